//! Filters that are long along a sheet and narrow across it, at all angles about a line.

use super::block::{BLOCK, Mask, Scratch, in_block};
use crate::feature::crossing::{Candidate, OVERLAP, dominant_axes};
use crate::feature::volume::Volume;
use crate::geometry::dot;
use crate::geometry::wide::wide;
use std::collections::BTreeMap;
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
pub const HALO: usize = 56;
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
/// Samples of x smoothed at once along the line.
const LANES: usize = 32;
/// Samples of x of a block and its small margin.
const WIDTH: usize = BLOCK + 2 * NEAR_X;

/// Weights of the samples round one, by how far they are in a buffer.
type Taps = Vec<(isize, f32)>;

/// The filters of a block.
pub struct Filters<const D: usize> {
    shape: Shape,
    frame: [[f64; D]; 3],
    /// Samples round a block that filters reach.
    margin: usize,
    /// Edge of the buffer.
    edge: usize,
    /// The angles at which sheets are looked for: those near normals that there are.
    angles: [bool; ANGLES],
}

impl<const D: usize> Filters<D> {
    /// Filters about the line of a frame, for sheets with normals near `modes` (any, if there are none).
    pub fn new(shape: Shape, frame: [[f64; D]; 3], modes: &[[f64; D]], wide: bool) -> Self {
        let line = if D == 3 { shape.line } else { 0.0 };
        let reach = (CUT * shape.along.hypot(line)).ceil() as usize + NEAR_X + 1;
        let edge = (BLOCK + 2 * reach).next_multiple_of(LANES);
        let margin = (edge - BLOCK) / 2;
        let mut filters = Self {
            shape,
            frame,
            margin,
            edge,
            angles: [modes.is_empty(); ANGLES],
        };
        let turns = TURNS[usize::from(wide || modes.len() > 1)];
        for mode in modes {
            let [a, b] = [1, 2].map(|k: usize| dot(frame[k], *mode));
            if a.hypot(b) > SQUARE {
                // The direction across turns with the angle: (-sin, cos).
                let bin = (-a).atan2(b) / PI * ANGLES as f64;
                for turn in -turns..=turns {
                    let near = (bin.round() as i32 + turn).rem_euclid(ANGLES as i32);
                    filters.angles[near as usize] = true;
                }
            }
        }
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

    /// A Gaussian of a width along a direction, read at every `step`, in a buffer of `strides`.
    fn bell(direction: [f64; D], width: f64, step: f64, strides: [usize; D]) -> Taps {
        let half = (CUT * width / step).round() as i32;
        let places: Vec<([f64; D], f64)> = (-half..=half)
            .map(|j| {
                let at = step * f64::from(j);
                (
                    direction.map(|c| c * at),
                    (-0.5 * (at / width).powi(2)).exp(),
                )
            })
            .collect();
        let sum: f64 = places.iter().map(|p| p.1).sum();
        taps(places.into_iter().map(|(at, w)| (at, w / sum)), strides)
    }

    /// Copies the block and its margin, zero outside of the image, and smooths them along the line.
    /// (A block whose margin is inside the image is read where it is.)
    pub fn fill(
        &self,
        image: Volume<'_, D>,
        first: [usize; D],
        level: f32,
        mask: &Mask,
        scratch: &mut Scratch,
    ) {
        let (edge, margin) = (self.edge, self.margin as isize);
        // Sums at the rows' ends read a little beyond the buffer; they are not used.
        let beyond = (CUT * self.shape.line).ceil() as isize + 1;
        let inside = (0..D).all(|k| {
            let (low, high) = (
                first[k] as isize - margin,
                (first[k] + BLOCK) as isize + margin,
            );
            low - beyond >= 0 && high + beyond <= image.dims[k] as isize
        });
        let strides = match inside {
            true => image.strides(),
            false => std::array::from_fn(|k| edge.pow(k as u32)),
        };
        let line = match D {
            3 => Self::bell(
                self.frame[0],
                self.shape.line,
                0.5 * self.shape.line,
                strides,
            ),
            _ => vec![(0, 1.0)],
        };
        let rows = edge.pow(D as u32 - 1);
        let pad = line.iter().map(|t| t.0.unsigned_abs()).max().unwrap_or(0) + LANES;
        let copied = if inside { 0 } else { rows };
        for buffer in [&mut scratch.raw, &mut scratch.inside] {
            buffer.clear();
            buffer.resize(edge * copied + 2 * pad, 0.0);
        }
        for row in 0..copied {
            let mut rest = row;
            let mut at = [0isize; D];
            for k in 1..D {
                at[k] = first[k] as isize + (rest % edge) as isize - margin;
                rest /= edge;
            }
            if (1..D).any(|k| at[k] < 0 || at[k] >= image.dims[k] as isize) {
                continue;
            }
            let start = (1..D)
                .rev()
                .fold(0, |i, k| (i + at[k] as usize) * image.dims[k - 1]);
            let from = first[0] as isize - margin;
            let low = from.max(0);
            let high = (from + edge as isize).min(image.dims[0] as isize);
            if low >= high {
                continue;
            }
            let to = pad + row * edge + (low - from) as usize;
            let source = &image.samples[start + low as usize..start + high as usize];
            for (out, s) in scratch.raw[to..].iter_mut().zip(source) {
                *out = s - level;
            }
            scratch.inside[to..to + source.len()].fill(1.0);
        }
        // Rows that are not needed hold anything.
        scratch.line.resize(edge * rows, 0.0);
        scratch
            .line_inside
            .resize(if inside { 0 } else { edge * rows }, 0.0);
        let needed = self.needed(mask);
        let (raw, out) = (&scratch.raw, &mut scratch.line);
        let (raw_inside, out_inside) = (&scratch.inside, &mut scratch.line_inside);
        let origin = image.index(first) as isize - strides.iter().sum::<usize>() as isize * margin;
        wide(
            #[inline(always)]
            || {
                for (row, _) in needed.iter().enumerate().filter(|r| *r.1) {
                    // The edge is a multiple of the lanes.
                    let (mut rest, mut from) = (row, origin);
                    for k in 1..D {
                        from += (rest % edge * strides[k]) as isize;
                        rest /= edge;
                    }
                    for part in 0..edge / LANES {
                        let at = row * edge + part * LANES;
                        let sum = match inside {
                            true => {
                                let from = from + (part * LANES) as isize;
                                summed::<LANES>(image.samples, from, &line).map(|s| s - level)
                            }
                            false => {
                                let part = summed::<LANES>(raw_inside, (pad + at) as isize, &line);
                                out_inside[at..at + LANES].copy_from_slice(&part);
                                summed::<LANES>(raw, (pad + at) as isize, &line)
                            }
                        };
                        out[at..at + LANES].copy_from_slice(&sum);
                    }
                }
            },
        );
    }

    /// The rows of the buffer that smoothing along sheets reads.
    fn needed(&self, mask: &Mask) -> Vec<bool> {
        let wide_edge = BLOCK + 2 * NEAR;
        let mut strides = [0; D];
        for k in 1..D {
            strides[k] = self.edge.pow(k as u32 - 1);
        }
        let mut needed = vec![false; self.edge.pow(D as u32 - 1)];
        let mut offsets = Vec::new();
        for angle in (0..ANGLES).filter(|&a| self.angles[a]) {
            let (along, _) = self.directions(angle as f64);
            let rows = Self::bell(along, self.shape.along, STEP, strides);
            offsets.extend(rows.into_iter().map(|tap| tap.0));
        }
        offsets.sort_unstable();
        offsets.dedup();
        for (row, _) in mask.around.iter().enumerate().filter(|r| *r.1) {
            let (mut rest, mut at) = (row, 0isize);
            for k in 1..D {
                at += ((self.margin - NEAR + rest % wide_edge) * strides[k]) as isize;
                rest /= wide_edge;
            }
            for offset in &offsets {
                needed[(at + offset) as usize] = true;
            }
        }
        needed
    }

    /// C and D of every sample of the block at every angle.
    pub fn apply(&self, mask: &Mask, scratch: &mut Scratch) {
        let rows = mask.rows.iter().filter(|r| **r).count();
        let wide_edge = BLOCK + 2 * NEAR;
        let big = std::array::from_fn(|k| self.edge.pow(k as u32));
        let small: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => WIDTH * wide_edge.pow(k as u32 - 1),
        });
        for buffer in [&mut scratch.second, &mut scratch.first] {
            buffer.clear();
            buffer.resize(rows * ANGLES * BLOCK, 0.0);
        }
        scratch.sheet.resize(mask.around.len() * WIDTH, 0.0);
        for angle in (0..ANGLES).filter(|&a| self.angles[a]) {
            let (along, across) = self.directions(angle as f64);
            let bell = Self::bell(along, self.shape.along, STEP, big);
            let minus = across.map(|c| -c);
            let third = |w: [f64; 3]| {
                taps(
                    [([0.0; D], w[0]), (minus, w[1]), (across, w[2])].into_iter(),
                    small,
                )
            };
            // Curvature upside down, and slope.
            let (second, first) = (third([2.0, -1.0, -1.0]), third([0.0, -0.5, 0.5]));
            let Scratch {
                line,
                line_inside,
                sheet,
                second: seconds,
                first: firsts,
                ..
            } = scratch;
            wide(
                #[inline(always)]
                || {
                    for (row, _) in mask.around.iter().enumerate().filter(|r| *r.1) {
                        let (mut rest, mut at) = (row, self.margin - NEAR_X);
                        for k in 1..D {
                            at += (self.margin - NEAR + rest % wide_edge) * big[k];
                            rest /= wide_edge;
                        }
                        let mut sum = summed::<WIDTH>(line, at as isize, &bell);
                        // Where the image ends, the mean of what is inside.
                        if !line_inside.is_empty() {
                            let part = summed::<WIDTH>(line_inside, at as isize, &bell);
                            for l in 0..WIDTH {
                                sum[l] = if part[l] > LEAST_INSIDE {
                                    sum[l] / part[l]
                                } else {
                                    0.0
                                };
                            }
                        }
                        sheet[row * WIDTH..(row + 1) * WIDTH].copy_from_slice(&sum);
                    }
                    let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
                    for (number, (row, _)) in rows.enumerate() {
                        let (mut rest, mut at) = (row, NEAR_X);
                        for k in 1..D {
                            at += (NEAR + rest % BLOCK) * small[k];
                            rest /= BLOCK;
                        }
                        let to = (number * ANGLES + angle) * BLOCK;
                        let c = summed::<BLOCK>(sheet, at as isize, &second);
                        let d = summed::<BLOCK>(sheet, at as isize, &first);
                        seconds[to..to + BLOCK].copy_from_slice(&c);
                        firsts[to..to + BLOCK].copy_from_slice(&d);
                    }
                },
            );
        }
    }

    /// Points of sheets: maxima of C over the angle.
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
        let (mut row, mut number) = (usize::MAX, usize::MAX);
        for (i, _) in mask.samples.iter().enumerate().filter(|s| *s.1) {
            if i / BLOCK != row {
                (row, number) = (i / BLOCK, number.wrapping_add(1));
            }
            let at = in_block(i, first);
            let place = |angle: usize| (number * ANGLES + angle % ANGLES) * BLOCK + i % BLOCK;
            let c = |angle: usize| f64::from(scratch.second[place(angle)]);
            // Half a turn on, the direction across is the opposite one.
            let d = |angle: usize| {
                let sign = if angle / ANGLES % 2 == 1 { 1.0 } else { -1.0 };
                sign * f64::from(scratch.first[place(angle)])
            };
            for angle in ANGLES..2 * ANGLES {
                let (before, here, after) = (c(angle - 1), c(angle), c(angle + 1));
                // Zero: not looked at; a maximum at the end of what was looked at is none.
                if !(here > 0.0 && here >= before && here > after && before != 0.0 && after != 0.0)
                {
                    continue;
                }
                let bend = before + after - 2.0 * here;
                let turn = (0.5 * (before - after) / bend.min(-1e-12)).clamp(-0.5, 0.5);
                let curvature = here - 0.25 * (before - after) * turn;
                let next = if turn < 0.0 {
                    d(angle - 1)
                } else {
                    d(angle + 1)
                };
                let slope = d(angle) + turn.abs() * (next - d(angle));
                let (_, normal) = self.directions((angle - ANGLES) as f64 + turn);
                let linear = slope / curvature;
                if linear.abs() > OFFSET {
                    continue;
                }
                let off = linear / (1.0 + linear * linear / PROFILE);
                let strength = (scale * curvature) as f32;
                for axis in dominant_axes(normal) {
                    let offset = off / normal[axis];
                    if offset.abs() <= 0.5 + f64::from(OVERLAP) {
                        found.push(Candidate::new(
                            dims,
                            at,
                            axis,
                            offset as f32,
                            normal,
                            strength,
                        ));
                    }
                }
            }
        }
    }
}

/// Weights of samples, from weights of places between them by multilinear interpolation.
fn taps<const D: usize>(
    places: impl Iterator<Item = ([f64; D], f64)>,
    strides: [usize; D],
) -> Taps {
    let mut taps: BTreeMap<isize, f64> = BTreeMap::new();
    for (at, weight) in places {
        let low = at.map(f64::floor);
        for corner in 0..1usize << D {
            let (mut share, mut offset) = (weight, 0isize);
            for k in 0..D {
                let above = corner >> k & 1 == 1;
                let fraction = at[k] - low[k];
                share *= if above { fraction } else { 1.0 - fraction };
                offset += (low[k] as isize + isize::from(above)) * strides[k] as isize;
            }
            if share.abs() > 1e-6 {
                *taps.entry(offset).or_default() += share;
            }
        }
    }
    taps.into_iter()
        .map(|(offset, weight)| (offset, weight as f32))
        .collect()
}

/// Weighted sums of neighbours, for `N` samples in a row: as many at once as stay in registers.
#[inline(always)]
fn summed<const N: usize>(samples: &[f32], at: isize, taps: &Taps) -> [f32; N] {
    let mut sum = [0.0f32; N];
    for &(offset, weight) in taps {
        let start = (at + offset) as usize;
        let from = &samples[start..start + N];
        for l in 0..N {
            sum[l] += weight * from[l];
        }
    }
    sum
}
