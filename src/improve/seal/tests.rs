mod partitions;

use super::*;
use crate::geometry::random::Random;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::mesh::{TetMesh, TriMesh};

/// Spacing of the nodes of the boxes.
const SPACING: f64 = 4.0;
/// Number of cells along each side of the boxes.
const CELLS_PER_SIDE: usize = 10;
/// Coordinate of the surfaces: x (or y) of all their points.
const PLANE_X: f64 = 20.0;

/// Returns a feature point on a plane normal to `axis`, moved off it by some noise.
fn point<const DIM: usize>(
    axis: usize,
    mut position: [f64; 3],
    random: &mut Random,
) -> FeaturePoint<DIM> {
    position[axis] += random.range(-0.1, 0.1);
    let normal = std::array::from_fn(|k| f32::from(u8::from(k == axis)));
    FeaturePoint {
        position: std::array::from_fn(|k| position[k] as f32),
        normal,
        strength: 1.0,
    }
}

/// Returns the points of the surfaces x = `PLANE_X` and y = `PLANE_X`, one per sample, for which
/// `keeps` is true.
fn points<const DIM: usize>(keeps: impl Fn(usize, [f64; 3]) -> bool) -> Vec<FeaturePoint<DIM>> {
    let mut random = Random::for_purpose(1, 2);
    let side = (SPACING as usize) * CELLS_PER_SIDE;
    let mut points = Vec::new();
    for axis in 0..2 {
        for z in 0..=if DIM == 3 { side } else { 0 } {
            for offset in 0..=side {
                let mut position = [0.0, 0.0, z as f64];
                (position[axis], position[1 - axis]) = (PLANE_X, offset as f64);
                if keeps(axis, position) {
                    points.push(point(axis, position, &mut random));
                }
            }
        }
    }
    points
}

fn seal_box<const DIM: usize, M: Simplices<DIM>>(
    mesh: &M,
    points: &[FeaturePoint<DIM>],
    marks: &mut [u8],
) -> SealReport {
    let (extent, distance) = (
        [SPACING * CELLS_PER_SIDE as f64; DIM],
        Distance::Constant(SPACING),
    );
    let neighbours = mesh.neighbours().unwrap();
    let cancel = CancelToken::never();
    let distance_near = |_: &[[f64; DIM]]| Ok(Cow::Borrowed(&distance));
    let view = MeshView::from_mesh(mesh);
    seal(
        &view,
        &neighbours,
        points,
        extent,
        SPACING,
        distance_near,
        marks,
        &cancel,
    )
    .unwrap()
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

/// Returns the distance of a node from the middle of the box, measured within the surface x =
/// `PLANE_X`.
fn offset_from_plane<const DIM: usize>(x: [f64; DIM]) -> f64 {
    (1..DIM)
        .map(|k| (x[k] - PLANE_X).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Checks that faces on the surface whose marks are lost are marked again, and no others.
fn lost_marks_come_back<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = box_mesh::<DIM, M>();
    let expected = faces_on(&mesh, |x: [f64; DIM]| x[0] == PLANE_X);
    let mut torn = faces_on(&mesh, |x: [f64; DIM]| {
        x[0] == PLANE_X && offset_from_plane(x) > 1.5 * SPACING
    });
    assert_ne!(torn, expected);
    let report = seal_box(&mesh, &points::<DIM>(|axis, _| axis == 0), &mut torn);
    assert_eq!(torn, expected);
    assert!(report.faces > 0 && report.compartments == 2 && report.pockets == 0);
    let face_area = if DIM == 3 {
        SPACING * SPACING / 2.0
    } else {
        SPACING
    };
    assert!((report.area - face_area * report.faces as f64).abs() < 1e-9);
}

#[test]
fn lost_faces_come_back() {
    lost_marks_come_back::<3, TetMesh>();
    lost_marks_come_back::<2, TriMesh>();
}

/// Checks that steps close the surface where nodes are off it, and that nothing is closed over a
/// hole in the feature surface or beyond its rim.
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
    let report = seal_box(&mesh, &points_where(&|_| true), &mut marks);
    assert!(report.faces > 0 && report.compartments == 2, "{report:?}");

    // A hole that the image shows.
    let mut marks = torn.clone();
    let is_outside_hole = |x: [f64; 3]| {
        (x[1] - PLANE_X).hypot(if DIM == 3 { x[2] - PLANE_X } else { 0.0 }) > 2.0 * SPACING
    };
    let report = seal_box(&mesh, &points_where(&is_outside_hole), &mut marks);
    assert_eq!((report.faces, report.compartments), (0, 1));
    assert_eq!(marks, torn);

    // A surface that ends inside of the box: with a hole near its end, and without.
    let half = |x: [f64; DIM]| x[0] == PLANE_X && x[1] < PLANE_X + 0.1;
    let mesh = box_mesh::<DIM, M>();
    let expected = faces_on(&mesh, half);
    let tip = points_where(&|x| x[1] < PLANE_X + 1.0);
    let mut marks = expected.clone();
    let report = seal_box(&mesh, &tip, &mut marks);
    assert_eq!((report.faces, report.compartments), (0, 1));
    assert_eq!(marks, expected);
    let mut marks = faces_on(&mesh, |x| {
        half(x) && (x[1] - 0.3 * extent).abs() > 0.6 * SPACING
    });
    assert_ne!(marks, expected);
    seal_box(&mesh, &tip, &mut marks);
    assert_eq!(marks, expected);
}

#[test]
fn steps_close_what_the_mesh_does_not_follow() {
    steps_close::<3, TetMesh>();
    steps_close::<2, TriMesh>();
}

/// Checks that a surface that ends at another is closed up to it and does not continue beyond.
fn surface_ends_at_another<const DIM: usize, M: Simplices<DIM>>() {
    let mesh = box_mesh::<DIM, M>();
    let ends = |x: [f64; DIM]| x[1] == PLANE_X && x[0] <= PLANE_X;
    let full = |x: [f64; DIM]| x[0] == PLANE_X;
    // Marks of the faces of two planes.
    let united =
        |a: Vec<u8>, b: Vec<u8>| -> Vec<u8> { a.iter().zip(b).map(|(a, b)| a | b).collect() };
    let expected = united(faces_on(&mesh, full), faces_on(&mesh, ends));
    let gap = |x: [f64; DIM]| ends(x) && x[0] < PLANE_X - 0.5 * SPACING;
    let mut marks = united(faces_on(&mesh, full), faces_on(&mesh, gap));
    assert_ne!(marks, expected);
    // Detection ends two samples before the crossing, or one sample beyond it.
    for last in [PLANE_X - 2.0, PLANE_X + 1.0] {
        let mut marks = marks.clone();
        let points = points::<DIM>(|axis, x| axis == 0 || x[0] <= last);
        let report = seal_box(&mesh, &points, &mut marks);
        assert_eq!(report.compartments, 3);
        assert_eq!(marks, expected);
    }
    let report = seal_box(&mesh, &[], &mut marks);
    assert_eq!((report.faces, report.compartments), (0, 2));
}

#[test]
fn a_surface_is_closed_up_to_the_one_at_which_it_ends() {
    surface_ends_at_another::<3, TetMesh>();
    surface_ends_at_another::<2, TriMesh>();
}
