//! A pseudo-regular lattice for variable d: Hale 2001, Algorithm 2, with exact sides.
//!
//! Atoms grow the lattice in the order in which they were added. Each atom proposes the sites that
//! its neighbours would have in the densest regular lattice of spacing d(x), face-centred cubic or
//! triangular, and a site becomes an atom if no atom is nearer than 0.8 d. Hale marks spheres in a
//! volume of flags; here atoms are kept in a grid of cells. Hale's sites are d(x) away from an atom
//! at x; here the distance is the mean of d at both ends, so that more of the proposed sites
//! coincide where d varies.
//!
//! The sides of the box come first, so that the box is filled exactly: its corners; atoms along its
//! edges, in 3-D sqrt 2 d apart as on the edges of a (100) box; in 3-D atoms in its sides, grown
//! from the edges as centred squares. Then the inside grows from its fixed atoms or, if there are
//! none, from its centre, as in Hale: one front, which meets only the sides, leaves a lattice
//! without grain boundaries. The space that is left beside the sides is filled from these.
//!
//! With [`Alignment::AlongsideFeatures`], the same happens on a box that is half a d smaller on
//! every side.
//!
//! Several ranks grow the lattice together, each in a slab of the box. A rank knows the atoms
//! within two d of its slab and so the sites that these propose. It decides about the sites in its
//! slab, and waits for the decisions of other ranks about earlier sites nearby. The atoms are the
//! same as with one process, whatever the number of ranks.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use super::refine::graded_positions;
use super::shared_box::SharedBox;
use super::{Alignment, MIN_SITE_DISTANCE, SIDE_MARGIN, empty_grid, side_count};
use crate::error::Result;
use crate::geometry::distance2;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::lattice::distance::Distance;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Fewest atoms whose sites one thread proposes.
const MIN_ATOMS_PER_THREAD: usize = 64;
/// Distance from its slab within which a rank knows atoms, in units of the largest d: the sites
/// that they propose are one d away from them, and depend on other atoms 0.8 d from there.
const HALO_WIDTH_RATIO: f64 = 2.0;

/// Returns the range along the last axis in which a rank must know d, if the largest d is `max_d`.
pub fn required_range<const D: usize>(shared_box: SharedBox<'_, D>, max_d: f64) -> [f64; 2] {
    // Sites are one d from atoms, and a little more where d at the site is not known yet.
    shared_box.slab_with_margin((HALO_WIDTH_RATIO + 2.0) * max_d)
}

/// Properties of an atom other than its position.
struct AtomInfo {
    /// Bits of the sides on which it lies: bit k for the near side along axis k, bit `D + k` for
    /// the far side.
    sides: u8,
    is_fixed: bool,
    /// Count of atoms that were added before it.
    index: u32,
}

impl AtomInfo {
    /// Creates an atom on some sides, without an index yet.
    fn on_sides(sides: u8) -> Self {
        Self {
            sides,
            is_fixed: false,
            index: 0,
        }
    }
}

/// A position that an atom proposes for a new atom.
struct ProposedSite<const D: usize> {
    x: [f64; D],
    /// Smallest allowed distance from other atoms.
    min_distance: f64,
    /// Index of the proposing atom, and of its step: of two sites too near to each other, the one
    /// with the smaller number becomes an atom.
    priority: u64,
}

/// A lattice that grows.
struct GrowingLattice<'a, const D: usize> {
    distance: &'a Distance<D>,
    extent: [f64; D],
    /// Distance of the outermost atoms from the sides of the box, in units of d.
    inset: f64,
    /// The box; this rank grows the atoms in its slab.
    shared_box: SharedBox<'a, D>,
    /// The atoms that this rank knows.
    atoms: IncrementalGrid<D>,
    infos: Vec<AtomInfo>,
    /// `true` if only atoms near the slab are stored.
    drops_distant: bool,
    /// Count of atoms of all ranks.
    global_count: u32,
    /// Sites about which nothing is decided yet.
    open_sites: IncrementalGrid<D>,
    /// The smallest and the largest d.
    min_d: f64,
    max_d: f64,
}

impl<'a, const D: usize> GrowingLattice<'a, D> {
    fn new(shared_box: SharedBox<'a, D>, distance: &'a Distance<D>, alignment: Alignment) -> Self {
        let (min_d, extent) = (distance.min(), shared_box.extent);
        Self {
            distance,
            extent,
            inset: match alignment {
                Alignment::OnFeatures => 0.0,
                Alignment::AlongsideFeatures => 0.5,
            },
            shared_box,
            atoms: empty_grid([0.0; D], extent, MIN_SITE_DISTANCE * min_d),
            infos: Vec::new(),
            drops_distant: false,
            global_count: 0,
            open_sites: IncrementalGrid::new([0.0; D], [0.0; D], min_d),
            min_d,
            max_d: distance.max(),
        }
    }

    /// Counts an atom that all ranks add, and stores it if it is near this rank's slab.
    fn add(&mut self, x: [f64; D], sides: u8, is_fixed: bool) -> Option<u32> {
        let index = self.global_count;
        self.global_count += 1;
        let info = AtomInfo {
            sides,
            is_fixed,
            index,
        };
        let is_near = !self.drops_distant || self.is_local(&x);
        is_near.then(|| self.add_local(x, info))
    }

    fn add_local(&mut self, x: [f64; D], info: AtomInfo) -> u32 {
        self.infos.push(info);
        self.atoms.add(x)
    }

    /// Returns `true` if this rank knows the atoms at a position.
    fn is_local(&self, x: &[f64; D]) -> bool {
        (self.shared_box).is_near_slab(x[D - 1], HALO_WIDTH_RATIO * self.max_d)
    }

    /// Drops atoms that are not near this rank's slab.
    fn drop_distant(&mut self) {
        if !self.shared_box.is_shared() {
            return;
        }
        self.drops_distant = true;
        let (mut low_corner, mut high_corner) = ([0.0; D], self.extent);
        [low_corner[D - 1], high_corner[D - 1]] =
            (self.shared_box).slab_with_margin(HALO_WIDTH_RATIO * self.max_d);
        let grid = empty_grid(low_corner, high_corner, MIN_SITE_DISTANCE * self.min_d);
        self.open_sites = grid.clone();
        let old_atoms = std::mem::replace(&mut self.atoms, grid);
        let infos = std::mem::take(&mut self.infos);
        for (x, info) in old_atoms.positions().iter().zip(infos) {
            if self.is_local(x) {
                self.add_local(*x, info);
            }
        }
    }

    /// Returns the near and far ends of the lattice along an axis where d is `d`.
    fn ends(&self, k: usize, d: f64) -> [f64; 2] {
        [self.inset * d, self.extent[k] - self.inset * d]
    }

    /// Moves a point onto the given sides of the lattice.
    fn snap_to_sides(&self, mut x: [f64; D], sides: u8) -> [f64; D] {
        let d = self.distance.value_at(x);
        for k in 0..D {
            let ends = self.ends(k, d);
            if sides >> k & 1 == 1 {
                x[k] = ends[0];
            } else if sides >> (D + k) & 1 == 1 {
                x[k] = ends[1];
            }
        }
        x
    }

    /// Grows a lattice from some atoms, over the whole box or over the given `sides` of it. Atoms
    /// propose sites in the order in which they were added. So all atoms of one round may propose
    /// at once; most of the sites that they propose are already occupied by atoms of earlier
    /// rounds.
    fn grow(&mut self, mut front: Vec<u32>, sides: u8, cancel: &CancelToken<'_>) -> Result<()> {
        let axes: Vec<usize> = (0..D)
            .filter(|&k| (sides | sides >> D) >> k & 1 == 0)
            .collect();
        let steps = neighbour_steps::<D>(&axes);
        loop {
            let state = [!front.is_empty(), cancel.is_cancelled()];
            let [grows, is_cancelled] = self.shared_box.any("growth of a lattice", state)?;
            if !grows || is_cancelled {
                return Ok(());
            }
            front.sort_unstable_by_key(|&n| self.infos[n as usize].index);
            let atoms = front.par_iter().with_min_len(MIN_ATOMS_PER_THREAD);
            let sites = atoms.flat_map_iter(|&n| self.propose_sites(n, &steps, &axes, sides));
            let sites: Vec<ProposedSite<D>> = sites.collect();
            front = self.accept_sites(&sites, sides)?;
        }
    }

    /// Returns the sites around an atom that are inside along the given axes and free, as far as
    /// this rank has to know them.
    fn propose_sites(
        &self,
        n: u32,
        steps: &[[f64; D]],
        axes: &[usize],
        sides: u8,
    ) -> impl Iterator<Item = ProposedSite<D>> {
        let origin = self.atoms.positions()[n as usize];
        let index = u64::from(self.infos[n as usize].index);
        let margin = MIN_SITE_DISTANCE * self.max_d;
        let d = self.distance.value_at(origin);
        steps
            .iter()
            .enumerate()
            .filter_map(move |(step_index, step)| {
                // The distance is the mean of d at both ends, so that a neighbour proposes the same
                // distance.
                let displaced = |d: f64| {
                    self.snap_to_sides(std::array::from_fn(|k| origin[k] + d * step[k]), sides)
                };
                let x = displaced(0.5 * (d + self.distance.value_at(displaced(d))));
                if !self.shared_box.is_near_slab(x[D - 1], margin) {
                    return None;
                }
                let d = self.distance.value_at(x);
                let is_inside = axes.iter().all(|&k| {
                    let [low, high] = self.ends(k, d);
                    x[k] >= low + SIDE_MARGIN * d && x[k] <= high - SIDE_MARGIN * d
                });
                let site = ProposedSite {
                    x,
                    min_distance: MIN_SITE_DISTANCE * d,
                    priority: index << 8 | step_index as u64,
                };
                (is_inside && self.atoms.is_free(&x, site.min_distance)).then_some(site)
            })
    }

    /// Returns the atoms that sites become, in their order. A site becomes an atom if it is free of
    /// all atoms before it.
    fn accept_sites(&mut self, sites: &[ProposedSite<D>], sides: u8) -> Result<Vec<u32>> {
        let first_new = self.infos.len();
        let decision_margin = MIN_SITE_DISTANCE * self.max_d;
        // This rank decides about the sites in its slab; it receives decisions about the others.
        let (mut undecided, mut foreign): (Vec<&ProposedSite<D>>, Vec<&ProposedSite<D>>) =
            (sites.iter()).partition(|site| self.shared_box.is_in_slab(site.x[D - 1]));
        let mut atoms: Vec<(u64, u32)> = Vec::new();
        let mut priorities: Vec<u64> = Vec::new();
        let mut accept = |lattice: &mut Self, priorities: &mut Vec<u64>, site: &ProposedSite<D>| {
            atoms.push((
                site.priority,
                lattice.add_local(site.x, AtomInfo::on_sides(sides)),
            ));
            priorities.push(site.priority);
        };
        loop {
            self.open_sites.clear();
            foreign
                .iter()
                .for_each(|site| _ = self.open_sites.add(site.x));
            let mut open_priorities: Vec<u64> = foreign.iter().map(|site| site.priority).collect();
            let mut decisions: Vec<(f64, (u64, bool))> = Vec::new();
            undecided.retain(|site| {
                let is_earlier =
                    |n: usize| n >= first_new && priorities[n - first_new] < site.priority;
                let has_room = !self.has_atom_near(site, is_earlier);
                if has_room && self.has_open_site_near(site, &open_priorities) {
                    self.open_sites.add(site.x);
                    open_priorities.push(site.priority);
                    return true;
                }
                if has_room {
                    accept(self, &mut priorities, site);
                }
                decisions.push((site.x[D - 1], (site.priority, has_room)));
                false
            });
            let what = "decisions about sites";
            let mut received =
                (self.shared_box).send_near(what, &decisions, decision_margin, None)?;
            received.sort_unstable();
            foreign.retain(|site| {
                let Ok(position) =
                    received.binary_search_by_key(&site.priority, |decision| decision.0)
                else {
                    return true;
                };
                if received[position].1 {
                    accept(self, &mut priorities, site);
                }
                false
            });
            let [has_undecided] =
                (self.shared_box).any("undecided sites", [!undecided.is_empty()])?;
            if !has_undecided {
                break;
            }
        }
        self.number_atoms(atoms, sides)
    }

    /// Returns `true` if an atom that `accept` accepts is too near to a site.
    fn has_atom_near(&self, site: &ProposedSite<D>, accept: impl Fn(usize) -> bool) -> bool {
        let (positions, radius2) = (
            self.atoms.positions(),
            site.min_distance * site.min_distance,
        );
        self.atoms.any_near(&site.x, site.min_distance, |n| {
            accept(n) && distance2(&positions[n], &site.x) < radius2
        })
    }

    /// Returns `true` if an earlier site about which nothing is decided is too near to a site.
    fn has_open_site_near(&self, site: &ProposedSite<D>, priorities: &[u64]) -> bool {
        let (positions, radius2) = (
            self.open_sites.positions(),
            site.min_distance * site.min_distance,
        );
        !positions.is_empty()
            && self.open_sites.any_near(&site.x, site.min_distance, |n| {
                priorities[n] < site.priority && distance2(&positions[n], &site.x) < radius2
            })
    }

    /// Numbers the atoms of a round, each given with its priority, in the order of priorities over
    /// all ranks. Returns the atoms, with those that other ranks send because they are near this
    /// slab.
    fn number_atoms(&mut self, mut atoms: Vec<(u64, u32)>, sides: u8) -> Result<Vec<u32>> {
        atoms.sort_unstable();
        let mut owned: Vec<(f64, (u64, [f64; D]))> = Vec::with_capacity(atoms.len());
        for &(priority, n) in &atoms {
            let x = self.atoms.positions()[n as usize];
            if self.shared_box.is_in_slab(x[D - 1]) {
                owned.push((x[D - 1], (priority, x)));
            }
        }
        // Ranks that received the decision about the site of an atom already know the atom.
        let [margin, known] = [HALO_WIDTH_RATIO, MIN_SITE_DISTANCE].map(|ratio| ratio * self.max_d);
        let nearby = (self.shared_box).send_near("atoms nearby", &owned, margin, Some(known))?;
        for (priority, x) in nearby {
            atoms.push((priority, self.add_local(x, AtomInfo::on_sides(sides))));
        }
        let priorities = owned.iter().map(|(_, (priority, _))| *priority).collect();
        let mut priorities = (self.shared_box).concatenated("priorities of atoms", priorities)?;
        priorities.sort();
        for &(priority, n) in &atoms {
            let count = priorities.partition_point(|&t| t < priority);
            self.infos[n as usize].index = self.global_count + count as u32;
        }
        self.global_count += priorities.len() as u32;
        Ok(atoms.into_iter().map(|(_, n)| n).collect())
    }

    /// Adds an atom at the centre of the box, if that is free.
    fn add_centre(&mut self) -> Result<Option<u32>> {
        let x = self.extent.map(|l| 0.5 * l);
        let has_room = self.shared_box.is_in_slab(x[D - 1])
            && self
                .atoms
                .is_free(&x, MIN_SITE_DISTANCE * self.distance.value_at(x));
        let [is_free] = self.shared_box.any("free centre", [has_room])?;
        Ok(if is_free { self.add(x, 0, false) } else { None })
    }

    /// Returns atoms between the ends of the edge along `axis` that belongs to `sides`, evenly
    /// spread in units of d (in 3-D of sqrt 2 d).
    fn edge_atoms(&self, axis: usize, sides: u8) -> Vec<[f64; D]> {
        let point_at = |t: f64| {
            let mut x = std::array::from_fn(|k| {
                if sides >> k & 1 == 1 {
                    0.0
                } else {
                    self.extent[k]
                }
            });
            x[axis] = t;
            self.snap_to_sides(x, sides)
        };
        let low = self.ends(axis, self.distance.value_at(point_at(0.0)))[0];
        let high = self.ends(axis, self.distance.value_at(point_at(self.extent[axis])))[1];
        let unit = if D == 3 { SQRT_2 } else { 1.0 };
        let d = |t: f64| unit * self.distance.value_at(point_at(low + t));
        let offsets = graded_positions(high - low, self.min_d, d);
        offsets.into_iter().map(|t| point_at(low + t)).collect()
    }
}

/// Returns the steps from an atom to its neighbours in the densest lattice of spacing 1 over the
/// given axes: all axes, or the two of a side in 3-D.
fn neighbour_steps<const D: usize>(axes: &[usize]) -> Vec<[f64; D]> {
    let mut steps = Vec::new();
    let mut add = |parts: [(usize, f64); 2]| {
        let mut step = [0.0; D];
        for (k, part) in parts {
            step[k] = part;
        }
        steps.push(step);
    };
    let signs = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
    if D == 2 {
        let (x, y) = (0, 1);
        add([(x, 1.0), (y, 0.0)]);
        add([(x, -1.0), (y, 0.0)]);
        for (a, b) in signs {
            add([(x, 0.5 * a), (y, 0.75f64.sqrt() * b)]);
        }
    } else {
        for (position, &first) in axes.iter().enumerate() {
            for &second in &axes[position + 1..] {
                for (a, b) in signs {
                    add([(first, FRAC_1_SQRT_2 * a), (second, FRAC_1_SQRT_2 * b)]);
                }
            }
        }
    }
    steps
}

/// Returns the sets of sides that meet on the faces of the box of `rank` sides each: corners for a
/// rank of `D`.
pub(crate) fn faces<const D: usize>(rank: usize) -> impl Iterator<Item = u8> {
    (0..1u8 << (2 * D)).filter(move |sides| {
        let (low, high) = (sides & ((1 << D) - 1), sides >> D);
        low & high == 0 && sides.count_ones() as usize == rank
    })
}

/// Grows a pseudo-regular lattice of spacing d(x) that fills the box `[0, extent]`, for `D` of 2 or
/// 3. Atoms on its sides have coordinates of exactly `0.0` or `extent[k]`. The lattice keeps its
/// distance from `fixed` atoms (which are in the box, and not in the result) and grows from them.
/// Each rank must know d in its [required range](required_range) and along the box's edges. Returns
/// the positions of the atoms in this rank's slab, each with the count of atoms that were added
/// before it.
///
/// # Errors
/// Returns an error if another rank fails.
pub fn grow_lattice<const D: usize>(
    shared_box: SharedBox<'_, D>,
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    cancel: &CancelToken<'_>,
) -> Result<Vec<([f64; D], u32)>> {
    let extent = shared_box.extent;
    let mut lattice = GrowingLattice::new(shared_box, distance, alignment);
    // From corners to the inside; each time the fixed atoms that lie there come first.
    for rank in (0..=D).rev() {
        if rank + 2 == D {
            lattice.drop_distant();
        }
        let old_count = lattice.global_count;
        for &x in fixed.iter().filter(|&&x| side_count(x, extent) == rank) {
            let side_bits =
                (0..D).map(|k| u8::from(x[k] <= 0.0) << k | u8::from(x[k] >= extent[k]) << (D + k));
            let sides = side_bits.fold(0, |all, side| all | side);
            lattice.add(x, sides, true);
        }
        let count = lattice.global_count;
        for sides in faces::<D>(rank) {
            if rank == D {
                let corner =
                    std::array::from_fn(|k| if sides >> k & 1 == 1 { 0.0 } else { extent[k] });
                let x = lattice.snap_to_sides(corner, sides);
                if lattice.atoms.is_free(&x, 1e-3 * lattice.min_d) {
                    lattice.add(x, sides, false);
                }
            } else if rank + 1 == D {
                let fixed_axes = sides | sides >> D;
                for axis in (0..D).filter(|&k| fixed_axes >> k & 1 == 0) {
                    for atom in lattice.edge_atoms(axis, sides) {
                        if lattice
                            .atoms
                            .is_free(&atom, MIN_SITE_DISTANCE * distance.value_at(atom))
                        {
                            lattice.add(atom, sides, false);
                        }
                    }
                }
            } else {
                let atoms_on = |indices: std::ops::Range<u32>| -> Vec<u32> {
                    let infos = (0..).zip(&lattice.infos);
                    let matching = infos.filter(|(_, info)| info.sides & sides == sides);
                    let matching = matching.filter(|(_, info)| indices.contains(&info.index));
                    matching.map(|(n, _)| n).collect()
                };
                let (mut seeds, boundary) = (atoms_on(old_count..count), atoms_on(0..old_count));
                if rank == 0 && old_count == count {
                    seeds.extend(lattice.add_centre()?);
                }
                lattice.grow(seeds, sides, cancel)?;
                lattice.grow(boundary, sides, cancel)?;
            }
        }
    }
    let atoms = lattice.atoms.positions().iter().zip(&lattice.infos);
    let owned = atoms.filter(|(x, info)| !info.is_fixed && shared_box.is_in_slab(x[D - 1]));
    Ok(owned.map(|(x, info)| (*x, info.index)).collect())
}

#[cfg(test)]
#[path = "grow_tests.rs"]
pub(crate) mod tests;
