//! Detectors find candidates for feature points in an image; one file per kind of feature.
//!
//! To add a detector:
//! 1. Write `impl Detector` for a unit struct in a file of this folder. Its methods say all that
//!    other parts of the program need to know about the kind.
//! 2. Add `mod` for the file, and an entry with help text, name and detector to `feature_kinds!`.
//!
//! - `ridges`: surfaces of high values, or of low ones (valleys)
//! - `edges`: ridges of Prewitt's gradient magnitude
//! - `canny`: maxima of the gradient magnitude along the gradient
//! - `isosurface`: surfaces on which the image has a given value
//! - `value_regions`: the regions between values
//! - `labels`: interfaces between labels
//! - `masks`: the medial surface of thin masks
//! - `label_gaps`: thickness of labels at their interfaces
//! - `label_slices`: labels between slices that are far apart
//! - `label_smoothing`: winning label of each sample after smoothing
//! - `horizons`: crests and troughs of seismic amplitude
//! - `faults`: places where layers of seismic amplitude do not continue
//! - `faults_and_horizons`: both, in one potential
//! - `potential`: an image that is b(x) itself
//! - `input`, `output`: what detectors get and return
//! - `selection`: the detectors for the options
//! - `auto`: choice of the kind that fits an image
//! - `paths`: the boundary of one object, by random shortest paths
//!
//! Widths of Gaussians, windows and reaches are in samples, whatever the step of lattice space.
//! Positions and normals are converted to lattice space when candidates are grouped into surfaces.

pub(crate) mod auto;
pub(crate) mod canny;
pub(crate) mod edges;
pub(crate) mod faults;
pub(crate) mod faults_and_horizons;
pub(crate) mod horizons;
mod input;
pub(crate) mod isosurface;
pub(crate) mod label_gaps;
pub(crate) mod label_slices;
pub(crate) mod label_smoothing;
pub(crate) mod labels;
pub(crate) mod masks;
mod output;
pub(crate) mod paths;
pub(crate) mod potential;
pub(crate) mod ridges;
mod selection;
pub(crate) mod value_regions;

pub(super) use input::DetectorInput;
pub(super) use output::{DetectorOutput, Thresholds};
pub(super) use selection::{
    DetectorTask, SelectionReason, combine_features, detector_for, detector_for_part,
    requested_detectors, select_detectors, selection_from_choice,
};

use super::candidate::Voxel;
use super::detection::MAX_IN_MEMORY_SAMPLES;
use super::oriented::FILTER_HALO_LAYERS;
use super::windows;
use crate::error::{Error, Result, cause};
use crate::files::codec::codec_variants;
use crate::image::{Image, ImageSource};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Defines [`FeatureKind`] from one table. An entry has the help text of a kind, its variant, its
/// name on the command line and in files, and its detectors.
macro_rules! feature_kinds {
    ($($(#[$help:meta])* $kind:ident = $name:tt [$($detector:expr),*];)+) => {
        /// Kinds of features. The doc comments of the variants are help texts of the command line.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
        pub enum FeatureKind {
            $(
                $(#[$help])*
                #[serde(rename = $name)]
                #[value(name = $name)]
                $kind,
            )+
        }

        impl FeatureKind {
            /// All kinds, in the order of the help text.
            const ALL: &[Self] = &[$(Self::$kind),+];

            /// Returns the name on the command line and in files.
            const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name),+
                }
            }

            /// Returns the detectors that find features of this kind. [`FeatureKind::Auto`], which
            /// is a choice, and [`FeatureKind::NoFeatures`] have none.
            pub(crate) fn detectors<const D: usize>(self) -> &'static [&'static dyn Detector<D>] {
                match self {
                    $(Self::$kind => &[$(&$detector),*]),+
                }
            }
        }

        codec_variants! {
            FeatureKind { $($kind),+ }
        }
    };
}

feature_kinds! {
    /// Chosen by what the image looks like; the report says which
    Auto = "auto" [];
    /// Bright surfaces: fault images, fractures, membranes
    Ridges = "ridges" [ridges::Ridges(Brightness::Bright)];
    /// Dark surfaces
    Valleys = "valleys" [ridges::Ridges(Brightness::Dark)];
    /// Steps of brightness
    Edges = "edges" [edges::Edges];
    /// Steps of brightness, by non-maximum suppression and hysteresis
    Canny = "canny" [canny::Canny];
    /// Closed regions below and above the value of --threshold, such as 300 HU for bone in CT images,
    /// or between several; without it, that of Otsu's threshold
    Isosurface = "isosurface" [isosurface::Isosurface];
    /// The boundary of an object, by random shortest paths (2-D; needs a point of the object)
    Paths = "paths" [paths::Paths];
    /// Peaks and troughs of seismic amplitude along the bedding's normal
    Horizons = "horizons" [horizons::Horizons];
    /// Places where layers of seismic amplitude are broken
    Faults = "faults" [faults::Faults];
    /// Faults and horizons, each with its weight
    FaultsAndHorizons = "faults+horizons" [faults::Faults, horizons::Horizons];
    /// Interfaces between labels
    Labels = "labels" [labels::Labels];
    /// The middle of a mask of thin objects, as interpreters paint faults
    Mask = "mask" [masks::Masks];
    /// The image is b(x) already: -1 on features, 0 elsewhere
    Potential = "potential" [potential::Potential];
    /// None: a plain box of well-shaped cells, also of a constant image, or a mesh that follows only
    /// the surfaces that are given
    NoFeatures = "none" [];
}

impl FeatureKind {
    /// Returns the detector that gives the properties of the kind, or `None` if the image decides
    /// on the detector. These properties must be the same for all detectors of a kind, and in 2-D
    /// and 3-D.
    fn first_detector(self) -> Option<&'static dyn Detector<3>> {
        self.detectors().first().copied()
    }

    /// Returns the meaning of the option `threshold`.
    pub(crate) fn threshold_meaning(self) -> ThresholdMeaning {
        self.first_detector()
            .map_or(ThresholdMeaning::MinStrength, |detector| {
                detector.threshold_meaning()
            })
    }

    /// Returns `true` if samples are labels, between which no value makes sense.
    pub(crate) fn has_labels(self) -> bool {
        self.first_detector()
            .is_some_and(|detector| detector.has_labels())
    }

    /// Returns the brightness of the features, if they differ from their surroundings by it.
    pub(crate) fn brightness(self) -> Option<Brightness> {
        self.first_detector()?.brightness()
    }

    /// Returns the effect of choosing this kind where the image leaves open whether it is right.
    pub(crate) fn suggestion_in_doubt(self) -> Option<&'static str> {
        Some(self.first_detector()?.suggestion_in_doubt())
    }

    /// Returns the memory, in bytes per rank, that the search for features takes besides an image
    /// in memory.
    pub(crate) fn search_bytes<const D: usize>(
        self,
        source: ImageSource<'_, D>,
        ranks: usize,
    ) -> f64 {
        let detectors = self.detectors().iter();
        // Detectors run one after the other.
        detectors
            .map(|detector| detector.search_bytes(source, ranks))
            .reduce(f64::max)
            .unwrap_or_else(|| image_search_bytes(source))
    }
}

impl fmt::Display for FeatureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for FeatureKind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let mut kinds = Self::ALL.iter().copied();
        kinds.find(|kind| kind.name() == name).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|kind| kind.name()).collect();
            Error::Feature(cause(
                format!("feature '{name}'"),
                "is not known",
                format!("choose one of {}", names.join(", ")),
            ))
        })
    }
}

/// Meaning of the option `threshold` for a kind of feature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThresholdMeaning {
    /// Smallest strength of a feature.
    MinStrength,
    /// Value of the image on a feature.
    Level,
    /// None: features of this kind have no strength.
    Unused,
}

/// Brightness of features, compared with their surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Brightness {
    /// Values on features are higher.
    Bright,
    /// Values on features are lower.
    Dark,
}

/// Memory (bytes) per sample of an image in memory: the smoothed samples, and some more.
const BYTES_PER_SAMPLE: f64 = 8.0;
/// Memory (bytes) per sample of a layer, if layers are read one after the other: the layers within
/// reach of ridges.
const BYTES_PER_LAYER_SAMPLE: f64 = 450.0;
/// Memory (bytes) per sample of a layer of a strip, within twice the reach of oriented filters.
const BYTES_PER_STRIP_SAMPLE: f64 = 1_400.0;

/// Returns the memory, in bytes, that a search of an image takes besides an image in memory.
fn image_search_bytes<const D: usize>(source: ImageSource<'_, D>) -> f64 {
    match source {
        ImageSource::InMemory(_) => BYTES_PER_SAMPLE * sample_count(source.dims()),
        ImageSource::Layered(_) => layers_search_bytes(source.dims()),
    }
}

/// Returns the memory, in bytes, that a search of some layers at a time takes.
fn layers_search_bytes<const D: usize>(dims: [usize; D]) -> f64 {
    let layer: f64 = dims[..D - 1].iter().map(|&n| n as f64).product();
    let strip_layer = windows::strip_layer_samples(dims, FILTER_HALO_LAYERS) as f64;
    (BYTES_PER_LAYER_SAMPLE * layer).max(BYTES_PER_STRIP_SAMPLE * strip_layer)
}

/// Returns the number of samples of an image.
fn sample_count<const D: usize>(dims: [usize; D]) -> f64 {
    dims.iter().map(|&n| n as f64).product()
}

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

    /// Returns the largest number of samples of an image in which the detector finds features.
    fn max_samples(&self) -> u64 {
        if self.is_streamable() {
            Voxel::MAX_COUNT
        } else {
            MAX_IN_MEMORY_SAMPLES
        }
    }

    /// Returns the memory, in bytes per rank, that the search takes besides an image in memory.
    fn search_bytes(&self, source: ImageSource<'_, D>, _ranks: usize) -> f64 {
        image_search_bytes(source)
    }

    /// Returns the reason why features can only be found in a whole image, if that is so.
    fn whole_image_reason(&self) -> Option<&'static str> {
        None
    }

    /// Returns `true` if samples that hold no data are filled before features are searched for.
    fn fills_gaps(&self) -> bool {
        true
    }

    /// Returns `true` if samples are labels, between which no value makes sense.
    fn has_labels(&self) -> bool {
        false
    }

    /// Returns the meaning of the option `threshold`.
    fn threshold_meaning(&self) -> ThresholdMeaning {
        ThresholdMeaning::MinStrength
    }

    /// Returns the brightness of the features, if they differ from their surroundings by it.
    fn brightness(&self) -> Option<Brightness> {
        None
    }

    /// Returns `true` if the features are faults, of which the report gives the dip.
    fn is_fault(&self) -> bool {
        false
    }

    /// Returns `true` if the features are horizons, which are no barriers to flow.
    fn is_horizon(&self) -> bool {
        false
    }

    /// Returns `true` if noise scatters normals and surfaces do not cross at small angles, so that
    /// the number of its surface tells whether a point bounds a gap.
    fn has_scattered_normals(&self) -> bool {
        false
    }

    /// Returns the effect of choosing this kind where the image leaves open whether it is right,
    /// and the option that confirms the other kind.
    fn suggestion_in_doubt(&self) -> &'static str {
        "follows these features instead"
    }

    /// Returns b(x) if the image itself is the potential.
    fn potential(&self, _image: &Image<D>) -> Option<Vec<f32>> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_the_same_names_everywhere() {
        for &kind in FeatureKind::ALL {
            let name = kind.to_string();
            assert_eq!(name.parse::<FeatureKind>().unwrap(), kind);
            assert_eq!(serde_json::to_value(kind).unwrap(), name);
            let value = clap::ValueEnum::to_possible_value(&kind).unwrap();
            assert_eq!(value.get_name(), name);
            assert!(value.get_help().is_some(), "{name}");
        }
        let message = "ridge".parse::<FeatureKind>().unwrap_err().to_string();
        assert!(
            message.contains("'ridge'") && message.contains("ridges"),
            "{message}"
        );
    }

    #[test]
    fn detectors_of_a_kind_agree() {
        fn properties<const D: usize>(detector: &dyn Detector<D>) -> impl PartialEq + fmt::Debug {
            (
                detector.threshold_meaning(),
                detector.has_labels(),
                detector.brightness(),
                detector.suggestion_in_doubt(),
            )
        }
        for &kind in FeatureKind::ALL {
            let (plane, space) = (kind.detectors::<2>(), kind.detectors::<3>());
            assert_eq!(plane.len(), space.len());
            for (plane, space) in plane.iter().zip(space) {
                let expected = format!("{:?}", properties(kind.detectors::<3>()[0]));
                assert_eq!(format!("{:?}", properties(*plane)), expected, "{kind}");
                assert_eq!(format!("{:?}", properties(*space)), expected, "{kind}");
                if space.kind() == kind {
                    assert_eq!(kind.detectors::<3>().len(), 1);
                }
            }
        }
    }
}
