//! Writes the named surfaces of a mesh of any cells as triangles: STL in text (its binary form has
//! single precision, which is not enough for survey coordinates), or OBJ.

use std::io::Write;
use std::path::Path;

use super::groups::FaceNames;
use crate::Result;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::geometry::{cross, norm, sub};
use crate::model::reservoir::Model;
use crate::names::NameRules;
use crate::surface_file::SurfaceFile;
use crate::surface_file::obj::add_obj;

/// Entry of STL in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "stl",
    description: "the sides of the box and the faces on features as triangles, in text",
    extensions: &["stl"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: &[ExportContent::Names],
    deck_path: None,
    names: FormatNames {
        faces: Naming::Names(NameRules::UNSPACED),
        ..FormatNames::NONE
    },
    write,
};

/// Entry of OBJ in the list of formats.
pub const FORMAT_OBJ: ExportFormat = ExportFormat {
    name: "obj",
    description: "the sides of the box and the faces on features as Wavefront OBJ",
    extensions: &["obj"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: &[ExportContent::Names],
    deck_path: None,
    names: FormatNames {
        faces: Naming::Names(NameRules::UNSPACED),
        table: TablePlace::Comments("# "),
        ..FormatNames::NONE
    },
    write: write_obj,
};

/// Returns the named groups of faces, cut into triangles. All triangles of a group face one way, as
/// [`FaceNames::side`] says.
fn named_surfaces(model: &Model, names: &FaceNames) -> SurfaceFile<3> {
    let mesh = &model.mesh;
    let groups = names.groups();
    let (mut facets, mut start) = (Vec::new(), vec![0]);
    for group in &groups {
        for &f in &group.faces {
            // Faces are convex, so a fan of triangles fills them.
            let (_, ring) = names.side(model, f);
            facets.extend((2..ring.len()).map(|i| [ring[0], ring[i - 1], ring[i]]));
        }
        start.push(facets.len());
    }
    let mut file = SurfaceFile::new(&mesh.nodes, &facets, &start, "");
    file.names = groups.into_iter().map(|group| group.name).collect();
    file
}

/// Writes STL in text, with a solid for each group.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let file = named_surfaces(model, &names.faces);
    batch.write(path, |out| {
        for (s, name) in file.names.iter().enumerate() {
            let facets = file.surface_facets(s);
            writeln!(out, "solid {name}")?;
            write_items(out, facets.len(), |text, i| {
                let corners = facets[i].map(|n| file.nodes[n as usize]);
                let [a, b, c] = corners;
                let normal = cross(sub(b, a), sub(c, a));
                let length = norm(normal).max(f64::MIN_POSITIVE);
                text.word("facet normal")
                    .point(normal.map(|v| v / length))
                    .end_line();
                text.word("outer loop").end_line();
                for corner in corners {
                    text.word("vertex").point(corner).end_line();
                }
                text.word("endloop\nendfacet").end_line();
            })?;
            writeln!(out, "endsolid {name}")?;
        }
        Ok(())
    })
}

/// Writes OBJ, with a group for each group of faces.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_obj(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    add_obj(
        batch,
        path,
        &named_surfaces(model, &names.faces),
        &names.comments(),
    )
}
