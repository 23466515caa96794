//! The atoms and cells round some edits, and what becomes of them.

use super::around::{Around, Context};
use super::body::Body;
use super::resolve::{Action, Group, REACH, Step, sides, square};
use super::spacing;
use super::window::Window;
use super::{Change, Summary};
use crate::error::cause;
use crate::feature::settled::reach;
use crate::feature::{self, Features};
use crate::improve::{Refusal, Wanted};
use crate::job::horizons::horizon_bits;
use crate::job::{self, Evaluator, Meshing, Scene, Space};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, Pairwise, Regularised, Sampled};
use crate::lattice::optimize::{self, temperature};
use crate::lattice::seeding::{Atoms, kind_in_box, sides_held};
use crate::mesh::Simplices;
use crate::observer::{Patience, Patient};
use crate::{Error, Result};

/// Movable atoms nearer than this to one that comes, in units of d, make room for it, as they do for
/// fixed atoms in a new lattice ...
pub(super) const ROOM_TO_COME: f64 = 0.7;
/// ... nearer than this to one that is shifted: their number shall stay the same ...
pub(super) const ROOM_TO_SHIFT: f64 = 0.5;
/// ... and one nearer than this to one that comes becomes it.
pub(super) const TAKEN: f64 = 0.35;

/// The smallest angle aimed at where the mesh was made without improvement.
const MIN_ANGLE: f64 = 30.0;

/// A neighbourhood: a part of the mesh, the atoms near it, and what shall happen to them.
///
/// Its nodes are numbered on their own: first those of the part, then atoms that come. Their positions
/// are those of the window's lattice space.
pub struct Scope<const D: usize, M> {
    group: Group<D>,
    /// The part of the image that it needs to know.
    window: Window<D>,
    /// The part's cells, in slots of the whole mesh.
    slots: Vec<usize>,
    part: M,
    /// The numbers of the part's nodes in the whole mesh.
    numbers: Vec<u32>,
    /// Temperatures of the part's nodes.
    heat: Vec<f64>,
    /// Atoms beyond the part that warm atoms feel.
    outer: Vec<[f64; D]>,
    wanted: Wanted<D>,
    /// For each atom that comes, its step.
    newcomers: Vec<Step<D>>,
}

impl<const D: usize, M: Simplices<D>> Scope<D, M>
where
    Space<D>: Meshing<D, Mesh = M>,
{
    /// Finds the neighbourhood of a group of steps.
    pub fn new(body: &Body<D, M>, group: Group<D>, context: &Context<'_, D>) -> Self {
        let heat = temperature::around(&body.nodes, &group.edited);
        let warm = |cell: &[u32]| cell.iter().any(|&n| heat[n as usize] > 0.0);
        let slots: Vec<usize> = (0..body.cells())
            .filter(|&c| body.cell(c).is_some_and(warm))
            .collect();
        let corners = || slots.iter().filter_map(|&c| body.cell(c)).flatten();
        let mut numbers: Vec<u32> = corners().copied().collect();
        numbers.sort_unstable();
        numbers.dedup();
        let local = |n: &u32| numbers.partition_point(|m| m < n) as u32;
        let in_part = |n: usize| numbers.binary_search(&(n as u32)).is_ok();
        let near = |n: usize| temperature::closeness(&body.nodes[n], &group.edited) < REACH;
        let outer: Vec<[f64; D]> = (0..body.nodes.len())
            .filter(|&n| body.used[n] && near(n) && !in_part(n))
            .map(|n| body.nodes[n])
            .collect();

        let inner = || numbers.iter().map(|&n| body.nodes[n as usize]);
        let (mut low, mut high) = ([f64::INFINITY; D], [0.0f64; D]);
        for x in inner() {
            for k in 0..D {
                low[k] = low[k].min(x[k]);
                high[k] = high[k].max(x[k]);
            }
        }
        for (x, d) in &group.edited {
            for k in 0..D {
                low[k] = low[k].min(x[k] - REACH * d);
                high[k] = high[k].max(x[k] + REACH * d);
            }
        }
        let (margin, dims) = (reach::<D>(context.settled), context.image.dims());
        let window = Window::around(low, high, margin, dims, body.step, body.extent);

        let targets: Vec<[f64; D]> = inner().map(|x| window.to_local(x)).collect();
        let kind = |&n: &u32| match heat[n as usize] > 0.0 {
            true => body.kinds[n as usize],
            false => AtomKind::Fixed,
        };
        Self {
            part: M::from_parts(targets.clone(), corners().map(local).collect()),
            wanted: Wanted {
                gone: vec![false; targets.len()],
                kinds: numbers.iter().map(kind).collect(),
                targets,
            },
            heat: numbers.iter().map(|&n| heat[n as usize]).collect(),
            outer: outer.into_iter().map(|x| window.to_local(x)).collect(),
            newcomers: Vec::new(),
            window,
            slots,
            numbers,
            group,
        }
    }

    /// Looks at what is there: features, distance, weight of the image.
    ///
    /// # Errors
    /// Those of feature detection.
    pub fn look(
        &self,
        body: &Body<D, M>,
        context: &Context<'_, D>,
        patience: &Patience<'_>,
    ) -> Result<Around<D>> {
        Around::look(&self.window, body.step, context, patience, || {
            let at_nodes = |&n: &u32| f64::from(body.distance[n as usize]);
            let d: Vec<f64> = self.numbers.iter().map(at_nodes).collect();
            Ok(spacing::from_nodes(&self.part, &d, self.window.extent()))
        })
    }

    /// Takes the steps, and lets warm atoms move until they are at rest again.
    ///
    /// # Errors
    /// Those of the optimiser.
    pub fn relax(
        &mut self,
        around: &Around<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
        patience: &Patience<'_>,
    ) -> Result<()> {
        self.step(&around.distance, summary);
        let stay = |&i: &usize| !self.wanted.gone[i];
        let moving: Vec<usize> = (0..self.wanted.targets.len()).filter(stay).collect();
        let frozen = self.outer.len();
        let mut atoms = Atoms {
            positions: moving.iter().map(|&i| self.wanted.targets[i]).collect(),
            kinds: moving.iter().map(|&i| self.wanted.kinds[i]).collect(),
        };
        atoms.positions.extend_from_slice(&self.outer);
        atoms.kinds.extend(vec![AtomKind::Fixed; frozen]);
        // Atoms that come are as warm as can be.
        let heat = |&i: &usize| self.heat.get(i).copied().unwrap_or(1.0);
        let params = context.params;
        let mut options = job::moving(params);
        options.temperature = moving.iter().map(heat).collect();
        options.temperature.extend(vec![0.0; frozen]);
        summary.warm += options.temperature.iter().filter(|t| **t > 0.0).count();
        summary.samples += around.features.potential.dims.iter().product::<usize>();

        let extent = self.window.extent();
        let potential = &around.features.potential;
        let (distance, beta) = (&around.distance, around.beta.clone());
        let pairs = || -> Result<Pairwise<D>> {
            Ok(Pairwise::new(extent, distance, Some(potential), beta.clone())?.uncrowded())
        };
        // The energy that made the mesh.
        let mut energy: Box<dyn Energy<D>> = match params.evaluator {
            Evaluator::Pairwise if params.kappa != 1.0 => {
                let mobility = atoms.mobility(extent);
                let (beta, kappa) = (beta.clone(), params.kappa);
                Box::new(Regularised::new(pairs()?, distance, beta, kappa, mobility)?)
            }
            Evaluator::Pairwise => Box::new(pairs()?),
            Evaluator::Sampled => Box::new(Sampled::new(distance, potential.dense(), beta.clone())),
        };
        let outcome = optimize::optimize(
            &mut atoms,
            &mut *energy,
            &around.distance,
            extent,
            &options,
            &mut Patient(patience),
        )?;
        summary.evaluations += outcome.evaluations;
        for (&i, x) in moving.iter().zip(atoms.positions) {
            self.wanted.targets[i] = x;
        }
        Ok(())
    }

    /// Atoms come, go and are shifted; others make room.
    fn step(&mut self, distance: &Distance<D>, summary: &mut Summary) {
        let extent = self.window.extent();
        let steps = std::mem::take(&mut self.group.steps);
        // Nothing that is edited makes room.
        let mut edited = vec![false; self.numbers.len()];
        for step in &steps {
            if let Action::Go { node } | Action::Shift { node, .. } = step.action {
                edited[self.local(node)] = true;
            }
        }
        for step in steps {
            let (to, room) = match step.action {
                Action::Go { node } => {
                    self.leave(self.local(node));
                    continue;
                }
                Action::Come { to, .. } => (self.window.to_local(to), ROOM_TO_COME),
                Action::Shift { to, .. } => (self.window.to_local(to), ROOM_TO_SHIFT),
            };
            let gap = |i: usize| square(self.part.nodes()[i], to).sqrt() / distance.at(to);
            let yields = |i: &usize| {
                let x = self.part.nodes()[*i];
                !edited[*i]
                    && !self.wanted.gone[*i]
                    && !matches!(self.wanted.kinds[*i], AtomKind::Fixed | AtomKind::Corner)
                    && sides_held(x, extent) <= sides_held(to, extent)
            };
            let crowd: Vec<usize> = (0..self.numbers.len())
                .filter(|&i| gap(i) < room)
                .filter(yields)
                .collect();
            let nearest = crowd
                .iter()
                .copied()
                .min_by(|&i, &j| gap(i).total_cmp(&gap(j)));
            let taken = nearest.filter(|&i| {
                gap(i) < TAKEN && sides(self.part.nodes()[i], extent) == sides(to, extent)
            });
            match (step.action, taken) {
                (Action::Shift { node, .. }, _) => self.shift(self.local(node), to, step),
                (Action::Come { number: None, .. }, Some(i)) => {
                    edited[i] = true;
                    self.shift(i, to, step);
                    summary.atoms[step.edit] = Some(self.numbers[i]);
                }
                _ => self.come(to, step),
            }
            for i in crowd {
                if !edited[i] {
                    self.leave(i);
                    summary.made_room += 1;
                }
            }
        }
    }

    /// The number of a node within the part.
    fn local(&self, node: u32) -> usize {
        self.numbers.partition_point(|&n| n < node)
    }

    fn leave(&mut self, i: usize) {
        self.wanted.gone[i] = true;
        self.wanted.kinds[i] = kind_in_box(self.part.nodes()[i], self.window.extent());
    }

    fn come(&mut self, to: [f64; D], step: Step<D>) {
        self.wanted.targets.push(to);
        self.wanted.kinds.push(step.kind);
        self.wanted.gone.push(false);
        self.newcomers.push(step);
    }

    fn shift(&mut self, i: usize, to: [f64; D], step: Step<D>) {
        self.wanted.targets[i] = to;
        self.wanted.kinds[i] = step.kind;
        self.group.steps.push(Step {
            action: Action::Shift {
                node: self.numbers[i],
                to,
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
    pub fn rejoin(
        mut self,
        body: &mut Body<D, M>,
        around: &Around<D>,
        context: &Context<'_, D>,
        summary: &mut Summary,
    ) -> Result<[M; 2]> {
        let without;
        let (features, min_angle) = match context.params.min_dihedral {
            Some(angle) => (&around.features, angle),
            None => {
                without = Features::none(self.window.dims, &feature::Detection::default());
                (&without, MIN_ANGLE)
            }
        };
        let scene = Scene {
            extent: self.window.extent(),
            features,
            distance: &around.distance,
        };
        let done = loop {
            let wanted = self.wanted.clone();
            match Space::<D>::rejoin(self.part.clone(), wanted, &scene, min_angle) {
                Ok(done) => break done,
                Err(Refusal::Node(node)) => self.otherwise(node as usize, context)?,
                Err(Refusal::Part(error)) => return Err(error),
            }
        };
        let count = self.numbers.len();
        let mut whole: Vec<u32> = Vec::with_capacity(done.kept.len());
        let mut kept = vec![false; count];
        for (j, &k) in done.kept.iter().enumerate() {
            let k = k as usize;
            let (local, x) = (k < count, done.mesh.nodes()[j]);
            let n = if local {
                self.numbers[k]
            } else {
                body.add_node()
            };
            whole.push(n);
            let i = n as usize;
            if local {
                kept[k] = true;
                if self.wanted.kinds[k] == AtomKind::Fixed && self.heat[k] > 0.0 {
                    body.kinds[i] = AtomKind::Fixed;
                }
            } else {
                body.kinds[i] = done.kinds[j];
            }
            if local && x == self.part.nodes()[k] {
                continue;
            }
            body.put_node(i, self.window.to_whole(x));
            body.distance[i] = around.distance.at(x) as f32;
            body.feature[i] = around.features.potential.value(x) as f32;
        }
        self.name(body, &done.kept, &whole, context, summary);
        for (k, &n) in self.numbers.iter().enumerate() {
            body.used[n as usize] = kept[k];
        }
        let regions = self.regions(body, &done.mesh);
        let horizons = horizon_bits(&done.mesh, &done.feature_faces, &around.features);
        summary.cells[0] += self.part.len();
        summary.cells[1] += done.mesh.len();
        body.exchange(
            &self.slots,
            &done.mesh,
            &whole,
            [&done.feature_faces, &horizons],
            &regions,
        );
        Ok([self.part, done.mesh])
    }

    /// Tells where edited atoms are, and puts them exactly where the user has put them.
    fn name(
        &self,
        body: &mut Body<D, M>,
        kept: &[u32],
        whole: &[u32],
        context: &Context<'_, D>,
        summary: &mut Summary,
    ) {
        let count = self.numbers.len();
        let shifted = self
            .group
            .steps
            .iter()
            .filter_map(|step| match step.action {
                Action::Shift { node, .. } => Some((self.local(node), step)),
                _ => None,
            });
        let come = (count..).zip(&self.newcomers);
        for (k, step) in shifted.chain(come) {
            let Some(j) = kept.iter().position(|&other| other as usize == k) else {
                continue;
            };
            let n = whole[j];
            summary.atoms[step.edit] = Some(n);
            if let Action::Come {
                number: Some(number),
                ..
            } = step.action
            {
                body.renamed.push((n, number));
            }
            body.kinds[n as usize] = step.kind;
            if let (AtomKind::Fixed, Change::Add(x) | Change::Move(_, x)) =
                (step.kind, context.edits[step.edit].change)
            {
                body.place_exactly(n as usize, x);
            }
        }
    }

    /// An atom that cannot be shifted goes, and comes anew where it shall be.
    fn otherwise(&mut self, i: usize, context: &Context<'_, D>) -> Result<()> {
        let count = self.numbers.len();
        let is_shift = |step: &Step<D>| match step.action {
            Action::Shift { node, .. } => i < count && node == self.numbers[i],
            _ => false,
        };
        if let Some(at) = self.group.steps.iter().position(is_shift) {
            let step = self.group.steps.remove(at);
            let to = self.wanted.targets[i];
            self.leave(i);
            let number = Some(self.numbers[i]);
            let action = Action::Come { to, number };
            self.come(to, Step { action, ..step });
            return Ok(());
        }
        let newcomer = self.newcomers.get(i.wrapping_sub(count));
        let name = newcomer.map_or_else(
            || format!("atom {}", self.numbers[i.min(count - 1)]),
            |step| context.edits[step.edit].name.clone(),
        );
        Err(Error::Mesh(cause(
            name,
            "would leave cells with zero volume",
            "give a place farther from other fixed atoms and from the sides, or mesh the image again",
        )))
    }

    /// For each cell of the new part, the region of the old cell in which its centre lies.
    fn regions(&self, body: &Body<D, M>, new: &M) -> Vec<i32> {
        let old: Vec<i32> = self.slots.iter().map(|&slot| body.region[slot]).collect();
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
        let centres: Vec<[f64; D]> = (0..self.part.len())
            .map(|c| centre(&self.part, c))
            .collect();
        let region = |c: usize| {
            let x = centre(new, c);
            let gaps = centres.iter().map(|&y| square(x, y)).zip(&old);
            let nearest = gaps.min_by(|a, b| a.0.total_cmp(&b.0));
            nearest.map_or(first, |(_, &region)| region)
        };
        (0..new.len()).map(region).collect()
    }
}
