//! Distribution of sites along a space-filling curve over ranks, in whole chunks of the lattice
//! that they become.

use std::ops::Range;

use crate::parallel::prelude::*;

use super::Atoms;
use super::fixed_atoms::Clearance;
use super::morton::MortonCurve;
use crate::comm::{Comm, concatenate};
use crate::error::Result;
use crate::lattice::AtomKind;
use crate::lattice::owned_atoms::{OwnedAtoms, owned_range};

/// Most segments of the curve whose sites are counted.
pub const MAX_SEGMENTS: usize = 1 << 16;

/// The distribution of a lattice over ranks: sites along a curve, and fixed atoms after them.
pub struct CurvePartition {
    /// Count of sites up to the end of each segment of the curve.
    segment_ends: Vec<usize>,
    fixed_count: usize,
}

impl CurvePartition {
    /// Creates the distribution from the count of sites in each segment and the count of fixed
    /// atoms.
    pub fn new(mut counts: Vec<usize>, fixed_count: usize) -> Self {
        let mut total = 0;
        for count in &mut counts {
            total += *count;
            *count = total;
        }
        Self {
            segment_ends: counts,
            fixed_count,
        }
    }

    /// Returns the count of sites.
    fn site_count(&self) -> usize {
        self.segment_ends.last().copied().unwrap_or(0)
    }

    /// Returns the sites of one of `rank_count` ranks, by their order along the curve.
    fn site_range(&self, rank: usize, rank_count: usize) -> Range<usize> {
        let range = owned_range(self.site_count() + self.fixed_count, rank, rank_count);
        range.start.min(self.site_count())..range.end.min(self.site_count())
    }

    /// Returns the segments that contain the sites of a rank.
    pub fn segments(&self, rank: usize, rank_count: usize) -> Range<usize> {
        let sites = self.site_range(rank, rank_count);
        let first = self.segment_ends.partition_point(|&end| end <= sites.start);
        if sites.is_empty() {
            first..first
        } else {
            first..self.segment_ends.partition_point(|&end| end < sites.end) + 1
        }
    }

    /// Returns the owned atoms of this rank. `sites` are all sites of the rank's segments in the
    /// order of the curve; the rank's own sites and fixed atoms are selected from them and from
    /// `fixed`.
    pub fn local_partition<const D: usize>(
        &self,
        mut sites: Vec<[f64; D]>,
        extent: [f64; D],
        fixed: &[[f64; D]],
        comm: &dyn Comm,
    ) -> OwnedAtoms<D> {
        let (rank, rank_count) = (comm.rank(), comm.size());
        let (site_range, site_count) = (self.site_range(rank, rank_count), self.site_count());
        let first_segment = self.segments(rank, rank_count).start;
        let start = first_segment
            .checked_sub(1)
            .map_or(0, |previous| self.segment_ends[previous]);
        sites.drain(..(site_range.start - start).min(sites.len()));
        sites.truncate(site_range.len());
        let global_count = site_count + self.fixed_count;
        let range = owned_range(global_count, rank, rank_count);
        let fixed_range =
            range.start.max(site_count) - site_count..range.end.max(site_count) - site_count;
        let mut atoms = Atoms::from_positions(sites, extent);
        atoms.positions.extend_from_slice(&fixed[fixed_range]);
        atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
        OwnedAtoms {
            atoms,
            first_index: range.start,
            global_count,
        }
    }
}

/// Distributes sites, of which each rank has some with their indices, over the ranks along the
/// curve. Sites of one cube of the curve are ordered by their indices. Fixed atoms come last; sites
/// too near to them are removed.
///
/// # Errors
/// Returns an error if another rank fails.
pub fn redistribute<const D: usize>(
    mut sites: Vec<([f64; D], u32)>,
    curve: &MortonCurve<D>,
    extent: [f64; D],
    fixed: &[[f64; D]],
    clearance: &Clearance<'_, D>,
    comm: &dyn Comm,
) -> Result<OwnedAtoms<D>> {
    sites.retain(|(x, _)| clearance.allows(x));
    let mut partition = CurvePartition::new(vec![sites.len()], fixed.len());
    if comm.size() > 1 {
        let segment = |x: [f64; D]| curve.segment(curve.key(x), MAX_SEGMENTS);
        let mut counts = vec![0u64; MAX_SEGMENTS];
        sites.iter().for_each(|(x, _)| counts[segment(*x)] += 1);
        let counts = comm.all_reduce_sum("sites along a curve", counts)?;
        partition = CurvePartition::new(
            counts.into_iter().map(|n| n as usize).collect(),
            fixed.len(),
        );
        let segments = (0..comm.size()).map(|rank| partition.segments(rank, comm.size()));
        let messages = segments.map(|segments| -> Vec<([f64; D], u32)> {
            let local_sites = sites
                .iter()
                .filter(|(x, _)| segments.contains(&segment(*x)));
            local_sites.copied().collect()
        });
        sites = concatenate(comm.all_to_all("sites along a curve", messages.collect())?);
    }
    let keyed = sites.par_iter().enumerate();
    let keyed = keyed.map(|(n, (x, index))| (curve.key(*x), *index, n as u32));
    let mut order: Vec<(u64, u32, u32)> = keyed.collect();
    order.par_sort_unstable();
    let sorted = order.par_iter().map(|&(_, _, n)| sites[n as usize].0);
    Ok(partition.local_partition(sorted.collect(), extent, fixed, comm))
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
    fn partitions_of_a_grown_lattice_are_the_lattice_in_order() {
        let extent = [90.0, 80.0, 170.0];
        let distance: Distance<3> = varying_distance(extent);
        let fixed = [[45.0, 41.0, 86.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for fixed in [&fixed[..], &[]] {
            let (alignment, cancel) = (Alignment::OnFeatures, &CancelToken::never());
            let expected = fcc(extent, &distance, fixed, alignment).unwrap();
            assert!(expected.len() > 3 * CHUNK_ATOMS, "{}", expected.len());
            for count in [2, 3, 7] {
                let partitions = run_threads(count, |comm| {
                    let seeding = Seeding::Fcc;
                    seed_regular(seeding, extent, &distance, fixed, alignment, cancel, comm)
                        .unwrap()
                });
                let mut gathered = Atoms::default();
                for owned in partitions {
                    assert_eq!(
                        (owned.first_index, owned.global_count),
                        (gathered.len(), expected.len())
                    );
                    gathered.append(owned.atoms);
                }
                assert!(gathered == expected, "{count}");
            }
        }
    }
}
