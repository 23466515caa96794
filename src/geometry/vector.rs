//! Vectors in the plane and in space, of `f64` or, for large arrays, of `f32`.
//!
//! Sums run in the order of the axes, so results are the same wherever they are computed.

use std::borrow::Borrow;
use std::ops::{Add, Div, Mul, Sub};

/// A number type that vectors may have.
pub trait Real:
    Copy
    + Default
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// Returns the square root.
    fn sqrt(self) -> Self;
}

macro_rules! reals {
    ($($type:ty)*) => {
        $(impl Real for $type {
            #[inline]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
        })*
    };
}

reals! { f32 f64 }

/// Returns `a - b`.
#[inline]
pub fn sub<T: Real, const D: usize>(a: [T; D], b: [T; D]) -> [T; D] {
    std::array::from_fn(|k| a[k] - b[k])
}

/// Returns `a + s b`.
#[inline]
pub fn add_scaled<T: Real, const D: usize>(a: [T; D], s: T, b: [T; D]) -> [T; D] {
    std::array::from_fn(|k| a[k] + s * b[k])
}

/// Returns the scalar product.
#[inline]
pub fn dot<T: Real, const D: usize>(a: [T; D], b: [T; D]) -> T {
    let mut sum = a[0] * b[0];
    for k in 1..D {
        sum = sum + a[k] * b[k];
    }
    sum
}

/// Returns a vector of the plane or of space as a vector of space; z is 0 in the plane.
#[inline]
pub fn to_3d<T: Real, const D: usize>(a: [T; D]) -> [T; 3] {
    std::array::from_fn(|k| a.get(k).copied().unwrap_or_default())
}

/// Returns the vector product.
#[inline]
pub fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Returns the square of the distance between two points.
#[inline]
pub fn distance2<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (0..D).map(|k| (a[k] - b[k]).powi(2)).sum()
}

/// Solves a small symmetric positive definite system by elimination. Returns zero if the system is
/// singular.
pub fn solve_positive<const D: usize>(mut a: [[f64; D]; D], mut b: [f64; D]) -> [f64; D] {
    for i in 0..D {
        if a[i][i] <= 0.0 {
            return [0.0; D];
        }
        for r in i + 1..D {
            let factor = a[r][i] / a[i][i];
            b[r] -= factor * b[i];
            let pivot = a[i];
            (i..D).for_each(|c| a[r][c] -= factor * pivot[c]);
        }
    }
    for i in (0..D).rev() {
        let known_part: f64 = (i + 1..D).map(|c| a[i][c] * b[c]).sum();
        b[i] = (b[i] - known_part) / a[i][i];
    }
    b
}

/// Returns the length of a vector.
#[inline]
pub fn norm<T: Real, const D: usize>(a: [T; D]) -> T {
    dot(a, a).sqrt()
}

/// Returns the unit vector along `a`, or zero if `a` is zero.
#[inline]
pub fn unit<T: Real, const D: usize>(a: [T; D]) -> [T; D] {
    let length = norm(a);
    if length > T::default() {
        a.map(|c| c / length)
    } else {
        a
    }
}

/// Returns the normal of a facet; its length is the facet's area (3-D) or length (2-D). In 3-D the
/// nodes are anticlockwise seen from the side to which the normal points; in 2-D it points to the
/// right of the edge.
pub fn normal<const D: usize>(x: &[[f64; D]; D]) -> [f64; D] {
    let u = sub(x[1], x[0]);
    let mut n = [0.0; D];
    if D == 2 {
        n[0] = u[1];
        n[1] = -u[0];
    } else {
        let v = sub(x[2], x[0]);
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            n[k] = 0.5 * (u[i] * v[j] - u[j] * v[i]);
        }
    }
    n
}

/// Returns six times the signed volume of a tetrahedron. It is positive if the first three nodes
/// are anticlockwise seen from the last node.
#[inline]
pub fn volume6(p: &[[f64; 3]; 4]) -> f64 {
    dot(sub(p[1], p[0]), cross(sub(p[2], p[0]), sub(p[3], p[0])))
}

/// Returns the smallest and the largest coordinates of some points. Without points, the smallest
/// are infinite and the largest minus infinite.
pub fn bounding_box<const D: usize>(
    points: impl IntoIterator<Item: Borrow<[f64; D]>>,
) -> [[f64; D]; 2] {
    let empty = [[f64::INFINITY; D], [f64::NEG_INFINITY; D]];
    points.into_iter().fold(empty, |[low, high], x| {
        let x = x.borrow();
        [
            std::array::from_fn(|k| low[k].min(x[k])),
            std::array::from_fn(|k| high[k].max(x[k])),
        ]
    })
}
