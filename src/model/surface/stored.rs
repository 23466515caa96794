//! The surfaces of a mesh that a file holds.

use super::kind::{Kind, kinds};
use super::{Options, Surfaces, select};
use crate::mesh::Mesh;
use crate::store::StoredMesh;

/// All surfaces of a mesh, with the numbers that `atomesh surface` gives them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Numbered<const D: usize> {
    /// The kind of surface 1, 2 ...
    pub kinds: Vec<Kind>,
    /// How many of them, the first, are large enough to be kept with default options.
    pub kept: usize,
    /// The facets of all surfaces, nodes ascending, sorted, each with the number of its surface.
    pub facets: Vec<([u32; D], u32)>,
}

/// The surfaces of a mesh whose marked faces lie on features: those of any size, with the numbers that
/// they have with default options, from 1; gaps in them are closed, and crumbs that touch one are part
/// of it.
pub fn numbered<const D: usize, M: Mesh<D>>(
    stored: &StoredMesh<D, M>,
    marks: &[bool],
) -> Numbered<D> {
    let options = Options {
        min_area: Some(0.0),
        ..Options::default()
    };
    let surfaces = group(stored, select::marked(&stored.lattice, marks), &options);
    let nodes = stored.lattice.nodes();
    let part_of = surfaces.adopted(nodes);
    let mut facets: Vec<([u32; D], u32)> = (surfaces.facets.iter())
        .zip(surfaces.labels())
        .map(|(facet, surface)| {
            let mut facet = *facet;
            facet.sort_unstable();
            (facet, part_of[surface as usize] + 1)
        })
        .collect();
    facets.sort_unstable();
    Numbered {
        kinds: kinds(&surfaces, nodes, &horizon_facets(stored)),
        kept: surfaces.usual(nodes),
        facets,
    }
}

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
