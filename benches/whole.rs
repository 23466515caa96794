//! Measures the table of docs/notes/measurements.md by running atomesh on the command line: `make bench`,
//! or `cargo bench --bench whole`. Takes some minutes and 2 GB of memory.
//!
//! Volumes of other projects are looked for in the folder that `ATOMESH_DATA` names, else in
//! `../shared/data`. Rows on absent volumes say so.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use atomesh::feature;
use atomesh::image::formats;
use atomesh::image::synth::{self, Options, PRESETS, SyntheticKind};
use atomesh::lattice::distance::Distance;
use atomesh::lattice::energy::{Beta, Energy, PairwiseEnergy};
use atomesh::lattice::seeding::{self, Alignment};
use atomesh::mesh::{delaunay, voronoi};
use atomesh::published::SampledEnergy;
use atomesh::report::cost::cpu_seconds;
use serde_json::Value;

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

fn main() -> Outcome<()> {
    // `cargo test --benches` runs benchmarks only to see that they start.
    if !std::env::args().any(|argument| argument == "--bench") {
        return Ok(());
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("whole");
    std::fs::create_dir_all(&folder)?;
    println!("| what | on | figure | target |\n|---|---|---|---|");
    presets(&folder)?;
    slivers(&folder)?;
    volumes_of_other_projects(&folder)?;
    large(&folder)?;
    evaluators()?;
    reproducibility(&folder)?;
    planes(&folder)?;
    cells()?;
    Ok(())
}

fn print_row(topic: &str, object: &str, figure: &str, target: &str) {
    println!("| {topic} | {object} | {figure} | {target} |");
}

/// JSON output of a run, and its user CPU seconds.
struct Run {
    json: Value,
    cpu: f64,
}

/// Runs atomesh with `--json`.
fn atomesh(folder: &Path, arguments: &[&str]) -> Outcome<Run> {
    let before = children_cpu_seconds();
    let output = Command::new(env!("CARGO_BIN_EXE_atomesh"))
        .current_dir(folder)
        .args(arguments)
        .args(["--json", "--quiet"])
        .output()?;
    let cpu = children_cpu_seconds() - before;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        return Err(format!("atomesh {}: {stderr}", arguments.join(" ")).into());
    }
    Ok(Run {
        json: serde_json::from_slice(&output.stdout)?,
        cpu,
    })
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

/// Returns a number at a JSON pointer of a report, or NaN.
fn number(json: &Value, pointer: &str) -> f64 {
    json.pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or(f64::NAN)
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// Writes a synthetic image and its truth.
fn write_synthetic(
    folder: &Path,
    name: &str,
    kind: SyntheticKind,
    options: &Options,
) -> Outcome<()> {
    let synthetic = synth::make(kind, options)?;
    formats::write(&folder.join(format!("{name}.npy")), &synthetic.image)?;
    Ok(synthetic
        .truth
        .write(&folder.join(format!("{name}-truth.npy")))?)
}

/// Rows of fidelity, quality and validity on the noisy fault volumes.
fn presets(folder: &Path) -> Outcome<()> {
    for preset in PRESETS {
        let name = preset.name;
        write_synthetic(folder, name, preset.kind, &preset.options)?;
        let (image, mesh) = (format!("{name}.npy"), format!("{name}.vtu"));
        atomesh(folder, &["mesh", &image, "-o", &mesh, "--distance", "8"])?;
        let truth = format!("{name}-truth.npy");
        let report = atomesh(folder, &["quality", &mesh, "--truth", &truth])?.json;
        let [nx, ny, nz] = preset.options.dims;
        let object = format!("{name}, {nx} x {ny} x {nz}, d = 8");
        let figure = format!(
            "coverage {} and {}, precision {}",
            percent(number(&report, "/fidelity/on_feature/coverage_half")),
            percent(number(&report, "/fidelity/on_feature/coverage_one")),
            percent(number(&report, "/fidelity/on_feature/precision")),
        );
        print_row(
            "fidelity",
            &object,
            &figure,
            "96 % within 0.5 and 98.5 % within 1 sample, precision 97 %",
        );
        print_quality(&object, &report);
        print_validity(folder, &object, &mesh)?;
    }
    Ok(())
}

/// Rows that compare exudation with flips and smoothing, on the first volume of [`presets`].
fn slivers(folder: &Path) -> Outcome<()> {
    let name = PRESETS[0].name;
    let image = format!("{name}.npy");
    let run = ["mesh", &image, "-o", "exuded.vtu", "--slivers", "exude"];
    let report = atomesh(folder, &run)?.json;
    for (method, figures) in [
        ("exudation", &report),
        ("flips and smoothing", &report["baseline"]),
    ] {
        let figure = format!(
            "dihedral angles {:.1} to {:.1}, {} below 30; coverage {} and {}, precision {}",
            number(figures, "/quality/smallest_angle/worst"),
            number(figures, "/quality/largest_angle/worst"),
            number(figures, "/quality/below_30"),
            percent(number(figures, "/fidelity/tagged_faces/coverage_half")),
            percent(number(figures, "/fidelity/tagged_faces/coverage_one")),
            percent(number(figures, "/fidelity/tagged_faces/precision")),
        );
        let object = format!("{name}, detected features");
        print_row(&format!("slivers: {method}"), &object, &figure, "compared");
    }
    Ok(())
}

fn print_quality(object: &str, report: &Value) {
    let figure = format!(
        "dihedral angles {:.1} to {:.1}; {} of {} tetrahedra below 30, {} above 150",
        number(report, "/quality/smallest_angle/worst"),
        number(report, "/quality/largest_angle/worst"),
        number(report, "/quality/below_30"),
        number(report, "/quality/cells"),
        number(report, "/quality/above_150"),
    );
    print_row(
        "quality",
        object,
        &figure,
        "all in 20 to 160, goal 30 to 150",
    );
}

fn print_validity(folder: &Path, object: &str, mesh: &str) -> Outcome<()> {
    let report = atomesh(folder, &["quality", mesh])?.json;
    let verdict = atomesh(folder, &["validate", mesh])?.json;
    let checkers: Vec<&str> = verdict["checks"]
        .as_array()
        .into_iter()
        .flatten()
        .filter(|check| check["problem"].is_null())
        .filter_map(|check| check["checker"].as_str())
        .collect();
    let figure = format!(
        "volume error {:.0e}, sides off by {:.0e}, {} unused nodes; valid to {}",
        number(&report, "/box/volume_error"),
        number(&report, "/box/flatness_error"),
        number(&report, "/box/unused_nodes"),
        checkers.join(", "),
    );
    print_row(
        "box",
        object,
        &figure,
        "volume error 1e-9, flat sides, no unused node",
    );
    Ok(())
}

/// Rows of quality on real data and on synthetic data of other projects.
fn volumes_of_other_projects(folder: &Path) -> Outcome<()> {
    let data = std::env::var_os("ATOMESH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")),
        PathBuf::from,
    );
    for (object, file, options) in [
        (
            "F3 faults",
            "fault3d_f3/f3_faults_slices003-210_u8.npy",
            &["--feature", "mask"][..],
        ),
        ("SEISMIC3D", "seismic3d/SEISMIC3D.sgy", &[]),
        (
            "LANL faults",
            "synthetic_faults3d_lanl/train_0_fsem.bin",
            &["--raw", "64x64x64:f32le"],
        ),
    ] {
        let path = data.join(file);
        if !path.is_file() {
            print_row("quality", object, "not measured: the file is absent", "");
            continue;
        }
        let path = path.canonicalize()?;
        let image = path.to_str().ok_or("a path that is no UTF-8")?;
        let arguments = [
            &["mesh", image, "-o", "other.vtu", "--distance", "8"],
            options,
        ]
        .concat();
        let run = atomesh(folder, &arguments)?;
        print_quality(object, &run.json);
        print_validity(folder, object, "other.vtu")?;
    }
    Ok(())
}

/// Rows of speed and memory with d = 4.
fn large(folder: &Path) -> Outcome<()> {
    for side in [128, 192, 256] {
        let options = Options {
            dims: [side; 3],
            ..Options::default()
        };
        write_synthetic(folder, "large", SyntheticKind::Faults, &options)?;
        let start = Instant::now();
        let run = atomesh(
            folder,
            &["mesh", "large.npy", "-o", "large.vtu", "--distance", "4"],
        )?;
        let seconds = start.elapsed().as_secs_f64();
        let stages = run.json["stages"].as_array().cloned().unwrap_or_default();
        let peak = stages
            .iter()
            .map(|s| number(s, "/peak_mb"))
            .fold(0.0, f64::max);
        let tets = number(&run.json, "/quality/cells");
        let object = format!("{side}^3, d = 4");
        print_row(
            "memory",
            &object,
            &format!("{peak:.0} MB peak, {tets} tetrahedra"),
            "1,500 MB at 256^3",
        );
        if side == 256 {
            let delaunay = stages
                .iter()
                .find(|s| s["stage"] == "joining atoms")
                .map_or(f64::NAN, |s| number(s, "/cpu_seconds"));
            let figure = format!(
                "{:.1} times the Delaunay triangulation: {:.1} s of user CPU in all ({seconds:.1} s by the \
                 clock), {delaunay:.1} s in its Delaunay",
                run.cpu / delaunay,
                run.cpu,
            );
            print_row("speed", &object, &figure, "4 times");
            print_quality(&object, &run.json);
        }
    }
    Ok(())
}

/// Row of the CPU seconds of one evaluation of the energy by both evaluators.
fn evaluators() -> Outcome<()> {
    let d = 8.0;
    let image = synth::make(PRESETS[0].kind, &PRESETS[0].options)?.image;
    let features = feature::detect(
        &image,
        &feature::DetectionOptions {
            d_min: d,
            ..feature::DetectionOptions::default()
        },
    )?;
    let extent = image.dims().map(|n| (n - 1) as f64);
    let distance = Distance::Constant(d);
    let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures)?.positions;
    let mut gradient = vec![[0.0; 3]; atoms.len()];
    let beta = Beta::Constant(0.2);
    let mut time = |energy: &mut dyn Energy<3>| -> Outcome<f64> {
        energy.evaluate(&atoms, &mut gradient)?;
        let start = Instant::now();
        let mut count = 0;
        while start.elapsed().as_secs_f64() < 1.0 {
            energy.evaluate(&atoms, &mut gradient)?;
            count += 1;
        }
        Ok(start.elapsed().as_secs_f64() / f64::from(count))
    };
    // There is one thread, so that wall-clock seconds are CPU seconds.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (pairwise, sampled) = pool.install(|| -> Outcome<(f64, f64)> {
        let mut pairwise =
            PairwiseEnergy::new(extent, &distance, Some(&features.potential), beta.clone())?;
        let mut sampled = SampledEnergy::new(&distance, features.potential.to_dense(), beta);
        Ok((time(&mut pairwise)?, time(&mut sampled)?))
    })?;
    let figure = format!(
        "pairwise {:.2} ms, sampled {:.1} ms an evaluation: {:.0} times less",
        1e3 * pairwise,
        1e3 * sampled,
        sampled / pairwise
    );
    print_row(
        "evaluator",
        &format!("{}, d = 8", PRESETS[0].name),
        &figure,
        "10 times less",
    );
    Ok(())
}

/// Row of the reproducibility with one and two threads, and in two runs.
fn reproducibility(folder: &Path) -> Outcome<()> {
    let image = format!("{}.npy", PRESETS[1].name);
    let mut meshes = Vec::new();
    for threads in ["1", "2", "2"] {
        atomesh(
            folder,
            &["mesh", &image, "-o", "same.vtu", "--threads", threads],
        )?;
        meshes.push(std::fs::read(folder.join("same.vtu"))?);
    }
    let same = meshes.windows(2).all(|pair| pair[0] == pair[1]);
    let figure = if same {
        "identical bytes"
    } else {
        "DIFFERENT bytes"
    };
    print_row(
        "reproducibility",
        PRESETS[1].name,
        figure,
        "identical with 1 and 2 threads, and from run to run",
    );
    Ok(())
}

/// Rows of 2-D images: angles and total time.
fn planes(folder: &Path) -> Outcome<()> {
    for kind in [
        "planes",
        "faults",
        "amplitude",
        "sphere",
        "shells",
        "blocks",
    ] {
        let synth = ["synth", kind, "-o", "plane.png", "--dims", "256,256"];
        atomesh(folder, &synth)?;
        let start = Instant::now();
        let run = atomesh(folder, &["mesh", "plane.png", "-o", "plane.vtu"])?;
        let seconds = start.elapsed().as_secs_f64();
        let figure = format!(
            "{seconds:.2} s in all; angles {:.1} to {:.1} in {} triangles",
            number(&run.json, "/quality/smallest_angle/worst"),
            number(&run.json, "/quality/largest_angle/worst"),
            number(&run.json, "/quality/cells"),
        );
        print_row("2-D", &format!("{kind}, 256 x 256"), &figure, "0.3 s");
    }
    Ok(())
}

/// Row of Voronoi cells against the Delaunay triangulation of the same atoms, on one thread.
fn cells() -> Outcome<()> {
    let extent = [255.0; 3];
    let mut atoms =
        seeding::densest_lattice::fit_lattice(extent, 4.0, Alignment::AlongsideFeatures);
    for (n, atom) in atoms.iter_mut().enumerate() {
        for (k, x) in atom.iter_mut().enumerate() {
            *x += 0.2 * ((n * 3 + k) as f64 * 0.618).sin();
        }
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let [triangulation, cells] = pool.install(|| -> atomesh::Result<[f64; 2]> {
        let start = cpu_seconds();
        delaunay::delaunay(&atoms)?;
        let after_delaunay = cpu_seconds();
        voronoi::voronoi(&atoms, extent)?;
        Ok([after_delaunay - start, cpu_seconds() - after_delaunay])
    })?;
    let figure = format!(
        "{triangulation:.1} s of user CPU for the Delaunay tetrahedra, {cells:.1} s for the cells: \
         {:.1} times",
        cells / triangulation
    );
    let object = format!("{} atoms", atoms.len());
    print_row("Voronoi", &object, &figure, "2 times");
    Ok(())
}
