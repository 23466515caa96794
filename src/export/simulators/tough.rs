//! Writes TOUGH2's file MESH: fixed columns, ten characters per number.
//!
//! TOUGH2 has no multipliers. A fault therefore reduces the area of its faces, and a closed fault
//! removes the connection. The permeability along x, in m^2, is the permeability modifier (PMX) of
//! each element, for rocks with a permeability of 1.

use std::io::Write;
use std::path::Path;

use super::CONNECTION_LIST;
use crate::error::cause;
use crate::export::format::ExportFormat;
use crate::export::meshers::groups::sorted_regions;
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::mesh::graph::Connection;
use crate::model::reservoir::Model;
use crate::names::NameRules;
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "tough2",
    description: "TOUGH2 mesh: elements and connections",
    extensions: &["MESH"],
    has_companion: true,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: CONNECTION_LIST,
    deck_path: None,
    names: FormatNames {
        regions: Naming::Names(NameRules {
            max_bytes: ROCK_NAME_BYTES,
            distinct_bytes: ROCK_NAME_BYTES,
            first_letter: 'R',
            // TOUGH2 gives these rocks a meaning of their own.
            reserved: &["SEED", "REFCO"],
            ..NameRules::IDENTIFIER
        }),
        default_region: default_rock_name,
        ..FormatNames::NONE
    },
    write,
};

/// Length of the names of rocks.
const ROCK_NAME_BYTES: usize = 5;
/// Largest number of rocks whose names can be made distinct.
const MAX_ROCKS: usize = 10_000;
/// Number of element names: three letters or digits, the first a letter, and two digits.
const MAX_NAMES: usize = 26 * 36 * 36 * 100;

/// Writes elements and connections. Rocks have the names of regions, or `REG00`, `REG01` ..., and
/// `R0100` and so on from region 100.
///
/// # Errors
/// Returns [`Error::Export`] if there are more cells or regions than names.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let graph = &model.graph;
    if model.len() > MAX_NAMES {
        return Err(Error::Export(cause(
            "a TOUGH2 mesh",
            format!("has names for {MAX_NAMES} cells, not for {}", model.len()),
            "mesh with a larger --distance",
        )));
    }
    let region_count = sorted_regions(model).len();
    if region_count > MAX_ROCKS {
        return Err(Error::Export(cause(
            "a TOUGH2 mesh",
            format!("has names for {MAX_ROCKS} rocks, not for {region_count} regions"),
            "merge regions",
        )));
    }
    batch.write(path, |out| {
        writeln!(out, "ELEME")?;
        write_items(out, model.len(), |text, c| {
            let (volume, [x, y, z]) = (graph.volume[c], graph.site[c]);
            text.word(ascii(&element_name(c))).word("          ");
            let rock = names.region(graph.region[c]);
            text.word(rock)
                .word(&"     "[rock.len().min(ROCK_NAME_BYTES)..]);
            text.word(ascii(&format_ten_chars(volume)))
                .word("          ");
            match &model.permeability {
                Some(permeability) => {
                    text.word(ascii(&format_ten_chars(permeability.rock.mobility(c).0[0])))
                }
                None => text.word("          "),
            };
            for value in [x, y, z] {
                text.word(ascii(&format_ten_chars(value)));
            }
            text.end_line();
        })?;
        writeln!(out, "\nCONNE")?;
        let open = model.open_connections();
        write_items(out, open.len(), |text, i| {
            let (i, factor) = open[i];
            let c = &graph.connections[i as usize];
            let [a, b] = c.cells.map(|cell| element_name(cell as usize));
            let (axis, beta) = direction(c, &graph.site);
            text.word(ascii(&a))
                .word(ascii(&b))
                .word("                   ");
            text.int(axis);
            for value in [c.distance[0], c.distance[1], factor * c.area, beta] {
                text.word(ascii(&format_ten_chars(value)));
            }
            text.end_line();
        })?;
        writeln!(out)
    })
}

/// Returns ISOT, the axis (1, 2, 3) that is nearest to the connection and whose permeability
/// counts, and BETAX, the cosine between the connection and gravity: positive if the first cell is
/// above.
fn direction(c: &Connection<3>, site: &[[f64; 3]]) -> (u8, f64) {
    let [a, b] = c.cells.map(|cell| site[cell as usize]);
    let line: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
    let axis = (1..3).fold(0, |best, k| {
        if line[k].abs() > line[best].abs() {
            k
        } else {
            best
        }
    });
    // The height difference of the sites must be right, even where the connection is not
    // perpendicular to its face.
    let beta = -line[2] / (c.distance[0] + c.distance[1]);
    (axis as u8 + 1, beta.clamp(-1.0, 1.0))
}

/// Returns the name of a cell: `AAA00`, `AAA01` ... `AAB00` ...
fn element_name(cell: usize) -> [u8; 5] {
    const NAME_CHARS: &[u8; 36] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789";
    let (word, digits) = (cell / 100, cell % 100);
    [
        NAME_CHARS[word / (36 * 36) % 26],
        NAME_CHARS[word / 36 % 36],
        NAME_CHARS[word % 36],
        b'0' + (digits / 10) as u8,
        b'0' + (digits % 10) as u8,
    ]
}

/// Returns the rock name of a region without a name.
fn default_rock_name(region: i32) -> String {
    match region {
        0..100 => format!("REG{region:02}"),
        _ => format!("R{region:04}"),
    }
}

/// Formats a number in ten characters, with as many digits as fit, and always with a decimal point.
/// Without a point, the last four digits would be read as decimals.
fn format_ten_chars(number: f64) -> [u8; 10] {
    let mut field = [b' '; 10];
    let magnitude = number.abs();
    if magnitude != 0.0 && !(1e-3..99_999_999.0).contains(&magnitude) {
        // The number of decimals is reduced until the number fits.
        for decimals in (1..=6).rev() {
            field = [b' '; 10];
            if write!(&mut field[..], "{number:.decimals$E}").is_ok() {
                break;
            }
        }
        return field;
    }
    let sign = usize::from(number < 0.0);
    let mut integer_digits = 1;
    let mut limit = 10.0;
    while magnitude >= limit {
        integer_digits += 1;
        limit *= 10.0;
    }
    let mut decimals = (9 - sign - integer_digits).min(8);
    let mut scaled = (magnitude * 10f64.powi(decimals as i32)).round() as u64;
    if scaled as f64 >= limit * 10f64.powi(decimals as i32) && integer_digits + decimals + sign == 9
    {
        // Rounding has added a digit.
        decimals -= 1;
        scaled = (magnitude * 10f64.powi(decimals as i32)).round() as u64;
        integer_digits += 1;
    }
    for column in (sign..sign + integer_digits + 1 + decimals).rev() {
        if column == sign + integer_digits {
            field[column] = b'.';
        } else {
            field[column] = b'0' + (scaled % 10) as u8;
            scaled /= 10;
        }
    }
    if sign == 1 {
        field[0] = b'-';
    }
    field
}

/// Returns bytes as text. All names and numbers of this module are ASCII.
fn ascii(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_fill_ten_columns() {
        for (number, expected) in [
            (0.0, "0.00000000"),
            (1.0 / 3.0, "0.33333333"),
            (612_345.678_91, "612345.679"),
            (-612_345.678_91, "-612345.68"),
            (1.5e-12, "1.5000E-12"),
            (-1.234_567e12, "-1.2346E12"),
            (-1.234_567e-123, "-1.23E-123"),
            (99_999_998.4, "99999998.4"),
            (-99_999_998.4, "-99999998."),
            (99_999_999.4, "1.000000E8"),
            (9.999_999_999_9, "10.0000000"),
            (-9.999_999_999_9, "-10.000000"),
            (0.001, "0.00100000"),
            (-0.25, "-0.2500000"),
        ] {
            assert_eq!(ascii(&format_ten_chars(number)), expected);
        }
    }

    #[test]
    fn names_are_distinct() {
        let mut names: Vec<_> = (0..400_000).map(element_name).collect();
        assert_eq!(ascii(&names[0]), "AAA00");
        assert_eq!(ascii(&names[3699]), "ABA99");
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), 400_000);
        assert_eq!(default_rock_name(7), "REG07");
        assert_eq!(default_rock_name(123), "R0123");
    }
}
