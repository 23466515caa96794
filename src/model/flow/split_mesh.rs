//! Meshes split along their faults: the nodes of fault faces are doubled, so that each side has its
//! own.

use super::barriers::Barriers;
use crate::error::cause;
use crate::mesh::complex::NONE;
use crate::mesh::{Simplices, TetMesh};
use crate::{Error, Result};

/// A mesh whose nodes on faults exist once for each side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SplitMesh<const D: usize = 3, M = TetMesh> {
    /// The mesh. Its cells are those of the original mesh, but may have other nodes. Added nodes
    /// follow the original ones.
    pub mesh: M,
    /// The original node of each node. Nodes of the original mesh have their own number.
    pub original_node: Vec<u32>,
    /// The faces along which the mesh is split.
    pub faces: Vec<FaultFace<D>>,
}

/// A face on a fault, with the data of its two cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultFace<const D: usize = 3> {
    /// The two cells, the smaller number first.
    pub cells: [u32; 2],
    /// The local number of the face in each cell.
    pub local_faces: [u8; 2],
    /// The nodes of the face in each cell, in the same order. At the tip of the fault they are
    /// equal.
    pub nodes: [[u32; D]; 2],
    /// The label of its barrier.
    pub label: u32,
}

impl<const D: usize, M: Simplices<D>> SplitMesh<D, M> {
    /// Splits `mesh` along the faces on barriers. The cells around a node form components,
    /// connected by faces that are not split. Each component gets its own copy of the node. At the
    /// rim of a fault there is only one component.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if more than two cells share a face.
    pub fn new(mesh: &M, barriers: &Barriers) -> Result<Self> {
        let neighbours = mesh.neighbours().map_err(|face| {
            Error::Mesh(cause(
                format!("face {face:?}"),
                format!("belongs to more than two {}", M::CELLS_NAME),
                "mesh the image again",
            ))
        })?;
        let mut splitter = MeshSplitter {
            mesh,
            corners: mesh.connectivity().to_vec(),
            nodes: mesh.nodes().to_vec(),
            original_node: (0..mesh.nodes().len() as u32).collect(),
            is_split: vec![false; neighbours.len()],
            neighbours,
        };
        let mut pairs = splitter.mark_barrier_faces(barriers);
        splitter.double_nodes(&pairs);
        pairs.sort_unstable_by_key(|pair| pair.faces);
        let faces = pairs.iter().map(|pair| splitter.fault_face(pair));
        Ok(Self {
            faces: faces.collect(),
            mesh: M::from_parts(splitter.nodes, splitter.corners),
            original_node: splitter.original_node,
        })
    }
}

/// A split face: its two numbers, the smaller one first, and its label.
struct FacePair {
    faces: [usize; 2],
    label: u32,
}

struct MeshSplitter<'a, const D: usize, M> {
    mesh: &'a M,
    neighbours: Vec<u32>,
    /// `true` for split faces. Face k of a cell has the index (D + 1) cell + k.
    is_split: Vec<bool>,
    nodes: Vec<[f64; D]>,
    corners: Vec<u32>,
    original_node: Vec<u32>,
}

impl<const D: usize, M: Simplices<D>> MeshSplitter<'_, D, M> {
    /// Marks every face on a barrier from both of its cells, and returns these faces.
    fn mark_barrier_faces(&mut self, barriers: &Barriers) -> Vec<FacePair> {
        let mut pairs = Vec::new();
        for face in 0..self.neighbours.len() {
            let Some(label) = barriers.label(face).filter(|_| !self.is_split[face]) else {
                continue;
            };
            let (cell, other) = (face / (D + 1), self.neighbours[face]);
            if other == NONE {
                continue;
            }
            let base = other as usize * (D + 1);
            let neighbours = &self.neighbours[base..base + D + 1];
            let Some(local_face) = neighbours.iter().position(|&c| c as usize == cell) else {
                continue;
            };
            let opposite = base + local_face;
            self.is_split[face] = true;
            self.is_split[opposite] = true;
            pairs.push(FacePair {
                faces: [face.min(opposite), face.max(opposite)],
                label,
            });
        }
        pairs
    }

    /// Gives each component of the cells around a node its own copy of the node.
    fn double_nodes(&mut self, pairs: &[FacePair]) {
        let mesh = self.mesh;
        let mut on_fault = vec![false; self.nodes.len()];
        for pair in pairs {
            let face = pair.faces[0];
            for node in mesh.face(face / (D + 1), face % (D + 1)) {
                on_fault[node as usize] = true;
            }
        }
        let mut node_cells: Vec<(u32, u32)> = Vec::new();
        for (corner, &node) in mesh.connectivity().iter().enumerate() {
            if on_fault[node as usize] {
                node_cells.push((node, (corner / (D + 1)) as u32));
            }
        }
        node_cells.sort_unstable();
        let (mut reached, mut done) = (Vec::new(), Vec::new());
        for star in node_cells.chunk_by(|a, b| a.0 == b.0) {
            let node = star[0].0;
            done.clear();
            done.resize(star.len(), false);
            for seed in 0..star.len() {
                if done[seed] {
                    continue;
                }
                let node_copy = if seed == 0 {
                    node
                } else {
                    self.nodes.push(mesh.nodes()[node as usize]);
                    self.original_node.push(node);
                    (self.nodes.len() - 1) as u32
                };
                done[seed] = true;
                reached.push(seed);
                while let Some(index) = reached.pop() {
                    let base = star[index].1 as usize * (D + 1);
                    for corner in base..=base + D {
                        let next = self.neighbours[corner];
                        if mesh.connectivity()[corner] == node {
                            self.corners[corner] = node_copy;
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

    /// Returns a split face with the nodes that each side has now.
    fn fault_face(&self, pair: &FacePair) -> FaultFace<D> {
        let [first, second] = pair.faces.map(|face| face / (D + 1));
        let opposite = pair.faces[0] % (D + 1);
        let (first_nodes, second_nodes) = (self.mesh.cell(first), self.mesh.cell(second));
        let skip_opposite = |i: usize| i + usize::from(i >= opposite);
        FaultFace {
            cells: [first as u32, second as u32],
            local_faces: pair.faces.map(|face| (face % (D + 1)) as u8),
            nodes: [
                std::array::from_fn(|i| self.corners[first * (D + 1) + skip_opposite(i)]),
                std::array::from_fn(|i| {
                    let position = second_nodes
                        .iter()
                        .position(|&n| n == first_nodes[skip_opposite(i)]);
                    self.corners[second * (D + 1) + position.unwrap_or(0)]
                }),
            ],
            label: pair.label,
        }
    }
}
