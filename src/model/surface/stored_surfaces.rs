//! The surfaces of a mesh that a file holds.

use super::kind::{SurfaceKind, surface_kinds};
use super::names::{SurfaceNames, add_names, interface_name};
use super::{Options, Surfaces, facet_selection};
use crate::mesh::Mesh;
use crate::store::{LabelledRegion, Storable, StoredMesh, read_labels};

/// All surfaces of a mesh, with the numbers that `atomesh surface` gives them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NumberedSurfaces<const D: usize> {
    /// The kind of surface 1, 2 ...
    pub kinds: Vec<SurfaceKind>,
    /// The names of the first, as far as the file has names.
    pub names: Vec<String>,
    /// How many of them, the first, are large enough to be kept with default options.
    pub kept_count: usize,
    /// The facets of all surfaces, nodes ascending, sorted, each with the number of its surface.
    pub facets: Vec<([u32; D], u32)>,
}

impl<const D: usize> NumberedSurfaces<D> {
    /// The names of all surfaces.
    pub fn all_names(&self) -> SurfaceNames {
        SurfaceNames::new(&self.kinds, self.kept_count, &self.names, &[])
    }

    /// Makes surfaces of those interfaces that are `wanted`, where they are on no other.
    pub fn add_interfaces(&mut self, interfaces: Interfaces<D>, wanted: impl Fn(&str) -> bool) {
        let mut bare: Vec<Vec<[u32; D]>> = vec![Vec::new(); interfaces.names.len()];
        for (facet, number) in interfaces.facets {
            let known = self.facets.binary_search_by(|known| known.0.cmp(&facet));
            if known.is_err() && wanted(&interfaces.names[number as usize - 1]) {
                bare[number as usize - 1].push(facet);
            }
        }
        let added = (interfaces.names.into_iter().zip(bare)).filter(|(_, own)| !own.is_empty());
        let (names, bare): (Vec<String>, Vec<_>) = added.unzip();
        if names.is_empty() {
            return;
        }
        let (kept, count) = (self.kept_count as u32, names.len());
        for scrap in self.facets.iter_mut().filter(|facet| facet.1 > kept) {
            scrap.1 += count as u32;
        }
        for (number, own) in (kept + 1..).zip(bare) {
            self.facets
                .extend(own.into_iter().map(|facet| (facet, number)));
        }
        self.facets.sort_unstable();
        self.names = self.all_names().names;
        self.names.extend(names);
        let interfaces = std::iter::repeat_n(SurfaceKind::Interface, count);
        self.kinds
            .splice(self.kept_count..self.kept_count, interfaces);
        self.kept_count += count;
    }
}

/// The surfaces of a mesh whose marked faces lie on features: those of any size, with the numbers that
/// they have with default options, from 1; gaps in them are closed, and crumbs that touch one are part
/// of it. What parts two labels of an image is a surface by itself, whatever its shape.
pub fn numbered_surfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    marks: &[bool],
) -> NumberedSurfaces<D> {
    number_surfaces(stored, marks, &interfaces(stored))
}

/// The same, but surfaces that part labels are told apart by how they bend, too, and no kind is
/// [`SurfaceKind::Interface`].
pub fn surfaces_by_bend<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    marks: &[bool],
) -> NumberedSurfaces<D> {
    number_surfaces(stored, marks, &Interfaces::default())
}

fn number_surfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    marks: &[bool],
    interfaces: &Interfaces<D>,
) -> NumberedSurfaces<D> {
    let options = Options {
        min_area: Some(0.0),
        ..Options::default()
    };
    let nodes = stored.lattice.nodes();
    let facets = facet_selection::marked_facets(&stored.lattice, marks);
    let (named, surfaces) = split_by_name(stored, facets, interfaces, &options);
    // What has a name is a surface by itself, whatever its size.
    let before = named.facets.len() as u32;
    let adopted = surfaces.fragment_parents(nodes);
    let part_of: Vec<u32> = (0..before)
        .chain(adopted.iter().map(|surface| surface + before))
        .collect();
    let kept = before as usize + surfaces.count_above_min_area(nodes);
    let surfaces = surfaces.append_to_named(named.names, named.facets, named.interfaces);
    let mut facets: Vec<([u32; D], u32)> = (surfaces.facets.iter())
        .zip(surfaces.labels())
        .map(|(facet, surface)| {
            let mut facet = *facet;
            facet.sort_unstable();
            (facet, part_of[surface as usize] + 1)
        })
        .collect();
    facets.sort_unstable();
    NumberedSurfaces {
        kinds: surface_kinds(&surfaces, nodes, &horizon_facets(stored)),
        names: surfaces.names,
        kept_count: kept,
        facets,
    }
}

/// Groups facets of a mesh into surfaces, in lattice space: first those that have names in its file, then
/// those that part labels of an image.
pub fn group_facets<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let (named, surfaces) = split_by_name(stored, facets, &interfaces(stored), options);
    surfaces.append_to_named(named.names, named.facets, named.interfaces)
}

/// Surfaces that have names.
struct NamedFacets<const D: usize> {
    names: Vec<String>,
    facets: Vec<Vec<[u32; D]>>,
    /// Which of them part two labels.
    interfaces: std::ops::Range<usize>,
}

/// The facets of each surface that has a name, and the surfaces of the others.
fn split_by_name<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    interfaces: &Interfaces<D>,
    options: &Options,
) -> (NamedFacets<D>, Surfaces<D>) {
    let by_name = facets_by_name(stored);
    let before = stored.named_surfaces.names.len();
    let mut named = vec![Vec::new(); before + interfaces.names.len()];
    let mut others = Vec::new();
    for facet in facets {
        let mut sorted = facet;
        sorted.sort_unstable();
        let number = |known: &[([u32; D], u32)]| {
            let at = known.binary_search_by(|known| known.0.cmp(&sorted));
            at.ok().map(|at| known[at].1 as usize - 1)
        };
        let interface = || number(&interfaces.facets).map(|at| at + before);
        match number(&by_name).or_else(interface) {
            Some(at) => named[at].push(facet),
            None => others.push(facet),
        }
    }
    let horizons = horizon_facets(stored);
    let others = Surfaces::find(stored.lattice.nodes(), others, &horizons, options);
    let names = stored
        .named_surfaces
        .names
        .iter()
        .chain(&interfaces.names)
        .cloned();
    let with_facets =
        |range: std::ops::Range<usize>| named[range].iter().filter(|own| !own.is_empty()).count();
    let first = with_facets(0..before);
    let count = first + with_facets(before..named.len());
    let (names, facets) = (names.zip(named))
        .filter(|(_, facets)| !facets.is_empty())
        .unzip();
    let named = NamedFacets {
        names,
        facets,
        interfaces: first..count,
    };
    (named, others)
}

/// What parts regions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Interfaces<const D: usize> {
    /// The name of interface 1, 2 ..., by the smaller and then by the larger number of its regions.
    pub names: Vec<String>,
    /// Facets, nodes ascending, sorted, each with the number of its interface.
    pub facets: Vec<([u32; D], u32)>,
}

/// What parts the regions of a mesh, if these are labels of an image; else nothing.
fn interfaces<const D: usize, M: Storable<D>>(stored: &StoredMesh<D, M>) -> Interfaces<D> {
    match (read_labels(&stored.arrays).is_empty(), stored.regions()) {
        (false, Some(region)) => find_interfaces(stored, &region),
        _ => Interfaces::default(),
    }
}

/// What parts regions, of which `region` has that of each cell.
pub fn find_interfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    region: &[i32],
) -> Interfaces<D> {
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    let mut found: Vec<([i32; 2], [u32; D])> = Vec::new();
    for (face, cells) in cells.into_iter().enumerate() {
        let [Some(&a), Some(&b)] = cells.map(|cell| region.get(cell as usize)) else {
            continue;
        };
        if a != b {
            stored.lattice.facets(face, |mut facet| {
                facet.sort_unstable();
                found.push(([a.min(b), a.max(b)], facet));
            });
        }
    }
    let mut pairs: Vec<[i32; 2]> = found.iter().map(|found| found.0).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let labels = read_labels(&stored.arrays);
    let mut names = Vec::new();
    let called = pairs.iter().map(|pair| {
        let [a, b] = pair.map(|region| region_label(&labels, region));
        interface_name([&a, &b])
    });
    add_names(&mut names, called);
    let number = |pair| pairs.partition_point(|known| *known < pair) as u32 + 1;
    let mut facets: Vec<_> = (found.into_iter())
        .map(|(pair, facet)| (facet, number(pair)))
        .collect();
    facets.sort_unstable();
    Interfaces { names, facets }
}

/// What a region is called in names: as its label is, or by its number.
pub fn region_label(labels: &[LabelledRegion], region: i32) -> String {
    let label = labels.iter().find(|label| label.region == region);
    let name = label.and_then(|label| label.name.clone());
    name.unwrap_or_else(|| region.to_string())
}

/// Facets that have the name of a surface, nodes ascending, sorted, each with its number.
fn facets_by_name<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<([u32; D], u32)> {
    let mut found = Vec::new();
    if stored.named_surfaces.names.is_empty() {
        return found;
    }
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    for (face, &cells) in cells.iter().enumerate() {
        if let Some(number) = stored.named_surfaces.surface_between(cells) {
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
    match stored.is_horizon_face.as_slice() {
        [] => Vec::new(),
        marks => facet_selection::marked_facets(&stored.lattice, marks),
    }
}
