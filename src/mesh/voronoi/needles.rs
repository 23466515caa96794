//! Faces too narrow to be any: the edges along them are led through the nodes that they pass, so that
//! both long sides are the same way, and the face is gone.
//!
//! Where atoms miss a symmetric place by rounding, nodes that should be one may lie anywhere on the
//! line between two others (the centre of a flat simplex moves along its axis), and faces are as long
//! as any and as narrow as rounding.

use crate::geometry::distance2;
use std::collections::HashMap;

use super::nodes::SimplexGroups;
use super::rings::Rings;

/// More rounds than any atoms need: one splits edges, the next may find those of the next needle.
const MAX_ROUNDS: usize = 32;

/// Whether a polygon is longer than `width` but narrower: all its nodes are that near to its long axis.
pub fn is_narrow<const D: usize>(
    nodes: impl Iterator<Item = [f64; D]> + Clone,
    width: f64,
) -> bool {
    let mut rest = nodes.clone();
    let Some(first) = rest.next() else {
        return true;
    };
    let far = rest.fold(first, |far, x| {
        if distance2(&x, &first) > distance2(&far, &first) {
            x
        } else {
            far
        }
    });
    let length = distance2(&far, &first);
    length > width * width
        && nodes.into_iter().all(|x| {
            let share = projection_product(&x, &first, &far) / length;
            let foot = std::array::from_fn(|k| first[k] + share * (far[k] - first[k]));
            distance2(&x, &foot) <= width * width
        })
}

/// The distance from `first` to the foot of `x`, times that to `far`.
fn projection_product<const D: usize>(x: &[f64; D], first: &[f64; D], far: &[f64; D]) -> f64 {
    (0..D)
        .map(|k| (x[k] - first[k]) * (far[k] - first[k]))
        .sum()
}

/// Puts the first node of a group onto the sides of the box that its members are on.
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

/// Edges that lead through other nodes.
#[derive(Debug, Default)]
pub struct EdgePaths {
    /// From the edge's lower node to its higher one: the nodes between.
    inner_nodes: HashMap<[u32; 2], Vec<u32>>,
}

impl EdgePaths {
    /// The paths that make the narrow faces of `rings` vanish: narrower than the `reach` of their nodes.
    /// Of nodes that turn out to be one, groups are joined. Nodes that an edge on the box's sides is led
    /// through go onto them.
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
        let (mut way, mut order) = (Vec::new(), Vec::new());
        for _ in 0..MAX_ROUNDS {
            let mut changed = false;
            for needle in needles() {
                paths.trace(needle.iter().map(|&s| groups.find_first(s)), &mut way);
                if way.len() < 3 {
                    continue;
                }
                let width = way.iter().map(|&s| reach(s)).fold(f64::INFINITY, f64::min);
                let first = centres[way[0] as usize];
                let off = |s: u32| distance2(&centres[s as usize], &first);
                let far = way.iter().copied();
                let far = far.max_by(|&s, &t| off(s).total_cmp(&off(t)));
                let far = centres[far.unwrap_or(way[0]) as usize];
                let length = distance2(&far, &first).sqrt();
                let at = |centres: &[[f64; D]], s: u32| {
                    projection_product(&centres[s as usize], &first, &far) / length
                };
                order.clear();
                order.extend(way.iter().map(|&s| (at(centres, s), s)));
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
                for i in 0..way.len() {
                    let (s, t) = (way[i], way[(i + 1) % way.len()]);
                    let [from, to] = [at(centres, s), at(centres, t)];
                    let (low, high) = (from.min(to), from.max(to));
                    let passed = order.iter().filter(|node| low < node.0 && node.0 < high);
                    let mut passed: Vec<u32> = passed.map(|node| node.1).collect();
                    if passed.is_empty() {
                        continue;
                    }
                    if (from < to) != (s < t) {
                        passed.reverse();
                    }
                    for k in 0..D {
                        let side = centres[s as usize][k];
                        if side == centres[t as usize][k] && (side == 0.0 || side == extent[k]) {
                            passed.iter().for_each(|&m| centres[m as usize][k] = side);
                        }
                    }
                    paths.inner_nodes.insert([s.min(t), s.max(t)], passed);
                }
            }
            if changed {
                // The paths lead through nodes that are others now.
                paths.inner_nodes.clear();
            } else if needles().all(|needle| {
                paths.trace(needle.iter().map(|&s| groups.find_first(s)), &mut way);
                way.len() < 3
            }) {
                break;
            }
        }
        paths
    }

    /// A ring led along the paths: without repeats and ways to a node and back.
    pub fn trace(&self, ring: impl Iterator<Item = u32>, way: &mut Vec<u32>) {
        way.clear();
        for node in ring {
            if let Some(&before) = way.last() {
                self.append_path(before, node, way, 0);
            }
            way.push(node);
        }
        if let [first, .., last] = way[..] {
            self.append_path(last, first, way, 0);
        }
        remove_backtracks(way);
    }

    /// Appends what lies between two nodes.
    fn append_path(&self, from: u32, to: u32, way: &mut Vec<u32>, depth: usize) {
        if self.inner_nodes.is_empty() || depth > MAX_ROUNDS {
            return;
        }
        let Some(between) = self.inner_nodes.get(&[from.min(to), from.max(to)]) else {
            return;
        };
        let mut at = from;
        for i in 0..between.len() {
            let next = between[if from < to { i } else { between.len() - 1 - i }];
            self.append_path(at, next, way, depth + 1);
            way.push(next);
            at = next;
        }
        self.append_path(at, to, way, depth + 1);
    }
}

/// Takes repeats out of a ring, and ways to a node and back.
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
    // The same where the end meets the beginning.
    let mut start = 0;
    loop {
        let rest = &nodes[start..];
        match rest {
            [first, .., last] if first == last => {
                nodes.pop();
            }
            [first, .., second_last, _] if rest.len() > 2 && first == second_last => {
                nodes.truncate(nodes.len() - 2);
            }
            [_, second, .., last] if rest.len() > 2 && second == last => start += 2,
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
        let check = |ring: &[u32], want: &[u32]| {
            let mut nodes = Vec::new();
            EdgePaths::default().trace(ring.iter().copied(), &mut nodes);
            let mut turned = want.to_vec();
            let any = (0..want.len().max(1)).any(|_| {
                turned.rotate_left(1.min(want.len()));
                turned == nodes
            });
            assert!(any, "{ring:?}: {nodes:?}, not {want:?}");
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
