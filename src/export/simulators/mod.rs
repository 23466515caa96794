//! Writes models for flow simulators, one module per format.
//!
//! - [`opm`]: decks for OPM Flow and Eclipse, with cells and connections
//! - `deck`: the common parts of all decks
//! - `openfoam`: OpenFOAM cases
//! - `disv`: MODFLOW 6 on columns
//! - `pflotran`, `tough`, `darts`: cells and connections for PFLOTRAN, TOUGH2 and DARTS
//! - `mrst`: grids for MRST
//! - `geos`: VTU for GEOS
//! - `resqml`: RESQML packages

pub(crate) mod darts;
pub(crate) mod deck;
pub(crate) mod disv;
pub(crate) mod geos;
pub(crate) mod mrst;
pub(crate) mod openfoam;
pub mod opm;
pub(crate) mod pflotran;
pub(crate) mod resqml;
pub(crate) mod tough;

use super::format::{ExportContent, ExportFormat};

/// Formats of this folder, in the order in which they are listed.
pub(crate) const FORMATS: &[&ExportFormat] = &[
    &opm::FORMAT,
    &openfoam::FORMAT,
    &pflotran::FORMAT,
    &tough::FORMAT,
    &disv::FORMAT,
    &mrst::FORMAT,
    &geos::FORMAT,
    &resqml::FORMAT,
    &darts::FORMAT,
];

/// Content of formats that list cells and connections, without wells and schedule.
const CONNECTION_LIST: &[ExportContent] = &[
    ExportContent::Regions,
    ExportContent::Porosity,
    ExportContent::Permeability,
    ExportContent::Properties,
    ExportContent::CutOffs,
    ExportContent::Faults,
    ExportContent::ClosedFaults,
    ExportContent::FaultsWithoutRock,
];
