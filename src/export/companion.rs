//! Writes the VTU beside a file whose format does not hold the shapes of cells. It holds the same
//! cells in the same order, with all their values.

use std::path::Path;

use super::values::rock_arrays;
use crate::Result;
use crate::files::Batch;
use crate::files::vtk::{ArrayPacking, DataArray};
use crate::mesh_file::polyhedra::add_cells_vtu;
use crate::model::reservoir::Model;
use crate::store::FieldValue;

/// Adds the companion VTU to the files of a model.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn add_companion(batch: &mut Batch, path: &Path, model: &Model) -> Result<()> {
    let cells = model.len();
    let mut arrays = vec![
        DataArray::scalars("volume", model.graph.volume.clone()),
        DataArray::scalars(
            "depth",
            (0..cells).map(|c| model.depth(c)).collect::<Vec<f64>>(),
        ),
        DataArray::scalars("two_point_angle", max_flux_angles(model)),
    ];
    arrays.extend(rock_arrays(model));
    let version = FieldValue::Text(env!("CARGO_PKG_VERSION").to_string());
    let fields = [("atomesh_version".to_string(), version)];
    add_cells_vtu(
        batch,
        path,
        &model.mesh,
        &[],
        &arrays,
        &fields,
        ArrayPacking::None,
    )
}

/// Returns for each cell the largest angle, in degrees, between a connection and the flux that its
/// two-point approximation stands for.
fn max_flux_angles(model: &Model) -> Vec<f32> {
    let mut worst = vec![0f32; model.len()];
    for (c, angle) in model.graph.connections.iter().zip(model.two_point_angles()) {
        for cell in c.cells {
            let worst = &mut worst[cell as usize];
            *worst = worst.max(angle as f32);
        }
    }
    worst
}
