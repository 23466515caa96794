//! Corner-point grids of reservoir simulators, in files.
//!
//! - `egrid`: Eclipse's binary EGRID, with the properties of the INIT file beside it
//! - `grdecl`: keywords as text (GRDECL, or a deck that includes them)
//! - `cells`: positions and volumes of cells
//! - `write`: writes a grid as GRDECL or EGRID
//!
//! A grid has pillars, which are straight lines (`COORD`), and cells between four of them, whose eight
//! corners are depths on these pillars (`ZCORN`). Cells that share a pillar need not share corners: that
//! is how a fault is stored. Indices are written `[i, j, k]`; i is fastest in all arrays, and k grows
//! downwards.
//!
//! `FILE:NAME` names a property of the grid in `FILE`.

mod cells;
mod egrid;
mod grdecl;
mod write;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::error::{Cause, Error, Result, cause};
use crate::geometry::grid_index::offset_of;
use crate::units::{self, Quantity, Unit};

pub(crate) use cells::{CornerPoints, Pillar};
pub(crate) use write::{GRID_EXTENSIONS, write_grid};

/// Number of bytes at the start of a file from which a grid is recognised.
const DETECTION_BYTES: u64 = 1 << 16;

/// Largest number of cells that is read. Offsets of corners then fit into 64 bits with room to spare, and
/// a grid of this size takes 150 GB.
const MAX_CELLS: usize = 1 << 31;

/// Bytes of memory for each cell: eight corners, and one value of a property.
const BYTES_PER_CELL: f64 = 80.0;

/// Largest number of properties that an error lists.
const MAX_LISTED: usize = 40;

/// Remedy where a grid is stored in a way that is not read, but any simulator can write an EGRID.
const NOSIM_REMEDY: &str =
    "run the simulator on the deck with NOSIM in RUNSPEC, and give the EGRID that it writes";

/// The property that numbers the layers, from 1. Every grid has it.
pub(crate) const LAYER_PROPERTY: &str = "K";

/// Names by which `convert` is asked for the faults of a grid alone.
pub(crate) const FAULTS_NAME: &str = "FAULTS";

/// Property that gives labels if none is named and the file has it.
const DEFAULT_PROPERTY: &str = "FIPNUM";

/// A property of a grid.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GridProperty {
    /// Keyword, in upper case.
    pub name: String,
    /// One value for each cell; NaN where the file has none.
    pub values: Vec<f64>,
    /// `true` if the values are whole numbers, so that they can be labels.
    pub is_whole: bool,
}

/// Faces of cells that belong to a named fault.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FaultFaces {
    /// Name of the fault.
    pub name: String,
    /// First and last cell along i, j and k, counted from 0, both included.
    pub cells: [[usize; 2]; 3],
    /// Axis across which the faces lie: 0 for i, 1 for j, 2 for k.
    pub axis: usize,
    /// `true` for the faces towards larger indices.
    pub is_upper: bool,
}

/// Position of a grid in the world: GRIDUNIT, MAPUNITS and MAPAXES.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct MapFrame {
    /// Unit of the grid; `None` if the file does not say it.
    pub grid_unit: Option<Unit>,
    /// `true` if coordinates are those of the map already (`GRIDUNIT METRES MAP`).
    pub is_map_relative: bool,
    /// Unit of the map.
    pub map_unit: Option<Unit>,
    /// A point on the y axis of the grid, its origin, and a point on its x axis, in the map.
    pub map_axes: Option<[f64; 6]>,
}

/// A corner-point grid as its file stores it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GridFile {
    /// The file of the grid.
    pub path: PathBuf,
    /// Kind of file, for messages.
    pub kind: &'static str,
    /// Number of cells along i, j and k.
    pub dims: [usize; 3],
    /// Upper and lower point (x, y, depth) of each pillar, in rows along i.
    pub coord: Vec<f64>,
    /// Depths of corners, in the order of the keyword `ZCORN`.
    pub zcorn: Vec<f64>,
    /// `true` for each active cell. Empty if all are.
    pub active: Vec<bool>,
    /// Position in the world.
    pub frame: MapFrame,
    /// Properties that were read.
    pub properties: Vec<GridProperty>,
    /// Names of all properties of the file.
    pub property_names: Vec<String>,
    /// Named faults.
    pub faults: Vec<FaultFaces>,
    /// Messages for the user.
    pub notes: Vec<String>,
}

/// Selects the properties that are read, by their names.
pub(crate) type PropertyFilter<'a> = &'a dyn Fn(&str) -> bool;

/// Splits `FILE:NAME` into the file and the property. Returns `None` unless the file holds a grid.
pub(crate) fn split_name(path: &Path) -> Option<(PathBuf, String)> {
    let (file, name) = path.to_str()?.rsplit_once(':')?;
    let is_name = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    (is_name && is_grid(Path::new(file))).then(|| (file.into(), name.to_ascii_uppercase()))
}

/// Returns `true` if a file begins as files with a corner-point grid do.
pub(crate) fn is_grid(path: &Path) -> bool {
    let mut head = Vec::new();
    let file = path.is_file().then(|| File::open(path).ok()).flatten();
    let read = file.map(|file| file.take(DETECTION_BYTES).read_to_end(&mut head));
    read.is_some_and(|read| read.is_ok()) && (egrid::looks_like(&head) || grdecl::looks_like(&head))
}

impl GridFile {
    /// Reads the grid that `FILE` or `FILE:NAME` names, and the properties that `filter` accepts. Also
    /// returns the name of the property.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file is damaged or holds no corner-point grid that can be read, and
    /// [`Error::Job`] if there is not enough memory for it.
    pub fn open(path: &Path, filter: PropertyFilter<'_>) -> Result<(Self, Option<String>)> {
        let (file, name) = match split_name(path) {
            Some((file, name)) => (file, Some(name)),
            None => (path.to_path_buf(), None),
        };
        let is_wanted = |keyword: &str| filter(keyword) || name.as_deref() == Some(keyword);
        let mut head = Vec::new();
        let read = crate::files::open(&file, "give the file of a grid")?
            .take(DETECTION_BYTES)
            .read_to_end(&mut head);
        read.map_err(|e| crate::error::io_error(&file, "read", e))?;
        let grid = if egrid::looks_like(&head) {
            egrid::read(&file, &is_wanted)?
        } else {
            grdecl::read(&file, &is_wanted, name.as_deref())?
        };
        grid.check()?;
        Ok((grid, name))
    }

    /// Reads the grid that `FILE` or `FILE:NAME` names, with the property whose values are labels or
    /// samples: the one that is named, else FIPNUM if the file has it, else the numbers of layers.
    ///
    /// # Errors
    /// Returns the errors of [`open`](Self::open), and [`Error::Io`] if the file has no such property.
    pub fn open_property(path: &Path, filter: PropertyFilter<'_>) -> Result<(Self, GridProperty)> {
        let is_named = split_name(path).is_some();
        let (mut grid, name) = Self::open(path, &|keyword| {
            filter(keyword) || !is_named && keyword == DEFAULT_PROPERTY
        })?;
        let name = name.unwrap_or_else(|| {
            let has_default = grid.property_names.iter().any(|n| n == DEFAULT_PROPERTY);
            let default = if has_default {
                DEFAULT_PROPERTY
            } else {
                LAYER_PROPERTY
            };
            let others = grid.listed_properties();
            let file = grid.path.display();
            grid.notes.push(format!(
                "the values of {default} are read; {file}:NAME names another: {others}"
            ));
            default.to_string()
        });
        let property = grid.property(&name)?;
        Ok((grid, property))
    }

    /// Returns a property of the file, or the numbers of layers.
    fn property(&self, name: &str) -> Result<GridProperty> {
        if let Some(property) = self.properties.iter().find(|p| p.name == name) {
            return Ok(property.clone());
        }
        let [nx, ny, nz] = self.dims;
        let whole = |values| GridProperty {
            name: name.into(),
            values,
            is_whole: true,
        };
        match name {
            LAYER_PROPERTY => Ok(whole(
                (1..=nz)
                    .flat_map(|k| std::iter::repeat_n(k as f64, nx * ny))
                    .collect(),
            )),
            "ACTNUM" => {
                let cells = 0..self.cell_count();
                Ok(whole(
                    cells
                        .map(|c| f64::from(u8::from(self.is_active(c))))
                        .collect(),
                ))
            }
            _ => {
                let problem = format!("has no property {name} of {} cells", self.cell_count());
                let remedy = format!("name one of {}", self.listed_properties());
                Err(self.error(problem, remedy))
            }
        }
    }

    /// Returns the names of the properties as a list in a sentence.
    fn listed_properties(&self) -> String {
        let mut names: Vec<&str> = vec![LAYER_PROPERTY, "ACTNUM"];
        names.extend(self.property_names.iter().map(String::as_str));
        let count = names.len();
        names.truncate(MAX_LISTED);
        let more = match count - names.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        names.join(", ") + &more
    }

    /// Returns the number of cells.
    pub fn cell_count(&self) -> usize {
        self.dims.iter().product()
    }

    /// Returns the offset of a cell in arrays.
    pub fn cell_index(&self, cell: [usize; 3]) -> usize {
        offset_of(self.dims, cell)
    }

    /// Returns `true` if a cell is active.
    pub fn is_active(&self, cell: usize) -> bool {
        self.active.is_empty() || self.active[cell]
    }

    /// Creates an error about the file.
    pub fn error(&self, problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
        Error::Io(cause(self.path.display(), problem, remedy))
    }

    /// Checks that all coordinates are numbers and that a cell is active.
    fn check(&self) -> Result<()> {
        if let Some(at) = self.coord.iter().position(|x| !x.is_finite()) {
            let problem = format!(
                "COORD holds a number that is not finite, of pillar {}",
                at / 6 + 1
            );
            return Err(self.error(problem, crate::files::REWRITE_DAMAGED));
        }
        if let Some(at) = self.zcorn.iter().position(|z| !z.is_finite()) {
            let problem = format!("ZCORN holds a number that is not finite, value {}", at + 1);
            return Err(self.error(problem, crate::files::REWRITE_DAMAGED));
        }
        if !self.active.is_empty() && !self.active.contains(&true) {
            return Err(self.error("has no active cell", "correct ACTNUM"));
        }
        Ok(())
    }
}

/// Cells of one value of a property.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GridRegion {
    /// The value.
    pub value: i64,
    /// Number of active cells.
    pub cells: usize,
    /// Their volume.
    pub volume: f64,
    /// Their pore volume, if the file has PORO.
    pub pore_volume: Option<f64>,
}

/// Description of a corner-point grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GridDescription {
    /// Number of cells along i, j and k.
    pub dims: [usize; 3],
    /// Number of active cells.
    pub active: usize,
    /// Unit of lengths.
    pub unit: String,
    /// Volume of the active cells.
    pub volume: f64,
    /// Pore volume of the active cells: porosity times net-to-gross ratio times volume, if the file has PORO.
    pub pore_volume: Option<f64>,
    /// `true` if the axes i, j and k (downwards) are left-handed.
    pub is_left_handed: bool,
    /// Number of active cells that are turned inside out.
    pub inverted: usize,
    /// Names of the properties.
    pub properties: Vec<String>,
    /// Name of the property of `regions`.
    pub property: String,
    /// Cells of each value, if the values are whole numbers.
    pub regions: Vec<GridRegion>,
}

/// Largest number of values of which the volumes are listed.
const MAX_REGIONS: usize = 10_000;

/// Describes the grid that `FILE` or `FILE:NAME` names.
///
/// # Errors
/// Returns the errors of [`GridFile::open_property`].
pub(crate) fn describe(path: &Path) -> Result<GridDescription> {
    let pore_keywords = ["PORO", "NTG"];
    let (grid, property) = GridFile::open_property(path, &|name| pore_keywords.contains(&name))?;
    let [porosity, net_to_gross] =
        pore_keywords.map(|name| grid.properties.iter().find(|p| p.name == name));
    let cells = grid.corner_points();
    let volumes = cells.volumes();
    let pore_volume = |cell: usize| {
        let net = net_to_gross.map_or(1.0, |p| p.values[cell]);
        porosity.map(|p| p.values[cell] * net * volumes[cell].abs())
    };
    let active = || (0..grid.cell_count()).filter(|&cell| grid.is_active(cell));
    // Values that a file does not give (NaN) count as none.
    let sum_of_pores = |cells: &mut dyn Iterator<Item = usize>| {
        porosity.map(|_| {
            cells
                .filter_map(pore_volume)
                .filter(|v| v.is_finite())
                .sum::<f64>()
        })
    };
    let signed: f64 = active().map(|cell| volumes[cell]).sum();
    let mut regions: std::collections::BTreeMap<i64, Vec<usize>> = Default::default();
    if property.is_whole {
        for cell in active().filter(|&cell| property.values[cell].is_finite()) {
            regions
                .entry(property.values[cell] as i64)
                .or_default()
                .push(cell);
        }
    }
    if regions.len() > MAX_REGIONS {
        regions.clear();
    }
    Ok(GridDescription {
        dims: grid.dims,
        active: active().count(),
        unit: grid.frame.unit().symbol.into(),
        volume: active().map(|cell| volumes[cell].abs()).sum(),
        pore_volume: sum_of_pores(&mut active()),
        is_left_handed: signed < 0.0,
        inverted: active()
            .filter(|&cell| volumes[cell] * signed < 0.0)
            .count(),
        properties: grid.property_names.clone(),
        property: property.name,
        regions: regions
            .into_iter()
            .map(|(value, cells)| GridRegion {
                value,
                cells: cells.len(),
                volume: cells.iter().map(|&cell| volumes[cell].abs()).sum(),
                pore_volume: sum_of_pores(&mut cells.iter().copied()),
            })
            .collect(),
    })
}

/// Returns the unit of length that a file names.
///
/// # Errors
/// Returns a cause without a place if the unit is not known.
fn length_unit(name: &str) -> std::result::Result<Unit, Cause> {
    // Eclipse stores at most eight characters of a word.
    let name = if name.trim().eq_ignore_ascii_case("US_SURVE") {
        "us survey foot"
    } else {
        name
    };
    let unit = units::find(name).filter(|unit| unit.quantity == Quantity::Length);
    unit.ok_or_else(|| {
        let problem = format!("has the unit '{}', which is not known", name.trim());
        cause("", problem, "write METRES, FEET or CM")
    })
}

/// Checks the number of cells that a file claims. Returns the number of pillars and of cells.
///
/// # Errors
/// Returns a cause without a place if there is no cell, or if there are too many.
fn check_dims(dims: [i64; 3]) -> std::result::Result<([usize; 3], [usize; 2]), Cause> {
    let sizes = dims.map(|n| usize::try_from(n).unwrap_or(0));
    let [nx, ny, nz] = sizes;
    let cells = nx.checked_mul(ny).and_then(|n| n.checked_mul(nz));
    let pillars = (nx.checked_add(1)).zip(ny.checked_add(1));
    let pillars = pillars.and_then(|(a, b)| a.checked_mul(b));
    match (cells, pillars) {
        (Some(cells @ 1..=MAX_CELLS), Some(pillars @ 1..=MAX_CELLS)) => {
            Ok((sizes, [pillars, cells]))
        }
        _ => {
            let [nx, ny, nz] = dims;
            let problem = format!("claims a grid of {nx} x {ny} x {nz} cells");
            Err(cause("", problem, "give a grid of 1 to 2147483648 cells"))
        }
    }
}

impl MapFrame {
    /// Returns the unit of coordinates in the world: that of the map, if coordinates are converted to
    /// it, or else that of the grid; metres if the file names none.
    pub fn unit(&self) -> Unit {
        let metre = Unit {
            symbol: "m",
            quantity: Quantity::Length,
            size: 1.0,
        };
        let grid = self.grid_unit.unwrap_or(metre);
        match self.map_unit {
            Some(map) if !self.is_map_relative => map,
            _ => grid,
        }
    }

    /// Returns the factor from lengths of the grid to those in the world.
    fn scale(&self) -> f64 {
        match (self.grid_unit, self.map_unit) {
            (Some(grid), Some(map)) if !self.is_map_relative => grid.size / map.size,
            _ => 1.0,
        }
    }

    /// Returns the function from a position in the file (x, y, depth) to one in the world, whose z
    /// grows upwards.
    fn to_world(&self) -> impl Fn([f64; 3]) -> [f64; 3] + Sync + 'static {
        let scale = self.scale();
        let axes = self.map_axes.filter(|_| !self.is_map_relative);
        let [origin, along_x, along_y] = match axes {
            Some([y1, y2, x0, y0, x1, x2]) => {
                let unit = |[a, b]: [f64; 2]| {
                    let length = a.hypot(b);
                    [a / length, b / length]
                };
                [[x0, y0], unit([x1 - x0, x2 - y0]), unit([y1 - x0, y2 - y0])]
            }
            None => [[0.0; 2], [1.0, 0.0], [0.0, 1.0]],
        };
        move |[x, y, depth]| {
            let [x, y] = [x * scale, y * scale];
            [
                origin[0] + x * along_x[0] + y * along_y[0],
                origin[1] + x * along_x[1] + y * along_y[1],
                -depth * scale,
            ]
        }
    }

    /// Sets the axes of the map. Axes without a length are left out; then a note is returned.
    fn set_map_axes(&mut self, axes: [f64; 6]) -> Option<String> {
        let [y1, y2, x0, y0, x1, x2] = axes;
        let area = (x1 - x0) * (y2 - y0) - (x2 - y0) * (y1 - x0);
        let is_usable = axes.iter().all(|x| x.is_finite()) && area != 0.0;
        self.map_axes = is_usable.then_some(axes);
        (!is_usable).then(|| {
            "MAPAXES does not span a plane: coordinates of the grid are taken for those of the map"
                .into()
        })
    }
}
