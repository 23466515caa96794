//! The atoms and cells around a group of edits, and how the edits change them.

use super::editable_mesh::EditableMesh;
use super::local_fields::{Context, LocalFields};
use super::resolve::{Action, EditGroup, EditStep, INFLUENCE_RADIUS, box_sides};
use super::spacing;
use super::window::EditWindow;
use super::{AtomChange, Summary};
use crate::error::cause;
use crate::feature::{self, Features};
use crate::geometry::{distance2, sorted_distinct};
use crate::improve::{Reshape, ReshapeError, ReshapeRequest, ReshapeResult};
use crate::job::horizons::horizon_bits;
use crate::job::simplices::cell_neighbours;
use crate::job::{self, LatticeParams, MeshScene};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::energy::Energy;
use crate::lattice::optimise::{self, temperature};
use crate::lattice::seeding::{Atoms, kind_at, side_count};
use crate::progress::{CancelToken, TokenProgress};
use crate::{Error, Result};

/// Distance, in units of d, within which movable atoms are removed to make room for an inserted
/// one. A new lattice uses the same value around fixed atoms.
pub(super) const INSERT_CLEARANCE: f64 = 0.7;
/// Distance, in units of d, within which movable atoms are removed to make room for a shifted one.
/// It is smaller, so that the number of atoms stays about the same.
pub(super) const SHIFT_CLEARANCE: f64 = 0.5;
/// Distance, in units of d, within which an existing atom is moved to the position of an inserted
/// one, instead of being removed.
pub(super) const REUSE_RADIUS: f64 = 0.35;

/// Target for the smallest angle, in degrees, where the mesh was made without improvement.
const MIN_ANGLE: f64 = 30.0;

/// Returns the energy with which the mesh was made, in a window of size `extent`. `mobility` says which
/// coordinates of the atoms may change.
///
/// # Errors
/// Returns the errors of [`job::job_energy`].
fn energy<'a, const D: usize>(
    params: &LatticeParams<'_, D>,
    fields: &'a LocalFields<D>,
    mobility: Vec<[f64; D]>,
    extent: [f64; D],
) -> Result<Box<dyn Energy<D> + 'a>> {
    let (potential, beta) = (&fields.features.potential, fields.beta.clone());
    let mobility = || Ok(mobility);
    job::job_energy(
        params,
        potential,
        &fields.distance,
        beta,
        extent,
        mobility,
        None,
    )
}

/// A neighbourhood: a part of the mesh, the atoms around it, and the steps that change them.
///
/// Nodes have local numbers: first those of the part, then the inserted atoms. Positions are in the
/// lattice space of the window.
pub struct Neighbourhood<const D: usize, M> {
    group: EditGroup<D>,
    /// The part of the image that the neighbourhood needs.
    window: EditWindow<D>,
    /// Slots of the part's cells in the whole mesh.
    cell_slots: Vec<usize>,
    local_mesh: M,
    /// Numbers of the part's nodes in the whole mesh, ascending.
    node_numbers: Vec<u32>,
    /// Temperatures of the part's nodes.
    temperatures: Vec<f64>,
    /// Positions of atoms outside the part that interact with warm atoms.
    outer_atoms: Vec<[f64; D]>,
    target_state: ReshapeRequest<D>,
    /// The step of each inserted atom.
    insertions: Vec<EditStep<D>>,
}

impl<const D: usize, M: Reshape<D>> Neighbourhood<D, M> {
    /// Finds the neighbourhood of a group of steps.
    pub fn new(
        editable: &EditableMesh<D, M>,
        group: EditGroup<D>,
        context: &Context<'_, D>,
    ) -> Self {
        let temperatures = temperature::temperatures(&editable.nodes, &group.edited_places);
        let is_warm = |cell: &[u32]| cell.iter().any(|&n| temperatures[n as usize] > 0.0);
        let cell_slots: Vec<usize> = (0..editable.cell_slot_count())
            .filter(|&c| editable.cell(c).is_some_and(is_warm))
            .collect();
        let corners = || {
            cell_slots
                .iter()
                .filter_map(|&c| editable.cell(c))
                .flatten()
        };
        let node_numbers = sorted_distinct(corners().copied());
        let local_number = |n: &u32| node_numbers.partition_point(|m| m < n) as u32;
        let is_in_part = |n: usize| node_numbers.binary_search(&(n as u32)).is_ok();
        let is_close = |n: usize| {
            temperature::relative_distance(&editable.nodes[n], &group.edited_places)
                < INFLUENCE_RADIUS
        };
        let outer_positions: Vec<[f64; D]> = (0..editable.nodes.len())
            .filter(|&n| editable.is_used[n] && is_close(n) && !is_in_part(n))
            .map(|n| editable.nodes[n])
            .collect();

        let part_positions: Vec<[f64; D]> = (node_numbers.iter())
            .map(|&n| editable.nodes[n as usize])
            .collect();
        let window = group.window(&part_positions, context, editable.step, editable.extent);
        let targets: Vec<[f64; D]> = part_positions.iter().map(|&x| window.to_local(x)).collect();
        let kind = |&n: &u32| {
            if temperatures[n as usize] > 0.0 {
                editable.kinds[n as usize]
            } else {
                AtomKind::Fixed
            }
        };
        Self {
            local_mesh: M::from_parts(targets.clone(), corners().map(local_number).collect()),
            target_state: ReshapeRequest {
                is_removed: vec![false; targets.len()],
                kinds: node_numbers.iter().map(kind).collect(),
                targets,
            },
            temperatures: node_numbers
                .iter()
                .map(|&n| temperatures[n as usize])
                .collect(),
            outer_atoms: outer_positions
                .into_iter()
                .map(|x| window.to_local(x))
                .collect(),
            insertions: Vec::new(),
            window,
            cell_slots,
            node_numbers,
            group,
        }
    }

    /// Computes the features, the nominal distance and the weight of the image in the window.
    ///
    /// # Errors
    /// Returns the errors of feature detection.
    pub fn local_fields(
        &self,
        editable: &EditableMesh<D, M>,
        context: &Context<'_, D>,
        cancel: &CancelToken<'_>,
    ) -> Result<LocalFields<D>> {
        LocalFields::detect(&self.window, editable.step, context, cancel, || {
            let distance_at = |&n: &u32| f64::from(editable.distance[n as usize]);
            let d: Vec<f64> = self.node_numbers.iter().map(distance_at).collect();
            Ok(spacing::distance_from_nodes(
                &self.local_mesh,
                &d,
                self.window.extent(),
            ))
        })
    }

    /// Applies the steps, then moves warm atoms to a minimum of the energy.
    ///
    /// # Errors
    /// Returns the errors of the optimiser.
    pub fn relax(
        &mut self,
        fields: &LocalFields<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        cancel: &CancelToken<'_>,
    ) -> Result<()> {
        self.apply_steps(&fields.distance, summary);
        let is_kept = |&i: &usize| !self.target_state.is_removed[i];
        let remaining: Vec<usize> = (0..self.target_state.targets.len())
            .filter(is_kept)
            .collect();
        let frozen_count = self.outer_atoms.len();
        let mut atoms = Atoms {
            positions: remaining
                .iter()
                .map(|&i| self.target_state.targets[i])
                .collect(),
            kinds: remaining
                .iter()
                .map(|&i| self.target_state.kinds[i])
                .collect(),
        };
        atoms.positions.extend_from_slice(&self.outer_atoms);
        atoms.kinds.extend(vec![AtomKind::Fixed; frozen_count]);
        // Inserted atoms have the highest temperature.
        let temperature = |&i: &usize| self.temperatures.get(i).copied().unwrap_or(1.0);
        let params = context.params;
        let mut options = job::optimise_options(params, &fields.distance);
        options.temperature = remaining.iter().map(temperature).collect();
        options.temperature.extend(vec![0.0; frozen_count]);
        summary.movable_atoms += options.temperature.iter().filter(|t| **t > 0.0).count();
        summary.samples += fields.detected_samples;

        let extent = self.window.extent();
        let mobility = atoms.mobility(extent);
        let mut energy = energy(params, fields, mobility, extent)?;
        let outcome = optimise::optimise(
            &mut atoms,
            &mut *energy,
            &fields.distance,
            extent,
            &options,
            &mut TokenProgress(cancel),
        )?;
        summary.evaluations += outcome.evaluations;
        for (&i, x) in remaining.iter().zip(atoms.positions) {
            self.target_state.targets[i] = x;
        }
        Ok(())
    }

    /// Inserts, removes and shifts atoms, and removes others that are too near to them.
    fn apply_steps(&mut self, distance: &Distance<D>, summary: &mut Summary) {
        let extent = self.window.extent();
        let steps = std::mem::take(&mut self.group.steps);
        // Edited atoms are never removed to make room.
        let mut edited = vec![false; self.node_numbers.len()];
        for step in &steps {
            if let Action::Remove { node } | Action::Shift { node, .. } = step.action {
                edited[self.local_number(node)] = true;
            }
        }
        for step in steps {
            let (position, clearance) = match step.action {
                Action::Remove { node } => {
                    self.remove_atom(self.local_number(node));
                    continue;
                }
                Action::Insert {
                    target: position, ..
                } => (self.window.to_local(position), INSERT_CLEARANCE),
                Action::Shift {
                    target: position, ..
                } => (self.window.to_local(position), SHIFT_CLEARANCE),
            };
            let distance_ratio = |i: usize| {
                distance2(&self.local_mesh.nodes()[i], &position).sqrt()
                    / distance.value_at(position)
            };
            let is_removable = |i: &usize| {
                let x = self.local_mesh.nodes()[*i];
                !edited[*i]
                    && !self.target_state.is_removed[*i]
                    && !matches!(
                        self.target_state.kinds[*i],
                        AtomKind::Fixed | AtomKind::Corner
                    )
                    && side_count(x, extent) <= side_count(position, extent)
            };
            let crowding: Vec<usize> = (0..self.node_numbers.len())
                .filter(|&i| distance_ratio(i) < clearance)
                .filter(is_removable)
                .collect();
            let nearest = crowding
                .iter()
                .copied()
                .min_by(|&i, &j| distance_ratio(i).total_cmp(&distance_ratio(j)));
            let reused = nearest.filter(|&i| {
                distance_ratio(i) < REUSE_RADIUS
                    && box_sides(self.local_mesh.nodes()[i], extent) == box_sides(position, extent)
            });
            match (step.action, reused) {
                (Action::Shift { node, .. }, _) => {
                    self.shift_atom(self.local_number(node), position, step)
                }
                (Action::Insert { number: None, .. }, Some(i)) => {
                    edited[i] = true;
                    self.shift_atom(i, position, step);
                    summary.atoms[step.edit] = Some(self.node_numbers[i]);
                }
                _ => self.insert_atom(position, step),
            }
            for i in crowding {
                if !edited[i] {
                    self.remove_atom(i);
                    summary.removed_neighbours += 1;
                }
            }
        }
    }

    /// Returns the local number of a node of the part.
    fn local_number(&self, node: u32) -> usize {
        self.node_numbers.partition_point(|&n| n < node)
    }

    fn remove_atom(&mut self, i: usize) {
        self.target_state.is_removed[i] = true;
        self.target_state.kinds[i] = kind_at(self.local_mesh.nodes()[i], self.window.extent());
    }

    fn insert_atom(&mut self, position: [f64; D], step: EditStep<D>) {
        self.target_state.targets.push(position);
        self.target_state.kinds.push(step.kind);
        self.target_state.is_removed.push(false);
        self.insertions.push(step);
    }

    fn shift_atom(&mut self, i: usize, position: [f64; D], step: EditStep<D>) {
        self.target_state.targets[i] = position;
        self.target_state.kinds[i] = step.kind;
        self.group.steps.push(EditStep {
            action: Action::Shift {
                node: self.node_numbers[i],
                target: position,
            },
            ..step
        });
    }

    /// Joins the atoms of the part again, and closes holes in its features. The part's outer faces do
    /// not change.
    ///
    /// # Errors
    /// Returns the node that cannot be moved to its target or cannot be removed, or another error.
    fn rejoin(
        &self,
        scene: &MeshScene<'_, D>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<M>, ReshapeError> {
        let mut request = self.target_state.clone();
        let planes = scene.snap(&mut request.targets, &request.kinds);
        let (extent, distance, mesh) = (scene.extent, scene.distance, &self.local_mesh);
        let mut part = mesh.reshape(&request, extent, &planes, distance, min_angle)?;
        let neighbours = cell_neighbours(&part.mesh).map_err(ReshapeError::Mesh)?;
        let (points, marks) = (&scene.features.points, &mut part.feature_faces);
        scene
            .close_holes(
                &part.mesh,
                &neighbours,
                points,
                marks,
                &CancelToken::never(),
            )
            .map_err(ReshapeError::Mesh)?;
        Ok(part)
    }

    /// Rebuilds the part's cells and puts them into the whole mesh. Returns the part before and
    /// after, in lattice space.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if an atom cannot be joined to its neighbours where it is, or cannot
    /// be removed, and other errors of the reconnection.
    pub fn remesh(
        mut self,
        editable: &mut EditableMesh<D, M>,
        fields: &LocalFields<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
    ) -> Result<[M; 2]> {
        let no_features;
        let (features, min_angle) = match context.params.spec().target() {
            Some(target) => (&fields.features, target.min_dihedral),
            None => {
                no_features =
                    Features::empty(self.window.dims, &feature::DetectionOptions::default());
                (&no_features, MIN_ANGLE)
            }
        };
        let scene = MeshScene {
            extent: self.window.extent(),
            features,
            distance: &fields.distance,
        };
        let reshaped = loop {
            match self.rejoin(&scene, min_angle) {
                Ok(reshaped) => break reshaped,
                Err(ReshapeError::Node(node)) => self.replace_shift(node as usize, context)?,
                Err(ReshapeError::Mesh(error)) => return Err(error),
            }
        };
        let count = self.node_numbers.len();
        let mut global_numbers: Vec<u32> = Vec::with_capacity(reshaped.request_nodes.len());
        let mut is_kept = vec![false; count];
        for (j, &k) in reshaped.request_nodes.iter().enumerate() {
            let k = k as usize;
            let (is_old, x) = (k < count, reshaped.mesh.nodes()[j]);
            let n = if is_old {
                self.node_numbers[k]
            } else {
                editable.add_node()
            };
            global_numbers.push(n);
            let i = n as usize;
            if is_old {
                is_kept[k] = true;
                if self.target_state.kinds[k] == AtomKind::Fixed && self.temperatures[k] > 0.0 {
                    editable.kinds[i] = AtomKind::Fixed;
                }
            } else {
                editable.kinds[i] = reshaped.kinds[j];
            }
            if is_old && x == self.local_mesh.nodes()[k] {
                continue;
            }
            editable.set_node_position(i, self.window.to_global(x));
            editable.distance[i] = fields.distance.value_at(x) as f32;
            editable.feature[i] = fields.features.potential.value(x) as f32;
        }
        self.record_edited_atoms(
            editable,
            &reshaped.request_nodes,
            &global_numbers,
            context,
            summary,
        );
        for (k, &n) in self.node_numbers.iter().enumerate() {
            editable.is_used[n as usize] = is_kept[k];
        }
        let regions = self.cell_regions(editable, &reshaped.mesh);
        let horizons = horizon_bits(
            &reshaped.mesh,
            &reshaped.feature_faces,
            &[],
            &fields.features,
        );
        summary.cells[0] += self.local_mesh.len();
        summary.cells[1] += reshaped.mesh.len();
        editable.replace_cells(
            &self.cell_slots,
            &reshaped.mesh,
            &global_numbers,
            [&reshaped.feature_faces, &horizons],
            &regions,
        );
        Ok([self.local_mesh, reshaped.mesh])
    }

    /// Records the numbers of the edited atoms in `summary` and `editable`, and sets the physical
    /// positions of fixed ones exactly to those of the edits.
    fn record_edited_atoms(
        &self,
        editable: &mut EditableMesh<D, M>,
        request_nodes: &[u32],
        global_numbers: &[u32],
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
        let inserted = (count..).zip(&self.insertions);
        for (k, step) in shifted.chain(inserted) {
            let Some(j) = request_nodes.iter().position(|&other| other as usize == k) else {
                continue;
            };
            let n = global_numbers[j];
            summary.atoms[step.edit] = Some(n);
            if let Action::Insert {
                number: Some(number),
                ..
            } = step.action
            {
                editable.renumberings.push((n, number));
            }
            editable.kinds[n as usize] = step.kind;
            if let (AtomKind::Fixed, AtomChange::Add(x) | AtomChange::Move(_, x)) =
                (step.kind, context.edits[step.edit].change)
            {
                editable.set_exact_position(n as usize, x);
            }
        }
    }

    /// Replaces the shift of an atom that cannot be shifted by a removal and an insertion.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if node `i` is not a shifted one.
    fn replace_shift(&mut self, i: usize, context: &Context<'_, D>) -> Result<()> {
        let count = self.node_numbers.len();
        let is_shift = |step: &EditStep<D>| match step.action {
            Action::Shift { node, .. } => i < count && node == self.node_numbers[i],
            _ => false,
        };
        if let Some(index) = self.group.steps.iter().position(is_shift) {
            let step = self.group.steps.remove(index);
            let target = self.target_state.targets[i];
            self.remove_atom(i);
            let number = Some(self.node_numbers[i]);
            let action = Action::Insert { target, number };
            self.insert_atom(target, EditStep { action, ..step });
            return Ok(());
        }
        let insertion = self.insertions.get(i.wrapping_sub(count));
        let name = insertion.map_or_else(
            || format!("atom {}", self.node_numbers[i.min(count - 1)]),
            |step| context.edits[step.edit].name.clone(),
        );
        Err(Error::Mesh(cause(
            name,
            "would leave cells with zero volume",
            "give a place farther from other fixed atoms and from the sides, or mesh the image again",
        )))
    }

    /// Returns, for each cell of the new part, the region of the old cell whose centre is nearest.
    fn cell_regions(&self, editable: &EditableMesh<D, M>, new_mesh: &M) -> Vec<i32> {
        let old_regions: Vec<i32> = self
            .cell_slots
            .iter()
            .map(|&slot| editable.region[slot])
            .collect();
        let first = old_regions.first().copied().unwrap_or(0);
        if old_regions.iter().all(|&r| r == first) {
            return vec![first; new_mesh.len()];
        }
        let centre = |mesh: &M, c: usize| -> [f64; D] {
            let corners = mesh.cell(c).iter().map(|&n| mesh.nodes()[n as usize]);
            corners.fold([0.0; D], |sum, x| {
                std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
            })
        };
        // The cell with the nearest centre is accurate enough; the containing cell need not be
        // found.
        let centres: Vec<[f64; D]> = (0..self.local_mesh.len())
            .map(|c| centre(&self.local_mesh, c))
            .collect();
        let region = |c: usize| {
            let x = centre(new_mesh, c);
            let distances2 = centres.iter().map(|y| distance2(&x, y)).zip(&old_regions);
            let nearest = distances2.min_by(|a, b| a.0.total_cmp(&b.0));
            nearest.map_or(first, |(_, &region)| region)
        };
        (0..new_mesh.len()).map(region).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::DetectionOptions;
    use crate::image::{ScalarField, SparseField};
    use crate::job::{Evaluator, MeshSpec, Params};
    use crate::lattice::energy::Beta;

    #[test]
    fn both_evaluators_have_the_energy_of_crowded_atoms() {
        // Rows of atoms 0.6 d apart, whose repulsion is most of their energy.
        let (d, extent) = (10.0, [60.0, 60.0]);
        let positions: Vec<[f64; 2]> = (0..49)
            .map(|i| [6.0 * f64::from(i % 7) + 12.0, 6.0 * f64::from(i / 7) + 12.0])
            .collect();
        let potential = ScalarField::from_fn([61, 61], [1.0; 2], |x| -0.01 * x[0]);
        let fields = LocalFields {
            features: Features {
                potential: SparseField::from_field(&potential),
                ..Features::empty([61, 61], &DetectionOptions::default())
            },
            detected_samples: 0,
            distance: Distance::Constant(d),
            beta: Beta::Constant(0.6),
        };
        let [pairwise, sampled] = [Evaluator::Pairwise, Evaluator::Sampled].map(|evaluator| {
            let params = Params::new(MeshSpec {
                evaluator,
                ..MeshSpec::default()
            })
            .unwrap();
            let params = LatticeParams::new(&params, 1.0);
            let mut energy = energy(&params, &fields, Vec::new(), extent).unwrap();
            let mut gradient = vec![[0.0; 2]; positions.len()];
            energy.evaluate(&positions, &mut gradient).unwrap()
        });
        // Both evaluators are exact for atoms at samples.
        assert!(pairwise > 1.0, "{pairwise}");
        let difference = (pairwise - sampled).abs();
        assert!(difference < 1e-4 * pairwise, "{pairwise} {sampled}");
    }
}
