//! Indices and memory offsets of the cells of a regular grid; the first axis is the fastest.

use super::vector::Real;

/// Returns the index along each axis of the cell at an offset in memory.
#[inline]
pub fn index_at<const D: usize>(dims: [usize; D], mut offset: usize) -> [usize; D] {
    dims.map(|n| {
        let index = offset % n;
        offset /= n;
        index
    })
}

/// Returns the offset in memory of the cell with an index along each axis.
#[inline]
pub fn offset_of<const D: usize>(dims: [usize; D], index: [usize; D]) -> usize {
    (0..D)
        .rev()
        .fold(0, |offset, k| offset * dims[k] + index[k])
}

/// Returns the offsets in memory at which the rows along the first axis of a block begin. The block
/// has `size` cells along each axis; its first cell is at index `first`.
pub fn block_rows<const D: usize>(
    dims: [usize; D],
    first: [usize; D],
    size: [usize; D],
) -> impl Iterator<Item = usize> {
    let mut row_grid = size;
    row_grid[0] = 1;
    (0..row_grid.iter().product()).map(move |row| {
        let in_block = index_at(row_grid, row);
        offset_of(dims, std::array::from_fn(|k| first[k] + in_block[k]))
    })
}

/// Calls `visit` with the offset and the weight of each sample from which the value at a fractional
/// index is interpolated linearly. Outside the grid the nearest samples count. `to_weight` converts
/// fractions to the type of the weights. Samples of weight 0 are left out, because they may be NaN.
#[inline]
pub fn for_each_corner<const D: usize, T: Real + From<u8>>(
    dims: [usize; D],
    index: [f64; D],
    to_weight: impl Fn(f64) -> T,
    mut visit: impl FnMut(usize, T),
) {
    let strides = strides(dims);
    for corner in 0..1usize << D {
        let (mut weight, mut offset) = (T::from(1), 0);
        for k in 0..D {
            let last = dims[k] - 1;
            let x = index[k].clamp(0.0, last as f64);
            let low = (x as usize).min(last.saturating_sub(1));
            let t = to_weight(x - low as f64);
            let (sample, factor) = match corner >> k & 1 {
                0 => (low, T::from(1) - t),
                _ => ((low + 1).min(last), t),
            };
            weight = weight * factor;
            offset += sample * strides[k];
        }
        if weight > T::default() {
            visit(offset, weight);
        }
    }
}

/// Returns the distance in memory between neighbours along each axis.
#[inline]
pub fn strides<const D: usize>(dims: [usize; D]) -> [usize; D] {
    let mut next = 1;
    dims.map(|n| {
        let stride = next;
        next *= n;
        stride
    })
}
