//! A job that was ended goes on from the last stage that was kept, and makes the same mesh, byte by byte.

use std::fs;
use std::path::Path;

use crate::common::{atomesh, write_npy, write_npy_2d, expect_refusal, planar_fault};

/// The mesh that a line of words makes, and what is said on the way.
fn made(folder: &Path, words: &str) -> (Vec<u8>, String) {
    let line = words.split_whitespace();
    let output = atomesh(folder)
        .arg("mesh")
        .args(line)
        .args(["-o", "m.vtu"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{words}: {said}");
    (fs::read(folder.join("m.vtu")).unwrap(), said)
}

/// The files of stages, in order.
fn kept(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("kept")).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Ends a job after each of its stages and starts it again; damages what each has kept.
fn goes_on(folder: &Path, words: &str, stages: &[&str]) {
    let (whole, _) = made(folder, words);
    let words = &format!("{words} --checkpoint kept");
    assert_eq!(made(folder, words).0, whole, "{words}");
    let expected: Vec<String> = stages
        .iter()
        .map(|name| format!("{name}.checkpoint"))
        .collect();
    assert_eq!(kept(folder), expected, "{words}");
    let path = |name: &str| folder.join("kept").join(name);
    for (k, name) in expected.iter().enumerate() {
        let (bytes, said) = made(folder, words);
        assert_eq!(bytes, whole, "{words}: from {name}");
        assert!(!said.contains("stage is made"), "{said}");
        // As a job leaves it that is killed in the stage before.
        for later in &expected[expected.len() - 1 - k..] {
            fs::remove_file(path(later)).unwrap();
        }
        assert_eq!(made(folder, words).0, whole, "{words}: without {k} stages");
        assert_eq!(kept(folder), expected, "{words}");
        // What is damaged is made again, and nothing is needed of the stages before.
        let good = fs::read(path(name)).unwrap();
        let mut bad = good.clone();
        let middle = bad.len() / 2;
        bad[middle] ^= 1;
        for bad in [&bad[..], &good[..good.len() - 1], &good[..10], b""] {
            for later in &expected[k..] {
                fs::remove_file(path(later)).unwrap();
            }
            fs::write(path(name), bad).unwrap();
            let (bytes, said) = made(folder, words);
            assert_eq!(bytes, whole, "{words}: damaged {name}");
            let line = format!("{name}: is damaged: this stage is made again");
            assert_eq!(said.matches(&line).count(), 1, "{said}");
            if bad.is_empty() {
                continue;
            }
            assert_eq!(fs::read(path(name)).unwrap(), good);
        }
    }
}

#[test]
#[cfg(feature = "tetgen")]
fn tetrahedra_are_the_same_whatever_stage_a_job_went_on_from() {
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
    goes_on(folder.path(), "a.npy --distance 5:7", &stages);

    // Another image, and another option: all is made anew, said once for each stage.
    let words = "a.npy --distance 5:7 --checkpoint kept";
    let other = "a.npy --distance 5:8 --checkpoint kept";
    let alone = made(folder.path(), "a.npy --distance 5:8").0;
    let (bytes, said) = made(folder.path(), other);
    assert_eq!(bytes, alone);
    assert_eq!(
        said.matches("other options").count(),
        stages.len(),
        "{said}"
    );
    assert!(!made(folder.path(), other).1.contains("other options"));
    write_npy(&folder.path().join("a.npy"), [26, 24, 22], |x| {
        planar_fault([26, 24, 22])(x) + 1.0
    });
    assert!(made(folder.path(), words).1.contains("is of another image"));
    // Where it is written does not matter.
    let (_, said) = made(folder.path(), &format!("{words} --report r.json"));
    assert!(!said.contains("other options"), "{said}");
}

#[test]
fn triangles_and_cells_are_the_same_whatever_stage_a_job_went_on_from() {
    let folder = tempfile::tempdir().unwrap();
    write_npy_2d(&folder.path().join("a.npy"), [60, 50], |[x, y]| {
        f32::from((x as f64 - 30.0).hypot(y as f64 - 25.0) < 15.0)
    });
    let stages = ["1-features", "2-seeded", "3-moved", "5-improved"];
    goes_on(folder.path(), "a.npy --distance 6", &stages);
    fs::remove_dir_all(folder.path().join("kept")).unwrap();
    let voronoi = "a.npy --distance 6 --cells voronoi";
    goes_on(
        folder.path(),
        voronoi,
        &["1-features", "2-seeded", "3-moved"],
    );
}

#[test]
fn a_folder_is_needed_and_lattices_are_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    write_npy_2d(&folder.path().join("a.npy"), [40, 40], |[x, _]| {
        f32::from(x > 20)
    });
    fs::write(folder.path().join("file"), "").unwrap();
    let error = expect_refusal(folder.path(), &["mesh", "a.npy", "--checkpoint", "file"]);
    assert!(error.contains("is no folder"), "{error}");
    let traced = ["mesh", "a.npy", "--checkpoint", "kept", "--trace", "t.pvd"];
    let error = expect_refusal(folder.path(), &traced);
    assert!(error.contains("keeps no lattices for --trace"), "{error}");
    assert!(!folder.path().join("kept").exists());
}
