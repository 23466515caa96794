//! What is known of all points where some are somewhere else.

use crate::geometry::{bounding_box, sub};

/// The first halo round a slab, in mean distances of points.
pub const INITIAL_HALO: f64 = 2.5;
/// How often a halo is tried; each is twice as wide as the one before.
pub const MAX_HALO_TRIES: usize = 3;

/// All points, of which some may be somewhere else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobalPoints {
    /// The least of their coordinates.
    pub low: [f64; 3],
    /// The largest.
    pub high: [f64; 3],
    /// How many they are.
    pub count: usize,
}

impl GlobalPoints {
    /// These.
    pub fn from_points(points: &[[f64; 3]]) -> Self {
        let [low, high] = bounding_box(points);
        let count = points.len();
        Self { low, high, count }
    }

    /// How far apart they are, if they stand regularly.
    pub fn mean_distance(&self) -> f64 {
        let room: f64 = sub(self.high, self.low).iter().product();
        (2f64.sqrt() * room / self.count as f64).cbrt()
    }

    /// How far round a slab points are looked at, at most.
    pub fn max_halo(&self) -> f64 {
        INITIAL_HALO * self.mean_distance() * f64::from(1 << (MAX_HALO_TRIES - 1))
    }
}
