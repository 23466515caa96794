//! Faults and horizons in one potential.
//!
//! Each is found as if alone; b(x) is the deeper of the two at every sample, the valleys of each kind
//! as deep as its weight says. Where a horizon ends at a fault both are valleys, and atoms come to rest
//! on either.

use super::faults::Faults;
use super::horizons::Horizons;
use super::{DetectionOptions, DetectorTask};
use crate::comm::{Comm, WorldComm};
use crate::error::Result;
use crate::feature::{Features, PointCounts};

/// The two detectors. A threshold that is asked for is one of amplitude, so it is the horizons'; the
/// faults' own is found from the image.
pub fn detector_tasks<const D: usize>(asked: &DetectionOptions<D>) -> Vec<DetectorTask<D>> {
    let of_faults = DetectionOptions {
        threshold: None,
        ..asked.clone()
    };
    vec![(&Faults, of_faults), (&Horizons, asked.clone())]
}

/// Features of two kinds as one; their valleys are as deep as the weights say.
///
/// # Errors
/// Those of other ranks.
pub fn combine<const D: usize>(
    mut first: Features<D>,
    second: Features<D>,
    weights: [f64; 2],
) -> Result<Features<D>> {
    let [a, b] = weights.map(|w| w as f32);
    let deepest = |first: f32, second: f32| (a * first).min(b * second);
    let group: &dyn Comm = &WorldComm;
    let of_all = [&first, &second].map(Features::point_counts);
    let last: Vec<u32> =
        group.all_gather("sheets", first.surface.iter().copied().max().unwrap_or(0))?;
    let last = last.into_iter().max().unwrap_or(0);
    first.global_counts = first.global_counts.map(|_| PointCounts {
        points: of_all[0].points + of_all[1].points,
        on_horizon: of_all[0].on_horizon + of_all[1].on_horizon,
    });
    first.potential = first.potential.combine(&second.potential, deepest);
    first.points.extend(second.points);
    first.on_horizon.extend(second.on_horizon);
    first
        .surface
        .extend(second.surface.iter().map(|s| last + s));
    first.spacing = (first.spacing.zip(second.spacing)).map(|(a, b)| [a, b].concat());
    first.outcomes.extend(second.outcomes);
    first.notes.extend(second.notes);
    first.resolved.extend(second.resolved);
    first.sort_points(group)?;
    Ok(first)
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::plane_image;
    use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint, detect};

    #[test]
    fn faults_and_horizons_share_one_potential_by_weight() {
        // Layers across x in a plane image, thrown by half a period at y = 40.
        let dims = [72, 80];
        let image = plane_image(dims, |p| {
            let throw = if p[1] > 40.0 { 6.0 } else { 0.0 };
            (std::f64::consts::TAU * (p[0] + throw) / 12.0).cos()
        });
        let asked = |kind, weights| DetectionOptions {
            weights,
            ..DetectionOptions::with_kind(kind, 4.0)
        };
        let run = |kind, weights| detect(&image, &asked(kind, weights)).unwrap();
        let faults = run(FeatureKind::Faults, [1.0; 2]);
        let on_fault = |p: &&FeaturePoint<2>| (p.position[1] - 40.5).abs() < 1.0;
        assert!(faults.points.len() > 50, "{:?}", faults.notes);
        assert_eq!(
            faults.points.iter().filter(on_fault).count(),
            faults.points.len()
        );
        let horizons = run(FeatureKind::Horizons, [1.0; 2]);
        let both = run(FeatureKind::FaultsAndHorizons, [1.0, 0.5]);
        assert_eq!(
            both.points.len(),
            faults.points.len() + horizons.points.len()
        );
        let [faults, horizons, both] =
            [faults, horizons, both].map(|found| found.potential.to_dense().samples);
        for (b, (f, h)) in both.iter().zip(faults.iter().zip(&horizons)) {
            assert_eq!(*b, f.min(0.5 * h));
        }
        let refused = asked(FeatureKind::FaultsAndHorizons, [0.0, 1.0]);
        assert!(detect(&image, &refused).is_err());
    }
}
