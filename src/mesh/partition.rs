//! A mesh in pieces, each in another process: nobody holds all of it.

use crate::parallel::prelude::*;

use super::TetMesh;
use super::complex::{NONE, NOT_LOCAL};

/// Some of a mesh's tetrahedra, one after the other. Nodes and tetrahedra have numbers of their own in it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshPartition {
    /// Its tetrahedra, and the nodes of these.
    pub mesh: TetMesh,
    /// For each tetrahedron and face k (opposite node k) the tetrahedron on the other side: `NONE` outside the
    /// mesh, `BEYOND` if it is in another piece.
    pub neighbors: Vec<[u32; 4]>,
    /// The whole mesh's number of each node, rising: pieces that have a node have it under this number.
    pub global_ids: Vec<u32>,
    /// The whole's number of the first tetrahedron; the others follow.
    pub first_cell: usize,
    /// Nodes and tetrahedra of the whole.
    pub global_counts: [usize; 2],
}

impl MeshPartition {
    /// The nodes that other pieces may have too, rising: those at faces beyond which another goes on. (The
    /// tetrahedra at a node hang together by faces: where some are in another piece, there is such a face.)
    pub fn shared_nodes(&self) -> Vec<u32> {
        let mut shared = Vec::new();
        for (tet, around) in self.mesh.tets.iter().zip(&self.neighbors) {
            for k in (0..4).filter(|&k| around[k] == NOT_LOCAL) {
                shared.extend((0..4).filter(|&i| i != k).map(|i| tet[i]));
            }
        }
        shared.sort_unstable();
        shared.dedup();
        shared
    }

    /// The numbers that neighbours have in a mesh of which this piece is all there is: outer faces are where
    /// the mesh ends, or the piece.
    pub fn local_neighbors(&self) -> Vec<[u32; 4]> {
        let here = |around: &[u32; 4]| around.map(|n| if n == NOT_LOCAL { NONE } else { n });
        self.neighbors.par_iter().map(here).collect()
    }

    /// A mesh cut into so many pieces, of about as many tetrahedra each.
    #[cfg(test)]
    pub fn split(mesh: &TetMesh, neighbors: &[[u32; 4]], count: usize) -> Vec<Self> {
        let cells = mesh.tets.len();
        let piece = |piece: usize| {
            let own = piece * cells / count..(piece + 1) * cells / count;
            let mut numbers = mesh.tets[own.clone()].as_flattened().to_vec();
            numbers.sort_unstable();
            numbers.dedup();
            let local = |n: u32| numbers.binary_search(&n).unwrap() as u32;
            let beyond = |n: u32| match n as usize {
                n if own.contains(&n) => (n - own.start) as u32,
                _ if n == NONE => NONE,
                _ => NOT_LOCAL,
            };
            Self {
                mesh: TetMesh {
                    nodes: numbers.iter().map(|&n| mesh.nodes[n as usize]).collect(),
                    tets: (mesh.tets[own.clone()].iter())
                        .map(|tet| tet.map(local))
                        .collect(),
                },
                neighbors: (neighbors[own.clone()].iter())
                    .map(|around| around.map(beyond))
                    .collect(),
                first_cell: own.start,
                global_counts: [mesh.nodes.len(), cells],
                global_ids: numbers,
            }
        };
        (0..count).map(piece).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::complex;

    #[test]
    fn pieces_are_the_mesh_and_know_which_nodes_they_share() {
        let mesh = kuhn_box([3, 2, 4], 1.0);
        let neighbors = complex::neighbors(mesh.nodes.len(), &mesh.tets).unwrap();
        let pieces = MeshPartition::split(&mesh, &neighbors, 3);
        let mut tets = Vec::new();
        for (i, piece) in pieces.iter().enumerate() {
            assert_eq!(piece.first_cell, tets.len());
            let whole = |tet: &[u32; 4]| tet.map(|n| piece.global_ids[n as usize]);
            tets.extend(piece.mesh.tets.iter().map(whole));
            let others = |n: &u32| {
                let mut others = pieces.iter().enumerate().filter(|(j, _)| *j != i);
                others.any(|(_, other)| other.global_ids.binary_search(n).is_ok())
            };
            let shared = (0..piece.global_ids.len() as u32)
                .filter(|&n| others(&piece.global_ids[n as usize]));
            assert!(piece.shared_nodes().into_iter().eq(shared), "piece {i}");
        }
        assert_eq!(tets, mesh.tets);
    }
}
