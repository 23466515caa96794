//! Images to files, in the format that the ending names: whole, or part by part.

use std::path::Path;

use super::samples::SampleType;
use super::stream::SlabSource;
use super::{
    ImageFormat, LineNumbers, extension, grids, metaimage, nifti, npy, nrrd, png, raw, vti, zarr,
};
use crate::error::{Error, Result, cause};
use crate::image::{Geometry, Image};

/// Writes an image in the format that the ending of `path` names.
///
/// # Errors
/// [`Error::Io`] if the ending is unknown or the file cannot be written.
pub fn write<const D: usize>(path: &Path, image: &Image<D>) -> Result<()> {
    write_survey(path, image, None)
}

/// The same of a survey, whose line numbers are written where the format has a place for them.
///
/// # Errors
/// As [`write`].
pub(crate) fn write_survey<const D: usize>(
    path: &Path,
    image: &Image<D>,
    lines: Option<[LineNumbers; 2]>,
) -> Result<()> {
    match (extension(path).as_str(), D) {
        ("vti", _) => vti::write(path, &image.to_3d(), "samples"),
        ("mha", _) => metaimage::write(path, image),
        ("irap", 2) => grids::write(path, image, ImageFormat::Irap),
        ("zmap", 2) => grids::write(path, image, ImageFormat::Zmap),
        ("cps3", 2) => grids::write(path, image, ImageFormat::Cps3),
        ("png", 2) => png::write(path, &image.to_3d().flatten()),
        (ending, _) if STREAMED_EXTENSIONS.contains(&ending) => {
            let whole = StreamedImage {
                dims: image.dims(),
                geometry: &image.geometry,
                missing: &image.missing,
                line_numbers: lines,
                sample_type: SampleType::F32,
                slabs: image,
            };
            whole.write(path)
        }
        (other, _) => Err(Error::Io(cause(
            path.display(),
            format!("{D}-D images cannot be written with the ending '.{other}'"),
            match D {
                2 => "use .png, .npy, .vti, .nrrd, .mha, .nii, .zarr, .raw, .irap, .zmap or .cps3",
                _ => "use .npy, .vti, .nrrd, .mha, .nii, .nii.gz, .zarr or .raw",
            },
        ))),
    }
}

/// Endings of the formats that are written part by part, of images that may be larger than memory.
const STREAMED_EXTENSIONS: [&str; 7] = ["npy", "raw", "bin", "nii", "nii.gz", "nrrd", "zarr"];

/// Whether what this ending names is written part by part.
#[cfg(feature = "cli")]
pub(crate) fn can_stream(path: &Path) -> bool {
    STREAMED_EXTENSIONS.contains(&extension(path).as_str())
}

/// An image to be written part by part.
pub(crate) struct StreamedImage<'a, const D: usize> {
    /// Samples along each axis, x first.
    pub dims: [usize; D],
    /// Where they lie.
    pub geometry: &'a Geometry<D>,
    /// Which rows hold no data, as [`Image::missing`] has it.
    pub missing: &'a [bool],
    /// Numbers of the inlines and crosslines of a survey.
    pub line_numbers: Option<[LineNumbers; 2]>,
    /// The type that holds them, where it is known.
    pub sample_type: SampleType,
    /// The samples.
    pub slabs: &'a dyn SlabSource,
}

impl<const D: usize> StreamedImage<'_, D> {
    /// Writes it, in one of the formats that [`can_stream`] knows.
    ///
    /// # Errors
    /// As [`write`].
    pub fn write(&self, path: &Path) -> Result<()> {
        match extension(path).as_str() {
            "npy" => npy::write(path, &self.dims, self.slabs),
            "nii" | "nii.gz" => nifti::write(path, self.dims, self.geometry, self.slabs),
            "nrrd" => nrrd::write(path, self.dims, self.geometry, self.slabs),
            "zarr" => zarr::write(path, self),
            _ => raw::write(path, self.slabs),
        }
    }
}
