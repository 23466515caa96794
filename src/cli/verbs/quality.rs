//! The verb `quality`: measures the quality and the fidelity of a mesh.

use std::path::PathBuf;

use clap::Args;

use crate::cli::common::output::check_output;
use crate::cli::console::Console;
use crate::error::cause;
use crate::image::Modality;
use crate::image::synth::Truth;
use crate::job::{cells, scaled_mesh};
use crate::mesh::Simplices;
use crate::mesh::check::{CheckHints, check, check_with_hints};
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::progress::CancelToken;
use crate::report::angles::mean_edge_lengths;
use crate::report::{self, AngleAssessment, Quality, Reference, Report};
use crate::store::output::DISTANCE_ARRAY;
use crate::store::{LatticeSpace, StoredMesh, with_mesh, write_lines};
use crate::{Error, Result};

/// Arguments of `atomesh quality`.
#[derive(Debug, Args)]
pub struct QualityArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The exact distance to the features, as `synth --truth` writes it
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
    /// Also write the lines where features, or a feature and a side of the box, meet at less than
    /// 30 degrees, with their angles
    #[arg(long, value_name = "LINES.vtp")]
    pub lines: Option<PathBuf>,
}

/// Runs the verb.
pub fn quality(args: &QualityArgs, console: &mut Console) -> Result<()> {
    if let Some(path) = &args.lines {
        let mut inputs = vec![args.mesh.as_path()];
        inputs.extend(args.truth.as_deref());
        check_output(path, "--lines", &["vtp"], &inputs)?;
    }
    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let file = console.read_mesh(&args.mesh)?;
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
    let report = figures(&mut stored, truth)?;
    if let Some(path) = &args.lines {
        let place = |n: u32| stored.world.nodes[n as usize];
        let angles = report.quality.as_ref().and_then(|q| q.angles.as_ref());
        write_lines(path, angles.map_or(&[], |a| &a.acute_lines), place)?;
    }
    show(report, stored.space.is_stored, console);
    Ok(())
}

/// Returns the figures of tetrahedra or triangles, compared with the truth if it is known.
pub(super) fn figures<const D: usize, M: Simplices<D>>(
    stored: &mut StoredMesh<D, M>,
    truth: Option<(Truth<D>, String)>,
) -> Result<Report> {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let assessment = explained_angles(stored);
    let mut report = Report {
        quality: Some(Quality {
            angles: Some(assessment.angles),
            ..report::quality(mesh)
        }),
        box_check: Some(check(mesh, [0.0; D], space.extent, space.tolerance())),
        ..Report::default()
    };
    if let Some((truth, note)) = &truth {
        let in_samples = scaled_mesh(mesh, space.step.map(|s| 1.0 / s));
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(report::fidelity(
            &*in_samples,
            &reference,
            stored.feature_faces.as_deref(),
        )?);
        report.notes.push(note.clone());
    }
    report.used_in_physical_space = space.geometry.modality() != Modality::Survey;
    if !space.geometry.preserves_shapes(space.step) && space.geometry.has_uniform_units() {
        report.quality_physical = Some(stored.with_world_mesh(report::quality));
    }
    Ok(report)
}

/// Returns which angles the features explain. If the mesh does not record its nominal distance, its
/// mean edge lengths replace it.
fn explained_angles<const D: usize, M: Simplices<D>>(stored: &StoredMesh<D, M>) -> AngleAssessment {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let arrays = &stored.arrays.point_data;
    let array = arrays.iter().find(|array| array.name == DISTANCE_ARRAY);
    let values = array.map(|array| array.values.to_f64());
    let distance = values
        .filter(|d| d.len() == mesh.nodes().len() && d.iter().all(|d| *d > 0.0))
        .unwrap_or_else(|| mean_edge_lengths(mesh));
    let faces = stored.feature_faces.as_deref().unwrap_or_default();
    report::assess_angles(mesh, faces, space.extent, |n| distance[n as usize])
}

/// Measures polyhedra or polygons and prints their figures.
fn measure_cells<const D: usize>(
    args: &QualityArgs,
    mut stored: StoredMesh<D, PolyMesh<D>>,
    console: &mut Console,
) -> Result<()> {
    if let Some(path) = &args.lines {
        let place = format!("--lines {}", path.display());
        let problem = format!(
            "{} holds Voronoi cells, which have no such angles",
            args.mesh.display()
        );
        let remedy = "give a mesh of tetrahedra or triangles, or omit it";
        return Err(Error::Job(cause(place, problem, remedy)));
    }
    let truth = read_truth(args, &stored.space)?;
    console.begin_stage("measuring the mesh");
    let report = cell_figures(&mut stored, truth);
    show(report, stored.space.is_stored, console);
    Ok(())
}

/// Returns the figures of polyhedra or polygons, compared with the truth if it is known.
pub(super) fn cell_figures<const D: usize>(
    stored: &mut StoredMesh<D, PolyMesh<D>>,
    truth: Option<(Truth<D>, String)>,
) -> Report {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let hints = CheckHints {
        weld: stored.weld,
        ..CheckHints::default()
    };
    let cell_check = check_with_hints(mesh, hints, [0.0; D], space.extent, space.tolerance());
    let graph = Graph::from_poly(mesh);
    let mut report = Report::default();
    if let Some((truth, note)) = &truth {
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(cells::cell_fidelity(
            mesh,
            space.step,
            &reference,
            &CancelToken::never(),
        ));
        report.notes.push(note.clone());
    }
    let physical = stored.with_world_mesh(Graph::from_poly);
    let measured = report::measure_voronoi(cell_check, &graph, &physical);
    let has_angles = stored.space.geometry.has_uniform_units();
    report.voronoi = Some(report::Voronoi {
        angle_physical: measured.angle_physical.filter(|_| has_angles),
        ..measured
    });
    report
}

fn show(mut report: Report, has_lattice_space: bool, console: &mut Console) {
    if !has_lattice_space {
        report
            .notes
            .push("the file does not record its lattice space: measured in physical space".into());
    }
    console.result(report.table().trim_end(), &report.to_json());
}

/// Reads the truth about a mesh's features, if it is given. Returns it with a line that describes
/// it.
fn read_truth<const D: usize>(
    args: &QualityArgs,
    space: &LatticeSpace<D>,
) -> Result<Option<(Truth<D>, String)>> {
    let Some(path) = &args.truth else {
        return Ok(None);
    };
    let (truth, note) = Truth::read(path)?;
    if !space.fits_dims(truth.dims) {
        let problem = format!(
            "has dimensions {:?}, the mesh {:?}",
            truth.dims,
            space.dims()
        );
        let remedy = match &space.velocities {
            None => "give the truth of the image that was meshed".to_string(),
            Some(velocities) => format!(
                "give the truth in depth, as the mesh is: atomesh convert --velocity {velocities} --geometry-from IMAGE {0} depth.npy",
                path.display()
            ),
        };
        return Err(Error::Mesh(cause(path.display(), problem, remedy)));
    }
    Ok(Some((truth, format!("{}: {note}", path.display()))))
}
