//! Checks a mesh of tetrahedra that is distributed over several ranks, one partition each.

use super::simplices::{
    boundary_sides, first_unreadable, mismatch_message, unpaired_count, unreadable_message,
};
use super::{BoxBounds, CellChecks, CellTotals, Check, NOT_FINITE, are_finite};
use crate::Result;
use crate::comm::Comm;
use crate::comm::LocalOrComm;
use crate::geometry::sorted_distinct;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::mesh::{Mesh, TetMesh};
use crate::progress::CancelToken;

/// Performs [`check`](super::check()) on a mesh of which each rank of `comm` has one partition, and
/// returns the result on all ranks. Faces between partitions must belong to exactly two tetrahedra.
/// After `cancel` is cancelled, the result has no meaning.
///
/// # Errors
/// Returns the errors of the communication.
pub(crate) fn check_distributed(
    partition: &MeshPartition,
    comm: &dyn Comm,
    low: [f64; 3],
    high: [f64; 3],
    tolerance: f64,
    cancel: &CancelToken<'_>,
) -> Result<Check> {
    let mesh = &partition.mesh;
    let mut report = Check {
        nodes: partition.global_counts[0],
        cells: partition.global_counts[1],
        ..Check::default()
    };
    let first = first_unreadable(mesh).map(|cell| partition.first_cell + cell);
    let gathered = comm.all_gather(
        "whether meshes are readable",
        (first, are_finite(&mesh.nodes)),
    )?;
    if let Some(cell) = gathered.iter().filter_map(|(first, _)| *first).min() {
        report.add_problem(unreadable_message::<3, TetMesh>(cell));
        return Ok(report);
    }
    if gathered.iter().any(|(_, finite)| !finite) {
        report.add_problem(NOT_FINITE.into());
        return Ok(report);
    }
    let bounds = BoxBounds {
        low,
        high,
        tolerance,
    };
    let totals = cell_totals(partition, comm)?;
    let unused = unused_nodes(partition, comm)?;
    report.judge(
        TetMesh::CELLS_NAME,
        &totals,
        unused,
        mesh.target_volume(&bounds),
        tolerance,
    );
    if let Some(cell) = first_mismatched_cell(partition, comm, cancel)? {
        report.add_problem(mismatch_message::<3, TetMesh>(cell));
        return Ok(report);
    }
    check_sides(partition, comm, &bounds, &mut report)?;
    Ok(report)
}

/// Sums up the volumes of all tetrahedra of all ranks.
fn cell_totals(partition: &MeshPartition, comm: &dyn Comm) -> Result<CellTotals> {
    let local = CellTotals::from_volumes(&partition.mesh.volumes());
    let first = local
        .first_not_positive
        .map(|cell| partition.first_cell + cell);
    let gathered = comm.all_gather("volumes", ((local.not_positive, first), local.volume))?;
    Ok(CellTotals {
        not_positive: gathered
            .iter()
            .map(|((not_positive, _), _)| not_positive)
            .sum(),
        first_not_positive: gathered.iter().filter_map(|((_, first), _)| *first).min(),
        volume: gathered.iter().map(|(_, volume)| volume).sum(),
    })
}

/// Counts the nodes of the global mesh that no partition uses. One rank, the owner, looks for each
/// node.
fn unused_nodes(partition: &MeshPartition, comm: &dyn Comm) -> Result<usize> {
    let mut by_rank = vec![Vec::new(); Comm::size(comm)];
    let used = partition.global_ids.iter().zip(partition.mesh.used_nodes());
    for (&node, _) in used.filter(|(_, used)| *used) {
        by_rank[comm.owner_rank(node, partition.global_counts[0])].push(node);
    }
    let used = sorted_distinct(comm.all_to_all("used nodes", by_rank)?.concat());
    let used: usize = comm
        .all_gather("counts of used nodes", used.len())?
        .iter()
        .sum();
    Ok(partition.global_counts[0].saturating_sub(used))
}

/// Returns the first tetrahedron of which a face is not shared with the neighbour that is given for
/// it. Each face between two partitions is sent to the rank that owns its first node, so both of
/// its copies meet there.
fn first_mismatched_cell(
    partition: &MeshPartition,
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<Option<usize>> {
    let mesh = &partition.mesh;
    let local = unpaired_count(
        mesh,
        partition.neighbors.as_flattened(),
        &[NONE, NOT_LOCAL],
        cancel,
    );
    let (mismatched, unpaired) = match local {
        Ok(unpaired) => (None, unpaired as i64),
        Err(cell) => (Some(partition.first_cell + cell), 0),
    };
    let mut by_rank = vec![Vec::new(); Comm::size(comm)];
    for (cell, (tet, adjacent)) in mesh.tets.iter().zip(&partition.neighbors).enumerate() {
        for k in (0..4).filter(|&k| adjacent[k] == NOT_LOCAL) {
            let global_id = |i: usize| partition.global_ids[tet[i + usize::from(i >= k)] as usize];
            let mut face = [0, 1, 2].map(global_id);
            face.sort_unstable();
            by_rank[comm.owner_rank(face[0], partition.global_counts[0])]
                .push((face, partition.first_cell + cell));
        }
    }
    let received = comm.all_to_all("faces between pieces", by_rank)?;
    let mut faces: Vec<([u32; 3], (usize, usize))> = (received.into_iter().enumerate())
        .flat_map(|(rank, faces)| {
            let with_rank = move |(face, cell)| (face, (cell, rank));
            faces.into_iter().map(with_rank)
        })
        .collect();
    faces.sort_unstable();
    let unmatched = faces.chunk_by(|a, b| a.0 == b.0).filter(|same| match same {
        [(_, (_, one)), (_, (_, other))] => one == other,
        _ => true,
    });
    let mismatched = unmatched.map(|same| same[0].1.0).chain(mismatched).min();
    let gathered = comm.all_gather("whether neighbours fit", (mismatched, unpaired))?;
    let unpaired: i64 = gathered.iter().map(|(_, left_over)| left_over).sum();
    let mismatched = gathered.iter().filter_map(|(cell, _)| *cell).min();
    Ok(mismatched.or((unpaired != 0).then_some(0)))
}

/// Checks that the outer faces of all partitions cover the sides of the box.
fn check_sides(
    partition: &MeshPartition,
    comm: &dyn Comm,
    bounds: &BoxBounds<3>,
    report: &mut Check,
) -> Result<()> {
    let mut local = Check::default();
    let mut sides = boundary_sides(
        &partition.mesh,
        partition.neighbors.as_flattened(),
        bounds,
        &mut local,
    );
    let counts = [local.boundary_faces, local.faces_off_sides];
    let local = (counts, (local.flatness_error, sides.area));
    sides.area = [[0.0; 2]; 3];
    for ([boundary_faces, faces_off_sides], (flatness_error, area)) in
        comm.all_gather("sides", local)?
    {
        report.boundary_faces += boundary_faces;
        report.faces_off_sides += faces_off_sides;
        report.flatness_error = report.flatness_error.max(flatness_error);
        let sums = sides.area.as_flattened_mut().iter_mut();
        sums.zip(area.as_flattened())
            .for_each(|(sum, area)| *sum += area);
    }
    sides.judge(bounds, report);
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::comm::run_threads;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::{CheckHints, check_with_hints};
    use crate::mesh::complex::neighbors;

    const BOX: [[f64; 3]; 2] = [[0.0; 3], [3.0, 2.0, 4.0]];

    /// Returns the check of a global mesh, and the check of its partitions as each rank computes
    /// it.
    fn check_both(
        mesh: &TetMesh,
        count: usize,
        change: impl Fn(&mut [MeshPartition]),
    ) -> (Check, Vec<Check>) {
        let adjacent = neighbors(mesh.nodes.len(), &mesh.tets).unwrap();
        let hints = CheckHints {
            neighbors: Some(adjacent.as_flattened()),
            ..CheckHints::default()
        };
        let global = check_with_hints(mesh, hints, BOX[0], BOX[1], 1e-9);
        let mut partitions = MeshPartition::split(mesh, &adjacent, count);
        change(&mut partitions);
        let distributed = run_threads(count, |comm| {
            let partition = &partitions[comm.rank()];
            let never = CancelToken::never();
            check_distributed(partition, comm, BOX[0], BOX[1], 1e-9, &never).unwrap()
        });
        (global, distributed)
    }

    /// Asserts that two checks are equal except for the rounding of sums (the messages print
    /// volumes with all digits).
    pub fn assert_same_check(report: &Check, expected: &Check) {
        let is_close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b.abs().max(1.0);
        assert!(is_close(report.volume_error, expected.volume_error));
        assert!(is_close(report.area_error, expected.area_error));
        let without_volumes = |check: &Check| Check {
            volume_error: 0.0,
            area_error: 0.0,
            problems: (check.problems.iter())
                .map(|line| line.split(" fill ").next().unwrap_or_default().into())
                .collect(),
            ..check.clone()
        };
        assert_eq!(without_volumes(report), without_volumes(expected));
    }

    #[test]
    fn partitions_give_the_check_of_the_global_mesh() {
        let right = kuhn_box([3, 2, 4], 1.0);
        let changed = |change: &dyn Fn(&mut TetMesh)| {
            let mut mesh = right.clone();
            change(&mut mesh);
            mesh
        };
        let meshes = [
            (true, right.clone()),
            (true, changed(&|m| m.tets.reverse())),
            (true, changed(&|m| m.tets.sort_by_key(|tet| tet[0] % 7))),
            (false, changed(&|m| m.tets[70].swap(0, 1))),
            (false, changed(&|m| m.nodes.push([0.5; 3]))),
            (false, changed(&|m| m.tets.truncate(101))),
            (false, changed(&|m| m.nodes[0][0] = 0.25)),
            (false, changed(&|m| m.nodes[30][1] = f64::NAN)),
            (false, changed(&|m| m.nodes[30][1] = 0.0)),
        ];
        for (is_right, mesh) in &meshes {
            for count in [1, 2, 3, 7] {
                let (expected, found) = check_both(mesh, count, |_| ());
                assert_eq!(expected.passed(), *is_right, "{:?}", expected.problems);
                found
                    .iter()
                    .for_each(|found| assert_same_check(found, &expected));
            }
        }
    }

    #[test]
    fn partitions_that_do_not_match_are_found() {
        let mesh = kuhn_box([3, 2, 4], 1.0);
        let problems = |change: &dyn Fn(&mut [MeshPartition])| {
            let (_, reports) = check_both(&mesh, 3, change);
            assert!(reports.iter().all(|other| *other == reports[0]));
            reports[0].problems.concat()
        };
        assert_eq!(problems(&|_| ()), "");
        let expected = "its faces do not match its neighbours";
        // Flips the mark of one face: it is outside on one side only, or has one neighbour too few.
        let flip_first = |partition: &mut MeshPartition, sought: u32| {
            let mut adjacent = partition.neighbors.as_flattened_mut().iter_mut();
            *adjacent.find(|n| **n == sought).unwrap() = NOT_LOCAL ^ NONE ^ sought;
        };
        assert!(problems(&|all| flip_first(&mut all[1], NOT_LOCAL)).contains(expected));
        assert!(problems(&|all| flip_first(&mut all[1], NONE)).contains(expected));
        let isolated = |partitions: &mut [MeshPartition]| partitions[2].neighbors[10] = [NONE; 4];
        assert!(problems(&isolated).contains(expected));
        // A tetrahedron with two nodes exchanged: its faces no longer match those of its
        // neighbours.
        let misoriented = |partitions: &mut [MeshPartition]| partitions[0].mesh.tets[5].swap(0, 3);
        assert!(!problems(&misoriented).is_empty());
        let missing = |partitions: &mut [MeshPartition]| partitions[2].mesh.tets[5][1] = 99;
        assert_eq!(
            problems(&missing),
            "tetrahedron 101: it names a node that does not exist"
        );
        let emptied = |partitions: &mut [MeshPartition]| {
            partitions[1] = MeshPartition {
                mesh: TetMesh::default(),
                neighbors: vec![],
                ..partitions[1].clone()
            }
        };
        assert!(problems(&emptied).contains(expected));
    }
}
