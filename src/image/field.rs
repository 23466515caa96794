//! A sampled scalar function of position in *lattice space*, and its smooth interpolation.
//!
//! Lattice space is the sample index times a step per axis (`step`, 1 by default). The field fills
//! the box `[0, (dims[k] - 1) * step[k]]`.
//!
//! Interpolation is cubic convolution (Keys 1981, a = -1/2; the Catmull-Rom spline) as a tensor
//! product over the axes. It passes through the samples, has a continuous gradient, and reproduces
//! quadratic functions away from the sides. Beyond the sides of the box the outermost sample
//! repeats, and positions outside are moved to the nearest point of the box. The gradient is the
//! exact derivative of the interpolant, so that a minimiser sees a consistent function and slope.

use super::{Geometry, Image};
use crate::geometry::grid_index::{index_at, strides};

/// Samples of a scalar function over a box in lattice space, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarField<const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Lattice-space distance between samples along each axis.
    pub step: [f64; D],
    /// Samples, x fastest.
    pub samples: Vec<f32>,
}

impl<const D: usize> ScalarField<D> {
    /// Converts a field with a value for each sample to an image with this geometry.
    pub fn into_image(self, geometry: &Geometry<D>) -> Image<D> {
        Image::new(self.dims, self.samples, geometry.clone())
    }
}

/// The four samples (taps) about a coordinate along one axis, and their weights.
#[derive(Clone, Copy)]
pub(super) struct Taps {
    /// Index of the sample at or before the coordinate.
    pub cell: usize,
    /// Offsets of the four taps in the sample array.
    pub offsets: [usize; 4],
    /// Weights of the value.
    value_weights: [f32; 4],
    /// Weights of the derivative along this axis.
    slope_weights: [f32; 4],
}

impl Taps {
    /// Computes the taps at `x` along an axis of `n` samples that are `step` apart in lattice space
    /// and `stride` apart in memory.
    #[inline]
    pub fn new(x: f64, n: usize, step: f64, stride: usize) -> Self {
        let last = n.max(1) - 1;
        let index = x / step;
        let inside = index >= 0.0 && index <= last as f64;
        let index = index.clamp(0.0, last as f64);
        let cell = (index as usize).min(last.saturating_sub(1));
        let t = (index - cell as f64) as f32;
        let offsets = std::array::from_fn(|k| (cell + k).saturating_sub(1).min(last) * stride);
        // Catmull-Rom basis and its derivative.
        let value_weights = [
            t * (-0.5 + t * (1.0 - 0.5 * t)),
            1.0 + t * t * (-2.5 + 1.5 * t),
            t * (0.5 + t * (2.0 - 1.5 * t)),
            t * t * (-0.5 + 0.5 * t),
        ];
        let scale = if inside { (1.0 / step) as f32 } else { 0.0 };
        let slope_weights = [
            (-0.5 + t * (2.0 - 1.5 * t)) * scale,
            t * (-5.0 + 4.5 * t) * scale,
            (0.5 + t * (4.0 - 4.5 * t)) * scale,
            t * (-1.0 + 1.5 * t) * scale,
        ];
        Self {
            cell,
            offsets,
            value_weights,
            slope_weights,
        }
    }
}

impl<const D: usize> ScalarField<D> {
    /// Creates a field by sampling a function of position in lattice space.
    pub fn from_fn(dims: [usize; D], step: [f64; D], mut f: impl FnMut([f64; D]) -> f64) -> Self {
        let sample = |offset: usize| {
            let index = index_at(dims, offset);
            f(std::array::from_fn(|k| index[k] as f64 * step[k])) as f32
        };
        let samples = (0..dims.iter().product()).map(sample).collect();
        Self {
            dims,
            step,
            samples,
        }
    }

    /// Returns the field with `f` applied to each sample.
    pub fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        let mapped = self.samples.iter().map(|&s| f(s.into()) as f32);
        Self {
            samples: mapped.collect(),
            ..*self
        }
    }

    /// Returns the far corner of the box; the near corner is the origin.
    pub fn extent(&self) -> [f64; D] {
        box_extent(self.dims, self.step)
    }

    /// Returns the interpolated value at a position in lattice space.
    pub fn value(&self, position: [f64; D]) -> f64 {
        self.value_and_gradient(position).0
    }

    /// Returns the interpolated value and its exact gradient at a position in lattice space. Along
    /// an axis on which the position lies outside the box the gradient is zero.
    ///
    /// Arithmetic is in `f32`, as the samples are: the absolute error is about 1e-7 of the spread
    /// of the taps.
    #[inline]
    pub fn value_and_gradient(&self, position: [f64; D]) -> (f64, [f64; D]) {
        let strides = strides(self.dims);
        let taps: [Taps; D] =
            std::array::from_fn(|k| Taps::new(position[k], self.dims[k], self.step[k], strides[k]));
        // The weights of the value sum to one and those of the slopes to zero. Therefore
        // differences from one of the taps can be summed instead, which loses fewer digits.
        let base = self.samples[taps.iter().map(|t| t.offsets[1]).sum::<usize>()];
        let contiguous = taps[0].cell >= 1 && taps[0].cell + 2 < self.dims[0];
        let line = |start: usize| -> [f32; 4] {
            let line = if contiguous {
                let first = start + taps[0].cell - 1;
                let line = &self.samples[first..first + 4];
                [line[0], line[1], line[2], line[3]]
            } else {
                taps[0].offsets.map(|x| self.samples[start + x])
            };
            line.map(|sample| sample - base)
        };
        interpolate(&taps, base, line)
    }
}

/// Returns the far corner of the box of a field in lattice space; the near corner is the origin.
pub(super) fn box_extent<const D: usize>(dims: [usize; D], step: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| (dims[k].max(1) - 1) as f64 * step[k])
}

/// Returns the value and gradient from the taps along each axis. `line` returns the four samples
/// along x, minus `base`, of the row at a given offset, which is the sum of the offsets of the taps
/// of the other axes.
#[inline(always)]
pub(super) fn interpolate<const D: usize>(
    taps: &[Taps; D],
    base: f32,
    line: impl Fn(usize) -> [f32; 4],
) -> (f64, [f64; D]) {
    // Sums over all axes but x, one lane per tap along x: `sums[0]` for the value, `sums[k]` for
    // the slope along axis k.
    let mut sums = [[0.0f32; 4]; D];
    // Number of tap combinations along the axes beyond y. The sums over them come first, so that
    // each sample is weighted only once or twice.
    let planes = if D > 2 { 4usize.pow(D as u32 - 2) } else { 1 };
    for tap in 0..if D > 1 { 4 } else { 1 } {
        let start = if D > 1 { taps[1].offsets[tap] } else { 0 };
        let mut inner = [[0.0f32; 4]; D];
        for plane in 0..planes {
            let tap = |k: usize| (plane >> (2 * (k - 2))) & 3;
            let line = line(start + (2..D).map(|k| taps[k].offsets[tap(k)]).sum::<usize>());
            for axis in (0..D).filter(|&axis| axis != 1) {
                let weight = |k: usize| {
                    if k == axis {
                        taps[k].slope_weights[tap(k)]
                    } else {
                        taps[k].value_weights[tap(k)]
                    }
                };
                let weight: f32 = (2..D).map(weight).product();
                for lane in 0..4 {
                    inner[axis][lane] += weight * line[lane];
                }
            }
        }
        let (value, slope) = match D {
            1 => (1.0, 0.0),
            _ => (taps[1].value_weights[tap], taps[1].slope_weights[tap]),
        };
        for axis in 0..D {
            let (weight, inner) = match axis {
                1 => (slope, &inner[0]),
                _ => (value, &inner[axis]),
            };
            for lane in 0..4 {
                sums[axis][lane] += weight * inner[lane];
            }
        }
    }
    let dot = |a: &[f32; 4], b: &[f32; 4]| -> f64 {
        (f64::from(a[0] * b[0]) + f64::from(a[1] * b[1]))
            + (f64::from(a[2] * b[2]) + f64::from(a[3] * b[3]))
    };
    let gradient = std::array::from_fn(|axis| {
        if axis == 0 {
            dot(&sums[0], &taps[0].slope_weights)
        } else {
            dot(&sums[axis], &taps[0].value_weights)
        }
    });
    (
        f64::from(base) + dot(&sums[0], &taps[0].value_weights),
        gradient,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quadratic(x: [f64; 3]) -> f64 {
        1.0 + 0.3 * x[0] - 0.2 * x[1] + 0.1 * x[2] + 0.05 * x[0] * x[1] - 0.02 * x[2] * x[2]
            + 0.03 * x[0] * x[0]
    }

    #[test]
    fn passes_through_the_samples_and_repeats_them_outside() {
        let field = ScalarField::from_fn([7, 6, 5], [1.0, 0.5, 2.0], |x| {
            (x[0] * 1.3 + x[1] - x[2]).sin()
        });
        for z in 0..5 {
            for y in 0..6 {
                for x in 0..7 {
                    let at = [x as f64, 0.5 * y as f64, 2.0 * z as f64];
                    let sample = f64::from(field.samples[x + 7 * (y + 6 * z)]);
                    assert!((field.value(at) - sample).abs() < 1e-6);
                }
            }
        }
        let (value, gradient) = field.value_and_gradient([-3.0, 1.2, 99.0]);
        assert!((value - field.value([0.0, 1.2, 8.0])).abs() < 1e-7);
        assert_eq!([gradient[0], gradient[2]], [0.0, 0.0]);
        assert!(gradient[1].abs() > 1e-3);
    }

    #[test]
    fn reproduces_quadratics_away_from_the_sides() {
        let field = ScalarField::from_fn([12, 11, 10], [1.0, 2.0, 0.5], quadratic);
        for n in 0..200 {
            let t = |k: u32| f64::from((n * 7919 + k * 104_729) % 1000) / 1000.0;
            let x = [1.0 + 9.0 * t(1), 2.0 + 16.0 * t(2), 0.5 + 3.5 * t(3)];
            let (value, gradient) = field.value_and_gradient(x);
            assert!((value - quadratic(x)).abs() < 2e-5, "{x:?}");
            let truth = [
                0.3 + 0.05 * x[1] + 0.06 * x[0],
                -0.2 + 0.05 * x[0],
                0.1 - 0.04 * x[2],
            ];
            for k in 0..3 {
                assert!((gradient[k] - truth[k]).abs() < 5e-5, "{x:?} axis {k}");
            }
        }
    }

    /// The interpolant is a piecewise polynomial, so a central difference of it within one cell
    /// gives its slope up to the rounding of f32.
    #[test]
    fn gradient_is_the_derivative_of_the_interpolant() {
        let mut seed = 1u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8) / f64::from(1 << 24)
        };
        let field = ScalarField::from_fn([6, 7, 8], [1.0, 1.5, 0.75], |_| 0.0);
        let samples = field
            .samples
            .iter()
            .map(|_| random() as f32 - 0.5)
            .collect();
        let field = ScalarField { samples, ..field };
        let extent = field.extent();
        for _ in 0..300 {
            let x: [f64; 3] = std::array::from_fn(|k| random() * extent[k]);
            let (_, gradient) = field.value_and_gradient(x);
            for k in 0..3 {
                // Five-point difference: exact for the cubic inside one cell.
                let h = 0.02 * field.step[k];
                let at = |shift: f64| {
                    let mut y = x;
                    y[k] += shift * h;
                    field.value(y)
                };
                let cell = |shift: f64| ((x[k] + shift * h) / field.step[k]).floor();
                if cell(-2.0) != cell(2.0) || x[k] - 2.0 * h < 0.0 || x[k] + 2.0 * h > extent[k] {
                    continue;
                }
                let slope = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h);
                assert!(
                    (slope - gradient[k]).abs() < 3e-5,
                    "{slope} {}",
                    gradient[k]
                );
            }
        }
    }

    #[test]
    fn works_in_two_dimensions_and_on_single_samples() {
        let field = ScalarField::from_fn([9, 9], [1.0, 1.0], |x| x[0] * x[1]);
        let (value, gradient) = field.value_and_gradient([3.25, 4.5]);
        assert!((value - 3.25 * 4.5).abs() < 1e-5);
        assert!((gradient[0] - 4.5).abs() < 1e-5 && (gradient[1] - 3.25).abs() < 1e-5);
        let single = ScalarField {
            dims: [1, 1],
            step: [1.0, 1.0],
            samples: vec![5.0],
        };
        assert_eq!(single.value_and_gradient([0.3, -2.0]), (5.0, [0.0, 0.0]));
    }
}
