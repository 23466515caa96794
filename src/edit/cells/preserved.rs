//! The faces, nodes and cells that stay unchanged around an edit.

use super::patch::CellNeighbourhood;
use crate::geometry::squared_distance_to_face;
use crate::geometry::{add_scaled, distance2};
use crate::lattice::optimise::temperature::relative_distance;
use crate::mesh::Mesh;
use crate::mesh::voronoi::conform::FacetSurface;

/// Distance, in units of d but at least one sample, within which a face on a feature and a feature
/// surface count as the same.
const SAME_FACE_TOLERANCE: f64 = 0.125;
/// Distance, in units of d, from a changed place within which faces on features are rebuilt.
const REBUILD_RADIUS: f64 = 1.5;
/// Relative tolerance for a site on the sphere around a node: it counts as not inside.
const SPHERE_TOLERANCE: f64 = 1e-9;

/// A face on a feature, in the lattice space of a window.
struct FeatureFace<const D: usize> {
    face: usize,
    centroid: [f64; D],
    facets: Vec<[[f64; D]; D]>,
}

/// The faces on features around an edit, and the places where they no longer fit the features.
pub struct FeatureChanges<const D: usize> {
    faces: Vec<FeatureFace<D>>,
    /// Changed places, each with the radius within which faces are rebuilt.
    changed_places: Vec<([f64; D], f64)>,
}

impl<const D: usize> FeatureChanges<D> {
    /// Compares the faces on features within `range` d of the edited places with the present
    /// feature surfaces. Faces at removed cells count as changed, too. `sample` is the largest
    /// distance between samples, and `distance` returns d.
    pub fn new(
        neighbourhood: &CellNeighbourhood<'_, D>,
        surface: &FacetSurface<D>,
        is_removed: &[bool],
        range: f64,
        sample: f64,
        distance: impl Fn([f64; D]) -> f64,
    ) -> Self {
        let CellNeighbourhood {
            editable,
            window,
            edited_places,
            ..
        } = neighbourhood;
        let mesh = &editable.mesh;
        let centre = |x: &[[f64; D]]| {
            let weight = 1.0 / x.len() as f64;
            x.iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, weight, x))
        };
        let is_near = |x: &[f64; D]| relative_distance(x, edited_places) < range;
        let mut faces = Vec::new();
        for face in (0..mesh.inner_face_count()).filter(|&f| mesh.on_feature[f]) {
            let nodes = mesh.faces.get(face).iter();
            let ring: Vec<[f64; D]> = nodes
                .map(|&n| window.to_local(mesh.nodes[n as usize]))
                .collect();
            let centroid = centre(&ring);
            if relative_distance(&centroid, edited_places) < range + 2.0 {
                let mut facets = Vec::new();
                mesh.facets(face, |facet| {
                    facets.push(facet.map(|n| window.to_local(mesh.nodes[n as usize])));
                });
                faces.push(FeatureFace {
                    face,
                    centroid,
                    facets,
                });
            }
        }
        let new_facets: Vec<[[f64; D]; D]> = (0..surface.facets.len())
            .map(|f| surface.corners(f))
            .filter(|facet| relative_distance(&centre(facet), edited_places) < range + 2.0)
            .collect();
        let coincides = |x: [f64; D], facet: &[[f64; D]; D]| {
            let tolerance = (SAME_FACE_TOLERANCE * distance(x)).max(sample);
            squared_distance_to_face(x, facet) <= tolerance * tolerance
        };
        let mut changed_places = Vec::new();
        for facet in &new_facets {
            let x = centre(facet);
            if is_near(&x)
                && !(faces.iter().flat_map(|face| &face.facets)).any(|old| coincides(x, old))
            {
                changed_places.push(x);
            }
        }
        for face in faces.iter().filter(|face| is_near(&face.centroid)) {
            let loses_cell = mesh.face_cells[face.face]
                .iter()
                .any(|&c| is_removed[c as usize]);
            if loses_cell
                || !new_facets
                    .iter()
                    .any(|facet| coincides(face.centroid, facet))
            {
                changed_places.push(face.centroid);
            }
        }
        let with_radius = |x: [f64; D]| (x, REBUILD_RADIUS * distance(x));
        Self {
            faces,
            changed_places: changed_places.into_iter().map(with_radius).collect(),
        }
    }

    /// Returns `true` if faces on features at `x` must be rebuilt.
    pub fn needs_rebuild(&self, x: &[f64; D]) -> bool {
        let mut places = self.changed_places.iter();
        places.any(|(place, radius)| distance2(place, x) < radius * radius)
    }
}

/// The nodes and atoms that stay unchanged.
pub struct PreservedParts {
    /// For each node of the mesh, `true` if it stays.
    pub keeps_node: Vec<bool>,
    /// For each cell, `true` if its atom stays in place because at least one node of the cell
    /// stays.
    pub keeps_atom: Vec<bool>,
    /// For each cell, `true` if its atom stays, but not all of its nodes.
    pub is_border: Vec<bool>,
}

impl PreservedParts {
    /// Determines which nodes stay: those at least `range` d away from the edited places, and those
    /// of faces on features that have not changed. Nodes of removed cells do not stay, and neither
    /// do nodes that are nearer to one of `new_sites` than to their own sites.
    pub fn new<const D: usize>(
        neighbourhood: &CellNeighbourhood<'_, D>,
        changes: &FeatureChanges<D>,
        is_removed: &[bool],
        new_sites: &[[f64; D]],
        range: f64,
    ) -> Self {
        let CellNeighbourhood {
            editable,
            window,
            edited_places,
            ..
        } = neighbourhood;
        let mesh = &editable.mesh;
        let count = mesh.sites.len();
        let cells_at = |n: usize| {
            let incident = editable.cells_of_nodes.get(n).iter().map(|&c| c as usize);
            incident.filter(move |&c| c < count)
        };
        let mut on_unchanged_feature = vec![false; mesh.nodes.len()];
        for face in changes
            .faces
            .iter()
            .filter(|f| !changes.needs_rebuild(&f.centroid))
        {
            let nodes = mesh.faces.get(face.face).iter();
            nodes.for_each(|&n| on_unchanged_feature[n as usize] = true);
        }
        let is_preserved = |n: usize| {
            let x = window.to_local(mesh.nodes[n]);
            if relative_distance(&x, edited_places) < range && !on_unchanged_feature[n]
                || cells_at(n).any(|c| is_removed[c])
            {
                return false;
            }
            new_sites.iter().all(|y| {
                let nearest = cells_at(n).map(|c| distance2(&window.to_local(mesh.sites[c]), &x));
                let nearest = nearest.fold(f64::INFINITY, f64::min);
                distance2(y, &x) >= nearest * (1.0 - SPHERE_TOLERANCE)
            })
        };
        let keeps_node: Vec<bool> = (0..mesh.nodes.len()).map(is_preserved).collect();
        let (mut keeps_atom, mut loses_node) = (vec![false; count], vec![false; count]);
        for (n, &is_kept) in keeps_node.iter().enumerate() {
            for c in cells_at(n) {
                keeps_atom[c] |= is_kept;
                loses_node[c] |= !is_kept;
            }
        }
        let is_border = keeps_atom
            .iter()
            .zip(loses_node)
            .map(|(&f, l)| f && l)
            .collect();
        Self {
            keeps_node,
            keeps_atom,
            is_border,
        }
    }
}
