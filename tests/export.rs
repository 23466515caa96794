//! Tests `atomesh export`: independent programs read and run the exported files.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    FAULT_DIMS as DIMS, expect_refusal, folder_with_meshes, is_close, numbers, run, run_simulator,
    run_validator, write_npy,
};
use atomesh::export::simulators::opm;
use atomesh::model::flow::{Rock, Tensor};
use atomesh::model::reservoir::{MILLIDARCY, Model};
use atomesh::model::reservoir::{MeshPlacement, PreparedModel};
use atomesh::store::{AnyMesh, read_any_vtu};
use serde_json::Value;

/// Volume of the box.
const VOLUME: f64 = 39.0 * 35.0 * 31.0;
const ROCK: &str = "--porosity 0.2 --permeability 100 --permeability-unit mD --quiet";

/// Returns the model that `atomesh export` makes of a mesh.
fn model(folder: &Path, mesh: &str, top: f64, k: &[f64]) -> Model {
    let file = read_any_vtu(&folder.join(mesh)).unwrap();
    let placement = MeshPlacement {
        top: Some(top),
        ..MeshPlacement::default()
    };
    let mut prepared = PreparedModel::new(file, mesh, &placement).unwrap();
    let tensor = Tensor::from_numbers(k).unwrap().scaled(MILLIDARCY);
    let model = &mut prepared.model;
    model.set_permeability(Rock::uniform(tensor, 1.0)).unwrap();
    prepared.model
}

/// Runs OPM Flow on a deck and returns its results.
fn flow(folder: &Path, case: &str) -> Value {
    let mut command = Command::new("flow");
    command
        .current_dir(folder)
        .args([&format!("{case}.DATA"), "--output-dir=out"])
        .args(["--enable-tuning=false", "--threads-per-process=1"]);
    run_simulator(&mut command);
    let out = folder.join("out");
    run_validator("resfo", "opm.py", &[out.as_os_str(), OsStr::new(case)])
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_has_the_transmissibilities_pore_volumes_and_depths_of_the_model() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for mesh in ["cells.vtu", "tets.vtu"] {
        let rock = "--porosity 0.2 --permeability 100,100,10 --permeability-unit mD --quiet";
        let wells = "--injector 5,5,5:5 --producer 33,30,25:200 --days 10";
        let deck = format!("export {mesh} --to opm -o CASE.DATA {rock} {wells}");
        run(folder, &format!("{deck} --depth-at-top 2000"));
        let model = model(folder, mesh, 2000.0, &[100.0, 100.0, 10.0]);
        let result = flow(folder, "CASE");
        let porv = numbers(&result["porv"]);
        assert_eq!(porv.len(), model.len());
        for (cell, &porv) in porv.iter().enumerate() {
            assert!(
                is_close(porv, 0.2 * model.graph.volume[cell], 1e-6),
                "{porv}"
            );
        }
        for (cell, &depth) in numbers(&result["depth"]).iter().enumerate() {
            assert!(is_close(depth, model.depth(cell), 1e-6), "{depth}");
        }
        let mut expected: Vec<([u32; 2], f64)> = Vec::new();
        let t = &model.need_permeability("").unwrap().transmissibility;
        for (c, t) in model.graph.connections.iter().zip(t) {
            let t = t * opm::TRANSMISSIBILITY_UNIT;
            if t >= opm::MIN_TRANSMISSIBILITY {
                expected.push((c.cells, t));
            }
        }
        expected.sort_by_key(|k| k.0);
        let mut read: Vec<([u32; 2], f64)> = Vec::new();
        for pair in result["t"].as_array().unwrap() {
            let [a, b] = [0, 1].map(|k| pair[k].as_u64().unwrap() as u32);
            read.push(([a.min(b), a.max(b)], pair[2].as_f64().unwrap()));
        }
        read.sort_by_key(|k| k.0);
        assert_eq!(read.len(), expected.len());
        for (read, expected) in read.iter().zip(&expected) {
            assert_eq!(read.0, expected.0);
            assert!(is_close(read.1, expected.1, 1e-6), "{read:?} {expected:?}");
        }
    }
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_has_the_steady_pressure_of_atomesh() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    // 8.64 m^3 a day are 1e-4 m^3/s. Water is almost incompressible near its reference pressure.
    let wells = "--injector 5,5,5:8.64 --producer 33,30,25:200 --pressure-at-top 200 --days 3650";
    let deck = format!("export cells.vtu --to opm -o CASE.DATA {ROCK} {wells}");
    for (faults, name) in [("open", "open"), ("0.01", "tight")] {
        run(
            folder,
            &format!("{deck} --depth-at-top 2000 --no-gravity --faults {faults}"),
        );
        let command = "flow cells.vtu -o flow.vtu --permeability 9.86923266716013e-14 --quiet";
        let ends = "--source 5,5,5:1e-4 --sink 33,30,25:1e-4";
        run(folder, &format!("{command} {ends} --faults {faults}"));
        let result = flow(folder, "CASE");
        let AnyMesh::Polyhedra(file) = read_any_vtu(&folder.join("flow.vtu")).unwrap() else {
            panic!("no polyhedra")
        };
        let arrays = &file.cell_data;
        let ours = arrays.iter().find(|a| a.name == "pressure").unwrap();
        let ours: Vec<f64> = ours.values.to_f64().iter().map(|p| p / 1e5).collect();
        let theirs = numbers(&result["pressure"]);
        let mean = |p: &[f64]| p.iter().sum::<f64>() / p.len() as f64;
        let range = |p: &[f64]| {
            p.iter().copied().fold(f64::NEG_INFINITY, f64::max)
                - p.iter().copied().fold(f64::INFINITY, f64::min)
        };
        let (our_mean, their_mean) = (mean(&ours), mean(&theirs));
        let differences: Vec<f64> = (ours.iter().zip(&theirs))
            .map(|(p, q)| (p - our_mean) - (q - their_mean))
            .collect();
        let worst = differences.iter().fold(0.0f64, |max, d| max.max(d.abs()));
        let range = range(&ours);
        println!("{name}: {worst:.2e} bar of {range:.2e}");
        assert!(worst < 1e-3 * range, "{name}: {worst} of {range}");
    }
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn water_displaces_oil() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let wells = "--injector INJ=5,5,5:50 --producer PROD=33,30,25:150";
    let deck = "export cells.vtu --to opm -o OIL.DATA --fluid oil-water --depth-at-top 1500";
    run(folder, &format!("{deck} {ROCK} {wells} --days 100"));
    let result = flow(folder, "OIL");
    let water = numbers(&result["swat"]);
    assert!(water.iter().all(|s| (0.199..=1.001).contains(s)));
    assert!(water.iter().filter(|s| **s > 0.4).count() > 5);
}

/// Runs one of OpenFOAM's programs and returns its standard output.
fn openfoam(program: &str, case: &Path, options: &[&str]) -> String {
    let mut command = Command::new(program);
    command
        .env("WM_PROJECT_DIR", "/usr/share/openfoam")
        .arg("-case")
        .arg(case)
        .args(options);
    run_simulator(&mut command)
}

/// Returns the values of a scalar field that OpenFOAM wrote.
fn field(path: &Path) -> Vec<f64> {
    let text = std::fs::read_to_string(path).unwrap();
    let (_, list) = text.split_once("internalField").unwrap();
    let (_, list) = list.split_once("\n(").unwrap();
    let (list, _) = list.split_once("\n)").unwrap();
    list.split_whitespace()
        .map(|v| v.parse().unwrap())
        .collect()
}

/// Returns the points of a case, each with `true` if it is in the point zone.
fn points_in_zone(case: &Path, zone: &str) -> Vec<([f64; 3], bool)> {
    let read = |name: &str| std::fs::read_to_string(case.join("constant/polyMesh").join(name));
    let zones = read("pointZones").unwrap();
    let (_, zone) = zones.split_once(&format!("\n{zone}\n{{")).unwrap();
    let (_, list) = zone.split_once("\n(").unwrap();
    let (list, _) = list.split_once("\n)").unwrap();
    let members: Vec<usize> = list
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    let points = read("points").unwrap();
    let (_, list) = points.split_once("\n(").unwrap();
    let lines = list.lines().filter(|line| line.starts_with('('));
    let point = |line: &str| -> [f64; 3] {
        let numbers = line.trim_matches(['(', ')']).split_whitespace();
        let numbers: Vec<f64> = numbers.map(|v| v.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    };
    (lines.map(point).enumerate())
        .map(|(i, p)| (p, members.binary_search(&i).is_ok()))
        .collect()
}

#[test]
#[ignore = "needs OpenFOAM: make test-all"]
fn openfoam_accepts_the_mesh_and_solves_a_linear_field_exactly() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for (mesh, tolerance) in [("cells", 1e-10), ("tets", 1e-5)] {
        run(
            folder,
            &format!("export {mesh}.vtu --to openfoam -o {mesh} {ROCK}"),
        );
        let case = folder.join(mesh);
        let stdout = openfoam("checkMesh", &case, &[]);
        assert!(stdout.contains("Mesh OK."), "{stdout}");
        // The nodes of a side are those that lie on it.
        let nodes = points_in_zone(&case, "xmin");
        let consistent = nodes
            .iter()
            .filter(|(p, in_zone)| (p[0] == 0.0) == *in_zone);
        assert_eq!(consistent.count(), nodes.len());
        let nodes = points_in_zone(&case, "fault1");
        assert!(nodes.iter().filter(|n| n.1).count() > 40, "{mesh}");
        let strict = match mesh {
            "cells" => {
                // checkMesh rates cells by their smallest faces, which welding removes.
                let welded = "mesh sheet.npy --distance 6 --cells voronoi --weld 0.001 --quiet";
                run(folder, &format!("{welded} -o welded.vtu"));
                run(folder, "export welded.vtu --to openfoam -o welded --quiet");
                folder.join("welded")
            }
            _ => case.clone(),
        };
        let options = ["-allGeometry", "-allTopology"];
        let stdout = openfoam("checkMesh", &strict, &options);
        // A tetrahedron in a corner of the box has only one or two inner faces. No other warning
        // may appear.
        let faults: Vec<&str> = stdout.lines().filter(|l| l.contains("***")).collect();
        let corners = |l: &&str| mesh == "tets" && l.contains("small determinant");
        assert!(faults.iter().all(corners), "{stdout}");
        assert!(stdout.contains("fault1"), "{stdout}");

        openfoam("laplacianFoam", &case, &[]);
        openfoam(
            "postProcess",
            &case,
            &["-func", "writeCellCentres", "-time", "1"],
        );
        let (t, x) = (field(&case.join("1/T")), field(&case.join("1/Cx")));
        for (t, x) in t.iter().zip(&x) {
            assert!((t - (1.0 - x / 39.0)).abs() < tolerance, "{t} at {x}");
        }
        assert!(field(&case.join("0/porosity")).iter().all(|p| *p == 0.2));
    }
}

#[test]
#[ignore = "needs OpenFOAM: make test-all"]
fn openfoam_finds_no_skew_face_among_cells_along_noisy_faults() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (kind, seed) in [("faults", 11), ("network", 12), ("faults", 13)] {
        let synth = format!("synth {kind} -o n.npy --dims 80,72,64 --rng-seed {seed} --quiet");
        run(folder, &synth);
        run(
            folder,
            "mesh n.npy --distance 6 --cells voronoi -o n.vtu --quiet",
        );
        run(
            folder,
            &format!("export n.vtu --to openfoam -o case{seed} --quiet"),
        );
        let stdout = openfoam("checkMesh", &folder.join(format!("case{seed}")), &[]);
        assert!(stdout.contains("Max skewness = "), "{stdout}");
        assert!(stdout.contains("Mesh OK."), "{kind} {seed}: {stdout}");
    }
}

#[test]
#[ignore = "needs OpenFOAM: make test-all"]
fn a_closed_fault_is_an_impermeable_patch_of_openfoam() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(
        folder,
        "export cells.vtu --to openfoam -o case --faults closed --quiet",
    );
    let case = folder.join("case");
    let faces = |name: &str| -> usize {
        let text = std::fs::read_to_string(case.join("constant/polyMesh/boundary")).unwrap();
        let (_, patch) = text.split_once(&format!("\n{name}\n")).unwrap();
        let (_, count) = patch.split_once("nFaces ").unwrap();
        count.split_once(';').unwrap().0.parse().unwrap()
    };
    let closed: usize = faces("fault1");
    assert!(closed > 40 && closed.is_multiple_of(2), "{closed}");
    let stdout = openfoam("checkMesh", &case, &["-allTopology"]);
    assert!(stdout.contains("Mesh OK."), "{stdout}");
    let pairs = format!("(baffle faces): {}", closed / 2);
    assert!(stdout.contains(&pairs), "{stdout}");
    openfoam("laplacianFoam", &case, &[]);
    let t = field(&case.join("1e+12/T"));
    let count_near = |value: f64| t.iter().filter(|t| (*t - value).abs() < 1e-6).count();
    assert!(count_near(1.0) > t.len() / 3 && count_near(0.0) > t.len() / 3);
    assert_eq!(count_near(1.0) + count_near(0.0), t.len());
    // OpenFOAM cannot hold a fault multiplier between 0 and 1.
    let error = expect_refusal(
        folder,
        &[
            "export",
            "cells.vtu",
            "--to",
            "openfoam",
            "-o",
            "other",
            "--faults",
            "0.1",
        ],
    );
    assert!(
        error.contains("fault multipliers") && error.contains("opm"),
        "{error}"
    );
}

#[test]
fn fault_multipliers_scale_areas_if_a_format_has_no_multipliers() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    // Each connection has its cells and its area.
    let areas = |to: &str, faults: &str| -> Vec<(String, f64)> {
        let out = if to == "tough2" { "MESH" } else { "grid.uge" };
        let export = format!("export cells.vtu --to {to} -o {out} --depth-at-top 100 --quiet");
        run(folder, &format!("{export} --faults {faults}"));
        let text = std::fs::read_to_string(folder.join(out)).unwrap();
        let word = if to == "tough2" {
            "CONNE"
        } else {
            "CONNECTIONS"
        };
        let lines = text
            .lines()
            .skip_while(|line| !line.starts_with(word))
            .skip(1);
        let row = |line: &str| match to {
            "tough2" => (line[..10].to_string(), line[50..60].trim().parse().unwrap()),
            _ => {
                let (cells, area) = line.rsplit_once(' ').unwrap();
                (cells.to_string(), area.parse().unwrap())
            }
        };
        lines.take_while(|line| !line.is_empty()).map(row).collect()
    };
    let connections = model(folder, "cells.vtu", 100.0, &[1.0]).graph.connections;
    for to in ["pflotran", "tough2"] {
        let open = areas(to, "open");
        assert_eq!(open.len(), connections.len());
        let tight = areas(to, "0.01");
        for ((open, tight), c) in open.iter().zip(&tight).zip(&connections) {
            let factor = if c.on_feature { 0.01 } else { 1.0 };
            assert_eq!(open.0, tight.0);
            assert!(
                is_close(factor * open.1, tight.1, 1e-5),
                "{to} {open:?} {tight:?}"
            );
        }
        let closed = areas(to, "closed");
        let expected = open.iter().zip(&connections).filter(|(_, c)| !c.on_feature);
        assert!(expected.map(|(row, _)| row).eq(&closed), "{to}");
        assert!(closed.len() < open.len() - 40);
    }
}

#[test]
#[ignore = "needs OpenFOAM: make test-all"]
fn meshes_of_the_plane_are_exported_as_a_layer_of_prisms() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    crate::common::write_npy_2d(&folder.join("line.npy"), [60, 50], |[x, y]| {
        (-0.5 * ((0.6 * x as f32 - 0.8 * y as f32 + 3.0) / 1.5).powi(2)).exp()
    });
    crate::common::write_npy_2d(&folder.join("phi.npy"), [60, 50], |[x, _]| {
        0.1 + 0.002 * x as f32
    });
    for cells in ["voronoi", "triangles"] {
        let mesh = format!("mesh line.npy --distance 5 --quiet -o {cells}.vtu --cells {cells}");
        run(folder, &mesh);
        let export = format!("export {cells}.vtu --thickness 4 --down y --json --quiet");
        let rock = "--porosity phi.npy --permeability 100 --permeability-unit mD";
        let stdout = run(
            folder,
            &format!("{export} --to opm -o A.DATA --depth-at-top 900 {rock}"),
        );
        let report: Value = serde_json::from_str(&stdout).unwrap();
        let checks = &report["checks"];
        assert!(is_close(
            checks["volume"].as_f64().unwrap(),
            59.0 * 49.0 * 4.0,
            1e-12
        ));
        assert!(checks["volume_error"].as_f64().unwrap() < 1e-12);
        assert!(checks["feature_connections"].as_u64().unwrap() > 5);
        let depth = numbers(&checks["depth"]);
        assert!(depth[0] > 900.0 && depth[1] < 949.0, "{depth:?}");
        run(folder, &format!("{export} --to openfoam -o {cells}"));
        let stdout = openfoam("checkMesh", &folder.join(cells), &[]);
        assert!(stdout.contains("Mesh OK."), "{stdout}");
    }
}

#[test]
#[ignore = "needs h5py: make test-all"]
fn pflotran_has_rock_for_each_cell() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let rock = "--porosity sheet.npy --permeability 100,50,10 --permeability-unit mD --quiet";
    run(
        folder,
        &format!("export cells.vtu --to pflotran -o a.uge --depth-at-top 0 {rock}"),
    );
    let path = folder.join("a-rock.h5");
    let result = run_validator("h5py", "datasets.py", &[path.as_os_str()]);
    let cells = numbers(&result["Cell Ids"]);
    let ids = 1..=cells.len();
    assert!(cells.len() > 100 && cells.iter().copied().eq(ids.map(|c| c as f64)));
    for (axis, k) in [("X", 100.0), ("Y", 50.0), ("Z", 10.0)] {
        let values = numbers(&result[format!("Permeability{axis}")]);
        assert_eq!(values.len(), cells.len());
        assert!(
            values.iter().all(|v| is_close(*v, k * MILLIDARCY, 1e-12)),
            "{axis}"
        );
    }
    let porosity = numbers(&result["Porosity"]);
    assert_eq!(porosity.len(), cells.len());
    assert!(porosity.iter().any(|p| *p > 0.3) && porosity.iter().any(|p| *p < 0.01));
    // Without rock there is no such file.
    run(
        folder,
        "export cells.vtu --to pflotran -o b.uge --depth-at-top 0 --quiet",
    );
    assert!(!folder.join("b-rock.h5").exists());
}

#[test]
fn the_grid_of_pflotran_is_the_connection_graph() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(
        folder,
        "export cells.vtu --to pflotran -o grid.uge --depth-at-top 0 --quiet",
    );
    let model = model(folder, "cells.vtu", 0.0, &[1.0]);
    let text = std::fs::read_to_string(folder.join("grid.uge")).unwrap();
    let mut lines = text.lines();
    let mut block = |word: &str| -> Vec<Vec<f64>> {
        let (name, count) = lines.next().unwrap().split_once(' ').unwrap();
        assert_eq!(name, word);
        let row = |line: &str| {
            let words = line.split_whitespace();
            words.map(|w| w.parse().unwrap()).collect()
        };
        (0..count.parse().unwrap())
            .map(|_| row(lines.next().unwrap()))
            .collect()
    };
    let (cells, connections) = (block("CELLS"), block("CONNECTIONS"));
    assert_eq!(
        (cells.len(), connections.len()),
        (model.len(), model.graph.connections.len())
    );
    for (i, cell) in cells.iter().enumerate() {
        assert_eq!(cell[0], (i + 1) as f64);
        assert_eq!(cell[1..4], model.graph.site[i]);
        assert_eq!(cell[4], model.graph.volume[i]);
    }
    // PFLOTRAN computes A / d from these rows.
    for (row, c) in connections.iter().zip(&model.graph.connections) {
        let [a, b] = [0, 1].map(|k| row[k] as usize - 1);
        assert_eq!([a as u32, b as u32], c.cells);
        let distance_to_face = |cell: usize| {
            let square = (0..3).map(|k| (row[2 + k] - cells[cell][1 + k]).powi(2));
            square.sum::<f64>().sqrt()
        };
        assert!(is_close(
            row[5] / (distance_to_face(a) + distance_to_face(b)),
            c.unit_transmissibility(),
            1e-9
        ));
    }
    let side = std::fs::read_to_string(folder.join("grid-xmax.ex")).unwrap();
    let area: f64 = side
        .lines()
        .skip(1)
        .map(|line| line.rsplit_once(' ').unwrap().1.parse::<f64>().unwrap())
        .sum();
    assert!(is_close(area, 35.0 * 31.0, 1e-9), "{area}");
    // The companion mesh has the same cells in the same order.
    let AnyMesh::Polyhedra(companion) = read_any_vtu(&folder.join("grid.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    assert_eq!(companion.mesh.sites, model.graph.site);
}

#[test]
#[ignore = "needs toughio: make test-all"]
fn toughio_reads_the_tough2_mesh() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(
        folder,
        "export cells.vtu --to tough2 -o MESH --depth-at-top 100 --quiet \
         --permeability 100,50,10 --permeability-unit mD",
    );
    let model = model(folder, "cells.vtu", 100.0, &[1.0]);
    let graph = &model.graph;
    let path = folder.join("MESH");
    let result = run_validator("toughio", "tough.py", &[path.as_os_str()]);
    for (volume, expected) in numbers(&result["volume"]).iter().zip(&graph.volume) {
        assert!(is_close(*volume, *expected, 1e-5));
    }
    for modifier in numbers(&result["modifier"]) {
        assert!(is_close(modifier, 100.0 * MILLIDARCY, 1e-4), "{modifier}");
    }
    let centres = result["center"].as_array().unwrap();
    assert_eq!(centres.len(), model.len());
    for (centre, expected) in centres.iter().zip(&graph.site) {
        let centre = numbers(centre);
        assert!((0..3).all(|k| (centre[k] - expected[k]).abs() < 1e-5));
    }
    let connections = result["connections"].as_array().unwrap();
    assert_eq!(connections.len(), graph.connections.len());
    for (row, c) in connections.iter().zip(&graph.connections) {
        assert_eq!(numbers(&row[0]), c.cells.map(f64::from));
        let [a, b] = c.cells.map(|cell| graph.site[cell as usize]);
        let line = [0, 1, 2].map(|k| b[k] - a[k]);
        let axis = row[1].as_u64().unwrap() as usize - 1;
        assert!((0..3).all(|k| line[k].abs() <= line[axis].abs()));
        let distances = numbers(&row[2]);
        assert!((0..2).all(|k| is_close(distances[k], c.distance[k], 1e-5)));
        let area = row[3].as_f64().unwrap();
        assert!((area - c.area).abs() < 1e-4 * c.area + 1e-8, "{area}");
        // Down is -z. The sign is that of a first cell above the second one.
        let length = line.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((row[4].as_f64().unwrap() + line[2] / length).abs() < 1e-5);
    }
}

#[test]
fn images_fill_cells() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    write_npy(&folder.join("phi.npy"), DIMS, |[x, _, _]| {
        0.1 + 0.005 * x as f32
    });
    std::fs::write(folder.join("k.csv"), "region,K\n0,100\n").unwrap();
    let export = "export cells.vtu --to opm -o A.DATA --json --quiet";
    let stdout = run(
        folder,
        &format!(
            "{export} --porosity phi.npy --permeability k.csv --permeability-unit mD \
             --depth-at-top 1000 --property amplitude=sheet.npy:nearest"
        ),
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    // The mean of a linear function over the box is the mean of its values at the ends.
    let pore_volume = report["checks"]["pore_volume"].as_f64().unwrap();
    assert!(
        is_close(pore_volume, (0.1 + 0.005 * 19.5) * VOLUME, 1e-6),
        "{pore_volume}"
    );
    assert!(report["checks"]["angle"][1].as_f64().unwrap() < 1e-3);
    assert_eq!(
        report["checks"]["compartments"].as_array().unwrap().len(),
        1
    );
}

#[test]
fn errors_name_the_cause() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    write_npy(&folder.join("phi.npy"), DIMS, |_| 0.1);
    write_npy(&folder.join("small.npy"), [9, 9, 9], |_| 0.1);
    std::fs::write(folder.join("wrong.csv"), "region,K\n7,100\n").unwrap();
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 1000";
    let unit = "--permeability-unit mD";
    for (to, options, expected) in [
        ("opm -o B.DATA", "", "above depth 0"),
        ("opm -o B.DATA", "--depth-at-top -5", "above depth 0"),
        ("opm -o B.DATA", "--depth-at-top 1000", "porosity"),
        ("opm -o B.DATA", "--porosity 0.2 --down z", "permeability"),
        ("geos -o B.vtu", "--permeability 100", "has no unit"),
        (
            "opm -o B.DATA",
            &format!("--porosity 1.2 --permeability 1 --down z {unit}"),
            "1.2 in cell 0",
        ),
        (
            "geos -o B.vtu",
            "--permeability 100 --permeability-unit darcy",
            "not a known unit",
        ),
        (
            "geos -o B.vtu",
            &format!("--permeability wrong.csv {unit}"),
            "region 0",
        ),
        ("geos -o B.vtu", "--porosity wrong.csv", "region 0"),
        ("geos -o B.vtu", "--porosity small.npy", "does not cover"),
        ("geos -o B.vtu", "--porosity nothing", "neither a number"),
        ("geos -o B.vtu", "--length-unit furlong", "furlong"),
        (
            "geos -o B.vtu",
            &format!("--permeability -1 {unit}"),
            "not a permeability",
        ),
        (
            "opm -o B.DATA",
            &format!("{rock} --injector 500,5,5:1"),
            "outside",
        ),
        (
            "opm -o B.DATA",
            &format!("{rock} --injector a=5,5,5"),
            "has no ':'",
        ),
        (
            "opm -o B.DATA",
            &format!("{rock} --injector 5,5,5:1 --well-radius 90"),
            "radius",
        ),
        ("opm -o B.deck", "", "DATA"),
        ("opm -o nowhere/B.DATA", "", "nowhere"),
        ("openfoam -o phi.npy", "", "is a file"),
        ("msh -o B.msh", "", "tetrahedra only"),
        ("pflotran -o cells.uge", "", "overwrite the mesh"),
    ] {
        let line = format!("export cells.vtu --to {to} {options}");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}\n{error}");
    }
}

#[test]
#[ignore = "needs OPM Flow: make test-all"]
fn opm_flow_accepts_decks_without_flow() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for (number, deck) in [
        "opm -o CASE.DATA",
        "opm -o CASE.DATA --no-gravity",
        "opm -o CASE.DATA --no-gravity --fluid oil-water",
        "grdecl -o CASE.GRDECL",
        "grdecl -o CASE.GRDECL --fluid oil-water",
    ]
    .into_iter()
    .enumerate()
    {
        let line = format!("export cells.vtu --to {deck} {ROCK} --depth-at-top 1500");
        run(folder, &line);
        let mut flow = std::process::Command::new("flow");
        let out = format!("--output-dir=out{number}");
        flow.current_dir(folder).args(["CASE.DATA", &out]);
        run_simulator(&mut flow);
        assert!(folder.join(format!("out{number}/CASE.INIT")).exists());
    }
    let rock = ROCK.replace(" --quiet", "");
    let line = format!("export cells.vtu --to opm -o A.DATA {rock} --depth-at-top 9 --days 7");
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(error.contains("has no effect without wells"), "{error}");
}
