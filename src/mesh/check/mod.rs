//! The one checker: is this mesh valid, and does it fill its box exactly?
//!
//! What holds for all meshes is checked here: positive volumes, no unused node, the box filled, sides
//! flat and covered once. That faces conform means something else for each kind of cells, and polyhedra
//! have more that can be wrong: `simplices` and `cells` see to that, and `flat` to faces of more than
//! three nodes. `pieces` checks a mesh of which nobody holds the whole.

mod cells;
mod distributed;
mod flat;
mod simplices;

pub use cells::CellCheck;
pub(crate) use cells::broken_cells;
pub(crate) use distributed::check_distributed;
#[cfg(test)]
pub(crate) use distributed::tests::assert_same_check;

use super::Mesh;
use crate::progress::CancelToken;
use serde::Serialize;

/// What [`check`] found. A mesh that is right has `problems` empty.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct Check {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of cells.
    pub cells: usize,
    /// Cells of zero or negative volume.
    pub non_positive_cells: usize,
    /// Nodes that no cell uses.
    pub unused_nodes: usize,
    /// Faces on the boundary (edges, in the plane).
    pub boundary_faces: usize,
    /// Boundary faces that do not lie in a side of the box.
    pub faces_off_sides: usize,
    /// |sum of volumes - volume of the box| / volume of the box; of columns, the volume between top and
    /// base.
    pub volume_error: f64,
    /// Largest distance of a boundary node from the side of its face, over the box's longest side.
    pub flatness_error: f64,
    /// Largest relative error of a side's area, summed over its faces.
    pub area_error: f64,
    /// What is known of polyhedra and polygons only.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub cell_check: Option<CellCheck>,
    /// Each fault in one line.
    pub problems: Vec<String>,
}

impl Check {
    /// Whether nothing is wrong.
    pub fn passed(&self) -> bool {
        self.problems.is_empty()
    }

    fn add_problem(&mut self, problem: String) {
        self.problems.push(problem);
    }

    /// Judges cells, whose kind is `cells`, by what they are in sum, and by how many nodes belong to none; `room` is
    /// what they are to fill.
    fn judge(
        &mut self,
        cells: &str,
        filled: &CellTotals,
        unused: usize,
        room: f64,
        tolerance: f64,
    ) {
        self.non_positive_cells = filled.not_positive;
        if let Some(first) = filled.first_not_positive {
            self.add_problem(format!(
                "{} {cells} are flat or inverted, the first is {first}",
                self.non_positive_cells
            ));
        }
        self.unused_nodes = unused;
        if unused > 0 {
            self.add_problem(format!(
                "{unused} nodes belong to no {}",
                singular_name(cells)
            ));
        }
        let volume = filled.volume;
        self.volume_error = ((volume - room) / room).abs();
        if self.volume_error > tolerance || self.volume_error.is_nan() {
            self.add_problem(format!(
                "the {cells} fill {volume} instead of the box's {room}"
            ));
        }
    }
}

/// What cells are in sum.
struct CellTotals {
    /// How many are of zero or negative volume, and the first of them.
    not_positive: usize,
    first_not_positive: Option<usize>,
    /// Of all.
    volume: f64,
}

impl CellTotals {
    fn from_volumes(volumes: &[f64]) -> Self {
        let wrong = |v: &f64| *v <= 0.0;
        Self {
            not_positive: volumes.iter().filter(|v| wrong(v)).count(),
            first_not_positive: volumes.iter().position(wrong),
            volume: volumes.iter().sum(),
        }
    }
}

/// Whether all nodes are somewhere.
fn are_finite<const D: usize>(nodes: &[[f64; D]]) -> bool {
    nodes.as_flattened().iter().all(|c| c.is_finite())
}

/// What is said if they are not.
const NOT_FINITE: &str = "a node is not finite";

/// What a caller knows of a mesh beforehand.
#[derive(Debug, Clone, Copy, Default)]
pub struct CheckHints<'a> {
    /// Of simplices: for every cell and face, in order, the cell on its other side, or
    /// `NONE`. Whether they are right is checked, which takes less time than to
    /// find them.
    pub neighbors: Option<&'a [u32]>,
    /// Of polyhedra and polygons: the share of their distance to their sites within which nodes are
    /// welded. Faces need be flat to that only.
    pub weld: f64,
}

/// The box that a mesh is to fill, and how exactly.
#[derive(Debug, Clone, Copy)]
pub struct BoxBounds<const D: usize> {
    low: [f64; D],
    high: [f64; D],
    /// Relative to the box.
    tolerance: f64,
}

impl<const D: usize> BoxBounds<D> {
    fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| self.high[k] - self.low[k])
    }

    fn longest_side(&self) -> f64 {
        self.extent().into_iter().fold(0.0, f64::max)
    }
}

/// What of the check depends on the kind of cells.
pub trait CellChecks<const D: usize> {
    /// What makes a mesh unreadable, if anything does: numbers of nodes that do not exist, and the like.
    fn unreadable_reason(&self) -> Option<String>;

    /// Whether each node belongs to a cell.
    fn used_nodes(&self) -> Vec<bool>;

    /// The volume that the cells are to fill.
    fn target_volume(&self, bounds: &BoxBounds<D>) -> f64;

    /// Checks the faces, and gives what each side of the box is covered with; `None` if that cannot be
    /// told.
    fn check_faces(
        &self,
        known: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        found: &mut Check,
        patience: &CancelToken<'_>,
    ) -> Option<SideCoverage<D>>;
}

/// Checks a mesh against the box `[low, high]`: positive volumes, conforming faces, no unused nodes,
/// sides exactly flat (to `tolerance` of the longest side), areas and volume filled to `tolerance`.
/// In the plane the same with areas for volumes and lengths for areas.
///
/// Of polyhedra and polygons also: cells closed with their sites inside, faces flat, their outlines not
/// crossing themselves. Columns fill the box as seen from above: their layers, their top and their base
/// may be bent, and their volume is what lies between top and base.
pub fn check<const D: usize, M: Mesh<D>>(
    mesh: &M,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    check_with_hints(mesh, CheckHints::default(), low, high, tolerance)
}

/// [`check`] of a mesh of which something is known.
pub fn check_with_hints<const D: usize, M: Mesh<D>>(
    mesh: &M,
    known: CheckHints<'_>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    check_cancellable(mesh, known, low, high, tolerance, &CancelToken::never())
}

/// The same as long as `patience` lasts; once it is over, nothing can be said of the mesh.
pub(crate) fn check_cancellable<const D: usize, M: Mesh<D>>(
    mesh: &M,
    known: CheckHints<'_>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
    patience: &CancelToken<'_>,
) -> Check {
    let mut found = Check {
        nodes: mesh.nodes().len(),
        cells: mesh.len(),
        ..Check::default()
    };
    if let Some(problem) = mesh.unreadable_reason() {
        found.add_problem(problem);
        return found;
    }
    if !are_finite(mesh.nodes()) {
        found.add_problem(NOT_FINITE.into());
        return found;
    }
    let bounds = BoxBounds {
        low,
        high,
        tolerance,
    };

    if patience.is_cancelled() {
        return found;
    }
    let filled = CellTotals::from_volumes(&mesh.volumes());
    let unused = mesh.used_nodes().iter().filter(|used| !**used).count();
    found.judge(
        M::CELLS_NAME,
        &filled,
        unused,
        mesh.target_volume(&bounds),
        tolerance,
    );
    if let Some(sides) = mesh.check_faces(known, &bounds, &mut found, patience) {
        sides.judge(&bounds, &mut found);
    }
    found
}

/// The share of the box `[0, extent]` that cells fill: 1 of a valid mesh, less of one with a hole, more
/// where cells overlap. `None` if a cell is flat or inverted, so that their sum says nothing.
pub fn filled_share<const D: usize, M: Mesh<D>>(mesh: &M, extent: [f64; D]) -> Option<f64> {
    let bounds = BoxBounds {
        low: [0.0; D],
        high: extent,
        tolerance: 0.0,
    };
    let mut filled = 0.0;
    for volume in mesh.volumes() {
        if volume <= 0.0 {
            return None;
        }
        filled += volume;
    }
    Some(filled / mesh.target_volume(&bounds))
}

/// The name of one cell.
fn singular_name(name: &str) -> String {
    match name.strip_suffix("hedra") {
        Some(start) => format!("{start}hedron"),
        None => name.trim_end_matches('s').into(),
    }
}

/// What covers the sides of the box.
pub struct SideCoverage<const D: usize> {
    /// Area on the low and the high side of each axis.
    area: [[f64; 2]; D],
    /// Whether the sides of each axis must be covered.
    must_be_covered: [bool; D],
}

impl<const D: usize> SideCoverage<D> {
    /// None of them covered; of each axis both must be.
    fn uncovered() -> Self {
        Self {
            area: [[0.0; 2]; D],
            must_be_covered: [true; D],
        }
    }

    /// Adds a boundary face that lies in the upper or lower side of an axis, but for a distance of `off`.
    fn add(
        &mut self,
        (axis, upper): (usize, bool),
        area: f64,
        off: f64,
        bounds: &BoxBounds<D>,
        found: &mut Check,
    ) {
        found.boundary_faces += 1;
        found.flatness_error = found.flatness_error.max(off / bounds.longest_side());
        if off > bounds.tolerance * bounds.longest_side() {
            found.faces_off_sides += 1;
        }
        self.area[axis][usize::from(upper)] += area;
    }

    /// Every boundary face lies in a side, every side is covered once.
    fn judge(self, bounds: &BoxBounds<D>, found: &mut Check) {
        if found.faces_off_sides > 0 {
            found.add_problem(format!(
                "{} boundary faces are off the box's sides: the mesh has holes or bumps",
                found.faces_off_sides
            ));
        }
        let extent = bounds.extent();
        for k in (0..D).filter(|&k| self.must_be_covered[k]) {
            let want: f64 = (0..D).filter(|&j| j != k).map(|j| extent[j]).product();
            for got in self.area[k] {
                found.area_error = found.area_error.max((got - want).abs() / want);
            }
        }
        if found.area_error > bounds.tolerance {
            found.add_problem(format!(
                "a side of the box is covered with a relative area error of {:.2e}",
                found.area_error
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::complex::NONE;
    use crate::mesh::{Simplices, TetMesh};

    /// The unit cube as six tetrahedra.
    fn cube() -> TetMesh {
        kuhn_box([1; 3], 1.0)
    }

    #[test]
    fn a_right_mesh_passes() {
        let found = check(&cube(), [0.0; 3], [1.0; 3], 1e-12);
        assert!(found.passed(), "{:?}", found.problems);
        assert_eq!(found.boundary_faces, 12);
    }

    #[test]
    fn known_neighbours_are_checked() {
        let mesh = cube();
        let right = Simplices::neighbors(&mesh).unwrap();
        let joined = |neighbors: &[u32]| {
            let known = CheckHints {
                neighbors: Some(neighbors),
                ..CheckHints::default()
            };
            check_with_hints(&mesh, known, [0.0; 3], [1.0; 3], 1e-12)
        };
        let found = |neighbors: &[u32]| joined(neighbors).problems;
        assert_eq!(joined(&right), check(&mesh, [0.0; 3], [1.0; 3], 1e-12));
        for i in 0..right.len() {
            for other in [0, 1, 2, 3, 4, 5, 6, NONE] {
                let mut wrong = right.clone();
                wrong[i] = other;
                assert_eq!(found(&wrong).is_empty(), wrong == right, "{i} {other}");
            }
        }
        assert!(!found(&right[1..]).is_empty());
    }

    #[test]
    fn each_fault_is_found() {
        let fault = |change: &dyn Fn(&mut TetMesh)| {
            let mut mesh = cube();
            change(&mut mesh);
            check(&mesh, [0.0; 3], [1.0; 3], 1e-12)
        };
        assert_eq!(fault(&|m| m.tets[0].swap(0, 1)).non_positive_cells, 1);
        assert_eq!(fault(&|m| m.nodes.push([0.5; 3])).unused_nodes, 1);
        assert!(fault(&|m| m.tets.truncate(5)).faces_off_sides > 0);
        assert!(fault(&|m| m.nodes[7][0] = 1.1).flatness_error > 0.05);
        assert!(!fault(&|m| m.tets[0][1] = 99).passed());
        assert!(
            !fault(&|m| {
                let t = m.tets[0];
                m.tets.push(t);
                m.tets.push(t)
            })
            .passed()
        );
        assert!(!fault(&|m| m.nodes[3][1] = f64::NAN).passed());
    }
}
