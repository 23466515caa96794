//! Keeps parts of labels apart that touch nowhere in the image, and their surfaces free of pinches.
//!
//! Cells take the label of most of their volume, so that a shell may end at a node: the regions on its two
//! sides touch there, and what the shell keeps back leaks. A node is *pinched* if
//!
//! - two parts meet at it that touch nowhere in the image, at a side, an edge or a corner of a sample, or
//! - the cells of a part around it are not connected by faces, or those of all other parts, with what is outside
//!   of the mesh, are not.
//!
//! At each such node, the cells of one part (all of them, those connected by faces around the node, or one
//! cell) take the part on their other side, if this leaves fewer pinches in all. Of several changes, the one whose
//! cells the labels of the image support most is made.

use super::assign::Votes;
use super::parts::LabelParts;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::sorted_distinct;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;

/// Largest number of passes over the pinched nodes.
const MAX_PASSES: usize = 8;
/// Weight of two parts that must not touch, compared with that of cells that are not connected.
const CONTACT_WEIGHT: u32 = 8;

/// A mesh whose cells belong to parts of labels.
pub struct PartTopology<'a, const D: usize, M> {
    mesh: &'a M,
    neighbours: &'a [u32],
    parts: &'a LabelParts<D>,
    /// `true` if what is outside of the mesh counts as a part.
    judges_sides: bool,
    /// Cells around each node, as ranges of `star_cells`.
    start: Vec<u32>,
    star_cells: Vec<u32>,
}

/// A change of the part of some cells.
struct Change {
    cells: Vec<u32>,
    part: u32,
    cost: f64,
}

impl<'a, const D: usize, M: Simplices<D>> PartTopology<'a, D, M> {
    /// Collects the cells around each node.
    pub fn new(mesh: &'a M, neighbours: &'a [u32], parts: &'a LabelParts<D>) -> Self {
        let corners = mesh.connectivity();
        let (start, slots) = sort_by_group(mesh.nodes().len(), corners.iter().map(|&n| n as usize));
        Self {
            mesh,
            neighbours,
            parts,
            judges_sides: true,
            start,
            star_cells: slots.iter().map(|slot| slot / (D as u32 + 1)).collect(),
        }
    }

    /// Returns the same without regard to what is outside of the mesh.
    pub fn without_sides(self) -> Self {
        Self {
            judges_sides: false,
            ..self
        }
    }

    /// Returns the cells around a node, in ascending order.
    pub(super) fn star(&self, n: u32) -> &[u32] {
        let n = n as usize;
        &self.star_cells[self.start[n] as usize..self.start[n + 1] as usize]
    }

    /// Returns the nodes of cells of different parts.
    fn interface_nodes(&self, part: &[u32]) -> Vec<u32> {
        let nodes = 0..self.mesh.nodes().len() as u32;
        nodes
            .filter(|&n| {
                let star = self.star(n);
                star.iter()
                    .any(|&c| part[c as usize] != part[star[0] as usize])
            })
            .collect()
    }

    /// Returns the nodes that are pinched.
    pub fn pinched_nodes(&self, part: &[u32]) -> Vec<u32> {
        let mut nodes = self.interface_nodes(part);
        nodes.retain(|&n| self.defects(n, part) > 0);
        nodes
    }

    /// Returns groups of cells around node `n` that are connected by faces at the node, as the index of the first
    /// cell of the group in `star` for each cell. Only cells of equal `key` are connected. If `outside` is the key of what
    /// is outside of the mesh, that follows the cells as one more, which is connected through the sides of the mesh.
    fn groups<K: PartialEq>(
        &self,
        n: u32,
        star: &[u32],
        key: impl Fn(u32) -> K,
        outside: Option<K>,
    ) -> Vec<usize> {
        // A neighbour in the star shares a face at the node, as only one face of a cell is not at the
        // node, and what lies beyond it is not in the star.
        let adjacent_cells = |i: usize| {
            let faces = &self.neighbours[(D + 1) * star[i] as usize..][..D + 1];
            faces.iter().filter_map(|c| star.binary_search(c).ok())
        };
        let is_at_side = |i: usize| {
            let (c, range) = (star[i] as usize, 0..=D);
            let cell = self.mesh.cell(c);
            let mut faces = range.filter(|&k| self.neighbours[(D + 1) * c + k] == NONE);
            faces.any(|k| cell[k] != n)
        };
        let has_outside_key = |i: usize| outside.as_ref() == Some(&key(star[i]));
        let mut group: Vec<usize> = (0..star.len() + usize::from(outside.is_some())).collect();
        let mut stack = Vec::new();
        let mut is_visited = vec![false; group.len()];
        for first in 0..group.len() {
            if is_visited[first] {
                continue;
            }
            is_visited[first] = true;
            stack.push(first);
            while let Some(i) = stack.pop() {
                group[i] = first;
                let mut visit = |j: usize| {
                    if !std::mem::replace(&mut is_visited[j], true) {
                        stack.push(j);
                    }
                };
                if i == star.len() {
                    let at_side = (0..star.len()).filter(|&j| has_outside_key(j) && is_at_side(j));
                    at_side.for_each(visit);
                    continue;
                }
                let same_key = |j: &usize| key(star[*j]) == key(star[i]);
                adjacent_cells(i).filter(same_key).for_each(&mut visit);
                if has_outside_key(i) && is_at_side(i) {
                    visit(star.len());
                }
            }
        }
        group
    }

    /// Returns `true` if a side of the mesh is at node `n`.
    fn is_on_side(&self, n: u32, star: &[u32]) -> bool {
        star.iter().any(|&c| {
            let c = c as usize;
            let mut faces = self.mesh.cell(c).iter().enumerate();
            faces.any(|(k, m)| *m != n && self.neighbours[(D + 1) * c + k] == NONE)
        })
    }

    /// Returns how much is wrong at a node; 0 if it is not pinched.
    pub(super) fn defects(&self, n: u32, part: &[u32]) -> u32 {
        let star = self.star(n);
        let parts_here = sorted_distinct(star.iter().map(|&c| part[c as usize]));
        if parts_here.len() < 2 {
            return 0;
        }
        let group_count =
            |groups: &[usize]| groups.iter().enumerate().filter(|(i, g)| i == *g).count();
        let mut defects = 0;
        for (i, &a) in parts_here.iter().enumerate() {
            for &b in &parts_here[i + 1..] {
                if a != NONE && b != NONE && !self.parts.may_touch(a, b) {
                    defects += CONTACT_WEIGHT;
                }
            }
        }
        let groups = self.groups(n, star, |c| part[c as usize], None);
        defects += (group_count(&groups) - parts_here.len()) as u32;
        let is_on_side = self.judges_sides && self.is_on_side(n, star);
        if parts_here.len() > 2 || is_on_side {
            for &a in &parts_here {
                let is_own = |c: u32| part[c as usize] == a;
                let groups = self.groups(n, star, is_own, is_on_side.then_some(false));
                // One group of the others, and those of the part itself.
                let own = (0..star.len()).filter(|&i| groups[i] == i && is_own(star[i]));
                defects += (group_count(&groups) - own.count() - 1) as u32;
            }
        }
        defects
    }

    /// Changes the parts of cells until no change leaves fewer pinches. `votes` has the sample points of
    /// each label in each cell.
    pub fn repair(&self, part: &mut [u32], votes: &[Votes]) {
        let mut cell_counts = vec![0usize; self.parts.count()];
        for &p in part.iter().filter(|&&p| p != NONE) {
            cell_counts[p as usize] += 1;
        }
        let mut pinched = self.pinched_nodes(part);
        for _ in 0..MAX_PASSES {
            let mut affected = Vec::new();
            for &n in &pinched {
                if self.defects(n, part) == 0 {
                    continue;
                }
                let Some(change) = self.best_change(n, part, votes, &cell_counts) else {
                    continue;
                };
                for &c in &change.cells {
                    if part[c as usize] != NONE {
                        cell_counts[part[c as usize] as usize] -= 1;
                    }
                    cell_counts[change.part as usize] += 1;
                    part[c as usize] = change.part;
                    affected.extend_from_slice(self.mesh.cell(c as usize));
                }
            }
            if affected.is_empty() {
                break;
            }
            affected.extend_from_slice(&pinched);
            pinched = sorted_distinct(affected);
            pinched.retain(|&n| self.defects(n, part) > 0);
        }
    }

    /// Returns the best change at a node that leaves fewer pinches; `None` if there is none.
    fn best_change(
        &self,
        n: u32,
        part: &mut [u32],
        votes: &[Votes],
        cell_counts: &[usize],
    ) -> Option<Change> {
        let star = self.star(n).to_vec();
        let groups = self.groups(n, &star, |c| part[c as usize], None);
        let mut candidates: Vec<Vec<u32>> = Vec::new();
        for first in 0..star.len() {
            let group = (0..star.len()).filter(|&i| groups[i] == first);
            let group: Vec<u32> = group.map(|i| star[i]).collect();
            if group.len() > 1 {
                candidates.push(group);
            }
        }
        candidates.extend(star.iter().map(|&c| vec![c]));
        for a in sorted_distinct(star.iter().map(|&c| part[c as usize])) {
            let all = star.iter().copied().filter(|&c| part[c as usize] == a);
            candidates.push(all.collect());
        }
        let mut best: Option<Change> = None;
        for cells in candidates {
            let current = part[cells[0] as usize];
            if current != NONE && cell_counts[current as usize] <= cells.len() {
                continue;
            }
            let adjacent = (cells.iter())
                .flat_map(|&c| &self.neighbours[(D + 1) * c as usize..][..D + 1])
                .filter(|&&n| n != NONE)
                .map(|&n| part[n as usize]);
            for new_part in sorted_distinct(adjacent) {
                if new_part == current || new_part == NONE {
                    continue;
                }
                let label = |p: u32| (p != NONE).then(|| self.parts.label(p));
                let share = |c: u32, p: u32| label(p).map_or(0.0, |l| votes[c as usize].share(l));
                let cost = |&c: &u32| {
                    self.mesh.volume(c as usize) * (share(c, current) - share(c, new_part))
                };
                let cost: f64 = cells.iter().map(cost).sum();
                if best.as_ref().is_some_and(|best| best.cost <= cost) {
                    continue;
                }
                if self.defect_change(&cells, new_part, part) < 0 {
                    best = Some(Change {
                        cells: cells.clone(),
                        part: new_part,
                        cost,
                    });
                }
            }
        }
        best
    }

    /// Returns by how much the defects of all nodes change if cells take another part.
    fn defect_change(&self, cells: &[u32], new_part: u32, part: &mut [u32]) -> i64 {
        let nodes = sorted_distinct(
            cells
                .iter()
                .flat_map(|&c| self.mesh.cell(c as usize))
                .copied(),
        );
        let sum = |part: &[u32]| -> i64 {
            let defects = nodes.iter().map(|&n| i64::from(self.defects(n, part)));
            defects.sum()
        };
        let before = sum(part);
        let old: Vec<u32> = cells.iter().map(|&c| part[c as usize]).collect();
        cells.iter().for_each(|&c| part[c as usize] = new_part);
        let after = sum(part);
        for (&c, old) in cells.iter().zip(old) {
            part[c as usize] = old;
        }
        after - before
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::LabelMap;
    use crate::image::LabelValue;
    use crate::mesh::TetMesh;
    use crate::mesh::boxes::kuhn_box;

    /// Returns a map of three labels: below, a wall of one sample, and above.
    fn wall() -> LabelMap<3> {
        let dims = [5; 3];
        let winner: Vec<u32> = (0..125)
            .map(|i| match i / 25 {
                0 | 1 => 0,
                2 => 1,
                _ => 2,
            })
            .collect();
        LabelMap {
            values: None,
            dims,
            step: [1.0; 3],
            labels: [0.0, 1.0, 2.0].map(LabelValue::from_sample).to_vec(),
            names: vec![None; 3],
            volumes: vec![24.0, 16.0, 24.0],
            winner,
            lead: vec![1.0; 125],
        }
    }

    /// Returns a mesh of cubes of side 0.5, with the part of each cell by the height of its centroid.
    fn mesh_of_wall() -> (TetMesh, Vec<u32>) {
        let mesh = kuhn_box([8; 3], 0.5);
        let part = |c: usize| {
            let height: f64 = mesh
                .cell(c)
                .iter()
                .map(|&n| mesh.nodes[n as usize][2] / 4.0)
                .sum();
            match height {
                z if z < 1.5 => 0,
                z if z < 2.5 => 1,
                _ => 2,
            }
        };
        let parts = (0..mesh.tets.len()).map(part).collect();
        (mesh, parts)
    }

    #[test]
    fn parts_that_touch_only_at_a_node_of_the_mesh_are_kept_apart() {
        let (mesh, mut part) = mesh_of_wall();
        let neighbours = mesh.neighbours().unwrap();
        let map = wall();
        let parts = LabelParts::new(&map);
        assert!(parts.may_touch(0, 1) && parts.may_touch(2, 1) && !parts.may_touch(0, 2));
        let topology = PartTopology::new(&mesh, &neighbours, &parts);
        assert!(topology.pinched_nodes(&part).is_empty());
        let flat = part.clone();
        // The cells around a node in the middle of the wall belong to the regions on its sides.
        let middle = mesh.nodes.iter().position(|x| *x == [2.0; 3]).unwrap() as u32;
        for c in 0..mesh.tets.len() {
            if mesh.cell(c).contains(&middle) {
                let height: f64 = mesh
                    .cell(c)
                    .iter()
                    .map(|&n| mesh.nodes[n as usize][2] / 4.0)
                    .sum();
                part[c] = if height < 2.0 { 0 } else { 2 };
            }
        }
        assert!(topology.pinched_nodes(&part).contains(&middle));
        let votes = vec![Votes::default(); mesh.tets.len()];
        topology.repair(&mut part, &votes);
        assert!(topology.pinched_nodes(&part).is_empty());
        // Only cells around the node differ from before.
        let changed = (0..part.len()).filter(|&c| part[c] != flat[c]);
        assert!(changed.clone().all(|c| mesh.cell(c).contains(&middle)));
    }

    #[test]
    fn a_part_that_is_connected_by_an_edge_alone_is_a_pinch() {
        let (mesh, _) = mesh_of_wall();
        let neighbours = mesh.neighbours().unwrap();
        let map = wall();
        let parts = LabelParts::new(&map);
        let topology = PartTopology::new(&mesh, &neighbours, &parts);
        let (edge, centre) = ([2.0, 2.0], |c: usize, k: usize| -> f64 {
            mesh.cell(c)
                .iter()
                .map(|&n| mesh.nodes[n as usize][k] / 4.0)
                .sum()
        });
        // Part 1 fills two opposite quarters around the edge x = y = 2.
        let mut part: Vec<u32> = (0..mesh.tets.len())
            .map(|c| u32::from((centre(c, 0) < edge[0]) == (centre(c, 1) < edge[1])))
            .collect();
        let pinched = topology.pinched_nodes(&part);
        assert_eq!(pinched.len(), 9);
        topology.repair(&mut part, &vec![Votes::default(); mesh.tets.len()]);
        assert!(topology.pinched_nodes(&part).is_empty());
    }
}
