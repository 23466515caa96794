//! Writes VTK unstructured grids of tetrahedra or triangles (`.vtu`), and of cells of several types.
//!
//! Nodes are in double precision. Connectivity is in 32 bits if the numbers fit. VTK's tetrahedron
//! has our orientation: nodes 0, 1, 2 turn anticlockwise seen from node 3. Triangles lie in the
//! plane z = 0.

use std::path::Path;

use super::array_names::{UNITS_FIELD, array_unit};
use super::{CellStreams, FieldValue, MeshFile};
use crate::Result;
use crate::files::Batch;
use crate::files::vtk::pieces::check_lengths;
use crate::files::vtk::{ArraySource, DataArray, Document};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh::{Mesh, Simplices};
use crate::parallel::prelude::*;

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
