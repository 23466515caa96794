//! Solves symmetric positive definite systems of equations by conjugate gradients (Hestenes and
//! Stiefel 1952) with the diagonal as the preconditioner.

/// A symmetric positive definite system of equations `matrix x = right_side`.
pub struct LinearSystem<'a, F> {
    /// Returns the product of the matrix and a vector.
    pub times: F,
    /// The diagonal of the matrix.
    pub diagonal: &'a [f64],
    /// The right side.
    pub right_side: &'a [f64],
}

impl<F: Fn(&[f64]) -> Vec<f64>> LinearSystem<'_, F> {
    /// Returns the vector divided by the diagonal.
    pub fn preconditioned(&self, vector: &[f64]) -> Vec<f64> {
        let pairs = vector.iter().zip(self.diagonal);
        pairs.map(|(v, d)| v / d).collect()
    }

    /// Returns the product of a vector and the preconditioned vector.
    pub fn squared_norm(&self, vector: &[f64]) -> f64 {
        dot(vector, &self.preconditioned(vector))
    }

    /// Improves `x` by at most `max_steps` steps, until the [squared norm](Self::squared_norm) of the
    /// residual is at most `tolerance`. Returns this norm.
    ///
    /// Sums are in the order of the unknowns.
    pub fn improve(&self, x: &mut [f64], tolerance: f64, max_steps: usize) -> f64 {
        let pairs = (self.times)(x).into_iter().zip(self.right_side);
        let mut residual: Vec<f64> = pairs.map(|(a, b)| b - a).collect();
        let mut direction = self.preconditioned(&residual);
        let mut square = dot(&residual, &direction);
        for _ in 0..max_steps {
            if square <= tolerance {
                break;
            }
            let image = (self.times)(&direction);
            let step = square / dot(&direction, &image);
            if !step.is_finite() {
                break;
            }
            for i in 0..x.len() {
                x[i] += step * direction[i];
                residual[i] -= step * image[i];
            }
            let preconditioned = self.preconditioned(&residual);
            let next = dot(&residual, &preconditioned);
            let ratio = next / square;
            square = next;
            for (p, z) in direction.iter_mut().zip(&preconditioned) {
                *p = z + ratio * *p;
            }
        }
        square
    }
}

/// Returns the product of two vectors.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_of_springs_has_the_known_solution() {
        // -x[i - 1] + 2 x[i] - x[i + 1] = 1 with zeros at both ends: x[i] = (i + 1) (n - i) / 2.
        let n = 30;
        let times = |x: &[f64]| -> Vec<f64> {
            let at = |i: usize| x.get(i).copied().unwrap_or(0.0);
            (0..n)
                .map(|i| 2.0 * at(i) - at(i.wrapping_sub(1)) - at(i + 1))
                .collect()
        };
        let system = LinearSystem {
            times,
            diagonal: &[2.0; 30],
            right_side: &[1.0; 30],
        };
        let mut x = vec![0.0; n];
        assert!(system.improve(&mut x, 1e-24, 2 * n) <= 1e-24);
        for (i, x) in x.iter().enumerate() {
            let expected = 0.5 * ((i + 1) * (n - i)) as f64;
            assert!((x - expected).abs() < 1e-9, "{i}: {x} {expected}");
        }
        let mut start = vec![0.0; n];
        assert!(system.improve(&mut start, 1e-24, 3) > 1e-3, "too few steps");
    }
}
