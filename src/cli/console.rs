//! Everything that atomesh prints: results on standard output, progress on standard error.

use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::Error;
use crate::cli::common::global::Common;

/// Where lines go, and whether they go anywhere.
pub struct Console {
    quiet: bool,
    json: bool,
    bar: Option<ProgressBar>,
}

impl Console {
    /// A console as the common options ask for it.
    pub fn new(common: &Common) -> Self {
        Self {
            quiet: common.quiet,
            json: common.json,
            bar: None,
        }
    }

    /// Prints the result of a verb: `json` if asked for, else `text` unless `--quiet`.
    pub fn result(&mut self, text: impl Display, json: &serde_json::Value) {
        self.end_stage();
        if self.json {
            print(format_args!("{json:#}"));
        } else if !self.quiet {
            print(text);
        }
    }

    /// One line about something that the user should know but that stops nothing.
    pub fn note(&self, line: impl Display) {
        self.line(format_args!("note: {line}"));
    }

    /// One line beside the progress.
    pub fn line(&self, line: impl Display) {
        if self.quiet {
            return;
        }
        match &self.bar {
            Some(bar) => bar.suspend(|| complain(line)),
            None => complain(line),
        }
    }

    /// A stage begins: a spinner, later perhaps a bar, on a terminal, a plain line elsewhere.
    pub fn begin_stage(&mut self, name: impl Display) {
        self.end_stage();
        if self.quiet {
            return;
        }
        if stderr().is_terminal() {
            let bar = ProgressBar::new_spinner().with_prefix(name.to_string());
            bar.set_style(style("{spinner} {prefix} {elapsed}"));
            bar.enable_steady_tick(Duration::from_millis(100));
            self.bar = Some(bar);
        } else {
            complain(format_args!("{name} ..."));
        }
    }

    /// How much of the stage is done at most, in [0, 1], and what it is at; only a terminal shows it.
    pub fn progress(&self, share: f64, what: impl Display) {
        if let Some(bar) = &self.bar {
            if bar.length().is_none() {
                bar.set_length(100);
                bar.set_style(style("{spinner} {prefix} [{bar:20}] {elapsed} {msg}"));
            }
            bar.set_position((100.0 * share.clamp(0.0, 1.0)) as u64);
            bar.set_message(what.to_string());
        }
    }

    /// The stage is over: its bar vanishes.
    pub fn end_stage(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

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
