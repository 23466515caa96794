//! Scripts: commands as the lines of a text, which a resident session runs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use serde_json::{Value, json};

use super::args::{CommandLine, Verb, value_error};
use super::common::global::CommonOptions;
use super::console::Console;
use super::interrupts::Interrupts;
use super::run_session;
use super::verbs::mesh::MeshJob;
use crate::error::cause;
use crate::files::output::path_text;
use crate::progress::Progress;
use crate::session::{Answer, output_path};
use crate::workbench::{Action, MeshPatch, Workbench};
use crate::{Error, Result, files};

/// Runs the lines of a script, then writes the meshes that they have made.
///
/// # Errors
/// Returns the error of the first line that fails, with the number of the line. Then no mesh is
/// written.
pub(crate) fn run_script(path: &Path, progress: &mut dyn Progress) -> Result<Answer> {
    let mut workbench = Workbench::default();
    let (mut texts, mut reports) = (Vec::new(), Vec::new());
    let text = read_text(path)?;
    for (line, number) in text.lines().zip(1..).filter(|(line, _)| is_command(line)) {
        let start = Instant::now();
        let (answer, patch) = run_line(&mut workbench, line, progress).map_err(|error| {
            let place = format!("{}:{number}: {}", path.display(), error.cause().place);
            error.with_place(place)
        })?;
        texts.push(format!("{number}: {}", line.trim()));
        texts.extend(Some(answer.text).filter(|text| !text.is_empty()));
        texts.extend(answer.files.iter().map(|file| format!("wrote {file}")));
        reports.push(json!({
            "line": number,
            "command": line.trim(),
            "report": answer.json,
            "change": patch.map(|patch| patch.to_json()),
            "seconds": start.elapsed().as_secs_f64(),
        }));
    }
    workbench.write_meshes()?;
    let files = workbench.mesh_names().into_iter().map(path_text).collect();
    Ok(Answer {
        text: texts.join("\n"),
        json: json!({ "lines": Value::Array(reports), "files": files }),
        files,
        ..Answer::default()
    })
}

/// Runs a line of a script in a session. Returns the answer, and what changed if the line makes a mesh.
///
/// # Errors
/// Returns [`Error::Job`] for a line that is no command or cannot be in a script, and the errors of
/// its verb.
pub fn run_line(
    workbench: &mut Workbench,
    line: &str,
    progress: &mut dyn Progress,
) -> Result<(Answer, Option<MeshPatch>)> {
    let mut verb = parse_line(line)?;
    let job = match &verb {
        Verb::Mesh(args) => Some(MeshJob::new(args, 1)?),
        _ => None,
    };
    let files = match &job {
        Some(job) => Some((job.image.clone(), output_path(&job.image, &job.spec))),
        None => mesh_files(&mut verb).map(|(input, output)| (input.clone(), output.clone())),
    };
    let Some((input, output)) = files else {
        let (answer, checked) = workbench.query(progress, |session| run_session(&verb, session))?;
        checked?;
        return Ok((answer, None));
    };
    let action = Action {
        line,
        input: &input,
        output: &output,
    };
    let reply = workbench.act(action, progress, |session, kept| match job {
        Some(job) => job.run_with_output(kept, session),
        None => {
            if let Some((_, output)) = mesh_files(&mut verb) {
                *output = kept.into();
            }
            Ok(run_session(&verb, session)?.0)
        }
    })?;
    Ok((reply.answer, Some(reply.patch)))
}

/// Runs `work` with a progress that is printed on standard error, as that of a mesh job is.
pub fn with_console<T>(work: impl FnOnce(&mut dyn Progress) -> T) -> T {
    let common = CommonOptions {
        quiet: false,
        json: false,
        threads: None,
        max_memory: None,
    };
    let interrupts = Interrupts::default();
    work(&mut Console::new(&common, true).job_progress(&interrupts, true))
}

/// Returns the input and the output of a verb that makes a mesh of a mesh; `None` for others.
fn mesh_files(verb: &mut Verb) -> Option<(&PathBuf, &mut PathBuf)> {
    Some(match verb {
        Verb::Edit(args) => (&args.mesh, &mut args.output),
        Verb::Paint(args) => (&args.mesh, &mut args.output),
        Verb::Segment(args) => (&args.mesh, &mut args.output),
        Verb::Flow(args) => (&args.mesh, &mut args.output),
        Verb::Columns(args) => (&args.map, &mut args.output),
        _ => return None,
    })
}

/// Returns the verb of a line.
fn parse_line(line: &str) -> Result<Verb> {
    let refuse = |problem: &str, remedy: &str| Err(Error::Job(cause(line.trim(), problem, remedy)));
    let words = split_words(line)?;
    let program = std::iter::once("atomesh".to_string());
    let parsed = CommandLine::try_parse_from(program.chain(words));
    let CommandLine { common, verb } = match parsed {
        Ok(parsed) => parsed,
        Err(error) => {
            if let Some(error) = value_error(&error) {
                return Err(error);
            }
            let text = error.to_string();
            let problem = text.lines().next().unwrap_or_default();
            let problem = problem.trim_start_matches("error: ");
            return refuse(problem, "atomesh --help shows the verbs and their options");
        }
    };
    if common.quiet || common.json || common.threads.is_some() || common.max_memory.is_some() {
        let problem = "has an option that counts for the whole script";
        return refuse(problem, "give it after atomesh script");
    }
    let is_refused = match &verb {
        Verb::Mesh(args) => args.print_config,
        Verb::Script(_) | Verb::Doctor | Verb::Completions(_) | Verb::Man(_) => true,
        _ => false,
    };
    if is_refused {
        let problem = "works on no mesh or image";
        return refuse(problem, "remove the line");
    }
    Ok(verb)
}

/// Returns `true` if a line is neither empty nor a comment.
fn is_command(line: &str) -> bool {
    !matches!(line.trim_start().chars().next(), None | Some('#'))
}

/// Splits a line at blanks outside of quotation marks, which are left out.
fn split_words(line: &str) -> Result<Vec<String>> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match quote {
            Some(mark) if c == mark => quote = None,
            None if c == '\'' || c == '"' => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            None if c.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(c),
        }
    }
    if let Some(mark) = quote {
        let problem = format!("has no {mark} at the end of a quotation");
        return Err(Error::Job(cause(
            line.trim(),
            problem,
            "add the quotation mark",
        )));
    }
    words.extend(word);
    Ok(words)
}

/// Reads a script.
fn read_text(path: &Path) -> Result<String> {
    let bytes = files::read(path, "give a text file of commands")?;
    String::from_utf8(bytes).map_err(|error| {
        let problem = "is not a text in UTF-8";
        let cause = cause(path.display(), problem, "save it as UTF-8").with_source(error);
        Error::Job(cause)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_split_at_blanks_outside_of_quotation_marks() {
        let line = "mesh 'my survey.sgy'  -o\t\"it's\".vtu ''";
        assert_eq!(
            split_words(line).unwrap(),
            ["mesh", "my survey.sgy", "-o", "it's.vtu", ""]
        );
        let error = split_words("mesh 'a").unwrap_err().to_string();
        assert!(error.contains("has no ' at the end"), "{error}");
    }

    #[test]
    fn lines_that_are_no_commands_of_a_script_are_refused() {
        for (line, expected) in [
            ("meshes a.npy", "unrecognized subcommand 'meshes'"),
            (
                "mesh a.npy --distances 3",
                "unexpected argument '--distances'",
            ),
            ("mesh a.npy --distance x", "--distance x: "),
            ("mesh a.npy --threads 1", "counts for the whole script"),
            ("script a.txt", "works on no mesh"),
        ] {
            let error = parse_line(line).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(["", "  # text"].iter().all(|line| !is_command(line)));
    }
}
