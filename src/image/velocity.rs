//! Interval velocities, on a grid of their own in two-way time, and how they lie to what they make depth of.
//!
//! Velocities are linear between samples, across and in time, and beyond the samples those of the nearest.

use super::time_depth::TimeDepthCurve;
use crate::error::cause;
use crate::image::{Geometry, Image};
use crate::{Error, Result, memory};

/// A volume, in the plane a section, of interval velocities in m/s on a grid of its own in two-way time.
#[derive(Debug, Clone)]
pub struct VelocityModel<const D: usize> {
    /// What errors and notes call it.
    pub name: String,
    /// Positive samples; time runs along axis 0, and along it alone.
    image: Image<D>,
    /// Which physical coordinate is time.
    coordinate: usize,
    /// Seconds downwards in its unit.
    seconds_per_unit: f64,
}

/// What velocities and some positions in two-way time have to do with one another.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityCoverage {
    /// Which coordinate of the positions is time.
    pub coordinate: usize,
    /// Seconds downwards in its unit: negative where times below the surface are, as heights would be.
    pub seconds_per_unit: f64,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// No rock is slower, in m/s; what is gives its velocities in km/s.
const MIN_VELOCITY: f32 = 50.0;

impl<const D: usize> VelocityModel<D> {
    /// Velocities as an image holds them; `name` is what errors call it.
    ///
    /// # Errors
    /// [`Error::Image`] unless the image has one axis in time and all velocities are positive.
    pub fn new(image: Image<D>, name: &str) -> Result<Self> {
        let refuse = |problem: String, remedy: &str| Error::Image(cause(name, problem, remedy));
        let geometry = &image.geometry;
        let time = geometry.two_way_time().map_err(|no| {
            refuse(
                format!("says not where its velocities lie in two-way time: {}", no.problem),
                "give velocities over x and y in m and time in s or ms; of a bare array, atomesh convert makes \
                 such an image (--axes, --spacing, --origin, --unit m,m,ms)",
            )
        })?;
        let along = geometry.axis_along(time.coordinate);
        let (Some(along), true) = (along, geometry.determinant() != 0.0) else {
            let problem = "has no axis that runs straight along time".to_string();
            return Err(refuse(
                problem,
                "give velocities on a grid of upright traces",
            ));
        };
        // Traces that a survey lacks have the velocities of the nearest.
        let image = image.with_missing_filled().unwrap_or(image);
        check_velocities(&image, name)?;
        let image = with_axis_first(image, along)?;
        let times = corners(&image).map(|p| p[time.coordinate]);
        Ok(Self {
            name: name.to_string(),
            coordinate: time.coordinate,
            seconds_per_unit: time.seconds_per_unit * downward_sign(times),
            image,
        })
    }

    /// Depth below a position of the world, whatever its time.
    pub fn time_depth_curve(&self, at: [f64; D]) -> TimeDepthCurve {
        let index = self.sample_index(at);
        let dims = self.image.dims();
        let samples = self.image.as_slice();
        let mut velocity = vec![0.0; dims[0]];
        for corner in 0..1usize << (D - 1) {
            let (mut weight, mut row, mut stride) = (1.0, 0, 1);
            for k in 1..D {
                let last = dims[k] - 1;
                let x = index[k].clamp(0.0, last as f64);
                let low = (x as usize).min(last.saturating_sub(1));
                let t = x - low as f64;
                let (place, share) = match corner >> (k - 1) & 1 {
                    0 => (low, 1.0 - t),
                    _ => ((low + 1).min(last), t),
                };
                weight *= share;
                row += place * stride;
                stride *= dims[k];
            }
            if weight > 0.0 {
                let trace = &samples[row * dims[0]..][..dims[0]];
                for (sum, &v) in velocity.iter_mut().zip(trace) {
                    *sum += weight * f64::from(v);
                }
            }
        }
        let geometry = &self.image.geometry;
        let first = geometry.origin[self.coordinate] * self.seconds_per_unit;
        let step = geometry.axes[0][self.coordinate] * self.seconds_per_unit;
        TimeDepthCurve::new(first, step, velocity)
    }

    /// The sample index of a position.
    fn sample_index(&self, at: [f64; D]) -> [f64; D] {
        self.image.geometry.to_index(at).unwrap_or([0.0; D])
    }

    /// Checks that velocities and what they make depth of, of which these are positions of `geometry`'s
    /// world, lie at the same place. Times may grow downwards in one and fall in the other.
    ///
    /// # Errors
    /// [`Error::Image`] if nothing lies among the velocities, beside or above one another.
    pub fn check_coverage(
        &self,
        positions: impl Iterator<Item = [f64; D]> + Clone,
        geometry: &Geometry<D>,
    ) -> Result<VelocityCoverage> {
        let other = geometry
            .two_way_time()
            .map_err(|no| no.to_error(format!("velocity {}", self.name)))?;
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(&self.name, problem, remedy)));
        if self.coordinate != other.coordinate {
            let problem =
                "has time along another coordinate than what shall come to lie in depth".into();
            return refuse(
                problem,
                "give velocities with coordinates in the same order",
            );
        }
        let seconds =
            other.seconds_per_unit * downward_sign(positions.clone().map(|p| p[other.coordinate]));
        let dims = self.image.dims();
        let (mut count, mut beside) = (0usize, 0usize);
        let mut covered = BoundingBox::empty();
        for mut at in positions {
            at[self.coordinate] *= seconds / self.seconds_per_unit;
            covered.add(at);
            let index = self.sample_index(at);
            // One trace stands for all.
            let off = |k: usize| dims[k] > 1 && !(-0.5..=dims[k] as f64 - 0.5).contains(&index[k]);
            count += 1;
            beside += usize::from((1..D).any(off));
        }
        let mut own = BoundingBox::empty();
        corners(&self.image).for_each(|p| own.add(p));
        // Downwards, in the velocities' unit.
        let [[from, to], [first, last]] = [&own, &covered].map(|bounds| {
            let ends = [bounds.min, bounds.max].map(|p| p[self.coordinate].abs());
            [ends[0].min(ends[1]), ends[0].max(ends[1])]
        });
        if beside == count || (dims[0] > 1 && (from > last || first > to)) {
            let unit = &self.image.geometry.units[self.coordinate];
            let problem = format!(
                "lies elsewhere: its velocities cover {own}, what shall come to lie in depth {covered} (time in {unit})"
            );
            return refuse(
                problem,
                "give velocities of the survey, in the same coordinates",
            );
        }
        let mut notes = Vec::new();
        if beside > 0 {
            notes.push(format!(
                "{}: {:.0} % of the positions lie beside the velocities, and have those of the nearest",
                self.name,
                (100.0 * beside as f64 / count as f64).max(1.0)
            ));
        }
        let step = (to - from) / (dims[0].max(2) - 1) as f64;
        if dims[0] > 1 && last > to + step {
            let unit = &self.image.geometry.units[self.coordinate];
            notes.push(format!(
                "{}: velocities end at {to} {unit}; the last is taken down to {last} {unit}",
                self.name
            ));
        }
        Ok(VelocityCoverage {
            coordinate: other.coordinate,
            seconds_per_unit: seconds,
            notes,
        })
    }
}

/// The corners of an image in the world.
fn corners<const D: usize>(image: &Image<D>) -> impl Iterator<Item = [f64; D]> {
    let far = image.dims().map(|n| n as f64 - 1.0);
    let index = move |corner: usize| {
        std::array::from_fn(|k| if corner >> k & 1 == 1 { far[k] } else { 0.0 })
    };
    (0..1usize << D).map(move |corner| image.geometry.to_physical(index(corner)))
}

/// The sign of times below the surface: 1 where they grow downwards, -1 where they fall as heights do.
fn downward_sign(times: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = times.fold((0.0f64, 0.0f64), |(a, b), t| (a.min(t), b.max(t)));
    if -low > high { -1.0 } else { 1.0 }
}

/// Refuses what is no velocity.
fn check_velocities<const D: usize>(image: &Image<D>, name: &str) -> Result<()> {
    let refuse = |problem: String, remedy: &str| Err(Error::Image(cause(name, problem, remedy)));
    let samples = image.as_slice();
    let wrong = |v: &f32| !(v.is_finite() && *v > 0.0);
    let count = samples.iter().filter(|v| wrong(v)).count();
    if let Some(first) = samples.iter().position(wrong) {
        let mut place = first;
        let index = image.dims().map(|n| {
            let index = place % n;
            place /= n;
            index
        });
        let problem = format!(
            "{count} of {} velocities are not positive numbers; that at index {index:?} (x first) is {}",
            samples.len(),
            samples[first]
        );
        return refuse(problem, "give interval velocities in m/s everywhere");
    }
    if samples.is_empty() {
        return refuse("holds no velocities".into(), "give some");
    }
    let most = samples.iter().fold(0.0f32, |most, v| most.max(*v));
    if most < MIN_VELOCITY {
        let problem = format!("holds at most {most} m/s, which is no velocity of rock or water");
        return refuse(problem, "give m/s: a thousand times km/s");
    }
    Ok(())
}

/// The image with two of its axes exchanged, so that axis `k` comes first.
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
        samples: samples.as_standard_layout().into_owned(),
        geometry,
        missing: Vec::new(),
        dead: Vec::new(),
    })
}

/// The box of some positions.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Velocities of `v` at samples of `dims`, which lie at `geometry`; in positions of the world.
    fn velocities<const D: usize>(
        dims: [usize; D],
        geometry: Geometry<D>,
        v: impl Fn([f64; D]) -> f64,
    ) -> Result<VelocityModel<D>> {
        let at = |mut i: usize| {
            let index = dims.map(|n| {
                let k = i % n;
                i /= n;
                k as f64
            });
            v(geometry.to_physical(index)) as f32
        };
        let samples = (0..dims.iter().product()).map(at).collect();
        VelocityModel::new(Image::new(dims, samples, geometry), "v.vti")
    }

    fn survey(units: [&str; 3]) -> Geometry<3> {
        Geometry {
            origin: [620_000.0, 6_000_000.0, 100.0],
            // Samples first, as in SEG-Y, on turned lines.
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
        let found = velocities([9, 5, 4], survey(["m", "m", "ms"]), law).unwrap();
        // The same, time last and in seconds.
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
            let at = geometry.to_physical(index);
            let t = 1e-3 * at[2];
            // Above 100 ms as there.
            let top = law([at[0], at[1], 100.0]);
            let z = 0.5 * (0.1 * top + top * (t - 0.1) + 250.0 * (t - 0.1) * (t - 0.1));
            for velocities in [&found, &turned] {
                let depth = velocities.time_depth_curve(at).depth(t);
                assert!((depth - z).abs() < 1e-3, "{index:?} {depth} {z}");
            }
        }
    }

    #[test]
    fn one_trace_is_meant_for_all_the_survey() {
        let mut geometry = survey(["m", "m", "ms"]);
        let one = velocities([9, 1, 1], geometry.clone(), |p| 1500.0 + p[2]).unwrap();
        geometry.origin = [7.0, 7.0, 100.0];
        let far = |k: f64| geometry.to_physical([k, 99.0, -99.0]);
        let reach = one.check_coverage([far(0.0), far(2.0)].into_iter(), &geometry);
        assert!(reach.unwrap().notes.is_empty());
    }

    #[test]
    fn times_may_grow_downwards_in_one_file_and_fall_in_the_other() {
        let found = velocities([9, 5, 4], survey(["m", "m", "ms"]), |p| 2000.0 + p[2]).unwrap();
        let inside = survey(["m", "m", "ms"]).to_physical([3.0, 2.0, 2.0]);
        let below = [inside[0], inside[1], -inside[2]];
        let reach = found
            .check_coverage([below].into_iter(), &survey(["m", "m", "ms"]))
            .unwrap();
        assert_eq!((reach.coordinate, reach.seconds_per_unit), (2, -1e-3));
        let other = Geometry {
            origin: [620_000.0, 6_000_000.0, -0.1],
            axes: [[0.0, 0.0, -0.04], [240.0, 70.0, 0.0], [-70.0, 240.0, 0.0]],
            units: ["m", "m", "s"].map(String::from),
            ..Geometry::default()
        };
        let falling = velocities([9, 5, 4], other, |p| 2000.0 - 1000.0 * p[2]).unwrap();
        let [a, b] = [&found, &falling].map(|v| v.time_depth_curve(inside).depth(0.25));
        assert!((a - b).abs() < 1e-3, "{a} {b}");
    }

    #[test]
    fn what_makes_no_depth_is_refused_with_file_place_and_remedy() {
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
        for (said, words) in cases {
            assert!(
                said.starts_with("v.vti: ") && said.contains("; give "),
                "{said}"
            );
            assert!(said.contains(words), "{words}: {said}");
        }
        let mut leaning = survey(["m", "m", "ms"]);
        leaning.axes[0][0] = 1.0;
        let said = velocities([9, 5, 4], leaning, good)
            .unwrap_err()
            .to_string();
        assert!(said.contains("straight along time"), "{said}");

        let found = velocities([9, 5, 4], survey(["m", "m", "ms"]), good).unwrap();
        let reach = |points: &[[f64; 3]], units: [&str; 3]| {
            let reach = found.check_coverage(points.iter().copied(), &survey(units));
            reach.map(|reach| reach.notes)
        };
        let inside = survey(["m", "m", "ms"]).to_physical([3.0, 2.0, 2.0]);
        let beside = inside.map(|c| c + 5000.0);
        let deep = [inside[0], inside[1], 900.0];
        assert!(reach(&[inside], ["m", "m", "ms"]).unwrap().is_empty());
        let notes = reach(&[inside, inside, beside, deep], ["m", "m", "ms"]).unwrap();
        assert!(
            notes[0].contains("25 % of the positions lie beside"),
            "{notes:?}"
        );
        assert!(notes[1].contains("velocities end at 420 ms"), "{notes:?}");
        for (points, units) in [
            ([beside], ["m", "m", "ms"]),
            ([deep], ["m", "m", "ms"]),
            ([inside], ["m", "m", "s"]),
        ] {
            let said = reach(&points, units).unwrap_err().to_string();
            assert!(said.starts_with("v.vti: lies elsewhere"), "{said}");
        }
        let said = reach(&[inside], ["m", "m", "m"]).unwrap_err().to_string();
        assert!(said.starts_with("velocity v.vti: makes depth"), "{said}");
    }
}
