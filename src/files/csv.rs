//! Tables in CSV files.
//!
//! Columns are separated by commas, semicolons or tabs. Empty lines and lines that begin with `#` are
//! skipped, as is one line of column names at the top. Errors name the file and the line.

use std::path::Path;

use crate::error::{cause, io_error};
use crate::{Error, Result};

/// Reads points from a CSV file, one `x,y,z` (`x,y` in 2-D) per line. Returns each with the number of its
/// line.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, [`Error::Job`] for a line that is not a point.
pub fn points<const D: usize>(path: &Path) -> Result<Vec<(usize, [f64; D])>> {
    let remedy = match D {
        2 => "write one point per line, as x,y",
        _ => "write one point per line, as x,y,z",
    };
    let point = |row: &[f64]| <[f64; D]>::try_from(row).ok();
    rows(path, point, &format!("{D} finite numbers"), remedy)
}

/// Reads rows of finite numbers from a CSV file. `take` makes a value of the numbers of a row, or refuses
/// them; errors call a row `meaning`. Returns each value with the number of its line.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, [`Error::Job`] for a row that `take` refuses.
pub fn rows<T>(
    path: &Path,
    take: impl Fn(&[f64]) -> Option<T>,
    meaning: &str,
    remedy: &str,
) -> Result<Vec<(usize, T)>> {
    let take = |words: &[&str]| {
        let values: Option<Vec<f64>> = words
            .iter()
            .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect();
        values.and_then(|values| take(&values))
    };
    text_rows(path, take, meaning, remedy)
}

/// Reads rows whose columns are not all numbers. `take` makes a value of the texts of a row, or refuses
/// them; errors call a row `meaning`. Returns each value with the number of its line.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, [`Error::Job`] for a row that `take` refuses.
pub fn text_rows<T>(
    path: &Path,
    take: impl Fn(&[&str]) -> Option<T>,
    meaning: &str,
    remedy: &str,
) -> Result<Vec<(usize, T)>> {
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let mut rows = Vec::new();
    // Only the first line may be one of words that name the columns.
    let mut named = false;
    for CsvLine {
        number,
        text,
        fields: words,
    } in lines(&text, path)?
    {
        match take(&words.iter().collect::<Vec<_>>()) {
            Some(row) => rows.push((number, row)),
            None if rows.is_empty()
                && !named
                && words.iter().all(|word| word.parse::<f64>().is_err()) =>
            {
                named = true;
            }
            None => {
                return Err(Error::Job(cause(
                    format!("{}:{number}", path.display()),
                    format!("'{text}' is not {meaning}"),
                    remedy,
                )));
            }
        }
    }
    Ok(rows)
}

/// A row of a table: its line number, and its words.
pub type TableRow = (usize, Vec<String>);

/// Reads a table whose first row has the names of the columns, in any order and all of them in
/// `known`. Returns the names, and the rows.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`] for a name that is not known
/// or is given twice.
pub fn named_rows(path: &Path, known: &[&str]) -> Result<(Vec<String>, Vec<TableRow>)> {
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let texts = |line: &CsvLine| line.fields.iter().map(String::from).collect::<Vec<_>>();
    let lines = lines(&text, path)?;
    let Some((head, rows)) = lines.split_first() else {
        let remedy = format!("write a row of names: {}", known.join(","));
        return Err(Error::Job(cause(path.display(), "is empty", remedy)));
    };
    let names = texts(head);
    let is_wrong = |(at, name): (usize, &String)| {
        !known.contains(&name.as_str()) || names[..at].contains(name)
    };
    if let Some(at) = (0..names.len()).find(|&at| is_wrong((at, &names[at]))) {
        return Err(Error::Job(cause(
            format!("{}:{}", path.display(), head.number),
            format!(
                "'{}' is not the name of a column, or stands there twice",
                names[at]
            ),
            format!(
                "write names of columns in the first row, from: {}",
                known.join(", ")
            ),
        )));
    }
    let rows = rows.iter().map(|line| (line.number, texts(line)));
    Ok((names, rows.collect()))
}

/// A line of a CSV file: its number from 1, its text, and its columns.
struct CsvLine<'a> {
    number: usize,
    text: &'a str,
    fields: csv::StringRecord,
}

/// The lines of a CSV file, without empty ones and those that begin with `#`. Separators are those of
/// the first line: semicolons, tabs or commas.
fn lines<'a>(text: &'a str, path: &Path) -> Result<Vec<CsvLine<'a>>> {
    let is_row = |line: &&str| !line.is_empty() && !line.starts_with('#');
    let first = text.lines().map(str::trim).find(is_row).unwrap_or_default();
    let mut separators = [b';', b'\t', b','].into_iter();
    let separator = separators.find(|&s| first.contains(char::from(s)));
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(separator.unwrap_or(b','))
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .has_headers(false)
        .from_reader(text.as_bytes());
    let mut lines = Vec::new();
    for record in reader.records() {
        let refuse = |error: csv::Error| {
            let remedy = "write numbers with commas between them";
            Error::Job(cause(
                path.display(),
                format!("is not a CSV file: {error}"),
                remedy,
            ))
        };
        let words = record.map_err(refuse)?;
        let Some(position) = words.position() else {
            continue;
        };
        // A record is said to begin where the one before ends: comments and empty lines follow.
        let rest = text.get(position.byte() as usize..).unwrap_or_default();
        let own = rest.lines().enumerate().map(|(i, line)| (i, line.trim()));
        let mut own = own.skip_while(|(_, line)| !is_row(line));
        if let Some((skipped, text)) = own.next()
            && !(words.len() == 1 && words[0].is_empty())
        {
            lines.push(CsvLine {
                number: position.line() as usize + skipped,
                text,
                fields: words,
            });
        }
    }
    Ok(lines)
}

/// Reads values by region from a CSV file of lines `region,number,...`. `accept` makes a value of the
/// numbers, or refuses them.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, [`Error::Job`] for a line that is not a region and its
/// value, or a region that occurs twice.
pub fn values_by_region<T>(
    path: &Path,
    accept: impl Fn(&[f64]) -> Option<T>,
    remedy: &str,
) -> Result<Vec<(i32, T)>> {
    let content = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let mut values: Vec<(i32, T)> = Vec::new();
    for CsvLine {
        number,
        text: line,
        fields: words,
    } in lines(&content, path)?
    {
        let entry = || {
            let numbers = words.iter().skip(1).map(|word| word.parse().ok());
            let numbers: Vec<f64> = numbers.collect::<Option<_>>()?;
            Some((words[0].parse().ok()?, accept(&numbers)?))
        };
        let refuse = |problem: String, remedy: &str| {
            let place = format!("{}:{number}", path.display());
            Err(Error::Job(cause(place, problem, remedy)))
        };
        match entry() {
            Some((region, _)) if values.iter().any(|(known, _)| *known == region) => {
                let problem = format!("region {region} is given twice");
                return refuse(problem, "give a value for each region once");
            }
            Some(entry) => values.push(entry),
            // One line of column names.
            None if values.is_empty() && line.starts_with("region") => {}
            None => return refuse(format!("'{line}' is not a region and its value"), remedy),
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_from_csv() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wells.csv");
        let want = [(3, [1.0, 2.0, 3.0]), (7, [4.5, -5.0, 60.0])];
        let text = "x,y,z\n# a well\n1,2,3\n\n  \n# more\n4.5, -5,\"6e1\"";
        for separator in [",", ";", "\t"] {
            for ending in ["\n", "\r\n"] {
                let text = text.replace(',', separator).replace('\n', ending);
                std::fs::write(&path, text).unwrap();
                assert_eq!(
                    points::<3>(&path).unwrap(),
                    want,
                    "{separator:?} {ending:?}"
                );
            }
        }
        std::fs::write(&path, "# a well\r\n\r\n1,2,3\r\n\r\n1,2,x\r\n").unwrap();
        let error = points::<3>(&path).unwrap_err().to_string();
        assert!(error.contains("wells.csv:5: '1,2,x' is not"), "{error}");
        for wrong in ["1,2\n", "1,2,nan\n", "1,2,3\nx,y,z\n", "1,2,3,4\n"] {
            std::fs::write(&path, wrong).unwrap();
            assert!(points::<3>(&path).is_err(), "{wrong}");
        }
    }
}
