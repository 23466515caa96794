//! Edge collapse: removes one of two nodes that are too close to each other.
//!
//! ```text
//!    1---2            1---2      g = `removed`, k = `kept`
//!   / \ / \          /  `. \     The tetrahedra at the edge (g, k) vanish. In the
//!  6---g---k   ->   6-------k    others at g, k takes the place of g: new edges
//!   \ / \ /          \  ,' /     lead from k to the neighbours of g (here to 1, 5
//!    5---4            5---4      and 6, as 2 and 4 are neighbours of k already).
//! ```

use super::TetImprover;
use crate::geometry::{sorted_distinct, sub};
use crate::mesh::quality::min_sine;

impl TetImprover<'_> {
    /// Moves node `removed` into node `kept`, if `kept` has all of its constraints and every
    /// tetrahedron that changes is better than `floor`.
    pub(super) fn collapse(&mut self, removed: u32, kept: u32, floor: f64) -> bool {
        self.collapse_if(removed, kept, floor, true)
    }

    /// Collapses as [`collapse`](Self::collapse) does; new edges may pass through features unless
    /// `features_first` is set.
    pub(super) fn collapse_if(
        &mut self,
        removed: u32,
        kept: u32,
        floor: f64,
        features_first: bool,
    ) -> bool {
        let (g, k) = (
            self.constraints[removed as usize],
            self.constraints[kept as usize],
        );
        let (from, to) = (
            self.complex.nodes[removed as usize],
            self.complex.nodes[kept as usize],
        );
        if g.fixed_axes == 7 || !g.is_subset_of(&k, sub(to, from)) {
            return false;
        }
        // A node in a side of the box may move within that side only.
        if !g.allows_move(from, to) {
            return false;
        }
        let mut star = std::mem::take(&mut self.star);
        self.complex.star(removed, &mut star);
        self.new_tets.clear();
        let mut good = true;
        for &t in &star {
            let tet = self.complex.tets[t as usize];
            if tet.contains(&kept) {
                continue;
            }
            let new_tet = tet.map(|n| if n == removed { kept } else { n });
            if min_sine(&new_tet.map(|n| self.complex.nodes[n as usize])) <= floor {
                good = false;
                break;
            }
            self.new_tets.push(new_tet);
        }
        if good && features_first {
            let rim = sorted_distinct(self.new_tets.iter().flatten().copied());
            good = !rim.iter().any(|&n| n != kept && self.intersects(n, kept));
        }
        if good {
            self.commit(&star);
        }
        self.star = star;
        good
    }
}
