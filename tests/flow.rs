//! `atomesh flow` as a user runs it.
#![cfg(feature = "tetgen")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on has failed"
)]

mod common;

use std::path::Path;

use atomesh::export::{AnyMesh, MeshFile, read_any_vtu, read_vtu};
use atomesh::io::vtk::VtkFile;
use common::{npy, refused, sheet, succeed};
use serde_json::Value;

const DIMS: [usize; 3] = [40, 36, 32];

/// A folder with a mesh of a sheet across the box, `mesh.vtu`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    npy(&folder.path().join("sheet.npy"), DIMS, sheet(DIMS));
    let mesh = [
        "mesh",
        "sheet.npy",
        "-o",
        "mesh.vtu",
        "--distance",
        "6",
        "--quiet",
    ];
    succeed(folder.path(), &mesh);
    folder
}

fn flow(folder: &Path, options: &[&str]) -> Value {
    let all = [
        &["flow", "mesh.vtu", "-o", "flow.vtu", "--quiet", "--json"],
        options,
    ]
    .concat();
    serde_json::from_str(&succeed(folder, &all)).unwrap()
}

fn through(folder: &Path, options: &[&str]) -> f64 {
    let sides = ["--pressure", "xmin=2e5", "--pressure", "xmax=1e5"];
    let said = flow(folder, &[&sides, options].concat());
    assert!(said["figures"]["worst_balance"].as_f64().unwrap() < 1e-10);
    assert!(said["figures"]["total_balance"].as_f64().unwrap() < 1e-10);
    said["figures"]["throughput"].as_f64().unwrap()
}

fn numbers(file: &MeshFile, name: &str) -> Vec<f64> {
    let arrays = file.point_data.iter().chain(&file.cell_data);
    arrays
        .into_iter()
        .find(|a| a.name == name)
        .unwrap()
        .values
        .to_f64()
}

#[test]
fn linear_pressure_is_exact_on_an_optimised_mesh() {
    let folder = folder();
    let rate = through(
        folder.path(),
        &[
            "--faults",
            "open",
            "--permeability",
            "2e-13,1e-12,3e-15",
            "--viscosity",
            "5e-4",
        ],
    );
    // k / viscosity * pressure difference * area / length.
    let want = 2e-13 / 5e-4 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / want - 1.0).abs() < 1e-9, "{rate} {want}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    for (p, x) in numbers(&file, "pressure").iter().zip(&file.mesh.nodes) {
        let exact = 2e5 - 1e5 * x[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-10, "{p} {exact}");
    }
    let u = want / (35.0 * 31.0);
    for velocity in numbers(&file, "velocity").chunks(3) {
        assert!((velocity[0] / u - 1.0).abs() < 1e-9);
        assert!(velocity[1].abs() + velocity[2].abs() < 1e-8 * u);
    }
}

#[test]
fn the_more_a_fault_resists_the_less_flows() {
    let folder = folder();
    let rates: Vec<f64> = ["open", "0.9", "0.1", "1e-3", "closed"]
        .map(|faults| through(folder.path(), &["--faults", faults]))
        .into();
    assert!(rates.windows(2).all(|pair| pair[1] < pair[0]), "{rates:?}");
    assert!(rates[3] < 0.2 * rates[0], "{rates:?}");
    // The sheet parts the box: closed, nothing gets across.
    assert!(rates[4] < 1e-9 * rates[0], "{rates:?}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    let nodes = numbers(&file, "node");
    let doubled = nodes
        .iter()
        .enumerate()
        .filter(|(i, node)| **node != *i as f64)
        .count();
    assert!(doubled > 20);
    assert!(numbers(&file, "fault_rate").iter().all(|rate| *rate == 0.0));
    assert_eq!(numbers(&file, "atom_kind").len(), file.mesh.nodes.len());

    // A layer twice as thick resists about twice as much as long as it is what resists most.
    let thin = through(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.1"],
    );
    let thick = through(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.2"],
    );
    assert!(thick < thin, "{thick} {thin}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    // What one side of a face loses the other one gains.
    let across = numbers(&file, "fault_rate");
    assert!(across.iter().sum::<f64>().abs() < 1e-12 * across.iter().map(|r| r.abs()).sum::<f64>());
}

#[test]
fn two_point_fluxes_are_exact_on_voronoi_cells() {
    let folder = tempfile::tempdir().unwrap();
    npy(&folder.path().join("sheet.npy"), DIMS, sheet(DIMS));
    let mesh = "mesh sheet.npy -o mesh.vtu --distance 6 --align alongside --cells voronoi --quiet";
    succeed(folder.path(), &mesh.split(' ').collect::<Vec<_>>());
    let rate = through(folder.path(), &["--faults", "open"]);
    let want = 1e-13 / 1e-3 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / want - 1.0).abs() < 1e-6, "{rate} {want}");
    let AnyMesh::SpaceCells(file) = read_any_vtu(&folder.path().join("flow.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let found = file
        .cell_data
        .iter()
        .find(|a| a.name == "pressure")
        .unwrap();
    for (p, site) in found.values.to_f64().iter().zip(&file.mesh.sites) {
        let exact = 2e5 - 1e5 * site[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-6, "{p} {exact}");
    }
    assert!(file.mesh.on_feature.iter().any(|on| *on));
    let closed = through(folder.path(), &["--faults", "closed"]);
    assert!(closed < 0.9 * rate, "{closed} {rate}");
    // The third coordinate is missing.
    let sink = [
        "flow",
        "mesh.vtu",
        "-o",
        "out.vtu",
        "--sink",
        "3,4",
        "--pressure",
        "xmin=0",
    ];
    assert!(refused(folder.path(), &sink).contains("2 coordinates, the mesh 3"));
}

#[test]
fn wells_streamlines_and_the_same_bytes_for_any_number_of_threads() {
    let folder = folder();
    let wells = [
        "--source",
        "8,10,12:0.002",
        "--sink",
        "30,20,15",
        "--sink",
        "8,30,28:0.0005",
    ];
    let run = |threads: &str| {
        let more = [
            "--faults",
            "0.01",
            "--streamlines",
            "lines.vtp",
            "--lines",
            "60",
            "--threads",
            threads,
        ];
        let said = flow(folder.path(), &[&wells[..], &more].concat());
        let files =
            ["flow.vtu", "lines.vtp"].map(|f| std::fs::read(folder.path().join(f)).unwrap());
        (said, files)
    };
    let (said, files) = run("1");
    assert!(run("3").1 == files);
    let rates: Vec<f64> = said["exchange"]
        .as_array()
        .unwrap()
        .iter()
        .map(|e| e["rate"].as_f64().unwrap())
        .collect();
    assert_eq!(rates, [0.002, -0.0015, -0.0005]);
    let lines = VtkFile::read(&folder.path().join("lines.vtp"), "PolyData").unwrap();
    let piece = lines.piece().unwrap();
    assert_eq!(
        lines.numbers::<usize>(piece, "NumberOfLines").unwrap(),
        [60]
    );
}

#[test]
fn permeability_by_region_and_by_cell() {
    let folder = folder();
    let through =
        |options: &[&str]| through(folder.path(), &[&["--faults", "0.1"], options].concat());
    let plain = through(&["--permeability", "3e-13"]);
    std::fs::write(
        folder.path().join("k.csv"),
        "region,k\n# all of it\n0,3e-13\n7,1\n",
    )
    .unwrap();
    assert_eq!(plain, through(&["--permeability", "k.csv"]));
    // Any cell array may be the permeability, here the cells' volumes.
    let by_volume = through(&["--permeability", "volume"]);
    assert!(by_volume > 0.0 && by_volume.is_finite());
}

#[test]
fn what_cannot_be_computed_is_refused_in_one_line() {
    let folder = folder();
    let path = folder.path();
    std::fs::write(path.join("five.csv"), "5,1e-13\n").unwrap();
    std::fs::write(path.join("twice.csv"), "0,1e-13\n0,1e-12\n").unwrap();
    std::fs::write(path.join("words.csv"), "0,1e-13\nsand,1e-12\n").unwrap();
    let ends = ["--pressure", "xmin=1", "--pressure", "xmax=0"];
    let [source, sink] = [["--source", "8,10,12"], ["--sink", "30,20,15"]];
    let cases: &[(&[&str], &[&str])] = &[
        (&[], &["--source", "--pressure"]),
        (
            &["--source", "800,10,12", "--sink", "30,20,15"],
            &["--source 800,10,12", "outside"],
        ),
        (
            &["--source", "8,10", "--pressure", "xmin=0"],
            &["2 coordinates"],
        ),
        (&["--source", "8,10,x"], &["not a number"]),
        (&["--source", "8,10,12:-1"], &["not positive"]),
        (&source, &["balance", "pressure of a side"]),
        (&sink, &["--sink 30,20,15", "no rate"]),
        (
            &[&source[..], &["--sink", "30,20,15:5"]].concat(),
            &["balance"],
        ),
        (&["--pressure", "top=1"], &["no side", "xmin"]),
        (&["--pressure", "xmin"], &["xmin=1e7"]),
        (
            &["--pressure", "xmin=1", "--pressure", "xmin=2"],
            &["twice"],
        ),
        (
            &[&ends[..], &["--faults", "2"]].concat(),
            &["multiplier 2", "0 to 1"],
        ),
        (
            &[&ends[..], &["--faults", "ajar"]].concat(),
            &["--faults ajar", "closed"],
        ),
        (
            &[&ends[..], &["--fault-thickness", "0"]].concat(),
            &["thickness 0"],
        ),
        (
            &[&ends[..], &["--permeability", "-1"]].concat(),
            &["--permeability -1"],
        ),
        (
            &[&ends[..], &["--permeability", "1,2"]].concat(),
            &["--permeability 1,2"],
        ),
        (
            &[&ends[..], &["--permeability", "gone"]].concat(),
            &["gone", "min_dihedral"],
        ),
        (
            &[&ends[..], &["--permeability", "five.csv"]].concat(),
            &["region 0", "for 5"],
        ),
        (
            &[&ends[..], &["--permeability", "twice.csv"]].concat(),
            &["twice.csv:2", "second time"],
        ),
        (
            &[&ends[..], &["--permeability", "words.csv"]].concat(),
            &["words.csv:2", "sand"],
        ),
        (
            &[&ends[..], &["--viscosity", "0"]].concat(),
            &["--viscosity 0"],
        ),
        (
            &[&ends[..], &["--streamlines", "no/such/lines.vtp"]].concat(),
            &["no/such"],
        ),
    ];
    for (options, words) in cases {
        let line = refused(
            path,
            &[&["flow", "mesh.vtu", "-o", "out.vtu"], *options].concat(),
        );
        for word in *words {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    }
    let line = refused(
        path,
        &[&["flow", "sheet.npy", "-o", "out.vtu"], &ends[..]].concat(),
    );
    assert!(line.contains("sheet.npy"), "{line}");
}
