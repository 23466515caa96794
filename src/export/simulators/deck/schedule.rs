//! The wells, their controls and the time steps of a deck.

use std::io::Write;

use super::{TRANSMISSIBILITY_UNIT, WellConnection};
use crate::export::names::ExportNames;
use crate::files::text::{FileWriter, WriteResult};
use crate::model::reservoir::schedule::{ControlKind, Controls, DEFAULT_GROUP, WellKind};
use crate::model::reservoir::{BAR, Control, DAY, Date, Fluid, Model, SimulationCase, Well};

/// Number of reports.
const REPORT_COUNT: usize = 10;

/// Writes SUMMARY and SCHEDULE. `connections` are the connections of each well. Without wells
/// nothing flows, and no time steps are written: OPM Flow, whose time steps depend on changes,
/// would stop with a failed assertion.
pub(crate) fn write_schedule(
    out: FileWriter,
    model: &Model,
    names: &ExportNames,
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
        write_wells(out, case, names, connections)?;
    }
    if case.schedule.is_some() {
        write_steps(out, case, names, connections)?;
    } else {
        let step = case.duration / DAY / REPORT_COUNT as f64;
        writeln!(out, "TSTEP\n {REPORT_COUNT}*{step} /\n")?;
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
    names: &ExportNames,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    writeln!(out, "WELSPECS")?;
    for well in 0..case.wells.len() {
        let change = case.schedule.as_ref().and_then(|s| s.first_change(well));
        let group = change.and_then(|change| change.group.as_deref());
        let group = group.map_or(DEFAULT_GROUP, |group| names.group(group));
        write_specification(
            out,
            case,
            &connections[well],
            WellGroup { well, group, names },
        )?;
    }
    writeln!(out, "/\nCOMPDAT")?;
    for (well, connections) in connections.iter().enumerate() {
        write_completions(out, &names.wells[well], &case.wells[well], connections, 0.0)?;
    }
    writeln!(out, "/")?;
    for (well, name) in case.wells.iter().zip(&names.wells) {
        match well.control {
            Control::Inject(rate) => writeln!(
                out,
                "WCONINJE\n {name} WATER OPEN RATE {} 1* 1E5 /\n/",
                rate * DAY
            )?,
            Control::Pressure(pressure) => {
                writeln!(out, "WCONPROD\n {name} OPEN BHP 5* {} /\n/", pressure / BAR)?;
            }
            Control::Scheduled => {}
        }
    }
    Ok(())
}

/// A well as a member of a group.
struct WellGroup<'a> {
    /// The index of the well.
    well: usize,
    /// The name of the group in the deck.
    group: &'a str,
    names: &'a ExportNames,
}

/// Writes a record of WELSPECS.
fn write_specification(
    out: FileWriter,
    case: &SimulationCase,
    connections: &[WellConnection],
    WellGroup { well, group, names }: WellGroup<'_>,
) -> WriteResult {
    let phase = preferred_phase(case, well);
    let [i, j, _] = connections.first().map_or([1; 3], |first| first.cell);
    let name = &names.wells[well];
    writeln!(out, " {name} {group} {i} {j} 1* {phase} /")
}

/// Writes the records of COMPDAT of a well with this skin factor.
fn write_completions(
    out: FileWriter,
    name: &str,
    well: &Well,
    connections: &[WellConnection],
    skin: f64,
) -> WriteResult {
    for connection in connections {
        let [i, j, k] = connection.cell;
        let index = connection.index_with_skin(skin);
        let (factor, width) = (TRANSMISSIBILITY_UNIT * index, 2.0 * well.radius);
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
    names: &ExportNames,
    connections: &[Vec<WellConnection>],
) -> WriteResult {
    let Some(schedule) = &case.schedule else {
        return Ok(());
    };
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
                let (well, group) = (change.well, names.group(group));
                write_specification(
                    out,
                    case,
                    &connections[well],
                    WellGroup { well, group, names },
                )?;
                writeln!(out, "/")?;
            }
            let (well, name) = (&case.wells[change.well], &names.wells[change.well]);
            if let Some(skin) = change.skin {
                writeln!(out, "COMPDAT")?;
                write_completions(out, name, well, &connections[change.well], skin)?;
                writeln!(out, "/")?;
            }
            write_controls(out, name, &change.controls)?;
        }
        for (group, controls) in &step.groups {
            write_group_controls(out, names.group(group), controls)?;
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
