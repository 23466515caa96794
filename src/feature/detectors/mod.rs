//! Detectors find candidates for feature points in an image; one file per kind of feature.
//!
//! - `ridges`: surfaces of high values, or of low ones (valleys)
//! - `edges`: ridges of Prewitt's gradient magnitude
//! - `canny`: maxima of the gradient magnitude along the gradient
//! - `paths`: the boundary of one object, by random shortest paths
//! - `labels`: interfaces between labels
//! - `masks`: the medial surface of thin masks
//! - `label_smoothing`: winning label of each sample after smoothing
//! - `horizons`: crests and troughs of seismic amplitude
//! - `faults`: places where layers of seismic amplitude do not continue
//! - `faults_and_horizons`: both, in one potential
//! - `potential`: an image that is b(x) itself
//! - `auto`: choice of the kind that fits an image
//!
//! Widths of Gaussians, windows and reaches are in samples, whatever the step of lattice space.
//! Positions and normals are converted to lattice space when candidates are grouped into surfaces.

pub(crate) mod auto;
pub(crate) mod canny;
pub(crate) mod edges;
pub(crate) mod faults;
pub(crate) mod faults_and_horizons;
pub(crate) mod horizons;
pub(crate) mod label_smoothing;
pub(crate) mod labels;
pub(crate) mod masks;
pub(crate) mod paths;
pub(crate) mod potential;
pub(crate) mod ridges;

use super::candidate::Candidate;
use super::gaussian;
use super::label_map::LabelMap;
use super::volume::Volume;
use super::windows::Samples;
use super::{DetectionOptions, Doubt, FeatureKind, Features, ResolvedOptions};
use crate::comm::{Comm, concatenate};
use crate::error::{Error, Result, cause};
use crate::image::{Image, ImageSource, LiveMask};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::fmt;
use std::ops::Range;

/// A detector of one kind of feature.
pub trait Detector<const D: usize>: Sync {
    /// Returns the kind of feature that the detector finds.
    fn kind(&self) -> FeatureKind;

    /// Finds candidates for feature points, in the order of samples, that are at least as strong as
    /// the lower threshold. Adds notes on the scale and the method to `notes`.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the image has no such features, and an [`Error::Feature`] if
    /// the options are invalid.
    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>>;

    /// Returns the smallest area of a surface that the mesh follows, in squares of the distance
    /// between atoms (in 2-D the smallest length, in such distances).
    fn min_surface_cells(&self) -> f64 {
        2.0
    }

    /// Returns the share of a small surface that must be strong; a surface with a smaller share is
    /// noise.
    fn min_strong_share(&self) -> f64 {
        0.0
    }

    /// Returns the width (samples) below which parts of surfaces are dropped, if atoms are at least
    /// `d_min` apart; 0 keeps any width.
    fn min_width(&self, _d_min: f64) -> usize {
        0
    }

    /// Returns the distance below which parallel surfaces exclude one another, in units of the
    /// smallest distance between atoms.
    fn resolution(&self) -> f64 {
        0.9
    }

    /// Returns how far (samples) detection looks to either side at `scale`: at a larger distance
    /// from the cut, a part of an image has the features of the whole image.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3
    }

    /// Returns the distance (samples), beyond three times the scale, from missing traces within
    /// which candidates are not trusted.
    fn extra_reach(&self) -> f64 {
        2.0
    }

    /// Returns `true` if the detector needs only some layers of the image at a time.
    fn is_streamable(&self) -> bool {
        false
    }

    /// Returns b(x) if the image itself is the potential.
    fn potential(&self, _image: &Image<D>) -> Option<Vec<f32>> {
        None
    }
}

/// Input of a detector.
#[derive(Debug, Clone, Copy)]
pub struct DetectorInput<'a, const D: usize> {
    /// The image. Its samples are finite and not all the same, and missing traces are filled. It is
    /// in memory, unless the detector [reads layers](Detector::is_streamable).
    pub source: ImageSource<'a, D>,
    /// Mask of the samples that hold data; `None` if all do.
    pub live_mask: Option<&'a LiveMask<D>>,
    /// Options: scale, thresholds, points of an object.
    pub options: &'a DetectionOptions<D>,
    /// Scales and thresholds of the whole image, if this is a part of one.
    pub resolved: Option<&'a ResolvedOptions>,
    /// Cancels the search; the result of a cancelled search is not used.
    pub cancel: &'a CancelToken<'a>,
}

impl<'a, const D: usize> DetectorInput<'a, D> {
    /// Creates the input for a whole image.
    pub fn new(
        source: ImageSource<'a, D>,
        options: &'a DetectionOptions<D>,
        cancel: &'a CancelToken<'a>,
    ) -> Self {
        Self {
            source,
            live_mask: None,
            options,
            resolved: None,
            cancel,
        }
    }

    /// Creates the input for a part of an image whose whole was searched before.
    pub fn for_part(
        image: &'a Image<D>,
        options: &'a DetectionOptions<D>,
        resolved: &'a ResolvedOptions,
        cancel: &'a CancelToken<'a>,
    ) -> Self {
        Self {
            resolved: Some(resolved),
            ..Self::new(ImageSource::InMemory(image), options, cancel)
        }
    }

    /// Returns the number of samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        self.source.dims()
    }

    /// Returns the image in memory.
    ///
    /// # Errors
    /// Returns an [`Error::Feature`] if the image is not in memory.
    pub fn image(&self) -> Result<&'a Image<D>> {
        match self.source {
            ImageSource::InMemory(image) => Ok(image),
            ImageSource::Layered(_) => Err(Error::Feature(cause(
                "feature detection",
                "needs an image in memory",
                "choose ridges, valleys, faults or horizons, which are found in layers",
            ))),
        }
    }

    /// Returns the samples in memory.
    ///
    /// # Errors
    /// Returns the errors of [`DetectorInput::image`].
    pub fn volume(&self) -> Result<Volume<'a, D>> {
        Ok(Volume::new(self.dims(), self.image()?.as_slice()))
    }

    /// Returns the samples times `sign`, to be read some layers at a time.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn samples(&self, sign: f32) -> Result<Samples<'a, D>> {
        match self.source {
            ImageSource::InMemory(image) if sign == 1.0 => {
                Ok(Samples::in_memory(image.dims(), image.as_slice()))
            }
            ImageSource::InMemory(image) => {
                let signed: Vec<f32> = image.as_slice().par_iter().map(|s| sign * s).collect();
                Ok(Samples::in_memory(image.dims(), signed))
            }
            ImageSource::Layered(layers) => Samples::from_layers(layers, sign).load_if_small(),
        }
    }

    /// Returns the width (samples) of the Gaussian under which derivatives are taken, for detectors
    /// that do not choose it by the noise.
    pub fn scale(&self) -> f64 {
        self.options.scale.unwrap_or(1.0)
    }

    /// Returns the samples smoothed over [`DetectorInput::scale`], to be read some layers at a
    /// time.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn smoothed_in_layers(&self) -> Result<Samples<'a, D>> {
        let mut samples = self.samples(1.0)?;
        samples.smooth(self.scale(), self.cancel);
        Ok(samples)
    }

    /// Returns the samples smoothed over [`DetectorInput::scale`], in memory.
    ///
    /// # Errors
    /// Returns the errors of [`DetectorInput::image`].
    pub fn smoothed(&self) -> Result<Vec<f32>> {
        let samples = self.image()?.as_slice();
        let (mut smoothed, scale) = (vec![0.0; samples.len()], [self.scale(); D]);
        gaussian::smooth_into(self.dims(), samples, &mut smoothed, scale, self.cancel);
        Ok(smoothed)
    }

    /// Returns the thresholds, unless they are to be chosen from the image.
    pub fn thresholds(&self) -> Option<Thresholds> {
        if let Some(resolved) = self.resolved {
            return Some(Thresholds {
                low: resolved.low,
                high: resolved.high,
                origin: "as in the whole image",
            });
        }
        self.options.threshold.map(|high| Thresholds {
            low: 0.5 * high,
            high,
            origin: "given",
        })
    }

    /// Returns the smallest area of a surface in square lattice units (in 2-D the smallest length),
    /// if it must cover `cells` squares of the distance between atoms.
    pub fn min_area(&self, cells: f64) -> f64 {
        if let Some(resolved) = self.resolved {
            return resolved.min_area;
        }
        let (dims, options) = (self.dims(), self.options);
        let side = |k: usize| (dims[k] as f64 - 1.0) * options.step[k];
        let section = (0..D)
            .map(|k| (1..D).map(|l| side((k + l) % D)).product())
            .fold(0.0, f64::max);
        // In a small image, smaller surfaces are large.
        (cells * options.d_max().powi(D as i32 - 1)).min(0.25 * section)
    }
}

/// Thresholds of strength for hysteresis (Canny 1986).
#[derive(Debug, Clone, Copy)]
pub struct Thresholds {
    /// Strength down to which a surface is followed.
    pub low: f32,
    /// Strength that a surface must reach somewhere.
    pub high: f32,
    /// Origin of the thresholds, in one or two words.
    pub origin: &'static str,
}

impl fmt::Display for Thresholds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high, origin } = self;
        write!(
            f,
            "threshold {high:.4} ({origin}; followed down to {low:.4})"
        )
    }
}

/// Output of a detector.
#[derive(Debug, Clone)]
pub struct DetectorOutput<const D: usize> {
    /// Points that may lie on features, in the order of samples.
    pub candidates: Vec<Candidate<D>>,
    /// Layers of which this rank has all candidates, if ranks share the candidates; `None` if every
    /// rank has all candidates.
    pub layers: Option<Range<usize>>,
    /// Width (samples) of the Gaussian under which they were found.
    pub scale: f64,
    /// Thresholds that decide which candidates form surfaces.
    pub thresholds: Thresholds,
    /// Typical strength of ridges divided by that of noise, if it was measured.
    pub signal_to_noise: Option<f32>,
    /// `true` if normals are known to a few degrees, so that they distinguish surfaces that cross
    /// at shallow angles.
    pub has_sharp_normals: bool,
    /// Value of the thin mask whose medial surface was sought.
    pub mask_value: Option<f32>,
    /// For labels: the winning labels, and the distance between atoms in each component.
    pub labels: Option<(LabelMap<D>, labels::LabelSpacing<D>)>,
    /// For paths: the share of the paths that pass each sample.
    pub confidence: Option<Vec<f32>>,
}

impl<const D: usize> DetectorOutput<D> {
    /// Creates an output of candidates without further results.
    pub fn new(candidates: Vec<Candidate<D>>, scale: f64, thresholds: Thresholds) -> Self {
        Self {
            candidates,
            layers: None,
            scale,
            thresholds,
            signal_to_noise: None,
            has_sharp_normals: false,
            mask_value: None,
            labels: None,
            confidence: None,
        }
    }

    /// Takes the candidates of all ranks; the candidates are no longer distributed afterwards.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn gather_candidates(&mut self, comm: &dyn Comm) -> Result<Vec<Candidate<D>>> {
        let local = std::mem::take(&mut self.candidates);
        match self.layers.take() {
            Some(_) => Ok(concatenate(comm.all_gather("candidates", local)?)),
            None => Ok(local),
        }
    }

    /// Drops candidates at missing traces, and those so near that smoothing mixes real samples with
    /// filled ones.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn drop_near_missing_data(
        &mut self,
        image: &Image<D>,
        beyond_smoothing: f64,
        notes: &mut Vec<String>,
        comm: &dyn Comm,
    ) -> Result<()> {
        let reach = (3.0 * self.scale).ceil() + beyond_smoothing;
        let is_near_missing = image.rows_near_missing(reach);
        if is_near_missing.is_empty() {
            return Ok(());
        }
        let row = |c: &Candidate<D>| c.voxel.index() / image.dims()[0];
        let dropped = self.candidates.iter().map(row);
        let mut dropped = dropped
            .filter(|&r| is_near_missing[r] && !image.missing[r])
            .count();
        if self.layers.is_some() {
            dropped = comm.all_gather("candidates dropped", dropped)?.iter().sum();
        }
        self.candidates.retain(|c| !is_near_missing[row(c)]);
        notes.push(format!(
            "{dropped} candidates dropped as they lie within {reach} samples of missing traces"
        ));
        Ok(())
    }
}

/// A detector and its options.
pub type DetectorTask<const D: usize> = (&'static dyn Detector<D>, DetectionOptions<D>);

/// The detectors to run; and the reason, if the image decided on one.
pub type DetectorSelection<const D: usize> = (Vec<DetectorTask<D>>, Option<SelectionReason>);

/// Reason for a choice that the image decided.
pub struct SelectionReason {
    /// A line for the report.
    pub note: String,
    /// Question that the image leaves open.
    pub doubt: Option<Doubt>,
}

/// Returns the detector of one kind. [`FeatureKind::Auto`], which is a choice, and
/// [`FeatureKind::FaultsAndHorizons`], which needs two detectors, have none.
pub fn detector_for<const D: usize>(kind: FeatureKind) -> Option<&'static dyn Detector<D>> {
    Some(match kind {
        FeatureKind::Ridges => &ridges::Ridges,
        FeatureKind::Valleys => &ridges::Valleys,
        FeatureKind::Edges => &edges::Edges,
        FeatureKind::Canny => &canny::Canny,
        FeatureKind::Paths => &paths::Paths,
        FeatureKind::Horizons => &horizons::Horizons,
        FeatureKind::Faults => &faults::Faults,
        FeatureKind::Labels => &labels::Labels,
        FeatureKind::Mask => &masks::Masks,
        FeatureKind::Potential => &potential::Potential,
        FeatureKind::Auto | FeatureKind::FaultsAndHorizons => return None,
    })
}

/// Returns the detectors for the options; and the reason, if the image decided on one.
///
/// # Errors
/// Returns an [`Error::Feature`] if the image decided on features to which the threshold does not
/// apply, and an [`Error::Image`] if the image has samples that are not finite.
pub fn select_detectors<const D: usize>(
    image: &Image<D>,
    options: &DetectionOptions<D>,
) -> Result<DetectorSelection<D>> {
    match requested_detectors(options) {
        Some(tasks) => Ok((tasks, None)),
        None => selection_from_choice(
            auto::choose(image, options.modality.or_detect(&image.geometry))?,
            options,
        ),
    }
}

/// Returns the detectors for the options, or `None` if the image decides.
pub fn requested_detectors<const D: usize>(
    options: &DetectionOptions<D>,
) -> Option<Vec<DetectorTask<D>>> {
    match options.kind {
        FeatureKind::FaultsAndHorizons => Some(faults_and_horizons::detector_tasks(options)),
        kind => detector_for(kind).map(|detector| vec![(detector, options.clone())]),
    }
}

/// Returns the detector on which an image decided, and the reason.
///
/// # Errors
/// Returns an [`Error::Feature`] if the requested threshold does not apply to its features.
pub fn selection_from_choice<const D: usize>(
    choice: auto::DetectorChoice<D>,
    options: &DetectionOptions<D>,
) -> Result<DetectorSelection<D>> {
    let auto::DetectorChoice {
        detector,
        reason,
        doubt,
    } = choice;
    let kind = detector.kind();
    match options.threshold {
        Some(threshold) if matches!(kind, FeatureKind::Labels | FeatureKind::Mask) => {
            Err(Error::Feature(cause(
                format!("threshold {threshold}"),
                format!("applies to the strength of features, but the image has {kind} ({reason})"),
                "omit it, or choose another kind of feature",
            )))
        }
        _ => {
            let note = format!("features: {kind} ({reason})");
            let reason = SelectionReason { note, doubt };
            Ok((vec![(detector, options.clone())], Some(reason)))
        }
    }
}

/// Returns the detector that finds in a part of an image what it found in the whole image.
///
/// # Errors
/// Returns an [`Error::Feature`] if features of this kind can only be found in the whole image.
pub fn detector_for_part<const D: usize>(kind: FeatureKind) -> Result<&'static dyn Detector<D>> {
    let problem = match detector_for(kind) {
        Some(_) if kind == FeatureKind::Paths => {
            "comes from paths through the whole image and cannot be found again in a part"
        }
        Some(detector) => return Ok(detector),
        None => "is not one kind that can be found again in a part of an image",
    };
    Err(Error::Feature(cause(
        format!("feature '{kind}'"),
        problem,
        "mesh the image again",
    )))
}

/// Combines the results of one or two detectors.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn combine_features<const D: usize>(
    features: Vec<Features<D>>,
    dims: [usize; D],
    options: &DetectionOptions<D>,
) -> Result<Features<D>> {
    let mut features = features.into_iter();
    Ok(match (features.next(), features.next()) {
        (Some(faults), Some(horizons)) => {
            faults_and_horizons::combine(faults, horizons, options.weights)?
        }
        (Some(single), None) => single,
        _ => Features::empty(dims, options),
    })
}
