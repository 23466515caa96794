//! Images whose samples are read when they are wanted, plane by plane: these may be larger than memory.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::parallel::prelude::*;
use ndarray::ArrayD;

use super::placement::NO_GEOMETRY_NOTE;
use super::samples::{self, Encoding};
use super::segy::{LineNumbers, SegyInfo};
use super::{AnyImage, ImageFormat, LoadedImage, into_any_image};
use crate::error::{Result, io_error};
use crate::image::nulls::is_null;
use crate::image::{ExactLabels, Geometry, Image};
use crate::memory;

/// All that is known of an image but its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageHeader<const D: usize> {
    /// Samples along each axis, x first.
    pub dims: [usize; D],
    /// Where they lie.
    pub geometry: Geometry<D>,
    /// Which rows along x hold no data, as [`Image::missing`] has it.
    pub missing: Vec<bool>,
    /// See [`LoadedImage::format`] and what follows there.
    pub format: ImageFormat,
    pub encoding: String,
    pub notes: Vec<String>,
    pub survey: Option<SegyInfo>,
    pub line_numbers: Option<[LineNumbers; 2]>,
}

impl ImageHeader<3> {
    /// Of a file that says nothing but how many samples there are and how they are coded; `what` it is.
    pub fn without_geometry(
        format: ImageFormat,
        dims: [usize; 3],
        encoding: Encoding,
        what: &str,
    ) -> Self {
        Self {
            dims,
            geometry: Geometry::default(),
            missing: Vec::new(),
            format,
            encoding: encoding.to_string(),
            notes: vec![format!("{what} {NO_GEOMETRY_NOTE}")],
            survey: None,
            line_numbers: None,
        }
    }
}

impl<const D: usize> ImageHeader<D> {
    /// With its samples in memory order, of which there must be as many.
    pub fn with_samples(self, samples: Vec<f32>) -> LoadedImage<D> {
        // An array of its shape, to be placed below.
        let bare = Image::new(self.dims, samples, Geometry::default());
        self.with_array(bare.samples)
    }

    /// With its samples as an array of its shape, in standard layout.
    pub fn with_array(self, samples: ArrayD<f32>) -> LoadedImage<D> {
        let image = Image {
            labels: None,
            samples,
            geometry: self.geometry,
            missing: Vec::new(),
            dead: Vec::new(),
        };
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
    /// All that is known of it but its samples.
    pub fn header(&self) -> ImageHeader<D> {
        ImageHeader {
            dims: self.image.dims(),
            geometry: self.image.geometry.clone(),
            missing: self.image.missing.clone(),
            format: self.format,
            encoding: self.encoding.clone(),
            notes: self.notes.clone(),
            survey: self.survey.clone(),
            line_numbers: self.line_numbers,
        }
    }
}

/// Samples in a file, which are read by planes along x and y.
pub trait PlaneReader: Send + Sync {
    /// Fills `out` with these rows (along x, numbered in a plane) of planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()>;

    /// How many planes are best read together.
    fn batch_planes(&self) -> usize {
        1
    }

    /// All samples as integers, in the order of memory, where they are integers that `f32` may round; `None` if
    /// they are not, or cannot be had so.
    ///
    /// # Errors
    /// Those of [`PlaneReader::read_rows`].
    fn read_integers(&self, _dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        Ok(None)
    }
}

/// An image of space whose samples are still in its file.
pub struct ImageStream {
    /// What is known without them.
    pub header: ImageHeader<3>,
    /// How an element is coded, for those that may be rounded.
    pub encoding: Encoding,
    pub reader: Box<dyn PlaneReader>,
    /// The largest magnitude among the samples that were read, as bits.
    pub max_magnitude_bits: AtomicU32,
}

/// Images of more samples are left in their files where they can be.
#[cfg(feature = "cli")]
const MAX_SAMPLES_IN_MEMORY: usize = 1 << 26;

/// Bytes of samples that are held at a time, unless a single plane takes more.
const MAX_BUFFER_BYTES: usize = 1 << 26;

/// Samples in the order of memory, a slab of planes at a time.
pub trait SlabSource {
    /// Calls `work` for one slab after the other, each of whole planes along the last axis: as many as
    /// `multiple` of these, or any number of times as many, but for the last.
    ///
    /// # Errors
    /// Those of the work and of reading; [`io_error`] gives the latter back as they were.
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
        let held = (MAX_BUFFER_BYTES / 4 / plane.max(1)).max(1);
        let wanted = least_common_multiple(multiple, self.reader.batch_planes());
        let planes = match wanted <= 4 * held {
            // As many times as many as are held easily.
            true => wanted * (held / wanted).max(1),
            false => multiple.max(1),
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
    /// Reads whole planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// Those of [`ImageStream::read_plane_rows`].
    pub fn read_planes(&self, first: usize, out: &mut [f32]) -> Result<()> {
        self.read_plane_rows(first, 0..self.header.dims[1], out)
    }

    /// Reads these rows of planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    pub fn read_plane_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.reader.read_rows(first, rows, out)?;
        if self.encoding.is_wide_integer() {
            // Bits of numbers without sign are in the order of the numbers.
            let bits = out.par_iter().map(|v| v.abs().to_bits()).max();
            self.max_magnitude_bits
                .fetch_max(bits.unwrap_or(0), Relaxed);
        }
        Ok(())
    }

    /// Whether its samples are so many that they are better left in the file, or there is no memory for
    /// them, or ranks share them; and may be, for none are missing and it has three axes.
    #[cfg(feature = "cli")]
    pub fn stays_in_file(&self) -> bool {
        let dims = self.header.dims;
        let count: usize = dims.iter().product();
        let shared = crate::comm::size() > 1;
        let large = shared
            || count > MAX_SAMPLES_IN_MEMORY
            || samples::check_memory(Path::new("the image"), 3 * count).is_err();
        large && self.header.missing.is_empty() && dims.iter().all(|&n| n > 1)
    }

    /// Reads all samples.
    ///
    /// # Errors
    /// [`Error::Job`](crate::Error::Job) if there is no memory for them, [`Error::Io`](crate::Error::Io) if
    /// they cannot be read.
    pub fn into_loaded(mut self, place: &Path) -> Result<LoadedImage> {
        let count = self.header.dims.iter().product();
        let mut samples = samples::allocate(place, count)?;
        let rows = 0..self.header.dims[1];
        self.reader.read_rows(0, rows, &mut samples)?;
        let note = self.encoding.rounding_note(&samples);
        let exact = match note {
            Some(_) => self.reader.read_integers(self.header.dims)?,
            None => None,
        };
        self.header.notes.extend(note);
        let mut loaded = self.header.with_samples(samples);
        loaded.image.labels = exact;
        Ok(loaded)
    }

    /// What must be said of the samples that were read.
    pub fn rounding_note(&self) -> Option<String> {
        let largest = f32::from_bits(self.max_magnitude_bits.load(Relaxed));
        self.encoding.rounding_note(&[largest])
    }
}

/// Samples that lie in a file as they are, the fastest axis first.
pub struct RawPlanes {
    pub path: PathBuf,
    pub file: File,
    /// The byte at which they begin.
    pub data_offset: u64,
    pub encoding: Encoding,
    /// Samples of a plane along its axes.
    pub plane_dims: [usize; 2],
}

impl PlaneReader for RawPlanes {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let [nx, ny] = self.plane_dims;
        // Whole planes follow one another in the file.
        let together = match rows.len() == ny {
            true => out.len(),
            false => rows.len() * nx,
        };
        for (plane, out) in (first..).zip(out.chunks_mut(together.max(1))) {
            let sample = (plane * ny + rows.start) * nx;
            let at = self.data_offset + (sample * self.encoding.size()) as u64;
            let read = self.encoding.read(&self.file, at, out);
            read.map_err(|e| io_error(&self.path, "read", e))?;
        }
        Ok(())
    }

    fn read_integers(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let count = dims.iter().product();
        let exact = self
            .encoding
            .read_exact_labels(&self.file, self.data_offset, count);
        exact.map_err(|e| io_error(&self.path, "read", e))
    }
}

/// Samples of which some values are read as NaN.
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

    fn read_integers(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        self.reader.read_integers(dims)
    }
}

/// Makes a sample that holds a null value NaN.
fn null_to_nan(sample: &mut f32, nulls: &[f32]) {
    if nulls.iter().any(|&null| is_null(*sample, null)) {
        *sample = f32::NAN;
    }
}

/// An image that was opened: in memory, or still in its file.
pub enum OpenedImage {
    /// Still in its file.
    Stream(ImageStream),
    /// In memory.
    InMemory(AnyImage),
}

impl OpenedImage {
    /// With all samples in memory.
    ///
    /// # Errors
    /// Those of [`ImageStream::into_loaded`].
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
            Self::InMemory(AnyImage::Plane(mut loaded)) => {
                loaded
                    .image
                    .samples
                    .iter_mut()
                    .for_each(|s| null_to_nan(s, nulls));
                Self::InMemory(AnyImage::Plane(loaded))
            }
            Self::InMemory(AnyImage::Space(mut loaded)) => {
                loaded
                    .image
                    .samples
                    .iter_mut()
                    .for_each(|s| null_to_nan(s, nulls));
                Self::InMemory(AnyImage::Space(loaded))
            }
        }
    }

    /// Its head, if it has `D` axes.
    pub fn into_header<const D: usize>(self) -> Option<ImageHeader<D>> {
        let head: Box<dyn std::any::Any> = match self {
            Self::Stream(stream) => Box::new(stream.header),
            Self::InMemory(AnyImage::Plane(loaded)) => Box::new(loaded.header()),
            Self::InMemory(AnyImage::Space(loaded)) => Box::new(loaded.header()),
        };
        head.downcast().ok().map(|head| *head)
    }
}
