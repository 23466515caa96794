//! Models for flow simulators, one format a file.
//!
//! - [`opm`]: decks for OPM Flow and Eclipse
//! - [`openfoam`]: OpenFOAM cases
//! - [`disv`]: MODFLOW 6 on columns
//! - [`pflotran`], [`tough`], [`darts`]: cells and connections for PFLOTRAN, TOUGH2 and DARTS
//! - [`mrst`]: grids for MRST
//! - [`geos`]: VTU for GEOS
//! - [`resqml`]: RESQML packages

pub mod darts;
pub mod disv;
pub mod geos;
pub mod mrst;
pub mod openfoam;
pub mod opm;
pub mod pflotran;
pub mod resqml;
pub mod tough;
