//! Reads and writes VTK unstructured grids of tetrahedra or triangles (`.vtu`).
//!
//! Nodes are in double precision. Connectivity is in 32 bits if the numbers fit. VTK's tetrahedron
//! has our orientation: nodes 0, 1, 2 turn anticlockwise seen from node 3. Triangles lie in the
//! plane z = 0.

mod mixed_grid;

use std::any::Any;
use std::path::Path;

use crate::parallel::prelude::*;

use super::foreign::{self, region_arrays};
use super::mixed_elements;
use super::output::{UNITS_FIELD, array_unit};
use super::polyhedra::{self, CellStreams, is_polygon};
use super::pvtu::{is_pvtu, read_pvtu};
use crate::error::Result;
use crate::files::Batch;
pub use crate::files::vtk::pieces::FieldValue;
pub(crate) use crate::files::vtk::pieces::{
    check_lengths, read_cell_integers, read_cell_values, read_count, read_nodes,
};
use crate::files::vtk::xml::Element;
use crate::files::vtk::{ArraySource, DataArray, Document, Values, VtkFile};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh::{Mesh, Simplices, TetMesh, TriMesh};

/// A mesh and all data that are stored with it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeshFile<M = TetMesh> {
    /// The mesh, in physical coordinates.
    pub mesh: M,
    /// Arrays with one tuple for each node.
    pub point_data: Vec<DataArray>,
    /// Arrays with one tuple for each cell.
    pub cell_data: Vec<DataArray>,
    /// Values that belong to the whole mesh: version, parameters, the hash of the input.
    pub field_data: Vec<(String, FieldValue)>,
}

impl<M> MeshFile<M> {
    /// Returns the cell array of that name.
    pub fn cell_array(&self, name: &str) -> Option<&DataArray> {
        self.cell_data.iter().find(|array| array.name == name)
    }

    /// Returns the field value of that name.
    pub fn field_value(&self, name: &str) -> Option<&FieldValue> {
        let mut fields = self.field_data.iter();
        fields.find_map(|(known, value)| (known == name).then_some(value))
    }

    /// Splits into the mesh and the other data.
    pub fn into_parts(self) -> (M, MeshFile<()>) {
        let arrays = MeshFile {
            mesh: (),
            point_data: self.point_data,
            cell_data: self.cell_data,
            field_data: self.field_data,
        };
        (self.mesh, arrays)
    }
}

impl MeshFile<()> {
    /// Adds a mesh to the data.
    pub fn with_mesh<M>(self, mesh: M) -> MeshFile<M> {
        MeshFile {
            mesh,
            point_data: self.point_data,
            cell_data: self.cell_data,
            field_data: self.field_data,
        }
    }
}

/// Writes a mesh, completely or not at all.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written, and
/// [`Error::Mesh`](crate::Error::Mesh) if an array does not have one tuple for each node or cell.
pub fn write_vtu<const D: usize, M: Simplices<D>>(path: &Path, file: &MeshFile<M>) -> Result<()> {
    let mut batch = Batch::default();
    add_vtu(&mut batch, path, file)?;
    batch.commit()
}

/// Writes a mesh as [`write_vtu`] does, as one of several files of a batch.
///
/// # Errors
/// Returns the errors of [`write_vtu`].
pub fn add_vtu<const D: usize, M: Simplices<D>>(
    batch: &mut Batch,
    path: &Path,
    file: &MeshFile<M>,
) -> Result<()> {
    let MeshFile {
        mesh,
        point_data,
        cell_data,
        field_data,
    } = file;
    let (nodes, cells) = (mesh.nodes().len(), mesh.len());
    check_lengths(path, point_data, nodes, "nodes")?;
    check_lengths(path, cell_data, cells, M::CELLS_NAME)?;

    let mut document = Document::new("UnstructuredGrid", &[]);
    let fields: Vec<_> = field_data.iter().collect();
    let [point_data, cell_data]: [Vec<_>; 2] = [point_data, cell_data].map(|a| a.iter().collect());
    begin_piece(
        &mut document,
        &fields,
        mesh.nodes(),
        cells,
        &point_data,
        &cell_data,
    );
    document.open("Cells", &[]);
    let corners = mesh.connectivity();
    document.add_array(integer_source("connectivity", corners));
    let end = |c: usize| (D + 1) * (c + 1);
    document.add_array(if corners.len() <= i32::MAX as usize {
        ArraySource::computed("offsets", 1, cells, move |c| end(c) as i32)
    } else {
        ArraySource::computed("offsets", 1, cells, move |c| end(c) as i64)
    });
    document.add_array(ArraySource::computed("types", 1, cells, |_| M::VTK_CELL));
    batch.write(path, |out| document.write(out))
}

/// Cells of several types, for other programs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MixedCells {
    /// The nodes of each cell.
    pub corners: Lists,
    /// VTK's type of each cell.
    pub kinds: Vec<u8>,
    /// The faces of the polyhedra, which come first, as VTK stores them.
    faces: Vec<u32>,
    /// End of each polyhedron's faces in `faces`.
    face_ends: Vec<u64>,
}

impl MixedCells {
    /// Returns the cells of a mesh of polyhedra.
    pub fn polyhedra(mesh: &PolyMesh<3>) -> Self {
        let streams = CellStreams::new(mesh);
        let ends = streams.corner_ends.iter().map(|&end| end as u32);
        Self {
            corners: Lists {
                offsets: [0].into_iter().chain(ends).collect(),
                items: streams.corners,
            },
            kinds: vec![PolyMesh::<3>::VTK_CELL; mesh.sites.len()],
            faces: streams.faces,
            face_ends: streams.face_ends,
        }
    }

    /// Appends a cell.
    pub fn push(&mut self, kind: u8, corners: impl IntoIterator<Item = u32>) {
        self.corners.push(corners);
        self.kinds.push(kind);
    }
}

/// Writes a file of mixed cells, as one of several files of a batch.
///
/// # Errors
/// Returns the errors of [`write_vtu`].
pub fn add_mixed_vtu(
    batch: &mut Batch,
    path: &Path,
    nodes: &[[f64; 3]],
    cells: &MixedCells,
    point_data: &[DataArray],
    cell_data: &[DataArray],
) -> Result<()> {
    check_lengths(path, point_data, nodes.len(), "nodes")?;
    check_lengths(path, cell_data, cells.kinds.len(), "cells")?;
    let mut document = Document::new("UnstructuredGrid", &[]);
    let [points, arrays]: [Vec<_>; 2] = [point_data, cell_data].map(|a| a.iter().collect());
    let count = cells.kinds.len();
    begin_piece(&mut document, &[], nodes, count, &points, &arrays);
    document.open("Cells", &[]);
    document.add_array(integer_source("connectivity", &cells.corners.items));
    document.add_array(integer_source("offsets", &cells.corners.offsets[1..]));
    document.add_array(ArraySource::slice("types", 1, &cells.kinds));
    if !cells.faces.is_empty() {
        document.add_array(integer_source("faces", &cells.faces));
        // Other cells have no faces.
        let ends = |i: usize| cells.face_ends.get(i).map_or(-1, |&end| end as i64);
        document.add_array(ArraySource::computed("faceoffsets", 1, count, ends));
    }
    batch.write(path, |out| document.write(out))
}

/// Opens the only piece, and adds everything up to its cells.
pub(super) fn begin_piece<'a, const D: usize>(
    document: &mut Document<'a>,
    fields: &[&'a (String, FieldValue)],
    nodes: &'a [[f64; D]],
    cells: usize,
    point_data: &[&'a DataArray],
    cell_data: &[&'a DataArray],
) {
    if !fields.is_empty() {
        document.open("FieldData", &[]);
        for (name, value) in fields {
            document.add_array(match value {
                FieldValue::Text(text) => ArraySource::slice(name, 1, text.as_bytes()),
                FieldValue::F64s(numbers) => ArraySource::slice(name, 1, numbers),
                FieldValue::Ints(numbers) => ArraySource::slice(name, 1, numbers),
            });
        }
        document.close();
    }
    document.open(
        "Piece",
        &[
            ("NumberOfPoints", nodes.len().to_string()),
            ("NumberOfCells", cells.to_string()),
        ],
    );
    let mut units = (fields.iter())
        .find_map(|(name, value)| match value {
            FieldValue::Text(text) if name == UNITS_FIELD => Some(text.as_str()),
            _ => None,
        })
        .unwrap_or_default()
        .split(',')
        .map(str::to_string);
    let units: [String; D] = std::array::from_fn(|_| units.next().unwrap_or_default());
    for (element, arrays) in [("PointData", point_data), ("CellData", cell_data)] {
        document.open(element, &[]);
        for array in arrays {
            let source = array.values.source(&array.name, array.components);
            document.add_array(source.with_unit(array_unit(&array.name, &units)));
        }
        document.close();
    }
    document.open("Points", &[]);
    let coordinates = nodes.as_flattened();
    document.add_array(ArraySource::computed(
        "Points",
        3,
        3 * nodes.len(),
        |i| match i % 3 {
            k if k < D => coordinates[D * (i / 3) + k],
            _ => 0.0,
        },
    ));
    document.close();
}

/// Returns the coordinates of 2-D or 3-D points as 3-D coordinates, one after the other.
pub(super) fn coordinates_3d<const D: usize>(points: &[[f64; D]]) -> Vec<f64> {
    points
        .iter()
        .flat_map(|&p| crate::geometry::to_3d(p))
        .collect()
}

/// Returns an array of integers, in 32 bits if all fit.
pub(super) fn integer_source<'a, T>(name: &str, values: &'a [T]) -> ArraySource<'a>
where
    T: Copy + Into<u64> + Sync,
{
    let max = values.par_iter().map(|&v| v.into()).max().unwrap_or(0);
    if max <= i32::MAX as u64 {
        ArraySource::computed(name, 1, values.len(), |i| values[i].into() as i32)
    } else {
        ArraySource::computed(name, 1, values.len(), |i| values[i].into() as i64)
    }
}

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

/// A mesh file of any kind of cells.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMesh {
    /// Triangles in the plane.
    Triangles(MeshFile<TriMesh>),
    /// Tetrahedra.
    Tetrahedra(MeshFile<TetMesh>),
    /// Polygons in the plane.
    Polygons(MeshFile<PolyMesh<2>>),
    /// Polyhedra.
    Polyhedra(MeshFile<PolyMesh<3>>),
}

impl AnyMesh {
    /// Writes the mesh with all its arrays as a VTU file, completely or not at all.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        with_mesh!(self, file => super::Storable::write(path, file))
    }

    /// Converts a [`MeshFile`] of one of these kinds; `None` for anything else.
    pub fn from_any(file: Box<dyn Any>) -> Option<Self> {
        let file = match file.downcast() {
            Ok(triangles) => return Some(Self::Triangles(*triangles)),
            Err(file) => file,
        };
        let file = match file.downcast() {
            Ok(tetrahedra) => return Some(Self::Tetrahedra(*tetrahedra)),
            Err(file) => file,
        };
        match file.downcast() {
            Ok(cells) => Some(Self::Polygons(*cells)),
            Err(file) => Some(Self::Polyhedra(*file.downcast().ok()?)),
        }
    }
}

/// Runs the same code with a mesh of any kind: `with_mesh!(mesh, file => ...)`; or different code
/// for simplices and for polygons and polyhedra: `with_mesh!(mesh, simplices file => ..., cells
/// file => ...)`.
#[macro_export]
#[doc(hidden)]
macro_rules! with_mesh {
    ($mesh:expr, $file:pat => $run:expr) => {
        $crate::with_mesh!($mesh, simplices $file => $run, cells $file => $run)
    };
    ($mesh:expr, simplices $simplices:pat => $run:expr, cells $cells:pat => $other:expr) => {
        match $mesh {
            $crate::store::AnyMesh::Triangles($simplices) => $run,
            $crate::store::AnyMesh::Tetrahedra($simplices) => $run,
            $crate::store::AnyMesh::Polygons($cells) => $other,
            $crate::store::AnyMesh::Polyhedra($cells) => $other,
        }
    };
}
pub(crate) use crate::with_mesh;

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
