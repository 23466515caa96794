//! Tests `atomesh mesh --surface`: the mesh follows surfaces that the user gives.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use crate::common::{expect_refusal, run, run_args, write_npy};

const DIMS: [usize; 3] = [56, 48, 44];
/// Position of the first sample, and distance of samples along each axis.
const ORIGIN: [f64; 3] = [1000.0, 2000.0, -900.0];
const STEP: [f64; 3] = [10.0, 12.5, 5.0];
const PLACE: &str = "--origin 1000,2000,-900 --spacing 10,12.5,5 --unit m";

/// Returns x of the fault at y, z, in samples.
fn fault(y: f64, z: f64) -> f64 {
    18.0 + 0.35 * z + 0.004 * (y - 20.0).powi(2)
}

/// Returns z of the horizon at x, y, in samples.
fn horizon(x: f64, y: f64) -> f64 {
    18.0 + 0.1 * x - 0.05 * y + 2.0 * (-((x - 30.0).powi(2) + (y - 24.0).powi(2)) / 400.0).exp()
}

fn to_world(p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| ORIGIN[k] + STEP[k] * p[k])
}

fn to_samples(p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| (p[k] - ORIGIN[k]) / STEP[k])
}

/// Writes the fault as GOCAD's TSurf and the horizon as points, both beyond the image, and an image
/// of noise.
fn write_inputs(folder: &Path) {
    let mut text = "GOCAD TSurf 1\nHEADER {\nname:Main fault\n}\nTFACE\n".to_string();
    let count = 33;
    let place = |i: usize| -3.0 + 60.0 * i as f64 / 32.0;
    for j in 0..count {
        for i in 0..count {
            let [x, y, z] = to_world([fault(place(i), place(j)), place(i), place(j)]);
            writeln!(text, "VRTX {} {x} {y} {z}", j * count + i + 1).unwrap();
        }
    }
    for j in 1..count {
        for i in 1..count {
            let a = (j - 1) * count + i;
            let [b, c, d] = [a + 1, a + count + 1, a + count];
            writeln!(text, "TRGL {a} {b} {c}\nTRGL {a} {c} {d}").unwrap();
        }
    }
    text += "END\n";
    std::fs::write(folder.join("faults.ts"), text).unwrap();
    let mut text = String::new();
    for i in 0..70 {
        for j in 0..62 {
            let [x, y] = [f64::from(i) - 6.0, f64::from(j) - 6.0];
            let [x, y, z] = to_world([x, y, horizon(x, y)]);
            writeln!(text, "{x} {y} {z}").unwrap();
        }
    }
    std::fs::write(folder.join("top.xyz"), text).unwrap();
    let mut state = 7u32;
    write_npy(&folder.join("image.npy"), DIMS, |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 1e7
    });
}

/// Reads the triangles of each object of a GOCAD file, in samples.
fn read_objects(path: &Path) -> BTreeMap<String, Vec<[[f64; 3]; 3]>> {
    let mut objects: BTreeMap<String, Vec<[[f64; 3]; 3]>> = BTreeMap::new();
    let (mut name, mut nodes) = (String::new(), Vec::new());
    for line in std::fs::read_to_string(path).unwrap().lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let number = |k: usize| words[k].parse::<f64>().unwrap();
        match words[0] {
            "GOCAD" => nodes.clear(),
            "VRTX" => nodes.push(to_samples([number(2), number(3), number(4)])),
            "TRGL" => {
                let corners = [1, 2, 3].map(|k| nodes[number(k) as usize - 1]);
                objects.entry(name.clone()).or_default().push(corners);
            }
            _ => {
                if let Some(text) = line.strip_prefix("name:") {
                    name = text.into();
                }
            }
        }
    }
    objects
}

/// A surface along one axis as a function of the other two, in samples.
struct Exact {
    axis: usize,
    value: fn(f64, f64) -> f64,
}

impl Exact {
    /// Returns the other two axes.
    fn lateral(&self) -> [usize; 2] {
        if self.axis == 0 { [1, 2] } else { [0, 1] }
    }

    /// Returns the distance of a point from the surface.
    fn distance(&self, p: [f64; 3]) -> f64 {
        let [a, b] = self.lateral().map(|k| p[k]);
        let (value, h) = ((self.value)(a, b), 1e-4);
        let slopes = [
            ((self.value)(a + h, b) - value) / h,
            ((self.value)(a, b + h) - value) / h,
        ];
        let length = (1.0 + slopes[0].powi(2) + slopes[1].powi(2)).sqrt();
        (p[self.axis] - value).abs() / length
    }

    /// Returns the share of the area of triangles, and of the surface in the box, at which each is
    /// within `tolerance` of the other.
    fn agreement(&self, triangles: &[[[f64; 3]; 3]], tolerance: f64) -> [f64; 2] {
        let [a, b] = self.lateral();
        let (mut near, mut total) = (0.0, 0.0);
        let weights = [
            [0.6, 0.2, 0.2],
            [0.2, 0.6, 0.2],
            [0.2, 0.2, 0.6],
            [1.0 / 3.0; 3],
        ];
        for t in triangles {
            let edge = |k: usize| -> [f64; 3] { std::array::from_fn(|c| t[k][c] - t[0][c]) };
            let (u, v) = (edge(1), edge(2));
            let n = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            let area = n.iter().map(|c| c * c).sum::<f64>().sqrt();
            for w in weights {
                let p = std::array::from_fn(|c| (0..3).map(|k| w[k] * t[k][c]).sum());
                total += area;
                near += area * f64::from(u8::from(self.distance(p) <= tolerance));
            }
        }
        // Points of the surface in the box, and whether a triangle passes near them.
        let (mut covered, mut count) = (0.0, 0.0);
        let last = DIMS.map(|n| n as f64 - 1.0);
        for i in 0..2 * DIMS[a] {
            for j in 0..2 * DIMS[b] {
                let [x, y] = [0.25 + 0.5 * i as f64, 0.25 + 0.5 * j as f64];
                let value = (self.value)(x, y);
                if x > last[a] || y > last[b] || !(0.0..=last[self.axis]).contains(&value) {
                    continue;
                }
                count += 1.0;
                let passes = |t: &[[f64; 3]; 3]| {
                    let area = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
                        (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
                    };
                    let [p, q, r] = t.map(|p| [p[a], p[b]]);
                    let total = area(p, q, r);
                    let at = [x, y];
                    let w = [area(at, q, r), area(p, at, r), area(p, q, at)].map(|s| s / total);
                    let z: f64 = (0..3).map(|k| w[k] * t[k][self.axis]).sum();
                    let mut place = [0.0; 3];
                    (place[a], place[b], place[self.axis]) = (x, y, z);
                    w.iter().all(|w| *w >= -1e-6) && self.distance(place) <= tolerance
                };
                covered += f64::from(u8::from(triangles.iter().any(passes)));
            }
        }
        [near / total, covered / count]
    }
}

const FAULT: Exact = Exact {
    axis: 0,
    value: fault,
};
const HORIZON: Exact = Exact {
    axis: 2,
    value: horizon,
};

#[test]
fn the_mesh_has_named_faces_on_surfaces_that_cross() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_inputs(dir);
    let report = run(
        dir,
        &format!(
            "mesh image.npy {PLACE} -o mesh.vtu --feature none --distance 4 --surface faults.ts \
             --surface top.xyz:Top --surfaces picks.vtp"
        ),
    );
    assert!(report.contains("mesh"), "{report}");
    let table = run_args(dir, &["surface", "mesh.vtu", "-o", "surfaces.ts"]);
    for (name, kind) in [("Main fault", "fault"), ("Top", "horizon")] {
        let has_row = |line: &str| line.contains(kind) && line.trim_end().ends_with(name);
        assert!(table.lines().any(has_row), "{table}");
    }
    let objects = read_objects(&dir.join("surfaces.ts"));
    let names: Vec<&str> = objects.keys().map(String::as_str).collect();
    assert_eq!(names, ["Main fault", "Top"]);
    for (name, exact) in [("Main fault", FAULT), ("Top", HORIZON)] {
        let [near, covered] = exact.agreement(&objects[name], 0.1);
        assert!(near >= 0.99 && covered >= 0.99, "{name}: {near} {covered}");
    }
    // The names reach other programs.
    run(dir, "export mesh.vtu --to inp -o mesh.inp --quiet");
    let text = std::fs::read_to_string(dir.join("mesh.inp")).unwrap();
    assert!(text.contains("SMAIN_FAULT") && text.contains("STOP"));
    let cells = format!(
        "mesh image.npy {PLACE} -o cells.vtu --feature none --distance 5 --cells voronoi --surface \
         faults.ts --surface top.xyz:Top --quiet"
    );
    run(dir, &cells);
    let table = run_args(dir, &["surface", "cells.vtu", "-o", "cells.ts"]);
    assert!(
        table.contains("Main fault") && table.contains("Top"),
        "{table}"
    );
}

#[test]
fn surfaces_beside_the_image_are_refused_or_cut() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_inputs(dir);
    let start = [
        "mesh",
        "image.npy",
        "--origin",
        "1000,2000,-900",
        "--spacing",
        "10,12.5,5",
    ];
    let refuse = |option: &str| {
        expect_refusal(
            dir,
            &[&start[..], &["-o", "m.vtu", "--surface", option]].concat(),
        )
    };
    std::fs::write(
        dir.join("far.csv"),
        "fault,stick,x,y,z\nF,1,0,0,0\nF,1,0,0,-9\nF,2,9,0,0\nF,2,9,0,-9\n",
    )
    .unwrap();
    let message = refuse("far.csv");
    assert!(
        message.contains("F lies outside the image: it has x 0 to 9, y 0 to 0, z -9 to 0, the image x 1000 to 1550"),
        "{message}"
    );
    std::fs::write(
        dir.join("two.obj"),
        "v 1100 2100 -800\nv 1200 2100 -800\nv 1200 2200 -850\nv 1100 2200 -700\ng a\nf 1 2 3\ng b\nf 1 3 4\n",
    )
    .unwrap();
    let message = refuse("two.obj:c");
    assert!(
        message.contains("--surface two.obj:c: names no surface: the file has a, b; "),
        "{message}"
    );
    // The sign of z is turned where only that makes sense, and what lies outside is cut off.
    let text = std::fs::read_to_string(dir.join("top.xyz")).unwrap();
    std::fs::write(dir.join("down.xyz"), text.replace(" -", " ")).unwrap();
    let report = run(
        dir,
        &format!(
            "mesh image.npy {PLACE} -o m.vtu --feature none --surface down.xyz --report r.json"
        ),
    );
    let report = format!(
        "{report}{}",
        std::fs::read_to_string(dir.join("r.json")).unwrap()
    );
    assert!(
        report.contains("surface down: 4340 points joined in their best-fitting plane, a horizon")
            && report.contains("with the sign of z turned")
            && report.contains("% of it outside the image"),
        "{report}"
    );
}
