//! Temperatures for local edits (Hale 2002): a lattice is warm where it has been edited and frozen
//! elsewhere, so that only the neighbourhood of the edit changes.

use crate::geometry::distance2;
use crate::parallel::prelude::*;

/// Radius of the neighbourhood of an edit, in units of d (Hale 2002).
pub const EDIT_RADIUS: f64 = 5.0;

/// Returns the temperature of each atom, for
/// [`OptimiseOptions::temperature`](super::OptimiseOptions::temperature): 1 at an `edited`
/// position, falling linearly to 0 at five d from the nearest of them. Each edited position comes
/// with the d there.
pub fn temperatures<const D: usize>(
    positions: &[[f64; D]],
    edited: &[([f64; D], f64)],
) -> Vec<f64> {
    let temperature = |x: &[f64; D]| 1.0 - relative_distance(x, edited) / EDIT_RADIUS;
    positions
        .par_iter()
        .map(|x| temperature(x).max(0.0))
        .collect()
}

/// Returns the distance of a position from the nearest edited one, in units of the d there.
pub fn relative_distance<const D: usize>(x: &[f64; D], edited: &[([f64; D], f64)]) -> f64 {
    let distance_to = |(y, d): &([f64; D], f64)| distance2(x, y).sqrt() / d;
    edited.iter().map(distance_to).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falls_from_one_at_the_edit_to_nothing_at_five_d() {
        let x = [
            [3.0, 4.0],
            [3.0, 14.0],
            [3.0, 23.9],
            [3.0, 24.1],
            [40.0, 4.0],
        ];
        let t = temperatures(&x, &[([3.0, 4.0], 4.0)]);
        assert_eq!((t[0], t[1], t[3], t[4]), (1.0, 0.5, 0.0, 0.0));
        assert!(t[2] > 0.0 && t[2] < 0.01);
        let t = temperatures(&x, &[([3.0, 4.0], 4.0), ([40.0, 4.0], 4.0)]);
        assert_eq!((t[0], t[4]), (1.0, 1.0));
    }
}
