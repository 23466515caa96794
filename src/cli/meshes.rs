//! The verbs about meshes: `quality` and `validate`.

use std::path::Path;

use serde::Serialize;
use serde_json::json;

use super::args::{QualityArgs, ValidateArgs};
use super::console::Console;
use crate::error::cause;
use crate::export::read_vtu;
use crate::mesh::check::check;
use crate::pipeline::file::Placed;
use crate::pipeline::{BOX_TOLERANCE, scaled};
use crate::report::{self, Reference, Report};
use crate::synth::Truth;
use crate::{Error, Result};

/// `atomesh quality`.
pub fn quality(args: &QualityArgs, console: &mut Console) -> Result<()> {
    console.begin_stage("reading");
    let placed = read(&args.mesh)?;
    let truth = args
        .truth
        .as_deref()
        .map(|path| read_truth(path, &placed))
        .transpose()?;
    console.begin_stage("measuring the mesh");
    let mut report = Report {
        quality: Some(report::quality(&placed.lattice)),
        filling: Some(check(
            &placed.lattice,
            [0.0; 3],
            placed.extent,
            BOX_TOLERANCE,
        )),
        ..Report::default()
    };
    if !placed.geometry.has_shape_of(placed.step) {
        report.quality_physical = Some(report::quality(&placed.physical));
    }
    if let (Some((truth, note)), Some(path)) = (&truth, &args.truth) {
        let in_samples = scaled(&placed.lattice, placed.step.map(|s| 1.0 / s));
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(report::fidelity(&in_samples, &reference, None)?);
        report.notes.push(format!("{}: {note}", path.display()));
    }
    if !placed.by_file {
        report.notes.push(
            "the file does not say where its lattice space is: measured in its own space".into(),
        );
    }
    console.result(
        report.table().trim_end(),
        &serde_json::to_value(&report).unwrap_or_default(),
    );
    Ok(())
}

/// `atomesh validate`: an error if the mesh is not valid, so that scripts see it.
pub fn validate(args: &ValidateArgs, console: &mut Console) -> Result<()> {
    console.begin_stage("reading");
    let placed = read(&args.mesh)?;
    console.begin_stage("checking");
    let found = check(&placed.lattice, [0.0; 3], placed.extent, BOX_TOLERANCE);
    let verdicts = vec![Verdict {
        by: "atomesh",
        what: format!(
            "{} tetrahedra of positive volume, conforming, fill the box (volume off by {:.0e}), \
             sides flat, all {} nodes used",
            found.tets, found.volume_error, found.nodes
        ),
        problem: found.problems.first().cloned(),
    }];
    let lines: Vec<String> = verdicts.iter().map(Verdict::line).collect();
    let failed = verdicts
        .iter()
        .find_map(|v| Some((v.by, v.problem.clone()?)));
    console.result(
        lines.join("\n"),
        &json!({ "file": args.mesh, "valid": failed.is_none(), "checks": verdicts }),
    );
    match failed {
        None => Ok(()),
        Some((by, problem)) => Err(Error::Mesh(cause(
            args.mesh.display(),
            format!("{by} finds it invalid: {problem}"),
            "mesh the image again",
        ))),
    }
}

/// What one checker says.
#[derive(Debug, Serialize)]
struct Verdict {
    /// Who checked.
    by: &'static str,
    /// What was checked.
    what: String,
    /// What is wrong, if anything.
    problem: Option<String>,
}

impl Verdict {
    fn line(&self) -> String {
        match &self.problem {
            None => format!("{:8} passed: {}", self.by, self.what),
            Some(problem) => format!("{:8} FAILED: {problem}", self.by),
        }
    }
}

/// Reads a mesh and finds its lattice space.
fn read(path: &Path) -> Result<Placed> {
    let place = path.display().to_string();
    Placed::new(read_vtu(path)?, &place)
}

/// Reads the truth about a mesh's features, with a line that says what it is.
fn read_truth(path: &Path, placed: &Placed) -> Result<(Truth, String)> {
    let (truth, note) = Truth::read(path)?;
    let dims: [f64; 3] = std::array::from_fn(|k| placed.extent[k] / placed.step[k] + 1.0);
    if (0..3).any(|k| (truth.dims[k] as f64 - dims[k]).abs() > 1e-6) {
        return Err(Error::Mesh(cause(
            path.display(),
            format!("is of {:?} samples, the mesh of {dims:?}", truth.dims),
            "give the truth of the image that was meshed",
        )));
    }
    Ok((truth, note))
}
