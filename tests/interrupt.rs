//! Tests interrupts: Ctrl-C at any moment, and progress trackers that stop a job in any stage.

use atomesh::ErrorKind;
use atomesh::image::synth::{self, SyntheticKind};
use atomesh::image::{Geometry, Image};
use atomesh::job::spec::{MeshSpec, NominalDistance};
use atomesh::job::{self, BOX_TOLERANCE, CellKind, MeshImage, MeshResult, Params};
use atomesh::lattice::optimise::StopReason;
use atomesh::mesh::Space;
use atomesh::mesh::check::{CheckHints, check, check_with_hints};
use atomesh::progress::{Progress, Stage};
use atomesh::published::relax::Scheme;

/// A progress tracker that stops the job when a stage begins.
struct Stopper {
    stop_stage: Stage,
    stopped: bool,
    seen: Vec<Stage>,
}

impl Progress for Stopper {
    fn stage(&mut self, stage: Stage) {
        self.stopped |= stage == self.stop_stage;
        self.seen.push(stage);
    }

    fn keep_going(&mut self) -> bool {
        !self.stopped
    }
}

/// Stops a job in each of its stages in turn.
fn assert_stops_in_each_stage<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    stages: &[Stage],
) where
    Space<D>: MeshImage<D>,
{
    for &stage in stages {
        let mut stopper = Stopper {
            stop_stage: stage,
            stopped: false,
            seen: Vec::new(),
        };
        let outcome = job::run(image, params, &mut stopper);
        assert!(stopper.stopped, "{stage} never began: {:?}", stopper.seen);
        match outcome {
            Err(error) => {
                assert_eq!(error.kind(), ErrorKind::Interrupted, "{stage}: {error}");
                assert!(!stage.has_lattice(), "{stage}: {error}");
            }
            Ok(outcome) => {
                assert!(stage.has_lattice(), "{stage} gave a mesh");
                assert_eq!(outcome.stop, StopReason::Interrupted, "{stage}");
                let (low, high) = ([0.0; D], outcome.extent);
                let check = match &outcome.mesh {
                    MeshResult::Simplices(simplices) => {
                        check(&simplices.mesh, low, high, BOX_TOLERANCE)
                    }
                    MeshResult::Voronoi { mesh, weld } => {
                        let hints = CheckHints {
                            weld: *weld,
                            ..CheckHints::default()
                        };
                        check_with_hints(mesh, hints, low, high, BOX_TOLERANCE)
                    }
                };
                assert!(check.passed(), "{stage}: {check:?}");
                // The tracker also stops the measuring, so that its figures are missing.
                assert_eq!(outcome.report.fidelity, None, "{stage}");
            }
        }
    }
}

fn sphere() -> Image<3> {
    let options = synth::Options {
        dims: [32, 30, 28],
        ..Default::default()
    };
    synth::make(SyntheticKind::Sphere, &options).unwrap().image
}

fn disc() -> Image<2> {
    let offset = |i: usize| [(i % 60) as f64 - 30.0, (i / 60) as f64 - 25.0];
    let value = |i| {
        if offset(i)[0].hypot(offset(i)[1]) < 15.0 {
            100.0
        } else {
            0.0
        }
    };
    let samples = (0..60 * 50).map(value).collect();
    Image::new([60, 50], samples, Geometry::default())
}

fn params_with_distance<const D: usize>(d: f64) -> Params<D> {
    Params::new(MeshSpec {
        distance: NominalDistance::Constant(d),
        ..MeshSpec::default()
    })
    .unwrap()
}

#[test]
fn tetrahedra_are_stopped_in_every_stage() {
    use Stage::*;
    let stages = [
        Features,
        Placing,
        Optimising,
        Triangulating,
        Improving,
        Measuring,
    ];
    assert_stops_in_each_stage(&sphere(), &params_with_distance(6.0), &stages);
}

#[test]
fn voronoi_cells_are_stopped_in_every_stage() {
    use Stage::*;
    let params = Params::new(MeshSpec {
        cells: Some(CellKind::Voronoi),
        align: None,
        ..params_with_distance::<3>(6.0).spec
    })
    .unwrap();
    let stages = [
        Features,
        Placing,
        Optimising,
        Triangulating,
        Improving,
        Conforming,
        Cutting,
        Measuring,
    ];
    assert_stops_in_each_stage(&disc(), &params, &stages);
    let params = Params::new(MeshSpec {
        cells: Some(CellKind::Voronoi),
        align: None,
        ..params_with_distance::<3>(6.0).spec
    })
    .unwrap();
    assert_stops_in_each_stage(&sphere(), &params, &stages);
}

#[test]
fn triangles_are_stopped_in_every_stage() {
    use Stage::*;
    let params = Params::new(MeshSpec {
        smooth: Some(Scheme::Odt),
        ..params_with_distance::<2>(6.0).spec
    })
    .unwrap();
    let stages = [
        Features,
        Placing,
        Optimising,
        Triangulating,
        Smoothing,
        Improving,
        Measuring,
    ];
    assert_stops_in_each_stage(&disc(), &params, &stages);
}

#[test]
fn the_files_of_a_job_appear_all_together_or_not_at_all() {
    use atomesh::files::{Batch, atomic_write, transaction};
    use std::io::Write;

    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    let names = || {
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    std::fs::write(in_folder("a"), "before").unwrap();
    let write = |fails: bool| {
        transaction(|| {
            atomic_write(&in_folder("a"), |out| out.write_all(b"first"))?;
            atomic_write(&in_folder("a"), |out| out.write_all(b"last"))?;
            let mut batch = Batch::default();
            batch.create_folder(&in_folder("case/inner"))?;
            batch.write(&in_folder("case/inner/b"), |out| out.write_all(b"b"))?;
            batch.commit()?;
            // Nothing changes on disk before the job ends.
            assert_eq!(std::fs::read(in_folder("a")).unwrap(), b"before");
            assert!(!in_folder("case/inner/b").exists());
            atomic_write(&in_folder("c"), |out| {
                if fails {
                    Err(std::io::Error::other("disk full"))
                } else {
                    out.write_all(b"c")
                }
            })
        })
    };
    assert!(write(true).unwrap_err().to_string().contains("disk full"));
    assert_eq!(names(), ["a"]);
    assert_eq!(std::fs::read(in_folder("a")).unwrap(), b"before");
    write(false).unwrap();
    assert_eq!(names(), ["a", "c", "case"]);
    assert_eq!(std::fs::read(in_folder("a")).unwrap(), b"last");
    assert_eq!(std::fs::read(in_folder("case/inner/b")).unwrap(), b"b");
    // Outside a transaction, each file appears at once.
    atomic_write(&in_folder("a"), |out| out.write_all(b"alone")).unwrap();
    assert_eq!(std::fs::read(in_folder("a")).unwrap(), b"alone");
}

#[cfg(unix)]
mod signals {
    use std::io::{BufRead, BufReader};
    use std::path::Path;
    use std::process::{Child, Command, Stdio};
    use std::thread::sleep;
    use std::time::{Duration, Instant};

    use crate::common::{atomesh, files_below, run_args};

    /// Two seconds, doubled for a machine with other load.
    const MAX_DELAY: Duration = Duration::from_secs(4);

    fn interrupt(child: &Child) {
        signal(child, "-INT");
    }

    fn signal(child: &Child, name: &str) {
        let pid = child.id().to_string();
        Command::new("kill").args([name, &pid]).status().unwrap();
    }

    fn start(folder: &Path, line: &str) -> Child {
        atomesh(folder)
            .args(line.split_whitespace())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    }

    /// Returns the exit code, and how long the process continued.
    fn wait_for_end(mut child: Child) -> (Option<i32>, Duration) {
        let start = Instant::now();
        let code = child.wait().unwrap().code();
        (code, start.elapsed())
    }

    /// Returns the names of all files except the image. Temporary files are among them.
    fn output_names(folder: &Path) -> Vec<String> {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let mut names: Vec<_> = files_below(folder)
            .iter()
            .map(|(path, _)| name(path))
            .collect();
        names.retain(|name| name != "faults.npy");
        names
    }

    const MESH: &str = "mesh faults.npy -o mesh.vtu --distance 6 --optimizer genetic";

    #[test]
    #[ignore = "slow: make test-all"]
    fn an_interrupted_mesh_is_complete_or_absent() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        run_args(
            dir,
            &["synth", "faults", "-o", "faults.npy", "--dims", "96,90,84"],
        );
        for moment in [0.05, 0.2, 0.5, 1.0, 2.0, 4.0] {
            let child = start(dir, MESH);
            sleep(Duration::from_secs_f64(moment));
            interrupt(&child);
            let (code, delay) = wait_for_end(child);
            let names = output_names(dir);
            assert!(delay < MAX_DELAY, "went on for {delay:?} after {moment} s");
            println!("{moment} s: {code:?} after {delay:?}, {names:?}");
            match names.as_slice() {
                [] => assert_eq!(code, Some(130), "after {moment} s"),
                [name] if name == "mesh.vtu" => {
                    assert!(matches!(code, Some(0 | 130)), "{code:?} after {moment} s");
                    run_args(dir, &["quality", "mesh.vtu"]);
                    std::fs::remove_file(dir.join("mesh.vtu")).unwrap();
                }
                other => panic!("{other:?} left after {moment} s"),
            }
        }
        // A second interrupt ends the program at once, in any state.
        let child = start(dir, MESH);
        sleep(Duration::from_secs(2));
        interrupt(&child);
        sleep(Duration::from_millis(50));
        interrupt(&child);
        let (code, delay) = wait_for_end(child);
        assert!(delay < MAX_DELAY, "{delay:?}");
        assert!(matches!(code, Some(0 | 130)), "{code:?}");
    }

    #[test]
    fn a_job_that_moves_many_atoms_stops_as_soon() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        run_args(
            dir,
            &["synth", "faults", "-o", "faults.npy", "--dims", "96,96,96"],
        );
        let mut child = atomesh(dir)
            .args("mesh faults.npy -o mesh.vtu --distance 1.5 --optimizer genetic".split(' '))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // Triangulating these many atoms would take longer than the allowed delay.
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut lines = lines.map(|line| line.unwrap());
        assert!(lines.any(|line| line.starts_with("moving atoms")));
        sleep(Duration::from_secs(1));
        interrupt(&child);
        let (code, delay) = wait_for_end(child);
        assert!(delay < MAX_DELAY, "went on for {delay:?}");
        assert_eq!((code, output_names(dir)), (Some(130), Vec::new()));
    }

    #[test]
    fn other_verbs_leave_no_files() {
        let folder = tempfile::tempdir().unwrap();
        for moment in [0.1, 0.4, 0.8, 1.2, 1.6] {
            let child = start(folder.path(), "synth faults -o big.npy --dims 200,200,200");
            sleep(Duration::from_secs_f64(moment));
            // A user sends the first signal, a batch system the second one.
            signal(&child, if moment < 1.0 { "-INT" } else { "-TERM" });
            let (code, delay) = wait_for_end(child);
            assert!(delay < MAX_DELAY, "went on for {delay:?} after {moment} s");
            match (code, output_names(folder.path()).as_slice()) {
                (Some(130), []) => (),
                (Some(0 | 130), [name]) if name == "big.npy" => {
                    std::fs::remove_file(folder.path().join(name)).unwrap();
                }
                other => panic!("{other:?} after {moment} s"),
            }
        }
    }

    /// A killed process leaves files with temporary names without an owner. A file that another
    /// process is writing is locked by it.
    #[test]
    fn temporary_files_of_killed_processes_are_removed_by_the_next_run() {
        let folder = tempfile::tempdir().unwrap();
        let in_folder = |name: &str| folder.path().join(name);
        let [dead, alive] = ["dead", "alive"]
            .map(|name| in_folder(&format!(".{name}.vtu.aBc123.atomesh-unfinished")));
        for path in [&dead, &alive, &in_folder(".mine"), &in_folder("dead.vtu")] {
            std::fs::write(path, "x").unwrap();
        }
        let owner = std::fs::File::open(&alive).unwrap();
        owner.lock().unwrap();
        run_args(
            folder.path(),
            &["synth", "sphere", "-o", "a.npy", "--dims", "9,9,9"],
        );
        assert!(
            !dead.exists()
                && alive.exists()
                && in_folder(".mine").exists()
                && in_folder("dead.vtu").exists()
        );
        drop(owner);
        run_args(
            folder.path(),
            &["synth", "sphere", "-o", "a.npy", "--dims", "9,9,9"],
        );
        assert!(!alive.exists());
    }
}
