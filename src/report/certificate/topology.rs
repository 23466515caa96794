//! Euler numbers of the parts of a mesh, and the nodes at which parts touch that are no neighbours in
//! the image.

use super::labelled_cells::LabelledCells;
use super::mesh_parts::{MeshParts, PartFacet};
use super::voxel_parts::VoxelParts;
use crate::geometry::{NONE, sorted, sorted_distinct};

/// A node that belongs to cells of parts that are nowhere neighbours in the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PinchedNode {
    /// The node.
    pub node: u32,
    /// The two parts with the smallest numbers among those that are no neighbours.
    pub parts: [u32; 2],
}

/// Returns the Euler number of the surface of each part (in 2-D of the part), counting nodes and edges
/// once at which the surface touches itself; `None` for parts without cells.
pub fn euler_numbers<const D: usize>(
    cells: &LabelledCells<'_, D>,
    mesh: &MeshParts<D>,
    part_count: usize,
) -> Vec<Option<i64>> {
    // Vertices and edges as pairs and triples of numbers, a part first.
    let (mut nodes, mut edges) = (Vec::<[u32; 2]>::new(), Vec::<[u32; 3]>::new());
    let mut sums: Vec<Option<i64>> = vec![None; part_count];
    if D == 2 {
        for face in 0..cells.face_count {
            let pair = cells.cells_of_face(face).map(|cell| match cell {
                NONE => NONE,
                cell => mesh.part_of_cell[cell as usize],
            });
            for (side, &part) in pair.iter().enumerate() {
                if part == NONE || side == 1 && part == pair[0] {
                    continue;
                }
                let sum = sums[part as usize].get_or_insert(0);
                *sum -= 1;
                cells.for_each_facet(face, |facet| {
                    nodes.extend(facet.map(|node| [part, node]));
                });
            }
        }
        for &part in mesh.part_of_cell.iter().filter(|part| **part != NONE) {
            *sums[part as usize].get_or_insert(0) += 1;
        }
    } else {
        for facets in mesh.facets.chunk_by(|a, b| a.face == b.face) {
            let parts = facets[0].parts;
            if parts[0] == parts[1] {
                continue;
            }
            let face_edges = edges_of_face(facets);
            for part in parts.into_iter().filter(|part| *part != NONE) {
                *sums[part as usize].get_or_insert(0) += 1;
                nodes.extend(facets.iter().flat_map(|f| f.nodes.map(|node| [part, node])));
                edges.extend(face_edges.iter().map(|[a, b]| [part, *a, *b]));
            }
        }
    }
    for [part, _] in sorted_distinct(nodes) {
        *sums[part as usize].get_or_insert(0) += 1;
    }
    for [part, ..] in sorted_distinct(edges) {
        *sums[part as usize].get_or_insert(0) -= 1;
    }
    sums
}

/// Returns the edges of a face, given its facets. The edges between two facets are none: those of two faces may
/// join the same nodes.
fn edges_of_face<const D: usize>(facets: &[PartFacet<D>]) -> Vec<[u32; 2]> {
    let edges = facets
        .iter()
        .flat_map(|facet| (0..D).map(|k| sorted([facet.nodes[k], facet.nodes[(k + 1) % D]])));
    let mut edges: Vec<[u32; 2]> = edges.collect();
    edges.sort_unstable();
    let once = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1);
    once.map(|same| same[0]).collect()
}

/// Returns the nodes at which parts touch that are nowhere neighbours in the image, in their order.
pub fn pinched_nodes<const D: usize>(
    mesh: &MeshParts<D>,
    voxels: &VoxelParts<'_, D>,
) -> Vec<PinchedNode> {
    let mut pairs: Vec<[u32; 2]> = Vec::new();
    for facet in &mesh.facets {
        for part in facet.parts.into_iter().filter(|part| *part != NONE) {
            pairs.extend(facet.nodes.map(|node| [node, part]));
        }
    }
    let pairs = sorted_distinct(pairs);
    let mut pinched = Vec::new();
    for at_node in pairs.chunk_by(|a, b| a[0] == b[0]) {
        let parts = at_node.iter().enumerate();
        let mut strangers = parts.flat_map(|(i, [_, a])| {
            let others = at_node[i + 1..].iter();
            others.filter_map(move |[_, b]| (!voxels.are_neighbours(*a, *b)).then_some([*a, *b]))
        });
        if let Some(parts) = strangers.next() {
            let node = at_node[0][0];
            pinched.push(PinchedNode { node, parts });
        }
    }
    pinched
}
