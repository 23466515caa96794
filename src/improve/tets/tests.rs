//! Improves meshes whose result is known.

use super::*;
use crate::feature::FeaturePoint;
use crate::geometry::random::uniform_signed;
use crate::geometry::{cross, norm, volume6};
use crate::lattice::seeding::kind_at;
use crate::mesh::check::check;
use crate::mesh::complex;

/// Returns a box of `n` cells of edge `h` along each axis, with six tetrahedra each (Kuhn). Inner
/// nodes for which `moves` is true are moved by up to `jitter * h`.
pub(super) fn box_mesh(
    n: [usize; 3],
    h: f64,
    jitter: f64,
    moves: impl Fn([f64; 3]) -> bool,
) -> (TetMesh, Vec<AtomKind>, [f64; 3]) {
    let extent = n.map(|n| n as f64 * h);
    let id = |i: usize, j: usize, k: usize| ((k * (n[1] + 1) + j) * (n[0] + 1) + i) as u32;
    let mut nodes = Vec::new();
    for k in 0..=n[2] {
        for j in 0..=n[1] {
            for i in 0..=n[0] {
                let mut x = [i as f64 * h, j as f64 * h, k as f64 * h];
                if moves(x) {
                    let seed = nodes.len() as u64 * 3;
                    for c in 0..3 {
                        if x[c] > 0.0 && x[c] < extent[c] {
                            x[c] += jitter * h * uniform_signed(seed, c as u64);
                        }
                    }
                }
                nodes.push(x);
            }
        }
    }
    let mut tets = Vec::new();
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                for order in [
                    [0, 1, 2],
                    [0, 2, 1],
                    [1, 0, 2],
                    [1, 2, 0],
                    [2, 0, 1],
                    [2, 1, 0],
                ] {
                    let mut at = [i, j, k];
                    let mut tet = [id(i, j, k); 4];
                    for (corner, axis) in order.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[corner + 1] = id(at[0], at[1], at[2]);
                    }
                    let odd = matches!(order, [0, 2, 1] | [1, 0, 2] | [2, 1, 0]);
                    if odd {
                        tet.swap(2, 3);
                    }
                    tets.push(tet);
                }
            }
        }
    }
    let kinds = nodes.iter().map(|&x| kind_at(x, extent)).collect();
    (TetMesh { nodes, tets }, kinds, extent)
}

fn run(
    mesh: &mut TetMesh,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 3],
    planes: &FeaturePlanes,
) -> (ImproveReport, Vec<u8>) {
    let mut neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    improve(
        mesh,
        &mut neighbours,
        kinds,
        ImproveContext {
            extent,
            planes,
            distance: &Distance::Constant(4.5),
            target: Target::default(),
        },
        SharedWork::alone(),
        &CancelToken::never(),
    )
    .unwrap()
}

fn improver<'a>(
    mesh: &TetMesh,
    kinds: &[AtomKind],
    extent: [f64; 3],
    planes: &'a FeaturePlanes,
    distance: &'a Distance<3>,
) -> TetImprover<'a> {
    let (mesh, cancel) = (mesh.clone(), CancelToken::never());
    let neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    let context = ImproveContext {
        extent,
        planes,
        distance,
        target: Target::default(),
    };
    let mut improver = TetImprover::new(mesh, neighbours, kinds, context, &cancel);
    improver.target_sine = 0.5;
    improver
}

/// Checks that fewer than one in `factor` of the `initial` tetrahedra below target remain, and that all
/// sines are up to date.
fn check_progress(improver: &TetImprover<'_>, factor: usize, initial: usize) {
    let remaining = improver.tets_below_target().len();
    assert!(factor * remaining < initial, "{remaining} of {initial}");
    for t in (0..improver.complex.tets.len() as u32).filter(|&t| improver.complex.is_alive(t)) {
        let sine = min_sine(&improver.complex.corners(t)) as f32;
        assert_eq!(improver.sines[t as usize], sine);
    }
}

fn worst(mesh: &TetMesh) -> f64 {
    (0..mesh.tets.len())
        .map(|t| min_sine(&mesh.corners(t)))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn a_jittered_box_becomes_good_and_stays_a_box() {
    let (mut mesh, mut kinds, extent) = box_mesh([7, 6, 5], 4.0, 0.28, |_| true);
    assert!(
        mesh.tets
            .iter()
            .all(|t| volume6(&t.map(|i| mesh.nodes[i as usize])) > 0.0)
    );
    let before = worst(&mesh);
    assert!(before < 0.2);
    let planes = FeaturePlanes::new(&[], extent, 3.0, 8.0);
    let (report, _) = run(&mut mesh, &mut kinds, extent, &planes);
    let checked = check(&mesh, [0.0; 3], extent, 1e-12);
    assert!(checked.passed(), "{:?}", checked.problems);
    assert_eq!(kinds.len(), mesh.nodes.len());
    assert!(
        worst(&mesh) >= 0.5 - 1e-6,
        "{} of {before}: {report:?}",
        worst(&mesh)
    );
    assert!(report.blocked.is_empty());
}

/// Returns the area of the mesh faces in the plane x = `x0`.
fn area_on_plane(mesh: &TetMesh, x0: f64) -> f64 {
    area_within(mesh, x0, 0.12)
}

/// Returns the area of the mesh faces that lie within `tolerance` of the plane x = `x0`.
fn area_within(mesh: &TetMesh, x0: f64, tolerance: f64) -> f64 {
    let mut faces = std::collections::BTreeSet::new();
    for tet in &mesh.tets {
        for f in FACES {
            let mut face = f.map(|i| tet[i]);
            face.sort_unstable();
            if face
                .iter()
                .all(|&i| (mesh.nodes[i as usize][0] - x0).abs() < tolerance)
            {
                faces.insert(face);
            }
        }
    }
    faces
        .iter()
        .map(|f| {
            let p = f.map(|i| mesh.nodes[i as usize]);
            0.5 * norm(cross(sub(p[1], p[0]), sub(p[2], p[0])))
        })
        .sum()
}

fn plane_points(x0: f64, extent: [f64; 3]) -> Vec<FeaturePoint<3>> {
    let mut points = Vec::new();
    for k in 0..=extent[2] as usize {
        for j in 0..=extent[1] as usize {
            points.push(FeaturePoint {
                position: [x0 as f32, j as f32, k as f32],
                normal: [1.0, 0.0, 0.0],
                strength: 1.0,
            });
        }
    }
    points
}

#[test]
fn a_plane_of_faces_survives_improvement() {
    // The plane x = 12 consists of mesh faces; all other nodes are jittered.
    let (mut mesh, mut kinds, extent) = box_mesh([6, 6, 6], 4.0, 0.28, |x| x[0] != 12.0);
    let planes = FeaturePlanes::new(&plane_points(12.0, extent), extent, 3.0, 8.0);
    let area = extent[1] * extent[2];
    assert!((area_on_plane(&mesh, 12.0) - area).abs() < 1e-9);
    let (report, marks) = run(&mut mesh, &mut kinds, extent, &planes);
    assert!(check(&mesh, [0.0; 3], extent, 1e-12).passed());
    assert_eq!(report.counts.intersecting_left, 0);
    assert!((area_on_plane(&mesh, 12.0) - area).abs() < 0.01 * area);
    for (tet, bits) in mesh.tets.iter().zip(marks) {
        for k in (0..4).filter(|k| bits >> k & 1 == 1) {
            for i in FACES[k] {
                assert!((mesh.nodes[tet[i] as usize][0] - 12.0).abs() < 0.11);
            }
        }
    }
    assert!(worst(&mesh) > 0.45, "{}", worst(&mesh));
}

#[test]
fn a_plane_that_cuts_through_cells_is_recovered() {
    // No node lies on x = 13.3: edges are split, snapped or flipped until faces cover the plane.
    let (mut mesh, mut kinds, extent) = box_mesh([7, 6, 6], 4.0, 0.1, |_| true);
    let planes = FeaturePlanes::new(&plane_points(13.3, extent), extent, 3.0, 8.0);
    let (report, marks) = run(&mut mesh, &mut kinds, extent, &planes);
    assert!(report.counts.intersecting_before > 50);
    assert_eq!(report.counts.intersecting_left, 0);
    assert!(check(&mesh, [0.0; 3], extent, 1e-12).passed());
    let area = extent[1] * extent[2];
    assert!((area_on_plane(&mesh, 13.3) - area).abs() < 0.01 * area);
    // Every face is marked from both sides.
    let face_count = marks.iter().map(|bits| bits.count_ones()).sum::<u32>() / 2;
    assert!(face_count > 40, "{face_count} {report:?}");
    assert!(worst(&mesh) > 0.3, "{} {report:?}", worst(&mesh));
}

#[test]
fn exudation_keeps_the_faces_on_a_plane_and_removes_slivers() {
    let (mesh, kinds, extent) = box_mesh([7, 6, 6], 4.0, 0.1, |x| x[0] != 12.0);
    let planes = FeaturePlanes::new(&plane_points(12.0, extent), extent, 3.0, 8.0);
    let neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    let (mut exuded, mut exuded_kinds) = (mesh.clone(), kinds);
    let (report, marks) = exude::exude(
        &mut exuded,
        neighbours,
        &mut exuded_kinds,
        ImproveContext {
            extent,
            planes: &planes,
            distance: &Distance::Constant(4.5),
            target: Target::default(),
        },
        SharedWork::alone(),
        &CancelToken::never(),
    )
    .unwrap();
    assert_eq!(exuded.nodes, mesh.nodes, "no node moves");
    assert!(check(&exuded, [0.0; 3], extent, 1e-12).passed());
    let area = extent[1] * extent[2];
    assert!((area_on_plane(&exuded, 12.0) - area).abs() < 1e-9 * area);
    assert!(marks.iter().any(|&bits| bits != 0));
    let delaunay = TetMesh {
        tets: crate::mesh::delaunay::delaunay(&mesh.nodes).unwrap().tets,
        ..mesh
    };
    let count_below_target = |mesh: &TetMesh| {
        let sines = (0..mesh.tets.len()).map(|t| min_sine(&mesh.corners(t)));
        sines.filter(|&sine| sine < 0.5).count()
    };
    let (before, after) = (count_below_target(&delaunay), count_below_target(&exuded));
    assert_eq!(report.blocked.len(), after);
    assert!(2 * after < before, "{before} to {after}");
}

#[test]
fn a_wide_gap_between_two_surfaces_gets_nodes_and_the_surfaces_stay_whole() {
    // No node lies between the surfaces, which are two spacings apart. All tetrahedra between them
    // are too steep, and no single flip, collapse or split improves them.
    let h = 4.0;
    let is_on_surface = |x: f64| x == h || x == 2.0 * h;
    let (mut mesh, mut kinds, mut extent) = box_mesh([3, 6, 6], h, 0.1, |x| !is_on_surface(x[0]));
    for x in &mut mesh.nodes {
        x[0] += if x[0] > 1.5 * h { h } else { 0.0 };
    }
    extent[0] += h;
    let mut points = plane_points(h, extent);
    points.extend(plane_points(3.0 * h, extent));
    let planes = FeaturePlanes::new(&points, extent, 3.0, 8.0);
    assert!(worst(&mesh) < 0.45);
    let (report, _) = run(&mut mesh, &mut kinds, extent, &planes);
    assert!(check(&mesh, [0.0; 3], extent, 1e-12).passed());
    assert!(report.blocked.is_empty(), "{report:?}");
    assert!(worst(&mesh) > 0.4999, "{}", worst(&mesh));
    for x0 in [h, 3.0 * h] {
        let area = area_within(&mesh, x0, MAX_DEVIATIONS[1] + 0.02) / (extent[1] * extent[2]);
        assert!((area - 1.0).abs() < 0.01, "{area}");
    }
}

#[test]
fn repair_in_patches_is_consistent_for_any_number_of_threads() {
    let (mesh, kinds, extent) = box_mesh([24, 10, 10], 2.0, 0.28, |_| true);
    let planes = FeaturePlanes::new(&[], extent, 3.0, 8.0);
    let repaired = |threads: usize| {
        let distance = Distance::Constant(1.5);
        let cancel = CancelToken::never();
        let mut improver = improver(&mesh, &kinds, extent, &planes, &distance);
        let below_target = improver.tets_below_target();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let cube_groups = improver.cubes(&below_target, 15.0);
        assert!(cube_groups[0].len() > 1);
        let repair = || improver.repair_in_patches(cube_groups, 15.0, &cancel, &|_| {});
        let deferred = pool.build().unwrap().install(repair).unwrap();
        assert!(10 * deferred.len() < below_target.len());
        check_progress(&improver, 2, below_target.len());
        improver.complex.into_mesh()
    };
    let (serial, neighbours, _) = repaired(1);
    assert!(check(&serial, [0.0; 3], extent, 1e-12).passed());
    assert!(neighbours == complex::neighbours(serial.nodes.len(), &serial.tets).unwrap());
    let (parallel, ..) = repaired(3);
    assert!(serial.nodes == parallel.nodes && serial.tets == parallel.tets);
}

#[test]
fn smoothing_is_the_same_for_any_number_of_threads_and_groups_share_no_tetrahedron() {
    let (mesh, kinds, extent) = box_mesh([12, 10, 10], 2.0, 0.28, |_| true);
    let planes = FeaturePlanes::new(&[], extent, 3.0, 8.0);
    let improved = |threads: usize| {
        let distance = Distance::Constant(1.5);
        let cancel = CancelToken::never();
        let mut improver = improver(&mesh, &kinds, extent, &planes, &distance);
        let below_target = improver.tets_below_target();
        let nodes: Vec<u32> = (0..mesh.nodes.len() as u32).collect();
        let groups = {
            let stars = improver.collect_node_tets(&nodes);
            improver.independent_groups(&nodes, &stars)
        };
        assert_eq!(groups.iter().map(Vec::len).sum::<usize>(), nodes.len());
        for group in &groups {
            let mut in_group = vec![false; nodes.len()];
            group.iter().for_each(|&i| in_group[i as usize] = true);
            let count = |tet: &[u32; 4]| tet.iter().filter(|&&n| in_group[n as usize]).count();
            assert!(mesh.tets.iter().all(|tet| count(tet) <= 1));
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let run = || improver.flip_and_smooth(3, &cancel);
        pool.build().unwrap().install(run).unwrap();
        assert!(improver.counts.flips > 100 && improver.counts.moves > 100);
        check_progress(&improver, 4, below_target.len());
        improver.complex.into_mesh()
    };
    let (serial, neighbours, _) = improved(1);
    assert!(check(&serial, [0.0; 3], extent, 1e-12).passed());
    assert!(neighbours == complex::neighbours(serial.nodes.len(), &serial.tets).unwrap());
    let (parallel, ..) = improved(3);
    assert!(serial.nodes == parallel.nodes && serial.tets == parallel.tets);
}
