//! From words to values: the small grammars inside option values.

use std::path::Path;

use crate::{
    Error, Result,
    error::{cause, io_error},
};

/// An [`Error::Job`] about an option.
pub fn option_error(option: &str, value: &str, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{option} {value}"), problem, remedy))
}

/// A finite number.
pub fn number(option: &str, text: &str, remedy: &str) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(option_error(option, text, "is not a finite number", remedy)),
        Err(_) => Err(option_error(option, text, "is not a number", remedy)),
    }
}

/// Two or three values separated by commas.
fn split_coordinates<'a>(option: &str, text: &'a str, remedy: &str) -> Result<Vec<&'a str>> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    match parts.len() {
        2 | 3 => Ok(parts),
        count => Err(option_error(
            option,
            text,
            &format!("has {count} values, not 2 or 3"),
            remedy,
        )),
    }
}

/// `NX,NY,NZ`, or `NX,NY` for a 2-D image: numbers of samples, at least two each, and few enough to
/// count.
pub fn dims(option: &str, text: &str) -> Result<Vec<usize>> {
    let remedy = "give two or three whole numbers such as 256,256 or 96,80,64";
    let mut dims = Vec::new();
    for word in split_coordinates(option, text, remedy)? {
        let dim: usize = word
            .parse()
            .map_err(|_| option_error(option, text, "is not made of whole numbers", remedy))?;
        dims.push(dim);
        if dim < 2 {
            return Err(option_error(
                option,
                text,
                "has an axis of fewer than 2 samples",
                remedy,
            ));
        }
    }
    let samples = dims
        .iter()
        .try_fold(1_usize, |product, &dim| product.checked_mul(dim));
    // 2^32 samples are 16 GiB; beyond that an allocation would fail without a word.
    match samples {
        Some(samples) if samples <= 1 << 32 => Ok(dims),
        _ => Err(option_error(
            option,
            text,
            "is more than 2^32 samples",
            "give smaller dimensions",
        )),
    }
}

/// `X,Y,Z`: a point; `X,Y` in the plane.
pub fn point<const D: usize>(option: &str, text: &str, remedy: &str) -> Result<[f64; D]> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let Ok(words) = <[&str; D]>::try_from(words.as_slice()) else {
        let problem = format!("has {} values, not {D}", words.len());
        return Err(option_error(option, text, &problem, remedy));
    };
    let mut point = [0.0; D];
    for (x, word) in point.iter_mut().zip(words) {
        *x = number(option, word, remedy)?;
    }
    Ok(point)
}

/// A physical coordinate by its number, and whether it is positive: x, y, z or -x, -y, -z; in the plane
/// without z.
pub fn axis<const D: usize>(option: &str, text: &str) -> Result<(usize, bool)> {
    let axes = &["x", "y", "z"][..D];
    let name = text.strip_prefix('-').unwrap_or(text);
    match axes.iter().position(|&axis| axis == name) {
        Some(axis) => Ok((axis, name.len() == text.len())),
        None => {
            let remedy = format!("give {}, or -{}", axes.join(", "), axes.join(", -"));
            Err(option_error(
                option,
                text,
                "is not an axis of the mesh",
                &remedy,
            ))
        }
    }
}

/// Points from a CSV file, one `x,y,z` (`x,y` in 2-D) a line, with the line that each stands on.
pub fn points<const D: usize>(path: &Path) -> Result<Vec<(usize, [f64; D])>> {
    let remedy = match D {
        2 => "write one point per line, as x,y",
        _ => "write one point per line, as x,y,z",
    };
    let point = |row: &[f64]| <[f64; D]>::try_from(row).ok();
    rows(path, point, &format!("{D} finite numbers"), remedy)
}

/// Rows of finite numbers from a CSV file, as `take` understands them, with the line that each stands
/// on. Empty lines, lines that begin with `#` and one line of column names are skipped; errors call a
/// row `meaning`.
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

/// The same for rows whose columns are not all numbers.
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

/// A line of a CSV file: its number from 1, itself, and what stands between the separators.
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

/// Values by region from a CSV file of lines `region,number,...`; `accept` makes a value of the
/// numbers, or refuses. Empty lines, lines that begin with `#` and one line of column names are
/// skipped.
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
                return refuse(problem, "give each region once");
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
    fn dims_that_overflow_are_refused() {
        assert_eq!(dims("--dims", "3, 4,5").unwrap(), [3, 4, 5]);
        for wrong in [
            "4294967296,4294967296,4294967296",
            "1,5,5",
            "3",
            "3,4,5,6",
            "-3,4,5",
            "a,b,c",
        ] {
            assert!(dims("--dims", wrong).is_err(), "{wrong}");
        }
    }

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
