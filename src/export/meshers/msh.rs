//! Writes Gmsh's mesh format, versions 2.2 and 4.1, in text. Tetrahedra are in a physical volume
//! for each region, and triangles in a physical surface for each side of the box, each surface, and
//! each interface of two regions. A 2-D mesh has triangles and edges. Sets of nodes are physical
//! points. In version 4.1 elements may be in several groups, so sets of cells and of faces are groups,
//! too. Between the two sides of a
//! surface along which the mesh is split, prisms without thickness are in a physical volume with
//! the name of the surface.
//!
//! Opposite sides of a periodic mesh are periodic entities, with the pairs of their nodes.
//!
//! The numbers of nodes and tetrahedra are those of the mesh plus 1. The numbers of triangles and
//! prisms follow. All physical groups have different numbers, whatever their dimension, since some
//! readers (DARTS) ignore the dimension.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

use super::PERIODIC_ELEMENTS;
use super::groups::NamedSides;
use super::groups::sorted_regions;
use super::simplices::{SimplexMesh, TornSurface};
use crate::Result;
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, TablePlace};
use crate::files::Batch;
use crate::files::text::{FileWriter, WriteResult};
use crate::files::text::{TextBuilder, write_items};
use crate::geometry::{bounding_box, sorted};
use crate::mesh::poly::Lists;
use crate::mesh_file::formats::gmsh::{POINT_TYPE, PRISM_TYPE, SIMPLEX_TYPES};
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
    supported_content: PERIODIC_ELEMENTS,
    deck_path: None,
    names: FormatNames {
        faces_overlap: true,
        has_cell_sets: true,
        node_set_prefix: Some(""),
        ..FormatNames::one_namespace(GROUP_NAMES, TablePlace::Comments(""))
    },
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
    supported_content: PERIODIC_ELEMENTS,
    deck_path: None,
    // Readers take an element in two groups for two elements.
    names: FormatNames {
        node_set_prefix: Some(""),
        ..FormatNames::one_namespace(GROUP_NAMES, TablePlace::Comments(""))
    },
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
    let sides = mesh.named_sides.len() + mesh.elements_between().len();
    let count = sides + regions.len() + names.cell_sets.len() + mesh.node_sets.len();
    writeln!(out, "{count}")?;
    for NamedSides { number, name, .. } in &mesh.named_sides {
        writeln!(out, "{} {number} \"{name}\"", dim - 1)?;
    }
    for TornSurface { number, name, .. } in mesh.elements_between() {
        writeln!(out, "{dim} {number} \"{name}\"")?;
    }
    for (number, region) in (mesh.next_number()..).zip(regions) {
        writeln!(out, "{dim} {number} \"{}\"", names.region(*region))?;
    }
    let first = mesh.next_number() + regions.len();
    for (number, set) in (first..).zip(&names.cell_sets) {
        writeln!(out, "{dim} {number} \"{}\"", set.name)?;
    }
    let first = first_node_group(mesh, names, regions);
    for (number, set) in (first..).zip(&mesh.node_sets) {
        writeln!(out, "0 {number} \"{}\"", set.name)?;
    }
    writeln!(out, "$EndPhysicalNames")
}

/// Returns the types of the cells and of their sides.
fn element_types(mesh: &SimplexMesh) -> [u8; 2] {
    [mesh.corner_count, mesh.corner_count - 1].map(|corners| {
        let mut types = SIMPLEX_TYPES.iter().filter(|t| t.corners == corners);
        let found = types.find(|t| (t.nodes > corners) == mesh.is_quadratic());
        found.map_or(POINT_TYPE, |found| found.number)
    })
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
    let surfaces = mesh.elements_between().iter();
    surfaces.map(|torn| torn.face_pairs.len()).sum()
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
        let point_count: usize = mesh.node_sets.iter().map(|set| set.members.len()).sum();
        let count = mesh.len() + mesh.named_side_count() + prism_count(mesh) + point_count;
        writeln!(out, "$EndNodes\n$Elements\n{count}")?;
        let mut next = mesh.len() + 1;
        let [kind, side_kind] = element_types(mesh);
        let first_point = first_node_group(mesh, names, &regions);
        for (number, set) in (first_point..).zip(&mesh.node_sets) {
            write_items(out, set.members.len(), |text, i| {
                let text = text.int(next + i).spaced_int(POINT_TYPE).word(" 2");
                let text = text.spaced_int(number).spaced_int(number);
                text.spaced_int(set.members[i] + 1).end_line();
            })?;
            next += set.members.len();
        }
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
        } in mesh.elements_between()
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
        writeln!(out, "$EndElements")?;
        write_periodic(out, mesh, "Affine", Some)
    })
}

/// Writes the pairs of nodes on opposite sides of a periodic mesh. `entity_of` returns the number of
/// the entity of the side with this number. `affine` begins the line with the map between them.
fn write_periodic(
    out: FileWriter,
    mesh: &SimplexMesh,
    affine: &str,
    entity_of: impl Fn(usize) -> Option<usize>,
) -> WriteResult {
    let sides = (0..3).filter_map(|axis| {
        let period = mesh.period(axis)?;
        let near_and_far = [2 * axis + 1, 2 * axis + 2];
        let has_side = |number: usize| mesh.named_sides.iter().any(|s| s.number == number);
        if !near_and_far.into_iter().all(has_side) {
            return None;
        }
        let [near, far] = near_and_far.map(&entity_of);
        Some((axis, period, near?, far?))
    });
    let sides: Vec<_> = sides.collect();
    if sides.is_empty() {
        return Ok(());
    }
    writeln!(out, "$Periodic\n{}", sides.len())?;
    let dim = mesh.corner_count - 2;
    for (axis, [x, y, z], near, far) in sides {
        let pairs = mesh.opposite_nodes(axis);
        writeln!(out, "{dim} {far} {near}")?;
        writeln!(out, "{affine} 1 0 0 {x} 0 1 0 {y} 0 0 1 {z} 0 0 0 1")?;
        writeln!(out, "{}", pairs.len())?;
        write_items(out, pairs.len(), |text, i| {
            let [node, base] = pairs[i];
            text.int(node + 1).spaced_int(base + 1).end_line();
        })?;
    }
    writeln!(out, "$EndPeriodic")
}

/// Elements of one dimension that are in the same physical groups.
struct Entity {
    dim: usize,
    /// Number of the entity, which no other entity of the dimension has.
    tag: usize,
    /// Numbers of the groups.
    groups: Vec<usize>,
    elements: Vec<u32>,
}

/// Divides `count` elements into entities. `groups` have their number and their elements; `free` is
/// the first number that no group has.
fn entities(
    dim: usize,
    count: usize,
    groups: impl Iterator<Item = (usize, Vec<u32>)>,
    free: usize,
) -> Vec<Entity> {
    let mut combinations: Vec<Vec<usize>> = vec![Vec::new()];
    let mut next = BTreeMap::new();
    let mut element_combination = vec![0usize; count];
    for (number, elements) in groups {
        for element in elements {
            let combination = &mut element_combination[element as usize];
            if combinations[*combination].last() == Some(&number) {
                continue;
            }
            *combination = *next.entry((*combination, number)).or_insert_with(|| {
                let known = combinations[*combination].iter().copied();
                combinations.push(known.chain([number]).collect());
                combinations.len() - 1
            });
        }
    }
    let mut elements: Vec<Vec<u32>> = vec![Vec::new(); combinations.len()];
    for (element, combination) in (0..).zip(element_combination) {
        elements[combination].push(element);
    }
    let mut used = BTreeSet::new();
    let mut free = free..;
    let mut result = Vec::new();
    for (groups, elements) in combinations.into_iter().zip(elements).skip(1) {
        let own = groups.first().copied().unwrap_or(0);
        if !elements.is_empty() {
            let is_free = used.insert(own);
            let tag = if is_free {
                own
            } else {
                free.next().unwrap_or(own)
            };
            result.push(Entity {
                dim,
                tag,
                groups,
                elements,
            });
        }
    }
    result
}

/// The different sides of a mesh, and the sides of each group.
fn distinct_sides(mesh: &SimplexMesh, overlap: bool) -> (Lists, Vec<(usize, Vec<u32>)>) {
    let mut sides = Lists::default();
    let mut known: BTreeMap<Vec<u32>, u32> = BTreeMap::new();
    let mut groups = Vec::new();
    for group in &mesh.named_sides {
        let mut members = Vec::new();
        for i in 0..group.sides.len() {
            let side = group.sides.get(i);
            let next = sides.len() as u32;
            let index = if overlap {
                *known.entry(sorted(side.to_vec())).or_insert(next)
            } else {
                next
            };
            if index == next {
                sides.push(side.iter().copied());
            }
            members.push(index);
        }
        groups.push((group.number, members));
    }
    (sides, groups)
}

/// Returns the cells of each region and of each set of cells, with the number of its group.
fn cell_groups<'a>(
    mesh: &'a SimplexMesh,
    names: &'a ExportNames,
    regions: &'a [i32],
) -> impl Iterator<Item = (usize, Vec<u32>)> + 'a {
    let first = mesh.next_number();
    let cells_of = move |region: i32| {
        let is_in_region = move |t: &u32| mesh.region[*t as usize] == region;
        (0..mesh.len() as u32).filter(is_in_region).collect()
    };
    let of_regions = regions.iter().map(move |&region| cells_of(region));
    let of_sets = names.cell_sets.iter().map(|set| set.members.clone());
    (first..).zip(of_regions.chain(of_sets))
}

/// Returns the number of the group of the first set of nodes.
fn first_node_group(mesh: &SimplexMesh, names: &ExportNames, regions: &[i32]) -> usize {
    mesh.next_number() + regions.len() + names.cell_sets.len()
}

/// Writes version 4.1.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write_v4(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "Gmsh's format")?;
    let regions = sorted_regions(model);
    mesh.write_face_pairs(batch, path, 1)?;
    let (dim, [kind, side_kind]) = (mesh.corner_count - 1, element_types(mesh));
    let first_point = first_node_group(mesh, names, &regions);
    let free = first_point + mesh.node_sets.len();
    let (sides, side_groups) = distinct_sides(mesh, !names.faces.sets.is_empty());
    let node_groups = (first_point..).zip(mesh.node_sets.iter().map(|set| set.members.clone()));
    let points = entities(0, mesh.node_count(), node_groups, free);
    let side_entities = entities(dim - 1, sides.len(), side_groups.into_iter(), free);
    let cell_groups = cell_groups(mesh, names, &regions);
    let cells = entities(dim, mesh.len(), cell_groups, free);
    batch.write(path, |out| {
        write_header(out, "4.1", names, &regions, mesh)?;
        write_entities(out, mesh, [&points, &side_entities, &cells])?;
        write_nodes(out, mesh, cells.first().map_or(1, |entity| entity.tag))?;
        let entity_count = points.len() + side_entities.len() + cells.len();
        let blocks = entity_count + mesh.elements_between().len();
        let point_count: usize = points.iter().map(|entity| entity.elements.len()).sum();
        let count = mesh.len() + sides.len() + prism_count(mesh) + point_count;
        writeln!(out, "$Elements\n{blocks} {count} 1 {count}")?;
        let mut next = mesh.len() + 1;
        for entity in &points {
            write_block(out, entity, POINT_TYPE, |text, i| {
                text.int(next + i)
                    .spaced_int(entity.elements[i] + 1)
                    .end_line();
            })?;
            next += entity.elements.len();
        }
        for entity in &side_entities {
            write_block(out, entity, side_kind, |text, i| {
                text.int(next + i);
                end_with_nodes(mesh, text, sides.get(entity.elements[i] as usize));
            })?;
            next += entity.elements.len();
        }
        for torn in mesh.elements_between() {
            let pairs = &torn.face_pairs;
            writeln!(out, "{dim} {} {PRISM_TYPE} {}", torn.number, pairs.len())?;
            write_items(out, pairs.len(), |text, i| {
                text.int(next + i);
                for &n in pairs[i].as_flattened() {
                    text.spaced_int(n + 1);
                }
                text.end_line();
            })?;
            next += pairs.len();
        }
        for entity in &cells {
            write_block(out, entity, kind, |text, i| {
                let cell = entity.elements[i];
                text.int(cell + 1);
                end_with_nodes(mesh, text, mesh.get(cell as usize));
            })?;
        }
        writeln!(out, "$EndElements")?;
        write_periodic(out, mesh, "16", |number| {
            let mut with_side = side_entities.iter().filter(|e| e.groups.contains(&number));
            with_side.next().map(|entity| entity.tag)
        })
    })
}

/// Writes the elements of an entity.
fn write_block(
    out: FileWriter,
    entity: &Entity,
    kind: u8,
    write: impl Fn(&mut TextBuilder, usize) + Sync,
) -> WriteResult {
    let Entity {
        dim, tag, elements, ..
    } = entity;
    writeln!(out, "{dim} {tag} {kind} {}", elements.len())?;
    write_items(out, elements.len(), write)
}

/// Writes the entities with their groups: points, sides and cells, and the prisms between the sides of
/// a split mesh.
fn write_entities(out: FileWriter, mesh: &SimplexMesh, parts: [&[Entity]; 3]) -> WriteResult {
    let dim = mesh.corner_count - 1;
    let mut counts = [0; 4];
    counts[dim] = mesh.elements_between().len();
    for entity in parts.into_iter().flatten() {
        counts[entity.dim] += 1;
    }
    let [a, b, c, d] = counts;
    writeln!(out, "$Entities\n{a} {b} {c} {d}")?;
    let [low, high] = bounding_box(mesh.nodes);
    let [[x, y, z], [u, v, w]] = [low, high];
    let [points, sides, cells] = parts;
    let line = |out: FileWriter, Entity { tag, groups, .. }: &Entity, place: &str, end: &str| {
        let list: Vec<String> = groups.iter().map(usize::to_string).collect();
        writeln!(
            out,
            "{tag} {place} {} {}{end}",
            groups.len(),
            list.join(" ")
        )
    };
    for entity in points {
        let [x, y, z] = mesh.point(entity.elements[0] as usize);
        line(out, entity, &format!("{x} {y} {z}"), "")?;
    }
    let extent = format!("{x} {y} {z} {u} {v} {w}");
    for entity in sides {
        line(out, entity, &extent, " 0")?;
    }
    for TornSurface { number, .. } in mesh.elements_between() {
        writeln!(out, "{number} {extent} 1 {number} 0")?;
    }
    for entity in cells {
        line(out, entity, &extent, " 0")?;
    }
    writeln!(out, "$EndEntities")
}

/// Writes all nodes as those of an entity of cells.
fn write_nodes(out: FileWriter, mesh: &SimplexMesh, tag: usize) -> WriteResult {
    let (nodes, dim) = (mesh.node_count(), mesh.corner_count - 1);
    writeln!(out, "$Nodes\n1 {nodes} 1 {nodes}\n{dim} {tag} 0 {nodes}")?;
    write_items(out, nodes, |text, i| text.int(i + 1).end_line())?;
    write_items(out, nodes, |text, i| {
        let [x, y, z] = mesh.point(i);
        text.real(x).spaced_real(y).spaced_real(z).end_line();
    })?;
    writeln!(out, "$EndNodes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_in_the_same_groups_are_one_entity() {
        let groups = [(5, vec![0, 1, 2]), (6, vec![1]), (7, vec![1, 3, 3])];
        let entities = entities(3, 5, groups.into_iter(), 9);
        let found = entities
            .iter()
            .map(|e| (e.tag, e.groups.clone(), e.elements.clone()));
        let expected = [
            (5, vec![5], vec![0, 2]),
            (9, vec![5, 6, 7], vec![1]),
            (7, vec![7], vec![3]),
        ];
        assert_eq!(found.collect::<Vec<_>>(), expected);
    }
}
