//! Columns of places in tables: which of them hold x, y and z, and what their names say.

use super::place_terms::DATUM_KEYS;
pub use super::place_terms::PLACE_TERMS;
use crate::Result;
use crate::files::table::{Column, Table, Term};
use crate::image::stated::{Domain, StatedCoordinates, ZDirection};
use crate::units::{self, Quantity};

/// A way to read places from the columns of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceReading<const D: usize> {
    /// The columns of the coordinates.
    pub columns: [usize; D],
    /// The columns of inline and crossline, where these decide between readings.
    pub lines: Option<[usize; 2]>,
    /// `true` if a column of consecutive numbers precedes the coordinates.
    pub is_numbered: bool,
    /// A number that is added to the last coordinate, as its datum is not that of the others.
    pub shift: f64,
    /// The statements of the file about the coordinates.
    pub coordinates: StatedCoordinates,
    /// Notes on assumptions.
    pub notes: Vec<String>,
}

impl<const D: usize> PlaceReading<D> {
    /// Returns the names of the columns, as the suffix `columns=` takes them.
    pub fn column_names(&self) -> String {
        let width = self.columns.iter().max().map_or(0, |last| last + 1);
        let name = |k: usize| match self.columns.iter().position(|&column| column == k) {
            Some(axis) => ["x", "y", "z"][axis.min(2)],
            None => "_",
        };
        let names: Vec<&str> = (0..width).map(name).collect();
        names.join(",")
    }
}

/// A meaning of the last coordinate.
struct Vertical {
    term: &'static str,
    direction: Option<ZDirection>,
    domain: Option<Domain>,
}

const fn vertical(
    term: &'static str,
    direction: Option<ZDirection>,
    domain: Option<Domain>,
) -> Vertical {
    Vertical {
        term,
        direction,
        domain,
    }
}

/// The meanings of the last coordinate: the first that a table has counts, and in time the last.
const VERTICALS: [Vertical; 6] = [
    vertical("z", None, None),
    vertical("tvdss", Some(ZDirection::Down), Some(Domain::Depth)),
    vertical("elevation", Some(ZDirection::Up), Some(Domain::Depth)),
    vertical("depth", Some(ZDirection::Down), Some(Domain::Depth)),
    vertical("tvd", Some(ZDirection::Down), Some(Domain::Depth)),
    vertical("time", Some(ZDirection::Down), Some(Domain::Time)),
];

/// Returns the term of this name.
pub(crate) fn term(name: &str) -> &'static Term {
    let position = PLACE_TERMS.iter().position(|term| term.name == name);
    &PLACE_TERMS[position.unwrap_or(0)]
}

/// Returns `true` if a table has a column for a coordinate.
pub(crate) fn has_coordinates(table: &Table) -> bool {
    let is_coordinate = |column: &Column| {
        let is_vertical = VERTICALS
            .iter()
            .any(|vertical| column.term == Some(vertical.term));
        is_vertical || matches!(column.term, Some("x" | "y"))
    };
    table.columns().iter().any(is_coordinate)
}

/// Returns the readings of places that the names of a table's columns allow: one, or one in depth and
/// one in time.
///
/// # Errors
/// Returns [`Error::Job`](crate::Error::Job) for a table without a column for each coordinate, or with
/// two for one.
pub fn named_readings<const D: usize>(table: &Table) -> Result<Vec<PlaceReading<D>>> {
    let has_lines = table.column("inline")?.is_some() && table.column("crossline")?.is_some();
    if has_lines && table.column("x")?.is_none() {
        let problem = "has line numbers, but no x and y";
        return Err(table.error(problem, "export the file again with X and Y"));
    }
    let x = table.required(term("x"))?;
    let y = table.column("y")?;
    let mut found = Vec::new();
    for vertical in &VERTICALS {
        if let Some(column) = table.column(vertical.term)? {
            found.push((vertical, column));
        }
    }
    let horizontal = match (D, y) {
        (_, Some(y)) => vec![x, y],
        // In 2-D, x and a depth are an upright section.
        (2, None) if !found.is_empty() => vec![x],
        _ => vec![x, table.required(term("y"))?],
    };
    if horizontal.len() == D {
        let units = std::array::from_fn(|k| unit_of(table, horizontal.get(k).copied()));
        return Ok(vec![PlaceReading {
            columns: std::array::from_fn(|k| horizontal[k]),
            lines: None,
            is_numbered: false,
            shift: 0.0,
            coordinates: StatedCoordinates {
                units,
                nulls: table.nulls().to_vec(),
                ..StatedCoordinates::default()
            },
            notes: Vec::new(),
        }]);
    }
    let in_time = found
        .iter()
        .position(|(vertical, _)| vertical.domain == Some(Domain::Time));
    let first = (!found.is_empty()).then_some(0);
    let chosen = [first, in_time.filter(|&k| k > 0)].into_iter().flatten();
    let mut readings: Vec<_> = chosen
        .map(|k| reading(table, &horizontal, found[k].0, found[k].1))
        .collect();
    // Beside a column of times, z is a depth.
    if let [first, _] = &mut readings[..] {
        first.coordinates.domain.get_or_insert(Domain::Depth);
    }
    if let (true, Some(column)) = (readings.is_empty(), only_other_column(table)) {
        table.check_unit(column)?;
        let mut other: PlaceReading<D> = reading(table, &horizontal, &VERTICALS[0], column);
        other.notes.push(format!(
            "column {} taken as z",
            table.columns()[column].name
        ));
        readings.push(other);
    }
    if readings.is_empty() {
        let terms: Vec<Term> = VERTICALS
            .iter()
            .map(|vertical| *term(vertical.term))
            .collect();
        return Err(table.missing(&terms));
    }
    Ok(readings)
}

/// Returns, for each column of a table, whether it has numbers and nothing else.
pub(crate) fn number_columns(table: &Table) -> Vec<bool> {
    let mut has_numbers = vec![false; table.columns().len()];
    let mut has_texts = has_numbers.clone();
    for row in table.rows() {
        for k in 0..has_texts.len() {
            if !has_texts[k] {
                match row.number(k) {
                    Ok(value) => has_numbers[k] |= value.is_some(),
                    Err(_) => has_texts[k] = true,
                }
            }
        }
    }
    let flags = has_numbers.into_iter().zip(has_texts);
    flags.map(|(numbers, texts)| numbers && !texts).collect()
}

/// Returns the only column of numbers whose name is not known. In a table with x and y it is z, under
/// the name of a surface.
fn only_other_column(table: &Table) -> Option<usize> {
    let is_number = number_columns(table);
    let is_other = |&k: &usize| {
        let term = table.columns()[k].term;
        is_number[k] && matches!(term, None | Some("horizon" | "surface" | "fault"))
    };
    let mut others = (0..is_number.len()).filter(is_other);
    others.next().filter(|_| others.next().is_none())
}

/// Returns the unit in the first remark that is about `subject` and ends with `GIVEN IN UNIT-UNITS`, as Petrel
/// writes of the depths of its wells.
pub(crate) fn unit_given_in_remark(table: &Table, subject: &str) -> Option<String> {
    table.remarks().iter().find_map(|remark| {
        let remark = remark.to_lowercase();
        let (about, unit) = remark.split_once("given in ")?;
        let unit = unit.trim().strip_suffix("-units")?;
        let is_meant = about.trim_start_matches(['#', ' ']).starts_with(subject);
        (is_meant && units::find(unit).is_some()).then(|| unit.to_string())
    })
}

/// Returns the unit of a column.
fn unit_of(table: &Table, column: Option<usize>) -> Option<String> {
    table.columns().get(column?)?.unit.clone()
}

/// Returns the reading with a certain last coordinate.
fn reading<const D: usize>(
    table: &Table,
    horizontal: &[usize],
    vertical: &Vertical,
    column: usize,
) -> PlaceReading<D> {
    let remark = |keys: &[&str]| {
        let unit = table.remark_text(keys)?;
        units::find(unit).map(|_| unit.to_string())
    };
    let general = remark(&["units", "unit", "coordinateunits"]);
    let plane =
        remark(&["unitinxandydirection", "xyunit", "xyunits", "unitxy"]).or(general.clone());
    let depth = remark(&[
        "unitindepth",
        "zunit",
        "zunits",
        "depthunit",
        "depthunits",
        "unitz",
    ]);
    let of_depths = unit_given_in_remark(table, "depth").or(general);
    let depth = depth.or_else(|| of_depths.filter(|_| vertical.domain != Some(Domain::Time)));
    let mut coordinates = StatedCoordinates {
        z_direction: vertical.direction,
        domain: vertical.domain,
        nulls: table.nulls().to_vec(),
        ..StatedCoordinates::default()
    };
    for (unit, &column) in coordinates.units.iter_mut().zip(horizontal) {
        *unit = unit_of(table, Some(column)).or(plane.clone());
    }
    let unit = unit_of(table, Some(column)).or(depth);
    if unit
        .as_deref()
        .and_then(units::find)
        .is_some_and(|unit| unit.quantity == Quantity::Time)
    {
        coordinates.domain = Some(Domain::Time);
    }
    coordinates.units[D - 1] = unit;
    let mut reading = PlaceReading {
        columns: std::array::from_fn(|k| horizontal.get(k).copied().unwrap_or(column)),
        lines: None,
        is_numbered: false,
        shift: 0.0,
        coordinates,
        notes: Vec::new(),
    };
    reading.columns[D - 1] = column;
    reading.take_sign_and_datum(table, vertical);
    reading
}

impl<const D: usize> PlaceReading<D> {
    /// Looks whether values agree with the direction that their name says, and applies the datum of
    /// depths below the kelly bushing.
    fn take_sign_and_datum(&mut self, table: &Table, vertical: &Vertical) {
        let column = self.columns[D - 1];
        let is_null = |value: &f64| table.nulls().contains(value);
        let values = table
            .rows()
            .filter_map(|row| row.number(column).ok().flatten());
        let mut sides = [0usize; 2];
        for value in values.filter(|value| !is_null(value)) {
            sides[0] += usize::from(value < 0.0);
            sides[1] += usize::from(value > 0.0);
        }
        if vertical.direction == Some(ZDirection::Down) && sides[0] > 0 && sides[1] == 0 {
            self.coordinates.z_direction = Some(ZDirection::Up);
            let name = &table.columns()[column].name;
            self.notes.push(format!(
                "all values of {name} are negative: they are read as heights"
            ));
        }
        if vertical.term != "tvd" {
            return;
        }
        let name = &table.columns()[column].name;
        match datum(table, self.coordinates.units[D - 1].as_deref()) {
            Some(height) => {
                let is_down = self.coordinates.z_direction == Some(ZDirection::Down);
                self.shift = if is_down { -height } else { height };
                self.notes.push(format!(
                    "{name} is measured from a datum {height} above z = 0"
                ));
            }
            None => self.notes.push(format!(
                "{name} is taken as measured from z = 0, as the file names no kelly bushing"
            )),
        }
    }
}

/// Returns the height of the datum of depths that the remarks of a table state, in `unit`.
pub(crate) fn datum(table: &Table, unit: Option<&str>) -> Option<f64> {
    let (height, own) = table.remark_value(DATUM_KEYS)?;
    Some(height * unit_ratio(own.as_deref(), unit))
}

/// Returns the number of units `to` in a unit `from`; 1 where one of them is not known.
pub(crate) fn unit_ratio(from: Option<&str>, to: Option<&str>) -> f64 {
    let size = |unit: Option<&str>| unit.and_then(units::find).map(|unit| unit.size);
    match (size(from), size(to)) {
        (Some(from), Some(to)) if from != to => from / to,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn parse(header: &str) -> Table {
        let text = format!("{header}\n1;2;3;4\n5;6;7;8\n");
        Table::parse(Path::new("t.csv"), text, PLACE_TERMS).unwrap()
    }

    #[test]
    fn units_with_reference_levels_are_units() {
        for (name, term, unit) in [
            ("MD (ftKB)", "md", "ft"),
            ("MD (ft KB)", "md", "ft"),
            ("MD [ft RKB]", "md", "ft"),
            ("MD (ft MD)", "md", "ft"),
            ("MD_ftKB", "md", "ft"),
            ("Z (')", "z", "ft"),
            ("TVD (ftKB)", "tvd", "ft"),
            ("TVD (ft MSL)", "tvdss", "ft"),
            ("TVDSS (ftSS)", "tvdss", "ft"),
            ("TVDSS (ft MSL)", "tvdss", "ft"),
            ("Z (ft TVDSS)", "tvdss", "ft"),
            ("Z (mTVDSS)", "tvdss", "m"),
            ("Depth (ft-msl)", "depth", "ft"),
            ("Depth (ft KB)", "tvd", "ft"),
            ("Elevation (ft, MSL)", "elevation", "ft"),
            ("Elevation (m MSL)", "elevation", "m"),
            ("Z_ft_SS", "z", "ft"),
            ("Z_ft", "z", "ft"),
        ] {
            let table = parse(&format!("x;y;{name};w"));
            let column = &table.columns()[2];
            assert_eq!(
                (column.term, column.unit.as_deref()),
                (Some(term), Some(unit)),
                "{name}"
            );
        }
        // A thickness is no depth.
        let table = parse("x (mE);y (mN);Thickness (m TVDSS);w");
        let column = &table.columns()[2];
        assert_eq!((column.term, column.unit.as_deref()), (None, Some("m")));
        assert_eq!(table.columns()[1].unit.as_deref(), Some("m"));
        let table = parse("x (UTM 31N);y;z;w");
        assert_eq!(table.column("x").unwrap(), Some(0));
    }

    #[test]
    fn names_of_xtgeo_are_known() {
        let table = parse("X_UTME;Y_UTMN;Z_TVDSS;ZONE");
        let terms = table.columns().iter().map(|column| column.term);
        let expected = ["x", "y", "tvdss", "zone"].map(Some);
        assert_eq!(terms.collect::<Vec<_>>(), expected);
        let table = parse("MDEPTH;Q_INCL;Q_AZI;WELLNAME");
        let terms = table.columns().iter().map(|column| column.term);
        let expected = ["md", "inclination", "azimuth", "well"].map(Some);
        assert_eq!(terms.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn units_that_are_not_known_are_errors() {
        for (header, problem) in [
            (
                "x;y;depth (fathoms);w",
                "t.csv:1: column depth has 'fathoms', which is not known as a unit",
            ),
            ("x (deg);y (deg);z;w", "t.csv:1: column x has 'deg'"),
            (
                "x;y;Top Balder (fathoms);md",
                "t.csv:1: column Top Balder has 'fathoms'",
            ),
        ] {
            let error = named_readings::<3>(&parse(header)).unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
        }
        let table = parse("md;inc (grad);azi [gon];w");
        for (term, unit) in [("inclination", "grad"), ("azimuth", "gon")] {
            let error = table.column(term).unwrap_err().to_string();
            assert!(
                error.contains(&format!("has angles in '{unit}'")),
                "{error}"
            );
            assert!(error.contains("give angles in degrees"), "{error}");
        }
        let table = parse("md;inc (deg);azi (deg TN);w");
        assert_eq!(table.column("azimuth").unwrap(), Some(2));
        // Columns without use may have any unit.
        let mut table = parse("x;y;depth (fathoms);z (ft KB)");
        table
            .set_columns(&["x", "y", "_", "z"].map(String::from), PLACE_TERMS)
            .unwrap();
        let readings = named_readings::<3>(&table).unwrap();
        assert_eq!(readings[0].coordinates.units[2].as_deref(), Some("ft"));
    }
}
