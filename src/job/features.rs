//! Detects the features of an image, as `atomesh feature` does.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::MeshSpec;
use super::output::lines::write_feature_lines;
use super::output::points::write_feature_points;
use super::spec::{FeatureWeights, NominalDistance, PointValue, ThresholdValues};
use crate::error::cause;
use crate::feature::{
    DetectionOptions, FaultEvidence, FeatureKind, FeatureLine, Features, LineKind, MIN_FAULT_DIP,
    MIN_LENGTH, SharedGrid, detect_with_cancel, lines_with_cancel,
};
use crate::files::output::{check_output, file_report};
use crate::image::formats::{self, IMAGE_EXTENSIONS, InputOptions, LoadedImage};
use crate::image::{Geometry, Image, ImageSource, Modality};
use crate::progress::{CancelToken, Progress, Stage};
use crate::{Error, Result};

/// Options of `atomesh feature`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FeatureSpec {
    /// Also write the lines (in 2-D points) at which features cross, branch off one another and
    /// end, with the angle and the two feature surfaces: .vtp
    #[arg(long, value_name = "LINES.vtp")]
    pub lines: Option<PathBuf>,
    /// Also write the feature points with normal, strength and surface: .csv or .vtp
    #[arg(long, value_name = "POINTS.csv")]
    pub points: Option<PathBuf>,
    /// The features to find
    #[arg(long, value_name = "KIND", default_value = "auto")]
    pub feature: FeatureKind,
    /// Nominal distance between atoms, in samples. The valleys of the potential are a quarter as
    /// wide
    #[arg(long, value_name = "D", default_value_t = Self::default().distance)]
    pub distance: f64,
    /// Scale of the features, in samples [default: depends on the kind of feature]
    #[arg(long, value_name = "S")]
    pub sigma: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image; for an isosurface, its value, or
    /// several values in ascending order with commas between them [default: automatic; it is printed]
    #[arg(long, value_name = "T[,T]", allow_hyphen_values = true)]
    pub threshold: Option<ThresholdValues>,
    /// How faults are recognised in seismic amplitudes
    #[arg(long, value_name = "EVIDENCE", default_value_t, value_enum)]
    pub fault_evidence: FaultEvidence,
    /// Smallest dip of a fault, in degrees; two-way time is converted to depth at 2,000 m/s
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().min_dip)]
    pub min_dip: f64,
    /// Smallest size of a fault in samples, whatever the distance between atoms: its area is at least
    /// the square of it, in 2-D its length [default: 20]
    #[arg(long, value_name = "SAMPLES")]
    pub min_fault_size: Option<f64>,
    /// Seek faults and horizons in chaotic zones (salt, gas chimneys), too
    #[arg(long)]
    pub keep_chaos: bool,
    /// Weights F,H of faults and horizons, each in (0, 1], if both are followed
    #[arg(long, value_name = "F,H", default_value_t)]
    pub feature_weights: FeatureWeights,
    /// A point of the object, in physical coordinates, for --feature paths; may be repeated
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub object: Vec<PointValue>,
    /// A point of the background, for --feature paths; may be repeated [default: the image's
    /// outermost samples]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub background: Vec<PointValue>,
    /// Also write the fraction of paths that passes through each sample, for --feature paths: .vti,
    /// .npy, .nrrd, .mha, .nii or .png
    #[arg(long, value_name = "OUT.png")]
    pub confidence_out: Option<PathBuf>,
    /// Seed of the random numbers, for --feature paths
    #[arg(long, value_name = "N", default_value_t = Self::default().rng_seed)]
    pub rng_seed: u64,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

impl Default for FeatureSpec {
    fn default() -> Self {
        Self {
            lines: None,
            points: None,
            feature: FeatureKind::Auto,
            distance: 8.0,
            sigma: None,
            threshold: None,
            fault_evidence: FaultEvidence::default(),
            min_dip: MIN_FAULT_DIP,
            min_fault_size: None,
            keep_chaos: false,
            feature_weights: FeatureWeights::default(),
            object: Vec::new(),
            background: Vec::new(),
            confidence_out: None,
            rng_seed: 1,
            input: InputOptions::default(),
        }
    }
}

impl FeatureSpec {
    /// Checks the options, and that the outputs have the right endings and replace neither the image
    /// nor the potential.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, image: &Path, output: &Path) -> Result<()> {
        check_output(output, "--output", &IMAGE_EXTENSIONS, &[image])?;
        let others = [
            (&self.lines, "--lines", &["vtp"][..]),
            (&self.points, "--points", &["csv", "vtp"]),
            (&self.confidence_out, "--confidence-out", &IMAGE_EXTENSIONS),
        ];
        for (path, option, endings) in others {
            if let Some(path) = path {
                check_output(path, option, endings, &[image, output])?;
            }
        }
        self.validate()
    }

    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible or has no
    /// effect.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        let refuse =
            |place: String, problem, remedy| Err(Error::Job(cause(place, problem, remedy)));
        if !(self.distance > 0.0 && self.distance.is_finite()) {
            let place = format!("distance {}", self.distance);
            return refuse(place, "is not positive", "give a few samples");
        }
        if self.confidence_out.is_some() && self.feature != FeatureKind::Paths {
            let problem = "applies to --feature paths only";
            return refuse(
                "confidence-out".into(),
                problem,
                "add --feature paths, or omit it",
            );
        }
        self.mesh_spec().validate()
    }

    /// Returns the options as those of a mesh job.
    fn mesh_spec(&self) -> MeshSpec {
        MeshSpec {
            distance: NominalDistance::Constant(self.distance),
            feature: self.feature,
            sigma: self.sigma,
            threshold: self.threshold.clone(),
            fault_evidence: self.fault_evidence,
            min_dip: self.min_dip,
            min_fault_size: self.min_fault_size,
            keep_chaos: self.keep_chaos,
            feature_weights: self.feature_weights,
            object: self.object.clone(),
            background: self.background.clone(),
            rng_seed: self.rng_seed,
            input: self.input.clone(),
            ..MeshSpec::default()
        }
    }
}

/// The features of an image.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FeatureOutcome<const D: usize> {
    /// The features, with the potential b(x). Positions are in samples.
    pub features: Features<D>,
    /// The lines at which features meet and end, if the options ask for them.
    pub lines: Option<Vec<FeatureLine<D>>>,
}

/// Detects the features of an image and computes the potential b(x), as `atomesh feature` does.
///
/// ```
/// use atomesh::image::synth::{self, SyntheticKind};
/// use atomesh::progress::NoProgress;
/// use atomesh::FeatureSpec;
///
/// let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let spec = FeatureSpec { distance: 6.0, ..FeatureSpec::default() };
/// let outcome = atomesh::features(&image.into(), &spec, &mut NoProgress)?;
/// assert!(outcome.features.points.len() > 500);
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns the errors of [`FeatureSpec::validate`] and [`detect`](crate::feature::detect), and
/// [`Error::Interrupted`] if `progress` stops the search.
pub fn features<const D: usize>(
    image: &LoadedImage<D>,
    spec: &FeatureSpec,
    progress: &mut dyn Progress,
) -> Result<FeatureOutcome<D>> {
    spec.validate()?;
    let mut options = spec.mesh_spec().detection_options([1.0; D])?;
    options.modality = Modality::detect(image.format, &image.image.geometry);
    progress.stage(Stage::Features);
    let callback = &mut |fraction: Option<f64>| {
        if let Some(fraction) = fraction {
            progress.fraction_done(fraction);
        }
        progress.keep_going()
    };
    CancelToken::run_with_progress(callback, |cancel| {
        let features = detect_in_one_process(&image.image, &options, cancel)?;
        let find_lines = || lines_with_cancel(&features, cancel);
        let lines = spec.lines.as_ref().map(|_| find_lines()).transpose()?;
        Ok(FeatureOutcome { features, lines })
    })
}

/// Detects the features of an image as [`detect`](crate::feature::detect) does, until `cancel` is
/// cancelled.
///
/// # Errors
/// Returns the errors of [`detect`](crate::feature::detect), and [`Error::Interrupted`] if `cancel` is
/// cancelled.
pub(crate) fn detect_in_one_process<const D: usize>(
    image: &Image<D>,
    options: &DetectionOptions<D>,
    cancel: &CancelToken<'_>,
) -> Result<Features<D>> {
    let grid = SharedGrid::of_one_process(image.dims());
    detect_with_cancel(ImageSource::InMemory(image), options, grid, cancel)
}

impl<const D: usize> FeatureOutcome<D> {
    /// Writes the files beside the potential that the options name. Returns a line for each file of
    /// lines and points: its name, and what it holds.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if a file cannot be written.
    pub fn write_others(&self, spec: &FeatureSpec, geometry: &Geometry<D>) -> Result<Vec<String>> {
        let features = &self.features;
        if let (Some(path), Some(confidence)) = (&spec.confidence_out, &features.confidence) {
            formats::write(path, &confidence.clone().into_image(geometry))?;
        }
        let mut files = Vec::new();
        if let (Some(path), Some(lines), Some((summary, _))) =
            (&spec.lines, &self.lines, self.lines_summary())
        {
            write_feature_lines(path, lines, |x| geometry.to_physical(x))?;
            files.push(format!("{}: {summary}", path.display()));
        }
        if let Some(path) = &spec.points {
            write_feature_points(path, features, geometry)?;
            files.push(format!(
                "{}: {} points",
                path.display(),
                features.points.len()
            ));
        }
        Ok(files)
    }

    /// Returns the number of samples and of feature points, the scales, and the lines as JSON.
    pub fn to_json(&self, spec: &FeatureSpec) -> Value {
        let lines = spec.lines.as_deref().zip(self.lines_summary());
        json!({
            "dims": self.features.potential.dims.to_vec(),
            "points": self.features.points.len(),
            "sigma": self.features.sigma,
            "notes": self.features.notes,
            "lines": lines.map(|(path, (_, counts))| file_report(path, counts)),
        })
    }

    /// Returns the number and the total length of the lines of each kind in one line of text, and as
    /// JSON; `None` without lines.
    pub fn lines_summary(&self) -> Option<(String, Value)> {
        let lines = self.lines.as_ref()?;
        let (mut text, mut json) = (String::new(), Map::new());
        for (name, kind) in [
            ("crossings", LineKind::Crossing),
            ("branches", LineKind::Branch),
            ("tips", LineKind::Tip),
        ] {
            let lines = lines.iter().filter(|line| line.kind == kind);
            let (count, length) = lines.fold((0, 0.0), |(count, length), line| {
                (count + 1, length + line.length)
            });
            let separator = if text.is_empty() { "" } else { ", " };
            let _ = write!(text, "{separator}{name} {count}");
            if D > 2 {
                let _ = write!(text, " ({length:.0} samples long)");
            }
            json.insert(name.into(), json!({ "count": count, "length": length }));
        }
        if D > 2 {
            let _ = write!(
                text,
                "; lines shorter than {MIN_LENGTH:.0} samples are omitted"
            );
        }
        Some((text, Value::Object(json)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_options_are_refused_by_name() {
        let negative = FeatureSpec {
            distance: -1.0,
            ..FeatureSpec::default()
        };
        let without_paths = FeatureSpec {
            confidence_out: Some("c.png".into()),
            ..FeatureSpec::default()
        };
        let flat_scale = FeatureSpec {
            sigma: Some(0.0),
            ..FeatureSpec::default()
        };
        for (spec, expected) in [
            (negative, "distance -1: is not positive"),
            (without_paths, "confidence-out: applies to --feature paths"),
            (flat_scale, "sigma 0: is not a positive number"),
        ] {
            let error = spec.validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        FeatureSpec::default().validate().unwrap();
    }
}
