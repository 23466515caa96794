use super::*;
use crate::feature::FeaturePoint;
use crate::geometry::to_3d;
use crate::improve::snap_to_features;
use crate::lattice::seeding::{self, Alignment};
use crate::mesh::check::check;
use crate::mesh::delaunay::delaunay_plane;
use proptest::prelude::*;

const EXTENT: [f64; 2] = [90.0, 80.0];
const SPACING: f64 = 6.0;

/// Returns points on a circle and on a straight line, as detection would return them.
fn circle_and_line() -> Vec<FeaturePoint<3>> {
    let circle = (0..190).map(|i| {
        let (sin, cos) = (f64::from(i) / 190.0 * std::f64::consts::TAU).sin_cos();
        ([30.0 + 20.0 * cos, 40.0 + 20.0 * sin], [cos, sin])
    });
    let line = (0..=80).map(|i| ([70.3, f64::from(i)], [1.0, 0.0]));
    let point = |(x, n): ([f64; 2], [f64; 2])| FeaturePoint {
        position: to_3d(x).map(|c| c as f32),
        normal: to_3d(n).map(|c| c as f32),
        strength: 1.0,
    };
    circle.chain(line).map(point).collect()
}

fn distance_to_features([x, y]: [f64; 2]) -> f64 {
    let circle = ((x - 30.0).hypot(y - 40.0) - 20.0).abs();
    circle.min((x - 70.3).abs())
}

#[test]
fn edges_lie_on_the_curves_and_all_angles_are_large() {
    let planes = FeaturePlanes::new(&circle_and_line(), to_3d(EXTENT), 4.8, 1.7 * SPACING);
    let distance = Distance::Constant(SPACING);
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let moved = snap_to_features(
        &mut atoms.positions,
        &atoms.kinds,
        EXTENT,
        &planes,
        0.35 * SPACING,
    );
    assert!(moved > 20);
    let mut mesh = delaunay_plane(&atoms.positions).unwrap();
    let mut kinds = atoms.kinds;
    let (report, marks) = improve(
        &mut mesh,
        &mut kinds,
        EXTENT,
        &planes,
        &distance,
        30.0,
        &CancelToken::never(),
    )
    .unwrap();
    let checked = check(&mesh, [0.0; 2], EXTENT, 1e-12);
    assert!(checked.passed(), "{:?}", checked.problems);
    assert_eq!(kinds.len(), mesh.nodes.len());
    assert_eq!(report.counts.intersecting_left, 0, "{:?}", report.counts);

    // The marked edges lie on the curves and cover their whole length.
    let mut length = 0.0;
    let mut smallest = f64::INFINITY;
    for (t, bits) in marks.iter().enumerate() {
        smallest = angles(&mesh.corners(t))
            .into_iter()
            .fold(smallest, f64::min);
        for k in (0..3).filter(|k| bits >> k & 1 == 1) {
            let [p, q] = SIDES[k].map(|i| mesh.corners(t)[i]);
            let middle = [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
            assert!(
                distance_to_features(p).max(distance_to_features(q)) < 0.3,
                "{p:?} {q:?}"
            );
            assert!(distance_to_features(middle) < 0.75);
            // Each edge is marked from both of its triangles.
            length += 0.5 * (p[0] - q[0]).hypot(p[1] - q[1]);
        }
    }
    let total_length = 20.0 * std::f64::consts::TAU + 80.0;
    assert!(
        (length / total_length - 1.0).abs() < 0.03,
        "{length} of {total_length}"
    );
    assert!(smallest > 29.0, "{smallest}");
    // Nodes have the kind of the sides of the box on which they lie.
    for (x, kind) in mesh.nodes.iter().zip(&kinds) {
        let sides = (0..2).filter(|&k| x[k] == 0.0 || x[k] == EXTENT[k]).count();
        let expected = [AtomKind::Interior, AtomKind::Edge, AtomKind::Corner][sides];
        assert_eq!(*kind, expected, "{x:?}");
    }
}

#[test]
fn without_features_a_regular_lattice_is_left_alone() {
    let planes = FeaturePlanes::new(&[], to_3d(EXTENT), 4.8, 1.7 * SPACING);
    let distance = Distance::Constant(SPACING);
    let atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let before = delaunay_plane(&atoms.positions).unwrap();
    let (mut mesh, mut kinds) = (before.clone(), atoms.kinds.clone());
    let (report, marks) = improve(
        &mut mesh,
        &mut kinds,
        EXTENT,
        &planes,
        &distance,
        25.0,
        &CancelToken::never(),
    )
    .unwrap();
    assert_eq!((report.below_target_before, report.blocked.len()), (0, 0));
    assert!(marks.iter().all(|bits| *bits == 0));
    assert_eq!(mesh.nodes, before.nodes);
    assert_eq!(kinds, atoms.kinds);
}

#[test]
fn triangles_that_overlap_are_refused_and_left_as_they_are() {
    let planes = FeaturePlanes::new(&[], to_3d(EXTENT), 4.8, 1.7 * SPACING);
    let distance = Distance::Constant(SPACING);
    let before = TriMesh {
        nodes: vec![
            [0.0, 0.0],
            [90.0, 0.0],
            [90.0, 80.0],
            [0.0, 80.0],
            [40.0, 30.0],
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 2, 4]],
    };
    let (mut mesh, mut kinds) = (before.clone(), vec![AtomKind::Corner; 5]);
    let cancel = &CancelToken::never();
    let result = improve(
        &mut mesh, &mut kinds, EXTENT, &planes, &distance, 30.0, cancel,
    );
    let error = result.unwrap_err().to_string();
    assert!(
        error.contains("edge [0, 2]: belongs to more than two"),
        "{error}"
    );
    assert_eq!(mesh, before);
}

#[test]
fn corners_of_the_box_stay_where_other_nodes_have_the_same_constraints() {
    // All coordinates of the corners are fixed, and so are those of a fixed node. No angle can
    // reach the target, and the shortest edges are those between such nodes.
    let corners = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [4.0, 4.0]];
    let inside = [[2.0, 0.0], [1.0, 2.0], [3.0, 2.0], [2.0, 4.0]];
    let planes = FeaturePlanes::new(&[], [4.0, 4.0, 0.0], 4.8, 3.4);
    for (fixed, min_angle) in [(None, 60.0), (Some([4.0, 0.3]), 30.0)] {
        let nodes = [&corners[..], &inside, fixed.as_slice()].concat();
        let kind = |x: &[f64; 2]| {
            if fixed == Some(*x) {
                AtomKind::Fixed
            } else {
                seeding::kind_at(*x, [4.0; 2])
            }
        };
        let mut kinds: Vec<AtomKind> = nodes.iter().map(kind).collect();
        let mut mesh = delaunay_plane(&nodes).unwrap();
        improve(
            &mut mesh,
            &mut kinds,
            [4.0; 2],
            &planes,
            &Distance::Constant(2.0),
            min_angle,
            &CancelToken::never(),
        )
        .unwrap();
        let checked = check(&mesh, [0.0; 2], [4.0; 2], 1e-12);
        assert!(checked.passed(), "{fixed:?}: {:?}", checked.problems);
        for corner in corners {
            assert!(mesh.nodes.contains(&corner), "{fixed:?}: {corner:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]
    #[test]
    fn the_mesh_stays_valid_whatever_changes(
        jitter in proptest::collection::vec(proptest::array::uniform2(-2.9f64..2.9), 400),
    ) {
        let planes = FeaturePlanes::new(&circle_and_line(), to_3d(EXTENT), 4.8, 1.7 * SPACING);
        let distance = Distance::Constant(SPACING);
        let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
        for (i, (x, kind)) in atoms.positions.iter_mut().zip(&atoms.kinds).enumerate() {
            if *kind == AtomKind::Interior {
                let [u, v] = jitter[i % jitter.len()];
                *x = [(x[0] + u).clamp(0.5, 89.5), (x[1] + v).clamp(0.5, 79.5)];
            }
        }
        let mut mesh = delaunay_plane(&atoms.positions).unwrap();
        let worst = |mesh: &TriMesh| {
            (0..mesh.triangles.len())
                .flat_map(|t| angles(&mesh.corners(t)))
                .fold(180.0, f64::min)
        };
        let before = worst(&mesh);
        let mut kinds = atoms.kinds;
        let cancel = &CancelToken::never();
        let improved = improve(&mut mesh, &mut kinds, EXTENT, &planes, &distance, 30.0, cancel);
        let (report, _) = improved.unwrap();
        let checked = check(&mesh, [0.0; 2], EXTENT, 1e-9);
        prop_assert!(checked.passed(), "{:?}", checked.problems);
        prop_assert!(report.blocked.len() < report.below_target_before);
        prop_assert!(worst(&mesh) >= before.min(3.0));
    }
}
