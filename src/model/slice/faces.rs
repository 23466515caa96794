//! The faces of any mesh, with the cells on either side.

use crate::Result;
use crate::geometry::to_3d;
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;
use crate::model::surface::facet_selection::labels_of_faces;
use crate::store::{Storable, StoredMesh};

/// The faces of a mesh, ready to be drawn. In 3-D, faces bound cells. In 2-D, each cell is a face
/// with only itself beside it, and the edges on features are stored separately.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct DrawableFaces {
    /// Node positions as fractions of the box, in [0, 1].
    pub nodes: Vec<[f64; 3]>,
    /// Nodes of each face, in cyclic order.
    pub rings: Lists,
    /// Cells on either side of each face, `NONE` where there is none.
    pub cells: Vec<[u32; 2]>,
    /// Number of the surface on which each face lies, from 1; 0 if it lies on none.
    pub surfaces: Vec<u32>,
    /// In 2-D, the edges on features, each with the number of its surface.
    pub feature_edges: Vec<([u32; 2], u32)>,
    /// Centre of each cell, as fractions of the box.
    pub cell_centres: Vec<[f64; 3]>,
}

impl DrawableFaces {
    /// Creates the faces of a mesh. `surfaces` holds the facets of its surfaces (sorted, with
    /// ascending nodes) and the surfaces' numbers.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
    pub(crate) fn from_mesh<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        surfaces: &[([u32; D], u32)],
    ) -> Result<Self> {
        let mesh = &stored.lattice;
        let extent = stored.space.extent;
        let to_fraction = |x: &[f64; D]| {
            let fraction: [f64; D] = std::array::from_fn(|k| (x[k] / extent[k]).clamp(0.0, 1.0));
            to_3d(fraction)
        };
        let mut faces = Self {
            nodes: mesh.nodes().iter().map(to_fraction).collect(),
            cell_centres: (mesh.cell_volumes().iter())
                .map(|(_, centre)| to_fraction(centre))
                .collect(),
            ..Self::default()
        };
        let cells_of_faces = mesh.cells_of_faces()?;
        let labels = labels_of_faces(mesh, surfaces);
        if D == 2 {
            faces.add_plane_mesh(mesh, &cells_of_faces, &labels);
        } else {
            faces.add_volume_mesh(mesh, &cells_of_faces, &labels);
        }
        Ok(faces)
    }

    /// Returns the number of faces.
    pub(crate) fn len(&self) -> usize {
        self.cells.len()
    }

    fn add_volume_mesh<const D: usize>(
        &mut self,
        mesh: &impl Mesh<D>,
        cells_of_faces: &[[u32; 2]],
        labels: &[u32],
    ) {
        let mut ring = Vec::new();
        for (face, &cells) in cells_of_faces
            .iter()
            .enumerate()
            .filter(|(_, c)| c[0] != NONE)
        {
            ring.clear();
            // The facets of a face form a fan: each one after the first adds one node.
            mesh.facets(face, |facet| {
                if ring.is_empty() {
                    ring.extend(facet)
                } else {
                    ring.push(facet[D - 1])
                }
            });
            self.rings.push(ring.iter().copied());
            self.cells.push(cells);
            self.surfaces.push(labels[face]);
        }
    }

    fn add_plane_mesh<const D: usize>(
        &mut self,
        mesh: &impl Mesh<D>,
        cells_of_faces: &[[u32; 2]],
        labels: &[u32],
    ) {
        // The edges of all cells, each directed so that its cell is on the left.
        let mut edges: Vec<(u32, [u32; 2])> = Vec::new();
        for (face, &[left, right]) in cells_of_faces
            .iter()
            .enumerate()
            .filter(|(_, c)| c[0] != NONE)
        {
            mesh.facets(face, |edge| {
                let (p, q) = (edge[0], edge[D - 1]);
                edges.push((left, [p, q]));
                if right != NONE {
                    edges.push((right, [q, p]));
                }
                if labels[face] > 0 {
                    self.feature_edges.push(([p, q], labels[face]));
                }
            });
        }
        edges.sort_unstable();
        let mut ring = Vec::new();
        for cell in edges.chunk_by(|a, b| a.0 == b.0) {
            ring.clear();
            let mut edge = cell[0].1;
            for _ in 0..cell.len() {
                ring.push(edge[0]);
                match cell.iter().find(|(_, next)| next[0] == edge[1]) {
                    Some((_, next)) => edge = *next,
                    None => break,
                }
            }
            self.rings.push(ring.iter().copied());
            self.cells.push([cell[0].0, NONE]);
            self.surfaces.push(0);
        }
    }
}
