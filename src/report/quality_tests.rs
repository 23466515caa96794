use super::*;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::{TetMesh, TriMesh};

fn quantiles_of(values: impl Iterator<Item = f32> + Clone + Sync, bad: BadEnd) -> Quantiles {
    let empty_mesh = TetMesh::default();
    let view = MeshView::from_mesh(&empty_mesh);
    let [quantiles] = super::quantiles(&view, [values], [bad]).unwrap();
    quantiles
}

#[test]
fn the_regular_tetrahedron() {
    let nodes = vec![
        [1.0, 1.0, 1.0],
        [-1.0, 1.0, -1.0],
        [1.0, -1.0, -1.0],
        [-1.0, -1.0, 1.0],
    ];
    let result = quality(&TetMesh {
        nodes,
        tets: vec![[0, 1, 2, 3]],
    });
    let regular = (1f64 / 3.0).acos().to_degrees();
    assert!((regular - 70.53).abs() < 0.01);
    assert!((result.smallest_angle.worst - regular).abs() < 1e-5);
    assert!((result.largest_angle.median - regular).abs() < 1e-5);
    assert_eq!(result.histogram.iter().sum::<u64>(), 6);
    assert_eq!(result.histogram[7], 6);
    assert!((result.mean_ratio.worst - 1.0).abs() < 1e-6);
    assert!((result.radius_edge.worst - 0.6124).abs() < 1e-4);
    assert!((result.volume - 8.0 / 3.0).abs() < 1e-12);
}

#[test]
fn the_equilateral_triangle_and_half_a_square() {
    let nodes = vec![[0.0, 0.0], [2.0, 0.0], [1.0, 3f64.sqrt()]];
    let mut mesh = TriMesh {
        nodes,
        triangles: vec![[0, 1, 2]],
    };
    let result = quality(&mesh);
    assert_eq!((result.cells, &*result.kind), (1, "triangles"));
    assert!((result.smallest_angle.worst - 60.0).abs() < 1e-5);
    assert_eq!(result.histogram[5] + result.histogram[6], 3);
    assert!((result.mean_ratio_mean - 1.0).abs() < 1e-12);
    assert!((result.volume - 3f64.sqrt()).abs() < 1e-12);
    mesh.nodes[2] = [0.0, 2.0];
    let result = quality(&mesh);
    assert!((result.smallest_angle.worst - 45.0).abs() < 1e-5);
    assert!((result.mean_ratio.worst - 0.75f64.sqrt()).abs() < 1e-6);
    assert_eq!(result.worst[0].centroid, [2.0 / 3.0; 2]);
    // The angles are 10, 10 and 160 degrees.
    mesh.nodes[2] = [1.0, 10f64.to_radians().tan()];
    let result = quality(&mesh);
    assert_eq!(
        (result.below_20, result.above_120, result.above_150),
        (1, 1, 1)
    );
}

#[test]
fn a_box_of_cut_cubes() {
    let mesh = kuhn_box([5, 4, 3], 2.0);
    let result = quality(&mesh);
    assert_eq!((result.nodes, result.cells), (6 * 5 * 4, 6 * 60));
    // Kuhn's tetrahedron has the angles 45 (twice), 60 and 90 (three times).
    assert!((result.smallest_angle.worst - 45.0).abs() < 1e-5);
    assert!((result.largest_angle.worst - 90.0).abs() < 1e-5);
    assert_eq!(
        result.histogram[4] + result.histogram[6] + result.histogram[5],
        360 * 3
    );
    assert_eq!(result.histogram[8] + result.histogram[9], 360 * 3);
    assert!((result.volume - 480.0).abs() < 1e-9);
    assert!((result.smallest_volume - 8.0 / 6.0).abs() < 1e-12);
    let counts = (
        result.below_20,
        result.below_30,
        result.above_150,
        result.above_160,
    );
    assert_eq!(counts, (0, 0, 0, 0));
    assert_eq!(result.worst.len(), 10);
}

#[test]
fn flat_tetrahedra_are_counted_listed_and_do_not_break_the_figures() {
    let mut mesh = kuhn_box([4, 4, 4], 1.0);
    let t = 100;
    let [a, b, c, _] = mesh.corners(t);
    // The node is nearly in the middle of the opposite face: angles near 0 and 180.
    let middle: [f64; 3] = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0 + 1e-3);
    mesh.nodes.push(middle);
    mesh.tets[t][3] = mesh.nodes.len() as u32 - 1;
    // A tetrahedron without volume and area.
    mesh.tets.push([0, 0, 1, 1]);
    let result = quality(&mesh);
    assert_eq!(result.worst.len(), 10);
    let listed: Vec<usize> = result.worst.iter().map(|w| w.cell).collect();
    assert!(listed[..2].contains(&t) && listed[..2].contains(&(mesh.tets.len() - 1)));
    assert_eq!((result.below_20, result.above_160), (2, 1));
    assert_eq!(result.smallest_angle.worst, 0.0);
    assert_eq!(result.mean_ratio.worst, 0.0);
    assert_eq!(
        result.histogram.iter().sum::<u64>(),
        6 * mesh.tets.len() as u64
    );

    let empty = quality(&TetMesh::default());
    assert!(empty.smallest_angle.worst.is_nan() && empty.mean_ratio_mean.is_nan());
}

#[test]
fn bins_are_those_of_the_angles() {
    let bins = AngleBins::new();
    for i in 1..18_000 {
        let angle = f64::from(i) / 100.0 - 0.005;
        assert_eq!(
            bins.bin_index(angle.to_radians().cos()),
            (angle / 10.0) as usize
        );
    }
    assert_eq!((bins.bin_index(1.0), bins.bin_index(-1.0)), (0, BINS - 1));
}

#[test]
fn points_are_the_ranks_of_the_sorted_values() {
    let values: Vec<f32> = (0..1001).map(|i| ((i * 617) % 1001) as f32).collect();
    let low = quantiles_of(values.iter().copied(), BadEnd::Small);
    assert_eq!(
        (low.worst, low.permille, low.percent, low.median),
        (0.0, 1.0, 10.0, 500.0)
    );
    let high = quantiles_of(values.iter().copied(), BadEnd::Large);
    let high_values = (high.worst, high.permille, high.percent, high.median);
    assert_eq!(high_values, (1000.0, 999.0, 990.0, 500.0));
}
