use super::*;
use crate::geometry::sorted_distinct;
use crate::mesh::check::check;
use crate::mesh::check::{Check, CheckHints, check_with_hints};
use crate::mesh::graph::Graph;
use proptest::prelude::*;

/// Returns a uniform random number in [0, 1), from a simple generator that is good enough for
/// tests.
fn uniform(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

fn random_points(n: usize, extent: [f64; 3], seed: u64) -> Vec<[f64; 3]> {
    let mut state = seed;
    (0..n)
        .map(|_| extent.map(|e| e * (0.001 + 0.998 * uniform(&mut state))))
        .collect()
}

/// Returns the sites (i, j, k) for which i + j + k is a multiple of `parity`, with spacing `h` and
/// `counts` of them along each axis, and the extent of the box. The box leaves `offset` steps
/// before the first site and the remainder after the last. Sites are moved at random by up to
/// `jitter` steps.
fn lattice(
    counts: [usize; 3],
    parity: usize,
    h: f64,
    offset: f64,
    jitter: f64,
) -> (Vec<[f64; 3]>, [f64; 3]) {
    let mut state = 7;
    let mut atoms = Vec::new();
    for k in 0..counts[2] {
        for j in 0..counts[1] {
            for i in 0..counts[0] {
                if (i + j + k) % parity == 0 {
                    atoms.push([i, j, k].map(|c| {
                        (c as f64 + offset + jitter * (2.0 * uniform(&mut state) - 1.0)) * h
                    }));
                }
            }
        }
    }
    (atoms, counts.map(|n| n as f64 * h))
}

/// Returns the cells after checking that they are valid and fill the box, and that faces are normal
/// to their connections.
fn checked_cells(atoms: &[[f64; 3]], extent: [f64; 3]) -> PolyMesh<3> {
    let mesh = voronoi(atoms, extent).unwrap();
    let report = check(&mesh, [0.0; 3], extent, 1e-9);
    assert!(report.passed(), "{:?}", report.problems);
    assert!(
        report.volume_error < 1e-12 && report.area_error < 1e-12,
        "{report:?}"
    );
    assert_eq!(report.flatness_error, 0.0);
    let graph = Graph::from_poly(&mesh);
    let mean = graph.connections.iter().map(|c| c.area).sum::<f64>()
        / graph.connections.len().max(1) as f64;
    for c in &graph.connections {
        let [a, b] = c.cells.map(|i| mesh.sites[i as usize]);
        assert!(c.distance[0] > 0.0 && c.distance[1] > 0.0, "{c:?}");
        // The face is half-way between the sites, and as close to normal as its size allows.
        assert!((c.distance[0] / c.distance[1] - 1.0).abs() < 1e-6, "{c:?}");
        if c.area > 1e-6 * mean {
            assert!(c.angle_error(&mesh.sites) < 1e-5, "{c:?} {a:?} {b:?}");
        }
    }
    mesh
}

/// Asserts that volumes and centroids of all cells agree with those of another program, relative to
/// the mean volume.
fn assert_like_meshless(atoms: &[[f64; 3]], extent: [f64; 3], mesh: &PolyMesh<3>) {
    use glam::DVec3;
    use meshless_voronoi::{Dimensionality, Voronoi};
    let points: Vec<DVec3> = atoms.iter().map(|&x| DVec3::from(x)).collect();
    let by_meshless = Voronoi::build(
        &points,
        DVec3::ZERO,
        DVec3::from(extent),
        Dimensionality::ThreeD,
        false,
    );
    let mean = extent.iter().product::<f64>() / atoms.len() as f64;
    let shapes = mesh.cell_shapes();
    for (cell, other_cell) in by_meshless.cells().iter().enumerate() {
        let error = (shapes[cell].0 - other_cell.volume()).abs() / mean;
        assert!(error < 1e-11, "cell {cell}: {error}");
        let distance = DVec3::from(shapes[cell].1).distance(other_cell.centroid());
        assert!(
            distance < 1e-9 * mean.cbrt() * (1.0 + mean / shapes[cell].0),
            "cell {cell}: {distance}"
        );
    }
}

#[test]
fn the_cell_of_one_atom_is_the_box() {
    let mesh = checked_cells(&[[1.0, 0.5, 2.0]], [3.0, 2.0, 4.0]);
    assert_eq!((mesh.nodes.len(), mesh.face_cells.len()), (8, 6));
    assert_eq!(mesh.cell_shapes()[0].0, 24.0);
}

#[test]
fn random_atoms_have_the_cells_that_another_program_finds() {
    for n in [2, 3, 5, 20, 1000] {
        let extent = [7.0, 11.0, 13.3];
        let atoms = random_points(n, extent, n as u64);
        assert_like_meshless(&atoms, extent, &checked_cells(&atoms, extent));
    }
}

#[test]
fn lattices_have_the_cells_that_another_program_finds() {
    for parity in [1, 2] {
        for jitter in [0.0, 1e-13, 1e-9, 1e-7, 0.05] {
            let (atoms, extent) = lattice([8, 7, 6], parity, 0.7, 0.5, jitter);
            let mesh = checked_cells(&atoms, extent);
            // The other program fails for points that are cospherical up to rounding.
            if jitter >= 1e-7 {
                assert_like_meshless(&atoms, extent, &mesh);
            }
        }
    }
}

#[test]
fn cubic_lattices_have_cubes_and_centred_ones_rhombic_dodecahedra() {
    for (parity, faces, nodes) in [(1, 6, 8), (2, 12, 14)] {
        // 0.7 is not a dyadic fraction: points are cospherical only up to rounding.
        let (atoms, extent) = lattice([9, 9, 9], parity, 0.7, 0.5, 0.0);
        let mesh = checked_cells(&atoms, extent);
        let lists = mesh.faces_of_cells();
        let is_inside = |x: &[f64; 3]| x.iter().all(|&c| c > 1.4 && c < 4.9);
        let mut count = 0;
        for cell in (0..atoms.len()).filter(|&i| is_inside(&atoms[i])) {
            let list = lists.get(cell);
            let cell_nodes = sorted_distinct(
                list.iter()
                    .flat_map(|&f| mesh.faces.get(f as usize).to_vec()),
            );
            assert_eq!((list.len(), cell_nodes.len()), (faces, nodes));
            assert!(list.iter().all(|&f| mesh.faces.get(f as usize).len() == 4));
            let volume = parity as f64 * 0.7f64.powi(3);
            assert!((mesh.cell_shapes()[cell].0 / volume - 1.0).abs() < 1e-12);
            count += 1;
        }
        assert!(count > 30);
    }
}

#[test]
fn rotated_lattices_have_no_faces_from_rounding() {
    // A centred lattice rotated about (1, 1, 1), so that nothing about it is exact.
    let (s, c) = (0.6f64, 0.8f64);
    let third = (1.0 - c) / 3.0;
    let (p, q) = (third - s / 3f64.sqrt(), third + s / 3f64.sqrt());
    let rotation = [[c + third, p, q], [q, c + third, p], [p, q, c + third]];
    let extent = [6.0, 6.5, 7.0];
    let mut atoms = Vec::new();
    for index in 0..41 * 41 * 41 {
        let x = [index % 41, index / 41 % 41, index / 1681].map(|c| c - 20);
        let position: [f64; 3] = std::array::from_fn(|k| {
            3.3 + 0.7
                * (0..3)
                    .map(|l| rotation[k][l] * f64::from(x[l]))
                    .sum::<f64>()
        });
        if (x[0] + x[1] + x[2]) % 2 == 0
            && (0..3).all(|k| position[k] > 0.0 && position[k] < extent[k])
        {
            atoms.push(position);
        }
    }
    let mesh = checked_cells(&atoms, extent);
    assert_like_meshless(&atoms, extent, &mesh);
    let lists = mesh.faces_of_cells();
    let is_inside = |x: &[f64; 3]| (0..3).all(|k| x[k] > 1.2 && x[k] < extent[k] - 1.2);
    for cell in (0..atoms.len()).filter(|&i| is_inside(&atoms[i])) {
        assert_eq!(lists.get(cell).len(), 12);
    }
}

#[test]
fn crowded_and_empty_places_in_one_box_are_cut_exactly() {
    // Nearly all atoms are in one corner, so some cells extend across the whole box.
    let extent = [20.0, 20.0, 20.0];
    let mut atoms = random_points(300, [1.0, 1.0, 1.0], 5);
    atoms.push([15.0, 3.0, 19.9999]);
    assert_like_meshless(&atoms, extent, &checked_cells(&atoms, extent));
    // A flat box, with a row of atoms along its middle.
    let extent = [50.0, 3.0, 0.02];
    let row: Vec<[f64; 3]> = (0..25)
        .map(|i| [2.0 * f64::from(i) + 1.0, 1.5, 0.01])
        .collect();
    let mesh = checked_cells(&row, extent);
    assert!(
        mesh.cell_shapes()
            .iter()
            .all(|s| (s.0 - 0.12).abs() < 1e-13)
    );
}

#[test]
fn atoms_near_a_side_touch_it_exactly() {
    for height in [1e-3, 1e-6, 1e-9] {
        let mut atoms = random_points(200, [10.0; 3], 3);
        atoms.push([4.0, 5.0, height]);
        atoms.push([10.0 - height, 5.0, 10.0 - 2.0 * height]);
        checked_cells(&atoms, [10.0; 3]);
    }
}

#[test]
fn polygons_fill_their_rectangle() {
    let extent = [9.0, 5.0];
    let mut state = 4;
    for n in [1, 2, 7, 400] {
        let atoms: Vec<[f64; 2]> = (0..n)
            .map(|_| extent.map(|e| e * (0.001 + 0.998 * uniform(&mut state))))
            .collect();
        let mesh = voronoi_plane(&atoms, extent).unwrap();
        let report = check(&mesh, [0.0; 2], extent, 1e-9);
        assert!(report.passed() && report.volume_error < 1e-12, "{report:?}");
        assert!(Graph::from_poly(&mesh).angle_errors().0 < 1e-4);
    }
}

/// Returns the fraction of connections smaller than `limit` times the mean, the number of
/// connections, and the largest angle between normal and connection of the faces above a hundredth
/// of the mean.
fn small_faces<const D: usize>(mesh: &PolyMesh<D>, limit: f64) -> (f64, usize, f64) {
    let graph = Graph::from_poly(mesh);
    let count = graph.connections.len();
    let mean = graph.connections.iter().map(|c| c.area).sum::<f64>() / count as f64;
    let small = graph.connections.iter().filter(|c| c.area < limit * mean);
    let large = graph.connections.iter().filter(|c| c.area > 0.01 * mean);
    let angle = large
        .map(|c| c.angle_error(&graph.site))
        .fold(0.0, f64::max);
    (small.count() as f64 / count as f64, count, angle)
}

/// Checks cells whose nodes are welded.
fn check_welded<const D: usize>(mesh: &PolyMesh<D>, extent: [f64; D], weld: f64) -> Check {
    let hints = CheckHints {
        weld,
        ..CheckHints::default()
    };
    check_with_hints(mesh, hints, [0.0; D], extent, 1e-9)
}

#[test]
fn welding_removes_small_faces_and_keeps_cells_valid() {
    let (atoms, extent) = lattice([14, 14, 14], 2, 1.0, 0.5, 0.05);
    let exact = checked_cells(&atoms, extent);
    let before = small_faces(&exact, 1e-4);
    let mut last = before.1;
    for weld in [1e-3, 1e-2, 5e-2] {
        let mesh = voronoi_welded(&atoms, extent, weld).unwrap();
        let report = check_welded(&mesh, extent, weld);
        assert!(report.passed(), "{weld}: {:?}", report.problems);
        assert!(
            report.volume_error < 1e-12 && report.area_error < 1e-12,
            "{report:?}"
        );
        assert_eq!(report.flatness_error, 0.0);
        let (tiny, count, angle) = small_faces(&mesh, 1e-4);
        assert!(count < last, "{weld}: {count} of {last}");
        // Two nodes of one face may both move, and the face may be small.
        assert!(angle < 20.0 * weld.to_degrees(), "{weld}: {angle}");
        if weld == 5e-2 {
            assert!(before.0 > 1e-3 && tiny == 0.0, "{before:?} {tiny}");
        }
        last = count;
    }
    // Random atoms, with cells of all sizes at the sides of the box.
    for (seed, weld) in (0..48).zip([2e-3, 1e-2, 5e-2, 0.2].into_iter().cycle()) {
        let (atoms, extent) = (random_points(400, [5.0, 4.0, 3.0], seed), [5.0, 4.0, 3.0]);
        let mesh = voronoi_welded(&atoms, extent, weld).unwrap();
        let report = check_welded(&mesh, extent, weld);
        assert!(
            report.passed() && report.volume_error < 1e-12,
            "seed {seed}, {weld}: {:?}",
            report.problems
        );
        assert_eq!(report.flatness_error, 0.0);
    }
    // Perfect lattices do not change.
    let (atoms, extent) = lattice([8, 8, 8], 2, 1.0, 0.5, 0.0);
    assert_eq!(
        voronoi_welded(&atoms, extent, 0.05).unwrap(),
        voronoi(&atoms, extent).unwrap()
    );
    // For any weld radius: cells that would break keep their nodes.
    let (atoms, extent) = (random_points(300, [5.0; 3], 3), [5.0; 3]);
    let count = |mesh: &PolyMesh<3>| mesh.face_cells.len();
    let mut last = count(&voronoi(&atoms, extent).unwrap());
    for weld in [0.02, 0.1, 0.2] {
        let mesh = voronoi_welded(&atoms, extent, weld).unwrap();
        let report = check_welded(&mesh, extent, weld);
        assert!(report.passed(), "{weld}: {:?}", report.problems);
        assert!(report.volume_error < 1e-12, "{weld}: {report:?}");
        assert!(count(&mesh) < last, "{weld}");
        last = count(&mesh);
    }
}

#[test]
fn short_edges_of_polygons_are_welded() {
    let extent = [9.0, 5.0];
    let mut state = 4;
    let atoms: Vec<[f64; 2]> = (0..500)
        .map(|_| extent.map(|e| e * (0.001 + 0.998 * uniform(&mut state))))
        .collect();
    let before = small_faces(&voronoi_plane(&atoms, extent).unwrap(), 0.02);
    let mesh = voronoi_plane_welded(&atoms, extent, 0.03).unwrap();
    let report = check_welded(&mesh, extent, 0.03);
    assert!(report.passed() && report.volume_error < 1e-12, "{report:?}");
    let after = small_faces(&mesh, 0.02);
    assert!(
        before.0 > 0.01 && after.0 < 0.2 * before.0,
        "{before:?} {after:?}"
    );
}

#[test]
fn bad_atoms_are_named() {
    let refusal = |atoms: &[[f64; 3]]| voronoi(atoms, [4.0; 3]).unwrap_err().to_string();
    assert!(refusal(&[]).contains("0 atoms"));
    for bad in [0.0, 4.0, -1.0, f64::NAN] {
        let message = refusal(&[[1.0; 3], [2.0, bad, 2.0]]);
        assert!(
            message.contains("atom 1") && message.contains("not inside"),
            "{message}"
        );
    }
    let message = refusal(&[[1.0; 3], [2.0; 3], [1.0; 3]]);
    assert!(
        message.contains("points 0 and 2 are 0e0 apart") || message.contains("points 2 and 0"),
        "{message}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// Atoms on a coarse grid, where all degeneracies can occur, or moved off it.
    #[test]
    fn any_atoms_fill_their_box(
        cells in prop::collection::hash_set((0u8..6, 0u8..5, 0u8..4), 1..60),
        shift in prop_oneof![Just(0.0), Just(1e-5), Just(1e-8), Just(1e-10), Just(1e-12), Just(1e-14), 0.0..0.4],
        seed in 0u64..1000,
    ) {
        let mut cells: Vec<_> = cells.into_iter().collect();
        cells.sort_unstable();
        let mut state = seed;
        let atoms: Vec<[f64; 3]> = cells
            .iter()
            .map(|&(i, j, k)| {
                [i, j, k].map(|c| 0.3 * (f64::from(c) + 0.5 + shift * (uniform(&mut state) - 0.5)))
            })
            .collect();
        checked_cells(&atoms, [1.8, 1.5, 1.2]);
    }
}
