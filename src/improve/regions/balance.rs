//! Computes by how much interfaces must move so that regions have their volumes.

use crate::geometry::conjugate_gradients::LinearSystem;

/// Returns a pressure for each region. Each region gains the volume `deficits` that it lacks if
/// every interface moves by the difference of the pressures on its two sides. `areas` has the areas
/// of the interfaces between pairs of regions. A deficit that no interface can change remains.
pub fn pressures(deficits: &[f64], areas: &[([u32; 2], f64)]) -> Vec<f64> {
    let count = deficits.len();
    if count > MAX_DENSE_REGIONS {
        return sparse_pressures(deficits, areas);
    }
    let mut matrix = vec![vec![0.0; count + 1]; count];
    for (row, &deficit) in matrix.iter_mut().zip(deficits) {
        row[count] = deficit;
    }
    let mut total_area = 0.0;
    for &([a, b], area) in areas {
        let (a, b) = (a as usize, b as usize);
        matrix[a][a] += area;
        matrix[b][b] += area;
        matrix[a][b] -= area;
        matrix[b][a] -= area;
        total_area += area;
    }
    // The equations determine the pressures only up to a constant.
    let diagonal_shift = 1e-9 * total_area.max(f64::MIN_POSITIVE);
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += diagonal_shift;
    }
    for i in 0..count {
        let (above, below) = matrix.split_at_mut(i + 1);
        let pivot = &above[i];
        if pivot[i] <= 0.0 {
            continue;
        }
        for row in below {
            let factor = row[i] / pivot[i];
            if factor != 0.0 {
                for (x, p) in row[i..].iter_mut().zip(&pivot[i..]) {
                    *x -= factor * p;
                }
            }
        }
    }
    let mut pressure = vec![0.0; count];
    for i in (0..count).rev() {
        let known_sum: f64 = (i + 1..count).map(|j| matrix[i][j] * pressure[j]).sum();
        if matrix[i][i] > 0.0 {
            pressure[i] = (matrix[i][count] - known_sum) / matrix[i][i];
        }
    }
    pressure
}

/// Largest number of regions for which the equations are solved by elimination.
const MAX_DENSE_REGIONS: usize = 255;

/// Relative residual at which conjugate gradients stop.
const RESIDUAL_TOLERANCE: f64 = 1e-10;
/// Largest number of conjugate gradient steps per region.
const MAX_STEPS_PER_REGION: usize = 2;

/// Returns the pressures of many regions by conjugate gradients. Sums are in the order of the
/// regions.
fn sparse_pressures(deficits: &[f64], areas: &[([u32; 2], f64)]) -> Vec<f64> {
    let count = deficits.len();
    let total_area: f64 = areas.iter().map(|(_, area)| area).sum();
    let diagonal_shift = 1e-9 * total_area.max(f64::MIN_POSITIVE);
    let mut diagonal = vec![diagonal_shift; count];
    for &([a, b], area) in areas {
        diagonal[a as usize] += area;
        diagonal[b as usize] += area;
    }
    let apply_matrix = |x: &[f64]| {
        let mut y: Vec<f64> = x.iter().zip(&diagonal).map(|(x, d)| x * d).collect();
        for &([a, b], area) in areas {
            let (a, b) = (a as usize, b as usize);
            y[a] -= area * x[b];
            y[b] -= area * x[a];
        }
        y
    };
    let system = LinearSystem {
        times: apply_matrix,
        diagonal: &diagonal,
        right_side: deficits,
    };
    let mut pressure = vec![0.0; count];
    let scale = system.squared_norm(deficits);
    let tolerance = RESIDUAL_TOLERANCE * RESIDUAL_TOLERANCE * scale;
    system.improve(&mut pressure, tolerance, MAX_STEPS_PER_REGION * count);
    pressure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_regions_have_the_pressures_that_elimination_gives() {
        let count = 40u32;
        let ring = (0..count).map(|i| [i, (i + 1) % count]);
        let areas: Vec<_> = ring
            .map(|[a, b]| ([a.min(b), a.max(b)], 1.0 + f64::from(a % 7)))
            .collect();
        let mut deficits: Vec<f64> = (0..count).map(|i| f64::from(i * 13 % 11)).collect();
        let mean = deficits.iter().sum::<f64>() / f64::from(count);
        deficits.iter_mut().for_each(|l| *l -= mean);
        let [dense, sparse] = [
            pressures(&deficits, &areas),
            sparse_pressures(&deficits, &areas),
        ];
        for i in 1..count as usize {
            let [d, s] = [&dense, &sparse].map(|p| p[i] - p[0]);
            assert!((d - s).abs() < 1e-6, "{i}: {d} {s}");
        }
    }

    #[test]
    fn pressures_fill_the_volume_deficits_of_regions() {
        let areas = [([0, 1], 10.0), ([1, 2], 4.0), ([0, 2], 1.0)];
        let deficits = [-3.0, 1.0, 2.0];
        let p = pressures(&deficits, &areas);
        for (region, deficit) in deficits.iter().enumerate() {
            let grown: f64 = areas
                .iter()
                .map(|&([a, b], area)| {
                    let moved = area * (p[a as usize] - p[b as usize]);
                    if a as usize == region {
                        moved
                    } else if b as usize == region {
                        -moved
                    } else {
                        0.0
                    }
                })
                .sum();
            assert!((grown - deficit).abs() < 1e-6, "{region}: {grown}");
        }
    }
}
