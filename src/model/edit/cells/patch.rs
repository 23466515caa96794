//! The cells round an edit made anew.

use super::anew::Anew;
use super::grid::Grid;
use super::kept::{Changed, Kept};
use super::put;
use crate::error::cause;
use crate::feature::settled::reach;
use crate::feature::{Detection, Features};
use crate::geometry::distance2;
use crate::job::cells::surface_in;
use crate::job::{Meshing, Scene, Space, Stages};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::optimize::temperature::closeness;
use crate::lattice::seeding::Atoms;
use crate::mesh::voronoi::conform::Surface;
use crate::model::edit::around::{Around, Context};
use crate::model::edit::neighbourhood::{ROOM_TO_COME, ROOM_TO_SHIFT, TAKEN};
use crate::model::edit::resolve::{Action, Group, REACH};
use crate::model::edit::window::Window;
use crate::model::edit::{Summary, spacing};
use crate::observer::{Patience, Patient};
use crate::{Error, Result};

/// Nodes as far as this from every edit, in units of d, stay: new ones are then within five d. Should one be
/// farther, less is made anew.
const RANGES: [f64; 4] = [4.4, 4.0, 3.5, 3.0];
/// Sites nearer to a side of the window than this share of it are not in it.
const INSIDE: f64 = 1e-9;

/// A neighbourhood: the part of the lattice and of the image round some edits.
pub struct Scope<'a, const D: usize> {
    pub grid: &'a Grid<D>,
    group: Group<D>,
    pub window: Window<D>,
    /// The edited places in the window.
    pub edited: Vec<([f64; D], f64)>,
    /// The cells whose sites are in the window and within reach, ascending, and these sites there.
    pub cells: Vec<u32>,
    pub sites: Vec<[f64; D]>,
}

/// An atom that is put somewhere.
#[derive(Debug, Clone, Copy)]
pub struct Put<const D: usize> {
    /// In the window.
    pub at: [f64; D],
    pub kind: AtomKind,
    /// Where it is in the world to the last digit.
    pub world: Option<[f64; D]>,
    /// The number that it shall have.
    pub number: Option<u32>,
    pub edit: Option<usize>,
}

/// A new cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Fresh<const D: usize> {
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
pub struct Face {
    pub ring: Vec<u32>,
    pub cells: [u32; 2],
    pub on_feature: bool,
    pub on_horizon: bool,
}

/// What is new round an edit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Patch<const D: usize> {
    /// The nodes that go; faces that have one go, too.
    pub dead: Vec<u32>,
    /// The cells that go.
    pub gone: Vec<u32>,
    /// The cells that stay, but have new faces.
    pub border: Vec<u32>,
    /// New nodes in lattice space.
    pub nodes: Vec<[f64; D]>,
    pub fresh: Vec<Fresh<D>>,
    pub faces: Vec<Face>,
    /// For edits whose atom is among the new cells, its place there.
    pub atoms: Vec<(usize, usize)>,
}

impl<'a, const D: usize> Scope<'a, D>
where
    Space<D>: Meshing<D>,
{
    /// Finds the neighbourhood of a group of steps.
    pub fn new(grid: &'a Grid<D>, group: Group<D>, context: &Context<'_, D>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; D], [0.0f64; D]);
        for (x, d) in &group.edited {
            for k in 0..D {
                low[k] = low[k].min(x[k] - REACH * d);
                high[k] = high[k].max(x[k] + REACH * d);
            }
        }
        let (margin, dims) = (reach::<D>(context.settled), context.image.dims());
        let (step, extent) = (grid.space.step, grid.space.extent);
        let window = Window::around(low, high, margin, dims, step, extent);
        let local = |&(x, d): &([f64; D], f64)| (window.to_local(x), d);
        let edited: Vec<([f64; D], f64)> = group.edited.iter().map(local).collect();
        let inside = |x: [f64; D]| {
            let is_in = |k: usize| {
                let room = INSIDE * window.extent()[k];
                x[k] > room && x[k] < window.extent()[k] - room
            };
            closeness(&x, &edited) < REACH && (0..D).all(is_in)
        };
        let sites = grid.mesh.sites.iter().map(|&x| window.to_local(x));
        let inner = sites.enumerate().filter(|&(_, x)| inside(x));
        let (cells, sites) = inner.map(|(c, x)| (c as u32, x)).unzip();
        Self {
            grid,
            edited,
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
    pub fn look(&self, context: &Context<'_, D>, patience: &Patience<'_>) -> Result<Around<D>> {
        Around::look(
            &self.window,
            self.grid.space.step,
            context,
            patience,
            || {
                let extent = self.window.extent();
                let d = self
                    .cells
                    .iter()
                    .map(|&c| f64::from(self.grid.distance[c as usize]));
                let d: Vec<f64> = d.collect();
                let atoms = Atoms {
                    kinds: vec![AtomKind::Interior; self.sites.len()],
                    positions: self.sites.clone(),
                };
                let scene = Scene {
                    extent,
                    features: &Features::none(self.window.dims, &Detection::default()),
                    distance: &Distance::Constant(d.iter().copied().fold(f64::INFINITY, f64::min)),
                };
                let observer = &mut Patient(patience);
                let joined =
                    Space::<D>::join(atoms, &scene, None, None, &mut Stages::new(observer))?;
                Ok(spacing::from_nodes(&joined.made.mesh, &d, extent))
            },
        )
    }

    /// The surfaces of the features there.
    ///
    /// # Errors
    /// Those of seeding and of the triangulation.
    pub fn surface(
        &self,
        around: &Around<D>,
        context: &Context<'_, D>,
        patience: &Patience<'_>,
    ) -> Result<Surface<D>> {
        surface_in(
            context.params,
            &around.distance,
            &around.features,
            (self.grid.space.step, self.window.extent()),
            around.beta.clone(),
            &mut Patient(patience),
        )
    }

    /// Makes the cells anew.
    ///
    /// # Errors
    /// [`Error::Mesh`] if they do not fit the others; those of optimiser and triangulation.
    pub fn patch(
        &self,
        around: &Around<D>,
        surface: &Surface<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        patience: &Patience<'_>,
    ) -> Result<Patch<D>> {
        let mut gone = vec![false; self.grid.mesh.sites.len()];
        let puts = self.steps(around, context, &mut gone, summary);
        let step = self.grid.space.step;
        let sample = step.iter().copied().fold(0.0, f64::max);
        for range in RANGES {
            let reach = (self.edited.as_slice(), range);
            let changed = Changed::new(
                self.grid,
                &self.window,
                surface,
                &gone,
                reach,
                (sample, |x| around.distance.at(x)),
            );
            let come: Vec<[f64; D]> = puts.iter().map(|put| put.at).collect();
            let kept = Kept::new(self.grid, &self.window, &changed, &gone, &come, reach);
            let seed = context.params.seed;
            let (anew, evaluations) = Anew::new(
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

            if patience.over() {
                return Ok(Patch::default());
            }
            if let Some(patch) = anew.patch() {
                summary.cells[0] += patch.gone.len() + patch.border.len();
                summary.cells[1] += patch.fresh.len() + patch.border.len();
                summary.warm += patch.gone.len();
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
    fn steps(
        &self,
        around: &Around<D>,
        context: &Context<'_, D>,
        gone: &mut [bool],
        summary: &mut Summary,
    ) -> Vec<Put<D>> {
        let (grid, steps) = (self.grid, &self.group.steps);
        for step in steps {
            if let Action::Go { node } | Action::Shift { node, .. } = step.action {
                gone[node as usize] = true;
            }
        }
        let mut at_feature = vec![false; gone.len()];
        for f in (0..grid.mesh.inner_faces()).filter(|&f| grid.mesh.on_feature[f]) {
            for c in grid.mesh.face_cells[f] {
                at_feature[c as usize] = true;
            }
        }
        let mut puts = Vec::new();
        for step in steps {
            let (to, mut number, room) = match step.action {
                Action::Go { .. } => continue,
                Action::Come { to, number } => (to, number, ROOM_TO_COME),
                Action::Shift { node, to } => (to, Some(node), ROOM_TO_SHIFT),
            };
            let at = self.window.to_local(to);
            let mut nearest = TAKEN;
            for (&c, x) in self.cells.iter().zip(&self.sites) {
                let c = c as usize;
                let gap = distance2(x, &at).sqrt() / around.distance.at(at);
                // Sites on either side of features are near to one another.
                let room = if at_feature[c] { TAKEN } else { room };
                if gap >= room || gone[c] || grid.kinds[c] == AtomKind::Fixed {
                    continue;
                }
                gone[c] = true;
                let takes_over = matches!(step.action, Action::Come { number: None, .. });
                if takes_over && gap < nearest {
                    nearest = gap;
                    number = Some(c as u32);
                } else {
                    summary.made_room += 1;
                }
            }
            puts.push(Put {
                at,
                kind: step.kind,
                world: put(&context.edits[step.edit]).filter(|_| step.kind == AtomKind::Fixed),
                number,
                edit: Some(step.edit),
            });
        }
        puts
    }
}
