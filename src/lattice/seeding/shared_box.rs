//! The box of a lattice that ranks fill together: each grows atoms in its slab of the box. Then the
//! sites are distributed along a space-filling curve, in whole chunks of the lattice that they
//! become.

use std::ops::Range;

use crate::parallel::prelude::*;

use super::Atoms;
use super::fixed_atoms::Clearance;
use super::morton::MortonCurve;
use crate::comm::{Comm, SelfComm, concatenate};
use crate::error::Result;
use crate::files::codec::Codec;
use crate::lattice::AtomKind;
use crate::lattice::owned_atoms::{OwnedAtoms, owned_range};

/// Most segments of the curve whose sites are counted.
pub const MAX_SEGMENTS: usize = 1 << 16;

/// The box `[0, extent]`, of which each rank has a slab along the last axis. All ranks call the same methods in the
/// same order; `what` names a call, and must be the same on all ranks. Methods return the errors of other ranks.
#[derive(Clone, Copy)]
pub struct SharedBox<'b, const D: usize> {
    /// Length along each axis.
    pub extent: [f64; D],
    comm: &'b dyn Comm,
}

impl<const D: usize> SharedBox<'static, D> {
    /// Creates the box of one process, which fills all of it.
    pub fn of_one_process(extent: [f64; D]) -> Self {
        Self {
            extent,
            comm: &SelfComm,
        }
    }
}

impl<'b, const D: usize> SharedBox<'b, D> {
    /// Creates a box that the ranks of `comm` fill.
    pub fn new(extent: [f64; D], comm: &'b dyn Comm) -> Self {
        Self { extent, comm }
    }

    /// Returns `true` if several ranks fill the box.
    pub fn is_shared(&self) -> bool {
        self.comm.size() > 1
    }

    /// Returns the slab of a rank. The outermost slabs have no end.
    fn slab(&self, rank: usize) -> [f64; 2] {
        let count = self.comm.size();
        let boundary = |end: usize| match end {
            0 => f64::NEG_INFINITY,
            end if end == count => f64::INFINITY,
            end => self.extent[D - 1] * end as f64 / count as f64,
        };
        [boundary(rank), boundary(rank + 1)]
    }

    /// Returns the part of the box within `margin` of this rank's slab, along the last axis.
    pub fn slab_with_margin(&self, margin: f64) -> [f64; 2] {
        let [low, high] = self.slab(self.comm.rank());
        [
            (low - margin).max(0.0),
            (high + margin).min(self.extent[D - 1]),
        ]
    }

    /// Returns `true` if a height is within `margin` of the slab of a rank.
    fn is_near(&self, rank: usize, height: f64, margin: f64) -> bool {
        let [low, high] = self.slab(rank);
        low - margin <= height && height < high + margin
    }

    /// Returns `true` if a height is within `margin` of this rank's slab.
    pub fn is_near_slab(&self, height: f64, margin: f64) -> bool {
        self.is_near(self.comm.rank(), height, margin)
    }

    /// Returns `true` if a height is in this rank's slab.
    pub fn is_in_slab(&self, height: f64) -> bool {
        self.is_near_slab(height, 0.0)
    }

    /// Sends items, each with its height, to the other ranks whose slabs are within `margin` of it, except for ranks
    /// within `known_margin`, which know it already. Returns what this rank receives.
    pub fn send_near<T: Codec + Clone>(
        &self,
        what: &str,
        items: &[(f64, T)],
        margin: f64,
        known_margin: Option<f64>,
    ) -> Result<Vec<T>> {
        let is_receiver = |rank: usize, height: f64| {
            rank != self.comm.rank()
                && self.is_near(rank, height, margin)
                && !known_margin.is_some_and(|known| self.is_near(rank, height, known))
        };
        let items_for = |rank: usize| -> Vec<T> {
            let received = items.iter().filter(|item| is_receiver(rank, item.0));
            received.map(|(_, item)| item.clone()).collect()
        };
        let sent = (0..self.comm.size()).map(items_for).collect();
        Ok(concatenate(self.comm.all_to_all(what, sent)?))
    }

    /// Returns the items of all slabs, from those of this rank's slab.
    pub fn concatenated<T: Codec>(&self, what: &str, items: Vec<T>) -> Result<Vec<T>> {
        Ok(concatenate(self.comm.all_gather(what, items)?))
    }

    /// Returns for each condition `true` if it is met on any rank.
    pub fn any<const N: usize>(&self, what: &str, conditions: [bool; N]) -> Result<[bool; N]> {
        let all: Vec<[bool; N]> = self.comm.all_gather(what, conditions)?;
        Ok(std::array::from_fn(|k| all.iter().any(|met| met[k])))
    }

    /// Distributes sites, of which each rank has some with their indices, over the ranks along the
    /// curve. Sites of one cube of the curve are ordered by their indices. Fixed atoms come last;
    /// sites too near to them are removed.
    pub fn redistribute(
        self,
        mut sites: Vec<([f64; D], u32)>,
        curve: &MortonCurve<D>,
        fixed: &[[f64; D]],
        clearance: &Clearance<'_, D>,
    ) -> Result<OwnedAtoms<D>> {
        sites.retain(|(x, _)| clearance.allows(x));
        let segment = |x: [f64; D]| curve.segment(curve.key(x), MAX_SEGMENTS);
        let mut counts = Vec::new();
        if self.is_shared() {
            counts = vec![0u64; MAX_SEGMENTS];
            sites.iter().for_each(|(x, _)| counts[segment(*x)] += 1);
            counts = self.comm.all_reduce_sum("sites along a curve", counts)?;
        }
        let counts = || counts.into_iter().map(|n| n as usize).collect();
        let partition = CurvePartition::new(self, counts, fixed.len());
        if self.is_shared() {
            let messages = (0..self.comm.size()).map(|rank| -> Vec<([f64; D], u32)> {
                let segments = partition.segments(rank);
                let is_in = |(x, _): &&([f64; D], u32)| segments.contains(&segment(*x));
                sites.iter().filter(is_in).copied().collect()
            });
            let received = (self.comm).all_to_all("sites along a curve", messages.collect())?;
            sites = concatenate(received);
        }
        let keyed = sites.par_iter().enumerate();
        let keyed = keyed.map(|(n, (x, index))| (curve.key(*x), *index, n as u32));
        let mut order: Vec<(u64, u32, u32)> = keyed.collect();
        order.par_sort_unstable();
        let sorted = order.par_iter().map(|&(_, _, n)| sites[n as usize].0);
        Ok(partition.owned_atoms(sorted.collect(), fixed))
    }
}

/// The distribution of a lattice over ranks: sites along a curve, and fixed atoms after them.
pub struct CurvePartition<'b, const D: usize> {
    shared_box: SharedBox<'b, D>,
    /// Count of sites up to the end of each segment of the curve, if several ranks share them.
    segment_ends: Vec<usize>,
    fixed_count: usize,
}

impl<'b, const D: usize> CurvePartition<'b, D> {
    /// Creates the distribution from the count of sites in each segment, which one process does not
    /// need, and the count of fixed atoms.
    pub fn new(
        shared_box: SharedBox<'b, D>,
        segment_counts: impl FnOnce() -> Vec<usize>,
        fixed_count: usize,
    ) -> Self {
        let mut segment_ends = if shared_box.is_shared() {
            segment_counts()
        } else {
            Vec::new()
        };
        let mut total = 0;
        for count in &mut segment_ends {
            total += *count;
            *count = total;
        }
        Self {
            shared_box,
            segment_ends,
            fixed_count,
        }
    }

    /// Returns the count of sites.
    fn site_count(&self) -> usize {
        self.segment_ends.last().copied().unwrap_or(0)
    }

    /// Returns the sites and the fixed atoms of a rank, by their order along the curve.
    fn owned_range(&self, rank: usize) -> Range<usize> {
        let count = self.site_count() + self.fixed_count;
        owned_range(count, rank, self.shared_box.comm.size())
    }

    /// Returns the sites of a rank, by their order along the curve.
    fn site_range(&self, rank: usize) -> Range<usize> {
        let range = self.owned_range(rank);
        range.start.min(self.site_count())..range.end.min(self.site_count())
    }

    /// Returns the segments that contain the sites of a rank.
    fn segments(&self, rank: usize) -> Range<usize> {
        let sites = self.site_range(rank);
        let first = self.segment_ends.partition_point(|&end| end <= sites.start);
        if sites.is_empty() {
            first..first
        } else {
            first..self.segment_ends.partition_point(|&end| end < sites.end) + 1
        }
    }

    /// Returns the segments that contain the sites of this rank.
    pub fn owned_segments(&self) -> Range<usize> {
        if self.shared_box.is_shared() {
            self.segments(self.shared_box.comm.rank())
        } else {
            0..usize::MAX
        }
    }

    /// Returns the owned atoms of this rank. `sites` are all sites of the rank's segments in the
    /// order of the curve; the rank's own sites and fixed atoms are selected from them and from
    /// `fixed`.
    pub fn owned_atoms(&self, mut sites: Vec<[f64; D]>, fixed: &[[f64; D]]) -> OwnedAtoms<D> {
        let SharedBox { extent, comm } = self.shared_box;
        let with_fixed = |sites, fixed: &[[f64; D]]| {
            let mut atoms = Atoms::from_positions(sites, extent);
            atoms.positions.extend_from_slice(fixed);
            atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
            atoms
        };
        if !self.shared_box.is_shared() {
            return OwnedAtoms::from_global(with_fixed(sites, fixed), comm);
        }
        let (rank, site_count) = (comm.rank(), self.site_count());
        let site_range = self.site_range(rank);
        let first_segment = self.segments(rank).start;
        let start = first_segment
            .checked_sub(1)
            .map_or(0, |previous| self.segment_ends[previous]);
        sites.drain(..(site_range.start - start).min(sites.len()));
        sites.truncate(site_range.len());
        let range = self.owned_range(rank);
        let fixed_range =
            range.start.max(site_count) - site_count..range.end.max(site_count) - site_count;
        OwnedAtoms {
            atoms: with_fixed(sites, &fixed[fixed_range]),
            first_index: range.start,
            global_count: site_count + self.fixed_count,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SharedBox;
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
                    let shared_box = SharedBox::new(extent, comm);
                    seed_regular(shared_box, seeding, &distance, fixed, alignment, cancel).unwrap()
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
