//! The cells round an edit made anew.

use super::editable_cells::EditableCells;
use super::preserved::{FeatureChanges, PreservedParts};
use super::rebuilt::RebuiltCells;
use super::target_position;
use crate::error::cause;
use crate::feature::resolved::detection_reach;
use crate::feature::{DetectionOptions, Features};
use crate::geometry::distance2;
use crate::job::cells::feature_surface_in_box;
use crate::job::{MeshScene, MeshSpace, Meshing, StageRunner};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::optimize::temperature::relative_distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::voronoi::conform::FacetSurface;
use crate::model::edit::local_fields::{Context, LocalFields};
use crate::model::edit::neighbourhood::{INSERT_CLEARANCE, REUSE_RADIUS, SHIFT_CLEARANCE};
use crate::model::edit::resolve::{Action, EditGroup, INFLUENCE_RADIUS};
use crate::model::edit::window::EditWindow;
use crate::model::edit::{Summary, spacing};
use crate::progress::{CancelToken, TokenProgress};
use crate::{Error, Result};

/// Nodes as far as this from every edit, in units of d, stay: new ones are then within five d. Should one be
/// farther, less is made anew.
const REBUILD_RANGES: [f64; 4] = [4.4, 4.0, 3.5, 3.0];
/// Sites nearer to a side of the window than this share of it are not in it.
const WINDOW_MARGIN_RATIO: f64 = 1e-9;

/// A neighbourhood: the part of the lattice and of the image round some edits.
pub struct CellNeighbourhood<'a, const D: usize> {
    pub editable: &'a EditableCells<D>,
    group: EditGroup<D>,
    pub window: EditWindow<D>,
    /// The edited places in the window.
    pub edited_places: Vec<([f64; D], f64)>,
    /// The cells whose sites are in the window and within reach, ascending, and these sites there.
    pub cells: Vec<u32>,
    pub sites: Vec<[f64; D]>,
}

/// An atom that is put somewhere.
#[derive(Debug, Clone, Copy)]
pub struct PlacedAtom<const D: usize> {
    /// In the window.
    pub position: [f64; D],
    pub kind: AtomKind,
    /// Where it is in the world to the last digit.
    pub world: Option<[f64; D]>,
    /// The number that it shall have.
    pub number: Option<u32>,
    pub edit: Option<usize>,
}

/// A new cell.
#[derive(Debug, Clone, PartialEq)]
pub struct NewCell<const D: usize> {
    /// In lattice space.
    pub site: [f64; D],
    /// In the world, if that is known to the last digit.
    pub world: Option<[f64; D]>,
    pub kind: AtomKind,
    pub region: i32,
    pub distance: f32,
    /// The number that it shall have.
    pub number: Option<u32>,
}

/// A new face. Nodes and cells are those of the mesh, and behind these those of the patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchFace {
    pub ring: Vec<u32>,
    pub cells: [u32; 2],
    pub on_feature: bool,
    pub on_horizon: bool,
}

/// What is new round an edit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellPatch<const D: usize> {
    /// The nodes that go; faces that have one go, too.
    pub removed_nodes: Vec<u32>,
    /// The cells that go.
    pub removed_cells: Vec<u32>,
    /// The cells that stay, but have new faces.
    pub border_cells: Vec<u32>,
    /// New nodes in lattice space.
    pub new_nodes: Vec<[f64; D]>,
    pub new_cells: Vec<NewCell<D>>,
    pub new_faces: Vec<PatchFace>,
    /// For edits whose atom is among the new cells, its place there.
    pub edited_atoms: Vec<(usize, usize)>,
}

impl<'a, const D: usize> CellNeighbourhood<'a, D>
where
    MeshSpace<D>: Meshing<D>,
{
    /// Finds the neighbourhood of a group of steps.
    pub fn new(
        editable: &'a EditableCells<D>,
        group: EditGroup<D>,
        context: &Context<'_, D>,
    ) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; D], [0.0f64; D]);
        for (x, d) in &group.edited_places {
            for k in 0..D {
                low[k] = low[k].min(x[k] - INFLUENCE_RADIUS * d);
                high[k] = high[k].max(x[k] + INFLUENCE_RADIUS * d);
            }
        }
        let (margin, dims) = (
            detection_reach::<D>(context.resolved_options),
            context.image.dims(),
        );
        let (step, extent) = (editable.space.step, editable.space.extent);
        let window = EditWindow::from_bounds(low, high, margin, dims, step, extent);
        let local = |&(x, d): &([f64; D], f64)| (window.to_local(x), d);
        let edited_places: Vec<([f64; D], f64)> = group.edited_places.iter().map(local).collect();
        let inside = |x: [f64; D]| {
            let is_in = |k: usize| {
                let room = WINDOW_MARGIN_RATIO * window.extent()[k];
                x[k] > room && x[k] < window.extent()[k] - room
            };
            relative_distance(&x, &edited_places) < INFLUENCE_RADIUS && (0..D).all(is_in)
        };
        let sites = editable.mesh.sites.iter().map(|&x| window.to_local(x));
        let inner = sites.enumerate().filter(|&(_, x)| inside(x));
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

    /// Looks at what is there.
    ///
    /// # Errors
    /// Those of feature detection, and of the triangulation of the atoms.
    pub fn local_fields(
        &self,
        context: &Context<'_, D>,
        patience: &CancelToken<'_>,
    ) -> Result<LocalFields<D>> {
        LocalFields::detect(
            &self.window,
            self.editable.space.step,
            context,
            patience,
            || {
                let extent = self.window.extent();
                let d = self
                    .cells
                    .iter()
                    .map(|&c| f64::from(self.editable.distance[c as usize]));
                let d: Vec<f64> = d.collect();
                let atoms = Atoms {
                    kinds: vec![AtomKind::Interior; self.sites.len()],
                    positions: self.sites.clone(),
                };
                let scene = MeshScene {
                    extent,
                    features: &Features::empty(self.window.dims, &DetectionOptions::default()),
                    distance: &Distance::Constant(d.iter().copied().fold(f64::INFINITY, f64::min)),
                };
                let observer = &mut TokenProgress(patience);
                let joined = MeshSpace::<D>::join(
                    atoms,
                    &scene,
                    None,
                    None,
                    &mut StageRunner::new(observer),
                )?;
                Ok(spacing::distance_from_nodes(
                    &joined.annotated_mesh.mesh,
                    &d,
                    extent,
                ))
            },
        )
    }

    /// The surfaces of the features there.
    ///
    /// # Errors
    /// Those of seeding and of the triangulation.
    pub fn surface(
        &self,
        around: &LocalFields<D>,
        context: &Context<'_, D>,
        patience: &CancelToken<'_>,
    ) -> Result<FacetSurface<D>> {
        feature_surface_in_box(
            context.params,
            &around.distance,
            &around.features,
            (self.editable.space.step, self.window.extent()),
            around.beta.clone(),
            &mut TokenProgress(patience),
        )
    }

    /// Makes the cells anew.
    ///
    /// # Errors
    /// [`Error::Mesh`] if they do not fit the others; those of optimiser and triangulation.
    pub fn patch(
        &self,
        around: &LocalFields<D>,
        surface: &FacetSurface<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        patience: &CancelToken<'_>,
    ) -> Result<CellPatch<D>> {
        let mut gone = vec![false; self.editable.mesh.sites.len()];
        let puts = self.apply_steps(around, context, &mut gone, summary);
        let step = self.editable.space.step;
        let sample = step.iter().copied().fold(0.0, f64::max);
        for range in REBUILD_RANGES {
            let reach = (self.edited_places.as_slice(), range);
            let changed = FeatureChanges::new(
                self.editable,
                &self.window,
                surface,
                &gone,
                reach,
                (sample, |x| around.distance.value_at(x)),
            );
            let come: Vec<[f64; D]> = puts.iter().map(|put| put.position).collect();
            let kept =
                PreservedParts::new(self.editable, &self.window, &changed, &gone, &come, reach);
            let seed = context.params.seed;
            let (anew, evaluations) = RebuiltCells::new(
                self,
                around,
                (surface, &changed),
                (&kept, range),
                &gone,
                &puts,
                seed,
                patience,
            )?;
            summary.evaluations += evaluations;

            if patience.is_cancelled() {
                return Ok(CellPatch::default());
            }
            if let Some(patch) = anew.patch() {
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
            "would change cells farther than 5 d away",
            "give a place farther from the sides and from other fixed atoms, or mesh the image again",
        )))
    }

    /// Atoms go, and others are put; those too near to them make room.
    fn apply_steps(
        &self,
        around: &LocalFields<D>,
        context: &Context<'_, D>,
        gone: &mut [bool],
        summary: &mut Summary,
    ) -> Vec<PlacedAtom<D>> {
        let (grid, steps) = (self.editable, &self.group.steps);
        for step in steps {
            if let Action::Remove { node } | Action::Shift { node, .. } = step.action {
                gone[node as usize] = true;
            }
        }
        let mut at_feature = vec![false; gone.len()];
        for f in (0..grid.mesh.inner_face_count()).filter(|&f| grid.mesh.on_feature[f]) {
            for c in grid.mesh.face_cells[f] {
                at_feature[c as usize] = true;
            }
        }
        let mut puts = Vec::new();
        for step in steps {
            let (to, mut number, room) = match step.action {
                Action::Remove { .. } => continue,
                Action::Insert { target: to, number } => (to, number, INSERT_CLEARANCE),
                Action::Shift { node, target: to } => (to, Some(node), SHIFT_CLEARANCE),
            };
            let at = self.window.to_local(to);
            let mut nearest = REUSE_RADIUS;
            for (&c, x) in self.cells.iter().zip(&self.sites) {
                let c = c as usize;
                let gap = distance2(x, &at).sqrt() / around.distance.value_at(at);
                // Sites on either side of features are near to one another.
                let room = if at_feature[c] { REUSE_RADIUS } else { room };
                if gap >= room || gone[c] || grid.kinds[c] == AtomKind::Fixed {
                    continue;
                }
                gone[c] = true;
                let takes_over = matches!(step.action, Action::Insert { number: None, .. });
                if takes_over && gap < nearest {
                    nearest = gap;
                    number = Some(c as u32);
                } else {
                    summary.removed_neighbours += 1;
                }
            }
            puts.push(PlacedAtom {
                position: at,
                kind: step.kind,
                world: target_position(&context.edits[step.edit])
                    .filter(|_| step.kind == AtomKind::Fixed),
                number,
                edit: Some(step.edit),
            });
        }
        puts
    }
}
