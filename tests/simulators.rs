//! Tests `atomesh export` to MRST and DARTS: independent programs read and run the exported files.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    expect_refusal, is_close, numbers, planar_fault, run, run_simulator, run_validator, write_npy,
};
use atomesh::model::flow::{FaultLaw, Rock, Tensor};
use atomesh::model::reservoir::{MILLIDARCY, Model};
use atomesh::model::reservoir::{MeshPlacement, PreparedModel};
use atomesh::store::{AnyMesh, read_any_vtu};
use serde_json::Value;

pub(super) const DIMS: [usize; 3] = [40, 36, 32];
/// Volume of the box.
pub(super) const VOLUME: f64 = 39.0 * 35.0 * 31.0;
pub(super) const TIGHT: f64 = 0.01;
pub(super) const ROCK: &str =
    "--porosity phi.npy --permeability 100,100,10 --permeability-unit mD --quiet";

/// Returns a folder with meshes of a fault across the box: `cells.vtu` of Voronoi cells and
/// `tets.vtu`. The folder has also `phi.npy`, a porosity that grows with x, and `labels.npy`, two
/// layers with a throw of 8 at the fault.
pub(super) fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_npy(&path.join("sheet.npy"), DIMS, planar_fault(DIMS));
    write_npy(&path.join("phi.npy"), DIMS, |[x, _, _]| {
        0.1 + 0.005 * x as f32
    });
    write_npy(&path.join("labels.npy"), DIMS, |[x, y, z]| {
        let right = x as f32 > 20.0 + 0.1 * y as f32 - 0.1 * z as f32;
        if z as f32 > if right { 19.5 } else { 11.5 } {
            1.0
        } else {
            2.0
        }
    });
    let mesh = "mesh sheet.npy --distance 5 --quiet -o";
    run(path, &format!("{mesh} cells.vtu --cells voronoi"));
    run(path, &format!("{mesh} tets.vtu"));
    folder
}

/// Returns the model that `atomesh export` makes of a mesh.
pub(super) fn model(folder: &Path, mesh: &str, top: f64, k: &[f64], faults: FaultLaw) -> Model {
    let file = read_any_vtu(&folder.join(mesh)).unwrap();
    let placement = MeshPlacement {
        top: Some(top),
        ..MeshPlacement::default()
    };
    let mut prepared = PreparedModel::new(file, mesh, &placement).unwrap();
    let tensor = Tensor::from_numbers(k).unwrap().scaled(MILLIDARCY);
    let rock = Rock::uniform(tensor, 1.0);
    prepared.model.set_faults(&faults.into()).unwrap();
    prepared.model.set_permeability(rock).unwrap();
    prepared.model
}

/// Returns the cell whose site is nearest to a point.
fn nearest_cell(model: &Model, point: [f64; 3]) -> usize {
    let squared_distance = |cell: &usize| -> f64 {
        let site = model.graph.site[*cell];
        (0..3).map(|k| (site[k] - point[k]).powi(2)).sum()
    };
    let cells = 0..model.len();
    cells
        .min_by(|a, b| squared_distance(a).total_cmp(&squared_distance(b)))
        .unwrap()
}

/// Compares steady pressures between two cells with those of `atomesh flow`, both scaled to the
/// range from 0 to 1.
fn assert_steady_pressure(folder: &Path, theirs: &[f64], cells: [usize; 2], tolerance: f64) {
    let AnyMesh::Polyhedra(file) = read_any_vtu(&folder.join("cells.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let [high, low] = cells.map(|c| file.mesh.sites[c].map(|x| x.to_string()).join(","));
    let ends = format!("--source {high}:1e-4 --sink {low}:1e-4 --faults {TIGHT} --quiet");
    run(
        folder,
        &format!("flow cells.vtu -o flow.vtu --permeability 9.86923266716013e-14 {ends}"),
    );
    let AnyMesh::Polyhedra(file) = read_any_vtu(&folder.join("flow.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let ours = file
        .cell_data
        .iter()
        .find(|a| a.name == "pressure")
        .unwrap();
    let ours = ours.values.to_f64();
    assert_eq!(ours.len(), theirs.len());
    let [high, low] = cells;
    let scaled = |p: &[f64], cell: usize| (p[cell] - p[low]) / (p[high] - p[low]);
    let worst = (0..ours.len()).fold(0.0f64, |max, cell| {
        max.max((scaled(&ours, cell) - scaled(theirs, cell)).abs())
    });
    println!("pressures differ by {worst:.1e} of their range");
    assert!(worst < tolerance, "{worst}");
}

/// Checks the transmissibilities of faces in the grid for MRST.
fn assert_transmissibilities(result: &Value, model: &Model) {
    let (graph, inner_count) = (&model.graph, model.graph.connections.len());
    let t = numbers(&result["t"]);
    let expected = &model.permeability.as_ref().unwrap().transmissibility;
    assert!(
        t.iter()
            .zip(expected)
            .all(|(t, expected)| is_close(*t, *expected, 1e-14))
    );
    for (t, face) in t[inner_count..].iter().zip(&graph.boundary) {
        let conductivity = model
            .permeability
            .as_ref()
            .unwrap()
            .rock
            .mobility(0)
            .normal_component(face.normal);
        assert!(is_close(
            *t,
            face.area * conductivity / face.distance,
            1e-12
        ));
    }
}

/// Checks the tags and the sets of nodes of faces in the grid for MRST.
fn assert_named_faces(result: &Value, model: &Model) {
    assert_eq!(numbers(&result["tags"]), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let feature_count = model
        .graph
        .connections
        .iter()
        .filter(|c| c.on_feature)
        .count();
    let tagged = |name: &str| result["tagged"][name].as_u64().unwrap_or(0) as usize;
    assert!(tagged("fault1") > 40 && tagged("interface_1_2") > 40);
    let surfaces = model.surfaces.kinds.len();
    let surfaces = (1..=surfaces).map(|n| tagged(&format!("fault{n}")));
    assert_eq!(surfaces.sum::<usize>() + tagged("scraps"), feature_count);
    for name in ["xmin", "zmax", "fault1", "interface_1_2"] {
        let nodes = result["sets"][name].as_u64().unwrap();
        assert!(nodes > 40 && tagged(name) > 0, "{name}");
    }
}

#[test]
#[ignore = "needs SciPy: make test-all"]
fn the_grid_of_mrst_has_the_volumes_and_fluxes_of_the_model() {
    let folder = folder();
    let folder = folder.path();
    for (mesh, k) in [("cells", "100"), ("tets", "100,100,10")] {
        let rock = ROCK.replace("100,100,10", k);
        let export = format!("export {mesh}.vtu --to mrst -o {mesh}.mat --depth-at-top 1000");
        run(
            folder,
            &format!("{export} {rock} --faults {TIGHT} --region labels.npy"),
        );
        let k: Vec<f64> = k.split(',').map(|k| k.parse().unwrap()).collect();
        let faults = FaultLaw::new(TIGHT, None).unwrap();
        let model = model(folder, &format!("{mesh}.vtu"), 1000.0, &k, faults);
        let graph = &model.graph;
        let ends = [[5.0, 5.0, -1026.0], [33.0, 30.0, -1006.0]].map(|p| nearest_cell(&model, p));
        let [source, sink] = ends.map(|cell| (cell + 1).to_string());
        let path = folder.join(format!("{mesh}.mat"));
        let arguments = [path.as_os_str(), OsStr::new(&source), OsStr::new(&sink)];
        let result = run_validator("SciPy", "mrst.py", &arguments);
        let inner_count = graph.connections.len();
        assert_eq!(result["cells"], model.len());
        assert_eq!(
            numbers(&result["faces"]),
            [
                (inner_count + graph.boundary.len()) as f64,
                inner_count as f64
            ]
        );
        assert_eq!(result["listed"], true);
        for name in ["volumes", "own_volumes"] {
            let volumes = numbers(&result[name]);
            assert!(is_close(volumes.iter().sum(), VOLUME, 1e-12), "{name}");
            let pairs = volumes.iter().zip(&graph.volume);
            assert!(
                pairs.into_iter().all(|(a, b)| is_close(*a, *b, 1e-9)),
                "{name}"
            );
        }
        assert!(result["normals_off"].as_f64().unwrap() < 1e-9, "{result}");
        assert_transmissibilities(&result, &model);
        let pairs = result["pairs"].as_array().unwrap();
        for (pair, c) in pairs.iter().zip(&graph.connections) {
            assert_eq!(numbers(pair), c.cells.map(f64::from));
        }
        for (cell, depth) in numbers(&result["depth"]).into_iter().enumerate() {
            assert!(is_close(depth, model.depth(cell), 1e-14));
        }
        let perm = result["perm"].as_array().unwrap();
        let first = numbers(&perm[0]);
        assert!(
            first.len() == k.len()
                && (0..k.len()).all(|i| is_close(first[i], k[i] * MILLIDARCY, 1e-14))
        );
        assert!(
            numbers(&result["region"])
                .iter()
                .all(|r| [1.0, 2.0].contains(r))
        );
        assert!(
            numbers(&result["poro"])
                .iter()
                .all(|p| (0.1..0.3).contains(p))
        );
        assert_named_faces(&result, &model);
        if mesh == "cells" {
            assert_steady_pressure(folder, &numbers(&result["pressure"]), ends, 1e-7);
        }
    }
    // Without rock there is no T.
    run(
        folder,
        "export cells.vtu --to mrst -o bare.mat --depth-at-top 0 --quiet",
    );
    assert!(folder.join("bare.mat").exists());
}

#[test]
#[ignore = "needs Octave: make test-all"]
fn octave_loads_the_grid_for_mrst() {
    let folder = folder();
    let folder = folder.path();
    let export = "export cells.vtu --to mrst -o cells.mat --depth-at-top 1000";
    let wells = "--injector 2,17,15:20 --producer 37,17,15:90 --producer 37,2,2:90";
    run(
        folder,
        &format!("{export} {ROCK} --property amplitude=sheet.npy {wells}"),
    );
    let model = model(folder, "cells.vtu", 1000.0, &[1.0], FaultLaw::OPEN);
    let program = "load cells.mat; n = strcmp(G.faces.tagNames, 'fault1');\
        printf('%d %d %d %d %d %d\\n', G.cells.num, numel(T), sum(G.faces.tag == find(n)), \
        numel(G.nodes.sets.fault1), numel(properties.amplitude), \
        sum(strcmp({W.type}, 'bhp') .* [W.val]));";
    let mut octave = Command::new("octave-cli");
    octave
        .current_dir(folder)
        .args(["--norc", "--eval", program]);
    let stdout = run_simulator(&mut octave);
    let result: Vec<usize> = stdout
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    let connections = &model.graph.connections;
    let feature_count = connections.iter().filter(|c| c.on_feature).count();
    assert_eq!(
        result[..2],
        [model.len(), connections.len() + model.graph.boundary.len()]
    );
    assert!(
        result[2] > 40 && result[2] <= feature_count && result[3] > 40,
        "{stdout}"
    );
    assert_eq!(result[4], model.len());
    assert_eq!(result[5], 2 * 90 * 100_000);
}

#[test]
#[ignore = "needs open-DARTS: make test-all"]
fn the_recipe_for_darts_in_the_documentation_runs() {
    let folder = folder();
    let folder = folder.path();
    run(
        folder,
        "export cells.vtu --to darts -o blocks.conn --depth-at-top 1000 --porosity 0.2 \
         --permeability 100 --permeability-unit mD --quiet",
    );
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/reference/exports.md")).unwrap();
    let (_, section) = text.split_once("## DARTS\n").unwrap();
    let block = |start: &str| {
        let (_, rest) = section.split_once(start).unwrap();
        rest.split_once("```").unwrap().0.to_string()
    };
    let check = "print(sum(mesh.volume), min(mesh.poro), min(mesh.depth) > 1000)\n";
    std::fs::write(folder.join("model.py"), block("```python\n") + check).unwrap();
    let bin = root.join(".venv/bin");
    let path = std::env::var("PATH").unwrap_or_default();
    let output = Command::new("sh")
        .args(["-e", "-c", &block("```sh\n")])
        .env("PATH", format!("{}:{path}", bin.display()))
        .current_dir(folder)
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stdout}\n{stderr}");
    let words: Vec<&str> = stdout.split_whitespace().collect();
    let &[.., volume, porosity, is_deep] = &words[..] else {
        panic!("{stdout}")
    };
    let volume: f64 = volume.parse().unwrap();
    assert!(is_close(volume, 39.0 * 35.0 * 31.0, 1e-9), "{stdout}");
    assert_eq!((porosity, is_deep), ("0.2", "True"), "{stdout}");
}

#[test]
#[ignore = "needs open-DARTS: make test-all"]
fn darts_runs_on_exported_connections_and_on_the_gmsh_mesh() {
    let folder = folder();
    let folder = folder.path();
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --quiet";
    let export = "export cells.vtu --to darts -o blocks.conn --depth-at-top 1000";
    run(folder, &format!("{export} {rock} --faults {TIGHT}"));
    run(folder, "export tets.vtu --to msh2 -o tets.msh --quiet");
    // The blocks are the most distant ones along x.
    let ends = |mesh: &str| {
        let model = model(folder, mesh, 1000.0, &[100.0], FaultLaw::OPEN);
        [[2.0, 17.0, -1015.0], [37.0, 17.0, -1015.0]].map(|p| nearest_cell(&model, p))
    };
    let darts = |files: &[&str], [high, low]: [usize; 2]| {
        let files: Vec<_> = files.iter().map(|f| folder.join(f)).collect();
        let blocks = [high, low].map(|c| c.to_string());
        let mut arguments: Vec<&OsStr> = files.iter().map(|f| f.as_os_str()).collect();
        arguments.extend(blocks.iter().map(OsStr::new));
        run_validator("open-DARTS", "steady.py", &arguments)
    };
    let blocks = ends("cells.vtu");
    let result = darts(&["blocks.conn", "blocks.cells"], blocks);
    assert_steady_pressure(folder, &numbers(&result["pressure"]), blocks, 1e-3);

    // DARTS computes two-point fluxes between tetrahedra, which are inaccurate, so that only the
    // direction of flow is checked.
    let blocks = ends("tets.vtu");
    let result = darts(&["tets.msh"], blocks);
    let (pressure, volume) = (numbers(&result["pressure"]), numbers(&result["volume"]));
    let model = model(folder, "tets.vtu", 1000.0, &[100.0], FaultLaw::OPEN);
    assert_eq!(pressure.len(), model.len());
    for (cell, volume) in volume
        .iter()
        .enumerate()
        .filter(|(c, _)| !blocks.contains(c))
    {
        assert!(is_close(*volume, model.graph.volume[cell], 1e-9));
    }
    assert!(
        pressure
            .iter()
            .all(|p| (199.0 - 1e-3..=201.0 + 1e-3).contains(p))
    );
    let side = |left: bool| {
        let is_on_side = |c: &usize| (model.graph.site[*c][0] < 19.5) == left;
        let pressures: Vec<f64> = (0..model.len())
            .filter(is_on_side)
            .map(|c| pressure[c])
            .collect();
        pressures.iter().sum::<f64>() / pressures.len() as f64
    };
    assert!(
        side(true) > side(false) + 0.05,
        "{} {}",
        side(true),
        side(false)
    );
}

#[test]
#[ignore = "needs SciPy and open-DARTS: make test-all"]
fn mrst_and_darts_have_the_wells_of_the_model() {
    let folder = folder();
    let folder = folder.path();
    // The rate is 20 m3/day of water of 1 cP, and the producer has a pressure of 90 bar.
    let (rate, bottom) = (20.0 / 86_400.0, 90e5);
    let wells = "--injector 2,17,15:20 --producer P=37,17,15:90";
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 1000";
    for (to, needs, script, files, unit, tolerance) in [
        ("mrst", "SciPy", "mrst.py", &["blocks.mat"][..], 1.0, 1e-7),
        (
            "darts",
            "open-DARTS",
            "steady.py",
            &["blocks.conn", "blocks.cells", "blocks.wells"],
            1e5,
            1e-3,
        ),
    ] {
        let export = format!("export cells.vtu --to {to} -o {} {rock} {wells}", files[0]);
        let stdout = run(folder, &format!("{export} --faults {TIGHT} --json --quiet"));
        let report: Value = serde_json::from_str(&stdout).unwrap();
        let first_completion = |well: usize| numbers(&report["wells"][well]["cells"][0]);
        let [injector, producer] = [0, 1].map(first_completion);
        let files: Vec<_> = files.iter().map(|f| folder.join(f)).collect();
        let arguments: Vec<&OsStr> = files.iter().map(|f| f.as_os_str()).collect();
        let result = run_validator(needs, script, &arguments);
        let pressure: Vec<f64> = numbers(&result["pressure"])
            .iter()
            .map(|p| unit * p)
            .collect();
        let cells = [injector[0], producer[0]].map(|cell| cell as usize);
        assert_steady_pressure(folder, &pressure, cells, tolerance);
        // The injected rate leaves through the well index of the producer.
        let drawdown = rate * 1e-3 / producer[1];
        let error = pressure[cells[1]] - bottom - drawdown;
        assert!(
            error.abs() < tolerance.max(1e-6) * drawdown,
            "{to}: {error} of {drawdown}"
        );
    }
}

#[test]
#[ignore = "needs meshio: make test-all"]
fn triangles_of_the_plane_are_exported_as_triangles() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    crate::common::write_npy_2d(&folder.join("line.npy"), [60, 50], |[x, y]| {
        (-0.5 * ((0.6 * x as f32 - 0.8 * y as f32 + 3.0) / 1.5).powi(2)).exp()
    });
    run(folder, "mesh line.npy --distance 5 --quiet -o plane.vtu");
    let AnyMesh::Triangles(file) = read_any_vtu(&folder.join("plane.vtu")).unwrap() else {
        panic!("no triangles")
    };
    for (to, name, format, edges) in [
        ("msh", "a.msh", "gmsh", true),
        ("msh2", "b.msh", "gmsh", true),
        ("medit", "a.mesh", "medit", true),
        ("inp", "a.inp", "abaqus", false),
        ("nastran", "a.bdf", "nastran", true),
    ] {
        // meshio does not support elements of plane strain.
        let downs = if to == "inp" {
            &["y"][..]
        } else {
            &["-z", "y"]
        };
        for down in downs {
            let export = format!("export plane.vtu --to {to} -o {name} --down {down} --quiet");
            run(folder, &export);
            let path = folder.join(name);
            let arguments = [path.as_os_str(), OsStr::new(format)];
            let result = run_validator("meshio", "simplices.py", &arguments);
            assert_eq!(result["triangles"], file.mesh.triangles.len(), "{to}");
            let points = result["points"].as_array().unwrap();
            assert_eq!(points.len(), file.mesh.nodes.len(), "{to}");
            assert!(
                is_close(result["area"].as_f64().unwrap(), 59.0 * 49.0, 1e-9),
                "{to}"
            );
            // Edges are those of the four sides and of the line across.
            assert!(!edges || result["edges"].as_u64().unwrap() > 40, "{to}");
        }
    }
    let line = "export plane.vtu --to tetgen -o a.node".split(' ');
    let error = expect_refusal(folder, &line.collect::<Vec<_>>());
    assert!(error.contains("tetrahedra only"), "{error}");
}

/// Writes a row of boxes of 2 x 3 x 5 m along x.
fn write_row_of_boxes(path: &Path, count: usize) {
    let points = 4 * (count + 1);
    let mut text = format!(
        "# vtk DataFile Version 3.0\nrow\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {points} double\n"
    );
    for n in 0..points {
        text += &format!("{} {} {}\n", 2 * (n / 4), 3 * (n / 2 % 2), 5 * (n % 2));
    }
    text += &format!("CELLS {count} {}\n", 9 * count);
    for i in 0..count {
        let corners = [0, 4, 2, 6, 1, 5, 3, 7].map(|n| (4 * i + n).to_string());
        text += &format!("8 {}\n", corners.join(" "));
    }
    text += &format!("CELL_TYPES {count}\n{}", "11\n".repeat(count));
    std::fs::write(path, text).unwrap();
}

/// Transmissibility in cP m3/day/bar of the faces between boxes of 100 mD: the manual of Eclipse has
/// 0.00852702 for one millidarcy.
const BOX_TRANSMISSIBILITY: f64 = 0.008_527_02 * 100.0 * 15.0 / 2.0;

/// Format, file, the line before some rows, their number, a column of them (in `tough2` its first
/// character), and the value there in each row.
const ROWS_OF_DECKS: [(&str, &str, &str, usize, usize, f64); 10] = [
    ("opm", "A.DATA", "NNC", 4, 6, BOX_TRANSMISSIBILITY),
    ("opm", "A.DATA", "PORV", 1, 4, 0.2 * 30.0),
    ("darts", "a.conn", "# block_m", 4, 2, BOX_TRANSMISSIBILITY),
    ("darts", "a.conn", "# block_m", 4, 3, 7.5),
    ("pflotran", "a.uge", "CELLS", 5, 4, 30.0),
    ("pflotran", "a.uge", "CONNECTIONS", 4, 5, 15.0),
    ("tough2", "MESH", "ELEME", 5, 20, 30.0),
    ("tough2", "MESH", "CONNE", 4, 30, 1.0),
    ("tough2", "MESH", "CONNE", 4, 40, 1.0),
    ("tough2", "MESH", "CONNE", 4, 50, 15.0),
];

#[test]
fn decks_have_the_volumes_and_transmissibilities_of_five_boxes_in_a_row() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_row_of_boxes(&folder.join("row.vtk"), 5);
    let rock = "--porosity 0.2 --permeability 100,50,10 --permeability-unit mD";
    for (to, file, heading, row_count, column, expected) in ROWS_OF_DECKS {
        let export = format!("export row.vtk --to {to} -o {file} --length-unit m {rock} --quiet");
        run(folder, &format!("{export} --depth-at-top 1000"));
        let text = std::fs::read_to_string(folder.join(file)).unwrap();
        let lines = text.lines().skip_while(|line| !line.starts_with(heading));
        let rows = lines.skip(1).map(str::trim_start);
        let value = |row: &str| -> f64 {
            let word = match to {
                "tough2" => &row[column..column + 10],
                _ => row.split(' ').nth(column).unwrap(),
            };
            word.trim().parse().unwrap()
        };
        let is_row = |row: &&str| row.starts_with(|c: char| c == 'A' || c.is_ascii_digit());
        let values: Vec<f64> = rows.take_while(is_row).map(value).collect();
        assert_eq!(values.len(), row_count, "{to} {heading}");
        let is_right = |value: &f64| is_close(*value, expected, 1e-6);
        assert!(values.iter().all(is_right), "{to} {heading}: {values:?}");
    }
}

#[test]
fn impossible_exports_are_refused() {
    let folder = folder();
    let folder = folder.path();
    for (to, options, expected) in [
        ("mrst -o a.m", "--depth-at-top 0", "does not end in mat"),
        ("mrst -o a.mat", "", "above depth 0"),
        ("darts -o a.conn", "--depth-at-top 0", "porosity"),
        (
            "grdecl -o A.GRDECL",
            "--depth-at-top 0 --grid 3,3",
            "three numbers",
        ),
        (
            "grdecl -o A.GRDECL",
            "--depth-at-top 0 --grid 0,3,3",
            "three numbers",
        ),
        ("geos -o cells.vtu", "", "overwrite the mesh"),
    ] {
        let line = format!("export cells.vtu --to {to} {options}");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}\n{error}");
    }
}
