//! Tree of bounding boxes, for searches of the items nearest to a point or at a point.

use std::borrow::Cow;

/// Maximum number of items in a leaf.
const LEAF_SIZE: usize = 4;
/// Rounding can make an item seem closer than its box. So boxes that are farther by this factor are
/// examined, too.
const ROUNDING_SLACK: f64 = 1.0 + 1e-9;

#[derive(Debug, Clone, PartialEq)]
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
#[derive(Debug, Clone, PartialEq)]
pub struct BoxTree<'a, const D: usize> {
    nodes: Vec<TreeNode<D>>,
    order: Vec<u32>,
    boxes: Cow<'a, [[[f64; D]; 2]]>,
    sets: Cow<'a, [u8]>,
}

impl<'a, const D: usize> BoxTree<'a, D> {
    /// Builds a tree over items with the given boxes (low and high corner) and sets, split at the
    /// median of the longest axis.
    pub fn new(boxes: impl Into<Cow<'a, [[[f64; D]; 2]]>>, sets: impl Into<Cow<'a, [u8]>>) -> Self {
        let (boxes, sets) = (boxes.into(), sets.into());
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len());
        if !boxes.is_empty() {
            build(&boxes, &sets, &mut order, 0, &mut nodes);
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
    pub fn nearest(
        &self,
        p: [f64; D],
        queried_sets: u8,
        limit: f64,
        hint: Option<usize>,
        square: impl Fn(usize) -> f64,
    ) -> Option<(usize, f64)> {
        let (boxes, sets) = (&*self.boxes, &*self.sets);
        let is_queried = |item: usize| sets[item] & queried_sets != 0;
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
                    let [low, high] = &boxes[item];
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

    /// Visits the items whose boxes contain a point.
    pub fn visit_at(&self, p: [f64; D], mut visit: impl FnMut(usize)) {
        let contains =
            |low: &[f64; D], high: &[f64; D]| (0..D).all(|k| low[k] <= p[k] && p[k] <= high[k]);
        let mut stack = Vec::from_iter((!self.nodes.is_empty()).then_some(0));
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if !contains(&node.low, &node.high) {
                continue;
            }
            if node.end - node.start > LEAF_SIZE as u32 {
                stack.extend([index + 1, node.second_child]);
                continue;
            }
            for &item in &self.order[node.start as usize..node.end as usize] {
                let [low, high] = &self.boxes[item as usize];
                if contains(low, high) {
                    visit(item as usize);
                }
            }
        }
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
    use crate::geometry::random::Random;
    use crate::geometry::{distance2, dot, sub};

    #[test]
    fn tree_and_scan_find_the_same_items() {
        let mut random = Random::new(2);
        let points: Vec<[f64; 3]> = (0..500)
            .map(|_| std::array::from_fn(|_| random.draw()))
            .collect();
        let boxes: Vec<[[f64; 3]; 2]> = points.iter().map(|&p| [p, p]).collect();
        // The sets contain every item, every third item, and the last item.
        let last = points.len() - 1;
        let sets: Vec<u8> = (0..=last)
            .map(|i| 1 | u8::from(i % 3 == 0) << 1 | u8::from(i == last) << 2)
            .collect();
        let tree = BoxTree::new(&boxes, &sets);
        let wide_boxes = points
            .iter()
            .map(|p| [-0.125, 0.125].map(|r| p.map(|c| c + r)));
        let wide_tree = BoxTree::new(wide_boxes.collect::<Vec<_>>(), &sets);
        for _ in 0..200 {
            let p: [f64; 3] = std::array::from_fn(|_| 2.0 * random.draw() - 0.5);
            let square = |i: usize| dot(sub(p, points[i]), sub(p, points[i]));
            for queried_sets in [1, 2, 4, 6, 7] {
                let set_items = (0..points.len()).filter(|&i| sets[i] & queried_sets != 0);
                let scanned = set_items.map(square).fold(f64::INFINITY, f64::min);
                let nearest = |limit, hint| tree.nearest(p, queried_sets, limit, hint, square);
                assert_eq!(nearest(f64::INFINITY, None).unwrap().1, scanned);
                assert_eq!(nearest(f64::INFINITY, Some(7)).unwrap().1, scanned);
                assert!(nearest(scanned, Some(7)).is_none());
            }
            let p = p.map(|c| 0.5 * c + 0.25);
            let is_at = |i: &usize| (0..3).all(|k| (points[*i][k] - p[k]).abs() <= 0.125);
            let mut visited = Vec::new();
            wide_tree.visit_at(p, |i| visited.push(i));
            visited.sort_unstable();
            assert!(visited.into_iter().eq((0..points.len()).filter(is_at)));
        }
        let empty_tree = BoxTree::<3>::new(&[][..], &[][..]);
        assert!(
            empty_tree
                .nearest([0.0; 3], 1, f64::INFINITY, None, |_| 0.0)
                .is_none()
        );
    }

    #[test]
    fn sets_without_items_cost_no_search() {
        let boxes: Vec<[[f64; 3]; 2]> = (0..4096)
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
            tree.nearest([60.2, 60.1, 5.0], queried_sets, f64::INFINITY, None, square);
            assert_eq!(visits.get(), max_visits);
        }
    }
}
