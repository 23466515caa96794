//! Gmsh's mesh format, versions 2.2 and 4.1, in text: tetrahedra in a physical volume for each region,
//! triangles in a physical surface for each side of the box, each surface, and what parts two regions. Of a
//! mesh of the plane, triangles and edges. Between the two sides of a surface along which the mesh is torn,
//! prisms of no thickness, in a physical volume that has its name.
//!
//! Numbers of nodes and of tetrahedra are those of the mesh plus 1; triangles and prisms come after. No two
//! physical groups have the same number, whatever their dimension, since some readers (DARTS) do not look at
//! that.

use std::io::Write;
use std::path::Path;

use super::groups::Named;
use super::groups::{region_name, regions};
use super::simplices::{Simplices, Torn};
use crate::Result;
use crate::export::containers::text::{Text, write_items};
use crate::files::Batch;
use crate::geometry::spread;
use crate::model::reservoir::Model;

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

/// Gmsh's numbers of element types, by their number of corners; and of quadratic ones.
const TYPES: [[u8; 2]; 5] = [[0, 0], [0, 0], [1, 8], [2, 9], [4, 11]];
/// Its number of prisms.
const PRISM: u8 = 6;

fn head(out: Out, version: &str, names: &[String], mesh: &Simplices) -> Done {
    let dim = mesh.size - 1;
    writeln!(
        out,
        "$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$PhysicalNames"
    )?;
    let count = mesh.named.len() + mesh.torn.len() + names.len();
    writeln!(out, "{count}")?;
    for Named { number, name, .. } in &mesh.named {
        writeln!(out, "{} {number} \"{name}\"", dim - 1)?;
    }
    for Torn { number, name, .. } in &mesh.torn {
        writeln!(out, "{dim} {number} \"{name}\"")?;
    }
    for (number, name) in (mesh.next_number()..).zip(names) {
        writeln!(out, "{dim} {number} \"{name}\"")?;
    }
    writeln!(out, "$EndPhysicalNames")
}

/// The types of the cells, and of their sides.
fn kinds(mesh: &Simplices) -> [u8; 2] {
    let order = usize::from(mesh.is_quadratic());
    [mesh.size, mesh.size - 1].map(|size| TYPES[size][order])
}

/// Ends a line with the nodes of a cell or side. Gmsh has the last two nodes of ten the other way round.
fn put(mesh: &Simplices, text: &mut Text, corners: &[u32]) {
    let (mut nodes, mut count) = ([0; 10], 0);
    mesh.visit(corners, |n| {
        nodes[count] = n + 1;
        count += 1;
    });
    if count == nodes.len() {
        nodes.swap(8, 9);
    }
    for n in &nodes[..count] {
        text.and_int(*n);
    }
    text.end();
}

/// Number of prisms between torn faces.
fn prisms(mesh: &Simplices) -> usize {
    mesh.torn.iter().map(|torn| torn.pairs.len()).sum()
}

/// Version 2.2.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor triangles.
pub fn write_2(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &Simplices::new(model, "Gmsh's format")?;
    let regions = regions(model);
    let names: Vec<String> = regions.iter().map(|&r| region_name(model, r)).collect();
    mesh.write_twins(batch, path, 1)?;
    batch.write(path, |out| {
        head(out, "2.2", &names, mesh)?;
        writeln!(out, "$Nodes\n{}", mesh.node_count())?;
        write_items(out, mesh.node_count(), |text, i| {
            text.int(i + 1).point(mesh.point(i)).end();
        })?;
        let count = mesh.len() + mesh.sides() + prisms(mesh);
        writeln!(out, "$EndNodes\n$Elements\n{count}")?;
        let mut next = mesh.len() + 1;
        let [kind, of_side] = kinds(mesh);
        for Named { number, sides, .. } in &mesh.named {
            write_items(out, sides.len(), |text, i| {
                let text = text.int(next + i).and_int(of_side).word(" 2");
                text.and_int(*number).and_int(*number);
                put(mesh, text, sides.get(i));
            })?;
            next += sides.len();
        }
        for Torn { number, pairs, .. } in &mesh.torn {
            write_items(out, pairs.len(), |text, i| {
                let text = text.int(next + i).and_int(PRISM).word(" 2");
                text.and_int(*number).and_int(*number);
                for &n in pairs[i].as_flattened() {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += pairs.len();
        }
        let first_region = mesh.next_number();
        write_items(out, mesh.len(), |text, t| {
            let region = regions.partition_point(|&r| r < mesh.region[t]) + first_region;
            let text = text.int(t + 1).and_int(kind).word(" 2");
            text.and_int(region).and_int(region);
            put(mesh, text, mesh.get(t));
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
    let regions = regions(model);
    let names: Vec<String> = regions.iter().map(|&r| region_name(model, r)).collect();
    let [low, high] = spread(mesh.nodes);
    mesh.write_twins(batch, path, 1)?;
    batch.write(path, |out| {
        head(out, "4.1", &names, mesh)?;
        let (dim, [kind, of_side]) = (mesh.size - 1, kinds(mesh));
        let (sides, cells) = (mesh.named.len(), regions.len() + mesh.torn.len());
        let first_region = mesh.next_number();
        match dim {
            3 => writeln!(out, "$Entities\n0 0 {sides} {cells}")?,
            _ => writeln!(out, "$Entities\n0 {sides} {cells} 0")?,
        }
        let [x, y, z] = low;
        let [u, v, w] = high;
        for Named { number, .. } in &mesh.named {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let torn = mesh.torn.iter().map(|torn| torn.number);
        for number in torn.chain(first_region..first_region + regions.len()) {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let nodes = mesh.node_count();
        writeln!(
            out,
            "$EndEntities\n$Nodes\n1 {nodes} 1 {nodes}\n{dim} {first_region} 0 {nodes}"
        )?;
        write_items(out, nodes, |text, i| text.int(i + 1).end())?;
        write_items(out, nodes, |text, i| {
            let [x, y, z] = mesh.point(i);
            text.real(x).and_real(y).and_real(z).end();
        })?;
        let (blocks, count) = (sides + cells, mesh.len() + mesh.sides() + prisms(mesh));
        writeln!(out, "$EndNodes\n$Elements\n{blocks} {count} 1 {count}")?;
        let mut next = mesh.len() + 1;
        for Named { number, sides, .. } in &mesh.named {
            writeln!(out, "{} {number} {of_side} {}", dim - 1, sides.len())?;
            write_items(out, sides.len(), |text, i| {
                text.int(next + i);
                put(mesh, text, sides.get(i));
            })?;
            next += sides.len();
        }
        for Torn { number, pairs, .. } in &mesh.torn {
            writeln!(out, "{dim} {number} {PRISM} {}", pairs.len())?;
            write_items(out, pairs.len(), |text, i| {
                text.int(next + i);
                for &n in pairs[i].as_flattened() {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += pairs.len();
        }
        for (number, &region) in (first_region..).zip(&regions) {
            let of = |t: &u32| mesh.region[*t as usize] == region;
            let own: Vec<u32> = (0..mesh.len() as u32).filter(of).collect();
            writeln!(out, "{dim} {number} {kind} {}", own.len())?;
            write_items(out, own.len(), |text, i| {
                text.int(own[i] + 1);
                put(mesh, text, mesh.get(own[i] as usize));
            })?;
        }
        writeln!(out, "$EndElements")
    })
}
