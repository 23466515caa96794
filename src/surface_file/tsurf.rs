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
use crate::image::stated::ZDirection;
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

/// Reads the `TSurf` objects of a GOCAD file, or its `PLine` objects if there are none. Other
/// objects are ignored. Vertices may have properties (`PVRTX`) or copy the position of another
/// vertex (`ATOM`, `PATOM`).
///
/// # Errors
/// Returns [`Error::Io`], with the line number if a line is damaged, if the file cannot be read or
/// has no such object.
pub fn read_gocad(path: &Path) -> Result<Gocad> {
    let mut bytes = Vec::new();
    let mut file = files::open(path, "give a GOCAD file")?;
    file.read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    let text = String::from_utf8_lossy(&bytes);
    let surfaces = read_objects::<3>(path, &text, "TSurf", &["TRGL"])?;
    if !surfaces.names.is_empty() {
        return Ok(Gocad::Surfaces(surfaces));
    }
    let lines = read_objects::<2>(path, &text, "PLine", &["SEG"])?;
    if !lines.names.is_empty() {
        return Ok(Gocad::Lines(lines));
    }
    let problem = "holds no GOCAD object TSurf or PLine";
    let remedy = "give a file of surfaces (.ts) or lines (.pl)";
    Err(Error::Io(cause(path.display(), problem, remedy)))
}

/// Reads the objects of one kind.
fn read_objects<const D: usize>(
    path: &Path,
    text: &str,
    kind: &str,
    elements: &[&str],
) -> Result<SurfaceFile<D>> {
    let mut surfaces = SurfaceFile::<D> {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    let mut in_object = false;
    // Index in `surfaces` of each vertex number of the current object.
    let mut vertex_index: HashMap<u32, u32> = HashMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let refuse = |problem: &str| {
            let place = format!("{}:{number}", path.display());
            Error::Io(cause(place, problem, "export the file again"))
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(&first) = words.first() else {
            continue;
        };
        if first == "GOCAD" {
            in_object = words.get(1) == Some(&kind);
            vertex_index.clear();
            if in_object {
                surfaces
                    .names
                    .push(format!("{kind}{}", surfaces.names.len() + 1));
                surfaces.surface_starts.push(surfaces.facets.len());
            }
            continue;
        }
        if !in_object {
            continue;
        }
        let id = |k: usize| words.get(k).and_then(|word| word.parse::<u32>().ok());
        let vertex = |k: usize| id(k).and_then(|id| vertex_index.get(&id).copied());
        match first {
            _ if first.starts_with("name:") => {
                let name = line.trim_start().trim_start_matches("name:").trim();
                if let (Some(last), false) = (surfaces.names.last_mut(), name.is_empty()) {
                    *last = names::from_file(name);
                }
            }
            "AXIS_UNIT" => {
                let units = words[1..].iter().map(|unit| unit.trim_matches('"'));
                for (k, name) in units.enumerate().take(3) {
                    let is_stated = !name.eq_ignore_ascii_case("unitless");
                    surfaces.stated.units[k] = is_stated.then(|| name.to_string());
                    surfaces.units[k] = surfaces.stated.units[k].clone().unwrap_or_default();
                }
            }
            "ZPOSITIVE" => {
                let is_down = words
                    .get(1)
                    .is_some_and(|word| word.eq_ignore_ascii_case("depth"));
                surfaces.z_up = !is_down;
                surfaces.stated.z_direction = Some(ZDirection::from_up(!is_down));
            }
            "VRTX" | "PVRTX" => {
                let position: Option<Vec<f64>> =
                    (2..5).map(|k| words.get(k)?.parse::<f64>().ok()).collect();
                let position = position.and_then(|place| <[f64; 3]>::try_from(place).ok());
                let (Some(id), Some(position)) = (id(1), position) else {
                    return Err(refuse("is not a vertex (number, x, y, z)"));
                };
                vertex_index.insert(id, surfaces.nodes.len() as u32);
                surfaces.nodes.push(position);
            }
            "ATOM" | "PATOM" => {
                let (Some(id), Some(vertex)) = (id(1), vertex(2)) else {
                    return Err(refuse("copies a vertex that does not exist"));
                };
                vertex_index.insert(id, vertex);
            }
            _ if elements.contains(&first) => {
                let nodes: Option<Vec<u32>> = (1..=D).map(vertex).collect();
                let facet = nodes.and_then(|nodes| <[u32; D]>::try_from(nodes).ok());
                let facet = facet.ok_or_else(|| refuse("names a vertex that does not exist"))?;
                surfaces.facets.push(facet);
                if let Some(end) = surfaces.surface_starts.last_mut() {
                    *end = surfaces.facets.len();
                }
            }
            "END" => in_object = false,
            _ => {}
        }
    }
    Ok(surfaces)
}
