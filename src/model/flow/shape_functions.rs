//! Linear shape functions on triangles and tetrahedra: 1 at one node of a cell, 0 at the others.

use crate::geometry::dot;
use crate::mesh::Simplices;

/// Returns `n!`. The volume of a parallelepiped is D! times that of the simplex with the same
/// edges.
pub const fn factorial(n: usize) -> f64 {
    if n > 1 {
        n as f64 * factorial(n - 1)
    } else {
        1.0
    }
}

/// Returns the positions of a cell's D + 1 corners, then zeros.
#[inline]
pub fn corners<const D: usize, M: Simplices<D>>(mesh: &M, cell: usize) -> [[f64; D]; 4] {
    let mut p = [[0.0; D]; 4];
    for (p, &node) in p.iter_mut().zip(mesh.cell(cell)) {
        *p = mesh.nodes()[node as usize];
    }
    p
}

/// Returns the gradients of the D + 1 linear shape functions, each times D! volumes (then zeros),
/// and D! times the volume.
#[inline]
pub fn gradients<const D: usize>(p: &[[f64; D]; 4]) -> ([[f64; D]; 4], f64) {
    const { assert!(D == 2 || D == 3, "flow is in two or three dimensions") };
    let edge = |k: usize| -> [f64; D] { std::array::from_fn(|c| p[k][c] - p[0][c]) };
    let mut g = [[0.0; D]; 4];
    for k in 1..=D {
        let next = edge(k % D + 1);
        if D == 2 {
            // The other edge turned by a right angle: anticlockwise for node 2, clockwise for node
            // 1.
            let sign = if k == 1 { 1.0 } else { -1.0 };
            (g[k][0], g[k][1]) = (sign * next[1], -sign * next[0]);
        } else {
            let last = edge((k + 1) % D + 1);
            for c in 0..D {
                let (i, j) = ((c + 1) % D, (c + 2) % D);
                g[k][c] = next[i] * last[j] - next[j] * last[i];
            }
        }
    }
    g[0] = std::array::from_fn(|c| -(1..=D).map(|k| g[k][c]).sum::<f64>());
    (g, dot(edge(1), g[1]))
}

/// Returns the outward area vector of a face. `gradient` is the gradient of the shape function of
/// the opposite node, times D! volumes.
#[inline]
pub fn area_vector<const D: usize>(gradient: [f64; D]) -> [f64; D] {
    gradient.map(|c| -c / const { factorial(D - 1) })
}

/// Returns the distance of a cell's centroid from the face opposite a node: the height over that
/// face divided by D + 1. `gradient` and `size` are those of [`gradients`].
#[inline]
pub fn centre_to_face<const D: usize>(gradient: [f64; D], size: f64) -> f64 {
    size / ((D + 1) as f64 * dot(gradient, gradient).sqrt())
}
