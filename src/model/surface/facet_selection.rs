//! Selects the facets of a mesh that lie on features.

use crate::parallel::prelude::*;

use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::{add_scaled, dot, norm, normal};
use crate::image::SparseField;
use crate::mesh::Mesh;

/// Number of faces that one task processes.
const CHUNK_FACES: usize = 1 << 14;

/// Returns every facet of a mesh for which `predicate(face number, facet)` is `true`, once. The
/// nodes of facets are in ascending order.
pub fn facets_where<const D: usize, F: Mesh<D>>(
    mesh: &F,
    predicate: impl Fn(usize, &[u32; D]) -> bool + Sync,
) -> Vec<[u32; D]> {
    let count = mesh.face_count();
    let mut facets: Vec<[u32; D]> = (0..count.div_ceil(CHUNK_FACES))
        .into_par_iter()
        .flat_map_iter(|chunk| {
            let mut chunk_facets = Vec::new();
            for face in chunk * CHUNK_FACES..count.min((chunk + 1) * CHUNK_FACES) {
                mesh.facets(face, |mut facet| {
                    facet.sort_unstable();
                    if predicate(face, &facet) {
                        chunk_facets.push(facet);
                    }
                });
            }
            chunk_facets
        })
        .collect();
    facets.par_sort_unstable();
    facets.dedup();
    facets
}

/// Returns the facets of marked faces. `marks` has one entry for each face.
pub fn marked_facets<const D: usize, F: Mesh<D>>(mesh: &F, marks: &[bool]) -> Vec<[u32; D]> {
    facets_where(mesh, |face, _| marks[face])
}

/// Returns a label for each face of a mesh: the label that covers most of the area of its facets in
/// `labelled` (nodes ascending, sorted), the first one of equals. It is 0 unless all facets of the
/// face have a label.
///
/// Two polyhedral faces share a facet if three of its nodes lie on one edge of both. Such a facet
/// has no area, so that its label, which may be that of the other face, does not count.
pub fn labels_of_faces<const D: usize, F: Mesh<D>>(
    mesh: &F,
    labelled: &[([u32; D], u32)],
) -> Vec<u32> {
    let mut is_labelled = vec![false; mesh.nodes().len()];
    for &n in labelled.iter().flat_map(|(facet, _)| facet) {
        is_labelled[n as usize] = true;
    }
    let label = |face: usize| {
        let mut areas: Vec<(u32, f64)> = Vec::new();
        let mut has_unlabelled = false;
        mesh.facets(face, |mut facet| {
            facet.sort_unstable();
            let may_match = facet.iter().all(|&n| is_labelled[n as usize]);
            let position = if may_match {
                labelled
                    .binary_search_by(|(known, _)| known.cmp(&facet))
                    .ok()
            } else {
                None
            };
            let Some(index) = position else {
                has_unlabelled = true;
                return;
            };
            let facet_label = labelled[index].1;
            let area = norm(normal(&facet.map(|n| mesh.nodes()[n as usize])));
            match areas.iter_mut().find(|entry| entry.0 == facet_label) {
                Some(entry) => entry.1 += area,
                None => areas.push((facet_label, area)),
            }
        });
        let mut best = (0, -1.0);
        for entry in areas {
            if entry.1 > best.1 {
                best = entry;
            }
        }
        if has_unlabelled { 0 } else { best.0 }
    };
    (0..mesh.face_count()).into_par_iter().map(label).collect()
}

/// Returns the facets that lie on valleys of the potential b(x): b is at most `-depth` at their
/// nodes and centroid, and the cosine between their normal and that of the valley is above
/// `min_cosine`. The valley's normal is the direction in which b varies most around the centroid:
/// the main eigenvector of the structure tensor of b, with a window of the valley's width `sigma`
/// (Hale 2002: d / 4).
///
/// Mesh and potential are in the same space.
pub fn valley_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    potential: &SparseField<D>,
    sigma: f64,
    depth: f64,
    min_cosine: f64,
) -> Vec<[u32; D]> {
    let nodes = mesh.nodes();
    let is_deep: Vec<bool> = (nodes.par_iter())
        .map(|&x| potential.value(x) <= -depth)
        .collect();
    facets_where(mesh, |_, facet| facet.iter().all(|&n| is_deep[n as usize]))
        .into_par_iter()
        .filter(|facet| {
            let corners = facet.map(|n| nodes[n as usize]);
            let centroid: [f64; D] =
                std::array::from_fn(|k| corners.iter().map(|x| x[k]).sum::<f64>() / D as f64);
            let normal = normal(&corners);
            potential.value(centroid) <= -depth
                && dot(valley_normal(potential, sigma, centroid), normal).abs()
                    > min_cosine * norm(normal)
        })
        .collect()
}

/// Returns the main eigenvector of the structure tensor of a potential around `x`, from 3^D
/// gradients with the spacing sigma.
fn valley_normal<const D: usize>(potential: &SparseField<D>, sigma: f64, x: [f64; D]) -> [f64; D] {
    let mut tensor = [[0.0; D]; D];
    for code in 0..3usize.pow(D as u32) {
        let offset: [f64; D] =
            std::array::from_fn(|k| (code / 3usize.pow(k as u32) % 3) as f64 - 1.0);
        let weight = (-0.5 * dot(offset, offset)).exp();
        let point = add_scaled(x, sigma, offset);
        let (_, gradient) = potential.value_and_gradient(point);
        for (i, row) in tensor.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += weight * gradient[i] * gradient[j];
            }
        }
    }
    let eigenvalue = eigenvalues(&tensor)[D - 1];
    eigenvector(&tensor, eigenvalue)
}
