//! Tests meshes that end at a topography: what other programs read of them.

use std::path::Path;
use std::process::Command;

use crate::common::{
    FAULT_DIMS, expect_refusal, is_close, numbers, planar_fault, run, run_simulator,
    run_vtk_program, write_npy,
};
use atomesh::store::read_vtu;
use serde_json::Value;

/// Height of the ground above the image in [`hill_mesh`].
fn hill(x: f64, y: f64) -> f64 {
    30.0 + 12.0 * (-((x - 20.0).powi(2) + (y - 15.0).powi(2)) / 400.0).exp()
}

/// Extent of the mesh of [`hill_mesh`] along x and y, and its depth below the top of the image.
const HILL_EXTENT: [f64; 3] = [39.0 + 50.0, 35.0 + 50.0, 31.0 + 20.0];

/// Makes a mesh that ends at a hill, from points: `hill.vtu`, `hill.inp` and `hill.exo`.
fn hill_mesh(folder: &Path) -> Value {
    write_npy(&folder.join("i.npy"), FAULT_DIMS, planar_fault(FAULT_DIMS));
    let width = |k: usize, i: i32| f64::from(i) * HILL_EXTENT[k] / 60.0 - 25.0;
    let places = (0..=60).flat_map(|i| (0..=60).map(move |j| [width(0, i), width(1, j)]));
    let points = places.map(|[x, y]| format!("{x} {y} {}\n", -hill(x, y)));
    std::fs::write(folder.join("hill.xyz"), points.collect::<String>()).unwrap();
    let options = "--distance 6 --pad below=20,sides=25 --topography hill.xyz --quiet";
    run(
        folder,
        &format!("mesh i.npy -o hill.vtu --report r.json {options}"),
    );
    for (format, file) in [("inp", "hill.inp"), ("exodus", "hill.exo")] {
        run(
            folder,
            &format!("export hill.vtu --to {format} -o {file} --quiet"),
        );
    }
    serde_json::from_slice(&std::fs::read(folder.join("r.json")).unwrap()).unwrap()
}

/// Returns the volume between the hill and the base of [`hill_mesh`].
fn hill_volume() -> f64 {
    const N: u32 = 500;
    let middle = |k: usize, i: u32| (f64::from(i) + 0.5) * HILL_EXTENT[k] / f64::from(N) - 25.0;
    let places = (0..N).flat_map(|i| (0..N).map(move |j| (middle(0, i), middle(1, j))));
    let sum: f64 = places.map(|(x, y)| hill(x, y) + HILL_EXTENT[2]).sum();
    sum * HILL_EXTENT[0] * HILL_EXTENT[1] / f64::from(N * N)
}

#[test]
fn a_mesh_ends_at_a_topography_in_the_deck_of_calculix_and_for_flow() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let report = hill_mesh(folder);
    let deviation = report["padding"]["topography_deviation"].as_f64().unwrap();
    assert!((0.0..1.0).contains(&deviation), "{deviation}");
    assert!(run(folder, "validate hill.vtu").contains("passed"));
    assert!(run(folder, "quality hill.vtu").contains("valid"));

    // Nodes, tetrahedra and the set of nodes of the ground, as the deck has them.
    let text = std::fs::read_to_string(folder.join("hill.inp")).unwrap();
    let mut blocks: Vec<(&str, Vec<f64>)> = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with("**")) {
        if line.starts_with('*') {
            blocks.push((line, Vec::new()));
        } else if let Some((_, values)) = blocks.last_mut() {
            values.extend(line.split(',').filter_map(|w| w.trim().parse::<f64>().ok()));
        }
    }
    let block = |start: &str| {
        let found = blocks.iter().filter(|(line, _)| line.starts_with(start));
        found.flat_map(|(_, v)| v.clone()).collect::<Vec<f64>>()
    };
    let nodes = block("*NODE");
    let nodes: Vec<[f64; 3]> = nodes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|n| [n[1], n[2], n[3]])
        .collect();
    let tets = block("*ELEMENT, TYPE=C3D4");
    let volumes = tets.as_chunks::<5>().0.iter().map(|tet| {
        let [a, b, c, d] = [1, 2, 3, 4].map(|i| nodes[tet[i] as usize - 1]);
        let [u, v, w] = [b, c, d].map(|p| [0, 1, 2].map(|k| p[k] - a[k]));
        (u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0])
            + u[2] * (v[0] * w[1] - v[1] * w[0]))
            / 6.0
    });
    let volumes: Vec<f64> = volumes.collect();
    assert!(volumes.len() > 1000);
    assert!(volumes.iter().all(|volume| *volume > 0.0));
    assert!(is_close(volumes.iter().sum(), hill_volume(), 0.01));
    let ground = block("*NSET, NSET=NZMIN");
    assert!(ground.len() > 50);
    for node in ground {
        let [x, y, z] = nodes[node as usize - 1];
        // The points of the hill are joined by straight lines.
        assert!((z + hill(x, y)).abs() < 0.05, "{x} {y} {z}");
    }

    // Nothing flows if the ground and the base have the same pressure.
    let sides = "--pressure zmin=1e7 --pressure zmax=1e7 --permeability 100";
    run(
        folder,
        &format!("flow hill.vtu -o flow.vtu {sides} --quiet"),
    );
    let flow = read_vtu(&folder.join("flow.vtu")).unwrap();
    let pressure = flow
        .point_data
        .iter()
        .find(|a| a.name == "pressure")
        .unwrap();
    assert!((pressure.values.to_f64().iter()).all(|p| is_close(*p, 1e7, 1e-6)));

    for (options, expected) in [
        ("--topography hill.xyz", "add --pad"),
        (
            "--pad sides=60 --topography hill.xyz",
            "does not cover the mesh",
        ),
        ("--pad sides=25 --topography i.npy", "i.npy"),
    ] {
        let line = format!("mesh i.npy -o e.vtu --distance 6 {options}");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{error}");
        assert!(!folder.join("e.vtu").exists());
    }
}

#[test]
#[ignore = "needs VTK and CalculiX: make test-all"]
fn vtk_and_calculix_read_a_mesh_that_ends_at_a_topography() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    hill_mesh(folder);
    let program = "\
import json, sys
import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.vtkIOExodus import vtkExodusIIReader
reader = vtkExodusIIReader()
reader.SetFileName(sys.argv[1])
reader.UpdateInformation()
for kind in [reader.ELEM_BLOCK, reader.SIDE_SET]:
    for i in range(reader.GetNumberOfObjects(kind)):
        reader.SetObjectStatus(kind, i, 1)
reader.Update()
iterator = reader.GetOutput().NewIterator()
volumes, ground = [], []
while not iterator.IsDoneWithTraversal():
    name = iterator.GetCurrentMetaData().Get(reader.GetOutput().NAME())
    grid = iterator.GetCurrentDataObject()
    if name == 'zmin':
        ground = vtk_to_numpy(grid.GetPoints().GetData()).tolist()
    elif grid.GetCellType(0) == 10:
        sizes = vtkCellSizeFilter()
        sizes.SetInputData(grid)
        sizes.Update()
        volumes += vtk_to_numpy(sizes.GetOutput().GetCellData().GetArray('Volume')).tolist()
    iterator.GoToNextItem()
print(json.dumps({'volumes': volumes, 'ground': np.ravel(ground).tolist()}))";
    let read = run_vtk_program(program, &[&folder.join("hill.exo")]);
    let volumes = numbers(&read["volumes"]);
    assert!(volumes.iter().all(|volume| *volume > 0.0));
    assert!(is_close(volumes.iter().sum(), hill_volume(), 0.01));
    let ground = numbers(&read["ground"]);
    assert!(ground.len() > 150);
    for [x, y, z] in ground.as_chunks::<3>().0 {
        assert!((z + hill(*x, *y)).abs() < 0.05, "{x} {y} {z}");
    }

    // A pressure on the ground is borne by the base: the pressure times the area as seen from above.
    let job = "*INCLUDE, INPUT=hill.inp\n*MATERIAL, NAME=ROCK\n*ELASTIC\n1E9, 0.2\n\
               *SOLID SECTION, ELSET=EALL, MATERIAL=ROCK\n*STEP\n*STATIC\n*BOUNDARY\n\
               NXMIN, 1, 1, 0.0\nNXMAX, 1, 1, 0.0\nNYMIN, 2, 2, 0.0\nNYMAX, 2, 2, 0.0\n\
               NZMAX, 3, 3, 0.0\n*DSLOAD\nSZMIN, P, 1E3\n\
               *NODE PRINT, NSET=NZMAX, TOTALS=ONLY\nRF\n*END STEP\n";
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    let totals = std::fs::read_to_string(folder.join("job.dat")).unwrap();
    let force = numbers_of_last_line(&totals)[2];
    let expected = -1e3 * HILL_EXTENT[0] * HILL_EXTENT[1];
    assert!(is_close(force, expected, 1e-4), "{force} {expected}");
}

/// Returns the numbers of the last line of a text that has any.
fn numbers_of_last_line(text: &str) -> Vec<f64> {
    let last = text.lines().rfind(|line| !line.trim().is_empty()).unwrap();
    last.split_whitespace()
        .map(|word| word.parse().unwrap())
        .collect()
}
