//! Triangles and tetrahedra: each face belongs to one cell or two, and cells that meet share all of it.

use super::{BoxBounds, CellChecks, Check, CheckHints, SideCoverage, singular_name};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Cells in one task, from one question whether to go on to the next.
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
        known: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        found: &mut Check,
        patience: &CancelToken<'_>,
    ) -> Option<SideCoverage<D>> {
        if patience.is_cancelled() {
            return None;
        }
        if let Some(neighbors) = known.neighbors {
            match unpaired_count(self, neighbors, &[NONE], patience) {
                Ok(0) => return Some(boundary_sides(self, neighbors, bounds, found)),
                Ok(_) => found.add_problem(mismatch_message::<D, M>(0)),
                Err(cell) => found.add_problem(mismatch_message::<D, M>(cell)),
            }
            return None;
        }
        match self.neighbors() {
            Ok(neighbors) => Some(boundary_sides(self, &neighbors, bounds, found)),
            Err(face) => {
                found.add_problem(format!(
                    "face {face:?} belongs to more than two {}",
                    M::CELLS_NAME
                ));
                None
            }
        }
    }
}

/// The first cell of a node that does not exist.
pub(super) fn first_unreadable<const D: usize, M: Simplices<D>>(mesh: &M) -> Option<usize> {
    let mut corners = mesh.connectivity().iter();
    let at = corners.position(|&i| i as usize >= mesh.nodes().len())?;
    Some(at / (D + 1))
}

/// What is said of it.
pub(super) fn unreadable_message<const D: usize, M: Simplices<D>>(cell: usize) -> String {
    let name = singular_name(M::CELLS_NAME);
    format!("{name} {cell}: it names a node that does not exist")
}

/// What is said of a cell that has not its faces in common with its neighbours.
pub(super) fn mismatch_message<const D: usize, M: Simplices<D>>(cell: usize) -> String {
    let name = singular_name(M::CELLS_NAME);
    format!("{name} {cell}: it and its neighbours do not fit")
}

/// A face seen from the cell of the lower number pairs with one seen from the higher: how many more of the first
/// than of the second there are, where none may be left over; or the first cell that has not each of its faces in
/// common with the neighbour there, and with that alone. Faces with one of the `open` numbers beyond are not looked
/// at, and none once `patience` is over.
pub(super) fn unpaired_count<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    open: &[u32],
    patience: &CancelToken<'_>,
) -> Result<isize, usize> {
    if neighbors.len() != (D + 1) * mesh.len() {
        return Err(0);
    }
    let of_row = |row: usize| {
        let cells = row * TASK_SIZE..mesh.len().min((row + 1) * TASK_SIZE);
        unpaired_count_in(mesh, neighbors, open, cells)
    };
    let rows: Vec<Result<isize, usize>> = (0..mesh.len().div_ceil(TASK_SIZE))
        .into_par_iter()
        .take_any_while(|_| !patience.is_cancelled())
        .map(of_row)
        .collect();
    if patience.is_cancelled() {
        return Ok(0);
    }
    rows.into_iter().sum()
}

/// The same of some cells.
fn unpaired_count_in<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    open: &[u32],
    cells: Range<usize>,
) -> Result<isize, usize> {
    let faces = D + 1;
    let mut unpaired = 0;
    for c in cells {
        let cell = mesh.cell(c);
        for (k, n) in neighbors[faces * c..faces * (c + 1)].iter().enumerate() {
            if open.contains(n) {
                continue;
            }
            let n = *n as usize;
            if n >= mesh.len() || n == c {
                return Err(c);
            }
            if n < c {
                unpaired -= 1;
                continue;
            }
            unpaired += 1;
            let (other, back) = (mesh.cell(n), &neighbors[faces * n..faces * (n + 1)]);
            let mut pairs = 0;
            let mut shared = 0;
            for (&node, &cell_beyond) in other.iter().zip(back) {
                // The node opposite the face that they share is not in it.
                let is_apex = cell_beyond as usize == c;
                pairs += usize::from(is_apex);
                for (i, &own) in cell.iter().enumerate() {
                    shared += usize::from((own == node) & (i != k) & !is_apex);
                }
            }
            // Nodes of a cell differ, so that many in common are the face.
            if (pairs, shared) != (1, D) {
                return Err(c);
            }
        }
    }
    Ok(unpaired)
}

/// Every face without a neighbour, in the side of the box to whose plane it keeps closest.
pub(super) fn boundary_sides<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    bounds: &BoxBounds<D>,
    found: &mut Check,
) -> SideCoverage<D> {
    let mut sides = SideCoverage::uncovered();
    for (i, _) in neighbors.iter().enumerate().filter(|(_, n)| **n == NONE) {
        let face = mesh.face(i / (D + 1), i % (D + 1));
        let p = face.map(|n| mesh.nodes()[n as usize]);
        let mut best = ((0, false), f64::INFINITY);
        for k in 0..D {
            for (upper, plane) in [(false, bounds.low[k]), (true, bounds.high[k])] {
                let off = p.iter().map(|q| (q[k] - plane).abs()).fold(0.0, f64::max);
                if off < best.1 {
                    best = ((k, upper), off);
                }
            }
        }
        sides.add(best.0, M::face_area(&p), best.1, bounds, found);
    }
    sides
}
