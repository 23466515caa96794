//! Finds acute lines: lines at which two faces, each on a feature or on a side of the box, meet at
//! a small angle. No mesh that contains both faces has larger angles there.
//!
//! A line consists of *ridges*: edges in 3-D, nodes in 2-D. The faces on features around a ridge,
//! and the sides of the box that contain it, are rays in the plane perpendicular to it:
//!
//! ```text
//!      \      / feature       A wedge is the sector between two neighbouring rays, of which
//!       \   /                 one or both are features. It is acute below 30 degrees.
//!    ____\/____ side
//! ```
//!
//! Faces may be marked as feature faces wrongly: both sides of a flat cell, or a single face that
//! sticks out of a feature. Such faces must not explain bad angles. So faces are joined into
//! patches across all ridges that are not acute, and a feature at an acute line must be a patch of
//! a minimum size.

use crate::parallel::prelude::*;
use serde::{Serialize, Serializer};

use super::mesh_faces::MeshFaces;
use crate::comm::Comm;
use crate::files::codec::codec_fields;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, cross, dot, norm, sorted, sorted_distinct, sub, to_3d, unit};
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;

/// Maximum mean angle of an acute line, in degrees.
pub const MAX_MEAN_ANGLE: f64 = 30.0;
/// Maximum angle of a single edge of a line, in degrees. On a rough surface, single edges may be
/// wider than the mean.
const MAX_EDGE_ANGLE: f64 = 35.0;
/// Minimum length of a line in 3-D, in units of d. One or two edges at which rough faces are folded
/// by chance are not a line.
const MIN_LENGTH: f64 = 2.0;
/// Minimum size of a patch at an acute line: area over d^2, or in 2-D length over d.
const MIN_PATCH_SIZE: f64 = 2.0;
/// Distance along a line, to either side, over which its angle is averaged, in units of d.
const AVERAGING_RADIUS: f64 = 2.0;
/// Maximum distance of a node from a side of the box that contains it, relative to the length of
/// the box. It allows for rounding.
const SIDE_TOLERANCE: f64 = 1e-7;

/// Pair of surfaces that meet at an acute line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum AcutePair {
    /// Two features.
    Features,
    /// Feature and side of the box: 2 k at the low end of axis k, 2 k + 1 at the high end.
    Side(u8),
}

impl AcutePair {
    /// Returns the pair as a number: 0 for two features, otherwise 1 + the number of the side.
    pub fn code(self) -> u8 {
        match self {
            Self::Features => 0,
            Self::Side(side) => side + 1,
        }
    }
}

impl std::fmt::Display for AcutePair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self::Side(side) = self else {
            return f.write_str("two features");
        };
        let axis = ["x", "y", "z"][usize::from(side / 2).min(2)];
        let end = if side.is_multiple_of(2) {
            "low"
        } else {
            "high"
        };
        write!(f, "feature and {end} side along {axis}")
    }
}

impl Serialize for AcutePair {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Chain of edges of a mesh (in 2-D a single node) at which the same pair meets at an acute angle.
/// Lengths and angles are in the space that was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AcuteLine {
    /// Pair that meets there.
    pub pair: AcutePair,
    /// Length of the line; 0 in 2-D.
    pub length: f64,
    /// Smallest angle of all edges, in degrees.
    pub min_angle: f64,
    /// Mean angle, weighted by length, in degrees.
    pub mean_angle: f64,
    /// Nodes in order. The last node equals the first if the line is closed.
    #[serde(skip)]
    pub nodes: Vec<u32>,
    /// Angle at each edge (in 2-D at the node), in degrees.
    #[serde(skip)]
    pub angles: Vec<f64>,
}

/// Edge of an acute line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AcuteEdge {
    /// Ends of the edge. In 2-D the same node twice.
    pub nodes: [u32; 2],
    /// Angle of the line there, in degrees: the mean over the neighbourhood along the line.
    pub angle: f64,
}

impl AcuteLine {
    fn new<const D: usize>(
        nodes: Vec<u32>,
        angles: Vec<f64>,
        pair: AcutePair,
        positions: &[[f64; D]],
    ) -> Self {
        let lengths = lengths(&nodes, positions);
        let length: f64 = lengths.iter().sum();
        let mean_angle = if length > 0.0 {
            weighted_sum(&angles, &lengths) / length
        } else {
            angles.iter().sum::<f64>() / angles.len() as f64
        };
        Self {
            pair,
            length,
            min_angle: angles.iter().copied().fold(f64::INFINITY, f64::min),
            mean_angle,
            nodes,
            angles,
        }
    }

    /// Returns the edges (in 2-D the node), each with the mean angle of the line in its
    /// neighbourhood. On a rough surface the angle of a single edge can be far from that mean.
    pub(super) fn edges<const D: usize>(
        &self,
        positions: &[[f64; D]],
        distance: &dyn Fn(u32) -> f64,
    ) -> Vec<AcuteEdge> {
        if let &[node] = &*self.nodes {
            let angle = self.mean_angle;
            return vec![AcuteEdge {
                nodes: [node; 2],
                angle,
            }];
        }
        let lengths = lengths(&self.nodes, positions);
        let mut position = 0.0;
        let middles: Vec<f64> = (lengths.iter())
            .map(|length| {
                position += length;
                position - 0.5 * length
            })
            .collect();
        let pieces = (0..lengths.len()).map(|i| {
            let nodes = [self.nodes[i], self.nodes[i + 1]];
            let radius = AVERAGING_RADIUS * 0.5 * nodes.map(distance).iter().sum::<f64>();
            let begin = middles.partition_point(|&m| m < middles[i] - radius);
            let end = middles.partition_point(|&m| m <= middles[i] + radius);
            let length: f64 = lengths[begin..end].iter().sum();
            let sum = weighted_sum(&self.angles[begin..end], &lengths[begin..end]);
            let angle = if length > 0.0 {
                sum / length
            } else {
                self.angles[i]
            };
            AcuteEdge { nodes, angle }
        });
        pieces.collect()
    }
}

fn lengths<const D: usize>(nodes: &[u32], positions: &[[f64; D]]) -> Vec<f64> {
    let segment_length = |ends: &[u32]| {
        let [a, b] = [ends[0], ends[1]].map(|n| positions[n as usize]);
        norm(sub(a, b))
    };
    nodes.windows(2).map(segment_length).collect()
}

fn weighted_sum(values: &[f64], weights: &[f64]) -> f64 {
    values.iter().zip(weights).map(|(v, w)| v * w).sum()
}

/// Face on a feature, seen from one of its ridges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RidgeFace {
    ridge: [u32; 2],
    face: u32,
    /// Node of the face that is not on the ridge.
    apex: u32,
}

/// Face on a feature at a ridge that several ranks may have. Node numbers are global.
#[derive(Debug, Clone, Copy)]
struct SharedRidgeFace<const D: usize> {
    ridge: [u32; 2],
    /// Nodes of the face, ascending, by which faces are ordered, and its global number.
    nodes: [u32; D],
    face: u32,
    /// Positions of the ends of the ridge, d at these ends, and the position of the node of the
    /// face that is not on the ridge.
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    apex: [f64; D],
}

/// Half-plane that ends at a ridge.
struct Ray {
    /// Angle around the ridge, in radians.
    angle: f64,
    /// Face on a feature (`Ok`), or side of the box (`Err`).
    source: Result<u32, u8>,
}

/// Wedge between two rays.
#[derive(Debug, Clone, Copy)]
struct Wedge<const D: usize> {
    /// Global numbers of the ends of the ridge, their positions, and d there.
    ridge: [u32; 2],
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    angle: f64,
    pair: AcutePair,
    /// Global numbers of the faces on features.
    faces: [Option<u32>; 2],
}

codec_fields! {
    @(const D: usize) SharedRidgeFace<D> as SharedRidgeFace { ridge, nodes, face, ends, distance, apex }
    @(const D: usize) Wedge<D> as Wedge { ridge, ends, distance, angle, pair, faces }
}

impl<const D: usize> Wedge<D> {
    /// Returns the minimum area of a patch at this wedge.
    fn min_patch_area(&self) -> f64 {
        let d = 0.5 * self.distance.iter().sum::<f64>();
        MIN_PATCH_SIZE * d.powi(D as i32 - 1)
    }
}

/// Acute lines of a mesh, and for their nodes the global numbers, the positions, and d. The nodes
/// of lines are indices into these lists.
pub(super) struct AcuteLines<const D: usize> {
    pub lines: Vec<AcuteLine>,
    pub global_nodes: Vec<u32>,
    pub nodes: Vec<[f64; D]>,
    pub distance: Vec<f64>,
}

/// Finds the acute lines of a distributed mesh that fills the box `[0, extent]`. Collective; every
/// rank gets all lines. `surface` has the [faces on features](sorted_feature_faces) that this rank
/// owns, and `distance` returns d at a local node.
///
/// # Errors
/// Returns the communication errors of `comm`.
pub(super) fn acute_lines<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    surface: &MeshFaces<'_, D>,
    extent: [f64; D],
    distance: &dyn Fn(u32) -> f64,
) -> crate::Result<AcuteLines<D>> {
    let (nodes, faces, comm) = (surface.nodes, &surface.faces, view.comm);
    let counts: Vec<u32> = comm.all_gather("faces on features", faces.len() as u32)?;
    // Global number of the first face of this rank.
    let first: u32 = counts[..comm.rank()].iter().sum();
    let mut ridge_faces: Vec<RidgeFace> = (0..)
        .zip(faces)
        .flat_map(|(face, nodes)| (0..D).map(move |k| ridge_face(nodes, face, k)))
        .collect();
    ridge_faces.par_sort_unstable();

    let is_shared = view.shared_mask();
    let mut outgoing = vec![Vec::new(); comm.size()];
    let mut patches = UnionFind::new(faces.len());
    let mut wedges = Vec::new();
    for group in ridge_faces.chunk_by(|a, b| a.ridge == b.ridge) {
        let local_ridge = group[0].ridge;
        let ridge = local_ridge.map(|n| view.global_id(n));
        let position = |n: u32| nodes[n as usize];
        let (ends, d) = (local_ridge.map(position), local_ridge.map(distance));
        if local_ridge.iter().all(|&n| is_shared[n as usize]) {
            let owner = view.owner_rank(ridge[0]);
            outgoing[owner].extend(group.iter().map(|ridge_face| SharedRidgeFace {
                ridge,
                nodes: faces[ridge_face.face as usize].map(|n| view.global_id(n)),
                face: first + ridge_face.face,
                ends,
                distance: d,
                apex: position(ridge_face.apex),
            }));
            continue;
        }
        let mut apexes = group
            .iter()
            .map(|ridge_face| (position(ridge_face.apex), first + ridge_face.face));
        match narrowest_wedge(ridge, ends, d, &mut apexes, extent) {
            Some(wedge) => wedges.push(wedge),
            None => (group.windows(2)).for_each(|pair| patches.unite(pair[0].face, pair[1].face)),
        }
    }
    drop(ridge_faces);
    let shared = comm.all_to_all("ridges at cuts", outgoing)?.concat();
    let (cut_wedges, united_faces) = wedges_at_cuts(shared, extent, comm)?;
    let parts_per_area = parts_per_unit_area(extent);
    let areas = patch_areas::<D, M>(
        surface,
        &mut patches,
        first,
        &united_faces,
        parts_per_area,
        comm,
    )?;
    let local_faces = first..first + faces.len() as u32;
    let is_large = |wedge: &Wedge<D>| {
        let faces = wedge.faces.iter().flatten();
        let mut local = faces.filter(|&face| local_faces.contains(face));
        let area = |&face: &u32| areas[(face - first) as usize] as f64 / parts_per_area;
        local.all(|face| area(face) >= wedge.min_patch_area())
    };
    wedges.retain(is_large);
    let mut wedges: Vec<Wedge<D>> = comm.all_gather("wedges", wedges)?.concat();
    wedges.extend(large_everywhere(cut_wedges, is_large, comm)?);
    wedges.sort_by_key(|wedge| wedge.ridge);
    Ok(chain_lines(wedges))
}

/// Returns the wedges at ridges that several ranks share, on all ranks, and the pairs of faces that
/// continue each other there. `shared` are the faces at the ridges of this rank. Collective.
///
/// # Errors
/// Returns the communication errors of `comm`.
fn wedges_at_cuts<const D: usize>(
    mut shared: Vec<SharedRidgeFace<D>>,
    extent: [f64; D],
    comm: &dyn Comm,
) -> crate::Result<(Vec<Wedge<D>>, Vec<[u32; 2]>)> {
    shared.sort_unstable_by_key(|face| (face.ridge, face.nodes));
    let (mut wedges, mut united_faces) = (Vec::new(), Vec::new());
    for group in shared.chunk_by(|a, b| a.ridge == b.ridge) {
        let SharedRidgeFace {
            ridge,
            ends,
            distance,
            ..
        } = group[0];
        let mut apexes = group
            .iter()
            .map(|ridge_face| (ridge_face.apex, ridge_face.face));
        match narrowest_wedge(ridge, ends, distance, &mut apexes, extent) {
            Some(wedge) => wedges.push(wedge),
            None => united_faces.extend(group.windows(2).map(|pair| [pair[0].face, pair[1].face])),
        }
    }
    let wedges = comm.all_gather("wedges at cuts", wedges)?.concat();
    let united_faces = comm.all_gather("patches at cuts", united_faces)?.concat();
    Ok((wedges, united_faces))
}

/// Returns those of the wedges, which all ranks know, that are large on every rank. Collective.
///
/// # Errors
/// Returns the communication errors of `comm`.
fn large_everywhere<const D: usize>(
    wedges: Vec<Wedge<D>>,
    is_large: impl Fn(&Wedge<D>) -> bool,
    comm: &dyn Comm,
) -> crate::Result<Vec<Wedge<D>>> {
    let is_small: Vec<bool> = wedges.iter().map(|wedge| !is_large(wedge)).collect();
    let is_small: Vec<Vec<bool>> = comm.all_gather("small patches", is_small)?;
    let is_large_everywhere = |i: usize| !is_small.iter().any(|of_rank| of_rank[i]);
    let large = (0..).zip(wedges).filter(|(i, _)| is_large_everywhere(*i));
    Ok(large.map(|(_, wedge)| wedge).collect())
}

/// Returns the number of units in which one unit of area is counted: 2^44 per square of the longest
/// side of the box, rounded up to a power of two. Sums of integers do not depend on their order.
fn parts_per_unit_area<const D: usize>(extent: [f64; D]) -> f64 {
    let longest = extent.into_iter().fold(f64::MIN_POSITIVE, f64::max);
    (44.0 - (D - 1) as f64 * longest.log2().ceil()).exp2()
}

/// Returns for each local face the area of its patch, in units of which `parts_per_area` make one
/// unit of area. `patches` are the local patches, and `united_faces` the pairs of faces on all
/// ranks that are in one patch. Collective.
///
/// # Errors
/// Returns the communication errors of `comm`.
fn patch_areas<const D: usize, M: Simplices<D>>(
    surface: &MeshFaces<'_, D>,
    patches: &mut UnionFind,
    first: u32,
    united_faces: &[[u32; 2]],
    parts_per_area: f64,
    comm: &dyn Comm,
) -> crate::Result<Vec<u64>> {
    let count = surface.faces.len();
    let mut area = vec![0u64; count];
    for face in 0..count {
        let face_area = (parts_per_area * M::face_area(&surface.corners(face))).round();
        area[patches.find(face as u32) as usize] += face_area as u64;
    }
    // Patches that cross partition boundaries, each with one of its faces.
    let local_index = |face: u32| {
        let index = face.checked_sub(first)?;
        ((index as usize) < count).then_some(index)
    };
    let mut cut_faces: Vec<(u32, (u32, u64))> = Vec::new();
    for &face in united_faces.as_flattened() {
        if let Some(index) = local_index(face) {
            let patch = patches.find(index);
            cut_faces.push((face, (first + patch, area[patch as usize])));
        }
    }
    let cut_faces = sorted_distinct(cut_faces);
    let cut_faces = sorted(comm.all_gather("areas of patches", cut_faces)?.concat());
    let cut_patches: Vec<(u32, u64)> = sorted_distinct(cut_faces.iter().map(|(_, patch)| *patch));
    let patch_index = |patch: u32| cut_patches.partition_point(|&(other, _)| other < patch) as u32;
    let patch_of_face = |face: u32| {
        let (_, (patch, _)) = cut_faces[cut_faces.partition_point(|&(other, _)| other < face)];
        patch_index(patch)
    };
    let mut sets = UnionFind::new(cut_patches.len());
    for &[a, b] in united_faces {
        sets.unite(patch_of_face(a), patch_of_face(b));
    }
    let mut sums = vec![0; cut_patches.len()];
    for (index, &(_, area)) in (0..).zip(&cut_patches) {
        sums[sets.find(index) as usize] += area;
    }
    for (index, &(patch, _)) in (0..).zip(&cut_patches) {
        if let Some(patch) = local_index(patch) {
            area[patch as usize] = sums[sets.find(index) as usize];
        }
    }
    Ok((0..count as u32)
        .map(|face| area[patches.find(face) as usize])
        .collect())
}

/// Chains wedges, which are ordered by ridge, into lines.
fn chain_lines<const D: usize>(mut wedges: Vec<Wedge<D>>) -> AcuteLines<D> {
    let ends = |wedge: &Wedge<D>| {
        let end = |k: usize| (wedge.ridge[k], (wedge.ends[k], wedge.distance[k]));
        [end(0), end(1)]
    };
    let mut ends: Vec<(u32, ([f64; D], f64))> = wedges.iter().flat_map(ends).collect();
    ends.sort_by_key(|(number, _)| *number);
    ends.dedup_by_key(|(number, _)| *number);
    let (global_nodes, node_values): (Vec<u32>, Vec<_>) = ends.into_iter().unzip();
    let (nodes, distance): (Vec<[f64; D]>, Vec<f64>) = node_values.into_iter().unzip();
    let node_index = |n: u32| global_nodes.partition_point(|&number| number < n) as u32;
    wedges
        .iter_mut()
        .for_each(|wedge| wedge.ridge = wedge.ridge.map(node_index));
    let mut lines = chain_wedges(&wedges, &nodes);
    lines.retain(|line| {
        let d = line
            .nodes
            .iter()
            .map(|&n| distance[n as usize])
            .sum::<f64>();
        let d = d / line.nodes.len() as f64;
        line.mean_angle < MAX_MEAN_ANGLE && (D == 2 || line.length >= MIN_LENGTH * d)
    });
    AcuteLines {
        lines,
        global_nodes,
        nodes,
        distance,
    }
}

/// Returns the faces on features, each with its nodes ascending. `feature_faces` has a byte for
/// each cell, in which bit k marks face k. Faces in a side of the box are omitted, because they
/// belong to that side.
pub(super) fn sorted_feature_faces<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    extent: [f64; D],
) -> Vec<[u32; D]> {
    let mut faces = Vec::new();
    for (c, &bits) in feature_faces
        .iter()
        .enumerate()
        .filter(|(_, bits)| **bits != 0)
    {
        for k in (0..=D).filter(|k| bits >> k & 1 == 1) {
            let face = sorted(mesh.face(c, k));
            let corners = face.map(|n| mesh.nodes()[n as usize]);
            if common_sides(&corners, extent).next().is_none() {
                faces.push(face);
            }
        }
    }
    faces
}

/// Returns the sides of the box that contain all of these positions.
pub(super) fn common_sides<const D: usize>(
    positions: &[[f64; D]],
    extent: [f64; D],
) -> impl Iterator<Item = u8> {
    (0..2 * D as u8).filter(move |side| {
        let axis = usize::from(side / 2);
        let plane = if side.is_multiple_of(2) {
            0.0
        } else {
            extent[axis]
        };
        let distance = |x: &[f64; D]| (x[axis] - plane).abs();
        positions
            .iter()
            .all(|x| distance(x) <= SIDE_TOLERANCE * extent[axis])
    })
}

fn ridge_face<const D: usize>(face_nodes: &[u32; D], face: u32, k: usize) -> RidgeFace {
    let node = |i: usize| face_nodes[(k + 1 + i) % D];
    RidgeFace {
        ridge: sorted([node(0), node(D - 2)]),
        face,
        apex: face_nodes[k],
    }
}

/// Returns the narrowest wedge at a ridge, if it is narrow enough for a line. `faces` has the
/// position of the node off the ridge, and the number, of each face at the ridge.
fn narrowest_wedge<const D: usize>(
    ridge: [u32; 2],
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    faces: &mut dyn Iterator<Item = ([f64; D], u32)>,
    extent: [f64; D],
) -> Option<Wedge<D>> {
    let [a, b] = ends.map(to_3d);
    let axis = if D == 2 {
        [0.0, 0.0, 1.0]
    } else {
        unit(sub(b, a))
    };
    let perpendicular = |v: [f64; 3]| unit(add_scaled(v, -dot(v, axis), axis));
    let mut directions: Vec<([f64; 3], Result<u32, u8>)> = faces
        .map(|(apex, face)| (perpendicular(sub(to_3d(apex), a)), Ok(face)))
        .collect();
    let sides: Vec<u8> = common_sides(&ends, extent).collect();
    if directions.len() + sides.len() < 2 {
        return None;
    }
    // Component of a direction that points out of a side.
    let outward_component = |v: [f64; 3], side: u8| {
        let c = v[usize::from(side / 2)];
        if side.is_multiple_of(2) { -c } else { c }
    };
    for &side in &sides {
        let mut normal = [0.0; 3];
        normal[usize::from(side / 2)] = 1.0;
        let in_plane = unit(cross(axis, normal));
        let candidates = [in_plane, in_plane.map(|c| -c)].into_iter();
        let inward = candidates.filter(|&v| {
            sides
                .iter()
                .all(|&other| outward_component(v, other) <= SIDE_TOLERANCE)
        });
        directions.extend(inward.map(|v| (v, Err(side))));
    }
    let x = directions[0].0;
    let y = cross(axis, x);
    let mut rays: Vec<Ray> = (directions.iter())
        .map(|&(v, source)| Ray {
            angle: dot(v, y).atan2(dot(v, x)),
            source,
        })
        .collect();
    // Faces are in the order of their nodes, before sides, so that the stable sort is
    // deterministic.
    rays.sort_by(|a, b| a.angle.total_cmp(&b.angle));
    let wedge = |i: usize| {
        let (this, next) = (&rays[i], &rays[(i + 1) % rays.len()]);
        let angle = (next.angle - this.angle).rem_euclid(std::f64::consts::TAU);
        let pair = match (this.source, next.source) {
            (Ok(_), Ok(_)) => AcutePair::Features,
            (Ok(_), Err(side)) | (Err(side), Ok(_)) => AcutePair::Side(side),
            (Err(_), Err(_)) => return None,
        };
        let angle = angle.to_degrees();
        (angle < MAX_EDGE_ANGLE).then_some(Wedge {
            ridge,
            ends,
            distance,
            angle,
            pair,
            faces: [this.source.ok(), next.source.ok()],
        })
    };
    let wedges = (0..rays.len()).filter_map(wedge);
    wedges.min_by(|a, b| a.angle.total_cmp(&b.angle))
}

/// Chains wedges, which are ordered by ridge, into lines. A line continues at a node where exactly
/// one other ridge of the same pair begins.
fn chain_wedges<const D: usize>(wedges: &[Wedge<D>], positions: &[[f64; D]]) -> Vec<AcuteLine> {
    let line = |nodes, angles, pair| AcuteLine::new(nodes, angles, pair, positions);
    if D == 2 {
        let single = |w: &Wedge<D>| line(vec![w.ridge[0]], vec![w.angle], w.pair);
        return wedges.iter().map(single).collect();
    }
    let mut ends: Vec<(u32, AcutePair, usize)> = (wedges.iter().enumerate())
        .flat_map(|(i, w)| w.ridge.map(|node| (node, w.pair, i)))
        .collect();
    ends.sort_unstable();
    let ends_at = |node: u32, pair: AcutePair| {
        let begin = ends.partition_point(|end| (end.0, end.1) < (node, pair));
        let end = ends.partition_point(|end| (end.0, end.1) <= (node, pair));
        &ends[begin..end]
    };
    let mut used = vec![false; wedges.len()];
    let mut walk = |first: usize, start_node: u32| {
        let pair = wedges[first].pair;
        let (mut nodes, mut angles) = (vec![start_node], Vec::new());
        let mut next = Some(first);
        let mut node = start_node;
        while let Some(i) = next.filter(|&i| !used[i]) {
            used[i] = true;
            let [a, b] = wedges[i].ridge;
            node = if a == node { b } else { a };
            nodes.push(node);
            angles.push(wedges[i].angle);
            next = match ends_at(node, pair) {
                [end_a, end_b] => Some(if end_a.2 == i { end_b.2 } else { end_a.2 }),
                _ => None,
            };
        }
        (!angles.is_empty()).then(|| line(nodes, angles, pair))
    };
    // Open lines are followed from their ends, then closed lines from any of their edges.
    let open_ends = ends.iter().filter(|end| ends_at(end.0, end.1).len() != 2);
    let mut lines: Vec<AcuteLine> = open_ends.filter_map(|end| walk(end.2, end.0)).collect();
    lines.extend((0..wedges.len()).filter_map(|i| walk(i, wedges[i].ridge[0])));
    lines
}
