//! From words to values: the small grammars inside option values.

use std::path::Path;

use crate::{
    Error, Result,
    error::{cause, os},
};

/// An [`Error::Job`] about an option.
pub fn bad(option: &str, value: &str, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{option} {value}"), problem, remedy))
}

/// A finite number.
pub fn number(option: &str, text: &str, remedy: &str) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(bad(option, text, "is not a finite number", remedy)),
        Err(_) => Err(bad(option, text, "is not a number", remedy)),
    }
}

/// Two or three values separated by commas.
fn two_or_three<'a>(option: &str, text: &'a str, remedy: &str) -> Result<Vec<&'a str>> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    match parts.len() {
        2 | 3 => Ok(parts),
        count => Err(bad(
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
    for word in two_or_three(option, text, remedy)? {
        let dim: usize = word
            .parse()
            .map_err(|_| bad(option, text, "is not made of whole numbers", remedy))?;
        dims.push(dim);
        if dim < 2 {
            return Err(bad(
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
        _ => Err(bad(
            option,
            text,
            "is more than 2^32 samples",
            "ask for a smaller volume",
        )),
    }
}

/// `X,Y,Z`: a point; `X,Y` in the plane.
pub fn point<const D: usize>(option: &str, text: &str, remedy: &str) -> Result<[f64; D]> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let Ok(words) = <[&str; D]>::try_from(words.as_slice()) else {
        let problem = format!("has {} values, not {D}", words.len());
        return Err(bad(option, text, &problem, remedy));
    };
    let mut point = [0.0; D];
    for (x, word) in point.iter_mut().zip(words) {
        *x = number(option, word, remedy)?;
    }
    Ok(point)
}

/// Points from a CSV file, one `x,y,z` (`x,y` in 2-D) a line, with the line that each stands on.
pub fn points<const D: usize>(path: &Path) -> Result<Vec<(usize, [f64; D])>> {
    let remedy = match D {
        2 => "write one point a line, as x,y",
        _ => "write one point a line, as x,y,z",
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
    let text = std::fs::read_to_string(path).map_err(|e| os(path, "read", e))?;
    let mut rows = Vec::new();
    for (line, content) in (1..).zip(text.lines().map(str::trim)) {
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = content.split([',', ';', '\t']).map(str::trim).collect();
        let values: Option<Vec<f64>> = words
            .iter()
            .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect();
        match values.and_then(|values| take(&values)) {
            Some(row) => rows.push((line, row)),
            None if rows.is_empty() && words.iter().all(|word| word.parse::<f64>().is_err()) => {}
            None => {
                return Err(Error::Job(cause(
                    format!("{}:{line}", path.display()),
                    format!("'{content}' is not {meaning}"),
                    remedy,
                )));
            }
        }
    }
    Ok(rows)
}

/// Values by region from a CSV file of lines `region,number,...`; `accept` makes a value of the
/// numbers, or refuses. Empty lines, lines that begin with `#` and one line of column names are
/// skipped.
pub fn by_region<T>(
    path: &Path,
    accept: impl Fn(&[f64]) -> Option<T>,
    remedy: &str,
) -> Result<Vec<(i32, T)>> {
    let content = std::fs::read_to_string(path).map_err(|e| os(path, "read", e))?;
    let mut values: Vec<(i32, T)> = Vec::new();
    for (at, line) in content.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let entry = line.split_once(',').and_then(|(region, rest)| {
            let words = rest.split(',').map(|word| word.trim().parse().ok());
            let numbers: Vec<f64> = words.collect::<Option<_>>()?;
            Some((region.trim().parse().ok()?, accept(&numbers)?))
        });
        let refuse = |problem: String, remedy: &str| {
            let place = format!("{}:{}", path.display(), at + 1);
            Err(Error::Job(cause(place, problem, remedy)))
        };
        match entry {
            Some((region, _)) if values.iter().any(|(known, _)| *known == region) => {
                let problem = format!("region {region} for the second time");
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
        std::fs::write(&path, "x,y,z\n# a well\n1,2,3\n\n4.5; -5; 6e1\n").unwrap();
        assert_eq!(
            points::<3>(&path).unwrap(),
            [(3, [1.0, 2.0, 3.0]), (5, [4.5, -5.0, 60.0])]
        );
        for wrong in ["1,2\n", "1,2,nan\n", "1,2,3\nx,y,z\n", "1,2,3,4\n"] {
            std::fs::write(&path, wrong).unwrap();
            assert!(points::<3>(&path).is_err(), "{wrong}");
        }
    }
}
