//! Tests one job on several processes: `mpirun atomesh-mpi mesh`.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on has failed"
)]

#[path = "../../../tests/common/mod.rs"]
#[allow(dead_code, reason = "shared with the other tests")]
mod common;

const PROGRAM: &str = env!("CARGO_BIN_EXE_atomesh-mpi");

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread::spawn;
use std::time::{Duration, Instant};

use common::{files_below, run_args};

const TIME_LIMIT: Duration = Duration::from_secs(240);

/// Returns a command that starts the program under test on `count` ranks.
fn mpirun_command(folder: &Path, count: usize) -> Command {
    // No job here takes long, and a launcher that hangs would block all later tests.
    let mut command = Command::new("timeout");
    command
        .current_dir(folder)
        .args([
            "--kill-after=5",
            &TIME_LIMIT.as_secs().to_string(),
            "mpirun",
        ])
        .args(["--oversubscribe", "-n", &count.to_string()])
        .arg(PROGRAM)
        // In a container the user is root.
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
        // A container may not read the memory of other processes.
        .env("OMPI_MCA_btl_vader_single_copy_mechanism", "none");
    command
}

/// Runs the program on `count` ranks and asserts exit code 0.
fn run_ranks(folder: &Path, count: usize, command_line: &str) -> Output {
    let line = command_line.split_whitespace();
    let output = mpirun_command(folder, count).args(line).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{count} ranks, {command_line}: {stderr}"
    );
    output
}

/// Runs the program on `count` ranks, asserts that it fails and leaves no files, and returns its
/// error lines.
fn run_expecting_failure(folder: &Path, count: usize, command_line: &str) -> Vec<String> {
    let before = files_below(folder);
    let line = command_line.split_whitespace();
    let output = mpirun_command(folder, count).args(line).output().unwrap();
    assert!(!output.status.success(), "{command_line}");
    assert!(
        files_below(folder) == before,
        "{command_line}: files were left behind"
    );
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let errors = stderr.lines().filter(|line| line.starts_with("error: "));
    errors.map(str::to_string).collect()
}

/// Meshes a fault network of `dims` samples with one process, writes `one.vtu`, and returns its
/// bytes.
fn single_process_mesh(folder: &Path, dims: &str, job: &str) -> Vec<u8> {
    write_fault_network(folder, dims);
    let line: Vec<&str> = job.split_whitespace().chain(["-o", "one.vtu"]).collect();
    run_args(folder, &line);
    fs::read(folder.join("one.vtu")).unwrap()
}

/// Writes an image of crossing faults in noise, `net.npy`.
fn write_fault_network(folder: &Path, dims: &str) {
    let line = ["synth", "network", "--dims", dims, "--rng-seed", "3"];
    run_args(folder, &[&line[..], &["-o", "net.npy", "--quiet"]].concat());
}

#[test]
fn the_mesh_has_the_same_bytes_for_any_number_of_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let job = "mesh net.npy --feature auto --distance 6 --quiet";
    let reference = single_process_mesh(folder, "56,48,64", job);
    for count in [1, 2, 3, 4, 7] {
        run_ranks(folder, count, &format!("{job} -o many.vtu"));
        assert!(
            fs::read(folder.join("many.vtu")).unwrap() == reference,
            "{count} ranks"
        );
    }
    // Three ranks continue from the checkpoints of two ranks.
    run_ranks(folder, 2, &format!("{job} -o many.vtu --checkpoint kept"));
    fs::remove_file(folder.join("kept/5-improved.checkpoint")).unwrap();
    run_ranks(folder, 3, &format!("{job} -o many.vtu --checkpoint kept"));
    assert!(
        fs::read(folder.join("many.vtu")).unwrap() == reference,
        "from checkpoints"
    );
}

#[test]
fn all_ranks_detect_faults_of_amplitudes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // There is a window of 144 layers for each of the three ranks.
    let line = "synth amplitude --dims 36,32,300 --rng-seed 2 -o amp.npy --quiet";
    run_args(folder, &line.split_whitespace().collect::<Vec<_>>());
    let job = "mesh amp.npy --feature faults+horizons --distance 8 --quiet";
    let line = format!("{job} -o one.vtu");
    run_args(folder, &line.split_whitespace().collect::<Vec<_>>());
    run_ranks(folder, 3, &format!("{job} -o many.vtu"));
    let [one, many] = ["one.vtu", "many.vtu"].map(|name| fs::read(folder.join(name)).unwrap());
    assert!(one == many);
    // There are two slabs, so that one rank has none, only the arrays of the others.
    let job = "mesh amp.npy --feature faults+horizons --distance 2.2 --quiet";
    let line = format!("{job} -o one.vtu");
    run_args(folder, &line.split_whitespace().collect::<Vec<_>>());
    run_ranks(folder, 3, &format!("{job} -o parts.pvtu"));
    let [one, parts] = ["one.vtu", "parts.pvtu"]
        .map(|name| atomesh::store::read_any_mesh(&folder.join(name)).unwrap());
    assert!(one == parts);
}

#[test]
fn all_ranks_move_and_triangulate_many_points() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The first job has atoms in fifty chunks, the second one some chunks of atoms with a varying
    // distance.
    for options in ["--distance 2", "--distance 2.5:6 --kappa 0.7"] {
        let job = format!("mesh net.npy {options} --slivers none --quiet");
        let one = single_process_mesh(folder, "64,64,72", &format!("{job} --report one.json"));
        run_ranks(folder, 3, &format!("{job} -o many.vtu --report many.json"));
        assert!(
            fs::read(folder.join("many.vtu")).unwrap() == one,
            "{options}"
        );
        let [one, many] = ["one.json", "many.json"].map(|name| mesh_figures(&folder.join(name)));
        assert_eq!(one, many, "{options}");
    }
}

/// Returns the figures of the mesh in a report.
fn mesh_figures(report: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(report).unwrap();
    let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
    ["lattice", "quality", "fidelity", "box"]
        .map(|part| report[part].take())
        .into()
}

#[test]
fn the_parts_together_are_the_mesh_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let job = "mesh net.npy --distance 6 --quiet";
    single_process_mesh(folder, "56,48,64", job);
    run_ranks(folder, 3, &format!("{job} -o parts.pvtu"));
    for part in 0..3 {
        assert!(folder.join(format!("parts_000{part}.vtu")).exists());
    }
    let [one, parts] = ["one.vtu", "parts.pvtu"].map(|name| {
        let path = folder.join(name);
        atomesh::store::read_any_mesh(&path).unwrap()
    });
    assert!(one == parts);
    // Other verbs read a mesh in parts.
    let quality = |name| run_args(folder, &["quality", name, "--json", "--quiet"]);
    let [one, parts] = ["one.vtu", "parts.pvtu"].map(quality);
    assert_eq!(one.replace("one.vtu", "parts.pvtu"), parts);
}

#[test]
fn no_rank_holds_all_of_a_large_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The box is 150 d long, which gives three slabs. Samples are not cubic, so that shapes differ
    // in physical space.
    let job = "mesh net.npy --distance 2 --spacing 2,1,1 --quiet";
    let one = single_process_mesh(folder, "300,48,40", &format!("{job} --report one.json"));
    let read = |name: &str| atomesh::store::read_any_mesh(&folder.join(name)).unwrap();
    let reference = read("one.vtu");
    run_ranks(folder, 3, &format!("{job} -o many.vtu"));
    assert!(fs::read(folder.join("many.vtu")).unwrap() == one);
    let size = |name: &str| fs::metadata(folder.join(name)).unwrap().len();
    for count in [2, 3, 4] {
        run_ranks(
            folder,
            count,
            &format!("{job} -o parts.pvtu --report many.json"),
        );
        assert!(read("parts.pvtu") == reference, "{count} ranks");
        let largest = (0..count)
            .map(|part| size(&format!("parts_000{part}.vtu")))
            .max();
        let limit = if count == 2 { 0.8 } else { 0.45 };
        assert!(
            (largest.unwrap() as f64) < limit * size("one.vtu") as f64,
            "{count} ranks"
        );
        let [one, many] = ["one.json", "many.json"].map(|name| exact_figures(&folder.join(name)));
        assert_eq!(one, many, "{count} ranks");
    }
    // With a varying distance all ranks grow the lattice together, and each holds the distance near
    // its part only.
    for (options, count) in [("--distance-from features", 3), ("--distance-from gaps", 4)] {
        let job = format!("mesh net.npy --distance 2:3 {options} --spacing 2,1,1 --quiet");
        let line = format!("{job} -o varying.vtu --report one.json");
        run_args(folder, &line.split_whitespace().collect::<Vec<_>>());
        run_ranks(
            folder,
            count,
            &format!("{job} -o parts.pvtu --report many.json"),
        );
        assert!(read("parts.pvtu") == read("varying.vtu"), "{options}");
        let [one, many] = ["one.json", "many.json"].map(|name| exact_figures(&folder.join(name)));
        assert_eq!(one, many, "{options}");
    }
    let job = "mesh net.npy --distance 2:3 --spacing 2,1,1 --quiet";
    // The output of surfaces gathers the whole mesh.
    run_ranks(
        folder,
        2,
        &format!("{job} -o parts.pvtu --surfaces faults.vtp"),
    );
    assert!(read("parts.pvtu") == read("varying.vtu") && folder.join("faults.vtp").exists());
}

/// Returns the figures of the mesh in a report. Sums of fractions are rounded, since parts sum up
/// in another order.
fn exact_figures(report: &Path) -> serde_json::Value {
    let text = fs::read_to_string(report).unwrap();
    let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let parts = [
        "lattice",
        "quality",
        "quality_physical",
        "fidelity",
        "box",
        "improvement",
    ];
    let mut figures: serde_json::Value = parts
        .into_iter()
        .map(|part| (part.to_string(), report[part].take()))
        .collect();
    let mut round_figure = |part: &str, name: &str, round: fn(f64) -> String| {
        let value = figures[part][name].take();
        figures[part][name] = round(value.as_f64().expect(name)).into();
    };
    for part in ["quality", "quality_physical"] {
        round_figure(part, "mean_ratio_mean", |mean| format!("{mean:.9}"));
        // The volume is about a million, so that its ninth decimal is beyond double precision.
        round_figure(part, "volume", |volume| format!("{volume:.9e}"));
    }
    for name in ["volume_error", "area_error"] {
        round_figure("box", name, |error| format!("{error:.9}"));
    }
    let area = figures["improvement"]["sealed"]["area"].take();
    figures["improvement"]["sealed"]["area"] =
        format!("{:.6}", area.as_f64().expect("area")).into();
    figures
}

#[test]
fn a_read_error_of_one_rank_ends_all_ranks_with_one_error() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_fault_network(folder, "64,48,96");
    let convert = ["convert", "net.npy", "net.zarr", "--quiet"];
    run_args(folder, &convert);
    let job = "mesh net.zarr --distance 8 -o out.pvtu --quiet";
    // Damage the last chunk.
    let chunks = files_below(&folder.join("net.zarr")).into_iter();
    let chunks = chunks.filter(|(path, _)| !path.ends_with("zarr.json"));
    fs::write(chunks.max().unwrap().0, b"no chunk").unwrap();
    let errors = run_expecting_failure(folder, 3, job);
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(
        errors[0].contains("net.zarr") && errors[0].contains("; "),
        "{errors:?}"
    );

    let errors = run_expecting_failure(folder, 2, "mesh none.npy --distance 8 -o out.vtu --quiet");
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(errors[0].contains("none.npy"), "{errors:?}");
    let errors = run_expecting_failure(folder, 2, "info net.npy --quiet");
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(errors[0].contains("atomesh mesh only"), "{errors:?}");
    let trace = "mesh net.npy --distance 8 -o out.vtu --trace out.pvd --quiet";
    let errors = run_expecting_failure(folder, 2, trace);
    assert!(
        errors.len() == 1 && errors[0].contains("--trace"),
        "{errors:?}"
    );
}

#[test]
fn a_rank_that_is_killed_ends_the_job() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_fault_network(folder, "96,96,96");
    let before = files_below(folder);
    // The ranks are computing in these stages. If a rank dies while Open MPI 4 is still starting
    // it, mpirun may wait endlessly.
    for stage in ["finding features", "moving atoms", "removing slivers"] {
        let job = "mesh net.npy --distance 5 -o out.pvtu";
        let mut job = mpirun_command(folder, 3)
            .args(job.split_whitespace())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(job.stderr.take().unwrap()).lines();
        let begun = lines.any(|line| line.is_ok_and(|line| line.starts_with(stage)));
        let at_work = child_processes(child_processes(job.id())[0]);
        assert!(begun && at_work.len() == 3, "{stage}: {at_work:?}");
        let killed = at_work[2].to_string();
        let kill = Command::new("kill").args(["-9", &killed]).status();
        assert!(kill.unwrap().success());
        // Read the remaining output of mpirun, so that it does not block on a full pipe.
        let reader = spawn(move || lines.count());
        let killed = Instant::now();
        assert!(!job.wait().unwrap().success(), "{stage}");
        assert!(killed.elapsed() < Duration::from_secs(60), "{stage}");
        reader.join().unwrap();
        assert!(
            files_below(folder) == before,
            "{stage}: files were left behind"
        );
    }
}

/// Returns the ids of the child processes of a process.
fn child_processes(parent: u32) -> Vec<u32> {
    let children = fs::read_dir("/proc").unwrap().filter_map(|entry| {
        let id: u32 = entry.ok()?.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        // The name of the process is in brackets, followed by its state and its parent.
        let parent_field = stat.rsplit_once(')')?.1.split_whitespace().nth(1)?;
        (parent_field.parse() == Ok(parent)).then_some(id)
    });
    children.collect()
}
