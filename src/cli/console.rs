//! The console of a verb: results go to standard output, progress goes to standard error.
//!
//! Verbs also read and write meshes and images through it, as these are not files under every
//! [`Host`].

use std::any::Any;
use std::cell::RefCell;
use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

use crate::cli::common::global::CommonOptions;
use crate::cli::common::options::read_options;
use crate::cli::common::output::path_text;
use crate::cli::host::{Host, MemoryOutput};
use crate::cli::interrupts::Interrupts;
use crate::cli::provenance::file_hash;
use crate::cli::time_left::TimeLeft;
use crate::comm::Comm;
use crate::export::SurfaceFile;
use crate::image::formats::stream::OpenedImage;
use crate::image::formats::with_loaded;
use crate::image::formats::{self, AnyImage, InputOptions, ReadImage};
use crate::image::{Image, ImageSource};
use crate::job::{MeshSpace, Meshing, Outcome};
use crate::progress::{Progress, Stage};
use crate::store::{AnyMesh, MeshFile, Storable, read_any_mesh_with_notes};
use crate::store::{ImageInput, MeshInput};
use crate::surface_file::AnySurfaces;
use crate::surfaces::SurfaceOutcome;
use crate::surfaces::SurfaceSpec;
use crate::{Error, Result};

/// The console of a verb: a [`Host`] with some convenience methods.
pub struct Console {
    host: Box<dyn Host>,
}

/// The hash of an image that may still be being computed.
pub enum PendingHash {
    /// The hash is known.
    Ready(Result<String>),
    /// A thread computes the hash.
    Running(JoinHandle<Result<String>>),
}

impl PendingHash {
    /// Waits for the hash and returns it.
    ///
    /// # Errors
    /// Returns the errors of [`file_hash`].
    pub fn wait(self) -> Result<String> {
        match self {
            Self::Ready(hash) => hash,
            Self::Running(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
        }
    }
}

impl Console {
    /// Returns the console of the terminal, as the common options configure it. Only the root rank
    /// prints anything.
    pub(super) fn new(common: &CommonOptions, comm: &dyn Comm) -> Self {
        Self::with_host(Terminal {
            quiet: common.quiet || !comm.is_root(),
            json: common.json && comm.is_root(),
            bar: None,
            job: RefCell::new(None),
        })
    }

    /// Returns the console of another host.
    pub fn with_host(host: impl Host + 'static) -> Self {
        Self {
            host: Box::new(host),
        }
    }

    /// Reports the result of a verb, as text and as JSON.
    pub fn result(&mut self, text: impl Display, json: &serde_json::Value) {
        self.host.result(&text.to_string(), json);
    }

    /// Prints a note: one line that the user should read but that stops nothing.
    pub fn note(&self, line: impl Display) {
        self.host.note(&line.to_string());
    }

    /// Prints one line next to the progress.
    pub fn log_line(&self, line: impl Display) {
        self.host.log_line(&line.to_string());
    }

    /// Begins a stage.
    pub fn begin_stage(&mut self, name: impl Display) {
        self.host.begin_stage(&name.to_string());
    }

    /// Shows the largest fraction of the stage that can be done, in [0, 1], and its current step.
    pub fn progress(&self, fraction: f64, detail: impl Display) {
        self.host.progress(fraction, &detail.to_string());
    }

    /// Ends the stage.
    pub fn end_stage(&mut self) {
        self.host.end_stage();
    }

    /// Runs a function of the library, which reads images through this console and reports its
    /// progress to it.
    pub fn run<T>(
        &mut self,
        interrupts: &Interrupts,
        work: impl FnOnce(ReadImage<'_>, &mut dyn Progress) -> T,
    ) -> T {
        let console = Mutex::new(self);
        let mut progress = VerbProgress {
            console: &console,
            interrupts,
        };
        let read_image = |path: &Path, input: &InputOptions| lock(&console).read_image(path, input);
        work(&read_image, &mut progress)
    }

    /// Reads the mesh that an argument names, and runs a function of the library on it.
    ///
    /// # Errors
    /// Returns the errors of [`Console::read_mesh`] and of the function.
    pub fn run_on_mesh<T>(
        &mut self,
        interrupts: &Interrupts,
        path: &Path,
        work: impl FnOnce(MeshInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        self.begin_stage(Stage::Reading);
        let mesh = self.read_mesh(path)?;
        let name = path.display().to_string();
        self.run(interrupts, |read_image, progress| {
            let input = MeshInput {
                mesh,
                name: &name,
                read_image,
            };
            work(input, progress)
        })
    }

    /// Runs a function of the library on a mesh and an image, which come from these files.
    ///
    /// # Errors
    /// Returns the errors of the function.
    pub fn run_on_mesh_and_image<T>(
        &mut self,
        interrupts: &Interrupts,
        mesh: AnyMesh,
        image: AnyImage,
        paths: [&Path; 2],
        sha256: Option<String>,
        work: impl FnOnce(MeshInput<'_>, ImageInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        let [mesh_name, image_name] = paths.map(path_text);
        self.run(interrupts, |read_image, progress| {
            let mesh = MeshInput {
                mesh,
                name: &mesh_name,
                read_image,
            };
            let image = ImageInput {
                image,
                name: &image_name,
                sha256,
            };
            work(mesh, image, progress)
        })
    }

    /// Reads a mesh that an argument names, and prints notes on what is in the file.
    ///
    /// # Errors
    /// Returns the errors of [`read_any_mesh_with_notes`].
    pub fn read_mesh(&self, path: &Path) -> Result<AnyMesh> {
        match self.host.mesh(path) {
            Some(mesh) => Ok(mesh),
            None => {
                let (mesh, notes) = read_any_mesh_with_notes(path)?;
                notes.iter().for_each(|note| self.note(note));
                Ok(mesh)
            }
        }
    }

    /// Reads an image that an argument names.
    ///
    /// # Errors
    /// Returns the errors of [`formats::read_any`], and [`Error::Job`] for options that do not
    /// apply to the image.
    pub fn read_image(&self, path: &Path, input: &InputOptions) -> Result<AnyImage> {
        match self.host.image(path) {
            Some(image) => {
                let remaining = InputOptions {
                    null: None,
                    crop: None,
                    inside: None,
                    ..input.clone()
                };
                remaining.refuse_unused(
                    "the image is in memory",
                    "omit it; spacing, origin and units are those of the image in memory",
                )?;
                input.restrict(image, path)
            }
            None => formats::read_any(path, &read_options(input, path)?),
        }
    }

    /// Returns the function by which the library reads images through this console.
    pub fn reader(&self) -> impl Fn(&Path, &InputOptions) -> Result<AnyImage> {
        |path, input| self.read_image(path, input)
    }

    /// Opens an image that an argument names. Its samples stay in the file, as they may exceed the
    /// memory.
    ///
    /// # Errors
    /// Returns the errors of [`Console::read_image`].
    pub fn open_image(&self, path: &Path, input: &InputOptions) -> Result<OpenedImage> {
        match self.host.image(path) {
            Some(_) => self.read_image(path, input).map(OpenedImage::InMemory),
            None => formats::open(path, &read_options(input, path)?),
        }
    }

    /// Returns `true` if output to `path` is kept in memory.
    pub fn keeps_in_memory(&self, path: &Path) -> bool {
        self.host.keeps_in_memory(path)
    }

    /// Returns the hash of an image or of a mesh that an argument names.
    ///
    /// # Errors
    /// Returns the errors of [`file_hash`].
    pub fn hash(&self, path: &Path) -> Result<String> {
        match self.host.hash(path) {
            Some(hash) => Ok(hash),
            None => file_hash(path),
        }
    }

    /// Starts to compute the hash of an image in a thread of its own.
    pub fn start_hash(&self, path: &Path) -> PendingHash {
        let spawn = || {
            let path = path.to_path_buf();
            thread::Builder::new().spawn(move || file_hash(&path)).ok()
        };
        match self.host.hash(path) {
            Some(hash) => PendingHash::Ready(Ok(hash)),
            None => {
                spawn().map_or_else(|| PendingHash::Ready(file_hash(path)), PendingHash::Running)
            }
        }
    }

    /// Writes a mesh.
    ///
    /// # Errors
    /// Returns the errors of [`Storable::write`].
    pub fn write_mesh<const D: usize, M>(&mut self, path: &Path, file: MeshFile<M>) -> Result<()>
    where
        M: Storable<D>,
    {
        self.write(path, file, |file| M::write(path, file))
    }

    /// Writes a mesh of any kind.
    ///
    /// # Errors
    /// Returns the errors of [`AnyMesh::write`].
    pub fn write_any_mesh(&mut self, path: &Path, mesh: AnyMesh) -> Result<()> {
        if !self.host.keeps_in_memory(path) {
            return mesh.write(path);
        }
        self.host
            .keep_in_memory(path, MemoryOutput::Mesh(Box::new(mesh)));
        Ok(())
    }

    /// Writes the mesh of a job, with the image's values at its nodes or cells.
    ///
    /// # Errors
    /// Returns the errors of [`Outcome::write_with_image`].
    pub(crate) fn write_outcome<const D: usize>(
        &mut self,
        path: &Path,
        outcome: &Outcome<D>,
        image: ImageSource<'_, D>,
        comm: &dyn Comm,
    ) -> Result<()>
    where
        MeshSpace<D>: Meshing<D>,
    {
        if !self.host.keeps_in_memory(path) {
            return outcome.write_distributed(path, image, comm);
        }
        let mesh = outcome.mesh_file(image)?;
        self.host
            .keep_in_memory(path, MemoryOutput::Mesh(Box::new(mesh)));
        Ok(())
    }

    /// Writes an image.
    ///
    /// # Errors
    /// Returns the errors of [`formats::write`].
    pub fn write_image<const D: usize>(&mut self, path: &Path, image: Image<D>) -> Result<()> {
        self.write(path, image, |image| formats::write(path, image))
    }

    /// Writes an image of any dimension, with the line numbers of a survey if it has any.
    ///
    /// # Errors
    /// Returns the errors of [`formats::write`].
    pub fn write_any_image(&mut self, path: &Path, image: AnyImage) -> Result<()> {
        if !self.host.keeps_in_memory(path) {
            return image.write(path);
        }
        with_loaded!(image, loaded => self.write_image(path, loaded.image))
    }

    /// Writes surfaces in the format of the file's ending.
    ///
    /// # Errors
    /// Returns the errors of [`SurfaceFile::write`].
    pub fn write_surfaces<const D: usize>(
        &mut self,
        path: &Path,
        file: SurfaceFile<D>,
    ) -> Result<()> {
        self.write(path, file, |file| file.write(path))
    }

    /// Writes surfaces or curves in the format of the file's ending.
    ///
    /// # Errors
    /// Returns the errors of [`SurfaceFile::write`].
    pub fn write_any_surfaces(&mut self, path: &Path, surfaces: AnySurfaces) -> Result<()> {
        match surfaces {
            AnySurfaces::Curves(file) => self.write_surfaces(path, file),
            AnySurfaces::Surfaces(file) => self.write_surfaces(path, file),
        }
    }

    /// Writes the surfaces of a mesh, also as sticks or grids.
    ///
    /// # Errors
    /// Returns the errors of [`SurfaceOutcome::write`].
    pub fn write_outcome_surfaces(
        &mut self,
        path: &Path,
        outcome: SurfaceOutcome,
        spec: &SurfaceSpec,
    ) -> Result<Vec<PathBuf>> {
        if !self.host.keeps_in_memory(path) {
            return outcome.write(path, spec);
        }
        self.write_any_surfaces(path, outcome.surfaces)?;
        Ok(vec![path.to_path_buf()])
    }

    /// Keeps a result in memory, or writes it with the function `write`.
    fn write<T: Any>(
        &mut self,
        path: &Path,
        result: T,
        write: impl FnOnce(&T) -> Result<()>,
    ) -> Result<()> {
        if !self.host.keeps_in_memory(path) {
            return write(&result);
        }
        if let Some(output) = MemoryOutput::from_any(result) {
            self.host.keep_in_memory(path, output);
        }
        Ok(())
    }
}

/// A console that a function of the library shares with the function that reads its images.
type SharedConsole<'a> = Mutex<&'a mut Console>;

/// Locks the console, of which no thread leaves an inconsistent state behind.
fn lock<'a, 'c>(console: &'a SharedConsole<'c>) -> MutexGuard<'a, &'c mut Console> {
    console.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Shows the progress of a function of the library, and stops it when the user asks for it.
struct VerbProgress<'a, 'c> {
    console: &'a SharedConsole<'c>,
    interrupts: &'a Interrupts,
}

impl Progress for VerbProgress<'_, '_> {
    fn stage(&mut self, stage: Stage) {
        lock(self.console).begin_stage(stage);
    }

    fn note(&mut self, line: &str) {
        lock(self.console).note(line);
    }

    fn fraction_done(&mut self, fraction: f64) {
        lock(self.console).progress(fraction, "");
    }

    fn keep_going(&mut self) -> bool {
        !self.interrupts.is_requested()
    }
}

/// The host of the command line: a terminal, or files to which its output is redirected.
struct Terminal {
    quiet: bool,
    json: bool,
    bar: Option<ProgressBar>,
    /// Progress of the mesh job that the bar shows, and the time when it began.
    job: RefCell<Option<(TimeLeft, Instant)>>,
}

impl Host for Terminal {
    /// Prints `json` with `--json`, otherwise `text` unless `--quiet` is given.
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

    /// Shows a spinner, which may become a bar later, on a terminal, and prints a line elsewhere.
    fn begin_stage(&mut self, name: &str) {
        let continues = match self.job.get_mut() {
            Some((job, start)) => job.begin_stage(name, start.elapsed().as_secs_f64()),
            None => false,
        };
        if let (Some(bar), true) = (&self.bar, continues) {
            bar.set_prefix(name.to_string());
            self.show_job("");
            return;
        }
        if !(PRINTS_PERCENT && continues) {
            self.end_stage();
        }
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
            if PRINTS_PERCENT && !continues {
                *self.job.get_mut() = TimeLeft::new(name).map(|job| (job, Instant::now()));
            }
        }
    }

    /// Shows the progress on a terminal, and prints it in a browser.
    fn progress(&self, fraction: f64, detail: &str) {
        let Some(bar) = &self.bar else {
            if PRINTS_PERCENT && !self.quiet {
                self.print_percent(fraction);
            }
            return;
        };
        let is_job = match &mut *self.job.borrow_mut() {
            Some((job, start)) => {
                job.update(fraction, start.elapsed().as_secs_f64());
                true
            }
            None => false,
        };
        if is_job {
            self.show_job(detail);
            return;
        }
        if bar.length().is_none() {
            bar.set_length(BAR_STEPS as u64);
            bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed}  {msg}"));
        }
        bar.set_position((BAR_STEPS * fraction.clamp(0.0, 1.0)) as u64);
        bar.set_message(detail.to_string());
    }

    /// Removes the bar.
    fn end_stage(&mut self) {
        *self.job.get_mut() = None;
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

impl Terminal {
    /// Prints the percentage of the mesh job, or else of the stage, that is done.
    fn print_percent(&self, fraction: f64) {
        let done = match &mut *self.job.borrow_mut() {
            Some((job, start)) => {
                job.update(fraction, start.elapsed().as_secs_f64());
                job.share_done()
            }
            None => fraction.clamp(0.0, 1.0),
        };
        print_stderr(format_args!("{:.1} %", 100.0 * done));
    }

    /// Shows the progress of the mesh job and an upper bound of the time left.
    fn show_job(&self, detail: &str) {
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
        let gap = if detail.is_empty() { "" } else { "  " };
        bar.set_message(format!("{}{gap}{detail}", left.unwrap_or_default()));
    }
}

/// Is `true` where the progress is printed as lines such as `42.5 %`, for the page that runs the
/// program in a browser.
const PRINTS_PERCENT: bool = cfg!(target_family = "wasm");

/// Number of steps of a progress bar.
const BAR_STEPS: f64 = 1000.0;

/// Returns a style from a template, or the default style if the template is faulty.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner())
}

/// Prints one line on standard output. A closed output (`atomesh info x | head -1`) is not an
/// error.
pub fn print(line: impl Display) {
    let _ = writeln!(stdout().lock(), "{}", escape_controls(&line.to_string()));
}

/// Prints one line on standard error.
pub fn print_stderr(line: impl Display) {
    let _ = writeln!(stderr().lock(), "{}", escape_controls(&line.to_string()));
}

/// Returns the text with control characters, except line ends and tabs, spelled out. Names and
/// words from files must not control the terminal.
fn escape_controls(text: &str) -> String {
    let is_unsafe = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    text.chars()
        .flat_map(|c| {
            if is_unsafe(c) {
                c.escape_default().collect::<Vec<char>>()
            } else {
                vec![c]
            }
        })
        .collect()
}

/// Returns an error as one line, with the option that it is about. The library names parameters,
/// not options.
pub fn error_line(error: &Error) -> String {
    let option = error.cause().parameter.map(|p| format!(" (--{p})"));
    format!("{error}{}", option.unwrap_or_default()).replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_from_files_does_not_control_the_terminal() {
        let escaped = escape_controls("a\u{1b}[31mRED\u{1b}]0;title\u{7}\u{9b}2J\r b\n\tc é");
        assert_eq!(
            escaped,
            "a\\u{1b}[31mRED\\u{1b}]0;title\\u{7}\\u{9b}2J\\r b\n\tc é"
        );
    }
}
