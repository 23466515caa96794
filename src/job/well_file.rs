//! CSV files of well trajectories: lines of x, y, z and radius.

use std::path::Path;

use crate::error::cause;
use crate::files::csv::rows;
use crate::{Error, Result};

/// A well trajectory from a file, in the mesh's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct WellFile<const D: usize> {
    /// Name of the file without its ending.
    pub name: String,
    /// For each point its line number in the file, its position, and the radius of the bore.
    pub points: Vec<(usize, [f64; D], f64)>,
}

/// Returns `true` if a text names a CSV file.
pub fn is_well_file(text: &str) -> bool {
    Path::new(text)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}

impl<const D: usize> WellFile<D> {
    /// Reads a file of lines `x,y,z,radius` (`x,y,radius` in 2-D).
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`] for any other kind of
    /// line, for a repeated point, or for fewer than `min_points` points.
    pub fn read(path: &Path, min_points: usize) -> Result<Self> {
        let columns = if D == 2 { "x,y,radius" } else { "x,y,z,radius" };
        let parse_row = |row: &[f64]| {
            let (radius, point) = row.split_last()?;
            Some((<[f64; D]>::try_from(point).ok()?, *radius)).filter(|_| *radius > 0.0)
        };
        let meaning = format!("a point of a well and its radius, {columns}");
        let remedy = format!("write {columns} in each line, the radius above 0");
        let points: Vec<_> = rows(path, parse_row, &meaning, &remedy)?
            .into_iter()
            .map(|(line, (point, radius))| (line, point, radius))
            .collect();
        if points.len() < min_points {
            let problem = format!(
                "has {} points, but a trajectory needs at least {min_points}",
                points.len()
            );
            return Err(Error::Job(cause(path.display(), problem, remedy)));
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[0].1 == pair[1].1) {
            return Err(Error::Job(cause(
                format!("{}:{}", path.display(), pair[1].0),
                "is at the same place as the point before",
                "remove one of them",
            )));
        }
        let name = path.file_stem().unwrap_or_default();
        Ok(Self {
            name: name.to_string_lossy().into_owned(),
            points,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wells_are_read_and_bad_lines_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("P1.csv");
        std::fs::write(&path, "x,y,z,radius\n1,2,3,0.1\n\n1,2,9,0.1\n").unwrap();
        let well = WellFile::<3>::read(&path, 2).unwrap();
        assert_eq!(well.name, "P1");
        assert_eq!(
            well.points,
            [(2, [1.0, 2.0, 3.0], 0.1), (4, [1.0, 2.0, 9.0], 0.1)]
        );
        for (text, expected) in [
            ("1,2,3\n4,5,6\n", "P1.csv:1: '1,2,3' is not a point"),
            ("1,2,3,0.1\n4,5,6,0\n", "P1.csv:2: "),
            ("1,2,3,0.1\n4,5,six,1\n", "P1.csv:2: "),
            ("1,2,3,0.1\n", "has 1 points"),
            ("1,2,3,0.1\n1,2,3,0.1\n", "P1.csv:2: is at the same place"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = WellFile::<3>::read(&path, 2).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        std::fs::write(&path, "1,2,0.1\n").unwrap();
        assert_eq!(WellFile::<2>::read(&path, 1).unwrap().points.len(), 1);
    }
}
