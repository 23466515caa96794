//! Tests that an interrupted job continues from its last checkpoint, and makes the same mesh, byte
//! for byte.

use std::fs;
use std::path::Path;

use crate::common::{atomesh, expect_refusal, planar_fault, write_npy, write_npy_2d};

/// Runs `mesh` with the options of a line, and returns the file of the mesh and the standard error.
fn make_mesh(folder: &Path, words: &str) -> (Vec<u8>, String) {
    let line = words.split_whitespace();
    let output = atomesh(folder)
        .arg("mesh")
        .args(line)
        .args(["-o", "m.vtu"])
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{words}: {stderr}");
    (fs::read(folder.join("m.vtu")).unwrap(), stderr)
}

/// Returns the names of the checkpoint files, sorted.
fn checkpoint_files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("kept")).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Restarts a job from each of its stages, also after damage to a checkpoint, and compares the
/// meshes.
fn assert_restarts(folder: &Path, words: &str, stages: &[&str]) {
    let (reference, _) = make_mesh(folder, words);
    let words = &format!("{words} --checkpoint kept");
    assert_eq!(make_mesh(folder, words).0, reference, "{words}");
    let expected: Vec<String> = stages
        .iter()
        .map(|name| format!("{name}.checkpoint"))
        .collect();
    assert_eq!(checkpoint_files(folder), expected, "{words}");
    let path = |name: &str| folder.join("kept").join(name);
    for (k, name) in expected.iter().enumerate() {
        let (bytes, stderr) = make_mesh(folder, words);
        assert_eq!(bytes, reference, "{words}: from {name}");
        assert!(!stderr.contains("stage is made"), "{stderr}");
        // This is the state that a job leaves if it is killed in the stage before.
        for later in &expected[expected.len() - 1 - k..] {
            fs::remove_file(path(later)).unwrap();
        }
        assert_eq!(
            make_mesh(folder, words).0,
            reference,
            "{words}: without {k} stages"
        );
        assert_eq!(checkpoint_files(folder), expected, "{words}");
        // A damaged stage is computed again, and the stages before it are not needed.
        let good = fs::read(path(name)).unwrap();
        let mut bad = good.clone();
        let middle = bad.len() / 2;
        bad[middle] ^= 1;
        for bad in [&bad[..], &good[..good.len() - 1], &good[..10], b""] {
            for later in &expected[k..] {
                fs::remove_file(path(later)).unwrap();
            }
            fs::write(path(name), bad).unwrap();
            let (bytes, stderr) = make_mesh(folder, words);
            assert_eq!(bytes, reference, "{words}: damaged {name}");
            let line = format!("{name}: is damaged: this stage is run again");
            assert_eq!(stderr.matches(&line).count(), 1, "{stderr}");
            if bad.is_empty() {
                continue;
            }
            assert_eq!(fs::read(path(name)).unwrap(), good);
        }
    }
}

#[test]
fn tetrahedra_are_the_same_after_a_restart_from_any_stage() {
    let folder = tempfile::tempdir().unwrap();
    write_npy(
        &folder.path().join("a.npy"),
        [26, 24, 22],
        planar_fault([26, 24, 22]),
    );
    let stages = [
        "1-features",
        "2-seeded",
        "3-moved",
        "4-joined",
        "5-improved",
    ];
    assert_restarts(folder.path(), "a.npy --distance 5:7", &stages);

    // With another option or another image every stage is computed again, and a note for each stage
    // says so.
    let options = "a.npy --distance 5:7 --checkpoint kept";
    let other_options = "a.npy --distance 5:8 --checkpoint kept";
    let reference = make_mesh(folder.path(), "a.npy --distance 5:8").0;
    let (bytes, stderr) = make_mesh(folder.path(), other_options);
    assert_eq!(bytes, reference);
    assert_eq!(
        stderr.matches("other options").count(),
        stages.len(),
        "{stderr}"
    );
    assert!(
        !make_mesh(folder.path(), other_options)
            .1
            .contains("other options")
    );
    write_npy(&folder.path().join("a.npy"), [26, 24, 22], |x| {
        planar_fault([26, 24, 22])(x) + 1.0
    });
    assert!(
        make_mesh(folder.path(), options)
            .1
            .contains("is of another image")
    );
    // Options of the output do not matter.
    let (_, stderr) = make_mesh(folder.path(), &format!("{options} --report r.json"));
    assert!(!stderr.contains("other options"), "{stderr}");
}

#[test]
fn triangles_and_cells_are_the_same_after_a_restart_from_any_stage() {
    let folder = tempfile::tempdir().unwrap();
    write_npy_2d(&folder.path().join("a.npy"), [60, 50], |[x, y]| {
        f32::from((x as f64 - 30.0).hypot(y as f64 - 25.0) < 15.0)
    });
    let stages = ["1-features", "2-seeded", "3-moved", "5-improved"];
    assert_restarts(folder.path(), "a.npy --distance 6", &stages);
    fs::remove_dir_all(folder.path().join("kept")).unwrap();
    let voronoi = "a.npy --distance 6 --cells voronoi";
    assert_restarts(
        folder.path(),
        voronoi,
        &["1-features", "2-seeded", "3-moved"],
    );
}

#[test]
fn checkpoints_need_a_folder_and_exclude_traces() {
    let folder = tempfile::tempdir().unwrap();
    write_npy_2d(&folder.path().join("a.npy"), [40, 40], |[x, _]| {
        f32::from(x > 20)
    });
    fs::write(folder.path().join("file"), "").unwrap();
    let error = expect_refusal(folder.path(), &["mesh", "a.npy", "--checkpoint", "file"]);
    assert!(error.contains("is not a folder"), "{error}");
    let traced = ["mesh", "a.npy", "--checkpoint", "kept", "--trace", "t.pvd"];
    let error = expect_refusal(folder.path(), &traced);
    assert!(error.contains("keeps no lattices for --trace"), "{error}");
    assert!(!folder.path().join("kept").exists());
}
