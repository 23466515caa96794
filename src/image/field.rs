//! A sampled scalar function of position in *lattice space*, and its smooth interpolation.
//!
//! Lattice space is sample index times a step per axis (`step`, 1 by default); the field fills the
//! box `[0, (dims[k] - 1) * step[k]]`.

/// Samples of a scalar function over the lattice-space box, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Field<const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Lattice-space distance between samples along each axis.
    pub step: [f64; D],
    /// Samples, x fastest.
    pub samples: Vec<f32>,
}

impl<const D: usize> Field<D> {
    /// The far corner of the box; the near one is the origin.
    pub fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| (self.dims[k].max(1) - 1) as f64 * self.step[k])
    }
}
