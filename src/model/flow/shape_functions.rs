//! Linear functions on triangles and tetrahedra: 1 at one node of a cell, 0 at the others.

use crate::geometry::dot;
use crate::mesh::Simplices;

/// `n!`: the parallelepiped of D edges is D! simplices.
pub const fn factorial(n: usize) -> f64 {
    if n > 1 {
        n as f64 * factorial(n - 1)
    } else {
        1.0
    }
}

/// Corner positions of a cell, D + 1 of them, then zeros.
#[inline]
pub fn corners<const D: usize, M: Simplices<D>>(mesh: &M, cell: usize) -> [[f64; D]; 4] {
    let mut p = [[0.0; D]; 4];
    for (p, &node) in p.iter_mut().zip(mesh.cell(cell)) {
        *p = mesh.nodes()[node as usize];
    }
    p
}

/// Gradients of the D + 1 linear base functions, times D! volumes (then zeros), and D! volumes.
#[inline]
pub fn gradients<const D: usize>(p: &[[f64; D]; 4]) -> ([[f64; D]; 4], f64) {
    const { assert!(D == 2 || D == 3, "flow is in two or three dimensions") };
    let edge = |k: usize| -> [f64; D] { std::array::from_fn(|c| p[k][c] - p[0][c]) };
    let mut g = [[0.0; D]; 4];
    for k in 1..=D {
        let next = edge(k % D + 1);
        if D == 2 {
            // A right angle from the other edge, anticlockwise of it for node 1.
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

/// The area vector, outwards, of the face whose base function has this gradient times D! volumes:
/// its length is (D - 1)! areas.
#[inline]
pub fn area_vector<const D: usize>(gradient: [f64; D]) -> [f64; D] {
    gradient.map(|c| -c / const { factorial(D - 1) })
}

/// Distance of a cell's centroid from that face: a part of D + 1 of the height.
#[inline]
pub fn centre_to_face<const D: usize>(gradient: [f64; D], size: f64) -> f64 {
    size / ((D + 1) as f64 * dot(gradient, gradient).sqrt())
}
