//! Reads and writes surfaces in Wavefront OBJ: a group for each surface, with triangles as faces, or segments
//! of a 2-D mesh as lines.

use std::io::Write;
use std::path::Path;

use super::SurfaceFile;
use crate::error::{Error, Result, cause};
use crate::files::text::write_items;
use crate::files::{self, Batch};
use crate::image::stated::ZDirection;
use crate::names::{self, NameRules};
use crate::units;

/// Reads the surfaces of an OBJ file: those of each group or object, or one with the name `stem`.
/// Polygons are cut into fans. A comment such as `# units: m` states the unit.
///
/// # Errors
/// Returns [`Error::Io`], with the line number, if the file cannot be read or a line is damaged.
pub fn read_obj(path: &Path, stem: &str) -> Result<SurfaceFile<3>> {
    let bytes = files::read(path, "give a file of surfaces")?;
    let text = String::from_utf8_lossy(&bytes);
    let mut file = SurfaceFile::<3> {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    for (number, line) in (1..).zip(text.lines()) {
        let refuse = |problem: &str| {
            let place = format!("{}:{number}", path.display());
            Error::Io(cause(place, problem, "export the file again"))
        };
        let mut words = line.split_whitespace();
        match words.next() {
            Some("#") => read_remark(line, &mut file),
            Some("v") => {
                let position: Vec<f64> = words.map_while(|word| word.parse().ok()).collect();
                let position = position.first_chunk::<3>().copied();
                let position = position.filter(|p| p.iter().all(|c| c.is_finite()));
                file.nodes
                    .push(position.ok_or_else(|| refuse("is not a vertex (x, y, z)"))?);
            }
            Some("g" | "o") => {
                let name = names::from_file(&words.collect::<Vec<_>>().join(" "));
                file.names.push(if name.is_empty() {
                    stem.to_string()
                } else {
                    name
                });
                file.surface_starts.push(file.facets.len());
            }
            Some("f") => {
                let count = file.nodes.len() as i64;
                let index = |word: &str| {
                    let number: i64 = word.split('/').next()?.parse().ok()?;
                    let index = if number < 0 {
                        count + number
                    } else {
                        number - 1
                    };
                    (0..count).contains(&index).then_some(index as u32)
                };
                let ring: Option<Vec<u32>> = words.map(index).collect();
                let ring = ring.ok_or_else(|| refuse("names a vertex that does not exist"))?;
                if file.names.is_empty() {
                    file.names.push(stem.to_string());
                    file.surface_starts.push(0);
                }
                file.facets
                    .extend((2..ring.len()).map(|k| [ring[0], ring[k - 1], ring[k]]));
                if let Some(end) = file.surface_starts.last_mut() {
                    *end = file.facets.len();
                }
            }
            _ => {}
        }
    }
    Ok(file)
}

/// Takes what a remark of an OBJ file says about the coordinates: `# units: m,m,ms` and `# z: up`,
/// as atomesh writes them.
fn read_remark(line: &str, file: &mut SurfaceFile<3>) {
    let text = line.trim_start_matches(['#', ' ']);
    if let Some(names) = text.strip_prefix("units:") {
        for (k, name) in names
            .split([',', ' '])
            .filter(|n| !n.is_empty())
            .take(3)
            .enumerate()
        {
            let unit = units::find(name).map(|_| name.to_string());
            file.units[k] = unit.clone().unwrap_or_default();
            file.stated.units[k] = unit;
        }
    }
    if let Some(unit) = unit_of_remark(text) {
        file.stated.units = [(); 3].map(|()| Some(unit.to_string()));
        file.units = [(); 3].map(|()| unit.to_string());
    }
    if let Some(direction) = text.strip_prefix("z:") {
        let is_up = direction.trim() != "down";
        file.z_up = is_up;
        file.stated.z_direction = Some(ZDirection::from_up(is_up));
    }
}

/// Returns the unit of all coordinates that a remark of another program states, such as
/// `File units = meters`.
fn unit_of_remark(text: &str) -> Option<&str> {
    let (before, name) = text.rsplit_once(['=', ':', ' '])?;
    let is_stated = before.to_lowercase().contains("unit") && !before.contains(',');
    (is_stated && units::find(name).is_some()).then(|| name.trim())
}

/// Writes surfaces. Coordinates have all digits.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_obj<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let mut batch = Batch::default();
    let names = file.written_names(&NameRules::UNSPACED);
    add_obj(&mut batch, path, &names.file, &names.table.comments("# "))?;
    batch.commit()
}

/// Adds surfaces, as [`write_obj`] writes them, to a batch of files, with these comments at the head.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn add_obj<const D: usize>(
    batch: &mut Batch,
    path: &Path,
    file: &SurfaceFile<D>,
    comments: &str,
) -> Result<()> {
    let element = if D == 2 { "l" } else { "f" };
    batch.write(path, |out| {
        writeln!(out, "# atomesh {}", env!("CARGO_PKG_VERSION"))?;
        let units = file.units.join(",");
        if units.len() > 2 {
            let direction = ZDirection::from_up(file.z_up);
            writeln!(out, "# units: {units}\n# z: {direction}")?;
        }
        write!(out, "{comments}")?;
        write_items(out, file.nodes.len(), |text, i| {
            text.word("v").point(file.nodes[i]).end_line();
        })?;
        for (s, name) in file.names.iter().enumerate() {
            writeln!(out, "g {name}")?;
            let facets = file.surface_facets(s);
            write_items(out, facets.len(), |text, i| {
                text.word(element);
                for n in facets[i] {
                    text.spaced_int(n + 1);
                }
                text.end_line();
            })?;
        }
        Ok(())
    })
}
