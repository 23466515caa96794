//! Fixed atoms: wells, sources, sinks. They come from the user and never move.

use super::{Alignment, Atoms, side_count};
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;

/// Lattice atoms nearer to a fixed atom than this, in units of d, make room for it.
const CLEARANCE_RATIO: f64 = 0.7;
/// Positions this near to a side (relative to the box) or to each other (relative to d) are taken
/// to be on it, or the same.
const COINCIDENCE_TOLERANCE: f64 = 1e-6;

/// Checks fixed atoms against the box `[0, extent]` and against each other; those within rounding
/// of a side are put exactly on it.
///
/// # Errors
/// [`Error::Seeding`] if one lies outside the box or, alongside, on a side of it, or two at one
/// place.
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
    let same = COINCIDENCE_TOLERANCE * distance.min();
    let mut order: Vec<usize> = (0..snapped.len()).collect();
    order.sort_by(|&a, &b| snapped[a][0].total_cmp(&snapped[b][0]));
    for (n, &a) in order.iter().enumerate() {
        let others = order[n + 1..]
            .iter()
            .take_while(|&&b| snapped[b][0] - snapped[a][0] <= same);
        for &b in others {
            if distance2(&snapped[a], &snapped[b]) <= same * same {
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

/// Adds fixed atoms (already [`validate`]) to a lattice, of which those make [room](Clearance) that must.
pub fn insert<const D: usize>(
    atoms: &mut Atoms<D>,
    fixed: &[[f64; D]],
    extent: [f64; D],
    distance: &Distance<D>,
) {
    if fixed.is_empty() {
        return;
    }
    let room = Clearance::new(fixed, extent, distance);
    let keep: Vec<bool> = atoms.positions.iter().map(|x| room.allows(x)).collect();
    let mut kept = keep.iter();
    atoms
        .positions
        .retain(|_| kept.next().copied().unwrap_or(true));
    let mut kept = keep.iter();
    atoms.kinds.retain(|_| kept.next().copied().unwrap_or(true));
    atoms.positions.extend_from_slice(fixed);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
}

/// The room that fixed atoms take: lattice atoms nearer to one than 0.7 d go, unless they lie on more sides of the box
/// than it does: the box keeps its corners, edges and sides.
pub struct Clearance<'a, const D: usize> {
    fixed: &'a [[f64; D]],
    extent: [f64; D],
    /// Of each the square of how far it reaches, and on how many sides it lies.
    radius2_and_side_count: Vec<(f64, usize)>,
    /// Along x, so that each lattice atom looks at a few only.
    x_order: Vec<usize>,
    max_radius: f64,
}

impl<'a, const D: usize> Clearance<'a, D> {
    /// Of fixed atoms in the box `[0, extent]`.
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

    /// Whether a lattice atom at `x` may stay.
    pub fn allows(&self, x: &[f64; D]) -> bool {
        let fixed = self.fixed;
        let first = (self.x_order).partition_point(|&n| fixed[n][0] < x[0] - self.max_radius);
        let mut near = self.x_order[first..]
            .iter()
            .take_while(|&&n| fixed[n][0] <= x[0] + self.max_radius)
            .peekable();
        if near.peek().is_none() {
            return true;
        }
        let held = side_count(*x, self.extent);
        near.all(|&n| {
            let (room2, fixed_held) = self.radius2_and_side_count[n];
            held > fixed_held || distance2(x, &fixed[n]) >= room2
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::seeding::fcc;

    #[test]
    fn lattice_makes_room_and_the_box_stays_whole() {
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
        let is = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
        assert_eq!((is(AtomKind::Fixed), is(AtomKind::Corner)), (4, 8));
        for (x, kind) in atoms.positions.iter().zip(&atoms.kinds) {
            if *kind == AtomKind::Interior {
                let near =
                    |f: &&[f64; 3]| crate::geometry::distance2(x, f) < (0.7f64 * 6.0).powi(2);
                assert!(fixed.iter().find(near).is_none(), "{x:?}");
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
