//! Values of samples, and the thresholds that divide them into regions.
//!
//! Between samples, the value is the multilinear interpolation less a correction along each axis, which makes
//! it the cubic polynomial through the four samples around a position on a line of samples. Multilinear
//! interpolation alone acts as a Gaussian of variance 1/6: it would move the surface of a ball of radius r
//! towards its centre by 1/(6 r) samples.
//!
//! Where all samples around a position are in the same region, so is the position: no region arises where no
//! sample has it.

use crate::geometry::grid_index::{index_at, strides};
use crate::parallel::prelude::*;

/// Number of lines along each axis across the steepest one, along which a cell between samples is measured.
const LINES_PER_AXIS: usize = 4;
/// Number of parts of each line in which the value is taken as linear.
const PARTS_PER_LINE: usize = 4;

/// Values of samples and thresholds in ascending order. Region n has the values from threshold n - 1 up to
/// threshold n.
#[derive(Debug, Clone, PartialEq)]
pub struct ValueField<const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// Values of the samples, in units of the image.
    pub samples: Vec<f32>,
    /// Thresholds, in ascending order.
    pub levels: Vec<f32>,
}

/// Returns the region of a value: the number of thresholds that it reaches.
pub fn region_of(levels: &[f32], value: f32) -> u32 {
    levels.partition_point(|level| *level <= value) as u32
}

/// The cell between samples that contains a position.
struct SampleCell<const D: usize> {
    /// Index of its first sample.
    first: usize,
    /// Coordinates of its first sample.
    low: [usize; D],
    /// Distance in memory to the next sample along each axis; 0 along an axis of one sample.
    strides: [usize; D],
    /// Position within the cell, from 0 to 1.
    fraction: [f64; D],
}

impl<const D: usize> SampleCell<D> {
    /// Returns the distance in memory from the first sample to a corner: bit k for the upper side along axis k.
    fn offset(&self, corner: usize) -> usize {
        (0..D).map(|k| (corner >> k & 1) * self.strides[k]).sum()
    }

    /// Returns the multilinear weight of a corner, without the factor of axis `skipped`.
    fn weight(&self, corner: usize, skipped: usize) -> f64 {
        let factor = |k: usize| match corner >> k & 1 {
            _ if k == skipped => 1.0,
            0 => 1.0 - self.fraction[k],
            _ => self.fraction[k],
        };
        (0..D).map(factor).product()
    }
}

impl<const D: usize> ValueField<D> {
    /// Returns the cell that contains a position in samples.
    fn cell(&self, u: [f64; D]) -> SampleCell<D> {
        let all_strides = strides(self.dims);
        let mut cell = SampleCell {
            first: 0,
            low: [0; D],
            strides: [0; D],
            fraction: [0.0; D],
        };
        for k in 0..D {
            let last = self.dims[k] - 1;
            if last > 0 {
                let position = u[k].clamp(0.0, last as f64);
                cell.low[k] = (position as usize).min(last - 1);
                cell.fraction[k] = position - cell.low[k] as f64;
                cell.strides[k] = all_strides[k];
            }
            cell.first += cell.low[k] * all_strides[k];
        }
        cell
    }

    /// Returns the lowest and the highest region of the samples around a cell.
    fn region_range(&self, cell: &SampleCell<D>) -> [u32; 2] {
        let value = |corner: usize| self.samples[cell.first + cell.offset(corner)];
        let range = (0..1usize << D)
            .map(value)
            .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], value| {
                [low.min(value), high.max(value)]
            });
        range.map(|value| region_of(&self.levels, value))
    }

    /// Returns the multilinear interpolation in a cell.
    fn linear_value(&self, cell: &SampleCell<D>) -> f64 {
        let term = |corner: usize| {
            cell.weight(corner, D) * f64::from(self.samples[cell.first + cell.offset(corner)])
        };
        (0..1usize << D).map(term).sum()
    }

    /// Returns the difference of multilinear from cubic interpolation in a cell.
    fn correction(&self, cell: &SampleCell<D>) -> f64 {
        let mut sum = 0.0;
        for k in 0..D {
            let f = cell.fraction[k];
            if f <= 0.0 || f >= 1.0 {
                continue;
            }
            let stride = cell.strides[k];
            for corner in (0..1usize << D).filter(|corner| corner >> k & 1 == 0) {
                let weight = cell.weight(corner, k);
                if weight == 0.0 {
                    continue;
                }
                let i = cell.first + cell.offset(corner);
                let sample = |i: usize| f64::from(self.samples[i]);
                let second = |i: usize| sample(i - stride) + sample(i + stride) - 2.0 * sample(i);
                let before = (cell.low[k] > 0).then(|| second(i));
                let after = (cell.low[k] + 2 < self.dims[k]).then(|| second(i + stride));
                // On a side the second derivative continues as it is at the next sample.
                let before_value = before.or(after).unwrap_or(0.0);
                let after_value = after.or(before).unwrap_or(0.0);
                let cubic = (2.0 - f) * before_value + (1.0 + f) * after_value;
                sum += weight * f * (1.0 - f) / 6.0 * cubic;
            }
        }
        sum
    }

    /// Returns the value at a position in samples, limited to the regions of the samples around it.
    pub fn value_at(&self, u: [f64; D]) -> f64 {
        let cell = self.cell(u);
        let [low, high] = self.region_range(&cell);
        let value = self.linear_value(&cell);
        if low == high {
            return value;
        }
        value - self.correction(&cell)
    }

    /// Returns the region at a position in samples.
    pub fn region_at(&self, u: [f64; D]) -> u32 {
        let cell = self.cell(u);
        let [low, high] = self.region_range(&cell);
        if low == high {
            return low;
        }
        let value = self.linear_value(&cell) - self.correction(&cell);
        region_of(&self.levels, value as f32).clamp(low, high)
    }

    /// Returns the lead of region `a` over region `b` at a position in samples, in units of the image: negative
    /// where `b` leads. Between regions that are no neighbours, their interface has the mean of the outermost
    /// thresholds between them.
    pub fn lead_between(&self, u: [f64; D], [a, b]: [u32; 2]) -> f64 {
        let [lower, upper] = [a.min(b) as usize, a.max(b) as usize];
        let level = |n: usize| f64::from(self.levels[n]);
        let middle = 0.5 * (level(lower) + level(upper - 1));
        let lead = self.value_at(u) - middle;
        if a > b { lead } else { -lead }
    }

    /// Returns the volume of each region, in samples. Half of a sample on a side of the image lies inside.
    pub fn volumes(&self) -> Vec<f64> {
        let layer_count = self.dims[D - 1].saturating_sub(1).max(1);
        let in_layers: Vec<Vec<f64>> = (0..layer_count)
            .into_par_iter()
            .map(|layer| self.volumes_in_layer(layer))
            .collect();
        let mut volumes = vec![0.0; self.levels.len() + 1];
        for in_layer in in_layers {
            (volumes.iter_mut().zip(in_layer)).for_each(|(sum, volume)| *sum += volume);
        }
        volumes
    }

    /// Returns the volume of each region between a layer of samples and the next one.
    fn volumes_in_layer(&self, layer: usize) -> Vec<f64> {
        let mut volumes = vec![0.0; self.levels.len() + 1];
        let mut cell_dims = self.dims.map(|n| n.saturating_sub(1).max(1));
        cell_dims[D - 1] = 1;
        for number in 0..cell_dims.iter().product() {
            let mut low: [usize; D] = index_at(cell_dims, number);
            low[D - 1] = layer;
            let cell = self.cell(low.map(|i| i as f64));
            let [lowest, highest] = self.region_range(&cell);
            volumes[lowest as usize] += 1.0;
            if lowest == highest {
                continue;
            }
            let levels = &self.levels[lowest as usize..highest as usize];
            for (n, share) in (lowest as usize..).zip(self.shares_above(low, &cell, levels)) {
                volumes[n] -= share;
                volumes[n + 1] += share;
            }
        }
        volumes
    }

    /// Returns the share of a cell in which the value reaches each of the `levels`.
    fn shares_above(&self, low: [usize; D], cell: &SampleCell<D>, levels: &[f32]) -> Vec<f64> {
        let slope = |k: usize| {
            let sign = |corner: usize| if corner >> k & 1 == 1 { 1.0 } else { -1.0 };
            let term = |corner: usize| {
                sign(corner) * f64::from(self.samples[cell.first + cell.offset(corner)])
            };
            (0..1usize << D).map(term).sum::<f64>().abs()
        };
        let steepest = (1..D).fold(0, |best, k| if slope(k) > slope(best) { k } else { best });
        let line_count = LINES_PER_AXIS.pow(D as u32 - 1);
        let mut sums = vec![0.0; levels.len()];
        for line in 0..line_count {
            let mut rest = line;
            let mut u = low.map(|i| i as f64);
            for k in (0..D).filter(|k| *k != steepest) {
                let index = rest % LINES_PER_AXIS;
                rest /= LINES_PER_AXIS;
                if self.dims[k] > 1 {
                    u[k] += (index as f64 + 0.5) / LINES_PER_AXIS as f64;
                }
            }
            let value = |part: usize| {
                let mut u = u;
                // The end of a line lies in the same cell, not in the next one.
                u[steepest] += (part as f64 / PARTS_PER_LINE as f64).min(1.0 - 1e-9);
                self.value_at(u)
            };
            let values: [f64; PARTS_PER_LINE + 1] = std::array::from_fn(value);
            for (sum, level) in sums.iter_mut().zip(levels) {
                let level = f64::from(*level);
                let share = |ends: &[f64]| share_reaching(level, [ends[0], ends[1]]);
                *sum += values.windows(2).map(share).sum::<f64>();
            }
        }
        let total = (line_count * PARTS_PER_LINE) as f64;
        sums.iter().map(|sum| sum / total).collect()
    }
}

/// Returns the share of a line on which a value that changes linearly from end to end reaches `level`.
fn share_reaching(level: f64, [a, b]: [f64; 2]) -> f64 {
    match (a >= level, b >= level) {
        (true, true) => 1.0,
        (false, false) => 0.0,
        (is_high_first, _) => {
            let crossing = (level - a) / (b - a);
            if is_high_first {
                crossing
            } else {
                1.0 - crossing
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::volume::Volume;
    use crate::geometry::{norm, sub};

    fn field<const D: usize>(
        dims: [usize; D],
        levels: &[f32],
        value: impl Fn([f64; D]) -> f64,
    ) -> ValueField<D> {
        let volume = Volume::new(dims, &[]);
        let at = |i: usize| volume.coordinates(i).map(|c| c as f64);
        ValueField {
            dims,
            samples: (0..dims.iter().product())
                .map(|i| value(at(i)) as f32)
                .collect(),
            levels: levels.to_vec(),
        }
    }

    /// Returns the largest distance, in samples, by which balls (discs in 2-D) of soft edges are too large or too
    /// small for their volumes, at several centres off the grid.
    fn worst_ball_error<const D: usize>(radius: f64, width: f64, level: f64) -> f64 {
        let measure = match D {
            2 => std::f64::consts::PI * radius.powi(2),
            _ => 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3),
        };
        let side = (2.0 * radius + 12.0 * width) as usize + 4;
        let shifts = [[0.0; 3], [0.5, 0.5, 0.5], [0.31, 0.77, 0.12]];
        let error = |shift: [f64; 3]| {
            let centre: [f64; D] = std::array::from_fn(|k| (side / 2) as f64 + shift[k]);
            let offset = width * (level / 500.0 - 1.0).atanh();
            let image = field([side; D], &[level as f32], |p| {
                let depth = radius - norm(sub(p, centre));
                500.0 * (1.0 + ((depth + offset) / width).tanh())
            });
            let ratio = image.volumes()[1] / measure;
            radius * (ratio.powf(1.0 / D as f64) - 1.0).abs()
        };
        shifts.into_iter().map(error).fold(0.0, f64::max)
    }

    #[test]
    fn balls_and_discs_have_their_radius_within_a_twentieth_of_a_sample() {
        // Away from the middle of a steep edge, a cubic polynomial does not follow it exactly.
        for (level, width, bound) in [
            (500.0, 1.0, 0.02),
            (500.0, 1.6, 0.01),
            (500.0, 3.0, 0.01),
            (300.0, 1.0, 0.05),
            (300.0, 1.6, 0.02),
            (300.0, 3.0, 0.01),
        ] {
            for radius in [5.0, 10.0, 12.3] {
                let errors = [
                    worst_ball_error::<2>(radius, width, level),
                    worst_ball_error::<3>(radius, width, level),
                ];
                let is_exact = errors.iter().all(|error| *error < bound);
                assert!(is_exact, "{radius} {width} {level}: {errors:?}");
            }
        }
    }

    #[test]
    fn planes_at_any_place_have_exact_volumes() {
        for tenth in 0..10 {
            let offset = 4.0 + 0.1 * f64::from(tenth);
            for axis in 0..3 {
                let image = field([10, 9, 11], &[5.0, 7.5], |p| 5.0 + p[axis] - offset);
                let section = [80.0, 90.0, 72.0][axis];
                let length = [9.0, 8.0, 10.0][axis];
                let bounds = [0.0, offset, (offset + 2.5).min(length), length];
                let expected = [0, 1, 2].map(|n| (bounds[n + 1] - bounds[n]) * section);
                for (volume, expected) in image.volumes().iter().zip(expected) {
                    let error = (volume - expected).abs();
                    assert!(
                        error < 1e-3 * section,
                        "{offset} {axis}: {volume} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_torus_and_a_cylinder_through_the_sides_have_their_volumes() {
        let torus = field([48, 46, 24], &[0.0], |p| {
            let from_axis = (p[0] - 23.3).hypot(p[1] - 22.6) - 13.2;
            4.1 - from_axis.hypot(p[2] - 11.4)
        });
        let exact = 2.0 * std::f64::consts::PI.powi(2) * 13.2 * 4.1 * 4.1;
        let error = torus.volumes()[1] / exact - 1.0;
        assert!(error.abs() < 0.001, "torus: {error}");
        // The half of a cylinder that lies inside of the image, from side to side.
        let cylinder = field([30, 18, 25], &[0.0], |p| 9.7 - (p[0] - 14.6).hypot(p[1]));
        let exact = 0.5 * std::f64::consts::PI * 9.7 * 9.7 * 24.0;
        let error = cylinder.volumes()[1] / exact - 1.0;
        assert!(error.abs() < 0.001, "cylinder: {error}");
    }

    #[test]
    fn a_thin_shell_between_two_thresholds_has_its_volume() {
        // No sample lies between the thresholds in places: the shell is a third of a sample thick.
        let image = field([40; 3], &[0.0, 0.33], |p| {
            norm(sub(p, [19.7, 20.2, 19.4])) - 12.0
        });
        let ball = |r: f64| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
        let exact = ball(12.33) - ball(12.0);
        let error = image.volumes()[1] / exact - 1.0;
        assert!(error.abs() < 0.01, "{error}");
    }

    #[test]
    fn interpolation_is_exact_for_cubic_values_along_an_axis() {
        let cubic = |x: f64| 0.02 * x * x * x - 0.3 * x * x + x;
        let image = field([12, 3], &[0.4], |p| cubic(p[0]));
        for step in 10..100 {
            let x = 0.1 * f64::from(step);
            let cell = image.cell([x, 1.0]);
            let value = image.linear_value(&cell) - image.correction(&cell);
            assert!((value - cubic(x)).abs() < 1e-5, "{x}: {value} {}", cubic(x));
        }
    }
}
