//! Signed distance of samples to the surface of a mask.

use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Largest distance (samples) that is exact; larger distances are cut to it.
pub const MAX_DISTANCE: usize = 8;

/// Returns the signed Euclidean distance of each sample to the surface of a mask, which lies half a
/// sample from the nearest sample on its other side. The distance is positive inside, and its
/// magnitude is at most [`MAX_DISTANCE`] less a half.
pub fn signed_distance<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let mut distances = squared_distance(dims, inside, false, cancel);
    let outside = squared_distance(dims, inside, true, cancel);
    distances
        .par_iter_mut()
        .zip(&outside)
        .for_each(|(distance, outside)| {
            *distance = if *distance > 0.0 {
                distance.sqrt() - 0.5
            } else {
                0.5 - outside.sqrt()
            };
        });
    distances
}

/// Returns the squared distance of each sample to the nearest sample whose `inside` is equal to
/// `target`.
fn squared_distance<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    target: bool,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let max_square = (MAX_DISTANCE * MAX_DISTANCE) as f32;
    let row = dims[0].max(1);
    let mut square = vec![max_square; inside.len()];
    square
        .par_chunks_mut(row)
        .zip(inside.par_chunks(row))
        .for_each(|(square, inside)| {
            let n = inside.len();
            let mut sweep = |order: &mut dyn Iterator<Item = usize>| {
                let mut steps = MAX_DISTANCE;
                for x in order {
                    steps = if inside[x] == target {
                        0
                    } else {
                        (steps + 1).min(MAX_DISTANCE)
                    };
                    square[x] = square[x].min((steps * steps) as f32);
                }
            };
            sweep(&mut (0..n));
            sweep(&mut (0..n).rev());
        });
    let mut stride = row;
    for n in &dims[1..] {
        if cancel.is_cancelled() {
            break;
        }
        // The minimum, over all shifts along this axis, of the distances along the axes before it.
        let before = square.clone();
        square.par_chunks_mut(row).enumerate().for_each(|(i, out)| {
            let (start, at) = (i * row, i * row / stride % n);
            for shift in 1..MAX_DISTANCE {
                let square_shift = (shift * shift) as f32;
                let mut lower = |source: usize| {
                    for (o, b) in out.iter_mut().zip(&before[source..source + row]) {
                        *o = o.min(b + square_shift);
                    }
                };
                if at >= shift {
                    lower(start - shift * stride);
                }
                if at + shift < *n {
                    lower(start + shift * stride);
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
    fn distances_match_an_exhaustive_search() {
        let dims = [13, 11, 12];
        let mut noise = Noise::new(5);
        let inside: Vec<bool> = (0..13 * 11 * 12)
            .map(|i| noise.uniform() < if i < 700 { 0.01 } else { 0.97 })
            .collect();
        let volume = Volume::new(dims, &[]);
        let distances = signed_distance(dims, &inside, &CancelToken::never());
        for i in 0..inside.len() {
            let p = volume.coordinates(i).map(|c| c as f64);
            let others = (0..inside.len()).filter(|&j| inside[j] != inside[i]);
            let min_square = others
                .map(|j| {
                    let q = volume.coordinates(j).map(|c| c as f64);
                    (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>()
                })
                .fold(64.0, f64::min);
            let expected = min_square.sqrt() - 0.5;
            let expected = if inside[i] { expected } else { -expected };
            assert!((f64::from(distances[i]) - expected).abs() < 1e-6, "{p:?}");
        }
    }
}
