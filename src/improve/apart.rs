//! Atoms that were moved one by one must not end at one place.

/// Moves atoms back that came nearer than `gap` to another: `before` holds where each atom was, and
/// there they all were farther apart. Of two that meet, the one of the higher number goes back.
/// Returns how many did.
pub fn keep_apart(positions: &mut [[f64; 3]], before: &[[f64; 3]], gap: f64) -> usize {
    let mut returned = 0;
    // One that goes back may meet another that has come near its old place: look again.
    loop {
        let moved = |k: usize| positions[k] != before[k];
        let mut cells: Vec<([i64; 3], usize)> = positions
            .iter()
            .enumerate()
            .map(|(k, &x)| (cell(x, gap), k))
            .collect();
        cells.sort_unstable();
        let meets = |k: usize| {
            let [a, b, c] = cell(positions[k], gap);
            (0..27).any(|n| {
                let wanted = [a + n % 3 - 1, b + n / 3 % 3 - 1, c + n / 9 - 1];
                let first = cells.partition_point(|(cell, _)| *cell < wanted);
                cells[first..]
                    .iter()
                    .take_while(|(cell, _)| *cell == wanted)
                    .any(|&(_, other)| {
                        let square: f64 = (0..3)
                            .map(|axis| (positions[k][axis] - positions[other][axis]).powi(2))
                            .sum();
                        other != k && square < gap * gap && (other < k || !moved(other))
                    })
            })
        };
        let back: Vec<usize> = (0..positions.len())
            .filter(|&k| moved(k) && meets(k))
            .collect();
        if back.is_empty() {
            return returned;
        }
        for &k in &back {
            positions[k] = before[k];
        }
        returned += back.len();
    }
}

fn cell(x: [f64; 3], size: f64) -> [i64; 3] {
    x.map(|c| (c / size).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_that_meet_one_goes_back_and_may_push_a_third() {
        let before = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [9.0, 0.0, 0.0]];
        // 0 and 1 meet at 0.5; 2 has gone to where 1 must return to.
        let mut positions = [
            [0.5, 0.0, 0.0],
            [0.5, 0.01, 0.0],
            [1.0, 0.0, 0.02],
            [9.5, 0.0, 0.0],
        ];
        assert_eq!(keep_apart(&mut positions, &before, 0.1), 2);
        assert_eq!(
            positions,
            [[0.5, 0.0, 0.0], before[1], before[2], [9.5, 0.0, 0.0]]
        );
    }
}
