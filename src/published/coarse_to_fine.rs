//! Smoother potentials for the first passes of an optimisation (Hale 2001).

use crate::feature::gaussian;
use crate::image::SparseField;
use crate::progress::CancelToken;

/// Returns a potential whose valleys, of width `sigma`, are made `factor` times as wide and as deep
/// as before.
pub fn smoothed_potential<const D: usize>(
    potential: &SparseField<D>,
    sigma: f64,
    factor: f64,
    cancel: &CancelToken<'_>,
) -> SparseField<D> {
    let mut smoothed = potential.to_dense();
    // Widths add in quadrature; the depth of a straight valley falls as its width grows.
    let added_sigma = sigma * (factor * factor - 1.0).sqrt();
    gaussian::smooth(
        smoothed.dims,
        &mut smoothed.samples,
        smoothed.step.map(|step| added_sigma / step),
        cancel,
    );
    for b in &mut smoothed.samples {
        *b = (*b * factor as f32).clamp(-1.0, 0.0);
    }
    SparseField::from_field(&smoothed)
}
