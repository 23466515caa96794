//! Magnitude of the gradient of an image, by central differences or Prewitt's operator.

use super::volume::Volume;
use crate::geometry::simd::dispatch_simd;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Returns Prewitt's gradient magnitude (Hale 2001, for medical images), in units of the image per
/// sample: along each axis the central difference, averaged over the three samples to either side
/// along every other axis. Beyond the sides, samples repeat those on the sides.
pub fn prewitt<const D: usize>(volume: Volume<'_, D>, cancel: &CancelToken<'_>) -> Vec<f32> {
    let nx = volume.dims[0];
    let mut out = vec![0.0; volume.samples.len()];
    out.par_chunks_mut(nx.max(1)).enumerate().for_each_init(
        || vec![vec![0.0f32; nx]; D],
        |gradient, (row, out)| {
            if cancel.is_cancelled() {
                return;
            }
            dispatch_simd(
                #[inline(always)]
                || prewitt_row(volume, row, gradient, out),
            );
        },
    );
    out
}

#[inline(always)]
fn prewitt_row<const D: usize>(
    volume: Volume<'_, D>,
    row: usize,
    gradient: &mut [Vec<f32>],
    out: &mut [f32],
) {
    let nx = out.len();
    let at = volume.coordinates(row * nx);
    for component in &mut *gradient {
        component.fill(0.0);
    }
    for number in 0..3usize.pow(D as u32 - 1) {
        let (mut remaining, mut neighbour) = (number, at);
        let mut side = [0.0f32; D];
        for k in 1..D {
            side[k] = (remaining % 3) as f32 - 1.0;
            neighbour[k] = (at[k] + remaining % 3)
                .saturating_sub(1)
                .min(volume.dims[k] - 1);
            remaining /= 3;
        }
        let line = &volume.samples[volume.index(neighbour)..][..nx];
        let mut add = |x: usize, before: f32, after: f32| {
            gradient[0][x] += after - before;
            let sum = before + line[x] + after;
            for k in 1..D {
                gradient[k][x] += side[k] * sum;
            }
        };
        for x in 1..nx.saturating_sub(1) {
            add(x, line[x - 1], line[x + 1]);
        }
        add(0, line[0], line[1.min(nx - 1)]);
        if nx > 1 {
            add(nx - 1, line[nx - 2], line[nx - 1]);
        }
    }
    let scale = 0.5 / 3f32.powi(D as i32 - 1);
    for (x, out) in out.iter_mut().enumerate() {
        let squares: f32 = gradient.iter().map(|g| g[x] * g[x]).sum();
        *out = scale * squares.sqrt();
    }
}

/// Returns the magnitude of the gradient by central differences, in units of the image per sample.
/// Beyond the sides, samples repeat those on the sides.
pub fn gradient_magnitude<const D: usize>(
    volume: Volume<'_, D>,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let nx = volume.dims[0];
    let mut out = vec![0.0; volume.samples.len()];
    out.par_chunks_mut(nx.max(1))
        .enumerate()
        .for_each(|(row, out)| {
            if cancel.is_cancelled() {
                return;
            }
            dispatch_simd(
                #[inline(always)]
                || gradient_magnitude_row(volume, row * nx, out),
            );
        });
    out
}

#[inline(always)]
fn gradient_magnitude_row<const D: usize>(volume: Volume<'_, D>, start: usize, out: &mut [f32]) {
    let nx = out.len();
    let (before, after) = volume.neighbour_offsets(volume.coordinates(start));
    let line = &volume.samples[start..start + nx];
    let last = nx - 1;
    for (x, out) in out.iter_mut().enumerate() {
        *out = (line[(x + 1).min(last)] - line[x.saturating_sub(1)]).powi(2);
    }
    for k in 1..D {
        let low = &volume.samples[start - before[k]..][..nx];
        let high = &volume.samples[start + after[k]..][..nx];
        for ((out, low), high) in out.iter_mut().zip(low).zip(high) {
            *out += (high - low).powi(2);
        }
    }
    for out in out {
        *out = 0.5 * out.sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;

    /// Checks that the slope of a plane is found exactly; on a side, half of it along the axis that
    /// ends there.
    fn check_plane_slope<const D: usize>(dims: [usize; D], slope: [f32; D]) {
        let mut samples = vec![0.0; dims.iter().product()];
        let empty = Volume { dims, samples: &[] };
        for (i, s) in samples.iter_mut().enumerate() {
            let at = empty.coordinates(i);
            *s = (0..D).map(|k| slope[k] * at[k] as f32).sum();
        }
        let volume = Volume {
            dims,
            samples: &samples,
        };
        for (i, got) in prewitt(volume, &CancelToken::never()).iter().enumerate() {
            let at = volume.coordinates(i);
            let part = |k: usize| match dims[k] {
                1 => 0.0,
                n if at[k] == 0 || at[k] + 1 == n => 0.5,
                _ => 1.0,
            };
            let truth = (0..D)
                .map(|k| (part(k) * slope[k]).powi(2))
                .sum::<f32>()
                .sqrt();
            assert!((got - truth).abs() < 1e-4, "{at:?} {got} {truth}");
        }
    }

    #[test]
    fn slopes_of_planes_in_two_and_three_dimensions() {
        check_plane_slope([9, 7, 6], [0.5, -1.0, 2.0]);
        check_plane_slope([9, 7], [0.5, -1.0]);
        check_plane_slope([1, 5], [3.0, 1.0]);
    }

    #[test]
    fn magnitude_is_the_length_of_the_gradient() {
        let mut random = Noise::new(2);
        let dims = [7, 5, 4];
        let samples: Vec<f32> = (0..140).map(|_| random.normal() as f32).collect();
        let volume = Volume {
            dims,
            samples: &samples,
        };
        for (i, magnitude) in gradient_magnitude(volume, &CancelToken::never())
            .iter()
            .enumerate()
        {
            let gradient = volume.gradient(volume.coordinates(i));
            let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
            assert!((magnitude - length).abs() < 1e-5);
        }
        let row = Volume {
            dims: [1, 3],
            samples: &samples[..3],
        };
        assert_eq!(
            gradient_magnitude(row, &CancelToken::never())[1],
            0.5 * (samples[2] - samples[0]).abs()
        );
    }
}
