//! One job by several processes: `mpirun atomesh-mpi mesh`.
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

use common::{files, succeed};

const TIME_LIMIT: Duration = Duration::from_secs(240);

/// The program under test as so many ranks.
fn mpirun_command(folder: &Path, count: usize) -> Command {
    // No job here takes long, and a launcher that hangs would hold up all that comes after.
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
        // In a container root is who is there.
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
        // It may not look into other processes' memory either.
        .env("OMPI_MCA_btl_vader_single_copy_mechanism", "none");
    command
}

/// Runs and asserts exit code 0.
fn run_ranks(folder: &Path, count: usize, words: &str) -> Output {
    let line = words.split_whitespace();
    let output = mpirun_command(folder, count).args(line).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{count} ranks, {words}: {said}");
    output
}

/// Runs, asserts that it fails and leaves nothing behind; gives what our program said.
fn run_expecting_failure(folder: &Path, count: usize, words: &str) -> Vec<String> {
    let before = files(folder);
    let line = words.split_whitespace();
    let output = mpirun_command(folder, count).args(line).output().unwrap();
    assert!(!output.status.success(), "{words}");
    assert!(
        files(folder) == before,
        "{words}: something was left behind"
    );
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let ours = said.lines().filter(|line| line.starts_with("error: "));
    ours.map(str::to_string).collect()
}

/// The mesh of faults in so many samples as one process makes it, in `one.vtu`; gives its bytes.
fn single_process_mesh(folder: &Path, dims: &str, job: &str) -> Vec<u8> {
    write_fault_network(folder, dims);
    let line: Vec<&str> = job.split_whitespace().chain(["-o", "one.vtu"]).collect();
    succeed(folder, &line);
    fs::read(folder.join("one.vtu")).unwrap()
}

/// Faults that cross, in noise.
fn write_fault_network(folder: &Path, dims: &str) {
    let line = ["synth", "network", "--dims", dims, "--rng-seed", "3"];
    succeed(folder, &[&line[..], &["-o", "net.npy", "--quiet"]].concat());
}

#[test]
fn the_mesh_has_the_same_bytes_for_any_number_of_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let job = "mesh net.npy --feature auto --distance 6 --quiet";
    let one = single_process_mesh(folder, "56,48,64", job);
    for count in [1, 2, 3, 4, 7] {
        run_ranks(folder, count, &format!("{job} -o many.vtu"));
        assert!(
            fs::read(folder.join("many.vtu")).unwrap() == one,
            "{count} ranks"
        );
    }
    // Stages that two ranks have kept three go on from.
    run_ranks(folder, 2, &format!("{job} -o many.vtu --checkpoint kept"));
    fs::remove_file(folder.join("kept/5-improved.checkpoint")).unwrap();
    run_ranks(folder, 3, &format!("{job} -o many.vtu --checkpoint kept"));
    assert!(
        fs::read(folder.join("many.vtu")).unwrap() == one,
        "from checkpoints"
    );
}

#[test]
fn faults_of_amplitudes_are_looked_for_by_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Windows of 144 layers: one for each of three ranks.
    let line = "synth amplitude --dims 36,32,300 --rng-seed 2 -o amp.npy --quiet";
    succeed(folder, &line.split_whitespace().collect::<Vec<_>>());
    let job = "mesh amp.npy --feature faults+horizons --distance 8 --quiet";
    let line = format!("{job} -o one.vtu");
    succeed(folder, &line.split_whitespace().collect::<Vec<_>>());
    run_ranks(folder, 3, &format!("{job} -o many.vtu"));
    let [one, many] = ["one.vtu", "many.vtu"].map(|name| fs::read(folder.join(name)).unwrap());
    assert!(one == many);
    // Two slabs: one of the ranks has none, but the arrays of the others.
    let job = "mesh amp.npy --feature faults+horizons --distance 2.2 --quiet";
    let line = format!("{job} -o one.vtu");
    succeed(folder, &line.split_whitespace().collect::<Vec<_>>());
    run_ranks(folder, 3, &format!("{job} -o parts.pvtu"));
    let [one, parts] = ["one.vtu", "parts.pvtu"]
        .map(|name| atomesh::store::read_any_mesh(&folder.join(name)).unwrap());
    assert!(one == parts);
}

#[test]
fn many_points_are_moved_and_triangulated_by_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Atoms in fifty chunks; then some chunks of atoms that are not everywhere as far apart.
    for how in ["--distance 2", "--distance 2.5:6 --kappa 0.7"] {
        let job = format!("mesh net.npy {how} --slivers none --quiet");
        let one = single_process_mesh(folder, "64,64,72", &format!("{job} --report one.json"));
        run_ranks(folder, 3, &format!("{job} -o many.vtu --report many.json"));
        assert!(fs::read(folder.join("many.vtu")).unwrap() == one, "{how}");
        let [one, many] = ["one.json", "many.json"].map(|name| mesh_figures(&folder.join(name)));
        assert_eq!(one, many, "{how}");
    }
}

/// What a report says of a mesh.
fn mesh_figures(report: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(report).unwrap();
    let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
    ["lattice", "quality", "fidelity", "box"]
        .map(|part| report[part].take())
        .into()
}

#[test]
fn parts_put_together_are_the_mesh() {
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
    // Other verbs read them.
    let quality = |name| succeed(folder, &["quality", name, "--json", "--quiet"]);
    let [one, parts] = ["one.vtu", "parts.pvtu"].map(quality);
    assert_eq!(one.replace("one.vtu", "parts.pvtu"), parts);
}

#[test]
fn a_large_mesh_is_made_in_pieces_of_which_no_rank_has_all() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // 150 d long: three slabs. Samples are no cubes, so that shapes are other ones in the world.
    let job = "mesh net.npy --distance 2 --spacing 2,1,1 --quiet";
    let one = single_process_mesh(folder, "300,48,40", &format!("{job} --report one.json"));
    let read = |name: &str| atomesh::store::read_any_mesh(&folder.join(name)).unwrap();
    let whole = read("one.vtu");
    run_ranks(folder, 3, &format!("{job} -o many.vtu"));
    assert!(fs::read(folder.join("many.vtu")).unwrap() == one);
    let size = |name: &str| fs::metadata(folder.join(name)).unwrap().len();
    for count in [2, 3, 4] {
        run_ranks(
            folder,
            count,
            &format!("{job} -o parts.pvtu --report many.json"),
        );
        assert!(read("parts.pvtu") == whole, "{count} ranks");
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
    // Where atoms are not everywhere as far apart all grow the lattice together, and each knows the distance near its
    // part.
    for (how, count) in [("--distance-from features", 3), ("--distance-from gaps", 4)] {
        let job = format!("mesh net.npy --distance 2:3 {how} --spacing 2,1,1 --quiet");
        let line = format!("{job} -o varying.vtu --report one.json");
        succeed(folder, &line.split_whitespace().collect::<Vec<_>>());
        run_ranks(
            folder,
            count,
            &format!("{job} -o parts.pvtu --report many.json"),
        );
        assert!(read("parts.pvtu") == read("varying.vtu"), "{how}");
        let [one, many] = ["one.json", "many.json"].map(|name| exact_figures(&folder.join(name)));
        assert_eq!(one, many, "{how}");
    }
    let job = "mesh net.npy --distance 2:3 --spacing 2,1,1 --quiet";
    // What needs all of the mesh has it.
    run_ranks(
        folder,
        2,
        &format!("{job} -o parts.pvtu --surfaces faults.vtp"),
    );
    assert!(read("parts.pvtu") == read("varying.vtu") && folder.join("faults.vtp").exists());
}

/// What a report says of a mesh, but for sums of numbers with a fraction, which pieces sum up in another order.
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
    let mut all: serde_json::Value = parts
        .into_iter()
        .map(|part| (part.to_string(), report[part].take()))
        .collect();
    let mut rounded = |part: &str, name: &str, round: fn(f64) -> String| {
        let value = all[part][name].take();
        all[part][name] = round(value.as_f64().expect(name)).into();
    };
    for part in ["quality", "quality_physical"] {
        rounded(part, "mean_ratio_mean", |mean| format!("{mean:.9}"));
        // Of a million the ninth decimal is the last that a number has.
        rounded(part, "volume", |volume| format!("{volume:.9e}"));
    }
    for name in ["volume_error", "area_error"] {
        rounded("box", name, |error| format!("{error:.9}"));
    }
    let area = all["improvement"]["sealed"]["area"].take();
    all["improvement"]["sealed"]["area"] = format!("{:.6}", area.as_f64().expect("area")).into();
    all
}

#[test]
fn what_one_rank_cannot_read_ends_all_with_one_error() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_fault_network(folder, "64,48,96");
    let convert = ["convert", "net.npy", "net.zarr", "--quiet"];
    succeed(folder, &convert);
    let job = "mesh net.zarr --distance 8 -o out.pvtu --quiet";
    // The last chunk there is.
    let chunks = files(&folder.join("net.zarr")).into_iter();
    let chunks = chunks.filter(|(path, _)| !path.ends_with("zarr.json"));
    fs::write(chunks.max().unwrap().0, b"no chunk").unwrap();
    let said = run_expecting_failure(folder, 3, job);
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].contains("net.zarr") && said[0].contains("; "),
        "{said:?}"
    );

    let said = run_expecting_failure(folder, 2, "mesh none.npy --distance 8 -o out.vtu --quiet");
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("none.npy"), "{said:?}");
    let said = run_expecting_failure(folder, 2, "info net.npy --quiet");
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("atomesh mesh only"), "{said:?}");
    let trace = "mesh net.npy --distance 8 -o out.vtu --trace out.pvd --quiet";
    let said = run_expecting_failure(folder, 2, trace);
    assert!(said.len() == 1 && said[0].contains("--trace"), "{said:?}");
}

#[test]
fn a_rank_that_is_killed_ends_the_job() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_fault_network(folder, "96,96,96");
    let before = files(folder);
    // Ranks are at work then. One that dies while Open MPI 4 is still starting it may leave mpirun waiting for ever.
    for stage in ["finding features", "moving atoms", "removing slivers"] {
        let job = "mesh net.npy --distance 5 -o out.pvtu";
        let mut job = mpirun_command(folder, 3)
            .args(job.split_whitespace())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(job.stderr.take().unwrap()).lines();
        let begun = said.any(|line| line.is_ok_and(|line| line.starts_with(stage)));
        let at_work = child_processes(child_processes(job.id())[0]);
        assert!(begun && at_work.len() == 3, "{stage}: {at_work:?}");
        let killed = at_work[2].to_string();
        let kill = Command::new("kill").args(["-9", &killed]).status();
        assert!(kill.unwrap().success());
        // What mpirun still says is read, so that it need not wait for that.
        let rest = spawn(move || said.count());
        let killed = Instant::now();
        assert!(!job.wait().unwrap().success(), "{stage}");
        assert!(killed.elapsed() < Duration::from_secs(60), "{stage}");
        rest.join().unwrap();
        assert!(files(folder) == before, "{stage}: something was left");
    }
}

/// The processes that a process has started.
fn child_processes(parent: u32) -> Vec<u32> {
    let all = fs::read_dir("/proc").unwrap().filter_map(|entry| {
        let id: u32 = entry.ok()?.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        // Its name is in brackets; then come its state and its parent.
        let of = stat.rsplit_once(')')?.1.split_whitespace().nth(1)?;
        (of.parse() == Ok(parent)).then_some(id)
    });
    all.collect()
}
