//! How well a mesh's faces follow the features, both ways.
//!
//! An *on-feature face* has all three nodes within 0.75 sample of a feature and its centroid
//! within 1. These faces say how much of the features the mesh holds. They cannot show a surface
//! that the mesh invents away from every feature, so the faces that the mesh itself *claims* (all
//! three nodes declared on a feature) are measured beside them. In the plane faces are edges and
//! areas lengths; nothing else differs.

use super::face_distances::distances_to_faces;
use super::face_samples::{FaceSample, sample_face};
use super::mesh_faces::{MeshFaces, merge_equal_faces};
use super::reference::Reference;
use super::tally::{DistanceShares, WeightedDistances, quantiles, summaries};
use crate::comm::LocalOrComm;
use crate::comm::SelfComm;
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use crate::{Error, Result, error::cause};
use serde::Serialize;

/// Largest distance of an on-feature face's nodes from the feature, in samples.
const MAX_NODE_DISTANCE: f64 = 0.75;
/// Largest distance of its centroid; also what counts as *on* for precision.
const MAX_CENTROID_DISTANCE: f64 = 1.0;
/// Nodes or faces in one task: neighbours, so that one's nearest feature point is a hint for the next. Unit tests
/// have few.
const ITEMS_PER_TASK: usize = if cfg!(test) { 64 } else { 4096 };

/// How a set of faces compares with the features. What has no value (no faces, no features) is
/// NaN or infinite, which JSON shows as null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaceMatch {
    /// Number of faces.
    pub faces: usize,
    /// Their area, in square samples.
    pub area: f64,
    /// Share of feature points within half a sample of a face.
    pub coverage_half: f64,
    /// Share of feature points within one sample of a face.
    pub coverage_one: f64,
    /// Share of the faces' area within one sample of a feature.
    pub precision: f64,
    /// Symmetric Hausdorff distance, in samples. From faces to features it is cut off at
    /// [`REACH`](crate::image::synth::truth::INFLUENCE_RADIUS).
    pub hausdorff: f64,
    /// The larger of the two directed 95 % points (by number of feature points, by area).
    pub hausdorff_95: f64,
    /// Of networks with known truth: coverage by how far the next feature is.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub by_gap: Vec<GapClass>,
}

/// Coverage of the feature points at some distance from the next feature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GapClass {
    /// The next feature is at least this far away (samples) ...
    pub from: f64,
    /// ... and less than this; null for the farthest class.
    pub to: f64,
    /// Number of feature points.
    pub points: usize,
    /// Share of them within half a sample of a face.
    pub coverage_half: f64,
    /// Share of them within one sample of a face.
    pub coverage_one: f64,
}

/// Where classes of distance to the next feature begin, in samples.
const GAP_BOUNDS: [f64; 6] = [0.0, 2.0, 3.0, 4.0, 6.0, 8.0];

impl GapClass {
    /// Of points of which `next` tells the distance (and angle) of the next feature and `to_faces` that of the nearest
    /// face, those of each class: all, and those within half a sample of a face and within one.
    fn count_by_gap(next: &[[f32; 2]], to_faces: &[f64]) -> [[u64; 3]; GAP_BOUNDS.len()] {
        let mut counts = [[0; 3]; GAP_BOUNDS.len()];
        for (next, far) in next.iter().zip(to_faces) {
            let classes = GAP_BOUNDS
                .iter()
                .take_while(|&&from| f64::from(next[0]) >= from);
            if let Some(class) = classes.count().checked_sub(1) {
                let counted = [true, *far <= 0.5, *far <= 1.0];
                (counts[class].iter_mut().zip(counted)).for_each(|(n, is)| *n += u64::from(is));
            }
        }
        counts
    }

    /// The classes of so many.
    fn from_counts(counts: [[u64; 3]; GAP_BOUNDS.len()]) -> Vec<Self> {
        let ends = GAP_BOUNDS[1..].iter().copied().chain([f64::INFINITY]);
        let classes = GAP_BOUNDS.into_iter().zip(ends).zip(counts);
        classes
            .map(|((from, to), [points, half, one])| Self {
                from,
                to,
                points: points as usize,
                coverage_half: half as f64 / points as f64,
                coverage_one: one as f64 / points as f64,
            })
            .collect()
    }
}

/// Fidelity of a mesh to the features of an image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fidelity {
    /// What the mesh was compared with: `truth`, `mask` or `detected`.
    pub reference: String,
    /// Number of feature points.
    pub feature_points: usize,
    /// The faces that lie on features.
    pub on_feature: FaceMatch,
    /// The faces that the mesh says lie on features, if it says so.
    pub tagged_faces: Option<FaceMatch>,
}

/// Compares a mesh, in lattice space with a step of 1 (else divide its nodes by the step), with
/// the features. `claimed` holds a byte for each cell: bit k says that the mesh holds face k
/// (opposite node k) to lie on a feature.
///
/// Cost: a microsecond or less for each feature point and each two square samples of faces; the
/// result does not depend on the number of threads.
///
/// # Errors
/// [`Error::Mesh`] if `claimed` has not one byte a cell.
pub fn fidelity<const D: usize, M: Simplices<D>>(
    mesh: &M,
    reference: &Reference<'_, D>,
    claimed: Option<&[u8]>,
) -> Result<Fidelity> {
    fidelity_with_cancel(mesh, reference, claimed, &CancelToken::never())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
///
/// # Errors
/// Those of [`fidelity`].
pub(crate) fn fidelity_with_cancel<const D: usize, M: Simplices<D>>(
    mesh: &M,
    reference: &Reference<'_, D>,
    claimed: Option<&[u8]>,
    patience: &CancelToken<'_>,
) -> Result<Fidelity> {
    let claims = TaggedFaces::new(mesh, claimed)?;
    let Ok(found) = fidelity_of_partition(&MeshView::from_mesh(mesh), reference, claims, patience);
    Ok(found)
}

/// The faces that a mesh holds to lie on features, if it says so.
#[derive(Clone, Copy)]
pub(crate) struct TaggedFaces<'a>(Option<&'a [u8]>);

impl<'a> TaggedFaces<'a> {
    /// For each cell a byte, of which bit k stands for face k.
    ///
    /// # Errors
    /// [`Error::Mesh`] if there are not as many.
    pub fn new<const D: usize, M: Simplices<D>>(
        mesh: &M,
        claimed: Option<&'a [u8]>,
    ) -> Result<Self> {
        if let Some(flags) = claimed
            && flags.len() != mesh.len()
        {
            return Err(Error::Mesh(cause(
                "fidelity",
                format!("{} bytes for {} {}", flags.len(), mesh.len(), M::CELLS_NAME),
                "give one byte per cell",
            )));
        }
        Ok(Self(claimed))
    }
}

/// [`fidelity_with_cancel`] of a mesh in parts, on all who hold one; the claims are those of the part.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn fidelity_of_partition<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    part: &MeshView<'_, D, M, H>,
    reference: &Reference<'_, D>,
    claims: TaggedFaces<'_>,
    patience: &CancelToken<'_>,
) -> std::result::Result<Fidelity, H::Error> {
    let faces = face_sets(part.mesh, reference, claims.0, patience);
    let surface = MeshFaces::owned_faces("faces near features", part, faces)?;
    compare_faces(&surface, claims.0.is_some(), reference, part.comm, patience)
}

/// [`fidelity`] of polyhedra (polygons), by the same rules: their faces are fans of triangles about
/// their means, and the faces that the mesh claims are those that it says lie on features.
pub fn fidelity_of_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
) -> Fidelity {
    fidelity_of_cells_with_cancel(mesh, reference, &CancelToken::never())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
pub(crate) fn fidelity_of_cells_with_cancel<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
    patience: &CancelToken<'_>,
) -> Fidelity {
    let near = nodes_near_features(&mesh.nodes, reference, patience);
    let sets_of_faces: Vec<u8> = (0..mesh.inner_face_count())
        .into_par_iter()
        .map(|f| {
            let all_near = mesh.faces.get(f).iter().all(|&n| near[n as usize]);
            let on =
                all_near && reference.is_within(mesh.face_shape(f).centroid, MAX_CENTROID_DISTANCE);
            (u8::from(on) * ON_FEATURE) | (u8::from(mesh.on_feature[f]) * TAGGED)
        })
        .collect();
    let mut nodes = mesh.nodes.clone();
    let (mut triangles, mut sets) = (Vec::new(), Vec::new());
    for (f, &set) in sets_of_faces.iter().enumerate().filter(|(_, s)| **s != 0) {
        let ring = mesh.faces.get(f);
        if D == 2 {
            triangles.push(std::array::from_fn(|k| ring[k]));
            sets.push(set);
            continue;
        }
        let apex = nodes.len() as u32;
        nodes.push(mesh.face_shape(f).apex);
        for i in 0..ring.len() {
            let corners = [apex, ring[i], ring[(i + 1) % ring.len()]];
            triangles.push(std::array::from_fn(|k| corners[k]));
            sets.push(set);
        }
    }
    let surface = MeshFaces {
        nodes: &nodes,
        faces: triangles,
        sets,
    };
    let Ok(mut found) = compare_faces(&surface, true, reference, &SelfComm, patience);
    let count = |set: u8| sets_of_faces.iter().filter(|&&s| s & set != 0).count();
    found.on_feature.faces = count(ON_FEATURE);
    if let Some(found) = &mut found.tagged_faces {
        found.faces = count(TAGGED);
    }
    found
}

/// Whether each node is as near to a feature as those of on-feature faces.
fn nodes_near_features<const D: usize>(
    nodes: &[[f64; D]],
    reference: &Reference<'_, D>,
    patience: &CancelToken<'_>,
) -> Vec<bool> {
    let mut near = vec![false; nodes.len()];
    let parts = near
        .par_chunks_mut(ITEMS_PER_TASK)
        .zip(nodes.par_chunks(ITEMS_PER_TASK));
    parts.for_each(|(near, nodes)| {
        if !patience.is_cancelled() {
            let within = nodes
                .iter()
                .map(|&p| reference.is_within(p, MAX_NODE_DISTANCE));
            near.iter_mut().zip(within).for_each(|(n, w)| *n = w);
        }
    });
    near
}

/// Compares the faces that holders have with the features: each measures its own, and some points.
fn compare_faces<const D: usize, H: LocalOrComm + ?Sized>(
    surface: &MeshFaces<'_, D>,
    claims: bool,
    reference: &Reference<'_, D>,
    holders: &H,
    patience: &CancelToken<'_>,
) -> std::result::Result<Fidelity, H::Error> {
    let wanted = [ON_FEATURE, TAGGED];
    let own = reference.owned_points(holders);
    let points = &reference.points[own.clone()];
    let to_faces = distances_to_faces(surface, points, wanted, holders, patience)?;
    let next = reference.next_feature.as_ref().map(|next| &next[own]);
    let own = LocalMatch {
        faces: wanted.map(|set| surface.sets.iter().filter(|&&s| s & set != 0).count()),
        max_corner_distances: find_farthest_corners(surface, wanted, reference, patience),
        gap_counts: next.map(|next| {
            to_faces
                .each_ref()
                .map(|far| GapClass::count_by_gap(next, far))
        }),
    };
    let all: Vec<LocalMatch> = holders.try_all_gather("faces and features", own)?;
    let by_gap = |set: usize| -> Vec<GapClass> {
        if reference.next_feature.is_none() {
            return Vec::new();
        }
        let mut sums = [[0; 3]; GAP_BOUNDS.len()];
        for counts in all.iter().filter_map(|own| own.gap_counts) {
            let both = sums.as_flattened_mut().iter_mut();
            both.zip(counts[set].as_flattened())
                .for_each(|(sum, count)| *sum += count);
        }
        GapClass::from_counts(sums)
    };
    let pieces = face_samples(surface, reference, patience);
    let [on, claimed] = wanted.map(|set| {
        let of_set = pieces.iter().filter(|(sets, _)| sets & set != 0);
        WeightedDistances::from_weighted(of_set.map(|(_, piece)| *piece).collect())
    });
    drop(pieces);
    let [to_on, to_claimed] = to_faces.map(WeightedDistances::from_distances);
    let [on_points, claimed_points] = summaries([&to_on, &to_claimed], [0.5, 1.0], holders)?;
    let [on_faces, claimed_faces] = summaries([&on, &claimed], [MAX_CENTROID_DISTANCE], holders)?;
    // Up to where 95 % of them are.
    let of_points = |all: &DistanceShares<2>| (0.95 * all.count as f64) as u64 + 1;
    let of_faces =
        |all: &DistanceShares<1>| ((0.95 * all.total_weight as f64).ceil() as u64).max(1);
    let most = quantiles(
        [&to_on, &to_claimed, &on, &claimed],
        [
            of_points(&on_points),
            of_points(&claimed_points),
            of_faces(&on_faces),
            of_faces(&claimed_faces),
        ],
        holders,
    )?;
    let found = |set: usize, points: &DistanceShares<2>, faces: &DistanceShares<1>| {
        let corner = all
            .iter()
            .map(|own| own.max_corner_distances[set])
            .fold(0.0, f64::max);
        let farthest = points.largest.zip(faces.largest);
        let is_any = points.count > 0 && faces.total_weight > 0;
        FaceMatch {
            faces: all.iter().map(|own| own.faces[set]).sum(),
            area: faces.area(),
            coverage_half: points.share(0),
            coverage_one: points.share(1),
            precision: faces.share(0),
            hausdorff: farthest.map_or(f64::INFINITY, |(a, b)| a.max(b).max(corner)),
            hausdorff_95: match is_any {
                true => most[set].max(most[2 + set]),
                false => f64::INFINITY,
            },
            by_gap: by_gap(set),
        }
    };
    Ok(Fidelity {
        reference: reference.source.to_string(),
        feature_points: on_points.count as usize,
        on_feature: found(0, &on_points, &on_faces),
        tagged_faces: claims.then(|| found(1, &claimed_points, &claimed_faces)),
    })
}

/// What one of the holders has of both sets of faces.
struct LocalMatch {
    /// How many.
    faces: [usize; 2],
    /// How far the farthest corners are from the features.
    max_corner_distances: [f64; 2],
    /// Of networks with known truth: points by the next feature.
    gap_counts: Option<[[[u64; 3]; GAP_BOUNDS.len()]; 2]>,
}

codec_fields! { LocalMatch as LocalMatch { faces, max_corner_distances, gap_counts } }

/// The set of on-feature faces, as a bit.
const ON_FEATURE: u8 = 1;
/// The set of claimed faces, as a bit.
const TAGGED: u8 = 2;

/// The faces of either set, nodes ascending, and the sets that each belongs to. One between two cells is there once
/// or twice; one cell may claim a face that the other does not.
fn face_sets<const D: usize>(
    mesh: &impl Simplices<D>,
    reference: &Reference<'_, D>,
    claimed: Option<&[u8]>,
    patience: &CancelToken<'_>,
) -> Vec<([u32; D], u8)> {
    let near = nodes_near_features(mesh.nodes(), reference, patience);
    let mut found: Vec<([u32; D], u8)> = (0..mesh.len())
        .into_par_iter()
        .flat_map_iter(|c| {
            let near = &near;
            let claims = claimed.map_or(0, |flags| flags[c]);
            let count = mesh.cell(c).iter().filter(|&&n| near[n as usize]).count();
            let faces = if claims != 0 || count >= D { D + 1 } else { 0 };
            (0..faces).filter_map(move |k| {
                let mut face = mesh.face(c, k);
                let all_near = face.iter().all(|&n| near[n as usize]);
                let claim = claims >> k & 1 == 1;
                let sets = (u8::from(all_near) * ON_FEATURE) | (u8::from(claim) * TAGGED);
                face.sort_unstable();
                (sets != 0).then_some((face, sets))
            })
        })
        .collect();
    merge_equal_faces(&mut found);
    found
        .into_par_iter()
        .map(|(face, mut sets)| {
            let corners = face.map(|n| mesh.nodes()[n as usize]);
            let sum = |k: usize| corners.iter().map(|p| p[k]).sum::<f64>();
            let centroid = std::array::from_fn(|k| sum(k) / D as f64);
            if sets & ON_FEATURE != 0 && !reference.is_within(centroid, MAX_CENTROID_DISTANCE) {
                sets &= !ON_FEATURE;
            }
            (face, sets)
        })
        .filter(|(_, sets)| *sets != 0)
        .collect()
}

/// How far the farthest corners of the faces of each set are from the features.
fn find_farthest_corners<const D: usize>(
    surface: &MeshFaces<'_, D>,
    wanted: [u8; 2],
    reference: &Reference<'_, D>,
    patience: &CancelToken<'_>,
) -> [f64; 2] {
    let mut sets = vec![0; surface.nodes.len()];
    for (face, set) in surface.faces.iter().zip(&surface.sets) {
        face.iter().for_each(|&node| sets[node as usize] |= set);
    }
    let chunks = surface
        .nodes
        .par_chunks(ITEMS_PER_TASK)
        .zip(sets.par_chunks(ITEMS_PER_TASK));
    let of_chunk = |(nodes, sets): (&[[f64; D]], &[u8])| {
        let (mut hint, mut most) = (None, [0.0f64; 2]);
        for (&x, &set) in nodes.iter().zip(sets) {
            if set == 0 || patience.is_cancelled() {
                continue;
            }
            let far = reference.distance(x, &mut hint);
            for (most, wanted) in most.iter_mut().zip(wanted) {
                *most = if set & wanted != 0 {
                    most.max(far)
                } else {
                    *most
                };
            }
        }
        most
    };
    let larger = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].max(b[1])];
    chunks.map(of_chunk).reduce(|| [0.0; 2], larger)
}

/// The small pieces of every face, with the face's sets.
fn face_samples<const D: usize>(
    surface: &MeshFaces<'_, D>,
    reference: &Reference<'_, D>,
    patience: &CancelToken<'_>,
) -> Vec<(u8, FaceSample)> {
    let count = surface.faces.len();
    let chunks = (0..count.div_ceil(ITEMS_PER_TASK)).into_par_iter();
    chunks
        .take_any_while(|_| !patience.is_cancelled())
        .flat_map_iter(|chunk| {
            let mut found = Vec::new();
            let mut hint = None;
            for f in chunk * ITEMS_PER_TASK..count.min((chunk + 1) * ITEMS_PER_TASK) {
                sample_face(&surface.corners(f), reference, &mut hint, |piece| {
                    found.push((surface.sets[f], piece));
                });
            }
            found
        })
        .collect()
}

#[cfg(test)]
#[path = "fidelity_tests.rs"]
mod tests;
