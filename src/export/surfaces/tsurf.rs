//! Surfaces as GOCAD ASCII: a `TSurf` object for each, a `PLine` for those of a 2-D mesh.
//!
//! An object is a header, a coordinate system, then its own vertices (`VRTX`, numbered from 1)
//! and triangles (`TRGL`) or segments (`SEG`). `ZPOSITIVE` says which way z grows.

use std::io::Write;
use std::path::Path;

use crate::error::Result;
use crate::export::surfaces::file::SurfaceFile;
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
            let mut used: Vec<u32> = file.of(s).concat();
            used.sort_unstable();
            used.dedup();
            for (i, &n) in used.iter().enumerate() {
                let [x, y, z] = file.nodes[n as usize];
                writeln!(out, "VRTX {} {x} {y} {z}", i + 1)?;
            }
            for facet in file.of(s) {
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
