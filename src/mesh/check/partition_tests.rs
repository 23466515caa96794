//! A mesh that is distributed over several ranks has the check of the global mesh.

use super::{Check, CheckHints, check_view, check_with_hints};
use crate::comm::run_threads;
use crate::mesh::TetMesh;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::complex::{NONE, NOT_LOCAL, neighbours};
use crate::mesh::mesh_partition::MeshPartition;
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;

const BOX: [[f64; 3]; 2] = [[0.0; 3], [3.0, 2.0, 4.0]];

/// Returns the check of a global mesh, and the check of its partitions as each rank computes
/// it.
fn check_both(
    mesh: &TetMesh,
    count: usize,
    change: impl Fn(&mut [MeshPartition]),
) -> (Check, Vec<Check>) {
    let adjacent = neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    let hints = CheckHints {
        neighbours: Some(adjacent.as_flattened()),
        ..CheckHints::default()
    };
    let global = check_with_hints(mesh, hints, BOX[0], BOX[1], 1e-9);
    let mut partitions = MeshPartition::split(mesh, &adjacent, count);
    change(&mut partitions);
    let distributed = run_threads(count, |comm| {
        let partition = &partitions[comm.rank()];
        let never = CancelToken::never();
        let hints = CheckHints {
            neighbours: Some(partition.neighbours.as_flattened()),
            ..CheckHints::default()
        };
        let view = MeshView::from_partition(partition, comm);
        check_view(&view, hints, BOX[0], BOX[1], 1e-9, &never).unwrap()
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
        let mut adjacent = partition.neighbours.as_flattened_mut().iter_mut();
        *adjacent.find(|n| **n == sought).unwrap() = NOT_LOCAL ^ NONE ^ sought;
    };
    assert!(problems(&|all| flip_first(&mut all[1], NOT_LOCAL)).contains(expected));
    assert!(problems(&|all| flip_first(&mut all[1], NONE)).contains(expected));
    let isolated = |partitions: &mut [MeshPartition]| partitions[2].neighbours[10] = [NONE; 4];
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
            neighbours: vec![],
            ..partitions[1].clone()
        }
    };
    assert!(problems(&emptied).contains(expected));
}
