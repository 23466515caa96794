//! Fixed atoms in tables of points.

use std::path::Path;

use crate::Result;
use crate::files::table::Table;
use crate::image::stated::StatedCoordinates;
use crate::surface_file::place_columns::{PLACE_TERMS, has_coordinates, named_readings};

/// Points from a file, in the coordinates of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomFile<const D: usize> {
    /// The points, each with the number of its line.
    pub points: Vec<(usize, [f64; D])>,
    /// The statements of the file about its coordinates.
    pub coordinates: StatedCoordinates,
    /// Notes on assumptions.
    pub notes: Vec<String>,
}

impl<const D: usize> AtomFile<D> {
    /// Reads a table with the columns x, y and z, in any order if they have names. `columns` names them
    /// in place of the file.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, and
    /// [`Error::Job`](crate::Error::Job), with the line, for what is not a table of points.
    pub fn read(path: &Path, columns: &[String]) -> Result<Self> {
        let mut table = Table::read(path, PLACE_TERMS)?;
        if table.is_empty() {
            let remedy = match D {
                2 => "write x,y in each line",
                _ => "write x,y,z in each line",
            };
            return Err(table.error("has no atom", remedy));
        }
        if !columns.is_empty() {
            table.set_columns(columns, PLACE_TERMS)?;
        }
        let remedy = match D {
            2 => "write one point per line, as x,y",
            _ => "write one point per line, as x,y,z",
        };
        let mut atoms = Self {
            points: Vec::new(),
            coordinates: StatedCoordinates::default(),
            notes: Vec::new(),
        };
        let (mut columns, mut shift) = (std::array::from_fn(|k| k), 0.0);
        if table.has_names() || has_coordinates(&table) {
            let reading = named_readings::<D>(&table)?.swap_remove(0);
            (columns, shift) = (reading.columns, reading.shift);
            (atoms.coordinates, atoms.notes) = (reading.coordinates, reading.notes);
        } else if table.columns().len() != D {
            let problem = format!(
                "has {} columns without names, not {D}",
                table.columns().len()
            );
            return Err(table.error(
                problem,
                format!("{remedy}, or name the columns in the first line"),
            ));
        }
        for row in table.rows() {
            let mut point = [0.0; D];
            for (value, &column) in point.iter_mut().zip(&columns) {
                *value = row
                    .number(column)?
                    .ok_or_else(|| row.error("is not a point", remedy))?;
            }
            point[D - 1] += shift;
            atoms.points.push((row.line, point));
        }
        Ok(atoms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn atoms_are_read_by_the_names_of_columns_or_in_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("atoms.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            AtomFile::<3>::read(&path, &[]).map_err(|e| e.to_string())
        };
        for text in [
            "x,y,z\n# a well\n1,2,3\n\n4.5,-5,\"6e1\"",
            "# a well\n\n1 2 3\n\n4.5 -5 6e1\n",
            "id;northing;EASTING;Depth\n\n1;2;1;3\n\n2;-5;4,5;60\nEND\n",
        ] {
            let atoms = read(text).unwrap();
            assert_eq!(
                atoms.points,
                [(3, [1.0, 2.0, 3.0]), (5, [4.5, -5.0, 60.0])],
                "{text}"
            );
        }
        for (text, expected) in [
            (
                "# a well\r\n\r\n1,2,3\r\n\r\n1,2,x\r\n",
                "atoms.csv:5: 'x' is not a number",
            ),
            (
                "1,2\n",
                "has 2 columns without names, not 3; write one point per line, as x,y,z",
            ),
            ("1,2,nan\n", "atoms.csv:1: is not a point"),
            ("1,2,3,4\n", "has 4 columns without names"),
            ("", "atoms.csv: has no atom; write x,y,z in each line"),
            (
                "x,y,z\n",
                "atoms.csv: has no atom; write x,y,z in each line",
            ),
            (
                "# a well\n\n",
                "atoms.csv: has no atom; write x,y,z in each line",
            ),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }
}
