//! Writes surfaces as Wavefront OBJ: a group for each surface, with triangles as faces, or segments
//! of a 2-D mesh as lines.

use std::io::Write;
use std::path::Path;

use crate::error::Result;
use crate::export::containers::text::write_items;
use crate::files::Batch;
use crate::image::stated::ZDirection;
use crate::names::NameRules;
use crate::surface_file::SurfaceFile;

/// Writes surfaces. Coordinates have all digits.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_obj<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let mut batch = Batch::default();
    let names = file.written_names(&NameRules::UNSPACED);
    add_obj(&mut batch, path, &names.file, &names.table.comments("# "))?;
    batch.commit()
}

/// Adds surfaces, as [`write_obj`] writes them, to a batch of files, with these comments at the head.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
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
