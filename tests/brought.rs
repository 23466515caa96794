//! Tests surfaces and wells of other programs, which `data/brought/matrix.py` made: each is meshed, and must lie where
//! an independent reader found it. The whole matrix needs these programs.

use crate::PROGRAM;
use crate::common::{numbers, run_args, run_python, write_npy};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Samples of the image.
const DIMS: [usize; 3] = [32, 28, 24];

/// Largest distance of a face from its surface, in metres: the height of a sample.
const MAX_DISTANCE: f64 = 12.0;

/// Returns the path of a file of these tests.
fn own_data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/brought")
        .join(name)
}

/// Reads the triangles of a GOCAD file, and scales their corners to metres.
fn triangles(path: &Path, metres: &[f64]) -> Vec<[[f64; 3]; 3]> {
    let text = std::fs::read_to_string(path).unwrap();
    let (mut nodes, mut triangles) = (Vec::new(), Vec::new());
    let mut first = 0;
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["GOCAD", ..] => first = nodes.len(),
            ["VRTX", _, x, y, z] => {
                let node = [x, y, z].map(|word| word.parse::<f64>().unwrap());
                nodes.push(std::array::from_fn::<f64, 3, _>(|k| node[k] * metres[k]));
            }
            ["TRGL", a, b, c] => triangles.push([a, b, c].map(|word| {
                let number: usize = word.parse().unwrap();
                nodes[first + number - 1]
            })),
            _ => {}
        }
    }
    triangles
}

/// Returns the difference of two points.
fn difference(a: &[f64], b: &[f64]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn area([a, b, c]: &[[f64; 3]; 3]) -> f64 {
    let (u, v) = (difference(b, a), difference(c, a));
    let cross = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    0.5 * dot(&cross, &cross).sqrt()
}

/// Checks that the faces on a meshed surface lie on a plane, and cover it.
fn check_surface(folder: &Path, case: &Value) {
    let option = &case["option"];
    run_args(
        folder,
        &["surface", "mesh.vtu", "-o", "faces.ts", "--quiet"],
    );
    let [centre, normal] = ["centre", "normal"].map(|key| numbers(&case[key]));
    let triangles = triangles(&folder.join("faces.ts"), &numbers(&case["metres"]));
    for corner in triangles.iter().flatten() {
        let distance = dot(&difference(corner, &centre), &normal).abs();
        assert!(distance <= MAX_DISTANCE, "{option}: {distance} m off");
    }
    let share = triangles.iter().map(area).sum::<f64>() / case["area"].as_f64().unwrap();
    assert!((0.93..1.07).contains(&share), "{option}: area {share}");
}

/// Checks that the fixed nodes of a mesh lie along a straight well from 0 to 270 m.
fn check_well(folder: &Path, case: &Value) {
    let option = &case["option"];
    let file =
        atomesh::files::vtk::VtkFile::read(&folder.join("mesh.vtu"), "UnstructuredGrid").unwrap();
    let piece = file.piece().unwrap();
    let array = |element: &str, name: Option<&str>| {
        let arrays = piece.child(element).unwrap().children.iter();
        let mut arrays = arrays.map(|array| file.array(array).unwrap());
        let array = arrays.find(|array| name.is_none_or(|name| array.name == name));
        array.unwrap().values.to_f64()
    };
    let (points, kinds) = (array("Points", None), array("PointData", Some("atom_kind")));
    let [head, direction] = ["head", "direction"].map(|key| numbers(&case[key]));
    let metres = numbers(&case["metres"]);
    let nodes = points.as_chunks::<3>().0.iter().zip(&kinds);
    let fixed = nodes.filter(|(_, kind)| **kind == 4.0).map(|(point, _)| {
        let place: [f64; 3] = std::array::from_fn(|k| point[k] * metres[k]);
        let from_head = difference(&place, &head);
        let along = dot(&from_head, &direction);
        (
            along,
            (dot(&from_head, &from_head) - along * along)
                .max(0.0)
                .sqrt(),
        )
    });
    let fixed: Vec<(f64, f64)> = fixed.collect();
    assert!(fixed.len() >= 5, "{option}: {} nodes", fixed.len());
    assert!(
        fixed.iter().all(|(_, off)| *off < 2.0),
        "{option}: {fixed:?}"
    );
    let ends = fixed
        .iter()
        .fold([f64::INFINITY, 0.0], |[low, high], (along, _)| {
            [along.min(low), along.max(high)]
        });
    assert!(ends[0] < 30.0 && ends[1] > 240.0, "{option}: {ends:?}");
}

#[test]
fn files_of_other_programs_come_out_where_these_read_them() {
    let folder = tempfile::tempdir().unwrap();
    let files = own_data("files");
    for entry in std::fs::read_dir(&files).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    write_npy(&folder.path().join("image.npy"), DIMS, |[i, j, k]| {
        ((7 * i + 11 * j + 13 * k) % 17) as f32
    });
    let cases = std::fs::read(folder.path().join("cases.json")).unwrap();
    let cases: Vec<Value> = serde_json::from_slice(&cases).unwrap();
    assert!(cases.len() >= 40, "{}", cases.len());
    for case in &cases {
        let option = case["option"].as_str().unwrap();
        let is_well = case["head"].is_array();
        let mut arguments = vec!["mesh", "image.npy"];
        arguments.extend(
            case["image"]
                .as_array()
                .unwrap()
                .iter()
                .map(|word| word.as_str().unwrap()),
        );
        arguments.extend([
            "--feature",
            "none",
            "--distance",
            "4",
            "-o",
            "mesh.vtu",
            "--quiet",
        ]);
        if is_well {
            arguments.extend(["--well", option, "--well-distance", "1"]);
        } else {
            arguments.extend(["--surface", option]);
        }
        run_args(folder.path(), &arguments);
        if is_well {
            check_well(folder.path(), case);
        } else {
            check_surface(folder.path(), case);
        }
    }
}

#[test]
#[ignore = "needs xtgeo, VTK and pandas: make test-all"]
fn the_matrix_of_formats_units_signs_orders_and_nulls_has_no_wrong_combination() {
    let folder = tempfile::tempdir().unwrap();
    let script = own_data("matrix.py");
    let arguments = [
        script.as_os_str(),
        PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    // The program fails if a combination is wrong, or too many are refused.
    let table = run_python("xtgeo, VTK and pandas", &arguments);
    let total = table.lines().last().unwrap();
    assert!(
        total.trim_start().starts_with("all") && total.contains(" 0 wrong"),
        "{table}"
    );
}
