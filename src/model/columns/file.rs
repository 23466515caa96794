//! Converts columns to the contents of a mesh file.

use crate::files::vtk::DataArray;
use crate::geometry::bounding_box;
use crate::image::Geometry;
use crate::mesh::poly::PolyMesh;
use crate::mesh_file::Provenance;
use crate::mesh_file::array_names::{LIVE_ARRAY, THROWS_FIELD};
use crate::mesh_file::lattice_space::common_fields;
use crate::model::columns::{COLUMN, Columns, LAYER};
use crate::store::{FieldValue, LatticeSpace, MeshFile};

/// Properties of a map's cells that their columns take over.
pub struct MapCells<'a> {
    /// The region of each cell.
    pub regions: &'a [i32],
    /// The share of each cell that holds data, if some hold none.
    pub live: Option<&'a [f64]>,
}

/// Converts columns on the cells of a map to a mesh file. The lattice space is that of the map, with z from the lowest node upwards; `z_unit`
/// is the unit of z.
pub fn columns_to_file(
    columns: Columns,
    MapCells { regions, live }: MapCells<'_>,
    map: &LatticeSpace<2>,
    z_unit: &str,
    provenance: &Provenance,
) -> MeshFile<PolyMesh<3>> {
    let [low, high] = bounding_box(&columns.mesh.nodes);
    let mut geometry: Geometry<3> = map.geometry.to_3d();
    geometry.origin[2] = low[2];
    geometry.units[2] = z_unit.into();
    let step = [map.step[0], map.step[1], 1.0];
    let extent = [map.extent[0], map.extent[1], high[2] - low[2]];
    let volume: Vec<f64> = columns.mesh.cell_shapes().iter().map(|s| s.0).collect();
    let mut cell_data = vec![
        DataArray::scalars(COLUMN, columns.column.clone()),
        DataArray::scalars(LAYER, columns.layer.clone()),
        DataArray::scalars("volume", volume),
    ];
    if regions.iter().any(|r| *r != 0) {
        let map_region = columns.column.iter().map(|&c| regions[c as usize]);
        cell_data.push(DataArray::scalars(
            "map_region",
            map_region.collect::<Vec<i32>>(),
        ));
    }
    if let Some(live) = live {
        let shares = columns.column.iter().map(|&c| live[c as usize]);
        cell_data.push(DataArray::scalars(LIVE_ARRAY, shares.collect::<Vec<f64>>()));
    }
    let mut field_data = common_fields(&geometry, step, extent, provenance);
    if columns.juxtaposed.is_some() {
        field_data.push((THROWS_FIELD.into(), FieldValue::Ints(vec![1])));
    }
    MeshFile {
        mesh: columns.mesh,
        point_data: Vec::new(),
        cell_data,
        field_data,
    }
}
