//! Writes triangles and tetrahedra (VTKHDF, CGNS and Exodus: cells of any shape) with named faces,
//! one module per format.
//!
//! - `groups`: the named faces
//! - `simplices`: the mesh that the writers share
//! - `msh`: meshes for Gmsh
//! - `inp`: Abaqus and CalculiX
//! - `nastran`: NASTRAN bulk data
//! - `febio`: models for FEBio
//! - `medit`: meshes for Medit
//! - `exodus`: Exodus II
//! - `vtkhdf`, `xdmf`: HDF5 for VTK and ParaView
//! - `cgns`: CGNS
//! - `tetgen`: meshes for TetGen
//! - `stl`: surfaces alone, as STL and OBJ

pub(crate) mod cgns;
pub(crate) mod exodus;
pub(crate) mod febio;
pub(crate) mod groups;
pub(crate) mod inp;
pub(crate) mod medit;
pub(crate) mod msh;
pub(crate) mod nastran;
pub(crate) mod simplices;
pub(crate) mod stl;
pub(crate) mod tetgen;
pub(crate) mod vtkhdf;
pub(crate) mod xdmf;

use super::format::{ExportContent, ExportFormat};

/// Formats of this folder, in the order in which they are listed.
pub(crate) const FORMATS: &[&ExportFormat] = &[
    &msh::FORMAT_V4,
    &msh::FORMAT_V2,
    &inp::FORMAT,
    &nastran::FORMAT,
    &febio::FORMAT,
    &medit::FORMAT,
    &tetgen::FORMAT,
    &exodus::FORMAT,
    &vtkhdf::FORMAT,
    &xdmf::FORMAT,
    &cgns::FORMAT,
    &stl::FORMAT,
    &stl::FORMAT_OBJ,
];

/// Content of formats that hold names, values and quadratic elements.
const NAMES_AND_ROCK: &[ExportContent] = &[
    ExportContent::Names,
    ExportContent::Regions,
    ExportContent::Porosity,
    ExportContent::Permeability,
    ExportContent::Properties,
    ExportContent::SplitNodes,
    ExportContent::Quadratic,
];

/// Content of formats that hold named elements and pairs of periodic nodes.
const PERIODIC_ELEMENTS: &[ExportContent] = &[
    ExportContent::Names,
    ExportContent::Regions,
    ExportContent::SplitNodes,
    ExportContent::Quadratic,
    ExportContent::PeriodicPairs,
];

/// Content of formats that hold named elements, linear or quadratic, without values.
const NAMED_ELEMENTS: &[ExportContent] = &[
    ExportContent::Names,
    ExportContent::Regions,
    ExportContent::SplitNodes,
    ExportContent::Quadratic,
];
