//! Cuts faces into small pieces and measures the distance of each centroid from the features.

use super::reference::Reference;
use crate::geometry::{dot, sub};

/// Maximum edge length of the pieces, in samples.
const MAX_SAMPLE_EDGE: f64 = 2.0;

/// Distance from the features, and area, of a piece of a face.
pub(super) type FaceSample = (f64, f64);

/// Visits the equal small pieces of a face, each measured at its centroid.
pub(super) fn sample_face<const D: usize>(
    face: &[[f64; D]; D],
    reference: &Reference<'_, D>,
    hint: &mut Option<usize>,
    mut visit: impl FnMut(FaceSample),
) {
    // Vectors from corner 0 to the two other corners. In 2-D both are the same.
    let side = |i: usize| -> [f64; D] { std::array::from_fn(|k| face[i][k] - face[0][k]) };
    let (u, v) = (side(1), side(D - 1));
    let square = |w: [f64; D]| w.iter().map(|c| c * c).sum::<f64>();
    let third = sub(v, u);
    let longest = square(u).max(square(v)).max(square(third)).sqrt();
    let n = (longest / MAX_SAMPLE_EDGE).ceil().clamp(1.0, 256.0) as usize;
    let dot_product = dot(u, v);
    let area = if D == 2 {
        square(u).sqrt()
    } else {
        0.5 * (square(u) * square(v) - dot_product * dot_product)
            .max(0.0)
            .sqrt()
    };
    let sample_area = area / n.pow(D as u32 - 1) as f64;
    let mut visit_at = |i: f64, j: f64| {
        let (s, t) = (i / n as f64, j / n as f64);
        let x = std::array::from_fn(|k| face[0][k] + s * u[k] + t * v[k]);
        visit((reference.distance(x, hint), sample_area));
    };
    for i in 0..n {
        if D == 2 {
            visit_at(i as f64 + 0.5, 0.0);
            continue;
        }
        for j in 0..n - i {
            let (i, j) = (i as f64, j as f64);
            visit_at(i + 1.0 / 3.0, j + 1.0 / 3.0);
            if i + j + 1.0 < n as f64 {
                visit_at(i + 2.0 / 3.0, j + 2.0 / 3.0);
            }
        }
    }
}
