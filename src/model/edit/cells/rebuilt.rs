//! Cells made anew while others stay.

use std::collections::{BTreeMap, BTreeSet};

use super::editable_cells::cells_of_nodes;
use super::patch::{CellNeighbourhood, CellPatch, NewCell, PatchFace, PlacedAtom};
use super::preserved::{FeatureChanges, PreservedParts};
use crate::Result;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2};
use crate::job::cells::{cut_even_cells, relax_atoms};
use crate::job::horizons::horizon_flags;
use crate::job::{MeshSpace, Meshing};
use crate::lattice::AtomKind;
use crate::lattice::optimize::temperature::{EDIT_RADIUS, relative_distance};
use crate::lattice::seeding::Atoms;
use crate::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};
use crate::mesh::voronoi::conform::{ConformingSites, FacetGrid, FacetSurface, SiteRegion};
use crate::model::edit::local_fields::LocalFields;
use crate::model::edit::resolve::INFLUENCE_RADIUS;
use crate::progress::{CancelToken, TokenProgress};

/// New nodes at old ones, to this share of d, are these.
const NODE_TOLERANCE: f64 = 1e-7;
/// A free atom that came is the one this near to where it came, in units of d.
const FREE_ATOM_RADIUS: f64 = 1.0;
/// An atom nearer than this, in units of d, to where one was has its number.
const RENUMBER_RADIUS: f64 = 0.6;
/// The number of a side of the window where the image goes on.
const OPEN_SIDE: u32 = u32::MAX;

/// New cells round an edit, with those around them.
pub struct RebuiltCells<'a, const D: usize> {
    neighbourhood: &'a CellNeighbourhood<'a, D>,
    fields: &'a LocalFields<D>,
    surface: &'a FacetSurface<D>,
    changes: &'a FeatureChanges<D>,
    preserved: &'a PreservedParts,
    /// The cells of the window: of the atoms that stay, of those that are put, of others, of sites.
    mesh: PolyMesh<D>,
    sites: ConformingSites<D>,
    /// The atoms that stay.
    preserved_atoms: Vec<u32>,
    placed_atoms: Vec<PlacedAtom<D>>,
    /// Atoms that were put and then moved.
    free_atoms: Vec<PlacedAtom<D>>,
    /// The number of all atoms.
    atom_count: usize,
}

impl<'a, const D: usize> RebuiltCells<'a, D>
where
    MeshSpace<D>: Meshing<D>,
{
    /// Brings atoms to rest round what stays and the parts of the surface that have changed, and cuts
    /// their cells; also tells how often the energy was evaluated.
    ///
    /// # Errors
    /// Those of optimiser and triangulation.
    #[expect(
        clippy::too_many_arguments,
        reason = "all that is known of the neighbourhood"
    )]
    pub fn new(
        scope: &'a CellNeighbourhood<'a, D>,
        around: &'a LocalFields<D>,
        (surface, changed): (&'a FacetSurface<D>, &'a FeatureChanges<D>),
        (kept, range): (&'a PreservedParts, f64),
        gone: &[bool],
        puts: &[PlacedAtom<D>],
        seed: u64,
        patience: &CancelToken<'_>,
    ) -> Result<(Self, usize)> {
        let (grid, extent) = (scope.editable, scope.window.extent());
        let cells = || scope.cells.iter().map(|&c| c as usize).zip(&scope.sites);
        let stay = cells().filter(|&(c, _)| kept.keeps_atom[c]);
        let (fixed, mut positions): (Vec<u32>, Vec<[f64; D]>) =
            stay.map(|(c, x)| (c as u32, *x)).unzip();
        let warm = || cells().filter(|&(c, _)| !kept.keeps_atom[c] && !gone[c]);
        // Wells stay where they are, whatever their cells become.
        let wells = warm().filter(|&(c, _)| grid.kinds[c] == AtomKind::Fixed);
        let mut put: Vec<PlacedAtom<D>> = wells
            .map(|(c, &at)| PlacedAtom {
                position: at,
                kind: AtomKind::Fixed,
                world: Some(grid.world.sites[c]),
                number: Some(c as u32),
                edit: None,
            })
            .collect();
        let (stays, free): (Vec<PlacedAtom<D>>, Vec<PlacedAtom<D>>) =
            puts.iter().partition(|put| put.kind == AtomKind::Fixed);
        put.extend(stays);
        positions.extend(put.iter().map(|put| put.position));
        let mut kinds = vec![AtomKind::Fixed; positions.len()];

        let balls = (0..kept.keeps_node.len())
            .filter(|&n| kept.keeps_node[n])
            .filter_map(|n| {
                let x = scope.window.to_local(grid.mesh.nodes[n]);
                let within = relative_distance(&x, &scope.edited_places) < INFLUENCE_RADIUS;
                let cell = *grid.cells_of_nodes.get(n).first()?;
                let site = scope.window.to_local(grid.mesh.sites[cell as usize]);
                within.then(|| (x, distance2(&x, &site).sqrt()))
            });
        let open = scope.edited_places.iter().map(|&(x, d)| (x, range * d));
        let room = SiteRegion::new(open.collect(), balls.collect());
        let part = surface.subset(|f| {
            let corners = surface.corners(f);
            let share = 1.0 / D as f64;
            let middle = corners
                .iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, share, x));
            changed.needs_rebuild(&middle)
        });
        let mut sites = ConformingSites::with_region(part, extent, &positions, room);

        let others = warm().filter(|&(c, _)| grid.kinds[c] != AtomKind::Fixed);
        positions.extend(others.map(|(_, x)| *x));
        positions.extend(free.iter().map(|put| put.position));
        kinds.resize(positions.len(), AtomKind::Interior);
        let mut atoms = Atoms { positions, kinds };
        let (distance, observer) = (&around.distance, &mut TokenProgress(patience));
        let rested = relax_atoms(
            &mut atoms,
            &sites,
            &scope.edited_places,
            distance,
            extent,
            seed,
            observer,
        )?;
        let mesh = cut_even_cells(
            &mut atoms,
            &mut sites,
            distance,
            extent,
            grid.weld,
            &mut || !patience.is_cancelled(),
        )?;
        let anew = Self {
            neighbourhood: scope,
            fields: around,
            surface,
            changes: changed,
            preserved: kept,
            mesh,
            sites,
            preserved_atoms: fixed,
            placed_atoms: put,
            free_atoms: free,
            atom_count: atoms.positions.len(),
        };
        Ok((anew, rested.evaluations))
    }

    /// What is new; `None` if it does not fit the rest.
    pub fn patch(&self) -> Option<CellPatch<D>> {
        let Self {
            neighbourhood: scope,
            preserved: kept,
            mesh,
            ..
        } = self;
        let flagged = |flags: &[bool], cells: &[u32]| -> Vec<u32> {
            cells
                .iter()
                .copied()
                .filter(|&c| flags[c as usize])
                .collect()
        };
        let border = flagged(&kept.is_border, &scope.cells);
        // All that changes has to be in the window.
        if border.len() != kept.is_border.iter().filter(|b| **b).count() {
            return None;
        }
        let gone: Vec<bool> = kept.keeps_atom.iter().map(|fixed| !fixed).collect();
        let mut patch = CellPatch {
            removed_nodes: (0..kept.keeps_node.len() as u32)
                .filter(|&n| !kept.keeps_node[n as usize])
                .collect(),
            removed_cells: flagged(&gone, &scope.cells),
            border_cells: border,
            ..CellPatch::default()
        };
        if patch.removed_cells.len() != gone.iter().filter(|g| **g).count() {
            return None;
        }
        patch.new_cells = self.new_cells(&mut patch.edited_atoms);
        self.assign_numbers(&mut patch);
        let mut fitting = NodeMatcher::new(self);
        let marks = self.feature_flags(&patch);
        let horizons = horizon_flags(mesh, &marks, &self.fields.features);
        for f in 0..mesh.face_cells.len() {
            let Some(cells) = self.new_face_cells(f)? else {
                continue;
            };
            if fitting.complete_faces.contains(&cells) {
                continue;
            }
            let ring = fitting.ring(f, &mut patch.new_nodes)?;
            if ring.len() >= D {
                patch.new_faces.push(PatchFace {
                    ring,
                    cells,
                    on_feature: marks[f],
                    on_horizon: horizons.get(f).copied().unwrap_or(false),
                });
            }
        }
        fitting.is_complete().then_some(patch)
    }

    /// The number of a cell of the window: its own if it stays, else behind all of the mesh; or that of a
    /// side of the box.
    fn mesh_cell(&self, c: u32) -> u32 {
        if c >= FIRST_SIDE {
            let side = (c - FIRST_SIDE) as usize;
            return match self.neighbourhood.window.open_sides[side / 2][side % 2] {
                true => OPEN_SIDE,
                false => c,
            };
        }
        match self.preserved_atoms.get(c as usize) {
            Some(&cell) => cell,
            None => {
                (self.neighbourhood.editable.mesh.sites.len() + c as usize
                    - self.preserved_atoms.len()) as u32
            }
        }
    }

    /// The cells of a face if both are new or have new faces; none at all if the window ends too soon.
    fn new_face_cells(&self, face: usize) -> Option<Option<[u32; 2]>> {
        let cells = self.mesh.face_cells[face].map(|c| self.mesh_cell(c));
        let count = self.neighbourhood.editable.mesh.sites.len();
        let wanted = cells.map(|c| match c {
            OPEN_SIDE => false,
            side if side >= FIRST_SIDE => true,
            c => self
                .preserved
                .is_border
                .get(c as usize)
                .copied()
                .unwrap_or(c as usize >= count),
        });
        match wanted {
            [true, true] => Some(Some(cells)),
            [true, false] if cells[1] == OPEN_SIDE => None,
            _ => Some(None),
        }
    }

    /// The new cells.
    fn new_cells(&self, atoms: &mut Vec<(usize, usize)>) -> Vec<NewCell<D>> {
        let Self {
            neighbourhood: scope,
            mesh,
            ..
        } = self;
        let (grid, first) = (scope.editable, self.preserved_atoms.len());
        let fresh = |c: usize| {
            let at = mesh.sites[c];
            let put = self.placed_atoms.get(c - first);
            let gaps = scope
                .sites
                .iter()
                .map(|x| distance2(x, &at))
                .zip(&scope.cells);
            let nearest = gaps.min_by(|a, b| a.0.total_cmp(&b.0));
            NewCell {
                site: scope.window.to_global(at),
                world: put.and_then(|put| put.world),
                kind: put.map_or(AtomKind::Interior, |put| put.kind),
                region: nearest.map_or(0, |(_, &c)| grid.mesh.region[c as usize]),
                distance: self.fields.distance.value_at(at) as f32,
                number: put.and_then(|put| put.number),
            }
        };
        let mut all: Vec<NewCell<D>> = (first..mesh.sites.len()).map(fresh).collect();
        let edits = self.placed_atoms.iter().enumerate();
        atoms.extend(edits.filter_map(|(i, put)| put.edit.map(|edit| (edit, i))));
        for put in &self.free_atoms {
            let gap = |i: &usize| distance2(&mesh.sites[first + i], &put.position);
            let nearest =
                (self.placed_atoms.len()..all.len()).min_by(|i, j| gap(i).total_cmp(&gap(j)));
            let reach = FREE_ATOM_RADIUS * self.fields.distance.value_at(put.position);
            let Some(i) = nearest.filter(|i| gap(i) < reach * reach) else {
                continue;
            };
            all[i].number = put.number;
            atoms.extend(put.edit.map(|edit| (edit, i)));
        }
        all
    }

    /// Atoms that are nearest to where one was that has moved, as this is to them, have its number.
    fn assign_numbers(&self, patch: &mut CellPatch<D>) {
        let taken: BTreeSet<u32> = patch.new_cells.iter().filter_map(|f| f.number).collect();
        let nameless: Vec<usize> = (0..patch.new_cells.len())
            .filter(|&i| patch.new_cells[i].number.is_none())
            .collect();
        let free: Vec<u32> = patch
            .removed_cells
            .iter()
            .copied()
            .filter(|c| !taken.contains(c))
            .collect();
        let old = &self.neighbourhood.editable.mesh.sites;
        let gap = |i: usize, c: u32| distance2(&patch.new_cells[i].site, &old[c as usize]);
        let heir = |c: u32| {
            let heirs = nameless.iter().copied();
            heirs.min_by(|&i, &j| gap(i, c).total_cmp(&gap(j, c)))
        };
        let pairs = free.iter().filter_map(|&c| {
            let i = heir(c)?;
            let back = free.iter().copied();
            let back = back.min_by(|&a, &b| gap(i, a).total_cmp(&gap(i, b)));
            let reach = RENUMBER_RADIUS * f64::from(patch.new_cells[i].distance);
            (back == Some(c) && gap(i, c) < reach * reach).then_some((i, c))
        });
        let pairs: Vec<(usize, u32)> = pairs.collect();
        for (i, c) in pairs {
            patch.new_cells[i].number = Some(c);
        }
    }

    /// Which faces of the window lie on features: those on surfaces, and of those between cells that stay
    /// also those that were, where features have not changed.
    fn feature_flags(&self, patch: &CellPatch<D>) -> Vec<bool> {
        let Self {
            neighbourhood: scope,
            mesh,
            ..
        } = self;
        let grid = scope.editable;
        let count = grid.mesh.sites.len();
        let region = |c: u32| match patch.new_cells.get((c as usize).wrapping_sub(count)) {
            Some(fresh) => fresh.region,
            None => grid.mesh.region[c as usize],
        };
        let mut marks = self.sites.faces_on_surface(mesh, self.atom_count);
        let facets = FacetGrid::new(self.surface);
        for (f, mark) in marks.iter_mut().enumerate() {
            let [a, b] = mesh.face_cells[f];
            if b >= FIRST_SIDE {
                continue;
            }
            let cells = [a, b].map(|c| self.mesh_cell(c));
            let inner = &grid.mesh.face_cells[..grid.mesh.inner_face_count()];
            let [x, y] = [a, b].map(|c| mesh.sites[c as usize]);
            *mark = match inner.binary_search(&cells) {
                _ if grid.has_labels => region(cells[0]) != region(cells[1]),
                Ok(old) if !self.changes.needs_rebuild(&mesh.face_shape(f).centroid) => {
                    grid.mesh.on_feature[old]
                }
                _ => *mark || facets.separates(x, y),
            };
        }
        marks
    }
}

/// How new faces fit the nodes that stay.
struct NodeMatcher<'a, 'b, const D: usize> {
    rebuilt: &'a RebuiltCells<'b, D>,
    /// The cells and sides that meet in each node of the window, by their numbers in the mesh.
    cells_of_nodes: Vec<Vec<u32>>,
    /// Nodes that stay, by what meets there, and by where they are.
    nodes_by_cells: BTreeMap<&'a [u32], Vec<u32>>,
    cell_list: CellList<D>,
    /// The numbers of those.
    node_numbers: Vec<u32>,
    /// The cells of faces of which all nodes stay.
    complete_faces: BTreeSet<[u32; 2]>,
    /// Nodes that stay and have to be met: others of a face of theirs do not.
    required_nodes: BTreeSet<u32>,
    matched_nodes: BTreeSet<u32>,
    /// Numbers of nodes of the window in the mesh, or behind all of it.
    window_numbers: Vec<Option<u32>>,
}

impl<'a, 'b, const D: usize> NodeMatcher<'a, 'b, D>
where
    MeshSpace<D>: Meshing<D>,
{
    fn new(rebuilt: &'a RebuiltCells<'b, D>) -> Self {
        let (grid, kept) = (rebuilt.neighbourhood.editable, rebuilt.preserved);
        let own: Lists = cells_of_nodes(&rebuilt.mesh);
        let numbers = |n: usize| {
            let mut cells: Vec<u32> = own.get(n).iter().map(|&c| rebuilt.mesh_cell(c)).collect();
            cells.sort_unstable();
            cells
        };
        let (mut nodes_by_cells, mut complete_faces, mut required_nodes) =
            (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        for (f, cells) in grid.mesh.face_cells.iter().enumerate() {
            let is_border = |c: u32| {
                kept.is_border
                    .get(c as usize)
                    .copied()
                    .unwrap_or(c >= FIRST_SIDE)
            };
            if !cells.iter().all(|&c| is_border(c)) {
                continue;
            }
            let ring = grid.mesh.faces.get(f).iter().copied();
            let stay: Vec<u32> = ring.filter(|&n| kept.keeps_node[n as usize]).collect();
            if stay.len() == grid.mesh.faces.get(f).len() {
                complete_faces.insert(*cells);
            } else {
                required_nodes.extend(stay);
            }
        }
        let (mut node_numbers, mut positions) = (Vec::new(), Vec::new());
        for n in (0..grid.mesh.nodes.len()).filter(|&n| kept.keeps_node[n]) {
            let cells = grid.cells_of_nodes.get(n);
            let at_border = |&c: &u32| kept.is_border.get(c as usize).copied().unwrap_or(false);
            if cells.iter().any(at_border) {
                nodes_by_cells
                    .entry(cells)
                    .or_insert_with(Vec::new)
                    .push(n as u32);
                node_numbers.push(n as u32);
                positions.push(rebuilt.neighbourhood.window.to_local(grid.mesh.nodes[n]));
            }
        }
        Self {
            cells_of_nodes: (0..rebuilt.mesh.nodes.len()).map(numbers).collect(),
            window_numbers: vec![None; rebuilt.mesh.nodes.len()],
            matched_nodes: BTreeSet::new(),
            cell_list: CellList::new(&positions, NODE_TOLERANCE * rebuilt.fields.distance.max()),
            node_numbers,
            rebuilt,
            nodes_by_cells,
            complete_faces,
            required_nodes,
        }
    }

    /// The nodes of a face of the window; `None` if one is too far from every edit.
    fn ring(&mut self, face: usize, nodes: &mut Vec<[f64; D]>) -> Option<Vec<u32>> {
        let anew = self.rebuilt;
        let own = anew.mesh.faces.get(face);
        let mut ring: Vec<u32> = Vec::with_capacity(own.len());
        for &n in own {
            let number = match self.window_numbers[n as usize] {
                Some(number) => number,
                None => self.find_node(n as usize, nodes)?,
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

    /// The node that stays where the window has one, or else a new one.
    fn find_node(&mut self, n: usize, nodes: &mut Vec<[f64; D]>) -> Option<u32> {
        let RebuiltCells {
            neighbourhood: scope,
            mesh,
            ..
        } = self.rebuilt;
        let x = mesh.nodes[n];
        let gap = |&m: &u32| {
            let old = scope.window.to_local(scope.editable.mesh.nodes[m as usize]);
            distance2(&old, &x)
        };
        let cells = self.cells_of_nodes[n].as_slice();
        let mut near: Vec<u32> = self.nodes_by_cells.get(cells).cloned().unwrap_or_default();
        if near.is_empty() {
            let reach = NODE_TOLERANCE * self.rebuilt.fields.distance.value_at(x);
            self.cell_list
                .visit_within(x, reach, |i| near.push(self.node_numbers[i]));
            near.retain(|m| gap(m) < reach * reach);
        }
        let found = near.into_iter().min_by(|a, b| gap(a).total_cmp(&gap(b)));
        if let Some(m) = found {
            self.matched_nodes.insert(m);
            return Some(m);
        }
        // Whatever is as near as its own atoms has to be within reach.
        let own = cells
            .iter()
            .filter(|&&c| c < FIRST_SIDE)
            .map(|&c| self.site(c));
        let own = own.map(|y| distance2(&y, &x).sqrt());
        let radius = own.fold(f64::INFINITY, f64::min);
        let mut edited = scope.edited_places.iter();
        let is_known = edited.any(|(y, d)| distance2(y, &x).sqrt() + radius < INFLUENCE_RADIUS * d);
        if !is_known || relative_distance(&x, &scope.edited_places) > EDIT_RADIUS {
            return None;
        }
        nodes.push(scope.window.to_global(x));
        Some((scope.editable.mesh.nodes.len() + nodes.len() - 1) as u32)
    }

    /// Where the atom of a cell is in the window.
    fn site(&self, cell: u32) -> [f64; D] {
        let RebuiltCells {
            neighbourhood: scope,
            mesh,
            preserved_atoms: fixed,
            ..
        } = self.rebuilt;
        let old = &scope.editable.mesh.sites;
        match old.get(cell as usize) {
            Some(&x) => scope.window.to_local(x),
            None => mesh.sites[cell as usize - old.len() + fixed.len()],
        }
    }

    /// Whether all nodes that stay have been met.
    fn is_complete(&self) -> bool {
        self.required_nodes.is_subset(&self.matched_nodes)
    }
}
