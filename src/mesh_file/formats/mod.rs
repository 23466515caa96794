//! Names and numberings of other programs' formats that their readers and their writers share.
//!
//! - `exodus`: Exodus II
//! - `gmsh`: Gmsh's mesh format

pub mod exodus;
pub mod gmsh;
