//! Tests `atomesh mesh --effort` on the sample volume.

use std::path::Path;

use crate::common::{run, run_args};
use serde_json::Value;

const SAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/faults.vti");

/// Meshes the sample volume with these options, and returns the report.
fn mesh(folder: &Path, options: &[&str]) -> Value {
    let text = run_args(
        folder,
        &[&["mesh", SAMPLE, "--json", "--quiet"], options].concat(),
    );
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// Returns the smallest and the largest dihedral angle in a report.
fn worst_angles(report: &Value) -> [f64; 2] {
    ["smallest_angle", "largest_angle"].map(|key| report["quality"][key]["worst"].as_f64().unwrap())
}

#[test]
fn each_effort_gives_a_mesh_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let [draft, normal, best] = ["draft", "normal", "best"].map(|effort| {
        let output = format!("{effort}.vtu");
        mesh(folder.path(), &["--effort", effort, "-o", &output])
    });
    mesh(folder.path(), &["-o", "default.vtu"]);
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("normal.vtu") == bytes("default.vtu"));
    assert!(bytes("draft.vtu") != bytes("normal.vtu"));
    assert!(bytes("best.vtu") != bytes("normal.vtu"));

    // Crossing surfaces that are not told apart are no narrow gaps.
    let cells = |report: &Value| report["quality"]["cells"].as_u64().unwrap();
    assert!(cells(&draft) < cells(&normal));

    let [draft, normal, best] = [draft, normal, best].map(|report| worst_angles(&report));
    assert!(draft[0] >= 15.0 && draft[1] <= 165.0, "{draft:?}");
    assert!(normal[0] >= 30.0 && normal[1] <= 150.0, "{normal:?}");
    assert!(
        best[0] >= normal[0] + 2.0 && best[1] <= normal[1] - 2.0,
        "{best:?} {normal:?}"
    );
    for name in ["draft.vtu", "best.vtu"] {
        let verdict = run(folder.path(), &format!("validate {name} --json"));
        let verdict: Value = serde_json::from_str(&verdict).unwrap();
        assert_eq!(verdict["valid"], true, "{name}: {verdict}");
    }
}

#[test]
fn options_override_the_preset() {
    let folder = tempfile::tempdir().unwrap();
    let report = mesh(
        folder.path(),
        &["--effort", "draft", "--min-dihedral", "30", "-o", "a.vtu"],
    );
    let angles = worst_angles(&report);
    // A draft aims at this target, but tries less than a normal mesh.
    assert!(angles[0] > 25.0 && angles[1] < 155.0, "{angles:?}");

    // A printed configuration has the preset and its angle. The command line has priority over it.
    let config = run(folder.path(), "mesh --effort draft --print-config");
    assert!(config.contains("effort = \"draft\""), "{config}");
    assert!(config.contains("min-dihedral = 15.0"), "{config}");
    std::fs::write(folder.path().join("job.toml"), config).unwrap();
    let config = run(
        folder.path(),
        "mesh --config job.toml --effort normal --print-config",
    );
    assert!(config.contains("effort = \"normal\""), "{config}");
}
