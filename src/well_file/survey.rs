//! Deviation surveys: trajectories from measured depths and angles by the minimum-curvature method (Taylor and Mason
//! 1972, *Trans. AIME* 253).

use super::{Bore, SurveyOffsets, WellFile, WellNames, WellPoint};
use crate::Result;
use crate::files::table::{Table, TableRow};
use crate::image::stated::{Domain, StatedCoordinates, ZDirection};
use crate::surface_file::place_columns::{datum, term, unit_given_in_remark, unit_ratio};
use crate::units;

/// A station of a deviation survey.
#[derive(Debug, Clone, Copy)]
struct Station {
    measured_depth: f64,
    /// Angle from the vertical, in radians.
    inclination: f64,
    /// Angle from north through east, in radians.
    azimuth: f64,
}

impl Station {
    /// Returns the unit vector along the well: east, north, down.
    fn direction(self) -> [f64; 3] {
        let (s, c) = self.inclination.sin_cos();
        let (east, north) = self.azimuth.sin_cos();
        [s * east, s * north, c]
    }

    /// Returns the offset to the next station on a circular arc: east, north, down.
    fn offset_to(self, next: Self) -> [f64; 3] {
        let [a, b] = [self.direction(), next.direction()];
        let chord: f64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| (b - a).powi(2))
            .sum::<f64>()
            .sqrt();
        let dogleg = 2.0 * (0.5 * chord).min(1.0).asin();
        let ratio = if dogleg < 1e-4 {
            1.0 + dogleg * dogleg / 12.0
        } else {
            (0.5 * dogleg).tan() / (0.5 * dogleg)
        };
        let half = 0.5 * (next.measured_depth - self.measured_depth) * ratio;
        std::array::from_fn(|k| half * (a[k] + b[k]))
    }
}

/// A deviation survey.
pub(super) struct Survey<'a> {
    table: &'a Table,
    measured_depth: usize,
    inclination: usize,
    azimuth: usize,
    /// The wellhead: x, y, and the height of measured depth 0.
    head: [f64; 3],
    /// Units of the wellhead in one of measured depth.
    scale: f64,
    /// The wellhead whose offsets are converted later, if the unit of the wellhead is not known here.
    offsets: Option<SurveyOffsets>,
    coordinates: StatedCoordinates,
    notes: Vec<String>,
}

/// Keys of the wellhead's x in remarks.
const HEAD_X: [&str; 12] = [
    "xcoordinate",
    "xcoord",
    "surfacex",
    "headx",
    "xwell",
    "wellx",
    "x",
    "easting",
    "surfaceeasting",
    "east",
    "xsurf",
    "wellheadx",
];

/// Keys of the wellhead's y in remarks.
const HEAD_Y: [&str; 12] = [
    "ycoordinate",
    "ycoord",
    "surfacey",
    "heady",
    "ywell",
    "welly",
    "y",
    "northing",
    "surfacenorthing",
    "north",
    "ysurf",
    "wellheady",
];

impl<'a> Survey<'a> {
    pub(super) fn new(table: &'a Table, given_head: Option<[f64; 3]>) -> Result<Self> {
        let azimuth = match table.column("azimuth")? {
            Some(column) => column,
            None => table.required(term("azimuth-true"))?,
        };
        let measured_depth = table.required(term("md"))?;
        let own = table.columns()[measured_depth].unit.clone();
        let own = own.or_else(|| unit_given_in_remark(table, "depth"));
        let mut notes = vec!["a deviation survey, by minimum curvature".to_string()];
        let place = [&HEAD_X, &HEAD_Y].map(|keys| table.remark_value(keys));
        // A wellhead that the option gives has the units of the option, or else of the image.
        let unit = match given_head {
            Some(_) => None,
            None => (place[0].as_ref())
                .and_then(|(_, unit)| unit.clone())
                .or_else(|| own.clone()),
        };
        let head = match (given_head, &place) {
            (Some(head), _) => head,
            (None, [Some((x, _)), Some((y, _))]) => {
                let height = datum(table, unit.as_deref());
                if height.is_none() {
                    notes.push(
                        "measured depth 0 taken at z = 0, as the file names no kelly bushing"
                            .into(),
                    );
                }
                [*x, *y, height.unwrap_or(0.0)]
            }
            _ => {
                let problem = "is a deviation survey that does not say where the well begins";
                let remedy = "add lines '# X-COORDINATE: ...', '# Y-COORDINATE: ...' and '# KB: ...' (the height of measured depth 0), give ,head=X,Y,Z after the file, or add columns x, y and z";
                return Err(table.error(problem, remedy));
            }
        };
        let coordinates = StatedCoordinates {
            units: std::array::from_fn(|_| unit.clone().filter(|unit| units::find(unit).is_some())),
            z_direction: Some(ZDirection::Up),
            domain: Some(Domain::Depth),
            nulls: Vec::new(),
        };
        Ok(Self {
            table,
            measured_depth,
            inclination: table.required(term("inclination"))?,
            azimuth,
            head,
            offsets: unit.is_none().then(|| SurveyOffsets {
                head,
                unit: own.clone(),
            }),
            scale: match unit {
                Some(_) => unit_ratio(own.as_deref(), unit.as_deref()),
                None => 1.0,
            },
            coordinates,
            notes,
        })
    }

    /// Returns the station in a row; `None` if a value is missing.
    fn station(&self, row: &TableRow<'_>) -> Result<Option<Station>> {
        let mut values = [0.0; 3];
        for (value, column) in
            values
                .iter_mut()
                .zip([self.measured_depth, self.inclination, self.azimuth])
        {
            match row
                .number(column)?
                .filter(|n| !self.table.nulls().contains(n))
            {
                Some(number) => *value = number,
                None => return Ok(None),
            }
        }
        let [measured_depth, inclination, azimuth] = values;
        if !(0.0..=180.0).contains(&inclination) || !(-360.0..=720.0).contains(&azimuth) {
            let problem =
                format!("has an inclination of {inclination} and an azimuth of {azimuth}");
            return Err(row.error(problem, "give angles in degrees"));
        }
        Ok(Some(Station {
            measured_depth: self.scale * measured_depth,
            inclination: inclination.to_radians(),
            azimuth: azimuth.to_radians(),
        }))
    }

    /// Returns the trajectories.
    pub(super) fn wells<const D: usize>(&self) -> Result<Vec<WellFile<D>>> {
        if D == 2 {
            let remedy = "give the points of the well: x and y";
            return Err(self
                .table
                .error("is a deviation survey, but the image has 2 axes", remedy));
        }
        let bore = Bore::of_table(self.table, self.coordinates.units[0].as_deref())?;
        let names = WellNames::of_table(self.table)?;
        let mut wells = Vec::new();
        for (name, rows) in names.groups(self.table) {
            let points = self.points(&rows, &bore)?;
            let mut notes = self.notes.clone();
            if bore.column.is_none() {
                notes.push("the file has no radius".into());
            }
            wells.push(WellFile {
                name,
                points,
                coordinates: self.coordinates.clone(),
                notes,
                survey: self.offsets.clone(),
            });
        }
        if wells.len() > 1 {
            let problem = "has deviation surveys of several wells, but one wellhead";
            return Err(self
                .table
                .error(problem, "give a file for each well, or columns x, y and z"));
        }
        Ok(wells)
    }

    /// Returns the points of the stations in these rows.
    fn points<const D: usize>(
        &self,
        rows: &[TableRow<'_>],
        bore: &Bore,
    ) -> Result<Vec<WellPoint<D>>> {
        // The well is vertical down to its first station.
        let mut last = Station {
            measured_depth: 0.0,
            inclination: 0.0,
            azimuth: 0.0,
        };
        let mut offset = [0.0; 3];
        let mut points: Vec<WellPoint<D>> = Vec::new();
        for row in rows {
            let Some(station) = self.station(row)? else {
                continue;
            };
            let begins = points.is_empty();
            if station.measured_depth < last.measured_depth {
                let problem = format!(
                    "has a measured depth of {}, less than the one before",
                    station.measured_depth
                );
                return Err(row.error(problem, "give measured depths in increasing order"));
            }
            let radius = bore.radius(row)?;
            let mut push = |offset: [f64; 3]| {
                let [x, y, z] = self.head;
                let position = [x + offset[0], y + offset[1], z - offset[2]];
                let position = std::array::from_fn(|k| position.get(k).copied().unwrap_or(0.0));
                let is_new = points
                    .last()
                    .is_none_or(|point: &WellPoint<D>| point.position != position);
                if is_new {
                    points.push(WellPoint {
                        line: row.line,
                        position,
                        radius,
                    });
                }
            };
            if begins {
                push(offset);
            }
            let step = if begins {
                [0.0, 0.0, station.measured_depth]
            } else {
                last.offset_to(station)
            };
            offset = std::array::from_fn(|k| offset[k] + step[k]);
            push(offset);
            last = station;
        }
        Ok(points)
    }
}
