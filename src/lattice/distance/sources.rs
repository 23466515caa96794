//! Nominal distance d(x) from an image, or given as samples.
//!
//! All are clipped to `min` to `max` and then graded: [`limit_gradient`] limits their slope. It
//! lowers but never raises samples, so minima are preserved.

use super::features::DistanceLimits;
use super::{Distance, limit_gradient};
use crate::error::{Error, Result, cause};
use crate::feature::gaussian::smooth;
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Where in an image atoms are dense.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DenseRegion {
    /// Where it is dark, as in Hale 2001.
    Dark,
    /// Where it is bright.
    Bright,
}

/// Returns d(x) = `min` where the smoothed image is darkest (or brightest, as `dense` says), `max`
/// at the other extreme, and linear between (Hale 2001, figure 5).
///
/// The image is smoothed by a Gaussian of width `max` (lattice units), because a lattice of such
/// distances cannot follow finer detail.
///
/// # Errors
/// Returns [`Error::Distance`] if the limits are not positive and in order, if the growth is not in
/// (0, 1], or if the image is constant.
pub fn from_image<const D: usize>(
    image: &ScalarField<D>,
    dense: DenseRegion,
    min: f64,
    max: f64,
    growth: f64,
    cancel: &CancelToken<'_>,
) -> Result<Distance<D>> {
    DistanceLimits { min, max, growth }.check()?;
    let mut field = image.clone();
    let sigma = field.step.map(|step| max / step);
    smooth(field.dims, &mut field.samples, sigma, cancel);
    let (low, high) = field
        .samples
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &s| {
            (low.min(s), high.max(s))
        });
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) {
        return Err(Error::Distance(cause(
            "distance from image",
            "the smoothed image has the same value everywhere, or values that are not finite",
            "give one distance instead of MIN:MAX",
        )));
    }
    let slope = (max - min) as f32 / span;
    for s in &mut field.samples {
        let excess = match dense {
            DenseRegion::Dark => *s - low,
            DenseRegion::Bright => high - *s,
        };
        *s = (min as f32 + slope * excess).clamp(min as f32, max as f32);
    }
    limit_gradient(&mut field, growth, cancel);
    Ok(Distance::Field(field))
}

/// Returns d(x) from samples on a grid that spans the box, clipped to `min` to `max`.
///
/// # Errors
/// Returns [`Error::Distance`] if the limits are not positive and in order, if the growth is not in
/// (0, 1], or if a sample is not a positive number.
pub fn from_samples<const D: usize>(
    mut field: ScalarField<D>,
    min: f64,
    max: f64,
    growth: f64,
    cancel: &CancelToken<'_>,
) -> Result<Distance<D>> {
    DistanceLimits { min, max, growth }.check()?;
    if let Some(bad) = field.samples.iter().find(|d| !(**d > 0.0 && d.is_finite())) {
        return Err(Error::Distance(cause(
            "given distance",
            format!("holds {bad}"),
            "give positive numbers of samples",
        )));
    }
    for d in &mut field.samples {
        *d = d.clamp(min as f32, max as f32);
    }
    limit_gradient(&mut field, growth, cancel);
    Ok(Distance::Field(field))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image_is_mapped_to_the_limits<const D: usize>(dims: [usize; D]) {
        // One period of a cosine, mirrored at the sides, so that smoothing only damps it.
        let k = std::f64::consts::PI / dims[0] as f64;
        let image = ScalarField::from_fn(dims, [1.0; D], |p| 50.0 + 7.0 * ((p[0] + 0.5) * k).cos());
        let (min, max) = (5.0, 7.0);
        for (dense, sign) in [(DenseRegion::Dark, 1.0), (DenseRegion::Bright, -1.0)] {
            let d = from_image(&image, dense, min, max, 0.1, &CancelToken::never()).unwrap();
            for x in 0..dims[0] {
                let mut p: [f64; D] = std::array::from_fn(|k| 0.5 * (dims[k] - 1) as f64);
                p[0] = x as f64;
                let truth = 6.0 + sign * ((p[0] + 0.5) * k).cos();
                assert!(
                    (d.value_at(p) - truth).abs() < 0.01,
                    "{x} {} {truth}",
                    d.value_at(p)
                );
            }
            assert_eq!((d.min(), d.max()), (min, max));
        }
    }

    #[test]
    fn an_image_is_scaled_and_biased_to_the_limits() {
        image_is_mapped_to_the_limits([96, 20, 24]);
        image_is_mapped_to_the_limits([96, 40]);
    }

    #[test]
    fn sampled_distances_are_clipped_and_graded() {
        let dims = [50, 30];
        // A gentle ramp from 4 to 8.9 with one narrow pit.
        let field = ScalarField::from_fn(dims, [1.0; 2], |p| {
            if p == [40.0, 15.0] {
                5.0
            } else {
                4.0 + 0.1 * p[0]
            }
        });
        let d = from_samples(field, 4.5, 8.0, 0.1, &CancelToken::never()).unwrap();
        assert!((d.value_at([0.0, 3.0]) - 4.5).abs() < 1e-6);
        assert!((d.value_at([20.0, 3.0]) - 6.0).abs() < 1e-5);
        // Far from the pit, too, d is determined by the path from it (sweeping is of first order).
        let truth = 5.0 + 0.1 * 9f64.hypot(15.0);
        assert!((d.value_at([49.0, 0.0]) - truth).abs() < 0.15);
        assert!((d.value_at([40.0, 15.0]) - 5.0).abs() < 1e-6);
        // Along an axis d rises from the pit by the growth.
        assert!((d.value_at([40.0, 20.0]) - 5.5).abs() < 1e-3);
    }

    #[test]
    fn impossible_sources_are_refused_with_a_remedy() {
        let flat = ScalarField::from_fn([30, 30], [1.0; 2], |_| 3.0);
        let nan = ScalarField::from_fn([30, 30], [1.0; 2], |_| f64::NAN);
        let errors = [
            from_image(
                &flat,
                DenseRegion::Dark,
                4.0,
                8.0,
                0.1,
                &CancelToken::never(),
            ),
            from_image(
                &nan,
                DenseRegion::Bright,
                4.0,
                8.0,
                0.1,
                &CancelToken::never(),
            ),
            from_samples(nan, 4.0, 8.0, 0.1, &CancelToken::never()),
            from_samples(flat, 8.0, 4.0, 0.1, &CancelToken::never()),
        ];
        for error in errors {
            let message = error.unwrap_err().to_string();
            assert!(message.contains("; give"), "{message}");
        }
    }
}
