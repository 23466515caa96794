//! Surfaces and lines of VTK poly data (`.vtp`) as they are drawn.

use std::collections::BTreeMap;
use std::path::Path;

use crate::Result;
use crate::files::vtk::VtkFile;
use crate::model::slice::OverlayShape;
use crate::model::surface::SurfaceKind;
use crate::surface_file::vtp::{
    is_numbered, labelled_rings, labelled_triangles, surface_name, surface_names,
};
pub use crate::surface_file::vtp::{read_surfaces, read_triangles, write_vtp};

/// Reads the surfaces and lines of a file as they are drawn, with the numbers and names in the
/// file. A file without surface numbers gives one shape with the name of the file.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, is damaged, or has neither polygons nor lines.
pub fn read_shapes(path: &Path) -> Result<Vec<OverlayShape>> {
    let file = VtkFile::read(path, "PolyData")?;
    let (is_labelled, names) = (is_numbered(&file)?, surface_names(&file));
    let has_element = |element: &str| Ok::<_, crate::Error>(file.piece()?.child(element).is_some());
    let mut shapes: BTreeMap<i64, OverlayShape> = BTreeMap::new();
    if has_element("Polys")? {
        for (label, triangle) in labelled_triangles(&file, is_labelled)? {
            shapes.entry(label).or_default().triangles.push(triangle);
        }
    }
    if has_element("Lines")? {
        // The surface numbers belong to the polygons, if there are any.
        for (label, line) in labelled_rings(&file, "Lines", is_labelled && shapes.is_empty())? {
            shapes.entry(label).or_default().lines.push(line);
        }
    }
    if shapes.is_empty() {
        return Err(file.error("holds neither polygons nor lines", "omit it"));
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for (label, shape) in &mut shapes {
        shape.name = if is_labelled {
            surface_name(*label, &names)
        } else {
            stem.to_string()
        };
        let kinds = [SurfaceKind::Fault, SurfaceKind::Horizon].into_iter();
        let mut matching_kinds =
            kinds.filter(|kind| is_labelled && shape.name.starts_with(kind.name()));
        shape.kind = matching_kinds.next();
    }
    Ok(shapes.into_values().collect())
}
