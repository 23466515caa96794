//! Edge collapse: where nodes stand too close, one of them goes.

use super::TetImprover;
use crate::mesh::quality::min_sine;

impl TetImprover<'_> {
    /// Moves node `gone` into node `kept`, if everything that holds the one holds the other and
    /// every tetrahedron that changes is better than `floor`.
    pub(super) fn collapse(&mut self, gone: u32, kept: u32, floor: f64) -> bool {
        self.collapse_if(gone, kept, floor, true)
    }

    /// The same, but new edges may pass through features unless `features_first`.
    pub(super) fn collapse_if(
        &mut self,
        gone: u32,
        kept: u32,
        floor: f64,
        features_first: bool,
    ) -> bool {
        let (g, k) = (
            self.constraints[gone as usize],
            self.constraints[kept as usize],
        );
        if g.fixed_axes == 7 || !g.is_subset_of(&k) {
            return false;
        }
        // In a side of the box the node must move within that side.
        let (from, to) = (
            self.complex.nodes[gone as usize],
            self.complex.nodes[kept as usize],
        );
        if (0..3).any(|c| g.fixed_axes >> c & 1 == 1 && from[c] != to[c]) {
            return false;
        }
        let mut star = std::mem::take(&mut self.star);
        self.complex.star(gone, &mut star);
        self.new_tets.clear();
        let mut good = true;
        for &t in &star {
            let tet = self.complex.tets[t as usize];
            if tet.contains(&kept) {
                continue;
            }
            let new = tet.map(|n| if n == gone { kept } else { n });
            if min_sine(&new.map(|n| self.complex.nodes[n as usize])) <= floor {
                good = false;
                break;
            }
            self.new_tets.push(new);
        }
        if good && features_first {
            let mut rim: Vec<u32> = self.new_tets.iter().flatten().copied().collect();
            rim.sort_unstable();
            rim.dedup();
            good = !rim.iter().any(|&n| n != kept && self.intersects(n, kept));
        }
        if good {
            self.commit(&star);
        }
        self.star = star;
        good
    }
}
