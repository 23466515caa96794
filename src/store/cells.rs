//! From a job's Voronoi cells to a file.

use rayon::prelude::*;

use super::file::{HORIZON_FACES, Provenance, WELD, common_fields};
use super::{FieldValue, MeshFile};
use crate::files::vtk::DataArray;
use crate::image::Geometry;
use crate::job::CellsOutcome;
use crate::job::cells::to_world;
use crate::job::horizons::on_horizons;
use crate::mesh::poly::PolyMesh;

/// The outcome of a job where the image lies in the world, with all that is known of each cell.
pub fn cells_to_file<const D: usize>(
    outcome: &CellsOutcome<D>,
    geometry: &Geometry<D>,
    provenance: &Provenance,
) -> MeshFile<PolyMesh<D>> {
    let mesh = to_world(&outcome.mesh, outcome.step, geometry);
    let volume: Vec<f64> = mesh.cell_shapes().into_iter().map(|s| s.0).collect();
    let mut on_feature = vec![0u8; mesh.sites.len()];
    for (cells, _) in mesh
        .face_cells
        .iter()
        .zip(&mesh.on_feature)
        .filter(|f| *f.1)
    {
        cells.iter().for_each(|&c| on_feature[c as usize] = 1);
    }
    let distance: Vec<f32> = outcome
        .mesh
        .sites
        .par_iter()
        .map(|&x| outcome.distance.at(x) as f32)
        .collect();
    let mut field_data = common_fields(geometry, outcome.step, outcome.extent, provenance);
    if outcome.weld > 0.0 {
        field_data.push((WELD.into(), FieldValue::F64s(vec![outcome.weld])));
    }
    let horizons = on_horizons(&outcome.mesh, &mesh.on_feature, &outcome.features);
    let pairs = mesh.face_cells.iter().zip(&horizons).filter(|f| *f.1);
    let pairs: Vec<i64> = pairs.flat_map(|(cells, _)| cells.map(i64::from)).collect();
    if !pairs.is_empty() {
        field_data.push((HORIZON_FACES.into(), FieldValue::Ints(pairs)));
    }
    MeshFile {
        cell_data: vec![
            DataArray::scalars(if D == 2 { "area" } else { "volume" }, volume),
            DataArray::scalars("on_feature", on_feature),
            DataArray::scalars("distance", distance),
        ],
        point_data: Vec::new(),
        field_data,
        mesh,
    }
}
