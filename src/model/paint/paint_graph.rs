//! The graph of cells through which paint flows, which does not depend on the seeds.

use std::sync::Arc;

use super::blocks;
use crate::Result;
use crate::memory::LastValue;
use crate::mesh::Mesh;
use crate::model::geodesics::Geodesics;
use crate::model::surface::adjacency::{CellAdjacency, CellLocator};

/// Smallest number of cells of a compartment; smaller ones are fragments between surfaces.
const MIN_COMPARTMENT_CELLS: usize = 24;

/// The graph of the mesh that was painted last. Paint of the same mesh with other seeds takes it over.
#[derive(Debug, Default)]
pub struct PaintCache(LastValue);

/// The cells of a mesh, the surfaces between them, and their blocks.
#[derive(Debug)]
pub(super) struct PaintGraph<const D: usize, M> {
    /// The mesh, the facets on its surfaces, and the value of the option `neck`.
    input: (M, Vec<[u32; D]>, f64),
    /// The cells on both sides of each face.
    pub face_cells: Vec<[u32; 2]>,
    /// The shortest paths through the cells.
    pub geodesics: Geodesics<CellAdjacency<D>, D>,
    /// Finds the cells of seeds.
    pub locator: CellLocator<D>,
    /// The block of each cell.
    pub block: Vec<u32>,
    /// The number of blocks.
    pub block_count: usize,
}

impl<const D: usize, M: Mesh<D> + Clone + PartialEq + Send + Sync + 'static> PaintGraph<D, M> {
    /// Returns the graph of a mesh: that in the cache if it is the same, or a new one. Facets in
    /// `closed` (nodes ascending, sorted) lie on surfaces.
    ///
    /// # Errors
    /// Returns the errors of [`Mesh::cells_of_faces`].
    pub fn get(
        mesh: &M,
        closed: Vec<[u32; D]>,
        neck: f64,
        cache: Option<&PaintCache>,
    ) -> Result<Arc<Self>> {
        let Some(PaintCache(last)) = cache else {
            return Ok(Arc::new(Self::new(mesh, closed, neck)?));
        };
        let fits = |known: &Self| {
            let (known_mesh, known_closed, known_neck) = &known.input;
            known_mesh == mesh && *known_closed == closed && *known_neck == neck
        };
        last.get_or_make(fits, || Self::new(mesh, closed.clone(), neck))
    }

    fn new(mesh: &M, closed: Vec<[u32; D]>, neck: f64) -> Result<Self> {
        let face_cells = mesh.cells_of_faces()?;
        let cells = CellAdjacency::new(mesh, &face_cells, &closed);
        let (block, block_count) = blocks(&cells, neck, MIN_COMPARTMENT_CELLS);
        Ok(Self {
            geodesics: Geodesics::new(mesh, &face_cells, cells),
            locator: CellLocator::new(mesh, &face_cells),
            input: (mesh.clone(), closed, neck),
            face_cells,
            block,
            block_count,
        })
    }
}
