//! The pair potential of Shimada, as Hale 2001 uses it: repulsive below the nominal distance,
//! attractive up to one and a half of it, nothing beyond.
//!
//! With u = r / d, for 0 <= u < 3/2:
//!
//! - force f(u) = 9/8 - 19/8 u^2 + 5/4 u^3 = (u - 1) (u - 3/2) (5/4 u + 3/4)
//! - potential phi(u) = 153/256 - 9/8 u + 19/24 u^3 - 5/16 u^4
//!   = -5/16 (u - 3/2)^2 (u^2 + 7/15 u - 17/20), so that phi' = -f
//!
//! The factored forms lose no digits near the zeros and vanish at u = 3/2 by themselves, so clamping
//! u there takes the place of a branch.

/// The distance, in units of d, beyond which atoms do not feel each other.
pub const CUTOFF: f32 = 1.5;

/// The force f(u) = -phi'(u); positive pushes apart.
#[inline(always)]
pub fn force(u: f32) -> f32 {
    let u = u.min(CUTOFF);
    (u - 1.0) * (u - CUTOFF) * (1.25 * u + 0.75)
}

/// The potential phi(u); least at u = 1, where it is -37/768.
#[inline(always)]
pub fn potential(u: f32) -> f32 {
    let u = u.min(CUTOFF);
    let v = u - CUTOFF;
    -0.3125 * v * v * (u * (u + 7.0 / 15.0) - 0.85)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factored_forms_are_the_published_polynomials() {
        for n in 0..=150 {
            let u = f64::from(n) / 100.0;
            let f = 9.0 / 8.0 - 19.0 / 8.0 * u.powi(2) + 5.0 / 4.0 * u.powi(3);
            let phi =
                153.0 / 256.0 - 9.0 / 8.0 * u + 19.0 / 24.0 * u.powi(3) - 5.0 / 16.0 * u.powi(4);
            assert!((f64::from(force(u as f32)) - f).abs() < 5e-7, "{u}");
            assert!((f64::from(potential(u as f32)) - phi).abs() < 2e-7, "{u}");
        }
        assert!((potential(1.0) + 37.0 / 768.0).abs() < 1e-8);
        assert_eq!((force(1.0), force(1.5), potential(1.5)), (0.0, 0.0, 0.0));
        assert_eq!((force(7.0), potential(7.0)), (0.0, 0.0));
    }
}
