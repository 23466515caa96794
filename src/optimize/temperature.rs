//! Temperatures for local edits (Hale 2002): a lattice is warm where it has been edited and frozen
//! elsewhere, so that only the neighbourhood of the edit changes.

use rayon::prelude::*;

use crate::distance::Distance;

/// How far an edit is felt, in units of d (Hale 2002).
const RANGE: f64 = 5.0;

/// The temperature of each atom, for [`Options::temperature`](super::Options::temperature): 1 where
/// an `edited` position is, falling linearly to 0 five d away from the nearest of them, where d is
/// that at the edited position.
pub fn around<const D: usize>(
    positions: &[[f64; D]],
    edited: &[[f64; D]],
    distance: &Distance<D>,
) -> Vec<f64> {
    let ranges: Vec<f64> = edited.iter().map(|x| RANGE * distance.at(*x)).collect();
    let temperature = |x: &[f64; D]| {
        let of = |(y, range): (&[f64; D], &f64)| {
            let r2: f64 = (0..D).map(|k| (x[k] - y[k]).powi(2)).sum();
            1.0 - r2.sqrt() / range
        };
        edited.iter().zip(&ranges).map(of).fold(0.0, f64::max)
    };
    positions.par_iter().map(temperature).collect()
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
        let t = around(&x, &[[3.0, 4.0]], &Distance::Constant(4.0));
        assert_eq!((t[0], t[1], t[3], t[4]), (1.0, 0.5, 0.0, 0.0));
        assert!(t[2] > 0.0 && t[2] < 0.01);
        let t = around(&x, &[[3.0, 4.0], [40.0, 4.0]], &Distance::Constant(4.0));
        assert_eq!((t[0], t[4]), (1.0, 1.0));
    }
}
