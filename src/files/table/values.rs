//! Tables of values: by surface, and by region.

use std::path::Path;

use super::{Table, TableRow, Term};
use crate::Result;

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

    /// Reads the rows of a file. `take` makes a value of the texts of a row, or refuses them. Returns each
    /// value.
    fn read<T>(
        &self,
        path: &Path,
        mut take: impl FnMut(&TableRow<'_>, &[&str]) -> Result<Option<T>>,
    ) -> Result<Vec<T>> {
        let table = Table::read(path, self.terms)?;
        let columns = self.columns(&table)?;
        let mut values = Vec::new();
        for row in table.rows() {
            let texts = row.texts();
            let text = |&k: &usize| texts.get(k).map_or("", String::as_str);
            let mut words: Vec<&str> = columns.iter().map(text).collect();
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

/// Reads values by region from a table: the region, and its numbers. `accept` makes a value of the
/// numbers, or refuses them.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, and
/// [`Error::Job`](crate::Error::Job) for a row that is not a region and its value, or a region that
/// occurs twice.
pub fn values_by_region<T>(
    path: &Path,
    accept: impl Fn(&[f64]) -> Option<T>,
    remedy: &'static str,
) -> Result<Vec<(i32, T)>> {
    let kind = ValueTable {
        terms: &[REGION],
        meaning: "a region and its value",
        remedy,
    };
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
    kind.read(path, |row, words| {
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
