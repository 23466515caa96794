//! Tests how `atomesh export` passes faults, horizons and sides of the box on: by name, with
//! multipliers, or split.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use crate::common::{
    atomesh, expect_refusal, planar_fault, run, run_python, run_simulator, run_validator,
    run_vtk_program, write_npy,
};
use atomesh::files::vtk::DataArray;
use atomesh::mesh::{FACES, TetMesh};
use atomesh::store::{MeshFile, write_vtu};
use serde_json::Value;

fn json(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, line)).unwrap()
}

fn read(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).unwrap()
}

/// Writes a mesh of a box of cubes with six tetrahedra each. `on` is true for the faces on
/// features.
fn write_box(path: &Path, n: [u32; 3], is_on_feature: impl Fn([[f64; 3]; 3]) -> bool) {
    let node = |[i, j, k]: [u32; 3]| i + (n[0] + 1) * (j + (n[1] + 1) * k);
    let mut mesh = TetMesh {
        nodes: Vec::new(),
        tets: Vec::new(),
    };
    for k in 0..=n[2] {
        for j in 0..=n[1] {
            mesh.nodes
                .extend((0..=n[0]).map(|i| [i, j, k].map(f64::from)));
        }
    }
    for index in 0..n[0] * n[1] * n[2] {
        let low = [index % n[0], index / n[0] % n[1], index / (n[0] * n[1])];
        for order in [
            [0, 1, 2],
            [1, 2, 0],
            [2, 0, 1],
            [1, 0, 2],
            [0, 2, 1],
            [2, 1, 0],
        ] {
            let mut corner = low;
            let mut tet = [node(low); 4];
            for (slot, axis) in tet[1..].iter_mut().zip(order) {
                corner[axis] += 1;
                *slot = node(corner);
            }
            // Odd permutations have the opposite orientation.
            if [[1, 0, 2], [0, 2, 1], [2, 1, 0]].contains(&order) {
                tet.swap(2, 3);
            }
            mesh.tets.push(tet);
        }
    }
    let bits = |tet: &[u32; 4]| {
        let marked = |k: &usize| is_on_feature(FACES[*k].map(|c| mesh.nodes[tet[c] as usize]));
        (0..4).filter(marked).fold(0u8, |bits, k| bits | 1 << k)
    };
    let bits: Vec<u8> = mesh.tets.iter().map(bits).collect();
    let file = MeshFile {
        mesh,
        cell_data: vec![DataArray::scalars("feature_faces", bits)],
        ..MeshFile::default()
    };
    write_vtu(path, &file).unwrap();
}

/// Returns the pairs of coincident faces of a file: the surface, the two cells, and the nodes of
/// both sides. Numbers begin at 1.
fn coincident_faces(text: &str) -> Vec<(String, [usize; 2], [[usize; 3]; 2])> {
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some("surface,cell_a,cell_b,a1,a2,a3,b1,b2,b3")
    );
    let row = |line: &str| {
        let (name, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<usize> = numbers.split(',').map(|n| n.parse().unwrap()).collect();
        let three = |at: usize| [0, 1, 2].map(|k| numbers[at + k]);
        (
            name.to_string(),
            [numbers[0], numbers[1]],
            [three(2), three(5)],
        )
    };
    lines.map(row).collect()
}

/// Returns the blocks of an Abaqus file: keyword lines, each with the rows that follow it.
fn blocks(text: &str) -> Vec<(&str, Vec<Vec<&str>>)> {
    let mut blocks: Vec<(&str, Vec<Vec<&str>>)> = Vec::new();
    for line in text.lines() {
        match line.strip_prefix('*') {
            Some(keyword) => blocks.push((keyword, Vec::new())),
            None => {
                let row = line.split(',').map(str::trim).collect();
                blocks.last_mut().unwrap().1.push(row);
            }
        }
    }
    blocks
}

fn node_positions(text: &str) -> Vec<[f64; 3]> {
    let blocks = blocks(text);
    let (_, rows) = blocks.iter().find(|b| b.0.starts_with("NODE,")).unwrap();
    rows.iter()
        .map(|row| [1, 2, 3].map(|k| row[k].parse().unwrap()))
        .collect()
}

/// Writes a mesh with two crossing faults, one of which ends inside.
fn write_crossing_faults(path: &Path) {
    write_box(path, [6, 6, 3], |face| {
        face.iter().all(|p| p[0] == 3.0) || face.iter().all(|p| p[1] == 3.0 && p[0] <= 5.0)
    });
}

#[test]
fn nodes_at_faults_have_a_copy_for_each_sector_except_at_tips() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_crossing_faults(&folder.join("mesh.vtu"));
    let surfaces = json(folder, "surface mesh.vtu -o s.vtp --json --quiet");
    let names: Vec<String> = (surfaces["surfaces"].as_array().unwrap().iter())
        .map(|s| format!("{}{}", s["kind"].as_str().unwrap(), s["surface"]))
        .collect();
    assert_eq!(names, ["fault1", "fault2"]);
    run(
        folder,
        "export mesh.vtu --to inp -o a.inp --split faults --quiet",
    );
    let text = read(folder, "a.inp");
    let nodes = node_positions(&text);
    let mut copies: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    for p in &nodes {
        *copies.entry(p.map(|x| x as i64)).or_default() += 1;
    }
    for ([x, y, z], count) in copies {
        let expected = match (x == 3, y == 3 && x < 5) {
            (true, true) => 4,
            (true, false) | (false, true) => 2,
            (false, false) => 1,
        };
        assert_eq!(count, expected, "at {x} {y} {z}");
    }

    // Coincident faces have their nodes in the same order. Cohesive elements consist of these
    // faces, and the normal of the first face points to the second cell.
    let twins = coincident_faces(&read(folder, "a-twins.csv"));
    assert_eq!(twins.len(), 2 * 6 * 3 + 2 * 5 * 3);
    let tets: Vec<Vec<usize>> = (blocks(&text).iter())
        .find(|b| b.0.starts_with("ELEMENT"))
        .map(|b| {
            b.1.iter()
                .map(|row| row[1..].iter().map(|n| n.parse().unwrap()).collect())
                .collect()
        })
        .unwrap();
    let mut sides: BTreeMap<&str, Vec<bool>> = BTreeMap::new();
    for (name, cells, pair) in &twins {
        for (cell, face) in cells.iter().zip(pair) {
            assert!(face.iter().all(|n| tets[cell - 1].contains(n)));
        }
        let [a, b, c] = pair[0].map(|n| nodes[n - 1]);
        assert_eq!([a, b, c], pair[1].map(|n| nodes[n - 1]));
        let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]];
        let height = |cell: usize| -> f64 {
            let mean = |k: usize| tets[cell - 1].iter().map(|n| nodes[n - 1][k]).sum::<f64>() / 4.0;
            (0..2).map(|k| normal[k] * (mean(k) - a[k])).sum()
        };
        assert!(height(cells[0]) < 0.0 && height(cells[1]) > 0.0);
        sides
            .entry(name)
            .or_default()
            .push(normal[0] + normal[1] > 0.0);
    }
    assert!(
        sides
            .values()
            .all(|side| side.iter().all(|up| *up == side[0]))
    );
    let cohesive = read(folder, "a-cohesive.inp");
    let elements: Vec<usize> = (blocks(&cohesive).iter())
        .inspect(|b| assert!(b.0.starts_with("ELEMENT, TYPE=COH3D6, ELSET=FAULT")))
        .flat_map(|b| b.1.iter().flat_map(|row| row[1..].to_vec()))
        .map(|n| n.parse().unwrap())
        .collect();
    let flat = twins.iter().flat_map(|t| t.2.as_flattened().to_vec());
    assert!(flat.eq(elements));

    // Each side is a set of faces and a set of nodes.
    for name in [
        "FAULT1_A", "FAULT1_B", "FAULT2_A", "FAULT2_B", "XMIN", "ZMAX",
    ] {
        assert!(text.contains(&format!("*NSET, NSET=N{name}\n")), "{name}");
        assert!(text.contains(&format!("*SURFACE, NAME=S{name}, TYPE=ELEMENT\n")));
    }
}

#[test]
fn impossible_splits_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_crossing_faults(&folder.join("mesh.vtu"));
    let error = expect_refusal(
        folder,
        &[
            "export", "mesh.vtu", "--to", "abaqus", "-o", "b.inp", "--split", "horizons",
        ],
    );
    assert!(
        error.contains("--split horizons: matches no surface"),
        "{error}"
    );
    let error = expect_refusal(
        folder,
        &[
            "export", "mesh.vtu", "--to", "medit", "-o", "b.mesh", "--split", "faults",
        ],
    );
    assert!(
        error.contains("--split") && error.contains("msh, msh2, inp"),
        "{error}"
    );
}

#[test]
#[ignore = "needs Gmsh: make test-all"]
fn gmsh_reads_split_meshes_with_prisms_between_their_sides() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_crossing_faults(&folder.join("mesh.vtu"));
    for version in ["msh", "msh2"] {
        run(
            folder,
            &format!("export mesh.vtu --to {version} -o a.msh --split 1 --quiet"),
        );
        assert_eq!(coincident_faces(&read(folder, "a-twins.csv")).len(), 36);
        let result = run_validator("Gmsh", "physical.py", &[folder.join("a.msh").as_os_str()]);
        assert_eq!(result["tets"], 6 * 6 * 6 * 3);
        assert!((result["volume"].as_f64().unwrap() - 108.0).abs() < 1e-9);
        let count = |dim: u64, name: &str| {
            let groups = result["groups"].as_array().unwrap().iter();
            let mut matching = groups.filter(|g| g[0] == dim && g[1] == name);
            matching.next().map_or(0, |g| g[2].as_u64().unwrap())
        };
        let counts = [
            (2, "fault1_a"),
            (2, "fault1_b"),
            (3, "fault1"),
            (2, "fault2"),
            (2, "xmin"),
        ];
        assert_eq!(
            counts.map(|(dim, name)| count(dim, name)),
            [36, 36, 36, 30, 36]
        );
        assert_eq!(count(3, "region0"), 648);
    }
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn geos_finds_the_collocated_nodes_of_each_fracture() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_crossing_faults(&folder.join("mesh.vtu"));
    run(
        folder,
        "export mesh.vtu --to geos -o a.vtu --split faults --quiet",
    );
    let program = "\
import json, sys
import numpy as np
from vtkmodules.vtkIOXML import vtkXMLMultiBlockDataReader
from vtkmodules.util.numpy_support import vtk_to_numpy
reader = vtkXMLMultiBlockDataReader()
reader.SetFileName(sys.argv[1])
reader.Update()
blocks = reader.GetOutput()
points = lambda block: vtk_to_numpy(block.GetPoints().GetData())
main, fractures = blocks.GetBlock(0), []
for b in range(1, blocks.GetNumberOfBlocks()):
    block = blocks.GetBlock(b)
    collocated = vtk_to_numpy(block.GetPointData().GetArray('collocated_nodes'))
    is_node = collocated >= 0
    off = np.abs(points(main)[collocated] - points(block)[:, None]).max(axis=2)
    fractures.append({'cells': block.GetNumberOfCells(), 'off': float((off * is_node).max()),
                  'copies': sorted(set(is_node.sum(axis=1).tolist())), 'most': collocated.shape[1],
                  'integer': collocated.dtype.kind})
print(json.dumps({'points': main.GetNumberOfPoints(), 'blocks': fractures}))";
    let report = run_vtk_program(program, &[&folder.join("a.vtm")]);
    assert_eq!(report["points"], 7 * 7 * 4 + 4 * (6 + 4 + 3));
    let blocks = report["blocks"].as_array().unwrap();
    let cells: Vec<u64> = blocks
        .iter()
        .map(|b| b["cells"].as_u64().unwrap())
        .collect();
    assert_eq!(cells, [36, 30]);
    for block in blocks {
        assert_eq!(block["off"], 0.0);
        assert_eq!(
            (&block["most"], &block["integer"]),
            (&4.into(), &"i".into())
        );
    }
    assert_eq!(blocks[0]["copies"], serde_json::json!([2, 4]));
    // The second fault ends at a tip.
    assert_eq!(blocks[1]["copies"], serde_json::json!([1, 2, 4]));
}

/// Shears a block across a fault that has a stiffness. The displacement jumps by stress over
/// stiffness at the fault, and the strain is the same on both sides.
#[test]
#[ignore = "needs CalculiX: make test-all"]
fn calculix_finds_the_analytic_jump_across_a_split_fault() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_box(&folder.join("mesh.vtu"), [4, 3, 2], |face| {
        face.iter().all(|p| p[0] == 2.0)
    });
    run(
        folder,
        "export mesh.vtu --to inp -o mesh.inp --split 1 --quiet",
    );
    let nodes = node_positions(&read(folder, "mesh.inp"));
    // Each pair of nodes represents its share of the fault's area.
    let mut areas: BTreeMap<[usize; 2], f64> = BTreeMap::new();
    for (_, _, [a, b]) in coincident_faces(&read(folder, "mesh-twins.csv")) {
        for pair in a.into_iter().zip(b) {
            *areas.entry([pair.0, pair.1]).or_default() += 0.5 / 3.0;
        }
    }
    let total: f64 = areas.values().sum();
    assert!((total - 6.0).abs() < 1e-12, "{total}");
    let (modulus, stiffness, shift) = (1e4, 2.5e3, 0.05);
    let mut job = "*INCLUDE, INPUT=mesh.inp\n*MATERIAL, NAME=ROCK\n*ELASTIC\n2E4, 0.0\n\
                   *SOLID SECTION, ELSET=EALL, MATERIAL=ROCK\n"
        .to_string();
    for (i, ([a, b], area)) in areas.iter().enumerate() {
        let element = 1000 + i;
        let _ = writeln!(
            job,
            "*ELEMENT, TYPE=SPRING2, ELSET=P{i}\n{element}, {a}, {b}\n*SPRING, ELSET=P{i}\n2, 2\n{:.12e}",
            stiffness * area
        );
    }
    let _ = writeln!(
        job,
        "*STEP\n*STATIC\n*BOUNDARY\nNALL, 1, 1, 0.0\nNALL, 3, 3, 0.0\nNXMIN, 2, 2, 0.0\n\
         NXMAX, 2, 2, {shift}\n*NODE PRINT, NSET=NALL\nU\n*END STEP"
    );
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    // shift = 4 stress / modulus + stress / stiffness.
    let stress = shift / (4.0 / modulus + 1.0 / stiffness);
    let upper: Vec<usize> = areas.keys().map(|pair| pair[1]).collect();
    let lower: Vec<usize> = areas.keys().map(|pair| pair[0]).collect();
    let mut compared = 0;
    for line in read(folder, "job.dat").lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if let [node, _, y, _] = words[..]
            && let (Ok(node), Ok(y)) = (node.parse::<usize>(), y.parse::<f64>())
        {
            let x = nodes[node - 1][0];
            // The numbers of the cells decide which side is the lower one, not this test.
            let is_upper =
                x > 2.0 || x == 2.0 && is_on_right_side(&nodes, &read(folder, "mesh.inp"), node);
            let jump = if is_upper { stress / stiffness } else { 0.0 };
            let expected = stress / modulus * x + jump;
            assert!(
                (y - expected).abs() < 1e-6 * shift,
                "node {node} at {x}: {y}, not {expected}"
            );
            compared += 1;
        }
    }
    assert_eq!(compared, nodes.len());
    assert_eq!(upper.len() + lower.len(), 2 * 4 * 3);
}

/// Returns `true` if the tetrahedra at a node lie on the side of larger x.
fn is_on_right_side(nodes: &[[f64; 3]], text: &str, node: usize) -> bool {
    let blocks = blocks(text);
    let (_, tets) = blocks.iter().find(|b| b.0.starts_with("ELEMENT")).unwrap();
    let name = node.to_string();
    let tet = tets
        .iter()
        .find(|row| row[1..].contains(&name.as_str()))
        .unwrap();
    let x = |n: &&str| nodes[n.parse::<usize>().unwrap() - 1][0];
    tet[1..].iter().map(x).sum::<f64>() / 4.0 > 2.0
}

#[test]
fn horizons_are_open_and_each_fault_can_have_a_multiplier() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("layers.npy"), [40, 36, 32], |[x, y, _]| {
        let ricker = |distance: f32| {
            let t = (distance / 2.5).powi(2);
            (1.0 - 2.0 * t) * (-t).exp()
        };
        ricker(x as f32 - 12.0 - 0.05 * y as f32) - ricker(x as f32 - 27.0)
    });
    run(
        folder,
        "mesh layers.npy -o mesh.vtu --distance 5 --feature horizons --quiet",
    );
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 100";
    let export = format!("export mesh.vtu --to darts -o a.conn {rock} --json --quiet");
    let compartment_count = |faults: &str| {
        let report = json(folder, &format!("{export} {faults}"));
        assert!(report["checks"]["feature_connections"].as_u64().unwrap() > 50);
        report["checks"]["compartments"].as_array().unwrap().len()
    };
    assert_eq!(compartment_count("--faults closed"), 1);
    assert_eq!(compartment_count("--faults closed --barriers horizons"), 3);
    assert_eq!(compartment_count("--fault-multiplier 1:0"), 2);
    run(folder, "export mesh.vtu --to inp -o a.inp --quiet");
    let text = read(folder, "a.inp");
    assert!(text.contains("NSET=NHORIZON1\n") && text.contains("NSET=NHORIZON2\n"));

    write_crossing_faults(&folder.join("mesh.vtu"));
    let connections = |faults: &str| -> Vec<f64> {
        run(folder, &format!("{export} {faults}"));
        let text = read(folder, "a.conn");
        let transmissibilities = text
            .lines()
            .skip(1)
            .map(|line| line.split(' ').nth(2).unwrap().parse().unwrap());
        transmissibilities.collect()
    };
    let open = connections("");
    let multiplied = connections("--faults 0.5 --fault-multiplier 2:0.01");
    let count_scaled_by = |factor: f64| {
        let pairs = open.iter().zip(&multiplied);
        pairs
            .filter(|(a, b)| (factor * *a - *b).abs() < 1e-9 * *a)
            .count()
    };
    assert_eq!([count_scaled_by(0.5), count_scaled_by(0.01)], [36, 30]);
    assert_eq!(count_scaled_by(1.0), open.len() - 66);
    let error = expect_refusal(
        folder,
        &format!(
            "{} --fault-multiplier 9:0.5",
            export.trim_end_matches(" --quiet")
        )
        .split_whitespace()
        .collect::<Vec<_>>(),
    );
    assert!(
        error.contains("--fault-multiplier 9: matches no surface: the mesh has "),
        "{error}"
    );
}

/// Compares the flow around a slit with the analytic solution. A slit that leaves an opening of 15
/// in a channel of width W = 40 acts as 4 W / pi ln csc(pi d / 2 W) of additional channel length.
/// docs/reservoir.md explains the error of each kind of cell.
#[test]
#[ignore = "needs SciPy: make test-all"]
fn flow_around_the_tip_of_a_closed_fault_is_the_analytic_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("slit.npy"),
        [81, 41, 31],
        |[x, y, _]| match y {
            0..=25 => (-0.5 * ((x as f32 - 40.0) / 1.5).powi(2)).exp(),
            _ => 0.0,
        },
    );
    let (length, width, height, opening) = (80.0, 40.0, 30.0, 15.0f64);
    let angle = std::f64::consts::FRAC_PI_2 * opening / width;
    let extra_length = 4.0 * width / std::f64::consts::PI * angle.sin().recip().ln();
    let exact = height * width / (length + extra_length);
    let mesh = "mesh slit.npy --distance 5 --feature ridges --quiet -o";
    let ends = "--pressure xmin=1 --pressure xmax=0 --permeability 1 --viscosity 1 --json --quiet";
    // Tetrahedra end where the fault does. Voronoi cells and boxes extend it by up to a cell.
    for (cells, tolerance) in [("tets", 0.02), ("voronoi", 0.15)] {
        run(folder, &format!("{mesh} {cells}.vtu --cells {cells}"));
        let report = json(folder, &format!("flow {cells}.vtu -o f.vtu {ends}"));
        let rate = report["exchange"][0]["rate"].as_f64().unwrap();
        println!("{cells}: {:.3}", rate / exact);
        assert!(
            (rate / exact - 1.0).abs() < tolerance,
            "{cells}: {rate}, not {exact}"
        );
    }
    let export = "export tets.vtu --to grdecl -o a.GRDECL --permeability 1 --permeability-unit m2";
    for (faults, expected, tolerance) in [("open", 15.0, 1e-9), ("closed", exact, 0.1)] {
        let grid = "--grid 48,24,12 --depth-at-top 100 --quiet --down z";
        run(folder, &format!("{export} {grid} --faults {faults}"));
        let path = folder.join("a.GRDECL");
        let result = run_validator("SciPy", "corner_rate.py", &[path.as_os_str()]);
        let rate = result["rate"].as_f64().unwrap();
        println!("corner points, {faults}: {:.3}", rate / expected);
        assert!(
            (rate / expected - 1.0).abs() < tolerance,
            "{rate}, not {expected}"
        );
    }
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_runs_the_corner_point_deck_with_its_wells() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let dims = [40, 36, 32];
    write_npy(&folder.join("sheet.npy"), dims, planar_fault(dims));
    run(
        folder,
        "mesh sheet.npy --distance 6 --quiet -o cells.vtu --cells voronoi",
    );
    // The wells cross the fault obliquely.
    std::fs::write(folder.join("INJ.csv"), "5,5,4,0.1\n5,5,28,0.1\n").unwrap();
    std::fs::write(
        folder.join("PROD.csv"),
        "34,30,2,0.1\n30,28,20,0.1\n30,20,20,0.1\n",
    )
    .unwrap();
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --down z --quiet";
    let wells = "--injector INJ.csv:20 --producer PROD.csv:95 --pressure-at-top 100 --days 3650";
    let export = format!("export cells.vtu --to grdecl -o A.GRDECL --depth-at-top 1000 {rock}");
    run(
        folder,
        &format!("{export} {wells} --grid 10,9,8 --faults 0.01"),
    );
    let deck = read(folder, "A.DATA");
    let completions: Vec<Vec<&str>> = (deck.split_once("COMPDAT\n").unwrap().1.lines())
        .take_while(|line| *line != "/")
        .map(|line| line.split_whitespace().collect())
        .collect();
    let completions_of = |name: &str| {
        completions
            .iter()
            .filter(|row| row[0] == name)
            .collect::<Vec<_>>()
    };
    // The injector is vertical while pillars lean a little. It crosses the layers from 4 to 28 of
    // 31, in the row of y = 5.
    let injector = completions_of("INJ");
    assert!(injector.iter().all(|row| row[2] == "2"), "{injector:?}");
    let mut layers: Vec<&str> = injector.iter().map(|row| row[3]).collect();
    layers.dedup();
    assert_eq!(layers, ["2", "3", "4", "5", "6", "7", "8"]);
    // The producer continues along j in one layer.
    let rows: Vec<&str> = completions_of("PROD").iter().map(|row| row[2]).collect();
    assert!(rows.contains(&"8") && rows.contains(&"6"), "{rows:?}");
    let mut flow = Command::new("flow");
    flow.current_dir(folder)
        .args(["A.DATA", "--output-dir=out"]);
    flow.args(["--enable-tuning=false", "--threads-per-process=1"]);
    run_simulator(&mut flow);
    let program = "import resfo, sys\n\
        word = lambda w: (w.decode() if isinstance(w, bytes) else w).strip()\n\
        smspec = {word(k): v for k, v in resfo.read(sys.argv[1] + '.SMSPEC')}\n\
        wells = smspec.get('WGNAMES', smspec.get('NAMES'))\n\
        names = [word(k) + ':' + word(w) for k, w in zip(smspec['KEYWORDS'], wells)]\n\
        last = [v for k, v in resfo.read(sys.argv[1] + '.UNSMRY') if k.strip() == 'PARAMS'][-1]\n\
        print({n: float(v) for n, v in zip(names, last)})";
    let case = folder.join("out/A");
    let rates = run_python(
        "resfo",
        &[OsStr::new("-c"), OsStr::new(program), case.as_os_str()],
    );
    let rates: Value = serde_json::from_str(&rates.replace('\'', "\"")).unwrap();
    let rate = |name: &str| rates[name].as_f64().unwrap();
    assert!((rate("WWIR:INJ") - 20.0).abs() < 1e-3, "{rates}");
    assert!((rate("WWPR:PROD") / 20.0 - 1.0).abs() < 0.01, "{rates}");
}

#[test]
fn a_producer_above_the_initial_pressure_gives_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_box(&folder.join("mesh.vtu"), [4, 3, 2], |_| false);
    let rock = "--porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 100";
    let stderr_at = |bar: &str| {
        let line = format!(
            "export mesh.vtu --to opm -o A.DATA {rock} --pressure-at-top 150 --well-radius 0.01 --producer 1.4,1.2,1.1:{bar}"
        );
        let words: Vec<&str> = line.split_whitespace().collect();
        let output = atomesh(folder).args(words).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stderr).unwrap()
    };
    let high = stderr_at("180");
    assert!(
        high.contains("note: producer P1: its pressure of 180 bar is not below"),
        "{high}"
    );
    assert!(!stderr_at("140").contains("producer"));
}
