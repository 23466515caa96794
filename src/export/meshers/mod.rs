//! Triangles and tetrahedra with named faces, one format a file.
//!
//! - `groups`: the named faces
//! - `simplices`: what the writers share
//! - `msh`: meshes for Gmsh
//! - `inp`: Abaqus and CalculiX
//! - `medit`: meshes for Medit
//! - `tetgen`: meshes for TetGen
//! - `stl`, `obj`: surfaces alone

pub(crate) mod groups;
pub(crate) mod inp;
pub(crate) mod medit;
pub(crate) mod msh;
pub(crate) mod obj;
pub(crate) mod simplices;
pub(crate) mod stl;
pub(crate) mod tetgen;
