//! Writes the common parts of decks for OPM Flow and Eclipse, which do not depend on the grid:
//! head, aquifers, and what wells have in common. Units are METRIC.
//!
//! - `fluids`: tables of fluids, and their state in equilibrium
//! - `schedule`: wells, their controls, time steps

mod fluids;
mod schedule;

pub(crate) use fluids::{CONNATE_WATER_SATURATION, write_equilibrium, write_props};
pub(crate) use schedule::write_schedule;

use std::io::Write;

use crate::Result;
use crate::error::{Error, cause};
use crate::export::names::ExportNames;
use crate::files::text::write_numbers;
use crate::files::text::{FileWriter, WriteResult};
use crate::model::reservoir::{
    Aquifer, AquiferModel, BAR, DAY, DeckRegions, Fluid, Model, SimulationCase,
};
use crate::names::{LetterCase, NameRules};

/// Conversion factor from m^3 to cP rm3/day/bar, so that T dp / viscosity is a rate in METRIC
/// units.
pub const TRANSMISSIBILITY_UNIT: f64 = DAY * BAR / 1e-3;

/// Connection of a well to a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellConnection {
    /// i, j and k of the cell, from 1.
    pub cell: [usize; 3],
    /// Well index in m^3.
    pub index: f64,
    /// Permeability times length times the angle in which fluid flows to the well, in m^3.
    pub strength: f64,
}

impl WellConnection {
    /// Returns the well index with a skin factor: a zone around the well that resists as much as
    /// `skin` more on the logarithm of the distance.
    fn index_with_skin(&self, skin: f64) -> f64 {
        if skin == 0.0 {
            return self.index;
        }
        1.0 / (1.0 / self.index + skin / self.strength)
    }
}

/// Largest region number in a deck. Simulators allocate tables for all numbers up to the largest.
pub(crate) const MAX_REGION_NUMBER: i32 = 9999;

/// Rules of decks for the names of wells, groups and faults.
pub(crate) const NAMES: NameRules = NameRules {
    max_bytes: 8,
    distinct_bytes: 8,
    first_letter: 'W',
    case: LetterCase::Insensitive,
    reserved: &["FIELD"],
    ..NameRules::HYPHENATED
};

/// Checks that a deck can hold the porosity of a model.
///
/// # Errors
/// Returns [`Error::Export`] if a porosity is outside [0, 1].
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
    Ok(())
}

/// Checks that the skin factors of a schedule leave every connection a positive index.
///
/// # Errors
/// Returns [`Error::Export`] with the name of the well and its smallest possible skin.
pub(crate) fn check_skin(case: &SimulationCase, connections: &[Vec<WellConnection>]) -> Result<()> {
    let steps = case.schedule.iter().flat_map(|schedule| &schedule.steps);
    for change in steps.flat_map(|step| &step.wells) {
        let Some(skin) = change.skin else { continue };
        let smallest = |c: &WellConnection| -c.strength / c.index;
        let all = connections[change.well].iter().map(smallest);
        let limit = all.fold(f64::NEG_INFINITY, f64::max);
        if skin <= limit {
            return Err(Error::Export(cause(
                format!("well {}", case.wells[change.well].name),
                format!("has the skin factor {skin}, with which its index is not positive"),
                format!("give a skin above {limit:.2}, or larger cells around the well"),
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

/// Writes RUNSPEC for a grid with these dimensions. `comment` is a line for readers, `connections`
/// are as for [`write_schedule`], and `aquifer_connections` is the largest number of cells of an aquifer.
pub(crate) fn write_runspec(
    out: FileWriter,
    model: &Model,
    names: &ExportNames,
    comment: &str,
    dims: [usize; 3],
    connections: &[Vec<WellConnection>],
    aquifer_connections: usize,
) -> WriteResult {
    let case = &model.case;
    let max_connections = connections.iter().map(Vec::len).max().unwrap_or(1);
    let wells = case.wells.len().max(1);
    let groups = case.schedule.as_ref().map_or(1, |s| s.groups().len());
    // A group holds wells or, as the group of all wells does, other groups.
    let group_size = wells.max(groups);
    let phases = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater => "OIL\nWATER",
        Fluid::OilWaterGas => "OIL\nWATER\nGAS",
    };
    let [n, m, layers] = dims;
    writeln!(
        out,
        "-- atomesh {}: {comment}\n{}\
         RUNSPEC\nTITLE\n {}\n\nDIMENS\n {n} {m} {layers} /\n{phases}\nMETRIC\n\
         START\n {} /\nWELLDIMS\n {wells} {max_connections} {groups} {group_size} /",
        env!("CARGO_PKG_VERSION"),
        names.comments(),
        case.title,
        case.start.deck_text()
    )?;
    let [saturation, pressure_volume, equilibration, mut reports] = model.deck_regions.counts();
    if !model.has_own_reports() {
        reports = names.largest_region_number();
    }
    if model.deck_regions == DeckRegions::default() && reports == 1 {
        writeln!(out, "TABDIMS\n/")?;
    } else {
        writeln!(
            out,
            "TABDIMS\n {saturation} {pressure_volume} 50 50 {reports} /"
        )?;
        writeln!(out, "EQLDIMS\n {equilibration} /")?;
    }
    if !case.aquifers.is_empty() {
        let count = case.aquifers.len();
        writeln!(out, "AQUDIMS\n 1* 1* 1 36 {count} {aquifer_connections} /")?;
    }
    writeln!(out, "UNIFOUT\n")
}

/// Connection of an aquifer to cells: the ranges of their i, j and k, their face, and the area of this
/// face, if it is not that of the grid.
pub(crate) struct AquiferConnection {
    pub cells: [[usize; 2]; 3],
    pub face: &'static str,
    pub area: Option<f64>,
}

/// Writes the aquifers. `connections` are those of each aquifer.
pub(crate) fn write_aquifers(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[Vec<AquiferConnection>],
) -> WriteResult {
    if case.aquifers.is_empty() {
        return Ok(());
    }
    let numbered = || (1..).zip(&case.aquifers);
    for (number, Aquifer { option, datum, .. }) in numbered() {
        let pressure = option.pressure.map_or("1*".into(), |bar| bar.to_string());
        let compressibility = option.compressibility;
        match option.model {
            AquiferModel::CarterTracy {
                permeability,
                porosity,
                thickness,
                radius,
                angle,
            } => writeln!(
                out,
                "AQUCT\n {number} {datum} {pressure} {permeability} {porosity} {compressibility} \
                 {radius} {thickness} {angle} 1 1 /\n/"
            )?,
            AquiferModel::Fetkovich {
                volume,
                productivity,
            } => writeln!(
                out,
                "AQUFETP\n {number} {datum} {pressure} {volume} {compressibility} \
                 {productivity} 1 /\n/"
            )?,
        }
    }
    writeln!(out, "AQUANCON")?;
    for ((number, _), connections) in numbered().zip(connections) {
        for AquiferConnection { cells, face, area } in connections {
            let [[i, i2], [j, j2], [k, k2]] = cells;
            let area = area.map_or("1*".into(), |area| format!("{area:.9e}"));
            writeln!(
                out,
                " {number} {i} {i2} {j} {j2} {k} {k2} '{face}' {area} /"
            )?;
        }
    }
    writeln!(out, "/\n")
}
