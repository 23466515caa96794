//! Finer grids for surveys whose traces are far apart.
//!
//! Where layers dip, neighbouring traces differ by a shift. If traces are as far apart as a wavelength, the
//! shift is a large part of a period even at gentle dips: layers look like faults, faults look like layers,
//! and angles in samples say little about those in the world. Therefore traces are interpolated until they
//! are closer than [`MAX_SPACING`] wavelengths, by cubic convolution (Keys 1981) along each axis. Points
//! that are found between traces are moved along their surface to the columns of the survey.

use std::ops::Range;

use super::super::DetectorInput;
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::feature::windows::{LayerWindow, MAX_WHOLE_SAMPLES, Samples, layer_len};
use crate::geometry::{norm, unit};
use crate::image::layers::rows_per_layer;
use crate::image::time::default_metres_per_unit;
use crate::image::{Geometry, Image, ImageLayers, ImageSource};
use crate::memory;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Largest distance between traces, in wavelengths of the layers. Measured with surveys of 25 to 150 m
/// between lines; the network was trained on about a tenth to a third.
const MAX_SPACING: f64 = 0.75;

/// Largest number of traces in place of one, along each axis.
const MAX_FACTOR: usize = 16;

/// Largest lag (samples) at which traces are correlated with themselves.
const MAX_LAG: usize = 64;

/// Largest autocorrelation at half a wavelength: smaller dips of the autocorrelation are chance.
const MAX_TROUGH: f64 = -0.1;

/// Memory (bytes) per sample of the finer grid for its likelihood, and while it is in memory as a whole.
const BYTES_PER_SAMPLE: f64 = 4.0;
const WHOLE_BYTES_PER_SAMPLE: f64 = 16.0;

/// Distance (samples) within which two points of a column are one.
const SAME_POINT_DISTANCE: f32 = 0.5;

/// An image with more traces than a survey, which are interpolated when they are read.
pub struct FineGrid<'a, const D: usize> {
    survey: ImageSource<'a, D>,
    /// Number of samples in place of one, along each axis.
    pub factors: [usize; D],
    pub dims: [usize; D],
    geometry: Geometry<D>,
}

/// Distances in a survey (metres; two-way time at 2,000 m/s).
struct Spacing<const D: usize> {
    /// Distance between samples along each axis.
    steps: [f64; D],
    /// Axis along the traces.
    vertical: usize,
}

impl<const D: usize> Spacing<D> {
    fn new(geometry: &Geometry<D>) -> Self {
        let scale = (geometry.units.each_ref()).map(|unit| default_metres_per_unit(unit));
        let axes = geometry
            .axes
            .map(|axis| std::array::from_fn::<f64, D, _>(|c| axis[c] * scale[c]));
        let coordinate = geometry.time_coordinate().unwrap_or(D - 1);
        let rise = axes.map(|axis| axis[coordinate].abs() / norm(axis));
        Self {
            steps: axes.map(norm),
            vertical: (1..D).fold(0, |a, k| if rise[k] > rise[a] { k } else { a }),
        }
    }

    /// Returns the distance between traces along the axis along which it is largest, in samples along the
    /// traces.
    fn max_aspect(&self) -> f64 {
        let traces = (0..D).filter(|&k| k != self.vertical);
        traces.map(|k| self.steps[k]).fold(0.0, f64::max) / self.steps[self.vertical]
    }

    /// Returns the number of samples in place of one along each axis, for layers of this wavelength
    /// (metres).
    fn factors(&self, wavelength: f64) -> [usize; D] {
        std::array::from_fn(|k| {
            let factor = (self.steps[k] / (MAX_SPACING * wavelength)).ceil();
            if k == self.vertical {
                1
            } else {
                (factor as usize).clamp(1, MAX_FACTOR)
            }
        })
    }
}

impl<'a, const D: usize> FineGrid<'a, D> {
    /// Returns the finer grid on which faults are searched for, or `None` if traces are near enough. Sections
    /// are left as they are: their network has seen traces that are far apart.
    ///
    /// # Errors
    /// Returns the errors of reading, and an [`Error::Job`](crate::Error::Job) if there is not enough memory.
    pub fn for_survey(
        input: &DetectorInput<'a, D>,
        notes: &mut Vec<String>,
    ) -> Result<Option<Self>> {
        let geometry = input.source.geometry();
        let spacing = Spacing::new(geometry);
        // Traces are near enough for wavelengths of at least twice this lag.
        let lag = 0.5 * spacing.max_aspect() / MAX_SPACING;
        if D == 2 || !lag.is_finite() || lag < 2.0 {
            return Ok(None);
        }
        let max_lag = (lag as usize).min(MAX_LAG);
        let samples = input.samples(1.0)?;
        let Some(period) = period(&samples, spacing.vertical, max_lag, input.cancel)? else {
            return Ok(None);
        };
        let wavelength = period * spacing.steps[spacing.vertical];
        let factors = spacing.factors(wavelength);
        if factors == [1; D] {
            return Ok(None);
        }
        let grid = Self::new(input.source, factors);
        grid.ensure_memory()?;
        let distances = (0..D).filter(|&k| k != spacing.vertical);
        let distances: Vec<String> = distances
            .map(|k| {
                let step = spacing.steps[k];
                format!("{step:.1} to {:.1} m", step / factors[k] as f64)
            })
            .collect();
        notes.push(format!(
            "traces are far apart for layers with a wavelength of about {wavelength:.0} m{}: faults are searched for \
             between interpolated traces, with distances reduced from {}",
            if geometry.time_coordinate().is_some() {
                " (at 2000 m/s)"
            } else {
                ""
            },
            distances.join(" and from "),
        ));
        Ok(Some(grid))
    }

    /// Creates a grid with `factors` samples in place of one along each axis.
    fn new(survey: ImageSource<'a, D>, factors: [usize; D]) -> Self {
        let (dims, mut geometry) = (survey.dims(), survey.geometry().clone());
        for (axis, factor) in geometry.axes.iter_mut().zip(factors) {
            *axis = axis.map(|c| c / factor as f64);
        }
        Self {
            survey,
            factors,
            dims: std::array::from_fn(|k| dims[k].saturating_sub(1) * factors[k] + 1),
            geometry,
        }
    }

    fn ensure_memory(&self) -> Result<()> {
        let count = self.dims.iter().map(|&n| n as f64).product::<f64>();
        let whole = count.min(MAX_WHOLE_SAMPLES as f64);
        memory::ensure_available(
            "faults",
            BYTES_PER_SAMPLE * count + WHOLE_BYTES_PER_SAMPLE * whole,
            format!("interpolating traces to {:?} samples", self.dims),
            "give a part of the survey",
        )
    }

    /// Returns the points of the survey's columns, in the order of samples, for points of this grid.
    pub fn to_survey(&self, candidates: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let dims = self.survey.dims();
        let moved = candidates.par_iter().map(|c| self.move_to_column(dims, c));
        let mut moved: Vec<MovedCandidate<D>> =
            moved.collect::<Vec<_>>().into_iter().flatten().collect();
        moved.sort_by(|a, b| {
            let order = (a.point.axis, a.column).cmp(&(b.point.axis, b.column));
            order.then(a.height().total_cmp(&b.height()))
        });
        let is_same = |a: &MovedCandidate<D>, b: &MovedCandidate<D>| {
            (a.point.axis, a.column) == (b.point.axis, b.column)
                && b.height() - a.height() < SAME_POINT_DISTANCE
        };
        let nearest = |points: &[MovedCandidate<D>]| {
            let nearest = points
                .iter()
                .reduce(|a, b| if b.shift < a.shift { b } else { a });
            nearest.map(|moved| moved.point)
        };
        let mut points: Vec<Candidate<D>> = moved.chunk_by(is_same).filter_map(nearest).collect();
        points.sort_by_key(|c| (c.voxel, c.axis));
        points.dedup_by_key(|c| (c.voxel, c.axis));
        points
    }

    /// Moves a point along its surface to the nearest column of the survey that crosses the surface most
    /// steeply. Returns `None` if it is outside the survey.
    fn move_to_column(&self, dims: [usize; D], c: &Candidate<D>) -> Option<MovedCandidate<D>> {
        let factors = self.factors.map(|f| f as f64);
        let position: [f64; D] = std::array::from_fn(|k| f64::from(c.position[k]) / factors[k]);
        let normal: [f64; D] = unit(std::array::from_fn(|k| f64::from(c.normal[k]) * factors[k]));
        let axis = (1..D).fold(0, |a, k| {
            if normal[k].abs() > normal[a].abs() {
                k
            } else {
                a
            }
        });
        let mut at: [usize; D] =
            std::array::from_fn(|k| (position[k].round().max(0.0) as usize).min(dims[k] - 1));
        let (mut along, mut shift) = (position[axis], 0.0);
        for k in (0..D).filter(|&k| k != axis) {
            let offset = position[k] - at[k] as f64;
            along += normal[k] * offset / normal[axis];
            shift += offset * offset;
        }
        if !(along > -0.5 && along < dims[axis] as f64 - 0.5) {
            return None;
        }
        let mut column = at;
        column[axis] = 0;
        at[axis] = (along.round().max(0.0) as usize).min(dims[axis] - 1);
        let offset = (along - at[axis] as f64) as f32;
        Some(MovedCandidate {
            point: Candidate::new(dims, at, axis, offset, normal, c.strength),
            column,
            shift,
        })
    }
}

/// A point that was moved to a column of a survey.
struct MovedCandidate<const D: usize> {
    point: Candidate<D>,
    /// Sample of the column whose index along the point's axis is 0.
    column: [usize; D],
    /// Square of the distance (samples) across the column by which it was moved.
    shift: f64,
}

impl<const D: usize> MovedCandidate<D> {
    fn height(&self) -> f32 {
        self.point.position[self.point.axis as usize]
    }
}

/// Returns the typical period (samples) of traces along the axis `vertical`: twice the lag at which their
/// autocorrelation has its first trough. Returns `None` if there is none at lags up to `max_lag`.
///
/// # Errors
/// Returns the errors of reading.
fn period<const D: usize>(
    samples: &Samples<'_, D>,
    vertical: usize,
    max_lag: usize,
    cancel: &CancelToken<'_>,
) -> Result<Option<f64>> {
    let dims = samples.dims();
    // One lag more tells whether the last one is a trough. The last sum is that of the samples.
    let lags = (max_lag + 2).min(dims[vertical]);
    let halo = if vertical == D - 1 { lags } else { 0 };
    let mut sums = vec![0.0; lags + 1];
    let mut measure = |window: &LayerWindow<'_, D>| -> Vec<Vec<f64>> {
        let layers = window.interior.layers.clone().into_par_iter();
        layers
            .map(|layer| layer_products(window, layer, vertical, lags))
            .collect()
    };
    let mut take = |layers: Vec<Vec<f64>>| {
        for layer in layers {
            sums.iter_mut()
                .zip(layer)
                .for_each(|(sum, part)| *sum += part);
        }
    };
    samples.for_each_window(halo, None, &|_| 1, cancel, &mut measure, &mut take)?;
    let count = dims.iter().map(|&n| n as f64).product::<f64>();
    let mean = sums[lags] / count;
    let correlation = |lag: usize| {
        let share = (dims[vertical] - lag) as f64 / dims[vertical] as f64;
        sums[lag] / (count * share) - mean * mean
    };
    let correlations: Vec<f64> = (0..lags).map(correlation).collect();
    let is_trough = |lag: &usize| {
        let [before, here, after] = [lag - 1, *lag, lag + 1].map(|lag| correlations[lag]);
        here < MAX_TROUGH * correlations[0] && here <= before && here < after
    };
    Ok((1..lags.saturating_sub(1))
        .find(is_trough)
        .map(|lag| 2.0 * lag as f64))
}

/// Returns the sums, over the samples of a layer, of the products with the samples at each of `lags` lags
/// along the axis `vertical`, and the sum of the samples.
fn layer_products<const D: usize>(
    window: &LayerWindow<'_, D>,
    layer: usize,
    vertical: usize,
    lags: usize,
) -> Vec<f64> {
    let dims = window.dims;
    let samples = window.smoothed.layers(&(layer..layer + 1));
    let product =
        |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum() };
    let at_lag = |lag: usize| -> f64 {
        if vertical == D - 1 {
            let other = layer + lag;
            if other >= dims[D - 1] {
                return 0.0;
            }
            return product(samples, window.smoothed.layers(&(other..other + 1)));
        }
        let stride: usize = dims[..vertical].iter().product();
        let blocks = samples.chunks(stride * dims[vertical]);
        blocks
            .map(|block| product(block, &block[lag * stride..]))
            .sum()
    };
    let mut sums: Vec<f64> = (0..lags).map(at_lag).collect();
    sums.push(samples.iter().map(|&s| f64::from(s)).sum());
    sums
}

/// Returns the four samples around the place `index` / `factor` on a line of `count` samples, with their
/// weights.
fn cubic_taps(index: usize, factor: usize, count: usize) -> [(usize, f32); 4] {
    let (base, t) = (index / factor, (index % factor) as f64 / factor as f64);
    let near = |t: f64| (1.5 * t - 2.5) * t * t + 1.0;
    let far = |t: f64| ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0;
    let weights = [far(1.0 + t), near(t), near(1.0 - t), far(2.0 - t)];
    std::array::from_fn(|k| {
        let sample = (base + k).saturating_sub(1).min(count - 1);
        (sample, weights[k] as f32)
    })
}

/// Returns the samples of a survey that are needed for the places `fine` between them.
fn needed(fine: &Range<usize>, factor: usize, count: usize) -> Range<usize> {
    let end = fine.end.saturating_sub(1) / factor + 3;
    (fine.start / factor).saturating_sub(1)..end.min(count)
}

/// Sums `parts` of `samples`, each of which begins at its tap's number times the length of `out`.
fn mix(taps: [(usize, f32); 4], first: usize, samples: &[f32], out: &mut [f32]) {
    let length = out.len();
    out.fill(0.0);
    for (number, weight) in taps.into_iter().filter(|tap| tap.1 != 0.0) {
        let part = &samples[(number - first) * length..][..length];
        out.iter_mut().zip(part).for_each(|(o, s)| *o += weight * s);
    }
}

impl<const D: usize> FineGrid<'_, D> {
    /// Returns the samples of some rows of some layers of the survey.
    fn survey_rows(&self, layers: &Range<usize>, rows: &Range<usize>) -> Result<Vec<f32>> {
        let dims = self.survey.dims();
        let row = dims[0];
        let mut samples = vec![0.0; layers.len() * rows.len() * row];
        match self.survey {
            ImageSource::Layered(survey) => {
                survey.read_rows(layers.start, rows.clone(), &mut samples)?;
            }
            ImageSource::InMemory(image) => {
                let parts = samples.chunks_mut((rows.len() * row).max(1));
                for (part, layer) in parts.zip(layers.clone()) {
                    let layer = &image.as_slice()[layer * layer_len(dims)..];
                    part.copy_from_slice(&layer[rows.start * row..rows.end * row]);
                }
            }
        }
        Ok(samples)
    }
}

impl<const D: usize> ImageLayers<D> for FineGrid<'_, D> {
    fn dims(&self) -> [usize; D] {
        self.dims
    }

    fn geometry(&self) -> &Geometry<D> {
        &self.geometry
    }

    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let (survey_dims, row) = (self.survey.dims(), self.dims[0]);
        let row_factor = if D == 2 { 1 } else { self.factors[1] };
        let row_count = rows_per_layer(survey_dims);
        let layer = rows.len() * row;
        let last = first + out.len() / layer.max(1);
        let layers = needed(&(first..last), self.factors[D - 1], survey_dims[D - 1]);
        let survey_rows = needed(&rows, row_factor, row_count);
        let samples = self.survey_rows(&layers, &survey_rows)?;
        let out = out.par_chunks_mut(layer.max(1)).enumerate();
        out.for_each(|(number, out)| {
            let mut mixed_layer = vec![0.0; survey_rows.len() * survey_dims[0]];
            let taps = cubic_taps(first + number, self.factors[D - 1], survey_dims[D - 1]);
            mix(taps, layers.start, &samples, &mut mixed_layer);
            let mut mixed_row = vec![0.0; survey_dims[0]];
            for (out, number) in out.chunks_mut(row).zip(rows.clone()) {
                let taps = cubic_taps(number, row_factor, row_count);
                mix(taps, survey_rows.start, &mixed_layer, &mut mixed_row);
                for (x, out) in out.iter_mut().enumerate() {
                    let taps = cubic_taps(x, self.factors[0], survey_dims[0]);
                    mix(taps, 0, &mixed_row, std::slice::from_mut(out));
                }
            }
        });
        Ok(())
    }

    fn load(&self) -> Result<Image<D>> {
        self.ensure_memory()?;
        let mut samples = vec![0.0; self.dims.iter().product()];
        self.read_layers(0, &mut samples)?;
        Ok(Image::new(self.dims, samples, self.geometry.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::windows::Samples;

    /// Returns an image of the values of `value` at samples.
    fn image(dims: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Image<3> {
        let at = |i: usize| crate::geometry::grid_index::index_at(dims, i).map(|c| c as f64);
        let count = dims.iter().product();
        let samples = (0..count).map(|i| value(at(i)) as f32).collect();
        Image::new(dims, samples, Geometry::default())
    }

    #[test]
    fn parabolas_are_interpolated_exactly_and_samples_are_kept() {
        let dims = [9, 8, 7];
        let value = |p: [f64; 3]| 0.3 * p[0] * p[0] - p[1] * p[2] + 0.2 * p[2] * p[2] + p[1];
        let image = image(dims, value);
        let grid = FineGrid::new(ImageSource::InMemory(&image), [2, 4, 3]);
        let fine = grid.load().unwrap();
        assert_eq!(fine.dims(), [17, 29, 19]);
        for (i, &found) in fine.as_slice().iter().enumerate() {
            let at = crate::geometry::grid_index::index_at(fine.dims(), i);
            let place: [f64; 3] = std::array::from_fn(|k| at[k] as f64 / grid.factors[k] as f64);
            let is_inner = (0..3).all(|k| place[k] >= 1.0 && place[k] <= dims[k] as f64 - 2.0);
            let is_sample = place.iter().all(|p| p.fract() == 0.0);
            if is_inner || is_sample {
                assert!((f64::from(found) - value(place)).abs() < 1e-4, "{at:?}");
            }
        }
    }

    #[test]
    fn rows_that_are_read_alone_equal_those_of_the_whole_to_the_bit() {
        let image = image([7, 9, 11], |p| (p[0] * 1.7 + p[1] * p[2]).sin());
        let grid = FineGrid::new(ImageSource::InMemory(&image), [1, 3, 4]);
        let whole = grid.load().unwrap();
        let (row, layer) = (7, 7 * 25);
        for (first, count, rows) in [(0, 2, 3..9), (5, 7, 0..25), (39, 2, 24..25)] {
            let mut part = vec![0.0; count * rows.len() * row];
            grid.read_rows(first, rows.clone(), &mut part).unwrap();
            for (number, part) in part.chunks(rows.len() * row).enumerate() {
                let from = (first + number) * layer + rows.start * row;
                assert!(*part == whole.as_slice()[from..from + part.len()]);
            }
        }
    }

    #[test]
    fn the_period_is_that_of_layers_across_each_axis() {
        let cancel = &CancelToken::never();
        for vertical in 0..3 {
            let wave = |p: [f64; 3]| 2.0 + (std::f64::consts::TAU * p[vertical] / 12.0).sin();
            let image = image([48; 3], wave);
            let samples = Samples::in_memory(image.dims(), image.as_slice());
            let found = |max_lag| period(&samples, vertical, max_lag, cancel).unwrap();
            assert_eq!(found(20), Some(12.0), "{vertical}");
            assert_eq!(found(4), None, "{vertical}");
        }
    }

    #[test]
    fn points_between_traces_move_along_their_surface() {
        // The plane x = 5 + 0.25 (z - 10) in the survey, where z has 4 samples in place of one.
        let image = image([12, 6, 20], |_| 0.0);
        let grid = FineGrid::new(ImageSource::InMemory(&image), [1, 1, 4]);
        let mut points = Vec::new();
        for z in 0..grid.dims[2] {
            let x = 5.0 + 0.25 * (z as f32 / 4.0 - 10.0);
            let at = [x.round() as usize, 3, z];
            let normal = unit([1.0, 0.0, -0.25 / 4.0]);
            points.push(Candidate::new(grid.dims, at, 0, x - x.round(), normal, 1.0));
        }
        let found = grid.to_survey(&points);
        assert_eq!(found.len(), 20);
        for (z, c) in found.iter().enumerate() {
            let x = 5.0 + 0.25 * (z as f32 - 10.0);
            assert!((c.position[0] - x).abs() < 1e-5, "{z} {c:?}");
            assert_eq!(c.position[1..], [3.0, z as f32]);
            assert!((c.normal[2] / c.normal[0] + 0.25).abs() < 1e-5);
        }
    }
}
