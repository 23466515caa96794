//! Everything that atomesh prints: results on standard output, progress on standard error; and the meshes and
//! images that verbs name, which at another [`Desk`] need not be files.

use std::any::Any;
use std::cell::RefCell;
use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::panic::resume_unwind;
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

use crate::cli::common::global::Common;
use crate::cli::common::options::read_options;
use crate::cli::desk::{Desk, Kept};
use crate::cli::provenance::file_hash;
use crate::cli::time_left::TimeLeft;
use crate::export::SurfaceFile;
use crate::image::formats::stream::Opened;
use crate::image::formats::{self, AnyLoaded, InputOptions, Lines};
use crate::image::{Image, Source};
use crate::job::{Meshing, Outcome, Space};
use crate::store::{AnyMesh, MeshFile, Stored, read_any_mesh};
use crate::{Error, Result, ranks};

/// What verbs speak to, and through which they read and write: a [`Desk`] with a few words of its own.
pub struct Console {
    desk: Box<dyn Desk>,
}

/// The hash of an image that may not be found yet.
pub enum Hashing {
    /// It is.
    Known(Result<String>),
    /// A thread is at it.
    Sought(JoinHandle<Result<String>>),
}

impl Hashing {
    /// Waits for it.
    ///
    /// # Errors
    /// As [`file_hash`].
    pub fn end(self) -> Result<String> {
        match self {
            Self::Known(hash) => hash,
            Self::Sought(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
        }
    }
}

impl Console {
    /// The terminal, as the common options ask for it; that of the first rank alone says anything.
    pub fn new(common: &Common) -> Self {
        Self::at(Terminal {
            quiet: common.quiet || !ranks::is_first(),
            json: common.json && ranks::is_first(),
            bar: None,
            job: RefCell::new(None),
        })
    }

    /// A console at another desk.
    pub fn at(desk: impl Desk + 'static) -> Self {
        Self {
            desk: Box::new(desk),
        }
    }

    /// The result of a verb.
    pub fn result(&mut self, text: impl Display, json: &serde_json::Value) {
        self.desk.result(&text.to_string(), json);
    }

    /// One line about something that the user should know but that stops nothing.
    pub fn note(&self, line: impl Display) {
        self.desk.note(&line.to_string());
    }

    /// One line beside the progress.
    pub fn line(&self, line: impl Display) {
        self.desk.line(&line.to_string());
    }

    /// A stage begins.
    pub fn begin_stage(&mut self, name: impl Display) {
        self.desk.stage(&name.to_string());
    }

    /// How much of the stage is done at most, in [0, 1], and what it is at.
    pub fn progress(&self, share: f64, what: impl Display) {
        self.desk.progress(share, &what.to_string());
    }

    /// The stage is over.
    pub fn end_stage(&mut self) {
        self.desk.end_stage();
    }

    /// A mesh that an argument names.
    ///
    /// # Errors
    /// As [`read_any_mesh`].
    pub fn read_mesh(&self, path: &Path) -> Result<AnyMesh> {
        match self.desk.mesh(path) {
            Some(mesh) => Ok(mesh),
            None => read_any_mesh(path),
        }
    }

    /// An image that an argument names.
    ///
    /// # Errors
    /// As [`formats::read_any`]; [`Error::Job`] for options that do not apply to it.
    pub fn read_image(&self, path: &Path, input: &InputOptions) -> Result<AnyLoaded> {
        match self.desk.image(path) {
            Some(image) => {
                let rest = InputOptions {
                    null: None,
                    ..input.clone()
                };
                rest.refuse_unused("the image is in memory")?;
                Opened::Held(image).with_nulls(&input.nulls()?).load(path)
            }
            None => formats::read_any(path, &read_options(input, path)?),
        }
    }

    /// The same with its samples left in the file, where they may be more than memory holds.
    ///
    /// # Errors
    /// As [`Console::read_image`].
    pub fn open_image(&self, path: &Path, input: &InputOptions) -> Result<Opened> {
        match self.desk.image(path) {
            Some(_) => self.read_image(path, input).map(Opened::Held),
            None => formats::open(path, &read_options(input, path)?),
        }
    }

    /// Whether what goes to `path` is kept in memory.
    pub fn keeps(&self, path: &Path) -> bool {
        self.desk.keeps(path)
    }

    /// The hash of an image or of a mesh that an argument names.
    ///
    /// # Errors
    /// As [`file_hash`].
    pub fn hash(&self, path: &Path) -> Result<String> {
        match self.desk.hash(path) {
            Some(hash) => Ok(hash),
            None => file_hash(path),
        }
    }

    /// The same, sought while other things go on.
    pub fn hashing(&self, path: &Path) -> Hashing {
        let sought = || {
            let path = path.to_path_buf();
            thread::Builder::new().spawn(move || file_hash(&path)).ok()
        };
        match self.desk.hash(path) {
            Some(hash) => Hashing::Known(Ok(hash)),
            None => sought().map_or_else(|| Hashing::Known(file_hash(path)), Hashing::Sought),
        }
    }

    /// Writes a mesh.
    ///
    /// # Errors
    /// As [`Stored::write`].
    pub fn write_mesh<const D: usize, M>(&mut self, path: &Path, file: MeshFile<M>) -> Result<()>
    where
        M: Stored<D>,
    {
        self.write(path, file, |file| M::write(path, file))
    }

    /// Writes the mesh of a job, and its image's values in it.
    ///
    /// # Errors
    /// As [`Outcome::write_with_image`].
    pub fn write_outcome<const D: usize>(
        &mut self,
        path: &Path,
        outcome: &Outcome<D>,
        image: Source<'_, D>,
    ) -> Result<()>
    where
        Space<D>: Meshing<D>,
    {
        if !self.desk.keeps(path) {
            return outcome.write_with_image(path, image);
        }
        if let Some(mesh) = outcome.file(image)? {
            self.desk.keep(path, Kept::Mesh(Box::new(mesh)));
        }
        Ok(())
    }

    /// Writes an image.
    ///
    /// # Errors
    /// As [`formats::write`].
    pub fn write_image<const D: usize>(&mut self, path: &Path, image: Image<D>) -> Result<()> {
        self.write_survey(path, image, None)
    }

    /// Writes an image with the numbers of its inlines and crosslines, where it has any.
    ///
    /// # Errors
    /// As [`formats::write`].
    pub fn write_survey<const D: usize>(
        &mut self,
        path: &Path,
        image: Image<D>,
        lines: Option<[Lines; 2]>,
    ) -> Result<()> {
        self.write(path, image, |image| {
            formats::write_survey(path, image, lines)
        })
    }

    /// Writes surfaces by what `write` does.
    ///
    /// # Errors
    /// As `write`.
    pub fn write_surfaces<const D: usize>(
        &mut self,
        path: &Path,
        file: SurfaceFile<D>,
        write: impl FnOnce(&SurfaceFile<D>) -> Result<()>,
    ) -> Result<()> {
        self.write(path, file, write)
    }

    /// Keeps a result, or writes it.
    fn write<T: Any>(
        &mut self,
        path: &Path,
        result: T,
        write: impl FnOnce(&T) -> Result<()>,
    ) -> Result<()> {
        if !self.desk.keeps(path) {
            return write(&result);
        }
        if let Some(kept) = Kept::of(result) {
            self.desk.keep(path, kept);
        }
        Ok(())
    }
}

/// The terminal: where lines go, and whether they go anywhere.
struct Terminal {
    quiet: bool,
    json: bool,
    bar: Option<ProgressBar>,
    /// How far the mesh job is that the bar shows, and when it began.
    job: RefCell<Option<(TimeLeft, Instant)>>,
}

impl Desk for Terminal {
    /// Prints `json` if asked for, else `text` unless `--quiet`.
    fn result(&mut self, text: &str, json: &serde_json::Value) {
        self.end_stage();
        if self.json {
            print(format_args!("{json:#}"));
        } else if !self.quiet {
            print(text);
        }
    }

    fn note(&self, line: &str) {
        self.line(&format!("note: {line}"));
    }

    fn line(&self, line: &str) {
        if self.quiet {
            return;
        }
        match &self.bar {
            Some(bar) => bar.suspend(|| complain(line)),
            None => complain(line),
        }
    }

    /// A spinner, later perhaps a bar, on a terminal, a plain line elsewhere.
    fn stage(&mut self, name: &str) {
        let goes_on = match self.job.get_mut() {
            Some((job, start)) => job.begin(name, start.elapsed().as_secs_f64()),
            None => false,
        };
        if let (Some(bar), true) = (&self.bar, goes_on) {
            bar.set_prefix(name.to_string());
            self.show_job("");
            return;
        }
        self.end_stage();
        if self.quiet {
            return;
        }
        if stderr().is_terminal() {
            let bar = ProgressBar::new_spinner().with_prefix(name.to_string());
            bar.set_style(style("{spinner} {prefix} {elapsed}"));
            bar.enable_steady_tick(Duration::from_millis(100));
            self.bar = Some(bar);
            *self.job.get_mut() = TimeLeft::new(name).map(|job| (job, Instant::now()));
            self.show_job("");
        } else {
            complain(format_args!("{name} ..."));
        }
    }

    /// Only a terminal shows it.
    fn progress(&self, share: f64, what: &str) {
        let Some(bar) = &self.bar else { return };
        let is_job = match &mut *self.job.borrow_mut() {
            Some((job, start)) => {
                job.update(share, start.elapsed().as_secs_f64());
                true
            }
            None => false,
        };
        if is_job {
            self.show_job(what);
            return;
        }
        if bar.length().is_none() {
            bar.set_length(STEPS as u64);
            bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed}  {msg}"));
        }
        bar.set_position((STEPS * share.clamp(0.0, 1.0)) as u64);
        bar.set_message(what.to_string());
    }

    /// The bar vanishes.
    fn end_stage(&mut self) {
        *self.job.get_mut() = None;
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

impl Terminal {
    /// Shows how far the mesh job is, and how much longer it takes at most.
    fn show_job(&self, what: &str) {
        let job = self.job.borrow();
        let (Some(bar), Some((job, start))) = (&self.bar, &*job) else {
            return;
        };
        if bar.length().is_none() {
            bar.set_length(STEPS as u64);
            bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed}{msg}"));
        }
        bar.set_position((STEPS * job.done()) as u64);
        let left = job.left(start.elapsed().as_secs_f64());
        let left = left.map(|left| {
            let left = Duration::from_secs(left.ceil() as u64);
            format!(", at most {} left", HumanDuration(left))
        });
        let gap = if what.is_empty() { "" } else { "  " };
        bar.set_message(format!("{}{gap}{what}", left.unwrap_or_default()));
    }
}

/// Steps of a bar.
const STEPS: f64 = 1000.0;

/// A style from a template; the default one, should the template be faulty.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner())
}

/// Prints one line on standard output. A reader that went away (`atomesh info x | head -1`) is no
/// fault of ours.
pub fn print(line: impl Display) {
    let _ = writeln!(stdout().lock(), "{}", harmless(&line.to_string()));
}

/// Prints one line on standard error.
pub fn complain(line: impl Display) {
    let _ = writeln!(stderr().lock(), "{}", harmless(&line.to_string()));
}

/// Text with control characters other than the ends of lines and tabs spelled out: names and words from
/// files shall not steer a terminal.
fn harmless(text: &str) -> String {
    let steers = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    text.chars()
        .flat_map(|c| match steers(c) {
            true => c.escape_default().collect::<Vec<char>>(),
            false => vec![c],
        })
        .collect()
}

/// An error as one line, with the option that it is about: the library knows parameters, not options.
pub fn in_words(error: &Error) -> String {
    let option = error.cause().parameter.map(|p| format!(" (--{p})"));
    format!("{error}{}", option.unwrap_or_default()).replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_from_files_do_not_steer_the_terminal() {
        let said = harmless("a\u{1b}[31mRED\u{1b}]0;title\u{7}\u{9b}2J\r b\n\tc é");
        assert_eq!(
            said,
            "a\\u{1b}[31mRED\\u{1b}]0;title\\u{7}\\u{9b}2J\\r b\n\tc é"
        );
    }
}
