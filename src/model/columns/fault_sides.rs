//! Faces between columns at a fault, where levels (tops and bottoms of layers) have another z on
//! either side.
//!
//! ```text
//!      p        q      The two columns meet in the upright plane over the map's edge from p to q.
//!  a2 ─┼────────┼─     Each level is a straight line there. Two cells share the part of the plane
//!      │     b2 ┼─     that lies between the levels of both: a polygon whose corners are ends of
//!  a1 ─┼──╲─────┼─     levels and places where levels of the two columns cross.
//!  b1 ─┼────╲───┼─
//! ```
//!
//! Cells of either column that reach above or below the other column have faces on the boundary,
//! which lie in no side of the box.

use std::collections::BTreeMap;

use crate::geometry::add_scaled;

/// A level of a column over an edge of the map: its nodes over the two ends of the edge.
pub type Level = [u32; 2];

/// A face between two columns.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedFace {
    /// The layers of the first and of the second column, counted upwards; `None` above or below the
    /// column.
    pub layers: [Option<usize>; 2],
    /// The nodes, anticlockwise as seen with the edge to the right and z upwards.
    pub ring: Vec<u32>,
}

/// The nodes over a map, to which nodes are added where levels cross.
pub struct CrossingNodes<'a> {
    /// The nodes.
    pub nodes: &'a mut Vec<[f64; 3]>,
    /// For each level that others cross, the fractions of the edge at which they do, and the nodes.
    pub on_levels: BTreeMap<Level, Vec<(f64, u32)>>,
    /// The nodes over each node of the map, upwards; only where faults tear the map.
    pub lines: &'a [Vec<u32>],
}

/// An end of a shared face over the edge of the map.
#[derive(Debug, Clone, Copy)]
struct FaceEnd {
    /// The lower and the upper node, which are equal where the face ends in a point.
    nodes: [u32; 2],
    /// Sign of the first column's level over the second's: of the lower and of the upper levels.
    signs: [i8; 2],
}

impl CrossingNodes<'_> {
    /// Returns the faces between two columns with these levels, upwards, over the edge between two
    /// nodes of the map.
    pub fn shared_faces(
        &mut self,
        map_nodes: [u32; 2],
        first: &[Level],
        second: &[Level],
    ) -> Vec<SharedFace> {
        let mut faces = Vec::new();
        let spans = |levels: &[Level]| -> Vec<(Option<usize>, [Option<Level>; 2])> {
            let count = levels.len();
            let level = |k: usize| (1..=count).contains(&k).then(|| levels[k - 1]);
            let spans = (0..=count).map(|k| {
                let layer = (1..count).contains(&k).then(|| k - 1);
                (layer, [level(k), level(k + 1)])
            });
            // Layers without thickness over the edge have no faces.
            spans.filter(|(_, [low, high])| low != high).collect()
        };
        let (first, second) = (spans(first), spans(second));
        for (a, [a_low, a_high]) in &first {
            for (b, [b_low, b_high]) in &second {
                if a.is_none() && b.is_none() {
                    continue;
                }
                let ring = self.common_part(map_nodes, [*a_low, *a_high], [*b_low, *b_high]);
                if let Some(ring) = ring {
                    faces.push(SharedFace {
                        layers: [*a, *b],
                        ring,
                    });
                }
            }
        }
        faces
    }

    /// Returns the outline of the part of the upright plane that lies between two pairs of levels.
    /// A level that is missing is far below or far above. `None` if there is no such part.
    fn common_part(
        &mut self,
        map_nodes: [u32; 2],
        [a_low, a_high]: [Option<Level>; 2],
        [b_low, b_high]: [Option<Level>; 2],
    ) -> Option<Vec<u32>> {
        // Signs of the height of the upper level of one pair over the lower level of the other.
        let height = |high: Option<Level>, low: Option<Level>, end: usize| match (high, low) {
            (Some(_), Some(_)) => self.sign(high, low, end, 1),
            _ => 1,
        };
        let heights = [(a_high, b_low), (b_high, a_low)]
            .map(|(high, low)| [0, 1].map(|end| height(high, low, end)));
        if heights.iter().any(|[p, q]| *p <= 0 && *q <= 0) {
            return None;
        }
        let mut face_end = |end: usize| {
            // Where an upper level is below a lower one, the part ends in the point where they cross.
            let crossed = match [heights[0][end] < 0, heights[1][end] < 0] {
                [true, _] => Some((a_high?, b_low?, -1)),
                [_, true] => Some((b_high?, a_low?, 1)),
                _ => None,
            };
            if let Some((high, low, sign)) = crossed {
                return Some(FaceEnd {
                    nodes: [self.crossing(high, low); 2],
                    signs: [sign; 2],
                });
            }
            let signs = [
                self.sign(a_low, b_low, end, -1),
                self.sign(a_high, b_high, end, 1),
            ];
            let low = if signs[0] >= 0 { a_low } else { b_low }?;
            let high = if signs[1] <= 0 { a_high } else { b_high }?;
            Some(FaceEnd {
                nodes: [low[end], high[end]],
                signs,
            })
        };
        let (left, right) = (face_end(0)?, face_end(1)?);
        let crosses = |k: usize| left.signs[k] * right.signs[k] < 0;
        let mut ring = vec![left.nodes[0]];
        if let (true, Some(a), Some(b)) = (crosses(0), a_low, b_low) {
            ring.push(self.crossing(a, b));
        }
        ring.push(right.nodes[0]);
        ring.extend(self.nodes_between(map_nodes[1], right.nodes));
        ring.push(right.nodes[1]);
        if let (true, Some(a), Some(b)) = (crosses(1), a_high, b_high) {
            ring.push(self.crossing(a, b));
        }
        ring.push(left.nodes[1]);
        ring.extend(self.nodes_between(map_nodes[0], left.nodes).iter().rev());
        ring.dedup();
        if ring.first() == ring.last() {
            ring.pop();
        }
        (ring.len() > 2).then_some(ring)
    }

    /// Returns the nodes over a node of the map strictly between two of them, upwards.
    pub fn nodes_between(&self, map_node: u32, [low, high]: [u32; 2]) -> Vec<u32> {
        let line = &self.lines[map_node as usize];
        let place = |node: u32| line.iter().position(|&n| n == node);
        match (place(low), place(high)) {
            (Some(low), Some(high)) if low < high => line[low + 1..high].to_vec(),
            _ => Vec::new(),
        }
    }

    /// Returns the sign of the height of a level over another at one end of the edge. If one is
    /// missing, the sign is `missing` for the first, and its opposite for the second.
    fn sign(&self, a: Option<Level>, b: Option<Level>, end: usize, missing: i8) -> i8 {
        match (a, b) {
            (Some(a), Some(b)) if a[end] == b[end] => 0,
            (Some(a), Some(b)) => {
                let [a, b] = [a, b].map(|level| self.nodes[level[end] as usize][2]);
                if a > b { 1 } else { -1 }
            }
            (None, Some(_)) => missing,
            (Some(_), None) => -missing,
            (None, None) => 0,
        }
    }

    /// Returns the node at which two levels cross.
    fn crossing(&mut self, a: Level, b: Level) -> u32 {
        let ends = |level: Level| level.map(|n| self.nodes[n as usize]);
        let ([ap, aq], [bp, bq]) = (ends(a), ends(b));
        let (at_p, at_q) = (ap[2] - bp[2], aq[2] - bq[2]);
        let fraction = at_p / (at_p - at_q);
        let known = self.on_levels.get(&a).into_iter().flatten();
        let other = self.on_levels.get(&b).into_iter().flatten();
        let other = other.map(|crossing| crossing.1);
        let mut common = known.map(|crossing| crossing.1);
        if let Some(node) = common.find(|node| other.clone().any(|n| n == *node)) {
            return node;
        }
        let along = std::array::from_fn(|k| aq[k] - ap[k]);
        let node = self.nodes.len() as u32;
        self.nodes.push(add_scaled(ap, fraction, along));
        for level in [a, b] {
            let crossings = self.on_levels.entry(level).or_default();
            let place = crossings.partition_point(|crossing| crossing.0 < fraction);
            crossings.insert(place, (fraction, node));
        }
        node
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the areas of the faces between columns with these levels over the edge from
    /// (0, 0) to (2, 0), by layers.
    fn areas(first: &[[f64; 2]], second: &[[f64; 2]]) -> Vec<([Option<usize>; 2], f64)> {
        let mut nodes: Vec<[f64; 3]> = Vec::new();
        let mut lines = vec![Vec::new(); 2];
        let mut level = |z: &[f64; 2]| {
            [0, 1].map(|end| {
                let x = 2.0 * end as f64;
                let known = nodes.iter().position(|p| *p == [x, 0.0, z[end]]);
                known.unwrap_or_else(|| {
                    nodes.push([x, 0.0, z[end]]);
                    lines[end].push(nodes.len() as u32 - 1);
                    nodes.len() - 1
                }) as u32
            })
        };
        let [first, second] =
            [first, second].map(|levels| levels.iter().map(&mut level).collect::<Vec<_>>());
        for line in &mut lines {
            line.sort_by(|&a, &b| nodes[a as usize][2].total_cmp(&nodes[b as usize][2]));
        }
        let mut crossings = CrossingNodes {
            nodes: &mut nodes,
            on_levels: BTreeMap::new(),
            lines: &lines,
        };
        let faces = crossings.shared_faces([0, 1], &first, &second);
        let area = |ring: &[u32]| {
            let turns = (0..ring.len()).map(|i| {
                let [p, q] = [i, (i + 1) % ring.len()].map(|i| nodes[ring[i] as usize]);
                0.5 * (p[0] * q[2] - q[0] * p[2])
            });
            turns.sum::<f64>()
        };
        faces
            .iter()
            .map(|face| (face.layers, area(&face.ring)))
            .collect()
    }

    #[test]
    fn cells_share_the_part_between_the_levels_of_both() {
        // A throw of 1 between two layers of thickness 3 each.
        let shared = areas(
            &[[0.0, 0.0], [3.0, 3.0], [6.0, 6.0]],
            &[[1.0, 1.0], [4.0, 4.0], [7.0, 7.0]],
        );
        let expected = [
            ([None, Some(1)], 2.0),
            ([Some(0), None], 2.0),
            ([Some(0), Some(0)], 4.0),
            ([Some(1), Some(0)], 2.0),
            ([Some(1), Some(1)], 4.0),
        ];
        let mut sorted = shared.clone();
        sorted.sort_by_key(|face| face.0);
        assert_eq!(sorted, expected);
        // Without throw, each layer meets its own.
        let level = [[0.0, 0.0], [3.0, 3.0], [6.0, 6.0]];
        assert_eq!(
            areas(&level, &level),
            [([Some(0), Some(0)], 6.0), ([Some(1), Some(1)], 6.0)]
        );
    }

    #[test]
    fn levels_may_cross() {
        // A throw from 2 downwards to 2 upwards: the lines cross at the middle.
        let shared = areas(&[[0.0, 0.0], [1.0, 1.0]], &[[2.0, -2.0], [3.0, -1.0]]);
        // The second column is between the first's levels where -1 < 2 - 2x < 1: the part between
        // 0 and 1 has the area 0.5 (its levels fall by 2 for each unit of x).
        let find = |layers: [Option<usize>; 2]| {
            let faces = shared.iter().filter(|face| face.0 == layers);
            faces.map(|face| face.1).sum::<f64>()
        };
        assert!((find([Some(0), Some(0)]) - 0.5).abs() < 1e-12, "{shared:?}");
        // Each column's side is covered once.
        for column in 0..2 {
            let of_column = shared.iter().filter(|face| face.0[column].is_some());
            let area: f64 = of_column.map(|face| face.1).sum();
            assert!((area - 2.0).abs() < 1e-12, "{shared:?}");
        }
        // Columns that only meet at the end of a fault.
        let wedge = areas(&[[0.0, 0.0], [1.0, 1.0]], &[[0.0, 0.5], [1.0, 1.5]]);
        let area: f64 = wedge
            .iter()
            .filter(|face| face.0 == [Some(0); 2])
            .map(|face| face.1)
            .sum();
        assert!((area - 1.5).abs() < 1e-12, "{wedge:?}");
    }
}
