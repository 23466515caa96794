//! The faces of a mesh that lie on features.

use rayon::prelude::*;

use crate::feature::symmetric::{eigenvalues, eigenvector};
use crate::image::Field;
use crate::mesh::{FACES, TetMesh, add_scaled, cross, dot, norm, sub};

/// Every face of a mesh for which `wanted(tetrahedron, k, nodes)` holds, once, nodes ascending.
pub fn faces_where(
    mesh: &TetMesh,
    wanted: impl Fn(usize, usize, &[u32; 3]) -> bool + Sync,
) -> Vec<[u32; 3]> {
    let mut faces: Vec<[u32; 3]> = (0..mesh.tets.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let wanted = &wanted;
            let tet = mesh.tets[t];
            (0..4).filter_map(move |k| {
                let mut face = FACES[k].map(|i| tet[i]);
                face.sort_unstable();
                wanted(t, k, &face).then_some(face)
            })
        })
        .collect();
    faces.par_sort_unstable();
    faces.dedup();
    faces
}

/// The faces that the mesh itself says lie on features: bit k of a tetrahedron's byte stands for its
/// face opposite node k.
pub fn marked(mesh: &TetMesh, bits: &[u8]) -> Vec<[u32; 3]> {
    faces_where(mesh, |t, k, _| bits[t] >> k & 1 == 1)
}

/// The faces not in `taken` (sorted) whose nodes are all nodes of faces in it: where gaps may be closed.
pub fn spanned(mesh: &TetMesh, taken: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut on = vec![false; mesh.nodes.len()];
    for &n in taken.as_flattened() {
        on[n as usize] = true;
    }
    faces_where(mesh, |_, _, face| {
        face.iter().all(|&n| on[n as usize]) && taken.binary_search(face).is_err()
    })
}

/// The faces that lie on valleys of b(x): b is at most `-depth` at their nodes and centroid, and their
/// normal is within the angle of cosine `along` of the valley's. That is the direction in which b
/// varies most about the centroid: the main eigenvector of the structure tensor of b, whose window
/// is the valley, of width `sigma` (Hale 2002: d / 4).
///
/// Mesh and potential in one space.
pub fn in_valleys(
    mesh: &TetMesh,
    potential: &Field<3>,
    sigma: f64,
    depth: f64,
    along: f64,
) -> Vec<[u32; 3]> {
    let deep: Vec<bool> = (mesh.nodes.par_iter())
        .map(|&x| potential.value(x) <= -depth)
        .collect();
    let mut faces = faces_where(mesh, |_, _, face| face.iter().all(|&n| deep[n as usize]));
    faces = faces
        .into_par_iter()
        .filter(|face| {
            let [a, b, c] = face.map(|n| mesh.nodes[n as usize]);
            let centroid = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
            let normal = cross(sub(b, a), sub(c, a));
            potential.value(centroid) <= -depth
                && dot(valley_normal(potential, sigma, centroid), normal).abs()
                    > along * norm(normal)
        })
        .collect();
    faces
}

/// Main eigenvector of the structure tensor of a potential about `x`: of 27 gradients, sigma apart.
fn valley_normal(potential: &Field<3>, sigma: f64, x: [f64; 3]) -> [f64; 3] {
    let mut tensor = [[0.0; 3]; 3];
    for code in 0..27 {
        let offset = [code % 3, code / 3 % 3, code / 9].map(|i| f64::from(i) - 1.0);
        let weight = (-0.5 * dot(offset, offset)).exp();
        let at = add_scaled(x, sigma, offset);
        let (_, gradient) = potential.value_and_gradient(at);
        for (i, row) in tensor.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += weight * gradient[i] * gradient[j];
            }
        }
    }
    let [_, _, largest] = eigenvalues(&tensor);
    eigenvector(&tensor, largest)
}
