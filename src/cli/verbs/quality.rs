//! `atomesh quality`: quality and fidelity figures of a mesh.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::console::Console;
use crate::error::cause;
use crate::image::synth::Truth;
use crate::job::{BOX_TOLERANCE, cells, scaled};
use crate::mesh::check::check;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::report::{self, Measured, Reference, Report};
use crate::store::file::Placed;
use crate::store::{AnyMesh, read_any_vtu};
use crate::{Error, Result};

/// `atomesh quality`.
#[derive(Debug, Args)]
pub struct QualityArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Exact distance to the features, as `synth --truth` writes it
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
}

/// Runs the verb.
pub fn quality(args: &QualityArgs, console: &mut Console) -> Result<()> {
    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    match read_any_vtu(&args.mesh)? {
        AnyMesh::Plane(file) => measure(args, &Placed::new(file, &place)?, console),
        AnyMesh::Space(file) => measure(args, &Placed::new(file, &place)?, console),
        AnyMesh::PlaneCells(file) => measure_cells(args, &Placed::cells(file, &place)?, console),
        AnyMesh::SpaceCells(file) => measure_cells(args, &Placed::cells(file, &place)?, console),
    }
}

fn measure<const D: usize, M: Measured<D>>(
    args: &QualityArgs,
    placed: &Placed<D, M>,
    console: &mut Console,
) -> Result<()> {
    let truth = args
        .truth
        .as_deref()
        .map(|path| read_truth(path, placed))
        .transpose()?;
    console.begin_stage("measuring the mesh");
    let mut report = Report {
        quality: Some(report::quality(&placed.lattice)),
        filling: Some(check(
            &placed.lattice,
            [0.0; D],
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
    show(report, placed.by_file, console);
    Ok(())
}

/// The same for polyhedra or polygons.
fn measure_cells<const D: usize>(
    args: &QualityArgs,
    placed: &Placed<D, PolyMesh<D>>,
    console: &mut Console,
) -> Result<()> {
    let truth = args
        .truth
        .as_deref()
        .map(|path| read_truth(path, placed))
        .transpose()?;
    console.begin_stage("measuring the mesh");
    let (graph, physical) = (
        Graph::from_poly(&placed.lattice),
        Graph::from_poly(&placed.physical),
    );
    let voronoi = report::voronoi(
        &placed.lattice,
        &graph,
        &physical,
        placed.extent,
        BOX_TOLERANCE,
        placed.weld,
    );
    let mut report = Report {
        voronoi: Some(voronoi),
        ..Report::default()
    };
    if let (Some((truth, note)), Some(path)) = (&truth, &args.truth) {
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(cells::fidelity(&placed.lattice, placed.step, &reference));
        report.notes.push(format!("{}: {note}", path.display()));
    }
    show(report, placed.by_file, console);
    Ok(())
}

fn show(mut report: Report, placed_by_file: bool, console: &mut Console) {
    if !placed_by_file {
        report.notes.push(
            "the file does not say where its lattice space is: measured in its own space".into(),
        );
    }
    console.result(
        report.table().trim_end(),
        &serde_json::to_value(&report).unwrap_or_default(),
    );
}

/// Reads the truth about a mesh's features, with a line that says what it is.
fn read_truth<const D: usize, M>(path: &Path, placed: &Placed<D, M>) -> Result<(Truth<D>, String)> {
    let (truth, note) = Truth::read(path)?;
    let dims: [f64; D] = std::array::from_fn(|k| placed.extent[k] / placed.step[k] + 1.0);
    if (0..D).any(|k| (truth.dims[k] as f64 - dims[k]).abs() > 1e-6) {
        return Err(Error::Mesh(cause(
            path.display(),
            format!("is of {:?} samples, the mesh of {dims:?}", truth.dims),
            "give the truth of the image that was meshed",
        )));
    }
    Ok((truth, note))
}
