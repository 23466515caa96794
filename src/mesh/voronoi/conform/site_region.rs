//! The region where sites may be placed. It is limited if only a part of a mesh is rebuilt and the
//! rest stays.

use crate::geometry::cell_list::CellList;
use crate::geometry::distance2;

/// Relative tolerance by which the excluded balls are enlarged, so that sites on their spheres are
/// excluded too.
const ROUNDING_TOLERANCE: f64 = 1e-9;

/// A union of balls in which sites must be, without the balls in which they must not be.
#[derive(Debug, Default)]
pub struct SiteRegion<const D: usize> {
    /// Centres and radii of the allowed balls; if empty, all positions are allowed.
    allowed_balls: Vec<([f64; D], f64)>,
    excluded_balls: Vec<([f64; D], f64)>,
    grid: Option<CellList<D>>,
    max_radius: f64,
}

impl<const D: usize> SiteRegion<D> {
    /// Creates the region inside the `allowed_balls` and outside all `excluded_balls`. The nodes of
    /// Voronoi cells do not change as long as no site enters their circumscribed balls, which are
    /// passed as `excluded_balls`.
    pub fn new(allowed_balls: Vec<([f64; D], f64)>, excluded_balls: Vec<([f64; D], f64)>) -> Self {
        let max_radius = excluded_balls
            .iter()
            .fold(0.0f64, |max, ball| max.max(ball.1));
        let centres: Vec<[f64; D]> = excluded_balls.iter().map(|ball| ball.0).collect();
        Self {
            allowed_balls,
            grid: (max_radius > 0.0).then(|| CellList::new(&centres, max_radius)),
            excluded_balls,
            max_radius,
        }
    }

    /// Returns `true` if a site may be placed at `x`.
    pub fn contains(&self, x: [f64; D]) -> bool {
        let is_inside =
            |ball: &([f64; D], f64), scale: f64| distance2(&ball.0, &x) < ball.1 * ball.1 * scale;
        let mut is_allowed = self.allowed_balls.is_empty()
            || self.allowed_balls.iter().any(|ball| is_inside(ball, 1.0));
        if let (true, Some(grid)) = (is_allowed, &self.grid) {
            grid.visit_within(x, self.max_radius, |i| {
                is_allowed =
                    is_allowed && !is_inside(&self.excluded_balls[i], 1.0 + ROUNDING_TOLERANCE);
            });
        }
        is_allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_is_in_allowed_balls_and_off_excluded_ones() {
        let region = SiteRegion::new(vec![([0.0; 2], 2.0)], vec![([1.0, 0.0], 0.5)]);
        assert!(region.contains([0.0, 1.0]) && region.contains([0.4, 0.0]));
        assert!(!region.contains([0.6, 0.0]), "in an excluded ball");
        assert!(!region.contains([0.5, 0.0]), "on its sphere");
        assert!(!region.contains([0.0, 2.1]), "in no allowed ball");
        assert!(SiteRegion::default().contains([9.0, 9.0]));
    }
}
