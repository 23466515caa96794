//! The triangulation of all points, by one process or by ranks that share the work.

use super::{
    Delaunay, DelaunayKernel, DelaunayTets, MIN_LARGE, MIN_SLAB_POINTS, canonical, check_all_used,
    check_points, slabs,
};
use crate::comm::{Comm, SelfComm};
use crate::error::Result;
use crate::mesh::TetMesh;

/// Returns the Delaunay triangulation of `points`.
///
/// Nodes are all points in their order, and every one is used. Tetrahedra are positively oriented
/// (see [`crate::mesh`](mod@crate::mesh)), never flat, and fill the convex hull exactly. They begin
/// with their lowest node, followed by the lowest of the others, and are sorted by their nodes.
///
/// # Errors
/// Returns [`Error::Delaunay`](crate::Error::Delaunay) for fewer than four points, for a coordinate
/// that is not finite, for points in one plane, or for coinciding points (the message names both).
pub fn delaunay(points: &[[f64; 3]]) -> Result<TetMesh> {
    distributed_delaunay(points, DelaunayKernel::Auto, &SelfComm)
}

/// Returns the [`delaunay`] triangulation by one of the kernels.
///
/// # Errors
/// Returns the errors of [`delaunay`], and an error if the kernel is not built in.
pub fn delaunay_by(points: &[[f64; 3]], kernel: DelaunayKernel) -> Result<TetMesh> {
    distributed_delaunay(points, kernel, &SelfComm)
}

/// Returns the [`delaunay`] triangulation on all ranks of `comm`, which have the same points and
/// share the work.
///
/// # Errors
/// Returns the errors of [`delaunay`], on whichever rank, and an error if the kernel is not built
/// in.
pub(crate) fn distributed_delaunay(
    points: &[[f64; 3]],
    kernel: DelaunayKernel,
    comm: &dyn Comm,
) -> Result<TetMesh> {
    Ok(triangulate(points, false, kernel, comm)?.mesh)
}

/// Returns the [`delaunay`] triangulation with its adjacency, which takes about a tenth more time.
///
/// # Errors
/// Returns the errors of [`delaunay`].
pub fn delaunay_with_neighbours(points: &[[f64; 3]]) -> Result<Delaunay> {
    distributed_delaunay_with_neighbours(points, DelaunayKernel::Auto, &SelfComm)
}

/// Returns the triangulation of [`distributed_delaunay`] with its adjacency.
///
/// # Errors
/// Returns the errors of [`distributed_delaunay`].
pub(crate) fn distributed_delaunay_with_neighbours(
    points: &[[f64; 3]],
    kernel: DelaunayKernel,
    comm: &dyn Comm,
) -> Result<Delaunay> {
    triangulate(points, true, kernel, comm)
}

fn triangulate(
    points: &[[f64; 3]],
    with_neighbours: bool,
    kernel: DelaunayKernel,
    comm: &dyn Comm,
) -> Result<Delaunay> {
    kernel.check_built_in()?;
    check_points(points)?;
    let kernel = kernel.kernel(points.len());
    let local_workers = rayon::current_num_threads();
    let slab_count = if points.len() < MIN_LARGE {
        1
    } else {
        let workers = comm.broadcast_from_root("processors", || Ok(local_workers * comm.size()))?;
        workers.min(points.len() / MIN_SLAB_POINTS)
    };
    let combined = if slab_count > 1 {
        slabs::triangulate_in_slabs(points, slab_count, local_workers, kernel, |triangulate| {
            let mut parts = Vec::with_capacity(slab_count);
            let work = |own, give: &mut dyn FnMut(Option<DelaunayTets>)| {
                (triangulate(own).into_iter()).try_for_each(|part| part.map(&mut *give))
            };
            comm.distribute("slabs of points", slab_count, work, &mut |part| {
                parts.push(part)
            })?;
            Ok(parts)
        })?
    } else {
        None
    };
    let mut output = match combined {
        Some(output) => output,
        None => kernel.triangulate(points, with_neighbours)?,
    };
    if !with_neighbours {
        output.neighbours = Vec::new();
    }
    canonical::sort_canonical(points.len(), &mut output);
    check_all_used(points, &output.tets)?;
    Ok(Delaunay {
        mesh: TetMesh {
            nodes: points.to_vec(),
            tets: output.tets,
        },
        neighbours: output.neighbours,
    })
}
