//! The regular lattice along a curve, distributed over ranks. No rank stores more than the atoms
//! that it owns.
//!
//! The position of a site follows from its index, so that every rank can visit all sites and keep
//! its own.

use crate::parallel::prelude::*;

use super::Alignment;
use super::densest_lattice::LatticeSites;
use super::fixed_atoms::{self, Clearance};
use super::morton::MortonCurve;
use super::shared_box::{CurvePartition, MAX_SEGMENTS, SharedBox};
use crate::error::Result;
use crate::lattice::distance::Distance;
use crate::lattice::owned_atoms::OwnedAtoms;

/// Returns this rank's atoms of the densest lattice whose nearest neighbours are `distance` apart
/// (constant), in the order of a space-filling curve. Fixed atoms come last; lattice atoms too near
/// to them are removed.
///
/// # Errors
/// Returns an error as [`seed`](super::seed) does, or if another rank fails.
pub fn place_atoms<const D: usize>(
    shared_box: SharedBox<'_, D>,
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
) -> Result<OwnedAtoms<D>> {
    let extent = shared_box.extent;
    distance.validate(extent)?;
    let fixed = fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let lattice = CurveLattice {
        sites: LatticeSites::fit(extent, distance.min(), alignment),
        curve: MortonCurve::new(extent, 2.0 * distance.min()),
        clearance: Clearance::new(&fixed, extent, distance),
    };
    let counts = || lattice.segment_counts();
    let partition = CurvePartition::new(shared_box, counts, fixed.len());
    let sites = lattice.sorted_sites(partition.owned_segments());
    let positions = sites.par_iter();
    let positions = positions.map(|&(_, site)| lattice.sites.position(site));
    let positions = positions.collect();
    drop(sites);
    Ok(partition.owned_atoms(positions, &fixed))
}

/// The sites of a lattice along a curve.
struct CurveLattice<'a, const D: usize> {
    sites: LatticeSites<D>,
    curve: MortonCurve<D>,
    clearance: Clearance<'a, D>,
}

impl<const D: usize> CurveLattice<'_, D> {
    /// Returns the sites of a row that are not removed, each with its key along the curve.
    fn row(&self, row: usize) -> impl Iterator<Item = (u64, u64)> {
        self.sites.row(row).filter_map(|site| {
            let x = self.sites.position(site);
            self.clearance.allows(&x).then(|| (self.curve.key(x), site))
        })
    }

    /// Returns the sites of some segments, in the order of the curve.
    fn sorted_sites(&self, segments: std::ops::Range<usize>) -> Vec<(u64, u64)> {
        let is_wanted =
            |(key, _): &(u64, u64)| segments.contains(&self.curve.segment(*key, MAX_SEGMENTS));
        let rows = (0..self.sites.row_count()).into_par_iter();
        let mut sites: Vec<(u64, u64)> = rows
            .flat_map_iter(|row| self.row(row).filter(&is_wanted))
            .collect();
        sites.par_sort_unstable();
        sites
    }

    /// Returns the count of sites in each segment.
    fn segment_counts(&self) -> Vec<usize> {
        let rows = (0..self.sites.row_count()).into_par_iter();
        let zeros = || vec![0; MAX_SEGMENTS];
        rows.fold(zeros, |mut counts, row| {
            (self.row(row)).for_each(|(key, _)| counts[self.curve.segment(key, MAX_SEGMENTS)] += 1);
            counts
        })
        .reduce(zeros, |mut sum, counts| {
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
    fn partitions_are_the_lattice_in_order() {
        let fixed = [[20.0, 21.0, 22.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for (extent, d, fixed) in [
            ([90.0, 50.0, 60.0], 3.0, &fixed[..]),
            ([260.0, 33.0, 21.0], 2.5, &[]),
            ([20.0, 21.0, 23.0], 5.0, &[]),
        ] {
            let distance = Distance::Constant(d);
            let expected = fcc(extent, &distance, fixed, Alignment::OnFeatures).unwrap();
            let mut sites =
                super::super::densest_lattice::fit_lattice(extent, d, Alignment::OnFeatures);
            morton::sort_by_curve(&mut sites, extent, 2.0 * d);
            let mut atoms = Atoms::from_positions(sites, extent);
            fixed_atoms::insert(&mut atoms, fixed, extent, &distance);
            assert!(expected == atoms, "{extent:?}");
            for count in [2, 3, 7] {
                let partitions = run_threads(count, |comm| {
                    let shared_box = SharedBox::new(extent, comm);
                    place_atoms(shared_box, &distance, fixed, Alignment::OnFeatures).unwrap()
                });
                let mut gathered = Atoms::default();
                for owned in partitions {
                    assert_eq!(
                        (owned.first_index, owned.global_count),
                        (gathered.len(), expected.len())
                    );
                    assert!(
                        owned.atoms.len()
                            <= (expected.len() / CHUNK_ATOMS / count + 2) * CHUNK_ATOMS
                    );
                    gathered.append(owned.atoms);
                }
                assert!(gathered == expected, "{extent:?}, {count}");
            }
        }
    }
}
