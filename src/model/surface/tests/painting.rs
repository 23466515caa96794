//! The cells between surfaces: blocks, paint, skins.

use super::*;

#[test]
fn cells_know_their_volumes_and_doors() {
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
    let beyond = mesh.cells_of_faces().unwrap();
    assert_eq!(find_cell(&mesh, &beyond, [3.1, 1.0, 1.0]), None);
    let twice = TetMesh {
        tets: [mesh.tets.clone(), mesh.tets[..1].to_vec()].concat(),
        ..mesh
    };
    assert!(twice.cells_of_faces().is_err());
}

#[cfg(feature = "tetgen")]
#[test]
fn a_point_is_held_by_the_cell_of_the_nearest_site_where_cells_touch_in_tiny_faces() {
    let mut seed = 7;
    for off in [1e-9, 1e-7, 1e-5] {
        let mut sites = cube_sites([4, 4, 4]);
        for x in sites.iter_mut().flatten() {
            *x += off * (random(&mut seed) - 0.5);
        }
        let mesh = crate::mesh::voronoi::voronoi(&sites, [4.0; 3]).unwrap();
        let across = mesh.cells_of_faces().unwrap();
        for _ in 0..500 {
            let x: [f64; 3] = std::array::from_fn(|_| 4.0 * random(&mut seed));
            let far = |cell: usize| norm(geometry::sub(sites[cell], x));
            let cell = find_cell(&mesh, &across, x).map(|c| far(c as usize));
            let nearest = (0..sites.len()).map(far).fold(f64::INFINITY, f64::min);
            assert!(cell.is_some_and(|d| d < nearest + 1e-4), "{off}: {x:?}");
        }
    }
}

/// Paint in three layers as thick as this, with a crack between two of them.
fn check_paint_fills_layer<const D: usize, F: Mesh<D>>(mesh: &F, thick: f64) {
    let up = D - 1;
    let crack = |x: [f64; D]| (0..up).all(|k| (x[k] - 6.5).abs() < 0.5);
    let mut closed = plane_facets(mesh, up, thick, |_| false);
    closed.extend(plane_facets(mesh, up, 2.0 * thick, crack));
    closed.sort_unstable();
    let cells = cells(mesh, &closed);
    let ways = Geodesics::new(mesh, &mesh.cells_of_faces().unwrap(), &cells);
    let layer = |c: usize| (cells.centres[c][up] / thick) as u32;
    let place = |x: [f64; 3]| -> [f64; D] {
        std::array::from_fn(|k| if k == up { x[2] * thick / 6.0 } else { x[k] })
    };
    let seed = |x, label| GeodesicSource {
        position: place(x),
        cell: cell_at(mesh, place(x)),
        label,
    };

    let (block, count) = blocks(&cells, 0.3, 10);
    assert_eq!(count, 3, "{D}-D, {} cells", cells.len());
    assert_eq!(blocks(&cells, 0.0, 10).1, 2, "any opening joins");
    let seeds = [seed([2.0, 3.0, 9.0], 7), seed([2.0, 3.0, 1.0], 5)];
    let found = flow(&ways, &block, None, &seeds, f64::INFINITY);
    let (unit, arrival) = (found.label, found.cost);
    // The two layers on either side of the crack may part a step before or behind it.
    for c in 0..cells.len() {
        let want = [Some(5), Some(7), None][layer(c) as usize];
        assert_eq!(arrival[c].is_finite(), unit[c].is_some());
        let from_crack = |k: usize| cells.centres[c][k] - if k == up { 2.0 * thick } else { 6.5 };
        let far = (0..D).map(|k| from_crack(k).powi(2)).sum::<f64>().sqrt();
        assert!(unit[c] == want || far < 2.0, "leaked {far} from the crack");
    }

    // Two seeds in one layer share it: each side is nearer to its own.
    let both = [seed([1.5, 6.2, 1.4], 1), seed([10.5, 6.2, 1.4], 2)];
    let unit = flow(&ways, &block, None, &both, f64::INFINITY).label;
    let share = |u| {
        let of = (0..cells.len()).filter(|&c| unit[c] == Some(u));
        of.map(|c| cells.volumes[c]).sum::<f64>()
    };
    let whole = thick * 12f64.powi(up as i32);
    assert!((share(1) + share(2) - whole).abs() < 1e-9);
    assert!((2.0 * share(1) / whole - 1.0).abs() < 0.05, "{}", share(1));

    // Paint stops at its level.
    let found = flow(&ways, &block, None, &both[..1], 3.0);
    let (unit, arrival) = (found.label, found.cost);
    assert!(arrival.iter().filter(|a| a.is_finite()).all(|&a| a <= 3.0));
    assert!(
        unit.contains(&Some(1)) && unit.iter().filter(|u| u.is_none()).count() > cells.len() / 2
    );
}

#[test]
fn paint_fills_the_layer_of_its_seed_and_no_more() {
    check_paint_fills_layer::<3, TetMesh>(&cubes([12, 12, 18]), 6.0);
    check_paint_fills_layer::<2, TriMesh>(&cubes([12, 36]), 12.0);
    #[cfg(feature = "tetgen")]
    check_paint_fills_layer::<3, PolyMesh<3>>(&boxes([12, 12, 36]), 12.0);
    check_paint_fills_layer::<2, PolyMesh<2>>(&squares([12, 36]), 12.0);
}

#[test]
fn rooms_that_open_widely_are_one_block() {
    // A wall through half of the box: round its end the way is as wide as the rooms.
    let mesh: TetMesh = cubes([16, 8, 4]);
    let half = plane_facets(&mesh, 1, 4.0, |x| x[0] > 8.0);
    assert_eq!(blocks(&cells(&mesh, &half), 0.3, 10).1, 1);
    // A door of one cube in the whole wall is a crack.
    let door = plane_facets(&mesh, 1, 4.0, |x| {
        (7.0..8.0).contains(&x[0]) && (1.0..2.0).contains(&x[2])
    });
    assert_eq!(blocks(&cells(&mesh, &door), 0.3, 10).1, 2);
    // Without walls nothing is near one, and all is one block.
    let free = cells(&mesh, &[]);
    assert!(clearance(&free).iter().all(|c| c.is_infinite()));
    assert_eq!(blocks(&free, 0.3, 10), (vec![0; free.len()], 1));
}

#[test]
fn crumbs_join_their_neighbour() {
    let mesh: TetMesh = cubes([6, 6, 6]);
    // One tetrahedron walled in.
    let walled = mesh.tets[500];
    let closed =
        facet_selection::facets_where(&mesh, |_, face| face.iter().all(|n| walled.contains(n)));
    let cells = cells(&mesh, &closed);
    assert_eq!(blocks(&cells, 0.3, 0).1, 2);
    assert_eq!(blocks(&cells, 0.3, 2).1, 1);
}

#[test]
fn contrast_holds_paint_back() {
    let mesh: TetMesh = cubes([10, 4, 4]);
    let cells = cells(&mesh, &[]);
    // A step of brightness at x = 3, no surface: seeds at x = 1 and 9 meet there, not at 5.
    let bright = |t: usize| f64::from(u8::from(cells.centres[t][0] > 3.0));
    let values: Vec<f64> = (0..cells.len()).map(bright).collect();
    let harder = contrast_factors(&cells, &values);
    let ways = Geodesics::new(&mesh, &mesh.cells_of_faces().unwrap(), &cells);
    let seed = |x, label| GeodesicSource {
        position: [x, 2.2, 2.1],
        cell: cell_at(&mesh, [x, 2.2, 2.1]),
        label,
    };
    let seeds = [seed(1.1, 1), seed(9.1, 2)];
    let dark = |harder| {
        let unit = flow(&ways, &vec![0; cells.len()], harder, &seeds, f64::INFINITY).label;
        let of = (0..cells.len()).filter(|&t| unit[t] == Some(1));
        of.map(|t| cells.volumes[t]).sum::<f64>() / 16.0
    };
    let [plain, held] = [dark(None), dark(Some(&harder))];
    assert!((plain - 5.1).abs() < 0.15, "{plain}");
    assert!((held - 3.0).abs() < 0.2, "{held}");
    assert_eq!(
        contrast_factors(&cells, &vec![4.0; cells.len()]),
        vec![1.0; cells.links.len()]
    );
}

fn check_enclosed_volume<const D: usize, F: Mesh<D>>(mesh: &F) {
    let volumes = mesh.cell_volumes();
    let regions: Vec<u32> = (0..volumes.len()).map(|c| u32::from(c % 60 < 24)).collect();
    let across = mesh.cells_of_faces().unwrap();
    for region in [0, 1] {
        let skin = enclosing_facets(mesh, &across, &regions, region);
        // The divergence theorem: the flux of x is D volumes.
        let flux = |f: &[u32; D]| {
            let x = f.map(|n| mesh.nodes()[n as usize]);
            dot(normal(&x), x[0])
        };
        let enclosed = skin.iter().map(flux).sum::<f64>() / D as f64;
        let here = volumes.iter().zip(&regions).filter(|(_, r)| **r == region);
        let want: f64 = here.map(|(cell, _)| cell.0).sum();
        assert!((enclosed - want).abs() < 1e-9, "{enclosed} {want}");
    }
}

#[test]
fn the_skin_of_a_region_is_closed_and_holds_its_volume() {
    check_enclosed_volume::<3, TetMesh>(&cubes([5, 4, 3]));
    check_enclosed_volume::<2, TriMesh>(&cubes([9, 7]));
    #[cfg(feature = "tetgen")]
    check_enclosed_volume::<3, PolyMesh<3>>(&boxes([5, 4, 6]));
    check_enclosed_volume::<2, PolyMesh<2>>(&squares([9, 11]));
}
