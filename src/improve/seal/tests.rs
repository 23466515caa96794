mod pieces;

use super::*;
use crate::geometry::random::Random;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::mesh::{TetMesh, TriMesh};

/// Spacing of the boxes' nodes.
const D: f64 = 4.0;
/// Sides of the boxes, in units of that.
const N: usize = 10;
/// Where the sheet is: x is this.
const AT: f64 = 20.0;

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
    let mut random = Random::of(1, 2);
    let side = (D as usize) * N;
    let mut points = Vec::new();
    for axis in 0..2 {
        for z in 0..=if DIM == 3 { side } else { 0 } {
            for along in 0..=side {
                let mut at = [0.0, 0.0, z as f64];
                (at[axis], at[1 - axis]) = (AT, along as f64);
                if on(axis, at) {
                    points.push(point(axis, at, &mut random));
                }
            }
        }
    }
    points
}

fn sealed<const DIM: usize, M: Simplices<DIM>>(
    mesh: &M,
    points: &[FeaturePoint<3>],
    marks: &mut [u8],
) -> Sealed {
    let (extent, distance) = ([D * N as f64; DIM], Distance::Constant(D));
    let neighbors = mesh.neighbors().unwrap();
    let patience = Patience::endless();
    seal(
        mesh, &neighbors, points, extent, &distance, marks, &patience,
    )
}

fn lattice<const DIM: usize, M: Simplices<DIM>>() -> M {
    let inner = |x: [f64; DIM]| x[0] != AT && x[1] != AT;
    jittered_box([N; DIM], [D * N as f64; DIM], 0.2, inner)
}

/// How far a node is from the middle of the box along the sheet x = `AT`.
fn aside<const DIM: usize>(x: [f64; DIM]) -> f64 {
    (1..DIM).map(|k| (x[k] - AT).powi(2)).sum::<f64>().sqrt()
}

/// Faces on the sheet whose marks are lost where the sheet has points come back, and no other.
fn lost_marks_come_back<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = lattice::<DIM, M>();
    let whole = faces_on(&mesh, |x: [f64; DIM]| x[0] == AT);
    let mut torn = faces_on(&mesh, |x: [f64; DIM]| x[0] == AT && aside(x) > 1.5 * D);
    assert_ne!(torn, whole);
    let done = sealed(&mesh, &points::<DIM>(|axis, _| axis == 0), &mut torn);
    assert_eq!(torn, whole);
    assert!(done.faces > 0 && done.rooms == 2 && done.pockets == 0);
    let each = if DIM == 3 { D * D / 2.0 } else { D };
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
    let mut mesh = lattice::<DIM, M>();
    let extent = D * N as f64;
    for (i, x) in mesh.parts_mut().0.iter_mut().enumerate() {
        if x[0] == AT && aside(*x) < 1.2 * D {
            x[0] += if i % 2 == 0 { 0.35 * D } else { -0.35 * D };
        }
    }
    let torn = faces_on(&mesh, |x: [f64; DIM]| x[0] == AT);
    let points_where = |on: &dyn Fn([f64; 3]) -> bool| points::<DIM>(|axis, x| axis == 0 && on(x));
    let mut marks = torn.clone();
    let done = sealed(&mesh, &points_where(&|_| true), &mut marks);
    assert!(done.faces > 0 && done.rooms == 2, "{done:?}");

    // A hole that the image shows.
    let mut marks = torn.clone();
    let beyond = |x: [f64; 3]| (x[1] - AT).hypot(if DIM == 3 { x[2] - AT } else { 0.0 }) > 2.0 * D;
    let done = sealed(&mesh, &points_where(&beyond), &mut marks);
    assert_eq!((done.faces, done.rooms), (0, 1));
    assert_eq!(marks, torn);

    // A sheet that ends inside: with a hole near its end, and without.
    let half = |x: [f64; DIM]| x[0] == AT && x[1] < AT + 0.1;
    let mesh = lattice::<DIM, M>();
    let whole = faces_on(&mesh, half);
    let tip = points_where(&|x| x[1] < AT + 1.0);
    let mut marks = whole.clone();
    let done = sealed(&mesh, &tip, &mut marks);
    assert_eq!((done.faces, done.rooms), (0, 1));
    assert_eq!(marks, whole);
    let mut marks = faces_on(&mesh, |x| half(x) && (x[1] - 0.3 * extent).abs() > 0.6 * D);
    assert_ne!(marks, whole);
    sealed(&mesh, &tip, &mut marks);
    assert_eq!(marks, whole);
}

#[test]
fn steps_close_what_the_mesh_does_not_follow() {
    steps_close::<3, TetMesh>();
    steps_close::<2, TriMesh>();
}

/// A sheet that ends at another is closed up to it, and does not go on beyond.
fn meets<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = lattice::<DIM, M>();
    let ends = |x: [f64; DIM]| x[1] == AT && x[0] <= AT;
    let whole = |x: [f64; DIM]| x[0] == AT;
    // Faces of two planes: marks of each, united.
    let united =
        |a: Vec<u8>, b: Vec<u8>| -> Vec<u8> { a.iter().zip(b).map(|(a, b)| a | b).collect() };
    let want = united(faces_on(&mesh, whole), faces_on(&mesh, ends));
    let gap = |x: [f64; DIM]| ends(x) && x[0] < AT - 0.5 * D;
    let mut marks = united(faces_on(&mesh, whole), faces_on(&mesh, gap));
    assert_ne!(marks, want);
    // Detection ends two samples before the crossing, and one beyond.
    for last in [AT - 2.0, AT + 1.0] {
        let mut marks = marks.clone();
        let points = points::<DIM>(|axis, x| axis == 0 || x[0] <= last);
        let done = sealed(&mesh, &points, &mut marks);
        assert_eq!(done.rooms, 3);
        assert_eq!(marks, want);
    }
    let none = sealed(&mesh, &[], &mut marks);
    assert_eq!((none.faces, none.rooms), (0, 2));
}

#[test]
fn a_sheet_is_closed_up_to_the_one_at_which_it_ends() {
    meets::<3, TetMesh>();
    meets::<2, TriMesh>();
}
