//! Removes needles: faces that are as narrow as rounding errors. The edges along a needle are led
//! through the nodes that they pass, so that both long sides follow the same path and the face
//! vanishes.
//!
//! Where atoms miss a symmetric position by rounding errors, nodes that should coincide may lie
//! anywhere on the line between two other nodes (the centre of a flat simplex moves along its
//! axis). The faces there can be long but are as narrow as rounding errors.

use crate::geometry::distance2;
use std::collections::HashMap;

use super::nodes::SimplexGroups;
use super::rings::Rings;

/// Largest number of rounds, more than any atoms need. One round splits edges, and the next may
/// find nodes on the edges of the next needle.
const MAX_ROUNDS: usize = 32;

/// Returns `true` if a polygon is longer than `width` but narrower: all its nodes are within
/// `width` of its long axis.
pub fn is_narrow<const D: usize>(
    nodes: impl Iterator<Item = [f64; D]> + Clone,
    width: f64,
) -> bool {
    let mut others = nodes.clone();
    let Some(first) = others.next() else {
        return true;
    };
    let farthest = others.fold(first, |far, x| {
        if distance2(&x, &first) > distance2(&far, &first) {
            x
        } else {
            far
        }
    });
    let length = distance2(&farthest, &first);
    length > width * width
        && nodes.into_iter().all(|x| {
            let fraction = projection_product(&x, &first, &farthest) / length;
            let foot = std::array::from_fn(|k| first[k] + fraction * (farthest[k] - first[k]));
            distance2(&x, &foot) <= width * width
        })
}

/// Returns the scalar product of `x - first` and `farthest - first`: the distance from `first` to
/// the foot of `x`, times the distance to `farthest`.
fn projection_product<const D: usize>(x: &[f64; D], first: &[f64; D], farthest: &[f64; D]) -> f64 {
    (0..D)
        .map(|k| (x[k] - first[k]) * (farthest[k] - first[k]))
        .sum()
}

/// Moves the first node of a group onto the sides of the box on which members of the group lie.
pub fn merge_sides<const D: usize>(
    centres: &mut [[f64; D]],
    first: u32,
    members: &[u32],
    extent: [f64; D],
) {
    for &member in members {
        for k in 0..D {
            let side = centres[member as usize][k];
            if side == 0.0 || side == extent[k] {
                centres[first as usize][k] = side;
            }
        }
    }
}

/// Paths of edges that lead through other nodes.
#[derive(Debug, Default)]
pub struct EdgePaths {
    /// For each edge the nodes between its lower and its higher node, in that order.
    inner_nodes: HashMap<[u32; 2], Vec<u32>>,
}

impl EdgePaths {
    /// Finds the paths that make the narrow faces of `rings` vanish, that is, faces narrower than
    /// `reach` of their nodes. Merges the groups of nodes that coincide. Moves the inner nodes of
    /// an edge on the box's sides onto these sides.
    pub fn new<'a, const D: usize>(
        rings: &'a [Rings],
        groups: &mut SimplexGroups,
        centres: &mut [[f64; D]],
        extent: [f64; D],
        reach: impl Fn(u32) -> f64,
    ) -> Self {
        let mut paths = Self::default();
        let needles = || {
            let faces = |part: &'a Rings| {
                part.narrow_edges
                    .iter()
                    .map(|&edge| part.simplices.get(edge as usize))
            };
            rings.iter().flat_map(faces)
        };
        let (mut path, mut order) = (Vec::new(), Vec::new());
        for _ in 0..MAX_ROUNDS {
            let mut changed = false;
            for needle in needles() {
                paths.trace(needle.iter().map(|&s| groups.find_first(s)), &mut path);
                if path.len() < 3 {
                    continue;
                }
                let width = path.iter().map(|&s| reach(s)).fold(f64::INFINITY, f64::min);
                let first = centres[path[0] as usize];
                let squared_distance = |s: u32| distance2(&centres[s as usize], &first);
                let candidates = path.iter().copied();
                let farthest =
                    candidates.max_by(|&s, &t| squared_distance(s).total_cmp(&squared_distance(t)));
                let farthest = centres[farthest.unwrap_or(path[0]) as usize];
                let length = distance2(&farthest, &first).sqrt();
                let position = |centres: &[[f64; D]], s: u32| {
                    projection_product(&centres[s as usize], &first, &farthest) / length
                };
                order.clear();
                order.extend(path.iter().map(|&s| (position(centres, s), s)));
                order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                order.dedup_by_key(|node| node.1);
                for pair in order.windows(2) {
                    let [s, t] = [pair[0].1, pair[1].1];
                    if pair[1].0 - pair[0].0 <= width && groups.merge(s, t) {
                        let first = groups.find_first(s);
                        merge_sides(centres, first, &[s, t], extent);
                        changed = true;
                    }
                }
                if changed {
                    continue;
                }
                for i in 0..path.len() {
                    let (s, t) = (path[i], path[(i + 1) % path.len()]);
                    let [start, end] = [position(centres, s), position(centres, t)];
                    let (low, high) = (start.min(end), start.max(end));
                    let inner = order.iter().filter(|node| low < node.0 && node.0 < high);
                    let mut inner: Vec<u32> = inner.map(|node| node.1).collect();
                    if inner.is_empty() {
                        continue;
                    }
                    if (start < end) != (s < t) {
                        inner.reverse();
                    }
                    for k in 0..D {
                        let side = centres[s as usize][k];
                        if side == centres[t as usize][k] && (side == 0.0 || side == extent[k]) {
                            inner.iter().for_each(|&m| centres[m as usize][k] = side);
                        }
                    }
                    paths.inner_nodes.insert([s.min(t), s.max(t)], inner);
                }
            }
            if changed {
                // The paths use nodes that have been merged.
                paths.inner_nodes.clear();
            } else if needles().all(|needle| {
                paths.trace(needle.iter().map(|&s| groups.find_first(s)), &mut path);
                path.len() < 3
            }) {
                break;
            }
        }
        paths
    }

    /// Writes a ring led along the paths to `path`, without repeated nodes and without spikes (a
    /// path to a node and back).
    pub fn trace(&self, ring: impl Iterator<Item = u32>, path: &mut Vec<u32>) {
        path.clear();
        for node in ring {
            if let Some(&previous) = path.last() {
                self.append_path(previous, node, path, 0);
            }
            path.push(node);
        }
        if let [first, .., last] = path[..] {
            self.append_path(last, first, path, 0);
        }
        remove_backtracks(path);
    }

    /// Appends the nodes between two nodes.
    fn append_path(&self, from: u32, to: u32, path: &mut Vec<u32>, depth: usize) {
        if self.inner_nodes.is_empty() || depth > MAX_ROUNDS {
            return;
        }
        let Some(between) = self.inner_nodes.get(&[from.min(to), from.max(to)]) else {
            return;
        };
        let mut current = from;
        for i in 0..between.len() {
            let next = between[if from < to { i } else { between.len() - 1 - i }];
            self.append_path(current, next, path, depth + 1);
            path.push(next);
            current = next;
        }
        self.append_path(current, to, path, depth + 1);
    }
}

/// Removes repeated nodes and spikes from a ring.
fn remove_backtracks(nodes: &mut Vec<u32>) {
    let mut kept = 0;
    for i in 0..nodes.len() {
        let node = nodes[i];
        if kept > 0 && nodes[kept - 1] == node {
            continue;
        }
        nodes[kept] = node;
        kept += 1;
        while kept > 2 && nodes[kept - 1] == nodes[kept - 3] {
            kept -= 2;
        }
    }
    nodes.truncate(kept);
    // Does the same across the end and the start of the ring.
    let mut start = 0;
    loop {
        let ring = &nodes[start..];
        match ring {
            [first, .., last] if first == last => {
                nodes.pop();
            }
            [first, .., second_last, _] if ring.len() > 2 && first == second_last => {
                nodes.truncate(nodes.len() - 2);
            }
            [_, second, .., last] if ring.len() > 2 && second == last => start += 2,
            _ => break,
        }
    }
    nodes.drain(..start);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_lose_repeats_and_spikes() {
        let check = |ring: &[u32], expected: &[u32]| {
            let mut nodes = Vec::new();
            EdgePaths::default().trace(ring.iter().copied(), &mut nodes);
            let mut rotated = expected.to_vec();
            let is_equal = (0..expected.len().max(1)).any(|_| {
                rotated.rotate_left(1.min(expected.len()));
                rotated == nodes
            });
            assert!(is_equal, "{ring:?}: {nodes:?}, not {expected:?}");
        };
        check(&[1, 2, 3], &[1, 2, 3]);
        check(&[1, 1, 2, 2, 3, 1], &[1, 2, 3]);
        check(&[1, 2, 3, 2, 4], &[1, 2, 4]);
        check(&[2, 4, 1, 2, 3], &[2, 4, 1]);
        check(&[3, 2, 4, 1, 2], &[2, 4, 1]);
        check(&[5, 6, 5, 5], &[5]);
        check(&[5, 6], &[5, 6]);
        check(&[7, 7], &[7]);
    }
}
