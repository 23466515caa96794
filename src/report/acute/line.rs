//! Acute lines, and the mean angles of their edges.

use serde::{Serialize, Serializer};

use crate::geometry::{norm, sub};

/// Distance along a line, to either side, over which its angle is averaged, in units of d.
const AVERAGING_RADIUS: f64 = 2.0;

/// Pair of surfaces that meet at an acute line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum AcutePair {
    /// Two features.
    Features,
    /// Feature and side of the box: 2 k at the low end of axis k, 2 k + 1 at the high end.
    Side(u8),
}

impl AcutePair {
    /// Returns the pair as a number: 0 for two features, otherwise 1 + the number of the side.
    pub fn code(self) -> u8 {
        match self {
            Self::Features => 0,
            Self::Side(side) => side + 1,
        }
    }
}

impl std::fmt::Display for AcutePair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self::Side(side) = self else {
            return f.write_str("two features");
        };
        let axis = ["x", "y", "z"][usize::from(side / 2).min(2)];
        let end = if side.is_multiple_of(2) {
            "low"
        } else {
            "high"
        };
        write!(f, "feature and {end} side along {axis}")
    }
}

impl Serialize for AcutePair {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Chain of edges of a mesh (in 2-D a single node) at which the same pair meets at an acute angle.
/// Lengths and angles are in the space that was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AcuteLine {
    /// Pair that meets there.
    pub pair: AcutePair,
    /// Length of the line; 0 in 2-D.
    pub length: f64,
    /// Smallest angle of all edges, in degrees.
    pub min_angle: f64,
    /// Mean angle, weighted by length, in degrees.
    pub mean_angle: f64,
    /// Nodes in order. The last node equals the first if the line is closed.
    #[serde(skip)]
    pub nodes: Vec<u32>,
    /// Angle at each edge (in 2-D at the node), in degrees.
    #[serde(skip)]
    pub angles: Vec<f64>,
}

/// Edge of an acute line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AcuteEdge {
    /// Ends of the edge. In 2-D the same node twice.
    pub nodes: [u32; 2],
    /// Angle of the line there, in degrees: the mean over the neighbourhood along the line.
    pub angle: f64,
}

impl AcuteLine {
    pub(super) fn new<const D: usize>(
        nodes: Vec<u32>,
        angles: Vec<f64>,
        pair: AcutePair,
        positions: &[[f64; D]],
    ) -> Self {
        let lengths = lengths(&nodes, positions);
        let length: f64 = lengths.iter().sum();
        let mean_angle = if length > 0.0 {
            weighted_sum(&angles, &lengths) / length
        } else {
            angles.iter().sum::<f64>() / angles.len() as f64
        };
        Self {
            pair,
            length,
            min_angle: angles.iter().copied().fold(f64::INFINITY, f64::min),
            mean_angle,
            nodes,
            angles,
        }
    }

    /// Returns the edges (in 2-D the node), each with the mean angle of the line in its
    /// neighbourhood. On a rough surface the angle of a single edge can be far from that mean.
    pub(in crate::report) fn edges<const D: usize>(
        &self,
        positions: &[[f64; D]],
        distance: &dyn Fn(u32) -> f64,
    ) -> Vec<AcuteEdge> {
        if let &[node] = &*self.nodes {
            let angle = self.mean_angle;
            return vec![AcuteEdge {
                nodes: [node; 2],
                angle,
            }];
        }
        let lengths = lengths(&self.nodes, positions);
        let mut position = 0.0;
        let middles: Vec<f64> = (lengths.iter())
            .map(|length| {
                position += length;
                position - 0.5 * length
            })
            .collect();
        let pieces = (0..lengths.len()).map(|i| {
            let nodes = [self.nodes[i], self.nodes[i + 1]];
            let radius = AVERAGING_RADIUS * 0.5 * nodes.map(distance).iter().sum::<f64>();
            let begin = middles.partition_point(|&m| m < middles[i] - radius);
            let end = middles.partition_point(|&m| m <= middles[i] + radius);
            let length: f64 = lengths[begin..end].iter().sum();
            let sum = weighted_sum(&self.angles[begin..end], &lengths[begin..end]);
            let angle = if length > 0.0 {
                sum / length
            } else {
                self.angles[i]
            };
            AcuteEdge { nodes, angle }
        });
        pieces.collect()
    }
}

fn lengths<const D: usize>(nodes: &[u32], positions: &[[f64; D]]) -> Vec<f64> {
    let segment_length = |ends: &[u32]| {
        let [a, b] = [ends[0], ends[1]].map(|n| positions[n as usize]);
        norm(sub(a, b))
    };
    nodes.windows(2).map(segment_length).collect()
}

fn weighted_sum(values: &[f64], weights: &[f64]) -> f64 {
    values.iter().zip(weights).map(|(v, w)| v * w).sum()
}
