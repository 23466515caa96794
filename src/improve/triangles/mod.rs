//! From a Delaunay triangulation of atoms in the plane to one whose edges lie on the features and
//! whose angles are all large enough.
//!
//! The same rules as in space, and the same code for what holds a node and where the features are:
//! the plane is z = 0, and a curve is a sheet that stands upright on it. Instead of tetrahedra and
//! their many local transformations there are triangles and one flip, so all is simpler:
//!
//! 1. no edge may pass through a curve: such an edge is flipped away, or one of its ends is pulled
//!    onto the curve, or it is split there;
//! 2. other edges are flipped, nodes smoothed (those on a curve along it only), and, where that is
//!    not enough, short edges collapsed and long ones split, whatever raises the smallest angle;
//! 3. where a triangle would be of no use otherwise, its nodes may leave their curves.
//!
//! An angle of at least 30 degrees everywhere means none above 120.
//!
//! - `recover`: no edge passes through a curve
//! - `mend`: angles are raised
//! - `edges`: flips, splits and collapses
//! - `smooth`: a node moves to where it is best
//! - `rework`: a change is tried together with what has to follow for it to pay
//! - `reshape`(fn@reshape): atoms come, go and move in a part of a mesh
//! - `relax`: Laplace's smoothing, before anything else

mod compound;
mod edges;
mod recover;
pub(crate) mod relax;
mod repair;
mod reshape;
mod smooth;

pub use reshape::reshape;

use super::constraint::NodeConstraint;
use super::feature_planes::{FeaturePlanes, MAX_FACE_OFFSET, SAME_SURFACE_COSINE};
use super::intersect::find_intersection;
use super::target::UNUSABLE_ANGLE;
use super::{BlockedCell, ImproveReport, OperationCounts};
use crate::error::{Error, Result, cause};
use crate::geometry::{add_scaled, dot, norm, sub, to_3d};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::TriMesh;
use crate::mesh::complex::NONE;
use crate::mesh::delaunay::delaunay_plane;
use crate::mesh::tri::{SIDES, angles, neighbors, worst_cotangent};
use crate::progress::CancelToken;

/// Which coordinates of each atom may change where what lies on a feature shall stay: 1 for free, 0 for
/// held. Atoms on the sides of the box keep to them.
pub fn mobility(atoms: &Atoms<2>, extent: [f64; 2], sheets: &FeaturePlanes) -> Vec<[f64; 2]> {
    let mut mobility = atoms.mobility(extent);
    for ((free, &x), &kind) in mobility.iter_mut().zip(&atoms.positions).zip(&atoms.kinds) {
        if NodeConstraint::new(to_3d(x), kind, to_3d(extent), sheets)
            .0
            .surface_count
            > 0
        {
            *free = [0.0; 2];
        }
    }
    mobility
}

/// Makes a Delaunay mesh follow the features and raises its smallest angles to `min_angle` degrees
/// where that can be, in place.
///
/// `kinds` says what each node is and follows the nodes that come and go; the result also says
/// for every triangle which of its edges lie on a feature: bit k for edge k (opposite node k). When
/// `patience` is over, the mesh is left as far as it has come.
///
/// # Errors
/// [`Error::Mesh`] if triangles overlap or more than two share an edge; nothing is changed then.
pub fn improve(
    mesh: &mut TriMesh,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 2],
    sheets: &FeaturePlanes,
    distance: &Distance<2>,
    min_angle: f64,
    patience: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let neighbors = adjacency(mesh)?;
    let taken = std::mem::take(mesh);
    let mut improver =
        TriImprover::new(taken, neighbors, kinds, extent, sheets, distance, min_angle);
    let outcome = improver.improve(patience);
    let finished = improver.finish();
    (*mesh, *kinds) = (finished.mesh, finished.kinds);
    Ok((outcome, finished.feature_faces))
}

/// The edges on features of the Delaunay triangulation of atoms, after edges that pass through a curve
/// were flipped where that frees it.
///
/// # Errors
/// Those of [`delaunay_plane`].
pub fn feature_edges(
    atoms: &Atoms<2>,
    extent: [f64; 2],
    sheets: &FeaturePlanes,
    distance: &Distance<2>,
) -> Result<Vec<[u32; 2]>> {
    let mesh = delaunay_plane(&atoms.positions)?;
    let neighbors = adjacency(&mesh)?;
    let (kinds, least) = (&atoms.kinds, UNUSABLE_ANGLE);
    let mut improver = TriImprover::new(mesh, neighbors, kinds, extent, sheets, distance, least);
    improver.flip_intersecting_edges();
    let on_feature = |&[a, b]: &[u32; 2]| improver.is_on_feature(a, b);
    Ok(improver.edges().filter(on_feature).collect())
}

/// Neighbours of every triangle.
fn adjacency(mesh: &TriMesh) -> Result<Vec<[u32; 3]>> {
    neighbors(mesh.nodes.len(), &mesh.triangles).map_err(|edge| {
        Error::Mesh(cause(
            format!("edge {edge:?}"),
            "belongs to more than two triangles, or to two that overlap",
            "mesh the image again",
        ))
    })
}

/// A mesh whose improvement is over.
struct ImprovedTriangles {
    mesh: TriMesh,
    kinds: Vec<AtomKind>,
    /// The number that each node had while the mesh was improved.
    old_ids: Vec<u32>,
    feature_faces: Vec<u8>,
}

struct TriImprover<'a> {
    nodes: Vec<[f64; 2]>,
    /// Node numbers; `NONE` first where the triangle is gone.
    triangles: Vec<[u32; 3]>,
    neighbors: Vec<[u32; 3]>,
    triangle_of_node: Vec<u32>,
    constraints: Vec<NodeConstraint>,
    kinds: Vec<AtomKind>,
    extent: [f64; 2],
    planes: &'a FeaturePlanes,
    distance: &'a Distance<2>,
    /// Triangles with a larger cotangent are of no use.
    max_usable_cotangent: f64,
    /// Largest cotangent that an angle shall have.
    target_cotangent: f64,
    /// Smoothing stops at this one, a little smaller.
    smoothing_target: f64,
    counts: OperationCounts,
    /// Edges to look at, as (triangle, side).
    queue: Vec<(u32, u8)>,
    /// Triangles around a node.
    star: Vec<u32>,
}

impl<'a> TriImprover<'a> {
    fn new(
        mesh: TriMesh,
        neighbors: Vec<[u32; 3]>,
        kinds: &[AtomKind],
        extent: [f64; 2],
        planes: &'a FeaturePlanes,
        distance: &'a Distance<2>,
        min_angle: f64,
    ) -> Self {
        let cotangent = |degrees: f64| 1.0 / degrees.to_radians().tan();
        let TriMesh { nodes, triangles } = mesh;
        let constraints = nodes
            .iter()
            .zip(kinds)
            .map(|(&x, &kind)| NodeConstraint::new(to_3d(x), kind, to_3d(extent), planes).0)
            .collect();
        let mut triangle_of_node = vec![NONE; nodes.len()];
        for (t, triangle) in triangles.iter().enumerate() {
            for &n in triangle {
                triangle_of_node[n as usize] = t as u32;
            }
        }
        Self {
            neighbors,
            nodes,
            triangles,
            triangle_of_node,
            constraints,
            kinds: kinds.to_vec(),
            extent,
            planes,
            distance,
            max_usable_cotangent: cotangent(UNUSABLE_ANGLE),
            target_cotangent: cotangent(min_angle),
            smoothing_target: cotangent((min_angle + SMOOTHING_MARGIN).min(59.0)),
            counts: OperationCounts::default(),
            queue: Vec::new(),
            star: Vec::new(),
        }
    }

    /// All steps, in order.
    fn improve(&mut self, patience: &CancelToken<'_>) -> ImproveReport {
        let poor_before = self.triangles_below_target().len();
        self.recover();
        self.flip_and_smooth(patience);
        self.apply_compound(self.max_usable_cotangent, patience);
        self.release_nodes(patience);
        self.apply_compound(self.target_cotangent, patience);
        let blocked = self.blocked_cells();
        ImproveReport {
            below_target_before: poor_before,
            below_target_after: blocked.len(),
            counts: self.counts,
            blocked,
        }
    }

    /// The compact mesh, and which edges of it lie on features.
    fn finish(self) -> ImprovedTriangles {
        let on_feature = |t: u32| {
            let on = |k: &usize| {
                let [a, b] = SIDES[*k].map(|i| self.triangles[t as usize][i]);
                self.is_on_feature(a, b)
            };
            (0..3).filter(on).fold(0, |bits, k| bits | 1 << k)
        };
        let feature_faces = self.live_triangles().map(on_feature).collect();
        let mut used = vec![false; self.nodes.len()];
        for t in self.live_triangles() {
            for n in self.triangles[t as usize] {
                used[n as usize] = true;
            }
        }
        let kept: Vec<u32> = (0..used.len() as u32)
            .filter(|&n| used[n as usize])
            .collect();
        let mut number = vec![NONE; self.nodes.len()];
        for (new, &n) in kept.iter().enumerate() {
            number[n as usize] = new as u32;
        }
        let triangles = self
            .live_triangles()
            .map(|t| self.triangles[t as usize].map(|n| number[n as usize]))
            .collect();
        ImprovedTriangles {
            mesh: TriMesh {
                nodes: kept.iter().map(|&n| self.nodes[n as usize]).collect(),
                triangles,
            },
            kinds: kept.iter().map(|&n| self.kinds[n as usize]).collect(),
            old_ids: kept,
            feature_faces,
        }
    }

    fn live_triangles(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.triangles.len() as u32).filter(|&t| self.triangles[t as usize][0] != NONE)
    }

    /// Each edge once.
    fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.live_triangles()
            .flat_map(|t| (0..3).map(move |k| (t as usize, k)))
            .filter_map(|(t, k)| {
                let [a, b] = SIDES[k].map(|i| self.triangles[t][i]);
                (a < b || self.neighbors[t][k] == NONE).then_some([a, b])
            })
    }

    fn corners(&self, triangle: [u32; 3]) -> [[f64; 2]; 3] {
        triangle.map(|n| self.nodes[n as usize])
    }

    /// The cotangent of a triangle's smallest angle; infinite if it is not positive.
    fn cotangent(&self, triangle: [u32; 3]) -> f64 {
        worst_cotangent(&self.corners(triangle))
    }

    /// Triangles below target, worst first.
    fn triangles_below_target(&self) -> Vec<u32> {
        self.triangles_above(self.target_cotangent)
    }

    /// Triangles with a cotangent above a limit, worst first.
    fn triangles_above(&self, limit: f64) -> Vec<u32> {
        let value = |t: u32| self.cotangent(self.triangles[t as usize]);
        let mut poor: Vec<(f64, u32)> = self
            .live_triangles()
            .map(|t| (value(t), t))
            .filter(|(value, _)| *value > limit)
            .collect();
        poor.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        poor.into_iter().map(|(_, t)| t).collect()
    }

    /// Where the edge between two nodes passes through a curve.
    fn find_intersection(&self, a: u32, b: u32) -> Option<[f64; 2]> {
        let ends = [a as usize, b as usize];
        let holds = ends.map(|n| &self.constraints[n]);
        let positions = ends.map(|n| to_3d(self.nodes[n]));
        find_intersection(self.planes, holds, positions).map(|([x, y, _], _)| [x, y])
    }

    /// Whether an edge lies on a feature: one curve holds both ends, the edge runs along it, and its
    /// middle is on it too.
    fn is_on_feature(&self, a: u32, b: u32) -> bool {
        let (p, q) = (&self.constraints[a as usize], &self.constraints[b as usize]);
        if p.surface_count == 0 || q.surface_count == 0 {
            return false;
        }
        let (x, y) = (to_3d(self.nodes[a as usize]), to_3d(self.nodes[b as usize]));
        let edge = sub(y, x);
        // The sine of the angle that SAME_SHEET is the cosine of.
        let across = (1.0 - SAME_SURFACE_COSINE * SAME_SURFACE_COSINE).sqrt() * norm(edge);
        let along = |n: [f64; 3]| dot(n, edge).abs() < across;
        if !p.normals().any(|n| along(n) && q.is_on_surface(n)) {
            return false;
        }
        let near = self.planes.planes_near(add_scaled(x, 0.5, edge));
        near.iter()
            .any(|s| s.offset.abs() < MAX_FACE_OFFSET && along(s.normal))
    }

    /// The sides of the box in which an edge lies: bit k for those normal to axis k.
    fn common_sides(&self, a: u32, b: u32) -> u8 {
        let (x, y) = (self.nodes[a as usize], self.nodes[b as usize]);
        let within = |&k: &usize| x[k] == y[k] && (x[k] == 0.0 || x[k] == self.extent[k]);
        (0..2).filter(within).fold(0, |bits, k| bits | 1 << k)
    }

    /// Flips side `k` of `t` if that raises the smallest angle and no feature is lost.
    fn try_flip(&mut self, t: u32, k: usize) -> bool {
        let Some([p, q]) = self.flip_result(t, k) else {
            return false;
        };
        let [a, b] = [p[1], q[2]];
        let (c, d) = (p[0], p[2]);
        let other = [d, b, a];
        let now = self
            .cotangent(self.triangles[t as usize])
            .max(self.cotangent(other));
        let then = self.cotangent(p).max(self.cotangent(q));
        if then >= now - 1e-9 || self.is_on_feature(a, b) || self.find_intersection(c, d).is_some()
        {
            return false;
        }
        self.flip(t, k);
        true
    }

    /// Flips edges until none raises the smallest angle about it.
    fn flip_all(&mut self, patience: &CancelToken<'_>) {
        self.queue.clear();
        let all: Vec<u32> = self.live_triangles().collect();
        self.queue
            .extend(all.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        self.flip_queue(patience);
    }

    fn flip_queue(&mut self, patience: &CancelToken<'_>) {
        while let Some((t, k)) = self.queue.pop() {
            if patience.is_cancelled() {
                self.queue.clear();
                break;
            }
            if self.triangles[t as usize][0] != NONE {
                self.try_flip(t, usize::from(k));
            }
        }
    }

    fn blocked_cells(&self) -> Vec<BlockedCell> {
        self.triangles_below_target()
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let p = self.corners(triangle);
                let holds = triangle.map(|n| self.constraints[n as usize]);
                BlockedCell::new(&p, &angles(&p), &holds, 3)
            })
            .collect()
    }
}

/// No change may leave an angle whose cotangent is above this (about 3 degrees).
const MAX_COTANGENT: f64 = 20.0;

/// Smoothing aims this many degrees above the target.
const SMOOTHING_MARGIN: f64 = 4.0;

#[cfg(test)]
mod tests;
