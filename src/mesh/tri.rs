//! Triangles in the plane: topology, adjacency and shape. Meshes of 2-D images consist of them.
//!
//! ```text
//!        2             (x1 - x0) x (x2 - x0) > 0: nodes 0, 1, 2 turn anticlockwise
//!       / \            where y points up (clockwise on a picture whose rows go down).
//!      /   \           Edge k is the edge opposite node k; neighbour k is the
//!     0-----1          triangle on the other side of edge k.
//! ```

use super::complex::NONE;
use crate::geometry::counting_sort::sort_by_group;

/// A triangle mesh in one space: lattice or physical, as the code that owns the mesh documents.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriMesh {
    /// Node positions.
    pub nodes: Vec<[f64; 2]>,
    /// Node indices of each triangle, positively oriented (see the module's figure).
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// Returns the three corner positions of triangle `t`.
    pub fn corners(&self, t: usize) -> [[f64; 2]; 3] {
        self.triangles[t].map(|i| self.nodes[i as usize])
    }
}

/// Nodes of edge k (opposite node k), in the triangle's sense of rotation.
pub const SIDES: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];

/// Returns twice the signed area of a triangle; positive for the module's orientation.
#[inline]
pub fn double_area(p: &[[f64; 2]; 3]) -> f64 {
    (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])
}

/// Returns the squared lengths of the three edges.
#[inline]
pub fn squared_sides(p: &[[f64; 2]; 3]) -> [f64; 3] {
    SIDES.map(|[i, j]| (p[j][0] - p[i][0]).powi(2) + (p[j][1] - p[i][1]).powi(2))
}

/// Returns the three angles in degrees, at nodes 0, 1 and 2.
pub fn angles(p: &[[f64; 2]; 3]) -> [f64; 3] {
    let area2 = double_area(p).abs();
    let [a, b, c] = squared_sides(p);
    // The scalar product of the two edges that meet at a node, from the squared length `opposite`
    // of the side opposite to it.
    let angle_at = |opposite: f64, s: f64, t: f64| {
        let product = 0.5 * (s + t - opposite);
        area2.atan2(product).to_degrees()
    };
    [angle_at(a, b, c), angle_at(b, c, a), angle_at(c, a, b)]
}

/// Returns the largest cotangent of the three angles, which is that of the smallest angle; infinite
/// for a flat or inverted triangle. It needs no trigonometry: all angles are at least `a` (and at
/// most 180 degrees - 2 a) exactly if the result is at most cot(a).
#[inline]
pub fn worst_cotangent(p: &[[f64; 2]; 3]) -> f64 {
    let area2 = double_area(p);
    if area2 <= 0.0 {
        return f64::INFINITY;
    }
    let [a, b, c] = squared_sides(p);
    // The smallest angle is opposite the shortest side.
    0.5 * (a + b + c - 2.0 * a.min(b).min(c)) / area2
}

/// Returns Q = 4 sqrt(3) A / (l1^2 + l2^2 + l3^2): 1 for the equilateral triangle, 0 for a flat or
/// inverted one (Fernandes & Gattass 2009).
pub fn shape_quality(p: &[[f64; 2]; 3]) -> f64 {
    let sum: f64 = squared_sides(p).iter().sum();
    if sum > 0.0 {
        (2.0 * 3f64.sqrt() * double_area(p) / sum).max(0.0)
    } else {
        0.0
    }
}

/// Returns the radius of the circumscribed circle over the length of the shortest edge: 0.577 for
/// the equilateral triangle.
pub fn radius_edge_ratio(p: &[[f64; 2]; 3]) -> f64 {
    let [a, b, c] = squared_sides(p).map(f64::sqrt);
    0.5 * a * b * c / double_area(p).abs() / a.min(b).min(c)
}

/// Returns the neighbours of every triangle, found by matching edges, in time linear in the number
/// of triangles.
///
/// # Errors
/// Returns the first edge (nodes ascending) that more than two triangles share, or that two
/// triangles have in the same direction, so that they overlap.
pub fn neighbours(node_count: usize, triangles: &[[u32; 3]]) -> Result<Vec<[u32; 3]>, [u32; 2]> {
    let side_of = |code: u32| SIDES[code as usize % 3].map(|i| triangles[code as usize / 3][i]);
    // A counting sort by the smaller node leaves only a few edges in each group.
    let smaller_nodes = (0..3 * triangles.len() as u32).map(|code| {
        let [a, b] = side_of(code);
        a.min(b) as usize
    });
    let (start, bucket) = sort_by_group(node_count, smaller_nodes);
    let mut result = vec![[NONE; 3]; triangles.len()];
    let mut edges: Vec<(u32, u32, bool)> = Vec::new();
    for i in 0..node_count {
        edges.clear();
        edges.extend(
            bucket[start[i] as usize..start[i + 1] as usize]
                .iter()
                .map(|&code| {
                    let [a, b] = side_of(code);
                    (a.max(b), code, a < b)
                }),
        );
        edges.sort_unstable();
        let mut j = 0;
        while j < edges.len() {
            let other_node = edges[j].0;
            let count = edges[j..].iter().take_while(|e| e.0 == other_node).count();
            if count > 2 || count == 2 && edges[j].2 == edges[j + 1].2 {
                return Err([i as u32, other_node]);
            }
            if count == 2 {
                let (p, q) = (edges[j].1, edges[j + 1].1);
                result[(p / 3) as usize][(p % 3) as usize] = q / 3;
                result[(q / 3) as usize][(q % 3) as usize] = p / 3;
            }
            j += count;
        }
    }
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_equilateral_triangle() {
        let p = [[0.0, 0.0], [2.0, 0.0], [1.0, 3f64.sqrt()]];
        assert!((double_area(&p) - 2.0 * 3f64.sqrt()).abs() < 1e-15);
        assert!(angles(&p).iter().all(|a| (a - 60.0).abs() < 1e-12));
        assert!((shape_quality(&p) - 1.0).abs() < 1e-15);
        assert!((radius_edge_ratio(&p) - 1.0 / 3f64.sqrt()).abs() < 1e-15);
        assert!((worst_cotangent(&p) - 1.0 / 3f64.sqrt()).abs() < 1e-15);
        let inverted = [p[0], p[2], p[1]];
        assert_eq!(shape_quality(&inverted), 0.0);
        assert_eq!(worst_cotangent(&inverted), f64::INFINITY);
    }

    #[test]
    fn half_a_square() {
        let p = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        for (got, expected) in angles(&p).iter().zip([90.0, 45.0, 45.0]) {
            assert!((got - expected).abs() < 1e-12);
        }
        assert!((shape_quality(&p) - 3f64.sqrt() / 2.0).abs() < 1e-15);
        assert_eq!(shape_quality(&[[0.0; 2]; 3]), 0.0);
    }

    #[test]
    fn neighbours_are_across_the_edge_opposite_the_node() {
        let square = [[0, 1, 2], [2, 1, 3]];
        let adjacent = neighbours(4, &square).unwrap();
        assert_eq!(adjacent, [[1, NONE, NONE], [NONE, NONE, 0]]);
        // A third triangle on the shared edge, then two triangles that overlap.
        assert_eq!(
            neighbours(5, &[[0, 1, 2], [2, 1, 3], [1, 2, 4]]),
            Err([1, 2])
        );
        assert_eq!(neighbours(4, &[[0, 1, 2], [1, 2, 3]]), Err([1, 2]));
        assert_eq!(neighbours(0, &[]), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn angles_sum_to_a_half_turn(c in proptest::array::uniform6(-1.0f64..1.0)) {
            let mut p = [[c[0], c[1]], [c[2], c[3]], [c[4], c[5]]];
            if double_area(&p) < 0.0 {
                p.swap(1, 2);
            }
            prop_assume!(double_area(&p) > 1e-3);
            let angles = angles(&p);
            prop_assert!((angles.iter().sum::<f64>() - 180.0).abs() < 1e-9);
            let smallest = angles.iter().copied().fold(180.0, f64::min).to_radians();
            prop_assert!((worst_cotangent(&p) * smallest.tan() - 1.0).abs() < 1e-6);
            prop_assert!(shape_quality(&p) <= 1.0 + 1e-12);
        }
    }
}
