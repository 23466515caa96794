//! Writes a MODFLOW 6 simulation of columns: steady groundwater flow on a grid of vertices (DISV).
//!
//! MODFLOW has layers of prisms. The top and the bottom of a cell are the mean heights of the faces
//! above and below it, so that volumes are exact. MODFLOW computes the conductances itself, from
//! the sites (the centres in CELL2D). They are correct for Voronoi cells, and equal to the model's
//! own where layers are horizontal. Heads are in metres: p / (rho g) + z. Flow passes vertically
//! through layers that are missing in a column (IDOMAIN -1).

use std::io::Write;
use std::path::Path;

use crate::error::cause;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames};
use crate::files::Batch;
use crate::files::text::{FileWriter, WriteResult, write_items, write_numbers};
use crate::model::columns::{COLUMN, LAYER};
use crate::model::reservoir::{Control, GRAVITY, Model};
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "disv",
    description: "MODFLOW 6 simulation of columns (DISV), in a folder",
    extensions: &[],
    has_companion: true,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::CutOffs,
        ExportContent::Faults,
        ExportContent::ClosedFaults,
        ExportContent::Wells,
        ExportContent::InitialPressure,
        ExportContent::Gravity,
        ExportContent::Duration,
    ],
    deck_path: None,
    names: FormatNames::NONE,
    write,
};

/// Density (kg/m^3) and viscosity (Pa s) of water.
const WATER_PROPERTIES: [f64; 2] = [1000.0, 1e-3];
const ERROR_PLACE: &str = "a MODFLOW grid";
/// Conductance factors that differ from 1 by less than this are not written.
const FACTOR_TOLERANCE: f64 = 1e-9;
/// Factor of a closed connection. MODFLOW would read a factor of zero as a conductance.
const CLOSED_FACTOR: f64 = 1e-30;

/// Writes the simulation into a folder.
///
/// # Errors
/// Returns [`Error::Export`] if the cells are not columns, or if permeability is missing.
pub fn write(model: &Model, _names: &ExportNames, batch: &mut Batch, folder: &Path) -> Result<()> {
    let permeability = model.need_permeability(ERROR_PLACE)?;
    let grid = DisvGrid::new(model)?;
    let weight = WATER_PROPERTIES[0] * GRAVITY;
    let units = HeadUnits {
        weight,
        conductivity: weight / WATER_PROPERTIES[1],
        has_gravity: model.case.has_gravity,
    };
    let highest = (0..model.len())
        .map(|cell| model.graph.site[cell][2])
        .fold(f64::NEG_INFINITY, f64::max);
    let start = units.head(model.case.top_pressure, highest);
    let wells = WellCells::new(model, &grid, &units);
    let barriers = grid.barriers(model);

    batch.create_folder(folder)?;
    let mut file = |name: &str, write: &mut dyn FnMut(FileWriter) -> WriteResult| {
        batch.write(&folder.join(name), |out| write(out))
    };
    file("mfsim.nam", &mut |out| writeln!(out, "{SIMULATION_FILE}"))?;
    let duration = model.case.duration;
    file("sim.tdis", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  TIME_UNITS SECONDS\nEND OPTIONS\n\nBEGIN DIMENSIONS\n  NPER 1\n\
             END DIMENSIONS\n\nBEGIN PERIODDATA\n  {duration} 1 1.0\nEND PERIODDATA"
        )
    })?;
    file("sim.ims", &mut |out| writeln!(out, "{SOLVER_FILE}"))?;
    let packages = [
        ("DISV6", "disv", 1),
        ("NPF6", "npf", 1),
        ("IC6", "ic", 1),
        ("OC6", "oc", 1),
        ("WEL6", "wel", wells.rates.len()),
        ("GHB6", "ghb", wells.pressures.len()),
        ("CHD6", "chd", usize::from(wells.pressures.is_empty())),
        ("HFB6", "hfb", barriers.len()),
    ];
    file("model.nam", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  SAVE_FLOWS\nEND OPTIONS\n\nBEGIN PACKAGES"
        )?;
        for (name, ending, _) in packages.iter().filter(|package| package.2 > 0) {
            writeln!(out, "  {name} model.{ending} {ending}")?;
        }
        writeln!(out, "END PACKAGES")
    })?;
    file("model.disv", &mut |out| grid.write(out, model))?;
    file("model.npf", &mut |out| {
        write_conductivity(out, &grid, |cell, k| {
            let is_active = model.is_active(cell);
            is_active.then(|| units.conductivity * permeability.rock.mobility(cell).0[k])
        })
    })?;
    file("model.ic", &mut |out| {
        writeln!(
            out,
            "BEGIN GRIDDATA\n  STRT\n    CONSTANT {start}\nEND GRIDDATA"
        )
    })?;
    file("model.oc", &mut |out| writeln!(out, "{OUTPUT_FILE}"))?;
    if !wells.rates.is_empty() {
        file("model.wel", &mut |out| wells.write_rates(out))?;
    }
    if wells.pressures.is_empty() {
        // The head must be known in at least one cell.
        let first = (0..model.len()).find(|&cell| model.is_active(cell));
        let [layer, column] = grid.id(first.unwrap_or(0) as u32);
        file("model.chd", &mut |out| {
            let bound = period_head(1);
            writeln!(out, "{bound}\n  {layer} {column} {start}\nEND PERIOD")
        })?;
    } else {
        file("model.ghb", &mut |out| wells.write_pressures(out))?;
    }
    if !barriers.is_empty() {
        file("model.hfb", &mut |out| grid.write_barriers(out, &barriers))?;
    }
    Ok(())
}

/// Name file of the simulation.
const SIMULATION_FILE: &str = "BEGIN OPTIONS\nEND OPTIONS\n\nBEGIN TIMING\n  TDIS6 sim.tdis\nEND TIMING\n\n\
    BEGIN MODELS\n  GWF6 model.nam model\nEND MODELS\n\nBEGIN EXCHANGES\nEND EXCHANGES\n\n\
    BEGIN SOLUTIONGROUP 1\n  IMS6 sim.ims model\nEND SOLUTIONGROUP";

/// Options of the linear solver.
const SOLVER_FILE: &str = "BEGIN OPTIONS\n  PRINT_OPTION SUMMARY\n  COMPLEXITY SIMPLE\nEND OPTIONS\n\n\
    BEGIN NONLINEAR\n  OUTER_DVCLOSE 1E-9\n  OUTER_MAXIMUM 50\nEND NONLINEAR\n\n\
    BEGIN LINEAR\n  INNER_MAXIMUM 500\n  INNER_DVCLOSE 1E-10\n  INNER_RCLOSE 1E-10\n\
    \x20 LINEAR_ACCELERATION CG\nEND LINEAR";

/// Files of heads and flows to write.
const OUTPUT_FILE: &str = "BEGIN OPTIONS\n  HEAD FILEOUT model.hds\n  BUDGET FILEOUT model.cbc\nEND OPTIONS\n\n\
    BEGIN PERIOD 1\n  SAVE HEAD LAST\n  SAVE BUDGET LAST\nEND PERIOD";

/// Returns the head of a package of conditions in `count` cells.
fn period_head(count: usize) -> String {
    format!("BEGIN DIMENSIONS\n  MAXBOUND {count}\nEND DIMENSIONS\n\nBEGIN PERIOD 1")
}

/// Writes the conductivity along x, y and z: that of each cell, and 1 where it has none.
fn write_conductivity(
    out: FileWriter,
    grid: &DisvGrid,
    conductivity: impl Fn(usize, usize) -> Option<f64> + Sync,
) -> WriteResult {
    writeln!(
        out,
        "BEGIN OPTIONS\n  SAVE_SPECIFIC_DISCHARGE\nEND OPTIONS\n\nBEGIN GRIDDATA"
    )?;
    writeln!(out, "  ICELLTYPE\n    CONSTANT 0")?;
    for (k, name) in ["K", "K22", "K33"].into_iter().enumerate() {
        writeln!(out, "  {name}\n    INTERNAL FACTOR 1.0")?;
        write_numbers(out, grid.cells.len(), |at| {
            let cell = grid.cells[at];
            cell.and_then(|cell| conductivity(cell as usize, k))
                .unwrap_or(1.0)
        })?;
    }
    writeln!(out, "END GRIDDATA")
}

/// Conversion of pressures to heads, and of permeability to conductivity.
struct HeadUnits {
    /// Weight of water.
    weight: f64,
    /// Conductivity of rock with a permeability of one square metre.
    conductivity: f64,
    has_gravity: bool,
}

impl HeadUnits {
    fn head(&self, pressure: f64, z: f64) -> f64 {
        pressure / self.weight + if self.has_gravity { z } else { 0.0 }
    }
}

/// Cells of wells, by layer and column.
#[derive(Default)]
struct WellCells {
    /// Cells with given rates.
    rates: Vec<([usize; 2], f64)>,
    /// Cells at given pressures: head and conductance.
    pressures: Vec<([usize; 2], [f64; 2])>,
}

impl WellCells {
    fn new(model: &Model, grid: &DisvGrid, units: &HeadUnits) -> Self {
        let mut wells = Self::default();
        for well in &model.case.wells {
            let total_index: f64 = well.cells.iter().map(|c| c.1).sum();
            for &(cell, index) in &well.cells {
                let id = grid.id(cell);
                match well.control {
                    Control::Inject(rate) => wells.rates.push((id, rate * index / total_index)),
                    // Formats without schedules have no such wells.
                    Control::Scheduled => {}
                    Control::Pressure(pressure) => {
                        // The pressure is given at the first cell of the well. Below that cell, the
                        // pressure is hydrostatic.
                        let first = well.cells.first();
                        let z = first.map_or(0.0, |c| model.graph.site[c.0 as usize][2]);
                        let head = units.head(pressure, z);
                        wells
                            .pressures
                            .push((id, [head, units.conductivity * index]));
                    }
                }
            }
        }
        wells
    }

    fn write_rates(&self, out: FileWriter) -> WriteResult {
        writeln!(out, "{}", period_head(self.rates.len()))?;
        for ([layer, column], rate) in &self.rates {
            writeln!(out, "  {layer} {column} {rate:e}")?;
        }
        writeln!(out, "END PERIOD")
    }

    fn write_pressures(&self, out: FileWriter) -> WriteResult {
        writeln!(out, "{}", period_head(self.pressures.len()))?;
        for ([layer, column], [head, conductance]) in &self.pressures {
            writeln!(out, "  {layer} {column} {head} {conductance:e}")?;
        }
        writeln!(out, "END PERIOD")
    }
}

/// Cells in layers and columns.
struct DisvGrid {
    layers: usize,
    columns: usize,
    /// Cell at each layer and column, if there is one.
    cells: Vec<Option<u32>>,
    /// Index in `cells` of each cell.
    cell_positions: Vec<usize>,
    vertices: Vec<[f64; 2]>,
    /// Centre of each column, and its vertices clockwise.
    polygons: Vec<([f64; 2], Vec<usize>)>,
    /// Mean z of the faces above and below each cell.
    z_bounds: Vec<[f64; 2]>,
}

/// Returns the column and the layer of each cell, from 0. The error is the problem.
fn columns_and_layers(
    model: &Model,
) -> std::result::Result<(Vec<usize>, Vec<usize>), &'static str> {
    let numbers = |name: &str| {
        let array = model.properties.iter().find(|array| array.name == name);
        array.map(|array| array.values.to_i64())
    };
    let (mesh, cells) = (&model.mesh, model.len());
    match (numbers(COLUMN), numbers(LAYER)) {
        (Some(column), Some(layer)) => {
            let numbers = column.iter().chain(&layer);
            if column.len() != cells || layer.len() != cells || numbers.clone().any(|&n| n < 0) {
                return Err("has inconsistent numbers of columns or layers");
            }
            let to_indices = |list: Vec<i64>| list.into_iter().map(|n| n as usize).collect();
            Ok((to_indices(column), to_indices(layer)))
        }
        _ if mesh.inner_face_count()
            == (0..mesh.inner_face_count())
                .filter(|&f| mesh.is_upright(f))
                .count() =>
        {
            Ok(((0..cells).collect(), vec![0; cells]))
        }
        _ => Err("needs the number of each cell's column and layer"),
    }
}

impl DisvGrid {
    fn new(model: &Model) -> Result<Self> {
        let (mesh, cells) = (&model.mesh, model.len());
        let refuse = |problem: &str| {
            let remedy = "give a mesh of columns with z or -z down, or a 2-D mesh";
            Error::Export(cause(ERROR_PLACE, problem, remedy))
        };
        if model.tets.is_some() || !mesh.is_columnar() {
            return Err(refuse(
                "needs columns, but these cells are not one above the other",
            ));
        }
        let (column, layer) = columns_and_layers(model).map_err(refuse)?;
        let inner = &mesh.face_cells[..mesh.inner_face_count()];
        let is_offset = |(f, [a, b]): (usize, &[u32; 2])| {
            layer[*a as usize] != layer[*b as usize] && mesh.is_upright(f)
        };
        if inner.iter().enumerate().any(is_offset) {
            return Err(Error::Export(cause(
                ERROR_PLACE,
                "cannot hold faults that offset layers: cells of different layers are neighbours",
                "make the columns without --throws, or export to opm, mrst, pflotran or tough",
            )));
        }
        let layers = layer.iter().max().map_or(0, |l| l + 1);
        let columns = column.iter().max().map_or(0, |c| c + 1);
        if layers.saturating_mul(columns) > 1 << 31 {
            return Err(refuse("has inconsistent numbers of columns or layers"));
        }
        let mut grid = Self {
            layers,
            columns,
            cells: vec![None; layers * columns],
            cell_positions: Vec::with_capacity(cells),
            vertices: mesh.nodes.iter().map(|&[x, y, _]| [x, y]).collect(),
            polygons: vec![([0.0; 2], Vec::new()); columns],
            z_bounds: vec![[f64::NEG_INFINITY, f64::INFINITY]; cells],
        };
        let order = |p: &[f64; 2], q: &[f64; 2]| p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1]));
        grid.vertices.sort_unstable_by(order);
        grid.vertices.dedup();
        for cell in 0..cells {
            let position = layer[cell] * columns + column[cell];
            if grid.cells[position].replace(cell as u32).is_some() {
                return Err(refuse("has two cells in one layer of a column"));
            }
            grid.cell_positions.push(position);
        }
        for f in (0..mesh.face_cells.len()).filter(|&f| !mesh.is_upright(f)) {
            let ring: Vec<[f64; 3]> = (mesh.faces.get(f).iter())
                .map(|&n| mesh.nodes[n as usize])
                .collect();
            let (area, z) = mean_height(&ring, mesh.face_shape(f).apex);
            for cell in mesh.face_cells[f]
                .into_iter()
                .filter(|&c| (c as usize) < cells)
            {
                let cell = cell as usize;
                let side = usize::from(z < mesh.sites[cell][2]);
                grid.z_bounds[cell][side] = z;
                let polygon = &mut grid.polygons[column[cell]];
                if polygon.1.is_empty() {
                    let vertex_index = |p: &[f64; 3]| {
                        let index = grid.vertices.binary_search_by(|q| order(q, &[p[0], p[1]]));
                        index.unwrap_or(0)
                    };
                    polygon.0 = [0, 1].map(|k| mesh.sites[cell][k]);
                    polygon.1 = ring.iter().map(vertex_index).collect();
                    if area > 0.0 {
                        polygon.1.reverse();
                    }
                }
            }
        }
        Ok(grid)
    }

    /// Returns layer and column of a cell, from 1.
    fn id(&self, cell: u32) -> [usize; 2] {
        let position = self.cell_positions[cell as usize];
        [position / self.columns + 1, position % self.columns + 1]
    }

    /// Writes connections with a smaller conductance than that of the rock, and the factor.
    fn write_barriers(&self, out: FileWriter, barriers: &[([u32; 2], f64)]) -> WriteResult {
        let count = barriers.len();
        writeln!(
            out,
            "BEGIN DIMENSIONS\n  MAXHFB {count}\nEND DIMENSIONS\n\nBEGIN PERIOD 1"
        )?;
        for (cells, factor) in barriers {
            let [[k, a], [l, b]] = cells.map(|cell| self.id(cell));
            writeln!(out, "  {k} {a} {l} {b} {:e}", -factor)?;
        }
        writeln!(out, "END PERIOD")
    }

    /// Returns the pairs of cells in neighbouring columns whose transmissibility is less than that
    /// of the rock, each with the ratio of the two.
    fn barriers(&self, model: &Model) -> Vec<([u32; 2], f64)> {
        let Some(permeability) = &model.permeability else {
            return Vec::new();
        };
        let mut barriers = Vec::new();
        let connections = model.graph.connections.iter().enumerate();
        for ((index, c), &t) in connections.zip(&permeability.transmissibility) {
            let is_active = c.cells.iter().all(|&cell| model.is_active(cell as usize));
            if is_active && model.barriers.label(index).is_some() {
                let k = c.cells.map(|cell| {
                    permeability
                        .rock
                        .mobility(cell as usize)
                        .normal_component(c.normal)
                });
                let factor = t / c.area * (c.distance[0] / k[0] + c.distance[1] / k[1]);
                if (factor - 1.0).abs() > FACTOR_TOLERANCE {
                    barriers.push((c.cells, factor.max(CLOSED_FACTOR)));
                }
            }
        }
        barriers
    }

    fn write(&self, out: FileWriter, model: &Model) -> WriteResult {
        let (layers, columns) = (self.layers, self.columns);
        writeln!(
            out,
            "BEGIN OPTIONS\n  LENGTH_UNITS METERS\nEND OPTIONS\n\nBEGIN DIMENSIONS\n  NLAY {layers}\n\
             \x20 NCPL {columns}\n  NVERT {}\nEND DIMENSIONS\n\nBEGIN GRIDDATA\n  TOP\n    INTERNAL FACTOR 1.0",
            self.vertices.len()
        )?;
        // A missing cell has no thickness, and lies at the bottom of the cell above it.
        let first = |column: usize| (0..layers).find_map(|l| self.cells[l * columns + column]);
        let last = |column: usize| {
            (0..layers)
                .rev()
                .find_map(|l| self.cells[l * columns + column])
        };
        let top = |column: usize| first(column).map_or(0.0, |cell| self.z_bounds[cell as usize][0]);
        let bottom = |position: usize| {
            let (layer, column) = (position / columns, position % columns);
            let above = (0..=layer)
                .rev()
                .find_map(|l| self.cells[l * columns + column]);
            above.map_or(top(column), |cell| self.z_bounds[cell as usize][1])
        };
        write_numbers(out, columns, top)?;
        writeln!(out, "  BOTM\n    INTERNAL FACTOR 1.0")?;
        // MODFLOW reads the layers one by one, and each begins on a new line.
        for layer in 0..layers {
            write_numbers(out, columns, |column| bottom(layer * columns + column))?;
        }
        writeln!(out, "  IDOMAIN\n    INTERNAL FACTOR 1")?;
        write_items(out, layers * columns, |text, at| {
            let range = [first(at % columns), last(at % columns)];
            let domain = match (self.cells[at], range) {
                (Some(cell), _) => i32::from(model.is_active(cell as usize)),
                (None, [Some(first), Some(last)])
                    if (self.cell_positions[first as usize]
                        ..self.cell_positions[last as usize])
                        .contains(&at) =>
                {
                    -1
                }
                _ => 0,
            };
            text.int(domain).end_line();
        })?;
        writeln!(out, "END GRIDDATA\n\nBEGIN VERTICES")?;
        write_items(out, self.vertices.len(), |text, v| {
            let [x, y] = self.vertices[v];
            text.int(v + 1).spaced_real(x).spaced_real(y).end_line();
        })?;
        writeln!(out, "END VERTICES\n\nBEGIN CELL2D")?;
        write_items(out, columns, |text, column| {
            let ([x, y], ring) = &self.polygons[column];
            text.int(column + 1)
                .spaced_real(*x)
                .spaced_real(*y)
                .spaced_int(ring.len());
            ring.iter().for_each(|v| {
                text.spaced_int(v + 1);
            });
            text.end_line();
        })?;
        writeln!(out, "END CELL2D")
    }
}

/// Returns the area of a face in map view, positive if its nodes turn anticlockwise, and its mean
/// z.
fn mean_height(ring: &[[f64; 3]], apex: [f64; 3]) -> (f64, f64) {
    let (mut area, mut sum) = (0.0, 0.0);
    for i in 0..ring.len() {
        let (p, q) = (ring[i], ring[(i + 1) % ring.len()]);
        let u = [p[0] - apex[0], p[1] - apex[1]];
        let v = [q[0] - apex[0], q[1] - apex[1]];
        let triangle_area = 0.5 * (u[0] * v[1] - u[1] * v[0]);
        area += triangle_area;
        sum += triangle_area * (p[2] + q[2] + apex[2]) / 3.0;
    }
    (area, sum / area)
}
