//! Which bad angles the features themselves explain.
//!
//! Where two sheets, or a sheet and a side of the box, meet at theta, no mesh that holds both has all
//! dihedral angles above theta. So what is promised is: every angle is in [30, 150], except in cells
//! that touch an acute line or lie in its wedge, whose angles are in [s, 180 - s] with s = [`MIN_ANGLE_RATIO`]
//! theta. Every other cell is *unexplained*. A cell lies in the wedge if all its nodes are on features or
//! sides of the box and one is within [`INFLUENCE_RADIUS`] d of the line: farther away the wedge is wide enough for
//! nodes between the two. (Beside a line no more cells are bad than anywhere else at features, as was
//! seen on sheets at 25 degrees to a side: there, all that were bad touched the line.)

use crate::parallel::prelude::*;
use serde::Serialize;

use super::acute::{
    AcuteEdge, AcuteLine, AcuteLines, acute_lines, common_sides, sorted_feature_faces,
};
use super::mesh_faces::MeshFaces;
use super::quality::{CELLS_PER_TASK, Worst, angle_from_versine, centroid, max_value, min_value};
use crate::comm::LocalOrComm;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, sub};
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;

/// Angles shall be at least this, and at most 180 minus it, in degrees.
pub const MIN_ANGLE: f64 = 30.0;
/// How far from the line its wedge is too narrow for nodes in between, in units of d.
pub const INFLUENCE_RADIUS: f64 = 2.0;
/// The share of the line's angle that theirs must have. A wedge of theta is filled with cells of which
/// some have a little less.
pub const MIN_ANGLE_RATIO: f64 = 0.7;

/// What the cell data of a file say of a cell whose angles are all in [30, 150].
pub const OK: u8 = 0;
/// Of one whose angles are not, but which is near an acute line that explains them.
pub const NEAR_ACUTE_LINE: u8 = 1;
/// Of any other.
pub const UNEXPLAINED: u8 = 2;

/// Angles beyond [30, 150], explained. Angles are dihedral in tetrahedra.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Angles {
    /// Cells all of whose angles are in [30, 150] degrees.
    pub ok: usize,
    /// Others near an acute line, whose angles are no worse than it explains.
    pub near_acute_line: usize,
    /// All other cells.
    pub unexplained: usize,
    /// The cell among these whose angles are farthest from 90 degrees.
    pub worst_unexplained: Option<Worst>,
    /// Where features, or a feature and a side of the box, meet at less than 30 degrees.
    pub acute_lines: Vec<AcuteLine>,
}

/// The same with what it says of each cell.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AngleAssessment {
    /// In figures.
    pub angles: Angles,
    /// For each cell 0 (fine), 1 (near an acute line) or 2 (unexplained).
    pub cell_classes: Vec<u8>,
}

/// A cell with an angle out of range, and what its angles need for a cosine of one, as in
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

/// What that of an angle in degrees is.
fn versine(angle: f64) -> f64 {
    1.0 - angle.to_radians().cos()
}

/// Judges the angles of a mesh that fills the box `[0, extent]`. `feature_faces` has a byte for each cell,
/// of which bit k says that face k lies on a feature; it may be empty. `distance` is d at each node.
pub fn assess_angles<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    extent: [f64; D],
    distance: impl Fn(u32) -> f64,
) -> AngleAssessment {
    let Ok(found) =
        assess_partition_angles(&MeshView::from_mesh(mesh), feature_faces, extent, &distance);
    found
}

/// The same of a mesh in parts, on all who hold one; the cells are those of the part, the nodes of lines have the
/// whole's numbers.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn assess_partition_angles<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    part: &MeshView<'_, D, M, H>,
    feature_faces: &[u8],
    extent: [f64; D],
    distance: &dyn Fn(u32) -> f64,
) -> Result<AngleAssessment, H::Error> {
    let (mesh, nodes) = (part.mesh, part.mesh.nodes());
    let faces = sorted_feature_faces(mesh, feature_faces, extent);
    let mut on_feature = vec![false; nodes.len()];
    for &node in faces.iter().flatten() {
        on_feature[node as usize] = true;
    }
    part.combine_shared_marks("nodes on features", &mut on_feature)?;
    let faces = faces.into_iter().map(|face| (face, 1)).collect();
    let surface = MeshFaces::owned_faces("faces on features", part, faces)?;
    let mut found = acute_lines(part, &surface, extent, distance)?;
    drop(surface);
    let explained = AngleExplainer::from_lines(&found);
    for line in &mut found.lines {
        (line.nodes.iter_mut()).for_each(|n| *n = found.global_nodes[*n as usize]);
    }
    let in_side = |n: u32| common_sides(&[nodes[n as usize]], extent).next().is_some();
    let held = |n: &u32| on_feature[*n as usize] || in_side(*n);
    let mut cells = vec![OK; mesh.len()];
    let mut unexplained = Vec::new();
    for bad in bad_cells(mesh) {
        let cell = mesh.cell(bad.cell);
        let corners = cell.iter().map(|&n| (part.global_id(n), nodes[n as usize]));
        cells[bad.cell] =
            match explained.explains(corners, cell.iter().all(held), bad.worst_versine()) {
                true => NEAR_ACUTE_LINE,
                false => UNEXPLAINED,
            };
        if cells[bad.cell] == UNEXPLAINED {
            unexplained.push(bad);
        }
    }
    let count = |verdict: u8| cells.iter().filter(|&&cell| cell == verdict).count();
    let worst = (unexplained.iter()).min_by(|a, b| a.worst_versine().total_cmp(&b.worst_versine()));
    let worst = worst.map(|bad| {
        let worst = Worst {
            cell: part.first_cell + bad.cell,
            centroid: centroid(mesh, bad.cell),
            smallest: angle_from_versine(f64::from(bad.small)),
            largest: 180.0 - angle_from_versine(f64::from(bad.large)),
        };
        (bad.worst_versine(), worst)
    });
    let own = ([OK, NEAR_ACUTE_LINE, UNEXPLAINED].map(count), worst);
    let all = part.comm.try_all_gather("verdicts on angles", own)?;
    let count = |verdict: u8| all.iter().map(|own| own.0[usize::from(verdict)]).sum();
    let worst = (all.iter().filter_map(|own| own.1.as_ref()))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cell.cmp(&b.1.cell)));
    let angles = Angles {
        ok: count(OK),
        near_acute_line: count(NEAR_ACUTE_LINE),
        unexplained: count(UNEXPLAINED),
        worst_unexplained: worst.map(|(_, worst)| worst.clone()),
        acute_lines: found.lines,
    };
    Ok(AngleAssessment {
        angles,
        cell_classes: cells,
    })
}

/// The cells with an angle out of range, rising.
fn bad_cells<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<BadCell> {
    let limit = versine(MIN_ANGLE);
    let of_chunk = |chunk: usize| {
        let first = chunk * CELLS_PER_TASK;
        let (mut found, mut cell) = (Vec::new(), first);
        mesh.shapes(first..mesh.len().min(first + CELLS_PER_TASK), |shape| {
            let cosines = shape.cosines.as_ref();
            let bad = BadCell {
                cell,
                small: (1.0 - max_value(cosines)) as f32,
                large: (1.0 + min_value(cosines)) as f32,
            };
            if f64::from(bad.worst_versine()) < limit {
                found.push(bad);
            }
            cell += 1;
        });
        found
    };
    let chunks = (0..mesh.len().div_ceil(CELLS_PER_TASK)).into_par_iter();
    chunks.flat_map_iter(of_chunk).collect()
}

/// A piece of a line.
struct AcuteSegment<const D: usize> {
    /// The whole mesh's numbers of its ends, and where these are.
    nodes: [u32; 2],
    ends: [[f64; D]; 2],
    /// The line's angle there, in degrees.
    angle: f64,
    /// How far from it angles are explained.
    reach: f64,
}

impl<const D: usize> AcuteSegment<D> {
    /// The square of the distance of a point from it.
    fn squared_distance(&self, x: [f64; D]) -> f64 {
        let [a, b] = self.ends;
        let (along, off) = (sub(b, a), sub(x, a));
        let long = dot(along, along);
        let share = if long > 0.0 {
            dot(off, along) / long
        } else {
            0.0
        };
        distance2(&x, &add_scaled(a, share.clamp(0.0, 1.0), along))
    }
}

/// The lines of a mesh, to be asked what they explain.
struct AngleExplainer<const D: usize> {
    segments: Vec<AcuteSegment<D>>,
    midpoints: CellList<D>,
    /// How far from the middle of any piece a place may be that is in its reach.
    max_reach: f64,
}

impl<const D: usize> AngleExplainer<D> {
    /// What lines explain.
    fn from_lines(found: &AcuteLines<D>) -> Self {
        let distance = |n: u32| found.distance[n as usize];
        let pieces = (found.lines.iter()).flat_map(|line| line.edges(&found.nodes, &distance));
        let stretch = |piece: AcuteEdge| AcuteSegment {
            nodes: piece.nodes.map(|n| found.global_nodes[n as usize]),
            ends: piece.nodes.map(|n| found.nodes[n as usize]),
            angle: piece.angle,
            reach: INFLUENCE_RADIUS * 0.5 * piece.nodes.map(distance).iter().sum::<f64>(),
        };
        Self::new(pieces.map(stretch).collect())
    }

    fn new(segments: Vec<AcuteSegment<D>>) -> Self {
        let middle = |stretch: &AcuteSegment<D>| {
            let [a, b] = stretch.ends;
            add_scaled(a, 0.5, sub(b, a))
        };
        let middles: Vec<[f64; D]> = segments.iter().map(middle).collect();
        let farthest = segments.iter().map(|stretch| {
            let [a, b] = stretch.ends;
            stretch.reach + 0.5 * distance2(&a, &b).sqrt()
        });
        let max_reach = farthest.fold(0.0, f64::max);
        Self {
            midpoints: CellList::new(&middles, max_reach.max(1e-9)),
            segments,
            max_reach,
        }
    }

    /// Whether a cell is near a line that explains its angles, the worse of which has this versine: the whole's
    /// number of each of its nodes, and where this is; `held` says that all are on features or sides of the box.
    fn explains(
        &self,
        mut cell: impl Iterator<Item = (u32, [f64; D])>,
        held: bool,
        versine_of_worse: f32,
    ) -> bool {
        if self.segments.is_empty() {
            return false;
        }
        cell.any(|(n, x)| {
            let mut near = false;
            self.midpoints.visit_within(x, self.max_reach, |i| {
                let stretch = &self.segments[i];
                let within = || held && stretch.squared_distance(x) <= stretch.reach.powi(2);
                near = near
                    || (f64::from(versine_of_worse) >= versine(MIN_ANGLE_RATIO * stretch.angle)
                        && (stretch.nodes.contains(&n) || within()));
            });
            near
        })
    }
}

/// The mean length of the edges of cells at each node: what d is about, where a mesh does not say.
#[cfg(feature = "cli")]
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
