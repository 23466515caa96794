//! Tests `atomesh export` to GEOS, corner-point grids and RESQML: independent programs read the exported
//! files.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{is_close, numbers, run, run_simulator, run_validator, run_vtk_program};
use crate::simulators::{ROCK, TIGHT, VOLUME, folder, model};
use atomesh::model::flow::FaultLaw;
use atomesh::model::reservoir::{MILLIDARCY, Model};
use serde_json::Value;

/// Reads a mesh as GEOS does, and prints its cells, faces and sets as JSON.
const READ_GEOS_MESH: &str = "\
import json, sys
import numpy as np
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.util.numpy_support import vtk_to_numpy
reader = vtkXMLUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
size = vtkCellSizeFilter()
size.SetInputConnection(reader.GetOutputPort())
size.Update()
mesh = size.GetOutput()
data, points = mesh.GetCellData(), mesh.GetPointData()
kinds = np.array([mesh.GetCellType(c) for c in range(mesh.GetNumberOfCells())])
surface = kinds < 10
array = lambda name: vtk_to_numpy(data.GetArray(name))[~surface]
numbers, area = (vtk_to_numpy(data.GetArray(name))[surface] for name in ('attribute', 'Area'))
# As GEOS does: only 64-bit arrays are sets of nodes, and the nodes of cells of each number are one.
sets = {points.GetArrayName(k): set(np.flatnonzero(vtk_to_numpy(points.GetArray(k))).tolist())
        for k in range(points.GetNumberOfArrays()) if vtk_to_numpy(points.GetArray(k)).dtype == np.int64}
nodes = lambda c: [mesh.GetCell(c).GetPointId(i) for i in range(mesh.GetCell(c).GetNumberOfPoints())]
numbered = {}
for c, number in zip(np.flatnonzero(surface), numbers.tolist()):
    numbered.setdefault(number, set()).update(nodes(int(c)))
print(json.dumps({
    'kinds': sorted(set(kinds.tolist())), 'faces': numbers.tolist(),
    'area': {n: float(area[numbers == n].sum()) for n in numbered},
    'sets': {name: len(members) for name, members in sets.items()},
    'numbered': [[n for n in numbered if numbered[n] == members] for members in sets.values()],
    'attribute': array('attribute').tolist(), 'integer': array('attribute').dtype.kind,
    'perm': array('rockPerm_permeability')[0].tolist(),
    'pores': float((array('rockPorosity_referencePorosity') * array('Volume')).sum()),
    'volume': float(array('Volume').sum())}))";

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_the_mesh_for_geos() {
    let folder = folder();
    let folder = folder.path();
    // VTK divides polyhedra into tetrahedra in another way.
    for (mesh, kind, tolerance) in [("cells", 42, 1e-6), ("tets", 10, 1e-12)] {
        let export = format!("export {mesh}.vtu --to geos -o geos.vtu --region labels.npy");
        run(folder, &format!("{export} {ROCK}"));
        let result = run_vtk_program(READ_GEOS_MESH, &[&folder.join("geos.vtu")]);
        let kinds = numbers(&result["kinds"]);
        assert_eq!(kinds.last(), Some(&f64::from(kind)));
        for name in ["xmin", "zmax", "fault1", "interface_1_2"] {
            assert!(
                result["sets"][name].as_u64().unwrap() > 40,
                "{name}: {result}"
            );
        }
        // The sides have the numbers 1 to 6, and the first surface has 9. Each is a set of nodes,
        // too.
        let faces = numbers(&result["faces"]);
        let has_faces = |number: f64| faces.iter().filter(|f| **f == number).count() > 40;
        assert!((1..=6).all(|n| has_faces(f64::from(n))) && has_faces(9.0));
        for (number, area) in [("1", 35.0 * 31.0), ("4", 39.0 * 31.0), ("6", 39.0 * 35.0)] {
            let found_area = result["area"][number].as_f64().unwrap();
            assert!(
                is_close(found_area, area, 1e-9),
                "{mesh}: {found_area} of {area}"
            );
        }
        let sets = result["numbered"].as_array().unwrap();
        assert!(
            sets.len() >= 8 && sets.iter().all(|numbers| numbers[0].is_u64()),
            "{result}"
        );
        assert!(
            kinds
                .iter()
                .rev()
                .skip(1)
                .all(|kind| [5.0, 7.0].contains(kind))
        );
        assert_eq!(result["integer"], "i");
        let regions = numbers(&result["attribute"]);
        assert!(regions.contains(&1.0) && regions.contains(&2.0));
        assert!(regions.iter().all(|r| [1.0, 2.0].contains(r)));
        let k = [100.0, 100.0, 10.0].map(|k| k * MILLIDARCY);
        let perm = numbers(&result["perm"]);
        assert!((0..3).all(|i| is_close(perm[i], k[i], 1e-14)), "{perm:?}");
        assert!(
            is_close(result["volume"].as_f64().unwrap(), VOLUME, tolerance),
            "{mesh}"
        );
        let pore_volume = (0.1 + 0.005 * 19.5) * VOLUME;
        assert!(
            is_close(result["pores"].as_f64().unwrap(), pore_volume, 1e-6),
            "{mesh}"
        );
    }
}

/// Returns a deck that includes a corner-point grid and nothing else of atomesh.
fn deck(dims: &[f64]) -> String {
    let [n, m, k] = dims else { panic!("{dims:?}") };
    format!(
        "RUNSPEC\nDIMENS\n {n} {m} {k} /\nWATER\nMETRIC\nSTART\n 1 JAN 2000 /\nTABDIMS\n/\n\
         REGDIMS\n 9 /\nUNIFOUT\nGRID\nINIT\nINCLUDE\n 'GRID.GRDECL' /\nPROPS\nPVTW\n 200 1 4E-5 1 0 /\n\
         ROCK\n 200 4E-5 /\nDENSITY\n 850 1000 1 /\nREGIONS\nINCLUDE\n 'GRID-regions.GRDECL' /\n\
         SOLUTION\nEQUIL\n 1000 100 /\nSUMMARY\nFPR\nSCHEDULE\nRPTRST\n BASIC=2 /\nTSTEP\n 1 /\nEND\n"
    )
}

/// Runs the deck `CASE.DATA` with OPM Flow and returns what resfo reads in its results.
fn run_flow(folder: &Path) -> Value {
    let mut flow = Command::new("flow");
    flow.current_dir(folder)
        .args(["CASE.DATA", "--output-dir=out"]);
    flow.args(["--enable-tuning=false", "--threads-per-process=1"]);
    run_simulator(&mut flow);
    let out = folder.join("out");
    let arguments = [out.as_os_str(), OsStr::new("CASE")];
    run_validator("resfo", "opm.py", &arguments)
}

/// Checks that of 13 columns along x, that of the fault is 100 times less permeable than the others.
fn assert_tight_column(result: &Value) {
    let transmissibilities = result["tranx"].as_array().unwrap().iter();
    let transmissibilities: Vec<f64> = transmissibilities
        .filter_map(Value::as_f64)
        .filter(|t| *t > 0.0)
        .collect();
    let max = transmissibilities.iter().copied().fold(0.0, f64::max);
    let tight = transmissibilities
        .iter()
        .filter(|t| **t < 2.0 * TIGHT * max)
        .count();
    assert_eq!(transmissibilities.len(), 12 * 9 * 7);
    assert_eq!(tight, 9 * 7);
}

/// Checks that pillars are parallel to the fault.
fn assert_pillars_lean(result: &Value) {
    // The fault moves 0.1 sideways per unit of z, and so do its pillars.
    let mut lean = numbers(&result["lean"]);
    lean.sort_by(f64::total_cmp);
    let (median, max) = (lean[lean.len() / 2], lean[lean.len() - 1]);
    println!(
        "pillars lean {median:.2} to {max:.2}, {} split",
        result["split"]
    );
    assert!((median - 3.1).abs() < 0.2 && max < 4.5, "{median}, {max}");
}

#[test]
#[ignore = "needs xtgeo, OPM Flow and resfo: make test-all"]
fn xtgeo_and_opm_flow_read_the_corner_point_grid() {
    let folder = folder();
    let folder = folder.path();
    let model = model(folder, "cells.vtu", 1000.0, &[1.0], FaultLaw::OPEN);
    let export = "export cells.vtu --to grdecl -o GRID.GRDECL --depth-at-top 1000";
    let pore_volume = (0.1 + 0.005 * 19.5) * VOLUME;
    for (grid, region) in [("", "--region labels.npy"), ("--grid 13,9,7", "")] {
        run(
            folder,
            &format!("{export} {ROCK} --faults {TIGHT} {grid} {region}"),
        );
        let files = ["GRID.GRDECL", "GRID-regions.GRDECL"].map(|f| folder.join(f));
        let arguments = [files[0].as_os_str(), files[1].as_os_str()];
        let result = run_validator("xtgeo", "corners.py", &arguments);
        println!("{}", result["dims"]);
        let number = |name: &str| result[name].as_f64().unwrap();
        let dims = numbers(&result["dims"]);
        // Layers that follow regions are bent. xtgeo triangulates their faces, which is less
        // accurate.
        let tolerance = if region.is_empty() { 1e-9 } else { 1e-5 };
        assert!(
            is_close(number("volume"), VOLUME, tolerance),
            "{}",
            number("volume")
        );
        assert!(number("least") > 0.0);
        let property = |name: &str| numbers(&result["properties"][name]);
        assert!(
            is_close(property("PORO")[1], pore_volume, 0.01),
            "{:?}",
            property("PORO")
        );
        for (name, k) in [("PERMX", 100.0), ("PERMY", 100.0), ("PERMZ", 10.0)] {
            let [min, _, max] = property(name)[..] else {
                panic!()
            };
            assert!(is_close(min, k, 1e-5) && is_close(max, k, 1e-5), "{name}");
        }
        assert_pillars_lean(&result);
        let text = std::fs::read_to_string(&files[0]).unwrap();
        let expected = format!("MULTFLT\n 'FAULT1' {TIGHT} /\n");
        let faults = text.contains("FAULTS\n 'FAULT1' ");
        assert!(
            faults && text.contains(&expected),
            "{faults} {grid} {region}"
        );
        assert!(!text.contains("MULTX"));
        if region.is_empty() {
            assert_eq!(dims, [13.0, 9.0, 7.0]);
            assert_eq!(number("split"), 0.0);
        } else {
            let cells: f64 = dims.iter().product();
            assert!(
                (0.7..1.5).contains(&(cells / model.len() as f64)),
                "{dims:?}"
            );
            // The throw of 8 splits only the row of pillars on the fault.
            let split = number("split");
            assert!((0.8..=1.3).contains(&(split / (dims[1] + 1.0))), "{split}");
            let region_volume = |r: &str| result["regions"][r].as_f64().unwrap();
            // The fault cuts the box at x = 18.45 + 1.75 on average, which gives the volume of the
            // lower label.
            let lower = 35.0 * (20.0 * 11.5 + 19.0 * 19.5);
            println!("lower {:.4} of {lower}", region_volume("2"));
            assert!(
                is_close(region_volume("2"), lower, 0.03),
                "{}",
                region_volume("2")
            );
            assert!(is_close(
                region_volume("1") + region_volume("2"),
                VOLUME,
                1e-5
            ));
        }
        std::fs::write(folder.join("CASE.DATA"), deck(&dims)).unwrap();
        let result = run_flow(folder);
        let porv = numbers(&result["porv"]).iter().sum::<f64>();
        assert!(is_close(porv, pore_volume, 0.01), "{porv}");
        if region.is_empty() {
            assert_tight_column(&result);
        }
    }
}

/// Checks the names of faces, and the sets of nodes of these faces, in a RESQML model.
fn assert_names(properties: &serde_json::Map<String, Value>, model: &Model) {
    let faces = &properties["names of faces"];
    assert_eq!(
        [&faces[0], &faces[4]],
        [&Value::from("categorical"), &Value::from("faces")]
    );
    let connections = &model.graph.connections;
    let of_faces = faces[5].as_array().unwrap();
    assert_eq!(of_faces.len(), model.mesh.face_cells.len());
    let named = |name: &str| of_faces.iter().filter(|f| **f == name).count();
    let feature_count = connections.iter().filter(|c| c.on_feature).count();
    assert!(named("fault1") > 40 && named("fault1") <= feature_count);
    assert!(named("xmin") > 20 && named("interface_1_2") > 40);
    for name in ["xmin", "zmax", "fault1", "interface_1_2"] {
        let nodes = &properties[name];
        assert_eq!(nodes[4], "nodes");
        let members = numbers(&nodes[3]);
        assert_eq!(members.len(), model.mesh.nodes.len());
        assert!(members.iter().sum::<f64>() > 40.0, "{name}");
    }
}

#[test]
#[ignore = "needs resqpy: make test-all"]
fn resqpy_reads_volumes_orientation_and_rock() {
    let folder = folder();
    let folder = folder.path();
    for (mesh, shape) in [("cells", "polyhedral"), ("tets", "tetrahedral")] {
        let export = format!("export {mesh}.vtu --to resqml -o {mesh}.epc --depth-at-top 1000");
        let options = "--region labels.npy --property amplitude=sheet.npy";
        run(folder, &format!("{export} {ROCK} {options}"));
        let model = model(
            folder,
            &format!("{mesh}.vtu"),
            1000.0,
            &[1.0],
            FaultLaw::OPEN,
        );
        let path = folder.join(format!("{mesh}.epc"));
        let result = run_validator("resqpy", "resqml.py", &[path.as_os_str()]);
        assert_eq!(result["shape"], shape);
        assert_eq!(
            (&result["up"], &result["units"]),
            (&true.into(), &vec!["m", "m"].into())
        );
        assert_eq!(result["cells"], model.len());
        let handed = numbers(&result["handed"]);
        assert!(is_close(handed.iter().sum(), VOLUME, 1e-12), "{mesh}");
        let expected = &model.graph.volume;
        assert!(
            handed
                .iter()
                .zip(expected)
                .all(|(a, b)| is_close(*a, *b, 1e-9)),
            "{mesh}"
        );
        let volumes = result["volume"].as_object().unwrap();
        assert!(volumes.len() > 200);
        for (cell, volume) in volumes {
            let expected = expected[cell.parse::<usize>().unwrap()];
            assert!(
                is_close(volume.as_f64().unwrap(), expected, 1e-9),
                "{mesh} {cell}"
            );
        }
        let properties = result["properties"].as_object().unwrap();
        assert_names(properties, &model);
        for (title, kind, unit, facet, value) in [
            ("permeability x", "permeability rock", "mD", "I", 100.0),
            ("permeability y", "permeability rock", "mD", "J", 100.0),
            ("permeability z", "permeability rock", "mD", "K", 10.0),
        ] {
            let property = &properties[title];
            assert_eq!(
                [&property[0], &property[1], &property[2]],
                [kind, unit, facet]
            );
            assert!(
                numbers(&property[3])
                    .iter()
                    .all(|k| is_close(*k, value, 1e-12))
            );
        }
        let porosity = numbers(&properties["porosity"][3]);
        let pore_volume: f64 = porosity
            .iter()
            .zip(&model.graph.volume)
            .map(|(p, v)| p * v)
            .sum();
        assert!(is_close(pore_volume, (0.1 + 0.005 * 19.5) * VOLUME, 1e-6));
        let regions = numbers(&properties["region"][3]);
        assert!(regions.contains(&1.0) && regions.contains(&2.0));
        // The export of a model always has the same bytes.
        let bytes = |name: &str| std::fs::read(folder.join(name)).unwrap();
        let (epc, h5) = (bytes(&format!("{mesh}.epc")), bytes(&format!("{mesh}.h5")));
        run(folder, &format!("{export} {ROCK} {options}"));
        assert!(bytes(&format!("{mesh}.epc")) == epc && bytes(&format!("{mesh}.h5")) == h5);
    }
}
