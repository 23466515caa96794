//! How normals vary from cell to cell beyond what one sheet that bends would have.

use super::ambiguity::trace;
use crate::feature::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::geometry::{dot, solve_positive, sub};
use crate::parallel::prelude::*;

/// Variance (samples squared) along a sheet below which places are too close together to tell how it bends.
const MIN_PLACE_VARIANCE: f64 = 1.0;

/// What the points of a cell say together: noise, which differs from point to point, is averaged.
#[derive(Clone, Copy)]
struct CellMean<const D: usize> {
    /// Number of points.
    weight: f64,
    position: [f64; D],
    normal: [f64; D],
}

/// Of each cell, the mean square deviation (of unit vectors, so the square of an angle) of the normals of the cells
/// round it, itself among them, from normals that vary linearly along the sheet, as those of one sheet do that
/// bends evenly. Zero where a cell has no points. `tensors` are the sums of the normals' tensors, `places` those
/// of positions; `beside` gives the cells round one.
pub fn normal_dispersion<const D: usize, I: Iterator<Item = usize>>(
    tensors: &[SymmetricMatrix<D>],
    places: &[[f64; D]],
    beside: impl Fn(usize) -> I + Sync,
) -> Vec<f64> {
    let mean = |(tensor, place): (&SymmetricMatrix<D>, &[f64; D])| {
        let weight = trace(tensor);
        (weight > 0.0).then(|| CellMean {
            weight,
            position: place.map(|x| x / weight),
            normal: eigenvector(tensor, eigenvalues(tensor)[D - 1]),
        })
    };
    let means: Vec<Option<CellMean<D>>> = tensors.par_iter().zip(places).map(mean).collect();
    let of_cell = |i: usize| {
        means[i].map_or(0.0, |_| {
            let near = || beside(i).filter_map(|j| means[j]);
            dispersion_about_surface(near)
        })
    };
    (0..means.len()).into_par_iter().map(of_cell).collect()
}

/// The mean square deviation of normals from n + B x, x along the sheet, by weighted least squares.
fn dispersion_about_surface<const D: usize, I: Iterator<Item = CellMean<D>>>(
    near: impl Fn() -> I,
) -> f64 {
    let (mut weight, mut centre, mut tensor) = (0.0, [0.0; D], [[0.0; D]; D]);
    for mean in near() {
        weight += mean.weight;
        for k in 0..D {
            centre[k] += mean.weight * mean.position[k];
            for l in 0..D {
                tensor[k][l] += mean.weight * mean.normal[k] * mean.normal[l];
            }
        }
    }
    let centre = centre.map(|x| x / weight);
    let main = eigenvector(&tensor, eigenvalues(&tensor)[D - 1]);
    // Both without what is square to the sheet, where normals do not vary and a sheet has no extent.
    let along = |v: [f64; D]| -> [f64; D] {
        let across = dot(v, main);
        std::array::from_fn(|k| v[k] - across * main[k])
    };
    let turned = |normal: [f64; D]| along(normal.map(|c| c * dot(normal, main).signum()));
    let mut middle = [0.0; D];
    for mean in near() {
        let turn = turned(mean.normal);
        (0..D).for_each(|k| middle[k] += mean.weight / weight * turn[k]);
    }
    // Second moments of places, of normals with places, and of normals.
    let (mut extent, mut common, mut square) = ([[0.0; D]; D], [[0.0; D]; D], 0.0);
    for mean in near() {
        let share = mean.weight / weight;
        let (x, turn) = (
            along(sub(mean.position, centre)),
            sub(turned(mean.normal), middle),
        );
        square += share * dot(turn, turn);
        for k in 0..D {
            for l in 0..D {
                extent[k][l] += share * x[k] * x[l];
                common[k][l] += share * turn[k] * x[l];
            }
        }
    }
    let mut held = extent;
    (0..D).for_each(|k| held[k][k] += MIN_PLACE_VARIANCE);
    common.iter().fold(square, |left, row| {
        let bend = solve_positive(held, *row);
        let explained: f64 = (0..D).map(|k| bend[k] * dot(extent[k], bend)).sum();
        left - 2.0 * dot(bend, *row) + explained
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::oriented::ambiguity::{CELL_SIZE, cells_around};
    use crate::feature::volume::Volume;
    use crate::geometry::unit;

    /// The largest spread over 6^3 cells, of points each with its normal.
    fn max_dispersion(points: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> f64 {
        let cells = Volume::new([6; 3], &[]);
        let (mut tensors, mut places) = (vec![[[0.0; 3]; 3]; 216], vec![[0.0; 3]; 216]);
        for (place, normal) in points {
            let cell = cells.index(place.map(|x| x as usize / CELL_SIZE));
            for k in 0..3 {
                places[cell][k] += place[k];
                (0..3).for_each(|l| tensors[cell][k][l] += normal[k] * normal[l]);
            }
        }
        let all = normal_dispersion(&tensors, &places, |cell| cells_around(&cells, cell, 1));
        all.into_iter().fold(0.0, f64::max)
    }

    fn grid() -> impl Iterator<Item = (f64, f64)> {
        (0..576).map(|i| (f64::from(i % 24), f64::from(i / 24)))
    }

    /// A plane through the middle, along y, that is turned about y by `degrees`.
    fn plane(degrees: f64) -> impl Iterator<Item = ([f64; 3], [f64; 3])> {
        let (sin, cos) = degrees.to_radians().sin_cos();
        grid().filter_map(move |(x, y)| {
            let z = 12.0 + (x - 12.0) * sin / cos;
            (0.0..24.0)
                .contains(&z)
                .then_some(([x, y, z], [-sin, 0.0, cos]))
        })
    }

    #[test]
    fn one_sheet_has_no_spread_however_it_bends() {
        assert!(max_dispersion(plane(20.0)) < 1e-12);
        // A sphere of radius 30, whose normals turn by 23 degrees over the 12 samples that are looked at.
        let sphere = grid().filter_map(|(x, y)| {
            let (a, b): (f64, f64) = (x - 12.0, y - 12.0);
            let c = (900.0 - a * a - b * b).sqrt();
            Some(([x, y, c - 18.0], unit([a, b, c]))).filter(|p| p.0[2] >= 0.0)
        });
        let all: f64 = (6.0f64 / 30.0).powi(2);
        let spread = max_dispersion(sphere);
        assert!(spread < 0.1 * all, "{spread} of {all}");
    }

    #[test]
    fn two_sheets_have_the_square_of_half_the_angle_between_them() {
        for angle in [20.0, 40.0] {
            let spread = max_dispersion(plane(0.5 * angle).chain(plane(-0.5 * angle)));
            let half = (0.5f64 * angle).to_radians().sin().powi(2);
            // Both are in one cell at the line itself, where their mean is seen.
            assert!(
                (0.5 * half..1.05 * half).contains(&spread),
                "{spread}, {half}"
            );
        }
    }
}
