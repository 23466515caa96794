//! A cache of local planes. Smoothing evaluates many positions close to each other, and need not
//! fit planes for each.

use super::feature_planes::{FeaturePlanes, NearbyPlanes};
use crate::geometry::sub;

/// Cache cells per fitting radius. Within so small a cell, the planes change by some hundredths of
/// a sample only.
const CELLS_PER_RADIUS: f64 = 8.0;

/// Number of cells in the cache. It must be a power of two.
const CACHE_SIZE: usize = 1 << 13;

/// The planes at the centres of the cells that were used last.
#[derive(Debug)]
pub struct PlaneCache {
    /// The key of each cell, and its planes.
    entries: Vec<(u64, NearbyPlanes)>,
}

impl Default for PlaneCache {
    fn default() -> Self {
        Self {
            entries: vec![(u64::MAX, NearbyPlanes::default()); CACHE_SIZE],
        }
    }
}

impl PlaneCache {
    /// Returns the planes near `x`, as fitted at the centre of the cache cell of `x`.
    pub fn planes_near(&mut self, planes: &FeaturePlanes, x: [f64; 3]) -> NearbyPlanes {
        let side = planes.radius() / CELLS_PER_RADIUS;
        // The cast turns negative coordinates into zero, where the box begins.
        let cell = x.map(|c| (c / side) as u64 & 0x1f_ffff);
        let key = cell[2] << 42 | cell[1] << 21 | cell[0];
        // Fibonacci hashing.
        let slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize % CACHE_SIZE;
        let middle = cell.map(|c| (c as f64 + 0.5) * side);
        let entry = &mut self.entries[slot];
        if entry.0 != key {
            *entry = (key, planes.planes_near(middle));
        }
        entry.1.translated(sub(x, middle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::FeaturePoint;
    use crate::geometry::random::uniform_signed;

    #[test]
    fn cached_planes_differ_from_exact_ones_by_some_hundredths() {
        // A cylinder of radius 30 along z around (0, -10).
        let mut points = Vec::new();
        for k in 0..=24 {
            for j in 0..=40 {
                let angle = 0.5 + 0.7 * f64::from(j) / 40.0;
                let normal = [angle.cos(), angle.sin(), 0.0];
                points.push(FeaturePoint {
                    position: [30.0 * normal[0], 30.0 * normal[1] - 10.0, f64::from(k)]
                        .map(|c| c as f32),
                    normal: normal.map(|c| c as f32),
                    strength: 1.0,
                });
            }
        }
        let planes = FeaturePlanes::new(&points, [32.0, 24.0, 24.0], 3.2, 6.0);
        let mut cache = PlaneCache::default();
        let mut compared = 0;
        // Run twice, so that the second run reads from the cache.
        for i in (0..400).chain(0..400) {
            let angle = 0.85 + 0.2 * uniform_signed(i, 0);
            let radius = 30.0 + 1.5 * uniform_signed(i, 1);
            let z = 12.0 + 6.0 * uniform_signed(i, 2);
            let x = [radius * angle.cos(), radius * angle.sin() - 10.0, z];
            let (exact, cached) = (planes.planes_near(x), cache.planes_near(&planes, x));
            assert_eq!(exact.iter().count(), cached.iter().count(), "{x:?}");
            for (a, b) in exact.iter().zip(cached.iter()) {
                assert!(
                    (a.offset.abs() - b.offset.abs()).abs() < 0.03,
                    "{a:?} {b:?}"
                );
                compared += 1;
            }
        }
        assert!(compared >= 800);
    }
}
