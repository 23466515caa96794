//! Writes NASTRAN bulk data: nodes (`GRID`), tetrahedra (`CTETRA`) with a property for each region,
//! and triangles (`CTRIA3`) with a property for each named group of faces. In a quadratic mesh they
//! are `CTETRA` with ten nodes and `CTRIA6`. A 2-D mesh has triangles, with rods (`CROD`) on named
//! edges, or two rods on each quadratic edge.
//!
//! The file is a deck without loads. Elements of regions refer to materials with the number of their
//! property. These `MAT1` have no stiffness until values are filled in. The triangles of named
//! groups have properties without a material, and the rods have no area. They carry names and
//! loads, but add no stiffness. The triangles of a 2-D mesh have thickness 1.
//!
//! Bulk data have no names. Comments in the forms of HyperMesh, ANSA and Femap name the properties.
//! Coordinates fill fields of 16 characters, with at least 12 significant digits for numbers of
//! absolute value 1e-9 to 1e13, and with at least 14 from 1 to 1e13. All other fields have 8
//! characters, since some readers (meshio) know large fields of `GRID` only.
//!
//! If the mesh is split along surfaces, `NAME-twins.csv` lists the corresponding faces of the two
//! sides.

use std::io::Write;
use std::path::Path;

use super::NAMED_ELEMENTS;
use super::groups::sorted_regions;
use super::simplices::SimplexMesh;
use crate::error::cause;
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, TablePlace};
use crate::files::Batch;
use crate::files::text::{FileWriter, TextBuilder, WriteResult, write_items};
use crate::model::reservoir::Model;
use crate::names::NameRules;
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "nastran",
    description: "NASTRAN bulk data: tetrahedra, regions and named triangles",
    extensions: &["bdf", "nas"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: NAMED_ELEMENTS,
    deck_path: None,
    names: FormatNames::one_namespace(
        NameRules {
            max_bytes: 80,
            distinct_bytes: 80,
            is_allowed: |c| c == ' ' || c.is_ascii_graphic() && !['"', ';'].contains(&c),
            ..NameRules::TEXT
        },
        TablePlace::Comments("$ "),
    ),
    write,
};

const ERROR_PLACE: &str = "NASTRAN's format";

/// Width of a field of integers, in characters.
const INTEGER_WIDTH: usize = 8;
/// Width of a field of coordinates, in characters.
const REAL_WIDTH: usize = 16;
/// Largest number of a node or an element, which has as many digits as its field has characters.
const MAX_NUMBER: usize = 99_999_999;
/// Number of nodes of an element in its first line.
const NODES_IN_FIRST_LINE: usize = 6;
/// Names of linear and of quadratic elements, by their number of corners.
const ELEMENT_CARDS: [[&str; 2]; 5] = [
    ["", ""],
    ["", ""],
    ["CROD", "CROD"],
    ["CTRIA3", "CTRIA6"],
    ["CTETRA", "CTETRA"],
];

/// Writes the mesh. Numbers begin with 1. Properties have the numbers of groups, and then those of
/// regions.
///
/// # Errors
/// Returns [`Error::Export`] if the cells are neither tetrahedra nor triangles, or if there are
/// more than 99,999,999 nodes or elements.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, ERROR_PLACE)?;
    let is_2d = mesh.corner_count == 3;
    let [cell_card, side_card] = [mesh.corner_count, mesh.corner_count - 1]
        .map(|corners| ELEMENT_CARDS[corners][usize::from(mesh.is_quadratic())]);
    let elements_per_side = if is_2d && mesh.is_quadratic() { 2 } else { 1 };
    let element_count = mesh.len() + elements_per_side * mesh.named_side_count();
    check_count(mesh.node_count(), "nodes")?;
    check_count(element_count, "elements")?;
    let regions = sorted_regions(model);
    let first_region = mesh.next_number();
    batch.write(path, |out| {
        let version = env!("CARGO_PKG_VERSION");
        writeln!(out, "$ atomesh {version}")?;
        write!(out, "{}", names.comments())?;
        writeln!(out, "SOL 101\nCEND\nBEGIN BULK")?;
        for group in &mesh.named_sides {
            let number = group.number;
            if is_2d {
                write_name(out, "PROD", number, &group.name)?;
                writeln!(out, "PROD    {number:8}{first_region:8}     0.0")?;
            } else {
                write_name(out, "PSHELL", number, &group.name)?;
                writeln!(out, "PSHELL  {number:8}")?;
            }
        }
        for (number, &region) in (first_region..).zip(&regions) {
            let name = names.region(region);
            if is_2d {
                write_name(out, "PSHELL", number, name)?;
                writeln!(out, "PSHELL  {number:8}{number:8}     1.0")?;
            } else {
                write_name(out, "PSOLID", number, name)?;
                writeln!(out, "PSOLID  {number:8}{number:8}")?;
            }
            writeln!(out, "MAT1    {number:8}     0.0             0.0")?;
        }
        write_items(out, mesh.node_count(), |text, i| {
            let [x, y, z] = mesh.point(i).map(real_text);
            text.word("GRID*   ");
            add_field(text, itoa::Buffer::new().format(i + 1), REAL_WIDTH);
            add_field(text, "", REAL_WIDTH);
            add_field(text, &x, REAL_WIDTH);
            add_field(text, &y, REAL_WIDTH);
            text.end_line();
            text.word("*       ");
            add_field(text, &z, REAL_WIDTH);
            text.end_line();
        })?;
        write_items(out, mesh.len(), |text, t| {
            let region = regions.partition_point(|&r| r < mesh.region[t]) + first_region;
            let (nodes, count) = element_nodes(mesh, mesh.get(t));
            add_element(text, cell_card, t + 1, region, &nodes[..count]);
        })?;
        let mut next = mesh.len() + 1;
        for group in &mesh.named_sides {
            write_items(out, group.sides.len(), |text, i| {
                let number = next + elements_per_side * i;
                let (nodes, count) = element_nodes(mesh, group.sides.get(i));
                if let ([a, b, middle], true) = (&nodes[..count], is_2d) {
                    add_element(text, side_card, number, group.number, &[*a, *middle]);
                    add_element(text, side_card, number + 1, group.number, &[*middle, *b]);
                } else {
                    add_element(text, side_card, number, group.number, &nodes[..count]);
                }
            })?;
            next += elements_per_side * group.sides.len();
        }
        writeln!(out, "ENDDATA")
    })?;
    mesh.write_face_pairs(batch, path, 1)
}

/// Checks that numbers up to `count` fit in their fields.
fn check_count(count: usize, items: &str) -> Result<()> {
    if count <= MAX_NUMBER {
        return Ok(());
    }
    Err(Error::Export(cause(
        ERROR_PLACE,
        format!("numbers at most {MAX_NUMBER} {items}, but the mesh has {count}"),
        "export to exodus or cgns, or mesh with a larger distance",
    )))
}

/// Writes the comments that name a property. `card` is the name of the card that follows.
fn write_name(out: FileWriter, card: &str, number: usize, name: &str) -> WriteResult {
    // Readers of HyperMesh's comments (OpenFOAM) expect the number to end in column 32. The property of
    // a component follows its name (meshio++).
    writeln!(
        out,
        "$HMNAME COMP{number:>20}\"{name}\" {number} \"{card}\""
    )?;
    writeln!(out, "$HMNAME PROP{number:>20}\"{name}\"")?;
    writeln!(
        out,
        "$ANSA_NAME_COMMENT;{number};{card};{name};;NO;NO;NO;NO;"
    )?;
    writeln!(out, "$ Femap Property {number} : {name}")
}

/// Returns the nodes of a cell or a side, numbered from 1, and their count.
fn element_nodes(mesh: &SimplexMesh, corners: &[u32]) -> ([u32; 10], usize) {
    let (mut nodes, mut count) = ([0; 10], 0);
    mesh.visit_nodes(corners, |n| {
        nodes[count] = n + 1;
        count += 1;
    });
    (nodes, count)
}

/// Adds an element in one line, or in two if it has more than six nodes.
fn add_element(text: &mut TextBuilder, card: &str, number: usize, property: usize, nodes: &[u32]) {
    text.word(card);
    text.word(&"        "[card.len()..]);
    let add_integer = |text: &mut TextBuilder, number: usize| {
        add_field(text, itoa::Buffer::new().format(number), INTEGER_WIDTH);
    };
    add_integer(text, number);
    add_integer(text, property);
    let (first, continued) = nodes.split_at(nodes.len().min(NODES_IN_FIRST_LINE));
    first.iter().for_each(|&n| add_integer(text, n as usize));
    if !continued.is_empty() {
        text.word("+\n+       ");
        continued
            .iter()
            .for_each(|&n| add_integer(text, n as usize));
    }
    text.end_line();
}

/// Adds a value at the right end of a field.
fn add_field(text: &mut TextBuilder, value: &str, width: usize) {
    text.word(&"                "[..width - value.len()])
        .word(value);
}

/// Returns a number in at most 16 characters: with the fewest digits that identify it if they fit,
/// otherwise with as many digits as fit.
fn real_text(number: f64) -> String {
    let shortest = nastran_form(zmij::Buffer::new().format(number));
    if shortest.len() <= REAL_WIDTH {
        return shortest;
    }
    // Of the two notations, the one with more digits.
    let is_decimal = (1e-2..1e13).contains(&number.abs());
    let with_decimals = |decimals: usize| {
        if is_decimal {
            let text = format!("{number:.decimals$}");
            // No digit is lost with the zero before the point.
            if number.abs() < 1.0 {
                text.replacen("0.", ".", 1)
            } else {
                text
            }
        } else {
            nastran_form(&format!("{number:.decimals$e}"))
        }
    };
    let mut texts = (1..REAL_WIDTH).rev().map(with_decimals);
    let fitting = texts.find(|text| text.len() <= REAL_WIDTH);
    fitting.unwrap_or(shortest)
}

/// Returns a number as NASTRAN reads it: with a decimal point, and with the sign of the exponent in
/// place of the letter `e`.
fn nastran_form(number: &str) -> String {
    let (mantissa, exponent) = number.split_once('e').unwrap_or((number, ""));
    let point = if mantissa.contains('.') { "" } else { "." };
    let has_sign = exponent.is_empty() || exponent.starts_with(['+', '-']);
    let sign = if has_sign { "" } else { "+" };
    format!("{mantissa}{point}{sign}{exponent}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::PolyMesh;

    /// Edge of the box in the tests. Its coordinates need all digits of a number.
    const EDGE: f64 = 1.0 / 3.0;

    /// Writes a box of six tetrahedra, of which the last is in region 4 and the others in region
    /// -2. Returns the text.
    fn box_of_tetrahedra(is_quadratic: bool) -> String {
        let tets = kuhn_box([1, 1, 1], EDGE);
        let regions = [-2, -2, -2, -2, -2, 4];
        let mut cells = PolyMesh::from_simplices(&tets, &[], &regions).unwrap();
        cells.assign_sides([0.0; 3], [EDGE; 3]);
        let mut model = Model::new(cells, Some(tets));
        model.is_quadratic = is_quadratic;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("box.bdf");
        FORMAT.write(&model, &path).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    /// Returns the fields of each line after the name of its card, for all cards with that name.
    /// The continuation of a line belongs to it.
    fn cards(text: &str, name: &str, width: usize) -> Vec<Vec<String>> {
        let text = text.replace("+\n+       ", "").replace("\n*       ", "");
        let lines = text
            .lines()
            .filter(|line| line[..8.min(line.len())].trim_end() == name);
        let fields = |line: &str| -> Vec<String> {
            let fields = line.as_bytes()[8..].chunks(width);
            fields
                .map(|field| String::from_utf8_lossy(field).trim().to_string())
                .collect()
        };
        lines.map(fields).collect()
    }

    fn integers(fields: &[String]) -> Vec<usize> {
        fields.iter().map(|field| field.parse().unwrap()).collect()
    }

    /// Reads a number of NASTRAN, which may have an exponent without a letter.
    fn parse_real(text: &str) -> f64 {
        let start = text.len().min(1);
        let exponent = text[start..].find(['+', '-']).map(|i| start + i);
        let (mantissa, exponent) = text.split_at(exponent.unwrap_or(text.len()));
        format!(
            "{mantissa}e{}",
            if exponent.is_empty() { "0" } else { exponent }
        )
        .parse()
        .unwrap()
    }

    #[test]
    fn numbers_fit_their_fields_with_at_least_12_digits() {
        let mut state = 1u64;
        for decade in -30..30 {
            for _ in 0..200 {
                state = state
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                let mantissa = 1.0 + 9.0 * (state >> 11) as f64 / (1u64 << 53) as f64;
                for number in [mantissa, -mantissa].map(|m| m * 10f64.powi(decade)) {
                    let text = real_text(number);
                    assert!(text.len() <= REAL_WIDTH && text.contains('.'), "{text}");
                    let digits = match decade {
                        0..13 => 14,
                        -9..0 => 12,
                        _ => 11,
                    };
                    let error = (parse_real(&text) - number).abs();
                    let half_digit = 0.5 * 10f64.powi(decade + 1 - digits);
                    let tolerance = half_digit + f64::EPSILON * number.abs();
                    assert!(error <= tolerance, "{number} {text}");
                }
            }
        }
        for (number, text) in [
            (0.0, "0.0"),
            (-1.0, "-1.0"),
            (612345.678, "612345.678"),
            (2.5e-7, "2.5-7"),
            (1e20, "1.+20"),
            (-1.0 / 3.0, "-.33333333333333"),
            (9.999999999999999, "10.0000000000000"),
            (99999999999.12342, "99999999999.1234"),
        ] {
            assert_eq!(real_text(number), text);
        }
    }

    #[test]
    fn elements_regions_and_sides_are_written() {
        for is_quadratic in [false, true] {
            let text = box_of_tetrahedra(is_quadratic);
            assert!(text.lines().all(|line| line.len() <= 80), "{text}");
            let tets = kuhn_box([1, 1, 1], EDGE);
            let nodes: Vec<[f64; 3]> = (1..)
                .zip(cards(&text, "GRID*", REAL_WIDTH))
                .map(|(number, fields)| {
                    assert_eq!(fields[0].parse(), Ok(number));
                    assert!(fields[1].is_empty());
                    [2, 3, 4].map(|k| parse_real(&fields[k]))
                })
                .collect();
            // A box of six tetrahedra has 8 corners and 19 edges.
            assert_eq!(nodes.len(), if is_quadratic { 27 } else { 8 });
            let is_close = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-14);
            for (node, &other) in nodes.iter().zip(&tets.nodes) {
                assert!(is_close(*node, other));
            }
            let middle = |a: usize, b: usize| {
                let [a, b] = [nodes[a - 1], nodes[b - 1]];
                std::array::from_fn(|k| 0.5 * (a[k] + b[k]))
            };
            let elements = cards(&text, "CTETRA", INTEGER_WIDTH);
            assert_eq!(elements.len(), tets.tets.len());
            for (i, fields) in elements.iter().enumerate() {
                let fields = integers(fields);
                // The six sides and the interface of the regions have lower numbers.
                assert_eq!(fields[..2], [i + 1, if i == 5 { 11 } else { 10 }]);
                assert_eq!(fields[2..6], tets.tets[i].map(|n| n as usize + 1));
                let edges = [[2, 3], [3, 4], [4, 2], [2, 5], [3, 5], [4, 5]];
                for (edge, &node) in edges.iter().zip(&fields[6..]) {
                    let [a, b] = edge.map(|k| fields[k]);
                    assert!(is_close(nodes[node - 1], middle(a, b)));
                }
                assert_eq!(fields.len(), if is_quadratic { 12 } else { 6 });
            }
            let name = if is_quadratic { "CTRIA6" } else { "CTRIA3" };
            let sides = cards(&text, name, INTEGER_WIDTH);
            assert_eq!(sides.len(), 14);
            for (i, fields) in sides.iter().enumerate() {
                let fields = integers(fields);
                assert_eq!(fields[0], 7 + i);
                let [a, b, c] = [2, 3, 4].map(|k| nodes[fields[k] - 1]);
                let (axis, is_high) = ((fields[1] - 1) / 2, fields[1].is_multiple_of(2));
                let normal =
                    crate::geometry::cross(crate::geometry::sub(b, a), crate::geometry::sub(c, a));
                // Sides of the box face outward.
                if fields[1] <= 6 {
                    assert_eq!(normal[axis] > 0.0, is_high);
                }
            }
        }
    }

    #[test]
    fn properties_have_names_and_regions_have_materials() {
        let text = box_of_tetrahedra(false);
        for lines in [
            "\n$ Femap Property 1 : xmin\nPSHELL         1\n",
            "\n$HMNAME COMP                   6\"zmax\" 6 \"PSHELL\"\n$HMNAME PROP                   6\"zmax\"\n\
             $ANSA_NAME_COMMENT;6;PSHELL;zmax;;NO;NO;NO;NO;\n$ Femap Property 6 : zmax\n",
            "\n$ Femap Property 10 : region-2\nPSOLID        10      10\n\
             MAT1          10     0.0             0.0\n",
            "\n$ Femap Property 11 : region4\nPSOLID        11      11\n",
        ] {
            assert!(text.contains(lines), "{lines}\n{text}");
        }
        let [begin, end] = ["SOL 101\nCEND\nBEGIN BULK\n", "\nENDDATA\n"];
        assert!(text.contains(begin) && text.ends_with(end));
    }

    #[test]
    fn more_items_than_8_digits_number_are_an_error() {
        assert!(check_count(MAX_NUMBER, "nodes").is_ok());
        let error = check_count(MAX_NUMBER + 1, "nodes").unwrap_err();
        assert!(error.to_string().contains("100000000"), "{error}");
    }
}
