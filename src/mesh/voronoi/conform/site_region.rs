//! Where sites may stand, if not everywhere: in a part of a mesh of which the rest stays.

use crate::geometry::cell_list::CellList;
use crate::geometry::distance2;

/// A sphere round a point stays empty also of what rounding puts onto it.
const ROUNDING_TOLERANCE: f64 = 1e-9;

/// Balls in one of which sites have to stand, and those that stay empty.
#[derive(Debug, Default)]
pub struct SiteRegion<const D: usize> {
    /// Centres and radii; with none sites may stand anywhere.
    allowed_balls: Vec<([f64; D], f64)>,
    excluded_balls: Vec<([f64; D], f64)>,
    grid: Option<CellList<D>>,
    max_radius: f64,
}

impl<const D: usize> SiteRegion<D> {
    /// The places in the `open` balls that are in none of the `closed` ones. Nodes of Voronoi cells stay as
    /// long as no site enters the balls round them whose spheres bear their sites.
    pub fn new(allowed_balls: Vec<([f64; D], f64)>, excluded_balls: Vec<([f64; D], f64)>) -> Self {
        let max_radius = excluded_balls
            .iter()
            .fold(0.0f64, |most, ball| most.max(ball.1));
        let centres: Vec<[f64; D]> = excluded_balls.iter().map(|ball| ball.0).collect();
        Self {
            allowed_balls,
            grid: (max_radius > 0.0).then(|| CellList::new(&centres, max_radius)),
            excluded_balls,
            max_radius,
        }
    }

    /// Whether a site may stand there.
    pub fn contains(&self, x: [f64; D]) -> bool {
        let within =
            |ball: &([f64; D], f64), scale: f64| distance2(&ball.0, &x) < ball.1 * ball.1 * scale;
        let mut holds = self.allowed_balls.is_empty()
            || self.allowed_balls.iter().any(|ball| within(ball, 1.0));
        if let (true, Some(grid)) = (holds, &self.grid) {
            grid.visit_within(x, self.max_radius, |i| {
                holds = holds && !within(&self.excluded_balls[i], 1.0 + ROUNDING_TOLERANCE);
            });
        }
        holds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_in_open_balls_and_off_closed_ones() {
        let room = SiteRegion::new(vec![([0.0; 2], 2.0)], vec![([1.0, 0.0], 0.5)]);
        assert!(room.contains([0.0, 1.0]) && room.contains([0.4, 0.0]));
        assert!(!room.contains([0.6, 0.0]), "in a closed ball");
        assert!(!room.contains([0.5, 0.0]), "on its sphere");
        assert!(!room.contains([0.0, 2.1]), "in no open ball");
        assert!(SiteRegion::default().contains([9.0, 9.0]));
    }
}
