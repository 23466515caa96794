//! The Delaunay triangulation of points in space, by TetGen (Si 2015, "TetGen, a Delaunay-based
//! quality tetrahedral mesh generator"): incremental insertion in a biased random, then Hilbert
//! order; exact predicates; ties of cospherical points broken by symbolic perturbation.
//!
//! What TetGen does badly on bad points is kept from it: everything it would assert on is checked
//! before, and its errors come back as [`Error::Delaunay`](crate::Error::Delaunay).

mod global_points;
#[cfg(feature = "tetgen")]
mod parts;
#[cfg(feature = "tetgen")]
mod worker;

#[cfg(feature = "tetgen")]
use crate::comm;
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

/// The neighbour beyond a face of the hull.
pub const OUTSIDE: u32 = u32::MAX;

/// So many points are triangulated in parts, if there are workers to do so, and come in an order that does
/// not depend on it.
#[cfg(feature = "tetgen")]
const MIN_PARALLEL_POINTS: usize = 40_000;
/// A part has at most so many points, for a run takes some 700 bytes for each; of smaller parts halos are a larger share.
#[cfg(feature = "tetgen")]
const MAX_PART_POINTS: usize = 600_000;
/// A part has at least so many points.
#[cfg(feature = "tetgen")]
const MIN_PART_POINTS: usize = 20_000;

/// A Delaunay triangulation and its adjacency.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Delaunay {
    /// Nodes are the given points in the given order; tetrahedra fill their convex hull.
    pub mesh: TetMesh,
    /// `neighbors[t][k]` shares with tetrahedron `t` the face opposite its node `k`;
    /// [`OUTSIDE`] on the hull.
    pub neighbors: Vec<[u32; 4]>,
}

/// The Delaunay triangulation of `points`.
///
/// Nodes are all points in their order, every one used; tetrahedra are positively oriented (see
/// [`crate::mesh`]), never flat, and fill the convex hull exactly. One call at a time runs in a
/// process; others wait, unless [`run_in_worker`](super::run_in_worker) gives each a process of its own.
///
/// # Errors
/// [`Error::Delaunay`](crate::Error::Delaunay) for fewer than four points, a coordinate that is
/// not finite, points all in one plane, two points at one place (both are named), or when built
/// without the feature `tetgen`.
pub fn delaunay(points: &[[f64; 3]]) -> Result<TetMesh> {
    Ok(run(points, false)?.mesh)
}

/// [`delaunay`] with the adjacency, which TetGen hands over for about a tenth of its time.
///
/// # Errors
/// As [`delaunay`].
pub fn delaunay_with_neighbors(points: &[[f64; 3]]) -> Result<Delaunay> {
    run(points, true)
}

/// Some of the tetrahedra of a [`Delaunay`] triangulation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct IntervalTets {
    /// By their nodes.
    pub tets: Vec<[u32; 4]>,
    /// What is beyond each face; [`OUTSIDE`] for tetrahedra that are not among these, too.
    pub neighbors: Vec<[u32; 4]>,
}

/// Some of the tetrahedra of [`delaunay_with_neighbors`], in the same order: space is cut across an axis at `cuts`,
/// and a tetrahedron is of the stretch that its first point, by number, is in. Neighbours that are of other
/// stretches than these are [`OUTSIDE`]. None if only the whole can tell.
///
/// No more than these stretches and a little round them is triangulated: of all points, the `whole`, those farther from
/// them than its [halo](GlobalPoints::max_halo) need not be there.
///
/// # Errors
/// As [`delaunay`].
#[cfg(feature = "tetgen")]
pub fn delaunay_in_intervals(
    points: &[[f64; 3]],
    whole: GlobalPoints,
    axis: usize,
    cuts: &[f64],
    stretches: std::ops::Range<usize>,
) -> Result<Option<IntervalTets>> {
    if stretches.is_empty() {
        return Ok(Some(IntervalTets::default()));
    }
    check_points(points)?;
    let Some(program) = worker::program_for_parts().filter(|_| whole.count >= MIN_PARALLEL_POINTS)
    else {
        return Ok(None);
    };
    let run = |part: &[[f64; 3]]| worker::run_program(program, part, true);
    let at_once = rayon::current_num_threads();
    let limits = [MIN_PART_POINTS, MAX_PART_POINTS];
    let some =
        parts::tets_in_intervals(points, whole, axis, cuts, stretches, at_once, limits, &run)?;
    Ok(some.map(|mut answer| {
        parts::sort_canonical(points.len(), &mut answer);
        IntervalTets {
            tets: answer.tets,
            neighbors: answer.neighbors,
        }
    }))
}

/// The same where there is no TetGen.
///
/// # Errors
/// Always.
#[cfg(not(feature = "tetgen"))]
pub fn delaunay_of_stretches(
    points: &[[f64; 3]],
    _: GlobalPoints,
    _: usize,
    _: &[f64],
    _: std::ops::Range<usize>,
) -> Result<Option<IntervalTets>> {
    run_tetgen(points, true).map(|_| None)
}

fn run(points: &[[f64; 3]], with_neighbors: bool) -> Result<Delaunay> {
    check_points(points)?;
    let answer = run_tetgen(points, with_neighbors)?;
    check_all_used(points, &answer.tets)?;
    Ok(Delaunay {
        mesh: TetMesh {
            nodes: points.to_vec(),
            tets: answer.tets,
        },
        neighbors: answer.neighbors,
    })
}

fn delaunay_error(problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> crate::Error {
    crate::Error::Delaunay(cause("Delaunay triangulation", problem, remedy))
}

/// What TetGen would meet with an assertion, i.e. the end of the process, or with a message on
/// standard output, which is not its to write on.
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

/// Least height of a big tetrahedron among the points, and the length of its longest edge: each
/// node in turn is the one farthest from the point, line and plane of those before. Thickness at
/// the level of rounding means points in one plane.
fn thickness_and_length(points: &[[f64; 3]]) -> (f64, f64) {
    let farthest = |distance2: &(dyn Fn([f64; 3]) -> f64 + Sync)| {
        let none = || (0.0, [0.0; 3]);
        let later = |best: (f64, [f64; 3]), other: (f64, [f64; 3])| {
            // Of several the first.
            if other.0 > best.0 { other } else { best }
        };
        let farther = |best, p: &[f64; 3]| {
            let q = std::array::from_fn(|k| p[k] - points[0][k]);
            later(best, (distance2(q), q))
        };
        points.par_iter().fold(none, farther).reduce(none, later)
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

/// TetGen leaves out a point that coincides, or nearly so, with another: names such points.
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
    let others = match unused.count() {
        0 => String::new(),
        n => format!(" (and {n} more points like it)"),
    };
    Err(delaunay_error(
        format!(
            "points {first} and {nearest} are {distance:e} apart, at [{}, {}, {}]{others}",
            p[0], p[1], p[2]
        ),
        "keep one of the two",
    ))
}

/// What TetGen answers.
#[cfg_attr(not(feature = "tetgen"), allow(dead_code))]
struct TetgenOutput {
    /// `TETGEN_SHIM_OK`, or why there is nothing else.
    status: i64,
    tets: Vec<[u32; 4]>,
    /// Empty if not asked for.
    neighbors: Vec<[u32; 4]>,
}

#[cfg(feature = "tetgen")]
codec_fields! {
    TetgenOutput as TetgenOutput { status, tets, neighbors }
}

#[cfg(not(feature = "tetgen"))]
fn tetrahedra(_: &[[f64; 3]], _: bool) -> Result<TetgenOutput> {
    Err(delaunay_error(
        "this atomesh was built without TetGen",
        "install libtet1.5-dev and libclang-dev and build with the feature `tetgen` (on by default)",
    ))
}

/// Tetrahedra and, when asked for, neighbours; `points` have passed `check_points`.
#[cfg(feature = "tetgen")]
fn run_tetgen(points: &[[f64; 3]], with_neighbors: bool) -> Result<TetgenOutput> {
    use tetgen_sys as sys;
    let one_run = |points: &[[f64; 3]], with_neighbors| match worker::program_for_all() {
        Some(program) => worker::run_program(program, points, with_neighbors),
        None => Ok(ffi::run(points, with_neighbors)),
    };
    let large = points.len() >= MIN_PARALLEL_POINTS;
    let at_once = rayon::current_num_threads();
    let at_all = match large {
        true => comm::broadcast_from_root("processors", || Ok(at_once * comm::size()))?,
        false => 1,
    };
    let at_all = at_all.min(points.len() / MIN_PART_POINTS).max(1);
    // In rounds, in each of which all are at work.
    let count = (points.len().div_ceil(MAX_PART_POINTS)).next_multiple_of(at_all);
    let in_parts = match worker::program_for_parts() {
        Some(program) if large && at_all > 1 => {
            parts::triangulate_in_parts(points, count, at_once, &|part| {
                worker::run_program(program, part, true)
            })?
        }
        _ => None,
    };
    let mut answer = match in_parts {
        Some(answer) => answer,
        None => one_run(points, with_neighbors)?,
    };
    if !with_neighbors {
        answer.neighbors = Vec::new();
    }
    match answer.status as sys::tetgen_shim_status {
        sys::TETGEN_SHIM_OK => {}
        sys::TETGEN_SHIM_BAD_INPUT => {
            return Err(delaunay_error(
                "TetGen finds all points in one plane or on one line, or nearly so",
                "give points that span a volume",
            ));
        }
        sys::TETGEN_SHIM_OUT_OF_MEMORY => {
            return Err(delaunay_error(
                format!("{} points do not fit in memory", points.len()),
                "use a larger nominal distance",
            ));
        }
        other => {
            return Err(delaunay_error(
                format!("TetGen stopped with its error {other}"),
                "please report it with the image and the options",
            ));
        }
    }
    // TetGen's tetrahedra point to nodes; a stray index would be undefined behaviour later on.
    let stray = |tet: &[u32; 4]| tet.iter().any(|&node| node as usize >= points.len());
    if answer.tets.par_iter().any(stray) {
        return Err(delaunay_error(
            "TetGen returned a node that was not given",
            "please report it",
        ));
    }
    if large {
        parts::sort_canonical(points.len(), &mut answer);
    }
    Ok(answer)
}

#[cfg(feature = "tetgen")]
#[allow(unsafe_code)]
mod ffi {
    use std::sync::{Mutex, PoisonError};

    use tetgen_sys as sys;

    use super::TetgenOutput;

    /// TetGen is not re-entrant: `exactinit` writes the error bounds of its predicates, made for
    /// the extent of the points at hand, into globals. A second run at the same time would use
    /// the wrong bounds, and be wrong without notice. Hence one run at a time in a process.
    static TETGEN_LOCK: Mutex<()> = Mutex::new(());

    /// Owns what the C++ side allocated and gives it back.
    struct OwnedMesh(sys::tetgen_shim_mesh);

    impl Drop for OwnedMesh {
        fn drop(&mut self) {
            // SAFETY: the mesh was filled by tetgen_shim_run (or is empty) and is freed only here.
            unsafe { sys::tetgen_shim_free(&raw mut self.0) }
        }
    }

    impl OwnedMesh {
        /// A copy of one of the mesh's arrays, four numbers a tetrahedron. TetGen's tetrahedra turn
        /// as ours do and its neighbours are numbered as ours; its -1 becomes `OUTSIDE`.
        fn copy_array(&self, array: *const i32) -> Vec<[u32; 4]> {
            if array.is_null() {
                return Vec::new();
            }
            // SAFETY: a non-null array of the mesh holds 4 * count ints and lives as long as self.
            let values = unsafe {
                std::slice::from_raw_parts(array.cast::<[i32; 4]>(), self.0.count as usize)
            };
            values.iter().map(|v| v.map(|i| i as u32)).collect()
        }
    }

    /// TetGen in this process.
    pub fn run(points: &[[f64; 3]], with_neighbors: bool) -> TetgenOutput {
        let mut mesh = OwnedMesh(sys::tetgen_shim_mesh {
            tetrahedra: std::ptr::null_mut(),
            neighbors: std::ptr::null_mut(),
            count: 0,
        });
        // A panic elsewhere cannot leave TetGen half-way: a poisoned lock is as good as new.
        let lock = TETGEN_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: `points` is read only, 3 * len finite doubles of nonzero extent, len >= 4 and
        // below i32::MAX (`check_points`); the switches are a constant that ends with zero; the lock
        // is held. The shim catches every exception.
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
    fn says_what_is_missing() {
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let text = super::delaunay(&points).unwrap_err().to_string();
        assert!(
            text.contains("without TetGen") && text.contains("libtet1.5-dev"),
            "{text}"
        );
    }
}
