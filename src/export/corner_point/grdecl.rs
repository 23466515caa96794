//! Writes a corner-point grid (Eclipse GRDECL) for simulators that cannot read unstructured
//! connections. The model is resampled on [`pillars`](super::pillars) and
//! [`layers`](super::layers).
//!
//! `NAME.GRDECL` is for the GRID section of a deck, and `NAME-regions.GRDECL` with FIPNUM is for
//! REGIONS. If the rock of the model is known, `NAME.DATA` is a deck that includes both.
//! `NAME-edit.GRDECL`, for the EDIT section, is written if faults need it (see
//! [`faults`](super::faults)). Units are METRIC, and z is depth.

use std::ffi::OsStr;
use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};

use crate::geometry::grid_index::index_at;
use crate::parallel::prelude::*;

use super::cell_walk::CellWalker;
use super::faults::FaultResistances;
use super::grid::CornerPointGrid;
use super::layers::{GridLayers, column_lines};
use super::pillars::{Outline, Pillars};
use super::{seals, wells};
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::export::simulators::deck::{
    self, AquiferConnection, CONNATE_WATER_SATURATION, WellConnection,
};
use crate::files::Batch;
use crate::files::text::{FileWriter, TextBuilder, WriteResult, write_items, write_numbers};
use crate::model::reservoir::seal_check::SealNetwork;
use crate::model::reservoir::{Aquifer, BAR, Fluid, MILLIDARCY, Model};
use crate::{Result, memory};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "grdecl",
    description: "corner-point grid, resampled, for Eclipse and similar simulators without NNC",
    extensions: &["GRDECL", "grdecl"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::NetToGross,
        ExportContent::DeckRegions,
        ExportContent::CutOffs,
        ExportContent::Faults,
        ExportContent::ClosedFaults,
        ExportContent::Grid,
        ExportContent::Wells,
        ExportContent::Fluid,
        ExportContent::Study,
        ExportContent::InitialPressure,
        ExportContent::Duration,
    ],
    deck_path: Some(deck_path),
    names: FormatNames {
        regions: Naming::Numbers,
        max_region_number: Some(deck::MAX_REGION_NUMBER),
        wells: Some(deck::NAMES),
        multipliers: Some(deck::NAMES),
        table: TablePlace::Comments("-- "),
        ..FormatNames::NONE
    },
    write,
};

/// Number of lines through a column along i and along j, on which cells are averaged.
const LINES_PER_AXIS: usize = 3;
const ERROR_PLACE: &str = "a corner-point grid";
/// End of the first line of a deck with a corner-point grid.
const DECK_TITLE_SUFFIX: &str = "a corner-point grid";

/// Returns `true` if a file is a deck with a corner-point grid that this module wrote.
pub fn is_corner_point_deck(path: &Path) -> bool {
    let file = std::fs::File::open(path).map(std::io::BufReader::new);
    let mut first = String::new();
    let line = file.and_then(|file| file.take(200).read_line(&mut first));
    line.is_ok() && first.trim_end().ends_with(DECK_TITLE_SUFFIX)
}

/// Returns the path of the deck beside a corner-point grid: `NAME.DATA`, or `NAME-grid.DATA` if
/// another file has that name.
pub fn deck_path(path: &Path) -> PathBuf {
    let usual = path.with_extension("DATA");
    if !usual.exists() || is_corner_point_deck(&usual) {
        return usual;
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-grid.DATA"))
}

/// Sums over the contents of one cell of the grid.
#[derive(Clone, Default)]
struct CellSum {
    /// Total weight (length of lines in the cell), and the weight of active cells.
    weight: f64,
    active_weight: f64,
    porosity: f64,
    /// Weighted sums of the logarithms of the permeability along i, j and z.
    permeability: [f64; 3],
    net_to_gross: f64,
    /// Weights of the regions, and of the numbers of [`DeckRegions::keywords`].
    regions: [Vec<(i32, f64)>; 5],
}

/// Calls a function with the grid of a model. Its numbers of columns and layers are the
/// [`grid`](Model::grid) of the model.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the mesh has no vertical sides, and the errors of
/// the function.
fn with_grid<T>(
    model: &Model,
    names: &ExportNames,
    call: impl FnOnce(&FilledGrid<'_>, &CellWalker) -> Result<T>,
) -> Result<T> {
    let graph = &model.graph;
    let outline = Outline::new(graph, &model.mesh.nodes, ERROR_PLACE)?;
    let [n, m, layers] = model.grid.unwrap_or_else(|| default_dims(model, &outline));
    let cells = [n, m, layers].iter().map(|&n| n as f64).product::<f64>();
    let description = format!("a grid of {cells} cells");
    memory::ensure_available("grid", 350.0 * cells, description, "ask for fewer cells")?;
    let pillars = Pillars::new(&outline, [n, m], graph);
    let walker = CellWalker::new(graph);
    let layers = GridLayers::new(model, &walker, &pillars, layers);
    let rock = RockLogarithms::new(model, &pillars);
    let columns: Vec<Vec<CellSum>> = (0..m)
        .into_par_iter()
        .flat_map_iter(|j| {
            let mut start_cell = 0;
            let sums = |i| {
                column_sums(
                    &rock,
                    &walker,
                    &pillars,
                    &layers,
                    j * n + i,
                    &mut start_cell,
                )
            };
            (0..n).map(sums).collect::<Vec<_>>()
        })
        .collect();
    let grid = CornerPointGrid {
        pillars: &pillars,
        layers: &layers,
    };
    let filled = FilledGrid {
        model,
        names,
        grid,
        columns,
    };
    call(&filled, &walker)
}

/// Returns the cells of the grid, and the connections that its files leave open, for the check of
/// closed faults.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the mesh has no vertical sides.
pub fn seal_network(model: &Model, names: &ExportNames) -> Result<SealNetwork> {
    with_grid(model, names, |filled, walker| {
        let permeability = |at: usize| {
            let cell = filled.cell(at);
            let is_active = cell.active_weight > 0.0;
            let uniform = model.permeability.is_none().then_some([1.0; 3]);
            is_active.then(|| uniform.or_else(|| cell.mean_permeability()))?
        };
        Ok(seals::network(model, walker, &filled.grid, permeability))
    })
}

/// Writes the grid.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the mesh has no vertical sides, and
/// [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    with_grid(model, names, |filled, walker| {
        let resistances = FaultResistances::new(model, walker, &filled.grid);
        write_files(filled, &resistances, batch, path)
    })
}

fn write_files(
    filled: &FilledGrid<'_>,
    resistances: &FaultResistances,
    batch: &mut Batch,
    path: &Path,
) -> Result<()> {
    let model = filled.model;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let regions = path.with_file_name(format!("{stem}-regions.{ending}"));
    let edits = path.with_file_name(format!("{stem}-edit.{ending}"));
    batch.write(path, |out| filled.write_grid(out, resistances))?;
    batch.write(&regions, |out| filled.write_regions(out))?;
    let has_edits = resistances.has_edits();
    if has_edits {
        batch.write(&edits, |out| resistances.write_edits(out))?;
    }
    let (Some(porosity), Some(_)) = (&model.porosity, &model.permeability) else {
        return Ok(());
    };
    deck::check(model, porosity)?;
    let rock = |at: [usize; 3]| {
        let cell = filled.cell(filled.grid.cell_index(at));
        let [i, j, k] = cell.mean_permeability()?;
        let net = match model.net_to_gross {
            Some(_) => cell.mean_net_to_gross(),
            None => 1.0,
        };
        Some([i * net, j * net, k])
    };
    let connections: Vec<Vec<WellConnection>> = (model.case.wells.iter())
        .map(|well| wells::well_connections(well, &filled.grid, rock))
        .collect::<Result<_>>()?;
    deck::check_skin(&model.case, &connections)?;
    let mut includes = vec![path, regions.as_path()];
    includes.extend(has_edits.then_some(edits.as_path()));
    let includes: Vec<&OsStr> = (includes.iter())
        .map(|path| path.file_name().unwrap_or_default())
        .collect();
    batch.write(&deck_path(path), |out| {
        filled.write_deck(out, &includes, &connections)
    })
}

/// A grid and the contents of its cells.
struct FilledGrid<'a> {
    model: &'a Model,
    names: &'a ExportNames,
    grid: CornerPointGrid<'a>,
    /// Contents of the cells of each column, from the top.
    columns: Vec<Vec<CellSum>>,
}

impl FilledGrid<'_> {
    fn cell(&self, at: usize) -> &CellSum {
        &self.columns[at % self.columns.len()][at / self.columns.len()]
    }

    /// Writes the grid and the rock in its cells.
    fn write_grid(&self, out: FileWriter, resistances: &FaultResistances) -> WriteResult {
        let (model, CornerPointGrid { pillars, layers }) = (self.model, &self.grid);
        let ([n, m], cells) = (pillars.columns, self.columns.len() * layers.count);
        let inclination = if pillars.ends.iter().any(|[top, bottom]| top != bottom) {
            "inclined along features"
        } else {
            "upright"
        };
        let layering = if layers.follows_regions {
            "between regions"
        } else {
            "of equal thickness"
        };
        writeln!(
            out,
            "-- atomesh {}: {} cells of a mesh on {n} x {m} columns; pillars {inclination}, layers {layering}",
            env!("CARGO_PKG_VERSION"),
            model.len()
        )?;
        write!(out, "{}", self.names.comments())?;
        writeln!(out, "SPECGRID\n {n} {m} {} 1 F /\n", layers.count)?;
        writeln!(out, "COORD")?;
        write_items(out, pillars.ends.len(), |text, p| {
            for (end, z) in pillars.ends[p].iter().zip(pillars.z) {
                text.point([end[0], end[1], -z]);
            }
            text.end_line();
        })?;
        writeln!(out, "/\n\nZCORN")?;
        // ZCORN has for each layer its top and its bottom, and for each of these the rows of
        // corners.
        let rows = 2 * m;
        write_items(out, 2 * layers.count * rows, |text, item| {
            let (level, row) = (item / rows, item % rows);
            let k = level.div_ceil(2);
            for i in 0..2 * n {
                let corner = i % 2 + 2 * (row % 2);
                text.spaced_real(-layers.corner_depths(row / 2 * n + i / 2, corner)[k]);
            }
            text.end_line();
        })?;
        writeln!(out, "/\n\nACTNUM")?;
        write_ints(out, cells, |at| {
            i64::from(self.cell(at).active_weight > 0.0)
        })?;
        if self.grid.has_pinched_cells() {
            // Without PINCH, a layer without thickness separates the layers above and below it.
            let thickness = self.grid.pinch_thickness();
            writeln!(out, "PINCH\n {thickness:e} GAP 1* TOPBOT TOP /\n")?;
        }
        if model.porosity.is_some() {
            writeln!(out, "PORO")?;
            write_numbers(out, cells, |at| match self.cell(at).net_to_gross {
                0.0 => 0.0,
                net => self.cell(at).porosity / net,
            })?;
            writeln!(out, "/\n")?;
        }
        if model.net_to_gross.is_some() {
            writeln!(out, "NTG")?;
            write_numbers(out, cells, |at| self.cell(at).mean_net_to_gross())?;
            writeln!(out, "/\n")?;
        }
        if model.permeability.is_some() {
            for (k, name) in ["PERMX", "PERMY", "PERMZ"].into_iter().enumerate() {
                writeln!(out, "{name}")?;
                write_numbers(out, cells, |at| {
                    let mean = self.cell(at).mean_permeability();
                    mean.map_or(0.0, |mean| mean[k] / MILLIDARCY)
                })?;
                writeln!(out, "/\n")?;
            }
        }
        resistances.write(out, &self.names.multipliers, &self.grid)
    }

    /// Writes the region of each cell, and the numbers of tables if they are given.
    fn write_regions(&self, out: FileWriter) -> WriteResult {
        let cells = self.columns.len() * self.grid.layers.count;
        let keywords = self.model.deck_regions.keywords();
        for (kind, (keyword, numbers)) in (1..).zip(keywords) {
            let (kind, is_region) = match (numbers, keyword) {
                (Some(_), _) => (kind, false),
                (None, "FIPNUM") => (0, true),
                _ => continue,
            };
            writeln!(out, "{keyword}")?;
            write_ints(out, cells, |at| {
                // The region with the largest part of the cell counts.
                let regions = self.cell(at).regions[kind].iter();
                let largest = regions.max_by(|a, b| a.1.total_cmp(&b.1));
                largest.map_or(1, |&(number, _)| {
                    i64::from(if is_region {
                        self.names.region_number(number)
                    } else {
                        number
                    })
                })
            })?;
        }
        Ok(())
    }

    /// Writes a deck that includes the files of the grid, the regions, and edits of connections if there are
    /// any.
    fn write_deck(
        &self,
        out: FileWriter,
        includes: &[&OsStr],
        connections: &[Vec<WellConnection>],
    ) -> WriteResult {
        let (model, grid) = (self.model, &self.grid);
        let (cells, top) = (grid.dims().iter().product(), model.top_depth());
        let title = DECK_TITLE_SUFFIX;
        let aquifers = model.case.aquifers.iter();
        let aquifers: Vec<Vec<AquiferConnection>> = aquifers
            .map(|aquifer| self.aquifer_connections(aquifer))
            .collect();
        let size = |connections: &Vec<AquiferConnection>| {
            let cells = connections.iter().map(|c| c.cells.map(|[a, b]| b + 1 - a));
            cells.map(|[i, j, k]| i * j * k).sum::<usize>()
        };
        let aquifer_cells = aquifers.iter().map(size).max().unwrap_or_default();
        let dims = grid.dims();
        deck::write_runspec(
            out,
            model,
            self.names,
            title,
            dims,
            connections,
            aquifer_cells,
        )?;
        let include = |out: FileWriter, name: &OsStr| {
            writeln!(out, "INCLUDE\n '{}' /\n", name.to_string_lossy())
        };
        writeln!(out, "GRID\nINIT\nGRIDFILE\n 0 1 /\n")?;
        include(out, includes[0])?;
        if let Some(edits) = includes.get(2) {
            writeln!(out, "EDIT\n")?;
            include(out, edits)?;
        }
        deck::write_props(out, model)?;
        writeln!(out, "REGIONS\n")?;
        include(out, includes[1])?;
        writeln!(out, "SOLUTION\n")?;
        if !deck::write_equilibrium(out, &model.case)? {
            deck::write_array(out, "PRESSURE", cells, |at| {
                let middle = grid.point(index_at(grid.dims(), at), [0.5; 3]);
                model.initial_pressure(-middle[2], top) / BAR
            })?;
            if model.case.fluid == Fluid::OilWater {
                writeln!(out, "SWAT\n {cells}*{CONNATE_WATER_SATURATION} /")?;
            }
        }
        deck::write_aquifers(out, &model.case, &aquifers)?;
        deck::write_schedule(out, model, self.names, connections)
    }

    /// Returns the cells of the grid to which an aquifer is connected: the active ones on its side,
    /// in runs along k.
    fn aquifer_connections(&self, aquifer: &Aquifer) -> Vec<AquiferConnection> {
        let [n, m, layers] = self.grid.dims();
        let [x, y, z] = aquifer.normal;
        let [i, j] = self.grid.pillars.axes.map(|axis| axis[0] * x + axis[1] * y);
        let is_deep = |cell: [usize; 3]| {
            let depth = -self.grid.point(cell, [0.5; 3])[2];
            aquifer.option.below.is_none_or(|below| depth > below)
        };
        let is_connected = |cell: [usize; 3]| {
            self.cell(self.grid.cell_index(cell)).active_weight > 0.0 && is_deep(cell)
        };
        let mut connections = Vec::new();
        let mut add = |column: [usize; 2], [k, end]: [usize; 2], face| {
            let [i, j] = column.map(|c| c + 1);
            connections.push(AquiferConnection {
                cells: [[i; 2], [j; 2], [k + 1, end]],
                face,
                area: None,
            });
        };
        let columns = (0..m).flat_map(|j| (0..n).map(move |i| [i, j]));
        if z.abs() > i.abs().max(j.abs()) {
            for column in columns {
                // The outermost active cell of the column.
                let mut all: Vec<usize> = (0..layers).collect();
                let face = if z > 0.0 { "K-" } else { "K+" };
                if z <= 0.0 {
                    all.reverse();
                }
                let is_outermost = |k: &&usize| is_connected([column[0], column[1], **k]);
                if let Some(&k) = all.iter().find(is_outermost) {
                    add(column, [k, k + 1], face);
                }
            }
            return connections;
        }
        let axis = usize::from(j.abs() > i.abs());
        let is_upper = [i, j][axis] > 0.0;
        let face = [["I-", "I+"], ["J-", "J+"]][axis][usize::from(is_upper)];
        let edge = if is_upper { [n, m][axis] - 1 } else { 0 };
        for column in columns.filter(|column| column[axis] == edge) {
            let mut k = 0;
            while k < layers {
                let start = k;
                while k < layers && is_connected([column[0], column[1], k]) {
                    k += 1;
                }
                if k > start {
                    add(column, [start, k], face);
                }
                k += 1;
            }
        }
        connections
    }
}

/// Writes integers, 30 per line, and the final slash.
fn write_ints(out: FileWriter, count: usize, value: impl Fn(usize) -> i64 + Sync) -> WriteResult {
    const NUMBERS_PER_LINE: usize = 30;
    write_items(out, count, |text: &mut TextBuilder, i| {
        text.spaced_int(value(i));
        if i % NUMBERS_PER_LINE == NUMBERS_PER_LINE - 1 || i + 1 == count {
            text.end_line();
        }
    })?;
    writeln!(out, "/\n")
}

/// Returns grid dimensions with about as many cells as the mesh has, and with the mean proportions
/// of these cells.
fn default_dims(model: &Model, outline: &Outline) -> [usize; 3] {
    let lengths = outline.lengths();
    let axes = [0, 1].map(|k| outline.edges[k].map(|e| e / lengths[k]));
    let axis_coordinates = |p: [f64; 3]| {
        let [i, j] = axes.map(|a| a[0] * p[0] + a[1] * p[1]);
        [i, j, p[2]]
    };
    // Sums of the distances between the sites of neighbours, along each axis.
    let mut distances = [0.0; 3];
    for c in &model.graph.connections {
        let [a, b] = c
            .cells
            .map(|cell| axis_coordinates(model.graph.site[cell as usize]));
        (0..3).for_each(|k| distances[k] += (a[k] - b[k]).abs());
    }
    // An axis along which no two cells are apart gets one cell. (The mesh of a 2-D image is one
    // layer.)
    let max_distance = distances.iter().copied().fold(0.0, f64::max);
    let ratios: [f64; 3] = std::array::from_fn(|k| {
        if distances[k] > 1e-9 * max_distance {
            lengths[k] / distances[k]
        } else {
            1.0
        }
    });
    let axes = distances
        .iter()
        .filter(|&&a| a > 1e-9 * max_distance)
        .count();
    let scale = model.len() as f64 / ratios.iter().product::<f64>();
    let scale = match axes {
        3 => scale.cbrt(),
        2 => scale.sqrt(),
        _ => scale,
    };
    std::array::from_fn(|k| {
        if distances[k] > 1e-9 * max_distance {
            ((ratios[k] * scale).round() as usize).max(1)
        } else {
            1
        }
    })
}

/// A model, and the logarithms of the permeability of its cells along i, j and z. (Many lines pass
/// each cell.)
struct RockLogarithms<'a> {
    model: &'a Model,
    /// Empty without permeability. Cells that are not active have none.
    permeability: Vec<[f64; 3]>,
}

impl<'a> RockLogarithms<'a> {
    fn new(model: &'a Model, pillars: &Pillars) -> Self {
        let logarithms = |at: usize| {
            let (Some(permeability), true) = (&model.permeability, model.is_active(at)) else {
                return [0.0; 3];
            };
            let net = model.net_to_gross.as_ref().map_or(1.0, |ratios| ratios[at]);
            let k = permeability.rock.mobility(at);
            let [i, j] = pillars.axes.map(|[x, y]| k.normal_component([x, y, 0.0]));
            [i / net, j / net, k.0[2]].map(f64::ln)
        };
        let cells = model.permeability.as_ref().map_or(0, |_| model.len());
        Self {
            model,
            permeability: (0..cells).into_par_iter().map(logarithms).collect(),
        }
    }
}

/// Returns the sums over the contents of each cell of a column.
fn column_sums(
    rock: &RockLogarithms,
    walker: &CellWalker,
    pillars: &Pillars,
    layers: &GridLayers,
    column: usize,
    start_cell: &mut u32,
) -> Vec<CellSum> {
    let mut sums = vec![CellSum::default(); layers.count];
    let position = |k: usize| (k as f64 + 0.5) / LINES_PER_AXIS as f64;
    let positions: Vec<[f64; 2]> = (0..LINES_PER_AXIS * LINES_PER_AXIS)
        .map(|k| [position(k % LINES_PER_AXIS), position(k / LINES_PER_AXIS)])
        .collect();
    let lines = column_lines(walker, pillars, column, &positions, start_cell);
    for (line, [u, v]) in lines.iter().zip(positions) {
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let tops: Vec<f64> = (0..=layers.count)
            .map(|k| {
                (0..4)
                    .map(|c| weights[c] * layers.corner_depths(column, c)[k])
                    .sum()
            })
            .collect();
        let mut k = 0;
        for segment in &line.segments {
            let (top, bottom) = (line.z(segment.start), line.z(segment.end));
            while k > 0 && tops[k] < top {
                k -= 1;
            }
            loop {
                let length = top.min(tops[k]) - bottom.max(tops[k + 1]);
                if length > 0.0 {
                    sums[k].add(rock, segment.cell, length);
                }
                if k + 1 < layers.count && tops[k + 1] > bottom {
                    k += 1;
                } else {
                    break;
                }
            }
        }
    }
    sums
}

impl CellSum {
    /// Returns the geometric mean of the permeability along i, j and z, or `None` if there is no
    /// rock.
    fn mean_permeability(&self) -> Option<[f64; 3]> {
        let mean = || self.permeability.map(|k| (k / self.active_weight).exp());
        (self.active_weight > 0.0).then(mean)
    }

    fn mean_net_to_gross(&self) -> f64 {
        match self.weight {
            0.0 => 0.0,
            weight => self.net_to_gross / weight,
        }
    }

    fn add(&mut self, rock: &RockLogarithms, cell: u32, weight: f64) {
        let (model, at) = (rock.model, cell as usize);
        self.weight += weight;
        // The porosity is that of the reservoir rock, so that pore volumes are those of the lines.
        let net = model.net_to_gross.as_ref().map_or(1.0, |ratios| ratios[at]);
        self.net_to_gross += weight * net;
        if let Some(porosity) = &model.porosity {
            self.porosity += weight * net * porosity[at];
        }
        let is_active = model.is_active(at);
        self.active_weight += if is_active { weight } else { 0.0 };
        if let Some(logarithms) = rock.permeability.get(at).filter(|_| is_active) {
            for (sum, k) in self.permeability.iter_mut().zip(logarithms) {
                *sum += weight * k;
            }
        }
        let keywords = model.deck_regions.keywords();
        let numbers = keywords.map(|(_, numbers)| numbers.map(|numbers| numbers[at] as i32));
        let numbers = std::iter::once(Some(model.graph.region[at])).chain(numbers);
        for (regions, number) in self.regions.iter_mut().zip(numbers) {
            let Some(number) = number else { continue };
            match regions.iter_mut().find(|known| known.0 == number) {
                Some(known) => known.1 += weight,
                None => regions.push((number, weight)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::PolyMesh;
    use crate::mesh::{TriMesh, voronoi};

    /// Returns the numbers of columns and layers in the grid of a 2-D mesh, one unit thick.
    fn grid_dims(mesh: &PolyMesh<2>) -> [usize; 3] {
        let model = Model::new(mesh.extrude(1.0), None);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("A.GRDECL");
        let mut batch = Batch::default();
        let names = ExportNames::new(&model, &FORMAT.names);
        write(&model, &names, &mut batch, &path).unwrap();
        batch.commit().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let tail = text.split("SPECGRID\n").nth(1).unwrap();
        let mut numbers = tail.split_whitespace().map(|word| word.parse().unwrap());
        std::array::from_fn(|_| numbers.next().unwrap())
    }

    #[test]
    fn a_mesh_of_the_plane_is_one_layer() {
        let row = |n: u32| (0..n).map(|i| 0.5 + f64::from(i));
        let atoms: Vec<[f64; 2]> = row(4).flat_map(|y| row(6).map(move |x| [x, y])).collect();
        let cells = voronoi::voronoi_plane_welded(&atoms, [6.0, 4.0], 1e-9).unwrap();
        assert_eq!(grid_dims(&cells), [6, 4, 1]);

        let square = TriMesh {
            nodes: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let mut cells = PolyMesh::from_simplices(&square, &[], &[]).unwrap();
        cells.assign_sides([0.0; 2], [1.0; 2]);
        assert_eq!(grid_dims(&cells)[2], 1);
    }
}
