//! Image -> features as points at sub-sample positions -> potential b(x).
//!
//! - [`gaussian`]: smoothing of volumes
//! - [`volume`]: finite differences
//! - [`rows`]: second differences of whole rows at once
//! - [`symmetric`]: eigenvectors of Hessians and structure tensors
//! - [`tensor`]: normals of layers
//! - [`auto`]: which kind of feature an image has
//! - [`crossing`]: where a sheet crosses the columns of samples
//! - [`ridges`](mod@ridges): ridges (and, negated, valleys)
//! - [`horizons`](mod@horizons): crests and troughs of seismic amplitude
//! - [`edges`]: how steep an image is
//! - [`faults`]: where layers do not continue
//! - [`labels`]: interfaces between labels, thin masks
//! - [`repair`](mod@repair): ridges through crossings and up to the box's sides
//! - [`grid`]: candidates by sample
//! - [`sheets`](mod@sheets): hysteresis, sheets too near one another, crumbs
//! - [`potential`](mod@potential): b(x)

pub mod auto;
pub mod crossing;
pub mod edges;
pub mod faults;
pub mod gaussian;
pub mod grid;
pub mod horizons;
pub mod labels;
pub mod potential;
pub mod repair;
pub mod ridges;
pub mod rows;
pub mod sheets;
pub mod symmetric;
pub mod tensor;
pub mod volume;

#[cfg(test)]
mod scenes;
#[cfg(test)]
mod tests;

use crate::error::{Error, Result, cause};
use crate::image::{Field, Image};
use crossing::Candidate;
use std::fmt;
use std::str::FromStr;
use volume::Volume;

/// One detected point of a feature (fault, horizon, wall) at its sub-sample position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeaturePoint<const D: usize> {
    /// Position in lattice space.
    pub position: [f32; D],
    /// Unit normal of the feature there (its sign means nothing).
    pub normal: [f32; D],
    /// Feature strength, in units of the feature image.
    pub strength: f32,
}

/// What feature detection hands to the rest of the pipeline.
#[derive(Debug, Clone)]
pub struct Features<const D: usize> {
    /// The features as points, in a fixed order (the order of samples).
    pub points: Vec<FeaturePoint<D>>,
    /// The image potential b(x) in [-1, 0]: every feature a valley of depth 1 and width `sigma`.
    pub potential: Field<D>,
    /// Width of the valleys in lattice units: d_min / 4.
    pub sigma: f64,
    /// One or more plain lines: what was picked and why, threshold, counts.
    pub notes: Vec<String>,
}

/// What a feature of the image is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Decided by what the image looks like.
    Auto,
    /// Sheets of high values: faults in a fault image, bright walls.
    Ridges,
    /// Sheets of low values.
    Valleys,
    /// Steps between low and high values.
    Edges,
    /// Crests and troughs of seismic amplitude.
    Horizons,
    /// Where the layers of seismic amplitude do not continue.
    Faults,
    /// Both, each with its weight.
    FaultsAndHorizons,
    /// Interfaces between labels; thin masks are ridges.
    Labels,
    /// The image is b(x) itself.
    Potential,
}

/// Names on the command line.
const NAMES: [(Kind, &str); 9] = [
    (Kind::Auto, "auto"),
    (Kind::Ridges, "ridges"),
    (Kind::Valleys, "valleys"),
    (Kind::Edges, "edges"),
    (Kind::Horizons, "horizons"),
    (Kind::Faults, "faults"),
    (Kind::FaultsAndHorizons, "faults+horizons"),
    (Kind::Labels, "labels"),
    (Kind::Potential, "potential"),
];

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(
            NAMES
                .iter()
                .find(|(kind, _)| kind == self)
                .map_or("", |(_, name)| name),
        )
    }
}

impl FromStr for Kind {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        let names = || NAMES.map(|(_, name)| name).join(", ");
        NAMES
            .iter()
            .find(|(_, name)| *name == s)
            .map(|(kind, _)| *kind)
            .ok_or_else(|| {
                Error::Feature(cause(
                    format!("feature '{s}'"),
                    "is not known",
                    format!("choose one of {}", names()),
                ))
            })
    }
}

/// How features are detected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options<const D: usize> {
    /// What a feature is.
    pub kind: Kind,
    /// Width (samples) of the Gaussian under which derivatives are taken; by kind if `None`.
    pub scale: Option<f64>,
    /// Width (samples) of the structure tensor's window (horizons, faults); 4 if `None`.
    pub smoothing: Option<f64>,
    /// Least strength of a feature, in units of the image; from the image itself if `None`.
    pub threshold: Option<f32>,
    /// Depths, in (0, 1], of the valleys of faults and of horizons where both are followed.
    pub weights: [f64; 2],
    /// The least nominal distance between atoms, in lattice units: what the lattice resolves.
    pub d_min: f64,
    /// Lattice-space distance between samples.
    pub step: [f64; D],
}

impl<const D: usize> Default for Options<D> {
    fn default() -> Self {
        Self {
            kind: Kind::Auto,
            scale: None,
            smoothing: None,
            threshold: None,
            weights: [1.0; 2],
            d_min: 8.0,
            step: [1.0; D],
        }
    }
}

/// Finds the features of an image and their potential.
///
/// # Errors
/// [`Error::Feature`] for impossible options, [`Error::Image`] for an image that has NaN or infinite
/// samples, is constant, or is not what `options.kind` says.
pub fn detect<const D: usize>(image: &Image<D>, options: &Options<D>) -> Result<Features<D>> {
    check(image, options)?;
    let mut notes = Vec::new();
    let kind = match options.kind {
        Kind::Auto => {
            let (kind, why) = auto::pick(Volume {
                dims: image.dims(),
                samples: image.as_slice(),
            });
            notes.push(format!("features: {kind} ({why})"));
            kind
        }
        kind => kind,
    };
    if kind != Kind::FaultsAndHorizons {
        return follow(image, kind, options, notes);
    }
    // A threshold is one of amplitude, and the faults' own is found from the image.
    let of_faults = Options {
        threshold: None,
        ..*options
    };
    let faults = follow(image, Kind::Faults, &of_faults, notes)?;
    let horizons = follow(image, Kind::Horizons, options, Vec::new())?;
    Ok(both(faults, horizons, options.weights))
}

/// Features of two kinds as one; their valleys are as deep as the weights say.
fn both<const D: usize>(
    mut first: Features<D>,
    second: Features<D>,
    weights: [f64; 2],
) -> Features<D> {
    let [a, b] = weights.map(|w| w as f32);
    let samples = first.potential.samples.iter_mut();
    for (deepest, other) in samples.zip(&second.potential.samples) {
        *deepest = (a * *deepest).min(b * other);
    }
    first.points.extend(second.points);
    let last_axis_first = |p: &FeaturePoint<D>, q: &FeaturePoint<D>| {
        let (p, q) = (p.position.iter().rev(), q.position.iter().rev());
        p.zip(q)
            .map(|(a, b)| a.total_cmp(b))
            .find(|order| order.is_ne())
            .unwrap_or(std::cmp::Ordering::Equal)
    };
    first.points.sort_by(last_axis_first);
    first.notes.extend(second.notes);
    first
}

/// Finds the features of one kind and their potential.
fn follow<const D: usize>(
    image: &Image<D>,
    kind: Kind,
    options: &Options<D>,
    mut notes: Vec<String>,
) -> Result<Features<D>> {
    let dims = image.dims();
    let found = find(image, kind, options, &mut notes)?;
    let side = |k: usize| (dims[k] as f64 - 1.0) * options.step[k];
    let section = (0..D)
        .map(|k| (1..D).map(|l| side((k + l) % D)).product())
        .fold(0.0, f64::max);
    let rules = sheets::Rules {
        high: found.high,
        resolution: found.resolution * options.d_min,
        // In a small image a large sheet is smaller.
        min_area: (found.min_cells * options.d_min.powi(D as i32 - 1)).min(0.25 * section),
    };
    let sheets = sheets::sheets(dims, &found.candidates, options.step, &rules);
    drop(found);
    notes.push(format!(
        "{} feature points in {} sheets; dropped {} nearer than {:.1} to a stronger parallel sheet \
         and {} weak or in sheets smaller than {:.0}",
        sheets.points.len(),
        sheets.sheets,
        sheets.too_near,
        rules.resolution,
        sheets.crumbs,
        rules.min_area,
    ));
    if sheets.points.is_empty() {
        notes.push(format!(
            "NO FEATURE ({kind}) was found, so the mesh follows none: try another --feature or a \
             lower --threshold"
        ));
    }
    let sigma = options.d_min / 4.0;
    let potential = if kind == Kind::Potential {
        Field {
            dims,
            step: options.step,
            samples: image.as_slice().to_vec(),
        }
    } else {
        potential::potential(&sheets.points, &sheets.rim, dims, options.step, sigma)
    };
    Ok(Features {
        points: sheets.points,
        potential,
        sigma,
        notes,
    })
}

/// Candidates, and the strength that a sheet must reach somewhere.
struct Found<const D: usize> {
    candidates: Vec<Candidate<D>>,
    high: f32,
    /// Least area of a sheet, in squares of the least distance (in 2-D: length, in distances).
    min_cells: f64,
    /// Parallel sheets nearer than this, in units of the least distance, exclude one another.
    resolution: f64,
}

/// Finds the candidates of one kind of feature; notes say how.
fn find<const D: usize>(
    image: &Image<D>,
    kind: Kind,
    options: &Options<D>,
    notes: &mut Vec<String>,
) -> Result<Found<D>> {
    let dims = image.dims();
    let samples = || image.as_slice().to_vec();
    match kind {
        Kind::Auto | Kind::Ridges => Ok(find_ridges(dims, samples(), FINEST, options, notes)),
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
            Ok(find_ridges(dims, negated, FINEST, options, notes))
        }
        Kind::Edges => {
            let mut smoothed = samples();
            gaussian::smooth(dims, &mut smoothed, [options.scale.unwrap_or(1.0); D]);
            let steepness = edges::prewitt(Volume {
                dims,
                samples: &smoothed,
            });
            drop(smoothed);
            Ok(find_ridges(dims, steepness, 1.0, options, notes))
        }
        Kind::Horizons | Kind::FaultsAndHorizons => {
            Ok(find_horizons(dims, samples(), options, notes))
        }
        Kind::Faults => Ok(find_faults(dims, samples(), options, notes)),
        Kind::Labels => find_labels(image, options, notes),
    }
}

/// Where ridges drown in noise they are sought on a smoother image, up to this scale (samples).
const COARSEST: f64 = 3.0;
/// The scale (samples) at which ridges are sought first.
const FINEST: f64 = 1.5;

/// Ridges of samples; from `scale` up as smooth as noise asks, unless the options give a scale.
fn find_ridges<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    scale: f64,
    options: &Options<D>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let mut scale = options.scale.unwrap_or(scale);
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let measure = |samples: &[f32], scale| ridges::statistics(Volume { dims, samples }, scale);
    let mut statistics = measure(&samples, scale);
    while options.scale.is_none() && statistics.drowned() && scale < COARSEST {
        let coarser = (1.25 * scale).min(COARSEST);
        gaussian::smooth(
            dims,
            &mut samples,
            [(coarser * coarser - scale * scale).sqrt(); D],
        );
        scale = coarser;
        statistics = measure(&samples, scale);
    }
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let (low, high) = options
        .threshold
        .map_or_else(|| statistics.thresholds(), |t| (0.5 * t, t));
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
    let candidates = ridges::ridges(smoothed, scale, low);
    Found {
        candidates: repair::repair(smoothed, candidates, scale, high),
        high,
        min_cells: 2.0,
        resolution: 0.9,
    }
}

/// Crests and troughs of seismic amplitude.
fn find_horizons<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    options: &Options<D>,
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
    let (low, high) = options
        .threshold
        .map_or((0.8 * rms, 1.3 * rms), |t| (0.5 * t, t));
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
        high,
        // Short pieces of reflectors are everywhere, and worth no cells.
        min_cells: 16.0,
        // Reflectors lie one above the other everywhere: leave room for a layer of atoms between.
        resolution: 1.5,
    }
}

/// Faults whose normals agree more than this (cosine) with the layers' are layers themselves.
const ALONG_LAYERS: f32 = 0.85;

/// Faults of seismic amplitude.
fn find_faults<const D: usize>(
    dims: [usize; D],
    mut samples: Vec<f32>,
    options: &Options<D>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let scale = options.scale.unwrap_or(1.0);
    let window = options.smoothing.unwrap_or(4.0);
    gaussian::smooth(dims, &mut samples, [scale; D]);
    let smoothed = Volume {
        dims,
        samples: &samples,
    };
    let layers = tensor::Normals::new(smoothed, window);
    let discontinuity = faults::discontinuity(smoothed, &layers, window);
    drop(samples);
    notes.push(format!(
        "faults: one less the semblance along layers, at scale {scale}, normals averaged over {window}"
    ));
    let of_ridges = Options {
        scale: None,
        ..*options
    };
    let mut found = find_ridges(dims, discontinuity, FINEST, &of_ridges, notes);
    found
        .candidates
        .retain(|c| crossing::dot(c.normal, layers.at(c.position)).abs() < ALONG_LAYERS);
    found.min_cells = 6.0;
    found
}

/// Interfaces between labels, or the middle of a thin mask.
fn find_labels<const D: usize>(
    image: &Image<D>,
    options: &Options<D>,
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
    if let [a, b] = values[..] {
        let mask = labels::mask(volume, [a, b]);
        if mask.share < 0.25 && mask.thickness < labels::THIN {
            notes.push(format!(
                "a mask {:.1} samples thick, {:.1} % of the volume: its middle is the feature",
                mask.thickness,
                100.0 * mask.share
            ));
            let inside = |s: &f32| f32::from(u8::from(*s == mask.value));
            let samples = volume.samples.iter().map(inside).collect();
            let scale = (0.5 * mask.thickness).max(1.5);
            return Ok(find_ridges(dims, samples, scale, options, notes));
        }
    }
    let scale = options.scale.unwrap_or(1.0);
    notes.push(format!(
        "interfaces between {} labels, smoothed over {scale}",
        values.len()
    ));
    Ok(Found {
        candidates: labels::interfaces(volume, &values, scale),
        high: 1.0,
        min_cells: 2.0,
        resolution: 0.9,
    })
}

/// Refuses impossible options and images.
fn check<const D: usize>(image: &Image<D>, options: &Options<D>) -> Result<()> {
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let fail =
        |what: String, remedy: &str| Err(Error::Feature(cause("feature detection", what, remedy)));
    if !positive(options.d_min) {
        return fail(
            format!("distance {} is not positive", options.d_min),
            "give a few samples",
        );
    }
    if !options.step.iter().all(|&h| positive(h)) {
        return fail(
            format!("step {:?} is not positive", options.step),
            "give positive steps",
        );
    }
    for (name, value) in [("scale", options.scale), ("smoothing", options.smoothing)] {
        if let Some(value) = value
            && !(0.5..=100.0).contains(&value)
        {
            return fail(
                format!("{name} {value} is not in 0.5 .. 100"),
                "give samples, such as 1.5",
            );
        }
    }
    if !options.weights.iter().all(|w| *w > 0.0 && *w <= 1.0) {
        return fail(
            format!(
                "weights {:?} are not above 0 and at most 1",
                options.weights
            ),
            "give depths of valleys such as 1 and 0.5",
        );
    }
    if options.threshold.is_some_and(|t| !t.is_finite()) {
        return fail(
            "the threshold is not a finite number".into(),
            "leave it out to have it chosen",
        );
    }
    let samples = image.as_slice();
    if let Some(i) = first_not_finite(samples) {
        let volume = Volume {
            dims: image.dims(),
            samples,
        };
        return Err(Error::Image(cause(
            format!("image sample {:?}", volume.coordinates(i)),
            format!("is {}", samples[i]),
            "fill missing samples before meshing",
        )));
    }
    if samples.iter().all(|s| *s == samples[0]) {
        return Err(Error::Image(cause(
            "image",
            "is constant, so it has no features",
            "check that the right file and data type were read",
        )));
    }
    Ok(())
}

/// The first sample that is NaN or infinite.
fn first_not_finite(samples: &[f32]) -> Option<usize> {
    // Without a way out of the inner loop it runs on many samples at once.
    let broken = |chunk: &[f32]| !chunk.iter().fold(true, |all, s| all & s.is_finite());
    let chunk = samples.chunks(4096).position(broken)? * 4096;
    let within = samples[chunk..].iter().position(|s| !s.is_finite())?;
    Some(chunk + within)
}
