//! Filters that are long along a sheet and narrow across it, at all angles about a line.

use super::block::{BLOCK_SIZE, BlockMask, BlockScratch, RowRanges, block_sample};
use super::stencil::{
    ACCUMULATOR_COUNT, LANES, SHORT_ROW_ACCUMULATOR_COUNT, Stencil, weighted_means, weighted_sums,
};
use crate::feature::candidate::{Candidate, MAX_CELL_OVERLAP, dominant_axes};
use crate::feature::volume::Volume;
use crate::geometry::dot;
use crate::geometry::simd::dispatch_simd;
use std::f64::consts::PI;

/// Angles at which filters look, over half a turn.
pub const ANGLE_COUNT: usize = 24;

/// Standard deviations (samples) of the filters along a sheet, across it, and along the line that the
/// sheets share.
#[derive(Debug, Clone, Copy)]
pub struct FilterShape {
    /// Along a sheet, square to the line.
    along: f64,
    /// In all directions, beforehand; interpolation adds 0.65 to what comes of it across a sheet.
    pub blur: f64,
    /// Along the line.
    line: f64,
}

/// The filters where sheets cross ...
pub const CROSSING_SHAPE: FilterShape = FilterShape {
    along: 8.0,
    blur: 0.8,
    line: 3.0,
};

/// ... and where two of them look like one that is too wide.
pub const CLOSE_SHAPE: FilterShape = FilterShape {
    along: 8.0,
    blur: 0.0,
    line: 6.0,
};

/// Sheets are sought up to this many angles (15 degrees) from the direction that normals have where
/// there is one, and (30 degrees) where there are more or ridges are wide ...
const MAX_ANGLE_STEPS: [i32; 2] = [2, 4];
/// ... if these are no farther off the plane square to the line (cosine: 37 degrees).
const MIN_IN_PLANE_COSINE: f64 = 0.8;
/// Layers to either side of a block that filters look at.
pub const FILTER_HALO_LAYERS: usize = 40;
/// Step (samples) of the places along a sheet at which the image is read.
const SAMPLING_STEP: f64 = 2.5;
/// A point's offset along the normal at most, in samples: further off it is another sample's.
const MAX_OFFSET: f64 = 0.95;
/// Squared width (samples) of a filtered ridge, for the bend of its profile.
const PROFILE_VARIANCE: f64 = 3.0;
/// Squared width (samples) of a typical ridge, for the height that a curvature stands for.
const RIDGE_VARIANCE: f64 = 2.25;
/// Samples round a block that the derivatives across a sheet reach ...
pub const DERIVATIVE_MARGIN: usize = 2;
/// ... and in x, which makes rows of a width that vector registers like.
const DERIVATIVE_MARGIN_X: usize = 4;
/// Of a row of which no more matter, no more are smoothed along a sheet.
const MAX_SPARSE_ROW_SAMPLES: usize = 16;
/// Samples of x of a block and its small margin.
const PADDED_WIDTH_X: usize = BLOCK_SIZE + 2 * DERIVATIVE_MARGIN_X;
/// Samples round a block that filters along sheets reach in what is smoothed along the line: two
/// standard deviations of 8 samples, one for interpolation, and the small margin.
const LINE_MARGIN: usize = 16 + 1 + DERIVATIVE_MARGIN_X;
/// Edge of the buffer of that: a multiple of the lanes.
const BUFFER_EDGE: usize = (BLOCK_SIZE + 2 * LINE_MARGIN).next_multiple_of(LANES);
/// Where the block begins in the buffer.
const BLOCK_OFFSET: usize = (BUFFER_EDGE - BLOCK_SIZE) / 2;
/// Edge, but along x, of the block and its small margin.
const PADDED_EDGE: usize = BLOCK_SIZE + 2 * DERIVATIVE_MARGIN;

/// The filters of a block.
pub struct OrientedFilters<const D: usize> {
    shape: FilterShape,
    frame: [[f64; D]; 3],
    /// The angles at which sheets are looked for, in order: those near normals that there are.
    angles: Vec<usize>,
    /// Means along the line, and along a sheet at each of the angles.
    line_mean: Stencil<D>,
    surface_means: Vec<Stencil<D>>,
}

impl<const D: usize> OrientedFilters<D> {
    /// Filters about the line of a frame, for sheets with normals near `modes`.
    pub fn new(shape: FilterShape, frame: [[f64; D]; 3], modes: &[[f64; D]], wide: bool) -> Self {
        let mut sought = [false; ANGLE_COUNT];
        let turns = MAX_ANGLE_STEPS[usize::from(wide || modes.len() > 1)];
        for mode in modes {
            let [a, b] = [1, 2].map(|k: usize| dot(frame[k], *mode));
            if a.hypot(b) > MIN_IN_PLANE_COSINE {
                // The direction across turns with the angle: (-sin, cos).
                let bin = (-a).atan2(b) / PI * ANGLE_COUNT as f64;
                for turn in -turns..=turns {
                    let near = (bin.round() as i32 + turn).rem_euclid(ANGLE_COUNT as i32);
                    sought[near as usize] = true;
                }
            }
        }
        let mut filters = Self {
            shape,
            frame,
            angles: (0..ANGLE_COUNT).filter(|&angle| sought[angle]).collect(),
            line_mean: match D {
                3 => Stencil::gaussian(frame[0], shape.line, 0.5 * shape.line),
                _ => Stencil::new(vec![([0.0; D], 1.0)]),
            },
            surface_means: Vec::new(),
        };
        let along = |&angle: &usize| {
            let (along, _) = filters.directions(angle as f64);
            Stencil::gaussian(along, shape.along, SAMPLING_STEP)
        };
        filters.surface_means = filters.angles.iter().map(along).collect();
        filters
    }

    /// Directions along and across a sheet at an angle (in steps of half a turn over [`ANGLE_COUNT`]).
    fn directions(&self, angle: f64) -> ([f64; D], [f64; D]) {
        let (sin, cos) = (PI * angle / ANGLE_COUNT as f64).sin_cos();
        let [_, a, b] = &self.frame;
        (
            std::array::from_fn(|k| cos * a[k] + sin * b[k]),
            std::array::from_fn(|k| cos * b[k] - sin * a[k]),
        )
    }

    /// The mean along the line of the block and its margin, above `level`, which is zero outside of the
    /// image. The block begins at sample `first`.
    pub fn fill_line_means(
        &self,
        image: Volume<'_, D>,
        first: [usize; D],
        level: f32,
        mask: &BlockMask,
        scratch: &mut BlockScratch,
    ) {
        let rows = BUFFER_EDGE.pow(D as u32 - 1);
        let begin = first.map(|i| i as isize - BLOCK_OFFSET as isize);
        let whole = (0..D).all(|k| {
            self.line_mean
                .is_inside(k, begin[k], begin[k] + BUFFER_EDGE as isize, image.dims[k])
        });
        // Rows that are not needed hold anything.
        scratch.line.resize(BUFFER_EDGE * rows, 0.0);
        scratch.inside_share.resize(BUFFER_EDGE * rows, 0.0);
        scratch.is_inside = whole;
        let needed = self.buffer_ranges(mask);
        let line = self.line_mean.offsets(image.strides());
        let (out, out_inside) = (&mut scratch.line, &mut scratch.inside_share);
        dispatch_simd(
            #[inline(always)]
            || {
                for row in 0..rows {
                    let part = needed.range(row);
                    if part.is_empty() {
                        continue;
                    }
                    let (mut rest, mut at) = (row, begin);
                    for k in 1..D {
                        at[k] += (rest % BUFFER_EDGE) as isize;
                        rest /= BUFFER_EDGE;
                    }
                    let inside = |k: usize, length: usize| {
                        let end = at[k] + length as isize;
                        self.line_mean.is_inside(k, at[k], end, image.dims[k])
                    };
                    let row_inside = whole || (1..D).all(|k| inside(k, 1));
                    for start in part.step_by(LANES) {
                        let start = start.min(BUFFER_EDGE - LANES);
                        let to = row * BUFFER_EDGE + start;
                        let mut at = at;
                        at[0] += start as isize;
                        let end = at[0] + LANES as isize;
                        if row_inside && self.line_mean.is_inside(0, at[0], end, image.dims[0]) {
                            let from = (0..D)
                                .rev()
                                .fold(0, |i, k| i * image.dims[k] as isize + at[k]);
                            let sum = weighted_sums::<LANES, ACCUMULATOR_COUNT>(
                                image.samples,
                                from,
                                &line,
                            );
                            out[to..to + LANES].copy_from_slice(&sum.map(|s| s - level));
                            if !whole {
                                out_inside[to..to + LANES].fill(1.0);
                            }
                        } else {
                            let (sum, inside) = self.line_mean.row_sums(image, at, level);
                            out[to..to + LANES].copy_from_slice(&sum);
                            out_inside[to..to + LANES].copy_from_slice(&inside);
                        }
                    }
                }
            },
        );
    }

    /// Of each row of the buffer, which samples smoothing along sheets reads.
    fn buffer_ranges(&self, mask: &BlockMask) -> RowRanges {
        let mut strides = [0; D];
        for k in 1..D {
            strides[k] = BUFFER_EDGE.pow(k as u32 - 1);
        }
        // How far off rows are that are read, and how far along them from the first to the last.
        let mut offsets: Vec<(isize, [i8; 2])> = Vec::new();
        for sum in &self.surface_means {
            let rows = sum.offsets(strides).into_iter().map(|tap| tap.0);
            offsets.extend(rows.zip(sum.taps.iter().map(|tap| [tap.offset[0] as i8; 2])));
        }
        offsets.sort_unstable_by_key(|offset| offset.0);
        offsets.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 = [kept.1[0].min(next.1[0]), kept.1[1].max(next.1[1])];
            }
            same
        });
        let mut needed = RowRanges::empty(BUFFER_EDGE.pow(D as u32 - 1));
        let around = [&mask.rows_around.start, &mask.rows_around.end];
        dispatch_simd(
            #[inline(always)]
            || {
                // Rows that follow one another along the second axis at once.
                for line in 0..mask.rows_around.start.len() / PADDED_EDGE {
                    let own = line * PADDED_EDGE..(line + 1) * PADDED_EDGE;
                    if own
                        .clone()
                        .all(|row| mask.rows_around.range(row).is_empty())
                    {
                        continue;
                    }
                    let (mut rest, mut at) = (line, (BLOCK_OFFSET - DERIVATIVE_MARGIN) as isize);
                    for k in 2..D {
                        at += ((BLOCK_OFFSET - DERIVATIVE_MARGIN + rest % PADDED_EDGE) * strides[k])
                            as isize;
                        rest /= PADDED_EDGE;
                    }
                    let around = around.map(|row| &row[own.clone()]);
                    for &(offset, moved) in &offsets {
                        let moved = moved.map(|by| by + (BLOCK_OFFSET - DERIVATIVE_MARGIN) as i8);
                        needed.add_shifted((at + offset) as usize, around, moved);
                    }
                }
            },
        );
        needed
    }

    /// C and D of every sample of the block, which begins at sample `first` of an image, at every angle.
    pub fn apply(
        &self,
        dims: [usize; D],
        first: [usize; D],
        mask: &BlockMask,
        scratch: &mut BlockScratch,
    ) {
        let rows = mask.rows.iter().filter(|r| **r).count();
        let big = std::array::from_fn(|k| BUFFER_EDGE.pow(k as u32));
        let small: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => PADDED_WIDTH_X * PADDED_EDGE.pow(k as u32 - 1),
        });
        let BlockScratch {
            line,
            is_inside: whole,
            inside_share: line_inside,
            surface: sheet,
            second_derivative: seconds,
            first_derivative: firsts,
        } = scratch;
        for buffer in [&mut *seconds, &mut *firsts] {
            buffer.resize(rows * self.angles.len() * BLOCK_SIZE, 0.0);
        }
        sheet.resize(mask.rows_around.start.len() * PADDED_WIDTH_X, 0.0);
        for (slot, (&angle, along)) in self.angles.iter().zip(&self.surface_means).enumerate() {
            let (_, across) = self.directions(angle as f64);
            let bell = along.offsets(big);
            let [after, before] = [1.0, -1.0]
                .map(|sign| Stencil::new(vec![(across.map(|c| sign * c), 1.0)]).offsets(small));
            // Whether all that a row's means are made of is inside the image.
            let inside = |k: usize, at: isize, length: usize| {
                let ((low, high), (before, after)) = (along.reach[k], self.line_mean.reach[k]);
                at + low + before >= 0 && at + length as isize + high + after <= dims[k] as isize
            };
            let x_inside = inside(
                0,
                first[0] as isize - DERIVATIVE_MARGIN_X as isize,
                PADDED_WIDTH_X,
            );
            dispatch_simd(
                #[inline(always)]
                || {
                    for row in 0..mask.rows_around.start.len() {
                        let part = mask.rows_around.range(row);
                        if part.is_empty() {
                            continue;
                        }
                        let (mut rest, mut at) = (row, BLOCK_OFFSET - DERIVATIVE_MARGIN_X);
                        let mut row_inside = x_inside;
                        for k in 1..D {
                            let i = rest % PADDED_EDGE;
                            at += (BLOCK_OFFSET - DERIVATIVE_MARGIN + i) * big[k];
                            row_inside &=
                                inside(k, (first[k] + i) as isize - DERIVATIVE_MARGIN as isize, 1);
                            rest /= PADDED_EDGE;
                        }
                        let inside = (!(row_inside || *whole)).then_some(&line_inside[..]);
                        let to = row * PADDED_WIDTH_X;
                        if part.len() <= MAX_SPARSE_ROW_SAMPLES {
                            let start = (DERIVATIVE_MARGIN_X - DERIVATIVE_MARGIN + part.start)
                                .min(PADDED_WIDTH_X - MAX_SPARSE_ROW_SAMPLES);
                            let sheet = &mut sheet[to + start..];
                            weighted_means::<MAX_SPARSE_ROW_SAMPLES>(
                                line,
                                inside,
                                at + start,
                                &bell,
                                sheet,
                            );
                        } else {
                            weighted_means::<PADDED_WIDTH_X>(
                                line,
                                inside,
                                at,
                                &bell,
                                &mut sheet[to..],
                            );
                        }
                    }
                    let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
                    for (number, (row, _)) in rows.enumerate() {
                        let (mut rest, mut at) = (row, DERIVATIVE_MARGIN_X);
                        for k in 1..D {
                            at += (DERIVATIVE_MARGIN + rest % BLOCK_SIZE) * small[k];
                            rest /= BLOCK_SIZE;
                        }
                        let to = (number * self.angles.len() + slot) * BLOCK_SIZE;
                        let here = &sheet[at..at + BLOCK_SIZE];
                        let after = weighted_sums::<BLOCK_SIZE, SHORT_ROW_ACCUMULATOR_COUNT>(
                            sheet,
                            at as isize,
                            &after,
                        );
                        let before = weighted_sums::<BLOCK_SIZE, SHORT_ROW_ACCUMULATOR_COUNT>(
                            sheet,
                            at as isize,
                            &before,
                        );
                        // Curvature upside down, and slope.
                        for l in 0..BLOCK_SIZE {
                            seconds[to + l] = 2.0 * here[l] - before[l] - after[l];
                            firsts[to + l] = 0.5 * (after[l] - before[l]);
                        }
                    }
                },
            );
        }
    }

    /// Points of sheets: maxima of C over the angle. The block begins at sample `first`.
    pub fn points(
        &self,
        dims: [usize; D],
        mask: &BlockMask,
        first: [usize; D],
        scratch: &BlockScratch,
        found: &mut Vec<Candidate<D>>,
    ) {
        // The height of a ridge of typical width that curves so.
        let across = self.shape.blur.powi(2) + 0.5;
        let scale = (across + RIDGE_VARIANCE).powf(1.5) / RIDGE_VARIANCE.sqrt();
        let count = self.angles.len();
        // A maximum at the end of what was looked at is none.
        let between: Vec<[usize; 3]> = (0..count)
            .map(|slot| [(slot + count - 1) % count, slot, (slot + 1) % count])
            .filter(|slots| {
                let [before, here, after] = slots.map(|slot| self.angles[slot]);
                (before + 1) % ANGLE_COUNT == here && (here + 1) % ANGLE_COUNT == after
            })
            .collect();
        let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
        for (number, (row, _)) in rows.enumerate() {
            let of = |slot: usize| {
                (number * count + slot) * BLOCK_SIZE..(number * count + slot + 1) * BLOCK_SIZE
            };
            for &slots in &between {
                let angle = self.angles[slots[1]];
                let c = slots.map(|slot| &scratch.second_derivative[of(slot)]);
                let d = slots.map(|slot| &scratch.first_derivative[of(slot)]);
                let sought = &mask.samples[row * BLOCK_SIZE..(row + 1) * BLOCK_SIZE];
                let mut maxima = maxima_bits(c, sought);
                while maxima != 0 {
                    let l = maxima.trailing_zeros() as usize;
                    maxima &= maxima - 1;
                    let [before, here, after] = c.map(|c| f64::from(c[l]));
                    // Half a turn on, the direction across is the opposite one.
                    let mut slope = d.map(|d| f64::from(d[l]));
                    if angle == 0 {
                        slope[0] = -slope[0];
                    }
                    if angle + 1 == ANGLE_COUNT {
                        slope[2] = -slope[2];
                    }
                    let bend = before + after - 2.0 * here;
                    let turn = (0.5 * (before - after) / bend.min(-1e-12)).clamp(-0.5, 0.5);
                    let curvature = here - 0.25 * (before - after) * turn;
                    let next = if turn < 0.0 { slope[0] } else { slope[2] };
                    let slope = slope[1] + turn.abs() * (next - slope[1]);
                    let (_, normal) = self.directions(angle as f64 + turn);
                    let linear = slope / curvature;
                    if linear.abs() > MAX_OFFSET {
                        continue;
                    }
                    let off = linear / (1.0 + linear * linear / PROFILE_VARIANCE);
                    let strength = (scale * curvature) as f32;
                    let at = block_sample(row * BLOCK_SIZE + l, first);
                    for axis in dominant_axes(normal) {
                        let offset = off / normal[axis];
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

/// Which samples of a row, a bit for each, are sought and have their maximum at the angle in the middle of three.
fn maxima_bits([before, here, after]: [&[f32]; 3], sought: &[bool]) -> u32 {
    let (mut bits, mut any) = (0, [false; BLOCK_SIZE]);
    for l in 0..BLOCK_SIZE {
        let [before, here, after] = [before[l], here[l], after[l]];
        // Zero: nothing there.
        any[l] = (here > 0.0)
            & (here >= before)
            & (here > after)
            & (before != 0.0)
            & (after != 0.0)
            & sought[l];
    }
    for (l, &any) in any.iter().enumerate() {
        bits |= u32::from(any) << l;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{cross, sub, unit};

    #[test]
    fn few_samples_of_a_block_show_what_they_do_among_all() {
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
        let mut found = |first: [usize; 3], wanted: &dyn Fn([usize; 3]) -> bool| {
            // What is not needed is nothing to count on.
            for buffer in [
                &mut scratch.line,
                &mut scratch.inside_share,
                &mut scratch.surface,
            ] {
                buffer.fill(f32::NAN);
            }
            let mask = BlockMask::new(dims, first, wanted);
            filters.fill_line_means(image, first, 500.0, &mask, &mut scratch);
            filters.apply(dims, first, &mask, &mut scratch);
            let mut found = Vec::new();
            filters.points(dims, &mask, first, &scratch, &mut found);
            found
        };
        for first in [[16, 16, 16], [0, 32, 0], [64, 48, 32]] {
            let all = found(first, &|_| true);
            assert!(all.len() > 20, "{first:?}: {}", all.len());
            let few = |at: [usize; 3]| (at[0] + 3 * at[1] + 5 * at[2]).is_multiple_of(11);
            let one = |at: [usize; 3]| image.index(at) == all[all.len() / 2].voxel.index();
            for wanted in [&few as &dyn Fn([usize; 3]) -> bool, &one] {
                let wanted_of = |c: &&Candidate<3>| wanted(image.coordinates(c.voxel.index()));
                let of_all: Vec<_> = all.iter().filter(wanted_of).collect();
                let some = found(first, wanted);
                assert!(!some.is_empty() && some.len() == of_all.len(), "{first:?}");
                for (a, b) in some.iter().zip(of_all) {
                    assert_eq!((a.voxel, a.axis), (b.voxel, b.axis));
                    // Beside the image's sides, sums are made in another order where fewer are.
                    let off = sub(a.position, b.position);
                    assert!(dot(off, off) < 1e-6 && dot(a.normal, b.normal) > 0.9999);
                    assert!((a.strength / b.strength - 1.0).abs() < 1e-3);
                }
            }
        }
    }
}
