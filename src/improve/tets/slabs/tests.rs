//! Slabs give the same mesh for one rank and for several.

use super::super::tests::box_mesh;
use super::*;
use crate::comm::{Comm, SelfComm, partition_range, run_threads};
use crate::feature::FeaturePoint;
use crate::geometry::grid_index::index_at;
use crate::geometry::{norm, normal};
use crate::improve::Target;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::tets::SharedWork;
use crate::lattice::distance::Distance;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::complex;

/// Returns the plane x + y / 2 = `x0` as points of a feature.
fn plane_points(x0: f32, extent: [f64; 3]) -> Vec<FeaturePoint<3>> {
    let [_, y, z] = extent.map(|e| e as usize);
    let length = 1.25f32.sqrt();
    let points = (0..=z).flat_map(|k| {
        (0..=y).map(move |j| FeaturePoint {
            position: [x0 - 0.5 * j as f32, j as f32, k as f32],
            normal: [1.0 / length, 0.5 / length, 0.0],
            strength: 1.0,
        })
    });
    points.collect()
}

/// Returns the area of the marked faces of a mesh.
fn area_on_features(mesh: &TetMesh, marks: &[u8]) -> f64 {
    let faces = mesh.tets.iter().zip(marks).flat_map(|(tet, marks)| {
        let marked = (0..4).filter(move |k| marks >> k & 1 == 1);
        marked.map(move |k| FACES[k].map(|i| mesh.nodes[tet[i] as usize]))
    });
    faces.map(|face| norm(normal(&face))).sum()
}

/// Checks that faces cover the planes as well as in a mesh that is not cut.
fn assert_faces_cover_planes(
    cut: &SlabResult,
    mesh: &TetMesh,
    neighbours: &[[u32; 4]],
    kinds: &[AtomKind],
    context: ImproveContext<'_>,
) {
    let (mut mesh, mut neighbours, mut kinds) = (mesh.clone(), neighbours.to_vec(), kinds.to_vec());
    let (work, cancel) = (SharedWork::alone(), &CancelToken::never());
    let (mesh, neighbours) = (&mut mesh, &mut neighbours);
    let (_, marks) =
        super::super::improve(mesh, neighbours, &mut kinds, context, work, cancel).unwrap();
    let uncut_area = area_on_features(mesh, &marks);
    let cut_area = area_on_features(&cut.partition.mesh, &cut.feature_faces);
    assert!(
        cut_area > 0.98 * uncut_area && uncut_area > 3000.0,
        "{cut_area} of {uncut_area}"
    );
}

#[test]
fn slabs_give_the_same_mesh_for_any_number_of_ranks() {
    let (mesh, kinds, extent) = box_mesh([45, 7, 6], 4.0, 0.28, |_| true);
    let neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    // One plane in the middle of a slab, and two planes that cross a cut.
    let points = [40.0, 72.0, 123.0]
        .map(|x0| plane_points(x0, extent))
        .concat();
    let planes = FeaturePlanes::new(&points, extent, 3.6, 5.0);
    let distance = Distance::Constant(4.5);
    let context = ImproveContext {
        extent,
        planes: &planes,
        distance: &distance,
        target: Target::default(),
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
    let improve = |comm: &dyn Comm| {
        let atoms = atoms();
        let (tets, neighbours) = (mesh.tets.clone(), neighbours.clone());
        let cancel = &CancelToken::never();
        DistributedSlabs::new(cuts.clone(), comm)
            .improve(atoms, tets, neighbours, context, cancel)
            .unwrap()
    };
    let serial = improve(&SelfComm);
    let SlabResult {
        partition, report, ..
    } = &serial;
    assert_eq!(
        (partition.first_cell, partition.global_ids.len()),
        (0, partition.global_counts[0])
    );
    let all_nodes = 0..partition.global_counts[0] as u32;
    assert!(partition.global_ids.iter().copied().eq(all_nodes));
    let hints = CheckHints {
        neighbours: Some(partition.neighbours.as_flattened()),
        ..CheckHints::default()
    };
    let checked = check_with_hints(&partition.mesh, hints, [0.0; 3], extent, 1e-12);
    assert!(checked.passed(), "{:?}", checked.problems);
    assert!(report.below_target_before > 100 && report.counts.intersecting_before > 50);
    assert!(report.blocked.is_empty());
    assert_faces_cover_planes(&serial, &mesh, &neighbours, &kinds, context);

    for count in [2, 3, 5] {
        let results = run_threads(count, |comm| {
            let (local, slabs) = (improve(comm), DistributedSlabs::new(cuts.clone(), comm));
            (local.partition.clone(), slabs.all_gather(local).unwrap())
        });
        let mut first = 0;
        for (local, gathered) in &results {
            assert_eq!(
                (local.first_cell, local.global_counts),
                (first, partition.global_counts),
                "{count}"
            );
            first += local.mesh.tets.len();
            assert!(gathered.partition == serial.partition, "{count}");
            assert!(
                gathered.kinds == serial.kinds && gathered.feature_faces == serial.feature_faces
            );
            assert_eq!(gathered.report, serial.report);
        }
    }
}

#[test]
fn a_mesh_is_cut_where_slabs_are_thick_and_have_atoms() {
    let atoms = |n: [usize; 3], d: f64| -> Vec<[f64; 3]> {
        let all = (0..n[0] * n[1] * n[2]).map(|i| {
            let at = index_at(n, i);
            at.map(|i| i as f64 * d)
        });
        all.collect()
    };
    let cut = |n: [usize; 3], d: f64| {
        let extent = n.map(|n| (n - 1) as f64 * d);
        let (atoms, distance) = (atoms(n, d), Distance::Constant(d));
        let serial = DistributedSlabs::cut(&atoms, extent, &distance, &SelfComm).unwrap();
        let serial = serial.map(|slabs| slabs.cuts);
        // Several ranks with a part of the atoms each find the same cuts.
        for cuts in run_threads(3, |comm| {
            let range = partition_range(atoms.len(), comm.rank(), 3);
            let slabs = DistributedSlabs::cut(&atoms[range], extent, &distance, comm).unwrap();
            slabs.map(|slabs| slabs.cuts)
        }) {
            assert_eq!(cuts, serial);
        }
        serial
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
        let cuts = SlabCuts {
            axis: 0,
            positions: vec![0.0; slabs - 1],
            half_width: 0.0,
        };
        let owned = run_threads(count, |comm| {
            let slabs = DistributedSlabs::new(cuts.clone(), comm);
            let owns = |&slab: &usize| slabs.owner(slab) == comm.rank();
            assert!((0..slabs.cuts.count()).filter(owns).eq(slabs.local_slabs()));
            slabs.local_slabs()
        });
        assert!(owned.into_iter().flatten().eq(0..slabs));
    }
}
