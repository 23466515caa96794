//! Where an image is steepest: non-maximum suppression (Canny 1986).
//!
//! A sample is on an edge where the gradient's magnitude is largest along the gradient, at the
//! sub-sample position where its derivative along that direction passes through zero.

use super::candidate::{Candidate, dominant_axes, ridge_offset};
use super::volume::Volume;
use crate::progress::CancelToken;

/// Points whose steepness is at least `low`, and above zero, in the order of samples, of a smoothed
/// volume of which `steepness` is the [steepness](super::gradient_magnitude::gradient_magnitude).
pub fn gradient_maxima<const D: usize>(
    smoothed: Volume<'_, D>,
    steepness: Volume<'_, D>,
    low: f32,
    patience: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    smoothed.map_rows(patience, |first, (): &mut (), found| {
        let start = smoothed.index(first);
        let row = &steepness.samples[start..start + smoothed.dims[0]];
        for (x, &steep) in row.iter().enumerate() {
            if steep < low || steep <= 0.0 {
                continue;
            }
            let mut at = first;
            at[0] = x;
            let normal = smoothed
                .gradient(at)
                .map(|g| f64::from(g) / f64::from(steep));
            for axis in dominant_axes(normal) {
                if let Some(offset) = ridge_offset(steepness, at, normal, axis) {
                    let found_here = Candidate::new(smoothed.dims, at, axis, offset, normal, steep);
                    found.push(found_here);
                }
            }
        }
    })
}
