//! Writes corner-point grids: GRDECL with all properties, or EGRID.

use std::io::{self, Write};
use std::path::Path;

use super::{FaultFaces, GridFile, MapFrame};
use crate::error::Result;
use crate::files::atomic_write;
use crate::files::text::{FileWriter, WriteResult, write_items, write_numbers};

/// File endings of grids that are written, in lower case.
pub(crate) const GRID_EXTENSIONS: [&str; 2] = ["grdecl", "egrid"];

/// Number of whole numbers in a line.
const WHOLE_PER_LINE: usize = 20;

/// Number of numbers in a line of COORD: a pillar.
const PILLAR_NUMBERS: usize = 6;

/// Largest number of elements in a block of a binary array.
const NUMBERS_PER_BLOCK: usize = 1000;

/// Writes a grid with the coordinates and the units of its file, as EGRID or GRDECL by the ending. GRDECL
/// also gets the properties and the named faults. Values that the file does not give (of inactive cells in
/// an INIT file) become 0.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub(crate) fn write_grid(path: &Path, grid: &GridFile) -> Result<()> {
    let ending = path.extension().unwrap_or_default();
    let is_egrid = ending.eq_ignore_ascii_case("egrid");
    atomic_write(path, |out| {
        if is_egrid {
            write_egrid(out, grid)
        } else {
            write_grdecl(out, grid)
        }
    })
}

/// Returns the name of a unit in files of grids.
fn unit_name(symbol: &str) -> &str {
    match symbol {
        "m" => "METRES",
        "ft" => "FEET",
        "cm" => "CM",
        "ftus" => "US_SURVE",
        other => other,
    }
}

impl MapFrame {
    /// Returns the words of GRIDUNIT; `None` if the file has no unit and is not relative to the map.
    fn grid_unit_words(&self) -> Option<[&str; 2]> {
        let unit = self
            .grid_unit
            .map_or("METRES", |unit| unit_name(unit.symbol));
        let origin = if self.is_map_relative { "MAP" } else { "" };
        (self.grid_unit.is_some() || self.is_map_relative).then_some([unit, origin])
    }
}

impl FaultFaces {
    /// Returns the name of the faces, such as `I-`.
    fn face_name(&self) -> &'static str {
        [["I-", "I"], ["J-", "J"], ["K-", "K"]][self.axis][usize::from(self.is_upper)]
    }
}

fn write_grdecl(out: FileWriter, grid: &GridFile) -> WriteResult {
    let [nx, ny, nz] = grid.dims;
    let version = env!("CARGO_PKG_VERSION");
    writeln!(out, "-- atomesh {version}: the grid of a file\n")?;
    if let Some(unit) = grid.frame.map_unit {
        writeln!(out, "MAPUNITS\n {} /\n", unit_name(unit.symbol))?;
    }
    if let Some(axes) = grid.frame.map_axes {
        let numbers = axes.map(|x| x.to_string()).join(" ");
        writeln!(out, "MAPAXES\n {numbers} /\n")?;
    }
    if let Some(words) = grid.frame.grid_unit_words() {
        writeln!(out, "GRIDUNIT\n {} /\n", words.join(" ").trim_end())?;
    }
    writeln!(out, "SPECGRID\n {nx} {ny} {nz} 1 F /\n\nCOORD")?;
    write_items(out, grid.coord.len() / PILLAR_NUMBERS, |text, pillar| {
        let numbers = &grid.coord[PILLAR_NUMBERS * pillar..][..PILLAR_NUMBERS];
        numbers.iter().for_each(|&number| {
            text.spaced_real(number);
        });
        text.end_line();
    })?;
    writeln!(out, "/\n\nZCORN")?;
    write_numbers(out, grid.zcorn.len(), |at| grid.zcorn[at])?;
    writeln!(out, "/\n")?;
    let cells = grid.cell_count();
    if !grid.active.is_empty() {
        writeln!(out, "ACTNUM")?;
        write_whole(out, cells, |cell| i64::from(grid.active[cell]))?;
    }
    for property in &grid.properties {
        writeln!(out, "{}", property.name)?;
        let value = |cell: usize| Some(property.values[cell]).filter(|v| v.is_finite());
        if property.is_whole {
            write_whole(out, cells, |cell| value(cell).unwrap_or(0.0) as i64)?;
        } else {
            write_numbers(out, cells, |cell| value(cell).unwrap_or(0.0))?;
            writeln!(out, "/\n")?;
        }
    }
    if grid.faults.is_empty() {
        return Ok(());
    }
    writeln!(out, "FAULTS")?;
    for fault in &grid.faults {
        write!(out, " '{}'", fault.name)?;
        for [first, last] in fault.cells {
            write!(out, " {} {}", first + 1, last + 1)?;
        }
        writeln!(out, " {} /", fault.face_name())?;
    }
    writeln!(out, "/")
}

/// Writes whole numbers and the final slash.
fn write_whole(out: FileWriter, count: usize, value: impl Fn(usize) -> i64 + Sync) -> WriteResult {
    write_items(out, count, |text, i| {
        text.spaced_int(value(i));
        if i % WHOLE_PER_LINE == WHOLE_PER_LINE - 1 || i + 1 == count {
            text.end_line();
        }
    })?;
    writeln!(out, "/\n")
}

fn write_egrid(out: FileWriter, grid: &GridFile) -> WriteResult {
    let real = |number: &f64| (*number as f32).to_be_bytes();
    let text = |word: &str| {
        let mut bytes = [b' '; 8];
        let length = word.len().min(8);
        bytes[..length].copy_from_slice(&word.as_bytes()[..length]);
        bytes
    };
    // Version 3 of the format, of 2007; a corner-point grid with single porosity.
    write_head(out, "FILEHEAD", &[(0, 3), (1, 2007), (3, 3), (6, 1)])?;
    if let Some(unit) = grid.frame.map_unit {
        write_array(out, "MAPUNITS", "CHAR", &[text(unit_name(unit.symbol))])?;
    }
    if let Some(axes) = &grid.frame.map_axes {
        write_array(out, "MAPAXES", "REAL", &axes.each_ref().map(real))?;
    }
    if let Some(words) = grid.frame.grid_unit_words() {
        write_array(out, "GRIDUNIT", "CHAR", &words.map(text))?;
    }
    let [nx, ny, nz] = grid.dims.map(|n| n as i32);
    let head = [(0, 1), (1, nx), (2, ny), (3, nz), (24, 1)];
    write_head(out, "GRIDHEAD", &head)?;
    let reals = |numbers: &[f64]| numbers.iter().map(real).collect::<Vec<_>>();
    write_array(out, "COORD", "REAL", &reals(&grid.coord))?;
    write_array(out, "ZCORN", "REAL", &reals(&grid.zcorn))?;
    if !grid.active.is_empty() {
        let flags = grid
            .active
            .iter()
            .map(|&flag| i32::from(flag).to_be_bytes());
        write_array(out, "ACTNUM", "INTE", &flags.collect::<Vec<_>>())?;
    }
    write_array::<4>(out, "ENDGRID", "INTE", &[])
}

/// Writes an array of 100 integers of which these are not 0.
fn write_head(out: &mut impl Write, name: &str, values: &[(usize, i32)]) -> io::Result<()> {
    let mut head = [[0; 4]; 100];
    for &(at, value) in values {
        head[at] = value.to_be_bytes();
    }
    write_array(out, name, "INTE", &head)
}

/// Writes an array of elements of `N` bytes.
fn write_array<const N: usize>(
    out: &mut impl Write,
    name: &str,
    element: &str,
    elements: &[[u8; N]],
) -> io::Result<()> {
    let mut write_block = |bytes: &[u8]| -> io::Result<()> {
        let length = (bytes.len() as u32).to_be_bytes();
        out.write_all(&length)?;
        out.write_all(bytes)?;
        out.write_all(&length)
    };
    let mut header = format!("{name:<8}").into_bytes();
    header.extend((elements.len() as i32).to_be_bytes());
    header.extend(element.as_bytes());
    write_block(&header)?;
    let mut blocks = elements.chunks(NUMBERS_PER_BLOCK);
    blocks.try_for_each(|block| write_block(block.as_flattened()))
}
