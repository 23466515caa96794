//! Positions as integers (fixed-point numbers).

/// A position as integers; coordinates of axes beyond `D` are 0. The last element is free for the
/// caller.
pub type IntPoint = [i32; 4];

/// Maps lattice space to integers of 31 bits a coordinate, whatever the size of the box. A box of
/// 256 samples is resolved to 5e-7 of a sample.
#[derive(Debug, Clone, Copy)]
pub struct FixedPointMap {
    /// Integer units per unit of lattice space; a power of two.
    pub scale: f64,
}

impl FixedPointMap {
    /// Chooses the scale so that the largest box coordinate becomes at most 2^29. Then mirror
    /// images beyond a side and differences of positions fit as well.
    pub fn new(extent: &[f64]) -> Self {
        let longest = extent.iter().fold(1e-30f64, |a, &b| a.max(b));
        Self {
            scale: (29.0 - longest.log2().ceil()).exp2(),
        }
    }

    /// Returns the integer nearest to a coordinate in units of `1 / scale`, which must be less than
    /// 2^31.
    #[inline(always)]
    pub fn coordinate(&self, x: f64) -> i32 {
        // Adding 1.5 * 2^52 leaves the integer in the lowest bits of the sum.
        (x * self.scale + 6_755_399_441_055_744.0).to_bits() as i32
    }

    /// Returns the integers of a position, with 0 as the last element.
    #[inline(always)]
    pub fn to_point<const D: usize>(self, x: &[f64; D]) -> IntPoint {
        let mut point = [0; 4];
        for k in 0..D {
            point[k] = self.coordinate(x[k]);
        }
        point
    }
}

/// A point so far from the box that no atom feels it.
pub const UNREACHABLE_POINT: IntPoint = [i32::MAX, i32::MAX, i32::MAX, 0];
