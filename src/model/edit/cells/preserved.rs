//! What of the cells round an edit stays.

use super::editable_cells::EditableCells;
use crate::geometry::{add_scaled, distance2};
use crate::lattice::optimize::temperature::relative_distance;
use crate::mesh::Mesh;
use crate::mesh::voronoi::conform::FacetSurface;
use crate::model::edit::window::EditWindow;
use crate::report::squared_distance_to_face;

/// Faces on features and surfaces this near to one another, in units of d and no less than a sample, are
/// the same.
const SAME_FACE_TOLERANCE: f64 = 0.125;
/// Faces on features nearer than this, in units of d, to a place where they have changed are made anew.
const REBUILD_RADIUS: f64 = 1.5;
/// A site on the sphere round a node is not inside.
const SPHERE_TOLERANCE: f64 = 1e-9;

/// A face on a feature, in the lattice space of a window.
struct FeatureFace<const D: usize> {
    face: usize,
    centroid: [f64; D],
    facets: Vec<[[f64; D]; D]>,
}

/// The faces on features round an edit, and the places where they do not fit any more.
pub struct FeatureChanges<const D: usize> {
    faces: Vec<FeatureFace<D>>,
    /// With the distance to which that is felt.
    changed_places: Vec<([f64; D], f64)>,
}

impl<const D: usize> FeatureChanges<D> {
    /// Compares the faces on features nearer than `range` d to the `edited` places with the surfaces that
    /// features have there; those at cells that are `gone` do not fit, either. `sample` is the largest
    /// distance between samples; `distance` tells d.
    pub fn new(
        grid: &EditableCells<D>,
        window: &EditWindow<D>,
        surface: &FacetSurface<D>,
        gone: &[bool],
        (edited, range): (&[([f64; D], f64)], f64),
        (sample, distance): (f64, impl Fn([f64; D]) -> f64),
    ) -> Self {
        let mesh = &grid.mesh;
        let centre = |x: &[[f64; D]]| {
            let share = 1.0 / x.len() as f64;
            x.iter().fold([0.0; D], |sum, &x| add_scaled(sum, share, x))
        };
        let is_near = |x: &[f64; D]| relative_distance(x, edited) < range;
        let mut faces = Vec::new();
        for face in (0..mesh.inner_face_count()).filter(|&f| mesh.on_feature[f]) {
            let nodes = mesh.faces.get(face).iter();
            let ring: Vec<[f64; D]> = nodes
                .map(|&n| window.to_local(mesh.nodes[n as usize]))
                .collect();
            let middle = centre(&ring);
            if relative_distance(&middle, edited) < range + 2.0 {
                let mut facets = Vec::new();
                mesh.facets(face, |facet| {
                    facets.push(facet.map(|n| window.to_local(mesh.nodes[n as usize])));
                });
                faces.push(FeatureFace {
                    face,
                    centroid: middle,
                    facets,
                });
            }
        }
        let anew: Vec<[[f64; D]; D]> = (0..surface.facets.len())
            .map(|f| surface.corners(f))
            .filter(|facet| relative_distance(&centre(facet), edited) < range + 2.0)
            .collect();
        let same = |x: [f64; D], facet: &[[f64; D]; D]| {
            let tolerance = (SAME_FACE_TOLERANCE * distance(x)).max(sample);
            squared_distance_to_face(x, facet) <= tolerance * tolerance
        };
        let mut places = Vec::new();
        for facet in &anew {
            let x = centre(facet);
            if is_near(&x) && !(faces.iter().flat_map(|face| &face.facets)).any(|old| same(x, old))
            {
                places.push(x);
            }
        }
        for face in faces.iter().filter(|face| is_near(&face.centroid)) {
            let leaves = mesh.face_cells[face.face].iter().any(|&c| gone[c as usize]);
            if leaves || !anew.iter().any(|facet| same(face.centroid, facet)) {
                places.push(face.centroid);
            }
        }
        let felt = |x: [f64; D]| (x, REBUILD_RADIUS * distance(x));
        Self {
            faces,
            changed_places: places.into_iter().map(felt).collect(),
        }
    }

    /// Whether faces on features have to be made anew at a place.
    pub fn needs_rebuild(&self, x: &[f64; D]) -> bool {
        let mut places = self.changed_places.iter();
        places.any(|(place, radius)| distance2(place, x) < radius * radius)
    }
}

/// What stays.
pub struct PreservedParts {
    /// For each node of the mesh whether it does.
    pub keeps_node: Vec<bool>,
    /// For each cell whether its atom stays where it is: it has a node that stays.
    pub keeps_atom: Vec<bool>,
    /// For each cell whether it keeps its atom, but not all of its nodes.
    pub is_border: Vec<bool>,
}

impl PreservedParts {
    /// The nodes that are `range` d or farther from the `edited` places, and those of faces on features that
    /// have not changed; but none of cells that are `gone`, and none nearer to an atom that has `come`
    /// than to its own.
    pub fn new<const D: usize>(
        grid: &EditableCells<D>,
        window: &EditWindow<D>,
        changed: &FeatureChanges<D>,
        gone: &[bool],
        come: &[[f64; D]],
        (edited, range): (&[([f64; D], f64)], f64),
    ) -> Self {
        let mesh = &grid.mesh;
        let count = mesh.sites.len();
        let cells = |n: usize| {
            let meeting = grid.cells_of_nodes.get(n).iter().map(|&c| c as usize);
            meeting.filter(move |&c| c < count)
        };
        let mut on_feature = vec![false; mesh.nodes.len()];
        for face in changed
            .faces
            .iter()
            .filter(|f| !changed.needs_rebuild(&f.centroid))
        {
            let nodes = mesh.faces.get(face.face).iter();
            nodes.for_each(|&n| on_feature[n as usize] = true);
        }
        let stays = |n: usize| {
            let x = window.to_local(mesh.nodes[n]);
            if relative_distance(&x, edited) < range && !on_feature[n] || cells(n).any(|c| gone[c])
            {
                return false;
            }
            come.iter().all(|y| {
                let own = cells(n).map(|c| distance2(&window.to_local(mesh.sites[c]), &x));
                let own = own.fold(f64::INFINITY, f64::min);
                distance2(y, &x) >= own * (1.0 - SPHERE_TOLERANCE)
            })
        };
        let keeps_node: Vec<bool> = (0..mesh.nodes.len()).map(stays).collect();
        let (mut keeps_atom, mut loses) = (vec![false; count], vec![false; count]);
        for (n, &stays) in keeps_node.iter().enumerate() {
            for c in cells(n) {
                keeps_atom[c] |= stays;
                loses[c] |= !stays;
            }
        }
        let is_border = keeps_atom.iter().zip(loses).map(|(&f, l)| f && l).collect();
        Self {
            keeps_node,
            keeps_atom,
            is_border,
        }
    }
}
