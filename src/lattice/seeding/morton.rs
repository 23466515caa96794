//! Memory order of atoms along a Morton curve, so that neighbours in space are near in memory.

use crate::parallel::prelude::*;

/// Sorts positions in the box `[0, extent]` along a Morton (Z-order) [`MortonCurve`] through cubes
/// of edge `cell`. Inside a cube, positions keep their order.
pub fn sort_by_curve<const D: usize>(positions: &mut Vec<[f64; D]>, extent: [f64; D], cell: f64) {
    let curve = MortonCurve::new(extent, cell);
    let mut keyed: Vec<(u64, u32)> = positions
        .par_iter()
        .enumerate()
        .map(|(n, x)| (curve.key(*x), n as u32))
        .collect();
    keyed.par_sort_unstable();
    let sorted = keyed.par_iter().map(|&(_, n)| positions[n as usize]);
    *positions = sorted.collect();
}

/// A Morton (Z-order) curve through the cubes of a box.
pub struct MortonCurve<const D: usize> {
    extent: [f64; D],
    cell: f64,
    /// Bits of a cube's index along an axis.
    bits_per_axis: usize,
}

impl<const D: usize> MortonCurve<D> {
    /// Creates a curve through cubes of edge `cell` in the box `[0, extent]`.
    pub fn new(extent: [f64; D], cell: f64) -> Self {
        let max_index = extent.iter().fold(0.0f64, |a, &b| a.max(b)) / cell;
        let bits_per_axis = (64 - (max_index as u64).leading_zeros() as usize).min(63 / D);
        Self {
            extent,
            cell,
            bits_per_axis,
        }
    }

    /// Returns the position along the curve of the cube that contains `x`.
    pub fn key(&self, x: [f64; D]) -> u64 {
        let mut key = 0u64;
        for (axis, &coordinate) in x.iter().enumerate() {
            let index = (coordinate.clamp(0.0, self.extent[axis]) / self.cell) as u64;
            for bit in 0..self.bits_per_axis {
                key |= (index >> bit & 1) << (bit * D + axis);
            }
        }
        key
    }

    /// Returns which of `count` segments of the curve contains a key. `count` must be a power of
    /// two.
    pub fn segment(&self, key: u64, count: usize) -> usize {
        let bits = (self.bits_per_axis * D) as u32;
        (key >> bits.saturating_sub(count.ilog2())) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_in_memory_are_neighbours_in_space() {
        let mut positions: Vec<[f64; 3]> = (0..4096)
            .map(|n| std::array::from_fn(|k| f64::from((n * 37 % 4096) >> (4 * k) & 15)))
            .collect();
        sort_by_curve(&mut positions, [15.0; 3], 1.0);
        let steps: f64 = positions
            .windows(2)
            .map(|w| (0..3).map(|k| (w[0][k] - w[1][k]).abs()).sum::<f64>())
            .sum();
        assert!(steps / 4095.0 < 3.0);
        assert_eq!(positions[0], [0.0; 3]);
        assert_eq!(positions[4095], [15.0; 3]);
    }
}
