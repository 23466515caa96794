//! Checks a mesh with atomesh's own checker, the Delaunay kernels (spade in 2-D) and CGAL, as far as
//! they are built in, as `atomesh validate` does.

use serde::Serialize;
use serde_json::{Value, json};

use crate::error::cause;
use crate::mesh::check::check_with_hints;
use crate::mesh::delaunay::{self, DelaunayKernel};
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::progress::{Progress, Stage};
use crate::store::MeshInput;
use crate::store::{AnyMesh, Storable, StoredMesh};
use crate::{Error, Result};

/// Checks a mesh with each checker that is built in, as `atomesh validate` does. If atomesh's own
/// checker finds a problem, the others do not run.
///
/// ```
/// use atomesh::MeshSpec;
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let verdicts = atomesh::validate(mesh, &mut NoProgress)?;
/// assert_eq!(verdicts[1].checker, "spade");
/// assert!(verdicts.iter().all(|verdict| verdict.problem.is_none()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`StoredMesh::new`], and those of the kernels.
pub fn validate<'a>(
    mesh: impl Into<MeshInput<'a>>,
    progress: &mut dyn Progress,
) -> Result<Vec<CheckerVerdict>> {
    let MeshInput { mesh, name, .. } = mesh.into();
    progress.stage(Stage::Checking);
    // The other checkers depend on the kind of cells.
    match mesh {
        AnyMesh::Triangles(file) => {
            let stored = StoredMesh::new(file, name)?;
            // A mesh of which cells were left out is not convex.
            if stored.outer.is_some() {
                return Ok(vec![atomesh_verdict(&stored)]);
            }
            with_other_checkers(atomesh_verdict(&stored), || {
                Ok(vec![spade_verdict(
                    &stored.lattice,
                    stored.space.tolerance(),
                )?])
            })
        }
        AnyMesh::Tetrahedra(file) => {
            let mut stored = StoredMesh::new(file, name)?;
            // A mesh that ends at a topography, or of which cells were left out, is not convex.
            if stored.space.bent_side.is_some() || stored.outer.is_some() {
                return Ok(vec![atomesh_verdict(&stored)]);
            }
            with_other_checkers(atomesh_verdict(&stored), || {
                let tolerance = stored.space.tolerance();
                let mut verdicts = Vec::new();
                for (kernel, name) in kernels() {
                    let mesh = &stored.lattice;
                    let hull = delaunay::delaunay_by(&mesh.nodes, kernel)?;
                    verdicts.push(hull_verdict(name, mesh, &hull, tolerance));
                }
                if cfg!(feature = "cgal") {
                    verdicts.push(stored.with_world_mesh(|mesh| cgal_verdict(mesh, tolerance))?);
                }
                Ok(verdicts)
            })
        }
        AnyMesh::Polygons(file) => Ok(vec![atomesh_verdict(&StoredMesh::new(file, name)?)]),
        AnyMesh::Polyhedra(file) => Ok(vec![atomesh_verdict(&StoredMesh::new(file, name)?)]),
    }
}

/// Adds the verdicts of the other checkers if atomesh's own checker finds no fault. On invalid
/// nodes TetGen might abort the process.
fn with_other_checkers(
    own_verdict: CheckerVerdict,
    others: impl FnOnce() -> Result<Vec<CheckerVerdict>>,
) -> Result<Vec<CheckerVerdict>> {
    let mut verdicts = vec![own_verdict];
    if verdicts[0].problem.is_none() {
        verdicts.extend(others()?);
    }
    Ok(verdicts)
}

/// Returns the verdict of atomesh's own checker, in lattice space, where the sides are known.
fn atomesh_verdict<const D: usize, M: Storable<D>>(stored: &StoredMesh<D, M>) -> CheckerVerdict {
    let (low, high) = ([0.0; D], stored.space.extent);
    let (hints, tolerance) = (stored.check_hints(), stored.space.tolerance());
    let check = check_with_hints(&stored.lattice, hints, low, high, tolerance);
    let box_name = match &stored.outer {
        Some(outer) => format!(
            "{:.4} of the box, within {} faces where cells were left out",
            outer.filled_share,
            outer.faces.len()
        ),
        None => "the box".to_string(),
    };
    let criterion = match &check.cell_check {
        None => format!(
            "{} {} of positive {}, conforming, fill {box_name} ({} off by {:.0e}), sides flat, all {} \
             nodes used",
            check.cells,
            M::CELLS_NAME,
            M::VOLUME_NAME,
            M::VOLUME_NAME,
            check.volume_error,
            check.nodes
        ),
        Some(cell_check) => {
            let [faces, space] = if cell_check.is_columnar {
                [
                    "faces, the vertical ones flat,",
                    "the space between top and base",
                ]
            } else {
                ["flat faces", box_name.as_str()]
            };
            format!(
                "{} closed cells with their atoms inside, {} {faces} between two cells or on a side, \
                 fill {space} (off by {:.0e})",
                check.cells, cell_check.faces, check.volume_error
            )
        }
    };
    CheckerVerdict {
        checker: "atomesh",
        criterion,
        problem: check.problems.first().cloned(),
    }
}

/// Returns the built-in Delaunay kernels with their names. A mesh is compared with their
/// triangulations of its nodes: both must fill the convex hull.
fn kernels() -> impl Iterator<Item = (DelaunayKernel, &'static str)> {
    let all = [
        (DelaunayKernel::Native, "atomesh's kernel"),
        (DelaunayKernel::Tetgen, "TetGen"),
    ];
    all.into_iter()
        .filter(|(kernel, _)| kernel.check_built_in().is_ok())
}

/// Returns the verdict of spade, in the plane.
fn spade_verdict(mesh: &TriMesh, tolerance: f64) -> Result<CheckerVerdict> {
    let hull = delaunay::delaunay_plane(&mesh.nodes)?;
    Ok(hull_verdict("spade", mesh, &hull, tolerance))
}

/// Checks that a mesh fills the convex hull of its nodes, which is given as another triangulation.
fn hull_verdict<const D: usize, M: Simplices<D>>(
    checker: &'static str,
    mesh: &M,
    hull: &M,
    tolerance: f64,
) -> CheckerVerdict {
    let volume = |mesh: &M| -> f64 { (0..mesh.len()).map(|c| mesh.volume(c)).sum() };
    let error = (volume(mesh) - volume(hull)).abs() / volume(hull);
    let name = M::VOLUME_NAME;
    CheckerVerdict {
        checker,
        criterion: format!("fills the convex hull of its nodes ({name} off by {error:.0e})"),
        problem: (error > tolerance)
            .then(|| format!("its {name} differs from that of its nodes' hull by {error:.1e}")),
    }
}

/// Returns the verdict of CGAL's exact predicates on the coordinates of the file.
fn cgal_verdict(mesh: &TetMesh, tolerance: f64) -> Result<CheckerVerdict> {
    let TetMesh { nodes, tets } = mesh;
    let verdict = delaunay::cgal::validate(nodes, tets)?;
    Ok(CheckerVerdict {
        checker: "CGAL",
        criterion: "a triangulation of the convex hull of its nodes, by exact predicates".into(),
        problem: verdict.faults(tolerance).into_iter().next(),
    })
}

/// The verdict of one checker.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct CheckerVerdict {
    /// Name of the checker.
    pub checker: &'static str,
    /// Properties that hold if the mesh is valid.
    pub criterion: String,
    /// The first problem, if there is one.
    pub problem: Option<String>,
}

impl CheckerVerdict {
    /// Returns the verdicts of all checkers as JSON.
    pub fn to_json(verdicts: &[Self]) -> Value {
        let is_valid = verdicts.iter().all(|verdict| verdict.problem.is_none());
        json!({ "valid": is_valid, "checks": verdicts })
    }

    /// Returns the error of the first problem that a checker found in the mesh of this name.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if there is one.
    pub fn require_valid(verdicts: &[Self], name: &str) -> Result<()> {
        let failed = verdicts
            .iter()
            .find_map(|v| Some((v.checker, v.problem.as_ref()?)));
        match failed {
            None => Ok(()),
            Some((checker, problem)) => Err(Error::Mesh(cause(
                name,
                format!("{checker} finds it invalid: {problem}"),
                "mesh the image again",
            ))),
        }
    }

    /// Returns the verdict as one line.
    pub fn summary_line(&self) -> String {
        match &self.problem {
            None => format!("{:8} passed: {}", self.checker, self.criterion),
            Some(problem) => format!("{:8} FAILED: {problem}", self.checker),
        }
    }
}
