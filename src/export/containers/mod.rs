//! Numbers as text and as bytes, and the containers that hold them.
//!
//! - [`text`]: numbers as text, fast
//! - [`binary`]: numbers as bytes
//! - [`mat`]: MATLAB's container
//! - [`hdf5`], [`epc`]: the containers of RESQML

pub mod binary;
pub mod epc;
pub mod hdf5;
pub mod mat;
pub mod text;
