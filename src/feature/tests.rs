//! Tests of features in images whose truth is known, for all kinds of features.

use super::scenes::{ExactSurface, crossing_surfaces, ridge_image};
use super::*;

#[test]
fn steps_scale_positions_and_turn_normals() {
    let (dims, surfaces) = (
        [48, 44, 40],
        [ExactSurface::plane([1.0, 0.4, 0.3], [24.0, 22.0, 20.0])],
    );
    let image = ridge_image(dims, &surfaces, 1.5, 0.0);
    let step = [0.5, 2.0, 1.0];
    let features = detect(
        &image,
        &DetectionOptions {
            step,
            ..DetectionOptions::with_kind(FeatureKind::Ridges, 8.0)
        },
    )
    .unwrap();
    assert_eq!(features.potential.step, step);
    let scaled = ExactSurface::plane([1.0 / 0.5, 0.4 / 2.0, 0.3], [12.0, 44.0, 20.0]);
    assert!(features.points.len() > 1000);
    for point in &features.points {
        let p = point.position.map(f64::from);
        assert!(scaled.distance(p).abs() < 0.1);
        let n = scaled.normal(p);
        let c: f64 = (0..3).map(|k| n[k] * f64::from(point.normal[k])).sum();
        assert!(c.abs() > 0.999, "{c}");
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let (dims, surfaces) = crossing_surfaces();
    let image = ridge_image(dims, &surfaces, 1.5, 0.25);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            detect(
                &image,
                &DetectionOptions::with_kind(FeatureKind::Ridges, 6.0),
            )
            .unwrap()
        })
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.points, three.points);
    assert_eq!(one.potential, three.potential);
}
