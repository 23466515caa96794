//! Compares the segmentation of a mesh's cells with that of samples (Xu 2016, table 4.1): `cargo
//! bench --bench segment`. Takes a minute or two.
//!
//! The total of the mesh is that of `atomesh mesh` (reading, features, lattice, tetrahedra,
//! writing, without measuring the mesh for its report) and of the means and the cut of `atomesh
//! segment`. The total of the samples is histograms, graph and cut by the same code. Both are user
//! CPU seconds. Both have the same boxes as seeds. A cut does not need good angles, so slivers
//! stay, as in the thesis.

use std::path::Path;
use std::process::Command;

use atomesh::image::formats;
use atomesh::image::{Geometry, Image};
use serde_json::Value;

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// A scene: name, dimensions, value at a position, `true` at positions of the object, noise,
/// nominal distance and seeds.
struct Scene {
    name: &'static str,
    dims: [usize; 3],
    value: fn([f64; 3]) -> f64,
    object: fn([f64; 3]) -> bool,
    noise: f64,
    distance: &'static str,
    seeds: &'static str,
}

/// Returns a value that is negative inside an ellipsoid and approximates the distance in samples
/// near its surface.
fn ellipsoid(p: [f64; 3], centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let square = |scale: &dyn Fn(f64) -> f64| {
        let part = |k: usize| ((p[k] - centre[k]) / scale(radii[k])).powi(2);
        (0..3).map(part).sum::<f64>().sqrt()
    };
    let outside = square(&|r| r);
    outside * (outside - 1.0) / square(&|r| r * r).max(1e-9)
}

/// Returns 1 inside and 0 outside, with a transition of about a sample.
fn inside(signed_distance: f64) -> f64 {
    1.0 / (1.0 + (2.0 * signed_distance).exp())
}

fn sphere(p: [f64; 3]) -> f64 {
    ellipsoid(p, [63.5; 3], [40.0; 3])
}

/// Biological cells, some large and some small.
fn cells(p: [f64; 3]) -> f64 {
    [
        ([40.0, 38.0, 34.0], [26.0, 22.0, 22.0]),
        ([94.0, 40.0, 30.0], [22.0, 26.0, 20.0]),
        ([66.0, 86.0, 38.0], [30.0, 21.0, 24.0]),
        ([112.0, 94.0, 44.0], [15.0, 17.0, 16.0]),
        ([20.0, 92.0, 28.0], [13.0, 16.0, 14.0]),
    ]
    .into_iter()
    .map(|(centre, radii)| ellipsoid(p, centre, radii))
    .fold(f64::INFINITY, f64::min)
}

/// Air of two lungs without the vessels in them.
fn lungs(p: [f64; 3]) -> f64 {
    let left = ellipsoid(p, [38.0, 62.0, 62.0], [20.0, 27.0, 46.0]);
    let right = ellipsoid(p, [90.0, 62.0, 62.0], [21.0, 28.0, 48.0]);
    let heart = ellipsoid(p, [58.0, 48.0, 54.0], [18.0, 17.0, 20.0]);
    // Vessels spread from the middle.
    let vessel = |slope: f64, rise: f64| {
        let x = p[0] - 64.0;
        let y = p[1] - 62.0 - slope * x.abs();
        let z = p[2] - 62.0 - rise * x.abs();
        y.hypot(z) - (3.6 - 0.03 * x.abs())
    };
    let vessels = [
        (0.35, 0.6),
        (-0.3, 0.4),
        (0.1, -0.6),
        (-0.2, -1.1),
        (0.2, 1.3),
    ]
    .into_iter()
    .map(|(slope, rise)| vessel(slope, rise))
    .fold(f64::INFINITY, f64::min);
    left.min(right).max(-heart).max(-vessels)
}

/// A chest: air 0, lungs 0.15, soft tissue 0.55, bones 0.95.
fn chest(p: [f64; 3]) -> f64 {
    let body = ellipsoid([p[0], p[1], 0.0], [63.5, 63.5, 0.0], [58.0, 44.0, 1e6]);
    let spine = (p[0] - 63.5).hypot(p[1] - 96.0) - 8.0;
    let rib = ellipsoid([p[0], p[1], 0.0], [63.5, 63.5, 0.0], [51.0, 37.5, 1e6]).abs() - 2.2;
    let ribs = rib.max((4.0 - (p[2] + 0.25 * p[1]).rem_euclid(16.0)).abs() - 3.0);
    let tissue = 0.55 * inside(body);
    let bone = 0.4 * inside(spine.min(ribs.max(body)));
    let air = inside(lungs(p));
    (tissue + bone) * (1.0 - air) + 0.15 * air
}

const SCENES: [Scene; 3] = [
    Scene {
        name: "sphere",
        dims: [128; 3],
        value: |p| inside(sphere(p)),
        object: |p| sphere(p) < 0.0,
        noise: 0.0,
        distance: "8",
        seeds: "--object 48,48,48:80,80,80 --background 2,2,2:20,20,126",
    },
    Scene {
        name: "noisy cells",
        dims: [136, 121, 71],
        value: |p| inside(cells(p)),
        object: |p| cells(p) < 0.0,
        noise: 1.0,
        distance: "6",
        seeds: "--object 30,28,24:50,48,44 --object 60,80,30:80,92,44 --background 2,2,2:134,10,69",
    },
    Scene {
        name: "chest",
        dims: [128; 3],
        value: chest,
        object: |p| lungs(p) < 0.0,
        noise: 0.12,
        distance: "8",
        seeds: "--object 28,70,50:40,80,80 --object 86,72,50:98,82,80 --background 2,2,2:8,126,126 \
                --background 52,40,44:66,56,64 --background 58,92,10:68,100,110",
    },
];

/// Writes the image and the true object of a scene.
fn write_scene(scene: &Scene, folder: &Path) -> Outcome<()> {
    let [nx, ny, nz] = scene.dims;
    let mut state = 5u64;
    let mut gauss = || {
        // The sum of twelve uniform numbers less six is nearly normal.
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 33) as f64 / (1u64 << 31) as f64;
        }
        sum
    };
    let (mut image, mut truth) = (Vec::new(), Vec::new());
    for i in 0..nx * ny * nz {
        let p = [i % nx, i / nx % ny, i / (nx * ny)].map(|c| c as f64);
        image.push(((scene.value)(p) + scene.noise * gauss()) as f32);
        truth.push(f32::from(u8::from((scene.object)(p))));
    }
    let save = |name: &str, samples| {
        formats::write(
            &folder.join(name),
            &Image::new(scene.dims, samples, Geometry::default()),
        )
    };
    save("image.npy", image)?;
    Ok(save("truth.npy", truth)?)
}

/// Returns the user CPU seconds of all child processes that have ended.
fn children_cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat
        .rsplit(')')
        .next()
        .and_then(|fields| fields.split_whitespace().nth(13));
    ticks
        .and_then(|word| word.parse::<f64>().ok())
        .unwrap_or(f64::NAN)
        / 100.0
}

/// Runs atomesh and returns its JSON output and the CPU seconds.
fn atomesh(folder: &Path, line: &str) -> Outcome<(Value, f64)> {
    let before = children_cpu_seconds();
    let output = Command::new(env!("CARGO_BIN_EXE_atomesh"))
        .current_dir(folder)
        .args(line.split_whitespace())
        .args(["--json", "--quiet"])
        .output()?;
    if !output.status.success() {
        return Err(format!(
            "atomesh {line}: {}",
            String::from_utf8_lossy(&output.stderr)
        )
        .into());
    }
    Ok((
        serde_json::from_slice(&output.stdout)?,
        children_cpu_seconds() - before,
    ))
}

/// Returns the CPU seconds for measuring the mesh, from a report.
fn measuring_seconds(report: &Value) -> f64 {
    let stages = report.pointer("/stages").and_then(Value::as_array);
    let named = |stage: &&Value| stage["stage"] == "measuring the mesh";
    let stage = stages.and_then(|stages| stages.iter().find(named));
    stage
        .and_then(|stage| stage["cpu_seconds"].as_f64())
        .unwrap_or(0.0)
}

fn main() -> Outcome<()> {
    // `cargo test --benches` runs benchmarks only to see that they start.
    if !std::env::args().any(|argument| argument == "--bench") {
        return Ok(());
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("segment");
    std::fs::create_dir_all(&folder)?;
    println!(
        "| volume | cells | meshing s | means s | cut s | total s | Dice | samples' cut s | Dice | ratio | with a mesh at hand |\n\
         |---|---|---|---|---|---|---|---|---|---|---|"
    );
    for scene in &SCENES {
        write_scene(scene, &folder)?;
        let d = scene.distance;
        let mesh =
            format!("mesh image.npy -o mesh.vtu --feature edges --distance {d} --slivers none");
        let (report, meshing) = atomesh(&folder, &mesh)?;
        let meshing = meshing - measuring_seconds(&report);
        let cut = format!(
            "segment image.npy mesh.vtu {} --lambda 0.3 -o out.vtu --truth truth.npy --voxels",
            scene.seeds
        );
        let (result, _) = atomesh(&folder, &cut)?;
        let number = |pointer: &str| {
            result
                .pointer(pointer)
                .and_then(Value::as_f64)
                .unwrap_or(f64::NAN)
        };
        let (means, cells) = (number("/cells/means_seconds"), number("/cells/cut_seconds"));
        let (total, samples) = (meshing + means + cells, number("/samples/cut_seconds"));
        let [nx, ny, nz] = scene.dims;
        println!(
            "| {}, {nx} x {ny} x {nz}, d = {d} | {} | {meshing:.2} | {means:.2} | {cells:.2} | {total:.2} | {:.4} | {samples:.2} | {:.4} | {:.1} | {:.0} |",
            scene.name,
            number("/cells/nodes"),
            number("/cells/dice"),
            number("/samples/dice"),
            samples / total,
            samples / (means + cells),
        );
    }
    Ok(())
}
