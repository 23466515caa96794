//! The figures of what a job made.

use std::borrow::Cow;

use super::frame::lattice_extent;
use crate::Result;
use crate::feature::Features;
use crate::mesh::Simplices;
use crate::mesh::check::{Known, check_while};
use crate::observer::Patience;
use crate::report::{self, Reference, Report};

/// How far the volume may be off the box's, and sides from flat, as a share.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// Shapes, fidelity and validity of a mesh in lattice space, as far as `patience` lasts: what was not
/// measured to its end is left out.
pub(super) fn measure<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: Option<&[u32]>,
    dims: [usize; D],
    step: [f64; D],
    features: &Features<D>,
    claimed: Option<&[u8]>,
    patience: &Patience<'_>,
) -> Result<Report> {
    let quality = measured(patience, || report::quality_while(mesh, patience));
    let known = Known {
        neighbors,
        ..Known::default()
    };
    let extent = lattice_extent(dims, step);
    let filling = measured(patience, || {
        check_while(mesh, known, [0.0; D], extent, BOX_TOLERANCE, patience)
    });
    let fidelity = measured(patience, || {
        let reference = Reference::from_features(features);
        let in_samples = scaled(mesh, step.map(|s| 1.0 / s));
        let any = !features.points.is_empty();
        any.then(|| report::fidelity_while(&*in_samples, &reference, claimed, patience))
            .transpose()
    });
    Ok(Report {
        quality,
        filling,
        fidelity: fidelity.transpose()?.flatten(),
        ..Report::default()
    })
}

/// What `measure` gives, if `patience` lasts from before it until after.
pub(super) fn measured<T>(patience: &Patience<'_>, measure: impl FnOnce() -> T) -> Option<T> {
    if patience.over() {
        return None;
    }
    let figures = measure();
    (!patience.over()).then_some(figures)
}

/// A mesh with each axis scaled.
pub fn scaled<const D: usize, M: Simplices<D>>(mesh: &M, scale: [f64; D]) -> Cow<'_, M> {
    if scale == [1.0; D] {
        return Cow::Borrowed(mesh);
    }
    let stretch = |x: &[f64; D]| std::array::from_fn(|k| x[k] * scale[k]);
    let nodes = mesh.nodes().iter().map(stretch).collect();
    Cow::Owned(M::from_parts(nodes, mesh.connectivity().to_vec()))
}
