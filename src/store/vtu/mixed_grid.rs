//! Reads unstructured grids of solid cells of several shapes as polyhedra. Flat cells in the file
//! mark faces on features.

use super::{read_arrays, read_cell_nodes, read_count, read_fields, read_nodes};
use crate::error::Result;
use crate::files::vtk::VtkFile;
use crate::geometry::sorted;
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;
use crate::mesh::renumber::new_numbers;
use crate::mesh_file::MeshFile;
use crate::mesh_file::array_names::REGION_ARRAY;
use crate::store::foreign::{
    Combinations, GroupNames, GroupedFaces, poly_file, region_arrays, select_rows, vtk_group,
};
use crate::store::mixed_elements::{MixedElement, SolidAssembler, mixed_element};
use crate::store::named_sets::NamedSets;
use crate::store::polyhedra::{face_streams, for_each_face};

/// Reads a mesh; `types` are VTK's cell types. Adds notes for the user.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) for a damaged file, or for cells that do not match.
pub fn read_cells(
    file: &VtkFile,
    types: &[i64],
    notes: &mut Vec<String>,
) -> Result<MeshFile<PolyMesh<3>>> {
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
    let mut flat: Vec<(usize, &[u32])> = Vec::new();
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
            MixedElement::Flat(ring) => flat.push((cell, ring)),
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
    let arrays = read_arrays(file, piece, "CellData", types.len())?;
    let numbers = region_arrays::find(&arrays).map(|found| found.regions);
    let mut combinations = Combinations::default();
    let new_index = new_numbers(points, &kept);
    let mut faces = Vec::new();
    for (cell, ring) in flat {
        let group = vtk_group(numbers.as_ref().map(|numbers| numbers[cell]));
        // A node beyond the points is on no cell.
        let index = |&n: &u32| new_index.get(n as usize).copied().unwrap_or(NONE);
        let ring: Vec<u32> = sorted(ring.iter().map(index).collect());
        faces.push((ring, combinations.number(&[group])));
    }
    let names = GroupNames::new();
    let grouped = GroupedFaces::new(faces, &mut combinations, &names);
    let mut cell_data = select_rows(arrays, &solid_cells);
    let mut fields = read_fields(file)?;
    notes.extend(region_arrays::adopt(&mut cell_data, &mut fields));
    if let Some(index) = cell_data.iter().position(|a| a.name == REGION_ARRAY) {
        let regions = cell_data.remove(index).values.to_i64();
        mesh.region = regions.iter().map(|&region| region as i32).collect();
    }
    let mut read = poly_file(mesh, grouped, NamedSets::default(), notes);
    let point_data = read_arrays(file, piece, "PointData", points)?;
    read.point_data.extend(select_rows(point_data, &kept));
    read.cell_data.extend(cell_data);
    fields.append(&mut read.field_data);
    read.field_data = fields;
    Ok(read)
}
