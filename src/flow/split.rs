//! A mesh torn along its faults: nodes doubled where faces on features part their tetrahedra.

use crate::error::cause;
use crate::mesh::complex::{NONE, neighbors};
use crate::mesh::{FACES, TetMesh};
use crate::{Error, Result};

/// A mesh whose nodes on faults exist once for each side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Split {
    /// The mesh, its tetrahedra as before, their nodes perhaps others; nodes that were added follow
    /// those that were there.
    pub mesh: TetMesh,
    /// For each node the one from which it was made (itself, for those that were there).
    pub original: Vec<u32>,
    /// The faces along which the mesh was torn.
    pub faces: Vec<FaultFace>,
}

/// A face on a fault, seen from its two tetrahedra.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultFace {
    /// The tetrahedra, the lower number first.
    pub tets: [u32; 2],
    /// Which of their faces it is.
    pub face: [u8; 2],
    /// The face's nodes as each tetrahedron has them, in the same order: equal at the fault's tip.
    pub nodes: [[u32; 3]; 2],
}

impl Split {
    /// Tears `mesh` along the faces that `feature_faces` names (bit k of a tetrahedron: its face k;
    /// from one side is enough). The tetrahedra round a node fall into parts that no untorn face
    /// joins, and each part gets a node of its own. At the rim of a fault there is one part only.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two tetrahedra share a face.
    pub fn new(mesh: &TetMesh, feature_faces: &[u8]) -> Result<Self> {
        let neighbors = neighbors(mesh.nodes.len(), &mesh.tets).map_err(|face| {
            Error::Mesh(cause(
                format!("face {face:?}"),
                "belongs to more than two tetrahedra",
                "mesh the image again",
            ))
        })?;
        let mut split = Self {
            mesh: mesh.clone(),
            original: (0..mesh.nodes.len() as u32).collect(),
            faces: Vec::new(),
        };
        let mut torn = vec![0u8; mesh.tets.len()];
        let mut pairs = Vec::new();
        for (t, &bits) in feature_faces.iter().enumerate() {
            for k in (0..4).filter(|k| bits >> k & 1 == 1) {
                let n = neighbors[t][k];
                if n == NONE || torn[t] >> k & 1 == 1 {
                    continue;
                }
                let back = neighbors[n as usize].iter().position(|&m| m as usize == t);
                let Some(back) = back else { continue };
                torn[t] |= 1 << k;
                torn[n as usize] |= 1 << back;
                let pair = [(t as u32, k as u8), (n, back as u8)];
                pairs.push(if n < t as u32 {
                    [pair[1], pair[0]]
                } else {
                    pair
                });
            }
        }
        split.double_nodes(mesh, &neighbors, &torn, &pairs);
        pairs.sort_unstable();
        for [(t, k), (n, back)] in pairs {
            let (here, there) = (mesh.tets[t as usize], mesh.tets[n as usize]);
            let corners = FACES[usize::from(k)];
            let across = corners.map(|i| there.iter().position(|&j| j == here[i]).unwrap_or(i));
            split.faces.push(FaultFace {
                tets: [t, n],
                face: [k, back],
                nodes: [
                    corners.map(|i| split.mesh.tets[t as usize][i]),
                    across.map(|i| split.mesh.tets[n as usize][i]),
                ],
            });
        }
        Ok(split)
    }

    /// Gives each part of the tetrahedra round a node a node of its own.
    fn double_nodes(
        &mut self,
        mesh: &TetMesh,
        neighbors: &[[u32; 4]],
        torn: &[u8],
        pairs: &[[(u32, u8); 2]],
    ) {
        let mut on_fault = vec![false; mesh.nodes.len()];
        for [(t, k), _] in pairs {
            for i in FACES[usize::from(*k)] {
                on_fault[mesh.tets[*t as usize][i] as usize] = true;
            }
        }
        let mut round: Vec<(u32, u32)> = Vec::new();
        for (t, tet) in mesh.tets.iter().enumerate() {
            let here = tet.iter().filter(|&&i| on_fault[i as usize]);
            round.extend(here.map(|&i| (i, t as u32)));
        }
        round.sort_unstable();
        let (mut reached, mut done) = (Vec::new(), Vec::new());
        for star in round.chunk_by(|a, b| a.0 == b.0) {
            let node = star[0].0;
            done.clear();
            done.resize(star.len(), false);
            for seed in 0..star.len() {
                if done[seed] {
                    continue;
                }
                let part = if seed == 0 {
                    node
                } else {
                    self.mesh.nodes.push(mesh.nodes[node as usize]);
                    self.original.push(node);
                    (self.mesh.nodes.len() - 1) as u32
                };
                done[seed] = true;
                reached.push(seed);
                while let Some(at) = reached.pop() {
                    let t = star[at].1 as usize;
                    for k in 0..4 {
                        if mesh.tets[t][k] == node {
                            self.mesh.tets[t][k] = part;
                        } else if neighbors[t][k] != NONE && torn[t] >> k & 1 == 0 {
                            let next = star.binary_search(&(node, neighbors[t][k]));
                            if let Ok(next) = next
                                && !done[next]
                            {
                                done[next] = true;
                                reached.push(next);
                            }
                        }
                    }
                }
            }
        }
    }
}
