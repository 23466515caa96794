//! Tests Voronoi cells on the command line: meshes, checks, quality, reading and refusals.

use std::path::Path;

use crate::common::{expect_refusal, run_args};

fn json(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    let stdout = run_args(folder, &[arguments, &["--json", "--quiet"]].concat());
    serde_json::from_str(&stdout).unwrap()
}

/// Writes a volume with faults and its cells in `v.vtu` with distance 6, and returns the report.
fn mesh_faults(folder: &Path) -> serde_json::Value {
    let dims = ["--dims", "64,56,48", "--quiet"];
    let synth = ["synth", "faults", "-o", "f.vti", "--truth", "t.npy"];
    run_args(folder, &[&synth[..], &dims].concat());
    let mesh = [
        "mesh",
        "f.vti",
        "-o",
        "v.vtu",
        "--distance",
        "6",
        "--report",
        "r.json",
    ];
    json(folder, &[&mesh[..], &["--cells", "voronoi"]].concat())
}

#[test]
fn cells_fill_the_box_and_follow_the_faults() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let report = mesh_faults(folder);
    let written: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("r.json")).unwrap()).unwrap();
    assert_eq!(report["voronoi"], written["voronoi"]);
    let voronoi = &report["voronoi"];
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    assert_eq!(voronoi["check"]["problems"].as_array().unwrap().len(), 0);
    assert!(number(&voronoi["check"]["volume_error"]) < 1e-12);
    assert_eq!(number(&voronoi["check"]["flatness_error"]), 0.0);
    assert_eq!(number(&voronoi["non_positive_connections"]), 0.0);
    assert!(number(&voronoi["angle"][0]) < 1e-6);
    let ratio = &voronoi["volume_ratio"][0];
    assert!(number(ratio) < 6.0, "neighbours' volumes {ratio}");

    let valid = json(folder, &["validate", "v.vtu"]);
    assert_eq!(valid["valid"], true, "{valid}");
    // A mesh that is read back is the same, apart from rounding in physical coordinates.
    let again = json(folder, &["quality", "v.vtu", "--truth", "t.npy"]);
    for key in ["connections", "on_feature"] {
        assert_eq!(again["voronoi"][key], voronoi[key]);
    }
    let line = expect_refusal(folder, &["quality", "v.vtu", "--lines", "l.vtp"]);
    assert!(
        line.contains("--lines l.vtp: v.vtu holds Voronoi cells"),
        "{line}"
    );
    let tagged = &again["fidelity"]["tagged_faces"];
    // Measured: 0.892.
    assert!(number(&tagged["coverage_one"]) > 0.88, "{tagged}");
    // Without the smallest faces the mesh has fewer connections and is still valid.
    let weld = [
        "mesh",
        "f.vti",
        "-o",
        "w.vtu",
        "--distance",
        "6",
        "--cells",
        "voronoi",
    ];
    let welded = json(folder, &[&weld[..], &["--weld", "0.02"]].concat());
    let tiny = |report: &serde_json::Value| number(&report["voronoi"]["tiny_faces"][1]);
    assert!(
        tiny(&welded) < 0.2 * tiny(&report),
        "{} {}",
        tiny(&welded),
        tiny(&report)
    );
    assert!(number(&welded["voronoi"]["connections"]) < number(&voronoi["connections"]));
    let valid = json(folder, &["validate", "w.vtu"]);
    assert_eq!(valid["valid"], true, "{valid}");

    let info = json(folder, &["info", "v.vtu"]);
    assert_eq!(info["polyhedra"], voronoi["check"]["cells"]);
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_computes_the_same_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    mesh_faults(folder);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/vtk/cells.py");
    let mesh = folder.join("v.vtu");
    let stdout = crate::common::run_python("VTK", &[script.as_os_str(), mesh.as_os_str()]);
    let worst: f64 = stdout.trim().parse().expect(&stdout);
    assert!(
        worst < 1e-10,
        "a cell's volume is off by {worst} of the mean"
    );
}

#[test]
fn polygons_in_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The image is a bright line on a dark background.
    crate::common::write_npy_2d(&folder.join("i.npy"), [96, 80], |[x, y]| {
        let distance = 0.6 * x as f32 - 0.8 * y as f32 + 3.0;
        (-0.5 * (distance / 1.5).powi(2)).exp()
    });
    let mesh = [
        "mesh",
        "i.npy",
        "-o",
        "v.vtu",
        "--distance",
        "5",
        "--align",
        "alongside",
    ];
    let report = json(folder, &mesh);
    let voronoi = &report["voronoi"];
    assert_eq!(voronoi["kind"], "polygons");
    assert!(voronoi["check"]["volume_error"].as_f64().unwrap() < 1e-12);
    let tagged = &report["fidelity"]["tagged_faces"];
    // Measured: 0.966.
    assert!(tagged["coverage_one"].as_f64().unwrap() > 0.95, "{tagged}");
    assert_eq!(json(folder, &["validate", "v.vtu"])["valid"], true);
    let info = json(folder, &["info", "v.vtu"]);
    assert_eq!(info["polygons"], voronoi["check"]["cells"]);
}

#[test]
fn cell_options_that_contradict_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    crate::common::write_npy(&folder.join("i.npy"), [20, 20, 20], |[x, ..]| {
        (x as f32).sin()
    });
    let mesh = ["mesh", "i.npy", "-o", "v.vtu"];
    for (options, expected) in [
        (
            &["--align", "on", "--cells", "voronoi"][..],
            "sides of the box",
        ),
        (
            &["--align", "alongside", "--cells", "tets"],
            "tetrahedra must reach",
        ),
        (
            &["--cells", "voronoi", "--potential", "sampled"],
            "mirror images",
        ),
        (&["--cells", "voronoi", "--weld", "0.5"], "from 0 to 0.2"),
        (
            &["--cells", "tets", "--weld", "0.01"],
            "applies to Voronoi cells",
        ),
    ] {
        let error = expect_refusal(folder, &[&mesh[..], options].concat());
        assert!(error.contains(expected), "{error}");
    }
}
