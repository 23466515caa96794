//! Sliver exudation (Cheng, Dey, Edelsbrunner, Facello & Teng 2000) by CGAL (feature `cgal`): points
//! get weights that make the flattest cells vanish from the weighted Delaunay triangulation.

use crate::error::{Error, Result, cause};

/// The Delaunay tetrahedra that [`exude`] starts from, positively oriented (see [`crate::mesh`]).
///
/// # Errors
/// [`Error::Delaunay`] if a coordinate is not finite, two points coincide, or built without the
/// feature `cgal`.
pub fn unweighted_delaunay(points: &[[f64; 3]]) -> Result<Vec<[u32; 4]>> {
    check_points(points)?;
    bridge::unweighted_delaunay(points)
}

/// The tetrahedra of [`unweighted_delaunay`] after points that belong to one with a dihedral angle below
/// `angle` degrees got the weight that makes the smallest angle about them largest. No point moves;
/// the hull stays, and so do those of `faces` that are faces of [`unweighted_delaunay`], except at the rim of a
/// surface: a face with an edge that no other of `faces` shares may go.
///
/// # Errors
/// Those of [`unweighted_delaunay`].
pub fn exude(points: &[[f64; 3]], faces: &[[u32; 3]], angle: f64) -> Result<Vec<[u32; 4]>> {
    check_points(points)?;
    bridge::exude(points, faces, angle)
}

fn check_points(points: &[[f64; 3]]) -> Result<()> {
    if !points.as_flattened().iter().all(|c| c.is_finite()) {
        return Err(exude_error(
            "a point is not finite",
            "give finite coordinates",
        ));
    }
    // CGAL's indices are ints.
    if points.len() > i32::MAX as usize {
        return Err(exude_error(
            "more than 2^31 points",
            "mesh a part of the image",
        ));
    }
    Ok(())
}

fn exude_error(problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
    Error::Delaunay(cause("sliver exudation", problem, remedy))
}

#[cfg(not(feature = "cgal"))]
mod bridge {
    use super::{Result, exude_error};

    fn missing<T>() -> Result<T> {
        Err(exude_error(
            "this atomesh was built without CGAL",
            "build with the feature `cgal` (on by default), or remove slivers another way",
        ))
    }

    pub fn unweighted(_: &[[f64; 3]]) -> Result<Vec<[u32; 4]>> {
        missing()
    }

    pub fn exude(_: &[[f64; 3]], _: &[[u32; 3]], _: f64) -> Result<Vec<[u32; 4]>> {
        missing()
    }
}

#[cfg(feature = "cgal")]
mod bridge {
    use super::{Result, exude_error};

    /// The other side is `cpp/exude.h`.
    #[cxx::bridge(namespace = "atomesh")]
    #[allow(unsafe_code)]
    mod ffi {
        // SAFETY: both functions only read their slices; `check` has seen to it that all
        // coordinates are finite and the points can be numbered. Faces are only compared.
        unsafe extern "C++" {
            include!("atomesh/cpp/exude.h");

            fn cgal_unweighted(points: &[f64]) -> Result<Vec<u32>>;
            fn cgal_exude(points: &[f64], faces: &[u32], angle: f64) -> Result<Vec<u32>>;
        }
    }

    pub fn unweighted_delaunay(points: &[[f64; 3]]) -> Result<Vec<[u32; 4]>> {
        to_tets(ffi::cgal_unweighted(points.as_flattened()))
    }

    pub fn exude(points: &[[f64; 3]], faces: &[[u32; 3]], angle: f64) -> Result<Vec<[u32; 4]>> {
        let faces = faces.as_flattened();
        to_tets(ffi::cgal_exude(points.as_flattened(), faces, angle))
    }

    fn to_tets(tets: std::result::Result<Vec<u32>, cxx::Exception>) -> Result<Vec<[u32; 4]>> {
        let tets =
            tets.map_err(|e| exude_error(e.what(), "give distinct points").with_source(e))?;
        let (tets, _) = tets.as_chunks();
        Ok(tets.to_vec())
    }
}

#[cfg(test)]
#[cfg(feature = "cgal")]
mod tests {
    use super::*;
    use crate::mesh::check::check;
    use crate::mesh::{FACES, TetMesh, quality};
    use std::collections::{BTreeMap, BTreeSet};

    /// A cubic lattice jittered by a tenth, its sides flat: slivers wherever eight points of a cube
    /// lie nearly on one sphere.
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
            let place = [i % n, i / n % n, i / (n * n)];
            points.push(place.map(|c| {
                let jitter = 0.2 * next();
                let inner = c > 0 && c < n - 1;
                c as f64 + if inner { jitter } else { 0.0 }
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
    fn slivers_go_and_points_hull_and_given_faces_stay() {
        let nodes = jittered(9);
        let before = TetMesh {
            tets: unweighted_delaunay(&nodes).unwrap(),
            nodes: nodes.clone(),
        };
        let faces_of = |mesh: &TetMesh| -> BTreeSet<[u32; 3]> {
            mesh.tets.iter().flat_map(sorted_faces).collect()
        };
        // A surface from side to side: the lower of two layers of tetrahedra, seen from above.
        let below = |tet: &[u32; 4]| tet.iter().map(|&n| nodes[n as usize][2]).sum::<f64>() < 16.0;
        let mut counts = BTreeMap::new();
        for tet in before.tets.iter().filter(|tet| below(tet)) {
            for face in sorted_faces(tet) {
                *counts.entry(face).or_insert(0) += 1;
            }
        }
        let on_side = |face: &[u32; 3]| {
            (0..3).any(|k| {
                [0.0, 8.0]
                    .iter()
                    .any(|&side| face.iter().all(|&n| nodes[n as usize][k] == side))
            })
        };
        let keep: Vec<[u32; 3]> = counts
            .into_iter()
            .filter(|(face, count)| *count == 1 && !on_side(face))
            .map(|(face, _)| face)
            .collect();
        assert!(keep.len() > 64);
        let after = TetMesh {
            tets: exude(&nodes, &keep, 30.0).unwrap(),
            nodes: nodes.clone(),
        };
        for mesh in [&before, &after] {
            let filling = check(mesh, [0.0; 3], [8.0; 3], 1e-12);
            assert!(filling.passed(), "{filling:?}");
        }
        let left = faces_of(&after);
        assert!(keep.iter().all(|face| left.contains(face)));
        let (was, is) = (smallest_angle(&before), smallest_angle(&after));
        assert!(was < 1.0 && is > 5.0 * was, "{was} to {is}");
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
