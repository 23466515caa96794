//! Marked cells of a grid.

use std::ops::Range;

use crate::parallel::prelude::*;

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

/// Of a grid of `dims` bricks, each of `edge` cells of length `step` along every axis, those that are no farther than
/// `reach` from some positions along each axis.
pub fn bricks_near<const D: usize>(
    positions: &[[f64; D]],
    reach: f64,
    dims: [usize; D],
    (edge, step): (usize, [f64; D]),
) -> Vec<bool> {
    let mut marks = vec![false; dims.iter().product()];
    for x in positions {
        let ranges: [Range<usize>; D] = std::array::from_fn(|k| {
            // A cast cuts off what is below zero.
            let brick = |x: f64| ((x / step[k]) as usize / edge).min(dims[k] - 1);
            brick(x[k] - reach)..brick(x[k] + reach) + 1
        });
        for number in 0..ranges.iter().map(Range::len).product() {
            let mut rest = number;
            let at: [usize; D] = std::array::from_fn(|k| {
                let at = ranges[k].start + rest % ranges[k].len();
                rest /= ranges[k].len();
                at
            });
            marks[(0..D).rev().fold(0, |brick, k| brick * dims[k] + at[k])] = true;
        }
    }
    marks
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

    #[test]
    fn bricks_near_positions_are_marked() {
        // Bricks of four cells that are half as long along x as along y.
        let (dims, bricks) = ([5, 4], (4, [0.5, 1.0]));
        let marked = |x: [f64; 2], reach: f64| -> Vec<usize> {
            let marks = bricks_near(&[x], reach, dims, bricks);
            (0..20).filter(|&brick| marks[brick]).collect()
        };
        assert_eq!(marked([3.0, 6.0], 0.0), [6]);
        assert_eq!(marked([3.0, 6.0], 1.5), [5, 6, 7]);
        assert_eq!(marked([0.5, 15.9], 4.5), [10, 11, 12, 15, 16, 17]);
        assert_eq!(marked([99.0, -1.0], 3.0), [4]);
    }
}
