//! The surfaces of a mesh that a file holds.

use super::{Options, Surfaces, select};
use crate::store::file::Placed;
use crate::store::stored::Stored;

/// Groups facets of a mesh into surfaces and closes their gaps, in lattice space.
pub fn group<const D: usize, M: Stored<D>>(
    placed: &Placed<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let candidates = select::spanned(&placed.lattice, &facets);
    Surfaces::find(
        placed.lattice.node_positions(),
        facets,
        &candidates,
        options,
    )
}

/// The facets of a mesh that lie on horizons, nodes ascending, sorted.
pub fn horizon_facets<const D: usize, M: Stored<D>>(placed: &Placed<D, M>) -> Vec<[u32; D]> {
    match placed.horizons.as_slice() {
        [] => Vec::new(),
        marks => select::marked(&placed.lattice, marks),
    }
}
