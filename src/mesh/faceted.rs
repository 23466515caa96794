//! What surfaces, blocks and paint need of a mesh, whatever its cells are: its faces, cut into
//! facets.

use crate::error::cause;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{Beyond, PolyMesh};
use crate::{Error, Result};

/// A mesh whose faces can be cut into facets: triangles in space, edges in the plane.
///
/// Faces are numbered as in [`Connection::face`](crate::mesh::graph::Connection::face): face k of
/// simplex c is `(D + 1) c + k`, so that a face between two simplices has two numbers; those of
/// polyhedra and polygons are the mesh's own.
pub trait Faceted<const D: usize>: Sync {
    /// Node positions.
    fn node_positions(&self) -> &[[f64; D]];

    /// How many numbers of faces there are.
    fn face_count(&self) -> usize;

    /// The facets of a face; their normals point out of its first cell.
    fn facets(&self, face: usize, visit: impl FnMut([u32; D]));

    /// For each number of a face its cell and the cell beyond, [`NONE`] on the boundary. Where two
    /// numbers mean one face, the second has [`NONE`] twice.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>>;

    /// Volume (area in the plane) and centre of each cell.
    fn cell_volumes(&self) -> Vec<(f64, [f64; D])>;
}

impl<const D: usize, M: Simplices<D>> Faceted<D> for M {
    fn node_positions(&self) -> &[[f64; D]] {
        self.nodes()
    }

    fn face_count(&self) -> usize {
        self.connectivity().len()
    }

    fn facets(&self, face: usize, mut visit: impl FnMut([u32; D])) {
        let (cell, k) = (face / (D + 1), face % (D + 1));
        let mut facet = self.face(cell, k);
        // Leaving out a node in an odd place turns the rest round.
        if k % 2 == 1 {
            facet.swap(0, 1);
        }
        visit(facet);
    }

    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>> {
        let neighbors = self.neighbors().map_err(|face| {
            Error::Mesh(cause(
                "mesh",
                format!("more than two {} share the face {face:?}", M::CELLS),
                "run atomesh validate",
            ))
        })?;
        let cells = neighbors.into_iter().enumerate().map(|(face, beyond)| {
            let cell = (face / (D + 1)) as u32;
            // NONE is greater than all.
            if beyond > cell {
                [cell, beyond]
            } else {
                [NONE; 2]
            }
        });
        Ok(cells.collect())
    }

    fn cell_volumes(&self) -> Vec<(f64, [f64; D])> {
        let centre = |c: usize| {
            let nodes = self.cell(c).iter().map(|&n| self.nodes()[n as usize]);
            nodes.fold([0.0; D], |sum, x| {
                std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
            })
        };
        (0..self.len())
            .map(|c| (self.volume(c), centre(c)))
            .collect()
    }
}

impl<const D: usize> Faceted<D> for PolyMesh<D> {
    fn node_positions(&self) -> &[[f64; D]] {
        &self.nodes
    }

    fn face_count(&self) -> usize {
        self.face_cells.len()
    }

    fn facets(&self, face: usize, mut visit: impl FnMut([u32; D])) {
        let ring = self.faces.get(face);
        if D == 2 {
            return visit(std::array::from_fn(|k| ring[k]));
        }
        // A fan round the node of lowest number: the same whichever way the face turns.
        let least = ring.iter().enumerate().min_by_key(|(_, node)| **node);
        let first = least.map_or(0, |(at, _)| at);
        for i in 1..ring.len() - 1 {
            visit(std::array::from_fn(|k| {
                let step = if k == 0 { 0 } else { i + k - 1 };
                ring[(first + step) % ring.len()]
            }));
        }
    }

    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>> {
        let cells = |face: usize| {
            let beyond = match self.beyond(face) {
                Beyond::Cell(cell) => cell as u32,
                _ => NONE,
            };
            [self.face_cells[face][0], beyond]
        };
        Ok((0..self.face_cells.len()).map(cells).collect())
    }

    fn cell_volumes(&self) -> Vec<(f64, [f64; D])> {
        self.cell_shapes()
    }
}

/// Marks for the faces of simplices, in the order of their numbers, from a byte a cell of which bit k
/// stands for face k.
pub fn marks_of_bits<const D: usize>(bits: &[u8]) -> impl Iterator<Item = bool> {
    (bits.iter()).flat_map(|&bits| (0..=D).map(move |k| bits >> k & 1 == 1))
}
