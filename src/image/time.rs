//! Two-way time as a coordinate of an image, and its conversion to depth by one velocity.

use super::Geometry;
use crate::error::cause;
use crate::units::{self, Quantity};
use crate::{Error, Result};

/// Smallest velocity, in m/s, that any rock has. Lower values are velocities in km/s.
pub(super) const MIN_VELOCITY: f64 = 50.0;

/// Largest velocity, in m/s, that any rock has. Higher values are velocities in ft/s.
pub(super) const MAX_VELOCITY: f64 = 10_000.0;

/// Velocity (metres per second) that converts two-way time to depth if none is given.
pub(crate) const DEFAULT_VELOCITY: f64 = 2000.0;

/// Returns the remedy for a velocity in another unit, which has this many metres per second.
fn remedy_per_second(velocity: f64) -> String {
    format!("give metres per second: {velocity}")
}

/// Returns the number of seconds in a unit of time, or `None` if it is not a unit of time.
pub(crate) fn seconds_per_unit(unit: &str) -> Option<f64> {
    units::find(unit)
        .filter(|unit| unit.quantity == Quantity::Time)
        .map(|unit| unit.size)
}

/// Returns the number of metres in a unit of length, or `None` if it is not one that is known.
pub(crate) fn metres_per_unit(unit: &str) -> Option<f64> {
    units::find(unit)
        .filter(|unit| unit.quantity == Quantity::Length)
        .map(|unit| unit.size)
}

/// Returns the number of metres in a unit of a coordinate where no velocity is given: two-way time
/// counts at 2,000 m/s, and an unknown unit as metres.
pub(crate) fn default_metres_per_unit(unit: &str) -> f64 {
    let depth = |seconds| 0.5 * DEFAULT_VELOCITY * seconds;
    let metres = seconds_per_unit(unit).map(depth);
    metres.or_else(|| metres_per_unit(unit)).unwrap_or(1.0)
}

/// The physical coordinate that holds two-way time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeCoordinate {
    /// Index of the coordinate.
    pub coordinate: usize,
    /// Number of seconds in its unit.
    pub seconds_per_unit: f64,
    /// Unit of the other coordinates, in which depth is, too: `"m"` or `"ft"`.
    pub depth_unit: &'static str,
}

impl TimeCoordinate {
    /// Returns the number of units of depth in a metre.
    pub fn depth_units_per_metre(&self) -> f64 {
        1.0 / metres_per_unit(self.depth_unit).unwrap_or(1.0)
    }
}

/// Reason why the two-way time of an image cannot be converted to depth.
#[derive(Debug, Clone, PartialEq)]
pub struct NoDepthReason {
    /// The obstacle.
    pub problem: String,
    /// Advice for the user.
    pub remedy: &'static str,
}

impl NoDepthReason {
    /// Returns the reason as an error about the velocity named `place`.
    pub fn to_error(&self, place: String) -> Error {
        let problem = format!("converts two-way time to depth, but {}", self.problem);
        Error::Image(cause(place, problem, self.remedy))
    }
}

impl<const D: usize> Geometry<D> {
    /// Returns the index of the physical coordinate that is time, if there is one.
    pub fn time_coordinate(&self) -> Option<usize> {
        self.units
            .iter()
            .position(|unit| seconds_per_unit(unit).is_some())
    }

    /// Returns the coordinate of two-way time if it can be converted to depth. The other
    /// coordinates must all be in metres or all in feet, and depth is in the same unit; one without a
    /// unit is assumed to be in that of the others, or in metres.
    ///
    /// # Errors
    /// Returns the obstacle and the remedy if it cannot.
    pub fn two_way_time(&self) -> std::result::Result<TimeCoordinate, NoDepthReason> {
        let seconds = self.units.iter().map(|unit| seconds_per_unit(unit));
        let found = (0..)
            .zip(seconds)
            .find_map(|(c, seconds)| Some((c, seconds?)));
        let Some((coordinate, seconds)) = found else {
            return Err(NoDepthReason {
                problem: "no coordinate is in s, ms or us".into(),
                remedy: "omit it",
            });
        };
        let others = (0..D).filter(|&c| c != coordinate);
        let is_feet = others.clone().any(|c| self.units[c] == "ft");
        let depth_unit = if is_feet { "ft" } else { "m" };
        let is_other = |c: &usize| !self.units[*c].is_empty() && self.units[*c] != depth_unit;
        if let Some(c) = others.clone().find(is_other) {
            return Err(NoDepthReason {
                problem: format!(
                    "another coordinate than time is in {}, not in {depth_unit}",
                    self.units[c]
                ),
                remedy: "give an image whose other coordinates are all in m or all in ft (for SEG-Y, set the bytes of x and y)",
            });
        }
        Ok(TimeCoordinate {
            coordinate,
            seconds_per_unit: seconds,
            depth_unit,
        })
    }

    /// Returns the image axis along which this coordinate alone changes, if the coordinate does not
    /// change along any other axis.
    pub fn axis_along(&self, coordinate: usize) -> Option<usize> {
        let runs_along = |k: usize| {
            (0..D).all(|c| (self.axes[k][c] != 0.0) == (c == coordinate))
                && (0..D).all(|l| l == k || self.axes[l][coordinate] == 0.0)
        };
        (0..D).find(|&k| runs_along(k))
    }

    /// Returns the geometry with depth instead of two-way time, in the unit of the other
    /// coordinates, and the factor between the two for each coordinate: `depth = velocity * time /
    /// 2`, with one velocity in metres per second.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the velocity is not positive, and the errors of
    /// [`Self::two_way_time`].
    pub fn to_depth(&self, velocity: f64) -> Result<(Self, [f64; D])> {
        let place = format!("velocity {velocity}");
        if !(velocity.is_finite() && velocity > 0.0) {
            let remedy = "give metres per second, e.g. 2000";
            return Err(Error::Image(cause(place, "is not positive", remedy)));
        }
        if velocity < MIN_VELOCITY {
            let problem = "is too slow for rock or water: is it in km/s?";
            return Err(Error::Image(cause(
                place,
                problem,
                remedy_per_second(1000.0 * velocity),
            )));
        }
        if velocity > MAX_VELOCITY {
            let problem = "is too fast for rock: is it in ft/s?";
            let remedy = remedy_per_second((0.3048 * velocity).round());
            return Err(Error::Image(cause(place, problem, remedy)));
        }
        let time = self
            .two_way_time()
            .map_err(|reason| reason.to_error(place))?;
        let axis = time.coordinate;
        let mut factor = [1.0; D];
        factor[axis] = 0.5 * velocity * time.seconds_per_unit * time.depth_units_per_metre();
        let mut depth = self.clone();
        depth.origin[axis] *= factor[axis];
        for step in &mut depth.axes {
            step[axis] *= factor[axis];
        }
        depth.units = std::array::from_fn(|_| time.depth_unit.to_string());
        Ok((depth, factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_becomes_depth() {
        let mut time = Geometry::<3> {
            origin: [620_000.0, 6_000_000.0, 999.0],
            axes: [[0.0, 0.0, 3.0], [20.0, 0.5, 0.0], [-0.5, 20.0, 0.0]],
            ..Geometry::default()
        };
        assert!(time.to_depth(2000.0).is_err(), "no time");
        time.units = ["m", "m", "ms"].map(String::from);
        assert_eq!(time.time_coordinate(), Some(2));
        let (depth, factor) = time.to_depth(2400.0).unwrap();
        assert_eq!(factor, [1.0, 1.0, 1.2]);
        let [x, y, z] = time.to_physical([100.0, 7.0, 9.0]);
        let found = depth.to_physical([100.0, 7.0, 9.0]);
        // The time is 1.299 s down and up again, at 2.4 km/s.
        assert!((z - 1299.0).abs() < 1e-9 && (found[2] - 1558.8).abs() < 1e-9);
        assert_eq!([found[0], found[1]], [x, y]);
        assert_eq!(depth.units, ["m", "m", "m"]);
        assert!(time.to_depth(0.0).is_err() && time.to_depth(f64::NAN).is_err());
        let slow = time.to_depth(2.5).unwrap_err().to_string();
        assert!(
            slow.contains("km/s?; give metres per second: 2500"),
            "{slow}"
        );
        let fast = time.to_depth(12_000.0).unwrap_err().to_string();
        assert!(
            fast.contains("ft/s?; give metres per second: 3658"),
            "{fast}"
        );
        time.units[0] = "line".into();
        assert!(time.to_depth(2000.0).is_err());
    }

    #[test]
    fn a_survey_in_feet_gets_depths_in_feet() {
        let mut time = Geometry::<3> {
            axes: [[0.0, 0.0, -2.0], [55.0, 0.0, 0.0], [0.0, 82.5, 0.0]],
            units: ["ft", "ft", "ms"].map(String::from),
            ..Geometry::default()
        };
        let (depth, factor) = time.to_depth(3048.0).unwrap();
        // 2 ms of two-way time at 3048 m/s, or 10,000 ft/s, are 10 ft.
        assert!((depth.axes[0][2] + 10.0).abs() < 1e-12 && (factor[2] - 5.0).abs() < 1e-12);
        assert_eq!(depth.units, ["ft", "ft", "ft"]);
        time.units[1] = String::new();
        assert_eq!(time.to_depth(3048.0).unwrap().0.units, ["ft", "ft", "ft"]);
        time.units[1] = "m".into();
        let mixed = time.to_depth(3048.0).unwrap_err().to_string();
        assert!(mixed.contains("in m, not in ft"), "{mixed}");
    }
}
