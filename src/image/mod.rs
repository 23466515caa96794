//! Images in memory: samples on a regular grid, and the position of that grid in the world.
//!
//! Axis order: `dims`, indices and positions are written x first (`[nx, ny, nz]`). In memory x is
//! the fastest axis, so the NumPy shape of the array is `(nz, ny, nx)`.
//!
//! - `geometry`: maps sample indices to physical coordinates
//! - `modality`: distinguishes seismic surveys from scans
//! - `time`: two-way time as a coordinate, and its conversion to depth by one velocity
//! - `velocity`: interval velocities on a grid of their own in two-way time
//! - `time_depth`: depth as a function of two-way time at one position, and its inverse
//! - `depth_conversion`: converts an image from two-way time to depth
//! - `check`: statistics of samples, and the check that an image can be meshed
//! - `field`: samples in *lattice space* and their smooth interpolation
//! - `bricks`: small blocks of samples, of which each rank has those that it needs
//! - `sparse_field`: such a field for a function that is zero nearly everywhere
//! - `labels`: exact label values
//! - `layers`: samples of an image in memory or in a file, some layers at a time
//! - `live_mask`: the samples that hold data, and the gaps between them
//! - `live_volume`: the share of a cell that holds data
//! - `nulls`: finds samples that hold no data
//! - `point_nulls`: finds points whose z is a null value
//! - `stated`: statements of files and options about coordinates
//! - `placing`: brings positions that a user gives into the frame of an image
//! - `fault_traces`: traces on the two sides of a fault, and the lag at which they agree
//! - `contrast`: the contrast of faults and horizons over that at random places
//! - `formats`: image files
//! - `synth`: synthetic images with exactly known features

pub(crate) mod bricks;
pub(crate) mod check;
pub(crate) mod contrast;
pub(crate) mod depth_conversion;
pub(crate) mod fault_traces;
pub(crate) mod field;
pub mod formats;
pub(crate) mod geometry;
pub(crate) mod labels;
pub(crate) mod layers;
pub(crate) mod live_mask;
pub(crate) mod live_volume;
pub(crate) mod modality;
pub(crate) mod nulls;
pub mod placing;
pub(crate) mod point_nulls;
pub(crate) mod sparse_field;
pub mod stated;
pub mod synth;
pub(crate) mod time;
pub(crate) mod time_depth;
pub(crate) mod velocity;

pub use check::Stats;
pub use depth_conversion::DepthConversion;
pub(crate) use depth_conversion::image_in_depth;
pub use field::ScalarField;
pub use geometry::{Geometry, NoAngles};
pub use labels::{ExactLabels, LabelTable, LabelValue};
pub use layers::{ImageLayers, ImageSource};
pub(crate) use live_mask::LiveMask;
use live_mask::distance_squared;
pub(crate) use live_volume::LiveVolume;
pub use modality::Modality;
pub use nulls::MaskedImage;
pub use sparse_field::SparseField;
pub use time::{NoDepthReason, TimeCoordinate};
pub use time_depth::TimeDepthCurve;
pub(crate) use velocity::read_velocities;
pub use velocity::{VelocityCoverage, VelocityModel};

use std::sync::Arc;

use ndarray::ArrayD;

use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::{for_each_corner, index_at, offset_of};

/// A `D`-dimensional image: `f32` samples and their [`Geometry`].
#[derive(Debug, Clone, PartialEq)]
pub struct Image<const D: usize> {
    /// Samples in C order, shape `(.., ny, nx)`; always in standard layout.
    pub samples: ArrayD<f32>,
    /// Position of the samples in the world.
    pub geometry: Geometry<D>,
    /// One flag per row of samples along x, in memory order: `true` if the row holds no data, such
    /// as a trace that a survey lacks. The samples of such a row are zeros without meaning. Empty
    /// if every row holds data. No file format stores these flags.
    pub missing: Vec<bool>,
    /// One flag per sample, in memory order: `true` if the sample holds no data. Such a sample is a
    /// zero without meaning. Empty unless dead samples differ from whole rows along x. No file
    /// format stores these flags.
    pub dead: Vec<bool>,
    /// Exact labels of the samples, if they are integers that 32-bit floats would round.
    pub labels: Option<Arc<ExactLabels>>,
    /// Names of labels, as a file gives them.
    pub label_names: Vec<(LabelValue, String)>,
}

impl<const D: usize> Image<D> {
    /// Creates an image from samples in memory order (x fastest). The number of samples must be the
    /// product of `dims`.
    pub fn new(dims: [usize; D], samples: Vec<f32>, geometry: Geometry<D>) -> Self {
        #[allow(clippy::expect_used)]
        Self::try_new(dims, samples, geometry)
            .expect("the number of samples must be the product of the dimensions")
    }

    /// Creates an image from samples in memory order.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if the number of samples is not the product of `dims`.
    pub fn try_new(dims: [usize; D], samples: Vec<f32>, geometry: Geometry<D>) -> Result<Self> {
        let count = samples.len();
        let shape: Vec<usize> = dims.iter().rev().copied().collect();
        let samples = ArrayD::from_shape_vec(shape, samples).map_err(|_| {
            Error::Image(cause(
                format!("an image of {dims:?} samples"),
                format!("is given {count} samples"),
                "give one sample for each position, the first axis fastest",
            ))
        })?;
        Ok(Self {
            samples,
            geometry,
            missing: Vec::new(),
            dead: Vec::new(),
            labels: None,
            label_names: Vec::new(),
        })
    }

    /// Creates an image by sampling a function of the physical position.
    pub(crate) fn from_fn(
        dims: [usize; D],
        geometry: Geometry<D>,
        mut value: impl FnMut([f64; D]) -> f64,
    ) -> Self {
        let sample = |offset: usize| {
            let index = index_at(dims, offset).map(|i| i as f64);
            value(geometry.to_physical(index)) as f32
        };
        let samples = (0..dims.iter().product()).map(sample).collect();
        Self::new(dims, samples, geometry)
    }

    /// Returns the image with these rows along x marked as missing, one flag per row.
    pub fn with_missing(mut self, missing: Vec<bool>) -> Self {
        self.missing = if missing.contains(&true) {
            missing
        } else {
            Vec::new()
        };
        self
    }

    /// Returns the image with each missing row replaced by a copy of the nearest present row, so
    /// that filtered samples show no edge where the data end. Returns `None` if no row is missing
    /// or no row is present.
    pub fn with_missing_filled(&self) -> Option<Self> {
        let present: Vec<bool> = self.missing.iter().map(|missing| !missing).collect();
        if !present.contains(&true) {
            return None;
        }
        let dims = self.dims();
        let nearest = nearest_rows(dims, &present);
        let mut samples = Vec::with_capacity(self.samples.len());
        for row in nearest {
            let start = row as usize * dims[0];
            samples.extend_from_slice(&self.as_slice()[start..start + dims[0]]);
        }
        let continued = Self::new(dims, samples, self.geometry.clone());
        Some(continued.with_missing(self.missing.clone()))
    }

    /// Returns the image with each sample that holds no data replaced by a copy of the nearest sample
    /// that does, whatever its distance; the flags stay. At least one sample must hold data.
    pub(crate) fn filled_from_nearest(mut self) -> Self {
        let Some(gaps) = self.gaps() else {
            return self;
        };
        let (dims, flags) = (self.dims(), gaps.flags);
        let nearest = live_mask::nearest_cells(gaps.dims, |i| !flags[i], usize::MAX);
        let cell_of = |offset: usize| {
            let mut index = index_at(dims, offset);
            if let Some(axis) = gaps.uniform_axis {
                index[axis] = 0;
            }
            offset_of(gaps.dims, index)
        };
        let source_of = |offset: usize| {
            let mut source = index_at(gaps.dims, nearest[cell_of(offset)] as usize);
            if let Some(axis) = gaps.uniform_axis {
                source[axis] = index_at(dims, offset)[axis];
            }
            offset_of(dims, source)
        };
        let sources: Vec<usize> = (0..self.samples.len()).map(source_of).collect();
        let samples = sources
            .iter()
            .map(|&source| self.as_slice()[source])
            .collect();
        self.labels = self.labels.map(|labels| {
            let values = sources
                .iter()
                .map(|&i| labels.values[labels.indices[i] as usize]);
            ExactLabels::from_integers(values)
        });
        let filled = Self::new(dims, samples, self.geometry.clone());
        Self {
            samples: filled.samples,
            ..self
        }
    }

    /// Returns one flag per row along x: `true` if the row is missing or lies at most `reach`
    /// samples from a missing one. The result is empty if no row is missing.
    pub fn rows_near_missing(&self, reach: f64) -> Vec<bool> {
        if self.missing.is_empty() {
            return Vec::new();
        }
        let dims = self.dims();
        let nearest = nearest_rows(dims, &self.missing);
        let is_near = |(row, missing): (usize, u32)| {
            distance_squared(row_grid(dims), row, missing as usize) as f64 <= reach * reach
        };
        nearest.into_iter().enumerate().map(is_near).collect()
    }

    /// Returns the number of samples along each axis, x first.
    pub fn dims(&self) -> [usize; D] {
        let shape = self.samples.shape();
        std::array::from_fn(|k| shape[D - 1 - k])
    }

    /// Returns the value at a (fractional) sample index by linear interpolation. Outside the image
    /// it is the value of the nearest sample.
    pub fn interpolate_linear(&self, index: [f64; D]) -> f32 {
        interpolate_linear(self.dims(), self.as_slice(), index)
    }

    /// Returns the samples in memory order, x fastest.
    pub fn as_slice(&self) -> &[f32] {
        #[allow(clippy::expect_used)]
        self.samples.as_slice().expect("standard layout")
    }
}

impl<const D: usize> Image<D> {
    /// Returns the image as a 3-D image. A 2-D image becomes a volume with a single sample along z,
    /// at z = 0.
    pub fn to_3d(&self) -> Image<3> {
        let dims = self.dims();
        let geometry = self.geometry.to_3d();
        let dims = std::array::from_fn(|k| dims.get(k).copied().unwrap_or(1));
        let mut space = Image::new(dims, self.as_slice().to_vec(), geometry);
        space.labels.clone_from(&self.labels);
        space.label_names.clone_from(&self.label_names);
        space.missing.clone_from(&self.missing);
        space.dead.clone_from(&self.dead);
        space
    }
}

impl Image<3> {
    /// Returns the first section along x and y as a 2-D image.
    ///
    /// If its plane is parallel to the physical x and y axes, the coordinates stay as they are.
    /// Otherwise they are measured in the plane: in an upright section along the section from its
    /// first sample, and upwards; in any other section from the first sample along the x axis and
    /// perpendicular to it.
    pub fn flatten(&self) -> Image<2> {
        let [nx, ny, _] = self.dims();
        let samples = self.as_slice()[..nx * ny].to_vec();
        let missing = self.missing.iter().copied().take(ny).collect();
        let mut flat = Image::new([nx, ny], samples, self.geometry.flatten());
        flat.labels = self
            .labels
            .as_ref()
            .map(|labels| labels.take_first(nx * ny));
        flat.label_names.clone_from(&self.label_names);
        flat.with_missing(missing)
    }
}

/// Implements [`Image::interpolate_linear`] for a slice of samples.
fn interpolate_linear<const D: usize>(dims: [usize; D], samples: &[f32], index: [f64; D]) -> f32 {
    let mut value = 0.0;
    let add = |i: usize, weight| value += weight * samples[i];
    for_each_corner(dims, index, |t| t as f32, add);
    value
}

/// Returns the dimensions of the grid of rows along x.
fn row_grid<const D: usize>(mut dims: [usize; D]) -> [usize; D] {
    dims[0] = 1;
    dims
}

/// Returns for each row along x the nearest row whose flag is set. At least one flag must be set.
fn nearest_rows<const D: usize>(dims: [usize; D], targets: &[bool]) -> Vec<u32> {
    live_mask::nearest_cells(row_grid(dims), |row| targets[row], usize::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::uniform;

    #[test]
    fn an_image_needs_a_sample_for_each_position() {
        let image = |count| Image::try_new([3, 2], vec![0.0; count], Geometry::default());
        assert_eq!(image(6).unwrap().dims(), [3, 2]);
        let error = image(5).unwrap_err();
        assert!(matches!(error, Error::Image(_)), "{error}");
    }

    #[test]
    fn linear_functions_are_interpolated_exactly() {
        let plane = |x: [f64; 3]| 2.0 + x[0] - 3.0 * x[1] + 0.5 * x[2];
        let image = Image::from_fn([5, 4, 3], Geometry::default(), plane);
        for x in [
            [0.0; 3],
            [4.0, 3.0, 2.0],
            [1.25, 2.5, 0.75],
            [3.9, 0.1, 1.0],
        ] {
            assert!(
                (f64::from(image.interpolate_linear(x)) - plane(x)).abs() < 1e-5,
                "{x:?}"
            );
        }
        assert_eq!(
            image.interpolate_linear([9.0, -1.0, 2.0]),
            image.interpolate_linear([4.0, 0.0, 2.0])
        );
    }

    #[test]
    fn missing_rows_copy_the_nearest_present_row() {
        let dims = [3, 9, 8];
        let samples: Vec<f32> = (0..216).map(|i| i as f32).collect();
        let missing: Vec<bool> = (0..72).map(|row| uniform(1, row) > 0.25).collect();
        let image = Image::new(dims, samples, Geometry::default()).with_missing(missing.clone());
        let continued = image.with_missing_filled().unwrap();
        for row in 0..72 {
            let source = continued.as_slice()[3 * row] as usize / 3;
            assert!(!missing[source]);
            let present = (0..72).filter(|&r| !missing[r]);
            let min_distance = present
                .map(|r| distance_squared([1, 9, 8], row, r))
                .min()
                .unwrap();
            assert_eq!(
                distance_squared([1, 9, 8], row, source),
                min_distance,
                "{row}"
            );
        }
        let near_missing = image.rows_near_missing(2.0);
        for row in 0..72 {
            let mut gaps = (0..72).filter(|&r| missing[r]);
            assert_eq!(
                near_missing[row],
                gaps.any(|r| distance_squared([1, 9, 8], row, r) <= 4)
            );
        }
        // Nothing is filled if no row is missing, or if all rows are.
        let complete = image.clone().with_missing(vec![false; 72]);
        assert!(complete.missing.is_empty() && complete.with_missing_filled().is_none());
        assert!(
            image
                .with_missing(vec![true; 72])
                .with_missing_filled()
                .is_none()
        );
    }
}
