//! Cells of any shape: each a list of faces, each of them a list of nodes and in the file once. The side of a
//! cell that is in a side set has the place in that list as its number.

use super::{Block, Grid, NFACED, NSIDED, Region, Set, Size, by_regions, places};
use crate::export::meshers::groups::{Group, groups, seen_from_below};
use crate::model::reservoir::Model;

/// The mesh.
pub fn grid(model: &Model) -> Grid {
    let mesh = &model.mesh;
    let lists = mesh.faces_of_cells();
    let (order, parts) = by_regions(model);
    let one_more = |n: &u32| *n as i32 + 1;
    let of_region = |Region {
                         name,
                         number,
                         cells,
                     }| {
        let own = || order[cells.clone()].iter().map(|&c| lists.get(c as usize));
        Block {
            name,
            number,
            kind: NFACED,
            parts: own().flatten().map(one_more).collect(),
            size: Size::Each(own().map(|faces| faces.len() as i32).collect()),
            of_cells: true,
        }
    };
    let blocks = parts.into_iter().map(of_region).collect();
    let sizes = (0..mesh.faces.len()).map(|f| mesh.faces.get(f).len() as i32);
    let faces = Block {
        name: "faces".into(),
        number: 1,
        kind: NSIDED,
        parts: mesh.faces.items.iter().map(one_more).collect(),
        size: Size::Each(sizes.collect()),
        of_cells: false,
    };
    let (places, rises) = (places(&order), model.rises());
    let set = |group: Group| {
        let mut set = Set::new(&group.name, group.number);
        for f in group.faces {
            let (cell, ring) = seen_from_below(model, &rises, f);
            let at = lists.get(cell as usize).iter().position(|&own| own == f);
            let side = at.unwrap_or(0) as i32 + 1;
            set.add(places[cell as usize], side, ring.iter().map(one_more));
        }
        set.done()
    };
    Grid {
        dim: 3,
        points: mesh.nodes.clone(),
        blocks,
        faces: Some(faces),
        sets: groups(model).into_iter().map(set).collect(),
        order,
    }
}
