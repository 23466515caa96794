//! The surfaces of a mesh from a file.

use super::fault_extension::{ExtendedFault, Extension, extensions};
use super::kind::{SurfaceKind, surface_kinds};
use super::names::{SurfaceNames, interface_name};
use super::{Options, Surfaces, facet_selection};
use crate::error::cause;
use crate::geometry::{norm, normal, sorted_distinct};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::mesh_file::CUT_NAME;
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::names::append_distinct;
use crate::store::{LabelledRegion, Storable, StoredMesh, read_labels};
use crate::{Error, Result};

/// All surfaces of a mesh, with the numbers that `atomesh surface` gives them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NumberedSurfaces<const D: usize> {
    /// The kinds of surfaces 1, 2 ...
    pub kinds: Vec<SurfaceKind>,
    /// The names of the first surfaces, if the file has names.
    pub names: Vec<String>,
    /// Number of surfaces, from the first, that are large enough to be kept with default options.
    pub kept_count: usize,
    /// The facets of all surfaces (nodes ascending, sorted), each with the number of its surface.
    pub facets: Vec<([u32; D], u32)>,
}

impl<const D: usize> NumberedSurfaces<D> {
    /// Returns the names of all surfaces.
    pub fn all_names(&self) -> SurfaceNames {
        SurfaceNames::new(&self.kinds, self.kept_count, &self.names, &[])
    }

    /// Adds the interfaces for whose names `selects` is `true` as surfaces. Only facets that lie on
    /// no other surface are added.
    pub fn add_interfaces(&mut self, interfaces: Interfaces<D>, selects: impl Fn(&str) -> bool) {
        let mut free_facets: Vec<Vec<[u32; D]>> = vec![Vec::new(); interfaces.names.len()];
        for (facet, number) in interfaces.facets {
            let position = self.facets.binary_search_by(|entry| entry.0.cmp(&facet));
            if position.is_err() && selects(&interfaces.names[number as usize - 1]) {
                free_facets[number as usize - 1].push(facet);
            }
        }
        let non_empty =
            (interfaces.names.into_iter().zip(free_facets)).filter(|(_, list)| !list.is_empty());
        let (names, facet_lists): (Vec<String>, Vec<_>) = non_empty.unzip();
        if names.is_empty() {
            return;
        }
        self.add_surfaces(names, SurfaceKind::Interface, facet_lists);
    }

    /// Adds surfaces of one kind after those that are kept, with these names and facets, which lie
    /// on no other surface.
    fn add_surfaces(
        &mut self,
        names: Vec<String>,
        kind: SurfaceKind,
        facet_lists: Vec<Vec<[u32; D]>>,
    ) {
        let (kept_count, count) = (self.kept_count as u32, names.len());
        for entry in self.facets.iter_mut().filter(|facet| facet.1 > kept_count) {
            entry.1 += count as u32;
        }
        for (number, list) in (kept_count + 1..).zip(facet_lists) {
            self.facets
                .extend(list.into_iter().map(|facet| (facet, number)));
        }
        self.facets.sort_unstable();
        self.names = self.all_names().names;
        self.names.extend(names);
        let added = std::iter::repeat_n(kind, count);
        self.kinds.splice(self.kept_count..self.kept_count, added);
        self.kept_count += count;
    }

    /// Extends all faults by up to `max_distance`, along the faces of these cells, which have the
    /// nodes of the mesh. Each extension becomes a fault of its own. Returns the number of the
    /// extended fault of each extension, and its description.
    pub fn extend_faults(
        &mut self,
        cells: &PolyMesh<D>,
        max_distance: f64,
    ) -> Vec<(u32, ExtendedFault)> {
        let graph = Graph::from_poly(cells);
        let mut labels = facet_selection::labels_of_faces(cells, &self.facets);
        labels.truncate(graph.connections.len());
        let is_fault = |surface: &u32| self.kinds[*surface as usize - 1] == SurfaceKind::Fault;
        let faults = (1..=self.kept_count as u32).filter(is_fault);
        let faults: Vec<u32> = faults.collect();
        let found = extensions(&graph, labels, &self.kinds, &faults, max_distance);
        let mut names = self.all_names().names;
        let known_count = names.len();
        let fault_name = |extension: &Extension| names[extension.surface as usize - 1].clone();
        let faults: Vec<String> = found.iter().map(fault_name).collect();
        let new_names = faults.iter().map(|name| format!("{name}_extension"));
        append_distinct(&mut names, new_names.collect::<Vec<_>>());
        let new_names = names.split_off(known_count);
        let facets_of = |extension: &Extension| {
            let mut facets = Vec::new();
            for &connection in &extension.connections {
                cells.facets(connection, |mut facet| {
                    facet.sort_unstable();
                    facets.push(facet);
                });
            }
            sorted_distinct(facets)
        };
        let lists: Vec<Vec<[u32; D]>> = found.iter().map(facets_of).collect();
        // An extension goes on through horizons.
        let taken = sorted_distinct(lists.concat());
        self.facets
            .retain(|(facet, _)| taken.binary_search(facet).is_err());
        let described = (found.iter().zip(&faults).zip(&new_names))
            .map(|((found, fault), name)| (found.surface, found.extended_fault(fault, name)));
        let described = described.collect();
        self.add_surfaces(new_names, SurfaceKind::Fault, lists);
        described
    }
}

/// Returns the facets that the mesh declares to lie on features. `name` is that of the mesh in
/// messages.
///
/// # Errors
/// Returns [`Error::Mesh`] if it declares none.
pub(crate) fn tagged_facets<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    name: &str,
) -> Result<Vec<[u32; D]>> {
    let marks = stored.feature_marks();
    let facets = marks.map(|marks| facet_selection::marked_facets(&stored.lattice, &marks));
    let refuse = |problem: &str, remedy: &str| Err(Error::Mesh(cause(name, problem, remedy)));
    match facets {
        None => refuse(
            "does not say which faces lie on features (no cell data feature_faces)",
            "give a mesh that atomesh mesh wrote",
        ),
        Some(facets) if facets.is_empty() => refuse(
            "has no face on a feature: no feature was found in its image, or slivers were not removed",
            "mesh the image again, with another --feature or a lower --threshold",
        ),
        Some(facets) => Ok(facets),
    }
}

/// Returns the surfaces of a mesh; `marks` is `true` for faces on features. Surfaces of any size
/// are included, and numbers are those with default options, from 1. Gaps in surfaces are closed,
/// and fragments that touch a surface belong to it. The interface between two labels of an image is
/// one surface, whatever its shape.
pub fn numbered_surfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    marks: &[bool],
) -> NumberedSurfaces<D> {
    number_surfaces(stored, marks, &interfaces(stored))
}

/// Returns the surfaces of a mesh as [`numbered_surfaces`] does, but also divides interfaces
/// between labels where they bend. No kind is [`SurfaceKind::Interface`].
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
    // A surface with a name is never part of another one, whatever its size.
    let named_count = named.facets.len() as u32;
    let parents = surfaces.fragment_parents(nodes);
    let parent: Vec<u32> = (0..named_count)
        .chain(parents.iter().map(|surface| surface + named_count))
        .collect();
    let kept_count =
        named_count as usize + surfaces.count_above_min_area(nodes, named.largest_area);
    let surfaces = surfaces.append_to_named(named.names, named.facets, named.interfaces);
    let mut facets: Vec<([u32; D], u32)> = (surfaces.facets.iter())
        .zip(surfaces.labels())
        .map(|(facet, surface)| {
            let mut facet = *facet;
            facet.sort_unstable();
            (facet, parent[surface as usize] + 1)
        })
        .collect();
    facets.sort_unstable();
    NumberedSurfaces {
        kinds: surface_kinds(&surfaces, nodes, &horizon_facets(stored)),
        names: surfaces.names,
        kept_count,
        facets,
    }
}

/// Groups facets of a mesh into surfaces, in lattice space. Surfaces with names in the file come
/// first, then interfaces between labels of an image, then the others.
pub fn group_facets<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let (named, surfaces) = split_by_name(stored, facets, &interfaces(stored), options);
    surfaces.append_to_named(named.names, named.facets, named.interfaces)
}

/// Surfaces with names.
struct NamedFacets<const D: usize> {
    names: Vec<String>,
    facets: Vec<Vec<[u32; D]>>,
    /// The range of the surfaces that are interfaces between labels.
    interfaces: std::ops::Range<usize>,
    /// Area in lattice space of the largest surface with a name in the file.
    largest_area: f64,
}

/// Returns the facets of each surface with a name, and the surfaces of all other facets.
fn split_by_name<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    interfaces: &Interfaces<D>,
    options: &Options,
) -> (NamedFacets<D>, Surfaces<D>) {
    let by_name = facets_by_name(stored);
    let file_name_count = stored.named_surfaces.names.len();
    let mut named = vec![Vec::new(); file_name_count + interfaces.names.len()];
    let mut others = Vec::new();
    for facet in facets {
        let mut sorted = facet;
        sorted.sort_unstable();
        let surface_index = |known: &[([u32; D], u32)]| {
            let position = known.binary_search_by(|entry| entry.0.cmp(&sorted));
            position.ok().map(|index| known[index].1 as usize - 1)
        };
        let interface = || surface_index(&interfaces.facets).map(|index| index + file_name_count);
        match surface_index(&by_name).or_else(interface) {
            Some(index) => named[index].push(facet),
            None => others.push(facet),
        }
    }
    let horizons = horizon_facets(stored);
    let nodes = stored.lattice.nodes();
    let area = |facet: &[u32; D]| norm(normal(&facet.map(|n| nodes[n as usize])));
    let file_areas = named[..file_name_count].iter();
    let largest_area = file_areas
        .map(|facets| facets.iter().map(area).sum::<f64>())
        .fold(0.0, f64::max);
    let options = Options {
        known_area: largest_area,
        ..*options
    };
    let others = Surfaces::find(nodes, others, &horizons, &options);
    let names = stored
        .named_surfaces
        .names
        .iter()
        .chain(&interfaces.names)
        .cloned();
    let count_non_empty =
        |range: std::ops::Range<usize>| named[range].iter().filter(|list| !list.is_empty()).count();
    let interface_start = count_non_empty(0..file_name_count);
    let interface_end = interface_start + count_non_empty(file_name_count..named.len());
    let (names, facets) = (names.zip(named))
        .filter(|(_, facets)| !facets.is_empty())
        .unzip();
    let named = NamedFacets {
        names,
        facets,
        interfaces: interface_start..interface_end,
        largest_area,
    };
    (named, others)
}

/// Interfaces between regions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Interfaces<const D: usize> {
    /// The names of interfaces 1, 2 ..., sorted by the smaller and then by the larger number of
    /// their regions.
    pub names: Vec<String>,
    /// The facets (nodes ascending, sorted), each with the number of its interface.
    pub facets: Vec<([u32; D], u32)>,
}

/// Returns the interfaces between the regions of a mesh if these are labels of an image; otherwise
/// none.
fn interfaces<const D: usize, M: Storable<D>>(stored: &StoredMesh<D, M>) -> Interfaces<D> {
    match (read_labels(&stored.arrays).is_empty(), stored.regions()) {
        (false, Some(region)) => find_interfaces(stored, &region),
        _ => Interfaces::default(),
    }
}

/// Finds the interfaces between regions. `region` holds the region of each cell.
pub fn find_interfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    region: &[i32],
) -> Interfaces<D> {
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    let mut pair_facets: Vec<([i32; 2], [u32; D])> = Vec::new();
    for (face, cells) in cells.into_iter().enumerate() {
        let [Some(&a), Some(&b)] = cells.map(|cell| region.get(cell as usize)) else {
            continue;
        };
        if a != b {
            stored.lattice.facets(face, |mut facet| {
                facet.sort_unstable();
                pair_facets.push(([a.min(b), a.max(b)], facet));
            });
        }
    }
    let pairs = sorted_distinct(pair_facets.iter().map(|entry| entry.0));
    let labels = read_labels(&stored.arrays);
    let mut names = Vec::new();
    let interface_names = pairs.iter().map(|pair| {
        let [a, b] = pair.map(|region| region_label(&labels, region));
        interface_name([&a, &b])
    });
    append_distinct(&mut names, interface_names);
    let interface_number = |pair| pairs.partition_point(|known| *known < pair) as u32 + 1;
    let mut facets: Vec<_> = (pair_facets.into_iter())
        .map(|(pair, facet)| (facet, interface_number(pair)))
        .collect();
    add_outer_interfaces(stored, &mut names, &mut facets);
    facets.sort_unstable();
    Interfaces { names, facets }
}

/// Adds the interfaces with regions that were left out, which bound the mesh.
fn add_outer_interfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    names: &mut Vec<String>,
    facets: &mut Vec<([u32; D], u32)>,
) {
    let Some(outer) = &stored.outer else {
        return;
    };
    let known = names.len() as u32;
    append_distinct(names, outer.names.iter().cloned());
    let outer_facets = outer_facets(stored).into_iter();
    let is_interface = |set: u32| outer.names[set as usize] != CUT_NAME;
    facets.extend(
        outer_facets
            .filter(|&(_, set)| is_interface(set))
            .map(|(facet, set)| (facet, known + set + 1)),
    );
}

/// Returns the facets at which cells were left out (nodes ascending, sorted), each with the number of its
/// set in [`OuterBoundary::names`](crate::mesh::check::OuterBoundary).
pub fn outer_facets<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
) -> Vec<([u32; D], u32)> {
    let mut facets = Vec::new();
    let Some(outer) = &stored.outer else {
        return facets;
    };
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    let boundary = cells.iter().enumerate();
    for (face, _) in boundary.filter(|(_, [cell, beyond])| *cell != NONE && *beyond == NONE) {
        if let Some(set) = outer.set_of(&stored.lattice.nodes_of_face(face)) {
            stored.lattice.facets(face, |mut facet| {
                facet.sort_unstable();
                facets.push((facet, set));
            });
        }
    }
    facets.sort_unstable();
    facets
}

/// Returns the name of a region: the name or else the value of its label, or its number.
pub fn region_label(labels: &[LabelledRegion], region: i32) -> String {
    match labels.iter().find(|label| label.region == region) {
        Some(label) => (label.name.clone()).unwrap_or_else(|| label.label.to_string()),
        None => region.to_string(),
    }
}

/// Returns the facets of surfaces with names (nodes ascending, sorted), each with the number of its
/// surface.
fn facets_by_name<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<([u32; D], u32)> {
    let mut facets = Vec::new();
    if stored.named_surfaces.names.is_empty() {
        return facets;
    }
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    for (face, &cells) in cells.iter().enumerate() {
        if let Some(number) = stored.named_surfaces.surface_between(cells) {
            stored.lattice.facets(face, |mut facet| {
                facet.sort_unstable();
                facets.push((facet, number));
            });
        }
    }
    facets.sort_unstable();
    facets
}

/// Returns the faces of surfaces as a file of the mesh stores them, with a name for each surface.
pub fn named_faces<const D: usize, M: Mesh<D>>(
    stored: &StoredMesh<D, M>,
    surfaces: &Surfaces<D>,
    names: &[String],
) -> NamedSurfaces {
    let facets = surfaces.facets.iter().zip(surfaces.labels());
    let mut facets: Vec<([u32; D], u32)> = facets
        .map(|(facet, surface)| {
            let mut sorted = *facet;
            sorted.sort_unstable();
            (sorted, surface)
        })
        .collect();
    facets.sort_unstable();
    let mut faces = Vec::new();
    // A mesh with a face of three cells is refused elsewhere.
    let cells = stored.lattice.cells_of_faces().unwrap_or_default();
    for (face, mut cells) in cells.into_iter().enumerate() {
        if cells.contains(&NONE) {
            continue;
        }
        cells.sort_unstable();
        stored.lattice.facets(face, |mut facet| {
            facet.sort_unstable();
            if let Ok(i) = facets.binary_search_by(|entry| entry.0.cmp(&facet)) {
                faces.push((cells, facets[i].1));
            }
        });
    }
    NamedSurfaces::new(names, faces)
}

/// Returns the facets of a mesh that lie on horizons (nodes ascending, sorted).
pub fn horizon_facets<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<[u32; D]> {
    match stored.is_horizon_face.as_slice() {
        [] => Vec::new(),
        marks => facet_selection::marked_facets(&stored.lattice, marks),
    }
}
