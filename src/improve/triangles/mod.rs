//! Improves a Delaunay triangulation of atoms in the plane: its edges lie on the features, and all
//! its angles are large enough.
//!
//! The rules, and the code for constraints and features, are those of 3-D: the plane is z = 0, and
//! a curve is a feature surface normal to it. Instead of tetrahedra and their many local
//! transformations there are triangles and one flip, so the algorithm is simpler:
//!
//! 1. No edge may pass through a curve: such an edge is flipped, or one of its ends is snapped onto
//!    the curve, or the edge is split there.
//! 2. Other edges are flipped and nodes smoothed (those on a curve only along it). Where this is
//!    not enough, short edges are collapsed and long ones split, if this raises the smallest angle.
//! 3. Where a triangle would stay unusable, its nodes may leave their curves.
//!
//! If every angle is at least 30 degrees, none is above 120.
//!
//! - `recover`: removes edges that pass through a curve
//! - `repair`: raises angles
//! - `edges`: flips, splits and collapses of edges
//! - `smooth`: moves a node to its best position
//! - `compound`: tries an operation together with those that must follow
//! - `reshape`: adds, removes and moves atoms in a part of a mesh

mod compound;
mod edges;
mod recover;
mod repair;
mod reshape;
mod smooth;

use super::constraint::NodeConstraint;
use super::feature_planes::{FeaturePlanes, MAX_FACE_OFFSET, SAME_SURFACE_COSINE};
use super::intersect::find_intersection;
use super::target::UNUSABLE_ANGLE;
use super::{BlockedCell, ImproveReport, OperationCounts};
use crate::error::{Error, Result, cause};
use crate::geometry::{add_scaled, dot, norm, sub, to_3d};
use crate::improve::constraint::common_sides;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{Atoms, kind_at};
use crate::mesh::TriMesh;
use crate::mesh::complex::NONE;
use crate::mesh::delaunay::delaunay_plane;
use crate::mesh::renumber::{new_numbers, used_items};
use crate::mesh::tri::{SIDES, angles, neighbours, worst_cotangent};
use crate::progress::CancelToken;

/// Returns the coordinates of each atom that may change while atoms on features stay there: 1 for
/// free, 0 for fixed. Atoms on a side of the box stay on it.
pub fn mobility(atoms: &Atoms<2>, extent: [f64; 2], planes: &FeaturePlanes) -> Vec<[f64; 2]> {
    let mut mobility = atoms.mobility(extent);
    for ((free, &x), &kind) in mobility.iter_mut().zip(&atoms.positions).zip(&atoms.kinds) {
        if NodeConstraint::new(to_3d(x), kind, to_3d(extent), planes)
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
/// where possible, in place.
///
/// `kinds` are those of the nodes; nodes that are inserted or removed change it. The result also
/// has, for every triangle, its edges on features: bit k for edge k (opposite node k). If `cancel`
/// is cancelled, the mesh keeps the changes made so far.
///
/// # Errors
/// Returns [`Error::Mesh`] if triangles overlap or more than two share an edge; the mesh is
/// unchanged then.
pub fn improve(
    mesh: &mut TriMesh,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 2],
    planes: &FeaturePlanes,
    distance: &Distance<2>,
    min_angle: f64,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let neighbours = adjacency(mesh)?;
    let taken = std::mem::take(mesh);
    let mut improver = TriImprover::new(
        taken, neighbours, kinds, extent, planes, distance, min_angle,
    );
    let report = improver.improve(cancel);
    let finished = improver.finish();
    (*mesh, *kinds) = (finished.mesh, finished.kinds);
    Ok((report, finished.feature_faces))
}

/// Returns the edges on features of the Delaunay triangulation of atoms. Edges that pass through a
/// curve are flipped first, where the flipped edge does not.
///
/// # Errors
/// Returns the errors of [`delaunay_plane`], and [`Error::Mesh`] if triangles overlap.
pub fn feature_edges(
    atoms: &Atoms<2>,
    extent: [f64; 2],
    planes: &FeaturePlanes,
    distance: &Distance<2>,
) -> Result<Vec<[u32; 2]>> {
    let mesh = delaunay_plane(&atoms.positions)?;
    let neighbours = adjacency(&mesh)?;
    let (kinds, min_angle) = (&atoms.kinds, UNUSABLE_ANGLE);
    let mut improver =
        TriImprover::new(mesh, neighbours, kinds, extent, planes, distance, min_angle);
    improver.flip_intersecting_edges();
    let on_feature = |&[a, b]: &[u32; 2]| improver.is_on_feature(a, b);
    Ok(improver.edges().filter(on_feature).collect())
}

/// Returns the neighbours of every triangle.
fn adjacency(mesh: &TriMesh) -> Result<Vec<[u32; 3]>> {
    neighbours(mesh.nodes.len(), &mesh.triangles).map_err(|edge| {
        Error::Mesh(cause(
            format!("edge {edge:?}"),
            "belongs to more than two triangles, or to two that overlap",
            "mesh the image again",
        ))
    })
}

/// A mesh after its improvement.
struct ImprovedTriangles {
    mesh: TriMesh,
    kinds: Vec<AtomKind>,
    /// Index of each node during the improvement.
    old_ids: Vec<u32>,
    feature_faces: Vec<u8>,
}

/// State of an improvement: the triangulation, and the constraints of every node.
struct TriImprover<'a> {
    nodes: Vec<[f64; 2]>,
    /// Node indices of each triangle; the first is `NONE` in an empty slot.
    triangles: Vec<[u32; 3]>,
    neighbours: Vec<[u32; 3]>,
    triangle_of_node: Vec<u32>,
    constraints: Vec<NodeConstraint>,
    kinds: Vec<AtomKind>,
    /// `true` if edges on the sides between fixed nodes stay whole, because another side has to match them.
    has_fixed_sides: bool,
    extent: [f64; 2],
    planes: &'a FeaturePlanes,
    distance: &'a Distance<2>,
    /// Largest cotangent of a usable triangle.
    max_usable_cotangent: f64,
    /// Largest cotangent that an angle may have.
    target_cotangent: f64,
    /// Cotangent at which smoothing stops; a little smaller than the target.
    smoothing_target: f64,
    counts: OperationCounts,
    /// Edges to be tested, as (triangle, side).
    queue: Vec<(u32, u8)>,
    /// Scratch: triangles around a node.
    star: Vec<u32>,
}

impl<'a> TriImprover<'a> {
    fn new(
        mesh: TriMesh,
        neighbours: Vec<[u32; 3]>,
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
        // Only where whole sides are fixed, corners are.
        let has_fixed_sides = nodes
            .iter()
            .zip(kinds)
            .any(|(x, kind)| *kind == AtomKind::Fixed && kind_at(*x, extent) == AtomKind::Corner);
        Self {
            has_fixed_sides,
            neighbours,
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

    /// Runs all steps in order.
    fn improve(&mut self, cancel: &CancelToken<'_>) -> ImproveReport {
        let below_target_before = self.triangles_below_target().len();
        self.recover();
        self.flip_and_smooth(cancel);
        self.apply_compound(self.max_usable_cotangent, cancel);
        self.release_nodes(cancel);
        self.apply_compound(self.target_cotangent, cancel);
        ImproveReport {
            below_target_before,
            counts: self.counts,
            blocked: self.blocked_cells(),
        }
    }

    /// Returns the mesh without empty slots, and its edges on features.
    fn finish(self) -> ImprovedTriangles {
        let on_feature = |t: u32| {
            let on = |k: &usize| {
                let [a, b] = SIDES[*k].map(|i| self.triangles[t as usize][i]);
                self.is_on_feature(a, b)
            };
            (0..3).filter(on).fold(0, |bits, k| bits | 1 << k)
        };
        let feature_faces = self.live_triangles().map(on_feature).collect();
        let corners = self.live_triangles().map(|t| self.triangles[t as usize]);
        let kept = used_items(self.nodes.len(), corners.flatten());
        let new_ids = new_numbers(self.nodes.len(), &kept);
        let triangles = self
            .live_triangles()
            .map(|t| self.triangles[t as usize].map(|n| new_ids[n as usize]))
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

    /// Returns the slots that have a triangle.
    fn live_triangles(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.triangles.len() as u32).filter(|&t| self.triangles[t as usize][0] != NONE)
    }

    /// Returns each edge once.
    fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.live_triangles()
            .flat_map(|t| (0..3).map(move |k| (t as usize, k)))
            .filter_map(|(t, k)| {
                let [a, b] = SIDES[k].map(|i| self.triangles[t][i]);
                (a < b || self.neighbours[t][k] == NONE).then_some([a, b])
            })
    }

    fn corners(&self, triangle: [u32; 3]) -> [[f64; 2]; 3] {
        triangle.map(|n| self.nodes[n as usize])
    }

    /// Returns the cotangent of a triangle's smallest angle; infinity if the triangle's area is not
    /// positive.
    fn cotangent(&self, triangle: [u32; 3]) -> f64 {
        worst_cotangent(&self.corners(triangle))
    }

    /// Returns the triangles below target, worst first.
    fn triangles_below_target(&self) -> Vec<u32> {
        self.triangles_above(self.target_cotangent)
    }

    /// Returns the triangles with a cotangent above a limit, worst first.
    fn triangles_above(&self, limit: f64) -> Vec<u32> {
        let value = |t: u32| self.cotangent(self.triangles[t as usize]);
        let mut selected: Vec<(f64, u32)> = self
            .live_triangles()
            .map(|t| (value(t), t))
            .filter(|(value, _)| *value > limit)
            .collect();
        selected.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        selected.into_iter().map(|(_, t)| t).collect()
    }

    /// Returns where the edge between two nodes passes through a curve.
    fn find_intersection(&self, a: u32, b: u32) -> Option<[f64; 2]> {
        let ends = [a as usize, b as usize];
        let constraints = ends.map(|n| &self.constraints[n]);
        let positions = ends.map(|n| to_3d(self.nodes[n]));
        find_intersection(self.planes, constraints, positions).map(|([x, y, _], _)| [x, y])
    }

    /// Returns `true` if an edge lies on a feature: one curve holds both ends, the edge runs along
    /// it, and the middle of the edge is on it, too.
    fn is_on_feature(&self, a: u32, b: u32) -> bool {
        let (p, q) = (&self.constraints[a as usize], &self.constraints[b as usize]);
        if p.surface_count == 0 || q.surface_count == 0 {
            return false;
        }
        let (x, y) = (to_3d(self.nodes[a as usize]), to_3d(self.nodes[b as usize]));
        let edge = sub(y, x);
        // The sine of the angle whose cosine is `SAME_SURFACE_COSINE`.
        let max_normal_component =
            (1.0 - SAME_SURFACE_COSINE * SAME_SURFACE_COSINE).sqrt() * norm(edge);
        let along = |n: [f64; 3]| dot(n, edge).abs() < max_normal_component;
        if !p.normals().any(|n| along(n) && q.is_on_surface(n)) {
            return false;
        }
        let nearby = self.planes.planes_near(add_scaled(x, 0.5, edge));
        nearby
            .iter()
            .any(|s| s.offset.abs() < MAX_FACE_OFFSET && along(s.normal))
    }

    /// Returns the sides of the box in which an edge lies: bit k for a side normal to axis k.
    fn common_sides(&self, a: u32, b: u32) -> u8 {
        let ends = [a, b].into_iter().map(|n| self.nodes[n as usize]);
        common_sides(ends, self.extent)
    }

    /// Flips side `k` of `t` if that raises the smallest angle and removes no edge on a feature.
    /// Returns `true` if it does.
    fn try_flip(&mut self, t: u32, k: usize) -> bool {
        let Some([p, q]) = self.flip_result(t, k) else {
            return false;
        };
        let [a, b] = [p[1], q[2]];
        let (c, d) = (p[0], p[2]);
        let second = [d, b, a];
        let old_cotangent = self
            .cotangent(self.triangles[t as usize])
            .max(self.cotangent(second));
        let new_cotangent = self.cotangent(p).max(self.cotangent(q));
        if new_cotangent >= old_cotangent - 1e-9
            || self.is_on_feature(a, b)
            || self.find_intersection(c, d).is_some()
        {
            return false;
        }
        self.flip(t, k);
        true
    }

    /// Flips edges until no flip raises the smallest angle of its two triangles.
    fn flip_all(&mut self, cancel: &CancelToken<'_>) {
        self.queue.clear();
        let triangles: Vec<u32> = self.live_triangles().collect();
        self.queue
            .extend(triangles.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        self.flip_queue(cancel);
    }

    /// Flips the edges in the queue, as far as that helps.
    fn flip_queue(&mut self, cancel: &CancelToken<'_>) {
        while let Some((t, k)) = self.queue.pop() {
            if cancel.is_cancelled() {
                self.queue.clear();
                break;
            }
            if self.triangles[t as usize][0] != NONE {
                self.try_flip(t, usize::from(k));
            }
        }
    }

    /// Returns the triangles below target and what may block them, the worst first.
    fn blocked_cells(&self) -> Vec<BlockedCell> {
        self.triangles_below_target()
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let p = self.corners(triangle);
                let constraints = triangle.map(|n| self.constraints[n as usize]);
                BlockedCell::new(&p, &angles(&p), &constraints, 3)
            })
            .collect()
    }
}

/// Largest cotangent that an operation may leave (about 3 degrees).
const MAX_COTANGENT: f64 = 20.0;

/// Margin above the target angle, in degrees, at which smoothing stops.
const SMOOTHING_MARGIN: f64 = 4.0;

#[cfg(test)]
mod tests;
