//! Reads VTK unstructured grids of tetrahedra or triangles (`.vtu`).
//!
//! Nodes are in double precision. Connectivity is in 32 bits if the numbers fit. VTK's tetrahedron
//! has our orientation: nodes 0, 1, 2 turn anticlockwise seen from node 3. Triangles lie in the
//! plane z = 0.

mod mixed_grid;

use std::path::Path;

use super::foreign::{self, region_arrays};
use super::mixed_elements;
use super::polyhedra::{self, is_polygon};
use super::pvtu::read_pvtu;
use crate::error::Result;
pub(crate) use crate::files::vtk::pieces::{
    read_cell_integers, read_cell_values, read_count, read_nodes,
};
use crate::files::vtk::xml::Element;
use crate::files::vtk::{DataArray, Values, VtkFile};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh::{Mesh, Simplices, TriMesh};
use crate::mesh_file::pvtu::is_pvtu;
use crate::mesh_file::{AnyMesh, FieldValue, MeshFile};

/// Reads a mesh of tetrahedra that atomesh, VTK, ParaView or meshio wrote.
///
/// The node order of tetrahedra is kept, whatever their orientation, because the checker reports
/// inverted cells.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file has another format, is damaged or cut off,
/// or has cells other than tetrahedra.
pub fn read_vtu(path: &Path) -> Result<MeshFile> {
    read_cells(&VtkFile::read(path, "UnstructuredGrid")?)
}

/// Reads a mesh of triangles or polygons in the plane z = 0 (quadrilaterals are polygons), of
/// tetrahedra as [`read_vtu`] does, or of polyhedra. Meshes of tetrahedra, hexahedra, wedges and
/// pyramids together are read as polyhedra.
///
/// Meshes in several files (`.pvtu`) can be read if atomesh wrote them.
///
/// # Errors
/// Returns the errors of [`read_vtu`], and an error for triangles and polygons that are not in the
/// plane z = 0.
pub fn read_any_vtu(path: &Path) -> Result<AnyMesh> {
    Ok(read_any_vtu_with_notes(path)?.0)
}

/// Reads a mesh as [`read_any_vtu`] does. Returns also notes for the user.
///
/// # Errors
/// Returns the errors of [`read_any_vtu`].
pub fn read_any_vtu_with_notes(path: &Path) -> Result<(AnyMesh, Vec<String>)> {
    if is_pvtu(path) {
        return Ok((read_pvtu(path)?, Vec::new()));
    }
    read_vtk_file_with_notes(&VtkFile::read(path, "UnstructuredGrid")?, path)
}

/// Reads a mesh from a VTK file in memory; `path` names it in errors and notes.
///
/// # Errors
/// Returns the errors of [`read_any_vtu`].
pub(super) fn read_vtk_file_with_notes(
    file: &VtkFile,
    path: &Path,
) -> Result<(AnyMesh, Vec<String>)> {
    let mut notes = Vec::new();
    let mesh = read_grid(file, path, &mut notes)?;
    let place = path.display();
    notes
        .iter_mut()
        .for_each(|note| *note = format!("{place}: {note}"));
    Ok((mesh, notes))
}

fn read_grid(file: &VtkFile, path: &Path, notes: &mut Vec<String>) -> Result<AnyMesh> {
    let types = read_cell_integers(file, file.child(file.piece()?, "Cells")?, "types")?;
    let [triangle, polyhedron] = [TriMesh::VTK_CELL, PolyMesh::<3>::VTK_CELL].map(i64::from);
    Ok(match types.first() {
        Some(_) if types.iter().all(|&kind| kind == triangle) => {
            AnyMesh::Triangles(with_regions(read_cells(file)?, notes))
        }
        Some(_) if types.iter().all(|&kind| is_polygon(kind)) => {
            AnyMesh::Polygons(polyhedra::read_cells(file, notes)?)
        }
        Some(_) if types.iter().all(|&kind| kind == polyhedron) => {
            AnyMesh::Polyhedra(polyhedra::read_cells(file, notes)?)
        }
        Some(_) if mixed_elements::are_mixed(&types) => {
            AnyMesh::Polyhedra(mixed_grid::read_cells(file, &types, notes)?)
        }
        Some(_) if foreign::is_mixed(&types) => foreign::read_mixed(path, file, &types, notes)?,
        _ => AnyMesh::Tetrahedra(with_regions(read_cells(file)?, notes)),
    })
}

/// Returns a mesh with the array of regions, which other programs store under other names.
fn with_regions<M>(mut file: MeshFile<M>, notes: &mut Vec<String>) -> MeshFile<M> {
    let note = region_arrays::adopt(&mut file.cell_data, &mut file.field_data);
    notes.extend(note);
    file
}

fn read_cells<const D: usize, M: Simplices<D>>(file: &VtkFile) -> Result<MeshFile<M>> {
    let piece = file.piece()?;
    let points: usize = read_count(file, piece, "NumberOfPoints")?;
    let cells: usize = read_count(file, piece, "NumberOfCells")?;

    let nodes = read_nodes(file, file.child(piece, "Points")?, points)?;
    let corners = read_corners::<D, M>(file, file.child(piece, "Cells")?, points, cells)?;
    Ok(MeshFile {
        mesh: M::from_parts(nodes, corners),
        point_data: read_arrays(file, piece, "PointData", points)?,
        cell_data: read_arrays(file, piece, "CellData", cells)?,
        field_data: read_fields(file)?,
    })
}

/// Reads the field values.
pub(super) fn read_fields(file: &VtkFile) -> Result<Vec<(String, FieldValue)>> {
    let mut field_data = Vec::new();
    if let Some(fields) = file.data_set().child("FieldData") {
        for array in &fields.children {
            let name = array.attribute("Name").unwrap_or_default().to_string();
            if array.attribute("type") == Some("String") {
                field_data.push((name, FieldValue::Text(file.text(array)?)));
                continue;
            }
            field_data.push((
                name,
                match file.array(array)?.values {
                    Values::F64(v) => FieldValue::F64s(v),
                    Values::U8(v) => FieldValue::Text(String::from_utf8_lossy(&v).into_owned()),
                    v @ Values::F32(_) => FieldValue::F64s(v.to_f64()),
                    v => FieldValue::Ints(v.to_i64()),
                },
            ));
        }
    }
    Ok(field_data)
}

/// Reads the nodes of cells of several types, one list for each of `count` cells.
pub(crate) fn read_cell_nodes(file: &VtkFile, cells: &Element, count: usize) -> Result<Lists> {
    let damaged = || {
        file.error(
            "has cells with a wrong number of nodes",
            crate::files::REWRITE_DAMAGED,
        )
    };
    let ends = read_cell_integers(file, cells, "offsets")?;
    let numbers = |values: &[i64]| -> Result<Vec<u32>> {
        let number = |&n: &i64| u32::try_from(n).map_err(|_| damaged());
        values.iter().map(number).collect()
    };
    let offsets = [vec![0], numbers(ends.get(..count).ok_or_else(damaged)?)?].concat();
    let items = numbers(&read_cell_integers(file, cells, "connectivity")?)?;
    if !offsets.is_sorted() || offsets[count] as usize > items.len() {
        return Err(damaged());
    }
    Ok(Lists { offsets, items })
}

fn read_corners<const D: usize, M: Simplices<D>>(
    file: &VtkFile,
    cells: &Element,
    points: usize,
    count: usize,
) -> Result<Vec<u32>> {
    let values = |name: &str| read_cell_integers(file, cells, name);
    let size = D + 1;
    let types = values("types")?;
    if let Some((cell, kind)) = types
        .iter()
        .enumerate()
        .find(|&(_, &t)| t != i64::from(M::VTK_CELL))
    {
        return Err(file.error(
            format!(
                "cell {cell} is of VTK's type {kind}, not of type {} as {} are",
                M::VTK_CELL,
                M::CELLS_NAME
            ),
            format!("give a mesh of linear {} only", M::CELLS_NAME),
        ));
    }
    let ends = values("offsets")?;
    let corners = values("connectivity")?;
    let is_regular = ends
        .iter()
        .zip(1..)
        .all(|(&end, cell)| end == size as i64 * cell);
    if types.len() != count
        || ends.len() != count
        || corners.len() != count.saturating_mul(size)
        || !is_regular
    {
        let problem = format!(
            "has {count} cells, but {} types, {} offsets and {} node numbers",
            types.len(),
            ends.len(),
            corners.len()
        );
        return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
    }
    if points > u32::MAX as usize {
        return Err(file.error(
            format!("has {points} points"),
            "give a mesh of fewer than 2^32",
        ));
    }
    if let Some(node) = corners.iter().find(|&&c| c < 0 || c as usize >= points) {
        let problem = format!("a cell has node {node}, but there are {points} points");
        return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
    }
    Ok(corners.iter().map(|&c| c as u32).collect())
}

pub(super) fn read_arrays(
    file: &VtkFile,
    piece: &Element,
    name: &str,
    tuples: usize,
) -> Result<Vec<DataArray>> {
    let Some(element) = piece.child(name) else {
        return Ok(Vec::new());
    };
    let mut arrays = Vec::new();
    for array in element.children.iter().filter(|a| a.name == "DataArray") {
        let array = file.array(array)?;
        if array.values.len() != tuples.saturating_mul(array.components) {
            let problem = format!(
                "array '{}' of {name} has {} numbers for {tuples} tuples of {}",
                array.name,
                array.values.len(),
                array.components
            );
            return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
        }
        arrays.push(array);
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests;
