//! Tests of all kernels with valid and invalid points.

use super::*;
use crate::Error;
use crate::geometry::{cross, dot, volume6};

/// Returns face-centred cubic points of half-spacing `h` in the box [0, m * h]^3, sides included.
fn fcc(m: usize, h: f64) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for k in 0..=m {
        for j in 0..=m {
            for i in 0..=m {
                if (i + j + k) % 2 == 0 {
                    points.push([i as f64 * h, j as f64 * h, k as f64 * h]);
                }
            }
        }
    }
    points
}

/// Returns a uniform random number in [0, 1), from a simple generator that is good enough for
/// tests.
fn uniform(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

fn six_volumes(mesh: &TetMesh) -> Vec<f64> {
    (0..mesh.tets.len())
        .map(|t| volume6(&mesh.corners(t)))
        .collect()
}

/// Asserts that tetrahedra are positive and have the right total volume, neighbours are mutual, and
/// the hull's faces lie on the box's sides and cover their area.
fn assert_fills_box(d: &Delaunay, extent: [f64; 3]) {
    let volumes6 = six_volumes(&d.mesh);
    let box_volume = extent[0] * extent[1] * extent[2];
    let worst = volumes6.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(worst > 1e-9, "a flat or inverted tetrahedron: {worst}");
    let error = volumes6.iter().sum::<f64>() / 6.0 / box_volume - 1.0;
    assert!(error.abs() <= 1e-12, "volume error {error}");
    let mut area = [0.0; 6];
    for (t, tet) in d.mesh.tets.iter().enumerate() {
        for k in 0..4 {
            let mut face: Vec<u32> = (0..4).filter(|&i| i != k).map(|i| tet[i]).collect();
            let n = d.neighbours[t][k];
            if n == NONE {
                let x: Vec<[f64; 3]> = face.iter().map(|&i| d.mesh.nodes[i as usize]).collect();
                let side = (0..6)
                    .find(|&s| {
                        let (axis, value) = (s / 2, if s % 2 == 0 { 0.0 } else { extent[s / 2] });
                        x.iter().all(|p| p[axis] == value)
                    })
                    .expect("a hull face off the box's sides");
                let (a, b) = ((side / 2 + 1) % 3, (side / 2 + 2) % 3);
                area[side] += 0.5
                    * ((x[1][a] - x[0][a]) * (x[2][b] - x[0][b])
                        - (x[1][b] - x[0][b]) * (x[2][a] - x[0][a]))
                        .abs();
            } else {
                let back_index = d.neighbours[n as usize]
                    .iter()
                    .position(|&b| b as usize == t);
                let back_index = back_index.expect("neighbours are mutual");
                let other_tet = d.mesh.tets[n as usize];
                let mut other_face: Vec<u32> = (0..4)
                    .filter(|&i| i != back_index)
                    .map(|i| other_tet[i])
                    .collect();
                face.sort_unstable();
                other_face.sort_unstable();
                assert_eq!(face, other_face);
            }
        }
    }
    for (side, area) in area.iter().enumerate() {
        let expected = box_volume / extent[side / 2];
        assert!(
            (area / expected - 1.0).abs() < 1e-12,
            "side {side}: area {area}, not {expected}"
        );
    }
}

fn error_message(points: &[[f64; 3]]) -> String {
    match delaunay(points) {
        Err(Error::Delaunay(cause)) => cause.to_string(),
        other => panic!("expected Error::Delaunay, got {other:?}"),
    }
}

#[test]
fn four_points_make_one_positive_tetrahedron() {
    let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let d = delaunay_with_neighbours(&points).unwrap();
    assert_eq!(d.mesh.nodes, points);
    assert_eq!(d.neighbours, [[NONE; 4]]);
    assert_eq!(six_volumes(&d.mesh), [1.0]);
    assert_eq!(delaunay(&points).unwrap(), d.mesh);
}

/// The most degenerate case: every point lies on many common spheres, and the hull's points in six
/// planes. (Five points of each square, and eight around each octahedron, are cospherical.)
#[test]
fn perfect_lattice_fills_its_box() {
    for m in [2, 3, 10] {
        // 0.7 is not a dyadic fraction: the planes are exact only because coordinates repeat.
        let h = 0.7;
        let d = delaunay_with_neighbours(&if m == 3 {
            // For odd sizes the parity lattice lacks some corners, so all eight are added.
            let mut points = fcc(m, h);
            for corner in 0..8 {
                let p = std::array::from_fn(|k| ((corner >> k) & 1) as f64 * m as f64 * h);
                if !points.contains(&p) {
                    points.push(p);
                }
            }
            points
        } else {
            fcc(m, h)
        })
        .unwrap();
        assert_fills_box(&d, [m as f64 * h; 3]);
    }
}

#[test]
fn random_interior_in_a_regular_box_is_delaunay() {
    let (m, h) = (12, 1.3);
    let length = m as f64 * h;
    let mut state = 7;
    let mut points = fcc(m, h);
    for p in &mut points {
        if p.iter().all(|&c| c > 0.0 && c < length) {
            p.iter_mut()
                .for_each(|c| *c += (uniform(&mut state) - 0.5) * h);
        }
    }
    let d = delaunay_with_neighbours(&points).unwrap();
    assert_fills_box(&d, [length; 3]);
    // Empty spheres: the node beyond each face is not inside the circumsphere (up to rounding).
    for (t, tet) in d.mesh.tets.iter().enumerate() {
        for k in 0..4 {
            let n = d.neighbours[t][k];
            if n == NONE {
                continue;
            }
            let opposite = d.mesh.tets[n as usize]
                .into_iter()
                .find(|node| !tet.contains(node))
                .unwrap();
            let (centre, radius) = circumsphere(tet.map(|i| points[i as usize]));
            let q = points[opposite as usize];
            let distance = (0..3)
                .map(|k| (q[k] - centre[k]).powi(2))
                .sum::<f64>()
                .sqrt();
            assert!(distance > radius * (1.0 - 1e-6), "{distance} < {radius}");
        }
    }
}

fn circumsphere(x: [[f64; 3]; 4]) -> ([f64; 3], f64) {
    let e: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| x[i + 1][k] - x[0][k]));
    let volume6 = dot(e[0], cross(e[1], e[2]));
    let (a, b, c) = (cross(e[1], e[2]), cross(e[2], e[0]), cross(e[0], e[1]));
    let r: [f64; 3] = std::array::from_fn(|k| {
        (dot(e[0], e[0]) * a[k] + dot(e[1], e[1]) * b[k] + dot(e[2], e[2]) * c[k]) / (2.0 * volume6)
    });
    (std::array::from_fn(|k| x[0][k] + r[k]), dot(r, r).sqrt())
}

#[test]
fn same_points_same_tetrahedra_also_from_many_threads() {
    let points = fcc(8, 1.0);
    let expected = delaunay(&points).unwrap();
    std::thread::scope(|scope| {
        let runs: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| delaunay(&points).unwrap()))
            .collect();
        for run in runs {
            assert_eq!(run.join().unwrap(), expected);
        }
    });
}

#[test]
fn impossible_points_are_named() {
    let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    assert!(error_message(&[]).contains("0 points"));
    assert!(error_message(&corners[..3]).contains("3 points"));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut points = corners;
        points[2][1] = bad;
        assert!(error_message(&points).contains("point 2 is at"));
    }
    let flat: Vec<[f64; 3]> = fcc(4, 1.0).into_iter().map(|p| [p[0], 3.5, p[2]]).collect();
    assert!(error_message(&flat).contains("extend over 0 along y"));
    assert!(error_message(&[[1.0; 3]; 9]).contains("extend over 0 along x"));
    assert!(
        error_message(&[[-f64::MAX; 3], [f64::MAX; 3], [0.0; 3], [1.0; 3]]).contains("inf along x")
    );
}

#[test]
fn oblique_planes_and_lines_are_named_and_thin_slabs_are_not() {
    let mut plane = Vec::new();
    for j in 0..20 {
        for i in 0..20 {
            let (x, y) = (f64::from(i), f64::from(j) * 0.7);
            plane.push([x, y, 0.1 * x + 2.3 * y]);
        }
    }
    assert!(error_message(&plane).contains("one plane"));
    let line: Vec<[f64; 3]> = (0..50)
        .map(|i| [0.1, 0.2, 0.7].map(|c| c * f64::from(i)))
        .collect();
    assert!(error_message(&line).contains("one line"));
    let far_away: Vec<[f64; 3]> = line.iter().map(|p| p.map(|c| c + 6e5)).collect();
    assert!(error_message(&far_away).contains("one line"));

    let slab: Vec<[f64; 3]> = plane
        .iter()
        .flat_map(|p| [[p[0], p[1], 0.0], [p[0], p[1], 1e-6]])
        .collect();
    let d = delaunay_with_neighbours(&slab).unwrap();
    let volume = six_volumes(&d.mesh).iter().sum::<f64>() / 6.0;
    assert!((volume / (19.0 * 19.0 * 0.7 * 1e-6) - 1.0).abs() < 1e-9);
}

#[test]
fn coinciding_points_are_named() {
    let mut points = fcc(6, 1.0);
    let duplicate = points.len();
    points.push(points[31]);
    let text = error_message(&points);
    assert!(
        text.contains(&format!("points {duplicate} and 31 are 0e0 apart"))
            || text.contains(&format!("points 31 and {duplicate} are 0e0 apart")),
        "{text}"
    );
    points.push(points[5]);
    assert!(error_message(&points).contains("and 1 more"));
}
