//! `atomesh flow`: steady pressure and flow from sources to sinks.

use std::path::Path;

use serde_json::{Value, json};

use super::args::FlowArgs;
use super::console::Console;
use super::parse::{bad, by_region, number};
use crate::error::cause;
use crate::export::polyhedra::write_cells_vtu;
use crate::export::{AnyMesh, FieldValue, MeshFile, read_any_vtu, write_vtu};
use crate::flow::split::FaultFace;
use crate::flow::{CellFlow, Faults, Figures, Rock, Solution, Streamlines, Tensor, TetFlow, Well};
use crate::io::check_target;
use crate::io::vtk::DataArray;
use crate::mesh::TetMesh;
use crate::mesh::graph::Graph;
use crate::mesh::poly::{PolyMesh, SIDES};
use crate::pipeline::file::Placed;
use crate::report::Measured;
use crate::{Error, Result};

/// Rate in m^3/s of a source for which none is given.
const RATE: f64 = 1e-3;
/// How near a side, in parts of the box, its nodes lie.
const ON_SIDE: f64 = 1e-7;

/// Runs the verb.
pub fn flow(args: &FlowArgs, console: &mut Console) -> Result<()> {
    let conditions = Conditions::new(args)?;
    let how = args.faults.as_deref().unwrap_or("closed");
    let faults = faults(how, args.fault_thickness)?;
    check_target(&args.output)?;
    args.streamlines.as_deref().map_or(Ok(()), check_target)?;
    console.begin_stage("reading");
    let (table, json) = match read_any_vtu(&args.mesh)? {
        AnyMesh::Space(file) => through_tetrahedra(args, file, &conditions, faults, console)?,
        AnyMesh::SpaceCells(file) => through_cells(args, file, &conditions, faults, console)?,
        AnyMesh::PlaneCells(file) => through_cells(args, file, &conditions, faults, console)?,
        AnyMesh::Plane(_) => {
            return Err(Error::Flow(cause(
                args.mesh.display(),
                "is of triangles, through which no flow is computed",
                "mesh the image with --align alongside --cells voronoi",
            )));
        }
    };
    console.result(
        format_args!("{table}\nwrote {}", args.output.display()),
        &json,
    );
    Ok(())
}

fn through_tetrahedra(
    args: &FlowArgs,
    file: MeshFile,
    conditions: &Conditions,
    faults: Faults,
    console: &mut Console,
) -> Result<(String, Value)> {
    let place = args.mesh.display().to_string();
    let [point_data, cell_data] = [file.point_data.clone(), file.cell_data.clone()];
    let field_data = file.field_data.clone();
    let placed = Placed::new(file, &place)?;
    let regions = cell_data.iter().find(|array| array.name == "region");
    let rock = rock(args, &cell_data, regions.map(|array| array.values.to_i64()))?;
    let feature_faces = match cell_data.iter().find(|a| a.name == TetMesh::FEATURE_FACES) {
        Some(array) => {
            let bits = array.values.to_i64();
            bits.into_iter().map(|bits| bits as u8).collect()
        }
        None if args.faults.is_some() && !faults.are_open() => {
            return Err(Error::Flow(cause(
                &place,
                "does not say which of its faces lie on features",
                "give a mesh that atomesh mesh wrote, or --faults open",
            )));
        }
        None => {
            console.note(format_args!(
                "{place} does not say which faces lie on features: no faults"
            ));
            Vec::new()
        }
    };

    console.begin_stage("computing pressure");
    let flow = TetFlow::new(&placed.physical, &feature_faces, rock, faults)?;
    let wells = conditions.wells_in()?;
    let located = flow.locate(&wells)?;
    let (fixed, sides) = conditions.fixed(&flow, &placed);
    let found = flow.solve(&flow.rates(&located), &fixed)?;

    let p = &found.pressure;
    let jump = |face: &FaultFace| {
        let [a, b] = face.nodes;
        let jumps = a
            .iter()
            .zip(b)
            .map(|(&a, b)| (p[a as usize] - p[b as usize]).abs());
        jumps.fold(0.0, f64::max)
    };
    let mut side_rates = [0.0; 6];
    for (&(node, _), &side) in fixed.iter().zip(&sides) {
        side_rates[side] += found.inflow[node as usize];
    }
    let nodes = flow.split.original.iter().zip(0u32..);
    let summary = Summary {
        figures: found.figures,
        pressure: range(p),
        doubled: nodes.filter(|(from, node)| *from != node).count(),
        fault_faces: flow.split.faces.len(),
        across_faults: flow.fault_rates(p).iter().map(|rate| rate.abs()).sum(),
        largest_jump: flow.split.faces.iter().map(jump).fold(0.0, f64::max),
        exchange: conditions.exchange(&side_rates),
    };

    if let Some(path) = &args.streamlines {
        console.begin_stage("tracing streamlines");
        let rates = flow.face_rates(p, &located, &fixed)?;
        let positions: Vec<[f64; 3]> = wells.iter().map(|well| well.position).collect();
        let mesh = &flow.split.mesh;
        Streamlines::trace(mesh, &rates, &located, &positions, args.lines).write(path)?;
    }
    console.begin_stage("writing");
    let json = summary.json();
    let file = to_file(flow, &found, point_data, cell_data, field_data, &json);
    write_vtu(&args.output, &file)?;
    Ok((summary.table(), json))
}

/// Through Voronoi cells (or any polyhedra or polygons).
fn through_cells<const D: usize>(
    args: &FlowArgs,
    mut file: MeshFile<PolyMesh<D>>,
    conditions: &Conditions,
    faults: Faults,
    console: &mut Console,
) -> Result<(String, Value)> {
    if args.streamlines.is_some() {
        return Err(Error::Flow(cause(
            args.mesh.display(),
            "is of Voronoi cells, through which no streamlines are traced",
            "leave out --streamlines, or mesh the image with tetrahedra",
        )));
    }
    let place = args.mesh.display().to_string();
    let regions = file
        .mesh
        .region
        .iter()
        .map(|&region| i64::from(region))
        .collect();
    let rock = rock(args, &file.cell_data, Some(regions))?;
    let placed = Placed::cells(file.clone(), &place)?;

    console.begin_stage("computing pressure");
    let graph = Graph::from_poly(&placed.physical);
    let flow = CellFlow::new(&graph, &rock, faults)?;
    if flow.angle_error > 1.0 {
        console.note(format_args!(
            "the lines between cells are {:.0} degrees off square to the permeability times their \
             faces' normals, on average: two-point fluxes are rough",
            flow.angle_error
        ));
    }
    let wells = conditions.wells_in()?;
    let sides: Vec<(u8, f64)> = conditions
        .sides
        .iter()
        .map(|&(s, p)| (s as u8, p))
        .collect();
    let cells = graph.volume.len();
    let found = flow.solve(&flow.well_rates(&wells)?, &sides)?;
    let (p, of_sides) = found.pressure.split_at(cells);
    let rates = flow.rates(p, &sides);
    let mut side_rates = [0.0; 6];
    for (&(side, _), at) in sides.iter().zip(cells..cells + of_sides.len()) {
        side_rates[usize::from(side)] = found.inflow[at];
    }
    let on_faults = || {
        graph
            .connections
            .iter()
            .zip(&rates.connections)
            .filter(|c| c.0.on_feature)
    };
    let jump = |c: [u32; 2]| (p[c[0] as usize] - p[c[1] as usize]).abs();
    let summary = Summary {
        figures: found.figures,
        pressure: range(p),
        doubled: 0,
        fault_faces: on_faults().count(),
        across_faults: on_faults().map(|(_, rate)| rate.abs()).sum(),
        largest_jump: on_faults().map(|(c, _)| jump(c.cells)).fold(0.0, f64::max),
        exchange: conditions.exchange(&side_rates),
    };
    console.begin_stage("writing");
    let json = summary.json();
    let in_space = |v: &[f64; D]| [0, 1, 2].map(|k| if k < D { v[k] } else { 0.0 });
    let velocity: Vec<f64> = flow.velocity(&rates).iter().flat_map(in_space).collect();
    file.cell_data
        .push(DataArray::scalars("pressure", p.to_vec()));
    file.cell_data.push(DataArray {
        name: "velocity".into(),
        components: 3,
        values: velocity.into(),
    });
    file.field_data.retain(|(name, _)| name != "feature_faces");
    file.field_data
        .push(("flow".into(), FieldValue::Text(json.to_string())));
    write_cells_vtu(&args.output, &file)?;
    Ok((summary.table(), json))
}

/// The smallest and the largest.
fn range(values: &[f64]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| {
            [low.min(v), high.max(v)]
        })
}

/// Where fluid enters and leaves.
struct Conditions {
    wells: Vec<TypedWell>,
    /// Side and pressure.
    sides: Vec<(usize, f64)>,
}

/// A well with as many coordinates as were typed.
struct TypedWell {
    name: String,
    position: Vec<f64>,
    rate: f64,
}

impl Conditions {
    fn new(args: &FlowArgs) -> Result<Self> {
        let mut sides: Vec<(usize, f64)> = Vec::new();
        for text in &args.pressure {
            let remedy = "give a side and its pressure, such as xmin=1e7";
            let (name, value) = text
                .split_once('=')
                .ok_or_else(|| bad("--pressure", text, "has no '='", remedy))?;
            let side = SIDES
                .iter()
                .position(|side| *side == name.trim())
                .ok_or_else(|| {
                    let problem = format!("'{name}' is no side of the box");
                    bad(
                        "--pressure",
                        text,
                        &problem,
                        &format!("give one of {}", SIDES.join(", ")),
                    )
                })?;
            if sides.iter().any(|known| known.0 == side) {
                return Err(bad("--pressure", text, "is given twice", "give it once"));
            }
            sides.push((side, number("--pressure", value, remedy)?));
        }
        let mut wells = Vec::new();
        let mut without_rate = Vec::new();
        let typed = [
            ("--source", &args.source, 1.0),
            ("--sink", &args.sink, -1.0),
        ];
        for (option, texts, sign) in typed {
            for text in texts {
                let (position, rate) = well(option, text)?;
                if rate.is_none() && sign < 0.0 && sides.is_empty() {
                    without_rate.push(wells.len());
                }
                wells.push(TypedWell {
                    name: format!("{option} {text}"),
                    position,
                    rate: sign * rate.unwrap_or(RATE),
                });
            }
        }
        // Sinks without a rate share what comes in; given pressures would take up any difference.
        let known = |i: &usize| !without_rate.contains(i);
        let left: f64 = (0..wells.len()).filter(known).map(|i| wells[i].rate).sum();
        for &i in &without_rate {
            if left <= 0.0 {
                let problem = format!("has no rate, and the others leave {left} m^3/s to it");
                let remedy = "give it a rate, or the sources a larger one";
                return Err(Error::Flow(cause(&wells[i].name, problem, remedy)));
            }
            wells[i].rate = -left / without_rate.len() as f64;
        }
        if wells.is_empty() && sides.is_empty() {
            return Err(Error::Flow(cause(
                "flow",
                "nothing makes fluid flow",
                "give --source and --sink, or --pressure of two sides",
            )));
        }
        Ok(Self { wells, sides })
    }

    /// The wells in a mesh of dimension `D`.
    fn wells_in<const D: usize>(&self) -> Result<Vec<Well<D>>> {
        let typed = self.wells.iter();
        typed
            .map(|well| {
                let position = well.position.as_slice().try_into().map_err(|_| {
                    let problem = format!("has {} coordinates, the mesh {D}", well.position.len());
                    Error::Flow(cause(&well.name, problem, "give as many"))
                })?;
                Ok(Well {
                    name: well.name.clone(),
                    position,
                    rate: well.rate,
                })
            })
            .collect()
    }

    /// Where fluid enters or leaves, and its rate, given that of each side.
    fn exchange(&self, side_rates: &[f64; 6]) -> Vec<(String, f64)> {
        let wells = self.wells.iter();
        let mut all: Vec<(String, f64)> = wells
            .map(|well| (well.name.trim_start_matches('-').to_string(), well.rate))
            .collect();
        for &(side, pressure) in &self.sides {
            all.push((
                format!("{} at {pressure} Pa", SIDES[side]),
                side_rates[side],
            ));
        }
        all
    }

    /// Nodes with given pressure, and for each of them the side that gives it.
    fn fixed(&self, flow: &TetFlow, placed: &Placed) -> (Vec<(u32, f64)>, Vec<usize>) {
        let mut taken = vec![false; flow.split.original.len()];
        let (mut fixed, mut sides) = (Vec::new(), Vec::new());
        for &(side, pressure) in &self.sides {
            let extent = placed.extent[side / 2];
            let plane = if side % 2 == 0 { 0.0 } else { extent };
            let off = |i: usize| (placed.lattice.nodes[i][side / 2] - plane).abs();
            for node in flow.nodes_where(|i| off(i) <= ON_SIDE * extent) {
                // Where two sides meet, the first holds.
                if !std::mem::replace(&mut taken[node as usize], true) {
                    fixed.push((node, pressure));
                    sides.push(side);
                }
            }
        }
        (fixed, sides)
    }
}

/// `X,Y,Z` or `X,Y,Z:RATE` (in the plane without Z).
fn well(option: &str, text: &str) -> Result<(Vec<f64>, Option<f64>)> {
    let remedy = "give X,Y,Z or X,Y,Z:RATE, such as 120,80,40:0.001";
    let (place, rate) = match text.split_once(':') {
        Some((place, rate)) => (place, Some(number(option, rate, remedy)?)),
        None => (text, None),
    };
    if rate.is_some_and(|rate| rate <= 0.0) {
        let remedy = "give a positive rate: --sink takes fluid out";
        return Err(bad(option, text, "has a rate that is not positive", remedy));
    }
    let position = place.split(',').map(|word| number(option, word, remedy));
    Ok((position.collect::<Result<_>>()?, rate))
}

/// What faults do: `closed`, `open`, or a multiplier.
pub(super) fn faults(how: &str, thickness: Option<f64>) -> Result<Faults> {
    match how {
        "closed" => Faults::new(0.0, thickness),
        "open" => Ok(Faults::OPEN),
        text => {
            let remedy = "give open, closed, or a multiplier from 0 to 1";
            Faults::new(number("--faults", text, remedy)?, thickness)
        }
    }
}

/// The mobility of every cell: from numbers, from a file by region, or from an array of the mesh.
fn rock(args: &FlowArgs, cell_data: &[DataArray], regions: Option<Vec<i64>>) -> Result<Rock> {
    let (text, viscosity) = (&args.permeability, args.viscosity);
    if !(viscosity > 0.0 && viscosity.is_finite()) {
        let problem = "is not a positive number";
        return Err(bad(
            "--viscosity",
            &viscosity.to_string(),
            problem,
            "give Pa s: water has 0.001",
        ));
    }
    let remedy = "give K, or KX,KY,KZ, or KXX,KYY,KZZ,KXY,KYZ,KXZ, positive definite, in m^2";
    let array = |name: &str| cell_data.iter().find(|array| array.name == name);
    let numbers = |words: &str| -> Option<Vec<f64>> {
        words
            .split(',')
            .map(|word| word.trim().parse().ok())
            .collect()
    };
    if let Some(values) = numbers(text) {
        let tensor = Tensor::from_numbers(&values)
            .ok_or_else(|| bad("--permeability", text, "is no permeability", remedy))?;
        return Ok(Rock::uniform(tensor, viscosity));
    }
    if let Some(array) = array(text) {
        let values = array.values.to_f64();
        let cell = |(cell, numbers): (usize, &[f64])| {
            let tensor = Tensor::from_numbers(numbers);
            tensor.map(|k| k.scaled(1.0 / viscosity)).ok_or_else(|| {
                let problem = format!("cell {cell} has {numbers:?}, which is no permeability");
                bad("--permeability", text, &problem, remedy)
            })
        };
        let kinds: Vec<Tensor> = values
            .chunks(array.components)
            .enumerate()
            .map(cell)
            .collect::<Result<_>>()?;
        return Ok(Rock {
            of_cell: (0..kinds.len() as u32).collect(),
            kinds,
        });
    }
    let path = Path::new(text);
    if !path.exists() {
        let names: Vec<&str> = cell_data.iter().map(|array| array.name.as_str()).collect();
        let problem = format!(
            "is no number, no file, and no cell array of the mesh (it has {})",
            names.join(", ")
        );
        return Err(bad("--permeability", text, &problem, remedy));
    }
    let lines = "write region,K or region,KX,KY,KZ, in m^2";
    let kinds = by_region(path, Tensor::from_numbers, lines)?;
    let regions = regions.ok_or_else(|| {
        let problem = "is by region, but the mesh has no cell array 'region'";
        bad(
            "--permeability",
            text,
            problem,
            "give one permeability for all",
        )
    })?;
    let regions: Vec<i32> = regions.into_iter().map(|r| r as i32).collect();
    Rock::by_region(&regions, &kinds, viscosity)
}

/// What the verb says.
struct Summary {
    figures: Figures,
    pressure: [f64; 2],
    doubled: usize,
    fault_faces: usize,
    /// Sum of the rates across faults, whatever their direction.
    across_faults: f64,
    largest_jump: f64,
    /// Where fluid enters or leaves, and its rate.
    exchange: Vec<(String, f64)>,
}

impl Summary {
    fn table(&self) -> String {
        let figures = &self.figures;
        let mut lines = vec![
            format!(
                "unknowns      {} ({} nodes doubled on {} faces of faults), {} compartment{}",
                figures.unknowns,
                self.doubled,
                self.fault_faces,
                figures.compartments,
                if figures.compartments == 1 { "" } else { "s" },
            ),
            format!(
                "solver        {} iterations, residual {:.1e}",
                figures.iterations, figures.residual
            ),
            format!(
                "pressure      {:.6e} to {:.6e} Pa",
                self.pressure[0], self.pressure[1]
            ),
            format!(
                "faults        {:.6e} m^3/s across, largest jump {:.6e} Pa",
                self.across_faults, self.largest_jump
            ),
            format!("throughput    {:.6e} m^3/s", figures.throughput),
            format!(
                "imbalance     {:.1e} of the throughput in the worst control volume, {:.1e} in all",
                figures.worst_balance, figures.total_balance
            ),
        ];
        for (name, rate) in &self.exchange {
            lines.push(format!("{rate:+13.6e} m^3/s  {name}"));
        }
        lines.join("\n")
    }

    fn json(&self) -> Value {
        let exchange: Vec<Value> = self
            .exchange
            .iter()
            .map(|(name, rate)| json!({ "name": name, "rate": rate }))
            .collect();
        json!({
            "figures": self.figures,
            "pressure": { "min": self.pressure[0], "max": self.pressure[1] },
            "faults": {
                "faces": self.fault_faces,
                "nodes_doubled": self.doubled,
                "rate_across": self.across_faults,
                "largest_jump": self.largest_jump,
            },
            "exchange": exchange,
        })
    }
}

/// The torn mesh with pressure, velocity, and what crosses faults.
fn to_file(
    flow: TetFlow,
    found: &Solution,
    point_data: Vec<DataArray>,
    mut cell_data: Vec<DataArray>,
    mut field_data: Vec<(String, FieldValue)>,
    summary: &Value,
) -> MeshFile {
    let velocity = flow.velocity(&found.pressure);
    let mut across = vec![0.0; 4 * velocity.len()];
    for (face, rate) in flow
        .split
        .faces
        .iter()
        .zip(flow.fault_rates(&found.pressure))
    {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            across[4 * face.tets[side] as usize + usize::from(face.face[side])] = sign * rate;
        }
    }
    let split = flow.split;
    let mut points: Vec<DataArray> = point_data
        .into_iter()
        .map(|array| DataArray {
            values: array.values.tuples(&split.original, array.components),
            ..array
        })
        .collect();
    points.push(DataArray::scalars("node", split.original.clone()));
    points.push(DataArray::scalars("pressure", found.pressure.clone()));
    cell_data.push(DataArray {
        name: "velocity".into(),
        components: 3,
        values: velocity.into_flattened().into(),
    });
    cell_data.push(DataArray {
        name: "fault_rate".into(),
        components: 4,
        values: across.into(),
    });
    field_data.push(("flow".into(), FieldValue::Text(summary.to_string())));
    MeshFile {
        mesh: split.mesh,
        point_data: points,
        cell_data,
        field_data,
    }
}
