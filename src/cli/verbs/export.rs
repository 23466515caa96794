//! The verb `export`: a mesh for a reservoir simulator, or for another mesher.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Args, ValueEnum};
use serde_json::json;

use crate::cli::common::output::shown;
use crate::cli::console::Console;
use crate::cli::faults::FaultOptions;
use crate::cli::parse::{bad, number, point};
use crate::cli::rock::RockOptions;
use crate::cli::wells::{WellFile, is_well_file};
use crate::error::cause;
use crate::export::{Content, FORMATS, Format};
use crate::mesh::graph::Locator;
use crate::model::flow::through::FaultLaws;
use crate::model::reservoir::frame::metres;
use crate::model::reservoir::{
    BAR, Case, Checks, Completion, Control, DAY, Down, Fluid, Model, Tracer, Trajectory, Well,
};
use crate::model::reservoir::{Placement, Prepared};
use crate::store::{AnyMesh, read_any_vtu};
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
    /// The file to write, or the folder for formats of many files
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// What fills the cells.
    #[command(flatten, next_help_heading = "Rock")]
    pub rock: RockOptions,
    /// How faults resist flow.
    #[command(flatten, next_help_heading = "Faults")]
    pub faults: FaultOptions,
    /// Columns along two axes, and layers, of a corner-point grid (grdecl) [default: as fine as the
    /// cells]
    #[arg(long, value_name = "NX,NY,NZ", help_heading = None)]
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
    /// Unit of the mesh's coordinates, where the mesh does not state it [default: m]: m, km, ft,
    /// cm, mm, um
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
    /// Depth (m) of the mesh's shallowest point [default: by its coordinates]
    #[arg(long, value_name = "DEPTH", allow_hyphen_values = true)]
    pub depth_at_top: Option<f64>,
    /// Velocity (m/s) that turns two-way time into depth
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    pub velocity: Option<f64>,
    /// Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    #[arg(long, value_name = "T")]
    pub thickness: Option<f64>,
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
    /// What fills the pores [default: water]
    #[arg(long, value_name = "FLUID")]
    pub fluid: Option<FluidChoice>,
    /// A well that injects water, in m^3/day, vertical in the cell at X,Y,Z (the mesh's
    /// coordinates), or along the trajectory in a CSV file of lines x,y,z,radius:
    /// [NAME=]FILE.csv:RATE; may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:RATE", allow_hyphen_values = true)]
    pub injector: Vec<String>,
    /// A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a file; may
    /// be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:BAR", allow_hyphen_values = true)]
    pub producer: Vec<String>,
    /// Radius (m) of wells that are given by a point [default: 0.1]
    #[arg(long, value_name = "R")]
    pub well_radius: Option<f64>,
    /// Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    #[arg(long, value_name = "BAR")]
    pub pressure_at_top: Option<f64>,
    /// Fluids without weight (no hydrostatic gradient)
    #[arg(long)]
    pub no_gravity: bool,
    /// Number of days to simulate [default: 3650]
    #[arg(long, value_name = "DAYS")]
    pub days: Option<f64>,
}

impl SpaceOptions {
    /// The options, checked.
    ///
    /// # Errors
    /// [`Error::Job`] for an unknown unit or axis, or numbers that make no sense.
    pub fn placement(&self) -> Result<Placement> {
        let known = |unit: &String| {
            let remedy = "give m, km, ft, cm, mm or um";
            let unknown = || bad("--length-unit", unit, "is not a known unit", remedy);
            metres(unit).ok_or_else(unknown)
        };
        let length = self.length_unit.as_ref().map(known).transpose()?;
        let grows = !self.down.starts_with('-');
        let name = self.down.trim_start_matches('-');
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        let axis = axis.ok_or_else(|| {
            let remedy = "give x, y, z, -x, -y or -z";
            bad("--down", &self.down, "is not an axis", remedy)
        })?;
        if let Some(thickness) = self.thickness {
            positive("--thickness", thickness)?;
        }
        Ok(Placement {
            length,
            down: Down { axis, grows },
            velocity: self.velocity,
            top: self.depth_at_top,
            thickness: self.thickness.unwrap_or(1.0),
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
    fn case(&self, prepared: &Prepared, console: &Console) -> Result<Case> {
        let days = self.days.unwrap_or(3650.0);
        positive("--days", days)?;
        let radius = self.well_radius.unwrap_or(0.1);
        positive("--well-radius", radius)?;
        let model = &prepared.model;
        let mut wells: Vec<Well> = Vec::new();
        let (tracer, locator) = (OnceCell::new(), OnceCell::new());
        let typed = [
            ("--injector", &self.injector, 'I'),
            ("--producer", &self.producer, 'P'),
        ];
        for (option, texts, letter) in typed {
            for text in texts {
                let (name, rest) = match text.split_once('=') {
                    Some((name, rest)) => (Some(name.to_string()), rest),
                    None => (None, text.as_str()),
                };
                let remedy = "give X,Y,Z:VALUE or FILE.csv:VALUE, with NAME= before it or not";
                let Some((place, value)) = rest.rsplit_once(':') else {
                    return Err(bad(option, text, "has no ':'", remedy));
                };
                let value = number(option, value, remedy)?;
                positive(option, value)?;
                let called = format!("{option} {text}");
                let tracer = tracer.get_or_init(|| Tracer::new(model));
                let (own_name, radius, way, completions) = if is_well_file(place) {
                    along_file(place, called, tracer, prepared, console)?
                } else {
                    let point = prepared.frame.to_model(point(option, place, remedy)?);
                    let locator = locator.get_or_init(|| Locator::new(&model.graph));
                    let cell = locator.cell_at(point).ok_or_else(|| {
                        let remedy = "give a point inside, in the mesh's coordinates (`atomesh info` shows its extent)";
                        bad(option, text, "lies outside the mesh", remedy)
                    })?;
                    let own_name = format!("{letter}{}", wells.len() + 1);
                    (
                        own_name,
                        radius,
                        vec![point],
                        tracer.complete_cell(&called, cell, radius)?,
                    )
                };
                let name = name.unwrap_or(own_name);
                if wells.iter().any(|known| known.name == name) {
                    return Err(bad(
                        option,
                        text,
                        "has the same name as another well",
                        remedy,
                    ));
                }
                wells.push(Well {
                    name,
                    cells: completions.iter().map(|c| (c.cell, c.index)).collect(),
                    lengths: completions.iter().map(|c| c.length).collect(),
                    radius,
                    way,
                    control: match letter {
                        'I' => Control::Inject(value / DAY),
                        _ => Control::Pressure(value * BAR),
                    },
                });
            }
        }
        let top = (0..model.len()).map(|cell| model.depth(cell));
        let top = top.fold(f64::INFINITY, f64::min);
        let hydrostatic = 1.013_25 * BAR + 1000.0 * crate::model::reservoir::GRAVITY * top;
        if let Some(bar) = self.pressure_at_top {
            positive("--pressure-at-top", bar)?;
        }
        Ok(Case {
            title: "atomesh".into(),
            fluid: match self.fluid.unwrap_or(FluidChoice::Water) {
                FluidChoice::Water => Fluid::Water,
                FluidChoice::OilWater => Fluid::OilWater,
            },
            gravity: !self.no_gravity,
            top_pressure: self.pressure_at_top.map_or(hydrostatic, |bar| bar * BAR),
            wells,
            duration: days * DAY,
        })
    }
}

/// Name, radius at its first point, way and completions of a well along the way in a file.
fn along_file(
    path: &str,
    called: String,
    tracer: &Tracer,
    prepared: &Prepared,
    console: &Console,
) -> Result<(String, f64, Vec<[f64; 3]>, Vec<Completion>)> {
    let file = WellFile::<3>::read(Path::new(path), 2)?;
    let frame = &prepared.frame;
    let points = file.points.iter();
    let way = Trajectory {
        name: called,
        points: points.clone().map(|p| frame.to_model(p.1)).collect(),
        radii: points.map(|p| p.2 * frame.across()).collect(),
    };
    let completions = tracer.complete(&way)?;
    let (all, inside) = (
        way.length(),
        completions.iter().map(|c| c.length).sum::<f64>(),
    );
    if inside < (1.0 - 1e-6) * all {
        console.note(format_args!(
            "{path}: {inside:.2} of the well's {all:.2} m lie in the mesh"
        ));
    }
    Ok((file.name, way.radii[0], way.points, completions))
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
        format!("puts the mesh's top {:.6} m above depth 0", -top),
        "give the other sign if that coordinate grows the other way, or --depth-at-top",
    )))
}

/// An option that would change nothing.
fn refuse(option: &str, problem: &str) -> Error {
    Error::Job(cause(option, problem, "omit it"))
}

impl ExportArgs {
    /// No option is typed that the format, or what else is typed, leaves without effect.
    fn check_options(&self, format: &Format, laws: &FaultLaws) -> Result<()> {
        let (rock, case) = (&self.rock, &self.case);
        let typed = [
            ("--porosity", rock.porosity.is_some(), Content::Porosity),
            ("--region", rock.region.is_some(), Content::Regions),
            (
                "--permeability",
                rock.permeability.is_some(),
                Content::Permeability,
            ),
            ("--property", !rock.property.is_empty(), Content::Properties),
            ("--injector", !case.injector.is_empty(), Content::Wells),
            ("--producer", !case.producer.is_empty(), Content::Wells),
            ("--well-radius", case.well_radius.is_some(), Content::Wells),
            ("--fluid", case.fluid.is_some(), Content::Fluid),
            (
                "--pressure-at-top",
                case.pressure_at_top.is_some(),
                Content::Pressure,
            ),
            ("--no-gravity", case.no_gravity, Content::Gravity),
            ("--days", case.days.is_some(), Content::Duration),
            ("--grid", self.grid.is_some(), Content::Grid),
        ];
        for (option, _, content) in typed.iter().filter(|typed| typed.1) {
            format.check_holds(*content, option)?;
        }
        if let Some(option) = self.faults.typed() {
            let content = match laws.any_between() {
                true => Content::Faults,
                false => Content::ClosedFaults,
            };
            format.check_holds(content, option)?;
        }
        let has_rock = rock.permeability.is_some() && rock.porosity.is_some();
        if let Some((option, ..)) = typed
            .iter()
            .find(|typed| typed.1 && typed.2.is_of_a_case())
            .filter(|_| !has_rock && format.case_needs_rock())
        {
            let problem = format!(
                "is of a deck, and {} writes one only for a known rock",
                format.name
            );
            let remedy = "give --porosity and --permeability, or omit it";
            return Err(Error::Job(cause(*option, problem, remedy)));
        }
        if rock.permeability.is_none() {
            if rock.permeability_unit.is_some() {
                return Err(refuse(
                    "--permeability-unit",
                    "is given without a permeability",
                ));
            }
            if let Some(option) = self.faults.typed()
                && !format.holds.contains(&Content::BareFaults)
            {
                let problem =
                    "changes the transmissibility of faults, but no permeability is given";
                return Err(refuse(option, problem));
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
            return Err(refuse("--well-radius", problem));
        }
        Ok(())
    }
}

/// Runs the verb.
pub fn export(args: &ExportArgs, console: &mut Console) -> Result<()> {
    let format = Format::named(&args.to)?;
    let placement = args.space.placement()?;
    let laws = args.faults.laws("open")?;
    args.check_options(format, &laws)?;
    format.check_target(&args.output)?;
    let inputs = [Some(args.output.clone()), format.twin_of(&args.output)];
    if inputs
        .iter()
        .flatten()
        .any(|path| same_file(path, &args.mesh))
    {
        return Err(Error::Job(cause(
            args.output.display(),
            "would replace the mesh, by itself or by the VTU beside it",
            "name another file",
        )));
    }

    console.begin_stage("reading");
    let place = args.mesh.display().to_string();
    let mesh = read_any_vtu(&args.mesh)?;
    let in_space = matches!(mesh, AnyMesh::Space(_) | AnyMesh::SpaceCells(_));
    if args.space.thickness.is_some() && in_space {
        return Err(refuse(
            "--thickness",
            "is for 2-D meshes, but the mesh is 3-D",
        ));
    }
    let mut prepared = Prepared::new(mesh, &place, &placement)?;
    if format.depth {
        check_depth(&prepared.model, &args.space)?;
    }
    if !prepared.features_known {
        console.note(format_args!(
            "{place} does not say which faces lie on features: no faults"
        ));
    }
    console.begin_stage("filling cells");
    prepared.model.set_faults(&laws)?;
    if let Some(rock) = args.rock.fill(&mut prepared, console)? {
        prepared.model.set_permeability(rock)?;
    }
    if !(args.case.injector.is_empty() && args.case.producer.is_empty()) || format.depth {
        prepared.model.case = args.case.case(&prepared, console)?;
        let idle = prepared.model.idle_producers();
        idle.iter().for_each(|note| console.note(note));
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
            "file": shown(&args.output),
            "twin": twin.as_deref().map(shown),
            "checks": checks,
            "wells": model.case.wells.iter().map(|well| {
                json!({ "name": well.name, "cells": well.cells, "lengths": well.lengths })
            }).collect::<Vec<_>>(),
        }),
    );
    Ok(())
}

/// Whether two paths are one file.
fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
