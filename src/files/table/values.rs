//! Tables of values: by surface, and by region; and the units of their columns.

use std::path::Path;

use super::{Table, TableRow, Term, comment_text, is_number, split_lines};
use crate::Result;
use crate::units::values::ValueMeasure;

impl Table {
    /// Returns the unit of a column as the file writes it: in brackets behind the name, or in a line of
    /// units below the names.
    fn stated_unit(&self, column: usize) -> Option<String> {
        let named = self.columns.get(column)?;
        if named.name.is_empty() || named.unit.is_some() {
            return named.unit.clone();
        }
        let lines = split_lines(&self.text);
        let is_header = |line: &super::Line| Some(line.number) == self.header_line;
        let at = lines.iter().position(is_header)?;
        let first_row = self.lines.first();
        let end = first_row.map_or(self.text.len(), |row| row.start);
        let mut rest = self.text.get(lines[at].start..end)?;
        for other in &self.columns[..=column] {
            let from = rest.find(other.name.as_str())? + other.name.len();
            rest = &rest[from..];
        }
        if let Some(unit) = rest.trim_start().strip_prefix(['(', '[', '{', '<']) {
            let unit = unit.split([')', ']', '}', '>', '\n']).next()?.trim();
            return (!unit.is_empty()).then(|| unit.to_string());
        }
        let is_above_rows =
            |line: &&super::Line| first_row.is_none_or(|row| line.number < row.number);
        let mut fields = lines[at + 1..]
            .iter()
            .take_while(is_above_rows)
            .map(|line| line.text(&self.text))
            .filter(|text| comment_text(text).is_none())
            .map(|text| self.separator.split(text))
            .filter(|fields| fields.len() == self.columns.len());
        let unit = fields.next()?.get(column)?.to_string();
        let unit = unit.trim_matches(|c: char| "()[]{}<>".contains(c) || c.is_whitespace());
        (!unit.is_empty() && !is_number(unit)).then(|| unit.to_string())
    }

    /// Returns the factor that converts the values of a column to the unit of `measure`; `None` if the
    /// file states no unit.
    ///
    /// # Errors
    /// Returns [`Error::Job`](crate::Error::Job) for a unit that is not known.
    pub fn unit_factor(&self, column: usize, measure: ValueMeasure) -> Result<Option<f64>> {
        let name = self.columns.get(column).map_or("", |column| &*column.name);
        let Some(unit) = self.stated_unit(column) else {
            // A unit may be the last word of the name.
            let last = name.rsplit_once(|c: char| c.is_whitespace() || "_-".contains(c));
            return Ok(last.and_then(|(_, unit)| measure.factor(unit)));
        };
        let factor = measure.factor(&unit).ok_or_else(|| {
            let [quantity, known] = measure.texts();
            let problem =
                format!("column '{name}' has the unit '{unit}', which is none of {quantity}");
            self.header_error(problem, format!("give one of {known}"))
        })?;
        Ok(Some(factor))
    }
}

/// Names of the column of regions.
const REGION: Term = Term::new(
    "region",
    &[
        "label",
        "zone",
        "regionid",
        "regionnumber",
        "layer",
        "material",
        "facies",
        "id",
    ],
);

/// A table of values: the column that says for what, and the columns of values.
pub struct ValueTable {
    /// All terms, that of the first column first.
    pub terms: &'static [Term],
    /// The meaning of a row, for messages.
    pub meaning: &'static str,
    /// The remedy of a wrong row, for messages.
    pub remedy: &'static str,
}

impl ValueTable {
    /// Returns the columns of the key and the values. Without names these are all columns in their
    /// order; columns of unknown names are values if no value has a known name.
    fn columns(&self, table: &Table) -> Result<Vec<usize>> {
        let all = 0..table.columns().len();
        if !table.has_names() {
            return Ok(all.collect());
        }
        let key = table.required(&self.terms[0])?;
        let mut columns = vec![key];
        for term in &self.terms[1..] {
            columns.extend(table.column(term.name)?);
        }
        if columns.len() == 1 {
            columns.extend(all.filter(|&k| k != key && table.columns()[k].term.is_none()));
        }
        Ok(columns)
    }

    /// Reads the rows of a file. `take` makes a value of the texts of a row, or refuses them. Throws and
    /// thicknesses are converted to metres. Returns each value.
    fn read<T>(
        &self,
        path: &Path,
        take: impl FnMut(&TableRow<'_>, &[&str]) -> Result<Option<T>>,
    ) -> Result<Vec<T>> {
        let table = Table::read(path, self.terms)?;
        let mut columns = Vec::new();
        for column in self.columns(&table)? {
            let factor = match table.columns()[column].term {
                Some("throw" | "thickness") => table.unit_factor(column, ValueMeasure::Length)?,
                _ => None,
            };
            columns.push((column, factor.unwrap_or(1.0)));
        }
        self.read_columns(&table, &columns, take)
    }

    /// Reads columns of a table, each with the factor of its numbers.
    fn read_columns<T>(
        &self,
        table: &Table,
        columns: &[(usize, f64)],
        mut take: impl FnMut(&TableRow<'_>, &[&str]) -> Result<Option<T>>,
    ) -> Result<Vec<T>> {
        let mut values = Vec::new();
        for row in table.rows() {
            let texts = row.texts();
            let text = |&(column, factor): &(usize, f64)| {
                let text = texts.get(column).cloned().unwrap_or_default();
                match text.parse::<f64>() {
                    Ok(number) if factor != 1.0 => (number * factor).to_string(),
                    _ => text,
                }
            };
            let converted: Vec<String> = columns.iter().map(text).collect();
            let mut words: Vec<&str> = converted.iter().map(String::as_str).collect();
            while words.last().is_some_and(|word| word.is_empty()) {
                words.pop();
            }
            let value = take(&row, &words)?.ok_or_else(|| {
                row.error(
                    format!("'{}' is not {}", words.join(","), self.meaning),
                    self.remedy,
                )
            })?;
            values.push(value);
        }
        Ok(values)
    }
}

/// Reads rows whose columns are not all numbers. `take` makes a value of the texts of a row, in the
/// order of the terms of `kind`, or refuses them. Returns each value with the number of its line.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, and
/// [`Error::Job`](crate::Error::Job) for a row that `take` refuses.
pub fn text_rows<T>(
    path: &Path,
    kind: &ValueTable,
    take: impl Fn(&[&str]) -> Option<T>,
) -> Result<Vec<(usize, T)>> {
    kind.read(path, |row, words| {
        Ok(take(words).map(|value| (row.line, value)))
    })
}

/// Terms of tables of values by region.
const REGION_TERMS: &[Term] = &[REGION];

/// Terms of tables of permeability by region.
const PERMEABILITY_TERMS: &[Term] = &[
    REGION,
    Term::new(
        "kx",
        &["permx", "permeabilityx", "kxx", "permxx", "ki", "permi"],
    ),
    Term::new(
        "ky",
        &["permy", "permeabilityy", "kyy", "permyy", "kj", "permj"],
    ),
    Term::new(
        "kz",
        &["permz", "permeabilityz", "kzz", "permzz", "kk", "permk"],
    ),
    Term::new("kxy", &["permxy", "permeabilityxy"]),
    Term::new("kyz", &["permyz", "permeabilityyz"]),
    Term::new("kxz", &["permxz", "permeabilityxz"]),
    Term::new("kh", &["permh", "permeabilityh", "horizontalpermeability"]),
    Term::new("kv", &["permv", "permeabilityv", "verticalpermeability"]),
    Term::new("permeability", &["perm", "k"]),
];

/// Returns the columns of the region and of the permeability: one number, those along x, y and z, or
/// those of a tensor. The names of columns decide. Without names these are all columns in their order.
fn permeability_columns(table: &Table) -> Result<Vec<usize>> {
    if !table.has_names() {
        return Ok((0..table.columns().len()).collect());
    }
    let key = table.required(&REGION)?;
    let others: Vec<usize> = (0..table.columns().len()).filter(|&k| k != key).collect();
    if let [column] = others[..] {
        return Ok(vec![key, column]);
    }
    let find = |term: usize| table.column(PERMEABILITY_TERMS[term].name);
    let missing = |term: usize| table.missing(&PERMEABILITY_TERMS[term..=term]);
    let [kx, ky, kz] = [find(1)?, find(2)?, find(3)?];
    let [kh, kv] = [find(7)?, find(8)?];
    if kx.is_some() || ky.is_some() || kz.is_some() {
        let kx = kx.ok_or_else(|| missing(1))?;
        let ky = ky.ok_or_else(|| missing(2))?;
        let mut columns = vec![key, kx, ky];
        columns.extend(kz.or(kv));
        for term in 4..=6 {
            columns.extend(find(term)?);
        }
        return Ok(columns);
    }
    if kh.is_some() || kv.is_some() {
        let kh = kh.ok_or_else(|| missing(7))?;
        let kv = kv.ok_or_else(|| missing(8))?;
        return Ok(vec![key, kh, kh, kv]);
    }
    if let Some(column) = find(9)? {
        return Ok(vec![key, column]);
    }
    match others.first() {
        Some(&column) => Err(table.unknown(&table.columns()[column], PERMEABILITY_TERMS)),
        None => Err(missing(9)),
    }
}

/// Reads permeability by region from a table: the region, and one number, those along x, y and z, or
/// those of a tensor, in m^2. `accept` makes a value of the numbers, or refuses them.
///
/// # Errors
/// Returns the errors of [`quantities_by_region`].
pub fn values_by_region<T>(
    path: &Path,
    accept: impl Fn(&[f64]) -> Option<T>,
    remedy: &'static str,
) -> Result<Vec<(i32, T)>> {
    let measure = Some((ValueMeasure::Permeability, 1.0));
    quantities_by_region(path, measure, accept, remedy)
}

/// Reads values by region from a table: the region, and its numbers. `accept` makes a value of the
/// numbers, or refuses them. `measure` is their quantity, with the size of the unit to which numbers are
/// converted whose column states a unit.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, and
/// [`Error::Job`](crate::Error::Job) for a row that is not a region and its value, a region that
/// occurs twice, and a column whose name or unit is not known.
pub fn quantities_by_region<T>(
    path: &Path,
    measure: Option<(ValueMeasure, f64)>,
    accept: impl Fn(&[f64]) -> Option<T>,
    remedy: &'static str,
) -> Result<Vec<(i32, T)>> {
    let is_permeability = measure.is_some_and(|(measure, _)| measure == ValueMeasure::Permeability);
    let kind = ValueTable {
        terms: if is_permeability {
            PERMEABILITY_TERMS
        } else {
            REGION_TERMS
        },
        meaning: "a region and its value",
        remedy,
    };
    let table = Table::read(path, kind.terms)?;
    let columns = if is_permeability {
        permeability_columns(&table)?
    } else {
        kind.columns(&table)?
    };
    let mut converted = Vec::new();
    for (place, column) in columns.into_iter().enumerate() {
        // The first column is the region.
        let factor = match measure {
            Some((measure, size)) if place > 0 => {
                let factor = table.unit_factor(column, measure)?;
                factor.map_or(1.0, |factor| factor / size)
            }
            _ => 1.0,
        };
        converted.push((column, factor));
    }
    let entry = |words: &[&str]| {
        let (region, values) = words.split_first()?;
        let region = region.parse::<f64>().ok().filter(|r| r.fract() == 0.0)? as i32;
        let values: Vec<f64> = values
            .iter()
            .map(|word| word.parse().ok())
            .collect::<Option<_>>()?;
        Some((region, accept(&values)?))
    };
    let mut known: Vec<i32> = Vec::new();
    kind.read_columns(&table, &converted, |row, words| {
        let entry = entry(words);
        if let Some((region, _)) = &entry {
            if known.contains(region) {
                let problem = format!("region {region} is given twice");
                return Err(row.error(problem, "give a value for each region once"));
            }
            known.push(*region);
        }
        Ok(entry)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::values::MILLIDARCY;

    fn read(text: &str, measure: ValueMeasure, size: f64) -> std::result::Result<Vec<f64>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.csv");
        std::fs::write(&path, text).unwrap();
        let all = |values: &[f64]| Some(values.to_vec());
        let rows = quantities_by_region(&path, Some((measure, size)), all, "write region,K");
        let rows = rows.map_err(|error| error.to_string())?;
        Ok(rows.into_iter().flat_map(|row| row.1).collect())
    }

    #[test]
    fn names_of_columns_order_permeability() {
        for text in [
            "1,100,200,10\n",
            "region,KX,KY,KZ\n1,100,200,10\n",
            "region,KZ,KX,KY\n1,10,100,200\n",
            "perm_z;Region;k_x;PERMY\n10;1;100;200\n",
        ] {
            let values = read(text, ValueMeasure::Permeability, 1.0);
            assert_eq!(values.unwrap(), [100.0, 200.0, 10.0], "{text}");
        }
        let values = read("region,kv,kh\n1,10,100\n", ValueMeasure::Permeability, 1.0);
        assert_eq!(values.unwrap(), [100.0, 100.0, 10.0]);
        let values = read(
            "region,porosity,permeability\n1,0.2,100\n",
            ValueMeasure::Permeability,
            1.0,
        );
        assert_eq!(values.unwrap(), [100.0]);
        for (text, expected) in [
            ("region,fast,slow,up\n1,1,2,3\n", ":1: 'fast' is not known"),
            ("region,KX,KZ\n1,1,2\n", ":1: has no column ky"),
        ] {
            let error = read(text, ValueMeasure::Permeability, 1.0).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn units_in_the_names_of_columns_are_converted() {
        let millidarcy = MILLIDARCY;
        for (name, value, factor) in [
            ("permeability", 100.0, 1.0),
            ("permeability (mD)", 100.0, 1.0),
            ("permeability (D)", 0.1, 1.0),
            ("K_mD", 100.0, 1.0),
            ("permeability [m\u{b2}]", 1e-13, 1e-13 / millidarcy / 100.0),
        ] {
            let text = format!("region,{name}\n1,{value:e}\n");
            let values = read(&text, ValueMeasure::Permeability, millidarcy).unwrap();
            assert!((values[0] / (100.0 * factor) - 1.0).abs() < 1e-12, "{name}");
        }
        for name in ["porosity (%)", "porosity [percent]"] {
            let text = format!("region,{name}\n1,25\n");
            assert_eq!(read(&text, ValueMeasure::Fraction, 1.0).unwrap(), [0.25]);
        }
        let error = read("region,porosity (psi)\n1,25\n", ValueMeasure::Fraction, 1.0).unwrap_err();
        assert!(
            error.contains("v.csv:1: column 'porosity' has the unit 'psi', which is none of fraction; give one of %"),
            "{error}"
        );
    }
}
