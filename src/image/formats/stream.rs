//! Images whose samples are read on demand, plane by plane, because they may be larger than memory.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::parallel::prelude::*;

use super::placement::NO_GEOMETRY_NOTE;
use super::samples::{self, Encoding};
use super::segy::{LineNumbers, SegyInfo};
use super::{AnyImage, ImageFormat, LoadedImage, into_any_image};
use crate::error::{Result, io_error};
use crate::image::formats::with_loaded;
use crate::image::nulls::is_null;
use crate::image::{ExactLabels, Geometry, Image, LabelValue};
use crate::memory;

/// Everything that is known of an image except its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageHeader<const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Position of the samples in the world.
    pub geometry: Geometry<D>,
    /// Flags of rows along x that hold no data, as in [`Image::missing`].
    pub missing: Vec<bool>,
    /// Names of labels, as in [`Image::label_names`].
    pub label_names: Vec<(LabelValue, String)>,
    /// This field and those below are as in [`LoadedImage`].
    pub format: ImageFormat,
    pub encoding: String,
    pub notes: Vec<String>,
    pub survey: Option<SegyInfo>,
    pub line_numbers: Option<[LineNumbers; 2]>,
}

impl ImageHeader<3> {
    /// Creates the header of a file that gives the dimensions and the encoding of the samples, but
    /// no geometry. `what` names the kind of file in the note.
    pub fn without_geometry(
        format: ImageFormat,
        dims: [usize; 3],
        encoding: Encoding,
        description: &str,
    ) -> Self {
        Self {
            dims,
            geometry: Geometry::default(),
            missing: Vec::new(),
            label_names: Vec::new(),
            format,
            encoding: encoding.to_string(),
            notes: vec![format!("{description} {NO_GEOMETRY_NOTE}")],
            survey: None,
            line_numbers: None,
        }
    }
}

impl<const D: usize> ImageHeader<D> {
    /// Returns the image with these samples in memory order. Their number must be the product of
    /// the dimensions.
    pub fn with_samples(self, samples: Vec<f32>) -> LoadedImage<D> {
        let image = Image::new(self.dims, samples, Geometry::default());
        self.with_image(image)
    }

    /// Returns an image with its geometry and missing rows replaced by those of this header.
    pub fn with_image(self, mut image: Image<D>) -> LoadedImage<D> {
        image.geometry = self.geometry;
        if !self.label_names.is_empty() {
            image.label_names = self.label_names;
        }
        LoadedImage {
            image: image.with_missing(self.missing),
            format: self.format,
            encoding: self.encoding,
            notes: self.notes,
            survey: self.survey,
            line_numbers: self.line_numbers,
        }
    }
}

impl<const D: usize> LoadedImage<D> {
    /// Returns everything that is known of the image except its samples.
    pub fn header(&self) -> ImageHeader<D> {
        ImageHeader {
            dims: self.image.dims(),
            geometry: self.image.geometry.clone(),
            missing: self.image.missing.clone(),
            label_names: self.image.label_names.clone(),
            format: self.format,
            encoding: self.encoding.clone(),
            notes: self.notes.clone(),
            survey: self.survey.clone(),
            line_numbers: self.line_numbers,
        }
    }
}

/// Reader of samples in a file, by planes along x and y.
pub trait PlaneReader: Send + Sync {
    /// Fills `out` with a range of rows (along x, numbered within a plane) of consecutive planes,
    /// beginning with plane `first`.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if the samples cannot be read.
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()>;

    /// Returns the number of planes that are read together most efficiently.
    fn batch_planes(&self) -> usize {
        1
    }

    /// Reads all samples as exact labels, in memory order. Returns `None` if some have a fraction, or
    /// if the reader does not support it.
    ///
    /// # Errors
    /// Returns the errors of [`PlaneReader::read_rows`].
    fn read_exact_labels(&self, _dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        Ok(None)
    }
}

/// A 3-D image whose samples are still in its file.
pub struct ImageStream {
    /// Everything that is known without the samples.
    pub header: ImageHeader<3>,
    /// Encoding of the samples in the file, which determines whether they may be rounded.
    pub encoding: Encoding,
    pub reader: Box<dyn PlaneReader>,
    /// Largest magnitude among the samples that were read, as the bits of an `f32`.
    pub max_magnitude_bits: AtomicU32,
}

/// Largest number of samples of an image that is loaded into memory although it could stay in its
/// file.
pub(super) const MAX_SAMPLES_IN_MEMORY: usize = 1 << 26;

/// Memory, in bytes, of the samples that are read at a time, unless a single plane takes more.
const MAX_BUFFER_BYTES: usize = 1 << 26;

/// Source of samples in memory order, in slabs of planes.
pub trait SlabSource {
    /// Calls `work` for each slab in order. A slab consists of whole planes along the last axis.
    /// The number of planes is a multiple of `multiple`, except in the last slab.
    ///
    /// # Errors
    /// Returns the errors of `work` and of reading; [`io_error`] restores the latter.
    fn for_each_slab(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()>;
}

impl<const D: usize> SlabSource for Image<D> {
    fn for_each_slab(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let plane: usize = self.dims()[..D - 1].iter().product();
        let slab = plane.saturating_mul(multiple).max(1);
        self.as_slice().chunks(slab).try_for_each(work)
    }
}

impl SlabSource for ImageStream {
    fn for_each_slab(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let [nx, ny, nz] = self.header.dims;
        let plane = nx * ny;
        let planes_in_buffer = (MAX_BUFFER_BYTES / 4 / plane.max(1)).max(1);
        let batch = least_common_multiple(multiple, self.reader.batch_planes());
        let planes = if batch <= 4 * planes_in_buffer {
            // Use as many multiples as fit into the buffer.
            batch * (planes_in_buffer / batch).max(1)
        } else {
            multiple.max(1)
        };
        let planes = planes.min(nz.max(1));
        memory::ensure_available(
            "a part of the image",
            4.0 * (planes * plane) as f64,
            format!("{planes} planes of {nx} x {ny} samples"),
            "write it with smaller chunks",
        )
        .map_err(io::Error::other)?;
        let mut slab = vec![0.0; planes * plane];
        for first in (0..nz).step_by(planes) {
            let part = &mut slab[..planes.min(nz - first) * plane];
            self.read_planes(first, part).map_err(io::Error::other)?;
            work(part)?;
        }
        Ok(())
    }
}

fn least_common_multiple(a: usize, b: usize) -> usize {
    let (mut x, mut y) = (a.max(1), b.max(1));
    while y > 0 {
        (x, y) = (y, x % y);
    }
    (a.max(1) / x).saturating_mul(b.max(1))
}

impl ImageStream {
    /// Reads consecutive whole planes, beginning with plane `first`.
    ///
    /// # Errors
    /// Returns the errors of [`ImageStream::read_plane_rows`].
    pub fn read_planes(&self, first: usize, out: &mut [f32]) -> Result<()> {
        self.read_plane_rows(first, 0..self.header.dims[1], out)
    }

    /// Reads a range of rows of consecutive planes, beginning with plane `first`.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if they cannot be read.
    pub fn read_plane_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.reader.read_rows(first, rows, out)?;
        if self.encoding.is_wide_integer() {
            // The bits of non-negative floats are ordered as the floats are.
            let bits = out.par_iter().map(|v| v.abs().to_bits()).max();
            self.max_magnitude_bits
                .fetch_max(bits.unwrap_or(0), Relaxed);
        }
        Ok(())
    }

    /// Returns `true` if the image should and can stay in its file. It should if it has many
    /// samples, if there is not enough memory for them, or if several ranks share them
    /// (`is_distributed`). It can if it has three axes and no missing rows.
    pub fn stays_in_file(&self, is_distributed: bool) -> bool {
        let dims = self.header.dims;
        let count: usize = dims.iter().product();
        let is_large = is_distributed
            || count > MAX_SAMPLES_IN_MEMORY
            || samples::check_memory(Path::new("the image"), 3 * count).is_err();
        is_large && self.header.missing.is_empty() && dims.iter().all(|&n| n > 1)
    }

    /// Reads all samples.
    ///
    /// # Errors
    /// Returns an [`Error::Job`](crate::Error::Job) if there is not enough memory for them, and an
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    pub fn into_loaded(mut self, place: &Path) -> Result<LoadedImage> {
        let count = self.header.dims.iter().product();
        let mut samples = samples::allocate(place, count)?;
        let rows = 0..self.header.dims[1];
        self.reader.read_rows(0, rows, &mut samples)?;
        self.header
            .notes
            .extend(self.encoding.rounding_note(&samples));
        let exact = if self.encoding.may_need_exact_labels(&samples) {
            self.reader.read_exact_labels(self.header.dims)?
        } else {
            None
        };
        let mut loaded = self.header.with_samples(samples);
        loaded.image.labels = exact;
        Ok(loaded)
    }

    /// Returns a warning if samples that were read so far were rounded.
    pub fn rounding_note(&self) -> Option<String> {
        let largest = f32::from_bits(self.max_magnitude_bits.load(Relaxed));
        self.encoding.rounding_note(&[largest])
    }
}

/// Reader of uncompressed samples in a file, the fastest axis first.
pub struct RawPlanes {
    pub path: PathBuf,
    pub file: File,
    /// Offset of the first sample in the file.
    pub data_offset: u64,
    pub encoding: Encoding,
    /// Number of samples of a plane along its axes.
    pub plane_dims: [usize; 2],
}

impl PlaneReader for RawPlanes {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let [nx, ny] = self.plane_dims;
        // Whole planes are contiguous in the file.
        let samples_per_read = if rows.len() == ny {
            out.len()
        } else {
            rows.len() * nx
        };
        for (plane, out) in (first..).zip(out.chunks_mut(samples_per_read.max(1))) {
            let sample = (plane * ny + rows.start) * nx;
            let offset = self.data_offset + (sample * self.encoding.size()) as u64;
            let read = self.encoding.read(&self.file, offset, out);
            read.map_err(|e| io_error(&self.path, "read", e))?;
        }
        Ok(())
    }

    fn read_exact_labels(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let count = dims.iter().product();
        let exact = self
            .encoding
            .read_exact_labels(&self.file, self.data_offset, count);
        exact.map_err(|e| io_error(&self.path, "read", e))
    }
}

/// Reader that replaces null values by NaN.
struct NullFilter {
    reader: Box<dyn PlaneReader>,
    nulls: Vec<f32>,
}

impl PlaneReader for NullFilter {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.reader.read_rows(first, rows, out)?;
        out.par_iter_mut().for_each(|s| null_to_nan(s, &self.nulls));
        Ok(())
    }

    fn batch_planes(&self) -> usize {
        self.reader.batch_planes()
    }

    fn read_exact_labels(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        self.reader.read_exact_labels(dims)
    }
}

/// Replaces a sample that holds a null value by NaN.
fn null_to_nan(sample: &mut f32, nulls: &[f32]) {
    if nulls.iter().any(|&null| is_null(*sample, null)) {
        *sample = f32::NAN;
    }
}

/// An image that was opened: in memory, or still in its file.
pub enum OpenedImage {
    /// The samples are still in the file.
    Stream(ImageStream),
    /// The image is in memory.
    InMemory(AnyImage),
}

/// Everything that is known of a 2-D or 3-D image except its samples.
pub(super) enum AnyHeader {
    /// Of a 2-D image.
    Plane(ImageHeader<2>),
    /// Of a 3-D image.
    Space(ImageHeader<3>),
}

impl AnyHeader {
    /// Returns an image with as many samples in the place of this one, and `true`; an image with other
    /// dimensions as it is, and `false`.
    pub fn place(&self, image: AnyImage) -> (AnyImage, bool) {
        match (self, image) {
            (Self::Plane(header), AnyImage::Plane(loaded))
                if header.dims == loaded.image.dims() =>
            {
                let placed = header.clone().with_image(loaded.image);
                (AnyImage::Plane(placed), true)
            }
            (Self::Space(header), AnyImage::Space(loaded))
                if header.dims == loaded.image.dims() =>
            {
                let placed = header.clone().with_image(loaded.image);
                (AnyImage::Space(placed), true)
            }
            (_, image) => (image, false),
        }
    }
}

impl OpenedImage {
    /// Returns everything that is known of the image except its samples.
    pub(super) fn header(&self) -> AnyHeader {
        match self {
            Self::Stream(stream) => AnyHeader::Space(stream.header.clone()),
            Self::InMemory(AnyImage::Plane(loaded)) => AnyHeader::Plane(loaded.header()),
            Self::InMemory(AnyImage::Space(loaded)) => AnyHeader::Space(loaded.header()),
        }
    }

    /// Loads all samples into memory.
    ///
    /// # Errors
    /// Returns the errors of `ImageStream::into_loaded`.
    pub fn load(self, place: &Path) -> Result<AnyImage> {
        match self {
            Self::Stream(stream) => stream.into_loaded(place).map(into_any_image),
            Self::InMemory(loaded) => Ok(loaded),
        }
    }

    /// Returns the image with samples of these values read as NaN.
    pub fn with_nulls(self, nulls: &[f32]) -> Self {
        if nulls.is_empty() {
            return self;
        }
        match self {
            Self::Stream(stream) => Self::Stream(ImageStream {
                reader: Box::new(NullFilter {
                    reader: stream.reader,
                    nulls: nulls.to_vec(),
                }),
                ..stream
            }),
            Self::InMemory(mut loaded) => {
                let samples = with_loaded!(&mut loaded, loaded => &mut loaded.image.samples);
                samples.iter_mut().for_each(|s| null_to_nan(s, nulls));
                Self::InMemory(loaded)
            }
        }
    }

    /// Returns the names of labels.
    pub fn label_names_mut(&mut self) -> &mut Vec<(LabelValue, String)> {
        match self {
            Self::Stream(stream) => &mut stream.header.label_names,
            Self::InMemory(image) => with_loaded!(image, loaded => &mut loaded.image.label_names),
        }
    }

    /// Returns the messages for the user about the reading.
    pub fn notes_mut(&mut self) -> &mut Vec<String> {
        match self {
            Self::Stream(stream) => &mut stream.header.notes,
            Self::InMemory(image) => with_loaded!(image, loaded => &mut loaded.notes),
        }
    }

    /// Returns the header of the image if it has `D` axes.
    pub fn into_header<const D: usize>(self) -> Option<ImageHeader<D>> {
        let header: Box<dyn std::any::Any> = match self {
            Self::Stream(stream) => Box::new(stream.header),
            Self::InMemory(image) => with_loaded!(image, loaded => Box::new(loaded.header())),
        };
        header.downcast().ok().map(|head| *head)
    }
}
