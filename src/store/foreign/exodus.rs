//! Exodus II: element blocks are regions, side sets surfaces.
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and appendix A.

use std::collections::BTreeMap;

use super::netcdf::File;
use super::{Fault, Foreign, Found, settle};

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
pub fn read(bytes: &[u8]) -> Found<Foreign> {
    let file = File::new(bytes)?;
    let mut foreign = Foreign {
        nodes: nodes(&file)?,
        ..Foreign::default()
    };
    let ids = file.numbers("eb_prop1")?;
    let called = file.texts("eb_names")?;
    let group = |block: usize| ids.get(block).map_or(block as i32 + 1, |id| *id as i32);
    let names: BTreeMap<i32, String> = (called.into_iter().enumerate())
        .map(|(block, name)| (group(block), name))
        .filter(|(_, name)| !name.is_empty())
        .collect();
    // Sets have numbers below zero, so that none is that of a block.
    let sets = file.texts("ss_names")?;
    let sets = (1..).zip(sets).map(|(set, name): (i32, _)| (-set, name));
    foreign.face_names = names.clone().into_iter().chain(sets).collect();
    let (numbers, names) = settle(names);
    foreign.names = names;
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
        let region = group(block);
        let region = numbers.get(&region).copied().unwrap_or(region);
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
                Kind::Edge => foreign.edges.push(([a, b], group(block))),
            }
            elements.push((kind, all));
        }
    }
    for set in 1i32.. {
        let [of, side] = ["elem", "side"].map(|what| format!("{what}_ss{set}"));
        if file.shape(&of).is_none() {
            break;
        }
        let sides = file.numbers(&side)?;
        for (of, side) in file.numbers(&of)?.into_iter().zip(sides) {
            let element = elements.get((of as usize).wrapping_sub(1));
            let Some((kind, x)) = element else {
                return Err(Fault::damaged(
                    "has a side set of elements that it does not have",
                ));
            };
            let side = (side as usize).wrapping_sub(1);
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
    }
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
