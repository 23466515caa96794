//! The regular lattice along a curve, of which each of a group has a share and none more.
//!
//! Where a site is follows from its number, so that all can look at all sites, and keep their own.

use crate::parallel::prelude::*;

use super::Alignment;
use super::curve_order::{CurvePartition, MAX_SEGMENTS};
use super::densest_lattice::LatticeSites;
use super::fixed_atoms::{self, Clearance};
use super::morton::MortonCurve;
use crate::comm::Comm;
use crate::error::Result;
use crate::lattice::distance::Distance;
use crate::lattice::partition::OwnedAtoms;

/// A share of the densest lattice whose nearest neighbours are `distance` apart, the same everywhere, in the order of a
/// space-filling curve; fixed atoms, for which others make room, come last.
///
/// # Errors
/// Those of [`seed`](super::seed).
pub fn place_atoms<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    group: &dyn Comm,
) -> Result<OwnedAtoms<D>> {
    distance.validate(extent)?;
    let fixed = fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let lattice = CurveLattice {
        sites: LatticeSites::fit(extent, distance.min(), alignment),
        curve: MortonCurve::new(extent, 2.0 * distance.min()),
        clearance: Clearance::new(&fixed, extent, distance),
    };
    let (turns, sites) = match group.size() {
        // One alone has all, and need not count.
        1 => {
            let sites = lattice.sorted_sites(0..usize::MAX);
            (CurvePartition::new(vec![sites.len()], fixed.len()), sites)
        }
        count => {
            let turns = CurvePartition::new(lattice.segment_counts(), fixed.len());
            let sites = lattice.sorted_sites(turns.segments(group.rank(), count));
            (turns, sites)
        }
    };
    let positions = sites.par_iter();
    let positions = positions.map(|&(_, site)| lattice.sites.position(site));
    let positions = positions.collect();
    drop(sites);
    Ok(turns.local_partition(positions, extent, &fixed, group))
}

/// The sites of a lattice along a curve.
struct CurveLattice<'a, const D: usize> {
    sites: LatticeSites<D>,
    curve: MortonCurve<D>,
    clearance: Clearance<'a, D>,
}

impl<const D: usize> CurveLattice<'_, D> {
    /// The sites of a row that stay, each with its place along the curve.
    fn row(&self, row: usize) -> impl Iterator<Item = (u64, u64)> {
        self.sites.row(row).filter_map(|site| {
            let x = self.sites.position(site);
            self.clearance.allows(&x).then(|| (self.curve.key(x), site))
        })
    }

    /// The sites of some stretches, in the order of the curve.
    fn sorted_sites(&self, stretches: std::ops::Range<usize>) -> Vec<(u64, u64)> {
        let wanted =
            |(key, _): &(u64, u64)| stretches.contains(&self.curve.segment(*key, MAX_SEGMENTS));
        let rows = (0..self.sites.row_count()).into_par_iter();
        let mut sites: Vec<(u64, u64)> = rows
            .flat_map_iter(|row| self.row(row).filter(&wanted))
            .collect();
        sites.par_sort_unstable();
        sites
    }

    /// How many sites each stretch has.
    fn segment_counts(&self) -> Vec<usize> {
        let rows = (0..self.sites.row_count()).into_par_iter();
        let none = || vec![0; MAX_SEGMENTS];
        rows.fold(none, |mut counts, row| {
            (self.row(row)).for_each(|(key, _)| counts[self.curve.segment(key, MAX_SEGMENTS)] += 1);
            counts
        })
        .reduce(none, |mut sum, counts| {
            sum.iter_mut().zip(counts).for_each(|(sum, n)| *sum += n);
            sum
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{fcc, morton};
    use super::*;
    use crate::comm::run_threads;
    use crate::lattice::energy::CHUNK_ATOMS;
    use crate::lattice::seeding::Atoms;

    #[test]
    fn shares_of_the_lattice_are_the_lattice_in_turn() {
        let fixed = [[20.0, 21.0, 22.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for (extent, d, fixed) in [
            ([90.0, 50.0, 60.0], 3.0, &fixed[..]),
            ([260.0, 33.0, 21.0], 2.5, &[]),
            ([20.0, 21.0, 23.0], 5.0, &[]),
        ] {
            let distance = Distance::Constant(d);
            let whole = fcc(extent, &distance, fixed, Alignment::OnFeatures).unwrap();
            let mut sites =
                super::super::densest_lattice::fit_lattice(extent, d, Alignment::OnFeatures);
            morton::sort_by_curve(&mut sites, extent, 2.0 * d);
            let mut atoms = Atoms::from_positions(sites, extent);
            fixed_atoms::insert(&mut atoms, fixed, extent, &distance);
            assert!(whole == atoms, "{extent:?}");
            for count in [2, 3, 7] {
                let shares = run_threads(count, |group| {
                    place_atoms(extent, &distance, fixed, Alignment::OnFeatures, group).unwrap()
                });
                let mut all = Atoms::default();
                for share in shares {
                    assert_eq!(
                        (share.first_index, share.global_count),
                        (all.len(), whole.len())
                    );
                    assert!(
                        share.atoms.len() <= (whole.len() / CHUNK_ATOMS / count + 2) * CHUNK_ATOMS
                    );
                    all.append(share.atoms);
                }
                assert!(all == whole, "{extent:?}, {count}");
            }
        }
    }
}
