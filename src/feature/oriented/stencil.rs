//! Weighted sums of the samples around each sample of a row.

use crate::feature::volume::Volume;

/// Distance, in standard deviations, at which filters are cut.
const CUTOFF_SIGMAS: f64 = 2.0;
/// Smallest share of a filter's weights inside the image for which a mean is computed.
const MIN_INSIDE_SHARE: f32 = 0.1;
/// Number of samples of a long row that are summed at once, and number of parallel sums for each of
/// them.
pub const LANES: usize = 32;
pub const ACCUMULATOR_COUNT: usize = 2;
/// Number of parallel sums if rows are short.
pub const SHORT_ROW_ACCUMULATOR_COUNT: usize = 4;

/// Offset and weight of one sample.
#[derive(Debug, Clone, Copy)]
pub struct StencilTap<const D: usize> {
    pub offset: [isize; D],
    pub weight: f32,
}

/// A weighted sum of the samples around a sample.
pub struct Stencil<const D: usize> {
    pub taps: Vec<StencilTap<D>>,
    /// Smallest and largest offset along each axis.
    pub reach: [(isize, isize); D],
}

impl<const D: usize> Stencil<D> {
    /// Creates a weighted sum of positions, each read by multilinear interpolation.
    pub fn new(places: Vec<([f64; D], f64)>) -> Self {
        let mut taps: Vec<StencilTap<D>> = Vec::with_capacity(places.len() << D);
        for (at, weight) in places {
            let low = at.map(f64::floor);
            for corner in 0..1usize << D {
                let (mut share, mut offset) = (weight, [0; D]);
                for k in 0..D {
                    let is_upper = corner >> k & 1 == 1;
                    let fraction = at[k] - low[k];
                    share *= if is_upper { fraction } else { 1.0 - fraction };
                    offset[k] = low[k] as isize + isize::from(is_upper);
                }
                if share > 1e-6 {
                    let weight = share as f32;
                    taps.push(StencilTap { offset, weight });
                }
            }
        }
        // Taps are in the order of memory, without duplicates.
        taps.sort_by_key(|tap| {
            let mut key = tap.offset;
            key.reverse();
            key
        });
        taps.dedup_by(|tap, kept| {
            let is_same = tap.offset == kept.offset;
            kept.weight += if is_same { tap.weight } else { 0.0 };
            is_same
        });
        let reach = std::array::from_fn(|k| {
            let offsets = taps.iter().map(|tap| tap.offset[k]);
            offsets.fold((0, 0), |r, i| (r.0.min(i), r.1.max(i)))
        });
        Self { taps, reach }
    }

    /// Creates a Gaussian mean of this width along a direction, read at every `step`.
    pub fn gaussian(direction: [f64; D], width: f64, step: f64) -> Self {
        let half_count = (CUTOFF_SIGMAS * width / step).round() as i32;
        let places: Vec<([f64; D], f64)> = (-half_count..=half_count)
            .map(|j| {
                let along = step * f64::from(j);
                let weight = (-0.5 * (along / width).powi(2)).exp();
                (direction.map(|c| c * along), weight)
            })
            .collect();
        let sum: f64 = places.iter().map(|place| place.1).sum();
        Self::new(places.into_iter().map(|(at, w)| (at, w / sum)).collect())
    }

    /// Returns the offset in memory and the weight of each sample.
    pub fn offsets(&self, strides: [usize; D]) -> Vec<(isize, f32)> {
        let offset =
            |tap: &StencilTap<D>| (0..D).map(|k| tap.offset[k] * strides[k] as isize).sum();
        (self.taps.iter())
            .map(|tap| (offset(tap), tap.weight))
            .collect()
    }

    /// Returns `true` if the sums at samples `start` to `end` along axis `k` read only samples
    /// inside the image.
    #[inline(always)]
    pub fn is_inside(&self, k: usize, start: isize, end: isize, samples: usize) -> bool {
        let (low, high) = self.reach[k];
        start + low >= 0 && end + high <= samples as isize
    }

    /// Returns the sums at a row of samples from `at` on, minus `level`, over samples inside the
    /// image, and the sums of the weights of these samples.
    #[inline(always)]
    pub fn row_sums(
        &self,
        image: Volume<'_, D>,
        at: [isize; D],
        level: f32,
    ) -> ([f32; LANES], [f32; LANES]) {
        let (mut sum, mut inside) = ([0.0; LANES], [0.0; LANES]);
        for tap in &self.taps {
            let position: [isize; D] = std::array::from_fn(|k| at[k] + tap.offset[k]);
            if (1..D).any(|k| position[k] < 0 || position[k] >= image.dims[k] as isize) {
                continue;
            }
            let row = (1..D)
                .rev()
                .fold(0, |i, k| (i + position[k] as usize) * image.dims[k - 1]);
            let low = (-position[0]).clamp(0, LANES as isize);
            let high = (image.dims[0] as isize - position[0]).clamp(low, LANES as isize);
            let source = row.wrapping_add_signed(position[0] + low);
            let (low, high) = (low as usize, high as usize);
            if low == high {
                continue;
            }
            let samples = &image.samples[source..source + high - low];
            // Samples outside count as the level.
            let mut values = [level; LANES];
            values[low..high].copy_from_slice(samples);
            for l in 0..LANES {
                sum[l] += tap.weight * (values[l] - level);
                inside[l] += if (low..high).contains(&l) {
                    tap.weight
                } else {
                    0.0
                };
            }
        }
        (sum, inside)
    }
}

/// Computes weighted means of neighbours for `N` samples in a row. If the means reach beyond the
/// image, `inside` has the share inside for each sample.
#[inline(always)]
pub fn weighted_means<const N: usize>(
    samples: &[f32],
    inside: Option<&[f32]>,
    at: usize,
    taps: &[(isize, f32)],
    out: &mut [f32],
) {
    let mut sum = weighted_sums::<N, SHORT_ROW_ACCUMULATOR_COUNT>(samples, at as isize, taps);
    if let Some(inside) = inside {
        let shares = weighted_sums::<N, SHORT_ROW_ACCUMULATOR_COUNT>(inside, at as isize, taps);
        for l in 0..N {
            sum[l] = if shares[l] > MIN_INSIDE_SHARE {
                sum[l] / shares[l]
            } else {
                0.0
            };
        }
    }
    out[..N].copy_from_slice(&sum);
}

/// Returns weighted sums of neighbours for `N` samples in a row: as many as stay in registers. Each
/// sum consists of `W` partial sums, of every `W`-th neighbour, because otherwise each addition
/// would wait for the one before.
#[inline(always)]
pub fn weighted_sums<const N: usize, const W: usize>(
    samples: &[f32],
    at: isize,
    taps: &[(isize, f32)],
) -> [f32; N] {
    let mut sums = [[0.0f32; N]; W];
    let (chunks, remainder) = taps.as_chunks::<W>();
    for chunk in chunks {
        for w in 0..W {
            let (offset, weight) = chunk[w];
            add_weighted(&mut sums[w], samples, at, offset, weight);
        }
    }
    for (sum, &(offset, weight)) in sums.iter_mut().zip(remainder) {
        add_weighted(sum, samples, at, offset, weight);
    }
    let mut total = sums[0];
    for sum in &sums[1..] {
        for l in 0..N {
            total[l] += sum[l];
        }
    }
    total
}

/// Adds a weighted row of samples.
#[inline(always)]
fn add_weighted<const N: usize>(
    sum: &mut [f32; N],
    samples: &[f32],
    at: isize,
    offset: isize,
    weight: f32,
) {
    let start = (at + offset) as usize;
    let row = &samples[start..start + N];
    for l in 0..N {
        sum[l] += weight * row[l];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{dot, unit};

    #[test]
    fn means_along_lines_are_centred_and_have_the_requested_width() {
        let directions = [
            [1.0, 0.0, 0.0],
            [0.6, -0.7, 0.4],
            [1.0, 1.0, 1.0],
            [0.1, 0.2, -0.9],
        ];
        for direction in directions.map(unit) {
            for (width, step) in [(8.0, 2.5), (6.0, 3.0), (3.0, 1.5)] {
                let stencil = Stencil::<3>::gaussian(direction, width, step);
                let (mut total, mut middle, mut along2, mut across2) = (0.0, [0.0; 3], 0.0, 0.0);
                for tap in &stencil.taps {
                    let (at, weight) = (tap.offset.map(|i| i as f64), f64::from(tap.weight));
                    let along = dot(at, direction);
                    total += weight;
                    middle = std::array::from_fn(|k| middle[k] + weight * at[k]);
                    along2 += weight * along * along;
                    across2 += weight * (dot(at, at) - along * along);
                }
                assert!((total - 1.0).abs() < 1e-4, "{direction:?}: {total}");
                assert!(dot(middle, middle) < 1e-6, "{direction:?}: {middle:?}");
                // A Gaussian cut at two standard deviations has 0.774 of its variance.
                let share = along2 / (width * width);
                assert!(
                    (0.62..0.9).contains(&share),
                    "{direction:?} {width}: {share}"
                );
                // Linear interpolation along three axes adds at most a quarter each.
                assert!(across2 < 0.75, "{direction:?} {width}: {across2}");
                assert!(
                    stencil
                        .reach
                        .iter()
                        .all(|&(low, high)| -low <= 17 && high <= 17)
                );
            }
        }
    }

    #[test]
    fn at_the_sides_means_use_what_is_inside() {
        let dims = [70, 50, 40];
        let samples: Vec<f32> = (0..70 * 50 * 40)
            .map(|i| (i * 7919 % 1009) as f32)
            .collect();
        let image = Volume::new(dims, &samples);
        let stencil = Stencil::<3>::gaussian(unit([0.5, 0.6, -0.4]), 3.0, 1.5);
        let offsets = stencil.offsets(image.strides());
        // Far inside, both ways of summing agree.
        let at = [20, 25, 20];
        let (sums, share) = stencil.row_sums(image, at, 0.0);
        let start = image.index([20, 25, 20]) as isize;
        let reference = weighted_sums::<LANES, ACCUMULATOR_COUNT>(&samples, start, &offsets);
        for l in 0..LANES {
            assert!((share[l] - 1.0).abs() < 1e-5 && (sums[l] - reference[l]).abs() < 1e-2);
        }
        // Beyond a side, the sums agree with those of single samples.
        for at in [[-9, 25, 20], [55, 3, 37], [20, -40, 20]] {
            let (sums, share) = stencil.row_sums(image, at, 100.0);
            for l in 0..LANES {
                let (mut value, mut inside) = (0.0, 0.0);
                for tap in &stencil.taps {
                    let position: [isize; 3] = std::array::from_fn(|k| {
                        at[k] + tap.offset[k] + if k == 0 { l as isize } else { 0 }
                    });
                    if (0..3).all(|k| (0..dims[k] as isize).contains(&position[k])) {
                        value += tap.weight
                            * (samples[image.index(position.map(|i| i as usize))] - 100.0);
                        inside += tap.weight;
                    }
                }
                assert!((value - sums[l]).abs() < 1e-2 && (inside - share[l]).abs() < 1e-5);
            }
        }
    }
}
