//! Distinguishes seismic surveys from scans by the format and the geometry of an image.

use super::Geometry;
use super::formats::ImageFormat;
use super::time::seconds_per_unit;

/// Kind of measurement or model that an image holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Modality {
    /// A seismic survey: amplitudes, their attributes, or interpretations of them.
    Survey,
    /// A scan of a body or a specimen (tomography, microscopy), or its labels.
    Scan,
    /// Neither the format nor the geometry identifies the source.
    #[default]
    Unknown,
}

/// Names of axes that only surveys have, in lower case.
const SURVEY_AXES: [&str; 7] = [
    "inline",
    "crossline",
    "xline",
    "iline",
    "trace",
    "twt",
    "cdp",
];

/// Units of length in which scans are measured.
const SCAN_UNITS: [&str; 8] = [
    "mm",
    "um",
    "nm",
    "cm",
    "\u{b5}m",
    "\u{3bc}m",
    "micron",
    "micrometer",
];

impl Modality {
    /// Determines the modality from the format and the geometry of a file. SEG-Y, and time or line
    /// numbers among the coordinates, indicate a survey; formats of medicine and microscopy, and
    /// units of length below a metre, indicate a scan.
    pub fn detect<const D: usize>(format: ImageFormat, geometry: &Geometry<D>) -> Self {
        match format {
            ImageFormat::Segy => Self::Survey,
            _ if geometry.modality() == Self::Survey => Self::Survey,
            ImageFormat::Nifti
            | ImageFormat::MetaImage
            | ImageFormat::Nrrd
            | ImageFormat::Tiff
            | ImageFormat::Dicom
            | ImageFormat::SliceFolder
            | ImageFormat::Inrimage => Self::Scan,
            _ => geometry.modality(),
        }
    }
}

impl Modality {
    /// Returns the modality, detected from the geometry if it is unknown.
    pub(crate) fn or_detect<const D: usize>(self, geometry: &Geometry<D>) -> Self {
        match self {
            Self::Unknown => geometry.modality(),
            known => known,
        }
    }
}

impl<const D: usize> Geometry<D> {
    /// Returns the modality that the units and names of the axes indicate.
    pub fn modality(&self) -> Modality {
        let is_survey_axis = |name: &String| SURVEY_AXES.contains(&&*name.to_ascii_lowercase());
        if self
            .units
            .iter()
            .any(|unit| seconds_per_unit(unit).is_some())
            || self.names.iter().any(is_survey_axis)
        {
            return Modality::Survey;
        }
        if self
            .units
            .iter()
            .all(|unit| SCAN_UNITS.contains(&unit.as_str()))
        {
            return Modality::Scan;
        }
        Modality::Unknown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_and_geometry_tell_surveys_from_scans() {
        let bare = Geometry::<3>::default();
        assert_eq!(Modality::detect(ImageFormat::Npy, &bare), Modality::Unknown);
        assert_eq!(Modality::detect(ImageFormat::Segy, &bare), Modality::Survey);
        for format in [
            ImageFormat::Nifti,
            ImageFormat::MetaImage,
            ImageFormat::Nrrd,
            ImageFormat::Tiff,
            ImageFormat::Inrimage,
        ] {
            assert_eq!(Modality::detect(format, &bare), Modality::Scan);
        }
        let mut timed = bare.clone();
        timed.units[0] = "ms".into();
        assert_eq!(Modality::detect(ImageFormat::Vti, &timed), Modality::Survey);
        assert_eq!(
            Modality::detect(ImageFormat::Nrrd, &timed),
            Modality::Survey
        );
        let mut named = bare.clone();
        named.names[2] = "Inline".into();
        assert_eq!(named.modality(), Modality::Survey);
        let mut measured = bare.clone();
        measured.units = ["mm"; 3].map(String::from);
        assert_eq!(
            Modality::detect(ImageFormat::Vti, &measured),
            Modality::Scan
        );
        measured.units = ["m"; 3].map(String::from);
        assert_eq!(measured.modality(), Modality::Unknown);
    }
}
