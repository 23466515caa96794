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

pub(crate) mod boundary_extension;
pub(crate) mod candidate;
mod candidate_slab;
pub(crate) mod components;
pub(crate) mod corners;
mod detection;
pub(crate) mod detectors;
pub(crate) mod distance_transform;
mod doubt;
pub(crate) mod eigen;
pub(crate) mod gaussian;
pub(crate) mod gradient_magnitude;
pub(crate) mod hessian;
mod kind;
pub(crate) mod label_map;
mod lines;
pub(crate) mod local_feature_size;
pub(crate) mod non_max_suppression;
pub(crate) mod oriented;
mod outcome;
mod partition;
pub(crate) mod potential;
pub(crate) mod quadric;
pub(crate) mod resolved;
pub(crate) mod ridges;
pub(crate) mod structure_tensor;
pub(crate) mod surfaces;
pub(crate) mod volume;
pub(crate) mod voxel_index;
pub(crate) mod windows;

#[cfg(test)]
pub(crate) mod scenes;
#[cfg(test)]
mod tests;

use crate::comm::{Comm, SelfComm, WorldComm};
use crate::error::Result;
use crate::image::{Image, ImageSource, LiveMask, ScalarField, SparseField};
use crate::progress::{CancelToken, Stage};
use detectors::auto::LayerChoice;
use detectors::{Detector, DetectorInput, labels};
use potential::PotentialValleys;
use std::borrow::Cow;
use surfaces::{FeatureSurfaces, OpenSides};
use volume::Volume;
use windows::Samples;

pub use detection::DetectionOptions;
pub(crate) use detection::fills_gaps;
pub use detectors::paths::PathSeeds;
pub use doubt::Doubt;
pub use kind::FeatureKind;
pub use label_map::{LabelMap, LabelOptions};
pub use lines::{FeatureLine, LineKind, MIN_LENGTH, lines};
pub use outcome::{KindOutcome, MIN_FAULT_DIP, MissingData};
pub use partition::PointCounts;
pub(crate) use partition::PointSubset;
pub use resolved::ResolvedOptions;
pub use surfaces::DroppedPoints;

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
    pub surface: Vec<u32>,
    /// For each of them whether it lies on a horizon, which is no barrier to flow.
    pub on_horizon: Vec<bool>,
    /// The image potential b(x) in [-1, 0]: every feature a valley of depth 1 and width `sigma`.
    pub potential: SparseField<D>,
    /// For each of them the distance that atoms may have there, where it was asked for by gaps.
    pub spacing: Option<Vec<f32>>,
    /// How many points all ranks have, where each has a share of them.
    pub global_counts: Option<PointCounts>,
    /// Width of the widest valleys in lattice units: a quarter of the distance between atoms.
    pub sigma: f64,
    /// What was found of each kind of feature.
    pub outcomes: Vec<KindOutcome>,
    /// The samples that hold no data, if there are any.
    pub missing: Option<MissingData>,
    /// One or more plain lines: what was picked and why, threshold, counts.
    pub notes: Vec<String>,
    /// The scales and thresholds that were settled on, one for each kind of feature followed.
    pub resolved: Vec<ResolvedOptions>,
    /// Of [`FeatureKind::Labels`], unless they are a thin mask: which label is where.
    pub labels: Option<LabelMap<D>>,
    /// Of [`FeatureKind::Paths`]: the share of the paths that pass each sample.
    pub confidence: Option<ScalarField<D>>,
    /// What the image leaves open, where the kind of feature was chosen by it.
    pub doubt: Option<Doubt>,
}

impl<const D: usize> Features<D> {
    /// No features in an image of `dims` samples.
    pub fn empty(dims: [usize; D], asked: &DetectionOptions<D>) -> Self {
        Self {
            points: Vec::new(),
            surface: Vec::new(),
            on_horizon: Vec::new(),
            potential: SparseField::zero(dims, asked.step),
            spacing: asked.gap_distance_range().map(|_| Vec::new()),
            global_counts: None,
            sigma: asked.d_max() / 4.0,
            outcomes: Vec::new(),
            missing: None,
            notes: Vec::new(),
            resolved: Vec::new(),
            labels: None,
            confidence: None,
            doubt: None,
        }
    }
}

/// Finds the features of an image and their potential. Where samples hold no data (see [`MirrorImage::changed_candidates`]),
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
pub fn detect<const D: usize>(
    image: &Image<D>,
    asked: &DetectionOptions<D>,
) -> Result<Features<D>> {
    detect_in_memory(image, asked, &CancelToken::never())
}

/// The same as long as there is patience.
///
/// # Errors
/// Those of [`detect`], and [`Error::Interrupted`](crate::Error::Interrupted).
pub(crate) fn detect_with_cancel<const D: usize>(
    source: ImageSource<'_, D>,
    asked: &DetectionOptions<D>,
    patience: &CancelToken<'_>,
) -> Result<Features<D>> {
    let layers = match source {
        ImageSource::InMemory(image) => return detect_in_memory(image, asked, patience),
        ImageSource::Layered(layers) => layers,
    };
    detection::validate_options(asked)?;
    let (dims, parts) = (layers.dims(), detectors::requested_detectors(asked));
    for (detector, _) in parts.iter().flatten() {
        detection::ensure_sample_count(dims, detection::max_samples(*detector))?;
    }
    let samples = Samples::from_layers(layers, 1.0);
    // Looked at whatever is asked for: what has gaps is searched in memory.
    let modality = asked.modality.or_detect(layers.geometry());
    let choice = detectors::auto::choose_in_layers(&samples, modality, patience)?;
    let chosen = match (parts, choice) {
        (_, LayerChoice::HasGaps) => None,
        (Some(parts), _) => Some((parts, None)),
        (None, LayerChoice::Chosen(choice)) => {
            Some(detectors::selection_from_choice(choice, asked)?)
        }
        (None, LayerChoice::NeedsMemory) => None,
    };
    match chosen {
        Some((parts, why)) if parts.iter().all(|(detector, _)| detector.is_streamable()) => {
            run_detectors((source, None), parts, why, asked, patience)
        }
        // What needs the whole image has it.
        _ => {
            detection::ensure_sample_count(dims, detection::MAX_IN_MEMORY_SAMPLES)?;
            detect_in_memory(&layers.load()?, asked, patience)
        }
    }
}

/// The same of an image in memory.
fn detect_in_memory<const D: usize>(
    image: &Image<D>,
    asked: &DetectionOptions<D>,
    patience: &CancelToken<'_>,
) -> Result<Features<D>> {
    let checked = detection::prepare_image(image, asked)?;
    let image = &*checked.image;
    detection::ensure_not_constant(image)?;
    let (parts, why) = detectors::select_detectors(image, asked)?;
    let source = (ImageSource::InMemory(image), checked.live_mask.as_ref());
    let mut features = run_detectors(source, parts, why, asked, patience)?;
    features.notes.extend(checked.notes);
    features.missing = checked.missing;
    Ok(features)
}

/// Finds features by some detectors.
fn run_detectors<const D: usize>(
    (source, live): (ImageSource<'_, D>, Option<&LiveMask<D>>),
    parts: Vec<detectors::DetectorTask<D>>,
    reason: Option<detectors::SelectionReason>,
    asked: &DetectionOptions<D>,
    patience: &CancelToken<'_>,
) -> Result<Features<D>> {
    let count = parts.len() as f64;
    let follow_whole = |(number, (detector, asked)): (usize, (_, _))| {
        patience.set_range(number as f64 / count, (number + 1) as f64 / count);
        let scene = DetectorInput {
            live_mask: live,
            ..DetectorInput::new(source, &asked, patience)
        };
        run_detector(&scene, detector, [[false; 2]; D])
    };
    let found: Result<Vec<_>> = parts.into_iter().enumerate().map(follow_whole).collect();
    let mut features = detectors::combine_features(found?, source.dims(), asked)?;
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
    asked: &DetectionOptions<D>,
    settled: &[ResolvedOptions],
    open: &OpenSides<D>,
    patience: &CancelToken<'_>,
) -> Result<Features<D>> {
    let checked = detection::prepare_image(part, asked)?;
    let part = &*checked.image;
    if detection::is_constant(part) {
        return Ok(Features::empty(part.dims(), asked));
    }
    let follow_part = |settled| {
        let scene = DetectorInput {
            live_mask: checked.live_mask.as_ref(),
            ..DetectorInput::for_part(part, asked, settled, patience)
        };
        run_detector(&scene, detectors::detector_for_part(settled.kind)?, *open)
    };
    let found: Result<Vec<_>> = settled.iter().map(follow_part).collect();
    detectors::combine_features(found?, part.dims(), asked)
}

/// The share of the work that is done once candidates are found, roughly, and once they are sheets.
const PROGRESS_FOUND: f64 = 0.85;
const PROGRESS_GROUPED: f64 = 0.95;

/// A region is no use without its other side, even if that is nearer than atoms: interfaces between labels
/// exclude parallel ones nearer than this, in units of the least distance between atoms.
const INTERFACE_RESOLUTION: f64 = 0.5;

/// Finds the features of one kind and their potential.
fn run_detector<const D: usize>(
    scene: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    open: OpenSides<D>,
) -> Result<Features<D>> {
    let (dims, asked, kind) = (scene.dims(), scene.options, detector.kind());
    detection::ensure_sample_count(dims, detection::max_samples(detector))?;
    let mut notes = Vec::new();
    let found = detector.find(scene, &mut notes);
    scene.cancel.set_fraction(PROGRESS_FOUND);
    scene.cancel.check(Stage::Features)?;
    let mut found = found?;
    match (scene.live_mask, scene.source) {
        (Some(live), _) => found.candidates.retain(|c| {
            let at = Volume::new(dims, &[]).coordinates(c.voxel.index());
            live.is_usable(at)
        }),
        (None, ImageSource::InMemory(image)) => {
            found.drop_near_missing_data(image, detector.extra_reach(), &mut notes, &WorldComm)?;
        }
        (None, ImageSource::Layered(_)) => (),
    }
    let thresholds = found.thresholds;
    let rules = surfaces::SurfaceRules {
        high: thresholds.high,
        agreement: if found.has_sharp_normals {
            surfaces::SHARP_NORMALS
        } else {
            surfaces::BLUNT_NORMALS
        },
        resolution: asked.min_distance()
            * match found.labels {
                Some(_) => INTERFACE_RESOLUTION,
                None => detector.resolution(),
            },
        min_area: match found.labels {
            // What is too small has gone before: of the rest everything is followed.
            Some(_) => 0.0,
            None => scene.min_area(detector.min_surface_cells()),
        },
        min_strong_share: detector.min_strong_share(),
        min_width: detector.min_width(asked.d_min),
        open_sides: open,
    };
    let group = &WorldComm as &dyn Comm;
    let among = (group, scene.cancel);
    let mut sheets = surfaces::extract_surfaces(
        dims,
        found.candidates,
        found.layers,
        asked.step,
        &rules,
        among,
    )?;
    scene.cancel.set_fraction(PROGRESS_GROUPED);
    sheets.describe(kind, &rules, &mut notes);
    let sigma = asked.d_max() / 4.0;
    let gaps = asked.gap_distance_range();
    // Labels look at all points.
    let in_shares = asked.is_distributed && found.labels.is_none();
    let among: &dyn Comm = match in_shares {
        true => group,
        false => {
            sheets = sheets.gather(group)?;
            &SelfComm
        }
    };
    // Edges do not cross at small angles, but their normals scatter in noise. Other sheets, which may run as
    // near one another as points of one do, are told apart by theirs.
    let sheet = (kind == FeatureKind::Edges).then_some(&sheets.surface[..]);
    let spacing = gaps.map(|[least, most]| {
        let points = &sheets.points;
        let of_labels = found.labels.is_some();
        let finest = if of_labels {
            labels::MIN_THIN_DISTANCE_RATIO * least
        } else {
            least
        };
        let limits = [finest, most];
        let mut spacing =
            local_feature_size::spacing(dims, points, sheet, asked.step, limits, among)?;
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
        notes.push(local_feature_size::spacing_note(spacing, limits, among)?);
    }
    let own = match scene.source {
        ImageSource::InMemory(image) => detector.potential(image),
        ImageSource::Layered(_) => None,
    };
    let potential = match own {
        Some(samples) => SparseField::from_field(&sample_field(dims, asked, samples)),
        None => {
            let FeatureSurfaces {
                points,
                is_rim: rim,
                ..
            } = &sheets;
            // A valley is as wide as a quarter of the distance that atoms have there (Hale 2002).
            let valleys = PotentialValleys {
                dims,
                step: asked.step,
                sigma,
                points: Cow::Borrowed(points),
                is_rim: Cow::Borrowed(rim),
                spacing: spacing.as_deref().map(Cow::Borrowed),
            };
            match (in_shares, asked.is_distributed) {
                (false, false) => valleys.potential(scene.cancel),
                (false, true) => valleys.distributed_potential(group, scene.cancel),
                (true, _) => valleys
                    .gather_for_share(group)?
                    .distributed_potential(group, scene.cancel),
            }
        }
    };
    scene.cancel.check(Stage::Features)?;
    let is_horizon = kind == FeatureKind::Horizons;
    let outcome = KindOutcome {
        kind,
        points: sheets.total_points,
        dropped: sheets.dropped,
        signal_to_noise: found.signal_to_noise,
        gently_dipping: match kind {
            FeatureKind::Faults => {
                let geometry = scene.source.geometry();
                outcome::gently_dipping_share(&sheets.points, geometry, asked.step, among)?
            }
            _ => None,
        },
    };
    Ok(Features {
        on_horizon: vec![is_horizon; sheets.points.len()],
        global_counts: in_shares.then_some(PointCounts {
            points: sheets.total_points,
            on_horizon: if is_horizon { sheets.total_points } else { 0 },
        }),
        points: sheets.points,
        surface: sheets.surface,
        spacing,
        potential,
        sigma,
        outcomes: vec![outcome],
        missing: None,
        notes,
        resolved: vec![ResolvedOptions {
            kind,
            scale: found.scale,
            low: thresholds.low,
            high: thresholds.high,
            min_area: rules.min_area,
            mask: found.mask_value,
        }],
        labels,
        confidence: found
            .confidence
            .map(|samples| sample_field(dims, asked, samples)),
        doubt: None,
    })
}

/// A field of the image's samples in lattice space.
fn sample_field<const D: usize>(
    dims: [usize; D],
    asked: &DetectionOptions<D>,
    samples: Vec<f32>,
) -> ScalarField<D> {
    ScalarField {
        dims,
        step: asked.step,
        samples,
    }
}
