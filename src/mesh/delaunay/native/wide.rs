//! Signed integers of 384 bits, for exact determinants.

use std::ops::{Add, Sub};

const LIMBS: usize = 6;

/// A signed integer of 384 bits in two's complement, the lowest 64 bits first. Sums and products
/// that do not fit wrap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wide([u64; LIMBS]);

impl Wide {
    /// Returns `a` times `b`.
    #[inline]
    pub fn product(a: i128, b: i64) -> Self {
        let low = i128::from(a as u64) * i128::from(b);
        let high = (a >> 64) * i128::from(b) + (low >> 64);
        let sign = (high >> 127) as u64;
        Self([
            low as u64,
            high as u64,
            (high >> 64) as u64,
            sign,
            sign,
            sign,
        ])
    }

    /// Returns `self` times `factor`, for a number of at most 192 bits.
    #[inline]
    pub fn times(self, factor: i128) -> Self {
        let is_negative = (self.signum() < 0) != (factor < 0);
        let magnitude = if self.signum() < 0 {
            self.negated().0
        } else {
            self.0
        };
        let factor = factor.unsigned_abs();
        let factor = [factor as u64, (factor >> 64) as u64];
        let mut product = [0; LIMBS];
        for (i, &m) in magnitude[..3].iter().enumerate() {
            let mut carry = 0;
            for (j, &f) in factor.iter().enumerate() {
                let sum = u128::from(m) * u128::from(f) + u128::from(product[i + j]) + carry;
                product[i + j] = sum as u64;
                carry = sum >> 64;
            }
            product[i + 2] = carry as u64;
        }
        let product = Self(product);
        if is_negative {
            product.negated()
        } else {
            product
        }
    }

    #[inline]
    fn negated(self) -> Self {
        Self([0; LIMBS]) - self
    }

    /// Returns -1, 0 or 1.
    #[inline]
    pub fn signum(self) -> i32 {
        if (self.0[LIMBS - 1] as i64) < 0 {
            -1
        } else {
            i32::from(self.0.iter().fold(0, |all, limb| all | limb) != 0)
        }
    }
}

impl Add for Wide {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        let mut carry = false;
        Self(std::array::from_fn(|i| {
            let (sum, first) = self.0[i].overflowing_add(other.0[i]);
            let (sum, second) = sum.overflowing_add(u64::from(carry));
            carry = first || second;
            sum
        }))
    }
}

impl Sub for Wide {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        let mut borrow = false;
        Self(std::array::from_fn(|i| {
            let (difference, first) = self.0[i].overflowing_sub(other.0[i]);
            let (difference, second) = difference.overflowing_sub(u64::from(borrow));
            borrow = first || second;
            difference
        }))
    }
}
