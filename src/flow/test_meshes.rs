//! Meshes for tests: boxes of cubes, each cut into the six tetrahedra about its diagonal.

use crate::mesh::{FACES, TetMesh};

/// `n` cubes along each axis of a box from the origin to `extent`; inner nodes for which `moves`
/// holds are shifted by up to `jitter` of a cube.
pub fn jittered_box(
    n: [usize; 3],
    extent: [f64; 3],
    jitter: f64,
    moves: impl Fn([f64; 3]) -> bool,
) -> TetMesh {
    let mut mesh = TetMesh::default();
    let mut state = 1u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    };
    for k in 0..=n[2] {
        for j in 0..=n[1] {
            for i in 0..=n[0] {
                let at = [i, j, k];
                let inside = (0..3).all(|c| at[c] > 0 && at[c] < n[c]);
                let x: [f64; 3] = std::array::from_fn(|c| at[c] as f64 / n[c] as f64 * extent[c]);
                let shift = if inside && moves(x) { jitter } else { 0.0 };
                mesh.nodes.push(std::array::from_fn(|c| {
                    x[c] + shift * noise() * extent[c] / n[c] as f64
                }));
            }
        }
    }
    let node = |at: [usize; 3]| ((at[2] * (n[1] + 1) + at[1]) * (n[0] + 1) + at[0]) as u32;
    // Each order of the axes is a path of edges from the near corner to the far one.
    let paths = [
        [0, 1, 2],
        [1, 2, 0],
        [2, 0, 1],
        [0, 2, 1],
        [2, 1, 0],
        [1, 0, 2],
    ];
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                for (path, order) in paths.into_iter().enumerate() {
                    let mut at = [i, j, k];
                    let mut tet = [node(at); 4];
                    for (corner, axis) in order.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[corner + 1] = node(at);
                    }
                    if path >= 3 {
                        tet.swap(2, 3);
                    }
                    mesh.tets.push(tet);
                }
            }
        }
    }
    mesh
}

/// Bits for the faces whose three nodes all are on a surface.
pub fn faces_on(mesh: &TetMesh, on: impl Fn([f64; 3]) -> bool) -> Vec<u8> {
    let marked: Vec<bool> = mesh.nodes.iter().map(|&x| on(x)).collect();
    let bits = |tet: &[u32; 4]| {
        let is_on = |k: usize| FACES[k].iter().all(|&i| marked[tet[i] as usize]);
        (0..4).filter(|&k| is_on(k)).map(|k| 1 << k).sum()
    };
    mesh.tets.iter().map(bits).collect()
}
