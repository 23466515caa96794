//! Eigenvalues and eigenvectors of small symmetric matrices (Hessians, structure tensors), in
//! closed form.

use crate::geometry::dot;

/// A symmetric matrix with two or three rows.
pub type SymmetricMatrix<const D: usize> = [[f64; D]; D];

/// Returns the eigenvalues in ascending order.
///
/// In three dimensions they are mean + p t, where t are the roots of t^3 - 3 t = 2 h (Smith 1961; h
/// is half the determinant of the matrix shifted and scaled by mean and p). The root farthest from
/// the others is smooth in h and found by Newton's method; the other two follow from a quadratic.
/// The relative error is about 1e-14 of the largest magnitude.
#[inline]
pub fn eigenvalues<const D: usize>(m: &SymmetricMatrix<D>) -> [f64; D] {
    const { assert!(D == 2 || D == 3, "images have two or three dimensions") };
    let mut values = [0.0; D];
    if D == 2 {
        let mean = 0.5 * (m[0][0] + m[1][1]);
        let half = 0.5 * (m[0][0] - m[1][1]);
        let radius = (half * half + m[0][1] * m[0][1]).sqrt();
        values.copy_from_slice(&[mean - radius, mean + radius]);
        return values;
    }
    let (xy, xz, yz) = (m[0][1], m[0][2], m[1][2]);
    let mean = (m[0][0] + m[1][1] + m[2][2]) / 3.0;
    let off_diagonal = xy * xy + xz * xz + yz * yz;
    let (a, b, c) = (m[0][0] - mean, m[1][1] - mean, m[2][2] - mean);
    let p = ((a * a + b * b + c * c + 2.0 * off_diagonal) / 6.0).sqrt();
    if p <= f64::MIN_POSITIVE {
        return [mean; D];
    }
    let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    let h = (0.5 * determinant / (p * p * p)).clamp(-1.0, 1.0);
    let lone = p * largest_root(h.abs()).copysign(h);
    // The other two add up to -lone; twice their half difference squared is 12 p^2 - 3 lone^2.
    let half = 0.5 * (12.0 * p * p - 3.0 * lone * lone).max(0.0).sqrt();
    let others = [mean - 0.5 * lone - half, mean - 0.5 * lone + half];
    values.copy_from_slice(&if h >= 0.0 {
        [others[0], others[1], mean + lone]
    } else {
        [mean + lone, others[0], others[1]]
    });
    values
}

/// Returns the largest root of t^3 - 3 t = 2 h for h in [0, 1]: 2 cos(acos(h) / 3), in [sqrt 3, 2].
#[inline]
fn largest_root(h: f64) -> f64 {
    let mut t = f64::from(approx_largest_root(h as f32));
    for _ in 0..2 {
        let square = t * t;
        t -= (t * (square - 3.0) - 2.0 * h) / (3.0 * (square - 1.0));
    }
    t
}

/// Returns the largest root with an error below 1.4e-4, which each step of Newton's method squares.
#[inline(always)]
pub fn approx_largest_root(h: f32) -> f32 {
    1.732_184_7 + h * (0.330_431_67 + h * (0.018_749_97 * h - 0.081_264_11))
}

/// Returns a unit eigenvector for an eigenvalue of `m`; any possible direction if it is not unique.
#[inline]
pub fn eigenvector<const D: usize>(m: &SymmetricMatrix<D>, value: f64) -> [f64; D] {
    let mut rows = *m;
    for k in 0..D {
        rows[k][k] -= value;
    }
    let row = longest(rows);
    let scale = dot(row, row);
    let mut vector = [0.0; D];
    if scale == 0.0 {
        vector[0] = 1.0;
        return vector;
    }
    if D == 2 {
        vector.copy_from_slice(&[-row[1], row[0]]);
        return unit(vector);
    }
    let best = longest([
        cross(rows[0], rows[1]),
        cross(rows[0], rows[2]),
        cross(rows[1], rows[2]),
    ]);
    // If the rows have rank one, the eigenvalue is double, and any direction normal to the row is
    // right.
    if dot(best, best) > 1e-20 * scale * scale {
        return unit(best);
    }
    let smallest = (0..D).fold(0, |a, k| if row[k].abs() < row[a].abs() { k } else { a });
    vector[smallest] = 1.0;
    unit(cross(row, vector))
}

fn longest<const N: usize, const D: usize>(vectors: [[f64; D]; N]) -> [f64; D] {
    // The result of the comparison cannot be predicted. Selecting an index instead of a vector
    // needs no branch.
    let (mut best, mut max) = (0, dot(vectors[0], vectors[0]));
    for (k, v) in vectors.iter().enumerate().skip(1) {
        let square = dot(*v, *v);
        best = if square > max { k } else { best };
        max = max.max(square);
    }
    vectors[best]
}

/// Returns the vector product of two vectors of three components; zero in two dimensions.
#[inline]
fn cross<const D: usize>(a: [f64; D], b: [f64; D]) -> [f64; D] {
    let mut product = [0.0; D];
    if D == 3 {
        product[0] = a[1] * b[2] - a[2] * b[1];
        product[1] = a[2] * b[0] - a[0] * b[2];
        product[2] = a[0] * b[1] - a[1] * b[0];
    }
    product
}

fn unit<const D: usize>(a: [f64; D]) -> [f64; D] {
    let length = dot(a, a).sqrt();
    a.map(|c| c / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<const D: usize>(m: &SymmetricMatrix<D>) {
        let scale = m.iter().flatten().fold(0.0f64, |a, c| a.max(c.abs()));
        let values = eigenvalues(m);
        assert!(values.windows(2).all(|v| v[0] <= v[1] + 1e-9 * scale));
        let trace: f64 = (0..D).map(|k| m[k][k]).sum();
        assert!((values.iter().sum::<f64>() - trace).abs() <= 1e-12 * scale);
        for value in [values[0], values[D - 1]] {
            let v = eigenvector(m, value);
            assert!((dot(v, v) - 1.0).abs() < 1e-12);
            for k in 0..D {
                let image = dot(m[k], v);
                assert!(
                    (image - value * v[k]).abs() <= 1e-6 * scale,
                    "{m:?} {value} {v:?}"
                );
            }
        }
    }

    fn from_six([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> SymmetricMatrix<3> {
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    #[test]
    fn random_and_degenerate_matrices() {
        let mut state = 1u64;
        let mut random = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        for i in 0..2000 {
            let scale = 10f64.powi(i % 13 - 6);
            let m: [f64; 6] = std::array::from_fn(|_| random() * scale);
            check(&from_six(m));
            check(&[[m[0], m[3]], [m[3], m[1]]]);
            // Rank one: a double eigenvalue zero.
            let v = [random(), random(), random()];
            check(&std::array::from_fn::<_, 3, _>(|k| v.map(|c| c * v[k])));
            let v = [random(), random()];
            check(&std::array::from_fn::<_, 2, _>(|k| v.map(|c| c * v[k])));
        }
        for m in [
            [0.0; 6],
            [2.0, 2.0, 2.0, 0.0, 0.0, 0.0],
            [1.0, 1.0, -3.0, 0.0, 0.0, 0.0],
        ] {
            check(&from_six(m));
        }
        check(&[[0.0; 2]; 2]);
        check(&[[3.0, 0.0], [0.0, 3.0]]);
    }

    #[test]
    fn the_lone_root_is_a_cosine() {
        for i in 0..=1000 {
            let h = f64::from(i) / 1000.0;
            let truth = 2.0 * (h.acos() / 3.0).cos();
            assert!((largest_root(h) - truth).abs() < 1e-13, "{h}");
        }
    }
}
