//! Where sites may stand, if not everywhere: in a part of a mesh of which the rest stays.

use crate::geometry::buckets::Buckets;
use crate::geometry::distance2;

/// A sphere round a point stays empty also of what rounding puts onto it.
const ROUNDING: f64 = 1e-9;

/// Balls in one of which sites have to stand, and those that stay empty.
#[derive(Debug, Default)]
pub struct Room<const D: usize> {
    /// Centres and radii; with none sites may stand anywhere.
    open: Vec<([f64; D], f64)>,
    closed: Vec<([f64; D], f64)>,
    grid: Option<Buckets<D>>,
    largest: f64,
}

impl<const D: usize> Room<D> {
    /// The places in the `open` balls that are in none of the `closed` ones. Nodes of Voronoi cells stay as
    /// long as no site enters the balls round them whose spheres bear their sites.
    pub fn new(open: Vec<([f64; D], f64)>, closed: Vec<([f64; D], f64)>) -> Self {
        let largest = closed.iter().fold(0.0f64, |most, ball| most.max(ball.1));
        let centres: Vec<[f64; D]> = closed.iter().map(|ball| ball.0).collect();
        Self {
            open,
            grid: (largest > 0.0).then(|| Buckets::new(&centres, largest)),
            closed,
            largest,
        }
    }

    /// Whether a site may stand there.
    pub fn holds(&self, x: [f64; D]) -> bool {
        let within =
            |ball: &([f64; D], f64), scale: f64| distance2(&ball.0, &x) < ball.1 * ball.1 * scale;
        let mut holds = self.open.is_empty() || self.open.iter().any(|ball| within(ball, 1.0));
        if let (true, Some(grid)) = (holds, &self.grid) {
            grid.visit_within(x, self.largest, |i| {
                holds = holds && !within(&self.closed[i], 1.0 + ROUNDING);
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
        let room = Room::new(vec![([0.0; 2], 2.0)], vec![([1.0, 0.0], 0.5)]);
        assert!(room.holds([0.0, 1.0]) && room.holds([0.4, 0.0]));
        assert!(!room.holds([0.6, 0.0]), "in a closed ball");
        assert!(!room.holds([0.5, 0.0]), "on its sphere");
        assert!(!room.holds([0.0, 2.1]), "in no open ball");
        assert!(Room::default().holds([9.0, 9.0]));
    }
}
