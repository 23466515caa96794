//! Adds, removes and moves atoms in a part of a mesh, whose outer faces do not change. Each change
//! leaves a valid mesh, so that the part always fits the rest of the mesh. All steps of
//! [`improve`](super::improve) follow.
//!
//! ```text
//!   c---d            c---d      Insertion of x: the tetrahedra whose circumspheres contain x form a
//!  /|\  |\          / \ / \     cavity, which shrinks or grows until x sees each of its outer faces.
//! b | \x| e   ->   b---x---e    Each outer face becomes a tetrahedron with x.
//!  \|  \|/          \ / \ /     Removal: the node collapses into a neighbour, drawn at `collapse`.
//!   g---f            g---f
//! ```

use super::{ImproveContext, TetImprover, smooth};
use crate::error::{Error, cause};
use crate::geometry::{norm, sorted_distinct, sub, volume6};
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{Reshape, ReshapeError, ReshapeRequest, ReshapeResult, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::{self, NONE};
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;

impl Reshape<3> for TetMesh {
    fn reshape(
        &self,
        request: &ReshapeRequest<3>,
        extent: [f64; 3],
        planes: &FeaturePlanes,
        distance: &Distance<3>,
        min_angle: f64,
    ) -> Result<ReshapeResult<Self>, ReshapeError> {
        let context = ImproveContext {
            extent,
            planes,
            distance,
            target: Target {
                min_dihedral: min_angle,
                ..Target::default()
            },
        };
        let ReshapeRequest {
            targets,
            kinds,
            is_removed,
        } = request;
        let count = self.nodes.len();
        let neighbours = complex::neighbours(count, &self.tets).map_err(|face| {
            ReshapeError::Mesh(Error::Mesh(cause(
                format!("face {face:?}"),
                "belongs to more than two tetrahedra",
                "mesh the image again",
            )))
        })?;
        let mut improver = TetImprover::new(
            self.clone(),
            neighbours,
            &kinds[..count],
            context,
            &CancelToken::never(),
        );
        // The proximities are of no use, as nodes move before edges are searched.
        improver.proximities = Vec::new();
        for node in count..targets.len() {
            let (constraint, _) =
                NodeConstraint::new(targets[node], kinds[node], context.extent, context.planes);
            if !improver.insert_node(targets[node], constraint) {
                return Err(ReshapeError::Node(node as u32));
            }
        }
        for node in (0..is_removed.len()).filter(|&n| is_removed[n]) {
            if !improver.remove_node(node as u32) {
                return Err(ReshapeError::Node(node as u32));
            }
        }
        improver.move_to_targets(request);
        let is_off_target = |&n: &usize| {
            !is_removed[n] && kinds[n] == AtomKind::Fixed && improver.complex.nodes[n] != targets[n]
        };
        if let Some(node) = (0..targets.len()).find(is_off_target) {
            return Err(ReshapeError::Node(node as u32));
        }
        let report = improver
            .improve(&CancelToken::never())
            .map_err(ReshapeError::Mesh)?;
        let finished = improver.finish(kinds);
        Ok(ReshapeResult {
            mesh: finished.mesh,
            kinds: finished.kinds,
            request_nodes: finished.old_ids,
            feature_faces: finished.feature_faces,
            report,
        })
    }
}

/// Rules for the search of a cavity around a new node, tried in order. `true` if the cavity begins
/// with all tetrahedra whose circumsphere contains the node, `false` if it begins with the
/// tetrahedron that contains it; and the smallest sine of the new tetrahedra.
const CAVITY_RULES: [(bool, f64); 6] = [
    (true, 0.1),
    (false, 0.1),
    (true, 0.03),
    (false, 0.03),
    (true, 0.003),
    (false, 0.003),
];

/// Smallest sines that a collapse may leave, tried in order.
const COLLAPSE_SINES: [f64; 5] = [0.25, 0.1, 0.03, 0.01, 0.003];

/// Largest number of times that a node is moved towards its neighbours so that it can collapse into
/// one.
const MAX_DRAGS: usize = 12;
/// Fractions of the way to a neighbour that such a move tries.
const DRAG_FRACTIONS: [f64; 3] = [0.8, 0.6, 0.4];

/// Smallest sine that a step towards a target may leave.
const MIN_STEP_SINE: f64 = 0.03;

/// Largest number of rounds of steps, with flips in between.
const MAX_ROUNDS: usize = 24;

/// Largest barycentric coordinate of a position that counts as lying on the opposite face.
const ON_FACE_TOLERANCE: f64 = 1e-6;

/// Largest number of changes of a cavity.
const MAX_CAVITY_CHANGES: usize = 200;

impl TetImprover<'_> {
    /// Inserts a new node at `x`. Returns `false` if no tetrahedron contains it, or no valid cavity
    /// is found.
    fn insert_node(&mut self, x: [f64; 3], constraint: NodeConstraint) -> bool {
        let node = self.complex.nodes.len() as u32;
        self.complex.add_node(x);
        self.constraints.push(constraint);
        let containing = self.containing_tet(x);
        for (use_circumspheres, floor) in CAVITY_RULES {
            if let Some(cavity) =
                containing.and_then(|home| self.cavity(home, node, use_circumspheres, floor))
            {
                self.commit(&cavity);
                return true;
            }
        }
        self.complex.truncate_nodes(node as usize);
        self.constraints.pop();
        false
    }

    /// Returns the tetrahedron that contains a position, within rounding errors; if several do, the
    /// one in which it lies deepest.
    fn containing_tet(&self, x: [f64; 3]) -> Option<u32> {
        let candidates = match self.walk(x) {
            Some(found) if self.min_barycentric(found, x) > ON_FACE_TOLERANCE => {
                return Some(found);
            }
            Some(found) => self.all_containing_tets(found, x),
            // The part may be concave, so that no straight path leads to the position.
            None => (0..self.complex.tets.len() as u32)
                .filter(|&t| self.complex.is_alive(t))
                .collect(),
        };
        candidates
            .into_iter()
            .map(|t| (self.min_barycentric(t, x), t))
            .fold((-1e-9, None), |best, (value, t)| {
                if value > best.0 {
                    (value, Some(t))
                } else {
                    best
                }
            })
            .1
    }

    /// Returns the smallest barycentric coordinate of a position in a tetrahedron. It is not
    /// negative inside.
    fn min_barycentric(&self, t: u32, x: [f64; 3]) -> f64 {
        let coordinates = self.scaled_barycentric(t, x).into_iter();
        coordinates.fold(f64::INFINITY, f64::min) / volume6(&self.complex.corners(t))
    }

    /// Returns the barycentric coordinates, multiplied by six times the volume.
    fn scaled_barycentric(&self, t: u32, x: [f64; 3]) -> [f64; 4] {
        let p = self.complex.corners(t);
        std::array::from_fn(|k| {
            let mut p = p;
            p[k] = x;
            volume6(&p)
        })
    }

    /// Walks from tetrahedron to tetrahedron, each time through the face beyond which the position
    /// is farthest, to the one that contains it. The walk starts at the newest tetrahedra, as new
    /// nodes are often next to each other. Returns `None` if it leads out of the part, or does not
    /// end.
    fn walk(&self, x: [f64; 3]) -> Option<u32> {
        let count = self.complex.tets.len() as u32;
        let alive = |&t: &u32| t < count && self.complex.is_alive(t);
        let mut current = self.slots.iter().copied().chain(0..count).find(alive)?;
        for _ in 0..count {
            let coordinates = self.scaled_barycentric(current, x);
            let next_face = (0..4)
                .filter(|&k| coordinates[k] < 0.0)
                .map(|k| (coordinates[k], self.complex.neighbours[current as usize][k]))
                .filter(|(_, next)| *next != NONE)
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match next_face {
                Some((_, next)) => current = next,
                None => {
                    let inside = self.min_barycentric(current, x) > -ON_FACE_TOLERANCE;
                    return inside.then_some(current);
                }
            }
        }
        None
    }

    /// Returns the tetrahedra that contain a position within rounding errors, as `first` does, in
    /// rising order.
    fn all_containing_tets(&self, first: u32, x: [f64; 3]) -> Vec<u32> {
        let mut found = vec![first];
        let mut next = 0;
        while next < found.len() {
            for n in self.complex.neighbours[found[next] as usize] {
                if n != NONE
                    && !found.contains(&n)
                    && self.min_barycentric(n, x) > -ON_FACE_TOLERANCE
                {
                    found.push(n);
                }
            }
            next += 1;
        }
        found.sort_unstable();
        found
    }

    /// Finds tetrahedra around `start_tet` such that the new node and each outer face of this
    /// cavity span a tetrahedron with a smallest sine above `floor`. The new tetrahedra are left in
    /// `new_tets`.
    pub(super) fn cavity(
        &mut self,
        start_tet: u32,
        node: u32,
        use_circumspheres: bool,
        floor: f64,
    ) -> Option<Vec<u32>> {
        let x = self.complex.nodes[node as usize];
        let mut cavity = vec![start_tet];
        let mut next = 0;
        while use_circumspheres && next < cavity.len() {
            for k in 0..4 {
                if let Some(n) = self.complex.neighbour(cavity[next], k)
                    && !cavity.contains(&n)
                    && is_in_circumsphere(&self.complex.corners(n), x)
                {
                    cavity.push(n);
                }
            }
            next += 1;
        }
        // Tetrahedra that contain x, also on their faces, must stay in the cavity.
        let mut needed = vec![start_tet];
        for _ in 0..MAX_CAVITY_CHANGES {
            match self.first_invisible_face(&cavity, node, floor) {
                None => return self.fills_cavity(&cavity).then_some(cavity),
                Some((t, k)) if needed.contains(&t) => {
                    let neighbour = self.complex.neighbour(t, k)?;
                    needed.push(neighbour);
                    if !cavity.contains(&neighbour) {
                        cavity.push(neighbour);
                    }
                }
                Some((t, _)) => cavity.retain(|&other| other != t),
            }
        }
        None
    }

    /// Spans tetrahedra from the node to the outer faces of the cavity, into `new_tets`. Returns
    /// the first face for which the new tetrahedron is too flat: its tetrahedron, and its index
    /// there.
    fn first_invisible_face(
        &mut self,
        cavity: &[u32],
        node: u32,
        floor: f64,
    ) -> Option<(u32, usize)> {
        self.new_tets.clear();
        for &t in cavity {
            for k in 0..4 {
                let neighbour = self.complex.neighbours[t as usize][k];
                if cavity.contains(&neighbour) {
                    continue;
                }
                let tet = self.complex.tets[t as usize];
                let [a, b, c] = FACES[k].map(|i| tet[i]);
                // In a side of the box, the node lies in the plane of the face.
                if neighbour == NONE && self.is_in_side(&[a, b, c, node]) {
                    continue;
                }
                let mut spanned = tet;
                spanned[k] = node;
                if min_sine(&spanned.map(|n| self.complex.nodes[n as usize])) <= floor {
                    return Some((t, k));
                }
                self.new_tets.push(spanned);
            }
        }
        None
    }

    /// Returns `true` if `new_tets` fills the cavity and has all of its nodes.
    fn fills_cavity(&self, cavity: &[u32]) -> bool {
        let volume = |tet: [u32; 4]| volume6(&tet.map(|n| self.complex.nodes[n as usize]));
        let old: f64 = cavity
            .iter()
            .map(|&t| volume(self.complex.tets[t as usize]))
            .sum();
        let new: f64 = self.new_tets.iter().map(|&tet| volume(tet)).sum();
        let is_used = |n: u32| self.new_tets.iter().any(|tet| tet.contains(&n));
        let mut nodes = cavity.iter().flat_map(|&t| self.complex.tets[t as usize]);
        (old - new).abs() <= 1e-9 * old && nodes.all(is_used)
    }

    /// Collapses a node into the neighbour that leaves the best tetrahedra.
    fn remove_node(&mut self, node: u32) -> bool {
        self.constraints[node as usize].clear_surfaces();
        for drag in 0..MAX_DRAGS {
            let x = self.complex.nodes[node as usize];
            self.complex.star(node, &mut self.star);
            let mut around = sorted_distinct(
                (self.star.iter())
                    .flat_map(|&t| self.complex.tets[t as usize])
                    .filter(|&n| n != node),
            );
            around.sort_by(|&a, &b| {
                let distance = |n: u32| norm(sub(self.complex.nodes[n as usize], x));
                distance(a).total_cmp(&distance(b))
            });
            for floor in COLLAPSE_SINES {
                for features_first in [true, false] {
                    if (around.iter()).any(|&n| self.collapse_if(node, n, floor, features_first)) {
                        self.flip_queue(&CancelToken::never());
                        return true;
                    }
                }
            }
            self.drag_node(node, &around, drag);
        }
        false
    }

    /// Moves a node most of the way to the nearest neighbour (or the `nth` next) into which it may
    /// collapse, and flips the tetrahedra that become flat. In a regular lattice no collapse is
    /// possible without this, as the faces around an atom lie in one plane with its neighbours.
    fn drag_node(&mut self, node: u32, around: &[u32], nth: usize) {
        let constraint = self.constraints[node as usize];
        let from = self.complex.nodes[node as usize];
        self.gather_star(node);
        let mut to_skip = nth;
        for &n in around {
            let to = self.complex.nodes[n as usize];
            let is_allowed = constraint.allows_move(from, to)
                && constraint.is_subset_of(&self.constraints[n as usize], sub(to, from));
            if !is_allowed {
                continue;
            }
            let point_at = |fraction: &f64| -> [f64; 3] {
                std::array::from_fn(|k| from[k] + fraction * (to[k] - from[k]))
            };
            let is_sound =
                |x: &[f64; 3]| smooth::worst_sine(*x, &self.link, MIN_STEP_SINE) > MIN_STEP_SINE;
            let Some(x) = DRAG_FRACTIONS.iter().map(point_at).find(is_sound) else {
                continue;
            };
            if to_skip > 0 {
                to_skip -= 1;
                continue;
            }
            // Coordinates in a side of the box must not change, not even by rounding.
            let x = std::array::from_fn(|k| if from[k] == to[k] { from[k] } else { x[k] });
            self.move_to(node, x, constraint);
            self.flip_queue(&CancelToken::never());
            return;
        }
    }

    /// Moves nodes towards their targets, with flips of the tetrahedra that fall below target in
    /// between.
    fn move_to_targets(&mut self, request: &ReshapeRequest<3>) {
        let mut pending: Vec<u32> = (0..request.targets.len())
            .filter(|&n| !request.is_removed[n] && self.complex.nodes[n] != request.targets[n])
            .map(|n| n as u32)
            .collect();
        for _ in 0..MAX_ROUNDS {
            let before = pending.len();
            let mut moved = false;
            pending.retain(|&node| {
                let (has_moved, has_arrived) = self.step_towards(node, request);
                moved |= has_moved;
                !has_arrived
            });
            self.flip_queue(&CancelToken::never());
            if pending.is_empty() || (!moved && pending.len() == before) {
                return;
            }
        }
    }

    /// Moves a node to its target, or as far towards it as leaves no tetrahedron flat. Returns
    /// `true` if the node has moved, and `true` if it has arrived.
    fn step_towards(&mut self, node: u32, request: &ReshapeRequest<3>) -> (bool, bool) {
        let n = node as usize;
        let (from, to) = (self.complex.nodes[n], request.targets[n]);
        self.gather_star(node);
        let current_sine = smooth::worst_sine(from, &self.link, f64::NEG_INFINITY);
        for fraction in [1.0, 0.5, 0.25] {
            let x = match fraction {
                1.0 => to,
                _ => std::array::from_fn(|k| from[k] + fraction * (to[k] - from[k])),
            };
            // A tetrahedron that is flat already must at least not become flatter.
            let floor = MIN_STEP_SINE.min(current_sine);
            if smooth::worst_sine(x, &self.link, floor) > floor {
                let (constraint, _) =
                    NodeConstraint::new(x, request.kinds[n], self.extent, self.planes);
                self.move_to(node, x, constraint);
                return (true, fraction == 1.0);
            }
        }
        (false, false)
    }
}

/// Returns `true` if a position lies inside the sphere through the corners of a positive
/// tetrahedron.
fn is_in_circumsphere(p: &[[f64; 3]; 4], x: [f64; 3]) -> bool {
    let rows = p.map(|q| sub(q, x));
    let square = rows.map(|[a, b, c]| a * a + b * b + c * c);
    // The determinant of (position, square), expanded by its last column.
    let minor = |i: usize, j: usize, k: usize| {
        crate::geometry::dot(rows[i], crate::geometry::cross(rows[j], rows[k]))
    };
    let determinant = square[0] * minor(1, 2, 3) - square[1] * minor(0, 2, 3)
        + square[2] * minor(0, 1, 3)
        - square[3] * minor(0, 1, 2);
    determinant > 1e-9 * volume6(p) * square.iter().copied().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
