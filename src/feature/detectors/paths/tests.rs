use super::*;
use crate::feature::scenes::Noise;
use crate::feature::{DetectionOptions, FeatureKind, detect};
use crate::image::Image;

const DIMS: [usize; 2] = [90, 80];
const CENTRE: [f64; 2] = [42.4, 38.7];
const RADIUS: f64 = 21.3;

/// Returns an image of a bright disc; with `gap`, its rim is eight times as wide over 40 degrees.
fn disc(noise: f64, gap: bool) -> Image<2> {
    let mut random = Noise::new(9);
    let value = |i: usize| {
        let [u, v] = [
            (i % DIMS[0]) as f64 - CENTRE[0],
            (i / DIMS[0]) as f64 - CENTRE[1],
        ];
        let is_wide = gap && v.atan2(u).abs() < 0.35;
        let width = if is_wide { 8.0 } else { 1.0 };
        let inside = (0.5 - (u.hypot(v) - RADIUS) / width).clamp(0.0, 1.0);
        (40.0 + 150.0 * inside + noise * random.normal()) as f32
    };
    let samples = (0..DIMS[0] * DIMS[1]).map(value).collect();
    Image::new(DIMS, samples, Geometry::default())
}

fn path_options(object: &[[f64; 2]]) -> DetectionOptions<2> {
    DetectionOptions {
        seeds: PathSeeds {
            object: object.to_vec(),
            ..PathSeeds::default()
        },
        ..DetectionOptions::with_kind(FeatureKind::Paths, 5.0)
    }
}

#[test]
fn the_boundary_of_a_disc_is_closed_and_where_it_is() {
    for (noise, gap) in [(0.0, false), (15.0, false), (10.0, true)] {
        let image = disc(noise, gap);
        let features = detect(&image, &path_options(&[[45.0, 35.0], [38.0, 45.0]])).unwrap();
        let (mut squares, mut worst) = (0.0, 0.0f64);
        let mut sectors = [false; 36];
        for point in &features.points {
            let [u, v] = [0, 1].map(|k| f64::from(point.position[k]) - CENTRE[k]);
            let distance = u.hypot(v) - RADIUS;
            worst = worst.max(distance.abs());
            squares += distance * distance;
            sectors[((v.atan2(u) / std::f64::consts::TAU + 0.5) * 36.0) as usize % 36] = true;
        }
        let rms = (squares / features.points.len() as f64).sqrt();
        assert!(sectors.iter().all(|s| *s), "{:?}", features.notes);
        assert!(
            rms < if gap { 1.2 } else { 0.5 } && worst < if gap { 4.0 } else { 1.5 },
            "{noise} {gap}: {rms} {worst}"
        );
        // Along the boundary the potential has no gap.
        for point in &features.points {
            let at = point.position.map(f64::from);
            assert!(features.potential.value(at) < -0.9, "{at:?}");
        }
        // Many more paths pass samples on the rim than others.
        let confidence = features.confidence.unwrap().samples;
        assert!(confidence.iter().all(|c| (0.0..=1.0).contains(c)));
        let mean = |is_on_rim: bool| {
            let (mut sum, mut count) = (0.0, 0);
            for (i, c) in confidence.iter().enumerate() {
                let [x, y] = [(i % DIMS[0]) as f64, (i / DIMS[0]) as f64];
                let is_near = ((x - CENTRE[0]).hypot(y - CENTRE[1]) - RADIUS).abs() < 1.0;
                if is_near == is_on_rim {
                    sum += f64::from(*c);
                    count += 1;
                }
            }
            sum / f64::from(count)
        };
        assert!(
            mean(true) > 10.0 * mean(false),
            "{} {}",
            mean(true),
            mean(false)
        );
    }
}

#[test]
fn shortest_paths_are_the_shortest() {
    // Random costs on a small grid, compared with the algorithm of Bellman and Ford.
    let dims = [9, 7];
    let costs: Vec<f32> = (0..63).map(|i| 0.05 + uniform(3, i) as f32).collect();
    let grid = Volume {
        dims,
        samples: &costs,
    };
    let (source, sinks) = (40, [0, 8, 31, 62, 62]);
    let mut min_cost = vec![f32::INFINITY; 63];
    min_cost[source] = 0.0;
    for _ in 0..63 {
        for i in 0..63 {
            for_each_neighbour(grid, i, |j| {
                min_cost[j] = min_cost[j].min(min_cost[i] + 0.5 * (costs[i] + costs[j]));
            });
        }
    }
    let previous = shortest_path_tree(grid, &costs, source, &sinks, &CancelToken::never());
    for sink in sinks {
        let (mut at, mut cost) = (sink, 0.0);
        while at != source {
            let next = previous[at] as usize;
            cost += 0.5 * (costs[at] + costs[next]);
            at = next;
        }
        assert!((cost - min_cost[sink]).abs() < 1e-5);
    }
    // Every path passes its ends.
    let counts = path_counts(grid, &costs, &[source], &sinks, &CancelToken::never());
    assert_eq!((counts[source], counts[62], counts[0]), (5, 2, 1));
}

#[test]
fn a_closed_path_goes_round_and_drops_detours() {
    // A ring of samples with a branch to its brightest sample, and a bright block beside it.
    let dims = [12, 10];
    let mut counts = vec![0u32; 120];
    let mut set = |x: usize, y: usize, c: u32| counts[y * 12 + x] = c;
    for i in 2..=7 {
        for (x, y) in [(i, 2), (i, 7), (2, i), (7, i)] {
            set(x, y, 5);
        }
    }
    for x in 8..=10 {
        set(x, 5, 9);
        set(x, 6, 9);
    }
    set(10, 5, 20);
    let grid = Volume { dims, samples: &[] };
    let uniform_weights = [1.0; 120];
    let path = closed_path(grid, &uniform_weights, &counts, 4 * 12 + 4).unwrap();
    assert_eq!(path.len(), 20);
    assert!(path.iter().all(|i| counts[*i] == 5));
    let values = inside_mask(grid, &path);
    assert_eq!(values.iter().filter(|v| **v == 1.0).count(), 16);
    assert_eq!(values.iter().filter(|v| **v == 0.5).count(), 20);
    // An open ring has no closed path.
    counts[2 * 12 + 4] = 0;
    assert_eq!(
        closed_path(grid, &uniform_weights, &counts, 4 * 12 + 4),
        None
    );
}

#[test]
fn points_are_drawn_near_their_start() {
    let distance: Vec<f32> = (0..1000).map(|i| i as f32).collect();
    let drawn = draw_samples(&distance, 500.0, 4000, 1);
    assert_eq!(drawn.len(), 4000);
    // The probability falls linearly to 0 at 500: the mean is a third of that.
    let mean = drawn.iter().sum::<usize>() as f64 / 4000.0;
    assert!((mean - 500.0 / 3.0).abs() < 6.0, "{mean}");
    assert!(drawn.iter().all(|i| *i < 500));
    assert!(draw_samples(&distance, 0.0, 3, 1).is_empty());
}

#[test]
fn missing_points_are_reported() {
    let image = disc(0.0, false);
    let error_for = |object: &[[f64; 2]]| {
        detect(&image, &path_options(object))
            .unwrap_err()
            .to_string()
    };
    assert!(error_for(&[]).contains("give one, such as --object"));
    assert!(error_for(&[[45.0, 90.0]]).contains("outside the image"));
    assert!(error_for(&[[45.0, 0.0]]).contains("cannot tell"));
    let space = Image::new(
        [4, 4, 4],
        (0..64).map(|i| i as f32).collect(),
        Geometry::default(),
    );
    assert!(
        detect(
            &space,
            &DetectionOptions::with_kind(FeatureKind::Paths, 2.0)
        )
        .unwrap_err()
        .to_string()
        .contains("2-D")
    );
}
