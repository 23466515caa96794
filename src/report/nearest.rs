//! Nearest-item queries: points in cells, a tree of bounding boxes, and the distance from a point to a
//! triangle or a segment.

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{dot, sub, to_3d};

type Point3 = [f64; 3];

/// Squared distance from a point to a triangle, exact for all seven regions of its plane (the
/// inside, three edges, three corners), also for a degenerate triangle. After Ericson, Real-Time
/// Collision Detection, 5.1.5.
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

/// Squared distance from a point to a face of a mesh: a triangle in space, a segment in the plane
/// (which is a flat triangle in space).
pub(crate) fn squared_distance_to_face<const D: usize>(p: [f64; D], face: &[[f64; D]; D]) -> f64 {
    squared_distance_to_triangle(to_3d(p), [face[0], face[1], face[D - 1]].map(to_3d))
}

/// Points in the cells of a grid: for nearest points of which most are within a cell or two.
pub(super) struct PointGrid<const D: usize> {
    /// In the order of their cells.
    sorted: Vec<[f32; D]>,
    /// Where each cell's points start; x fastest, one more at the end.
    start: Vec<u32>,
    dims: [usize; D],
    /// Side of a cell.
    side: f64,
}

/// Side of a cell, or, where there would be more cells than this, twice or four times as much.
const MIN_CELL_SIDE: f64 = 2.0;
const MAX_CELLS: usize = 1 << 24;

impl<const D: usize> PointGrid<D> {
    /// Sorts points in or near the box `[0, extent]`; also gives their numbers in the new order.
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
            let along = |k: usize| ((f64::from(p[k]) / side) as usize).min(dims[k] - 1);
            (0..D).rev().fold(0, |cell, k| cell * dims[k] + along(k))
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

    /// Where point `i` of the new order is.
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

    /// The nearest point, by its number in the new order (of equally near ones the first), and its squared distance; none
    /// if all are `limit` away or farther. `hint` may be a point that is likely to be near, to save time.
    pub(super) fn nearest(
        &self,
        p: [f64; D],
        limit: f64,
        hint: Option<usize>,
    ) -> Option<(usize, f64)> {
        // Some point is as near as this.
        let mut near = hint.map_or(f64::INFINITY, |i| self.squared_distance(p, i));
        let known = near.sqrt() * (1.0 + 1e-9);
        // Every point within the radius is looked at: it grows until the nearest is among them.
        let mut radius = known.min(self.side).min(limit);
        loop {
            let best = self.nearest_within(p, radius, limit, near);
            near = best.map_or(near, |(_, square)| square.min(near));
            if near <= radius * radius || radius >= limit {
                return best;
            }
            radius = (2.0 * radius).max(1e-3).min(limit);
        }
    }

    /// The square of how far at least the points in cells of that number along an axis are away along
    /// it. The outermost cells have all points outside the box, too.
    #[inline]
    fn squared_distance_to_slab(&self, k: usize, along: usize, x: f64) -> f64 {
        let mut gap = 0f64;
        if along > 0 {
            gap = gap.max(self.side * along as f64 - x);
        }
        if along + 1 < self.dims[k] {
            gap = gap.max(x - self.side * (along + 1) as f64);
        }
        gap * gap
    }

    /// The points in each row of cells that touch a box, with the place of the row's first cell.
    #[inline]
    fn visit_rows(
        &self,
        low: [f64; D],
        high: [f64; D],
        mut row: impl FnMut([usize; D], std::ops::Range<usize>),
    ) {
        let (mut first, mut last) = ([0; D], [0; D]);
        for k in 0..D {
            first[k] = self.cell_coordinate(k, low[k]);
            last[k] = self.cell_coordinate(k, high[k]);
        }
        let mut at = first;
        loop {
            let mut cell = 0;
            for k in (1..D).rev() {
                cell = (cell + at[k]) * self.dims[k - 1];
            }
            let [from, to] = [self.start[cell + first[0]], self.start[cell + last[0] + 1]];
            row(at, from as usize..to as usize);
            // The next row, the last axis slowest.
            let mut k = 1;
            while k < D && at[k] == last[k] {
                at[k] = first[k];
                k += 1;
            }
            if k >= D {
                return;
            }
            at[k] += 1;
        }
    }

    /// The points in a box, by their numbers in the new order.
    pub(super) fn visit_box(&self, low: [f64; D], high: [f64; D], mut each: impl FnMut(usize)) {
        self.visit_rows(low, high, |_, points| {
            for i in points {
                let q = &self.sorted[i];
                let mut inside = true;
                for k in 0..D {
                    let x = f64::from(q[k]);
                    inside &= low[k] <= x && x <= high[k];
                }
                if inside {
                    each(i);
                }
            }
        });
    }

    /// The nearest of the points in the cells within `radius` of `p`, if it is less than `limit` away; the square of the
    /// distance to some point is known to be `near`.
    fn nearest_within(
        &self,
        p: [f64; D],
        radius: f64,
        limit: f64,
        near: f64,
    ) -> Option<(usize, f64)> {
        let (mut which, mut least) = (usize::MAX, limit * limit);
        // It lets far rows be passed over. Rounding must not lose equally near ones, of which the first is taken.
        let mut near = near.min(least);
        self.visit_rows(p, p, |_, points| {
            near = points.fold(near, |near, i| near.min(self.squared_distance(p, i)));
        });
        near *= 1.0 + 1e-9;
        let (mut low, mut high) = (p, p);
        let reach = radius.min(near.sqrt());
        for k in 0..D {
            low[k] -= reach;
            high[k] += reach;
        }
        self.visit_rows(low, high, |at, points| {
            let mut away = 0.0;
            for k in 1..D {
                away += self.squared_distance_to_slab(k, at[k], p[k]);
            }
            if away > near {
                return;
            }
            for i in points {
                let square = self.squared_distance(p, i);
                if square < least {
                    (which, least) = (i, square);
                }
            }
        });
        (which != usize::MAX).then_some((which, least))
    }
}

/// Items in a leaf.
const LEAF_SIZE: usize = 4;
/// What is in a box may seem nearer than the box by what is rounded away: so much farther ones are looked into.
const ROUNDING_SLACK: f64 = 1.0 + 1e-9;

struct TreeNode<const D: usize> {
    low: [f64; D],
    high: [f64; D],
    /// Items `start..end` of the order; a leaf if there are at most [`LEAF_SIZE`].
    start: u32,
    end: u32,
    /// The second child; the first follows its parent.
    second_child: u32,
    /// The sets that its items belong to, as bits.
    sets: u8,
}

impl<const D: usize> TreeNode<D> {
    #[inline]
    fn squared_distance(&self, p: [f64; D]) -> f64 {
        squared_distance_to_box(p, &self.low, &self.high)
    }
}

/// Squared distance from a point to a box.
#[inline]
fn squared_distance_to_box<const D: usize>(p: [f64; D], low: &[f64; D], high: &[f64; D]) -> f64 {
    let mut sum = 0.0;
    for k in 0..D {
        let gap = (low[k] - p[k]).max(p[k] - high[k]).max(0.0);
        sum += gap * gap;
    }
    sum
}

/// A tree of bounding boxes over items that are known by their index, each of which belongs to the
/// sets of its bits.
pub(super) struct BoxTree<'a, const D: usize> {
    nodes: Vec<TreeNode<D>>,
    order: Vec<u32>,
    boxes: &'a [[[f64; D]; 2]],
    sets: &'a [u8],
}

impl<'a, const D: usize> BoxTree<'a, D> {
    /// A tree over items with the given boxes (low and high corner) and sets, split at the median of
    /// the longest axis.
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

    /// The nearest item of the `wanted` sets and its squared distance, `square(item)` being the exact
    /// squared distance from `p` to an item; none if that is not below `limit` for any. Branches
    /// without a wanted item are not looked into: of sets with few items the search is as quick as
    /// in a tree of their own. `hint` may be an item that is likely to be near, to save time; of
    /// equally near items it may change which one is found, but not how near it is.
    pub(super) fn nearest(
        &self,
        p: [f64; D],
        wanted: u8,
        limit: f64,
        hint: Option<usize>,
        square: impl Fn(usize) -> f64,
    ) -> Option<(usize, f64)> {
        let is_wanted = |item: usize| self.sets[item] & wanted != 0;
        let mut best = hint
            .filter(|&item| is_wanted(item))
            .map(|item| (item, square(item)))
            .filter(|(_, d)| *d < limit);
        let mut least = best.map_or(limit, |(_, d)| d);
        let mut stack = [(0u32, 0f64); 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (at, bound) = stack[depth];
            if bound >= least * ROUNDING_SLACK {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.sets & wanted == 0 {
                continue;
            }
            let items = &self.order[node.start as usize..node.end as usize];
            if items.len() <= LEAF_SIZE {
                for &item in items {
                    let item = item as usize;
                    let [low, high] = &self.boxes[item];
                    if !is_wanted(item)
                        || squared_distance_to_box(p, low, high) >= least * ROUNDING_SLACK
                    {
                        continue;
                    }
                    let d = square(item);
                    if d < least {
                        (best, least) = (Some((item, d)), d);
                    }
                }
            } else {
                let first = (at + 1, self.nodes[at as usize + 1].squared_distance(p));
                let second = (
                    node.second_child,
                    self.nodes[node.second_child as usize].squared_distance(p),
                );
                // The nearer child is on top of the stack.
                let (far, near) = if first.1 <= second.1 {
                    (second, first)
                } else {
                    (first, second)
                };
                stack[depth] = far;
                stack[depth + 1] = near;
                depth += 2;
            }
        }
        best
    }
}

/// Appends the nodes over `order`, whose first item is item `start` of the whole.
fn build<const D: usize>(
    boxes: &[[[f64; D]; 2]],
    sets: &[u8],
    order: &mut [u32],
    start: usize,
    nodes: &mut Vec<TreeNode<D>>,
) {
    let (mut low, mut high) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
    let mut all = 0;
    for &item in order.iter() {
        all |= sets[item as usize];
        let [l, h] = boxes[item as usize];
        for k in 0..D {
            low[k] = low[k].min(l[k]);
            high[k] = high[k].max(h[k]);
        }
    }
    let at = nodes.len();
    let end = (start + order.len()) as u32;
    nodes.push(TreeNode {
        low,
        high,
        start: start as u32,
        end,
        second_child: 0,
        sets: all,
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
    nodes[at].second_child = nodes.len() as u32;
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
    fn cells_find_what_a_scan_finds() {
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
                let (i, found) = grid.nearest(p, 50.0, hint).unwrap();
                assert!((found - scanned).abs() < 1e-12);
                assert!((square(order[i] as usize) - scanned).abs() < 1e-12);
                assert_eq!(grid.position(i), points[order[i] as usize]);
                assert!(grid.nearest(p, 0.999 * scanned.sqrt(), hint).is_none());
                assert!(grid.nearest(p, 1.001 * scanned.sqrt(), hint).is_some());
            }
        }
        for _ in 0..100 {
            let low: Point3 = extent.map(|e| e * (1.4 * random(&mut seed) - 0.4));
            let high = low.map(|c| c + 6.0 * random(&mut seed));
            let mut found = Vec::new();
            grid.visit_box(low, high, |i| found.push(order[i]));
            found.sort_unstable();
            let inside = |q: &[f32; 3]| (0..3).all(|k| (low[k]..=high[k]).contains(&q[k].into()));
            let scanned = (0..).zip(&points).filter(|(_, q)| inside(q));
            assert!(found.into_iter().eq(scanned.map(|(i, _)| i)));
        }
        let (none, _) = PointGrid::new(&[], extent);
        assert!(none.nearest([1.0; 3], 9.0, None).is_none());
    }

    #[test]
    fn the_tree_finds_what_a_scan_finds() {
        let mut seed = 2;
        let points: Vec<Point3> = (0..500)
            .map(|_| std::array::from_fn(|_| random(&mut seed)))
            .collect();
        let boxes: Vec<[Point3; 2]> = points.iter().map(|&p| [p, p]).collect();
        // One set of every item, one of every third, one of the last.
        let last = points.len() - 1;
        let sets: Vec<u8> = (0..=last)
            .map(|i| 1 | u8::from(i % 3 == 0) << 1 | u8::from(i == last) << 2)
            .collect();
        let tree = BoxTree::new(&boxes, &sets);
        for _ in 0..200 {
            let p: Point3 = std::array::from_fn(|_| 2.0 * random(&mut seed) - 0.5);
            let square = |i: usize| dot(sub(p, points[i]), sub(p, points[i]));
            for wanted in [1, 2, 4, 6, 7] {
                let of_sets = (0..points.len()).filter(|&i| sets[i] & wanted != 0);
                let scanned = of_sets.map(square).fold(f64::INFINITY, f64::min);
                let nearest = |limit, hint| tree.nearest(p, wanted, limit, hint, square);
                assert_eq!(nearest(UNLIMITED, None).unwrap().1, scanned);
                assert_eq!(nearest(UNLIMITED, Some(7)).unwrap().1, scanned);
                assert!(nearest(scanned, Some(7)).is_none());
            }
        }
        let none = BoxTree::<3>::new(&[], &[]);
        assert!(
            none.nearest([0.0; 3], 1, UNLIMITED, None, |_| 0.0)
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
        for (wanted, most) in [(4, 0), (2, 1)] {
            let looked_at = std::cell::Cell::new(0);
            let square = |i: usize| {
                looked_at.set(looked_at.get() + 1);
                distance2(&boxes[i][0], &[60.2, 60.1, 5.0])
            };
            tree.nearest([60.2, 60.1, 5.0], wanted, UNLIMITED, None, square);
            assert_eq!(looked_at.get(), most);
        }
    }
}
