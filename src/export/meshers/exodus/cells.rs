//! Converts cells of any shape: each cell is a list of faces, and each face a list of nodes, stored
//! once. In a side set, the number of a side is the position of the face in the list of its cell.

use super::{
    Block, ExodusMesh, PartCounts, RegionCells, SideSet, element_numbers, order_by_region,
};
use crate::export::meshers::groups::FaceGroup;
use crate::export::names::ExportNames;
use crate::mesh_file::formats::exodus::{NFACED, NSIDED};
use crate::model::reservoir::Model;

/// Returns the mesh with the cells of a model.
pub fn exodus_mesh(model: &Model, names: &ExportNames) -> ExodusMesh {
    let mesh = &model.mesh;
    let lists = mesh.faces_of_cells();
    let (order, regions) = order_by_region(model, names);
    let one_based = |n: &u32| *n as i32 + 1;
    let region_block = |RegionCells {
                            name,
                            number,
                            cells,
                        }| {
        let face_lists = || order[cells.clone()].iter().map(|&c| lists.get(c as usize));
        Block {
            name,
            number,
            element_type: NFACED,
            connectivity: face_lists().flatten().map(one_based).collect(),
            part_counts: PartCounts::PerElement(
                face_lists().map(|faces| faces.len() as i32).collect(),
            ),
            has_cell_values: true,
        }
    };
    let blocks = regions.into_iter().map(region_block).collect();
    let sizes = (0..mesh.faces.len()).map(|f| mesh.faces.get(f).len() as i32);
    let faces = Block {
        name: "faces".into(),
        number: 1,
        element_type: NSIDED,
        connectivity: mesh.faces.items.iter().map(one_based).collect(),
        part_counts: PartCounts::PerElement(sizes.collect()),
        has_cell_values: false,
    };
    let elements = element_numbers(&order);
    let side_set = |group: FaceGroup| {
        let mut sides = SideSet::new(&group.name, group.number);
        for f in group.faces {
            let (cell, ring) = names.faces.side(model, f);
            let index = lists.get(cell as usize).iter().position(|&face| face == f);
            let side = index.unwrap_or(0) as i32 + 1;
            sides.add(elements[cell as usize], side, ring.iter().map(one_based));
        }
        sides.with_unique_nodes()
    };
    ExodusMesh {
        dim: 3,
        points: mesh.nodes.clone(),
        blocks,
        faces: Some(faces),
        sets: names.faces.groups().into_iter().map(side_set).collect(),
        node_sets: (names.node_sets.iter())
            .map(|set| {
                (
                    set.name.clone(),
                    set.members.iter().map(one_based).collect(),
                )
            })
            .collect(),
        cell_order: order,
    }
}
