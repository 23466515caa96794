use super::*;
use crate::feature::scenes::Noise;
use crate::feature::volume::Volume;

/// Returns layers of period 12 across x, displaced by 5 samples at y = 24.
fn thrown_layers([nx, ny, nz]: [usize; 3]) -> Vec<f32> {
    let sample = |index: usize| {
        let (x, y, z) = (index % nx, index / nx % ny, index / (nx * ny));
        let throw = if y >= 24 { 5.0 } else { 0.0 };
        let phase = std::f64::consts::TAU * (x as f64 + throw + 0.1 * z as f64) / 12.0;
        (phase.sin() + 0.5 * (0.37 * phase).cos()) as f32
    };
    (0..nx * ny * nz).map(sample).collect()
}

fn probabilities<const D: usize>(dims: [usize; D], vertical: usize, image: &[f32]) -> Vec<f32> {
    fault_network::<D>(vertical, false).probabilities(grid_dims(dims), image, &CancelToken::never())
}

#[test]
fn probabilities_are_those_of_the_training_framework() {
    let dims = [40, 48, 32];
    let p = probabilities(dims, 0, &thrown_layers(dims));
    // The output of the trained network in PyTorch for the same image.
    for ([x, y, z], expected) in VOLUME_REFERENCE {
        let found = p[x + dims[0] * (y + dims[1] * z)];
        assert!(
            (found - expected).abs() < 2e-3,
            "{x} {y} {z}: {found} {expected}"
        );
    }
    let dims = [40, 48];
    let p = probabilities(dims, 0, &thrown_layers([40, 48, 1]));
    for ([x, y], expected) in SECTION_REFERENCE {
        let found = p[x + dims[0] * y];
        assert!(
            (found - expected).abs() < 2e-3,
            "{x} {y}: {found} {expected}"
        );
    }
}

const VOLUME_REFERENCE: [([usize; 3], f32); 6] = [
    ([20, 24, 16], 0.73205),
    ([20, 20, 16], 0.00108),
    ([5, 24, 3], 0.67457),
    ([33, 23, 29], 0.57536),
    ([0, 23, 0], 0.17432),
    ([20, 40, 10], 0.00003),
];
const SECTION_REFERENCE: [([usize; 2], f32); 4] = [
    ([20, 24], 0.86112),
    ([20, 20], 0.00561),
    ([5, 23], 0.74419),
    ([39, 25], 0.21049),
];

#[test]
fn every_axis_can_be_the_vertical_one() {
    let dims = [40, 48, 32];
    let image = thrown_layers(dims);
    let p = probabilities(dims, 0, &image);
    // The same image with x as the slowest axis.
    let turned_dims = [48, 32, 40];
    let turned = |values: &[f32]| -> Vec<f32> {
        let sample = |index: usize| {
            let (y, z, x) = (index % 48, index / 48 % 32, index / (48 * 32));
            values[x + 40 * (y + 48 * z)]
        };
        (0..values.len()).map(sample).collect()
    };
    let q = probabilities(turned_dims, 2, &turned(&image));
    for (q, p) in q.iter().zip(turned(&p)) {
        assert!((q - p).abs() < 1e-4, "{q} {p}");
    }
}

#[test]
fn mirrored_sections_with_opposite_sign_have_mirrored_probabilities() {
    // A multiple of the coarsest level's samples: its samples are then the same pairs from both ends.
    let dims = [40, 48];
    let image = thrown_layers([40, 48, 1]);
    let mirrored_image: Vec<f32> = (0..image.len())
        .map(|i| -image[i % 40 + 40 * (47 - i / 40)])
        .collect();
    let cancel = CancelToken::never();
    let networks = section::Networks::new::<2>(0);
    let p = networks.probabilities(Volume::new(dims, &image), 1.0, &cancel);
    let q = networks.probabilities(Volume::new(dims, &mirrored_image), 1.0, &cancel);
    for (i, p) in p.iter().enumerate() {
        let q = q[i % 40 + 40 * (47 - i / 40)];
        assert!((p - q).abs() < 1e-4, "{i}: {p} {q}");
    }
    let on_fault = p[20 + 40 * 24];
    assert!(on_fault > 0.6, "{on_fault}");
    // The same section with the other axis as the slowest one.
    let turned = |values: &[f32]| -> Vec<f32> {
        (0..values.len())
            .map(|i| values[i / 48 + 40 * (i % 48)])
            .collect()
    };
    let turned_image = turned(&image);
    let networks = section::Networks::new::<2>(1);
    let q = networks.probabilities(Volume::new([48, 40], &turned_image), 1.0, &cancel);
    for (p, q) in turned(&p).iter().zip(&q) {
        assert!((p - q).abs() < 1e-4, "{p} {q}");
    }
}

#[test]
fn a_window_gives_the_probabilities_of_the_whole() {
    let dims = [19, 21, 200];
    let mut noise = Noise::new(5);
    let image: Vec<f32> = (0..dims.iter().product())
        .map(|_| noise.normal() as f32)
        .collect();
    let whole = probabilities(dims, 0, &image);
    let layer = dims[0] * dims[1];
    // Windows begin at a multiple of the last level's samples.
    for (first, end) in [(0, 120), (48, 200), (80, 200)] {
        let window = probabilities([19, 21, end - first], 0, &image[first * layer..end * layer]);
        let inner = if first == 0 { 0 } else { first + NETWORK_REACH };
        let inner_end = if end == 200 { 200 } else { end - NETWORK_REACH };
        assert_eq!(
            window[(inner - first) * layer..(inner_end - first) * layer],
            whole[inner * layer..inner_end * layer]
        );
    }
}

#[test]
fn convolution_adds_all_taps_and_channels_of_its_sources() {
    let (outputs, inputs) = (3, 5);
    let mut noise = Noise::new(7);
    let weights: Vec<f32> = (0..27 * inputs * outputs)
        .map(|_| noise.normal() as f32)
        .collect();
    let taps: Vec<usize> = (0..27).collect();
    let source = |range| SourceWeights::new(&weights, inputs, range, outputs, &taps);
    let convolution = Convolution {
        sources: vec![source(0..2), source(2..5)],
        biases: vec![0.1, -0.2, 0.3],
    };
    let samples = 6;
    let line = convolution::line_len(samples);
    let mut random_row = |channels: usize| -> Vec<f32> {
        let value = |i: usize| match i % line {
            0 => 0.0,
            x if x == line - 1 => 0.0,
            _ => noise.normal() as f32,
        };
        (0..channels * line).map(value).collect()
    };
    let rows: [Vec<Vec<f32>>; 2] =
        [2, 3].map(|channels| (0..9).map(|_| random_row(channels)).collect());
    // The first row of taps lies outside of the image.
    let views = [0, 1].map(|s| std::array::from_fn(|r| (r > 0).then(|| &rows[s][r][..])));
    let mut out = vec![0.0; outputs * line];
    convolution::convolve_row(&convolution, &views, samples, &mut out);
    for output in 0..outputs {
        for x in 0..samples {
            let mut sum = convolution.biases[output];
            for tap in 3..27 {
                for channel in 0..inputs {
                    let (s, c) = if channel < 2 {
                        (0, channel)
                    } else {
                        (1, channel - 2)
                    };
                    let value = rows[s][tap / 3][c * line + x + tap % 3];
                    sum += value * weights[(tap * inputs + channel) * outputs + output];
                }
            }
            let found = out[output * line + x + 1];
            assert!(
                (found - sum.max(0.0)).abs() < 1e-4,
                "{output} {x}: {found} {sum}"
            );
        }
    }
}
