//! A MODFLOW 6 simulation of columns: groundwater flow on a grid of vertices (DISV), steady.
//!
//! MODFLOW knows layers of prisms: a cell's top and bottom are the means of the faces above and below,
//! so that volumes are exact; conductances are MODFLOW's own, from the sites (CELL2D's centres), which
//! for Voronoi cells are right, and equal to ours where layers are level. Heads are in metres:
//! p / (rho g) + z. Layers that are missing in a column are passed through (IDOMAIN -1).

use std::io::Write;
use std::path::Path;

use crate::error::cause;
use crate::export::containers::text::{write_items, write_numbers};
use crate::files::Batch;
use crate::model::columns::{COLUMN, LAYER};
use crate::model::reservoir::{Control, GRAVITY, Model};
use crate::{Error, Result};

/// Density (kg/m^3) and viscosity (Pa s) of water.
const WATER_PROPERTIES: [f64; 2] = [1000.0, 1e-3];
const ERROR_PLACE: &str = "a MODFLOW grid";
/// Factors of a conductance that are nearer to 1 are none.
const FACTOR_TOLERANCE: f64 = 1e-9;
/// MODFLOW takes a factor of zero for a conductance.
const CLOSED_FACTOR: f64 = 1e-30;

/// Writes the simulation into a folder.
///
/// # Errors
/// [`Error::Export`] if the cells are no columns, or without permeability.
pub fn write(model: &Model, batch: &mut Batch, folder: &Path) -> Result<()> {
    let permeability = model.need_permeability(ERROR_PLACE)?;
    let grid = DisvGrid::new(model)?;
    let weight = WATER_PROPERTIES[0] * GRAVITY;
    let conductivity = weight / WATER_PROPERTIES[1];
    let (layers, columns) = (grid.layers, grid.columns);
    let cells = layers * columns;
    let of = |k: usize, at: usize| match grid.cells[at] {
        Some(cell) if model.is_active(cell as usize) => {
            conductivity * permeability.rock.mobility(cell as usize).0[k]
        }
        _ => 1.0,
    };
    let case = &model.case;
    let head = |pressure: f64, z: f64| pressure / weight + if case.has_gravity { z } else { 0.0 };
    let site = |cell: u32| model.graph.site[cell as usize][2];
    let highest = (0..model.len() as u32)
        .map(site)
        .fold(f64::NEG_INFINITY, f64::max);
    let start = head(case.top_pressure, highest);
    // Layer and column, from 1 on.
    let id = |cell: u32| {
        let at = grid.cell_positions[cell as usize];
        [at / columns + 1, at % columns + 1]
    };
    let mut rates: Vec<([usize; 2], f64)> = Vec::new();
    let mut pressures: Vec<([usize; 2], [f64; 2])> = Vec::new();
    for well in &case.wells {
        let all: f64 = well.cells.iter().map(|c| c.1).sum();
        for &(cell, index) in &well.cells {
            match well.control {
                Control::Inject(rate) => rates.push((id(cell), rate * index / all)),
                Control::Produce(rate) => rates.push((id(cell), -rate * index / all)),
                Control::Pressure(pressure) => {
                    // The pressure is that at the well's first cell; below it, water stands.
                    let z = well.cells.first().map_or(0.0, |c| site(c.0));
                    pressures.push((id(cell), [head(pressure, z), conductivity * index]));
                }
            }
        }
    }
    let barriers = grid.barriers(model);

    batch.create_folder(folder)?;
    let mut file = |name: &str, write: &mut dyn FnMut(FileWriter) -> WriteResult| {
        batch.write(&folder.join(name), |out| write(out))
    };
    file("mfsim.nam", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\nEND OPTIONS\n\nBEGIN TIMING\n  TDIS6 sim.tdis\nEND TIMING\n\n\
             BEGIN MODELS\n  GWF6 model.nam model\nEND MODELS\n\nBEGIN EXCHANGES\nEND EXCHANGES\n\n\
             BEGIN SOLUTIONGROUP 1\n  IMS6 sim.ims model\nEND SOLUTIONGROUP"
        )
    })?;
    file("sim.tdis", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  TIME_UNITS SECONDS\nEND OPTIONS\n\nBEGIN DIMENSIONS\n  NPER 1\n\
             END DIMENSIONS\n\nBEGIN PERIODDATA\n  {} 1 1.0\nEND PERIODDATA",
            case.duration
        )
    })?;
    file("sim.ims", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  PRINT_OPTION SUMMARY\n  COMPLEXITY SIMPLE\nEND OPTIONS\n\n\
             BEGIN NONLINEAR\n  OUTER_DVCLOSE 1E-9\n  OUTER_MAXIMUM 50\nEND NONLINEAR\n\n\
             BEGIN LINEAR\n  INNER_MAXIMUM 500\n  INNER_DVCLOSE 1E-10\n  INNER_RCLOSE 1E-10\n\
             \x20 LINEAR_ACCELERATION CG\nEND LINEAR"
        )
    })?;
    let some = [
        ("WEL6", "wel", rates.len()),
        ("GHB6", "ghb", pressures.len()),
        ("CHD6", "chd", usize::from(pressures.is_empty())),
        ("HFB6", "hfb", barriers.len()),
    ];
    file("model.nam", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  SAVE_FLOWS\nEND OPTIONS\n\nBEGIN PACKAGES"
        )?;
        for (name, ending) in [
            ("DISV6", "disv"),
            ("NPF6", "npf"),
            ("IC6", "ic"),
            ("OC6", "oc"),
        ] {
            writeln!(out, "  {name} model.{ending} {ending}")?;
        }
        for (name, ending, _) in some.iter().filter(|package| package.2 > 0) {
            writeln!(out, "  {name} model.{ending} {ending}")?;
        }
        writeln!(out, "END PACKAGES")
    })?;
    file("model.disv", &mut |out| grid.write(out, model))?;
    file("model.npf", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  SAVE_SPECIFIC_DISCHARGE\nEND OPTIONS\n\nBEGIN GRIDDATA"
        )?;
        writeln!(
            out,
            "  ICELLTYPE\n    CONSTANT 0\n  K\n    INTERNAL FACTOR 1.0"
        )?;
        write_numbers(out, cells, |at| of(0, at))?;
        writeln!(out, "  K22\n    INTERNAL FACTOR 1.0")?;
        write_numbers(out, cells, |at| of(1, at))?;
        writeln!(out, "  K33\n    INTERNAL FACTOR 1.0")?;
        write_numbers(out, cells, |at| of(2, at))?;
        writeln!(out, "END GRIDDATA")
    })?;
    file("model.ic", &mut |out| {
        writeln!(
            out,
            "BEGIN GRIDDATA\n  STRT\n    CONSTANT {start}\nEND GRIDDATA"
        )
    })?;
    file("model.oc", &mut |out| {
        writeln!(
            out,
            "BEGIN OPTIONS\n  HEAD FILEOUT model.hds\n  BUDGET FILEOUT model.cbc\nEND OPTIONS\n\n\
             BEGIN PERIOD 1\n  SAVE HEAD LAST\n  SAVE BUDGET LAST\nEND PERIOD"
        )
    })?;
    let bound = |count: usize| {
        format!("BEGIN DIMENSIONS\n  MAXBOUND {count}\nEND DIMENSIONS\n\nBEGIN PERIOD 1")
    };
    if !rates.is_empty() {
        file("model.wel", &mut |out| {
            writeln!(out, "{}", bound(rates.len()))?;
            for ([layer, column], rate) in &rates {
                writeln!(out, "  {layer} {column} {rate:e}")?;
            }
            writeln!(out, "END PERIOD")
        })?;
    }
    if pressures.is_empty() {
        // Somewhere the head must be known.
        let first = (0..model.len()).find(|&cell| model.is_active(cell));
        let [layer, column] = id(first.unwrap_or(0) as u32);
        file("model.chd", &mut |out| {
            writeln!(out, "{}\n  {layer} {column} {start}\nEND PERIOD", bound(1))
        })?;
    } else {
        file("model.ghb", &mut |out| {
            writeln!(out, "{}", bound(pressures.len()))?;
            for ([layer, column], [head, conductance]) in &pressures {
                writeln!(out, "  {layer} {column} {head} {conductance:e}")?;
            }
            writeln!(out, "END PERIOD")
        })?;
    }
    if !barriers.is_empty() {
        file("model.hfb", &mut |out| {
            writeln!(
                out,
                "BEGIN DIMENSIONS\n  MAXHFB {}\nEND DIMENSIONS\n\nBEGIN PERIOD 1",
                barriers.len()
            )?;
            for (cells, factor) in &barriers {
                let [[k, a], [l, b]] = cells.map(id);
                writeln!(out, "  {k} {a} {l} {b} {:e}", -factor)?;
            }
            writeln!(out, "END PERIOD")
        })?;
    }
    Ok(())
}

type FileWriter<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type WriteResult = std::io::Result<()>;

/// The cells in layers and columns.
struct DisvGrid {
    layers: usize,
    columns: usize,
    /// For each layer and column the cell, if it is there.
    cells: Vec<Option<u32>>,
    /// For each cell its place in that.
    cell_positions: Vec<usize>,
    vertices: Vec<[f64; 2]>,
    /// Centre of each column, and its vertices clockwise.
    polygons: Vec<([f64; 2], Vec<usize>)>,
    /// Mean z of the faces above and below each cell.
    z_bounds: Vec<[f64; 2]>,
}

impl DisvGrid {
    fn new(model: &Model) -> Result<Self> {
        let mesh = &model.mesh;
        let refuse = |problem: &str| {
            let remedy = "give a mesh of columns with z or -z down, or a 2-D mesh";
            Err(Error::Export(cause(ERROR_PLACE, problem, remedy)))
        };
        if model.tets.is_some() || !mesh.is_columnar() {
            return refuse("holds columns only, and these cells do not stand above one another");
        }
        let numbers = |name: &str| {
            let array = model.properties.iter().find(|array| array.name == name);
            array.map(|array| array.values.to_i64())
        };
        let cells = model.len();
        let (column, layer): (Vec<usize>, Vec<usize>) = match (numbers(COLUMN), numbers(LAYER)) {
            (Some(column), Some(layer)) => {
                let all = column.iter().chain(&layer);
                if column.len() != cells || layer.len() != cells || all.clone().any(|&n| n < 0) {
                    return refuse("has inconsistent numbers of columns or layers");
                }
                let plain = |list: Vec<i64>| list.into_iter().map(|n| n as usize).collect();
                (plain(column), plain(layer))
            }
            _ if mesh.inner_face_count()
                == (0..mesh.inner_face_count())
                    .filter(|&f| mesh.is_upright(f))
                    .count() =>
            {
                ((0..cells).collect(), vec![0; cells])
            }
            _ => return refuse("needs the number of each cell's column and layer"),
        };
        let layers = layer.iter().max().map_or(0, |l| l + 1);
        let columns = column.iter().max().map_or(0, |c| c + 1);
        if layers.saturating_mul(columns) > 1 << 31 {
            return refuse("has inconsistent numbers of columns or layers");
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
            let at = layer[cell] * columns + column[cell];
            if grid.cells[at].replace(cell as u32).is_some() {
                return refuse("has two cells in one layer of a column");
            }
            grid.cell_positions.push(at);
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
                    let place = |p: &[f64; 3]| {
                        let found = grid.vertices.binary_search_by(|q| order(q, &[p[0], p[1]]));
                        found.unwrap_or(0)
                    };
                    polygon.0 = [0, 1].map(|k| mesh.sites[cell][k]);
                    polygon.1 = ring.iter().map(place).collect();
                    if area > 0.0 {
                        polygon.1.reverse();
                    }
                }
            }
        }
        Ok(grid)
    }

    /// Pairs of neighbouring columns' cells whose transmissibility is less than the rock's, by which
    /// factor.
    fn barriers(&self, model: &Model) -> Vec<([u32; 2], f64)> {
        let Some(permeability) = &model.permeability else {
            return Vec::new();
        };
        let mut found = Vec::new();
        let connections = model.graph.connections.iter().enumerate();
        for ((at, c), &t) in connections.zip(&permeability.transmissibility) {
            let is_active = c.cells.iter().all(|&cell| model.is_active(cell as usize));
            if is_active && model.barriers.label(at).is_some() {
                let k = c.cells.map(|cell| {
                    permeability
                        .rock
                        .mobility(cell as usize)
                        .normal_component(c.normal)
                });
                let factor = t / c.area * (c.distance[0] / k[0] + c.distance[1] / k[1]);
                if factor < 1.0 - FACTOR_TOLERANCE {
                    found.push((c.cells, factor.max(CLOSED_FACTOR)));
                }
            }
        }
        found
    }

    fn write(&self, out: FileWriter, model: &Model) -> WriteResult {
        let (layers, columns) = (self.layers, self.columns);
        writeln!(
            out,
            "BEGIN OPTIONS\n  LENGTH_UNITS METERS\nEND OPTIONS\n\nBEGIN DIMENSIONS\n  NLAY {layers}\n\
             \x20 NCPL {columns}\n  NVERT {}\nEND DIMENSIONS\n\nBEGIN GRIDDATA\n  TOP\n    INTERNAL FACTOR 1.0",
            self.vertices.len()
        )?;
        // What is missing lies, without thickness, where the cell above it ends.
        let first = |column: usize| (0..layers).find_map(|l| self.cells[l * columns + column]);
        let last = |column: usize| {
            (0..layers)
                .rev()
                .find_map(|l| self.cells[l * columns + column])
        };
        let top = |column: usize| first(column).map_or(0.0, |cell| self.z_bounds[cell as usize][0]);
        let bottom = |at: usize| {
            let (layer, column) = (at / columns, at % columns);
            let above = (0..=layer)
                .rev()
                .find_map(|l| self.cells[l * columns + column]);
            above.map_or(top(column), |cell| self.z_bounds[cell as usize][1])
        };
        write_numbers(out, columns, top)?;
        writeln!(out, "  BOTM\n    INTERNAL FACTOR 1.0")?;
        // MODFLOW reads layer by layer, each from a line of its own.
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

/// The area of a face seen from above, positive if it turns anticlockwise, and its mean z.
fn mean_height(ring: &[[f64; 3]], apex: [f64; 3]) -> (f64, f64) {
    let (mut area, mut sum) = (0.0, 0.0);
    for i in 0..ring.len() {
        let (p, q) = (ring[i], ring[(i + 1) % ring.len()]);
        let u = [p[0] - apex[0], p[1] - apex[1]];
        let v = [q[0] - apex[0], q[1] - apex[1]];
        let part = 0.5 * (u[0] * v[1] - u[1] * v[0]);
        area += part;
        sum += part * (p[2] + q[2] + apex[2]) / 3.0;
    }
    (area, sum / area)
}
