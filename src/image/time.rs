//! Two-way time as a coordinate of an image, and its conversion to depth by one velocity.

use super::Geometry;
use crate::error::cause;
use crate::{Error, Result};

/// Smallest velocity, in m/s, that any rock has. Lower values are velocities in km/s.
pub(super) const MIN_VELOCITY: f64 = 50.0;

/// Velocity (metres per second) that converts two-way time to depth if none is given.
const DEFAULT_VELOCITY: f64 = 2000.0;

/// Returns the remedy for a velocity in km/s.
fn remedy_per_second(velocity: f64) -> String {
    format!("give metres per second: {}", 1000.0 * velocity)
}

/// Returns the number of seconds in a unit of time, or `None` if it is not a unit of time.
pub(crate) fn seconds_per_unit(unit: &str) -> Option<f64> {
    match unit {
        "s" => Some(1.0),
        "ms" => Some(1e-3),
        "us" => Some(1e-6),
        _ => None,
    }
}

/// Returns the factor that converts a coordinate to depth where no velocity is given: two-way time
/// counts at 2,000 m/s, and other units stay as they are.
pub(crate) fn default_depth_factor(unit: &str) -> f64 {
    seconds_per_unit(unit).map_or(1.0, |seconds| 0.5 * DEFAULT_VELOCITY * seconds)
}

/// The physical coordinate that holds two-way time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeCoordinate {
    /// Index of the coordinate.
    pub coordinate: usize,
    /// Number of seconds in its unit.
    pub seconds_per_unit: f64,
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
        let problem = format!(
            "converts two-way time to depth in metres, but {}",
            self.problem
        );
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

    /// Returns the coordinate of two-way time if it can be converted to depth in metres. The other
    /// coordinates must be in metres; one without a unit is assumed to be in metres.
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
        let is_metres = |c: usize| matches!(&*self.units[c], "" | "m");
        if let Some(c) = (0..D).find(|&c| c != coordinate && !is_metres(c)) {
            return Err(NoDepthReason {
                problem: format!(
                    "another coordinate than time is in {}, not in m",
                    self.units[c]
                ),
                remedy: "read the survey's coordinates in metres (for SEG-Y, set the bytes of x and y)",
            });
        }
        Ok(TimeCoordinate {
            coordinate,
            seconds_per_unit: seconds,
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

    /// Returns the geometry with depth in metres instead of two-way time, and the factor between
    /// the two for each coordinate: `depth = velocity * time / 2`, with one velocity in metres per
    /// second.
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
                remedy_per_second(velocity),
            )));
        }
        let time = self
            .two_way_time()
            .map_err(|reason| reason.to_error(place))?;
        let axis = time.coordinate;
        let mut factor = [1.0; D];
        factor[axis] = 0.5 * velocity * time.seconds_per_unit;
        let mut depth = self.clone();
        depth.origin[axis] *= factor[axis];
        for step in &mut depth.axes {
            step[axis] *= factor[axis];
        }
        depth.units = std::array::from_fn(|_| "m".to_string());
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
        time.units[0] = "line".into();
        assert!(time.to_depth(2000.0).is_err());
    }
}
