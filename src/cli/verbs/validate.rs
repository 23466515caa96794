//! `atomesh validate`: our own checker, TetGen and CGAL; which of them passed.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::cli::common::output::path_text;
use crate::cli::console::Console;
use crate::error::cause;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::delaunay;
use crate::mesh::{Mesh, Simplices, TetMesh, TriMesh};
use crate::store::{AnyMesh, StoredMesh};
use crate::{Error, Result};

/// `atomesh validate`.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
}

/// Runs the verb: an error if the mesh is not valid, so that scripts see it.
pub fn validate(args: &ValidateArgs, console: &mut Console) -> Result<()> {
    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let mesh = console.read_mesh(&args.mesh)?;
    console.begin_stage("checking");
    // The second opinions differ by kind: who knows cells of that kind is asked.
    let verdicts = match mesh {
        AnyMesh::Triangles(file) => {
            let stored = StoredMesh::new(file, &place)?;
            with_other_checkers(atomesh_verdict(&stored), || {
                Ok(vec![spade_verdict(
                    &stored.lattice,
                    stored.space.tolerance(),
                )?])
            })
        }
        AnyMesh::Tetrahedra(file) => {
            let mut stored = StoredMesh::new(file, &place)?;
            with_other_checkers(atomesh_verdict(&stored), || {
                let tolerance = stored.space.tolerance();
                let mut verdicts = Vec::new();
                if cfg!(feature = "tetgen") {
                    verdicts.push(tetgen_verdict(&stored.lattice, tolerance)?);
                }
                if cfg!(feature = "cgal") {
                    verdicts.push(stored.with_world_mesh(|mesh| cgal_verdict(mesh, tolerance))?);
                }
                Ok(verdicts)
            })
        }
        AnyMesh::Polygons(file) => Ok(vec![atomesh_verdict(&StoredMesh::new(file, &place)?)]),
        AnyMesh::Polyhedra(file) => Ok(vec![atomesh_verdict(&StoredMesh::new(file, &place)?)]),
    }?;
    let lines: Vec<String> = verdicts.iter().map(CheckerVerdict::summary_line).collect();
    let failed = verdicts
        .iter()
        .find_map(|v| Some((v.checker, v.problem.clone()?)));
    console.result(
        lines.join("\n"),
        &json!({ "file": path_text(&args.mesh), "valid": failed.is_none(), "checks": verdicts }),
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

/// What the others say as well. They are not asked about a mesh in which our own checker finds a fault:
/// TetGen takes the process down with it when nodes make no sense.
fn with_other_checkers(
    own: CheckerVerdict,
    others: impl FnOnce() -> Result<Vec<CheckerVerdict>>,
) -> Result<Vec<CheckerVerdict>> {
    let mut verdicts = vec![own];
    if verdicts[0].problem.is_none() {
        verdicts.extend(others()?);
    }
    Ok(verdicts)
}

/// Our own checker, in lattice space, where the sides are known.
fn atomesh_verdict<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> CheckerVerdict {
    let known = CheckHints {
        weld: stored.weld,
        ..CheckHints::default()
    };
    let (low, high) = ([0.0; D], stored.space.extent);
    let found = check_with_hints(&stored.lattice, known, low, high, stored.space.tolerance());
    let what = match &found.cell_check {
        None => format!(
            "{} {} of positive {}, conforming, fill the box ({} off by {:.0e}), sides flat, all {} \
             nodes used",
            found.cells,
            M::CELLS_NAME,
            M::VOLUME_NAME,
            M::VOLUME_NAME,
            found.volume_error,
            found.nodes
        ),
        Some(of_cells) => {
            let [faces, space] = match of_cells.is_columnar {
                true => [
                    "faces, the vertical ones flat,",
                    "what lies between top and base",
                ],
                false => ["flat faces", "the box"],
            };
            format!(
                "{} closed cells with their atoms inside, {} {faces} between two cells or on a side, \
                 fill {space} (off by {:.0e})",
                found.cells, of_cells.faces, found.volume_error
            )
        }
    };
    CheckerVerdict {
        checker: "atomesh",
        criterion: what,
        problem: found.problems.first().cloned(),
    }
}

/// TetGen cannot read a mesh without changing it, so it is asked for the convex hull of the nodes:
/// the mesh must fill it.
fn tetgen_verdict(mesh: &TetMesh, tolerance: f64) -> Result<CheckerVerdict> {
    let hull = delaunay::delaunay(&mesh.nodes)?;
    Ok(hull_verdict("TetGen", mesh, &hull, tolerance))
}

/// The same in the plane by spade.
fn spade_verdict(mesh: &TriMesh, tolerance: f64) -> Result<CheckerVerdict> {
    let hull = delaunay::delaunay_plane(&mesh.nodes)?;
    Ok(hull_verdict("spade", mesh, &hull, tolerance))
}

/// Whether a mesh fills the convex hull of its nodes, of which another triangulation is given.
fn hull_verdict<const D: usize, M: Simplices<D>>(
    by: &'static str,
    mesh: &M,
    hull: &M,
    tolerance: f64,
) -> CheckerVerdict {
    let volume = |mesh: &M| -> f64 { (0..mesh.len()).map(|c| mesh.volume(c)).sum() };
    let error = (volume(mesh) - volume(hull)).abs() / volume(hull);
    let name = M::VOLUME_NAME;
    CheckerVerdict {
        checker: by,
        criterion: format!("fills the convex hull of its nodes ({name} off by {error:.0e})"),
        problem: (error > tolerance)
            .then(|| format!("its {name} differs from that of its nodes' hull by {error:.1e}")),
    }
}

/// CGAL's exact predicates, on the coordinates as they are in the file.
fn cgal_verdict(mesh: &TetMesh, tolerance: f64) -> Result<CheckerVerdict> {
    let TetMesh { nodes, tets } = mesh;
    let verdict = delaunay::cgal::validate(nodes, tets)?;
    Ok(CheckerVerdict {
        checker: "CGAL",
        criterion: "a triangulation of the convex hull of its nodes, by exact predicates".into(),
        problem: verdict.faults(tolerance).into_iter().next(),
    })
}

/// What one checker says.
#[derive(Debug, Serialize)]
struct CheckerVerdict {
    /// Who checked.
    checker: &'static str,
    /// What holds if nothing is wrong.
    criterion: String,
    /// What is wrong, if anything.
    problem: Option<String>,
}

impl CheckerVerdict {
    fn summary_line(&self) -> String {
        match &self.problem {
            None => format!("{:8} passed: {}", self.checker, self.criterion),
            Some(problem) => format!("{:8} FAILED: {problem}", self.checker),
        }
    }
}
