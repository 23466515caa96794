//! Images whose samples are read when they are wanted, plane by plane: these may be larger than memory.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::parallel::prelude::*;
use ndarray::ArrayD;

use super::placement::BARE;
use super::samples::{self, Encoding};
use super::segy::{Lines, SegyInfo};
use super::{AnyLoaded, Format, Loaded, of_its_axes};
use crate::error::{Result, os};
use crate::image::nulls::is_null;
use crate::image::{ExactLabels, Geometry, Image};
use crate::memory;

/// All that is known of an image but its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Head<const D: usize> {
    /// Samples along each axis, x first.
    pub dims: [usize; D],
    /// Where they lie.
    pub geometry: Geometry<D>,
    /// Which rows along x hold no data, as [`Image::missing`] has it.
    pub missing: Vec<bool>,
    /// See [`Loaded::format`] and what follows there.
    pub format: Format,
    pub encoding: String,
    pub notes: Vec<String>,
    pub survey: Option<SegyInfo>,
    pub lines: Option<[Lines; 2]>,
}

impl Head<3> {
    /// Of a file that says nothing but how many samples there are and how they are coded; `what` it is.
    pub fn bare(format: Format, dims: [usize; 3], encoding: Encoding, what: &str) -> Self {
        Self {
            dims,
            geometry: Geometry::default(),
            missing: Vec::new(),
            format,
            encoding: encoding.to_string(),
            notes: vec![format!("{what} {BARE}")],
            survey: None,
            lines: None,
        }
    }
}

impl<const D: usize> Head<D> {
    /// With its samples in memory order, of which there must be as many.
    pub fn with(self, samples: Vec<f32>) -> Loaded<D> {
        // An array of its shape, to be placed below.
        let bare = Image::new(self.dims, samples, Geometry::default());
        self.with_array(bare.samples)
    }

    /// With its samples as an array of its shape, in standard layout.
    pub fn with_array(self, samples: ArrayD<f32>) -> Loaded<D> {
        let image = Image {
            labels: None,
            samples,
            geometry: self.geometry,
            missing: Vec::new(),
            dead: Vec::new(),
        };
        Loaded {
            image: image.with_missing(self.missing),
            format: self.format,
            encoding: self.encoding,
            notes: self.notes,
            survey: self.survey,
            lines: self.lines,
        }
    }
}

impl<const D: usize> Loaded<D> {
    /// All that is known of it but its samples.
    pub fn head(&self) -> Head<D> {
        Head {
            dims: self.image.dims(),
            geometry: self.image.geometry.clone(),
            missing: self.image.missing.clone(),
            format: self.format,
            encoding: self.encoding.clone(),
            notes: self.notes.clone(),
            survey: self.survey.clone(),
            lines: self.lines,
        }
    }
}

/// Samples in a file, which are read by planes along x and y.
pub trait Planes: Send + Sync {
    /// Fills `out` with these rows (along x, numbered in a plane) of planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    fn read(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()>;

    /// How many planes are best read together.
    fn together(&self) -> usize {
        1
    }

    /// All samples as integers, in the order of memory, where they are integers that `f32` may round; `None` if
    /// they are not, or cannot be had so.
    ///
    /// # Errors
    /// Those of [`Planes::read`].
    fn integers(&self, _dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        Ok(None)
    }
}

/// An image of space whose samples are still in its file.
pub struct Stream {
    /// What is known without them.
    pub head: Head<3>,
    /// How an element is coded, for those that may be rounded.
    pub coded: Encoding,
    pub planes: Box<dyn Planes>,
    /// The largest magnitude among the samples that were read, as bits.
    pub largest: AtomicU32,
}

/// Images of more samples are left in their files where they can be.
#[cfg(feature = "cli")]
const LARGE: usize = 1 << 26;

/// Bytes of samples that are held at a time, unless a single plane takes more.
const HELD: usize = 1 << 26;

/// Samples in the order of memory, a slab of planes at a time.
pub trait Slabs {
    /// Calls `work` for one slab after the other, each of whole planes along the last axis: as many as
    /// `multiple` of these, or any number of times as many, but for the last.
    ///
    /// # Errors
    /// Those of the work and of reading; [`os`] gives the latter back as they were.
    fn each(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()>;
}

impl<const D: usize> Slabs for Image<D> {
    fn each(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let plane: usize = self.dims()[..D - 1].iter().product();
        let slab = plane.saturating_mul(multiple).max(1);
        self.as_slice().chunks(slab).try_for_each(work)
    }
}

impl Slabs for Stream {
    fn each(
        &self,
        multiple: usize,
        work: &mut dyn FnMut(&[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let [nx, ny, nz] = self.head.dims;
        let plane = nx * ny;
        let held = (HELD / 4 / plane.max(1)).max(1);
        let wanted = least_common_multiple(multiple, self.planes.together());
        let planes = match wanted <= 4 * held {
            // As many times as many as are held easily.
            true => wanted * (held / wanted).max(1),
            false => multiple.max(1),
        };
        let planes = planes.min(nz.max(1));
        memory::afford(
            "a part of the image",
            4.0 * (planes * plane) as f64,
            format!("{planes} planes of {nx} x {ny} samples"),
            "write it with smaller chunks",
        )
        .map_err(io::Error::other)?;
        let mut slab = vec![0.0; planes * plane];
        for first in (0..nz).step_by(planes) {
            let part = &mut slab[..planes.min(nz - first) * plane];
            self.planes(first, part).map_err(io::Error::other)?;
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

impl Stream {
    /// Reads whole planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// Those of [`Stream::rows`].
    pub fn planes(&self, first: usize, out: &mut [f32]) -> Result<()> {
        self.rows(first, 0..self.head.dims[1], out)
    }

    /// Reads these rows of planes, from the one numbered `first` on.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    pub fn rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.planes.read(first, rows, out)?;
        if self.coded.is_wide() {
            // Bits of numbers without sign are in the order of the numbers.
            let bits = out.par_iter().map(|v| v.abs().to_bits()).max();
            self.largest.fetch_max(bits.unwrap_or(0), Relaxed);
        }
        Ok(())
    }

    /// Whether its samples are so many that they are better left in the file, or there is no memory for
    /// them, or ranks share them; and may be, for none are missing and it has three axes.
    #[cfg(feature = "cli")]
    pub fn stays(&self) -> bool {
        let dims = self.head.dims;
        let count: usize = dims.iter().product();
        let shared = crate::ranks::count() > 1;
        let large =
            shared || count > LARGE || samples::afford(Path::new("the image"), 3 * count).is_err();
        large && self.head.missing.is_empty() && dims.iter().all(|&n| n > 1)
    }

    /// Reads all samples.
    ///
    /// # Errors
    /// [`Error::Job`](crate::Error::Job) if there is no memory for them, [`Error::Io`](crate::Error::Io) if
    /// they cannot be read.
    pub fn loaded(mut self, place: &Path) -> Result<Loaded> {
        let count = self.head.dims.iter().product();
        let mut samples = samples::room(place, count)?;
        let rows = 0..self.head.dims[1];
        self.planes.read(0, rows, &mut samples)?;
        let note = self.coded.rounding_note(&samples);
        let exact = match note {
            Some(_) => self.planes.integers(self.head.dims)?,
            None => None,
        };
        self.head.notes.extend(note);
        let mut loaded = self.head.with(samples);
        loaded.image.labels = exact;
        Ok(loaded)
    }

    /// What must be said of the samples that were read.
    pub fn note(&self) -> Option<String> {
        let largest = f32::from_bits(self.largest.load(Relaxed));
        self.coded.rounding_note(&[largest])
    }
}

/// Samples that lie in a file as they are, the fastest axis first.
pub struct Plain {
    pub path: PathBuf,
    pub file: File,
    /// The byte at which they begin.
    pub start: u64,
    pub encoding: Encoding,
    /// Samples of a plane along its axes.
    pub plane: [usize; 2],
}

impl Planes for Plain {
    fn read(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let [nx, ny] = self.plane;
        // Whole planes follow one another in the file.
        let together = match rows.len() == ny {
            true => out.len(),
            false => rows.len() * nx,
        };
        for (plane, out) in (first..).zip(out.chunks_mut(together.max(1))) {
            let sample = (plane * ny + rows.start) * nx;
            let at = self.start + (sample * self.encoding.size()) as u64;
            let read = self.encoding.read(&self.file, at, out);
            read.map_err(|e| os(&self.path, "read", e))?;
        }
        Ok(())
    }

    fn integers(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let count = dims.iter().product();
        let exact = self.encoding.read_exact(&self.file, self.start, count);
        exact.map_err(|e| os(&self.path, "read", e))
    }
}

/// Samples of which some values are read as NaN.
struct WithNulls {
    planes: Box<dyn Planes>,
    nulls: Vec<f32>,
}

impl Planes for WithNulls {
    fn read(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.planes.read(first, rows, out)?;
        out.par_iter_mut().for_each(|s| blank(s, &self.nulls));
        Ok(())
    }

    fn together(&self) -> usize {
        self.planes.together()
    }

    fn integers(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        self.planes.integers(dims)
    }
}

/// Makes a sample that holds a null value NaN.
fn blank(sample: &mut f32, nulls: &[f32]) {
    if nulls.iter().any(|&null| is_null(*sample, null)) {
        *sample = f32::NAN;
    }
}

/// An image that was opened: in memory, or still in its file.
pub enum Opened {
    /// Still in its file.
    Stream(Stream),
    /// In memory.
    Held(AnyLoaded),
}

impl Opened {
    /// With all samples in memory.
    ///
    /// # Errors
    /// Those of [`Stream::loaded`].
    pub fn load(self, place: &Path) -> Result<AnyLoaded> {
        match self {
            Self::Stream(stream) => stream.loaded(place).map(of_its_axes),
            Self::Held(loaded) => Ok(loaded),
        }
    }

    /// Returns the image with samples of these values read as NaN.
    pub fn with_nulls(self, nulls: &[f32]) -> Self {
        if nulls.is_empty() {
            return self;
        }
        match self {
            Self::Stream(stream) => Self::Stream(Stream {
                planes: Box::new(WithNulls {
                    planes: stream.planes,
                    nulls: nulls.to_vec(),
                }),
                ..stream
            }),
            Self::Held(AnyLoaded::Plane(mut loaded)) => {
                loaded
                    .image
                    .samples
                    .iter_mut()
                    .for_each(|s| blank(s, nulls));
                Self::Held(AnyLoaded::Plane(loaded))
            }
            Self::Held(AnyLoaded::Space(mut loaded)) => {
                loaded
                    .image
                    .samples
                    .iter_mut()
                    .for_each(|s| blank(s, nulls));
                Self::Held(AnyLoaded::Space(loaded))
            }
        }
    }

    /// Its head, if it has `D` axes.
    pub fn head<const D: usize>(self) -> Option<Head<D>> {
        let head: Box<dyn std::any::Any> = match self {
            Self::Stream(stream) => Box::new(stream.head),
            Self::Held(AnyLoaded::Plane(loaded)) => Box::new(loaded.head()),
            Self::Held(AnyLoaded::Space(loaded)) => Box::new(loaded.head()),
        };
        head.downcast().ok().map(|head| *head)
    }
}
