//! A deck for OPM Flow, Eclipse and those who read its keywords, in METRIC units.
//!
//! The keywords know columns of boxes only; cells of any shape are given as N boxes in a row, each at
//! its cell's depth, whose own transmissibilities are set to zero (`TRANX`); what counts are the
//! cells' pore volumes (`PORV`) and their connections (`NNC`, in cP rm3/day/bar).

use std::io::Write;
use std::path::Path;

use crate::error::cause;
use crate::export::containers::text::{write_items, write_numbers};
use crate::files::Batch;
use crate::model::reservoir::{BAR, Case, Control, DAY, Fluid, GRAVITY, MILLIDARCY, Model, Well};
use crate::{Error, Result};

/// From m^3 to cP rm3/day/bar, so that T dp / viscosity is a rate in METRIC units.
pub const TRANSMISSIBILITY: f64 = DAY * BAR / 1e-3;
/// Least transmissibility, in those units, of a connection: simulators ignore, or misread, what is
/// less.
pub const LEAST: f64 = 1e-6;
/// Densities in kg/m^3 of oil and water.
const DENSITY: [f64; 2] = [850.0, 1000.0];
/// Number of reports.
const REPORTS: usize = 10;
const NEEDS: &str = "an OPM deck";

/// Writes the deck.
///
/// # Errors
/// [`Error::Export`] without porosity or permeability, for a porosity outside (0, 1], a depth above
/// the surface, or a well's name that no deck can hold.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let porosity = model.need_porosity(NEEDS)?;
    let permeability = model.need_permeability(NEEDS)?;
    let case = &model.case;
    check(model, porosity)?;

    let (cells, graph) = (model.len(), &model.graph);
    let side = (graph.volume.iter().sum::<f64>() / cells as f64).cbrt();
    let depths = (0..cells).map(|cell| model.depth(cell));
    let top = depths.fold(f64::INFINITY, f64::min);
    let depth = |cell: usize| if case.gravity { model.depth(cell) } else { top };
    let fluid = match case.fluid {
        Fluid::Water => DENSITY[1],
        Fluid::OilWater => DENSITY[0],
    };
    let pressure = |cell: usize| (case.top_pressure + fluid * GRAVITY * (depth(cell) - top)) / BAR;

    batch.write(path, |out| {
        head(out, case, cells)?;
        writeln!(out, "GRID\nINIT\nGRIDFILE\n 0 1 /\n")?;
        for keyword in ["DX", "DY", "DZ"] {
            writeln!(out, "{keyword}\n {cells}*{side:.9} /")?;
        }
        let numbers = |out: &mut _, name: &str, value: &(dyn Fn(usize) -> f64 + Sync)| {
            array(out, name, cells, value)
        };
        numbers(out, "TOPS", &|c| depth(c) - 0.5 * side)?;
        numbers(out, "PORO", &|c| porosity[c])?;
        for (k, name) in ["PERMX", "PERMY", "PERMZ"].into_iter().enumerate() {
            numbers(out, name, &|c| {
                permeability.rock.mobility(c).0[k] / MILLIDARCY
            })?;
        }
        writeln!(out, "NNC")?;
        let (connections, t) = (&graph.connections, &permeability.transmissibility);
        write_items(out, connections.len(), |text, i| {
            let t = TRANSMISSIBILITY * t[i];
            if t >= LEAST {
                let [a, b] = connections[i].cells.map(|cell| cell + 1);
                text.int(a).word(" 1 1 ").int(b).word(" 1 1");
                text.and_real(t).word(" /").end();
            }
        })?;
        writeln!(out, "/\n\nEDIT\n")?;
        numbers(out, "PORV", &|c| porosity[c] * graph.volume[c])?;
        writeln!(out, "TRANX\n {cells}*0 /\n")?;
        properties(out, case)?;
        writeln!(out, "REGIONS\n")?;
        let least = graph.region.iter().min().copied().unwrap_or(0);
        writeln!(out, "FIPNUM")?;
        write_items(out, cells, |text, c| {
            text.and_int(i64::from(graph.region[c]) - i64::from(least) + 1)
                .end();
        })?;
        writeln!(out, "/\n\nSOLUTION\n")?;
        numbers(out, "PRESSURE", &pressure)?;
        if case.fluid == Fluid::OilWater {
            writeln!(out, "SWAT\n {cells}*0.2 /")?;
        }
        schedule(out, case)
    })
}

fn check(model: &Model, porosity: &[f64]) -> Result<()> {
    let wrong = |p: &f64| !(*p > 0.0 && *p <= 1.0);
    if let Some(cell) = porosity.iter().position(wrong) {
        return Err(Error::Export(cause(
            "porosity",
            format!("is {} in cell {cell}", porosity[cell]),
            "give fractions of volume above 0 and up to 1",
        )));
    }
    for well in &model.case.wells {
        let plain = well
            .name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '_');
        let first = well
            .name
            .chars()
            .next()
            .is_some_and(|c| c.is_ascii_alphabetic());
        if !plain || !first || well.name.len() > 8 {
            return Err(Error::Export(cause(
                format!("well '{}'", well.name),
                "has a name that a deck cannot hold",
                "give up to eight letters, digits or _, the first a letter",
            )));
        }
    }
    Ok(())
}

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

/// A keyword with a number for each cell.
fn array(out: Out, name: &str, cells: usize, value: impl Fn(usize) -> f64 + Sync) -> Done {
    writeln!(out, "{name}")?;
    write_numbers(out, cells, value)?;
    writeln!(out, "/\n")
}

fn head(out: Out, case: &Case, cells: usize) -> Done {
    let open = |well: &Well| well.cells.len();
    let most = case.wells.iter().map(open).max().unwrap_or(1);
    let wells = case.wells.len().max(1);
    let phases = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL\nWATER",
    };
    writeln!(
        out,
        "-- atomesh {}: cell i of the mesh is box (i + 1, 1, 1)\n\
         RUNSPEC\nTITLE\n {}\n\nDIMENS\n {cells} 1 1 /\n{phases}\nMETRIC\n\
         START\n 1 JAN 2000 /\nWELLDIMS\n {wells} {most} 1 {wells} /\nTABDIMS\n/\nUNIFOUT\n",
        env!("CARGO_PKG_VERSION"),
        case.title
    )
}

fn properties(out: Out, case: &Case) -> Done {
    let reference = case.top_pressure / BAR;
    let [oil, water] = DENSITY;
    writeln!(
        out,
        "PROPS\n\nPVTW\n {reference} 1.0 4.5E-5 1.0 0 /\nROCK\n {reference} 4.5E-5 /\n\
         DENSITY\n {oil} {water} 1 /"
    )?;
    if case.fluid == Fluid::OilWater {
        writeln!(
            out,
            "PVCDO\n {reference} 1.1 1.0E-4 2.0 0 /\n\
             SWOF\n 0.2 0.0 1.0 0\n 0.4 0.0625 0.4444 0\n 0.6 0.25 0.1111 0\n 0.8 0.5625 0.0 0\n 1.0 1.0 0.0 0 /"
        )?;
    }
    writeln!(out)
}

fn schedule(out: Out, case: &Case) -> Done {
    writeln!(out, "SUMMARY\nFPR\nWBHP\n/\nWWIR\n/\nWWPR\n/")?;
    if case.fluid == Fluid::OilWater {
        writeln!(out, "WOPR\n/\nFOPT")?;
    }
    writeln!(out, "\nSCHEDULE\n\nRPTRST\n BASIC=2 /")?;
    if !case.wells.is_empty() {
        let main = match case.fluid {
            Fluid::Water => "WATER",
            Fluid::OilWater => "OIL",
        };
        writeln!(out, "WELSPECS")?;
        for well in &case.wells {
            let injects = matches!(well.control, Control::Inject(_));
            let phase = if injects { "WATER" } else { main };
            let first = well.cells.first().map_or(0, |c| c.0) + 1;
            writeln!(out, " {} G {first} 1 1* {phase} /", well.name)?;
        }
        writeln!(out, "/\nCOMPDAT")?;
        for well in &case.wells {
            for (cell, index) in &well.cells {
                let factor = TRANSMISSIBILITY * index;
                let (name, width) = (&well.name, 2.0 * well.radius);
                writeln!(out, " {name} {} 1 1 1 OPEN 1* {factor} {width} /", cell + 1)?;
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
    }
    let step = case.duration / DAY / REPORTS as f64;
    writeln!(out, "TSTEP\n {REPORTS}*{step} /\n\nEND")
}
