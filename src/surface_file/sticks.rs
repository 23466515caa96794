//! Fault sticks: the lines, side by side, along which interpreters draw a fault from top to bottom.
//!
//! The file is a table with the columns `fault,stick,x,y,z` and one row per point, from the top of
//! a stick down. In tables of other programs, the columns may be in any order, and other columns
//! are ignored.

use std::io::{Read, Write};
use std::path::Path;

use super::SurfaceFile;
use super::joining::join_sticks;
use super::point_table::read_stick_table;
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::files::atomic_write;
use crate::geometry::{dot, hypot, norm, sub};
use crate::image::stated::{StatedCoordinates, ZDirection};
use crate::image::time::default_metres_per_unit;

/// One stick of a fault.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stick {
    /// Name or number of the stick in its file.
    pub name: String,
    /// Line of the file that holds the first point, from 1; `None` if it has no lines.
    pub line: Option<usize>,
    /// Points along the stick, in either direction.
    pub points: Vec<[f64; 3]>,
}

/// Fault: its name, and its sticks in any order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaultSticks {
    /// Name of the fault.
    pub name: String,
    /// Sticks of the fault.
    pub sticks: Vec<Stick>,
    /// The statements of the file about the coordinates.
    pub coordinates: StatedCoordinates,
}

/// Points that are closer than this, relative to the length of the fault, are one point.
const POINT_TOLERANCE_RATIO: f64 = 1e-9;

/// Number of sticks of a surface if no spacing is given.
const DEFAULT_STICK_COUNT: f64 = 10.0;

impl FaultSticks {
    /// Makes sticks from each surface: its intersections with vertical planes perpendicular to its
    /// strike. `spacing` is the distance between planes (a tenth of the surface's length if
    /// `None`).
    pub fn from_surfaces(file: &SurfaceFile<3>, spacing: Option<f64>) -> Vec<Self> {
        (0..file.names.len())
            .map(|s| {
                let triangles: Vec<[[f64; 3]; 3]> = file
                    .surface_facets(s)
                    .iter()
                    .map(|facet| facet.map(|n| file.nodes[n as usize]))
                    .collect();
                let lines = section_lines(&triangles, spacing);
                Self {
                    name: file.names[s].clone(),
                    sticks: numbered_sticks(lines),
                    coordinates: file.stated.clone(),
                }
            })
            .collect()
    }

    /// Makes sticks from the lines of each object.
    pub fn from_lines(file: &SurfaceFile<2>) -> Vec<Self> {
        let object_sticks = |s: usize| {
            let mut sticks: Vec<Vec<[f64; 3]>> = Vec::new();
            let mut end = None;
            for &[a, b] in file.surface_facets(s) {
                let [start, end_point] = [a, b].map(|n| file.nodes[n as usize]);
                match sticks.last_mut() {
                    Some(stick) if end == Some(a) => stick.push(end_point),
                    _ => sticks.push(vec![start, end_point]),
                }
                end = Some(b);
            }
            Self {
                name: file.names[s].clone(),
                sticks: numbered_sticks(sticks),
                coordinates: file.stated.clone(),
            }
        };
        (0..file.names.len()).map(object_sticks).collect()
    }

    /// Converts the sticks of each fault to lines.
    pub fn to_lines(faults: &[Self]) -> SurfaceFile<2> {
        let mut file = SurfaceFile {
            surface_starts: vec![0],
            z_up: true,
            ..SurfaceFile::default()
        };
        for fault in faults {
            let units = fault.coordinates.units.each_ref();
            file.units = units.map(|unit| unit.clone().unwrap_or_default());
            file.z_up = fault.coordinates.z_direction != Some(ZDirection::Down);
            file.stated = fault.coordinates.clone();
            for stick in &fault.sticks {
                let first = file.nodes.len() as u32;
                file.nodes.extend(&stick.points);
                let ends = (first + 1)..file.nodes.len() as u32;
                file.facets.extend(ends.map(|end| [end - 1, end]));
            }
            file.names.push(fault.name.clone());
            file.surface_starts.push(file.facets.len());
        }
        file
    }

    /// Makes a surface of each fault, as [`join_sticks`] does. Faults with a single stick are omitted.
    /// Coordinates in a unit that is unknown count as metres.
    ///
    /// # Errors
    /// Returns the errors of [`join_sticks`].
    pub fn to_surfaces(faults: &[Self]) -> Result<SurfaceFile<3>> {
        let mut surfaces = Vec::new();
        for fault in faults.iter().filter(|fault| fault.sticks.len() > 1) {
            let units = fault.coordinates.units.each_ref();
            let scale = units.map(|unit| default_metres_per_unit(unit.as_deref().unwrap_or("")));
            let joined = join_sticks(&fault.name, &fault.sticks, scale)?;
            surfaces.push((fault.name.clone(), joined.triangles));
        }
        let mut file = SurfaceFile::from_triangles(surfaces);
        if let Some(fault) = faults.last() {
            let units = fault.coordinates.units.each_ref();
            file.units = units.map(|unit| unit.clone().unwrap_or_default());
            file.z_up = fault.coordinates.z_direction != Some(ZDirection::Down);
            file.stated = fault.coordinates.clone();
        }
        Ok(file)
    }
}

/// Returns sticks of these points, with the names 1, 2, 3 ...
fn numbered_sticks(lines: Vec<Vec<[f64; 3]>>) -> Vec<Stick> {
    let stick = |(number, points): (usize, _)| Stick {
        name: number.to_string(),
        line: None,
        points,
    };
    (1..).zip(lines).map(stick).collect()
}

/// Returns the horizontal direction of the strike of a surface. It is perpendicular to the mean of
/// the horizontal parts of the normals. The sign of a normal does not matter.
fn strike(triangles: &[[[f64; 3]; 3]]) -> [f64; 3] {
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for [a, b, c] in triangles {
        let (u, v) = (sub(*b, *a), sub(*c, *a));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]];
        // Large faces count more.
        let size = hypot(normal[0], normal[1]).max(f64::MIN_POSITIVE);
        xx += normal[0] * normal[0] / size;
        xy += normal[0] * normal[1] / size;
        yy += normal[1] * normal[1] / size;
    }
    let normal_angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    [-normal_angle.sin(), normal_angle.cos(), 0.0]
}

/// Returns the lines in which vertical planes perpendicular to the strike cut the triangles.
fn section_lines(triangles: &[[[f64; 3]; 3]], spacing: Option<f64>) -> Vec<Vec<[f64; 3]>> {
    let direction = strike(triangles);
    let positions = triangles.iter().flatten().map(|&p| dot(p, direction));
    let (low, high) = positions.fold(
        (f64::INFINITY, f64::NEG_INFINITY),
        |(low, high), position| (low.min(position), high.max(position)),
    );
    let length = high - low;
    if !(length > 0.0 && length.is_finite()) {
        return Vec::new();
    }
    let count = (length / spacing.unwrap_or(length / DEFAULT_STICK_COUNT))
        .round()
        .clamp(1.0, 1e5) as usize;
    // Planes do not pass through the ends of the surface.
    let position = |k: usize| low + length * (k as f64 + 0.5) / count as f64;
    let mut sticks = Vec::new();
    for position in (0..count).map(position) {
        let mut segments: Vec<[[f64; 3]; 2]> = triangles
            .iter()
            .filter_map(|triangle| triangle_section(triangle, direction, position))
            .collect();
        while let Some([start, end]) = segments.pop() {
            let mut line = std::collections::VecDeque::from([start, end]);
            while let Some((i, end, at_front)) = find_adjoining_segment(&segments, &line) {
                segments.swap_remove(i);
                if at_front {
                    line.push_front(end);
                } else {
                    line.push_back(end);
                }
            }
            let mut stick: Vec<[f64; 3]> = line.into();
            // A plane through a node cuts many edges at that node.
            stick.dedup_by(|a, b| norm(sub(*a, *b)) <= POINT_TOLERANCE_RATIO * length);
            if stick[0][2] < stick[stick.len() - 1][2] {
                stick.reverse();
            }
            if stick.len() > 1 {
                sticks.push(stick);
            }
        }
    }
    sticks
}

/// Finds a segment with an end at an end of the line. Returns its index, its other end, and `true`
/// if it is at the front of the line.
fn find_adjoining_segment(
    segments: &[[[f64; 3]; 2]],
    line: &std::collections::VecDeque<[f64; 3]>,
) -> Option<(usize, [f64; 3], bool)> {
    let (front, back) = (line.front()?, line.back()?);
    segments.iter().enumerate().find_map(|(i, [a, b])| {
        [(a, b), (b, a)]
            .into_iter()
            .find_map(|(start, end)| match start {
                near if near == back => Some((i, *end, false)),
                near if near == front => Some((i, *end, true)),
                _ => None,
            })
    })
}

/// Returns the segment in which a plane cuts a triangle. Both triangles of an edge give the same
/// point on it.
fn triangle_section(
    triangle: &[[f64; 3]; 3],
    direction: [f64; 3],
    position: f64,
) -> Option<[[f64; 3]; 2]> {
    let distances = triangle.map(|p| dot(p, direction) - position);
    let mut ends = Vec::with_capacity(2);
    for (a, b) in [(0, 1), (1, 2), (2, 0)] {
        if (distances[a] < 0.0) != (distances[b] < 0.0) {
            // The edge is taken from its negative end, so that both of its triangles give the same
            // bits.
            let (a, b) = if distances[a] < 0.0 { (a, b) } else { (b, a) };
            let t = distances[a] / (distances[a] - distances[b]);
            ends.push(std::array::from_fn(|k| {
                triangle[a][k] + t * (triangle[b][k] - triangle[a][k])
            }));
        }
    }
    <[[f64; 3]; 2]>::try_from(ends).ok().filter(|[a, b]| a != b)
}

/// Writes sticks.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_sticks(path: &Path, faults: &[FaultSticks]) -> Result<()> {
    atomic_write(path, |out| {
        writeln!(out, "fault,stick,x,y,z")?;
        for fault in faults {
            for (number, stick) in (1..).zip(&fault.sticks) {
                for [x, y, z] in &stick.points {
                    writeln!(out, "{},{number},{x},{y},{z}", fault.name)?;
                }
            }
        }
        Ok(())
    })
}

/// Writes sticks as Charisma's fault sticks, which Petrel, OpendTect and others read: a line for each
/// point, `INLINE-` with the inline, the crossline, x, y, z, fault and stick. z is positive downwards.
/// `z_up` says whether that of the sticks grows upwards, and `lines_at` returns the inline and
/// crossline of a point.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_charisma(
    path: &Path,
    faults: &[FaultSticks],
    z_up: bool,
    lines_at: impl Fn([f64; 3]) -> [i64; 2],
) -> Result<()> {
    let down = if z_up { -1.0 } else { 1.0 };
    atomic_write(path, |out| {
        for fault in faults {
            for (number, stick) in (1..).zip(&fault.sticks) {
                for &point in &stick.points {
                    let ([inline, crossline], [x, y, z]) = (lines_at(point), point);
                    writeln!(
                        out,
                        "INLINE- {inline:>8} {crossline:>8} {x:>14.3} {y:>14.3} {:>12.3} {} {number}",
                        down * z,
                        fault.name
                    )?;
                }
            }
        }
        Ok(())
    })
}

/// Words with which a line of Charisma's fault sticks begins: the kind of section on which the point
/// was picked.
const CHARISMA_SECTIONS: [&str; 8] = [
    "INLINE-",
    "XLINE-",
    "CROSSLINE-",
    "TRACE-",
    "RANDOM-",
    "TIMESLICE-",
    "TIME-SLICE-",
    "Z-SLICE-",
];

/// Returns the words of a line of Charisma's fault sticks after that of its section.
fn charisma_words(line: &str) -> Option<Vec<&str>> {
    let line = line.trim_start();
    let first = line.split_whitespace().next()?.to_uppercase();
    let section = (CHARISMA_SECTIONS.iter()).find(|section| first.starts_with(**section))?;
    Some(line.get(section.len()..)?.split_whitespace().collect())
}

/// Returns `true` if a text has Charisma's fault sticks.
pub(crate) fn is_charisma(text: &str) -> bool {
    let is_data = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
    let first = text.lines().find(is_data);
    first.is_some_and(|line| charisma_words(line).is_some())
}

/// Returns the point, the fault and the stick of a line of Charisma's fault sticks. The inline and the
/// crossline may be missing, and the name of the fault may have spaces.
fn charisma_point<'a>(words: &[&'a str]) -> Option<([f64; 3], String, &'a str)> {
    let (stick, words) = words.split_last()?;
    let numbers: Vec<f64> = words.iter().map_while(|word| word.parse().ok()).collect();
    // All but the last two words may be numbers if the fault's name is one.
    let first = if numbers.len() >= 5 && words.len() > 5 {
        2
    } else {
        0
    };
    let point = numbers.get(first..first + 3)?.try_into().ok()?;
    let name = words.get(first + 3..)?.join(" ");
    (!name.is_empty()).then_some((point, name, *stick))
}

/// Reads Charisma's fault sticks: lines `INLINE- inline crossline x y z fault stick`, or without line
/// numbers, from inlines, crosslines, slices or other sections. z stays positive downwards.
///
/// # Errors
/// Returns [`Error::Io`], with the line number, if the file cannot be read or a line is no point of a
/// stick.
pub fn read_charisma(path: &Path) -> Result<Vec<FaultSticks>> {
    let text = read_text(path)?;
    let mut collector = StickCollector::default();
    let is_data = |line: &str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
    for (number, line) in (1..).zip(text.lines()).filter(|line| is_data(line.1)) {
        let words = charisma_words(line).unwrap_or_default();
        let Some((point, fault, stick)) = charisma_point(&words) else {
            let place = format!("{}:{number}", path.display());
            let problem = "is not 'INLINE- inline crossline x y z fault stick'";
            return Err(Error::Io(cause(place, problem, "export the sticks again")));
        };
        collector.add(&fault, stick, number, point);
    }
    for fault in &mut collector.faults {
        fault.coordinates.z_direction = Some(ZDirection::Down);
    }
    Ok(collector.faults)
}

/// Reads the text of a file of sticks.
fn read_text(path: &Path) -> Result<String> {
    let mut text = String::new();
    let mut file = files::open(path, "give a file of fault sticks")?;
    file.read_to_string(&mut text)
        .map_err(|e| io_error(path, "read", e))?;
    Ok(text)
}

/// Collects points into sticks, and these into faults.
#[derive(Default)]
struct StickCollector {
    faults: Vec<FaultSticks>,
    /// The fault and the stick of the last point.
    previous: Option<(usize, String)>,
}

impl StickCollector {
    /// Adds the point in a line of the file. A stick ends where the name of the fault or of the stick
    /// changes.
    fn add(&mut self, fault: &str, stick: &str, line: usize, point: [f64; 3]) {
        let known = self.faults.iter().position(|other| other.name == fault);
        let fault = known.unwrap_or_else(|| {
            self.faults.push(FaultSticks {
                name: fault.to_string(),
                ..FaultSticks::default()
            });
            self.faults.len() - 1
        });
        let key = (fault, stick.to_string());
        let sticks = &mut self.faults[fault].sticks;
        if self.previous.as_ref() != Some(&key) {
            sticks.push(Stick {
                name: stick.to_string(),
                line: Some(line),
                points: Vec::new(),
            });
        }
        self.previous = Some(key);
        if let Some(stick) = sticks.last_mut() {
            stick.points.push(point);
        }
    }
}

/// Reads a table of sticks.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`], with the line number, if it is
/// not a table of sticks.
pub fn read_sticks(path: &Path) -> Result<Vec<FaultSticks>> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    read_stick_table(path, &stem)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a plane of squares, each cut into two triangles. It dips by 60 degrees and its
    /// strike is 30 degrees.
    fn plane() -> SurfaceFile<3> {
        let (s, c) = 30f64.to_radians().sin_cos();
        let node = |i: usize, j: usize| {
            let (along, down) = (10.0 * i as f64, 5.0 * j as f64);
            let offset = down / 3f64.sqrt();
            [
                along * s + offset * c,
                along * c - offset * s,
                -100.0 - down,
            ]
        };
        let nodes: Vec<[f64; 3]> = (0..9)
            .flat_map(|i| (0..7).map(move |j| node(i, j)))
            .collect();
        let mut facets = Vec::new();
        for i in 0..8u32 {
            for j in 0..6 {
                let at = 7 * i + j;
                facets.push([at, at + 7, at + 8]);
                facets.push([at, at + 8, at + 1]);
            }
        }
        let start = [0, facets.len()];
        SurfaceFile::new(&nodes, &facets, &start, "fault")
    }

    #[test]
    fn sticks_run_down_a_fault_and_rebuild_it() {
        let file = plane();
        let faults = FaultSticks::from_surfaces(&file, Some(8.0));
        assert_eq!((faults.len(), faults[0].sticks.len()), (1, 10));
        for Stick { points: stick, .. } in &faults[0].sticks {
            // Sticks run down the dip: 30 deep, from edge to edge, in order.
            assert!(stick.windows(2).all(|p| p[1][2] < p[0][2]), "{stick:?}");
            let [top, base] = [stick[0], stick[stick.len() - 1]];
            assert!((top[2] - base[2] - 30.0).abs() < 1e-9);
            let horizontal = (base[0] - top[0]).hypot(base[1] - top[1]);
            assert!(
                (horizontal - 30.0 / 3f64.sqrt()).abs() < 1e-9,
                "{horizontal}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sticks.csv");
        write_sticks(&path, &faults).unwrap();
        let points = |faults: &[FaultSticks]| -> Vec<Vec<[f64; 3]>> {
            let sticks = faults.iter().flat_map(|fault| &fault.sticks);
            sticks.map(|stick| stick.points.clone()).collect()
        };
        assert_eq!(points(&read_sticks(&path).unwrap()), points(&faults));
        assert_eq!(
            FaultSticks::from_lines(&FaultSticks::to_lines(&faults)),
            faults
        );

        // Charisma's sticks have line numbers, and z downwards.
        let path = folder.path().join("sticks.charisma");
        write_charisma(&path, &faults, true, |[x, y, _]| {
            [x.round() as i64, y.round() as i64]
        })
        .unwrap();
        assert!(is_charisma(&std::fs::read_to_string(&path).unwrap()));
        let read = read_charisma(&path).unwrap();
        assert_eq!((read.len(), &read[0].name), (1, &faults[0].name));
        for (read, written) in read[0].sticks.iter().zip(&faults[0].sticks) {
            assert_eq!(read.points.len(), written.points.len());
            for (a, b) in read.points.iter().zip(&written.points) {
                assert!((a[0] - b[0]).abs() + (a[1] - b[1]).abs() + (a[2] + b[2]).abs() < 2e-3);
            }
        }
        std::fs::write(&path, "INLINE- 1 2 F 1\n").unwrap();
        let message = read_charisma(&path).unwrap_err().to_string();
        assert!(
            message.contains("sticks.charisma:1: is not 'INLINE-"),
            "{message}"
        );

        // Other sections, no line numbers, and names with spaces or of digits.
        let text = "# picks\nCROSSLINE-  10 20 1 2 3 Main fault 7\nXLINE-12 20 1 2 3 Main fault 8\n\
                    TIMESLICE- 1 2 4 Main fault 9\nINLINE- 10 20 1 2 5 101 1\n";
        std::fs::write(&path, text).unwrap();
        let read = read_charisma(&path).unwrap();
        let names: Vec<(&str, usize)> = (read.iter())
            .map(|fault| (&*fault.name, fault.sticks.len()))
            .collect();
        assert_eq!(names, [("Main fault", 3), ("101", 1)]);
        assert_eq!(read[0].sticks[2].points, [[1.0, 2.0, 4.0]]);
        assert_eq!(read[1].sticks[0].points, [[1.0, 2.0, 5.0]]);

        // Nine of the ten strips of the plane lie between sticks.
        let rebuilt = FaultSticks::to_surfaces(&faults).unwrap();
        assert_eq!(
            (rebuilt.names.as_slice(), rebuilt.surface_starts.len()),
            (&["fault1".to_string()][..], 2)
        );
        let area: f64 = rebuilt
            .facets
            .iter()
            .map(|f| area(f.map(|n| rebuilt.nodes[n as usize])))
            .sum();
        let full_area = 80.0 * 30.0 / 60f64.to_radians().sin();
        assert!(
            (area - 0.9 * full_area).abs() < 1e-6 * full_area,
            "{area} of {full_area}"
        );
    }

    fn area([a, b, c]: [[f64; 3]; 3]) -> f64 {
        let (u, v) = (sub(b, a), sub(c, a));
        let n: [f64; 3] = std::array::from_fn(|k| {
            u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]
        });
        0.5 * norm(n)
    }

    #[test]
    fn foreign_tables_are_read_and_errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let text = "# picks\nX,Y,Z,Interpreter,Fault,Stick\n1,2,-3,me,F 1,7\n1,2,-4,me,F 1,7\n\n5,2,-3,me,F 1,8\n9,9,9,me,F2,1\n";
        std::fs::write(&path, text).unwrap();
        let faults = read_sticks(&path).unwrap();
        let counts: Vec<Vec<usize>> = faults
            .iter()
            .map(|fault| fault.sticks.iter().map(|s| s.points.len()).collect())
            .collect();
        assert_eq!(counts, [vec![2, 1], vec![1]]);
        assert_eq!(faults[0].sticks[1].points, [[5.0, 2.0, -3.0]]);
        assert_eq!(faults[0].sticks[1].line, Some(6));
        for (text, expected) in [
            ("x,y,z\n1,2,3\n", "has no column stick"),
            (
                "fault,stick,x,y,z\na,1,2,3,four\n",
                "a.csv:2: 'four' in column z is not a number",
            ),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = read_sticks(&path).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
