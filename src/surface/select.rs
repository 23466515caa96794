//! The faces of a mesh that lie on features.

use rayon::prelude::*;

use crate::mesh::{FACES, TetMesh};

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
