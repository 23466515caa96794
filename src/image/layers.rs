//! Images whose samples are taken some layers at a time, for they may be larger than memory.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;
use std::path::Path;

use super::formats::{samples, stream::ImageStream};
use super::{Geometry, Image};
use crate::Result;
use crate::geometry::counting_sort::sort_by_group_into;
use crate::parallel::prelude::*;

/// Samples that are read together.
const MAX_SAMPLES_PER_READ: usize = 1 << 22;

/// Samples by layers: planes along x and y in 3-D, rows in 2-D.
pub trait ImageLayers<const D: usize>: Sync {
    /// Samples along each axis, x first.
    fn dims(&self) -> [usize; D];

    /// Where they lie.
    fn geometry(&self) -> &Geometry<D>;

    /// Fills `out` with the samples of these rows (along x, numbered in a layer) of layers, from the one numbered
    /// `first` on.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if they cannot be read.
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()>;

    /// The same of whole layers.
    ///
    /// # Errors
    /// Those of [`ImageLayers::read_rows`].
    fn read_layers(&self, first: usize, out: &mut [f32]) -> Result<()> {
        self.read_rows(first, 0..rows_per_layer(self.dims()), out)
    }

    /// All of them.
    ///
    /// # Errors
    /// Those of [`ImageLayers::read_layers`], and [`Error::Job`](crate::Error::Job) if there is no memory for them.
    fn load(&self) -> Result<Image<D>>;
}

/// Rows along x of a layer.
pub fn rows_per_layer<const D: usize>(dims: [usize; D]) -> usize {
    dims[1..D - 1].iter().product()
}

impl ImageLayers<3> for ImageStream {
    fn dims(&self) -> [usize; 3] {
        self.header.dims
    }

    fn geometry(&self) -> &Geometry<3> {
        &self.header.geometry
    }

    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.read_plane_rows(first, rows, out)
    }

    fn load(&self) -> Result<Image<3>> {
        let mut samples =
            samples::allocate(Path::new("the image"), self.header.dims.iter().product())?;
        self.read_planes(0, &mut samples)?;
        let mut image = Image::new(self.header.dims, samples, self.header.geometry.clone());
        if self.rounding_note().is_some() {
            image.labels = self.reader.read_integers(self.header.dims)?;
        }
        Ok(image.with_missing(self.header.missing.clone()))
    }
}

/// An image, in memory or by its layers.
#[derive(Clone, Copy)]
pub enum ImageSource<'a, const D: usize> {
    /// In memory.
    InMemory(&'a Image<D>),
    /// Where layers of it are read. No rows of it are missing.
    Layered(&'a dyn ImageLayers<D>),
}

impl<const D: usize> fmt::Debug for ImageSource<'_, D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} samples", self.dims())
    }
}

impl<'a, const D: usize> ImageSource<'a, D> {
    /// Samples along each axis, x first.
    pub fn dims(&self) -> [usize; D] {
        match self {
            Self::InMemory(image) => image.dims(),
            Self::Layered(layers) => layers.dims(),
        }
    }

    /// Where they lie.
    pub fn geometry(&self) -> &'a Geometry<D> {
        match self {
            Self::InMemory(image) => &image.geometry,
            Self::Layered(layers) => layers.geometry(),
        }
    }

    /// The values at `len` (fractional) sample indices, as [`MirrorImage::interpolate_linear`] gives them; NaN where there is
    /// none. Index `i` is `at(i)`, asked for more than once, since there may be a hundred million.
    ///
    /// # Errors
    /// That of reading.
    pub fn interpolate_linear(
        &self,
        len: usize,
        at: impl Fn(usize) -> Option<[f64; D]> + Sync,
    ) -> Result<Vec<f32>> {
        let layers = match self {
            Self::InMemory(image) => {
                let value = |i: usize| at(i).map_or(f32::NAN, |x| image.interpolate_linear(x));
                return Ok((0..len).into_par_iter().map(value).collect());
            }
            Self::Layered(layers) => layers,
        };
        let dims = layers.dims();
        let (count, layer) = (dims[D - 1], dims[..D - 1].iter().product::<usize>());
        let last = (count - 1) as f64;
        let along = |x: [f64; D]| x[D - 1].clamp(0.0, last);
        let layer_of = |i: usize| at(i).map_or(0, |x| along(x) as u32);
        let (mut start, mut order) = (Vec::new(), Vec::new());
        let layer_of: Vec<u32> = (0..len).into_par_iter().map(layer_of).collect();
        sort_by_group_into(count, &layer_of, &mut start, &mut order);
        drop(layer_of);
        let mut values = vec![f32::NAN; len];
        let together = (MAX_SAMPLES_PER_READ / layer.max(1)).max(1);
        for first in (0..count).step_by(together) {
            let end = (first + together).min(count);
            let these = &order[start[first] as usize..start[end] as usize];
            if these.is_empty() {
                continue;
            }
            let mut part = dims;
            part[D - 1] = (end + 1).min(count) - first;
            let mut samples = vec![0.0; part[D - 1] * layer];
            layers.read_layers(first, &mut samples)?;
            let value = |&i: &u32| {
                at(i as usize).map_or(f32::NAN, |mut x| {
                    x[D - 1] = along(x) - first as f64;
                    super::interpolate_linear(part, &samples, x)
                })
            };
            let found: Vec<f32> = these.par_iter().map(value).collect();
            for (&i, value) in these.iter().zip(found) {
                values[i as usize] = value;
            }
        }
        Ok(values)
    }

    /// The whole image in memory.
    ///
    /// # Errors
    /// Those of [`ImageLayers::load`].
    pub fn to_image(&self) -> Result<Cow<'a, Image<D>>> {
        match self {
            Self::InMemory(image) => Ok(Cow::Borrowed(image)),
            Self::Layered(layers) => layers.load().map(Cow::Owned),
        }
    }
}
