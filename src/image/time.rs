//! Two-way time among the coordinates of an image, and depth for it by one velocity.

use super::Geometry;
use crate::error::cause;
use crate::{Error, Result};

/// Seconds in a unit of time; `None` for what is no unit of time.
pub(crate) fn seconds_per_unit(unit: &str) -> Option<f64> {
    match unit {
        "s" => Some(1.0),
        "ms" => Some(1e-3),
        "us" => Some(1e-6),
        _ => None,
    }
}

/// The physical coordinate that is two-way time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeCoordinate {
    /// Which it is.
    pub coordinate: usize,
    /// Seconds in its unit.
    pub seconds_per_unit: f64,
}

/// Why no depth can be made of an image's time.
#[derive(Debug, Clone, PartialEq)]
pub struct NoDepthReason {
    /// What stands in the way.
    pub problem: String,
    /// What to do.
    pub remedy: &'static str,
}

impl NoDepthReason {
    /// As an error about what should have made depth.
    pub fn to_error(&self, place: String) -> Error {
        let problem = format!(
            "makes depth in metres of two-way time, but {}",
            self.problem
        );
        Error::Image(cause(place, problem, self.remedy))
    }
}

impl<const D: usize> Geometry<D> {
    /// Which physical coordinate is time, if one is.
    pub fn time_coordinate(&self) -> Option<usize> {
        self.units
            .iter()
            .position(|unit| seconds_per_unit(unit).is_some())
    }

    /// Where two-way time is that depth in metres can be made of: the other coordinates must be metres (one
    /// without a unit is taken to be).
    ///
    /// # Errors
    /// What stands in the way, and the remedy.
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
        let metres = |c: usize| matches!(&*self.units[c], "" | "m");
        if let Some(c) = (0..D).find(|&c| c != coordinate && !metres(c)) {
            return Err(NoDepthReason {
                problem: format!("a coordinate beside time is in {}, not in m", self.units[c]),
                remedy: "read the survey's coordinates in metres (of SEG-Y by the bytes of x and y)",
            });
        }
        Ok(TimeCoordinate {
            coordinate,
            seconds_per_unit: seconds,
        })
    }

    /// The image axis that runs along a coordinate, if no other coordinate changes along it, nor this one
    /// along another axis.
    pub fn axis_along(&self, coordinate: usize) -> Option<usize> {
        let alone = |k: usize| {
            (0..D).all(|c| (self.axes[k][c] != 0.0) == (c == coordinate))
                && (0..D).all(|l| l == k || self.axes[l][coordinate] == 0.0)
        };
        (0..D).find(|&k| alone(k))
    }

    /// The same with depth in metres for two-way time, and the factor from the one to the other:
    /// `depth = velocity * time / 2`, at one velocity in metres a second.
    ///
    /// # Errors
    /// [`Error::Image`] for a velocity that is not positive, and as [`Self::two_way_time`].
    pub fn to_depth(&self, velocity: f64) -> Result<(Self, [f64; D])> {
        let place = format!("velocity {velocity}");
        if !(velocity.is_finite() && velocity > 0.0) {
            let remedy = "give metres a second, 2000 say";
            return Err(Error::Image(cause(place, "is not positive", remedy)));
        }
        let time = self.two_way_time().map_err(|no| no.to_error(place))?;
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
        // 1.299 s there and back at 2.4 km/s.
        assert!((z - 1299.0).abs() < 1e-9 && (found[2] - 1558.8).abs() < 1e-9);
        assert_eq!([found[0], found[1]], [x, y]);
        assert_eq!(depth.units, ["m", "m", "m"]);
        assert!(time.to_depth(0.0).is_err() && time.to_depth(f64::NAN).is_err());
        time.units[0] = "line".into();
        assert!(time.to_depth(2000.0).is_err());
    }
}
