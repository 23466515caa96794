//! The nodes of Voronoi cells: centres of Delaunay simplices. Coinciding centres become one node,
//! and centres close to a side of the box are moved onto it exactly.

use crate::parallel::prelude::*;

use super::mirror::MirroredAtoms;

/// Returns the centre of every simplex. Coordinates within `tolerance` of a side of the box are set
/// to that side exactly.
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

/// Returns the sides of the box beyond which a node lies, as bits.
pub fn sides_beyond<const D: usize>(node: &[f64; D], extent: [f64; D]) -> u8 {
    (0..D).fold(0, |sides, k| {
        let below = u8::from(node[k] < 0.0);
        let above = u8::from(node[k] > extent[k]);
        sides | (below | above << 1) << (2 * k)
    })
}

/// Groups of simplices whose centres coincide: a union-find structure.
pub struct SimplexGroups {
    /// A lower simplex of the same group, or the simplex itself if it is the first.
    parents: Vec<u32>,
}

impl SimplexGroups {
    /// Returns `count` groups of one simplex each.
    pub fn new(count: usize) -> Self {
        Self {
            parents: (0..count as u32).collect(),
        }
    }

    /// Returns the first simplex of the group of `s`.
    pub fn find_first(&mut self, mut s: u32) -> u32 {
        let parents = &mut self.parents;
        while parents[s as usize] != s {
            parents[s as usize] = parents[parents[s as usize] as usize];
            s = parents[s as usize];
        }
        s
    }

    /// Merges two groups. Returns `true` if they were different.
    pub fn merge(&mut self, s: u32, t: u32) -> bool {
        let (s, t) = (self.find_first(s), self.find_first(t));
        self.parents[s.max(t) as usize] = s.min(t);
        s != t
    }
}
