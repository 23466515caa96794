//! Samples that hold no data: finds them, and fills them for filters that look across them.
//!
//! A sample is dead if it is not finite, if it holds a null value, if it belongs to a trace that the survey
//! lacks or that is zero throughout, or if it stands alone far outside the range of all others. [`Image::marked`] finds dead samples; [`LiveMask`] says which
//! gaps are small enough to be bridged.

use super::Image;
use crate::error::{Error, Result, cause};
use crate::memory;
use crate::parallel::prelude::*;

/// Values that programs write where there are no data: Kingdom and Petrel, LAS files, grids of GIS, IRAP,
/// CPS-3, ZMAP+, Surfer, netCDF.
const COMMON_NULLS: [f32; 11] = [
    -999.25,
    -999.0,
    -9999.0,
    -99999.0,
    -999_999.0,
    9_999_900.0,
    1e30,
    -1e30,
    1.701_41e38,
    f32::MAX,
    f32::MIN,
];

/// The least magnitude among the common null values.
const LEAST_NULL: f32 = 999.0;

/// One sample of a null value of this magnitude or more is enough: no measurement is so large.
const IMPOSSIBLE: f32 = 1e29;

/// A null value of lesser magnitude has at least so many samples.
const FEWEST_NULLS: usize = 8;

/// Traces shorter than this (samples) may be zero by chance.
const SHORTEST_TRACE: usize = 8;

/// In an image with a larger share of zeros outside of traces that are zero throughout, zero is a value
/// like others.
const MOST_ZEROS: f64 = 0.3;

/// Dead samples within this distance (samples) of live ones on all sides are bridged: gaps up to twice as
/// wide.
const BRIDGE: usize = 3;

/// Filters look no farther than this (samples) into a gap.
const DEEPEST: usize = 64;

/// A sample is an outlier if it is farther from the median than all features by this factor.
const OUTLYING: f32 = 8.0;

/// Outliers are no larger share of the samples than this: what is more is a part of the image.
const MOST_OUTLIERS: f64 = 1e-3;

/// Samples, evenly spread, by which the usual distance from the median is judged.
const LOOKED_AT: usize = 100_000;

/// Bytes a sample that finding and filling gaps takes.
const BYTES: f64 = 16.0;

/// An image whose dead samples are marked, and notes on what was found.
#[derive(Debug, Clone)]
pub struct Marked<const D: usize> {
    /// The image; its dead samples are zeros.
    pub image: Image<D>,
    /// One line for each kind of dead samples.
    pub notes: Vec<String>,
}

impl<const D: usize> Image<D> {
    /// Returns the image with those of its samples marked as dead that are not finite and, if `recognise`
    /// is set, those of common null values, of traces that are zero throughout, and outliers. Returns `None` if there
    /// are none but those that are marked already.
    ///
    /// # Errors
    /// [`Error::Image`] if no sample is left, [`Error::Job`] if there is no memory for the marks.
    pub fn marked(&self, recognise: bool) -> Result<Option<Marked<D>>> {
        let samples = self.as_slice();
        let count = samples.len();
        let percent = |part: usize| 100.0 * part as f64 / count.max(1) as f64;
        let nulls = match recognise {
            true => self.common_nulls(),
            false => Vec::new(),
        };
        let is_finite = |part: &[f32]| part.iter().fold(true, |all, s| all & s.is_finite());
        let finite = samples.par_chunks(4096).all(is_finite);
        let zeros = match recognise {
            true => self.zero_traces(&nulls),
            false => Vec::new(),
        };
        let outliers = match recognise {
            true => self.outliers(&nulls),
            false => Vec::new(),
        };
        if finite && nulls.is_empty() && zeros.is_empty() && outliers.is_empty() {
            return Ok(None);
        }
        memory::afford(
            "the image",
            5.0 * count as f64,
            format!("marks of {count} samples, some of which hold no data"),
            "mesh a part of it",
        )?;
        let mut notes = Vec::new();
        let dead = |s: &f32| !s.is_finite() || nulls.iter().any(|null| is_null(*s, null.value));
        let mut flags: Vec<bool> = samples.par_iter().map(dead).collect();
        if !finite {
            let bad = samples.iter().filter(|s| !s.is_finite()).count();
            notes.push(format!(
                "{bad} samples ({:.2} %) are not finite and count as missing",
                percent(bad)
            ));
        }
        for null in &nulls {
            notes.push(format!(
                "{} samples ({:.2} %) hold {}, a common null value, and count as missing (--null none \
                 keeps them)",
                null.count,
                percent(null.count),
                null.value,
            ));
        }
        if !outliers.is_empty() {
            outliers.iter().for_each(|&i| flags[i] = true);
            let farthest = outliers
                .iter()
                .map(|&i| samples[i])
                .max_by(|a, b| a.abs().total_cmp(&b.abs()));
            notes.push(format!(
                "{} single samples ({:.2} %) lie {OUTLYING} times farther out than all others (up to {}) and \
                 count as missing (--null none keeps them)",
                outliers.len(),
                percent(outliers.len()),
                farthest.unwrap_or_default(),
            ));
        }
        if !zeros.is_empty() {
            let vertical = self.vertical();
            let (length, stride) = (self.dims()[vertical], self.stride(vertical));
            for &start in &zeros {
                (0..length).for_each(|i| flags[start + i * stride] = true);
            }
            let traces = count / length;
            notes.push(format!(
                "{} of {traces} traces ({:.2} %) are zero throughout and count as missing (--null none keeps \
                 them)",
                zeros.len(),
                100.0 * zeros.len() as f64 / traces as f64
            ));
        }
        if !self.dead.is_empty() {
            flags
                .iter_mut()
                .zip(&self.dead)
                .for_each(|(to, dead)| *to |= dead);
        }
        for (row, _) in self
            .missing
            .iter()
            .enumerate()
            .filter(|(_, missing)| **missing)
        {
            flags[row * self.dims()[0]..][..self.dims()[0]].fill(true);
        }
        if !flags.contains(&false) {
            return Err(Error::Image(cause(
                "image",
                "has no sample that holds data",
                "check that the right file and attribute were read, or give --null none",
            )));
        }
        let mut samples = samples.to_vec();
        for (sample, _) in samples.iter_mut().zip(&flags).filter(|(_, dead)| **dead) {
            *sample = 0.0;
        }
        let image = Self::new(self.dims(), samples, self.geometry.clone()).with_dead(flags);
        Ok(Some(Marked { image, notes }))
    }

    /// Returns the image with these samples marked as dead, one flag a sample.
    pub fn with_dead(mut self, flags: Vec<bool>) -> Self {
        let rows = flags.chunks(self.dims()[0].max(1));
        let whole = rows
            .clone()
            .all(|row| row.iter().all(|dead| *dead == row[0]));
        if whole {
            let missing = rows.map(|row| row[0]).collect();
            self.dead = Vec::new();
            return self.with_missing(missing);
        }
        self.missing = Vec::new();
        self.dead = flags;
        self
    }

    /// Returns the axis that runs along the vertical, or nearest to it.
    fn vertical(&self) -> usize {
        let upright = |k: usize| {
            let axis = self.geometry.axes[k];
            let length = axis.iter().map(|c| c * c).sum::<f64>().sqrt();
            axis[D - 1].abs() / length.max(f64::MIN_POSITIVE)
        };
        (1..D).fold(
            0,
            |best, k| if upright(k) >= upright(best) { k } else { best },
        )
    }

    fn stride(&self, axis: usize) -> usize {
        self.dims()[..axis].iter().product()
    }

    /// Returns the common null values that the image has.
    fn common_nulls(&self) -> Vec<Null> {
        let samples = self.as_slice();
        let dims = self.dims();
        let strides: [usize; D] = std::array::from_fn(|k| self.stride(k));
        let has_twin = |i: usize| {
            strides.iter().zip(dims).any(|(&stride, n)| {
                let at = i / stride % n;
                at > 0 && samples[i - stride] == samples[i]
                    || at + 1 < n && samples[i + stride] == samples[i]
            })
        };
        // For each value: samples, those beside a sample that is alike, and samples of the opposite value.
        type Counts = [[usize; 3]; COMMON_NULLS.len()];
        const TOGETHER: usize = 1 << 14;
        let count = |(chunk, part): (usize, &[f32])| {
            let mut counts: Counts = Default::default();
            for (i, &s) in part.iter().enumerate() {
                if s.abs() < LEAST_NULL {
                    continue;
                }
                for (counts, &null) in counts.iter_mut().zip(&COMMON_NULLS) {
                    if is_null(s, null) {
                        counts[0] += 1;
                        counts[1] += usize::from(has_twin(chunk * TOGETHER + i));
                    }
                    counts[2] += usize::from(is_null(s, -null));
                }
            }
            counts
        };
        let parts: Vec<Counts> = samples
            .par_chunks(TOGETHER)
            .enumerate()
            .map(count)
            .collect();
        let total = |value: usize, which: usize| parts.iter().map(|part| part[value][which]).sum();
        let found = COMMON_NULLS.iter().enumerate().filter_map(|(i, &value)| {
            let [count, twins, opposite]: [usize; 3] = [0, 1, 2].map(|which| total(i, which));
            // What is clipped is so at both ends.
            let is_fill = count >= FEWEST_NULLS && 10 * twins >= 9 * count && 4 * opposite < count;
            let impossible = value.abs() >= IMPOSSIBLE && count > 0;
            (is_fill || impossible).then_some(Null { value, count })
        });
        found.collect()
    }

    /// Returns the samples that stand alone and lie far outside the range of all others.
    fn outliers(&self, nulls: &[Null]) -> Vec<usize> {
        let samples = self.as_slice();
        let is_data = |s: f32| s.is_finite() && !nulls.iter().any(|null| is_null(s, null.value));
        let every = samples.len().div_ceil(LOOKED_AT) | 1;
        let some = samples.iter().step_by(every).copied();
        let mut some: Vec<f32> = some.filter(|s| is_data(*s)).collect();
        if some.is_empty() {
            return Vec::new();
        }
        let middle = some.len() / 2;
        let median = *some.select_nth_unstable_by(middle, f32::total_cmp).1;
        let mut usual: Vec<f32> = some.iter().map(|s| (s - median).abs()).collect();
        usual.retain(|off| *off > 0.0);
        if usual.is_empty() {
            return Vec::new();
        }
        let most = usual.len() * 99 / 100;
        let usual = *usual.select_nth_unstable_by(most, f32::total_cmp).1;
        let is_far = |s: f32, bound: f32| (s - median).abs() > bound && is_data(s);
        let range = |part: &[f32]| {
            part.iter()
                .fold(0.0, |most: f32, s| most.max((s - median).abs()))
        };
        let bound = OUTLYING * usual;
        if samples.par_chunks(4096).all(|part| range(part) <= bound) {
            return Vec::new();
        }
        let far = |i: &usize| is_far(samples[*i], bound);
        let far: Vec<usize> = (0..samples.len()).into_par_iter().filter(far).collect();
        if far.len() as f64 > MOST_OUTLIERS * samples.len() as f64 {
            return Vec::new();
        }
        // Of a sheet of such samples each has many others within two samples.
        let dims = self.dims();
        let strides: [usize; D] = std::array::from_fn(|k| self.stride(k));
        let alone = if D == 2 { 4 } else { 8 };
        let stands_alone = |i: usize| {
            let mut near = 0;
            for number in 0..5usize.pow(D as u32) {
                let (mut rest, mut to, mut inside) = (number, 0, true);
                for k in 0..D {
                    let at = i / strides[k] % dims[k] + rest % 5;
                    inside &= (2..dims[k] + 2).contains(&at);
                    to += at.saturating_sub(2) * strides[k];
                    rest /= 5;
                }
                near += usize::from(inside && is_far(samples[to], bound));
            }
            near <= alone
        };
        let (single, together): (Vec<usize>, Vec<usize>) =
            far.into_iter().partition(|&i| stands_alone(i));
        let largest = together.iter().map(|&i| (samples[i] - median).abs());
        let bound = OUTLYING * largest.fold(usual, f32::max);
        let single = single.into_iter().filter(|&i| is_far(samples[i], bound));
        single.collect()
    }

    /// Returns the first sample of each trace that is zero throughout but not marked yet, if the image is one
    /// of amplitudes, which are hardly ever zero.
    fn zero_traces(&self, nulls: &[Null]) -> Vec<usize> {
        let (samples, vertical) = (self.as_slice(), self.vertical());
        let (length, stride) = (self.dims()[vertical], self.stride(vertical));
        if length < SHORTEST_TRACE {
            return Vec::new();
        }
        let lanes = samples.len() / length;
        let start = |lane: usize| lane / stride * stride * length + lane % stride;
        let is_marked = |i: usize| {
            self.dead.get(i).copied().unwrap_or(false)
                || self
                    .missing
                    .get(i / self.dims()[0])
                    .copied()
                    .unwrap_or(false)
        };
        let is_null = |s: f32| !s.is_finite() || nulls.iter().any(|null| is_null(s, null.value));
        let is_zero = |&start: &usize| {
            let mut zeros = 0;
            let all = (0..length).map(|i| start + i * stride).all(|i| {
                let zero = samples[i] == 0.0 && !is_marked(i);
                zeros += usize::from(zero);
                zero || samples[i] == 0.0 || is_null(samples[i])
            });
            all && 2 * zeros > length
        };
        let found: Vec<usize> = (0..lanes)
            .into_par_iter()
            .map(start)
            .filter(is_zero)
            .collect();
        if found.is_empty() {
            return found;
        }
        // Positive, negative and zero samples outside of them.
        let sign = |part: &[f32]| {
            part.iter().fold([0usize; 3], |[more, less, zero], &s| {
                let live = !is_null(s);
                [
                    more + usize::from(live && s > 0.0),
                    less + usize::from(live && s < 0.0),
                    zero + usize::from(s == 0.0),
                ]
            })
        };
        let add = |a: [usize; 3], b: [usize; 3]| std::array::from_fn(|k| a[k] + b[k]);
        let [more, less, zero] = samples.par_chunks(4096).map(sign).reduce(|| [0; 3], add);
        let marked = match self.dead.is_empty() {
            true => self.missing.iter().filter(|m| **m).count() * self.dims()[0],
            false => self.dead.iter().filter(|m| **m).count(),
        };
        let zero = zero.saturating_sub(found.len() * length + marked) as f64;
        let values = (more + less) as f64;
        let has_both_signs = more.min(less) as f64 > 0.1 * values;
        match has_both_signs && zero < MOST_ZEROS * (zero + values) {
            true => found,
            false => Vec::new(),
        }
    }

    /// Returns which samples hold data, or `None` if all do.
    ///
    /// # Errors
    /// [`Error::Job`] if there is no memory for it.
    pub(crate) fn live_mask(&self) -> Result<Option<LiveMask<D>>> {
        let mut dims = self.dims();
        if self.dead.is_empty() && self.missing.is_empty() {
            return Ok(None);
        }
        let (alike, flags) = match self.dead.is_empty() {
            true => (Some(0), self.missing.clone()),
            false => self.cells_of_dead(),
        };
        let depth = alike.map_or(1, |axis| std::mem::replace(&mut dims[axis], 1));
        memory::afford(
            "the image",
            BYTES * flags.len() as f64,
            "finding the gaps in the image",
            "mesh a part of it",
        )?;
        Ok(Some(LiveMask::new((dims, alike, depth), &flags)))
    }

    /// Returns the axis along which dead samples are alike, if there is one, and the flags without it.
    fn cells_of_dead(&self) -> (Option<usize>, Vec<bool>) {
        for axis in 1..D {
            let (length, stride) = (self.dims()[axis], self.stride(axis));
            let blocks = self.dead.chunks(stride * length);
            let alike =
                |block: &[bool]| block.chunks(stride).all(|layer| *layer == block[..stride]);
            if blocks.clone().all(alike) {
                let flags = blocks.flat_map(|block| block[..stride].iter().copied());
                return (Some(axis), flags.collect());
            }
        }
        (None, self.dead.clone())
    }
}

/// A null value that an image has.
struct Null {
    value: f32,
    count: usize,
}

/// Returns whether a sample holds a null value; floats of IBM round it.
pub(crate) fn is_null(sample: f32, null: f32) -> bool {
    sample == null
        || (sample - null).abs() <= 1e-6 * null.abs() && null.fract() != 0.0
        || null.abs() >= IMPOSSIBLE && (sample / null - 1.0).abs() <= 1e-5
}

/// Returns whether a sample holds a common null value.
pub(crate) fn may_be_null(sample: f32) -> bool {
    COMMON_NULLS.iter().any(|&null| is_null(sample, null))
}

/// Whether a sample holds data.
#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Live,
    /// In a gap that is small enough for detectors to look across.
    Bridged,
    Dead,
}

/// Says which samples of an image hold data, and which gaps are small.
#[derive(Debug, Clone)]
pub(crate) struct LiveMask<const D: usize> {
    /// Cells along each axis: samples, but only one along the axis along which all are alike.
    dims: [usize; D],
    alike: Option<usize>,
    /// Samples along that axis.
    depth: usize,
    states: Vec<State>,
    /// For each cell the nearest live one, [`NONE`] beyond [`DEEPEST`].
    nearest: Vec<u32>,
}

/// No cell.
const NONE: u32 = u32::MAX;

impl<const D: usize> LiveMask<D> {
    fn new((dims, alike, depth): ([usize; D], Option<usize>, usize), dead: &[bool]) -> Self {
        let nearest = nearest(dims, |i| !dead[i], DEEPEST);
        let within = |i: usize, other: u32| {
            other != NONE && apart2(dims, i, other as usize) <= BRIDGE * BRIDGE
        };
        let beyond = self::nearest(dims, |i| !within(i, nearest[i]), BRIDGE);
        let state = |i: usize| match (dead[i], within(i, beyond[i])) {
            (false, _) => State::Live,
            (true, false) => State::Bridged,
            (true, true) => State::Dead,
        };
        Self {
            dims,
            alike,
            depth,
            states: (0..dead.len()).into_par_iter().map(state).collect(),
            nearest,
        }
    }

    fn cell(&self, mut at: [usize; D]) -> usize {
        if let Some(axis) = self.alike {
            at[axis] = 0;
        }
        (0..D).rev().fold(0, |i, k| i * self.dims[k] + at[k])
    }

    /// Returns whether the sample holds data.
    pub fn is_live(&self, at: [usize; D]) -> bool {
        self.states[self.cell(at)] == State::Live
    }

    /// Returns for a layer along the last axis which of its samples, in memory order, hold data.
    pub fn of_layer(&self, layer: usize) -> impl Fn(usize) -> bool + '_ {
        let mut first = [0; D];
        first[D - 1] = layer;
        let start = self.cell(first);
        let (alike, dims) = (self.alike, self.dims);
        let size: usize = dims[..D - 1].iter().product();
        move |i| {
            let cell = match alike {
                Some(axis) if axis < D - 1 => {
                    // The cell of a sample without the axis along which all are alike.
                    let stride: usize = dims[..axis].iter().product();
                    i % stride + i / (stride * self.depth) * stride
                }
                _ => i,
            };
            debug_assert!(cell < size);
            self.states[start + cell] == State::Live
        }
    }

    /// Returns whether features may lie at the sample: it holds data, or its gap is bridged.
    pub fn is_usable(&self, at: [usize; D]) -> bool {
        self.states[self.cell(at)] != State::Dead
    }

    /// Returns the shares of all samples that are dead, and that are bridged.
    pub fn shares(&self) -> [f64; 2] {
        [State::Dead, State::Bridged].map(|state| {
            let count = self.states.iter().filter(|s| **s == state).count();
            count as f64 / self.states.len().max(1) as f64
        })
    }

    /// Fills dead samples with the nearest live ones; if `bridge` is set, in bridged gaps linearly between
    /// the live samples on either side along the axes.
    pub fn fill(&self, dims: [usize; D], samples: &mut [f32], bridge: bool) {
        let strides: [usize; D] = std::array::from_fn(|k| dims[..k].iter().product());
        let cell_strides: [usize; D] = std::array::from_fn(|k| self.dims[..k].iter().product());
        let coordinates = |mut i: usize| -> [usize; D] {
            self.dims.map(|n| {
                let at = i % n;
                i /= n;
                at
            })
        };
        let index = |at: [usize; D]| (0..D).map(|k| at[k] * strides[k]).sum::<usize>();
        let live: Vec<f64> = samples.iter().map(|s| f64::from(*s)).collect();
        let mean = {
            let of_live = |i: &usize| self.states[*i] == State::Live;
            let starts = (0..self.states.len())
                .filter(of_live)
                .map(|i| live[index(coordinates(i))]);
            let (count, sum) = starts.fold((0usize, 0.0), |(n, sum), s| (n + 1, sum + s));
            sum / count.max(1) as f64
        };
        let depth = self.depth;
        let step = self.alike.map_or(0, |axis| strides[axis]);
        // First samples of the cells that a cell is filled from, and their weights.
        let sources = |i: usize| -> Vec<(usize, f64)> {
            let at = coordinates(i);
            let mut found = Vec::new();
            if bridge && self.states[i] == State::Bridged {
                for k in 0..D {
                    let live = |i: &usize| self.states[*i] == State::Live;
                    let most = 2 * BRIDGE + 1;
                    let before = (1..=most.min(at[k])).find(|n| live(&(i - n * cell_strides[k])));
                    let after = (self.dims[k] - 1 - at[k]).min(most);
                    let after = (1..=after).find(|n| live(&(i + n * cell_strides[k])));
                    if let (Some(before), Some(after)) = (before, after) {
                        let gap = (before + after) as f64;
                        let [mut low, mut high] = [at; 2];
                        low[k] -= before;
                        high[k] += after;
                        let weight = 1.0 / (gap * gap * gap);
                        found.push((index(low), weight * after as f64));
                        found.push((index(high), weight * before as f64));
                    }
                }
            }
            if found.is_empty() && self.nearest[i] != NONE {
                found.push((index(coordinates(self.nearest[i] as usize)), 1.0));
            }
            found
        };
        for i in (0..self.states.len()).filter(|i| self.states[*i] != State::Live) {
            let (start, sources) = (index(coordinates(i)), sources(i));
            let total: f64 = sources.iter().map(|(_, weight)| weight).sum();
            for n in 0..depth {
                let from = |(source, weight): &(usize, f64)| weight * live[source + n * step];
                samples[start + n * step] = match sources.is_empty() {
                    true => mean as f32,
                    false => (sources.iter().map(from).sum::<f64>() / total) as f32,
                };
            }
        }
    }
}

/// Returns the square of the distance between two cells.
pub(super) fn apart2<const D: usize>(dims: [usize; D], mut a: usize, mut b: usize) -> usize {
    let mut sum = 0;
    for n in dims {
        sum += (a % n).abs_diff(b % n).pow(2);
        (a, b) = (a / n, b / n);
    }
    sum
}

/// Returns for each cell the nearest one that is wanted, if there is one within `reach`: axis by axis, each
/// time the nearest among those that are nearest so far.
pub(super) fn nearest<const D: usize>(
    dims: [usize; D],
    wanted: impl Fn(usize) -> bool + Sync,
    reach: usize,
) -> Vec<u32> {
    let count: usize = dims.iter().product();
    let own = |i: usize| if wanted(i) { i as u32 } else { NONE };
    let mut nearest: Vec<u32> = (0..count).into_par_iter().map(own).collect();
    let mut stride = 1;
    for n in dims {
        if n == 1 {
            continue;
        }
        let before = nearest;
        let nearer = |i: usize| {
            let at = i / stride % n;
            let mut best = before[i];
            let mut least = match best {
                NONE => reach.saturating_mul(reach).saturating_add(1),
                other => apart2(dims, i, other as usize),
            };
            for step in 1..n {
                if step * step >= least {
                    break;
                }
                let back = (at >= step).then(|| i - step * stride);
                let forth = (at + step < n).then(|| i + step * stride);
                for other in [back, forth].into_iter().flatten().map(|i| before[i]) {
                    if other != NONE {
                        let apart = apart2(dims, i, other as usize);
                        if apart < least {
                            (least, best) = (apart, other);
                        }
                    }
                }
            }
            best
        };
        nearest = (0..count).into_par_iter().map(nearer).collect();
        stride *= n;
    }
    nearest
}
