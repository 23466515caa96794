//! Distances from a point to triangles and segments.

use super::{dot, sub, to_3d};

type Point3 = [f64; 3];

/// Returns the squared distance from a point to a triangle. It is exact in all seven regions of the
/// plane (the inside, three edges, three corners), and for degenerate triangles. Source: Ericson,
/// Real-Time Collision Detection, 5.1.5.
#[inline]
pub fn squared_distance_to_triangle(p: Point3, [a, b, c]: [Point3; 3]) -> f64 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let square = |t: f64, u: f64| {
        let x = ap[0] - t * ab[0] - u * ac[0];
        let y = ap[1] - t * ab[1] - u * ac[1];
        let z = ap[2] - t * ab[2] - u * ac[2];
        x * x + y * y + z * z
    };
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return square(0.0, 0.0);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return square(1.0, 0.0);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return square(d1 / (d1 - d3), 0.0);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return square(0.0, 1.0);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return square(0.0, d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let u = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return square(1.0 - u, u);
    }
    let sum = va + vb + vc;
    square(vb / sum, vc / sum)
}

/// Returns the squared distance from a point to a face of a mesh: a triangle in 3-D, a segment
/// (which is a degenerate triangle) in 2-D.
pub fn squared_distance_to_face<const D: usize>(p: [f64; D], face: &[[f64; D]; D]) -> f64 {
    squared_distance_to_triangle(to_3d(p), [face[0], face[1], face[D - 1]].map(to_3d))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    #[test]
    fn distance_to_a_triangle_is_the_least_over_its_points() {
        let mut random = Random::new(1);
        for _ in 0..300 {
            let mut point = || -> Point3 { std::array::from_fn(|_| random.draw()) };
            let (p, t) = (point(), [point(), point(), point()]);
            let exact = squared_distance_to_triangle(p, t).sqrt();
            let n = 100;
            let mut scanned = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
                    let q: Point3 = std::array::from_fn(|k| {
                        (1.0 - u - v) * t[0][k] + u * t[1][k] + v * t[2][k]
                    });
                    let gap = sub(p, q);
                    scanned = scanned.min(dot(gap, gap).sqrt());
                }
            }
            assert!(
                exact <= scanned + 1e-12 && scanned < exact + 0.02,
                "{exact} {scanned}"
            );
        }
    }

    #[test]
    fn a_segment_is_a_flat_triangle() {
        let segment = [[1.0, 1.0], [3.0, 1.0]];
        for (p, square) in [
            ([2.0, 3.0], 4.0),
            ([0.0, 1.0], 1.0),
            ([4.0, 2.0], 2.0),
            ([1.5, 1.0], 0.0),
        ] {
            assert_eq!(squared_distance_to_face(p, &segment), square);
        }
        assert_eq!(squared_distance_to_face([0.0, 0.0], &[[3.0, 4.0]; 2]), 25.0);
    }
}
