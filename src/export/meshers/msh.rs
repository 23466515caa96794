//! Gmsh's mesh format, versions 2.2 and 4.1, in text: tetrahedra in a physical volume for each region,
//! triangles in a physical surface for each side of the box and for what lies on features. Of a mesh of
//! the plane, triangles and edges.
//!
//! Numbers of nodes and of tetrahedra are those of the mesh plus 1; triangles come after.

use std::io::Write;
use std::path::Path;

use super::groups::{region_name, regions};
use super::simplices::{Named, Simplices};
use crate::Result;
use crate::export::containers::text::write_items;
use crate::files::Batch;
use crate::model::reservoir::Model;

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

/// The number of the first region: none is that of a surface too, since some readers (DARTS) do not look
/// at dimensions.
const FIRST_REGION: usize = 9;
/// Gmsh's numbers of element types, by their number of nodes.
const TYPES: [u8; 5] = [0, 0, 1, 2, 4];

fn head(out: Out, version: &str, regions: &[i32], mesh: &Simplices) -> Done {
    let dim = mesh.size - 1;
    writeln!(
        out,
        "$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$PhysicalNames"
    )?;
    writeln!(out, "{}", mesh.named.len() + regions.len())?;
    for Named { number, name, .. } in &mesh.named {
        writeln!(out, "{} {number} \"{name}\"", dim - 1)?;
    }
    for (number, &region) in (FIRST_REGION..).zip(regions) {
        writeln!(out, "{dim} {number} \"{}\"", region_name(region))?;
    }
    writeln!(out, "$EndPhysicalNames")
}

/// Version 2.2.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor triangles.
pub fn write_2(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &Simplices::new(model, "Gmsh's format")?;
    let regions = regions(&model.mesh);
    batch.write(path, |out| {
        head(out, "2.2", &regions, mesh)?;
        writeln!(out, "$Nodes\n{}", mesh.nodes.len())?;
        write_items(out, mesh.nodes.len(), |text, i| {
            text.int(i + 1).point(mesh.nodes[i]).end();
        })?;
        writeln!(out, "$EndNodes\n$Elements\n{}", mesh.len() + mesh.sides())?;
        let mut next = mesh.len() + 1;
        let (kind, of_side) = (TYPES[mesh.size], TYPES[mesh.size - 1]);
        for Named { number, sides, .. } in &mesh.named {
            write_items(out, sides.len(), |text, i| {
                let text = text.int(next + i).and_int(of_side).word(" 2");
                text.and_int(*number).and_int(*number);
                for &n in sides.get(i) {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += sides.len();
        }
        write_items(out, mesh.len(), |text, t| {
            let region = regions.partition_point(|&r| r < mesh.region[t]) + FIRST_REGION;
            let text = text.int(t + 1).and_int(kind).word(" 2");
            text.and_int(region).and_int(region);
            for n in mesh.get(t) {
                text.and_int(n + 1);
            }
            text.end();
        })?;
        writeln!(out, "$EndElements")
    })
}

/// Version 4.1.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor triangles.
pub fn write_4(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &Simplices::new(model, "Gmsh's format")?;
    let regions = regions(&model.mesh);
    let nowhere = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let (low, high) = mesh.nodes.iter().fold(nowhere, |(low, high), p| {
        (
            std::array::from_fn(|k| low[k].min(p[k])),
            std::array::from_fn(|k| high[k].max(p[k])),
        )
    });
    batch.write(path, |out| {
        head(out, "4.1", &regions, mesh)?;
        let (dim, kind, of_side) = (mesh.size - 1, TYPES[mesh.size], TYPES[mesh.size - 1]);
        let (sides, cells) = (mesh.named.len(), regions.len());
        match dim {
            3 => writeln!(out, "$Entities\n0 0 {sides} {cells}")?,
            _ => writeln!(out, "$Entities\n0 {sides} {cells} 0")?,
        }
        let [x, y, z] = low;
        let [u, v, w] = high;
        for Named { number, .. } in &mesh.named {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        for number in FIRST_REGION..FIRST_REGION + regions.len() {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let nodes = mesh.nodes.len();
        writeln!(
            out,
            "$EndEntities\n$Nodes\n1 {nodes} 1 {nodes}\n{dim} {FIRST_REGION} 0 {nodes}"
        )?;
        write_items(out, nodes, |text, i| text.int(i + 1).end())?;
        write_items(out, nodes, |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.real(x).and_real(y).and_real(z).end();
        })?;
        let (blocks, count) = (sides + cells, mesh.len() + mesh.sides());
        writeln!(out, "$EndNodes\n$Elements\n{blocks} {count} 1 {count}")?;
        let mut next = mesh.len() + 1;
        for Named { number, sides, .. } in &mesh.named {
            writeln!(out, "{} {number} {of_side} {}", dim - 1, sides.len())?;
            write_items(out, sides.len(), |text, i| {
                text.int(next + i);
                for &n in sides.get(i) {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += sides.len();
        }
        for (number, &region) in (FIRST_REGION..).zip(&regions) {
            let of = |t: &u32| mesh.region[*t as usize] == region;
            let own: Vec<u32> = (0..mesh.len() as u32).filter(of).collect();
            writeln!(out, "{dim} {number} {kind} {}", own.len())?;
            write_items(out, own.len(), |text, i| {
                text.int(own[i] + 1);
                for n in mesh.get(own[i] as usize) {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
        }
        writeln!(out, "$EndElements")
    })
}
