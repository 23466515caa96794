//! Nearest-neighbour searches: points in the cells of a grid, a tree of bounding boxes, and the
//! distance from a point to a triangle or a segment.

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{dot, sub, to_3d};

type Point3 = [f64; 3];

/// Returns the squared distance from a point to a triangle. It is exact in all seven regions of the
/// plane (the inside, three edges, three corners), and for degenerate triangles. Source: Ericson,
/// Real-Time Collision Detection, 5.1.5.
#[inline]
pub(super) fn squared_distance_to_triangle(p: Point3, [a, b, c]: [Point3; 3]) -> f64 {
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
pub(crate) fn squared_distance_to_face<const D: usize>(p: [f64; D], face: &[[f64; D]; D]) -> f64 {
    squared_distance_to_triangle(to_3d(p), [face[0], face[1], face[D - 1]].map(to_3d))
}

/// Points in the cells of a grid, for searches in which most nearest points are within a cell or
/// two.
pub(super) struct PointGrid<const D: usize> {
    /// Points in the order of their cells.
    sorted: Vec<[f32; D]>,
    /// Index of the first point of each cell, x fastest, and the number of points at the end.
    start: Vec<u32>,
    dims: [usize; D],
    /// Side of a cell.
    side: f64,
}

/// Minimum side of a cell, and maximum number of cells. The side is doubled until there are no more
/// cells than that.
const MIN_CELL_SIDE: f64 = 2.0;
const MAX_CELLS: usize = 1 << 24;

impl<const D: usize> PointGrid<D> {
    /// Sorts points in or near the box `[0, extent]` into cells. Also returns the original number
    /// of each sorted point.
    pub(super) fn new(points: &[[f32; D]], extent: [f64; D]) -> (Self, Vec<u32>) {
        let mut side = MIN_CELL_SIDE;
        let dims = loop {
            let dims = extent.map(|e| (e / side) as usize + 1);
            if dims.iter().product::<usize>() <= MAX_CELLS {
                break dims;
            }
            side *= 2.0;
        };
        let cell = |p: &[f32; D]| {
            let coordinate = |k: usize| ((f64::from(p[k]) / side) as usize).min(dims[k] - 1);
            (0..D)
                .rev()
                .fold(0, |cell, k| cell * dims[k] + coordinate(k))
        };
        let (start, order) = sort_by_group(dims.iter().product(), points.iter().map(cell));
        let sorted = order.iter().map(|&i| points[i as usize]).collect();
        (
            Self {
                sorted,
                start,
                dims,
                side,
            },
            order,
        )
    }

    #[inline]
    fn cell_coordinate(&self, k: usize, x: f64) -> usize {
        ((x / self.side) as usize).min(self.dims[k] - 1)
    }

    /// Returns the position of sorted point `i`.
    pub(super) fn position(&self, i: usize) -> [f32; D] {
        self.sorted[i]
    }

    #[inline]
    fn squared_distance(&self, p: [f64; D], i: usize) -> f64 {
        let q = &self.sorted[i];
        let mut sum = 0.0;
        for k in 0..D {
            let gap = p[k] - f64::from(q[k]);
            sum += gap * gap;
        }
        sum
    }

    /// Returns the sorted index of the nearest point (the first of several at the same distance),
    /// and its squared distance. Returns `None` if no point is closer than `limit`. `hint` may be
    /// the index of a point that is probably near; it saves time.
    pub(super) fn nearest(
        &self,
        p: [f64; D],
        limit: f64,
        hint: Option<usize>,
    ) -> Option<(usize, f64)> {
        // Upper bound of the squared distance of the nearest point.
        let mut upper_bound = hint.map_or(f64::INFINITY, |i| self.squared_distance(p, i));
        let known_distance = upper_bound.sqrt() * (1.0 + 1e-9);
        // All points within the radius are examined. The radius grows until the nearest point is
        // inside.
        let mut radius = known_distance.min(self.side).min(limit);
        loop {
            let best = self.nearest_within(p, radius, limit, upper_bound);
            upper_bound = best.map_or(upper_bound, |(_, square)| square.min(upper_bound));
            if upper_bound <= radius * radius || radius >= limit {
                return best;
            }
            radius = (2.0 * radius).max(1e-3).min(limit);
        }
    }

    /// Returns a lower bound of the squared distance, along axis `k`, between `x` and the points in
    /// the cells with the given index. The outermost cells contain also all points outside the box.
    #[inline]
    fn squared_distance_to_slab(&self, k: usize, index: usize, x: f64) -> f64 {
        let mut gap = 0f64;
        if index > 0 {
            gap = gap.max(self.side * index as f64 - x);
        }
        if index + 1 < self.dims[k] {
            gap = gap.max(x - self.side * (index + 1) as f64);
        }
        gap * gap
    }

    /// Visits the rows of cells that touch a box: the coordinates of the first cell of the row, and
    /// the range of its points.
    #[inline]
    fn visit_rows(
        &self,
        low: [f64; D],
        high: [f64; D],
        mut visit: impl FnMut([usize; D], std::ops::Range<usize>),
    ) {
        let (mut first, mut last) = ([0; D], [0; D]);
        for k in 0..D {
            first[k] = self.cell_coordinate(k, low[k]);
            last[k] = self.cell_coordinate(k, high[k]);
        }
        let mut coordinates = first;
        loop {
            let mut cell = 0;
            for k in (1..D).rev() {
                cell = (cell + coordinates[k]) * self.dims[k - 1];
            }
            let [begin, end] = [self.start[cell + first[0]], self.start[cell + last[0] + 1]];
            visit(coordinates, begin as usize..end as usize);
            // Proceeds to the next row. The last axis is slowest.
            let mut k = 1;
            while k < D && coordinates[k] == last[k] {
                coordinates[k] = first[k];
                k += 1;
            }
            if k >= D {
                return;
            }
            coordinates[k] += 1;
        }
    }

    /// Visits the sorted indices of the points in a box.
    pub(super) fn visit_box(&self, low: [f64; D], high: [f64; D], mut visit: impl FnMut(usize)) {
        self.visit_rows(low, high, |_, points| {
            for i in points {
                let q = &self.sorted[i];
                let mut is_inside = true;
                for k in 0..D {
                    let x = f64::from(q[k]);
                    is_inside &= low[k] <= x && x <= high[k];
                }
                if is_inside {
                    visit(i);
                }
            }
        });
    }

    /// Returns the nearest of the points in the cells within `radius` of `p`, if it is closer than
    /// `limit`. `upper_bound` is an upper bound of the squared distance of the nearest point.
    fn nearest_within(
        &self,
        p: [f64; D],
        radius: f64,
        limit: f64,
        upper_bound: f64,
    ) -> Option<(usize, f64)> {
        let (mut nearest, mut min_square) = (usize::MAX, limit * limit);
        // The upper bound excludes distant rows. Rounding must not exclude points at the same
        // distance, of which the first is returned.
        let mut upper_bound = upper_bound.min(min_square);
        self.visit_rows(p, p, |_, points| {
            upper_bound = points.fold(upper_bound, |bound, i| {
                bound.min(self.squared_distance(p, i))
            });
        });
        upper_bound *= 1.0 + 1e-9;
        let (mut low, mut high) = (p, p);
        let search_radius = radius.min(upper_bound.sqrt());
        for k in 0..D {
            low[k] -= search_radius;
            high[k] += search_radius;
        }
        self.visit_rows(low, high, |coordinates, points| {
            let mut row_square = 0.0;
            for k in 1..D {
                row_square += self.squared_distance_to_slab(k, coordinates[k], p[k]);
            }
            if row_square > upper_bound {
                return;
            }
            for i in points {
                let square = self.squared_distance(p, i);
                if square < min_square {
                    (nearest, min_square) = (i, square);
                }
            }
        });
        (nearest != usize::MAX).then_some((nearest, min_square))
    }
}

/// Maximum number of items in a leaf.
const LEAF_SIZE: usize = 4;
/// Rounding can make an item seem closer than its box. So boxes that are farther by this factor are
/// examined, too.
const ROUNDING_SLACK: f64 = 1.0 + 1e-9;

struct TreeNode<const D: usize> {
    low: [f64; D],
    high: [f64; D],
    /// Range `start..end` of the item order. The node is a leaf if it has at most [`LEAF_SIZE`]
    /// items.
    start: u32,
    end: u32,
    /// Index of the second child. The first child follows its parent.
    second_child: u32,
    /// Union of the sets of its items, as bits.
    sets: u8,
}

impl<const D: usize> TreeNode<D> {
    #[inline]
    fn squared_distance(&self, p: [f64; D]) -> f64 {
        squared_distance_to_box(p, &self.low, &self.high)
    }
}

/// Returns the squared distance from a point to a box.
#[inline]
fn squared_distance_to_box<const D: usize>(p: [f64; D], low: &[f64; D], high: &[f64; D]) -> f64 {
    let mut sum = 0.0;
    for k in 0..D {
        let gap = (low[k] - p[k]).max(p[k] - high[k]).max(0.0);
        sum += gap * gap;
    }
    sum
}

/// Tree of bounding boxes over items, which are identified by their index. The bits of an item are
/// the sets to which it belongs.
pub(super) struct BoxTree<'a, const D: usize> {
    nodes: Vec<TreeNode<D>>,
    order: Vec<u32>,
    boxes: &'a [[[f64; D]; 2]],
    sets: &'a [u8],
}

impl<'a, const D: usize> BoxTree<'a, D> {
    /// Builds a tree over items with the given boxes (low and high corner) and sets, split at the
    /// median of the longest axis.
    pub(super) fn new(boxes: &'a [[[f64; D]; 2]], sets: &'a [u8]) -> Self {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len());
        if !boxes.is_empty() {
            build(boxes, sets, &mut order, 0, &mut nodes);
        }
        Self {
            nodes,
            order,
            boxes,
            sets,
        }
    }

    /// Returns the nearest item of the queried sets and its squared distance, or `None` if no item
    /// is closer than `limit` (a squared distance). `square(item)` returns the exact squared
    /// distance from `p` to an item. Branches without queried items are skipped, so for sets with
    /// few items the search is as fast as in a tree of their own. `hint` may be an item that is
    /// probably near; it saves time. Of several items at the same distance it may change which one
    /// is returned, but not the distance.
    pub(super) fn nearest(
        &self,
        p: [f64; D],
        queried_sets: u8,
        limit: f64,
        hint: Option<usize>,
        square: impl Fn(usize) -> f64,
    ) -> Option<(usize, f64)> {
        let is_queried = |item: usize| self.sets[item] & queried_sets != 0;
        let mut best = hint
            .filter(|&item| is_queried(item))
            .map(|item| (item, square(item)))
            .filter(|(_, d)| *d < limit);
        let mut min_square = best.map_or(limit, |(_, d)| d);
        let mut stack = [(0u32, 0f64); 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (index, bound) = stack[depth];
            if bound >= min_square * ROUNDING_SLACK {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.sets & queried_sets == 0 {
                continue;
            }
            let items = &self.order[node.start as usize..node.end as usize];
            if items.len() <= LEAF_SIZE {
                for &item in items {
                    let item = item as usize;
                    let [low, high] = &self.boxes[item];
                    if !is_queried(item)
                        || squared_distance_to_box(p, low, high) >= min_square * ROUNDING_SLACK
                    {
                        continue;
                    }
                    let d = square(item);
                    if d < min_square {
                        (best, min_square) = (Some((item, d)), d);
                    }
                }
            } else {
                let first = (
                    index + 1,
                    self.nodes[index as usize + 1].squared_distance(p),
                );
                let second = (
                    node.second_child,
                    self.nodes[node.second_child as usize].squared_distance(p),
                );
                // The nearer child is on top of the stack.
                let (farther, nearer) = if first.1 <= second.1 {
                    (second, first)
                } else {
                    (first, second)
                };
                stack[depth] = farther;
                stack[depth + 1] = nearer;
                depth += 2;
            }
        }
        best
    }
}

/// Appends the tree nodes for the items in `order`, the first of which has the index `start` in the
/// whole order.
fn build<const D: usize>(
    boxes: &[[[f64; D]; 2]],
    sets: &[u8],
    order: &mut [u32],
    start: usize,
    nodes: &mut Vec<TreeNode<D>>,
) {
    let (mut low, mut high) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
    let mut all_sets = 0;
    for &item in order.iter() {
        all_sets |= sets[item as usize];
        let [l, h] = boxes[item as usize];
        for k in 0..D {
            low[k] = low[k].min(l[k]);
            high[k] = high[k].max(h[k]);
        }
    }
    let index = nodes.len();
    let end = (start + order.len()) as u32;
    nodes.push(TreeNode {
        low,
        high,
        start: start as u32,
        end,
        second_child: 0,
        sets: all_sets,
    });
    if order.len() <= LEAF_SIZE {
        return;
    }
    let size = |k: usize| high[k] - low[k];
    let axis = (0..D).fold(0, |best, k| if size(k) > size(best) { k } else { best });
    let middle = |item: u32| boxes[item as usize][0][axis] + boxes[item as usize][1][axis];
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |&a, &b| {
        middle(a).total_cmp(&middle(b)).then(a.cmp(&b))
    });
    let (left, right) = order.split_at_mut(half);
    build(boxes, sets, left, start, nodes);
    nodes[index].second_child = nodes.len() as u32;
    build(boxes, sets, right, start + half, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance2;

    const UNLIMITED: f64 = f64::INFINITY;

    fn random(state: &mut u64) -> f64 {
        *state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (*state >> 33) as f64 / (1u64 << 31) as f64
    }

    #[test]
    fn distance_to_a_triangle_is_the_least_over_its_points() {
        let mut seed = 1;
        for _ in 0..300 {
            let mut point = || -> Point3 { std::array::from_fn(|_| random(&mut seed)) };
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

    #[test]
    fn grid_and_scan_find_the_same_points() {
        let mut seed = 3;
        let extent = [20.0, 9.0, 14.0];
        let points: Vec<[f32; 3]> = (0..400)
            .map(|_| extent.map(|e| (0.2 * e + 0.7 * e * random(&mut seed)) as f32))
            .collect();
        let (grid, order) = PointGrid::new(&points, extent);
        for _ in 0..500 {
            let p: Point3 = extent.map(|e| e * (1.4 * random(&mut seed) - 0.2));
            let square = |i: usize| {
                let gap = sub(p, points[i].map(f64::from));
                dot(gap, gap)
            };
            let scanned = (0..points.len()).map(square).fold(UNLIMITED, f64::min);
            for hint in [None, Some(7)] {
                let (i, actual) = grid.nearest(p, 50.0, hint).unwrap();
                assert!((actual - scanned).abs() < 1e-12);
                assert!((square(order[i] as usize) - scanned).abs() < 1e-12);
                assert_eq!(grid.position(i), points[order[i] as usize]);
                assert!(grid.nearest(p, 0.999 * scanned.sqrt(), hint).is_none());
                assert!(grid.nearest(p, 1.001 * scanned.sqrt(), hint).is_some());
            }
        }
        for _ in 0..100 {
            let low: Point3 = extent.map(|e| e * (1.4 * random(&mut seed) - 0.4));
            let high = low.map(|c| c + 6.0 * random(&mut seed));
            let mut indices = Vec::new();
            grid.visit_box(low, high, |i| indices.push(order[i]));
            indices.sort_unstable();
            let inside = |q: &[f32; 3]| (0..3).all(|k| (low[k]..=high[k]).contains(&q[k].into()));
            let scanned = (0..).zip(&points).filter(|(_, q)| inside(q));
            assert!(indices.into_iter().eq(scanned.map(|(i, _)| i)));
        }
        let (empty_grid, _) = PointGrid::new(&[], extent);
        assert!(empty_grid.nearest([1.0; 3], 9.0, None).is_none());
    }

    #[test]
    fn tree_and_scan_find_the_same_items() {
        let mut seed = 2;
        let points: Vec<Point3> = (0..500)
            .map(|_| std::array::from_fn(|_| random(&mut seed)))
            .collect();
        let boxes: Vec<[Point3; 2]> = points.iter().map(|&p| [p, p]).collect();
        // The sets contain every item, every third item, and the last item.
        let last = points.len() - 1;
        let sets: Vec<u8> = (0..=last)
            .map(|i| 1 | u8::from(i % 3 == 0) << 1 | u8::from(i == last) << 2)
            .collect();
        let tree = BoxTree::new(&boxes, &sets);
        for _ in 0..200 {
            let p: Point3 = std::array::from_fn(|_| 2.0 * random(&mut seed) - 0.5);
            let square = |i: usize| dot(sub(p, points[i]), sub(p, points[i]));
            for queried_sets in [1, 2, 4, 6, 7] {
                let set_items = (0..points.len()).filter(|&i| sets[i] & queried_sets != 0);
                let scanned = set_items.map(square).fold(f64::INFINITY, f64::min);
                let nearest = |limit, hint| tree.nearest(p, queried_sets, limit, hint, square);
                assert_eq!(nearest(UNLIMITED, None).unwrap().1, scanned);
                assert_eq!(nearest(UNLIMITED, Some(7)).unwrap().1, scanned);
                assert!(nearest(scanned, Some(7)).is_none());
            }
        }
        let empty_tree = BoxTree::<3>::new(&[], &[]);
        assert!(
            empty_tree
                .nearest([0.0; 3], 1, UNLIMITED, None, |_| 0.0)
                .is_none()
        );
    }

    #[test]
    fn sets_without_items_cost_no_search() {
        let boxes: Vec<[Point3; 2]> = (0..4096)
            .map(|i| [[f64::from(i % 64), f64::from(i / 64), 0.0]; 2])
            .collect();
        let sets: Vec<u8> = (0..4096).map(|i| 1 | u8::from(i == 77) << 1).collect();
        let tree = BoxTree::new(&boxes, &sets);
        for (queried_sets, max_visits) in [(4, 0), (2, 1)] {
            let visits = std::cell::Cell::new(0);
            let square = |i: usize| {
                visits.set(visits.get() + 1);
                distance2(&boxes[i][0], &[60.2, 60.1, 5.0])
            };
            tree.nearest([60.2, 60.1, 5.0], queried_sets, UNLIMITED, None, square);
            assert_eq!(visits.get(), max_visits);
        }
    }
}
