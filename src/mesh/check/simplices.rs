//! Checks of triangles and tetrahedra: each face belongs to one cell or two, and neighbouring cells
//! share a whole face.

use super::{BoxBounds, CellChecks, Check, CheckHints, SideCoverage, singular_name};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Number of cells in one parallel task. Cancellation is checked between tasks.
const TASK_SIZE: usize = 1 << 14;

impl<const D: usize, M: Simplices<D>> CellChecks<D> for M {
    fn unreadable_reason(&self) -> Option<String> {
        first_unreadable(self).map(unreadable_message::<D, M>)
    }

    fn used_nodes(&self) -> Vec<bool> {
        let mut used = vec![false; self.nodes().len()];
        for &i in self.connectivity() {
            used[i as usize] = true;
        }
        used
    }

    fn target_volume(&self, bounds: &BoxBounds<D>) -> f64 {
        bounds.extent().iter().product()
    }

    fn check_faces(
        &self,
        hints: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        report: &mut Check,
        cancel: &CancelToken<'_>,
    ) -> Option<SideCoverage<D>> {
        if cancel.is_cancelled() {
            return None;
        }
        if let Some(neighbors) = hints.neighbors {
            match unpaired_count(self, neighbors, &[NONE], cancel) {
                Ok(0) => return Some(boundary_sides(self, neighbors, bounds, report)),
                Ok(_) => report.add_problem(mismatch_message::<D, M>(0)),
                Err(cell) => report.add_problem(mismatch_message::<D, M>(cell)),
            }
            return None;
        }
        match self.neighbors() {
            Ok(neighbors) => Some(boundary_sides(self, &neighbors, bounds, report)),
            Err(face) => {
                report.add_problem(format!(
                    "face {face:?} belongs to more than two {}",
                    M::CELLS_NAME
                ));
                None
            }
        }
    }
}

/// Returns the first cell that uses a node that does not exist.
pub(super) fn first_unreadable<const D: usize, M: Simplices<D>>(mesh: &M) -> Option<usize> {
    let mut corners = mesh.connectivity().iter();
    let position = corners.position(|&i| i as usize >= mesh.nodes().len())?;
    Some(position / (D + 1))
}

/// Returns the problem that the check reports for a cell that uses a node that does not exist.
pub(super) fn unreadable_message<const D: usize, M: Simplices<D>>(cell: usize) -> String {
    let name = singular_name(M::CELLS_NAME);
    format!("{name} {cell}: it names a node that does not exist")
}

/// Returns the problem that the check reports for a cell whose faces are not those of its
/// neighbours.
pub(super) fn mismatch_message<const D: usize, M: Simplices<D>>(cell: usize) -> String {
    let name = singular_name(M::CELLS_NAME);
    format!("{name} {cell}: its faces do not match its neighbours")
}

/// Returns how many more faces are seen from their cell with the lower number than from their cell
/// with the higher number: 0 if all faces pair.
///
/// Returns as the error the first cell of which a face is not shared with the neighbour given for
/// it, and with that one only. Faces whose neighbour is one of the `skipped` numbers are not
/// checked, and none is checked after `cancel` is cancelled.
pub(super) fn unpaired_count<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    skipped: &[u32],
    cancel: &CancelToken<'_>,
) -> Result<isize, usize> {
    if neighbors.len() != (D + 1) * mesh.len() {
        return Err(0);
    }
    let count_in_task = |task: usize| {
        let cells = task * TASK_SIZE..mesh.len().min((task + 1) * TASK_SIZE);
        unpaired_count_in(mesh, neighbors, skipped, cells)
    };
    let counts: Vec<Result<isize, usize>> = (0..mesh.len().div_ceil(TASK_SIZE))
        .into_par_iter()
        .take_any_while(|_| !cancel.is_cancelled())
        .map(count_in_task)
        .collect();
    if cancel.is_cancelled() {
        return Ok(0);
    }
    counts.into_iter().sum()
}

/// Performs [`unpaired_count`] for a range of cells.
fn unpaired_count_in<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    skipped: &[u32],
    cells: Range<usize>,
) -> Result<isize, usize> {
    let faces = D + 1;
    let mut unpaired = 0;
    for c in cells {
        let cell = mesh.cell(c);
        for (k, n) in neighbors[faces * c..faces * (c + 1)].iter().enumerate() {
            if skipped.contains(n) {
                continue;
            }
            let beyond = *n as usize;
            if beyond >= mesh.len() || beyond == c {
                return Err(c);
            }
            if beyond < c {
                unpaired -= 1;
                continue;
            }
            unpaired += 1;
            let (other_cell, other_neighbors) = (
                mesh.cell(beyond),
                &neighbors[faces * beyond..faces * (beyond + 1)],
            );
            let mut pairs = 0;
            let mut shared = 0;
            for (&node, &cell_beyond) in other_cell.iter().zip(other_neighbors) {
                // The node opposite the shared face does not belong to it.
                let is_apex = cell_beyond as usize == c;
                pairs += usize::from(is_apex);
                for (i, &own_node) in cell.iter().enumerate() {
                    shared += usize::from((own_node == node) & (i != k) & !is_apex);
                }
            }
            // The nodes of a cell differ, so D common nodes are the whole face.
            if (pairs, shared) != (1, D) {
                return Err(c);
            }
        }
    }
    Ok(unpaired)
}

/// Adds every face without a neighbour to the side of the box whose plane is nearest to it.
pub(super) fn boundary_sides<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    bounds: &BoxBounds<D>,
    report: &mut Check,
) -> SideCoverage<D> {
    let mut sides = SideCoverage::uncovered();
    for (i, _) in neighbors.iter().enumerate().filter(|(_, n)| **n == NONE) {
        let face = mesh.face(i / (D + 1), i % (D + 1));
        let p = face.map(|n| mesh.nodes()[n as usize]);
        let mut best = ((0, false), f64::INFINITY);
        for k in 0..D {
            for (upper, plane) in [(false, bounds.low[k]), (true, bounds.high[k])] {
                let offset = p.iter().map(|q| (q[k] - plane).abs()).fold(0.0, f64::max);
                if offset < best.1 {
                    best = ((k, upper), offset);
                }
            }
        }
        sides.add(best.0, M::face_area(&p), best.1, bounds, report);
    }
    sides
}
