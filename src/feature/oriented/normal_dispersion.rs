//! Measures how normals vary from cell to cell, beyond the variation of a single curved surface.

use super::ambiguity::trace;
use crate::geometry::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::geometry::{add_scaled, dot, solve_positive, sub};
use crate::parallel::prelude::*;

/// Smallest variance (samples squared) of positions along a surface that is used to fit its
/// curvature.
const MIN_PLACE_VARIANCE: f64 = 1.0;

/// Mean of the points of a cell, which averages noise.
#[derive(Clone, Copy)]
struct CellMean<const D: usize> {
    /// Number of points.
    weight: f64,
    position: [f64; D],
    normal: [f64; D],
}

/// Returns, for each cell, the mean square deviation of the normals of the cell and the cells
/// around it from normals that vary linearly along the surface, as those of an evenly curved
/// surface do. Normals are unit vectors, so that the result is the square of an angle in radians.
/// It is 0 for a cell without points. `tensors` are the sums of the normals' tensors,
/// `position_sums` those of positions, and `neighbours` returns a cell and the cells around it.
pub fn normal_dispersion<const D: usize, I: Iterator<Item = usize>>(
    tensors: &[SymmetricMatrix<D>],
    position_sums: &[[f64; D]],
    neighbours: impl Fn(usize) -> I + Sync,
) -> Vec<f64> {
    let mean = |(tensor, place): (&SymmetricMatrix<D>, &[f64; D])| {
        let weight = trace(tensor);
        (weight > 0.0).then(|| CellMean {
            weight,
            position: place.map(|x| x / weight),
            normal: eigenvector(tensor, eigenvalues(tensor)[D - 1]),
        })
    };
    let means: Vec<Option<CellMean<D>>> = tensors.par_iter().zip(position_sums).map(mean).collect();
    let dispersion_at = |i: usize| {
        means[i].map_or(0.0, |_| {
            let means_around = || neighbours(i).filter_map(|j| means[j]);
            dispersion_about_surface(means_around)
        })
    };
    (0..means.len())
        .into_par_iter()
        .map(dispersion_at)
        .collect()
}

/// Returns the mean square deviation of normals from n + B x, with x along the surface, by weighted
/// least squares.
fn dispersion_about_surface<const D: usize, I: Iterator<Item = CellMean<D>>>(
    means: impl Fn() -> I,
) -> f64 {
    let (mut weight, mut centre, mut tensor) = (0.0, [0.0; D], [[0.0; D]; D]);
    for mean in means() {
        weight += mean.weight;
        for k in 0..D {
            centre[k] += mean.weight * mean.position[k];
            for l in 0..D {
                tensor[k][l] += mean.weight * mean.normal[k] * mean.normal[l];
            }
        }
    }
    let centre = centre.map(|x| x / weight);
    let mean_normal = eigenvector(&tensor, eigenvalues(&tensor)[D - 1]);
    // Removes the component along the mean normal, along which normals do not vary and a surface
    // has no extent.
    let project = |v: [f64; D]| -> [f64; D] {
        let normal_part = dot(v, mean_normal);
        add_scaled(v, -normal_part, mean_normal)
    };
    let tangential =
        |normal: [f64; D]| project(normal.map(|c| c * dot(normal, mean_normal).signum()));
    let mut mean_tilt = [0.0; D];
    for mean in means() {
        let tilt = tangential(mean.normal);
        (0..D).for_each(|k| mean_tilt[k] += mean.weight / weight * tilt[k]);
    }
    // Second moments of positions, of normals with positions, and of normals.
    let (mut extent, mut covariance, mut variance) = ([[0.0; D]; D], [[0.0; D]; D], 0.0);
    for mean in means() {
        let fraction = mean.weight / weight;
        let (x, tilt) = (
            project(sub(mean.position, centre)),
            sub(tangential(mean.normal), mean_tilt),
        );
        variance += fraction * dot(tilt, tilt);
        for k in 0..D {
            for l in 0..D {
                extent[k][l] += fraction * x[k] * x[l];
                covariance[k][l] += fraction * tilt[k] * x[l];
            }
        }
    }
    let mut regularized = extent;
    (0..D).for_each(|k| regularized[k][k] += MIN_PLACE_VARIANCE);
    covariance.iter().fold(variance, |remaining, row| {
        let slope = solve_positive(regularized, *row);
        let explained: f64 = (0..D).map(|k| slope[k] * dot(extent[k], slope)).sum();
        remaining - 2.0 * dot(slope, *row) + explained
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::oriented::ambiguity::{CELL_SIZE, cells_around};
    use crate::feature::volume::Volume;
    use crate::geometry::unit;

    /// Returns the largest dispersion over 6^3 cells of points with normals.
    fn max_dispersion(points: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> f64 {
        let cells = Volume::new([6; 3], &[]);
        let (mut tensors, mut position_sums) = (vec![[[0.0; 3]; 3]; 216], vec![[0.0; 3]; 216]);
        for (position, normal) in points {
            let cell = cells.index(position.map(|x| x as usize / CELL_SIZE));
            for k in 0..3 {
                position_sums[cell][k] += position[k];
                (0..3).for_each(|l| tensors[cell][k][l] += normal[k] * normal[l]);
            }
        }
        let dispersion = normal_dispersion(&tensors, &position_sums, |cell| {
            cells_around(&cells, cell, 1)
        });
        dispersion.into_iter().fold(0.0, f64::max)
    }

    fn grid() -> impl Iterator<Item = (f64, f64)> {
        (0..576).map(|i| (f64::from(i % 24), f64::from(i / 24)))
    }

    /// Returns points of a plane through the middle, along y, that is turned about y by `degrees`.
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
    fn a_single_surface_has_no_dispersion() {
        assert!(max_dispersion(plane(20.0)) < 1e-12);
        // A sphere of radius 30, whose normals turn by 23 degrees over the 12 samples of a
        // neighbourhood.
        let sphere = grid().filter_map(|(x, y)| {
            let (a, b): (f64, f64) = (x - 12.0, y - 12.0);
            let c = (900.0 - a * a - b * b).sqrt();
            Some(([x, y, c - 18.0], unit([a, b, c]))).filter(|p| p.0[2] >= 0.0)
        });
        let total: f64 = (6.0f64 / 30.0).powi(2);
        let dispersion = max_dispersion(sphere);
        assert!(dispersion < 0.1 * total, "{dispersion} of {total}");
    }

    #[test]
    fn two_surfaces_have_the_squared_sine_of_half_their_angle() {
        for angle in [20.0, 40.0] {
            let dispersion = max_dispersion(plane(0.5 * angle).chain(plane(-0.5 * angle)));
            let half = (0.5f64 * angle).to_radians().sin().powi(2);
            // At the line itself, both planes are in one cell, of which only the mean counts.
            assert!(
                (0.5 * half..1.05 * half).contains(&dispersion),
                "{dispersion}, {half}"
            );
        }
    }
}
