//! The regular lattice along a curve, of which each of a group has a share and none more.
//!
//! Where a site is follows from its number, so that all can look at all sites, and keep their own.

use rayon::prelude::*;

use super::fixed::{self, Room};
use super::lattice::Sites;
use super::order::Curve;
use super::{Alignment, Atoms};
use crate::error::Result;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::share::{OwnAtoms, own_of};
use crate::ranks::Group;

/// Stretches of the curve whose sites are counted, at most.
const STRETCHES: usize = 1 << 16;

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
    let (own, sites, whole) = match group.count() {
        1 => {
            let sites = lattice.sorted(0..usize::MAX);
            let whole = sites.len() + fixed.len();
            (0..whole, sites, whole)
        }
        count => {
            let mut ends = lattice.counts();
            let mut before = 0;
            for end in &mut ends {
                before += *end;
                *end = before;
            }
            let whole = before + fixed.len();
            let own = own_of(whole, group.rank(), count);
            let wanted = own.start.min(before)..own.end.min(before);
            // The stretches in which they are, and where these begin.
            let first = ends.partition_point(|&end| end <= wanted.start);
            let end = ends.partition_point(|&end| end < wanted.end) + 1;
            let start = first.checked_sub(1).map_or(0, |before| ends[before]);
            let mut sites = match wanted.is_empty() {
                true => Vec::new(),
                false => lattice.sorted(first..end),
            };
            sites.drain(..(wanted.start - start).min(sites.len()));
            sites.truncate(wanted.len());
            (own, sites, whole)
        }
    };
    let positions = sites.par_iter();
    let positions = positions.map(|&(_, site)| lattice.sites.position(site));
    let mut atoms = Atoms::in_box(positions.collect(), extent);
    drop(sites);
    let others = whole - fixed.len();
    let of_fixed = own.start.max(others) - others..own.end.max(others) - others;
    atoms.positions.extend_from_slice(&fixed[of_fixed]);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    Ok(OwnAtoms {
        atoms,
        first: own.start,
        whole,
    })
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

    /// The stretch of the curve in which a place is.
    fn stretch(&self, key: u64) -> usize {
        let bits = self.curve.key_bits() as u32;
        (key >> bits.saturating_sub(STRETCHES.ilog2())) as usize
    }

    /// The sites of some stretches, in the order of the curve.
    fn sorted(&self, stretches: std::ops::Range<usize>) -> Vec<(u64, u64)> {
        let wanted = |(key, _): &(u64, u64)| stretches.contains(&self.stretch(*key));
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
            (self.row(row)).for_each(|(key, _)| counts[self.stretch(key)] += 1);
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
