//! Writes the common parts of decks for OPM Flow and Eclipse, which do not depend on the grid:
//! head, fluids, wells, time. Units are METRIC.

use std::io::Write;

use crate::Result;
use crate::error::{Error, cause};
use crate::export::containers::text::write_numbers;
use crate::export::containers::text::{FileWriter, WriteResult};
use crate::model::reservoir::schedule::{
    ControlKind, Controls, DEFAULT_GROUP, WellKind, is_deck_name,
};
use crate::model::reservoir::{
    Aquifer, AquiferModel, BAR, CapillaryOption, Control, DAY, Date, DeckRegions, Fluid,
    GAS_DENSITY, Model, OIL_DENSITY, SURFACE_PRESSURE, Schedule, SimulationCase, WATER_DENSITY,
    Well,
};

/// Conversion factor from m^3 to cP rm3/day/bar, so that T dp / viscosity is a rate in METRIC
/// units.
pub const TRANSMISSIBILITY_UNIT: f64 = DAY * BAR / 1e-3;
/// Saturation of immobile water in rock full of oil.
pub(crate) const CONNATE_WATER_SATURATION: f64 = 0.2;
/// Number of steps of the table of relative permeabilities, up to the residual oil saturation.
const TABLE_STEPS: usize = 12;
/// Smallest saturation of mobile water over the largest one for which capillary pressure is
/// computed. It would be infinite at 0.
const MIN_CAPILLARY_SATURATION: f64 = 0.005;
/// Ratio of the saturations of mobile water in two rows of a table with capillary pressure: linear
/// interpolation between them is off by half a percent of the saturation.
const CAPILLARY_STEP_RATIO: f64 = 1.2;
/// Pressures in bar in the table of the volume of gas.
const GAS_PRESSURES: [f64; 8] = [20.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0];
/// Deviation of the volume of gas from that of an ideal gas.
const GAS_DEVIATION: f64 = 0.9;
/// Temperature in the reservoir, 353 K, over that at the surface, 288 K.
const GAS_EXPANSION: f64 = 353.0 / 288.0;
/// Number of reports.
const REPORT_COUNT: usize = 10;

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
        if !is_deck_name(&well.name) {
            return Err(Error::Export(cause(
                format!("well '{}'", well.name),
                "has a name that a deck cannot hold",
                "give up to eight letters, digits or _, the first a letter",
            )));
        }
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
        "-- atomesh {}: {comment}\n\
         RUNSPEC\nTITLE\n {}\n\nDIMENS\n {n} {m} {layers} /\n{phases}\nMETRIC\n\
         START\n {} /\nWELLDIMS\n {wells} {max_connections} {groups} {group_size} /",
        env!("CARGO_PKG_VERSION"),
        case.title,
        case.start.deck_text()
    )?;
    let [saturation, pressure_volume, equilibration, reports] = model.deck_regions.counts();
    if model.deck_regions == DeckRegions::default() {
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

/// Writes PROPS: for each number of a table the same typical fluids, and for each table of relative
/// permeability its capillary pressure.
pub(crate) fn write_props(out: FileWriter, model: &Model) -> WriteResult {
    let case = &model.case;
    let [saturation_tables, pressure_tables, ..] = model.deck_regions.counts();
    let reference = case.top_pressure / BAR;
    let repeated = |line: String| vec![line; pressure_tables].join("\n");
    let gas_density = match case.fluid {
        Fluid::OilWaterGas => GAS_DENSITY,
        _ => 1.0,
    };
    writeln!(
        out,
        "PROPS\n\nPVTW\n{}\nROCK\n{}\nDENSITY\n{}",
        repeated(format!(" {reference} 1.0 4.5E-5 1.0 0 /")),
        repeated(format!(" {reference} 4.5E-5 /")),
        repeated(format!(" {OIL_DENSITY} {WATER_DENSITY} {gas_density} /"))
    )?;
    if case.fluid == Fluid::Water {
        return writeln!(out);
    }
    let oil = repeated(format!(" {reference} 1.1 1.0E-4 2.0 0 /"));
    writeln!(out, "PVCDO\n{oil}\nSWOF")?;
    for table in 1..=saturation_tables {
        let capillary = CapillaryOption::for_table(&case.capillary_pressures, table as u32);
        write_water_table(out, capillary)?;
    }
    if case.fluid == Fluid::OilWaterGas {
        writeln!(out, "SGOF")?;
        for _ in 1..=saturation_tables {
            write_gas_table(out)?;
        }
        writeln!(out, "PVDG")?;
        for _ in 1..=pressure_tables {
            for pressure in GAS_PRESSURES {
                let volume = GAS_DEVIATION * SURFACE_PRESSURE / BAR / pressure * GAS_EXPANSION;
                writeln!(
                    out,
                    " {pressure} {volume:.6e} {:.4}",
                    0.012 + 2e-5 * pressure
                )?;
            }
            writeln!(out, " /")?;
        }
    }
    writeln!(out)
}

/// Writes Corey functions with exponents of 2, 20 % immobile water and 20 % residual oil.
fn write_water_table(out: FileWriter, capillary: Option<CapillaryOption>) -> WriteResult {
    let connate = CONNATE_WATER_SATURATION;
    let pressure = |water: f64| {
        let mobile = ((water - connate) / (1.0 - connate)).max(MIN_CAPILLARY_SATURATION);
        capillary.map_or(0.0, |curve| curve.pressure(mobile))
    };
    let rows: Vec<f64> = if capillary.is_some() {
        // Steps of equal ratio follow the curve, which is steep near immobile water. Residual oil
        // has a row of its own.
        let next = |s: &f64| Some(s * CAPILLARY_STEP_RATIO);
        let mobile = std::iter::successors(Some(MIN_CAPILLARY_SATURATION), next);
        let mobile = mobile.take_while(|s| *s < 1.0).chain([0.0, 0.75]);
        let mut rows: Vec<f64> = mobile.map(|s| connate + (1.0 - connate) * s).collect();
        rows.sort_by(f64::total_cmp);
        rows
    } else {
        let step = |step| connate + 0.6 * step as f64 / TABLE_STEPS as f64;
        (0..=TABLE_STEPS).map(step).collect()
    };
    for water in rows {
        let [water_mobility, oil_mobility] =
            [(water - connate) / 0.8, ((0.8 - water) / 0.6).max(0.0)];
        let (water_mobility, oil_mobility) = (water_mobility.powi(2), oil_mobility.powi(2));
        if capillary.is_some() {
            writeln!(
                out,
                " {water:.6} {water_mobility:.6} {oil_mobility:.6} {:.6}",
                pressure(water)
            )?;
        } else {
            writeln!(out, " {water:.3} {water_mobility:.6} {oil_mobility:.6} 0")?;
        }
    }
    if capillary.is_some() {
        return writeln!(out, " 1 1 0 {:.6} /", pressure(1.0));
    }
    writeln!(out, " 1 1 0 0 /")
}

/// Writes Corey functions with exponents of 2, 5 % immobile gas and 20 % residual oil, where there
/// is immobile water.
fn write_gas_table(out: FileWriter) -> WriteResult {
    let highest = 1.0 - CONNATE_WATER_SATURATION;
    writeln!(out, " 0 0 1 0")?;
    for step in 0..=TABLE_STEPS {
        let gas = 0.05 + (highest - 0.25) * step as f64 / TABLE_STEPS as f64;
        let gas_mobility = 0.8 * ((gas - 0.05) / (highest - 0.05)).powi(2);
        let oil_mobility = ((highest - 0.2 - gas) / (highest - 0.2)).max(0.0).powi(2);
        writeln!(out, " {gas:.4} {gas_mobility:.6} {oil_mobility:.6} 0")?;
    }
    writeln!(out, " {highest} 0.8 0 0 /")
}

/// Writes the state of fluids in equilibrium, if there is one. Returns `true` if there is.
pub(crate) fn write_equilibrium(out: FileWriter, case: &SimulationCase) -> std::io::Result<bool> {
    if case.equilibria.is_empty() {
        return Ok(false);
    }
    // The initial state is in the restart file, too.
    writeln!(out, "RPTRST\n BASIC=2 /\n\nEQUIL")?;
    for e in &case.equilibria {
        writeln!(
            out,
            " {} {} {} {} {} {} 1 0 0 /",
            e.datum,
            e.pressure / BAR,
            e.oil_water,
            e.oil_water_capillary / BAR,
            e.gas_oil,
            e.gas_oil_capillary / BAR
        )?;
    }
    writeln!(out)?;
    Ok(true)
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

/// Writes SUMMARY and SCHEDULE. `connections` are the connections of each well. Without wells
/// nothing flows, and no time steps are written: OPM Flow, whose time steps depend on changes,
/// would stop with a failed assertion.
pub(crate) fn write_schedule(
    out: FileWriter,
    model: &Model,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    let case = &model.case;
    writeln!(out, "SUMMARY\nFPR\nWBHP\n/\nWWIR\n/\nWWPR\n/")?;
    if case.fluid != Fluid::Water {
        writeln!(out, "WOPR\n/\nFOPT\nFOIP\nFWIT\nFWPT")?;
    }
    if case.fluid == Fluid::OilWaterGas {
        writeln!(out, "WGPR\n/\nFWIP\nFGIP\nFGPT\nFGIT")?;
    }
    if case.schedule.is_some() {
        writeln!(out, "WOPRH\n/\nWWPRH\n/\nGOPR\n/\nGWPR\n/")?;
    }
    if !case.aquifers.is_empty() {
        writeln!(out, "AAQR\n/\nAAQT\n/")?;
    }
    writeln!(out, "\nSCHEDULE\n\nRPTRST\n BASIC=2 /")?;
    if case.wells.is_empty() && case.aquifers.is_empty() {
        return writeln!(
            out,
            "-- No wells: nothing moves, and there are no time steps\n\nEND"
        );
    }
    if !case.wells.is_empty() {
        write_wells(out, case, connections)?;
    }
    match &case.schedule {
        Some(schedule) => write_steps(out, case, schedule, connections)?,
        None => {
            let step = case.duration / DAY / REPORT_COUNT as f64;
            writeln!(out, "TSTEP\n {REPORT_COUNT}*{step} /\n")?;
        }
    }
    writeln!(out, "END")
}

/// Returns the phase whose flow into a well is looked at first.
fn preferred_phase(case: &SimulationCase, well: usize) -> &'static str {
    let produced_phase = match case.fluid {
        Fluid::Water => "WATER",
        Fluid::OilWater | Fluid::OilWaterGas => "OIL",
    };
    let scheduled = case.schedule.as_ref().and_then(|s| s.first_change(well));
    let kind = scheduled.map(|change| change.controls.kind);
    match (case.wells[well].control, kind) {
        (_, Some(WellKind::GasInjector)) => "GAS",
        (_, Some(WellKind::WaterInjector)) | (Control::Inject(_), None) => "WATER",
        _ => produced_phase,
    }
}

fn write_wells(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    writeln!(out, "WELSPECS")?;
    for well in 0..case.wells.len() {
        let change = case.schedule.as_ref().and_then(|s| s.first_change(well));
        let group = change.and_then(|change| change.group.as_deref());
        write_specification(out, case, connections, well, group.unwrap_or(DEFAULT_GROUP))?;
    }
    writeln!(out, "/\nCOMPDAT")?;
    for (well, connections) in case.wells.iter().zip(connections) {
        write_completions(out, well, connections, 0.0)?;
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
            Control::Scheduled => {}
        }
    }
    Ok(())
}

/// Writes a record of WELSPECS.
fn write_specification(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[Vec<WellConnection>],
    well: usize,
    group: &str,
) -> WriteResult {
    let phase = preferred_phase(case, well);
    let [i, j, _] = connections[well].first().map_or([1; 3], |first| first.cell);
    let name = &case.wells[well].name;
    writeln!(out, " {name} {group} {i} {j} 1* {phase} /")
}

/// Writes the records of COMPDAT of a well with this skin factor.
fn write_completions(
    out: FileWriter,
    Well { name, radius, .. }: &Well,
    connections: &[WellConnection],
    skin: f64,
) -> WriteResult {
    for connection in connections {
        let [i, j, k] = connection.cell;
        let index = connection.index_with_skin(skin);
        let (factor, width) = (TRANSMISSIBILITY_UNIT * index, 2.0 * radius);
        write!(out, " {name} {i} {j} {k} {k} OPEN 1* {factor} {width}")?;
        if skin != 0.0 {
            write!(out, " 1* {skin}")?;
        }
        writeln!(out, " /")?;
    }
    Ok(())
}

/// Writes the changes of wells and groups, and the time steps between them.
fn write_steps(
    out: FileWriter,
    case: &SimulationCase,
    schedule: &Schedule,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    let end = case.duration / DAY;
    let longest = end / REPORT_COUNT as f64;
    let mut now = 0.0;
    for (index, step) in schedule.steps.iter().enumerate() {
        let day = (step.date.0 - schedule.start.0) as f64;
        write_time(out, &mut now, day, longest, Some(step.date))?;
        for change in &step.wells {
            let is_specified = schedule.first_change(change.well) == Some(change)
                && !schedule.steps[..index]
                    .iter()
                    .any(|s| s.wells.iter().any(|c| c.well == change.well));
            if let Some(group) = change.group.as_deref().filter(|_| !is_specified) {
                writeln!(out, "WELSPECS")?;
                write_specification(out, case, connections, change.well, group)?;
                writeln!(out, "/")?;
            }
            let well = &case.wells[change.well];
            if let Some(skin) = change.skin {
                writeln!(out, "COMPDAT")?;
                write_completions(out, well, &connections[change.well], skin)?;
                writeln!(out, "/")?;
            }
            write_controls(out, &well.name, &change.controls)?;
        }
        for (group, controls) in &step.groups {
            write_group_controls(out, group, controls)?;
        }
    }
    write_time(out, &mut now, end, longest, None)
}

/// Writes the time steps to a day, none of them longer than `longest`. The last one ends at `date`,
/// if it is given.
fn write_time(
    out: FileWriter,
    now: &mut f64,
    day: f64,
    longest: f64,
    date: Option<Date>,
) -> WriteResult {
    let length = day - *now;
    *now = day;
    if length <= 0.0 {
        return Ok(());
    }
    let count = (length / longest - 1e-9).ceil().max(1.0);
    let step = length / count;
    match date {
        Some(date) => {
            if count > 1.0 {
                writeln!(out, "TSTEP\n {}*{step} /", count - 1.0)?;
            }
            writeln!(out, "DATES\n {} /\n/\n", date.deck_text())
        }
        None => writeln!(out, "TSTEP\n {count}*{step} /\n"),
    }
}

/// Names of the rates that control producers.
const RATE_CONTROLS: [&str; 5] = ["ORAT", "WRAT", "GRAT", "LRAT", "RESV"];

fn control_name(control: Option<ControlKind>) -> &'static str {
    match control {
        Some(ControlKind::Rate(index)) => RATE_CONTROLS[index],
        Some(ControlKind::Pressure) => "BHP",
        None => "1*",
    }
}

/// Returns values as items of a record, with `1*` for those that are not given.
fn items(values: &[Option<f64>]) -> String {
    let item = |value: &Option<f64>| value.map_or("1*".into(), |v| v.to_string());
    let texts: Vec<String> = values.iter().map(item).collect();
    texts.join(" ")
}

/// Writes the new controls of a well.
fn write_controls(out: FileWriter, name: &str, controls: &Controls) -> WriteResult {
    let Controls {
        kind,
        control,
        rates,
        pressure,
        is_open,
        is_history,
    } = *controls;
    let status = if is_open { "OPEN" } else { "SHUT" };
    let [oil, water, gas, _, reservoir] = rates;
    let (phase, rate) = match kind {
        WellKind::Producer => {
            let mode = control_name(control);
            if is_history {
                let observed = items(&[oil, water, gas].map(|rate| Some(rate.unwrap_or(0.0))));
                let pressure = items(&[pressure]);
                return writeln!(
                    out,
                    "WCONHIST\n {name} {status} {mode} {observed} 3* {pressure} /\n/"
                );
            }
            let limits = items(&rates);
            let pressure = items(&[pressure]);
            return writeln!(
                out,
                "WCONPROD\n {name} {status} {mode} {limits} {pressure} /\n/"
            );
        }
        WellKind::WaterInjector => ("WATER", water),
        WellKind::GasInjector => ("GAS", gas),
    };
    if is_history {
        let values = items(&[rate, pressure]);
        return writeln!(out, "WCONINJH\n {name} {phase} {status} {values} /\n/");
    }
    let mode = match control {
        Some(ControlKind::Rate(4)) => "RESV",
        Some(ControlKind::Rate(_)) => "RATE",
        other => control_name(other),
    };
    let values = items(&[rate, reservoir, pressure]);
    writeln!(
        out,
        "WCONINJE\n {name} {phase} {status} {mode} {values} /\n/"
    )
}

/// Writes the new controls of a group.
fn write_group_controls(out: FileWriter, name: &str, controls: &Controls) -> WriteResult {
    let [oil, water, gas, liquid, reservoir] = controls.rates;
    let mode = control_name(controls.control);
    let (phase, rate) = match controls.kind {
        WellKind::Producer => {
            let limits = items(&[oil, water, gas, liquid]);
            return writeln!(out, "GCONPROD\n {name} {mode} {limits} RATE /\n/");
        }
        WellKind::WaterInjector => ("WATER", water),
        WellKind::GasInjector => ("GAS", gas),
    };
    let mode = if rate.is_some() { "RATE" } else { "RESV" };
    let values = items(&[rate, reservoir]);
    writeln!(out, "GCONINJE\n {name} {phase} {mode} {values} /\n/")
}
