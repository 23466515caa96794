//! Fixed atoms: wells, sources, sinks. The user gives them, and they never move.

use super::{Alignment, Atoms, side_count};
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;

/// Lattice atoms nearer to a fixed atom than this, in units of d, are removed.
const CLEARANCE_RATIO: f64 = 0.7;
/// Positions this near to a side (relative to the box) or to each other (relative to d) count as on
/// the side, or as the same.
const COINCIDENCE_TOLERANCE: f64 = 1e-6;

/// Checks fixed atoms against the box `[0, extent]` and against each other. Atoms within rounding
/// of a side are moved exactly onto it.
///
/// # Errors
/// Returns [`Error::Seeding`] if an atom lies outside the box, if two atoms are at one place, or,
/// with [`Alignment::AlongsideFeatures`], if an atom lies on a side.
pub fn validate<const D: usize>(
    fixed: &[[f64; D]],
    extent: [f64; D],
    distance: &Distance<D>,
    alignment: Alignment,
) -> Result<Vec<[f64; D]>> {
    let place = |n: usize, x: [f64; D]| format!("fixed atom {} at {x:?} (lattice)", n + 1);
    let mut snapped = Vec::with_capacity(fixed.len());
    for (n, &x) in fixed.iter().enumerate() {
        let tolerance = extent.map(|l| COINCIDENCE_TOLERANCE * l);
        if !(0..D).all(|k| x[k] >= -tolerance[k] && x[k] <= extent[k] + tolerance[k]) {
            return Err(Error::Seeding(cause(
                place(n, x),
                format!("lies outside the box from the origin to {extent:?}"),
                "remove it or correct its coordinates",
            )));
        }
        let x = std::array::from_fn(|k| {
            if x[k] <= tolerance[k] {
                0.0
            } else if x[k] >= extent[k] - tolerance[k] {
                extent[k]
            } else {
                x[k]
            }
        });
        if alignment == Alignment::AlongsideFeatures && side_count(x, extent) > 0 {
            return Err(Error::Seeding(cause(
                place(n, x),
                "lies on a side of the box, where cells end",
                "move it inside, or make a mesh that has nodes on the sides",
            )));
        }
        snapped.push(x);
    }
    if snapped.is_empty() {
        return Ok(snapped);
    }
    let tolerance = COINCIDENCE_TOLERANCE * distance.min();
    let mut order: Vec<usize> = (0..snapped.len()).collect();
    order.sort_by(|&a, &b| snapped[a][0].total_cmp(&snapped[b][0]));
    for (n, &a) in order.iter().enumerate() {
        let others = order[n + 1..]
            .iter()
            .take_while(|&&b| snapped[b][0] - snapped[a][0] <= tolerance);
        for &b in others {
            if distance2(&snapped[a], &snapped[b]) <= tolerance * tolerance {
                let (first, second) = (a.min(b), a.max(b));
                return Err(Error::Seeding(cause(
                    place(second, fixed[second]),
                    format!("is at the same place as fixed atom {}", first + 1),
                    "remove one of them",
                )));
            }
        }
    }
    Ok(snapped)
}

/// Adds fixed atoms (which [`validate`] has checked) to a lattice. Lattice atoms within their
/// [clearance](Clearance) are removed.
pub fn insert<const D: usize>(
    atoms: &mut Atoms<D>,
    fixed: &[[f64; D]],
    extent: [f64; D],
    distance: &Distance<D>,
) {
    if fixed.is_empty() {
        return;
    }
    let clearance = Clearance::new(fixed, extent, distance);
    let is_kept: Vec<bool> = atoms
        .positions
        .iter()
        .map(|x| clearance.allows(x))
        .collect();
    let mut flags = is_kept.iter();
    atoms
        .positions
        .retain(|_| flags.next().copied().unwrap_or(true));
    let mut flags = is_kept.iter();
    atoms
        .kinds
        .retain(|_| flags.next().copied().unwrap_or(true));
    atoms.positions.extend_from_slice(fixed);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
}

/// The clearance around fixed atoms: lattice atoms nearer to a fixed atom than 0.7 d are removed,
/// unless they lie on more sides of the box than it does, so that the box keeps its corners, edges
/// and sides.
pub struct Clearance<'a, const D: usize> {
    fixed: &'a [[f64; D]],
    extent: [f64; D],
    /// For each fixed atom the square of its clearance, and the count of sides on which it lies.
    radius2_and_side_count: Vec<(f64, usize)>,
    /// Fixed atoms sorted along x, so that each lattice atom is compared with a few only.
    x_order: Vec<usize>,
    max_radius: f64,
}

impl<'a, const D: usize> Clearance<'a, D> {
    /// Computes the clearance of fixed atoms in the box `[0, extent]`.
    pub fn new(fixed: &'a [[f64; D]], extent: [f64; D], distance: &Distance<D>) -> Self {
        let radius2_and_side_count: Vec<(f64, usize)> = fixed
            .iter()
            .map(|&x| {
                (
                    (CLEARANCE_RATIO * distance.value_at(x)).powi(2),
                    side_count(x, extent),
                )
            })
            .collect();
        let mut x_order: Vec<usize> = (0..fixed.len()).collect();
        x_order.sort_by(|&a, &b| fixed[a][0].total_cmp(&fixed[b][0]));
        let max_radius = radius2_and_side_count
            .iter()
            .fold(0.0f64, |w, r| w.max(r.0))
            .sqrt();
        Self {
            fixed,
            extent,
            radius2_and_side_count,
            x_order,
            max_radius,
        }
    }

    /// Returns `true` if a lattice atom at `x` may stay.
    pub fn allows(&self, x: &[f64; D]) -> bool {
        let fixed = self.fixed;
        let first = (self.x_order).partition_point(|&n| fixed[n][0] < x[0] - self.max_radius);
        let mut nearby = self.x_order[first..]
            .iter()
            .take_while(|&&n| fixed[n][0] <= x[0] + self.max_radius)
            .peekable();
        if nearby.peek().is_none() {
            return true;
        }
        let atom_sides = side_count(*x, self.extent);
        nearby.all(|&n| {
            let (radius2, fixed_sides) = self.radius2_and_side_count[n];
            atom_sides > fixed_sides || distance2(x, &fixed[n]) >= radius2
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::seeding::fcc;

    #[test]
    fn lattice_atoms_make_room_and_the_box_keeps_its_corners() {
        let extent = [40.0, 44.0, 48.0];
        let distance = Distance::Constant(6.0);
        let fixed = [
            [20.0, 21.0, 22.0],
            [0.0, 20.0, 20.0],
            [20.0, 0.0, 48.0],
            [1.0, 1.0, 1.0],
        ];
        let plain = fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let atoms = fcc(extent, &distance, &fixed, Alignment::OnFeatures).unwrap();
        assert!(atoms.len() <= plain.len() + fixed.len());
        let count_kind = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
        assert_eq!(
            (count_kind(AtomKind::Fixed), count_kind(AtomKind::Corner)),
            (4, 8)
        );
        for (x, kind) in atoms.positions.iter().zip(&atoms.kinds) {
            if *kind == AtomKind::Interior {
                let is_near =
                    |f: &&[f64; 3]| crate::geometry::distance2(x, f) < (0.7f64 * 6.0).powi(2);
                assert!(fixed.iter().find(is_near).is_none(), "{x:?}");
            }
        }
    }

    #[test]
    fn impossible_fixed_atoms_are_refused() {
        let extent = [40.0; 3];
        let distance = Distance::Constant(6.0);
        let message = |fixed: &[[f64; 3]]| {
            fcc(extent, &distance, fixed, Alignment::OnFeatures)
                .unwrap_err()
                .to_string()
        };
        let outside = message(&[[1.0, 2.0, 3.0], [41.0, 2.0, 3.0]]);
        assert!(
            outside.contains("fixed atom 2") && outside.contains("outside"),
            "{outside}"
        );
        assert!(message(&[[f64::NAN, 2.0, 3.0]]).contains("outside"));
        let twice = message(&[[1.0, 2.0, 3.0], [5.0, 5.0, 5.0], [1.0, 2.0, 3.0]]);
        assert!(twice.contains("same place as fixed atom 1"), "{twice}");
    }
}
