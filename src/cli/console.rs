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

use crate::cli::common::global::CommonOptions;
use crate::cli::common::options::read_options;
use crate::cli::host::{Host, MemoryOutput};
use crate::cli::provenance::file_hash;
use crate::cli::time_left::TimeLeft;
use crate::export::SurfaceFile;
use crate::image::formats::stream::OpenedImage;
use crate::image::formats::{self, AnyImage, InputOptions, LineNumbers};
use crate::image::{Image, ImageSource};
use crate::job::{MeshSpace, Meshing, Outcome};
use crate::store::{AnyMesh, MeshFile, Storable, read_any_mesh};
use crate::{Error, Result, comm};

/// What verbs speak to, and through which they read and write: a [`Desk`] with a few words of its own.
pub struct Console {
    host: Box<dyn Host>,
}

/// The hash of an image that may not be found yet.
pub enum PendingHash {
    /// It is.
    Ready(Result<String>),
    /// A thread is at it.
    Running(JoinHandle<Result<String>>),
}

impl PendingHash {
    /// Waits for it.
    ///
    /// # Errors
    /// As [`file_hash`].
    pub fn wait(self) -> Result<String> {
        match self {
            Self::Ready(hash) => hash,
            Self::Running(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
        }
    }
}

impl Console {
    /// The terminal, as the common options ask for it; that of the first rank alone says anything.
    pub fn new(common: &CommonOptions) -> Self {
        Self::with_host(Terminal {
            quiet: common.quiet || !comm::is_root(),
            json: common.json && comm::is_root(),
            bar: None,
            job: RefCell::new(None),
        })
    }

    /// A console at another desk.
    pub fn with_host(desk: impl Host + 'static) -> Self {
        Self {
            host: Box::new(desk),
        }
    }

    /// The result of a verb.
    pub fn result(&mut self, text: impl Display, json: &serde_json::Value) {
        self.host.result(&text.to_string(), json);
    }

    /// One line about something that the user should know but that stops nothing.
    pub fn note(&self, line: impl Display) {
        self.host.note(&line.to_string());
    }

    /// One line beside the progress.
    pub fn log_line(&self, line: impl Display) {
        self.host.log_line(&line.to_string());
    }

    /// A stage begins.
    pub fn begin_stage(&mut self, name: impl Display) {
        self.host.begin_stage(&name.to_string());
    }

    /// How much of the stage is done at most, in [0, 1], and what it is at.
    pub fn progress(&self, share: f64, what: impl Display) {
        self.host.progress(share, &what.to_string());
    }

    /// The stage is over.
    pub fn end_stage(&mut self) {
        self.host.end_stage();
    }

    /// A mesh that an argument names.
    ///
    /// # Errors
    /// As [`read_any_mesh`].
    pub fn read_mesh(&self, path: &Path) -> Result<AnyMesh> {
        match self.host.mesh(path) {
            Some(mesh) => Ok(mesh),
            None => read_any_mesh(path),
        }
    }

    /// An image that an argument names.
    ///
    /// # Errors
    /// As [`formats::read_any`]; [`Error::Job`] for options that do not apply to it.
    pub fn read_image(&self, path: &Path, input: &InputOptions) -> Result<AnyImage> {
        match self.host.image(path) {
            Some(image) => {
                let rest = InputOptions {
                    null: None,
                    ..input.clone()
                };
                rest.refuse_unused("the image is in memory")?;
                OpenedImage::InMemory(image)
                    .with_nulls(&input.nulls()?)
                    .load(path)
            }
            None => formats::read_any(path, &read_options(input, path)?),
        }
    }

    /// The same with its samples left in the file, where they may be more than memory holds.
    ///
    /// # Errors
    /// As [`Console::read_image`].
    pub fn open_image(&self, path: &Path, input: &InputOptions) -> Result<OpenedImage> {
        match self.host.image(path) {
            Some(_) => self.read_image(path, input).map(OpenedImage::InMemory),
            None => formats::open(path, &read_options(input, path)?),
        }
    }

    /// Whether what goes to `path` is kept in memory.
    pub fn keeps_in_memory(&self, path: &Path) -> bool {
        self.host.keeps_in_memory(path)
    }

    /// The hash of an image or of a mesh that an argument names.
    ///
    /// # Errors
    /// As [`file_hash`].
    pub fn hash(&self, path: &Path) -> Result<String> {
        match self.host.hash(path) {
            Some(hash) => Ok(hash),
            None => file_hash(path),
        }
    }

    /// The same, sought while other things go on.
    pub fn start_hash(&self, path: &Path) -> PendingHash {
        let sought = || {
            let path = path.to_path_buf();
            thread::Builder::new().spawn(move || file_hash(&path)).ok()
        };
        match self.host.hash(path) {
            Some(hash) => PendingHash::Ready(Ok(hash)),
            None => {
                sought().map_or_else(|| PendingHash::Ready(file_hash(path)), PendingHash::Running)
            }
        }
    }

    /// Writes a mesh.
    ///
    /// # Errors
    /// As [`Stored::write`].
    pub fn write_mesh<const D: usize, M>(&mut self, path: &Path, file: MeshFile<M>) -> Result<()>
    where
        M: Storable<D>,
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
        image: ImageSource<'_, D>,
    ) -> Result<()>
    where
        MeshSpace<D>: Meshing<D>,
    {
        if !self.host.keeps_in_memory(path) {
            return outcome.write_with_image(path, image);
        }
        if let Some(mesh) = outcome.mesh_file(image)? {
            self.host
                .keep_in_memory(path, MemoryOutput::Mesh(Box::new(mesh)));
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
        lines: Option<[LineNumbers; 2]>,
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
        if !self.host.keeps_in_memory(path) {
            return write(&result);
        }
        if let Some(kept) = MemoryOutput::from_any(result) {
            self.host.keep_in_memory(path, kept);
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

impl Host for Terminal {
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
        self.log_line(&format!("note: {line}"));
    }

    fn log_line(&self, line: &str) {
        if self.quiet {
            return;
        }
        match &self.bar {
            Some(bar) => bar.suspend(|| print_stderr(line)),
            None => print_stderr(line),
        }
    }

    /// A spinner, later perhaps a bar, on a terminal, a plain line elsewhere.
    fn begin_stage(&mut self, name: &str) {
        let goes_on = match self.job.get_mut() {
            Some((job, start)) => job.begin_stage(name, start.elapsed().as_secs_f64()),
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
            print_stderr(format_args!("{name} ..."));
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
            bar.set_length(BAR_STEPS as u64);
            bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed}  {msg}"));
        }
        bar.set_position((BAR_STEPS * share.clamp(0.0, 1.0)) as u64);
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
            bar.set_length(BAR_STEPS as u64);
            bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed}{msg}"));
        }
        bar.set_position((BAR_STEPS * job.share_done()) as u64);
        let left = job.seconds_left(start.elapsed().as_secs_f64());
        let left = left.map(|left| {
            let left = Duration::from_secs(left.ceil() as u64);
            format!(", at most {} left", HumanDuration(left))
        });
        let gap = if what.is_empty() { "" } else { "  " };
        bar.set_message(format!("{}{gap}{what}", left.unwrap_or_default()));
    }
}

/// Steps of a bar.
const BAR_STEPS: f64 = 1000.0;

/// A style from a template; the default one, should the template be faulty.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner())
}

/// Prints one line on standard output. A reader that went away (`atomesh info x | head -1`) is no
/// fault of ours.
pub fn print(line: impl Display) {
    let _ = writeln!(stdout().lock(), "{}", escape_controls(&line.to_string()));
}

/// Prints one line on standard error.
pub fn print_stderr(line: impl Display) {
    let _ = writeln!(stderr().lock(), "{}", escape_controls(&line.to_string()));
}

/// Text with control characters other than the ends of lines and tabs spelled out: names and words from
/// files shall not steer a terminal.
fn escape_controls(text: &str) -> String {
    let steers = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    text.chars()
        .flat_map(|c| match steers(c) {
            true => c.escape_default().collect::<Vec<char>>(),
            false => vec![c],
        })
        .collect()
}

/// An error as one line, with the option that it is about: the library knows parameters, not options.
pub fn error_line(error: &Error) -> String {
    let option = error.cause().parameter.map(|p| format!(" (--{p})"));
    format!("{error}{}", option.unwrap_or_default()).replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_from_files_do_not_steer_the_terminal() {
        let said = escape_controls("a\u{1b}[31mRED\u{1b}]0;title\u{7}\u{9b}2J\r b\n\tc é");
        assert_eq!(
            said,
            "a\\u{1b}[31mRED\\u{1b}]0;title\\u{7}\\u{9b}2J\\r b\n\tc é"
        );
    }
}
