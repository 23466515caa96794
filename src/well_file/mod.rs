//! Trajectories of wells in files: points, or deviation surveys.
//!
//! | columns | trajectory |
//! |---|---|
//! | x, y and z, or depth, tvd, tvdss, elevation | the points |
//! | md, inclination and azimuth, without x and y | from the wellhead by the minimum-curvature method (Taylor and Mason 1972, *Trans. AIME* 253) |
//!
//! A column of names of wells gives several wells. The wellhead and the datum of measured depths stand in
//! the file's comments, as Petrel and LAS write them.

mod survey;

use std::collections::BTreeMap;
use std::path::Path;

use crate::Result;
use crate::files::table::{Table, TableRow};
use crate::image::stated::StatedCoordinates;
use crate::surface_file::place_columns::{
    PLACE_TERMS, PlaceReading, has_coordinates, named_readings, unit_ratio,
};
use survey::Survey;

/// A well trajectory from a file, in the coordinates of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct WellFile<const D: usize> {
    /// Name of the well: that in the file, or the name of the file without its ending.
    pub name: String,
    /// The points, in their order.
    pub points: Vec<WellPoint<D>>,
    /// The statements of the file about its coordinates.
    pub coordinates: StatedCoordinates,
    /// Notes on assumptions.
    pub notes: Vec<String>,
    /// The wellhead of a deviation survey whose offsets may have another unit than the wellhead.
    pub survey: Option<SurveyOffsets>,
}

/// The wellhead of a deviation survey. The offsets of its points from it are in the unit of measured
/// depths.
#[derive(Debug, Clone, PartialEq)]
pub struct SurveyOffsets {
    /// The wellhead, in the coordinates of the points.
    pub head: [f64; 3],
    /// The unit of measured depths, if the file says it.
    pub unit: Option<String>,
}

impl SurveyOffsets {
    /// Returns a point whose offset from the wellhead is converted to the units of coordinates.
    /// `factors` are the sizes of the unit of measured depths in these units.
    pub fn converted<const D: usize>(&self, point: [f64; D], factors: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| match self.head.get(k) {
            Some(head) => head + (point[k] - head) * factors[k],
            None => point[k],
        })
    }
}

/// A point of a well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellPoint<const D: usize> {
    /// The line of the file, from 1.
    pub line: usize,
    /// The position.
    pub position: [f64; D],
    /// The radius of the bore, if the file has it.
    pub radius: Option<f64>,
}

/// Endings of files of wells that need not exist when an option is read.
const ENDINGS: [&str; 10] = [
    "csv", "tsv", "txt", "dev", "las", "dat", "asc", "prn", "wlp", "survey",
];

/// Returns `true` if a text names a file of wells.
pub fn is_well_file(text: &str) -> bool {
    let path = Path::new(text);
    let ending = path.extension().unwrap_or_default();
    ENDINGS
        .iter()
        .any(|known| ending.eq_ignore_ascii_case(known))
        || path.is_file()
}

impl<const D: usize> WellFile<D> {
    /// Reads all wells of a file. `columns` names the columns in place of the file, and `head` is the
    /// wellhead of a deviation survey (x, y, and the height of its measured depth 0).
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, and
    /// [`Error::Job`](crate::Error::Job), with the line, for what is
    /// not a table of wells, for a repeated point, or for a well of fewer than `min_points` points.
    pub fn read_all(
        path: &Path,
        columns: &[String],
        head: Option<[f64; 3]>,
        min_points: usize,
    ) -> Result<Vec<Self>> {
        let mut table = Table::read(path, PLACE_TERMS)?;
        if !columns.is_empty() {
            table.set_columns(columns, PLACE_TERMS)?;
        }
        let wells = if is_deviation_survey(&table)? {
            Survey::new(&table, head)?.wells()?
        } else {
            wells_of_points(&table)?
        };
        for well in &wells {
            well.check(&table, min_points)?;
        }
        if wells.is_empty() {
            return Err(table.error("has no point of a well", "write a line for each point"));
        }
        Ok(wells)
    }

    /// Refuses a well of too few points, and one that repeats a point.
    fn check(&self, table: &Table, min_points: usize) -> Result<()> {
        let count = self.points.len();
        if count < min_points {
            let name = if self.name == stem(table) {
                String::new()
            } else {
                format!("{} ", self.name)
            };
            let problem =
                format!("{name}has {count} points, but a trajectory needs at least {min_points}");
            return Err(table.error(problem, "write a line for each point"));
        }
        match self
            .points
            .windows(2)
            .find(|pair| pair[0].position == pair[1].position)
        {
            Some(pair) => Err(table.error_at(
                pair[1].line,
                "is at the same place as the point before",
                "remove one of them",
            )),
            None => Ok(()),
        }
    }
}

/// Returns the name of a table's file without its ending.
fn stem(table: &Table) -> String {
    table
        .path()
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Returns `true` if a table has measured depths and angles but no places.
fn is_deviation_survey(table: &Table) -> Result<bool> {
    let mut has_all = true;
    for name in ["md", "inclination"] {
        has_all &= table.column(name)?.is_some();
    }
    has_all &= table
        .column("azimuth")?
        .or(table.column("azimuth-true")?)
        .is_some();
    Ok(has_all && (table.column("x")?.is_none() || table.column("y")?.is_none()))
}

/// The column of names of a table's wells, and the name of one without.
struct WellNames {
    column: Option<usize>,
    default: String,
}

impl WellNames {
    fn of_table(table: &Table) -> Result<Self> {
        let by_file = table.remark_text(&["wellname", "well"]);
        let by_file = by_file
            .map(|name| name.trim_end_matches("()").trim())
            .filter(|name| !name.is_empty());
        let mut column = table.column("well")?;
        if column.is_none()
            && let Some(name) = table.column("name")?
        {
            // Names of points are no names of wells.
            let mut names: Vec<Option<&str>> = Vec::new();
            let rows: Vec<TableRow<'_>> = table.rows().collect();
            for row in &rows {
                if !names.contains(&row.text(name)) {
                    names.push(row.text(name));
                }
            }
            column = (2 * names.len() <= rows.len()).then_some(name);
        }
        Ok(Self {
            column,
            default: by_file.map_or_else(|| stem(table), String::from),
        })
    }

    /// Returns the rows of each well, in the order in which the wells appear.
    fn groups<'a>(&self, table: &'a Table) -> Vec<(String, Vec<TableRow<'a>>)> {
        let mut groups: Vec<(String, Vec<TableRow<'a>>)> = Vec::new();
        let mut indices: BTreeMap<String, usize> = BTreeMap::new();
        for row in table.rows() {
            let name = self.column.and_then(|column| row.text(column));
            let name = name.unwrap_or(&self.default).to_string();
            let index = *indices.entry(name.clone()).or_insert_with(|| {
                groups.push((name, Vec::new()));
                groups.len() - 1
            });
            groups[index].1.push(row);
        }
        groups
    }
}

/// The column of radii or diameters.
struct Bore {
    column: Option<usize>,
    /// The radius in the unit of the coordinates, of a value 1.
    factor: f64,
}

impl Bore {
    fn of_table(table: &Table, unit: Option<&str>) -> Result<Self> {
        let radius = table.column("radius")?;
        let diameter = table.column("diameter")?;
        let column = radius.or(diameter);
        let own = column.and_then(|column| table.columns()[column].unit.as_deref());
        // Coordinates without a unit count as metres here.
        let ratio = unit_ratio(own, Some(unit.unwrap_or("m")));
        let factor = if radius.is_some() { ratio } else { 0.5 * ratio };
        Ok(Self { column, factor })
    }

    /// Returns the radius in a row.
    fn radius(&self, row: &TableRow<'_>) -> Result<Option<f64>> {
        let Some(column) = self.column else {
            return Ok(None);
        };
        match row.number(column)? {
            Some(value) if value > 0.0 => Ok(Some(self.factor * value)),
            Some(value) => {
                let problem = format!("has a radius of {value}, which is not above 0");
                Err(row.error(
                    problem,
                    "give radii above 0, or name the columns in the first line",
                ))
            }
            None => Ok(None),
        }
    }
}

/// Returns the wells of a table of points.
fn wells_of_points<const D: usize>(table: &Table) -> Result<Vec<WellFile<D>>> {
    let (reading, bore) = if table.has_names() || has_coordinates(table) {
        let reading = named_readings::<D>(table)?.swap_remove(0);
        let bore = Bore::of_table(table, reading.coordinates.units[0].as_deref())?;
        (reading, bore)
    } else {
        unnamed_columns(table)?
    };
    let names = WellNames::of_table(table)?;
    let mut wells = Vec::new();
    for (name, rows) in names.groups(table) {
        let mut notes = reading.notes.clone();
        let mut points = Vec::new();
        let count = rows.len();
        for row in rows {
            let mut position = [0.0; D];
            for (value, &column) in position.iter_mut().zip(&reading.columns) {
                let number = row.number(column)?;
                *value = number
                    .filter(|n| !table.nulls().contains(n))
                    .unwrap_or(f64::NAN);
            }
            position[D - 1] += reading.shift;
            let radius = bore.radius(&row)?;
            if position.iter().all(|c| c.is_finite()) {
                points.push(WellPoint {
                    line: row.line,
                    position,
                    radius,
                });
            }
        }
        if points.len() < count {
            notes.push(format!("rows without a place: {}", count - points.len()));
        }
        if bore.column.is_none() {
            notes.push("the file has no radius".into());
        }
        wells.push(WellFile {
            name,
            points,
            coordinates: reading.coordinates.clone(),
            notes,
            survey: None,
        });
    }
    Ok(wells)
}

/// Returns the columns of a table without names: the coordinates, and perhaps the radius.
fn unnamed_columns<const D: usize>(table: &Table) -> Result<(PlaceReading<D>, Bore)> {
    let count = table.columns().len();
    let columns = if D == 2 { "x,y,radius" } else { "x,y,z,radius" };
    if count != D && count != D + 1 {
        let problem = format!("has {count} columns without names");
        let remedy =
            format!("write {columns} in each line, or the names of the columns in the first");
        return Err(table.error(problem, remedy));
    }
    let mut reading = PlaceReading {
        columns: std::array::from_fn(|k| k),
        lines: None,
        is_numbered: false,
        shift: 0.0,
        coordinates: StatedCoordinates::default(),
        notes: Vec::new(),
    };
    let is_radius = count > D && is_column_of_radii(table, D)?;
    if count > D && !is_radius {
        reading.notes.push(format!(
            "the values of column {} are no radii: they are left out",
            D + 1
        ));
    }
    let bore = Bore {
        column: is_radius.then_some(D),
        factor: 1.0,
    };
    Ok((reading, bore))
}

/// Returns `true` if the values of a column may be radii of bores. Measured depths, which some programs write
/// behind the coordinates, grow from row to row and are larger.
fn is_column_of_radii(table: &Table, column: usize) -> Result<bool> {
    const MAX_RADIUS: f64 = 10.0;
    let mut values = Vec::new();
    for row in table.rows() {
        values.extend(row.number(column)?);
    }
    let grows = values.len() > 2 && values.windows(2).all(|pair| pair[1] > pair[0]);
    let is_large = values.iter().any(|value| *value > MAX_RADIUS);
    Ok(!(grows && is_large))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::stated::ZDirection;

    fn read(text: &str) -> std::result::Result<Vec<WellFile<3>>, String> {
        read_as(text, None)
    }

    fn read_as(
        text: &str,
        head: Option<[f64; 3]>,
    ) -> std::result::Result<Vec<WellFile<3>>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("P1.csv");
        std::fs::write(&path, text).unwrap();
        WellFile::read_all(&path, &[], head, 2).map_err(|e| e.to_string())
    }

    #[test]
    fn wells_are_read_and_bad_lines_named() {
        for text in [
            "x,y,z,radius\n1,2,3,0.1\n\n1,2,9,0.1\n",
            "1,2,3,0.1\n#\n#\n1,2,9,0.1\n",
            "Diameter;z;Northing;Easting\n0,2;3;2;1\n\n0,2;9;2;1\nEOF\n",
            "Y X Z Bore(cm)\n2 1 3 20\n\n2 1 9 20\n",
        ] {
            let well = read(text).unwrap().swap_remove(0);
            assert_eq!(well.name, "P1");
            let points: Vec<_> = well
                .points
                .iter()
                .map(|p| (p.position, p.radius.unwrap()))
                .collect();
            assert_eq!(
                points,
                [([1.0, 2.0, 3.0], 0.1), ([1.0, 2.0, 9.0], 0.1)],
                "{text}"
            );
            assert!(well.points[1].line >= 4);
        }
        let well = read("1,2,3\n4,5,6\n").unwrap().swap_remove(0);
        assert_eq!((well.points[0].radius, well.notes.len()), (None, 1));
        for (text, expected) in [
            (
                "1,2,3,4,5\n4,5,6,7,8\n",
                "P1.csv: has 5 columns without names; write x,y,z,radius",
            ),
            ("1,2,3,0.1\n4,5,6,0\n", "P1.csv:2: has a radius of 0"),
            ("1,2,3,0.1\n4,5,six,1\n", "P1.csv:2: 'six' is not a number"),
            ("1,2,3,0.1\n", "has 1 points"),
            ("1,2,3,0.1\n1,2,3,0.1\n", "P1.csv:2: is at the same place"),
            (
                "x,y,colour,size\n1,2,3,4\n",
                "P1.csv:1: has no column z or tvdss",
            ),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("P1.csv");
        for text in ["1,2,0.1\n", "y,radius,x\n2,0.1,1\n", "depth,x,r\n2,1,0.1\n"] {
            std::fs::write(&path, text).unwrap();
            let well = WellFile::<2>::read_all(&path, &[], None, 1)
                .unwrap()
                .swap_remove(0);
            assert_eq!(
                (well.points[0].position, well.points[0].radius),
                ([1.0, 2.0], Some(0.1))
            );
        }
    }

    #[test]
    fn measured_depths_behind_coordinates_are_no_radii() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.txt");
        let radii = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let well = WellFile::<3>::read_all(&path, &[], None, 2).unwrap();
            let radii = well[0].points.iter().map(|point| point.radius);
            radii.collect::<Vec<_>>()
        };
        assert_eq!(radii("1 2 3 0\n1 2 9 600\n1 2 20 1700\n"), [None; 3]);
        assert_eq!(
            radii("1 2 3 0.1\n1 2 9 0.2\n1 2 20 0.3\n"),
            [Some(0.1), Some(0.2), Some(0.3)]
        );
    }

    #[test]
    fn petrels_remark_says_the_unit_of_depths() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.dev");
        let head = "# WELL TRACE FROM PETREL\n# WELL HEAD X-COORDINATE: 450300.0 (m)\n\
                    # WELL HEAD Y-COORDINATE: 6780300.0 (m)\n\
                    # WELL DATUM (KB, Kelly bushing, from MSL): 82.021 (ft)\n\
                    # DX DY ARE GIVEN IN GRID NORTH IN m-UNITS\n\
                    # DEPTH (Z, TVD) GIVEN IN ft-UNITS\n#====\n";
        let read = |table: &str| {
            std::fs::write(&path, format!("{head}{table}")).unwrap();
            WellFile::<3>::read_all(&path, &[], None, 2)
                .unwrap()
                .remove(0)
        };
        let trace =
            read("MD X Y Z TVD\n0 450300 6780300 82.021 0\n1000 450300 6780300 -917.979 1000\n");
        assert_eq!(trace.coordinates.units[2].as_deref(), Some("ft"));
        // 1,000 ft at 60 degrees towards the east, in metres.
        let survey = read("MD INCL AZIM_GN\n0 60 90\n1000 60 90\n");
        let [x, _, z] = survey.points[1].position;
        assert!((x - 450_300.0 - 304.8 * 0.75f64.sqrt()).abs() < 1e-6, "{x}");
        assert!((z - 25.0 + 152.4).abs() < 1e-3, "{z}");
    }

    #[test]
    fn a_wellhead_of_the_option_keeps_its_units() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.dev");
        std::fs::write(&path, "MD (ft),INC,AZI\n0,45,90\n1000,45,90\n").unwrap();
        let head = [450_000.0, 6_780_000.0, 25.0];
        let well = &WellFile::<3>::read_all(&path, &[], Some(head), 2).unwrap()[0];
        assert_eq!(well.coordinates.units, [None, None, None]);
        let survey = well.survey.as_ref().unwrap();
        assert_eq!(survey.unit.as_deref(), Some("ft"));
        let last = survey.converted(well.points[1].position, [0.3048, 0.3048, 0.3048]);
        let offset = 304.8 * 0.5f64.sqrt();
        assert!((last[0] - head[0] - offset).abs() < 1e-6, "{last:?}");
        assert!((last[2] - head[2] + offset).abs() < 1e-6, "{last:?}");
    }

    #[test]
    fn columns_of_names_give_wells() {
        let text = "Well Name,X,Y,TVDSS,Radius\nWell A 1,1,2,3,0.1\nB,4,5,6,0.1\nWell A 1,1,2,9,0.1\nB,4,5,9,0.1\n";
        let wells = read(text).unwrap();
        let names: Vec<&str> = wells.iter().map(|well| &*well.name).collect();
        assert_eq!(names, ["Well A 1", "B"]);
        assert_eq!(wells[0].points[1].position, [1.0, 2.0, 9.0]);
        assert_eq!(wells[1].coordinates.z_direction, Some(ZDirection::Down));
        let error = read("well,x,y,z\nA,1,2,3\nA,1,2,4\nB,1,2,3\n").unwrap_err();
        assert!(error.contains("B has 1 points"), "{error}");
    }

    /// Returns a survey that builds from vertical to `end` degrees on a circle of this radius, in
    /// `count` steps, to this azimuth.
    fn circle(radius: f64, end: f64, azimuth: f64, count: usize) -> String {
        let station = |k: usize| {
            let inclination = end * k as f64 / count as f64;
            format!(
                "{},{inclination},{azimuth}\n",
                radius * inclination.to_radians()
            )
        };
        (0..=count).map(station).collect()
    }

    #[test]
    fn minimum_curvature_follows_a_circle_exactly() {
        for (end, azimuth, count) in [
            (90.0, 30.0, 3),
            (60.0, 250.0, 1),
            (1e-4, 10.0, 2),
            (120.0, 0.0, 7),
        ] {
            let text = format!(
                "# WELL HEAD X-COORDINATE: 450000.0 (m)\n# WELL HEAD Y-COORDINATE: 6780000.0 (m)\n\
                 # WELL DATUM (KB, Kelly bushing, from MSL): 25.0 (m)\nMD,INCL,AZIM_GN\n{}",
                circle(500.0, end, azimuth, count)
            );
            let well = read(&text).unwrap().swap_remove(0);
            let (s, c) = f64::to_radians(end).sin_cos();
            let (east, north) = f64::to_radians(azimuth).sin_cos();
            let out = 500.0 * (1.0 - c);
            let expected = [
                450_000.0 + out * east,
                6_780_000.0 + out * north,
                25.0 - 500.0 * s,
            ];
            let last = well.points.last().unwrap().position;
            for k in 0..3 {
                assert!(
                    (last[k] - expected[k]).abs() < 1e-8,
                    "{last:?} {expected:?}"
                );
            }
            assert_eq!(well.coordinates.z_direction, Some(ZDirection::Up));
            assert_eq!(well.coordinates.units[2].as_deref(), Some("m"));
        }
    }

    #[test]
    fn a_turn_in_the_plane_is_a_circle_too() {
        // Horizontal, from north to east on a circle of radius 100.
        let text = format!(
            "md,inc,azi\n0,90,0\n{},90,90\n",
            50.0 * std::f64::consts::PI
        );
        let well = read_as(&text, Some([0.0; 3])).unwrap().swap_remove(0);
        let last = well.points.last().unwrap().position;
        assert!(
            (last[0] - 100.0).abs() + (last[1] - 100.0).abs() + last[2].abs() < 1e-9,
            "{last:?}"
        );
    }

    #[test]
    fn surveys_are_vertical_to_the_first_station_and_take_units() {
        let text = "# X-COORDINATE: 100 (m)\n# Y-COORDINATE: 200 (m)\n# KB: 10 (m)\nMD (ft),Inc,Azi,Diameter(in)\n1000,0,0,8\n2000,0,0,8\n";
        let well = read(text).unwrap().swap_remove(0);
        let heights: Vec<f64> = well.points.iter().map(|p| p.position[2]).collect();
        assert_eq!(heights, [10.0, 10.0 - 304.8, 10.0 - 609.6]);
        assert!((well.points[0].radius.unwrap() - 4.0 * 0.0254).abs() < 1e-12);
        for (text, expected) in [
            (
                "md,inc,azi\n0,0,0\n10,0,0\n",
                "P1.csv: is a deviation survey that does not say where the well begins",
            ),
            (
                "# X: 1\n# Y: 2\nmd,inc,azi\n0,0,0\n10,200,0\n",
                "P1.csv:5: has an inclination of 200",
            ),
            (
                "# X: 1\n# Y: 2\nmd,inc,azi\n10,0,0\n5,0,0\n",
                "P1.csv:5: has a measured depth of 5, less",
            ),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn petrels_trajectories_have_places_beside_their_angles() {
        let text = "# WELL TRACE FROM PETREL\n# WELL NAME:              A-1 T2\n# WELL HEAD X-COORDINATE: 450000.0 (m)\n\
                    # WELL HEAD Y-COORDINATE: 6780000.0 (m)\n# WELL DATUM (KB, Kelly bushing, from MSL): 25.0 (m)\n\
                    #====================\n      MD              X              Y          Z          TVD        DX       DY      AZIM_TN   INCL    DLS\n\
                    0.0 450000.0 6780000.0 25.0 0.0 0.0 0.0 0.0 0.0 0.0\n100.0 450001.0 6780002.0 -75.0 100.0 1.0 2.0 0.0 0.0 0.0\n";
        let well = read(text).unwrap().swap_remove(0);
        assert_eq!(
            (&*well.name, well.points[1].position),
            ("A-1 T2", [450_001.0, 6_780_002.0, -75.0])
        );
        assert_eq!(well.coordinates.z_direction, None);
    }
}
