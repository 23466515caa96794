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
//! - [`paths`]: edges of an object by random shortest paths
//! - [`marching`](mod@marching): how long a front takes to reach every sample
//! - [`horizons`](mod@horizons): crests and troughs of seismic amplitude
//! - [`edges`]: how steep an image is
//! - [`canny`]: where an image is steepest
//! - [`faults`]: where layers do not continue
//! - [`scan`]: steep planes through every sample
//! - [`labels`]: interfaces between labels, thin masks
//! - [`repair`](mod@repair): ridges through crossings and up to the box's sides
//! - [`grid`]: candidates by sample
//! - [`settled`](mod@settled): a part of an image, treated as the whole was
//! - [`sheets`](mod@sheets): hysteresis, sheets too near one another, crumbs
//! - [`potential`](mod@potential): b(x)
//! - `find`: the candidates of each kind of feature

pub mod auto;
pub mod canny;
pub mod crossing;
pub mod edges;
pub mod faults;
mod find;
pub mod gaussian;
pub mod grid;
pub mod horizons;
pub mod labels;
pub mod marching;
pub mod paths;
pub mod potential;
pub mod repair;
pub mod ridges;
pub mod rows;
pub mod scan;
pub mod settled;
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
use serde::{Deserialize, Serialize};
use sheets::Open;
use std::fmt;
use std::str::FromStr;
use volume::Volume;

pub use settled::{Settled, detect_part};

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
    /// For each of them whether it lies on a horizon, which is no barrier to flow.
    pub on_horizon: Vec<bool>,
    /// The image potential b(x) in [-1, 0]: every feature a valley of depth 1 and width `sigma`.
    pub potential: Field<D>,
    /// Width of the valleys in lattice units: d_min / 4.
    pub sigma: f64,
    /// One or more plain lines: what was picked and why, threshold, counts.
    pub notes: Vec<String>,
    /// The scales and thresholds that were settled on, one for each kind of feature followed.
    pub settled: Vec<Settled>,
    /// Of [`Kind::Paths`]: the share of the paths that pass each sample.
    pub confidence: Option<Field<D>>,
}

/// What a feature of the image is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Picked by what the image looks like; the report says what was picked
    Auto,
    /// Bright sheets: fault images, fractures, membranes
    Ridges,
    /// Dark sheets
    Valleys,
    /// Steps of brightness
    Edges,
    /// Steps of brightness, by non-maximum suppression and hysteresis
    Canny,
    /// The boundary of an object, by random shortest paths (2-D; needs a point of the object)
    Paths,
    /// Peaks and troughs of seismic amplitude along the bedding's normal
    Horizons,
    /// Where the layers of seismic amplitude do not continue
    Faults,
    /// Both, each with its weight
    #[cfg_attr(feature = "cli", value(name = "faults+horizons"))]
    #[serde(rename = "faults+horizons")]
    FaultsAndHorizons,
    /// Interfaces between labels, or the rim of a mask
    Labels,
    /// The image is b(x) already: -1 on features, 0 elsewhere
    Potential,
}

/// Names on the command line.
const NAMES: [(Kind, &str); 11] = [
    (Kind::Auto, "auto"),
    (Kind::Ridges, "ridges"),
    (Kind::Valleys, "valleys"),
    (Kind::Edges, "edges"),
    (Kind::Canny, "canny"),
    (Kind::Paths, "paths"),
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
#[derive(Debug, Clone, PartialEq)]
pub struct Options<const D: usize> {
    /// What a feature is.
    pub kind: Kind,
    /// Width (samples) of the Gaussian under which derivatives are taken; by kind if `None`.
    pub scale: Option<f64>,
    /// Width (samples) of the structure tensor's window; 4 (horizons) or 12 (faults) if `None`.
    pub smoothing: Option<f64>,
    /// Least strength of a feature, in units of the image; from the image itself if `None`.
    pub threshold: Option<f32>,
    /// Depths, in (0, 1], of the valleys of faults and of horizons where both are followed.
    pub weights: [f64; 2],
    /// What [`Kind::Paths`] knows of the object.
    pub seeds: paths::Seeds<D>,
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
            seeds: paths::Seeds::default(),
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
///
/// Where traces are [missing](Image::missing) there are no features, nor next to them.
pub fn detect<const D: usize>(image: &Image<D>, options: &Options<D>) -> Result<Features<D>> {
    refuse_too_many(image.dims(), options.kind)?;
    let continued = image.continued();
    let image = continued.as_ref().unwrap_or(image);
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
        return follow(image, kind, options, None, notes);
    }
    // A threshold is one of amplitude, and the faults' own is found from the image.
    let of_faults = Options {
        threshold: None,
        ..options.clone()
    };
    let faults = follow(image, Kind::Faults, &of_faults, None, notes)?;
    let horizons = follow(image, Kind::Horizons, options, None, Vec::new())?;
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
    first.on_horizon.extend(second.on_horizon);
    let last_axis_first = |p: &(FeaturePoint<D>, bool), q: &(FeaturePoint<D>, bool)| {
        let (p, q) = (p.0.position.iter().rev(), q.0.position.iter().rev());
        p.zip(q)
            .map(|(a, b)| a.total_cmp(b))
            .find(|order| order.is_ne())
            .unwrap_or(std::cmp::Ordering::Equal)
    };
    let mut points: Vec<_> = first.points.into_iter().zip(first.on_horizon).collect();
    points.sort_by(last_axis_first);
    (first.points, first.on_horizon) = points.into_iter().unzip();
    first.notes.extend(second.notes);
    first.settled.extend(second.settled);
    first
}

/// No features.
pub(crate) fn empty<const D: usize>(dims: [usize; D], options: &Options<D>) -> Features<D> {
    Features {
        points: Vec::new(),
        on_horizon: Vec::new(),
        potential: Field {
            dims,
            step: options.step,
            samples: vec![0.0; dims.iter().product()],
        },
        sigma: options.d_min / 4.0,
        notes: Vec::new(),
        settled: Vec::new(),
        confidence: None,
    }
}

/// Finds the features of one kind and their potential; of a part of an image, by what is known of
/// the whole.
fn follow<const D: usize>(
    image: &Image<D>,
    kind: Kind,
    options: &Options<D>,
    known: Option<(&Settled, &Open<D>)>,
    mut notes: Vec<String>,
) -> Result<Features<D>> {
    let dims = image.dims();
    let mut found = find::find(image, kind, options, known.map(|(s, _)| s), &mut notes)?;
    found.drop_near_missing(image, kind, &mut notes);
    let side = |k: usize| (dims[k] as f64 - 1.0) * options.step[k];
    let section = (0..D)
        .map(|k| (1..D).map(|l| side((k + l) % D)).product())
        .fold(0.0, f64::max);
    // In a small image a large sheet is smaller.
    let min_area = (found.min_cells * options.d_min.powi(D as i32 - 1)).min(0.25 * section);
    let rules = sheets::Rules {
        high: found.levels.high,
        resolution: found.resolution * options.d_min,
        min_area: known.map_or(min_area, |(settled, _)| settled.min_area),
        open: known.map_or([[false; 2]; D], |(_, open)| *open),
    };
    let sheets = sheets::sheets(dims, &found.candidates, options.step, &rules);
    let settled = Settled {
        kind,
        scale: found.levels.scale,
        low: found.levels.low,
        high: found.levels.high,
        min_area: rules.min_area,
        mask: found.mask,
    };
    let confidence = found.confidence.map(|samples| Field {
        dims,
        step: options.step,
        samples,
    });
    drop(found.candidates);
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
            "NO FEATURE ({kind}) was found, so the mesh follows none: try another kind of \
             feature or a lower threshold"
        ));
    }
    let sigma = options.d_min / 4.0;
    let potential = if kind == Kind::Potential {
        let mut samples = image.as_slice().to_vec();
        for (row, missing) in samples.chunks_mut(dims[0].max(1)).zip(&image.missing) {
            if *missing {
                row.fill(0.0);
            }
        }
        Field {
            dims,
            step: options.step,
            samples,
        }
    } else {
        potential::potential(&sheets.points, &sheets.rim, dims, options.step, sigma)
    };
    Ok(Features {
        on_horizon: vec![kind == Kind::Horizons; sheets.points.len()],
        points: sheets.points,
        potential,
        sigma,
        notes,
        settled: vec![settled],
        confidence,
    })
}

/// Most samples of an image whose features are sought: candidates know theirs by 32 bits.
const MOST_SAMPLES: u128 = u32::MAX as u128;

/// Refuses an image with more samples than can be numbered. [`Kind::Paths`] numbers them twice.
fn refuse_too_many<const D: usize>(dims: [usize; D], kind: Kind) -> Result<()> {
    let samples = dims
        .iter()
        .fold(1u128, |all, &n| all.saturating_mul(n as u128));
    let most = match kind {
        Kind::Paths => MOST_SAMPLES / 2,
        _ => MOST_SAMPLES,
    };
    if samples <= most && dims.iter().all(|&n| n <= i32::MAX as usize) {
        return Ok(());
    }
    Err(Error::Image(cause(
        "image",
        format!("has {samples} samples ({dims:?}); features can be found among {most}"),
        "mesh a part of it, or take every other sample",
    )))
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
