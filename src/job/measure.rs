//! The figures of what a job made.

use std::borrow::Cow;

use super::frame::lattice_extent;
use crate::Result;
use crate::feature::Features;
use crate::mesh::Simplices;
use crate::mesh::check::{Known, check_known};
use crate::report::{self, Reference, Report};

/// How far the volume may be off the box's, and sides from flat, as a share.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// Shapes, fidelity (unless it is stopped) and validity of a mesh in lattice space.
pub(super) fn measure<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: Option<&[u32]>,
    dims: [usize; D],
    step: [f64; D],
    features: &Features<D>,
    claimed: Option<&[u8]>,
    keep_going: &mut dyn FnMut() -> bool,
) -> Result<Report> {
    let extent = lattice_extent(dims, step);
    let fidelity = match features.points.is_empty() || !keep_going() {
        true => None,
        false => {
            let reference = Reference::from_features(features);
            let in_samples = scaled(mesh, step.map(|s| 1.0 / s));
            Some(report::fidelity(&*in_samples, &reference, claimed)?)
        }
    };
    Ok(Report {
        quality: Some(report::quality(mesh)),
        fidelity,
        filling: Some(check_known(
            mesh,
            Known {
                neighbors,
                ..Known::default()
            },
            [0.0; D],
            extent,
            BOX_TOLERANCE,
        )),
        ..Report::default()
    })
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
