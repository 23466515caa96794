//! The shape of a tetrahedron, measured by its dihedral angles.

use super::{EDGES, cross, dot, sub, volume6};

/// The six dihedral angles in degrees, in the order of [`EDGES`].
pub fn dihedral_angles(p: &[[f64; 3]; 4]) -> [f64; 6] {
    EDGES.map(|[i, j]| {
        // The two nodes off the edge; the angle between the faces' heights over the edge.
        let [k, l] = match (i, j) {
            (0, 1) => [2, 3],
            (0, 2) => [1, 3],
            (0, 3) => [1, 2],
            (1, 2) => [0, 3],
            (1, 3) => [0, 2],
            _ => [0, 1],
        };
        let e = sub(p[j], p[i]);
        let m = cross(e, sub(p[k], p[i]));
        let n = cross(e, sub(p[l], p[i]));
        let sine = super::norm(cross(m, n));
        sine.atan2(dot(m, n)).to_degrees()
    })
}

/// The smallest sine of the six dihedral angles; negative for an inverted tetrahedron.
///
/// This is what improvement maximises: small and large angles count alike, every angle lies in
/// [30, 150] degrees exactly when it is at least 1/2, and it needs no trigonometry: the sine at an
/// edge of length l between faces of areas A and B is 3 V l / (2 A B) (Klingner & Shewchuk 2007).
#[inline]
pub fn min_sine(p: &[[f64; 3]; 4]) -> f64 {
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (u, v) = (sub(p[2], p[1]), sub(p[3], p[1]));
    let w = sub(p[3], p[2]);
    let n3 = cross(a, b);
    let n2 = cross(a, c);
    let n1 = cross(b, c);
    let n0 = cross(u, v);
    let volume = dot(c, n3);
    let (s0, s1, s2, s3) = (dot(n0, n0), dot(n1, n1), dot(n2, n2), dot(n3, n3));
    // sin^2 = V^2 l^2 / (|n_i|^2 |n_j|^2); edge between nodes (i, j) borders the faces opposite the
    // other two nodes.
    let m = (dot(a, a) * s0 * s1)
        .min(dot(b, b) * s0 * s2)
        .min(dot(c, c) * s0 * s3)
        .min(dot(u, u) * s1 * s2)
        .min(dot(v, v) * s1 * s3)
        .min(dot(w, w) * s2 * s3);
    let denominator = s0 * s1 * s2 * s3;
    if denominator <= 0.0 {
        return -1.0;
    }
    let sine = (m / denominator).sqrt() * volume.abs();
    if volume > 0.0 { sine } else { -sine }
}

/// Mean ratio: 12 (3 V)^(2/3) / (sum of squared edge lengths); 1 for the regular tetrahedron
/// (Liu & Joe 1994).
pub fn mean_ratio(p: &[[f64; 3]; 4]) -> f64 {
    let lengths: f64 = EDGES
        .iter()
        .map(|&[i, j]| {
            let e = sub(p[j], p[i]);
            dot(e, e)
        })
        .sum();
    let volume = volume6(p) / 6.0;
    if volume <= 0.0 || lengths <= 0.0 {
        return 0.0;
    }
    12.0 * (3.0 * volume).powf(2.0 / 3.0) / lengths
}

/// Radius of the circumscribed sphere over the shortest edge; 0.612 for the regular tetrahedron.
pub fn radius_edge_ratio(p: &[[f64; 3]; 4]) -> f64 {
    let shortest = EDGES
        .iter()
        .map(|&[i, j]| {
            let e = sub(p[j], p[i]);
            dot(e, e)
        })
        .fold(f64::INFINITY, f64::min)
        .sqrt();
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
    let (aa, bb, cc) = (dot(a, a), dot(b, b), dot(c, c));
    let top: [f64; 3] = std::array::from_fn(|k| aa * bc[k] + bb * ca[k] + cc * ab[k]);
    super::norm(top) / (2.0 * volume6(p).abs()) / shortest
}

/// All figures of one tetrahedron, from what they share: a quarter of the cost of one by one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Of the dihedral angles, in the order of [`EDGES`]; good to 1e-6 degrees near 0 and 180. An
    /// angle at a face without area is called 0.
    pub cosines: [f64; 6],
    /// See [`mean_ratio`].
    pub mean_ratio: f64,
    /// See [`radius_edge_ratio`].
    pub radius_edge: f64,
    /// Signed volume.
    pub volume: f64,
}

impl Shape {
    /// Measures the tetrahedron with these corners.
    #[inline]
    pub fn of(p: &[[f64; 3]; 4]) -> Self {
        let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
        let (u, v, w) = (sub(p[2], p[1]), sub(p[3], p[1]), sub(p[3], p[2]));
        // Of the faces opposite each node, all outward (or all inward).
        let normals = [cross(u, v), cross(c, b), cross(a, c), cross(b, a)];
        let inverses = normals.map(|n| {
            let square = dot(n, n);
            if square > 0.0 {
                1.0 / square.sqrt()
            } else {
                0.0
            }
        });
        let cosines = std::array::from_fn(|e| {
            // Edge e lies between the faces opposite the two nodes of the opposite edge.
            let [k, l] = EDGES[5 - e];
            let inverse = inverses[k] * inverses[l];
            if inverse > 0.0 {
                (-dot(normals[k], normals[l]) * inverse).clamp(-1.0, 1.0)
            } else {
                1.0
            }
        });
        let squares = [a, b, c, u, v, w].map(|e| dot(e, e));
        let sum = squares.iter().sum::<f64>();
        let shortest = squares.iter().copied().fold(f64::INFINITY, f64::min);
        // Six times the volume; positive as in `volume6`.
        let volume6 = -dot(c, normals[3]);
        let mean_ratio = if volume6 > 0.0 && sum > 0.0 {
            12.0 * (0.25 * volume6 * volume6).cbrt() / sum
        } else {
            0.0
        };
        let top: [f64; 3] = std::array::from_fn(|k| {
            squares[0] * -normals[1][k] + squares[1] * -normals[2][k] + squares[2] * -normals[3][k]
        });
        let radius_edge = (dot(top, top) / shortest).sqrt() / (2.0 * volume6.abs());
        Self {
            cosines,
            mean_ratio,
            radius_edge,
            volume: volume6 / 6.0,
        }
    }

    /// The smallest dihedral angle, in degrees.
    #[inline]
    pub fn smallest_angle(&self) -> f64 {
        let most = self.cosines.iter().copied().fold(-1.0, f64::max);
        most.acos().to_degrees()
    }

    /// The largest dihedral angle, in degrees.
    #[inline]
    pub fn largest_angle(&self) -> f64 {
        let least = self.cosines.iter().copied().fold(1.0, f64::min);
        least.acos().to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const REGULAR: [[f64; 3]; 4] = [
        [1.0, 1.0, 1.0],
        [-1.0, 1.0, -1.0],
        [1.0, -1.0, -1.0],
        [-1.0, -1.0, 1.0],
    ];

    #[test]
    fn regular_tetrahedron() {
        assert!(volume6(&REGULAR) > 0.0);
        for angle in dihedral_angles(&REGULAR) {
            assert!((angle - (1.0f64 / 3.0).acos().to_degrees()).abs() < 1e-12);
        }
        assert!((min_sine(&REGULAR) - 8f64.sqrt() / 3.0).abs() < 1e-14);
        assert!((mean_ratio(&REGULAR) - 1.0).abs() < 1e-14);
        assert!((radius_edge_ratio(&REGULAR) - 6f64.sqrt() / 4.0).abs() < 1e-14);
    }

    #[test]
    fn corner_of_the_cube() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut angles = dihedral_angles(&p);
        angles.sort_by(f64::total_cmp);
        for (got, want) in angles
            .iter()
            .zip([54.7356, 54.7356, 54.7356, 90.0, 90.0, 90.0])
        {
            assert!((got - want).abs() < 1e-4);
        }
    }

    proptest! {
        #[test]
        fn shapes_are_the_single_figures(c in proptest::array::uniform12(-1.0f64..1.0)) {
            let p = [[c[0], c[1], c[2]], [c[3], c[4], c[5]], [c[6], c[7], c[8]], [c[9], c[10], c[11]]];
            prop_assume!(volume6(&p).abs() > 1e-4);
            let shape = Shape::of(&p);
            let angles = dihedral_angles(&p);
            for (cosine, exact) in shape.cosines.into_iter().zip(angles) {
                prop_assert!((cosine.acos().to_degrees() - exact).abs() < 1e-5);
            }
            let least = angles.into_iter().fold(f64::INFINITY, f64::min);
            let most = angles.into_iter().fold(0.0, f64::max);
            prop_assert!((shape.smallest_angle() - least).abs() < 1e-5);
            prop_assert!((shape.largest_angle() - most).abs() < 1e-5);
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-8 * b.abs();
            prop_assert!(close(shape.volume, volume6(&p) / 6.0));
            prop_assert!(close(shape.mean_ratio, mean_ratio(&p)));
            prop_assert!(close(shape.radius_edge, radius_edge_ratio(&p)));
        }

        #[test]
        fn min_sine_is_the_smallest_sine_of_the_angles(
            c in proptest::array::uniform12(-1.0f64..1.0)
        ) {
            let p = [[c[0], c[1], c[2]], [c[3], c[4], c[5]], [c[6], c[7], c[8]], [c[9], c[10], c[11]]];
            let v = volume6(&p);
            prop_assume!(v.abs() > 1e-4);
            let expected = dihedral_angles(&p)
                .iter()
                .map(|a| a.to_radians().sin())
                .fold(f64::INFINITY, f64::min);
            let got = min_sine(&p);
            prop_assert!(got.signum() == v.signum());
            prop_assert!((got.abs() - expected).abs() < 1e-9);
        }
    }
}
