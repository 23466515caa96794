//! Tests files of scans: units, spacing, values on cells, palettes, and errors for formats that are
//! not supported.

use std::fs::File;
use std::path::Path;

use crate::common::{expect_refusal, folder_with_meshes, run, run_validator, write_npy};

/// Returns the label of one of two halves with a tilted boundary.
fn halves([x, y, z]: [usize; 3]) -> f32 {
    1.0 + f32::from(u8::from(x as f32 + 0.3 * y as f32 - 0.2 * z as f32 > 11.0))
}

/// Returns the largest coordinate of the nodes of a CalculiX deck.
fn largest_coordinate(path: &Path) -> f64 {
    let text = std::fs::read_to_string(path).unwrap();
    let nodes = text.lines().skip_while(|line| !line.starts_with("*NODE"));
    let nodes = nodes.skip(1).take_while(|line| !line.starts_with('*'));
    let numbers = nodes.flat_map(|line| {
        let words = line.split(',').skip(1);
        words.map(|word| word.trim().parse::<f64>().unwrap())
    });
    numbers.fold(0.0, f64::max)
}

#[test]
fn an_image_in_millimetres_is_exported_in_millimetres() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("a.npy"), [24, 22, 20], halves);
    for (unit, metres) in [("mm", 1e-3), ("um", 1e-6)] {
        let geometry = format!("--spacing 2,2,2 --unit {unit},{unit},{unit}");
        run(
            folder,
            &format!("mesh a.npy -o m.vtu --distance 5 {geometry} --quiet"),
        );
        let output = crate::common::atomesh(folder)
            .args("export m.vtu --to inp -o m.inp".split(' '))
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8_lossy(&text).into_owned();
        assert!(
            (largest_coordinate(&folder.join("m.inp")) - 46.0).abs() < 1e-6,
            "{text}"
        );
        assert!(text.contains(&format!("{unit}^3")), "{text}");
        for word in ["two-point", "flux", "depth"] {
            assert!(!text.contains(word), "{word}: {text}");
        }
        // An explicit unit has priority.
        for (target, scale) in [(unit, metres), ("m", 1.0), ("km", 1e3)] {
            run(
                folder,
                &format!("export m.vtu --to inp -o n.inp --length-unit {target} --quiet"),
            );
            let coordinate = largest_coordinate(&folder.join("n.inp"));
            assert!(
                (coordinate / (46.0 * scale) - 1.0).abs() < 1e-6,
                "{target} {coordinate}"
            );
        }
        // Exports to flow simulators are in metres.
        let stdout = run(folder, "export m.vtu --to mrst -o m.mat --down z");
        assert!(
            stdout.contains("depth") && stdout.contains("m^3"),
            "{stdout}"
        );
    }
}

#[test]
fn values_on_cells_are_samples_at_the_cell_centres() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let values: Vec<String> = (0..4 * 3 * 2).map(|i| i.to_string()).collect();
    let data = |element: &str, name: &str| {
        format!(
            "<{element}><DataArray type=\"Float32\" Name=\"{name}\" format=\"ascii\">{}</DataArray></{element}>",
            values.join(" ")
        )
    };
    let write = |extent: &str, data: &str| {
        let text = format!(
            "<?xml version=\"1.0\"?><VTKFile type=\"ImageData\" version=\"0.1\" byte_order=\"LittleEndian\">\
             <ImageData WholeExtent=\"{extent}\" Origin=\"100 200 -50\" Spacing=\"2 1 0.5\">\
             <Piece Extent=\"{extent}\">{data}</Piece></ImageData></VTKFile>"
        );
        std::fs::write(folder.join("a.vti"), text).unwrap();
        run(folder, "info a.vti")
    };
    let stdout = write("0 4 0 3 0 2", &data("CellData", "rock"));
    for part in [
        "4 x 3 x 2",
        "(101.000, 200.500, -49.750)",
        "(107.000, 202.500, -49.250)",
        "0 to 23",
    ] {
        assert!(stdout.contains(part), "no {part}: {stdout}");
    }
    // An empty element for points has no effect. An extent that does not begin at 0 moves the
    // image.
    let cells = format!("<PointData/>{}", data("CellData", "rock"));
    let stdout = write("10 14 0 3 0 2", &cells);
    assert!(stdout.contains("(121.000, 200.500, -49.750)"), "{stdout}");
    let stdout = write("0 3 0 2 0 1", &data("PointData", "rock"));
    assert!(stdout.contains("(100.000, 200.000, -50.000)"), "{stdout}");
    std::fs::write(
        folder.join("a.vti"),
        "<VTKFile type=\"ImageData\" version=\"0.1\"><ImageData WholeExtent=\"0 1 0 1 0 1\">\
         <Piece Extent=\"0 1 0 1 0 1\"/></ImageData></VTKFile>",
    )
    .unwrap();
    let error = expect_refusal(folder, &["info", "a.vti"]);
    assert!(error.contains("no data on its points or cells"), "{error}");
}

#[test]
fn color_palettes_give_indices_and_grey_palettes_give_grey_values() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (depth, bits) in [
        (png::BitDepth::Eight, 8),
        (png::BitDepth::Four, 4),
        (png::BitDepth::Two, 2),
    ] {
        for grey in [false, true] {
            let file = File::create(folder.join("a.png")).unwrap();
            let mut encoder = png::Encoder::new(file, 6, 4);
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_depth(depth);
            let palette = if grey {
                [0, 0, 0, 90, 90, 90, 200, 200, 200]
            } else {
                [0, 0, 0, 255, 0, 0, 0, 0, 255]
            };
            encoder.set_palette(palette.to_vec());
            let mut writer = encoder.write_header().unwrap();
            let row = (6usize * bits).div_ceil(8);
            let mut bytes = vec![0u8; row * 4];
            for y in 0..4 {
                for x in 0..6 {
                    let value = ((x + y) % 3) as u8;
                    bytes[y * row + x * bits / 8] |= value << (8 - bits - x * bits % 8);
                }
            }
            writer.write_image_data(&bytes).unwrap();
            writer.finish().unwrap();
            run(folder, "convert a.png a.npy --quiet");
            let bytes = std::fs::read(folder.join("a.npy")).unwrap();
            let samples = bytes[bytes.len() - 6 * 4 * 4..].chunks_exact(4);
            let samples: Vec<f32> = samples
                .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
                .collect();
            let values = if grey {
                [0.0, 90.0, 200.0]
            } else {
                [0.0, 1.0, 2.0]
            };
            let expected: Vec<f32> = (0..24).map(|i| values[(i % 6 + i / 6) % 3]).collect();
            assert_eq!(samples, expected, "{bits} {grey}");
        }
    }
}

/// Steps along the first and the last axis, as `info` shows them.
const STEPS: [&str; 2] = ["(0.2500, 0.0000, 0.0000)", "(0.0000, 0.0000, 2.0000)"];

#[test]
fn spacing_is_read_from_imagej_and_ome_tiff() {
    use tiff::encoder::{Rational, TiffEncoder, colortype::Gray8};
    use tiff::tags::Tag;
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let write = |description: &str, per_unit: Option<[u32; 2]>| {
        let file = File::create(folder.join("a.tif")).unwrap();
        let mut encoder = TiffEncoder::new(file).unwrap();
        for page in 0..3u8 {
            let mut image = encoder.new_image::<Gray8>(5, 4).unwrap();
            let tags = image.encoder();
            if page == 0 {
                tags.write_tag(Tag::ImageDescription, description).unwrap();
            }
            if let Some([n, d]) = per_unit {
                for tag in [Tag::XResolution, Tag::YResolution] {
                    tags.write_tag(tag, Rational { n, d }).unwrap();
                }
            }
            image.write_data(&[page; 20]).unwrap();
        }
        run(folder, "info a.tif")
    };
    let imagej = |unit: &str| format!("ImageJ=1.53\nimages=3\nslices=3\n{unit}spacing=2.0\n");
    for unit in ["unit=micron\n", "unit=\\u00B5m\n", "unit=um\n"] {
        let stdout = write(&imagej(unit), Some([4, 1]));
        for part in [STEPS[0], STEPS[1], "um, um, um", "from ImageJ metadata"] {
            assert!(stdout.contains(part), "no {part}: {stdout}");
        }
    }
    // A resolution of 1 is the default of ImageJ and of this writer, and stands for no resolution.
    let stdout = write(&imagej("unit=micron\n"), None);
    assert!(
        stdout.contains("(1.0000, 0.0000, 0.0000)") && stdout.contains("um, um, um"),
        "{stdout}"
    );
    // Without a unit of length the distance of planes is in pixels, and resolutions of screens do not count.
    for (unit, per_unit) in [("", Some([72, 1])), ("unit=pixel\n", Some([1, 1]))] {
        let stdout = write(&imagej(unit), per_unit);
        for part in [
            "(1.0000, 0.0000, 0.0000)",
            "2.0000) along z",
            "in pixels, without a unit",
        ] {
            assert!(stdout.contains(part), "{unit}: no {part}: {stdout}");
        }
    }
    let ome = "<?xml version=\"1.0\"?><OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\">\
               <Image><Pixels SizeC=\"1\" SizeT=\"1\" SizeZ=\"3\" PhysicalSizeX=\"0.25\" PhysicalSizeY=\"0.25\" \
               PhysicalSizeZ=\"2\"/></Image></OME>";
    let stdout = write(ome, None);
    assert!(
        stdout.contains(STEPS[0]) && stdout.contains("um, um, um"),
        "{stdout}"
    );
}

#[test]
fn spacing_is_read_from_ome_zarr() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("a.npy"), [5, 4, 3], |[x, ..]| x as f32);
    run(folder, "convert a.npy a.zarr --quiet");
    // Move the written array into a group with OME metadata.
    let written = folder.join("a.zarr");
    let arrays = std::fs::read_dir(&written).unwrap().flatten();
    let is_volume = |path: &Path| {
        let text = std::fs::read_to_string(path.join("zarr.json")).unwrap_or_default();
        let node: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        node["shape"]
            .as_array()
            .is_some_and(|shape| shape.len() == 3)
    };
    let array = arrays
        .map(|entry| entry.path())
        .find(|path| is_volume(path));
    let group = folder.join("ome.zarr");
    std::fs::create_dir(&group).unwrap();
    std::fs::rename(array.unwrap(), group.join("0")).unwrap();
    let node = group.join("0/zarr.json");
    let mut metadata: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&node).unwrap()).unwrap();
    metadata["attributes"] = serde_json::json!({});
    std::fs::write(&node, metadata.to_string()).unwrap();
    let axes = ["z", "y", "x"]
        .map(|name| serde_json::json!({ "name": name, "type": "space", "unit": "micrometer" }));
    let ome = serde_json::json!({
        "zarr_format": 3, "node_type": "group",
        "attributes": { "ome": { "version": "0.5", "multiscales": [{ "axes": axes, "datasets": [{
            "path": "0", "coordinateTransformations": [
                { "type": "scale", "scale": [2.0, 0.25, 0.25] },
                { "type": "translation", "translation": [7.0, 0.0, 0.0] },
            ] }] }] } },
    });
    std::fs::write(group.join("zarr.json"), ome.to_string()).unwrap();
    for path in ["ome.zarr", "ome.zarr/0"] {
        let stdout = run(folder, &format!("info {path}"));
        for part in [STEPS[0], STEPS[1], "(0.000, 0.000, 7.000)", "um, um, um"] {
            assert!(stdout.contains(part), "{path}, no {part}: {stdout}");
        }
    }
}

#[test]
fn unsupported_files_are_refused_with_the_name_of_a_tool_that_reads_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let gzip = b"\x1f\x8b\x08\0\0\0\0\0\0\x03";
    let files: &[(&str, &[u8], &str)] = &[
        ("brain.mgz", gzip, "mri_convert"),
        ("all.npz", b"PK\x03\x04\x14\0\0\0a.npy", "numpy.load"),
        ("all.zip", b"PK\x03\x04", "unzip"),
    ];
    for (name, bytes, tool) in files {
        std::fs::write(folder.join(name), bytes).unwrap();
        let error = expect_refusal(folder, &["info", name]);
        assert!(error.contains(tool), "{name}: {error}");
    }
}

#[test]
fn xdmf_has_one_grid_of_cells_and_a_separate_file_of_names() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(folder, "export tets.vtu --to xdmf -o a.xdmf --quiet");
    let text = std::fs::read_to_string(folder.join("a.xdmf")).unwrap();
    assert_eq!(text.matches("<Grid ").count(), 1);
    assert!(!text.contains("<Set "));
    let names = std::fs::read_to_string(folder.join("a_names.xdmf")).unwrap();
    assert!(names.matches("<Grid ").count() > 6 && names.contains("Name=\"xmin\""));
}

#[test]
#[ignore = "needs meshio: make test-all"]
fn meshio_reads_xdmf_and_vtu() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(folder, "export tets.vtu --to xdmf -o a.xdmf --quiet");
    let paths = ["a.xdmf", "tets.vtu"].map(|name| folder.join(name));
    let [xdmf, vtu] = &paths;
    let result = run_validator(
        "meshio",
        "meshio_read.py",
        &[xdmf.as_os_str(), vtu.as_os_str()],
    );
    let result = result.as_array().unwrap();
    assert_eq!(result[0]["points"], result[1]["points"]);
    assert_eq!(result[0]["tetra"], result[1]["tetra"]);
}
