//! Atoms come, go and move in a part of a mesh, whose outer faces stay what they are: each of them
//! by a change that leaves a valid mesh, so that the part always fits the rest. Then all that
//! [`improve`](super::improve) does.

use super::{TetImprover, smooth};
use crate::error::{Error, cause};
use crate::geometry::{norm, sub, volume6};
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{ReshapeError, ReshapeRequest, ReshapeResult, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::{self, NONE};
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;

/// Reshapes a part of a mesh: new nodes are put in, others collapsed into a neighbour, and all moved
/// towards their targets as far as the mesh allows.
///
/// # Errors
/// The node that cannot be put where it must be, or cannot go; or that the part is no mesh.
pub fn reshape(
    part: TetMesh,
    wanted: &ReshapeRequest<3>,
    extent: [f64; 3],
    sheets: &FeaturePlanes,
    distance: &Distance<3>,
    target: &Target,
) -> Result<ReshapeResult<TetMesh>, ReshapeError> {
    let ReshapeRequest {
        targets,
        kinds,
        is_removed: gone,
    } = wanted;
    let count = part.nodes.len();
    let neighbors = complex::neighbors(count, &part.tets).map_err(|face| {
        ReshapeError::Mesh(Error::Mesh(cause(
            format!("face {face:?}"),
            "belongs to more than two tetrahedra",
            "mesh the image again",
        )))
    })?;
    let target = target.min_dihedral.to_radians().sin();
    let own = &kinds[..count];
    let mut improver = TetImprover::new(
        part,
        neighbors,
        own,
        extent,
        sheets,
        distance,
        target,
        &CancelToken::never(),
    );
    // Nodes move before edges are searched.
    improver.proximities = Vec::new();
    for node in count..targets.len() {
        let (hold, _) = NodeConstraint::new(targets[node], kinds[node], extent, sheets);
        if !improver.insert_node(targets[node], hold) {
            return Err(ReshapeError::Node(node as u32));
        }
    }
    for node in (0..gone.len()).filter(|&n| gone[n]) {
        if !improver.remove_node(node as u32) {
            return Err(ReshapeError::Node(node as u32));
        }
    }
    improver.move_to_targets(wanted);
    let astray = |&n: &usize| {
        !gone[n] && kinds[n] == AtomKind::Fixed && improver.complex.nodes[n] != targets[n]
    };
    if let Some(node) = (0..targets.len()).find(astray) {
        return Err(ReshapeError::Node(node as u32));
    }
    let outcome = improver
        .improve(&CancelToken::never())
        .map_err(ReshapeError::Mesh)?;
    let finished = improver.finish(kinds);
    Ok(ReshapeResult {
        mesh: finished.mesh,
        kinds: finished.kinds,
        request_nodes: finished.old_ids,
        feature_faces: finished.feature_faces,
        report: outcome,
    })
}

/// How to look for a cavity that a new node can see: whether it begins with all tetrahedra whose
/// circumsphere holds the node, or only with the one that holds it; and the least sine of what
/// fills it.
const CAVITY_RULES: [(bool, f64); 6] = [
    (true, 0.1),
    (false, 0.1),
    (true, 0.03),
    (false, 0.03),
    (true, 0.003),
    (false, 0.003),
];

/// Sines above which collapsing a node is welcome, less welcome and so on.
const COLLAPSE_SINES: [f64; 5] = [0.25, 0.1, 0.03, 0.01, 0.003];

/// How often a node is dragged towards neighbours to have it collapse into one, and how far at most.
const MAX_DRAGS: usize = 12;
const DRAG_FRACTIONS: [f64; 3] = [0.8, 0.6, 0.4];

/// A step towards a target may leave tetrahedra as flat as this.
const MIN_STEP_SINE: f64 = 0.03;

/// Rounds of steps, with flips in between.
const MAX_ROUNDS: usize = 24;

/// A position whose least share of a tetrahedron is no more than this may be on a face of it.
const ON_FACE_TOLERANCE: f64 = 1e-6;

/// A cavity is given up when it has been changed so often.
const MAX_CAVITY_CHANGES: usize = 200;

impl TetImprover<'_> {
    /// Puts a new node at `x`. False if there is no tetrahedron for it, or none can be made.
    fn insert_node(&mut self, x: [f64; 3], hold: NodeConstraint) -> bool {
        let new = self.complex.nodes.len() as u32;
        self.complex.add_node(x);
        self.constraints.push(hold);
        let home = self.containing_tet(x);
        for (delaunay, floor) in CAVITY_RULES {
            if let Some(cavity) = home.and_then(|home| self.cavity(home, new, delaunay, floor)) {
                self.commit(&cavity);
                return true;
            }
        }
        self.complex.truncate_nodes(new as usize);
        self.constraints.pop();
        false
    }

    /// The tetrahedron that holds a position, if one does to rounding: of several the one that it lies
    /// deepest in.
    fn containing_tet(&self, x: [f64; 3]) -> Option<u32> {
        let near = match self.walk(x) {
            Some(found) if self.min_barycentric(found, x) > ON_FACE_TOLERANCE => {
                return Some(found);
            }
            Some(found) => self.all_containing_tets(found, x),
            // The part may have dents that no straight way leads through.
            None => (0..self.complex.tets.len() as u32)
                .filter(|&t| self.complex.is_alive(t))
                .collect(),
        };
        near.into_iter()
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

    /// The least of the shares by which the corners of a tetrahedron make a position: not negative
    /// inside.
    fn min_barycentric(&self, t: u32, x: [f64; 3]) -> f64 {
        let shares = self.scaled_barycentric(t, x).into_iter();
        shares.fold(f64::INFINITY, f64::min) / volume6(&self.complex.corners(t))
    }

    /// The shares, times six times the volume.
    fn scaled_barycentric(&self, t: u32, x: [f64; 3]) -> [f64; 4] {
        let p = self.complex.corners(t);
        std::array::from_fn(|k| {
            let mut p = p;
            p[k] = x;
            volume6(&p)
        })
    }

    /// Goes from one tetrahedron to the next, each time through the face beyond which a position is
    /// farthest, to the one that holds it: from those made last, as new nodes are often next to each
    /// other. `None` if that leads out of the part, or nowhere.
    fn walk(&self, x: [f64; 3]) -> Option<u32> {
        let count = self.complex.tets.len() as u32;
        let alive = |&t: &u32| t < count && self.complex.is_alive(t);
        let mut at = self.slots.iter().copied().chain(0..count).find(alive)?;
        for _ in 0..count {
            let shares = self.scaled_barycentric(at, x);
            let beyond = (0..4)
                .filter(|&k| shares[k] < 0.0)
                .map(|k| (shares[k], self.complex.neighbors[at as usize][k]))
                .filter(|(_, next)| *next != NONE)
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match beyond {
                Some((_, next)) => at = next,
                None => {
                    let inside = self.min_barycentric(at, x) > -ON_FACE_TOLERANCE;
                    return inside.then_some(at);
                }
            }
        }
        None
    }

    /// The tetrahedra that hold a position to rounding, as `first` does, in rising order.
    fn all_containing_tets(&self, first: u32, x: [f64; 3]) -> Vec<u32> {
        let mut found = vec![first];
        let mut next = 0;
        while next < found.len() {
            for n in self.complex.neighbors[found[next] as usize] {
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

    /// Tetrahedra round `home` all of whose outer faces the new node sees so well that the smallest
    /// sine of what it spans with them, left in `fresh`, is above `floor`.
    pub(super) fn cavity(
        &mut self,
        home: u32,
        new: u32,
        delaunay: bool,
        floor: f64,
    ) -> Option<Vec<u32>> {
        let x = self.complex.nodes[new as usize];
        let mut cavity = vec![home];
        let mut next = 0;
        while delaunay && next < cavity.len() {
            for k in 0..4 {
                if let Some(n) = self.complex.neighbor(cavity[next], k)
                    && !cavity.contains(&n)
                    && is_in_circumsphere(&self.complex.corners(n), x)
                {
                    cavity.push(n);
                }
            }
            next += 1;
        }
        // Tetrahedra that x lies in, or on the rim of, must be in the cavity.
        let mut needed = vec![home];
        for _ in 0..MAX_CAVITY_CHANGES {
            match self.first_invisible_face(&cavity, new, floor) {
                None => return self.fills_cavity(&cavity).then_some(cavity),
                Some((t, k)) if needed.contains(&t) => {
                    let beyond = self.complex.neighbor(t, k)?;
                    needed.push(beyond);
                    if !cavity.contains(&beyond) {
                        cavity.push(beyond);
                    }
                }
                Some((t, _)) => cavity.retain(|&other| other != t),
            }
        }
        None
    }

    /// Spans tetrahedra from the node to the cavity's outer faces, into `fresh`. Gives the first face
    /// that it does not see well enough: its tetrahedron, and its number there.
    fn first_invisible_face(
        &mut self,
        cavity: &[u32],
        new: u32,
        floor: f64,
    ) -> Option<(u32, usize)> {
        self.new_tets.clear();
        for &t in cavity {
            for k in 0..4 {
                let beyond = self.complex.neighbors[t as usize][k];
                if cavity.contains(&beyond) {
                    continue;
                }
                let tet = self.complex.tets[t as usize];
                let [a, b, c] = FACES[k].map(|i| tet[i]);
                // In a side of the box the node lies among the others.
                if beyond == NONE && self.is_in_side(&[a, b, c, new]) {
                    continue;
                }
                let mut spanned = tet;
                spanned[k] = new;
                if min_sine(&spanned.map(|n| self.complex.nodes[n as usize])) <= floor {
                    return Some((t, k));
                }
                self.new_tets.push(spanned);
            }
        }
        None
    }

    /// Whether `fresh` fills the cavity and has all of its nodes.
    fn fills_cavity(&self, cavity: &[u32]) -> bool {
        let volume = |tet: [u32; 4]| volume6(&tet.map(|n| self.complex.nodes[n as usize]));
        let old: f64 = cavity
            .iter()
            .map(|&t| volume(self.complex.tets[t as usize]))
            .sum();
        let new: f64 = self.new_tets.iter().map(|&tet| volume(tet)).sum();
        let has = |n: u32| self.new_tets.iter().any(|tet| tet.contains(&n));
        let mut nodes = cavity.iter().flat_map(|&t| self.complex.tets[t as usize]);
        (old - new).abs() <= 1e-9 * old && nodes.all(has)
    }

    /// Collapses a node into the neighbour that leaves the best tetrahedra.
    fn remove_node(&mut self, node: u32) -> bool {
        self.constraints[node as usize].clear_surfaces();
        for easing in 0..MAX_DRAGS {
            let x = self.complex.nodes[node as usize];
            self.complex.star(node, &mut self.star);
            let mut around: Vec<u32> = (self.star.iter())
                .flat_map(|&t| self.complex.tets[t as usize])
                .filter(|&n| n != node)
                .collect();
            around.sort_unstable();
            around.dedup();
            around.sort_by(|&a, &b| {
                let gap = |n: u32| norm(sub(self.complex.nodes[n as usize], x));
                gap(a).total_cmp(&gap(b))
            });
            for floor in COLLAPSE_SINES {
                for features_first in [true, false] {
                    if (around.iter()).any(|&n| self.collapse_if(node, n, floor, features_first)) {
                        self.flip_queue(&CancelToken::never());
                        return true;
                    }
                }
            }
            self.drag_node(node, &around, easing);
        }
        false
    }

    /// Moves a node most of the way to the nearest neighbour (or the `nth` next) into which it may
    /// collapse, with flips of what that makes flat: in a regular lattice no collapse is possible at
    /// once, for the faces round an atom lie in one plane with its neighbours.
    fn drag_node(&mut self, node: u32, around: &[u32], nth: usize) {
        let hold = self.constraints[node as usize];
        let from = self.complex.nodes[node as usize];
        self.gather_star(node);
        let mut left = nth;
        for &n in around {
            let to = self.complex.nodes[n as usize];
            let off_side = (0..3).any(|k| hold.fixed_axes >> k & 1 == 1 && from[k] != to[k]);
            if off_side || !hold.is_subset_of(&self.constraints[n as usize]) {
                continue;
            }
            let on_the_way = |share: &f64| -> [f64; 3] {
                std::array::from_fn(|k| from[k] + share * (to[k] - from[k]))
            };
            let sound =
                |x: &[f64; 3]| smooth::worst_sine(*x, &self.link, MIN_STEP_SINE) > MIN_STEP_SINE;
            let Some(x) = DRAG_FRACTIONS.iter().map(on_the_way).find(sound) else {
                continue;
            };
            if left > 0 {
                left -= 1;
                continue;
            }
            // Coordinates in a side stay what they are, to the bit.
            let x = std::array::from_fn(|k| if from[k] == to[k] { from[k] } else { x[k] });
            self.move_to(node, x, hold);
            self.flip_queue(&CancelToken::never());
            return;
        }
    }

    /// Moves nodes towards their targets, with flips of what that makes poor in between.
    fn move_to_targets(&mut self, wanted: &ReshapeRequest<3>) {
        let mut pending: Vec<u32> = (0..wanted.targets.len())
            .filter(|&n| !wanted.is_removed[n] && self.complex.nodes[n] != wanted.targets[n])
            .map(|n| n as u32)
            .collect();
        for _ in 0..MAX_ROUNDS {
            let before = pending.len();
            let mut moved = false;
            pending.retain(|&node| {
                let (went, arrived) = self.step_towards(node, wanted);
                moved |= went;
                !arrived
            });
            self.flip_queue(&CancelToken::never());
            if pending.is_empty() || (!moved && pending.len() == before) {
                return;
            }
        }
    }

    /// Goes to the target, or as far towards it as leaves no tetrahedron flat. Whether the node has
    /// moved, and whether it is there.
    fn step_towards(&mut self, node: u32, wanted: &ReshapeRequest<3>) -> (bool, bool) {
        let n = node as usize;
        let (from, to) = (self.complex.nodes[n], wanted.targets[n]);
        self.gather_star(node);
        let here = smooth::worst_sine(from, &self.link, f64::NEG_INFINITY);
        for share in [1.0, 0.5, 0.25] {
            let x = match share {
                1.0 => to,
                _ => std::array::from_fn(|k| from[k] + share * (to[k] - from[k])),
            };
            // What is flat already may at least not become flatter.
            let floor = MIN_STEP_SINE.min(here);
            if smooth::worst_sine(x, &self.link, floor) > floor {
                let (hold, _) = NodeConstraint::new(x, wanted.kinds[n], self.extent, self.planes);
                self.move_to(node, x, hold);
                return (true, share == 1.0);
            }
        }
        (false, false)
    }
}

/// Whether a position lies inside the sphere through the corners of a positive tetrahedron.
fn is_in_circumsphere(p: &[[f64; 3]; 4], x: [f64; 3]) -> bool {
    let rows = p.map(|q| sub(q, x));
    let square = rows.map(|[a, b, c]| a * a + b * b + c * c);
    // The determinant of (position, square) by its last column.
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
