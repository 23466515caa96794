//! Sites in their turn along a curve, of which each of a group has a share: whole chunks of the lattice that they become.

use std::ops::Range;

use crate::parallel::prelude::*;

use super::Atoms;
use super::fixed::Room;
use super::order::Curve;
use crate::error::Result;
use crate::lattice::AtomKind;
use crate::lattice::share::{OwnAtoms, own_of};
use crate::ranks::{Group, Holders, joined};

/// Stretches of the curve whose sites are counted, at most.
pub const STRETCHES: usize = 1 << 16;

/// Which atoms of a lattice are whose: sites along a curve, and fixed atoms behind them.
pub struct Turns {
    /// How many sites there are up to the end of each stretch of the curve.
    ends: Vec<usize>,
    fixed: usize,
}

impl Turns {
    /// Of so many sites in each stretch, and so many fixed atoms.
    pub fn new(mut counts: Vec<usize>, fixed: usize) -> Self {
        let mut before = 0;
        for count in &mut counts {
            before += *count;
            *count = before;
        }
        Self {
            ends: counts,
            fixed,
        }
    }

    /// How many sites there are.
    fn sites(&self) -> usize {
        self.ends.last().copied().unwrap_or(0)
    }

    /// The sites of one of `count`, by their turn.
    fn of(&self, rank: usize, count: usize) -> Range<usize> {
        let own = own_of(self.sites() + self.fixed, rank, count);
        own.start.min(self.sites())..own.end.min(self.sites())
    }

    /// The stretches in which these are.
    pub fn stretches(&self, rank: usize, count: usize) -> Range<usize> {
        let own = self.of(rank, count);
        let first = self.ends.partition_point(|&end| end <= own.start);
        match own.is_empty() {
            true => first..first,
            false => first..self.ends.partition_point(|&end| end < own.end) + 1,
        }
    }

    /// The share of one of a group: of sites in the order of the curve, which are all of its stretches, its own, and its
    /// own of the fixed atoms.
    pub fn share<const D: usize>(
        &self,
        mut sites: Vec<[f64; D]>,
        extent: [f64; D],
        fixed: &[[f64; D]],
        group: &dyn Group,
    ) -> OwnAtoms<D> {
        let (rank, count) = (group.rank(), group.count());
        let (own, before) = (self.of(rank, count), self.sites());
        let first = self.stretches(rank, count).start;
        let start = first.checked_sub(1).map_or(0, |before| self.ends[before]);
        sites.drain(..(own.start - start).min(sites.len()));
        sites.truncate(own.len());
        let whole = before + self.fixed;
        let own = own_of(whole, rank, count);
        let of_fixed = own.start.max(before) - before..own.end.max(before) - before;
        let mut atoms = Atoms::in_box(sites, extent);
        atoms.positions.extend_from_slice(&fixed[of_fixed]);
        atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
        OwnAtoms {
            atoms,
            first: own.start,
            whole,
        }
    }
}

/// Of sites of which each of a group has some, with their numbers, its share along the curve, in the cubes of which they
/// go by their numbers. Fixed atoms, for which others make room, come last.
///
/// # Errors
/// Those of the others.
pub fn dealt<const D: usize>(
    mut sites: Vec<([f64; D], u32)>,
    curve: &Curve<D>,
    extent: [f64; D],
    (fixed, room): (&[[f64; D]], &Room<'_, D>),
    group: &dyn Group,
) -> Result<OwnAtoms<D>> {
    sites.retain(|(x, _)| room.leaves(x));
    let mut turns = Turns::new(vec![sites.len()], fixed.len());
    if group.count() > 1 {
        let stretch = |x: [f64; D]| curve.stretch(curve.key(x), STRETCHES);
        let mut counts = vec![0u64; STRETCHES];
        sites.iter().for_each(|(x, _)| counts[stretch(*x)] += 1);
        let counts = group.summed("sites along a curve", counts)?;
        turns = Turns::new(
            counts.into_iter().map(|n| n as usize).collect(),
            fixed.len(),
        );
        let wanted = (0..group.count()).map(|rank| turns.stretches(rank, group.count()));
        let to = wanted.map(|stretches| -> Vec<([f64; D], u32)> {
            let wanted = sites
                .iter()
                .filter(|(x, _)| stretches.contains(&stretch(*x)));
            wanted.copied().collect()
        });
        sites = joined(group.pass("sites along a curve", to.collect())?);
    }
    let keyed = sites.par_iter().enumerate();
    let keyed = keyed.map(|(at, (x, number))| (curve.key(*x), *number, at as u32));
    let mut order: Vec<(u64, u32, u32)> = keyed.collect();
    order.par_sort_unstable();
    let sorted = order.par_iter().map(|&(_, _, at)| sites[at as usize].0);
    Ok(turns.share(sorted.collect(), extent, fixed, group))
}

#[cfg(test)]
mod tests {
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::CHUNK;
    use crate::lattice::seeding::grow::tests::varying;
    use crate::lattice::seeding::{Alignment, Atoms, Seeding, fcc, regularly};
    use crate::observer::Patience;
    use crate::ranks::shared;

    #[test]
    fn shares_of_a_grown_lattice_are_the_lattice_in_turn() {
        let extent = [90.0, 80.0, 170.0];
        let distance: Distance<3> = varying(extent);
        let fixed = [[45.0, 41.0, 86.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for fixed in [&fixed[..], &[]] {
            let (on, patience) = (Alignment::On, &Patience::endless());
            let whole = fcc(extent, &distance, fixed, on).unwrap();
            assert!(whole.len() > 3 * CHUNK, "{}", whole.len());
            for count in [2, 3, 7] {
                let shares = shared(count, |group| {
                    let how = Seeding::Fcc;
                    regularly(how, extent, &distance, fixed, on, patience, group).unwrap()
                });
                let mut all = Atoms::default();
                for share in shares {
                    assert_eq!((share.first, share.whole), (all.len(), whole.len()));
                    all.append(share.atoms);
                }
                assert!(all == whole, "{count}");
            }
        }
    }
}
