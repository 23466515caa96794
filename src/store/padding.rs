//! The mesh of an image alone, without the cells beyond it.

use super::{LatticeSpace, MeshFile};
use crate::files::vtk::DataArray;
use crate::geometry::{bounding_box, sorted_distinct};
use crate::mesh::Simplices;
use crate::mesh_file::array_names::{
    BENT_SIDE_FIELD, LATTICE_EXTENT_FIELD, ORIGIN_FIELD, REGION_ARRAY, REGIONS_FIELD,
};
use crate::mesh_file::{Burden, NamedRegion, read_named_regions};
use crate::store::FieldValue;

/// Returns the mesh of the image alone: without the cells beyond it, if there are any. The lattice space
/// of the file becomes that of the image again. The second value is the number of cells left out.
pub fn without_padding<const D: usize, M: Simplices<D>>(file: MeshFile<M>) -> (MeshFile<M>, usize) {
    let is_burden = |named: &NamedRegion| Burden::ALL.iter().any(|b| b.name() == named.name);
    let named = read_named_regions(&file).into_iter().filter(is_burden);
    let beyond: Vec<i64> = named.map(|named| named.region.into()).collect();
    let regions = file
        .cell_data
        .iter()
        .find(|array| array.name == REGION_ARRAY);
    let regions = regions.map_or(Vec::new(), |array| array.values.to_i64());
    let kept: Vec<u32> = (regions.iter().zip(0..))
        .filter(|(region, _)| !beyond.contains(region))
        .map(|(_, cell)| cell)
        .collect();
    let space = LatticeSpace::from_file(&file, file.mesh.nodes());
    let (false, Some(space)) = (beyond.is_empty() || kept.is_empty(), space) else {
        return (file, 0);
    };
    let dropped_count = file.mesh.len() - kept.len();
    let corners = |&cell: &u32| {
        let start = cell as usize * (D + 1);
        file.mesh.connectivity()[start..start + D + 1]
            .iter()
            .copied()
    };
    let corners: Vec<u32> = kept.iter().flat_map(corners).collect();
    let nodes = sorted_distinct(corners.iter().copied());
    let number = |node: &u32| nodes.binary_search(node).unwrap_or(0) as u32;
    let positions: Vec<[f64; D]> = nodes
        .iter()
        .map(|&n| file.mesh.nodes()[n as usize])
        .collect();
    let [low, high] = bounding_box(positions.iter().filter_map(|&x| space.to_lattice(x)));
    let mesh = M::from_parts(positions, corners.iter().map(number).collect());
    let select = |arrays: Vec<DataArray>, indices: &[u32]| -> Vec<DataArray> {
        let selected = arrays.into_iter().map(|array| DataArray {
            values: array.values.select_tuples(indices, array.components),
            ..array
        });
        selected.collect()
    };
    // The box of an image has a whole number of steps.
    let extent = (0..D).map(|k| ((high[k] - low[k]) / space.step[k]).round() * space.step[k]);
    let extent: Vec<f64> = extent.collect();
    let mut field_data = file.field_data;
    field_data.retain(|(name, _)| name != REGIONS_FIELD && name != BENT_SIDE_FIELD);
    for (name, value) in &mut field_data {
        match name.as_str() {
            ORIGIN_FIELD => *value = FieldValue::F64s(space.to_world(low).to_vec()),
            LATTICE_EXTENT_FIELD => *value = FieldValue::F64s(extent.clone()),
            _ => {}
        }
    }
    let file = MeshFile {
        mesh,
        point_data: select(file.point_data, &nodes),
        cell_data: select(file.cell_data, &kept),
        field_data,
    };
    (file, dropped_count)
}
