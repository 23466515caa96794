//! Exodus II: element blocks are regions, side sets surfaces.
//!
//! - `polyhedra`: blocks of cells that are lists of faces
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and appendix A.

mod polyhedra;

use std::collections::BTreeMap;

use super::netcdf::NetcdfReader;
use super::{FileProblem, ForeignMesh, ReadResult, assign_regions};
use crate::store::AnyMesh;

/// For each side of a tetrahedron, its corners.
const TET_SIDE_CORNERS: [[usize; 3]; 4] = [[0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 1, 2]];

/// What a block's elements are.
#[derive(Clone, Copy, PartialEq)]
enum BlockKind {
    Tet,
    Triangle,
    Edge,
}

/// Reads a file.
pub fn read(bytes: &[u8]) -> ReadResult<AnyMesh> {
    let file = NetcdfReader::new(bytes)?;
    let groups = BlockGroups::from_file(&file)?;
    let of_faces = |block: usize| file.shape(&format!("facconn{}", block + 1)).is_some();
    match (0..groups.block_ids.len().max(1)).any(of_faces) {
        true => polyhedra::read(&file, groups).map(AnyMesh::Polyhedra),
        false => simplices(&file, groups)?.into_mesh(),
    }
}

/// What a file says of its blocks and sets.
struct BlockGroups {
    block_ids: Vec<f64>,
    /// The number of the region that a block is, where that is not its own.
    region_numbers: BTreeMap<i32, i32>,
    /// Names of regions.
    region_names: BTreeMap<i32, String>,
    /// Names of blocks, and of side sets by their place below zero, so that none is that of a block.
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
        let called = file.texts("eb_names")?.into_iter().enumerate();
        let names: BTreeMap<i32, String> = called
            .map(|(block, name)| (groups.block_number(block), name))
            .filter(|(_, name)| !name.is_empty())
            .collect();
        let sets = (1..).zip(file.texts("ss_names")?);
        let sets = sets.map(|(set, name): (i32, _)| (-set, name));
        groups.face_names = names.clone().into_iter().chain(sets).collect();
        (groups.region_numbers, groups.region_names) = assign_regions(names);
        Ok(groups)
    }

    /// The number of a block.
    fn block_number(&self, block: usize) -> i32 {
        let id = self.block_ids.get(block);
        id.map_or(block as i32 + 1, |id| *id as i32)
    }

    /// The region that it is.
    fn region(&self, block: usize) -> i32 {
        let number = self.block_number(block);
        self.region_numbers.get(&number).copied().unwrap_or(number)
    }
}

/// The sides of each side set, in order: the numbers of the set, of the element and of its side, from 1 on.
fn side_set_sides(file: &NetcdfReader) -> ReadResult<Vec<(i32, usize, usize)>> {
    let mut sides = Vec::new();
    for set in 1i32.. {
        let [of, side] = ["elem", "side"].map(|what| format!("{what}_ss{set}"));
        if file.shape(&of).is_none() {
            break;
        }
        let both = file.numbers(&of)?.into_iter().zip(file.numbers(&side)?);
        sides.extend(both.map(|(of, side)| (set, of as usize, side as usize)));
    }
    Ok(sides)
}

/// A side set of elements that there are not.
fn missing_element_error() -> FileProblem {
    FileProblem::damaged("has a side set of elements that it does not have")
}

/// A mesh of tetrahedra or triangles.
fn simplices(file: &NetcdfReader, groups: BlockGroups) -> ReadResult<ForeignMesh> {
    let mut foreign = ForeignMesh {
        nodes: nodes(file)?,
        ..ForeignMesh::default()
    };
    // Corners of all elements, in order, for the sides of sets.
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
                    "has an element of nodes that it does not have",
                )),
            };
            let mut all = [0; 4];
            let count = match kind {
                BlockKind::Tet => 4,
                BlockKind::Triangle => 3,
                BlockKind::Edge => 2,
            };
            for (k, place) in all.iter_mut().enumerate().take(count) {
                *place = corner(k)?;
            }
            let [a, b, c, _] = all;
            match kind {
                BlockKind::Tet => foreign.tets.push((all, region)),
                BlockKind::Triangle => foreign.triangles.push(([a, b, c], region)),
                BlockKind::Edge => foreign.edges.push(([a, b], groups.block_number(block))),
            }
            elements.push((kind, all));
        }
    }
    for (set, of, side) in side_set_sides(file)? {
        let element = of.checked_sub(1).and_then(|at| elements.get(at));
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
            let all = file.numbers("coord")?;
            let axis = |k: usize| match k < axes {
                true => all[k * count..(k + 1) * count].to_vec(),
                false => Vec::new(),
            };
            [axis(0), axis(1), axis(2)]
        }
        _ => [
            file.numbers("coordx")?,
            file.numbers("coordy")?,
            file.numbers("coordz")?,
        ],
    };
    let at = |k: usize, n: usize| axes[k].get(n).copied().unwrap_or(0.0);
    let count = axes[0].len();
    if axes[1..]
        .iter()
        .any(|axis| !axis.is_empty() && axis.len() != count)
    {
        return Err(FileProblem::damaged(
            "has more coordinates along one axis than along another",
        ));
    }
    Ok((0..count).map(|n| [at(0, n), at(1, n), at(2, n)]).collect())
}

fn block_kind(name: &str, nodes: usize) -> ReadResult<BlockKind> {
    let upper = name.to_ascii_uppercase();
    let is = |prefixes: &[&str]| prefixes.iter().any(|p| upper.starts_with(p));
    match nodes {
        4 | 10 if is(&["TET"]) => Ok(BlockKind::Tet),
        3 | 6 if is(&["TRI"]) => Ok(BlockKind::Triangle),
        2 | 3 if is(&["BAR", "BEAM", "TRUSS", "EDGE", "LINE"]) => Ok(BlockKind::Edge),
        _ => Err(FileProblem {
            problem: format!("holds elements '{name}' of {nodes} nodes"),
            remedy: "give a mesh of tetrahedra or triangles, of first or second order",
        }),
    }
}
