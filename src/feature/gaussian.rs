//! Gaussian smoothing of volumes.
//!
//! The filter has a finite impulse response: the sampled Gaussian, cut at four sigma and scaled so
//! that constants stay constant. It is valid for sigma >= 0.5 (below, the sampled Gaussian is no
//! good approximation; sigma = 0 is the identity). The cost grows linearly with sigma. Beyond its
//! sides the volume is continued by mirror images (`c b a | a b c`).
//!
//! Each pass works on whole rows of x, so that the inner loop runs over neighbouring samples: along
//! y and z by adding shifted rows, along x by adding shifted copies of one padded row.

use crate::geometry::simd::dispatch_simd;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Number of samples of x processed at once: the sums stay in registers.
const LANES: usize = 16;

/// Number of samples of a layer that are smoothed together across layers.
const STRIP_SAMPLES: usize = 1024;

/// Returns how many samples to either side a kernel looks.
pub fn radius(sigma: f64) -> usize {
    (4.0 * sigma).ceil() as usize
}

/// Returns the right half of a symmetric smoothing kernel: `weights[0]` is the centre.
fn half_kernel(sigma: f64) -> Vec<f32> {
    let raw: Vec<f64> = (0..=radius(sigma))
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
        .collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|w| (w / sum) as f32).collect()
}

/// Returns the sample at index `i` of a line of `n` samples that is continued by mirror images.
fn mirror_index(i: isize, n: usize) -> usize {
    let n = n as isize;
    let i = i.rem_euclid(2 * n);
    (if i < n { i } else { 2 * n - 1 - i }) as usize
}

/// Convolves an image (x fastest) in place with a Gaussian of width `sigma` samples along each
/// axis. Axes with `sigma[k] <= 0` are not smoothed.
pub fn smooth<const D: usize>(
    dims: [usize; D],
    samples: &mut [f32],
    sigma: [f64; D],
    cancel: &CancelToken<'_>,
) {
    smooth_planes(dims, None, samples, sigma, cancel);
}

/// Convolves the image `source` as [`smooth`] does, into `out`, whose contents are overwritten.
pub fn smooth_into<const D: usize>(
    dims: [usize; D],
    source: &[f32],
    out: &mut [f32],
    sigma: [f64; D],
    cancel: &CancelToken<'_>,
) {
    smooth_planes(dims, Some(source), out, sigma, cancel);
}

/// Convolves `source`, or `samples` in place if there is none, into `samples`.
fn smooth_planes<const D: usize>(
    dims: [usize; D],
    source: Option<&[f32]>,
    samples: &mut [f32],
    sigma: [f64; D],
    cancel: &CancelToken<'_>,
) {
    let [nx, ny] = [dims[0], dims[1]];
    if samples.is_empty() {
        return;
    }
    let kernels = sigma.map(|s| (s > 0.0).then(|| half_kernel(s)));
    // Both x and y stay inside a plane: they are done while it is in the cache.
    samples.par_chunks_mut(nx * ny).enumerate().for_each_init(
        <(Vec<f32>, Vec<f32>)>::default,
        |(padded, rows), (number, plane)| {
            if cancel.is_cancelled() {
                return;
            }
            let first = number * nx * ny;
            let source = source.map_or(&*plane, |source| &source[first..][..plane.len()]);
            rows.resize(plane.len(), 0.0);
            match &kernels[0] {
                Some(kernel) => dispatch_simd(
                    #[inline(always)]
                    || {
                        for (row, out) in source.chunks(nx).zip(rows.chunks_mut(nx)) {
                            smooth_row(row, kernel, padded, out);
                        }
                    },
                ),
                None => rows.copy_from_slice(source),
            }
            match &kernels[1] {
                Some(kernel) => dispatch_simd(
                    #[inline(always)]
                    || smooth_across(rows, kernel, plane.chunks_mut(nx)),
                ),
                None => plane.copy_from_slice(rows),
            }
        },
    );
    let mut stride = nx * ny;
    for k in 2..D {
        if let Some(kernel) = &kernels[k] {
            // One stack of rows for each row of the first layer along this axis.
            let rows_below = stride / nx;
            for block in samples.chunks_mut(stride * dims[k]) {
                let mut stacks: Vec<Vec<&mut [f32]>> = (0..rows_below)
                    .map(|_| Vec::with_capacity(dims[k]))
                    .collect();
                for (i, row) in block.chunks_mut(nx).enumerate() {
                    stacks[i % rows_below].push(row);
                }
                stacks
                    .par_iter_mut()
                    .for_each_init(Vec::new, |scratch, rows| {
                        if cancel.is_cancelled() {
                            return;
                        }
                        scratch.clear();
                        rows.iter().for_each(|row| scratch.extend_from_slice(row));
                        dispatch_simd(
                            #[inline(always)]
                            || {
                                smooth_across(
                                    scratch,
                                    kernel,
                                    rows.iter_mut().map(|row| &mut **row),
                                )
                            },
                        );
                    });
            }
        }
        stride *= dims[k];
    }
}

/// Fills `out` with layers, square to the last axis, of an image convolved along that axis only,
/// beginning with layer `first`. The result is bitwise that of [`smooth`].
pub fn smooth_last_axis<const D: usize>(
    dims: [usize; D],
    samples: &[f32],
    sigma: f64,
    first: usize,
    out: &mut [f32],
    cancel: &CancelToken<'_>,
) {
    let layer = dims[..D - 1].iter().product::<usize>().max(1);
    let (count, kernel, reach) = (out.len() / layer, half_kernel(sigma), radius(sigma));
    // All layers are processed strip by strip: layers are megabytes apart, but the needed parts of
    // them then stay in the cache.
    let mut strips: Vec<Vec<&mut [f32]>> = Vec::new();
    strips.resize_with(layer.div_ceil(STRIP_SAMPLES), || Vec::with_capacity(count));
    for layer in out.chunks_mut(layer) {
        for (strip, part) in strips.iter_mut().zip(layer.chunks_mut(STRIP_SAMPLES)) {
            strip.push(part);
        }
    }
    let work = |buffer: &mut Vec<f32>, (strip, out): (usize, &mut Vec<&mut [f32]>)| {
        if cancel.is_cancelled() {
            return;
        }
        let (start, width) = (
            strip * STRIP_SAMPLES,
            STRIP_SAMPLES.min(layer - strip * STRIP_SAMPLES),
        );
        buffer.clear();
        for j in 0..count + 2 * reach {
            let j = mirror_index((first + j) as isize - reach as isize, dims[D - 1]);
            buffer.extend_from_slice(&samples[j * layer + start..][..width]);
        }
        for (j, out) in out.iter_mut().enumerate() {
            let source = |j: usize| &buffer[j * width..][..width];
            let pairs: Vec<(&[f32], &[f32])> = (0..kernel.len())
                .map(|i| (source(j + reach - i), source(j + reach + i)))
                .collect();
            dispatch_simd(
                #[inline(always)]
                || weighted_row_sum(&kernel, &pairs, out),
            );
        }
    };
    (strips.par_iter_mut().enumerate()).for_each_init(Vec::new, work);
}

/// Computes the weighted sum of pairs of rows; the first pair is one row twice.
#[inline(always)]
fn weighted_row_sum(kernel: &[f32], pairs: &[(&[f32], &[f32])], out: &mut [f32]) {
    for (block, out) in out.chunks_mut(LANES).enumerate() {
        let x = block * LANES;
        if let Ok(out) = <&mut [f32; LANES]>::try_from(&mut *out) {
            let pair = |i: usize| (lanes(&pairs[i].0[x..]), lanes(&pairs[i].1[x..]));
            *out = weighted_lanes(kernel, pair(0).0, pair);
        } else {
            for (l, o) in out.iter_mut().enumerate() {
                let mut sum = kernel[0] * pairs[0].0[x + l];
                for (w, (a, b)) in kernel.iter().zip(pairs).skip(1) {
                    sum += w * (a[x + l] + b[x + l]);
                }
                *o = sum;
            }
        }
    }
}

/// Smooths one contiguous row along itself.
#[inline(always)]
fn smooth_row(row: &[f32], kernel: &[f32], padded: &mut Vec<f32>, out: &mut [f32]) {
    let (n, radius) = (row.len(), kernel.len() - 1);
    let mirrored = |i: usize| row[mirror_index(i as isize - radius as isize, n)];
    padded.clear();
    padded.extend((0..radius).map(mirrored));
    padded.extend_from_slice(row);
    padded.extend((n + radius..n + 2 * radius).map(mirrored));
    let padded = &padded[..];
    let mut start = 0;
    for out in out.chunks_mut(LANES) {
        if let Ok(out) = <&mut [f32; LANES]>::try_from(&mut *out) {
            let at = |shift: usize| -> &[f32; LANES] { lanes(&padded[start + shift..]) };
            *out = weighted_lanes(kernel, at(radius), |i| (at(radius - i), at(radius + i)));
        } else {
            for (x, o) in out.iter_mut().enumerate() {
                let c = start + x + radius;
                let mut sum = kernel[0] * padded[c];
                for (i, w) in kernel.iter().enumerate().skip(1) {
                    sum += w * (padded[c - i] + padded[c + i]);
                }
                *o = sum;
            }
        }
        start += LANES;
    }
}

/// Smooths across a stack of successive rows: each row of `out` becomes the weighted sum of its
/// neighbours.
#[inline(always)]
fn smooth_across<'a>(
    rows: &[f32],
    kernel: &[f32],
    out: impl ExactSizeIterator<Item = &'a mut [f32]>,
) {
    let n = out.len();
    let nx = rows.len() / n.max(1);
    for (j, out) in out.enumerate() {
        let source = |shift: isize| &rows[mirror_index(j as isize + shift, n) * nx..][..nx];
        let pairs: Vec<(&[f32], &[f32])> = (0..kernel.len() as isize)
            .map(|i| (source(-i), source(i)))
            .collect();
        weighted_row_sum(kernel, &pairs, out);
    }
}

/// Returns the first `LANES` samples of a slice.
#[inline(always)]
fn lanes(slice: &[f32]) -> &[f32; LANES] {
    slice.first_chunk().unwrap_or(&[0.0; LANES])
}

/// Returns `kernel[0] * centre + sum_i kernel[i] * (before_i + after_i)`, lane by lane.
#[inline(always)]
fn weighted_lanes<'a>(
    kernel: &[f32],
    centre: &[f32; LANES],
    pair: impl Fn(usize) -> (&'a [f32; LANES], &'a [f32; LANES]),
) -> [f32; LANES] {
    let mut sum = [0.0; LANES];
    for l in 0..LANES {
        sum[l] = kernel[0] * centre[l];
    }
    for (i, w) in kernel.iter().enumerate().skip(1) {
        let (a, b) = pair(i);
        for l in 0..LANES {
            sum[l] += w * (a[l] + b[l]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample_index(dims: [usize; 3], p: [usize; 3]) -> usize {
        (p[2] * dims[1] + p[1]) * dims[0] + p[0]
    }

    #[test]
    fn impulse_response_is_the_gaussian() {
        let dims = [53, 47, 51];
        for sigma in [[0.8, 0.8, 0.8], [1.5, 1.5, 1.5], [2.0, 3.0, 4.0]] {
            let mut v = vec![0.0; 53 * 47 * 51];
            let c = [26, 23, 25];
            v[sample_index(dims, c)] = 1.0;
            smooth(dims, &mut v, sigma, &CancelToken::never());
            let norm: f64 = sigma
                .iter()
                .map(|s| s * (2.0 * std::f64::consts::PI).sqrt())
                .product();
            let mut worst = 0.0f64;
            let mut moments = [0.0f64; 3];
            let mut sum = 0.0f64;
            for z in 0..51 {
                for y in 0..47 {
                    for x in 0..53 {
                        let p = [x, y, z];
                        let got = f64::from(v[sample_index(dims, p)]);
                        let mut e = 0.0;
                        sum += got;
                        for k in 0..3 {
                            let r = p[k] as f64 - c[k] as f64;
                            e += 0.5 * (r / sigma[k]).powi(2);
                            moments[k] += got * r * r;
                        }
                        worst = worst.max((got - (-e).exp() / norm).abs());
                    }
                }
            }
            assert!(worst < 2e-3 / norm, "{worst} of {}", 1.0 / norm);
            assert!((sum - 1.0).abs() < 1e-5);
            for k in 0..3 {
                assert!(
                    (moments[k] / sigma[k].powi(2) - 1.0).abs() < 5e-3,
                    "{moments:?}"
                );
            }
        }
    }

    #[test]
    fn plane_waves_are_damped_by_the_analytic_factor() {
        let dims = [64, 40, 48];
        let sigma = 2.0;
        for (a, b, c) in [
            (0.3, 0.0, 0.0),
            (0.0, 0.4, 0.0),
            (0.0, 0.0, 0.5),
            (0.2, 0.3, 0.1),
        ] {
            let wave = |x: usize, y: usize, z: usize| {
                (a * x as f64 + b * y as f64 + c * z as f64 + 0.3).sin()
            };
            let mut v = Vec::new();
            for z in 0..48 {
                for y in 0..40 {
                    for x in 0..64 {
                        v.push(wave(x, y, z) as f32);
                    }
                }
            }
            smooth(dims, &mut v, [sigma; 3], &CancelToken::never());
            let factor = (-0.5f64 * sigma * sigma * (a * a + b * b + c * c)).exp();
            for z in 8..40 {
                for y in 8..32 {
                    for x in 8..56 {
                        let got = f64::from(v[sample_index(dims, [x, y, z])]);
                        assert!((got - factor * wave(x, y, z)).abs() < 5e-4);
                    }
                }
            }
        }
    }

    #[test]
    fn constants_stay_constant_up_to_the_sides_of_odd_shapes() {
        for dims in [[1, 1, 1], [3, 2, 1], [17, 5, 33], [16, 1, 2]] {
            let mut v = vec![2.5f32; dims.iter().product()];
            smooth(dims, &mut v, [1.5, 2.5, 9.0], &CancelToken::never());
            assert!(v.iter().all(|x| (x - 2.5).abs() < 1e-5), "{dims:?}");
        }
    }
}
