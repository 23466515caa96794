//! Meshes for tests: boxes of cubes, each cut into the tetrahedra (squares: triangles) about its
//! diagonal.

use super::{Simplices, TetMesh};

/// `n` cubes along each axis of a box from the origin to `extent`; inner nodes for which `moves`
/// holds are shifted by up to `jitter` of a cube.
pub fn jittered_box<const D: usize, M: Simplices<D>>(
    n: [usize; D],
    extent: [f64; D],
    jitter: f64,
    moves: impl Fn([f64; D]) -> bool,
) -> M {
    let mut state = 1u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    };
    // The place of number `i` among `counts` along each axis, x fastest.
    let place = |i: usize, counts: [usize; D]| -> [usize; D] {
        let mut rest = i;
        counts.map(|count| {
            let at = rest % count;
            rest /= count;
            at
        })
    };
    let posts = n.map(|n| n + 1);
    let mut nodes = Vec::new();
    for i in 0..posts.iter().product() {
        let at = place(i, posts);
        let inside = (0..D).all(|c| at[c] > 0 && at[c] < n[c]);
        let x: [f64; D] = std::array::from_fn(|c| at[c] as f64 * extent[c] / n[c] as f64);
        let shift = if inside && moves(x) { jitter } else { 0.0 };
        nodes.push(std::array::from_fn(|c| {
            x[c] + shift * noise() * extent[c] / n[c] as f64
        }));
    }
    let node = |at: [usize; D]| (0..D).rev().fold(0, |i, c| i * posts[c] + at[c]) as u32;
    // Each order of the axes is a path of edges from the near corner to the far one; those of the
    // first half turn one way, the others the other.
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
            let mut at = place(i, n);
            let mut cell = vec![node(at)];
            for &axis in &order[..D] {
                at[axis] += 1;
                cell.push(node(at));
            }
            if path >= paths.len() / 2 {
                cell.swap(D - 1, D);
            }
            corners.extend(cell);
        }
    }
    M::from_parts(nodes, corners)
}

/// `n` cubes along each axis, each of side `size`, from the origin.
pub fn kuhn_box(n: [usize; 3], size: f64) -> TetMesh {
    jittered_box(n, n.map(|n| size * n as f64), 0.0, |_| false)
}

/// Bits for the faces whose nodes all are on a surface.
pub fn faces_on<const D: usize, M: Simplices<D>>(
    mesh: &M,
    on: impl Fn([f64; D]) -> bool,
) -> Vec<u8> {
    let marked: Vec<bool> = mesh.nodes().iter().map(|&x| on(x)).collect();
    let bits = |c: usize| {
        let is_on = |k: usize| mesh.face(c, k).iter().all(|&i| marked[i as usize]);
        (0..=D).filter(|&k| is_on(k)).map(|k| 1 << k).sum()
    };
    (0..mesh.len()).map(bits).collect()
}
