//! Tests `atomesh edit` on the command line.

use crate::common::{expect_refusal, planar_fault, run_args, write_npy};
use atomesh::mesh::TriMesh;
use atomesh::store::{AnyMesh, FieldValue, MeshFile, read_any_vtu, write_vtu};
use serde_json::Value;

fn json(folder: &std::path::Path, arguments: &[&str]) -> Value {
    let arguments = [arguments, &["--json", "--quiet"]].concat();
    serde_json::from_str(&run_args(folder, &arguments)).unwrap()
}

fn triangles(path: &std::path::Path) -> MeshFile<TriMesh> {
    match read_any_vtu(path).unwrap() {
        AnyMesh::Triangles(file) => file,
        other => panic!("not triangles: {other:?}"),
    }
}

fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

#[test]
fn atoms_are_added_moved_and_removed_in_a_volume() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let dims = [60, 44, 40];
    write_npy(&dir.join("image.npy"), dims, planar_fault(dims));
    let mesh = "mesh image.npy -o mesh.vtu --distance 5 --feature ridges --quiet";
    run_args(dir, &words(mesh));
    std::fs::write(
        dir.join("edits.csv"),
        "# two wells and an atom too many\nadd,10.5,12,8\nadd, 10.5, 12, 20.5\nremove,300\n",
    )
    .unwrap();
    let edit = "edit mesh.vtu image.npy -o edited.vtu --edits edits.csv --move 200:16.5,9,30";
    let report = json(dir, &words(edit));
    let atoms = report["atoms"].as_array().unwrap();
    assert_eq!(atoms[0], 200);
    assert!(
        atoms[1].is_u64() && atoms[2].is_u64() && atoms[3].is_null(),
        "{report}"
    );
    let angle = |q: &Value| q["smallest_angle"]["worst"].as_f64().unwrap();
    assert!(angle(&report["quality"][1]) > 25.0, "{report}");
    let stages = report["stages"].as_array().unwrap();
    assert_eq!(stages[0]["stage"], "reading");

    assert_eq!(json(dir, &["validate", "edited.vtu"])["valid"], true);
    let info = json(dir, &["info", "edited.vtu"]);
    let edits = info["fields"]["edits"].as_str().unwrap();
    assert_eq!(edits.lines().count(), 4, "{edits}");
    // The same input gives the same bytes. An edited mesh can be edited again and drawn.
    let bytes = std::fs::read(dir.join("edited.vtu")).unwrap();
    run_args(
        dir,
        &[&words(edit)[..], &["--threads", "1", "--quiet"]].concat(),
    );
    assert!(bytes == std::fs::read(dir.join("edited.vtu")).unwrap());
    let table = run_args(
        dir,
        &words("edit edited.vtu image.npy -o again.vtu --remove 200 --quiet --json"),
    );
    assert!(table.contains("again.vtu"));
    run_args(
        dir,
        &words("slice image.npy again.vtu -o again.png --quiet"),
    );

    for (line, names) in [
        ("edit mesh.vtu image.npy -o x.vtu", &["nothing to do"][..]),
        (
            "edit mesh.vtu image.npy -o x.vtu --add 1,2",
            &["--add 1,2", "3"],
        ),
        (
            "edit mesh.vtu image.npy -o x.vtu --add 99,2,3",
            &["--add 99,2,3", "outside"],
        ),
        (
            "edit mesh.vtu image.npy -o x.vtu --remove 99999999",
            &["--remove", "99999999"],
        ),
        (
            "edit mesh.vtu image.npy -o x.vtu --move 7",
            &["--move 7", "colon"],
        ),
        (
            "edit mesh.vtu image.npy -o mesh.vtu --remove 7",
            &["overwrite"],
        ),
        ("edit mesh.vtu image.npy -o x.png --remove 7", &[".vtu"]),
    ] {
        let error = expect_refusal(dir, &words(line));
        assert!(names.iter().all(|name| error.contains(name)), "{error}");
    }
}

#[test]
fn atoms_are_added_and_removed_in_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    run_args(
        dir,
        &words("synth faults -o slice.png --signal-to-noise 10 --dims 128,112 --quiet"),
    );
    run_args(dir, &words("mesh slice.png -o mesh.vtu --quiet"));
    let report = json(
        dir,
        &words("edit mesh.vtu slice.png -o edited.vtu --add 30.5,40.25 --remove 100 --free"),
    );
    assert!(
        report["atoms"][0].is_u64() && report["atoms"][1].is_null(),
        "{report}"
    );
    assert_eq!(json(dir, &["validate", "edited.vtu"])["valid"], true);
    let error = expect_refusal(dir, &words("edit mesh.vtu slice.png -o x.vtu --add 1,2,3"));
    assert!(error.contains("--add 1,2,3"), "{error}");
    run_args(
        dir,
        &words("synth faults -o other.png --dims 64,64 --quiet"),
    );
    let error = expect_refusal(dir, &words("edit mesh.vtu other.png -o x.vtu --remove 100"));
    assert!(error.contains("[64, 64]"), "{error}");
    run_args(
        dir,
        &words("mesh slice.png -o cells.vtu --cells voronoi --quiet"),
    );
    let edit = "edit cells.vtu slice.png -o cells2.vtu --add 30.5,40.25 --remove 100";
    let report = json(dir, &words(edit));
    assert!(
        report["atoms"][0].is_u64() && report["atoms"][1].is_null(),
        "{report}"
    );
    assert_eq!(json(dir, &["validate", "cells2.vtu"])["valid"], true);
    // The same input gives the same bytes.
    let bytes = std::fs::read(dir.join("cells2.vtu")).unwrap();
    let line = [&words(edit)[..], &["--threads", "1", "--quiet"]].concat();
    run_args(dir, &line);
    assert!(bytes == std::fs::read(dir.join("cells2.vtu")).unwrap());
    let error = expect_refusal(dir, &words("edit cells.vtu slice.png -o x.vtu --add 0,20"));
    assert!(error.contains("where cells end"), "{error}");
}

#[test]
fn cells_along_surfaces_are_edited_at_any_place() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    for (kind, dims) in [("sphere", "40,36,32"), ("faults", "60,56,52")] {
        run_args(
            dir,
            &words(&format!("synth {kind} -o i.npy --dims {dims} --quiet")),
        );
        run_args(
            dir,
            &words("mesh i.npy -o v.vtu --distance 6 --cells voronoi --quiet"),
        );
        for place in ["20.3,18.1,15.2", "30.5,20.5,25.5", "12.1,30.2,13.3"] {
            json(
                dir,
                &words(&format!("edit v.vtu i.npy -o e.vtu --add {place}")),
            );
            let valid = json(dir, &["validate", "e.vtu"]);
            assert_eq!(valid["valid"], true, "{kind}, {place}: {valid}");
        }
    }
}

#[test]
fn edits_use_the_evaluator_kappa_and_optimiser_of_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    run_args(
        dir,
        &words("synth faults -o slice.png --signal-to-noise 10 --dims 64,56 --quiet"),
    );
    let read = |name: &str| triangles(&dir.join(name));
    let record = |file: &MeshFile<TriMesh>| file.field_value("parameters").cloned().unwrap();
    let edited = |mesh: &str| {
        let line = format!("edit {mesh} slice.png -o edited.vtu --add 30.5,27.25 --quiet");
        run_args(dir, &words(&line));
        read("edited.vtu")
    };
    run_args(dir, &words("mesh slice.png -o mesh.vtu --quiet"));
    let mut results = vec![("by default", edited("mesh.vtu"))];
    for option in [
        "--kappa 0.5",
        "--evaluator sampled",
        "--optimizer descent",
        "--optimizer genetic",
    ] {
        let line = format!("mesh slice.png -o other.vtu --quiet {option}");
        run_args(dir, &words(&line));
        // The mesh is the same, but its file records other parameters.
        let (expected, mut file) = (record(&read("other.vtu")), read("mesh.vtu"));
        assert_ne!(expected, record(&file));
        for (name, value) in &mut file.field_data {
            if name == "parameters" {
                *value = expected.clone();
            }
        }
        write_vtu(&dir.join("recorded.vtu"), &file).unwrap();
        let file = edited("recorded.vtu");
        assert_eq!(
            record(&file),
            expected,
            "{option}: the edited mesh records it"
        );
        results.push((option, file));
    }
    for (i, (a, first)) in results.iter().enumerate() {
        for (b, second) in &results[..i] {
            assert_ne!(first.mesh.nodes, second.mesh.nodes, "{a}, {b}");
        }
    }
}

#[test]
fn meshes_of_version_0_1_0_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let old = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/version-0.1.0");
    for name in ["mesh.vtu", "refused.vtu", "image.png"] {
        std::fs::copy(old.join(name), dir.join(name)).unwrap();
    }
    // The mesh was made with --distance 6:9 --distance-from features --kappa 0.7 --optimizer
    // descent.
    let quality = json(dir, &["quality", "mesh.vtu"])["quality"].clone();
    assert_eq!(
        (&quality["nodes"], &quality["cells"]),
        (&36.into(), &50.into())
    );
    let worst = quality["smallest_angle"]["worst"].as_f64().unwrap();
    assert!(
        (worst - 31.7).abs() < 0.05,
        "the file records 31.7: {worst}"
    );
    run_args(
        dir,
        &words("edit mesh.vtu image.png -o edited.vtu --remove 12 --quiet"),
    );
    assert_eq!(json(dir, &["validate", "edited.vtu"])["valid"], true);
    let edited = triangles(&dir.join("edited.vtu"));
    assert_eq!(edited.mesh.nodes.len(), 35);
    let Some(FieldValue::Text(record)) = edited.field_value("parameters") else {
        panic!("no parameters");
    };
    for setting in [
        "distance = \"6:9\"",
        "kappa = 0.7",
        "optimizer = \"descent\"",
    ] {
        assert!(record.contains(setting), "no {setting} in {record}");
    }
    // Version 0.1.0 accepted --min-dihedral with --slivers none, which has no effect.
    json(dir, &["quality", "refused.vtu"]);
    let line = "edit refused.vtu image.png -o x.vtu --remove 12";
    let error = expect_refusal(dir, &words(line));
    for word in [
        "refused.vtu",
        "min-dihedral 20",
        "no slivers",
        "mesh the image again",
    ] {
        assert!(error.contains(word), "no '{word}' in: {error}");
    }
}
