//! Writes VTK unstructured grids of polyhedra (cell type 42) or, in 2-D, polygons (7).
//!
//! VTK stores the faces of every polyhedron with it, oriented outwards, so each face between two
//! cells is in the file twice. Sites and regions are cell data. Faces on features are a list of pairs of
//! cells in the field data.

use std::path::Path;

use super::array_names::{FEATURE_FACES_FIELD, REGION_ARRAY, SITE_ARRAY};
use super::vtu::{begin_piece, coordinates_3d, integer_source};
use super::{FieldValue, MeshFile};
use crate::Result;
use crate::files::Batch;
use crate::files::vtk::pieces::check_lengths;
use crate::files::vtk::{ArrayPacking, ArraySource, DataArray, Document};
use crate::mesh::Mesh;
use crate::mesh::poly::{FaceNeighbour, PolyMesh};
use crate::parallel::prelude::*;

/// Number of cells in one parallel task.
const CHUNK_CELLS: usize = 4096;

/// Number of tasks whose results are in memory at the same time.
const CHUNKS_PER_BATCH: usize = 16;

/// Writes a mesh of polyhedra or polygons, completely or not at all. `site`, `region` and
/// `feature_faces` come from the mesh; `point_data` and `cell_data` are additional arrays.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written, and
/// [`Error::Mesh`](crate::Error::Mesh) if an array does not have one tuple for each node or cell.
pub fn write_cells_vtu<const D: usize>(path: &Path, file: &MeshFile<PolyMesh<D>>) -> Result<()> {
    let mut batch = Batch::default();
    let (points, cells) = (&file.point_data, &file.cell_data);
    add_cells_vtu(
        &mut batch,
        path,
        &file.mesh,
        points,
        cells,
        &file.field_data,
        ArrayPacking::Zlib,
    )?;
    batch.commit()
}

/// Writes a mesh as [`write_cells_vtu`] does, as one of several files of a batch, with the given
/// packing.
///
/// # Errors
/// Returns the errors of [`write_cells_vtu`].
pub fn add_cells_vtu<const D: usize>(
    batch: &mut Batch,
    path: &Path,
    mesh: &PolyMesh<D>,
    point_data: &[DataArray],
    cell_data: &[DataArray],
    field_data: &[(String, FieldValue)],
    packing: ArrayPacking,
) -> Result<()> {
    let (nodes, cells) = (mesh.nodes.len(), mesh.sites.len());
    check_lengths(path, point_data, nodes, "nodes")?;
    check_lengths(path, cell_data, cells, "cells")?;
    let site = DataArray {
        name: SITE_ARRAY.to_string(),
        components: 3,
        values: coordinates_3d(&mesh.sites).into(),
    };
    let region = DataArray::scalars(REGION_ARRAY, mesh.region.clone());
    let mut pairs = Vec::new();
    for f in (0..mesh.face_cells.len()).filter(|&f| mesh.on_feature[f]) {
        if let FaceNeighbour::Cell(_) = mesh.face_neighbour(f) {
            pairs.extend(mesh.face_cells[f].map(i64::from));
        }
    }
    let pairs = (FEATURE_FACES_FIELD.to_string(), FieldValue::Ints(pairs));
    let fields: Vec<_> = field_data.iter().chain([&pairs]).collect();
    let cell_data: Vec<_> = [&region, &site].into_iter().chain(cell_data).collect();
    let point_data: Vec<_> = point_data.iter().collect();
    let streams = CellStreams::new(mesh);

    let mut document = Document::with_packing("UnstructuredGrid", &[], packing);
    begin_piece(
        &mut document,
        &fields,
        &mesh.nodes,
        cells,
        &point_data,
        &cell_data,
    );
    document.open("Cells", &[]);
    document.add_array(integer_source("connectivity", &streams.corners));
    document.add_array(integer_source("offsets", &streams.corner_ends));
    let kind = PolyMesh::<D>::VTK_CELL;
    document.add_array(ArraySource::computed("types", 1, cells, |_| kind));
    if D == 3 {
        document.add_array(integer_source("faces", &streams.faces));
        document.add_array(integer_source("faceoffsets", &streams.face_ends));
    }
    batch.write(path, |out| document.write(out))
}

/// The arrays in which VTK stores polyhedra or polygons.
#[derive(Debug, Default)]
pub struct CellStreams {
    /// The nodes of each cell, ascending; in 2-D in anticlockwise order.
    pub corners: Vec<u32>,
    /// End of each cell's nodes in `corners`.
    pub corner_ends: Vec<u64>,
    /// For each cell the number of its faces, and for each face the number of its nodes followed by
    /// the nodes.
    pub faces: Vec<u32>,
    /// End of each cell's faces in `faces`.
    pub face_ends: Vec<u64>,
}

impl CellStreams {
    /// Creates the arrays of a mesh.
    pub fn new<const D: usize>(mesh: &PolyMesh<D>) -> Self {
        let lists = mesh.faces_of_cells();
        let cells = mesh.sites.len();
        let part = |chunk: usize| {
            let mut part = Self::default();
            for cell in chunk * CHUNK_CELLS..((chunk + 1) * CHUNK_CELLS).min(cells) {
                part.add(mesh, cell, lists.get(cell));
            }
            part
        };
        let mut all = Self::default();
        let chunks = cells.div_ceil(CHUNK_CELLS);
        // Only a few parts are computed at a time, to save memory.
        for first in (0..chunks).step_by(CHUNKS_PER_BATCH) {
            let batch_chunks = first..chunks.min(first + CHUNKS_PER_BATCH);
            let parts: Vec<Self> = batch_chunks.into_par_iter().map(part).collect();
            parts.iter().for_each(|part| all.append(part));
        }
        all
    }

    fn append(&mut self, part: &Self) {
        let (corners, faces) = (self.corners.len() as u64, self.faces.len() as u64);
        let ends = part.corner_ends.iter().map(|end| end + corners);
        self.corner_ends.extend(ends);
        let ends = part.face_ends.iter().map(|end| end + faces);
        self.face_ends.extend(ends);
        self.corners.extend_from_slice(&part.corners);
        self.faces.extend_from_slice(&part.faces);
    }

    fn add<const D: usize>(&mut self, mesh: &PolyMesh<D>, cell: usize, faces: &[u32]) {
        let is_first_cell = |f: u32| mesh.face_cells[f as usize][0] as usize == cell;
        let start = self.corners.len();
        if D == 2 {
            mesh.append_ring(cell, faces, &mut self.corners);
            self.corner_ends.push(self.corners.len() as u64);
            return;
        }
        self.faces.push(faces.len() as u32);
        for &f in faces {
            let ring = mesh.faces.get(f as usize);
            self.faces.push(ring.len() as u32);
            if is_first_cell(f) {
                self.faces.extend_from_slice(ring);
            } else {
                self.faces.extend(ring.iter().rev());
            }
            self.corners.extend_from_slice(ring);
        }
        self.face_ends.push(self.faces.len() as u64);
        self.corners[start..].sort_unstable();
        let mut kept = start;
        for i in start..self.corners.len() {
            if i == start || self.corners[i] != self.corners[i - 1] {
                self.corners[kept] = self.corners[i];
                kept += 1;
            }
        }
        self.corners.truncate(kept);
        self.corner_ends.push(kept as u64);
    }
}
