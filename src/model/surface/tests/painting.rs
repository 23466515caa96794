//! Tests of the cells between surfaces: blocks, paint, enclosing facets.

use super::*;

#[test]
fn cells_have_volumes_and_links() {
    let mesh: TetMesh = cubes([3, 2, 2]);
    let cells = cells(&mesh, &[]);
    assert_eq!(
        (cells.len(), cells.links.len()),
        (72, (72 * 4 - 2 * 32) / 2)
    );
    assert!((cells.volumes.iter().sum::<f64>() - 12.0).abs() < 1e-12);
    for c in 0..72 {
        for (l, link, n) in cells.links_of(c) {
            assert!(link.cells.contains(&c) && link.cells.contains(&n) && n != c);
            assert_eq!(cells.links[l], *link);
        }
    }
    for x in [[0.9, 0.2, 0.1], [0.2, 0.9, 0.3]] {
        assert!(cell_at(&mesh, x) < 6);
    }
    let face_cells = mesh.cells_of_faces().unwrap();
    assert_eq!(find_cell(&mesh, &face_cells, [3.1, 1.0, 1.0]), None);
    let duplicated = TetMesh {
        tets: [mesh.tets.clone(), mesh.tets[..1].to_vec()].concat(),
        ..mesh
    };
    assert!(duplicated.cells_of_faces().is_err());
}

#[test]
fn find_cell_returns_the_cell_of_the_nearest_site_despite_tiny_faces() {
    let mut seed = 7;
    for offset in [1e-9, 1e-7, 1e-5] {
        let mut sites = cube_sites([4, 4, 4]);
        for x in sites.iter_mut().flatten() {
            *x += offset * (random(&mut seed) - 0.5);
        }
        let mesh = crate::mesh::voronoi::voronoi(&sites, [4.0; 3]).unwrap();
        let face_cells = mesh.cells_of_faces().unwrap();
        for _ in 0..500 {
            let x: [f64; 3] = std::array::from_fn(|_| 4.0 * random(&mut seed));
            let distance = |cell: usize| norm(geometry::sub(sites[cell], x));
            let found_distance = find_cell(&mesh, &face_cells, x).map(|c| distance(c as usize));
            let min_distance = (0..sites.len()).map(distance).fold(f64::INFINITY, f64::min);
            assert!(
                found_distance.is_some_and(|d| d < min_distance + 1e-4),
                "{offset}: {x:?}"
            );
        }
    }
}

/// Checks paint in three layers of this thickness, with a crack between two of them.
fn check_paint_fills_layer<const D: usize, F: Mesh<D>>(mesh: &F, thickness: f64) {
    let vertical = D - 1;
    let is_crack = |x: [f64; D]| (0..vertical).all(|k| (x[k] - 6.5).abs() < 0.5);
    let mut closed = plane_facets(mesh, vertical, thickness, |_| false);
    closed.extend(plane_facets(mesh, vertical, 2.0 * thickness, is_crack));
    closed.sort_unstable();
    let cells = cells(mesh, &closed);
    let geodesics = Geodesics::new(mesh, &mesh.cells_of_faces().unwrap(), &cells);
    let layer = |c: usize| (cells.centres[c][vertical] / thickness) as u32;
    let point = |x: [f64; 3]| -> [f64; D] {
        std::array::from_fn(|k| {
            if k == vertical {
                x[2] * thickness / 6.0
            } else {
                x[k]
            }
        })
    };
    let seed = |x, label| GeodesicSource {
        position: point(x),
        cell: cell_at(mesh, point(x)),
        label,
    };

    let (block, count) = blocks(&cells, 0.3, 10);
    assert_eq!(count, 3, "{D}-D, {} cells", cells.len());
    assert_eq!(blocks(&cells, 0.0, 10).1, 2, "any opening joins");
    let seeds = [seed([2.0, 3.0, 9.0], 7), seed([2.0, 3.0, 1.0], 5)];
    let arrivals = grow(&geodesics, &block, None, &seeds, f64::INFINITY);
    let (labels, costs) = (arrivals.label, arrivals.cost);
    // The two layers on either side of the crack may be separated a step before or behind it.
    for c in 0..cells.len() {
        let expected = [Some(5), Some(7), None][layer(c) as usize];
        assert_eq!(costs[c].is_finite(), labels[c].is_some());
        let crack_offset =
            |k: usize| cells.centres[c][k] - if k == vertical { 2.0 * thickness } else { 6.5 };
        let distance = (0..D).map(|k| crack_offset(k).powi(2)).sum::<f64>().sqrt();
        assert!(
            labels[c] == expected || distance < 2.0,
            "leaked {distance} from the crack"
        );
    }

    // Two seeds in one layer share it: each side is nearer to its own seed.
    let seed_pair = [seed([1.5, 6.2, 1.4], 1), seed([10.5, 6.2, 1.4], 2)];
    let labels = grow(&geodesics, &block, None, &seed_pair, f64::INFINITY).label;
    let labelled_volume = |u| {
        let label_cells = (0..cells.len()).filter(|&c| labels[c] == Some(u));
        label_cells.map(|c| cells.volumes[c]).sum::<f64>()
    };
    let layer_volume = thickness * 12f64.powi(vertical as i32);
    assert!((labelled_volume(1) + labelled_volume(2) - layer_volume).abs() < 1e-9);
    assert!(
        (2.0 * labelled_volume(1) / layer_volume - 1.0).abs() < 0.05,
        "{}",
        labelled_volume(1)
    );

    // Paint stops at its level.
    let arrivals = grow(&geodesics, &block, None, &seed_pair[..1], 3.0);
    let (labels, costs) = (arrivals.label, arrivals.cost);
    assert!(costs.iter().filter(|a| a.is_finite()).all(|&a| a <= 3.0));
    assert!(
        labels.contains(&Some(1))
            && labels.iter().filter(|u| u.is_none()).count() > cells.len() / 2
    );
}

#[test]
fn paint_fills_the_layer_of_its_seed_and_no_more() {
    check_paint_fills_layer::<3, TetMesh>(&cubes([12, 12, 18]), 6.0);
    check_paint_fills_layer::<2, TriMesh>(&cubes([12, 36]), 12.0);
    check_paint_fills_layer::<3, PolyMesh<3>>(&boxes([12, 12, 36]), 12.0);
    check_paint_fills_layer::<2, PolyMesh<2>>(&squares([12, 36]), 12.0);
}

#[test]
fn compartments_with_a_wide_opening_are_one_block() {
    // A wall through half of the box: the opening at its end is as wide as the compartments.
    let mesh: TetMesh = cubes([16, 8, 4]);
    let half_wall = plane_facets(&mesh, 1, 4.0, |x| x[0] > 8.0);
    assert_eq!(blocks(&cells(&mesh, &half_wall), 0.3, 10).1, 1);
    // A door of one cube in a complete wall is a crack.
    let wall_with_door = plane_facets(&mesh, 1, 4.0, |x| {
        (7.0..8.0).contains(&x[0]) && (1.0..2.0).contains(&x[2])
    });
    assert_eq!(blocks(&cells(&mesh, &wall_with_door), 0.3, 10).1, 2);
    // Without walls, the clearance is infinite and all cells are one block.
    let open = cells(&mesh, &[]);
    assert!(clearance(&open).iter().all(|c| c.is_infinite()));
    assert_eq!(blocks(&open, 0.3, 10), (vec![0; open.len()], 1));
}

#[test]
fn small_blocks_join_their_neighbour() {
    let mesh: TetMesh = cubes([6, 6, 6]);
    // Closed facets enclose one tetrahedron.
    let enclosed = mesh.tets[500];
    let closed =
        facet_selection::facets_where(&mesh, |_, face| face.iter().all(|n| enclosed.contains(n)));
    let cells = cells(&mesh, &closed);
    assert_eq!(blocks(&cells, 0.3, 0).1, 2);
    assert_eq!(blocks(&cells, 0.3, 2).1, 1);
}

#[test]
fn contrast_slows_down_paint() {
    let mesh: TetMesh = cubes([10, 4, 4]);
    let cells = cells(&mesh, &[]);
    // Brightness changes at x = 3, without a surface: paint from seeds at x = 1 and 9 meets there,
    // not at 5.
    let bright = |t: usize| f64::from(u8::from(cells.centres[t][0] > 3.0));
    let values: Vec<f64> = (0..cells.len()).map(bright).collect();
    let factors = contrast_factors(&cells, &values);
    let geodesics = Geodesics::new(&mesh, &mesh.cells_of_faces().unwrap(), &cells);
    let seed = |x, label| GeodesicSource {
        position: [x, 2.2, 2.1],
        cell: cell_at(&mesh, [x, 2.2, 2.1]),
        label,
    };
    let seeds = [seed(1.1, 1), seed(9.1, 2)];
    let first_extent = |factors| {
        let labels = grow(
            &geodesics,
            &vec![0; cells.len()],
            factors,
            &seeds,
            f64::INFINITY,
        )
        .label;
        let first_cells = (0..cells.len()).filter(|&t| labels[t] == Some(1));
        first_cells.map(|t| cells.volumes[t]).sum::<f64>() / 16.0
    };
    let [plain, slowed] = [first_extent(None), first_extent(Some(&factors))];
    assert!((plain - 5.1).abs() < 0.15, "{plain}");
    assert!((slowed - 3.0).abs() < 0.2, "{slowed}");
    assert_eq!(
        contrast_factors(&cells, &vec![4.0; cells.len()]),
        vec![1.0; cells.links.len()]
    );
}

fn check_enclosed_volume<const D: usize, F: Mesh<D>>(mesh: &F) {
    let volumes = mesh.cell_volumes();
    let regions: Vec<u32> = (0..volumes.len()).map(|c| u32::from(c % 60 < 24)).collect();
    let face_cells = mesh.cells_of_faces().unwrap();
    for region in [0, 1] {
        let facets = enclosing_facets(mesh, &face_cells, &regions, region);
        // By the divergence theorem, the flux of x is D volumes.
        let flux = |f: &[u32; D]| {
            let x = f.map(|n| mesh.nodes()[n as usize]);
            dot(normal(&x), x[0])
        };
        let enclosed = facets.iter().map(flux).sum::<f64>() / D as f64;
        let region_cells = volumes.iter().zip(&regions).filter(|(_, r)| **r == region);
        let expected: f64 = region_cells.map(|(cell, _)| cell.0).sum();
        assert!((enclosed - expected).abs() < 1e-9, "{enclosed} {expected}");
    }
}

#[test]
fn the_enclosing_facets_of_a_region_are_closed_and_have_its_volume() {
    check_enclosed_volume::<3, TetMesh>(&cubes([5, 4, 3]));
    check_enclosed_volume::<2, TriMesh>(&cubes([9, 7]));
    check_enclosed_volume::<3, PolyMesh<3>>(&boxes([5, 4, 6]));
    check_enclosed_volume::<2, PolyMesh<2>>(&squares([9, 11]));
}
