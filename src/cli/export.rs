//! The verb `export`: a mesh for a reservoir simulator, or for another mesher.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::console::Console;
use super::flow::faults;
use super::parse::{bad, number, point};
use super::rock::RockOptions;
use crate::error::cause;
use crate::export::{FORMATS, Format, read_any_vtu};
use crate::pipeline::{Placement, Prepared};
use crate::reservoir::frame::metres;
use crate::reservoir::{BAR, Case, Checks, Control, DAY, Down, Fluid, Model, Well};
use crate::{Error, Result};

/// `atomesh export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The format
    #[arg(long, value_name = "FORMAT", value_parser = formats())]
    pub to: String,
    /// The file to write, or the folder where a format is many files
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// What fills the cells.
    #[command(flatten, next_help_heading = "Rock")]
    pub rock: RockOptions,
    /// How features resist flow across them: open, closed, or a factor, from 0 to 1, of the
    /// transmissibility there
    #[arg(
        long,
        value_name = "HOW",
        default_value = "open",
        help_heading = "Rock"
    )]
    pub faults: String,
    /// Thickness (m) of the layer that the factor of --faults is for [default: from cell to cell]
    #[arg(long, value_name = "W", help_heading = "Rock")]
    pub fault_thickness: Option<f64>,
    /// Columns along two axes, and layers, of a corner-point grid (grdecl) [default: as fine as the cells]
    #[arg(long, value_name = "NX,NY,NZ")]
    pub grid: Option<String>,
    /// Where depth is.
    #[command(flatten, next_help_heading = "Space")]
    pub space: SpaceOptions,
    /// What happens.
    #[command(flatten, next_help_heading = "Case")]
    pub case: CaseOptions,
}

/// The names of the formats, with what they are.
fn formats() -> PossibleValuesParser {
    let named = |format: &Format| PossibleValue::new(format.name).help(format.what);
    PossibleValuesParser::new(FORMATS.iter().map(named))
}

/// Where a mesh's coordinates are in metres and depth.
#[derive(Debug, Clone, Args)]
pub struct SpaceOptions {
    /// Unit of the mesh's coordinates where the mesh does not say it [default: m]: m, km, ft, cm, mm, um
    #[arg(long, value_name = "UNIT")]
    pub length_unit: Option<String>,
    /// The coordinate that is depth, with its sign: -z if z grows upwards, z if downwards, x ...
    #[arg(
        long,
        value_name = "AXIS",
        default_value = "-z",
        allow_hyphen_values = true
    )]
    pub down: String,
    /// Depth (m) of the mesh's shallowest point [default: as its coordinates have it]
    #[arg(long, value_name = "DEPTH", allow_hyphen_values = true)]
    pub depth_at_top: Option<f64>,
    /// Velocity (m/s) that turns two-way time into depth
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    pub velocity: Option<f64>,
    /// Thickness of a 2-D mesh, in the unit of its coordinates
    #[arg(long, value_name = "T", default_value_t = 1.0)]
    pub thickness: f64,
}

/// What fills the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FluidChoice {
    /// Water only
    Water,
    /// Oil, into which water is injected
    OilWater,
}

/// What happens in a simulation.
#[derive(Debug, Clone, Args)]
pub struct CaseOptions {
    /// What fills the pores
    #[arg(long, value_name = "FLUID", default_value = "water")]
    pub fluid: FluidChoice,
    /// A well that injects water into the cell at X,Y,Z (the mesh's coordinates), in m^3/day; may be
    /// repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:RATE", allow_hyphen_values = true)]
    pub injector: Vec<String>,
    /// A well that produces from the cell at X,Y,Z at a pressure in bar; may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:BAR", allow_hyphen_values = true)]
    pub producer: Vec<String>,
    /// Radius (m) of the wells
    #[arg(long, value_name = "R", default_value_t = 0.1)]
    pub well_radius: f64,
    /// Pressure (bar) at the top at first [default: that of water from the surface down to there, or
    /// 1.01325]
    #[arg(long, value_name = "BAR")]
    pub pressure_at_top: Option<f64>,
    /// Fluids without weight
    #[arg(long)]
    pub no_gravity: bool,
    /// Days that the simulation covers
    #[arg(long, value_name = "DAYS", default_value_t = 3650.0)]
    pub days: f64,
}

impl SpaceOptions {
    /// The options, checked.
    ///
    /// # Errors
    /// [`Error::Job`] for an unknown unit or axis, or numbers that make no sense.
    pub fn placement(&self) -> Result<Placement> {
        let known = |unit: &String| {
            let remedy = "give m, km, ft, cm, mm or um";
            let unknown = || bad("--length-unit", unit, "is no known unit", remedy);
            metres(unit).ok_or_else(unknown)
        };
        let length = self.length_unit.as_ref().map(known).transpose()?;
        let grows = !self.down.starts_with('-');
        let name = self.down.trim_start_matches('-');
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        let axis = axis.ok_or_else(|| {
            let remedy = "give x, y, z, -x, -y or -z";
            bad("--down", &self.down, "is no axis", remedy)
        })?;
        positive("--thickness", self.thickness)?;
        Ok(Placement {
            length,
            down: Down { axis, grows },
            velocity: self.velocity,
            top: self.depth_at_top,
            thickness: self.thickness,
        })
    }
}

fn positive(option: &str, value: f64) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    let problem = "is not a positive number";
    Err(bad(option, &value.to_string(), problem, "give one above 0"))
}

impl CaseOptions {
    /// The case, its wells in cells of the model.
    fn case(&self, prepared: &Prepared) -> Result<Case> {
        positive("--days", self.days)?;
        let model = &prepared.model;
        let mut wells = Vec::new();
        let typed = [
            ("--injector", &self.injector, 'I'),
            ("--producer", &self.producer, 'P'),
        ];
        for (option, texts, letter) in typed {
            for text in texts {
                let (name, rest) = match text.split_once('=') {
                    Some((name, rest)) => (name.to_string(), rest),
                    None => (format!("{letter}{}", wells.len() + 1), text.as_str()),
                };
                let remedy = "give X,Y,Z:VALUE or NAME=X,Y,Z:VALUE";
                let Some((place, value)) = rest.split_once(':') else {
                    return Err(bad(option, text, "has no ':'", remedy));
                };
                let value = number(option, value, remedy)?;
                positive(option, value)?;
                if wells.iter().any(|known: &Well| known.name == name) {
                    return Err(bad(option, text, "has the name of another well", remedy));
                }
                let place = prepared.frame.to_model(point(option, place, remedy)?);
                let cell = model.graph.cell_at(place).ok_or_else(|| {
                    let remedy = "give a point inside, in the mesh's coordinates (`atomesh info` says where it lies)";
                    bad(option, text, "lies outside the mesh", remedy)
                })?;
                let index =
                    model.well_index(&format!("{option} {text}"), cell, self.well_radius)?;
                wells.push(Well {
                    name,
                    cells: vec![(cell as u32, index)],
                    radius: self.well_radius,
                    control: match letter {
                        'I' => Control::Inject(value / DAY),
                        _ => Control::Pressure(value * BAR),
                    },
                });
            }
        }
        let top = (0..model.len()).map(|cell| model.depth(cell));
        let top = top.fold(f64::INFINITY, f64::min);
        let hydrostatic = 1.013_25 * BAR + 1000.0 * crate::reservoir::GRAVITY * top;
        if let Some(bar) = self.pressure_at_top {
            positive("--pressure-at-top", bar)?;
        }
        Ok(Case {
            title: "atomesh".into(),
            fluid: match self.fluid {
                FluidChoice::Water => Fluid::Water,
                FluidChoice::OilWater => Fluid::OilWater,
            },
            gravity: !self.no_gravity,
            top_pressure: self.pressure_at_top.map_or(hydrostatic, |bar| bar * BAR),
            wells,
            duration: self.days * DAY,
        })
    }
}

/// Three numbers of cells.
fn grid(text: &str) -> Result<[usize; 3]> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let counts = numbers.and_then(|n| <[usize; 3]>::try_from(n).ok());
    let fits = |n: &[usize; 3]| n.iter().all(|n| (1..=10_000).contains(n));
    counts.filter(fits).ok_or_else(|| {
        let remedy = "give NX,NY,NZ, each from 1 to 10000";
        bad("--grid", text, "is not three numbers of cells", remedy)
    })
}

/// Depth must grow downwards from the surface.
fn check_depth(model: &Model, space: &SpaceOptions) -> Result<()> {
    let depths = (0..model.len()).map(|cell| model.depth(cell));
    let top = depths.fold(f64::INFINITY, f64::min);
    if top >= 0.0 {
        return Ok(());
    }
    Err(Error::Export(cause(
        format!("--down {}", space.down),
        format!("puts the mesh's top {:.6} m above the surface", -top),
        "give the other sign if that coordinate grows the other way, or --depth-at-top",
    )))
}

/// Runs the verb.
pub fn export(args: &ExportArgs, console: &mut Console) -> Result<()> {
    let format = Format::named(&args.to)?;
    let placement = args.space.placement()?;
    let faults = faults(&args.faults, args.fault_thickness)?;
    format.check_target(&args.output)?;
    let inputs = [Some(args.output.clone()), format.twin_of(&args.output)];
    if inputs
        .iter()
        .flatten()
        .any(|path| same_file(path, &args.mesh))
    {
        return Err(Error::Job(cause(
            args.output.display(),
            "would replace the mesh, itself or by its twin",
            "name another file",
        )));
    }

    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let mut prepared = Prepared::new(read_any_vtu(&args.mesh)?, &place, &placement)?;
    if format.depth {
        check_depth(&prepared.model, &args.space)?;
    }
    if !prepared.features_known {
        console.note(format_args!(
            "{place} does not say which faces lie on features: no faults"
        ));
    }
    console.begin_stage("filling cells");
    if let Some(rock) = args.rock.fill(&mut prepared, console)? {
        prepared.model.set_permeability(rock, faults)?;
    }
    if !(args.case.injector.is_empty() && args.case.producer.is_empty()) || format.depth {
        prepared.model.case = args.case.case(&prepared)?;
    }
    prepared.model.grid = args.grid.as_deref().map(grid).transpose()?;
    console.begin_stage("checking");
    let model = &prepared.model;
    let checks = Checks::new(model, prepared.box_volume);
    checks.notes().iter().for_each(|note| console.note(note));
    console.begin_stage("writing");
    format.write(model, &args.output)?;
    let mut table = checks.table();
    for well in &model.case.wells {
        let (cell, index) = well.cells[0];
        table += &format!(
            "\nwell {:<9} in cell {cell}, index {index:.3e} m^3",
            well.name
        );
    }
    table += &format!("\nwrote {}: {}", args.output.display(), format.what);
    let twin = format.twin_of(&args.output);
    if let Some(twin) = &twin {
        table += &format!(
            "\nwrote {}: the same cells with their shapes",
            twin.display()
        );
    }
    console.result(
        table,
        &json!({
            "format": format.name,
            "file": args.output,
            "twin": twin,
            "checks": checks,
            "wells": model.case.wells.iter().map(|well| {
                json!({ "name": well.name, "cells": well.cells })
            }).collect::<Vec<_>>(),
        }),
    );
    Ok(())
}

/// Whether two paths are one file.
fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
