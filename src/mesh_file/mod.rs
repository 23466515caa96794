//! Mesh files as values, and the files that atomesh writes: a mesh in physical coordinates, with the
//! arrays and fields that belong to it.
//!
//! `store` reads these files, and those of other programs.
//!
//! - `array_names`: names of arrays and fields
//! - `vtu`: writes VTK unstructured grids of simplices, our own mesh format
//! - `polyhedra`: writes VTK unstructured grids of polyhedra and polygons
//! - `pvtu`: writes meshes in several files
//! - `physical`: lattice space and physical space
//! - `lattice_space`: where the lattice space of a mesh lies in the world, as its file stores it
//! - `formats`: names and numberings of other programs' formats
//! - `labels`: regions that are labels of an image
//! - `named_regions`: regions that have names, and cells beyond the image
//! - `named_surfaces`: surfaces that have names
//! - `named_sets`: sets of cells, faces and nodes that have names
//! - `cell_choice`: the regions of which a mesh keeps the cells
//! - `take_cells`: meshes of some cells of a mesh

pub(crate) mod array_names;
pub(crate) mod cell_choice;
pub(crate) mod formats;
pub(crate) mod labels;
pub(crate) mod lattice_space;
pub(crate) mod named_regions;
pub(crate) mod named_sets;
pub(crate) mod named_surfaces;
mod physical;
pub(crate) mod polyhedra;
pub(crate) mod pvtu;
mod take_cells;
pub(crate) mod vtu;

use std::path::Path;

use crate::Result;
use crate::files::vtk::DataArray;
pub use crate::files::vtk::pieces::FieldValue;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{TetMesh, TriMesh};
pub use cell_choice::{CellChoice, ChosenCells, KnownRegion, RegionNames};
pub use labels::{LabelledRegion, read_labels};
pub use lattice_space::{LatticeSpace, Provenance, image_geometry_in_depth};
pub use named_regions::{Burden, NamedRegion, read_named_regions};
pub use physical::{face_bits_to_physical, replace_nodes, to_physical};
pub use polyhedra::{CellStreams, write_cells_vtu};
pub use take_cells::{CUT_NAME, TakeCells, read_outer_boundary, take_cells};
pub use vtu::write_vtu;

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
        with_mesh!(self,
            simplices file => write_vtu(path, file),
            cells file => write_cells_vtu(path, file)
        )
    }
}

/// Implements the conversion of mesh files of one kind to those of any.
macro_rules! any_mesh_from {
    ($($kind:ident $mesh:ty),*) => {$(
        impl From<MeshFile<$mesh>> for AnyMesh {
            fn from(file: MeshFile<$mesh>) -> Self {
                Self::$kind(file)
            }
        }
    )*};
}

any_mesh_from!(Triangles TriMesh, Tetrahedra TetMesh, Polygons PolyMesh<2>, Polyhedra PolyMesh<3>);

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
            $crate::mesh_file::AnyMesh::Triangles($simplices) => $run,
            $crate::mesh_file::AnyMesh::Tetrahedra($simplices) => $run,
            $crate::mesh_file::AnyMesh::Polygons($cells) => $other,
            $crate::mesh_file::AnyMesh::Polyhedra($cells) => $other,
        }
    };
}

pub(crate) use crate::with_mesh;
