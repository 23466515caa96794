//! Cells of any shape: each a list of faces, each of them a list of nodes and in the file once. The side of a
//! cell that is in a side set has the place in that list as its number.

use super::{
    Block, ExodusMesh, NFACED, NSIDED, PartCounts, RegionCells, SideSet, element_numbers,
    order_by_region,
};
use crate::export::meshers::groups::{FaceGroup, face_from_below, face_groups};
use crate::model::reservoir::Model;

/// The mesh.
pub fn exodus_mesh(model: &Model) -> ExodusMesh {
    let mesh = &model.mesh;
    let lists = mesh.faces_of_cells();
    let (order, parts) = order_by_region(model);
    let one_more = |n: &u32| *n as i32 + 1;
    let of_region = |RegionCells {
                         name,
                         number,
                         cells,
                     }| {
        let own = || order[cells.clone()].iter().map(|&c| lists.get(c as usize));
        Block {
            name,
            number,
            element_type: NFACED,
            connectivity: own().flatten().map(one_more).collect(),
            part_counts: PartCounts::PerElement(own().map(|faces| faces.len() as i32).collect()),
            has_cell_values: true,
        }
    };
    let blocks = parts.into_iter().map(of_region).collect();
    let sizes = (0..mesh.faces.len()).map(|f| mesh.faces.get(f).len() as i32);
    let faces = Block {
        name: "faces".into(),
        number: 1,
        element_type: NSIDED,
        connectivity: mesh.faces.items.iter().map(one_more).collect(),
        part_counts: PartCounts::PerElement(sizes.collect()),
        has_cell_values: false,
    };
    let (places, rises) = (element_numbers(&order), model.second_cell_is_upper());
    let set = |group: FaceGroup| {
        let mut set = SideSet::new(&group.name, group.number);
        for f in group.faces {
            let (cell, ring) = face_from_below(model, &rises, f);
            let at = lists.get(cell as usize).iter().position(|&own| own == f);
            let side = at.unwrap_or(0) as i32 + 1;
            set.add(places[cell as usize], side, ring.iter().map(one_more));
        }
        set.with_unique_nodes()
    };
    ExodusMesh {
        dim: 3,
        points: mesh.nodes.clone(),
        blocks,
        faces: Some(faces),
        sets: face_groups(model).into_iter().map(set).collect(),
        cell_order: order,
    }
}
