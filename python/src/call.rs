//! A call of a verb from Python's arguments.

use std::path::{Path, PathBuf};

use atomesh::error::cause;
use atomesh::files::output::path_text;
use atomesh::job::MeshSpec;
use atomesh::model::validate::CheckerVerdict;
use atomesh::progress::Progress;
use atomesh::session::{Answer, Objects, Session};
use atomesh::{Error, Result, files, memory};

use crate::options::Options;

/// A call of a verb.
pub struct Call {
    pub verb: String,
    /// The positional arguments.
    pub arguments: Vec<PathBuf>,
    pub options: Options,
    pub objects: Objects,
}

impl Call {
    /// Runs the verb. Output files appear when it has succeeded, or not at all.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files and of the library. An error that begins with
    /// the name of an option begins with its two hyphens.
    pub fn run(mut self, progress: &mut dyn Progress) -> Result<Answer> {
        if let Some(bytes) = self.options.take_max_memory()? {
            memory::set_limit(bytes);
        }
        files::transaction(|| self.run_verb(progress))
            .map_err(|error| with_hyphens(error, &self.verb))
    }

    fn run_verb(&mut self, progress: &mut dyn Progress) -> Result<Answer> {
        let mut session = Session {
            objects: &self.objects,
            progress,
        };
        let options = &mut self.options;
        if self.verb == "mesh" {
            let config = options.take_path("config");
            let names = options.0.keys().cloned().collect();
            let spec: MeshSpec = options.spec()?;
            return session.mesh(
                argument(&self.arguments, 0),
                &spec.with_config(&names, config.as_deref())?,
            );
        }
        let output = &options.take_path("output").unwrap_or_default();
        let [first, second] = [0, 1].map(|k| argument(&self.arguments, k));
        match self.verb.as_str() {
            "feature" => session.feature(first, output, &options.spec()?),
            "columns" => {
                let horizons = options.take_texts("horizon");
                session.columns(first, &horizons, output, &options.spec()?)
            }
            "convert" => session.convert(first, second, &options.spec()?),
            "edit" => session.edit(first, second, output, &options.spec()?),
            "export" => {
                let format = options.take_texts("to").concat();
                session.export(first, &format, output, &options.spec()?)
            }
            "flow" => session.flow(first, output, &options.spec()?),
            "info" => session.info(first, &options.spec()?),
            "paint" => session.paint(first, output, &options.spec()?),
            "quality" => session.quality(first, &options.spec()?),
            "report" => session.report(first, second, output, &options.spec()?),
            "segment" => session.segment(first, second, output, &options.spec()?),
            "slice" => session.slice(&self.arguments, output, &options.spec()?),
            "surface" => {
                if self.arguments.len() > 1 {
                    options.0.insert("image".into(), path_text(second).into());
                }
                session.surface(first, output, &options.spec()?)
            }
            "synth" => session.synth(&path_text(first), output, &options.spec()?),
            "validate" => {
                let (answer, verdicts) = session.validate(first)?;
                CheckerVerdict::require_valid(&verdicts, &path_text(first))?;
                Ok(answer)
            }
            other => Err(Error::Job(cause(other, "is no verb", "give another"))),
        }
    }
}

fn argument(arguments: &[PathBuf], k: usize) -> &Path {
    arguments.get(k).map_or(Path::new(""), PathBuf::as_path)
}

/// Returns the error with two hyphens before a place that begins with the name of an option of the
/// verb, as messages of the library name options elsewhere.
fn with_hyphens(error: Error, verb: &str) -> Error {
    let place = &error.cause().place;
    let name = place.split(' ').next().unwrap_or_default();
    let table = atomesh::option_table();
    let has_option = |verb: &str| {
        let options = table[verb]["options"].as_array();
        options.is_some_and(|options| options.iter().any(|option| option["name"] == name))
    };
    // An edit also repeats the options of the mesh.
    if has_option(verb) || verb == "edit" && has_option("mesh") {
        let place = format!("--{place}");
        return error.with_place(place);
    }
    error
}
