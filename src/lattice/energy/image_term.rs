//! The image's part of the energy: b(x_i), and nothing where b is nothing.
//!
//! A potential with a few thin valleys is zero almost everywhere. Blocks of cells whose every tap is
//! zero are flagged once, and atoms in them cost one look-up instead of 4^D taps.

use crate::image::Field;

/// Cells along each axis of a block.
const BLOCK: usize = 2;

/// An image potential with the blocks in which it is nothing flagged.
#[derive(Clone)]
pub struct ImageTerm<'a, const D: usize> {
    field: &'a Field<D>,
    /// Whether a block has any sample (or tap) that is not zero, x fastest.
    occupied: Vec<bool>,
    /// Number of blocks along each axis.
    blocks: [usize; D],
    /// Blocks per unit of lattice space along each axis.
    scale: [f64; D],
}

impl<'a, const D: usize> ImageTerm<'a, D> {
    /// Flags the blocks of a field.
    pub fn new(field: &'a Field<D>) -> Self {
        let blocks = field.dims.map(|n| n.saturating_sub(1) / BLOCK + 1);
        let scale = std::array::from_fn(|k| 1.0 / (field.step[k] * BLOCK as f64));
        let mut occupied = vec![false; blocks.iter().product()];
        // The blocks along one axis whose cells have sample `s` as a tap: a sample is a tap of the
        // cells from two before it to one after it.
        let touched = |s: usize, k: usize| {
            let last = blocks[k] - 1;
            [
                (s.saturating_sub(2) / BLOCK).min(last),
                ((s + 1) / BLOCK).min(last),
            ]
        };
        for (row, line) in field.samples.chunks_exact(field.dims[0].max(1)).enumerate() {
            // First block of each row of blocks that this line of samples touches (2^(D-1) of them,
            // most often all the same).
            let mut firsts: Vec<usize> = vec![0];
            let (mut rest, mut stride) = (row, blocks[0]);
            for k in 1..D {
                let pair = touched(rest % field.dims[k], k);
                rest /= field.dims[k];
                firsts = firsts
                    .iter()
                    .flat_map(|f| pair.map(|b| f + b * stride))
                    .collect();
                stride *= blocks[k];
            }
            firsts.dedup();
            for (segment, samples) in line.chunks(BLOCK).enumerate() {
                if samples.iter().all(|&b| b == 0.0) {
                    continue;
                }
                for (n, _) in samples.iter().enumerate().filter(|&(_, &b)| b != 0.0) {
                    for block in touched(segment * BLOCK + n, 0) {
                        for first in &firsts {
                            occupied[first + block] = true;
                        }
                    }
                }
            }
        }
        Self {
            field,
            occupied,
            blocks,
            scale,
        }
    }

    /// b and its gradient at a position, or `None` where b is identically zero.
    #[inline]
    pub fn at(&self, x: [f64; D]) -> Option<(f64, [f64; D])> {
        let mut block = 0;
        for k in (0..D).rev() {
            block =
                block * self.blocks[k] + ((x[k] * self.scale[k]) as usize).min(self.blocks[k] - 1);
        }
        self.occupied[block].then(|| self.field.value_and_gradient(x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skips_only_where_the_field_is_nothing() {
        let dims = [41, 30, 25];
        let step = [1.0, 0.5, 2.0];
        let field = Field::from_fn(dims, step, |x| {
            if (x[0] - 17.0).abs() < 1.5 && (x[1] - 4.0).abs() < 3.0 {
                -1.0
            } else {
                0.0
            }
        });
        let term = ImageTerm::new(&field);
        let mut skipped = 0;
        for n in 0..20_000u32 {
            let t = |k: u32| {
                f64::from(n.wrapping_mul(2_654_435_761).rotate_left(9 * k) >> 8)
                    / f64::from(1 << 24)
            };
            let x = std::array::from_fn(|k| t(k as u32) * field.extent()[k]);
            let truth = field.value_and_gradient(x);
            match term.at(x) {
                Some(found) => assert_eq!(found, truth),
                None => {
                    skipped += 1;
                    assert_eq!(truth, (0.0, [0.0; 3]));
                }
            }
        }
        assert!(skipped > 8_000, "{skipped}");
    }
}
