//! Gmsh's mesh format, versions 2.2 and 4.1, in text: tetrahedra in a physical volume for each region,
//! triangles in a physical surface for each side of the box and for what lies on features.
//!
//! Numbers of nodes and of tetrahedra are those of the mesh plus 1; triangles come after.

use std::io::Write;
use std::path::Path;

use super::groups::{Group, groups, region_name, regions};
use super::text::write_items;
use crate::Result;
use crate::io::Batch;
use crate::reservoir::Model;

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

/// The number of the first region: none is that of a surface too, since some readers (DARTS) do not look
/// at dimensions.
const FIRST_REGION: usize = 9;
/// Gmsh's numbers of element types.
const TRIANGLE: u8 = 2;
const TETRAHEDRON: u8 = 4;

fn head(out: Out, version: &str, regions: &[i32], groups: &[Group]) -> Done {
    writeln!(
        out,
        "$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$PhysicalNames"
    )?;
    writeln!(out, "{}", groups.len() + regions.len())?;
    for group in groups {
        writeln!(out, "2 {} \"{}\"", group.number, group.name)?;
    }
    for (number, &region) in (FIRST_REGION..).zip(regions) {
        writeln!(out, "3 {number} \"{}\"", region_name(region))?;
    }
    writeln!(out, "$EndPhysicalNames")
}

/// Version 2.2.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are no tetrahedra.
pub fn write_2(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let tets = &model.need_tets("Gmsh's format")?.tets;
    let mesh = &model.mesh;
    let (regions, groups) = (regions(mesh), groups(mesh));
    batch.write(path, |out| {
        head(out, "2.2", &regions, &groups)?;
        writeln!(out, "$Nodes\n{}", mesh.nodes.len())?;
        write_items(out, mesh.nodes.len(), |text, i| {
            text.int(i + 1).point(mesh.nodes[i]).end();
        })?;
        let triangles: usize = groups.iter().map(|g| g.faces.len()).sum();
        writeln!(out, "$EndNodes\n$Elements\n{}", tets.len() + triangles)?;
        let mut next = tets.len() + 1;
        for Group { number, faces, .. } in &groups {
            write_items(out, faces.len(), |text, i| {
                let text = text.int(next + i).and_int(TRIANGLE).word(" 2");
                text.and_int(*number).and_int(*number);
                for &n in mesh.faces.get(faces[i] as usize) {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += faces.len();
        }
        write_items(out, tets.len(), |text, t| {
            let region = regions.partition_point(|&r| r < mesh.region[t]) + FIRST_REGION;
            let text = text.int(t + 1).and_int(TETRAHEDRON).word(" 2");
            text.and_int(region).and_int(region);
            for n in tets[t] {
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
/// [`Error::Export`](crate::Error::Export) if the cells are no tetrahedra.
pub fn write_4(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let tets = &model.need_tets("Gmsh's format")?.tets;
    let mesh = &model.mesh;
    let (regions, groups) = (regions(mesh), groups(mesh));
    let nowhere = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let (low, high) = mesh.nodes.iter().fold(nowhere, |(low, high), p| {
        (
            std::array::from_fn(|k| low[k].min(p[k])),
            std::array::from_fn(|k| high[k].max(p[k])),
        )
    });
    batch.write(path, |out| {
        head(out, "4.1", &regions, &groups)?;
        writeln!(out, "$Entities\n0 0 {} {}", groups.len(), regions.len())?;
        let [x, y, z] = low;
        let [u, v, w] = high;
        for Group { number, .. } in &groups {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        for number in FIRST_REGION..FIRST_REGION + regions.len() {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let nodes = mesh.nodes.len();
        writeln!(
            out,
            "$EndEntities\n$Nodes\n1 {nodes} 1 {nodes}\n3 {FIRST_REGION} 0 {nodes}"
        )?;
        write_items(out, nodes, |text, i| text.int(i + 1).end())?;
        write_items(out, nodes, |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.real(x).and_real(y).and_real(z).end();
        })?;
        let triangles: usize = groups.iter().map(|g| g.faces.len()).sum();
        let (blocks, count) = (groups.len() + regions.len(), tets.len() + triangles);
        writeln!(out, "$EndNodes\n$Elements\n{blocks} {count} 1 {count}")?;
        let mut next = tets.len() + 1;
        for Group { number, faces, .. } in &groups {
            writeln!(out, "2 {number} {TRIANGLE} {}", faces.len())?;
            write_items(out, faces.len(), |text, i| {
                text.int(next + i);
                for &n in mesh.faces.get(faces[i] as usize) {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
            next += faces.len();
        }
        for (number, &region) in (FIRST_REGION..).zip(&regions) {
            let of = |t: &u32| mesh.region[*t as usize] == region;
            let own: Vec<u32> = (0..tets.len() as u32).filter(of).collect();
            writeln!(out, "3 {number} {TETRAHEDRON} {}", own.len())?;
            write_items(out, own.len(), |text, i| {
                text.int(own[i] + 1);
                for n in tets[own[i] as usize] {
                    text.and_int(n + 1);
                }
                text.end();
            })?;
        }
        writeln!(out, "$EndElements")
    })
}
