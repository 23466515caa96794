//! Tetrahedra or triangles. Between the two sides of a surface along which the mesh is torn, wedges of no
//! thickness, in a block that has its name.

use super::{Block, Grid, Region, Set, Size, by_regions, places};
use crate::export::meshers::groups::Named;
use crate::export::meshers::simplices::Simplices;
use crate::model::reservoir::Model;

/// The side of an element opposite its corner k, in space and in the plane.
const SIDE_OPPOSITE: [[i32; 4]; 2] = [[2, 3, 1, 4], [2, 3, 1, 0]];
/// A triangle that is not in the plane z = 0 is a shell, whose first two sides are its faces.
const FACES_OF_SHELL: i32 = 2;

/// The mesh.
pub fn grid(model: &Model, mesh: &Simplices) -> Grid {
    let flat = mesh.nodes.iter().all(|p| p[2] == mesh.nodes[0][2]);
    let dim = if mesh.size == 3 && flat { 2 } else { 3 };
    let (order, parts) = by_regions(model);
    let kind = match (mesh.size, mesh.is_quadratic()) {
        (4, false) => "TETRA",
        (4, true) => "TETRA10",
        (_, false) => "TRI3",
        (_, true) => "TRI6",
    };
    let corners = mesh.size;
    let edges = corners * (corners - 1) / 2;
    let size = corners + if mesh.is_quadratic() { edges } else { 0 };
    let of_region = |Region {
                         name,
                         number,
                         cells,
                     }| {
        let mut parts = Vec::with_capacity(cells.len() * size);
        for &cell in &order[cells] {
            mesh.visit(mesh.get(cell as usize), |n| parts.push(n as i32 + 1));
        }
        Block {
            name,
            number,
            kind,
            parts,
            size: Size::All(size),
            of_cells: true,
        }
    };
    let mut blocks: Vec<Block> = parts.into_iter().map(of_region).collect();
    let last = blocks.iter().map(|block| block.number).max().unwrap_or(0);
    for (number, torn) in (last + 1..).zip(&mesh.torn) {
        let nodes = torn.pairs.iter().flat_map(|pair| pair.as_flattened());
        blocks.push(Block {
            name: torn.name.clone(),
            number,
            kind: "WEDGE",
            parts: nodes.map(|&n| n as i32 + 1).collect(),
            size: Size::All(6),
            of_cells: false,
        });
    }
    let places = places(&order);
    Grid {
        dim,
        points: (0..mesh.node_count()).map(|i| mesh.point(i)).collect(),
        order,
        blocks,
        faces: None,
        sets: (mesh.named.iter())
            .map(|named| set(mesh, named, &places, dim))
            .collect(),
    }
}

/// `places` has each cell's number among the elements.
fn set(mesh: &Simplices, named: &Named, places: &[i32], dim: usize) -> Set {
    let opposite = SIDE_OPPOSITE[usize::from(mesh.size == 3)];
    let shell = if mesh.size == 3 && dim == 3 {
        FACES_OF_SHELL
    } else {
        0
    };
    let mut set = Set::new(&named.name, named.number);
    for (i, &cell) in named.cells.iter().enumerate() {
        let side = named.sides.get(i);
        let corners = mesh.get(cell as usize);
        let corner = corners.iter().position(|n| !side.contains(n));
        let number = opposite[corner.unwrap_or(0)] + shell;
        let mut nodes = Vec::new();
        mesh.visit(side, |n| nodes.push(n as i32 + 1));
        set.add(places[cell as usize], number, nodes);
    }
    set.done()
}
