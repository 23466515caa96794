//! Reads Eclipse's EGRID, and properties from the INIT file beside it.
//!
//! Both are sequences of arrays. An array has a header of 16 bytes (name of 8 characters, number of
//! elements, type of 4 characters) and blocks of elements; the header and each block stand between two
//! copies of their length in bytes. All numbers are big-endian.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use super::{
    BYTES_PER_CELL, GridFile, GridProperty, MapFrame, NOSIM_REMEDY, PropertyFilter, check_dims,
    length_unit,
};
use crate::error::{Cause, Error, Result, cause, io_error};
use crate::files::REWRITE_DAMAGED;
use crate::memory;
use crate::units::Unit;

/// First bytes of an array file: the length of the first header.
const HEADER_BYTES: u32 = 16;

/// Places of values in the array GRIDHEAD.
const GRID_TYPE: usize = 0;
const GRID_DIMS: usize = 1;
const COORDINATE_SETS: usize = 24;
const COORDINATE_TYPE: usize = 26;

/// Places of values in the array INTEHEAD of an INIT file.
const INIT_UNITS: usize = 2;
const INIT_DIMS: usize = 8;
const INIT_ACTIVE: usize = 11;

/// Arrays of an INIT file that describe the model and not its cells, whatever their length.
const INIT_HEADS: [&str; 4] = ["LOGIHEAD", "DOUBHEAD", "TABDIMS", "TAB"];

/// Returns `true` if a file begins with the header of an array.
pub(super) fn looks_like(head: &[u8]) -> bool {
    let names: [&[u8]; 5] = [
        b"FILEHEAD",
        b"GRIDHEAD",
        b"INTEHEAD",
        b"DIMENS  ",
        b"MAPUNITS",
    ];
    head.len() >= 24
        && head[..4] == HEADER_BYTES.to_be_bytes()
        && head[20..24] == HEADER_BYTES.to_be_bytes()
        && names.contains(&&head[4..12])
}

/// Type of the elements of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ElementType {
    /// 32-bit integers.
    Integer,
    /// 32-bit floats.
    Real,
    /// 64-bit floats.
    Double,
    /// Logical values of 4 bytes.
    Logical,
    /// Texts of this number of bytes.
    Text(usize),
    /// Nothing.
    Message,
}

impl ElementType {
    fn parse(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"INTE" => Self::Integer,
            b"REAL" => Self::Real,
            b"DOUB" => Self::Double,
            b"LOGI" => Self::Logical,
            b"CHAR" => Self::Text(8),
            b"MESS" => Self::Message,
            [b'C', digits @ ..] => {
                let length = std::str::from_utf8(digits).ok()?.parse().ok()?;
                Self::Text(length)
            }
            _ => return None,
        })
    }

    fn size(self) -> u64 {
        match self {
            Self::Integer | Self::Real | Self::Logical => 4,
            Self::Double => 8,
            Self::Text(length) => length as u64,
            Self::Message => 0,
        }
    }
}

/// Header of an array.
#[derive(Debug, Clone, PartialEq)]
struct ArrayHeader {
    name: String,
    count: usize,
    element: ElementType,
    /// Offset of the header in the file, for messages.
    offset: u64,
}

/// A file of arrays.
struct ArrayFile {
    path: PathBuf,
    file: BufReader<File>,
    length: u64,
    offset: u64,
}

impl ArrayFile {
    fn open(path: &Path) -> Result<Self> {
        let file = crate::files::open(path, "give an EGRID file")?;
        let length = file
            .metadata()
            .map_err(|e| io_error(path, "read", e))?
            .len();
        Ok(Self {
            path: path.to_path_buf(),
            file: BufReader::new(file),
            length,
            offset: 0,
        })
    }

    /// Creates an error about an array.
    fn error(&self, array: &ArrayHeader, problem: impl std::fmt::Display) -> Error {
        let place = format!(
            "{}, {} at byte {}",
            self.path.display(),
            array.name,
            array.offset
        );
        Error::Io(cause(place, problem, REWRITE_DAMAGED))
    }

    fn error_at(&self, offset: u64, problem: &str) -> Error {
        let place = format!("{}, byte {offset}", self.path.display());
        Error::Io(cause(place, problem, REWRITE_DAMAGED))
    }

    fn read_bytes(&mut self, out: &mut [u8]) -> Result<()> {
        if self.length - self.offset < out.len() as u64 {
            return Err(self.error_at(self.offset, "the file is cut off"));
        }
        let read = self.file.read_exact(out);
        read.map_err(|e| io_error(&self.path, "read", e))?;
        self.offset += out.len() as u64;
        Ok(())
    }

    fn read_length(&mut self) -> Result<u32> {
        let mut bytes = [0; 4];
        self.read_bytes(&mut bytes)?;
        Ok(u32::from_be_bytes(bytes))
    }

    /// Reads the header of the next array; `None` at the end of the file.
    fn next_array(&mut self) -> Result<Option<ArrayHeader>> {
        if self.offset == self.length {
            return Ok(None);
        }
        let offset = self.offset;
        let mut bytes = [0; HEADER_BYTES as usize];
        let is_header = self.read_length()? == HEADER_BYTES && {
            self.read_bytes(&mut bytes)?;
            self.read_length()? == HEADER_BYTES
        };
        let count = i32::from_be_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        let element = ElementType::parse(&bytes[12..]);
        let (true, Ok(count), Some(element)) = (is_header, usize::try_from(count), element) else {
            let problem = "there is no header of an array where one has to be";
            return Err(self.error_at(offset, problem));
        };
        let name = String::from_utf8_lossy(&bytes[..8]).trim_end().to_string();
        let array = ArrayHeader {
            name,
            count,
            element,
            offset,
        };
        if (count as u64).saturating_mul(element.size()) > self.length - self.offset {
            let problem = format!("claims {count} elements, more than the file holds");
            return Err(self.error(&array, problem));
        }
        Ok(Some(array))
    }

    /// Passes each block of an array to `use_block`.
    fn for_each_block(
        &mut self,
        array: &ArrayHeader,
        mut use_block: impl FnMut(&[u8]),
    ) -> Result<()> {
        let total = array.count as u64 * array.element.size();
        let mut block = Vec::new();
        let mut done = 0;
        while done < total {
            let length = self.read_length()?;
            if length == 0 || u64::from(length) > total - done {
                return Err(self.error(array, "has a block of another length than its elements"));
            }
            block.resize(length as usize, 0);
            self.read_bytes(&mut block)?;
            if self.read_length()? != length {
                return Err(self.error(array, "has a block that ends elsewhere than it says"));
            }
            use_block(&block);
            done += u64::from(length);
        }
        Ok(())
    }

    /// Skips the elements of an array.
    fn skip(&mut self, array: &ArrayHeader) -> Result<()> {
        let total = array.count as u64 * array.element.size();
        let mut done = 0;
        while done < total {
            let length = u64::from(self.read_length()?);
            if length == 0 || length > total - done || length + 4 > self.length - self.offset {
                return Err(self.error(array, "has a block of another length than its elements"));
            }
            let seek = self.file.seek_relative(length as i64);
            seek.map_err(|e| io_error(&self.path, "read", e))?;
            self.offset += length;
            self.read_length()?;
            done += length;
        }
        Ok(())
    }

    /// Reads the numbers of an array.
    fn numbers(&mut self, array: &ArrayHeader) -> Result<Vec<f64>> {
        let size = array.element.size() as usize;
        let decode: fn(&[u8]) -> f64 = match array.element {
            ElementType::Integer | ElementType::Logical => {
                |b| f64::from(i32::from_be_bytes([b[0], b[1], b[2], b[3]]))
            }
            ElementType::Real => |b| f64::from(f32::from_be_bytes([b[0], b[1], b[2], b[3]])),
            ElementType::Double => {
                |b| f64::from_be_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]])
            }
            ElementType::Text(_) | ElementType::Message => {
                return Err(self.error(array, "holds no numbers"));
            }
        };
        let mut numbers = Vec::with_capacity(array.count);
        self.for_each_block(array, |block| {
            numbers.extend(block.chunks_exact(size).map(decode));
        })?;
        if numbers.len() != array.count {
            return Err(self.error(array, "has blocks that cut elements apart"));
        }
        Ok(numbers)
    }

    /// Reads this number of numbers.
    fn exact_numbers(
        &mut self,
        array: &ArrayHeader,
        count: usize,
        owner: &str,
    ) -> Result<Vec<f64>> {
        if array.count != count {
            let problem = format!("holds {} numbers, but {owner} need {count}", array.count);
            return Err(self.error(array, problem));
        }
        self.numbers(array)
    }

    /// Reads the texts of an array.
    fn texts(&mut self, array: &ArrayHeader) -> Result<Vec<String>> {
        let ElementType::Text(size @ 1..) = array.element else {
            return Err(self.error(array, "holds no text"));
        };
        let mut texts = Vec::new();
        self.for_each_block(array, |block| {
            let words = block.chunks(size);
            texts.extend(words.map(|word| String::from_utf8_lossy(word).trim().to_string()));
        })?;
        Ok(texts)
    }

    /// Reads a unit of length.
    fn unit(&self, array: &ArrayHeader, name: &str) -> Result<Unit> {
        length_unit(name).map_err(|found: Cause| {
            let place = format!("{}, {}", self.path.display(), array.name);
            Error::Io(cause(place, found.problem, found.remedy))
        })
    }
}

/// Reads a grid, and the properties that `filter` accepts from the INIT file beside it.
pub(super) fn read(path: &Path, filter: PropertyFilter<'_>) -> Result<GridFile> {
    let mut file = ArrayFile::open(path)?;
    let mut parts = GridParts::default();
    let mut first = true;
    while let Some(array) = file.next_array()? {
        if std::mem::take(&mut first) && ["INTEHEAD", "DIMENS"].contains(&&*array.name) {
            return Err(no_egrid(path, &array.name));
        }
        parts.add(&mut file, &array)?;
    }
    let mut grid = parts.into_grid(path)?;
    let init = companion(path);
    if let Some(init) = init {
        read_properties(&mut grid, &init, filter)?;
    }
    Ok(grid)
}

/// Returns the error for a file of arrays that is no EGRID.
fn no_egrid(path: &Path, first: &str) -> Error {
    let (problem, remedy) = if first == "INTEHEAD" {
        (
            "holds properties or results without the grid",
            "give the EGRID beside it; the INIT is read with it",
        )
    } else {
        ("is a grid in the old format GRID", NOSIM_REMEDY)
    };
    Error::Io(cause(path.display(), problem, remedy))
}

/// Returns the INIT file beside a grid, if there is one.
fn companion(path: &Path) -> Option<PathBuf> {
    let endings = ["INIT", "init"].map(|ending| path.with_extension(ending));
    endings.into_iter().find(|path| path.is_file())
}

/// Contents of an EGRID.
#[derive(Default)]
struct GridParts {
    dims: Option<[usize; 3]>,
    counts: [usize; 2],
    coord: Vec<f64>,
    zcorn: Vec<f64>,
    active: Vec<bool>,
    frame: MapFrame,
    notes: Vec<String>,
    /// `true` behind the global grid.
    is_complete: bool,
    refinements: Vec<String>,
    connections: usize,
}

impl GridParts {
    fn add(&mut self, file: &mut ArrayFile, array: &ArrayHeader) -> Result<()> {
        match array.name.as_str() {
            "LGR" => self.refinements.extend(file.texts(array)?),
            "NNCHEAD" => {
                let head = file.numbers(array)?;
                self.connections += head.first().map_or(0, |count| count.max(0.0) as usize);
            }
            "ENDGRID" => {
                self.is_complete = true;
                file.skip(array)?;
            }
            _ if self.is_complete => file.skip(array)?,
            "FILEHEAD" => {
                let head = file.numbers(array)?;
                check_file_head(file, array, &head)?;
            }
            "MAPUNITS" => {
                let words = file.texts(array)?;
                let unit = words.first().map(|name| file.unit(array, name));
                self.frame.map_unit = unit.transpose()?;
            }
            "MAPAXES" => {
                let axes = file.exact_numbers(array, 6, "axes of the map")?;
                let axes = std::array::from_fn(|n| axes[n]);
                self.notes.extend(self.frame.set_map_axes(axes));
            }
            "GRIDUNIT" => {
                let words = file.texts(array)?;
                let unit = words.first().map(|name| file.unit(array, name));
                self.frame.grid_unit = unit.transpose()?;
                self.frame.is_map_relative = words
                    .get(1)
                    .is_some_and(|word| word.eq_ignore_ascii_case("MAP"));
            }
            "GRIDHEAD" => {
                let head = file.numbers(array)?;
                self.add_grid_head(file, array, &head)?;
            }
            "COORD" | "ZCORN" | "ACTNUM" => self.add_geometry(file, array)?,
            _ => file.skip(array)?,
        }
        Ok(())
    }

    fn add_grid_head(&mut self, file: &ArrayFile, array: &ArrayHeader, head: &[f64]) -> Result<()> {
        let value = |at: usize| head.get(at).copied().unwrap_or(0.0);
        let refuse = |problem: &str| Error::Io(cause(file.path.display(), problem, NOSIM_REMEDY));
        if head.len() < GRID_DIMS + 3 {
            return Err(file.error(array, "has no numbers of cells"));
        }
        if value(GRID_TYPE) != 1.0 {
            return Err(refuse("is no corner-point grid but an unstructured one"));
        }
        if value(COORDINATE_SETS) > 1.0 {
            return Err(refuse("has several sets of pillars (NUMRES)"));
        }
        if value(COORDINATE_TYPE) != 0.0 {
            return Err(refuse("has cylindrical coordinates"));
        }
        let dims = [0, 1, 2].map(|n| head[GRID_DIMS + n] as i64);
        let (dims, counts) = check_dims(dims).map_err(|found| file.error(array, found.problem))?;
        self.dims = Some(dims);
        self.counts = counts;
        Ok(())
    }

    fn add_geometry(&mut self, file: &mut ArrayFile, array: &ArrayHeader) -> Result<()> {
        let Some([nx, ny, nz]) = self.dims else {
            return Err(file.error(array, "comes before GRIDHEAD"));
        };
        let [pillars, cells] = self.counts;
        let size = format!("{nx} x {ny} x {nz} cells");
        match array.name.as_str() {
            "COORD" => {
                memory::ensure_available(
                    file.path.display(),
                    BYTES_PER_CELL * cells as f64,
                    format!("a grid of {size}"),
                    "give a part of the grid",
                )?;
                self.coord = file.exact_numbers(array, 6 * pillars, &size)?;
            }
            "ZCORN" => self.zcorn = file.exact_numbers(array, 8 * cells, &size)?,
            _ => {
                let flags = file.exact_numbers(array, cells, &size)?;
                self.active = flags.iter().map(|flag| *flag != 0.0).collect();
            }
        }
        Ok(())
    }

    fn into_grid(mut self, path: &Path) -> Result<GridFile> {
        let missing = [
            ("GRIDHEAD", self.dims.is_none()),
            ("COORD", self.coord.is_empty()),
            ("ZCORN", self.zcorn.is_empty()),
        ];
        if let Some((name, _)) = missing.into_iter().find(|(_, is_missing)| *is_missing) {
            let problem = format!("has no array {name}");
            return Err(Error::Io(cause(path.display(), problem, REWRITE_DAMAGED)));
        }
        if !self.refinements.is_empty() {
            self.notes.push(format!(
                "local refinements ({}) are left out: the cells in their places are those of the global grid",
                self.refinements.join(", ")
            ));
        }
        if self.connections > 0 {
            self.notes.push(format!(
                "{} connections of cells that are not neighbours (NNC) are left out: faults are found from the corners",
                self.connections
            ));
        }
        Ok(GridFile {
            path: path.to_path_buf(),
            kind: "EGRID",
            dims: self.dims.unwrap_or_default(),
            coord: self.coord,
            zcorn: self.zcorn,
            active: self.active,
            frame: self.frame,
            properties: Vec::new(),
            property_names: Vec::new(),
            faults: Vec::new(),
            notes: self.notes,
        })
    }
}

/// Refuses grids of other kinds.
fn check_file_head(file: &ArrayFile, array: &ArrayHeader, head: &[f64]) -> Result<()> {
    if head.len() < 7 {
        return Err(file.error(array, "is too short"));
    }
    let problem = match (head[4] as i64, head[5] as i64) {
        (0, 0) => return Ok(()),
        (0, 1) => "is a model with dual porosity, which has two cells at each place",
        (0, 2) => "is a model with dual permeability, which has two cells at each place",
        _ => "is no corner-point grid but an unstructured or hybrid one",
    };
    let remedy = "give the grid of a model with single porosity";
    Err(Error::Io(cause(file.path.display(), problem, remedy)))
}

/// Reads the properties that `filter` accepts from an INIT file. Properties hold all cells, or the active
/// ones.
fn read_properties(grid: &mut GridFile, path: &Path, filter: PropertyFilter<'_>) -> Result<()> {
    let mut file = ArrayFile::open(path)?;
    let (cells, active) = (
        grid.cell_count(),
        (0..grid.cell_count())
            .filter(|&cell| grid.is_active(cell))
            .count(),
    );
    while let Some(array) = file.next_array()? {
        if array.name == "INTEHEAD" {
            let head = file.numbers(&array)?;
            if head.len() <= INIT_ACTIVE {
                return Err(file.error(&array, "is too short"));
            }
            let dims = [0, 1, 2].map(|n| head[INIT_DIMS + n]);
            if dims != grid.dims.map(|n| n as f64) || head[INIT_ACTIVE] != active as f64 {
                let [nx, ny, nz] = dims;
                let problem = format!(
                    "belongs to a grid of {nx} x {ny} x {nz} cells of which {} are active, not to {}",
                    head[INIT_ACTIVE],
                    grid.path.display()
                );
                let remedy = "give the two files of one run, or move the INIT elsewhere";
                return Err(Error::Io(cause(path.display(), problem, remedy)));
            }
            if grid.frame.grid_unit.is_none() {
                let name = match head[INIT_UNITS] as i64 {
                    2 => "FEET",
                    3 => "CM",
                    _ => "METRES",
                };
                grid.frame.grid_unit = length_unit(name).ok();
            }
            continue;
        }
        // What follows belongs to a local refinement.
        if array.name == "LGRHEADI" || array.name == "LGR" {
            break;
        }
        let is_number = matches!(
            array.element,
            ElementType::Integer | ElementType::Real | ElementType::Double
        );
        let is_property = is_number
            && (array.count == cells || array.count == active)
            && !INIT_HEADS.contains(&&*array.name)
            && !grid.property_names.contains(&array.name);
        if !is_property {
            file.skip(&array)?;
            continue;
        }
        grid.property_names.push(array.name.clone());
        if !filter(&array.name) {
            file.skip(&array)?;
            continue;
        }
        let numbers = file.numbers(&array)?;
        let values = if numbers.len() == cells {
            numbers
        } else {
            let mut stored = numbers.into_iter();
            let value = |cell| {
                let is_stored = grid.is_active(cell);
                is_stored
                    .then(|| stored.next())
                    .flatten()
                    .unwrap_or(f64::NAN)
            };
            (0..cells).map(value).collect()
        };
        grid.properties.push(GridProperty {
            name: array.name,
            values,
            is_whole: array.element == ElementType::Integer,
        });
    }
    Ok(())
}
