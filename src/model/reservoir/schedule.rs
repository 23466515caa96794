//! The schedule of a simulation: rates, pressure limits, groups and skin of wells by date, from a
//! table.

use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::str::FromStr;

use super::{Control, Fluid, Well};
use crate::files::table::{Table, TableRow, Term};
use crate::option_text::InvalidValue;
use crate::option_text::serde_as_text;
use crate::units::values::ValueMeasure;
use crate::{Error, Result};

/// Columns of a schedule.
const COLUMNS: [Term; 14] = [
    Term::new("date", &["day", "startdate"]),
    Term::new("well", &["wellname", "name"]),
    Term::new("group", &["groupname"]),
    Term::new("type", &["welltype"]),
    Term::new("status", &["wellstatus"]),
    Term::new("mode", &["controlmode"]),
    Term::new("control", &["controlledby"]),
    Term::new("oil", &["oilrate", "qo", "orat", "wopr", "qoil"]),
    Term::new(
        "water",
        &["waterrate", "qw", "wrat", "wwpr", "qwat", "qwater"],
    ),
    Term::new("gas", &["gasrate", "qg", "grat", "wgpr", "qgas"]),
    Term::new("liquid", &["liquidrate", "ql", "lrat", "wlpr", "qliq"]),
    Term::new("reservoir", &["reservoirrate", "resv", "voidage"]),
    Term::new("bhp", &["bottomholepressure", "wbhp", "pressure"]),
    Term::new("skin", &["skinfactor"]),
];
/// Names of the months in a deck.
const MONTHS: [&str; 12] = [
    "JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC",
];
/// Name of the group of wells without a group.
pub const DEFAULT_GROUP: &str = "G";

/// A date, as days since 1 January 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Date(pub i64);

impl Default for Date {
    /// Returns 1 January 2000.
    fn default() -> Self {
        Self(10_957)
    }
}

impl Date {
    /// Returns a date of the Gregorian calendar, or `None` if it does not exist.
    pub fn new(year: i64, month: u32, day: u32) -> Option<Self> {
        if !(1..=12).contains(&month) || !(1..=31).contains(&day) {
            return None;
        }
        // Years begin in March, so that the leap day is the last one.
        let shifted = year - i64::from(month <= 2);
        let month_index = i64::from((month + 9) % 12);
        let day_of_year = (153 * month_index + 2) / 5 + i64::from(day) - 1;
        let leap_days = shifted.div_euclid(4) - shifted.div_euclid(100) + shifted.div_euclid(400);
        let date = Self(365 * shifted + leap_days + day_of_year - 719_468);
        (date.parts() == (year, month, day)).then_some(date)
    }

    /// Returns year, month and day.
    pub fn parts(self) -> (i64, u32, u32) {
        let days = self.0 + 719_468;
        let era = days.div_euclid(146_097);
        let day_of_era = days.rem_euclid(146_097);
        let year_of_era =
            (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
        let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
        let month_index = (5 * day_of_year + 2) / 153;
        let day = (day_of_year - (153 * month_index + 2) / 5 + 1) as u32;
        let month = ((month_index + 2) % 12 + 1) as u32;
        (era * 400 + year_of_era + i64::from(month <= 2), month, day)
    }

    /// Returns the date as decks have it: 1 MAY 2003.
    pub fn deck_text(self) -> String {
        let (year, month, day) = self.parts();
        format!("{day} {} {year}", MONTHS[month as usize - 1])
    }
}

impl FromStr for Date {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let mut words = text.trim().splitn(3, '-');
        let mut next = || words.next()?.parse::<u32>().ok();
        let date = (|| Self::new(i64::from(next()?), next()?, next()?))();
        let remedy = "give year-month-day, such as 2003-05-01";
        date.ok_or_else(|| InvalidValue::new("is not a date", remedy))
    }
}

impl Display for Date {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let (year, month, day) = self.parts();
        write!(f, "{year:04}-{month:02}-{day:02}")
    }
}

serde_as_text!(Date: ["-"; 2]);

/// The kinds of wells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WellKind {
    /// Produces.
    Producer,
    /// Injects water.
    WaterInjector,
    /// Injects gas.
    GasInjector,
}

/// The value that controls a well or a group: the index of a rate in [`Controls::rates`], or the
/// pressure in the well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlKind {
    /// The rate with this index.
    Rate(usize),
    /// The pressure in the well.
    Pressure,
}

/// Rates and limits of a well or a group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controls {
    /// The kind of the well, or of the wells of the group.
    pub kind: WellKind,
    /// The value that controls. The others are limits.
    pub control: Option<ControlKind>,
    /// Rates in m^3/day at the surface of oil, water, gas and liquid, and in the reservoir.
    pub rates: [Option<f64>; 5],
    /// Limit of the pressure in the well in bar.
    pub pressure: Option<f64>,
    /// `true` if the well flows.
    pub is_open: bool,
    /// `true` if the rates are those that were observed.
    pub is_history: bool,
}

/// Change of a well.
#[derive(Debug, Clone, PartialEq)]
pub struct WellChange {
    /// The number of the well, from 0.
    pub well: usize,
    /// The new group, if it changes.
    pub group: Option<String>,
    /// The new skin factor, if it changes.
    pub skin: Option<f64>,
    /// The new controls.
    pub controls: Controls,
}

/// The changes on one date.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduleStep {
    /// The date.
    pub date: Date,
    /// Changes of wells.
    pub wells: Vec<WellChange>,
    /// Groups with their new controls.
    pub groups: Vec<(String, Controls)>,
}

/// The schedule of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// The first day of the simulation.
    pub start: Date,
    /// The steps, by date.
    pub steps: Vec<ScheduleStep>,
}

/// A row of the table.
struct Row<'a> {
    table: &'a Table,
    row: TableRow<'a>,
    /// The factor of each column's numbers.
    factors: &'a [f64],
}

impl Row<'_> {
    fn error(&self, problem: impl Display, remedy: &str) -> Error {
        self.row.error(problem.to_string(), remedy)
    }

    /// Returns the column of a name. [`Schedule::read`] has refused a name that stands there twice.
    fn column(&self, name: &str) -> Option<usize> {
        let columns = self.table.columns().iter();
        columns
            .into_iter()
            .position(|column| column.term == Some(name))
    }

    /// Returns the text in a column, if there is one.
    fn text(&self, column: &str) -> Option<&str> {
        self.row.text(self.column(column)?)
    }

    fn number(&self, column: &str) -> Result<Option<f64>> {
        let Some(index) = self.column(column) else {
            return Ok(None);
        };
        let value = self.row.number(index)?;
        if value.is_some_and(|value| value < 0.0) && column != "skin" {
            let text = self.row.text(index).unwrap_or_default();
            let problem = format!("'{text}' in column {column} is not a number of 0 or more");
            return Err(self.error(problem, "give a number, or leave it empty"));
        }
        Ok(value.map(|value| value * self.factors[index]))
    }

    /// Returns the entry of `known` whose name the column has.
    fn choice<T: Copy>(&self, column: &str, known: &[(&str, T)]) -> Result<Option<T>> {
        let find = |text: &str| {
            let entry = known.iter().find(|(name, _)| *name == text);
            entry.map(|(_, value)| *value).ok_or_else(|| {
                let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
                let problem = format!("'{text}' is not possible in column {column}");
                self.error(problem, &format!("give one of {}", names.join(", ")))
            })
        };
        self.text(column).map(find).transpose()
    }

    fn controls(&self, previous: WellKind, fluid: Fluid) -> Result<Controls> {
        let kinds = [
            ("producer", WellKind::Producer),
            ("water-injector", WellKind::WaterInjector),
            ("gas-injector", WellKind::GasInjector),
        ];
        let kind = self.choice("type", &kinds)?.unwrap_or(previous);
        let status = self.choice("status", &[("open", true), ("shut", false)])?;
        let mode = self.choice("mode", &[("history", true), ("forecast", false)])?;
        let rate_columns = ["oil", "water", "gas", "liquid", "reservoir"];
        let mut rates = [None; 5];
        for (rate, column) in rates.iter_mut().zip(rate_columns) {
            *rate = self.number(column)?;
        }
        let has_oil = fluid != Fluid::Water;
        let has_gas = fluid == Fluid::OilWaterGas;
        let injects_gas = kind == WellKind::GasInjector;
        for (phase, is_given, exists) in [
            ("oil", rates[0].is_some(), has_oil),
            ("gas", rates[2].is_some() || injects_gas, has_gas),
        ] {
            if is_given && !exists {
                let problem = format!(
                    "has a rate of {phase}, which is not among the fluids of the simulation"
                );
                return Err(self.error(problem, "give other fluids (fluid), or leave it empty"));
            }
        }
        let pressure = self.number("bhp")?;
        let mut controls: Vec<(&str, ControlKind)> = rate_columns
            .into_iter()
            .zip((0..5).map(ControlKind::Rate))
            .collect();
        controls.push(("bhp", ControlKind::Pressure));
        let is_given = |control: ControlKind| match control {
            ControlKind::Rate(index) => rates[index].is_some(),
            ControlKind::Pressure => pressure.is_some(),
        };
        let allowed = |control: ControlKind| match (kind, control) {
            (WellKind::Producer, _) | (_, ControlKind::Rate(4) | ControlKind::Pressure) => true,
            (WellKind::WaterInjector, ControlKind::Rate(index)) => index == 1,
            (WellKind::GasInjector, ControlKind::Rate(index)) => index == 2,
        };
        let chosen = self.choice("control", &controls)?;
        let first = || {
            let mut known = controls.iter().map(|(_, control)| *control);
            known.find(|control| is_given(*control) && allowed(*control))
        };
        let control = match chosen {
            Some(control) if is_given(control) && allowed(control) => Some(control),
            Some(_) => {
                let problem =
                    "is controlled by a value that is not given, or that its type cannot have";
                return Err(self.error(problem, "give that value, or another control"));
            }
            None => first(),
        };
        let is_open = status.unwrap_or(true);
        if control.is_none() && is_open {
            let problem = "gives neither a rate nor a pressure that its type can have";
            return Err(self.error(problem, "give one, or the status shut"));
        }
        Ok(Controls {
            kind,
            control,
            rates,
            pressure,
            is_open,
            is_history: mode.unwrap_or(false),
        })
    }
}

/// Refuses a table without dates, and one whose columns are not all known: a rate that is not
/// understood must not be left out.
fn check_columns(table: &Table) -> Result<()> {
    table.required(&COLUMNS[0])?;
    for column in table.columns() {
        let Some(term) = column.term else {
            return Err(table.unknown(column, &COLUMNS));
        };
        table.column(term)?;
    }
    Ok(())
}

/// Returns the factor of each column that converts its numbers to m^3/day or bar, by the units in the
/// names of columns.
fn column_factors(table: &Table) -> Result<Vec<f64>> {
    let mut factors = Vec::new();
    for (index, column) in table.columns().iter().enumerate() {
        let measure = match column.term {
            Some("bhp") => ValueMeasure::Pressure,
            Some("gas") => ValueMeasure::GasRate,
            Some("oil" | "water" | "liquid" | "reservoir") => ValueMeasure::LiquidRate,
            _ => {
                factors.push(1.0);
                continue;
            }
        };
        factors.push(table.unit_factor(index, measure)?.unwrap_or(1.0));
    }
    Ok(factors)
}

impl Schedule {
    /// Reads a table with a row of column names: date, well, group, type (producer, water-injector,
    /// gas-injector), status (open, shut), mode (history, forecast), control, the rates oil, water,
    /// gas, liquid and reservoir in m^3/day, bhp in bar, and skin. The name of a column may have another
    /// unit in brackets, such as psi or STB/day. Only the date is needed in every row. A row without a well is for a group, one without a group gives only the date.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`] with the line of a row
    /// that makes no sense.
    pub fn read(path: &Path, wells: &[Well], fluid: Fluid, start: Option<Date>) -> Result<Self> {
        let table = Table::read(path, &COLUMNS)?;
        check_columns(&table)?;
        let factors = column_factors(&table)?;
        let mut kinds: Vec<WellKind> = (wells.iter())
            .map(|well| match well.control {
                Control::Inject(_) => WellKind::WaterInjector,
                _ => WellKind::Producer,
            })
            .collect();
        let mut dated: Vec<(Date, Row<'_>)> = Vec::new();
        for row in table.rows() {
            let row = Row {
                table: &table,
                row,
                factors: &factors,
            };
            let text = row.text("date").unwrap_or_default();
            let date = text.parse().map_err(|_| {
                let problem = format!("'{text}' in column date is not a date");
                row.error(problem, "give year-month-day, such as 2003-05-01")
            })?;
            dated.push((date, row));
        }
        dated.sort_by_key(|(date, _)| *date);
        let first = dated.first().map(|(date, _)| *date);
        let start = start.or(first).unwrap_or_default();
        let mut steps: Vec<ScheduleStep> = Vec::new();
        for (date, row) in dated {
            if date < start {
                let problem = format!("{date} lies before the start of the simulation, {start}");
                return Err(row.error(problem, "give a later date, or an earlier start"));
            }
            if steps.last().is_none_or(|step| step.date != date) {
                steps.push(ScheduleStep {
                    date,
                    wells: Vec::new(),
                    groups: Vec::new(),
                });
            }
            let Some(step) = steps.last_mut() else {
                continue;
            };
            let group = row.text("group").map(String::from);
            if let Some(name) = row.text("well") {
                let Some(well) = wells.iter().position(|well| well.name == name) else {
                    let names: Vec<&str> = wells.iter().map(|well| well.name.as_str()).collect();
                    let problem = format!("well '{name}' is not one of {}", names.join(", "));
                    let remedy = "give its place as a well, an injector or a producer";
                    return Err(row.error(problem, remedy));
                };
                let controls = row.controls(kinds[well], fluid)?;
                kinds[well] = controls.kind;
                step.wells.push(WellChange {
                    well,
                    group,
                    skin: row.number("skin")?,
                    controls,
                });
            } else if let Some(group) = group {
                let controls = row.controls(WellKind::Producer, fluid)?;
                if controls.is_history || controls.pressure.is_some() {
                    let problem = "gives a group a pressure or a history";
                    return Err(row.error(problem, "give these to wells"));
                }
                step.groups.push((group, controls));
            }
        }
        Ok(Self { start, steps })
    }

    /// Returns the first change of a well.
    pub fn first_change(&self, well: usize) -> Option<&WellChange> {
        let changes = self.steps.iter().flat_map(|step| &step.wells);
        changes.into_iter().find(|change| change.well == well)
    }

    /// Returns the names of all groups.
    pub fn groups(&self) -> Vec<&str> {
        let of_wells = self.steps.iter().flat_map(|step| &step.wells);
        let of_wells = of_wells.filter_map(|change| change.group.as_deref());
        let groups = self.steps.iter().flat_map(|step| &step.groups);
        let mut names: Vec<&str> = of_wells
            .chain(groups.map(|(name, _)| name.as_str()))
            .collect();
        names.push(DEFAULT_GROUP);
        names.sort_unstable();
        names.dedup();
        names
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        let date = |text: &str| text.parse::<Date>();
        assert_eq!(date("1970-01-01").unwrap(), Date(0));
        assert_eq!(date("2000-01-01").unwrap(), Date::default());
        assert_eq!(
            date("2024-03-01").unwrap().0 - date("2024-02-28").unwrap().0,
            2
        );
        assert_eq!(
            date("2100-03-01").unwrap().0 - date("2100-02-28").unwrap().0,
            1
        );
        for day in (-200_000..200_000).step_by(97) {
            let (year, month, day_of_month) = Date(day).parts();
            assert_eq!(Date::new(year, month, day_of_month), Some(Date(day)));
        }
        assert_eq!(date("2003-05-01").unwrap().deck_text(), "1 MAY 2003");
        for wrong in ["2003", "2003-13-01", "2003-02-29", "2003-02-00", "x"] {
            assert!(date(wrong).is_err(), "{wrong}");
        }
    }

    fn read(text: &str) -> std::result::Result<Schedule, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("schedule.csv");
        std::fs::write(&path, text).unwrap();
        let well = |name: &str, control| Well {
            name: name.into(),
            cells: vec![(0, 1.0)],
            strengths: vec![1.0],
            lengths: vec![1.0],
            radius: 0.1,
            path: vec![[0.0; 3]],
            control,
        };
        let wells = [
            well("I1", Control::Inject(1.0)),
            well("P1", Control::Scheduled),
        ];
        Schedule::read(&path, &wells, Fluid::OilWater, None).map_err(|e| e.to_string())
    }

    #[test]
    fn schedules_are_read_by_the_names_of_columns() {
        let schedule = read(
            "well,date,oil,water,bhp,group,skin,mode,type\n\
             P1,2001-01-01,100,,150,NORTH,2.5,,\nI1,2000-01-01,,500,400,,,,\n\
             P1,2002-01-01,80,20,,,,history,\n,2003-01-01,,,,,,,\n,2001-01-01,300,,,NORTH,,,\n",
        )
        .unwrap();
        assert_eq!(schedule.start, Date::default());
        assert_eq!(schedule.steps.len(), 4);
        let injection = &schedule.steps[0].wells[0];
        assert_eq!(
            (injection.well, injection.controls.kind),
            (0, WellKind::WaterInjector)
        );
        assert_eq!(injection.controls.control, Some(ControlKind::Rate(1)));
        let production = &schedule.steps[1].wells[0];
        assert_eq!(
            (production.skin, production.group.as_deref()),
            (Some(2.5), Some("NORTH"))
        );
        assert_eq!(production.controls.control, Some(ControlKind::Rate(0)));
        assert_eq!(schedule.steps[1].groups[0].0, "NORTH");
        assert!(schedule.steps[2].wells[0].controls.is_history);
        assert!(schedule.steps[3].wells.is_empty());
        assert_eq!(schedule.groups(), ["G", "NORTH"]);
        assert_eq!(schedule.first_change(1).unwrap().skin, Some(2.5));
    }

    #[test]
    fn units_in_the_names_of_columns_are_converted() {
        let change = |names: &str, row: &str| -> std::result::Result<Controls, String> {
            let schedule = read(&format!("date,well,{names}\n2000-01-01,P1,{row}\n"))?;
            Ok(schedule.steps[0].wells[0].controls)
        };
        for (names, row) in [
            ("oil,bhp", "10,100"),
            ("oil (STB/day),bhp (psi)", "62.898108,1450.3774"),
            ("oil [bbl/d],bhp [kPa]", "62.898108,10000"),
            ("oil (sm\u{b3}/day),bhp (MPa)", "10,10"),
            ("oil (m^3/d),bhp (atm)", "10,98.692327"),
        ] {
            let controls = change(names, row).unwrap();
            let values = [controls.pressure.unwrap(), controls.rates[0].unwrap()];
            assert!((values[0] / 100.0 - 1.0).abs() < 1e-6, "{names} {values:?}");
            assert!((values[1] / 10.0 - 1.0).abs() < 1e-6, "{names} {values:?}");
        }
        for (names, expected) in [
            (
                "oil,bhp (furlong)",
                ":1: column 'bhp' has the unit 'furlong'",
            ),
            (
                "oil,bhp (furlong)",
                "give one of bar, psi, kPa, MPa, Pa, atm",
            ),
            (
                "oil (Mscf/day),bhp",
                ":1: column 'oil' has the unit 'Mscf/day'",
            ),
        ] {
            let error = change(names, "10,100").unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn errors_name_the_line() {
        for (row, expected) in [
            ("P2,2000-01-01,1,,", ":2: well 'P2' is not one of I1, P1"),
            ("P1,2000-31-01,1,,", ":2: '2000-31-01' in column date"),
            (
                "P1,2000-01-01,,,",
                ":2: gives neither a rate nor a pressure",
            ),
            ("P1,2000-01-01,-5,,", ":2: '-5' in column oil"),
            ("P1,2000-01-01,,5,", ":2: has a rate of gas"),
            (
                "P1,2000-01-01,5,,open it",
                ":2: 'open it' is not possible in column status",
            ),
        ] {
            let error = read(&format!("well,date,oil,gas,status\n{row}\n")).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let error = read("well,date,oill\nP1,2000-01-01,4\n").unwrap_err();
        assert!(error.contains("'oill'"), "{error}");
    }
}
