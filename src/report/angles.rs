//! Assesses which bad angles are explained by the features themselves.
//!
//! If two feature surfaces, or a feature surface and a side of the box, meet at an angle theta, no
//! mesh that contains both has all dihedral angles above theta. So the criterion is: every angle is
//! in [30, 150] degrees, except in cells that touch an acute line or lie in its wedge. Their angles
//! must be in [s, 180 - s] with s = [`MIN_ANGLE_RATIO`] theta. All other cells are *unexplained*. A
//! cell lies in the wedge if all its nodes are on features or sides of the box and one of them is
//! within [`INFLUENCE_RADIUS`] d of the line. Farther away, the wedge is wide enough for nodes
//! between its two surfaces. (Outside the wedge, bad cells are no more frequent near a line than
//! elsewhere at features. On feature surfaces at 25 degrees to a side, all bad cells near the line
//! touched it.)

use crate::parallel::prelude::*;
use serde::Serialize;

use super::acute::{
    AcuteEdge, AcuteLine, AcuteLines, acute_lines, common_sides, sorted_feature_faces,
};
use super::mesh_faces::MeshFaces;
use super::quality::{CELLS_PER_TASK, Worst, angle_from_versine, centroid, max_value, min_value};
use crate::Result;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, sub};
use crate::mesh::Simplices;
use crate::mesh::view::{MeshView, WHOLE_MESH_NEVER_FAILS};

/// Minimum angle in degrees. The maximum is 180 minus this.
pub const MIN_ANGLE: f64 = 30.0;
/// Distance from the line within which its wedge is too narrow for nodes inside, in units of d.
pub const INFLUENCE_RADIUS: f64 = 2.0;
/// Minimum ratio of a cell's angle to the angle of the line. Some of the cells that fill a wedge of
/// theta have slightly less than theta.
pub const MIN_ANGLE_RATIO: f64 = 0.7;

/// Class of a cell whose angles are all in [30, 150] degrees, as stored in cell data.
pub const OK: u8 = 0;
/// Class of a cell with other angles near an acute line that explains them.
pub const NEAR_ACUTE_LINE: u8 = 1;
/// Class of any other cell.
pub const UNEXPLAINED: u8 = 2;

/// Counts of cells with angles beyond [30, 150] degrees, explained or not. Angles of tetrahedra are
/// dihedral.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Angles {
    /// Number of cells whose angles are all in [30, 150] degrees.
    pub ok: usize,
    /// Number of other cells near an acute line that explains their angles.
    pub near_acute_line: usize,
    /// Number of all other cells.
    pub unexplained: usize,
    /// Unexplained cell whose angles are farthest from 90 degrees.
    pub worst_unexplained: Option<Worst>,
    /// Lines where features, or a feature and a side of the box, meet at less than 30 degrees.
    pub acute_lines: Vec<AcuteLine>,
}

/// Assessment of the angles of a mesh, with the class of each cell.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AngleAssessment {
    /// Counts and acute lines.
    pub angles: Angles,
    /// Class of each cell: 0 (good), 1 (near an acute line) or 2 (unexplained).
    pub cell_classes: Vec<u8>,
}

/// Cell with an angle out of range. Its extreme angles are stored as versines, as in
/// [`quality`](super::quality()).
struct BadCell {
    cell: usize,
    small: f32,
    large: f32,
}

impl BadCell {
    fn worst_versine(&self) -> f32 {
        self.small.min(self.large)
    }
}

/// Returns the versine of an angle in degrees.
fn versine(angle: f64) -> f64 {
    1.0 - angle.to_radians().cos()
}

/// Assesses the angles of a mesh that fills the box `[0, extent]`. `feature_faces` has a byte for
/// each cell, in which bit k marks that face k lies on a feature; it may be empty. `distance`
/// returns d at a node.
pub fn assess_angles<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    extent: [f64; D],
    distance: impl Fn(u32) -> f64,
) -> AngleAssessment {
    assess_partition_angles(&MeshView::from_mesh(mesh), feature_faces, extent, &distance)
        .expect(WHOLE_MESH_NEVER_FAILS)
}

/// Assesses the angles of a distributed mesh. Collective. The cell classes are those of the local
/// cells, and the nodes of acute lines are global.
///
/// # Errors
/// Returns the communication errors of the view.
pub(crate) fn assess_partition_angles<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    feature_faces: &[u8],
    extent: [f64; D],
    distance: &dyn Fn(u32) -> f64,
) -> Result<AngleAssessment> {
    let (mesh, nodes) = (view.mesh, view.mesh.nodes());
    let faces = sorted_feature_faces(mesh, feature_faces, extent);
    let mut on_feature = vec![false; nodes.len()];
    for &node in faces.iter().flatten() {
        on_feature[node as usize] = true;
    }
    view.combine_shared_marks("nodes on features", &mut on_feature)?;
    let faces = faces.into_iter().map(|face| (face, 1)).collect();
    let surface = MeshFaces::owned_faces("faces on features", view, faces)?;
    let mut acute = acute_lines(view, &surface, extent, distance)?;
    drop(surface);
    let explainer = AngleExplainer::from_lines(&acute);
    for line in &mut acute.lines {
        (line.nodes.iter_mut()).for_each(|n| *n = acute.global_nodes[*n as usize]);
    }
    let in_side = |n: u32| common_sides(&[nodes[n as usize]], extent).next().is_some();
    let is_constrained = |n: &u32| on_feature[*n as usize] || in_side(*n);
    let mut cells = vec![OK; mesh.len()];
    let mut unexplained = Vec::new();
    for bad in bad_cells(mesh) {
        let cell = mesh.cell(bad.cell);
        let corners = cell.iter().map(|&n| (view.global_id(n), nodes[n as usize]));
        let is_explained = explainer.explains(
            corners,
            cell.iter().all(is_constrained),
            bad.worst_versine(),
        );
        cells[bad.cell] = if is_explained {
            NEAR_ACUTE_LINE
        } else {
            UNEXPLAINED
        };
        if cells[bad.cell] == UNEXPLAINED {
            unexplained.push(bad);
        }
    }
    let count = |class: u8| cells.iter().filter(|&&cell| cell == class).count();
    let worst = (unexplained.iter()).min_by(|a, b| a.worst_versine().total_cmp(&b.worst_versine()));
    let worst = worst.map(|bad| {
        let worst = Worst {
            cell: view.first_cell + bad.cell,
            centroid: centroid(mesh, bad.cell),
            smallest: angle_from_versine(f64::from(bad.small)),
            largest: 180.0 - angle_from_versine(f64::from(bad.large)),
        };
        (bad.worst_versine(), worst)
    });
    let local = ([OK, NEAR_ACUTE_LINE, UNEXPLAINED].map(count), worst);
    let ([ok, near_acute_line, unexplained], worst) =
        view.merge_parts("verdicts on angles", local, |(counts, worst), other| {
            let counts: [usize; 3] = std::array::from_fn(|class| counts[class] + other.0[class]);
            let worst = (worst.into_iter().chain(other.1))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cell.cmp(&b.1.cell)));
            (counts, worst)
        })?;
    let angles = Angles {
        ok,
        near_acute_line,
        unexplained,
        worst_unexplained: worst.map(|(_, worst)| worst),
        acute_lines: acute.lines,
    };
    Ok(AngleAssessment {
        angles,
        cell_classes: cells,
    })
}

/// Returns the cells with an angle out of range, ascending.
fn bad_cells<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<BadCell> {
    let limit = versine(MIN_ANGLE);
    let chunk_bad_cells = |chunk: usize| {
        let first = chunk * CELLS_PER_TASK;
        let (mut bad_cells, mut cell) = (Vec::new(), first);
        mesh.shapes(first..mesh.len().min(first + CELLS_PER_TASK), |shape| {
            let cosines = shape.cosines.as_ref();
            let bad = BadCell {
                cell,
                small: (1.0 - max_value(cosines)) as f32,
                large: (1.0 + min_value(cosines)) as f32,
            };
            if f64::from(bad.worst_versine()) < limit {
                bad_cells.push(bad);
            }
            cell += 1;
        });
        bad_cells
    };
    let chunks = (0..mesh.len().div_ceil(CELLS_PER_TASK)).into_par_iter();
    chunks.flat_map_iter(chunk_bad_cells).collect()
}

/// Edge of an acute line.
struct AcuteSegment<const D: usize> {
    /// Global numbers of the ends, and their positions.
    nodes: [u32; 2],
    ends: [[f64; D]; 2],
    /// Angle of the line there, in degrees.
    angle: f64,
    /// Distance from the edge up to which angles are explained.
    reach: f64,
}

impl<const D: usize> AcuteSegment<D> {
    /// Returns the squared distance of a point from the edge.
    fn squared_distance(&self, x: [f64; D]) -> f64 {
        let [a, b] = self.ends;
        let (direction, offset) = (sub(b, a), sub(x, a));
        let squared_length = dot(direction, direction);
        let fraction = if squared_length > 0.0 {
            dot(offset, direction) / squared_length
        } else {
            0.0
        };
        distance2(&x, &add_scaled(a, fraction.clamp(0.0, 1.0), direction))
    }
}

/// Acute lines of a mesh, with a search structure to find the angles that they explain.
struct AngleExplainer<const D: usize> {
    segments: Vec<AcuteSegment<D>>,
    midpoints: CellList<D>,
    /// Maximum distance between the midpoint of an edge and a point within the reach of the edge.
    max_reach: f64,
}

impl<const D: usize> AngleExplainer<D> {
    /// Creates an explainer from acute lines.
    fn from_lines(lines: &AcuteLines<D>) -> Self {
        let distance = |n: u32| lines.distance[n as usize];
        let edges = (lines.lines.iter()).flat_map(|line| line.edges(&lines.nodes, &distance));
        let to_segment = |edge: AcuteEdge| AcuteSegment {
            nodes: edge.nodes.map(|n| lines.global_nodes[n as usize]),
            ends: edge.nodes.map(|n| lines.nodes[n as usize]),
            angle: edge.angle,
            reach: INFLUENCE_RADIUS * 0.5 * edge.nodes.map(distance).iter().sum::<f64>(),
        };
        Self::new(edges.map(to_segment).collect())
    }

    fn new(segments: Vec<AcuteSegment<D>>) -> Self {
        let midpoint = |segment: &AcuteSegment<D>| {
            let [a, b] = segment.ends;
            add_scaled(a, 0.5, sub(b, a))
        };
        let midpoints: Vec<[f64; D]> = segments.iter().map(midpoint).collect();
        let reaches = segments.iter().map(|segment| {
            let [a, b] = segment.ends;
            segment.reach + 0.5 * distance2(&a, &b).sqrt()
        });
        let max_reach = reaches.fold(0.0, f64::max);
        Self {
            midpoints: CellList::new(&midpoints, max_reach.max(1e-9)),
            segments,
            max_reach,
        }
    }

    /// Returns `true` if a cell is near a line that explains its worst angle, whose versine is
    /// `worst_versine`. `cell` has the global number and the position of each node.
    /// `is_constrained` is `true` if all nodes are on features or sides of the box.
    fn explains(
        &self,
        mut cell: impl Iterator<Item = (u32, [f64; D])>,
        is_constrained: bool,
        worst_versine: f32,
    ) -> bool {
        if self.segments.is_empty() {
            return false;
        }
        cell.any(|(n, x)| {
            let mut is_explained = false;
            self.midpoints.visit_within(x, self.max_reach, |i| {
                let segment = &self.segments[i];
                let is_in_wedge =
                    || is_constrained && segment.squared_distance(x) <= segment.reach.powi(2);
                is_explained = is_explained
                    || (f64::from(worst_versine) >= versine(MIN_ANGLE_RATIO * segment.angle)
                        && (segment.nodes.contains(&n) || is_in_wedge()));
            });
            is_explained
        })
    }
}

/// Returns the mean length of the edges of cells at each node. It approximates d if the mesh does
/// not store d.
pub fn mean_edge_lengths<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<f64> {
    let nodes = mesh.nodes();
    let mut sums = vec![(0.0, 0.0); nodes.len()];
    for c in 0..mesh.len() {
        let cell = mesh.cell(c);
        for (i, &a) in cell.iter().enumerate() {
            for &b in &cell[i + 1..] {
                let length = distance2(&nodes[a as usize], &nodes[b as usize]).sqrt();
                for node in [a, b] {
                    let (sum, count) = &mut sums[node as usize];
                    *sum += length;
                    *count += 1.0;
                }
            }
        }
    }
    (sums.iter())
        .map(|&(sum, count)| if count > 0.0 { sum / count } else { 0.0 })
        .collect()
}

#[cfg(test)]
#[path = "angles_tests.rs"]
mod tests;
