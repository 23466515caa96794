//! The options of `atomesh surface`, as one value.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::error::cause;
use crate::feature::FeatureKind;
use crate::image::formats::InputOptions;
use crate::job::MeshSpec;
use crate::model::surface::GroupingOptions;
use crate::option_text::{NumberOrFile, ThresholdValues};
use crate::surface_file::FileOption;
use crate::{Error, Result};

/// Options of `atomesh surface`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SurfaceSpec {
    /// An image; faces on its features are used and not those that the mesh declares
    #[arg(value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// Options that group faces into surfaces.
    #[command(flatten)]
    pub grouping: GroupingOptions,
    /// The criterion by which faces form a surface
    #[arg(long, value_name = "WHAT", default_value_t, value_enum)]
    pub by: GroupBy,
    /// Smallest area of a surface, in square samples (length in 2-D); smaller ones are omitted, and
    /// 0 keeps all [default: ten faces, and 2 % of the largest surface]
    #[arg(long, value_name = "AREA", allow_negative_numbers = true)]
    pub min_area: Option<f64>,
    /// The number of the surface that becomes a grid or points, as in the printed table [default: all
    /// horizons, with a file each]
    #[arg(long, value_name = "N")]
    pub number: Option<usize>,
    /// Distance between sticks, or between the nodes of a grid, in the unit of x [default: ten
    /// sticks per fault; for a grid the bins of the survey, or about the length of the surface's edges]
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true)]
    pub step: Option<f64>,
    /// Surfaces of an earlier interpretation, whose names the surfaces at the same place get: .vtp,
    /// .ts, .obj, grids, sticks or points, and what the file does not say, as for mesh --surface. All
    /// other surfaces get numbers that no earlier name has
    #[arg(long, value_name = "FILE[:NAME][,unit=U][,z=up|down]")]
    pub names_from: Option<FileOption>,
    /// Also write the mesh with the names of these surfaces, which every verb then uses
    #[arg(long, value_name = "NAMED.vtu")]
    pub mesh_out: Option<PathBuf>,
    /// Show in the table which surfaces meet (--json always does)
    #[arg(long)]
    pub meets: bool,
    /// The image of amplitudes that was meshed. It gives throw of faults, polarity of horizons, and
    /// confidence; its lines number points, and its bins are the nodes of grids
    #[arg(long, value_name = "IMAGE")]
    pub survey: Option<PathBuf>,
    /// Smallest confidence of a fault or horizon in the survey: omit those below. Noise has about 1
    #[arg(
        long,
        value_name = "C",
        allow_negative_numbers = true,
        requires = "survey"
    )]
    pub min_confidence: Option<f64>,
    /// Depth of the valleys of b(x), from 0 to 1, from which faces count as lying on the features
    /// of IMAGE [default: 0.6]
    #[arg(long, value_name = "DEPTH", requires = "image")]
    pub depth: Option<f64>,
    /// The features to detect in IMAGE [default: auto]
    #[arg(long, value_name = "KIND", requires = "image")]
    pub feature: Option<FeatureKind>,
    /// Scale of the features, in samples [default: depends on the kind of feature]
    #[arg(long, value_name = "S", requires = "image")]
    pub sigma: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image; for an isosurface, its value, or
    /// several values in ascending order with commas between them [default: automatic; it is printed]
    #[arg(
        long,
        value_name = "T[,T]",
        allow_hyphen_values = true,
        requires = "image"
    )]
    pub threshold: Option<ThresholdValues>,
    /// Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s for the whole mesh, or a
    /// file of interval velocities in m/s on a grid in two-way time
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The criterion by which faces form a surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum GroupBy {
    /// Faces on features that continue one another: faults, horizons
    #[default]
    Bends,
    /// All faces between the same two regions, or between a region and the sides of the mesh; the
    /// faces of a region enclose it
    Regions,
}

impl SurfaceSpec {
    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible or has no
    /// effect.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        self.grouping.options(self.min_area)?;
        if let Some(step) = self.step.filter(|step| !(step.is_finite() && *step > 0.0)) {
            let remedy = "give a length above 0, in the unit of x";
            return Err(Error::Job(cause(
                format!("step {step}"),
                "is not a distance",
                remedy,
            )));
        }
        if let Some(depth) = self.depth.filter(|depth| !(*depth > 0.0 && *depth < 1.0)) {
            let remedy = "give a number above 0 and below 1; 0.6 is the default";
            return Err(Error::Job(cause(
                format!("depth {depth}"),
                "is out of range",
                remedy,
            )));
        }
        if let Some(confidence) = self.min_confidence {
            let place = || format!("min-confidence {confidence}");
            if !(confidence.is_finite() && confidence >= 0.0) {
                let remedy = "give 0 or more; noise has about 1";
                return Err(Error::Job(cause(place(), "is out of range", remedy)));
            }
            if self.survey.is_none() {
                let problem = "needs the amplitudes in which confidence is measured";
                return Err(Error::Job(cause(place(), problem, "give them as survey")));
            }
        }
        if self.by == GroupBy::Regions
            && (self.image.is_some()
                || self.survey.is_some()
                || self.min_area.is_some()
                || self.names_from.is_some()
                || self.mesh_out.is_some()
                || self.meets)
        {
            let problem = "is not for surfaces between regions, all of which are written";
            let remedy = "omit images, the smallest area, names, and which surfaces meet";
            return Err(Error::Job(cause("by regions", problem, remedy)));
        }
        if self.image.is_some() {
            return self.detection().validate();
        }
        let detection = [
            ("depth", self.depth.is_some()),
            ("feature", self.feature.is_some()),
            ("sigma", self.sigma.is_some()),
            ("threshold", self.threshold.is_some()),
        ];
        if let Some((option, _)) = detection.iter().find(|option| option.1) {
            let problem = "is about the features of an image, but none is given";
            return Err(Error::Job(cause(
                option,
                problem,
                "give an image, or omit it",
            )));
        }
        if self.survey.is_none() {
            return self
                .input
                .refuse_unused("no image is given", "omit it, or give the image");
        }
        if let Some(NumberOrFile::File(path)) = &self.velocity {
            let place = format!("velocity {}", path.display());
            let problem = "moves the mesh, but amplitudes are given in time";
            let remedy =
                "give one velocity in m/s, or mesh the image in depth (mesh --velocity FILE)";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        Ok(())
    }

    /// Returns the options of feature detection.
    pub(crate) fn detection(&self) -> MeshSpec {
        MeshSpec {
            feature: self.feature.unwrap_or(FeatureKind::Auto),
            sigma: self.sigma,
            threshold: self.threshold.clone(),
            ..MeshSpec::default()
        }
    }
}
