//! Tests `atomesh export`: wells that closed faults separate, inactive cells, and decks that are
//! not overwritten.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    atomesh, expect_refusal, numbers, run, run_simulator, run_validator, write_npy,
};
use serde_json::Value;

const DIMS: [usize; 3] = [40, 20, 20];
const ROCK: &str =
    "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --depth-at-top 2000";

/// Returns a folder with `cells.vtu`, the mesh of a plane across the whole box at x = 20.3.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("sheet.npy"), DIMS, |[x, ..]| {
        (-((x as f32 - 20.3) / 1.2).powi(2)).exp()
    });
    run(
        folder.path(),
        "mesh sheet.npy --feature ridges --cells voronoi --distance 5 --quiet -o cells.vtu",
    );
    folder
}

/// Runs an export and returns its standard error.
fn export_stderr(folder: &Path, line: &str) -> String {
    let words: Vec<&str> = line.split_whitespace().collect();
    let output = atomesh(folder).args(words).output().unwrap();
    let export_stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{line}\n{export_stderr}");
    export_stderr
}

#[test]
fn wells_separated_by_or_crossing_closed_faults_get_a_note_each() {
    let folder = folder();
    let folder = folder.path();
    std::fs::write(
        folder.join("H.csv"),
        "x,y,z,radius\n5,10,10,0.1\n35,10,11,0.1\n",
    )
    .unwrap();
    std::fs::write(folder.join("V.csv"), "20.3,10,2,0.1\n20.3,10,18,0.1\n").unwrap();
    let notes = |wells: &str, faults: &str| -> Vec<String> {
        let line = format!("export cells.vtu --to opm -o Y.DATA {ROCK} --faults {faults} {wells}");
        let stderr = export_stderr(folder, &line);
        let notes = stderr
            .lines()
            .filter_map(|line| line.strip_prefix("note: "));
        let others = ["of the well's", "numbers of regions begin with 1"];
        let notes = notes.filter(|note| !others.iter().any(|other| note.contains(other)));
        notes.map(str::to_string).collect()
    };
    let separate_wells = "--injector 10,10,10:20 --producer 30,10,10:190";
    let result = notes(separate_wells, "closed");
    assert_eq!(result.len(), 1, "{result:?}");
    assert!(
        result[0].starts_with("injector I1: closed faults separate its compartment"),
        "{result:?}"
    );
    assert!(notes(separate_wells, "0.01").is_empty());
    let three_wells = format!("{separate_wells} --producer 5,5,5:190");
    let result = notes(&three_wells, "closed");
    assert_eq!(result.len(), 1, "{result:?}");
    assert!(
        result[0].starts_with("producer P2: closed faults separate its compartment"),
        "{result:?}"
    );

    let result = notes("--producer H.csv:190", "closed");
    assert_eq!(result.len(), 1, "{result:?}");
    assert!(
        result[0].starts_with("well H: crosses the closed fault1 between cells "),
        "{result:?}"
    );
    assert!(notes("--producer H.csv:190", "open").is_empty());

    let result = notes("--producer V.csv:190", "closed");
    assert!(
        result
            .iter()
            .any(|note| note.starts_with("well V: ") && note.contains("closed fault1")),
        "{result:?}"
    );
    assert!(notes("--producer V.csv:190", "0.5").is_empty());
}

#[test]
fn rock_without_pores_or_permeability_is_inactive() {
    let folder = folder();
    let folder = folder.path();
    // Only the upper half has rock.
    write_npy(&folder.join("half.npy"), DIMS, |[_, _, z]| {
        f32::from(u8::from(z >= 10))
    });
    std::fs::write(folder.join("phi.csv"), "0,0\n1,0.2\n").unwrap();
    std::fs::write(folder.join("k.csv"), "0,0\n1,100\n").unwrap();
    for rock in [
        "--porosity phi.csv --permeability 100",
        "--porosity 0.2 --permeability k.csv",
        "--porosity phi.csv --permeability k.csv",
    ] {
        for (to, name) in [
            ("opm", "A.DATA"),
            ("grdecl", "B.GRDECL"),
            ("mrst", "a.mat"),
            ("darts", "a.conn"),
        ] {
            let line = format!(
                "export cells.vtu --to {to} -o {name} --down z --depth-at-top 900 --permeability-unit mD --region half.npy {rock}"
            );
            let notes = export_stderr(folder, &line);
            assert!(
                notes.contains("cells are inactive: their porosity or permeability is 0"),
                "{line}\n{notes}"
            );
            let report: Value =
                serde_json::from_str(&run(folder, &format!("{line} --quiet --json"))).unwrap();
            assert_eq!(
                report["checks"]["compartments"].as_array().unwrap().len(),
                1,
                "{line}"
            );
        }
        let deck = std::fs::read_to_string(folder.join("A.DATA")).unwrap();
        let active = deck
            .split_once("\nACTNUM\n")
            .unwrap()
            .1
            .split_once('/')
            .unwrap()
            .0;
        let active: Vec<&str> = active.split_whitespace().collect();
        let dead = active.iter().filter(|n| **n == "0").count();
        assert!(
            dead > active.len() / 4 && dead < active.len() * 3 / 4,
            "{dead}"
        );
        let nnc = deck.split_once("\nNNC\n").unwrap().1;
        for line in nnc.lines().take_while(|line| *line != "/") {
            let words: Vec<&str> = line.split_whitespace().collect();
            for column in [0, 3] {
                assert_eq!(
                    active[words[column].parse::<usize>().unwrap() - 1],
                    "1",
                    "{line}"
                );
            }
        }
    }
    let line = "export cells.vtu --to opm -o A.DATA --down z --permeability-unit mD --depth-at-top 900 --porosity 0 --permeability 1";
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(
        error.contains("is zero or below a cut-off in every cell"),
        "{error}"
    );
    let line = "export cells.vtu --to opm -o A.DATA --down z --permeability-unit mD --depth-at-top 900 --region half.npy --porosity phi.csv --permeability 1 --producer 10,10,3:90";
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(error.contains("lies in inactive rock only"), "{error}");
}

#[test]
fn a_deck_of_connections_and_a_corner_point_deck_do_not_overwrite_each_other() {
    let folder = folder();
    let folder = folder.path();
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    run(
        folder,
        &format!("export cells.vtu --to opm -o A.DATA {ROCK} --quiet"),
    );
    let deck = read("A.DATA");
    let grid = format!("export cells.vtu --to grdecl -o A.GRDECL {ROCK}");
    let notes = export_stderr(folder, &grid);
    assert!(notes.contains("A.DATA is there already"), "{notes}");
    assert_eq!(read("A.DATA"), deck);
    assert!(read("A-grid.DATA").contains("'A.GRDECL'"));
    // An export replaces a deck of its own.
    run(
        folder,
        &format!("export cells.vtu --to grdecl -o B.GRDECL {ROCK} --quiet"),
    );
    let grid = read("B.DATA");
    run(
        folder,
        &format!("export cells.vtu --to grdecl -o B.GRDECL {ROCK} --quiet --grid 4,3,2"),
    );
    assert_ne!(read("B.DATA"), grid);
    let line = format!("export cells.vtu --to opm -o B.DATA {ROCK}");
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(
        error.contains("B.DATA: is the deck of a corner-point grid"),
        "{error}"
    );
}

#[test]
#[ignore = "needs OPM Flow, resfo and SciPy: make test-all"]
fn opm_flow_runs_decks_with_inactive_cells() {
    let folder = folder();
    let folder = folder.path();
    write_npy(&folder.join("half.npy"), DIMS, |[_, _, z]| {
        f32::from(u8::from(z >= 10))
    });
    std::fs::write(folder.join("phi.csv"), "0,0\n1,0.2\n").unwrap();
    std::fs::write(folder.join("k.csv"), "0,0\n1,100\n").unwrap();
    let rock = "--porosity phi.csv --permeability k.csv --permeability-unit mD --region half.npy --down z --depth-at-top 2000 --quiet";
    let wells = "--injector 10,10,15:5 --producer 30,10,15:150";
    for (to, name) in [("opm", "A.DATA"), ("grdecl", "B.GRDECL")] {
        run(
            folder,
            &format!("export cells.vtu --to {to} -o {name} {rock} {wells}"),
        );
        let case = &name[..1];
        let mut flow = Command::new("flow");
        flow.current_dir(folder).args([
            format!("{case}.DATA"),
            format!("--output-dir={case}"),
            "--threads-per-process=1".into(),
        ]);
        run_simulator(&mut flow);
        let out = folder.join(case);
        let result = run_validator(
            "resfo and SciPy",
            "compartments.py",
            &[out.as_os_str(), OsStr::new(case)],
        );
        let porv = numbers(&result["porv"]);
        assert_eq!(porv.len(), 1, "{porv:?}");
        let half = 0.2 * 39.0 * 19.0 * 9.5;
        assert!((porv[0] / half - 1.0).abs() < 0.1, "{porv:?} {half}");
    }
}

/// Returns the porosities of a deck.
fn porosities(deck: &Path) -> Vec<f64> {
    let deck = std::fs::read_to_string(deck).unwrap();
    let values = deck.split("\nPORO\n").nth(1).unwrap();
    let values = values.split('/').next().unwrap().split_whitespace();
    values.map(|word| word.parse().unwrap()).collect()
}

/// Writes an image of the box of [`folder`], with its own position and the values of `value` at z.
fn write_placed(path: &Path, origin: [f64; 3], spacing: [f64; 3], value: impl Fn(f64) -> f32) {
    use atomesh::image::{Geometry, Image, formats};
    let [nx, ny, nz] = DIMS;
    let z = |i: usize| origin[2] + spacing[2] * (i / (nx * ny)) as f64;
    let samples = (0..nx * ny * nz).map(|i| value(z(i))).collect();
    let image = Image::new(DIMS, samples, Geometry::with_spacing(origin, spacing));
    formats::write(path, &image).unwrap();
}

const PLACED: &str = "--spacing 25,25,20 --origin 450000,6780000,-2000 --unit m";

#[test]
fn images_with_as_many_samples_as_the_mesh_are_placed_by_their_coordinates() {
    let folder = folder();
    let folder = folder.path();
    run(
        folder,
        &format!(
            "mesh sheet.npy {PLACED} --feature ridges --cells voronoi --distance 5 --quiet -o placed.vtu"
        ),
    );
    let (origin, spacing) = ([450_000.0, 6_780_000.0, -2000.0], [25.0, 25.0, 20.0]);
    let porosity = |z: f64| (0.05 + 0.01 * (z + 2000.0) / 20.0) as f32;
    write_npy(&folder.join("array.npy"), DIMS, |[.., z]| {
        porosity(20.0 * z as f64 - 2000.0)
    });
    let down = [origin[0], origin[1], 1620.0];
    write_placed(&folder.join("same.vti"), origin, spacing, porosity);
    write_placed(&folder.join("down.vti"), down, spacing, |z| porosity(-z));
    let top = [origin[0], origin[1], -1620.0];
    let falling = [25.0, 25.0, -20.0];
    write_placed(&folder.join("falling.vti"), top, falling, porosity);
    let moved = [460_000.0, origin[1], origin[2]];
    write_placed(&folder.join("moved.vti"), moved, spacing, porosity);
    let dense = [12.5, 12.5, 10.0];
    write_placed(&folder.join("dense.vti"), origin, dense, porosity);
    let export = |image: &str| {
        format!(
            "export placed.vtu --to opm -o A.DATA --porosity {image} --permeability 100 --permeability-unit mD"
        )
    };
    run(folder, &format!("{} --quiet", export("array.npy")));
    let expected = porosities(&folder.join("A.DATA"));
    for image in ["same.vti", "down.vti", "falling.vti"] {
        run(folder, &format!("{} --quiet", export(image)));
        let values = porosities(&folder.join("A.DATA"));
        assert_eq!(values.len(), expected.len());
        for (value, expected) in values.iter().zip(&expected) {
            assert!(
                (value - expected).abs() < 1e-5,
                "{image}: {value} {expected}"
            );
        }
    }
    std::fs::remove_file(folder.join("A.DATA")).unwrap();
    for image in ["moved.vti", "dense.vti"] {
        let line = export(image);
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(
            error.contains(image)
                && error.contains("does not cover the mesh: it lies at x 4")
                && error.contains("the mesh at x 450000 to 450975"),
            "{error}"
        );
    }
}

#[test]
fn masks_with_a_position_are_placed_by_it() {
    let folder = folder();
    let folder = folder.path();
    let (origin, spacing) = ([450_000.0, 6_780_000.0, -2000.0], [25.0, 25.0, 20.0]);
    let flag = |z: f64| f32::from(u8::from(z < -1850.0));
    write_npy(&folder.join("mask.npy"), DIMS, |[.., z]| {
        flag(20.0 * z as f64 - 2000.0)
    });
    let down = [origin[0], origin[1], 1620.0];
    write_placed(&folder.join("down.vti"), down, spacing, |z| flag(-z));
    let moved = [455_000.0, origin[1], origin[2]];
    write_placed(&folder.join("moved.vti"), moved, spacing, flag);
    let line = |option: &str, mask: &str| {
        format!("convert sheet.npy out.npy {PLACED} --{option} {mask} --quiet")
    };
    let read = || std::fs::read(folder.join("out.npy")).unwrap();
    for option in ["mask", "inside"] {
        run(folder, &line(option, "mask.npy"));
        let expected = read();
        run(folder, &line(option, "down.vti"));
        assert!(read() == expected, "{option}");
        std::fs::remove_file(folder.join("out.npy")).unwrap();
        let words = line(option, "moved.vti").replace(" --quiet", "");
        let error = expect_refusal(folder, &words.split_whitespace().collect::<Vec<_>>());
        assert!(
            error.contains("moved.vti: lies at x 455000 to 455975"),
            "{error}"
        );
    }
}
