//! Detects the features of an image as points at sub-sample positions, and computes the potential
//! b(x) from them.
//!
//! [`detect`] works in three steps. A detector of the requested kind finds candidates: the points
//! at which columns of samples cross a feature. The candidates are grouped into feature surfaces;
//! surfaces that are too weak, too small, or too close to a stronger one for the lattice to resolve
//! are dropped. Last, the potential b(x) gets a valley along each surface.
//!
//! Options and results:
//! - `detection`: options of detection and their checks
//! - `outcome`: what was found of each kind, and how credible it is
//! - `world_dip`: dips of surfaces in the world
//! - `confidence`: contrasts of faults and horizons in amplitudes, over those at random places
//! - `doubt`: decisions that the image leaves open
//! - `given`: surfaces that the user gives, as features
//! - `resolved`: scales and thresholds of a whole image, to be used again for a part of it
//!
//! Detectors:
//! - `detectors`: kinds of features with their names and properties; one file per kind
//!
//! Shared by detectors:
//! - `value_field`: values between samples, and the regions into which thresholds divide them
//! - `volume`: samples in memory and their finite differences
//! - `windows`: samples read some layers at a time, for images that may be larger than memory
//! - `gaussian`: Gaussian smoothing
//! - `hessian`: second differences of whole rows at once
//! - `structure_tensor`: normals of layers
//! - `chaos`: chaotic zones, in which there are no layers
//! - `distance_transform`: signed distances to the surface of a mask
//! - `components`: connected components of labels
//! - `label_map`: labels at samples and between them
//! - `gradient_magnitude`: magnitudes of gradients
//! - `non_max_suppression`: points at which the gradient magnitude is largest
//! - `oriented`: ridges at all orientations, where surfaces cross, branch or run close to each
//!   other
//! - `corners`: corners of edges in the plane
//! - `candidate`: points at which a surface crosses the columns of samples
//! - `ridges`: ridges of a volume
//!
//! From candidates to the potential:
//! - `voxel_index`: candidates by the sample that they belong to
//! - `quadric`: a quadratic surface fitted to points
//! - `boundary_extension`: continues ridges to the sides of the box
//! - `surfaces`: groups candidates into surfaces (hysteresis, resolution, removal of fragments)
//! - `lines`: lines at which surfaces cross, branch and end
//! - `local_feature_size`: lattice spacing between surfaces that run close to each other
//! - `potential`: the potential b(x)
//! - `shared_grid`: the grid of samples, candidates and feature points, distributed over ranks

pub(crate) mod boundary_extension;
pub(crate) mod candidate;
pub(crate) mod chaos;
pub(crate) mod components;
pub(crate) mod confidence;
pub(crate) mod corners;
mod detection;
pub(crate) mod detectors;
pub(crate) mod distance_transform;
mod doubt;
pub(crate) mod gaussian;
pub(crate) mod given;
pub(crate) mod gradient_magnitude;
pub(crate) mod hessian;
pub(crate) mod label_map;
mod lines;
pub(crate) mod local_feature_size;
pub(crate) mod non_max_suppression;
pub(crate) mod oriented;
mod outcome;
pub(crate) mod potential;
pub(crate) mod quadric;
pub(crate) mod resolved;
pub(crate) mod ridges;
mod shared_grid;
pub(crate) mod structure_tensor;
pub(crate) mod surfaces;
pub(crate) mod value_field;
pub(crate) mod volume;
pub(crate) mod voxel_index;
pub(crate) mod windows;
mod world_dip;

#[cfg(test)]
pub(crate) mod scenes;
#[cfg(test)]
mod tests;

use crate::error::Result;
use crate::image::{Image, ImageSource, LiveMask, ScalarField, SparseField};
use crate::progress::{CancelToken, Stage};
use detectors::auto::LayerChoice;
use detectors::label_gaps::{bend_limits, label_gaps};
use detectors::labels::{LabelSpacing, ThinDistances};
use detectors::{Detector, DetectorInput, DetectorOutput};
use potential::PotentialValleys;
use std::borrow::Cow;
use surfaces::{FeatureSurfaces, OpenSides, SurfaceRules};
use volume::Volume;
use windows::Samples;
use world_dip::WorldDip;

pub use confidence::{Confidences, DOUBTFUL_CONFIDENCE};
pub(crate) use detection::fills_gaps;
pub use detection::{DetectionOptions, FaultEvidence};
pub use detectors::FeatureKind;
pub use detectors::paths::PathSeeds;
pub(crate) use detectors::value_regions::{region_names, region_values};
pub(crate) use detectors::{Brightness, ThresholdMeaning};
pub use doubt::Doubt;
pub use given::{GivenPoints, GivenSurface, SurfaceName};
pub use label_map::{LabelMap, LabelOptions};
pub(crate) use lines::lines_with_cancel;
pub use lines::{FeatureLine, LineKind, MIN_LENGTH, lines};
pub use outcome::{FlatFaults, KindOutcome, MIN_FAULT_DIP, MissingData};
pub use resolved::ResolvedOptions;
pub use shared_grid::PointCounts;
pub(crate) use shared_grid::{PointSubset, SharedGrid};
pub use surfaces::DroppedPoints;
pub use value_field::ValueField;

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

/// Result of feature detection.
#[derive(Debug, Clone)]
pub struct Features<const D: usize> {
    /// The feature points, in a fixed order (the order of samples).
    pub points: Vec<FeaturePoint<D>>,
    /// Number of the feature surface that each point is part of, from 1.
    pub surface: Vec<u32>,
    /// Names of the surfaces that have one: those that the user gives.
    pub names: Vec<SurfaceName>,
    /// For each point, `true` if it lies on a horizon, which is no barrier to flow.
    pub on_horizon: Vec<bool>,
    /// The image potential b(x) in [-1, 0]: a valley of depth 1 along every feature, at most
    /// `sigma` wide.
    pub potential: SparseField<D>,
    /// Distance between atoms at each point, in lattice units, if the distance follows the gaps
    /// between features.
    pub spacing: Option<Vec<f32>>,
    /// Number of points of all ranks, if each rank holds a share of the points; else `None`.
    pub global_counts: Option<PointCounts>,
    /// Width of the widest valleys in lattice units: a quarter of the largest distance between
    /// atoms.
    pub sigma: f64,
    /// Outcome for each kind of feature.
    pub outcomes: Vec<KindOutcome>,
    /// Shares of the samples that hold no data, if there are any.
    pub missing: Option<MissingData>,
    /// Lines for the report: which detector was used and why, thresholds, counts.
    pub notes: Vec<String>,
    /// Scales and thresholds that were used, one entry for each kind of feature.
    pub resolved: Vec<ResolvedOptions>,
    /// Label at each sample, of [`FeatureKind::Labels`] unless the labels are a thin mask.
    pub labels: Option<LabelMap<D>>,
    /// Share of the paths that pass each sample, of [`FeatureKind::Paths`].
    pub confidence: Option<ScalarField<D>>,
    /// Question that the image leaves open, if the kind of feature was chosen from the image.
    pub doubt: Option<Doubt>,
}

impl<const D: usize> Features<D> {
    /// Returns the features of an image of `dims` samples that has none.
    pub fn empty(dims: [usize; D], options: &DetectionOptions<D>) -> Self {
        Self {
            points: Vec::new(),
            surface: Vec::new(),
            names: Vec::new(),
            on_horizon: Vec::new(),
            potential: SparseField::zero(dims, options.step),
            spacing: options.gap_distance_range().map(|_| Vec::new()),
            global_counts: None,
            sigma: options.d_max() / 4.0,
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

/// Finds the features of an image and computes their potential.
///
/// Where samples hold no data (see [`Image::mark_dead`]), small gaps are bridged. In larger gaps
/// there are no features.
///
/// The edge of a disc:
///
/// ```
/// use atomesh::feature::{self, DetectionOptions, FeatureKind};
/// use atomesh::image::{Geometry, Image};
///
/// let from_centre = |x: f64, y: f64| (x - 30.0).hypot(y - 25.0);
/// let outside = |i: usize| from_centre((i % 60) as f64, (i / 60) as f64) - 15.0;
/// let disc = (0..60 * 50).map(|i| -outside(i).tanh() as f32);
/// let image = Image::new([60, 50], disc.collect(), Geometry::default());
///
/// let options = DetectionOptions::with_kind(FeatureKind::Edges, 5.0);
/// let features = feature::detect(&image, &options)?;
/// assert!(features.points.len() > 50);
/// for point in &features.points {
///     let [x, y] = point.position.map(f64::from);
///     assert!((from_centre(x, y) - 15.0).abs() < 1.0);
/// }
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns an [`Error::Feature`](crate::Error::Feature) if the options are invalid, and an
/// [`Error::Image`](crate::Error::Image) if the image has NaN or infinite samples, is constant, or
/// is not of the kind that `options.kind` says.
pub fn detect<const D: usize>(
    image: &Image<D>,
    options: &DetectionOptions<D>,
) -> Result<Features<D>> {
    let grid = SharedGrid::of_one_process(image.dims());
    let source = ImageSource::InMemory(image);
    detect_with_cancel(source, options, grid, &CancelToken::never())
}

/// Finds features as [`detect`] does, in an image that may be read layer by layer, until `cancel`
/// is cancelled. Ranks share the work by the layers of `grid`.
///
/// # Errors
/// Returns the errors of [`detect`], the errors of reading, and an
/// [`Error::Interrupted`](crate::Error::Interrupted) if `cancel` is cancelled.
pub(crate) fn detect_with_cancel<const D: usize>(
    source: ImageSource<'_, D>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    detection::validate_options(options)?;
    if options.kind == FeatureKind::NoFeatures {
        return add_given(None, options, grid, cancel);
    }
    let layers = match source {
        ImageSource::InMemory(image) => return detect_in_memory(image, options, grid, cancel),
        ImageSource::Layered(layers) => layers,
    };
    let (dims, tasks) = (layers.dims(), detectors::requested_detectors(options));
    for (detector, _) in tasks.iter().flatten() {
        detection::ensure_sample_count(dims, detector.max_samples())?;
    }
    let samples = Samples::from_layers(layers, 1.0).with_grid(grid);
    // The survey is made for every kind, because an image with gaps is searched in memory.
    let modality = options.modality.or_detect(layers.geometry());
    let choice = detectors::auto::choose_in_layers(&samples, modality, cancel)?;
    let selection = match (tasks, choice) {
        (_, LayerChoice::HasGaps) => None,
        (Some(tasks), _) => Some((tasks, None)),
        (None, LayerChoice::Chosen(choice)) => {
            Some(detectors::selection_from_choice(choice, options)?)
        }
        (None, LayerChoice::NeedsMemory) => None,
    };
    match selection {
        // Confidences are measured in the whole image.
        Some((tasks, reason))
            if tasks.iter().all(|(detector, _)| detector.is_streamable())
                && options.min_confidence.is_none() =>
        {
            run_detectors(source, None, tasks, reason, options, grid, cancel)
        }
        // The detectors need the whole image, or the image has gaps.
        _ => {
            detection::ensure_sample_count(dims, detection::MAX_IN_MEMORY_SAMPLES)?;
            detect_in_memory(&layers.load()?, options, grid, cancel)
        }
    }
}

/// Finds the features of an image in memory.
fn detect_in_memory<const D: usize>(
    image: &Image<D>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    let prepared = detection::prepare_image(image, options)?;
    let image = &*prepared.image;
    detection::ensure_not_constant(image)?;
    let (tasks, reason) = detectors::select_detectors(image, options, grid)?;
    let (source, live) = (ImageSource::InMemory(image), prepared.live_mask.as_ref());
    let mut features = run_detectors(source, live, tasks, reason, options, grid, cancel)?;
    features.notes.extend(prepared.notes);
    features.missing = prepared.missing;
    Ok(features)
}

/// Runs the detectors one after the other and combines their features.
fn run_detectors<const D: usize>(
    source: ImageSource<'_, D>,
    live: Option<&LiveMask<D>>,
    tasks: Vec<detectors::DetectorTask<D>>,
    reason: Option<detectors::SelectionReason>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    let count = tasks.len() as f64;
    let run_task = |(index, (detector, options)): (usize, (_, _))| {
        cancel.set_range(index as f64 / count, (index + 1) as f64 / count);
        let input = DetectorInput {
            live_mask: live,
            grid,
            ..DetectorInput::new(source, &options, cancel)
        };
        run_detector(&input, detector, [[false; 2]; D])
    };
    let results: Result<Vec<_>> = tasks.into_iter().enumerate().map(run_task).collect();
    let features = detectors::combine_features(results?, options, grid)?;
    let mut features = add_given(Some(features), options, grid, cancel)?;
    if let Some(reason) = reason {
        features.notes.insert(0, reason.note);
        features.doubt = reason.doubt;
    }
    Ok(features)
}

/// Finds the features of a part of an image as [`detect`] finds those of the whole image, with the
/// scales and thresholds `resolved` of the whole image. `open_sides` marks the sides beyond which
/// the image goes on: surfaces that reach such a side are kept, however small they are in the part.
///
/// # Errors
/// Returns the errors of [`detect`], except that a part may be constant, and an
/// [`Error::Interrupted`](crate::Error::Interrupted) if `cancel` is cancelled.
pub(crate) fn detect_part<const D: usize>(
    part: &Image<D>,
    options: &DetectionOptions<D>,
    resolved: &[ResolvedOptions],
    open_sides: &OpenSides<D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    let prepared = detection::prepare_image(part, options)?;
    let part = &*prepared.image;
    let grid = SharedGrid::of_one_process(part.dims());
    if options.kind == FeatureKind::NoFeatures || detection::is_constant(part) {
        return add_given(None, options, grid, cancel);
    }
    let run_kind = |resolved| {
        let input = DetectorInput {
            live_mask: prepared.live_mask.as_ref(),
            ..DetectorInput::for_part(part, options, resolved, cancel)
        };
        run_detector(
            &input,
            detectors::detector_for_part(resolved.kind)?,
            *open_sides,
        )
    };
    let results: Result<Vec<_>> = resolved.iter().map(run_kind).collect();
    let features = detectors::combine_features(results?, options, grid)?;
    add_given(Some(features), options, grid, cancel)
}

/// Adds the given surfaces to the features that were found, if there are any.
fn add_given<const D: usize>(
    found: Option<Features<D>>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    let given = options.given.as_ref();
    let given = given.map(|given| given.features(options, cancel));
    match (found, given.transpose()?) {
        (Some(found), Some(mut given)) => {
            if let (Some(_), None) = (&found.spacing, &given.spacing) {
                given.spacing = Some(vec![options.d_max() as f32; given.points.len()]);
            }
            detectors::faults_and_horizons::combine(found, given, [1.0; 2], grid)
        }
        (Some(only), None) | (None, Some(only)) => Ok(only),
        (None, None) => Ok(Features::empty(grid.dims, options)),
    }
}

/// Approximate share of the work that is done when all candidates are found, and when they are
/// grouped into surfaces.
const PROGRESS_FOUND: f64 = 0.85;
const PROGRESS_GROUPED: f64 = 0.95;

/// Interfaces between labels exclude parallel ones that are nearer than this, in units of the
/// smallest distance between atoms. It is less than one, because a region needs both of its sides,
/// even if they are nearer to each other than atoms.
const INTERFACE_RESOLUTION: f64 = 0.5;

/// Finds the features of one kind and computes their potential.
fn run_detector<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    open_sides: OpenSides<D>,
) -> Result<Features<D>> {
    let (dims, options, grid) = (input.dims(), input.options, input.grid);
    let kind = detector.kind();
    detection::ensure_sample_count(dims, detector.max_samples())?;
    let mut notes = Vec::new();
    let output = find_candidates(input, detector, &mut notes)?;
    let rules = surface_rules(input, detector, &output, open_sides);
    let resolved = resolved_options(kind, &output, &rules);
    let below_min_dip = flat_faults(input, detector, &output, &rules)?;
    let mut surfaces = surfaces::extract_surfaces(
        grid,
        output.candidates,
        output.layers,
        options.step,
        &rules,
        input.cancel,
    )?;
    input.cancel.set_fraction(PROGRESS_GROUPED);
    let axis = output.vertical_axis;
    let confidence = measure_confidences(input, detector, axis, &mut surfaces, &mut notes)?;
    surfaces.describe(kind, &rules, &mut notes);
    // The spacing of labels needs the points of all ranks.
    let is_partitioned = options.is_distributed && output.labels.is_none();
    if !is_partitioned {
        surfaces = surfaces.gather()?;
    }
    let spacing = point_spacing(
        input,
        detector,
        &surfaces,
        output.labels.as_ref(),
        &mut notes,
    )?;
    let labels = output.labels.map(|(label_map, _)| label_map);
    let potential = feature_potential(input, detector, &surfaces, spacing.as_deref())?;
    input.cancel.check(Stage::Features)?;
    let is_horizon = detector.is_horizon();
    let gently_dipping = gentle_share(input, detector, axis, &surfaces)?;
    let outcome = KindOutcome {
        kind,
        points: surfaces.total_points,
        dropped: surfaces.dropped,
        signal_to_noise: output.signal_to_noise,
        chaotic: output.chaotic_share,
        below_min_dip,
        confidence,
        gently_dipping,
    };
    Ok(Features {
        on_horizon: vec![is_horizon; surfaces.points.len()],
        global_counts: is_partitioned.then_some(PointCounts {
            points: surfaces.total_points,
            on_horizon: if is_horizon { surfaces.total_points } else { 0 },
        }),
        points: surfaces.points,
        surface: surfaces.surface,
        names: Vec::new(),
        spacing,
        potential,
        sigma: options.d_max() / 4.0,
        outcomes: vec![outcome],
        missing: None,
        notes,
        resolved: vec![resolved],
        labels,
        confidence: output
            .confidence
            .map(|samples| sample_field(dims, options, samples)),
        doubt: None,
    })
}

/// Returns the share of the points of faults that dip gently; `None` for other features. Collective.
fn gentle_share<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    vertical_axis: usize,
    surfaces: &FeatureSurfaces<'_, D>,
) -> Result<Option<f64>> {
    if !detector.is_fault() {
        return Ok(None);
    }
    let dips = WorldDip::new(input.source.geometry(), vertical_axis);
    outcome::gently_dipping_share(surfaces.grid, &surfaces.points, &dips, input.options.step)
}

/// Runs a detector, and drops candidates near samples that hold no data.
fn find_candidates<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let output = detector.find(input, notes);
    input.cancel.set_fraction(PROGRESS_FOUND);
    input.cancel.check(Stage::Features)?;
    let mut output = output?;
    if let Some(given) = &input.options.given {
        let distance = detector.resolution() * input.options.min_distance();
        let are_labels = output.labels.is_some();
        let count = given.drop_parallel(&mut output.candidates, distance, are_labels);
        given.drop_parallel(&mut output.flat_candidates, distance, false);
        notes.push(format!(
            "{count} candidates dropped as they lie nearer than {distance:.1} samples to a given surface"
        ));
    }
    match (input.live_mask, input.source) {
        (Some(live), _) => {
            let volume = Volume::new(input.dims(), &[]);
            for candidates in [&mut output.candidates, &mut output.flat_candidates] {
                candidates.retain(|c| live.is_usable(volume.coordinates(c.voxel.index())));
            }
        }
        (None, ImageSource::InMemory(image)) => {
            output.drop_near_missing_data(image, detector.extra_reach(), notes, input.grid)?;
        }
        (None, ImageSource::Layered(_)) => (),
    }
    Ok(output)
}

/// Returns the faults that are left out because they dip too little, if there are any. They meet the
/// same rules as those that are followed. Collective.
fn flat_faults<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    output: &DetectorOutput<D>,
    rules: &SurfaceRules<D>,
) -> Result<Option<FlatFaults>> {
    if !detector.is_fault() {
        return Ok(None);
    }
    let (grid, options, geometry) = (input.grid, input.options, input.source.geometry());
    let flat = surfaces::extract_surfaces(
        grid,
        output.flat_candidates.clone(),
        output.layers.clone(),
        options.step,
        rules,
        input.cancel,
    )?;
    let flat = flat.gather()?;
    let dips = WorldDip::new(geometry, output.vertical_axis);
    Ok(FlatFaults::measure(
        &flat,
        &dips,
        geometry,
        options.step,
        options.min_dip,
    ))
}

/// Measures the confidence of faults and horizons, and drops those below
/// [`min_confidence`](DetectionOptions::min_confidence). `None` for other features, and in images that
/// are not in memory. Collective.
fn measure_confidences<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    vertical_axis: usize,
    surfaces: &mut FeatureSurfaces<'_, D>,
    notes: &mut Vec<String>,
) -> Result<Option<Confidences>> {
    let (kind, min) = (detector.kind(), input.options.min_confidence);
    if !(detector.is_fault() || detector.is_horizon()) {
        return Ok(None);
    }
    let ImageSource::InMemory(image) = input.source else {
        return Ok(None);
    };
    let all = surfaces.clone().gather()?;
    let vertical = detector.is_fault().then_some(vertical_axis);
    let confidences = confidence::confidences(image, &all, input.options.step, vertical);
    let Some((summary, stays)) = Confidences::summarise(&all, &confidences, min) else {
        return Ok(None);
    };
    if let (Some(min), true) = (min, summary.dropped > 0) {
        surfaces.keep(&stays, &all);
        notes.push(format!(
            "{} of {} {kind} have a confidence below {min} and are left out",
            summary.dropped,
            stays.len()
        ));
    }
    Ok(Some(summary))
}

/// Returns the rules by which the candidates in `output` form surfaces.
fn surface_rules<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    output: &DetectorOutput<D>,
    open_sides: OpenSides<D>,
) -> SurfaceRules<D> {
    SurfaceRules {
        high: output.thresholds.high,
        agreement: if output.has_sharp_normals {
            surfaces::SHARP_NORMALS
        } else {
            surfaces::BLUNT_NORMALS
        },
        resolution: input.options.min_distance()
            * match output.labels {
                Some(_) => INTERFACE_RESOLUTION,
                None => detector.resolution(),
            },
        min_area: match output.labels {
            // Components that are too small were absorbed before: all others are followed.
            Some(_) => 0.0,
            None => input.min_area(detector),
        },
        min_strong_share: detector.min_strong_share(),
        min_width: detector.min_width(input.options.d_min),
        open_sides,
    }
}

/// Returns the scales and thresholds with which features were found.
fn resolved_options<const D: usize>(
    kind: FeatureKind,
    output: &DetectorOutput<D>,
    rules: &SurfaceRules<D>,
) -> ResolvedOptions {
    ResolvedOptions {
        kind,
        scale: output.scale,
        low: output.thresholds.low,
        high: output.thresholds.high,
        min_area: rules.min_area,
        mask: output.mask_value,
        levels: output.levels.clone(),
    }
}

/// Returns the distance between atoms at each point of `surfaces`, if it follows the gaps between
/// features or the label of the point, and adds a note on its range.
fn point_spacing<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    surfaces: &FeatureSurfaces<'_, D>,
    labels: Option<&(LabelMap<D>, LabelSpacing<D>)>,
    notes: &mut Vec<String>,
) -> Result<Option<Vec<f32>>> {
    let (grid, points, step) = (surfaces.grid, &surfaces.points, input.options.step);
    let gaps = input.options.gap_distance_range();
    // Edges do not cross at small angles, but noise scatters their normals, so that points of one
    // edge are told apart by the number of their surface. Other surfaces may run as near to each
    // other as points of one surface do: they are told apart by their normals.
    let has_scattered_normals = detector.has_scattered_normals() || !input.options.seeks_crossings;
    let surface = has_scattered_normals.then_some(&surfaces.surface[..]);
    let gap_spacing = |[min, max]: [f64; 2]| {
        let spacing = |limits| local_feature_size::spacing(grid, points, surface, step, limits);
        let Some((label_map, _)) = labels else {
            return spacing([min, max]);
        };
        let mut gaps = label_gaps(label_map, points, max);
        let samples = label_map.winner.len();
        let distances = ThinDistances::for_gaps(&gaps, [min, max], label_map.min_step(), samples);
        let bends = bend_limits(points, label_map.min_step(), input.cancel);
        for (gap, bend) in gaps.iter_mut().zip(bends) {
            *gap = distances.in_gap(*gap).min(bend.max(min as f32));
        }
        local_feature_size::propagate_gaps(grid, points, step, &gaps, max)
    };
    let mut spacing = gaps.map(gap_spacing).transpose()?;
    if let Some((_, labels)) = labels {
        spacing = labels.spacing(points, step, spacing);
    }
    if let (Some(spacing), Some(mut limits)) = (&spacing, gaps) {
        if labels.is_some() {
            limits[0] = spacing.iter().fold(limits[0], |d, s| d.min(f64::from(*s)));
        }
        notes.push(local_feature_size::spacing_note(grid, spacing, limits)?);
    }
    Ok(spacing)
}

/// Returns the potential b(x): that of the detector, if it has its own, or else a valley along each
/// surface.
fn feature_potential<const D: usize>(
    input: &DetectorInput<'_, D>,
    detector: &dyn Detector<D>,
    surfaces: &FeatureSurfaces<'_, D>,
    spacing: Option<&[f32]>,
) -> Result<SparseField<D>> {
    let (dims, options, cancel) = (input.dims(), input.options, input.cancel);
    if let ImageSource::InMemory(image) = input.source
        && let Some(samples) = detector.potential(image)
    {
        let field = sample_field(dims, options, samples);
        return Ok(SparseField::from_field(&field));
    }
    let grid = if options.is_distributed {
        input.grid
    } else {
        SharedGrid::of_one_process(dims)
    };
    // A valley is as wide as a quarter of the distance between atoms there (Hale 2002).
    let mut valleys = PotentialValleys {
        grid,
        step: options.step,
        sigma: options.d_max() / 4.0,
        points: Cow::Borrowed(&surfaces.points),
        is_rim: Cow::Borrowed(&surfaces.is_rim),
        spacing: spacing.map(Cow::Borrowed),
    };
    if surfaces.grid.is_shared() {
        valleys = valleys.gather_for_share()?;
    }
    Ok(valleys.potential(cancel))
}

/// Returns a field in lattice space with a value at each sample of the image.
fn sample_field<const D: usize>(
    dims: [usize; D],
    options: &DetectionOptions<D>,
    samples: Vec<f32>,
) -> ScalarField<D> {
    ScalarField {
        dims,
        step: options.step,
        samples,
    }
}
