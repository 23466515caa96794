//! Reads STL, in text or binary: a surface for each solid.

use std::path::Path;

use super::SurfaceFile;
use crate::error::{Error, Result, cause};
use crate::{files, names};

/// Bytes before the triangles of a binary file: a title and the number of triangles.
const HEAD_BYTES: usize = 84;

/// Bytes of a triangle in a binary file: the normal, three corners in single precision, and two more.
const TRIANGLE_BYTES: usize = 50;

/// Reads the solids of an STL file. A solid without a name has that of the file, `stem`.
///
/// # Errors
/// Returns [`Error::Io`], with the line number in a text, if the file cannot be read or is damaged.
pub fn read_stl(path: &Path, stem: &str) -> Result<SurfaceFile<3>> {
    let bytes = files::read(path, "give an STL file")?;
    if let Some(triangles) = binary_triangles(&bytes) {
        return Ok(SurfaceFile::from_triangles([(stem.to_string(), triangles)]));
    }
    let text = String::from_utf8_lossy(&bytes);
    let mut solids: Vec<(String, Vec<[[f64; 3]; 3]>)> = Vec::new();
    let mut corners: Vec<[f64; 3]> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let refuse = |problem: &str| {
            let place = format!("{}:{number}", path.display());
            Err(Error::Io(cause(place, problem, "export the file again")))
        };
        let mut words = line.split_whitespace();
        match words.next() {
            Some("solid") => {
                let name = names::from_file(&words.collect::<Vec<_>>().join(" "));
                let is_unnamed = name.is_empty();
                solids.push((if is_unnamed { stem.into() } else { name }, Vec::new()));
            }
            Some("vertex") => {
                let corner: Vec<f64> = words.map_while(|word| word.parse().ok()).collect();
                match <[f64; 3]>::try_from(corner) {
                    Ok(corner) => corners.push(corner),
                    Err(_) => return refuse("is not a vertex (x, y, z)"),
                }
            }
            Some("endfacet") => {
                let triangle = <[[f64; 3]; 3]>::try_from(std::mem::take(&mut corners));
                match (triangle, solids.last_mut()) {
                    (Ok(triangle), Some((_, triangles))) => triangles.push(triangle),
                    _ => return refuse("ends a facet that does not have three corners"),
                }
            }
            _ if solids.is_empty() && !line.trim().is_empty() => {
                return refuse("is neither text nor binary STL");
            }
            _ => {}
        }
    }
    Ok(SurfaceFile::from_triangles(solids))
}

/// Returns the triangles of a binary file; `None` if its size is not that of one.
fn binary_triangles(bytes: &[u8]) -> Option<Vec<[[f64; 3]; 3]>> {
    let count = bytes.get(HEAD_BYTES - 4..HEAD_BYTES)?;
    let count = u32::from_le_bytes(count.try_into().ok()?) as usize;
    let body = &bytes[HEAD_BYTES..];
    if count.checked_mul(TRIANGLE_BYTES) != Some(body.len()) {
        return None;
    }
    let number = |bytes: &[u8]| bytes.try_into().map_or(f32::NAN, f32::from_le_bytes);
    let triangle = |bytes: &[u8]| {
        std::array::from_fn(|corner| {
            std::array::from_fn(|k| {
                let start = 12 + 12 * corner + 4 * k;
                f64::from(number(&bytes[start..start + 4]))
            })
        })
    };
    Some(body.chunks_exact(TRIANGLE_BYTES).map(triangle).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_binary_have_the_same_triangles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.stl");
        let text = "solid top A\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 1\n   vertex 2 0 1\n   \
                    vertex 0 3.5 -1e1\n  endloop\n endfacet\nendsolid top A\nsolid\nendsolid\n";
        std::fs::write(&path, text).unwrap();
        let file = read_stl(&path, "a").unwrap();
        assert_eq!(file.names, ["top A", "a"]);
        let expected = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 3.5, -10.0]];
        assert_eq!(file.nodes, expected);
        let mut bytes = b"solid but binary".to_vec();
        bytes.resize(80, 0);
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend([0; 12]);
        for c in expected.as_flattened() {
            bytes.extend((*c as f32).to_le_bytes());
        }
        bytes.extend([0; 2]);
        std::fs::write(&path, &bytes).unwrap();
        let file = read_stl(&path, "a").unwrap();
        assert_eq!((&*file.names[0], file.nodes), ("a", expected.to_vec()));
        for (old, new, line) in [
            ("2 0 1", "2 0", 5),
            ("endloop\n endfacet", "endfacet\nendfacet", 8),
        ] {
            std::fs::write(&path, text.replace(old, new)).unwrap();
            let message = read_stl(&path, "a").unwrap_err().to_string();
            assert!(message.contains(&format!("a.stl:{line}: ")), "{message}");
        }
    }
}
