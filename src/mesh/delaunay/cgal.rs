//! CGAL (feature `cgal`): a Delaunay triangulation that shares no code with the others, an
//! independent check of any tetrahedral mesh with exact predicates, and sliver exudation.

use super::bridge::{call, ffi, to_arrays};
use crate::error::{Error, Result, cause};

/// Place of this module's errors.
const PLACE: &str = "validation by CGAL";

/// Results of CGAL's check of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CgalReport {
    /// Number of tetrahedra whose exact orientation is negative.
    pub inverted: u64,
    /// Number of tetrahedra whose four nodes lie exactly in one plane.
    pub flat: u64,
    /// Number of nodes that no tetrahedron uses.
    pub unused_nodes: u64,
    /// Number of faces of more than two tetrahedra, and of hull edges that do not belong to exactly
    /// two hull faces.
    pub overfull_faces: u64,
    /// Number of faces of only one tetrahedron.
    pub hull_faces: u64,
    /// Result of CGAL's `is_valid` for its own data structure, made of the tetrahedra and an
    /// infinite node beyond the hull: neighbours are mutual, orientations agree, and Euler's
    /// relation holds.
    pub valid_topology: bool,
    /// Sum of the signed volumes.
    pub volume: f64,
    /// Volume of the convex hull of the nodes on the hull.
    pub hull_volume: f64,
}

impl CgalReport {
    /// Returns the faults as readable text, one per entry; none if the mesh is a triangulation of
    /// its convex hull. The volumes may differ by the relative `tolerance`: sides that are exactly
    /// flat in lattice space are flat only up to rounding after a rotation.
    pub fn faults(&self, tolerance: f64) -> Vec<String> {
        let mut faults = Vec::new();
        for (count, description) in [
            (self.inverted, "inverted tetrahedra"),
            (self.flat, "flat tetrahedra"),
            (self.unused_nodes, "unused nodes"),
            (
                self.overfull_faces,
                "faces or hull edges that do not connect exactly two others",
            ),
        ] {
            if count > 0 {
                faults.push(format!("{count} {description}"));
            }
        }
        if !self.valid_topology {
            faults.push("CGAL's data structure of the mesh is not valid".to_string());
        }
        let error = self.volume / self.hull_volume - 1.0;
        if error.is_nan() || error.abs() > tolerance {
            faults.push(format!(
                "volume {} is not its convex hull's {} (relative {error:.1e})",
                self.volume, self.hull_volume
            ));
        }
        faults
    }
}

/// Returns CGAL's Delaunay tetrahedra of `points`, positively oriented (see [`crate::mesh`](mod@crate::mesh)).
///
/// Where more than four points lie on a sphere, the triangulation is not unique, and CGAL may
/// choose another one than TetGen.
///
/// # Errors
/// Returns [`Error::Delaunay`] if a coordinate is not finite, if two points coincide, if memory
/// runs out, or without the feature `cgal`.
pub fn triangulate(points: &[[f64; 3]]) -> Result<Vec<[u32; 4]>> {
    call(PLACE, points, ffi::cgal_triangulate).map(to_arrays)
}

/// Returns the Delaunay tetrahedra of `points` after CGAL's sliver exudation, which keeps the hull and
/// `faces` and removes as many tetrahedra with angles below `angle` degrees as it can. A face of `faces` with an edge that no other of them
/// shares may vanish.
///
/// # Errors
/// Returns the errors of [`triangulate`].
pub fn exude(points: &[[f64; 3]], faces: &[[u32; 3]], angle: f64) -> Result<Vec<[u32; 4]>> {
    call("sliver exudation by CGAL", points, |points| {
        ffi::cgal_exude(points, faces.as_flattened(), angle)
    })
    .map(to_arrays)
}

/// Checks that tetrahedra are a triangulation of the convex hull of their points.
///
/// # Errors
/// Returns [`Error::Mesh`] if a tetrahedron uses a node that does not exist, and
/// [`Error::Delaunay`] if a coordinate is not finite, if memory runs out, or without the feature
/// `cgal`.
pub fn validate(points: &[[f64; 3]], tets: &[[u32; 4]]) -> Result<CgalReport> {
    let is_out_of_range = |t: &&[u32; 4]| t.iter().any(|&node| node as usize >= points.len());
    if let Some(tet) = tets.iter().find(is_out_of_range) {
        return Err(Error::Mesh(cause(
            "mesh",
            format!(
                "a tetrahedron has the nodes {tet:?}, but there are {} nodes",
                points.len()
            ),
            crate::files::REWRITE_DAMAGED,
        )));
    }
    // CGAL's structure numbers four faces for each tetrahedron, and four beyond each hull face,
    // with 32 bits.
    if points.len().max(tets.len()) > u32::MAX as usize / 32 {
        let problem = format!("{} nodes, {} tetrahedra", points.len(), tets.len());
        let remedy = "mesh with a larger --distance: CGAL takes at most 134 million of each";
        return Err(Error::Delaunay(cause(PLACE, problem, remedy)));
    }
    let verdict = call(PLACE, points, |points| {
        ffi::cgal_validate(points, tets.as_flattened())
    })?;
    Ok(CgalReport {
        inverted: verdict.inverted,
        flat: verdict.flat,
        unused_nodes: verdict.unused_nodes,
        overfull_faces: verdict.overfull_faces,
        hull_faces: verdict.hull_faces,
        valid_topology: verdict.valid_topology,
        volume: verdict.volume,
        hull_volume: verdict.hull_volume,
    })
}

#[cfg(test)]
#[cfg(all(feature = "cgal", feature = "tetgen"))]
mod tests {
    use super::*;
    use crate::mesh::delaunay::delaunay;

    /// Returns distinct points without a pattern.
    fn scattered_points(count: usize) -> Vec<[f64; 3]> {
        let mut state = 1u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..count)
            .map(|_| [next(), next() * 3.0, next() - 6e5])
            .collect()
    }

    fn sorted(tets: &[[u32; 4]]) -> Vec<[u32; 4]> {
        let mut tets = tets.to_vec();
        tets.iter_mut().for_each(|t| t.sort_unstable());
        tets.sort_unstable();
        tets
    }

    fn lattice(m: usize) -> Vec<[f64; 3]> {
        let all = 0..(m + 1).pow(3);
        let index = |i: usize| [i % (m + 1), i / (m + 1) % (m + 1), i / (m + 1).pow(2)];
        let fcc = all.map(index).filter(|i| i.iter().sum::<usize>() % 2 == 0);
        fcc.map(|i| i.map(|c| c as f64 * 0.7)).collect()
    }

    #[test]
    fn cgal_and_tetgen_make_the_same_tetrahedra() {
        let points = scattered_points(3000);
        let by_tetgen = delaunay(&points).unwrap();
        let by_cgal = triangulate(&points).unwrap();
        assert_eq!(sorted(&by_tetgen.tets), sorted(&by_cgal));
        for tets in [&by_tetgen.tets, &by_cgal] {
            assert_eq!(validate(&points, tets).unwrap().faults(1e-12), [""; 0]);
        }
    }

    #[test]
    fn a_degenerate_lattice_is_a_valid_triangulation() {
        let points = lattice(10);
        let mesh = delaunay(&points).unwrap();
        let verdict = validate(&points, &mesh.tets).unwrap();
        assert_eq!(verdict.faults(1e-12), [""; 0]);
        // Each side has 61 nodes: 2 triangles for each inner node and 1 for each node on the rim,
        // minus 2.
        assert_eq!(verdict.hull_faces, 6 * (2 * 41 + 20 - 2));
        assert!((verdict.volume / 343.0 - 1.0).abs() < 1e-12);
    }

    /// A flip turns two tetrahedra into three; one of the two triangulations is not Delaunay.
    #[test]
    fn meshes_need_not_be_delaunay_to_be_valid() {
        let points = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.3, 0.3, -0.5],
            [0.3, 0.3, 0.6],
        ];
        let two = [[0, 1, 2, 4], [0, 2, 1, 3]];
        let three = [[0, 1, 3, 4], [1, 2, 3, 4], [2, 0, 3, 4]];
        for tets in [&two[..], &three[..]] {
            let verdict = validate(&points, tets).unwrap();
            assert_eq!(verdict.faults(1e-14), [""; 0], "{verdict:?}");
            assert_eq!(verdict.hull_faces, 6);
        }
    }

    #[test]
    fn every_kind_of_damage_is_found() {
        let points = lattice(4);
        let valid_tets = delaunay(&points).unwrap().tets;
        let faulty_report = |points: &[[f64; 3]], tets: &[[u32; 4]]| {
            let verdict = validate(points, tets).unwrap();
            assert!(!verdict.faults(1e-9).is_empty(), "{verdict:?}");
            verdict
        };
        assert_eq!(
            validate(&points, &valid_tets).unwrap().faults(1e-12),
            [""; 0]
        );

        let mut turned = valid_tets.clone();
        turned[5].swap(0, 1);
        let verdict = faulty_report(&points, &turned);
        assert!(
            verdict.inverted == 1 && !verdict.valid_topology,
            "{verdict:?}"
        );

        let mut with_flat = valid_tets.clone();
        with_flat.push([0, 1, 2, 0]);
        assert_eq!(faulty_report(&points, &with_flat).flat, 1);

        let mut duplicated = valid_tets.clone();
        duplicated.push(valid_tets[7]);
        assert!(faulty_report(&points, &duplicated).overfull_faces > 0);

        // Without one inner tetrahedron all faces are still shared properly, but volume is missing.
        let hull_node = |n: u32| {
            points[n as usize]
                .iter()
                .any(|&c| c == 0.0 || c == 4.0 * 0.7)
        };
        let inner_tet = valid_tets
            .iter()
            .position(|t| !t.iter().any(|&n| hull_node(n)))
            .unwrap();
        let mut with_hole = valid_tets.clone();
        with_hole.remove(inner_tet);
        let verdict = faulty_report(&points, &with_hole);
        assert!(verdict.volume < verdict.hull_volume * (1.0 - 1e-4));

        let mut more_points = points.clone();
        more_points.push([1.0, 1.1, 1.2]);
        assert_eq!(faulty_report(&more_points, &valid_tets).unused_nodes, 1);

        // A node moves through the opposite faces of its star.
        let mut moved = points.clone();
        let node = valid_tets[inner_tet][0] as usize;
        moved[node][0] += 2.0;
        let verdict = faulty_report(&moved, &valid_tets);
        assert!(
            verdict.inverted > 0 && verdict.valid_topology,
            "{verdict:?}"
        );

        faulty_report(&points, &[]);
        faulty_report(&[], &[]);
        // Two tetrahedra with opposite orientation on the same nodes: a closed surface without a
        // hull.
        let closed = faulty_report(&points[..4], &[[0, 1, 2, 3], [1, 0, 2, 3]]);
        assert!(closed.hull_faces == 0 && !closed.valid_topology);
    }

    #[test]
    fn impossible_input_is_named() {
        let mut points = lattice(2);
        let duplicate = points[3];
        points.push(duplicate);
        let text = triangulate(&points).unwrap_err().to_string();
        assert!(text.contains("1 of 15 points coincide"), "{text}");
        points[2][1] = f64::NAN;
        assert!(
            triangulate(&points)
                .unwrap_err()
                .to_string()
                .contains("point 2 is at")
        );
        assert!(
            validate(&points, &[])
                .unwrap_err()
                .to_string()
                .contains("point 2 is at")
        );
        let text = validate(&lattice(2), &[[0, 1, 2, 99]])
            .unwrap_err()
            .to_string();
        assert!(text.contains("99"), "{text}");
    }
}

#[cfg(test)]
#[cfg(not(feature = "cgal"))]
mod tests_without_cgal {
    #[test]
    fn error_names_the_missing_library() {
        let text = super::triangulate(&[]).unwrap_err().to_string();
        assert!(
            text.contains("without CGAL") && text.contains("libcgal-dev"),
            "{text}"
        );
        assert!(super::validate(&[], &[]).is_err());
    }
}
