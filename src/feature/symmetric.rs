//! Eigenvectors of symmetric 3 x 3 matrices (Hessians, structure tensors), in closed form.
//!
//! Matrices are stored as `[xx, yy, zz, xy, xz, yz]`.

/// Eigenvalues in ascending order (Smith 1961: roots of the characteristic cubic by cosines).
pub fn eigenvalues(m: &[f64; 6]) -> [f64; 3] {
    let [xx, yy, zz, xy, xz, yz] = *m;
    let mean = (xx + yy + zz) / 3.0;
    let off = xy * xy + xz * xz + yz * yz;
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    let p = ((a * a + b * b + c * c + 2.0 * off) / 6.0).sqrt();
    if p <= f64::MIN_POSITIVE {
        return [mean; 3];
    }
    let half_det = 0.5
        * (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz))
        / (p * p * p);
    let angle = half_det.clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * p * angle.cos();
    let smallest = mean + 2.0 * p * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    [smallest, 3.0 * mean - largest - smallest, largest]
}

/// A unit eigenvector for an eigenvalue of `m`; any fitting direction where it is not unique.
pub fn eigenvector(m: &[f64; 6], value: f64) -> [f64; 3] {
    let [xx, yy, zz, xy, xz, yz] = *m;
    let rows = [
        [xx - value, xy, xz],
        [xy, yy - value, yz],
        [xz, yz, zz - value],
    ];
    let crosses = [
        cross(rows[0], rows[1]),
        cross(rows[0], rows[2]),
        cross(rows[1], rows[2]),
    ];
    let best = longest(crosses);
    let row = longest(rows);
    // Rows of rank one: the eigenvalue is double, and what is normal to the row will do.
    let (long, scale) = (dot(best, best), dot(row, row));
    if long > 1e-20 * scale * scale {
        return unit(best);
    }
    if scale == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let least = (0..3).fold(0, |a, k| if row[k].abs() < row[a].abs() { k } else { a });
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    unit(cross(row, axis))
}

fn longest(vectors: [[f64; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = vectors;
    let ab = if dot(b, b) > dot(a, a) { b } else { a };
    if dot(c, c) > dot(ab, ab) { c } else { ab }
}

/// Vector product.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Scalar product.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|c| c / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply(m: &[f64; 6], v: [f64; 3]) -> [f64; 3] {
        let [xx, yy, zz, xy, xz, yz] = *m;
        [
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        ]
    }

    fn check(m: &[f64; 6]) {
        let scale = m.iter().fold(0.0f64, |a, c| a.max(c.abs()));
        let values = eigenvalues(m);
        assert!(values[0] <= values[1] + 1e-9 * scale && values[1] <= values[2] + 1e-9 * scale);
        assert!((values.iter().sum::<f64>() - m[0] - m[1] - m[2]).abs() <= 1e-12 * scale);
        for value in [values[0], values[2]] {
            let v = eigenvector(m, value);
            assert!((dot(v, v) - 1.0).abs() < 1e-12);
            let mv = apply(m, v);
            for k in 0..3 {
                assert!(
                    (mv[k] - value * v[k]).abs() <= 1e-6 * scale,
                    "{m:?} {value} {v:?}"
                );
            }
        }
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
            check(&m);
            // Rank one: a double eigenvalue zero.
            let v = [random(), random(), random()];
            check(&[
                v[0] * v[0],
                v[1] * v[1],
                v[2] * v[2],
                v[0] * v[1],
                v[0] * v[2],
                v[1] * v[2],
            ]);
        }
        for m in [
            [0.0; 6],
            [2.0, 2.0, 2.0, 0.0, 0.0, 0.0],
            [1.0, 1.0, -3.0, 0.0, 0.0, 0.0],
        ] {
            check(&m);
        }
    }
}
