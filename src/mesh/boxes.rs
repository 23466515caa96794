//! Meshes for tests: boxes of cubes, each cut into tetrahedra (in 2-D: squares cut into triangles)
//! along its diagonal.

use super::{Simplices, TetMesh};
use crate::geometry::grid_index::{index_at, offset_of};

/// Returns a box from the origin to `extent` with `n` cubes along each axis. Inner nodes for which
/// `is_movable` returns true are shifted by up to `jitter` of a cube.
pub fn jittered_box<const D: usize, M: Simplices<D>>(
    n: [usize; D],
    extent: [f64; D],
    jitter: f64,
    is_movable: impl Fn([f64; D]) -> bool,
) -> M {
    let mut state = 1u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    };
    let node_counts = n.map(|n| n + 1);
    let mut nodes = Vec::new();
    for i in 0..node_counts.iter().product() {
        let index = index_at(node_counts, i);
        let inside = (0..D).all(|c| index[c] > 0 && index[c] < n[c]);
        let x: [f64; D] = std::array::from_fn(|c| index[c] as f64 * extent[c] / n[c] as f64);
        let shift = if inside && is_movable(x) { jitter } else { 0.0 };
        nodes.push(std::array::from_fn(|c| {
            x[c] + shift * noise() * extent[c] / n[c] as f64
        }));
    }
    let node_at = |index: [usize; D]| offset_of(node_counts, index) as u32;
    // Each permutation of the axes is a path of edges from the low corner of the cube to the high
    // one. The first half of the permutations is even, the second half odd.
    let paths: &[[usize; 3]] = match D {
        2 => &[[0, 1, 2], [1, 0, 2]],
        _ => &[
            [0, 1, 2],
            [1, 2, 0],
            [2, 0, 1],
            [0, 2, 1],
            [2, 1, 0],
            [1, 0, 2],
        ],
    };
    let mut corners = Vec::new();
    for i in 0..n.iter().product() {
        for (path, order) in paths.iter().enumerate() {
            let mut index = index_at(n, i);
            let mut cell = vec![node_at(index)];
            for &axis in &order[..D] {
                index[axis] += 1;
                cell.push(node_at(index));
            }
            if path >= paths.len() / 2 {
                cell.swap(D - 1, D);
            }
            corners.extend(cell);
        }
    }
    M::from_parts(nodes, corners)
}

/// Returns a box from the origin with `n` cubes of side `size` along each axis, cut into Kuhn's
/// tetrahedra.
pub fn kuhn_box(n: [usize; 3], size: f64) -> TetMesh {
    jittered_box(n, n.map(|n| size * n as f64), 0.0, |_| false)
}

/// Returns for each cell the faces, as bits, whose nodes all lie on a surface.
pub fn faces_on<const D: usize, M: Simplices<D>>(
    mesh: &M,
    is_on_surface: impl Fn([f64; D]) -> bool,
) -> Vec<u8> {
    let marked: Vec<bool> = mesh.nodes().iter().map(|&x| is_on_surface(x)).collect();
    let bits = |c: usize| {
        let is_on = |k: usize| mesh.face(c, k).iter().all(|&i| marked[i as usize]);
        (0..=D).filter(|&k| is_on(k)).map(|k| 1 << k).sum()
    };
    (0..mesh.len()).map(bits).collect()
}
