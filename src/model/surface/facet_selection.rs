//! The facets of a mesh that lie on features.

use crate::parallel::prelude::*;

use crate::feature::eigen::{eigenvalues, eigenvector};
use crate::geometry::{add_scaled, dot, norm, normal};
use crate::image::SparseField;
use crate::mesh::Mesh;

/// Faces that one task looks at.
const CHUNK_FACES: usize = 1 << 14;

/// Every facet of a mesh for which `wanted(number of its face, nodes ascending)` holds, once, nodes
/// ascending.
pub fn facets_where<const D: usize, F: Mesh<D>>(
    mesh: &F,
    wanted: impl Fn(usize, &[u32; D]) -> bool + Sync,
) -> Vec<[u32; D]> {
    let count = mesh.face_count();
    let mut facets: Vec<[u32; D]> = (0..count.div_ceil(CHUNK_FACES))
        .into_par_iter()
        .flat_map_iter(|chunk| {
            let mut here = Vec::new();
            for face in chunk * CHUNK_FACES..count.min((chunk + 1) * CHUNK_FACES) {
                mesh.facets(face, |mut facet| {
                    facet.sort_unstable();
                    if wanted(face, &facet) {
                        here.push(facet);
                    }
                });
            }
            here
        })
        .collect();
    facets.par_sort_unstable();
    facets.dedup();
    facets
}

/// The facets of marked faces: `marks` by number of face.
pub fn marked_facets<const D: usize, F: Mesh<D>>(mesh: &F, marks: &[bool]) -> Vec<[u32; D]> {
    facets_where(mesh, |face, _| marks[face])
}

/// A label for each face of a mesh: the one that most of its facets have in `labelled` (nodes ascending,
/// sorted), of equals the first; 0 unless all of its facets have one. Two faces may share a facet, and each
/// has its own label nevertheless.
pub fn labels_of_faces<const D: usize, F: Mesh<D>>(
    mesh: &F,
    labelled: &[([u32; D], u32)],
) -> Vec<u32> {
    let mut on = vec![false; mesh.nodes().len()];
    for &n in labelled.iter().flat_map(|(facet, _)| facet) {
        on[n as usize] = true;
    }
    let label = |face: usize| {
        let mut counts: Vec<(u32, usize)> = Vec::new();
        let mut is_bare = false;
        mesh.facets(face, |mut facet| {
            facet.sort_unstable();
            let is_on = facet.iter().all(|&n| on[n as usize]);
            let place = match is_on {
                true => labelled
                    .binary_search_by(|(known, _)| known.cmp(&facet))
                    .ok(),
                false => None,
            };
            let Some(at) = place else {
                is_bare = true;
                return;
            };
            let number = labelled[at].1;
            match counts.iter_mut().find(|count| count.0 == number) {
                Some(count) => count.1 += 1,
                None => counts.push((number, 1)),
            }
        });
        let mut most = (0, 0);
        for count in counts {
            if count.1 > most.1 {
                most = count;
            }
        }
        if is_bare { 0 } else { most.0 }
    };
    (0..mesh.face_count()).into_par_iter().map(label).collect()
}

/// The facets that lie on valleys of b(x): b is at most `-depth` at their nodes and centroid, and their
/// normal is within the angle of cosine `along` of the valley's. That is the direction in which b
/// varies most about the centroid: the main eigenvector of the structure tensor of b, whose window
/// is the valley, of width `sigma` (Hale 2002: d / 4).
///
/// Mesh and potential in one space.
pub fn valley_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    potential: &SparseField<D>,
    sigma: f64,
    depth: f64,
    along: f64,
) -> Vec<[u32; D]> {
    let nodes = mesh.nodes();
    let deep: Vec<bool> = (nodes.par_iter())
        .map(|&x| potential.value(x) <= -depth)
        .collect();
    facets_where(mesh, |_, facet| facet.iter().all(|&n| deep[n as usize]))
        .into_par_iter()
        .filter(|facet| {
            let corners = facet.map(|n| nodes[n as usize]);
            let centroid: [f64; D] =
                std::array::from_fn(|k| corners.iter().map(|x| x[k]).sum::<f64>() / D as f64);
            let normal = normal(&corners);
            potential.value(centroid) <= -depth
                && dot(valley_normal(potential, sigma, centroid), normal).abs()
                    > along * norm(normal)
        })
        .collect()
}

/// Main eigenvector of the structure tensor of a potential about `x`: of 3^D gradients, sigma apart.
fn valley_normal<const D: usize>(potential: &SparseField<D>, sigma: f64, x: [f64; D]) -> [f64; D] {
    let mut tensor = [[0.0; D]; D];
    for code in 0..3usize.pow(D as u32) {
        let offset: [f64; D] =
            std::array::from_fn(|k| (code / 3usize.pow(k as u32) % 3) as f64 - 1.0);
        let weight = (-0.5 * dot(offset, offset)).exp();
        let at = add_scaled(x, sigma, offset);
        let (_, gradient) = potential.value_and_gradient(at);
        for (i, row) in tensor.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += weight * gradient[i] * gradient[j];
            }
        }
    }
    let largest = eigenvalues(&tensor)[D - 1];
    eigenvector(&tensor, largest)
}
