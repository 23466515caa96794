//! Synthetic images with exactly known features.
//!
//! Every kind is built from analytic surfaces, so its [`Truth`] holds the exact distance and the
//! exact closest point of every sample, not an approximation from voxels.
//!
//! Axis x (the fastest in memory) is vertical, as in a seismic trace.
//!
//! - `surface`: sheets and balls with exact closest points
//! - `crossing`: well-separated faults that cross
//! - `network`: fault networks as in real surveys
//! - `exact_distance`: distance, direction and side of every sample
//! - `amplitude`: layers, throws and a wavelet
//! - `noise`: reproducible noise
//! - `synth_spec`: the options of `atomesh synth`, as one value
//! - [`truth`]: the exact distance to the features, and its file format

mod amplitude;
mod crossing;
mod exact_distance;
mod network;
mod noise;
mod surface;
mod synth_spec;
pub mod truth;

use crate::geometry::sorted_distinct;
pub use synth_spec::{SynthDims, SynthSpec, synth};
pub use truth::Truth;

use std::f64::consts::{PI, TAU};
use std::str::FromStr;

use crate::error::cause;
use crate::geometry::random::Random;
use crate::image::{Geometry, Image};
use crate::parallel::prelude::*;
use crate::{Error, Result, memory};
use surface::ImplicitSurface;

/// Kind of a synthetic image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SyntheticKind {
    /// Fault likelihood of planar crossing faults: ridges of height 0.7 to 1.
    Planes,
    /// Fault likelihood of curved crossing faults (radius of curvature at least 45 samples,
    /// crossing angles at least 30 degrees). If there are four or more, the last one ends at the
    /// first.
    Faults,
    /// Seismic amplitude: folded layers displaced by curved faults, convolved with a Ricker wavelet
    /// along x. The features of its truth are the faults. The signal has rms 1.
    Amplitude,
    /// A bright ball with a soft edge; its feature is the ball's surface.
    Sphere,
    /// Nested thin spherical shells: ridges of height 0.7 to 1.
    Shells,
    /// Integer labels without noise: the blocks between curved crossing surfaces.
    Blocks,
    /// Fault likelihood of a network as in real surveys: 2 to 6 faults that cross at 15 to 80
    /// degrees, branch off one another, run 3 to 12 samples apart, flatten with depth and taper
    /// out.
    Network,
    /// Seismic amplitude of layers displaced by the faults of such a network; throws taper out,
    /// too.
    NetworkAmplitude,
    /// Mask of the faults of such a network, as an interpreter might paint them: ones on zeros, 1
    /// to 5 samples thick, with holes and stray pieces, without noise.
    NetworkMask,
}

impl SyntheticKind {
    /// Every kind, with the name that [`FromStr`] accepts.
    pub const ALL: [(&'static str, SyntheticKind); 9] = [
        ("planes", SyntheticKind::Planes),
        ("faults", SyntheticKind::Faults),
        ("amplitude", SyntheticKind::Amplitude),
        ("sphere", SyntheticKind::Sphere),
        ("shells", SyntheticKind::Shells),
        ("blocks", SyntheticKind::Blocks),
        ("network", SyntheticKind::Network),
        ("network-amplitude", SyntheticKind::NetworkAmplitude),
        ("network-mask", SyntheticKind::NetworkMask),
    ];
}

impl SyntheticKind {
    /// Returns `true` if the image shows layers that faults displace.
    pub fn has_layers(self) -> bool {
        matches!(
            self,
            SyntheticKind::Amplitude | SyntheticKind::NetworkAmplitude
        )
    }

    /// Returns `true` if the faults are those of [`SyntheticKind::Network`].
    fn is_network(self) -> bool {
        matches!(
            self,
            SyntheticKind::Network | SyntheticKind::NetworkAmplitude | SyntheticKind::NetworkMask
        )
    }
}

impl FromStr for SyntheticKind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::ALL
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, kind)| *kind)
            .ok_or_else(|| {
                let known: Vec<&str> = Self::ALL.iter().map(|(known, _)| *known).collect();
                Error::Job(cause(
                    format!("synth {name}"),
                    "no such kind of synthetic image",
                    format!("choose one of {}", known.join(", ")),
                ))
            })
    }
}

/// Parameters of a synthetic image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Number of samples along each axis, x first; 1 along z for a 2-D image ([`make_2d`]).
    pub dims: [usize; 3],
    /// Seed of all random numbers. The same seed gives the same bytes.
    pub seed: u64,
    /// Number of surfaces (faults or shells). The default is 4; in a network the seed determines
    /// the number. [`SyntheticKind::Sphere`] ignores it.
    pub count: Option<usize>,
    /// Ratio of the signal to the rms of the noise. The signal is 1: the height of a ridge, the
    /// brightness of the ball, or the rms amplitude. Infinity means no noise.
    pub signal_to_noise: f64,
    /// Standard deviation of the Gaussian ridges, and of the blur of the edge of the ball, in
    /// samples.
    pub width: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            dims: [128; 3],
            seed: 1,
            count: None,
            signal_to_noise: 4.0,
            width: 1.5,
        }
    }
}

impl Options {
    /// Returns the number of surfaces if the kind of image does not determine it.
    fn count(&self) -> usize {
        self.count.unwrap_or(4)
    }

    fn check(&self, kind: SyntheticKind) -> Result<()> {
        let refuse = |option: String, problem: &str, remedy: &str| {
            Err(Error::Job(cause(
                format!("synth {option}"),
                problem,
                remedy,
            )))
        };
        let samples = self
            .dims
            .iter()
            .try_fold(1usize, |all, &n| all.checked_mul(n));
        let [nx, ny, nz] = self.dims;
        if nx < 8 || ny < 8 || (nz < 8 && nz != 1) || samples.is_none_or(|n| n > 1 << 31) {
            return refuse(
                format!("dims {:?}", self.dims),
                "each axis needs at least 8 samples, and all at most 2^31",
                "choose other dimensions",
            );
        }
        let samples = (nx * ny * nz) as f64;
        let description = format!("{samples} samples");
        memory::ensure_available(
            "synth dims",
            36.0 * samples,
            description,
            "choose smaller dimensions",
        )?;
        if kind != SyntheticKind::Sphere && !(1..=16).contains(&self.count()) {
            return refuse(
                format!("count {}", self.count()),
                "must be from 1 to 16",
                "choose fewer surfaces",
            );
        }
        if self.signal_to_noise.is_nan() || self.signal_to_noise <= 0.0 {
            return refuse(
                format!("noise {}", self.signal_to_noise),
                "the ratio of signal to noise must be positive",
                "4 is noisy, inf is without noise",
            );
        }
        if !(self.width > 0.0 && self.width <= 10.0) {
            return refuse(
                format!("width {}", self.width),
                "must be above 0 and at most 10 samples",
                "1.5 is the default",
            );
        }
        Ok(())
    }
}

/// A named synthetic image, for reproducible tables and tests.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preset {
    /// Name of the preset.
    pub name: &'static str,
    /// Kind of the image.
    pub kind: SyntheticKind,
    /// Parameters of the image.
    pub options: Options,
}

/// Three noisy volumes of curved faults that cross; none of them is cubic.
pub const PRESETS: [Preset; 3] = [
    Preset {
        name: "faults-1",
        kind: SyntheticKind::Faults,
        options: Options {
            dims: [170, 150, 128],
            seed: 1,
            count: Some(4),
            signal_to_noise: 4.0,
            width: 1.5,
        },
    },
    Preset {
        name: "faults-2",
        kind: SyntheticKind::Faults,
        options: Options {
            dims: [140, 180, 120],
            seed: 2,
            count: Some(5),
            signal_to_noise: 4.0,
            width: 1.75,
        },
    },
    Preset {
        name: "faults-3",
        kind: SyntheticKind::Faults,
        options: Options {
            dims: [200, 120, 110],
            seed: 3,
            count: Some(3),
            signal_to_noise: 4.0,
            width: 2.0,
        },
    },
];

/// An image and its truth.
#[derive(Debug, Clone)]
pub struct SyntheticImage<const D: usize = 3> {
    /// The image, with unit spacing.
    pub image: Image<D>,
    /// The exact distance to its features.
    pub truth: Truth<D>,
}

/// Makes a synthetic image and its truth. The same options give the same bytes on any number of
/// threads.
///
/// # Errors
/// Returns an [`Error::Job`] if the options are invalid, or if `count` faults do not fit into the
/// box without crossing each other at less than 30 degrees.
pub fn make(kind: SyntheticKind, options: &Options) -> Result<SyntheticImage> {
    options.check(kind)?;
    let surfaces = surfaces(kind, options)?;
    let (mut truth, sides) = exact_distance::compute_truth(&surfaces, options.dims);
    if kind.is_network() || kind.has_layers() {
        let mut next = exact_distance::next_features(&surfaces, &truth);
        if kind.has_layers() {
            amplitude::mark_invisible_faults(&mut next, &truth, &sides, &surfaces, options);
        }
        truth.next_feature = Some(next);
    }
    let mut samples = match kind {
        SyntheticKind::Planes | SyntheticKind::Faults | SyntheticKind::Shells => {
            ridges(&truth, options)
        }
        SyntheticKind::Network => network::likelihood(&surfaces, options),
        SyntheticKind::NetworkMask => network::mask(&surfaces, options),
        SyntheticKind::Amplitude | SyntheticKind::NetworkAmplitude => {
            amplitude::amplitude(&sides, &surfaces, options)
        }
        SyntheticKind::Sphere => ball_image(&truth, &sides, options),
        SyntheticKind::Blocks => block_labels(&sides),
    };
    if kind != SyntheticKind::Blocks && kind != SyntheticKind::NetworkMask {
        noise::add_noise(
            &mut samples,
            options.dims,
            options.seed,
            1.0 / options.signal_to_noise,
        );
    }
    let image = Image::new(options.dims, samples, Geometry::default());
    Ok(SyntheticImage { image, truth })
}

/// Returns the depth of each sample of the image of [`make`] before folding and faulting, in
/// samples along x. It is constant along a reflector, and therefore shows whether a horizon stays
/// on its reflector across a fault.
///
/// # Errors
/// Returns the errors of [`make`], and an [`Error::Job`] for an image [without
/// layers](SyntheticKind::has_layers).
pub fn layer_depths(kind: SyntheticKind, options: &Options) -> Result<Image<3>> {
    options.check(kind)?;
    if !kind.has_layers() {
        return Err(Error::Job(cause(
            "layers",
            "this kind of image has none",
            "choose amplitude or network-amplitude",
        )));
    }
    let surfaces = surfaces(kind, options)?;
    let (_, sides) = exact_distance::compute_truth(&surfaces, options.dims);
    let samples = amplitude::depths(&sides, &surfaces, options);
    Ok(Image::new(options.dims, samples, Geometry::default()))
}

/// Returns the surfaces of an image.
fn surfaces(kind: SyntheticKind, options: &Options) -> Result<Vec<ImplicitSurface>> {
    Ok(match kind {
        SyntheticKind::Planes => crossing::faults(options, 0.0)?,
        SyntheticKind::Faults | SyntheticKind::Amplitude | SyntheticKind::Blocks => {
            crossing::faults(options, 1.0)?
        }
        SyntheticKind::Network | SyntheticKind::NetworkAmplitude | SyntheticKind::NetworkMask => {
            network::faults(options)?
        }
        SyntheticKind::Sphere => balls(options, 1),
        SyntheticKind::Shells => balls(options, options.count()),
    })
}

/// Makes a synthetic 2-D image and its truth, as [`make`] does in 3-D, with curves instead of
/// surfaces and a disc instead of a ball. `options.dims` must end in 1.
///
/// # Errors
/// Returns the errors of [`make`], and an [`Error::Job`] if there is more than one sample along z.
pub fn make_2d(kind: SyntheticKind, options: &Options) -> Result<SyntheticImage<2>> {
    let [nx, ny, nz] = options.dims;
    if nz != 1 {
        return Err(Error::Job(cause(
            format!("synth dims {:?}", options.dims),
            "a 2-D image has one sample along z",
            "give two dimensions",
        )));
    }
    let SyntheticImage { image, truth } = make(kind, options)?;
    let truth = Truth {
        dims: [nx, ny],
        distance: truth.distance,
        direction: truth.direction.iter().map(|&[x, y, _]| [x, y]).collect(),
        is_smooth: truth.is_smooth,
        next_feature: truth.next_feature,
    };
    Ok(SyntheticImage {
        image: image.flatten(),
        truth,
    })
}

/// Returns `count` nested balls about the centre of the box. The diameter of the largest is 0.8 of
/// the shortest side.
fn balls(options: &Options, count: usize) -> Vec<ImplicitSurface> {
    let extent = options.dims.map(|n| (n - 1) as f64);
    let sides = extent.iter().copied().filter(|&e| e > 0.0);
    let largest = 0.4 * sides.fold(f64::INFINITY, f64::min);
    (1..=count)
        .map(|k| ImplicitSurface::ball(extent.map(|e| 0.5 * e), largest * k as f64 / count as f64))
        .collect()
}

/// Returns Gaussian ridges on the features, whose height varies slowly over the volume.
fn ridges(truth: &Truth, options: &Options) -> Vec<f32> {
    let [nx, ny, _] = truth.dims;
    let scale = -0.5 / (options.width * options.width) as f32;
    let mut random = Random::for_purpose(options.seed, 0x5712);
    let phase: [f32; 3] = std::array::from_fn(|_| random.range(0.0, TAU) as f32);
    let wave = |k: usize, i: usize| {
        (TAU as f32 * i as f32 / truth.dims[k] as f32 * (1.0 + 0.5 * k as f32) + phase[k]).sin()
    };
    let along_x: Vec<f32> = (0..nx).map(|x| 0.05 * wave(0, x)).collect();
    let mut samples = vec![0.0; truth.distance.len()];
    samples
        .par_chunks_mut(nx)
        .zip(truth.distance.par_chunks(nx))
        .enumerate()
        .for_each(|(row, (samples, distance))| {
            let height = 0.85 + 0.05 * (wave(1, row % ny) + wave(2, row / ny));
            for x in 0..nx {
                let d = distance[x];
                samples[x] = (height + along_x[x]) * (scale * d * d).exp();
            }
        });
    samples
}

/// Returns 1 inside the ball and 0 outside, with the edge blurred to `width`.
fn ball_image(truth: &Truth, sides: &[u32], options: &Options) -> Vec<f32> {
    // The logistic edge has the same standard deviation as a Gaussian blur.
    let slope = (PI / 3f64.sqrt() / options.width) as f32;
    truth
        .distance
        .par_iter()
        .zip(sides)
        .map(|(&d, &side)| {
            let signed = if side == 0 { -d } else { d };
            1.0 / (1.0 + (slope * signed).exp())
        })
        .collect()
}

/// Returns labels 0, 1, 2 ... of the blocks between the surfaces.
fn block_labels(sides: &[u32]) -> Vec<f32> {
    let mut patterns: Vec<u32> = sides
        .par_chunks(1 << 16)
        .flat_map_iter(|chunk| sorted_distinct(chunk.iter().copied()))
        .collect();
    patterns.sort_unstable();
    patterns.dedup();
    sides
        .par_iter()
        .map(|side| patterns.partition_point(|p| p < side) as f32)
        .collect()
}

#[cfg(test)]
mod tests;
