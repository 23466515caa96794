//! A part of a complex as one of its own: to try changes there while nothing of the whole changes.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::atomic::Ordering::Relaxed;

use super::{Complex, NONE, NOT_LOCAL};

/// What the nodes and tetrahedra of a part are in the whole.
#[derive(Debug, Default)]
pub struct PartNumbering {
    /// The whole's number of each node, and whether the part has all tetrahedra at it.
    pub nodes: Vec<(u32, bool)>,
    /// Of each tetrahedron.
    pub slots: Vec<u32>,
    /// The other way round.
    local_nodes: IdMap,
    local_slots: IdMap,
}

type IdMap = HashMap<u32, u32, BuildHasherDefault<FibonacciHasher>>;

/// Hashing of numbers that no one chose in bad faith.
#[derive(Default)]
struct FibonacciHasher(u64);

impl Hasher for FibonacciHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u32(byte.into()));
    }

    fn write_u32(&mut self, number: u32) {
        let product = (self.0 ^ u64::from(number)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ product >> 32;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

impl Complex {
    /// Becomes the part of `whole` that has all tetrahedra at nodes where it `holds`, as far as they are joined to
    /// the tetrahedra `first`, whose numbers become 0, 1 and so on. Nothing that it was before is left.
    pub fn set_to_part(
        &mut self,
        whole: &Complex,
        first: &[u32],
        holds: impl Fn([f64; 3]) -> bool,
        numbers: &mut PartNumbering,
    ) {
        let PartNumbering {
            nodes,
            slots,
            local_nodes: node_here,
            local_slots: slot_here,
        } = numbers;
        nodes.clear();
        slots.clear();
        node_here.clear();
        slot_here.clear();
        self.nodes.clear();
        self.tets.clear();
        self.neighbors.clear();
        self.tet_of_node.clear();
        self.slot_stamps.clear();
        self.free_slots.clear();
        (self.stamp, self.journal) = (0, None);
        *self.reached_nonlocal.get_mut() = false;

        slots.extend_from_slice(first);
        slot_here.extend(first.iter().copied().zip(0..));
        let mut here = 0;
        while here < slots.len() {
            let slot = slots[here];
            let tet = whole.tets[slot as usize].map(|n| {
                *node_here.entry(n).or_insert_with(|| {
                    let x = whole.nodes[n as usize];
                    nodes.push((n, holds(x)));
                    self.nodes.push(x);
                    self.tet_of_node.push(here as u32);
                    nodes.len() as u32 - 1
                })
            });
            self.tets.push(tet);
            let all = tet.map(|n| nodes[n as usize].1);
            let around = whole.neighbors[slot as usize];
            self.neighbors.push(std::array::from_fn(|k| {
                let n = around[k];
                if n == NONE {
                    return NONE;
                }
                // It is at a node that has all if one of the face does.
                let wanted = (0..4).any(|i| i != k && all[i]);
                match slot_here.entry(n) {
                    Entry::Occupied(here) => *here.get(),
                    Entry::Vacant(place) if wanted => {
                        slots.push(n);
                        *place.insert(slots.len() as u32 - 1)
                    }
                    Entry::Vacant(_) => NOT_LOCAL,
                }
            }));
            here += 1;
        }
        self.slot_stamps.resize(self.tets.len(), 0);
        // What came later than its neighbour looked.
        for t in 0..self.tets.len() {
            for k in 0..4 {
                if self.neighbors[t][k] == NOT_LOCAL {
                    let there = whole.neighbors[slots[t] as usize][k];
                    self.neighbors[t][k] = slot_here.get(&there).copied().unwrap_or(NOT_LOCAL);
                }
            }
        }
        self.renumber(numbers);
    }

    /// Numbers the nodes of a part in the order of the whole's: what goes through them goes the same way.
    fn renumber(&mut self, numbers: &mut PartNumbering) {
        let mut order: Vec<u32> = (0..self.nodes.len() as u32).collect();
        order.sort_unstable_by_key(|&n| numbers.nodes[n as usize].0);
        let mut now = vec![0; order.len()];
        for (i, &n) in order.iter().enumerate() {
            now[n as usize] = i as u32;
        }
        let before = |i: &u32| *i as usize;
        numbers.nodes = order.iter().map(|i| numbers.nodes[before(i)]).collect();
        self.nodes = order.iter().map(|i| self.nodes[before(i)]).collect();
        self.tet_of_node = order.iter().map(|i| self.tet_of_node[before(i)]).collect();
        for tet in &mut self.tets {
            *tet = tet.map(|n| now[n as usize]);
        }
    }

    /// Whether anything was asked of this part that only the whole knows: the answer was wrong.
    pub fn has_reached_nonlocal(&self) -> bool {
        self.reached_nonlocal.load(Relaxed)
    }

    /// The same, and forgets it: it may be asked other things.
    pub fn take_reached_nonlocal(&mut self) -> bool {
        std::mem::take(self.reached_nonlocal.get_mut())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::complex::{Ring, neighbors};

    /// So many tetrahedra round the axis (0, 1), in a fan that is open.
    fn fan(count: u32) -> Complex {
        let mut nodes = vec![[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]];
        for i in 0..=count {
            let (sin, cos) = (f64::from(i) * 0.5).sin_cos();
            nodes.push([cos, sin, 0.0]);
        }
        let tets: Vec<[u32; 4]> = (0..count).map(|i| [0, 1, i + 2, i + 3]).collect();
        let around = neighbors(nodes.len(), &tets).unwrap();
        Complex::new(TetMesh { nodes, tets }, around)
    }

    #[test]
    fn a_part_knows_what_it_does_not_know() {
        let whole = fan(8);
        let (mut part, mut numbers) = (Complex::default(), PartNumbering::default());
        // The tetrahedra at node 5: numbers 2 and 3.
        let at = whole.nodes[5];
        part.set_to_part(&whole, &[3], |x| x == at, &mut numbers);
        assert_eq!(numbers.slots, [3, 2]);
        let of_whole: Vec<u32> = numbers.nodes.iter().map(|n| n.0).collect();
        assert_eq!(of_whole, [0, 1, 4, 5, 6]);
        assert_eq!(part.neighbors[0], [NONE, NONE, NOT_LOCAL, 1]);
        let mut star = Vec::new();
        part.star(3, &mut star);
        star.sort_unstable();
        assert_eq!(star, [0, 1]);
        assert!(!part.take_reached_nonlocal(), "all at node 5 is here");
        part.star(0, &mut star);
        assert!(part.take_reached_nonlocal(), "others are at node 0");
        assert!(!part.take_reached_nonlocal(), "asked before");
        let mut ring = Ring::default();
        part.ring(0, 0, 1, 9, &mut ring);
        assert!(part.take_reached_nonlocal());
        // Another part of the same size in the same room.
        part.set_to_part(&whole, &[0], |x| x == whole.nodes[2], &mut numbers);
        assert_eq!((numbers.slots.len(), part.tets.len()), (1, 1));
        assert_eq!(part.neighbors[0], [NONE, NONE, NOT_LOCAL, NONE]);
    }
}
