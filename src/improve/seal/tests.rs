mod pieces;

use super::*;
use crate::geometry::random::Random;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::mesh::{TetMesh, TriMesh};

/// Spacing of the boxes' nodes.
const SPACING: f64 = 4.0;
/// Sides of the boxes, in units of that.
const CELLS_PER_SIDE: usize = 10;
/// Where the sheet is: x is this.
const PLANE_X: f64 = 20.0;

/// A point on the plane of all points that share coordinate `axis`, off by some noise.
fn point(axis: usize, mut at: [f64; 3], random: &mut Random) -> FeaturePoint<3> {
    at[axis] += random.range(-0.1, 0.1);
    let normal = std::array::from_fn(|k| f32::from(u8::from(k == axis)));
    FeaturePoint {
        position: at.map(|c| c as f32),
        normal,
        strength: 1.0,
    }
}

/// The points of the sheet x = `AT` and of the sheet y = `AT`, one a sample, where `on` holds.
fn points<const DIM: usize>(on: impl Fn(usize, [f64; 3]) -> bool) -> Vec<FeaturePoint<3>> {
    let mut random = Random::for_purpose(1, 2);
    let side = (SPACING as usize) * CELLS_PER_SIDE;
    let mut points = Vec::new();
    for axis in 0..2 {
        for z in 0..=if DIM == 3 { side } else { 0 } {
            for along in 0..=side {
                let mut at = [0.0, 0.0, z as f64];
                (at[axis], at[1 - axis]) = (PLANE_X, along as f64);
                if on(axis, at) {
                    points.push(point(axis, at, &mut random));
                }
            }
        }
    }
    points
}

fn seal_box<const DIM: usize, M: Simplices<DIM>>(
    mesh: &M,
    points: &[FeaturePoint<3>],
    marks: &mut [u8],
) -> SealReport {
    let (extent, distance) = (
        [SPACING * CELLS_PER_SIDE as f64; DIM],
        Distance::Constant(SPACING),
    );
    let neighbors = mesh.neighbors().unwrap();
    let patience = CancelToken::never();
    seal(
        mesh, &neighbors, points, extent, &distance, marks, &patience,
    )
}

fn box_mesh<const DIM: usize, M: Simplices<DIM>>() -> M {
    let inner = |x: [f64; DIM]| x[0] != PLANE_X && x[1] != PLANE_X;
    jittered_box(
        [CELLS_PER_SIDE; DIM],
        [SPACING * CELLS_PER_SIDE as f64; DIM],
        0.2,
        inner,
    )
}

/// How far a node is from the middle of the box along the sheet x = `AT`.
fn offset_from_plane<const DIM: usize>(x: [f64; DIM]) -> f64 {
    (1..DIM)
        .map(|k| (x[k] - PLANE_X).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Faces on the sheet whose marks are lost where the sheet has points come back, and no other.
fn lost_marks_come_back<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = box_mesh::<DIM, M>();
    let whole = faces_on(&mesh, |x: [f64; DIM]| x[0] == PLANE_X);
    let mut torn = faces_on(&mesh, |x: [f64; DIM]| {
        x[0] == PLANE_X && offset_from_plane(x) > 1.5 * SPACING
    });
    assert_ne!(torn, whole);
    let done = seal_box(&mesh, &points::<DIM>(|axis, _| axis == 0), &mut torn);
    assert_eq!(torn, whole);
    assert!(done.faces > 0 && done.compartments == 2 && done.pockets == 0);
    let each = if DIM == 3 {
        SPACING * SPACING / 2.0
    } else {
        SPACING
    };
    assert!((done.area - each * done.faces as f64).abs() < 1e-9);
}

#[test]
fn lost_faces_come_back() {
    lost_marks_come_back::<3, TetMesh>();
    lost_marks_come_back::<2, TriMesh>();
}

/// Where nodes are off the sheet, steps close it; over a hole in the sheet, and beyond its rim, nothing is
/// closed.
fn steps_close<const DIM: usize, M: Simplices<DIM>>() {
    let mut mesh = box_mesh::<DIM, M>();
    let extent = SPACING * CELLS_PER_SIDE as f64;
    for (i, x) in mesh.parts_mut().0.iter_mut().enumerate() {
        if x[0] == PLANE_X && offset_from_plane(*x) < 1.2 * SPACING {
            x[0] += if i % 2 == 0 {
                0.35 * SPACING
            } else {
                -0.35 * SPACING
            };
        }
    }
    let torn = faces_on(&mesh, |x: [f64; DIM]| x[0] == PLANE_X);
    let points_where = |on: &dyn Fn([f64; 3]) -> bool| points::<DIM>(|axis, x| axis == 0 && on(x));
    let mut marks = torn.clone();
    let done = seal_box(&mesh, &points_where(&|_| true), &mut marks);
    assert!(done.faces > 0 && done.compartments == 2, "{done:?}");

    // A hole that the image shows.
    let mut marks = torn.clone();
    let beyond = |x: [f64; 3]| {
        (x[1] - PLANE_X).hypot(if DIM == 3 { x[2] - PLANE_X } else { 0.0 }) > 2.0 * SPACING
    };
    let done = seal_box(&mesh, &points_where(&beyond), &mut marks);
    assert_eq!((done.faces, done.compartments), (0, 1));
    assert_eq!(marks, torn);

    // A sheet that ends inside: with a hole near its end, and without.
    let half = |x: [f64; DIM]| x[0] == PLANE_X && x[1] < PLANE_X + 0.1;
    let mesh = box_mesh::<DIM, M>();
    let whole = faces_on(&mesh, half);
    let tip = points_where(&|x| x[1] < PLANE_X + 1.0);
    let mut marks = whole.clone();
    let done = seal_box(&mesh, &tip, &mut marks);
    assert_eq!((done.faces, done.compartments), (0, 1));
    assert_eq!(marks, whole);
    let mut marks = faces_on(&mesh, |x| {
        half(x) && (x[1] - 0.3 * extent).abs() > 0.6 * SPACING
    });
    assert_ne!(marks, whole);
    seal_box(&mesh, &tip, &mut marks);
    assert_eq!(marks, whole);
}

#[test]
fn steps_close_what_the_mesh_does_not_follow() {
    steps_close::<3, TetMesh>();
    steps_close::<2, TriMesh>();
}

/// A sheet that ends at another is closed up to it, and does not go on beyond.
fn meets<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = box_mesh::<DIM, M>();
    let ends = |x: [f64; DIM]| x[1] == PLANE_X && x[0] <= PLANE_X;
    let whole = |x: [f64; DIM]| x[0] == PLANE_X;
    // Faces of two planes: marks of each, united.
    let united =
        |a: Vec<u8>, b: Vec<u8>| -> Vec<u8> { a.iter().zip(b).map(|(a, b)| a | b).collect() };
    let want = united(faces_on(&mesh, whole), faces_on(&mesh, ends));
    let gap = |x: [f64; DIM]| ends(x) && x[0] < PLANE_X - 0.5 * SPACING;
    let mut marks = united(faces_on(&mesh, whole), faces_on(&mesh, gap));
    assert_ne!(marks, want);
    // Detection ends two samples before the crossing, and one beyond.
    for last in [PLANE_X - 2.0, PLANE_X + 1.0] {
        let mut marks = marks.clone();
        let points = points::<DIM>(|axis, x| axis == 0 || x[0] <= last);
        let done = seal_box(&mesh, &points, &mut marks);
        assert_eq!(done.compartments, 3);
        assert_eq!(marks, want);
    }
    let none = seal_box(&mesh, &[], &mut marks);
    assert_eq!((none.faces, none.compartments), (0, 2));
}

#[test]
fn a_sheet_is_closed_up_to_the_one_at_which_it_ends() {
    meets::<3, TetMesh>();
    meets::<2, TriMesh>();
}
