//! Interval velocities on a grid of their own in two-way time, and the check that they cover an
//! image.
//!
//! Velocities are interpolated linearly between samples, horizontally and in time. Beyond the grid
//! they are those of the nearest sample.

use std::path::Path;

use super::time::{MAX_VELOCITY, MIN_VELOCITY};
use super::time_depth::TimeDepthCurve;
use crate::error::cause;
use crate::geometry::grid_index::{for_each_corner, index_at};
use crate::image::formats::{InputOptions, ReadImage};
use crate::image::{Geometry, Image};
use crate::{Error, Result, memory};

/// A volume (a section in 2-D) of interval velocities in m/s on a grid of its own in two-way time.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityModel<const D: usize> {
    /// Name in errors and notes.
    pub name: String,
    /// Positive samples, in units of depth per second. Time runs along axis 0, and only along this
    /// axis.
    image: Image<D>,
    /// Index of the physical coordinate that is time.
    coordinate: usize,
    /// Seconds per unit of time, negative if times decrease downwards.
    seconds_per_unit: f64,
    /// Unit of the other coordinates, in which depth is, too.
    depth_unit: &'static str,
}

/// Relation between the velocities and some positions in two-way time.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityCoverage {
    /// Index of the coordinate of the positions that is time.
    pub coordinate: usize,
    /// Seconds per unit of that coordinate, negative if times below the surface are negative, as
    /// heights would be.
    pub seconds_per_unit: f64,
    /// Unit of the other coordinates, in which depth is, too.
    pub depth_unit: &'static str,
    /// Messages for the user.
    pub notes: Vec<String>,
}

impl<const D: usize> VelocityModel<D> {
    /// Creates a model from an image of velocities; `name` identifies it in errors.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] unless the image has one axis along time and all velocities are
    /// positive.
    pub fn new(image: Image<D>, name: &str) -> Result<Self> {
        let refuse = |problem: String, remedy: &str| Error::Image(cause(name, problem, remedy));
        let geometry = &image.geometry;
        let time = geometry.two_way_time().map_err(|reason| {
            refuse(
                format!("does not say where its velocities lie in two-way time: {}", reason.problem),
                "give velocities over x and y in m (or both in ft) and time in s or ms; atomesh convert makes such an image from an \
                 array without geometry (--axes, --spacing, --origin, --unit m,m,ms)",
            )
        })?;
        let time_axis = geometry.axis_along(time.coordinate);
        let (Some(along), true) = (time_axis, geometry.determinant() != 0.0) else {
            let problem = "has no axis that runs straight along time".to_string();
            return Err(refuse(
                problem,
                "give velocities on a grid of upright traces",
            ));
        };
        // Traces that a survey lacks take the velocities of the nearest trace.
        let image = image.with_missing_filled().unwrap_or(image);
        check_velocities(&image, name)?;
        let mut image = with_axis_first(image, along)?;
        if time.depth_unit != "m" {
            let factor = time.depth_units_per_metre();
            let scaled = |v: f32| (f64::from(v) * factor) as f32;
            image.samples.mapv_inplace(scaled);
        }
        let times = corners(&image).map(|p| p[time.coordinate]);
        Ok(Self {
            name: name.to_string(),
            coordinate: time.coordinate,
            seconds_per_unit: time.seconds_per_unit * downward_sign(times),
            depth_unit: time.depth_unit,
            image,
        })
    }

    /// Returns depth as a function of time at a physical position. The time of the position is
    /// ignored.
    pub fn time_depth_curve(&self, position: [f64; D]) -> TimeDepthCurve {
        let mut index = self.sample_index(position);
        index[0] = 0.0;
        let samples = self.image.as_slice();
        let mut velocity = vec![0.0; self.image.dims()[0]];
        for_each_corner(
            self.image.dims(),
            index,
            |t| t,
            |first, weight: f64| {
                for (sum, &v) in velocity.iter_mut().zip(&samples[first..]) {
                    *sum += weight * f64::from(v);
                }
            },
        );
        let geometry = &self.image.geometry;
        let first = geometry.origin[self.coordinate] * self.seconds_per_unit;
        let step = geometry.axes[0][self.coordinate] * self.seconds_per_unit;
        TimeDepthCurve::new(first, step, velocity)
    }

    /// Returns the sample index of a position.
    fn sample_index(&self, position: [f64; D]) -> [f64; D] {
        self.image.geometry.to_index(position).unwrap_or([0.0; D])
    }

    /// Checks that the velocities and some positions in the world of `geometry` overlap. Times may
    /// increase downwards in one and decrease in the other.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if all positions are horizontally outside the velocity grid, or
    /// all are above or below it.
    pub fn check_coverage(
        &self,
        positions: impl Iterator<Item = [f64; D]> + Clone,
        geometry: &Geometry<D>,
    ) -> Result<VelocityCoverage> {
        let time = geometry
            .two_way_time()
            .map_err(|reason| reason.to_error(format!("velocity {}", self.name)))?;
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(&self.name, problem, remedy)));
        if self.coordinate != time.coordinate {
            let problem = "has time in another coordinate than the image".into();
            return refuse(
                problem,
                "give velocities with coordinates in the same order",
            );
        }
        if self.depth_unit != time.depth_unit {
            let problem = format!(
                "has x and y in {}, the image in {}",
                self.depth_unit, time.depth_unit
            );
            return refuse(problem, "give velocities with coordinates in the same unit");
        }
        let seconds =
            time.seconds_per_unit * downward_sign(positions.clone().map(|p| p[time.coordinate]));
        let dims = self.image.dims();
        let (mut count, mut outside_count) = (0usize, 0usize);
        let mut positions_box = BoundingBox::empty();
        for mut position in positions {
            position[self.coordinate] *= seconds / self.seconds_per_unit;
            positions_box.add(position);
            let index = self.sample_index(position);
            // A single trace is valid everywhere.
            let is_outside =
                |k: usize| dims[k] > 1 && !(-0.5..=dims[k] as f64 - 0.5).contains(&index[k]);
            count += 1;
            outside_count += usize::from((1..D).any(is_outside));
        }
        let mut velocity_box = BoundingBox::empty();
        corners(&self.image).for_each(|p| velocity_box.add(p));
        // Time ranges downwards, in the unit of the velocities.
        let [
            [velocity_start, velocity_end],
            [position_start, position_end],
        ] = [&velocity_box, &positions_box].map(|bounds| {
            let ends = [bounds.min, bounds.max].map(|p| p[self.coordinate].abs());
            [ends[0].min(ends[1]), ends[0].max(ends[1])]
        });
        if outside_count == count
            || (dims[0] > 1 && (velocity_start > position_end || position_start > velocity_end))
        {
            let unit = &self.image.geometry.units[self.coordinate];
            let problem = format!(
                "lies elsewhere: its velocities cover {velocity_box}, the image covers {positions_box} (time in {unit})"
            );
            return refuse(
                problem,
                "give velocities of the survey, in the same coordinates",
            );
        }
        let mut notes = Vec::new();
        if outside_count > 0 {
            notes.push(format!(
                "{}: {:.0} % of the positions lie outside the velocity grid and take the nearest velocities",
                self.name,
                (100.0 * outside_count as f64 / count as f64).max(1.0)
            ));
        }
        let step = (velocity_end - velocity_start) / (dims[0].max(2) - 1) as f64;
        if dims[0] > 1 && position_end > velocity_end + step {
            let unit = &self.image.geometry.units[self.coordinate];
            notes.push(format!(
                "{}: velocities end at {velocity_end} {unit}, so the last one of each trace is used down to {position_end} {unit}",
                self.name
            ));
        }
        Ok(VelocityCoverage {
            coordinate: time.coordinate,
            seconds_per_unit: seconds,
            depth_unit: time.depth_unit,
            notes,
        })
    }
}

/// Returns the corners of an image in physical coordinates.
fn corners<const D: usize>(image: &Image<D>) -> impl Iterator<Item = [f64; D]> {
    let last = image.dims().map(|n| n as f64 - 1.0);
    let index = move |corner: usize| {
        std::array::from_fn(|k| if corner >> k & 1 == 1 { last[k] } else { 0.0 })
    };
    (0..1usize << D).map(move |corner| image.geometry.to_physical(index(corner)))
}

/// Returns the sign of times below the surface: 1 if times increase downwards, -1 if they decrease
/// as heights do.
fn downward_sign(times: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = times.fold((0.0f64, 0.0f64), |(a, b), t| (a.min(t), b.max(t)));
    if -low > high { -1.0 } else { 1.0 }
}

/// Checks that all samples are velocities.
fn check_velocities<const D: usize>(image: &Image<D>, name: &str) -> Result<()> {
    let refuse = |problem: String, remedy: &str| Err(Error::Image(cause(name, problem, remedy)));
    let samples = image.as_slice();
    let is_invalid = |v: &f32| !(v.is_finite() && *v > 0.0);
    let count = samples.iter().filter(|v| is_invalid(v)).count();
    if let Some(first) = samples.iter().position(is_invalid) {
        let index = index_at(image.dims(), first);
        let problem = format!(
            "{count} of {} velocities are not positive numbers; that at index {index:?} (x first) is {}",
            samples.len(),
            samples[first]
        );
        return refuse(problem, "give interval velocities in m/s everywhere");
    }
    if samples.is_empty() {
        return refuse("holds no velocities".into(), "give an image with samples");
    }
    let max = samples.iter().fold(0.0f32, |max, v| max.max(*v));
    if f64::from(max) < MIN_VELOCITY {
        let problem = format!("holds at most {max} m/s, which is too slow for rock or water");
        return refuse(problem, "give velocities in m/s, not in km/s");
    }
    let min = samples.iter().fold(f32::MAX, |min, v| min.min(*v));
    if f64::from(min) > MAX_VELOCITY {
        let problem = format!("holds at least {min} m/s, which is too fast for rock");
        return refuse(problem, "give velocities in m/s, not in ft/s");
    }
    Ok(())
}

/// Returns the image with axis `k` exchanged with the first axis.
fn with_axis_first<const D: usize>(image: Image<D>, k: usize) -> Result<Image<D>> {
    if k == 0 {
        return Ok(image);
    }
    let dims = image.dims();
    memory::ensure_available(
        "velocities",
        4.0 * image.samples.len() as f64,
        format!("ordering {dims:?} velocities by traces"),
        "give them on a coarser grid",
    )?;
    let Image {
        mut samples,
        mut geometry,
        ..
    } = image;
    samples.swap_axes(D - 1, D - 1 - k);
    geometry.axes.swap(0, k);
    geometry.names.swap(0, k);
    Ok(Image {
        labels: None,
        label_names: Vec::new(),
        samples: samples.as_standard_layout().into_owned(),
        geometry,
        missing: Vec::new(),
        dead: Vec::new(),
    })
}

/// Axis-aligned bounding box of positions.
struct BoundingBox<const D: usize> {
    min: [f64; D],
    max: [f64; D],
}

impl<const D: usize> BoundingBox<D> {
    fn empty() -> Self {
        Self {
            min: [f64::INFINITY; D],
            max: [f64::NEG_INFINITY; D],
        }
    }

    fn add(&mut self, p: [f64; D]) {
        for k in 0..D {
            self.min[k] = self.min[k].min(p[k]);
            self.max[k] = self.max[k].max(p[k]);
        }
    }
}

impl<const D: usize> std::fmt::Display for BoundingBox<D> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for k in 0..D {
            let comma = if k > 0 { ", " } else { "" };
            let rounded = |x: f64| (10.0 * x).round() / 10.0;
            write!(
                f,
                "{comma}{} to {}",
                rounded(self.min[k]),
                rounded(self.max[k])
            )?;
        }
        Ok(())
    }
}

/// Reads a volume of velocities. A volume without a position of its own gets that of `time`, the
/// geometry of the image, if `fits` accepts its dimensions.
///
/// # Errors
/// Returns the errors of reading, and [`Error::Image`] for velocities of another dimension.
pub(crate) fn read_velocities<const D: usize>(
    path: &Path,
    time: &Geometry<D>,
    fits: impl Fn([usize; D]) -> bool,
    read: ReadImage<'_>,
) -> Result<VelocityModel<D>> {
    let name = path.display().to_string();
    let mut image: Image<D> = read(path, &InputOptions::default())?
        .into_image()
        .ok_or_else(|| {
            let problem = format!("is not a {D}-D image, but the image in time is {D}-D");
            let remedy = "give velocities with as many axes";
            Error::Image(cause(format!("velocity {name}"), problem, remedy))
        })?;
    if image.geometry == Geometry::default() && fits(image.dims()) {
        image.geometry = time.clone();
    }
    VelocityModel::new(image, &name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a model whose velocities are `v` of the physical position at each sample.
    fn velocities<const D: usize>(
        dims: [usize; D],
        geometry: Geometry<D>,
        v: impl Fn([f64; D]) -> f64,
    ) -> Result<VelocityModel<D>> {
        VelocityModel::new(Image::from_fn(dims, geometry, v), "v.vti")
    }

    fn survey(units: [&str; 3]) -> Geometry<3> {
        Geometry {
            origin: [620_000.0, 6_000_000.0, 100.0],
            // Samples are along the first axis, as in SEG-Y, and lines are rotated.
            axes: [[0.0, 0.0, 40.0], [240.0, 70.0, 0.0], [-70.0, 240.0, 0.0]],
            units: units.map(String::from),
            ..Geometry::default()
        }
    }

    #[test]
    fn columns_are_looked_up_where_they_lie_in_the_world() {
        let law = |[x, y, t]: [f64; 3]| {
            2000.0 + 0.3 * (x - 620_000.0) - 0.2 * (y - 6_000_000.0) + 0.5 * t
        };
        let model = velocities([9, 5, 4], survey(["m", "m", "ms"]), law).unwrap();
        // The second model is the same with time along the last axis, and in seconds.
        let mut turned = survey(["m", "m", "s"]);
        turned.origin[2] = 0.1;
        turned.axes = [[240.0, 70.0, 0.0], [-70.0, 240.0, 0.0], [0.0, 0.0, 0.04]];
        let seconds = |[x, y, t]: [f64; 3]| law([x, y, 1000.0 * t]);
        let turned = velocities([5, 4, 9], turned, seconds).unwrap();
        let geometry = survey(["m", "m", "ms"]);
        for index in [
            [0.0, 0.0, 0.0],
            [3.3, 1.7, 2.2],
            [8.0, 4.0, 3.0],
            [5.5, 0.1, 2.9],
        ] {
            let position = geometry.to_physical(index);
            let t = 1e-3 * position[2];
            // Above 100 ms the velocity is that at 100 ms.
            let top = law([position[0], position[1], 100.0]);
            let z = 0.5 * (0.1 * top + top * (t - 0.1) + 250.0 * (t - 0.1) * (t - 0.1));
            for velocities in [&model, &turned] {
                let depth = velocities.time_depth_curve(position).depth(t);
                assert!((depth - z).abs() < 1e-3, "{index:?} {depth} {z}");
            }
        }
    }

    #[test]
    fn one_trace_is_valid_for_the_whole_survey() {
        let mut geometry = survey(["m", "m", "ms"]);
        let model = velocities([9, 1, 1], geometry.clone(), |p| 1500.0 + p[2]).unwrap();
        geometry.origin = [7.0, 7.0, 100.0];
        let outside = |k: f64| geometry.to_physical([k, 99.0, -99.0]);
        let coverage = model.check_coverage([outside(0.0), outside(2.0)].into_iter(), &geometry);
        assert!(coverage.unwrap().notes.is_empty());
    }

    #[test]
    fn times_may_grow_downwards_in_one_file_and_fall_in_the_other() {
        let model = velocities([9, 5, 4], survey(["m", "m", "ms"]), |p| 2000.0 + p[2]).unwrap();
        let inside = survey(["m", "m", "ms"]).to_physical([3.0, 2.0, 2.0]);
        let below = [inside[0], inside[1], -inside[2]];
        let coverage = model
            .check_coverage([below].into_iter(), &survey(["m", "m", "ms"]))
            .unwrap();
        assert_eq!((coverage.coordinate, coverage.seconds_per_unit), (2, -1e-3));
        let other = Geometry {
            origin: [620_000.0, 6_000_000.0, -0.1],
            axes: [[0.0, 0.0, -0.04], [240.0, 70.0, 0.0], [-70.0, 240.0, 0.0]],
            units: ["m", "m", "s"].map(String::from),
            ..Geometry::default()
        };
        let falling = velocities([9, 5, 4], other, |p| 2000.0 - 1000.0 * p[2]).unwrap();
        let [a, b] = [&model, &falling].map(|v| v.time_depth_curve(inside).depth(0.25));
        assert!((a - b).abs() < 1e-3, "{a} {b}");
    }

    #[test]
    fn invalid_velocities_are_refused_with_file_problem_and_remedy() {
        let good = |_: [f64; 3]| 2000.0;
        let refused = |units: [&str; 3], v: &dyn Fn([f64; 3]) -> f64| {
            velocities([9, 5, 4], survey(units), v)
                .unwrap_err()
                .to_string()
        };
        let cases = [
            (
                refused(["m", "m", "m"], &good),
                "no coordinate is in s, ms or us",
            ),
            (refused(["line", "m", "ms"], &good), "is in line, not in m"),
            (
                refused(["m", "m", "ms"], &|p| p[2] - 180.0),
                "60 of 180 velocities",
            ),
            (
                refused(["m", "m", "ms"], &|p| {
                    if p[2] > 300.0 { f64::NAN } else { 2e3 }
                }),
                "at index [6, 0, 0]",
            ),
            (refused(["m", "m", "ms"], &|_| 2.5), "at most 2.5 m/s"),
        ];
        for (message, expected) in cases {
            assert!(
                message.starts_with("v.vti: ") && message.contains("; give "),
                "{message}"
            );
            assert!(message.contains(expected), "{expected}: {message}");
        }
        let mut leaning = survey(["m", "m", "ms"]);
        leaning.axes[0][0] = 1.0;
        let message = velocities([9, 5, 4], leaning, good)
            .unwrap_err()
            .to_string();
        assert!(message.contains("straight along time"), "{message}");

        let model = velocities([9, 5, 4], survey(["m", "m", "ms"]), good).unwrap();
        let check = |points: &[[f64; 3]], units: [&str; 3]| {
            let coverage = model.check_coverage(points.iter().copied(), &survey(units));
            coverage.map(|reach| reach.notes)
        };
        let inside = survey(["m", "m", "ms"]).to_physical([3.0, 2.0, 2.0]);
        let outside = inside.map(|c| c + 5000.0);
        let deep = [inside[0], inside[1], 900.0];
        assert!(check(&[inside], ["m", "m", "ms"]).unwrap().is_empty());
        let notes = check(&[inside, inside, outside, deep], ["m", "m", "ms"]).unwrap();
        assert!(
            notes[0].contains("25 % of the positions lie outside"),
            "{notes:?}"
        );
        assert!(notes[1].contains("velocities end at 420 ms"), "{notes:?}");
        for (points, units) in [
            ([outside], ["m", "m", "ms"]),
            ([deep], ["m", "m", "ms"]),
            ([inside], ["m", "m", "s"]),
        ] {
            let message = check(&points, units).unwrap_err().to_string();
            assert!(message.starts_with("v.vti: lies elsewhere"), "{message}");
        }
        let message = check(&[inside], ["m", "m", "m"]).unwrap_err().to_string();
        assert!(
            message.starts_with("velocity v.vti: converts two-way time"),
            "{message}"
        );
    }
}
