//! Reads Exodus II files, in NetCDF's classic formats and in NetCDF-4: element blocks become regions,
//! side sets become surfaces.
//!
//! - `polyhedra`: blocks of cells that are lists of faces
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and
//! appendix A.

mod polyhedra;

use std::path::Path;

use super::groups::{Group, GroupNames};
use super::netcdf::NetcdfReader;
use super::{FileProblem, ForeignMesh, NotedMesh, ReadResult};
use crate::geometry::sorted_distinct;
use crate::mesh_file::formats::exodus::{
    COORDINATES, ELEMENT_BLOCKS, ELEMENT_TYPE, ELEMENT_VALUE_NAMES, ELEMENTS, ELEMENTS_OF_FACES,
    NODE_SET_ARRAY, NODE_SETS, ObjectKind, SHELL_FACE_COUNT, SIDE_SET_ARRAYS, SIDE_SETS,
    TETRAHEDRON_SIDES, TRIANGLE_SIDES,
};
use crate::names;
use crate::store::named_sets::NamedSet;

/// Kind of the elements of a block.
#[derive(Clone, Copy, PartialEq)]
enum BlockKind {
    Tet,
    Triangle,
    Edge,
    Point,
}

impl BlockKind {
    fn dim(self) -> usize {
        match self {
            Self::Tet => 3,
            Self::Triangle => 2,
            Self::Edge => 1,
            Self::Point => 0,
        }
    }
}

/// Reads a mesh.
pub fn read(path: &Path) -> ReadResult<NotedMesh> {
    let file = &NetcdfReader::open(path)?;
    let blocks = ObjectList::new(file, &ELEMENT_BLOCKS, ELEMENTS.list)?;
    let has_face_lists = |block: usize| {
        file.shape(&format!("{}{}", ELEMENTS_OF_FACES.list, block + 1))
            .is_some()
    };
    let (mesh, mut notes) = if (0..blocks.ids.len()).any(has_face_lists) {
        polyhedra::read(file, &blocks)?
    } else {
        simplices(file, &blocks)?.into_mesh()?
    };
    notes.extend(unread_values(file));
    Ok((mesh, notes))
}

/// Returns a note on values at times, which are not read.
fn unread_values(file: &NetcdfReader) -> Option<String> {
    let mut names = Vec::new();
    for list in ["name_nod_var", ELEMENT_VALUE_NAMES, "name_glo_var"] {
        names.extend(file.texts(list).ok()?);
    }
    // Our own files have the regions as values.
    names.retain(|name| name != "region");
    (!names.is_empty()).then(|| format!("values are not read: {}", names.join(", ")))
}

/// The objects of one kind (blocks, side sets or node sets) that a file lists.
struct ObjectList {
    /// The number that the file gives each object.
    ids: Vec<i32>,
    /// The name of each object; empty for none.
    names: Vec<String>,
}

impl ObjectList {
    /// Reads the list of objects of a kind. If the file does not count them, those objects exist for
    /// which there is an array `array` with a number.
    fn new(file: &NetcdfReader, kind: &ObjectKind, array: &str) -> ReadResult<Self> {
        let prefix = kind.prefix;
        let is_there = |number: &usize| file.shape(&format!("{array}{number}")).is_some();
        let count = file
            .dimension(kind.count)
            .unwrap_or_else(|| (1..).take_while(is_there).count());
        let ids = file.numbers(&format!("{prefix}_prop1"))?;
        let mut names = file.texts(&format!("{prefix}_names"))?.into_iter();
        // A file that claims more objects than it can have ends here.
        let count = count.min(file.variable_count());
        let mut list = Self {
            ids: Vec::new(),
            names: Vec::new(),
        };
        for object in 0..count {
            let id = ids.get(object).map_or(object as i32 + 1, |id| *id as i32);
            list.ids.push(id);
            list.names
                .push(names::from_file(&names.next().unwrap_or_default()));
        }
        Ok(list)
    }

    /// Adds the name of an object to the names of groups, if it has one.
    fn add_name(&self, object: usize, group: Group, names: &mut GroupNames) {
        if !self.names[object].is_empty() {
            names.insert(group, self.names[object].clone());
        }
    }
}

/// A side of an element in a side set.
struct Side {
    group: Group,
    /// Index of the element.
    element: usize,
    /// Index of the side.
    side: usize,
}

/// Returns the sides of all side sets, and adds the names of the sets.
fn side_sets(file: &NetcdfReader, names: &mut GroupNames) -> ReadResult<Vec<Side>> {
    let list = ObjectList::new(file, &SIDE_SETS, SIDE_SET_ARRAYS[0])?;
    let mut sides = Vec::new();
    for (set, &id) in list.ids.iter().enumerate() {
        let group = Group::Set(id);
        list.add_name(set, group, names);
        let numbers = |k: usize| file.numbers(&format!("{}{}", SIDE_SET_ARRAYS[k], set + 1));
        for (element, side) in numbers(0)?.into_iter().zip(numbers(1)?) {
            if element < 1.0 || side < 1.0 {
                return Err(missing_element_error());
            }
            sides.push(Side {
                group,
                element: element as usize - 1,
                side: side as usize - 1,
            });
        }
    }
    Ok(sides)
}

/// Reads the sets of nodes of a mesh with `count` nodes.
fn node_sets(file: &NetcdfReader, count: usize) -> ReadResult<Vec<NamedSet>> {
    let list = ObjectList::new(file, &NODE_SETS, NODE_SET_ARRAY)?;
    let mut sets = Vec::new();
    for (set, (id, name)) in list.ids.iter().zip(&list.names).enumerate() {
        let numbers = file.numbers(&format!("{NODE_SET_ARRAY}{}", set + 1))?;
        if numbers.iter().any(|&n| n < 1.0 || n > count as f64) {
            return Err(FileProblem::damaged(
                "has a node set with a node that does not exist",
            ));
        }
        let name = match name.as_str() {
            "" => format!("nodes_{id}"),
            name => name.to_string(),
        };
        let members = sorted_distinct(numbers.into_iter().map(|n| n as u32 - 1));
        sets.push(NamedSet { name, members });
    }
    Ok(sets)
}

/// Returns the error for a side set with an element that does not exist.
fn missing_element_error() -> FileProblem {
    FileProblem::damaged("has a side set with an element or a side that does not exist")
}

/// Reads a mesh of tetrahedra or triangles.
fn simplices(file: &NetcdfReader, blocks: &ObjectList) -> ReadResult<ForeignMesh> {
    let mut foreign = ForeignMesh {
        nodes: nodes(file)?,
        ..ForeignMesh::default()
    };
    // Corners of all elements, in order, which the side sets refer to.
    let mut elements: Vec<(BlockKind, [u32; 4])> = Vec::new();
    for (block, &id) in blocks.ids.iter().enumerate() {
        let group = Group::Physical(id);
        let combination = foreign.combinations.number(&[group]);
        let Some((kind, block_elements)) = read_block(file, block, foreign.nodes.len())? else {
            continue;
        };
        blocks.add_name(block, group, &mut foreign.names[kind.dim()]);
        for nodes in block_elements {
            let [a, b, c, _] = nodes;
            match kind {
                BlockKind::Tet => foreign.tets.push((nodes, combination)),
                BlockKind::Triangle => foreign.triangles.push(([a, b, c], combination)),
                BlockKind::Edge => foreign.edges.push(([a, b], combination)),
                BlockKind::Point => foreign.points.push(([a], combination)),
            }
            elements.push((kind, nodes));
        }
    }
    let is_solid = !foreign.tets.is_empty();
    let face_names = &mut foreign.names[if is_solid { 2 } else { 1 }];
    for Side {
        group,
        element,
        side,
    } in side_sets(file, face_names)?
    {
        let (kind, x) = elements.get(element).ok_or_else(missing_element_error)?;
        let combination = foreign.combinations.number(&[group]);
        // Triangles in space have two faces, and then three edges.
        let (edge, is_face) = match kind {
            BlockKind::Triangle if is_solid => {
                (side.wrapping_sub(SHELL_FACE_COUNT), side < SHELL_FACE_COUNT)
            }
            _ => (side, false),
        };
        match kind {
            BlockKind::Tet if side < 4 => {
                let corners = TETRAHEDRON_SIDES[side].map(|k| x[k]);
                foreign.triangles.push((corners, combination));
            }
            BlockKind::Triangle if is_face => {
                foreign.triangles.push(([x[0], x[1], x[2]], combination));
            }
            BlockKind::Triangle if edge < 3 => {
                let ends = TRIANGLE_SIDES[edge].map(|k| x[k]);
                foreign.edges.push((ends, combination));
            }
            BlockKind::Edge | BlockKind::Point => {}
            _ => return Err(missing_element_error()),
        }
    }
    foreign.node_sets = node_sets(file, foreign.nodes.len())?;
    Ok(foreign)
}

/// Reads the elements of a block; `None` for an empty block.
fn read_block(
    file: &NetcdfReader,
    block: usize,
    node_count: usize,
) -> ReadResult<Option<(BlockKind, Vec<[u32; 4]>)>> {
    let connect = format!("{}{}", ELEMENTS.list, block + 1);
    let Some(shape) = file.shape(&connect) else {
        return Ok(None);
    };
    let [count, size] = shape[..] else {
        let problem = format!("has a block '{connect}' of {} dimensions", shape.len());
        return Err(FileProblem::damaged(problem));
    };
    let name = file.attribute(&connect, ELEMENT_TYPE).unwrap_or_default();
    if count == 0 || size == 0 {
        return Ok(None);
    }
    let kind = block_kind(&name, size)?;
    let corners = file.numbers(&connect)?;
    let mut elements = Vec::new();
    for element in corners.chunks(size).take(count) {
        let mut nodes = [0; 4];
        for (k, slot) in nodes.iter_mut().enumerate().take(kind.dim() + 1) {
            *slot = match element.get(k) {
                Some(&n) if n >= 1.0 && n <= node_count as f64 => n as u32 - 1,
                _ => {
                    return Err(FileProblem::damaged(
                        "has an element with a node that does not exist",
                    ));
                }
            };
        }
        elements.push(nodes);
    }
    Ok(Some((kind, elements)))
}

fn nodes(file: &NetcdfReader) -> ReadResult<Vec<[f64; 3]>> {
    let axes = match file.shape("coord").map(<[usize; 2]>::try_from) {
        // Older files have one array for all axes.
        Some(Ok([axes @ 1..=3, count])) => {
            let coordinates = file.numbers("coord")?;
            let axis = |k: usize| {
                if k < axes {
                    coordinates[k * count..(k + 1) * count].to_vec()
                } else {
                    Vec::new()
                }
            };
            [axis(0), axis(1), axis(2)]
        }
        _ => {
            let [x, y, z] = COORDINATES.map(|axis| file.numbers(axis));
            [x?, y?, z?]
        }
    };
    let coordinate = |k: usize, n: usize| axes[k].get(n).copied().unwrap_or(0.0);
    let count = axes[0].len();
    if axes[1..]
        .iter()
        .any(|axis| !axis.is_empty() && axis.len() != count)
    {
        return Err(FileProblem::damaged(
            "has more coordinates along one axis than along another",
        ));
    }
    Ok((0..count)
        .map(|n| [coordinate(0, n), coordinate(1, n), coordinate(2, n)])
        .collect())
}

fn block_kind(name: &str, nodes: usize) -> ReadResult<BlockKind> {
    let upper = name.to_ascii_uppercase();
    let has_prefix = |prefixes: &[&str]| prefixes.iter().any(|p| upper.starts_with(p));
    match nodes {
        4 | 8 | 10 | 11 | 14 | 15 if has_prefix(&["TET"]) => Ok(BlockKind::Tet),
        3 | 4 | 6 | 7 if has_prefix(&["TRI"]) => Ok(BlockKind::Triangle),
        3 | 6 if has_prefix(&["SHELL"]) => Ok(BlockKind::Triangle),
        2 | 3 if has_prefix(&["BAR", "BEAM", "TRUSS", "EDGE", "LINE", "ROD"]) => {
            Ok(BlockKind::Edge)
        }
        1 if has_prefix(&["SPHERE", "CIRCLE", "POINT", "NODE"]) => Ok(BlockKind::Point),
        _ => Err(FileProblem {
            problem: format!("has elements '{name}' of {nodes} nodes"),
            remedy: "give a mesh of tetrahedra or triangles, of first or second order",
        }),
    }
}
