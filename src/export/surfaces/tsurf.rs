//! Surfaces as GOCAD ASCII: a `TSurf` object for each, a `PLine` for those of a 2-D mesh.
//!
//! An object is a header, a coordinate system, then its own vertices (`VRTX`, numbered from 1)
//! and triangles (`TRGL`) or segments (`SEG`). `ZPOSITIVE` says which way z grows.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::path::Path;

use crate::error::{Error, Result, cause, io_error};
use crate::export::surfaces::file::SurfaceFile;
use crate::files;
use crate::files::atomic_write;

/// Writes surfaces; coordinates to the last digit, in the units that are known.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
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
            let mut used: Vec<u32> = file.surface_facets(s).concat();
            used.sort_unstable();
            used.dedup();
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

/// What a GOCAD file holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Gocad {
    /// Surfaces: `TSurf` objects.
    Surfaces(SurfaceFile<3>),
    /// Lines: `PLine` objects.
    Lines(SurfaceFile<2>),
}

/// Reads the `TSurf` objects of a GOCAD file, or its `PLine` objects if it has none of these; others are
/// passed over. Vertices may have properties (`PVRTX`) or stand where others do (`ATOM`, `PATOM`).
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, is damaged, or has no such object; it names the line.
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

/// The objects of one kind.
fn read_objects<const D: usize>(
    path: &Path,
    text: &str,
    kind: &str,
    elements: &[&str],
) -> Result<SurfaceFile<D>> {
    let mut found = SurfaceFile::<D> {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    let mut inside = false;
    // Numbers of an object's vertices, in the file and here.
    let mut numbers: HashMap<u32, u32> = HashMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let refuse = |problem: &str| {
            let place = format!("{}:{number}", path.display());
            Error::Io(cause(place, problem, "write it again"))
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(&first) = words.first() else {
            continue;
        };
        if first == "GOCAD" {
            inside = words.get(1) == Some(&kind);
            numbers.clear();
            if inside {
                found.names.push(format!("{kind}{}", found.names.len() + 1));
                found.surface_starts.push(found.facets.len());
            }
            continue;
        }
        if !inside {
            continue;
        }
        let id = |k: usize| words.get(k).and_then(|word| word.parse::<u32>().ok());
        let of = |k: usize| id(k).and_then(|id| numbers.get(&id).copied());
        match first {
            _ if first.starts_with("name:") => {
                let name = line.trim_start().trim_start_matches("name:").trim();
                if let (Some(last), false) = (found.names.last_mut(), name.is_empty()) {
                    *last = name.split_whitespace().collect::<Vec<_>>().join("_");
                }
            }
            "AXIS_UNIT" => {
                let units = words[1..].iter().map(|unit| unit.trim_matches('"'));
                for (unit, told) in found.units.iter_mut().zip(units) {
                    *unit = if told == "unitless" {
                        String::new()
                    } else {
                        told.to_string()
                    };
                }
            }
            "ZPOSITIVE" => found.z_up = words.get(1) != Some(&"Depth"),
            "VRTX" | "PVRTX" => {
                let place: Option<Vec<f64>> =
                    (2..5).map(|k| words.get(k)?.parse::<f64>().ok()).collect();
                let place = place.and_then(|place| <[f64; 3]>::try_from(place).ok());
                let (Some(id), Some(place)) = (id(1), place) else {
                    return Err(refuse("is no vertex: number, x, y, z"));
                };
                numbers.insert(id, found.nodes.len() as u32);
                found.nodes.push(place);
            }
            "ATOM" | "PATOM" => {
                let (Some(own), Some(other)) = (id(1), of(2)) else {
                    return Err(refuse("stands where no vertex does"));
                };
                numbers.insert(own, other);
            }
            _ if elements.contains(&first) => {
                let nodes: Option<Vec<u32>> = (1..=D).map(of).collect();
                let facet = nodes.and_then(|nodes| <[u32; D]>::try_from(nodes).ok());
                let facet = facet.ok_or_else(|| refuse("names a vertex that there is not"))?;
                found.facets.push(facet);
                if let Some(end) = found.surface_starts.last_mut() {
                    *end = found.facets.len();
                }
            }
            "END" => inside = false,
            _ => {}
        }
    }
    Ok(found)
}
