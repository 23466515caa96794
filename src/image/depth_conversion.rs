//! Converts an image from two-way time to depth, trace by trace.
//!
//! Samples in depth are evenly spaced, at the smallest distance that samples in time have in depth,
//! so that no detail is lost. They cover the depth range that all traces have in common. Values
//! between samples in time come from cubic interpolation ([`ScalarField`]), clamped to the range of
//! the image; labels are those of the nearest sample.

use crate::parallel::prelude::*;
use ndarray::{ArrayD, Axis, Dimension, IxDyn, Zip};

use super::time_depth::TimeDepthCurve;
use super::velocity::{VelocityModel, read_velocities};
use crate::error::cause;
use crate::image::formats::ReadImage;
use crate::image::{Geometry, Image, Modality, ScalarField};
use crate::memory;
use crate::option_text::NumberOrFile;
use crate::{Error, Result};

/// Mapping of images on one grid in two-way time to a grid in depth.
#[derive(Debug, Clone)]
pub struct DepthConversion<const D: usize> {
    velocities: VelocityModel<D>,
    /// The grid in time.
    time_geometry: Geometry<D>,
    dims: [usize; D],
    /// The image axis along time.
    time_axis: usize,
    /// Two-way time of the first sample, and the step to the next sample, in seconds.
    first_time: f64,
    time_step: f64,
    /// The grid in depth.
    depth_geometry: Geometry<D>,
    /// Depth of the first sample and the step to the next sample, in the unit of the geometry in depth.
    depth_sampling: (f64, f64),
    depth_count: usize,
    /// Messages for the user.
    pub notes: Vec<String>,
}

/// Depths of the first and last sample of a trace, and the smallest distance in depth between its
/// samples, all in the order of its samples.
#[derive(Clone, Copy)]
struct TraceDepths {
    start: f64,
    end: f64,
    min_step: f64,
}

/// Returns the smallest and the largest depth that all traces cover, times the `direction` of the
/// samples (1 or -1), and the smallest step of any trace.
fn common_depths(traces: &[TraceDepths], direction: f64) -> [f64; 3] {
    let everything = [f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY];
    traces.iter().fold(everything, |[start, end, step], trace| {
        [
            start.max(direction * trace.start),
            end.min(direction * trace.end),
            step.min(trace.min_step),
        ]
    })
}

impl<const D: usize> DepthConversion<D> {
    /// Creates the conversion for `image` and for all images on the same grid, with the given
    /// velocities.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the image is not in two-way time, the velocities do not cover
    /// it, or the traces have no depth range in common.
    pub fn new(image: &Image<D>, velocities: VelocityModel<D>) -> Result<Self> {
        let (time, dims) = (image.geometry.clone(), image.dims());
        let place = format!("velocity {}", velocities.name);
        let twt = time
            .two_way_time()
            .map_err(|reason| reason.to_error(place.clone()))?;
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(&place, problem, remedy)));
        let Some(time_axis) = time.axis_along(twt.coordinate) else {
            let problem = "converts vertical traces to depth, but no axis of the image is parallel to the time axis";
            return refuse(problem.into(), "give an image in x, y and time");
        };
        let mut conversion = Self {
            time_axis,
            first_time: 0.0,
            time_step: 0.0,
            depth_geometry: time.clone(),
            depth_sampling: (0.0, 0.0),
            depth_count: 0,
            notes: Vec::new(),
            velocities,
            time_geometry: time,
            dims,
        };
        let trace_starts = conversion.trace_starts(&image.missing);
        let trace_ends = |&start: &[f64; D]| {
            let mut index = start;
            index[time_axis] = dims[time_axis] as f64 - 1.0;
            [start, index].map(|index| conversion.time_geometry.to_physical(index))
        };
        let ends = trace_starts.iter().flat_map(trace_ends);
        let coverage = conversion
            .velocities
            .check_coverage(ends, &conversion.time_geometry)?;
        let c = coverage.coordinate;
        conversion.first_time = conversion.time_geometry.origin[c] * coverage.seconds_per_unit;
        conversion.time_step =
            conversion.time_geometry.axes[time_axis][c] * coverage.seconds_per_unit;
        let extents: Vec<TraceDepths> = trace_starts
            .par_iter()
            .map(|&s| conversion.trace_depths(s))
            .collect();
        let direction = conversion.time_step.signum();
        let [start, end, step] = common_depths(&extents, direction);
        let unit = coverage.depth_unit;
        if end - start < step {
            let problem = format!(
                "leaves no depth range that all traces cover: one begins at {:.1} {unit}, another ends at {:.1} {unit}",
                direction * start,
                direction * end
            );
            return refuse(problem, "give smoother velocities, or a part of the image");
        }
        // The small constant keeps rounding from removing the last sample.
        conversion.depth_count = ((end - start) / step + 1e-6) as usize + 1;
        let total_extent: f64 = extents.iter().map(|e| (e.end - e.start).abs()).sum();
        let kept_extent = extents.len() as f64 * (conversion.depth_count - 1) as f64 * step;
        conversion.depth_sampling = (direction * start, direction * step);
        let (depth, sign) = (
            &mut conversion.depth_geometry,
            coverage.seconds_per_unit.signum(),
        );
        depth.origin[c] = sign * direction * start;
        depth.axes[time_axis][c] = sign * direction * step;
        depth.names[time_axis] = "depth".into();
        depth.units = std::array::from_fn(|_| unit.to_string());
        conversion.notes = coverage.notes;
        conversion.notes.push(format!(
            "converted to depth with {}: {:.1} to {:.1} {unit} in {} steps of {step:.3} {unit} ({} samples in time); {:.1} % of the image is cut off, where not all traces have samples",
            conversion.velocities.name,
            direction * start,
            direction * (start + (conversion.depth_count - 1) as f64 * step),
            conversion.depth_count - 1,
            dims[time_axis],
            (100.0 * (1.0 - kept_extent / total_extent)).max(0.0)
        ));
        Ok(conversion)
    }

    /// Returns the velocities of the conversion.
    pub fn velocities(&self) -> &VelocityModel<D> {
        &self.velocities
    }

    /// Returns the index of the first sample of each trace, except for rows of samples that are
    /// `missing`, if these are the traces.
    fn trace_starts(&self, missing: &[bool]) -> Vec<[f64; D]> {
        let count = self.dims.iter().product::<usize>() / self.dims[self.time_axis].max(1);
        let is_missing = |lane: usize| self.time_axis == 0 && missing.get(lane) == Some(&true);
        let lanes = (0..count).filter(|&lane| !is_missing(lane));
        lanes.map(|lane| self.trace_start(lane)).collect()
    }

    /// Returns the index of the first sample of a trace. Traces are numbered in memory order.
    fn trace_start(&self, mut lane: usize) -> [f64; D] {
        let mut index = [0.0; D];
        for k in (0..D).filter(|&k| k != self.time_axis) {
            index[k] = (lane % self.dims[k]) as f64;
            lane /= self.dims[k];
        }
        index
    }

    fn time_depth_curve(&self, start: [f64; D]) -> TimeDepthCurve {
        self.velocities
            .time_depth_curve(self.time_geometry.to_physical(start))
    }

    fn trace_depths(&self, start: [f64; D]) -> TraceDepths {
        let curve = self.time_depth_curve(start);
        let depth = |i: usize| curve.depth(self.first_time + i as f64 * self.time_step);
        let last = self.dims[self.time_axis] - 1;
        let steps = (0..last).map(|i| (depth(i + 1) - depth(i)).abs());
        TraceDepths {
            start: depth(0),
            end: depth(last),
            min_step: steps.fold(f64::INFINITY, f64::min),
        }
    }

    /// Checks that an image of dimensions `dims` is on this grid; `place` names the image in
    /// errors.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the dimensions differ.
    pub fn check(&self, dims: [usize; D], place: &str) -> Result<()> {
        if dims == self.dims {
            return Ok(());
        }
        let problem = format!(
            "has {dims:?} samples, but the image in time has {:?}",
            self.dims
        );
        let remedy = "give an image on the same grid in two-way time; it is converted to depth like the image";
        Err(Error::Image(cause(place, problem, remedy)))
    }

    /// Converts an image on the grid to depth. Set `labels` if its values must not be interpolated.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if there is not enough memory.
    ///
    /// # Panics
    /// Panics if the image has other dimensions than the grid; see [`Self::check`].
    pub fn apply(&self, image: &Image<D>, labels: bool) -> Result<Image<D>> {
        assert_eq!(image.dims(), self.dims, "an image on the grid");
        let mut dims = self.dims;
        dims[self.time_axis] = self.depth_count;
        memory::ensure_available(
            "the image in depth",
            4.0 * dims.iter().map(|&n| n as f64).product::<f64>(),
            format!("{dims:?} samples"),
            "give a part of the image",
        )?;
        let shape: Vec<usize> = dims.iter().rev().copied().collect();
        let mut samples = ArrayD::<f32>::zeros(shape);
        // Cubic interpolation can overshoot the range of the samples. A range without finite
        // samples is left alone, so that NaN stays NaN.
        let stats = image.stats();
        let clamp_to_range = |value: f32| {
            if stats.min <= stats.max {
                value.clamp(stats.min, stats.max)
            } else {
                value
            }
        };
        let axis = Axis(D - 1 - self.time_axis);
        let mut shape = image.samples.shape().to_vec();
        shape.remove(axis.index());
        let trace_number =
            |index: IxDyn| (index.slice().iter().zip(&shape)).fold(0, |n, (i, len)| n * len + i);
        let trace_numbers = ArrayD::from_shape_fn(shape.as_slice(), trace_number);
        let (first_depth, step) = self.depth_sampling;
        let last = (self.dims[self.time_axis] - 1) as f64;
        Zip::from(samples.lanes_mut(axis))
            .and(image.samples.lanes(axis))
            .and(&trace_numbers)
            .par_for_each(|output, trace, &lane| {
                let curve = self.time_depth_curve(self.trace_start(lane));
                let trace = ScalarField {
                    dims: [trace.len()],
                    step: [1.0],
                    samples: trace.to_vec(),
                };
                for (j, value) in output.into_iter().enumerate() {
                    let time = curve.time(first_depth + j as f64 * step);
                    let i = ((time - self.first_time) / self.time_step).clamp(0.0, last);
                    *value = if labels {
                        trace.samples[i.round() as usize]
                    } else {
                        clamp_to_range(trace.value([i]) as f32)
                    };
                }
            });
        let converted = Image {
            labels: None,
            label_names: image.label_names.clone(),
            samples,
            geometry: self.depth_geometry.clone(),
            missing: Vec::new(),
            dead: Vec::new(),
        };
        // A missing trace is missing at all depths. Missing rows along other axes have no
        // counterpart in depth.
        Ok(match self.time_axis {
            0 => converted.with_missing(image.missing.clone()),
            _ => converted,
        })
    }
}

/// Converts an image to depth if a velocity is given. Returns the image, and the conversion if the
/// image was resampled. Values of an image with `is_labels` are not interpolated.
///
/// # Errors
/// Returns the errors of reading velocities, and [`Error::Image`] for velocities that do not fit
/// the image.
pub(crate) fn image_in_depth<const D: usize>(
    mut image: Image<D>,
    velocity: Option<&NumberOrFile>,
    is_labels: bool,
    read: ReadImage<'_>,
) -> Result<(Image<D>, Option<DepthConversion<D>>)> {
    match velocity {
        None => Ok((image, None)),
        Some(NumberOrFile::Constant(velocity)) => {
            image.geometry = image.geometry.to_depth(*velocity)?.0;
            Ok((image, None))
        }
        Some(NumberOrFile::File(path)) => {
            let dims = image.dims();
            let velocities = read_velocities(path, &image.geometry, |volume| volume == dims, read)?;
            let conversion = DepthConversion::new(&image, velocities)?;
            let is_labels = is_labels || image.label_evidence(Modality::Survey).is_some();
            Ok((conversion.apply(&image, is_labels)?, Some(conversion)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::grid_index::index_at;

    /// Returns the geometry of a survey. Samples are along the first axis if `time_first` is set;
    /// times are negative if `down` is -1.
    fn survey_geometry(time_first: bool, down: f64, step: [f64; 2]) -> Geometry<3> {
        let [line_spacing, dt] = step;
        let time = [0.0, 0.0, down * dt];
        let lines = [[line_spacing, 0.0, 0.0], [0.0, line_spacing, 0.0]];
        let axes = if time_first {
            [time, lines[0], lines[1]]
        } else {
            [lines[0], lines[1], time]
        };
        Geometry {
            origin: [5000.0, 7000.0, down * 400.0],
            axes,
            units: ["m", "m", "ms"].map(String::from),
            ..Geometry::default()
        }
    }

    fn convert_to_depth<const D: usize>(
        image: &Image<D>,
        v: Image<D>,
    ) -> (Image<D>, DepthConversion<D>) {
        let conversion =
            DepthConversion::new(image, VelocityModel::new(v, "v.vti").unwrap()).unwrap();
        (conversion.apply(image, false).unwrap(), conversion)
    }

    /// A wave in depth, imaged in time, is recovered for both orders of axes and both signs of
    /// time.
    #[test]
    fn a_wave_in_depth_is_recovered_from_its_image_in_time() {
        for (time_first, down) in [(true, 1.0), (false, 1.0), (true, -1.0), (false, -1.0)] {
            let dims = |nt: usize| if time_first { [nt, 5, 4] } else { [5, 4, nt] };
            let law = |[x, _, t]: [f64; 3]| 1900.0 + 0.5 * (x - 5000.0) + 0.6 * t.abs();
            // Depth in metres from time in milliseconds, integrated by hand; velocities begin at
            // 400 ms.
            let depth = |[x, y, t]: [f64; 3]| {
                let (top, below) = (law([x, y, 400.0]), 1e-3 * (t.abs() - 400.0));
                0.5 * (0.4 * top + top * below + 300.0 * below * below)
            };
            let wave = |z: f64| 100.0 * (z / 14.0).sin();
            let image = survey_geometry(time_first, down, [12.5, 4.0]);
            let image = Image::from_fn(dims(200), image, |p| wave(depth(p)));
            // Times increase downwards in the velocities, and decrease in half of the images.
            let velocities = survey_geometry(time_first, 1.0, [40.0, 50.0]);
            let dims = if time_first { [25, 3, 3] } else { [3, 3, 25] };
            let velocities = Image::from_fn(dims, velocities, law);
            let (converted, conversion) = convert_to_depth(&image, velocities);
            let geometry = &converted.geometry;
            assert_eq!(geometry.units, ["m", "m", "m"]);
            let expected = Image::from_fn(converted.dims(), geometry.clone(), |p| wave(p[2].abs()));
            let along = if time_first { 0 } else { 2 };
            let (dims, mut max_error) = (converted.dims(), 0.0f32);
            for (i, (a, b)) in converted
                .as_slice()
                .iter()
                .zip(expected.as_slice())
                .enumerate()
            {
                // At its ends a trace lacks neighbours for the cubic interpolation.
                let depth_index = index_at(dims, i)[along];
                if (2..dims[along] - 2).contains(&depth_index) {
                    max_error = max_error.max((a - b).abs());
                }
            }
            // One period of the wave is about 17 samples of 4 ms; linear interpolation would be off
            // by 1.7.
            assert!(max_error < 0.4, "{time_first} {down} {max_error}");
            // The spacing in depth is that of the samples in time at the top, and the range is from
            // the deepest top to the shallowest end.
            let step = geometry.axes[along][2];
            let min_step = 0.5 * 0.004 * (1900.0 + 0.6 * 402.0);
            assert!((step - down * min_step).abs() < 1e-3, "{step}");
            let top = depth([5050.0, 0.0, 400.0]);
            assert!((geometry.origin[2] - down * top).abs() < 1e-3);
            let last = geometry.origin[2].abs() + (converted.dims()[along] - 1) as f64 * step.abs();
            let end = depth([5000.0, 0.0, 1196.0]);
            assert!(
                last <= end + 1e-3 && last > end - step.abs(),
                "{last} {end}"
            );
            assert!(
                conversion.notes[0].contains("% of the image is cut off"),
                "{:?}",
                conversion.notes
            );
        }
    }

    /// A plane that dips in time under velocities that change across is flat in depth.
    #[test]
    fn a_plane_that_dips_in_time_is_flat_in_depth() {
        let geometry = Geometry::<2> {
            units: ["m", "ms"].map(String::from),
            ..Geometry::with_spacing([0.0; 2], [25.0, 2.0])
        };
        let law = |[x, _]: [f64; 2]| 2000.0 + 0.4 * x;
        // The reflector lies at z = 500 m.
        let time = |x: f64| 1e3 * 2.0 * 500.0 / law([x, 0.0]);
        let pulse = |off: f64| (-off * off / 2.0).exp();
        let image = Image::from_fn([41, 400], geometry.clone(), |[x, t]| {
            pulse((t - time(x)) / 6.0)
        });
        let coarse = Geometry {
            axes: [[500.0, 0.0], [0.0, 400.0]],
            ..geometry.clone()
        };
        let (converted, _) = convert_to_depth(&image, Image::from_fn([3, 3], coarse, law));
        let dims = converted.dims();
        for x in 0..41 {
            let row = (0..dims[1]).map(|z| f64::from(converted.as_slice()[x + 41 * z]));
            let (sum, moment) = (0..).zip(row).fold((0.0, 0.0), |(sum, moment), (z, v)| {
                (sum + v, moment + v * f64::from(z))
            });
            let depth = converted.geometry.origin[1] + moment / sum * converted.geometry.axes[1][1];
            // One sample is 2 m.
            assert!((depth - 500.0).abs() < 0.1, "{x} {depth}");
        }
        assert!((time(0.0) - time(1000.0)).abs() > 80.0);
    }

    #[test]
    fn a_constant_velocity_volume_equals_one_velocity() {
        let geometry = survey_geometry(true, 1.0, [12.5, 4.0]);
        let image = Image::from_fn([64, 5, 4], geometry.clone(), |p| {
            (p[0] + 3.0 * p[1] + p[2] / 7.0).sin()
        });
        let coarse = survey_geometry(true, 1.0, [50.0, 100.0]);
        let (converted, conversion) =
            convert_to_depth(&image, Image::from_fn([3, 2, 2], coarse, |_| 2400.0));
        let depth = geometry.to_depth(2400.0).unwrap().0;
        assert_eq!(converted.dims(), image.dims());
        for k in 0..3 {
            for c in 0..3 {
                assert!((converted.geometry.axes[k][c] - depth.axes[k][c]).abs() < 1e-9);
            }
            assert!((converted.geometry.origin[k] - depth.origin[k]).abs() < 1e-9);
        }
        let pairs = converted.as_slice().iter().zip(image.as_slice());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(
            conversion.notes[0].contains("0.0 % of the image"),
            "{:?}",
            conversion.notes
        );
    }

    #[test]
    fn labels_stay_labels_and_missing_traces_missing() {
        let geometry = survey_geometry(true, 1.0, [12.5, 4.0]);
        let labels = |p: [f64; 3]| f64::from((p[2] > 600.0) as u8 + 3 * (p[2] > 650.0) as u8);
        let image = Image::from_fn([100, 5, 4], geometry.clone(), labels);
        let mut missing = vec![false; 20];
        missing[7] = true;
        let image = image.with_missing(missing.clone());
        let coarse = survey_geometry(true, 1.0, [50.0, 100.0]);
        let law = |p: [f64; 3]| 2000.0 + p[2] + 4.0 * (p[0] - 5000.0);
        let velocities =
            VelocityModel::new(Image::from_fn([5, 2, 2], coarse, law), "v.vti").unwrap();
        let conversion = DepthConversion::new(&image, velocities).unwrap();
        let converted = conversion.apply(&image, true).unwrap();
        assert!(
            converted
                .as_slice()
                .iter()
                .all(|v| [0.0, 1.0, 4.0].contains(v))
        );
        assert_eq!(converted.missing, missing);
        let mixed = conversion.apply(&image, false).unwrap();
        assert!(mixed.as_slice().iter().any(|v| v.fract() != 0.0));
        // The clamp keeps cubic interpolation within the range of the image.
        assert!(mixed.as_slice().iter().all(|v| (0.0..=4.0).contains(v)));
        assert!(conversion.check([100, 5, 5], "b.npy").is_err());
    }

    #[test]
    fn traces_without_a_common_depth_are_refused() {
        let geometry = survey_geometry(true, 1.0, [100.0, 4.0]);
        let image = Image::from_fn([10, 3, 3], geometry.clone(), |p| p[0]);
        let law = |p: [f64; 3]| if p[0] < 5050.0 { 500.0 } else { 5000.0 };
        let velocities = Image::from_fn([2, 3, 3], survey_geometry(true, 1.0, [100.0, 36.0]), law);
        let velocities = VelocityModel::new(velocities, "v.vti").unwrap();
        let message = DepthConversion::new(&image, velocities)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("velocity v.vti: leaves no depth range that all traces cover"),
            "{message}"
        );
    }
}
