//! Features of images whose truth is known.

use super::scenes::{
    Noise, Sheet, crossing_sheets, fit, image_of, ridge_image, ridges_in_correlated_noise,
};
use super::*;
use crate::image::Geometry;

fn options<const D: usize>(kind: Kind, d_min: f64) -> Options<D> {
    Options {
        kind,
        d_min,
        ..Options::default()
    }
}

#[test]
fn noisy_crossing_curved_sheets_are_found() {
    let (dims, sheets) = crossing_sheets();
    for (width, noise) in [(1.0, 0.2), (1.5, 0.0), (1.5, 0.25), (2.0, 0.25)] {
        let image = ridge_image(dims, &sheets, width, noise);
        let features = detect(&image, &options(Kind::Ridges, 8.0)).unwrap();
        let fit = fit(dims, &sheets, &features.points);
        assert!(fit.coverage > 0.99, "{width} {noise} {fit:?}");
        assert!(fit.precision > 0.995, "{width} {noise} {fit:?}");
        assert!(fit.rms < 0.15, "{width} {noise} {fit:?}");
        assert!(fit.angle < 3.5, "{width} {noise} {fit:?}");
    }
}

#[test]
fn correlated_noise_is_told_from_sheets() {
    let (dims, sheets) = crossing_sheets();
    for (width, noise, coverage) in [(1.5, 0.15, 0.98), (1.5, 0.2, 0.95), (2.0, 0.25, 0.8)] {
        let image = ridges_in_correlated_noise(dims, &sheets, width, noise, 1.0);
        let features = detect(&image, &options(Kind::Ridges, 8.0)).unwrap();
        let fit = fit(dims, &sheets, &features.points);
        assert!(
            fit.coverage > coverage && fit.precision > 0.97,
            "{width} {noise} {fit:?}"
        );
    }
}

#[test]
fn valleys_are_ridges_upside_down() {
    let (dims, sheets) = (
        [40, 36, 32],
        [Sheet::plane([1.0, 0.3, 0.2], [20.0, 18.0, 16.0])],
    );
    let image = ridge_image(dims, &sheets, 1.5, 0.1);
    let negated = Image::new(
        dims,
        image.as_slice().iter().map(|s| -s).collect(),
        Geometry::default(),
    );
    let ridges = detect(&image, &options(Kind::Ridges, 4.0)).unwrap();
    let valleys = detect(&negated, &options(Kind::Valleys, 4.0)).unwrap();
    assert!(!ridges.points.is_empty());
    assert_eq!(ridges.points, valleys.points);
    assert_eq!(ridges.potential, valleys.potential);
}

#[test]
fn edges_of_a_ball() {
    // Smoothing draws an edge towards its centre of curvature: here by 0.19 samples, the more the
    // stronger it bends; what is left is noise.
    let (dims, ball) = ([60, 56, 52], Sheet::Sphere([30.0, 28.0, 26.0], 19.0));
    let mut noise = Noise::new(3);
    let image = image_of(dims, |p| {
        100.0 / (1.0 + ball.distance(p).exp()) + 5.0 * noise.normal()
    });
    let features = detect(&image, &options(Kind::Edges, 5.0)).unwrap();
    let fit = fit(dims, &[ball], &features.points);
    assert!(
        fit.coverage > 0.98 && fit.precision > 0.98 && fit.rms < 0.24,
        "{fit:?}"
    );
}

#[test]
fn straight_edges_lie_where_they_are() {
    let (dims, wall) = (
        [48, 44, 40],
        [Sheet::plane([1.0, 0.45, -0.3], [24.0, 22.0, 20.0])],
    );
    let mut noise = Noise::new(4);
    let image = image_of(dims, |p| {
        100.0 / (1.0 + wall[0].distance(p).exp()) + 5.0 * noise.normal()
    });
    let features = detect(&image, &options(Kind::Edges, 5.0)).unwrap();
    let fit = fit(dims, &wall, &features.points);
    assert!(
        fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.08 && fit.angle < 2.0,
        "{fit:?}"
    );
}

#[test]
fn interfaces_of_labels_are_smooth_and_counted_once() {
    let dims = [64, 60, 56];
    let ball = || Sheet::Sphere([32.0, 30.0, 28.0], 18.0);
    let floor = || Sheet::plane([0.2, 0.1, 1.0], [32.0, 30.0, 4.0]);
    let image = image_of(dims, |p| {
        if ball().distance(p) < 0.0 {
            7.0
        } else {
            f64::from(u8::from(floor().distance(p) > 0.0))
        }
    });
    let features = detect(&image, &options(Kind::Auto, 5.0)).unwrap();
    assert!(features.notes[0].contains("labels"), "{:?}", features.notes);
    let sheets = [ball(), floor()];
    let fit = fit(dims, &sheets, &features.points);
    assert!(fit.coverage > 0.98 && fit.precision > 0.995, "{fit:?}");
    assert!(fit.rms < 0.2 && fit.angle < 6.0, "{fit:?}");
    // One point per column: the ball has 4 pi r^2 / 1.5 columns, the floor one per (x, y).
    let columns = 4.0 * std::f64::consts::PI * 18.0f64.powi(2) / 1.5 + 64.0 * 60.0;
    let ratio = features.points.len() as f64 / columns;
    assert!(ratio > 0.95 && ratio < 1.25, "{ratio}");
}

#[test]
fn a_thin_mask_is_one_sheet_and_not_two() {
    let (dims, sheets) = (
        [64, 60, 56],
        [Sheet::plane([1.0, 0.35, 0.2], [32.0, 30.0, 28.0])],
    );
    for half in [0.6, 1.5] {
        let image = image_of(dims, |p| {
            255.0 * f64::from(u8::from(sheets[0].distance(p).abs() < half))
        });
        let features = detect(&image, &options(Kind::Auto, 8.0)).unwrap();
        let fit = fit(dims, &sheets, &features.points);
        assert!(
            fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.25,
            "{half} {fit:?}"
        );
    }
}

#[test]
fn horizons_keep_the_lattice_resolution() {
    // Crests and troughs every 6 samples across dipping layers: every second one fits d = 8, which
    // leaves room for a layer of atoms between.
    let dims = [72, 64, 56];
    let layers = Sheet::plane([1.0, 0.25, -0.15], [36.0, 32.0, 28.0]);
    let mut noise = Noise::new(5);
    let image = image_of(dims, |p| {
        let s = layers.distance(p);
        let strength = if (s / 12.0).round() as i64 == 0 {
            1.5
        } else {
            1.0
        };
        strength * (std::f64::consts::TAU * s / 12.0).cos() + 0.1 * noise.normal()
    });
    let features = detect(&image, &options(Kind::Auto, 8.0)).unwrap();
    assert!(
        features.notes[0].contains("horizons"),
        "{:?}",
        features.notes
    );
    assert!(features.points.len() > 5000);
    // Level n is the extremum at s = 6 n.
    let mut levels = [0usize; 41];
    let (mut squares, mut count) = (0.0, 0.0);
    for point in &features.points {
        let p = point.position.map(f64::from);
        if (0..3).all(|k| p[k] > 4.0 && p[k] < dims[k] as f64 - 5.0) {
            let level = (layers.distance(p) / 6.0).round();
            squares += (layers.distance(p) - 6.0 * level).powi(2);
            count += 1.0;
            levels[(level + 20.0) as usize] += 1;
        }
    }
    let rms = f64::sqrt(squares / count);
    assert!(rms < 0.3, "{rms}");
    assert!(levels[20] > 2400, "the strongest is kept whole: {levels:?}");
    for pair in levels.windows(2) {
        let (less, more) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
        assert!(less * 10 <= more, "two levels nearer than 7.2: {levels:?}");
    }
}

#[test]
fn the_valley_is_gaussian_across_and_even_along() {
    let dims = [48, 44, 40];
    let sheets = [
        Sheet::plane([1.0, 0.45, 0.3], [22.0, 22.0, 20.0]),
        Sheet::plane([-0.4, 1.0, 0.2], [24.0, 24.0, 20.0]),
    ];
    let image = ridge_image(dims, &sheets, 1.5, 0.0);
    let d_min = 8.0;
    let features = detect(&image, &options(Kind::Ridges, d_min)).unwrap();
    let (sigma, rest) = (features.sigma, (-4.5f64).exp());
    assert_eq!(sigma, d_min / 4.0);
    // Off the crossing, and at it (where both sheets are within three samples).
    let (mut worst, mut deepest) = ([0.0f64; 2], 0.0f32);
    for z in 5..35 {
        for y in 5..39 {
            for x in 5..43 {
                let p = [x as f64, y as f64, z as f64];
                let b = features.potential.samples[(z * 44 + y) * 48 + x];
                deepest = deepest.min(b);
                let s = sheets
                    .iter()
                    .map(|s| s.distance(p).abs())
                    .fold(f64::MAX, f64::min);
                let bell = (-0.5 * (s / sigma).powi(2)).exp().max(rest);
                let crossing = sheets.iter().all(|s| s.distance(p).abs() < 3.0);
                let worst = &mut worst[usize::from(crossing)];
                *worst = worst.max((f64::from(b) + (bell - rest) / (1.0 - rest)).abs());
            }
        }
    }
    assert!(worst[0] < 0.08 && worst[1] < 0.2, "{worst:?}");
    assert!((-1.0..-0.99).contains(&deepest), "{deepest}");
}

#[test]
fn a_ready_potential_is_kept() {
    let (dims, sheets) = ([32, 32, 32], [Sheet::plane([1.0, 0.3, 0.2], [16.0; 3])]);
    let ridges = ridge_image(dims, &sheets, 2.0, 0.0);
    let b: Vec<f32> = ridges.as_slice().iter().map(|s| -s).collect();
    let image = Image::new(dims, b.clone(), Geometry::default());
    let features = detect(&image, &options(Kind::Auto, 8.0)).unwrap();
    assert!(
        features.notes[0].contains("potential"),
        "{:?}",
        features.notes
    );
    assert_eq!(features.potential.samples, b);
    assert!(fit(dims, &sheets, &features.points).coverage > 0.99);
    assert!(detect(&ridges, &options(Kind::Potential, 8.0)).is_err());
}

#[test]
fn steps_scale_positions_and_turn_normals() {
    let (dims, sheets) = (
        [48, 44, 40],
        [Sheet::plane([1.0, 0.4, 0.3], [24.0, 22.0, 20.0])],
    );
    let image = ridge_image(dims, &sheets, 1.5, 0.0);
    let step = [0.5, 2.0, 1.0];
    let features = detect(
        &image,
        &Options {
            step,
            ..options(Kind::Ridges, 8.0)
        },
    )
    .unwrap();
    assert_eq!(features.potential.step, step);
    let scaled = Sheet::plane([1.0 / 0.5, 0.4 / 2.0, 0.3], [12.0, 44.0, 20.0]);
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
fn auto_tells_ridges_and_edges() {
    let (dims, sheets) = crossing_sheets();
    let note =
        |image: &Image<3>| detect(image, &options(Kind::Auto, 8.0)).unwrap().notes[0].clone();
    let ridges = note(&ridge_image(dims, &sheets, 1.5, 0.25));
    assert!(ridges.contains("features: ridges"), "{ridges}");
    let mut noise = Noise::new(9);
    let blob = image_of([48, 48, 48], |p| {
        let r = (0..3).map(|k| (p[k] - 24.0).powi(2)).sum::<f64>().sqrt();
        80.0 + 60.0 * f64::from(u8::from(r < 18.0)) + 4.0 * noise.normal()
    });
    let edges = note(&blob);
    assert!(edges.contains("features: edges"), "{edges}");
}

#[test]
fn threads_do_not_change_a_bit() {
    let (dims, sheets) = crossing_sheets();
    let image = ridge_image(dims, &sheets, 1.5, 0.25);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| detect(&image, &options(Kind::Ridges, 6.0)).unwrap())
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.points, three.points);
    assert_eq!(one.potential, three.potential);
}

#[test]
fn noise_alone_gives_hardly_any_feature() {
    let mut noise = Noise::new(11);
    let image = image_of([64, 64, 64], |_| noise.normal());
    let features = detect(&image, &options(Kind::Ridges, 8.0)).unwrap();
    assert!(features.points.len() < 1000, "{:?}", features.notes);
}

#[test]
fn images_whose_samples_cannot_be_numbered_are_refused() {
    let large = |dims: [usize; 3]| super::refuse_too_many(dims, Kind::Ridges);
    // The last candidate's number, and the end of the last row, fit in 32 bits.
    assert!(large([1 << 16, 1 << 8, (1 << 8) - 1]).is_ok());
    assert!(large([65_537, 65_535, 1]).is_ok());
    for dims in [[1 << 16, 1 << 16, 1], [2048, 2048, 1024], [usize::MAX; 3]] {
        let error = large(dims).unwrap_err().to_string();
        assert!(error.contains("found among 4294967295"), "{error}");
    }
    assert!(large([1 << 31, 1, 1]).is_err(), "an axis counts in 31 bits");
    // Shortest paths run through two copies of the image.
    let plane = |n| super::refuse_too_many([n, 1 << 16], Kind::Paths);
    assert!(plane((1 << 15) - 1).is_ok() && plane(1 << 15).is_err());
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let (dims, sheets) = ([16, 15, 14], [Sheet::plane([1.0, 0.0, 0.0], [8.0; 3])]);
    let image = ridge_image(dims, &sheets, 1.5, 0.1);
    let message = |image: &Image<3>, options: Options<3>| {
        let message = detect(image, &options).unwrap_err().to_string();
        assert!(
            !message.contains('\n') && message.contains("; "),
            "{message}"
        );
        message
    };
    let good = options(Kind::Ridges, 4.0);
    assert!(
        message(
            &image,
            Options {
                d_min: 0.0,
                ..good.clone()
            }
        )
        .contains("distance 0")
    );
    assert!(
        message(
            &image,
            Options {
                step: [1.0, f64::NAN, 1.0],
                ..good.clone()
            }
        )
        .contains("step")
    );
    assert!(
        message(
            &image,
            Options {
                scale: Some(0.1),
                ..good.clone()
            }
        )
        .contains("scale 0.1")
    );
    assert!(
        message(
            &image,
            Options {
                threshold: Some(f32::NAN),
                ..good.clone()
            }
        )
        .contains("threshold")
    );
    assert!(
        message(
            &image,
            Options {
                kind: Kind::Labels,
                ..good.clone()
            }
        )
        .contains("different values")
    );
    let mut samples = image.as_slice().to_vec();
    samples[16 * 15 * 2 + 16 * 3 + 5] = f32::NAN;
    let broken = Image::new(dims, samples, Geometry::default());
    assert!(message(&broken, good.clone()).contains("[5, 3, 2]"));
    let flat = Image::new(dims, vec![3.0; 16 * 15 * 14], Geometry::default());
    assert!(message(&flat, good).contains("constant"));
}

#[test]
fn kinds_have_the_names_of_the_command_line() {
    for (kind, name) in NAMES {
        assert_eq!(kind.to_string(), name);
        assert_eq!(name.parse::<Kind>().unwrap(), kind);
    }
    let message = "ridge".parse::<Kind>().unwrap_err().to_string();
    assert!(
        message.contains("'ridge'") && message.contains("ridges"),
        "{message}"
    );
}

/// An image of two dimensions of a function of the sample coordinates.
fn plane_image(dims: [usize; 2], mut f: impl FnMut([f64; 2]) -> f64) -> Image<2> {
    let at = |i: usize| [(i % dims[0]) as f64, (i / dims[0]) as f64];
    let samples = (0..dims[0] * dims[1]).map(|i| f(at(i)) as f32).collect();
    Image::new(dims, samples, Geometry::default())
}

/// Share of the curve `along(t)`, t from 0 to 1, within half a sample of a point, and the rms
/// distance `off` of the points.
fn curve_fit(
    features: &Features<2>,
    along: impl Fn(f64) -> [f64; 2],
    off: impl Fn([f64; 2]) -> f64,
) -> (f64, f64) {
    let covered = (0..=1000).filter(|&i| {
        let p = along(f64::from(i) / 1000.0);
        features.points.iter().any(|point| {
            let r: [f64; 2] = std::array::from_fn(|k| f64::from(point.position[k]) - p[k]);
            let s = r[0] * f64::from(point.normal[0]) + r[1] * f64::from(point.normal[1]);
            s.abs() <= 0.5 && r[0].hypot(r[1]) <= 1.2
        })
    });
    let squares: f64 = features
        .points
        .iter()
        .map(|p| off(p.position.map(f64::from)).powi(2))
        .sum();
    let rms = (squares / features.points.len().max(1) as f64).sqrt();
    (covered.count() as f64 / 1001.0, rms)
}

#[test]
fn curves_of_a_plane_image_are_found() {
    let dims = [120, 100];
    let (centre, radius) = ([30.0, -40.0], 80.0);
    let ring = |p: [f64; 2]| (p[0] - centre[0]).hypot(p[1] - centre[1]) - radius;
    let line = |p: [f64; 2]| 0.8 * (p[0] - 60.0) - 0.6 * (p[1] - 50.0);
    let mut noise = Noise::new(21);
    let bell = |s: f64| (-0.5 * (s / 1.5).powi(2)).exp();
    let image = plane_image(dims, |p| {
        bell(ring(p)).max(bell(line(p))) + 0.15 * noise.normal()
    });
    let features = detect(&image, &options(Kind::Auto, 8.0)).unwrap();
    assert!(features.notes[0].contains("ridges"), "{:?}", features.notes);
    let nearest = |p: [f64; 2]| ring(p).abs().min(line(p).abs());
    let (arc, rms) = curve_fit(
        &features,
        |t| {
            let angle = 0.55 + 1.3 * t;
            [
                centre[0] + radius * angle.cos(),
                centre[1] + radius * angle.sin(),
            ]
        },
        nearest,
    );
    let (straight, _) = curve_fit(&features, |t| [30.0 + 60.0 * t, 10.0 + 80.0 * t], nearest);
    assert!(
        arc > 0.93 && straight > 0.97 && rms < 0.3,
        "{arc} {straight} {rms} {:?}",
        features.notes
    );
    assert_eq!(features.potential.dims, dims);
    let deepest = features
        .potential
        .samples
        .iter()
        .copied()
        .fold(0.0, f32::min);
    assert!((-1.0..-0.98).contains(&deepest), "{deepest}");
}

/// Worst distance (samples) of ridge points from a straight Gaussian ridge through the middle, and
/// worst angle (degrees) between normals, away from the sides.
fn straight_ridge<const D: usize>(dims: [usize; D], normal: [f64; D], width: f64) -> (f64, f64) {
    let middle = dims.map(|n| 0.5 * n as f64 + 0.13);
    let off = |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
    let count = dims.iter().product();
    let empty = Volume { dims, samples: &[] };
    let at = |i: usize| empty.coordinates(i).map(|c| c as f64);
    let samples: Vec<f32> = (0..count)
        .map(|i| (-0.5 * (off(at(i)) / width).powi(2)).exp() as f32)
        .collect();
    let image = Image::new(dims, samples, Geometry::default());
    let features = detect(&image, &options(Kind::Ridges, 5.0)).unwrap();
    let (mut worst, mut turned, mut inner) = ([0.0f64; 2], 0.0f64, 0);
    for point in &features.points {
        let p = point.position.map(f64::from);
        if (0..D).all(|k| p[k] > 7.0 && p[k] < dims[k] as f64 - 8.0) {
            inner += 1;
            worst[0] = worst[0].max(off(p).abs());
            let c: f64 = (0..D).map(|k| normal[k] * f64::from(point.normal[k])).sum();
            turned = turned.max(c.abs().min(1.0).acos().to_degrees());
        }
    }
    assert!(inner > dims[0] / 3, "{inner} {normal:?}");
    (worst[0], turned)
}

#[test]
fn ridges_lie_where_they_are_at_every_dip() {
    for width in [1.0, 2.0] {
        for dip in (0..180).step_by(9) {
            let (sin, cos) = f64::from(dip).to_radians().sin_cos();
            let (off, angle) = straight_ridge([48, 44], [cos, sin], width);
            assert!(off < 0.1 && angle < 0.5, "2-D {width} {dip} {off} {angle}");
        }
        for dip in (0..=90).step_by(18) {
            for azimuth in (0..360).step_by(40) {
                let (dip, azimuth) = (f64::from(dip).to_radians(), f64::from(azimuth).to_radians());
                let normal = [
                    dip.cos(),
                    dip.sin() * azimuth.cos(),
                    dip.sin() * azimuth.sin(),
                ];
                let (off, angle) = straight_ridge([30, 29, 32], normal, width);
                assert!(off < 0.1 && angle < 0.5, "3-D {normal:?} {off} {angle}");
            }
        }
    }
}

/// Shares of the true faults within two samples of a point, and of the points within two samples of a
/// true fault.
fn recall_and_precision<const D: usize>(
    dims: [usize; D],
    distance: &[f32],
    points: &[FeaturePoint<D>],
) -> [f64; 2] {
    let space = Volume { dims, samples: &[] };
    let mut near = vec![false; distance.len()];
    let mut good = 0;
    for point in points {
        let at: [usize; D] = point.position.map(|c| c.round() as usize);
        good += usize::from(distance[space.index(at)].abs() < 2.0);
        for number in 0..5usize.pow(D as u32) {
            let (mut rest, mut to, mut square) = (number, at, 0);
            for k in 0..D {
                let offset = rest % 5;
                square += offset.abs_diff(2).pow(2);
                to[k] = (at[k] + offset).saturating_sub(2).min(dims[k] - 1);
                rest /= 5;
            }
            if square <= 4 {
                near[space.index(to)] = true;
            }
        }
    }
    let on = |(d, near): (&f32, &bool)| (d.abs() < 0.5).then_some(*near);
    let on: Vec<bool> = distance.iter().zip(&near).filter_map(on).collect();
    let found = on.iter().filter(|near| **near).count();
    [
        found as f64 / on.len() as f64,
        good as f64 / points.len().max(1) as f64,
    ]
}

#[test]
fn faults_of_amplitude_are_found_where_layers_are_thrown() {
    for (seed, signal_to_noise, recall, precision) in [
        (1, 4.0, 0.95, 0.88),
        (2, 4.0, 0.95, 0.94),
        (1, 2.0, 0.8, 0.9),
    ] {
        let made = crate::image::synth::make(
            crate::image::synth::Kind::Amplitude,
            &crate::image::synth::Options {
                dims: [96, 80, 72],
                count: 2,
                seed,
                signal_to_noise,
                ..Default::default()
            },
        )
        .unwrap();
        let features = detect(&made.image, &options(Kind::Faults, 8.0)).unwrap();
        let dims = made.image.dims();
        let found = recall_and_precision(dims, &made.truth.distance, &features.points);
        assert!(
            found[0] > recall && found[1] > precision,
            "{seed} {signal_to_noise} {found:?} {:?}",
            features.notes
        );
    }
}

/// Layers across x thrown along x by `throw` on one side of a plane with this unit normal through the
/// middle: rms distance (samples) of fault points from the plane, rms angle (degrees) between their
/// normals and its, and points per column of samples that the plane crosses; all away from the sides.
fn straight_fault<const D: usize>(dims: [usize; D], normal: [f64; D], throw: f64) -> [f64; 3] {
    let middle = dims.map(|n| 0.5 * (n as f64 - 1.0));
    let off = |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
    let mut noise = Noise::new(17);
    let space = Volume { dims, samples: &[] };
    let samples = (0..dims.iter().product())
        .map(|i| {
            let p = space.coordinates(i).map(|c| c as f64);
            let depth = p[0] + if off(p) > 0.0 { throw } else { 0.0 };
            // Three periods that are no multiples of one another.
            let waves = [(0.52, 1.0), (0.71, 0.8), (0.33, 0.7)];
            let wave = |(k, height): (f64, f64)| height * (k * depth).sin();
            (waves.map(wave).iter().sum::<f64>() + 0.25 * noise.normal()) as f32
        })
        .collect();
    let image = Image::new(dims, samples, Geometry::default());
    let features = detect(&image, &options(Kind::Faults, 6.0)).unwrap();
    let inner = |p: &[f64; D]| (0..D).all(|k| p[k] > 6.0 && p[k] < dims[k] as f64 - 7.0);
    let (mut squares, mut angles, mut count) = (0.0, 0.0, 0.0);
    for point in &features.points {
        let p = point.position.map(f64::from);
        if inner(&p) {
            squares += off(p).powi(2);
            let c: f64 = (0..D).map(|k| normal[k] * f64::from(point.normal[k])).sum();
            angles += c.abs().min(1.0).acos().to_degrees().powi(2);
            count += 1.0;
        }
    }
    let axis = (1..D).fold(0, |a, k| {
        if normal[k].abs() > normal[a].abs() {
            k
        } else {
            a
        }
    });
    let columns = (0..dims.iter().product()).filter(|i| {
        let p = space.coordinates(*i).map(|c| c as f64);
        let s = off(p) / normal[axis];
        s > -0.5 && s <= 0.5 && inner(&p)
    });
    [
        f64::sqrt(squares / count),
        f64::sqrt(angles / count),
        count / columns.count() as f64,
    ]
}

#[test]
fn straight_faults_lie_where_they_are_at_every_dip_and_throw() {
    let good = |[off, angle, covered]: [f64; 3]| off < 0.5 && angle < 5.5 && covered > 0.98;
    for throw in [2.5, 4.0, 7.0] {
        for dip in (50..=130).step_by(10) {
            let (sin, cos) = f64::from(dip).to_radians().sin_cos();
            let fit = straight_fault([96, 80], [cos, sin], throw);
            assert!(good(fit), "2-D {throw} {dip} {fit:?}");
        }
        for (dip, azimuth) in [
            (90, 0),
            (75, 20),
            (60, 45),
            (110, 70),
            (65, 100),
            (120, 150),
        ] {
            let (dip, azimuth) = (f64::from(dip).to_radians(), f64::from(azimuth).to_radians());
            let normal = [
                dip.cos(),
                dip.sin() * azimuth.cos(),
                dip.sin() * azimuth.sin(),
            ];
            let fit = straight_fault([64, 56, 48], normal, throw);
            assert!(good(fit), "3-D {throw} {dip} {azimuth} {fit:?}");
        }
    }
}

#[test]
fn faults_and_horizons_share_one_potential_by_weight() {
    // Layers across x in a plane image, thrown by half a period at y = 40.
    let dims = [72, 80];
    let image = plane_image(dims, |p| {
        let throw = if p[1] > 40.0 { 6.0 } else { 0.0 };
        (std::f64::consts::TAU * (p[0] + throw) / 12.0).cos()
    });
    let run = |kind, weights| {
        let chosen = Options {
            weights,
            ..options(kind, 4.0)
        };
        detect(&image, &chosen).unwrap()
    };
    let faults = run(Kind::Faults, [1.0; 2]);
    let on_fault = |p: &&FeaturePoint<2>| (p.position[1] - 40.5).abs() < 1.0;
    assert!(faults.points.len() > 50, "{:?}", faults.notes);
    assert_eq!(
        faults.points.iter().filter(on_fault).count(),
        faults.points.len()
    );
    let horizons = run(Kind::Horizons, [1.0; 2]);
    let both = run(Kind::FaultsAndHorizons, [1.0, 0.5]);
    assert_eq!(
        both.points.len(),
        faults.points.len() + horizons.points.len()
    );
    let parts = faults
        .potential
        .samples
        .iter()
        .zip(&horizons.potential.samples);
    for (b, (f, h)) in both.potential.samples.iter().zip(parts) {
        assert_eq!(*b, f.min(0.5 * h));
    }
    let refused = Options {
        weights: [0.0, 1.0],
        ..options(Kind::FaultsAndHorizons, 4.0)
    };
    assert!(detect(&image, &refused).is_err());
}
