//! Tests of lines of surfaces whose crossings and ends are known.

use super::*;
use crate::feature::scenes::{Noise, image_of, plane_image};
use crate::feature::{DetectionOptions, FeatureKind, detect};
use crate::image::Image;
use crate::image::synth::{self, Options, SyntheticKind};

const DIMS: [usize; 3] = [72, 64, 56];
const MIDDLE: [f64; 3] = [36.0, 32.0, 28.0];
/// Normal of a plane that meets another one in a line through the middle.
const FIRST_NORMAL: [f64; 3] = [0.9759, 0.0976, 0.1952];

fn offset_from_middle(p: [f64; 3]) -> [f64; 3] {
    sub(p, MIDDLE)
}

/// Returns the normal of a plane through the middle, turned from the first plane by an angle in
/// degrees.
fn turned_normal(degrees: f64) -> [f64; 3] {
    let perpendicular = unit(cross(FIRST_NORMAL, [0.2, 0.1, 1.0]));
    let (sin, cos) = degrees.to_radians().sin_cos();
    add_scaled(FIRST_NORMAL.map(|c| cos * c), sin, perpendicular)
}

fn ridge(distance: f64) -> f64 {
    (-0.5 * (distance / 1.5).powi(2)).exp()
}

fn noisy_image(seed: u64, height: impl Fn([f64; 3]) -> f64) -> Image<3> {
    let mut noise = Noise::new(seed);
    image_of(DIMS, |p| {
        height(offset_from_middle(p)) + 0.15 * noise.normal()
    })
}

fn lines_of<const D: usize>(image: &Image<D>) -> Vec<FeatureLine<D>> {
    let features = detect(
        image,
        &DetectionOptions::with_kind(FeatureKind::Ridges, 4.0),
    )
    .unwrap();
    assert_eq!(features.surface.len(), features.points.len());
    assert!(features.surface.iter().all(|&surface| surface > 0));
    lines(&features).unwrap()
}

/// Returns the share of a straight line through the middle of the box that has a point of `lines`
/// within one sample, and the largest distance of these points from the straight line.
fn measure_fit(lines: &[FeatureLine<3>], direction: [f64; 3]) -> (f64, f64) {
    let places = || lines.iter().flat_map(|line| &line.points);
    let (mut total, mut hits) = (0, 0);
    for i in -500..500 {
        let p = add_scaled(MIDDLE, 0.1 * f64::from(i), direction);
        if (0..3).all(|k| p[k] >= 0.0 && p[k] <= (DIMS[k] - 1) as f64) {
            total += 1;
            hits += usize::from(places().any(|&q| norm(sub(q, p)) <= 1.0));
        }
    }
    let distance = |&q: &[f64; 3]| norm(cross(offset_from_middle(q), direction));
    (
        f64::from(hits as u32) / f64::from(total),
        places().map(distance).fold(0.0, f64::max),
    )
}

#[test]
fn planes_cross_in_one_line_at_their_angle() {
    for (angle, seed) in [(30.0, 1), (30.0, 2), (60.0, 3), (60.0, 4)] {
        let second = turned_normal(angle);
        let image = noisy_image(seed, |p| {
            ridge(dot(p, FIRST_NORMAL)).max(ridge(dot(p, second)))
        });
        let lines = lines_of(&image);
        let crossings: Vec<_> = lines.iter().map(|line| line.kind).collect();
        assert_eq!(crossings, [LineKind::Crossing], "{angle} {seed}");
        let (share, max_distance) = measure_fit(&lines, unit(cross(FIRST_NORMAL, second)));
        assert!(
            share >= 0.9 && max_distance <= 1.0,
            "{angle} {seed}: {share} {max_distance}"
        );
        let reported = lines[0].angle;
        assert!(
            (reported - angle).abs() <= 3.0,
            "{angle} {seed}: {reported}"
        );
    }
}

#[test]
fn a_surface_that_ends_at_another_branches_off_it() {
    for seed in [1, 2] {
        let second = turned_normal(80.0);
        let image = noisy_image(seed, |p| {
            let branch = if dot(p, FIRST_NORMAL) > 0.0 {
                ridge(dot(p, second))
            } else {
                0.0
            };
            ridge(dot(p, FIRST_NORMAL)).max(branch)
        });
        let lines = lines_of(&image);
        let kinds: Vec<_> = lines.iter().map(|line| line.kind).collect();
        assert_eq!(kinds, [LineKind::Branch], "{seed}");
        assert_eq!(lines[0].surfaces, [1, 2]);
        let (share, max_distance) = measure_fit(&lines, unit(cross(FIRST_NORMAL, second)));
        assert!(
            share >= 0.9 && max_distance <= 1.0,
            "{seed}: {share} {max_distance}"
        );
        assert!((lines[0].angle - 80.0).abs() <= 3.0, "{}", lines[0].angle);
    }
}

#[test]
fn a_surface_that_ends_inside_has_a_tip_there() {
    let end = unit([0.0, 1.0, 0.3]);
    for seed in [1, 2] {
        let inside = |p: [f64; 3]| dot(p, end) < 8.0;
        let image = noisy_image(seed, |p| {
            if inside(p) {
                ridge(dot(p, FIRST_NORMAL))
            } else {
                0.0
            }
        });
        let lines = lines_of(&image);
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert_eq!((lines[0].kind, lines[0].surfaces), (LineKind::Tip, [0, 1]));
        let distance = |&q: &[f64; 3]| (dot(offset_from_middle(q), end) - 8.0).abs();
        let worst = lines[0].points.iter().map(distance).fold(0.0, f64::max);
        assert!(worst <= 2.0, "{seed}: {worst}");
        // From side to side the rim is about 60 samples long.
        assert!(lines[0].length > 40.0, "{}", lines[0].length);
    }
}

#[test]
fn lines_in_the_plane_are_points() {
    let mut noise = Noise::new(5);
    // A straight curve crossed by another at 50 degrees; a third one starts at the first and ends
    // 25 samples away.
    let second = [50f64.to_radians().cos(), 50f64.to_radians().sin()];
    let image = plane_image([80, 72], |p| {
        let p = [p[0] - 36.0, p[1] - 32.0];
        let third = if (0.0..25.0).contains(&p[0]) {
            ridge(p[1] - 25.0)
        } else {
            0.0
        };
        ridge(p[0]).max(ridge(dot(p, second))).max(third) + 0.1 * noise.normal()
    });
    let lines = lines_of(&image);
    let check = |kind: LineKind, at: [f64; 2], angle: f64| {
        let matching: Vec<_> = lines.iter().filter(|line| line.kind == kind).collect();
        assert_eq!(matching.len(), 1, "{lines:?}");
        let line = matching[0];
        assert_eq!((line.points.len(), line.length), (1, 0.0));
        let distance = norm(sub(line.points[0], at));
        let max_distance = if kind == LineKind::Tip { 2.0 } else { 1.0 };
        assert!(
            distance <= max_distance && (line.angle - angle).abs() <= 3.0,
            "{line:?}"
        );
    };
    check(LineKind::Crossing, [36.0, 32.0], 50.0);
    check(LineKind::Branch, [36.0, 57.0], 90.0);
    check(LineKind::Tip, [61.0, 57.0], 0.0);
}

#[test]
fn places_and_angles_are_in_lattice_space() {
    let image = noisy_image(1, |p| {
        ridge(dot(p, FIRST_NORMAL)).max(ridge(dot(p, turned_normal(60.0))))
    });
    let step = [2.0, 1.0, 0.5];
    let options = DetectionOptions {
        step,
        ..DetectionOptions::with_kind(FeatureKind::Ridges, 4.0)
    };
    let lines = lines(&detect(&image, &options).unwrap()).unwrap();
    let direction = cross(FIRST_NORMAL, turned_normal(60.0));
    for &place in lines.iter().flat_map(|line| &line.points) {
        let in_samples = std::array::from_fn(|k| place[k] / step[k]);
        assert!(norm(cross(offset_from_middle(in_samples), unit(direction))) <= 1.0);
    }
    let [a, b] = [FIRST_NORMAL, turned_normal(60.0)].map(|n| unit([n[0] / 2.0, n[1], n[2] / 0.5]));
    let angle = dot(a, b).abs().acos().to_degrees();
    assert!(
        (lines[0].angle - angle).abs() <= 3.0,
        "{} {angle}",
        lines[0].angle
    );
}

#[test]
fn results_do_not_depend_on_threads_and_cancelling_stops() {
    let options = Options {
        dims: [64; 3],
        seed: 5,
        signal_to_noise: 4.0,
        ..Options::default()
    };
    let image = synth::make(SyntheticKind::Network, &options).unwrap().image;
    let features = detect(
        &image,
        &DetectionOptions::with_kind(FeatureKind::Ridges, 2.7),
    )
    .unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| lines(&features).unwrap())
    };
    assert_eq!(run(1), run(3));
    let stopped = CancelToken::run(&mut || false, |cancel| lines_with_cancel(&features, cancel));
    let kind = stopped.unwrap_err().kind();
    assert_eq!(kind, crate::ErrorKind::Interrupted);
}

#[test]
#[ignore = "slow: make test-all"]
fn lines_of_networks_are_few_and_lie_where_two_faults_are_near() {
    for seed in [1, 5, 9] {
        let options = Options {
            dims: [80; 3],
            seed,
            signal_to_noise: 4.0,
            ..Options::default()
        };
        let synthetic = synth::make(SyntheticKind::Network, &options).unwrap();
        let features = detect(
            &synthetic.image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 2.7),
        )
        .unwrap();
        let lines = lines(&features).unwrap();
        assert!(lines.iter().all(|line| line.length >= MIN_LENGTH));
        let (tips, meetings): (Vec<_>, Vec<_>) =
            lines.iter().partition(|line| line.kind == LineKind::Tip);
        let next = synthetic.truth.next_feature.as_ref().unwrap();
        let (mut hits, mut total) = (0, 0);
        for place in meetings.iter().flat_map(|line| &line.points) {
            // The distance to the second nearest fault is known at samples on faults.
            let is_near_two_faults =
                |i: usize| synthetic.truth.distance[i] < 0.5 && next[i][0] < 2.5;
            let around = |n: usize| {
                let at =
                    |k: usize, offset: usize| (place[k].round() as usize + offset).clamp(1, 80) - 1;
                (at(2, n / 9) * 80 + at(1, n / 3 % 3)) * 80 + at(0, n % 3)
            };
            total += 1;
            hits += u32::from((0..27).map(around).any(is_near_two_faults));
        }
        let share = f64::from(hits) / f64::from(total);
        let counts = (meetings.len(), tips.len());
        assert!(counts.0 <= 10 && counts.1 <= 20, "{seed}: {counts:?}");
        assert!(share >= 0.95, "{seed}: {hits} of {total}");
    }
}
