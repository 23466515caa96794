//! Facts about all points of a distributed triangulation, for ranks that have only some of them.

use crate::geometry::{bounding_box, sub};

/// First width of the halo around a slab, in mean distances between points.
pub const INITIAL_HALO: f64 = 2.5;
/// Number of halo widths that are tried; each is twice as wide as the one before.
pub const MAX_HALO_TRIES: usize = 3;

/// Bounding box and number of all points, on a rank that may have only some of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobalPoints {
    /// Smallest coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
    /// Number of points.
    pub count: usize,
}

impl GlobalPoints {
    /// Returns the facts about `points`, which are all points.
    pub fn from_points(points: &[[f64; 3]]) -> Self {
        let [low, high] = bounding_box(points);
        let count = points.len();
        Self { low, high, count }
    }

    /// Returns the distance between neighbouring points if they form a regular (face-centred cubic)
    /// lattice.
    pub fn mean_distance(&self) -> f64 {
        let volume: f64 = sub(self.high, self.low).iter().product();
        (2f64.sqrt() * volume / self.count as f64).cbrt()
    }

    /// Returns the largest halo width: points farther from a slab are never used.
    pub fn max_halo(&self) -> f64 {
        INITIAL_HALO * self.mean_distance() * f64::from(1 << (MAX_HALO_TRIES - 1))
    }
}
