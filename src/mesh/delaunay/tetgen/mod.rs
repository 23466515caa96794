//! The Delaunay triangulation of points in 3-D, by TetGen (Si 2015, "TetGen, a Delaunay-based
//! quality tetrahedral mesh generator"). TetGen inserts points incrementally, in a biased random
//! and then Hilbert order; its predicates are exact, and ties of cospherical points are broken by
//! symbolic perturbation.
//!
//! Input that TetGen cannot handle is rejected before the call: all conditions that would end in an
//! assertion are checked first. TetGen's own errors are returned as
//! [`Error::Delaunay`](crate::Error::Delaunay).

mod global_points;
#[cfg(feature = "tetgen")]
mod parts;
#[cfg(feature = "tetgen")]
mod worker;

use crate::comm::{Comm, SelfComm};
use crate::error::{Result, cause};
#[cfg(feature = "tetgen")]
use crate::files::codec::codec_fields;
use crate::geometry::{cross, dot};
use crate::mesh::TetMesh;
use crate::parallel::prelude::*;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

pub use global_points::GlobalPoints;
#[cfg(feature = "tetgen")]
pub use worker::{peak_mb, run_in_worker, serve, share_with_workers};

/// Place of this module's errors.
const PLACE: &str = "Delaunay triangulation";

/// Stands for the outside, beyond a face of the hull.
pub const OUTSIDE: u32 = u32::MAX;

/// Smallest number of points that are triangulated in parts, if there are workers. From this number
/// on the order of the tetrahedra is canonical, so that it does not depend on the number of
/// workers.
#[cfg(feature = "tetgen")]
const MIN_PARALLEL_POINTS: usize = 40_000;
/// Largest number of points of a part. A run takes some 700 bytes for each point; in smaller parts
/// halos are a larger fraction.
#[cfg(feature = "tetgen")]
const MAX_PART_POINTS: usize = 600_000;
/// Smallest number of points of a part.
#[cfg(feature = "tetgen")]
const MIN_PART_POINTS: usize = 20_000;

/// A Delaunay triangulation and its adjacency.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Delaunay {
    /// The points in their order as nodes, and the tetrahedra that fill their convex hull.
    pub mesh: TetMesh,
    /// `neighbors[t][k]` shares with tetrahedron `t` the face opposite its node `k`; [`OUTSIDE`] on
    /// the hull.
    pub neighbors: Vec<[u32; 4]>,
}

/// Returns the Delaunay triangulation of `points`.
///
/// Nodes are all points in their order, and every one is used. Tetrahedra are positively oriented
/// (see [`crate::mesh`](mod@crate::mesh)), never flat, and fill the convex hull exactly. Only one call at a time
/// runs in a process; others wait, unless [`run_in_worker`](super::run_in_worker) gives each call a
/// process of its own.
///
/// # Errors
/// Returns [`Error::Delaunay`](crate::Error::Delaunay) for fewer than four points, for a coordinate
/// that is not finite, for points in one plane, for coinciding points (the message names both), or
/// without the feature `tetgen`.
pub fn delaunay(points: &[[f64; 3]]) -> Result<TetMesh> {
    distributed_delaunay(points, &SelfComm)
}

/// Returns the [`delaunay`] triangulation on all ranks of `comm`, which have the same points and
/// share the work.
///
/// # Errors
/// Returns the errors of [`delaunay`], on whichever rank.
pub(crate) fn distributed_delaunay(points: &[[f64; 3]], comm: &dyn Comm) -> Result<TetMesh> {
    Ok(run(points, false, comm)?.mesh)
}

/// Returns the [`delaunay`] triangulation with its adjacency, which takes about a tenth more time.
///
/// # Errors
/// Returns the errors of [`delaunay`].
pub fn delaunay_with_neighbors(points: &[[f64; 3]]) -> Result<Delaunay> {
    distributed_delaunay_with_neighbors(points, &SelfComm)
}

/// Returns the triangulation of [`distributed_delaunay`] with its adjacency.
///
/// # Errors
/// Returns the errors of [`distributed_delaunay`].
pub(crate) fn distributed_delaunay_with_neighbors(
    points: &[[f64; 3]],
    comm: &dyn Comm,
) -> Result<Delaunay> {
    run(points, true, comm)
}

/// Some of the tetrahedra of a [`Delaunay`] triangulation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct IntervalTets {
    /// Node numbers of each tetrahedron.
    pub tets: Vec<[u32; 4]>,
    /// Index of the tetrahedron beyond each face; [`OUTSIDE`] also if that tetrahedron is not in
    /// this list.
    pub neighbors: Vec<[u32; 4]>,
}

/// Returns some of the tetrahedra of [`delaunay_with_neighbors`], in the same order. Space is cut
/// into intervals along an axis at `cuts`. A tetrahedron belongs to the interval of its first point
/// (the one with the lowest number). Returns the tetrahedra of `intervals`; neighbours in other
/// intervals are [`OUTSIDE`]. Returns `None` if only a triangulation of all points can give the
/// result.
///
/// Only the points in these intervals and in a halo round them are triangulated. `global` describes
/// all points; points farther away than its [`max_halo`](GlobalPoints::max_halo) need not be in
/// `points`.
///
/// # Errors
/// Returns the errors of [`delaunay`].
#[cfg(feature = "tetgen")]
pub fn delaunay_in_intervals(
    points: &[[f64; 3]],
    global: GlobalPoints,
    axis: usize,
    cuts: &[f64],
    intervals: std::ops::Range<usize>,
) -> Result<Option<IntervalTets>> {
    if intervals.is_empty() {
        return Ok(Some(IntervalTets::default()));
    }
    check_points(points)?;
    let Some(program) = worker::program_for_parts().filter(|_| global.count >= MIN_PARALLEL_POINTS)
    else {
        return Ok(None);
    };
    let run = |part: &[[f64; 3]]| worker::run_program(program, part, true);
    let worker_count = rayon::current_num_threads();
    let limits = [MIN_PART_POINTS, MAX_PART_POINTS];
    let output = parts::tets_in_intervals(
        points,
        global,
        axis,
        cuts,
        intervals,
        worker_count,
        limits,
        &run,
    )?;
    Ok(output.map(|mut output| {
        parts::sort_canonical(points.len(), &mut output);
        IntervalTets {
            tets: output.tets,
            neighbors: output.neighbors,
        }
    }))
}

/// Returns an error, because this atomesh was built without TetGen.
///
/// # Errors
/// Always returns [`Error::Delaunay`](crate::Error::Delaunay).
#[cfg(not(feature = "tetgen"))]
pub fn delaunay_in_intervals(
    points: &[[f64; 3]],
    _: GlobalPoints,
    _: usize,
    _: &[f64],
    _: std::ops::Range<usize>,
) -> Result<Option<IntervalTets>> {
    run_tetgen(points, true, &SelfComm).map(|_| None)
}

fn run(points: &[[f64; 3]], with_neighbors: bool, comm: &dyn Comm) -> Result<Delaunay> {
    check_points(points)?;
    let output = run_tetgen(points, with_neighbors, comm)?;
    check_all_used(points, &output.tets)?;
    Ok(Delaunay {
        mesh: TetMesh {
            nodes: points.to_vec(),
            tets: output.tets,
        },
        neighbors: output.neighbors,
    })
}

fn delaunay_error(problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> crate::Error {
    crate::Error::Delaunay(cause(PLACE, problem, remedy))
}

/// Checks for input on which TetGen would abort the process by an assertion, or print a message on
/// standard output.
fn check_points(points: &[[f64; 3]]) -> Result<()> {
    if points.len() < 4 {
        return Err(delaunay_error(
            format!("{} points make no tetrahedron", points.len()),
            "give at least four points that are not in one plane",
        ));
    }
    if points.len() > i32::MAX as usize / 8 {
        return Err(delaunay_error(
            format!("{} points are more than TetGen can number", points.len()),
            "use a larger nominal distance",
        ));
    }
    let (mut low, mut high) = (points[0], points[0]);
    for (i, p) in points.iter().enumerate() {
        if !p.iter().all(|c| c.is_finite()) {
            return Err(delaunay_error(
                format!("point {i} is at [{}, {}, {}]", p[0], p[1], p[2]),
                "give finite coordinates",
            ));
        }
        for k in 0..3 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    for k in 0..3 {
        let extent = high[k] - low[k];
        if !(extent > 0.0 && extent.is_finite()) {
            return Err(delaunay_error(
                format!(
                    "the points extend over {extent} along {} (from {} to {})",
                    ["x", "y", "z"][k],
                    low[k],
                    high[k]
                ),
                "give points that span a volume",
            ));
        }
    }
    let largest = low
        .iter()
        .chain(&high)
        .fold(0.0, |m: f64, c| m.max(c.abs()));
    let (thickness, length) = thickness_and_length(points);
    if thickness < 1e-13 * length + 8.0 * f64::EPSILON * largest {
        return Err(delaunay_error(
            format!(
                "the {} points lie in one plane or on one line, to within {thickness:.1e}",
                points.len()
            ),
            "give points that span a volume",
        ));
    }
    Ok(())
}

/// Returns the smallest height of a large tetrahedron among the points, and the length of its
/// longest edge. Each node in turn is the point farthest from the first point, then from the line,
/// then from the plane of those before. A thickness at the level of rounding means that the points
/// lie in one plane.
fn thickness_and_length(points: &[[f64; 3]]) -> (f64, f64) {
    let farthest = |distance2: &(dyn Fn([f64; 3]) -> f64 + Sync)| {
        let no_candidate = || (0.0, [0.0; 3]);
        let farther_of = |best: (f64, [f64; 3]), candidate: (f64, [f64; 3])| {
            // Of several equally far points, the first is taken.
            if candidate.0 > best.0 {
                candidate
            } else {
                best
            }
        };
        let update = |best, p: &[f64; 3]| {
            let q = std::array::from_fn(|k| p[k] - points[0][k]);
            farther_of(best, (distance2(q), q))
        };
        points
            .par_iter()
            .fold(no_candidate, update)
            .reduce(no_candidate, farther_of)
    };
    let (length2, a) = farthest(&|q| dot(q, q));
    let (area2, b) = farthest(&|q| {
        let c = cross(a, q);
        dot(c, c)
    });
    if length2 == 0.0 || area2 == 0.0 {
        return (0.0, length2.sqrt());
    }
    let normal = cross(a, b);
    let (height2, _) = farthest(&|q| dot(normal, q).powi(2));
    let height = (height2 / dot(normal, normal)).sqrt();
    (height.min((area2 / length2).sqrt()), length2.sqrt())
}

/// Returns an error that names two points if TetGen has left out a point because it coincides, or
/// nearly so, with another.
fn check_all_used(points: &[[f64; 3]], tets: &[[u32; 4]]) -> Result<()> {
    let used: Vec<AtomicBool> = points.par_iter().map(|_| AtomicBool::new(false)).collect();
    tets.par_iter().for_each(|tet| {
        let nodes = tet.iter().map(|&node| &used[node as usize]);
        nodes.for_each(|used| used.store(true, Relaxed));
    });
    let mut unused = (0..points.len()).filter(|&i| !used[i].load(Relaxed));
    let Some(first) = unused.next() else {
        return Ok(());
    };
    let p = points[first];
    let squared = |q: &[f64; 3]| (0..3).map(|k| (q[k] - p[k]).powi(2)).sum::<f64>();
    let nearest = (0..points.len())
        .filter(|&i| i != first)
        .min_by(|&i, &j| squared(&points[i]).total_cmp(&squared(&points[j])))
        .unwrap_or(first);
    let distance = squared(&points[nearest]).sqrt();
    let more_points = match unused.count() {
        0 => String::new(),
        n => format!(" (and {n} more points like it)"),
    };
    Err(delaunay_error(
        format!(
            "points {first} and {nearest} are {distance:e} apart, at [{}, {}, {}]{more_points}",
            p[0], p[1], p[2]
        ),
        "keep one of the two",
    ))
}

/// Output of one run of TetGen.
#[cfg_attr(not(feature = "tetgen"), allow(dead_code))]
struct TetgenOutput {
    /// `TETGEN_SHIM_OK`, or the reason why there are no tetrahedra.
    status: i64,
    tets: Vec<[u32; 4]>,
    /// Neighbours of each tetrahedron; empty if they were not requested.
    neighbors: Vec<[u32; 4]>,
}

#[cfg(feature = "tetgen")]
codec_fields! {
    TetgenOutput as TetgenOutput { status, tets, neighbors }
}

#[cfg(not(feature = "tetgen"))]
fn run_tetgen(_: &[[f64; 3]], _: bool, _: &dyn Comm) -> Result<TetgenOutput> {
    Err(delaunay_error(
        "this atomesh was built without TetGen",
        "install libtet1.5-dev and libclang-dev and build with the feature `tetgen` (on by default)",
    ))
}

/// Returns tetrahedra and, if requested, neighbours. `points` have passed `check_points`.
#[cfg(feature = "tetgen")]
fn run_tetgen(points: &[[f64; 3]], with_neighbors: bool, comm: &dyn Comm) -> Result<TetgenOutput> {
    use tetgen_sys as sys;
    let run_once = |points: &[[f64; 3]], with_neighbors| match worker::program_for_all() {
        Some(program) => worker::run_program(program, points, with_neighbors),
        None => Ok(ffi::run(points, with_neighbors)),
    };
    let is_large = points.len() >= MIN_PARALLEL_POINTS;
    let local_workers = rayon::current_num_threads();
    let total_workers = if is_large {
        comm.broadcast_from_root("processors", || Ok(local_workers * comm.size()))?
    } else {
        1
    };
    let total_workers = total_workers.min(points.len() / MIN_PART_POINTS).max(1);
    // The number of parts is a multiple of the number of workers, so that all of them work in every
    // round.
    let count = (points.len().div_ceil(MAX_PART_POINTS)).next_multiple_of(total_workers);
    let combined = match worker::program_for_parts() {
        Some(program) if is_large && total_workers > 1 => {
            let run = |part: &[[f64; 3]]| worker::run_program(program, part, true);
            parts::triangulate_in_parts(points, count, local_workers, comm, &run)?
        }
        _ => None,
    };
    let mut output = match combined {
        Some(answer) => answer,
        None => run_once(points, with_neighbors)?,
    };
    if !with_neighbors {
        output.neighbors = Vec::new();
    }
    match output.status as sys::tetgen_shim_status {
        sys::TETGEN_SHIM_OK => {}
        sys::TETGEN_SHIM_BAD_INPUT => {
            return Err(delaunay_error(
                "TetGen finds all points in one plane or on one line, or nearly so",
                "give points that span a volume",
            ));
        }
        sys::TETGEN_SHIM_OUT_OF_MEMORY => {
            return Err(super::out_of_memory(PLACE, points.len()));
        }
        status => {
            return Err(delaunay_error(
                format!("TetGen stopped with its error {status}"),
                "please report it with the image and the options",
            ));
        }
    }
    // An out-of-range index would make later code panic.
    let is_out_of_range = |tet: &[u32; 4]| tet.iter().any(|&node| node as usize >= points.len());
    if output.tets.par_iter().any(is_out_of_range) {
        return Err(delaunay_error(
            "TetGen returned a node that was not given",
            "please report it",
        ));
    }
    if is_large {
        parts::sort_canonical(points.len(), &mut output);
    }
    Ok(output)
}

#[cfg(feature = "tetgen")]
#[allow(unsafe_code)]
mod ffi {
    use std::sync::{Mutex, PoisonError};

    use tetgen_sys as sys;

    use super::TetgenOutput;

    /// TetGen is not re-entrant: `exactinit` writes the error bounds of its predicates, which
    /// depend on the extent of the points, into global variables. A second run at the same time
    /// would use wrong bounds and could give wrong results without notice. Therefore only one run
    /// at a time is allowed in a process.
    static TETGEN_LOCK: Mutex<()> = Mutex::new(());

    /// Owns the memory that the C++ side allocated, and frees it when dropped.
    struct OwnedMesh(sys::tetgen_shim_mesh);

    impl Drop for OwnedMesh {
        fn drop(&mut self) {
            // SAFETY: the mesh was filled by tetgen_shim_run (or is empty) and is freed only here.
            unsafe { sys::tetgen_shim_free(&raw mut self.0) }
        }
    }

    impl OwnedMesh {
        /// Returns a copy of one of the mesh's arrays, with four numbers for each tetrahedron.
        /// TetGen's orientation and numbering of neighbours equal ours; its -1 becomes `OUTSIDE`.
        fn copy_array(&self, array: *const i32) -> Vec<[u32; 4]> {
            if array.is_null() {
                return Vec::new();
            }
            // SAFETY: a non-null array of the mesh has 4 * count ints and lives as long as self.
            let values = unsafe {
                std::slice::from_raw_parts(array.cast::<[i32; 4]>(), self.0.count as usize)
            };
            values.iter().map(|v| v.map(|i| i as u32)).collect()
        }
    }

    /// Runs TetGen in this process.
    pub fn run(points: &[[f64; 3]], with_neighbors: bool) -> TetgenOutput {
        let mut mesh = OwnedMesh(sys::tetgen_shim_mesh {
            tetrahedra: std::ptr::null_mut(),
            neighbors: std::ptr::null_mut(),
            count: 0,
        });
        // TetGen has no state that a panic could leave inconsistent, so a poisoned lock can be
        // used.
        let lock = TETGEN_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: `points` is only read and has 3 * len finite doubles of nonzero extent, with len
        // >= 4 and below i32::MAX (`check_points`); the switches are a constant that ends with
        // zero; the lock is held. The shim catches every exception.
        let status = unsafe {
            sys::tetgen_shim_run(
                points.as_ptr().cast(),
                points.len() as i32,
                sys::tetgen_shim_switches(i32::from(with_neighbors)),
                &raw mut mesh.0,
            )
        };
        drop(lock);
        TetgenOutput {
            status: i64::from(status),
            tets: mesh.copy_array(mesh.0.tetrahedra),
            neighbors: mesh.copy_array(mesh.0.neighbors),
        }
    }
}

#[cfg(test)]
#[cfg(feature = "tetgen")]
mod tests;

#[cfg(test)]
#[cfg(not(feature = "tetgen"))]
mod tests_without_tetgen {
    #[test]
    fn error_names_the_missing_library() {
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let text = super::delaunay(&points).unwrap_err().to_string();
        assert!(
            text.contains("without TetGen") && text.contains("libtet1.5-dev"),
            "{text}"
        );
    }
}
