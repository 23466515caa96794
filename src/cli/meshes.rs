//! The verbs about meshes: `quality` and `validate`.

use std::path::Path;

use serde::Serialize;
use serde_json::json;

use super::args::{QualityArgs, ValidateArgs};
use super::console::Console;
use crate::error::cause;
use crate::export::{FieldValue, read_vtu};
use crate::io::vtk::DataArray;
use crate::mesh::check::check;
use crate::mesh::{TetMesh, volume6};
use crate::pipeline::file::{Placed, bounds};
use crate::pipeline::{BOX_TOLERANCE, scaled};
use crate::report::{self, Reference, Report};
use crate::synth::Truth;
use crate::{Error, Result, delaunay};

/// `atomesh info` of a mesh.
pub fn info(path: &Path, console: &mut Console) -> Result<()> {
    let file = read_vtu(path)?;
    let (low, high) = bounds(&file.mesh.nodes);
    let names = |arrays: &[DataArray]| -> Vec<String> {
        arrays.iter().map(|array| array.name.clone()).collect()
    };
    let (points, cells) = (names(&file.point_data), names(&file.cell_data));
    let [nodes, tets] = [file.mesh.nodes.len(), file.mesh.tets.len()];
    let mut lines = vec![
        format!("file        {}", path.display()),
        "format      VTK unstructured grid".to_string(),
        format!("mesh        {nodes} nodes, {tets} tetrahedra"),
        format!("from        {low:?}"),
        format!("to          {high:?}"),
        format!("point data  {}", points.join(", ")),
        format!("cell data   {}", cells.join(", ")),
    ];
    let mut fields = serde_json::Map::new();
    for (name, value) in &file.field_data {
        let value = match value {
            FieldValue::Text(text) => json!(text),
            FieldValue::F64s(values) => json!(values),
            FieldValue::Ints(values) => json!(values),
        };
        let shown = value
            .as_str()
            .map_or_else(|| value.to_string(), |s| s.trim().replace('\n', ", "));
        lines.push(format!("{name}: {shown}"));
        fields.insert(name.clone(), value);
    }
    console.result(
        lines.join("\n"),
        &json!({
            "file": path, "format": "VTK unstructured grid", "nodes": nodes, "tetrahedra": tets,
            "from": low, "to": high, "point_data": points, "cell_data": cells, "fields": fields,
        }),
    );
    Ok(())
}

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
        report.fidelity = Some(report::fidelity(
            &*in_samples,
            &reference,
            placed.feature_faces.as_deref(),
        )?);
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
    let mut verdicts = vec![by_atomesh(&placed)];
    if cfg!(feature = "tetgen") {
        verdicts.push(by_tetgen(&placed)?);
    }
    if cfg!(feature = "cgal") {
        verdicts.push(by_cgal(&placed)?);
    }
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

/// Our own checker, in lattice space, where the sides are known.
fn by_atomesh(placed: &Placed) -> Verdict {
    let found = check(&placed.lattice, [0.0; 3], placed.extent, BOX_TOLERANCE);
    Verdict {
        by: "atomesh",
        what: format!(
            "{} tetrahedra of positive volume, conforming, fill the box (volume off by {:.0e}), \
             sides flat, all {} nodes used",
            found.cells, found.volume_error, found.nodes
        ),
        problem: found.problems.first().cloned(),
    }
}

/// TetGen cannot read a mesh without changing it, so it is asked for the convex hull of the nodes:
/// the mesh must fill it.
fn by_tetgen(placed: &Placed) -> Result<Verdict> {
    let volume = |mesh: &TetMesh| -> f64 {
        (0..mesh.tets.len())
            .map(|t| volume6(&mesh.corners(t)) / 6.0)
            .sum()
    };
    let hull = volume(&delaunay::delaunay(&placed.lattice.nodes)?);
    let error = (volume(&placed.lattice) - hull).abs() / hull;
    Ok(Verdict {
        by: "TetGen",
        what: format!("fills the convex hull of its nodes (volume off by {error:.0e})"),
        problem: (error > BOX_TOLERANCE)
            .then(|| format!("its volume is off that of its nodes' hull by {error:.1e}")),
    })
}

/// CGAL's exact predicates, on the coordinates as they are in the file.
fn by_cgal(placed: &Placed) -> Result<Verdict> {
    let TetMesh { nodes, tets } = &placed.physical;
    let verdict = delaunay::cgal::validate(nodes, tets)?;
    Ok(Verdict {
        by: "CGAL",
        what: "by exact predicates a triangulation of the convex hull of its nodes".into(),
        problem: verdict.faults(BOX_TOLERANCE).into_iter().next(),
    })
}

/// What one checker says.
#[derive(Debug, Serialize)]
struct Verdict {
    /// Who checked.
    by: &'static str,
    /// What holds if nothing is wrong.
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
