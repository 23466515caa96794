//! How deep samples lie inside a mask.

use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Depths are exact up to this (samples); beyond, they are this.
pub const MAX_DISTANCE: usize = 8;

/// The signed Euclidean distance of each sample to the surface of a mask, half a sample from the
/// nearest sample on its other side: positive inside, at most [`MAX_DISTANCE`] less a half either way.
pub fn signed_distance<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    patience: &CancelToken<'_>,
) -> Vec<f32> {
    let mut depth = squared_distance(dims, inside, false, patience);
    let outwards = squared_distance(dims, inside, true, patience);
    depth
        .par_iter_mut()
        .zip(&outwards)
        .for_each(|(depth, away)| {
            *depth = match *depth > 0.0 {
                true => depth.sqrt() - 0.5,
                false => 0.5 - away.sqrt(),
            };
        });
    depth
}

/// The square of the distance of each sample to the nearest that is `wanted`: inside or not.
fn squared_distance<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    wanted: bool,
    patience: &CancelToken<'_>,
) -> Vec<f32> {
    let far = (MAX_DISTANCE * MAX_DISTANCE) as f32;
    let row = dims[0].max(1);
    let mut square = vec![far; inside.len()];
    square
        .par_chunks_mut(row)
        .zip(inside.par_chunks(row))
        .for_each(|(square, inside)| {
            let n = inside.len();
            let mut sweep = |order: &mut dyn Iterator<Item = usize>| {
                let mut steps = MAX_DISTANCE;
                for x in order {
                    steps = match inside[x] == wanted {
                        true => 0,
                        false => (steps + 1).min(MAX_DISTANCE),
                    };
                    square[x] = square[x].min((steps * steps) as f32);
                }
            };
            sweep(&mut (0..n));
            sweep(&mut (0..n).rev());
        });
    let mut stride = row;
    for n in &dims[1..] {
        if patience.is_cancelled() {
            break;
        }
        // The least over all shifts along this axis of what was found along the others.
        let before = square.clone();
        square.par_chunks_mut(row).enumerate().for_each(|(i, out)| {
            let (start, at) = (i * row, i * row / stride % n);
            for shift in 1..MAX_DISTANCE {
                let further = (shift * shift) as f32;
                let mut take = |from: usize| {
                    for (o, b) in out.iter_mut().zip(&before[from..from + row]) {
                        *o = o.min(b + further);
                    }
                };
                if at >= shift {
                    take(start - shift * stride);
                }
                if at + shift < *n {
                    take(start + shift * stride);
                }
            }
        });
        stride *= n;
    }
    square
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::volume::Volume;

    #[test]
    fn depths_are_those_that_a_search_of_all_samples_finds() {
        let dims = [13, 11, 12];
        let mut noise = Noise::new(5);
        let inside: Vec<bool> = (0..13 * 11 * 12)
            .map(|i| noise.uniform() < if i < 700 { 0.01 } else { 0.97 })
            .collect();
        let volume = Volume::new(dims, &[]);
        let found = signed_distance(dims, &inside, &CancelToken::never());
        for i in 0..inside.len() {
            let p = volume.coordinates(i).map(|c| c as f64);
            let others = (0..inside.len()).filter(|&j| inside[j] != inside[i]);
            let least = others
                .map(|j| {
                    let q = volume.coordinates(j).map(|c| c as f64);
                    (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>()
                })
                .fold(64.0, f64::min);
            let expected = least.sqrt() - 0.5;
            let expected = if inside[i] { expected } else { -expected };
            assert!((f64::from(found[i]) - expected).abs() < 1e-6, "{p:?}");
        }
    }
}
