//! `atomesh validate`: our own checker, TetGen and CGAL; which of them passed.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::cli::common::output::shown;
use crate::cli::console::Console;
use crate::error::cause;
use crate::mesh::check::{Known, check_known};
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
        AnyMesh::Plane(file) => {
            let stored = StoredMesh::new(file, &place)?;
            others_too(by_atomesh(&stored), || {
                Ok(vec![by_spade(&stored.lattice, stored.space.tolerance())?])
            })
        }
        AnyMesh::Space(file) => {
            let mut stored = StoredMesh::new(file, &place)?;
            others_too(by_atomesh(&stored), || {
                let tolerance = stored.space.tolerance();
                let mut verdicts = Vec::new();
                if cfg!(feature = "tetgen") {
                    verdicts.push(by_tetgen(&stored.lattice, tolerance)?);
                }
                if cfg!(feature = "cgal") {
                    verdicts.push(stored.in_world(|mesh| by_cgal(mesh, tolerance))?);
                }
                Ok(verdicts)
            })
        }
        AnyMesh::PlaneCells(file) => Ok(vec![by_atomesh(&StoredMesh::new(file, &place)?)]),
        AnyMesh::SpaceCells(file) => Ok(vec![by_atomesh(&StoredMesh::new(file, &place)?)]),
    }?;
    let lines: Vec<String> = verdicts.iter().map(Verdict::line).collect();
    let failed = verdicts
        .iter()
        .find_map(|v| Some((v.by, v.problem.clone()?)));
    console.result(
        lines.join("\n"),
        &json!({ "file": shown(&args.mesh), "valid": failed.is_none(), "checks": verdicts }),
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
fn others_too(own: Verdict, others: impl FnOnce() -> Result<Vec<Verdict>>) -> Result<Vec<Verdict>> {
    let mut verdicts = vec![own];
    if verdicts[0].problem.is_none() {
        verdicts.extend(others()?);
    }
    Ok(verdicts)
}

/// Our own checker, in lattice space, where the sides are known.
fn by_atomesh<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Verdict {
    let known = Known {
        weld: stored.weld,
        ..Known::default()
    };
    let (low, high) = ([0.0; D], stored.space.extent);
    let found = check_known(&stored.lattice, known, low, high, stored.space.tolerance());
    let what = match &found.of_cells {
        None => format!(
            "{} {} of positive {}, conforming, fill the box ({} off by {:.0e}), sides flat, all {} \
             nodes used",
            found.cells,
            M::CELLS,
            M::VOLUME,
            M::VOLUME,
            found.volume_error,
            found.nodes
        ),
        Some(of_cells) => {
            let [faces, space] = match of_cells.in_columns {
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
    Verdict {
        by: "atomesh",
        what,
        problem: found.problems.first().cloned(),
    }
}

/// TetGen cannot read a mesh without changing it, so it is asked for the convex hull of the nodes:
/// the mesh must fill it.
fn by_tetgen(mesh: &TetMesh, tolerance: f64) -> Result<Verdict> {
    let hull = delaunay::delaunay(&mesh.nodes)?;
    Ok(by_hull("TetGen", mesh, &hull, tolerance))
}

/// The same in the plane by spade.
fn by_spade(mesh: &TriMesh, tolerance: f64) -> Result<Verdict> {
    let hull = delaunay::delaunay_plane(&mesh.nodes)?;
    Ok(by_hull("spade", mesh, &hull, tolerance))
}

/// Whether a mesh fills the convex hull of its nodes, of which another triangulation is given.
fn by_hull<const D: usize, M: Simplices<D>>(
    by: &'static str,
    mesh: &M,
    hull: &M,
    tolerance: f64,
) -> Verdict {
    let volume = |mesh: &M| -> f64 { (0..mesh.len()).map(|c| mesh.volume(c)).sum() };
    let error = (volume(mesh) - volume(hull)).abs() / volume(hull);
    let name = M::VOLUME;
    Verdict {
        by,
        what: format!("fills the convex hull of its nodes ({name} off by {error:.0e})"),
        problem: (error > tolerance)
            .then(|| format!("its {name} differs from that of its nodes' hull by {error:.1e}")),
    }
}

/// CGAL's exact predicates, on the coordinates as they are in the file.
fn by_cgal(mesh: &TetMesh, tolerance: f64) -> Result<Verdict> {
    let TetMesh { nodes, tets } = mesh;
    let verdict = delaunay::cgal::validate(nodes, tets)?;
    Ok(Verdict {
        by: "CGAL",
        what: "a triangulation of the convex hull of its nodes, by exact predicates".into(),
        problem: verdict.faults(tolerance).into_iter().next(),
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
