//! The verbs about meshes: `quality` and `validate`.

use std::path::Path;

use serde::Serialize;
use serde_json::json;

use crate::cli::args::{QualityArgs, ValidateArgs};
use crate::cli::console::Console;
use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::image::synth::Truth;
use crate::job::{BOX_TOLERANCE, cells, scaled};
use crate::mesh::check::check;
use crate::mesh::delaunay;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::mesh::poly_check::check_welded;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::report::{self, Measured, Reference, Report};
use crate::store::file::{Placed, bounds};
use crate::store::{AnyMesh, FieldValue, MeshFile, read_any_vtu};
use crate::{Error, Result};

/// `atomesh info` of a mesh.
pub fn info(path: &Path, console: &mut Console) -> Result<()> {
    match read_any_vtu(path)? {
        AnyMesh::Plane(file) => simplices(path, &file, console),
        AnyMesh::Space(file) => simplices(path, &file, console),
        AnyMesh::PlaneCells(file) => {
            let mesh = &file.mesh;
            describe(
                path,
                &file,
                &mesh.nodes,
                mesh.sites.len(),
                "polygons",
                console,
            );
        }
        AnyMesh::SpaceCells(file) => {
            let mesh = &file.mesh;
            describe(
                path,
                &file,
                &mesh.nodes,
                mesh.sites.len(),
                "polyhedra",
                console,
            );
        }
    }
    Ok(())
}

fn simplices<const D: usize, M: Simplices<D>>(
    path: &Path,
    file: &MeshFile<M>,
    console: &mut Console,
) {
    describe(
        path,
        file,
        file.mesh.nodes(),
        file.mesh.len(),
        M::CELLS,
        console,
    );
}

fn describe<const D: usize, M>(
    path: &Path,
    file: &MeshFile<M>,
    nodes: &[[f64; D]],
    cells: usize,
    kind: &str,
    console: &mut Console,
) {
    let (low, high) = bounds(nodes);
    let names = |arrays: &[DataArray]| -> Vec<String> {
        arrays.iter().map(|array| array.name.clone()).collect()
    };
    let (points, arrays) = (names(&file.point_data), names(&file.cell_data));
    let nodes = nodes.len();
    let mut lines = vec![
        format!("file        {}", path.display()),
        "format      VTK unstructured grid".to_string(),
        format!("mesh        {nodes} nodes, {cells} {kind}"),
        format!("from        {low:?}"),
        format!("to          {high:?}"),
        format!("point data  {}", points.join(", ")),
        format!("cell data   {}", arrays.join(", ")),
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
            "file": path, "format": "VTK unstructured grid", "nodes": nodes, kind: cells,
            "from": low.to_vec(), "to": high.to_vec(), "point_data": points, "cell_data": arrays,
            "fields": fields,
        }),
    );
}

/// `atomesh quality`.
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

/// `atomesh validate`: an error if the mesh is not valid, so that scripts see it.
pub fn validate(args: &ValidateArgs, console: &mut Console) -> Result<()> {
    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let mesh = read_any_vtu(&args.mesh)?;
    console.begin_stage("checking");
    let mut verdicts = Vec::new();
    match mesh {
        AnyMesh::Plane(file) => {
            let placed = Placed::new(file, &place)?;
            verdicts.push(by_atomesh(&placed));
            verdicts.push(by_spade(&placed)?);
        }
        AnyMesh::Space(file) => {
            let placed = Placed::new(file, &place)?;
            verdicts.push(by_atomesh(&placed));
            if cfg!(feature = "tetgen") {
                verdicts.push(by_tetgen(&placed)?);
            }
            if cfg!(feature = "cgal") {
                verdicts.push(by_cgal(&placed)?);
            }
        }
        AnyMesh::PlaneCells(file) => verdicts.push(cells_by_atomesh(&Placed::cells(file, &place)?)),
        AnyMesh::SpaceCells(file) => verdicts.push(cells_by_atomesh(&Placed::cells(file, &place)?)),
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
fn by_atomesh<const D: usize, M: Measured<D>>(placed: &Placed<D, M>) -> Verdict {
    let found = check(&placed.lattice, [0.0; D], placed.extent, BOX_TOLERANCE);
    Verdict {
        by: "atomesh",
        what: format!(
            "{} {} of positive {}, conforming, fill the box ({} off by {:.0e}), sides flat, all {} \
             nodes used",
            found.cells,
            M::CELLS,
            M::VOLUME,
            M::VOLUME,
            found.volume_error,
            found.nodes
        ),
        problem: found.problems.first().cloned(),
    }
}

/// The same for polyhedra and polygons, of which TetGen and CGAL have no notion.
fn cells_by_atomesh<const D: usize>(placed: &Placed<D, PolyMesh<D>>) -> Verdict {
    let found = check_welded(
        &placed.lattice,
        [0.0; D],
        placed.extent,
        BOX_TOLERANCE,
        placed.weld,
    );
    let [faces, space] = match found.in_columns {
        true => [
            "faces, the upright ones flat,",
            "what lies between top and base",
        ],
        false => ["flat faces", "the box"],
    };
    Verdict {
        by: "atomesh",
        what: format!(
            "{} closed cells with their atoms inside, {} {faces} between two cells or on a side, \
             fill {space} (off by {:.0e})",
            found.cells, found.faces, found.volume_error
        ),
        problem: found.problems.first().cloned(),
    }
}

/// TetGen cannot read a mesh without changing it, so it is asked for the convex hull of the nodes:
/// the mesh must fill it.
fn by_tetgen(placed: &Placed) -> Result<Verdict> {
    let hull = delaunay::delaunay(&placed.lattice.nodes)?;
    Ok(by_hull("TetGen", &placed.lattice, &hull))
}

/// The same in the plane by spade.
fn by_spade(placed: &Placed<2, TriMesh>) -> Result<Verdict> {
    let hull = delaunay::delaunay_plane(&placed.lattice.nodes)?;
    Ok(by_hull("spade", &placed.lattice, &hull))
}

/// Whether a mesh fills the convex hull of its nodes, of which another triangulation is given.
fn by_hull<const D: usize, M: Measured<D>>(by: &'static str, mesh: &M, hull: &M) -> Verdict {
    let volume = |mesh: &M| -> f64 { (0..mesh.len()).map(|c| mesh.volume(c)).sum() };
    let error = (volume(mesh) - volume(hull)).abs() / volume(hull);
    let name = M::VOLUME;
    Verdict {
        by,
        what: format!("fills the convex hull of its nodes ({name} off by {error:.0e})"),
        problem: (error > BOX_TOLERANCE)
            .then(|| format!("its {name} is off that of its nodes' hull by {error:.1e}")),
    }
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
