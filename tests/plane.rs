//! Tests 2-D images with every verb on the command line.

use atomesh::job::spec::{MeshSpec, NominalDistance};
use std::path::Path;

use crate::common::{expect_refusal, run_args, write_npy_2d};
use serde_json::Value;

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let arguments = [arguments, &["--json", "--quiet"]].concat();
    serde_json::from_str(&run_args(folder, &arguments)).unwrap()
}

/// Returns a folder with a synthetic time slice of faults, `slice.png`, and its true faults,
/// `truth.npy`.
fn folder(dims: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "synth faults -o slice.png --truth truth.npy --signal-to-noise 10 --dims";
    let mut arguments: Vec<&str> = arguments.split(' ').collect();
    arguments.push(dims);
    run_args(folder.path(), &arguments);
    folder
}

#[test]
fn a_time_slice_suits_every_verb() {
    let folder = folder("256,256");
    let dir = folder.path();
    let info = json(dir, &["info", "slice.png"]);
    assert_eq!(info["image"]["numpy_shape"], serde_json::json!([256, 256]));

    let report = json(dir, &["mesh", "slice.png", "-o", "mesh.vtu"]);
    assert_eq!(report["quality"]["kind"], "triangles");
    assert!(
        report["quality"]["smallest_angle"]["worst"]
            .as_f64()
            .unwrap()
            > 28.0
    );
    assert!(report["quality"]["mean_ratio_mean"].as_f64().unwrap() > 0.95);
    assert!(report["box"]["problems"].as_array().unwrap().is_empty());
    assert!(report["box"]["volume_error"].as_f64().unwrap() < 1e-9);

    let quality = json(dir, &["quality", "mesh.vtu", "--truth", "truth.npy"]);
    let tagged = &quality["fidelity"]["tagged_faces"];
    assert!(tagged["coverage_one"].as_f64().unwrap() > 0.95, "{tagged}");
    assert!(tagged["precision"].as_f64().unwrap() > 0.95, "{tagged}");
    assert_eq!(quality["quality"]["cells"], report["quality"]["cells"]);

    assert_eq!(json(dir, &["validate", "mesh.vtu"])["valid"], true);
    assert_eq!(
        json(dir, &["info", "mesh.vtu"])["triangles"],
        report["quality"]["cells"]
    );

    json(
        dir,
        &["slice", "slice.png", "mesh.vtu", "-o", "picture.png"],
    );
    let picture = json(dir, &["info", "picture.png"]);
    assert!(picture["image"]["axes"][0]["count"].as_u64().unwrap() > 1000);

    json(dir, &["feature", "slice.png", "-o", "potential.npy"]);
    json(
        dir,
        &[
            "mesh",
            "potential.npy",
            "--feature",
            "potential",
            "-o",
            "again.vtu",
        ],
    );
}

#[test]
fn meshes_are_the_same_for_every_format_and_number_of_threads() {
    let folder = folder("96,80");
    let dir = folder.path();
    for to in ["slice.npy", "slice.vti"] {
        run_args(dir, &["convert", "slice.png", to]);
    }
    let mesh = |image: &str, more: &[&str]| {
        let arguments = [&["mesh", image, "-o", "mesh.vtu", "--quiet"], more].concat();
        run_args(dir, &arguments);
        std::fs::read(dir.join("mesh.vtu")).unwrap()
    };
    let reference = mesh("slice.npy", &["--threads", "1"]);
    assert!(reference == mesh("slice.npy", &["--threads", "3"]));
    let quality_of = |image: &str| {
        mesh(image, &[]);
        json(dir, &["quality", "mesh.vtu"])["quality"].clone()
    };
    assert_eq!(quality_of("slice.npy"), quality_of("slice.vti"));
    assert_eq!(quality_of("slice.npy"), quality_of("slice.png"));
}

#[test]
fn options_of_space_have_their_meaning_in_the_plane() {
    let folder = folder("128,96");
    let dir = folder.path();
    std::fs::write(dir.join("wells.csv"), "x,y\n30.5,40.25\n100,20\n").unwrap();
    let arguments = "mesh slice.png -o mesh.vtu --distance 4:10 --distance-from features \
                     --atoms-from wells.csv --metric 1,2 --trace trace.pvd --potential-out b.vti";
    let report = json(dir, &arguments.split_whitespace().collect::<Vec<_>>());
    assert!(report["box"]["problems"].as_array().unwrap().is_empty());
    assert!(report["quality_physical"]["cells"].is_u64());
    assert!(dir.join("trace.pvd").exists());
    assert_eq!(json(dir, &["validate", "mesh.vtu"])["valid"], true);
}

#[test]
fn impossible_jobs_in_the_plane_are_refused() {
    let folder = folder("64,48");
    let dir = folder.path();
    let png = std::fs::read(dir.join("slice.png")).unwrap();
    std::fs::write(dir.join("cut.png"), &png[..png.len() / 2]).unwrap();
    std::fs::write(dir.join("dot.raw"), [7]).unwrap();
    std::fs::write(dir.join("wells.csv"), "1,2,3\n").unwrap();
    run_args(dir, &["mesh", "slice.png", "-o", "mesh.vtu", "--quiet"]);
    run_args(
        dir,
        &["synth", "sphere", "-o", "ball.npy", "--dims", "16,16,16"],
    );
    let cases: &[(&str, &[&str])] = &[
        ("mesh cut.png", &["cut.png"]),
        ("info cut.png", &["cut.png"]),
        ("mesh dot.raw --raw 1x1:u8", &["dot.raw"]),
        ("mesh slice.png --metric 1,1,1", &["--metric", "2 axes"]),
        (
            "mesh slice.png --atoms-from wells.csv",
            &["wells.csv", "3 columns", "x,y"],
        ),
        ("mesh slice.png --distance 60", &["60"]),
        ("convert ball.npy ball.png", &["ball.png", "3-D"]),
        (
            "slice ball.npy mesh.vtu -o p.png",
            &["mesh.vtu", "2-D mesh"],
        ),
        ("slice slice.png mesh.vtu -o p.jpg", &["p.jpg", ".png"]),
        ("slice slice.png mesh.vtu -o p.png --at 1,2", &["--at", "3"]),
        (
            "quality mesh.vtu --truth ball.npy",
            &["ball.npy", "(ny, nx)"],
        ),
        ("synth faults -o a.npy --dims 64", &["--dims"]),
    ];
    for (arguments, expected) in cases {
        let line = expect_refusal(dir, &arguments.split(' ').collect::<Vec<_>>());
        for word in *expected {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    }
}

/// Returns the coverage within one sample and the energy of a mesh of a potential at distance 12,
/// after a number of passes on smoother potentials.
fn coverage_and_energy(width: f64, coarse_passes: usize) -> [f64; 2] {
    use atomesh::feature::FeatureKind;
    use atomesh::image::{Geometry, Image};
    use atomesh::job::{self, Params};
    use atomesh::lattice::optimise::NoProgress;

    let dims = [200, 180];
    let valley = |p: [f64; 2]| {
        let ring = (p[0] - 20.0).hypot(p[1] + 30.0) - 140.0;
        let line = 0.8 * (p[0] - 100.0) - 0.6 * (p[1] - 60.0);
        let s = ring.abs().min(line.abs());
        -(-0.5 * (s / width).powi(2)).exp()
    };
    let position = |i: usize| [(i % dims[0]) as f64, (i / dims[0]) as f64];
    let samples = (0..dims[0] * dims[1])
        .map(|i| valley(position(i)) as f32)
        .collect();
    let image = Image::new(dims, samples, Geometry::default());
    let params = Params::new(MeshSpec {
        distance: NominalDistance::Constant(12.0),
        feature: FeatureKind::Potential,
        coarse_to_fine: coarse_passes,
        ..MeshSpec::default()
    })
    .unwrap();
    let report = job::run(&image, &params, &mut NoProgress).unwrap().report;
    [
        report.fidelity.unwrap().on_feature.coverage_one,
        report.lattice.unwrap().optimisation.unwrap().energy,
    ]
}

#[test]
fn passes_on_smoother_potentials_lower_the_energy_and_keep_the_coverage() {
    // The valleys have a width of a twelfth of the distance, where most atoms start too far away to
    // be attracted by them, and of the usual quarter.
    for width in [1.0, 3.0] {
        let [fine, coarse_to_fine] = [0, 1].map(|passes| coverage_and_energy(width, passes));
        assert!(
            coarse_to_fine[0] > fine[0] - 0.01,
            "{width} {fine:?} {coarse_to_fine:?}"
        );
        // Energies are negative.
        assert!(
            coarse_to_fine[1] < 1.01 * fine[1],
            "{width} {fine:?} {coarse_to_fine:?}"
        );
    }
}

/// Returns the values of small images with sharp edges: squares, rings, a disc with a step, and
/// waves with a step.
fn sharp_image(kind: usize, seed: usize) -> impl Fn([usize; 2]) -> f32 {
    let (a, b) = (4 + seed % 5, 4 + seed / 5 % 7);
    move |[x, y]| {
        let [u, v] = [x as f32, y as f32];
        match kind {
            0 => ((x / a + y / b) % 2) as f32 * 10.0,
            1 => (((u - 24.0).hypot(v - 17.0) / a as f32) as usize % 2) as f32 * 5.0,
            2 => f32::from((u - 11.0).hypot(v - 14.0) < 9.0) + 0.7 * f32::from(x > 20 + a),
            _ => (u / a as f32 + v / b as f32).sin() + f32::from(v > 0.3 * b as f32 * u),
        }
    }
}

#[test]
fn canny_points_of_sharp_images_give_few_angles_outside_20_to_160_degrees() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let (mut cells, mut outside, mut unexplained) = (0, 0, 0);
    for (kind, seed) in (0..4).flat_map(|kind| (0..3).map(move |seed| (kind, seed))) {
        write_npy_2d(
            &dir.join("sharp.npy"),
            [40 + seed, 36],
            sharp_image(kind, 5 * seed),
        );
        let mesh = "mesh sharp.npy -o mesh.vtu --seeding canny --feature canny";
        let arguments: Vec<&str> = mesh.split(' ').collect();
        let quality = &json(dir, &arguments)["quality"];
        let count = |figure: &Value| figure.as_u64().unwrap();
        outside += count(&quality["below_20"]) + count(&quality["above_160"]);
        cells += count(&quality["cells"]);
        unexplained += count(&quality["angles"]["unexplained"]);
    }
    assert!(outside <= 2, "{outside} of {cells}");
    assert!(200 * unexplained <= cells, "{unexplained} of {cells}");
}
