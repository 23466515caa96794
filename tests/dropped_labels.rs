//! Tests meshes of which labels are left out: volumes, boundaries, holes, and every format of `export`.

use std::path::Path;

use crate::common::{expect_refusal, is_close, run, write_npy, write_npy_2d, write_npy_u64};
use atomesh::mesh::Mesh;
use atomesh::store::{FieldValue, TakeCells, read_any_vtu, take_cells};
use atomesh::with_mesh;
use serde_json::Value;

const DIMS: [usize; 3] = [31, 25, 21];

/// Returns a label: a box of label 3 in a layer of 1, with 0 above both, and an island of 3 in 0.
fn label([x, y, z]: [usize; 3]) -> f32 {
    let is_in_box = (8..=22).contains(&x) && (6..=18).contains(&y) && (5..=14).contains(&z);
    let is_island = x < 4 && y < 5 && z > 15;
    match z {
        _ if is_in_box || is_island => 3.0,
        0..=10 => 1.0,
        _ => 0.0,
    }
}

/// Returns a label of the plane: a rectangle of 3 in 1, beside 0.
fn label_2d([x, y]: [usize; 2]) -> f32 {
    if (10..=25).contains(&x) && (8..=20).contains(&y) {
        3.0
    } else if y < 15 {
        1.0
    } else {
        0.0
    }
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("l3.npy"), DIMS, label);
    write_npy_2d(&folder.path().join("l2.npy"), [40, 30], label_2d);
    folder
}

fn json(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("{line} --json --quiet"))).unwrap()
}

/// Returns the volume of the cells of a mesh, the names of its outer boundary, and its regions.
fn content(path: &Path) -> (f64, Vec<String>, Vec<i32>) {
    let text = |value: Option<&FieldValue>| match value {
        Some(FieldValue::Text(text)) => text.lines().map(str::to_string).collect(),
        _ => Vec::new(),
    };
    with_mesh!(read_any_vtu(path).unwrap(), file => {
        let mut regions = file.mesh.cell_regions(&file.cell_data);
        regions.sort_unstable();
        regions.dedup();
        (file.mesh.volumes().iter().sum(), text(file.field_value("outer_boundary")), regions)
    })
}

#[test]
fn what_is_dropped_leaves_named_boundaries_in_all_kinds_of_cells() {
    let folder = folder();
    let path = folder.path();
    for (image, cells) in [
        ("l3", "tets"),
        ("l3", "voronoi"),
        ("l2", "tets"),
        ("l2", "voronoi"),
    ] {
        let mesh =
            format!("mesh {image}.npy --distance 4 --cells {cells} --label 3:name=core --quiet");
        run(path, &format!("{mesh} -o all.vtu --feature labels"));
        run(path, &format!("{mesh} -o part.vtu --drop 0"));
        run(path, &format!("{mesh} -o kept.vtu --keep 1,core"));
        let (part, kept) = (path.join("part.vtu"), path.join("kept.vtu"));
        let (volume, boundary, regions) = content(&part);
        assert_eq!(regions, [1, 3], "{image} {cells}");
        assert_eq!(
            boundary,
            ["interface_0_1", "interface_0_core"],
            "{image} {cells}"
        );
        // The two options make the same cells.
        assert_eq!(
            (volume, boundary, regions),
            content(&kept),
            "{image} {cells}"
        );
        // Labels have the volumes of their samples, as in the mesh of all labels.
        let (whole, none, _) = content(&path.join("all.vtu"));
        assert!(none.is_empty());
        assert!(
            0.3 * whole < volume && volume < 0.9 * whole,
            "{volume} {whole}"
        );
        let verdicts = json(path, "validate part.vtu");
        assert_eq!(verdicts["valid"], true, "{verdicts}");
        let quality = json(path, "quality part.vtu");
        let problems = quality["box"]["problems"].as_array();
        assert!(problems.is_none_or(Vec::is_empty), "{quality}");
        // What export drops of the mesh of all labels are the same surfaces.
        let surface = run(path, "surface part.vtu --by regions -o s.vtp");
        assert!(surface.contains("interface_0_core"), "{surface}");
    }
}

#[test]
fn a_hole_in_a_mesh_without_a_label_is_found() {
    let folder = folder();
    let path = folder.path();
    for (image, cells) in [("l3", "tets"), ("l2", "tets"), ("l3", "voronoi")] {
        let options = "--distance 4 --drop 0 --quiet -o part.vtu";
        run(path, &format!("mesh {image}.npy --cells {cells} {options}"));
        with_mesh!(read_any_vtu(&path.join("part.vtu")).unwrap(), file => {
            let count = file.mesh.len() as u32;
            for hole in [0, count / 2, count - 1] {
                let rest: Vec<u32> = (0..count).filter(|cell| *cell != hole).collect();
                let mut holed = take_cells(file.clone(), &rest).unwrap();
                // The declaration of the mesh without the hole.
                for (name, value) in &mut holed.field_data {
                    let declared = ["outer_boundary", "filled_share"].contains(&name.as_str());
                    if let (true, Some(old)) = (declared, file.field_value(name)) {
                        *value = old.clone();
                    }
                }
                atomesh::store::AnyMesh::from(holed).write(&path.join("holed.vtu")).unwrap();
                let error = expect_refusal(path, &["validate", "holed.vtu"]);
                assert!(error.contains("holed.vtu"), "{error}");
                let line = ["export", "holed.vtu", "--to", "vtkhdf", "-o", "h.vtkhdf"];
                assert!(expect_refusal(path, &line).contains("cells are missing"));
            }
        });
    }
}

#[test]
fn the_largest_part_of_each_label_stays() {
    let folder = folder();
    let path = folder.path();
    let mesh = "mesh l3.npy --distance 3 --quiet --keep 3";
    run(path, &format!("{mesh} -o both.vtu"));
    run(path, &format!("{mesh} --keep-largest -o largest.vtu"));
    let [both, largest] = ["both.vtu", "largest.vtu"].map(|name| content(&path.join(name)));
    // A box of 15 x 13 x 10 samples, and an island of 4 x 5 x 5 in the corner of the image.
    let box_volume = 15.0 * 13.0 * 10.0;
    assert!(is_close(largest.0, box_volume, 0.01), "{largest:?}");
    assert!(both.0 > 1.02 * largest.0, "{both:?}");
    assert_eq!(json(path, "validate largest.vtu")["valid"], true);
    run(
        path,
        "mesh l3.npy --distance 3 --quiet --feature labels -o all.vtu",
    );
    run(
        path,
        "export all.vtu --to msh -o a.msh --keep 3 --keep-largest --quiet",
    );
    let text = std::fs::read_to_string(path.join("a.msh")).unwrap();
    assert!(
        text.contains("\"interface_0_3\"") && text.contains("\"interface_1_3\""),
        "{text}"
    );
    assert!(!text.contains("\"boundary\""));
}

#[test]
fn every_format_holds_a_mesh_without_its_background() {
    let folder = folder();
    let path = folder.path();
    for image in ["l3", "l2"] {
        run(
            path,
            &format!("mesh {image}.npy --distance 4 --drop 0 -o part.vtu --quiet"),
        );
        let formats = [
            ("msh", "a.msh"),
            ("msh2", "a2.msh"),
            ("inp", "a.inp"),
            ("nastran", "a.bdf"),
            ("exodus", "a.exo"),
            ("cgns", "a.cgns"),
            ("vtkhdf", "a.vtkhdf"),
            ("xdmf", "a.xdmf"),
            ("medit", "a.mesh"),
            ("stl", "a.stl"),
            ("obj", "a.obj"),
            ("openfoam", "case"),
            ("geos", "g.vtu"),
            ("mrst", "a.mat"),
        ];
        for (format, name) in formats {
            run(
                path,
                &format!("export part.vtu --to {format} -o {name} --quiet --down z"),
            );
        }
        for name in ["a.msh", "a2.msh", "a.inp"] {
            let text = std::fs::read_to_string(path.join(name))
                .unwrap()
                .to_lowercase();
            for set in ["interface_0_1", "interface_0_3", "xmin"] {
                assert!(text.contains(set), "{name} {set}");
            }
            assert!(!text.contains("\"boundary\""), "{name}");
        }
        let boundary =
            std::fs::read_to_string(path.join("case/constant/polyMesh/boundary")).unwrap();
        assert!(boundary.contains("interface_0_1") && boundary.contains("interface_0_3"));
        // Only sides that the layers reach have faces.
        let fluxes = json(
            path,
            "flow part.vtu -o f.vtu --pressure xmin=1 --pressure xmax=0 --permeability 1",
        );
        assert!(fluxes.to_string().len() > 10);
    }
}

#[test]
fn what_is_not_there_is_refused_with_one_line() {
    let folder = folder();
    let path = folder.path();
    run(
        path,
        "mesh l3.npy --distance 6 --feature labels -o all.vtu --quiet",
    );
    run(
        path,
        "mesh l3.npy --distance 6 --drop 0 -o part.vtu --quiet",
    );
    for (line, says) in [
        ("mesh l3.npy --drop 7 -o a.vtu", "drop 7: is no label"),
        ("mesh l3.npy --drop bone -o a.vtu", "which has 0, 1, 3"),
        ("mesh l3.npy --drop 0,1,3 -o a.vtu", "leaves out all labels"),
        (
            "mesh l3.npy --feature edges --drop 0 -o a.vtu",
            "is about a label",
        ),
        ("mesh l3.npy --drop 0 -o a.pvtu", "several files"),
        ("mesh l3.npy --drop 0 --pad sides=5 -o a.vtu", "pad"),
        (
            "export all.vtu --to msh -o a.msh --keep 9",
            "keep 9: is no label",
        ),
        (
            "mesh l3.npy --distance 3mm -o a.vtu",
            "--spacing 1,1,1 --unit mm",
        ),
        (
            "mesh l3.npy --cover voxels --cells voronoi -o a.vtu",
            "cover voxels",
        ),
        (
            "edit part.vtu l3.npy --add 5,5,5 -o e.vtu",
            "labels were left out",
        ),
    ] {
        let arguments: Vec<&str> = line.split(' ').collect();
        let error = expect_refusal(path, &arguments);
        assert!(error.contains(says), "{line}: {error}");
    }
}

#[test]
fn lengths_have_the_size_that_they_say() {
    let folder = folder();
    let path = folder.path();
    let place = "--spacing 0.5,0.5,2 --unit mm";
    let mesh = "--feature labels --quiet -o a.vtu --report a.json";
    run(path, &format!("mesh l3.npy {place} --distance 4mm {mesh}"));
    let text = std::fs::read_to_string(path.join("a.json")).unwrap();
    let report: Value = serde_json::from_str(&text).unwrap();
    let lengths: Vec<f64> = serde_json::from_value(report["body"]["lengths"].clone()).unwrap();
    let expected = [15.0, 12.0, 40.0];
    let pairs = lengths.iter().zip(expected);
    assert!(
        lengths.len() == 3 && pairs.clone().all(|(a, b)| (a - b).abs() < 1e-9),
        "{lengths:?}"
    );
    // Tetrahedra of a face-centred cubic lattice have the mean volume d^3 / (6 sqrt 2) or so.
    let cells = report["quality"]["cells"].as_f64().unwrap();
    let mean = lengths.iter().product::<f64>() / cells;
    let ideal = 4f64.powi(3) / 8.5;
    assert!((0.4 * ideal..1.6 * ideal).contains(&mean), "{mean} {ideal}");
    // A distance of 400 um in each label is the same in samples.
    let both = |distance: &str| {
        let options = format!("mesh l2.npy --spacing 0.2,0.2 --unit mm --distance {distance}");
        run(
            path,
            &format!("{options} --feature labels --quiet -o b.vtu"),
        );
        content(&path.join("b.vtu"))
    };
    let (volume, outer, regions) = both("4");
    for distance in ["0.8mm", "800um"] {
        let found = both(distance);
        assert!(is_close(found.0, volume, 1e-9), "{distance}: {found:?}");
        assert_eq!((&found.1, &found.2), (&outer, &regions));
    }
}

#[test]
fn full_voxels_have_the_volume_of_the_image() {
    let folder = folder();
    let path = folder.path();
    for (image, samples) in [("l3", 31.0 * 25.0 * 21.0), ("l2", 40.0 * 30.0)] {
        for feature in ["labels", "none", "isosurface --threshold 0.5"] {
            let options =
                format!("--cover voxels --distance 5 --feature {feature} --quiet -o v.vtu");
            run(path, &format!("mesh {image}.npy {options}"));
            let (volume, _, _) = content(&path.join("v.vtu"));
            assert!(
                is_close(volume, samples, 1e-9),
                "{image} {feature}: {volume} {samples}"
            );
            assert_eq!(json(path, "validate v.vtu")["valid"], true);
        }
        let dropped = "--cover voxels --distance 4 --drop 0 --quiet -o d.vtu --report d.json";
        run(path, &format!("mesh {image}.npy {dropped}"));
        assert_eq!(json(path, "validate d.vtu")["valid"], true);
        let text = std::fs::read_to_string(path.join("d.json")).unwrap();
        let report: Value = serde_json::from_str(&text).unwrap();
        for region in report["regions"]["regions"].as_array().unwrap() {
            assert_eq!(
                region["sample_volume"].as_f64(),
                region["samples"].as_f64(),
                "{region}"
            );
            let error = region["volume_error_percent"].as_f64().unwrap();
            assert!(error.abs() < 2.0, "{region}");
        }
    }
}

#[test]
fn labels_that_are_left_out_are_not_judged() {
    let folder = folder();
    for (options, parts) in [
        ("--drop 0", 3),
        ("--keep 3", 2),
        ("--keep 3 --keep-largest", 1),
    ] {
        let mesh = format!("mesh l3.npy -o k.vtu --feature labels --distance 3 {options}");
        let reports =
            [&*mesh, "quality k.vtu --labels l3.npy"].map(|line| json(folder.path(), line));
        for report in reports {
            let certificate = &report["certificate"];
            assert_eq!(certificate["parts"], parts, "{options}");
            assert_eq!(certificate["lost_parts"], 0, "{options}");
            for part in certificate["part_reports"].as_array().unwrap() {
                let error = part["volume_error_percent"].as_f64().unwrap();
                assert!(error.abs() < 0.5, "{options}: {part}");
            }
        }
    }
}

#[test]
fn quality_judges_a_mesh_by_the_image_as_the_job_did() {
    let folder = folder();
    let path = folder.path();
    write_npy(&path.join("m3.npy"), DIMS, |[x, y, _]| {
        f32::from(x > 4 && y < 20)
    });
    write_npy_2d(&path.join("m2.npy"), [40, 30], |[x, _]| f32::from(x > 7));
    for (image, options) in [
        ("l3", ""),
        ("l3", "--drop 0"),
        ("l3", "--keep 3 --keep-largest"),
        ("l3", "--cover voxels"),
        ("l3", "--cover voxels --drop 0"),
        ("l3", "--min-part 300"),
        ("l3", "--label 3:into=1"),
        ("l3", "--crop i=2:28"),
        ("l3", "--inside m3.npy"),
        ("l3", "--inside m3.npy --crop j=0:21 --drop 0"),
        ("l3", "--inside m3.npy --cells voronoi"),
        ("l3", "--cells voronoi --drop 0"),
        ("l2", "--drop 0"),
        ("l2", "--cover voxels"),
        ("l2", "--inside m2.npy"),
        ("l2", "--inside m2.npy --cells voronoi"),
    ] {
        let mesh = format!("mesh {image}.npy -o q.vtu --feature labels --distance 4 {options}");
        let quality = format!("quality q.vtu --labels {image}.npy");
        let [made, judged] = [mesh, quality].map(|line| json(path, &line)["certificate"].clone());
        assert_eq!(made["parts"], judged["parts"], "{image} {options}");
        let [made, judged] = [&made, &judged].map(|c| c["part_reports"].as_array().unwrap());
        for (a, b) in made.iter().zip(judged) {
            for figure in [
                "/label",
                "/samples",
                "/mesh_euler",
                "/volume",
                "/dice",
                "/boundary/mean",
                "/boundary/within_one",
                "/faces/mean",
                "/faces/worst",
            ] {
                let [a, b] = [a, b].map(|part| part.pointer(figure).and_then(Value::as_f64));
                let is_same = match (a, b) {
                    (Some(a), Some(b)) => (a - b).abs() <= 1e-4 * a.abs().max(1.0),
                    _ => a == b,
                };
                assert!(is_same, "{image} {options}: {figure} {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn what_lies_outside_of_a_mask_has_no_cells() {
    let folder = folder();
    let path = folder.path();
    // Also as integers that 32-bit floats round.
    write_npy(&path.join("m3.npy"), DIMS, |[x, y, _]| {
        f32::from(x > 4 && y < 23)
    });
    let large = |at: [usize; 3]| (1u64 << 40) + label(at) as u64;
    write_npy_u64(&path.join("large.npy"), DIMS, large);
    for (image, prefix, offset) in [("l3", "", 0), ("large", "label_", 1u64 << 40)] {
        for cells in ["tets", "voronoi"] {
            let line =
                format!("mesh {image}.npy -o in.vtu --inside m3.npy --feature labels --distance 4");
            run(path, &format!("{line} --cells {cells} --quiet"));
            let (volume, boundary, regions) = content(&path.join("in.vtu"));
            assert_eq!(regions.len(), 3, "{image} {cells}");
            // The outline lies halfway between samples.
            let expected = 25.5 * 22.5 * 20.0;
            let tolerance = if cells == "tets" { 2e-3 } else { 2e-2 };
            assert!(
                (volume / expected - 1.0).abs() < tolerance,
                "{image} {cells}: {volume}, not {expected}"
            );
            let outlines: Vec<String> = [0, 1]
                .iter()
                .map(|value| format!("interface_{prefix}{}_outside", offset + value))
                .collect();
            assert_eq!(boundary, outlines, "{image} {cells}");
        }
    }
}

#[test]
fn regions_between_thresholds_are_chosen_by_number_and_name() {
    let folder = folder();
    // The distance from the centre is the radius 12 less the value.
    let value = |at: [usize; 3]| {
        12.0 - at
            .map(|c| (c as f32 - 11.5).powi(2))
            .iter()
            .sum::<f32>()
            .sqrt()
    };
    write_npy(&folder.path().join("grey.npy"), [24; 3], value);
    let ball = |radius: f64| 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
    for (options, expected) in [
        ("--threshold 3 --keep above", ball(9.0)),
        ("--threshold 3,6 --keep 2", ball(6.0)),
        ("--threshold 3,6 --keep above", ball(6.0)),
        ("--threshold 3,6 --keep between", ball(9.0) - ball(6.0)),
        ("--threshold 3,6 --drop below", ball(9.0)),
    ] {
        let line = format!("mesh grey.npy -o g.vtu --feature isosurface --distance 3 {options}");
        run(folder.path(), &format!("{line} --quiet"));
        let (volume, ..) = content(&folder.path().join("g.vtu"));
        assert!(
            (volume / expected - 1.0).abs() < 0.01,
            "{options}: {volume}, not {expected}"
        );
    }
}
