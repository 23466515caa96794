//! Writes numbers as bytes, and container files.
//!
//! - `binary`: numbers as bytes
//! - `mat`: MATLAB's container
//! - `hdf5`, `epc`: the containers of RESQML. VTKHDF, XDMF and CGNS use HDF5, too.
//! - `netcdf`: the container of Exodus

pub(crate) mod binary;
pub(crate) mod epc;
pub(crate) mod hdf5;
pub(crate) mod mat;
pub(crate) mod netcdf;

/// Returns a number of bytes, rounded up to a multiple of eight.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(8)
}
