//! Writes and reads surfaces as GOCAD ASCII: a `TSurf` object for each surface, or a `PLine` object
//! for each line of a 2-D mesh.
//!
//! An object is a header, a coordinate system, its vertices (`VRTX`, numbered from 1), and its
//! triangles (`TRGL`) or segments (`SEG`). `ZPOSITIVE` gives the direction of z.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::path::Path;

use super::SurfaceFile;
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::files::atomic_write;
use crate::geometry::sorted_distinct;
use crate::image::stated::{StatedCoordinates, ZDirection};
use crate::names;

/// Writes surfaces. Coordinates have all digits and the units that are known.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_tsurf<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let (object, part, element) = match D {
        2 => ("PLine", "ILINE", "SEG"),
        _ => ("TSurf", "TFACE", "TRGL"),
    };
    let [x_unit, y_unit, z_unit] = (file.units.each_ref()).map(|unit| match unit.as_str() {
        "" => "unitless",
        known => known,
    });
    let z_positive = if file.z_up { "Elevation" } else { "Depth" };
    atomic_write(path, |out| {
        for (s, name) in file.names.iter().enumerate() {
            writeln!(out, "GOCAD {object} 1\nHEADER {{\nname:{name}\n}}")?;
            writeln!(
                out,
                "GOCAD_ORIGINAL_COORDINATE_SYSTEM\nNAME Default\nAXIS_NAME \"X\" \"Y\" \"Z\"\n\
                 AXIS_UNIT \"{x_unit}\" \"{y_unit}\" \"{z_unit}\"\nZPOSITIVE {z_positive}\n\
                 END_ORIGINAL_COORDINATE_SYSTEM\n{part}"
            )?;
            let used = sorted_distinct(file.surface_facets(s).concat());
            for (i, &n) in used.iter().enumerate() {
                let [x, y, z] = file.nodes[n as usize];
                writeln!(out, "VRTX {} {x} {y} {z}", i + 1)?;
            }
            for facet in file.surface_facets(s) {
                write!(out, "{element}")?;
                for n in facet {
                    write!(out, " {}", used.partition_point(|m| m < n) + 1)?;
                }
                writeln!(out)?;
            }
            writeln!(out, "END")?;
        }
        Ok(())
    })
}

/// Contents of a GOCAD file.
#[derive(Debug, Clone, PartialEq)]
pub enum Gocad {
    /// Surfaces: `TSurf` objects.
    Surfaces(SurfaceFile<3>),
    /// Lines: `PLine` objects.
    Lines(SurfaceFile<2>),
}

/// Kind of a GOCAD object that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GocadKind {
    /// `TSurf`: triangles.
    Surface,
    /// `PLine`: lines.
    Lines,
    /// `VSet`: points.
    Points,
}

/// An object of a GOCAD file.
#[derive(Debug, Clone, PartialEq)]
pub struct GocadObject {
    /// Name of the object.
    pub name: String,
    /// Kind of the object.
    pub kind: GocadKind,
    /// `true` for a horizon and `false` for a fault, if the file says so (`GEOLOGICAL_TYPE`).
    pub is_horizon: Option<bool>,
    /// Vertices.
    pub nodes: Vec<[f64; 3]>,
    /// Nodes of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Lines, each with its line in the file and its nodes from end to end.
    pub lines: Vec<(usize, Vec<u32>)>,
    /// The statements of the object about its coordinates.
    pub coordinates: StatedCoordinates,
}

/// Reads the `TSurf` objects of a GOCAD file, or its `PLine` objects if there are none. Other
/// objects are ignored. Vertices may have properties (`PVRTX`) or copy the position of another
/// vertex (`ATOM`, `PATOM`).
///
/// # Errors
/// Returns [`Error::Io`], with the line number if a line is damaged, if the file cannot be read or
/// has no such object.
pub fn read_gocad(path: &Path) -> Result<Gocad> {
    let objects = read_gocad_objects(path)?;
    let of_kind = |kind| objects.iter().filter(move |object| object.kind == kind);
    if of_kind(GocadKind::Surface).next().is_some() {
        let facets = |object: &GocadObject| object.triangles.clone();
        return Ok(Gocad::Surfaces(surface_file(
            of_kind(GocadKind::Surface),
            facets,
        )));
    }
    if of_kind(GocadKind::Lines).next().is_some() {
        let segments = |object: &GocadObject| {
            let lines = object.lines.iter();
            lines
                .flat_map(|(_, nodes)| nodes.windows(2).map(|pair| [pair[0], pair[1]]))
                .collect()
        };
        return Ok(Gocad::Lines(surface_file(
            of_kind(GocadKind::Lines),
            segments,
        )));
    }
    let problem = "holds no GOCAD object TSurf or PLine";
    let remedy = "give a file of surfaces (.ts) or lines (.pl)";
    Err(Error::Io(cause(path.display(), problem, remedy)))
}

/// Returns objects as one file of surfaces or lines.
fn surface_file<'a, const D: usize>(
    objects: impl Iterator<Item = &'a GocadObject>,
    facets: impl Fn(&GocadObject) -> Vec<[u32; D]>,
) -> SurfaceFile<D> {
    let mut file = SurfaceFile::<D> {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    for object in objects {
        let first = file.nodes.len() as u32;
        file.nodes.extend(&object.nodes);
        file.facets
            .extend(facets(object).iter().map(|facet| facet.map(|n| n + first)));
        file.surface_starts.push(file.facets.len());
        file.names.push(object.name.clone());
        let units = object.coordinates.units.clone();
        file.units = units.map(Option::unwrap_or_default);
        file.z_up = object.coordinates.z_direction != Some(ZDirection::Down);
        file.stated = object.coordinates.clone();
    }
    file
}

/// Reads all surfaces, lines and sets of points of a GOCAD file. Coordinates are as in the file.
///
/// # Errors
/// Returns [`Error::Io`], with the line number if a line is damaged, if the file cannot be read.
pub fn read_gocad_objects(path: &Path) -> Result<Vec<GocadObject>> {
    let mut bytes = Vec::new();
    let mut file = files::open(path, "give a GOCAD file")?;
    file.read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    let text = String::from_utf8_lossy(&bytes);
    let mut reader = ObjectReader::default();
    for (number, line) in (1..).zip(text.lines()) {
        reader.read_line(number, line).map_err(|problem| {
            let place = format!("{}:{number}", path.display());
            Error::Io(cause(place, problem, "export the file again"))
        })?;
    }
    reader.end_object();
    Ok(reader.objects)
}

/// Reads objects line by line.
#[derive(Default)]
struct ObjectReader {
    objects: Vec<GocadObject>,
    /// The object that is being read.
    current: Option<GocadObject>,
    /// `true` if the object has the name of its header, not one of style (`*name`).
    has_name: bool,
    /// Index of each vertex number of the current object.
    vertex_index: HashMap<u32, u32>,
    /// The parts of the current line object: line in the file, first vertex, and segments.
    parts: Vec<LinePart>,
}

/// A part of a line object.
struct LinePart {
    line: usize,
    first_node: usize,
    segments: Vec<[u32; 2]>,
}

impl ObjectReader {
    /// Reads a line. Returns what is wrong with it.
    fn read_line(&mut self, number: usize, line: &str) -> std::result::Result<(), &'static str> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(&first) = words.first() else {
            return Ok(());
        };
        if first == "GOCAD" {
            self.end_object();
            self.start_object(words.get(1).copied().unwrap_or_default());
            return Ok(());
        }
        let Some(object) = &mut self.current else {
            return Ok(());
        };
        let id = |k: usize| words.get(k).and_then(|word| word.parse::<u32>().ok());
        let vertex = |k: usize| id(k).and_then(|id| self.vertex_index.get(&id).copied());
        let missing = "names a vertex that does not exist";
        match first {
            "AXIS_UNIT" => object.coordinates.units = axis_units(line),
            "ZPOSITIVE" => object.coordinates.z_direction = z_direction(&words),
            "GEOLOGICAL_TYPE" => object.is_horizon = geological_type(&words),
            "VRTX" | "PVRTX" => {
                let position: Option<Vec<f64>> =
                    (2..5).map(|k| words.get(k)?.parse::<f64>().ok()).collect();
                let position = position.and_then(|place| <[f64; 3]>::try_from(place).ok());
                let (Some(id), Some(position)) = (id(1), position) else {
                    return Err("is not a vertex (number, x, y, z)");
                };
                self.vertex_index.insert(id, object.nodes.len() as u32);
                object.nodes.push(position);
            }
            "ATOM" | "PATOM" => {
                let (Some(id), Some(vertex)) = (id(1), vertex(2)) else {
                    return Err("copies a vertex that does not exist");
                };
                self.vertex_index.insert(id, vertex);
            }
            "TRGL" => {
                let [Some(a), Some(b), Some(c)] = [1, 2, 3].map(vertex) else {
                    return Err(missing);
                };
                object.triangles.push([a, b, c]);
            }
            "ILINE" => self.parts.push(LinePart {
                line: number,
                first_node: object.nodes.len(),
                segments: Vec::new(),
            }),
            "SEG" => {
                let ([Some(a), Some(b)], Some(part)) = ([1, 2].map(vertex), self.parts.last_mut())
                else {
                    return Err(missing);
                };
                part.segments.push([a, b]);
            }
            "END" => self.end_object(),
            _ => self.read_name(line),
        }
        Ok(())
    }

    /// Reads the name from a line of the header, such as `name: Top`, `*name: Top` or
    /// `HEADER { name: Top }`.
    fn read_name(&mut self, line: &str) {
        let line = line.trim();
        let line = match line.strip_prefix("HEADER") {
            Some(rest) => rest.trim_start().trim_start_matches('{').trim_start(),
            None => line,
        };
        let is_of_style = line.starts_with('*');
        let line = line.trim_start_matches('*');
        let Some(name) = line
            .strip_prefix("name:")
            .filter(|_| !(is_of_style && self.has_name))
        else {
            return;
        };
        let name = name
            .trim_end()
            .trim_end_matches('}')
            .trim()
            .trim_matches('"');
        if let (Some(object), false) = (&mut self.current, name.is_empty()) {
            object.name = names::from_file(name);
            self.has_name = !is_of_style;
        }
    }

    /// Starts an object, if it is of a kind that is read.
    fn start_object(&mut self, kind_name: &str) {
        let kind = match kind_name {
            "TSurf" => GocadKind::Surface,
            "PLine" => GocadKind::Lines,
            "VSet" => GocadKind::Points,
            _ => return,
        };
        let before = self.objects.iter().filter(|object| object.kind == kind);
        self.current = Some(GocadObject {
            name: format!("{kind_name}{}", before.count() + 1),
            kind,
            is_horizon: None,
            nodes: Vec::new(),
            triangles: Vec::new(),
            lines: Vec::new(),
            coordinates: StatedCoordinates::default(),
        });
    }

    /// Ends the current object.
    fn end_object(&mut self) {
        let ends: Vec<usize> = self
            .parts
            .iter()
            .skip(1)
            .map(|part| part.first_node)
            .collect();
        if let Some(mut object) = self.current.take() {
            for (i, part) in self.parts.drain(..).enumerate() {
                let end = ends.get(i).copied().unwrap_or(object.nodes.len());
                let mut lines = chains(&part.segments);
                // Without segments, the vertices follow one another.
                if part.segments.is_empty() && end > part.first_node {
                    lines.push((part.first_node as u32..end as u32).collect());
                }
                object
                    .lines
                    .extend(lines.into_iter().map(|nodes| (part.line, nodes)));
            }
            self.objects.push(object);
        }
        self.parts.clear();
        self.vertex_index.clear();
        self.has_name = false;
    }
}

/// Returns the units of an `AXIS_UNIT` line, whose names may be in quotes.
fn axis_units(line: &str) -> [Option<String>; 3] {
    let mut names = if line.contains('"') {
        line.split('"').skip(1).step_by(2).collect::<Vec<_>>()
    } else {
        line.split_whitespace().skip(1).collect()
    }
    .into_iter();
    std::array::from_fn(|_| {
        let name = names.next()?.trim();
        let is_none = ["", "unitless", "none", "unknown"]
            .iter()
            .any(|none| name.eq_ignore_ascii_case(none));
        (!is_none).then(|| name.to_string())
    })
}

/// Returns the direction of z that a `ZPOSITIVE` line names.
fn z_direction(words: &[&str]) -> Option<ZDirection> {
    let name = words.get(1)?.trim_matches('"').to_lowercase();
    match name.as_str() {
        "depth" => Some(ZDirection::Down),
        "elevation" => Some(ZDirection::Up),
        _ => None,
    }
}

/// Returns `true` if a `GEOLOGICAL_TYPE` line names a horizon, and `false` if it names a fault.
fn geological_type(words: &[&str]) -> Option<bool> {
    match words.get(1)?.to_lowercase().as_str() {
        "fault" => Some(false),
        "top" | "intraformational" | "unconformity" | "topographic" => Some(true),
        _ => None,
    }
}

/// Returns the lines that segments make where they share ends.
fn chains(segments: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let mut chains: Vec<Vec<u32>> = Vec::new();
    for &[a, b] in segments {
        match chains.last_mut() {
            Some(chain) if chain.last() == Some(&a) => chain.push(b),
            _ => chains.push(vec![a, b]),
        }
    }
    // Segments in another order leave pieces.
    let mut i = 0;
    while i < chains.len() {
        let joined = (i + 1..chains.len()).find_map(|j| {
            let union = chained(&chains[i], &chains[j])?;
            Some((j, union))
        });
        match joined {
            Some((j, union)) => {
                chains[i] = union;
                chains.remove(j);
            }
            None => i += 1,
        }
    }
    chains
}

/// Returns the line that two lines make if they share an end.
fn chained(a: &[u32], b: &[u32]) -> Option<Vec<u32>> {
    let reversed = |line: &[u32]| line.iter().rev().copied().collect::<Vec<u32>>();
    for first in [a.to_vec(), reversed(a)] {
        for second in [b.to_vec(), reversed(b)] {
            if first.last() == second.first() {
                return Some([&first, &second[1..]].concat());
            }
        }
    }
    None
}
