//! The options of `atomesh export`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{ExportContent, ExportFormat};
use crate::error::cause;
use crate::files::output::check_output;
use crate::mesh_file::{CellChoice, RegionNames};
use crate::model::flow::driver::{BarrierSelection, FaultLaws};
use crate::model::flow::{FaultOptions, FaultResistance};
use crate::model::reservoir::{CaseOptions, GougeOptions, RockOptions, SpaceOptions, WellPlace};
use crate::option_text::InvalidValue;
use crate::option_text::serde_as_text;
use crate::{Error, Result};

/// Options of `atomesh export`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExportSpec {
    /// Options for the rock in the cells.
    #[command(flatten, next_help_heading = "Rock")]
    pub rock: RockOptions,
    /// Options that say how faults resist flow; they are open by default.
    #[command(flatten, next_help_heading = "Faults")]
    pub fault_options: FaultOptions,
    /// Options for fault rock that is computed from clay.
    #[command(flatten, next_help_heading = "Faults")]
    pub gouge: GougeOptions,
    /// Regions, by label or name, whose cells are left out, such as 0 for the background. Their boundaries keep
    /// their names, such as interface_0_3
    #[arg(long, value_name = "LABEL,...", allow_hyphen_values = true, conflicts_with = "keep", help_heading = None)]
    pub drop: Option<RegionNames>,
    /// Regions, by label or name, whose cells alone are exported
    #[arg(long, value_name = "LABEL,...", allow_hyphen_values = true, help_heading = None)]
    pub keep: Option<RegionNames>,
    /// Of each region that stays, keep only the largest connected part
    #[arg(long, help_heading = None)]
    pub keep_largest: bool,
    /// Number of columns along two axes, and of layers, of a corner-point grid (grdecl) [default:
    /// as fine as the cells]
    #[arg(long, value_name = "NX,NY,NZ", help_heading = None)]
    pub grid: Option<GridCounts>,
    /// Duplicate the nodes along surfaces and add elements between the two sides (tetrahedra only):
    /// faults, horizons, all, or a list of numbers and names as `atomesh surface MESH` prints them
    #[arg(long, value_name = "WHICH", help_heading = None)]
    pub split: Option<BarrierSelection>,
    /// Add nodes in the middle of edges: elements of second order
    #[arg(long, help_heading = None)]
    pub quadratic: bool,
    /// Extend faults beyond their edges by up to DIST metres, to the next fault or the sides of the mesh,
    /// along the faces of cells. An extension has a name of its own, such as fault1_extension, and the law
    /// of its fault
    #[arg(long, value_name = "DIST", help_heading = "Faults")]
    pub extend_faults: Option<f64>,
    /// Also write what lies against what on the two sides of faults (Allan maps): a table of area, throw, shale-gouge
    /// ratio, multiplier and transmissibility by pairs of zones (.csv), the faces with these (.vtp), or a picture
    /// (.png). May be repeated
    #[arg(long, value_name = "FILE", help_heading = "Faults")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub juxtaposition: Vec<PathBuf>,
    /// Report for each closed fault whether it seals, the share of the flow between its two sides that
    /// passes through it and around its ends, the place, area, cause and remedy of each leak, and the wells in
    /// each compartment
    #[arg(long, help_heading = "Faults")]
    pub check_seals: bool,
    /// Write the result of --check-seals as a table, a line for each leak (.csv)
    #[arg(
        long,
        value_name = "FILE",
        requires = "check_seals",
        help_heading = "Faults"
    )]
    pub seal_table: Option<PathBuf>,
    /// Options that convert coordinates to metres and depth.
    #[command(flatten, next_help_heading = "Space")]
    pub space: SpaceOptions,
    /// Options for wells, fluids and the duration of the simulation.
    #[command(flatten, next_help_heading = "Case")]
    pub case: CaseOptions,
}

/// Numbers of columns along two axes, and of layers, each from 1 to 10000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GridCounts(pub [usize; 3]);

impl FromStr for GridCounts {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        let counts = numbers.and_then(|n| <[usize; 3]>::try_from(n).ok());
        let fits = |n: &[usize; 3]| n.iter().all(|n| (1..=10_000).contains(n));
        counts.filter(fits).map(Self).ok_or_else(|| {
            let remedy = "give NX,NY,NZ, each from 1 to 10000";
            InvalidValue::new("is not three numbers of cells", remedy)
        })
    }
}

impl Display for GridCounts {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let [nx, ny, nz] = self.0;
        write!(f, "{nx},{ny},{nz}")
    }
}

serde_as_text!(GridCounts: [","; 2]);

/// Returns the error about an option that would have no effect.
pub(super) fn no_effect_error(option: &str, problem: &str) -> Error {
    Error::Job(cause(option, problem, "omit it"))
}

impl ExportSpec {
    /// Returns which cells of the mesh are exported.
    pub fn cell_choice(&self) -> CellChoice<'_> {
        CellChoice {
            drop: self.drop.as_ref(),
            keep: self.keep.as_ref(),
            keep_largest: self.keep_largest,
        }
    }

    /// Returns `true` if an export in this format is for flow, so that depth and fluxes matter.
    pub fn is_for_flow(&self, format: &ExportFormat) -> bool {
        format.is_for_flow(self.rock.permeability.is_some() || self.rock.porosity.is_some())
    }

    /// Checks that the options make sense together, and have an effect in this format.
    ///
    /// # Errors
    /// Returns an error that begins with the name of the option that is impossible or has no effect.
    pub fn validate(&self, format: &ExportFormat) -> Result<()> {
        self.cell_choice().validate()?;
        self.space.placement()?;
        let laws = self.fault_options.laws(FaultResistance::Open)?;
        self.gouge.validate()?;
        let has_closed_fault = laws.law.multiplier() == 0.0
            || laws
                .overrides
                .iter()
                .any(|entry| entry.1.multiplier() == 0.0);
        if self.check_seals && !has_closed_fault {
            let problem = "is for closed faults, but none is closed";
            return Err(no_effect_error("check-seals", problem));
        }
        for path in &self.juxtaposition {
            check_output(path, "juxtaposition", &["csv", "vtp", "png"], &[])?;
        }
        if let Some(table) = &self.seal_table {
            check_output(table, "seal-table", &["csv"], &[])?;
            if !self.check_seals {
                let problem = "is for the check of seals, which is not requested";
                return Err(no_effect_error("seal-table", problem));
            }
        }
        if let Some(distance) = self.extend_faults {
            if !(distance.is_finite() && distance > 0.0) {
                let place = format!("extend-faults {distance}");
                let problem = "is not a positive number of metres";
                return Err(Error::Job(cause(
                    place,
                    problem,
                    "give a distance, or omit it",
                )));
            }
            if self.fault_options.given_option().is_none() {
                format.check_content(ExportContent::Names, "extend-faults")?;
            }
        }
        self.check_effect(format, &laws)?;
        self.case.validate()
    }

    /// Checks that no option is given that has no effect with the format or the other options.
    fn check_effect(&self, format: &ExportFormat, laws: &FaultLaws) -> Result<()> {
        let given = self.given_content();
        for (option, content) in &given {
            format.check_content(*content, option)?;
        }
        if let Some(option) = self.fault_options.given_option() {
            let content = if laws.has_partial_law() {
                ExportContent::Faults
            } else {
                ExportContent::ClosedFaults
            };
            format.check_content(content, option)?;
        }
        let simulation_input = given
            .iter()
            .find(|(_, content)| content.is_simulation_input());
        if let Some((option, _)) = simulation_input {
            self.check_rock_is_known(format, option)?;
        }
        self.check_permeability_is_known(format)?;
        self.check_well_radius()
    }

    /// Returns the options that are given, each with the content of a file that it makes or changes.
    fn given_content(&self) -> Vec<(&'static str, ExportContent)> {
        use ExportContent as Content;
        let (rock, case) = (&self.rock, &self.case);
        let has_permeability = rock.permeability.is_some();
        let has_capillary_pressure = !case.capillary_pressure.is_empty();
        let has_pressure_at_top = case.pressure_at_top.is_some();
        let options = [
            ("porosity", rock.porosity.is_some(), Content::Porosity),
            ("region", rock.region.is_some(), Content::Regions),
            ("permeability", has_permeability, Content::Permeability),
            ("property", !rock.property.is_empty(), Content::Properties),
            (
                "net-to-gross",
                rock.net_to_gross.is_some(),
                Content::NetToGross,
            ),
            ("cutoff", !rock.cutoff.is_empty(), Content::CutOffs),
            ("satnum", rock.satnum.is_some(), Content::DeckRegions),
            ("pvtnum", rock.pvtnum.is_some(), Content::DeckRegions),
            ("eqlnum", rock.eqlnum.is_some(), Content::DeckRegions),
            ("fipnum", rock.fipnum.is_some(), Content::DeckRegions),
            ("injector", !case.injector.is_empty(), Content::Wells),
            ("producer", !case.producer.is_empty(), Content::Wells),
            ("well-radius", case.well_radius.is_some(), Content::Wells),
            ("fluid", case.fluid.is_some(), Content::Fluid),
            ("well", !case.well.is_empty(), Content::Study),
            ("schedule", case.schedule.is_some(), Content::Study),
            ("start", case.start.is_some(), Content::Study),
            ("contact", !case.contact.is_empty(), Content::Study),
            ("datum", !case.datum.is_empty(), Content::Study),
            ("capillary-pressure", has_capillary_pressure, Content::Study),
            ("aquifer", !case.aquifer.is_empty(), Content::Study),
            (
                "pressure-at-top",
                has_pressure_at_top,
                Content::InitialPressure,
            ),
            ("no-gravity", case.no_gravity, Content::Gravity),
            ("days", case.days.is_some(), Content::Duration),
            ("grid", self.grid.is_some(), Content::Grid),
            ("split", self.split.is_some(), Content::SplitNodes),
            ("quadratic", self.quadratic, Content::Quadratic),
        ];
        (options.into_iter())
            .filter_map(|(option, is_given, content)| is_given.then_some((option, content)))
            .collect()
    }

    /// Checks that the rock is known, if the format needs it for a simulation deck, to which `option`
    /// applies.
    fn check_rock_is_known(&self, format: &ExportFormat, option: &str) -> Result<()> {
        let has_porosity = self.rock.porosity.is_some();
        if has_porosity && self.rock.permeability.is_some() || !format.case_needs_rock() {
            return Ok(());
        }
        let problem = format!(
            "applies to a simulation deck, which {} writes only if the rock is known",
            format.name
        );
        let remedy = "give porosity and permeability, or omit it";
        let parameter = if has_porosity {
            "permeability"
        } else {
            "porosity"
        };
        let cause = cause(option, problem, remedy).with_parameter(parameter);
        Err(Error::Job(cause))
    }

    /// Checks that the permeability is known, if an option needs it.
    fn check_permeability_is_known(&self, format: &ExportFormat) -> Result<()> {
        let has_permeability = self.rock.permeability.is_some();
        if let Some(option) = self.gouge.given_option() {
            format.check_content(ExportContent::Faults, option)?;
            if !has_permeability {
                let problem =
                    "gives the permeability of fault rock, but that of the rock is not known";
                return Err(no_effect_error(option, problem));
            }
        }
        if has_permeability {
            return Ok(());
        }
        if self.rock.permeability_unit.is_some() {
            return Err(no_effect_error(
                "permeability-unit",
                "is given without a permeability",
            ));
        }
        if let Some(option) = self.fault_options.given_option()
            && !format
                .supported_content
                .contains(&ExportContent::FaultsWithoutRock)
        {
            let problem = "changes the transmissibility of faults, but no permeability is given";
            return Err(no_effect_error(option, problem));
        }
        Ok(())
    }

    /// Checks that there is a well that is given by a point, if there is a radius for such wells.
    fn check_well_radius(&self) -> Result<()> {
        let case = &self.case;
        let wells = case.injector.iter().chain(&case.producer);
        let mut places = (wells.map(|well| &well.place)).chain(case.well.iter().map(|w| &w.place));
        if case.well_radius.is_some() && !places.any(|place| matches!(place, WellPlace::Point(_))) {
            let problem = "is the radius of wells that are given by a point, but there are none";
            return Err(no_effect_error("well-radius", problem));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read_from_texts_numbers_and_lists() {
        let json = r#"{
            "rock": {
                "porosity": 0.2,
                "permeability": [100, "kv.npy:harmonic", 10],
                "permeability-unit": "mD",
                "property": [["amplitude", "survey.sgy"], "depth=z.npy"]
            },
            "fault-options": {"faults": 0.01, "fault-multiplier": [[3, 0.5], "1/11:0"], "barriers": [1, "fault2"]},
            "grid": [10, 20, 3],
            "space": {"down": "z"},
            "case": {"injector": [[[1, 2.5, 3], 50], "W=way.csv:20"], "fluid": "oil-water"}
        }"#;
        let spec: ExportSpec = serde_json::from_str(json).unwrap();
        let texts = |json: serde_json::Value| json.to_string().replace('"', "");
        let rock = texts(serde_json::to_value(&spec.rock).unwrap());
        assert!(
            rock.contains("porosity:0.2,permeability:100,kv.npy:harmonic,10"),
            "{rock}"
        );
        assert!(
            rock.contains("[amplitude=survey.sgy,depth=z.npy]"),
            "{rock}"
        );
        let faults = texts(serde_json::to_value(&spec.fault_options).unwrap());
        assert!(
            faults.contains("[3:0.5,1/11:0],barriers:1,fault2"),
            "{faults}"
        );
        assert_eq!(spec.grid, Some(GridCounts([10, 20, 3])));
        assert_eq!(
            spec.case.injector[0].place,
            WellPlace::Point([1.0, 2.5, 3.0])
        );
        assert_eq!(spec.case.injector[1].to_string(), "W=way.csv:20");
        for wrong in [
            r#"{"grid": [10, 20]}"#,
            r#"{"case": {"producer": ["1,2,3"]}}"#,
            r#"{"case": {"producer": ["1,2:5"]}}"#,
            r#"{"case": {"producer": ["1,2,3:0"]}}"#,
            r#"{"rock": {"permeability-unit": "darcy"}}"#,
            r#"{"porosity": 0.2}"#,
        ] {
            assert!(
                serde_json::from_str::<ExportSpec>(wrong).is_err(),
                "{wrong}"
            );
        }
    }

    #[test]
    fn options_without_effect_are_refused_by_name() {
        let opm = ExportFormat::from_name("opm").unwrap();
        let case = CaseOptions {
            days: Some(7.0),
            ..CaseOptions::default()
        };
        let spec = ExportSpec {
            case,
            ..ExportSpec::default()
        };
        let error = spec.validate(opm).unwrap_err().to_string();
        assert!(error.starts_with("days 7: has no effect"), "{error}");
        let msh = ExportFormat::from_name("msh").unwrap();
        let error = spec.validate(msh).unwrap_err().to_string();
        assert!(
            error.starts_with("days: the format msh holds no"),
            "{error}"
        );
    }
}
