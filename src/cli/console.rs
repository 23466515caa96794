//! The console of a verb: results go to standard output, progress goes to standard error.

use std::cell::RefCell;
use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

use crate::Error;
use crate::cli::common::global::CommonOptions;
use crate::cli::interrupts::Interrupts;
use crate::cli::time_left::TimeLeft;
use crate::progress::{OptimiseStatus, Progress, SizeEstimate, Stage};
use crate::session::Answer;

/// The console of a verb: a terminal, or files to which its output is redirected.
pub struct Console {
    quiet: bool,
    json: bool,
    bar: Option<ProgressBar>,
    /// Progress of the mesh job that the bar shows, and the time when it began.
    job: RefCell<Option<(TimeLeft, Instant)>>,
}

impl Console {
    /// Returns the console that the common options configure. Of several processes that share a job,
    /// only one `prints` anything.
    pub(super) fn new(common: &CommonOptions, prints: bool) -> Self {
        Self {
            quiet: common.quiet || !prints,
            json: common.json && prints,
            bar: None,
            job: RefCell::new(None),
        }
    }

    /// Returns the progress of a function of the library: it is shown here, and stops when the user
    /// asks for it.
    pub fn progress<'a>(&'a mut self, interrupts: &'a Interrupts) -> VerbProgress<'a> {
        VerbProgress {
            console: self,
            interrupts,
            job: None,
        }
    }

    /// Returns the progress of a mesh job, which other processes share unless it `is_alone`.
    pub(super) fn job_progress<'a>(
        &'a mut self,
        interrupts: &'a Interrupts,
        is_alone: bool,
    ) -> VerbProgress<'a> {
        VerbProgress {
            job: Some(is_alone),
            ..self.progress(interrupts)
        }
    }

    /// Prints the report of a verb, and the names of the files that it wrote.
    pub fn answer(&mut self, answer: &Answer) {
        let files = answer.files.iter().map(|file| format!("wrote {file}"));
        let text = Some(answer.text.clone()).filter(|text| !text.is_empty());
        let lines: Vec<String> = text.into_iter().chain(files).collect();
        self.result(lines.join("\n"), &answer.json);
    }

    /// Prints `json` with `--json`, otherwise `text` unless `--quiet` is given.
    pub fn result(&mut self, text: impl Display, json: &serde_json::Value) {
        self.end_stage();
        if self.json {
            print(format_args!("{json:#}"));
        } else if !self.quiet {
            print(text);
        }
    }

    /// Prints a note: one line that the user should read but that stops nothing.
    fn note(&self, line: impl Display) {
        self.log_line(format_args!("note: {line}"));
    }

    /// Prints one line next to the progress.
    fn log_line(&self, line: impl Display) {
        if self.quiet {
            return;
        }
        match &self.bar {
            Some(bar) => bar.suspend(|| print_stderr(line)),
            None => print_stderr(line),
        }
    }

    /// Begins a stage. Shows a spinner, which may become a bar later, on a terminal, and prints a line elsewhere.
    fn begin_stage(&mut self, stage: Stage) {
        let name = &stage.to_string();
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

    /// Shows the fraction of the stage that is done, in [0, 1], and its current step, on a terminal;
    /// prints the fraction in a browser.
    fn show_progress(&self, fraction: f64, detail: &str) {
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

/// The progress of a function of the library on the console. It stops when the user asks for it.
pub struct VerbProgress<'a> {
    console: &'a mut Console,
    interrupts: &'a Interrupts,
    /// For a mesh job, `true` if no other process shares it.
    job: Option<bool>,
}

impl Progress for VerbProgress<'_> {
    fn stage(&mut self, stage: Stage) {
        self.console.begin_stage(stage);
        if let Some(is_alone) = self.job {
            // Several processes would not stop at the same place.
            self.interrupts.set_stage(stage, is_alone);
        }
    }

    fn note(&mut self, line: &str) {
        self.console.note(line);
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        if self.job.is_some() {
            self.console.log_line(estimate);
        }
    }

    fn optimise_step(&mut self, status: &OptimiseStatus) {
        if self.job.is_some() {
            self.console
                .show_progress(status.fraction(), &status.to_string());
        }
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.console.show_progress(fraction, "");
    }

    fn keep_going(&mut self) -> bool {
        !self.interrupts.is_requested()
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
