//! The pair potential of Shimada, as Hale 2001 uses it: repulsive below the nominal distance,
//! attractive up to one and a half times this distance, and zero beyond.
//!
//! With u = r / d, for 0 <= u < 3/2:
//!
//! - force f(u) = 9/8 - 19/8 u^2 + 5/4 u^3 = (u - 1) (u - 3/2) (5/4 u + 3/4)
//! - potential phi(u) = 153/256 - 9/8 u + 19/24 u^3 - 5/16 u^4 = -5/16 (u - 3/2)^2 (u^2 + 7/15 u -
//!   17/20), so that phi' = -f
//!
//! The factored forms lose no digits near the zeros and vanish at u = 3/2, so clamping u there
//! takes the place of a branch.
//!
//! # Stiffening
//!
//! In three dimensions the potential as published has a flaw. Its repulsion is soft (phi(0) is only
//! 0.6), and its integral over space is negative (4 pi times -0.011), so that it is not stable in
//! the sense of Ruelle 1969: the more atoms crowd into one place, the lower their energy. A few
//! steps of a minimiser do not show it, but many do: pairs of atoms merge, first on the features
//! that attract them. Adding k (1 - u)^2 to the force below u = 1 (k/3 (1 - u)^3 to the potential)
//! makes the integral positive for k > 2, and changes neither the minimum nor anything beyond it.
//! With k = [`stiffness`] (beta) no two atoms come nearer than about 0.65 d, and fewer atoms are
//! stuck between a feature and the layer of atoms beside it. Stiffening also helps where there is
//! no feature: with the potential as published, a third of the atoms of a perturbed regular lattice
//! end out of place.

/// The distance, in units of d, beyond which atoms do not feel each other.
pub const CUTOFF_RATIO: f32 = 1.5;

/// Returns the stiffening that keeps atoms apart where an image of weight beta in valleys of depth
/// 1 attracts them. It is proportional to beta / (1 - beta), the pull of the image over that of the
/// lattice, and never less than at the default beta of 1/2, because the lattice must stay regular
/// by itself.
///
/// The factor was found by trial on curved and crossing surfaces: 10 lets atoms crowd on surfaces
/// (0.6 d apart), 60 leaves more atoms stuck beside them.
pub fn stiffness(beta: f64) -> f32 {
    // The factor is bounded as beta approaches 1, where nothing holds the lattice together anyway.
    let beta = beta.clamp(0.5, 0.95);
    (20.0 * beta / (1.0 - beta)) as f32
}

/// Returns the smaller of two numbers in one instruction ([`f32::min`] takes three, because of
/// NaN).
#[inline(always)]
fn fast_min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Returns the force f(u) = -phi'(u), stiffened by `stiffness`; a positive force pushes atoms
/// apart.
#[inline(always)]
pub fn force(u: f32, stiffness: f32) -> f32 {
    let u = fast_min(u, CUTOFF_RATIO);
    let inside = 1.0 - fast_min(u, 1.0);
    (u - 1.0) * (u - CUTOFF_RATIO) * (1.25 * u + 0.75) + stiffness * inside * inside
}

/// Returns the potential phi(u), stiffened by `stiffness`. Its minimum is -37/768, at u = 1.
#[inline(always)]
pub fn potential(u: f32, stiffness: f32) -> f32 {
    let u = fast_min(u, CUTOFF_RATIO);
    let v = u - CUTOFF_RATIO;
    let inside = 1.0 - fast_min(u, 1.0);
    -0.3125 * v * v * (u * (u + 7.0 / 15.0) - 0.85) + stiffness / 3.0 * inside * inside * inside
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
            assert!((f64::from(force(u as f32, 0.0)) - f).abs() < 5e-7, "{u}");
            assert!(
                (f64::from(potential(u as f32, 0.0)) - phi).abs() < 2e-7,
                "{u}"
            );
        }
        for stiffness in [0.0, stiffness(0.6)] {
            let (f, phi) = (|u| force(u, stiffness), |u| potential(u, stiffness));
            assert!((phi(1.0) + 37.0 / 768.0).abs() < 1e-8);
            assert_eq!((f(1.0), f(1.5), phi(1.5)), (0.0, 0.0, 0.0));
            assert_eq!((f(7.0), phi(7.0)), (0.0, 0.0));
        }
    }

    #[test]
    fn stiffening_makes_crowding_cost_energy() {
        let integral = |stiffness: f32| -> f64 {
            let steps = 150_000;
            (0..steps)
                .map(|n| 1.5 * (f64::from(n) + 0.5) / f64::from(steps))
                .map(|u| f64::from(potential(u as f32, stiffness)) * u * u * 1.5)
                .sum::<f64>()
                / f64::from(steps)
        };
        assert!((integral(0.0) + 0.0113).abs() < 2e-4, "{}", integral(0.0));
        assert!(integral(2.5) > 0.0);
        for n in 1..100 {
            let (u, h) = (0.01 * n as f32, 1e-2);
            let slope = (potential(u + h, 40.0) - potential(u - h, 40.0)) / (2.0 * h);
            assert!((slope + force(u, 40.0)).abs() < 0.01, "{u}");
        }
    }
}
