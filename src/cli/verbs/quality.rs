//! `atomesh quality`: quality and fidelity figures of a mesh.

use std::path::PathBuf;

use clap::Args;

use crate::cli::console::Console;
use crate::error::cause;
use crate::image::synth::Truth;
use crate::job::{BOX_TOLERANCE, cells, scaled};
use crate::mesh::Simplices;
use crate::mesh::check::{Known, check, check_known};
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::observer::Patience;
use crate::report::{self, Reference, Report};
use crate::store::{LatticeSpace, StoredMesh, read_any_vtu, with_mesh};
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
    let file = read_any_vtu(&args.mesh)?;
    with_mesh!(file,
        simplices file => measure(args, StoredMesh::new(file, &place)?, console),
        cells file => measure_cells(args, StoredMesh::new(file, &place)?, console)
    )
}

fn measure<const D: usize, M: Simplices<D>>(
    args: &QualityArgs,
    mut stored: StoredMesh<D, M>,
    console: &mut Console,
) -> Result<()> {
    let truth = read_truth(args, &stored.space)?;
    console.begin_stage("measuring the mesh");
    let (mesh, space) = (&stored.lattice, &stored.space);
    let mut report = Report {
        quality: Some(report::quality(mesh)),
        filling: Some(check(mesh, [0.0; D], space.extent, BOX_TOLERANCE)),
        ..Report::default()
    };
    if let Some((truth, note)) = &truth {
        let in_samples = scaled(mesh, space.step.map(|s| 1.0 / s));
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(report::fidelity(
            &*in_samples,
            &reference,
            stored.feature_faces.as_deref(),
        )?);
        report.notes.push(note.clone());
    }
    if !space.geometry.has_shape_of(space.step) {
        report.quality_physical = Some(stored.in_world(report::quality));
    }
    show(report, stored.space.by_file, console);
    Ok(())
}

/// The same for polyhedra or polygons.
fn measure_cells<const D: usize>(
    args: &QualityArgs,
    mut stored: StoredMesh<D, PolyMesh<D>>,
    console: &mut Console,
) -> Result<()> {
    let truth = read_truth(args, &stored.space)?;
    console.begin_stage("measuring the mesh");
    let (mesh, space) = (&stored.lattice, &stored.space);
    let known = Known {
        weld: stored.weld,
        ..Known::default()
    };
    let found = check_known(mesh, known, [0.0; D], space.extent, BOX_TOLERANCE);
    let graph = Graph::from_poly(mesh);
    let mut report = Report::default();
    if let Some((truth, note)) = &truth {
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(cells::fidelity(
            mesh,
            space.step,
            &reference,
            &Patience::endless(),
        ));
        report.notes.push(note.clone());
    }
    let physical = stored.in_world(Graph::from_poly);
    report.voronoi = Some(report::voronoi(found, &graph, &physical));
    show(report, stored.space.by_file, console);
    Ok(())
}

fn show(mut report: Report, placed_by_file: bool, console: &mut Console) {
    if !placed_by_file {
        report
            .notes
            .push("the file does not record its lattice space: measured in physical space".into());
    }
    console.result(
        report.table().trim_end(),
        &serde_json::to_value(&report).unwrap_or_default(),
    );
}

/// The truth about a mesh's features, if it is given, with a line that says what it is.
fn read_truth<const D: usize>(
    args: &QualityArgs,
    space: &LatticeSpace<D>,
) -> Result<Option<(Truth<D>, String)>> {
    let Some(path) = &args.truth else {
        return Ok(None);
    };
    let (truth, note) = Truth::read(path)?;
    if !space.holds(truth.dims) {
        let problem = format!(
            "is of {:?} samples, the mesh of {:?}",
            truth.dims,
            space.dims()
        );
        let remedy = "give the truth of the image that was meshed";
        return Err(Error::Mesh(cause(path.display(), problem, remedy)));
    }
    Ok(Some((truth, format!("{}: {note}", path.display()))))
}
