//! Nominal distance d(x) that grows away from the features of an image.

use super::{Distance, limit_gradient};
use crate::error::{Error, Result, cause};
use crate::feature::Features;
use crate::geometry::grid_index::offset_of;
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Bounds of a distance and of its gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceLimits {
    /// Smallest distance, in lattice units.
    pub min: f64,
    /// Largest distance, in lattice units.
    pub max: f64,
    /// Bound on |grad d|.
    pub growth: f64,
}

/// Returns d(x) = `min` at every feature point, growing away from it by `growth` per lattice unit,
/// up to `max`.
///
/// Hale (2002) sets d = c / sqrt|laplacian of b| with c such that d = 4 sigma = `min` in the
/// valleys of b. Between the valleys the Laplacian vanishes and d would be infinite, so there the
/// bound on the gradient alone decides. Setting `min` at the features and letting d grow as fast as
/// allowed gives the same result without the artefacts where the Laplacian changes sign.
///
/// d is stored on a grid of spacing about `min / 2` that spans the image's box. All corners of a
/// cell with a feature point in it have the value `min`, so d is exactly `min` at the feature
/// points.
///
/// # Errors
/// Returns [`Error::Distance`] if `min` or `max` is not a positive number, `min > max`, or `growth`
/// is not in (0, 1].
pub fn from_features<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    cancel: &CancelToken<'_>,
) -> Result<Distance<D>> {
    limits.check()?;
    let d_at_point = |_| limits.min as f32;
    Ok(from_points(features, limits, d_at_point, cancel))
}

/// Returns d(x) from the value of d at each feature point.
pub(super) fn from_points<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    d_at_point: impl Fn(usize) -> f32,
    cancel: &CancelToken<'_>,
) -> Distance<D> {
    let mut field = coarse_field(features.potential.extent(), limits.min, limits.max);
    for (i, point) in features.points.iter().enumerate() {
        lower_cell_corners(&mut field, point.position.map(f64::from), d_at_point(i));
    }
    limit_gradient(&mut field, limits.growth, cancel);
    Distance::Field(field)
}

/// Lowers d at each corner of the cell that contains a point to the value at the point.
pub(crate) fn lower_cell_corners<const D: usize>(field: &mut ScalarField<D>, x: [f64; D], d: f32) {
    let dims = field.dims;
    for_each_corner(x, dims, field.step, |corner| {
        let sample = &mut field.samples[offset_of(dims, corner)];
        *sample = sample.min(d);
    });
}

/// Calls `visit` with the indices of each corner of the grid cell that contains a point.
pub(super) fn for_each_corner<const D: usize>(
    x: [f64; D],
    dims: [usize; D],
    step: [f64; D],
    mut visit: impl FnMut([usize; D]),
) {
    // The cast turns negative values to zero.
    let low: [usize; D] = std::array::from_fn(|k| ((x[k] / step[k]) as usize).min(dims[k] - 2));
    for corner in 0..1usize << D {
        visit(std::array::from_fn(|k| low[k] + (corner >> k & 1)));
    }
}

/// Returns the count of samples along each axis and the steps of a grid of spacing at most `min /
/// 2` that spans the box.
pub(super) fn coarse_grid<const D: usize>(extent: [f64; D], min: f64) -> ([usize; D], [f64; D]) {
    let cells = extent.map(|e| (2.0 * e / min).ceil().max(1.0) as usize);
    let step = std::array::from_fn(|k| {
        if extent[k] > 0.0 {
            extent[k] / cells[k] as f64
        } else {
            1.0
        }
    });
    (cells.map(|c| c + 1), step)
}

/// Returns a field with the value `max` everywhere, on a grid of spacing at most `min / 2` that
/// spans the box.
pub(crate) fn coarse_field<const D: usize>(extent: [f64; D], min: f64, max: f64) -> ScalarField<D> {
    let (dims, step) = coarse_grid(extent, min);
    ScalarField {
        dims,
        step,
        samples: vec![max as f32; dims.iter().product()],
    }
}

impl DistanceLimits {
    /// Returns an error if the limits are not positive and in order, or if the growth is not in (0,
    /// 1].
    pub(crate) fn check(self) -> Result<()> {
        let Self { min, max, growth } = self;
        let fail = |problem: String, remedy: &str| {
            Err(Error::Distance(cause("varying distance", problem, remedy)))
        };
        if !(min > 0.0 && min.is_finite() && max.is_finite()) {
            return fail(
                format!("{min}:{max} is not positive"),
                "give MIN:MAX such as 6:18",
            );
        }
        if min > max {
            return fail(
                format!("the minimum {min} is above the maximum {max}"),
                "give MIN:MAX such as 6:18",
            );
        }
        if !(growth > 0.0 && growth <= 1.0) {
            return fail(
                format!("growth {growth} is not above 0 and at most 1"),
                "give a growth such as 0.1",
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::FeaturePoint;
    use crate::image::SparseField;

    fn distance_from_features(
        features: &Features<3>,
        min: f64,
        max: f64,
        growth: f64,
    ) -> Result<Distance<3>> {
        let limits = DistanceLimits { min, max, growth };
        from_features(features, limits, &CancelToken::never())
    }

    /// The plane x = 20.3 in a box of 64 x 50 x 40 samples.
    fn plane() -> Features<3> {
        let dims = [64, 50, 40];
        let points = (0..40 * 50)
            .map(|i| FeaturePoint {
                position: [20.3, (i % 50) as f32, (i / 50) as f32],
                normal: [1.0, 0.0, 0.0],
                strength: 1.0,
            })
            .collect();
        let potential = SparseField::zero(dims, [1.0; 3]);
        Features {
            names: Vec::new(),
            surface: vec![],
            on_horizon: vec![],
            points,
            potential,
            sigma: 1.0,
            outcomes: vec![],
            missing: None,
            notes: vec![],
            resolved: vec![],
            spacing: None,
            global_counts: None,
            labels: None,
            confidence: None,
            doubt: None,
        }
    }

    #[test]
    fn d_is_min_on_the_feature_and_grows_linearly_to_max() {
        let features = plane();
        let d = distance_from_features(&features, 4.0, 7.0, 0.1).unwrap();
        assert!(d.validate(features.potential.extent()).is_ok());
        assert_eq!(d.min(), 4.0);
        assert_eq!(d.max(), 7.0);
        for point in &features.points {
            assert!((d.value_at(point.position.map(f64::from)) - 4.0).abs() < 1e-12);
        }
        for x in 0..64 {
            let p = [x as f64, 23.7, 11.1];
            // The bottom is up to a cell (two samples) wide on either side; interpolation rounds
            // the kinks.
            let offset = (p[0] - 20.3f64).abs();
            let (min, max) = (4.0 + 0.1 * (offset - 2.05).max(0.0), 4.0 + 0.1 * offset);
            let value = d.value_at(p);
            assert!(
                value >= min.min(7.0) - 5e-3 && value <= max.min(7.0) + 1e-4,
                "{x} {value}"
            );
            let (_, gradient) = d.value_and_gradient_at(p);
            assert!(gradient.iter().map(|g| g * g).sum::<f64>().sqrt() <= 0.1 * 1.001);
        }
    }

    #[test]
    fn no_features_means_max_everywhere() {
        let features = Features {
            points: vec![],
            ..plane()
        };
        let d = distance_from_features(&features, 4.0, 9.0, 0.1).unwrap();
        assert_eq!((d.min(), d.max()), (9.0, 9.0));
    }

    #[test]
    fn bad_parameters_are_refused() {
        for (min, max, growth) in [
            (0.0, 8.0, 0.1),
            (9.0, 8.0, 0.1),
            (f64::NAN, 8.0, 0.1),
            (4.0, 8.0, 0.0),
            (4.0, 8.0, 2.0),
        ] {
            let message = distance_from_features(&plane(), min, max, growth)
                .unwrap_err()
                .to_string();
            assert!(message.contains("; give"), "{message}");
        }
    }
}
