//! Tests Zarr versions 2 and 3 and MDIO version 1: stores of other programs are read correctly, they read
//! those of atomesh, damaged ones are refused in one line, and images larger than the memory limit
//! can be converted.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{copy_folder, expect_refusal, run_args, write_npy};
use atomesh::image::formats::{self, AnyImage, LoadedImage, ReadOptions};
use atomesh::image::{Geometry, Image};

fn open_volume(path: &Path) -> Result<LoadedImage, String> {
    match formats::read_any(path, &ReadOptions::default()) {
        Ok(AnyImage::Space(loaded)) => Ok(loaded),
        Ok(AnyImage::Plane(_)) => Err("is 2-D".into()),
        Err(error) => Err(error.to_string()),
    }
}

fn data_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/zarr")
}

/// Compares some 240 stores: those of every type, codec and layout that zarr-python writes, and
/// some of atomesh.
#[test]
#[ignore = "needs zarr-python: make test-all"]
fn values_are_the_same_in_zarr_python() {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/zarrs.py");
    let arguments = [
        script.as_os_str(),
        crate::PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    let stdout = crate::common::run_python("zarr-python", &arguments);
    println!("{stdout}");
    assert_eq!(stdout.trim(), "zarr-python: 223 read, 18 written");
}

/// Compares a survey that multidimio 1.1.3 made from a SEG-Y file without one of its traces. The delay of
/// the first sample is in the trace headers that MDIO keeps.
#[test]
fn an_mdio_survey_equals_its_seg_y_file() {
    let [mdio, segy] =
        ["survey.mdio", "survey.sgy"].map(|name| open_volume(&data_folder().join(name)).unwrap());
    assert_eq!(mdio.image.samples, segy.image.samples);
    assert_eq!(mdio.image.missing, segy.image.missing);
    assert_eq!(
        mdio.image
            .missing
            .iter()
            .filter(|missing| **missing)
            .count(),
        1
    );
    assert!(mdio.line_numbers.is_some() && mdio.line_numbers == segy.line_numbers);
    let (mdio_geometry, segy_geometry) = (&mdio.image.geometry, &segy.image.geometry);
    assert_eq!(mdio_geometry.units, segy_geometry.units);
    assert_eq!(mdio_geometry.names, ["time", "crossline", "inline"]);
    assert_eq!(segy_geometry.origin[2], mdio_geometry.origin[2]);
    for index in [[0.0; 3], [11.0, 5.0, 4.0], [3.0, 1.0, 2.0]] {
        let [a, b] = [mdio_geometry, segy_geometry].map(|geometry| geometry.to_physical(index));
        for c in 0..3 {
            assert!((a[c] - b[c]).abs() < 1e-6, "{a:?} {b:?}");
        }
    }
    // An array of the group is read with its coordinates.
    let array = open_volume(&data_folder().join("survey.mdio/amplitude")).unwrap();
    assert_eq!(array.image, mdio.image);
    assert_eq!(array.line_numbers, mdio.line_numbers);
}

#[test]
fn stores_keep_geometry_and_line_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let survey = data_folder().join("survey.sgy");
    let segy = open_volume(&survey).unwrap();
    run_args(
        folder.path(),
        &["convert", survey.to_str().unwrap(), "a.zarr"],
    );
    let reread = open_volume(&folder.path().join("a.zarr")).unwrap();
    assert_eq!(reread.image, segy.image);
    assert_eq!(reread.line_numbers, segy.line_numbers);
    // An image from memory with any geometry survives, too.
    let geometry = Geometry {
        origin: [1.5, -2.0, 1e7],
        axes: [[0.1, 0.2, 0.3], [-1.0, 0.5, 0.0], [0.0, 0.25, 4.0]],
        names: ["x", "x", "trace_mask"].map(String::from),
        units: ["m", "", "ms"].map(String::from),
    };
    let count = 65 * 3 * 70;
    let samples = (0..count).map(|i| if i % 1000 < 900 { 0.0 } else { i as f32 * 0.1 });
    let image = Image::new([65, 3, 70], samples.collect(), geometry);
    let path = folder.path().join("b.zarr");
    formats::write(&path, &image).unwrap();
    formats::write(&path, &image).unwrap();
    assert_eq!(open_volume(&path).unwrap().image, image);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        2,
        "nothing else"
    );
    // A mesh of a store is that of the file.
    write_npy(&folder.path().join("s.npy"), [24, 22, 20], |[x, _, z]| {
        (0.5 * (x + z) as f32).sin()
    });
    run_args(folder.path(), &["convert", "s.npy", "s.zarr"]);
    let mesh = |image: &str, to: &str| {
        let line = [
            "mesh",
            image,
            "--distance",
            "6",
            "--feature",
            "edges",
            "-o",
            to,
            "--quiet",
        ];
        run_args(folder.path(), &line);
        let read = atomesh::store::read_any_vtu(&folder.path().join(to)).unwrap();
        let atomesh::store::AnyMesh::Tetrahedra(file) = read else {
            panic!("not in space")
        };
        file.mesh
    };
    assert_eq!(mesh("s.zarr", "a.vtu"), mesh("s.npy", "b.vtu"));
}

#[test]
fn unreadable_stores_are_refused_in_one_line_and_leave_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    write_npy(&in_folder("a.npy"), [20, 20, 20], |[x, y, z]| {
        (x * y + z) as f32
    });
    run_args(folder.path(), &["convert", "a.npy", "a.zarr"]);
    let json = fs::read_to_string(in_folder("a.zarr/samples/zarr.json")).unwrap();
    for (from, to, expected) in [
        ("\"blosc\"", "\"fancy\"", "has the codec 'fancy'"),
        ("\"float32\"", "\"complex64\"", "complex64, no real number"),
        ("\"regular\"", "\"odd\"", "not regular"),
        (
            "\"node_type\": \"array\"",
            "\"node_type\": 3",
            "neither array nor group",
        ),
        (
            "\"zarr_format\": 3",
            "\"zarr_format\": 4",
            "of Zarr version 4",
        ),
        ("    20,\n", "    20000000000000,\n", "more than any survey"),
        ("{\n", "{{", "is not JSON metadata of Zarr"),
    ] {
        assert!(json.contains(from), "{from}");
        let changed = json.replacen(from, to, 1);
        fs::write(in_folder("a.zarr/samples/zarr.json"), changed).unwrap();
        let error = expect_refusal(folder.path(), &["info", "a.zarr/samples"]);
        assert!(error.contains(expected), "{error} (expected: {expected})");
    }
    fs::write(in_folder("a.zarr/samples/zarr.json"), &json).unwrap();
    let chunk = in_folder("a.zarr/samples/c/0/0/0");
    let bytes = fs::read(&chunk).unwrap();
    fs::write(&chunk, &bytes[..bytes.len() / 2]).unwrap();
    let error = expect_refusal(folder.path(), &["convert", "a.zarr", "b.zarr"]);
    assert!(
        error.contains("c/0/0/0") && error.contains("cut off"),
        "{error}"
    );
    assert!(!in_folder("b.zarr").exists());
    // Samples of a missing chunk have the fill value.
    fs::remove_file(&chunk).unwrap();
    let image = open_volume(&in_folder("a.zarr")).unwrap().image;
    assert!(image.as_slice().iter().all(|v| *v == 0.0));

    let numbers = data_folder().join("survey.mdio/inline");
    let error = expect_refusal(folder.path(), &["info", numbers.to_str().unwrap()]);
    assert!(
        error.contains("holds 5 elements, where 2 or 3 axes are needed"),
        "{error}"
    );
    for name in ["old", "old/data", "old/metadata"] {
        fs::create_dir(in_folder(name)).unwrap();
        fs::write(in_folder(name).join(".zgroup"), "{\"zarr_format\": 2}").unwrap();
    }
    let error = expect_refusal(folder.path(), &["info", "old"]);
    assert!(error.contains("MDIO version 0"), "{error}");
    fs::create_dir(in_folder("empty")).unwrap();
    let error = expect_refusal(folder.path(), &["info", "empty"]);
    assert!(error.contains("is a folder"), "{error}");
    let error = expect_refusal(folder.path(), &["convert", "a.npy", "old.zarr/b.zarr"]);
    assert!(error.contains("does not exist"), "{error}");
    fs::create_dir(in_folder("full.zarr")).unwrap();
    fs::write(in_folder("full.zarr/mine"), "").unwrap();
    let error = expect_refusal(folder.path(), &["convert", "a.npy", "full.zarr"]);
    assert!(error.contains("contains no zarr.json"), "{error}");
    let hidden = |entry: fs::DirEntry| entry.file_name().to_string_lossy().starts_with('.');
    let mut is_hidden = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| hidden(entry.unwrap()));
    assert!(!is_hidden.any(|hidden| hidden));
}

/// Changes, removes and inserts bytes in the files of two stores. Each result is an image or one
/// clear error line, without running out of memory.
#[test]
fn damaged_stores_are_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    copy_folder(&data_folder().join("survey.mdio"), &in_folder("a.mdio"));
    copy_folder(&data_folder().join("shards.zarr"), &in_folder("b.zarr"));
    let mut state = 1u64;
    let mut random = |n: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n.max(1)
    };
    let (mut read, mut refused) = (0, 0);
    for store in ["a.mdio", "b.zarr"] {
        let files = crate::common::files_below(&in_folder(store));
        let files: Vec<_> = files
            .into_iter()
            .filter(|(_, bytes)| !bytes.is_empty())
            .collect();
        for _ in 0..120 {
            let (path, bytes) = &files[random(files.len())];
            let path = in_folder(store).join(path);
            let mut changed = bytes.clone();
            for _ in 0..1 + random(3) {
                let position = random(changed.len());
                match random(4) {
                    0 => changed.truncate(position),
                    1 if position < changed.len() => changed[position] ^= 1 << random(8),
                    2 if position < changed.len() => {
                        changed[position] = [0, 255, b'9', b'-'][random(4)]
                    }
                    _ => changed.insert(position, [b'"', b'-', b',', 0][random(4)]),
                }
            }
            fs::write(&path, changed).unwrap();
            match open_volume(&in_folder(store)) {
                Ok(_) => read += 1,
                Err(error) => {
                    assert!(!error.contains('\n') && error.len() < 1000, "{error}");
                    refused += 1;
                }
            }
            fs::write(&path, bytes).unwrap();
        }
    }
    println!("{read} read, {refused} refused");
    assert!(read > 20 && refused > 20, "{read} read, {refused} refused");
}

/// Reads the figures of a volume of 335 MB and converts it to a store with a memory limit of half
/// that size.
#[cfg(target_os = "linux")]
#[test]
fn a_volume_larger_than_the_memory_limit_is_converted() {
    let folder = tempfile::tempdir().unwrap();
    let [nx, ny, nz] = [512, 512, 320];
    let samples: Vec<u8> = (0..nx * ny * nz).map(|i| (i / 4096 % 200) as u8).collect();
    fs::write(folder.path().join("a.raw"), samples).unwrap();
    let run_with_limit = |words: &str| {
        // The limit is in kilobytes of address space, of which the program itself takes some
        // 200,000.
        let line = format!(
            "ulimit -v 400000; exec {} --threads 2 {words}",
            crate::PROGRAM
        );
        let mut shell = std::process::Command::new("sh");
        shell.env("MALLOC_ARENA_MAX", "1");
        let output = shell
            .args(["-c", &line])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() {
            Ok(String::from_utf8_lossy(&output.stdout).into_owned())
        } else {
            Err(stderr)
        }
    };
    let info = run_with_limit(&format!("info a.raw --raw {nx}x{ny}x{nz}:u8")).unwrap();
    assert!(info.contains("values      0 to 199"), "{info}");
    run_with_limit(&format!("convert a.raw a.zarr --raw {nx}x{ny}x{nz}:u8")).unwrap();
    let reread_info = run_with_limit("info a.zarr").unwrap();
    let values = |text: &str| {
        let line = text.lines().find(|line| line.starts_with("values"));
        line.unwrap().to_string()
    };
    assert_eq!(values(&info), values(&reread_info));
    // A conversion that needs the whole image in memory is refused in one line.
    let error =
        run_with_limit(&format!("convert a.raw a.vti --raw {nx}x{ny}x{nz}:u8")).unwrap_err();
    assert!(
        error.contains("of memory") && error.trim().lines().count() == 1,
        "{error}"
    );
}
