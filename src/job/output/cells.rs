//! Converts a job's Voronoi cells to a mesh file.

use crate::parallel::prelude::*;

use super::{feature_names, labels_field, live_array, resolved_options_field};
use crate::files::vtk::DataArray;
use crate::job::Outcome;
use crate::job::cells::to_world;
use crate::job::horizons::horizon_flags;
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;
use crate::mesh_file::array_names::{DISTANCE_ARRAY, HORIZON_FACES_ARRAY, WELD_FIELD};
use crate::mesh_file::lattice_space::common_fields;
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::mesh_file::{FieldValue, MeshFile};

/// Returns the Voronoi cells of a job in world coordinates, with the data of each cell.
pub fn cell_mesh_file<const D: usize, M>(
    outcome: &Outcome<D, M>,
    lattice: &PolyMesh<D>,
    weld: f64,
) -> MeshFile<PolyMesh<D>> {
    let mesh = to_world(lattice, outcome.step, &outcome.geometry);
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
    let nominal = &outcome.distance;
    let distance: Vec<f32> = lattice
        .sites
        .par_iter()
        .map(|&x| nominal.value_at(x) as f32)
        .collect();
    let mut field_data = common_fields(
        &outcome.geometry,
        outcome.step,
        outcome.extent,
        &outcome.provenance,
    );
    field_data.extend(resolved_options_field(&outcome.features.resolved));
    field_data.extend(outcome.features.labels.as_ref().and_then(labels_field));
    if weld > 0.0 {
        field_data.push((WELD_FIELD.into(), FieldValue::F64s(vec![weld])));
    }
    let names = &outcome.face_names;
    let named = (mesh.face_cells.iter().zip(names))
        .filter(|(_, name)| **name != NONE)
        .map(|(&[a, b], &name)| ([a.min(b), a.max(b)], name));
    let named = NamedSurfaces::new(&feature_names(outcome), named.collect());
    field_data.extend(named.into_fields());
    let horizons = horizon_flags(lattice, &mesh.on_feature, names, &outcome.features);
    let pairs = mesh.face_cells.iter().zip(&horizons).filter(|f| *f.1);
    let pairs: Vec<i64> = pairs.flat_map(|(cells, _)| cells.map(i64::from)).collect();
    if !pairs.is_empty() {
        field_data.push((HORIZON_FACES_ARRAY.into(), FieldValue::Ints(pairs)));
    }
    let mut cell_data = vec![
        DataArray::scalars(if D == 2 { "area" } else { "volume" }, volume),
        DataArray::scalars("on_feature", on_feature),
        DataArray::scalars(DISTANCE_ARRAY, distance),
    ];
    cell_data.extend(live_array(outcome));
    MeshFile {
        cell_data,
        point_data: Vec::new(),
        field_data,
        mesh,
    }
}
