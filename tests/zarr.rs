//! Zarr version 3 and MDIO version 1: stores of others are read right, what is written others read, what is
//! damaged is refused in one line; and images larger than the memory allowed pass through.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{write_npy, expect_refusal, run_args};
use atomesh::image::formats::{self, AnyImage, LoadedImage, ReadOptions};
use atomesh::image::{Geometry, Image};

fn opened(path: &Path) -> Result<LoadedImage, String> {
    match formats::read_any(path, &ReadOptions::default()) {
        Ok(AnyImage::Space(loaded)) => Ok(loaded),
        Ok(AnyImage::Plane(_)) => Err("is 2-D".into()),
        Err(error) => Err(error.to_string()),
    }
}

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/zarr")
}

/// All in a folder, in another one.
fn copied(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        match path.is_dir() {
            true => copied(&path, &target),
            false => drop(fs::copy(&path, &target).unwrap()),
        }
    }
}

/// Some 130 stores, of every type, codec and layout that zarr-python writes, and some of ours.
#[test]
#[ignore = "needs zarr-python: make test-all"]
fn values_are_those_of_zarr_python() {
    let folder = tempfile::tempdir().unwrap();
    let judge = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/zarrs.py");
    let arguments = [
        judge.as_os_str(),
        crate::PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    let said = crate::common::run_python("zarr-python", &arguments);
    println!("{said}");
    assert_eq!(said.trim(), "zarr-python: 111 read, 18 written");
}

/// The survey was made from the SEG-Y file by multidimio 1.1.3; a trace is missing. It knows nothing of
/// times before the first sample, which are in trace headers.
#[test]
fn a_survey_of_mdio_is_that_of_its_seg_y_file() {
    let [mdio, segy] =
        ["survey.mdio", "survey.sgy"].map(|name| opened(&data().join(name)).unwrap());
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
    let (ours, theirs) = (&mdio.image.geometry, &segy.image.geometry);
    assert_eq!(ours.units, theirs.units);
    assert_eq!(ours.names, ["time", "crossline", "inline"]);
    let start = theirs.origin[2] - ours.origin[2];
    assert_eq!(start, -100.0);
    for index in [[0.0; 3], [11.0, 5.0, 4.0], [3.0, 1.0, 2.0]] {
        let [a, b] = [ours, theirs].map(|geometry| geometry.to_physical(index));
        for c in 0..3 {
            let start = if c == 2 { start } else { 0.0 };
            assert!((a[c] + start - b[c]).abs() < 1e-6, "{a:?} {b:?}");
        }
    }
    // An array of the group, with what lies beside it.
    let alone = opened(&data().join("survey.mdio/amplitude")).unwrap();
    assert_eq!(alone.image, mdio.image);
    assert_eq!(alone.line_numbers, mdio.line_numbers);
}

#[test]
fn what_is_written_is_read_again_with_its_place_and_lines() {
    let folder = tempfile::tempdir().unwrap();
    let survey = data().join("survey.sgy");
    let segy = opened(&survey).unwrap();
    run_args(
        folder.path(),
        &["convert", survey.to_str().unwrap(), "a.zarr"],
    );
    let again = opened(&folder.path().join("a.zarr")).unwrap();
    assert_eq!(again.image, segy.image);
    assert_eq!(again.line_numbers, segy.line_numbers);
    // Through memory as through the file, any geometry.
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
    assert_eq!(opened(&path).unwrap().image, image);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        2,
        "nothing else"
    );
    // A mesh of a folder.
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
fn what_cannot_be_read_is_refused_in_one_line_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_npy(&at("a.npy"), [20, 20, 20], |[x, y, z]| (x * y + z) as f32);
    run_args(folder.path(), &["convert", "a.npy", "a.zarr"]);
    let json = fs::read_to_string(at("a.zarr/samples/zarr.json")).unwrap();
    for (from, to, says) in [
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
        ("{\n", "{{", "is no JSON of Zarr"),
    ] {
        assert!(json.contains(from), "{from}");
        let changed = json.replacen(from, to, 1);
        fs::write(at("a.zarr/samples/zarr.json"), changed).unwrap();
        let error = expect_refusal(folder.path(), &["info", "a.zarr/samples"]);
        assert!(error.contains(says), "{error} (expected: {says})");
    }
    fs::write(at("a.zarr/samples/zarr.json"), &json).unwrap();
    let chunk = at("a.zarr/samples/c/0/0/0");
    let bytes = fs::read(&chunk).unwrap();
    fs::write(&chunk, &bytes[..bytes.len() / 2]).unwrap();
    let error = expect_refusal(folder.path(), &["convert", "a.zarr", "b.zarr"]);
    assert!(
        error.contains("c/0/0/0") && error.contains("cut off"),
        "{error}"
    );
    assert!(!at("b.zarr").exists());
    // What no chunk holds has the value that is said.
    fs::remove_file(&chunk).unwrap();
    let image = opened(&at("a.zarr")).unwrap().image;
    assert!(image.as_slice().iter().all(|v| *v == 0.0));

    let numbers = data().join("survey.mdio/inline");
    let error = expect_refusal(folder.path(), &["info", numbers.to_str().unwrap()]);
    assert!(
        error.contains("holds 5 elements, where 2 or 3 axes are needed"),
        "{error}"
    );
    fs::create_dir(at("old")).unwrap();
    fs::write(at("old/.zgroup"), "{\"zarr_format\": 2}").unwrap();
    let error = expect_refusal(folder.path(), &["info", "old"]);
    assert!(
        error.contains("Zarr version 2 (or MDIO version 0)"),
        "{error}"
    );
    fs::create_dir(at("empty")).unwrap();
    let error = expect_refusal(folder.path(), &["info", "empty"]);
    assert!(error.contains("is a folder"), "{error}");
    let error = expect_refusal(folder.path(), &["convert", "a.npy", "old.zarr/b.zarr"]);
    assert!(error.contains("does not exist"), "{error}");
    fs::create_dir(at("full.zarr")).unwrap();
    fs::write(at("full.zarr/mine"), "").unwrap();
    let error = expect_refusal(folder.path(), &["convert", "a.npy", "full.zarr"]);
    assert!(error.contains("contains no zarr.json"), "{error}");
    let hidden = |entry: fs::DirEntry| entry.file_name().to_string_lossy().starts_with('.');
    let mut left = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| hidden(entry.unwrap()));
    assert!(!left.any(|hidden| hidden));
}

/// Every file of two stores with a few bytes changed, taken off or put in: an image or one clear line, and
/// never more memory than is there.
#[test]
fn any_change_of_a_store_is_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    copied(&data().join("survey.mdio"), &at("a.mdio"));
    copied(&data().join("shards.zarr"), &at("b.zarr"));
    let mut state = 1u64;
    let mut random = |n: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n.max(1)
    };
    let (mut read, mut not) = (0, 0);
    for store in ["a.mdio", "b.zarr"] {
        let files = crate::common::files_below(&at(store));
        let files: Vec<_> = files
            .into_iter()
            .filter(|(_, bytes)| !bytes.is_empty())
            .collect();
        for _ in 0..120 {
            let (path, bytes) = &files[random(files.len())];
            let path = at(store).join(path);
            let mut changed = bytes.clone();
            for _ in 0..1 + random(3) {
                let place = random(changed.len());
                match random(4) {
                    0 => changed.truncate(place),
                    1 if place < changed.len() => changed[place] ^= 1 << random(8),
                    2 if place < changed.len() => changed[place] = [0, 255, b'9', b'-'][random(4)],
                    _ => changed.insert(place, [b'"', b'-', b',', 0][random(4)]),
                }
            }
            fs::write(&path, changed).unwrap();
            match opened(&at(store)) {
                Ok(_) => read += 1,
                Err(error) => {
                    assert!(!error.contains('\n') && error.len() < 1000, "{error}");
                    not += 1;
                }
            }
            fs::write(&path, bytes).unwrap();
        }
    }
    println!("{read} read, {not} refused");
    assert!(read > 20 && not > 20, "{read} read, {not} refused");
}

/// A volume of 335 MB as it would be held in memory, where half of that is left beside the program: its figures,
/// and a store of it.
#[cfg(target_os = "linux")]
#[test]
fn a_volume_larger_than_the_memory_allowed_passes_through() {
    let folder = tempfile::tempdir().unwrap();
    let [nx, ny, nz] = [512, 512, 320];
    let samples: Vec<u8> = (0..nx * ny * nz).map(|i| (i / 4096 % 200) as u8).collect();
    fs::write(folder.path().join("a.raw"), samples).unwrap();
    let within = |words: &str| {
        // Kilobytes of addresses, of which the program itself takes some 200,000.
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
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        match output.status.success() {
            true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
            false => Err(said),
        }
    };
    let about = within(&format!("info a.raw --raw {nx}x{ny}x{nz}:u8")).unwrap();
    assert!(about.contains("values      0 to 199"), "{about}");
    within(&format!("convert a.raw a.zarr --raw {nx}x{ny}x{nz}:u8")).unwrap();
    let again = within("info a.zarr").unwrap();
    let values = |text: &str| {
        let line = text.lines().find(|line| line.starts_with("values"));
        line.unwrap().to_string()
    };
    assert_eq!(values(&about), values(&again));
    // What has to be held is refused in one line.
    let error = within(&format!("convert a.raw a.vti --raw {nx}x{ny}x{nz}:u8")).unwrap_err();
    assert!(
        error.contains("of memory") && error.trim().lines().count() == 1,
        "{error}"
    );
}
