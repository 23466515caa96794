//! By how much interfaces must give way for regions to have their volumes.

/// A pressure for each region such that every region has the volume that it lacks once each interface
/// moves by the difference of the pressures on its two sides. `areas` are those of interfaces between
/// pairs of regions. What no interface can change is left.
pub fn pressures(lacking: &[f64], areas: &[([u8; 2], f64)]) -> Vec<f64> {
    let count = lacking.len();
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

#[cfg(test)]
mod tests {
    use super::*;

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
