//! Tests groups, sets and regions of other programs' meshes, with files that these programs wrote.

use std::ffi::OsStr;
use std::path::Path;

use crate::common::{expect_refusal, run, run_python, run_validator};
use serde_json::{Value, json};

/// Copies a file of `tests/data/meshes` to a folder.
fn copy(folder: &Path, name: &str) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/meshes")
        .join(name);
    std::fs::copy(source, folder.join(name)).unwrap();
}

/// Returns what `info` says about a file.
fn info(folder: &Path, file: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("info {file} --json"))).unwrap()
}

/// Returns the names of a kind of groups with the number of their members.
fn groups(info: &Value, kind: &str) -> Vec<(String, u64)> {
    let entry = |entry: &Value| {
        let name = entry["name"].as_str().unwrap().to_string();
        (name, entry["count"].as_u64().unwrap())
    };
    info[kind].as_array().unwrap().iter().map(entry).collect()
}

fn export(folder: &Path, from: &str, format: &str, to: &str) -> String {
    run(
        folder,
        &format!("export {from} --to {format} -o {to} --quiet"),
    );
    std::fs::read_to_string(folder.join(to)).unwrap_or_default()
}

#[test]
fn overlapping_physical_groups_are_regions_and_a_set() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for file in ["allfirst.msh", "two2.2.msh"] {
        copy(folder, file);
        let read = info(folder, file);
        let regions = groups(&read, "regions");
        assert_eq!(regions.len(), 2, "{read}");
        assert_eq!([&regions[0].0, &regions[1].0], ["left", "right"]);
        let total = regions[0].1 + regions[1].1;
        assert_eq!(groups(&read, "cell_sets"), [("all".to_string(), total)]);
        // The sets survive in all formats that have them.
        for (format, written) in [("msh", "o.msh"), ("inp", "o.inp")] {
            let text = export(folder, file, format, written);
            if format == "msh" {
                let again = info(folder, written);
                assert_eq!(groups(&again, "regions"), regions, "{file}");
                assert_eq!(groups(&again, "cell_sets"), groups(&read, "cell_sets"));
            } else {
                for name in ["LEFT", "RIGHT", "ALL"] {
                    assert!(
                        text.contains(&format!("*ELSET, ELSET={name}\n")),
                        "{file}: {name}"
                    );
                }
            }
        }
        // In version 2.2 readers would count a cell of two groups twice.
        let line = format!("export {file} --to msh2 -o o2.msh");
        let output = crate::common::atomesh(folder)
            .args(line.split(' '))
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            stderr.contains("msh2 has no place for the sets of cells"),
            "{stderr}"
        );
        assert_eq!(groups(&info(folder, "o2.msh"), "regions"), regions);
    }
}

#[test]
fn sets_on_the_boundary_and_of_nodes_survive_exports() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for file in ["x.exo", "pos.msh"] {
        copy(folder, file);
        let read = info(folder, file);
        let faces = groups(&read, "face_sets");
        let nodes = groups(&read, "node_sets");
        assert!(!faces.is_empty(), "{read}");
        for (format, written) in [("msh", "o.msh"), ("msh2", "o2.msh"), ("exodus", "o.exo")] {
            export(folder, file, format, written);
            let again = info(folder, written);
            for face_set in &faces {
                assert!(
                    groups(&again, "face_sets").contains(face_set),
                    "{written}: {again}"
                );
            }
            for node_set in &nodes {
                assert!(
                    groups(&again, "node_sets").contains(node_set),
                    "{written}: {again}"
                );
            }
        }
        let text = export(folder, file, "inp", "o.inp");
        for (name, _) in &faces {
            let name = name.to_uppercase();
            assert!(
                text.contains(&format!("*SURFACE, NAME=S{name},")),
                "{file}: {name}"
            );
            assert!(
                text.contains(&format!("*NSET, NSET=N{name}\n")),
                "{file}: {name}"
            );
        }
        for (name, _) in &nodes {
            assert!(
                text.contains(&format!("*NSET, NSET={}\n", name.to_uppercase())),
                "{name}"
            );
        }
    }
}

#[test]
fn integer_arrays_of_legacy_vtk_files_are_regions() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for file in ["two_uint8a.vtk", "two_uint16.vtk", "two_int32.vtk"] {
        copy(folder, file);
        let regions = groups(&info(folder, file), "regions");
        assert_eq!(regions.len(), 2, "{file}");
        let text = export(folder, file, "inp", "o.inp");
        assert_eq!(text.matches("*ELSET, ELSET=").count(), 2, "{file}");
    }
}

#[test]
fn a_mesh_of_msh_4_1_without_entities_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    copy(folder, "allfirst.msh");
    let text = std::fs::read_to_string(folder.join("allfirst.msh")).unwrap();
    let (start, end) = (
        text.find("$Entities").unwrap(),
        text.find("$Nodes").unwrap(),
    );
    std::fs::write(
        folder.join("none.msh"),
        [&text[..start], &text[end..]].concat(),
    )
    .unwrap();
    let error = expect_refusal(folder, &["info", "none.msh"]);
    assert!(error.contains("no section $Entities"), "{error}");
}

#[test]
#[ignore = "needs Gmsh: make test-all"]
fn gmsh_reads_overlapping_groups_and_sets_of_nodes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    copy(folder, "allfirst.msh");
    copy(folder, "x.exo");
    let read = info(folder, "allfirst.msh");
    export(folder, "allfirst.msh", "msh", "o.msh");
    let result = run_validator("Gmsh", "physical.py", &[folder.join("o.msh").as_os_str()]);
    let count = |dim: u64, name: &str| {
        let groups = result["groups"].as_array().unwrap().iter();
        let mut found = groups.filter(|g| g[0] == dim && g[1] == name);
        found.next().unwrap()[2].as_u64().unwrap()
    };
    for (name, n) in groups(&read, "regions")
        .iter()
        .chain(&groups(&read, "cell_sets"))
    {
        assert_eq!(count(3, name), *n, "{name}: {result}");
    }
    assert_eq!(
        result["volume"].as_f64().map(|v| (v - 2.0).abs() < 1e-9),
        Some(true)
    );
    export(folder, "x.exo", "msh", "x.msh");
    let read = info(folder, "x.exo");
    let result = run_validator("Gmsh", "physical.py", &[folder.join("x.msh").as_os_str()]);
    let names: Vec<&Value> = result["groups"]
        .as_array()
        .unwrap()
        .iter()
        .map(|g| &g[1])
        .collect();
    for (name, _) in groups(&read, "face_sets")
        .iter()
        .chain(&groups(&read, "node_sets"))
    {
        assert!(names.contains(&&json!(name)), "{name}: {result}");
    }
}

#[test]
#[ignore = "needs h5py, meshio and VTK: make test-all"]
fn meshes_in_hdf5_are_read_as_the_same_meshes_in_other_formats() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/export/hdf5_meshes.py");
    let arguments = [script.as_os_str(), folder.as_os_str(), OsStr::new("meshes")];
    let expected: Value = serde_json::from_str(&run_python("meshio", &arguments)).unwrap();
    for (file, expected) in expected.as_object().unwrap() {
        let read = info(folder, file);
        for key in ["nodes", "tetrahedra"] {
            assert_eq!(read[key], expected[key], "{file}: {read}");
        }
        let counts: Vec<u64> = groups(&read, "regions").iter().map(|r| r.1).collect();
        assert_eq!(json!(counts), expected["regions"], "{file}: {read}");
    }
}
