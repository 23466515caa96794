use super::*;
use crate::feature::{DetectionOptions, FeatureKind, Features, detect};
use crate::image::{Geometry, Image};
use crate::mesh::check::check;
use crate::mesh::delaunay::delaunay_plane;

/// A ball (a disc in the plane) of 100 on a background that rises from 0 to 20 along x.
fn ball<const D: usize>(dims: [usize; D], radius: f64) -> Image<D> {
    let empty = Volume { dims, samples: &[] };
    let value = |i: usize| {
        let sample = empty.coordinates(i);
        let squares = (0..D).map(|k| (sample[k] as f64 - 0.5 * (dims[k] - 1) as f64 - 0.3).powi(2));
        let outside = squares.sum::<f64>().sqrt() - radius;
        (100.0 * (0.5 - outside).clamp(0.0, 1.0) + 20.0 * sample[0] as f64 / dims[0] as f64) as f32
    };
    let samples = (0..dims.iter().product()).map(value).collect();
    Image::new(dims, samples, Geometry::default())
}

fn seed_image<const D: usize>(image: &Image<D>) -> (Features<D>, Atoms<D>, Distance<D>) {
    let options = DetectionOptions {
        kind: FeatureKind::Canny,
        d_min: min_point_distance(D),
        ..DetectionOptions::default()
    };
    let features = detect(image, &options).unwrap();
    let field = ScalarField {
        dims: image.dims(),
        step: [1.0; D],
        samples: image.as_slice().to_vec(),
    };
    let (atoms, distance) =
        place_atoms(&features.points, &field, &[], &CancelToken::never()).unwrap();
    (features, atoms, distance)
}

fn distance2<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (0..D).map(|k| (a[k] - b[k]).powi(2)).sum()
}

/// Checks that every feature point has an atom within its radius, that no two atoms on features are
/// in each other's smallest window, and that d(x) at every atom is at most the distance to the
/// nearest atom.
fn check_thinning<const D: usize>(image: &Image<D>) {
    let (features, atoms, distance) = seed_image(image);
    let on_features: Vec<[f64; D]> = atoms
        .positions
        .iter()
        .zip(&atoms.kinds)
        .filter(|(_, kind)| **kind == AtomKind::Fixed)
        .map(|(x, _)| *x)
        .collect();
    assert!(
        on_features.len() > 20 && on_features.len() * 2 < features.points.len(),
        "{}",
        on_features.len()
    );
    for point in &features.points {
        let x = point.position.map(f64::from);
        let radius = f64::from(radii(D)[2]) + 1.0;
        let is_near = |a: &&[f64; D]| (0..D).all(|k| (a[k] - x[k]).abs() <= radius);
        assert!(on_features.iter().any(|a| is_near(&a)), "{x:?}");
    }
    for (n, a) in on_features.iter().enumerate() {
        let distances = on_features[..n].iter().map(|b| distance2(a, b).sqrt());
        assert!(distances.fold(f64::INFINITY, f64::min) > min_point_distance(D) - 1.1);
    }
    for (n, x) in atoms.positions.iter().enumerate() {
        let others = (0..atoms.len()).filter(|&m| m != n);
        let nearest = others.map(|m| distance2(x, &atoms.positions[m]));
        let nearest = nearest.fold(f64::INFINITY, f64::min).sqrt();
        assert!(distance.value_at(*x) <= nearest * 1.0001, "{x:?}");
    }
    distance
        .validate(image.dims().map(|n| (n - 1) as f64))
        .unwrap();
}

#[test]
fn feature_points_are_thinned_and_make_the_distance() {
    check_thinning(&ball([96, 80], 30.0));
    check_thinning(&ball([48, 44, 40], 14.0));
}

#[test]
fn straight_features_keep_fewer_points_than_corners() {
    let dims = [64, 64];
    let line: Vec<FeaturePoint<2>> = (10..50)
        .map(|i| FeaturePoint {
            position: [i as f32, 20.2],
            normal: [0.0, 1.0],
            strength: 1.0,
        })
        .collect();
    let kept = thin_points(
        &line,
        dims,
        [1.0; 2],
        &mut OccupiedSamples::new(dims),
        &CancelToken::never(),
    );
    let gaps: Vec<f64> = kept.windows(2).map(|w| w[1][0] - w[0][0]).collect();
    assert!(gaps.iter().all(|g| *g == 6.0), "{gaps:?}");
    // A right angle: around its corner the points spread alike in both directions.
    let mut corner = line.clone();
    corner.extend((20..60).map(|i| FeaturePoint {
        position: [30.2, i as f32],
        normal: [1.0, 0.0],
        strength: 1.0,
    }));
    let kept = thin_points(
        &corner,
        dims,
        [1.0; 2],
        &mut OccupiedSamples::new(dims),
        &CancelToken::never(),
    );
    let is_near = |x: &&[f64; 2]| (x[0] - 30.2).hypot(x[1] - 20.2) < 3.5;
    assert!(kept.iter().filter(is_near).count() >= 2, "{kept:?}");
    // The step of the lattice does not matter.
    let stretch = |p: &FeaturePoint<2>| FeaturePoint {
        position: [2.0 * p.position[0], 0.5 * p.position[1]],
        ..*p
    };
    let stretched: Vec<_> = corner.iter().map(stretch).collect();
    let kept_stretched = thin_points(
        &stretched,
        dims,
        [2.0, 0.5],
        &mut OccupiedSamples::new(dims),
        &CancelToken::never(),
    );
    assert_eq!(kept_stretched.len(), kept.len());
}

/// Returns the edge of a disc as a detector finds it: the samples nearest to the edge along an
/// axis, each moved onto the edge.
fn circle(dims: [usize; 2], centre: [f64; 2], radius: f64) -> Vec<FeaturePoint<2>> {
    let empty = Volume { dims, samples: &[] };
    let mut points = Vec::new();
    for i in 0..dims[0] * dims[1] {
        let sample = empty.coordinates(i);
        let offset: [f64; 2] = std::array::from_fn(|k| sample[k] as f64 - centre[k]);
        let r = offset[0].hypot(offset[1]);
        if (r - radius).abs() <= 0.5 * offset[0].abs().max(offset[1].abs()) / r.max(1e-9) {
            points.push(FeaturePoint {
                position: std::array::from_fn(|k| (centre[k] + radius / r * offset[k]) as f32),
                normal: std::array::from_fn(|k| (offset[k] / r) as f32),
                strength: 1.0,
            });
        }
    }
    points
}

#[test]
fn the_more_a_line_bends_the_more_of_its_points_are_kept() {
    let dims = [120, 120];
    // Mean over some centres, because samples lie differently around each.
    let spacing = |radius: f64| {
        let centres = [[60.3, 59.7], [60.0, 60.5], [59.9, 60.15], [60.45, 60.3]];
        let kept = centres.map(|centre| {
            let points = circle(dims, centre, radius);
            let occupied = &mut OccupiedSamples::new(dims);
            thin_points(&points, dims, [1.0; 2], occupied, &CancelToken::never()).len() as f64
        });
        2.0 * std::f64::consts::PI * radius * 4.0 / kept.iter().sum::<f64>()
    };
    let spacings = [3.0, 5.0, 6.0, 7.0, 8.0].map(spacing);
    println!("{spacings:?}");
    assert!(spacings[1] <= 3.0, "{spacings:?}");
    assert!(spacings.is_sorted_by(|a, b| a < b), "{spacings:?}");
    // Circles that hardly bend within a window are lines: six samples along an axis, 8.5 along a
    // diagonal.
    for radius in [10.0, 15.0, 20.0, 30.0, 45.0] {
        let line_spacing = spacing(radius);
        assert!(
            line_spacing > spacings[4] - 0.1 && line_spacing < 8.5,
            "{radius}: {line_spacing}"
        );
    }
}

#[test]
fn lines_side_by_side_are_no_detail() {
    let dims = [90, 90];
    for gap in [3.0, 5.0, 9.0f32] {
        let line = |y: f32| {
            (0..90).map(move |i| FeaturePoint {
                position: [i as f32, y],
                normal: [0.0, 1.0],
                strength: 1.0,
            })
        };
        let lines: Vec<_> = (0..5).flat_map(|n| line(20.2 + gap * n as f32)).collect();
        let occupied = &mut OccupiedSamples::new(dims);
        let kept = thin_points(&lines, dims, [1.0; 2], occupied, &CancelToken::never());
        // With the coarse radius, each point excludes a square of eleven samples.
        let max = 5.0 * 90.0 / 6.0 + 5.0;
        assert!((kept.len() as f64) < max, "{gap}: {}", kept.len());
    }
}

/// Checks the ratio of the count of atoms in an image with noise to that without.
fn noisy_atom_ratio<const D: usize>(dims: [usize; D], radius: f64, percent: f64) {
    let image = |noise: f64, seed: u64| {
        let mut random = crate::feature::scenes::Noise::new(seed);
        let clean = ball(dims, radius);
        let samples = clean.as_slice().iter();
        let noisy = samples.map(|&s| s + (noise * random.normal()) as f32);
        Image::new(dims, noisy.collect(), Geometry::default())
    };
    let atoms = |image: Image<D>| {
        let (features, ..) = seed_image(&image);
        let mut samples = image.as_slice().to_vec();
        crate::feature::gaussian::smooth(dims, &mut samples, [1.0; D], &CancelToken::never());
        let step = [1.0; D];
        let field = ScalarField {
            dims,
            step,
            samples,
        };
        let seeded = place_atoms(&features.points, &field, &[], &CancelToken::never());
        seeded.unwrap().0.len() as f64
    };
    let clean = atoms(image(0.0, 1));
    for seed in 1..4 {
        let share = atoms(image(percent, seed)) / clean;
        println!("{D}-D, seed {seed}: {share} of {clean}");
        assert!((0.8..=1.5).contains(&share), "{D}-D, seed {seed}: {share}");
    }
}

#[test]
fn noise_adds_few_atoms() {
    noisy_atom_ratio([192, 180], 60.0, 5.0);
    noisy_atom_ratio([256, 240], 90.0, 5.0);
    noisy_atom_ratio([56, 52, 50], 17.0, 5.0);
}

#[test]
fn dots_hold_as_much_as_the_map() {
    // A parabola bends alike everywhere, and by more than a dot takes away.
    let image = ScalarField::from_fn([40, 30], [1.0; 2], |[x, y]| 0.5 * x * x + 0.1 * y);
    let inner = halftone_dots(&image).into_iter().filter(|i| {
        let (x, y) = (i % 40, i / 40);
        (2..38).contains(&x) && (2..28).contains(&y)
    });
    let share = inner.count() as f64 / (36.0 * 26.0);
    assert!(share > 0.99, "{share}");
    // A tenth of the largest bend gives a sixth as many dots.
    let image = ScalarField::from_fn([60, 60], [1.0; 2], |[x, _]| {
        if x < 10.0 {
            5.0 * x * x
        } else {
            5.0 * 100.0 + 100.0 * (x - 10.0) + 0.5 * (x - 10.0).powi(2)
        }
    });
    let inner = halftone_dots(&image)
        .into_iter()
        .filter(|i| (20..55).contains(&(i % 60)));
    let share = inner.count() as f64 / (35.0 * 60.0);
    assert!((share - 0.1 / 0.6).abs() < 0.02, "{share}");
}

#[test]
fn seeds_of_a_plane_image_fill_the_box_with_triangles() {
    let image = ball([96, 80], 30.0);
    let (_, atoms, _) = seed_image(&image);
    let count = |kind| atoms.kinds.iter().filter(|k| **k == kind).count();
    assert_eq!(count(AtomKind::Corner), 4);
    let mesh = delaunay_plane(&atoms.positions).unwrap();
    let report = check(&mesh, [0.0; 2], [95.0, 79.0], 1e-12);
    assert!(report.passed(), "{:?}", report.problems);
    // No space is left for another uniform point.
    let widest = mesh
        .triangles
        .iter()
        .flat_map(|t| {
            [[0, 1], [1, 2], [2, 0]]
                .map(|[i, j]| distance2(&mesh.nodes[t[i] as usize], &mesh.nodes[t[j] as usize]))
        })
        .fold(0.0, f64::max)
        .sqrt();
    assert!(widest < 2.5 * UNIFORM_SPACING, "{widest}");
}

#[test]
fn in_space_only_the_sides_have_uniform_points() {
    let (_, atoms, _) = seed_image(&ball([48, 44, 40], 14.0));
    assert!(atoms.kinds.iter().all(|k| *k != AtomKind::Interior));
    let count = |kind| atoms.kinds.iter().filter(|k| **k == kind).count();
    assert_eq!(count(AtomKind::Corner), 8);
    // Cells of 47 / 7, 43 / 6 and 39 / 6.
    assert_eq!(count(AtomKind::Edge), 4 * (6 + 5 + 5));
    assert_eq!(count(AtomKind::Side), 2 * (6 * 5 + 6 * 5 + 5 * 5));
}

#[test]
fn small_images_are_refused() {
    let field = ScalarField::from_fn([40, 12], [1.0; 2], |[x, _]| x);
    let error = place_atoms(&[], &field, &[], &CancelToken::never())
        .unwrap_err()
        .to_string();
    assert!(error.contains("12 samples along axis 1"), "{error}");
}
