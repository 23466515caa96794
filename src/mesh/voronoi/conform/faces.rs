//! Which faces of Voronoi cells lie on a surface.

use crate::parallel::prelude::*;

use super::{ConformingSites, FacetSurface};
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, norm, normal, sub};
use crate::mesh::poly::PolyMesh;

impl<const D: usize> ConformingSites<D> {
    /// Which faces of cells lie on the surface: those between the two sites of a facet, and those whose
    /// connection passes through it. So no way from cell to cell passes the surface but through such a
    /// face. The [`sites`](Self::sites) have the cells from `first` on.
    pub fn faces_on_surface(&self, mesh: &PolyMesh<D>, first: usize) -> Vec<bool> {
        let mut on_surface = vec![false; mesh.face_cells.len()];
        let facets = FacetGrid::new(self.surface());
        let inner = mesh.inner_face_count();
        let between = |f: usize| {
            let [a, b] = mesh.face_cells[f].map(|c| mesh.sites[c as usize]);
            self.is_between_sites(mesh, f, first) || facets.separates(a, b)
        };
        let found: Vec<bool> = (0..inner).into_par_iter().map(between).collect();
        on_surface[..inner].copy_from_slice(&found);
        on_surface
    }

    /// The area of the faces between the two sites of a facet, which lie in its plane, over the area of
    /// the surface; 1 if it has none.
    pub fn covered_share(&self, mesh: &PolyMesh<D>, first: usize) -> f64 {
        let surface = self.surface();
        let all = (0..surface.facets.len()).map(|f| norm(normal(&surface.corners(f))));
        let between =
            (0..mesh.inner_face_count()).filter(|&f| self.is_between_sites(mesh, f, first));
        let followed: f64 = between.map(|f| mesh.face_shape(f).area()).sum();
        match all.sum::<f64>() {
            all if all > 0.0 => followed / all,
            _ => 1.0,
        }
    }

    /// Whether a face is between the two sites of a facet.
    fn is_between_sites(&self, mesh: &PolyMesh<D>, face: usize, first: usize) -> bool {
        let [a, b] = mesh.face_cells[face].map(|c| c as usize);
        let of_facets = first..first + 2 * self.facets().len();
        of_facets.contains(&a) && (a - first).is_multiple_of(2) && b == a + 1
    }
}

/// The facets of a surface, by their places.
#[derive(Debug)]
pub struct FacetGrid<'a, const D: usize> {
    surface: &'a FacetSurface<D>,
    grid: CellList<D>,
    /// No corner is farther from the middle of its facet.
    max_corner_distance: f64,
}

impl<'a, const D: usize> FacetGrid<'a, D> {
    /// Sorts them.
    pub fn new(surface: &'a FacetSurface<D>) -> Self {
        let middle = |f: usize| {
            let x = surface.corners(f);
            x.iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, 1.0 / D as f64, x))
        };
        let middles: Vec<[f64; D]> = (0..surface.facets.len()).map(middle).collect();
        let squares = middles.iter().enumerate().flat_map(|(f, middle)| {
            let corners = surface.corners(f);
            corners.map(|x| distance2(&x, middle))
        });
        let max_corner_distance = squares.fold(0.0, f64::max).sqrt();
        Self {
            surface,
            grid: CellList::new(&middles, max_corner_distance.max(f64::MIN_POSITIVE)),
            max_corner_distance,
        }
    }

    /// Whether one of them is between two points.
    pub fn separates(&self, a: [f64; D], b: [f64; D]) -> bool {
        if self.surface.facets.is_empty() {
            return false;
        }
        let middle = add_scaled(a, 0.5, sub(b, a));
        let reach = 0.5 * distance2(&a, &b).sqrt() + self.max_corner_distance;
        let mut part = false;
        self.grid.visit_within(middle, reach, |f| {
            part = part || intersects(a, b, &self.surface.corners(f));
        });
        part
    }
}

/// Whether the line from a to b passes through a facet.
fn intersects<const D: usize>(a: [f64; D], b: [f64; D], facet: &[[f64; D]; D]) -> bool {
    let up = normal(facet);
    let [over, under] = [a, b].map(|x| dot(sub(x, facet[0]), up));
    if (over > 0.0) == (under > 0.0) {
        return false;
    }
    let at = add_scaled(a, over / (over - under), sub(b, a));
    (0..D).all(|k| {
        let mut part = *facet;
        part[k] = at;
        dot(normal(&part), up) >= 0.0
    })
}
