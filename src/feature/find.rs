//! The candidates of each kind of feature: scales, thresholds, and what is said about them.

use super::crossing::Candidate;
use super::ridges::{self, Statistics};
use super::volume::Volume;
use super::{Kind, Options, Settled};
use super::{canny, edges, faults, gaussian, horizons, labels, paths, repair, tensor};
use crate::error::{Error, Result, cause};
use crate::geometry::dot;
use crate::image::Image;

/// The scale at which sheets were sought, and their thresholds.
#[derive(Clone, Copy)]
pub(super) struct Levels {
    pub(super) scale: f64,
    pub(super) low: f32,
    pub(super) high: f32,
}

impl From<&Settled> for Levels {
    fn from(settled: &Settled) -> Self {
        let Settled {
            scale, low, high, ..
        } = *settled;
        Self { scale, low, high }
    }
}

/// Candidates, and what decides which of them make sheets.
pub(super) struct Found<const D: usize> {
    pub(super) candidates: Vec<Candidate<D>>,
    pub(super) levels: Levels,
    /// The value of the thin mask whose middle was sought.
    pub(super) mask: Option<f32>,
    /// Least area of a sheet, in squares of the least distance (in 2-D: length, in distances).
    pub(super) min_cells: f64,
    /// Parallel sheets nearer than this, in units of the least distance, exclude one another.
    pub(super) resolution: f64,
    /// Of paths: the share of them that passes each sample.
    pub(super) confidence: Option<Vec<f32>>,
}

impl<const D: usize> Found<D> {
    /// Drops what lies where traces are missing, or so near that smoothing mixes what is beside them
    /// with what only continues it.
    pub(super) fn drop_near_missing(
        &mut self,
        image: &Image<D>,
        kind: Kind,
        notes: &mut Vec<String>,
    ) {
        // Semblance looks farther than smoothing, along layers that go on level where data end.
        let beyond = if kind == Kind::Faults { 12.0 } else { 2.0 };
        let reach = (3.0 * self.levels.scale).ceil() + beyond;
        let near = image.near_missing(reach);
        if near.is_empty() {
            return;
        }
        let row = |c: &Candidate<D>| c.voxel as usize / image.dims()[0];
        let dropped = self.candidates.iter().map(row);
        let dropped = dropped.filter(|&r| near[r] && !image.missing[r]).count();
        self.candidates.retain(|c| !near[row(c)]);
        notes.push(format!(
            "{dropped} candidates dropped as they lie within {reach} samples of missing traces"
        ));
    }
}

/// Finds the candidates of one kind of feature; notes say how.
pub(super) fn find<const D: usize>(
    image: &Image<D>,
    kind: Kind,
    options: &Options<D>,
    known: Option<&Settled>,
    notes: &mut Vec<String>,
) -> Result<Found<D>> {
    let dims = image.dims();
    let samples = || image.as_slice().to_vec();
    let levels = known.map(Levels::from);
    let automatic = Statistics::thresholds;
    match kind {
        Kind::Auto | Kind::Ridges => {
            let scene = (dims, samples(), FINEST);
            Ok(find_ridges(scene, automatic, options, levels, notes))
        }
        Kind::Valleys | Kind::Potential => {
            let outside = image.as_slice().iter().find(|s| !(-1.0..=0.0).contains(*s));
            if let (Kind::Potential, Some(value)) = (kind, outside) {
                return Err(Error::Image(cause(
                    "image",
                    format!("is no potential b(x) in [-1, 0]: it holds {value}"),
                    "scale it, or choose another feature kind",
                )));
            }
            let negated = image.as_slice().iter().map(|s| -s).collect();
            Ok(find_ridges(
                (dims, negated, FINEST),
                automatic,
                options,
                levels,
                notes,
            ))
        }
        Kind::Edges => {
            let mut smoothed = samples();
            gaussian::smooth(dims, &mut smoothed, [options.scale.unwrap_or(1.0); D]);
            let steepness = edges::prewitt(Volume {
                dims,
                samples: &smoothed,
            });
            drop(smoothed);
            Ok(find_ridges(
                (dims, steepness, 1.0),
                automatic,
                options,
                levels,
                notes,
            ))
        }
        Kind::Canny => Ok(find_canny(dims, samples(), options, levels, notes)),
        Kind::Paths => find_boundary(image, options, notes),
        Kind::Horizons | Kind::FaultsAndHorizons => {
            Ok(find_horizons(dims, samples(), options, levels, notes))
        }
        Kind::Faults => Ok(find_faults(dims, samples(), options, levels, notes)),
        Kind::Labels => find_labels(image, options, known, notes),
    }
}

/// Where ridges drown in noise they are sought on a smoother image, up to this scale (samples).
const COARSEST: f64 = 3.0;
/// The scale (samples) at which ridges are sought first.
const FINEST: f64 = 1.5;

/// Ridges of samples (dims, samples, finest scale); where all is not `known`, from that scale up as
/// smooth as noise asks, and above the `automatic` thresholds, unless the options give both.
fn find_ridges<const D: usize>(
    (dims, mut samples, scale): ([usize; D], Vec<f32>, f64),
    automatic: impl Fn(&Statistics) -> (f32, f32),
    options: &Options<D>,
    known: Option<Levels>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let levels = match known {
        Some(levels) => {
            gaussian::smooth(dims, &mut samples, [levels.scale; D]);
            levels
        }
        None => smooth_for_ridges(dims, &mut samples, scale, automatic, options, notes),
    };
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let candidates = ridges::ridges(smoothed, levels.scale, levels.low);
    Found {
        candidates: repair::repair(smoothed, candidates, levels.scale, levels.high),
        levels,
        mask: None,
        min_cells: 2.0,
        resolution: 0.9,
        confidence: None,
    }
}

/// Smooths samples so that ridges do not drown in noise (or as the options say), and finds the
/// thresholds of ridges there.
fn smooth_for_ridges<const D: usize>(
    dims: [usize; D],
    samples: &mut [f32],
    scale: f64,
    automatic: impl Fn(&Statistics) -> (f32, f32),
    options: &Options<D>,
    notes: &mut Vec<String>,
) -> Levels {
    let mut scale = options.scale.unwrap_or(scale);
    gaussian::smooth(dims, samples, [scale; D]);
    let measure = |samples: &[f32], scale| ridges::statistics(Volume { dims, samples }, scale);
    let mut statistics = measure(samples, scale);
    while options.scale.is_none() && statistics.drowned() && scale < COARSEST {
        let coarser = (1.25 * scale).min(COARSEST);
        gaussian::smooth(
            dims,
            samples,
            [(coarser * coarser - scale * scale).sqrt(); D],
        );
        scale = coarser;
        statistics = measure(samples, scale);
    }
    let (low, high) = options
        .threshold
        .map_or_else(|| automatic(&statistics), |t| (0.5 * t, t));
    let chosen = if options.threshold.is_some() {
        "given"
    } else {
        "chosen"
    };
    notes.push(format!(
        "ridges at scale {scale}: threshold {high:.4} ({chosen}; followed down to {low:.4}), noise \
         {:.4}, typical strength {:.4}",
        statistics.noise, statistics.typical
    ));
    Levels { scale, low, high }
}

/// Edges where the gradient is steepest.
fn find_canny<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    options: &Options<D>,
    known: Option<Levels>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let scale = known.map_or(options.scale.unwrap_or(1.0), |known| known.scale);
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let steepness = canny::steepness(smoothed);
    let noise = canny::above_noise::<D>(&steepness);
    let floor = match (known, options.threshold) {
        (Some(known), _) => known.low,
        (None, Some(t)) => 0.5 * t,
        // Where there is no even ground the thresholds are lower than noise would ask.
        (None, None) => 0.5 * noise[0],
    };
    let steep = Volume {
        dims,
        samples: &steepness,
    };
    let mut candidates = canny::edges(smoothed, steep, floor);
    let ([low, high], chosen) = match (known, options.threshold) {
        (Some(known), _) => ([known.low, known.high], "known"),
        (None, Some(t)) => ([0.5 * t, t], "given"),
        (None, None) => (canny::thresholds(noise, &candidates), "chosen"),
    };
    candidates.retain(|c| c.strength >= low);
    notes.push(format!(
        "steepest places at scale {scale}: threshold {high:.4} ({chosen}; followed down to {low:.4}), \
         noise up to {:.4} a sample",
        noise[1]
    ));
    Found {
        candidates,
        levels: Levels { scale, low, high },
        mask: None,
        min_cells: 2.0,
        resolution: 0.9,
        confidence: None,
    }
}

/// Width (samples) of the Gaussian that makes a smooth curve of a path from sample to sample.
const PATH_SCALE: f64 = 1.5;

/// The boundary of an object, by random shortest paths.
fn find_boundary<const D: usize>(
    image: &Image<D>,
    options: &Options<D>,
    notes: &mut Vec<String>,
) -> Result<Found<D>> {
    let dims = image.dims();
    let scale = options.scale.unwrap_or(1.0);
    let mut samples = image.as_slice().to_vec();
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let seeds = &options.seeds;
    let found = paths::enhance(smoothed, &image.geometry, seeds)?;
    let mut candidates = Vec::new();
    let drawn = format!(
        "shortest paths at scale {scale} from {} sources in the object to {} sinks around it",
        seeds.sources, seeds.sinks
    );
    if let Some(path) = &found.boundary {
        let mut values = paths::surrounded(smoothed, path);
        notes.push(format!(
            "{drawn}: a boundary of {} samples round {}",
            path.len(),
            values.iter().filter(|v| **v == 1.0).count()
        ));
        gaussian::smooth(dims, &mut values, [PATH_SCALE; D]);
        let smoothed = Volume {
            dims,
            samples: &values,
        };
        let steepness = canny::steepness(smoothed);
        let steep = Volume {
            dims,
            samples: &steepness,
        };
        candidates = canny::edges(smoothed, steep, LEAST_STEP);
    } else {
        notes.push(format!("{drawn}: no path goes round the object"));
    }
    Ok(Found {
        candidates,
        levels: Levels {
            scale,
            low: LEAST_STEP,
            high: LEAST_STEP,
        },
        mask: None,
        min_cells: 2.0,
        resolution: 0.9,
        confidence: Some(found.confidence),
    })
}

/// A step from 0 to 1, smoothed over [`PATH_SCALE`], is 0.26 steep.
const LEAST_STEP: f32 = 0.1;

/// Crests and troughs of seismic amplitude.
fn find_horizons<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    options: &Options<D>,
    known: Option<Levels>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let scale = options.scale.unwrap_or(1.0);
    let window = options.smoothing.unwrap_or(4.0);
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let normals = tensor::Normals::new(smoothed, window);
    let rms = horizons::root_mean_square(&samples);
    let (low, high) = match (known, options.threshold) {
        (Some(known), _) => (known.low, known.high),
        (None, Some(t)) => (0.5 * t, t),
        (None, None) => (0.8 * rms, 1.3 * rms),
    };
    let chosen = if options.threshold.is_some() {
        "given"
    } else {
        "1.3 times the rms"
    };
    notes.push(format!(
        "crests and troughs at scale {scale}, normals averaged over {window}: threshold {high:.4} \
         ({chosen}; followed down to {low:.4})"
    ));
    Found {
        candidates: horizons::horizons(smoothed, &normals, low),
        levels: Levels { scale, low, high },
        mask: None,
        // Short pieces of reflectors are everywhere, and worth no cells.
        min_cells: if D == 3 { 16.0 } else { 8.0 },
        // Reflectors lie one above the other everywhere: leave room for a layer of atoms between.
        resolution: 1.5,
        confidence: None,
    }
}

/// Faults whose normals agree more than this (cosine) with the layers' are layers themselves.
const ALONG_LAYERS: f32 = 0.77;

/// Faults of seismic amplitude.
fn find_faults<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    options: &Options<D>,
    known: Option<Levels>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let scale = options.scale.unwrap_or(1.0);
    let window = options.smoothing.unwrap_or(12.0);
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let layers = tensor::Normals::new(smoothed, window);
    let likelihood = faults::likelihood(smoothed, &layers);
    drop(samples);
    notes.push(format!(
        "faults: least semblance along layers over steep planes, at scale {scale}, normals averaged \
         over {window}"
    ));
    let of_ridges = Options {
        scale: None,
        ..options.clone()
    };
    let scene = (dims, likelihood, FINEST);
    let mut found = find_ridges(scene, faults::thresholds, &of_ridges, known, notes);
    found
        .candidates
        .retain(|c| dot(c.normal, layers.at(c.position)).abs() < ALONG_LAYERS);
    found.min_cells = 6.0;
    found
}

/// Interfaces between labels, or the middle of a thin mask.
fn find_labels<const D: usize>(
    image: &Image<D>,
    options: &Options<D>,
    known: Option<&Settled>,
    notes: &mut Vec<String>,
) -> Result<Found<D>> {
    let dims = image.dims();
    let volume = Volume {
        dims,
        samples: image.as_slice(),
    };
    let Some(values) = labels::values(volume.samples) else {
        return Err(Error::Feature(cause(
            "feature 'labels'",
            format!(
                "the image has more than {} different values",
                labels::MOST_LABELS
            ),
            "choose ridges, edges or horizons, or merge labels",
        )));
    };
    let levels = known.map(Levels::from);
    let middle_of = |value: f32, scale: f64, notes: &mut Vec<String>| {
        let inside = |s: &f32| f32::from(u8::from(*s == value));
        let samples = volume.samples.iter().map(inside).collect();
        let mask = Some(value);
        Found {
            mask,
            ..find_ridges(
                (dims, samples, scale),
                Statistics::thresholds,
                options,
                levels,
                notes,
            )
        }
    };
    match (known, &values[..]) {
        (
            Some(Settled {
                mask: Some(value), ..
            }),
            _,
        ) => {
            return Ok(middle_of(*value, FINEST, notes));
        }
        (None, &[a, b]) => {
            let mask = labels::mask(volume, [a, b]);
            if mask.share < 0.25 && mask.thickness < labels::THIN {
                notes.push(format!(
                    "a mask {:.1} samples thick, {:.1} % of the volume: its middle is the feature",
                    mask.thickness,
                    100.0 * mask.share
                ));
                return Ok(middle_of(
                    mask.value,
                    (0.5 * mask.thickness).max(1.5),
                    notes,
                ));
            }
        }
        _ => {}
    }
    let scale = options.scale.unwrap_or(1.0);
    notes.push(format!(
        "interfaces between {} labels, smoothed over {scale}",
        values.len()
    ));
    Ok(Found {
        candidates: labels::interfaces(volume, &values, scale),
        levels: Levels {
            scale,
            low: 0.0,
            high: 1.0,
        },
        mask: None,
        min_cells: 2.0,
        resolution: 0.9,
        confidence: None,
    })
}
