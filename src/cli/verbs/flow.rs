//! The verb `flow`: computes steady pressure and flow from sources to sinks.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::depth::{mesh_in_depth, warn_if_time};
use crate::cli::common::output::check_output;
use crate::cli::console::Console;
use crate::cli::faults::FaultOptions;
use crate::cli::interrupts::Interrupts;
use crate::cli::parse::{number, option_error};
use crate::error::cause;
use crate::files::csv::values_by_region;
use crate::job::spec::NumberOrFile;
use crate::job::{MeshSpace, Meshing};
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::model::flow::driver::{
    BoundaryConditions, FaultLaws, FlowOutcome, SIDE_NAMES, barriers, flow_through_cells,
    flow_through_elements,
};
use crate::model::flow::report::FlowReport;
use crate::model::flow::{Barriers, PointWell, Rock, Streamlines, Tensor};
use crate::store::{MeshFile, Storable, StoredMesh, with_mesh};
use crate::{Error, Result, memory};

/// Arguments of `atomesh flow`.
#[derive(Debug, Args)]
pub struct FlowArgs {
    /// A mesh written by atomesh; its coordinates are assumed to be in metres
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, split along faults, with pressure (Pa) and Darcy velocity (m/s)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// A point (X,Y in 2-D) where fluid enters, with its rate in m^3/s [default rate: 0.001]; may
    /// be repeated
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub source: Vec<String>,
    /// A point where fluid leaves [default rate: all that enters, or 0.001 with --pressure]; may be
    /// repeated
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub sink: Vec<String>,
    /// Pressure (Pa) on a side of the box: xmin, xmax, ymin ... along the image's axes, x the
    /// fastest in memory. Sides without a pressure are closed
    #[arg(long, value_name = "SIDE=P")]
    pub pressure: Vec<String>,
    /// Options that say how faults resist flow.
    #[command(flatten)]
    pub faults: FaultOptions,
    /// Permeability in m^2 (1 mD is 9.87e-16 m^2): K; KX,KY,KZ; KXX,KYY,KZZ,KXY,KYZ,KXZ (in 2-D K;
    /// KX,KY; KXX,KYY,KXY); a CSV file of lines region,K; or a cell array of the mesh
    #[arg(
        long,
        value_name = "K",
        default_value = "1e-13",
        allow_hyphen_values = true
    )]
    pub permeability: String,
    /// Convert two-way time to depth in metres, with one velocity in m/s or a file of interval
    /// velocities in m/s on a grid in two-way time. Sources and sinks are then in depth
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Viscosity in Pa s
    #[arg(
        long,
        value_name = "MU",
        default_value_t = 0.001,
        allow_hyphen_values = true
    )]
    pub viscosity: f64,
    /// Also write streamlines that carry equal rates, for ParaView
    #[arg(long, value_name = "FILE.vtp")]
    pub streamlines: Option<PathBuf>,
    /// Number of streamlines [default: 200]
    #[arg(long, value_name = "N")]
    pub lines: Option<usize>,
}

impl FlowArgs {
    /// Checks that no output replaces an input or the other output.
    fn check_files(&self) -> Result<()> {
        let mut inputs = vec![self.mesh.as_path(), Path::new(&self.permeability)];
        inputs.extend(self.faults.fault_multiplier.iter().map(Path::new));
        check_output(&self.output, "--output", &["vtu"], &inputs)?;
        inputs.push(&self.output);
        match &self.streamlines {
            Some(path) => check_output(path, "--streamlines", &["vtp"], &inputs),
            None => Ok(()),
        }
    }

    /// Checks that no option is typed that has no effect with the others.
    fn check_options(&self) -> Result<()> {
        if self.lines.is_some() && self.streamlines.is_none() {
            let problem = "is the number of streamlines, but none are to be written";
            return Err(Error::Job(cause("--lines", problem, "omit it")));
        }
        if let Some(lines) = self.lines {
            let task = format!("{lines} streamlines");
            memory::ensure_available("--lines", 4e3 * lines as f64, task, "ask for fewer")?;
        }
        Ok(())
    }
}

/// Rate in m^3/s of a source or sink whose rate is not given.
const DEFAULT_RATE: f64 = 1e-3;

/// Default number of streamlines.
const DEFAULT_LINE_COUNT: usize = 200;

/// Runs the verb.
pub fn flow(args: &FlowArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let input = FlowInput {
        args,
        interrupts,
        wells: WellInput::parse_all(args)?,
        sides: parse_sides(&args.pressure)?,
        laws: args.faults.laws("closed")?,
    };
    args.check_files()?;
    args.check_options()?;
    console.begin_stage("reading");
    let report = with_mesh!(console.read_mesh(&args.mesh)?,
        simplices file => input.solve_simplices(file, console),
        cells file => input.solve_cells(file, console)
    )?;
    console.result(
        format_args!("{}\nwrote {}", report.table(), args.output.display()),
        &json!(report),
    );
    Ok(())
}

/// The parsed arguments, as far as they do not depend on the mesh.
struct FlowInput<'a> {
    args: &'a FlowArgs,
    interrupts: &'a Interrupts,
    wells: Vec<WellInput>,
    sides: Vec<(u8, f64)>,
    laws: FaultLaws,
}

impl FlowInput<'_> {
    fn solve_simplices<const D: usize, M: Simplices<D>>(
        &self,
        file: MeshFile<M>,
        console: &mut Console,
    ) -> Result<FlowReport> {
        let args = self.args;
        let mut stored = check_mesh(args, file, console)?;
        warn_if_time(&stored.space.geometry, console);
        let rock = cell_mobility(args, &stored)?;
        let conditions = self.conditions()?;
        let barriers = self.barriers(&mut stored, console)?;
        console.begin_stage("computing pressure");
        let lines = args
            .streamlines
            .as_ref()
            .map(|_| args.lines.unwrap_or(DEFAULT_LINE_COUNT));
        let outcome = self.interrupts.run_until_interrupted(console, |cancel| {
            flow_through_elements(stored, rock, &barriers, &conditions, lines, cancel)
        })?;
        self.write(outcome, console)
    }

    /// Computes flow through Voronoi cells (or other polyhedra or polygons).
    fn solve_cells<const D: usize>(
        &self,
        file: MeshFile<PolyMesh<D>>,
        console: &mut Console,
    ) -> Result<FlowReport>
    where
        MeshSpace<D>: Meshing<D>,
    {
        let args = self.args;
        let mut stored = check_mesh(args, file, console)?;
        warn_if_time(&stored.space.geometry, console);
        let rock = cell_mobility(args, &stored)?;
        let conditions = self.conditions()?;
        let barriers = self.barriers(&mut stored, console)?;
        console.begin_stage("computing pressure");
        let lines = args
            .streamlines
            .as_ref()
            .map(|_| args.lines.unwrap_or(DEFAULT_LINE_COUNT));
        let (outcome, notes) = self.interrupts.run_until_interrupted(console, |cancel| {
            flow_through_cells(stored, &rock, &barriers, &conditions, lines, cancel)
        })?;
        notes.iter().for_each(|note| console.note(note));
        self.write(outcome, console)
    }

    fn write<const D: usize, M: Storable<D>>(
        &self,
        outcome: FlowOutcome<D, M>,
        console: &mut Console,
    ) -> Result<FlowReport> {
        console.begin_stage("writing");
        if let (Some(path), Some(lines)) = (&self.args.streamlines, &outcome.streamlines) {
            Streamlines::write(lines, path)?;
        }
        console.write_mesh(&self.args.output, outcome.file)?;
        Ok(outcome.report)
    }

    /// Returns the wells and side pressures, checked for a mesh of dimension `D`.
    fn conditions<const D: usize>(&self) -> Result<BoundaryConditions<D>> {
        let well = |well: &WellInput| {
            let position = well.position.as_slice().try_into().map_err(|_| {
                let problem = format!("has {} coordinates, the mesh {D}", well.position.len());
                Error::Flow(cause(&well.name, problem, "give as many"))
            })?;
            Ok(PointWell {
                name: well.name.clone(),
                position,
                rate: well.rate,
            })
        };
        if let Some(side) = self.sides.iter().find(|side| usize::from(side.0) >= 2 * D) {
            let place = format!("--pressure {}={}", SIDE_NAMES[usize::from(side.0)], side.1);
            let problem = format!("names a side that a {D}-D mesh does not have");
            let remedy = format!("give one of {}", SIDE_NAMES[..2 * D].join(", "));
            return Err(Error::Flow(cause(place, problem, remedy)));
        }
        Ok(BoundaryConditions {
            wells: self.wells.iter().map(well).collect::<Result<_>>()?,
            sides: self.sides.clone(),
        })
    }

    fn barriers<const D: usize, M: Storable<D>>(
        &self,
        stored: &mut StoredMesh<D, M>,
        console: &mut Console,
    ) -> Result<Barriers> {
        let laws = &self.laws;
        if laws.law.is_open() && laws.overrides.is_empty() {
            return Ok(Barriers::default());
        }
        let place = self.args.mesh.display();
        match stored.feature_marks() {
            Some(marks) => {
                console.begin_stage("grouping faces into faults");
                let (barriers, idle) = barriers(stored, &marks, laws)?;
                if idle {
                    console.note(format_args!(
                        "{place} has surfaces, but no faults, so that nothing resists flow; --barriers says which surfaces resist"
                    ));
                }
                Ok(barriers)
            }
            None if self.args.faults.faults.is_some() || !laws.overrides.is_empty() => {
                Err(Error::Flow(cause(
                    place,
                    "does not say which of its faces lie on features",
                    "give a mesh that atomesh mesh wrote, or --faults open",
                )))
            }
            None => {
                console.note(format_args!(
                    "{place} does not say which faces lie on features: no faults"
                ));
                Ok(Barriers::default())
            }
        }
    }
}

/// Reads a mesh, in depth if a velocity is given, and checks that its cells fill it.
fn check_mesh<const D: usize, M: Storable<D>>(
    args: &FlowArgs,
    file: MeshFile<M>,
    console: &Console,
) -> Result<StoredMesh<D, M>> {
    let place = args.mesh.display().to_string();
    let stored = mesh_in_depth(file, args.velocity.as_ref(), &place, console)?;
    stored.check_filled(&place)?;
    Ok(stored)
}

/// Parses `SIDE=P`: sides of the box with their pressures.
fn parse_sides(texts: &[String]) -> Result<Vec<(u8, f64)>> {
    let mut sides: Vec<(u8, f64)> = Vec::new();
    for text in texts {
        let remedy = "give a side and its pressure, such as xmin=1e7";
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| option_error("--pressure", text, "has no '='", remedy))?;
        let side = SIDE_NAMES.iter().position(|side| *side == name.trim());
        let side = side.ok_or_else(|| {
            let problem = format!("'{name}' is not a side of the box");
            let remedy = format!("give one of {}", SIDE_NAMES.join(", "));
            option_error("--pressure", text, &problem, &remedy)
        })? as u8;
        if sides.iter().any(|known| known.0 == side) {
            return Err(option_error(
                "--pressure",
                text,
                "is given twice",
                "give it once",
            ));
        }
        sides.push((side, number("--pressure", value, remedy)?));
    }
    Ok(sides)
}

/// A source or sink, with as many coordinates as were typed.
struct WellInput {
    name: String,
    position: Vec<f64>,
    rate: f64,
}

impl WellInput {
    /// Parses all sources, then all sinks.
    fn parse_all(args: &FlowArgs) -> Result<Vec<Self>> {
        let mut wells = Vec::new();
        let mut without_rate = Vec::new();
        let typed = [
            ("--source", &args.source, 1.0),
            ("--sink", &args.sink, -1.0),
        ];
        for (option, texts, sign) in typed {
            for text in texts {
                let (position, rate) = parse_well(option, text)?;
                if rate.is_none() && sign < 0.0 && args.pressure.is_empty() {
                    without_rate.push(wells.len());
                }
                wells.push(Self {
                    name: format!("{option} {text}"),
                    position,
                    rate: sign * rate.unwrap_or(DEFAULT_RATE),
                });
            }
        }
        // Sinks without a rate share the rate of the sources. With side pressures this is not
        // needed, as they balance any difference.
        let has_rate = |i: &usize| !without_rate.contains(i);
        let net_rate: f64 = (0..wells.len())
            .filter(has_rate)
            .map(|i| wells[i].rate)
            .sum();
        for &i in &without_rate {
            if net_rate <= 0.0 {
                let problem = format!("has no rate, and the others leave {net_rate} m^3/s for it");
                let remedy = "give it a rate, or the sources a larger one";
                return Err(Error::Flow(cause(&wells[i].name, problem, remedy)));
            }
            wells[i].rate = -net_rate / without_rate.len() as f64;
        }
        if wells.is_empty() && args.pressure.is_empty() {
            return Err(Error::Flow(cause(
                "flow",
                "nothing makes fluid flow",
                "give --source and --sink, or --pressure of two sides",
            )));
        }
        Ok(wells)
    }
}

/// Parses `X,Y,Z` or `X,Y,Z:RATE` (in the plane without Z).
fn parse_well(option: &str, text: &str) -> Result<(Vec<f64>, Option<f64>)> {
    let remedy = "give X,Y,Z or X,Y,Z:RATE, such as 120,80,40:0.001";
    let (place, rate) = match text.split_once(':') {
        Some((place, rate)) => (place, Some(number(option, rate, remedy)?)),
        None => (text, None),
    };
    if rate.is_some_and(|rate| rate <= 0.0) {
        let remedy = "give a positive rate: --sink takes fluid out";
        return Err(option_error(
            option,
            text,
            "has a rate that is not positive",
            remedy,
        ));
    }
    let position = place.split(',').map(|word| number(option, word, remedy));
    Ok((position.collect::<Result<_>>()?, rate))
}

/// Returns the mobility of every cell, from numbers, a file by region, or an array of the mesh.
fn cell_mobility<const D: usize, M: Storable<D>>(
    args: &FlowArgs,
    stored: &StoredMesh<D, M>,
) -> Result<Rock> {
    let (text, viscosity) = (&args.permeability, args.viscosity);
    if !(viscosity > 0.0 && viscosity.is_finite()) {
        let remedy = "give Pa s: water has 0.001";
        let problem = "is not a positive number";
        return Err(option_error(
            "--viscosity",
            &viscosity.to_string(),
            problem,
            remedy,
        ));
    }
    let remedy = match D {
        2 => "give K, or KX,KY, or KXX,KYY,KXY, positive definite, in m^2",
        _ => "give K, or KX,KY,KZ, or KXX,KYY,KZZ,KXY,KYZ,KXZ, positive definite, in m^2",
    };
    let refuse = |problem: &str| option_error("--permeability", text, problem, remedy);
    let numbers: std::result::Result<Vec<f64>, _> =
        text.split(',').map(|word| word.trim().parse()).collect();
    if let Ok(numbers) = numbers {
        let tensor = Tensor::from_components::<D>(&numbers);
        let tensor = tensor.ok_or_else(|| refuse("is not a permeability"))?;
        return Ok(Rock::uniform(tensor, viscosity));
    }
    if let Some(array) = stored.arrays.cell_array(text) {
        return Rock::by_cell::<D>(&array.values.to_f64(), array.components, viscosity);
    }
    let path = Path::new(text);
    if !path.exists() {
        let arrays = stored.arrays.cell_data.iter();
        let names: Vec<&str> = arrays.map(|array| array.name.as_str()).collect();
        return Err(refuse(&format!(
            "is neither a number nor a file nor a cell array of the mesh (it has {})",
            names.join(", ")
        )));
    }
    let lines = "write region,K or region,KX,KY,KZ, in m^2";
    let by_region = values_by_region(path, Tensor::from_components::<D>, lines)?;
    let regions = stored.regions().ok_or_else(|| {
        refuse(
            "is given by region, but the mesh has no cell array 'region': give one value for all",
        )
    })?;
    Rock::by_region(&regions, &by_region, viscosity)
}
