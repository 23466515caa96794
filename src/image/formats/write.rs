//! Writes images in the format that the ending of the path names, at once or in parts.

use std::path::Path;

use super::samples::SampleType;
use super::stream::SlabSource;
use super::{LineNumbers, extension, grids, metaimage, nifti, npy, nrrd, png, raw, vti, zarr};
use crate::error::{Error, Result, cause};
use crate::image::{Geometry, Image};

/// Writes an image in the format that the ending of `path` names.
///
/// # Errors
/// Returns an [`Error::Io`] if the ending is unknown or the file cannot be written.
pub fn write<const D: usize>(path: &Path, image: &Image<D>) -> Result<()> {
    write_survey(path, image, None)
}

/// Writes an image as [`write`] does, with the line numbers of a survey where the format supports
/// them.
///
/// # Errors
/// Returns the errors of [`write`].
pub(crate) fn write_survey<const D: usize>(
    path: &Path,
    image: &Image<D>,
    lines: Option<[LineNumbers; 2]>,
) -> Result<()> {
    match (extension(path).as_str(), D) {
        ("vti", _) => vti::write(path, &image.to_3d(), "samples"),
        ("mha", _) => metaimage::write(path, image),
        ("png", 2) => png::write(path, &image.to_3d().flatten()),
        (ending, _) if STREAMED_EXTENSIONS.contains(&ending) => {
            let streamed = StreamedImage {
                dims: image.dims(),
                geometry: &image.geometry,
                missing: &image.missing,
                line_numbers: lines,
                sample_type: SampleType::F32,
                slabs: image,
            };
            streamed.write(path)
        }
        (ending, 2) if let Some(format) = grids::GridFormat::from_extension(ending) => {
            grids::write(path, image, format)
        }
        (other, _) => Err(Error::Io(cause(
            path.display(),
            format!("{D}-D images cannot be written with the ending '.{other}'"),
            match D {
                2 => {
                    "use .png, .npy, .vti, .nrrd, .mha, .nii, .zarr, .raw, .irap, .zmap, .cps3, .grd or .asc"
                }
                _ => "use .npy, .vti, .nrrd, .mha, .nii, .nii.gz, .zarr or .raw",
            },
        ))),
    }
}

/// Endings of the formats that verbs write.
pub const IMAGE_EXTENSIONS: [&str; 13] = [
    "vti", "npy", "png", "nrrd", "mha", "nii", "gz", "zarr", "irap", "zmap", "cps3", "grd", "asc",
];

/// Endings of the formats that are written in parts, so that images may be larger than memory.
const STREAMED_EXTENSIONS: [&str; 7] = ["npy", "raw", "bin", "nii", "nii.gz", "nrrd", "zarr"];

/// Returns `true` if the format of this ending is written in parts.
pub(crate) fn can_stream(path: &Path) -> bool {
    STREAMED_EXTENSIONS.contains(&extension(path).as_str())
}

/// An image that is written in parts.
pub(crate) struct StreamedImage<'a, const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Position of the samples in the world.
    pub geometry: &'a Geometry<D>,
    /// Flags of rows that hold no data, as in [`Image::missing`].
    pub missing: &'a [bool],
    /// Numbers of the inlines and crosslines of a survey.
    pub line_numbers: Option<[LineNumbers; 2]>,
    /// Type of the samples, where it is known.
    pub sample_type: SampleType,
    /// Source of the samples.
    pub slabs: &'a dyn SlabSource,
}

impl<const D: usize> StreamedImage<'_, D> {
    /// Writes the image in one of the formats for which [`can_stream`] returns `true`.
    ///
    /// # Errors
    /// Returns the errors of [`write`].
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
