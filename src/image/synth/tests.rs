use super::*;
use crate::geometry::grid_index::index_at;
use crate::geometry::random::Random;
use crate::geometry::sorted_distinct;
use ndarray::ArrayD;

fn noise_free_options(dims: [usize; 3], count: usize) -> Options {
    Options {
        dims,
        count: Some(count),
        signal_to_noise: f64::INFINITY,
        ..Options::default()
    }
}

fn position(dims: [usize; 3], i: usize) -> [f64; 3] {
    index_at(dims, i).map(|c| c as f64)
}

#[test]
fn sphere_has_the_analytic_distance_and_direction() {
    let dims = [40, 36, 32];
    let truth = make(SyntheticKind::Sphere, &noise_free_options(dims, 1))
        .unwrap()
        .truth;
    let centre = [19.5, 17.5, 15.5];
    let radius = 0.4 * 31.0;
    for i in 0..truth.distance.len() {
        let p = position(dims, i);
        let r: [f64; 3] = std::array::from_fn(|k| p[k] - centre[k]);
        let length = r.iter().map(|c| c * c).sum::<f64>().sqrt();
        let exact = (length - radius).abs();
        assert!((f64::from(truth.distance[i]) - exact.min(10.0)).abs() < 1e-5);
        if exact < 10.0 {
            let sign = if length > radius { -1.0 } else { 1.0 };
            for k in 0..3 {
                assert!((f64::from(truth.direction[i][k]) - sign * r[k] / length).abs() < 1e-5);
            }
        } else {
            assert_eq!(truth.direction[i], [0.0; 3]);
        }
    }
}

/// Compares the distance of curved, crossing, ending faults with a random search for sign changes
/// of their levels within that distance.
#[test]
fn fault_distance_matches_brute_force() {
    let options = Options {
        seed: 5,
        ..noise_free_options([56, 48, 40], 4)
    };
    let faults = crossing::faults(&options, 1.0).unwrap();
    assert!(faults[3].end.is_some());
    let (truth, _) = exact_distance::compute_truth(&faults, options.dims);
    let mut checked = 0;
    for i in (0..truth.distance.len()).step_by(997) {
        let p = position(options.dims, i);
        let d = f64::from(truth.distance[i]);
        if d >= 9.0 {
            continue;
        }
        // No point is nearer than d: levels keep their sign within the ball, and a point at
        // distance d exists.
        let foot: [f64; 3] = std::array::from_fn(|k| p[k] + d * f64::from(truth.direction[i][k]));
        let exists = |f: &surface::ImplicitSurface, q| {
            f.end
                .is_none_or(|end| faults[end.surface].level(q) * end.side >= -1e-4)
        };
        assert!(
            faults
                .iter()
                .any(|f| f.level(foot).abs() < 1e-4 && exists(f, foot)),
            "sample {p:?}: no fault at {foot:?}"
        );
        let mut random = Random::for_purpose(i as u64, 1);
        for _ in 0..200 {
            let v: [f64; 3] = std::array::from_fn(|_| random.range(-1.0, 1.0));
            let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            let q: [f64; 3] = std::array::from_fn(|k| p[k] + 0.999 * d * v[k] / length);
            for f in &faults {
                let crossed = f.level(p) * f.level(q) < 0.0;
                if crossed {
                    // A crossing found by bisection may only lie where the fault has ended.
                    let (mut a, mut b) = (p, q);
                    for _ in 0..50 {
                        let m: [f64; 3] = std::array::from_fn(|k| 0.5 * (a[k] + b[k]));
                        if f.level(a) * f.level(m) <= 0.0 {
                            b = m
                        } else {
                            a = m
                        }
                    }
                    let end = f.end.expect("a fault without end is nearer than the truth");
                    assert!(faults[end.surface].level(a) * end.side < 1e-6);
                }
            }
        }
        checked += 1;
    }
    assert!(checked > 40, "only {checked} samples near faults");
}

#[test]
fn faults_bend_but_not_too_much_and_cross_at_good_angles() {
    for preset in PRESETS {
        let faults = crossing::faults(&preset.options, 1.0).unwrap();
        assert_eq!(faults.len(), preset.options.count());
        let (truth, sides) = exact_distance::compute_truth(&faults, preset.options.dims);
        // Curved, crossing faults form more blocks than faults + 1, and many samples are near a
        // fault.
        let patterns = sorted_distinct(sides.iter().copied());
        assert!(
            patterns.len() > faults.len() + 1,
            "{}: faults do not cross",
            preset.name
        );
        let count = truth.distance.iter().filter(|d| **d < 0.5).count();
        assert!(count > 10_000, "{}: {count} feature points", preset.name);
    }
}

#[test]
fn ridges_stand_on_the_faults_and_noise_has_the_given_ratio() {
    let options = noise_free_options([64, 56, 48], 3);
    let exact = make(SyntheticKind::Faults, &options).unwrap();
    for (&v, &d) in exact.image.as_slice().iter().zip(&exact.truth.distance) {
        let ridge = (-0.5 * (d / 1.5).powi(2)).exp();
        assert!(v >= 0.699 * ridge && v <= 1.001 * ridge);
    }
    let noisy = make(
        SyntheticKind::Faults,
        &Options {
            signal_to_noise: 4.0,
            ..options
        },
    )
    .unwrap();
    let n = exact.image.as_slice().len() as f64;
    let (mut sum, mut squares) = (0.0, 0.0);
    for (a, b) in noisy.image.as_slice().iter().zip(exact.image.as_slice()) {
        let e = f64::from(a - b);
        sum += e;
        squares += e * e;
    }
    assert!((sum / n).abs() < 0.005, "mean {}", sum / n);
    assert!(
        ((squares / n).sqrt() - 0.25).abs() < 0.005,
        "rms {}",
        (squares / n).sqrt()
    );
}

#[test]
fn every_kind_is_made_the_same_on_any_number_of_threads() {
    for (name, kind) in SyntheticKind::ALL {
        assert_eq!(name.parse::<SyntheticKind>().unwrap(), kind);
        let options = Options {
            dims: [40, 33, 27],
            count: Some(2),
            ..Options::default()
        };
        let parallel = make(kind, &options).unwrap();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let single = pool.install(|| make(kind, &options)).unwrap();
        assert!(
            parallel.image.as_slice() == single.image.as_slice(),
            "{name}"
        );
        assert!(parallel.truth == single.truth, "{name}");
        assert!(parallel.image.as_slice().iter().all(|v| v.is_finite()));
        let reseeded = make(kind, &Options { seed: 9, ..options }).unwrap();
        assert!(
            parallel.image.as_slice() != reseeded.image.as_slice(),
            "{name}: the seed is ignored"
        );
    }
}

#[test]
fn amplitude_has_unit_rms_and_breaks_at_the_faults() {
    let options = noise_free_options([80, 64, 48], 2);
    let SyntheticImage { image, truth } = make(SyntheticKind::Amplitude, &options).unwrap();
    let samples = image.as_slice();
    let rms = samples.iter().map(|s| f64::from(s * s)).sum::<f64>() / samples.len() as f64;
    assert!((rms - 1.0).abs() < 1e-3);
    // Differences between neighbouring traces are larger across faults than elsewhere.
    let (mut on, mut off) = ((0.0, 0usize), (0.0, 0usize));
    for i in 0..samples.len() - 80 {
        let e = f64::from((samples[i + 80] - samples[i]).powi(2));
        let d = truth.distance[i];
        if d < 0.5 {
            on = (on.0 + e, on.1 + 1);
        } else if d > 4.0 {
            off = (off.0 + e, off.1 + 1);
        }
    }
    let (on, off) = (on.0 / on.1 as f64, off.0 / off.1 as f64);
    assert!(on > 4.0 * off, "on faults {on}, off faults {off}");
}

#[test]
fn blocks_are_labels_whose_jumps_lie_on_the_truth() {
    let SyntheticImage { image, truth } =
        make(SyntheticKind::Blocks, &noise_free_options([48, 40, 36], 3)).unwrap();
    let labels = image.as_slice();
    let largest = labels.iter().fold(0f32, |a, &b| a.max(b));
    assert!(largest >= 3.0);
    for i in 0..labels.len() - 1 {
        assert_eq!(labels[i], labels[i].round());
        if (i + 1) % 48 != 0 && labels[i] != labels[i + 1] {
            assert!(truth.distance[i] + truth.distance[i + 1] <= 1.0 + 1e-4);
        }
    }
}

#[test]
fn truth_survives_its_array_and_is_found_again_from_distances_alone() {
    let truth = make(SyntheticKind::Shells, &noise_free_options([48, 40, 44], 2))
        .unwrap()
        .truth;
    let (restored, _) = Truth::<3>::from_array(&truth.to_array(), "t").unwrap();
    assert!(restored == truth);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.npy");
    truth.write(&path).unwrap();
    assert!(Truth::read(&path).unwrap().0 == truth);
    let missing = Truth::<3>::read(&folder.path().join("none.npy")).unwrap_err();
    assert!(missing.to_string().contains("none.npy"));
    let distance = truth.to_array().index_axis_move(ndarray::Axis(0), 0);
    let (estimated, note) = Truth::<3>::from_array(&distance, "t").unwrap();
    assert!(note.contains("differences"));
    let mut worst = 0f32;
    for i in (0..truth.distance.len()).filter(|&i| truth.distance[i] < 0.5) {
        let [a, b] = [truth.direction[i], estimated.direction[i]];
        let gap = (0..3)
            .map(|k| (a[k] - b[k]) * truth.distance[i])
            .fold(0.0, |s, e| s + e * e);
        worst = worst.max(gap.sqrt());
    }
    assert!(worst < 0.1, "feature points are {worst} off");
}

#[test]
fn a_mask_gives_the_exact_distance_to_its_voxels() {
    let dims = [13, 11, 9];
    let mut random = Random::for_purpose(7, 7);
    let mask: Vec<f32> = (0..13 * 11 * 9)
        .map(|_| f32::from(u8::from(random.range(0.0, 1.0) < 0.01)))
        .collect();
    let array = ArrayD::from_shape_vec(vec![9, 11, 13], mask.clone()).unwrap();
    let (truth, note) = Truth::<3>::from_array(&array, "m").unwrap();
    assert!(note.contains("mask") && !truth.is_smooth);
    let voxels: Vec<[f64; 3]> = (0..mask.len())
        .filter(|&i| mask[i] == 1.0)
        .map(|i| position(dims, i))
        .collect();
    assert!(voxels.len() > 3);
    for i in 0..mask.len() {
        let p = position(dims, i);
        let gap = |v: &[f64; 3]| (0..3).map(|k| (v[k] - p[k]).powi(2)).sum::<f64>().sqrt();
        let exact = voxels.iter().map(gap).fold(f64::INFINITY, f64::min);
        assert!((f64::from(truth.distance[i]) - exact).abs() < 1e-5);
        let foot: [f64; 3] =
            std::array::from_fn(|k| p[k] + exact * f64::from(truth.direction[i][k]));
        assert!(
            voxels
                .iter()
                .any(|v| (0..3).all(|k| (v[k] - foot[k]).abs() < 1e-4))
        );
    }
}

#[test]
fn bad_requests_are_refused_in_one_line() {
    let refuse = |options: Options| {
        make(SyntheticKind::Faults, &options)
            .unwrap_err()
            .to_string()
    };
    assert!(
        refuse(Options {
            dims: [4, 40, 40],
            ..Options::default()
        })
        .contains("8 samples")
    );
    assert!(
        refuse(Options {
            count: Some(0),
            ..Options::default()
        })
        .contains("1 to 16")
    );
    assert!(
        refuse(Options {
            count: Some(16),
            dims: [32; 3],
            ..Options::default()
        })
        .contains("fit")
    );
    assert!(
        refuse(Options {
            signal_to_noise: 0.0,
            ..Options::default()
        })
        .contains("positive")
    );
    assert!(
        refuse(Options {
            width: f64::NAN,
            ..Options::default()
        })
        .contains("width")
    );
    assert!(
        "nonsense"
            .parse::<SyntheticKind>()
            .unwrap_err()
            .to_string()
            .contains("planes")
    );
    for shape in [vec![8usize], vec![3, 8, 8, 8], vec![1, 8, 8]] {
        assert!(Truth::<3>::from_array(&ArrayD::zeros(shape), "t").is_err());
    }
    assert!(Truth::<3>::from_array(&ArrayD::zeros(vec![8, 8, 8]), "t").is_err());
    assert!(Truth::<3>::from_array(&ArrayD::from_elem(vec![8, 8, 8], f32::NAN), "t").is_err());
}

/// Compares the distance that reports interpolate between samples with the exact distance to the
/// surfaces.
#[test]
fn distance_between_samples_is_that_of_the_faults() {
    let options = noise_free_options([72, 64, 56], 4);
    let faults = crossing::faults(&options, 1.0).unwrap();
    let (truth, _) = exact_distance::compute_truth(&faults, options.dims);
    let reference = crate::report::Reference::from_truth(&truth);
    let mut random = Random::for_purpose(3, 3);
    let end = faults[3].end.unwrap();
    let (mut worst, mut behind, mut count) = (0f64, 0f64, 0);
    for _ in 0..40_000 {
        let p: [f64; 3] = std::array::from_fn(|k| random.range(0.0, (options.dims[k] - 1) as f64));
        let exact = exact_distance::distance(&faults, p);
        if exact < 2.0 {
            let error = (reference.distance(p, &mut None) - exact).abs();
            // Just behind the line where a fault ends, the interpolated distance continues the
            // fault.
            if faults[end.surface].level(p) * end.side < 0.0 && faults[3].level(p).abs() < 1.0 {
                behind = behind.max(error);
            } else {
                worst = worst.max(error);
            }
            count += 1;
        }
    }
    assert!(
        count > 4000 && worst < 0.01,
        "off by {worst} at worst of {count}"
    );
    assert!(behind < 0.5, "off by {behind} behind an end");
}
