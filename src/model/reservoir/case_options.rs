//! Options for the wells and fluids of a simulation.

use std::cell::OnceCell;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::equilibrium::{Equilibrium, equilibria};
use super::well_options::{GivenWell, WellInModel};
use super::{
    Aquifer, AquiferOption, BAR, CapillaryOption, ContactOption, Control, DAY, Date, DatumOption,
    Fluid, GRAVITY, Model, OIL_DENSITY, PreparedModel, SURFACE_PRESSURE, Schedule, ScheduledWell,
    SimulationCase, Trajectory, WATER_DENSITY, Well, WellOption, WellPlace, WellTracer,
};
use crate::error::cause;
use crate::mesh::graph::Locator;
use crate::progress::Progress;
use crate::{Error, Result};

/// Number of days that are simulated by default.
const DEFAULT_DAYS: f64 = 3650.0;

/// Default radius in metres of wells that are given by a point.
const DEFAULT_WELL_RADIUS: f64 = 0.1;

/// The fluids in the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FluidChoice {
    /// Water only
    Water,
    /// Oil, into which water is injected
    OilWater,
    /// Gas above oil above water (needs contacts)
    OilWaterGas,
}

/// Options for the wells, fluids and duration of a simulation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct CaseOptions {
    /// Fluids in the pores [default: water]
    #[arg(long, value_name = "FLUID")]
    pub fluid: Option<FluidChoice>,
    /// A well that injects water at a rate in m^3/day. It is vertical in the cell at X,Y,Z (the
    /// mesh's coordinates), or follows the trajectory in a table of columns x, y, z and radius:
    /// [NAME=]FILE.csv:RATE; may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:RATE", allow_hyphen_values = true)]
    pub injector: Vec<WellOption>,
    /// A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a CSV file;
    /// may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:BAR", allow_hyphen_values = true)]
    pub producer: Vec<WellOption>,
    /// A well whose rates and pressures are in --schedule, at X,Y,Z or along the trajectory in a CSV
    /// file; may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z", allow_hyphen_values = true)]
    pub well: Vec<ScheduledWell>,
    /// A CSV table of what wells and groups do, with a row of names at the top: date, well, group,
    /// type, status, mode, control, oil, water, gas, liquid, reservoir, bhp, skin
    #[arg(long, value_name = "FILE.csv")]
    pub schedule: Option<PathBuf>,
    /// First day of the simulation, year-month-day [default: the first date of the schedule, or
    /// 2000-01-01]
    #[arg(long, value_name = "DATE")]
    pub start: Option<Date>,
    /// Depth (m) of a contact between fluids, which are in equilibrium at the start:
    /// oil-water=DEPTH or gas-oil=DEPTH, perhaps with the capillary pressure there (bar), and before it the
    /// number of an equilibration region: 2/oil-water=2450:0.1; may be repeated
    #[arg(long, value_name = "[REGION/]FLUIDS=DEPTH[:BAR]")]
    pub contact: Vec<ContactOption>,
    /// Initial pressure (bar) at a depth (m) where there are contacts; may be repeated [default: that of a
    /// column of water at the contact with oil]
    #[arg(long, value_name = "[REGION/]DEPTH:BAR")]
    pub datum: Vec<DatumOption>,
    /// Capillary pressure between oil and water after Brooks and Corey: entry pressure (bar) and exponent,
    /// for all or one of the tables of --satnum; may be repeated [default: none; exponent 2]
    #[arg(long, value_name = "[TABLE/]BAR[:EXPONENT]")]
    pub capillary_pressure: Vec<CapillaryOption>,
    /// An aquifer beyond a side of the mesh (xmin ... zmax): Carter-Tracy with permeability (mD), porosity,
    /// thickness (m), radius (m) and angle (degrees), or Fetkovich with volume (m^3) and productivity
    /// (m^3/day/bar); both with compressibility (1/bar), below (depth), datum and pressure; may be
    /// repeated
    #[arg(long, value_name = "SIDE:NAME=VALUE,...")]
    pub aquifer: Vec<AquiferOption>,
    /// Radius (m) of wells that are given by a point, or whose file has no radius [default: 0.1]
    #[arg(long, value_name = "R")]
    pub well_radius: Option<f64>,
    /// Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    #[arg(long, value_name = "BAR")]
    pub pressure_at_top: Option<f64>,
    /// Ignore gravity: no hydrostatic gradient
    #[arg(long)]
    pub no_gravity: bool,
    /// Number of days to simulate [default: 3650]
    #[arg(long, value_name = "DAYS")]
    pub days: Option<f64>,
}

/// Checks that the value of an option is positive.
///
/// # Errors
/// Returns [`Error::Job`] if it is not.
pub(super) fn check_positive(option: &str, value: f64) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    let place = format!("{option} {value}");
    Err(Error::Job(cause(
        place,
        "is not a positive number",
        "give one above 0",
    )))
}

impl CaseOptions {
    /// Checks the options that do not depend on the model.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense.
    pub(crate) fn validate(&self) -> Result<()> {
        let numbers = [
            ("days", self.days),
            ("well-radius", self.well_radius),
            ("pressure-at-top", self.pressure_at_top),
        ];
        for (option, number) in numbers {
            if let Some(number) = number {
                check_positive(option, number)?;
            }
        }
        self.check_fluids()?;
        self.check_wells()
    }

    /// Checks that the options for fluids make sense together.
    fn check_fluids(&self) -> Result<()> {
        let has_contacts = !self.contact.is_empty();
        let is_two_phase = self.fluid.is_some_and(|fluid| fluid != FluidChoice::Water);
        let refuse = |option: &str, problem: &str, remedy: &str| {
            Err(Error::Job(cause(option, problem, remedy)))
        };
        if has_contacts && !is_two_phase {
            let remedy = "give the fluids oil-water or oil-water-gas, or omit it";
            return refuse(
                "contact",
                "is between fluids, but there is only water",
                remedy,
            );
        }
        if has_contacts && self.no_gravity {
            let remedy = "omit one of them";
            return refuse(
                "contact",
                "has no effect without gravity (no-gravity)",
                remedy,
            );
        }
        if !has_contacts && self.fluid == Some(FluidChoice::OilWaterGas) {
            let remedy = "give contacts, such as oil-water=2450 and gas-oil=2400";
            return refuse(
                "fluid oil-water-gas",
                "needs the contacts of the fluids",
                remedy,
            );
        }
        if !has_contacts && !self.datum.is_empty() {
            let remedy = "give contacts, or the pressure at the top (pressure-at-top)";
            return refuse("datum", "has no effect without contacts", remedy);
        }
        if !self.datum.is_empty() && self.pressure_at_top.is_some() {
            let remedy = "omit one of them";
            return refuse(
                "datum",
                "and the pressure at the top exclude one another",
                remedy,
            );
        }
        if !is_two_phase && !self.capillary_pressure.is_empty() {
            let remedy = "give the fluids oil-water or oil-water-gas, or omit it";
            return refuse(
                "capillary-pressure",
                "is between oil and water, but there is only water",
                remedy,
            );
        }
        if self.has_gas_contact() && self.fluid != Some(FluidChoice::OilWaterGas) {
            let remedy = "give the fluids oil-water-gas, or omit it";
            return refuse("contact gas-oil", "is of gas, but there is none", remedy);
        }
        Ok(())
    }

    /// Checks that the options for wells and time make sense together.
    fn check_wells(&self) -> Result<()> {
        let refuse = |option: &str, problem: &str, remedy: &str| {
            Err(Error::Job(cause(option, problem, remedy)))
        };
        if self.schedule.is_none() {
            if let Some(well) = self.well.first() {
                let remedy = "give a schedule, or an injector or producer in its place";
                return refuse(
                    &format!("well {well}"),
                    "has its rates in a schedule, but there is none",
                    remedy,
                );
            }
            if self.start.is_some() && !self.has_wells() {
                let remedy = "give wells, or omit it";
                return refuse("start", "has no effect without wells", remedy);
            }
        } else if !self.has_wells() {
            let remedy = "give their places as wells, injectors or producers";
            return refuse("schedule", "is for wells, but there are none", remedy);
        }
        match self.days {
            Some(days) if !self.has_wells() => {
                let remedy = "give an injector or a producer, or omit it";
                let place = format!("days {days}");
                Err(Error::Job(cause(
                    place,
                    "has no effect without wells",
                    remedy,
                )))
            }
            _ => Ok(()),
        }
    }

    /// Returns `true` if there are wells.
    pub(crate) fn has_wells(&self) -> bool {
        !(self.injector.is_empty() && self.producer.is_empty() && self.well.is_empty())
    }

    fn has_gas_contact(&self) -> bool {
        let mut contacts = self.contact.iter();
        contacts.any(|contact| contact.kind == super::equilibrium::ContactKind::GasOil)
    }

    /// Returns the simulation case, with its wells in cells of the model.
    ///
    /// # Errors
    /// Returns [`Error::Export`] for wells that lie outside the mesh.
    pub(crate) fn case(
        &self,
        prepared: &PreparedModel,
        progress: &mut dyn Progress,
    ) -> Result<SimulationCase> {
        let model = &prepared.model;
        let wells = self.place_wells(prepared, progress)?;
        let fluid = match self.fluid.unwrap_or(FluidChoice::Water) {
            FluidChoice::Water => Fluid::Water,
            FluidChoice::OilWater => Fluid::OilWater,
            FluidChoice::OilWaterGas => Fluid::OilWaterGas,
        };
        let (equilibria, top_pressure) = self.initial_state(model)?;
        let aquifers = self
            .aquifer
            .iter()
            .map(|option| Aquifer::new(*option, model));
        let schedule = (self.schedule.as_ref())
            .map(|path| Schedule::read(path, &wells, fluid, self.start))
            .transpose()?;
        if let Some(schedule) = &schedule {
            note_unscheduled_wells(schedule, &wells, progress);
        }
        let start = schedule.as_ref().map(|schedule| schedule.start);
        let start = start.or(self.start).unwrap_or_default();
        let days = self.simulated_days(schedule.as_ref(), start)?;
        Ok(SimulationCase {
            title: "atomesh".into(),
            fluid,
            has_gravity: !self.no_gravity,
            top_pressure,
            equilibria,
            capillary_pressures: self.capillary_pressure.clone(),
            aquifers: aquifers.collect::<Result<_>>()?,
            wells,
            start,
            schedule,
            duration: days * DAY,
        })
    }

    /// Returns the wells of the options: injectors, producers and those of a schedule.
    fn given_wells(&self) -> impl Iterator<Item = GivenWell<'_>> {
        let injectors = self.injector.iter().map(|well| GivenWell {
            label: format!("injector {well}"),
            name: well.name.as_deref(),
            place: &well.place,
            letter: 'I',
            control: Control::Inject(well.value / DAY),
        });
        let producers = self.producer.iter().map(|well| GivenWell {
            label: format!("producer {well}"),
            name: well.name.as_deref(),
            place: &well.place,
            letter: 'P',
            control: Control::Pressure(well.value * BAR),
        });
        let scheduled = self.well.iter().map(|well| GivenWell {
            label: format!("well {well}"),
            name: well.name.as_deref(),
            place: &well.place,
            letter: 'W',
            control: Control::Scheduled,
        });
        injectors.chain(producers).chain(scheduled)
    }

    /// Returns the wells, in cells of the model.
    fn place_wells(
        &self,
        prepared: &PreparedModel,
        progress: &mut dyn Progress,
    ) -> Result<Vec<Well>> {
        let point_radius = self.well_radius.unwrap_or(DEFAULT_WELL_RADIUS);
        let model = &prepared.model;
        let mut wells: Vec<Well> = Vec::new();
        let (tracer, locator) = (OnceCell::new(), OnceCell::new());
        for given in self.given_wells() {
            let refuse = |problem: &str, remedy: &str| {
                Err(Error::Job(cause(given.label.clone(), problem, remedy)))
            };
            let tracer = tracer.get_or_init(|| WellTracer::new(model));
            let places = match given.place {
                WellPlace::File(path) => {
                    given.read(path, point_radius, tracer, prepared, progress)?
                }
                WellPlace::Point(point) => {
                    let point = prepared.frame.to_model(*point);
                    let locator = locator.get_or_init(|| Locator::new(&model.graph));
                    let Some(cell) = locator.cell_at(point) else {
                        let remedy = "give a point inside, in the mesh's coordinates (`atomesh info` shows its extent)";
                        return refuse("lies outside the mesh", remedy);
                    };
                    vec![WellInModel {
                        name: format!("{}{}", given.letter, wells.len() + 1),
                        trajectory: Trajectory {
                            name: given.label.clone(),
                            points: vec![point],
                            radii: vec![point_radius],
                        },
                        completions: tracer.complete_cell(&given.label, cell, point_radius)?,
                    }]
                }
            };
            for place in places {
                let name = given.name.map_or(place.name, String::from);
                if wells.iter().any(|known| known.name == name) {
                    let problem = "has the same name as another well";
                    return refuse(problem, "give it another name with NAME= before it");
                }
                let completions = &place.completions;
                wells.push(Well {
                    name,
                    cells: completions.iter().map(|c| (c.cell, c.index)).collect(),
                    strengths: completions.iter().map(|c| c.strength).collect(),
                    lengths: completions.iter().map(|c| c.length).collect(),
                    radius: place.trajectory.radii[0],
                    path: place.trajectory.points,
                    control: given.control,
                });
            }
        }
        Ok(wells)
    }

    /// Returns the equilibria of the fluids at the start, and the pressure at the model's top.
    fn initial_state(&self, model: &Model) -> Result<(Vec<Equilibrium>, f64)> {
        let top = (0..model.len()).map(|cell| model.depth(cell));
        let top = top.fold(f64::INFINITY, f64::min);
        let hydrostatic = SURFACE_PRESSURE + WATER_DENSITY * GRAVITY * top;
        let mut top_pressure = self.pressure_at_top.map_or(hydrostatic, |bar| bar * BAR);
        let mut equilibria = if self.contact.is_empty() {
            Vec::new()
        } else {
            let [_, _, count, _] = model.deck_regions.counts();
            equilibria(&self.contact, &self.datum, count)?
        };
        for equilibrium in &mut equilibria {
            if self.pressure_at_top.is_some() {
                (equilibrium.datum, equilibrium.pressure) = (top, top_pressure);
            }
        }
        if let Some(first) = equilibria.first() {
            top_pressure = first.pressure - OIL_DENSITY * GRAVITY * (first.datum - top);
        }
        Ok((equilibria, top_pressure))
    }

    /// Returns the number of days from `start` that are simulated.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if the schedule ends later than the option says.
    fn simulated_days(&self, schedule: Option<&Schedule>, start: Date) -> Result<f64> {
        let Some(last) = schedule.and_then(|schedule| schedule.steps.last()) else {
            return Ok(self.days.unwrap_or(DEFAULT_DAYS));
        };
        let last_day = (last.date.0 - start.0) as f64;
        let ends_there = last.wells.is_empty() && last.groups.is_empty();
        match self.days {
            Some(days) if last_day > days => {
                let problem = format!("end before {}, the last date of the schedule", last.date);
                let remedy = "give more days, or omit it";
                Err(Error::Job(cause(format!("days {days}"), problem, remedy)))
            }
            None if ends_there => Ok(last_day),
            None => Ok(DEFAULT_DAYS + last_day),
            Some(days) => Ok(days),
        }
    }
}

/// Notes the wells that the schedule does not open.
fn note_unscheduled_wells(schedule: &Schedule, wells: &[Well], progress: &mut dyn Progress) {
    for (index, well) in wells.iter().enumerate() {
        if well.control == Control::Scheduled && schedule.first_change(index).is_none() {
            progress.note(&format!(
                "well {}: is not in the schedule, and stays shut",
                well.name
            ));
        }
    }
}
