//! Reads unstructured grids of solid cells of several shapes as polyhedra. Flat cells in the file
//! mark faces on features.

use super::{MeshFile, read_arrays, read_cell_nodes, read_count, read_fields, read_nodes};
use crate::error::Result;
use crate::files::vtk::{DataArray, VtkFile};
use crate::geometry::sorted;
use crate::mesh::poly::PolyMesh;
use crate::store::foreign::REGION_ARRAYS;
use crate::store::mixed_elements::{MixedElement, SolidAssembler, mixed_element};
use crate::store::polyhedra::{face_streams, for_each_face};

/// Reads a mesh; `types` are VTK's cell types.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) for a damaged file, or for cells that do not match.
pub fn read_cells(file: &VtkFile, types: &[i64]) -> Result<MeshFile<PolyMesh<3>>> {
    let piece = file.piece()?;
    let points = read_count(file, piece, "NumberOfPoints")?;
    let nodes = read_nodes(file, file.child(piece, "Points")?, points)?;
    let element = file.child(piece, "Cells")?;
    let damaged = || {
        file.error(
            "has cells with a wrong number of nodes",
            crate::files::REWRITE_DAMAGED,
        )
    };
    let corners = read_cell_nodes(file, element, types.len())?;
    let has_polyhedra = types.contains(&i64::from(<PolyMesh<3> as crate::mesh::Mesh<3>>::VTK_CELL));
    let (stream, face_ends) = if has_polyhedra {
        face_streams(file, element)?
    } else {
        Default::default()
    };
    let (mut solids, mut solid_cells) = (SolidAssembler::default(), Vec::new());
    let mut flat: Vec<Vec<u32>> = Vec::new();
    let mut face_begin = 0;
    for (cell, &kind) in types.iter().enumerate() {
        let cell_corners = corners.get(cell);
        // Other cells have -1 here, or the end of the polyhedra before them.
        let face_end = face_ends
            .get(cell)
            .and_then(|&end| usize::try_from(end).ok());
        let faces = stream.get(face_begin..face_end.unwrap_or(face_begin));
        face_begin = face_end.unwrap_or(face_begin);
        match mixed_element(kind, cell_corners).ok_or_else(damaged)? {
            MixedElement::Line => {}
            MixedElement::Flat(ring) => flat.push(sorted(ring.to_vec())),
            MixedElement::Solid(faces) => {
                solid_cells.push(cell as u32);
                solids.add(
                    faces
                        .iter()
                        .map(|face| face.iter().map(|&k| cell_corners[k]).collect()),
                );
            }
            MixedElement::Polyhedron => {
                solid_cells.push(cell as u32);
                let mut rings = Vec::new();
                faces
                    .and_then(|stream| for_each_face(stream, |ring| rings.push(ring.to_vec())))
                    .ok_or_else(damaged)?;
                solids.add(rings);
            }
        }
    }
    let assembled = solids.into_mesh(&nodes);
    let remedy = "give a mesh whose cells meet face to face";
    let (mut mesh, kept) = assembled.map_err(|problem| file.error(problem, remedy))?;
    flat.sort_unstable();
    for f in 0..mesh.inner_face_count() {
        let ring = mesh.faces.get(f).iter().map(|&n| kept[n as usize]);
        mesh.on_feature[f] = flat.binary_search(&sorted(ring.collect())).is_ok();
    }
    let cell_data = select_rows(
        read_arrays(file, piece, "CellData", types.len())?,
        &solid_cells,
    );
    let is_scalar = |name: &&str| (cell_data.iter()).find(|a| a.name == *name && a.components == 1);
    if let Some(regions) = REGION_ARRAYS.iter().find_map(is_scalar) {
        mesh.region = regions.values.to_i64().iter().map(|&r| r as i32).collect();
    }
    Ok(MeshFile {
        mesh,
        point_data: select_rows(read_arrays(file, piece, "PointData", points)?, &kept),
        cell_data: cell_data
            .into_iter()
            .filter(|a| a.name != REGION_ARRAYS[0])
            .collect(),
        field_data: read_fields(file)?,
    })
}

/// Returns some rows of arrays.
fn select_rows(arrays: Vec<DataArray>, rows: &[u32]) -> Vec<DataArray> {
    let select = |array: DataArray| DataArray {
        values: array.values.select_tuples(rows, array.components),
        ..array
    };
    arrays.into_iter().map(select).collect()
}
