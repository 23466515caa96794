//! Seismic amplitude: folded layers, displaced by faults, convolved with a wavelet.

use super::Options;
use super::surface::ImplicitSurface;
use super::truth::Truth;
use crate::geometry::random::Random;
use crate::parallel::prelude::*;
use std::f64::consts::{PI, TAU};

/// Peak frequency of the Ricker wavelet, in cycles per sample.
const WAVELET_FREQUENCY: f64 = 0.08;
/// Smallest dip, in degrees, of faults that displace layers. Flatter faults slip along the layers.
const MIN_FAULT_DIP: f64 = 40.0;
/// Smallest throw, in samples, that is visible: a sixth of the period of the wavelet.
const MIN_VISIBLE_THROW: f32 = 2.0;
/// Knots per sample in the table of layers.
const KNOTS_PER_SAMPLE: f64 = 8.0;

/// Folded layers displaced by faults.
///
/// `sides` has one bit per fault. The layers on the positive side of a fault are displaced along x
/// by 4 to 12 samples, varying along the fault. If the fault has a rim, the throw tapers out
/// towards the rim and away from the fault. Throws of faults that meet add up or cancel.
///
/// The depth of a sample before folding and faulting is `w = x + fold(y, z) (1/2 + x / nx) + sum of
/// throws`.
struct FoldedLayers<'a> {
    dims: [usize; 3],
    sides: &'a [u32],
    faults: &'a [ImplicitSurface],
    throws: Vec<Throw>,
    folds: Vec<[f64; 4]>,
    has_tapers: bool,
}

impl<'a> FoldedLayers<'a> {
    fn new(
        random: &mut Random,
        sides: &'a [u32],
        faults: &'a [ImplicitSurface],
        dims: [usize; 3],
    ) -> Self {
        let [_, ny, nz] = dims;
        let max_normal_x = MIN_FAULT_DIP.to_radians().cos();
        let throw = |fault: &ImplicitSurface| {
            let throw = Throw::new(random);
            if fault.mean_normal()[0].abs() <= max_normal_x {
                throw
            } else {
                Throw { mean: 0.0, ..throw }
            }
        };
        let throws: Vec<Throw> = faults.iter().map(throw).collect();
        let folds: Vec<[f64; 4]> = (0..4)
            .map(|_| {
                let k = PI / ny.max(nz) as f64 * random.range(1.0, 4.0);
                let (sin, cos) = random.range(0.0, TAU).sin_cos();
                // The slope of each fold is at most 0.12.
                [
                    random.range(0.04, 0.12) / k,
                    k * cos,
                    k * sin,
                    random.range(0.0, TAU),
                ]
            })
            .collect();
        Self {
            dims,
            sides,
            faults,
            throws,
            folds,
            has_tapers: faults.iter().any(|s| s.rim.is_some()),
        }
    }

    /// Returns an upper bound of the displacement of a layer by folds and throws.
    fn max_shift(&self) -> f64 {
        let folds = self.folds.iter().map(|f| 1.5 * f[0]);
        folds.sum::<f64>() + 17.0 * self.faults.len() as f64
    }

    /// Computes the depths before folding and faulting of samples `-margin..depths.len() - margin`
    /// of a row along x.
    fn depths(&self, row: usize, margin: usize, depths: &mut [f64]) {
        let [nx, ny, _] = self.dims;
        let (y, z) = ((row % ny) as f64, (row / ny) as f64);
        let fold: f64 = (self.folds.iter())
            .map(|f| f[0] * (f[1] * y + f[2] * z + f[3]).sin())
            .sum();
        let sides = &self.sides[row * nx..(row + 1) * nx];
        let (mut last, mut shift) = (u32::MAX, 0.0);
        for (i, depth) in depths.iter_mut().enumerate() {
            let x = i as f64 - margin as f64;
            let side = sides[i.saturating_sub(margin).min(nx - 1)];
            // A throw that tapers out changes from sample to sample.
            if side != last || self.has_tapers && side != 0 {
                let p = [x.clamp(0.0, (nx - 1) as f64), y, z];
                let shifting_faults = (0..self.faults.len()).filter(|k| side >> k & 1 == 1);
                shift = shifting_faults
                    .map(|k| self.throws[k].shift_at(y, z) * self.faults[k].throw_share(p))
                    .sum();
                last = side;
            }
            // Folding does not continue beyond the box, so that w stays within the layers.
            let stretch = 0.5 + x.clamp(0.0, nx as f64) / nx as f64;
            *depth = x + fold * stretch + shift;
        }
    }
}

/// Returns the random numbers for the layers of an amplitude image.
fn layer_random(options: &Options) -> Random {
    Random::for_purpose(options.seed, 0xa3b1)
}

/// Returns the depth of each sample of [`amplitude`] before folding and faulting. It is constant
/// along a reflector.
pub(super) fn depths(sides: &[u32], faults: &[ImplicitSurface], options: &Options) -> Vec<f32> {
    let folded = FoldedLayers::new(&mut layer_random(options), sides, faults, options.dims);
    let nx = options.dims[0];
    let mut samples = vec![0f32; sides.len()];
    samples.par_chunks_mut(nx).enumerate().for_each_init(
        || vec![0.0; nx],
        |depths, (row, samples)| {
            folded.depths(row, 0, depths);
            samples
                .iter_mut()
                .zip(depths)
                .for_each(|(s, w)| *s = *w as f32);
        },
    );
    samples
}

/// Marks the invisible parts of faults in `next_feature` (see [`Truth::next_feature`]): where the
/// layers are displaced by less than [`MIN_VISIBLE_THROW`] samples, because throws of faults that
/// meet may cancel.
pub(super) fn mark_invisible_faults(
    entry: &mut [[f32; 2]],
    truth: &Truth,
    sides: &[u32],
    faults: &[ImplicitSurface],
    options: &Options,
) {
    let depths = depths(sides, faults, options);
    // Displacement of the layer at a position: its original depth minus its present depth.
    let shift = |p: [f32; 3]| {
        let index: [usize; 3] =
            std::array::from_fn(|k| (p[k].round().max(0.0) as usize).min(truth.dims[k] - 1));
        depths[truth.sample_index(index)] - index[0] as f32
    };
    entry.par_iter_mut().enumerate().for_each(|(i, next)| {
        if truth.distance[i] < 0.5 {
            let position = truth.index_of(i).map(|c| c as f32);
            let normal = truth.direction[i];
            let shift_beside = |offset: f32| {
                shift(std::array::from_fn(|k| {
                    position[k] + (truth.distance[i] + offset) * normal[k]
                }))
            };
            if (shift_beside(1.5) - shift_beside(-1.5)).abs() < MIN_VISIBLE_THROW {
                *next = [-1.0, 90.0];
            }
        }
    });
}

/// Returns the amplitude of folded layers displaced by faults, with rms 1. Impedance is constant
/// within a layer of w, and the trace along x is its derivative convolved with the wavelet.
pub(super) fn amplitude(
    sides: &[u32],
    surfaces: &[ImplicitSurface],
    options: &Options,
) -> Vec<f32> {
    let [nx, ny, _] = options.dims;
    let mut random = layer_random(options);
    let folded = FoldedLayers::new(&mut random, sides, surfaces, options.dims);
    let wavelet = wavelet_slope();
    let margin = wavelet.len() / 2;
    let pad = folded.max_shift() + margin as f64 + 4.0;
    let layers = LayerTable::new(&mut random, -pad, nx as f64 + pad);

    let mut samples = vec![0f32; sides.len()];
    samples.par_chunks_mut(nx).enumerate().for_each_init(
        || (vec![0.0; nx + 2 * margin], vec![0f32; nx + 2 * margin]),
        |(depths, impedance), (row, trace)| {
            folded.depths(row, margin, depths);
            for (impedance, &w) in impedance.iter_mut().zip(&*depths) {
                *impedance = layers.mean(w);
            }
            for (x, sample) in trace.iter_mut().enumerate() {
                *sample = impedance[x..]
                    .iter()
                    .zip(&wavelet)
                    .map(|(i, w)| i * w)
                    .sum();
            }
        },
    );
    let squares: Vec<f64> = samples
        .par_chunks(nx * ny)
        .map(|plane| plane.iter().map(|&s| f64::from(s * s)).sum())
        .collect();
    let rms = (squares.iter().sum::<f64>() / samples.len() as f64).sqrt();
    let scale = if rms > 0.0 { (1.0 / rms) as f32 } else { 0.0 };
    samples.par_iter_mut().for_each(|s| *s *= scale);
    samples
}

/// Displacement of layers along a fault.
struct Throw {
    mean: f64,
    wave: [f64; 2],
    phase: f64,
}

impl Throw {
    fn new(random: &mut Random) -> Self {
        let sign = if random.range(0.0, 1.0) < 0.5 {
            -1.0
        } else {
            1.0
        };
        Self {
            mean: sign * random.range(5.5, 9.5),
            wave: [random.range(-0.03, 0.03), random.range(-0.03, 0.03)],
            phase: random.range(0.0, TAU),
        }
    }

    fn shift_at(&self, y: f64, z: f64) -> f64 {
        self.mean * (1.0 + 0.25 * (self.wave[0] * y + self.wave[1] * z + self.phase).sin())
    }
}

/// Layers of random thickness (3 to 9 samples) and impedance, as a table of the integral of the
/// impedance.
struct LayerTable {
    start: f64,
    integral: Vec<f64>,
}

impl LayerTable {
    fn new(random: &mut Random, start: f64, end: f64) -> Self {
        let knots = ((end - start) * KNOTS_PER_SAMPLE).ceil() as usize + 2;
        let mut integral = Vec::with_capacity(knots);
        let (mut sum, mut impedance, mut layer_end) = (0.0, 0.0, start);
        for k in 0..knots {
            if start + k as f64 / KNOTS_PER_SAMPLE >= layer_end {
                impedance = random.range(-1.0, 1.0);
                layer_end += random.range(3.0, 9.0);
            }
            integral.push(sum);
            sum += impedance / KNOTS_PER_SAMPLE;
        }
        Self { start, integral }
    }

    fn integral(&self, w: f64) -> f64 {
        let knot =
            ((w - self.start) * KNOTS_PER_SAMPLE).clamp(0.0, (self.integral.len() - 2) as f64);
        let k = knot as usize;
        self.integral[k] + (knot - k as f64) * (self.integral[k + 1] - self.integral[k])
    }

    /// Returns the mean impedance over one sample about w, which keeps thin layers from aliasing.
    fn mean(&self, w: f64) -> f32 {
        (self.integral(w + 0.5) - self.integral(w - 0.5)) as f32
    }
}

/// Returns the derivative of a Ricker wavelet (1 - 2 a) exp(-a), a = (pi f t)^2, reversed for a
/// sliding product. Its product with impedances is the reflectivity convolved with the wavelet.
fn wavelet_slope() -> Vec<f32> {
    let half = (1.3 / WAVELET_FREQUENCY).ceil() as i64;
    (-half..=half)
        .map(|i| {
            let t = -i as f64;
            let q = (PI * WAVELET_FREQUENCY).powi(2);
            let a = q * t * t;
            (2.0 * q * t * (2.0 * a - 3.0) * (-a).exp()) as f32
        })
        .collect()
}
