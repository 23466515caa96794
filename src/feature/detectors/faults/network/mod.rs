//! Tells how likely each sample lies on a fault, by a convolutional network.
//!
//! The network has the form of a U-Net (Ronneberger et al. 2015; for faults: Wu et al. 2019,
//! "FaultSeg3D"). At each of four levels, two convolutions over 3 samples along each axis look for
//! patterns; between levels, the maximum of 2 samples along each axis halves the resolution. On the
//! way back, each level also sees the patterns of the level above it. So the network compares what
//! lies 40 samples apart, and still knows where a fault is to the sample. It was trained on synthetic
//! images only, by `scripts/train_fault_network.py`. There is one network for volumes and one for
//! sections.
//!
//! Input are amplitudes divided by their root mean square around each sample. The axis across the
//! layers must be known, because faults are steep: the network's weights are turned to it.
//!
//! In sections the probability is the mean of four: of the section and of the section with its traces
//! twice as close (`section`), each also mirrored and with opposite sign. Traces of real sections
//! are often far apart, so that faults lie close together and layers are steep; the network for
//! sections was also trained on such images.

mod convolution;
mod section;
mod stages;

use super::semblance::balance_amplitudes;
use crate::error::Result;
use crate::feature::windows::Samples;
use crate::progress::CancelToken;
use convolution::{Convolution, SourceWeights};
use half::f16;
use stages::{Network, Source, Stage};

/// Weights of the networks: see `UNet.write` in `scripts/train_fault_network.py`.
const VOLUME_WEIGHTS: &[u8] = include_bytes!("volume.bin");
const SECTION_WEIGHTS: &[u8] = include_bytes!("section.bin");

/// Number of channels at each level of the networks.
const VOLUME_CHANNELS: [usize; LEVELS] = [8, 16, 32, 48];
const SECTION_CHANNELS: [usize; LEVELS] = [16, 24, 32, 48];
const LEVELS: usize = 4;

/// Distance (samples) at which samples influence the network's output: 44 by two convolutions before
/// and after each halving, and up to 7 because halving combines samples.
const NETWORK_REACH: usize = 56;

/// Number of layers of the halo: the network's reach, plus that of balancing amplitudes.
pub const HALO_LAYERS: usize = NETWORK_REACH + super::semblance::BALANCE_REACH;

/// Computes the probability that each sample lies on a fault; each rank gets a share of it.
///
/// `vertical` is the axis across the layers, and `rms` the root mean square amplitude. Gaps in the data
/// must be filled from their sides, because the network takes the margin of zeros for a fault.
///
/// # Errors
/// Returns the errors of reading layers of `amplitude`.
pub fn likelihood<'a, const D: usize>(
    amplitude: &Samples<'a, D>,
    vertical: usize,
    rms: f32,
    cancel: &CancelToken<'_>,
) -> Result<Samples<'a, D>> {
    if D == 2 {
        let networks = section::Networks::new::<D>(vertical);
        return amplitude.map_windows(HALO_LAYERS, cancel, |stack| {
            networks.probabilities(stack.volume, rms, cancel)
        });
    }
    let network = fault_network::<D>(vertical, false);
    amplitude.map_windows(HALO_LAYERS, cancel, |stack| {
        let balanced = balance_amplitudes(stack.volume, rms, cancel);
        network.probabilities(grid_dims(stack.volume.dims), &balanced, cancel)
    })
}

/// Returns dimensions in which a section is a volume with a single row in each layer.
fn grid_dims<const D: usize>(dims: [usize; D]) -> [usize; 3] {
    [dims[0], if D == 3 { dims[1] } else { 1 }, dims[D - 1]]
}

/// Returns the network for images of `D` dimensions whose layers lie across the axis `vertical`; or
/// its mirror image along the first of the other axes, which gives for a mirrored image the
/// mirrored probabilities.
fn fault_network<const D: usize>(vertical: usize, is_mirrored: bool) -> Network {
    let (bytes, channels) = match D {
        2 => (SECTION_WEIGHTS, SECTION_CHANNELS),
        _ => (VOLUME_WEIGHTS, VOLUME_CHANNELS),
    };
    let mut reader = WeightReader {
        bytes,
        taps: tap_order::<D>(vertical, is_mirrored),
    };
    let mut stages = Vec::new();
    let mut last = 0;
    let mut skips = Vec::new();
    let mut convolve = |stages: &mut Vec<Stage>, level: usize, sources: &[(Source, usize)]| {
        let convolution = reader.convolution(sources.iter().map(|s| s.1), channels[level]);
        let sources = sources.iter().map(|s| s.0).collect();
        stages.push(Stage::convolution(convolution, sources, level));
        stages.len()
    };
    for level in 0..LEVELS {
        let mut inputs = 1;
        if level > 0 {
            skips.push(last);
            inputs = channels[level - 1];
            stages.push(Stage::halving(last, inputs, level));
            last = stages.len();
        }
        last = convolve(&mut stages, level, &[(Source::same(last), inputs)]);
        last = convolve(&mut stages, level, &[(Source::same(last), channels[level])]);
    }
    for level in (0..LEVELS - 1).rev() {
        let sources = [
            (Source::doubled(last), channels[level + 1]),
            (Source::same(skips[level]), channels[level]),
        ];
        last = convolve(&mut stages, level, &sources);
        last = convolve(&mut stages, level, &[(Source::same(last), channels[level])]);
    }
    let (weights, bias) = reader.sum(channels[0]);
    Network::new(stages, weights, bias)
}

/// Returns for each tap of the file, whose last axis is the vertical one and the fastest, the number
/// of the tap in the image's axes, whose first is the fastest. In a section, y has a single tap, the
/// middle one.
fn tap_order<const D: usize>(vertical: usize, is_mirrored: bool) -> Vec<usize> {
    let mut axes: Vec<usize> = (0..D).rev().filter(|&axis| axis != vertical).collect();
    axes.push(vertical);
    // Strides of a tap's number along the image's axes.
    let strides: [usize; 3] = [1, 3, 9];
    let stride = |axis: usize| {
        if D == 2 && axis == 1 {
            9
        } else {
            strides[axis]
        }
    };
    let middle = if D == 2 { 3 } else { 0 };
    (0..3usize.pow(D as u32))
        .map(|number| {
            let digit = |place: usize| {
                let digit = number / 3usize.pow((D - 1 - place) as u32) % 3;
                if is_mirrored && place == 0 {
                    2 - digit
                } else {
                    digit
                }
            };
            let along: usize = (0..D).map(|place| digit(place) * stride(axes[place])).sum();
            middle + along
        })
        .collect()
}

/// Reads the weights of one convolution after the other.
struct WeightReader {
    bytes: &'static [u8],
    taps: Vec<usize>,
}

impl WeightReader {
    fn take(&mut self, count: usize) -> &'static [u8] {
        let (taken, rest) = self.bytes.split_at(count);
        self.bytes = rest;
        taken
    }

    fn weights(&mut self, count: usize) -> Vec<f32> {
        let halves = self.take(2 * count).chunks_exact(2);
        halves
            .map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32())
            .collect()
    }

    fn biases(&mut self, count: usize) -> Vec<f32> {
        let words = self.take(4 * count).chunks_exact(4);
        words
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect()
    }

    /// Reads a convolution over 3 samples along each axis, whose input channels come from several
    /// sources.
    fn convolution(
        &mut self,
        inputs: impl Iterator<Item = usize> + Clone,
        outputs: usize,
    ) -> Convolution {
        let all: usize = inputs.clone().sum();
        let weights = self.weights(self.taps.len() * all * outputs);
        let biases = self.biases(outputs);
        let mut first = 0;
        let sources = inputs
            .map(|count| {
                let channels = first..first + count;
                first += count;
                SourceWeights::new(&weights, all, channels, outputs, &self.taps)
            })
            .collect();
        Convolution { sources, biases }
    }

    /// Reads the weights and the bias of the last sum over the channels.
    fn sum(&mut self, inputs: usize) -> (Vec<f32>, f32) {
        let weights = self.weights(inputs);
        (weights, self.biases(1)[0])
    }
}

#[cfg(test)]
mod tests;
