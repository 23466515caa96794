//! Tests with real files, if they are available.

use std::path::PathBuf;

use super::*;
use crate::geometry::sorted_distinct;
use crate::image::formats::{self, ReadOptions};

/// Returns a folder of images from other sources, which are not in the repository.
fn data_folder(folder: &str) -> PathBuf {
    let root = std::env::var_os("ATOMESH_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    root.join(folder)
}

fn read_real(path: &Path) -> Result<LoadedImage> {
    formats::read(path, &ReadOptions::default())
}

#[test]
#[ignore = "needs images made by others: make test-all DATA=folder"]
fn seismic3d() {
    let folder = data_folder("seismic3d");
    let loaded = read_real(&folder.join("SEISMIC3D.sgy")).unwrap();
    assert_eq!(loaded.image.dims(), [268, 181, 76]);
    let info = loaded.survey.as_ref().unwrap();
    assert_eq!((info.missing, info.duplicates), (0, 0));
    assert_eq!((info.dt_ms, info.t0_ms), (Some(3.0), 999.0));
    assert!(has_note(
        &loaded,
        "bytes 181 and 185 are not used: they only repeat the line numbers"
    ));
    // Source X, Y are local metres: a grid of 25 m x 12.5 m, up to rounding.
    let fit = info.fit.as_ref().unwrap();
    assert!(
        (fit.line_spacing()[0] - 25.0).abs() < 0.01 && (fit.line_spacing()[1] - 12.5).abs() < 0.01
    );
    assert!(fit.max < 1.0);
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.to_physical([267.0, 0.0, 0.0])[2], -1800.0);

    let stats = loaded.image.stats();
    assert!((stats.min + 0.976_118).abs() < 1e-5 && (stats.max - 1.419_807).abs() < 1e-5);
    let distinct = sorted_distinct(loaded.image.as_slice().iter().map(|v| v.to_bits()));
    assert_eq!(distinct.len(), 106);
}

#[test]
#[ignore = "needs images made by others: make test-all DATA=folder"]
fn the_same_cube_in_every_format() {
    let folder = data_folder("formats_segy/segyio");
    let f3 = read_real(&folder.join("f3.sgy")).unwrap();
    assert_eq!(f3.image.dims(), [75, 18, 23]);
    assert_eq!(f3.image.as_slice()[5000..5003], [793.0, -1653.0, -3525.0]);
    let geometry = &f3.image.geometry;
    assert!((geometry.origin[0] - 620_197.2).abs() < 0.1);
    assert!((geometry.origin[1] - 6_074_232.9).abs() < 0.1);
    let other = read_real(&folder.join("f3-lsb.sgy")).unwrap();
    assert_eq!(other.image, f3.image);
    for format in [1, 2, 3, 5, 6, 7, 9] {
        for order in ["msb", "lsb"] {
            let name = format!("multiformats/Format{format}{order}.sgy");
            let other = read_real(&folder.join(&name)).unwrap();
            assert_eq!(other.image, f3.image, "{name}");
        }
    }
    // These formats cannot hold the values: unsigned formats wrap.
    for (format, modulus) in [(10, 2f64.powi(32)), (11, 65536.0), (15, 2f64.powi(24))] {
        let name = format!("multiformats/Format{format}msb.sgy");
        let image = read_real(&folder.join(&name)).unwrap().image;
        for (a, b) in image.as_slice().iter().zip(f3.image.as_slice()) {
            assert_eq!(*a, f64::from(*b).rem_euclid(modulus) as f32, "{name}");
        }
    }
}

/// Checks every file of the collection against its expected dimensions or a part of the error.
#[test]
#[ignore = "needs images made by others: make test-all DATA=folder"]
fn odd_and_broken_files() {
    let folder = data_folder("formats_segy");
    const EXPECTED_PROBLEM: &str = "do not form a survey";
    let refused: &[(&str, &str)] = &[
        ("segyio/1x1.sgy", EXPECTED_PROBLEM),
        ("segyio/1xN.sgy", "pre-stack"),
        ("segyio/Mx1.sgy", "pre-stack"),
        ("segyio/broken.sgy", "68 bytes are left over after 3 traces"),
        ("segyio/delay-scalar.sgy", "single trace"),
        ("segyio/interval-neg-bin-neg-trace.sgy", "single trace"),
        ("segyio/interval-neg-bin-pos-trace.sgy", "single trace"),
        ("segyio/interval-pos-bin-neg-trace.sgy", "single trace"),
        ("segyio/long.sgy", EXPECTED_PROBLEM),
        ("segyio/multi-text.sgy", "single trace"),
        ("segyio/shot-gather.sgy", EXPECTED_PROBLEM),
        ("segyio/small.su", "not in a known image format"),
        ("segyio/small-lsb.su", "not in a known image format"),
        ("segyio/text.sgy", "no traces"),
        ("segyio/mapping-minimal.sgy", EXPECTED_PROBLEM),
        ("segyio/mapping-unsupported-type.sgy", EXPECTED_PROBLEM),
        ("segyio/mapping-shifted.sgy", "several traces in a cell"),
        ("segyio/multiformats/Format4msb.sgy", "sample format 4"),
        // A line is a 2-D image.
        (
            "segysak/f3-iline-111.sgy",
            "is a 2-D image of 75 x 18 samples",
        ),
    ];
    let readable: &[(&str, [usize; 3])] = &[
        ("segyio/tiny.sgy", [4, 2, 3]),
        ("segyio/mapping-default.sgy", [4, 2, 3]),
        ("segyio/mapping-empty.sgy", [4, 2, 3]),
        ("segyio/mapping-multiple-stanzas.sgy", [4, 2, 3]),
        ("segyio/stanzas-known-count.sgy", [4, 2, 3]),
        ("segyio/stanzas-unknown-count.sgy", [4, 2, 3]),
        ("segyio/trace-header-extension1.sgy", [4, 2, 3]),
        ("segyio/小文件.sgy", [50, 5, 5]),
        ("segyio/rotated-small-rev2.sgy", [50, 5, 5]),
        ("segysak/f3-ebcidctest.sgy", [463, 100, 2]),
        ("segysak/f3-withdead.sgy", [75, 18, 23]),
        ("segysak/test-geometry.sgy", [4, 202, 61]),
    ];
    for (name, expected) in refused {
        let error = read_real(&folder.join(name)).unwrap_err().to_string();
        assert!(error.contains(expected), "{name}: {error}");
    }
    for (name, dims) in readable {
        assert_eq!(
            read_real(&folder.join(name)).unwrap().image.dims(),
            *dims,
            "{name}"
        );
    }
    let dead = read_real(&folder.join("segysak/f3-withdead.sgy")).unwrap();
    assert_eq!(dead.survey.unwrap().missing, 175);

    // No file in the folder causes a panic, and all but a few kinds can at least be described.
    for sub in ["segyio", "segyio/multiformats", "segysak"] {
        for entry in std::fs::read_dir(folder.join(sub)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let described = formats::describe(&path, &ReadOptions::default());
            if name.ends_with(".sgy") && !name.starts_with("Format4") {
                assert!(described.unwrap().to_lines().contains("SEG-Y"), "{name}");
            }
        }
    }
}

#[test]
#[ignore = "needs images made by others: make test-all DATA=folder"]
fn one_survey_turned_in_eight_directions() {
    let folder = data_folder("formats_segy/segyio");
    // The file names give the azimuth of the crossline steps.
    for (name, clockwise) in [
        ("normal", 0.0f64),
        ("acute", 45.0),
        ("right", 90.0),
        ("obtuse", 135.0),
        ("straight", 180.0),
        ("reflex", 225.0),
        ("left", 270.0),
        ("inv-acute", 315.0),
    ] {
        let loaded = read_real(&folder.join(format!("{name}-small.sgy"))).unwrap();
        let fit = loaded.survey.unwrap().fit.unwrap();
        let [x, y] = fit.crossline;
        let error = (x.atan2(y).to_degrees() - clockwise + 180.0).rem_euclid(360.0) - 180.0;
        assert!(error.abs() < 1e-6, "{name}: off by {error} degrees");
        assert!(fit.max < 1e-6 * fit.line_spacing()[0], "{name}");
    }
}
