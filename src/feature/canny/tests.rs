use super::*;
use crate::feature::scenes::Noise;
use crate::feature::{Kind, Options, detect};
use crate::image::{Geometry, Image};

/// An image of a ball (a disc in 2-D), 100 inside and 0 outside, with an edge one sample wide and
/// noise.
fn ball<const D: usize>(dims: [usize; D], centre: [f64; D], radius: f64, noise: f64) -> Image<D> {
    let mut random = Noise::new(5);
    let empty = Volume { dims, samples: &[] };
    let samples = (0..dims.iter().product()).map(|i| {
        let off = off_ball(empty.coordinates(i).map(|c| c as f64), centre, radius);
        (100.0 * (0.5 - off).clamp(0.0, 1.0) + noise * random.normal()) as f32
    });
    Image::new(dims, samples.collect(), Geometry::default())
}

fn off_ball<const D: usize>(p: [f64; D], centre: [f64; D], radius: f64) -> f64 {
    let squares: f64 = (0..D).map(|k| (p[k] - centre[k]).powi(2)).sum();
    squares.sqrt() - radius
}

/// Finds the edge of a ball: every point within half a sample of it, its normal along the radius,
/// the rms below `rms`, and no way round without meeting one.
fn edge_of_a_ball<const D: usize>(
    dims: [usize; D],
    centre: [f64; D],
    radius: f64,
    noise: f64,
    rms: f64,
) {
    let image = ball(dims, centre, radius, noise);
    let options = Options {
        kind: Kind::Canny,
        d_min: 4.0,
        ..Options::default()
    };
    let found = detect(&image, &options).unwrap();
    let (mut worst, mut squares) = (0.0f64, 0.0);
    for point in &found.points {
        let p = point.position.map(f64::from);
        let off = off_ball(p, centre, radius);
        worst = worst.max(off.abs());
        squares += off * off;
        let along: f64 = (0..D)
            .map(|k| (p[k] - centre[k]) / radius * f64::from(point.normal[k]))
            .sum();
        assert!(along.abs() > 0.95, "{along}");
    }
    let got = (squares / found.points.len() as f64).sqrt();
    assert!(
        worst < 0.5 && got < rms,
        "worst {worst}, rms {got}, {:?}",
        found.notes
    );
    // Every sample within half a sample of the edge has a point at most a sample (and a bit) away.
    let empty = Volume { dims, samples: &[] };
    for i in 0..dims.iter().product() {
        let p = empty.coordinates(i).map(|c| c as f64);
        if off_ball(p, centre, radius).abs() < 0.5 {
            let near = found.points.iter().any(|point| {
                let squares = (0..D).map(|k| (f64::from(point.position[k]) - p[k]).powi(2));
                squares.sum::<f64>() < 1.3 * 1.3
            });
            assert!(near, "no point near {p:?}");
        }
    }
}

#[test]
fn a_circle_and_a_sphere_are_found_within_half_a_sample() {
    edge_of_a_ball([90, 80], [44.3, 40.7], 27.4, 0.0, 0.06);
    edge_of_a_ball([90, 80], [44.3, 40.7], 27.4, 5.0, 0.15);
    edge_of_a_ball([46, 44, 42], [22.3, 21.7, 20.5], 14.6, 0.0, 0.11);
    edge_of_a_ball([46, 44, 42], [22.3, 21.7, 20.5], 14.6, 5.0, 0.2);
}

#[test]
fn noise_alone_reaches_the_thresholds_as_often_as_said() {
    fn shares<const D: usize>(dims: [usize; D]) -> [f64; 2] {
        let mut random = Noise::new(11);
        let mut samples: Vec<f32> = (0..dims.iter().product())
            .map(|_| random.normal() as f32)
            .collect();
        crate::feature::gaussian::smooth(dims, &mut samples, [1.0; D]);
        let steepness = steepness(Volume {
            dims,
            samples: &samples,
        });
        above_noise::<D>(&steepness).map(|t| {
            let above = steepness.iter().filter(|s| **s >= t).count();
            above as f64 / steepness.len() as f64
        })
    }
    for [low, high] in [shares([900, 800]), shares([80, 90, 100])] {
        assert!((low / FALSE_ALARMS[0] - 1.0).abs() < 0.25, "{low}");
        assert!(high < 10.0 * FALSE_ALARMS[1], "{high}");
    }
}

#[test]
fn steepness_is_the_length_of_the_gradient() {
    let mut random = Noise::new(2);
    let dims = [7, 5, 4];
    let samples: Vec<f32> = (0..140).map(|_| random.normal() as f32).collect();
    let volume = Volume {
        dims,
        samples: &samples,
    };
    for (i, steep) in steepness(volume).iter().enumerate() {
        let gradient = volume.gradient(volume.coordinates(i));
        let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
        assert!((steep - length).abs() < 1e-5);
    }
    let row = Volume {
        dims: [1, 3],
        samples: &samples[..3],
    };
    assert_eq!(steepness(row)[1], 0.5 * (samples[2] - samples[0]).abs());
}
