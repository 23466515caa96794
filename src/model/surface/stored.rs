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
    /// The names of the first, as far as the file has names.
    pub names: Vec<String>,
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
    let nodes = stored.lattice.nodes();
    let facets = select::marked(&stored.lattice, marks);
    let (named, surfaces) = parted(stored, facets, &options);
    // What has a name is a surface by itself, whatever its size.
    let before = named.len() as u32;
    let adopted = surfaces.adopted(nodes);
    let part_of: Vec<u32> = (0..before)
        .chain(adopted.iter().map(|surface| surface + before))
        .collect();
    let kept = named.len() + surfaces.usual(nodes);
    let surfaces = surfaces.behind(stored.named.names.clone(), named);
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
        names: surfaces.names,
        kept,
        facets,
    }
}

/// Groups facets of a mesh into surfaces, in lattice space: first those that have names in its file.
pub fn group<const D: usize, M: Mesh<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let (named, surfaces) = parted(stored, facets, options);
    let named = stored.named.names.iter().cloned().zip(named);
    let (names, named) = named.filter(|(_, facets)| !facets.is_empty()).unzip();
    surfaces.behind(names, named)
}

/// The facets of each surface that has a name, and the surfaces of the others.
fn parted<const D: usize, M: Mesh<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> (Vec<Vec<[u32; D]>>, Surfaces<D>) {
    let by_name = facets_by_name(stored);
    let mut named = vec![Vec::new(); stored.named.names.len()];
    let mut others = Vec::new();
    for facet in facets {
        let mut sorted = facet;
        sorted.sort_unstable();
        match by_name.binary_search_by(|known| known.0.cmp(&sorted)) {
            Ok(at) => named[by_name[at].1 as usize - 1].push(facet),
            Err(_) => others.push(facet),
        }
    }
    let horizons = horizon_facets(stored);
    let others = Surfaces::find(stored.lattice.nodes(), others, &horizons, options);
    (named, others)
}

/// Facets that have the name of a surface, nodes ascending, sorted, each with its number.
fn facets_by_name<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<([u32; D], u32)> {
    let mut found = Vec::new();
    if stored.named.names.is_empty() {
        return found;
    }
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    for (face, &cells) in cells.iter().enumerate() {
        if let Some(number) = stored.named.between(cells) {
            stored.lattice.facets(face, |mut facet| {
                facet.sort_unstable();
                found.push((facet, number));
            });
        }
    }
    found.sort_unstable();
    found
}

/// The facets of a mesh that lie on horizons, nodes ascending, sorted.
pub fn horizon_facets<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<[u32; D]> {
    match stored.horizons.as_slice() {
        [] => Vec::new(),
        marks => select::marked(&stored.lattice, marks),
    }
}
