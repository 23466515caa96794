//! Tests which features `auto` chooses for scans and labels from the format, the geometry and the
//! values; and isosurfaces of scans.

use std::path::Path;

use crate::common::{Survey, expect_refusal, run, write_npy, write_segy};

/// Returns the distance of a sample from a point.
fn distance([x, y, z]: [usize; 3], centre: [f64; 3]) -> f64 {
    let p = [x, y, z].map(|i| i as f64);
    (0..3)
        .map(|k| (p[k] - centre[k]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Returns a pseudo-random number in [0, 1) that depends on the position only.
fn noise([x, y, z]: [usize; 3]) -> f64 {
    let mut h = (x * 73_856_093) ^ (y * 19_349_663) ^ (z * 83_492_791);
    h = (h ^ (h >> 13)).wrapping_mul(1_274_126_177);
    ((h ^ (h >> 16)) & 0xffff) as f64 / 65_536.0
}

/// Returns the values of a winding tube of diameter 5 along an axis.
fn tube(axis: usize) -> impl Fn([usize; 3]) -> f32 {
    move |index| {
        let along = index[axis] as f64;
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3].map(|k| index[k] as f64);
        let distance = (u - 16.0 - 3.0 * (along / 7.0).sin()).hypot(v - 15.0);
        f32::from(u8::from(distance < 2.5))
    }
}

/// Meshes an image and returns the report with the label and the volume error in percent of each
/// region.
fn regions(folder: &Path, options: &str) -> (serde_json::Value, Vec<(f64, f64)>) {
    run(
        folder,
        &format!("mesh {options} -o m.vtu --report r.json --quiet"),
    );
    let text = std::fs::read_to_string(folder.join("r.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let regions = report["regions"]["regions"].as_array();
    let label_and_error = |region: &serde_json::Value| {
        let number = |key: &str| region[key].as_f64().unwrap();
        (number("label"), number("volume_error_percent"))
    };
    let regions = regions.map_or(Vec::new(), |regions| {
        regions.iter().map(label_and_error).collect()
    });
    (report, regions)
}

#[test]
fn a_mask_is_a_region_unless_it_is_a_fault_mask_of_a_survey() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for axis in 0..3 {
        write_npy(&folder.join("tube.npy"), [32, 32, 32], tube(axis));
        // The format and the geometry are ambiguous, so the verdict mentions the doubt.
        let (report, regions_found) = regions(folder, "tube.npy");
        assert_eq!(regions_found.len(), 2, "{report}");
        let verdict = &report["verdict"];
        let [issue, option, suggestion] =
            ["issue", "option", "suggestion"].map(|key| verdict[key].as_str().unwrap_or_default());
        assert!(issue.contains("doubtful"), "{verdict}");
        assert_eq!(option, "--feature mask");
        assert!(suggestion.contains("--feature labels"), "{verdict}");
        // With an explicit option there is no doubt.
        let (report, regions_found) = regions(folder, "tube.npy --feature labels");
        assert_eq!(regions_found.len(), 2);
        assert_eq!(report["doubt"], serde_json::Value::Null);
        assert!(regions_found[1].1.abs() < 2.0, "{regions_found:?}");
        for name in ["tube.nii", "tube.mha", "tube.nrrd"] {
            run(folder, &format!("convert tube.npy {name} --quiet"));
            let (report, regions_found) = regions(folder, name);
            assert_eq!(regions_found.len(), 2, "{name}");
            assert_eq!(report["doubt"], serde_json::Value::Null, "{name}");
        }
    }
    let survey = Survey {
        inlines: 30,
        crosslines: 28,
        samples: 32,
    };
    write_segy(
        &folder.join("paint.sgy"),
        &survey,
        |[sample, crossline, _]| {
            f32::from(u8::from(
                (crossline as f32 - 14.0 - 0.2 * sample as f32).abs() < 1.5,
            ))
        },
    );
    let (report, regions_found) = regions(folder, "paint.sgy --distance 5");
    assert!(regions_found.is_empty(), "{report}");
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("the mesh follows the middle of this paint"),
        "{notes}"
    );
    // In other formats the user can select this by name.
    write_npy(&folder.join("paint.npy"), [32, 28, 30], |[x, y, _]| {
        f32::from(u8::from((y as f32 - 14.0 - 0.2 * x as f32).abs() < 1.5))
    });
    let (_, regions_found) = regions(folder, "paint.npy --distance 5 --feature mask");
    assert!(regions_found.is_empty());
}

#[test]
fn polycrystals_are_labels_and_grey_values_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (side, grains) in [(30, 70), (40, 180)] {
        let sites: Vec<[f64; 3]> = (0..grains)
            .map(|site| [0, 1, 2].map(|k| side as f64 * noise([site * 7 + 1, k + 3, site + k])))
            .collect();
        let nearest = |index: [usize; 3]| {
            let distance_to = |site: &usize| distance(index, sites[*site]);
            let best = (0..grains).min_by(|a, b| distance_to(a).total_cmp(&distance_to(b)));
            best.unwrap() as f32
        };
        write_npy(&folder.join("grains.npy"), [side; 3], nearest);
        let stdout = run(folder, "feature grains.npy -o b.vti --distance 4");
        assert!(stdout.contains("features: labels"), "{stdout}");
    }
    // The images have 256 grey values with and without noise.
    for amount in [0.0, 20.0] {
        write_npy(&folder.join("grey.npy"), [40, 36, 32], |index| {
            let inside = 200.0 / (1.0 + (distance(index, [20.0, 18.0, 16.0]) - 11.0).exp());
            (inside + amount * noise(index)).round() as f32
        });
        let stdout = run(folder, "feature grey.npy -o b.vti --distance 4");
        assert!(!stdout.contains("features: labels"), "{stdout}");
    }
}

#[test]
fn hounsfield_units_are_no_amplitudes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The values are those of air, tissue and bone with noise. Half of them are negative.
    write_npy(&folder.join("ct.npy"), [40, 40, 40], |index| {
        let [x, y, _] = index.map(|i| i as f64);
        let distance = (x - 20.0).hypot(y - 20.0);
        let tissue = match () {
            () if distance < 4.0 => 1200.0,
            () if distance < 15.0 => 40.0,
            () => -1000.0,
        };
        (tissue + 160.0 * (noise(index) - 0.5)).round() as f32
    });
    let stdout = run(folder, "feature ct.npy -o b.vti --distance 4");
    assert!(!stdout.contains("features: horizons"), "{stdout}");
    run(folder, "convert ct.npy ct.nii.gz --quiet");
    let stdout = run(folder, "feature ct.nii.gz -o b.vti --distance 4");
    assert!(stdout.contains("features: edges"), "{stdout}");
    // Amplitudes of layers are recognised if the format gives no hint.
    write_npy(&folder.join("layers.npy"), [40, 40, 40], |index| {
        let [x, y, z] = index.map(|i| i as f64);
        let depth = z + 0.2 * x + 1.5 * (y / 9.0).sin();
        (1000.0 * (depth / 1.9).sin() * (0.5 + 0.5 * (depth / 11.0).sin()) + 50.0 * noise(index))
            as f32
    });
    let stdout = run(folder, "feature layers.npy -o b.vti --distance 4");
    assert!(stdout.contains("features: horizons"), "{stdout}");
    run(folder, "convert layers.npy layers.nii.gz --quiet");
    let stdout = run(folder, "feature layers.nii.gz -o b.vti --distance 4");
    assert!(!stdout.contains("features: horizons"), "{stdout}");
}

#[test]
fn an_isosurface_has_its_value() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A bone of 1200 HU with a soft edge in tissue of 40 HU, with noise.
    const RADIUS: f64 = 13.0;
    let centre = [24.0, 21.0, 20.0];
    write_npy(&folder.join("bone.npy"), [48, 44, 40], |index| {
        let edge = ((RADIUS - distance(index, centre)) / 1.2).tanh();
        (40.0 + 580.0 * (1.0 + edge) + 60.0 * (noise(index) - 0.5)) as f32
    });
    // Without a value, the threshold of Otsu is near the middle of the two classes.
    for (value, note) in [
        ("--threshold 300", "isosurface of the value 300 (given)"),
        ("", "(Otsu's threshold)"),
    ] {
        run(
            folder,
            &format!(
                "mesh bone.npy -o m.vtu --feature isosurface {value} --distance 4 --report r.json --quiet"
            ),
        );
        let text = std::fs::read_to_string(folder.join("r.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert!(report["notes"].to_string().contains(note), "{report}");
        let faces = &report["fidelity"]["tagged_faces"];
        let [coverage, precision] =
            ["coverage_one", "precision"].map(|key| faces[key].as_f64().unwrap());
        assert!(coverage > 0.95 && precision > 0.95, "{faces}");
    }
    let error = expect_refusal(
        folder,
        &[
            "feature",
            "bone.npy",
            "-o",
            "b.vti",
            "--feature",
            "isosurface",
            "--threshold",
            "3000",
        ],
    );
    assert!(
        error.contains("threshold 3000") && error.contains("values of the image are from"),
        "{error}"
    );
}

/// Returns the volumes by label of the regions in a report, with those of the image.
fn volumes(report: &serde_json::Value) -> Vec<[f64; 2]> {
    assert_eq!(report["regions"]["volume_reference"], "interpolated-values");
    let regions = report["regions"]["regions"].as_array().unwrap();
    let volumes = regions
        .iter()
        .map(|region| ["volume", "sample_volume"].map(|key| region[key].as_f64().unwrap()));
    volumes.collect()
}

#[test]
fn solids_between_thresholds_have_their_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let ball = |r: f64| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
    // Balls that fall from 1000 to 0 over an edge, at several places and widths: the radius is where it is 500.
    for (radius, width, shift) in [(10.0, 0.9, 0.3), (12.3, 1.5, 0.5), (12.3, 2.5, 0.17)] {
        let centre = [24.0 + shift, 23.0 - shift, 22.0 + 2.0 * shift];
        write_npy(&folder.join("ball.npy"), [48, 46, 44], |index| {
            (500.0 * (1.0 + ((radius - distance(index, centre)) / width).tanh())) as f32
        });
        let (report, _) = regions(folder, "ball.npy --feature isosurface --threshold 500");
        let found = volumes(&report);
        assert_eq!(found.len(), 2, "{report}");
        for volume in found[1] {
            let error = 100.0 * (volume / ball(radius) - 1.0);
            assert!(error.abs() < 0.3, "{radius} {width}: {error} %");
        }
        let names: Vec<&str> = (report["regions"]["regions"].as_array().unwrap().iter())
            .map(|region| region["name"].as_str().unwrap())
            .collect();
        assert_eq!(names, ["below", "above"]);
    }
    // Three regions; the outer two are cut by sides of the image.
    let centre = [24.0, 21.0, 3.0];
    write_npy(&folder.join("shells.npy"), [48, 44, 30], |index| {
        (50.0 * (24.0 - distance(index, centre))) as f32
    });
    let (report, _) = regions(
        folder,
        "shells.npy --feature isosurface --threshold 300,700 --distance 4",
    );
    let found = volumes(&report);
    assert_eq!(found.len(), 3, "{report}");
    for [volume, expected] in found {
        assert!(
            (volume / expected - 1.0).abs() < 0.005,
            "{volume} {expected}"
        );
    }
    let error = expect_refusal(
        folder,
        &[
            "mesh",
            "shells.npy",
            "-o",
            "e.vtu",
            "--feature",
            "edges",
            "--threshold",
            "300,700",
        ],
    );
    assert!(error.contains("threshold 300,700"), "{error}");
}

#[test]
fn small_parts_join_their_surroundings_before_meshing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let inside = |index: [usize; 3]| {
        distance(index, [16.0, 16.0, 14.0]) < 9.0 || distance(index, [29.0, 29.0, 25.0]) < 2.6
    };
    // The small ball has 81 samples.
    write_npy(&folder.join("labels.npy"), [34, 34, 30], |index| {
        f32::from(u8::from(inside(index)))
    });
    write_npy(&folder.join("values.npy"), [34, 34, 30], |index| {
        100.0 * f32::from(u8::from(inside(index)))
    });
    for image in [
        "labels.npy --feature labels",
        "values.npy --feature isosurface --threshold 50",
    ] {
        for (option, parts) in [("", 2), ("--min-part 60", 2), ("--min-part 100", 1)] {
            let (report, _) = regions(folder, &format!("{image} --distance 2 {option}"));
            let inside = &report["regions"]["regions"][1];
            assert_eq!(inside["parts"], parts, "{image} {option}: {report}");
            assert!(report["regions"]["lost"].as_array().unwrap().is_empty());
        }
    }
    let error = expect_refusal(
        folder,
        &[
            "mesh",
            "values.npy",
            "-o",
            "e.vtu",
            "--feature",
            "edges",
            "--min-part",
            "20",
        ],
    );
    assert!(error.contains("min-part 20"), "{error}");
}

#[test]
fn cells_of_labels_are_well_shaped_in_space_unless_samples_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let ball = |at| f32::from(u8::from(distance(at, [16.0, 16.0, 8.0]) < 7.0));
    write_npy(&folder.join("ball.npy"), [32, 32, 16], ball);
    let mesh = |image: &str, options: &str| {
        let mesh = format!(
            "mesh {image} {options} --feature labels --distance 4 -o m.vtu --report r.json"
        );
        run(folder, &format!("{mesh} --quiet"));
        let text = std::fs::read_to_string(folder.join("r.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&text).unwrap();
        let worst = |key: &str| report[key]["smallest_angle"]["worst"].as_f64();
        (worst("quality").unwrap(), worst("quality_physical"))
    };
    // Slices three times as far apart as the samples in them.
    let spacing = "--spacing 0.5,0.5,1.5";
    run(
        folder,
        &format!("convert ball.npy scan.nii {spacing} --unit mm --quiet"),
    );
    let (in_lattice, in_space) = mesh("scan.nii", "");
    assert!(in_lattice >= 20.0 && in_space.unwrap_or(in_lattice) >= 20.0);
    let shape = std::fs::read(folder.join("m.vtu")).unwrap();
    assert_eq!(mesh("scan.nii", "--metric shape").0, in_lattice);
    assert!(std::fs::read(folder.join("m.vtu")).unwrap() == shape);
    assert!(mesh("scan.nii", "--metric samples").1.unwrap() < 20.0);
    let (in_lattice, in_space) = mesh("ball.npy", spacing);
    assert!(in_lattice >= 20.0 && in_space.unwrap_or(in_lattice) >= 20.0);
}
