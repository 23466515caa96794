//! d(x) that grows away from the features of an image.

use super::{Distance, DistanceLayers, DistributedDistance, limit_gradient};
use crate::comm::{Comm, SelfComm};
use crate::error::{Error, Result, cause};
use crate::feature::Features;
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Between what, and how fast, a distance varies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceLimits {
    /// The least distance.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// The bound on |grad d|.
    pub growth: f64,
}

/// d(x) = `min` at every feature point, growing away from it by `growth` per lattice unit, up to
/// `max`.
///
/// Hale (2002) sets d = c / sqrt|laplacian of b| with c such that d = 4 sigma = `min` in the
/// valleys of b; between the valleys the laplacian vanishes and d would be infinite, so there the
/// bound on the gradient alone decides. Setting `min` at the features and letting d grow as fast as
/// it may is that definition, without its accidents where the laplacian changes sign.
///
/// d is stored on a grid of spacing about `min / 2` that spans the image's box; all corners of a
/// cell with a feature point in it hold `min`, so d is exactly `min` at the feature points.
///
/// # Errors
/// [`Error::Distance`] if `min` or `max` is not a positive number, `min > max`, or `growth` is not
/// between 0 and 1.
pub fn from_features<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    patience: &CancelToken<'_>,
) -> Result<Distance<D>> {
    distributed_from_features(features, limits, patience, &SelfComm)?.into_global(&SelfComm)
}

/// The same; where the points are shared by a group, so is d.
///
/// # Errors
/// As [`from_features`], and those of the others of the group.
pub(crate) fn distributed_from_features<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
) -> Result<DistributedDistance<D>> {
    from_points(features, limits, patience, group, |_| limits.min as f32)
}

/// d(x) as the gaps between features ask for ([`Features::spacing`]) at every feature point, from `min`
/// to `max`, growing away from where it is small by `growth` per lattice unit. Where the points are shared by a group,
/// so is d.
///
/// # Errors
/// As [`from_features`], and those of the others of the group.
pub(crate) fn distributed_from_gaps<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
) -> Result<DistributedDistance<D>> {
    let [min, max] = [limits.min, limits.max].map(|d| d as f32);
    let spacing = features.spacing.as_deref().unwrap_or(&[]);
    let at = |i: usize| spacing.get(i).map_or(max, |d| d.clamp(min, max));
    let mut fine = (0..features.points.len()).any(|i| at(i) < max);
    if features.global_counts.is_some() {
        fine = group.all_gather("fine points", fine)?.contains(&true);
    }
    // Where no gap asks for less, one number says it all.
    if !fine {
        limits.check()?;
        return Ok(DistributedDistance::Global(Distance::Constant(limits.max)));
    }
    from_points(features, limits, patience, group, at)
}

/// d(x) from d at each feature point.
fn from_points<const D: usize>(
    features: &Features<D>,
    limits: DistanceLimits,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
    at_point: impl Fn(usize) -> f32,
) -> Result<DistributedDistance<D>> {
    limits.check()?;
    let extent = features.potential.extent();
    let numbered = features.points.iter().enumerate();
    let points = numbered.map(|(i, point)| (point.position, at_point(i)));
    if features.global_counts.is_some() {
        let some = DistanceLayers::from_points(extent, limits, points, patience, group)?;
        return Ok(DistributedDistance::Layers(some));
    }
    let mut field = coarse_field(extent, limits.min, limits.max);
    points.for_each(|(x, d)| lower_cell_corners(&mut field, x.map(f64::from), d));
    limit_gradient(&mut field, limits.growth, patience);
    Ok(DistributedDistance::Global(Distance::Field(field)))
}

/// Lowers d at each corner of the cell that a point is in to what it is at the point.
pub(crate) fn lower_cell_corners<const D: usize>(field: &mut ScalarField<D>, x: [f64; D], d: f32) {
    let dims = field.dims;
    for_each_corner(x, dims, field.step, |at| {
        let at = (0..D).rev().fold(0, |all, k| all * dims[k] + at[k]);
        field.samples[at] = field.samples[at].min(d);
    });
}

/// Each corner of the cell of a grid that a point is in.
pub(super) fn for_each_corner<const D: usize>(
    x: [f64; D],
    dims: [usize; D],
    step: [f64; D],
    mut each: impl FnMut([usize; D]),
) {
    // A cast cuts off what is below zero.
    let low: [usize; D] = std::array::from_fn(|k| ((x[k] / step[k]) as usize).min(dims[k] - 2));
    for corner in 0..1usize << D {
        each(std::array::from_fn(|k| low[k] + (corner >> k & 1)));
    }
}

/// Samples along each axis, and the distance between them, of a grid of spacing at most `min / 2` that spans the box.
pub(super) fn coarse_grid<const D: usize>(extent: [f64; D], min: f64) -> ([usize; D], [f64; D]) {
    let cells = extent.map(|e| (2.0 * e / min).ceil().max(1.0) as usize);
    let step = std::array::from_fn(|k| match extent[k] > 0.0 {
        true => extent[k] / cells[k] as f64,
        false => 1.0,
    });
    (cells.map(|c| c + 1), step)
}

/// A field of `max` everywhere, on a grid of spacing at most `min / 2` that spans the box.
pub(crate) fn coarse_field<const D: usize>(extent: [f64; D], min: f64, max: f64) -> ScalarField<D> {
    let (dims, step) = coarse_grid(extent, min);
    ScalarField {
        dims,
        step,
        samples: vec![max as f32; dims.iter().product()],
    }
}

impl DistanceLimits {
    /// Refuses limits that are not positive and in order, and a growth that is not in (0, 1].
    pub(super) fn check(self) -> Result<()> {
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
                format!("growth {growth} is not in (0, 1]"),
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
            // The foot is up to a cell (two samples) wide on either side; interpolation rounds the kinks.
            let away = (p[0] - 20.3f64).abs();
            let (least, most) = (4.0 + 0.1 * (away - 2.05).max(0.0), 4.0 + 0.1 * away);
            let got = d.value_at(p);
            assert!(
                got >= least.min(7.0) - 5e-3 && got <= most.min(7.0) + 1e-4,
                "{x} {got}"
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
