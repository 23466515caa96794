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
use super::tally::{Distances, Together, of_all, reached};
use crate::files::kept::fields;
use crate::mesh::Simplices;
use crate::mesh::part::Part;
use crate::mesh::poly::PolyMesh;
use crate::observer::Patience;
use crate::parallel::prelude::*;
use crate::ranks::Alone;
use crate::ranks::Holders;
use crate::{Error, Result, error::cause};
use serde::Serialize;

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
    /// Of points of which `next` tells the distance (and angle) of the next feature and `to_faces` that of the nearest
    /// face, those of each class: all, and those within half a sample of a face and within one.
    fn counts(next: &[[f32; 2]], to_faces: &[f64]) -> [[u64; 3]; GAPS.len()] {
        let mut counts = [[0; 3]; GAPS.len()];
        for (next, far) in next.iter().zip(to_faces) {
            let classes = GAPS.iter().take_while(|&&from| f64::from(next[0]) >= from);
            if let Some(class) = classes.count().checked_sub(1) {
                let counted = [true, *far <= 0.5, *far <= 1.0];
                (counts[class].iter_mut().zip(counted)).for_each(|(n, is)| *n += u64::from(is));
            }
        }
        counts
    }

    /// The classes of so many.
    fn all(counts: [[u64; 3]; GAPS.len()]) -> Vec<Self> {
        let ends = GAPS[1..].iter().copied().chain([f64::INFINITY]);
        let classes = GAPS.into_iter().zip(ends).zip(counts);
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
    let surface = Surface::own("faces near features", part, faces)?;
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
        nodes: &nodes,
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

/// Compares the faces that holders have with the features: each measures its own, and some points.
fn judge<const D: usize, H: Holders + ?Sized>(
    surface: &Surface<'_, D>,
    claims: bool,
    reference: &Reference<'_, D>,
    holders: &H,
    patience: &Patience<'_>,
) -> std::result::Result<Fidelity, H::Error> {
    let wanted = [ON_FEATURE, CLAIMED];
    let own = reference.own(holders);
    let points = &reference.points[own.clone()];
    let to_faces = to_faces(surface, points, wanted, holders, patience)?;
    let next = reference.next.as_ref().map(|next| &next[own]);
    let own = Own {
        faces: wanted.map(|set| surface.sets.iter().filter(|&&s| s & set != 0).count()),
        corners: farthest_corners(surface, wanted, reference, patience),
        gaps: next.map(|next| to_faces.each_ref().map(|far| GapClass::counts(next, far))),
    };
    let all: Vec<Own> = holders.told("faces and features", own)?;
    let by_gap = |set: usize| -> Vec<GapClass> {
        if reference.next.is_none() {
            return Vec::new();
        }
        let mut sums = [[0; 3]; GAPS.len()];
        for counts in all.iter().filter_map(|own| own.gaps) {
            let both = sums.as_flattened_mut().iter_mut();
            both.zip(counts[set].as_flattened())
                .for_each(|(sum, count)| *sum += count);
        }
        GapClass::all(sums)
    };
    let pieces = pieces(surface, reference, patience);
    let [on, claimed] = wanted.map(|set| {
        let of_set = pieces.iter().filter(|(sets, _)| sets & set != 0);
        Distances::weighted(of_set.map(|(_, piece)| *piece).collect())
    });
    drop(pieces);
    let [to_on, to_claimed] = to_faces.map(Distances::counted);
    let [on_points, claimed_points] = of_all([&to_on, &to_claimed], [0.5, 1.0], holders)?;
    let [on_faces, claimed_faces] = of_all([&on, &claimed], [CENTROID], holders)?;
    // Up to where 95 % of them are.
    let of_points = |all: &Together<2>| (0.95 * all.count as f64) as u64 + 1;
    let of_faces = |all: &Together<1>| ((0.95 * all.all as f64).ceil() as u64).max(1);
    let most = reached(
        [&to_on, &to_claimed, &on, &claimed],
        [
            of_points(&on_points),
            of_points(&claimed_points),
            of_faces(&on_faces),
            of_faces(&claimed_faces),
        ],
        holders,
    )?;
    let found = |set: usize, points: &Together<2>, faces: &Together<1>| {
        let corner = all.iter().map(|own| own.corners[set]).fold(0.0, f64::max);
        let farthest = points.largest.zip(faces.largest);
        let is_any = points.count > 0 && faces.all > 0;
        Match {
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
        claimed: claims.then(|| found(1, &claimed_points, &claimed_faces)),
    })
}

/// What one of the holders has of both sets of faces.
struct Own {
    /// How many.
    faces: [usize; 2],
    /// How far the farthest corners are from the features.
    corners: [f64; 2],
    /// Of networks with known truth: points by the next feature.
    gaps: Option<[[[u64; 3]; GAPS.len()]; 2]>,
}

fields! { Own as Own { faces, corners, gaps } }

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
            let corners = face.map(|n| mesh.nodes()[n as usize]);
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

/// How far the farthest corners of the faces of each set are from the features.
fn farthest_corners<const D: usize>(
    surface: &Surface<'_, D>,
    wanted: [u8; 2],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> [f64; 2] {
    let mut sets = vec![0; surface.nodes.len()];
    for (face, set) in surface.faces.iter().zip(&surface.sets) {
        face.iter().for_each(|&node| sets[node as usize] |= set);
    }
    let chunks = surface.nodes.par_chunks(CHUNK).zip(sets.par_chunks(CHUNK));
    let of_chunk = |(nodes, sets): (&[[f64; D]], &[u8])| {
        let (mut hint, mut most) = (None, [0.0f64; 2]);
        for (&x, &set) in nodes.iter().zip(sets) {
            if set == 0 || patience.over() {
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
fn pieces<const D: usize>(
    surface: &Surface<'_, D>,
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> Vec<(u8, Piece)> {
    let count = surface.faces.len();
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter();
    chunks
        .take_any_while(|_| !patience.over())
        .flat_map_iter(|chunk| {
            let mut found = Vec::new();
            let mut hint = None;
            for f in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
                sample(&surface.corners(f), reference, &mut hint, |piece| {
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
