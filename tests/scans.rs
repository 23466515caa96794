//! Scans and labels: what `auto` makes of images by their format, their geometry and their values.

use std::path::Path;

use crate::common::{Survey, write_npy, run, write_segy};

/// The distance from a point.
fn from([x, y, z]: [usize; 3], centre: [f64; 3]) -> f64 {
    let p = [x, y, z].map(|i| i as f64);
    (0..3)
        .map(|k| (p[k] - centre[k]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// A number in [0, 1) that a sample's place decides.
fn noise([x, y, z]: [usize; 3]) -> f64 {
    let mut h = (x * 73_856_093) ^ (y * 19_349_663) ^ (z * 83_492_791);
    h = (h ^ (h >> 13)).wrapping_mul(1_274_126_177);
    ((h ^ (h >> 16)) & 0xffff) as f64 / 65_536.0
}

/// A tube of diameter 5 along one axis, that winds.
fn tube(axis: usize) -> impl Fn([usize; 3]) -> f32 {
    move |at| {
        let along = at[axis] as f64;
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3].map(|k| at[k] as f64);
        let off = (u - 16.0 - 3.0 * (along / 7.0).sin()).hypot(v - 15.0);
        f32::from(u8::from(off < 2.5))
    }
}

/// What the report says of regions: the label and the percentage that its volume is off, of each.
fn regions(folder: &Path, options: &str) -> (serde_json::Value, Vec<(f64, f64)>) {
    run(
        folder,
        &format!("mesh {options} -o m.vtu --report r.json --quiet"),
    );
    let text = std::fs::read_to_string(folder.join("r.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let regions = report["regions"]["regions"].as_array();
    let of = |region: &serde_json::Value| {
        let number = |key: &str| region[key].as_f64().unwrap();
        (number("label"), number("off_percent"))
    };
    let regions = regions.map_or(Vec::new(), |regions| regions.iter().map(of).collect());
    (report, regions)
}

#[test]
fn an_object_in_a_mask_is_a_region_and_paint_on_faults_only_in_a_survey() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for axis in 0..3 {
        write_npy(&folder.join("tube.npy"), [32, 32, 32], tube(axis));
        // Neither format nor geometry tells: the verdict asks.
        let (report, found) = regions(folder, "tube.npy");
        assert_eq!(found.len(), 2, "{report}");
        let verdict = &report["verdict"];
        let [issue, option, suggestion] =
            ["issue", "option", "suggestion"].map(|key| verdict[key].as_str().unwrap_or_default());
        assert!(issue.contains("doubtful"), "{verdict}");
        assert_eq!(option, "--feature mask");
        assert!(suggestion.contains("--feature labels"), "{verdict}");
        // Asked for labels there is no doubt.
        let (report, found) = regions(folder, "tube.npy --feature labels");
        assert_eq!(found.len(), 2);
        assert_eq!(report["doubt"], serde_json::Value::Null);
        assert!(found[1].1.abs() < 2.0, "{found:?}");
        for name in ["tube.nii", "tube.mha", "tube.nrrd"] {
            run(folder, &format!("convert tube.npy {name} --quiet"));
            let (report, found) = regions(folder, name);
            assert_eq!(found.len(), 2, "{name}");
            assert_eq!(report["doubt"], serde_json::Value::Null, "{name}");
        }
    }
    let survey = Survey {
        inlines: 30,
        crosslines: 28,
        samples: 32,
    };
    write_segy(&folder.join("paint.sgy"), &survey, |[sample, cross, _]| {
        f32::from(u8::from(
            (cross as f32 - 14.0 - 0.2 * sample as f32).abs() < 1.5,
        ))
    });
    let (report, found) = regions(folder, "paint.sgy --distance 5");
    assert!(found.is_empty(), "{report}");
    let notes = report["notes"].to_string();
    assert!(notes.contains("its middle is the feature"), "{notes}");
    // Elsewhere it can be had by its name.
    write_npy(&folder.join("paint.npy"), [32, 28, 30], |[x, y, _]| {
        f32::from(u8::from((y as f32 - 14.0 - 0.2 * x as f32).abs() < 1.5))
    });
    let (_, found) = regions(folder, "paint.npy --distance 5 --feature mask");
    assert!(found.is_empty());
}

#[test]
fn polycrystals_and_atlases_are_labels_and_grey_values_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (side, grains) in [(30, 70), (40, 180)] {
        let sites: Vec<[f64; 3]> = (0..grains)
            .map(|i| [0, 1, 2].map(|k| side as f64 * noise([i * 7 + 1, k + 3, i + k])))
            .collect();
        let nearest = |at: [usize; 3]| {
            let off = |i: &usize| from(at, sites[*i]);
            let best = (0..grains).min_by(|a, b| off(a).total_cmp(&off(b)));
            best.unwrap() as f32
        };
        write_npy(&folder.join("grains.npy"), [side; 3], nearest);
        let said = run(folder, "feature grains.npy -o b.vti --distance 4");
        assert!(said.contains("features: labels"), "{said}");
    }
    // 256 grey values with noise, and without.
    for amount in [0.0, 20.0] {
        write_npy(&folder.join("grey.npy"), [40, 36, 32], |at| {
            let inside = 200.0 / (1.0 + (from(at, [20.0, 18.0, 16.0]) - 11.0).exp());
            (inside + amount * noise(at)).round() as f32
        });
        let said = run(folder, "feature grey.npy -o b.vti --distance 4");
        assert!(!said.contains("features: labels"), "{said}");
    }
}

#[test]
fn hounsfield_numbers_are_no_amplitudes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Air, tissue and bone, with noise; of the values half are below zero.
    write_npy(&folder.join("ct.npy"), [40, 40, 40], |at| {
        let [x, y, _] = at.map(|i| i as f64);
        let off = (x - 20.0).hypot(y - 20.0);
        let tissue = match () {
            () if off < 4.0 => 1200.0,
            () if off < 15.0 => 40.0,
            () => -1000.0,
        };
        (tissue + 160.0 * (noise(at) - 0.5)).round() as f32
    });
    let said = run(folder, "feature ct.npy -o b.vti --distance 4");
    assert!(!said.contains("features: horizons"), "{said}");
    run(folder, "convert ct.npy ct.nii.gz --quiet");
    let said = run(folder, "feature ct.nii.gz -o b.vti --distance 4");
    assert!(said.contains("features: edges"), "{said}");
    // Amplitudes of layers are, where the format does not tell.
    write_npy(&folder.join("layers.npy"), [40, 40, 40], |at| {
        let [x, y, z] = at.map(|i| i as f64);
        let depth = z + 0.2 * x + 1.5 * (y / 9.0).sin();
        (1000.0 * (depth / 1.9).sin() * (0.5 + 0.5 * (depth / 11.0).sin()) + 50.0 * noise(at))
            as f32
    });
    let said = run(folder, "feature layers.npy -o b.vti --distance 4");
    assert!(said.contains("features: horizons"), "{said}");
    run(folder, "convert layers.npy layers.nii.gz --quiet");
    let said = run(folder, "feature layers.nii.gz -o b.vti --distance 4");
    assert!(!said.contains("features: horizons"), "{said}");
}
