//! Writes a deck for OPM Flow, Eclipse and other programs that read its keywords, in METRIC units.
//!
//! The keywords describe grids of boxes only. So a cell of any shape becomes one of N boxes in a
//! row, each at the depth of its cell, and the transmissibilities between the boxes are set to zero
//! (`TRANX`). The simulation uses the pore volumes of the cells (`PORV`) and their connections
//! (`NNC`, in cP rm3/day/bar).

use std::io::Write;
use std::path::Path;

pub use super::deck::TRANSMISSIBILITY_UNIT;
use super::deck::{
    AquiferConnection, CONNATE_WATER_SATURATION, WellConnection, check, check_skin, write_aquifers,
    write_array, write_equilibrium, write_props, write_runspec, write_schedule,
};
use crate::error::cause;
use crate::export::corner_point::grdecl::is_corner_point_deck;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::{FileWriter, WriteResult, write_items};
use crate::mesh::graph::Graph;
use crate::model::reservoir::{BAR, Fluid, MILLIDARCY, Model, Permeability, SimulationCase};
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "opm",
    description: "OPM Flow and Eclipse deck: cells and connections, a complete case",
    extensions: &["DATA", "data"],
    has_companion: true,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::NetToGross,
        ExportContent::DeckRegions,
        ExportContent::CutOffs,
        ExportContent::Faults,
        ExportContent::ClosedFaults,
        ExportContent::Wells,
        ExportContent::Fluid,
        ExportContent::Study,
        ExportContent::InitialPressure,
        ExportContent::Gravity,
        ExportContent::Duration,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        max_region_number: Some(super::deck::MAX_REGION_NUMBER),
        wells: Some(super::deck::NAMES),
        table: TablePlace::Comments("-- "),
        ..FormatNames::NONE
    },
    write,
};

/// Minimum transmissibility of a connection, in cP rm3/day/bar. Simulators ignore or misread
/// smaller values.
pub const MIN_TRANSMISSIBILITY: f64 = 1e-6;
const ERROR_PLACE: &str = "an OPM deck";

/// Writes the deck.
///
/// # Errors
/// Returns [`Error::Export`] if porosity or permeability is missing, if a porosity is outside [0,
/// 1], if a depth is above the surface, or if a deck cannot hold the name of a well.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let porosity = model.need_porosity(ERROR_PLACE)?;
    let permeability = model.need_permeability(ERROR_PLACE)?;
    let case = &model.case;
    check(model, porosity)?;
    if is_corner_point_deck(path) {
        return Err(Error::Export(cause(
            path.display(),
            "is the deck of a corner-point grid, which is not overwritten",
            "give another file name, or remove that file",
        )));
    }

    let cells = model.len();
    let top = model.top_depth();
    let depth = |cell: usize| {
        if case.has_gravity {
            model.depth(cell)
        } else {
            top
        }
    };
    let pressure = |cell: usize| model.initial_pressure(depth(cell), top) / BAR;
    let well_connections = well_connections(case);
    check_skin(case, &well_connections)?;
    let aquifer_connections = aquifer_connections(case);
    let aquifer_cells = case.aquifers.iter().map(|aquifer| aquifer.cells.len());
    let aquifer_cells = aquifer_cells.max().unwrap_or_default();

    batch.write(path, |out| {
        let comment = "cell i of the mesh is box (i + 1, 1, 1)\n\
            -- faults that are nearly closed: flow --linear-solver=cpr needs a tenth of the iterations";
        let dims = [cells, 1, 1];
        write_runspec(out, model, names, comment, dims, &well_connections, aquifer_cells)?;
        write_grid(out, model, porosity, permeability, &depth)?;
        write_connections(out, &model.graph, &permeability.transmissibility)?;
        writeln!(out, "EDIT\n")?;
        write_array(out, "PORV", cells, |c| {
            model.pore_volume(c).unwrap_or_default()
        })?;
        writeln!(out, "TRANX\n {cells}*0 /\n")?;
        write_props(out, model)?;
        write_regions(out, model, names)?;
        writeln!(out, "SOLUTION\n")?;
        if !write_equilibrium(out, case)? {
            write_array(out, "PRESSURE", cells, pressure)?;
            if case.fluid == Fluid::OilWater {
                writeln!(out, "SWAT\n {cells}*{CONNATE_WATER_SATURATION} /")?;
            }
        }
        write_aquifers(out, case, &aquifer_connections)?;
        write_schedule(out, model, names, &well_connections)
    })
}

/// Returns the connections of each well to the boxes.
fn well_connections(case: &SimulationCase) -> Vec<Vec<WellConnection>> {
    let connection = |(&(cell, index), &strength): (&(u32, f64), &f64)| WellConnection {
        cell: [cell as usize + 1, 1, 1],
        index,
        strength,
    };
    (case.wells.iter())
        .map(|well| {
            well.cells
                .iter()
                .zip(&well.strengths)
                .map(connection)
                .collect()
        })
        .collect()
}

/// Returns the connections of each aquifer to the boxes.
fn aquifer_connections(case: &SimulationCase) -> Vec<Vec<AquiferConnection>> {
    // The boxes have no neighbours along j.
    let connection = |&(cell, area): &(u32, f64)| AquiferConnection {
        cells: [[cell as usize + 1; 2], [1; 2], [1; 2]],
        face: "J-",
        area: Some(area),
    };
    (case.aquifers.iter())
        .map(|aquifer| aquifer.cells.iter().map(connection).collect())
        .collect()
}

/// Writes GRID up to the connections: the boxes and their rock. `depth` is that of each cell.
fn write_grid(
    out: FileWriter,
    model: &Model,
    porosity: &[f64],
    permeability: &Permeability,
    depth: &(dyn Fn(usize) -> f64 + Sync),
) -> WriteResult {
    let cells = model.len();
    let side = (model.graph.volume.iter().sum::<f64>() / cells as f64).cbrt();
    writeln!(out, "GRID\nINIT\nGRIDFILE\n 0 1 /\n")?;
    for keyword in ["DX", "DY", "DZ"] {
        writeln!(out, "{keyword}\n {cells}*{side:.9} /")?;
    }
    write_array(out, "TOPS", cells, |c| depth(c) - 0.5 * side)?;
    write_array(out, "PORO", cells, |c| porosity[c])?;
    for (k, name) in ["PERMX", "PERMY", "PERMZ"].into_iter().enumerate() {
        write_array(out, name, cells, |c| {
            model.net_permeability(permeability, c)[k] / MILLIDARCY
        })?;
    }
    if let Some(net_to_gross) = &model.net_to_gross {
        write_array(out, "NTG", cells, |c| net_to_gross[c])?;
    }
    if !model.inactive.is_empty() {
        writeln!(out, "ACTNUM")?;
        write_items(out, cells, |text, c| {
            text.spaced_int(i64::from(model.is_active(c))).end_line();
        })?;
        writeln!(out, "/\n")?;
    }
    Ok(())
}

/// Writes REGIONS: the numbers of the regions of each cell.
fn write_regions(out: FileWriter, model: &Model, names: &ExportNames) -> WriteResult {
    writeln!(out, "REGIONS\n")?;
    for (keyword, numbers) in model.deck_regions.keywords() {
        if numbers.is_none() && keyword != "FIPNUM" {
            continue;
        }
        writeln!(out, "{keyword}")?;
        write_items(out, model.len(), |text, c| {
            let region = || i64::from(names.region_number(model.graph.region[c]));
            let number = numbers.map_or_else(region, |numbers| i64::from(numbers[c]));
            text.spaced_int(number).end_line();
        })?;
        writeln!(out, "/\n")?;
    }
    Ok(())
}

/// Writes the connections between cells, which are not neighbours in the grid, with their
/// transmissibility `t`.
fn write_connections(out: FileWriter, graph: &Graph<3>, t: &[f64]) -> WriteResult {
    let connections = &graph.connections;
    writeln!(out, "NNC")?;
    write_items(out, connections.len(), |text, i| {
        let t = TRANSMISSIBILITY_UNIT * t[i];
        if t >= MIN_TRANSMISSIBILITY {
            let [a, b] = connections[i].cells.map(|cell| cell + 1);
            text.int(a).word(" 1 1 ").int(b).word(" 1 1");
            text.spaced_real(t).word(" /").end_line();
        }
    })?;
    writeln!(out, "/\n")
}
