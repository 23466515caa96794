//! Tests surfaces, wells and images of other programs, which `data/brought/matrix.py` and `images.py` made: each must
//! lie where an independent reader found it. The whole matrices need these programs.

use crate::PROGRAM;
use crate::common::{copy_folder, numbers, run_args, run_python, write_npy};
use atomesh::image::formats::{self, ReadOptions};
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

/// Number of metres in a unit of length.
fn metres(unit: &str) -> f64 {
    match unit {
        "mm" => 1e-3,
        "um" => 1e-6,
        "nm" => 1e-9,
        "cm" => 1e-2,
        "in" => 0.0254,
        "ft" => 0.3048,
        "angstrom" => 1e-10,
        _ => 1.0,
    }
}

/// Checks that an image has the labels of a case, and its marked voxel where it was written.
fn check_image(folder: &Path, case: &Value) {
    let given = case["given"].as_str().unwrap();
    let options: Vec<&str> = (case["options"].as_array().unwrap().iter())
        .map(|word| word.as_str().unwrap())
        .collect();
    let info = run_args(
        folder,
        &[&["info", given, "--json", "--quiet"], &options[..]].concat(),
    );
    let info: Value = serde_json::from_str(&info).unwrap();
    let image = &info["image"];
    if !numbers(&case["labels"]).is_empty() {
        assert_eq!(image["labels"], case["labels"], "{given}");
    }
    run_args(
        folder,
        &[&["convert", given, "out.npy", "--quiet"], &options[..]].concat(),
    );
    let samples = formats::read(&folder.join("out.npy"), &ReadOptions::default());
    let samples = samples.unwrap().image.samples;
    let samples = samples.as_slice().unwrap();
    let mark = case["mark"].as_f64().unwrap() as f32;
    let axes = image["axes"].as_array().unwrap();
    let counts: Vec<usize> = (axes.iter())
        .map(|axis| axis["count"].as_u64().unwrap() as usize)
        .collect();
    let origin = numbers(&image["origin"]);
    let steps: Vec<Vec<f64>> = axes.iter().map(|axis| numbers(&axis["step"])).collect();
    let units = |units: &Value| -> Vec<String> {
        let units = units.as_array().unwrap().iter();
        units
            .map(|unit| unit.as_str().unwrap().to_string())
            .collect()
    };
    let (found_units, right_units) = (units(&image["units"]), units(&case["units"]));
    let right = numbers(&case["point"]);
    let distance = |sample: usize| -> f64 {
        let index = [
            sample % counts[0],
            sample / counts[0] % counts[1],
            sample / (counts[0] * counts[1]),
        ];
        let off = (0..3).map(|c| {
            let step: f64 = (0..3).map(|k| steps[k][c] * index[k] as f64).sum();
            let scale = metres(&found_units[c]) / metres(&right_units[c]);
            (scale * (origin[c] + step) - right[c]).abs()
        });
        off.fold(0.0, f64::max)
    };
    // Labels beyond 24 bits may be equal as 32-bit floats.
    let marked = (0..samples.len()).filter(|&sample| samples[sample] == mark);
    let nearest = marked.map(distance).fold(f64::INFINITY, f64::min);
    let largest = right.iter().fold(1000.0f64, |max, v| max.max(v.abs()));
    assert!(nearest <= 1e-7 * largest, "{given}: {nearest} off");
}

#[test]
fn images_of_other_programs_have_their_labels_and_lie_where_these_read_them() {
    let folder = tempfile::tempdir().unwrap();
    copy_folder(&own_data("images"), folder.path());
    let cases = std::fs::read(folder.path().join("cases.json")).unwrap();
    let cases: Vec<Value> = serde_json::from_slice(&cases).unwrap();
    assert!(cases.len() >= 60, "{}", cases.len());
    for case in &cases {
        check_image(folder.path(), case);
    }
}

#[test]
#[ignore = "needs Gmsh, meshio and VTK: make test-all"]
fn the_matrix_of_mesh_writers_types_and_groups_has_no_wrong_combination() {
    run_matrix("meshes.py");
}

/// Runs a matrix, whose program fails if a combination is wrong, or too many are refused.
fn run_matrix(script: &str) {
    let folder = tempfile::tempdir().unwrap();
    let script = own_data(script);
    let arguments = [
        script.as_os_str(),
        PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    let table = run_python("programs that write these files", &arguments);
    let total = table.lines().last().unwrap();
    assert!(
        total.trim_start().starts_with("all") && total.contains(" 0 wrong"),
        "{table}"
    );
}

#[test]
#[ignore = "needs SimpleITK, nibabel, pynrrd, VTK, tifffile, zarr, ome-zarr, ngff-zarr and segyio: make test-all"]
fn the_matrix_of_image_writers_types_units_and_orientations_has_no_wrong_combination() {
    run_matrix("images.py");
}

#[test]
#[ignore = "needs xtgeo, VTK and pandas: make test-all"]
fn the_matrix_of_formats_units_signs_orders_and_nulls_has_no_wrong_combination() {
    run_matrix("matrix.py");
}
