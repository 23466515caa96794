//! Non-maximum suppression (Canny 1986): points at which the gradient magnitude is largest.
//!
//! A sample is on an edge if the magnitude of its gradient is largest along the gradient. The point
//! is at the sub-sample position where the derivative of the magnitude along that direction passes
//! through zero.

use super::candidate::{Candidate, dominant_axes, ridge_offset};
use super::volume::Volume;
use crate::progress::CancelToken;

/// Returns the points of a smoothed volume whose [gradient
/// magnitude](super::gradient_magnitude::gradient_magnitude) is at least `low` and above zero, in
/// the order of samples. `magnitudes` has the gradient magnitude of each sample.
pub fn gradient_maxima<const D: usize>(
    smoothed: Volume<'_, D>,
    magnitudes: Volume<'_, D>,
    low: f32,
    cancel: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    smoothed.map_rows(cancel, |first, (): &mut (), found| {
        let start = smoothed.index(first);
        let row = &magnitudes.samples[start..start + smoothed.dims[0]];
        for (x, &magnitude) in row.iter().enumerate() {
            if magnitude < low || magnitude <= 0.0 {
                continue;
            }
            let mut at = first;
            at[0] = x;
            let normal = smoothed
                .gradient(at)
                .map(|g| f64::from(g) / f64::from(magnitude));
            for axis in dominant_axes(normal) {
                if let Some(offset) = ridge_offset(magnitudes, at, normal, axis) {
                    let candidate =
                        Candidate::new(smoothed.dims, at, axis, offset, normal, magnitude);
                    found.push(candidate);
                }
            }
        }
    })
}
