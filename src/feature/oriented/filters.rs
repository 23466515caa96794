//! Filters that are long along a surface and narrow across it, at all angles about a line.

use super::block::{BLOCK_SIZE, BlockMask, BlockScratch, block_sample};
use super::row_ranges::RowRanges;
use super::stencil::{
    ACCUMULATOR_COUNT, LANES, SHORT_ROW_ACCUMULATOR_COUNT, Stencil, StencilTap, weighted_means,
    weighted_sums,
};
use crate::feature::candidate::{Candidate, MAX_CELL_OVERLAP, dominant_axes};
use crate::feature::volume::Volume;
use crate::geometry::simd::dispatch_simd;
use crate::geometry::{dot, hypot};
use std::f64::consts::PI;

/// Number of filter angles over half a turn.
pub const ANGLE_COUNT: usize = 24;

/// Standard deviations (samples) of the filters along a surface, across it, and along the line that
/// surfaces share.
#[derive(Debug, Clone, Copy)]
pub struct FilterShape {
    /// Along a surface, square to the line.
    along: f64,
    /// In all directions, applied before. Interpolation adds 0.65 to the resulting width across
    /// a surface.
    pub blur: f64,
    /// Along the line.
    line: f64,
}

/// Filters for surfaces that cross.
pub const CROSSING_SHAPE: FilterShape = FilterShape {
    along: 8.0,
    blur: 0.8,
    line: 3.0,
};

/// Filters for two close surfaces that form one wide ridge.
pub const CLOSE_SHAPE: FilterShape = FilterShape {
    along: 8.0,
    blur: 0.0,
    line: 6.0,
};

/// Largest difference, in steps of the angle, from the direction of normals: 15 degrees if there is
/// one direction, 30 degrees if there are more or ridges are wide.
const MAX_ANGLE_STEPS: [i32; 2] = [2, 4];
/// Smallest cosine (37 degrees) between these normals and the plane square to the line.
const MIN_IN_PLANE_COSINE: f64 = 0.8;
/// Number of layers to either side of a block that filters read.
pub const FILTER_HALO_LAYERS: usize = 40;
/// Step (samples) along a surface at which the image is read.
const SAMPLING_STEP: f64 = 2.5;
/// Largest offset (samples) of a point along the normal; a point farther away belongs to another
/// sample.
const MAX_OFFSET: f64 = 0.95;
/// Squared width (samples) of a filtered ridge, for the curvature of its profile.
const PROFILE_VARIANCE: f64 = 3.0;
/// Squared width (samples) of a typical ridge, to convert curvature to height.
const RIDGE_VARIANCE: f64 = 2.25;
/// Number of samples around a block that derivatives across a surface read: a position one sample
/// away is interpolated between samples at most one sample away along each axis.
const DERIVATIVE_MARGIN: usize = 1;
/// Number of samples on either side of a block in x: more than derivatives need, so that rows have
/// the width of vector registers.
const DERIVATIVE_MARGIN_X: usize = 4;
/// Number of samples in x of a block and its derivative margin.
const PADDED_WIDTH_X: usize = BLOCK_SIZE + 2 * DERIVATIVE_MARGIN_X;
/// Number of samples around a block in which line means are needed: two standard deviations of 8
/// samples, one sample for interpolation, and the derivative margin.
const LINE_MARGIN: usize = 16 + 1 + DERIVATIVE_MARGIN;
/// Edge of the buffer of line means along x: a multiple of the lanes, with a margin for derivatives
/// in full registers.
const BUFFER_WIDTH: usize =
    (BLOCK_SIZE + 2 * (16 + 1 + DERIVATIVE_MARGIN_X)).next_multiple_of(LANES);
/// Edge of this buffer along the other axes: an odd number, so that samples at the same place of
/// successive layers are in different sets of the cache.
const BUFFER_EDGE: usize = BLOCK_SIZE + 2 * LINE_MARGIN + 1;
/// Offset of the block in this buffer, along x and along the other axes.
const BLOCK_OFFSET_X: usize = (BUFFER_WIDTH - BLOCK_SIZE) / 2;
const BLOCK_OFFSET: usize = (BUFFER_EDGE - BLOCK_SIZE) / 2;
/// Edge of a block and its derivative margin, along all axes but x.
const PADDED_EDGE: usize = BLOCK_SIZE + 2 * DERIVATIVE_MARGIN;

/// Filters for a block.
pub struct OrientedFilters<const D: usize> {
    shape: FilterShape,
    frame: [[f64; D]; 3],
    /// Angles at which surfaces are searched for, in ascending order: those near the directions of
    /// normals.
    angles: Vec<usize>,
    /// Mean along the line, and mean along a surface at each of the angles.
    line_mean: Stencil<D>,
    surface_means: Vec<Stencil<D>>,
}

impl<const D: usize> OrientedFilters<D> {
    /// Creates the filters about the line of a frame, for surfaces with normals near `modes`.
    pub fn new(
        shape: FilterShape,
        frame: [[f64; D]; 3],
        modes: &[[f64; D]],
        is_wide: bool,
    ) -> Self {
        let mut is_searched = [false; ANGLE_COUNT];
        let max_steps = MAX_ANGLE_STEPS[usize::from(is_wide || modes.len() > 1)];
        for mode in modes {
            let [a, b] = [1, 2].map(|k: usize| dot(frame[k], *mode));
            if hypot(a, b) > MIN_IN_PLANE_COSINE {
                // The direction across turns with the angle: (-sin, cos).
                let bin = (-a).atan2(b) / PI * ANGLE_COUNT as f64;
                for turn in -max_steps..=max_steps {
                    let index = (bin.round() as i32 + turn).rem_euclid(ANGLE_COUNT as i32);
                    is_searched[index as usize] = true;
                }
            }
        }
        let mut filters = Self {
            shape,
            frame,
            angles: (0..ANGLE_COUNT)
                .filter(|&angle| is_searched[angle])
                .collect(),
            line_mean: match D {
                3 => Stencil::gaussian(frame[0], shape.line, 0.5 * shape.line),
                _ => Stencil::new(vec![([0.0; D], 1.0)]),
            },
            surface_means: Vec::new(),
        };
        let mean_along = |&angle: &usize| {
            let (along, _) = filters.directions(angle as f64);
            Stencil::gaussian(along, shape.along, SAMPLING_STEP)
        };
        filters.surface_means = filters.angles.iter().map(mean_along).collect();
        filters
    }

    /// Returns the directions along and across a surface at an angle (in steps of half a turn
    /// divided by [`ANGLE_COUNT`]).
    fn directions(&self, angle: f64) -> ([f64; D], [f64; D]) {
        let (sin, cos) = (PI * angle / ANGLE_COUNT as f64).sin_cos();
        let [_, a, b] = &self.frame;
        (
            std::array::from_fn(|k| cos * a[k] + sin * b[k]),
            std::array::from_fn(|k| cos * b[k] - sin * a[k]),
        )
    }

    /// Computes the mean along the line, minus `level`, for the block and its margin; outside the
    /// image it is 0. The block begins at sample `first`.
    pub fn fill_line_means(
        &self,
        image: Volume<'_, D>,
        first: [usize; D],
        level: f32,
        mask: &BlockMask,
        scratch: &mut BlockScratch,
    ) {
        let rows = BUFFER_EDGE.pow(D as u32 - 1);
        let begin: [isize; D] = std::array::from_fn(|k| {
            let offset = if k == 0 { BLOCK_OFFSET_X } else { BLOCK_OFFSET };
            first[k] as isize - offset as isize
        });
        let is_block_inside = (0..D).all(|k| {
            let edge = if k == 0 { BUFFER_WIDTH } else { BUFFER_EDGE };
            (self.line_mean).is_inside(k, begin[k], begin[k] + edge as isize, image.dims[k])
        });
        // Rows that are not needed keep arbitrary values.
        scratch.line.resize(BUFFER_WIDTH * rows, 0.0);
        scratch.inside_share.resize(BUFFER_WIDTH * rows, 0.0);
        scratch.is_inside = is_block_inside;
        let slots = 0..self.angles.len();
        scratch.surface_ranges = slots.map(|slot| self.surface_ranges(slot, mask)).collect();
        let needed = self.buffer_ranges(&scratch.surface_ranges);
        let line = self.line_mean.offsets(image.strides());
        let (out, out_inside) = (&mut scratch.line, &mut scratch.inside_share);
        dispatch_simd(
            #[inline(always)]
            || {
                for row in 0..rows {
                    let range = needed.range(row);
                    if range.is_empty() {
                        continue;
                    }
                    let (mut remaining, mut at) = (row, begin);
                    for k in 1..D {
                        at[k] += (remaining % BUFFER_EDGE) as isize;
                        remaining /= BUFFER_EDGE;
                    }
                    let is_axis_inside = |k: usize, length: usize| {
                        let end = at[k] + length as isize;
                        self.line_mean.is_inside(k, at[k], end, image.dims[k])
                    };
                    let is_row_inside = is_block_inside || (1..D).all(|k| is_axis_inside(k, 1));
                    for start in range.step_by(LANES) {
                        let start = start.min(BUFFER_WIDTH - LANES);
                        let target = row * BUFFER_WIDTH + start;
                        let mut at = at;
                        at[0] += start as isize;
                        let end = at[0] + LANES as isize;
                        if is_row_inside && self.line_mean.is_inside(0, at[0], end, image.dims[0]) {
                            let source = (0..D)
                                .rev()
                                .fold(0, |i, k| i * image.dims[k] as isize + at[k]);
                            let sum = weighted_sums::<LANES, ACCUMULATOR_COUNT>(
                                image.samples,
                                source,
                                &line,
                            );
                            out[target..target + LANES].copy_from_slice(&sum.map(|s| s - level));
                            if !is_block_inside {
                                out_inside[target..target + LANES].fill(1.0);
                            }
                        } else {
                            let (sum, inside) = self.line_mean.row_sums(image, at, level);
                            out[target..target + LANES].copy_from_slice(&sum);
                            out_inside[target..target + LANES].copy_from_slice(&inside);
                        }
                    }
                }
            },
        );
    }

    /// Returns, for each row of the block and its derivative margin, the range of samples that
    /// derivatives at needed samples read at the angle `slot`.
    fn surface_ranges(&self, slot: usize, mask: &BlockMask) -> RowRanges {
        let centre = [StencilTap {
            offset: [0; D],
            weight: 1.0,
        }];
        let [after, before] = self.derivative_stencils(slot);
        let taps = centre.iter().chain(&after.taps).chain(&before.taps);
        let mut needed = RowRanges::empty::<D>(PADDED_EDGE);
        needed.add_around(&mask.ranges, DERIVATIVE_MARGIN, taps);
        needed
    }

    /// Returns, for each row of the buffer, the range of samples that smoothing along surfaces
    /// reads.
    fn buffer_ranges(&self, surface_ranges: &[RowRanges]) -> RowRanges {
        let mut needed = RowRanges::empty::<D>(BUFFER_EDGE);
        let margin_x = BLOCK_OFFSET_X - DERIVATIVE_MARGIN;
        for (ranges, stencil) in surface_ranges.iter().zip(&self.surface_means) {
            needed.add_around(ranges, margin_x, stencil.taps.iter());
        }
        needed
    }

    /// Returns stencils that read the positions one sample away on both sides of a surface at the
    /// angle `slot`.
    fn derivative_stencils(&self, slot: usize) -> [Stencil<D>; 2] {
        let (_, across) = self.directions(self.angles[slot] as f64);
        [1.0, -1.0].map(|sign| Stencil::new(vec![(across.map(|c| sign * c), 1.0)]))
    }

    /// Computes C and D of every needed sample of the block at every angle. The block begins at
    /// sample `first` of an image.
    pub fn apply(
        &self,
        dims: [usize; D],
        first: [usize; D],
        mask: &BlockMask,
        scratch: &mut BlockScratch,
    ) {
        let rows = mask.rows.iter().filter(|r| **r).count();
        for buffer in [
            &mut scratch.second_derivative,
            &mut scratch.first_derivative,
        ] {
            buffer.resize(rows * self.angles.len() * BLOCK_SIZE, 0.0);
        }
        let samples = PADDED_EDGE.pow(D as u32 - 1) * PADDED_WIDTH_X;
        scratch.surface.resize(samples, 0.0);
        for slot in 0..self.angles.len() {
            self.smooth_along_surface(slot, dims, first, scratch);
            self.differentiate_across(slot, mask, scratch);
        }
    }

    /// Computes the means along a surface at the angle `slot`, of the block and its derivative
    /// margin. The block begins at sample `first` of an image.
    fn smooth_along_surface(
        &self,
        slot: usize,
        dims: [usize; D],
        first: [usize; D],
        scratch: &mut BlockScratch,
    ) {
        let BlockScratch {
            line,
            is_inside,
            inside_share,
            surface_ranges,
            surface,
            ..
        } = scratch;
        let needed = &surface_ranges[slot];
        let buffer_strides: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => BUFFER_WIDTH * BUFFER_EDGE.pow(k as u32 - 1),
        });
        let surface_mean = &self.surface_means[slot];
        let mean_taps = surface_mean.offsets(buffer_strides);
        // Returns `true` if all samples that contribute to means of a row are inside the image.
        let is_axis_inside = |k: usize, at: isize, length: usize| {
            let ((low, high), (before, after)) = (surface_mean.reach[k], self.line_mean.reach[k]);
            at + low + before >= 0 && at + length as isize + high + after <= dims[k] as isize
        };
        let is_x_inside = is_axis_inside(
            0,
            first[0] as isize - DERIVATIVE_MARGIN_X as isize,
            PADDED_WIDTH_X,
        );
        dispatch_simd(
            #[inline(always)]
            || {
                for row in 0..needed.row_count() {
                    let range = needed.range(row);
                    if range.is_empty() {
                        continue;
                    }
                    let (mut remaining, mut at) = (row, BLOCK_OFFSET_X - DERIVATIVE_MARGIN_X);
                    let mut is_row_inside = is_x_inside;
                    for k in 1..D {
                        let i = remaining % PADDED_EDGE;
                        at += (BLOCK_OFFSET - DERIVATIVE_MARGIN + i) * buffer_strides[k];
                        is_row_inside &= is_axis_inside(
                            k,
                            (first[k] + i) as isize - DERIVATIVE_MARGIN as isize,
                            1,
                        );
                        remaining /= PADDED_EDGE;
                    }
                    let row_shares = (!(is_row_inside || *is_inside)).then_some(&inside_share[..]);
                    let target = row * PADDED_WIDTH_X;
                    let width = match range.len() {
                        ..=8 => 8,
                        9..=16 => 16,
                        _ => PADDED_WIDTH_X,
                    };
                    let start = (DERIVATIVE_MARGIN_X - DERIVATIVE_MARGIN + range.start)
                        .min(PADDED_WIDTH_X - width);
                    let (at, out) = (at + start, &mut surface[target + start..]);
                    let taps = &mean_taps;
                    match width {
                        8 => weighted_means::<8>(line, row_shares, at, taps, out),
                        16 => weighted_means::<16>(line, row_shares, at, taps, out),
                        _ => weighted_means::<PADDED_WIDTH_X>(line, row_shares, at, taps, out),
                    }
                }
            },
        );
    }

    /// Computes C and D at the angle `slot`, of every needed sample of the block, from the means
    /// along a surface.
    fn differentiate_across(&self, slot: usize, mask: &BlockMask, scratch: &mut BlockScratch) {
        let BlockScratch {
            surface,
            second_derivative,
            first_derivative,
            ..
        } = scratch;
        let padded_strides: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => PADDED_WIDTH_X * PADDED_EDGE.pow(k as u32 - 1),
        });
        let [after_taps, before_taps] = self
            .derivative_stencils(slot)
            .map(|stencil| stencil.offsets(padded_strides));
        dispatch_simd(
            #[inline(always)]
            || {
                let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
                for (number, (row, _)) in rows.enumerate() {
                    let (mut remaining, mut at) = (row, DERIVATIVE_MARGIN_X);
                    for k in 1..D {
                        at += (DERIVATIVE_MARGIN + remaining % BLOCK_SIZE) * padded_strides[k];
                        remaining /= BLOCK_SIZE;
                    }
                    let target = (number * self.angles.len() + slot) * BLOCK_SIZE;
                    let centre = &surface[at..at + BLOCK_SIZE];
                    let after = weighted_sums::<BLOCK_SIZE, SHORT_ROW_ACCUMULATOR_COUNT>(
                        surface,
                        at as isize,
                        &after_taps,
                    );
                    let before = weighted_sums::<BLOCK_SIZE, SHORT_ROW_ACCUMULATOR_COUNT>(
                        surface,
                        at as isize,
                        &before_taps,
                    );
                    // The negated second derivative, and the first derivative.
                    for l in 0..BLOCK_SIZE {
                        second_derivative[target + l] = 2.0 * centre[l] - before[l] - after[l];
                        first_derivative[target + l] = 0.5 * (after[l] - before[l]);
                    }
                }
            },
        );
    }

    /// Adds the points of surfaces: maxima of C over the angle. The block begins at sample `first`.
    pub fn points(
        &self,
        dims: [usize; D],
        mask: &BlockMask,
        first: [usize; D],
        scratch: &BlockScratch,
        found: &mut Vec<Candidate<D>>,
    ) {
        // Ratio of the height of a ridge of typical width to its curvature.
        let filter_variance = self.shape.blur.powi(2) + 0.5;
        let scale = (filter_variance + RIDGE_VARIANCE).powf(1.5) / RIDGE_VARIANCE.sqrt();
        let count = self.angles.len();
        // An angle is used only if both neighbouring angles are filtered, too.
        let triples: Vec<[usize; 3]> = (0..count)
            .map(|slot| [(slot + count - 1) % count, slot, (slot + 1) % count])
            .filter(|slots| {
                let [before, here, after] = slots.map(|slot| self.angles[slot]);
                (before + 1) % ANGLE_COUNT == here && (here + 1) % ANGLE_COUNT == after
            })
            .collect();
        let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
        for (number, (row, _)) in rows.enumerate() {
            let range_of = |slot: usize| {
                (number * count + slot) * BLOCK_SIZE..(number * count + slot + 1) * BLOCK_SIZE
            };
            for &slots in &triples {
                let angle = self.angles[slots[1]];
                let c = slots.map(|slot| &scratch.second_derivative[range_of(slot)]);
                let d = slots.map(|slot| &scratch.first_derivative[range_of(slot)]);
                let is_searched = &mask.samples[row * BLOCK_SIZE..(row + 1) * BLOCK_SIZE];
                let mut maxima = maxima_bits(c, is_searched);
                while maxima != 0 {
                    let l = maxima.trailing_zeros() as usize;
                    maxima &= maxima - 1;
                    let [before, here, after] = c.map(|c| f64::from(c[l]));
                    // After half a turn, the direction across is the opposite one.
                    let mut slope = d.map(|d| f64::from(d[l]));
                    if angle == 0 {
                        slope[0] = -slope[0];
                    }
                    if angle + 1 == ANGLE_COUNT {
                        slope[2] = -slope[2];
                    }
                    let second_difference = before + after - 2.0 * here;
                    let turn =
                        (0.5 * (before - after) / second_difference.min(-1e-12)).clamp(-0.5, 0.5);
                    let curvature = here - 0.25 * (before - after) * turn;
                    let next = if turn < 0.0 { slope[0] } else { slope[2] };
                    let slope = slope[1] + turn.abs() * (next - slope[1]);
                    let (_, normal) = self.directions(angle as f64 + turn);
                    let linear = slope / curvature;
                    if linear.abs() > MAX_OFFSET {
                        continue;
                    }
                    let distance = linear / (1.0 + linear * linear / PROFILE_VARIANCE);
                    let strength = (scale * curvature) as f32;
                    let at = block_sample(row * BLOCK_SIZE + l, first);
                    for axis in dominant_axes(normal) {
                        let offset = distance / normal[axis];
                        if offset.abs() <= 0.5 + f64::from(MAX_CELL_OVERLAP) {
                            let offset = offset as f32;
                            found.push(Candidate::new(dims, at, axis, offset, normal, strength));
                        }
                    }
                }
            }
        }
    }
}

/// Returns one bit per sample of a row: 1 if the sample is to be searched and has its maximum at the middle
/// one of three angles.
fn maxima_bits([before, here, after]: [&[f32]; 3], is_searched: &[bool]) -> u32 {
    let (mut bits, mut is_maximum) = (0, [false; BLOCK_SIZE]);
    for l in 0..BLOCK_SIZE {
        let [before, here, after] = [before[l], here[l], after[l]];
        // A value of 0 means that nothing was measured.
        is_maximum[l] = (here > 0.0)
            & (here >= before)
            & (here > after)
            & (before != 0.0)
            & (after != 0.0)
            & is_searched[l];
    }
    for (l, &is_maximum) in is_maximum.iter().enumerate() {
        bits |= u32::from(is_maximum) << l;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{cross, sub, unit};

    #[test]
    fn few_samples_of_a_block_match_those_among_all() {
        let dims = [70, 50, 40];
        let samples: Vec<f32> = (0..70 * 50 * 40)
            .map(|i| (i * 7919 % 1009) as f32)
            .collect();
        let image = Volume::new(dims, &samples);
        let modes = [[1.0, 0.2, 0.3], [0.9, -0.4, 0.3]].map(unit);
        let line = unit(cross(modes[0], modes[1]));
        let side = cross(line, modes[0]);
        let filters = OrientedFilters::new(CROSSING_SHAPE, [line, modes[0], side], &modes, false);
        let mut scratch = BlockScratch::default();
        let mut find = |first: [usize; 3], is_wanted: &dyn Fn([usize; 3]) -> bool| {
            // Samples that are not needed must not influence the result.
            for buffer in [
                &mut scratch.line,
                &mut scratch.inside_share,
                &mut scratch.surface,
            ] {
                buffer.fill(f32::NAN);
            }
            let mask = BlockMask::new(dims, first, is_wanted);
            filters.fill_line_means(image, first, 500.0, &mask, &mut scratch);
            filters.apply(dims, first, &mask, &mut scratch);
            let mut points = Vec::new();
            filters.points(dims, &mask, first, &scratch, &mut points);
            points
        };
        for first in [[16, 16, 16], [0, 32, 0], [64, 48, 32]] {
            let all = find(first, &|_| true);
            assert!(all.len() > 20, "{first:?}: {}", all.len());
            let sparse = |at: [usize; 3]| (at[0] + 3 * at[1] + 5 * at[2]).is_multiple_of(11);
            let single = |at: [usize; 3]| image.index(at) == all[all.len() / 2].voxel.index();
            for is_wanted in [&sparse as &dyn Fn([usize; 3]) -> bool, &single] {
                let is_selected = |c: &&Candidate<3>| is_wanted(image.coordinates(c.voxel.index()));
                let expected: Vec<_> = all.iter().filter(is_selected).collect();
                let found = find(first, is_wanted);
                assert!(
                    !found.is_empty() && found.len() == expected.len(),
                    "{first:?}"
                );
                for (a, b) in found.iter().zip(expected) {
                    assert_eq!((a.voxel, a.axis), (b.voxel, b.axis));
                    // Near the sides of the image, the order of sums depends on which samples are
                    // needed.
                    let offset = sub(a.position, b.position);
                    assert!(dot(offset, offset) < 1e-6 && dot(a.normal, b.normal) > 0.9999);
                    assert!((a.strength / b.strength - 1.0).abs() < 1e-3);
                }
            }
        }
    }
}
