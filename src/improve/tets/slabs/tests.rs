//! Slabs of one mesh, by one and by several.

use super::super::tests::box_mesh;
use super::*;
use crate::comm::{SelfComm, run_threads};
use crate::feature::FeaturePoint;
use crate::geometry::{norm, normal};
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::complex;

/// The plane x + y / 2 = `at` as points of a feature.
fn plane_points(at: f32, extent: [f64; 3]) -> Vec<FeaturePoint<3>> {
    let [_, y, z] = extent.map(|e| e as usize);
    let length = 1.25f32.sqrt();
    let points = (0..=z).flat_map(|k| {
        (0..=y).map(move |j| FeaturePoint {
            position: [at - 0.5 * j as f32, j as f32, k as f32],
            normal: [1.0 / length, 0.5 / length, 0.0],
            strength: 1.0,
        })
    });
    points.collect()
}

#[test]
fn slabs_are_the_same_mesh_for_any_number_of_members() {
    let (mesh, kinds, extent) = box_mesh([45, 7, 6], 4.0, 0.28, |_| true);
    let neighbors = complex::neighbors(mesh.nodes.len(), &mesh.tets).unwrap();
    // One in the middle of a slab, and two that cross a cut.
    let points = [40.0, 72.0, 123.0]
        .map(|at| plane_points(at, extent))
        .concat();
    let sheets = FeaturePlanes::new(&points, extent, 3.6, 5.0);
    let distance = Distance::Constant(4.5);
    let target = Target::default();
    let aim = SlabContext {
        extent,
        planes: &sheets,
        distance: &distance,
        target: &target,
    };
    let cuts = SlabCuts {
        axis: 0,
        positions: vec![61.0, 118.0],
        half_width: 18.0,
    };
    let atoms = || KnownAtoms {
        atoms: Atoms {
            positions: mesh.nodes.clone(),
            kinds: kinds.clone(),
        },
        global_ids: None,
        global_count: mesh.nodes.len(),
    };
    let improved = |group: &dyn Comm| {
        let atoms = atoms();
        let joined = (mesh.tets.clone(), neighbors.clone());
        let patience = &CancelToken::never();
        improve_in_slabs(atoms, joined, &cuts, aim, group, patience).unwrap()
    };
    let alone = improved(&SelfComm);
    let SlabResult {
        partition: piece,
        report: improved,
        ..
    } = &improved(&SelfComm);
    assert_eq!(
        (piece.first_cell, piece.global_ids.len()),
        (0, piece.global_counts[0])
    );
    assert!(
        piece
            .global_ids
            .iter()
            .copied()
            .eq(0..piece.global_counts[0] as u32)
    );
    let known = CheckHints {
        neighbors: Some(piece.neighbors.as_flattened()),
        ..CheckHints::default()
    };
    let check = check_with_hints(&piece.mesh, known, [0.0; 3], extent, 1e-12);
    assert!(check.passed(), "{:?}", check.problems);
    assert!(improved.below_target_before > 100 && improved.counts.intersecting_before > 50);
    assert_eq!(improved.below_target_after, 0);
    // Of the planes as much is faces as in a mesh that is not cut.
    let on_planes = |mesh: &TetMesh, marks: &[u8]| -> f64 {
        let faces = mesh.tets.iter().zip(marks).flat_map(|(tet, marks)| {
            let marked = (0..4).filter(move |k| marks >> k & 1 == 1);
            marked.map(move |k| FACES[k].map(|i| mesh.nodes[tet[i] as usize]))
        });
        faces.map(|face| norm(normal(&face))).sum()
    };
    let (mut whole, mut around, mut of_whole) = (mesh.clone(), neighbors.clone(), kinds.clone());
    let (_, marks) = super::super::improve(
        &mut whole,
        &mut around,
        &mut of_whole,
        extent,
        &sheets,
        &distance,
        &target,
        &CancelToken::never(),
    )
    .unwrap();
    let areas = [(&piece.mesh, &alone.feature_faces), (&whole, &marks)];
    let [cut, uncut] = areas.map(|(mesh, marks)| on_planes(mesh, marks));
    assert!(cut > 0.98 * uncut && uncut > 3000.0, "{cut} of {uncut}");

    for count in [2, 3, 5] {
        let all = run_threads(count, |group| {
            let own = improve_in_slabs(
                atoms(),
                (mesh.tets.clone(), neighbors.clone()),
                &cuts,
                aim,
                group,
                &CancelToken::never(),
            );
            let own = own.unwrap();
            let piece = own.partition.clone();
            (piece, own.all_gather(group).unwrap())
        });
        let mut first = 0;
        for (own, whole) in &all {
            assert_eq!(
                (own.first_cell, own.global_counts),
                (first, piece.global_counts),
                "{count}"
            );
            first += own.mesh.tets.len();
            assert!(whole.partition == alone.partition, "{count}");
            assert!(whole.kinds == alone.kinds && whole.feature_faces == alone.feature_faces);
            assert_eq!(whole.report, alone.report);
        }
    }
}

#[test]
fn a_mesh_is_cut_where_slabs_are_thick_and_have_atoms() {
    let atoms = |n: [usize; 3], d: f64| -> Vec<[f64; 3]> {
        let all = (0..n[0] * n[1] * n[2]).map(|i| {
            let at = [i % n[0], i / n[0] % n[1], i / n[0] / n[1]];
            at.map(|i| i as f64 * d)
        });
        all.collect()
    };
    let cut = |n: [usize; 3], d: f64| {
        let extent = n.map(|n| (n - 1) as f64 * d);
        let (atoms, distance) = (atoms(n, d), Distance::Constant(d));
        let alone = SlabCuts::new(&atoms, extent, &distance, &SelfComm).unwrap();
        // The same by several, each of which has some.
        for cuts in run_threads(3, |group| {
            let own = partition_range(atoms.len(), group.rank(), 3);
            SlabCuts::new(&atoms[own], extent, &distance, group).unwrap()
        }) {
            assert_eq!(cuts, alone);
        }
        alone
    };
    assert_eq!(cut([90, 40, 40], 3.0), None, "not thick enough");
    assert_eq!(cut([150, 10, 10], 3.0), None, "too few atoms");
    let cuts = cut([30, 25, 150], 3.0).unwrap();
    assert_eq!((cuts.axis, cuts.count()), (2, 3));
    assert_eq!(
        cuts.first_atom_cuts(),
        [50.0 * 3.0 + 18.0, 100.0 * 3.0 + 18.0]
    );
    let regions = [0.0, 131.0, 132.0, 167.9, 168.0, 281.9, 282.0, 317.9, 318.0]
        .map(|z| cuts.region_index([0.0, 0.0, z]));
    assert_eq!(regions, [0, 0, 1, 1, 2, 2, 3, 3, 4]);
}

#[test]
fn every_slab_has_one_owner() {
    for (slabs, count) in [(1, 1), (3, 2), (4, 4), (2, 7), (5, 3)] {
        let ranges = run_threads(count, |group| slabs_of_rank(slabs, group));
        let all: Vec<usize> = ranges.iter().cloned().flatten().collect();
        assert!(all.into_iter().eq(0..slabs));
        for slab in 0..slabs {
            assert!(ranges[owner(slab, slabs, count)].contains(&slab));
        }
    }
}
