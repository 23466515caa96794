//! How well a mesh's faces follow the features, both ways.
//!
//! An *on-feature face* has all three nodes within 0.75 sample of a feature and its centroid
//! within 1. These faces say how much of the features the mesh holds. They cannot show a surface
//! that the mesh invents away from every feature, so the faces that the mesh itself *claims* (all
//! three nodes declared on a feature) are measured beside them. In the plane faces are edges and
//! areas lengths; nothing else differs.

use super::pieces::{Piece, sample};
use super::reach::to_faces;
use super::reference::Reference;
use super::surface::{Surface, together};
use crate::mesh::Simplices;
use crate::mesh::part::{Holders, Part};
use crate::mesh::poly::PolyMesh;
use crate::observer::Patience;
use crate::ranks::Alone;
use crate::{Error, Result, error::cause};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Largest distance of an on-feature face's nodes from the feature, in samples.
const NODE: f64 = 0.75;
/// Largest distance of its centroid; also what counts as *on* for precision.
const CENTROID: f64 = 1.0;
/// Nodes or faces in one task: neighbours, so that one's nearest feature point is a hint for the next. Unit tests
/// have few.
const CHUNK: usize = if cfg!(test) { 64 } else { 4096 };

/// How a set of faces compares with the features. What has no value (no faces, no features) is
/// NaN or infinite, which JSON shows as null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Match {
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
    /// [`REACH`](crate::image::synth::truth::REACH).
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
const GAPS: [f64; 6] = [0.0, 2.0, 3.0, 4.0, 6.0, 8.0];

impl GapClass {
    /// The classes of points of which `next` tells the distance (and angle) of the next feature and
    /// `to_faces` that of the nearest face.
    fn all(next: &[[f32; 2]], to_faces: &[f64]) -> Vec<Self> {
        let ends = GAPS[1..].iter().copied().chain([f64::INFINITY]);
        GAPS.into_iter()
            .zip(ends)
            .map(|(from, to)| {
                let of_class = next.iter().zip(to_faces);
                let of_class = of_class.filter(|(n, _)| (from..to).contains(&f64::from(n[0])));
                let distances: Vec<f64> = of_class.map(|(_, &d)| d).collect();
                let within = |t: f64| {
                    let reached = distances.iter().filter(|&&d| d <= t).count();
                    reached as f64 / distances.len() as f64
                };
                Self {
                    from,
                    to,
                    points: distances.len(),
                    coverage_half: within(0.5),
                    coverage_one: within(1.0),
                }
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
    pub on_feature: Match,
    /// The faces that the mesh says lie on features, if it says so.
    pub claimed: Option<Match>,
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
    fidelity_while(mesh, reference, claimed, &Patience::endless())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
///
/// # Errors
/// Those of [`fidelity`].
pub(crate) fn fidelity_while<const D: usize, M: Simplices<D>>(
    mesh: &M,
    reference: &Reference<'_, D>,
    claimed: Option<&[u8]>,
    patience: &Patience<'_>,
) -> Result<Fidelity> {
    let claims = Claims::new(mesh, claimed)?;
    let Ok(found) = fidelity_of_part(&Part::all(mesh), reference, claims, patience);
    Ok(found)
}

/// The faces that a mesh holds to lie on features, if it says so.
#[derive(Clone, Copy)]
pub(crate) struct Claims<'a>(Option<&'a [u8]>);

impl<'a> Claims<'a> {
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
                format!("{} bytes for {} {}", flags.len(), mesh.len(), M::CELLS),
                "give one byte per cell",
            )));
        }
        Ok(Self(claimed))
    }
}

/// [`fidelity_while`] of a mesh in parts, on all who hold one; the claims are those of the part.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn fidelity_of_part<const D: usize, M: Simplices<D>, H: Holders + ?Sized>(
    part: &Part<'_, D, M, H>,
    reference: &Reference<'_, D>,
    claims: Claims<'_>,
    patience: &Patience<'_>,
) -> std::result::Result<Fidelity, H::Error> {
    let faces = faces(part.mesh, reference, claims.0, patience);
    let at = |n: u32| part.mesh.nodes()[n as usize];
    let surface = Surface::told("faces near features", part, faces, at)?;
    judge(
        &surface,
        claims.0.is_some(),
        reference,
        part.holders,
        patience,
    )
}

/// [`fidelity`] of polyhedra (polygons), by the same rules: their faces are fans of triangles about
/// their means, and the faces that the mesh claims are those that it says lie on features.
pub fn fidelity_of_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
) -> Fidelity {
    fidelity_of_cells_while(mesh, reference, &Patience::endless())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
pub(crate) fn fidelity_of_cells_while<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> Fidelity {
    let near = near(&mesh.nodes, reference, patience);
    let sets_of_faces: Vec<u8> = (0..mesh.inner_faces())
        .into_par_iter()
        .map(|f| {
            let all_near = mesh.faces.get(f).iter().all(|&n| near[n as usize]);
            let on = all_near && reference.within(mesh.face_shape(f).centroid, CENTROID);
            (u8::from(on) * ON_FEATURE) | (u8::from(mesh.on_feature[f]) * CLAIMED)
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
    let surface = Surface {
        numbers: (0..nodes.len() as u32).collect(),
        nodes,
        faces: triangles,
        sets,
    };
    let Ok(mut found) = judge(&surface, true, reference, &Alone, patience);
    let count = |set: u8| sets_of_faces.iter().filter(|&&s| s & set != 0).count();
    found.on_feature.faces = count(ON_FEATURE);
    if let Some(found) = &mut found.claimed {
        found.faces = count(CLAIMED);
    }
    found
}

/// Whether each node is as near to a feature as those of on-feature faces.
fn near<const D: usize>(
    nodes: &[[f64; D]],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> Vec<bool> {
    let mut near = vec![false; nodes.len()];
    let parts = near.par_chunks_mut(CHUNK).zip(nodes.par_chunks(CHUNK));
    parts.for_each(|(near, nodes)| {
        if !patience.over() {
            let within = nodes.iter().map(|&p| reference.within(p, NODE));
            near.iter_mut().zip(within).for_each(|(n, w)| *n = w);
        }
    });
    near
}

/// Compares faces, which all holders know, with the features: each looks for distances from some.
fn judge<const D: usize, H: Holders + ?Sized>(
    surface: &Surface<D, [f64; D]>,
    claims: bool,
    reference: &Reference<'_, D>,
    holders: &H,
    patience: &Patience<'_>,
) -> std::result::Result<Fidelity, H::Error> {
    let sets = &surface.sets;
    let chunks = sets.len().div_ceil(CHUNK);
    let pieces = holders.shared("pieces of faces", chunks, |own| {
        pieces(surface, own, reference, patience)
    })?;
    let wanted = [ON_FEATURE, CLAIMED];
    let [to_on, to_claimed] = to_faces(surface, &reference.points, wanted, holders, patience)?;
    let corners = of_corners(surface.nodes.len(), &surface.faces, sets);
    let chunks = chunks_of_nodes(&surface.numbers);
    let to_corners = holders.shared("distances of nodes", chunks.len(), |own| {
        distances(&surface.nodes, &corners, &chunks[own], reference, patience)
    })?;
    let compare = |set: u8, to_faces: Vec<f64>| {
        let count = sets.iter().filter(|&&s| s & set != 0).count();
        let pieces = pieces.iter().filter(|(s, _)| s & set != 0);
        let to_corners = corners.iter().zip(&to_corners);
        let farthest = to_corners
            .filter(|(s, _)| *s & set != 0)
            .fold(0.0, |most: f64, (_, &d)| most.max(d));
        let next = reference.next.as_ref();
        let by_gap = next.map_or(Vec::new(), |next| GapClass::all(next, &to_faces));
        let compared = compare(count, pieces.map(|p| p.1).collect(), farthest, to_faces);
        Match { by_gap, ..compared }
    };
    Ok(Fidelity {
        reference: reference.source.to_string(),
        feature_points: reference.points.len(),
        on_feature: compare(ON_FEATURE, to_on),
        claimed: claims.then(|| compare(CLAIMED, to_claimed)),
    })
}

/// The set of on-feature faces, as a bit.
const ON_FEATURE: u8 = 1;
/// The set of claimed faces, as a bit.
const CLAIMED: u8 = 2;

/// The faces of either set, nodes ascending, and the sets that each belongs to. One between two cells is there once
/// or twice; one cell may claim a face that the other does not.
fn faces<const D: usize>(
    mesh: &impl Simplices<D>,
    reference: &Reference<'_, D>,
    claimed: Option<&[u8]>,
    patience: &Patience<'_>,
) -> Vec<([u32; D], u8)> {
    let near = near(mesh.nodes(), reference, patience);
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
                let sets = (u8::from(all_near) * ON_FEATURE) | (u8::from(claim) * CLAIMED);
                face.sort_unstable();
                (sets != 0).then_some((face, sets))
            })
        })
        .collect();
    together(&mut found);
    found
        .into_par_iter()
        .map(|(face, mut sets)| {
            let corners = corners(mesh.nodes(), face);
            let sum = |k: usize| corners.iter().map(|p| p[k]).sum::<f64>();
            let centroid = std::array::from_fn(|k| sum(k) / D as f64);
            if sets & ON_FEATURE != 0 && !reference.within(centroid, CENTROID) {
                sets &= !ON_FEATURE;
            }
            (face, sets)
        })
        .filter(|(_, sets)| *sets != 0)
        .collect()
}

pub(super) fn corners<const D: usize>(nodes: &[[f64; D]], face: [u32; D]) -> [[f64; D]; D] {
    face.map(|n| nodes[n as usize])
}

/// The sets of the faces that have each node as a corner.
fn of_corners<const D: usize>(nodes: usize, faces: &[[u32; D]], sets: &[u8]) -> Vec<u8> {
    let mut found = vec![0; nodes];
    for (face, set) in faces.iter().zip(sets) {
        for &node in face {
            found[node as usize] |= set;
        }
    }
    found
}

/// The places of nodes with these numbers that are in the same chunk of the whole mesh's, however it is cut: what is
/// nearest may depend on hints where two are alike.
fn chunks_of_nodes(numbers: &[u32]) -> Vec<Range<usize>> {
    let mut end = 0;
    let same = |a: &u32, b: &u32| a / CHUNK as u32 == b / CHUNK as u32;
    (numbers.chunk_by(same))
        .map(|chunk| {
            end += chunk.len();
            end - chunk.len()..end
        })
        .collect()
}

/// Distances to the features of the nodes of some chunks that are in any set, 0 for the others.
fn distances<const D: usize>(
    nodes: &[[f64; D]],
    sets: &[u8],
    chunks: &[Range<usize>],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> Vec<f64> {
    chunks
        .par_iter()
        .take_any_while(|_| !patience.over())
        .flat_map_iter(|chunk| {
            let mut hint = None;
            let mut distance = |x: [f64; D]| reference.distance(x, &mut hint);
            let found: Vec<f64> = nodes[chunk.clone()]
                .iter()
                .zip(&sets[chunk.clone()])
                .map(|(&x, &set)| if set == 0 { 0.0 } else { distance(x) })
                .collect();
            found
        })
        .collect()
}

/// The small pieces of every face of some chunks, with the face's sets.
fn pieces<const D: usize>(
    surface: &Surface<D, [f64; D]>,
    chunks: Range<usize>,
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> Vec<(u8, Piece)> {
    let Surface {
        nodes, faces, sets, ..
    } = surface;
    chunks
        .into_par_iter()
        .take_any_while(|_| !patience.over())
        .flat_map_iter(|chunk| {
            let mut found = Vec::new();
            let mut hint = None;
            for f in chunk * CHUNK..faces.len().min((chunk + 1) * CHUNK) {
                sample(&corners(nodes, faces[f]), reference, &mut hint, |piece| {
                    found.push((sets[f], piece));
                });
            }
            found
        })
        .collect()
}

/// Compares a set of faces, given as pieces and the distance of their farthest corner, with points of
/// the features, given as distances.
fn compare(
    faces: usize,
    mut to_features: Vec<Piece>,
    farthest_corner: f64,
    mut to_faces: Vec<f64>,
) -> Match {
    to_features.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let area: f64 = to_features.iter().map(|(_, area)| area).sum();
    let within = |t: f64| {
        let reached = to_faces.iter().filter(|&&d| d <= t).count();
        reached as f64 / to_faces.len() as f64
    };
    let (half, one) = (within(0.5), within(1.0));
    let precise: f64 = to_features
        .iter()
        .take_while(|(d, _)| *d <= CENTROID)
        .map(|(_, area)| area)
        .sum();
    let farthest = to_faces
        .iter()
        .copied()
        .max_by(f64::total_cmp)
        .zip(to_features.last().map(|(d, _)| d.max(farthest_corner)));
    let mut sum = 0.0;
    let area_95 = to_features.iter().find(|(_, area_here)| {
        sum += area_here;
        sum >= 0.95 * area
    });
    let rank = (0.95 * to_faces.len() as f64) as usize;
    let points_95 =
        (rank < to_faces.len()).then(|| *to_faces.select_nth_unstable_by(rank, f64::total_cmp).1);
    Match {
        faces,
        area,
        coverage_half: half,
        coverage_one: one,
        precision: if area > 0.0 { precise / area } else { f64::NAN },
        hausdorff: farthest.map_or(f64::INFINITY, |(a, b)| a.max(b)),
        hausdorff_95: points_95
            .zip(area_95)
            .map_or(f64::INFINITY, |(a, (b, _))| a.max(*b)),
        by_gap: Vec::new(),
    }
}

#[cfg(test)]
#[path = "fidelity_tests.rs"]
mod tests;
