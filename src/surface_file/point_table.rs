//! Surfaces in tables: points and fault sticks, one or several surfaces in a file.
//!
//! Columns are known by their names ([`PLACE_TERMS`]). A table without names may be read in several
//! ways, which [`TableReadings`] holds until the image is known; the one that fits it counts.

mod levels;
mod unnamed;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::interpretation::{PickedShape, PickedSurface};
use super::place_columns::{
    PLACE_TERMS, PlaceReading, has_coordinates, named_readings, number_columns, term,
};
use super::sticks::{FaultSticks, Stick};
use levels::has_several_levels;
use unnamed::guessed_surfaces;

use crate::error::cause;
use crate::files::table::{Table, TableRow};
use crate::image::stated::{Domain, StatedCoordinates};
use crate::{Error, Result, names};

/// Points of a table that can be read in several ways.
#[derive(Debug, Clone, PartialEq)]
pub struct TableReadings {
    /// Numbers of each row, NaN where there is none.
    values: Vec<f64>,
    /// Number of columns.
    width: usize,
    /// The readings, in the order in which they are tried.
    readings: Vec<PlaceReading<3>>,
}

/// An image, as far as it decides how a table is read.
pub struct ReadingFrame<'a> {
    /// Returns `true` if a point of the table lies in the image, with the one or the other sign of z.
    pub contains: &'a dyn Fn([f64; 3]) -> bool,
    /// Returns `true` if a place in the plane lies in the image.
    pub contains_in_plane: &'a dyn Fn([f64; 2]) -> bool,
    /// Distances between samples along the axes of the image.
    pub spacing: [f64; 3],
    /// The domain of z, if it is known.
    pub domain: Option<Domain>,
}

/// A reading that fits an image.
#[derive(Debug, Clone, PartialEq)]
pub struct FittingReading {
    /// The points.
    pub points: Vec<[f64; 3]>,
    /// The statements of the table about them.
    pub coordinates: StatedCoordinates,
    /// A note on the columns that were taken.
    pub note: String,
}

/// Smallest share of points in the image of a reading that fits.
const MIN_SHARE: f64 = 0.5;

/// The problem of points of several surfaces in one.
const SEVERAL_LEVELS: &str =
    "has points with clearly different z at many places: the file seems to hold several surfaces";

/// The remedy for points of several surfaces in one.
const SEVERAL_LEVELS_REMEDY: &str =
    "add a column of the names of surfaces, or write a file for each surface";

/// Largest number of points that are tried.
const MAX_TRIED: usize = 5000;

/// Ratios of the distance between lines of a survey to that between samples of its image.
const LINE_RATIOS: [f64; 7] = [0.25, 1.0 / 3.0, 0.5, 1.0, 2.0, 3.0, 4.0];

/// Largest relative difference of a distance between lines from one of these ratios.
const LINE_TOLERANCE: f64 = 0.02;

impl TableReadings {
    /// Returns the number of readings.
    pub fn count(&self) -> usize {
        self.readings.len()
    }

    /// Returns the points of a reading.
    pub fn points(&self, reading: usize) -> Vec<[f64; 3]> {
        let reading = &self.readings[reading];
        let rows = self.values.chunks_exact(self.width);
        let points = rows.map(|row| shifted(reading.columns.map(|k| row[k]), reading.shift));
        points.filter(|p| p.iter().all(|c| c.is_finite())).collect()
    }

    /// Returns the reading that fits an image. `option` is the option that names the file, for messages.
    ///
    /// # Errors
    /// Returns [`Error::Job`], with all readings, if none fits or several do, and for points of several
    /// surfaces above each other.
    pub fn fit(&self, option: &str, frame: &ReadingFrame<'_>) -> Result<FittingReading> {
        let fitting = self.fitting_reading(option, frame)?;
        if has_several_levels(&fitting.points) {
            return Err(Error::Job(cause(
                option,
                SEVERAL_LEVELS,
                SEVERAL_LEVELS_REMEDY,
            )));
        }
        Ok(fitting)
    }

    fn fitting_reading(&self, option: &str, frame: &ReadingFrame<'_>) -> Result<FittingReading> {
        let all: Vec<usize> = (0..self.readings.len()).collect();
        let in_domain = |&k: &usize| {
            let domain = self.readings[k].coordinates.domain;
            domain.is_some() && domain == frame.domain
        };
        let is_named = self
            .readings
            .iter()
            .any(|reading| reading.coordinates.domain.is_some());
        if is_named {
            return Ok(self.take(all.iter().copied().find(in_domain).unwrap_or(0)));
        }
        let points = |k: usize| {
            let points = self.points(k);
            let step = points.len().div_ceil(MAX_TRIED).max(1);
            points.into_iter().step_by(step).collect::<Vec<_>>()
        };
        let tried: Vec<Vec<[f64; 3]>> = all.iter().map(|&k| points(k)).collect();
        let share = |k: usize, is_inside: &dyn Fn([f64; 3]) -> bool| {
            let count = tried[k].iter().filter(|p| is_inside(**p)).count();
            count as f64 >= MIN_SHARE * tried[k].len().max(1) as f64
        };
        let in_plane = |p: [f64; 3]| (frame.contains_in_plane)([p[0], p[1]]);
        let mut fitting: Vec<usize> = all
            .iter()
            .copied()
            .filter(|&k| share(k, &frame.contains))
            .collect();
        if fitting.is_empty() {
            // z may have another unit.
            fitting = all
                .iter()
                .copied()
                .filter(|&k| share(k, &in_plane))
                .collect();
        }
        let is_certain = |k: &usize| {
            self.readings[*k].is_numbered && self.readings[*k].lines.is_none()
                || self.has_lines_of_survey(*k, frame.spacing)
        };
        let has_no_lines = |k: &usize| self.readings[*k].lines.is_none();
        for rank in [
            &is_certain as &dyn Fn(&usize) -> bool,
            &has_no_lines,
            &|_| true,
        ] {
            let best: Vec<usize> = fitting.iter().copied().filter(rank).collect();
            match best[..] {
                [] => {}
                [only] => return Ok(self.take(only)),
                _ => {
                    return Err(self.unclear(
                        option,
                        &best,
                        "several readings of its columns fit the image",
                    ));
                }
            }
        }
        Err(self.unclear(option, &all, "no reading of its columns lies in the image"))
    }

    fn take(&self, reading: usize) -> FittingReading {
        FittingReading {
            points: self.points(reading),
            coordinates: self.readings[reading].coordinates.clone(),
            note: format!("columns read as {}", self.readings[reading].column_names()),
        }
    }

    fn unclear(&self, option: &str, readings: &[usize], problem: &str) -> Error {
        let commands = readings.iter().map(|&k| {
            let names = self.readings[k].column_names();
            format!("--{option},columns={names}")
        });
        let commands: Vec<String> = commands.collect();
        let problem = format!("has columns without names, and {problem}");
        let remedy = format!(
            "name the columns in the file's first line, or give {}",
            commands.join(" or ")
        );
        Error::Job(cause(option, problem, remedy))
    }

    /// Returns `true` if x and y follow from the line numbers of a reading, at distances between lines
    /// that suit an image's samples.
    fn has_lines_of_survey(&self, reading: usize, spacing: [f64; 3]) -> bool {
        let reading = &self.readings[reading];
        let Some(lines) = reading.lines else {
            return false;
        };
        let rows = self.values.chunks_exact(self.width);
        let rows: Vec<[f64; 4]> = rows
            .map(|row| {
                [
                    row[lines[0]],
                    row[lines[1]],
                    row[reading.columns[0]],
                    row[reading.columns[1]],
                ]
            })
            .filter(|row| row.iter().all(|value| value.is_finite()))
            .collect();
        let Some(steps) = line_steps(&rows) else {
            return false;
        };
        steps.iter().all(|step| {
            let fits = |&s: &f64| {
                LINE_RATIOS
                    .iter()
                    .any(|r| (step / (s * r) - 1.0).abs() < LINE_TOLERANCE)
            };
            spacing.iter().any(fits)
        })
    }
}

/// Returns the distances in the plane between inlines and crosslines of rows `inline, crossline, x, y`;
/// `None` if x and y are no linear functions of the line numbers.
fn line_steps(rows: &[[f64; 4]]) -> Option<[f64; 2]> {
    let count = rows.len().max(1) as f64;
    let mean: [f64; 4] =
        std::array::from_fn(|k| rows.iter().map(|row| row[k]).sum::<f64>() / count);
    let centred = || {
        rows.iter()
            .map(|row| -> [f64; 4] { std::array::from_fn(|k| row[k] - mean[k]) })
    };
    let product = |k: usize, l: usize| centred().map(|row| row[k] * row[l]).sum::<f64>();
    let (ii, ic, cc) = (product(0, 0), product(0, 1), product(1, 1));
    let determinant = ii * cc - ic * ic;
    if determinant <= 1e-9 * ii * cc {
        return None;
    }
    let axis = |k: usize| {
        let (i, c) = (product(0, k), product(1, k));
        [
            (i * cc - c * ic) / determinant,
            (c * ii - i * ic) / determinant,
        ]
    };
    let axes = [axis(2), axis(3)];
    let steps = [0, 1].map(|k| axes[0][k].hypot(axes[1][k]));
    let tolerance = 0.05 * steps[0].min(steps[1]);
    let is_linear = centred().all(|row| {
        let residual = [0, 1].map(|k| row[2 + k] - axes[k][0] * row[0] - axes[k][1] * row[1]);
        residual[0].hypot(residual[1]) <= tolerance
    });
    is_linear.then_some(steps)
}

fn shifted([x, y, z]: [f64; 3], shift: f64) -> [f64; 3] {
    [x, y, z + shift]
}

/// Reads the surfaces of a table. `stem` names one without a name of its own, and `columns` names the
/// columns in place of the file.
///
/// # Errors
/// Returns [`Error::Job`], with the line, for a text that is not a table of points.
pub fn read_point_table(path: &Path, stem: &str, columns: &[String]) -> Result<Vec<PickedSurface>> {
    let mut table = Table::read(path, PLACE_TERMS)?;
    if !columns.is_empty() {
        table.set_columns(columns, PLACE_TERMS)?;
    }
    let surfaces = if !has_coordinates(&table) && !table.has_names() {
        guessed_surfaces(&table, stem)?
    } else {
        let readings = named_readings::<3>(&table)?;
        Groups::read(&table, &readings, stem)?.into_surfaces(&readings)?
    };
    for surface in &surfaces {
        if let PickedShape::Points(points) = &surface.shape
            && surface.is_horizon != Some(false)
            && has_several_levels(points)
        {
            return Err(table.error(SEVERAL_LEVELS, SEVERAL_LEVELS_REMEDY));
        }
    }
    Ok(surfaces)
}

/// Reads the fault sticks of a table.
///
/// # Errors
/// Returns [`Error::Job`], with the line, for a text that is not a table of sticks.
pub fn read_stick_table(path: &Path, stem: &str) -> Result<Vec<FaultSticks>> {
    let table = Table::read(path, PLACE_TERMS)?;
    table.required(term("stick"))?;
    let readings = named_readings::<3>(&table)?;
    Ok(Groups::read(&table, &readings, stem)?.into_faults(&readings[0]))
}

/// Rows of one surface.
struct Group {
    name: String,
    /// Numbers of the rows.
    values: Vec<f64>,
    /// The line and the stick of each row.
    rows: Vec<(usize, String)>,
    /// Number of rows without a place.
    missing: usize,
}

/// The surfaces of a table with names of columns.
struct Groups {
    groups: Vec<Group>,
    width: usize,
    /// The term of the column of names.
    kind: Option<&'static str>,
    has_sticks: bool,
}

/// Terms of columns of names, the most telling first.
const NAME_TERMS: [&str; 5] = ["fault", "horizon", "surface", "zone", "name"];

impl Groups {
    fn read(table: &Table, readings: &[PlaceReading<3>], stem: &str) -> Result<Self> {
        let mut name_column = None;
        for term in NAME_TERMS {
            if name_column.is_none() {
                let column = table.column(term)?;
                let column = column.filter(|&column| has_surface_names(table, term, column));
                name_column = column.map(|column| (term, column));
            }
        }
        let kind = name_column.map(|(term, _)| term);
        let stick = table.column("stick")?;
        let has_segments = table.rows().any(|row| row.segment > 1);
        let mut groups = Self {
            groups: Vec::new(),
            width: table.columns().len(),
            kind,
            has_sticks: kind != Some("horizon") && (stick.is_some() || has_segments),
        };
        let mut columns: Vec<usize> = readings
            .iter()
            .flat_map(|reading| reading.columns)
            .collect();
        columns.sort_unstable();
        columns.dedup();
        let mut indices: BTreeMap<String, usize> = BTreeMap::new();
        for row in table.rows() {
            let name = name_column.and_then(|(_, column)| row.text(column));
            let name = name.unwrap_or(stem).to_string();
            let index = *indices.entry(name.clone()).or_insert_with(|| {
                groups.groups.push(Group {
                    name,
                    values: Vec::new(),
                    rows: Vec::new(),
                    missing: 0,
                });
                groups.groups.len() - 1
            });
            let stick = match stick {
                Some(column) => row.text(column).unwrap_or("").to_string(),
                None => row.segment.to_string(),
            };
            groups.groups[index].add(&row, groups.width, &columns, stick)?;
        }
        Ok(groups)
    }

    /// Returns `true` for horizons and `false` for faults; `None` if the table does not say.
    fn is_horizon(&self, name: &str) -> Option<bool> {
        let begins_with = |kind: &str| name.to_lowercase().starts_with(kind);
        match self.kind {
            Some("fault") => Some(false),
            Some("horizon") => Some(true),
            _ if self.has_sticks || begins_with("fault") => Some(false),
            _ if begins_with("horizon") => Some(true),
            _ => None,
        }
    }

    fn into_faults(self, reading: &PlaceReading<3>) -> Vec<FaultSticks> {
        let fault = |group: Group| FaultSticks {
            sticks: group.sticks(self.width, reading),
            name: group.name,
            coordinates: reading.coordinates.clone(),
        };
        self.groups.into_iter().map(fault).collect()
    }

    fn into_surfaces(self, readings: &[PlaceReading<3>]) -> Result<Vec<PickedSurface>> {
        let mut surfaces = Vec::new();
        for group in &self.groups {
            let mut notes = readings[0].notes.clone();
            if group.missing > 0 {
                notes.push(format!("rows without a place: {}", group.missing));
            }
            let shape = if self.has_sticks {
                PickedShape::Sticks(group.sticks(self.width, &readings[0]))
            } else {
                let table = TableReadings {
                    values: group.values.clone(),
                    width: self.width,
                    readings: readings.to_vec(),
                };
                match readings.len() {
                    1 => PickedShape::Points(table.points(0)),
                    _ => PickedShape::Readings(table),
                }
            };
            surfaces.push(PickedSurface {
                is_horizon: self.is_horizon(&group.name),
                name: names::from_file(&group.name),
                shape,
                coordinates: readings[0].coordinates.clone(),
                notes,
            });
        }
        Ok(surfaces)
    }
}

/// Returns `true` if a column of this term names surfaces: names of points and of single zones do not,
/// nor do numbers of zones.
fn has_surface_names(table: &Table, term: &str, column: usize) -> bool {
    if !matches!(term, "name" | "zone") {
        return true;
    }
    let names: BTreeSet<String> = table
        .rows()
        .filter_map(|row| row.text(column).map(String::from))
        .collect();
    let are_repeated = 3 * names.len() <= table.rows().count();
    let are_zones = || names.len() > 1 && !number_columns(table)[column];
    are_repeated && (term != "zone" || are_zones())
}

impl Group {
    fn add(
        &mut self,
        row: &TableRow<'_>,
        width: usize,
        columns: &[usize],
        stick: String,
    ) -> Result<()> {
        let mut values = vec![f64::NAN; width];
        for &column in columns {
            values[column] = row.number(column)?.unwrap_or(f64::NAN);
        }
        self.missing += usize::from(columns.iter().any(|&column| values[column].is_nan()));
        self.values.extend(values);
        self.rows.push((row.line, stick));
        Ok(())
    }
}

impl Group {
    /// Returns the sticks: the rows of each name, in their order.
    fn sticks(&self, width: usize, reading: &PlaceReading<3>) -> Vec<Stick> {
        let mut sticks: Vec<Stick> = Vec::new();
        let mut indices: BTreeMap<&str, usize> = BTreeMap::new();
        for (row, (line, name)) in self.values.chunks_exact(width).zip(&self.rows) {
            let point = shifted(reading.columns.map(|k| row[k]), reading.shift);
            if point.iter().any(|c| !c.is_finite()) {
                continue;
            }
            let index = *indices.entry(name).or_insert_with(|| {
                sticks.push(Stick {
                    name: name.clone(),
                    line: Some(*line),
                    points: Vec::new(),
                });
                sticks.len() - 1
            });
            sticks[index].points.push(point);
        }
        sticks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::stated::ZDirection;
    use crate::surface_file::interpretation::{read_interpretation, read_interpretation_as};

    fn write(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("top A.xyz");
        std::fs::write(&path, text).unwrap();
        (folder, path)
    }

    fn read(text: &str) -> Vec<PickedSurface> {
        read_interpretation(&write(text).1).unwrap()
    }

    /// Returns the reading of a surface that fits the box from `low` to `high`.
    fn fit(surface: &PickedSurface, low: [f64; 3], high: [f64; 3]) -> Result<FittingReading> {
        let PickedShape::Readings(table) = &surface.shape else {
            panic!("one reading")
        };
        let is_inside =
            |p: [f64; 3], axes: usize| (0..axes).all(|k| (low[k]..=high[k]).contains(&p[k]));
        let frame = ReadingFrame {
            contains: &|p| is_inside(p, 3) || is_inside([p[0], p[1], -p[2]], 3),
            contains_in_plane: &|[x, y]| is_inside([x, y, 0.0], 2),
            spacing: [10.0, 12.5, 5.0],
            domain: Some(Domain::Time),
        };
        table.fit("surface a.xyz", &frame)
    }

    #[test]
    fn names_of_columns_tell_units_direction_and_domain() {
        let stated = |header: &str, z: f64| {
            let surface = read(&format!("{header}\n1,2,{z}\n3,4,{z}\n5,6,{z}\n")).swap_remove(0);
            assert!(
                matches!(&surface.shape, PickedShape::Points(points) if points[1] == [3.0, 4.0, z]),
                "{header}"
            );
            surface.coordinates
        };
        let down = stated("Easting (m),Northing (m),TVDSS [ft]", 7.0);
        assert_eq!(
            down.units,
            ["m", "m", "ft"].map(|unit| Some(unit.to_string()))
        );
        assert_eq!(
            (down.z_direction, down.domain),
            (Some(ZDirection::Down), Some(Domain::Depth))
        );
        assert_eq!(stated("x,y,depth", -7.0).z_direction, Some(ZDirection::Up));
        assert_eq!(
            stated("UTM-X,UTM-Y,Elevation", -7.0).z_direction,
            Some(ZDirection::Up)
        );
        let time = stated("X,Y,TWT(ms)", 7.0);
        assert_eq!(
            (time.z_direction, time.domain),
            (Some(ZDirection::Down), Some(Domain::Time))
        );
        assert_eq!(stated("x,y,z(ms)", 7.0).domain, Some(Domain::Time));
        assert_eq!(stated("x,y,Z (TWT)", 7.0).domain, Some(Domain::Time));
        assert_eq!(stated("x,y,z", 7.0), StatedCoordinates::default());
        assert_eq!(stated("x,y,Top_Balder", 7.0), StatedCoordinates::default());
        let petrel = "# Petrel Points with attributes\n# Unit in X and Y direction: m\n# Unit in depth: ft\nVERSION 1\nBEGIN HEADER\nX\nY\nZ\nFLOAT,Thickness\nEND HEADER\n1 2 -3 9\n";
        let surface = read(petrel).swap_remove(0);
        assert_eq!(surface.shape, PickedShape::Points(vec![[1.0, 2.0, -3.0]]));
        assert_eq!(surface.coordinates.units[2].as_deref(), Some("ft"));
    }

    #[test]
    fn depths_below_the_kelly_bushing_are_shifted() {
        let surface = read("# KB: 25 (m)\nx,y,tvd\n1,2,100\n").swap_remove(0);
        assert_eq!(surface.shape, PickedShape::Points(vec![[1.0, 2.0, 75.0]]));
        let surface = read("x,y,tvd\n1,2,100\n").swap_remove(0);
        assert_eq!(surface.shape, PickedShape::Points(vec![[1.0, 2.0, 100.0]]));
        assert!(
            surface.notes[0].contains("no kelly bushing"),
            "{:?}",
            surface.notes
        );
    }

    #[test]
    fn columns_of_names_give_surfaces_and_those_of_sticks_sticks() {
        for (column, kinds) in [
            ("Horizon", Some(true)),
            ("fault_name", Some(false)),
            ("Surface", None),
        ] {
            let text = format!("x;{column};y;z\n1;Top A;2;3\n4;Base;5;6\n7;Top A;8;9\n");
            let surfaces = read(&text);
            let names: Vec<&str> = surfaces.iter().map(|surface| &*surface.name).collect();
            assert_eq!(names, ["Top A", "Base"]);
            assert_eq!(surfaces[0].is_horizon, kinds, "{column}");
            assert_eq!(
                surfaces[0].shape,
                PickedShape::Points(vec![[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]])
            );
        }
        // The points of a stick may stand apart.
        let text = "Stick ID\tFault\tNorthing\tEasting\tZ\n1\tA\t2\t1\t0\n2\tA\t2\t5\t0\n1\tA\t2\t1\t-9\n2\tA\t2\t5\t-9\n";
        let surfaces = read(text);
        let PickedShape::Sticks(sticks) = &surfaces[0].shape else {
            panic!("no sticks")
        };
        let points: Vec<&[[f64; 3]]> = sticks.iter().map(|stick| &*stick.points).collect();
        assert_eq!(
            points,
            [
                [[1.0, 2.0, 0.0], [1.0, 2.0, -9.0]],
                [[5.0, 2.0, 0.0], [5.0, 2.0, -9.0]]
            ]
        );
        assert_eq!(
            (sticks[1].line, surfaces[0].is_horizon),
            (Some(3), Some(false))
        );
        let words = "Fault Name Stick ID Easting Northing Z\nMain 1 1 2 -3\nMain 2 4 5 -6\n";
        let surfaces = read(words);
        assert_eq!((&*surfaces[0].name, surfaces.len()), ("Main", 1));
        assert!(matches!(&surfaces[0].shape, PickedShape::Sticks(sticks) if sticks.len() == 2));
        let zones = "X_UTME,Y_UTMN,Z_TVDSS,ZONE\n1,2,3,Upper\n4,5,6,Lower\n7,8,9,Upper\n1,2,4,Lower\n4,5,7,Upper\n7,8,10,Lower\n";
        let names: Vec<String> = read(zones)
            .into_iter()
            .map(|surface| surface.name)
            .collect();
        assert_eq!(names, ["Upper", "Lower"]);
        let numbers = zones.replace("Upper", "1").replace("Lower", "2");
        assert_eq!(read(&numbers).len(), 1);
        // Names of points are not names of surfaces.
        assert_eq!(read("name,x,y,z\np1,1,2,3\np2,4,5,6\np3,7,8,9\n").len(), 1);
        // IRAP's lines are separated by rows of 999.
        let irap = "1 2 0\n1 2 -9\n999.0 999.0 999.0\n5 2 0\n5 2 -9\n999.0 999.0 999.0\n";
        assert!(matches!(&read(irap)[0].shape, PickedShape::Sticks(sticks) if sticks.len() == 2));
    }

    #[test]
    fn names_in_a_table_without_names_of_columns_give_surfaces() {
        for row in [
            "\"NAME\"\tX\tY\tZ",
            "NAME X Y Z",
            "X Y Z NAME",
            "NAME 5 7 X Y Z",
        ] {
            let mut text = String::new();
            for (name, top) in [("Top_A", 100.5), ("Base_B", 300.5)] {
                for n in 0..100 {
                    let (x, y) = (
                        f64::from(n % 10) * 25.0 + 0.5,
                        f64::from(n / 10) * 25.0 + 0.5,
                    );
                    let z = top + 0.1 * x;
                    let line = row.replace("NAME", name).replace('X', &x.to_string());
                    let line = line.replace('Y', &y.to_string());
                    text += &(line.replace('Z', &z.to_string()) + "\n");
                }
            }
            let surfaces = read(&text);
            let names: Vec<&str> = surfaces.iter().map(|surface| &*surface.name).collect();
            assert_eq!(names, ["Top_A", "Base_B"], "{row}");
            assert!(!surfaces[0].is_duplicate(&surfaces[1]), "{row}");
            for surface in &surfaces {
                assert_eq!(surface.shape.points().count(), 100, "{row}");
            }
            // Without names, they are no surface.
            let text = text.replace("Top_A", "").replace("Base_B", "");
            if !row.contains('5') {
                let error = read_interpretation(&write(&text).1)
                    .unwrap_err()
                    .to_string();
                assert!(error.contains("seems to hold several surfaces"), "{error}");
            }
        }
        let earth_vision = "# Type: scattered data\n# Field: 1 x\n# Field: 2 y\n# Field: 3 z meters\n# Field: 4 Horizon Name non-numeric\n1 2 3 Top_A\n4 5 6 Base_B\n7 8 9 Top_A\n";
        let surfaces = read(earth_vision);
        let names: Vec<&str> = surfaces.iter().map(|surface| &*surface.name).collect();
        assert_eq!(names, ["Top_A", "Base_B"]);
        assert_eq!(surfaces[0].is_horizon, Some(true));
    }

    #[test]
    fn sticks_and_nodes_after_coordinates_are_fault_sticks() {
        // `dip` is the change of z from node to node, and `bend` that of their distance.
        let rows = |fault: &str, first: i32, dip: f64, bend: f64| {
            let row = |n: i32| {
                let (stick, node) = (n / 5, f64::from(n % 5));
                let x = 1000.5 + 50.0 * node + bend * node * node + 10.0 * f64::from(stick);
                let y = 500.5 + 100.0 * f64::from(stick);
                let z = 1460.5 + dip * node;
                let node = n % 5 + first;
                format!("{fault}{x}\t{y}\t{z}\t{}\t{node}\n", stick + first)
            };
            (0..20).map(row).collect::<String>()
        };
        let sticks = |text: &str| -> Vec<usize> {
            let count = |surface: PickedSurface| match surface.shape {
                PickedShape::Sticks(sticks) => {
                    assert_eq!(surface.is_horizon, Some(false));
                    assert!(sticks.iter().all(|stick| stick.points.len() == 5));
                    sticks.len()
                }
                _ => 0,
            };
            read(text).into_iter().map(count).collect()
        };
        assert_eq!(sticks(&rows("", 0, 100.0, 0.0)), [4]);
        assert_eq!(sticks(&rows("", 1, 0.1, 10.0)), [4]);
        let two = rows("\"F 1\"\t", 1, 100.0, 0.0) + &rows("\"F 2\"\t", 1, 80.0, 0.0);
        assert_eq!(sticks(&two), [4, 4]);
        assert_eq!(read(&two)[1].name, "F 2");
        // A horizon with line numbers from 1.
        assert_eq!(sticks(&rows("", 1, 2.0, 0.0)), [0]);
    }

    #[test]
    fn without_names_the_reading_that_fits_the_image_counts() {
        let grid = |row: &dyn Fn(i32, i32, [f64; 3]) -> String| {
            let place = |i: i32, c: i32| {
                [
                    1000.0 + 10.0 * f64::from(c),
                    500.0 + 12.5 * f64::from(i),
                    -300.0 - f64::from(i),
                ]
            };
            let rows = (0..40)
                .map(|n| (n / 8, n % 8))
                .map(|(i, c)| row(i, c, place(i, c)));
            rows.collect::<Vec<_>>().join("\n")
        };
        let image = ([990.0, 490.0, 0.0], [1200.0, 700.0, 400.0]);
        for (text, columns) in [
            (
                grid(&|i, c, [x, y, z]| format!("{} {} {x} {y} {z}", 100 + i, 300 + c)),
                "_,_,x,y,z",
            ),
            (
                grid(&|i, c, [x, y, z]| format!("{x} {y} {} {} {z}", 100 + i, 300 + c)),
                "x,y,_,_,z",
            ),
            (
                grid(&|i, c, [x, y, z]| format!("{x} {y} {z} {i} {c}.5")),
                "x,y,z",
            ),
            (
                grid(&|i, c, [x, y, z]| format!("{} {x} {y} {z}", 8 * i + c)),
                "_,x,y,z",
            ),
            (
                grid(&|i, c, [x, y, z]| format!("{},{i},{c},{x},{y},{z},7", 8 * i + c + 1)),
                "_,_,_,x,y,z",
            ),
            (
                grid(&|i, c, [x, y, z]| {
                    format!("INLINE : {} XLINE : {} {x} {y} {z}", 100 + i, 300 + c)
                }),
                "_,_,_,_,_,_,x,y,z",
            ),
        ] {
            let surface = read(&text).swap_remove(0);
            let fitting = fit(&surface, image.0, image.1).unwrap();
            assert_eq!(fitting.note, format!("columns read as {columns}"), "{text}");
            assert_eq!(fitting.points[9], [1010.0, 512.5, -301.0], "{text}");
            let error = fit(&surface, [0.0; 3], [1.0; 3]).unwrap_err().to_string();
            assert!(
                error.contains("no reading of its columns")
                    && error.contains(&format!(",columns={columns}")),
                "{error}"
            );
            // The user's names are taken as they are.
            let names: Vec<String> = columns.split(',').map(String::from).collect();
            let named = read_interpretation_as(&write(&text).1, &names).unwrap();
            assert_eq!(named[0].shape, PickedShape::Points(fitting.points));
        }
    }

    #[test]
    fn readings_that_fit_alike_are_all_named() {
        // Two columns of line numbers that do not belong to any line of the image.
        let text: String = (0..40)
            .map(|n| format!("{} {} {} {} {}\n", n % 7, n % 5, n % 3, (n * n) % 4, n % 6))
            .collect();
        let surface = read(&text).swap_remove(0);
        let fitting = fit(&surface, [0.0; 3], [9.0; 3]).unwrap();
        assert_eq!(fitting.note, "columns read as x,y,z");
        let text: String = (0..40)
            .map(|n| format!("{} 100.5 {} {} {}\n", 200 + n, n % 3, (n * n) % 4, n % 6))
            .collect();
        let surface = read(&text).swap_remove(0);
        let error = fit(&surface, [900.0; 3], [950.0; 3])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("--surface a.xyz,columns=x,y,z or --surface a.xyz,columns=x,y,_,_,z"),
            "{error}"
        );
    }

    #[test]
    fn depth_or_time_is_taken_as_the_image_has_it() {
        let surface = read("x,y,depth,twt\n1,2,900,500\n3,4,901,501\n").swap_remove(0);
        let fitting = fit(&surface, [0.0; 3], [9.0; 3]).unwrap();
        assert_eq!(fitting.points[0], [1.0, 2.0, 500.0]);
        assert_eq!(fitting.coordinates.domain, Some(Domain::Time));
    }

    #[test]
    fn tables_without_a_place_are_errors() {
        for (text, expected) in [
            (
                "right,high,z\n1,2,3\n",
                "top A.xyz:1: has no column x: its columns are right, high, z",
            ),
            (
                "x,y,colour,size\n1,2,3,4\n",
                "top A.xyz:1: has no column z or tvdss or elevation",
            ),
            ("1 2\n3 4\n", "top A.xyz:1: has 2 numbers"),
            ("x,y,z\n1,2,deep\n", "top A.xyz:2: 'deep' in column z"),
        ] {
            let error = read_interpretation(&write(text).1).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
