//! Writes TetGen's `.node`, `.ele` and `.face`: nodes, tetrahedra with their regions, and triangles
//! with the numbers of their names. Numbers begin with 1.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::model::reservoir::Model;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "tetgen",
    description: "TetGen's .node, .ele and .face",
    extensions: &["node"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: &[ExportContent::Names, ExportContent::Regions],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        max_region_number: Some(i32::MAX),
        faces: Naming::Numbers,
        table: TablePlace::Comments("# "),
        ..FormatNames::NONE
    },
    write,
};

/// Writes the three files. `path` is the `.node` file.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are not tetrahedra.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let tets = &model.need_tets("TetGen's format")?.tets;
    let mesh = &model.mesh;
    batch.write(path, |out| {
        writeln!(out, "{} 3 0 0", mesh.nodes.len())?;
        write_items(out, mesh.nodes.len(), |text, i| {
            text.int(i + 1).point(mesh.nodes[i]).end_line();
        })
    })?;
    batch.write(&path.with_extension("ele"), |out| {
        write!(out, "{}", names.comments())?;
        writeln!(out, "{} 4 1", tets.len())?;
        write_items(out, tets.len(), |text, t| {
            text.int(t + 1);
            for n in tets[t] {
                text.spaced_int(n + 1);
            }
            text.spaced_int(names.region_number(mesh.region[t]))
                .end_line();
        })
    })?;
    let groups = names.faces.groups();
    batch.write(&path.with_extension("face"), |out| {
        writeln!(
            out,
            "{} 1",
            groups.iter().map(|g| g.faces.len()).sum::<usize>()
        )?;
        let mut next = 1;
        for group in &groups {
            write_items(out, group.faces.len(), |text, i| {
                text.int(next + i);
                for n in names.faces.side(model, group.faces[i]).1 {
                    text.spaced_int(n + 1);
                }
                text.spaced_int(group.number).end_line();
            })?;
            next += group.faces.len();
        }
        Ok(())
    })
}
