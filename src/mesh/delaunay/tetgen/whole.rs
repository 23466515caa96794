//! What is known of all points where some are somewhere else.

use crate::geometry::{spread, sub};

/// The first halo round a slab, in mean distances of points.
pub const HALO: f64 = 2.5;
/// How often a halo is tried; each is twice as wide as the one before.
pub const TRIES: usize = 3;

/// All points, of which some may be somewhere else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whole {
    /// The least of their coordinates.
    pub low: [f64; 3],
    /// The largest.
    pub high: [f64; 3],
    /// How many they are.
    pub count: usize,
}

impl Whole {
    /// These.
    pub fn of(points: &[[f64; 3]]) -> Self {
        let [low, high] = spread(points);
        let count = points.len();
        Self { low, high, count }
    }

    /// How far apart they are, if they stand regularly.
    pub fn distance(&self) -> f64 {
        let room: f64 = sub(self.high, self.low).iter().product();
        (2f64.sqrt() * room / self.count as f64).cbrt()
    }

    /// How far round a slab points are looked at, at most.
    pub fn halo(&self) -> f64 {
        HALO * self.distance() * f64::from(1 << (TRIES - 1))
    }
}
