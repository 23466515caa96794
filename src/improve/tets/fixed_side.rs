//! Makes a Delaunay mesh of a box match given triangles on its sides, and improves it without changing
//! them, so that it fits another mesh that ends there, or copies of itself.
//!
//! The faces of the mesh on that side are a triangulation of the same nodes. Any two triangulations of a
//! convex polygon differ by flips of edges (Lawson 1972). Each missing edge is inserted by flips of the
//! edges that cross it (Sloan 1993). A flip of an edge on the side removes the tetrahedra around it. If
//! no others fill their place, then a new node above the middle of the edge does: as it can be as close to
//! the edge as necessary, all faces of the cavity are visible from it. Improvement then moves that node.
//!
//! ```text
//! the side, from above    section through c and d, the side on top, with a new node x
//!
//!    a           a        c-----*-----d      c-----------d     * is the edge (a, b). Its ring of m
//!   /|\         / \        \   / \   /        \ `-. .-' /      nodes c, r, s, d has m - 1 tetrahedra,
//!  c | d  ->   c---d        \ /   \ /    ->    \   x   /       which become 2 m: one with a and one
//!   \|/         \ /          r-----s            \ / \ /        with b for each of the m edges (c, r),
//!    b           b                               r---s         (r, s), (s, d) and (d, c)
//! ```

use std::collections::{HashMap, VecDeque};

use super::{ImproveContext, TetImprover};
use crate::error::{Error, Result, cause};
use crate::geometry::{add_scaled, cross, dot, norm, sorted, sorted_distinct, sub, unit};
use crate::improve::ImproveReport;
use crate::improve::constraint::NodeConstraint;
use crate::lattice::AtomKind;
use crate::mesh::complex::{NONE, Ring};
use crate::mesh::delaunay::Delaunay;
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;

/// Largest number of tetrahedra around an edge.
const MAX_RING: usize = 1000;

/// Smallest sine of the tetrahedra around an edge on the side after its flip, if those before are better.
/// Improvement follows, so that it may be small.
const FLIP_SINE: f64 = 0.05;

/// Distances of a new node from the middle of an edge, in units of the edge's length, that are tried.
const NODE_HEIGHTS: [f64; 8] = [0.5, 0.3, 0.1, 0.03, 1e-2, 1e-3, 1e-5, 1e-7];

/// Makes the faces of a Delaunay mesh on the upper side of its box, normal to `axis`, equal to
/// `triangles`, and improves the mesh without changing these.
///
/// The mesh fills the box of `context`, and `kinds` are those of its nodes. The nodes of the triangles are
/// all nodes on that side, and are fixed. Returns the improved mesh, in which nodes keep their numbers,
/// unless nodes that are not fixed are removed, and the kinds of its nodes.
///
/// # Errors
/// Returns [`Error::Mesh`] if the triangles do not fit the side.
pub fn improve_beside(
    delaunay: Delaunay,
    kinds: &[AtomKind],
    axis: usize,
    triangles: &[[u32; 3]],
    context: ImproveContext<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(TetMesh, Vec<AtomKind>, ImproveReport)> {
    let Delaunay { mesh, neighbours } = delaunay;
    let mut improver = TetImprover::new(mesh, neighbours, kinds, context, cancel);
    let side = BoxSide {
        axis,
        is_high: true,
    };
    improver.match_side(side, triangles)?;
    // The box ends beyond the side now. So its faces are those where the mesh ends, which do not change.
    improver.extent[axis] *= 2.0;
    let report = improver.improve(cancel)?;
    let finished = improver.finish(kinds);
    Ok((finished.mesh, finished.kinds, report))
}

/// A side of the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoxSide {
    /// The axis to which it is normal.
    pub axis: usize,
    /// `true` for the upper side.
    pub is_high: bool,
}

/// Improves a mesh as [`improve`](super::improve) does, after it has made its faces on sides of the box
/// equal to the triangles that are given for these sides. Improvement does not change them.
///
/// All nodes on these sides are nodes of the triangles, and are fixed. They keep their numbers if they
/// come first.
///
/// # Errors
/// Returns [`Error::Mesh`] if the triangles do not fit a side.
pub fn improve_between(
    mesh: &mut TetMesh,
    neighbours: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    sides: &[(BoxSide, Vec<[u32; 3]>)],
    context: ImproveContext<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let (owned_mesh, owned_neighbours) = (std::mem::take(mesh), std::mem::take(neighbours));
    let mut improver = TetImprover::new(owned_mesh, owned_neighbours, kinds, context, cancel);
    for (side, triangles) in sides {
        improver.match_side(*side, triangles)?;
        improver.frozen_axes |= 1 << side.axis;
    }
    let report = improver.improve(cancel)?;
    let finished = improver.finish(kinds);
    (*mesh, *neighbours, *kinds) = (finished.mesh, finished.neighbours, finished.kinds);
    Ok((report, finished.feature_faces))
}

/// Returns the edges of a triangle.
fn edges_of([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// The triangles of a mesh on one side of its box.
struct SideTriangles {
    side: BoxSide,
    /// For each edge, the nodes opposite it in its one or two triangles.
    opposite_nodes: HashMap<[u32; 2], Vec<u32>>,
}

impl SideTriangles {
    /// Finds the triangles on a side.
    fn new(improver: &TetImprover<'_>, side: BoxSide) -> Self {
        let (complex, axis) = (&improver.complex, side.axis);
        let plane = if side.is_high {
            improver.extent[axis]
        } else {
            0.0
        };
        let is_in_side = |n: &u32| complex.nodes[*n as usize][axis] == plane;
        let mut side = Self {
            side,
            opposite_nodes: HashMap::new(),
        };
        for (tet, neighbours) in complex.tets.iter().zip(&complex.neighbours) {
            for k in (0..4).filter(|&k| neighbours[k] == NONE) {
                let triangle = FACES[k].map(|i| tet[i]);
                if triangle.iter().all(is_in_side) {
                    side.add(triangle);
                }
            }
        }
        side
    }

    fn add(&mut self, triangle: [u32; 3]) {
        let [a, b, c] = triangle;
        for (edge, opposite) in edges_of(triangle).into_iter().zip([c, a, b]) {
            let nodes = self.opposite_nodes.entry(sorted(edge)).or_default();
            nodes.push(opposite);
        }
    }

    fn remove(&mut self, triangle: [u32; 3]) {
        let [a, b, c] = triangle;
        for (edge, opposite) in edges_of(triangle).into_iter().zip([c, a, b]) {
            let edge = sorted(edge);
            if let Some(nodes) = self.opposite_nodes.get_mut(&edge) {
                nodes.retain(|&n| n != opposite);
                if nodes.is_empty() {
                    self.opposite_nodes.remove(&edge);
                }
            }
        }
    }

    /// Returns twice the signed area of a triangle in the side.
    fn area(&self, improver: &TetImprover<'_>, [a, b, c]: [u32; 3]) -> f64 {
        let [a, b, c] = [a, b, c].map(|n| improver.complex.nodes[n as usize]);
        cross(sub(b, a), sub(c, a))[self.side.axis]
    }

    /// Returns `true` if two segments between four different nodes cross.
    fn crosses(&self, improver: &TetImprover<'_>, [a, b]: [u32; 2], [c, d]: [u32; 2]) -> bool {
        let area = |x, y, z| self.area(improver, [x, y, z]);
        area(a, b, c) * area(a, b, d) < 0.0 && area(c, d, a) * area(c, d, b) < 0.0
    }

    /// Returns the edges that cross the segment between two nodes, in order from the first node.
    fn crossing_edges(&self, improver: &mut TetImprover<'_>, target: [u32; 2]) -> Vec<[u32; 2]> {
        let mut star = std::mem::take(&mut improver.star);
        improver.complex.star(target[0], &mut star);
        let around = star.iter().flat_map(|&t| improver.complex.tets[t as usize]);
        let around = sorted_distinct(around.filter(|n| *n != target[0]));
        improver.star = star;
        // The triangle at the first node that the segment enters.
        let mut first = None;
        for n in around {
            let Some(nodes) = self.opposite_nodes.get(&sorted([target[0], n])) else {
                continue;
            };
            let far_edges = nodes.iter().map(|&m| [n, m]);
            first = first.or(far_edges
                .filter(|edge| !edge.contains(&target[1]))
                .find(|edge| self.crosses(improver, *edge, target)));
        }
        let mut crossing = Vec::new();
        let mut last_apex = target[0];
        while let Some(edge) = first {
            crossing.push(sorted(edge));
            let opposite = self.opposite_nodes.get(&sorted(edge));
            let apex = opposite.and_then(|nodes| nodes.iter().find(|n| **n != last_apex));
            let Some(&apex) = apex.filter(|n| **n != target[1]) else {
                break;
            };
            let next = [[edge[0], apex], [apex, edge[1]]].into_iter();
            first = { next }.find(|e| self.crosses(improver, *e, target));
            last_apex = if first.is_some_and(|e| e.contains(&edge[0])) {
                edge[1]
            } else {
                edge[0]
            };
        }
        crossing
    }

    /// Flips edges until the mesh has an edge between two nodes. Returns `false` if that fails.
    fn insert_edge(&mut self, improver: &mut TetImprover<'_>, target: [u32; 2]) -> bool {
        if self.opposite_nodes.contains_key(&target) {
            return true;
        }
        let mut crossing = VecDeque::from(self.crossing_edges(improver, target));
        let mut budget = 10 * crossing.len() * (crossing.len() + 1);
        while let Some(edge) = crossing.pop_front() {
            if budget == 0 {
                return false;
            }
            budget -= 1;
            let Some(&[c, d]) = self.opposite_nodes.get(&edge).map(Vec::as_slice) else {
                return false;
            };
            let diagonal = sorted([c, d]);
            // Only the edges of a convex quadrangle can be exchanged.
            if !self.crosses(improver, edge, diagonal) {
                crossing.push_back(edge);
                continue;
            }
            if !improver.flip_side_edge(edge, self.side) {
                return false;
            }
            let [a, b] = edge;
            self.remove([a, b, c]);
            self.remove([a, b, d]);
            self.add([a, c, d]);
            self.add([b, c, d]);
            if diagonal != target && self.crosses(improver, diagonal, target) {
                crossing.push_back(diagonal);
            }
        }
        self.opposite_nodes.contains_key(&target)
    }
}

impl TetImprover<'_> {
    /// Exchanges edges on a side until its triangles are the given ones.
    fn match_side(&mut self, side: BoxSide, triangles: &[[u32; 3]]) -> Result<()> {
        let mut side = SideTriangles::new(self, side);
        let edges = triangles.iter().flat_map(|t| edges_of(*t));
        for edge in sorted_distinct(edges.map(sorted)) {
            if !side.insert_edge(self, edge) {
                return Err(Error::Mesh(cause(
                    format!("edge {edge:?}"),
                    "cannot be inserted into a side of the box",
                    "choose another distance, and please report it: this is an error in atomesh",
                )));
            }
        }
        Ok(())
    }

    /// Exchanges an edge on a side for the other diagonal of its two triangles. Inserts a node if
    /// necessary.
    fn flip_side_edge(&mut self, [a, b]: [u32; 2], side: BoxSide) -> bool {
        let mut star = std::mem::take(&mut self.star);
        let tet = self.complex.tet_with_edge(a, b, &mut star);
        self.star = star;
        let Some(t) = tet else {
            return false;
        };
        if self.apply_found(
            |s, flip| s.find_edge_removal(t, [a, b], FLIP_SINE, flip),
            None,
        ) {
            return true;
        }
        let mut ring = Ring::default();
        if !self.complex.ring(t, a, b, MAX_RING, &mut ring) || ring.is_closed {
            return false;
        }
        let (first, last) = (ring.nodes[0], ring.nodes[ring.nodes.len() - 1]);
        let Some(middle) = self.crossing_point([a, b], [first, last]) else {
            return false;
        };
        let node = NONE;
        let m = ring.nodes.len();
        let new_tets: Vec<[u32; 4]> = (0..m)
            .map(|i| (ring.nodes[i], ring.nodes[(i + 1) % m]))
            .flat_map(|(r, s)| [[a, node, r, s], [node, b, r, s]])
            .collect();
        let nodes = &self.complex.nodes;
        let length = norm(sub(nodes[a as usize], nodes[b as usize]));
        let sine_at = |x: [f64; 3]| {
            let position = |n| if n == node { x } else { nodes[n as usize] };
            let sines = new_tets.iter().map(|tet| min_sine(&tet.map(position)));
            sines.fold(f64::INFINITY, f64::min)
        };
        // Flat tetrahedra may leave little room above the edge, but more towards the nodes around it.
        let inwards = if side.is_high { -1.0 } else { 1.0 };
        let mut directions = vec![std::array::from_fn(|k| {
            if k == side.axis { inwards } else { 0.0 }
        })];
        let around = &ring.nodes[1..m - 1];
        directions.extend(around.iter().map(|&n| unit(sub(nodes[n as usize], middle))));
        let candidates = directions.iter().flat_map(|&direction| {
            NODE_HEIGHTS.map(|height| add_scaled(middle, height * length, direction))
        });
        let (x, sine) = candidates
            .map(|x| (x, sine_at(x)))
            .fold(
                ([0.0; 3], 0.0),
                |best, other| if other.1 > best.1 { other } else { best },
            );
        if sine <= 0.0 {
            return false;
        }
        self.apply(&ring.tets, &new_tets, Some((x, NodeConstraint::default())));
        true
    }

    /// Returns the point at which the diagonals of a plane quadrangle cross.
    fn crossing_point(&self, [a, b]: [u32; 2], [c, d]: [u32; 2]) -> Option<[f64; 3]> {
        let [a, b, c, d] = [a, b, c, d].map(|n| self.complex.nodes[n as usize]);
        let normal = cross(sub(b, a), sub(d, c));
        let share = dot(cross(sub(c, a), sub(d, c)), normal) / dot(normal, normal);
        let point = std::array::from_fn(|k| a[k] + share * (b[k] - a[k]));
        (share > 0.0 && share < 1.0).then_some(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::improve::Target;
    use crate::improve::feature_planes::FeaturePlanes;
    use crate::lattice::distance::Distance;
    use crate::mesh::check::check;
    use crate::mesh::complex::neighbours;
    use crate::mesh::delaunay::delaunay_with_neighbours;

    const EXTENT: [f64; 3] = [6.0, 6.0, 4.0];

    /// Returns jittered nodes in the box, first those on its upper side along z.
    fn nodes(seed: u64) -> Vec<[f64; 3]> {
        let mut state = seed;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            0.5 * ((state >> 33) as f64 / (1u64 << 31) as f64 - 0.5)
        };
        let mut nodes = Vec::new();
        for i in 0..7 * 7 * 5 {
            let index = [i % 7, i / 7 % 7, 4 - i / 49].map(|c| c as f64);
            nodes.push(std::array::from_fn(|k| {
                let is_free = index[k] > 0.0 && index[k] < EXTENT[k];
                index[k] + if is_free { noise() } else { 0.0 }
            }));
        }
        nodes
    }

    /// Returns the triangles on the upper side, each with its nodes in rising order, sorted.
    fn triangles(mesh: &TetMesh) -> Vec<[u32; 3]> {
        let neighbours = neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
        let mut triangles = Vec::new();
        for (tet, around) in mesh.tets.iter().zip(&neighbours) {
            for k in (0..4).filter(|&k| around[k] == NONE) {
                let mut face = FACES[k].map(|i| tet[i]);
                face.sort_unstable();
                if face.iter().all(|&n| mesh.nodes[n as usize][2] == EXTENT[2]) {
                    triangles.push(face);
                }
            }
        }
        triangles.sort_unstable();
        triangles
    }

    #[test]
    fn a_mesh_takes_any_triangles_on_its_side() {
        for seed in 1..6 {
            let nodes = nodes(seed);
            let delaunay = delaunay_with_neighbours(&nodes).unwrap();
            // Other triangles of the same nodes: the Delaunay triangles of a sheared side. The sums are exact.
            let sheared = nodes[..49].iter().map(|x| [x[0] + x[1], x[1]]);
            let sheared: Vec<[f64; 2]> = sheared.collect();
            let sheared = crate::mesh::delaunay::delaunay_plane(&sheared).unwrap();
            let mut expected = sheared.triangles.clone();
            expected.iter_mut().for_each(|t| t.sort_unstable());
            expected.sort_unstable();
            assert_ne!(triangles(&delaunay.mesh), expected);
            let mut kinds = vec![AtomKind::Interior; delaunay.mesh.nodes.len()];
            kinds[..49].fill(AtomKind::Fixed);
            let context = ImproveContext {
                extent: EXTENT,
                planes: &FeaturePlanes::new(&[], EXTENT, 1.0, 1.0),
                distance: &Distance::Constant(1.0),
                target: Target {
                    min_dihedral: 20.0,
                    ..Target::default()
                },
            };
            let cancel = CancelToken::never();
            let (mesh, kinds, _) =
                improve_beside(delaunay, &kinds, 2, &expected, context, &cancel).unwrap();
            assert_eq!(triangles(&mesh), expected);
            assert_eq!(mesh.nodes[..49], nodes[..49]);
            assert_eq!(kinds.len(), mesh.nodes.len());
            let check = check(&mesh, [0.0; 3], EXTENT, 1e-9);
            assert!(check.passed(), "{check:?}");
        }
    }
}
