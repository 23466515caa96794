//! What decks for OPM Flow and Eclipse have in common, whatever their grid: head, fluids, wells, time.
//! METRIC units.

use std::io::Write;

use crate::Result;
use crate::error::{Error, cause};
use crate::export::containers::text::write_numbers;
use crate::model::reservoir::{
    BAR, Control, DAY, Fluid, Model, OIL_DENSITY, SimulationCase, WATER_DENSITY, Well,
};

/// From m^3 to cP rm3/day/bar, so that T dp / viscosity is a rate in METRIC units.
pub const TRANSMISSIBILITY_UNIT: f64 = DAY * BAR / 1e-3;
/// Saturation of water that does not flow, in rock full of oil.
pub(crate) const CONNATE_WATER_SATURATION: f64 = 0.2;
/// Steps of the table of relative permeabilities up to the oil that does not flow.
const TABLE_STEPS: usize = 12;
/// Number of reports.
const REPORT_COUNT: usize = 10;

pub(crate) type FileWriter<'a> = &'a mut std::io::BufWriter<std::fs::File>;
pub(crate) type WriteResult = std::io::Result<()>;

/// A well's opening to a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellConnection {
    /// i, j and k of the cell, from 1 on.
    pub cell: [usize; 3],
    /// The well index in m^3.
    pub index: f64,
}

/// Checks what a deck needs of a model.
///
/// # Errors
/// [`Error::Export`] for a porosity outside [0, 1], or a well's name that no deck can hold.
pub(crate) fn check(model: &Model, porosity: &[f64]) -> Result<()> {
    let wrong = |cell: &usize| {
        let p = porosity[*cell];
        model.is_active(*cell) && !(p > 0.0 && p <= 1.0)
    };
    if let Some(cell) = (0..porosity.len()).find(wrong) {
        return Err(Error::Export(cause(
            "porosity",
            format!("is {} in cell {cell}", porosity[cell]),
            "give fractions of volume from 0, of inactive cells, to 1",
        )));
    }
    for well in &model.case.wells {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let first = well.name.starts_with(|c: char| c.is_ascii_alphabetic());
        if !well.name.chars().all(plain) || !first || well.name.len() > 8 {
            return Err(Error::Export(cause(
                format!("well '{}'", well.name),
                "has a name that a deck cannot hold",
                "give up to eight letters, digits or _, the first a letter",
            )));
        }
    }
    Ok(())
}

/// A keyword with a number for each cell.
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

/// RUNSPEC of a grid of these dimensions; `says` is a line for people, `open` as for [`write_schedule`].
pub(crate) fn write_runspec(
    out: FileWriter,
    case: &SimulationCase,
    says: &str,
    dims: [usize; 3],
    open: &[Vec<WellConnection>],
) -> WriteResult {
    let most = open.iter().map(Vec::len).max().unwrap_or(1);
    let wells = case.wells.len().max(1);
    let phases = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL\nWATER",
    };
    let [n, m, layers] = dims;
    writeln!(
        out,
        "-- atomesh {}: {says}\n\
         RUNSPEC\nTITLE\n {}\n\nDIMENS\n {n} {m} {layers} /\n{phases}\nMETRIC\n\
         START\n 1 JAN 2000 /\nWELLDIMS\n {wells} {most} 1 {wells} /\nTABDIMS\n/\nUNIFOUT\n",
        env!("CARGO_PKG_VERSION"),
        case.title
    )
}

/// PROPS.
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
        // Corey's exponents of 2, a fifth of water that stays and a fifth of oil.
        for step in 0..=TABLE_STEPS {
            let water = CONNATE_WATER_SATURATION + 0.6 * step as f64 / TABLE_STEPS as f64;
            let [of_water, of_oil] = [
                (water - CONNATE_WATER_SATURATION) / 0.8,
                (0.8 - water) / 0.6,
            ];
            writeln!(
                out,
                " {water:.3} {:.6} {:.6} 0",
                of_water.powi(2),
                of_oil.powi(2)
            )?;
        }
        writeln!(out, " 1 1 0 0 /")?;
    }
    writeln!(out)
}

/// SUMMARY and SCHEDULE; `open` has the cells that each well is open to. Without wells nothing moves, and there
/// are no time steps: OPM Flow, whose steps depend on what changes, ends with a failed assertion.
pub(crate) fn write_schedule(
    out: FileWriter,
    case: &SimulationCase,
    open: &[Vec<WellConnection>],
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
    write_wells(out, case, open)?;
    let step = case.duration / DAY / REPORT_COUNT as f64;
    writeln!(out, "TSTEP\n {REPORT_COUNT}*{step} /\n\nEND")
}

fn write_wells(
    out: FileWriter,
    case: &SimulationCase,
    open: &[Vec<WellConnection>],
) -> WriteResult {
    let main = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL",
    };
    let all = || case.wells.iter().zip(open);
    writeln!(out, "WELSPECS")?;
    for (well, open) in all() {
        let injects = matches!(well.control, Control::Inject(_));
        let phase = if injects { "WATER" } else { main };
        let [i, j, _] = open.first().map_or([1; 3], |first| first.cell);
        writeln!(out, " {} G {i} {j} 1* {phase} /", well.name)?;
    }
    writeln!(out, "/\nCOMPDAT")?;
    for (Well { name, radius, .. }, open) in all() {
        for WellConnection {
            cell: [i, j, k],
            index,
        } in open
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
