//! Tests what `atomesh surface` measures in a survey and writes for interpreters, and masks of bodies.

use serde_json::Value;

use crate::common::{atomesh, expect_refusal, run_args};

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_survey_gives_attributes_and_files_of_horizons() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let run = |line: &str| run_args(dir, &line.split_whitespace().collect::<Vec<_>>());
    run("synth amplitude -o image.vti --dims 56,64,48 --count 1 --rng-seed 3 --quiet");
    run("mesh image.vti -o mesh.vtu --distance 5 --feature faults+horizons --quiet");
    let surface = "surface mesh.vtu --survey image.vti";
    let report = json(&run(&format!("{surface} --up -x -o s.vtp --json")));
    let surfaces = report["surfaces"].as_array().unwrap();
    let horizons: Vec<_> = surfaces.iter().filter(|s| s["kind"] == "horizon").collect();
    assert!(horizons.len() >= 2, "{report}");
    let has_upright_layers = |up: &str| {
        let line = format!("{surface} -o u.vtp --up {up}");
        let output = atomesh(dir).args(line.split(' ')).output().unwrap();
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("stand upright")
    };
    assert!(has_upright_layers("z") && !has_upright_layers("-x"));
    for horizon in &horizons {
        assert!(horizon["polarity"] == "peak" || horizon["polarity"] == "trough");
        assert!(horizon["confidence"].as_f64().unwrap() > 1.0, "{horizon}");
        assert!(horizon["throw"].is_null() && horizon["vertical_range"].is_array());
    }
    for ending in ["xyz", "irap"] {
        let report = json(&run(&format!("{surface} -o h.{ending} --json")));
        let files = report["files"].as_array().unwrap();
        assert_eq!(files.len(), horizons.len(), "{report}");
        for file in files {
            let path = file.as_str().unwrap();
            let name = path.rsplit('-').next().unwrap();
            assert!(name.starts_with("horizon"), "{path}");
            assert!(std::fs::metadata(dir.join(path)).unwrap().len() > 100);
        }
    }
    let charisma = format!("{surface} -o f.charisma");
    let error = expect_refusal(dir, &charisma.split(' ').collect::<Vec<_>>());
    assert!(
        error.contains("have line numbers, which no survey gives"),
        "{error}"
    );
    // Horizons bound blocks of `auto`, but not those of `blocks`.
    let regions = |seed: &str| {
        let report = json(&run(&format!(
            "paint mesh.vtu -o p.vtu --seed {seed} --json"
        )));
        report["regions"].as_array().unwrap().len()
    };
    assert!(regions("blocks") < regions("auto"));
}

/// Tests that samples under a mask, and their edge, are no features.
#[test]
fn a_mask_leaves_a_body_out() {
    use atomesh::image::{Geometry, Image};
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let dims = [40, 40, 40];
    let inside = |i: usize| {
        let index = [i % 40, i / 40 % 40, i / 1600];
        index.iter().all(|&k| (10..28).contains(&k))
    };
    let value = |i: usize| {
        let noise = ((i as f64 * 12.9898).sin() * 43_758.545_3).fract();
        (if inside(i) { 2.0 + noise } else { 0.1 * noise }) as f32
    };
    let write = |name: &str, samples: Vec<f32>| {
        let image = Image::new(dims, samples, Geometry::default());
        atomesh::image::formats::write(&dir.join(name), &image).unwrap();
    };
    write("image.npy", (0..64_000).map(value).collect());
    write(
        "salt.npy",
        (0..64_000)
            .map(|i| f32::from(u8::from(inside(i))))
            .collect(),
    );
    write("small.npy", vec![0.0; 64_000]);
    let points = |mask: &str| {
        let line =
            format!("feature image.npy -o b.npy --feature edges --threshold 0.5 {mask} --json");
        let report = json(&run_args(dir, &line.split_whitespace().collect::<Vec<_>>()));
        report["points"].as_u64().unwrap()
    };
    let without = points("");
    assert!(without > 1000, "{without}");
    assert_eq!(points("--mask salt.npy"), 0);
    assert_eq!(points("--mask small.npy"), without);
    let other = Image::new([40, 40, 2], vec![0.0; 3200], Geometry::default());
    atomesh::image::formats::write(&dir.join("other.npy"), &other).unwrap();
    let line = "feature image.npy -o b.npy --mask other.npy";
    let error = expect_refusal(dir, &line.split(' ').collect::<Vec<_>>());
    assert!(
        error.contains("other.npy: has other samples than image.npy"),
        "{error}"
    );
}

#[test]
fn names_of_an_earlier_interpretation_last() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let run = |line: &str| run_args(dir, &line.split_whitespace().collect::<Vec<_>>());
    run("synth amplitude -o image.vti --dims 56,64,48 --count 1 --rng-seed 3 --quiet");
    for distance in ["5", "7"] {
        run(&format!(
            "mesh image.vti -o {distance}.vtu --distance {distance} --feature faults+horizons --quiet"
        ));
    }
    // The interpreter gives a name of the field.
    run("surface 5.vtu -o earlier.obj");
    let text = std::fs::read_to_string(dir.join("earlier.obj")).unwrap();
    assert!(text.contains("g fault"), "{text}");
    let fault = text
        .lines()
        .find_map(|line| line.strip_prefix("g fault"))
        .unwrap();
    let text = text.replace(&format!("g fault{fault}\n"), "g Main\n");
    std::fs::write(dir.join("earlier.obj"), text).unwrap();
    let line = "surface 7.vtu -o later.vtp --names-from earlier.obj --mesh-out named.vtu --json";
    let report = json(&run(line));
    let names = |report: &Value| -> Vec<String> {
        let surfaces = report["surfaces"].as_array().unwrap().iter();
        surfaces
            .filter_map(|s| s["name"].as_str().map(str::to_string))
            .collect()
    };
    let later = names(&report);
    assert!(later.contains(&"Main".to_string()), "{later:?}");
    let distinct: std::collections::BTreeSet<&String> = later.iter().collect();
    assert_eq!(distinct.len(), later.len(), "{later:?}");
    // The mesh with these names gives the same surfaces, and other verbs know them.
    assert_eq!(
        names(&json(&run("surface named.vtu -o s.ts --json"))),
        later
    );
    let text = std::fs::read_to_string(dir.join("s.ts")).unwrap();
    assert!(text.contains("name:Main"));
    run("export named.vtu --to msh -o named.msh --quiet");
    let text = std::fs::read(dir.join("named.msh")).unwrap();
    assert!(text.windows(6).any(|bytes| bytes == b"\"Main\""));
    let error = expect_refusal(
        dir,
        &["surface", "7.vtu", "-o", "s.vtp", "--names-from", "no"],
    );
    assert!(error.contains("no"), "{error}");
}
