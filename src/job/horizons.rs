//! Which of the faces on features lie on horizons: those whose nearest feature points do.

use crate::parallel::prelude::*;

use crate::feature::Features;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::Simplices;
use crate::mesh::interface::marks_from_bits;

/// Points are of a face's feature if their normals are within 45 degrees of its.
const MIN_NORMAL_COSINE: f64 = 0.7;

/// For each simplex of a mesh in lattice space which of its faces on features, given as bits, lie on
/// horizons. Empty if none does.
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
    let bits = |faces: &[bool]| faces.iter().enumerate().map(bit).sum();
    let on = horizon_flags(mesh, &marks, features);
    on.chunks_exact(D + 1).map(bits).collect()
}

/// For each number of a face of a mesh in lattice space whether it lies on a horizon; `marks` says
/// which lie on features. Empty if none does.
pub(crate) fn horizon_flags<const D: usize, F: Mesh<D>>(
    mesh: &F,
    marks: &[bool],
    features: &Features<D>,
) -> Vec<bool> {
    let all = features.point_counts();
    if all.on_horizon == 0 {
        return Vec::new();
    }
    if all.on_horizon == all.points {
        return marks.to_vec();
    }
    let points: Vec<[f64; D]> = (features.points.iter())
        .map(|p| p.position.map(f64::from))
        .collect();
    // Valleys are a quarter as wide as atoms are apart: all of a feature that is near is within four. What is farther
    // off than that is not known to every rank.
    let most = 4.0 * features.sigma;
    let grid = CellList::new(&points, 0.5 * most);
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
        let (middle, along) = (
            middle.map(|c| c / area),
            MIN_NORMAL_COSINE * norm(area_vector),
        );
        let mut nearest = (most, false);
        grid.visit_within(middle, most, |i| {
            let far = norm(sub(points[i], middle));
            let parallel = dot(area_vector, features.points[i].normal.map(f64::from)).abs() > along;
            // Of two as near, a fault: whichever is met first.
            let nearer = far < nearest.0 || far == nearest.0 && !features.on_horizon[i];
            if parallel && nearer {
                nearest = (far, features.on_horizon[i]);
            }
        });
        nearest.1
    };
    let faces = (0..marks.len()).into_par_iter();
    faces.map(|face| marks[face] && is_horizon(face)).collect()
}
