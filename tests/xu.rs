//! Tests Canny points, image-based smoothing and random shortest paths, from the image to the mesh.

use crate::common::{expect_refusal, run_args};
use atomesh::feature::FeatureKind;
use atomesh::image::{Geometry, Image};
use atomesh::job::spec::{MeshSpec, NominalDistance, SeedingKind, Slivers};
use atomesh::job::{self, MeshImage, Outcome, Params};
use atomesh::lattice::AtomKind;
use atomesh::lattice::optimise::NoProgress;
use atomesh::mesh::{Simplices, Space};
use atomesh::published::relax::Scheme;
use serde_json::Value;

/// Returns an image of a ball (a disc in the plane) of 100 on a background that rises along x.
fn ball<const D: usize>(dims: [usize; D], radius: f64) -> Image<D> {
    let value = |i: usize| {
        let (mut remaining_index, mut squares) = (i, 0.0);
        for n in dims {
            squares += ((remaining_index % n) as f64 - 0.5 * (n - 1) as f64 - 0.3).powi(2);
            remaining_index /= n;
        }
        let inside = (0.5 - (squares.sqrt() - radius)).clamp(0.0, 1.0);
        (100.0 * inside + 10.0 * (i % dims[0]) as f64 / dims[0] as f64) as f32
    };
    let samples = (0..dims.iter().product()).map(value).collect();
    Image::new(dims, samples, Geometry::default())
}

fn mesh_canny_points<const D: usize>(
    image: &Image<D>,
    smooth: Option<Scheme>,
    min_dihedral: Option<f64>,
) -> Outcome<D>
where
    Space<D>: MeshImage<D>,
{
    let (slivers, min_dihedral) = match min_dihedral {
        Some(angle) => (Slivers::Joe, Some(angle)),
        None => (Slivers::None, None),
    };
    let params = Params::new(MeshSpec {
        seeding: SeedingKind::Canny,
        smooth,
        slivers,
        min_dihedral,
        ..MeshSpec::default()
    })
    .unwrap();
    job::run(image, &params, &mut NoProgress).unwrap()
}

/// Returns the positions of the fixed nodes, sorted.
fn fixed_nodes<const D: usize, M: Simplices<D>>(outcome: &Outcome<D, M>) -> Vec<[f64; D]> {
    let simplices = outcome.simplices().unwrap();
    let nodes = simplices.mesh.nodes().iter().zip(&simplices.node_kinds);
    let mut fixed_nodes: Vec<[f64; D]> = nodes
        .filter(|(_, kind)| **kind == AtomKind::Fixed)
        .map(|(x, _)| *x)
        .collect();
    fixed_nodes.sort_by(|a, b| a.partial_cmp(b).unwrap());
    fixed_nodes
}

#[test]
fn smoothing_improves_triangles_and_keeps_canny_points_in_place() {
    let image = ball([120, 100], 33.0);
    let plain = mesh_canny_points(&image, None, None);
    let points = fixed_nodes(&plain);
    assert!(points.len() > 20);
    let mean = |o: &Outcome<2>| o.report.quality.as_ref().unwrap().mean_ratio_mean;
    let problems = |o: &Outcome<2>| o.report.box_check.as_ref().unwrap().problems.clone();
    assert!(problems(&plain).is_empty());
    for scheme in [Scheme::Cvt, Scheme::Odt] {
        let smooth = mesh_canny_points(&image, Some(scheme), None);
        assert!(problems(&smooth).is_empty(), "{:?}", problems(&smooth));
        assert_eq!(fixed_nodes(&smooth), points);
        assert!(
            mean(&smooth) > mean(&plain) + 0.01,
            "{scheme:?} {} {}",
            mean(&plain),
            mean(&smooth)
        );
        // Flips and max-min smoothing afterwards raise the smallest angle without moving the
        // points.
        let improved = mesh_canny_points(&image, Some(scheme), Some(25.0));
        assert!(problems(&improved).is_empty());
        assert_eq!(fixed_nodes(&improved), points);
        let worst = |o: &Outcome<2>| o.report.quality.as_ref().unwrap().smallest_angle.worst;
        // Measured: 26.2 and 28.0 degrees, from 15.0 and 14.3.
        assert!(worst(&smooth) < 16.0, "{}", worst(&smooth));
        assert!(worst(&improved) > 24.5, "{}", worst(&improved));
        let fidelity = &improved.report.fidelity.as_ref().unwrap().on_feature;
        // Measured: 0.971 and 1.
        assert!(fidelity.coverage_one > 0.96, "{fidelity:?}");
    }
}

/// Returns an image of a disc, a square or an oblique bar of 100 on 0, with noise of 5.
fn noisy_shape(shape: usize, seed: u64) -> Image<2> {
    let mut state = seed;
    let mut uniform = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let value = |i: usize| {
        let [x, y] = [(i % 128) as f64 - 63.3, (i / 128) as f64 - 63.8];
        let (u, v) = (0.921 * x + 0.389 * y, 0.921 * y - 0.389 * x);
        let signed_distance = match shape {
            0 => x.hypot(y) - 40.0,
            1 => x.abs().max(y.abs()) - 36.0,
            _ => (u.abs() - 45.0).max(v.abs() - 9.0),
        };
        let noise = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        (100.0 / (1.0 + (2.0 * signed_distance).exp()) + 5.0 * noise) as f32
    };
    let samples = (0..128 * 128).map(value).collect();
    Image::new([128, 128], samples, Geometry::default())
}

#[test]
fn smoothing_in_noise_keeps_the_edges_on_features() {
    let coverage = |image: &Image<2>, smooth| {
        let outcome = mesh_canny_points(image, smooth, Some(30.0));
        let fidelity = outcome.report.fidelity.unwrap();
        // Measure the edges that are tagged as features. At a corner, an edge may end some tenths
        // of a sample off the feature to reach the target angle.
        fidelity.tagged_faces.unwrap().coverage_one
    };
    for (shape, seed) in [(0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (2, 1), (2, 2)] {
        let image = noisy_shape(shape, seed);
        let plain = coverage(&image, None);
        for scheme in [Scheme::Cvt, Scheme::Odt] {
            let smooth = coverage(&image, Some(scheme));
            assert!(
                smooth >= plain - 0.01,
                "{shape} {seed} {scheme:?} {plain} {smooth}"
            );
        }
    }
}

#[test]
fn canny_points_in_space_give_a_valid_mesh() {
    let image = ball([48, 44, 40], 13.0);
    for min_dihedral in [None, Some(15.0)] {
        let outcome = mesh_canny_points(&image, None, min_dihedral);
        let box_check = outcome.report.box_check.as_ref().unwrap();
        assert!(box_check.problems.is_empty(), "{:?}", box_check.problems);
        for x in fixed_nodes(&outcome) {
            let squares: f64 = (0..3)
                .map(|k| (x[k] - 0.5 * [47.0, 43.0, 39.0][k] - 0.3).powi(2))
                .sum();
            assert!((squares.sqrt() - 13.0).abs() < 0.5, "{x:?}");
        }
        assert!(fixed_nodes(&outcome).len() > 40);
    }
}

#[test]
fn edges_follow_the_boundary_that_paths_find() {
    let image = ball([100, 90], 27.0);
    let mut params = Params::new(MeshSpec {
        distance: NominalDistance::Constant(6.0),
        feature: FeatureKind::Paths,
        ..MeshSpec::default()
    })
    .unwrap();
    params.path_seeds.object = vec![[50.0, 45.0]];
    let outcome = job::run(&image, &params, &mut NoProgress).unwrap();
    let simplices = outcome.simplices().unwrap();
    let length: f64 = simplices
        .feature_faces
        .iter()
        .enumerate()
        .flat_map(|(t, bits)| {
            (0..3)
                .filter(move |k| bits >> k & 1 == 1)
                .map(move |k| (t, k))
        })
        .map(|(t, k)| {
            let [a, b] = simplices
                .mesh
                .face(t, k)
                .map(|n| simplices.mesh.nodes[n as usize]);
            0.5 * (a[0] - b[0]).hypot(a[1] - b[1])
        })
        .sum();
    let circumference = 27.0 * std::f64::consts::TAU;
    assert!(
        (length / circumference - 1.0).abs() < 0.05,
        "{length} of {circumference}"
    );
}

fn json(folder: &std::path::Path, arguments: &str) -> Value {
    let arguments: Vec<&str> = arguments.split(' ').chain(["--json", "--quiet"]).collect();
    serde_json::from_str(&run_args(folder, &arguments)).unwrap()
}

#[test]
fn the_command_line_has_canny_points_smoothing_and_paths() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    json(
        dir,
        "synth sphere -o disc.png --dims 96,80 --signal-to-noise 20",
    );
    let report = json(
        dir,
        "mesh disc.png -o a.vtu --seeding canny --smooth odt --min-dihedral 25",
    );
    assert!(report["box"]["problems"].as_array().unwrap().is_empty());
    assert!(report["notes"].to_string().contains("steepest places"));
    assert_eq!(json(dir, "validate a.vtu")["valid"], true);
    json(dir, "mesh disc.png -o b.vtu --feature canny --smooth cvt");
    assert_eq!(json(dir, "validate b.vtu")["valid"], true);

    json(
        dir,
        "feature disc.png -o b.vti --feature paths --object 48,40 --confidence-out c.png",
    );
    let range = &json(dir, "info c.png")["image"];
    assert_eq!(range["numpy_shape"], serde_json::json!([80, 96]));
    // The file is the same for any number of threads, and differs for another seed.
    let potential = |options: &str| {
        json(
            dir,
            &format!(
                "feature disc.png -o p.npy --feature paths --object 48,40 --confidence-out c.npy{options}"
            ),
        );
        std::fs::read(dir.join("c.npy")).unwrap()
    };
    let reference = potential(" --threads 1");
    assert!(reference == potential(" --threads 3"));
    assert!(reference != potential(" --rng-seed 2"));
}

#[test]
fn impossible_canny_smoothing_and_path_jobs_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    run_args(
        dir,
        &["synth", "sphere", "-o", "disc.png", "--dims", "64,48"],
    );
    run_args(
        dir,
        &["synth", "sphere", "-o", "ball.npy", "--dims", "32,32,32"],
    );
    let cases: &[(&str, &[&str])] = &[
        (
            "mesh disc.png --seeding canny --distance 5",
            &["--distance"],
        ),
        ("mesh disc.png --seeding canny --cells voronoi", &["canny"]),
        ("mesh ball.npy --smooth cvt", &["--smooth", "2-D"]),
        ("mesh disc.png --smooth cvt --cells voronoi", &["--smooth"]),
        ("mesh disc.png --feature paths", &["--object"]),
        ("mesh disc.png --feature paths --object 3", &["--object 3"]),
        ("mesh disc.png --feature paths --object 99,3", &["outside"]),
        ("mesh ball.npy --feature paths --object 1,2,3", &["2-D"]),
        (
            "feature disc.png -o b.vti --feature canny --confidence-out c.png",
            &["--confidence-out"],
        ),
    ];
    for (arguments, expected) in cases {
        let line = expect_refusal(dir, &arguments.split(' ').collect::<Vec<_>>());
        for word in *expected {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    }
}
