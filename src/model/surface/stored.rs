//! The surfaces of a mesh that a file holds.

use super::{Options, Surfaces, select};
use crate::mesh::Mesh;
use crate::store::StoredMesh;

/// Groups facets of a mesh into surfaces, in lattice space.
pub fn group<const D: usize, M: Mesh<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let horizons = horizon_facets(stored);
    Surfaces::find(stored.lattice.nodes(), facets, &horizons, options)
}

/// The facets of a mesh that lie on horizons, nodes ascending, sorted.
pub fn horizon_facets<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<[u32; D]> {
    match stored.horizons.as_slice() {
        [] => Vec::new(),
        marks => select::marked(&stored.lattice, marks),
    }
}
