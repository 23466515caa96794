//! Splits cells at pinched nodes, where no other part of whole cells helps.
//!
//! A part is drawn back from a pinched node: the edges between the node and the other nodes of the part's
//! cells around it are split, and the cells between the node and the new nodes take the part on their other
//! side. Nodes of one edge or face that are pinched are treated together.

use super::parts::LabelParts;
use super::topology::PartTopology;
use crate::geometry::{distance2, sorted_distinct};
use crate::improve::enlarge_angles;
use crate::lattice::AtomKind;
use crate::lattice::seeding::kind_at;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Largest number of passes over the pinched nodes.
const MAX_PASSES: usize = 4;
/// Largest number of pinched nodes that are treated together.
const MAX_CLUSTER: usize = 12;
/// Positions of new nodes on split edges that are tried, as fractions of the way from the pinched node.
const SPLIT_FRACTIONS: [f64; 3] = [0.5, 0.35, 0.65];
/// Smallest angle of the new cells, in degrees, unless the cells around have a smaller one.
const MIN_SPLIT_ANGLE: f64 = 20.0;
/// A mesh of parts whose pinched nodes are opened.
pub struct PinchedMesh<'a, const D: usize, M> {
    /// The mesh.
    pub mesh: &'a mut M,
    /// The kind of each node.
    pub kinds: &'a mut Vec<AtomKind>,
    /// The adjacent cell for every cell and face, in order.
    pub neighbours: &'a mut Vec<u32>,
    /// The name of each face of each cell, or [`NONE`]; empty if there are no names.
    pub face_names: &'a mut Vec<u32>,
    /// The label of each cell.
    pub regions: &'a mut Vec<u32>,
    /// The part of each cell, or [`NONE`].
    pub cell_parts: &'a mut Vec<u32>,
    /// The parts.
    pub parts: &'a LabelParts<D>,
    /// Far corner of the box.
    pub extent: [f64; D],
}

/// Some cells of a mesh, with nodes of their own numbers.
struct Patch<const D: usize, M> {
    mesh: M,
    /// The part of each cell.
    parts: Vec<u32>,
    /// The cell of the whole mesh of which each cell is a piece.
    origin: Vec<u32>,
    /// The name of each face of each cell; empty if there are no names.
    names: Vec<u32>,
    /// The kind of each node.
    kinds: Vec<AtomKind>,
    /// The nodes whose parts are compared.
    judged: Vec<u32>,
}

impl<const D: usize, M: Simplices<D>> PinchedMesh<'_, D, M> {
    /// Opens the pinched nodes for which a change without flat cells is found.
    pub fn open(&mut self, cancel: &CancelToken<'_>) {
        for _ in 0..MAX_PASSES {
            let topology = PartTopology::new(&*self.mesh, self.neighbours, self.parts);
            let pinched = topology.pinched_nodes(self.cell_parts);
            if pinched.is_empty() {
                break;
            }
            let mut is_taken = vec![false; self.mesh.len()];
            let mut opened: Vec<(Patch<D, M>, Vec<u32>, Vec<u32>)> = Vec::new();
            for cluster in self.clusters(&topology, &pinched) {
                let nodes = sorted_distinct(
                    (cluster.iter().flat_map(|&n| topology.star(n)))
                        .flat_map(|&c| self.mesh.cell(c as usize).iter().copied()),
                );
                let cells = nodes.iter().flat_map(|&n| topology.star(n)).copied();
                let cells = sorted_distinct(cells);
                if cancel.is_cancelled() || cells.iter().any(|&c| is_taken[c as usize]) {
                    continue;
                }
                let (patch, patch_nodes) = self.patch(&cells, &nodes);
                let local = |n: &u32| patch_nodes.binary_search(n).unwrap_or_default() as u32;
                let cluster: Vec<u32> = cluster.iter().map(local).collect();
                if let Some(patch) = patch.opened(&cluster, self.parts, self.extent) {
                    cells.iter().for_each(|&c| is_taken[c as usize] = true);
                    opened.push((patch, cells, patch_nodes));
                }
            }
            if opened.is_empty() {
                break;
            }
            let (nodes, corners) = self.mesh.parts();
            let (mut positions, mut corners) = (nodes.to_vec(), corners.to_vec());
            for (patch, cells, nodes) in opened {
                self.replace(&patch, &cells, &nodes, &mut positions, &mut corners);
            }
            *self.mesh = M::from_parts(positions, corners);
            // A conforming mesh whose edges are split is conforming.
            if let Ok(neighbours) = self.mesh.neighbours() {
                *self.neighbours = neighbours;
            }
        }
    }

    /// Returns the pinched nodes in groups that edges connect.
    fn clusters(&self, topology: &PartTopology<'_, D, M>, pinched: &[u32]) -> Vec<Vec<u32>> {
        let mut is_visited = vec![false; pinched.len()];
        let mut clusters = Vec::new();
        for first in 0..pinched.len() {
            if is_visited[first] {
                continue;
            }
            is_visited[first] = true;
            let mut cluster = vec![pinched[first]];
            let mut next = 0;
            while let Some(&n) = cluster.get(next) {
                next += 1;
                for &m in (topology.star(n).iter()).flat_map(|&c| self.mesh.cell(c as usize)) {
                    if let Ok(i) = pinched.binary_search(&m)
                        && !is_visited[i]
                        && cluster.len() < MAX_CLUSTER
                    {
                        is_visited[i] = true;
                        cluster.push(m);
                    }
                }
            }
            clusters.push(cluster);
        }
        clusters
    }

    /// Returns cells as a mesh of their own, and the numbers of their nodes in the whole mesh.
    fn patch(&self, cells: &[u32], judged: &[u32]) -> (Patch<D, M>, Vec<u32>) {
        let corners = cells.iter().flat_map(|&c| self.mesh.cell(c as usize));
        let nodes = sorted_distinct(corners.clone().copied());
        let local = |n: &u32| nodes.binary_search(n).unwrap_or_default() as u32;
        let positions = nodes.iter().map(|&n| self.mesh.nodes()[n as usize]);
        let names_of = |&c: &u32| &self.face_names[(D + 1) * c as usize..][..D + 1];
        let patch = Patch {
            mesh: M::from_parts(positions.collect(), corners.map(local).collect()),
            parts: cells.iter().map(|&c| self.cell_parts[c as usize]).collect(),
            origin: cells.to_vec(),
            names: if self.face_names.is_empty() {
                Vec::new()
            } else {
                cells.iter().flat_map(names_of).copied().collect()
            },
            kinds: nodes.iter().map(|&n| self.kinds[n as usize]).collect(),
            judged: judged.iter().map(local).collect(),
        };
        (patch, nodes)
    }

    /// Puts the cells of a patch in the place of `cells`, of which it was made with the nodes `nodes`.
    /// `positions` and `corners` are those of the whole mesh.
    fn replace(
        &mut self,
        patch: &Patch<D, M>,
        cells: &[u32],
        nodes: &[u32],
        positions: &mut Vec<[f64; D]>,
        corners: &mut Vec<u32>,
    ) {
        let new_nodes = positions.len() as u32;
        let global = |&n: &u32| match nodes.get(n as usize) {
            Some(&n) => n,
            None => new_nodes + n - nodes.len() as u32,
        };
        for (n, &x) in (0..).zip(patch.mesh.nodes()) {
            match nodes.get(n as usize) {
                Some(&old) => positions[old as usize] = x,
                None => {
                    positions.push(x);
                    self.kinds.push(patch.kinds[n as usize]);
                }
            }
        }
        for c in 0..patch.mesh.len() {
            let (part, origin) = (patch.parts[c], patch.origin[c] as usize);
            let region = if part == NONE {
                self.regions[origin]
            } else {
                self.parts.label(part)
            };
            let names = if patch.names.is_empty() {
                &[][..]
            } else {
                &patch.names[(D + 1) * c..][..D + 1]
            };
            let nodes = patch.mesh.cell(c).iter().map(global);
            if let Some(&c) = cells.get(c) {
                let range = (D + 1) * c as usize..(D + 1) * (c as usize + 1);
                corners[range.clone()]
                    .iter_mut()
                    .zip(nodes)
                    .for_each(|(corner, n)| *corner = n);
                if !names.is_empty() {
                    self.face_names[range].copy_from_slice(names);
                }
                self.cell_parts[c as usize] = part;
                self.regions[c as usize] = region;
            } else {
                corners.extend(nodes);
                self.face_names.extend_from_slice(names);
                self.cell_parts.push(part);
                self.regions.push(region);
            }
        }
    }
}

impl<const D: usize, M: Simplices<D>> Patch<D, M> {
    /// Returns the patch with one part drawn back from the cluster of nodes, so that fewer nodes are pinched;
    /// `None` if there is no such change without flat cells.
    fn opened(&self, cluster: &[u32], parts: &LabelParts<D>, extent: [f64; D]) -> Option<Self> {
        let neighbours = self.mesh.neighbours().ok()?;
        let topology = PartTopology::new(&self.mesh, &neighbours, parts);
        let defects = |n: &u32| topology.defects(*n, &self.parts);
        let before: u32 = self.judged.iter().map(defects).sum();
        let (min_sine, shortest) = self.measure();
        let min_sine = min_sine.min(MIN_SPLIT_ANGLE.to_radians().sin());
        let mut best: Option<(u32, f64, Self)> = None;
        for group in self.groups(&neighbours, cluster) {
            let own = self.parts[group[0] as usize];
            let adjacent = group
                .iter()
                .flat_map(|&c| &neighbours[(D + 1) * c as usize..][..D + 1]);
            let adjacent = adjacent
                .filter(|n| **n != NONE)
                .map(|&n| self.parts[n as usize]);
            for part in sorted_distinct(adjacent) {
                if part == own || part == NONE {
                    continue;
                }
                for fraction in SPLIT_FRACTIONS {
                    let mut trial = self.drawn_back(&group, cluster, part, fraction, extent);
                    let Ok(neighbours) = trial.mesh.neighbours() else {
                        break;
                    };
                    let topology = PartTopology::new(&trial.mesh, &neighbours, parts);
                    let judged = trial.judged.iter().copied();
                    let new_nodes = self.mesh.nodes().len() as u32..trial.mesh.nodes().len() as u32;
                    let nodes = judged.chain(new_nodes.clone());
                    let after: u32 = nodes.map(|n| topology.defects(n, &trial.parts)).sum();
                    if after >= before || best.as_ref().is_some_and(|best| best.0 < after) {
                        break;
                    }
                    let moving: Vec<u32> = cluster.iter().copied().chain(new_nodes).collect();
                    trial.enlarge_angles(&moving, shortest, extent);
                    let sine = trial.measure().0;
                    let is_better = |best: &(u32, f64, Self)| (after, -sine) < (best.0, -best.1);
                    if sine >= min_sine && best.as_ref().is_none_or(is_better) {
                        best = Some((after, sine, trial));
                    }
                }
            }
        }
        best.map(|best| best.2)
    }

    /// Returns the smallest sine of an angle, and the length of the shortest edge.
    fn measure(&self) -> (f64, f64) {
        let (mut min_sine, mut shortest) = (f64::INFINITY, f64::INFINITY);
        for c in 0..self.mesh.len() {
            min_sine = min_sine.min(self.mesh.min_sine(c));
            let x: Vec<_> = (self.mesh.cell(c).iter())
                .map(|&n| self.mesh.nodes()[n as usize])
                .collect();
            for (i, a) in x.iter().enumerate() {
                let squared = x[i + 1..].iter().map(|b| distance2(a, b));
                shortest = squared.fold(shortest, f64::min);
            }
        }
        (min_sine, shortest.sqrt())
    }

    /// Returns the cells at a cluster of nodes, in groups of one part that faces with a node of the cluster connect.
    fn groups(&self, neighbours: &[u32], cluster: &[u32]) -> Vec<Vec<u32>> {
        let is_at = |c: u32, skipped: Option<usize>| {
            let nodes = self.mesh.cell(c as usize).iter().enumerate();
            nodes
                .filter(|(k, _)| Some(*k) != skipped)
                .any(|(_, n)| cluster.contains(n))
        };
        let mut is_visited = vec![false; self.mesh.len()];
        let mut groups = Vec::new();
        for first in 0..self.mesh.len() as u32 {
            if is_visited[first as usize] || !is_at(first, None) {
                continue;
            }
            is_visited[first as usize] = true;
            let mut group = vec![first];
            let mut next = 0;
            while let Some(&c) = group.get(next) {
                next += 1;
                for (k, &n) in neighbours[(D + 1) * c as usize..][..D + 1]
                    .iter()
                    .enumerate()
                {
                    if n != NONE
                        && !is_visited[n as usize]
                        && self.parts[n as usize] == self.parts[c as usize]
                        && is_at(c, Some(k))
                    {
                        is_visited[n as usize] = true;
                        group.push(n);
                    }
                }
            }
            groups.push(group);
        }
        groups
    }

    /// Returns the patch with the edges between the cluster and other nodes of a group of cells split, and the
    /// part of the pieces of the group at the cluster changed.
    fn drawn_back(
        &self,
        group: &[u32],
        cluster: &[u32],
        part: u32,
        fraction: f64,
        extent: [f64; D],
    ) -> Self {
        let mut edges = Vec::new();
        for &c in group {
            let (at, other): (Vec<u32>, Vec<u32>) =
                (self.mesh.cell(c as usize).iter()).partition(|n| cluster.contains(n));
            edges.extend(at.iter().flat_map(|&a| other.iter().map(move |&b| [a, b])));
        }
        let x = |n: u32| self.mesh.nodes()[n as usize];
        let mut edges = sorted_distinct(edges);
        edges.sort_by(|e, f| {
            let length = |[a, b]: &[u32; 2]| distance2(&x(*a), &x(*b));
            length(f).total_cmp(&length(e))
        });
        let mut in_group: Vec<bool> = vec![false; self.mesh.len()];
        group.iter().for_each(|&c| in_group[c as usize] = true);
        let (mut nodes, mut corners) = (
            self.mesh.nodes().to_vec(),
            self.mesh.connectivity().to_vec(),
        );
        let (mut parts, mut origin) = (self.parts.clone(), self.origin.clone());
        let (mut names, mut kinds) = (self.names.clone(), self.kinds.clone());
        for [a, b] in edges {
            let new = nodes.len() as u32;
            let position = std::array::from_fn(|k| x(a)[k] + fraction * (x(b)[k] - x(a)[k]));
            nodes.push(position);
            kinds.push(kind_at(position, extent));
            for c in 0..parts.len() {
                let cell = &corners[(D + 1) * c..][..D + 1];
                let at = |n: u32| cell.iter().position(|&m| m == n);
                let (Some(i), Some(j)) = (at(a), at(b)) else {
                    continue;
                };
                // The piece at `b` is a new cell; the one at `a` takes the place of the cell.
                let mut piece = cell.to_vec();
                piece[i] = new;
                corners.extend(piece);
                corners[(D + 1) * c + j] = new;
                parts.push(parts[c]);
                origin.push(origin[c]);
                in_group.push(in_group[c]);
                if !names.is_empty() {
                    let mut piece = names[(D + 1) * c..][..D + 1].to_vec();
                    piece[j] = NONE;
                    names.extend(piece);
                    names[(D + 1) * c + i] = NONE;
                }
            }
        }
        for (c, cell) in corners.chunks_exact(D + 1).enumerate() {
            if in_group[c] && cell.iter().any(|n| cluster.contains(n)) {
                parts[c] = part;
            }
        }
        Self {
            mesh: M::from_parts(nodes, corners),
            parts,
            origin,
            names,
            kinds,
            judged: self.judged.clone(),
        }
    }

    /// Moves nodes so that the smallest angle around each becomes larger. Nodes on faces with names stay.
    fn enlarge_angles(&mut self, moving: &[u32], shortest: f64, extent: [f64; D]) {
        let mut is_named = vec![false; self.mesh.nodes().len()];
        let named = (self.names.iter().enumerate()).filter(|(_, name)| **name != NONE);
        for (face, _) in named {
            let face = self.mesh.face(face / (D + 1), face % (D + 1));
            face.iter().for_each(|&n| is_named[n as usize] = true);
        }
        let is_fixed = |n: usize| matches!(self.kinds[n], AtomKind::Corner | AtomKind::Fixed);
        let movable = moving.iter().copied();
        let movable: Vec<u32> = movable
            .filter(|&n| !is_named[n as usize] && !is_fixed(n as usize))
            .collect();
        enlarge_angles(&mut self.mesh, &movable, shortest, extent);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::LabelMap;
    use crate::geometry::add_scaled;
    use crate::image::LabelValue;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::{Mesh, TetMesh};

    /// Returns a map of samples of the labels of three layers: below, a wall of one sample, and above.
    fn wall() -> LabelMap<3> {
        LabelMap {
            values: None,
            dims: [5; 3],
            step: [1.0; 3],
            labels: [0.0, 1.0, 2.0].map(LabelValue::from_sample).to_vec(),
            names: vec![None; 3],
            volumes: vec![24.0, 16.0, 24.0],
            winner: (0..125).map(|i| [0, 0, 1, 2, 2][i / 25]).collect(),
            lead: vec![1.0; 125],
        }
    }

    /// Opens the pinches of a mesh of cubes of side 1 and returns the mesh and the parts of its cells.
    fn opened(part_of: impl Fn([f64; 3]) -> u32) -> (TetMesh, Vec<u32>) {
        let mut mesh = kuhn_box([4; 3], 1.0);
        let centroid = |c: usize| {
            let corners = mesh.cell(c).iter().map(|&n| mesh.nodes[n as usize]);
            corners.fold([0.0; 3], |sum, x| add_scaled(sum, 0.25, x))
        };
        let mut cell_parts: Vec<u32> = (0..mesh.len()).map(|c| part_of(centroid(c))).collect();
        let mut regions = cell_parts.clone();
        let mut neighbours = mesh.neighbours().unwrap();
        let name = |(face, n): (usize, &u32)| if *n == NONE { face as u32 } else { NONE };
        let mut face_names: Vec<u32> = neighbours.iter().enumerate().map(name).collect();
        let kinds = |x: &[f64; 3]| kind_at(*x, [4.0; 3]);
        let mut kinds = mesh.nodes.iter().map(kinds).collect();
        let map = wall();
        let parts = LabelParts::new(&map);
        let is_pinched = |mesh: &TetMesh, neighbours: &[u32], cell_parts: &[u32]| {
            !(PartTopology::new(mesh, neighbours, &parts).pinched_nodes(cell_parts)).is_empty()
        };
        assert!(is_pinched(&mesh, &neighbours, &cell_parts));
        let mut pinched = PinchedMesh {
            mesh: &mut mesh,
            kinds: &mut kinds,
            neighbours: &mut neighbours,
            face_names: &mut face_names,
            regions: &mut regions,
            cell_parts: &mut cell_parts,
            parts: &parts,
            extent: [4.0; 3],
        };
        pinched.open(&CancelToken::never());
        assert!(!is_pinched(&mesh, &neighbours, &cell_parts));
        assert_eq!(regions, cell_parts);
        assert_eq!(neighbours, mesh.neighbours().unwrap());
        assert_eq!(kinds.len(), mesh.nodes.len());
        assert_eq!(face_names.len(), neighbours.len());
        // Pieces of a face keep its name, and new faces inside of cells have none.
        let mut faces = neighbours.iter().zip(&face_names);
        assert!(faces.all(|(n, name)| (*n == NONE) == (*name != NONE)));
        assert!((0..mesh.len()).all(|c| mesh.min_sine(c) > 15f64.to_radians().sin()));
        let volume: f64 = mesh.volumes().iter().sum();
        assert!((volume - 64.0).abs() < 1e-9);
        (mesh, cell_parts)
    }

    #[test]
    fn parts_on_both_sides_of_a_wall_that_meet_at_a_node_are_separated() {
        // Cones that meet in the middle of the wall.
        let part_of = |x: [f64; 3]| {
            let [u, v, w] = x.map(|a| a - 2.0);
            let is_inside = w.abs() > 1.0 || u.abs().max(v.abs()) < w.abs();
            match (is_inside, w < 0.0) {
                (false, _) => 1,
                (true, true) => 0,
                (true, false) => 2,
            }
        };
        let (mesh, parts) = opened(part_of);
        let volumes = super::super::part_volumes(&mesh, &parts, 3);
        assert!(volumes.iter().all(|&volume| volume > 15.0), "{volumes:?}");
    }

    #[test]
    fn a_part_that_meets_itself_at_an_edge_is_opened() {
        let part_of = |x: [f64; 3]| {
            let is_opposite = (x[0] < 2.0) == (x[1] < 2.0) && (1.0..3.0).contains(&x[2]);
            u32::from(is_opposite)
        };
        opened(part_of);
    }
}
