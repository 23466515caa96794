use super::*;
use crate::image::synth::truth::{MAX_DISTANCE, Truth};
use crate::image::synth::{Options, SyntheticKind, make};
use crate::mesh::TriMesh;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::tri::SIDES;

/// Returns the truth of a feature for which `closest` gives the distance and the direction to its
/// closest point.
fn truth_of(dims: [usize; 3], closest: impl Fn([f64; 3]) -> (f64, [f64; 3])) -> Truth {
    let mut truth = Truth {
        dims,
        distance: vec![],
        direction: vec![],
        is_smooth: true,
        next_feature: None,
    };
    for i in 0..dims[0] * dims[1] * dims[2] {
        let p = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])].map(|c| c as f64);
        let (d, n) = closest(p);
        truth.distance.push((d as f32).min(MAX_DISTANCE));
        truth
            .direction
            .push(n.map(|c| if d < 10.0 { c as f32 } else { 0.0 }));
    }
    truth
}

/// Returns the truth of the plane x = at.
fn plane(at: f64) -> Truth {
    truth_of([17, 17, 17], |p| {
        (
            (at - p[0]).abs(),
            [if at < p[0] { -1.0 } else { 1.0 }, 0.0, 0.0],
        )
    })
}

#[test]
fn a_plane_of_nodes_is_matched_entirely() {
    let mesh = kuhn_box([8, 8, 8], 2.0);
    let result = fidelity(&mesh, &Reference::from_truth(&plane(8.0)), None).unwrap();
    let on_feature = &result.on_feature;
    assert_eq!(result.feature_points, 17 * 17);
    assert_eq!(on_feature.faces, 2 * 8 * 8);
    assert!((on_feature.area - 256.0).abs() < 1e-9);
    assert_eq!(
        (on_feature.coverage_half, on_feature.coverage_one),
        (1.0, 1.0)
    );
    assert!((on_feature.precision - 1.0).abs() < 1e-12);
    assert!(on_feature.hausdorff < 1e-6 && on_feature.hausdorff_95 < 1e-6);
    assert!(result.tagged_faces.is_none());
}

#[test]
fn a_shifted_plane_is_covered_only_at_the_larger_tolerance() {
    let mesh = kuhn_box([8, 8, 8], 2.0);
    let truth = plane(8.7);
    let on_feature = fidelity(&mesh, &Reference::from_truth(&truth), None)
        .unwrap()
        .on_feature;
    assert_eq!(
        (on_feature.coverage_half, on_feature.coverage_one),
        (0.0, 1.0)
    );
    assert!((on_feature.precision - 1.0).abs() < 1e-12);
    assert!(
        (on_feature.hausdorff - 0.7).abs() < 1e-5 && (on_feature.hausdorff_95 - 0.7).abs() < 1e-5
    );
    // Beyond 0.75 no face is on the feature any more.
    let truth = plane(8.8);
    let on_feature = fidelity(&mesh, &Reference::from_truth(&truth), None)
        .unwrap()
        .on_feature;
    assert_eq!((on_feature.faces, on_feature.coverage_one), (0, 0.0));
    assert!(on_feature.precision.is_nan() && on_feature.hausdorff.is_infinite());
}

#[test]
fn missing_faces_lower_coverage_by_their_share() {
    let mut mesh = kuhn_box([8, 8, 8], 2.0);
    let nodes = mesh.nodes.clone();
    mesh.tets
        .retain(|tet| tet.iter().all(|&n| nodes[n as usize][2] <= 8.0));
    let on_feature = fidelity(&mesh, &Reference::from_truth(&plane(8.0)), None)
        .unwrap()
        .on_feature;
    // Of the rows z = 0 ..= 16, those up to 8 lie on faces and row 9 is one sample off.
    assert!((on_feature.coverage_half - 9.0 / 17.0).abs() < 1e-12);
    assert!((on_feature.coverage_one - 10.0 / 17.0).abs() < 1e-12);
    assert!((on_feature.hausdorff - 8.0).abs() < 1e-6);
    assert!((on_feature.precision - 1.0).abs() < 1e-12);
}

#[test]
fn tags_away_from_every_feature_lower_precision() {
    let mesh = kuhn_box([8, 8, 8], 2.0);
    let truth = plane(8.0);
    let reference = Reference::from_truth(&truth);
    let tagged = |is_tagged: &dyn Fn([f64; 3]) -> bool| {
        let flags: Vec<u8> = mesh
            .tets
            .iter()
            .map(|tet| {
                let is_on_feature = tet.map(|n| is_tagged(mesh.nodes[n as usize]));
                (0..4)
                    .filter(|&k| (0..4).all(|i| i == k || is_on_feature[i]))
                    .fold(0, |bits, k| bits | 1 << k)
            })
            .collect();
        fidelity(&mesh, &reference, Some(&flags))
            .unwrap()
            .tagged_faces
            .unwrap()
    };
    let both = tagged(&|p| p[0] == 8.0 || p[0] == 12.0);
    assert!((both.precision - 0.5).abs() < 1e-12 && both.coverage_half == 1.0);
    assert!((both.hausdorff - 4.0).abs() < 1e-6);
    let half = tagged(&|p| p[0] == 8.0 && p[1] <= 8.0);
    assert!((half.precision - 1.0).abs() < 1e-12);
    assert!((half.coverage_half - 9.0 / 17.0).abs() < 1e-12);
    let none = tagged(&|_| false);
    assert_eq!((none.faces, none.coverage_one), (0, 0.0));
    assert!(fidelity(&mesh, &reference, Some(&[1])).is_err());
}

fn for_each_random_point(count: usize, mut visit: impl FnMut(&mut dyn FnMut() -> f64)) {
    let mut state = 9u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    for _ in 0..count {
        visit(&mut next);
    }
}

#[test]
fn distance_between_samples_matches_a_sphere_and_crossing_planes() {
    let sphere = make(
        SyntheticKind::Sphere,
        &Options {
            dims: [101, 101, 101],
            signal_to_noise: f64::INFINITY,
            ..Options::default()
        },
    )
    .unwrap()
    .truth;
    let reference = Reference::from_truth(&sphere);
    let mut worst = 0f64;
    for_each_random_point(20_000, |next| {
        let v: [f64; 3] = std::array::from_fn(|_| next() - 0.5);
        let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let offset = 4.0 * next() - 2.0;
        let p = std::array::from_fn(|k| 50.0 + v[k] / length * (40.0 + offset));
        worst = worst.max((reference.distance(p, &mut None) - offset.abs()).abs());
    });
    assert!(worst < 2e-3, "sphere of radius 40: {worst}");

    let (sin, cos) = 30f64.to_radians().sin_cos();
    let planes = [[1.0, 0.0, 0.0], [cos, sin, 0.0]];
    let height = |p: [f64; 3], n: [f64; 3]| (p[0] - 8.3) * n[0] + (p[1] - 7.6) * n[1];
    let truth = truth_of([17, 17, 17], |p| {
        let [a, b] = planes.map(|n| height(p, n));
        let (h, n) = if a.abs() < b.abs() {
            (a, planes[0])
        } else {
            (b, planes[1])
        };
        (h.abs(), n.map(|c| if h > 0.0 { -c } else { c }))
    });
    let reference = Reference::from_truth(&truth);
    let mut worst = 0f64;
    for_each_random_point(20_000, |next| {
        let p: [f64; 3] = std::array::from_fn(|_| 16.0 * next());
        let exact = planes
            .map(|n| height(p, n).abs())
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        worst = worst.max((reference.distance(p, &mut None) - exact).abs());
    });
    assert!(worst < 1e-5, "planes crossing at 30 degrees: {worst}");
}

#[test]
fn distance_does_not_run_on_where_a_surface_ends() {
    // The half plane x = 8, y <= 8.
    let truth = truth_of([17, 17, 17], |p| {
        let q = [8.0, p[1].min(8.0), p[2]];
        let v: [f64; 3] = std::array::from_fn(|k| q[k] - p[k]);
        let d = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        (
            d,
            if d > 0.0 {
                v.map(|c| c / d)
            } else {
                [1.0, 0.0, 0.0]
            },
        )
    });
    let reference = Reference::from_truth(&truth);
    for y in [9.5, 10.25, 12.0] {
        assert!(
            (reference.distance([8.1, y, 8.0], &mut None) - (y - 8.0)).abs() < 0.3,
            "y = {y}"
        );
    }
    assert!(reference.distance([8.1, 6.0, 8.0], &mut None) < 0.11);
}

#[test]
fn detected_points_stand_in_for_truth() {
    use crate::feature::{DetectionOptions, FeaturePoint, Features};
    let points = (0..17 * 17)
        .map(|i| FeaturePoint {
            position: [8.0, (i % 17) as f32, (i / 17) as f32],
            normal: [1.0, 0.0, 0.0],
            strength: 1.0,
        })
        .collect();
    let features = Features {
        points,
        ..Features::empty([17; 3], &DetectionOptions::default())
    };
    let reference = Reference::from_features(&features);
    assert!((reference.distance([8.4, 3.5, 3.5], &mut None) - 0.4).abs() < 1e-9);
    assert_eq!(reference.distance([18.5, 3.0, 3.0], &mut None), 10.0);
    let result = fidelity(&kuhn_box([8, 8, 8], 2.0), &reference, None).unwrap();
    assert_eq!(result.reference, "detected");
    assert_eq!(result.on_feature.coverage_half, 1.0);
    assert!((result.on_feature.precision - 1.0).abs() < 1e-12);
}

#[test]
fn the_figures_do_not_depend_on_the_number_of_threads() {
    let options = Options {
        dims: [40, 36, 32],
        count: Some(3),
        ..Options::default()
    };
    let truth = make(SyntheticKind::Faults, &options).unwrap().truth;
    let reference = Reference::from_truth(&truth);
    let mesh = kuhn_box([39, 35, 31], 1.0);
    let parallel = fidelity(&mesh, &reference, None).unwrap();
    assert!(parallel.on_feature.faces > 1000);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(
        pool.install(|| fidelity(&mesh, &reference, None).unwrap()),
        parallel
    );
}

/// Returns a square of small squares, each cut into two triangles.
fn squares(count: usize, size: f64) -> TriMesh {
    let node = |x: usize, y: usize| (y * (count + 1) + x) as u32;
    let mut mesh = TriMesh::default();
    for y in 0..=count {
        for x in 0..=count {
            mesh.nodes.push([size * x as f64, size * y as f64]);
            if x < count && y < count {
                let [a, b, c, d] = [
                    node(x, y),
                    node(x + 1, y),
                    node(x, y + 1),
                    node(x + 1, y + 1),
                ];
                mesh.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
    }
    mesh
}

#[test]
fn in_the_plane_edges_take_the_place_of_faces() {
    let mesh = squares(8, 2.0);
    let line = |at: f32| Truth::<2> {
        dims: [17, 17],
        distance: (0..289).map(|i| (at - (i % 17) as f32).abs()).collect(),
        direction: (0..289)
            .map(|i| [if at < (i % 17) as f32 { -1.0 } else { 1.0 }, 0.0])
            .collect(),
        is_smooth: true,
        next_feature: None,
    };
    let result = fidelity(&mesh, &Reference::from_truth(&line(8.0)), None).unwrap();
    assert_eq!((result.feature_points, result.on_feature.faces), (17, 8));
    assert!((result.on_feature.area - 16.0).abs() < 1e-12);
    assert_eq!(result.on_feature.coverage_half, 1.0);
    assert!(result.on_feature.hausdorff < 1e-6);
    let shifted = fidelity(&mesh, &Reference::from_truth(&line(8.7)), None)
        .unwrap()
        .on_feature;
    assert_eq!((shifted.coverage_half, shifted.coverage_one), (0.0, 1.0));
    assert!((shifted.hausdorff - 0.7).abs() < 1e-5);
    // Edges on a line away from every feature are tagged, in addition to those on the feature.
    let is_at = |n: u32, at: f64| mesh.nodes[n as usize][0] == at;
    let bits = |t: &[u32; 3]| {
        (0..3u8)
            .filter(|&k| {
                let face = SIDES[usize::from(k)].map(|i| t[i]);
                face.iter().all(|&n| is_at(n, 8.0)) || face.iter().all(|&n| is_at(n, 12.0))
            })
            .fold(0u8, |bits, k| bits | 1 << k)
    };
    let flags: Vec<u8> = mesh.triangles.iter().map(bits).collect();
    let truth = line(8.0);
    let tagged = fidelity(&mesh, &Reference::from_truth(&truth), Some(&flags))
        .unwrap()
        .tagged_faces;
    let tagged = tagged.unwrap();
    assert_eq!(tagged.faces, 16);
    assert!((tagged.precision - 0.5).abs() < 1e-12 && (tagged.hausdorff - 4.0).abs() < 1e-6);
}
