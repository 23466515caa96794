//! A distributed mesh: each MPI rank has one partition, and no rank has the global mesh.

use crate::parallel::prelude::*;

use super::TetMesh;
use super::complex::{NONE, NOT_LOCAL};

/// Consecutive tetrahedra of a global mesh, with local numbers of nodes and tetrahedra.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshPartition {
    /// The tetrahedra of the partition, and their nodes.
    pub mesh: TetMesh,
    /// For each tetrahedron and face k (opposite node k) the tetrahedron on the other side: `NONE`
    /// outside the mesh, `NOT_LOCAL` if it is in another partition.
    pub neighbours: Vec<[u32; 4]>,
    /// Global number of each node, ascending. All partitions use the same global numbers.
    pub global_ids: Vec<u32>,
    /// Global number of the first tetrahedron; the others follow.
    pub first_cell: usize,
    /// Number of nodes and number of tetrahedra of the global mesh.
    pub global_counts: [usize; 2],
}

impl MeshPartition {
    /// Returns the nodes that other partitions may have too, ascending: the nodes of faces to
    /// another partition. This finds all of them, because the tetrahedra at a node are connected
    /// through faces: where some are in another partition, there is such a face.
    pub fn shared_nodes(&self) -> Vec<u32> {
        let mut shared = Vec::new();
        for (tet, adjacent) in self.mesh.tets.iter().zip(&self.neighbours) {
            for k in (0..4).filter(|&k| adjacent[k] == NOT_LOCAL) {
                shared.extend((0..4).filter(|&i| i != k).map(|i| tet[i]));
            }
        }
        shared.sort_unstable();
        shared.dedup();
        shared
    }

    /// Returns the neighbours with `NONE` on all outer faces of the partition, both on the boundary
    /// of the mesh and towards other partitions.
    pub fn local_neighbours(&self) -> Vec<[u32; 4]> {
        let without_nonlocal =
            |adjacent: &[u32; 4]| adjacent.map(|n| if n == NOT_LOCAL { NONE } else { n });
        self.neighbours.par_iter().map(without_nonlocal).collect()
    }

    /// Cuts a mesh into `count` partitions with about as many tetrahedra each.
    #[cfg(test)]
    pub fn split(mesh: &TetMesh, neighbours: &[[u32; 4]], count: usize) -> Vec<Self> {
        let cells = mesh.tets.len();
        let partition = |piece: usize| {
            let cells_of_part = piece * cells / count..(piece + 1) * cells / count;
            let global_ids = crate::geometry::sorted_distinct(
                mesh.tets[cells_of_part.clone()]
                    .as_flattened()
                    .iter()
                    .copied(),
            );
            let local_id = |n: u32| global_ids.binary_search(&n).unwrap() as u32;
            let local_neighbour = |n: u32| match n as usize {
                n if cells_of_part.contains(&n) => (n - cells_of_part.start) as u32,
                _ if n == NONE => NONE,
                _ => NOT_LOCAL,
            };
            Self {
                mesh: TetMesh {
                    nodes: global_ids.iter().map(|&n| mesh.nodes[n as usize]).collect(),
                    tets: (mesh.tets[cells_of_part.clone()].iter())
                        .map(|tet| tet.map(local_id))
                        .collect(),
                },
                neighbours: (neighbours[cells_of_part.clone()].iter())
                    .map(|adjacent| adjacent.map(local_neighbour))
                    .collect(),
                first_cell: cells_of_part.start,
                global_counts: [mesh.nodes.len(), cells],
                global_ids,
            }
        };
        (0..count).map(partition).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::complex;

    #[test]
    fn partitions_are_the_mesh_and_find_their_shared_nodes() {
        let mesh = kuhn_box([3, 2, 4], 1.0);
        let neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
        let partitions = MeshPartition::split(&mesh, &neighbours, 3);
        let mut tets = Vec::new();
        for (i, partition) in partitions.iter().enumerate() {
            assert_eq!(partition.first_cell, tets.len());
            let global_tet = |tet: &[u32; 4]| tet.map(|n| partition.global_ids[n as usize]);
            tets.extend(partition.mesh.tets.iter().map(global_tet));
            let is_elsewhere = |n: &u32| {
                let mut others = partitions.iter().enumerate().filter(|(j, _)| *j != i);
                others.any(|(_, other)| other.global_ids.binary_search(n).is_ok())
            };
            let shared = (0..partition.global_ids.len() as u32)
                .filter(|&n| is_elsewhere(&partition.global_ids[n as usize]));
            assert!(partition.shared_nodes().into_iter().eq(shared), "piece {i}");
        }
        assert_eq!(tets, mesh.tets);
    }
}
