//! How well a mesh's faces follow the features, both ways.
//!
//! An *on-feature face* has all three nodes within 0.75 sample of a feature and its centroid
//! within 1. These faces say how much of the features the mesh holds. They cannot show a surface
//! that the mesh invents away from every feature, so the faces that the mesh itself *claims* (all
//! three nodes declared on a feature) are measured beside them.

use super::nearest::{Tree, square_to_triangle};
use super::reference::Reference;
use crate::mesh::TetMesh;
use crate::surface::select::faces_where;
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
/// the features. `claimed` holds a byte for each tetrahedron: bit k says that the mesh holds face k
/// (opposite node k) to lie on a feature.
///
/// Cost: a microsecond or less for each feature point and each two square samples of faces; the
/// result does not depend on the number of threads.
///
/// # Errors
/// [`Error::Mesh`] if `claimed` has not one byte a tetrahedron.
pub fn fidelity(
    mesh: &TetMesh,
    reference: &Reference<'_>,
    claimed: Option<&[u8]>,
) -> Result<Fidelity> {
    if let Some(flags) = claimed
        && flags.len() != mesh.tets.len()
    {
        return Err(Error::Mesh(cause(
            "fidelity",
            format!("{} bytes for {} tetrahedra", flags.len(), mesh.tets.len()),
            "give one byte a tetrahedron",
        )));
    }
    let near: Vec<bool> = mesh
        .nodes
        .par_iter()
        .map(|&p| reference.within(p, NODE))
        .collect();
    let mut on_feature = faces_where(mesh, |_, _, face| face.iter().all(|&n| near[n as usize]));
    on_feature = on_feature
        .into_par_iter()
        .filter(|face| {
            let [a, b, c] = corners(mesh, *face);
            let centroid = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
            reference.within(centroid, CENTROID)
        })
        .collect();
    let claimed = claimed.map(|flags| faces_where(mesh, |t, k, _| flags[t] >> k & 1 == 1));
    // Most claimed faces are on-feature faces: each is sampled once.
    let mut all = [
        on_feature.as_slice(),
        claimed.as_deref().unwrap_or_default(),
    ]
    .concat();
    all.par_sort_unstable();
    all.dedup();
    let pieces: Vec<Vec<Piece>> = all
        .par_iter()
        .map(|&face| sample(corners(mesh, face), reference))
        .collect();
    let pieces_of = |faces: &[[u32; 3]]| -> Vec<Piece> {
        let numbers = faces.iter().filter_map(|face| all.binary_search(face).ok());
        numbers.flat_map(|k| &pieces[k]).copied().collect()
    };
    let compare = |faces: &[[u32; 3]]| compare(mesh, faces, pieces_of(faces), &reference.points);
    Ok(Fidelity {
        reference: reference.source.to_string(),
        feature_points: reference.points.len(),
        on_feature: compare(&on_feature),
        claimed: claimed.as_deref().map(compare),
    })
}

fn corners(mesh: &TetMesh, face: [u32; 3]) -> [[f64; 3]; 3] {
    face.map(|n| mesh.nodes[n as usize])
}

/// Compares faces, given also as pieces, with points of the features.
fn compare(
    mesh: &TetMesh,
    faces: &[[u32; 3]],
    mut to_features: Vec<Piece>,
    points: &[[f32; 3]],
) -> Match {
    let triangles: Vec<[[f64; 3]; 3]> = faces.iter().map(|&f| corners(mesh, f)).collect();
    let boxes: Vec<[[f64; 3]; 2]> = triangles
        .iter()
        .map(|[a, b, c]| {
            [
                std::array::from_fn(|k| a[k].min(b[k]).min(c[k])),
                std::array::from_fn(|k| a[k].max(b[k]).max(c[k])),
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
                    let found = tree.nearest(p, f64::INFINITY, hint, |i| {
                        square_to_triangle(p, triangles[i])
                    });
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

/// The equal small triangles of a face, each measured at its centroid, and the face's corners,
/// which have no area but count for the largest distance.
fn sample(triangle: [[f64; 3]; 3], reference: &Reference<'_>) -> Vec<Piece> {
    let [a, b, c] = triangle;
    let edge = |p: [f64; 3], q: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| q[k] - p[k]) };
    let length = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let (u, v) = (edge(a, b), edge(a, c));
    let cross = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let longest = length(u).max(length(v)).max(length(edge(b, c)));
    let n = (longest / FINE).ceil().clamp(1.0, 256.0) as usize;
    let part = 0.5 * length(cross) / (n * n) as f64;
    let at = |i: f64, j: f64| {
        let (s, t) = (i / n as f64, j / n as f64);
        reference.distance(std::array::from_fn(|k| a[k] + s * u[k] + t * v[k]))
    };
    let mut pieces: Vec<Piece> = triangle
        .iter()
        .map(|&corner| (reference.distance(corner), 0.0))
        .collect();
    for i in 0..n {
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
