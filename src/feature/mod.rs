//! Image -> features as points at sub-sample positions -> potential b(x).
//!
//! [`detect`] asks the detector of the kind that is sought for candidates, the points at which columns
//! of samples cross a feature; makes sheets of them, of which the strong, the large and those that a
//! lattice can tell apart are kept; and digs a valley of b(x) along each.
//!
//! What is asked and what comes of it:
//! - `kind`: kinds of features and their names
//! - `detection`: how features are asked for, and what is refused
//! - `outcome`: what was found of each kind, and how credible it is
//! - `settled`: the scales and thresholds of a whole image, for a part of it
//!
//! Finding, one file a kind:
//! - `detectors`: their trait and table; `auto`, `canny`, `edges`, `faults`, `faults_and_horizons`,
//!   `horizons`, `labels`, `paths`, `potential`, `ridges` (and valleys)
//!
//! What detectors share:
//! - `volume`: samples in memory and their finite differences
//! - `windows`: samples some layers at a time, of images that may be larger than memory
//! - `gaussian`: smoothing
//! - `rows`: second differences of whole rows at once
//! - `symmetric`: eigenvectors of Hessians and structure tensors
//! - `tensor`: normals of layers
//! - `depth`: how deep samples lie inside a mask
//! - `components`: connected parts of labels
//! - `labelled`: which label is where, between samples too
//! - `steepness`: magnitudes of gradients
//! - `steepest`: where they are largest
//! - `lifted`: ridges at all orientations, where sheets cross, branch or run close
//! - `corners`: of edges in the plane, where their sides cross
//! - `crossing`: candidates: where a sheet crosses the columns of samples
//! - `ridges`: ridges of a volume
//!
//! From candidates to the potential:
//! - `by_sample`: candidates by the sample they belong to
//! - `quadric`: a sheet near a place
//! - `repair`: ridges up to the box's sides
//! - `slab`: candidates of some layers, where ranks share them
//! - `sheets`: hysteresis, sheets too near one another, crumbs
//! - `lines`: where sheets cross, branch and end
//! - `gaps`: how fine a lattice must be between sheets that run close
//! - `potential`: b(x)
//! - `share`: points, where ranks share them

pub(crate) mod by_sample;
pub(crate) mod components;
pub(crate) mod corners;
pub(crate) mod crossing;
pub(crate) mod depth;
mod detection;
pub(crate) mod detectors;
mod doubt;
pub(crate) mod gaps;
pub(crate) mod gaussian;
mod kind;
pub(crate) mod labelled;
pub(crate) mod lifted;
mod lines;
mod outcome;
pub(crate) mod potential;
pub(crate) mod quadric;
pub(crate) mod repair;
pub(crate) mod ridges;
pub(crate) mod rows;
pub(crate) mod settled;
mod share;
pub(crate) mod sheets;
mod slab;
pub(crate) mod steepest;
pub(crate) mod steepness;
pub(crate) mod symmetric;
pub(crate) mod tensor;
pub(crate) mod volume;
pub(crate) mod windows;

#[cfg(test)]
pub(crate) mod scenes;
#[cfg(test)]
mod tests;

use crate::error::Result;
use crate::image::{Field, Image, LiveMask, Source, Sparse};
use crate::observer::{Patience, Stage};
use crate::ranks::{Alone, Group, Ranks};
use detectors::auto::Known;
use detectors::{Detector, Scene, labels};
use potential::Valleys;
use sheets::{FoundSheets, Open};
use std::borrow::Cow;
use volume::Volume;
use windows::Samples;

pub use detection::Detection;
pub(crate) use detection::fills_gaps;
pub use detectors::paths::PathSeeds;
pub use doubt::Doubt;
pub use kind::FeatureKind;
pub use labelled::{LabelWish, Labelled};
pub use lines::{FeatureLine, LineKind, SHORTEST, lines};
pub use outcome::{KindOutcome, LEAST_DIP, MissingData};
pub use settled::Settled;
pub(crate) use share::NearPoints;
pub use share::OfAll;
pub use sheets::LeftOut;

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
    /// For each of them the number of the sheet that it is part of, from 1.
    pub sheet: Vec<u32>,
    /// For each of them whether it lies on a horizon, which is no barrier to flow.
    pub on_horizon: Vec<bool>,
    /// The image potential b(x) in [-1, 0]: every feature a valley of depth 1 and width `sigma`.
    pub potential: Sparse<D>,
    /// For each of them the distance that atoms may have there, where it was asked for by gaps.
    pub spacing: Option<Vec<f32>>,
    /// How many points all ranks have, where each has a share of them.
    pub in_shares: Option<OfAll>,
    /// Width of the widest valleys in lattice units: a quarter of the distance between atoms.
    pub sigma: f64,
    /// What was found of each kind of feature.
    pub outcomes: Vec<KindOutcome>,
    /// The samples that hold no data, if there are any.
    pub missing: Option<MissingData>,
    /// One or more plain lines: what was picked and why, threshold, counts.
    pub notes: Vec<String>,
    /// The scales and thresholds that were settled on, one for each kind of feature followed.
    pub settled: Vec<Settled>,
    /// Of [`FeatureKind::Labels`], unless they are a thin mask: which label is where.
    pub labels: Option<Labelled<D>>,
    /// Of [`FeatureKind::Paths`]: the share of the paths that pass each sample.
    pub confidence: Option<Field<D>>,
    /// What the image leaves open, where the kind of feature was chosen by it.
    pub doubt: Option<Doubt>,
}

impl<const D: usize> Features<D> {
    /// No features in an image of `dims` samples.
    pub fn none(dims: [usize; D], asked: &Detection<D>) -> Self {
        Self {
            points: Vec::new(),
            sheet: Vec::new(),
            on_horizon: Vec::new(),
            potential: Sparse::zero(dims, asked.step),
            spacing: asked.gaps().map(|_| Vec::new()),
            in_shares: None,
            sigma: asked.d_max() / 4.0,
            outcomes: Vec::new(),
            missing: None,
            notes: Vec::new(),
            settled: Vec::new(),
            labels: None,
            confidence: None,
            doubt: None,
        }
    }
}

/// Finds the features of an image and their potential. Where samples hold no data (see [`Image::marked`]),
/// small gaps are bridged, and there are no features in larger ones.
///
/// The edge of a disc:
///
/// ```
/// use atomesh::feature::{self, Detection, FeatureKind};
/// use atomesh::image::{Geometry, Image};
///
/// let from_centre = |x: f64, y: f64| (x - 30.0).hypot(y - 25.0);
/// let outside = |i: usize| from_centre((i % 60) as f64, (i / 60) as f64) - 15.0;
/// let disc = (0..60 * 50).map(|i| -outside(i).tanh() as f32);
/// let image = Image::new([60, 50], disc.collect(), Geometry::default());
///
/// let found = feature::detect(&image, &Detection::of(FeatureKind::Edges, 5.0))?;
/// assert!(found.points.len() > 50);
/// for point in &found.points {
///     let [x, y] = point.position.map(f64::from);
///     assert!((from_centre(x, y) - 15.0).abs() < 1.0);
/// }
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// [`Error::Feature`](crate::Error::Feature) for impossible wishes,
/// [`Error::Image`](crate::Error::Image) for an image that has NaN or infinite samples, is constant, or
/// is not what `asked.kind` says.
pub fn detect<const D: usize>(image: &Image<D>, asked: &Detection<D>) -> Result<Features<D>> {
    detect_held(image, asked, &Patience::endless())
}

/// The same as long as there is patience.
///
/// # Errors
/// Those of [`detect`], and [`Error::Interrupted`](crate::Error::Interrupted).
pub(crate) fn detect_while<const D: usize>(
    source: Source<'_, D>,
    asked: &Detection<D>,
    patience: &Patience<'_>,
) -> Result<Features<D>> {
    let layers = match source {
        Source::Held(image) => return detect_held(image, asked, patience),
        Source::InLayers(layers) => layers,
    };
    detection::refuse_impossible(asked)?;
    let (dims, parts) = (layers.dims(), detectors::of_asked(asked));
    for (detector, _) in parts.iter().flatten() {
        detection::refuse_more(dims, detection::most_samples(*detector))?;
    }
    let samples = Samples::in_layers(layers, 1.0);
    // Looked at whatever is asked for: what has gaps is searched in memory.
    let modality = asked.modality.or_of(layers.geometry());
    let choice = detectors::auto::choose_in_layers(&samples, modality, patience)?;
    let chosen = match (parts, choice) {
        (_, Known::Gaps) => None,
        (Some(parts), _) => Some((parts, None)),
        (None, Known::Fits(choice)) => Some(detectors::named(choice, asked)?),
        (None, Known::Unknown) => None,
    };
    match chosen {
        Some((parts, why)) if parts.iter().all(|(detector, _)| detector.in_layers()) => {
            follow_parts((source, None), parts, why, asked, patience)
        }
        // What needs the whole image has it.
        _ => {
            detection::refuse_more(dims, detection::MOST_HELD)?;
            detect_held(&layers.load()?, asked, patience)
        }
    }
}

/// The same of an image in memory.
fn detect_held<const D: usize>(
    image: &Image<D>,
    asked: &Detection<D>,
    patience: &Patience<'_>,
) -> Result<Features<D>> {
    let checked = detection::checked(image, asked)?;
    let image = &*checked.image;
    detection::refuse_constant(image)?;
    let (parts, why) = detectors::chosen(image, asked)?;
    let source = (Source::Held(image), checked.live.as_ref());
    let mut features = follow_parts(source, parts, why, asked, patience)?;
    features.notes.extend(checked.notes);
    features.missing = checked.missing;
    Ok(features)
}

/// Finds features by some detectors.
fn follow_parts<const D: usize>(
    (source, live): (Source<'_, D>, Option<&LiveMask<D>>),
    parts: Vec<detectors::Part<D>>,
    reason: Option<detectors::Reason>,
    asked: &Detection<D>,
    patience: &Patience<'_>,
) -> Result<Features<D>> {
    let count = parts.len() as f64;
    let follow_whole = |(number, (detector, asked)): (usize, (_, _))| {
        patience.part(number as f64 / count, (number + 1) as f64 / count);
        let scene = Scene {
            live,
            ..Scene::new(source, &asked, patience)
        };
        follow(&scene, detector, [[false; 2]; D])
    };
    let found: Result<Vec<_>> = parts.into_iter().enumerate().map(follow_whole).collect();
    let mut features = detectors::together(found?, source.dims(), asked)?;
    if let Some(reason) = reason {
        features.notes.insert(0, reason.note);
        features.doubt = reason.doubt;
    }
    Ok(features)
}

/// Finds the features of a part of an image as [`detect`] finds those of the whole, for which it
/// `settled` on scales and thresholds. `open` tells the sides beyond which the image goes on: sheets
/// that reach them are kept however small they are here.
///
/// # Errors
/// Those of [`detect`], but that a part may well be constant; and
/// [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
pub(crate) fn detect_part<const D: usize>(
    part: &Image<D>,
    asked: &Detection<D>,
    settled: &[Settled],
    open: &Open<D>,
    patience: &Patience<'_>,
) -> Result<Features<D>> {
    let checked = detection::checked(part, asked)?;
    let part = &*checked.image;
    if detection::is_constant(part) {
        return Ok(Features::none(part.dims(), asked));
    }
    let follow_part = |settled| {
        let scene = Scene {
            live: checked.live.as_ref(),
            ..Scene::of_part(part, asked, settled, patience)
        };
        follow(&scene, detectors::again(settled.kind)?, *open)
    };
    let found: Result<Vec<_>> = settled.iter().map(follow_part).collect();
    detectors::together(found?, part.dims(), asked)
}

/// The share of the work that is done once candidates are found, roughly, and once they are sheets.
const FOUND: f64 = 0.85;
const IN_SHEETS: f64 = 0.95;

/// A region is no use without its other side, even if that is nearer than atoms: interfaces between labels
/// exclude parallel ones nearer than this, in units of the least distance between atoms.
const OTHER_SIDE: f64 = 0.5;

/// Finds the features of one kind and their potential.
fn follow<const D: usize>(
    scene: &Scene<'_, D>,
    detector: &dyn Detector<D>,
    open: Open<D>,
) -> Result<Features<D>> {
    let (dims, asked, kind) = (scene.dims(), scene.asked, detector.kind());
    detection::refuse_more(dims, detection::most_samples(detector))?;
    let mut notes = Vec::new();
    let found = detector.find(scene, &mut notes);
    scene.patience.reached(FOUND);
    scene.patience.lasts(Stage::Features)?;
    let mut found = found?;
    match (scene.live, scene.source) {
        (Some(live), _) => found.candidates.retain(|c| {
            let at = Volume::new(dims, &[]).coordinates(c.voxel.index());
            live.is_usable(at)
        }),
        (None, Source::Held(image)) => {
            found.drop_near_missing(image, detector.beyond_smoothing(), &mut notes, &Ranks)?;
        }
        (None, Source::InLayers(_)) => (),
    }
    let thresholds = found.thresholds;
    let rules = sheets::Rules {
        high: thresholds.high,
        agreement: if found.sharp {
            sheets::SHARP
        } else {
            sheets::BLUNT
        },
        resolution: asked.least()
            * match found.labels {
                Some(_) => OTHER_SIDE,
                None => detector.resolution(),
            },
        min_area: match found.labels {
            // What is too small has gone before: of the rest everything is followed.
            Some(_) => 0.0,
            None => scene.least_area(detector.least_sheet()),
        },
        sure: detector.least_sure(),
        least_width: detector.least_width(asked.d_min),
        open,
    };
    let group = &Ranks as &dyn Group;
    let among = (group, scene.patience);
    let mut sheets = sheets::sheets(
        dims,
        found.candidates,
        found.layers,
        asked.step,
        &rules,
        among,
    )?;
    scene.patience.reached(IN_SHEETS);
    sheets.describe(kind, &rules, &mut notes);
    let sigma = asked.d_max() / 4.0;
    let gaps = asked.gaps();
    // Labels look at all points.
    let in_shares = asked.in_shares && found.labels.is_none();
    let among: &dyn Group = match in_shares {
        true => group,
        false => {
            sheets = sheets.gathered(group)?;
            &Alone
        }
    };
    // Edges do not cross at small angles, but their normals scatter in noise. Other sheets, which may run as
    // near one another as points of one do, are told apart by theirs.
    let sheet = (kind == FeatureKind::Edges).then_some(&sheets.sheet[..]);
    let spacing = gaps.map(|[least, most]| {
        let points = &sheets.points;
        let of_labels = found.labels.is_some();
        let finest = if of_labels {
            labels::LEAST_IN_THIN * least
        } else {
            least
        };
        let limits = [finest, most];
        let mut spacing = gaps::spacing(dims, points, sheet, asked.step, limits, among)?;
        if of_labels {
            let gaps = spacing.iter_mut();
            gaps.for_each(|gap| *gap = labels::distance_in_gap(*gap, [least, most]));
        }
        Ok(spacing)
    });
    let spacing = spacing.transpose()?;
    let (labels, limits) = found.labels.unzip();
    let spacing = match limits {
        Some(limits) => limits.spacing(&sheets.points, asked.step, spacing),
        None => spacing,
    };
    if let (Some(spacing), Some(mut limits)) = (&spacing, gaps) {
        if labels.is_some() {
            limits[0] = spacing.iter().fold(limits[0], |d, s| d.min(f64::from(*s)));
        }
        notes.push(gaps::note(spacing, limits, among)?);
    }
    let own = match scene.source {
        Source::Held(image) => detector.potential(image),
        Source::InLayers(_) => None,
    };
    let potential = match own {
        Some(samples) => Sparse::of(&field(dims, asked, samples)),
        None => {
            let FoundSheets { points, rim, .. } = &sheets;
            // A valley is as wide as a quarter of the distance that atoms have there (Hale 2002).
            let valleys = Valleys {
                dims,
                step: asked.step,
                sigma,
                points: Cow::Borrowed(points),
                rim: Cow::Borrowed(rim),
                spacing: spacing.as_deref().map(Cow::Borrowed),
            };
            match (in_shares, asked.in_shares) {
                (false, false) => valleys.potential(scene.patience),
                (false, true) => valleys.share(group, scene.patience),
                (true, _) => valleys.of_share(group)?.share(group, scene.patience),
            }
        }
    };
    scene.patience.lasts(Stage::Features)?;
    let is_horizon = kind == FeatureKind::Horizons;
    let outcome = KindOutcome {
        kind,
        points: sheets.whole,
        left_out: sheets.left_out,
        signal_to_noise: found.signal_to_noise,
        gently_dipping: match kind {
            FeatureKind::Faults => {
                let geometry = scene.source.geometry();
                outcome::gently_dipping(&sheets.points, geometry, asked.step, among)?
            }
            _ => None,
        },
    };
    Ok(Features {
        on_horizon: vec![is_horizon; sheets.points.len()],
        in_shares: in_shares.then_some(OfAll {
            points: sheets.whole,
            on_horizon: if is_horizon { sheets.whole } else { 0 },
        }),
        points: sheets.points,
        sheet: sheets.sheet,
        spacing,
        potential,
        sigma,
        outcomes: vec![outcome],
        missing: None,
        notes,
        settled: vec![Settled {
            kind,
            scale: found.scale,
            low: thresholds.low,
            high: thresholds.high,
            min_area: rules.min_area,
            mask: found.mask,
        }],
        labels,
        confidence: found.confidence.map(|samples| field(dims, asked, samples)),
        doubt: None,
    })
}

/// A field of the image's samples in lattice space.
fn field<const D: usize>(dims: [usize; D], asked: &Detection<D>, samples: Vec<f32>) -> Field<D> {
    Field {
        dims,
        step: asked.step,
        samples,
    }
}
