//! Sliver exudation after Cheng, Dey, Edelsbrunner, Facello & Teng (2000): points get weights that
//! remove the flattest cells from the weighted Delaunay triangulation.
//!
//! 1. The points of the flattest tetrahedron are tried in turn. As the weight of a point grows, its
//!    star absorbs one neighbouring cell after the other, at the weights at which the point enters
//!    their spheres. All states of the star up to a largest weight are examined.
//! 2. The state with the largest smallest angle is made, if it is better than the present one.
//! 3. This goes on with the next flattest tetrahedron until none below the angle can be improved.
//!
//! The largest weight is a share of the distance to the nearest point, so that every point stays in
//! the triangulation.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use super::native::predicates::orientation;
use super::native::triangulation::{GHOST, Triangulation};
use super::{check_points, native};
use crate::error::Result;
use crate::geometry::{cross, distance2, dot, sorted, sub};
use crate::mesh::quality;

/// Largest weight of a point, as a share of the squared distance to the nearest point.
const MAX_WEIGHT: f64 = 0.2;
/// Largest number of rounds over all flat tetrahedra.
const MAX_ROUNDS: usize = 4;
/// Two weights are different if they differ by more than this share.
const WEIGHT_TOLERANCE: f64 = 1e-9;
/// Smallest improvement of the smallest angle of a star, in degrees.
const MIN_IMPROVEMENT: f64 = 1e-6;

/// Returns the tetrahedra of the Delaunay triangulation of `points` after sliver exudation. Each
/// point of a tetrahedron with a dihedral angle below `angle` degrees gets the weight that
/// maximises the smallest angle at the point. No point moves, and the hull stays.
///
/// The `faces` that are faces of the Delaunay triangulation stay too.
///
/// # Errors
/// Returns the errors of [`delaunay`](super::delaunay).
pub fn exude(points: &[[f64; 3]], faces: &[[u32; 3]], angle: f64) -> Result<Vec<[u32; 4]>> {
    check_points(points)?;
    let triangulation = native::incremental(points)?;
    super::check_all_used(points, &triangulation.tets())?;
    let mut exuder = Exuder::new(triangulation, faces, points.len());
    exuder.run(angle);
    Ok(exuder.triangulation.tets())
}

/// A triangulation whose points get weights.
struct Exuder {
    triangulation: Triangulation<true>,
    /// Faces that stay, by the sorted vertices.
    kept_faces: BTreeSet<[u32; 3]>,
    /// A cell of each vertex.
    cell_of_vertex: Vec<u32>,
    weights: Vec<f64>,
}

/// One state of a star whose point gains weight.
struct Star {
    /// Cells that it replaces: those of the point first, then those that it absorbed.
    cells: Vec<u32>,
    weight: f64,
    /// Smallest dihedral angle in degrees.
    angle: f64,
}

impl Exuder {
    fn new(triangulation: Triangulation<true>, faces: &[[u32; 3]], point_count: usize) -> Self {
        let mut vertex_of_number = vec![GHOST; point_count];
        let mut cell_of_vertex = vec![0; point_count + 1];
        for slot in 0..triangulation.cell_count() as u32 {
            let cell = triangulation.cell(slot);
            if !cell.is_finite() {
                continue;
            }
            for v in cell.vertices {
                vertex_of_number[triangulation.number(v) as usize] = v;
                cell_of_vertex[v as usize] = slot;
            }
        }
        let to_vertices = |face: &[u32; 3]| sorted(face.map(|n| vertex_of_number[n as usize]));
        Self {
            kept_faces: faces.iter().map(to_vertices).collect(),
            cell_of_vertex,
            weights: vec![0.0; point_count + 1],
            triangulation,
        }
    }

    /// Removes as many tetrahedra with angles below `bound` as it can.
    fn run(&mut self, bound: f64) {
        // What could not be improved may be, once its neighbours have changed.
        for _ in 0..MAX_ROUNDS {
            if !self.run_round(bound) {
                return;
            }
        }
    }

    /// Tries all tetrahedra with angles below `bound`, and those that replace them. Returns `true`
    /// if there are improvements.
    fn run_round(&mut self, bound: f64) -> bool {
        let mut has_improved = false;
        // Vertices decide between equal angles, so that every run gives the same result.
        let mut queue = std::collections::BinaryHeap::new();
        let entry = |exuder: &Self, slot: u32| {
            let cell = exuder.triangulation.cell(slot);
            let angle = cell
                .is_finite()
                .then(|| exuder.smallest_angle(cell.vertices))?;
            (angle < bound).then(|| (Reverse(ordered(angle)), Reverse(cell.vertices), slot))
        };
        let slots = 0..self.triangulation.cell_count() as u32;
        queue.extend(slots.filter_map(|slot| entry(self, slot)));
        while let Some((_, Reverse(vertices), slot)) = queue.pop() {
            for vertex in vertices {
                if self.triangulation.cell(slot).vertices != vertices {
                    break;
                }
                if self.improve(vertex) {
                    has_improved = true;
                    let new_cells: Vec<u32> = self.triangulation.new_cells().collect();
                    queue.extend(new_cells.into_iter().filter_map(|slot| entry(self, slot)));
                }
            }
        }
        has_improved
    }

    /// Gives a vertex its best weight. Returns `true` if that improves its star.
    fn improve(&mut self, vertex: u32) -> bool {
        let Some(best) = self.best_star(vertex) else {
            return false;
        };
        self.weights[vertex as usize] = best.weight;
        self.triangulation.replace_star(vertex, &best.cells);
        for slot in self.triangulation.new_cells() {
            for v in self.triangulation.cell(slot).vertices {
                self.cell_of_vertex[v as usize] = slot;
            }
        }
        true
    }

    /// Returns the best state of a vertex's star among those of larger weights, if it is better
    /// than the present one.
    fn best_star(&self, vertex: u32) -> Option<Star> {
        let mut cells = self.cells_of(vertex);
        let present = cells
            .iter()
            .map(|&slot| self.smallest_angle(self.triangulation.cell(slot).vertices));
        let present = present.fold(f64::INFINITY, f64::min);
        // Faces opposite the vertex with the cell beyond, and the angle of the cell that joins them
        // with the vertex; negative if that is not positively oriented.
        let mut faces: Vec<(u32, [u32; 3], f64)> = Vec::new();
        let mut nearest2 = f64::INFINITY;
        let centre = self.triangulation.point(vertex);
        for &slot in &cells {
            let cell = self.triangulation.cell(slot);
            for k in (0..4).filter(|&k| cell.vertices[k] == vertex) {
                let face = cell.face(k);
                faces.push((cell.neighbours[k] >> 2, face, self.join_angle(vertex, face)));
            }
            for v in cell.vertices.into_iter().filter(|&v| v != vertex) {
                nearest2 = nearest2.min(distance2(&self.triangulation.point(v), &centre));
            }
        }
        let max_weight = MAX_WEIGHT * nearest2;
        let mut best: Option<Star> = None;
        let mut reached = self.weights[vertex as usize];
        loop {
            // The cell that is absorbed next.
            let next = (faces.iter().filter(|face| !cells.contains(&face.0)))
                .filter_map(|&(slot, ..)| Some((self.critical_weight(slot, centre)?, slot)))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let next_weight = next.map_or(max_weight, |next| next.0.min(max_weight));
            let angle = faces
                .iter()
                .map(|face| face.2)
                .fold(f64::INFINITY, f64::min);
            let is_state = next_weight > reached + WEIGHT_TOLERANCE * nearest2;
            let bound = best
                .as_ref()
                .map_or(present + MIN_IMPROVEMENT, |best| best.angle);
            if is_state && angle > bound {
                best = Some(Star {
                    cells: cells.clone(),
                    weight: 0.5 * (reached + next_weight),
                    angle,
                });
            }
            let Some((weight, slot)) = next.filter(|next| next.0 < max_weight) else {
                return best;
            };
            // Faces between the cell and the star vanish.
            let cell = *self.triangulation.cell(slot);
            let (inner, outer): (Vec<usize>, Vec<usize>) =
                (0..4).partition(|&k| cells.contains(&(cell.neighbours[k] >> 2)));
            let is_kept = |k: &usize| self.kept_faces.contains(&sorted(cell.face(*k)));
            // A cell with only its apex outside keeps it on the boundary; one that is surrounded on
            // all sides but one hides a vertex.
            if inner.iter().any(is_kept) || inner.len() > 2 {
                return best;
            }
            faces.retain(|face| face.0 != slot);
            for k in outer {
                let face = cell.face(k);
                faces.push((cell.neighbours[k] >> 2, face, self.join_angle(vertex, face)));
            }
            cells.push(slot);
            reached = reached.max(weight);
        }
    }

    /// Returns the cells of a vertex inside the hull.
    fn cells_of(&self, vertex: u32) -> Vec<u32> {
        let mut cells = vec![self.cell_of_vertex[vertex as usize]];
        let mut next = 0;
        while next < cells.len() {
            let cell = self.triangulation.cell(cells[next]);
            next += 1;
            for k in (0..4).filter(|&k| cell.vertices[k] != vertex) {
                let neighbour = cell.neighbours[k] >> 2;
                if self.triangulation.cell(neighbour).is_finite() && !cells.contains(&neighbour) {
                    cells.push(neighbour);
                }
            }
        }
        cells
    }

    /// Returns the weight from which on a point at `x` absorbs a cell; `None` for cells beyond the
    /// hull.
    fn critical_weight(&self, slot: u32, x: [f64; 3]) -> Option<f64> {
        let cell = self.triangulation.cell(slot);
        if !cell.is_finite() {
            return None;
        }
        let [a, b, c, d] = cell.vertices.map(|v| self.triangulation.point(v));
        let [wa, wb, wc, wd] = cell.vertices.map(|v| self.weights[v as usize]);
        let [b, c, d] = [b, c, d].map(|p| sub(p, a));
        let normals = [cross(c, d), cross(d, b), cross(b, c)];
        let lifts = [
            dot(b, b) - wb + wa,
            dot(c, c) - wc + wa,
            dot(d, d) - wd + wa,
        ];
        let scale = 0.5 / dot(b, normals[0]);
        let centre: [f64; 3] =
            std::array::from_fn(|k| scale * (0..3).map(|i| lifts[i] * normals[i][k]).sum::<f64>());
        Some(distance2(&sub(x, a), &centre) - dot(centre, centre) + wa)
    }

    /// Returns the smallest dihedral angle of the tetrahedron that joins a vertex with a face,
    /// negative if it is not positively oriented.
    fn join_angle(&self, vertex: u32, [a, b, c]: [u32; 3]) -> f64 {
        let vertices = [vertex, a, b, c];
        if orientation(vertices.map(|v| self.triangulation.point(v))) <= 0 {
            return -1.0;
        }
        self.smallest_angle(vertices)
    }

    fn smallest_angle(&self, vertices: [u32; 4]) -> f64 {
        let corners = vertices.map(|v| self.triangulation.point(v));
        (quality::dihedral_angles(&corners).into_iter()).fold(f64::INFINITY, f64::min)
    }
}

/// Returns a key with the order of angles, which are not negative.
fn ordered(angle: f64) -> u64 {
    angle.max(0.0).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::grid_index::index_at;
    use crate::mesh::check::check;
    use crate::mesh::delaunay::delaunay;
    use crate::mesh::{FACES, TetMesh, quality};
    use std::collections::{BTreeMap, BTreeSet};

    /// Returns a cubic lattice with flat sides, its inner points moved at random by up to a tenth.
    /// It has slivers wherever the eight points of a cube lie nearly on one sphere.
    fn jittered(n: usize) -> Vec<[f64; 3]> {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut points = Vec::new();
        for i in 0..n.pow(3) {
            let index = index_at([n; 3], i);
            points.push(index.map(|c| {
                let jitter = 0.2 * next();
                let is_inner = c > 0 && c < n - 1;
                c as f64 + if is_inner { jitter } else { 0.0 }
            }));
        }
        points
    }

    fn smallest_angle(mesh: &TetMesh) -> f64 {
        let angles = (0..mesh.tets.len())
            .map(|t| quality::dihedral_angles(&mesh.corners(t)))
            .map(|angles| angles.into_iter().fold(f64::INFINITY, f64::min));
        angles.fold(f64::INFINITY, f64::min)
    }

    fn sorted_faces(tet: &[u32; 4]) -> [[u32; 3]; 4] {
        FACES.map(|face| {
            let mut face = face.map(|k| tet[k]);
            face.sort_unstable();
            face
        })
    }

    #[test]
    fn exudation_removes_slivers_and_keeps_points_hull_and_faces() {
        let nodes = jittered(9);
        let before = TetMesh {
            tets: delaunay(&nodes).unwrap().tets,
            nodes: nodes.clone(),
        };
        let faces_of = |mesh: &TetMesh| -> BTreeSet<[u32; 3]> {
            mesh.tets.iter().flat_map(sorted_faces).collect()
        };
        // The surface from side to side between two layers of tetrahedra: the upper faces of the
        // lower layer.
        let is_below =
            |tet: &[u32; 4]| tet.iter().map(|&n| nodes[n as usize][2]).sum::<f64>() < 16.0;
        let mut counts = BTreeMap::new();
        for tet in before.tets.iter().filter(|tet| is_below(tet)) {
            for face in sorted_faces(tet) {
                *counts.entry(face).or_insert(0) += 1;
            }
        }
        let is_on_side = |face: &[u32; 3]| {
            (0..3).any(|k| {
                [0.0, 8.0]
                    .iter()
                    .any(|&side| face.iter().all(|&n| nodes[n as usize][k] == side))
            })
        };
        let kept_faces: Vec<[u32; 3]> = counts
            .into_iter()
            .filter(|(face, count)| *count == 1 && !is_on_side(face))
            .map(|(face, _)| face)
            .collect();
        assert!(kept_faces.len() > 64);
        let after = TetMesh {
            tets: exude(&nodes, &kept_faces, 30.0).unwrap(),
            nodes: nodes.clone(),
        };
        for mesh in [&before, &after] {
            let report = check(mesh, [0.0; 3], [8.0; 3], 1e-12);
            assert!(report.passed(), "{report:?}");
        }
        let remaining_faces = faces_of(&after);
        assert!(kept_faces.iter().all(|face| remaining_faces.contains(face)));
        let (angle_before, angle_after) = (smallest_angle(&before), smallest_angle(&after));
        assert!(
            angle_before < 1.0 && angle_after > 5.0 * angle_before,
            "{angle_before} to {angle_after}"
        );
    }

    /// Ours leaves as few slivers as CGAL's, up to a tenth.
    #[test]
    #[cfg(feature = "cgal")]
    fn as_many_slivers_are_removed_as_by_cgal() {
        let nodes = jittered(9);
        let slivers_below = |tets: &[[u32; 4]], bound: f64| {
            let corners = |tet: &[u32; 4]| tet.map(|n| nodes[n as usize]);
            let angles = tets
                .iter()
                .map(|tet| quality::dihedral_angles(&corners(tet)));
            let smallest = angles.map(|angles| angles.into_iter().fold(f64::INFINITY, f64::min));
            smallest.filter(|angle| *angle < bound).count()
        };
        let own = exude(&nodes, &[], 30.0).unwrap();
        let by_cgal = super::super::cgal::exude(&nodes, &[], 30.0).unwrap();
        for bound in [5.0, 10.0, 15.0] {
            let counts = [&own, &by_cgal].map(|tets| slivers_below(tets, bound));
            println!("below {bound} degrees: {counts:?}");
            assert!(
                10 * counts[0] <= 11 * counts[1],
                "below {bound} degrees: {counts:?}"
            );
        }
    }

    #[test]
    fn points_that_coincide_are_refused() {
        let mut points = jittered(3);
        points.push(points[4]);
        let error = exude(&points, &[], 30.0).unwrap_err().to_string();
        assert!(error.contains("are 0e0 apart"), "{error}");
        assert!(exude(&[[f64::NAN; 3]], &[], 30.0).is_err());
    }
}
