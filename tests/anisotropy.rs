//! Tests flow in anisotropic rock: the note about cells of an unsuitable shape, and the metric that
//! this note proposes.

use std::path::Path;

use crate::common::{atomesh, run, write_npy};

const DIMS: [usize; 3] = [32, 24, 24];

/// Returns the note about flow along the axes, if there is one, and the rate through the first
/// side.
fn flow(folder: &Path, mesh: &str, k: &str) -> (Option<String>, f64) {
    let line = format!(
        "flow {mesh} --pressure zmin=1e5 --pressure zmax=0 --permeability {k} --faults open -o o.vtu --json"
    );
    let words: Vec<&str> = line.split_whitespace().collect();
    let output = atomesh(folder).args(words).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let note = stderr
        .lines()
        .find(|line| line.contains("the right one along"));
    let rate = report["exchange"][0]["rate"].as_f64().unwrap();
    (note.map(str::to_string), rate.abs())
}

#[test]
fn the_metric_that_the_note_proposes_corrects_the_flow() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("sheet.npy"), DIMS, |[x, ..]| {
        (-((x as f32 - 16.3) / 1.2).powi(2)).exp()
    });
    let mesh = "mesh sheet.npy --feature ridges --cells voronoi --distance 5 --quiet -o";
    run(folder, &format!("{mesh} cells.vtu"));
    let exact = 1e-14 / 1e-3 * 1e5 * 31.0 * 23.0 / 23.0;
    let k = "1e-13,1e-13,1e-14";
    let (note, rate) = flow(folder, "cells.vtu", k);
    let note = note.unwrap();
    let ratio = rate / exact;
    assert!(ratio > 2.0, "{ratio}");
    // The note predicts the ratio along the vertical that the flow has.
    assert!(
        note.contains(&format!("{ratio:.2} times the right one along z")),
        "{note} {ratio}"
    );
    let metric = note.split("--metric ").nth(1).unwrap().trim();
    run(folder, &format!("{mesh} shaped.vtu --metric {metric}"));
    let (note, rate) = flow(folder, "shaped.vtu", k);
    assert_eq!(note, None);
    assert!((rate / exact - 1.0).abs() < 0.01, "{}", rate / exact);
    // The cells of the first mesh suit isotropic rock, so there is no note.
    assert_eq!(flow(folder, "cells.vtu", "1e-13").0, None);

    let export = "export cells.vtu --to mrst -o a.mat --down z --permeability 100,100,10 --permeability-unit mD";
    let words: Vec<&str> = export.split_whitespace().collect();
    let output = atomesh(folder).args(words).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        stderr.contains(&format!("mesh with --metric {metric}")),
        "{stderr}"
    );
    let stdout = run(
        folder,
        "export shaped.vtu --to mrst -o a.mat --down z --permeability 100,100,10 --permeability-unit mD",
    );
    assert!(!stdout.contains("--metric"), "{stdout}");
}
