//! Filters that are long along a sheet and narrow across it, at all angles about a line.

use super::block::{BLOCK, Mask, Parts, Scratch, in_block};
use crate::feature::crossing::{Candidate, OVERLAP, dominant_axes};
use crate::feature::volume::Volume;
use crate::geometry::dot;
use crate::geometry::wide::wide;
use std::f64::consts::PI;

/// Angles at which filters look, over half a turn.
pub const ANGLES: usize = 24;

/// Standard deviations (samples) of the filters along a sheet, across it, and along the line that the
/// sheets share.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Along a sheet, square to the line.
    along: f64,
    /// In all directions, beforehand; interpolation adds 0.65 to what comes of it across a sheet.
    pub blur: f64,
    /// Along the line.
    line: f64,
}

/// The filters where sheets cross ...
pub const CROSSING: Shape = Shape {
    along: 8.0,
    blur: 0.8,
    line: 3.0,
};

/// ... and where two of them look like one that is too wide.
pub const CLOSE: Shape = Shape {
    along: 8.0,
    blur: 0.0,
    line: 6.0,
};

/// Sheets are sought up to this many angles (15 degrees) from the direction that normals have where
/// there is one, and (30 degrees) where there are more or ridges are wide ...
const TURNS: [i32; 2] = [2, 4];
/// ... if these are no farther off the plane square to the line (cosine: 37 degrees).
const SQUARE: f64 = 0.8;
/// Filters are cut at this many standard deviations.
const CUT: f64 = 2.0;
/// Layers to either side of a block that filters look at.
pub const HALO: usize = 40;
/// Step (samples) of the places along a sheet at which the image is read.
const STEP: f64 = 2.5;
/// A mean is one of what is inside the image if at least this share is.
const LEAST_INSIDE: f32 = 0.1;
/// A point's offset along the normal at most, in samples: further off it is another sample's.
const OFFSET: f64 = 0.95;
/// Squared width (samples) of a filtered ridge, for the bend of its profile.
const PROFILE: f64 = 3.0;
/// Squared width (samples) of a typical ridge, for the height that a curvature stands for.
const RIDGE: f64 = 2.25;
/// Samples round a block that the derivatives across a sheet reach ...
pub const NEAR: usize = 2;
/// ... and in x, which makes rows of a width that vector registers like.
const NEAR_X: usize = 4;
/// Samples of x smoothed at once along the line, and sums of them that grow side by side ...
const LANES: usize = 32;
const SUMS: usize = 2;
/// ... and along a sheet: of a row of few samples, and of all.
const FEW: usize = 16;
const MANY_SUMS: usize = 4;
/// Samples of x of a block and its small margin.
const WIDTH: usize = BLOCK + 2 * NEAR_X;
/// Samples round a block that filters along sheets reach in what is smoothed along the line: two
/// standard deviations of 8 samples, one for interpolation, and the small margin.
const MARGIN: usize = 16 + 1 + NEAR_X;
/// Edge of the buffer of that: a multiple of the lanes.
const EDGE: usize = (BLOCK + 2 * MARGIN).next_multiple_of(LANES);
/// Where the block begins in the buffer.
const BEGIN: usize = (EDGE - BLOCK) / 2;
/// Edge, but along x, of the block and its small margin.
const WIDE: usize = BLOCK + 2 * NEAR;

/// The weight of a sample some samples away.
#[derive(Debug, Clone, Copy)]
struct Tap<const D: usize> {
    at: [isize; D],
    weight: f32,
}

/// A weighted sum of the samples round one.
struct Sum<const D: usize> {
    taps: Vec<Tap<D>>,
    /// The first and the last sample along each axis that it reaches.
    reach: [(isize, isize); D],
}

/// The filters of a block.
pub struct Filters<const D: usize> {
    shape: Shape,
    frame: [[f64; D]; 3],
    /// The angles at which sheets are looked for, in order: those near normals that there are.
    angles: Vec<usize>,
    /// Means along the line, and along a sheet at each of the angles.
    line: Sum<D>,
    along: Vec<Sum<D>>,
}

impl<const D: usize> Filters<D> {
    /// Filters about the line of a frame, for sheets with normals near `modes`.
    pub fn new(shape: Shape, frame: [[f64; D]; 3], modes: &[[f64; D]], wide: bool) -> Self {
        let mut sought = [false; ANGLES];
        let turns = TURNS[usize::from(wide || modes.len() > 1)];
        for mode in modes {
            let [a, b] = [1, 2].map(|k: usize| dot(frame[k], *mode));
            if a.hypot(b) > SQUARE {
                // The direction across turns with the angle: (-sin, cos).
                let bin = (-a).atan2(b) / PI * ANGLES as f64;
                for turn in -turns..=turns {
                    let near = (bin.round() as i32 + turn).rem_euclid(ANGLES as i32);
                    sought[near as usize] = true;
                }
            }
        }
        let mut filters = Self {
            shape,
            frame,
            angles: (0..ANGLES).filter(|&angle| sought[angle]).collect(),
            line: match D {
                3 => Sum::bell(frame[0], shape.line, 0.5 * shape.line),
                _ => Sum::new(vec![([0.0; D], 1.0)]),
            },
            along: Vec::new(),
        };
        let along = |&angle: &usize| {
            let (along, _) = filters.directions(angle as f64);
            Sum::bell(along, shape.along, STEP)
        };
        filters.along = filters.angles.iter().map(along).collect();
        filters
    }

    /// Directions along and across a sheet at an angle (in steps of half a turn over [`ANGLES`]).
    fn directions(&self, angle: f64) -> ([f64; D], [f64; D]) {
        let (sin, cos) = (PI * angle / ANGLES as f64).sin_cos();
        let [_, a, b] = &self.frame;
        (
            std::array::from_fn(|k| cos * a[k] + sin * b[k]),
            std::array::from_fn(|k| cos * b[k] - sin * a[k]),
        )
    }

    /// The mean along the line of the block and its margin, above `level`, which is zero outside of the
    /// image. The block begins at sample `first`.
    pub fn fill(
        &self,
        image: Volume<'_, D>,
        first: [usize; D],
        level: f32,
        mask: &Mask,
        scratch: &mut Scratch,
    ) {
        let rows = EDGE.pow(D as u32 - 1);
        let begin = first.map(|i| i as isize - BEGIN as isize);
        let whole = (0..D).all(|k| {
            self.line
                .inside(k, begin[k], begin[k] + EDGE as isize, image.dims[k])
        });
        // Rows that are not needed hold anything.
        scratch.line.resize(EDGE * rows, 0.0);
        scratch.line_inside.resize(EDGE * rows, 0.0);
        scratch.whole = whole;
        let needed = self.needed(mask);
        let line = self.line.offsets(image.strides());
        let (out, out_inside) = (&mut scratch.line, &mut scratch.line_inside);
        wide(
            #[inline(always)]
            || {
                for row in 0..rows {
                    let part = needed.of(row);
                    if part.is_empty() {
                        continue;
                    }
                    let (mut rest, mut at) = (row, begin);
                    for k in 1..D {
                        at[k] += (rest % EDGE) as isize;
                        rest /= EDGE;
                    }
                    let inside = |k: usize, length: usize| {
                        let end = at[k] + length as isize;
                        self.line.inside(k, at[k], end, image.dims[k])
                    };
                    let row_inside = whole || (1..D).all(|k| inside(k, 1));
                    for start in part.step_by(LANES) {
                        let start = start.min(EDGE - LANES);
                        let to = row * EDGE + start;
                        let mut at = at;
                        at[0] += start as isize;
                        let end = at[0] + LANES as isize;
                        if row_inside && self.line.inside(0, at[0], end, image.dims[0]) {
                            let from = (0..D)
                                .rev()
                                .fold(0, |i, k| i * image.dims[k] as isize + at[k]);
                            let sum = summed::<LANES, SUMS>(image.samples, from, &line);
                            out[to..to + LANES].copy_from_slice(&sum.map(|s| s - level));
                            if !whole {
                                out_inside[to..to + LANES].fill(1.0);
                            }
                        } else {
                            let (sum, inside) = self.line.of_some(image, at, level);
                            out[to..to + LANES].copy_from_slice(&sum);
                            out_inside[to..to + LANES].copy_from_slice(&inside);
                        }
                    }
                }
            },
        );
    }

    /// Of each row of the buffer, which samples smoothing along sheets reads.
    fn needed(&self, mask: &Mask) -> Parts {
        let mut strides = [0; D];
        for k in 1..D {
            strides[k] = EDGE.pow(k as u32 - 1);
        }
        // How far off rows are that are read, and how far along them from the first to the last.
        let mut offsets: Vec<(isize, [i8; 2])> = Vec::new();
        for sum in &self.along {
            let rows = sum.offsets(strides).into_iter().map(|tap| tap.0);
            offsets.extend(rows.zip(sum.taps.iter().map(|tap| [tap.at[0] as i8; 2])));
        }
        offsets.sort_unstable_by_key(|offset| offset.0);
        offsets.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 = [kept.1[0].min(next.1[0]), kept.1[1].max(next.1[1])];
            }
            same
        });
        let mut needed = Parts::none(EDGE.pow(D as u32 - 1));
        let around = [&mask.around.start, &mask.around.end];
        wide(
            #[inline(always)]
            || {
                // Rows that follow one another along the second axis at once.
                for line in 0..mask.around.start.len() / WIDE {
                    let own = line * WIDE..(line + 1) * WIDE;
                    if own.clone().all(|row| mask.around.of(row).is_empty()) {
                        continue;
                    }
                    let (mut rest, mut at) = (line, (BEGIN - NEAR) as isize);
                    for k in 2..D {
                        at += ((BEGIN - NEAR + rest % WIDE) * strides[k]) as isize;
                        rest /= WIDE;
                    }
                    let around = around.map(|row| &row[own.clone()]);
                    for &(offset, moved) in &offsets {
                        let moved = moved.map(|by| by + (BEGIN - NEAR) as i8);
                        needed.add_all((at + offset) as usize, around, moved);
                    }
                }
            },
        );
        needed
    }

    /// C and D of every sample of the block, which begins at sample `first` of an image, at every angle.
    pub fn apply(&self, dims: [usize; D], first: [usize; D], mask: &Mask, scratch: &mut Scratch) {
        let rows = mask.rows.iter().filter(|r| **r).count();
        let big = std::array::from_fn(|k| EDGE.pow(k as u32));
        let small: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => WIDTH * WIDE.pow(k as u32 - 1),
        });
        let Scratch {
            line,
            whole,
            line_inside,
            sheet,
            second: seconds,
            first: firsts,
        } = scratch;
        for buffer in [&mut *seconds, &mut *firsts] {
            buffer.resize(rows * self.angles.len() * BLOCK, 0.0);
        }
        sheet.resize(mask.around.start.len() * WIDTH, 0.0);
        for (slot, (&angle, along)) in self.angles.iter().zip(&self.along).enumerate() {
            let (_, across) = self.directions(angle as f64);
            let bell = along.offsets(big);
            let [after, before] = [1.0, -1.0]
                .map(|sign| Sum::new(vec![(across.map(|c| sign * c), 1.0)]).offsets(small));
            // Whether all that a row's means are made of is inside the image.
            let inside = |k: usize, at: isize, length: usize| {
                let ((low, high), (before, after)) = (along.reach[k], self.line.reach[k]);
                at + low + before >= 0 && at + length as isize + high + after <= dims[k] as isize
            };
            let x_inside = inside(0, first[0] as isize - NEAR_X as isize, WIDTH);
            wide(
                #[inline(always)]
                || {
                    for row in 0..mask.around.start.len() {
                        let part = mask.around.of(row);
                        if part.is_empty() {
                            continue;
                        }
                        let (mut rest, mut at) = (row, BEGIN - NEAR_X);
                        let mut row_inside = x_inside;
                        for k in 1..D {
                            let i = rest % WIDE;
                            at += (BEGIN - NEAR + i) * big[k];
                            row_inside &= inside(k, (first[k] + i) as isize - NEAR as isize, 1);
                            rest /= WIDE;
                        }
                        let inside = (!(row_inside || *whole)).then_some(&line_inside[..]);
                        let to = row * WIDTH;
                        if part.len() <= FEW {
                            let start = (NEAR_X - NEAR + part.start).min(WIDTH - FEW);
                            let sheet = &mut sheet[to + start..];
                            mean::<FEW>(line, inside, at + start, &bell, sheet);
                        } else {
                            mean::<WIDTH>(line, inside, at, &bell, &mut sheet[to..]);
                        }
                    }
                    let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
                    for (number, (row, _)) in rows.enumerate() {
                        let (mut rest, mut at) = (row, NEAR_X);
                        for k in 1..D {
                            at += (NEAR + rest % BLOCK) * small[k];
                            rest /= BLOCK;
                        }
                        let to = (number * self.angles.len() + slot) * BLOCK;
                        let here = &sheet[at..at + BLOCK];
                        let after = summed::<BLOCK, MANY_SUMS>(sheet, at as isize, &after);
                        let before = summed::<BLOCK, MANY_SUMS>(sheet, at as isize, &before);
                        // Curvature upside down, and slope.
                        for l in 0..BLOCK {
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
        mask: &Mask,
        first: [usize; D],
        scratch: &Scratch,
        found: &mut Vec<Candidate<D>>,
    ) {
        // The height of a ridge of typical width that curves so.
        let across = self.shape.blur.powi(2) + 0.5;
        let scale = (across + RIDGE).powf(1.5) / RIDGE.sqrt();
        let count = self.angles.len();
        // A maximum at the end of what was looked at is none.
        let between: Vec<[usize; 3]> = (0..count)
            .map(|slot| [(slot + count - 1) % count, slot, (slot + 1) % count])
            .filter(|slots| {
                let [before, here, after] = slots.map(|slot| self.angles[slot]);
                (before + 1) % ANGLES == here && (here + 1) % ANGLES == after
            })
            .collect();
        let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
        for (number, (row, _)) in rows.enumerate() {
            let of =
                |slot: usize| (number * count + slot) * BLOCK..(number * count + slot + 1) * BLOCK;
            for &slots in &between {
                let angle = self.angles[slots[1]];
                let c = slots.map(|slot| &scratch.second[of(slot)]);
                let d = slots.map(|slot| &scratch.first[of(slot)]);
                let sought = &mask.samples[row * BLOCK..(row + 1) * BLOCK];
                let mut maxima = most(c, sought);
                while maxima != 0 {
                    let l = maxima.trailing_zeros() as usize;
                    maxima &= maxima - 1;
                    let [before, here, after] = c.map(|c| f64::from(c[l]));
                    // Half a turn on, the direction across is the opposite one.
                    let mut slope = d.map(|d| f64::from(d[l]));
                    if angle == 0 {
                        slope[0] = -slope[0];
                    }
                    if angle + 1 == ANGLES {
                        slope[2] = -slope[2];
                    }
                    let bend = before + after - 2.0 * here;
                    let turn = (0.5 * (before - after) / bend.min(-1e-12)).clamp(-0.5, 0.5);
                    let curvature = here - 0.25 * (before - after) * turn;
                    let next = if turn < 0.0 { slope[0] } else { slope[2] };
                    let slope = slope[1] + turn.abs() * (next - slope[1]);
                    let (_, normal) = self.directions(angle as f64 + turn);
                    let linear = slope / curvature;
                    if linear.abs() > OFFSET {
                        continue;
                    }
                    let off = linear / (1.0 + linear * linear / PROFILE);
                    let strength = (scale * curvature) as f32;
                    let at = in_block(row * BLOCK + l, first);
                    for axis in dominant_axes(normal) {
                        let offset = off / normal[axis];
                        if offset.abs() <= 0.5 + f64::from(OVERLAP) {
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
fn most([before, here, after]: [&[f32]; 3], sought: &[bool]) -> u32 {
    let (mut bits, mut any) = (0, [false; BLOCK]);
    for l in 0..BLOCK {
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

impl<const D: usize> Sum<D> {
    /// A weighted sum of places, each read by multilinear interpolation.
    fn new(places: Vec<([f64; D], f64)>) -> Self {
        let mut taps: Vec<Tap<D>> = Vec::with_capacity(places.len() << D);
        for (at, weight) in places {
            let low = at.map(f64::floor);
            for corner in 0..1usize << D {
                let (mut share, mut to) = (weight, [0; D]);
                for k in 0..D {
                    let above = corner >> k & 1 == 1;
                    let fraction = at[k] - low[k];
                    share *= if above { fraction } else { 1.0 - fraction };
                    to[k] = low[k] as isize + isize::from(above);
                }
                if share > 1e-6 {
                    let weight = share as f32;
                    taps.push(Tap { at: to, weight });
                }
            }
        }
        // As they lie in memory, each once.
        taps.sort_by_key(|tap| {
            let mut key = tap.at;
            key.reverse();
            key
        });
        taps.dedup_by(|tap, kept| {
            let same = tap.at == kept.at;
            kept.weight += if same { tap.weight } else { 0.0 };
            same
        });
        let reach = std::array::from_fn(|k| {
            let along = taps.iter().map(|tap| tap.at[k]);
            along.fold((0, 0), |r, i| (r.0.min(i), r.1.max(i)))
        });
        Self { taps, reach }
    }

    /// A Gaussian mean of a width along a direction, read at every `step`.
    fn bell(direction: [f64; D], width: f64, step: f64) -> Self {
        let half = (CUT * width / step).round() as i32;
        let places: Vec<([f64; D], f64)> = (-half..=half)
            .map(|j| {
                let along = step * f64::from(j);
                let weight = (-0.5 * (along / width).powi(2)).exp();
                (direction.map(|c| c * along), weight)
            })
            .collect();
        let sum: f64 = places.iter().map(|place| place.1).sum();
        Self::new(places.into_iter().map(|(at, w)| (at, w / sum)).collect())
    }

    /// How far in memory the samples are, and their weights.
    fn offsets(&self, strides: [usize; D]) -> Vec<(isize, f32)> {
        let offset = |tap: &Tap<D>| (0..D).map(|k| tap.at[k] * strides[k] as isize).sum();
        (self.taps.iter())
            .map(|tap| (offset(tap), tap.weight))
            .collect()
    }

    /// Whether the sums at samples `start` to `end` along axis `k` read only samples that there are.
    #[inline(always)]
    fn inside(&self, k: usize, start: isize, end: isize, samples: usize) -> bool {
        let (low, high) = self.reach[k];
        start + low >= 0 && end + high <= samples as isize
    }

    /// The sums at a row of samples from `at` on of what is inside an image, above `level`, and the
    /// sums of the weights of what is.
    #[inline(always)]
    fn of_some(
        &self,
        image: Volume<'_, D>,
        at: [isize; D],
        level: f32,
    ) -> ([f32; LANES], [f32; LANES]) {
        let (mut sum, mut inside) = ([0.0; LANES], [0.0; LANES]);
        for tap in &self.taps {
            let to: [isize; D] = std::array::from_fn(|k| at[k] + tap.at[k]);
            if (1..D).any(|k| to[k] < 0 || to[k] >= image.dims[k] as isize) {
                continue;
            }
            let row = (1..D)
                .rev()
                .fold(0, |i, k| (i + to[k] as usize) * image.dims[k - 1]);
            let low = (-to[0]).clamp(0, LANES as isize);
            let high = (image.dims[0] as isize - to[0]).clamp(low, LANES as isize);
            let from = row.wrapping_add_signed(to[0] + low);
            let (low, high) = (low as usize, high as usize);
            if low == high {
                continue;
            }
            let samples = &image.samples[from..from + high - low];
            // What is outside counts as the level.
            let mut part = [level; LANES];
            part[low..high].copy_from_slice(samples);
            for l in 0..LANES {
                sum[l] += tap.weight * (part[l] - level);
                inside[l] += if (low..high).contains(&l) {
                    tap.weight
                } else {
                    0.0
                };
            }
        }
        (sum, inside)
    }
}

/// Weighted means of neighbours for `N` samples in a row; where the image ends, of what is `inside`.
#[inline(always)]
fn mean<const N: usize>(
    samples: &[f32],
    inside: Option<&[f32]>,
    at: usize,
    taps: &[(isize, f32)],
    out: &mut [f32],
) {
    let mut sum = summed::<N, MANY_SUMS>(samples, at as isize, taps);
    if let Some(inside) = inside {
        let part = summed::<N, MANY_SUMS>(inside, at as isize, taps);
        for l in 0..N {
            sum[l] = if part[l] > LEAST_INSIDE {
                sum[l] / part[l]
            } else {
                0.0
            };
        }
    }
    out[..N].copy_from_slice(&sum);
}

/// Weighted sums of neighbours, for `N` samples in a row: as many at once as stay in registers. There are `W` sums of
/// each, of every `W`-th neighbour, since one addition would wait for the other.
#[inline(always)]
fn summed<const N: usize, const W: usize>(
    samples: &[f32],
    at: isize,
    taps: &[(isize, f32)],
) -> [f32; N] {
    let mut sums = [[0.0f32; N]; W];
    let (groups, rest) = taps.as_chunks::<W>();
    for group in groups {
        for w in 0..W {
            add(&mut sums[w], samples, at, group[w]);
        }
    }
    for (sum, tap) in sums.iter_mut().zip(rest) {
        add(sum, samples, at, *tap);
    }
    let mut all = sums[0];
    for sum in &sums[1..] {
        for l in 0..N {
            all[l] += sum[l];
        }
    }
    all
}

/// Adds a weighted row of samples.
#[inline(always)]
fn add<const N: usize>(
    sum: &mut [f32; N],
    samples: &[f32],
    at: isize,
    (offset, weight): (isize, f32),
) {
    let start = (at + offset) as usize;
    let from = &samples[start..start + N];
    for l in 0..N {
        sum[l] += weight * from[l];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{cross, sub, unit};

    #[test]
    fn means_along_lines_are_centred_and_as_wide_as_asked() {
        let directions = [
            [1.0, 0.0, 0.0],
            [0.6, -0.7, 0.4],
            [1.0, 1.0, 1.0],
            [0.1, 0.2, -0.9],
        ];
        for direction in directions.map(unit) {
            for (width, step) in [(8.0, 2.5), (6.0, 3.0), (3.0, 1.5)] {
                let sum = Sum::<3>::bell(direction, width, step);
                let (mut all, mut middle, mut along2, mut across2) = (0.0, [0.0; 3], 0.0, 0.0);
                for tap in &sum.taps {
                    let (at, weight) = (tap.at.map(|i| i as f64), f64::from(tap.weight));
                    let along = dot(at, direction);
                    all += weight;
                    middle = std::array::from_fn(|k| middle[k] + weight * at[k]);
                    along2 += weight * along * along;
                    across2 += weight * (dot(at, at) - along * along);
                }
                assert!((all - 1.0).abs() < 1e-4, "{direction:?}: {all}");
                assert!(dot(middle, middle) < 1e-6, "{direction:?}: {middle:?}");
                // A Gaussian cut at two standard deviations has .774 of its variance.
                let share = along2 / (width * width);
                assert!(
                    (0.62..0.9).contains(&share),
                    "{direction:?} {width}: {share}"
                );
                // Linear interpolation along three axes: at most a quarter each.
                assert!(across2 < 0.75, "{direction:?} {width}: {across2}");
                assert!(
                    sum.reach
                        .iter()
                        .all(|&(low, high)| -low <= 17 && high <= 17)
                );
            }
        }
    }

    #[test]
    fn at_the_sides_a_mean_is_one_of_what_is_inside() {
        let dims = [70, 50, 40];
        let samples: Vec<f32> = (0..70 * 50 * 40)
            .map(|i| (i * 7919 % 1009) as f32)
            .collect();
        let image = Volume::new(dims, &samples);
        let sum = Sum::<3>::bell(unit([0.5, 0.6, -0.4]), 3.0, 1.5);
        let offsets = sum.offsets(image.strides());
        // Far inside, both ways of summing agree ...
        let at = [20, 25, 20];
        let (some, share) = sum.of_some(image, at, 0.0);
        let from = image.index([20, 25, 20]) as isize;
        let whole = summed::<LANES, SUMS>(&samples, from, &offsets);
        for l in 0..LANES {
            assert!((share[l] - 1.0).abs() < 1e-5 && (some[l] - whole[l]).abs() < 1e-2);
        }
        // ... and beyond a side, sample by sample.
        for at in [[-9, 25, 20], [55, 3, 37], [20, -40, 20]] {
            let (some, share) = sum.of_some(image, at, 100.0);
            for l in 0..LANES {
                let (mut value, mut inside) = (0.0, 0.0);
                for tap in &sum.taps {
                    let to: [isize; 3] = std::array::from_fn(|k| {
                        at[k] + tap.at[k] + if k == 0 { l as isize } else { 0 }
                    });
                    if (0..3).all(|k| (0..dims[k] as isize).contains(&to[k])) {
                        value +=
                            tap.weight * (samples[image.index(to.map(|i| i as usize))] - 100.0);
                        inside += tap.weight;
                    }
                }
                assert!((value - some[l]).abs() < 1e-2 && (inside - share[l]).abs() < 1e-5);
            }
        }
    }

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
        let filters = Filters::new(CROSSING, [line, modes[0], side], &modes, false);
        let mut scratch = Scratch::default();
        let mut found = |first: [usize; 3], wanted: &dyn Fn([usize; 3]) -> bool| {
            // What is not needed is nothing to count on.
            for buffer in [
                &mut scratch.line,
                &mut scratch.line_inside,
                &mut scratch.sheet,
            ] {
                buffer.fill(f32::NAN);
            }
            let mask = Mask::new(dims, first, wanted);
            filters.fill(image, first, 500.0, &mask, &mut scratch);
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
