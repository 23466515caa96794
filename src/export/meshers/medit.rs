//! Writes Medit's `.mesh` in text (INRIA, MMG, FreeFem++): tetrahedra with their regions, and
//! triangles with the numbers of their names. A 2-D mesh has triangles and edges.

use std::io::Write;
use std::path::Path;

use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::model::reservoir::Model;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "medit",
    description: "Medit mesh of tetrahedra and triangles",
    extensions: &["mesh"],
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

/// Writes the mesh. Node numbers begin with 1.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "Medit's format")?;
    let (cell_keyword, side_keyword) = match mesh.corner_count {
        3 => ("Triangles", "Edges"),
        _ => ("Tetrahedra", "Triangles"),
    };
    batch.write(path, |out| {
        writeln!(
            out,
            "MeshVersionFormatted 2\nDimension 3\n{}Vertices\n{}",
            names.comments(),
            mesh.nodes.len()
        )?;
        write_items(out, mesh.nodes.len(), |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.real(x)
                .spaced_real(y)
                .spaced_real(z)
                .word(" 0")
                .end_line();
        })?;
        writeln!(out, "{side_keyword}\n{}", mesh.named_side_count())?;
        for group in &mesh.named_sides {
            write_items(out, group.sides.len(), |text, i| {
                for &n in group.sides.get(i) {
                    text.int(n + 1).word(" ");
                }
                text.int(group.number).end_line();
            })?;
        }
        writeln!(out, "{cell_keyword}\n{}", mesh.len())?;
        write_items(out, mesh.len(), |text, t| {
            for n in mesh.get(t) {
                text.int(n + 1).word(" ");
            }
            text.int(names.region_number(mesh.region[t])).end_line();
        })?;
        writeln!(out, "End")
    })
}
