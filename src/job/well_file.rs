//! Wells along trajectories, as typed: CSV files of x, y, z and radius.

use std::path::Path;

use crate::error::cause;
use crate::files::csv::rows;
use crate::{Error, Result};

/// A well's way as a file has it, in the mesh's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct WellFile<const D: usize> {
    /// The file's name without its ending.
    pub name: String,
    /// For each point the line that it stands on, the point, and the radius of the bore there.
    pub points: Vec<(usize, [f64; D], f64)>,
}

/// Whether a text names such a file.
pub fn is_well_file(text: &str) -> bool {
    Path::new(text)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}

impl<const D: usize> WellFile<D> {
    /// Reads a file of lines `x,y,z,radius` (`x,y,radius` in 2-D).
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Job`] for a line that is something else, a point
    /// twice, or fewer points than `least`.
    pub fn read(path: &Path, least: usize) -> Result<Self> {
        let columns = if D == 2 { "x,y,radius" } else { "x,y,z,radius" };
        let take = |row: &[f64]| {
            let (radius, point) = row.split_last()?;
            Some((<[f64; D]>::try_from(point).ok()?, *radius)).filter(|_| *radius > 0.0)
        };
        let meaning = format!("a point of a well and its radius, {columns}");
        let remedy = format!("write {columns} in each line, the radius above 0");
        let points: Vec<_> = rows(path, take, &meaning, &remedy)?
            .into_iter()
            .map(|(line, (point, radius))| (line, point, radius))
            .collect();
        if points.len() < least {
            let problem = format!(
                "has {} points, but a trajectory needs at least {least}",
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
        for (text, want) in [
            ("1,2,3\n4,5,6\n", "P1.csv:1: '1,2,3' is not a point"),
            ("1,2,3,0.1\n4,5,6,0\n", "P1.csv:2: "),
            ("1,2,3,0.1\n4,5,six,1\n", "P1.csv:2: "),
            ("1,2,3,0.1\n", "has 1 points"),
            ("1,2,3,0.1\n1,2,3,0.1\n", "P1.csv:2: is at the same place"),
        ] {
            std::fs::write(&path, text).unwrap();
            let said = WellFile::<3>::read(&path, 2).unwrap_err().to_string();
            assert!(said.contains(want), "{said}");
        }
        std::fs::write(&path, "1,2,0.1\n").unwrap();
        assert_eq!(WellFile::<2>::read(&path, 1).unwrap().points.len(), 1);
    }
}
