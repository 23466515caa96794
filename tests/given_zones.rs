//! Tests given faults in label images: every face of a fault keeps its name, whatever labels its two
//! cells have, so that closed faults hold and open ones do not resist.

use std::fmt::Write;
use std::path::Path;

use serde_json::Value;

use crate::common::{run, write_npy};

const DIMS: [usize; 3] = [30, 20, 16];
const PLACE: &str = "--spacing 10 --unit m";
const FLOW: &str = "-o flow.vtu --pressure xmin=1e5 --pressure xmax=0 --json --quiet";

/// A plane of which points are x = `x` + `slope_y` y + `slope_z` z (in samples), from y = -1 to `end_y`.
struct Plane {
    name: &'static str,
    x: f64,
    slope_y: f64,
    slope_z: f64,
    end_y: f64,
}

impl Plane {
    fn at(&self, y: f64, z: f64) -> f64 {
        self.x + self.slope_y * y + self.slope_z * z
    }

    /// Returns the area inside the image, in square metres.
    fn area(&self) -> f64 {
        let height = DIMS[2] as f64 - 1.0;
        let width = self.end_y.min(DIMS[1] as f64 - 1.0);
        let stretch = (1.0 + self.slope_y.powi(2) + self.slope_z.powi(2)).sqrt();
        100.0 * height * width * stretch
    }

    fn write(&self, folder: &Path) {
        let mut text = format!("GOCAD TSurf 1\nHEADER {{\nname:{}\n}}\nTFACE\n", self.name);
        let corners = [
            (-1.0, -1.0),
            (self.end_y, -1.0),
            (self.end_y, 17.0),
            (-1.0, 17.0),
        ];
        for (i, (y, z)) in (1..).zip(corners) {
            let [x, y, z] = [self.at(y, z), y, z].map(|c| 10.0 * c);
            writeln!(text, "VRTX {i} {x} {y} {z}").unwrap();
        }
        text += "TRGL 1 2 3\nTRGL 1 3 4\nEND\n";
        std::fs::write(folder.join(format!("{}.ts", self.name)), text).unwrap();
    }
}

/// A fault through the whole image.
const THROUGH: Plane = Plane {
    name: "through",
    x: 11.3,
    slope_y: 0.05,
    slope_z: 0.45,
    end_y: 21.0,
};

/// Meshes `labels` with the planes as faults, `options` included.
fn mesh(planes: &[&Plane], label: impl Fn([usize; 3]) -> f32, options: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("labels.npy"), DIMS, label);
    let mut line = format!("mesh labels.npy --feature labels {PLACE} --quiet -o m.vtu {options}");
    for plane in planes {
        plane.write(folder.path());
        write!(line, " --surface {}.ts,fault", plane.name).unwrap();
    }
    run(folder.path(), &line);
    folder
}

fn json(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&run(folder, line)).unwrap()
}

/// Returns the throughput with faults open and closed, in m^3/s.
fn throughputs(folder: &Path) -> [f64; 2] {
    ["open", "closed"].map(|how| {
        let report = json(folder, &format!("flow m.vtu {FLOW} --faults {how}"));
        report["solver"]["throughput"].as_f64().unwrap()
    })
}

/// Returns the throughput of the open box: the default permeability and viscosity, and a drop of one
/// bar over its length.
fn open_throughput() -> f64 {
    let [length, width, height] = DIMS.map(|n| 10.0 * (n as f64 - 1.0));
    1e-13 * width * height / 1e-3 * 1e5 / length
}

/// Returns the areas of the surfaces with these names.
fn areas(folder: &Path, names: &[&str]) -> Vec<f64> {
    let table = json(folder, "surface m.vtu -o s.vtp --json --quiet");
    let surfaces = table["surfaces"].as_array().unwrap();
    let area = |name: &&str| {
        let surface = surfaces.iter().find(|surface| surface["name"] == **name);
        let surface = surface.unwrap_or_else(|| panic!("no surface {name}: {table}"));
        assert_eq!(surface["kind"], "fault");
        surface["area"].as_f64().unwrap()
    };
    names.iter().map(area).collect()
}

/// Returns the label of gently dipping layers that the fault offsets by some samples.
fn layers(offset: f64) -> impl Fn([usize; 3]) -> f32 {
    move |[x, y, z]| {
        let [x, y, z] = [x, y, z].map(|c| c as f64);
        let throw = if x > THROUGH.at(y, z) { offset } else { 0.0 };
        match z + throw + 0.1 * x {
            level if level < 6.0 => 0.0,
            level if level < 12.0 => 1.0,
            _ => 2.0,
        }
    }
}

#[test]
fn a_fault_through_labels_is_closed_and_open_without_a_hole() {
    for (offset, cells) in [
        (0.0, ""),
        (3.0, ""),
        (0.0, "--cells voronoi"),
        (3.0, "--cells voronoi"),
    ] {
        let folder = mesh(
            &[&THROUGH],
            layers(offset),
            &format!("--distance 4 {cells}"),
        );
        let [open, closed] = throughputs(folder.path());
        assert!(
            (open / open_throughput() - 1.0).abs() < 1e-6,
            "{offset} {cells}: {open}"
        );
        assert!(
            closed <= 1e-12 * open,
            "{offset} {cells}: {}",
            closed / open
        );
        let ratio = areas(folder.path(), &["through"])[0] / THROUGH.area();
        assert!((ratio - 1.0).abs() < 0.03, "{offset} {cells}: area {ratio}");
    }
}

#[test]
fn faults_that_cross_in_labels_are_closed_each_by_itself() {
    let other = Plane {
        name: "other",
        x: 20.0,
        slope_y: -0.4,
        slope_z: -0.3,
        end_y: 21.0,
    };
    for cells in ["", "--cells voronoi"] {
        let options = format!("--distance 3 {cells}");
        let folder = mesh(&[&THROUGH, &other], layers(0.0), &options);
        let [open, closed] = throughputs(folder.path());
        assert!(closed <= 1e-12 * open, "{cells}: {}", closed / open);
        let found = areas(folder.path(), &["through", "other"]);
        for (area, plane) in found.iter().zip([&THROUGH, &other]) {
            let ratio = area / plane.area();
            assert!(
                (ratio - 1.0).abs() < 0.1,
                "{cells} {}: area {ratio}",
                plane.name
            );
        }
    }
}

#[test]
fn a_fault_that_coincides_with_an_interface_in_part_is_closed() {
    let upright = Plane {
        slope_y: 0.0,
        slope_z: 0.0,
        x: 14.5,
        ..THROUGH
    };
    let label = |[x, y, z]: [usize; 3]| match (x > 14 && y < 10, z > 8) {
        (true, _) => 2.0,
        (false, above) => f32::from(u8::from(above)),
    };
    for cells in ["", "--cells voronoi"] {
        let folder = mesh(&[&upright], label, &format!("--distance 3 {cells}"));
        let [open, closed] = throughputs(folder.path());
        assert!(closed <= 1e-12 * open, "{cells}: {}", closed / open);
    }
}

#[test]
fn flow_goes_round_the_tip_of_a_fault_in_labels_and_not_through_it() {
    let ending = Plane {
        end_y: 12.0,
        ..THROUGH
    };
    let folder = mesh(&[&ending], layers(0.0), "--distance 3");
    let closed = json(folder.path(), &format!("flow m.vtu {FLOW} --faults closed"));
    let [open, throughput] = throughputs(folder.path());
    assert!(
        throughput > 0.2 * open && throughput < 0.95 * open,
        "{throughput} {open}"
    );
    assert_eq!(
        closed["by_fault"][0]["total_rate_across"].as_f64(),
        Some(0.0)
    );
    let ratio = areas(folder.path(), &["through"])[0] / ending.area();
    assert!((ratio - 1.0).abs() < 0.05, "area {ratio}");
}

#[test]
fn voronoi_cells_of_blocks_that_meet_at_right_angles_are_made() {
    // Four labels meet along a line, and eight blocks at a point.
    let label = |[x, y, z]: [usize; 3]| [x >= 15, y >= 10, z >= 8].map(|b| f32::from(u8::from(b)));
    let checkerboard = |at: [usize; 3]| label(at).iter().sum::<f32>() % 2.0;
    let corners = |at: [usize; 3]| {
        let [x, y, z] = label(at);
        x + 2.0 * y + 4.0 * z
    };
    for seed in 1..4 {
        let options = format!("--distance 4 --cells voronoi --rng-seed {seed}");
        mesh(&[], checkerboard, &options);
        mesh(&[], corners, &options);
    }
}
