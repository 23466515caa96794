//! The regular lattice along a curve, of which each of a group has a share and none more.
//!
//! Where a site is follows from its number, so that all can look at all sites, and keep their own.

use crate::parallel::prelude::*;

use super::Alignment;
use super::fixed::{self, Room};
use super::lattice::Sites;
use super::order::Curve;
use super::turns::{STRETCHES, Turns};
use crate::error::Result;
use crate::lattice::distance::Distance;
use crate::lattice::share::OwnAtoms;
use crate::ranks::Group;

/// A share of the densest lattice whose nearest neighbours are `distance` apart, the same everywhere, in the order of a
/// space-filling curve; fixed atoms, for which others make room, come last.
///
/// # Errors
/// Those of [`seed`](super::seed).
pub fn seeded<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    group: &dyn Group,
) -> Result<OwnAtoms<D>> {
    distance.validate(extent)?;
    let fixed = fixed::checked(fixed, extent, distance, alignment)?;
    let lattice = Lattice {
        sites: Sites::fitted(extent, distance.min(), alignment),
        curve: Curve::new(extent, 2.0 * distance.min()),
        room: Room::new(&fixed, extent, distance),
    };
    let (turns, sites) = match group.count() {
        // One alone has all, and need not count.
        1 => {
            let sites = lattice.sorted(0..usize::MAX);
            (Turns::new(vec![sites.len()], fixed.len()), sites)
        }
        count => {
            let turns = Turns::new(lattice.counts(), fixed.len());
            let sites = lattice.sorted(turns.stretches(group.rank(), count));
            (turns, sites)
        }
    };
    let positions = sites.par_iter();
    let positions = positions.map(|&(_, site)| lattice.sites.position(site));
    let positions = positions.collect();
    drop(sites);
    Ok(turns.share(positions, extent, &fixed, group))
}

/// The sites of a lattice along a curve.
struct Lattice<'a, const D: usize> {
    sites: Sites<D>,
    curve: Curve<D>,
    room: Room<'a, D>,
}

impl<const D: usize> Lattice<'_, D> {
    /// The sites of a row that stay, each with its place along the curve.
    fn row(&self, row: usize) -> impl Iterator<Item = (u64, u64)> {
        self.sites.row(row).filter_map(|site| {
            let x = self.sites.position(site);
            self.room.leaves(&x).then(|| (self.curve.key(x), site))
        })
    }

    /// The sites of some stretches, in the order of the curve.
    fn sorted(&self, stretches: std::ops::Range<usize>) -> Vec<(u64, u64)> {
        let wanted =
            |(key, _): &(u64, u64)| stretches.contains(&self.curve.stretch(*key, STRETCHES));
        let rows = (0..self.sites.rows()).into_par_iter();
        let mut sites: Vec<(u64, u64)> = rows
            .flat_map_iter(|row| self.row(row).filter(&wanted))
            .collect();
        sites.par_sort_unstable();
        sites
    }

    /// How many sites each stretch has.
    fn counts(&self) -> Vec<usize> {
        let rows = (0..self.sites.rows()).into_par_iter();
        let none = || vec![0; STRETCHES];
        rows.fold(none, |mut counts, row| {
            (self.row(row)).for_each(|(key, _)| counts[self.curve.stretch(key, STRETCHES)] += 1);
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
    use super::super::{fcc, order};
    use super::*;
    use crate::lattice::energy::CHUNK;
    use crate::lattice::seeding::Atoms;
    use crate::ranks::shared;

    #[test]
    fn shares_of_the_lattice_are_the_lattice_in_turn() {
        let fixed = [[20.0, 21.0, 22.0], [0.0, 20.0, 20.0], [88.5, 1.0, 1.0]];
        for (extent, d, fixed) in [
            ([90.0, 50.0, 60.0], 3.0, &fixed[..]),
            ([260.0, 33.0, 21.0], 2.5, &[]),
            ([20.0, 21.0, 23.0], 5.0, &[]),
        ] {
            let distance = Distance::Constant(d);
            let whole = fcc(extent, &distance, fixed, Alignment::On).unwrap();
            let mut sites = super::super::lattice::fitted(extent, d, Alignment::On);
            order::sort_by_curve(&mut sites, extent, 2.0 * d);
            let mut atoms = Atoms::in_box(sites, extent);
            fixed::insert(&mut atoms, fixed, extent, &distance);
            assert!(whole == atoms, "{extent:?}");
            for count in [2, 3, 7] {
                let shares = shared(count, |group| {
                    seeded(extent, &distance, fixed, Alignment::On, group).unwrap()
                });
                let mut all = Atoms::default();
                for share in shares {
                    assert_eq!((share.first, share.whole), (all.len(), whole.len()));
                    assert!(share.atoms.len() <= (whole.len() / CHUNK / count + 2) * CHUNK);
                    all.append(share.atoms);
                }
                assert!(all == whole, "{extent:?}, {count}");
            }
        }
    }
}
