//! Image files: reading and writing.
//!
//! Files are recognised by their content, never by their name. The format of a written file is
//! chosen by the ending of its name.
//!
//! - `foreign`: formats of others that are recognised and not read
//! - `grids`: grids of heights: IRAP classic, ZMAP+, CPS-3, Surfer, ESRI ASCII
//! - `hdf5`: arrays in HDF5 files, of h5py, MATLAB, ilastik, ITK and VTK
//! - `corner_points`: properties of corner-point grids, sampled on a lattice
//! - `crop`: blocks of images
//! - `dicom`: series, frames and segmentations of DICOM
//! - `inside`: outlines of the part of an image that is kept
//! - `inrimage`: INRIMAGE-4 volumes
//! - `label_table`: tables of names of labels
//! - `metaimage`: MetaImage, the format of ITK
//! - `nifti`: NIfTI, the format of neuroscience
//! - `npy`: NumPy arrays
//! - `nrrd`: NRRD files
//! - `packed`: samples behind a header, possibly compressed
//! - `png`: pictures, as 2-D images
//! - `segy`: seismic volumes and lines
//! - `tiff`: TIFF stacks
//! - `zarr`: chunked arrays, Zarr and MDIO
//! - `vtk_axes`: evenly spaced grids of VTK
//! - `vti`: VTK image data; [`vtk`] is the container that it shares with meshes
//! - `raw`: samples without a header, described by the user
//! - `write`: writes images in the format that the ending names
//! - `stream`: images that may be larger than memory, read in parts
//! - `same_place`: compares the positions of two images, and orders the samples of masks
//! - `segments`: names of labels, and layers of segmentations
//! - `slice_folder`: folders of PNG or TIFF slices
//! - `samples`: sample types and their conversion to `f32`
//! - `placement`: geometry that the user gives for files without one
//! - `input`: options of the user for reading a file
//! - `describe`: description of a file for people and for programs

mod corner_points;
pub(crate) mod crop;
pub(crate) mod describe;
mod dicom;
mod file_hash;
mod foreign;
pub(crate) mod grids;
pub(crate) mod hdf5;
pub(crate) mod input;
pub(crate) mod inrimage;
mod inside;
pub(crate) mod label_table;
pub(crate) mod metaimage;
pub(crate) mod nifti;
pub(crate) mod npy;
pub(crate) mod nrrd;
pub(crate) mod packed;
pub(crate) mod placement;
pub(crate) mod png;
pub(crate) mod raw;
pub(crate) mod same_place;
pub(crate) mod samples;
mod segments;
pub mod segy;
mod slice_folder;
pub(crate) mod stream;
pub(crate) mod tiff;
pub mod vti;
mod vtk_axes;
mod write;
pub(crate) mod zarr;

use std::any::Any;
use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result, cause, io_error};
use crate::files::{self, vtk};
use crate::grid_file;
use crate::image::Image;

pub use crate::grid_file::{GridDescription, GridRegion};
pub use crop::Crop;
pub use describe::{Description, describe};
pub use file_hash::file_hash;
pub use input::{InputOptions, ReadImage, SampleDomain, read_with_options};
pub use placement::{AxisSpec, ImagePlacement};
pub use raw::RawSpec;
use same_place::in_place_of;
pub use segy::{LineNumbers, SegyBytes, SegyInfo};
pub use stream::OpenedImage;
pub use write::{IMAGE_EXTENSIONS, write};
pub(crate) use write::{StreamedImage, can_stream, write_survey};

/// Options for reading an image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReadOptions {
    /// Description of the file as raw samples; if given, the content of the file is not inspected.
    pub raw: Option<RawSpec>,
    /// Bytes of SEG-Y trace headers that hold the needed fields.
    pub segy: SegyBytes,
    /// Geometry of the image, if the file has none.
    pub placement: ImagePlacement,
    /// Values that stand for missing samples; they are read as NaN.
    pub nulls: Vec<f32>,
    /// An image with as many samples; where its samples are not zero, those of the image are read as
    /// NaN.
    pub mask: Option<PathBuf>,
    /// The block of the image that is read; if `None`, the whole image.
    pub crop: Option<Crop>,
    /// The layer of a segmentation with layers that is read.
    pub layer: Option<usize>,
    /// A table of names of labels, or `none`. If `None`, a table that lies beside the image is read.
    pub label_table: Option<PathBuf>,
    /// Polygons in map view, or an image with as many samples; outside them, or where its samples are
    /// zero, those of the image are read as NaN.
    pub inside: Option<PathBuf>,
}

impl ReadOptions {
    /// Returns `true` if all samples keep the values and the places that the file gives them.
    fn keep_all_samples(&self) -> bool {
        self.placement.is_empty()
            && self.nulls.is_empty()
            && self.mask.is_none()
            && self.crop.is_none()
            && self.inside.is_none()
    }
}

/// The image formats that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// NumPy `.npy`.
    Npy,
    /// SEG-Y.
    Segy,
    /// VTK image data, `.vti`, and evenly spaced grids, `.vtr`, `.vts`.
    Vti,
    /// A picture, `.png`.
    Png,
    /// NIfTI-1 or NIfTI-2, `.nii`, `.nii.gz`, or `.hdr` with `.img`, also Analyze 7.5.
    Nifti,
    /// MetaImage, `.mha` or `.mhd`.
    MetaImage,
    /// NRRD, `.nrrd` or `.nhdr`.
    Nrrd,
    /// A TIFF stack.
    Tiff,
    /// INRIMAGE-4, `.inr` or `.inr.gz`.
    Inrimage,
    /// A grid of heights, IRAP classic.
    Irap,
    /// A grid of heights, ZMAP+.
    Zmap,
    /// A grid of heights, CPS-3.
    Cps3,
    /// A grid of heights of Surfer, as text or binary.
    Surfer,
    /// A grid of heights, ESRI ASCII.
    Esri,
    /// A folder with an array in chunks, Zarr version 3; also MDIO version 1.
    Zarr,
    /// A data set of an HDF5 file.
    Hdf5,
    /// DICOM: a series of files, a file of frames, or a segmentation.
    Dicom,
    /// A folder of PNG or TIFF slices.
    SliceFolder,
    /// A property of a corner-point grid, EGRID or GRDECL.
    CornerPoints,
    /// Samples without a header.
    Raw,
}

impl ImageFormat {
    /// Returns `true` for grids of heights, which are 2-D.
    pub(crate) fn is_height_grid(self) -> bool {
        matches!(
            self,
            Self::Irap | Self::Zmap | Self::Cps3 | Self::Surfer | Self::Esri
        )
    }
}

impl fmt::Display for ImageFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Npy => "NumPy array",
            Self::Segy => "SEG-Y",
            Self::Vti => "VTK image data",
            Self::Png => "PNG",
            Self::Nifti => "NIfTI",
            Self::MetaImage => "MetaImage",
            Self::Nrrd => "NRRD",
            Self::Tiff => "TIFF",
            Self::Inrimage => "INRIMAGE-4",
            Self::Irap => "IRAP classic",
            Self::Zmap => "ZMAP+",
            Self::Cps3 => "CPS-3",
            Self::Surfer => "Surfer",
            Self::Esri => "ESRI ASCII",
            Self::Zarr => "Zarr",
            Self::Hdf5 => "HDF5",
            Self::Dicom => "DICOM",
            Self::SliceFolder => "folder of slices",
            Self::CornerPoints => "corner-point grid",
            Self::Raw => "raw samples",
        })
    }
}

/// An image and what was learned while reading it.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedImage<const D: usize = 3> {
    /// The image.
    pub image: Image<D>,
    /// Format from which it was read.
    pub format: ImageFormat,
    /// Encoding of the samples in the file.
    pub encoding: String,
    /// Messages for the user about the reading.
    pub notes: Vec<String>,
    /// Contents of the headers of a SEG-Y file.
    pub survey: Option<SegyInfo>,
    /// Numbers of the inlines and crosslines of a survey.
    pub line_numbers: Option<[LineNumbers; 2]>,
}

/// A 2-D or 3-D image.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyImage {
    /// A 2-D image.
    Plane(LoadedImage<2>),
    /// A 3-D image.
    Space(LoadedImage<3>),
}

impl<const D: usize> From<Image<D>> for LoadedImage<D> {
    /// Returns an image that was made in memory, as if it were an array of NumPy.
    fn from(image: Image<D>) -> Self {
        Self {
            image,
            format: ImageFormat::Npy,
            encoding: "float32".into(),
            notes: Vec::new(),
            survey: None,
            line_numbers: None,
        }
    }
}

/// Runs the same code with an image of any dimension: `with_loaded!(image, loaded => ...)`.
macro_rules! with_loaded {
    ($image:expr, $loaded:pat => $run:expr) => {
        match $image {
            $crate::image::formats::AnyImage::Plane($loaded) => $run,
            $crate::image::formats::AnyImage::Space($loaded) => $run,
        }
    };
}

pub(crate) use with_loaded;

impl From<LoadedImage<2>> for AnyImage {
    fn from(loaded: LoadedImage<2>) -> Self {
        Self::Plane(loaded)
    }
}

impl From<LoadedImage<3>> for AnyImage {
    fn from(loaded: LoadedImage<3>) -> Self {
        Self::Space(loaded)
    }
}

impl AnyImage {
    /// Returns the image if it has `D` axes.
    pub fn into_image<const D: usize>(self) -> Option<Image<D>> {
        let image: Box<dyn Any> = with_loaded!(self, loaded => Box::new(loaded.image));
        image.downcast().ok().map(|image| *image)
    }

    /// Returns the number of samples along each axis, x first.
    pub fn dims(&self) -> Vec<usize> {
        with_loaded!(self, loaded => loaded.image.dims().to_vec())
    }

    /// Returns the SHA-256 of the samples, x fastest, as little-endian 32-bit floats.
    pub fn hash(&self) -> String {
        let samples = match self {
            Self::Plane(loaded) => loaded.image.as_slice(),
            Self::Space(loaded) => loaded.image.as_slice(),
        };
        file_hash::hash_of_samples(samples)
    }

    /// Writes the image in the format that the ending of `path` names, with the line numbers of a
    /// survey where the format supports them.
    ///
    /// # Errors
    /// Returns the errors of [`write()`].
    pub fn write(&self, path: &Path) -> Result<()> {
        with_loaded!(self, loaded => write_survey(path, &loaded.image, loaded.line_numbers))
    }
}

/// Reads a 3-D image of any known format.
///
/// ```
/// use atomesh::image::formats::{self, ReadOptions};
/// use atomesh::image::synth::{self, Options, SyntheticKind};
///
/// let options = Options { dims: [12, 11, 10], ..Options::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let path = std::env::temp_dir().join("atomesh-formats-read.npy");
/// formats::write(&path, &image)?;
///
/// let loaded = formats::read(&path, &ReadOptions::default())?;
/// assert_eq!(loaded.image.dims(), [12, 11, 10]);
/// assert_eq!(loaded.image.samples, image.samples);
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read, is of no known format, is damaged or 2-D.
pub fn read(path: &Path, options: &ReadOptions) -> Result<LoadedImage<3>> {
    match read_any(path, options)? {
        AnyImage::Space(loaded) => Ok(loaded),
        AnyImage::Plane(LoadedImage { image, .. }) => {
            let [nx, ny] = image.dims();
            Err(Error::Io(cause(
                path.display(),
                format!("is a 2-D image of {nx} x {ny} samples where a volume is needed"),
                "give a 3-D image",
            )))
        }
    }
}

/// Reads an image of any known format. An image with a single sample along its last axis is 2-D.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read, is of no known format, or is damaged.
pub fn read_any(path: &Path, options: &ReadOptions) -> Result<AnyImage> {
    open(path, options)?.load(path)
}

/// Opens an image of any known format. Samples of images that may be larger than memory stay in
/// their files.
///
/// # Errors
/// Returns the errors of [`read_any`].
pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<OpenedImage> {
    let format = detect(path, options)?;
    let mut opened = open_as_stored(path, format, options)?;
    name_labels(&mut opened, path, options.label_table.as_deref())?;
    let opened = match opened {
        // The geometry of a 2-D image is derived when its samples are loaded.
        OpenedImage::Stream(stream) if stream.header.dims[2] == 1 => {
            OpenedImage::InMemory(into_any_image(stream.into_loaded(path)?))
        }
        other => other,
    };
    let placement = if format == ImageFormat::CornerPoints {
        options.placement.without_spacing()
    } else {
        options.placement.clone()
    };
    let opened = placement.apply(opened, &options.segy)?;
    restricted(opened.with_nulls(&options.nulls), path, options)
}

/// Gives the labels of an image the names in a table, or in one that lies beside the image if its file
/// has no names and `table` is not `none`.
///
/// # Errors
/// Returns an [`Error::Io`] if the table cannot be read.
pub(crate) fn name_labels(
    opened: &mut OpenedImage,
    path: &Path,
    table: Option<&Path>,
) -> Result<()> {
    let has_names = !opened.label_names_mut().is_empty();
    let (file, names, is_found) = match table {
        Some(file) if file == Path::new("none") => return Ok(()),
        Some(file) => (file.to_path_buf(), label_table::read(file)?, false),
        None if has_names => return Ok(()),
        None => match label_table::companion_table(path) {
            Some((file, names)) => (file, names, true),
            None => return Ok(()),
        },
    };
    let mut note = label_table::note(&file, &names, is_found);
    if has_names {
        note += ", in place of those in the image";
    }
    let notes = opened.notes_mut();
    notes.retain(|note| !note.starts_with(segments::NAMES_NOTE));
    notes.push(note);
    *opened.label_names_mut() = names;
    Ok(())
}

/// Returns the part of an image that is read: the block to which it is cropped, with NaN where a mask
/// leaves samples out and outside an outline. `place` names the image.
///
/// # Errors
/// Returns the errors of the files that the options name, and [`Error::Image`] if they do not fit the
/// image.
pub(crate) fn restricted(
    opened: OpenedImage,
    place: &Path,
    options: &ReadOptions,
) -> Result<OpenedImage> {
    let whole = opened.header();
    let opened = match &options.crop {
        Some(crop) => crop.apply(opened)?,
        None => opened,
    };
    if options.mask.is_none() && options.inside.is_none() {
        return Ok(opened);
    }
    let image = opened.load(place)?;
    let fit = |mask: AnyImage| match (&options.crop, whole.place(mask)) {
        (Some(crop), (mask, true)) => crop.apply(OpenedImage::InMemory(mask))?.load(place),
        (_, (mask, _)) => Ok(mask),
    };
    // A file that has a position must lie where the image does.
    let cropped = OpenedImage::InMemory(image);
    let cropped_header = cropped.header();
    let headers = [&whole, &cropped_header];
    let mut image = cropped.load(place)?;
    if let Some(mask) = &options.mask {
        let fit = |flags: AnyImage| fit(in_place_of(&headers, flags, place, mask, "mask")?);
        image = masked(image, place, mask, &fit)?;
    }
    if let Some(outline) = &options.inside {
        let fit = |flags: AnyImage| fit(in_place_of(&headers, flags, place, outline, "inside")?);
        image = inside::any_without_outside(image, outline, &fit)?;
    }
    Ok(OpenedImage::InMemory(image))
}

/// Returns the image with NaN where the image at `mask` is not zero, and a note that says how many
/// samples these are. `fit` returns the part of the mask that belongs to the image.
fn masked(image: AnyImage, path: &Path, mask: &Path, fit: inside::FitMask<'_>) -> Result<AnyImage> {
    fn apply<const D: usize>(
        mut loaded: LoadedImage<D>,
        place: &Path,
        flags: Option<Image<D>>,
        mask: &Path,
    ) -> Result<LoadedImage<D>> {
        let dims = loaded.image.dims();
        let Some(flags) = flags.filter(|flags| flags.dims() == dims) else {
            let problem = format!("has other samples than {} ({dims:?})", place.display());
            let remedy =
                "give a mask with one value for each sample, not 0 where samples are left out";
            let error = cause(mask.display(), problem, remedy);
            return Err(Error::Image(error.with_parameter("mask")));
        };
        let mut count = 0;
        let samples = loaded.image.samples.iter_mut().zip(flags.as_slice());
        for (sample, _) in samples.filter(|(_, flag)| **flag != 0.0) {
            *sample = f32::NAN;
            count += 1;
        }
        let share = 100.0 * f64::from(count) / flags.as_slice().len().max(1) as f64;
        loaded.notes.push(format!(
            "{count} samples ({share:.2} %) are left out by the mask {}",
            mask.display()
        ));
        Ok(loaded)
    }
    let flags = fit(read_any(mask, &ReadOptions::default())?)?;
    Ok(with_loaded!(image, loaded => apply(loaded, path, flags.into_image(), mask)?.into()))
}

/// Opens an image with the geometry that its file gives.
fn open_as_stored(path: &Path, format: ImageFormat, options: &ReadOptions) -> Result<OpenedImage> {
    let loaded = match format {
        ImageFormat::Png => {
            return png::read(path)
                .map(AnyImage::Plane)
                .map(OpenedImage::InMemory);
        }
        format @ (ImageFormat::Irap
        | ImageFormat::Zmap
        | ImageFormat::Cps3
        | ImageFormat::Surfer
        | ImageFormat::Esri) => {
            let read = grids::read(path, format);
            return read.map(AnyImage::Plane).map(OpenedImage::InMemory);
        }
        ImageFormat::Raw => match options.raw {
            Some(spec) => return raw::open(path, spec).map(OpenedImage::Stream),
            None => return Err(unknown_format(path)),
        },
        ImageFormat::Npy => return npy::open(path),
        ImageFormat::Segy => return segy::open(path, &options.segy).map(OpenedImage::Stream),
        ImageFormat::Zarr => return zarr::open(path).map(OpenedImage::Stream),
        ImageFormat::Dicom => return dicom::open(path, options.layer),
        ImageFormat::SliceFolder => return slice_folder::open(path).map(OpenedImage::Stream),
        ImageFormat::CornerPoints => {
            return corner_points::open(path, &options.placement).map(OpenedImage::Stream);
        }
        ImageFormat::Nifti => nifti::read(path)?,
        ImageFormat::MetaImage => metaimage::read(path)?,
        ImageFormat::Nrrd => nrrd::read(path, options.layer)?,
        ImageFormat::Tiff => tiff::read(path)?,
        ImageFormat::Inrimage => inrimage::read(path)?,
        ImageFormat::Hdf5 => hdf5::read(path)?,
        ImageFormat::Vti => vti::read(path)?,
    };
    Ok(OpenedImage::InMemory(into_any_image(loaded)))
}

/// Returns a 3-D image, or a 2-D image if there is a single sample along the last axis.
pub(crate) fn into_any_image(loaded: LoadedImage) -> AnyImage {
    match loaded.image.dims() {
        [_, _, 1] => {
            let mut notes = loaded.notes;
            if loaded.image.geometry.is_oblique() && !loaded.image.geometry.is_upright() {
                notes.push(
                    "the image's plane is neither horizontal nor vertical: positions are measured within it, from the first sample"
                        .into(),
                );
            }
            AnyImage::Plane(LoadedImage {
                image: loaded.image.flatten(),
                format: loaded.format,
                encoding: loaded.encoding,
                notes,
                survey: loaded.survey,
                line_numbers: loaded.line_numbers,
            })
        }
        _ => AnyImage::Space(loaded),
    }
}

pub(crate) fn extension(path: &Path) -> String {
    let name = path.to_string_lossy().to_lowercase();
    if name.ends_with(".nii.gz") {
        return "nii.gz".into();
    }
    path.extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default()
}

/// Returns the format of a folder, or of a data set in a file; `None` for other paths.
///
/// # Errors
/// Returns an [`Error::Io`] for a folder that is not read.
fn detect_container(path: &Path, options: &ReadOptions) -> Result<Option<ImageFormat>> {
    let (is_folder, is_raw) = (path.is_dir(), options.raw.is_some());
    if !is_raw && zarr::is_node(path)? {
        return Ok(Some(ImageFormat::Zarr));
    }
    if !is_raw && is_folder && dicom::is_folder_of_series(path) {
        return Ok(Some(ImageFormat::Dicom));
    }
    if let Some(error) = is_folder.then(|| foreign::folder_refusal(path)).flatten() {
        return Err(error);
    }
    if !is_raw && is_folder && slice_folder::has_slices(path) {
        return Ok(Some(ImageFormat::SliceFolder));
    }
    if is_raw {
        return Ok(None);
    }
    if hdf5::split_path(path).is_some() {
        return Ok(Some(ImageFormat::Hdf5));
    }
    let is_property = grid_file::split_name(path).is_some();
    Ok(is_property.then_some(ImageFormat::CornerPoints))
}

/// Detects the format of a file from its content. The format is raw only if the options describe
/// raw samples.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read or is of no supported format.
pub fn detect(path: &Path, options: &ReadOptions) -> Result<ImageFormat> {
    let mut head = Vec::new();
    if let Some(format) = detect_container(path, options)? {
        return Ok(format);
    }
    let file = files::open(
        path,
        "give an image file, or a folder with an array of Zarr, a DICOM series, or PNG or TIFF slices",
    )?;
    if options.raw.is_some() {
        return Ok(ImageFormat::Raw);
    }
    file.take(DETECTION_BYTES)
        .read_to_end(&mut head)
        .map_err(|e| io_error(path, "read", e))?;
    if head.is_empty() {
        return Err(Error::Io(cause(
            path.display(),
            "is empty",
            "give an image file",
        )));
    }
    if let Some(format) = recognise(&head) {
        return Ok(format);
    }
    if nifti::header_of(path).is_some() {
        return Ok(ImageFormat::Nifti);
    }
    if let Some(error) = foreign::refusal(path, &head) {
        return Err(error);
    }
    if hdf5::is_hdf5(path) {
        return Ok(ImageFormat::Hdf5);
    }
    if head.starts_with(packed::GZIP_MAGIC) {
        let (unpacked, _) = packed::read_head(path, DETECTION_BYTES)?;
        return match recognise(&unpacked) {
            Some(format @ (ImageFormat::Nifti | ImageFormat::Inrimage)) => Ok(format),
            _ => Err(Error::Io(cause(
                path.display(),
                "is compressed (gzip), and holds no NIfTI or INRIMAGE file",
                "decompress it first, with gunzip",
            ))),
        };
    }
    let text = String::from_utf8_lossy(&head[..head.len().min(1024)]);
    if text.contains("<VTKFile") || head.starts_with(vtk::legacy::MAGIC) {
        const KINDS: [&str; 6] = [
            "ImageData",
            "RectilinearGrid",
            "StructuredGrid",
            "STRUCTURED_POINTS",
            "RECTILINEAR_GRID",
            "DATASET STRUCTURED_GRID",
        ];
        if KINDS.iter().any(|kind| text.contains(kind)) {
            return Ok(ImageFormat::Vti);
        }
        let problem = "is a VTK file, but not of image data";
        return Err(Error::Io(cause(
            path.display(),
            problem,
            "give an image, not a mesh",
        )));
    }
    if grid_file::is_grid(path) {
        return Ok(ImageFormat::CornerPoints);
    }
    // For a file with a SEG-Y name the SEG-Y reader reports what is wrong with it.
    let has_segy_name = matches!(extension(path).as_str(), "sgy" | "segy");
    if has_segy_name || segy::looks_like(&head) {
        return Ok(ImageFormat::Segy);
    }
    Err(foreign::late_refusal(path, &head).unwrap_or_else(|| unknown_format(path)))
}

/// Returns the file of a data set that is named `FILE:/PATH`, or of a property of a grid that is named
/// `FILE:NAME`; `None` for other names.
pub(crate) fn file_of_data_set(path: &Path) -> Option<PathBuf> {
    let (file, _) = hdf5::split_path(path).or_else(|| grid_file::split_name(path))?;
    Some(file)
}

/// Number of bytes at the start of a file from which its format is detected.
const DETECTION_BYTES: u64 = segy::FILE_HEADER_BYTES as u64;

/// Returns the format that the first bytes of a file indicate.
fn recognise(head: &[u8]) -> Option<ImageFormat> {
    Some(match head {
        _ if head.starts_with(npy::MAGIC) => ImageFormat::Npy,
        _ if head.starts_with(png::MAGIC) => ImageFormat::Png,
        _ if head.starts_with(nrrd::MAGIC) => ImageFormat::Nrrd,
        _ if head.starts_with(inrimage::MAGIC) => ImageFormat::Inrimage,
        _ if dicom::is_dicom(head) => ImageFormat::Dicom,
        _ if metaimage::looks_like(head) => ImageFormat::MetaImage,
        _ if tiff::MAGIC.iter().any(|magic| head.starts_with(magic)) => ImageFormat::Tiff,
        _ if nifti::looks_like(head) || nifti::looks_like_analyze(head) => ImageFormat::Nifti,
        _ => return grids::recognise(head),
    })
}

fn unknown_format(path: &Path) -> Error {
    Error::Io(
        cause(
            path.display(),
            "is not in a known image format (SEG-Y, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png, .irap, .zmap, .cps3, .grd, .asc, EGRID, GRDECL, HDF5, Zarr, DICOM)",
            "say what it holds, e.g. 100x400x208:f32be (fastest axis first), or convert it to .npy",
        )
        .with_parameter("raw"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;

    fn error_message(path: &Path) -> String {
        read(path, &ReadOptions::default()).unwrap_err().to_string()
    }

    #[test]
    fn unreadable_files_are_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image");
        assert!(error_message(&path).contains("cannot open"));
        assert!(error_message(folder.path()).contains("is a folder"));
        let mut nifti = vec![0; 400];
        nifti[344..348].copy_from_slice(b"n+1\0");
        let cases: &[(&[u8], &str)] = &[
            (b"", "is empty"),
            (b"x", "not in a known image format"),
            (b"\x93NUMPY", "header is cut off"),
            (b"NRRD0004\ntype: float", "no 'sizes'"),
            (b"ObjectType = Image", "ElementDataFile"),
            (&nifti, "claims to be 0 bytes"),
            (b"II*\0\x08", "page 0"),
            (b"\x89PNG\r\n\x1a\n", "cut off"),
            (b"\x1f\x8b\x08", "gzip"),
            (
                b"<?xml version='1.0'?><VTKFile type='UnstructuredGrid'>",
                "not of image data",
            ),
        ];
        for (bytes, expected) in cases {
            std::fs::write(&path, bytes).unwrap();
            let error = error_message(&path);
            assert!(error.contains(expected), "{error} (expected: {expected})");
        }
        // A file named .sgy is refused with the reason of the SEG-Y reader.
        let named = folder.path().join("a.SGY");
        std::fs::write(&named, [7; 5000]).unwrap();
        assert!(
            error_message(&named).contains("sample format"),
            "{}",
            error_message(&named)
        );
    }

    #[test]
    fn one_sample_along_the_last_axis_makes_a_plane() {
        let folder = tempfile::tempdir().unwrap();
        let geometry = Geometry::with_spacing([100.0, -5.0], [12.5, 4.0]);
        let image = Image::new([3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 250.0], geometry);
        for name in ["a.vti", "a.npy", "a.png"] {
            let path = folder.path().join(name);
            write(&path, &image).unwrap();
            let AnyImage::Plane(loaded) = read_any(&path, &ReadOptions::default()).unwrap() else {
                panic!("{name} is not 2-D");
            };
            assert_eq!(loaded.image.as_slice(), image.as_slice(), "{name}");
            assert_eq!(loaded.image.dims(), [3, 2]);
            if name == "a.vti" {
                assert_eq!(loaded.image.geometry, image.geometry);
            }
            assert!(error_message(&path).contains("2-D image of 3 x 2 samples"));
        }
        let raw = folder.path().join("a.raw");
        write(&raw, &image).unwrap();
        for raw_spec in ["3x2:f32le", "3x2x1:f32le"] {
            let options = ReadOptions {
                raw: raw_spec.parse().ok(),
                ..ReadOptions::default()
            };
            let loaded = read_any(&raw, &options).unwrap();
            assert!(matches!(loaded, AnyImage::Plane(l) if l.image.samples == image.samples));
        }
        let volume = Image::new([2, 2, 2], vec![1.5; 8], Geometry::default());
        let error = write(&folder.path().join("b.png"), &volume).unwrap_err();
        assert!(error.to_string().contains("3-D images"), "{error}");
    }

    #[test]
    fn the_ending_chooses_the_written_format() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::new([2, 2, 2], vec![1.5; 8], Geometry::default());
        let path = folder.path().join("a.npy");
        write(&path, &image).unwrap();
        assert_eq!(read(&path, &ReadOptions::default()).unwrap().image, image);
        let raw = folder.path().join("a.raw");
        write(&raw, &image).unwrap();
        let options = ReadOptions {
            raw: "2x2x2:f32le".parse().ok(),
            ..ReadOptions::default()
        };
        let loaded = read(&raw, &options).unwrap();
        assert_eq!(
            (loaded.format, loaded.image),
            (ImageFormat::Raw, image.clone())
        );
        for name in ["a.xyz", "a"] {
            let error = write(&folder.path().join(name), &image).unwrap_err();
            assert!(error.to_string().contains("ending"), "{error}");
        }
    }
}
