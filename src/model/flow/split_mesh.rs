//! A mesh torn along its faults: nodes doubled where faces on faults part their cells.

use super::barriers::Barriers;
use crate::error::cause;
use crate::mesh::complex::NONE;
use crate::mesh::{Simplices, TetMesh};
use crate::{Error, Result};

/// A mesh whose nodes on faults exist once for each side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SplitMesh<const D: usize = 3, M = TetMesh> {
    /// The mesh, its cells as before, their nodes perhaps others; nodes that were added follow
    /// those that were there.
    pub mesh: M,
    /// For each node the one from which it was made (itself, for those that were there).
    pub original_node: Vec<u32>,
    /// The faces along which the mesh was torn.
    pub faces: Vec<FaultFace<D>>,
}

/// A face on a fault, seen from its two cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultFace<const D: usize = 3> {
    /// The cells, the lower number first.
    pub cells: [u32; 2],
    /// Which of their faces it is.
    pub local_faces: [u8; 2],
    /// The face's nodes as each cell has them, in the same order: equal at the fault's tip.
    pub nodes: [[u32; D]; 2],
    /// The label of its barrier.
    pub label: u32,
}

impl<const D: usize, M: Simplices<D>> SplitMesh<D, M> {
    /// Tears `mesh` along the faces on which barriers stand. The cells round a node fall into parts
    /// that no untorn face joins, and each part gets a node of its own. At the rim of a fault there
    /// is one part only.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    pub fn new(mesh: &M, barriers: &Barriers) -> Result<Self> {
        let neighbors = mesh.neighbors().map_err(|face| {
            Error::Mesh(cause(
                format!("face {face:?}"),
                format!("belongs to more than two {}", M::CELLS_NAME),
                "mesh the image again",
            ))
        })?;
        let mut tearing = MeshSplitter {
            mesh,
            corners: mesh.connectivity().to_vec(),
            nodes: mesh.nodes().to_vec(),
            original_node: (0..mesh.nodes().len() as u32).collect(),
            is_split: vec![false; neighbors.len()],
            neighbors,
        };
        let mut pairs = tearing.mark_barrier_faces(barriers);
        tearing.double_nodes(&pairs);
        pairs.sort_unstable_by_key(|pair| pair.faces);
        let faces = pairs.iter().map(|pair| tearing.fault_face(pair));
        Ok(Self {
            faces: faces.collect(),
            mesh: M::from_parts(tearing.nodes, tearing.corners),
            original_node: tearing.original_node,
        })
    }
}

/// A torn face by its two numbers, the lower first.
struct FacePair {
    faces: [usize; 2],
    label: u32,
}

struct MeshSplitter<'a, const D: usize, M> {
    mesh: &'a M,
    neighbors: Vec<u32>,
    /// By number of face: (D + 1) cell + k.
    is_split: Vec<bool>,
    nodes: Vec<[f64; D]>,
    corners: Vec<u32>,
    original_node: Vec<u32>,
}

impl<const D: usize, M: Simplices<D>> MeshSplitter<'_, D, M> {
    /// Marks both sides of every face on a barrier.
    fn mark_barrier_faces(&mut self, barriers: &Barriers) -> Vec<FacePair> {
        let mut pairs = Vec::new();
        for face in 0..self.neighbors.len() {
            let Some(label) = barriers.label(face).filter(|_| !self.is_split[face]) else {
                continue;
            };
            let (cell, other) = (face / (D + 1), self.neighbors[face]);
            if other == NONE {
                continue;
            }
            let base = other as usize * (D + 1);
            let around = &self.neighbors[base..base + D + 1];
            let Some(back) = around.iter().position(|&c| c as usize == cell) else {
                continue;
            };
            let back = base + back;
            self.is_split[face] = true;
            self.is_split[back] = true;
            pairs.push(FacePair {
                faces: [face.min(back), face.max(back)],
                label,
            });
        }
        pairs
    }

    /// Gives each part of the cells round a node a node of its own.
    fn double_nodes(&mut self, pairs: &[FacePair]) {
        let mesh = self.mesh;
        let mut on_fault = vec![false; self.nodes.len()];
        for pair in pairs {
            let face = pair.faces[0];
            for node in mesh.face(face / (D + 1), face % (D + 1)) {
                on_fault[node as usize] = true;
            }
        }
        let mut round: Vec<(u32, u32)> = Vec::new();
        for (corner, &node) in mesh.connectivity().iter().enumerate() {
            if on_fault[node as usize] {
                round.push((node, (corner / (D + 1)) as u32));
            }
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
                    self.nodes.push(mesh.nodes()[node as usize]);
                    self.original_node.push(node);
                    (self.nodes.len() - 1) as u32
                };
                done[seed] = true;
                reached.push(seed);
                while let Some(at) = reached.pop() {
                    let base = star[at].1 as usize * (D + 1);
                    for corner in base..=base + D {
                        let next = self.neighbors[corner];
                        if mesh.connectivity()[corner] == node {
                            self.corners[corner] = part;
                        } else if next != NONE
                            && !self.is_split[corner]
                            && let Ok(next) = star.binary_search(&(node, next))
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

    /// A torn face with the nodes that either side has now.
    fn fault_face(&self, pair: &FacePair) -> FaultFace<D> {
        let [here, there] = pair.faces.map(|face| face / (D + 1));
        let opposite = pair.faces[0] % (D + 1);
        let (cell, beyond) = (self.mesh.cell(here), self.mesh.cell(there));
        let kept = |i: usize| i + usize::from(i >= opposite);
        FaultFace {
            cells: [here as u32, there as u32],
            local_faces: pair.faces.map(|face| (face % (D + 1)) as u8),
            nodes: [
                std::array::from_fn(|i| self.corners[here * (D + 1) + kept(i)]),
                std::array::from_fn(|i| {
                    let same = beyond.iter().position(|&n| n == cell[kept(i)]);
                    self.corners[there * (D + 1) + same.unwrap_or(0)]
                }),
            ],
            label: pair.label,
        }
    }
}
