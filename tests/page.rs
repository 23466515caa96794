//! Tests HTML pages: the program writes them, and a headless browser opens them.

use std::path::Path;
use std::process::Command;

use crate::common::{expect_refusal, planar_fault, run, write_npy, write_npy_2d};

/// Opens pages in Chromium and uses all their controls at two sizes in dark and light mode. Asserts
/// that there is no error and no network request. Screenshots go to `folder`.
fn assert_pages_work(folder: &Path, pages: &[&str]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/page/look.py");
    let output = Command::new("python3")
        .arg("-B")
        .arg(script)
        .arg(folder)
        .args(pages)
        .current_dir(folder)
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stdout}\n{stderr}");
    assert_eq!(stdout.lines().count(), pages.len(), "{stdout}");
}

/// Returns the amplitude of layers that are displaced along the middle.
fn broken_layers([x, y]: [usize; 2]) -> f32 {
    let throw = if x < 40 { 0.0 } else { 5.0 };
    (0.5 * (y as f32 + throw) + 0.02 * x as f32).sin()
}

#[test]
#[ignore = "needs Chromium: make test-all"]
fn pages_of_every_kind_of_cell_work() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    write_npy_2d(&dir.join("line.npy"), [80, 60], broken_layers);
    // The page of tetrahedra comes with the report of the run.
    let stdout = run(
        dir,
        "mesh sheet.npy -o tets.vtu --distance 6 --page tets.html",
    );
    assert!(stdout.contains("wrote tets.html"), "{stdout}");
    run(
        dir,
        "mesh sheet.npy -o cells.vtu --distance 6 --cells voronoi --quiet",
    );
    run(
        dir,
        "mesh line.npy -o line.vtu --distance 6 --feature faults --report line.json --quiet",
    );
    run(
        dir,
        "mesh line.npy -o polygons.vtu --distance 6 --feature faults --cells voronoi --quiet",
    );
    run(dir, "report sheet.npy cells.vtu -o cells.html --quiet");
    run(
        dir,
        "report line.npy line.vtu -o line.html --figures line.json --quiet",
    );
    run(dir, "report line.npy polygons.vtu -o polygons.html --quiet");
    assert_pages_work(
        dir,
        &["tets.html", "cells.html", "line.html", "polygons.html"],
    );
}

#[test]
fn the_pages_of_mesh_and_report_hold_the_same_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(
        dir,
        "mesh sheet.npy -o a.vtu --distance 6 --page a.html --quiet",
    );
    run(dir, "report sheet.npy a.vtu -o b.html --quiet");
    let data = |name: &str| {
        let page = std::fs::read_to_string(dir.join(name)).unwrap();
        let start = page.find("id=\"data\">").unwrap();
        page[start..start + page[start..].find('<').unwrap()].to_string()
    };
    assert!(data("a.html").len() > 10_000);
    assert!(data("a.html") == data("b.html"), "the pages differ");
}

/// Tests a fault that crosses the box: the mesh comes with the surface file and the values of the
/// image.
#[test]
fn a_mesh_has_its_surfaces_and_the_values_of_its_image() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let value = |[x, y, z]: [usize; 3]| planar_fault([40, 36, 32])([x, y, z]);
    write_npy(&dir.join("sheet.npy"), [40, 36, 32], value);
    run(
        dir,
        "mesh sheet.npy -o a.vtu --distance 6 --surfaces a.vtp --quiet",
    );
    run(dir, "surface a.vtu -o b.vtp --quiet");
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(bytes("a.vtp").len() > 1000 && bytes("a.vtp") == bytes("b.vtp"));

    let file = atomesh::store::read_vtu(&dir.join("a.vtu")).unwrap();
    let on_nodes = file.point_data.iter().find(|a| a.name == "image").unwrap();
    let on_nodes = on_nodes.values.to_f64();
    let nearest_sample = |x: [f64; 3]| {
        let index = x.map(|c| c.round() as usize);
        (f64::from(value(index)), x)
    };
    for (&value_of_node, &node) in on_nodes.iter().zip(&file.mesh.nodes) {
        let (sample, x) = nearest_sample(node);
        // The largest slope is 0.41 per sample.
        let distance = (0..3).map(|k| (x[k] - x[k].round()).abs()).sum::<f64>();
        assert!(
            (value_of_node - sample).abs() <= 0.42 * distance + 1e-5,
            "{x:?}: {value_of_node}"
        );
    }
    let cells = file.cell_array("image").unwrap();
    assert_eq!(cells.values.len(), file.mesh.tets.len());
    // An edited mesh has them, too.
    run(dir, "edit a.vtu sheet.npy -o c.vtu --add 10,10,10 --quiet");
    let edited = atomesh::store::read_vtu(&dir.join("c.vtu")).unwrap();
    assert!(edited.cell_array("image").is_some());
}

#[test]
fn impossible_pages_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    write_npy(
        &dir.join("other.npy"),
        [40, 36, 30],
        planar_fault([40, 36, 30]),
    );
    write_npy_2d(&dir.join("line.npy"), [80, 60], broken_layers);
    std::fs::write(dir.join("no.json"), "{\"a\": 1}").unwrap();
    run(dir, "mesh sheet.npy -o a.vtu --distance 8 --quiet");
    for (line, expected) in [
        (
            "report line.npy a.vtu -o p.html",
            "is a 3-D mesh, but the image is 2-D",
        ),
        ("report other.npy a.vtu -o p.html", "[40, 36, 30] samples"),
        ("report sheet.npy a.vtu -o p.txt", "does not end in .html"),
        ("report sheet.npy a.vtu -o a.vtu", "does not end in .html"),
        (
            "report sheet.npy a.vtu -o p.html --figures no.json",
            "is not a report of atomesh",
        ),
        ("report sheet.npy absent.vtu -o p.html", "absent.vtu"),
        (
            "mesh sheet.npy -o b.vtu --page b.vtu",
            "does not end in .html",
        ),
        (
            "slice line.npy a.vtu -o p.png --view 3d",
            "the image is 2-D",
        ),
        (
            "slice sheet.npy a.vtu -o p.png --view 3d --at 100,0,0",
            "lies outside the image",
        ),
    ] {
        let error = expect_refusal(dir, &line.split(' ').collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}: {error}");
    }
}

#[test]
fn every_mesh_in_space_is_drawn_as_a_body_with_an_open_corner() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(dir, "mesh sheet.npy -o tets.vtu --distance 6 --quiet");
    run(
        dir,
        "mesh sheet.npy -o cells.vtu --distance 6 --cells voronoi --quiet",
    );
    for mesh in ["tets", "cells"] {
        run(
            dir,
            &format!("slice sheet.npy {mesh}.vtu -o {mesh}.png --view 3d --quiet"),
        );
        run(dir, &format!("convert {mesh}.png {mesh}.npy --quiet"));
        let bytes = std::fs::read(dir.join(format!("{mesh}.npy"))).unwrap();
        let values: Vec<f32> = (bytes[128..].chunks_exact(4))
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        let white = values.iter().copied().fold(0.0, f32::max);
        let drawn = values.iter().filter(|&&v| v < 0.98 * white).count();
        assert!(
            5 * drawn > values.len(),
            "{mesh}: {drawn} of {}",
            values.len()
        );
    }
}
