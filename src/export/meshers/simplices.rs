//! Meshes of simplices for those formats that hold nothing else: tetrahedra with triangles on what has a
//! name, or, of the plane, triangles with edges.

use super::groups::groups;
use crate::Result;
use crate::mesh::poly::Lists;
use crate::model::reservoir::Model;

/// A mesh of tetrahedra or triangles.
pub struct Simplices<'a> {
    /// Positions.
    pub nodes: &'a [[f64; 3]],
    /// The nodes of each, one after the other.
    corners: &'a [u32],
    /// Number of nodes of each: 4, or 3.
    pub size: usize,
    /// The region of each.
    pub region: &'a [i32],
    /// What has a name.
    pub named: Vec<Named>,
}

/// Sides of simplices that have a name.
pub struct Named {
    /// As [`Group::name`](super::groups::Group).
    pub name: &'static str,
    /// As [`Group::number`](super::groups::Group).
    pub number: usize,
    /// The nodes of each side.
    pub sides: Lists,
    /// The first cell that has it.
    pub cells: Vec<u32>,
}

impl<'a> Simplices<'a> {
    /// The simplices of a model.
    ///
    /// # Errors
    /// [`Error::Export`](crate::Error::Export) if the cells are others; `needs` says who asks.
    pub fn new(model: &'a Model, needs: &str) -> Result<Self> {
        let mesh = &model.mesh;
        let (corners, size, nodes) = match &model.triangles {
            Some(triangles) => (triangles.as_flattened(), 3, mesh.nodes.len() / 2),
            None => {
                let tets = &model.need_tets(needs)?.tets;
                (tets.as_flattened(), 4, mesh.nodes.len())
            }
        };
        let below = |n: &u32| (*n as usize) < nodes;
        let named = groups(mesh).into_iter().map(|group| {
            let mut named = Named {
                name: group.name,
                number: group.number,
                sides: Lists::default(),
                cells: Vec::new(),
            };
            for f in group.faces {
                // Of a layer's upright faces the lower edge.
                let side = || mesh.faces.get(f as usize).iter().copied().filter(below);
                if size == 4 || side().count() == 2 {
                    named.sides.push(side());
                    named.cells.push(mesh.face_cells[f as usize][0]);
                }
            }
            named
        });
        Ok(Self {
            nodes: &mesh.nodes[..nodes],
            corners,
            size,
            region: &mesh.region,
            named: named.filter(|named| !named.cells.is_empty()).collect(),
        })
    }

    /// Number of simplices.
    pub fn len(&self) -> usize {
        self.corners.len() / self.size
    }

    /// The nodes of one.
    pub fn get(&self, i: usize) -> &[u32] {
        &self.corners[i * self.size..][..self.size]
    }

    /// Number of sides that have a name.
    pub fn sides(&self) -> usize {
        self.named.iter().map(|named| named.cells.len()).sum()
    }
}
