//! Convolutions over 3 x 3 x 3 samples of many channels.
//!
//! A row has one channel after the other, each as a line of samples with a zero at either end. So
//! every loop runs over neighbouring samples, whatever the number of channels.

use crate::geometry::simd::dispatch_simd;
use std::ops::Range;

/// Number of taps along a line.
const TAPS: usize = 3;
/// Number of rows with taps.
pub const TAP_ROWS: usize = 9;

/// A convolution of one or two sources, and a rectifier.
pub struct Convolution {
    pub sources: Vec<SourceWeights>,
    pub biases: Vec<f32>,
}

/// Weights of a convolution for the channels of one source.
pub struct SourceWeights {
    pub channels: usize,
    /// For each output, row of taps and input channel: the weights along the line.
    weights: Vec<[f32; TAPS]>,
}

impl SourceWeights {
    /// Arranges the weights of the channels `range` out of `all`. `weights` has them by tap, input
    /// channel and output; `taps` are the taps' numbers (x fastest).
    pub fn new(
        weights: &[f32],
        all: usize,
        range: Range<usize>,
        outputs: usize,
        taps: &[usize],
    ) -> Self {
        let channels = range.len();
        let mut arranged = vec![[0.0; TAPS]; outputs * TAP_ROWS * channels];
        for (tap, &place) in taps.iter().enumerate() {
            for (number, channel) in range.clone().enumerate() {
                for output in 0..outputs {
                    let tap_row = place / TAPS;
                    arranged[(output * TAP_ROWS + tap_row) * channels + number][place % TAPS] =
                        weights[(tap * all + channel) * outputs + output];
                }
            }
        }
        Self {
            channels,
            weights: arranged,
        }
    }

    /// Returns the weights of each input channel for an output and a row of taps.
    fn of_channels(&self, output: usize, tap_row: usize) -> &[[f32; TAPS]] {
        &self.weights[(output * TAP_ROWS + tap_row) * self.channels..][..self.channels]
    }
}

/// Returns the length of a line of `samples` samples: there is a zero at each end.
pub fn line_len(samples: usize) -> usize {
    samples + 2
}

/// Computes one row of the output. `rows` has, for each source, the row at each row of taps, if there
/// is one.
pub fn convolve_row(
    convolution: &Convolution,
    rows: &[[Option<&[f32]>; TAP_ROWS]],
    samples: usize,
    out: &mut [f32],
) {
    let line = line_len(samples);
    dispatch_simd(
        #[inline(always)]
        || {
            let outputs = out.chunks_exact_mut(line).zip(&convolution.biases);
            for (output, (out, bias)) in outputs.enumerate() {
                let sums = &mut out[1..=samples];
                sums.fill(*bias);
                for (source, rows) in convolution.sources.iter().zip(rows) {
                    for (tap_row, row) in rows.iter().enumerate() {
                        let Some(row) = row else { continue };
                        let channels = source.of_channels(output, tap_row);
                        for (weights, line) in channels.iter().zip(row.chunks_exact(line)) {
                            add_line(sums, line, weights);
                        }
                    }
                }
                for sum in sums {
                    *sum = sum.max(0.0);
                }
            }
        },
    );
}

/// Adds the taps along a line to the sums.
#[inline(always)]
fn add_line(sums: &mut [f32], line: &[f32], [a, b, c]: &[f32; TAPS]) {
    let n = sums.len();
    let (low, middle, high) = (&line[..n], &line[1..=n], &line[2..n + 2]);
    for i in 0..n {
        sums[i] += a * low[i] + b * middle[i] + c * high[i];
    }
}
