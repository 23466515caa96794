//! Exodus II: element blocks are regions, side sets surfaces.
//!
//! - `polyhedra`: blocks of cells that are lists of faces
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and appendix A.

mod polyhedra;

use std::collections::BTreeMap;

use super::netcdf::File;
use super::{Fault, Foreign, Found, settle};
use crate::store::AnyMesh;

/// For each side of a tetrahedron, its corners.
const SIDES: [[usize; 3]; 4] = [[0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 1, 2]];

/// What a block's elements are.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Tet,
    Triangle,
    Edge,
}

/// Reads a file.
pub fn read(bytes: &[u8]) -> Found<AnyMesh> {
    let file = File::new(bytes)?;
    let groups = Groups::of(&file)?;
    let of_faces = |block: usize| file.shape(&format!("facconn{}", block + 1)).is_some();
    match (0..groups.ids.len().max(1)).any(of_faces) {
        true => polyhedra::read(&file, groups).map(AnyMesh::SpaceCells),
        false => simplices(&file, groups)?.assembled(),
    }
}

/// What a file says of its blocks and sets.
struct Groups {
    ids: Vec<f64>,
    /// The number of the region that a block is, where that is not its own.
    numbers: BTreeMap<i32, i32>,
    /// Names of regions.
    names: BTreeMap<i32, String>,
    /// Names of blocks, and of side sets by their place below zero, so that none is that of a block.
    face_names: BTreeMap<i32, String>,
}

impl Groups {
    fn of(file: &File) -> Found<Self> {
        let mut groups = Self {
            ids: file.numbers("eb_prop1")?,
            numbers: BTreeMap::new(),
            names: BTreeMap::new(),
            face_names: BTreeMap::new(),
        };
        let called = file.texts("eb_names")?.into_iter().enumerate();
        let names: BTreeMap<i32, String> = called
            .map(|(block, name)| (groups.number(block), name))
            .filter(|(_, name)| !name.is_empty())
            .collect();
        let sets = (1..).zip(file.texts("ss_names")?);
        let sets = sets.map(|(set, name): (i32, _)| (-set, name));
        groups.face_names = names.clone().into_iter().chain(sets).collect();
        (groups.numbers, groups.names) = settle(names);
        Ok(groups)
    }

    /// The number of a block.
    fn number(&self, block: usize) -> i32 {
        let id = self.ids.get(block);
        id.map_or(block as i32 + 1, |id| *id as i32)
    }

    /// The region that it is.
    fn region(&self, block: usize) -> i32 {
        let number = self.number(block);
        self.numbers.get(&number).copied().unwrap_or(number)
    }
}

/// The sides of each side set, in order: the numbers of the set, of the element and of its side, from 1 on.
fn sides(file: &File) -> Found<Vec<(i32, usize, usize)>> {
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
fn stray() -> Fault {
    Fault::damaged("has a side set of elements that it does not have")
}

/// A mesh of tetrahedra or triangles.
fn simplices(file: &File, groups: Groups) -> Found<Foreign> {
    let mut foreign = Foreign {
        nodes: nodes(file)?,
        ..Foreign::default()
    };
    // Corners of all elements, in order, for the sides of sets.
    let mut elements: Vec<(Kind, [u32; 4])> = Vec::new();
    for block in 0.. {
        let connect = format!("connect{}", block + 1);
        let Some(shape) = file.shape(&connect) else {
            break;
        };
        let &[count, size] = shape else {
            return Err(Fault::damaged(format!(
                "has a block '{connect}' of {} dimensions",
                shape.len()
            )));
        };
        let kind = kind(
            file.attribute(&connect, "elem_type").unwrap_or_default(),
            size,
        )?;
        let corners = file.numbers(&connect)?;
        let region = groups.region(block);
        for element in corners.chunks(size).take(count) {
            let corner = |k: usize| match element.get(k) {
                Some(&n) if n >= 1.0 && n <= foreign.nodes.len() as f64 => Ok(n as u32 - 1),
                _ => Err(Fault::damaged(
                    "has an element of nodes that it does not have",
                )),
            };
            let mut all = [0; 4];
            let count = match kind {
                Kind::Tet => 4,
                Kind::Triangle => 3,
                Kind::Edge => 2,
            };
            for (k, place) in all.iter_mut().enumerate().take(count) {
                *place = corner(k)?;
            }
            let [a, b, c, _] = all;
            match kind {
                Kind::Tet => foreign.tets.push((all, region)),
                Kind::Triangle => foreign.triangles.push(([a, b, c], region)),
                Kind::Edge => foreign.edges.push(([a, b], groups.number(block))),
            }
            elements.push((kind, all));
        }
    }
    for (set, of, side) in sides(file)? {
        let element = of.checked_sub(1).and_then(|at| elements.get(at));
        let (kind, x) = element.ok_or_else(stray)?;
        let side = side.wrapping_sub(1);
        match kind {
            Kind::Tet if side < 4 => {
                foreign.triangles.push((SIDES[side].map(|k| x[k]), -set));
            }
            Kind::Triangle if side < 3 => {
                let edge = [x[side], x[(side + 1) % 3]];
                foreign.edges.push((edge, -set));
            }
            _ => {}
        }
    }
    foreign.names = groups.names;
    foreign.face_names = groups.face_names;
    Ok(foreign)
}

fn nodes(file: &File) -> Found<Vec<[f64; 3]>> {
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
        return Err(Fault::damaged(
            "has more coordinates along one axis than along another",
        ));
    }
    Ok((0..count).map(|n| [at(0, n), at(1, n), at(2, n)]).collect())
}

fn kind(name: &str, nodes: usize) -> Found<Kind> {
    let upper = name.to_ascii_uppercase();
    let is = |prefixes: &[&str]| prefixes.iter().any(|p| upper.starts_with(p));
    match nodes {
        4 | 10 if is(&["TET"]) => Ok(Kind::Tet),
        3 | 6 if is(&["TRI"]) => Ok(Kind::Triangle),
        2 | 3 if is(&["BAR", "BEAM", "TRUSS", "EDGE", "LINE"]) => Ok(Kind::Edge),
        _ => Err(Fault {
            problem: format!("holds elements '{name}' of {nodes} nodes"),
            remedy: "give a mesh of tetrahedra or triangles, of first or second order",
        }),
    }
}
