//! Surfaces as Wavefront OBJ: a group for each, triangles as faces, segments of a 2-D mesh as lines.

use std::io::Write;
use std::path::Path;

use super::surfaces::SurfaceFile;
use crate::error::Result;
use crate::io::atomic_write;

/// Writes surfaces; coordinates to the last digit.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_obj<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let element = if D == 2 { 'l' } else { 'f' };
    atomic_write(path, |out| {
        writeln!(out, "# atomesh {}", env!("CARGO_PKG_VERSION"))?;
        for [x, y, z] in &file.nodes {
            writeln!(out, "v {x} {y} {z}")?;
        }
        for (s, name) in file.names.iter().enumerate() {
            writeln!(out, "g {name}")?;
            for facet in file.of(s) {
                write!(out, "{element}")?;
                for n in facet {
                    write!(out, " {}", n + 1)?;
                }
                writeln!(out)?;
            }
        }
        Ok(())
    })
}
