//! Sliver exudation by CGAL (feature `cgal`) after Cheng, Dey, Edelsbrunner, Facello & Teng (2000):
//! points get weights that remove the flattest cells from the weighted Delaunay triangulation.

use super::bridge::{call, ffi, to_arrays};
use crate::error::Result;

/// Place of this module's errors.
const PLACE: &str = "sliver exudation";

/// Returns the Delaunay tetrahedra that [`exude`] starts from, positively oriented (see
/// [`crate::mesh`]).
///
/// # Errors
/// Returns [`Error::Delaunay`](crate::Error::Delaunay) if a coordinate is not finite, if two points
/// coincide, if memory runs out, or without the feature `cgal`.
pub fn unweighted_delaunay(points: &[[f64; 3]]) -> Result<Vec<[u32; 4]>> {
    call(PLACE, points, ffi::cgal_unweighted).map(to_arrays)
}

/// Returns the tetrahedra of [`unweighted_delaunay`] after sliver exudation. Each point of a
/// tetrahedron with a dihedral angle below `angle` degrees gets the weight that maximises the
/// smallest angle at the point. No point moves, and the hull stays.
///
/// The `faces` that are faces of [`unweighted_delaunay`] stay too, except at the rim of a surface:
/// a face with an edge that no other of `faces` shares may vanish.
///
/// # Errors
/// Returns the errors of [`unweighted_delaunay`].
pub fn exude(points: &[[f64; 3]], faces: &[[u32; 3]], angle: f64) -> Result<Vec<[u32; 4]>> {
    call(PLACE, points, |points| {
        ffi::cgal_exude(points, faces.as_flattened(), angle)
    })
    .map(to_arrays)
}

#[cfg(test)]
#[cfg(feature = "cgal")]
mod tests {
    use super::*;
    use crate::geometry::grid_index::index_at;
    use crate::mesh::check::check;
    use crate::mesh::{FACES, TetMesh, quality};
    use std::collections::{BTreeMap, BTreeSet};

    /// Returns a cubic lattice with flat sides, its inner points moved at random by up to a tenth.
    /// It has slivers wherever the eight points of a cube lie nearly on one sphere.
    fn jittered(n: usize) -> Vec<[f64; 3]> {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut points = Vec::new();
        for i in 0..n.pow(3) {
            let index = index_at([n; 3], i);
            points.push(index.map(|c| {
                let jitter = 0.2 * next();
                let is_inner = c > 0 && c < n - 1;
                c as f64 + if is_inner { jitter } else { 0.0 }
            }));
        }
        points
    }

    fn smallest_angle(mesh: &TetMesh) -> f64 {
        let angles = (0..mesh.tets.len())
            .map(|t| quality::dihedral_angles(&mesh.corners(t)))
            .map(|angles| angles.into_iter().fold(f64::INFINITY, f64::min));
        angles.fold(f64::INFINITY, f64::min)
    }

    fn sorted_faces(tet: &[u32; 4]) -> [[u32; 3]; 4] {
        FACES.map(|face| {
            let mut face = face.map(|k| tet[k]);
            face.sort_unstable();
            face
        })
    }

    #[test]
    fn exudation_removes_slivers_and_keeps_points_hull_and_faces() {
        let nodes = jittered(9);
        let before = TetMesh {
            tets: unweighted_delaunay(&nodes).unwrap(),
            nodes: nodes.clone(),
        };
        let faces_of = |mesh: &TetMesh| -> BTreeSet<[u32; 3]> {
            mesh.tets.iter().flat_map(sorted_faces).collect()
        };
        // The surface from side to side between two layers of tetrahedra: the upper faces of the
        // lower layer.
        let is_below =
            |tet: &[u32; 4]| tet.iter().map(|&n| nodes[n as usize][2]).sum::<f64>() < 16.0;
        let mut counts = BTreeMap::new();
        for tet in before.tets.iter().filter(|tet| is_below(tet)) {
            for face in sorted_faces(tet) {
                *counts.entry(face).or_insert(0) += 1;
            }
        }
        let is_on_side = |face: &[u32; 3]| {
            (0..3).any(|k| {
                [0.0, 8.0]
                    .iter()
                    .any(|&side| face.iter().all(|&n| nodes[n as usize][k] == side))
            })
        };
        let kept_faces: Vec<[u32; 3]> = counts
            .into_iter()
            .filter(|(face, count)| *count == 1 && !is_on_side(face))
            .map(|(face, _)| face)
            .collect();
        assert!(kept_faces.len() > 64);
        let after = TetMesh {
            tets: exude(&nodes, &kept_faces, 30.0).unwrap(),
            nodes: nodes.clone(),
        };
        for mesh in [&before, &after] {
            let report = check(mesh, [0.0; 3], [8.0; 3], 1e-12);
            assert!(report.passed(), "{report:?}");
        }
        let remaining_faces = faces_of(&after);
        assert!(kept_faces.iter().all(|face| remaining_faces.contains(face)));
        let (angle_before, angle_after) = (smallest_angle(&before), smallest_angle(&after));
        assert!(
            angle_before < 1.0 && angle_after > 5.0 * angle_before,
            "{angle_before} to {angle_after}"
        );
    }

    #[test]
    fn points_that_coincide_are_refused() {
        let mut points = jittered(3);
        points.push(points[4]);
        let error = unweighted_delaunay(&points).unwrap_err().to_string();
        assert!(error.contains("coincide"), "{error}");
        assert!(exude(&[[f64::NAN; 3]], &[], 30.0).is_err());
    }
}
