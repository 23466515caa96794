//! Lines of sheets whose crossings and ends are known.

use super::*;
use crate::feature::scenes::{Noise, image_of, plane_image};
use crate::feature::{DetectionOptions, FeatureKind, detect};
use crate::image::Image;
use crate::image::synth::{self, Options, SyntheticKind};

const DIMS: [usize; 3] = [72, 64, 56];
const MIDDLE: [f64; 3] = [36.0, 32.0, 28.0];
/// Off one plane, and off another that meets it in a line through the middle.
const FIRST_NORMAL: [f64; 3] = [0.9759, 0.0976, 0.1952];

fn offset_from_middle(p: [f64; 3]) -> [f64; 3] {
    sub(p, MIDDLE)
}

/// The normal of a plane through the middle, turned from the first by an angle in degrees.
fn turned_normal(degrees: f64) -> [f64; 3] {
    let aside = unit(cross(FIRST_NORMAL, [0.2, 0.1, 1.0]));
    let (sin, cos) = degrees.to_radians().sin_cos();
    add_scaled(FIRST_NORMAL.map(|c| cos * c), sin, aside)
}

fn ridge(off: f64) -> f64 {
    (-0.5 * (off / 1.5).powi(2)).exp()
}

fn noisy_image(seed: u64, height: impl Fn([f64; 3]) -> f64) -> Image<3> {
    let mut noise = Noise::new(seed);
    image_of(DIMS, |p| {
        height(offset_from_middle(p)) + 0.15 * noise.normal()
    })
}

fn lines_of<const D: usize>(image: &Image<D>) -> Vec<FeatureLine<D>> {
    let found = detect(
        image,
        &DetectionOptions::with_kind(FeatureKind::Ridges, 4.0),
    )
    .unwrap();
    assert_eq!(found.surface.len(), found.points.len());
    assert!(found.surface.iter().all(|&sheet| sheet > 0));
    lines(&found).unwrap()
}

/// The share of the line through the middle along a direction, as far as it is in the box, that has a
/// place within one sample; and how far off it places of these lines are at most.
fn measure_fit(lines: &[FeatureLine<3>], along: [f64; 3]) -> (f64, f64) {
    let places = || lines.iter().flat_map(|line| &line.points);
    let (mut all, mut near) = (0, 0);
    for i in -500..500 {
        let p = add_scaled(MIDDLE, 0.1 * f64::from(i), along);
        if (0..3).all(|k| p[k] >= 0.0 && p[k] <= (DIMS[k] - 1) as f64) {
            all += 1;
            near += usize::from(places().any(|&q| norm(sub(q, p)) <= 1.0));
        }
    }
    let off = |&q: &[f64; 3]| norm(cross(offset_from_middle(q), along));
    (
        f64::from(near as u32) / f64::from(all),
        places().map(off).fold(0.0, f64::max),
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
        let (share, off) = measure_fit(&lines, unit(cross(FIRST_NORMAL, second)));
        assert!(share >= 0.9 && off <= 1.0, "{angle} {seed}: {share} {off}");
        let told = lines[0].angle;
        assert!((told - angle).abs() <= 3.0, "{angle} {seed}: {told}");
    }
}

#[test]
fn a_sheet_that_ends_at_another_branches_off_it() {
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
        let (share, off) = measure_fit(&lines, unit(cross(FIRST_NORMAL, second)));
        assert!(share >= 0.9 && off <= 1.0, "{seed}: {share} {off}");
        assert!((lines[0].angle - 80.0).abs() <= 3.0, "{}", lines[0].angle);
    }
}

#[test]
fn a_sheet_that_ends_inside_has_a_tip_there() {
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
        let off = |&q: &[f64; 3]| (dot(offset_from_middle(q), end) - 8.0).abs();
        let worst = lines[0].points.iter().map(off).fold(0.0, f64::max);
        assert!(worst <= 2.0, "{seed}: {worst}");
        // From side to side the rim is some 60 samples long.
        assert!(lines[0].length > 40.0, "{}", lines[0].length);
    }
}

#[test]
fn in_the_plane_they_are_points() {
    let mut noise = Noise::new(5);
    // A curve across, crossed by one at 50 degrees; a third ends at the first and, 25 samples on, inside.
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
    let near = |kind: LineKind, at: [f64; 2], angle: f64| {
        let of_kind: Vec<_> = lines.iter().filter(|line| line.kind == kind).collect();
        assert_eq!(of_kind.len(), 1, "{lines:?}");
        let line = of_kind[0];
        assert_eq!((line.points.len(), line.length), (1, 0.0));
        let off = norm(sub(line.points[0], at));
        let most = if kind == LineKind::Tip { 2.0 } else { 1.0 };
        assert!(off <= most && (line.angle - angle).abs() <= 3.0, "{line:?}");
    };
    near(LineKind::Crossing, [36.0, 32.0], 50.0);
    near(LineKind::Branch, [36.0, 57.0], 90.0);
    near(LineKind::Tip, [61.0, 57.0], 0.0);
}

#[test]
fn places_and_angles_are_in_lattice_space() {
    let image = noisy_image(1, |p| {
        ridge(dot(p, FIRST_NORMAL)).max(ridge(dot(p, turned_normal(60.0))))
    });
    let step = [2.0, 1.0, 0.5];
    let asked = DetectionOptions {
        step,
        ..DetectionOptions::with_kind(FeatureKind::Ridges, 4.0)
    };
    let lines = lines(&detect(&image, &asked).unwrap()).unwrap();
    let along = cross(FIRST_NORMAL, turned_normal(60.0));
    for &place in lines.iter().flat_map(|line| &line.points) {
        let in_samples = std::array::from_fn(|k| place[k] / step[k]);
        assert!(norm(cross(offset_from_middle(in_samples), unit(along))) <= 1.0);
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
fn threads_change_nothing_and_patience_is_asked() {
    let options = Options {
        dims: [64; 3],
        seed: 5,
        signal_to_noise: 4.0,
        ..Options::default()
    };
    let image = synth::make(SyntheticKind::Network, &options).unwrap().image;
    let found = detect(
        &image,
        &DetectionOptions::with_kind(FeatureKind::Ridges, 2.7),
    )
    .unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| lines(&found).unwrap())
    };
    assert_eq!(run(1), run(3));
    let stopped = CancelToken::run(&mut || false, |patience| {
        lines_with_cancel(&found, patience)
    });
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
        let made = synth::make(SyntheticKind::Network, &options).unwrap();
        let found = detect(
            &made.image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 2.7),
        )
        .unwrap();
        let lines = lines(&found).unwrap();
        assert!(lines.iter().all(|line| line.length >= MIN_LENGTH));
        let (tips, meetings): (Vec<_>, Vec<_>) =
            lines.iter().partition(|line| line.kind == LineKind::Tip);
        let next = made.truth.next_feature.as_ref().unwrap();
        let (mut near, mut all) = (0, 0);
        for place in meetings.iter().flat_map(|line| &line.points) {
            // How far the next fault is, is known of samples on faults.
            let known = |i: usize| made.truth.distance[i] < 0.5 && next[i][0] < 2.5;
            let around = |n: usize| {
                let at = |k: usize, by: usize| (place[k].round() as usize + by).clamp(1, 80) - 1;
                (at(2, n / 9) * 80 + at(1, n / 3 % 3)) * 80 + at(0, n % 3)
            };
            all += 1;
            near += u32::from((0..27).map(around).any(known));
        }
        let share = f64::from(near) / f64::from(all);
        let counts = (meetings.len(), tips.len());
        assert!(counts.0 <= 10 && counts.1 <= 20, "{seed}: {counts:?}");
        assert!(share >= 0.95, "{seed}: {near} of {all}");
    }
}
