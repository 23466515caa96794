//! Medit's `.mesh` in text (INRIA, MMG, FreeFem++): tetrahedra with their regions, triangles with the
//! numbers of their names. Of a mesh of the plane, triangles and edges.

use std::io::Write;
use std::path::Path;

use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::containers::text::write_items;
use crate::files::Batch;
use crate::model::reservoir::Model;

/// Writes the mesh; numbers of nodes begin with 1.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor triangles.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, "Medit's format")?;
    let (names, of_side) = match mesh.corner_count {
        3 => ("Triangles", "Edges"),
        _ => ("Tetrahedra", "Triangles"),
    };
    batch.write(path, |out| {
        writeln!(
            out,
            "MeshVersionFormatted 2\nDimension 3\nVertices\n{}",
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
        writeln!(out, "{of_side}\n{}", mesh.named_side_count())?;
        for named in &mesh.named_sides {
            write_items(out, named.sides.len(), |text, i| {
                for &n in named.sides.get(i) {
                    text.int(n + 1).word(" ");
                }
                text.int(named.number).end_line();
            })?;
        }
        writeln!(out, "{names}\n{}", mesh.len())?;
        write_items(out, mesh.len(), |text, t| {
            for n in mesh.get(t) {
                text.int(n + 1).word(" ");
            }
            text.int(mesh.region[t]).end_line();
        })?;
        writeln!(out, "End")
    })
}
