//! By how much interfaces must give way for regions to have their volumes.

/// A pressure for each region such that every region has the volume that it lacks once each interface
/// moves by the difference of the pressures on its two sides. `areas` are those of interfaces between
/// pairs of regions. What no interface can change is left.
pub fn pressures(lacking: &[f64], areas: &[([u32; 2], f64)]) -> Vec<f64> {
    let count = lacking.len();
    if count > MAX_DENSE_REGIONS {
        return sparse_pressures(lacking, areas);
    }
    let mut matrix = vec![vec![0.0; count + 1]; count];
    for (row, &lacks) in matrix.iter_mut().zip(lacking) {
        row[count] = lacks;
    }
    let mut whole = 0.0;
    for &([a, b], area) in areas {
        let (a, b) = (a as usize, b as usize);
        matrix[a][a] += area;
        matrix[b][b] += area;
        matrix[a][b] -= area;
        matrix[b][a] -= area;
        whole += area;
    }
    // Pressures are known but for a constant.
    let ground = 1e-9 * whole.max(f64::MIN_POSITIVE);
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += ground;
    }
    for i in 0..count {
        let (above, below) = matrix.split_at_mut(i + 1);
        let pivot = &above[i];
        if pivot[i] <= 0.0 {
            continue;
        }
        for row in below {
            let share = row[i] / pivot[i];
            if share != 0.0 {
                for (x, p) in row[i..].iter_mut().zip(&pivot[i..]) {
                    *x -= share * p;
                }
            }
        }
    }
    let mut pressure = vec![0.0; count];
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|j| matrix[i][j] * pressure[j]).sum();
        if matrix[i][i] > 0.0 {
            pressure[i] = (matrix[i][count] - known) / matrix[i][i];
        }
    }
    pressure
}

/// Up to so many regions the equations are solved by elimination.
const MAX_DENSE_REGIONS: usize = 255;

/// Conjugate gradients end where the residual is this share of what it was ...
const RESIDUAL_TOLERANCE: f64 = 1e-10;
/// ... and after so many steps for each region.
const MAX_STEPS_PER_REGION: usize = 2;

/// The pressures of many regions, by conjugate gradients (Hestenes and Stiefel 1952) with the diagonal as the
/// preconditioner; sums are in the order of the regions.
fn sparse_pressures(lacking: &[f64], areas: &[([u32; 2], f64)]) -> Vec<f64> {
    let count = lacking.len();
    let whole: f64 = areas.iter().map(|(_, area)| area).sum();
    let ground = 1e-9 * whole.max(f64::MIN_POSITIVE);
    let mut diagonal = vec![ground; count];
    for &([a, b], area) in areas {
        diagonal[a as usize] += area;
        diagonal[b as usize] += area;
    }
    let times = |x: &[f64]| {
        let mut y: Vec<f64> = x.iter().zip(&diagonal).map(|(x, d)| x * d).collect();
        for &([a, b], area) in areas {
            let (a, b) = (a as usize, b as usize);
            y[a] -= area * x[b];
            y[b] -= area * x[a];
        }
        y
    };
    let product = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let scaled = |r: &[f64]| -> Vec<f64> { r.iter().zip(&diagonal).map(|(r, d)| r / d).collect() };
    let mut pressure = vec![0.0; count];
    let mut residual = lacking.to_vec();
    let mut towards = scaled(&residual);
    let mut along = towards.clone();
    let mut size = product(&residual, &towards);
    let enough = RESIDUAL_TOLERANCE * RESIDUAL_TOLERANCE * size;
    for _ in 0..MAX_STEPS_PER_REGION * count {
        if size <= enough {
            break;
        }
        let image = times(&along);
        let step = size / product(&along, &image);
        if !step.is_finite() {
            break;
        }
        for i in 0..count {
            pressure[i] += step * along[i];
            residual[i] -= step * image[i];
        }
        towards = scaled(&residual);
        let next = product(&residual, &towards);
        for (along, towards) in along.iter_mut().zip(&towards) {
            *along = towards + next / size * *along;
        }
        size = next;
    }
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
        let mut lacking: Vec<f64> = (0..count).map(|i| f64::from(i * 13 % 11)).collect();
        let mean = lacking.iter().sum::<f64>() / f64::from(count);
        lacking.iter_mut().for_each(|l| *l -= mean);
        let [dense, sparse] = [
            pressures(&lacking, &areas),
            sparse_pressures(&lacking, &areas),
        ];
        for i in 1..count as usize {
            let [d, s] = [&dense, &sparse].map(|p| p[i] - p[0]);
            assert!((d - s).abs() < 1e-6, "{i}: {d} {s}");
        }
    }

    #[test]
    fn interfaces_move_by_what_regions_lack() {
        let areas = [([0, 1], 10.0), ([1, 2], 4.0), ([0, 2], 1.0)];
        let lacking = [-3.0, 1.0, 2.0];
        let p = pressures(&lacking, &areas);
        for (region, lacks) in lacking.iter().enumerate() {
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
            assert!((grown - lacks).abs() < 1e-6, "{region}: {grown}");
        }
    }
}
