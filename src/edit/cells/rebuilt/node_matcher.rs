//! Nodes of new faces, matched with the nodes that stay.

use std::collections::{BTreeMap, BTreeSet};

use super::RebuiltCells;
use crate::edit::cells::editable_cells::cells_of_nodes;
use crate::edit::resolve::INFLUENCE_RADIUS;
use crate::geometry::cell_list::CellList;
use crate::geometry::{distance2, sorted};
use crate::lattice::optimise::temperature::{EDIT_RADIUS, relative_distance};
use crate::mesh::poly::{FIRST_SIDE, Lists};

/// Distance, in units of d, within which a new node counts as an old one.
const NODE_TOLERANCE: f64 = 1e-7;

/// Matches nodes of new faces with the nodes that stay.
pub struct NodeMatcher<'a, 'b, const D: usize> {
    rebuilt: &'a RebuiltCells<'b, D>,
    /// For each node of the window, the cells and sides that meet in it, by their numbers in the
    /// mesh.
    cells_of_nodes: Vec<Vec<u32>>,
    /// Preserved nodes by the cells that meet in them; `cell_list` finds them by position.
    nodes_by_cells: BTreeMap<&'a [u32], Vec<u32>>,
    cell_list: CellList<D>,
    /// Numbers of the nodes in `cell_list`.
    node_numbers: Vec<u32>,
    /// Cells of the faces whose nodes all stay.
    pub complete_faces: BTreeSet<[u32; 2]>,
    /// Preserved nodes that new faces must contain, because other nodes of one of their faces do
    /// not stay.
    required_nodes: BTreeSet<u32>,
    matched_nodes: BTreeSet<u32>,
    /// For each node of the window, its number in the mesh, or a number after all nodes of the mesh
    /// for a new one.
    window_numbers: Vec<Option<u32>>,
}

impl<'a, 'b, const D: usize> NodeMatcher<'a, 'b, D> {
    pub fn new(rebuilt: &'a RebuiltCells<'b, D>) -> Self {
        let (editable, preserved) = (rebuilt.neighbourhood.editable, rebuilt.preserved);
        let window_cells: Lists = cells_of_nodes(&rebuilt.mesh);
        let mesh_cells = |n: usize| {
            let cells = window_cells.get(n).iter();
            sorted(cells.map(|&c| rebuilt.mesh_cell(c)).collect::<Vec<u32>>())
        };
        let (mut nodes_by_cells, mut complete_faces, mut required_nodes) =
            (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        for (f, cells) in editable.mesh.face_cells.iter().enumerate() {
            let is_border = |c: u32| {
                preserved
                    .is_border
                    .get(c as usize)
                    .copied()
                    .unwrap_or(c >= FIRST_SIDE)
            };
            if !cells.iter().all(|&c| is_border(c)) {
                continue;
            }
            let ring = editable.mesh.faces.get(f).iter().copied();
            let kept_nodes: Vec<u32> = ring.filter(|&n| preserved.keeps_node[n as usize]).collect();
            if kept_nodes.len() == editable.mesh.faces.get(f).len() {
                complete_faces.insert(*cells);
            } else {
                required_nodes.extend(kept_nodes);
            }
        }
        let (mut node_numbers, mut positions) = (Vec::new(), Vec::new());
        for n in (0..editable.mesh.nodes.len()).filter(|&n| preserved.keeps_node[n]) {
            let cells = editable.cells_of_nodes.get(n);
            let is_border_cell = |&c: &u32| {
                preserved
                    .is_border
                    .get(c as usize)
                    .copied()
                    .unwrap_or(false)
            };
            if cells.iter().any(is_border_cell) {
                nodes_by_cells
                    .entry(cells)
                    .or_insert_with(Vec::new)
                    .push(n as u32);
                node_numbers.push(n as u32);
                positions.push(
                    rebuilt
                        .neighbourhood
                        .window
                        .to_local(editable.mesh.nodes[n]),
                );
            }
        }
        Self {
            cells_of_nodes: (0..rebuilt.mesh.nodes.len()).map(mesh_cells).collect(),
            window_numbers: vec![None; rebuilt.mesh.nodes.len()],
            matched_nodes: BTreeSet::new(),
            cell_list: CellList::new(&positions, rebuilt.fields.distance.max()),
            node_numbers,
            rebuilt,
            nodes_by_cells,
            complete_faces,
            required_nodes,
        }
    }

    /// Returns the nodes of a face of the window, or `None` if one is too far from every edit.
    pub fn ring(&mut self, face: usize, new_nodes: &mut Vec<[f64; D]>) -> Option<Vec<u32>> {
        let rebuilt = self.rebuilt;
        let face_nodes = rebuilt.mesh.faces.get(face);
        let mut ring: Vec<u32> = Vec::with_capacity(face_nodes.len());
        for &n in face_nodes {
            let number = match self.window_numbers[n as usize] {
                Some(number) => number,
                None => self.find_node(n as usize, new_nodes)?,
            };
            self.window_numbers[n as usize] = Some(number);
            if ring.last() != Some(&number) {
                ring.push(number);
            }
        }
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        Some(ring)
    }

    /// Returns the preserved node at node `n` of the window, or else adds a new node.
    fn find_node(&mut self, n: usize, new_nodes: &mut Vec<[f64; D]>) -> Option<u32> {
        let RebuiltCells {
            neighbourhood,
            mesh,
            ..
        } = self.rebuilt;
        let x = mesh.nodes[n];
        let distance2_to = |&m: &u32| {
            let old = neighbourhood
                .window
                .to_local(neighbourhood.editable.mesh.nodes[m as usize]);
            distance2(&old, &x)
        };
        let cells = self.cells_of_nodes[n].as_slice();
        let mut candidates: Vec<u32> = self.nodes_by_cells.get(cells).cloned().unwrap_or_default();
        if candidates.is_empty() {
            let reach = NODE_TOLERANCE * self.rebuilt.fields.distance.value_at(x);
            self.cell_list
                .visit_within(x, reach, |i| candidates.push(self.node_numbers[i]));
            candidates.retain(|m| distance2_to(m) < reach * reach);
        }
        let nearest = candidates
            .into_iter()
            .min_by(|a, b| distance2_to(a).total_cmp(&distance2_to(b)));
        if let Some(m) = nearest {
            self.matched_nodes.insert(m);
            return Some(m);
        }
        // The node is known to be right only if its whole sphere, out to its nearest sites, lies
        // within the influence radius.
        let distances = cells
            .iter()
            .filter(|&&c| c < FIRST_SIDE)
            .map(|&c| self.site(c));
        let distances = distances.map(|y| distance2(&y, &x).sqrt());
        let radius = distances.fold(f64::INFINITY, f64::min);
        let mut edited = neighbourhood.edited_places.iter();
        let is_in_reach =
            edited.any(|(y, d)| distance2(y, &x).sqrt() + radius < INFLUENCE_RADIUS * d);
        if !is_in_reach || relative_distance(&x, &neighbourhood.edited_places) > EDIT_RADIUS {
            return None;
        }
        new_nodes.push(neighbourhood.window.to_global(x));
        Some((neighbourhood.editable.mesh.nodes.len() + new_nodes.len() - 1) as u32)
    }

    /// Returns the position of a cell's site in the window.
    fn site(&self, cell: u32) -> [f64; D] {
        let RebuiltCells {
            neighbourhood,
            mesh,
            preserved_atoms,
            ..
        } = self.rebuilt;
        let old_sites = &neighbourhood.editable.mesh.sites;
        match old_sites.get(cell as usize) {
            Some(&x) => neighbourhood.window.to_local(x),
            None => mesh.sites[cell as usize - old_sites.len() + preserved_atoms.len()],
        }
    }

    /// Returns `true` if new faces contain all the nodes that they must contain.
    pub fn is_complete(&self) -> bool {
        self.required_nodes.is_subset(&self.matched_nodes)
    }
}
