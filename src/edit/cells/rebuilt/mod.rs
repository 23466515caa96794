//! New Voronoi cells around an edit, which fit the cells that stay.

mod node_matcher;

use std::collections::BTreeSet;

use super::patch::{CellNeighbourhood, CellPatch, NewCell, PatchFace, PlacedAtom};
use super::preserved::{FeatureChanges, PreservedParts};
use crate::Result;
use crate::edit::local_fields::LocalFields;
use crate::edit::resolve::INFLUENCE_RADIUS;
use crate::geometry::{add_scaled, distance2};
use crate::job::StageRunner;
use crate::job::cells::{RelaxOptions, cut_even_cells, relax_atoms};
use crate::job::horizons::horizon_flags;
use crate::lattice::AtomKind;
use crate::lattice::optimise::temperature::relative_distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::mesh::voronoi::conform::{ConformingSites, FacetGrid, FacetSurface, SiteRegion};
use crate::mesh::{Dimension, Space};
use crate::progress::{CancelToken, TokenProgress};
use node_matcher::NodeMatcher;

/// Radius, in units of d, within which the atom of a free edit is searched around its initial
/// position.
const FREE_ATOM_RADIUS: f64 = 1.0;
/// Radius, in units of d, within which a new atom takes the number of a removed one.
const RENUMBER_RADIUS: f64 = 0.6;
/// Number of a side of the window at which the image continues.
const OPEN_SIDE: u32 = u32::MAX;

/// The parts of a neighbourhood that are rebuilt, and those that stay.
#[derive(Clone, Copy)]
pub struct RebuildScope<'a, const D: usize> {
    /// The present surface of the features.
    pub surface: &'a FacetSurface<D>,
    /// Where faces no longer fit the features.
    pub changes: &'a FeatureChanges<D>,
    pub preserved: &'a PreservedParts,
    /// Distance from the edited places, in units of d, within which nodes are rebuilt.
    pub range: f64,
    /// `true` for each cell of the mesh whose atom is removed.
    pub is_removed: &'a [bool],
}

/// New cells around an edit, together with the cells around them.
pub struct RebuiltCells<'a, const D: usize> {
    neighbourhood: &'a CellNeighbourhood<'a, D>,
    fields: &'a LocalFields<D>,
    surface: &'a FacetSurface<D>,
    changes: &'a FeatureChanges<D>,
    preserved: &'a PreservedParts,
    /// The cells of the window, in this order: cells of preserved atoms, of placed atoms, of all
    /// other atoms, and of the sites along features.
    mesh: PolyMesh<D>,
    sites: ConformingSites<D>,
    /// Cell numbers of the atoms that stay.
    preserved_atoms: Vec<u32>,
    placed_atoms: Vec<PlacedAtom<D>>,
    /// Atoms that were inserted and then moved.
    free_atoms: Vec<PlacedAtom<D>>,
    /// Number of atoms, without the sites along features.
    atom_count: usize,
}

/// Returns the region in which sites along features are placed: within `range` of the edited places,
/// and not in the empty balls around nodes that are preserved.
fn site_region<const D: usize>(
    neighbourhood: &CellNeighbourhood<'_, D>,
    preserved: &PreservedParts,
    range: f64,
) -> SiteRegion<D> {
    let editable = neighbourhood.editable;
    let empty_balls = (0..preserved.keeps_node.len())
        .filter(|&n| preserved.keeps_node[n])
        .filter_map(|n| {
            let x = neighbourhood.window.to_local(editable.mesh.nodes[n]);
            let within = relative_distance(&x, &neighbourhood.edited_places) < INFLUENCE_RADIUS;
            let cell = *editable.cells_of_nodes.get(n).first()?;
            let site = neighbourhood
                .window
                .to_local(editable.mesh.sites[cell as usize]);
            within.then(|| (x, distance2(&x, &site).sqrt()))
        });
    let edit_balls = neighbourhood
        .edited_places
        .iter()
        .map(|&(x, d)| (x, range * d));
    SiteRegion::new(edit_balls.collect(), empty_balls.collect())
}

impl<'a, const D: usize> RebuiltCells<'a, D> {
    /// Moves atoms to a minimum of the energy around the preserved parts and the changed parts of
    /// the surface, and cuts their cells. Also returns the number of evaluations of the energy.
    ///
    /// # Errors
    /// Returns the errors of optimiser and triangulation.
    pub fn new(
        neighbourhood: &'a CellNeighbourhood<'a, D>,
        fields: &'a LocalFields<D>,
        RebuildScope {
            surface,
            changes,
            preserved,
            range,
            is_removed,
        }: RebuildScope<'a, D>,
        placed: &[PlacedAtom<D>],
        seed: u64,
        cancel: &CancelToken<'_>,
    ) -> Result<(Self, usize)>
    where
        Space<D>: Dimension<D>,
    {
        let (editable, extent) = (neighbourhood.editable, neighbourhood.window.extent());
        let cells = || {
            neighbourhood
                .cells
                .iter()
                .map(|&c| c as usize)
                .zip(&neighbourhood.sites)
        };
        let preserved_cells = cells().filter(|&(c, _)| preserved.keeps_atom[c]);
        let (preserved_atoms, mut positions): (Vec<u32>, Vec<[f64; D]>) =
            preserved_cells.map(|(c, x)| (c as u32, *x)).unzip();
        let warm_cells = || cells().filter(|&(c, _)| !preserved.keeps_atom[c] && !is_removed[c]);
        // Wells stay in place even if their cells change.
        let wells = warm_cells().filter(|&(c, _)| editable.kinds[c] == AtomKind::Fixed);
        let mut placed_atoms: Vec<PlacedAtom<D>> = wells
            .map(|(c, &position)| PlacedAtom {
                position,
                kind: AtomKind::Fixed,
                world: Some(editable.world.sites[c]),
                number: Some(c as u32),
                edit: None,
            })
            .collect();
        let (fixed_atoms, free_atoms): (Vec<PlacedAtom<D>>, Vec<PlacedAtom<D>>) =
            placed.iter().partition(|atom| atom.kind == AtomKind::Fixed);
        placed_atoms.extend(fixed_atoms);
        positions.extend(placed_atoms.iter().map(|atom| atom.position));
        let mut kinds = vec![AtomKind::Fixed; positions.len()];

        let region = site_region(neighbourhood, preserved, range);
        let changed_surface = surface.subset(|f| {
            let corners = surface.corners(f);
            let weight = 1.0 / D as f64;
            let centroid = corners
                .iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, weight, x));
            changes.needs_rebuild(&centroid)
        });
        let mut sites = ConformingSites::with_region(changed_surface, extent, &positions, region);

        let interior = warm_cells().filter(|&(c, _)| editable.kinds[c] != AtomKind::Fixed);
        positions.extend(interior.map(|(_, x)| *x));
        positions.extend(free_atoms.iter().map(|atom| atom.position));
        kinds.resize(positions.len(), AtomKind::Interior);
        let mut atoms = Atoms { positions, kinds };
        let (distance, progress) = (&fields.distance, &mut TokenProgress(cancel));
        let stages = &mut StageRunner::new(progress);
        let relaxed = relax_atoms(
            &mut atoms,
            &sites,
            distance,
            extent,
            RelaxOptions {
                edited: &neighbourhood.edited_places,
                seed,
            },
            stages,
        )?;
        let weld = editable.weld;
        let mesh = cut_even_cells(&mut atoms, &mut sites, distance, extent, weld, stages)?;
        let rebuilt = Self {
            neighbourhood,
            fields,
            surface,
            changes,
            preserved,
            mesh,
            sites,
            preserved_atoms,
            placed_atoms,
            free_atoms,
            atom_count: atoms.positions.len(),
        };
        Ok((rebuilt, relaxed.evaluations))
    }

    /// Returns the patch of the new cells, or `None` if they do not fit the rest of the mesh.
    pub fn patch(&self) -> Option<CellPatch<D>> {
        let Self {
            neighbourhood,
            preserved,
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
        let border_cells = flagged(&preserved.is_border, &neighbourhood.cells);
        // All changes must lie in the window.
        if border_cells.len() != preserved.is_border.iter().filter(|b| **b).count() {
            return None;
        }
        let is_removed: Vec<bool> = preserved.keeps_atom.iter().map(|fixed| !fixed).collect();
        let mut patch = CellPatch {
            removed_nodes: (0..preserved.keeps_node.len() as u32)
                .filter(|&n| !preserved.keeps_node[n as usize])
                .collect(),
            removed_cells: flagged(&is_removed, &neighbourhood.cells),
            border_cells,
            ..CellPatch::default()
        };
        if patch.removed_cells.len() != is_removed.iter().filter(|g| **g).count() {
            return None;
        }
        patch.new_cells = self.new_cells(&mut patch.edited_atoms);
        self.assign_numbers(&mut patch);
        let mut matcher = NodeMatcher::new(self);
        let on_feature = self.feature_flags(&patch);
        let horizons = horizon_flags(mesh, &on_feature, &[], &self.fields.features);
        for f in 0..mesh.face_cells.len() {
            let Some(cells) = self.new_face_cells(f)? else {
                continue;
            };
            if matcher.complete_faces.contains(&cells) {
                continue;
            }
            let ring = matcher.ring(f, &mut patch.new_nodes)?;
            if ring.len() >= D {
                patch.new_faces.push(PatchFace {
                    ring,
                    cells,
                    on_feature: on_feature[f],
                    on_horizon: horizons.get(f).copied().unwrap_or(false),
                });
            }
        }
        matcher.is_complete().then_some(patch)
    }

    /// Returns the number in the mesh of a cell of the window: the cell's own number if it stays,
    /// or else a number after all cells of the mesh. Returns sides of the box unchanged.
    fn mesh_cell(&self, c: u32) -> u32 {
        if c >= FIRST_SIDE {
            let side = (c - FIRST_SIDE) as usize;
            return if self.neighbourhood.window.open_sides[side / 2][side % 2] {
                OPEN_SIDE
            } else {
                c
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

    /// Returns the cells of a face if both are new or get new faces, and `Some(None)` if they do
    /// not. Returns `None` if the face lies on an open side of the window, so that the window is
    /// too small.
    fn new_face_cells(&self, face: usize) -> Option<Option<[u32; 2]>> {
        let cells = self.mesh.face_cells[face].map(|c| self.mesh_cell(c));
        let count = self.neighbourhood.editable.mesh.sites.len();
        let is_new = cells.map(|c| match c {
            OPEN_SIDE => false,
            side if side >= FIRST_SIDE => true,
            c => self
                .preserved
                .is_border
                .get(c as usize)
                .copied()
                .unwrap_or(c as usize >= count),
        });
        match is_new {
            [true, true] => Some(Some(cells)),
            [true, false] if cells[1] == OPEN_SIDE => None,
            _ => Some(None),
        }
    }

    /// Returns the new cells, and appends the edited atoms among them to `edited_atoms`.
    fn new_cells(&self, edited_atoms: &mut Vec<(usize, usize)>) -> Vec<NewCell<D>> {
        let Self {
            neighbourhood,
            mesh,
            ..
        } = self;
        let (editable, preserved_count) = (neighbourhood.editable, self.preserved_atoms.len());
        let new_cell = |c: usize| {
            let site = mesh.sites[c];
            let atom = self.placed_atoms.get(c - preserved_count);
            let distances2 = neighbourhood
                .sites
                .iter()
                .map(|x| distance2(x, &site))
                .zip(&neighbourhood.cells);
            let nearest = distances2.min_by(|a, b| a.0.total_cmp(&b.0));
            NewCell {
                site: neighbourhood.window.to_global(site),
                world: atom.and_then(|atom| atom.world),
                kind: atom.map_or(AtomKind::Interior, |atom| atom.kind),
                region: nearest.map_or(0, |(_, &c)| editable.mesh.region[c as usize]),
                distance: self.fields.distance.value_at(site) as f32,
                number: atom.and_then(|atom| atom.number),
            }
        };
        let mut cells: Vec<NewCell<D>> =
            (preserved_count..mesh.sites.len()).map(new_cell).collect();
        let edits = self.placed_atoms.iter().enumerate();
        edited_atoms.extend(edits.filter_map(|(i, atom)| atom.edit.map(|edit| (edit, i))));
        for atom in &self.free_atoms {
            let distance2_to =
                |i: &usize| distance2(&mesh.sites[preserved_count + i], &atom.position);
            let nearest = (self.placed_atoms.len()..cells.len())
                .min_by(|i, j| distance2_to(i).total_cmp(&distance2_to(j)));
            let reach = FREE_ATOM_RADIUS * self.fields.distance.value_at(atom.position);
            let Some(i) = nearest.filter(|i| distance2_to(i) < reach * reach) else {
                continue;
            };
            cells[i].number = atom.number;
            edited_atoms.extend(atom.edit.map(|edit| (edit, i)));
        }
        cells
    }

    /// Gives the number of a removed cell to a new cell without a number, if each of the two is the
    /// nearest of the other and both are close enough.
    fn assign_numbers(&self, patch: &mut CellPatch<D>) {
        let used_numbers: BTreeSet<u32> = patch.new_cells.iter().filter_map(|f| f.number).collect();
        let unnumbered: Vec<usize> = (0..patch.new_cells.len())
            .filter(|&i| patch.new_cells[i].number.is_none())
            .collect();
        let free_numbers: Vec<u32> = patch
            .removed_cells
            .iter()
            .copied()
            .filter(|c| !used_numbers.contains(c))
            .collect();
        let old_sites = &self.neighbourhood.editable.mesh.sites;
        let distance2_between =
            |i: usize, c: u32| distance2(&patch.new_cells[i].site, &old_sites[c as usize]);
        let nearest_cell = |c: u32| {
            let candidates = unnumbered.iter().copied();
            candidates.min_by(|&i, &j| distance2_between(i, c).total_cmp(&distance2_between(j, c)))
        };
        let pairs = free_numbers.iter().filter_map(|&c| {
            let i = nearest_cell(c)?;
            let nearest_number = free_numbers.iter().copied();
            let nearest_number = nearest_number
                .min_by(|&a, &b| distance2_between(i, a).total_cmp(&distance2_between(i, b)));
            let reach = RENUMBER_RADIUS * f64::from(patch.new_cells[i].distance);
            (nearest_number == Some(c) && distance2_between(i, c) < reach * reach).then_some((i, c))
        });
        let pairs: Vec<(usize, u32)> = pairs.collect();
        for (i, c) in pairs {
            patch.new_cells[i].number = Some(c);
        }
    }

    /// Returns, for each face of the window, `true` if it lies on a feature. With labels, these are
    /// the faces between different regions. Otherwise they are the faces on surfaces, and the faces
    /// between preserved cells that were on features and where features have not changed.
    fn feature_flags(&self, patch: &CellPatch<D>) -> Vec<bool> {
        let Self {
            neighbourhood,
            mesh,
            ..
        } = self;
        let editable = neighbourhood.editable;
        let count = editable.mesh.sites.len();
        let region = |c: u32| match patch.new_cells.get((c as usize).wrapping_sub(count)) {
            Some(new_cell) => new_cell.region,
            None => editable.mesh.region[c as usize],
        };
        let mut flags = self.sites.faces_on_surface(mesh, self.atom_count);
        let facet_grid = FacetGrid::new(self.surface);
        for (f, flag) in flags.iter_mut().enumerate() {
            let [a, b] = mesh.face_cells[f];
            if b >= FIRST_SIDE {
                continue;
            }
            let cells = [a, b].map(|c| self.mesh_cell(c));
            let inner_faces = &editable.mesh.face_cells[..editable.mesh.inner_face_count()];
            let [x, y] = [a, b].map(|c| mesh.sites[c as usize]);
            *flag = match inner_faces.binary_search(&cells) {
                _ if editable.has_labels => region(cells[0]) != region(cells[1]),
                Ok(old) if !self.changes.needs_rebuild(&mesh.face_shape(f).centroid) => {
                    editable.mesh.on_feature[old]
                }
                _ => *flag || facet_grid.separates(x, y),
            };
        }
        flags
    }
}
