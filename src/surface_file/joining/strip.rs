//! Triangles between neighbouring sticks.

use super::line::Point;
use crate::geometry::{norm, sub};

/// Weight of a difference in height between the ends of an edge across a strip. Sticks of a fault
/// are compared at equal height: along the strike, a fault bends less than along its dip.
const HEIGHT_WEIGHT: f64 = 4.0;

/// Joins two lines that run in the same direction to a strip of triangles: of all such strips, the
/// one whose edges from line to line are shortest in total (by dynamic programming, as Fuchs, Kedem
/// and Uselton (1977) find the strip of least cost between two contours).
pub(super) fn join_lines(a: &[Point], b: &[Point]) -> Vec<[Point; 3]> {
    if a.is_empty() || b.is_empty() {
        return Vec::new();
    }
    let cost = |i: usize, j: usize| {
        let [x, y, z] = sub(a[i], b[j]);
        norm([x, y, HEIGHT_WEIGHT * z])
    };
    // Smallest total of a strip that ends with the edge from `a[i]` to `b[j]`.
    let width = b.len();
    let mut totals = vec![0.0; a.len() * width];
    for i in 0..a.len() {
        for j in 0..width {
            let before_a = if i > 0 {
                totals[(i - 1) * width + j]
            } else {
                f64::INFINITY
            };
            let before_b = if j > 0 {
                totals[i * width + j - 1]
            } else {
                f64::INFINITY
            };
            let before = if i + j == 0 {
                0.0
            } else {
                f64::min(before_a, before_b)
            };
            totals[i * width + j] = before + cost(i, j);
        }
    }
    let (mut i, mut j) = (a.len() - 1, width - 1);
    let mut triangles = Vec::with_capacity(i + j);
    while i + j > 0 {
        let is_step_of_a =
            j == 0 || (i > 0 && totals[(i - 1) * width + j] <= totals[i * width + j - 1]);
        if is_step_of_a {
            triangles.push([a[i - 1], b[j], a[i]]);
            i -= 1;
        } else {
            triangles.push([a[i], b[j - 1], b[j]]);
            j -= 1;
        }
    }
    triangles.reverse();
    triangles
}
