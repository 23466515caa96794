//! Reads PLY, in text or binary: the polygons of its faces.

use std::path::Path;
use std::str::SplitAsciiWhitespace;

use super::SurfaceFile;
use crate::error::{Error, Result, cause};
use crate::files;

/// Reads the polygons of a PLY file as one surface with the name `stem`. They are cut into fans.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be read or is damaged.
pub fn read_ply(path: &Path, stem: &str) -> Result<SurfaceFile<3>> {
    let bytes = files::read(path, "give a PLY file")?;
    let triangles = triangles(&bytes).ok_or_else(|| {
        let problem = "is no PLY file with vertices x, y, z and faces, or is damaged";
        Error::Io(cause(path.display(), problem, "export the file again"))
    })?;
    Ok(SurfaceFile::from_triangles([(stem.to_string(), triangles)]))
}

/// A kind of item, such as vertices, as the head of the file describes it.
struct Items<'a> {
    name: &'a str,
    count: usize,
    properties: Vec<Property<'a>>,
}

/// A number of an item, or a list of numbers.
struct Property<'a> {
    name: &'a str,
    kind: &'a str,
    /// The type of the length, if it is a list.
    length: Option<&'a str>,
}

/// The numbers after the head of a file.
enum Numbers<'a> {
    Text(SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], is_big: bool },
}

impl Numbers<'_> {
    /// Returns the next number, which is of this type.
    fn next(&mut self, kind: &str) -> Option<f64> {
        match self {
            Self::Text(words) => words.next()?.parse().ok(),
            Self::Binary { bytes, is_big } => {
                let (head, rest) = bytes.split_at_checked(byte_count(kind)?)?;
                *bytes = rest;
                let mut head = head.to_vec();
                if *is_big {
                    head.reverse();
                }
                number(kind, &head)
            }
        }
    }

    /// Returns the values of a property.
    fn values(&mut self, property: &Property) -> Option<Vec<f64>> {
        let count = match property.length {
            Some(kind) => self.next(kind)? as usize,
            None => 1,
        };
        (0..count).map(|_| self.next(property.kind)).collect()
    }
}

/// Returns the number of bytes of a type.
fn byte_count(kind: &str) -> Option<usize> {
    Some(match kind {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        _ => return None,
    })
}

/// Returns the number that bytes of a type hold, the least significant first.
fn number(kind: &str, bytes: &[u8]) -> Option<f64> {
    Some(match kind {
        "char" | "int8" => f64::from(i8::from_le_bytes(bytes.try_into().ok()?)),
        "uchar" | "uint8" => f64::from(*bytes.first()?),
        "short" | "int16" => f64::from(i16::from_le_bytes(bytes.try_into().ok()?)),
        "ushort" | "uint16" => f64::from(u16::from_le_bytes(bytes.try_into().ok()?)),
        "int" | "int32" => f64::from(i32::from_le_bytes(bytes.try_into().ok()?)),
        "uint" | "uint32" => f64::from(u32::from_le_bytes(bytes.try_into().ok()?)),
        "float" | "float32" => f64::from(f32::from_le_bytes(bytes.try_into().ok()?)),
        _ => f64::from_le_bytes(bytes.try_into().ok()?),
    })
}

/// Returns the triangles of a file; `None` if it is damaged.
fn triangles(bytes: &[u8]) -> Option<Vec<[[f64; 3]; 3]>> {
    const END: &[u8] = b"end_header";
    let end = bytes.windows(END.len()).position(|window| window == END)?;
    let body = &bytes[end + END.len()..];
    let body = &body[body.iter().position(|&byte| byte == b'\n')? + 1..];
    let head = std::str::from_utf8(&bytes[..end]).ok()?;
    let mut items: Vec<Items> = Vec::new();
    let mut numbers = None;
    for line in head.lines() {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["format", "ascii", ..] => {
                let text = std::str::from_utf8(body).ok()?;
                numbers = Some(Numbers::Text(text.split_ascii_whitespace()));
            }
            ["format", order, ..] => {
                let is_big = order == "binary_big_endian";
                numbers = Some(Numbers::Binary {
                    bytes: body,
                    is_big,
                });
            }
            ["element", name, count] => items.push(Items {
                name,
                count: count.parse().ok()?,
                properties: Vec::new(),
            }),
            ["property", "list", length, kind, name] => {
                items.last_mut()?.properties.push(Property {
                    name,
                    kind,
                    length: Some(length),
                })
            }
            ["property", kind, name] => items.last_mut()?.properties.push(Property {
                name,
                kind,
                length: None,
            }),
            _ => {}
        }
    }
    read_items(&items, &mut numbers?)
}

/// Reads the items that the head describes.
fn read_items(items: &[Items], numbers: &mut Numbers) -> Option<Vec<[[f64; 3]; 3]>> {
    let (mut nodes, mut rings) = (Vec::new(), Vec::new());
    for kind in items.iter().filter(|kind| !kind.properties.is_empty()) {
        for _ in 0..kind.count {
            let mut point = [f64::NAN; 3];
            for property in &kind.properties {
                let values = numbers.values(property)?;
                match (kind.name, property.name) {
                    ("vertex", "x") => point[0] = values[0],
                    ("vertex", "y") => point[1] = values[0],
                    ("vertex", "z") => point[2] = values[0],
                    ("face", "vertex_indices" | "vertex_index") => rings.push(values),
                    _ => {}
                }
            }
            if kind.name == "vertex" {
                nodes.push(point);
            }
        }
    }
    let node = |n: f64| nodes.get(n as usize).copied().filter(|_| n >= 0.0);
    let mut triangles = Vec::new();
    for ring in rings {
        for k in 2..ring.len() {
            triangles.push([node(ring[0])?, node(ring[k - 1])?, node(ring[k])?]);
        }
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_both_binary_orders_have_the_same_triangles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let head = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
                 property double y\nproperty float z\nproperty uchar red\nelement face 1\n\
                 property list uchar int vertex_indices\nend_header\n"
            )
        };
        let points: [[f64; 3]; 4] = [
            [0.0, 0.1, 1.0],
            [2.0, 0.0, 1.0],
            [2.0, 3.0, 0.5],
            [0.0, 3.0, -1.0],
        ];
        let mut text = head("ascii");
        for [x, y, z] in points {
            text += &format!("{x} {y} {z} 255\n");
        }
        text += "4 0 1 2 3\n";
        let binary = |format: &str, is_big: bool| {
            let mut bytes = head(format).into_bytes();
            let mut push = |mut value: Vec<u8>| {
                if is_big {
                    value.reverse();
                }
                bytes.extend(value);
            };
            for [x, y, z] in points {
                push((x as f32).to_le_bytes().to_vec());
                push(y.to_le_bytes().to_vec());
                push((z as f32).to_le_bytes().to_vec());
                push(vec![255]);
            }
            push(vec![4]);
            (0..4_i32).for_each(|n| push(n.to_le_bytes().to_vec()));
            bytes
        };
        for bytes in [
            text.into_bytes(),
            binary("binary_little_endian", false),
            binary("binary_big_endian", true),
        ] {
            std::fs::write(&path, &bytes).unwrap();
            let file = read_ply(&path, "a").unwrap();
            let [a, b, c, d] = points;
            assert_eq!(
                (file.names, file.nodes),
                (vec!["a".to_string()], vec![a, b, c, a, c, d])
            );
            std::fs::write(&path, &bytes[..bytes.len() - 2]).unwrap();
            assert!(read_ply(&path, "a").is_err());
        }
    }
}
