//! Marked cells of a grid.

use rayon::prelude::*;

/// Marks the `reach` cells on both sides of every marked cell, along one axis.
pub fn dilate<const D: usize>(marks: &mut [bool], dims: [usize; D], axis: usize, reach: usize) {
    if marks.is_empty() || reach == 0 {
        return;
    }
    let (row, n) = (dims[0], dims[axis]);
    // Neighbours along other axes than x are so many rows apart.
    let apart = dims[..axis].iter().skip(1).product::<usize>();
    let before = marks.to_vec();
    let rows = marks.par_chunks_mut(row).enumerate();
    rows.for_each(|(number, marks)| {
        let c = number / apart % n;
        let beside = |c: usize| c.saturating_sub(reach)..(c + reach + 1).min(n);
        if axis == 0 {
            let own = &before[number * row..(number + 1) * row];
            for (x, mark) in marks.iter_mut().enumerate() {
                *mark = own[beside(x)].contains(&true);
            }
            return;
        }
        for other in beside(c) {
            let other = number + other * apart - c * apart;
            for (mark, there) in marks.iter_mut().zip(&before[other * row..]) {
                *mark |= there;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_within_reach_along_an_axis_are_marked() {
        let dims = [5, 4, 3];
        let at = |i: usize| [i % 5, i / 5 % 4, i / 20];
        for reach in 0..4 {
            for axis in 0..3 {
                let before: Vec<bool> = (0..60).map(|i| i % 17 == 3).collect();
                let mut marks = before.clone();
                dilate(&mut marks, dims, axis, reach);
                let near = |i: usize, j: usize| {
                    (0..3).all(|k| {
                        let most = if k == axis { reach } else { 0 };
                        at(i)[k].abs_diff(at(j)[k]) <= most
                    })
                };
                for (i, mark) in marks.into_iter().enumerate() {
                    assert_eq!(mark, (0..60).any(|j| before[j] && near(i, j)));
                }
            }
        }
        dilate(&mut [], [0; 3], 0, 1);
    }
}
