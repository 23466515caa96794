//! A resident session: actions change meshes in memory, one after another, and can be undone.
//!
//! An action is a verb that makes a mesh, such as `mesh`, `edit` or `paint`, and the line of a script
//! with which the command line runs it. Meshes stay in memory under the names of their files, so that
//! an action may replace the mesh that it begins with. Images stay in memory as they were read. Each
//! action answers with its report and a [`MeshPatch`], which has what changed. An action that fails
//! changes nothing.
//!
//! The lines of all actions that are not undone are a script. Run in a new session, it makes the same
//! meshes, to the last bit. Undo and redo restore meshes to the last bit, too, from the differences
//! between their states.
//!
//! - `mesh_change`: the difference between two states of a mesh
//! - `mesh_patch`: the same for those who show the mesh

mod mesh_change;
mod mesh_patch;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::cause;
use crate::files::output::{check_output, path_text};
use crate::files::{commit_immediately, transaction};
use crate::mesh_file::AnyMesh;
use crate::progress::Progress;
use crate::session::{Answer, ImageCache, Objects, Output, ResidentData, Session};
use crate::{Error, Result};
use mesh_change::MeshChange;
pub use mesh_patch::{ArrayPatch, MeshPatch};

/// An action: a line of a script, and the files of its verb.
#[derive(Debug, Clone, Copy)]
pub struct Action<'a> {
    /// The line.
    pub line: &'a str,
    /// The file from which the verb makes the mesh: a mesh or an image.
    pub input: &'a Path,
    /// The name of the mesh that the verb makes.
    pub output: &'a Path,
}

/// The answer to an action.
#[derive(Debug)]
pub struct Reply {
    /// The report of the verb.
    pub answer: Answer,
    /// The nodes, cells and values that changed.
    pub patch: MeshPatch,
}

/// An action that was done, or was undone.
#[derive(Debug)]
struct Step {
    line: String,
    mesh: PathBuf,
    /// The change that leads to the other state: back from a step that was done, on from one that was
    /// undone.
    change: MeshChange,
}

/// A resident session.
///
/// ```
/// use std::path::Path;
/// use atomesh::image::synth::SyntheticKind;
/// use atomesh::progress::NoProgress;
/// use atomesh::workbench::{Action, Workbench};
/// use atomesh::{EditSpec, MeshSpec, SynthSpec};
///
/// let folder = tempfile::tempdir()?;
/// let image = &folder.path().join("disc.npy");
/// let spec = SynthSpec { dims: "60,50".parse()?, ..SynthSpec::default() };
/// atomesh::synth(SyntheticKind::Sphere, &spec)?.write(image)?;
///
/// let mut workbench = Workbench::default();
/// let mesh = Path::new("mesh.vtu");
/// let distance = "5".parse()?;
/// let line = "mesh disc.npy -o mesh.vtu --distance 5";
/// let action = Action { line, input: image, output: mesh };
/// workbench.act(action, &mut NoProgress, |session, output| {
///     let output = Some(output.into());
///     session.mesh(image, &MeshSpec { output, distance, ..MeshSpec::default() })
/// })?;
/// let line = "edit mesh.vtu disc.npy -o mesh.vtu --add 30.5,25";
/// let action = Action { line, input: mesh, output: mesh };
/// let spec = EditSpec { add: vec!["30.5,25".parse()?], ..EditSpec::default() };
/// let reply = workbench.act(action, &mut NoProgress, |session, output| {
///     session.edit(mesh, image, output, &spec)
/// })?;
/// assert!(reply.patch.cells.len() < reply.patch.cell_count[1]);
/// workbench.undo();
/// assert_eq!(workbench.done().count(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Workbench {
    objects: Objects,
    done: Vec<Step>,
    /// The steps that can be done again; the next one is the last.
    undone: Vec<Step>,
}

impl Default for Workbench {
    fn default() -> Self {
        Self {
            objects: Objects {
                keeps_results: true,
                resident: Some(ResidentData::default()),
                ..Objects::default()
            },
            done: Vec::new(),
            undone: Vec::new(),
        }
    }
}

impl Workbench {
    /// Runs a verb that makes a mesh, and keeps the mesh in memory. `verb` gets the name that it has
    /// to give to the mesh. Actions that were undone before can then not be redone any more.
    ///
    /// # Errors
    /// Returns the errors of the verb, [`Error::Job`] if the mesh would replace a file that the verb
    /// reads, and [`Error::Interrupted`] if `progress` stopped the verb, even if it made a mesh.
    pub fn act(
        &mut self,
        action: Action<'_>,
        progress: &mut dyn Progress,
        verb: impl FnOnce(&mut Session<'_>, &Path) -> Result<Answer>,
    ) -> Result<Reply> {
        let Action { input, output, .. } = action;
        check_output(output, "--output", &["vtu"], &self.files_among(&[input]))?;
        let kept = &kept_name(output);
        let with_output_name = |error: Error| {
            let place = &error.cause().place;
            let place = place.replace(&path_text(kept), &path_text(output));
            error.with_place(place)
        };
        let mut answer = self
            .run(progress, |session| verb(session, kept))
            .map_err(with_output_name)?;
        let Some((_, Output::Mesh(mesh))) = answer.kept.take() else {
            let problem = "makes no mesh";
            return Err(Error::Job(cause(
                action.line,
                problem,
                "give a verb that makes one",
            )));
        };
        if answer.is_interrupted {
            let remedy = "run the line again";
            return Err(Error::Interrupted(cause(
                action.line,
                "interrupted",
                remedy,
            )));
        }
        answer
            .files
            .retain(|file| !file.starts_with(&path_text(kept)));
        if let Some(file) = answer.json.get_mut("file") {
            *file = path_text(output).into();
        }
        let before = self.objects.meshes.remove(output);
        let change = MeshChange::between(&mesh, before);
        let patch = MeshPatch::new(&path_text(output), &change, Some(&mesh));
        self.objects.meshes.insert(output.into(), Arc::new(mesh));
        self.undone.clear();
        self.done.push(Step {
            line: action.line.trim().into(),
            mesh: output.into(),
            change,
        });
        Ok(Reply { answer, patch })
    }

    /// Runs a verb that makes no mesh, such as `export`, on the files and the meshes in memory.
    /// Scripts do not have its line.
    ///
    /// # Errors
    /// Returns the errors of the verb.
    pub fn query<T>(
        &mut self,
        progress: &mut dyn Progress,
        verb: impl FnOnce(&mut Session<'_>) -> Result<T>,
    ) -> Result<T> {
        let result = self.run(progress, verb);
        // The verb may have replaced an image.
        if let Some(resident) = &mut self.objects.resident {
            resident.images = ImageCache::default();
        }
        result
    }

    /// Detects the features that the edits of a mesh share, so that the first edit takes no longer than
    /// later ones. Changes no mesh.
    ///
    /// # Errors
    /// Returns the errors of the edits of a mesh or an image that cannot be edited.
    pub fn prepare_edits(
        &self,
        mesh: &Path,
        image: &Path,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        self.run(progress, |session| session.prepare_edits(mesh, image))
    }

    /// Runs a verb, whose files appear when it succeeds, or not at all.
    fn run<T>(
        &self,
        progress: &mut dyn Progress,
        verb: impl FnOnce(&mut Session<'_>) -> Result<T>,
    ) -> Result<T> {
        let mut session = Session {
            objects: &self.objects,
            progress,
        };
        commit_immediately(|| transaction(|| verb(&mut session)))
    }

    /// Returns the names that are not those of meshes in memory.
    fn files_among<'a>(&self, names: &[&'a Path]) -> Vec<&'a Path> {
        let is_file = |name: &&Path| !self.objects.meshes.contains_key(*name);
        names.iter().copied().filter(is_file).collect()
    }

    /// Undoes the last action, and returns what that changed; `None` if there is nothing to undo.
    pub fn undo(&mut self) -> Option<MeshPatch> {
        let mut step = self.done.pop()?;
        let patch = self.exchange(&mut step);
        self.undone.push(step);
        Some(patch)
    }

    /// Does again what was undone last, and returns what that changed; `None` if there is nothing to
    /// redo.
    pub fn redo(&mut self) -> Option<MeshPatch> {
        let mut step = self.undone.pop()?;
        let patch = self.exchange(&mut step);
        self.done.push(step);
        Some(patch)
    }

    /// Brings the mesh of a step into its other state.
    fn exchange(&mut self, step: &mut Step) -> MeshPatch {
        let meshes = &mut self.objects.meshes;
        let mut mesh = meshes.remove(&step.mesh);
        step.change.exchange(&mut mesh);
        let patch = MeshPatch::new(&path_text(&step.mesh), &step.change, mesh.as_deref());
        if let Some(mesh) = mesh {
            meshes.insert(step.mesh.clone(), mesh);
        }
        patch
    }

    /// Returns the lines of the actions that are done, the first one first.
    pub fn done(&self) -> impl Iterator<Item = &str> {
        self.done.iter().map(|step| step.line.as_str())
    }

    /// Returns the lines of the actions that were undone, the next one to redo first.
    pub fn undone(&self) -> impl Iterator<Item = &str> {
        self.undone.iter().rev().map(|step| step.line.as_str())
    }

    /// Returns the script that makes the present meshes from the files, one line for each action.
    pub fn script(&self) -> String {
        self.done().flat_map(|line| [line, "\n"]).collect()
    }

    /// Returns a mesh in memory.
    pub fn mesh(&self, name: &Path) -> Option<&AnyMesh> {
        self.objects.meshes.get(name).map(|mesh| &**mesh)
    }

    /// Returns the names of the meshes in memory, in the order in which they were made.
    pub fn mesh_names(&self) -> Vec<&Path> {
        let mut names: Vec<&Path> = Vec::new();
        for step in &self.done {
            if !names.contains(&step.mesh.as_path()) {
                names.push(&step.mesh);
            }
        }
        names
    }

    /// Writes the meshes to the files of their names: all, or none.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if a file cannot be written.
    pub fn write_meshes(&self) -> Result<()> {
        transaction(|| {
            let names = self.mesh_names();
            let mut meshes = (names.iter()).filter_map(|name| Some((name, self.mesh(name)?)));
            meshes.try_for_each(|(name, mesh)| mesh.write(name))
        })
    }
}

/// Returns the name under which a session keeps the mesh of a file while its verb runs. Names that begin
/// with `<` are those of objects in memory.
fn kept_name(output: &Path) -> PathBuf {
    let mut name = OsString::from("<");
    name.push(output.file_name().unwrap_or(output.as_os_str()));
    name.into()
}
