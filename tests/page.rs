//! Pages to look at: made by the binary, opened in a headless browser.

use std::path::Path;
use std::process::Command;

use crate::common::{write_npy, write_npy_2d, expect_refusal, run, planar_fault};

/// Opens pages in Chromium and uses them: draws, cuts, sections, colours, clicks, keys, fingers, at two
/// sizes, dark and light, with no complaint and no request. Screenshots go to `folder`.
fn looked_at(folder: &Path, pages: &[&str]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/page/look.py");
    let output = Command::new("python3")
        .arg("-B")
        .arg(script)
        .arg(folder)
        .args(pages)
        .current_dir(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let failed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}\n{failed}");
    assert_eq!(said.lines().count(), pages.len(), "{said}");
}

/// Waves of amplitude, broken along the middle.
fn broken_layers([x, y]: [usize; 2]) -> f32 {
    let throw = if x < 40 { 0.0 } else { 5.0 };
    (0.5 * (y as f32 + throw) + 0.02 * x as f32).sin()
}

#[test]
#[ignore = "needs Chromium: make test-all"]
fn pages_of_every_kind_of_cell_are_drawn_and_answer() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("sheet.npy"), [40, 36, 32], planar_fault([40, 36, 32]));
    write_npy_2d(&at.join("line.npy"), [80, 60], broken_layers);
    // Tetrahedra with the report of their run.
    let said = run(
        at,
        "mesh sheet.npy -o tets.vtu --distance 6 --page tets.html",
    );
    assert!(said.contains("wrote tets.html"), "{said}");
    run(
        at,
        "mesh sheet.npy -o cells.vtu --distance 6 --cells voronoi --quiet",
    );
    run(
        at,
        "mesh line.npy -o line.vtu --distance 6 --feature faults --report line.json --quiet",
    );
    run(
        at,
        "mesh line.npy -o polygons.vtu --distance 6 --feature faults --cells voronoi --quiet",
    );
    run(at, "report sheet.npy cells.vtu -o cells.html --quiet");
    run(
        at,
        "report line.npy line.vtu -o line.html --figures line.json --quiet",
    );
    run(at, "report line.npy polygons.vtu -o polygons.html --quiet");
    looked_at(
        at,
        &["tets.html", "cells.html", "line.html", "polygons.html"],
    );
}

#[test]
fn the_page_of_mesh_and_that_of_report_hold_the_same_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("sheet.npy"), [40, 36, 32], planar_fault([40, 36, 32]));
    run(
        at,
        "mesh sheet.npy -o a.vtu --distance 6 --page a.html --quiet",
    );
    run(at, "report sheet.npy a.vtu -o b.html --quiet");
    let data = |name: &str| {
        let page = std::fs::read_to_string(at.join(name)).unwrap();
        let from = page.find("id=\"data\">").unwrap();
        page[from..from + page[from..].find('<').unwrap()].to_string()
    };
    assert!(data("a.html").len() > 10_000);
    assert!(data("a.html") == data("b.html"), "the pages differ");
}

/// A surface that crosses the box: all its faces have one number, and lie on it.
#[test]
fn a_mesh_comes_with_its_surfaces_and_with_the_values_of_its_image() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let value = |[x, y, z]: [usize; 3]| planar_fault([40, 36, 32])([x, y, z]);
    write_npy(&at.join("sheet.npy"), [40, 36, 32], value);
    run(
        at,
        "mesh sheet.npy -o a.vtu --distance 6 --surfaces a.vtp --quiet",
    );
    run(at, "surface a.vtu -o b.vtp --quiet");
    let bytes = |name: &str| std::fs::read(at.join(name)).unwrap();
    assert!(bytes("a.vtp").len() > 1000 && bytes("a.vtp") == bytes("b.vtp"));

    let file = atomesh::store::read_vtu(&at.join("a.vtu")).unwrap();
    let on_nodes = file.point_data.iter().find(|a| a.name == "image").unwrap();
    let on_nodes = on_nodes.values.to_f64();
    let bends = |x: [f64; 3]| {
        let index = x.map(|c| c.round() as usize);
        (f64::from(value(index)), x)
    };
    for (&found, &node) in on_nodes.iter().zip(&file.mesh.nodes) {
        let (nearest, x) = bends(node);
        // The steepest slope is 0.41 a sample.
        let off = (0..3).map(|k| (x[k] - x[k].round()).abs()).sum::<f64>();
        assert!(
            (found - nearest).abs() <= 0.42 * off + 1e-5,
            "{x:?}: {found}"
        );
    }
    let cells = file.cell_array("image").unwrap();
    assert_eq!(cells.values.len(), file.mesh.tets.len());
    // After an edit they are there again.
    run(at, "edit a.vtu sheet.npy -o c.vtu --add 10,10,10 --quiet");
    let edited = atomesh::store::read_vtu(&at.join("c.vtu")).unwrap();
    assert!(edited.cell_array("image").is_some());
}

#[test]
fn what_no_page_can_be_made_of_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("sheet.npy"), [40, 36, 32], planar_fault([40, 36, 32]));
    write_npy(&at.join("other.npy"), [40, 36, 30], planar_fault([40, 36, 30]));
    write_npy_2d(&at.join("line.npy"), [80, 60], broken_layers);
    std::fs::write(at.join("no.json"), "{\"a\": 1}").unwrap();
    run(at, "mesh sheet.npy -o a.vtu --distance 8 --quiet");
    for (line, said) in [
        (
            "report line.npy a.vtu -o p.html",
            "is a 3-D mesh, but the image is 2-D",
        ),
        (
            "report other.npy a.vtu -o p.html",
            "is of [40, 36, 30] samples",
        ),
        ("report sheet.npy a.vtu -o p.txt", "does not end in .html"),
        ("report sheet.npy a.vtu -o a.vtu", "does not end in .html"),
        (
            "report sheet.npy a.vtu -o p.html --figures no.json",
            "is no report of atomesh",
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
        let error = expect_refusal(at, &line.split(' ').collect::<Vec<_>>());
        assert!(error.contains(said), "{line}: {error}");
    }
}

#[test]
fn a_body_with_an_open_corner_is_drawn_of_every_mesh_in_space() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("sheet.npy"), [40, 36, 32], planar_fault([40, 36, 32]));
    run(at, "mesh sheet.npy -o tets.vtu --distance 6 --quiet");
    run(
        at,
        "mesh sheet.npy -o cells.vtu --distance 6 --cells voronoi --quiet",
    );
    for mesh in ["tets", "cells"] {
        run(
            at,
            &format!("slice sheet.npy {mesh}.vtu -o {mesh}.png --view 3d --quiet"),
        );
        run(at, &format!("convert {mesh}.png {mesh}.npy --quiet"));
        let bytes = std::fs::read(at.join(format!("{mesh}.npy"))).unwrap();
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
