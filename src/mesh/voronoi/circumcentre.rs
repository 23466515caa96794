//! Centres of circumscribed spheres and circles, accurate also for nearly flat simplices.
//!
//! The centre of a tetrahedron with edges u, v, w from its first corner has the offset `(|u|^2 v x
//! w + |v|^2 w x u + |w|^2 u x v) / (2 u . v x w)` from that corner. Rounding errors grow as the
//! denominator shrinks, so flat simplices are computed in doubled precision (pairs of doubles,
//! Dekker 1971). The corners are exact input, so the result is the centre of exactly that simplex.
//! If the determinant vanishes even there (atoms off a perfect grid by a few last digits), it is
//! computed in integers of arbitrary length.

use num_bigint::BigInt;
use num_traits::{FromPrimitive, ToPrimitive};

use crate::geometry::{cross, dot};

/// Smallest determinant of the edges, relative to the cube (in 2-D the square) of the longest edge,
/// for which doubles are accurate enough: the centre is correct to about 1e-12 of the radius. Below
/// it doubled precision is used.
const MIN_DOUBLE_DETERMINANT: f64 = 1e-3;

/// Smallest relative determinant for which pairs of doubles are accurate enough: the centre is
/// correct to 1e-12 of the radius. Below it integers are used.
const MIN_PRECISE_DETERMINANT: f64 = 1e-19;

/// Returns the centre of the circle through three points.
pub fn triangle_circumcentre(p: [[f64; 2]; 3]) -> [f64; 2] {
    let [u, v] = [1, 2].map(|i| [p[i][0] - p[0][0], p[i][1] - p[0][1]]);
    let (uu, vv) = (dot(u, u), dot(v, v));
    let det = u[0] * v[1] - u[1] * v[0];
    let offset = if det.abs() > MIN_DOUBLE_DETERMINANT * uu.max(vv) {
        let s = 0.5 / det;
        [s * (uu * v[1] - vv * u[1]), s * (vv * u[0] - uu * v[0])]
    } else {
        let [u, v] = [1, 2].map(|i| [0, 1].map(|k| DoubleDouble::difference(p[i][k], p[0][k])));
        let square = |a: [DoubleDouble; 2]| a[0] * a[0] + a[1] * a[1];
        let (uu, vv) = (square(u), square(v));
        let det = u[0] * v[1] - u[1] * v[0];
        let half_quotient = |a: DoubleDouble| 0.5 * a.divide(det);
        [
            half_quotient(uu * v[1] - vv * u[1]),
            half_quotient(vv * u[0] - uu * v[0]),
        ]
    };
    [p[0][0] + offset[0], p[0][1] + offset[1]]
}

/// Returns the centre of the sphere through four points.
pub fn tetrahedron_circumcentre(p: [[f64; 3]; 4]) -> [f64; 3] {
    let [u, v, w] = [1, 2, 3].map(|i| std::array::from_fn(|k| p[i][k] - p[0][k]));
    let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
    let [vw, wu, uv] = [cross(v, w), cross(w, u), cross(u, v)];
    let det = dot(u, vw);
    let longest = uu.max(vv).max(ww);
    let offset = if det.abs() > MIN_DOUBLE_DETERMINANT * longest * longest.sqrt() {
        let s = 0.5 / det;
        std::array::from_fn(|k| s * (uu * vw[k] + vv * wu[k] + ww * uv[k]))
    } else {
        precise_offset(p)
    };
    std::array::from_fn(|k| p[0][k] + offset[k])
}

#[cold]
fn precise_offset(p: [[f64; 3]; 4]) -> [f64; 3] {
    let [u, v, w] =
        [1, 2, 3].map(|i| [0, 1, 2].map(|k| DoubleDouble::difference(p[i][k], p[0][k])));
    let dot = |a: [DoubleDouble; 3], b: [DoubleDouble; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |a: [DoubleDouble; 3], b: [DoubleDouble; 3]| -> [DoubleDouble; 3] {
        std::array::from_fn(|k| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            a[i] * b[j] - a[j] * b[i]
        })
    };
    let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
    let [vw, wu, uv] = [cross(v, w), cross(w, u), cross(u, v)];
    let det = dot(u, vw);
    let longest = uu.0.max(vv.0).max(ww.0);
    if det.0.abs() <= MIN_PRECISE_DETERMINANT * longest * longest.sqrt() {
        return exact_offset(p, longest.sqrt());
    }
    std::array::from_fn(|k| 0.5 * (uu * vw[k] + vv * wu[k] + ww * uv[k]).divide(det))
}

/// Computes the offset of [`precise_offset`] in integers. Coordinates are in units of 2^-200 of the
/// longest edge, which is finer than their last digits.
#[cold]
fn exact_offset(p: [[f64; 3]; 4], longest: f64) -> [f64; 3] {
    let unit = (200.0 - longest.log2().floor()).exp2();
    let integers = p.map(|x| x.map(|c| BigInt::from_f64(c * unit).unwrap_or_default()));
    let [u, v, w] = [1, 2, 3].map(|i| [0, 1, 2].map(|k| &integers[i][k] - &integers[0][k]));
    let dot = |a: &[BigInt; 3], b: &[BigInt; 3]| -> BigInt {
        &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
    };
    let cross = |a: &[BigInt; 3], b: &[BigInt; 3]| {
        [(1, 2), (2, 0), (0, 1)].map(|(i, j)| &a[i] * &b[j] - &a[j] * &b[i])
    };
    let (uu, vv, ww) = (dot(&u, &u), dot(&v, &v), dot(&w, &w));
    let [vw, wu, uv] = [cross(&v, &w), cross(&w, &u), cross(&u, &v)];
    let double = |a: &BigInt| a.to_f64().unwrap_or(f64::NAN);
    // The division is done in two steps, since numerator and denominator may each be too large for
    // a double.
    let det: BigInt = dot(&u, &vw) * 2;
    std::array::from_fn(|k| {
        let numerator: BigInt = &uu * &vw[k] + &vv * &wu[k] + &ww * &uv[k];
        let quotient: BigInt = &numerator / &det;
        let remainder: BigInt = &numerator - &quotient * &det;
        let shift = det.bits().saturating_sub(900);
        (double(&quotient) + double(&(remainder >> shift)) / double(&(&det >> shift))) / unit
    })
}

/// An unevaluated sum of two doubles, the second below the rounding error of the first: about 32
/// digits.
#[derive(Debug, Clone, Copy)]
struct DoubleDouble(f64, f64);

impl DoubleDouble {
    /// Returns `a + b` exactly.
    fn sum(a: f64, b: f64) -> Self {
        let s = a + b;
        let t = s - a;
        Self(s, (a - (s - t)) + (b - t))
    }

    /// Returns `a - b` exactly.
    fn difference(a: f64, b: f64) -> Self {
        Self::sum(a, -b)
    }

    /// Returns the quotient, rounded to a double.
    fn divide(self, divisor: Self) -> f64 {
        let first = self.0 / divisor.0;
        let remainder = self - divisor * Self(first, 0.0);
        first + remainder.0 / divisor.0
    }
}

impl std::ops::Add for DoubleDouble {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let high = Self::sum(self.0, other.0);
        let low = Self::sum(self.1, other.1);
        let sum = Self::sum(high.0, high.1 + low.0);
        Self::sum(sum.0, sum.1 + low.1)
    }
}

impl std::ops::Sub for DoubleDouble {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + Self(-other.0, -other.1)
    }
}

impl std::ops::Mul for DoubleDouble {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.0 * other.0;
        let error = self.0.mul_add(other.0, -product);
        Self::sum(product, error + (self.0 * other.1 + self.1 * other.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a sphere about the origin with exact coordinates: permutations and signs of (1, 4,
    /// 8) and (4, 4, 7), all of length 9.
    const ON_SPHERE: [[f64; 3]; 6] = [
        [1.0, 4.0, 8.0],
        [-4.0, 4.0, 7.0],
        [8.0, -1.0, 4.0],
        [-4.0, -8.0, 1.0],
        [7.0, 4.0, -4.0],
        [4.0, 1.0, -8.0],
    ];

    #[test]
    fn nearly_coplanar_corners_have_an_exact_centre() {
        // Three corners of a square of side 2, and a fourth corner that differs from the square's
        // in the last digit. The determinant is 4 h for a height h, and the centre is at (1, 1, ((b
        // - 1)^2 + (c - 1)^2 + h^2 - 2) / 2 h), so a tiny height has a large effect.
        let epsilon = f64::EPSILON;
        for (relative_offset, height) in [(1.0, 2.0), (1.0, -3.0), (-2.0, 1.0), (0.0, 5.0)] {
            let (b, h) = (
                2.0 + 2.0 * relative_offset * epsilon,
                height * epsilon * epsilon,
            );
            let p = [
                [0.0, 0.0, 0.0],
                [2.0, 0.0, 0.0],
                [0.0, 2.0, 0.0],
                [b, 2.0, h],
            ];
            let z = (2.0 * relative_offset * epsilon * b + h * h) / (2.0 * h);
            let got = tetrahedron_circumcentre(p);
            assert!(
                (got[0] - 1.0).abs() < 1e-15 && (got[1] - 1.0).abs() < 1e-15,
                "{got:?}"
            );
            assert!(
                (got[2] - z).abs() <= 1e-15 * z.abs().max(1.0),
                "{got:?}, not {z}"
            );
        }
    }

    #[test]
    fn spheres_through_exact_points_are_found() {
        let c = [1000.0, -3.5, 0.25];
        for skip in 0..3 {
            let p = [0, 1, 2, 3]
                .map(|i| ON_SPHERE[i + usize::from(i >= skip) * 2])
                .map(|x| std::array::from_fn(|k| c[k] + 0.125 * x[k]));
            let centre = tetrahedron_circumcentre(p);
            for k in 0..3 {
                assert!((centre[k] - c[k]).abs() < 1e-13, "{centre:?}");
            }
        }
    }

    #[test]
    fn flat_tetrahedra_are_as_exact_as_others() {
        // Four points of a circle in z = 0, one of them lifted by h: the centre lies on the axis at
        // (x^2 + y^2 + h^2 - 25) / (2 h), here h / 2.
        for h in [1e-2, 1e-5, 1e-9, 1e-13] {
            let p = [
                [5.0, 0.0, 0.0],
                [-3.0, 4.0, 0.0],
                [0.0, -5.0, 0.0],
                [3.0, 4.0, h],
            ];
            let [x, y, z] = tetrahedron_circumcentre(p);
            assert!(x.abs() < 1e-14 && y.abs() < 1e-14, "{x} {y}");
            assert!((z - 0.5 * h).abs() < 1e-15, "{z}");
        }
        // A large sphere: its centre is far away from four points that lie nearly in one plane.
        let h = 1e-9;
        let p = [
            [1.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.5, h],
        ];
        let [.., z] = tetrahedron_circumcentre(p);
        let expected = (0.25 + h * h - 1.0) / (2.0 * h);
        assert!((z / expected - 1.0).abs() < 1e-14, "{z} {expected}");
    }

    #[test]
    fn flat_triangles_are_as_exact_as_others() {
        for h in [1.0, 1e-4, 1e-8, 1e-12] {
            let [x, y] = triangle_circumcentre([[0.0, 0.0], [1.0, h], [2.0, 0.0]]);
            let expected = (h * h - 1.0) / (2.0 * h);
            assert!((x - 1.0).abs() < 1e-15);
            assert!(
                (y - expected).abs() <= 1e-15 * expected.abs(),
                "{y} {expected}"
            );
        }
    }
}
