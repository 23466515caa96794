//! `--velocity`: depth of two-way time.

use crate::Result;
use crate::cli::common::options::named;
use crate::cli::console::Console;
use crate::image::Geometry;
use crate::mesh::Mesh;
use crate::store::{self, MeshFile};

/// A mesh in depth, if a velocity is given.
///
/// # Errors
/// [`crate::Error::Image`] for a velocity that makes no depth.
pub fn in_depth<const D: usize, M: Mesh<D>>(
    file: MeshFile<M>,
    velocity: Option<f64>,
) -> Result<MeshFile<M>> {
    match velocity {
        Some(velocity) => store::in_depth(file, velocity).map_err(named),
        None => Ok(file),
    }
}

/// Says so if a coordinate is time.
pub fn warn_of_time<const D: usize>(geometry: &Geometry<D>, console: &Console) {
    if let Some(axis) = geometry.time_axis() {
        console.note(format_args!(
            "WARNING: {} is time ({}), not depth: dips, volumes and fluxes are not true; give --velocity V (m/s)",
            ["x", "y", "z"][axis], geometry.units[axis]
        ));
    }
}
