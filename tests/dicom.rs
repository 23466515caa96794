//! Tests DICOM: series, frames, compressions and segmentations that pydicom, highdicom and GDCM wrote
//! (`tests/data/dicom/make.py`), folders of slices, and tables of labels.

use std::path::{Path, PathBuf};

use atomesh::image::formats::{AnyImage, LoadedImage, ReadOptions, read, read_any, write};
use atomesh::image::{Geometry, Image, LabelValue};

use crate::common::{copy_folder, expect_refusal, run};

/// Number of samples of the scan along each axis.
const DIMS: [usize; 3] = [10, 8, 4];

/// Directions of rows, of columns and of the normal, and the distance between samples along each.
const DIRECTIONS: [[f64; 3]; 3] = [[0.6, 0.8, 0.0], [-0.48, 0.36, 0.8], [0.64, -0.48, 0.6]];
const STEPS: [f64; 3] = [0.5, 0.75, 2.0];
const ORIGIN: [f64; 3] = [-100.0, 20.0, 300.0];

/// Positions are written with ten digits.
const TOLERANCE: f64 = 1e-6;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/dicom")
        .join(name)
}

/// Returns the stored value of a sample.
fn stored([i, j, k]: [usize; 3]) -> f32 {
    (7 * i + 31 * j + 101 * k) as f32 - 300.0
}

/// Returns the value of a sample: each slice has its slope and its intercept.
fn value([i, j, k]: [usize; 3]) -> f32 {
    stored([i, j, k]) * (k + 1) as f32 - 10.0 * k as f32
}

/// Returns the position of a sample. Slices are sheared by `tilt` within their plane.
fn position(index: [usize; 3], tilt: f64) -> [f64; 3] {
    std::array::from_fn(|c| {
        let along = |axis: usize| index[axis] as f64 * STEPS[axis];
        ORIGIN[c]
            + along(0) * DIRECTIONS[0][c]
            + along(1) * DIRECTIONS[1][c]
            + along(2) * (DIRECTIONS[2][c] + tilt * DIRECTIONS[1][c])
    })
}

/// Checks the values and the positions of all samples. The image begins with slice `first`.
fn check(loaded: &LoadedImage, first: usize, tilt: f64, value: impl Fn([usize; 3]) -> f32) {
    let [nx, ny, nz] = loaded.image.dims();
    let samples = loaded.image.as_slice();
    for (offset, sample) in samples.iter().enumerate() {
        let index = [offset % nx, offset / nx % ny, offset / (nx * ny)];
        let in_scan = [index[0], index[1], index[2] + first];
        assert_eq!(*sample, value(in_scan), "{index:?} of {nx} x {ny} x {nz}");
        let [found, expected] = [
            loaded.image.geometry.to_physical(index.map(|i| i as f64)),
            position(in_scan, tilt),
        ];
        for c in 0..3 {
            assert!(
                (found[c] - expected[c]).abs() < TOLERANCE,
                "{found:?} {expected:?}"
            );
        }
    }
}

fn load(name: &str) -> LoadedImage {
    read(&data(name), &ReadOptions::default()).unwrap()
}

#[test]
fn every_encoding_of_the_scan_has_its_values_and_positions() {
    let names = [
        "frames.dcm",
        "big_endian.dcm",
        "deflated.dcm",
        "rle.dcm",
        "jpeg_lossless.dcm",
        "jpeg_2000.dcm",
        "series/b",
    ];
    for name in names {
        let loaded = load(name);
        assert_eq!(loaded.image.dims(), DIMS, "{name}");
        check(&loaded, 0, 0.0, value);
        let notes = loaded.notes.join("; ");
        assert!(
            notes.contains("made ") && !notes.contains("ecret"),
            "{notes}"
        );
    }
    let error = read_any(&data("jpeg_ls.dcm"), &ReadOptions::default()).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("JPEG-LS") && error.contains("gdcmconv"),
        "{error}"
    );
}

#[test]
fn a_folder_is_its_series_without_the_localizer() {
    let loaded = load("series");
    check(&loaded, 0, 0.0, value);
    let notes = loaded.notes.join("; ");
    assert!(notes.contains("1 localizers are left out"), "{notes}");
}

#[test]
fn slices_of_a_tilted_gantry_keep_their_places() {
    let loaded = load("tilted");
    check(&loaded, 0, 0.25, value);
    let notes = loaded.notes.join("; ");
    assert!(notes.contains("sheared by 14.04 degrees"), "{notes}");
}

#[test]
fn padding_holds_no_data() {
    let AnyImage::Plane(loaded) = read_any(&data("padded.dcm"), &ReadOptions::default()).unwrap()
    else {
        panic!("one slice is read as a volume");
    };
    let samples = loaded.image.as_slice();
    let missing: Vec<usize> = (0..samples.len())
        .filter(|&i| samples[i].is_nan())
        .collect();
    assert_eq!(missing, [2 * DIMS[0] + 3]);
    assert_eq!(samples[0], value([0, 0, 0]));
}

#[test]
fn missing_slices_and_several_series_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    copy_folder(&data("series"), &folder.join("gap"));
    std::fs::remove_file(folder.join("gap/d")).unwrap();
    let error = expect_refusal(folder, &["info", "gap"]);
    assert!(
        error.contains("lacks slices (1 in all): 1 between a at"),
        "{error}"
    );
    assert!(error.contains("and b at"), "{error}");

    copy_folder(&data("series"), &folder.join("two"));
    for k in 0..4 {
        std::fs::copy(
            data(&format!("tilted/{k}.dcm")),
            folder.join(format!("two/t{k}")),
        )
        .unwrap();
    }
    let error = expect_refusal(folder, &["info", "two"]);
    for part in [
        "holds 2 series",
        "'made 1' (5 images, a)",
        "'made 3' (4 images, t0)",
        "two/a",
    ] {
        assert!(error.contains(part), "no {part}: {error}");
    }
    assert!(run(folder, "info two/t2").contains("10 x 8 x 4"));

    // A copy of a file counts once; another image at the same place is refused.
    copy_folder(&data("tilted"), &folder.join("copies"));
    std::fs::copy(data("tilted/0.dcm"), folder.join("copies/again.dcm")).unwrap();
    assert!(run(folder, "info copies").contains("1 files are copies"));
}

#[test]
fn names_of_patients_are_in_no_output() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    copy_folder(&data("series"), &folder.join("series"));
    let text = run(folder, "info series");
    assert!(text.contains("CT series 1 'made 1'"), "{text}");
    let mut texts = vec![text.into_bytes()];
    for name in ["a.vti", "a.nrrd", "a.nii", "a.mha"] {
        run(folder, &format!("convert series {name} --quiet"));
        texts.push(std::fs::read(folder.join(name)).unwrap());
    }
    for text in texts {
        let text = String::from_utf8_lossy(&text).to_lowercase();
        assert!(!text.contains("secret"));
    }
}

#[test]
fn segmentations_have_the_labels_and_names_of_their_segments() {
    let names = |loaded: &LoadedImage| -> Vec<(i64, String)> {
        let names = loaded.image.label_names.iter();
        let whole = |label: &LabelValue| label.as_f64() as i64;
        names
            .map(|(label, name)| (whole(label), name.clone()))
            .collect()
    };
    let named = |pairs: &[(i64, &str)]| -> Vec<(i64, String)> {
        pairs
            .iter()
            .map(|(label, name)| (*label, (*name).to_string()))
            .collect()
    };
    let is_in = |range: std::ops::Range<usize>, i: usize| range.contains(&i);
    let loaded = load("seg_binary.dcm");
    assert_eq!(loaded.image.dims(), [10, 8, 2]);
    check(&loaded, 1, 0.0, |[i, j, k]| match k {
        1 if is_in(2..5, j) && is_in(3..7, i) => 1.0,
        2 if is_in(4..7, j) && is_in(1..9, i) => 2.0,
        _ => 0.0,
    });
    assert_eq!(names(&loaded), named(&[(1, "bone"), (2, "Left lung")]));

    let loaded = load("seg_labels.dcm");
    check(&loaded, 1, 0.0, |[i, j, k]| match k {
        2 if is_in(5..7, j) && is_in(1..9, i) => 300.0,
        _ if is_in(2..5, j) && is_in(3..7, i) => 3.0,
        _ => 0.0,
    });
    assert_eq!(names(&loaded), named(&[(3, "bone"), (300, "Left lung")]));
}

#[test]
fn overlapping_segments_are_read_layer_by_layer() {
    let path = data("seg_overlapping.dcm");
    let error = read_any(&path, &ReadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("0 (bone), 1 (tumour)"), "{error}");
    let layer = |layer: usize| {
        let options = ReadOptions {
            layer: Some(layer),
            ..ReadOptions::default()
        };
        read(&path, &options)
    };
    let is_in = |range: std::ops::Range<usize>, i: usize| range.contains(&i);
    let bone = layer(0).unwrap();
    assert_eq!(bone.image.dims(), DIMS);
    check(&bone, 0, 0.0, |[i, j, k]| {
        f32::from(u8::from(
            matches!(k, 0 | 3) && is_in(1..4, j) && is_in(2..6, i),
        ))
    });
    let tumour = layer(1).unwrap();
    check(&tumour, 0, 0.0, |[i, j, k]| match k {
        1 if is_in(0..3, j) && is_in(4..9, i) => 2.0,
        3 if is_in(3..6, j) && is_in(5..8, i) => 2.0,
        _ => 0.0,
    });
    assert_eq!(
        tumour.image.label_names,
        [(LabelValue::Whole(2), "tumour".into())]
    );
    assert!(layer(2).is_err());
}

#[test]
fn damaged_files_are_refused_with_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dcm");
    for name in [
        "frames.dcm",
        "rle.dcm",
        "jpeg_lossless.dcm",
        "seg_binary.dcm",
    ] {
        let bytes = std::fs::read(data(name)).unwrap();
        for end in (0..bytes.len() - 2).step_by(41) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            // A file that is cut between elements may be complete.
            if let Err(error) = read_any(&path, &ReadOptions::default()) {
                assert_eq!(error.to_string().lines().count(), 1, "{error}");
            }
        }
    }
}

/// Writes a box with a body of label 3 in label 0.
fn write_body(path: &Path) {
    let dims = [16, 16, 16];
    let inside = |x: usize| (4..12).contains(&(x % 16));
    let label = |n: usize| {
        if inside(n) && inside(n / 16) && inside(n / 256) {
            3.0
        } else {
            0.0
        }
    };
    let samples = (0..16 * 16 * 16).map(label).collect();
    write(
        path,
        &Image::new(dims, samples, Geometry::with_spacing([0.0; 3], [1.0; 3])),
    )
    .unwrap();
}

/// Returns the names of the regions of a mesh.
fn regions(folder: &Path, options: &str) -> (String, String) {
    let text = run(
        folder,
        &format!(
            "mesh a.nrrd -o m.vtu --distance 4 --effort draft --report r.json --details {options}"
        ),
    );
    (
        std::fs::read_to_string(folder.join("r.json")).unwrap(),
        text,
    )
}

#[test]
fn tables_of_labels_name_regions() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_body(&folder.join("a.nrrd"));
    std::fs::write(
        folder.join("names.txt"),
        "0 air 0 0 0 0\n3 femur 255 0 0 0\n",
    )
    .unwrap();
    let (report, _) = regions(folder, "--label-table names.txt");
    assert!(
        report.contains("\"femur\"") && report.contains("\"air\""),
        "{report}"
    );
    // An option of the command line wins, with a note.
    let (report, _) = regions(folder, "--label-table names.txt --label 3:name=tibia");
    assert!(
        report.contains("\"tibia\"") && !report.contains("\"femur\""),
        "{report}"
    );
    assert!(
        report.contains("label 3 is named tibia, as --label says, not femur"),
        "{report}"
    );
    // A table beside the image is found.
    std::fs::write(folder.join("a.csv"), "label,name\n3,Knochen\n").unwrap();
    let (report, _) = regions(folder, "");
    assert!(
        report.contains("\"Knochen\"") && report.contains("a.csv, which lies beside"),
        "{report}"
    );
    let (report, _) = regions(folder, "--label-table none");
    assert!(!report.contains("Knochen"), "{report}");
    // Names go from file to file.
    run(
        folder,
        "convert a.nrrd b.vti --label-table names.txt --label-table-out b.tsv --quiet",
    );
    let table = std::fs::read_to_string(folder.join("b.tsv")).unwrap();
    assert_eq!(table, "value\tname\n0\tair\n3\tfemur\n");
}

#[test]
fn tables_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_body(&folder.join("a.nrrd"));
    std::fs::write(folder.join("other.csv"), "7,skin\n").unwrap();
    std::fs::write(folder.join("bad.csv"), "3,skin\n3,bone\n").unwrap();
    let mesh = |table: &'static str, more: &[&'static str]| {
        let mut words = vec!["mesh", "a.nrrd", "-o", "m.vtu", "--label-table", table];
        words.extend(more);
        expect_refusal(folder, &words)
    };
    assert!(mesh("other.csv", &[]).contains("names none of the image's labels, such as 0, 3"));
    assert!(mesh("bad.csv", &[]).contains("line 2 names label 3 'bone', which is 'skin' above"));
    assert!(mesh("other.csv", &["--feature", "edges"]).contains("edges are followed"));
    let error = expect_refusal(
        folder,
        &["convert", "a.nrrd", "b.vti", "--label-table", "other.csv"],
    );
    assert!(
        error.contains("names labels, which have no names here"),
        "{error}"
    );
    let error = expect_refusal(
        folder,
        &["convert", "a.nrrd", "b.vti", "--label-table-out", "n.csv"],
    );
    assert!(error.contains("has no names to write"), "{error}");
}

#[test]
fn folders_of_slices_are_meshed_as_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("stack")).unwrap();
    for z in 0..12usize {
        let label = |n: usize| 1.0 + f32::from(u8::from(n % 12 + z > 11));
        let plane = Image::new([12, 12], (0..144).map(label).collect(), Geometry::default());
        write(&folder.join(format!("stack/slice{z}.png")), &plane).unwrap();
    }
    let text = run(folder, "info stack --spacing 1,1,2 --unit mm");
    for part in [
        "12 x 12 x 12",
        "from slice0.png to slice11.png",
        "(0.0000, 0.0000, 2.0000) along z",
    ] {
        assert!(text.contains(part), "no {part}: {text}");
    }
    run(
        folder,
        "mesh stack -o m.vtu --distance 4 --spacing 1,1,2 --unit mm --effort draft --quiet",
    );
    std::fs::remove_file(folder.join("stack/slice7.png")).unwrap();
    let error = expect_refusal(folder, &["info", "stack"]);
    assert!(
        error.contains("numbers missing: slice6.png and slice8.png"),
        "{error}"
    );
}

/// Compares the files of pydicom's test data: those that both read have the same values, at the same
/// positions.
#[test]
#[ignore = "needs pydicom: make test-all"]
fn values_are_the_same_in_pydicom() {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/dicom.py");
    let arguments = [
        script.as_os_str(),
        crate::PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    let stdout = crate::common::run_python("pydicom", &arguments);
    println!("{stdout}");
    let summary = stdout.lines().rfind(|line| line.contains(" files: "));
    let [_, equal, refused, _, faults]: [usize; 5] = numbers(summary.unwrap());
    assert!(equal >= 40 && refused > 0 && faults == 0, "{stdout}");
}

/// Returns the numbers in a line.
fn numbers<const N: usize>(line: &str) -> [usize; N] {
    let words = line.split(|c: char| !c.is_ascii_digit());
    let numbers: Vec<usize> = words.filter_map(|word| word.parse().ok()).collect();
    numbers.try_into().unwrap()
}
