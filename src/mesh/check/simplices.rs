//! Checks of triangles and tetrahedra: each face belongs to one cell or two, and neighbouring cells
//! share a whole face.

use super::{
    BoxBounds, CellChecks, Check, CheckHints, OuterBoundary, SIDE_TOLERANCE, SideCoverage,
    singular_name,
};
use crate::geometry::sorted;
use crate::mesh::Simplices;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Number of cells in one parallel task. Cancellation is checked between tasks.
const TASK_SIZE: usize = 1 << 14;

impl<const D: usize, M: Simplices<D>> CellChecks<D> for M {
    fn unreadable_reason(&self, first_cell: usize) -> Option<String> {
        let mut corners = self.connectivity().iter();
        let position = corners.position(|&i| i as usize >= self.nodes().len())?;
        let (name, cell) = (
            singular_name(M::CELLS_NAME),
            first_cell + position / (D + 1),
        );
        Some(format!(
            "{name} {cell}: it names a node that does not exist"
        ))
    }

    fn used_nodes(&self) -> Vec<bool> {
        let mut used = vec![false; self.nodes().len()];
        for &i in self.connectivity() {
            used[i as usize] = true;
        }
        used
    }

    fn target_volume(&self, bounds: &BoxBounds<D>) -> f64 {
        let Some(side) = bounds.bent_side else {
            return bounds.extent().iter().product();
        };
        let axis = side / 2;
        let opposite = if side % 2 == 1 {
            bounds.low
        } else {
            bounds.high
        }[axis];
        let prism = |face: [u32; D]| {
            let nodes = face.map(|n| self.nodes()[n as usize]);
            let heights = nodes.iter().map(|x| (x[axis] - opposite).abs());
            M::face_area(&flattened(nodes, axis)) * heights.sum::<f64>() / D as f64
        };
        bent_faces(self, bounds).into_iter().map(prism).sum()
    }

    fn check_faces(
        view: &MeshView<'_, D, Self>,
        hints: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        report: &mut Check,
        cancel: &CancelToken<'_>,
    ) -> crate::Result<Option<SideCoverage<D>>> {
        if let Some(neighbours) = hints.neighbours {
            if let Some(cell) = first_mismatched_cell(view, neighbours, cancel)? {
                let name = singular_name(M::CELLS_NAME);
                report.add_problem(format!(
                    "{name} {cell}: its faces do not match its neighbours"
                ));
                return Ok(None);
            }
            return boundary_sides(view, neighbours, hints.outer, bounds, report).map(Some);
        }
        if cancel.is_cancelled() {
            return Ok(None);
        }
        match view.mesh.neighbours() {
            Ok(neighbours) => {
                boundary_sides(view, &neighbours, hints.outer, bounds, report).map(Some)
            }
            Err(face) => {
                report.add_problem(format!(
                    "face {face:?} belongs to more than two {}",
                    M::CELLS_NAME
                ));
                Ok(None)
            }
        }
    }
}

/// Returns the first cell of which a face is not shared with the neighbour that is given for it.
/// Each face between two ranks is sent to the rank that owns its first node, so both of its copies
/// meet there. Collective.
fn first_mismatched_cell<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    neighbours: &[u32],
    cancel: &CancelToken<'_>,
) -> crate::Result<Option<usize>> {
    let mesh = view.mesh;
    let (mismatched, unpaired) = match unpaired_count(mesh, neighbours, cancel) {
        Ok(unpaired) => (None, unpaired as i64),
        Err(cell) => (Some(view.first_cell + cell), 0),
    };
    let at_cuts = (neighbours.iter().enumerate()).filter(|(_, n)| **n == NOT_LOCAL);
    let entry = |(i, _)| {
        let (cell, k) = (i / (D + 1), i % (D + 1));
        let face = sorted(mesh.face(cell, k).map(|n| view.global_id(n)));
        (face, view.first_cell + cell)
    };
    let faces = view.collect_by_nodes("faces between pieces", at_cuts.map(entry).collect())?;
    let unmatched = (faces.chunk_by(|a, b| a.nodes == b.nodes)).filter(|copies| match copies {
        [one, other] => one.sender.0 == other.sender.0,
        _ => true,
    });
    let unmatched = unmatched.map(|copies| copies[0].value);
    let local = (unmatched.chain(mismatched).min(), unpaired);
    let (mismatched, unpaired) =
        view.merge_parts("whether neighbours fit", local, |(a, m), (b, n)| {
            (a.into_iter().chain(b).min(), m + n)
        })?;
    Ok(mismatched.or((unpaired != 0).then_some(0)))
}

/// Returns how many more faces are seen from their cell with the lower number than from their cell
/// with the higher number: 0 if all faces pair.
///
/// Returns as the error the first cell of which a face is not shared with the neighbour given for
/// it, and with that one only. Faces without a local neighbour are not checked, and none is checked
/// after `cancel` is cancelled.
fn unpaired_count<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbours: &[u32],
    cancel: &CancelToken<'_>,
) -> Result<isize, usize> {
    if neighbours.len() != (D + 1) * mesh.len() {
        return Err(0);
    }
    let count_in_task = |task: usize| {
        let cells = task * TASK_SIZE..mesh.len().min((task + 1) * TASK_SIZE);
        unpaired_count_in(mesh, neighbours, cells)
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
    neighbours: &[u32],
    cells: Range<usize>,
) -> Result<isize, usize> {
    let faces = D + 1;
    let mut unpaired = 0;
    for c in cells {
        let cell = mesh.cell(c);
        for (k, n) in neighbours[faces * c..faces * (c + 1)].iter().enumerate() {
            if *n >= NOT_LOCAL {
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
            let (other_cell, other_neighbours) = (
                mesh.cell(beyond),
                &neighbours[faces * beyond..faces * (beyond + 1)],
            );
            let mut pairs = 0;
            let mut shared = 0;
            for (&node, &cell_beyond) in other_cell.iter().zip(other_neighbours) {
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

/// Returns the side of the box whose plane is nearest to the nodes of a face, as axis and `true` for its high end, and
/// the largest distance of its nodes from there. A face that lies in no flat side lies in the bent one, if there is one.
fn nearest_side<const D: usize>(
    nodes: &[[f64; D]; D],
    bounds: &BoxBounds<D>,
) -> ((usize, bool), f64) {
    let mut best = ((0, false), f64::INFINITY);
    for k in 0..D {
        for (upper, plane) in [(false, bounds.low[k]), (true, bounds.high[k])] {
            let offset = nodes
                .iter()
                .map(|q| (q[k] - plane).abs())
                .fold(0.0, f64::max);
            let is_bent = bounds.bent_side == Some(2 * k + usize::from(upper));
            if offset < best.1 && !is_bent {
                best = ((k, upper), offset);
            }
        }
    }
    match bounds.bent_side {
        Some(side) if best.1 > bounds.tolerance * bounds.longest_side() => {
            ((side / 2, side % 2 == 1), 0.0)
        }
        _ => best,
    }
}

/// Returns for each node of a mesh whether it lies on the side of the box `[0, extent]` that is bent.
pub fn nodes_on_bent_side<const D: usize>(
    mesh: &impl Simplices<D>,
    extent: [f64; D],
    bent_side: usize,
) -> Vec<bool> {
    let bounds = BoxBounds {
        low: [0.0; D],
        high: extent,
        tolerance: SIDE_TOLERANCE,
        bent_side: Some(bent_side),
    };
    let mut is_on_side = vec![false; mesh.nodes().len()];
    for face in bent_faces(mesh, &bounds) {
        face.iter().for_each(|&n| is_on_side[n as usize] = true);
    }
    is_on_side
}

/// Returns the faces in the bent side of the box; none if no side is bent, or if more than two cells share a face.
fn bent_faces<const D: usize>(mesh: &impl Simplices<D>, bounds: &BoxBounds<D>) -> Vec<[u32; D]> {
    let neighbours = mesh.neighbours().unwrap_or_default();
    let boundary = (neighbours.iter().enumerate()).filter(|(_, n)| **n == NONE);
    let faces = boundary.map(|(i, _)| mesh.face(i / (D + 1), i % (D + 1)));
    let is_bent = |face: &[u32; D]| {
        let nodes = face.map(|n| mesh.nodes()[n as usize]);
        let (axis, is_high) = nearest_side(&nodes, bounds).0;
        bounds.bent_side == Some(2 * axis + usize::from(is_high))
    };
    faces.filter(is_bent).collect()
}

/// Returns the nodes of a face as seen along an axis.
fn flattened<const D: usize>(nodes: [[f64; D]; D], axis: usize) -> [[f64; D]; D] {
    nodes.map(|mut x| {
        x[axis] = 0.0;
        x
    })
}

/// Adds every face without a neighbour, on any rank, to the side of the box whose plane is nearest
/// to it, except those where cells were left out. Collective.
fn boundary_sides<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    neighbours: &[u32],
    outer: Option<&OuterBoundary>,
    bounds: &BoxBounds<D>,
    report: &mut Check,
) -> crate::Result<SideCoverage<D>> {
    let (mesh, mut local) = (view.mesh, Check::default());
    let mut sides = SideCoverage::uncovered();
    if let Some(side) = bounds.bent_side {
        // The areas of the others depend on the bent side.
        sides.must_be_covered = std::array::from_fn(|k| k == side / 2);
    }
    for (i, _) in neighbours.iter().enumerate().filter(|(_, n)| **n == NONE) {
        let face = mesh.face(i / (D + 1), i % (D + 1));
        if outer.is_some_and(|outer| outer.contains(&face)) {
            sides.declared_faces += 1;
            continue;
        }
        let p = face.map(|n| mesh.nodes()[n as usize]);
        let ((axis, upper), offset) = nearest_side::<D>(&p, bounds);
        let p = match bounds.bent_side {
            Some(bent) if bent == 2 * axis + usize::from(upper) => flattened(p, axis),
            _ => p,
        };
        sides.add(axis, upper, M::face_area(&p), offset, bounds, &mut local);
    }
    let counts = [local.boundary_faces, local.faces_off_sides];
    let local = (counts, (local.flatness_error, sides.area));
    let ([boundary_faces, faces_off_sides], (flatness_error, area)) =
        view.merge_parts("sides", local, |([m, n], (error, mut sums)), other| {
            let ([k, l], (other_error, area)) = other;
            (sums.as_flattened_mut().iter_mut())
                .zip(area.as_flattened())
                .for_each(|(sum, area)| *sum += area);
            ([m + k, n + l], (error.max(other_error), sums))
        })?;
    report.boundary_faces += boundary_faces;
    report.faces_off_sides += faces_off_sides;
    report.flatness_error = report.flatness_error.max(flatness_error);
    sides.area = area;
    Ok(sides)
}
