//! Tests label images: from the image to regions, surfaces and named sets.

use std::collections::BTreeMap;

use crate::common::{expect_refusal, run, write_npy};

/// Returns the label of a sample: two layers, a ball that intersects both, and a speck of one
/// sample.
fn label([x, y, z]: [usize; 3]) -> f32 {
    let distance_from = |c: [f32; 3]| {
        let p = [x, y, z].map(|i| i as f32);
        (0..3).map(|k| (p[k] - c[k]).powi(2)).sum::<f32>().sqrt()
    };
    match () {
        () if distance_from([20.0, 17.0, 15.0]) < 9.0 => 3.0,
        () if [x, y, z] == [34, 30, 27] => 7.0,
        () => 1.0 + f32::from(u8::from(z as f32 > 14.0 + 0.1 * x as f32)),
    }
}

#[test]
fn labels_become_regions_closed_surfaces_and_named_sets() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), [40, 36, 32], label);
    let stdout = run(
        folder,
        "mesh labels.npy -o m.vtu --distance 3:6 --label 3:name=core --details",
    );
    let expected = "LOST of label 7: a part of 1 sample at (34, 30, 27)\n";
    assert!(stdout.contains(expected), "{stdout}");
    // Specks are rarely wanted, so that finer cells are no remedy.
    assert!(
        stdout.contains("fair: the part of label 7 with 1 sample at (34, 30, 27) is lost")
            && !stdout.contains("--label 7:distance"),
        "{stdout}"
    );

    let stdout = run(folder, "surface m.vtu --by regions -o s.obj");
    assert!(stdout.contains("wrote s.obj: 5 surfaces"), "{stdout}");
    let text = std::fs::read_to_string(folder.join("s.obj")).unwrap();
    let mut surfaces: BTreeMap<&str, Vec<[usize; 3]>> = BTreeMap::new();
    let mut name = "";
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["o" | "g", new_name] => name = new_name,
            ["f", a, b, c] => {
                let face = [a, b, c].map(|n| n.split('/').next().unwrap().parse().unwrap());
                surfaces.entry(name).or_default().push(face);
            }
            _ => {}
        }
    }
    let names: Vec<&str> = surfaces.keys().copied().collect();
    assert_eq!(names, ["1_2", "1_core", "1_outside", "2_core", "2_outside"]);
    for region in ["1", "2", "core"] {
        let mut edges: BTreeMap<[usize; 2], i32> = BTreeMap::new();
        for (name, faces) in &surfaces {
            let (inside, outside) = name.split_once('_').unwrap();
            let sign = i32::from(inside == region) - i32::from(outside == region);
            for face in faces {
                for k in 0..3 {
                    let (a, b) = (face[k], face[(k + 1) % 3]);
                    *edges.entry([a.min(b), a.max(b)]).or_default() +=
                        if a < b { sign } else { -sign };
                }
            }
        }
        assert!(edges.values().all(|sum| *sum == 0), "{region} has a hole");
    }

    run(folder, "export m.vtu --to msh2 -o m.msh --quiet");
    let text = std::fs::read_to_string(folder.join("m.msh")).unwrap();
    for name in [
        "core",
        "region1",
        "interface_1_2",
        "interface_1_core",
        "interface_2_core",
        "xmin",
    ] {
        assert!(
            text.contains(&format!("\"{name}\"")),
            "no {name}: {}",
            &text[..600]
        );
    }
    assert!(!text.contains("fault1"), "{}", &text[..600]);
}

#[test]
fn absent_labels_and_impossible_label_options_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), [40, 36, 32], label);
    for (option, expected) in [
        (
            "--label 5:distance=2",
            "label 5: is not in the image, whose labels are 1, 2, 3, 7",
        ),
        ("--label 3:distance=0", "--label 3:distance=0"),
        ("--label 3:colour=1", "is not an option"),
        ("--label 3:distance=40", "40"),
        ("--label 3:name=x --feature edges", "--label"),
    ] {
        let line = format!("mesh labels.npy -o m.vtu {option}");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{option}: {error}");
    }
    run(folder, "synth sphere -o s.npy --dims 30,30,30 --quiet");
    run(
        folder,
        "mesh s.npy -o s.vtu --distance 6 --feature edges --quiet",
    );
    let error = expect_refusal(
        folder,
        &["surface", "s.vtu", "--by", "regions", "-o", "a.vtp"],
    );
    assert!(error.contains("only one region"), "{error}");
}

#[test]
fn exported_label_meshes_suit_every_verb() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), [40, 36, 32], label);
    run(
        folder,
        "mesh labels.npy -o m.vtu --distance 6 --label 3:name=core --quiet",
    );
    let original: serde_json::Value =
        serde_json::from_str(&run(folder, "quality m.vtu --json --quiet")).unwrap();
    for (format, file) in [("msh", "a.msh"), ("msh2", "b.msh"), ("exodus", "c.exo")] {
        run(
            folder,
            &format!("export m.vtu --to {format} -o {file} --quiet"),
        );
        let stdout = run(folder, &format!("quality {file} --json --quiet"));
        let reread: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        for figure in ["nodes", "cells", "below_20"] {
            assert_eq!(
                original["quality"][figure], reread["quality"][figure],
                "{file} {figure}"
            );
        }
        assert_eq!(
            reread["box"]["problems"].as_array().map(Vec::len),
            Some(0),
            "{file}"
        );
        let stdout = run(
            folder,
            &format!("surface {file} --by regions -o {format}.obj"),
        );
        for name in ["core", "1 ", "2 "] {
            assert!(stdout.contains(name), "{file}: {stdout}");
        }
        run(
            folder,
            &format!("export {file} --to inp -o {format}.inp --quiet"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{format}.inp"))).unwrap();
        assert!(text.contains("ELSET=CORE"), "{file}");
        run(
            folder,
            &format!("flow {file} -o flow.vtu --pressure xmin=1 --pressure xmax=0 --quiet"),
        );
    }
    let cut = std::fs::read(folder.join("c.exo")).unwrap();
    std::fs::write(folder.join("cut.exo"), &cut[..cut.len() / 2]).unwrap();
    let error = expect_refusal(folder, &["quality", "cut.exo"]);
    assert!(
        error.contains("cut.exo: ") && error.contains("copy the file again"),
        "{error}"
    );
    std::fs::write(folder.join("hdf.exo"), b"\x89HDF\r\n\x1a\n and more bytes").unwrap();
    let error = expect_refusal(folder, &["quality", "hdf.exo"]);
    assert!(
        error.contains("hdf.exo: is damaged or no HDF5 file"),
        "{error}"
    );
}

#[test]
fn a_mesh_is_judged_by_the_samples_of_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), [40, 36, 32], label);
    run(
        folder,
        "mesh labels.npy -o m.vtu --distance 3:6 --quiet --report m.json",
    );
    let json = |text: &str| -> serde_json::Value { serde_json::from_str(text).unwrap() };
    let of_job = json(&std::fs::read_to_string(folder.join("m.json")).unwrap());
    let of_file = json(&run(
        folder,
        "quality m.vtu --labels labels.npy --json --quiet",
    ));
    let [of_job, of_file] = [&of_job, &of_file].map(|report| &report["certificate"]);
    // The two layers, the ball in both and the speck.
    for certificate in [of_job, of_file] {
        assert_eq!(certificate["parts"], 4);
        assert_eq!(certificate["lost_parts"], 1);
        assert_eq!(certificate["pinch_count"], 0);
        assert_eq!(certificate["samples"], 40 * 36 * 32);
    }
    for key in ["changed_samples", "issues"] {
        assert_eq!(of_job[key], of_file[key]);
    }
    let ball = &of_job["part_reports"][2];
    assert_eq!(
        (&ball["label"], &ball["mesh_euler"]),
        (&json("3"), &json("2"))
    );
    assert!(
        ball["volume_error_percent"].as_f64().unwrap().abs() < 1.0,
        "{ball}"
    );
    let message = expect_refusal(folder, &["quality", "m.vtu", "--labels", "m.vtu"]);
    assert!(message.contains("m.vtu"), "{message}");
}
