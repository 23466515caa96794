//! Nominal distance d(x) from the Laplacian of the potential (Hale 2002).

use crate::error::Result;
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::image::ScalarField;
use crate::lattice::distance::{Distance, DistanceLimits, coarse_field, limit_gradient};
use crate::progress::CancelToken;

/// Samples between two checks for cancellation.
const CANCEL_CHECK_INTERVAL: usize = 1 << 14;

/// Returns d(x) = c / sqrt |laplacian of b|, with c such that d is `min` in the valleys of b, whose
/// width is `sigma`; at most `max` (Hale 2002).
///
/// b = -exp(-s^2 / (2 sigma^2)) has the Laplacian 1 / sigma^2 in the valley, so c = min / sigma.
/// Hale's sigma is min / 4, so that c = 4. The Laplacian vanishes on either side of a valley: the
/// smallest d within about `min / 2` counts, and the limit on the slope bridges the gap.
///
/// # Errors
/// Returns [`Error::Distance`](crate::Error::Distance) if the limits are not positive and in order, or if the growth is not
/// in (0, 1].
pub fn laplacian_distance<const D: usize>(
    potential: &ScalarField<D>,
    sigma: f64,
    min: f64,
    max: f64,
    growth: f64,
    cancel: &CancelToken<'_>,
) -> Result<Distance<D>> {
    DistanceLimits { min, max, growth }.check()?;
    let mut field = coarse_field(potential.extent(), min, max);
    let strides = strides(potential.dims);
    let b = &potential.samples;
    for i in 0..b.len() {
        if i % CANCEL_CHECK_INTERVAL == 0 && cancel.is_cancelled() {
            break;
        }
        let index = index_at(potential.dims, i);
        let (mut laplacian, mut nearest) = (0.0, [0; D]);
        for k in 0..D {
            let x = index[k];
            let before = if x > 0 { i - strides[k] } else { i };
            let after = if x + 1 < potential.dims[k] {
                i + strides[k]
            } else {
                i
            };
            let step = potential.step[k];
            laplacian += f64::from(b[before] + b[after] - 2.0 * b[i]) / (step * step);
            let position = (x as f64 * step / field.step[k]).round() as usize;
            nearest[k] = position.min(field.dims[k] - 1);
        }
        let d = (min / sigma / laplacian.abs().sqrt()).clamp(min, max);
        let sample = &mut field.samples[offset_of(field.dims, nearest)];
        *sample = sample.min(d as f32);
    }
    limit_gradient(&mut field, growth, cancel);
    Ok(Distance::Field(field))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Valleys of width sigma on the planes x = 20 and x = 60.
    fn valleys<const D: usize>(dims: [usize; D], sigma: f64) -> ScalarField<D> {
        let bell = |x: f64| (-0.5 * (x / sigma).powi(2)).exp();
        ScalarField::from_fn(dims, [1.0; D], |p| {
            -bell(p[0] - 20.0).max(bell(p[0] - 60.0))
        })
    }

    fn laplacian_gives_min_in_valleys<const D: usize>(dims: [usize; D]) {
        let (sigma, min, max) = (2.0, 8.0, 14.0);
        let b = valleys(dims, sigma);
        let d = laplacian_distance(&b, sigma, min, max, 0.1, &CancelToken::never()).unwrap();
        assert!(d.validate(b.extent()).is_ok());
        for x in 0..80 {
            let mut p: [f64; D] = std::array::from_fn(|k| 0.45 * (dims[k] - 1) as f64);
            p[0] = x as f64;
            let offset = (p[0] - 20.0).abs().min((p[0] - 60.0).abs());
            let (value, slope) = d.value_and_gradient_at(p);
            // Second differences of a bell as narrow as two samples are a tenth too small, and a
            // node of the grid includes values up to half a cell (two samples) away.
            if offset == 0.0 {
                assert!((min..min * 1.08).contains(&value), "{x} {value}");
            }
            let truth = min + 0.1 * offset;
            assert!(
                value <= truth.min(max) + 0.6 && value >= (truth - 0.75).clamp(min, max) - 1e-3,
                "{x}: {value} {truth}"
            );
            assert!(slope.iter().map(|g| g * g).sum::<f64>().sqrt() <= 0.1001);
        }
    }

    #[test]
    fn the_laplacian_gives_min_in_valleys_and_growth_between() {
        laplacian_gives_min_in_valleys([81, 40, 36]);
        laplacian_gives_min_in_valleys([81, 64]);
    }

    #[test]
    fn impossible_limits_are_refused_with_a_remedy() {
        let flat = ScalarField::from_fn([30, 30], [1.0; 2], |_| 3.0);
        let error = laplacian_distance(&flat, 1.0, 4.0, 8.0, 0.0, &CancelToken::never());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("; give"), "{message}");
    }
}
