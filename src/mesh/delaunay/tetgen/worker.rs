//! TetGen in processes of its own: `atomesh-tetgen` of `tetgen-sys`, or any program that [serves](serve).
//!
//! For several parts of one triangulation at once; for a program that cannot hold TetGen itself (a shared library such as Python's extension modules
//! hides the symbol with which the shim makes TetGen's errors harmless), or that wants to live on
//! whatever becomes of TetGen. The answer is the same to the byte, and calls do not wait for one another.
//! What goes over the pipes is told in `tetgen-sys/cpp/worker.cpp`.

use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use super::{TetgenOutput, delaunay_error};
use crate::error::Result;

/// Hundredths of a second in which a worker that has hung up may end by itself.
const GRACE_CENTISECONDS: usize = 50;

/// A program that runs TetGen.
pub(super) struct WorkerProgram {
    path: PathBuf,
    arguments: &'static [&'static str],
    /// For all, or only for parts of large ones.
    runs_all: bool,
}

static PROGRAM: OnceLock<WorkerProgram> = OnceLock::new();

/// The largest memory of this process and its workers together, in MB, where the system tells.
static PEAK_MB: AtomicU64 = AtomicU64::new(0);

/// From now on TetGen runs in processes of this program, `atomesh-tetgen`, instead of in this process; large
/// triangulations in several at once. The first call of this or [`share_with_workers`] counts.
pub fn run_in_worker(program: impl Into<PathBuf>) {
    PROGRAM.get_or_init(|| WorkerProgram {
        path: program.into(),
        arguments: &[],
        runs_all: true,
    });
}

/// From now on large triangulations are made in parts, by as many processes of this program at once as there
/// are threads; with these arguments it has to [`serve`].
pub fn share_with_workers(program: impl Into<PathBuf>, arguments: &'static [&'static str]) {
    PROGRAM.get_or_init(|| WorkerProgram {
        path: program.into(),
        arguments,
        runs_all: false,
    });
}

/// The program to run, if it shall not be this one.
pub(super) fn program_for_all() -> Option<&'static WorkerProgram> {
    PROGRAM.get().filter(|program| program.runs_all)
}

/// The program for parts.
pub(super) fn program_for_parts() -> Option<&'static WorkerProgram> {
    PROGRAM.get()
}

/// Largest memory so far of this process together with its workers, in MB (10^6 bytes); 0 without any.
pub fn peak_mb() -> f64 {
    PEAK_MB.load(Relaxed) as f64
}

/// Reads points from standard input and writes their tetrahedra on standard output, as `atomesh-tetgen` does;
/// gives the exit code.
#[allow(unsafe_code)]
pub fn serve() -> u8 {
    // SAFETY: touches nothing but its own memory, standard input and output; the one TetGen that runs.
    unsafe { tetgen_sys::tetgen_shim_serve() as u8 }
}

/// What TetGen, run by `program`, answers.
///
/// # Errors
/// [`Error::Delaunay`](crate::Error::Delaunay) if it cannot be run, or ends without an answer: crashes,
/// is killed, hangs up. It never outlives the call.
pub(super) fn run_program(
    program: &WorkerProgram,
    points: &[[f64; 3]],
    with_neighbors: bool,
) -> Result<TetgenOutput> {
    let remedy = "install atomesh again";
    let spawned = Command::new(&program.path)
        .args(program.arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let child = spawned.map_err(|e| {
        let problem = format!(
            "TetGen's program {} cannot be run: {e}",
            program.path.display()
        );
        delaunay_error(problem, remedy)
    })?;
    let mut worker = Worker(child);
    let (Some(input), Some(output)) = (worker.0.stdin.take(), worker.0.stdout.take()) else {
        return Err(delaunay_error("TetGen's program has no pipes", remedy));
    };
    let pid = worker.0.id();
    send_points(input, points, with_neighbors)
        .and_then(|()| receive_tets(output, with_neighbors, || record_memory(pid)))
        .map_err(|error| worker.failure(&error))
}

/// Ended, if it has not ended by itself, when dropped.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        // Both fail, as they may, where it has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Worker {
    /// Why there is no answer.
    fn failure(&mut self, error: &io::Error) -> crate::Error {
        // Having lost its pipes it is about to end, if it has not.
        let mut ended = None;
        for _ in 0..GRACE_CENTISECONDS {
            ended = self.0.try_wait().ok().flatten();
            if ended.is_some() {
                break;
            }
            thread::sleep(Duration::from_millis(10));
        }
        let ended = match ended {
            Some(status) => status.to_string(),
            None => "it hung up".to_string(),
        };
        delaunay_error(
            format!("TetGen's program ended without an answer ({ended}; {error})"),
            "look whether the machine is out of memory; use a larger nominal distance; \
             if it happens again, please report it with the image and the options",
        )
    }
}

/// Hands over the points; who gives `input` away closes it.
fn send_points(input: ChildStdin, points: &[[f64; 3]], with_neighbors: bool) -> io::Result<()> {
    let mut input = BufWriter::with_capacity(1 << 16, input);
    input.write_all(&(points.len() as u64).to_ne_bytes())?;
    input.write_all(&u64::from(with_neighbors).to_ne_bytes())?;
    for coordinate in points.as_flattened() {
        input.write_all(&coordinate.to_ne_bytes())?;
    }
    input.flush()
}

/// What the worker answers; `at_work` while it still has all that it needed.
fn receive_tets(
    output: ChildStdout,
    with_neighbors: bool,
    at_work: impl FnOnce() -> WorkerMemory,
) -> io::Result<TetgenOutput> {
    let mut output = BufReader::with_capacity(1 << 16, output);
    let mut number = [0; 8];
    output.read_exact(&mut number)?;
    let status = i64::from_ne_bytes(number);
    output.read_exact(&mut number)?;
    let count = u64::from_ne_bytes(number);
    let _until_it_is_read = at_work();
    let tets = read_tets(&mut output, count)?;
    let neighbors = match with_neighbors {
        true => read_tets(&mut output, count)?,
        false => Vec::new(),
    };
    Ok(TetgenOutput {
        status,
        tets,
        neighbors,
    })
}

/// Memory of a worker that is at work, in MB.
struct WorkerMemory(u64);

/// Of all workers at work.
static WORKERS_MB: AtomicU64 = AtomicU64::new(0);

/// Takes down what a worker and all others have at its end, with this process.
fn record_memory(worker: u32) -> WorkerMemory {
    let megabytes = |process: &str, row: &str| {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix(row));
        let kilobytes = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
        kilobytes.unwrap_or(0) * 1024 / 1_000_000
    };
    let memory = WorkerMemory(megabytes(&worker.to_string(), "VmHWM:"));
    let workers = WORKERS_MB.fetch_add(memory.0, Relaxed) + memory.0;
    PEAK_MB.fetch_max(workers + megabytes("self", "VmRSS:"), Relaxed);
    memory
}

impl Drop for WorkerMemory {
    fn drop(&mut self) {
        WORKERS_MB.fetch_sub(self.0, Relaxed);
    }
}

fn read_tets(output: &mut impl Read, count: u64) -> io::Result<Vec<[u32; 4]>> {
    let mut four = [0; 16];
    let read = |_| {
        output.read_exact(&mut four)?;
        let (numbers, _) = four.as_chunks::<4>();
        Ok(std::array::from_fn(|k| u32::from_ne_bytes(numbers[k])))
    };
    (0..count).map(read).collect()
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;
    use std::time::Instant;

    use super::*;
    use crate::geometry::random::Random;

    const WORKER_PATH: &str = env!("ATOMESH_TETGEN_WORKER");

    fn program(path: impl Into<PathBuf>) -> WorkerProgram {
        let (path, arguments, for_all) = (path.into(), &[][..], true);
        WorkerProgram {
            path,
            arguments,
            runs_all: for_all,
        }
    }

    fn scattered(count: usize) -> Vec<[f64; 3]> {
        let mut random = Random::new(5);
        (0..count)
            .map(|_| std::array::from_fn(|_| 40.0 * random.draw()))
            .collect()
    }

    /// A program that does what the script says.
    fn script(folder: &Path, text: &str) -> PathBuf {
        let path = folder.join("worker");
        std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn error_message(program: &Path, points: &[[f64; 3]]) -> String {
        match run_program(&self::program(program), points, true) {
            Ok(_) => panic!("{} answered", program.display()),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn a_worker_answers_as_this_process_does() {
        let points = scattered(3000);
        for with_neighbors in [false, true] {
            let own = super::super::ffi::run(&points, with_neighbors);
            let other = run_program(&program(WORKER_PATH), &points, with_neighbors).unwrap();
            assert_eq!((own.status, own.tets), (other.status, other.tets));
            assert_eq!(own.neighbors, other.neighbors);
            assert_eq!(other.neighbors.is_empty(), !with_neighbors);
        }
    }

    /// The error that would crash a program in which TetGen's own `terminatetetgen` is called.
    #[test]
    fn a_worker_reports_tetgens_errors() {
        let flat: Vec<[f64; 3]> = (0..400)
            .map(|i| (f64::from(i % 20), f64::from(i / 20)))
            .map(|(x, y)| [x, y, x + 2.0 * y])
            .collect();
        let answer = run_program(&program(WORKER_PATH), &flat, true).unwrap();
        assert_eq!(answer.status, i64::from(tetgen_sys::TETGEN_SHIM_BAD_INPUT));
        assert!(answer.tets.is_empty());
    }

    #[test]
    fn a_worker_that_does_not_answer_is_one_error() {
        let folder = tempfile::tempdir().unwrap();
        let points = scattered(5000);
        let ways = [
            ("kill -9 $$", "signal: 9"),
            ("exit 3", "exit status: 3"),
            ("cat >/dev/null; kill -SEGV $$", "signal: 11"),
            ("exec 0<&- 1>&-; exit 0", "exit status: 0"),
            ("exec 0<&- 1>&- sleep 1000", "it hung up"),
            ("cat >/dev/null; printf 12345678123", "failed to fill"),
        ];
        for (text, says) in ways {
            let error = error_message(&script(folder.path(), text), &points);
            assert!(error.contains("without an answer"), "{text}: {error}");
            assert!(error.contains(says), "{text}: {error}");
        }
        let error = error_message(&folder.path().join("absent"), &points);
        assert!(error.contains("cannot be run"), "{error}");
    }

    #[test]
    fn a_worker_that_is_killed_at_work_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let pid = folder.path().join("pid");
        let text = format!(
            "echo $$ >{0}.part; mv {0}.part {0}; exec {WORKER_PATH}",
            pid.display()
        );
        let program = script(folder.path(), &text);
        let points = scattered(400_000);
        let number = thread::scope(|scope| {
            let asking = scope.spawn(|| error_message(&program, &points));
            let begun = Instant::now();
            while !pid.exists() {
                assert!(begun.elapsed() < Duration::from_secs(30), "no worker");
                thread::sleep(Duration::from_millis(5));
            }
            thread::sleep(Duration::from_millis(100));
            let number = std::fs::read_to_string(&pid).unwrap().trim().to_string();
            let killed = Command::new("kill").args(["-9", &number]).status().unwrap();
            assert!(killed.success(), "it was not at work any more");
            let error = asking.join().unwrap();
            assert!(error.contains("signal: 9"), "{error}");
            number
        });
        // Nor a zombie.
        assert!(!Path::new("/proc").join(number).exists());
    }
}
