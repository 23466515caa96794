//! Any mesh as faces with the cells on either side.

use crate::Result;
use crate::geometry::to_3d;
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;
use crate::model::surface::facet_selection::labels_of_faces;
use crate::store::{Storable, StoredMesh};

/// Faces that bound cells in space. In the plane each cell is a face of itself alone, and the mesh's
/// edges on features are lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct DrawableFaces {
    /// Node positions as shares of the box, in [0, 1].
    pub nodes: Vec<[f64; 3]>,
    /// The nodes of each face, in order round it.
    pub rings: Lists,
    /// The cells on either side, `NONE` where there is none.
    pub cells: Vec<[u32; 2]>,
    /// The number of the surface on which each face lies, from 1; 0 if on none.
    pub surfaces: Vec<u32>,
    /// In the plane: the edges on features, each with the number of its surface.
    pub feature_edges: Vec<([u32; 2], u32)>,
    /// The middle of each cell, a share of the box.
    pub cell_centres: Vec<[f64; 3]>,
}

impl DrawableFaces {
    /// Of a mesh, with the facets of its surfaces (nodes ascending, sorted) and their numbers.
    ///
    /// # Errors
    /// [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
    pub(crate) fn from_mesh<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        surfaces: &[([u32; D], u32)],
    ) -> Result<Self> {
        let mesh = &stored.lattice;
        let extent = stored.space.extent;
        let share = |x: &[f64; D]| {
            let share: [f64; D] = std::array::from_fn(|k| (x[k] / extent[k]).clamp(0.0, 1.0));
            to_3d(share)
        };
        let mut faces = Self {
            nodes: mesh.nodes().iter().map(share).collect(),
            cell_centres: (mesh.cell_volumes().iter())
                .map(|(_, middle)| share(middle))
                .collect(),
            ..Self::default()
        };
        let sides = mesh.cells_of_faces()?;
        let labels = labels_of_faces(mesh, surfaces);
        if D == 2 {
            faces.from_plane_mesh(mesh, &sides, &labels);
        } else {
            faces.from_volume_mesh(mesh, &sides, &labels);
        }
        Ok(faces)
    }

    /// Number of faces.
    pub(crate) fn len(&self) -> usize {
        self.cells.len()
    }

    fn from_volume_mesh<const D: usize>(
        &mut self,
        mesh: &impl Mesh<D>,
        sides: &[[u32; 2]],
        labels: &[u32],
    ) {
        let mut ring = Vec::new();
        for (face, &cells) in sides.iter().enumerate().filter(|(_, c)| c[0] != NONE) {
            ring.clear();
            // Facets are a fan: each but the first adds a node.
            mesh.facets(face, |facet| match ring.is_empty() {
                true => ring.extend(facet),
                false => ring.push(facet[D - 1]),
            });
            self.rings.push(ring.iter().copied());
            self.cells.push(cells);
            self.surfaces.push(labels[face]);
        }
    }

    fn from_plane_mesh<const D: usize>(
        &mut self,
        mesh: &impl Mesh<D>,
        sides: &[[u32; 2]],
        labels: &[u32],
    ) {
        // The edges of each cell, with the cell on their left.
        let mut edges: Vec<(u32, [u32; 2])> = Vec::new();
        for (face, &[left, right]) in sides.iter().enumerate().filter(|(_, c)| c[0] != NONE) {
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
