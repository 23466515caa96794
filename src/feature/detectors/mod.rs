//! Detectors: image -> candidates for points of features, one file a kind.
//!
//! - `ridges`: sheets of high values, or of low ones (valleys)
//! - `edges`: ridges of Prewitt's gradient magnitude
//! - `canny`: where the gradient is steepest along itself
//! - `paths`: the boundary of one object, by random shortest paths
//! - `labels`: interfaces between labels
//! - `masks`: the sheet in the middle of thin masks
//! - `contest`: which label leads at each sample
//! - `horizons`: crests and troughs of seismic amplitude
//! - `faults`: where layers of seismic amplitude do not continue
//! - `faults_and_horizons`: both, in one potential
//! - `potential`: an image that is b(x) itself
//! - `auto`: which of them fits an image
//!
//! Widths of Gaussians, windows and reaches are in samples, whatever the step of lattice space is;
//! positions and normals become lattice space's when sheets are made of the candidates.

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

/// Finds features of one kind.
pub trait Detector<const D: usize>: Sync {
    /// What it finds: one kind.
    fn kind(&self) -> FeatureKind;

    /// Candidates for points of features, in the order of samples, at least as strong as the lower
    /// threshold; notes say at which scale and how they were found.
    ///
    /// # Errors
    /// [`Error::Image`] for an image that has no such features, [`Error::Feature`] for wishes that
    /// cannot be met.
    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>>;

    /// The least area of a sheet that is worth cells, in squares of the least distance between atoms
    /// (in 2-D its length, in such distances).
    fn min_surface_cells(&self) -> f64 {
        2.0
    }

    /// The share of a small sheet that is as strong as its seeds must be, or it is noise.
    fn min_strong_share(&self) -> f64 {
        0.0
    }

    /// Parts of sheets narrower than this (samples) are worth no cells, where atoms stand at least `d_min`
    /// apart; 0 if any width is.
    fn min_width(&self, _d_min: f64) -> usize {
        0
    }

    /// Parallel sheets nearer than this, in units of the least distance between atoms, exclude one
    /// another.
    fn resolution(&self) -> f64 {
        0.9
    }

    /// How far (samples) it looks to either side where features are sought at `scale`: a part of an
    /// image has the features of the whole farther than this from where it was cut.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3
    }

    /// How far (samples), beyond three times the scale, what is found depends on the samples round it:
    /// nearer to missing traces it is not trusted.
    fn extra_reach(&self) -> f64 {
        2.0
    }

    /// Whether it needs but some layers of the image at a time.
    fn is_streamable(&self) -> bool {
        false
    }

    /// b(x), where the image says it itself.
    fn potential(&self, _image: &Image<D>) -> Option<Vec<f32>> {
        None
    }
}

/// What a detector works on.
#[derive(Debug, Clone, Copy)]
pub struct DetectorInput<'a, const D: usize> {
    /// The image, whose samples are finite and not all the same, and go on where traces are missing; in
    /// memory, unless the detector finds [in layers](Detector::is_streamable).
    pub source: ImageSource<'a, D>,
    /// Which samples hold data, unless all do.
    pub live_mask: Option<&'a LiveMask<D>>,
    /// What is asked for: scale, thresholds, what is known of an object.
    pub options: &'a DetectionOptions<D>,
    /// Of a part of an image, what was settled on for the whole.
    pub resolved: Option<&'a ResolvedOptions>,
    /// Until when it works: once this is over, what it finds is not looked at.
    pub cancel: &'a CancelToken<'a>,
}

impl<'a, const D: usize> DetectorInput<'a, D> {
    /// A whole image.
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

    /// A part of an image of which the whole was seen before.
    pub fn for_part(
        image: &'a Image<D>,
        asked: &'a DetectionOptions<D>,
        settled: &'a ResolvedOptions,
        patience: &'a CancelToken<'a>,
    ) -> Self {
        Self {
            resolved: Some(settled),
            ..Self::new(ImageSource::InMemory(image), asked, patience)
        }
    }

    /// Samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        self.source.dims()
    }

    /// The image in memory.
    ///
    /// # Errors
    /// [`Error::Feature`] if it is not there.
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

    /// The samples in memory.
    ///
    /// # Errors
    /// Those of [`DetectorInput::image_energy`].
    pub fn volume(&self) -> Result<Volume<'a, D>> {
        Ok(Volume::new(self.dims(), self.image()?.as_slice()))
    }

    /// The samples times `sign`, to be looked at some layers at a time.
    ///
    /// # Errors
    /// That of reading.
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

    /// Width (samples) of the Gaussian under which derivatives are taken, if not by noise.
    pub fn scale(&self) -> f64 {
        self.options.scale.unwrap_or(1.0)
    }

    /// The samples smoothed over [`DetectorInput::inverse_step2`], to be looked at some layers at a time.
    ///
    /// # Errors
    /// That of reading.
    pub fn smoothed_in_layers(&self) -> Result<Samples<'a, D>> {
        let mut samples = self.samples(1.0)?;
        samples.smooth(self.scale(), self.cancel);
        Ok(samples)
    }

    /// The samples smoothed over [`DetectorInput::inverse_step2`], in memory.
    ///
    /// # Errors
    /// Those of [`DetectorInput::image_energy`].
    pub fn smoothed(&self) -> Result<Vec<f32>> {
        let samples = self.image()?.as_slice();
        let (mut smoothed, scale) = (vec![0.0; samples.len()], [self.scale(); D]);
        gaussian::smooth_into(self.dims(), samples, &mut smoothed, scale, self.cancel);
        Ok(smoothed)
    }

    /// The thresholds, unless they are to be found from the image.
    pub fn thresholds(&self) -> Option<Thresholds> {
        if let Some(settled) = self.resolved {
            return Some(Thresholds {
                low: settled.low,
                high: settled.high,
                origin: "as in the whole image",
            });
        }
        self.options.threshold.map(|high| Thresholds {
            low: 0.5 * high,
            high,
            origin: "given",
        })
    }

    /// The least area of a sheet in square lattice units (in 2-D its length), where it covers `cells`
    /// squares of the distance between atoms.
    pub fn min_area(&self, cells: f64) -> f64 {
        if let Some(settled) = self.resolved {
            return settled.min_area;
        }
        let (dims, asked) = (self.dims(), self.options);
        let side = |k: usize| (dims[k] as f64 - 1.0) * asked.step[k];
        let section = (0..D)
            .map(|k| (1..D).map(|l| side((k + l) % D)).product())
            .fold(0.0, f64::max);
        // In a small image a large sheet is smaller.
        (cells * asked.d_max().powi(D as i32 - 1)).min(0.25 * section)
    }
}

/// Strengths that decide by hysteresis (Canny 1986) which candidates make features.
#[derive(Debug, Clone, Copy)]
pub struct Thresholds {
    /// Down to this a sheet is followed.
    pub low: f32,
    /// So strong a sheet is somewhere.
    pub high: f32,
    /// Where they come from, in a word or two.
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

/// What a detector finds.
#[derive(Debug, Clone)]
pub struct DetectorOutput<const D: usize> {
    /// Points that may lie on features, in the order of samples.
    pub candidates: Vec<Candidate<D>>,
    /// Where ranks share them: the layers of which this rank has all. `None` if every rank has all of all.
    pub layers: Option<Range<usize>>,
    /// Width (samples) of the Gaussian under which they were found.
    pub scale: f64,
    /// What decides which of them make sheets.
    pub thresholds: Thresholds,
    /// Typical strength of ridges over that of noise, where it was measured.
    pub signal_to_noise: Option<f32>,
    /// Whether normals are known to a few degrees, so that sheets that cross at shallow angles can be
    /// told apart by them.
    pub has_sharp_normals: bool,
    /// The value of the thin mask whose middle was sought.
    pub mask_value: Option<f32>,
    /// Of labels: which leads where, and how far apart atoms may stand.
    pub labels: Option<(LabelMap<D>, labels::LabelSpacing<D>)>,
    /// Of paths: the share of them that passes each sample.
    pub confidence: Option<Vec<f32>>,
}

impl<const D: usize> DetectorOutput<D> {
    /// Candidates of which there is no more to say.
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

    /// Takes the candidates of all ranks: from now on each has all.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn gather_candidates(&mut self, group: &dyn Comm) -> Result<Vec<Candidate<D>>> {
        let own = std::mem::take(&mut self.candidates);
        match self.layers.take() {
            Some(_) => Ok(concatenate(group.all_gather("candidates", own)?)),
            None => Ok(own),
        }
    }

    /// Drops what lies where traces are missing, or so near that smoothing mixes what is beside them
    /// with what only continues it.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn drop_near_missing_data(
        &mut self,
        image: &Image<D>,
        beyond_smoothing: f64,
        notes: &mut Vec<String>,
        group: &dyn Comm,
    ) -> Result<()> {
        let reach = (3.0 * self.scale).ceil() + beyond_smoothing;
        let near = image.rows_near_missing(reach);
        if near.is_empty() {
            return Ok(());
        }
        let row = |c: &Candidate<D>| c.voxel.index() / image.dims()[0];
        let dropped = self.candidates.iter().map(row);
        let mut dropped = dropped.filter(|&r| near[r] && !image.missing[r]).count();
        if self.layers.is_some() {
            dropped = group
                .all_gather("candidates dropped", dropped)?
                .iter()
                .sum();
        }
        self.candidates.retain(|c| !near[row(c)]);
        notes.push(format!(
            "{dropped} candidates dropped as they lie within {reach} samples of missing traces"
        ));
        Ok(())
    }
}

/// A detector and what is asked of it.
pub type DetectorTask<const D: usize> = (&'static dyn Detector<D>, DetectionOptions<D>);

/// The detectors to use; and, where the image decided on one, why.
pub type DetectorSelection<const D: usize> = (Vec<DetectorTask<D>>, Option<SelectionReason>);

/// Why an image has the features that were chosen.
pub struct SelectionReason {
    /// A line for the report.
    pub note: String,
    /// What the image leaves open.
    pub doubt: Option<Doubt>,
}

/// The detector of one kind: none is that of [`FeatureKind::Auto`], which is a choice, nor of
/// [`FeatureKind::FaultsAndHorizons`], which takes two.
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

/// The detectors of what is asked for; and, where the image decided on one, why.
///
/// # Errors
/// [`Error::Feature`] if the image decided on features that the threshold does not apply to.
pub fn select_detectors<const D: usize>(
    image: &Image<D>,
    asked: &DetectionOptions<D>,
) -> Result<DetectorSelection<D>> {
    match requested_detectors(asked) {
        Some(parts) => Ok((parts, None)),
        None => selection_from_choice(
            auto::choose(image, asked.modality.or_detect(&image.geometry))?,
            asked,
        ),
    }
}

/// The detectors of what is asked for, unless the image decides.
pub fn requested_detectors<const D: usize>(
    asked: &DetectionOptions<D>,
) -> Option<Vec<DetectorTask<D>>> {
    match asked.kind {
        FeatureKind::FaultsAndHorizons => Some(faults_and_horizons::detector_tasks(asked)),
        kind => detector_for(kind).map(|detector| vec![(detector, asked.clone())]),
    }
}

/// The detector that an image decided on, and why.
///
/// # Errors
/// [`Error::Feature`] if the threshold asked for does not apply to its features.
pub fn selection_from_choice<const D: usize>(
    choice: auto::DetectorChoice<D>,
    asked: &DetectionOptions<D>,
) -> Result<DetectorSelection<D>> {
    let auto::DetectorChoice {
        detector,
        reason: why,
        doubt,
    } = choice;
    let kind = detector.kind();
    match asked.threshold {
        Some(threshold) if matches!(kind, FeatureKind::Labels | FeatureKind::Mask) => {
            Err(Error::Feature(cause(
                format!("threshold {threshold}"),
                format!("applies to the strength of features, but the image has {kind} ({why})"),
                "omit it, or choose another kind of feature",
            )))
        }
        _ => {
            let note = format!("features: {kind} ({why})");
            let reason = SelectionReason { note, doubt };
            Ok((vec![(detector, asked.clone())], Some(reason)))
        }
    }
}

/// The detector that finds in a part of an image what it found in the whole.
///
/// # Errors
/// [`Error::Feature`] for what only the whole shows.
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

/// What the detectors found, as one.
///
/// # Errors
/// Those of other ranks.
pub fn combine_features<const D: usize>(
    found: Vec<Features<D>>,
    dims: [usize; D],
    asked: &DetectionOptions<D>,
) -> Result<Features<D>> {
    let mut found = found.into_iter();
    Ok(match (found.next(), found.next()) {
        (Some(faults), Some(horizons)) => {
            faults_and_horizons::combine(faults, horizons, asked.weights)?
        }
        (Some(only), None) => only,
        _ => Features::empty(dims, asked),
    })
}
