//! Reads Exodus II files: element blocks become regions, side sets become surfaces.
//!
//! - `polyhedra`: blocks of cells that are lists of faces
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and
//! appendix A.

mod polyhedra;

use std::collections::BTreeMap;

use super::netcdf::NetcdfReader;
use super::{FileProblem, ForeignMesh, ReadResult, assign_regions};
use crate::store::AnyMesh;

/// The corners of each side of a tetrahedron.
const TET_SIDE_CORNERS: [[usize; 3]; 4] = [[0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 1, 2]];

/// Kind of the elements of a block.
#[derive(Clone, Copy, PartialEq)]
enum BlockKind {
    Tet,
    Triangle,
    Edge,
}

/// Reads a mesh from the bytes of a file.
pub fn read(bytes: &[u8]) -> ReadResult<AnyMesh> {
    let file = NetcdfReader::new(bytes)?;
    let groups = BlockGroups::from_file(&file)?;
    let has_face_lists = |block: usize| file.shape(&format!("facconn{}", block + 1)).is_some();
    if (0..groups.block_ids.len().max(1)).any(has_face_lists) {
        polyhedra::read(&file, groups).map(AnyMesh::Polyhedra)
    } else {
        simplices(&file, groups)?.into_mesh()
    }
}

/// Names and numbers of the blocks and side sets of a file.
struct BlockGroups {
    block_ids: Vec<f64>,
    /// Region number of a block, where it differs from the block number.
    region_numbers: BTreeMap<i32, i32>,
    /// Names of regions.
    region_names: BTreeMap<i32, String>,
    /// Names of blocks, and of side sets under negative numbers, so that they differ from block
    /// numbers.
    face_names: BTreeMap<i32, String>,
}

impl BlockGroups {
    fn from_file(file: &NetcdfReader) -> ReadResult<Self> {
        let mut groups = Self {
            block_ids: file.numbers("eb_prop1")?,
            region_numbers: BTreeMap::new(),
            region_names: BTreeMap::new(),
            face_names: BTreeMap::new(),
        };
        let names = file.texts("eb_names")?.into_iter().enumerate();
        let names: BTreeMap<i32, String> = names
            .map(|(block, name)| (groups.block_number(block), name))
            .filter(|(_, name)| !name.is_empty())
            .collect();
        let sets = (1..).zip(file.texts("ss_names")?);
        let sets = sets.map(|(set, name): (i32, _)| (-set, name));
        groups.face_names = names.clone().into_iter().chain(sets).collect();
        (groups.region_numbers, groups.region_names) = assign_regions(names);
        Ok(groups)
    }

    /// Returns the number of a block.
    fn block_number(&self, block: usize) -> i32 {
        let id = self.block_ids.get(block);
        id.map_or(block as i32 + 1, |id| *id as i32)
    }

    /// Returns the region of a block.
    fn region(&self, block: usize) -> i32 {
        let number = self.block_number(block);
        self.region_numbers.get(&number).copied().unwrap_or(number)
    }
}

/// Returns the sides of all side sets, in order: the numbers of the set, the element and its side,
/// all from 1.
fn side_set_sides(file: &NetcdfReader) -> ReadResult<Vec<(i32, usize, usize)>> {
    let mut sides = Vec::new();
    for set in 1i32.. {
        let [element_array, side_array] = ["elem", "side"].map(|part| format!("{part}_ss{set}"));
        if file.shape(&element_array).is_none() {
            break;
        }
        let pairs = file
            .numbers(&element_array)?
            .into_iter()
            .zip(file.numbers(&side_array)?);
        sides.extend(pairs.map(|(element, side)| (set, element as usize, side as usize)));
    }
    Ok(sides)
}

/// Returns the error for a side set with an element that does not exist.
fn missing_element_error() -> FileProblem {
    FileProblem::damaged("has a side set with an element that does not exist")
}

/// Reads a mesh of tetrahedra or triangles.
fn simplices(file: &NetcdfReader, groups: BlockGroups) -> ReadResult<ForeignMesh> {
    let mut foreign = ForeignMesh {
        nodes: nodes(file)?,
        ..ForeignMesh::default()
    };
    // Corners of all elements, in order, which the side sets refer to.
    let mut elements: Vec<(BlockKind, [u32; 4])> = Vec::new();
    for block in 0.. {
        let connect = format!("connect{}", block + 1);
        let Some(shape) = file.shape(&connect) else {
            break;
        };
        let &[count, size] = shape else {
            return Err(FileProblem::damaged(format!(
                "has a block '{connect}' of {} dimensions",
                shape.len()
            )));
        };
        let kind = block_kind(
            file.attribute(&connect, "elem_type").unwrap_or_default(),
            size,
        )?;
        let corners = file.numbers(&connect)?;
        let region = groups.region(block);
        for element in corners.chunks(size).take(count) {
            let corner = |k: usize| match element.get(k) {
                Some(&n) if n >= 1.0 && n <= foreign.nodes.len() as f64 => Ok(n as u32 - 1),
                _ => Err(FileProblem::damaged(
                    "has an element with a node that does not exist",
                )),
            };
            let mut nodes = [0; 4];
            let count = match kind {
                BlockKind::Tet => 4,
                BlockKind::Triangle => 3,
                BlockKind::Edge => 2,
            };
            for (k, slot) in nodes.iter_mut().enumerate().take(count) {
                *slot = corner(k)?;
            }
            let [a, b, c, _] = nodes;
            match kind {
                BlockKind::Tet => foreign.tets.push((nodes, region)),
                BlockKind::Triangle => foreign.triangles.push(([a, b, c], region)),
                BlockKind::Edge => foreign.edges.push(([a, b], groups.block_number(block))),
            }
            elements.push((kind, nodes));
        }
    }
    for (set, element_number, side) in side_set_sides(file)? {
        let element = element_number.checked_sub(1).and_then(|i| elements.get(i));
        let (kind, x) = element.ok_or_else(missing_element_error)?;
        let side = side.wrapping_sub(1);
        match kind {
            BlockKind::Tet if side < 4 => {
                foreign
                    .triangles
                    .push((TET_SIDE_CORNERS[side].map(|k| x[k]), -set));
            }
            BlockKind::Triangle if side < 3 => {
                let edge = [x[side], x[(side + 1) % 3]];
                foreign.edges.push((edge, -set));
            }
            _ => {}
        }
    }
    foreign.names = groups.region_names;
    foreign.face_names = groups.face_names;
    Ok(foreign)
}

fn nodes(file: &NetcdfReader) -> ReadResult<Vec<[f64; 3]>> {
    let axes = match file.shape("coord") {
        // Older files have one array for all axes.
        Some(&[axes @ 1..=3, count]) => {
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
        _ => [
            file.numbers("coordx")?,
            file.numbers("coordy")?,
            file.numbers("coordz")?,
        ],
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
        4 | 10 if has_prefix(&["TET"]) => Ok(BlockKind::Tet),
        3 | 6 if has_prefix(&["TRI"]) => Ok(BlockKind::Triangle),
        2 | 3 if has_prefix(&["BAR", "BEAM", "TRUSS", "EDGE", "LINE"]) => Ok(BlockKind::Edge),
        _ => Err(FileProblem {
            problem: format!("has elements '{name}' of {nodes} nodes"),
            remedy: "give a mesh of tetrahedra or triangles, of first or second order",
        }),
    }
}
