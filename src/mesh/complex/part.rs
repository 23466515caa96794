//! Copies a part of a complex into a complex of its own, so that changes can be tried without
//! touching the global complex.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::atomic::Ordering::Relaxed;

use super::{Complex, NONE, NOT_LOCAL};

/// Global numbers of the nodes and tetrahedra of a part.
#[derive(Debug, Default)]
pub struct PartNumbering {
    /// For each node its global number, and `true` if the part contains all tetrahedra at it.
    pub nodes: Vec<(u32, bool)>,
    /// For each tetrahedron its global slot.
    pub slots: Vec<u32>,
    /// Local number of each global node, the inverse of `nodes`.
    local_nodes: IdMap,
    local_slots: IdMap,
}

type IdMap = HashMap<u32, u32, BuildHasherDefault<FibonacciHasher>>;

/// A fast hash (Fibonacci hashing) for numbers that are not chosen by an attacker.
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
    /// Replaces this complex by a part of `global`: all tetrahedra at nodes for which `is_inside`
    /// holds, as far as they are connected with the tetrahedra `seeds`. The seeds get the numbers
    /// 0, 1 and so on.
    pub fn set_to_part(
        &mut self,
        global: &Complex,
        seeds: &[u32],
        is_inside: impl Fn([f64; 3]) -> bool,
        numbering: &mut PartNumbering,
    ) {
        let PartNumbering {
            nodes,
            slots,
            local_nodes,
            local_slots,
        } = numbering;
        nodes.clear();
        slots.clear();
        local_nodes.clear();
        local_slots.clear();
        self.nodes.clear();
        self.tets.clear();
        self.neighbours.clear();
        self.tet_of_node.clear();
        self.slot_epochs.clear();
        self.free_slots.clear();
        (self.epoch, self.journal) = (0, None);
        *self.reached_nonlocal.get_mut() = false;

        slots.extend_from_slice(seeds);
        local_slots.extend(seeds.iter().copied().zip(0..));
        let mut current = 0;
        while current < slots.len() {
            let slot = slots[current];
            let tet = global.tets[slot as usize].map(|n| {
                *local_nodes.entry(n).or_insert_with(|| {
                    let x = global.nodes[n as usize];
                    nodes.push((n, is_inside(x)));
                    self.nodes.push(x);
                    self.tet_of_node.push(current as u32);
                    nodes.len() as u32 - 1
                })
            });
            self.tets.push(tet);
            let is_complete = tet.map(|n| nodes[n as usize].1);
            let adjacent = global.neighbours[slot as usize];
            self.neighbours.push(std::array::from_fn(|k| {
                let n = adjacent[k];
                if n == NONE {
                    return NONE;
                }
                // The neighbour belongs to the part if a node of the shared face is complete.
                let is_needed = (0..4).any(|i| i != k && is_complete[i]);
                match local_slots.entry(n) {
                    Entry::Occupied(local) => *local.get(),
                    Entry::Vacant(entry) if is_needed => {
                        slots.push(n);
                        *entry.insert(slots.len() as u32 - 1)
                    }
                    Entry::Vacant(_) => NOT_LOCAL,
                }
            }));
            current += 1;
        }
        self.slot_epochs.resize(self.tets.len(), 0);
        // Links to neighbours that were added after this tetrahedron was visited.
        for t in 0..self.tets.len() {
            for k in 0..4 {
                if self.neighbours[t][k] == NOT_LOCAL {
                    let neighbour = global.neighbours[slots[t] as usize][k];
                    self.neighbours[t][k] =
                        local_slots.get(&neighbour).copied().unwrap_or(NOT_LOCAL);
                }
            }
        }
        self.renumber(numbering);
    }

    /// Numbers the nodes of the part in the order of the global numbers, so that loops over nodes
    /// visit them in the same order.
    fn renumber(&mut self, numbering: &mut PartNumbering) {
        let mut order: Vec<u32> = (0..self.nodes.len() as u32).collect();
        order.sort_unstable_by_key(|&n| numbering.nodes[n as usize].0);
        let mut new_index = vec![0; order.len()];
        for (i, &n) in order.iter().enumerate() {
            new_index[n as usize] = i as u32;
        }
        let old_index = |i: &u32| *i as usize;
        numbering.nodes = order
            .iter()
            .map(|i| numbering.nodes[old_index(i)])
            .collect();
        self.nodes = order.iter().map(|i| self.nodes[old_index(i)]).collect();
        self.tet_of_node = order
            .iter()
            .map(|i| self.tet_of_node[old_index(i)])
            .collect();
        for tet in &mut self.tets {
            *tet = tet.map(|n| new_index[n as usize]);
        }
    }

    /// Returns `true` if a query needed tetrahedra that are only in the global complex. Its answer
    /// was wrong then.
    pub fn has_reached_nonlocal(&self) -> bool {
        self.reached_nonlocal.load(Relaxed)
    }

    /// Returns the value of [`has_reached_nonlocal`](Self::has_reached_nonlocal) and resets it, for
    /// further queries.
    pub fn take_reached_nonlocal(&mut self) -> bool {
        std::mem::take(self.reached_nonlocal.get_mut())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::complex::{Ring, neighbours};

    /// Returns an open fan of `count` tetrahedra around the axis (0, 1).
    fn fan(count: u32) -> Complex {
        let mut nodes = vec![[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]];
        for i in 0..=count {
            let (sin, cos) = (f64::from(i) * 0.5).sin_cos();
            nodes.push([cos, sin, 0.0]);
        }
        let tets: Vec<[u32; 4]> = (0..count).map(|i| [0, 1, i + 2, i + 3]).collect();
        let adjacent = neighbours(nodes.len(), &tets).unwrap();
        Complex::new(TetMesh { nodes, tets }, adjacent)
    }

    #[test]
    fn a_part_reports_queries_beyond_itself() {
        let global = fan(8);
        let (mut part, mut numbering) = (Complex::default(), PartNumbering::default());
        // The tetrahedra at node 5 are numbers 2 and 3.
        let position = global.nodes[5];
        part.set_to_part(&global, &[3], |x| x == position, &mut numbering);
        assert_eq!(numbering.slots, [3, 2]);
        let global_nodes: Vec<u32> = numbering.nodes.iter().map(|n| n.0).collect();
        assert_eq!(global_nodes, [0, 1, 4, 5, 6]);
        assert_eq!(part.neighbours[0], [NONE, NONE, NOT_LOCAL, 1]);
        let mut star = Vec::new();
        part.star(3, &mut star);
        star.sort_unstable();
        assert_eq!(star, [0, 1]);
        assert!(
            !part.take_reached_nonlocal(),
            "all tetrahedra at node 5 are local"
        );
        part.star(0, &mut star);
        assert!(
            part.take_reached_nonlocal(),
            "some tetrahedra at node 0 are not local"
        );
        assert!(!part.take_reached_nonlocal(), "the mark was reset");
        let mut ring = Ring::default();
        part.ring(0, 0, 1, 9, &mut ring);
        assert!(part.take_reached_nonlocal());
        // A second part reuses the same memory.
        part.set_to_part(&global, &[0], |x| x == global.nodes[2], &mut numbering);
        assert_eq!((numbering.slots.len(), part.tets.len()), (1, 1));
        assert_eq!(part.neighbours[0], [NONE, NONE, NOT_LOCAL, NONE]);
    }
}
