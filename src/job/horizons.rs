//! The faces on features that lie on horizons: those whose nearest feature points do.

use crate::parallel::prelude::*;

use crate::feature::Features;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::Simplices;
use crate::mesh::interface::marks_from_bits;

/// Smallest cosine of the angle between the normals of a face and of a point on its feature (45
/// degrees).
const MIN_NORMAL_COSINE: f64 = 0.7;

/// Returns for each simplex of a mesh in lattice space the faces on horizons, as bits;
/// `feature_faces` holds the faces on features in the same way. The result is empty if no face lies
/// on a horizon.
pub(crate) fn horizon_bits<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    features: &Features<D>,
) -> Vec<u8> {
    if features.point_counts().on_horizon == 0 {
        return Vec::new();
    }
    let marks: Vec<bool> = marks_from_bits::<D>(feature_faces).collect();
    let bit = |(k, on): (usize, &bool)| u8::from(*on) << k;
    let bits = |faces: &[bool]| faces.iter().enumerate().map(bit).sum::<u8>();
    let flags = horizon_flags(mesh, &marks, features);
    flags.chunks_exact(D + 1).map(bits).collect()
}

/// Returns for each face of a mesh in lattice space `true` if it lies on a horizon. `marks` holds
/// `true` for faces on features. The result is empty if no face lies on a horizon.
pub(crate) fn horizon_flags<const D: usize, F: Mesh<D>>(
    mesh: &F,
    marks: &[bool],
    features: &Features<D>,
) -> Vec<bool> {
    let counts = features.point_counts();
    if counts.on_horizon == 0 {
        return Vec::new();
    }
    if counts.on_horizon == counts.points {
        return marks.to_vec();
    }
    let points: Vec<[f64; D]> = (features.points.iter())
        .map(|p| p.position.map(f64::from))
        .collect();
    // Valleys are a quarter as wide as atoms are apart, so that all points of the feature near a
    // face are within four widths. Not every rank knows points that are further away.
    let max_distance = 4.0 * features.sigma;
    let grid = CellList::new(&points, 0.5 * max_distance);
    let nodes = mesh.nodes();
    let is_horizon = |face: usize| {
        let (mut middle, mut area_vector, mut area) = ([0.0; D], [0.0; D], 0.0);
        mesh.facets(face, |facet| {
            let corners = facet.map(|n| nodes[n as usize]);
            let n = normal(&corners);
            let centre = corners
                .iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, 1.0 / D as f64, x));
            area += norm(n);
            area_vector = add_scaled(area_vector, 1.0, n);
            middle = add_scaled(middle, norm(n), centre);
        });
        let (middle, min_dot) = (
            middle.map(|c| c / area),
            MIN_NORMAL_COSINE * norm(area_vector),
        );
        let mut nearest = (max_distance, false);
        grid.visit_within(middle, max_distance, |i| {
            let distance = norm(sub(points[i], middle));
            let parallel =
                dot(area_vector, features.points[i].normal.map(f64::from)).abs() > min_dot;
            // Of two points at the same distance, one on a fault wins, whatever their order.
            let is_nearer =
                distance < nearest.0 || distance == nearest.0 && !features.on_horizon[i];
            if parallel && is_nearer {
                nearest = (distance, features.on_horizon[i]);
            }
        });
        nearest.1
    };
    let faces = (0..marks.len()).into_par_iter();
    faces.map(|face| marks[face] && is_horizon(face)).collect()
}
