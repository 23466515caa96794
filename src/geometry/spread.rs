//! Points that are spread evenly over paths and over triangles.

use super::{cross, norm, sub};

/// Returns the middles of pieces of equal length of each leg of a path, about `count` in all and at least one
/// for each leg. A path of one point gives this point.
pub fn along_path<const D: usize>(points: &[[f64; D]], count: usize) -> Vec<[f64; D]> {
    if points.len() < 2 {
        return points.to_vec();
    }
    let legs = || points.windows(2).map(|leg| [leg[0], leg[1]]);
    let total: f64 = legs().map(|[a, b]| norm(sub(b, a))).sum();
    let mut spread = Vec::with_capacity(count + points.len());
    for [a, b] in legs() {
        let share = norm(sub(b, a)) / total.max(f64::MIN_POSITIVE);
        let pieces = piece_count(count as f64 * share);
        spread.extend((0..pieces).map(|i| {
            let t = (f64::from(i) + 0.5) / f64::from(pieces);
            std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
        }));
    }
    spread
}

/// Returns the centroids of similar parts of equal area of each triangle, about `count` in all and at least one
/// for each triangle.
pub fn over_triangles(triangles: &[[[f64; 3]; 3]], count: usize) -> Vec<[f64; 3]> {
    let area = |[a, b, c]: &[[f64; 3]; 3]| 0.5 * norm(cross(sub(*b, *a), sub(*c, *a)));
    let total: f64 = triangles.iter().map(area).sum();
    let mut spread = Vec::with_capacity(count + triangles.len());
    for triangle in triangles {
        let [a, b, c] = *triangle;
        let share = area(triangle) / total.max(f64::MIN_POSITIVE);
        let divisions = piece_count((count as f64 * share).sqrt());
        let mut add = |i: f64, j: f64| {
            let [s, t] = [i, j].map(|k| k / f64::from(divisions));
            let place = |k: usize| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k]);
            spread.push(std::array::from_fn(place));
        };
        for i in 0..divisions {
            for j in 0..divisions - i {
                let [x, y] = [i, j].map(f64::from);
                add(x + 1.0 / 3.0, y + 1.0 / 3.0);
                if i + j + 1 < divisions {
                    add(x + 2.0 / 3.0, y + 2.0 / 3.0);
                }
            }
        }
    }
    spread
}

/// Rounds a number of pieces up; at least 1.
fn piece_count(pieces: f64) -> u32 {
    pieces.ceil().max(1.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_paths_are_equally_long() {
        let spread = along_path(&[[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]], 8);
        assert_eq!(
            spread[..6],
            [0.25, 0.75, 1.25, 1.75, 2.25, 2.75].map(|x| [x, 0.0])
        );
        assert_eq!(spread[6..], [[3.0, 0.25], [3.0, 0.75]]);
        assert_eq!(along_path(&[[1.0, 2.0]], 8), [[1.0, 2.0]]);
        assert_eq!(along_path(&[[1.0], [1.0]], 8), [[1.0]]);
    }

    #[test]
    fn centroids_of_triangles_have_equal_shares_of_the_area() {
        let corners = [
            [0.0, 0.0, 1.0],
            [8.0, 0.0, 1.0],
            [8.0, 4.0, 1.0],
            [0.0, 4.0, 1.0],
        ];
        let triangles = [
            [corners[0], corners[1], corners[2]],
            [corners[0], corners[2], corners[3]],
        ];
        let spread = over_triangles(&triangles, 200);
        assert_eq!(spread.len(), 200);
        // An eighth of the area lies left of x = 1, and half of it below y = 2.
        let share = |is_in: &dyn Fn(&[f64; 3]) -> bool| {
            spread.iter().filter(|p| is_in(p)).count() as f64 / spread.len() as f64
        };
        assert!((share(&|p| p[0] < 1.0) - 0.125).abs() < 0.03);
        assert!((share(&|p| p[1] < 2.0) - 0.5).abs() < 0.03);
        assert!(spread.iter().all(|p| p[2] == 1.0));
    }
}
