//! Nominal distance d(x) from the spacing of given atoms.

use crate::geometry::cell_list::CellList;
use crate::geometry::distance2;
use crate::image::ScalarField;
use crate::lattice::distance::{Distance, limit_gradient, lower_cell_corners};
use crate::progress::CancelToken;

/// Step of the grid of d, in units of the mean distance between atoms.
const SAMPLE_SPACING_RATIO: f64 = 0.5;

/// Returns d(x) of atoms in the box `[0, extent]`: at every atom the distance of its nearest
/// neighbour, growing away from it by `growth` per lattice unit, up to half the box's shortest
/// side.
pub fn distance_from_atoms<const D: usize>(
    positions: &[[f64; D]],
    extent: [f64; D],
    growth: f64,
    cancel: &CancelToken<'_>,
) -> Distance<D> {
    let nearest = nearest_neighbours(positions, extent);
    let max = extent.iter().fold(f64::INFINITY, |a, &e| a.min(e)) / 2.0;
    let volume: f64 = extent.iter().product();
    let spacing =
        SAMPLE_SPACING_RATIO * (volume / positions.len().max(1) as f64).powf(1.0 / D as f64);
    let cells = extent.map(|e| (e / spacing).ceil().max(1.0) as usize);
    let dims = cells.map(|c| c + 1);
    let step: [f64; D] = std::array::from_fn(|k| extent[k] / cells[k] as f64);
    let mut field = ScalarField {
        dims,
        step,
        samples: vec![max as f32; dims.iter().product()],
    };
    for (&x, &d) in positions.iter().zip(&nearest) {
        lower_cell_corners(&mut field, x, d as f32);
    }
    limit_gradient(&mut field, growth, cancel);
    Distance::Field(field)
}

/// Returns the distance of each point from its nearest neighbour. There must be at least two
/// points.
pub fn nearest_neighbours<const D: usize>(positions: &[[f64; D]], extent: [f64; D]) -> Vec<f64> {
    let volume: f64 = extent.iter().product();
    let edge = (volume / positions.len().max(1) as f64).powf(1.0 / D as f64);
    let cells = CellList::new(positions, edge);
    let nearest = |n: usize| {
        let (mut best, mut radius) = (f64::INFINITY, edge);
        loop {
            cells.visit_within(positions[n], radius, |m| {
                if m != n {
                    best = best.min(distance2(&positions[m], &positions[n]));
                }
            });
            if best <= radius * radius {
                return best.sqrt();
            }
            radius *= 2.0;
        }
    };
    (0..positions.len()).map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    fn random_points<const D: usize>(count: u32, extent: [f64; D]) -> Vec<[f64; D]> {
        let mut random = Random::new(1);
        // Points are dense at one end of the box and sparse at the other.
        (0..count)
            .map(|_| std::array::from_fn(|k| extent[k] * random.draw().powi(2)))
            .collect()
    }

    fn check_against_brute_force<const D: usize>(extent: [f64; D]) {
        let positions = random_points(300, extent);
        let brute_force = |n: usize| {
            let squares = |m: usize| -> f64 {
                (0..D)
                    .map(|k| (positions[m][k] - positions[n][k]).powi(2))
                    .sum()
            };
            let others = (0..positions.len()).filter(|&m| m != n);
            others.map(squares).fold(f64::INFINITY, f64::min).sqrt()
        };
        for (n, distance) in nearest_neighbours(&positions, extent).iter().enumerate() {
            assert!((distance - brute_force(n)).abs() < 1e-12);
        }
    }

    #[test]
    fn nearest_neighbours_in_the_plane_and_in_space() {
        check_against_brute_force([40.0, 25.0]);
        check_against_brute_force([40.0, 25.0, 30.0]);
    }

    #[test]
    fn distance_is_that_of_the_atoms() {
        let extent = [60.0, 48.0];
        let grid = |i: u32| [f64::from(i % 16) * 4.0, f64::from(i / 16) * 4.0];
        let positions: Vec<[f64; 2]> = (0..16 * 13).map(grid).collect();
        let distance = distance_from_atoms(&positions, extent, 0.3, &CancelToken::never());
        distance.validate(extent).unwrap();
        for x in [[10.0, 10.0], [31.5, 17.25], [0.0, 48.0]] {
            let d = distance.value_at(x);
            assert!((4.0..4.9).contains(&d), "{d}");
        }
        // Far from all atoms d is larger.
        let sparse = [[0.0, 0.0], [4.0, 0.0], [60.0, 48.0], [60.0, 44.0]];
        let distance = distance_from_atoms(&sparse, extent, 0.3, &CancelToken::never());
        assert!(distance.value_at([30.0, 24.0]) > 8.0);
        assert!((distance.value_at([0.0, 0.0]) - 4.0).abs() < 1e-6);
    }
}
