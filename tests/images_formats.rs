//! Tests images in the formats of other programs: their files are read correctly or refused in one
//! clear line, and so are damaged files.

use std::path::{Path, PathBuf};

use atomesh::image::formats::{self, AnyImage, ReadOptions};
use atomesh::image::{Geometry, Image};

fn read(path: &Path) -> Result<Image<3>, String> {
    match formats::read_any(path, &ReadOptions::default()) {
        Ok(AnyImage::Space(loaded)) => Ok(loaded.image),
        Ok(AnyImage::Plane(loaded)) => Ok(loaded.image.to_3d()),
        Err(error) => Err(error.to_string()),
    }
}

/// Returns the mean of the samples, and the mean of each sample times the remainder of its index by
/// 97, which detects any change of order. Samples that are not finite count as 0, as SimpleITK
/// reads them.
fn checksums(image: &Image<3>) -> [f64; 2] {
    let value = |&v: &f32| if v.is_finite() { v } else { 0.0 };
    let samples: Vec<f32> = image.as_slice().iter().map(value).collect();
    let n = samples.len() as f64;
    let mean = samples.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
    let mixed = samples
        .iter()
        .enumerate()
        .map(|(i, &v)| f64::from(v) * (i % 97) as f64);
    [mean, mixed.sum::<f64>() / n]
}

fn all_close(a: &[f64], b: &[f64], tolerance: f64) -> bool {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= tolerance * (1.0 + b.abs());
    a.len() == b.len() && a.iter().zip(b).all(near)
}

/// Compares some 300 files that segyio, nibabel, pynrrd, SimpleITK and tifffile write, and some
/// that atomesh writes.
#[test]
#[ignore = "needs segyio, SimpleITK and others: make test-all"]
fn values_and_geometry_are_those_of_other_libraries() {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/others.py");
    let arguments = [
        script.as_os_str(),
        crate::PROGRAM.as_ref(),
        folder.path().as_os_str(),
    ];
    let stdout = crate::common::run_python("segyio and SimpleITK", &arguments);
    println!("{stdout}");
    let read = stdout.lines().filter_map(|line| {
        line.split_once(": ")?
            .1
            .split(' ')
            .next()?
            .parse::<u32>()
            .ok()
    });
    assert!(read.sum::<u32>() >= 280, "{stdout}");
}

#[test]
fn contradictory_headers_are_refused_and_rounded_integers_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mha");
    let read_header = |sizes: &str| {
        let head = format!(
            "ObjectType = Image\nNDims = 3\n{sizes}\nElementType = MET_INT\nElementDataFile = LOCAL\n"
        );
        let samples = (0..60i32).flat_map(|i| (i + (1 << 25)).to_le_bytes());
        std::fs::write(&path, head.bytes().chain(samples).collect::<Vec<u8>>()).unwrap();
        formats::read(&path, &ReadOptions::default())
    };
    let error = read_header("DimSize = 5 4 3\nDimSize = 5 3 4")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("gives DimSize twice: 5 4 3 and 5 3 4"),
        "{error}"
    );
    let read = read_header("DimSize = 5 4 3\nDimSize = 5 4 3").unwrap();
    assert!(
        read.notes.iter().any(|note| note.contains("rounded")),
        "{:?}",
        read.notes
    );
    // VTK writes such a file.
    let path = folder.path().join("a.vti");
    let extent = "WholeExtent=\"0 1 0 1 0 1\" Origin=\"0 0 0\" Spacing=\"1 1 1\"";
    let text = format!(
        "<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\"><ImageData {extent}>\
         <Piece Extent=\"0 1 0 1 0 1\"><PointData Scalars=\"v\"><DataArray type=\"Int64\" Name=\"v\" format=\"ascii\">\
         33554433 1 2 3 4 5 6 7</DataArray></PointData></Piece></ImageData></VTKFile>"
    );
    std::fs::write(&path, text).unwrap();
    let read = formats::read(&path, &ReadOptions::default()).unwrap();
    assert!(
        read.notes.iter().any(|note| note.contains("rounded")),
        "{:?}",
        read.notes
    );
}

/// Returns an image with a rotated, sheared grid and values of both signs.
fn oblique<const D: usize>(dims: [usize; D]) -> Image<D> {
    let axes = [[0.5, 0.25, 0.0], [-1.0, 2.0, 0.125], [0.25, 0.0, -4.0]];
    let count = dims.iter().product();
    let geometry = Geometry {
        origin: std::array::from_fn(|k| [-12.5, 1000.0, 3.0][k]),
        axes: std::array::from_fn(|k| std::array::from_fn(|c| axes[k][c])),
        names: std::array::from_fn(|k| ["sample", "crossline", "inline"][k].into()),
        units: std::array::from_fn(|_| "mm".into()),
    };
    let samples = (0..count).map(|i| (i as f32 * 0.37).sin() * 50.0);
    Image::new(dims, samples.collect(), geometry)
}

fn round_trip<const D: usize>(dims: [usize; D]) {
    let folder = tempfile::tempdir().unwrap();
    let image = oblique(dims);
    for name in ["a.nrrd", "a.mha", "a.nii", "a.nii.gz"] {
        let path = folder.path().join(name);
        formats::write(&path, &image).unwrap();
        let reread = formats::read_any(&path, &ReadOptions::default()).unwrap();
        let reread: Image<D> = reread.into_image().unwrap();
        assert_eq!(reread.samples, image.samples, "{name}");
        // NIfTI's header has single precision, which represents these numbers exactly.
        let (actual, expected) = (&reread.geometry, &image.geometry);
        assert!(all_close(&actual.origin, &expected.origin, 1e-12), "{name}");
        let axes = [actual, expected].map(|g| g.axes.as_flattened().to_vec());
        assert!(all_close(&axes[0], &axes[1], 1e-12), "{name}: {axes:?}");
        match name {
            "a.nrrd" => assert_eq!(actual, expected),
            "a.mha" => assert_eq!(actual.units, Geometry::<D>::default().units),
            _ => assert_eq!(actual.units, expected.units),
        }
    }
    let error = formats::write(&folder.path().join("a.npy.gz"), &image).unwrap_err();
    assert!(error.to_string().contains("ending"), "{error}");
}

#[test]
fn images_survive_a_round_trip_through_each_format() {
    round_trip([5, 4, 3]);
    round_trip([7, 6]);
}

/// Writes small valid files of every format that atomesh writes, and some by hand, and returns
/// their paths.
fn good_files(folder: &Path) -> Vec<PathBuf> {
    let image = oblique([6, 5, 4]);
    let mut paths: Vec<PathBuf> = ["a.nrrd", "a.mha", "a.nii", "a.nii.gz"]
        .iter()
        .map(|name| folder.join(name))
        .collect();
    paths
        .iter()
        .for_each(|path| formats::write(path, &image).unwrap());
    let mut write_file = |name: &str, head: &str, data: &[u8]| {
        paths.push(folder.join(name));
        std::fs::write(folder.join(name), [head.as_bytes(), data].concat()).unwrap();
    };
    let bytes: Vec<u8> = (0..120).collect();
    let inr = "#INRIMAGE-4#{\nXDIM=6\nYDIM=5\nZDIM=4\nVDIM=1\nTYPE=unsigned fixed\n\
               PIXSIZE=8 bits\nSCALE=2**0\nCPU=decm\nVX=0.5\nVY=1\nVZ=2\n";
    write_file(
        "a.inr",
        &format!("{inr}{}##}}\n", "\n".repeat(252 - inr.len())),
        &bytes,
    );
    let text: String = bytes.iter().map(|b| format!("{b} ")).collect();
    write_file(
        "b.nrrd",
        "NRRD0001\ntype: int16\ndimension: 3\nsizes: 6 5 4\nspacings: 1 nan 3\nencoding: ascii\n\n",
        text.as_bytes(),
    );
    write_file(
        "b.mha",
        "NDims = 3\nDimSize = 6 5 4\nBinaryData = False\nElementType = MET_SHORT\n\
         ElementDataFile = LOCAL\n",
        text.as_bytes(),
    );
    write_file(
        "b.mhd",
        "NDims = 3\nDimSize = 6 5 4\nHeaderSize = -1\nElementType = MET_UCHAR\n\
         ElementDataFile = a.inr\n",
        b"",
    );
    write_file("a.tif", "", &tiff([6, 5], 4));
    write_file(
        "b.nii",
        "",
        &[nifti_2(), bytes.iter().rev().copied().collect()].concat(),
    );
    paths
}

/// Returns a big-endian NIfTI-2 header of 6 x 5 x 4 unsigned bytes. A byte v stands for 119 - v,
/// and the qform rotates the image by 90 degrees about z.
fn nifti_2() -> Vec<u8> {
    let mut head = vec![0u8; 544];
    let mut write_at =
        |offset: usize, bytes: &[u8]| head[offset..offset + bytes.len()].copy_from_slice(bytes);
    write_at(0, &540i32.to_be_bytes());
    write_at(4, b"n+2\0\r\n\x1a\n");
    write_at(12, &2i16.to_be_bytes());
    write_at(14, &8i16.to_be_bytes());
    for (k, n) in [3i64, 6, 5, 4, 1, 1, 1, 1].iter().enumerate() {
        write_at(16 + 8 * k, &n.to_be_bytes());
    }
    for (k, size) in [-1.0f64, 0.5, 1.0, 2.0].iter().enumerate() {
        write_at(104 + 8 * k, &size.to_be_bytes());
    }
    write_at(168, &544i64.to_be_bytes());
    write_at(176, &(-1.0f64).to_be_bytes());
    write_at(184, &119.0f64.to_be_bytes());
    write_at(344, &1i32.to_be_bytes());
    write_at(368, &0.5f64.sqrt().to_be_bytes());
    for (k, x) in [10.0f64, 20.0, 30.0].iter().enumerate() {
        write_at(376 + 8 * k, &x.to_be_bytes());
    }
    write_at(500, &2i32.to_be_bytes());
    head
}

/// Returns a little-endian TIFF stack of uncompressed grey pages with the samples 0, 1, 2 ...
fn tiff([nx, ny]: [u16; 2], pages: u16) -> Vec<u8> {
    let mut file = b"II*\0\x08\0\0\0".to_vec();
    let page = u32::from(nx) * u32::from(ny);
    for p in 0..pages {
        let start = file.len() as u32;
        let data = start + 2 + 12 * 8 + 4;
        let entries: [(u16, u16, u32); 8] = [
            (256, 3, nx.into()),
            (257, 3, ny.into()),
            (258, 3, 8),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, data),
            (278, 3, ny.into()),
            (279, 4, page),
        ];
        file.extend((entries.len() as u16).to_le_bytes());
        for (tag, kind, value) in entries {
            file.extend(tag.to_le_bytes());
            file.extend(kind.to_le_bytes());
            file.extend(1u32.to_le_bytes());
            file.extend(value.to_le_bytes());
        }
        let next = if p + 1 < pages { data + page } else { 0 };
        file.extend(next.to_le_bytes());
        file.extend((0..page).map(|i| (i + u32::from(p) * page) as u8));
    }
    file
}

#[test]
fn small_files_of_every_format_have_the_expected_samples() {
    let folder = tempfile::tempdir().unwrap();
    for path in good_files(folder.path()).iter().skip(4) {
        let image = read(path).unwrap();
        assert_eq!(image.dims(), [6, 5, 4], "{}", path.display());
        let counted = image
            .as_slice()
            .iter()
            .enumerate()
            .all(|(i, &v)| v == i as f32);
        assert!(counted, "{}", path.display());
    }
    let spacing = read(&folder.path().join("a.inr"))
        .unwrap()
        .geometry
        .spacing();
    assert_eq!(spacing, [0.5, 1.0, 2.0]);
    // The axes are (0, 0.5, 0), (-1, 0, 0) and (0, 0, -2) in RAS coordinates. The last one is
    // reversed.
    let geometry = read(&folder.path().join("b.nii")).unwrap().geometry;
    let axes = [0.0, -0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -2.0];
    assert!(
        all_close(geometry.axes.as_flattened(), &axes, 1e-12),
        "{:?}",
        geometry.axes
    );
    assert_eq!(
        (geometry.origin, geometry.units[0].as_str()),
        ([-10.0, -20.0, 30.0], "mm")
    );
    let spacing = read(&folder.path().join("b.nrrd"))
        .unwrap()
        .geometry
        .spacing();
    assert_eq!(spacing, [1.0, 1.0, 3.0]);
}

#[test]
#[ignore = "slow: make test-all"]
fn damaged_files_are_refused_or_read_without_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let files = good_files(folder.path());
    let mut state = 1u32;
    let mut random = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    for path in files {
        let good = std::fs::read(&path).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap().to_string();
        let broken = folder.path().join(format!("broken-{name}"));
        // A truncated file is refused unless only the end of compressed data or of a text is
        // missing.
        for end in (0..good.len()).step_by(1 + good.len() / 60) {
            std::fs::write(&broken, &good[..end]).unwrap();
            if let Ok(image) = read(&broken) {
                assert!(
                    end > good.len() / 2 && name != "a.nii",
                    "{name} cut at {end}"
                );
                assert_eq!(image.dims(), [6, 5, 4]);
            }
        }
        // A file with changed bytes gives an image of limited size or a clear error, and does so
        // quickly.
        for _ in 0..300 {
            let mut bytes = good.clone();
            for _ in 0..1 + random(3) {
                let position = random(bytes.len().min(700));
                bytes[position] = random(256) as u8;
            }
            std::fs::write(&broken, &bytes).unwrap();
            match read(&broken) {
                Ok(image) => assert!(image.samples.len() < 2_000_000, "{name}"),
                Err(error) => assert!(error.contains("; ") && !error.contains('\n'), "{error}"),
            }
        }
    }
    // These files declare more samples than they can hold.
    let large = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 100 100 100\nencoding: ";
    for (encoding, expected) in [
        ("raw", "cut off"),
        ("gzip", "cannot hold"),
        ("ascii", "cut off"),
    ] {
        let path = folder.path().join("large.nrrd");
        std::fs::write(&path, format!("{large}{encoding}\n\n1 2 3")).unwrap();
        let error = read(&path).unwrap_err();
        assert!(
            error.contains(expected) && error.contains("large.nrrd"),
            "{error}"
        );
    }
}

/// Files of other programs.
mod real_data {
    use super::*;
    use crate::common::data_path;

    /// File, dimensions, two checksums, origin and steps along the axes, as SimpleITK and nibabel
    /// read them.
    type Known = (&'static str, [usize; 3], [f64; 2], [f64; 3], [[f64; 3]; 3]);

    include!("data/image_formats.rs");

    #[test]
    #[ignore = "needs images made by others: make test-all DATA=folder"]
    fn files_of_other_programs_have_the_values_that_those_programs_read() {
        let folder = data_path("");
        for (name, dims, expected, origin, axes) in KNOWN {
            let image = read(&folder.join(name)).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(image.dims(), *dims, "{name}");
            let actual = checksums(&image);
            assert!(
                all_close(&actual, expected, 1e-6),
                "{name}: {actual:?} {expected:?}"
            );
            let g = &image.geometry;
            assert!(
                all_close(&g.origin, origin, 1e-6),
                "{name}: {:?} {origin:?}",
                g.origin
            );
            let (actual, axes) = (g.axes.concat(), axes.concat());
            assert!(
                all_close(&actual, &axes, 1e-6),
                "{name}: {actual:?} {axes:?}"
            );
        }
    }

    #[test]
    #[ignore = "needs images made by others: make test-all DATA=folder"]
    fn files_that_are_no_images_are_refused_in_one_line() {
        let folder = data_path("");
        for (name, expected) in [
            (
                "formats_metaimage/itk/BayesianClassifierInitializerMemberships.mhd",
                "4 values",
            ),
            ("formats_metaimage/itk/itkBrainSliceComplex.mha", "2 values"),
            ("formats_nrrd/BallBinary30x30x30_bz2.nrrd", "bzip2"),
            (
                "formats_nrrd/BallBinary30x30x30_byteskip_minus_five.nhdr",
                "byte skip: -5",
            ),
            (
                "formats_nrrd/BallBinary30x30x30_nifti.nhdr",
                "byte skip: -1",
            ),
            ("formats_nrrd/test1d_ascii.nrrd", "2 or 3 axes"),
            ("formats_nrrd/test_customFields.nrrd", "2 or 3 axes"),
            (
                "formats_nifti_mgh_etc/nibabel/example4d.nii.gz",
                "one volume",
            ),
            (
                "formats_nifti_mgh_etc/nibabel/example_nifti2.nii.gz",
                "one volume",
            ),
            ("formats_nifti_mgh_etc/nibabel/functional.nii", "one volume"),
            (
                "formats_nifti_mgh_etc/nibabel/row_major.dconn.nii",
                "one volume",
            ),
            ("formats_nifti_mgh_etc/nibabel/nifti1.hdr", "does not exist"),
            ("formats_nifti_mgh_etc/nibabel/nifti2.hdr", "does not exist"),
        ] {
            let error = read(&folder.join(name)).unwrap_err();
            let file = Path::new(name).file_name().unwrap().to_str().unwrap();
            assert!(
                error.contains(file) && error.contains(expected),
                "{error} ({expected})"
            );
        }
        // The other files there may be refused, but each in one line.
        for set in [
            "formats_metaimage/itk",
            "formats_nrrd",
            "formats_nifti_mgh_etc/nibabel",
        ] {
            for entry in std::fs::read_dir(folder.join(set)).unwrap() {
                let path = entry.unwrap().path();
                if let Err(error) = read(&path) {
                    assert!(!error.contains('\n') && error.contains("; "), "{error}");
                    assert!(error.contains(&*path.to_string_lossy()), "{error}");
                }
            }
        }
    }
}

/// Tests grids of heights that GDAL wrote in the formats of ESRI and Surfer. The nodes are in the
/// middle of cells of 25 x 10 (25 x 25) whose north-western corner is at (1000, 5000).
#[test]
fn grids_that_gdal_wrote_lie_where_gdal_has_them() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/grids");
    for (name, dy) in [
        ("gdal_rectangles.asc", 10.0),
        ("gdal_squares.asc", 25.0),
        ("gdal_text.grd", 10.0),
        ("gdal_version_6.grd", 10.0),
        ("gdal_version_7.grd", 10.0),
    ] {
        let image = read(&folder.join(name)).unwrap();
        assert_eq!(image.dims(), [4, 3, 1], "{name}");
        for row in 0..3 {
            for column in 0..4 {
                // Rows are counted from the north in GDAL.
                let height = image.as_slice()[(2 - row) * 4 + column];
                if (row, column) == (1, 2) {
                    assert!(height.is_nan(), "{name}");
                } else {
                    assert_eq!(height, (10 * (4 * row + column)) as f32, "{name}");
                }
                let index = [column as f64, (2 - row) as f64, 0.0];
                let [x, y, _] = image.geometry.to_physical(index);
                let expected = [
                    1000.0 + 25.0 * (column as f64 + 0.5),
                    5000.0 - dy * (row as f64 + 0.5),
                ];
                assert!(all_close(&[x, y], &expected, 1e-9), "{name}: {x} {y}");
            }
        }
    }
}

/// Prints the nodes with heights of each grid, as x, y and z.
const XTGEO_NODES: &str = "\
import json, sys
import numpy as np
import xtgeo
grids = []
for path, kind in zip(sys.argv[1::2], sys.argv[2::2]):
    surface = xtgeo.surface_from_file(path, fformat=kind)
    x, y = (np.ma.getdata(values) for values in surface.get_xy_values(asmasked=False))
    z = np.ma.filled(surface.values.astype(float), np.nan)
    known = np.isfinite(z)
    grids.append(np.stack([x[known], y[known], z[known]], axis=1).tolist())
print(json.dumps(grids))
";

/// Returns a map of a survey: 60 x 40 bins of 25 x 12.5 m, whose axes are turned by this angle and
/// multiplied by these signs, and are perpendicular only to 4e-6 degrees.
fn survey_map(degrees: f64, signs: [f64; 2]) -> Image<2> {
    let axis = |length: f64, degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [length * cos, length * sin]
    };
    let geometry = Geometry {
        origin: [450_000.25, 6_780_000.75],
        axes: [
            axis(25.0 * signs[0], degrees),
            axis(12.5 * signs[1], degrees + 90.000_004),
        ],
        ..Geometry::default()
    };
    let height = |i: usize| match i % 17 {
        3 => f32::NAN,
        _ => -2000.0 + 0.25 * i as f32,
    };
    Image::new([60, 40], (0..2400).map(height).collect(), geometry)
}

#[test]
#[ignore = "needs xtgeo: make test-all"]
fn xtgeo_finds_the_nodes_of_maps_within_a_centimetre() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments: Vec<String> = vec!["-c".into(), XTGEO_NODES.into()];
    let mut maps = Vec::new();
    for (degrees, endings) in [
        (0.0, &["irap", "zmap"][..]),
        (35.0, &["irap"]),
        (130.0, &["irap"]),
    ] {
        for signs in [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
            for ending in endings {
                let map = survey_map(degrees, signs);
                let path = folder.path().join(format!("{}.{ending}", maps.len()));
                formats::write(&path, &map).unwrap();
                arguments.push(path.to_string_lossy().into_owned());
                arguments.push(format!("{ending}_ascii"));
                maps.push(map);
            }
        }
    }
    let arguments: Vec<&std::ffi::OsStr> = arguments.iter().map(AsRef::as_ref).collect();
    let stdout = crate::common::run_python("xtgeo", &arguments);
    let grids: Vec<Vec<[f64; 3]>> = serde_json::from_str(&stdout).unwrap();
    assert_eq!(grids.len(), maps.len());
    for (mut nodes, map) in grids.into_iter().zip(maps) {
        nodes.sort_by(|a, b| a[2].total_cmp(&b[2]));
        let heights = map.as_slice().iter().enumerate();
        // Heights grow with the index.
        let known: Vec<(usize, f64)> = heights
            .filter(|(_, z)| z.is_finite())
            .map(|(i, &z)| (i, f64::from(z)))
            .collect();
        assert_eq!(nodes.len(), known.len());
        for ([x, y, z], (i, height)) in nodes.into_iter().zip(known) {
            let place = map.geometry.to_physical([(i % 60) as f64, (i / 60) as f64]);
            assert_eq!(z, height);
            assert!(
                (x - place[0]).hypot(y - place[1]) < 0.01,
                "{x} {y} {place:?}"
            );
        }
    }
}

/// A file of another program as `placed.py` describes it: name, layer, dims, position of the first
/// sample, steps and samples.
type PlacedFile = (
    String,
    Option<usize>,
    [usize; 3],
    [f64; 3],
    [[f64; 3]; 3],
    Vec<f32>,
);

#[test]
#[ignore = "needs VTK, nibabel and pynrrd: make test-all"]
fn grids_pairs_and_layers_lie_where_their_programs_have_them() {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/placed.py");
    let arguments = [script.as_os_str(), folder.path().as_os_str()];
    let stdout = crate::common::run_python("VTK, nibabel and pynrrd", &arguments);
    let files: Vec<PlacedFile> = serde_json::from_str(&stdout).unwrap();
    assert_eq!(files.len(), 12);
    for (name, layer, dims, origin, axes, samples) in files {
        let options = ReadOptions {
            layer,
            ..ReadOptions::default()
        };
        let AnyImage::Space(loaded) =
            formats::read_any(&folder.path().join(&name), &options).unwrap()
        else {
            panic!("{name} is no plane");
        };
        let image = loaded.image;
        assert_eq!(image.dims(), dims, "{name}");
        assert_eq!(image.as_slice(), samples, "{name}");
        assert!(all_close(&image.geometry.origin, &origin, 1e-9), "{name}");
        for (axis, expected) in image.geometry.axes.iter().zip(&axes) {
            assert!(
                all_close(axis, expected, 1e-6),
                "{name}: {axis:?} {expected:?}"
            );
        }
        let names: Vec<String> = (image.label_names.iter())
            .map(|(label, name)| format!("{label} {name}"))
            .collect();
        let expected = match layer {
            Some(0) => vec!["2 Muscle".to_string()],
            Some(_) => vec!["1 Tumour".to_string()],
            None => Vec::new(),
        };
        assert_eq!(names, expected, "{name}");
    }
}
