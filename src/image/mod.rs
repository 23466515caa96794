//! Images in memory: samples on a regular grid, and where that grid lies in the world.
//!
//! Axis order: `dims`, indices and positions are written x first (`[nx, ny, nz]`); in memory x is
//! the fastest axis, so the array's NumPy shape is `(nz, ny, nx)`.
//!
//! - [`geometry`]: from sample indices to physical coordinates
//! - [`check`]: statistics, and refusing what no mesh can be made of
//! - [`field`]: samples in *lattice space* and their smooth interpolation

pub mod check;
pub mod field;
pub mod formats;
pub mod geometry;
pub mod synth;

pub use check::Stats;
pub use field::Field;
pub use geometry::Geometry;

use ndarray::ArrayD;

/// A `D`-dimensional image: `f32` samples and their [`Geometry`].
#[derive(Debug, Clone, PartialEq)]
pub struct Image<const D: usize> {
    /// Samples in C order, shape `(.., ny, nx)`; always in standard layout.
    pub samples: ArrayD<f32>,
    /// Where the samples lie.
    pub geometry: Geometry<D>,
}

impl<const D: usize> Image<D> {
    /// An image from samples in memory order (x fastest), `samples.len() == product of dims`.
    pub fn new(dims: [usize; D], samples: Vec<f32>, geometry: Geometry<D>) -> Self {
        let shape: Vec<usize> = dims.iter().rev().copied().collect();
        #[allow(clippy::expect_used)]
        let samples = ArrayD::from_shape_vec(shape, samples)
            .expect("the number of samples is the product of the dims");
        Self { samples, geometry }
    }

    /// Number of samples along each axis, x first.
    pub fn dims(&self) -> [usize; D] {
        let shape = self.samples.shape();
        std::array::from_fn(|k| shape[D - 1 - k])
    }

    /// The samples in memory order, x fastest.
    pub fn as_slice(&self) -> &[f32] {
        #[allow(clippy::expect_used)]
        self.samples.as_slice().expect("standard layout")
    }
}

impl<const D: usize> Image<D> {
    /// The image as part of space: a 2-D image becomes one of a single sample along z, at z = 0.
    pub fn in_space(&self) -> Image<3> {
        let dims = self.dims();
        let geometry = self.geometry.in_space();
        let dims = std::array::from_fn(|k| dims.get(k).copied().unwrap_or(1));
        Image::new(dims, self.as_slice().to_vec(), geometry)
    }
}

impl Image<3> {
    /// The first section along x and y as a 2-D image. Where its plane is that of the physical x and
    /// y it stays there; else its coordinates are measured in the plane, from the first sample,
    /// along the x axis and across.
    pub fn flatten(&self) -> Image<2> {
        let [nx, ny, _] = self.dims();
        let samples = self.as_slice()[..nx * ny].to_vec();
        Image::new([nx, ny], samples, self.geometry.flatten())
    }
}
