//! Marks the neighbourhood of marked cells or of positions in a grid.

use std::ops::Range;

use super::grid_index::{index_at, offset_of};
use crate::parallel::prelude::*;

/// Marks the `radius` cells on both sides of every marked cell along one axis.
pub fn dilate<const D: usize>(marks: &mut [bool], dims: [usize; D], axis: usize, radius: usize) {
    if marks.is_empty() || radius == 0 {
        return;
    }
    let (row_len, n) = (dims[0], dims[axis]);
    // Count of rows between neighbours along any axis other than x.
    let row_stride = dims[..axis].iter().skip(1).product::<usize>();
    let previous = marks.to_vec();
    let rows = marks.par_chunks_mut(row_len).enumerate();
    rows.for_each(|(number, marks)| {
        let c = number / row_stride % n;
        let range_around = |c: usize| c.saturating_sub(radius)..(c + radius + 1).min(n);
        if axis == 0 {
            let source_row = &previous[number * row_len..(number + 1) * row_len];
            for (x, mark) in marks.iter_mut().enumerate() {
                *mark = source_row[range_around(x)].contains(&true);
            }
            return;
        }
        for neighbour in range_around(c) {
            let neighbour = number + neighbour * row_stride - c * row_stride;
            for (mark, is_marked) in marks.iter_mut().zip(&previous[neighbour * row_len..]) {
                *mark |= is_marked;
            }
        }
    });
}

/// Marks the bricks that are within `radius` of a position along each axis. The grid has `dims`
/// bricks; each brick has `edge` cells along every axis, and cells have the size `step`.
pub fn bricks_near<const D: usize>(
    positions: &[[f64; D]],
    radius: f64,
    dims: [usize; D],
    edge: usize,
    step: [f64; D],
) -> Vec<bool> {
    let mut marks = vec![false; dims.iter().product()];
    for x in positions {
        let ranges: [Range<usize>; D] = std::array::from_fn(|k| {
            // The cast turns negative values to zero.
            let brick = |x: f64| ((x / step[k]) as usize / edge).min(dims[k] - 1);
            brick(x[k] - radius)..brick(x[k] + radius) + 1
        });
        let span: [usize; D] = std::array::from_fn(|k| ranges[k].len());
        for number in 0..span.iter().product() {
            let within = index_at(span, number);
            let index = std::array::from_fn(|k| ranges[k].start + within[k]);
            marks[offset_of(dims, index)] = true;
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
        let coordinates = |i: usize| index_at(dims, i);
        for radius in 0..4 {
            for axis in 0..3 {
                let original: Vec<bool> = (0..60).map(|i| i % 17 == 3).collect();
                let mut marks = original.clone();
                dilate(&mut marks, dims, axis, radius);
                let is_near = |i: usize, j: usize| {
                    (0..3).all(|k| {
                        let max = if k == axis { radius } else { 0 };
                        coordinates(i)[k].abs_diff(coordinates(j)[k]) <= max
                    })
                };
                for (i, mark) in marks.into_iter().enumerate() {
                    assert_eq!(mark, (0..60).any(|j| original[j] && is_near(i, j)));
                }
            }
        }
        dilate(&mut [], [0; 3], 0, 1);
    }

    #[test]
    fn bricks_near_positions_are_marked() {
        // Bricks of four cells, which are half as long along x as along y.
        let dims = [5, 4];
        let marked = |x: [f64; 2], radius: f64| -> Vec<usize> {
            let marks = bricks_near(&[x], radius, dims, 4, [0.5, 1.0]);
            (0..20).filter(|&brick| marks[brick]).collect()
        };
        assert_eq!(marked([3.0, 6.0], 0.0), [6]);
        assert_eq!(marked([3.0, 6.0], 1.5), [5, 6, 7]);
        assert_eq!(marked([0.5, 15.9], 4.5), [10, 11, 12, 15, 16, 17]);
        assert_eq!(marked([99.0, -1.0], 3.0), [4]);
    }
}
