//! How well a mesh's faces follow the features, both ways.
//!
//! An *on-feature face* has all three nodes within 0.75 sample of a feature and its centroid
//! within 1. These faces say how much of the features the mesh holds. They cannot show a surface
//! that the mesh invents away from every feature, so the faces that the mesh itself *claims* (all
//! three nodes declared on a feature) are measured beside them. In the plane faces are edges and
//! areas lengths; nothing else differs.

use super::nearest::{Tree, square_to_face};
use super::reference::Reference;
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::{Error, Result, error::cause};
use rayon::prelude::*;
use serde::Serialize;

/// Largest distance of an on-feature face's nodes from the feature, in samples.
const NODE: f64 = 0.75;
/// Largest distance of its centroid; also what counts as *on* for precision.
const CENTROID: f64 = 1.0;
/// Faces are sampled by triangles with edges no longer than this, in samples.
const FINE: f64 = 2.0;
/// Feature points in one task: neighbours, so that one's nearest face is a hint for the next.
const CHUNK: usize = 4096;

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
    /// [`REACH`](crate::synth::truth::REACH).
    pub hausdorff: f64,
    /// The larger of the two directed 95 % points (by number of feature points, by area).
    pub hausdorff_95: f64,
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
    if let Some(flags) = claimed
        && flags.len() != mesh.len()
    {
        return Err(Error::Mesh(cause(
            "fidelity",
            format!("{} bytes for {} {}", flags.len(), mesh.len(), M::CELLS),
            "give one byte a cell",
        )));
    }
    let near = near(mesh.nodes(), reference);
    let mut on_feature = faces_where(mesh, |_, _, face| face.iter().all(|&n| near[n as usize]));
    on_feature = on_feature
        .into_par_iter()
        .filter(|face| {
            let corners = corners(mesh.nodes(), *face);
            let sum = |k: usize| corners.iter().map(|p| p[k]).sum::<f64>();
            let centroid = std::array::from_fn(|k| sum(k) / D as f64);
            reference.within(centroid, CENTROID)
        })
        .collect();
    let claimed = claimed.map(|flags| faces_where(mesh, |t, k, _| flags[t] >> k & 1 == 1));
    Ok(judge(
        mesh.nodes(),
        &on_feature,
        claimed.as_deref(),
        reference,
    ))
}

/// [`fidelity`] of polyhedra (polygons), by the same rules: their faces are fans of triangles about
/// their means, and the faces that the mesh claims are those that it says lie on features.
pub fn fidelity_of_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    reference: &Reference<'_, D>,
) -> Fidelity {
    let near = near(&mesh.nodes, reference);
    let inner = 0..mesh.inner_faces();
    let on_feature: Vec<usize> = inner
        .clone()
        .into_par_iter()
        .filter(|&f| {
            let all = mesh.faces.get(f).iter().all(|&n| near[n as usize]);
            all && reference.within(mesh.face_shape(f).centroid, CENTROID)
        })
        .collect();
    let claimed: Vec<usize> = inner.filter(|&f| mesh.on_feature[f]).collect();
    let mut nodes = mesh.nodes.clone();
    let mut fans = |faces: &[usize]| -> Vec<[u32; D]> {
        let mut triangles = Vec::new();
        for &f in faces {
            let ring = mesh.faces.get(f);
            if D == 2 {
                triangles.push(std::array::from_fn(|k| ring[k]));
                continue;
            }
            let apex = nodes.len() as u32;
            nodes.push(mesh.face_shape(f).apex);
            for i in 0..ring.len() {
                let corners = [apex, ring[i], ring[(i + 1) % ring.len()]];
                triangles.push(std::array::from_fn(|k| corners[k]));
            }
        }
        triangles
    };
    let [on_triangles, claimed_triangles] = [fans(&on_feature), fans(&claimed)];
    let mut found = judge(&nodes, &on_triangles, Some(&claimed_triangles), reference);
    found.on_feature.faces = on_feature.len();
    if let Some(found) = &mut found.claimed {
        found.faces = claimed.len();
    }
    found
}

/// Whether each node is as near to a feature as those of on-feature faces.
fn near<const D: usize>(nodes: &[[f64; D]], reference: &Reference<'_, D>) -> Vec<bool> {
    let within = |&p: &[f64; D]| reference.within(p, NODE);
    nodes.par_iter().map(within).collect()
}

/// Compares the faces that lie on features, and those that are claimed to, with the features.
fn judge<const D: usize>(
    nodes: &[[f64; D]],
    on_feature: &[[u32; D]],
    claimed: Option<&[[u32; D]]>,
    reference: &Reference<'_, D>,
) -> Fidelity {
    // Most claimed faces are on-feature faces: each is sampled once.
    let mut all = [on_feature, claimed.unwrap_or_default()].concat();
    all.par_sort_unstable();
    all.dedup();
    let pieces: Vec<Vec<Piece>> = all
        .par_iter()
        .map(|&face| sample(&corners(nodes, face), reference))
        .collect();
    let pieces_of = |faces: &[[u32; D]]| -> Vec<Piece> {
        let numbers = faces.iter().filter_map(|face| all.binary_search(face).ok());
        numbers.flat_map(|k| &pieces[k]).copied().collect()
    };
    let compare = |faces: &[[u32; D]]| compare(nodes, faces, pieces_of(faces), &reference.points);
    Fidelity {
        reference: reference.source.to_string(),
        feature_points: reference.points.len(),
        on_feature: compare(on_feature),
        claimed: claimed.map(compare),
    }
}

/// Every face of the mesh for which `wanted(cell, k, nodes)` holds, once, nodes ascending.
fn faces_where<const D: usize>(
    mesh: &impl Simplices<D>,
    wanted: impl Fn(usize, usize, &[u32; D]) -> bool + Sync,
) -> Vec<[u32; D]> {
    let mut faces: Vec<[u32; D]> = (0..mesh.len())
        .into_par_iter()
        .flat_map_iter(|c| {
            let wanted = &wanted;
            (0..=D).filter_map(move |k| {
                let mut face = mesh.face(c, k);
                face.sort_unstable();
                wanted(c, k, &face).then_some(face)
            })
        })
        .collect();
    faces.par_sort_unstable();
    faces.dedup();
    faces
}

fn corners<const D: usize>(nodes: &[[f64; D]], face: [u32; D]) -> [[f64; D]; D] {
    face.map(|n| nodes[n as usize])
}

/// Compares faces, given also as pieces, with points of the features.
fn compare<const D: usize>(
    nodes: &[[f64; D]],
    faces: &[[u32; D]],
    mut to_features: Vec<Piece>,
    points: &[[f32; D]],
) -> Match {
    let shapes: Vec<[[f64; D]; D]> = faces.iter().map(|&f| corners(nodes, f)).collect();
    let boxes: Vec<[[f64; D]; 2]> = shapes
        .iter()
        .map(|face| {
            let end = |fold: fn(f64, f64) -> f64, k: usize| {
                face.iter().map(|p| p[k]).fold(face[0][k], fold)
            };
            [
                std::array::from_fn(|k| end(f64::min, k)),
                std::array::from_fn(|k| end(f64::max, k)),
            ]
        })
        .collect();
    let tree = Tree::new(&boxes);
    let mut to_faces: Vec<f64> = points
        .par_chunks(CHUNK)
        .flat_map_iter(|points| {
            let mut hint = None;
            points
                .iter()
                .map(move |p| p.map(f64::from))
                .map(|p| {
                    let found =
                        tree.nearest(p, f64::INFINITY, hint, |i| square_to_face(p, &shapes[i]));
                    hint = found.map(|(item, _)| item);
                    found.map_or(f64::INFINITY, |(_, square)| square.sqrt())
                })
                .collect::<Vec<f64>>()
        })
        .collect();
    to_faces.par_sort_unstable_by(f64::total_cmp);
    to_features.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let area: f64 = to_features.iter().map(|(_, area)| area).sum();
    let within = |t: f64| {
        let points = to_faces.len() as f64;
        to_faces.partition_point(|&d| d <= t) as f64 / points
    };
    let precise: f64 = to_features
        .iter()
        .take_while(|(d, _)| *d <= CENTROID)
        .map(|(_, area)| area)
        .sum();
    let farthest = to_faces
        .last()
        .copied()
        .zip(to_features.last().map(|(d, _)| *d));
    let mut sum = 0.0;
    let area_95 = to_features.iter().find(|(_, area_here)| {
        sum += area_here;
        sum >= 0.95 * area
    });
    let points_95 = to_faces.get((0.95 * to_faces.len() as f64) as usize);
    Match {
        faces: faces.len(),
        area,
        coverage_half: within(0.5),
        coverage_one: within(1.0),
        precision: if area > 0.0 { precise / area } else { f64::NAN },
        hausdorff: farthest.map_or(f64::INFINITY, |(a, b)| a.max(b)),
        hausdorff_95: points_95
            .zip(area_95)
            .map_or(f64::INFINITY, |(a, (b, _))| a.max(*b)),
    }
}

/// Distance to the features and area of a small piece of a face.
type Piece = (f64, f64);

/// The equal small pieces of a face, each measured at its centroid, and the face's corners, which
/// have no area but count for the largest distance.
fn sample<const D: usize>(face: &[[f64; D]; D], reference: &Reference<'_, D>) -> Vec<Piece> {
    // From corner 0 to the two others; in the plane there is one other.
    let side = |i: usize| -> [f64; D] { std::array::from_fn(|k| face[i][k] - face[0][k]) };
    let (u, v) = (side(1), side(D - 1));
    let square = |w: [f64; D]| w.iter().map(|c| c * c).sum::<f64>();
    let third = std::array::from_fn(|k| v[k] - u[k]);
    let longest = square(u).max(square(v)).max(square(third)).sqrt();
    let n = (longest / FINE).ceil().clamp(1.0, 256.0) as usize;
    let along: f64 = (0..D).map(|k| u[k] * v[k]).sum();
    let area = if D == 2 {
        square(u).sqrt()
    } else {
        0.5 * (square(u) * square(v) - along * along).max(0.0).sqrt()
    };
    let part = area / n.pow(D as u32 - 1) as f64;
    let at = |i: f64, j: f64| {
        let (s, t) = (i / n as f64, j / n as f64);
        reference.distance(std::array::from_fn(|k| face[0][k] + s * u[k] + t * v[k]))
    };
    let mut pieces: Vec<Piece> = face
        .iter()
        .map(|&corner| (reference.distance(corner), 0.0))
        .collect();
    for i in 0..n {
        if D == 2 {
            pieces.push((at(i as f64 + 0.5, 0.0), part));
            continue;
        }
        for j in 0..n - i {
            let (i, j) = (i as f64, j as f64);
            pieces.push((at(i + 1.0 / 3.0, j + 1.0 / 3.0), part));
            if i + j + 1.0 < n as f64 {
                pieces.push((at(i + 2.0 / 3.0, j + 2.0 / 3.0), part));
            }
        }
    }
    pieces
}

#[cfg(test)]
#[path = "fidelity_tests.rs"]
mod tests;
