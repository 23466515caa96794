//! Statements of files about their coordinates.

/// Direction in which z grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZDirection {
    /// Heights: z grows upwards.
    Up,
    /// Depths and times: z grows downwards.
    Down,
}

/// Domain of the vertical coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// Two-way time.
    Time,
    /// Depth or height.
    Depth,
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
