//! Measures how well the faces of a mesh follow the features, in both directions.
//!
//! An *on-feature face* has all its nodes within 0.75 sample of a feature, and its centroid within
//! 1 sample. These faces show how much of the features is in the mesh. They cannot show a surface
//! that the mesh has away from every feature. So the *tagged faces*, which the mesh itself marks as
//! faces on features, are measured separately. In 2-D, faces are edges and areas are lengths.

use super::face_distances::distances_to_faces;
use super::face_samples::{FaceSample, sample_face};
use super::mesh_faces::{MeshFaces, merge_equal_faces};
use super::reference::Reference;
use super::tally::{DistanceShares, WeightedDistances, quantiles, summaries};
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::mesh::view::{MeshView, WHOLE_MESH_NEVER_FAILS};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use crate::{Error, Result, error::cause};
use serde::Serialize;
use std::collections::BTreeMap;

/// Maximum distance of the nodes of an on-feature face from the feature, in samples.
const MAX_NODE_DISTANCE: f64 = 0.75;
/// Maximum distance of its centroid, in samples. It is also the maximum distance of area that
/// counts for precision.
const MAX_CENTROID_DISTANCE: f64 = 1.0;
/// Number of nodes or faces in one task. They are neighbours, so that the nearest feature point of
/// one is a hint for the next. Unit tests have a small value.
const ITEMS_PER_TASK: usize = if cfg!(test) { 64 } else { 4096 };

/// Comparison of a set of faces with the features. Values that do not exist (without faces or
/// features) are NaN or infinite, which is null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaceMatch {
    /// Number of faces.
    pub faces: usize,
    /// Area of the faces, in square samples.
    pub area: f64,
    /// Fraction of the feature points within half a sample of a face.
    pub coverage_half: f64,
    /// Fraction of the feature points within one sample of a face.
    pub coverage_one: f64,
    /// Fraction of the area of the faces within one sample of a feature.
    pub precision: f64,
    /// Symmetric Hausdorff distance, in samples. The distance from faces to features is at most
    /// [`MAX_DISTANCE`](crate::image::synth::truth::MAX_DISTANCE).
    pub hausdorff: f64,
    /// Larger of the two directed 95 % quantiles of distance (by number of feature points, by
    /// area), in samples.
    pub hausdorff_95: f64,
    /// Coverage by distance to the next feature, for feature networks with known truth.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub by_gap: Vec<GapClass>,
}

/// Coverage of the feature points at certain distances from the next feature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GapClass {
    /// Minimum distance to the next feature, in samples.
    pub from: f64,
    /// Upper bound of the distance to the next feature, in samples. It is infinite (null in JSON)
    /// for the last class.
    pub to: f64,
    /// Number of feature points.
    pub points: usize,
    /// Fraction of the points within half a sample of a face.
    pub coverage_half: f64,
    /// Fraction of the points within one sample of a face.
    pub coverage_one: f64,
}

/// Lower bounds of the classes of distance to the next feature, in samples.
const GAP_BOUNDS: [f64; 6] = [0.0, 2.0, 3.0, 4.0, 6.0, 8.0];

impl GapClass {
    /// Counts points by class of distance to the next feature: all points, those within half a
    /// sample of a face, and those within one sample. `next` has the distance (and angle) of the
    /// next feature for each point, and `face_distances` the distance of the nearest face.
    fn count_by_gap(next: &[[f32; 2]], face_distances: &[f64]) -> [[u64; 3]; GAP_BOUNDS.len()] {
        let mut counts = [[0; 3]; GAP_BOUNDS.len()];
        for (next, distance) in next.iter().zip(face_distances) {
            let classes = GAP_BOUNDS
                .iter()
                .take_while(|&&from| f64::from(next[0]) >= from);
            if let Some(class) = classes.count().checked_sub(1) {
                let flags = [true, *distance <= 0.5, *distance <= 1.0];
                (counts[class].iter_mut().zip(flags))
                    .for_each(|(n, is_counted)| *n += u64::from(is_counted));
            }
        }
        counts
    }

    /// Creates the classes from the counts of points.
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
    /// Source of the features: `truth`, `mask` or `detected`.
    pub reference: String,
    /// Number of feature points.
    pub feature_points: usize,
    /// Match of the faces that lie on features.
    pub on_feature: FaceMatch,
    /// Match of the faces that the mesh marks as faces on features, if it marks any.
    pub tagged_faces: Option<FaceMatch>,
    /// Coverage of each feature surface by the tagged faces, or by those on features if the mesh marks
    /// none. It is empty if the surfaces are not known.
    #[serde(skip)]
    pub surfaces: Vec<SurfaceCoverage>,
}

/// Coverage of a feature surface by faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceCoverage {
    /// Number of the surface, as in [`Features::surface`](crate::feature::Features::surface).
    pub surface: u32,
    /// Number of its points.
    pub points: usize,
    /// Number of its points within one sample of a face.
    pub covered_points: usize,
}

impl SurfaceCoverage {
    /// Returns the fraction of the points within one sample of a face.
    pub fn share(&self) -> f64 {
        self.covered_points as f64 / self.points.max(1) as f64
    }

    /// Counts the points of each surface on all ranks. `surface` has the number of the surface of each
    /// local point, and `distances` its distance from the nearest face. Collective.
    fn count<const D: usize, M>(
        view: &MeshView<'_, D, M>,
        surface: &[u32],
        distances: &[f64],
    ) -> Result<Vec<Self>> {
        let mut counts: BTreeMap<u32, [u64; 2]> = BTreeMap::new();
        for (&surface, &distance) in surface.iter().zip(distances) {
            let count = counts.entry(surface).or_default();
            count[0] += 1;
            count[1] += u64::from(distance <= 1.0);
        }
        let local: Vec<(u32, [u64; 2])> = counts.into_iter().collect();
        let mut sums: BTreeMap<u32, [u64; 2]> = BTreeMap::new();
        for (surface, count) in view.concatenate("points of surfaces", local)? {
            let sum = sums.entry(surface).or_default();
            *sum = [sum[0] + count[0], sum[1] + count[1]];
        }
        let coverage = |(surface, [points, covered]): (u32, [u64; 2])| Self {
            surface,
            points: points as usize,
            covered_points: covered as usize,
        };
        Ok(sums.into_iter().map(coverage).collect())
    }
}

/// Compares a mesh with the features. The mesh is in lattice space with a step of 1 (otherwise
/// divide its nodes by the step). `tagged` has a byte for each cell, in which bit k marks face k
/// (opposite node k) as a face on a feature.
///
/// The cost is at most a microsecond for each feature point and for each two square samples of
/// faces. The result does not depend on the number of threads.
///
/// # Errors
/// Returns [`Error::Mesh`] if `tagged` does not have one byte per cell.
pub fn fidelity<const D: usize, M: Simplices<D>>(
    mesh: &M,
    reference: &Reference<'_, D>,
    tagged: Option<&[u8]>,
) -> Result<Fidelity> {
    let (view, never) = (MeshView::from_mesh(mesh), CancelToken::never());
    fidelity_of_partition(&view, reference, tagged, &never)
}

/// Compares a mesh that may be distributed with the features, as [`fidelity`] does, until `cancel`
/// is cancelled. The result of a cancelled call is meaningless. Collective. `tagged` has the marks
/// of the local cells, and `reference` the feature points of this rank.
///
/// # Errors
/// Returns the errors of [`fidelity`], and the communication errors of the view.
pub(crate) fn fidelity_of_partition<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    reference: &Reference<'_, D>,
    tagged: Option<&[u8]>,
    cancel: &CancelToken<'_>,
) -> Result<Fidelity> {
    let cells = view.mesh.len();
    if let Some(flags) = tagged
        && flags.len() != cells
    {
        return Err(Error::Mesh(cause(
            "fidelity",
            format!("{} bytes for {cells} {}", flags.len(), M::CELLS_NAME),
            "give one byte per cell",
        )));
    }
    let faces = face_sets(view.mesh, reference, tagged, cancel);
    let surface = MeshFaces::owned_faces("faces near features", view, faces)?;
    compare_faces(view, &surface, tagged.is_some(), reference, cancel)
}

/// Compares polyhedra (polygons) with the features, by the rules of [`fidelity`]. Faces are cut
/// into fans of triangles around their mean, and the tagged faces are those that the mesh marks as
/// faces on features. The result of a cancelled call is meaningless.
pub(crate) fn fidelity_of_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> Fidelity {
    let is_near = nodes_near_features(&mesh.nodes, reference, cancel);
    let sets_of_faces: Vec<u8> = (0..mesh.inner_face_count())
        .into_par_iter()
        .map(|f| {
            let is_face_near = mesh.faces.get(f).iter().all(|&n| is_near[n as usize]);
            let is_on_feature = is_face_near
                && reference.is_within(mesh.face_shape(f).centroid, MAX_CENTROID_DISTANCE);
            (u8::from(is_on_feature) * ON_FEATURE) | (u8::from(mesh.on_feature[f]) * TAGGED)
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
    let mut result = compare_faces(
        &MeshView::from_mesh(mesh),
        &surface,
        true,
        reference,
        cancel,
    )
    .expect(WHOLE_MESH_NEVER_FAILS);
    let count = |set: u8| sets_of_faces.iter().filter(|&&s| s & set != 0).count();
    result.on_feature.faces = count(ON_FEATURE);
    if let Some(tagged) = &mut result.tagged_faces {
        tagged.faces = count(TAGGED);
    }
    result
}

/// Returns for each node `true` if it is as near to a feature as the nodes of on-feature faces.
fn nodes_near_features<const D: usize>(
    nodes: &[[f64; D]],
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> Vec<bool> {
    let mut is_near = vec![false; nodes.len()];
    let chunks = is_near
        .par_chunks_mut(ITEMS_PER_TASK)
        .zip(nodes.par_chunks(ITEMS_PER_TASK));
    chunks.for_each(|(is_near, nodes)| {
        if !cancel.is_cancelled() {
            let flags = nodes
                .iter()
                .map(|&p| reference.is_within(p, MAX_NODE_DISTANCE));
            is_near.iter_mut().zip(flags).for_each(|(n, w)| *n = w);
        }
    });
    is_near
}

/// Compares the faces of all ranks with the features. Each rank measures its own faces and feature
/// points. Collective.
fn compare_faces<const D: usize, M>(
    view: &MeshView<'_, D, M>,
    surface: &MeshFaces<'_, D>,
    has_tags: bool,
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Fidelity> {
    let queried_sets = [ON_FEATURE, TAGGED];
    let face_distances =
        distances_to_faces(view, surface, &reference.points, queried_sets, cancel)?;
    let local = LocalMatch {
        faces: queried_sets.map(|set| surface.sets.iter().filter(|&&s| s & set != 0).count()),
        max_corner_distances: find_farthest_corners(surface, queried_sets, reference, cancel),
        gap_counts: (reference.next_feature.as_ref())
            .map(|next| (face_distances.each_ref()).map(|d| GapClass::count_by_gap(next, d)))
            .unwrap_or_default(),
    };
    let judged_distances = &face_distances[usize::from(has_tags)];
    let surfaces = SurfaceCoverage::count(view, &reference.surface, judged_distances)?;
    let totals = view.merge_parts("faces and features", local, LocalMatch::merged)?;
    let by_gap = |set: usize| match reference.next_feature {
        Some(_) => GapClass::from_counts(totals.gap_counts[set]),
        None => Vec::new(),
    };
    let samples = face_samples(surface, reference, cancel);
    let [on_feature, tagged] = queried_sets.map(|set| {
        let set_samples = samples.iter().filter(|(sets, _)| sets & set != 0);
        WeightedDistances::from_weighted(set_samples.map(|(_, sample)| *sample).collect())
    });
    drop(samples);
    let [to_on_feature, to_tagged] = face_distances.map(WeightedDistances::from_distances);
    let [on_feature_points, tagged_points] =
        summaries(view, [&to_on_feature, &to_tagged], [0.5, 1.0])?;
    let [on_feature_faces, tagged_faces] =
        summaries(view, [&on_feature, &tagged], [MAX_CENTROID_DISTANCE])?;
    // Ranks up to which there are 95 % of the points, and of the area.
    let point_rank = |shares: &DistanceShares<2>| (0.95 * shares.count as f64) as u64 + 1;
    let face_weight =
        |shares: &DistanceShares<1>| ((0.95 * shares.total_weight as f64).ceil() as u64).max(1);
    let percentiles = quantiles(
        view,
        [&to_on_feature, &to_tagged, &on_feature, &tagged],
        [
            point_rank(&on_feature_points),
            point_rank(&tagged_points),
            face_weight(&on_feature_faces),
            face_weight(&tagged_faces),
        ],
    )?;
    let face_match = |set: usize, points: &DistanceShares<2>, faces: &DistanceShares<1>| {
        let corner = totals.max_corner_distances[set].max(0.0);
        let farthest = points.largest.zip(faces.largest);
        let is_any = points.count > 0 && faces.total_weight > 0;
        FaceMatch {
            faces: totals.faces[set],
            area: faces.area(),
            coverage_half: points.share(0),
            coverage_one: points.share(1),
            precision: faces.share(0),
            hausdorff: farthest.map_or(f64::INFINITY, |(a, b)| a.max(b).max(corner)),
            hausdorff_95: if is_any {
                percentiles[set].max(percentiles[2 + set])
            } else {
                f64::INFINITY
            },
            by_gap: by_gap(set),
        }
    };
    Ok(Fidelity {
        reference: reference.source.to_string(),
        feature_points: on_feature_points.count as usize,
        on_feature: face_match(0, &on_feature_points, &on_feature_faces),
        tagged_faces: has_tags.then(|| face_match(1, &tagged_points, &tagged_faces)),
        surfaces,
    })
}

/// Measures of one part of a mesh, or of several, for both sets of faces.
struct LocalMatch {
    /// Number of faces.
    faces: [usize; 2],
    /// Maximum distance of corners from the features.
    max_corner_distances: [f64; 2],
    /// Counts of points by distance to the next feature, for networks with known truth.
    gap_counts: [[[u64; 3]; GAP_BOUNDS.len()]; 2],
}

codec_fields! { LocalMatch as LocalMatch { faces, max_corner_distances, gap_counts } }

impl LocalMatch {
    /// Returns the measures of both.
    fn merged(mut self, other: Self) -> Self {
        for set in 0..2 {
            let corner = &mut self.max_corner_distances[set];
            *corner = corner.max(other.max_corner_distances[set]);
            self.faces[set] += other.faces[set];
        }
        (self
            .gap_counts
            .as_flattened_mut()
            .as_flattened_mut()
            .iter_mut())
        .zip(other.gap_counts.as_flattened().as_flattened())
        .for_each(|(sum, count)| *sum += count);
        self
    }
}

/// Bit of the set of on-feature faces.
const ON_FEATURE: u8 = 1;
/// Bit of the set of tagged faces.
const TAGGED: u8 = 2;

/// Returns the faces of either set, with their nodes ascending, and the sets of each face. A face
/// between two cells is returned once, even if only one of the cells marks it.
fn face_sets<const D: usize>(
    mesh: &impl Simplices<D>,
    reference: &Reference<'_, D>,
    tagged: Option<&[u8]>,
    cancel: &CancelToken<'_>,
) -> Vec<([u32; D], u8)> {
    let is_near = nodes_near_features(mesh.nodes(), reference, cancel);
    let mut candidates: Vec<([u32; D], u8)> = (0..mesh.len())
        .into_par_iter()
        .flat_map_iter(|c| {
            let is_near = &is_near;
            let tags = tagged.map_or(0, |flags| flags[c]);
            let count = mesh
                .cell(c)
                .iter()
                .filter(|&&n| is_near[n as usize])
                .count();
            let faces = if tags != 0 || count >= D { D + 1 } else { 0 };
            (0..faces).filter_map(move |k| {
                let mut face = mesh.face(c, k);
                let is_face_near = face.iter().all(|&n| is_near[n as usize]);
                let is_tagged = tags >> k & 1 == 1;
                let sets = (u8::from(is_face_near) * ON_FEATURE) | (u8::from(is_tagged) * TAGGED);
                face.sort_unstable();
                (sets != 0).then_some((face, sets))
            })
        })
        .collect();
    merge_equal_faces(&mut candidates);
    candidates
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

/// Returns the maximum distance of the corners of the faces of each set from the features.
fn find_farthest_corners<const D: usize>(
    surface: &MeshFaces<'_, D>,
    queried_sets: [u8; 2],
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> [f64; 2] {
    let mut sets = vec![0; surface.nodes.len()];
    for (face, set) in surface.faces.iter().zip(&surface.sets) {
        face.iter().for_each(|&node| sets[node as usize] |= set);
    }
    let chunks = surface
        .nodes
        .par_chunks(ITEMS_PER_TASK)
        .zip(sets.par_chunks(ITEMS_PER_TASK));
    let chunk_max = |(nodes, sets): (&[[f64; D]], &[u8])| {
        let (mut hint, mut max) = (None, [0.0f64; 2]);
        for (&x, &set) in nodes.iter().zip(sets) {
            if set == 0 || cancel.is_cancelled() {
                continue;
            }
            let distance = reference.distance(x, &mut hint);
            for (max, queried) in max.iter_mut().zip(queried_sets) {
                *max = if set & queried != 0 {
                    max.max(distance)
                } else {
                    *max
                };
            }
        }
        max
    };
    let elementwise_max = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].max(b[1])];
    chunks.map(chunk_max).reduce(|| [0.0; 2], elementwise_max)
}

/// Returns the small pieces of every face, with the sets of the face.
fn face_samples<const D: usize>(
    surface: &MeshFaces<'_, D>,
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> Vec<(u8, FaceSample)> {
    let count = surface.faces.len();
    let chunks = (0..count.div_ceil(ITEMS_PER_TASK)).into_par_iter();
    chunks
        .take_any_while(|_| !cancel.is_cancelled())
        .flat_map_iter(|chunk| {
            let mut samples = Vec::new();
            let mut hint = None;
            for f in chunk * ITEMS_PER_TASK..count.min((chunk + 1) * ITEMS_PER_TASK) {
                sample_face(&surface.corners(f), reference, &mut hint, |sample| {
                    samples.push((surface.sets[f], sample));
                });
            }
            samples
        })
        .collect()
}

#[cfg(test)]
#[path = "fidelity_tests.rs"]
mod tests;
