//! A pseudo-regular lattice for variable d: Hale 2001, Algorithm 2, with exact sides.
//!
//! Atoms grow the lattice in the order in which they came: an atom proposes the sites that its neighbours would have in
//! the densest regular lattice of spacing d(x), face-centred cubic or triangular, and a site becomes
//! an atom if no atom is nearer than 0.8 d. Hale marks spheres in a volume of flags; here atoms are
//! kept in a grid of cells. Hale's sites are d(x) away from an atom at x; here the mean of d at both ends,
//! so that more of them fall together where d varies.
//!
//! The box comes first, so that it is filled exactly: its corners; atoms along its edges, in 3-D
//! sqrt 2 d apart as on the edges of a (100) box; in 3-D atoms in its sides, grown from the edges as
//! centred squares. Then the inside grows from its fixed atoms or, if there are none, from its centre, as
//! in Hale: one front, which nothing meets but the sides, leaves a lattice without grain boundaries. What
//! room is left beside the sides is filled from these.
//!
//! Alongside, the same happens on a box that is half a d smaller on every side.

//! A group grows it together, each in a slab of the box: it knows the atoms within two d of its slab and so the sites
//! that these propose, decides about those in its slab, and waits for what others say of earlier ones nearby. The
//! atoms are those of one alone, whatever the number of ranks.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use super::refine::graded_positions;
use super::{Alignment, MIN_SITE_DISTANCE, SIDE_MARGIN, empty_grid, side_count};
use crate::comm::Comm;
use crate::error::Result;
use crate::geometry::distance2;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::lattice::distance::Distance;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Atoms of which one thread looks at the sites at least.
const MIN_ATOMS_PER_THREAD: usize = 64;
/// How far from its slab one of a group knows atoms, in units of the largest d: what they propose is one d away from
/// them, and depends on others 0.8 d from there.
const HALO_WIDTH_RATIO: f64 = 2.0;

/// The slab of the box, along its last axis, that is one of a group's to fill.
struct GrowthSlab<'a> {
    length: f64,
    comm: &'a dyn Comm,
}

impl GrowthSlab<'_> {
    /// The slab of one of the group.
    fn range(&self, rank: usize) -> [f64; 2] {
        let count = self.comm.size();
        let at = |end: usize| match end {
            0 => f64::NEG_INFINITY,
            end if end == count => f64::INFINITY,
            end => self.length * end as f64 / count as f64,
        };
        [at(rank), at(rank + 1)]
    }

    /// Whether a height is no farther than `reach` from the slab of one of the group.
    fn is_near(&self, rank: usize, height: f64, reach: f64) -> bool {
        let [low, high] = self.range(rank);
        low - reach <= height && height < high + reach
    }

    /// Whether a height is in the slab of this one.
    fn contains(&self, height: f64) -> bool {
        self.is_near(self.comm.rank(), height, 0.0)
    }
}

/// From where to where along the last axis one of a group must know d, the largest of which is `most`.
pub fn required_range(length: f64, most: f64, group: &dyn Comm) -> [f64; 2] {
    let [low, high] = GrowthSlab {
        length,
        comm: group,
    }
    .range(group.rank());
    // Sites are one d from atoms, and a little more where it is not yet known how large d is there.
    let reach = (HALO_WIDTH_RATIO + 2.0) * most;
    [(low - reach).max(0.0), (high + reach).min(length)]
}

/// What is known of an atom but its place.
struct AtomInfo {
    /// The sides that it belongs to: bit k for the near one along axis k, bit `D + k` for the far one.
    sides: u8,
    is_fixed: bool,
    /// How many came before it.
    index: u32,
}

impl AtomInfo {
    /// An atom on some sides, not yet numbered.
    fn on_sides(sides: u8) -> Self {
        Self {
            sides,
            is_fixed: false,
            index: 0,
        }
    }
}

/// A place that an atom proposes.
struct ProposedSite<const D: usize> {
    x: [f64; D],
    /// No atom may be nearer.
    min_distance: f64,
    /// Number of the atom that proposes it, and of its step: what comes first has the place.
    priority: u64,
}

/// A lattice that grows.
struct GrowingLattice<'a, const D: usize> {
    distance: &'a Distance<D>,
    extent: [f64; D],
    /// How far inside the box its outermost atoms are, in units of d.
    inset: f64,
    slab: GrowthSlab<'a>,
    /// The atoms that are known here.
    atoms: IncrementalGrid<D>,
    infos: Vec<AtomInfo>,
    /// Whether only those that are near are kept.
    drops_distant: bool,
    /// Atoms of all of the group.
    global_count: u32,
    /// Sites about which nothing is decided yet.
    open_sites: IncrementalGrid<D>,
    /// The smallest and the largest d.
    min_d: f64,
    max_d: f64,
}

impl<'a, const D: usize> GrowingLattice<'a, D> {
    fn new(
        extent: [f64; D],
        distance: &'a Distance<D>,
        alignment: Alignment,
        group: &'a dyn Comm,
    ) -> Self {
        let min_d = distance.min();
        let length = extent[D - 1];
        Self {
            distance,
            extent,
            inset: match alignment {
                Alignment::OnFeatures => 0.0,
                Alignment::AlongsideFeatures => 0.5,
            },
            slab: GrowthSlab {
                length,
                comm: group,
            },
            atoms: empty_grid([0.0; D], extent, MIN_SITE_DISTANCE * min_d),
            infos: Vec::new(),
            drops_distant: false,
            global_count: 0,
            open_sites: IncrementalGrid::new([0.0; D], [0.0; D], min_d),
            min_d,
            max_d: distance.max(),
        }
    }

    /// Adds an atom of which all of the group know, to those that are known here if it is near.
    fn add(&mut self, x: [f64; D], sides: u8, is_fixed: bool) -> Option<u32> {
        let number = self.global_count;
        self.global_count += 1;
        let known = AtomInfo {
            sides,
            is_fixed,
            index: number,
        };
        let is_near = !self.drops_distant || self.is_local(&x);
        is_near.then(|| self.add_local(x, known))
    }

    fn add_local(&mut self, x: [f64; D], known: AtomInfo) -> u32 {
        self.infos.push(known);
        self.atoms.add(x)
    }

    /// Whether this one of the group knows the atoms at a place.
    fn is_local(&self, x: &[f64; D]) -> bool {
        let (rank, reach) = (self.slab.comm.rank(), HALO_WIDTH_RATIO * self.max_d);
        self.slab.is_near(rank, x[D - 1], reach)
    }

    /// Forgets atoms that are not near.
    fn drop_distant(&mut self) {
        if self.slab.comm.size() == 1 {
            return;
        }
        self.drops_distant = true;
        let [low, high] = self.slab.range(self.slab.comm.rank());
        let reach = HALO_WIDTH_RATIO * self.max_d;
        let (mut from, mut to) = ([0.0; D], self.extent);
        from[D - 1] = (low - reach).max(0.0);
        to[D - 1] = (high + reach).min(to[D - 1]);
        let some = empty_grid(from, to, MIN_SITE_DISTANCE * self.min_d);
        self.open_sites = some.clone();
        let all = std::mem::replace(&mut self.atoms, some);
        let known = std::mem::take(&mut self.infos);
        for (x, known) in all.positions().iter().zip(known) {
            if self.is_local(x) {
                self.add_local(*x, known);
            }
        }
    }

    /// Where the near and far ends of the lattice are along an axis at a place where d is `d`.
    fn ends(&self, k: usize, d: f64) -> [f64; 2] {
        [self.inset * d, self.extent[k] - self.inset * d]
    }

    /// Puts a point onto the given sides of the lattice.
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

    /// Grows a lattice from some atoms, over the whole box or over the given `sides` of it. Atoms propose sites in the
    /// order in which they came: so all that came in one round may propose at once, and of what they propose most is
    /// taken by atoms of earlier rounds.
    fn grow(&mut self, mut front: Vec<u32>, sides: u8, patience: &CancelToken<'_>) -> Result<()> {
        let along: Vec<usize> = (0..D)
            .filter(|&k| (sides | sides >> D) >> k & 1 == 0)
            .collect();
        let steps = neighbour_steps::<D>(&along);
        loop {
            let own: Vec<(bool, bool)> = (self.slab.comm)
                .all_gather("a lattice", (!front.is_empty(), patience.is_cancelled()))?;
            if !own.iter().any(|(grows, _)| *grows) || own.iter().any(|(_, over)| *over) {
                return Ok(());
            }
            front.sort_unstable_by_key(|&n| self.infos[n as usize].index);
            let atoms = front.par_iter().with_min_len(MIN_ATOMS_PER_THREAD);
            let sites = atoms.flat_map_iter(|&n| self.propose_sites(n, &steps, &along, sides));
            let sites: Vec<ProposedSite<D>> = sites.collect();
            front = self.accept_sites(&sites, sides)?;
        }
    }

    /// The sites round an atom that are inside, along those axes, and free, as far as it is for this one of the group
    /// to know.
    fn propose_sites(
        &self,
        n: u32,
        steps: &[[f64; D]],
        along: &[usize],
        sides: u8,
    ) -> impl Iterator<Item = ProposedSite<D>> {
        let from = self.atoms.positions()[n as usize];
        let number = u64::from(self.infos[n as usize].index);
        let (rank, reach) = (self.slab.comm.rank(), MIN_SITE_DISTANCE * self.max_d);
        let d = self.distance.value_at(from);
        steps.iter().enumerate().filter_map(move |(turn, step)| {
            // As far away as d asks for at both ends: then a neighbour asks for the same pair.
            let after =
                |d: f64| self.snap_to_sides(std::array::from_fn(|k| from[k] + d * step[k]), sides);
            let x = after(0.5 * (d + self.distance.value_at(after(d))));
            if !self.slab.is_near(rank, x[D - 1], reach) {
                return None;
            }
            let d = self.distance.value_at(x);
            let inside = along.iter().all(|&k| {
                let [low, high] = self.ends(k, d);
                x[k] >= low + SIDE_MARGIN * d && x[k] <= high - SIDE_MARGIN * d
            });
            let site = ProposedSite {
                x,
                min_distance: MIN_SITE_DISTANCE * d,
                priority: number << 8 | turn as u64,
            };
            (inside && self.atoms.is_free(&x, site.min_distance)).then_some(site)
        })
    }

    /// The atoms that come of sites, in their order: of these each is taken that has room among all that were before it.
    fn accept_sites(&mut self, sites: &[ProposedSite<D>], sides: u8) -> Result<Vec<u32>> {
        let (group, before) = (self.slab.comm, self.infos.len());
        // Those here are decided about here; of others it is heard.
        let (mut left, mut others): (Vec<&ProposedSite<D>>, Vec<&ProposedSite<D>>) =
            (sites.iter()).partition(|site| self.slab.contains(site.x[D - 1]));
        let mut atoms: Vec<(u64, u32)> = Vec::new();
        let mut turns: Vec<u64> = Vec::new();
        let mut take = |lattice: &mut Self, turns: &mut Vec<u64>, site: &ProposedSite<D>| {
            atoms.push((
                site.priority,
                lattice.add_local(site.x, AtomInfo::on_sides(sides)),
            ));
            turns.push(site.priority);
        };
        loop {
            self.open_sites.clear();
            others
                .iter()
                .for_each(|site| _ = self.open_sites.add(site.x));
            let mut open: Vec<u64> = others.iter().map(|site| site.priority).collect();
            let mut told: Vec<Vec<(u64, bool)>> = vec![Vec::new(); group.size()];
            left.retain(|site| {
                let earlier = |n: usize| n >= before && turns[n - before] < site.priority;
                let has_room = !self.has_atom_near(site, earlier);
                if has_room && self.has_open_site_near(site, &open) {
                    self.open_sites.add(site.x);
                    open.push(site.priority);
                    return true;
                }
                if has_room {
                    take(self, &mut turns, site);
                }
                for (rank, told) in told.iter_mut().enumerate() {
                    let near =
                        self.slab
                            .is_near(rank, site.x[D - 1], MIN_SITE_DISTANCE * self.max_d);
                    if rank != group.rank() && near {
                        told.push((site.priority, has_room));
                    }
                }
                false
            });
            let mut heard = group.all_to_all("sites taken", told)?.concat();
            heard.sort_unstable();
            others.retain(|site| {
                let Ok(at) = heard.binary_search_by_key(&site.priority, |of| of.0) else {
                    return true;
                };
                if heard[at].1 {
                    take(self, &mut turns, site);
                }
                false
            });
            let open: Vec<bool> = group.all_gather("sites left", !left.is_empty())?;
            if !open.contains(&true) {
                break;
            }
        }
        self.number_atoms(atoms, sides)
    }

    /// Whether an atom that will do is in the room of a site.
    fn has_atom_near(&self, site: &ProposedSite<D>, will_do: impl Fn(usize) -> bool) -> bool {
        let (positions, room2) = (
            self.atoms.positions(),
            site.min_distance * site.min_distance,
        );
        self.atoms.any_near(&site.x, site.min_distance, |n| {
            will_do(n) && distance2(&positions[n], &site.x) < room2
        })
    }

    /// Whether in the room of a site there is an earlier one about which nothing is decided.
    fn has_open_site_near(&self, site: &ProposedSite<D>, turns: &[u64]) -> bool {
        let (positions, room2) = (
            self.open_sites.positions(),
            site.min_distance * site.min_distance,
        );
        !positions.is_empty()
            && self.open_sites.any_near(&site.x, site.min_distance, |n| {
                turns[n] < site.priority && distance2(&positions[n], &site.x) < room2
            })
    }

    /// The atoms of a round, each with its turn, as they are known when all of the group have told one another of those
    /// nearby, with their numbers.
    fn number_atoms(&mut self, mut atoms: Vec<(u64, u32)>, sides: u8) -> Result<Vec<u32>> {
        let group = self.slab.comm;
        atoms.sort_unstable();
        let mut turns: Vec<u64> = Vec::with_capacity(atoms.len());
        let mut told: Vec<Vec<(u64, [f64; D])>> = vec![Vec::new(); group.size()];
        for &(turn, n) in &atoms {
            let x = self.atoms.positions()[n as usize];
            if !self.slab.contains(x[D - 1]) {
                continue;
            }
            turns.push(turn);
            for (rank, told) in told.iter_mut().enumerate() {
                let near = |reach: f64| self.slab.is_near(rank, x[D - 1], reach * self.max_d);
                // They have heard of those that were in the way of theirs.
                if rank != group.rank() && near(HALO_WIDTH_RATIO) && !near(MIN_SITE_DISTANCE) {
                    told.push((turn, x));
                }
            }
        }
        for (turn, x) in group
            .all_to_all("atoms nearby", told)?
            .into_iter()
            .flatten()
        {
            atoms.push((turn, self.add_local(x, AtomInfo::on_sides(sides))));
        }
        let turns: Vec<Vec<u64>> = group.all_gather("turns of atoms", turns)?;
        for &(turn, n) in &atoms {
            let before = turns
                .iter()
                .map(|turns| turns.partition_point(|&t| t < turn));
            self.infos[n as usize].index = self.global_count + before.sum::<usize>() as u32;
        }
        self.global_count += turns.iter().map(Vec::len).sum::<usize>() as u32;
        Ok(atoms.into_iter().map(|(_, n)| n).collect())
    }

    /// Puts an atom in the middle, if there is room.
    fn add_centre(&mut self) -> Result<Option<u32>> {
        let x = self.extent.map(|l| 0.5 * l);
        let has_room = self.slab.contains(x[D - 1])
            && self
                .atoms
                .is_free(&x, MIN_SITE_DISTANCE * self.distance.value_at(x));
        let told: Vec<bool> = (self.slab.comm).all_gather("room in the middle", has_room)?;
        match told.contains(&true) {
            true => Ok(self.add(x, 0, false)),
            false => Ok(None),
        }
    }

    /// Atoms between the ends of the edge along `axis` that belongs to `sides`, evenly spread in
    /// units of d (in 3-D of sqrt 2 d).
    fn edge_atoms(&self, axis: usize, sides: u8) -> Vec<[f64; D]> {
        let at = |t: f64| {
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
        let near = self.ends(axis, self.distance.value_at(at(0.0)))[0];
        let far = self.ends(axis, self.distance.value_at(at(self.extent[axis])))[1];
        let unit = if D == 3 { SQRT_2 } else { 1.0 };
        let d = |t: f64| unit * self.distance.value_at(at(near + t));
        let places = graded_positions(far - near, self.min_d, d);
        places.into_iter().map(|t| at(near + t)).collect()
    }
}

/// The steps from an atom to its neighbours in the densest lattice of spacing 1 over the axes
/// `along`: all of them, or the two of a side in 3-D.
fn neighbour_steps<const D: usize>(along: &[usize]) -> Vec<[f64; D]> {
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
        for (place, &first) in along.iter().enumerate() {
            for &second in &along[place + 1..] {
                for (a, b) in signs {
                    add([(first, FRAC_1_SQRT_2 * a), (second, FRAC_1_SQRT_2 * b)]);
                }
            }
        }
    }
    steps
}

/// The sides that meet on the faces of the box of `rank` sides each: corners for a rank of `D`.
pub(super) fn faces<const D: usize>(rank: usize) -> impl Iterator<Item = u8> {
    (0..1u8 << (2 * D)).filter(move |sides| {
        let (near, far) = (sides & ((1 << D) - 1), sides >> D);
        near & far == 0 && sides.count_ones() as usize == rank
    })
}

/// Positions of a pseudo-regular lattice of spacing d(x) that fills the box `[0, extent]`, for `D`
/// of 2 or 3; atoms on its sides have coordinates of exactly `0.0` or `extent[k]`. Keeps its distance
/// from `fixed` atoms (which are in the box, and not in the result) and grows from them. Each of a group, which knows
/// d where it [looks](required_range) and along the box's edges, gives those of its slab; with each how many came before it.
///
/// # Errors
/// Those of the others of the group.
pub fn grow_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
) -> Result<Vec<([f64; D], u32)>> {
    let mut lattice = GrowingLattice::new(extent, distance, alignment, group);
    // From corners to the inside, each time the fixed atoms that lie there first.
    for rank in (0..=D).rev() {
        if rank + 2 == D {
            lattice.drop_distant();
        }
        let before = lattice.global_count;
        for &x in fixed.iter().filter(|&&x| side_count(x, extent) == rank) {
            let held =
                (0..D).map(|k| u8::from(x[k] <= 0.0) << k | u8::from(x[k] >= extent[k]) << (D + k));
            let sides = held.fold(0, |all, side| all | side);
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
                let held = sides | sides >> D;
                for axis in (0..D).filter(|&k| held >> k & 1 == 0) {
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
                let on = |numbers: std::ops::Range<u32>| -> Vec<u32> {
                    let known = (0..).zip(&lattice.infos);
                    let on = known.filter(|(_, known)| known.sides & sides == sides);
                    let on = on.filter(|(_, known)| numbers.contains(&known.index));
                    on.map(|(n, _)| n).collect()
                };
                let (mut seeds, rims) = (on(before..count), on(0..before));
                if rank == 0 && before == count {
                    seeds.extend(lattice.add_centre()?);
                }
                lattice.grow(seeds, sides, patience)?;
                lattice.grow(rims, sides, patience)?;
            }
        }
    }
    let atoms = lattice.atoms.positions().iter().zip(&lattice.infos);
    let own = atoms.filter(|(x, known)| !known.is_fixed && lattice.slab.contains(x[D - 1]));
    Ok(own.map(|(x, known)| (*x, known.index)).collect())
}

#[cfg(test)]
#[path = "grow_tests.rs"]
pub(super) mod tests;
