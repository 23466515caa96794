//! Runs TetGen in separate worker processes: `atomesh-tetgen` of `tetgen-sys`, or any program that
//! calls [`serve`].
//!
//! Workers serve three purposes. They compute several parts of one triangulation at the same time.
//! They help programs that cannot contain TetGen themselves: a shared library such as a Python
//! extension module hides the symbol with which the shim makes TetGen's errors harmless. And they
//! protect the calling program from crashes of TetGen.
//!
//! The result is identical to the byte, and calls do not wait for one another. The protocol on the
//! pipes is described in `tetgen-sys/cpp/worker.cpp`.

use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use super::{TetgenOutput, delaunay_error};
use crate::error::Result;

/// Time in hundredths of a second that a worker gets to end by itself after it has closed its
/// pipes.
const GRACE_CENTISECONDS: usize = 50;

/// A program that runs TetGen.
pub(super) struct WorkerProgram {
    path: PathBuf,
    arguments: &'static [&'static str],
    /// `true` if it runs all triangulations, `false` if it runs only the parts of large ones.
    runs_all: bool,
}

static PROGRAM: OnceLock<WorkerProgram> = OnceLock::new();

/// Largest memory so far of this process and its workers together, in MB, on systems that report
/// it.
static PEAK_MB: AtomicU64 = AtomicU64::new(0);

/// Makes TetGen run in processes of this program, `atomesh-tetgen`, instead of in this process, and
/// large triangulations in several processes at the same time. Only the first call of this function
/// or of [`share_with_workers`] has an effect.
pub fn run_in_worker(program: impl Into<PathBuf>) {
    PROGRAM.get_or_init(|| WorkerProgram {
        path: program.into(),
        arguments: &[],
        runs_all: true,
    });
}

/// Makes large triangulations run in parts, in as many processes of this program at the same time
/// as there are threads. With these arguments the program must call [`serve`].
pub fn share_with_workers(program: impl Into<PathBuf>, arguments: &'static [&'static str]) {
    PROGRAM.get_or_init(|| WorkerProgram {
        path: program.into(),
        arguments,
        runs_all: false,
    });
}

/// Returns the worker program, if all triangulations should run in it.
pub(super) fn program_for_all() -> Option<&'static WorkerProgram> {
    PROGRAM.get().filter(|program| program.runs_all)
}

/// Returns the worker program for parts of large triangulations.
pub(super) fn program_for_parts() -> Option<&'static WorkerProgram> {
    PROGRAM.get()
}

/// Returns the largest memory so far of this process together with its workers, in MB (10^6 bytes);
/// 0 if no worker has run.
pub fn peak_mb() -> f64 {
    PEAK_MB.load(Relaxed) as f64
}

/// Reads points from standard input and writes their tetrahedra to standard output, as
/// `atomesh-tetgen` does. Returns the exit code.
#[allow(unsafe_code)]
pub fn serve() -> u8 {
    // SAFETY: the function uses only its own memory, standard input and standard output, and it is
    // the only TetGen that runs in this process.
    unsafe { tetgen_sys::tetgen_shim_serve() as u8 }
}

/// Returns TetGen's output, computed by a process of `program`.
///
/// # Errors
/// Returns [`Error::Delaunay`](crate::Error::Delaunay) if the program cannot be run, or if it ends
/// without output: it crashes, is killed or closes its pipes. The process never outlives the call.
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

/// A worker process. It is killed when dropped, unless it has ended by itself.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        // Both calls fail if the process has ended already, which is no problem.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Worker {
    /// Returns the error that explains why there is no output.
    fn failure(&mut self, error: &io::Error) -> crate::Error {
        // The worker has lost its pipes: it has ended, or it will end soon.
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
            None => "it closed its pipes".to_string(),
        };
        delaunay_error(
            format!("TetGen's program ended without an answer ({ended}; {error})"),
            "look whether the machine is out of memory; use a larger nominal distance; \
             if it happens again, please report it with the image and the options",
        )
    }
}

/// Sends the points to the worker. Dropping `input` closes the pipe.
fn send_points(input: ChildStdin, points: &[[f64; 3]], with_neighbors: bool) -> io::Result<()> {
    let mut input = BufWriter::with_capacity(1 << 16, input);
    input.write_all(&(points.len() as u64).to_ne_bytes())?;
    input.write_all(&u64::from(with_neighbors).to_ne_bytes())?;
    for coordinate in points.as_flattened() {
        input.write_all(&coordinate.to_ne_bytes())?;
    }
    input.flush()
}

/// Reads the worker's output. Calls `record_memory` while the worker still holds all its memory.
fn receive_tets(
    output: ChildStdout,
    with_neighbors: bool,
    record_memory: impl FnOnce() -> WorkerMemory,
) -> io::Result<TetgenOutput> {
    let mut output = BufReader::with_capacity(1 << 16, output);
    let mut number = [0; 8];
    output.read_exact(&mut number)?;
    let status = i64::from_ne_bytes(number);
    output.read_exact(&mut number)?;
    let count = u64::from_ne_bytes(number);
    let _memory = record_memory();
    let tets = read_tets(&mut output, count)?;
    let neighbors = if with_neighbors {
        read_tets(&mut output, count)?
    } else {
        Vec::new()
    };
    Ok(TetgenOutput {
        status,
        tets,
        neighbors,
    })
}

/// Memory of a running worker, in MB.
struct WorkerMemory(u64);

/// Memory of all running workers, in MB.
static WORKERS_MB: AtomicU64 = AtomicU64::new(0);

/// Records the peak memory of a worker together with that of all other running workers and this
/// process.
fn record_memory(worker: u32) -> WorkerMemory {
    let megabytes = |process: &str, row: &str| {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix(row));
        let kilobytes = line.and_then(|value| value.split_whitespace().next()?.parse::<u64>().ok());
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
    let mut buffer = [0; 16];
    let read_tet = |_| {
        output.read_exact(&mut buffer)?;
        let (numbers, _) = buffer.as_chunks::<4>();
        Ok(std::array::from_fn(|k| u32::from_ne_bytes(numbers[k])))
    };
    (0..count).map(read_tet).collect()
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
        let (path, arguments, runs_all) = (path.into(), &[][..], true);
        WorkerProgram {
            path,
            arguments,
            runs_all,
        }
    }

    fn scattered(count: usize) -> Vec<[f64; 3]> {
        let mut random = Random::new(5);
        (0..count)
            .map(|_| std::array::from_fn(|_| 40.0 * random.draw()))
            .collect()
    }

    /// Creates a program that runs the shell script `text`.
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
    fn a_worker_gives_the_result_of_this_process() {
        let points = scattered(3000);
        for with_neighbors in [false, true] {
            let in_process = super::super::ffi::run(&points, with_neighbors);
            let in_worker = run_program(&program(WORKER_PATH), &points, with_neighbors).unwrap();
            assert_eq!(
                (in_process.status, in_process.tets),
                (in_worker.status, in_worker.tets)
            );
            assert_eq!(in_process.neighbors, in_worker.neighbors);
            assert_eq!(in_worker.neighbors.is_empty(), !with_neighbors);
        }
    }

    /// This error would crash a program in which TetGen's own `terminatetetgen` is called.
    #[test]
    fn a_worker_reports_tetgens_errors() {
        let flat: Vec<[f64; 3]> = (0..400)
            .map(|i| (f64::from(i % 20), f64::from(i / 20)))
            .map(|(x, y)| [x, y, x + 2.0 * y])
            .collect();
        let output = run_program(&program(WORKER_PATH), &flat, true).unwrap();
        assert_eq!(output.status, i64::from(tetgen_sys::TETGEN_SHIM_BAD_INPUT));
        assert!(output.tets.is_empty());
    }

    #[test]
    fn a_worker_without_output_gives_one_error() {
        let folder = tempfile::tempdir().unwrap();
        let points = scattered(5000);
        let cases = [
            ("kill -9 $$", "signal: 9"),
            ("exit 3", "exit status: 3"),
            ("cat >/dev/null; kill -SEGV $$", "signal: 11"),
            ("exec 0<&- 1>&-; exit 0", "exit status: 0"),
            ("exec 0<&- 1>&- sleep 1000", "it closed its pipes"),
            ("cat >/dev/null; printf 12345678123", "failed to fill"),
        ];
        for (text, expected) in cases {
            let error = error_message(&script(folder.path(), text), &points);
            assert!(error.contains("without an answer"), "{text}: {error}");
            assert!(error.contains(expected), "{text}: {error}");
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
            let caller = scope.spawn(|| error_message(&program, &points));
            let start = Instant::now();
            while !pid.exists() {
                assert!(start.elapsed() < Duration::from_secs(30), "no worker");
                thread::sleep(Duration::from_millis(5));
            }
            thread::sleep(Duration::from_millis(100));
            let number = std::fs::read_to_string(&pid).unwrap().trim().to_string();
            let killed = Command::new("kill").args(["-9", &number]).status().unwrap();
            assert!(killed.success(), "it was not at work any more");
            let error = caller.join().unwrap();
            assert!(error.contains("signal: 9"), "{error}");
            number
        });
        // The killed worker does not remain as a zombie process.
        assert!(!Path::new("/proc").join(number).exists());
    }
}
