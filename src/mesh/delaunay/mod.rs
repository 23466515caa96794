//! Delaunay triangulation of points into tetrahedra or triangles, and validation and refinement of
//! the result.
//!
//! - [`native`]: tetrahedra by our own kernel, which also has weights and adds points one by one
//! - `tetgen`: tetrahedra by TetGen (feature `tetgen`)
//! - `slabs`: one triangulation from those of slabs, by several threads or ranks
//! - `distributed`: the triangulation of all points, by one process or by ranks that share the work
//! - `canonical`: the order of the tetrahedra
//! - `planar`: triangles in the plane, by spade
//! - `cgal`: tetrahedra by CGAL, and its check of any mesh (feature `cgal`)
//! - `exude`: removes slivers by weights
//! - `refine`: adds points until no circumsphere is too large
//! - `bridge`: CGAL's functions for `cgal` and `exude`
//!
//! Where more than four points lie on a sphere, ties are broken by the points' numbers, so that there
//! is only one triangulation of given points. Kernels differ in time, memory and licence, not in
//! their results.

mod bridge;
mod canonical;
pub mod cgal;
mod distributed;
pub(crate) mod exude;
mod global_points;
pub mod native;
pub(crate) mod planar;
pub(crate) mod refine;
mod slabs;
#[cfg(feature = "tetgen")]
mod tetgen;

use std::fmt::{self, Display, Formatter};
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use serde::{Deserialize, Serialize};

use crate::error::{Result, cause};
use crate::files::codec::codec_fields;
pub use crate::geometry::NONE;
use crate::geometry::{cross, dot};
use crate::mesh::TetMesh;
use crate::parallel::prelude::*;

pub use distributed::{delaunay, delaunay_by, delaunay_with_neighbours};
pub(crate) use distributed::{distributed_delaunay, distributed_delaunay_with_neighbours};
pub use global_points::GlobalPoints;
pub use planar::{constrained_plane, delaunay_plane};

/// Place of this module's errors.
const PLACE: &str = "Delaunay triangulation";

/// Smallest number of points that our own kernel triangulates by default, and of those that several
/// threads or ranks share.
const MIN_LARGE: usize = 40_000;
/// Smallest number of points of a slab.
const MIN_SLAB_POINTS: usize = 20_000;

/// Computes Delaunay triangulations in space.
pub trait Kernel: Sync {
    /// Returns the tetrahedra of `points` in no particular order, and the neighbours of each if they
    /// are requested. All coordinates are finite, and the points do not lie in one plane. A point
    /// that coincides with another may be left out.
    ///
    /// # Errors
    /// Returns [`Error::Delaunay`](crate::Error::Delaunay) for points in one plane, or if memory
    /// runs out.
    fn triangulate(&self, points: &[[f64; 3]], with_neighbours: bool) -> Result<DelaunayTets>;
}

/// Programs that compute Delaunay triangulations in space.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DelaunayKernel {
    /// TetGen below 40,000 nodes if it is built in, else atomesh's own kernel
    #[default]
    Auto,
    /// TetGen
    Tetgen,
    /// atomesh's own kernel
    Native,
}

impl DelaunayKernel {
    /// Returns an error if the program does not have the kernel.
    ///
    /// # Errors
    /// Returns [`Error::Delaunay`](crate::Error::Delaunay).
    pub fn check_built_in(self) -> Result<()> {
        if self == Self::Tetgen && !cfg!(feature = "tetgen") {
            return Err(delaunay_error(
                "this atomesh was built without TetGen",
                "use the kernel `native`, which gives the same tetrahedra; or install \
                 libtet1.5-dev and libclang-dev and build with the feature `tetgen`",
            ));
        }
        Ok(())
    }

    /// Returns the kernel for a number of points. Without TetGen it is always our own.
    #[cfg_attr(not(feature = "tetgen"), allow(unused_variables))]
    pub fn kernel(self, point_count: usize) -> &'static dyn Kernel {
        #[cfg(feature = "tetgen")]
        {
            let is_small = point_count < MIN_LARGE;
            if self == Self::Tetgen || self == Self::Auto && is_small {
                return &tetgen::Tetgen;
            }
        }
        &native::Native
    }
}

impl Display for DelaunayKernel {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Tetgen => "tetgen",
            Self::Native => "native",
        })
    }
}

/// A Delaunay triangulation and its adjacency.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Delaunay {
    /// The points in their order as nodes, and the tetrahedra that fill their convex hull.
    pub mesh: TetMesh,
    /// `neighbours[t][k]` shares with tetrahedron `t` the face opposite its node `k`; [`NONE`] on
    /// the hull.
    pub neighbours: Vec<[u32; 4]>,
}

/// Tetrahedra of a Delaunay triangulation, or some of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DelaunayTets {
    /// Node numbers of each tetrahedron, positively oriented.
    pub tets: Vec<[u32; 4]>,
    /// Index of the tetrahedron beyond the face opposite each node; [`NONE`] on the hull, and if
    /// that tetrahedron is not in this list. Empty if neighbours were not requested.
    pub neighbours: Vec<[u32; 4]>,
}

codec_fields! {
    DelaunayTets as DelaunayTets { tets, neighbours }
}

/// Returns some of the tetrahedra of [`delaunay_with_neighbours`], in the same order. Space is cut
/// into intervals along an axis at `cuts`. A tetrahedron belongs to the interval of its first point
/// (the one with the lowest number). Returns the tetrahedra of `intervals`; neighbours in other
/// intervals are [`NONE`]. Returns `None` if only a triangulation of all points can give the
/// result.
///
/// Only the points in these intervals and in a halo around them are triangulated. `global` describes
/// all points; points farther away than its [`max_halo`](GlobalPoints::max_halo) need not be in
/// `points`.
///
/// # Errors
/// Returns the errors of [`delaunay`], and an error if the kernel is not built in.
pub fn delaunay_in_intervals(
    points: &[[f64; 3]],
    global: GlobalPoints,
    axis: usize,
    cuts: &[f64],
    intervals: std::ops::Range<usize>,
    kernel: DelaunayKernel,
) -> Result<Option<DelaunayTets>> {
    kernel.check_built_in()?;
    if intervals.is_empty() {
        return Ok(Some(DelaunayTets::default()));
    }
    check_points(points)?;
    if global.count < MIN_LARGE {
        return Ok(None);
    }
    let output = slabs::tets_in_intervals(
        points,
        global,
        axis,
        cuts,
        intervals,
        rayon::current_num_threads(),
        MIN_SLAB_POINTS,
        kernel.kernel(global.count),
    )?;
    Ok(output.map(|mut output| {
        canonical::sort_canonical(points.len(), &mut output);
        output
    }))
}

fn delaunay_error(problem: impl Display, remedy: impl Display) -> crate::Error {
    crate::Error::Delaunay(cause(PLACE, problem, remedy))
}

/// Returns the error for `point_count` points that TetGen or CGAL has no memory for.
#[cfg_attr(not(any(feature = "tetgen", feature = "cgal")), allow(dead_code))]
fn out_of_memory(place: &str, point_count: usize) -> crate::Error {
    crate::Error::Delaunay(cause(
        place,
        format!("{point_count} points do not fit in memory"),
        "use a larger distance between atoms (--distance), or a machine with more memory",
    ))
}

/// Checks for input that has no triangulation, on which TetGen would abort the process by an
/// assertion or print a message on standard output.
fn check_points(points: &[[f64; 3]]) -> Result<()> {
    if points.len() < 4 {
        return Err(delaunay_error(
            format!("{} points make no tetrahedron", points.len()),
            "give at least four points that are not in one plane",
        ));
    }
    if points.len() > i32::MAX as usize / 8 {
        return Err(delaunay_error(
            format!("{} points are more than can be numbered", points.len()),
            "use a larger distance between atoms (--distance)",
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

/// Returns an error that names two points if a point was left out because it coincides with another,
/// or for TetGen nearly so.
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

#[cfg(test)]
mod tests;
