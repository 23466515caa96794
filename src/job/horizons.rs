//! The faces on features that lie on horizons, and on surfaces with names: those whose nearest
//! feature points do.

use crate::parallel::prelude::*;

use crate::feature::Features;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::interface::marks_from_bits;

/// Smallest cosine of the angle between the normals of a face and of a point on its feature (45
/// degrees).
const MIN_NORMAL_COSINE: f64 = 0.7;

/// Returns for each simplex of a mesh in lattice space the faces on horizons, as bits;
/// `feature_faces` holds the faces on features in the same way, and `face_names` the names of faces
/// as [`face_names`] returns them. The result is empty if no face lies on a horizon.
pub(crate) fn horizon_bits<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    face_names: &[u32],
    features: &Features<D>,
) -> Vec<u8> {
    if features.point_counts().on_horizon == 0 {
        return Vec::new();
    }
    let marks: Vec<bool> = marks_from_bits::<D>(feature_faces).collect();
    let bit = |(k, on): (usize, &bool)| u8::from(*on) << k;
    let bits = |faces: &[bool]| faces.iter().enumerate().map(bit).sum::<u8>();
    let flags = horizon_flags(mesh, &marks, face_names, features);
    flags.chunks_exact(D + 1).map(bits).collect()
}

/// Returns for each face of a mesh in lattice space `true` if it lies on a horizon. `marks` holds
/// `true` for faces on features, and `face_names` the names of faces as [`face_names`] returns them.
/// The result is empty if no face lies on a horizon.
pub(crate) fn horizon_flags<const D: usize, F: Mesh<D>>(
    mesh: &F,
    marks: &[bool],
    face_names: &[u32],
    features: &Features<D>,
) -> Vec<bool> {
    let counts = features.point_counts();
    if counts.on_horizon == 0 {
        return Vec::new();
    }
    if counts.on_horizon == counts.points {
        return marks.to_vec();
    }
    let horizon =
        |[parallel, _]: [Option<usize>; 2]| parallel.is_some_and(|i| features.on_horizon[i]);
    let nearest = nearest_points(mesh, marks, features).into_iter();
    let is_horizon = |(face, points): (usize, _)| match face_names.get(face) {
        Some(&name) if name != NONE => features.names[name as usize].is_horizon,
        _ => horizon(points),
    };
    nearest.enumerate().map(is_horizon).collect()
}

/// Returns for each face of a mesh in lattice space the index in [`Features::names`] of the surface
/// that it lies on, or [`NONE`] if that has no name. `marks` holds `true` for faces on features. The
/// result is empty if no surface has a name.
pub(crate) fn face_names<const D: usize, F: Mesh<D>>(
    mesh: &F,
    marks: &[bool],
    features: &Features<D>,
) -> Vec<u32> {
    if features.names.is_empty() {
        return Vec::new();
    }
    let index = |[parallel, any]: [Option<usize>; 2]| {
        let number = parallel.or(any).map(|point| features.surface[point]);
        let mut names = features.names.iter();
        let index = names.position(|name| Some(name.number) == number);
        index.map_or(NONE, |index| index as u32)
    };
    nearest_points(mesh, marks, features)
        .into_iter()
        .map(index)
        .collect()
}

/// Returns for each marked face of a mesh in lattice space the nearest feature point whose normal
/// is that of the face, and the nearest one whatever its normal.
fn nearest_points<const D: usize, F: Mesh<D>>(
    mesh: &F,
    marks: &[bool],
    features: &Features<D>,
) -> Vec<[Option<usize>; 2]> {
    let points: Vec<[f64; D]> = (features.points.iter())
        .map(|p| p.position.map(f64::from))
        .collect();
    // Valleys are a quarter as wide as atoms are apart, so that all points of the feature near a
    // face are within four widths. Not every rank knows points that are further away.
    let max_distance = 4.0 * features.sigma;
    let grid = CellList::new(&points, 0.5 * max_distance);
    let nodes = mesh.nodes();
    let nearest_point = |face: usize| {
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
        let mut nearest: [(f64, Option<usize>); 2] = [(max_distance, None); 2];
        grid.visit_within(middle, max_distance, |i| {
            let distance = norm(sub(points[i], middle));
            let parallel =
                dot(area_vector, features.points[i].normal.map(f64::from)).abs() > min_dot;
            // Of two points at the same distance, one on a fault wins, then the first.
            let rank = |i: usize| (features.on_horizon[i], i);
            for (best, may_count) in nearest.iter_mut().zip([parallel, true]) {
                let is_nearer = distance < best.0
                    || distance == best.0 && best.1.is_none_or(|j| rank(i) < rank(j));
                if may_count && is_nearer {
                    *best = (distance, Some(i));
                }
            }
        });
        nearest.map(|best| best.1)
    };
    let faces = (0..marks.len()).into_par_iter();
    faces
        .map(|face| {
            if marks[face] {
                nearest_point(face)
            } else {
                [None; 2]
            }
        })
        .collect()
}
