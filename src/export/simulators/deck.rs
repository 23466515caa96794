//! Writes the common parts of decks for OPM Flow and Eclipse, which do not depend on the grid:
//! head, fluids, wells, time. Units are METRIC.

use std::io::Write;

use crate::Result;
use crate::error::{Error, cause};
use crate::export::containers::text::write_numbers;
use crate::export::containers::text::{FileWriter, WriteResult};
use crate::model::reservoir::{
    BAR, Control, DAY, Fluid, Model, OIL_DENSITY, SimulationCase, WATER_DENSITY, Well,
};

/// Conversion factor from m^3 to cP rm3/day/bar, so that T dp / viscosity is a rate in METRIC
/// units.
pub const TRANSMISSIBILITY_UNIT: f64 = DAY * BAR / 1e-3;
/// Saturation of immobile water in rock full of oil.
pub(crate) const CONNATE_WATER_SATURATION: f64 = 0.2;
/// Number of steps of the table of relative permeabilities, up to the residual oil saturation.
const TABLE_STEPS: usize = 12;
/// Number of reports.
const REPORT_COUNT: usize = 10;

/// Connection of a well to a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellConnection {
    /// i, j and k of the cell, from 1.
    pub cell: [usize; 3],
    /// Well index in m^3.
    pub index: f64,
}

/// Checks that a deck can hold the porosity and the well names of a model.
///
/// # Errors
/// Returns [`Error::Export`] if a porosity is outside [0, 1], or if a deck cannot hold the name of
/// a well.
pub(crate) fn check(model: &Model, porosity: &[f64]) -> Result<()> {
    let is_invalid = |cell: &usize| {
        let p = porosity[*cell];
        model.is_active(*cell) && !(p > 0.0 && p <= 1.0)
    };
    if let Some(cell) = (0..porosity.len()).find(is_invalid) {
        return Err(Error::Export(cause(
            "porosity",
            format!("is {} in cell {cell}", porosity[cell]),
            "give fractions of volume: 0 in inactive cells, otherwise up to 1",
        )));
    }
    for well in &model.case.wells {
        let is_valid_char = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let starts_with_letter = well.name.starts_with(|c: char| c.is_ascii_alphabetic());
        if !well.name.chars().all(is_valid_char) || !starts_with_letter || well.name.len() > 8 {
            return Err(Error::Export(cause(
                format!("well '{}'", well.name),
                "has a name that a deck cannot hold",
                "give up to eight letters, digits or _, the first a letter",
            )));
        }
    }
    Ok(())
}

/// Writes a keyword with a number for each cell.
pub(crate) fn write_array(
    out: FileWriter,
    name: &str,
    cells: usize,
    value: impl Fn(usize) -> f64 + Sync,
) -> WriteResult {
    writeln!(out, "{name}")?;
    write_numbers(out, cells, value)?;
    writeln!(out, "/\n")
}

/// Writes RUNSPEC for a grid with these dimensions. `comment` is a line for readers, and
/// `connections` are as for [`write_schedule`].
pub(crate) fn write_runspec(
    out: FileWriter,
    case: &SimulationCase,
    comment: &str,
    dims: [usize; 3],
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    let max_connections = connections.iter().map(Vec::len).max().unwrap_or(1);
    let wells = case.wells.len().max(1);
    let phases = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL\nWATER",
    };
    let [n, m, layers] = dims;
    writeln!(
        out,
        "-- atomesh {}: {comment}\n\
         RUNSPEC\nTITLE\n {}\n\nDIMENS\n {n} {m} {layers} /\n{phases}\nMETRIC\n\
         START\n 1 JAN 2000 /\nWELLDIMS\n {wells} {max_connections} 1 {wells} /\nTABDIMS\n/\nUNIFOUT\n",
        env!("CARGO_PKG_VERSION"),
        case.title
    )
}

/// Writes PROPS.
pub(crate) fn write_props(out: FileWriter, case: &SimulationCase) -> WriteResult {
    let reference = case.top_pressure / BAR;
    writeln!(
        out,
        "PROPS\n\nPVTW\n {reference} 1.0 4.5E-5 1.0 0 /\nROCK\n {reference} 4.5E-5 /\n\
         DENSITY\n {OIL_DENSITY} {WATER_DENSITY} 1 /"
    )?;
    if case.fluid == Fluid::OilWater {
        writeln!(
            out,
            "PVCDO\n {reference} 1.1 1.0E-4 2.0 0 /\n\
             SWOF"
        )?;
        // Corey functions with exponents of 2, 20 % immobile water and 20 % residual oil.
        for step in 0..=TABLE_STEPS {
            let water = CONNATE_WATER_SATURATION + 0.6 * step as f64 / TABLE_STEPS as f64;
            let [water_mobility, oil_mobility] = [
                (water - CONNATE_WATER_SATURATION) / 0.8,
                (0.8 - water) / 0.6,
            ];
            writeln!(
                out,
                " {water:.3} {:.6} {:.6} 0",
                water_mobility.powi(2),
                oil_mobility.powi(2)
            )?;
        }
        writeln!(out, " 1 1 0 0 /")?;
    }
    writeln!(out)
}

/// Writes SUMMARY and SCHEDULE. `connections` are the connections of each well. Without wells
/// nothing flows, and no time steps are written: OPM Flow, whose time steps depend on changes,
/// would stop with a failed assertion.
pub(crate) fn write_schedule(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    writeln!(out, "SUMMARY\nFPR\nWBHP\n/\nWWIR\n/\nWWPR\n/")?;
    if case.fluid == Fluid::OilWater {
        writeln!(out, "WOPR\n/\nFOPT\nFOIP\nFWIT\nFWPT")?;
    }
    writeln!(out, "\nSCHEDULE\n\nRPTRST\n BASIC=2 /")?;
    if case.wells.is_empty() {
        return writeln!(
            out,
            "-- No wells: nothing moves, and there are no time steps\n\nEND"
        );
    }
    write_wells(out, case, connections)?;
    let step = case.duration / DAY / REPORT_COUNT as f64;
    writeln!(out, "TSTEP\n {REPORT_COUNT}*{step} /\n\nEND")
}

fn write_wells(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    let produced_phase = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL",
    };
    let wells_with_connections = || case.wells.iter().zip(connections);
    writeln!(out, "WELSPECS")?;
    for (well, connections) in wells_with_connections() {
        let injects = matches!(well.control, Control::Inject(_));
        let phase = if injects { "WATER" } else { produced_phase };
        let [i, j, _] = connections.first().map_or([1; 3], |first| first.cell);
        writeln!(out, " {} G {i} {j} 1* {phase} /", well.name)?;
    }
    writeln!(out, "/\nCOMPDAT")?;
    for (Well { name, radius, .. }, connections) in wells_with_connections() {
        for WellConnection {
            cell: [i, j, k],
            index,
        } in connections
        {
            let (factor, width) = (TRANSMISSIBILITY_UNIT * index, 2.0 * radius);
            writeln!(out, " {name} {i} {j} {k} {k} OPEN 1* {factor} {width} /")?;
        }
    }
    writeln!(out, "/")?;
    for well in &case.wells {
        let name = &well.name;
        match well.control {
            Control::Inject(rate) => writeln!(
                out,
                "WCONINJE\n {name} WATER OPEN RATE {} 1* 1E5 /\n/",
                rate * DAY
            )?,
            Control::Produce(rate) => {
                writeln!(out, "WCONPROD\n {name} OPEN LRAT 3* {} /\n/", rate * DAY)?;
            }
            Control::Pressure(pressure) => {
                writeln!(out, "WCONPROD\n {name} OPEN BHP 5* {} /\n/", pressure / BAR)?;
            }
        }
    }
    Ok(())
}
