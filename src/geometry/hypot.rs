//! The length of a vector with two components.

/// Returns the square root of `x * x + y * y`, with an error of less than one unit in the last
/// place (Borges 2019, arXiv:1904.09481). The result is the same on every system, unlike that of
/// [`f64::hypot`], which the C library computes.
pub fn hypot(x: f64, y: f64) -> f64 {
    /// Scale of numbers whose squares would overflow, and inverse scale of those whose squares
    /// would underflow.
    const SCALE: f64 = f64::from_bits((1023 - 600) << 52);
    /// Squares of larger numbers may overflow (2^511).
    const LARGE: f64 = f64::from_bits((1023 + 511) << 52);
    /// Squares of smaller numbers may underflow (2^-459).
    const SMALL: f64 = f64::from_bits((1023 - 459) << 52);
    /// Ratio below which the smaller number does not change the result (2^-54).
    const NEGLIGIBLE: f64 = f64::EPSILON / 4.0;

    if !x.is_finite() || !y.is_finite() {
        let is_infinite = x.is_infinite() || y.is_infinite();
        return if is_infinite { f64::INFINITY } else { f64::NAN };
    }
    let (large, small) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    if small <= large * NEGLIGIBLE {
        large + small
    } else if large > LARGE {
        corrected_hypot(large * SCALE, small * SCALE) / SCALE
    } else if small < SMALL {
        corrected_hypot(large / SCALE, small / SCALE) * SCALE
    } else {
        corrected_hypot(large, small)
    }
}

/// Returns the square root of the sum of squares, less its error to first order. Requires
/// `large >= small > 0`, and squares that neither overflow nor underflow.
#[inline]
fn corrected_hypot(large: f64, small: f64) -> f64 {
    let h = (large * large + small * small).sqrt();
    let (t1, t2) = if h <= 2.0 * small {
        let delta = h - small;
        (
            large * (2.0 * delta - large),
            (delta - 2.0 * (large - small)) * delta,
        )
    } else {
        let delta = h - large;
        (
            2.0 * delta * (large - 2.0 * small),
            (4.0 * delta - small) * small + delta * delta,
        )
    };
    h - (t1 + t2) / (2.0 * h)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_exact_where_they_can_be() {
        for (x, y, length) in [
            (3.0, -4.0, 5.0),
            (0.0, -7.0, 7.0),
            (0.0, 0.0, 0.0),
            (1e-160, 2e-200, 1e-160),
            (f64::MIN_POSITIVE, 0.0, f64::MIN_POSITIVE),
            (
                3.0 * f64::from_bits(1),
                4.0 * f64::from_bits(1),
                5.0 * f64::from_bits(1),
            ),
            (f64::MAX, f64::MAX, f64::INFINITY),
            (f64::NAN, f64::NEG_INFINITY, f64::INFINITY),
        ] {
            assert_eq!(hypot(x, y), length, "{x:e} {y:e}");
            assert_eq!(hypot(y, x), length, "{x:e} {y:e}");
        }
        assert!(hypot(f64::NAN, 1.0).is_nan());
    }
}
