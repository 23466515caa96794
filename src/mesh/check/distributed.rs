//! A mesh of tetrahedra of which several hold a piece each.

use super::simplices::{
    boundary_sides, first_unreadable, mismatch_message, unpaired_count, unreadable_message,
};
use super::{BoxBounds, CellChecks, CellTotals, Check, NOT_FINITE, are_finite};
use crate::Result;
use crate::comm::Comm;
use crate::comm::LocalOrComm;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::mesh::{Mesh, TetMesh};
use crate::progress::CancelToken;

/// [`check`](super::check()) of a mesh of which each of a group holds a piece, on all of them. Faces between pieces
/// must be in just two. Once `patience` is over, nothing can be said of the mesh.
///
/// # Errors
/// Those of the others.
pub(crate) fn check_distributed(
    piece: &MeshPartition,
    group: &dyn Comm,
    low: [f64; 3],
    high: [f64; 3],
    tolerance: f64,
    patience: &CancelToken<'_>,
) -> Result<Check> {
    let mesh = &piece.mesh;
    let mut found = Check {
        nodes: piece.global_counts[0],
        cells: piece.global_counts[1],
        ..Check::default()
    };
    let first = first_unreadable(mesh).map(|cell| piece.first_cell + cell);
    let all = group.all_gather(
        "whether meshes are readable",
        (first, are_finite(&mesh.nodes)),
    )?;
    if let Some(cell) = all.iter().filter_map(|(first, _)| *first).min() {
        found.add_problem(unreadable_message::<3, TetMesh>(cell));
        return Ok(found);
    }
    if all.iter().any(|(_, finite)| !finite) {
        found.add_problem(NOT_FINITE.into());
        return Ok(found);
    }
    let bounds = BoxBounds {
        low,
        high,
        tolerance,
    };
    let filled = cell_totals(piece, group)?;
    let unused = unused_nodes(piece, group)?;
    found.judge(
        TetMesh::CELLS_NAME,
        &filled,
        unused,
        mesh.target_volume(&bounds),
        tolerance,
    );
    if let Some(cell) = first_mismatched_cell(piece, group, patience)? {
        found.add_problem(mismatch_message::<3, TetMesh>(cell));
        return Ok(found);
    }
    check_sides(piece, group, &bounds, &mut found)?;
    Ok(found)
}

/// What all tetrahedra are in sum.
fn cell_totals(piece: &MeshPartition, group: &dyn Comm) -> Result<CellTotals> {
    let own = CellTotals::from_volumes(&piece.mesh.volumes());
    let first = own.first_not_positive.map(|cell| piece.first_cell + cell);
    let all = group.all_gather("volumes", ((own.not_positive, first), own.volume))?;
    Ok(CellTotals {
        not_positive: all.iter().map(|((not_positive, _), _)| not_positive).sum(),
        first_not_positive: all.iter().filter_map(|((_, first), _)| *first).min(),
        volume: all.iter().map(|(_, volume)| volume).sum(),
    })
}

/// How many nodes of the whole no piece uses. Each is looked for by one of the group.
fn unused_nodes(piece: &MeshPartition, group: &dyn Comm) -> Result<usize> {
    let mut to = vec![Vec::new(); Comm::size(group)];
    let used = piece.global_ids.iter().zip(piece.mesh.used_nodes());
    for (&node, _) in used.filter(|(_, used)| *used) {
        to[group.owner_rank(node, piece.global_counts[0])].push(node);
    }
    let mut used = group.all_to_all("used nodes", to)?.concat();
    used.sort_unstable();
    used.dedup();
    let used: usize = group
        .all_gather("counts of used nodes", used.len())?
        .iter()
        .sum();
    Ok(piece.global_counts[0].saturating_sub(used))
}

/// The first tetrahedron that has not each of its faces in common with the neighbour there, if it has one. Those of
/// faces between pieces meet at one of the group, at which nobody else's do.
fn first_mismatched_cell(
    piece: &MeshPartition,
    group: &dyn Comm,
    patience: &CancelToken<'_>,
) -> Result<Option<usize>> {
    let mesh = &piece.mesh;
    let inside = unpaired_count(
        mesh,
        piece.neighbors.as_flattened(),
        &[NONE, NOT_LOCAL],
        patience,
    );
    let (apart, left_over) = match inside {
        Ok(left_over) => (None, left_over as i64),
        Err(cell) => (Some(piece.first_cell + cell), 0),
    };
    let mut to = vec![Vec::new(); Comm::size(group)];
    for (cell, (tet, around)) in mesh.tets.iter().zip(&piece.neighbors).enumerate() {
        for k in (0..4).filter(|&k| around[k] == NOT_LOCAL) {
            let number = |i: usize| piece.global_ids[tet[i + usize::from(i >= k)] as usize];
            let mut face = [0, 1, 2].map(number);
            face.sort_unstable();
            to[group.owner_rank(face[0], piece.global_counts[0])]
                .push((face, piece.first_cell + cell));
        }
    }
    let from = group.all_to_all("faces between pieces", to)?;
    let mut faces: Vec<([u32; 3], (usize, usize))> = (from.into_iter().enumerate())
        .flat_map(|(member, faces)| {
            let of = move |(face, cell)| (face, (cell, member));
            faces.into_iter().map(of)
        })
        .collect();
    faces.sort_unstable();
    let alone = faces.chunk_by(|a, b| a.0 == b.0).filter(|same| match same {
        [(_, (_, one)), (_, (_, other))] => one == other,
        _ => true,
    });
    let apart = alone.map(|same| same[0].1.0).chain(apart).min();
    let all = group.all_gather("whether neighbours fit", (apart, left_over))?;
    let left_over: i64 = all.iter().map(|(_, left_over)| left_over).sum();
    let apart = all.iter().filter_map(|(apart, _)| *apart).min();
    Ok(apart.or((left_over != 0).then_some(0)))
}

/// Checks that the outer faces of all cover the sides of the box.
fn check_sides(
    piece: &MeshPartition,
    group: &dyn Comm,
    bounds: &BoxBounds<3>,
    found: &mut Check,
) -> Result<()> {
    let mut own = Check::default();
    let mut sides = boundary_sides(
        &piece.mesh,
        piece.neighbors.as_flattened(),
        bounds,
        &mut own,
    );
    let counts = [own.boundary_faces, own.faces_off_sides];
    let own = (counts, (own.flatness_error, sides.area));
    sides.area = [[0.0; 2]; 3];
    for ([boundary_faces, faces_off_sides], (flatness_error, area)) in
        group.all_gather("sides", own)?
    {
        found.boundary_faces += boundary_faces;
        found.faces_off_sides += faces_off_sides;
        found.flatness_error = found.flatness_error.max(flatness_error);
        let sums = sides.area.as_flattened_mut().iter_mut();
        sums.zip(area.as_flattened())
            .for_each(|(sum, area)| *sum += area);
    }
    sides.judge(bounds, found);
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

    /// What is found of a whole mesh, and what of its pieces, by each of those who hold them.
    fn check_both(
        mesh: &TetMesh,
        count: usize,
        change: impl Fn(&mut [MeshPartition]),
    ) -> (Check, Vec<Check>) {
        let around = neighbors(mesh.nodes.len(), &mesh.tets).unwrap();
        let known = CheckHints {
            neighbors: Some(around.as_flattened()),
            ..CheckHints::default()
        };
        let whole = check_with_hints(mesh, known, BOX[0], BOX[1], 1e-9);
        let mut pieces = MeshPartition::split(mesh, &around, count);
        change(&mut pieces);
        let of_pieces = run_threads(count, |group| {
            let piece = &pieces[group.rank()];
            let endless = CancelToken::never();
            check_distributed(piece, group, BOX[0], BOX[1], 1e-9, &endless).unwrap()
        });
        (whole, of_pieces)
    }

    /// The same but for how sums are rounded: volumes are said to all their digits.
    pub fn assert_same_check(found: &Check, whole: &Check) {
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b.abs().max(1.0);
        assert!(near(found.volume_error, whole.volume_error));
        assert!(near(found.area_error, whole.area_error));
        let but_volumes = |check: &Check| Check {
            volume_error: 0.0,
            area_error: 0.0,
            problems: (check.problems.iter())
                .map(|line| line.split(" fill ").next().unwrap_or_default().into())
                .collect(),
            ..check.clone()
        };
        assert_eq!(but_volumes(found), but_volumes(whole));
    }

    #[test]
    fn what_is_said_of_pieces_is_said_of_the_whole() {
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
                let (whole, found) = check_both(mesh, count, |_| ());
                assert_eq!(whole.passed(), *is_right, "{:?}", whole.problems);
                found
                    .iter()
                    .for_each(|found| assert_same_check(found, &whole));
            }
        }
    }

    #[test]
    fn pieces_that_do_not_fit_are_found() {
        let mesh = kuhn_box([3, 2, 4], 1.0);
        let problems = |change: &dyn Fn(&mut [MeshPartition])| {
            let (_, found) = check_both(&mesh, 3, change);
            assert!(found.iter().all(|other| *other == found[0]));
            found[0].problems.concat()
        };
        assert_eq!(problems(&|_| ()), "");
        let apart = "it and its neighbours do not fit";
        // A face that only one side, or neither of one piece and one more of another, knows to go on.
        let first_of = |piece: &mut MeshPartition, sought: u32| {
            let mut all = piece.neighbors.as_flattened_mut().iter_mut();
            *all.find(|n| **n == sought).unwrap() = NOT_LOCAL ^ NONE ^ sought;
        };
        assert!(problems(&|all| first_of(&mut all[1], NOT_LOCAL)).contains(apart));
        assert!(problems(&|all| first_of(&mut all[1], NONE)).contains(apart));
        let inner = |all: &mut [MeshPartition]| all[2].neighbors[10] = [NONE; 4];
        assert!(problems(&inner).contains(apart));
        // A tetrahedron of another node: its faces are not those of its neighbours.
        let other = |all: &mut [MeshPartition]| all[0].mesh.tets[5].swap(0, 3);
        assert!(!problems(&other).is_empty());
        let missing = |all: &mut [MeshPartition]| all[2].mesh.tets[5][1] = 99;
        assert_eq!(
            problems(&missing),
            "tetrahedron 101: it names a node that does not exist"
        );
        let gone = |all: &mut [MeshPartition]| {
            all[1] = MeshPartition {
                mesh: TetMesh::default(),
                neighbors: vec![],
                ..all[1].clone()
            }
        };
        assert!(problems(&gone).contains(apart));
    }
}
