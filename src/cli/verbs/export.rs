//! The verb `export`: writes a mesh for a reservoir simulator, or for another mesher.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};
use serde_json::json;

use crate::cli::case::{CaseOptions, SpaceOptions, check_depth};
use crate::cli::common::output::path_text;
use crate::cli::console::Console;
use crate::cli::parse::option_error;
use crate::cli::rock::RockOptions;
use crate::error::cause;
use crate::export::{ExportContent, ExportFormat, formats};
use crate::job::well_file::is_well_file;
use crate::model::flow::driver::{BarrierSelection, FaultLaws};
use crate::model::flow::{FaultOptions, FaultResistance};
use crate::model::reservoir::{MeshPlacement, ModelChecks, PreparedModel};
use crate::store::AnyMesh;
use crate::{Error, Result};

/// Arguments of `atomesh export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The format to write
    #[arg(long, value_name = "FORMAT", value_parser = format_names())]
    pub to: String,
    /// The file to write, or the folder for formats with several files
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Options for the rock in the cells.
    #[command(flatten, next_help_heading = "Rock")]
    pub rock: RockOptions,
    /// Options that say how faults resist flow.
    #[command(flatten, next_help_heading = "Faults")]
    pub faults: FaultOptions,
    /// Number of columns along two axes, and of layers, of a corner-point grid (grdecl) [default:
    /// as fine as the cells]
    #[arg(long, value_name = "NX,NY,NZ", help_heading = None)]
    pub grid: Option<String>,
    /// Duplicate the nodes along surfaces and add elements between the two sides (tetrahedra only):
    /// faults, horizons, all, or a list of numbers and names as `atomesh surface MESH` prints them
    #[arg(long, value_name = "WHICH", help_heading = None)]
    pub split: Option<BarrierSelection>,
    /// Add nodes in the middle of edges: elements of second order
    #[arg(long, help_heading = None, conflicts_with = "split")]
    pub quadratic: bool,
    /// Options that convert coordinates to metres and depth.
    #[command(flatten, next_help_heading = "Space")]
    pub space: SpaceOptions,
    /// Options for wells, fluids and the duration of the simulation.
    #[command(flatten, next_help_heading = "Case")]
    pub case: CaseOptions,
}

/// Returns the names of the formats with their descriptions.
fn format_names() -> PossibleValuesParser {
    let named = |format: &ExportFormat| PossibleValue::new(format.name).help(format.description);
    PossibleValuesParser::new(formats().map(named))
}

/// Parses three numbers of cells.
fn parse_grid(text: &str) -> Result<[usize; 3]> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let counts = numbers.and_then(|n| <[usize; 3]>::try_from(n).ok());
    let fits = |n: &[usize; 3]| n.iter().all(|n| (1..=10_000).contains(n));
    counts.filter(fits).ok_or_else(|| {
        let remedy = "give NX,NY,NZ, each from 1 to 10000";
        option_error("--grid", text, "is not three numbers of cells", remedy)
    })
}

/// Returns the error about an option that would have no effect.
fn no_effect_error(option: &str, problem: &str) -> Error {
    Error::Job(cause(option, problem, "omit it"))
}

impl ExportArgs {
    /// Checks that no option is typed that has no effect with the format or the other options.
    fn check_options(&self, format: &ExportFormat, laws: &FaultLaws) -> Result<()> {
        let (rock, case) = (&self.rock, &self.case);
        let typed = [
            (
                "--porosity",
                rock.porosity.is_some(),
                ExportContent::Porosity,
            ),
            ("--region", rock.region.is_some(), ExportContent::Regions),
            (
                "--permeability",
                rock.permeability.is_some(),
                ExportContent::Permeability,
            ),
            (
                "--property",
                !rock.property.is_empty(),
                ExportContent::Properties,
            ),
            (
                "--injector",
                !case.injector.is_empty(),
                ExportContent::Wells,
            ),
            (
                "--producer",
                !case.producer.is_empty(),
                ExportContent::Wells,
            ),
            (
                "--well-radius",
                case.well_radius.is_some(),
                ExportContent::Wells,
            ),
            ("--fluid", case.fluid.is_some(), ExportContent::Fluid),
            (
                "--pressure-at-top",
                case.pressure_at_top.is_some(),
                ExportContent::InitialPressure,
            ),
            ("--no-gravity", case.no_gravity, ExportContent::Gravity),
            ("--days", case.days.is_some(), ExportContent::Duration),
            ("--grid", self.grid.is_some(), ExportContent::Grid),
            ("--split", self.split.is_some(), ExportContent::SplitNodes),
            ("--quadratic", self.quadratic, ExportContent::Quadratic),
        ];
        for (option, _, content) in typed.iter().filter(|typed| typed.1) {
            format.check_content(*content, option)?;
        }
        if let Some(option) = self.faults.given_option() {
            let content = if laws.has_partial_law() {
                ExportContent::Faults
            } else {
                ExportContent::ClosedFaults
            };
            format.check_content(content, option)?;
        }
        let has_rock = rock.permeability.is_some() && rock.porosity.is_some();
        if let Some((option, ..)) = typed
            .iter()
            .find(|typed| typed.1 && typed.2.is_simulation_input())
            .filter(|_| !has_rock && format.case_needs_rock())
        {
            let problem = format!(
                "applies to a simulation deck, which {} writes only if the rock is known",
                format.name
            );
            let remedy = "give --porosity and --permeability, or omit it";
            return Err(Error::Job(cause(*option, problem, remedy)));
        }
        if rock.permeability.is_none() {
            if rock.permeability_unit.is_some() {
                return Err(no_effect_error(
                    "--permeability-unit",
                    "is given without a permeability",
                ));
            }
            if let Some(option) = self.faults.given_option()
                && !format
                    .supported_content
                    .contains(&ExportContent::FaultsWithoutRock)
            {
                let problem =
                    "changes the transmissibility of faults, but no permeability is given";
                return Err(no_effect_error(option, problem));
            }
        }
        let wells = case.injector.iter().chain(&case.producer);
        let is_point = |well: &String| {
            let place = well
                .rsplit_once(':')
                .map_or(well.as_str(), |(place, _)| place);
            !is_well_file(place)
        };
        if case.well_radius.is_some() && !wells.clone().any(is_point) {
            let problem = "is the radius of wells that are given by a point, but there are none";
            return Err(no_effect_error("--well-radius", problem));
        }
        Ok(())
    }
}

/// Runs the verb.
pub fn export(args: &ExportArgs, console: &mut Console) -> Result<()> {
    let format = ExportFormat::from_name(&args.to)?;
    let placement = MeshPlacement {
        keeps_unit: !format.is_flow_format(),
        ..args.space.placement()?
    };
    let laws = args.faults.laws(FaultResistance::Open)?;
    let split = args.split.clone();
    args.check_options(format, &laws)?;
    format.check_target(&args.output)?;
    let outputs = [
        Some(args.output.clone()),
        format.companion_path(&args.output),
    ];
    if outputs
        .iter()
        .flatten()
        .any(|path| same_file(path, &args.mesh))
    {
        return Err(Error::Job(cause(
            args.output.display(),
            "would overwrite the mesh, directly or with its companion VTU",
            "name another file",
        )));
    }

    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let mesh = console.read_mesh(&args.mesh)?;
    let is_3d = matches!(mesh, AnyMesh::Tetrahedra(_) | AnyMesh::Polyhedra(_));
    if args.space.thickness.is_some() && is_3d {
        return Err(no_effect_error(
            "--thickness",
            "is for 2-D meshes, but the mesh is 3-D",
        ));
    }
    let needs_names = format.supported_content.contains(&ExportContent::Names);
    let mut prepared = if needs_names || split.is_some() || args.faults.given_option().is_some() {
        PreparedModel::new(mesh, &place, &placement)?
    } else {
        PreparedModel::without_surfaces(mesh, &place, &placement)?
    };
    if format.uses_depth {
        check_depth(&prepared.model, &args.space)?;
    }
    if !prepared.has_feature_faces {
        console.note(format_args!(
            "{place} does not say which faces lie on features: no faults"
        ));
    }
    console.begin_stage("filling cells");
    let rock = args.rock.fill(&mut prepared, console)?;
    prepared.model.set_faults(&laws)?;
    let inactive = prepared.model.find_inactive(rock.as_ref())?;
    if inactive > 0 {
        console.note(format_args!(
            "{inactive} of {} cells are inactive: their porosity or permeability is 0",
            prepared.model.len()
        ));
    }
    if let Some(rock) = rock {
        prepared.model.set_permeability(rock)?;
    }
    if !(args.case.injector.is_empty() && args.case.producer.is_empty()) || format.uses_depth {
        prepared.model.case = args.case.case(&prepared, console)?;
        let idle = prepared.model.idle_producers();
        idle.iter().for_each(|note| console.note(note));
        let well_notes = prepared.model.notes_on_wells();
        well_notes.iter().for_each(|note| console.note(note));
    }
    prepared.model.is_quadratic = args.quadratic;
    if let Some(selection) = split {
        prepared.model.split_along(selection)?;
    }
    prepared.model.grid = args.grid.as_deref().map(parse_grid).transpose()?;
    console.begin_stage("checking");
    let model = &prepared.model;
    let checks = ModelChecks::new(model, prepared.box_volume);
    if format.is_flow_format() {
        checks.notes().iter().for_each(|note| console.note(note));
        if checks.is_rough() {
            let ratios = prepared.axis_ratios()?;
            let note = ratios.and_then(|ratios| ratios.note());
            note.iter().for_each(|note| console.note(note));
        }
    } else if prepared.unit != "m" {
        let unit = &prepared.unit;
        console.note(format_args!(
            "coordinates are in {unit}, as in the image; --length-unit {unit} writes metres"
        ));
    }
    console.begin_stage("writing");
    let deck = format.deck_path(&args.output);
    format.write(model, &args.output)?;
    let mut table = checks.table(&prepared.unit, format.is_flow_format());
    for well in &model.case.wells {
        let index: f64 = well.cells.iter().map(|c| c.1).sum();
        let place = match well.cells[..] {
            [(cell, _)] => format!("in cell {cell}"),
            _ => {
                let length: f64 = well.lengths.iter().sum();
                format!("{length:.2} m in {} cells", well.cells.len())
            }
        };
        table += &format!("\nwell {:<9} {place}, index {index:.3e} m^3", well.name);
    }
    table += &format!("\nwrote {}: {}", args.output.display(), format.description);
    let default_deck = args.output.with_extension("DATA");
    let has_deck = model.porosity.is_some() && model.permeability.is_some();
    if let Some(deck) = deck.filter(|deck| has_deck && *deck != default_deck) {
        console.note(format_args!(
            "{} is there already and stays as it is: the corner-point grid's deck is {}",
            default_deck.display(),
            deck.display()
        ));
    }
    let companion = format.companion_path(&args.output);
    if let Some(companion) = &companion {
        table += &format!(
            "\nwrote {}: the same cells with their shapes",
            companion.display()
        );
    }
    console.result(
        table,
        &json!({
            "format": format.name,
            "file": path_text(&args.output),
            "twin": companion.as_deref().map(path_text),
            "checks": checks,
            "wells": model.case.wells.iter().map(|well| {
                json!({ "name": well.name, "cells": well.cells, "lengths": well.lengths })
            }).collect::<Vec<_>>(),
        }),
    );
    Ok(())
}

/// Returns `true` if two paths name the same existing file.
fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
