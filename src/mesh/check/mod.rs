//! Checks that a mesh is valid and that it fills its box exactly.
//!
//! This module checks what holds for all meshes: cells have positive volumes, no node is unused,
//! the box is filled, its sides are flat and covered once. Conformity of faces depends on the kind
//! of cells, and polyhedra can have further faults: `simplices` and `cells` check these, and `flat`
//! checks faces of more than three nodes.
//!
//! The simplices may be distributed over several ranks, each of which checks its partition.

mod cells;
mod flat;
#[cfg(test)]
pub(crate) mod partition_tests;
mod simplices;

pub use cells::CellCheck;
pub(crate) use cells::broken_cells;
pub use simplices::nodes_on_bent_side;

use super::Mesh;
use super::view::{MeshView, WHOLE_MESH_NEVER_FAILS};
use crate::Result;
use crate::geometry::sorted;
use crate::progress::CancelToken;
use serde::Serialize;

/// Tolerance of the volume of the mesh, and of the flatness of sides, relative to the box.
pub const BOX_TOLERANCE: f64 = 1e-9;
/// Result of [`check`]. A valid mesh has no `problems`.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct Check {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of cells.
    pub cells: usize,
    /// Number of cells with zero or negative volume.
    pub non_positive_cells: usize,
    /// Number of nodes that no cell uses.
    pub unused_nodes: usize,
    /// Number of faces on the boundary (in 2-D: of edges).
    pub boundary_faces: usize,
    /// Number of boundary faces that do not lie in a side of the box.
    pub faces_off_sides: usize,
    /// Number of boundary faces where cells were left out.
    #[serde(skip_serializing_if = "is_zero")]
    pub outer_faces: usize,
    /// |sum of volumes - volume of the box| / volume of the box. If cells were left out, the declared share
    /// of the box replaces the first volume of the box. For columns, the volume between top and base replaces that of the box.
    pub volume_error: f64,
    /// Largest distance of a boundary node from the side of its face, relative to the box's longest
    /// side.
    pub flatness_error: f64,
    /// Largest relative error of the area of a side, summed over its faces.
    pub area_error: f64,
    /// Results that exist for polyhedra and polygons only.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub cell_check: Option<CellCheck>,
    /// All faults, one line each.
    pub problems: Vec<String>,
}

impl Check {
    /// Returns `true` if the check found no problem.
    pub fn passed(&self) -> bool {
        self.problems.is_empty()
    }

    /// Records how many faces of the declared boundary are boundary faces.
    fn count_declared(&mut self, outer: &OuterBoundary, declared_faces: usize) {
        self.outer_faces = declared_faces;
        if declared_faces != outer.faces.len() {
            self.add_problem(format!(
                "{declared_faces} of the {} faces where cells were left out are on the boundary",
                outer.faces.len()
            ));
        }
    }

    fn add_problem(&mut self, problem: String) {
        self.problems.push(problem);
    }

    /// Records what the totals of the cells and the number of unused nodes say. `cells_name` is the
    /// plural name of the cells; the two volumes are the one that they should fill, and that of the box.
    fn judge(
        &mut self,
        cells_name: &str,
        totals: &CellTotals,
        unused: usize,
        [target_volume, box_volume]: [f64; 2],
        tolerance: f64,
    ) {
        self.non_positive_cells = totals.not_positive;
        if let Some(first) = totals.first_not_positive {
            self.add_problem(format!(
                "{} {cells_name} are flat or inverted, the first is {first}",
                self.non_positive_cells
            ));
        }
        self.unused_nodes = unused;
        if unused > 0 {
            self.add_problem(format!(
                "{unused} nodes belong to no {}",
                singular_name(cells_name)
            ));
        }
        let volume = totals.volume;
        self.volume_error = ((volume - target_volume) / box_volume).abs();
        if self.volume_error > tolerance || self.volume_error.is_nan() {
            let part = if target_volume == box_volume {
                "box's"
            } else {
                "declared"
            };
            self.add_problem(format!(
                "the {cells_name} fill {volume} instead of the {part} {target_volume}"
            ));
        }
    }
}

/// Returns `true` for 0, which reports omit.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Totals over all cells.
struct CellTotals {
    /// Number of cells with zero or negative volume.
    not_positive: usize,
    first_not_positive: Option<usize>,
    /// Sum of the volumes of all cells.
    volume: f64,
}

impl CellTotals {
    /// Sums up the volumes of the cells of all ranks. Collective.
    fn new<const D: usize, M: Mesh<D>>(view: &MeshView<'_, D, M>) -> Result<Self> {
        let volumes = view.mesh.volumes();
        let is_not_positive = |v: &f64| *v <= 0.0;
        let not_positive = volumes.iter().filter(|v| is_not_positive(v)).count();
        let first = volumes.iter().position(is_not_positive);
        let first = first.map(|cell| view.first_cell + cell);
        let local = ((not_positive, first), volumes.iter().sum::<f64>());
        let ((not_positive, first_not_positive), volume) =
            view.merge_parts("volumes", local, |((m, first), v), ((n, other), w)| {
                ((m + n, first.or(other)), v + w)
            })?;
        Ok(Self {
            not_positive,
            first_not_positive,
            volume,
        })
    }
}

/// Counts the nodes of the global mesh that no rank uses. Collective.
fn unused_nodes<const D: usize, M: Mesh<D>>(view: &MeshView<'_, D, M>) -> Result<usize> {
    let is_used = view.mesh.used_nodes();
    let shared = view.gather_shared("used nodes", |n| is_used[n as usize])?;
    let copies = shared.chunk_by(|a, b| a.0 == b.0);
    let shared = copies.filter(|copies| copies.iter().any(|(_, used)| *used));
    let owned = is_used.iter().zip(view.shared_mask());
    let owned = owned.filter(|(used, is_shared)| **used && !is_shared);
    let used = owned.count() + shared.count();
    let used = view.merge_parts("counts of used nodes", used, |a, b| a + b)?;
    Ok(view.global_counts[0].saturating_sub(used))
}

/// Returns `true` if all coordinates are finite.
fn are_finite<const D: usize>(nodes: &[[f64; D]]) -> bool {
    nodes.as_flattened().iter().all(|c| c.is_finite())
}

/// Problem that the check reports if a coordinate is not finite.
const NOT_FINITE: &str = "a node is not finite";

/// Facts about a mesh that a caller already knows.
#[derive(Debug, Clone, Copy, Default)]
pub struct CheckHints<'a> {
    /// For simplices: the cell on the other side of each face, for every cell and face in order, or
    /// `NONE`. The check verifies these numbers, which takes less time than finding them.
    pub neighbours: Option<&'a [u32]>,
    /// For polyhedra and polygons: nodes are welded within this fraction of their distance to their
    /// sites. Faces need to be flat only to that distance.
    pub weld: f64,
    /// For simplices: number of the side of the box that may be bent: 2 axis for the lower side, 2 axis + 1 for the
    /// upper side. Lines along the axis must cross it once. The cells fill the space between it and the opposite side.
    pub bent_side: Option<usize>,
    /// The boundary at which cells were left out, if the mesh does not fill its box.
    pub outer: Option<&'a OuterBoundary>,
}

/// The declared boundary of a mesh that does not fill its box, because cells were left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OuterBoundary {
    /// The share of the box that the cells fill.
    pub filled_share: f64,
    /// The nodes of each face where cells were left out, ascending, and the number of its set in `names`,
    /// from 0; the faces are sorted.
    pub faces: Vec<(Vec<u32>, u32)>,
    /// The names of the sets of faces that the boundary has.
    pub names: Vec<String>,
}

impl OuterBoundary {
    /// Returns `true` if a face with these nodes, in any order, is declared.
    pub fn contains(&self, nodes: &[u32]) -> bool {
        self.set_of(nodes).is_some()
    }

    /// Returns the number of the set of a face with these nodes, in any order.
    pub fn set_of(&self, nodes: &[u32]) -> Option<u32> {
        let nodes = sorted(nodes.to_vec());
        let found = self.faces.binary_search_by(|entry| entry.0.cmp(&nodes));
        found.ok().map(|index| self.faces[index].1)
    }
}

/// The box that a mesh should fill, and the tolerance.
#[derive(Debug, Clone, Copy)]
pub struct BoxBounds<const D: usize> {
    low: [f64; D],
    high: [f64; D],
    /// Tolerance relative to the box's longest side, areas and volume.
    tolerance: f64,
    /// The number of the side that may be bent, as in [`CheckHints`].
    bent_side: Option<usize>,
}

impl<const D: usize> BoxBounds<D> {
    fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| self.high[k] - self.low[k])
    }

    fn longest_side(&self) -> f64 {
        self.extent().into_iter().fold(0.0, f64::max)
    }
}

/// The parts of the check that depend on the kind of cells.
pub trait CellChecks<const D: usize> {
    /// Returns the reason why a mesh cannot be read, if there is one: indices of nodes that do not
    /// exist, for instance. `first_cell` is the global number of the first cell.
    fn unreadable_reason(&self, first_cell: usize) -> Option<String>;

    /// Returns for each node whether a cell uses it.
    fn used_nodes(&self) -> Vec<bool>;

    /// Returns the volume that the cells should fill.
    fn target_volume(&self, bounds: &BoxBounds<D>) -> f64;

    /// Checks the faces of all ranks, and returns how they cover each side of the box. Returns
    /// `None` if that cannot be determined. Collective.
    ///
    /// # Errors
    /// Returns the communication errors of the view.
    fn check_faces(
        view: &MeshView<'_, D, Self>,
        hints: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        report: &mut Check,
        cancel: &CancelToken<'_>,
    ) -> Result<Option<SideCoverage<D>>>
    where
        Self: Sized;
}

/// Checks a mesh against the box `[low, high]`: cells have positive volumes, faces conform, no node
/// is unused, sides are flat (to `tolerance` times the longest side), and areas and volume are
/// filled (to the relative `tolerance`). In 2-D areas replace volumes, and lengths replace areas.
///
/// For polyhedra and polygons also: cells are closed and contain their sites, faces are flat, and
/// their outlines do not cross themselves. Columns fill the box as seen from above: their layers,
/// top and base may be bent, and they fill the volume between top and base.
pub fn check<const D: usize, M: Mesh<D>>(
    mesh: &M,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    check_with_hints(mesh, CheckHints::default(), low, high, tolerance)
}

/// Performs [`check`] with facts about the mesh that the caller already knows.
pub fn check_with_hints<const D: usize, M: Mesh<D>>(
    mesh: &M,
    hints: CheckHints<'_>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    let (view, never) = (MeshView::from_mesh(mesh), CancelToken::never());
    check_view(&view, hints, low, high, tolerance, &never).expect(WHOLE_MESH_NEVER_FAILS)
}

/// Performs [`check_with_hints`] on a mesh that may be distributed, until `cancel` is cancelled.
/// After that the result has no meaning. Collective; every rank gets the result for the global
/// mesh. If it is distributed, neighbours must be given.
///
/// # Errors
/// Returns the communication errors of the view.
pub(crate) fn check_view<const D: usize, M: Mesh<D>>(
    view: &MeshView<'_, D, M>,
    hints: CheckHints<'_>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
    cancel: &CancelToken<'_>,
) -> Result<Check> {
    let mesh = view.mesh;
    let mut report = Check {
        nodes: view.global_counts[0],
        cells: view.global_counts[1],
        ..Check::default()
    };
    let unreadable_reason = mesh.unreadable_reason(view.first_cell);
    let local = (unreadable_reason, are_finite(mesh.nodes()));
    let (unreadable_reason, is_finite) =
        view.merge_parts("whether meshes are readable", local, |a, b| {
            (a.0.or(b.0), a.1 && b.1)
        })?;
    let not_finite = (!is_finite).then(|| NOT_FINITE.into());
    if let Some(problem) = unreadable_reason.or(not_finite) {
        report.add_problem(problem);
        return Ok(report);
    }
    let bounds = BoxBounds {
        low,
        high,
        tolerance,
        bent_side: hints.bent_side,
    };
    let volumes = match hints.outer {
        Some(outer) => {
            let box_volume = bounds.extent().iter().product();
            [outer.filled_share * box_volume, box_volume]
        }
        None => [mesh.target_volume(&bounds); 2],
    };
    report.judge(
        M::CELLS_NAME,
        &CellTotals::new(view)?,
        unused_nodes(view)?,
        volumes,
        tolerance,
    );
    if let Some(mut sides) = M::check_faces(view, hints, &bounds, &mut report, cancel)? {
        if let Some(outer) = hints.outer {
            report.count_declared(outer, sides.declared_faces);
            sides.must_be_covered = [false; D];
        }
        sides.judge(&bounds, &mut report);
    }
    Ok(report)
}

/// Largest distance of a face from the side in which it lies, in units of the box's longest side.
const SIDE_TOLERANCE: f64 = 1e-6;

/// Returns the fraction of the box `[0, extent]` that the cells fill: 1 for a valid mesh, less for
/// a mesh with a hole, more where cells overlap. With a bent side, it is the fraction of the part of the box that this
/// side bounds; where cells were left out, of the declared share of the box. Returns `None` if a cell is flat or
/// inverted, because then the sum has no meaning.
pub fn filled_share<const D: usize, M: Mesh<D>>(
    mesh: &M,
    extent: [f64; D],
    hints: CheckHints<'_>,
) -> Option<f64> {
    let bounds = BoxBounds {
        low: [0.0; D],
        high: extent,
        tolerance: SIDE_TOLERANCE,
        bent_side: hints.bent_side,
    };
    let mut total = 0.0;
    for volume in mesh.volumes() {
        if volume <= 0.0 {
            return None;
        }
        total += volume;
    }
    Some(match hints.outer {
        Some(outer) => total / (outer.filled_share * extent.iter().product::<f64>()),
        None => total / mesh.target_volume(&bounds),
    })
}

/// Returns the singular of a plural name of cells.
fn singular_name(name: &str) -> String {
    match name.strip_suffix("hedra") {
        Some(start) => format!("{start}hedron"),
        None => name.trim_end_matches('s').into(),
    }
}

/// Areas of the box's sides that boundary faces cover.
pub struct SideCoverage<const D: usize> {
    /// Covered area on the low and the high side of each axis.
    area: [[f64; 2]; D],
    /// `true` for each axis whose two sides must be covered.
    must_be_covered: [bool; D],
    /// Number of boundary faces that the outer boundary declares.
    declared_faces: usize,
}

impl<const D: usize> SideCoverage<D> {
    /// Returns a coverage of zero, where the sides of all axes must be covered.
    fn uncovered() -> Self {
        Self {
            area: [[0.0; 2]; D],
            must_be_covered: [true; D],
            declared_faces: 0,
        }
    }

    /// Adds a boundary face of the upper or lower side of an axis. `offset` is the largest distance
    /// of its nodes from that side.
    fn add(
        &mut self,
        axis: usize,
        upper: bool,
        area: f64,
        offset: f64,
        bounds: &BoxBounds<D>,
        report: &mut Check,
    ) {
        report.boundary_faces += 1;
        report.flatness_error = report.flatness_error.max(offset / bounds.longest_side());
        if offset > bounds.tolerance * bounds.longest_side() {
            report.faces_off_sides += 1;
        }
        self.area[axis][usize::from(upper)] += area;
    }

    /// Checks that every boundary face lies in a side, and that every side is covered once.
    fn judge(self, bounds: &BoxBounds<D>, report: &mut Check) {
        if report.faces_off_sides > 0 {
            report.add_problem(format!(
                "{} boundary faces are off the box's sides: the mesh has holes or bumps",
                report.faces_off_sides
            ));
        }
        let extent = bounds.extent();
        for k in (0..D).filter(|&k| self.must_be_covered[k]) {
            let want: f64 = (0..D).filter(|&j| j != k).map(|j| extent[j]).product();
            for got in self.area[k] {
                report.area_error = report.area_error.max((got - want).abs() / want);
            }
        }
        if report.area_error > bounds.tolerance {
            report.add_problem(format!(
                "a side of the box is covered with a relative area error of {:.2e}",
                report.area_error
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

    /// Returns the unit cube as six tetrahedra.
    fn cube() -> TetMesh {
        kuhn_box([1; 3], 1.0)
    }

    #[test]
    fn a_valid_mesh_passes() {
        let report = check(&cube(), [0.0; 3], [1.0; 3], 1e-12);
        assert!(report.passed(), "{:?}", report.problems);
        assert_eq!(report.boundary_faces, 12);
    }

    #[test]
    fn known_neighbours_are_checked() {
        let mesh = cube();
        let expected = Simplices::neighbours(&mesh).unwrap();
        let check_neighbours = |neighbours: &[u32]| {
            let hints = CheckHints {
                neighbours: Some(neighbours),
                ..CheckHints::default()
            };
            check_with_hints(&mesh, hints, [0.0; 3], [1.0; 3], 1e-12)
        };
        let problems = |neighbours: &[u32]| check_neighbours(neighbours).problems;
        assert_eq!(
            check_neighbours(&expected),
            check(&mesh, [0.0; 3], [1.0; 3], 1e-12)
        );
        for i in 0..expected.len() {
            for other in [0, 1, 2, 3, 4, 5, 6, NONE] {
                let mut wrong = expected.clone();
                wrong[i] = other;
                assert_eq!(
                    problems(&wrong).is_empty(),
                    wrong == expected,
                    "{i} {other}"
                );
            }
        }
        assert!(!problems(&expected[1..]).is_empty());
    }

    #[test]
    fn each_fault_is_found() {
        let checked = |change: &dyn Fn(&mut TetMesh)| {
            let mut mesh = cube();
            change(&mut mesh);
            check(&mesh, [0.0; 3], [1.0; 3], 1e-12)
        };
        assert_eq!(checked(&|m| m.tets[0].swap(0, 1)).non_positive_cells, 1);
        assert_eq!(checked(&|m| m.nodes.push([0.5; 3])).unused_nodes, 1);
        assert!(checked(&|m| m.tets.truncate(5)).faces_off_sides > 0);
        assert!(checked(&|m| m.nodes[7][0] = 1.1).flatness_error > 0.05);
        assert!(!checked(&|m| m.tets[0][1] = 99).passed());
        assert!(
            !checked(&|m| {
                let t = m.tets[0];
                m.tets.push(t);
                m.tets.push(t)
            })
            .passed()
        );
        assert!(!checked(&|m| m.nodes[3][1] = f64::NAN).passed());
    }
}
