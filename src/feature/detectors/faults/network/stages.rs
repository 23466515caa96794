//! Runs a network layer by layer.
//!
//! A stage of the network makes each layer of its output from a few layers of its sources. A layer is
//! computed when a later stage asks for it, and dropped when no stage needs it any more. So only as
//! many layers as the network reaches are in memory, and none is computed twice.

use super::convolution::{Convolution, TAP_ROWS, convolve_row, line_len};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::collections::VecDeque;

/// Where a stage takes values from: the image (0), or the output of an earlier stage (its number + 1).
#[derive(Clone, Copy)]
pub struct Source {
    stage: usize,
    /// `true` if each sample of the source counts for two samples along each axis.
    is_doubled: bool,
}

impl Source {
    /// Returns a source at the resolution of the stage.
    pub fn same(stage: usize) -> Self {
        Self {
            stage,
            is_doubled: false,
        }
    }

    /// Returns a source at half the resolution of the stage.
    pub fn doubled(stage: usize) -> Self {
        Self {
            stage,
            is_doubled: true,
        }
    }
}

/// One step of a network.
pub struct Stage {
    step: Step,
    sources: Vec<Source>,
    channels: usize,
    /// Number of times that the resolution was halved.
    level: usize,
}

enum Step {
    Convolution(Convolution),
    /// The maximum of two samples along each axis.
    Halving,
}

impl Stage {
    pub fn convolution(convolution: Convolution, sources: Vec<Source>, level: usize) -> Self {
        Self {
            channels: convolution.biases.len(),
            step: Step::Convolution(convolution),
            sources,
            level,
        }
    }

    pub fn halving(source: usize, channels: usize, level: usize) -> Self {
        Self {
            step: Step::Halving,
            sources: vec![Source::same(source)],
            channels,
            level,
        }
    }

    /// Returns the layers of a source that layer `z` needs, of a source with `count` layers.
    fn needed(&self, source: &Source, z: usize, count: usize) -> std::ops::Range<usize> {
        match self.step {
            Step::Halving => 2 * z..(2 * z + 2).min(count),
            Step::Convolution(_) if source.is_doubled => {
                z.saturating_sub(1) / 2..(z.div_ceil(2) + 1).min(count)
            }
            Step::Convolution(_) => z.saturating_sub(1)..(z + 2).min(count),
        }
    }
}

/// A network whose last output is a sum over channels.
pub struct Network {
    stages: Vec<Stage>,
    weights: Vec<f32>,
    bias: f32,
    /// Numbers of the stages that use the output of each stage, and of the image.
    users: Vec<Vec<usize>>,
}

/// Layers of a stage's output that are in memory.
#[derive(Default)]
struct Output {
    dims: [usize; 3],
    row_len: usize,
    /// Number of the first layer in memory, and of the next to be computed.
    first: usize,
    next: usize,
    layers: VecDeque<Vec<f32>>,
    /// Layers that can be overwritten.
    spare: Vec<Vec<f32>>,
}

impl Output {
    fn row(&self, y: usize, z: usize) -> &[f32] {
        &self.layers[z - self.first][y * self.row_len..][..self.row_len]
    }
}

impl Network {
    pub fn new(stages: Vec<Stage>, weights: Vec<f32>, bias: f32) -> Self {
        let mut users = vec![Vec::new(); stages.len() + 1];
        for (number, stage) in stages.iter().enumerate() {
            for source in &stage.sources {
                users[source.stage].push(number);
            }
        }
        Self {
            stages,
            weights,
            bias,
            users,
        }
    }

    /// Returns the logistic function of the network's output at each sample (x fastest) of the image.
    pub fn probabilities(
        &self,
        dims: [usize; 3],
        image: &[f32],
        cancel: &CancelToken<'_>,
    ) -> Vec<f32> {
        let mut run = Run {
            network: self,
            image,
            outputs: self.outputs(dims),
        };
        let mut probabilities = vec![0.0; image.len()];
        let last = self.stages.len();
        let layers = probabilities.chunks_exact_mut((dims[0] * dims[1]).max(1));
        for (z, layer) in layers.enumerate() {
            if cancel.is_cancelled() {
                break;
            }
            run.compute(last, z);
            let output = &run.outputs[last];
            layer
                .par_chunks_mut(dims[0])
                .enumerate()
                .for_each(|(y, row)| {
                    row.fill(self.bias);
                    let lines = output.row(y, z).chunks_exact(line_len(dims[0]));
                    for (line, weight) in lines.zip(&self.weights) {
                        let values = &line[1..=row.len()];
                        for i in 0..row.len() {
                            row[i] += weight * values[i];
                        }
                    }
                    row.iter_mut().for_each(|sum| *sum = logistic(*sum));
                });
            run.drop_layers(last, z + 1);
        }
        probabilities
    }

    fn outputs(&self, dims: [usize; 3]) -> Vec<Output> {
        let output = |channels: usize, level: usize| {
            let dims = dims.map(|n| n.div_ceil(1 << level));
            Output {
                dims,
                row_len: channels * line_len(dims[0]),
                ..Output::default()
            }
        };
        let stages = self.stages.iter().map(|s| output(s.channels, s.level));
        std::iter::once(output(1, 0)).chain(stages).collect()
    }
}

/// The layers in memory while a network runs.
struct Run<'a> {
    network: &'a Network,
    image: &'a [f32],
    /// The image, and the output of each stage.
    outputs: Vec<Output>,
}

impl Run<'_> {
    /// Makes sure that the output `number` has layer `z`.
    fn compute(&mut self, number: usize, z: usize) {
        while self.outputs[number].next <= z {
            let next = self.outputs[number].next;
            let layer = if number == 0 {
                self.image_layer(next)
            } else {
                let network = self.network;
                let stage = &network.stages[number - 1];
                for source in &stage.sources {
                    let count = self.outputs[source.stage].dims[2];
                    let needed = stage.needed(source, next, count);
                    self.compute(source.stage, needed.end - 1);
                }
                let layer = self.stage_layer(stage, number, next);
                for source in &stage.sources {
                    self.drop_unneeded(source.stage, number - 1, next + 1);
                }
                layer
            };
            let output = &mut self.outputs[number];
            output.layers.push_back(layer);
            output.next += 1;
        }
    }

    /// Drops the layers of an output that no stage needs any more; `user` computes layer `z` next.
    fn drop_unneeded(&mut self, number: usize, user: usize, z: usize) {
        let count = self.outputs[number].dims[2];
        let network = self.network;
        let first_needed = |&stage: &usize| {
            let next = if stage == user {
                z
            } else {
                self.outputs[stage + 1].next
            };
            let sources = network.stages[stage].sources.iter();
            sources
                .filter(|s| s.stage == number)
                .map(|s| network.stages[stage].needed(s, next, count).start)
                .min()
        };
        let first = network.users[number].iter().filter_map(first_needed).min();
        self.drop_layers(number, first.unwrap_or(0));
    }

    fn drop_layers(&mut self, number: usize, first: usize) {
        let output = &mut self.outputs[number];
        while output.first < first.min(output.next) {
            output.spare.extend(output.layers.pop_front());
            output.first += 1;
        }
    }

    /// Returns memory for a layer of an output. Its margins are zero.
    fn blank_layer(&mut self, number: usize) -> Vec<f32> {
        let output = &mut self.outputs[number];
        let len = output.row_len * output.dims[1];
        output.spare.pop().unwrap_or_else(|| vec![0.0; len])
    }

    fn image_layer(&mut self, z: usize) -> Vec<f32> {
        let mut layer = self.blank_layer(0);
        let Output { dims, row_len, .. } = self.outputs[0];
        let image = &self.image[z * dims[0] * dims[1]..];
        let rows = image.chunks_exact(dims[0]);
        for (row, samples) in layer.chunks_exact_mut(row_len).zip(rows) {
            row[1..=dims[0]].copy_from_slice(samples);
        }
        layer
    }

    fn stage_layer(&mut self, stage: &Stage, number: usize, z: usize) -> Vec<f32> {
        let mut layer = self.blank_layer(number);
        let (dims, row_len) = (self.outputs[number].dims, self.outputs[number].row_len);
        let this = &*self;
        layer
            .par_chunks_mut(row_len)
            .enumerate()
            .for_each(|(y, out)| match &stage.step {
                Step::Halving => this.halve_row(stage, [y, z], out),
                Step::Convolution(convolution) => {
                    this.convolve_row(stage, convolution, [y, z], dims, out);
                }
            });
        layer
    }

    fn halve_row(&self, stage: &Stage, [y, z]: [usize; 2], out: &mut [f32]) {
        let source = &self.outputs[stage.sources[0].stage];
        let [nx, ny, nz] = source.dims;
        let (line, halved_line) = (line_len(nx), line_len(nx.div_ceil(2)));
        let mut is_first = true;
        for z in 2 * z..(2 * z + 2).min(nz) {
            for y in 2 * y..(2 * y + 2).min(ny) {
                let lines = source.row(y, z).chunks_exact(line);
                for (out, line) in out.chunks_exact_mut(halved_line).zip(lines) {
                    // At an odd end, a single sample is left.
                    for (out, pair) in out[1..].iter_mut().zip(line[1..=nx].chunks(2)) {
                        let highest = pair[0].max(pair[pair.len() - 1]);
                        *out = if is_first { highest } else { out.max(highest) };
                    }
                }
                is_first = false;
            }
        }
    }

    fn convolve_row(
        &self,
        stage: &Stage,
        convolution: &Convolution,
        [y, z]: [usize; 2],
        dims: [usize; 3],
        out: &mut [f32],
    ) {
        // Rows of sources at half the resolution, with each sample twice.
        let mut doubled: Vec<Vec<f32>> = Vec::new();
        let places = |tap_row: usize| {
            let y = (y + tap_row % 3).checked_sub(1).filter(|&y| y < dims[1])?;
            let z = (z + tap_row / 3).checked_sub(1).filter(|&z| z < dims[2])?;
            Some([y, z])
        };
        for source in &stage.sources {
            if source.is_doubled {
                let output = &self.outputs[source.stage];
                doubled.extend((0..TAP_ROWS).map(|tap_row| {
                    let row = places(tap_row).map(|[y, z]| output.row(y / 2, z / 2));
                    row.map_or_else(Vec::new, |row| double_row(row, dims[0]))
                }));
            }
        }
        let rows: Vec<[Option<&[f32]>; TAP_ROWS]> = stage
            .sources
            .iter()
            .map(|source| {
                std::array::from_fn(|tap_row| {
                    let [y, z] = places(tap_row)?;
                    Some(if source.is_doubled {
                        &doubled[tap_row]
                    } else {
                        self.outputs[source.stage].row(y, z)
                    })
                })
            })
            .collect();
        convolve_row(convolution, &rows, dims[0], out);
    }
}

/// Returns a row of `samples` samples that has each sample of `row` twice.
fn double_row(row: &[f32], samples: usize) -> Vec<f32> {
    let (line, doubled_line) = (line_len(samples.div_ceil(2)), line_len(samples));
    let mut doubled = vec![0.0; row.len() / line * doubled_line];
    for (out, line) in doubled
        .chunks_exact_mut(doubled_line)
        .zip(row.chunks_exact(line))
    {
        for (pair, value) in out[1..].chunks_exact_mut(2).zip(&line[1..]) {
            pair[0] = *value;
            pair[1] = *value;
        }
        out[samples + 1] = 0.0;
    }
    doubled
}

/// Returns 1 / (1 + exp(-x)) to about 1e-6, the same on every machine.
fn logistic(x: f32) -> f32 {
    // exp(-|x|) = (exp(-|x| / 64))^64, by the first terms of the series.
    let t = -f64::from(x.abs().min(40.0)) / 64.0;
    let small = 1.0
        + t * (1.0
            + t / 2.0 * (1.0 + t / 3.0 * (1.0 + t / 4.0 * (1.0 + t / 5.0 * (1.0 + t / 6.0)))));
    let power = (0..6).fold(small, |p, _| p * p);
    let below = power / (1.0 + power);
    (if x < 0.0 { below } else { 1.0 - below }) as f32
}
