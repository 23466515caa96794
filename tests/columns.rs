//! Tests `atomesh columns`, and simulators on columns.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    SharedFiles, expect_refusal, run, run_simulator, run_validator, write_npy, write_npy_2d,
};
use atomesh::mesh::graph::Graph;
use atomesh::mesh::poly::PolyMesh;
use atomesh::store::{AnyMesh, MeshFile, read_any_vtu};
use serde_json::Value;

const ROCK: &str = "--porosity 0.2 --permeability 100 --permeability-unit mD --quiet";

/// Returns a folder with `map.vtu`, the cells of a map of 60 x 50 samples with one fault across it,
/// and with the depths of horizons `top.npy`, `mid.npy` (part of which coincides with the top) and
/// `base.npy`.
fn folder() -> tempfile::TempDir {
    static FILES: SharedFiles = SharedFiles::new();
    FILES.folder(write_map_and_horizons)
}

fn write_map_and_horizons(path: &Path) {
    write_npy_2d(&path.join("fault.npy"), [60, 50], |[x, y]| {
        (-0.5 * ((0.8 * x as f32 - 0.6 * y as f32 - 9.0) / 1.5).powi(2)).exp()
    });
    run(
        path,
        "mesh fault.npy --cells voronoi --distance 5 --quiet -o map.vtu",
    );
    let top = |x: usize, y: usize| 1000.0 + 0.1 * x as f32 - 0.05 * y as f32;
    write_npy_2d(&path.join("top.npy"), [60, 50], |[x, y]| top(x, y));
    write_npy_2d(&path.join("mid.npy"), [60, 50], |[x, y]| {
        top(x, y) + (0.3 * (x as f32 - 20.0)).max(0.0)
    });
    write_npy_2d(&path.join("base.npy"), [60, 50], |[x, y]| {
        top(x, y) + 20.0 + (0.2 * x as f32).sin()
    });
}

fn cells(path: &Path) -> MeshFile<PolyMesh<3>> {
    match read_any_vtu(path).unwrap() {
        AnyMesh::Polyhedra(file) => file,
        _ => panic!("no polyhedra"),
    }
}

fn map_of(path: &Path) -> PolyMesh<2> {
    match read_any_vtu(path).unwrap() {
        AnyMesh::Polygons(file) => file.mesh,
        _ => panic!("no polygons"),
    }
}

const HORIZONS: &str = "--horizon top.npy --horizon mid.npy --horizon base.npy --layers 2,3";

#[test]
fn columns_between_horizons_suit_every_verb() {
    let folder = folder();
    let folder = folder.path();
    let stdout = run(
        folder,
        &format!("columns map.vtu {HORIZONS} -o cells.vtu --json --quiet"),
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let map = map_of(&folder.join("map.vtu"));
    let columns = map.sites.len();
    assert_eq!(report["columns"].as_u64().unwrap() as usize, columns);
    assert_eq!(report["layers"], serde_json::json!([2, 3]));
    assert_eq!(report["z_grows"], "downwards");
    let missing = report["missing"][0].as_u64().unwrap();
    assert!(missing > 10 && report["missing"][1] == missing && report["missing"][2] == 0);

    let file = cells(&folder.join("cells.vtu"));
    assert_eq!(file.mesh.sites.len(), 5 * columns - 2 * missing as usize);
    // The volume is the integral of the thickness between top and base, which mid does not change.
    let graph = Graph::from_poly(&file.mesh);
    let volume: f64 = graph.volume.iter().sum();
    let expected: f64 = (0..590)
        .map(|i| 20.0 + (0.02 * (f64::from(i) + 0.5)).sin())
        .sum::<f64>()
        * 4.9;
    assert!(
        (volume / expected - 1.0).abs() < 2e-3,
        "{volume} {expected}"
    );
    // Faults are vertical through all layers, on the edges of the map.
    let count_true = |flags: &[bool]| flags.iter().filter(|flag| **flag).count();
    assert!(count_true(&map.on_feature) > 5);
    assert!(count_true(&file.mesh.on_feature) > 3 * count_true(&map.on_feature));

    let valid = run(folder, "validate cells.vtu --json --quiet");
    assert!(
        valid.contains("\"valid\":true") || valid.contains("\"valid\": true"),
        "{valid}"
    );
    let quality = run(folder, "quality cells.vtu --json --quiet");
    let quality: Value = serde_json::from_str(&quality).unwrap();
    assert_eq!(quality["voronoi"]["non_positive_connections"], 0);
    // Validation still finds damage.
    let mut damaged = file.clone();
    damaged.mesh.sites[7][2] += 30.0;
    atomesh::store::write_cells_vtu(&folder.join("damaged.vtu"), &damaged).unwrap();
    let error = expect_refusal(folder, &["validate", "damaged.vtu"]);
    assert!(error.contains("do not contain their site"), "{error}");
    // A site that is moved sideways lies in no column.
    damaged.mesh.sites[7][0] += 30.0;
    atomesh::store::write_cells_vtu(&folder.join("damaged.vtu"), &damaged).unwrap();
    assert!(expect_refusal(folder, &["validate", "damaged.vtu"]).contains("invalid"));

    let flow = "flow cells.vtu -o flow.vtu --pressure xmin=2e5 --pressure xmax=1e5 --faults open";
    run(folder, &format!("{flow} --quiet"));
    let stdout = run(
        folder,
        &format!("export cells.vtu --to openfoam -o case --down z --json {ROCK}"),
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    assert!(
        report["checks"]["volume_error"].as_f64().unwrap() < 1e-12,
        "{report}"
    );
}

/// Writes a map with a fault across it, horizons that are offset by 5 at the fault, and horizons of the
/// same throw at a fault that dips: each is offset at another place.
fn write_offset_horizons(path: &Path) {
    write_map_and_horizons(path);
    let is_beyond = |[x, y]: [usize; 2], shift: f32| 0.8 * x as f32 - 0.6 * y as f32 - 9.0 > shift;
    for (name, z, shift) in [
        ("upright-top", 1000.0, 0.0),
        ("upright-base", 1020.0, 0.0),
        ("dipping-top", 1000.0, -1.6),
        ("dipping-base", 1020.0, 1.6),
    ] {
        write_npy_2d(&path.join(format!("{name}.npy")), [60, 50], |at| {
            z + if is_beyond(at, shift) { 5.0 } else { 0.0 }
        });
    }
}

#[test]
fn offset_horizons_make_cells_of_different_layers_neighbours() {
    static FILES: SharedFiles = SharedFiles::new();
    let folder = FILES.folder(write_offset_horizons);
    let folder = folder.path();
    let map = map_of(&folder.join("map.vtu"));
    let fault_faces = (0..map.inner_face_count()).filter(|&f| map.on_feature[f]);
    let length: f64 = fault_faces.map(|f| map.face_shape(f).area()).sum();
    for fault in ["upright", "dipping"] {
        let horizons = format!("--horizon {fault}-top.npy --horizon {fault}-base.npy");
        let columns = format!("columns map.vtu {horizons} --layers 2 -o {fault}.vtu --quiet");
        let stdout = run(folder, &format!("{columns} --throws 4 --json"));
        let report: Value = serde_json::from_str(&stdout).unwrap();
        // Layers of 10 with a throw of 5: each meets its own layer over 5, and one the other over 5.
        let faces = &report["juxtaposed"];
        let area = |name: &str| faces[name].as_f64().unwrap();
        assert!(
            (area("area") / (15.0 * length) - 1.0).abs() < 1e-6,
            "{fault} {faces} {length}"
        );
        assert!(
            (area("exposed_area") / (10.0 * length) - 1.0).abs() < 1e-6,
            "{fault} {faces}"
        );
        assert_eq!(
            faces["same_layer"],
            2 * faces["other_layer"].as_u64().unwrap()
        );

        let mesh = format!("{fault}.vtu");
        let valid: Value =
            serde_json::from_str(&run(folder, &format!("validate {mesh} --json --quiet"))).unwrap();
        assert_eq!(valid["valid"], true, "{valid}");
        // The transmissibility across the fault is that of the map, per unit of height.
        let graph = Graph::from_poly(&cells(&folder.join(&mesh)).mesh);
        let plane = Graph::from_poly(&map);
        let across = |graph: &Graph<3>| -> f64 {
            let on_fault = graph.connections.iter().filter(|c| c.on_feature);
            on_fault.map(|c| c.unit_transmissibility()).sum()
        };
        let on_fault = plane.connections.iter().filter(|c| c.on_feature);
        let expected: f64 = on_fault.map(|c| 15.0 * c.unit_transmissibility()).sum();
        assert!((across(&graph) / expected - 1.0).abs() < 1e-6, "{fault}");

        // Faces beside no cell are closed: all that enters leaves at the other side.
        let flow = format!("flow {mesh} -o flow.vtu --pressure xmin=2e5 --pressure xmax=1e5");
        let flow = format!("{flow} --faults open --quiet --json");
        let report: Value = serde_json::from_str(&run(folder, &flow)).unwrap();
        let exchange = report["exchange"].as_array().unwrap();
        let rates: Vec<f64> = exchange
            .iter()
            .map(|e| e["rate"].as_f64().unwrap())
            .collect();
        assert!(
            rates[0] > 0.0 && (rates[0] + rates[1]).abs() < 1e-6 * rates[0],
            "{report}"
        );
        for (format, output) in [
            ("opm", "CASE.DATA"),
            ("mrst", "case.mat"),
            ("pflotran", "case.uge"),
            ("tough2", "MESH"),
            ("openfoam", "case"),
        ] {
            let rock = if format == "openfoam" {
                "--quiet"
            } else {
                ROCK
            };
            run(
                folder,
                &format!("export {mesh} --to {format} -o {output} --down z {rock}"),
            );
        }
        let rock = ROCK.replace("--quiet", "");
        let disv = format!("export {mesh} --to disv -o disv --down z {rock}");
        let error = expect_refusal(folder, &disv.split_whitespace().collect::<Vec<_>>());
        assert!(
            error.contains("offset layers") && error.contains("--throws"),
            "{error}"
        );
        assert_darts_connections(folder, &mesh, &map);
    }
    // Without the option, the same horizons make ramps.
    let horizons = "--horizon upright-top.npy --horizon upright-base.npy";
    let ramps = format!("columns map.vtu {horizons} -o ramps.vtu --quiet --json");
    let report: Value = serde_json::from_str(&run(folder, &ramps)).unwrap();
    assert_eq!(report["juxtaposed"], Value::Null);
}

/// Asserts that DARTS gets the connections of cells in columns whose layers are offset by half their
/// thickness of 10: each pair of cells at the fault meets over a height of 5 and has the
/// transmissibility of the map for that height. With the exported connections, as much flows into
/// each cell as out of it at the pressures that `atomesh flow` computed.
fn assert_darts_connections(folder: &Path, mesh: &str, map: &PolyMesh<2>) {
    run(
        folder,
        &format!("export {mesh} --to darts -o a.conn --down z {ROCK}"),
    );
    let text = std::fs::read_to_string(folder.join("a.conn")).unwrap();
    let number = |word: &str| -> f64 { word.parse().unwrap() };
    let rows: Vec<Vec<f64>> = (text.lines().skip(1))
        .map(|line| line.split(' ').map(number).collect())
        .collect();
    let file = cells(&folder.join(mesh));
    let graph = Graph::from_poly(&file.mesh);
    assert_eq!(rows.len(), graph.connections.len());
    let pairs: BTreeSet<[u32; 2]> = graph.connections.iter().map(|c| c.cells).collect();
    assert_eq!(pairs.len(), rows.len(), "each pair is connected once");

    let plane = Graph::from_poly(map);
    let on_map: BTreeMap<[u32; 2], f64> = (plane.connections.iter())
        .map(|c| (c.cells, c.unit_transmissibility()))
        .collect();
    let column = |cell: u32| {
        let site = file.mesh.sites[cell as usize];
        let is_same = |x: &[f64; 2]| (0..2).all(|k| (x[k] - site[k]).abs() < 1e-9);
        map.sites.iter().position(is_same).unwrap() as u32
    };
    let mut count = 0;
    for (row, connection) in rows.iter().zip(&graph.connections) {
        let cells = [row[0] as u32, row[1] as u32];
        assert_eq!(cells, connection.cells);
        // A millidarcy is 0.00852702 cP m3/day/bar for each metre.
        assert!((row[2] / (0.852702 * row[3]) - 1.0).abs() < 1e-6, "{row:?}");
        if connection.on_feature {
            let columns = cells.map(column);
            let pair = [columns[0].min(columns[1]), columns[0].max(columns[1])];
            assert!((row[3] / (5.0 * on_map[&pair]) - 1.0).abs() < 1e-6);
            count += 1;
        }
    }
    let fault_faces = plane.connections.iter().filter(|c| c.on_feature).count();
    assert_eq!(count, 3 * fault_faces);

    let flow = cells(&folder.join("flow.vtu"));
    let pressure = flow.cell_data.iter().find(|a| a.name == "pressure");
    let pressure = pressure.unwrap().values.to_f64();
    let mut balance = vec![(0.0, 0.0f64); pressure.len()];
    for row in &rows {
        let [a, b] = [row[0] as usize, row[1] as usize];
        let rate = row[2] * (pressure[a] - pressure[b]);
        for (cell, rate) in [(a, rate), (b, -rate)] {
            balance[cell].0 += rate;
            balance[cell].1 = balance[cell].1.max(rate.abs());
        }
    }
    // Where the pressure is given, at the smallest and the largest x, water enters and leaves.
    let x = || graph.boundary.iter().map(|face| face.point[0]);
    let ends = [x().fold(f64::MAX, f64::min), x().fold(f64::MIN, f64::max)];
    for face in &graph.boundary {
        if ends.iter().any(|end| (face.point[0] - end).abs() < 1e-6) {
            balance[face.cell as usize] = (0.0, 0.0);
        }
    }
    let largest = balance.iter().fold(0.0, |max: f64, b| max.max(b.1));
    let worst = balance.iter().fold(0.0, |max: f64, b| max.max(b.0.abs()));
    assert!(
        largest > 0.0 && worst < 1e-5 * largest,
        "{worst} of {largest}"
    );
}

#[test]
#[ignore = "needs OpenFOAM: make test-all"]
fn openfoam_accepts_columns() {
    let folder = folder();
    let folder = folder.path();
    run(
        folder,
        &format!("columns map.vtu {HORIZONS} -o cells.vtu --quiet"),
    );
    run(
        folder,
        &format!("export cells.vtu --to openfoam -o case --down z {ROCK}"),
    );
    let mut check = Command::new("checkMesh");
    check
        .env("WM_PROJECT_DIR", "/usr/share/openfoam")
        .arg("-case")
        .arg(folder.join("case"));
    let stdout = run_simulator(&mut check);
    assert!(
        stdout.contains("Boundary definition OK") && stdout.contains("Cell volumes OK"),
        "{stdout}"
    );
}

#[test]
fn level_layers_have_the_pressures_of_the_map() {
    let folder = folder();
    let folder = folder.path();
    run(
        folder,
        "columns map.vtu --horizon -1000 --horizon -1004 --layers 2 -o cells.vtu --quiet",
    );
    let sides = "--pressure xmin=2e5 --pressure xmax=1e5 --faults 0.01 --quiet --json";
    run(folder, &format!("flow cells.vtu -o flow.vtu {sides}"));
    run(folder, &format!("flow map.vtu -o plane.vtu {sides}"));
    let pressure = |arrays: &[atomesh::files::vtk::DataArray]| {
        let array = arrays.iter().find(|a| a.name == "pressure").unwrap();
        array.values.to_f64()
    };
    let space = pressure(&cells(&folder.join("flow.vtu")).cell_data);
    let AnyMesh::Polygons(plane) = read_any_vtu(&folder.join("plane.vtu")).unwrap() else {
        panic!("no polygons")
    };
    let plane = pressure(&plane.cell_data);
    assert_eq!(space.len(), 2 * plane.len());
    for (cell, p) in space.iter().enumerate() {
        assert!((p - plane[cell % plane.len()]).abs() < 1e-3, "{cell}: {p}");
    }
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_runs_columns() {
    let folder = folder();
    let folder = folder.path();
    run(
        folder,
        &format!("columns map.vtu {HORIZONS} -o cells.vtu --quiet"),
    );
    std::fs::write(folder.join("INJ.csv"), "6,40,900,0.1\n6,40,1100,0.1\n").unwrap();
    std::fs::write(folder.join("PROD.csv"), "40,10,900,0.1\n50,12,1017,0.1\n").unwrap();
    let wells = "--injector INJ.csv:1 --producer PROD.csv:100";
    let deck =
        format!("export cells.vtu --to opm -o CASE.DATA --down z {ROCK} --no-gravity {wells}");
    run(folder, &format!("{deck} --pressure-at-top 100"));
    let mut command = Command::new("flow");
    command
        .current_dir(folder)
        .args(["CASE.DATA", "--output-dir=out", "--threads-per-process=1"]);
    run_simulator(&mut command);
    let out = folder.join("out");
    let result = run_validator("resfo", "opm.py", &[out.as_os_str(), OsStr::new("CASE")]);
    let pressure: Vec<f64> = (result["pressure"].as_array().unwrap().iter())
        .map(|p| p.as_f64().unwrap())
        .collect();
    let file = cells(&folder.join("cells.vtu"));
    assert_eq!(pressure.len(), file.mesh.sites.len());
    let min = pressure.iter().copied().fold(f64::INFINITY, f64::min);
    let max = pressure.iter().copied().fold(0.0, f64::max);
    assert!(min > 100.0 && max > min + 0.1, "{min} {max}");
}

#[test]
#[ignore = "needs flopy: make test-all"]
fn modflow_has_the_conductances_and_heads_of_atomesh() {
    let folder = folder();
    let folder = folder.path();
    // The layers are level. In the east the middle one has no thickness.
    write_npy_2d(&folder.join("step.npy"), [60, 50], |[x, _]| {
        if x < 30 { 1006.0 } else { 1002.0 }
    });
    let horizons = "--horizon 1000 --horizon 1002 --horizon step.npy --horizon 1010";
    run(
        folder,
        &format!("columns map.vtu {horizons} -o cells.vtu --quiet"),
    );
    // The same horizons without the layer that ends.
    let level = "--horizon 1000 --horizon 1002 --horizon 1006 --layers 2";
    run(
        folder,
        &format!("columns map.vtu {level} -o level.vtu --quiet"),
    );
    let wells = "--injector 5,40,1001:8.64 --producer 50,12,1001:120 --faults 0.01";
    for mesh in ["cells", "level"] {
        let export = format!("export {mesh}.vtu --down z --no-gravity --quiet {wells}");
        let rock = "--porosity 0.2 --permeability 100,100,10 --permeability-unit mD --json";
        let stdout = run(
            folder,
            &format!("{export} --to disv -o model-{mesh} {rock}"),
        );
        let report: Value = serde_json::from_str(&stdout).unwrap();
        let path = folder.join(format!("model-{mesh}"));
        let result = run_validator("flopy", "disv.py", &[path.as_os_str()]);
        let file = cells(&folder.join(format!("{mesh}.vtu")));
        let graph = Graph::from_poly(&file.mesh);
        assert_eq!(result["clockwise"], true);
        let active = result["active"].as_u64().unwrap() as usize;
        assert_eq!(active, graph.volume.len());
        let total: f64 = graph.volume.iter().sum();
        assert!((result["volume"].as_f64().unwrap() / total - 1.0).abs() < 1e-12);
        if mesh == "cells" {
            assert!(
                result["passed"].as_u64().unwrap() > 10,
                "{}",
                result["passed"]
            );
            continue;
        }
        assert_eq!(
            result["connections"].as_u64().unwrap() as usize,
            graph.connections.len()
        );
        // The heads between the wells are those that `atomesh flow` computes for the same problem.
        let flow = format!(
            "flow {mesh}.vtu -o flow.vtu --permeability 9.86923266716013e-14,9.86923266716013e-14,9.86923266716013e-15"
        );
        let ends = "--source 5,40,1001:1e-4 --sink 50,12,1001:1e-4 --faults 0.01 --quiet";
        run(folder, &format!("{flow} {ends}"));
        let ours = cells(&folder.join("flow.vtu")).cell_data;
        let ours = ours
            .iter()
            .find(|a| a.name == "pressure")
            .unwrap()
            .values
            .to_f64();
        let heads: Vec<f64> = (result["head"].as_array().unwrap().iter())
            .map(|h| h.as_f64().unwrap())
            .collect();
        let producer = report["wells"][1]["cells"][0][0].as_u64().unwrap() as usize;
        let range = ours.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - ours.iter().copied().fold(f64::INFINITY, f64::min);
        for (cell, p) in ours.iter().enumerate() {
            let theirs = (heads[cell] - heads[producer]) * 9806.65;
            assert!(
                (theirs - (p - ours[producer])).abs() < 1e-6 * range,
                "{cell}"
            );
        }
        // The whole rate leaves through the well index of the producer.
        let index = report["wells"][1]["cells"][0][1].as_f64().unwrap();
        let rate = (heads[producer] * 9806.65 - 120e5) * index / 1e-3;
        assert!((rate / 1e-4 - 1.0).abs() < 1e-6, "{rate}");
    }
}

#[test]
fn impossible_columns_are_refused() {
    let folder = folder();
    let folder = folder.path();
    write_npy(&folder.join("cube.npy"), [9, 9, 9], |_| 1.0);
    write_npy_2d(&folder.join("far.npy"), [60, 50], |_| f32::NAN);
    run(
        folder,
        "mesh fault.npy --distance 8 --quiet -o triangles.vtu",
    );
    for (line, expected) in [
        ("map.vtu --horizon top.npy", "at least two"),
        (
            "map.vtu --horizon base.npy --horizon mid.npy --horizon top.npy --horizon 2000",
            "cross",
        ),
        ("map.vtu --horizon 5 --horizon 5", "coincide everywhere"),
        ("map.vtu --horizon top.npy --horizon cube.npy", "3-D image"),
        (
            "map.vtu --horizon top.npy --horizon far.npy",
            "lies beside the map",
        ),
        ("map.vtu --horizon top.npy --horizon none.npy", "none.npy"),
        (
            "map.vtu --horizon top.npy --horizon base.npy --layers x",
            "--layers x",
        ),
        (
            "map.vtu --horizon top.npy --horizon base.npy --layers 1,2",
            "do not fit",
        ),
        (
            "map.vtu --horizon top.npy --horizon base.npy --layer-thickness 0",
            "not positive",
        ),
        ("triangles.vtu --horizon 0 --horizon 1", "triangles"),
        (
            "map.vtu --horizon 0 --horizon 1 --throws -1",
            "--throws -1: is not a distance",
        ),
    ] {
        let line = format!("columns {line} -o out.vtu");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}\n{error}");
    }
}

#[test]
fn a_mesh_that_is_not_in_columns_is_refused_as_a_modflow_grid() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("sheet.npy"),
        [30, 28, 26],
        crate::common::planar_fault([30, 28, 26]),
    );
    run(
        folder,
        "mesh sheet.npy --distance 8 --quiet -o cells.vtu --cells voronoi",
    );
    let export = "export cells.vtu --to disv -o model --depth-at-top 10";
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD";
    let line = format!("{export} {rock}");
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(error.contains("needs columns"), "{error}");
}

#[test]
fn surfaces_and_images_with_a_geometry_are_horizons() {
    let folder = folder();
    let folder = folder.path();
    // Two surfaces cover part of the map: z = 10 + 0.2 x, and z = 30.
    let grid = |z: &dyn Fn(f64) -> f64| -> Vec<[f64; 3]> {
        (0..36)
            .map(|i| {
                let [x, y] = [f64::from(i % 6) * 9.0, f64::from(i / 6) * 12.0 - 2.0];
                [x, y, z(x)]
            })
            .collect()
    };
    let nodes = [grid(&|x| 10.0 + 0.2 * x), grid(&|_| 30.0)].concat();
    let mut facets = Vec::new();
    for first in [0u32, 36] {
        for cell in (0..30u32).filter(|c| c % 6 < 5) {
            let corner = first + cell;
            facets.extend([
                [corner, corner + 1, corner + 7],
                [corner, corner + 7, corner + 6],
            ]);
        }
    }
    let half = facets.len() / 2;
    let surfaces =
        atomesh::export::SurfaceFile::<3>::new(&nodes, &facets, &[0, half, 2 * half], "h");
    atomesh::export::write_vtp(&folder.join("h.vtp"), &surfaces).unwrap();
    run(
        folder,
        "columns map.vtu --horizon h.vtp:1 --horizon h.vtp:2 -o cells.vtu --quiet",
    );
    let mesh = cells(&folder.join("cells.vtu")).mesh;
    // The surfaces end at x = 45. Beyond, depths are extrapolated from the margin.
    for [x, _, z] in &mesh.nodes {
        let top = 10.0 + 0.2 * x;
        let error = (z - top).abs().min((z - 30.0).abs());
        assert!(error < if *x <= 45.0 { 1e-5 } else { 4.0 }, "{x} {z}");
    }
    // A file of several surfaces is no horizon.
    let line = "columns map.vtu --horizon h.vtp --horizon 40 -o x.vtu";
    let error = expect_refusal(folder, &line.split(' ').collect::<Vec<_>>());
    assert!(
        error.contains("h.vtp: has 2 surfaces: h1, h2; name one of them as FILE:NAME"),
        "{error}"
    );
    // The image has other dimensions than the map, and a geometry of its own.
    let geometry = atomesh::image::Geometry::with_spacing([-10.0, -10.0], [20.0, 16.0]);
    let samples = (0..30).map(|i| 5.0 + 0.5 * (i % 5) as f32).collect();
    let image = atomesh::image::Image::new([5, 6], samples, geometry);
    atomesh::image::formats::write(&folder.join("top.vti"), &image).unwrap();
    run(
        folder,
        "columns map.vtu --horizon top.vti --horizon 40 --layer-thickness 10 -o cells.vtu --quiet",
    );
    let file = cells(&folder.join("cells.vtu"));
    let layers = file.cell_data.iter().find(|a| a.name == "layer").unwrap();
    assert_eq!(layers.values.to_i64().iter().max(), Some(&2));
    for [x, _, z] in file.mesh.nodes.iter().filter(|p| p[2] < 10.0) {
        assert!(
            (z - (5.0 + 0.5 * (x + 10.0) / 20.0)).abs() < 1e-5,
            "{x} {z}"
        );
    }
    let error = expect_refusal(
        folder,
        &[
            "columns",
            "map.vtu",
            "--horizon",
            "h.vtp:7",
            "--horizon",
            "40",
            "-o",
            "x.vtu",
        ],
    );
    assert!(
        error.contains("h.vtp:7: names no surface: the file has h1, h2"),
        "{error}"
    );
}
