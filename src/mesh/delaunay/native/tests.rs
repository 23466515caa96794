//! Tests of the kernel against TetGen, CGAL and exact definitions.

use proptest::prelude::*;

use super::*;
use crate::geometry::NONE;
use crate::geometry::random::Random;
use crate::mesh::delaunay::canonical::sort_canonical;

/// Returns the tetrahedra of points in canonical order, with their neighbours.
fn triangulated(points: &[[f64; 3]]) -> DelaunayTets {
    let mut tets = Native.triangulate(points, true).unwrap();
    sort_canonical(points.len(), &mut tets);
    tets
}

/// Returns sets of points of every kind that is difficult for a triangulation.
fn difficult_sets() -> Vec<(&'static str, Vec<[f64; 3]>)> {
    let mut random = Random::new(11);
    let mut draw = |count: usize, f: &mut dyn FnMut([f64; 3]) -> [f64; 3]| -> Vec<[f64; 3]> {
        (0..count)
            .map(|_| f(std::array::from_fn(|_| random.draw())))
            .collect()
    };
    let lattice = |n: usize, is_site: &dyn Fn([usize; 3]) -> bool, scale: f64| {
        let mut points = Vec::new();
        for x in 0..=n {
            for y in 0..=n {
                for z in 0..=n {
                    if is_site([x, y, z]) {
                        points.push([x, y, z].map(|i| i as f64 * scale));
                    }
                }
            }
        }
        points
    };
    let is_fcc = |[x, y, z]: [usize; 3]| (x + y + z).is_multiple_of(2);
    let on_sphere = |p: [f64; 3]| {
        let v = p.map(|x| 2.0 * x - 1.0);
        let length = crate::geometry::norm(v).max(1e-3);
        v.map(|x| x / length)
    };
    let mut with_box = draw(300, &mut |p| p);
    with_box.extend(lattice(4, &|i| i.iter().any(|&c| c == 0 || c == 4), 0.25));
    let mut line = draw(40, &mut |p| [p[0], 0.5, 0.5]);
    line.extend([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let mut plane = draw(200, &mut |p| [p[0], p[1], 0.25]);
    plane.extend(draw(20, &mut |p| p));
    let mut sphere = draw(400, &mut |p| on_sphere(p));
    sphere.push([0.0; 3]);
    vec![
        ("random", draw(1500, &mut |p| p)),
        ("clustered", draw(600, &mut |p| p.map(|x| x.powi(12)))),
        (
            "graded",
            draw(600, &mut |[x, y, z]| [x, y * 0.01 * x, z * z]),
        ),
        (
            "sheared",
            draw(600, &mut |[x, y, z]| [x + 50.0 * y, y + 30.0 * z, z]),
        ),
        ("face-centred lattice", lattice(8, &is_fcc, 1.0)),
        ("face-centred lattice in tenths", lattice(8, &is_fcc, 0.7)),
        ("cubic lattice", lattice(6, &|_| true, 1.0)),
        ("cubic lattice in tenths", lattice(6, &|_| true, 0.1)),
        ("box with flat sides", with_box),
        ("sphere with its centre", sphere),
        ("plane and some points", plane),
        ("line and a triangle", line),
        ("far away", draw(400, &mut |p| p.map(|x| 1e6 + 1e-3 * x))),
        ("very small", draw(200, &mut |p| p.map(|x| 1e-310 * x))),
        ("very large", draw(200, &mut |p| p.map(|x| 1e300 * x))),
    ]
}

/// Asserts what defines a Delaunay triangulation: mutual neighbours, positive tetrahedra, a convex
/// hull, and no point inside the circumsphere of a neighbour, all exactly.
fn assert_is_delaunay(name: &str, points: &[[f64; 3]], all: &DelaunayTets) {
    let scaled = normalized(points);
    let point = |n: u32| WeightedPoint {
        x: scaled[n as usize],
        weight: 0.0,
    };
    let grid = Grid::from_points(scaled.iter());
    let mut hull = Vec::new();
    for (t, (tet, neighbours)) in all.tets.iter().zip(&all.neighbours).enumerate() {
        assert_eq!(orientation(tet.map(|n| point(n).x)), 1, "{name}");
        for (k, &n) in neighbours.iter().enumerate() {
            if n == NONE {
                hull.push((t, k));
                continue;
            }
            let back = all.neighbours[n as usize]
                .iter()
                .position(|&b| b == t as u32);
            let apex = all.tets[n as usize][back.expect("neighbours are mutual")];
            assert!(!tet.contains(&apex), "{name}");
            let numbers = [tet[0], tet[1], tet[2], tet[3], apex];
            let side = predicates::in_sphere(tet.map(point), point(apex), numbers, grid);
            assert_eq!(side, 1, "{name}: {numbers:?}");
        }
    }
    for (t, k) in hull {
        for n in 0..points.len() as u32 {
            let mut corners = all.tets[t].map(|n| point(n).x);
            corners[k] = point(n).x;
            assert!(
                orientation(corners) >= 0,
                "{name}: point {n} beyond the hull"
            );
        }
    }
}

#[test]
fn difficult_points_have_delaunay_triangulations() {
    for (name, points) in difficult_sets() {
        assert_is_delaunay(name, &points, &triangulated(&points));
    }
}

#[test]
#[cfg(feature = "tetgen")]
fn difficult_points_have_the_tetrahedra_of_tetgen() {
    use crate::mesh::delaunay::tetgen::Tetgen;
    for (name, points) in difficult_sets() {
        // TetGen uses absolute tolerances and joins points that are nearly the same.
        if matches!(name, "very small" | "very large" | "clustered" | "far away") {
            continue;
        }
        let mut by_tetgen = Tetgen.triangulate(&points, true).unwrap();
        sort_canonical(points.len(), &mut by_tetgen);
        assert!(triangulated(&points) == by_tetgen, "{name}");
    }
}

#[test]
#[cfg(feature = "cgal")]
fn points_without_ties_have_the_tetrahedra_of_cgal() {
    for (name, points) in difficult_sets() {
        let has_ties = ["lattice", "box", "line", "very"]
            .iter()
            .any(|word| name.contains(word));
        if has_ties {
            continue;
        }
        let tets = crate::mesh::delaunay::cgal::triangulate(&points).unwrap();
        let mut by_cgal = DelaunayTets {
            tets,
            neighbours: Vec::new(),
        };
        sort_canonical(points.len(), &mut by_cgal);
        assert!(triangulated(&points).tets == by_cgal.tets, "{name}");
    }
}

#[test]
fn the_order_of_insertion_does_not_matter() {
    for (name, points) in difficult_sets() {
        let scaled = normalized(&points);
        let expected = triangulated(&points).tets;
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut random = Random::new(5);
        for i in (1..order.len()).rev() {
            order.swap(i, (random.draw() * (i + 1) as f64) as usize);
        }
        put_simplex_first(&scaled, &mut order).unwrap();
        let cells = inserted::<false>(&scaled, &[], &order).into_cells();
        let mut all = compacted(cells.0, &cells.1, false);
        sort_canonical(points.len(), &mut all);
        assert!(all.tets == expected, "{name}");
    }
}

#[test]
fn weights_give_the_lower_hull_of_lifted_points() {
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let points: Vec<[f64; 3]> = (0..60).map(|_| [(); 3].map(|()| random.draw())).collect();
        let weights: Vec<f64> = (0..60).map(|_| 0.3 * random.draw()).collect();
        let mut order = insertion_order(&points);
        put_simplex_first(&points, &mut order).unwrap();
        let (cells, numbers) = inserted::<true>(&points, &weights, &order).into_cells();
        let tets = compacted(cells, &numbers, false).tets;
        let point = |n: u32| WeightedPoint {
            x: points[n as usize],
            weight: weights[n as usize],
        };
        let grid = Grid::from_points(points.iter());
        let mut volume = 0.0;
        for tet in &tets {
            assert_eq!(orientation(tet.map(|n| point(n).x)), 1);
            volume += crate::geometry::volume6(&tet.map(|n| point(n).x)) / 6.0;
            for n in (0..60).filter(|n| !tet.contains(n)) {
                let numbers = [tet[0], tet[1], tet[2], tet[3], n];
                assert_eq!(
                    predicates::in_sphere(tet.map(point), point(n), numbers, grid),
                    1
                );
            }
        }
        let unweighted = triangulated(&points).tets;
        let hull: f64 = (unweighted.iter())
            .map(|tet| crate::geometry::volume6(&tet.map(|n| point(n).x)) / 6.0)
            .sum();
        assert!((volume / hull - 1.0).abs() < 1e-12);
        let mut used: Vec<u32> = tets.into_flattened();
        used.sort_unstable();
        used.dedup();
        assert!(used.len() < 60, "some points are hidden");
    }
}

#[test]
fn duplicates_are_left_out() {
    let mut points = difficult_sets().remove(0).1;
    let expected = triangulated(&points).tets;
    points.push(points[77]);
    let tets = triangulated(&points).tets;
    assert_eq!(tets.len(), expected.len());
    assert!(!tets.as_flattened().contains(&77) || !tets.as_flattened().contains(&1500));
}

#[test]
#[ignore = "slow: make test-all"]
#[cfg(feature = "tetgen")]
fn a_hundred_thousand_small_sets_have_the_tetrahedra_of_tetgen() {
    use crate::mesh::delaunay::tetgen::Tetgen;
    let mut random = Random::new(2026);
    for set in 0..100_000 {
        let count = 4 + (random.draw() * 30.0) as usize;
        // A third of the sets on a coarse grid, a third on a fine one, a third anywhere.
        let grid = [4.0, 64.0, 0.0][set % 3];
        let mut coordinate = || match grid {
            0.0 => random.draw(),
            cells => (random.draw() * cells).floor(),
        };
        let mut points: Vec<[f64; 3]> = (0..count)
            .map(|_| std::array::from_fn(|_| coordinate()))
            .collect();
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        points.dedup();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        if points.len() < 4 || put_simplex_first(&points, &mut order).is_none() {
            continue;
        }
        let mut by_tetgen = Tetgen.triangulate(&points, true).unwrap();
        sort_canonical(points.len(), &mut by_tetgen);
        assert!(triangulated(&points) == by_tetgen, "set {set}: {points:?}");
    }
}

fn small_sets() -> impl Strategy<Value = Vec<[f64; 3]>> {
    // Coordinates on a coarse grid make ties of every kind.
    let coarse = prop::array::uniform3((0u8..5).prop_map(f64::from));
    let fine = prop::array::uniform3(0.0..4.0);
    prop::collection::vec(prop_oneof![3 => coarse, 1 => fine], 5..40)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn any_small_set_is_triangulated(mut points in small_sets()) {
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        points.dedup();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        prop_assume!(points.len() >= 4 && put_simplex_first(&points, &mut order).is_some());
        assert_is_delaunay("small", &points, &triangulated(&points));
        #[cfg(feature = "tetgen")]
        {
            use crate::mesh::delaunay::tetgen::Tetgen;
            let mut by_tetgen = Tetgen.triangulate(&points, true).unwrap();
            sort_canonical(points.len(), &mut by_tetgen);
            prop_assert!(triangulated(&points) == by_tetgen);
        }
    }
}
