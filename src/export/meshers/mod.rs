//! Triangles and tetrahedra with named faces, one format a file.
//!
//! - [`groups`](mod@groups): the named faces
//! - [`simplices`]: what the writers share
//! - [`msh`]: meshes for Gmsh
//! - [`inp`]: Abaqus and CalculiX
//! - [`medit`]: meshes for Medit
//! - [`tetgen`]: meshes for TetGen
//! - [`stl`], [`obj`]: surfaces alone

pub mod groups;
pub mod inp;
pub mod medit;
pub mod msh;
pub mod obj;
pub mod simplices;
pub mod stl;
pub mod tetgen;
