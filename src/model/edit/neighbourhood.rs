//! The atoms and cells round some edits, and what becomes of them.

use super::editable_mesh::EditableMesh;
use super::local_fields::{Context, LocalFields};
use super::resolve::{Action, EditGroup, EditStep, INFLUENCE_RADIUS, box_sides, squared_distance};
use super::spacing;
use super::window::EditWindow;
use super::{AtomChange, Summary};
use crate::error::cause;
use crate::feature::resolved::detection_reach;
use crate::feature::{self, Features};
use crate::improve::{ReshapeError, ReshapeRequest};
use crate::job::horizons::horizon_bits;
use crate::job::{self, Evaluator, MeshScene, MeshSpace, Meshing};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, PairwiseEnergy, RegularisedEnergy, SampledEnergy};
use crate::lattice::optimize::{self, temperature};
use crate::lattice::seeding::{Atoms, kind_at, side_count};
use crate::mesh::Simplices;
use crate::progress::{CancelToken, TokenProgress};
use crate::{Error, Result};

/// Movable atoms nearer than this to one that comes, in units of d, make room for it, as they do for
/// fixed atoms in a new lattice ...
pub(super) const INSERT_CLEARANCE: f64 = 0.7;
/// ... nearer than this to one that is shifted: their number shall stay the same ...
pub(super) const SHIFT_CLEARANCE: f64 = 0.5;
/// ... and one nearer than this to one that comes becomes it.
pub(super) const REUSE_RADIUS: f64 = 0.35;

/// The smallest angle aimed at where the mesh was made without improvement.
const MIN_ANGLE: f64 = 30.0;

/// A neighbourhood: a part of the mesh, the atoms near it, and what shall happen to them.
///
/// Its nodes are numbered on their own: first those of the part, then atoms that come. Their positions
/// are those of the window's lattice space.
pub struct Neighbourhood<const D: usize, M> {
    group: EditGroup<D>,
    /// The part of the image that it needs to know.
    window: EditWindow<D>,
    /// The part's cells, in slots of the whole mesh.
    cell_slots: Vec<usize>,
    local_mesh: M,
    /// The numbers of the part's nodes in the whole mesh.
    node_numbers: Vec<u32>,
    /// Temperatures of the part's nodes.
    temperatures: Vec<f64>,
    /// Atoms beyond the part that warm atoms feel.
    outer_atoms: Vec<[f64; D]>,
    target_state: ReshapeRequest<D>,
    /// For each atom that comes, its step.
    insertions: Vec<EditStep<D>>,
}

impl<const D: usize, M: Simplices<D>> Neighbourhood<D, M>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    /// Finds the neighbourhood of a group of steps.
    pub fn new(body: &EditableMesh<D, M>, group: EditGroup<D>, context: &Context<'_, D>) -> Self {
        let heat = temperature::temperatures(&body.nodes, &group.edited_places);
        let warm = |cell: &[u32]| cell.iter().any(|&n| heat[n as usize] > 0.0);
        let cell_slots: Vec<usize> = (0..body.cell_slot_count())
            .filter(|&c| body.cell(c).is_some_and(warm))
            .collect();
        let corners = || cell_slots.iter().filter_map(|&c| body.cell(c)).flatten();
        let mut node_numbers: Vec<u32> = corners().copied().collect();
        node_numbers.sort_unstable();
        node_numbers.dedup();
        let local = |n: &u32| node_numbers.partition_point(|m| m < n) as u32;
        let in_part = |n: usize| node_numbers.binary_search(&(n as u32)).is_ok();
        let near = |n: usize| {
            temperature::relative_distance(&body.nodes[n], &group.edited_places) < INFLUENCE_RADIUS
        };
        let outer: Vec<[f64; D]> = (0..body.nodes.len())
            .filter(|&n| body.is_used[n] && near(n) && !in_part(n))
            .map(|n| body.nodes[n])
            .collect();

        let inner = || node_numbers.iter().map(|&n| body.nodes[n as usize]);
        let (mut low, mut high) = ([f64::INFINITY; D], [0.0f64; D]);
        for x in inner() {
            for k in 0..D {
                low[k] = low[k].min(x[k]);
                high[k] = high[k].max(x[k]);
            }
        }
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
        let window = EditWindow::from_bounds(low, high, margin, dims, body.step, body.extent);

        let targets: Vec<[f64; D]> = inner().map(|x| window.to_local(x)).collect();
        let kind = |&n: &u32| match heat[n as usize] > 0.0 {
            true => body.kinds[n as usize],
            false => AtomKind::Fixed,
        };
        Self {
            local_mesh: M::from_parts(targets.clone(), corners().map(local).collect()),
            target_state: ReshapeRequest {
                is_removed: vec![false; targets.len()],
                kinds: node_numbers.iter().map(kind).collect(),
                targets,
            },
            temperatures: node_numbers.iter().map(|&n| heat[n as usize]).collect(),
            outer_atoms: outer.into_iter().map(|x| window.to_local(x)).collect(),
            insertions: Vec::new(),
            window,
            cell_slots,
            node_numbers,
            group,
        }
    }

    /// Looks at what is there: features, distance, weight of the image.
    ///
    /// # Errors
    /// Those of feature detection.
    pub fn local_fields(
        &self,
        body: &EditableMesh<D, M>,
        context: &Context<'_, D>,
        patience: &CancelToken<'_>,
    ) -> Result<LocalFields<D>> {
        LocalFields::detect(&self.window, body.step, context, patience, || {
            let at_nodes = |&n: &u32| f64::from(body.distance[n as usize]);
            let d: Vec<f64> = self.node_numbers.iter().map(at_nodes).collect();
            Ok(spacing::distance_from_nodes(
                &self.local_mesh,
                &d,
                self.window.extent(),
            ))
        })
    }

    /// Takes the steps, and lets warm atoms move until they are at rest again.
    ///
    /// # Errors
    /// Those of the optimiser.
    pub fn relax(
        &mut self,
        around: &LocalFields<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        patience: &CancelToken<'_>,
    ) -> Result<()> {
        self.apply_steps(&around.distance, summary);
        let stay = |&i: &usize| !self.target_state.is_removed[i];
        let moving: Vec<usize> = (0..self.target_state.targets.len()).filter(stay).collect();
        let frozen = self.outer_atoms.len();
        let mut atoms = Atoms {
            positions: moving
                .iter()
                .map(|&i| self.target_state.targets[i])
                .collect(),
            kinds: moving.iter().map(|&i| self.target_state.kinds[i]).collect(),
        };
        atoms.positions.extend_from_slice(&self.outer_atoms);
        atoms.kinds.extend(vec![AtomKind::Fixed; frozen]);
        // Atoms that come are as warm as can be.
        let heat = |&i: &usize| self.temperatures.get(i).copied().unwrap_or(1.0);
        let params = context.params;
        let mut options = job::optimize_options(params);
        options.temperature = moving.iter().map(heat).collect();
        options.temperature.extend(vec![0.0; frozen]);
        summary.movable_atoms += options.temperature.iter().filter(|t| **t > 0.0).count();
        summary.samples += around.features.potential.dims.iter().product::<usize>();

        let extent = self.window.extent();
        let potential = &around.features.potential;
        let (distance, beta) = (&around.distance, around.beta.clone());
        let pairs = || -> Result<PairwiseEnergy<D>> {
            Ok(
                PairwiseEnergy::new(extent, distance, Some(potential), beta.clone())?
                    .with_auto_stiffness(),
            )
        };
        // The energy that made the mesh.
        let mut energy: Box<dyn Energy<D>> = match params.evaluator {
            Evaluator::Pairwise if params.kappa != 1.0 => {
                let mobility = atoms.mobility(extent);
                let (beta, kappa) = (beta.clone(), params.kappa);
                Box::new(RegularisedEnergy::new(
                    pairs()?,
                    distance,
                    beta,
                    kappa,
                    mobility,
                )?)
            }
            Evaluator::Pairwise => Box::new(pairs()?),
            Evaluator::Sampled => Box::new(SampledEnergy::new(
                distance,
                potential.to_dense(),
                beta.clone(),
            )),
        };
        let outcome = optimize::optimize(
            &mut atoms,
            &mut *energy,
            &around.distance,
            extent,
            &options,
            &mut TokenProgress(patience),
        )?;
        summary.evaluations += outcome.evaluations;
        for (&i, x) in moving.iter().zip(atoms.positions) {
            self.target_state.targets[i] = x;
        }
        Ok(())
    }

    /// Atoms come, go and are shifted; others make room.
    fn apply_steps(&mut self, distance: &Distance<D>, summary: &mut Summary) {
        let extent = self.window.extent();
        let steps = std::mem::take(&mut self.group.steps);
        // Nothing that is edited makes room.
        let mut edited = vec![false; self.node_numbers.len()];
        for step in &steps {
            if let Action::Remove { node } | Action::Shift { node, .. } = step.action {
                edited[self.local_number(node)] = true;
            }
        }
        for step in steps {
            let (to, room) = match step.action {
                Action::Remove { node } => {
                    self.remove_atom(self.local_number(node));
                    continue;
                }
                Action::Insert { target: to, .. } => (self.window.to_local(to), INSERT_CLEARANCE),
                Action::Shift { target: to, .. } => (self.window.to_local(to), SHIFT_CLEARANCE),
            };
            let gap = |i: usize| {
                squared_distance(self.local_mesh.nodes()[i], to).sqrt() / distance.value_at(to)
            };
            let yields = |i: &usize| {
                let x = self.local_mesh.nodes()[*i];
                !edited[*i]
                    && !self.target_state.is_removed[*i]
                    && !matches!(
                        self.target_state.kinds[*i],
                        AtomKind::Fixed | AtomKind::Corner
                    )
                    && side_count(x, extent) <= side_count(to, extent)
            };
            let crowd: Vec<usize> = (0..self.node_numbers.len())
                .filter(|&i| gap(i) < room)
                .filter(yields)
                .collect();
            let nearest = crowd
                .iter()
                .copied()
                .min_by(|&i, &j| gap(i).total_cmp(&gap(j)));
            let taken = nearest.filter(|&i| {
                gap(i) < REUSE_RADIUS
                    && box_sides(self.local_mesh.nodes()[i], extent) == box_sides(to, extent)
            });
            match (step.action, taken) {
                (Action::Shift { node, .. }, _) => {
                    self.shift_atom(self.local_number(node), to, step)
                }
                (Action::Insert { number: None, .. }, Some(i)) => {
                    edited[i] = true;
                    self.shift_atom(i, to, step);
                    summary.atoms[step.edit] = Some(self.node_numbers[i]);
                }
                _ => self.insert_atom(to, step),
            }
            for i in crowd {
                if !edited[i] {
                    self.remove_atom(i);
                    summary.removed_neighbours += 1;
                }
            }
        }
    }

    /// The number of a node within the part.
    fn local_number(&self, node: u32) -> usize {
        self.node_numbers.partition_point(|&n| n < node)
    }

    fn remove_atom(&mut self, i: usize) {
        self.target_state.is_removed[i] = true;
        self.target_state.kinds[i] = kind_at(self.local_mesh.nodes()[i], self.window.extent());
    }

    fn insert_atom(&mut self, to: [f64; D], step: EditStep<D>) {
        self.target_state.targets.push(to);
        self.target_state.kinds.push(step.kind);
        self.target_state.is_removed.push(false);
        self.insertions.push(step);
    }

    fn shift_atom(&mut self, i: usize, to: [f64; D], step: EditStep<D>) {
        self.target_state.targets[i] = to;
        self.target_state.kinds[i] = step.kind;
        self.group.steps.push(EditStep {
            action: Action::Shift {
                node: self.node_numbers[i],
                target: to,
            },
            ..step
        });
    }

    /// Makes the part's cells anew and puts them into the whole mesh. Gives the part as it was and as
    /// it is, in lattice space.
    ///
    /// # Errors
    /// [`Error::Mesh`] if an atom cannot be joined to its neighbours where it is, or cannot go; and
    /// what else keeps the part from being joined.
    pub fn remesh(
        mut self,
        body: &mut EditableMesh<D, M>,
        around: &LocalFields<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
    ) -> Result<[M; 2]> {
        let without;
        let (features, min_angle) = match context.params.min_dihedral {
            Some(angle) => (&around.features, angle),
            None => {
                without = Features::empty(self.window.dims, &feature::DetectionOptions::default());
                (&without, MIN_ANGLE)
            }
        };
        let scene = MeshScene {
            extent: self.window.extent(),
            features,
            distance: &around.distance,
        };
        let done = loop {
            let wanted = self.target_state.clone();
            match MeshSpace::<D>::rejoin(self.local_mesh.clone(), wanted, &scene, min_angle) {
                Ok(done) => break done,
                Err(ReshapeError::Node(node)) => self.replace_shift(node as usize, context)?,
                Err(ReshapeError::Mesh(error)) => return Err(error),
            }
        };
        let count = self.node_numbers.len();
        let mut whole: Vec<u32> = Vec::with_capacity(done.request_nodes.len());
        let mut kept = vec![false; count];
        for (j, &k) in done.request_nodes.iter().enumerate() {
            let k = k as usize;
            let (local, x) = (k < count, done.mesh.nodes()[j]);
            let n = if local {
                self.node_numbers[k]
            } else {
                body.add_node()
            };
            whole.push(n);
            let i = n as usize;
            if local {
                kept[k] = true;
                if self.target_state.kinds[k] == AtomKind::Fixed && self.temperatures[k] > 0.0 {
                    body.kinds[i] = AtomKind::Fixed;
                }
            } else {
                body.kinds[i] = done.kinds[j];
            }
            if local && x == self.local_mesh.nodes()[k] {
                continue;
            }
            body.set_node_position(i, self.window.to_global(x));
            body.distance[i] = around.distance.value_at(x) as f32;
            body.feature[i] = around.features.potential.value(x) as f32;
        }
        self.record_edited_atoms(body, &done.request_nodes, &whole, context, summary);
        for (k, &n) in self.node_numbers.iter().enumerate() {
            body.is_used[n as usize] = kept[k];
        }
        let regions = self.cell_regions(body, &done.mesh);
        let horizons = horizon_bits(&done.mesh, &done.feature_faces, &around.features);
        summary.cells[0] += self.local_mesh.len();
        summary.cells[1] += done.mesh.len();
        body.replace_cells(
            &self.cell_slots,
            &done.mesh,
            &whole,
            [&done.feature_faces, &horizons],
            &regions,
        );
        Ok([self.local_mesh, done.mesh])
    }

    /// Tells where edited atoms are, and puts them exactly where the user has put them.
    fn record_edited_atoms(
        &self,
        body: &mut EditableMesh<D, M>,
        kept: &[u32],
        whole: &[u32],
        context: &Context<'_, D>,
        summary: &mut Summary,
    ) {
        let count = self.node_numbers.len();
        let shifted = self
            .group
            .steps
            .iter()
            .filter_map(|step| match step.action {
                Action::Shift { node, .. } => Some((self.local_number(node), step)),
                _ => None,
            });
        let come = (count..).zip(&self.insertions);
        for (k, step) in shifted.chain(come) {
            let Some(j) = kept.iter().position(|&other| other as usize == k) else {
                continue;
            };
            let n = whole[j];
            summary.atoms[step.edit] = Some(n);
            if let Action::Insert {
                number: Some(number),
                ..
            } = step.action
            {
                body.renumberings.push((n, number));
            }
            body.kinds[n as usize] = step.kind;
            if let (AtomKind::Fixed, AtomChange::Add(x) | AtomChange::Move(_, x)) =
                (step.kind, context.edits[step.edit].change)
            {
                body.set_exact_position(n as usize, x);
            }
        }
    }

    /// An atom that cannot be shifted goes, and comes anew where it shall be.
    fn replace_shift(&mut self, i: usize, context: &Context<'_, D>) -> Result<()> {
        let count = self.node_numbers.len();
        let is_shift = |step: &EditStep<D>| match step.action {
            Action::Shift { node, .. } => i < count && node == self.node_numbers[i],
            _ => false,
        };
        if let Some(at) = self.group.steps.iter().position(is_shift) {
            let step = self.group.steps.remove(at);
            let to = self.target_state.targets[i];
            self.remove_atom(i);
            let number = Some(self.node_numbers[i]);
            let action = Action::Insert { target: to, number };
            self.insert_atom(to, EditStep { action, ..step });
            return Ok(());
        }
        let newcomer = self.insertions.get(i.wrapping_sub(count));
        let name = newcomer.map_or_else(
            || format!("atom {}", self.node_numbers[i.min(count - 1)]),
            |step| context.edits[step.edit].name.clone(),
        );
        Err(Error::Mesh(cause(
            name,
            "would leave cells with zero volume",
            "give a place farther from other fixed atoms and from the sides, or mesh the image again",
        )))
    }

    /// For each cell of the new part, the region of the old cell in which its centre lies.
    fn cell_regions(&self, body: &EditableMesh<D, M>, new: &M) -> Vec<i32> {
        let old: Vec<i32> = self
            .cell_slots
            .iter()
            .map(|&slot| body.region[slot])
            .collect();
        let first = old.first().copied().unwrap_or(0);
        if old.iter().all(|&r| r == first) {
            return vec![first; new.len()];
        }
        let centre = |mesh: &M, c: usize| -> [f64; D] {
            let corners = mesh.cell(c).iter().map(|&n| mesh.nodes()[n as usize]);
            corners.fold([0.0; D], |sum, x| {
                std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
            })
        };
        // The nearest centre is as good as the cell itself.
        let centres: Vec<[f64; D]> = (0..self.local_mesh.len())
            .map(|c| centre(&self.local_mesh, c))
            .collect();
        let region = |c: usize| {
            let x = centre(new, c);
            let gaps = centres.iter().map(|&y| squared_distance(x, y)).zip(&old);
            let nearest = gaps.min_by(|a, b| a.0.total_cmp(&b.0));
            nearest.map_or(first, |(_, &region)| region)
        };
        (0..new.len()).map(region).collect()
    }
}
