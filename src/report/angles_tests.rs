use super::super::acute::AcutePair;
use super::super::quality::quality;
use super::*;
use crate::mesh::Mesh;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::{TetMesh, TriMesh};

/// Number of cubes along x and y; along z there are a few.
const CUBES_XY: usize = 12;
const CUBES_Z: usize = 4;
/// Indices of a node along x and y.
type GridIndex = [usize; 2];

/// Returns cubes cut into tetrahedra along all diagonal planes x - y = const, in units of the
/// cubes. The mesh is so narrow along x that those planes are at `degrees` to the planes x = const.
fn tetrahedra_of_cubes(degrees: f64) -> TetMesh {
    let mut mesh = kuhn_box([CUBES_XY, CUBES_XY, CUBES_Z], 1.0);
    let narrowing = degrees.to_radians().tan();
    mesh.nodes.iter_mut().for_each(|x| x[0] *= narrowing);
    mesh
}

/// Returns squares cut into triangles in the same way.
fn triangles_of_squares(degrees: f64) -> TriMesh {
    let narrowing = degrees.to_radians().tan();
    let position = |i: usize| {
        [
            (i % (CUBES_XY + 1)) as f64 * narrowing,
            (i / (CUBES_XY + 1)) as f64,
        ]
    };
    let square = |i: usize| {
        let a = (i / CUBES_XY * (CUBES_XY + 1) + i % CUBES_XY) as u32;
        let [b, c, d] = [1, CUBES_XY as u32 + 1, CUBES_XY as u32 + 2].map(|offset| a + offset);
        [[a, b, d], [a, d, c]]
    };
    TriMesh {
        nodes: (0..(CUBES_XY + 1) * (CUBES_XY + 1)).map(position).collect(),
        triangles: (0..CUBES_XY * CUBES_XY).flat_map(square).collect(),
    }
}

fn grid_index(node: u32) -> GridIndex {
    let node = node as usize;
    [
        node % (CUBES_XY + 1),
        node / (CUBES_XY + 1) % (CUBES_XY + 1),
    ]
}

fn extent<const D: usize, M: Simplices<D>>(mesh: &M) -> [f64; D] {
    let nodes = mesh.nodes().iter();
    nodes.fold([0.0; D], |max, x| std::array::from_fn(|k| x[k].max(max[k])))
}

/// Returns the bits of the faces that lie on one of the features.
fn feature_bits<const D: usize, M: Simplices<D>>(
    mesh: &M,
    features: &[fn(GridIndex) -> bool],
) -> Vec<u8> {
    let is_on_feature = |face: [u32; D]| {
        features
            .iter()
            .any(|feature| face.iter().all(|&n| feature(grid_index(n))))
    };
    let bits = |c: usize| {
        (0..=D)
            .map(|k| u8::from(is_on_feature(mesh.face(c, k))) << k)
            .sum()
    };
    (0..mesh.len()).map(bits).collect()
}

fn judge<const D: usize, M: Simplices<D>>(
    mesh: &M,
    features: &[fn(GridIndex) -> bool],
) -> AngleAssessment {
    assess_angles(mesh, &feature_bits(mesh, features), extent(mesh), |_| 1.0)
}

fn is_middle(at: GridIndex) -> bool {
    at[0] == CUBES_XY / 2
}

fn is_diagonal(at: GridIndex) -> bool {
    at[0] == at[1]
}

/// Selects the diagonal moved along y, so that it ends in the middle of a side.
fn is_shifted_diagonal(at: GridIndex) -> bool {
    at[0] + 3 == at[1]
}

/// Returns the properties of the lines: pair, length, minimum and mean angle, indices of a node.
fn line_summaries(judged: &AngleAssessment) -> Vec<(AcutePair, f64, f64, f64, GridIndex)> {
    let lines = judged.angles.acute_lines.iter();
    let mut summaries: Vec<_> = lines
        .map(|l| {
            (
                l.pair,
                l.length,
                l.min_angle,
                l.mean_angle,
                grid_index(l.nodes[0]),
            )
        })
        .collect();
    summaries.sort_by_key(|line| line.4);
    summaries
}

/// Asserts that the class of every cell follows from the lines by the documented rule, one cell and
/// line at a time, and that there are cells of each class.
fn assert_judged_by_the_rule<const D: usize, M: Simplices<D>>(mesh: &M, judged: &AngleAssessment) {
    let mut counts = [0; 3];
    for c in 0..mesh.len() {
        let cosines = mesh.shape(c).cosines;
        let [max_cosine, min_cosine] = [max_value(cosines.as_ref()), min_value(cosines.as_ref())];
        let worst_angle = max_cosine.acos().to_degrees();
        let worst_angle = worst_angle.min(180.0 - min_cosine.acos().to_degrees());
        let is_constrained = |&n: &u32| {
            let x = mesh.nodes()[n as usize];
            let on_side = (0..D).any(|k| x[k] == 0.0 || x[k] == extent(mesh)[k]);
            on_side || is_middle(grid_index(n)) || is_diagonal(grid_index(n))
        };
        let is_explained = judged.angles.acute_lines.iter().any(|line| {
            // Lines run along z from one end of the box to the other.
            let distance_from_line = |n: u32| {
                let [x, y] = [n, line.nodes[0]].map(|n| mesh.nodes()[n as usize]);
                (x[0] - y[0]).hypot(x[1] - y[1])
            };
            let cell = mesh.cell(c);
            let touches = cell.iter().any(|n| line.nodes.contains(n));
            let in_wedge = cell.iter().all(is_constrained)
                && cell.iter().any(|&n| distance_from_line(n) <= 2.0 + 1e-9);
            (touches || in_wedge) && worst_angle >= 0.7 * line.mean_angle
        });
        let verdict = match (worst_angle >= 30.0, is_explained) {
            (true, _) => OK,
            (false, true) => NEAR_ACUTE_LINE,
            (false, false) => UNEXPLAINED,
        };
        assert_eq!(judged.cell_classes[c], verdict, "{c}: {worst_angle}");
        counts[usize::from(verdict)] += 1;
    }
    let Angles {
        ok,
        near_acute_line,
        unexplained,
        ..
    } = judged.angles;
    assert_eq!([ok, near_acute_line, unexplained], counts);
    assert!(near_acute_line > 0 && unexplained > 0, "{counts:?}");
}

fn assert_close(
    actual: &[(AcutePair, f64, f64, f64, GridIndex)],
    expected: &[(AcutePair, f64, f64, GridIndex)],
) {
    assert_eq!(actual.len(), expected.len(), "{actual:?}");
    for (line, &(pair, length, angle, index)) in actual.iter().zip(expected) {
        assert_eq!((line.0, line.4), (pair, index));
        for (value, expected) in [(line.1, length), (line.2, angle), (line.3, angle)] {
            assert!((value - expected).abs() < 1e-9, "{actual:?}");
        }
    }
}

#[test]
fn planes_that_cross_at_20_degrees_make_a_line_of_20_degrees() {
    let mesh = tetrahedra_of_cubes(20.0);
    let judged = judge(&mesh, &[is_middle, is_diagonal]);
    let depth = CUBES_Z as f64;
    // The diagonal ends in two edges of the box, at 20 degrees to one of the sides there.
    let expected = [
        (AcutePair::Side(0), depth, 20.0, [0, 0]),
        (
            AcutePair::Features,
            depth,
            20.0,
            [CUBES_XY / 2, CUBES_XY / 2],
        ),
        (AcutePair::Side(1), depth, 20.0, [CUBES_XY, CUBES_XY]),
    ];
    assert_close(&line_summaries(&judged), &expected);
    for line in &judged.angles.acute_lines {
        assert_eq!(
            (line.nodes.len(), line.angles.len()),
            (CUBES_Z + 1, CUBES_Z)
        );
    }
    assert_judged_by_the_rule(&mesh, &judged);
}

#[test]
fn curves_that_cross_at_20_degrees_make_a_corner_of_20_degrees() {
    let mesh = triangles_of_squares(20.0);
    let judged = judge(&mesh, &[is_middle, is_diagonal]);
    let expected = [
        (AcutePair::Side(0), 0.0, 20.0, [0, 0]),
        (AcutePair::Features, 0.0, 20.0, [CUBES_XY / 2, CUBES_XY / 2]),
        (AcutePair::Side(1), 0.0, 20.0, [CUBES_XY, CUBES_XY]),
    ];
    assert_close(&line_summaries(&judged), &expected);
    assert_judged_by_the_rule(&mesh, &judged);
}

#[test]
fn a_feature_at_25_degrees_to_a_side_makes_a_line() {
    let expected = |depth| {
        [
            (AcutePair::Side(0), depth, 25.0, [0, 3]),
            // At the other end it leaves through the side y, to which it is steep.
        ]
    };
    let judged = judge(&tetrahedra_of_cubes(25.0), &[is_shifted_diagonal]);
    assert_close(&line_summaries(&judged), &expected(CUBES_Z as f64));
    let judged = judge(&triangles_of_squares(25.0), &[is_shifted_diagonal]);
    assert_close(&line_summaries(&judged), &expected(0.0));
}

#[test]
fn features_perpendicular_to_sides_or_wide_apart_make_no_line() {
    assert!(line_summaries(&judge(&tetrahedra_of_cubes(20.0), &[is_middle])).is_empty());
    assert!(line_summaries(&judge(&triangles_of_squares(20.0), &[is_middle])).is_empty());
    let judged = judge(
        &tetrahedra_of_cubes(31.0),
        &[is_middle, is_diagonal, is_shifted_diagonal],
    );
    assert!(line_summaries(&judged).is_empty(), "{:?}", judged.angles);
    let judged = judge(
        &triangles_of_squares(31.0),
        &[is_middle, is_diagonal, is_shifted_diagonal],
    );
    assert!(line_summaries(&judged).is_empty(), "{:?}", judged.angles);
}

#[test]
fn a_bad_cell_away_from_every_line_is_unexplained() {
    let mut mesh = kuhn_box([CUBES_XY, CUBES_XY, CUBES_Z], 1.0);
    let sound = judge(&mesh, &[is_middle]);
    assert_eq!(sound.angles.ok, mesh.len());
    assert_eq!(sound.angles.worst_unexplained, None);
    // A node that moves towards a neighbour flattens the cells between the two.
    let node = mesh
        .nodes
        .iter()
        .position(|x| *x == [3.0, 4.0, 2.0])
        .unwrap();
    mesh.nodes[node][1] += 0.8;
    let judged = judge(&mesh, &[is_middle]);
    let quality = quality(&mesh);
    let angles = &judged.angles;
    assert_eq!(angles.near_acute_line, 0);
    assert!(angles.unexplained >= quality.below_30 && quality.below_30 > 0);
    assert_eq!(angles.ok + angles.unexplained, mesh.len());
    let worst = angles.worst_unexplained.as_ref().unwrap();
    assert_eq!(worst, &quality.worst[0]);
    assert_eq!(judged.cell_classes[worst.cell], UNEXPLAINED);

    let mut mesh = triangles_of_squares(45.0);
    assert_eq!(judge(&mesh, &[is_middle]).angles.ok, mesh.len());
    mesh.nodes[4 * (CUBES_XY + 1) + 3][1] += 0.8;
    let angles = judge(&mesh, &[is_middle]).angles;
    assert!(
        angles.unexplained > 0 && angles.near_acute_line == 0,
        "{angles:?}"
    );
}

#[test]
fn a_single_face_that_stands_off_a_feature_explains_nothing() {
    let mesh = tetrahedra_of_cubes(20.0);
    let mut bits = feature_bits(&mesh, &[is_middle]);
    let ends_on_it = |c: usize, k: usize| {
        let face = mesh.face(c, k).map(grid_index);
        face.into_iter().all(is_diagonal) && face.into_iter().filter(|&n| is_middle(n)).count() == 2
    };
    let faces = (0..mesh.len()).flat_map(|c| (0..4).map(move |k| (c, k)));
    let (cell, k) = faces.into_iter().find(|&(c, k)| ends_on_it(c, k)).unwrap();
    bits[cell] |= 1 << k;
    let judged = assess_angles(&mesh, &bits, extent(&mesh), |_| 1.0);
    assert!(line_summaries(&judged).is_empty(), "{:?}", judged.angles);
}

#[test]
fn lines_are_the_same_whatever_the_unit_of_length() {
    let lines = |unit: f64| {
        let mut mesh = tetrahedra_of_cubes(20.0);
        let bits = feature_bits(&mesh, &[is_middle, is_diagonal]);
        let scaled_extent = extent(&mesh).map(|x| unit * x);
        for x in mesh.nodes.iter_mut().flatten() {
            *x *= unit;
        }
        assess_angles(&mesh, &bits, scaled_extent, |_| unit)
            .angles
            .acute_lines
    };
    let reference = lines(1.0);
    assert!(!reference.is_empty());
    for unit in [1e-9, 1e-3, 37.0, 1e6] {
        let scaled = lines(unit);
        let nodes = |lines: &[AcuteLine]| -> Vec<Vec<u32>> {
            lines.iter().map(|line| line.nodes.clone()).collect()
        };
        assert_eq!(nodes(&scaled), nodes(&reference), "{unit}");
    }
}

#[test]
fn a_line_goes_on_where_single_edges_are_wider_and_may_not_be_too_short() {
    let mut mesh = kuhn_box([CUBES_XY, CUBES_XY, CUBES_Z], 1.0);
    for x in &mut mesh.nodes {
        // The angle grows from 25 to 33 degrees.
        let narrowing = (25.0 + 2.0 * x[2]).to_radians().tan();
        x[0] = 100.0 + (x[0] - CUBES_XY as f64 / 2.0) * narrowing;
    }
    let bits = feature_bits(&mesh, &[is_middle, is_diagonal]);
    let lines = |d: f64| {
        assess_angles(&mesh, &bits, [1e3; 3], |_| d)
            .angles
            .acute_lines
    };
    let [line] = &lines(1.0)[..] else {
        panic!("{:?}", lines(1.0));
    };
    assert_eq!(
        (line.pair, line.nodes.len()),
        (AcutePair::Features, CUBES_Z + 1)
    );
    assert!(line.min_angle < 28.0 && line.mean_angle < 30.0, "{line:?}");
    assert!(line.angles.iter().any(|angle| *angle > 30.0), "{line:?}");
    // The line is 4 long.
    assert_eq!(lines(1.9).len(), 1);
    assert!(lines(2.1).is_empty());
}

#[test]
fn the_angle_of_a_line_is_that_of_its_neighbourhood() {
    // Edges of length 1, one of which has a very different angle.
    let nodes: Vec<[f64; 3]> = (0..11).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    let mut angles = vec![20.0; 10];
    angles[5] = 5.0;
    let line = AcuteLine {
        pair: AcutePair::Features,
        length: 10.0,
        min_angle: 5.0,
        mean_angle: 18.5,
        nodes: (0..11).collect(),
        angles,
    };
    let edges = line.edges(&nodes, &|_| 1.0);
    let angles: Vec<f64> = edges.iter().map(|piece| piece.angle).collect();
    let expected = [20.0, 20.0, 20.0, 17.0, 17.0, 17.0, 17.0, 17.0, 20.0, 20.0];
    for (i, (angle, expected)) in angles.iter().zip(expected).enumerate() {
        assert!((angle - expected).abs() < 1e-9, "{i}: {angles:?}");
    }
    assert_eq!(edges[9].nodes, [9, 10]);
}

#[test]
fn mean_edge_lengths_replace_unknown_distances() {
    let mesh = triangles_of_squares(45.0);
    let edges = mean_edge_lengths(&mesh);
    // In its six cells, an inner node has four edges of length 1 and two of the square root of 2,
    // twice each.
    let inside = edges[4 * (CUBES_XY + 1) + 3];
    assert!((inside - (4.0 + 2.0 * 2f64.sqrt()) / 6.0).abs() < 1e-12);
}
