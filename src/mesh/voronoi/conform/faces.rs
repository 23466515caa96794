//! Finds the faces of Voronoi cells that lie on a surface.

use crate::parallel::prelude::*;

use super::{ConformingSites, FacetSurface};
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, norm, normal, sorted_distinct, sub};
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;

impl<const D: usize> ConformingSites<D> {
    /// Returns for each face whether it lies on the surface: faces between the two sites of a
    /// facet, and faces whose connection passes through the surface. So every path from cell to
    /// cell that crosses the surface passes through such a face. The [`sites`](Self::sites) are
    /// those of the cells from `first_site` on.
    pub fn faces_on_surface(&self, mesh: &PolyMesh<D>, first_site: usize) -> Vec<bool> {
        let mut on_surface = vec![false; mesh.face_cells.len()];
        let facets = FacetGrid::new(self.surface());
        let pairs = self.sorted_pairs();
        let inner = mesh.inner_face_count();
        let is_on_surface = |f: usize| {
            let [a, b] = mesh.face_cells[f].map(|c| mesh.sites[c as usize]);
            is_between_sites(&pairs, mesh, f, first_site) || facets.separates(a, b)
        };
        let marks: Vec<bool> = (0..inner).into_par_iter().map(is_on_surface).collect();
        on_surface[..inner].copy_from_slice(&marks);
        on_surface
    }

    /// Returns for each face the index of the name of the surface on which it lies, or `NONE`; empty
    /// if no surface has a name. Of surfaces that both pass between two cells, that with the lowest
    /// index counts. So every path from cell to cell that crosses a surface alone passes through a face
    /// with its name. The [`sites`](Self::sites) are those of the cells from `first_site` on.
    pub fn names_of_faces(&self, mesh: &PolyMesh<D>, first_site: usize) -> Vec<u32> {
        let surface = self.surface();
        if surface.names.is_empty() {
            return Vec::new();
        }
        let facets = NamedFacets::new(surface);
        let grids = facets.grids();
        let facet_of_pair = sorted_distinct(self.site_pairs().into_iter().zip(self.facets.clone()));
        let inner = mesh.inner_face_count();
        let name_of = |f: usize| {
            let [a, b] = mesh.face_cells[f].map(|c| mesh.sites[c as usize]);
            let exact = sites_of_face(mesh, f, first_site).and_then(|pair| {
                let index = facet_of_pair.binary_search_by_key(&pair, |entry| entry.0);
                index.ok().map(|i| surface.name_of(facet_of_pair[i].1))
            });
            let crossed = grids.iter().find(|(_, grid)| grid.separates(a, b));
            exact
                .unwrap_or(NONE)
                .min(crossed.map_or(NONE, |(name, _)| *name))
        };
        let names = (0..mesh.face_cells.len()).into_par_iter();
        names
            .map(|f| if f < inner { name_of(f) } else { NONE })
            .collect()
    }

    /// Returns the area of the faces between the two sites of a facet, which lie in the facet's
    /// plane, relative to the area of the surface; 1 if the surface has no area. Faces may reach
    /// beyond the rim of a surface, so the share is limited to 1.
    pub fn covered_share(&self, mesh: &PolyMesh<D>, first_site: usize) -> f64 {
        let surface = self.surface();
        let areas = (0..surface.facets.len()).map(|f| norm(normal(&surface.corners(f))));
        let pairs = self.sorted_pairs();
        let faces =
            (0..mesh.inner_face_count()).filter(|&f| is_between_sites(&pairs, mesh, f, first_site));
        let covered: f64 = faces.map(|f| mesh.face_shape(f).area()).sum();
        match areas.sum::<f64>() {
            all if all > 0.0 => (covered / all).min(1.0),
            _ => 1.0,
        }
    }

    fn sorted_pairs(&self) -> Vec<[u32; 2]> {
        let mut pairs = self.site_pairs();
        pairs.par_sort_unstable();
        pairs
    }
}

/// Returns `true` if a face is between the two sites of one facet, which `pairs` holds ascending.
fn is_between_sites<const D: usize>(
    pairs: &[[u32; 2]],
    mesh: &PolyMesh<D>,
    face: usize,
    first_site: usize,
) -> bool {
    sites_of_face(mesh, face, first_site).is_some_and(|pair| pairs.binary_search(&pair).is_ok())
}

/// Returns the two sites of a face, if its cells have sites: those from `first_site` on.
fn sites_of_face<const D: usize>(
    mesh: &PolyMesh<D>,
    face: usize,
    first_site: usize,
) -> Option<[u32; 2]> {
    let [a, b] = mesh.face_cells[face].map(|c| (c as usize).checked_sub(first_site));
    Some([a? as u32, b? as u32])
}

/// The facets of surfaces with names, for searches by position.
#[derive(Debug)]
struct NamedFacets<const D: usize> {
    /// The index of each name, ascending, and the facets of its surface.
    surfaces: Vec<(u32, FacetSurface<D>)>,
}

impl<const D: usize> NamedFacets<D> {
    /// Sorts the facets of a surface by name.
    fn new(surface: &FacetSurface<D>) -> Self {
        let names = sorted_distinct(surface.names.iter().copied());
        let names = names.into_iter().filter(|&name| name != NONE);
        let facets = |name| surface.subset(|f| surface.names[f] == name);
        Self {
            surfaces: names.map(|name| (name, facets(name))).collect(),
        }
    }

    /// Returns a grid of the facets of each name.
    fn grids(&self) -> Vec<(u32, FacetGrid<'_, D>)> {
        let surfaces = self.surfaces.iter();
        surfaces
            .map(|(name, facets)| (*name, FacetGrid::new(facets)))
            .collect()
    }
}

/// The facets of a surface in a grid of cells, for searches by position.
#[derive(Debug)]
pub struct FacetGrid<'a, const D: usize> {
    surface: &'a FacetSurface<D>,
    grid: CellList<D>,
    /// Largest distance of a corner from the centre of its facet.
    max_corner_distance: f64,
}

impl<'a, const D: usize> FacetGrid<'a, D> {
    /// Sorts the facets of a surface into a grid.
    pub fn new(surface: &'a FacetSurface<D>) -> Self {
        let facet_centre = |f: usize| {
            let x = surface.corners(f);
            x.iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, 1.0 / D as f64, x))
        };
        let centres: Vec<[f64; D]> = (0..surface.facets.len()).map(facet_centre).collect();
        let squares = centres.iter().enumerate().flat_map(|(f, centre)| {
            let corners = surface.corners(f);
            corners.map(|x| distance2(&x, centre))
        });
        let max_corner_distance = squares.fold(0.0, f64::max).sqrt();
        Self {
            surface,
            grid: CellList::new(&centres, max_corner_distance),
            max_corner_distance,
        }
    }

    /// Returns `true` if the line from a to b passes through a facet.
    pub fn separates(&self, a: [f64; D], b: [f64; D]) -> bool {
        if self.surface.facets.is_empty() {
            return false;
        }
        let middle = add_scaled(a, 0.5, sub(b, a));
        let radius = 0.5 * distance2(&a, &b).sqrt() + self.max_corner_distance;
        let mut separates = false;
        self.grid.visit_within(middle, radius, |f| {
            separates = separates || intersects(a, b, &self.surface.corners(f));
        });
        separates
    }
}

/// How far beyond a facet's edge a line may pass, as a share of the facet, and still pass through it. A
/// line through an edge or a node of a surface must not slip between its facets by rounding.
const EDGE_TOLERANCE: f64 = 1e-9;

/// Returns `true` if the line from a to b passes through a facet.
fn intersects<const D: usize>(a: [f64; D], b: [f64; D], facet: &[[f64; D]; D]) -> bool {
    let facet_normal = normal(facet);
    let [height_a, height_b] = [a, b].map(|x| dot(sub(x, facet[0]), facet_normal));
    if (height_a > 0.0) == (height_b > 0.0) {
        return false;
    }
    let crossing = add_scaled(a, height_a / (height_a - height_b), sub(b, a));
    (0..D).all(|k| {
        let mut triangle = *facet;
        triangle[k] = crossing;
        dot(normal(&triangle), facet_normal) >= -EDGE_TOLERANCE * dot(facet_normal, facet_normal)
    })
}
