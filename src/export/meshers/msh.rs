//! Writes Gmsh's mesh format, versions 2.2 and 4.1, in text. Tetrahedra are in a physical volume
//! for each region, and triangles in a physical surface for each side of the box, each surface, and
//! each interface of two regions. A 2-D mesh has triangles and edges. Between the two sides of a
//! surface along which the mesh is split, prisms without thickness are in a physical volume with
//! the name of the surface.
//!
//! The numbers of nodes and tetrahedra are those of the mesh plus 1. The numbers of triangles and
//! prisms follow. All physical groups have different numbers, whatever their dimension, since some
//! readers (DARTS) ignore the dimension.

use std::io::Write;
use std::path::Path;

use super::NAMED_ELEMENTS;
use super::groups::NamedSides;
use super::groups::sorted_regions;
use super::simplices::{SimplexMesh, TornSurface};
use crate::Result;
use crate::export::containers::text::{FileWriter, WriteResult};
use crate::export::containers::text::{TextBuilder, write_items};
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, TablePlace};
use crate::files::Batch;
use crate::geometry::bounding_box;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of version 4.1 in the list of formats.
pub const FORMAT_V4: ExportFormat = ExportFormat {
    name: "msh",
    description: "Gmsh mesh, version 4.1: tetrahedra, regions and surfaces",
    extensions: &["msh"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: NAMED_ELEMENTS,
    deck_path: None,
    names: FormatNames::one_namespace(GROUP_NAMES, TablePlace::Comments("")),
    write: write_v4,
};

/// Entry of version 2.2 in the list of formats.
pub const FORMAT_V2: ExportFormat = ExportFormat {
    name: "msh2",
    description: "Gmsh mesh, version 2.2",
    extensions: &["msh"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: NAMED_ELEMENTS,
    deck_path: None,
    names: FormatNames::one_namespace(GROUP_NAMES, TablePlace::Comments("")),
    write: write_v2,
};

/// Rules of Gmsh for the names of physical groups. Readers such as meshio have one list of names for
/// all dimensions.
const GROUP_NAMES: NameRules = NameRules {
    max_bytes: 127,
    distinct_bytes: 127,
    is_allowed: |c| !c.is_control() && c != '"',
    ..NameRules::TEXT
};
/// Gmsh types of linear and of quadratic simplices, by their number of corners.
const ELEMENT_TYPES: [[u8; 2]; 5] = [[0, 0], [0, 0], [1, 8], [2, 9], [4, 11]];
/// Gmsh type of prisms.
const PRISM_TYPE: u8 = 6;

fn write_header(
    out: FileWriter,
    version: &str,
    names: &ExportNames,
    regions: &[i32],
    mesh: &SimplexMesh,
) -> WriteResult {
    let dim = mesh.corner_count - 1;
    writeln!(out, "$MeshFormat\n{version} 0 8\n$EndMeshFormat")?;
    let comments = names.comments();
    if !comments.is_empty() {
        writeln!(out, "$Comments\n{comments}$EndComments")?;
    }
    writeln!(out, "$PhysicalNames")?;
    let count = mesh.named_sides.len() + mesh.torn_surfaces.len() + regions.len();
    writeln!(out, "{count}")?;
    for NamedSides { number, name, .. } in &mesh.named_sides {
        writeln!(out, "{} {number} \"{name}\"", dim - 1)?;
    }
    for TornSurface { number, name, .. } in &mesh.torn_surfaces {
        writeln!(out, "{dim} {number} \"{name}\"")?;
    }
    for (number, region) in (mesh.next_number()..).zip(regions) {
        writeln!(out, "{dim} {number} \"{}\"", names.region(*region))?;
    }
    writeln!(out, "$EndPhysicalNames")
}

/// Returns the types of the cells and of their sides.
fn element_types(mesh: &SimplexMesh) -> [u8; 2] {
    let order = usize::from(mesh.is_quadratic());
    [mesh.corner_count, mesh.corner_count - 1].map(|size| ELEMENT_TYPES[size][order])
}

/// Ends a line with the nodes of a cell or side. In Gmsh, the last two of ten nodes are in reverse
/// order.
fn end_with_nodes(mesh: &SimplexMesh, text: &mut TextBuilder, corners: &[u32]) {
    let (mut nodes, mut count) = ([0; 10], 0);
    mesh.visit_nodes(corners, |n| {
        nodes[count] = n + 1;
        count += 1;
    });
    if count == nodes.len() {
        nodes.swap(8, 9);
    }
    for n in &nodes[..count] {
        text.spaced_int(*n);
    }
    text.end_line();
}

/// Returns the number of prisms between split faces.
fn prism_count(mesh: &SimplexMesh) -> usize {
    mesh.torn_surfaces
        .iter()
        .map(|torn| torn.face_pairs.len())
        .sum()
}

/// Writes version 2.2.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write_v2(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "Gmsh's format")?;
    let regions = sorted_regions(model);
    mesh.write_face_pairs(batch, path, 1)?;
    batch.write(path, |out| {
        write_header(out, "2.2", names, &regions, mesh)?;
        writeln!(out, "$Nodes\n{}", mesh.node_count())?;
        write_items(out, mesh.node_count(), |text, i| {
            text.int(i + 1).point(mesh.point(i)).end_line();
        })?;
        let count = mesh.len() + mesh.named_side_count() + prism_count(mesh);
        writeln!(out, "$EndNodes\n$Elements\n{count}")?;
        let mut next = mesh.len() + 1;
        let [kind, side_kind] = element_types(mesh);
        for NamedSides { number, sides, .. } in &mesh.named_sides {
            write_items(out, sides.len(), |text, i| {
                let text = text.int(next + i).spaced_int(side_kind).word(" 2");
                text.spaced_int(*number).spaced_int(*number);
                end_with_nodes(mesh, text, sides.get(i));
            })?;
            next += sides.len();
        }
        for TornSurface {
            number,
            face_pairs: pairs,
            ..
        } in &mesh.torn_surfaces
        {
            write_items(out, pairs.len(), |text, i| {
                let text = text.int(next + i).spaced_int(PRISM_TYPE).word(" 2");
                text.spaced_int(*number).spaced_int(*number);
                for &n in pairs[i].as_flattened() {
                    text.spaced_int(n + 1);
                }
                text.end_line();
            })?;
            next += pairs.len();
        }
        let first_region = mesh.next_number();
        write_items(out, mesh.len(), |text, t| {
            let region = regions.partition_point(|&r| r < mesh.region[t]) + first_region;
            let text = text.int(t + 1).spaced_int(kind).word(" 2");
            text.spaced_int(region).spaced_int(region);
            end_with_nodes(mesh, text, mesh.get(t));
        })?;
        writeln!(out, "$EndElements")
    })
}

/// Writes version 4.1.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write_v4(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "Gmsh's format")?;
    let regions = sorted_regions(model);
    let [low, high] = bounding_box(mesh.nodes);
    mesh.write_face_pairs(batch, path, 1)?;
    batch.write(path, |out| {
        write_header(out, "4.1", names, &regions, mesh)?;
        let (dim, [kind, side_kind]) = (mesh.corner_count - 1, element_types(mesh));
        let (sides, cells) = (
            mesh.named_sides.len(),
            regions.len() + mesh.torn_surfaces.len(),
        );
        let first_region = mesh.next_number();
        match dim {
            3 => writeln!(out, "$Entities\n0 0 {sides} {cells}")?,
            _ => writeln!(out, "$Entities\n0 {sides} {cells} 0")?,
        }
        let [x, y, z] = low;
        let [u, v, w] = high;
        for NamedSides { number, .. } in &mesh.named_sides {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let torn = mesh.torn_surfaces.iter().map(|torn| torn.number);
        for number in torn.chain(first_region..first_region + regions.len()) {
            writeln!(out, "{number} {x} {y} {z} {u} {v} {w} 1 {number} 0")?;
        }
        let nodes = mesh.node_count();
        writeln!(
            out,
            "$EndEntities\n$Nodes\n1 {nodes} 1 {nodes}\n{dim} {first_region} 0 {nodes}"
        )?;
        write_items(out, nodes, |text, i| text.int(i + 1).end_line())?;
        write_items(out, nodes, |text, i| {
            let [x, y, z] = mesh.point(i);
            text.real(x).spaced_real(y).spaced_real(z).end_line();
        })?;
        let (blocks, count) = (
            sides + cells,
            mesh.len() + mesh.named_side_count() + prism_count(mesh),
        );
        writeln!(out, "$EndNodes\n$Elements\n{blocks} {count} 1 {count}")?;
        let mut next = mesh.len() + 1;
        for NamedSides { number, sides, .. } in &mesh.named_sides {
            writeln!(out, "{} {number} {side_kind} {}", dim - 1, sides.len())?;
            write_items(out, sides.len(), |text, i| {
                text.int(next + i);
                end_with_nodes(mesh, text, sides.get(i));
            })?;
            next += sides.len();
        }
        for TornSurface {
            number,
            face_pairs: pairs,
            ..
        } in &mesh.torn_surfaces
        {
            writeln!(out, "{dim} {number} {PRISM_TYPE} {}", pairs.len())?;
            write_items(out, pairs.len(), |text, i| {
                text.int(next + i);
                for &n in pairs[i].as_flattened() {
                    text.spaced_int(n + 1);
                }
                text.end_line();
            })?;
            next += pairs.len();
        }
        for (number, &region) in (first_region..).zip(&regions) {
            let is_in_region = |t: &u32| mesh.region[*t as usize] == region;
            let region_cells: Vec<u32> = (0..mesh.len() as u32).filter(is_in_region).collect();
            writeln!(out, "{dim} {number} {kind} {}", region_cells.len())?;
            write_items(out, region_cells.len(), |text, i| {
                text.int(region_cells[i] + 1);
                end_with_nodes(mesh, text, mesh.get(region_cells[i] as usize));
            })?;
        }
        writeln!(out, "$EndElements")
    })
}
