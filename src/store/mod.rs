//! Reads mesh files, and writes a series of them. Files are in physical coordinates;
//! [`mesh_file`](crate::mesh_file) has the files as values and writes them.
//!
//! - `vtu`: VTK unstructured grids, our own mesh format
//! - `polyhedra`: VTK unstructured grids of polyhedra and polygons
//! - `pvtu`: meshes in several files
//! - `padding`: the mesh of the image alone
//! - `pvd`: the lattice after each round, for ParaView
//! - `foreign`: meshes of other programs
//! - `info`: descriptions of files
//! - `input`: the mesh of a verb, and the images that its options name
//! - `depth`: meshes converted from two-way time to depth
//! - `mixed_elements`: cells of several shapes as polyhedra
//! - `stored_mesh`: meshes from files, whatever their cells are, and the conversion back to lattice
//!   space

pub(crate) mod depth;
mod foreign;
pub(crate) mod info;
pub(crate) mod input;
mod mixed_elements;
mod padding;
mod polyhedra;
pub(crate) mod pvd;
mod pvtu;
pub(crate) mod stored_mesh;
pub(crate) mod vtu;

pub use crate::mesh_file::{
    AnyMesh, CellStreams, FieldValue, LabelledRegion, LatticeSpace, MeshFile, NamedRegion,
    TakeCells, face_bits_to_physical, image_geometry_in_depth, read_labels, read_named_regions,
    replace_nodes, take_cells, to_physical, write_cells_vtu, write_vtu,
};
pub(crate) use crate::mesh_file::{named_sets, with_mesh};
pub use depth::to_depth;
pub use foreign::{read_any_mesh, read_any_mesh_with_notes};
pub use info::{FileInfo, info};
pub use input::{ImageInput, MeshInput};
pub use padding::without_padding;
pub use pvd::PvdSeries;
pub use stored_mesh::{Storable, StoredMesh};
pub use vtu::{read_any_vtu, read_vtu};
