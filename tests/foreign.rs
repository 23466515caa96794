//! Tests meshes of other programs: every verb accepts them.

use std::ffi::OsStr;
use std::path::Path;

use crate::common::{expect_refusal, folder_with_meshes, is_close, run, run_args, run_validator};
use serde_json::Value;

/// Runs a verb and returns its report.
fn run_json(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("{line} --json --quiet"))).unwrap()
}

#[test]
fn surfaces_keep_the_names_that_other_programs_gave_them() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for (format, file) in [("msh", "a.msh"), ("msh2", "b.msh"), ("exodus", "c.exo")] {
        run(
            folder,
            &format!("export tets.vtu --to {format} -o {file} --quiet"),
        );
        // The new name has six letters as the old one, so that no offset changes.
        let path = folder.join(file);
        let mut bytes = std::fs::read(&path).unwrap();
        for offset in 0..bytes.len() - 6 {
            if &bytes[offset..offset + 6] == b"fault1" {
                bytes[offset..offset + 6].copy_from_slice(b"Main-A");
            }
        }
        std::fs::write(&path, bytes).unwrap();
        let run_json = run(folder, &format!("surface {file} -o {format}.obj --json"));
        let report: serde_json::Value = serde_json::from_str(&run_json).unwrap();
        let surfaces = report["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 1, "{run_json}");
        assert_eq!(surfaces[0]["name"], "Main-A");
        assert_eq!(surfaces[0]["kind"], "fault");
        let table = run(folder, &format!("surface {file} -o {format}.obj"));
        assert!(table.contains("  Main-A"), "{table}");
        let text = std::fs::read_to_string(folder.join(format!("{format}.obj"))).unwrap();
        assert!(text.contains("Main-A"), "{file}");
        // Exports use the name, and flow has the fault as number 1.
        run(
            folder,
            &format!("export {file} --to inp -o {format}.inp --quiet"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{format}.inp"))).unwrap();
        assert!(text.contains("NSET=NMAIN-A"), "{file}");
        let flow = format!("flow {file} -o flow.vtu --pressure xmin=1 --pressure xmax=0 --json");
        let rate = |options: &str| -> f64 {
            let run_json = run(folder, &format!("{flow} {options}"));
            let report: serde_json::Value = serde_json::from_str(&run_json).unwrap();
            report["solver"]["throughput"].as_f64().unwrap()
        };
        let (free, hindered) = (rate("--faults open"), rate("--fault-multiplier 1:0.001"));
        assert!(hindered < 0.5 * free, "{hindered} of {free}");
        // The mesh that flow writes still has the name.
        rate("--faults open");
        let run_json = run(folder, "surface flow.vtu -o flow.obj");
        assert!(run_json.contains("Main-A"), "{run_json}");
    }
}

#[test]
#[ignore = "needs VTK and SciPy: make test-all"]
fn meshes_of_mixed_cells_are_read_as_polyhedra() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for kind in ["hexahedra", "polyhedra", "mismatch"] {
        let path = folder.join(format!("{kind}.vtu"));
        let arguments = [path.as_os_str(), OsStr::new(kind)];
        run_validator("VTK", "mixed.py", &arguments);
    }
    for kind in ["hexahedra", "polyhedra"] {
        // There are 9 cubes and 18 wedges. Of the other 18 cubes, 5 sides are pyramids and the
        // others two tetrahedra each.
        let cells = 9 + 18 + 9 * (5 + 2) + 9 * 12;
        let report = run_json(folder, &format!("quality {kind}.vtu"));
        assert_eq!(report["voronoi"]["check"]["cells"], cells, "{report}");
        assert_eq!(
            report["voronoi"]["check"]["problems"]
                .as_array()
                .map(Vec::len),
            Some(0),
            "{report}"
        );
        let report = run_json(folder, &format!("info {kind}.vtu"));
        assert_eq!(
            report["nodes"],
            5 * 4 * 4 + 18,
            "a point without a cell is dropped"
        );
        run(folder, &format!("validate {kind}.vtu --quiet"));
        let report = run_json(folder, &format!("surface {kind}.vtu -o a.obj --min-area 0"));
        let surfaces = report["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 1, "{report}");
        assert!(
            is_close(surfaces[0]["area"].as_f64().unwrap(), 9.0, 1e-12),
            "{report}"
        );
        // With an open fault the flow is nearly that in a box of one kind of cells. Closed
        // quadrilaterals are impermeable.
        let flow = format!("flow {kind}.vtu -o f.vtu --pressure xmin=1 --pressure xmax=0");
        let report = run_json(
            folder,
            &format!("{flow} --faults open --permeability 1e-13"),
        );
        let rate = report["solver"]["throughput"].as_f64().unwrap();
        assert!(is_close(rate, 1e-13 * 9.0 / 1e-3 / 4.0, 0.05), "{rate}");
        let report = run_json(folder, &flow);
        assert_eq!(report["solver"]["compartments"], 2, "{report}");
        run(
            folder,
            &format!("export {kind}.vtu --to exodus -o {kind}.exo --quiet"),
        );
        let path = folder.join(format!("{kind}.exo"));
        let result = run_validator("SciPy", "exodus.py", &[path.as_os_str()]);
        assert_eq!(result["cells"], cells);
        assert_eq!(result["blocks"], serde_json::json!(["region4", "region5"]));
        assert!(is_close(
            result["sets"]["xmax"]["area"].as_f64().unwrap(),
            9.0,
            1e-12
        ));
        assert!(is_close(
            result["sets"]["fault1"]["area"].as_f64().unwrap(),
            9.0,
            1e-12
        ));
    }
    for line in [
        "quality mismatch.vtu",
        "export mismatch.vtu --to vtkhdf -o f.vtkhdf",
    ] {
        let arguments: Vec<&str> = line.split(' ').collect();
        let line = expect_refusal(folder, &arguments);
        assert!(line.contains("nothing would pass between"), "{line}");
    }
}

#[test]
#[ignore = "needs SciPy: make test-all"]
fn exodus_meshes_of_polyhedra_survive_a_round_trip() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(folder, "export cells.vtu --to exodus -o a.exo --quiet");
    let [original, reread] =
        ["cells.vtu", "a.exo"].map(|file| run_json(folder, &format!("quality {file}")));
    for figure in ["nodes", "cells", "faces"] {
        assert_eq!(
            original["voronoi"]["check"][figure], reread["voronoi"]["check"][figure],
            "{figure}"
        );
    }
    assert_eq!(
        reread["voronoi"]["check"]["problems"]
            .as_array()
            .map(Vec::len),
        Some(0),
        "{reread}"
    );
    let area = |file: &str| {
        let report = run_json(folder, &format!("surface {file} -o a.obj"));
        let surfaces = report["surfaces"].as_array().unwrap().clone();
        assert_eq!(surfaces.len(), 1, "{file}");
        (
            surfaces[0]["area"].as_f64().unwrap(),
            surfaces[0]["name"].clone(),
        )
    };
    let (original, reread) = (area("cells.vtu"), area("a.exo"));
    // The triangulation of a polygon begins at another corner. As close nodes are merged, polygons
    // are flat only up to rounding of their nodes; the difference was 1e-8 of the area at most.
    assert!(
        is_close(original.0, reread.0, 1e-7),
        "{original:?} {reread:?}"
    );
    assert_eq!((original.1, reread.1), (Value::Null, "fault1".into()));
    run(folder, "export a.exo --to exodus -o b.exo --quiet");
    let [a, b] = ["a.exo", "b.exo"]
        .map(|file| run_validator("SciPy", "exodus.py", &[folder.join(file).as_os_str()]));
    for key in ["cells", "faces", "blocks"] {
        assert_eq!(a[key], b[key]);
    }
    for name in ["xmin", "fault1"] {
        assert_eq!(a["sets"][name]["faces"], b["sets"][name]["faces"], "{name}");
    }
    // A file that is truncated is refused in one line.
    let bytes = std::fs::read(folder.join("a.exo")).unwrap();
    for end in [bytes.len() / 3, bytes.len() / 2] {
        std::fs::write(folder.join("cut.exo"), &bytes[..end]).unwrap();
        expect_refusal(folder, &["quality", "cut.exo"]);
    }
    run_args(folder, &["validate", "a.exo", "--quiet"]);
}
