//! Statements about coordinates: by the file that holds them, and by the option that names the file.

use std::fmt::{self, Display, Formatter};

/// Direction in which z grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZDirection {
    /// Heights: z grows upwards.
    Up,
    /// Depths and times: z grows downwards.
    Down,
}

impl ZDirection {
    /// Returns the direction of heights if `is_up` is `true`, or else that of depths.
    pub fn from_up(is_up: bool) -> Self {
        if is_up { Self::Up } else { Self::Down }
    }
}

impl Display for ZDirection {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Up => "up",
            Self::Down => "down",
        })
    }
}

/// Domain of the vertical coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// Two-way time.
    Time,
    /// Depth or height.
    Depth,
}

impl Display for Domain {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Time => "time",
            Self::Depth => "depth",
        })
    }
}

/// Statements of a file about the coordinates of its surfaces, sticks, points or wells. Everything is
/// optional: what it leaves out is taken from the image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StatedCoordinates {
    /// Units of x, y and z, as the file writes them.
    pub units: [Option<String>; 3],
    /// Direction in which z grows.
    pub z_direction: Option<ZDirection>,
    /// Domain of z. A unit of time says it, too.
    pub domain: Option<Domain>,
    /// Values that the file names as null values.
    pub nulls: Vec<f64>,
}

/// Statements of an option about the coordinates in the file that it names. They complete those of
/// the file, and replace them where the two differ.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CoordinateOptions {
    /// The unit of z, or the units of x, y and z.
    pub units: Vec<String>,
    /// Direction in which z grows.
    pub z_direction: Option<ZDirection>,
    /// Domain of z.
    pub domain: Option<Domain>,
    /// Null values. An empty list keeps all values; `None` recognises common null values.
    pub nulls: Option<Vec<f64>>,
    /// Meaning of each column of a table; `_` skips one.
    pub columns: Vec<String>,
    /// Wellhead of a deviation survey: x, y, and the height of its measured depth 0.
    pub head: Option<[f64; 3]>,
}

impl CoordinateOptions {
    /// Returns the unit of a coordinate, if the option says it.
    pub fn unit(&self, coordinate: usize) -> Option<&str> {
        match (&self.units[..], coordinate) {
            ([z], 2) => Some(z),
            ([_], _) => None,
            (units, _) => units.get(coordinate).map(String::as_str),
        }
    }

    /// Returns the options, with these null values if they name none themselves.
    pub fn with_nulls(&self, nulls: Option<Vec<f64>>) -> Self {
        Self {
            nulls: self.nulls.clone().or(nulls),
            ..self.clone()
        }
    }
}
