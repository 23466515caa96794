//! Tests faults in label images with blocks and layers: interfaces between labels are closed by
//! name or by the pair of regions, in `flow` and in exports.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{expect_refusal, run, write_npy};
use serde_json::Value;

const DIMS: [usize; 3] = [30, 16, 20];

/// Returns the label of a sample: two blocks of three layers, separated by a steep fault, with
/// labels 1 to 3 and 11 to 13.
fn label([x, y, z]: [usize; 3]) -> f32 {
    let is_beyond_fault = x as f32 > 15.0 + 0.3 * (z as f32 - 10.0) + 0.1 * y as f32;
    let depth = z as f32 - if is_beyond_fault { 4.0 } else { 0.0 };
    let layer = if depth < 5.0 {
        1.0
    } else if depth < 11.0 {
        2.0
    } else {
        3.0
    };
    layer + if is_beyond_fault { 10.0 } else { 0.0 }
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("labels.npy"), DIMS, label);
    let mesh = "mesh labels.npy --feature labels --distance 5 --quiet -o";
    run(folder.path(), &format!("{mesh} cells.vtu --cells voronoi"));
    run(folder.path(), &format!("{mesh} tets.vtu"));
    folder
}

fn json(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("{line} --json --quiet"))).unwrap()
}

/// Returns the names and multipliers of the faults of a report.
fn faults(report: &Value) -> Vec<(String, f64)> {
    let faults = report["by_fault"].as_array().unwrap().iter();
    let named = faults.map(|fault| {
        let name = fault["name"].as_str().unwrap().to_string();
        (name, fault["multiplier"].as_f64().unwrap())
    });
    named.collect()
}

/// Returns the absolute rate through the first side.
fn rate(report: &Value) -> f64 {
    report["exchange"][0]["rate"].as_f64().unwrap().abs()
}

const FLOW_OPTIONS: &str = "-o out.vtu --pressure xmin=1e5 --pressure xmax=0";

#[test]
fn a_fault_between_blocks_of_labels_closes_by_pairs_and_patterns() {
    let folder = folder();
    let folder = folder.path();
    for mesh in ["cells.vtu", "tets.vtu"] {
        let open = json(folder, &format!("flow {mesh} {FLOW_OPTIONS} --faults open"));
        let default = json(folder, &format!("flow {mesh} {FLOW_OPTIONS}"));
        assert_eq!(default["by_fault"], open["by_fault"], "nothing is a fault");
        assert_eq!(rate(&default), rate(&open));
        for options in [
            "--faults closed --barriers ?/1?",
            "--faults closed --barriers interface_?_1?",
            "--faults open --fault-multiplier ?/1?:0",
        ] {
            let closed = json(folder, &format!("flow {mesh} {FLOW_OPTIONS} {options}"));
            let ratio = rate(&closed) / rate(&open);
            assert!(ratio <= 1e-12, "{mesh} {options}: {ratio}");
            let named = faults(&closed);
            assert!(named.len() >= 4, "{named:?}");
            for (name, multiplier) in &named {
                let blocks = name.strip_prefix("interface_").unwrap().split_once('_');
                let (a, b) = blocks.unwrap();
                assert!(
                    a.len() == 1 && b.len() == 2 && *multiplier == 0.0,
                    "{named:?}"
                );
            }
        }
        // If several options select a surface, the last one holds.
        let command = format!("flow {mesh} {FLOW_OPTIONS} --faults open");
        let report = json(
            folder,
            &format!(
                "{command} --fault-multiplier *:0 --fault-multiplier *_1*:0.5 --fault-multiplier 11/1:0.25"
            ),
        );
        let multiplier_of = |name: &str| {
            faults(&report)
                .iter()
                .find(|fault| fault.0 == name)
                .unwrap()
                .1
        };
        assert_eq!(
            ["interface_1_11", "interface_1_2", "interface_2_3"].map(multiplier_of),
            [0.25, 0.5, 0.0]
        );
    }
}

#[test]
fn all_formats_use_the_names_of_the_surface_table() {
    let folder = folder();
    let folder = folder.path();
    let table = json(folder, "surface cells.vtu -o s.vtp");
    let mut names = Vec::new();
    for surface in table["surfaces"].as_array().unwrap() {
        assert_eq!(surface["kind"], "interface");
        names.push(surface["name"].as_str().unwrap().to_string());
    }
    assert!(names.contains(&"interface_1_2".to_string()), "{names:?}");
    assert!(names.contains(&"interface_3_13".to_string()), "{names:?}");
    run(folder, "export cells.vtu --to obj -o a.obj --quiet");
    let text = std::fs::read_to_string(folder.join("a.obj")).unwrap();
    let mut groups: Vec<&str> = (text.lines())
        .filter_map(|line| line.strip_prefix("g "))
        .filter(|name| !name.ends_with("min") && !name.ends_with("max"))
        .collect();
    groups.sort_unstable();
    names.sort_unstable();
    assert_eq!(groups, names);

    // Only the faces between blocks are closed: the model has two compartments in every format.
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    for (to, name) in [("opm", "A.DATA"), ("mrst", "a.mat"), ("grdecl", "B.GRDECL")] {
        let export = format!("export cells.vtu --to {to} -o {name} {rock}");
        let open = json(folder, &export);
        let closed = json(folder, &format!("{export} --faults closed --barriers ?/1?"));
        // Ignore single cells that the surfaces of blocks cut off.
        let count_large = |report: &Value| {
            let compartments = report["checks"]["compartments"].as_array().unwrap().iter();
            compartments
                .filter(|compartment| compartment[1].as_u64().unwrap() > 5)
                .count()
        };
        assert_eq!([count_large(&open), count_large(&closed)], [1, 2]);
        let low = closed["checks"]["transmissibility"][0].as_f64().unwrap();
        assert_eq!(low, 0.0);
    }
    let text = std::fs::read_to_string(folder.join("B.GRDECL")).unwrap();
    let multipliers = text.split_once("MULTFLT\n").unwrap().1;
    assert!(multipliers.contains(" 'I2_11' 0 /"), "{multipliers}");
    assert!(
        !multipliers.contains("I1_2'") && text.contains(" 'I1_2' "),
        "{multipliers}"
    );
    assert!(!text.contains("FAULT1"));
}

#[test]
fn multipliers_apply_to_connections_between_the_regions() {
    let folder = folder();
    let folder = folder.path();
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    let connections = |name: &str, options: &str| -> Vec<(Vec<String>, f64)> {
        run(
            folder,
            &format!("export cells.vtu --to opm -o {name}.DATA {rock} --quiet {options}"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{name}.DATA"))).unwrap();
        let nnc = text.split_once("\nNNC\n").unwrap().1;
        let rows = nnc.lines().take_while(|line| *line != "/");
        let row = |line: &str| {
            let words: Vec<String> = line.split_whitespace().map(str::to_string).collect();
            (words[..6].to_vec(), words[6].parse().unwrap())
        };
        rows.map(row).collect()
    };
    let open = connections("O", "");
    let half = connections("H", "--fault-multiplier ?/1?:0.5");
    let half: BTreeMap<Vec<String>, f64> = half.into_iter().collect();
    let region_numbers = |name: &str| -> Vec<i64> {
        let text = std::fs::read_to_string(folder.join(format!("{name}.DATA"))).unwrap();
        let block = text.split_once("\nFIPNUM\n").unwrap().1;
        let block = block.split_once('/').unwrap().0;
        block
            .split_whitespace()
            .map(|w| w.parse().unwrap())
            .collect()
    };
    let regions = region_numbers("H");
    // Decks omit transmissibilities below 1e-6.
    for (cells, open) in open.iter().filter(|(_, t)| *t > 2.1e-6) {
        let half = half[cells];
        let [a, b] = [0, 3].map(|column| regions[cells[column].parse::<usize>().unwrap() - 1] / 10);
        let expected = if a == b { 1.0 } else { 0.5 };
        assert!(
            (half / open - expected).abs() < 1e-9,
            "{cells:?}: {}",
            half / open
        );
    }
}

#[test]
fn selections_without_a_match_are_refused_with_the_names() {
    let folder = folder();
    let folder = folder.path();
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    let no_match = "matches no surface";
    for (option, place, problem) in [
        ("--fault-multiplier 99:0", "--fault-multiplier 99", no_match),
        (
            "--fault-multiplier fault1:0",
            "--fault-multiplier fault1",
            no_match,
        ),
        (
            "--fault-multiplier 1/13:0",
            "--fault-multiplier 1/13",
            no_match,
        ),
        (
            "--faults closed --barriers nothing*",
            "--barriers nothing*",
            no_match,
        ),
        ("--faults closed --barriers 1,77", "--barriers 77", no_match),
        (
            "--faults closed --barriers horizons",
            "--barriers horizons",
            no_match,
        ),
        (
            "--faults 0.01",
            "--faults",
            "is for faults, but no surface is one",
        ),
    ] {
        for line in [
            format!("flow cells.vtu {FLOW_OPTIONS} {option}"),
            format!("export tets.vtu --to opm -o a.DATA {rock} {option}"),
            format!("export cells.vtu --to grdecl -o a.GRDECL {rock} {option}"),
        ] {
            let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
            let expected = format!("error: {place}: {problem}: the mesh has interface_1_2, ");
            assert!(error.starts_with(&expected), "{line}\n{error}");
        }
    }
}

#[test]
fn regions_of_an_image_divide_faults_by_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("sheet.npy"), DIMS, |[x, ..]| {
        (-((x as f32 - 15.3) / 1.2).powi(2)).exp()
    });
    write_npy(&folder.join("layers.npy"), DIMS, |[_, _, z]| {
        f32::from(u8::from(z > 9))
    });
    run(
        folder,
        "mesh sheet.npy --feature ridges --cells voronoi --distance 5 --quiet -o cells.vtu",
    );
    let export = "export cells.vtu --to mrst -o a.mat --down z --region layers.npy --permeability 1 --permeability-unit mD";
    let compartment_count = |options: &str| {
        let report = json(folder, &format!("{export} {options}"));
        report["checks"]["compartments"].as_array().unwrap().len()
    };
    assert_eq!(compartment_count(""), 1);
    assert_eq!(compartment_count("--fault-multiplier fault1:0"), 2);
    assert_eq!(
        compartment_count("--fault-multiplier 0/1:0 --fault-multiplier fault1:0"),
        4
    );
}
