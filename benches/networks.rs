//! Measures meshes of twenty random fault networks, each with faults that cross at 15 degrees and
//! more, branch, run close together and taper out: `make bench-networks`, or `cargo bench --bench
//! networks [-- [voronoi] [FIRST LAST]]`.
//!
//! Prints for each figure the median over the seeds and the worst value with its seed. With
//! `voronoi`, the meshes have Voronoi cells instead of tetrahedra.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// A figure of the reports: its JSON pointer, its name, and `true` if larger is better.
type Figure = (&'static str, &'static str, bool);

/// Figures of Voronoi cells.
const CELL_FIGURES: [Figure; 6] = [
    (
        "/fidelity/tagged_faces/coverage_half",
        "coverage within half a sample",
        true,
    ),
    (
        "/fidelity/tagged_faces/coverage_one",
        "coverage within one sample",
        true,
    ),
    (
        "/fidelity/tagged_faces/precision",
        "precision of faces on features",
        true,
    ),
    (
        "/voronoi/volume_ratio/0",
        "neighbours' volumes, largest ratio",
        false,
    ),
    (
        "/voronoi/shortest_connection",
        "shortest connection over the mean",
        true,
    ),
    (
        "/voronoi/tiny_faces/2",
        "share of faces below 1e-3 of the mean",
        false,
    ),
];

/// Figures of tetrahedra.
const TETRAHEDRON_FIGURES: [Figure; 7] = [
    (
        "/fidelity/on_feature/coverage_half",
        "coverage within half a sample",
        true,
    ),
    (
        "/fidelity/on_feature/coverage_one",
        "coverage within one sample",
        true,
    ),
    (
        "/fidelity/tagged_faces/coverage_one",
        "coverage by tagged faces, one sample",
        true,
    ),
    (
        "/fidelity/tagged_faces/precision",
        "precision of tagged faces",
        true,
    ),
    (
        "/quality/smallest_angle/worst",
        "smallest angle (degrees)",
        true,
    ),
    (
        "/quality/largest_angle/worst",
        "largest angle (degrees)",
        false,
    ),
    (
        "/quality/angles/unexplained",
        "unexplained angles (tetrahedra)",
        false,
    ),
];

fn main() -> Outcome<()> {
    // `cargo test --benches` runs benchmarks only to see that they start.
    let arguments: Vec<String> = std::env::args().collect();
    if !arguments.iter().any(|a| a == "--bench") {
        return Ok(());
    }
    let cells = arguments.iter().any(|a| a == "voronoi");
    let definitions: &[Figure] = if cells {
        &CELL_FIGURES
    } else {
        &TETRAHEDRON_FIGURES
    };
    let mut seeds = arguments.iter().filter_map(|a| a.parse::<u32>().ok());
    let (first, last) = (seeds.next().unwrap_or(1), seeds.next().unwrap_or(20));
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("networks");
    std::fs::create_dir_all(&folder)?;
    let mut figures: Vec<Vec<(f64, u32)>> = vec![Vec::new(); definitions.len()];
    let mut by_gap: Vec<(String, f64, [f64; 2])> = Vec::new();
    for seed in first..=last {
        let number = seed.to_string();
        let synth = [
            "synth",
            "network",
            "-o",
            "n.npy",
            "--truth",
            "t.npy",
            "--rng-seed",
            &number,
        ];
        run(&folder, &synth)?;
        let kind = if cells { "voronoi" } else { "tets" };
        let mesh = ["mesh", "n.npy", "-o", "n.vtu", "--cells", kind];
        run(&folder, &mesh)?;
        let report = run(&folder, &["quality", "n.vtu", "--truth", "t.npy", "--json"])?;
        for (k, (pointer, _, _)) in definitions.iter().enumerate() {
            figures[k].push((
                report
                    .pointer(pointer)
                    .and_then(Value::as_f64)
                    .unwrap_or(f64::NAN),
                seed,
            ));
        }
        let classes = report
            .pointer("/fidelity/on_feature/by_gap")
            .and_then(Value::as_array);
        for (k, class) in classes.into_iter().flatten().enumerate() {
            let value_of = |name: &str| class[name].as_f64().unwrap_or(0.0);
            if by_gap.len() == k {
                let upper = class["to"]
                    .as_f64()
                    .map_or("and more".into(), |upper| format!("to {upper}"));
                by_gap.push((format!("{} {upper}", value_of("from")), 0.0, [0.0; 2]));
            }
            let points = value_of("points");
            by_gap[k].1 += points;
            by_gap[k].2[0] += points * value_of("coverage_half");
            by_gap[k].2[1] += points * value_of("coverage_one");
        }
        eprintln!("seed {seed}: {}", last_figures(&figures));
    }
    println!("| figure | median | worst | seed |\n|---|---|---|---|");
    for ((_, name, larger_is_better), values) in definitions.iter().zip(&mut figures) {
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let median = values[values.len() / 2].0;
        let worst = if *larger_is_better {
            values[0]
        } else {
            values[values.len() - 1]
        };
        println!("| {name} | {median:.3} | {:.3} | {} |", worst.0, worst.1);
    }
    println!(
        "\n| distance to the next fault (samples) | within half a sample | within one |\n|---|---|---|"
    );
    for (class, points, [half, one]) in by_gap {
        println!("| {class} | {:.3} | {:.3} |", half / points, one / points);
    }
    Ok(())
}

/// Returns the figures of the last seed.
fn last_figures(figures: &[Vec<(f64, u32)>]) -> String {
    let last = figures.iter().filter_map(|f| f.last());
    last.map(|(value, _)| format!("{value:.3} ")).collect()
}

/// Runs atomesh and returns its JSON output, or null without such an output.
fn run(folder: &Path, arguments: &[&str]) -> Outcome<Value> {
    let output = Command::new(env!("CARGO_BIN_EXE_atomesh"))
        .current_dir(folder)
        .args(arguments)
        .arg("--quiet")
        .output()?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        return Err(format!("atomesh {}: {stderr}", arguments.join(" ")).into());
    }
    Ok(serde_json::from_slice(&output.stdout).unwrap_or(Value::Null))
}
