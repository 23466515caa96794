//! Medit's `.mesh` in text (INRIA, MMG, FreeFem++): tetrahedra with their regions, triangles with the
//! numbers of their [`groups`].

use std::io::Write;
use std::path::Path;

use super::groups::groups;
use super::text::write_items;
use crate::Result;
use crate::io::Batch;
use crate::reservoir::Model;

/// Writes the mesh; numbers of nodes begin with 1.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are no tetrahedra.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let tets = &model.need_tets("Medit's format")?.tets;
    let mesh = &model.mesh;
    let groups = groups(mesh);
    batch.write(path, |out| {
        writeln!(
            out,
            "MeshVersionFormatted 2\nDimension 3\nVertices\n{}",
            mesh.nodes.len()
        )?;
        write_items(out, mesh.nodes.len(), |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.real(x).and_real(y).and_real(z).word(" 0").end();
        })?;
        writeln!(
            out,
            "Triangles\n{}",
            groups.iter().map(|g| g.faces.len()).sum::<usize>()
        )?;
        for group in &groups {
            write_items(out, group.faces.len(), |text, i| {
                for &n in mesh.faces.get(group.faces[i] as usize) {
                    text.int(n + 1).word(" ");
                }
                text.int(group.number).end();
            })?;
        }
        writeln!(out, "Tetrahedra\n{}", tets.len())?;
        write_items(out, tets.len(), |text, t| {
            for n in tets[t] {
                text.int(n + 1).word(" ");
            }
            text.int(mesh.region[t]).end();
        })?;
        writeln!(out, "End")
    })
}
