//! Converts tetrahedra or triangles. Between the two sides of a surface along which the mesh is
//! split, wedges without thickness are in a block with the name of the surface.

use super::{
    Block, ExodusMesh, PartCounts, RegionCells, SideSet, element_numbers, order_by_region,
};
use crate::export::meshers::groups::NamedSides;
use crate::export::meshers::simplices::SimplexMesh;
use crate::export::names::ExportNames;
use crate::mesh_file::formats::exodus::{SHELL_FACE_COUNT, TETRAHEDRON_SIDES, TRIANGLE_SIDES};
use crate::model::reservoir::Model;

/// Returns the mesh with the simplices of a model.
pub fn exodus_mesh(model: &Model, names: &ExportNames, mesh: &SimplexMesh) -> ExodusMesh {
    let is_flat = mesh.nodes.iter().all(|p| p[2] == mesh.nodes[0][2]);
    let dim = if mesh.corner_count == 3 && is_flat {
        2
    } else {
        3
    };
    let (order, regions) = order_by_region(model, names);
    let kind = match (mesh.corner_count, mesh.is_quadratic()) {
        (4, false) => "TETRA",
        (4, true) => "TETRA10",
        (_, false) => "TRI3",
        (_, true) => "TRI6",
    };
    let corners = mesh.corner_count;
    let edges = corners * (corners - 1) / 2;
    let size = corners + if mesh.is_quadratic() { edges } else { 0 };
    let region_block = |RegionCells {
                            name,
                            number,
                            cells,
                        }| {
        let mut nodes = Vec::with_capacity(cells.len() * size);
        for &cell in &order[cells] {
            mesh.visit_nodes(mesh.get(cell as usize), |n| nodes.push(n as i32 + 1));
        }
        Block {
            name,
            number,
            element_type: kind,
            connectivity: nodes,
            part_counts: PartCounts::Uniform(size),
            has_cell_values: true,
        }
    };
    let mut blocks: Vec<Block> = regions.into_iter().map(region_block).collect();
    let last = blocks.iter().map(|block| block.number).max().unwrap_or(0);
    for (number, torn) in (last + 1..).zip(mesh.elements_between()) {
        let nodes = torn.face_pairs.iter().flat_map(|pair| pair.as_flattened());
        blocks.push(Block {
            name: torn.name.clone(),
            number,
            element_type: "WEDGE",
            connectivity: nodes.map(|&n| n as i32 + 1).collect(),
            part_counts: PartCounts::Uniform(6),
            has_cell_values: false,
        });
    }
    let elements = element_numbers(&order);
    ExodusMesh {
        dim,
        points: (0..mesh.node_count()).map(|i| mesh.point(i)).collect(),
        cell_order: order,
        blocks,
        faces: None,
        sets: (mesh.named_sides.iter())
            .map(|group| side_set(mesh, group, &elements, dim))
            .collect(),
        node_sets: (mesh.node_sets.iter())
            .map(|set| {
                (
                    set.name.clone(),
                    set.members.iter().map(|&n| n as i32 + 1).collect(),
                )
            })
            .collect(),
    }
}

/// Returns the side set of a group. `elements` has the element number of each cell.
fn side_set(mesh: &SimplexMesh, group: &NamedSides, elements: &[i32], dim: usize) -> SideSet {
    let has_triangles = mesh.corner_count == 3;
    let shell_offset = if has_triangles && dim == 3 {
        SHELL_FACE_COUNT
    } else {
        0
    };
    let mut set = SideSet::new(&group.name, group.number);
    for (i, &cell) in group.cells.iter().enumerate() {
        let side = group.sides.get(i);
        let corners = mesh.get(cell as usize);
        let corner = corners.iter().position(|n| !side.contains(n)).unwrap_or(0);
        let opposite = if has_triangles {
            TRIANGLE_SIDES.iter().position(|s| !s.contains(&corner))
        } else {
            TETRAHEDRON_SIDES.iter().position(|s| !s.contains(&corner))
        };
        let number = (opposite.unwrap_or(0) + 1 + shell_offset) as i32;
        let mut nodes = Vec::new();
        mesh.visit_nodes(side, |n| nodes.push(n as i32 + 1));
        set.add(elements[cell as usize], number, nodes);
    }
    set.with_unique_nodes()
}
