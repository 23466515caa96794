//! Meshes of other programs are as good as ours for every verb.

use std::ffi::OsStr;
use std::path::Path;

use crate::common::{run_validator, is_close, expect_refusal, run, folder_with_meshes, run_args};
use serde_json::Value;

/// What a verb says as JSON.
fn said(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("{line} --json --quiet"))).unwrap()
}

#[test]
fn surfaces_keep_the_names_that_others_gave_them() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for (format, file) in [("msh", "a.msh"), ("msh2", "b.msh"), ("exodus", "c.exo")] {
        run(
            folder,
            &format!("export tets.vtu --to {format} -o {file} --quiet"),
        );
        // Six letters, so that nothing else moves.
        let path = folder.join(file);
        let mut bytes = std::fs::read(&path).unwrap();
        for at in 0..bytes.len() - 6 {
            if &bytes[at..at + 6] == b"fault1" {
                bytes[at..at + 6].copy_from_slice(b"Main-A");
            }
        }
        std::fs::write(&path, bytes).unwrap();
        let said = run(folder, &format!("surface {file} -o {format}.obj --json"));
        let found: serde_json::Value = serde_json::from_str(&said).unwrap();
        let surfaces = found["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 1, "{said}");
        assert_eq!(surfaces[0]["name"], "Main-A");
        assert_eq!(surfaces[0]["kind"], "fault");
        let table = run(folder, &format!("surface {file} -o {format}.obj"));
        assert!(table.contains("  Main-A"), "{table}");
        let text = std::fs::read_to_string(folder.join(format!("{format}.obj"))).unwrap();
        assert!(text.contains("Main-A"), "{file}");
        // Exports call it so, and flow has it as number 1.
        run(
            folder,
            &format!("export {file} --to inp -o {format}.inp --quiet"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{format}.inp"))).unwrap();
        assert!(text.contains("NSET=NMAIN_A"), "{file}");
        let flow = format!("flow {file} -o flow.vtu --pressure xmin=1 --pressure xmax=0 --json");
        let rate = |how: &str| -> f64 {
            let said = run(folder, &format!("{flow} {how}"));
            let found: serde_json::Value = serde_json::from_str(&said).unwrap();
            found["solver"]["throughput"].as_f64().unwrap()
        };
        let (free, hindered) = (rate("--faults open"), rate("--fault-multiplier 1:0.001"));
        assert!(hindered < 0.5 * free, "{hindered} of {free}");
        // Written again, the mesh still knows it.
        rate("--faults open");
        let said = run(folder, "surface flow.vtu -o flow.obj");
        assert!(said.contains("Main-A"), "{said}");
    }
}

#[test]
#[ignore = "needs VTK and SciPy: make test-all"]
fn cells_of_several_shapes_are_polyhedra() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for how in ["hexahedra", "polyhedra", "mismatch"] {
        let path = folder.join(format!("{how}.vtu"));
        let arguments = [path.as_os_str(), OsStr::new(how)];
        run_validator("VTK", "mixed.py", &arguments);
    }
    for how in ["hexahedra", "polyhedra"] {
        // 9 cubes, 18 wedges; of 18 cubes 5 sides are pyramids and the others two tetrahedra each.
        let cells = 9 + 18 + 9 * (5 + 2) + 9 * 12;
        let found = said(folder, &format!("quality {how}.vtu"));
        assert_eq!(found["voronoi"]["check"]["cells"], cells, "{found}");
        assert_eq!(
            found["voronoi"]["check"]["problems"]
                .as_array()
                .map(Vec::len),
            Some(0),
            "{found}"
        );
        let found = said(folder, &format!("info {how}.vtu"));
        assert_eq!(
            found["nodes"],
            5 * 4 * 4 + 18,
            "a point of no cell is left out"
        );
        run(folder, &format!("validate {how}.vtu --quiet"));
        let found = said(folder, &format!("surface {how}.vtu -o a.obj --min-area 0"));
        let surfaces = found["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 1, "{found}");
        assert!(
            is_close(surfaces[0]["area"].as_f64().unwrap(), 9.0, 1e-12),
            "{found}"
        );
        // Open, nearly as in a box of one kind of cells; closed, the quadrilaterals let nothing through.
        let flow = format!("flow {how}.vtu -o f.vtu --pressure xmin=1 --pressure xmax=0");
        let found = said(
            folder,
            &format!("{flow} --faults open --permeability 1e-13"),
        );
        let rate = found["solver"]["throughput"].as_f64().unwrap();
        assert!(is_close(rate, 1e-13 * 9.0 / 1e-3 / 4.0, 0.05), "{rate}");
        let found = said(folder, &flow);
        assert_eq!(found["solver"]["compartments"], 2, "{found}");
        run(
            folder,
            &format!("export {how}.vtu --to exodus -o {how}.exo --quiet"),
        );
        let path = folder.join(format!("{how}.exo"));
        let found = run_validator("SciPy", "exodus.py", &[path.as_os_str()]);
        assert_eq!(found["cells"], cells);
        assert_eq!(found["blocks"], serde_json::json!(["region4", "region5"]));
        assert!(is_close(
            found["sets"]["xmax"]["area"].as_f64().unwrap(),
            9.0,
            1e-12
        ));
        assert!(is_close(
            found["sets"]["fault1"]["area"].as_f64().unwrap(),
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
fn exodus_meshes_of_polyhedra_come_back() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(folder, "export cells.vtu --to exodus -o a.exo --quiet");
    let [ours, theirs] =
        ["cells.vtu", "a.exo"].map(|file| said(folder, &format!("quality {file}")));
    for figure in ["nodes", "cells", "faces"] {
        assert_eq!(
            ours["voronoi"]["check"][figure], theirs["voronoi"]["check"][figure],
            "{figure}"
        );
    }
    assert_eq!(
        theirs["voronoi"]["check"]["problems"]
            .as_array()
            .map(Vec::len),
        Some(0),
        "{theirs}"
    );
    let area = |file: &str| {
        let found = said(folder, &format!("surface {file} -o a.obj"));
        let surfaces = found["surfaces"].as_array().unwrap().clone();
        assert_eq!(surfaces.len(), 1, "{file}");
        (
            surfaces[0]["area"].as_f64().unwrap(),
            surfaces[0]["name"].clone(),
        )
    };
    let (ours, theirs) = (area("cells.vtu"), area("a.exo"));
    // The triangles of a face of many corners begin elsewhere.
    assert!(is_close(ours.0, theirs.0, 1e-8), "{ours:?} {theirs:?}");
    assert_eq!((ours.1, theirs.1), (Value::Null, "fault1".into()));
    run(folder, "export a.exo --to exodus -o b.exo --quiet");
    let [a, b] = ["a.exo", "b.exo"]
        .map(|file| run_validator("SciPy", "exodus.py", &[folder.join(file).as_os_str()]));
    for what in ["cells", "faces", "blocks"] {
        assert_eq!(a[what], b[what]);
    }
    for name in ["xmin", "fault1"] {
        assert_eq!(a["sets"][name]["faces"], b["sets"][name]["faces"], "{name}");
    }
    // Cut, or with another number of faces, it is refused in one line.
    let bytes = std::fs::read(folder.join("a.exo")).unwrap();
    for end in [bytes.len() / 3, bytes.len() / 2] {
        std::fs::write(folder.join("cut.exo"), &bytes[..end]).unwrap();
        expect_refusal(folder, &["quality", "cut.exo"]);
    }
    run_args(folder, &["validate", "a.exo", "--quiet"]);
}
