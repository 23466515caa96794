//! An image in two-way time becomes one in depth, trace by trace.
//!
//! Samples in depth are evenly spaced, and as dense as samples in time are where these lie densest: no detail
//! is lost. They reach from the shallowest to the deepest that every trace reaches. Values between samples in
//! time are those of a cubic ([`ScalarField`]), within the range of the image; labels are those of the nearest.

use crate::parallel::prelude::*;
use ndarray::{ArrayD, Axis, Dimension, IxDyn, Zip};

use super::time_depth::TimeDepthCurve;
use super::velocity::VelocityModel;
use crate::error::cause;
use crate::image::{Geometry, Image, ScalarField};
use crate::memory;
use crate::{Error, Result};

/// How images on one grid in two-way time come to lie in depth.
#[derive(Debug, Clone)]
pub struct DepthConversion<const D: usize> {
    velocities: VelocityModel<D>,
    /// The grid in time.
    time_geometry: Geometry<D>,
    dims: [usize; D],
    /// The image axis along time.
    time_axis: usize,
    /// Two-way time in seconds of the first sample, and from there to the next.
    first_time: f64,
    time_step: f64,
    /// Where samples lie in depth.
    depth_geometry: Geometry<D>,
    /// Depth of the first sample, from there to the next, and how many there are.
    depth_sampling: (f64, f64),
    depth_count: usize,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// Where a trace begins and ends, and the least distance between its samples, in depth; all along the order
/// of its samples.
#[derive(Clone, Copy)]
struct TraceDepths {
    start: f64,
    end: f64,
    min_step: f64,
}

impl<const D: usize> DepthConversion<D> {
    /// Of `image` and all that lies on its grid, by velocities.
    ///
    /// # Errors
    /// [`Error::Image`] for an image that is not in two-way time, and where the velocities do not reach it or
    /// no depth is reached by every trace.
    pub fn new(image: &Image<D>, velocities: VelocityModel<D>) -> Result<Self> {
        let (time, dims) = (image.geometry.clone(), image.dims());
        let place = format!("velocity {}", velocities.name);
        let twt = time
            .two_way_time()
            .map_err(|no| no.to_error(place.clone()))?;
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(&place, problem, remedy)));
        let Some(along) = time.axis_along(twt.coordinate) else {
            let problem =
                "makes depth of upright traces, but no axis of the image runs straight along time";
            return refuse(problem.into(), "give an image in x, y and time");
        };
        let mut stretch = Self {
            time_axis: along,
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
        let present: Vec<[f64; D]> = (0..dims.iter().product::<usize>() / dims[along].max(1))
            .filter(|&lane| along != 0 || !image.missing.get(lane).is_some_and(|missing| *missing))
            .map(|lane| stretch.trace_start(lane))
            .collect();
        let far = |&start: &[f64; D]| {
            let mut index = start;
            index[along] = dims[along] as f64 - 1.0;
            [start, index].map(|index| stretch.time_geometry.to_physical(index))
        };
        let ends = present.iter().flat_map(far);
        let reach = stretch
            .velocities
            .check_coverage(ends, &stretch.time_geometry)?;
        let c = reach.coordinate;
        stretch.first_time = stretch.time_geometry.origin[c] * reach.seconds_per_unit;
        stretch.time_step = stretch.time_geometry.axes[along][c] * reach.seconds_per_unit;
        let extents: Vec<TraceDepths> = present
            .par_iter()
            .map(|&s| stretch.trace_depths(s))
            .collect();
        let down = stretch.time_step.signum();
        let from = extents
            .iter()
            .fold(f64::NEG_INFINITY, |most, e| most.max(down * e.start));
        let to = extents
            .iter()
            .fold(f64::INFINITY, |least, e| least.min(down * e.end));
        let step = extents
            .iter()
            .fold(f64::INFINITY, |least, e| least.min(e.min_step));
        if to - from < step {
            let problem = format!(
                "leaves no depth that every trace reaches: one begins at {:.1} m, another ends at {:.1} m",
                down * from,
                down * to
            );
            return refuse(problem, "give smoother velocities, or a part of the image");
        }
        // The last sample shall not be lost to rounding.
        stretch.depth_count = ((to - from) / step + 1e-6) as usize + 1;
        let whole: f64 = extents.iter().map(|e| (e.end - e.start).abs()).sum();
        let kept = extents.len() as f64 * (stretch.depth_count - 1) as f64 * step;
        stretch.depth_sampling = (down * from, down * step);
        let (depth, grows) = (&mut stretch.depth_geometry, reach.seconds_per_unit.signum());
        depth.origin[c] = grows * down * from;
        depth.axes[along][c] = grows * down * step;
        depth.names[along] = "depth".into();
        depth.units = std::array::from_fn(|_| "m".to_string());
        stretch.notes = reach.notes;
        stretch.notes.push(format!(
            "by {} to depth: {:.1} to {:.1} m in {} steps of {step:.3} m ({} samples in time); {:.1} % of the image is cut off, where not every trace reaches",
            stretch.velocities.name,
            down * from,
            down * (from + (stretch.depth_count - 1) as f64 * step),
            stretch.depth_count - 1,
            dims[along],
            (100.0 * (1.0 - kept / whole)).max(0.0)
        ));
        Ok(stretch)
    }

    /// The index of the first sample of a trace, these being numbered in memory order.
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
        let column = self.time_depth_curve(start);
        let depth = |i: usize| column.depth(self.first_time + i as f64 * self.time_step);
        let last = self.dims[self.time_axis] - 1;
        let apart = (0..last).map(|i| (depth(i + 1) - depth(i)).abs());
        TraceDepths {
            start: depth(0),
            end: depth(last),
            min_step: apart.fold(f64::INFINITY, f64::min),
        }
    }

    /// Checks that an image lies on the grid; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it does not.
    pub fn check(&self, dims: [usize; D], place: &str) -> Result<()> {
        if dims == self.dims {
            return Ok(());
        }
        let problem = format!(
            "is of {dims:?} samples, the image in time of {:?}",
            self.dims
        );
        let remedy =
            "give as many samples, in two-way time: they come to lie in depth as the image does";
        Err(Error::Image(cause(place, problem, remedy)))
    }

    /// An image on the grid, in depth; `labels` says that its values are not to be mixed.
    ///
    /// # Errors
    /// [`Error::Job`] if there is no memory for it.
    ///
    /// # Panics
    /// If it is not of as many samples: see [`Self::check`].
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
        // A cubic may swing beyond the samples; NaN stays what it is.
        let stats = image.stats();
        let within = |value: f32| match stats.min <= stats.max {
            true => value.clamp(stats.min, stats.max),
            false => value,
        };
        let axis = Axis(D - 1 - self.time_axis);
        let mut shape = image.samples.shape().to_vec();
        shape.remove(axis.index());
        let number = |at: IxDyn| (at.slice().iter().zip(&shape)).fold(0, |n, (i, len)| n * len + i);
        let numbers = ArrayD::from_shape_fn(shape.as_slice(), number);
        let (from, step) = self.depth_sampling;
        let last = (self.dims[self.time_axis] - 1) as f64;
        Zip::from(samples.lanes_mut(axis))
            .and(image.samples.lanes(axis))
            .and(&numbers)
            .par_for_each(|to, trace, &lane| {
                let column = self.time_depth_curve(self.trace_start(lane));
                let trace = ScalarField {
                    dims: [trace.len()],
                    step: [1.0],
                    samples: trace.to_vec(),
                };
                for (j, value) in to.into_iter().enumerate() {
                    let time = column.time(from + j as f64 * step);
                    let i = ((time - self.first_time) / self.time_step).clamp(0.0, last);
                    *value = match labels {
                        true => trace.samples[i.round() as usize],
                        false => within(trace.value([i]) as f32),
                    };
                }
            });
        let made = Image {
            labels: None,
            samples,
            geometry: self.depth_geometry.clone(),
            missing: Vec::new(),
            dead: Vec::new(),
        };
        // Traces that are missing are so at all depths; of other rows nobody knows.
        Ok(match self.time_axis {
            0 => made.with_missing(image.missing.clone()),
            _ => made,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples of a function of the world.
    fn sample_function<const D: usize>(
        dims: [usize; D],
        geometry: &Geometry<D>,
        value: impl Fn([f64; D]) -> f64,
    ) -> Image<D> {
        let at = |mut i: usize| {
            let index = dims.map(|n| {
                let k = i % n;
                i /= n;
                k as f64
            });
            value(geometry.to_physical(index)) as f32
        };
        let samples = (0..dims.iter().product()).map(at).collect();
        Image::new(dims, samples, geometry.clone())
    }

    /// Samples first where `down` says so, and upwards in time where it is negative.
    fn survey_geometry(first: bool, down: f64, step: [f64; 2]) -> Geometry<3> {
        let [apart, dt] = step;
        let time = [0.0, 0.0, down * dt];
        let lines = [[apart, 0.0, 0.0], [0.0, apart, 0.0]];
        let axes = match first {
            true => [time, lines[0], lines[1]],
            false => [lines[0], lines[1], time],
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
        let stretch = DepthConversion::new(image, VelocityModel::new(v, "v.vti").unwrap()).unwrap();
        (stretch.apply(image, false).unwrap(), stretch)
    }

    /// A wave in depth, seen in time, comes to lie where it was: in any order of axes, up or down.
    #[test]
    fn depth_comes_out_of_time_as_it_went_in() {
        for (first, down) in [(true, 1.0), (false, 1.0), (true, -1.0), (false, -1.0)] {
            let dims = |nt: usize| if first { [nt, 5, 4] } else { [5, 4, nt] };
            let law = |[x, _, t]: [f64; 3]| 1900.0 + 0.5 * (x - 5000.0) + 0.6 * t.abs();
            // Depth of time in ms, by hand; velocities begin at 400 ms.
            let depth = |[x, y, t]: [f64; 3]| {
                let (top, below) = (law([x, y, 400.0]), 1e-3 * (t.abs() - 400.0));
                0.5 * (0.4 * top + top * below + 300.0 * below * below)
            };
            let wave = |z: f64| 100.0 * (z / 14.0).sin();
            let image = survey_geometry(first, down, [12.5, 4.0]);
            let image = sample_function(dims(200), &image, |p| wave(depth(p)));
            // Time grows downwards in velocities, and falls in some images.
            let velocities = survey_geometry(first, 1.0, [40.0, 50.0]);
            let velocities = sample_function(
                if first { [25, 3, 3] } else { [3, 3, 25] },
                &velocities,
                law,
            );
            let (found, stretch) = convert_to_depth(&image, velocities);
            let geometry = &found.geometry;
            assert_eq!(geometry.units, ["m", "m", "m"]);
            let expected = sample_function(found.dims(), geometry, |p| wave(p[2].abs()));
            let along = if first { 0 } else { 2 };
            let (dims, mut off) = (found.dims(), 0.0f32);
            let stride: usize = dims[..along].iter().product();
            for (i, (a, b)) in found.as_slice().iter().zip(expected.as_slice()).enumerate() {
                // At its ends a trace has nothing beyond to bend towards.
                let deep = i / stride % dims[along];
                if (2..dims[along] - 2).contains(&deep) {
                    off = off.max((a - b).abs());
                }
            }
            // A wave is some 17 samples of 4 ms long; straight lines between them are 1.7 off.
            assert!(off < 0.4, "{first} {down} {off}");
            // As dense as in time at the top, and from the deepest top to the shallowest end.
            let step = geometry.axes[along][2];
            let least = 0.5 * 0.004 * (1900.0 + 0.6 * 402.0);
            assert!((step - down * least).abs() < 1e-3, "{step}");
            let top = depth([5050.0, 0.0, 400.0]);
            assert!((geometry.origin[2] - down * top).abs() < 1e-3);
            let last = geometry.origin[2].abs() + (found.dims()[along] - 1) as f64 * step.abs();
            let end = depth([5000.0, 0.0, 1196.0]);
            assert!(
                last <= end + 1e-3 && last > end - step.abs(),
                "{last} {end}"
            );
            assert!(
                stretch.notes[0].contains("% of the image is cut off"),
                "{:?}",
                stretch.notes
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
        // z = 500 m.
        let time = |x: f64| 1e3 * 2.0 * 500.0 / law([x, 0.0]);
        let pulse = |off: f64| (-off * off / 2.0).exp();
        let image = sample_function([41, 400], &geometry, |[x, t]| pulse((t - time(x)) / 6.0));
        let coarse = Geometry {
            axes: [[500.0, 0.0], [0.0, 400.0]],
            ..geometry.clone()
        };
        let (found, _) = convert_to_depth(&image, sample_function([3, 3], &coarse, law));
        let dims = found.dims();
        for x in 0..41 {
            let row = (0..dims[1]).map(|z| f64::from(found.as_slice()[x + 41 * z]));
            let (sum, moment) = (0..).zip(row).fold((0.0, 0.0), |(sum, moment), (z, v)| {
                (sum + v, moment + v * f64::from(z))
            });
            let depth = found.geometry.origin[1] + moment / sum * found.geometry.axes[1][1];
            // 2 m are a sample.
            assert!((depth - 500.0).abs() < 0.1, "{x} {depth}");
        }
        assert!((time(0.0) - time(1000.0)).abs() > 80.0);
    }

    #[test]
    fn a_constant_volume_does_what_the_number_does() {
        let geometry = survey_geometry(true, 1.0, [12.5, 4.0]);
        let image = sample_function([64, 5, 4], &geometry, |p| {
            (p[0] + 3.0 * p[1] + p[2] / 7.0).sin()
        });
        let coarse = survey_geometry(true, 1.0, [50.0, 100.0]);
        let (found, stretch) =
            convert_to_depth(&image, sample_function([3, 2, 2], &coarse, |_| 2400.0));
        let depth = geometry.to_depth(2400.0).unwrap().0;
        assert_eq!(found.dims(), image.dims());
        for k in 0..3 {
            for c in 0..3 {
                assert!((found.geometry.axes[k][c] - depth.axes[k][c]).abs() < 1e-9);
            }
            assert!((found.geometry.origin[k] - depth.origin[k]).abs() < 1e-9);
        }
        let pairs = found.as_slice().iter().zip(image.as_slice());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(
            stretch.notes[0].contains("0.0 % of the image"),
            "{:?}",
            stretch.notes
        );
    }

    #[test]
    fn labels_stay_labels_and_missing_traces_missing() {
        let geometry = survey_geometry(true, 1.0, [12.5, 4.0]);
        let labels = |p: [f64; 3]| f64::from((p[2] > 600.0) as u8 + 3 * (p[2] > 650.0) as u8);
        let image = sample_function([100, 5, 4], &geometry, labels);
        let mut missing = vec![false; 20];
        missing[7] = true;
        let image = image.with_missing(missing.clone());
        let coarse = survey_geometry(true, 1.0, [50.0, 100.0]);
        let law = |p: [f64; 3]| 2000.0 + p[2] + 4.0 * (p[0] - 5000.0);
        let velocities =
            VelocityModel::new(sample_function([5, 2, 2], &coarse, law), "v.vti").unwrap();
        let stretch = DepthConversion::new(&image, velocities).unwrap();
        let found = stretch.apply(&image, true).unwrap();
        assert!(found.as_slice().iter().all(|v| [0.0, 1.0, 4.0].contains(v)));
        assert_eq!(found.missing, missing);
        let mixed = stretch.apply(&image, false).unwrap();
        assert!(mixed.as_slice().iter().any(|v| v.fract() != 0.0));
        // A cubic does not swing beyond the image's range.
        assert!(mixed.as_slice().iter().all(|v| (0.0..=4.0).contains(v)));
        assert!(stretch.check([100, 5, 5], "b.npy").is_err());
    }

    #[test]
    fn traces_without_a_common_depth_are_refused() {
        let geometry = survey_geometry(true, 1.0, [100.0, 4.0]);
        let image = sample_function([10, 3, 3], &geometry, |p| p[0]);
        let law = |p: [f64; 3]| if p[0] < 5050.0 { 500.0 } else { 5000.0 };
        let velocities =
            sample_function([2, 3, 3], &survey_geometry(true, 1.0, [100.0, 36.0]), law);
        let velocities = VelocityModel::new(velocities, "v.vti").unwrap();
        let said = DepthConversion::new(&image, velocities)
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("velocity v.vti: leaves no depth that every trace reaches"),
            "{said}"
        );
    }
}
