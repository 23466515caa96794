//! Access to the samples of an image some layers at a time, because the image may be larger than
//! memory.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;
use std::path::Path;

use super::formats::{samples, stream::ImageStream};
use super::{Geometry, Image};
use crate::Result;
use crate::geometry::counting_sort::sort_by_group_into;
use crate::parallel::prelude::*;

/// Number of samples that are read together.
const MAX_SAMPLES_PER_READ: usize = 1 << 22;

/// Source of samples in layers: planes along x and y in 3-D, rows in 2-D.
pub trait ImageLayers<const D: usize>: Sync {
    /// Returns the number of samples along each axis, x first.
    fn dims(&self) -> [usize; D];

    /// Returns the position of the samples in the world.
    fn geometry(&self) -> &Geometry<D>;

    /// Fills `out` with the samples of a range of rows (along x, numbered within a layer) of
    /// consecutive layers, beginning with layer `first`.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if the samples cannot be read.
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()>;

    /// Fills `out` with the samples of consecutive whole layers, beginning with layer `first`.
    ///
    /// # Errors
    /// Returns the errors of [`ImageLayers::read_rows`].
    fn read_layers(&self, first: usize, out: &mut [f32]) -> Result<()> {
        self.read_rows(first, 0..rows_per_layer(self.dims()), out)
    }

    /// Loads the whole image into memory.
    ///
    /// # Errors
    /// Returns the errors of [`ImageLayers::read_layers`], and an [`Error::Job`](crate::Error::Job)
    /// if there is not enough memory.
    fn load(&self) -> Result<Image<D>>;
}

/// Returns the number of rows along x in a layer.
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
        if self.encoding.may_need_exact_labels(image.as_slice()) {
            image.labels = self.reader.read_exact_labels(self.header.dims)?;
        }
        Ok(image.with_missing(self.header.missing.clone()))
    }
}

/// An image in memory, or a source of its layers.
#[derive(Clone, Copy)]
pub enum ImageSource<'a, const D: usize> {
    /// An image in memory.
    InMemory(&'a Image<D>),
    /// A source of layers, without missing rows.
    Layered(&'a dyn ImageLayers<D>),
}

impl<'a, const D: usize> From<&'a Image<D>> for ImageSource<'a, D> {
    fn from(image: &'a Image<D>) -> Self {
        Self::InMemory(image)
    }
}

impl<const D: usize> fmt::Debug for ImageSource<'_, D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} samples", self.dims())
    }
}

impl<'a, const D: usize> ImageSource<'a, D> {
    /// Returns the number of samples along each axis, x first.
    pub fn dims(&self) -> [usize; D] {
        match self {
            Self::InMemory(image) => image.dims(),
            Self::Layered(layers) => layers.dims(),
        }
    }

    /// Returns the position of the samples in the world.
    pub fn geometry(&self) -> &'a Geometry<D> {
        match self {
            Self::InMemory(image) => &image.geometry,
            Self::Layered(layers) => layers.geometry(),
        }
    }

    /// Returns the values at `len` (fractional) sample indices, interpolated as in
    /// [`Image::interpolate_linear`]; NaN where there is no index. `index_of(i)` returns the index
    /// with number `i`. It is called more than once for each `i`, because storing a hundred million
    /// indices would take too much memory.
    ///
    /// # Errors
    /// Returns the errors of reading the layers.
    pub fn interpolate_linear(
        &self,
        len: usize,
        index_of: impl Fn(usize) -> Option<[f64; D]> + Sync,
    ) -> Result<Vec<f32>> {
        let layers = match self {
            Self::InMemory(image) => {
                let value =
                    |i: usize| index_of(i).map_or(f32::NAN, |x| image.interpolate_linear(x));
                return Ok((0..len).into_par_iter().map(value).collect());
            }
            Self::Layered(layers) => layers,
        };
        let dims = layers.dims();
        let (layer_count, layer_len) = (dims[D - 1], dims[..D - 1].iter().product::<usize>());
        let last = (layer_count - 1) as f64;
        let last_coordinate = |x: [f64; D]| x[D - 1].clamp(0.0, last);
        let layer_of = |i: usize| index_of(i).map_or(0, |x| last_coordinate(x) as u32);
        let (mut start, mut order) = (Vec::new(), Vec::new());
        let layer_of: Vec<u32> = (0..len).into_par_iter().map(layer_of).collect();
        sort_by_group_into(layer_count, &layer_of, &mut start, &mut order);
        drop(layer_of);
        let mut values = vec![f32::NAN; len];
        let layers_per_read = (MAX_SAMPLES_PER_READ / layer_len.max(1)).max(1);
        for first in (0..layer_count).step_by(layers_per_read) {
            let end = (first + layers_per_read).min(layer_count);
            let indices = &order[start[first] as usize..start[end] as usize];
            if indices.is_empty() {
                continue;
            }
            let mut part_dims = dims;
            part_dims[D - 1] = (end + 1).min(layer_count) - first;
            let mut samples = vec![0.0; part_dims[D - 1] * layer_len];
            layers.read_layers(first, &mut samples)?;
            let value = |&i: &u32| {
                index_of(i as usize).map_or(f32::NAN, |mut x| {
                    x[D - 1] = last_coordinate(x) - first as f64;
                    super::interpolate_linear(part_dims, &samples, x)
                })
            };
            let interpolated: Vec<f32> = indices.par_iter().map(value).collect();
            for (&i, value) in indices.iter().zip(interpolated) {
                values[i as usize] = value;
            }
        }
        Ok(values)
    }

    /// Returns the whole image in memory.
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
