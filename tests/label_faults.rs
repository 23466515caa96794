//! Faults in images of labels, blocks by layers: what parts two labels is closed by its name or by the pair of its
//! regions, in `flow` and in exports alike.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{write_npy, expect_refusal, run};
use serde_json::Value;

const DIMS: [usize; 3] = [30, 16, 20];

/// Two blocks of three layers, parted by a steep fault: labels 1 to 3 and 11 to 13.
fn label([x, y, z]: [usize; 3]) -> f32 {
    let beyond = x as f32 > 15.0 + 0.3 * (z as f32 - 10.0) + 0.1 * y as f32;
    let depth = z as f32 - if beyond { 4.0 } else { 0.0 };
    let layer = if depth < 5.0 {
        1.0
    } else if depth < 11.0 {
        2.0
    } else {
        3.0
    };
    layer + if beyond { 10.0 } else { 0.0 }
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

/// The faults of a report, by name.
fn faults(report: &Value) -> Vec<(String, f64)> {
    let faults = report["by_fault"].as_array().unwrap().iter();
    let named = faults.map(|fault| {
        let name = fault["name"].as_str().unwrap().to_string();
        (name, fault["multiplier"].as_f64().unwrap())
    });
    named.collect()
}

/// The rate that enters at the first side.
fn rate(report: &Value) -> f64 {
    report["exchange"][0]["rate"].as_f64().unwrap().abs()
}

const THROUGH: &str = "-o out.vtu --pressure xmin=1e5 --pressure xmax=0";

#[test]
fn a_fault_between_blocks_of_labels_closes_by_pairs_and_patterns() {
    let folder = folder();
    let folder = folder.path();
    for mesh in ["cells.vtu", "tets.vtu"] {
        let open = json(folder, &format!("flow {mesh} {THROUGH} --faults open"));
        let usual = json(folder, &format!("flow {mesh} {THROUGH}"));
        assert_eq!(usual["by_fault"], open["by_fault"], "nothing is a fault");
        assert_eq!(rate(&usual), rate(&open));
        for how in [
            "--faults closed --barriers ?/1?",
            "--faults closed --barriers interface_?_1?",
            "--faults open --fault-multiplier ?/1?:0",
        ] {
            let closed = json(folder, &format!("flow {mesh} {THROUGH} {how}"));
            let passed = rate(&closed) / rate(&open);
            assert!(passed <= 1e-12, "{mesh} {how}: {passed}");
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
        // The last that picks a surface holds.
        let some = format!("flow {mesh} {THROUGH} --faults open");
        let some = json(
            folder,
            &format!(
                "{some} --fault-multiplier *:0 --fault-multiplier *_1*:0.5 --fault-multiplier 11/1:0.25"
            ),
        );
        let of = |name: &str| {
            faults(&some)
                .iter()
                .find(|fault| fault.0 == name)
                .unwrap()
                .1
        };
        assert_eq!(
            ["interface_1_11", "interface_1_2", "interface_2_3"].map(of),
            [0.25, 0.5, 0.0]
        );
    }
}

#[test]
fn all_formats_have_the_names_of_the_table() {
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

    // The faces between blocks, and no others, are closed: the model has two parts, whatever the format.
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    for (to, name) in [("opm", "A.DATA"), ("mrst", "a.mat"), ("grdecl", "B.GRDECL")] {
        let export = format!("export cells.vtu --to {to} -o {name} {rock}");
        let open = json(folder, &export);
        let closed = json(folder, &format!("{export} --faults closed --barriers ?/1?"));
        // But for cells that the surfaces of blocks cut off one by one.
        let large = |report: &Value| {
            let parts = report["checks"]["compartments"].as_array().unwrap().iter();
            parts.filter(|part| part[1].as_u64().unwrap() > 5).count()
        };
        assert_eq!([large(&open), large(&closed)], [1, 2]);
        let low = closed["checks"]["transmissibility"][0].as_f64().unwrap();
        assert_eq!(low, 0.0);
    }
    let text = std::fs::read_to_string(folder.join("B.GRDECL")).unwrap();
    let flt = text.split_once("MULTFLT\n").unwrap().1;
    assert!(flt.contains(" 'I2_11' 0 /"), "{flt}");
    assert!(!flt.contains("I1_2'") && text.contains(" 'I1_2' "), "{flt}");
    assert!(!text.contains("FAULT1"));
}

#[test]
fn what_is_multiplied_is_what_lies_between_the_regions() {
    let folder = folder();
    let folder = folder.path();
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    let connections = |name: &str, more: &str| -> Vec<(Vec<String>, f64)> {
        run(
            folder,
            &format!("export cells.vtu --to opm -o {name}.DATA {rock} --quiet {more}"),
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
    let fip = |name: &str| -> Vec<i64> {
        let text = std::fs::read_to_string(folder.join(format!("{name}.DATA"))).unwrap();
        let block = text.split_once("\nFIPNUM\n").unwrap().1;
        let block = block.split_once('/').unwrap().0;
        block
            .split_whitespace()
            .map(|w| w.parse().unwrap())
            .collect()
    };
    let regions = fip("H");
    // Decks omit what is less than 1e-6.
    for (cells, open) in open.iter().filter(|(_, t)| *t > 2.1e-6) {
        let half = half[cells];
        let [a, b] = [0, 3].map(|at| regions[cells[at].parse::<usize>().unwrap() - 1] / 10);
        let want = if a == b { 1.0 } else { 0.5 };
        assert!(
            (half / open - want).abs() < 1e-9,
            "{cells:?}: {}",
            half / open
        );
    }
}

#[test]
fn what_picks_nothing_is_refused_with_the_names() {
    let folder = folder();
    let folder = folder.path();
    let rock =
        "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 900";
    let none = "matches no surface";
    for (option, place, problem) in [
        ("--fault-multiplier 99:0", "--fault-multiplier 99", none),
        (
            "--fault-multiplier fault1:0",
            "--fault-multiplier fault1",
            none,
        ),
        ("--fault-multiplier 1/13:0", "--fault-multiplier 1/13", none),
        (
            "--faults closed --barriers nothing*",
            "--barriers nothing*",
            none,
        ),
        ("--faults closed --barriers 1,77", "--barriers 77", none),
        (
            "--faults closed --barriers horizons",
            "--barriers horizons",
            none,
        ),
        (
            "--faults 0.01",
            "--faults",
            "is for faults, but no surface is one",
        ),
    ] {
        for line in [
            format!("flow cells.vtu {THROUGH} {option}"),
            format!("export tets.vtu --to opm -o a.DATA {rock} {option}"),
            format!("export cells.vtu --to grdecl -o a.GRDECL {rock} {option}"),
        ] {
            let said = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
            let want = format!("error: {place}: {problem}: the mesh has interface_1_2, ");
            assert!(said.starts_with(&want), "{line}\n{said}");
        }
    }
}

#[test]
fn regions_of_an_image_part_faults_by_pairs_too() {
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
    let parts = |more: &str| {
        let said = json(folder, &format!("{export} {more}"));
        said["checks"]["compartments"].as_array().unwrap().len()
    };
    assert_eq!(parts(""), 1);
    assert_eq!(parts("--fault-multiplier fault1:0"), 2);
    assert_eq!(
        parts("--fault-multiplier 0/1:0 --fault-multiplier fault1:0"),
        4
    );
}
