//! The nominal distance d(x) between neighbouring atoms near x, in lattice units.
//!
//! - `grading`: limits |grad d| by fast sweeping and preserves minima
//! - `features`: d that grows away from detected features
//! - `distributed_distance`: d that is distributed over ranks in layers
//! - `sources`: d from an image, or given as samples

pub(crate) mod distributed_distance;
pub(crate) mod features;
pub(crate) mod grading;
pub(crate) mod sources;

pub use distributed_distance::DistanceBricks;
pub(crate) use distributed_distance::DistributedDistance;
pub use features::{DistanceLimits, from_features};
pub(crate) use features::{coarse_field, lower_cell_corners};
pub use grading::limit_gradient;
pub use sources::{DenseRegion, from_image, from_samples};

use crate::geometry::grid_index::strides;
use crate::geometry::norm;
use std::f64::consts::SQRT_2;

use crate::parallel::prelude::*;

use crate::error::{Error, Result, cause};
use crate::image::ScalarField;

/// The nominal distance between neighbouring atoms, in lattice units.
#[derive(Debug, Clone, PartialEq)]
pub enum Distance<const D: usize> {
    /// One distance everywhere.
    Constant(f64),
    /// Samples over the lattice-space box, interpolated multilinearly, so that a value is never
    /// below the smallest or above the largest sample.
    Field(ScalarField<D>),
    /// Samples as for `Field`, of which only some bricks are local.
    Bricks(DistanceBricks<D>),
}

impl<const D: usize> Distance<D> {
    /// Returns d at a position in lattice space; outside the box, d at the nearest point of the
    /// box.
    #[inline]
    pub fn value_at(&self, position: [f64; D]) -> f64 {
        match self {
            Self::Constant(d) => *d,
            Self::Field(field) => GridCell::new(field, &position).value(),
            Self::Bricks(bricks) => bricks
                .cell(&position)
                .map_or(bricks.summary.max, |c| c.value()),
        }
    }

    /// Returns d and its gradient. The gradient is the exact derivative of [`Distance::value_at`]
    /// inside each cell of the grid, and zero along axes where the position lies outside the box.
    #[inline]
    pub fn value_and_gradient_at(&self, position: [f64; D]) -> (f64, [f64; D]) {
        match self {
            Self::Constant(d) => (*d, [0.0; D]),
            Self::Field(field) => GridCell::new(field, &position).value_and_gradient(),
            Self::Bricks(bricks) => match bricks.cell(&position) {
                Some(cell) => cell.value_and_gradient(),
                None => (bricks.summary.max, [0.0; D]),
            },
        }
    }

    /// Returns `true` if d was requested at a position where it is not local.
    pub(crate) fn has_misses(&self) -> bool {
        matches!(self, Self::Bricks(bricks) if bricks.has_misses())
    }

    /// Returns the smallest d anywhere; NaN if any sample is NaN.
    pub fn min(&self) -> f64 {
        match self {
            Self::Constant(d) => *d,
            Self::Field(field) => reduce(&field.samples, f32::min),
            Self::Bricks(bricks) => bricks.summary.min,
        }
    }

    /// Returns the largest d anywhere; NaN if any sample is NaN.
    pub fn max(&self) -> f64 {
        match self {
            Self::Constant(d) => *d,
            Self::Field(field) => reduce(&field.samples, f32::max),
            Self::Bricks(bricks) => bricks.summary.max,
        }
    }

    /// Returns a bound on |grad d|, from the largest difference between neighbouring samples along
    /// each axis. The bound holds because d is interpolated linearly between samples.
    pub fn max_slope(&self) -> f64 {
        match self {
            Self::Constant(_) => 0.0,
            Self::Field(field) => norm(max_slopes(field)),
            Self::Bricks(bricks) => bricks.summary.max_slope,
        }
    }

    /// Checks that a lattice of spacing d can fill the box `[0, extent]`.
    ///
    /// # Errors
    /// Returns [`Error::Distance`] if d is not a positive number, if it is larger than the box, if
    /// a side of the box is shorter than two d, if a field does not span the box, or if d needs
    /// more atoms than can be numbered.
    pub fn validate(&self, extent: [f64; D]) -> Result<()> {
        let fail = |problem: String, remedy: String| {
            Err(Error::Distance(cause("distance", problem, remedy)))
        };
        if let Self::Field(field) = self {
            let spans = (0..D).all(|k| (field.extent()[k] - extent[k]).abs() <= 1e-6 * extent[k]);
            let count: usize = field.dims.iter().product();
            if !spans || field.samples.len() != count {
                return fail(
                    format!(
                        "the given distances span {:?} samples, but the image spans {extent:?}",
                        field.extent()
                    ),
                    "give distances that cover the whole image".into(),
                );
            }
        }
        let (min, max) = (self.min(), self.max());
        if !min.is_finite() || !max.is_finite() {
            return fail(
                "it is not a finite number everywhere".into(),
                "give a distance without NaN and infinities".into(),
            );
        }
        if min <= 0.0 {
            return fail(
                format!("{min} is not positive"),
                "give a distance of a few samples, for example 8".into(),
            );
        }
        let longest = extent.iter().copied().fold(0.0, f64::max);
        let shortest = extent.iter().copied().fold(f64::INFINITY, f64::min);
        if shortest == 0.0 {
            return fail(
                "the image is a single sample thick along an axis, so that no cell fits into it"
                    .into(),
                "give a volume, or a 2-D image; reshape an array that was saved flat".into(),
            );
        }
        let remedy = format!("give a distance of at most {}", shortest / 2.0);
        if max > longest {
            return fail(
                format!("{max} is more than the image's longest side, {longest}"),
                remedy,
            );
        }
        if shortest < 2.0 * max {
            return fail(
                format!("{max} is more than half the image's shortest side, {shortest}"),
                remedy,
            );
        }
        let atoms = self.estimate_atom_count(extent);
        if atoms > MAX_ATOMS {
            return fail(
                format!(
                    "it asks for about {atoms:.0e} atoms in the image's {extent:?} samples, more than can be numbered"
                ),
                "give a larger distance, of a few samples".into(),
            );
        }
        Ok(())
    }

    /// Estimates the count of atoms of spacing d in the box `[0, extent]`, with those on its sides:
    /// the densest lattice has sqrt(2) / d^3 atoms per volume in space, and 2 / (sqrt(3) d^2) per
    /// area in the plane.
    pub fn estimate_atom_count(&self, extent: [f64; D]) -> f64 {
        let per_volume = match self {
            Self::Constant(d) => d.powi(-(D as i32)),
            Self::Field(field) => {
                let layer = field.dims[..D - 1].iter().product::<usize>().max(1);
                let sums = field.samples.par_chunks(layer).map(density_sum::<D>);
                let sums: Vec<f64> = sums.collect();
                sums.into_iter().sum::<f64>() / field.samples.len() as f64
            }
            Self::Bricks(bricks) => bricks.summary.mean_density,
        };
        let volume: f64 = extent.iter().product();
        let densest = if D == 2 { 2.0 / 3f64.sqrt() } else { SQRT_2 };
        let d = per_volume.powf(-1.0 / D as f64);
        let with_sides: f64 = extent.iter().map(|e| 1.0 + d / e).product();
        densest * volume * per_volume * with_sides
    }
}

/// Returns the largest slope between neighbouring samples along each axis.
fn max_slopes<const D: usize>(field: &ScalarField<D>) -> [f64; D] {
    let strides = strides(field.dims);
    std::array::from_fn(|k| {
        let stride = strides[k];
        let next = field.samples.get(stride..).unwrap_or_default();
        let pairs = field.samples.par_iter().zip(next);
        let steepest = pairs
            .enumerate()
            .filter(|(n, _)| n / stride % field.dims[k] + 1 < field.dims[k])
            .map(|(_, (a, b))| (b - a).abs())
            .reduce(|| 0.0, f32::max);
        f64::from(steepest) / field.step[k]
    })
}

/// Returns the sum of d^-D over the samples of a layer.
fn density_sum<const D: usize>(layer: &[f32]) -> f64 {
    layer.iter().map(|&d| f64::from(d).powi(-(D as i32))).sum()
}

/// Most atoms of a lattice. Atoms have indices of 32 bits, and so have cells, of which there are up
/// to seven times as many.
const MAX_ATOMS: f64 = 6e8;

/// Folds samples with `f`; the result is NaN if any sample is NaN.
fn reduce(samples: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) -> f64 {
    const LANES: usize = 16;
    let chunks = samples.par_chunks(1 << 16).map(|chunk| {
        let (mut extremes, mut has_nan) = ([chunk[0]; LANES], false);
        for block in chunk.chunks(LANES) {
            for (extreme, &sample) in extremes.iter_mut().zip(block) {
                *extreme = f(*extreme, sample);
                has_nan |= sample.is_nan();
            }
        }
        if has_nan {
            f32::NAN
        } else {
            extremes.into_iter().fold(chunk[0], &f)
        }
    });
    let combine = |a: f32, b: f32| {
        if a.is_nan() || b.is_nan() {
            f32::NAN
        } else {
            f(a, b)
        }
    };
    f64::from(
        chunks
            .collect::<Vec<f32>>()
            .into_iter()
            .reduce(combine)
            .unwrap_or(f32::NAN),
    )
}

/// The grid cell around a position: the samples of the grid, the index of the cell's lowest corner,
/// the strides along each axis, and the position inside the cell.
struct GridCell<'a, const D: usize> {
    samples: &'a [f32],
    corner: usize,
    strides: [usize; D],
    position: CellPosition<D>,
}

/// A position inside a cell of a grid.
struct CellPosition<const D: usize> {
    /// Indices of the cell's lowest corner.
    low: [usize; D],
    /// Offset from that corner along each axis, in cells.
    fraction: [f64; D],
    /// d(fraction)/d(position): zero where the position was clamped to the box.
    slope: [f64; D],
}

impl<const D: usize> CellPosition<D> {
    #[inline]
    fn locate(dims: &[usize; D], step: &[f64; D], position: &[f64; D]) -> Self {
        let mut cell = Self {
            low: [0; D],
            fraction: [0.0; D],
            slope: [0.0; D],
        };
        for k in 0..D {
            let last = dims[k].saturating_sub(1);
            if last > 0 {
                let u = position[k] / step[k];
                let clamped = u.clamp(0.0, last as f64);
                let low = (clamped as usize).min(last - 1);
                cell.low[k] = low;
                cell.fraction[k] = clamped - low as f64;
                cell.slope[k] = if u == clamped { 1.0 / step[k] } else { 0.0 };
            }
        }
        cell
    }
}

impl<'a, const D: usize> GridCell<'a, D> {
    #[inline]
    fn new(field: &'a ScalarField<D>, position: &[f64; D]) -> Self {
        let position = CellPosition::locate(&field.dims, &field.step, position);
        let (mut corner, mut strides, mut stride) = (0, [0; D], 1);
        for k in 0..D {
            corner += position.low[k] * stride;
            // Along an axis of one sample there is no other corner.
            strides[k] = if field.dims[k] > 1 { stride } else { 0 };
            stride *= field.dims[k];
        }
        Self {
            samples: &field.samples,
            corner,
            strides,
            position,
        }
    }

    #[inline]
    fn value(&self) -> f64 {
        (0..1usize << D)
            .map(|c| self.weight(c, D) * self.sample(c))
            .sum()
    }

    #[inline]
    fn value_and_gradient(&self) -> (f64, [f64; D]) {
        let (mut value, mut gradient) = (0.0, [0.0; D]);
        for c in 0..1usize << D {
            let sample = self.sample(c);
            value += self.weight(c, D) * sample;
            for k in 0..D {
                let sign = if c >> k & 1 == 1 { 1.0 } else { -1.0 };
                gradient[k] += sign * self.position.slope[k] * self.weight(c, k) * sample;
            }
        }
        (value, gradient)
    }

    /// Returns the product of the linear weights of corner `c` over all axes except `without`.
    #[inline]
    fn weight(&self, c: usize, without: usize) -> f64 {
        (0..D)
            .filter(|&k| k != without)
            .map(|k| {
                if c >> k & 1 == 1 {
                    self.position.fraction[k]
                } else {
                    1.0 - self.position.fraction[k]
                }
            })
            .product()
    }

    #[inline]
    fn sample(&self, c: usize) -> f64 {
        let offset: usize = (0..D).map(|k| (c >> k & 1) * self.strides[k]).sum();
        f64::from(self.samples[self.corner + offset])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy() -> ScalarField<3> {
        let dims = [5, 4, 6];
        let samples = (0..120)
            .map(|i| 5.0 + ((i * 37 % 17) as f32) * 0.1)
            .collect();
        ScalarField {
            dims,
            step: [2.0, 1.5, 1.0],
            samples,
        }
    }

    #[test]
    fn interpolation_reproduces_samples_and_stays_between_them() {
        let field = wavy();
        let d = Distance::Field(field.clone());
        for z in 0..6 {
            for y in 0..4 {
                for x in 0..5 {
                    let p = [x as f64 * 2.0, y as f64 * 1.5, z as f64];
                    let truth = f64::from(field.samples[(z * 4 + y) * 5 + x]);
                    assert!((d.value_at(p) - truth).abs() < 1e-12);
                }
            }
        }
        let outside = d.value_at([-3.0, 100.0, 2.3]);
        assert!((outside - d.value_at([0.0, 4.5, 2.3])).abs() < 1e-12);
        assert!(outside >= d.min() && outside <= d.max());
    }

    #[test]
    fn gradient_is_the_derivative_of_the_value() {
        let d = Distance::Field(wavy());
        for i in 0..50 {
            let r = |m: usize| ((i * m % 101) as f64 + 0.37) / 102.0;
            let p = [8.0 * r(17), 4.5 * r(29), 5.0 * r(43)];
            let (value, gradient) = d.value_and_gradient_at(p);
            assert!((value - d.value_at(p)).abs() < 1e-12);
            for k in 0..3 {
                let h = 1e-6;
                let (mut a, mut b) = (p, p);
                a[k] -= h;
                b[k] += h;
                let numeric = (d.value_at(b) - d.value_at(a)) / (2.0 * h);
                assert!(
                    (numeric - gradient[k]).abs() < 1e-6,
                    "{numeric} {}",
                    gradient[k]
                );
            }
        }
    }

    #[test]
    fn impossible_distances_are_refused_with_a_remedy() {
        let extent = [63.0, 63.0, 20.0];
        let accepts = |d: f64| Distance::<3>::Constant(d).validate(extent);
        assert!(accepts(8.0).is_ok() && accepts(10.0).is_ok());
        for (d, word) in [
            (0.0, "positive"),
            (-1.0, "positive"),
            (f64::NAN, "finite"),
            (f64::INFINITY, "finite"),
            (80.0, "more than the image's longest side"),
            (10.1, "more than half the image's shortest side"),
            (0.001, "about 1e14 atoms"),
        ] {
            let message = accepts(d).unwrap_err().to_string();
            assert!(
                message.contains(word) && message.contains("; give a"),
                "{message}"
            );
        }
        let mut field = wavy();
        let field_extent = field.extent();
        assert!(
            Distance::Field(field.clone())
                .validate([8.0, 4.5, 7.0])
                .is_err()
        );
        field.samples[7] = f32::NAN;
        assert!(Distance::Field(field).validate(field_extent).is_err());
    }
}
