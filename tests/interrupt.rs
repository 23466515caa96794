//! Ctrl-C at any moment, and observers that say stop in any stage.

use atomesh::ErrorKind;
use atomesh::image::synth::{self, SyntheticKind};
use atomesh::image::{Geometry, Image};
use atomesh::improve::Scheme;
use atomesh::job::spec::{MeshSpec, NominalDistance};
use atomesh::job::{
    self, BOX_TOLERANCE, CellKind, MeshResult, MeshSpace, Meshing, Params,
};
use atomesh::lattice::optimize::StopReason;
use atomesh::mesh::check::{CheckHints, check, check_with_hints};
use atomesh::progress::{Progress, Stage};

/// Says stop from a stage on.
struct Stopper {
    from: Stage,
    over: bool,
    seen: Vec<Stage>,
}

impl Progress for Stopper {
    fn stage(&mut self, stage: Stage) {
        self.over |= stage == self.from;
        self.seen.push(stage);
    }

    fn keep_going(&mut self) -> bool {
        !self.over
    }
}

/// Stops a job in one stage after the other.
fn stopped_everywhere<const D: usize>(image: &Image<D>, params: &Params<D>, stages: &[Stage])
where
    MeshSpace<D>: Meshing<D>,
{
    for &from in stages {
        let mut stopper = Stopper {
            from,
            over: false,
            seen: Vec::new(),
        };
        let outcome = job::run(image, params, &mut stopper);
        assert!(stopper.over, "{from} never began: {:?}", stopper.seen);
        match outcome {
            Err(error) => {
                assert_eq!(error.kind(), ErrorKind::Interrupted, "{from}: {error}");
                assert!(!from.has_lattice(), "{from}: {error}");
            }
            Ok(outcome) => {
                assert!(from.has_lattice(), "{from} gave a mesh");
                assert_eq!(outcome.stop, StopReason::Interrupted, "{from}");
                let (low, high) = ([0.0; D], outcome.extent);
                let check = match &outcome.mesh {
                    MeshResult::Simplices(made) => check(&made.mesh, low, high, BOX_TOLERANCE),
                    MeshResult::Voronoi { mesh, weld } => {
                        let known = CheckHints {
                            weld: *weld,
                            ..CheckHints::default()
                        };
                        check_with_hints(mesh, known, low, high, BOX_TOLERANCE)
                    }
                };
                assert!(check.passed(), "{from}: {check:?}");
                // It says no to the end: what measuring would find is missing.
                assert_eq!(outcome.report.fidelity, None, "{from}");
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
    let at = |i: usize| [(i % 60) as f64 - 30.0, (i / 60) as f64 - 25.0];
    let value = |i| {
        if at(i)[0].hypot(at(i)[1]) < 15.0 {
            100.0
        } else {
            0.0
        }
    };
    let samples = (0..60 * 50).map(value).collect();
    Image::new([60, 50], samples, Geometry::default())
}

fn spaced<const D: usize>(d: f64) -> Params<D> {
    Params::new(MeshSpec {
        distance: NominalDistance::Constant(d),
        ..MeshSpec::default()
    })
    .unwrap()
}

#[test]
#[cfg(feature = "tetgen")]
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
    stopped_everywhere(&sphere(), &spaced(6.0), &stages);
}

#[test]
fn voronoi_cells_are_stopped_in_every_stage() {
    use Stage::*;
    let params = Params::new(MeshSpec {
        cells: Some(CellKind::Voronoi),
        align: None,
        ..spaced::<3>(6.0).spec
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
    stopped_everywhere(&disc(), &params, &stages);
    if cfg!(feature = "tetgen") {
        let params = Params::new(MeshSpec {
            cells: Some(CellKind::Voronoi),
            align: None,
            ..spaced::<3>(6.0).spec
        })
        .unwrap();
        stopped_everywhere(&sphere(), &params, &stages);
    }
}

#[test]
fn triangles_are_stopped_in_every_stage() {
    use Stage::*;
    let params = Params::new(MeshSpec {
        smooth: Some(Scheme::Odt),
        ..spaced::<2>(6.0).spec
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
    stopped_everywhere(&disc(), &params, &stages);
}

#[test]
fn the_files_of_a_job_appear_together_or_not_at_all() {
    use atomesh::files::{Batch, atomic_write, transaction};
    use std::io::Write;

    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let names = || {
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    std::fs::write(at("a"), "before").unwrap();
    let write = |fails: bool| {
        transaction(|| {
            atomic_write(&at("a"), |out| out.write_all(b"first"))?;
            atomic_write(&at("a"), |out| out.write_all(b"last"))?;
            let mut batch = Batch::default();
            batch.create_folder(&at("case/inner"))?;
            batch.write(&at("case/inner/b"), |out| out.write_all(b"b"))?;
            batch.commit()?;
            // As long as the job lasts, nothing has changed.
            assert_eq!(std::fs::read(at("a")).unwrap(), b"before");
            assert!(!at("case/inner/b").exists());
            atomic_write(&at("c"), |out| match fails {
                true => Err(std::io::Error::other("disk full")),
                false => out.write_all(b"c"),
            })
        })
    };
    assert!(write(true).unwrap_err().to_string().contains("disk full"));
    assert_eq!(names(), ["a"]);
    assert_eq!(std::fs::read(at("a")).unwrap(), b"before");
    write(false).unwrap();
    assert_eq!(names(), ["a", "c", "case"]);
    assert_eq!(std::fs::read(at("a")).unwrap(), b"last");
    assert_eq!(std::fs::read(at("case/inner/b")).unwrap(), b"b");
    // After it, each file appears at once again.
    atomic_write(&at("a"), |out| out.write_all(b"alone")).unwrap();
    assert_eq!(std::fs::read(at("a")).unwrap(), b"alone");
}

#[cfg(all(unix, feature = "tetgen"))]
mod signals {
    use std::io::{BufRead, BufReader};
    use std::path::Path;
    use std::process::{Child, Command, Stdio};
    use std::thread::sleep;
    use std::time::{Duration, Instant};

    use crate::common::{atomesh, files_below, run_args};

    /// Two seconds, and as much again for a machine that has other work to do.
    const AT_MOST: Duration = Duration::from_secs(4);

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

    /// The exit code, and how long the process went on.
    fn end(mut child: Child) -> (Option<i32>, Duration) {
        let start = Instant::now();
        let code = child.wait().unwrap().code();
        (code, start.elapsed())
    }

    /// The names of all files but the image; none may be a temporary one.
    fn made(folder: &Path) -> Vec<String> {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let mut names: Vec<_> = files_below(folder).iter().map(|(path, _)| name(path)).collect();
        names.retain(|name| name != "faults.npy");
        names
    }

    const MESH: &str = "mesh faults.npy -o mesh.vtu --distance 6 --optimizer genetic";

    #[test]
    #[ignore = "slow: make test-all"]
    fn a_mesh_is_whole_or_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        run_args(
            here,
            &["synth", "faults", "-o", "faults.npy", "--dims", "96,90,84"],
        );
        for moment in [0.05, 0.2, 0.5, 1.0, 2.0, 4.0] {
            let child = start(here, MESH);
            sleep(Duration::from_secs_f64(moment));
            interrupt(&child);
            let (code, took) = end(child);
            let names = made(here);
            assert!(took < AT_MOST, "went on for {took:?} after {moment} s");
            println!("{moment} s: {code:?} after {took:?}, {names:?}");
            match names.as_slice() {
                [] => assert_eq!(code, Some(130), "after {moment} s"),
                [name] if name == "mesh.vtu" => {
                    assert!(matches!(code, Some(0 | 130)), "{code:?} after {moment} s");
                    run_args(here, &["quality", "mesh.vtu"]);
                    std::fs::remove_file(here.join("mesh.vtu")).unwrap();
                }
                other => panic!("{other:?} left after {moment} s"),
            }
        }
        // Once more ends it at once, whatever it is at.
        let child = start(here, MESH);
        sleep(Duration::from_secs(2));
        interrupt(&child);
        sleep(Duration::from_millis(50));
        interrupt(&child);
        let (code, took) = end(child);
        assert!(took < AT_MOST, "{took:?}");
        assert!(matches!(code, Some(0 | 130)), "{code:?}");
    }

    #[test]
    fn many_atoms_that_move_end_as_soon() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        run_args(
            here,
            &["synth", "faults", "-o", "faults.npy", "--dims", "96,96,96"],
        );
        let mut child = atomesh(here)
            .args("mesh faults.npy -o mesh.vtu --distance 1.5 --optimizer genetic".split(' '))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // To join these many atoms takes longer.
        let said = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut said = said.map(|line| line.unwrap());
        assert!(said.any(|line| line.starts_with("moving atoms")));
        sleep(Duration::from_secs(1));
        interrupt(&child);
        let (code, took) = end(child);
        assert!(took < AT_MOST, "went on for {took:?}");
        assert_eq!((code, made(here)), (Some(130), Vec::new()));
    }

    #[test]
    fn other_verbs_leave_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        for moment in [0.1, 0.4, 0.8, 1.2, 1.6] {
            let child = start(folder.path(), "synth faults -o big.npy --dims 200,200,200");
            sleep(Duration::from_secs_f64(moment));
            // As a user and as a batch system do.
            signal(&child, if moment < 1.0 { "-INT" } else { "-TERM" });
            let (code, took) = end(child);
            assert!(took < AT_MOST, "went on for {took:?} after {moment} s");
            match (code, made(folder.path()).as_slice()) {
                (Some(130), []) => (),
                (Some(0 | 130), [name]) if name == "big.npy" => {
                    std::fs::remove_file(folder.path().join(name)).unwrap();
                }
                other => panic!("{other:?} after {moment} s"),
            }
        }
    }

    /// What a killed process leaves has a temporary name and no owner; what another is just writing is
    /// locked by it.
    #[test]
    fn what_a_killed_process_left_is_removed_by_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let [dead, alive] =
            ["dead", "alive"].map(|name| at(&format!(".{name}.vtu.aBc123.atomesh-unfinished")));
        for path in [&dead, &alive, &at(".mine"), &at("dead.vtu")] {
            std::fs::write(path, "x").unwrap();
        }
        let owner = std::fs::File::open(&alive).unwrap();
        owner.lock().unwrap();
        run_args(
            folder.path(),
            &["synth", "sphere", "-o", "a.npy", "--dims", "9,9,9"],
        );
        assert!(
            !dead.exists() && alive.exists() && at(".mine").exists() && at("dead.vtu").exists()
        );
        drop(owner);
        run_args(
            folder.path(),
            &["synth", "sphere", "-o", "a.npy", "--dims", "9,9,9"],
        );
        assert!(!alive.exists());
    }
}
