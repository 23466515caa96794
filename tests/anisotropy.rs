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
    // The metric of the permeability is the same, and needs no mesh to find.
    run(folder, &format!("{mesh} rock.vtu --metric k:{k}"));
    let (note, rate) = flow(folder, "rock.vtu", k);
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

#[test]
fn a_constant_image_is_a_box_of_well_shaped_cells() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("flat.npy"), DIMS, |_| 2.0);
    let words = ["mesh", "flat.npy", "--distance", "6", "-o", "a.vtu"];
    let error = crate::common::expect_refusal(folder, &words);
    assert!(error.contains("--feature none"), "{error}");
    for cells in ["tets", "voronoi"] {
        let line = format!(
            "mesh flat.npy --feature none --distance 6 --cells {cells} --spacing 10,10,4 --unit m \
             --metric k:100,100,10 -o box.vtu --json --quiet"
        );
        let words: Vec<&str> = line.split_whitespace().collect();
        let output = atomesh(folder).args(words).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{stderr}");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let verdict = report["verdict"].to_string();
        assert!(!verdict.contains("invalid"), "{verdict}");
        run(folder, "validate box.vtu");
        // A box of uniform rock has the exact flow along each axis.
        if cells == "voronoi" {
            let (note, rate) = flow(folder, "box.vtu", "1e-13,1e-13,1e-14");
            let exact = 1e-14 / 1e-3 * 1e5 * 310.0 * 230.0 / 92.0;
            assert_eq!(note, None);
            assert!((rate / exact - 1.0).abs() < 1e-3, "{}", rate / exact);
        }
    }
}
