//! The nodes of Voronoi cells: centres of Delaunay simplices, those at one place made one node, and
//! those at a side of the box put onto it exactly.

use crate::parallel::prelude::*;

use super::mirror::MirroredAtoms;

/// The centre of every simplex. Coordinates within `tolerance` of a side of the box are on it exactly.
pub fn centres<const D: usize, const N: usize>(
    mirrored: &MirroredAtoms<D>,
    simplices: &[[u32; N]],
    extent: [f64; D],
    tolerance: f64,
    centre: impl Fn([[f64; D]; N]) -> [f64; D] + Sync,
) -> Vec<[f64; D]> {
    simplices
        .par_iter()
        .map(|simplex| {
            let mut node = centre(simplex.map(|n| mirrored.points[n as usize]));
            for k in 0..D {
                for side in [0.0, extent[k]] {
                    if (node[k] - side).abs() <= tolerance {
                        node[k] = side;
                    }
                }
            }
            node
        })
        .collect()
}

/// The sides of the box beyond which a node lies, as bits.
pub fn sides_beyond<const D: usize>(node: &[f64; D], extent: [f64; D]) -> u8 {
    (0..D).fold(0, |sides, k| {
        let below = u8::from(node[k] < 0.0);
        let above = u8::from(node[k] > extent[k]);
        sides | (below | above << 1) << (2 * k)
    })
}

/// Simplices whose centres are one node, in groups that grow.
pub struct SimplexGroups {
    /// A simplex before it in its group, or itself: the first.
    parents: Vec<u32>,
}

impl SimplexGroups {
    /// Each of `count` simplices alone.
    pub fn new(count: usize) -> Self {
        Self {
            parents: (0..count as u32).collect(),
        }
    }

    /// The first simplex of the group of `s`.
    pub fn find_first(&mut self, mut s: u32) -> u32 {
        let before = &mut self.parents;
        while before[s as usize] != s {
            before[s as usize] = before[before[s as usize] as usize];
            s = before[s as usize];
        }
        s
    }

    /// Makes one group of two; says whether they were two.
    pub fn merge(&mut self, s: u32, t: u32) -> bool {
        let (s, t) = (self.find_first(s), self.find_first(t));
        self.parents[s.max(t) as usize] = s.min(t);
        s != t
    }
}
