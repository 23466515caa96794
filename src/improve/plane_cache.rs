//! The local planes of sheets, remembered: what is tried again and again in one place needs no new fit
//! each time.

use super::feature_planes::{FeaturePlanes, NearbyPlanes};
use crate::geometry::sub;

/// Cells per fitting radius. So near to the place where they were fitted, planes stay what they are to
/// some hundredths of a sample.
const CELLS_PER_RADIUS: f64 = 8.0;

/// Cells that are remembered at a time; a power of two.
const CACHE_SIZE: usize = 1 << 13;

/// The sheets near the middles of the cells that were asked for last.
#[derive(Debug)]
pub struct PlaneCache {
    /// Each with its cell's name.
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
    /// The sheets near `x`, by planes fitted in the middle of its cell.
    pub fn planes_near(&mut self, sheets: &FeaturePlanes, x: [f64; 3]) -> NearbyPlanes {
        let side = sheets.radius() / CELLS_PER_RADIUS;
        // Casts cut off at zero, where the box begins.
        let cell = x.map(|c| (c / side) as u64 & 0x1f_ffff);
        let name = cell[2] << 42 | cell[1] << 21 | cell[0];
        // Fibonacci hashing.
        let place = (name.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize % CACHE_SIZE;
        let middle = cell.map(|c| (c as f64 + 0.5) * side);
        let remembered = &mut self.entries[place];
        if remembered.0 != name {
            *remembered = (name, sheets.planes_near(middle));
        }
        remembered.1.translated(sub(x, middle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::FeaturePoint;
    use crate::geometry::random::uniform_signed;

    #[test]
    fn remembered_planes_are_those_of_the_place_to_some_hundredths() {
        // A cylinder of radius 30 along z, round (0, -10).
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
        let sheets = FeaturePlanes::new(&points, [32.0, 24.0, 24.0], 3.2, 6.0);
        let mut lookup = PlaneCache::default();
        let mut compared = 0;
        // Twice, so that planes are remembered.
        for i in (0..400).chain(0..400) {
            let angle = 0.85 + 0.2 * uniform_signed(i, 0);
            let radius = 30.0 + 1.5 * uniform_signed(i, 1);
            let z = 12.0 + 6.0 * uniform_signed(i, 2);
            let x = [radius * angle.cos(), radius * angle.sin() - 10.0, z];
            let (exact, known) = (sheets.planes_near(x), lookup.planes_near(&sheets, x));
            assert_eq!(exact.iter().count(), known.iter().count(), "{x:?}");
            for (a, b) in exact.iter().zip(known.iter()) {
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
