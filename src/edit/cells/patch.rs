//! The neighbourhood of an edit of Voronoi cells, and the patch that replaces its cells.

use super::editable_cells::EditableCells;
use super::preserved::{FeatureChanges, PreservedParts};
use super::rebuilt::{RebuildScope, RebuiltCells};
use super::target_position;
use crate::edit::local_fields::{Context, LocalFields};
use crate::edit::neighbourhood::{INSERT_CLEARANCE, REUSE_RADIUS, SHIFT_CLEARANCE};
use crate::edit::resolve::{Action, EditGroup, INFLUENCE_RADIUS};
use crate::edit::window::EditWindow;
use crate::edit::{Summary, spacing};
use crate::error::cause;
use crate::geometry::distance2;
use crate::job::JoinAtoms;
use crate::job::cells::feature_surface_in_box;
use crate::lattice::AtomKind;
use crate::lattice::optimise::temperature::relative_distance;
use crate::mesh::voronoi::conform::FacetSurface;
use crate::mesh::{Dimension, Space};
use crate::progress::{CancelToken, TokenProgress};
use crate::{Error, Result};

/// Distances from every edit, in units of d, beyond which nodes stay, in the order in which they
/// are tried. New nodes must be within five d; if one is farther, the next smaller distance is
/// tried.
const REBUILD_RANGES: [f64; 4] = [4.4, 4.0, 3.5, 3.0];
/// Sites nearer than this to a side of the window, relative to its extent, do not belong to it.
const WINDOW_MARGIN_RATIO: f64 = 1e-9;

/// A neighbourhood: the part of the lattice and of the image around a group of edits.
pub struct CellNeighbourhood<'a, const D: usize> {
    pub editable: &'a EditableCells<D>,
    group: EditGroup<D>,
    pub window: EditWindow<D>,
    /// Edited positions in the window, each with d there.
    pub edited_places: Vec<([f64; D], f64)>,
    /// Cells whose sites are in the window and within the influence radius, ascending; `sites`
    /// holds their positions in the window.
    pub cells: Vec<u32>,
    pub sites: Vec<[f64; D]>,
}

/// An atom that an edit puts at a position.
#[derive(Debug, Clone, Copy)]
pub struct PlacedAtom<const D: usize> {
    /// Position in the window.
    pub position: [f64; D],
    pub kind: AtomKind,
    /// Exact physical position, if it must not be rounded.
    pub world: Option<[f64; D]>,
    /// Number that the atom is to have.
    pub number: Option<u32>,
    pub edit: Option<usize>,
}

/// A new cell.
#[derive(Debug, Clone, PartialEq)]
pub struct NewCell<const D: usize> {
    /// Site in lattice space.
    pub site: [f64; D],
    /// Exact physical position of the site, if it must not be rounded.
    pub world: Option<[f64; D]>,
    pub kind: AtomKind,
    pub region: i32,
    pub distance: f32,
    /// Number that the cell is to have.
    pub number: Option<u32>,
}

/// A new face. Node and cell numbers are those of the mesh; nodes and cells of the patch are
/// numbered after all of the mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchFace {
    pub ring: Vec<u32>,
    pub cells: [u32; 2],
    pub on_feature: bool,
    pub on_horizon: bool,
}

/// The changes of a mesh around an edit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellPatch<const D: usize> {
    /// Nodes to remove. Faces that have one of these nodes are removed, too.
    pub removed_nodes: Vec<u32>,
    /// Cells to remove.
    pub removed_cells: Vec<u32>,
    /// Cells that stay but get new faces.
    pub border_cells: Vec<u32>,
    /// New nodes in lattice space.
    pub new_nodes: Vec<[f64; D]>,
    pub new_cells: Vec<NewCell<D>>,
    pub new_faces: Vec<PatchFace>,
    /// Pairs of an edit's index and the index of its atom in `new_cells`.
    pub edited_atoms: Vec<(usize, usize)>,
}

impl<'a, const D: usize> CellNeighbourhood<'a, D>
where
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    /// Finds the neighbourhood of a group of steps.
    pub fn new(
        editable: &'a EditableCells<D>,
        group: EditGroup<D>,
        context: &Context<'_, D>,
    ) -> Self {
        let (step, extent) = (editable.space.step, editable.space.extent);
        let window = group.window(&[], context, step, extent);
        let to_window = |&(x, d): &([f64; D], f64)| (window.to_local(x), d);
        let edited_places: Vec<([f64; D], f64)> =
            group.edited_places.iter().map(to_window).collect();
        let is_inside = |x: [f64; D]| {
            let is_within = |k: usize| {
                let side_margin = WINDOW_MARGIN_RATIO * window.extent()[k];
                x[k] > side_margin && x[k] < window.extent()[k] - side_margin
            };
            relative_distance(&x, &edited_places) < INFLUENCE_RADIUS && (0..D).all(is_within)
        };
        let sites = editable.mesh.sites.iter().map(|&x| window.to_local(x));
        let inner = sites.enumerate().filter(|&(_, x)| is_inside(x));
        let (cells, sites) = inner.map(|(c, x)| (c as u32, x)).unzip();
        Self {
            editable,
            edited_places,
            group,
            window,
            cells,
            sites,
        }
    }

    /// Computes the features, the nominal distance and the weight of the image in the window.
    ///
    /// # Errors
    /// Returns the errors of feature detection and of the triangulation of the atoms.
    pub fn local_fields(
        &self,
        context: &Context<'_, D>,
        cancel: &CancelToken<'_>,
    ) -> Result<LocalFields<D>> {
        LocalFields::detect(
            &self.window,
            self.editable.space.step,
            context,
            cancel,
            || {
                let extent = self.window.extent();
                let d = self
                    .cells
                    .iter()
                    .map(|&c| f64::from(self.editable.distance[c as usize]));
                let d: Vec<f64> = d.collect();
                let mesh = Space::<D>::delaunay(&self.sites)?;
                Ok(spacing::distance_from_nodes(&mesh, &d, extent))
            },
        )
    }

    /// Returns the surfaces of the features in the window.
    ///
    /// # Errors
    /// Returns the errors of seeding and of the triangulation.
    pub fn surface(
        &self,
        fields: &LocalFields<D>,
        context: &Context<'_, D>,
        cancel: &CancelToken<'_>,
    ) -> Result<FacetSurface<D>> {
        feature_surface_in_box(
            context.params,
            &fields.distance,
            &fields.features,
            self.editable.space.step,
            self.window.extent(),
            fields.beta.clone(),
            &mut TokenProgress(cancel),
        )
    }

    /// Rebuilds the cells of the neighbourhood and returns the patch that replaces them.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if the new cells do not fit the others, and the errors of optimiser
    /// and triangulation.
    pub fn patch(
        &self,
        fields: &LocalFields<D>,
        surface: &FacetSurface<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        cancel: &CancelToken<'_>,
    ) -> Result<CellPatch<D>> {
        let mut is_removed = vec![false; self.editable.mesh.sites.len()];
        let placed_atoms = self.apply_steps(fields, context, &mut is_removed, summary);
        let step = self.editable.space.step;
        let sample = step.iter().copied().fold(0.0, f64::max);
        for range in REBUILD_RANGES {
            let changes = FeatureChanges::new(self, surface, &is_removed, range, sample, |x| {
                fields.distance.value_at(x)
            });
            let new_sites: Vec<[f64; D]> = placed_atoms.iter().map(|atom| atom.position).collect();
            let preserved = PreservedParts::new(self, &changes, &is_removed, &new_sites, range);
            let scope = RebuildScope {
                surface,
                changes: &changes,
                preserved: &preserved,
                range,
                is_removed: &is_removed,
            };
            let seed = context.params.spec().rng_seed;
            let (rebuilt, evaluations) =
                RebuiltCells::new(self, fields, scope, &placed_atoms, seed, cancel)?;
            summary.evaluations += evaluations;

            if cancel.is_cancelled() {
                return Ok(CellPatch::default());
            }
            if let Some(patch) = rebuilt.patch() {
                summary.cells[0] += patch.removed_cells.len() + patch.border_cells.len();
                summary.cells[1] += patch.new_cells.len() + patch.border_cells.len();
                summary.movable_atoms += patch.removed_cells.len();
                return Ok(patch);
            }
        }
        let names = self.group.steps.iter();
        let name = names.map(|step| context.edits[step.edit].name.as_str());
        Err(Error::Mesh(cause(
            name.collect::<Vec<_>>().join(", "),
            "would change cells farther away than 5 times the distance between atoms",
            "give a place farther from the sides and from other fixed atoms, or mesh the image again",
        )))
    }

    /// Applies the steps: marks removed atoms, and those too near to inserted ones, in
    /// `is_removed`, and returns the inserted and shifted atoms.
    fn apply_steps(
        &self,
        fields: &LocalFields<D>,
        context: &Context<'_, D>,
        is_removed: &mut [bool],
        summary: &mut Summary,
    ) -> Vec<PlacedAtom<D>> {
        let (editable, steps) = (self.editable, &self.group.steps);
        for step in steps {
            if let Action::Remove { node } | Action::Shift { node, .. } = step.action {
                is_removed[node as usize] = true;
            }
        }
        let mut at_feature = vec![false; is_removed.len()];
        for f in (0..editable.mesh.inner_face_count()).filter(|&f| editable.mesh.on_feature[f]) {
            for c in editable.mesh.face_cells[f] {
                at_feature[c as usize] = true;
            }
        }
        let mut placed_atoms = Vec::new();
        for step in steps {
            let (target, mut number, clearance) = match step.action {
                Action::Remove { .. } => continue,
                Action::Insert { target, number } => (target, number, INSERT_CLEARANCE),
                Action::Shift { node, target } => (target, Some(node), SHIFT_CLEARANCE),
            };
            let position = self.window.to_local(target);
            let mut nearest = REUSE_RADIUS;
            for (&c, x) in self.cells.iter().zip(&self.sites) {
                let c = c as usize;
                let distance_ratio =
                    distance2(x, &position).sqrt() / fields.distance.value_at(position);
                // Sites on either side of a feature are near to each other by construction.
                let clearance = if at_feature[c] {
                    REUSE_RADIUS
                } else {
                    clearance
                };
                if distance_ratio >= clearance
                    || is_removed[c]
                    || editable.kinds[c] == AtomKind::Fixed
                {
                    continue;
                }
                is_removed[c] = true;
                let may_reuse = matches!(step.action, Action::Insert { number: None, .. });
                if may_reuse && distance_ratio < nearest {
                    nearest = distance_ratio;
                    number = Some(c as u32);
                } else {
                    summary.removed_neighbours += 1;
                }
            }
            placed_atoms.push(PlacedAtom {
                position,
                kind: step.kind,
                world: target_position(&context.edits[step.edit])
                    .filter(|_| step.kind == AtomKind::Fixed),
                number,
                edit: Some(step.edit),
            });
        }
        placed_atoms
    }
}
