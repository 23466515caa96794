//! Faults and horizons in one potential.
//!
//! Each kind is found as if alone. At every sample, b(x) is the lower of the two potentials, each
//! multiplied by its weight. Where a horizon ends at a fault, both have valleys, and atoms move to
//! either.

use super::DetectorTask;
use super::faults::Faults;
use super::horizons::Horizons;
use crate::error::Result;
use crate::feature::{DetectionOptions, Features, PointCounts, SharedGrid, SurfaceName};

/// Returns the two detectors with their options. The requested threshold is an amplitude, so it
/// applies to horizons; that of faults is chosen from the image.
pub fn detector_tasks<const D: usize>(options: &DetectionOptions<D>) -> Vec<DetectorTask<D>> {
    let fault_options = DetectionOptions {
        threshold: None,
        ..options.clone()
    };
    vec![(&Faults, fault_options), (&Horizons, options.clone())]
}

/// Combines features of two kinds; the depths of their valleys are the weights.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn combine<const D: usize>(
    mut first: Features<D>,
    second: Features<D>,
    weights: [f64; 2],
    grid: SharedGrid<'_, D>,
) -> Result<Features<D>> {
    let [a, b] = weights.map(|w| w as f32);
    let deepest = |first: f32, second: f32| (a * first).min(b * second);
    let counts = [&first, &second].map(Features::point_counts);
    let max_surface = first.surface.iter().copied().max().unwrap_or(0);
    let max_surface = grid.max("surfaces", max_surface)?;
    first.global_counts = first.global_counts.map(|_| PointCounts {
        points: counts[0].points + counts[1].points,
        on_horizon: counts[0].on_horizon + counts[1].on_horizon,
    });
    first.potential = first.potential.combine(&second.potential, deepest);
    first.points.extend(second.points);
    first.on_horizon.extend(second.on_horizon);
    first
        .surface
        .extend(second.surface.iter().map(|s| max_surface + s));
    first
        .names
        .extend(second.names.into_iter().map(|name| SurfaceName {
            number: max_surface + name.number,
            ..name
        }));
    first.spacing = (first.spacing.zip(second.spacing)).map(|(a, b)| [a, b].concat());
    first.outcomes.extend(second.outcomes);
    first.notes.extend(second.notes);
    first.resolved.extend(second.resolved);
    first.sort_points(grid)?;
    Ok(first)
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::plane_image;
    use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint, detect};

    #[test]
    fn faults_and_horizons_share_one_potential_by_weight() {
        // Layers across x in a plane image, displaced by half a period at y = 40.
        let dims = [72, 80];
        let image = plane_image(dims, |p| {
            let throw = if p[1] > 40.0 { 6.0 } else { 0.0 };
            (std::f64::consts::TAU * (p[0] + throw) / 12.0).cos()
        });
        let options = |kind, weights| DetectionOptions {
            weights,
            ..DetectionOptions::with_kind(kind, 4.0)
        };
        let run = |kind, weights| detect(&image, &options(kind, weights)).unwrap();
        let faults = run(FeatureKind::Faults, [1.0; 2]);
        let on_fault = |p: &&FeaturePoint<2>| (p.position[1] - 40.5).abs() < 1.0;
        assert!(faults.points.len() > 50, "{:?}", faults.notes);
        assert_eq!(
            faults.points.iter().filter(on_fault).count(),
            faults.points.len()
        );
        let horizons = run(FeatureKind::Horizons, [1.0; 2]);
        let combined = run(FeatureKind::FaultsAndHorizons, [1.0, 0.5]);
        assert_eq!(
            combined.points.len(),
            faults.points.len() + horizons.points.len()
        );
        let [faults, horizons, combined] =
            [faults, horizons, combined].map(|features| features.potential.to_dense().samples);
        for (b, (f, h)) in combined.iter().zip(faults.iter().zip(&horizons)) {
            assert_eq!(*b, f.min(0.5 * h));
        }
        let invalid = options(FeatureKind::FaultsAndHorizons, [0.0, 1.0]);
        assert!(detect(&image, &invalid).is_err());
    }
}
