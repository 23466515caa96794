//! Tests `atomesh mesh` on the command line: image in, mesh out.

use std::path::Path;

use crate::common::{
    Survey, atomesh, files_below, planar_fault, run, run_args, run_vtk_program, write_npy,
    write_segy,
};
use serde_json::Value;

const DIMS: [usize; 3] = [44, 36, 32];

/// Returns a folder with `image.npy`, the image of one tilted planar fault.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("image.npy"), DIMS, planar_fault(DIMS));
    folder
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// Python program that prints what VTK reads in a mesh file: counts, bounds, volume, array names
/// and invalid cells.
const INSPECT: &str = r#"
import json, sys
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
from vtkmodules.vtkFiltersGeneral import vtkCellValidator
errors = []
reader = vtkXMLUnstructuredGridReader()
reader.AddObserver("ErrorEvent", lambda *a: errors.append("reader"))
reader.SetFileName(sys.argv[1])
reader.Update()
grid = reader.GetOutput()
validator = vtkCellValidator()
validator.AddObserver("ErrorEvent", lambda *a: errors.append("validator"))
validator.SetInputData(grid)
validator.Update()
states = validator.GetOutput().GetCellData().GetArray("ValidityState")
volume = grid.GetCellData().GetArray("volume")
kinds = grid.GetPointData().GetArray("atom_kind")
names = lambda data: [data.GetAbstractArray(k).GetName() for k in range(data.GetNumberOfArrays())]
geometric = 0.0
for k in range(grid.GetNumberOfCells()):
    p = [grid.GetPoint(grid.GetCell(k).GetPointId(i)) for i in range(4)]
    a, b, c = ([p[i][j] - p[0][j] for j in range(3)] for i in (1, 2, 3))
    det = (a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
           + a[2] * (b[0] * c[1] - b[1] * c[0]))
    if det <= 0:
        errors.append("inverted cell %d" % k)
    geometric += det / 6
units = {}
for data in (grid.GetCellData(), grid.GetPointData()):
    for k in range(data.GetNumberOfArrays()):
        array = data.GetAbstractArray(k)
        if array.HasInformation() and array.GetInformation().Has(array.UNITS_LABEL()):
            units[array.GetName()] = array.GetInformation().Get(array.UNITS_LABEL())
print(json.dumps({
    "units": units, "points": grid.GetNumberOfPoints(), "cells": grid.GetNumberOfCells(), "bounds": grid.GetBounds(),
    "invalid": sum(states.GetTuple1(k) != 0 for k in range(states.GetNumberOfTuples())),
    "volume": sum(volume.GetTuple1(k) for k in range(volume.GetNumberOfTuples())),
    "geometric_volume": geometric,
    "corners": sum(kinds.GetTuple1(k) == 3 for k in range(kinds.GetNumberOfTuples())),
    "point_data": names(grid.GetPointData()), "cell_data": names(grid.GetCellData()),
    "field_data": names(grid.GetFieldData()), "errors": errors[:5],
}))
"#;

#[test]
fn an_image_gives_a_valid_mesh() {
    let folder = folder();
    let table = run_args(
        folder.path(),
        &[
            "mesh",
            "image.npy",
            "--distance",
            "6",
            "--report",
            "r.json",
            "--potential-out",
            "b.vti",
        ],
    );
    assert!(table.lines().count() > 5, "{table}");
    json(&std::fs::read_to_string(folder.path().join("r.json")).unwrap());
    let names: Vec<_> = files_below(folder.path())
        .into_iter()
        .map(|(path, _)| path.file_name().unwrap().to_str().unwrap().to_string())
        .collect();
    assert_eq!(names, ["b.vti", "image.npy", "image.vtu", "r.json"]);

    let verdict = json(&run_args(
        folder.path(),
        &["validate", "image.vtu", "--json"],
    ));
    assert_eq!(verdict["valid"], true, "{verdict}");
    run_args(folder.path(), &["quality", "image.vtu"]);
    json(&run_args(
        folder.path(),
        &["quality", "image.vtu", "--json"],
    ));
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_the_box_and_every_array() {
    let folder = folder();
    run_args(folder.path(), &["mesh", "image.npy", "--distance", "6"]);
    let result = run_vtk_program(INSPECT, &[&folder.path().join("image.vtu")]);
    assert_eq!(result["errors"], serde_json::json!([]));
    assert_eq!(result["invalid"], 0);
    assert_eq!(result["corners"], 8);
    assert_eq!(
        result["point_data"],
        serde_json::json!(["atom_kind", "feature", "distance", "image"])
    );
    assert_eq!(
        result["cell_data"],
        serde_json::json!([
            "region",
            "min_dihedral",
            "volume",
            "feature_faces",
            "angles",
            "image"
        ])
    );
    // VTK reads the units, too.
    let units = serde_json::json!({ "min_dihedral": "degrees", "distance": "samples" });
    assert_eq!(result["units"], units);
    let bounds: Vec<f64> = serde_json::from_value(result["bounds"].clone()).unwrap();
    assert_eq!(bounds, [0.0, 43.0, 0.0, 35.0, 0.0, 31.0]);
    for key in ["volume", "geometric_volume"] {
        let volume = result[key].as_f64().unwrap();
        assert!(
            (volume / (43.0 * 35.0 * 31.0) - 1.0).abs() < 1e-6,
            "{key} {volume}"
        );
    }
}

#[test]
fn meshes_have_the_same_bytes_for_any_number_of_threads_and_in_each_run() {
    let folder = folder();
    for (output, threads) in [("a.vtu", "1"), ("b.vtu", "2"), ("c.vtu", "2")] {
        run_args(
            folder.path(),
            &[
                "mesh",
                "image.npy",
                "-o",
                output,
                "--distance",
                "5",
                "--threads",
                threads,
            ],
        );
    }
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("a.vtu") == bytes("b.vtu"), "1 and 2 threads differ");
    assert!(bytes("b.vtu") == bytes("c.vtu"), "two runs differ");
    let other = [
        "mesh",
        "image.npy",
        "-o",
        "d.vtu",
        "--distance",
        "5",
        "--rng-seed",
        "2",
    ];
    run_args(folder.path(), &other);
    assert!(bytes("a.vtu") != bytes("d.vtu"), "the seed changes nothing");
}

/// Several threads triangulate in slabs, one thread at once.
#[test]
fn large_meshes_are_the_same_for_any_number_of_threads() {
    let folder = folder();
    let dir = folder.path();
    run(dir, "synth faults -o large.npy --dims 112,104,104 --quiet");
    for threads in [1, 2, 3] {
        let line = "mesh large.npy --distance 3.5 --feature edges --slivers none --quiet";
        let stdout = run(
            dir,
            &format!("{line} -o {threads}.vtu --threads {threads} --json"),
        );
        let atoms = json(&stdout)["lattice"]["atoms"].as_u64().unwrap();
        assert!(atoms > 40_000, "{atoms} are not many");
    }
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(
        bytes("1.vtu") == bytes("2.vtu"),
        "one thread and two threads differ"
    );
    assert!(
        bytes("2.vtu") == bytes("3.vtu"),
        "two and three threads differ"
    );
}

#[test]
fn the_json_option_prints_nothing_but_json() {
    let folder = folder();
    write_npy(&folder.path().join("other.npy"), DIMS, planar_fault(DIMS));
    let report = json(&run_args(
        folder.path(),
        &["mesh", "image.npy", "--distance", "8", "--json"],
    ));
    assert!(report.is_object());
    for arguments in [
        &["info", "image.npy"][..],
        &["info", "image.vtu"],
        &["convert", "image.npy", "image.vti"],
        &["feature", "image.npy", "-o", "b.vti"],
        &["synth", "sphere", "-o", "s.npy", "--dims", "24,24,24"],
    ] {
        let report = json(&run_args(folder.path(), &[arguments, &["--json"]].concat()));
        assert!(report.is_object(), "{arguments:?}");
    }
    let quiet = run_args(folder.path(), &["mesh", "other.npy", "--quiet"]);
    assert_eq!(quiet, "");
}

#[test]
fn a_printed_configuration_reads_back() {
    let folder = folder();
    let typed = [
        "mesh",
        "--distance",
        "5:9",
        "--distance-from",
        "features",
        "--beta",
        "0.4",
        "--metric",
        "1,1,0.5",
        "--sigma",
        "1.5",
        "--inline-byte",
        "9",
        "--print-config",
    ];
    let first = run_args(folder.path(), &typed);
    std::fs::write(folder.path().join("job.toml"), &first).unwrap();
    let again = run_args(
        folder.path(),
        &["mesh", "--config", "job.toml", "--print-config"],
    );
    assert_eq!(first, again);

    // Options on the command line have priority over the file.
    let overridden = [
        "mesh",
        "--config",
        "job.toml",
        "--beta",
        "0.25",
        "--print-config",
    ];
    let overridden = run_args(folder.path(), &overridden);
    assert!(
        overridden.contains("beta = \"0.25\"") && overridden.contains("distance = \"5:9\""),
        "{overridden}"
    );

    // A job from the file makes the same mesh as the job on the command line.
    let plain = [
        "mesh",
        "image.npy",
        "--distance",
        "7",
        "--feature",
        "ridges",
    ];
    run_args(folder.path(), &[&plain[..], &["-o", "typed.vtu"]].concat());
    let config = run_args(folder.path(), &[&plain[..], &["--print-config"]].concat());
    std::fs::write(folder.path().join("plain.toml"), config).unwrap();
    run_args(
        folder.path(),
        &[
            "mesh",
            "image.npy",
            "--config",
            "plain.toml",
            "-o",
            "file.vtu",
        ],
    );
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("typed.vtu") == bytes("file.vtu"));
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn a_survey_is_meshed_in_its_own_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let survey = Survey {
        inlines: 20,
        crosslines: 24,
        samples: 32,
    };
    let image = planar_fault([32, 24, 20]);
    write_segy(&folder.path().join("survey.sgy"), &survey, image);
    let info = json(&run_args(folder.path(), &["info", "survey.sgy", "--json"]));
    assert_eq!(
        info["image"]["numpy_shape"],
        serde_json::json!([20, 24, 32]),
        "{info}"
    );
    run_args(
        folder.path(),
        &[
            "mesh",
            "survey.sgy",
            "--distance",
            "5",
            "--feature",
            "ridges",
        ],
    );
    let verdict = json(&run_args(
        folder.path(),
        &["validate", "survey.vtu", "--json"],
    ));
    assert_eq!(verdict["valid"], true, "{verdict}");

    let result = run_vtk_program(INSPECT, &[&folder.path().join("survey.vtu")]);
    assert_eq!(result["errors"], serde_json::json!([]));
    let bounds: Vec<f64> = serde_json::from_value(result["bounds"].clone()).unwrap();
    let corners = [(0, 0), (19, 0), (0, 23), (19, 23)].map(|(i, c)| survey.position(i, c));
    for axis in 0..2 {
        let coordinates = corners.map(|corner| corner[axis]);
        let (min, max) = (
            coordinates.into_iter().reduce(f64::min),
            coordinates.into_iter().reduce(f64::max),
        );
        assert!((bounds[2 * axis] - min.unwrap()).abs() < 0.02, "{bounds:?}");
        assert!(
            (bounds[2 * axis + 1] - max.unwrap()).abs() < 0.02,
            "{bounds:?}"
        );
    }
    // The depth is 31 intervals of 4 ms.
    assert!(((bounds[5] - bounds[4]) - 124.0).abs() < 1e-6, "{bounds:?}");
    let volume = result["volume"].as_f64().unwrap();
    assert!(
        (volume / (19.0 * 25.0 * 23.0 * 12.5 * 124.0) - 1.0).abs() < 1e-4,
        "{volume}"
    );
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn fixed_atoms_stay_in_place() {
    let folder = folder();
    std::fs::write(
        folder.path().join("wells.csv"),
        "x,y,z\n10.25,12.5,9.75\n30,20,20\n",
    )
    .unwrap();
    run_args(
        folder.path(),
        &[
            "mesh",
            "image.npy",
            "--distance",
            "6",
            "--atoms-from",
            "wells.csv",
        ],
    );
    let inspect = r#"
import json, sys
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
reader = vtkXMLUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
reader.Update()
grid = reader.GetOutput()
kinds = grid.GetPointData().GetArray("atom_kind")
fixed = [grid.GetPoint(k) for k in range(grid.GetNumberOfPoints()) if kinds.GetTuple1(k) == 4]
print(json.dumps(sorted(fixed)))
"#;
    let fixed = run_vtk_program(inspect, &[&folder.path().join("image.vtu")]);
    let fixed: Vec<[f64; 3]> = serde_json::from_value(fixed).unwrap();
    for (actual, expected) in fixed.iter().zip([[10.25, 12.5, 9.75], [30.0, 20.0, 20.0]]) {
        for k in 0..3 {
            assert!((actual[k] - expected[k]).abs() < 1e-5, "{fixed:?}");
        }
    }
    assert_eq!(fixed.len(), 2, "{fixed:?}");
}

#[test]
fn options_of_mesh_give_valid_meshes() {
    let folder = folder();
    write_npy(&folder.path().join("beta.npy"), DIMS, |[x, _, _]| {
        if x < 20 { 0.3 } else { 0.6 }
    });
    for options in [
        &["--distance", "5:9", "--distance-from", "features"][..],
        &["--beta", "beta.npy"],
        &["--potential", "sampled"],
        &["--coarse-to-fine", "2"],
        &["--slivers", "none"],
        &["--metric", "1,0.8,1.2"],
        &["--feature", "edges"],
        &["--feature", "valleys"],
        &["--feature", "horizons"],
        &["--trace", "trace.pvd"],
    ] {
        let all = [&["mesh", "image.npy", "-o", "m.vtu"][..], options].concat();
        run_args(folder.path(), &all);
        let verdict = json(&run_args(folder.path(), &["validate", "m.vtu", "--json"]));
        assert_eq!(verdict["valid"], true, "{options:?}: {verdict}");
    }
    let pvd = std::fs::read_to_string(folder.path().join("trace.pvd")).unwrap();
    let steps: Vec<&str> = pvd
        .split("file=\"")
        .skip(1)
        .filter_map(|s| s.split('"').next())
        .collect();
    assert!(steps.len() >= 2, "{pvd}");
    for step in steps {
        let frame = json(&run_args(folder.path(), &["info", step, "--json"]));
        let [nodes, cells] = ["nodes", "tetrahedra"].map(|what| frame[what].as_u64().unwrap());
        assert!(cells > 2 * nodes, "{step}: {frame}");
        let energy = &frame["fields"]["energy"][0];
        assert!(energy.is_f64(), "{step}: {frame}");
    }
}

#[test]
fn a_potential_written_by_feature_can_be_meshed() {
    let folder = folder();
    run_args(
        folder.path(),
        &["feature", "image.npy", "-o", "b.vti", "--distance", "6"],
    );
    run_args(
        folder.path(),
        &[
            "mesh",
            "b.vti",
            "--feature",
            "potential",
            "--distance",
            "6",
            "-o",
            "m.vtu",
        ],
    );
}

#[test]
fn images_survive_a_conversion() {
    let folder = folder();
    run_args(folder.path(), &["convert", "image.npy", "one.vti"]);
    run_args(folder.path(), &["convert", "one.vti", "two.npy"]);
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let samples =
        |bytes: Vec<u8>| bytes[bytes.len() - 4 * DIMS.iter().product::<usize>()..].to_vec();
    assert_eq!(samples(bytes("image.npy")), samples(bytes("two.npy")));
}

/// Meshes `image.npy`, and interrupts the job some time after atoms begin to move.
fn interrupt_slow_job(folder: &Path, wait: std::time::Duration) {
    // The sampled evaluator is slow, so that there is time to interrupt.
    let mut child = atomesh(folder)
        .args([
            "mesh",
            "image.npy",
            "--distance",
            "5",
            "--potential",
            "sampled",
        ])
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let mut stages = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().unwrap()));
    stages
        .find(|line| {
            line.as_ref()
                .is_ok_and(|line| line.contains("moving atoms"))
        })
        .unwrap()
        .unwrap();
    std::thread::sleep(wait);
    let signal = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(signal.unwrap().success());
    let remaining: Vec<String> = stages.map(|line| line.unwrap()).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{remaining:?}");
}

#[test]
fn an_interrupted_job_writes_the_best_lattice_so_far() {
    let folder = tempfile::tempdir().unwrap();
    let dims = [120, 110, 100];
    write_npy(&folder.path().join("image.npy"), dims, planar_fault(dims));
    // The first lattice takes longer on a busy machine; before it, there is nothing to write.
    for wait in [300, 1000, 3000] {
        interrupt_slow_job(folder.path(), std::time::Duration::from_millis(wait));
        if folder.path().join("image.vtu").exists() {
            break;
        }
    }
    let verdict = json(&run_args(
        folder.path(),
        &["validate", "image.vtu", "--json"],
    ));
    assert_eq!(verdict["valid"], true);
    assert_eq!(files_below(folder.path()).len(), 2);
}

#[test]
fn the_sample_volume_follows_from_the_command_in_its_readme() {
    let folder = tempfile::tempdir().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let readme = std::fs::read_to_string(data.join("README.md")).unwrap();
    let command = readme
        .split('`')
        .find(|code| code.starts_with("atomesh synth"))
        .unwrap();
    let arguments: Vec<&str> = command
        .split_whitespace()
        .skip(1)
        .map(|word| {
            if word.starts_with("data/") {
                "made.vti"
            } else {
                word
            }
        })
        .collect();
    run_args(folder.path(), &arguments);
    let synthetic = std::fs::read(folder.path().join("made.vti")).unwrap();
    assert!(
        synthetic == std::fs::read(data.join("faults.vti")).unwrap(),
        "{command}"
    );
}

#[test]
fn help_shows_examples_and_version_shows_the_licence() {
    let dir = Path::new(".");
    for verb in [
        "mesh", "feature", "info", "convert", "quality", "validate", "synth",
    ] {
        let help = run_args(dir, &[verb, "--help"]);
        assert!(help.contains("Example:\n  atomesh "), "{help}");
    }
    assert!(run_args(dir, &["--version"]).contains("AGPL-3.0"));
}

/// Python program that prints what VTK reads in a file of acute lines.
const INSPECT_LINES: &str = r#"
import json, sys
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader
reader = vtkXMLPolyDataReader()
reader.SetFileName(sys.argv[1])
reader.Update()
lines = reader.GetOutput()
values = lambda a: [a.GetTuple1(k) for k in range(a.GetNumberOfTuples())]
cells = lines.GetCellData()
print(json.dumps({
    "lines": lines.GetNumberOfLines(), "verts": lines.GetNumberOfVerts(),
    "points": [lines.GetPoint(k) for k in range(lines.GetNumberOfPoints())],
    "angle": values(lines.GetPointData().GetArray("angle")),
    **{n: values(cells.GetArray(n)) for n in ["mean_angle", "least_angle", "length", "pair"]},
}))
"#;

/// Writes the image of a plane that meets the side x = 0 at y = 60, at an angle of 25 degrees.
fn write_acute_plane(path: &Path) {
    let (sine, cosine) = 25f32.to_radians().sin_cos();
    write_npy(path, [96, 96, 40], |[x, y, _]| {
        let distance = x as f32 * cosine + (y as f32 - 60.0) * sine;
        (-0.5 * (distance / 1.5).powi(2)).exp()
    });
}

#[test]
fn small_angles_at_an_acute_line_on_a_side_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_acute_plane(&dir.join("image.npy"));
    let mesh = "mesh image.npy --distance 6 --feature ridges --sigma 0.7 --lines a.vtp --json";
    let words: Vec<&str> = mesh.split(' ').collect();
    // Nodes may deviate from the feature so far that all angles reach 30 degrees even at the acute
    // line.
    let report = json(&run_args(dir, &words));
    assert_eq!(
        report["quality"]["angles"]["ok"],
        report["quality"]["cells"]
    );
    let covered = report["fidelity"]["tagged_faces"]["coverage_one"].as_f64();
    assert!(covered.unwrap() > 0.99, "{covered:?}");
    // With a lower target angle the line keeps its angle.
    let report = json(&run_args(
        dir,
        &[&words[..], &["--min-dihedral", "25"]].concat(),
    ));
    let angles = &report["quality"]["angles"];
    let count = |name: &str| angles[name].as_u64().unwrap();
    assert!(count("near_acute_line") > 5, "{angles}");
    let worst = angles["worst_unexplained"]["min_angle"].as_f64();
    assert!(worst.is_none_or(|angle| angle >= 25.0), "{angles}");
    let total = report["quality"]["cells"].as_u64().unwrap();
    let kinds = ["ok", "near_acute_line", "unexplained"];
    assert_eq!(kinds.map(count).iter().sum::<u64>(), total);
    let [line] = &angles["acute_lines"].as_array().unwrap()[..] else {
        panic!("{angles}");
    };
    assert_eq!(line["pair"], "feature and low side along x");
    assert!((line["mean_angle"].as_f64().unwrap() - 25.0).abs() < 1.0);
    assert!((line["length"].as_f64().unwrap() - 39.0).abs() < 0.5);

    // The mesh file alone gives the same figures.
    let again = ["quality", "image.vtu", "--lines", "b.vtp", "--json"];
    let again = json(&run_args(dir, &again));
    let counts = ["ok", "near_acute_line", "unexplained"];
    let counts_of = |angles: &Value| counts.map(|name| angles[name].clone());
    assert_eq!(counts_of(&again["quality"]["angles"]), counts_of(angles));
    let table = run_args(dir, &["quality", "image.vtu"]);
    let unexplained = format!("unexplained: {}", count("unexplained"));
    assert!(table.contains(&unexplained), "{table}");
    assert!(table.contains("acute lines: 1, 39 long in all"), "{table}");
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_acute_lines() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_acute_plane(&dir.join("image.npy"));
    let mesh = "mesh image.npy --distance 6 --feature ridges --sigma 0.7 --lines a.vtp";
    run(dir, &format!("{mesh} --min-dihedral 25 --quiet"));
    run(dir, "quality image.vtu --lines b.vtp --quiet");
    for name in ["a.vtp", "b.vtp"] {
        let result = run_vtk_program(INSPECT_LINES, &[&dir.join(name)]);
        assert_eq!((&result["lines"], &result["verts"]), (&1.into(), &0.into()));
        assert_eq!(result["pair"], serde_json::json!([1.0]));
        let points = result["points"].as_array().unwrap();
        assert_eq!(points.len(), result["angle"].as_array().unwrap().len());
        for point in points {
            let [x, y] = [0, 1].map(|k| point[k].as_f64().unwrap());
            assert!(x.abs() < 1e-9 && (y - 60.0).abs() < 1.0, "{point}");
        }
    }
}
