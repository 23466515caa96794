//! TOUGH2's file MESH: fixed columns, ten characters a number.
//!
//! It knows no multipliers, but areas: what a fault lets through is a share of its face, and a closed one is
//! no connection. The permeability along x, in m^2, is each element's modifier (PMX), for rocks of
//! permeability 1.

use std::io::Write;
use std::path::Path;

use crate::error::cause;
use crate::export::containers::text::write_items;
use crate::files::Batch;
use crate::mesh::graph::Connection;
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// Names are three letters or digits, the first a letter, and two digits.
const MAX_NAMES: usize = 26 * 36 * 36 * 100;

/// Writes elements and connections. Rocks are named by region, `REG00`, `REG01` ... (`R0100` from
/// there on).
///
/// # Errors
/// [`Error::Export`] for more cells or regions than there are names.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let graph = &model.graph;
    if model.len() > MAX_NAMES {
        return Err(Error::Export(cause(
            "a TOUGH2 mesh",
            format!("has names for {MAX_NAMES} cells, not for {}", model.len()),
            "make larger cells",
        )));
    }
    if let Some(region) = graph.region.iter().find(|r| !(0..10_000).contains(*r)) {
        return Err(Error::Export(cause(
            "a TOUGH2 mesh",
            format!("has rocks for regions from 0 to 9999, not for {region}"),
            "renumber the regions",
        )));
    }
    batch.write(path, |out| {
        writeln!(out, "ELEME")?;
        write_items(out, model.len(), |text, c| {
            let (volume, [x, y, z]) = (graph.volume[c], graph.site[c]);
            text.word(ascii(&element_name(c))).word("          ");
            text.word(ascii(&rock_name(graph.region[c])));
            text.word(ascii(&format_ten_chars(volume)))
                .word("          ");
            match &model.permeability {
                Some(known) => text.word(ascii(&format_ten_chars(known.rock.mobility(c).0[0]))),
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

/// ISOT, the permeability that counts (1, 2, 3: that of the axis the connection is nearest to), and
/// BETAX, the cosine between the connection and gravity: positive if the first cell is above.
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
    // The rise between the sites must be right, also where the connection is not square to its face.
    let beta = -line[2] / (c.distance[0] + c.distance[1]);
    (axis as u8 + 1, beta.clamp(-1.0, 1.0))
}

/// The name of a cell: `AAA00`, `AAA01` ... `AAB00` ...
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

/// The name of a region's rock.
fn rock_name(region: i32) -> [u8; 5] {
    let digit = |power: i32| b'0' + (region / power % 10) as u8;
    if region < 100 {
        [b'R', b'E', b'G', digit(10), digit(1)]
    } else {
        [b'R', digit(1000), digit(100), digit(10), digit(1)]
    }
}

/// A number in ten characters, with as many digits as find room there, and always a point: without one,
/// the last four digits would be read as decimals.
fn format_ten_chars(number: f64) -> [u8; 10] {
    let mut field = [b' '; 10];
    let size = number.abs();
    if size != 0.0 && !(1e-3..99_999_999.0).contains(&size) {
        // Fewer decimals until it fits.
        for decimals in (1..=6).rev() {
            field = [b' '; 10];
            if write!(&mut field[..], "{number:.decimals$E}").is_ok() {
                break;
            }
        }
        return field;
    }
    let sign = usize::from(number < 0.0);
    let mut whole = 1;
    let mut limit = 10.0;
    while size >= limit {
        whole += 1;
        limit *= 10.0;
    }
    let mut decimals = (9 - sign - whole).min(8);
    let mut scaled = (size * 10f64.powi(decimals as i32)).round() as u64;
    if scaled as f64 >= limit * 10f64.powi(decimals as i32) && whole + decimals + sign == 9 {
        // Rounded up to one more digit.
        decimals -= 1;
        scaled = (size * 10f64.powi(decimals as i32)).round() as u64;
        whole += 1;
    }
    for place in (sign..sign + whole + 1 + decimals).rev() {
        if place == sign + whole {
            field[place] = b'.';
        } else {
            field[place] = b'0' + (scaled % 10) as u8;
            scaled /= 10;
        }
    }
    if sign == 1 {
        field[0] = b'-';
    }
    field
}

/// What these functions make is ASCII.
fn ascii(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_fill_ten_columns() {
        for (number, want) in [
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
            assert_eq!(ascii(&format_ten_chars(number)), want);
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
        assert_eq!(ascii(&rock_name(7)), "REG07");
        assert_eq!(ascii(&rock_name(123)), "R0123");
    }
}
