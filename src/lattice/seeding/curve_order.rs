//! Sites in their turn along a curve, of which each of a group has a share: whole chunks of the lattice that they become.

use std::ops::Range;

use crate::parallel::prelude::*;

use super::Atoms;
use super::fixed_atoms::Clearance;
use super::morton::MortonCurve;
use crate::comm::{Comm, LocalOrComm, concatenate};
use crate::error::Result;
use crate::lattice::AtomKind;
use crate::lattice::partition::{OwnedAtoms, owned_range};

/// Stretches of the curve whose sites are counted, at most.
pub const MAX_SEGMENTS: usize = 1 << 16;

/// Which atoms of a lattice are whose: sites along a curve, and fixed atoms behind them.
pub struct CurvePartition {
    /// How many sites there are up to the end of each stretch of the curve.
    segment_ends: Vec<usize>,
    fixed_count: usize,
}

impl CurvePartition {
    /// Of so many sites in each stretch, and so many fixed atoms.
    pub fn new(mut counts: Vec<usize>, fixed_count: usize) -> Self {
        let mut before = 0;
        for count in &mut counts {
            before += *count;
            *count = before;
        }
        Self {
            segment_ends: counts,
            fixed_count,
        }
    }

    /// How many sites there are.
    fn site_count(&self) -> usize {
        self.segment_ends.last().copied().unwrap_or(0)
    }

    /// The sites of one of `count`, by their turn.
    fn site_range(&self, rank: usize, count: usize) -> Range<usize> {
        let own = owned_range(self.site_count() + self.fixed_count, rank, count);
        own.start.min(self.site_count())..own.end.min(self.site_count())
    }

    /// The stretches in which these are.
    pub fn segments(&self, rank: usize, count: usize) -> Range<usize> {
        let own = self.site_range(rank, count);
        let first = self.segment_ends.partition_point(|&end| end <= own.start);
        match own.is_empty() {
            true => first..first,
            false => first..self.segment_ends.partition_point(|&end| end < own.end) + 1,
        }
    }

    /// The share of one of a group: of sites in the order of the curve, which are all of its stretches, its own, and its
    /// own of the fixed atoms.
    pub fn local_partition<const D: usize>(
        &self,
        mut sites: Vec<[f64; D]>,
        extent: [f64; D],
        fixed: &[[f64; D]],
        group: &dyn Comm,
    ) -> OwnedAtoms<D> {
        let (rank, count) = (group.rank(), group.size());
        let (own, before) = (self.site_range(rank, count), self.site_count());
        let first = self.segments(rank, count).start;
        let start = first
            .checked_sub(1)
            .map_or(0, |before| self.segment_ends[before]);
        sites.drain(..(own.start - start).min(sites.len()));
        sites.truncate(own.len());
        let whole = before + self.fixed_count;
        let own = owned_range(whole, rank, count);
        let of_fixed = own.start.max(before) - before..own.end.max(before) - before;
        let mut atoms = Atoms::from_positions(sites, extent);
        atoms.positions.extend_from_slice(&fixed[of_fixed]);
        atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
        OwnedAtoms {
            atoms,
            first_index: own.start,
            global_count: whole,
        }
    }
}

/// Of sites of which each of a group has some, with their numbers, its share along the curve, in the cubes of which they
/// go by their numbers. Fixed atoms, for which others make room, come last.
///
/// # Errors
/// Those of the others.
pub fn redistribute<const D: usize>(
    mut sites: Vec<([f64; D], u32)>,
    curve: &MortonCurve<D>,
    extent: [f64; D],
    (fixed, room): (&[[f64; D]], &Clearance<'_, D>),
    group: &dyn Comm,
) -> Result<OwnedAtoms<D>> {
    sites.retain(|(x, _)| room.allows(x));
    let mut turns = CurvePartition::new(vec![sites.len()], fixed.len());
    if group.size() > 1 {
        let stretch = |x: [f64; D]| curve.segment(curve.key(x), MAX_SEGMENTS);
        let mut counts = vec![0u64; MAX_SEGMENTS];
        sites.iter().for_each(|(x, _)| counts[stretch(*x)] += 1);
        let counts = group.all_reduce_sum("sites along a curve", counts)?;
        turns = CurvePartition::new(
            counts.into_iter().map(|n| n as usize).collect(),
            fixed.len(),
        );
        let wanted = (0..group.size()).map(|rank| turns.segments(rank, group.size()));
        let to = wanted.map(|stretches| -> Vec<([f64; D], u32)> {
            let wanted = sites
                .iter()
                .filter(|(x, _)| stretches.contains(&stretch(*x)));
            wanted.copied().collect()
        });
        sites = concatenate(group.all_to_all("sites along a curve", to.collect())?);
    }
    let keyed = sites.par_iter().enumerate();
    let keyed = keyed.map(|(at, (x, number))| (curve.key(*x), *number, at as u32));
    let mut order: Vec<(u64, u32, u32)> = keyed.collect();
    order.par_sort_unstable();
    let sorted = order.par_iter().map(|&(_, _, at)| sites[at as usize].0);
    Ok(turns.local_partition(sorted.collect(), extent, fixed, group))
}

#[cfg(test)]
mod tests {
    use crate::comm::run_threads;
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::CHUNK_ATOMS;
    use crate::lattice::seeding::grow::tests::varying_distance;
    use crate::lattice::seeding::{Alignment, Atoms, Seeding, fcc, seed_regular};
    use crate::progress::CancelToken;

    #[test]
    fn shares_of_a_grown_lattice_are_the_lattice_in_turn() {
        let extent = [90.0, 80.0, 170.0];
        let distance: Distance<3> = varying_distance(extent);
        let fixed = [[45.0, 41.0, 86.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for fixed in [&fixed[..], &[]] {
            let (on, patience) = (Alignment::OnFeatures, &CancelToken::never());
            let whole = fcc(extent, &distance, fixed, on).unwrap();
            assert!(whole.len() > 3 * CHUNK_ATOMS, "{}", whole.len());
            for count in [2, 3, 7] {
                let shares = run_threads(count, |group| {
                    let how = Seeding::Fcc;
                    seed_regular(how, extent, &distance, fixed, on, patience, group).unwrap()
                });
                let mut all = Atoms::default();
                for share in shares {
                    assert_eq!(
                        (share.first_index, share.global_count),
                        (all.len(), whole.len())
                    );
                    all.append(share.atoms);
                }
                assert!(all == whole, "{count}");
            }
        }
    }
}
