//! Acute lines: where two faces, each on a feature or a side of the box, meet at a small angle. No mesh
//! that holds both has larger angles there.
//!
//! A line is made of *ridges*: edges in space, nodes in the plane. The faces on features around a ridge,
//! and the sides of the box that it lies in, are rays in the plane square to it:
//!
//! ```text
//!      \      / feature          The wedge between two rays with none in between, of which at least
//!       \   /                    one is a feature, is acute if it is narrower than 30 degrees.
//!    ____\/____ side
//! ```
//!
//! Claims may be wrong: a flat cell both of whose sides are said to lie on one feature, or a single face
//! that stands off it. They shall explain nothing. So faces are joined into patches across all ridges
//! that are not acute, and a feature at an acute line must be a patch of some size.

use crate::parallel::prelude::*;
use serde::{Serialize, Serializer};

use super::mesh_faces::MeshFaces;
use crate::comm::LocalOrComm;
use crate::files::codec::codec_fields;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, cross, dot, norm, sub, to_3d, unit};
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;

/// A line at which faces meet at less than this on average, in degrees, is acute.
pub const MAX_MEAN_ANGLE: f64 = 30.0;
/// A single edge of a rough surface may be this wide without an end of the line.
const MAX_EDGE_ANGLE: f64 = 35.0;
/// The least length of a line in space, in units of d. One or two edges at which rough faces happen to
/// be folded are no line.
const MIN_LENGTH: f64 = 2.0;
/// The least size of a patch at an acute line: of area over d^2 (of length over d in the plane).
const MIN_PATCH_SIZE: f64 = 2.0;
/// To either side of a place on a line, in units of d, its angle is averaged.
const AVERAGING_RADIUS: f64 = 2.0;
/// Nodes nearer to a side of the box than this, over its length, are in it: what rounding leaves.
const SIDE_TOLERANCE: f64 = 1e-7;

/// What meets at an acute line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum AcutePair {
    /// Two features.
    Features,
    /// A feature and a side of the box: 2 k at the low end of axis k, 2 k + 1 at the high one.
    Side(u8),
}

impl AcutePair {
    /// As a number: 0 for two features, else 1 more than the side's.
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

/// Edges of a mesh one after the other, in the plane a single node, where the same pair meets at an
/// acute angle. Lengths and angles are in the space that was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AcuteLine {
    /// What meets there.
    pub pair: AcutePair,
    /// Its length; 0 in the plane.
    pub length: f64,
    /// The smallest angle of all its edges, in degrees.
    pub min_angle: f64,
    /// The mean angle by length.
    pub mean_angle: f64,
    /// Its nodes in order; the last is the first where it is closed.
    #[serde(skip)]
    pub nodes: Vec<u32>,
    /// The angle at each of its edges, in degrees; in the plane, at its node.
    #[serde(skip)]
    pub angles: Vec<f64>,
}

/// A piece of a line, for whoever asks what is near it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AcuteEdge {
    /// Its ends; one node twice in the plane.
    pub nodes: [u32; 2],
    /// The angle of the line there, in degrees: the mean of what is near along it.
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
        let mean_angle = match length > 0.0 {
            true => weighted_sum(&angles, &lengths) / length,
            false => angles.iter().sum::<f64>() / angles.len() as f64,
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

    /// Its edges (its node in the plane), each with the mean angle of the edges near it along the line.
    /// A single edge of a rough surface can be far off that.
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
        let mut at = 0.0;
        let middles: Vec<f64> = (lengths.iter())
            .map(|length| {
                at += length;
                at - 0.5 * length
            })
            .collect();
        let pieces = (0..lengths.len()).map(|i| {
            let nodes = [self.nodes[i], self.nodes[i + 1]];
            let reach = AVERAGING_RADIUS * 0.5 * nodes.map(distance).iter().sum::<f64>();
            let from = middles.partition_point(|&m| m < middles[i] - reach);
            let to = middles.partition_point(|&m| m <= middles[i] + reach);
            let length: f64 = lengths[from..to].iter().sum();
            let sum = weighted_sum(&self.angles[from..to], &lengths[from..to]);
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
    let long = |ends: &[u32]| {
        let [a, b] = [ends[0], ends[1]].map(|n| positions[n as usize]);
        norm(sub(a, b))
    };
    nodes.windows(2).map(long).collect()
}

fn weighted_sum(values: &[f64], weights: &[f64]) -> f64 {
    values.iter().zip(weights).map(|(v, w)| v * w).sum()
}

/// A face on a feature, seen from one of its ridges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RidgeFace {
    ridge: [u32; 2],
    face: u32,
    /// The node of the face off the ridge.
    apex: u32,
}

/// A ridge that several parts may have, by the whole's numbers, and a face on a feature there.
#[derive(Debug, Clone, Copy)]
struct SharedRidgeFace<const D: usize> {
    ridge: [u32; 2],
    /// The face's nodes, rising, by which faces are in order; and its number among those of all.
    nodes: [u32; D],
    face: u32,
    /// Where the ends of the ridge are, and d there; and where the face's node off the ridge is.
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    apex: [f64; D],
}

/// A half-plane that ends at a ridge.
struct Ray {
    /// In radians, round the ridge.
    angle: f64,
    /// A face on a feature, or a side of the box.
    source: Result<u32, u8>,
}

/// A wedge between two rays.
#[derive(Debug, Clone, Copy)]
struct Wedge<const D: usize> {
    /// By the whole's numbers of its ends; where they are, and d there.
    ridge: [u32; 2],
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    angle: f64,
    pair: AcutePair,
    /// The numbers of the faces on features.
    faces: [Option<u32>; 2],
}

codec_fields! {
    @(const D: usize) SharedRidgeFace<D> as SharedRidgeFace { ridge, nodes, face, ends, distance, apex }
    @(const D: usize) Wedge<D> as Wedge { ridge, ends, distance, angle, pair, faces }
}

impl<const D: usize> Wedge<D> {
    /// The least area of a patch that may be at it.
    fn min_patch_area(&self) -> f64 {
        let d = 0.5 * self.distance.iter().sum::<f64>();
        MIN_PATCH_SIZE * d.powi(D as i32 - 1)
    }
}

/// The acute lines of a mesh, and of their nodes the whole's numbers, where they are, and d there: lines have the places
/// of nodes among these.
pub(super) struct AcuteLines<const D: usize> {
    pub lines: Vec<AcuteLine>,
    pub global_nodes: Vec<u32>,
    pub nodes: Vec<[f64; D]>,
    pub distance: Vec<f64>,
}

/// The acute lines of a mesh in parts that fills the box `[0, extent]`, on all who hold one; the part has some
/// [faces on features](sorted_feature_faces), each of which is one's, and `distance` is d at its nodes.
///
/// # Errors
/// Those of the other holders.
pub(super) fn acute_lines<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    part: &MeshView<'_, D, M, H>,
    surface: &MeshFaces<'_, D>,
    extent: [f64; D],
    distance: &dyn Fn(u32) -> f64,
) -> Result<AcuteLines<D>, H::Error> {
    let (nodes, faces, holders) = (surface.nodes, &surface.faces, part.comm);
    let counts: Vec<u32> = holders.try_all_gather("faces on features", faces.len() as u32)?;
    // The number of this part's first face among those of all.
    let first: u32 = counts[..holders.rank()].iter().sum();
    let mut seen: Vec<RidgeFace> = (0..)
        .zip(faces)
        .flat_map(|(face, nodes)| (0..D).map(move |k| ridge_face(nodes, face, k)))
        .collect();
    seen.par_sort_unstable();

    let is_shared = part.shared_mask();
    let mut to = vec![Vec::new(); holders.size()];
    let mut patches = UnionFind::new(faces.len());
    let mut wedges = Vec::new();
    for round in seen.chunk_by(|a, b| a.ridge == b.ridge) {
        let here = round[0].ridge;
        let ridge = here.map(|n| part.global_id(n));
        let at = |n: u32| nodes[n as usize];
        let (ends, d) = (here.map(at), here.map(distance));
        if here.iter().all(|&n| is_shared[n as usize]) {
            let owner = holders.owner_rank(ridge[0], part.global_counts[0]);
            to[owner].extend(round.iter().map(|seen| SharedRidgeFace {
                ridge,
                nodes: faces[seen.face as usize].map(|n| part.global_id(n)),
                face: first + seen.face,
                ends,
                distance: d,
                apex: at(seen.apex),
            }));
            continue;
        }
        let mut apexes = round.iter().map(|seen| (at(seen.apex), first + seen.face));
        match narrowest_wedge(ridge, ends, d, &mut apexes, extent) {
            Some(wedge) => wedges.push(wedge),
            None => (round.windows(2)).for_each(|pair| patches.unite(pair[0].face, pair[1].face)),
        }
    }
    drop(seen);
    let mut shared = holders.try_all_to_all("ridges at cuts", to)?.concat();
    shared.sort_unstable_by_key(|seen| (seen.ridge, seen.nodes));
    let (mut at_cuts, mut united) = (Vec::new(), Vec::new());
    for round in shared.chunk_by(|a, b| a.ridge == b.ridge) {
        let SharedRidgeFace {
            ridge,
            ends,
            distance,
            ..
        } = round[0];
        let mut apexes = round.iter().map(|seen| (seen.apex, seen.face));
        match narrowest_wedge(ridge, ends, distance, &mut apexes, extent) {
            Some(wedge) => at_cuts.push(wedge),
            None => united.extend(round.windows(2).map(|pair| [pair[0].face, pair[1].face])),
        }
    }
    let at_cuts: Vec<Wedge<D>> = holders.try_all_gather("wedges at cuts", at_cuts)?.concat();
    let united: Vec<[u32; 2]> = holders.try_all_gather("patches at cuts", united)?.concat();
    let parts = parts_per_unit_area(extent);
    let areas = patch_areas::<D, M, H>(surface, &mut patches, first, &united, parts, holders)?;
    let own = first..first + faces.len() as u32;
    let is_large = |wedge: &Wedge<D>| {
        let faces = wedge.faces.iter().flatten();
        let mut of_own = faces.filter(|&face| own.contains(face));
        let area = |&face: &u32| areas[(face - first) as usize] as f64 / parts;
        of_own.all(|face| area(face) >= wedge.min_patch_area())
    };
    wedges.retain(is_large);
    let small: Vec<bool> = at_cuts.iter().map(|wedge| !is_large(wedge)).collect();
    let small: Vec<Vec<bool>> = holders.try_all_gather("small patches", small)?;
    let mut wedges: Vec<Wedge<D>> = holders.try_all_gather("wedges", wedges)?.concat();
    let large = |i: usize| !small.iter().any(|small| small[i]);
    let large_at_cuts = at_cuts.iter().enumerate().filter(|(i, _)| large(*i));
    wedges.extend(large_at_cuts.map(|(_, wedge)| *wedge));
    wedges.sort_by_key(|wedge| wedge.ridge);
    Ok(chain_lines(wedges))
}

/// Areas are counted in so many parts of a unit, so that it makes no difference in which order: 2^44 of the square of the
/// longest side of the box, rounded up to a power of two.
fn parts_per_unit_area<const D: usize>(extent: [f64; D]) -> f64 {
    let longest = extent.into_iter().fold(f64::MIN_POSITIVE, f64::max);
    (44.0 - (D - 1) as f64 * longest.log2().ceil()).exp2()
}

/// For each of a part's faces the area of the patch that it is in, of which a unit has so many `parts`. `patches` has those
/// of the part, and `united` pairs of faces of all parts that are in one patch.
///
/// # Errors
/// Those of the other holders.
fn patch_areas<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    surface: &MeshFaces<'_, D>,
    patches: &mut UnionFind,
    first: u32,
    united: &[[u32; 2]],
    parts: f64,
    holders: &H,
) -> Result<Vec<u64>, H::Error> {
    let count = surface.faces.len();
    let mut area = vec![0u64; count];
    for face in 0..count {
        let own = (parts * M::face_area(&surface.corners(face))).round();
        area[patches.find(face as u32) as usize] += own as u64;
    }
    // The patches at cuts, by one of their faces each.
    let here = |face: u32| {
        let place = face.checked_sub(first)?;
        ((place as usize) < count).then_some(place)
    };
    let mut met: Vec<(u32, (u32, u64))> = Vec::new();
    for &face in united.as_flattened() {
        if let Some(place) = here(face) {
            let patch = patches.find(place);
            met.push((face, (first + patch, area[patch as usize])));
        }
    }
    met.sort_unstable();
    met.dedup();
    let mut met = holders.try_all_gather("areas of patches", met)?.concat();
    met.sort_unstable();
    let mut whole: Vec<(u32, u64)> = met.iter().map(|(_, patch)| *patch).collect();
    whole.sort_unstable();
    whole.dedup();
    let place = |patch: u32| whole.partition_point(|&(other, _)| other < patch) as u32;
    let of_face = |face: u32| {
        let (_, (patch, _)) = met[met.partition_point(|&(other, _)| other < face)];
        place(patch)
    };
    let mut sets = UnionFind::new(whole.len());
    for &[a, b] in united {
        sets.unite(of_face(a), of_face(b));
    }
    let mut sums = vec![0; whole.len()];
    for (place, &(_, area)) in (0..).zip(&whole) {
        sums[sets.find(place) as usize] += area;
    }
    for (place, &(patch, _)) in (0..).zip(&whole) {
        if let Some(patch) = here(patch) {
            area[patch as usize] = sums[sets.find(place) as usize];
        }
    }
    Ok((0..count as u32)
        .map(|face| area[patches.find(face) as usize])
        .collect())
}

/// Lines of wedges that are in the order of their ridges.
fn chain_lines<const D: usize>(mut wedges: Vec<Wedge<D>>) -> AcuteLines<D> {
    let ends = |wedge: &Wedge<D>| {
        let end = |k: usize| (wedge.ridge[k], (wedge.ends[k], wedge.distance[k]));
        [end(0), end(1)]
    };
    let mut ends: Vec<(u32, ([f64; D], f64))> = wedges.iter().flat_map(ends).collect();
    ends.sort_by_key(|(number, _)| *number);
    ends.dedup_by_key(|(number, _)| *number);
    let (numbers, places): (Vec<u32>, Vec<_>) = ends.into_iter().unzip();
    let (nodes, distance): (Vec<[f64; D]>, Vec<f64>) = places.into_iter().unzip();
    let place = |n: u32| numbers.partition_point(|&number| number < n) as u32;
    wedges
        .iter_mut()
        .for_each(|wedge| wedge.ridge = wedge.ridge.map(place));
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
        global_nodes: numbers,
        nodes,
        distance,
    }
}

/// The faces on features, each with its nodes rising. `feature_faces` has a byte for each cell, of which
/// bit k stands for face k. Faces in a side of the box are that side.
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
            let mut face = mesh.face(c, k);
            face.sort_unstable();
            let corners = face.map(|n| mesh.nodes()[n as usize]);
            if common_sides(&corners, extent).next().is_none() {
                faces.push(face);
            }
        }
    }
    faces
}

/// The sides of the box in which all of these positions lie.
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
        let off = |x: &[f64; D]| (x[axis] - plane).abs();
        positions
            .iter()
            .all(|x| off(x) <= SIDE_TOLERANCE * extent[axis])
    })
}

fn ridge_face<const D: usize>(face_nodes: &[u32; D], face: u32, k: usize) -> RidgeFace {
    let node = |i: usize| face_nodes[(k + 1 + i) % D];
    let mut ridge = [node(0), node(D - 2)];
    ridge.sort_unstable();
    RidgeFace {
        ridge,
        face,
        apex: face_nodes[k],
    }
}

/// The narrowest wedge at a ridge, if it is narrow enough for a line to pass, of the faces of which the nodes off it are
/// there, with their numbers.
fn narrowest_wedge<const D: usize>(
    ridge: [u32; 2],
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    round: &mut dyn Iterator<Item = ([f64; D], u32)>,
    extent: [f64; D],
) -> Option<Wedge<D>> {
    let [a, b] = ends.map(to_3d);
    let along = if D == 2 {
        [0.0, 0.0, 1.0]
    } else {
        unit(sub(b, a))
    };
    let square = |v: [f64; 3]| unit(add_scaled(v, -dot(v, along), along));
    let mut directions: Vec<([f64; 3], Result<u32, u8>)> = round
        .map(|(apex, face)| (square(sub(to_3d(apex), a)), Ok(face)))
        .collect();
    let sides: Vec<u8> = common_sides(&ends, extent).collect();
    if directions.len() + sides.len() < 2 {
        return None;
    }
    // How far a direction leads out of a side.
    let out = |v: [f64; 3], side: u8| {
        let c = v[usize::from(side / 2)];
        if side.is_multiple_of(2) { -c } else { c }
    };
    for &side in &sides {
        let mut normal = [0.0; 3];
        normal[usize::from(side / 2)] = 1.0;
        let within = unit(cross(along, normal));
        let both = [within, within.map(|c| -c)].into_iter();
        let inside = both.filter(|&v| sides.iter().all(|&other| out(v, other) <= SIDE_TOLERANCE));
        directions.extend(inside.map(|v| (v, Err(side))));
    }
    let x = directions[0].0;
    let y = cross(along, x);
    let mut rays: Vec<Ray> = (directions.iter())
        .map(|&(v, of)| Ray {
            angle: dot(v, y).atan2(dot(v, x)),
            source: of,
        })
        .collect();
    // Faces are in the order of their nodes, before sides.
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

/// Wedges, in the order of their ridges, as lines: a line goes on where just one other ridge of the same
/// pair begins.
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
    let at = |node: u32, pair: AcutePair| {
        let from = ends.partition_point(|end| (end.0, end.1) < (node, pair));
        let to = ends.partition_point(|end| (end.0, end.1) <= (node, pair));
        &ends[from..to]
    };
    let mut used = vec![false; wedges.len()];
    let mut walk = |first: usize, from: u32| {
        let pair = wedges[first].pair;
        let (mut nodes, mut angles) = (vec![from], Vec::new());
        let mut next = Some(first);
        let mut node = from;
        while let Some(i) = next.filter(|&i| !used[i]) {
            used[i] = true;
            let [a, b] = wedges[i].ridge;
            node = if a == node { b } else { a };
            nodes.push(node);
            angles.push(wedges[i].angle);
            next = match at(node, pair) {
                [one, other] => Some(if one.2 == i { other.2 } else { one.2 }),
                _ => None,
            };
        }
        (!angles.is_empty()).then(|| line(nodes, angles, pair))
    };
    // Open lines from their ends, then what is closed from anywhere.
    let from_ends = ends.iter().filter(|end| at(end.0, end.1).len() != 2);
    let mut lines: Vec<AcuteLine> = from_ends.filter_map(|end| walk(end.2, end.0)).collect();
    lines.extend((0..wedges.len()).filter_map(|i| walk(i, wedges[i].ridge[0])));
    lines
}
