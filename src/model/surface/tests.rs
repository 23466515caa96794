use super::adjacency::{Adjacency, holding, skin};
use super::measure::Up;
use super::*;
use crate::geometry;
use crate::geometry::{dot, norm, normal};
use crate::mesh::Mesh;
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi::voronoi_plane;
use crate::mesh::{TetMesh, TriMesh};
use crate::model::flow::test_meshes::jittered_box;
use crate::model::paint::{Seed, blocks, clearance, contrast, paint as flow};

/// Numbers in [0, 1) that look random.
fn random(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 53) as f64
}

/// A sheet of `n` by `m` squares, each cut in two, whose node (i, j) is `at(i, j)`; nodes at places
/// that exist already are shared.
fn add_sheet(
    nodes: &mut Vec<[f64; 3]>,
    facets: &mut Vec<[u32; 3]>,
    [n, m]: [usize; 2],
    at: impl Fn(f64, f64) -> [f64; 3],
) {
    let mut number = |i: usize, j: usize| {
        let x = at(i as f64, j as f64);
        let known = nodes.iter().position(|y| norm(geometry::sub(x, *y)) < 1e-9);
        known.unwrap_or_else(|| {
            nodes.push(x);
            nodes.len() - 1
        }) as u32
    };
    for i in 0..n {
        for j in 0..m {
            let [a, b, c, d] =
                [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| number(i, j));
            facets.extend([[a, b, d], [a, d, c]]);
        }
    }
}

/// Two sheets of 100 and 80 that cross along z at `degrees`.
fn crossing(degrees: f64) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    let (sin, cos) = degrees.to_radians().sin_cos();
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 5.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [8, 10], |i, j| {
        [(i - 4.0) * cos, (i - 4.0) * sin, j]
    });
    (nodes, facets)
}

fn areas<const D: usize>(surfaces: &Surfaces<D>, nodes: &[[f64; D]]) -> Vec<f64> {
    let up = Up::along(D - 1, true);
    measure(surfaces, nodes, &up, &[])
        .iter()
        .map(|m| m.area)
        .collect()
}

#[test]
fn sheets_that_cross_stay_two_and_meet() {
    for degrees in [30.0, 45.0, 90.0, 140.0] {
        let (nodes, facets) = crossing(degrees);
        let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let found = measure(&surfaces, &nodes, &Up::along(2, true), &[]);
        assert_eq!(found.len(), 2, "{degrees}");
        assert!((found[0].area - 100.0).abs() < 1e-9 && (found[1].area - 80.0).abs() < 1e-9);
        assert_eq!([&found[0].meets[..], &found[1].meets[..]], [[1], [0]]);
        assert_eq!([found[0].components, found[0].holes], [1, 0]);
        assert!((found[0].rim - 40.0).abs() < 1e-9 && found[0].off_plane < 1e-9);
    }
}

#[test]
fn the_order_of_facets_changes_nothing() {
    let (nodes, facets) = crossing(40.0);
    let want = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    let mut seed = 7;
    for _ in 0..5 {
        let mut keyed: Vec<(f64, [u32; 3])> =
            facets.iter().map(|&f| (random(&mut seed), f)).collect();
        keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let shuffled = keyed.into_iter().map(|k| k.1).collect();
        assert_eq!(
            Surfaces::find(&nodes, shuffled, &[], &Options::default()),
            want
        );
    }
}

#[test]
fn a_gap_at_the_crossing_does_not_part_a_surface() {
    // Of the second sheet, the strips on both sides of the crossing are missing.
    let (nodes, mut facets) = crossing(60.0);
    let first = facets.len() - 160;
    let off = |f: &[u32; 3]| {
        f.iter()
            .all(|&n| dot(nodes[n as usize], [0.5, 3f64.sqrt() / 2.0, 0.0]).abs() < 1.1)
    };
    let rest: Vec<[u32; 3]> = facets.drain(first..).collect();
    let (gap, kept): (Vec<_>, Vec<_>) = rest.into_iter().partition(off);
    assert_eq!(gap.len(), 40);
    facets.extend(kept);
    let surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    assert_eq!(surfaces.len(), 2);
    assert!((areas(&surfaces, &nodes)[1] - 60.0).abs() < 1e-9);
    // Half of the gap closes with faces that hang on what there is.
    let half: Vec<[u32; 3]> = (gap.iter().copied())
        .filter(|f| {
            f.iter()
                .all(|&n| dot(nodes[n as usize], [0.5, 3f64.sqrt() / 2.0, 0.0]) > -0.1)
        })
        .collect();
    let stray = [half[0][0], half[1][1], facets[0][0]];
    let one_side = [half, vec![stray]].concat();
    let closed = Surfaces::find(&nodes, facets, &one_side, &Options::default());
    assert_eq!(
        (closed.len(), closed.filled),
        (2, 0),
        "the crossing's nodes are not on the second sheet"
    );
}

/// Where two faults cross at a low angle, of the one a wide strip is missing: it stays one. A parallel
/// fault that ends at the same crossing, but farther off than facets are wide, does not join it.
fn a_wide_gap(off: f64) -> usize {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 13.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i + 1.0, off, j]);
    let (sin, cos) = 25f64.to_radians().sin_cos();
    add_sheet(&mut nodes, &mut facets, [16, 10], |i, j| {
        [(i - 8.0) * cos - 1.0, (i - 8.0) * sin, j]
    });
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let mut areas = areas(&surfaces, &nodes);
    areas.sort_by(|a, b| b.total_cmp(a));
    assert!((areas.iter().sum::<f64>() - 360.0).abs() < 1e-9);
    areas.len()
}

#[test]
fn a_strip_missing_at_a_low_angle_crossing_does_not_part_a_surface() {
    assert_eq!(a_wide_gap(0.0), 2);
    assert_eq!(a_wide_gap(0.5), 2);
    assert_eq!(a_wide_gap(2.5), 3);
}

#[test]
fn holes_close_with_candidates_in_the_plane_only() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [8, 8], |i, j| {
        [i, j, 0.1 * (i * 0.5).sin()]
    });
    let whole = facets.clone();
    let missing: Vec<[u32; 3]> = [100, 40, 41].map(|k| facets.remove(k)).to_vec();
    nodes.push([3.0, 3.0, 1.0]);
    let top = nodes.len() as u32 - 1;
    let wrong = [facets[0][0], facets[0][1], top];
    let candidates = [missing, vec![wrong]].concat();
    let surfaces = Surfaces::find(&nodes, facets, &candidates, &Options::default());
    assert_eq!((surfaces.len(), surfaces.filled), (1, 3));
    let sorted = |mut list: Vec<[u32; 3]>| {
        list.sort_unstable();
        list
    };
    assert_eq!(sorted(surfaces.facets), sorted(whole));
}

#[test]
fn a_surface_that_ends_at_another_is_its_own() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 5.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [6, 10], |i, j| {
        [0.8 * i, 0.6 * i, j]
    });
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let areas = areas(&surfaces, &nodes);
    assert!(areas.len() == 2 && (areas[0] - 100.0).abs() < 1e-9 && (areas[1] - 60.0).abs() < 1e-9);
}

#[test]
fn small_surfaces_are_dropped_and_counted() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [6, 6], |i, j| [i, j, 0.0]);
    add_sheet(&mut nodes, &mut facets, [1, 2], |i, j| [i, j, 5.0]);
    let find = |min_area| {
        let options = Options {
            min_area,
            ..Options::default()
        };
        Surfaces::find(&nodes, facets.clone(), &[], &options)
    };
    let surfaces = find(None);
    assert_eq!((surfaces.len(), surfaces.dropped), (1, 1));
    assert!((surfaces.dropped_area - 2.0).abs() < 1e-12);
    assert_eq!(find(Some(1.9)).len(), 2);
    assert!(Surfaces::<3>::find(&[], vec![], &[], &Options::default()).is_empty());
}

/// Lines that cross: the same grouping, one dimension down.
#[test]
fn in_two_dimensions_lines_cross_too() {
    let mut nodes = vec![[0.0, 0.0]];
    let mut facets = Vec::new();
    for degrees in [10.0f64, 55.0, 190.0, 235.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut last = 0;
        for i in 1..=12 {
            // Not quite straight.
            let (r, a) = (f64::from(i), 0.004 * f64::from(i * i));
            nodes.push([r * cos - a * sin, r * sin + a * cos]);
            let next = nodes.len() as u32 - 1;
            facets.push([last, next]);
            last = next;
        }
    }
    let mut surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    surfaces.orient(&nodes, [0.0, 1.0]);
    let found = measure(&surfaces, &nodes, &Up::along(1, true), &[]);
    assert_eq!(found.len(), 2);
    for line in &found {
        assert_eq!((line.facets, line.components, line.rim), (24, 1, 2.0));
        assert!((line.area - 24.0).abs() < 0.2 && line.strike.is_none());
        assert_eq!(line.meets.len(), 1);
    }
    let mut dips: Vec<f64> = found.iter().map(|m| m.dip).collect();
    dips.sort_by(f64::total_cmp);
    // The arms rise by 0.048 on the mean.
    let tilt = 0.048f64.atan().to_degrees();
    assert!(
        (dips[0] - 10.0 - tilt).abs() < 0.1 && (dips[1] - 55.0 - tilt).abs() < 0.1,
        "{dips:?}"
    );
    for s in 0..2 {
        // Consistent orientation: the segments follow each other.
        let mut begin: Vec<u32> = surfaces.of(s).iter().map(|f| f[0]).collect();
        begin.sort_unstable();
        begin.dedup();
        assert_eq!(begin.len(), 24);
    }
    // Without the segments at the crossing it stays two lines.
    facets.retain(|f| f[0] != 0);
    let apart = Surfaces::find(&nodes, facets, &[], &Options::default());
    assert_eq!(areas(&apart, &nodes).len(), 2);
}

#[test]
fn strike_and_dip_of_known_planes() {
    for (strike, dip) in [
        (0.0f64, 30.0f64),
        (90.0, 60.0),
        (215.0, 45.0),
        (330.0, 89.0),
    ] {
        let (s, d) = (strike.to_radians(), dip.to_radians());
        // x is east, y north, z up; down the dip is to the right of the strike.
        let along = [s.sin(), s.cos(), 0.0];
        let down = [d.cos() * s.cos(), -d.cos() * s.sin(), -d.sin()];
        let (mut nodes, mut facets) = (Vec::new(), Vec::new());
        add_sheet(&mut nodes, &mut facets, [7, 5], |i, j| {
            std::array::from_fn(|k| 1e5 + i * along[k] + j * down[k])
        });
        // Turned at random: orientation is found again.
        let mut seed = 3;
        facets.iter_mut().for_each(|f| {
            if random(&mut seed) < 0.5 {
                f.swap(1, 2);
            }
        });
        let mut surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let up = Up::along(2, true);
        surfaces.orient(&nodes, up.up);
        let [found] = &measure(&surfaces, &nodes, &up, &[])[..] else {
            panic!("one")
        };
        assert!((found.dip - dip).abs() < 1e-6, "{dip} {found:?}");
        assert!(
            (found.strike.unwrap() - strike + 180.0).rem_euclid(360.0) - 180.0 < 1e-6,
            "{found:?}"
        );
        let all_up = |f: &[u32; 3]| normal(&f.map(|n| nodes[n as usize]))[2] > 0.0;
        assert!(surfaces.facets.iter().all(all_up));
        let middle: [f64; 3] = std::array::from_fn(|k| 1e5 + 3.5 * along[k] + 2.5 * down[k]);
        assert!(
            norm(std::array::from_fn::<f64, 3, _>(
                |k| found.centre[k] - middle[k]
            )) < 1e-6
        );
    }
}

#[test]
fn rims_holes_and_closed_surfaces() {
    // A ring: an annulus has a hole.
    let ring = |i: f64, j: f64| {
        let a = i / 24.0 * std::f64::consts::TAU;
        [(3.0 + j) * a.cos(), (3.0 + j) * a.sin(), 0.0]
    };
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [24, 3], ring);
    // A torus: closed, no rim; bends of 30 degrees from square to square.
    add_sheet(&mut nodes, &mut facets, [24, 16], |i, j| {
        let (a, b) = (
            i / 24.0 * std::f64::consts::TAU,
            j / 16.0 * std::f64::consts::TAU,
        );
        let r = 12.0 + 5.0 * b.cos();
        [r * a.cos(), r * a.sin(), 30.0 + 5.0 * b.sin()]
    });
    let mut surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let up = Up::along(2, true);
    surfaces.orient(&nodes, up.up);
    let found = measure(&surfaces, &nodes, &up, &[]);
    assert_eq!(found.len(), 2);
    let (torus, ring) = (&found[0], &found[1]);
    assert_eq!((torus.rim, torus.components, torus.holes), (0.0, 1, 0));
    assert_eq!((ring.components, ring.holes), (1, 1));
    let around = |r: f64| 24.0 * 2.0 * r * (std::f64::consts::PI / 24.0).sin();
    assert!((ring.rim - around(3.0) - around(6.0)).abs() < 1e-9);
    // All of a closed surface's facets show the same side: their normals sum to zero.
    let sum = surfaces.of(0).iter().fold([0.0; 3], |sum, f| {
        geometry::add_scaled(sum, 1.0, normal(&f.map(|n| nodes[n as usize])))
    });
    assert!(norm(sum) < 1e-9 * torus.area);
}

/// A box of `dims` unit cubes, each of six tetrahedra (squares: two triangles) round its diagonal.
fn cubes<const D: usize, M: Simplices<D>>(dims: [usize; D]) -> M {
    jittered_box(dims, dims.map(|n| n as f64), 0.0, |_| false)
}

/// Facets in the plane where coordinate `axis` is `at`, unless `left_out`.
fn plane<const D: usize, F: Mesh<D>>(
    mesh: &F,
    axis: usize,
    at: f64,
    left_out: impl Fn([f64; D]) -> bool + Sync,
) -> Vec<[u32; D]> {
    select::facets_where(mesh, |_, facet| {
        let x = facet.map(|n| mesh.nodes()[n as usize]);
        let centroid = std::array::from_fn(|k| x.iter().map(|x| x[k]).sum::<f64>() / D as f64);
        x.iter().all(|p| p[axis] == at) && !left_out(centroid)
    })
}

/// The cells of a mesh parted by facets.
fn cells<const D: usize, F: Mesh<D>>(mesh: &F, closed: &[[u32; D]]) -> Adjacency<D> {
    Adjacency::new(mesh, &mesh.cells_of_faces().unwrap(), closed)
}

/// The cell that holds a point.
fn at<const D: usize, F: Mesh<D>>(mesh: &F, x: [f64; D]) -> u32 {
    holding(mesh, &mesh.cells_of_faces().unwrap(), x).unwrap()
}

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
        for (l, link, n) in cells.around(c) {
            assert!(link.cells.contains(&c) && link.cells.contains(&n) && n != c);
            assert!(cells.links[l] == *link && cells.resistance(link) >= link.distance);
        }
    }
    for x in [[0.9, 0.2, 0.1], [0.2, 0.9, 0.3]] {
        assert!(at(&mesh, x) < 6);
    }
    let beyond = mesh.cells_of_faces().unwrap();
    assert_eq!(holding(&mesh, &beyond, [3.1, 1.0, 1.0]), None);
    let twice = TetMesh {
        tets: [mesh.tets.clone(), mesh.tets[..1].to_vec()].concat(),
        ..mesh
    };
    assert!(twice.cells_of_faces().is_err());
}

/// Paint in three layers as thick as this, with a crack between two of them.
fn paint_fills_its_layer<const D: usize, F: Mesh<D>>(mesh: &F, thick: f64) {
    let up = D - 1;
    let crack = |x: [f64; D]| (0..up).all(|k| (x[k] - 6.5).abs() < 0.5);
    let mut closed = plane(mesh, up, thick, |_| false);
    closed.extend(plane(mesh, up, 2.0 * thick, crack));
    closed.sort_unstable();
    let cells = cells(mesh, &closed);
    let cost: Vec<f64> = cells.links.iter().map(|l| cells.resistance(l)).collect();
    let layer = |c: usize| (cells.centres[c][up] / thick) as u32;
    let place = |x: [f64; 3]| -> [f64; D] {
        std::array::from_fn(|k| if k == up { x[2] * thick / 6.0 } else { x[k] })
    };
    let seed = |x, unit| Seed {
        cell: at(mesh, place(x)),
        unit,
    };

    let (block, count) = blocks(&cells, 0.3, 10);
    assert_eq!(count, 3, "{D}-D, {} cells", cells.len());
    assert_eq!(blocks(&cells, 0.0, 10).1, 2, "any opening joins");
    let seeds = [seed([2.0, 3.0, 9.0], 7), seed([2.0, 3.0, 1.0], 5)];
    let (unit, arrival) = flow(&cells, &block, &cost, &seeds, f64::INFINITY);
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
    let (unit, _) = flow(&cells, &block, &cost, &both, f64::INFINITY);
    let share = |u| {
        let of = (0..cells.len()).filter(|&c| unit[c] == Some(u));
        of.map(|c| cells.volumes[c]).sum::<f64>()
    };
    let whole = thick * 12f64.powi(up as i32);
    assert!((share(1) + share(2) - whole).abs() < 1e-9);
    // In the plane the diagonals, which all run one way, weigh more.
    let fair = if D == 2 { 0.25 } else { 0.1 };
    assert!((2.0 * share(1) / whole - 1.0).abs() < fair, "{}", share(1));

    // Paint stops at its level.
    let (unit, arrival) = flow(&cells, &block, &cost, &both[..1], 3.0);
    assert!(arrival.iter().filter(|a| a.is_finite()).all(|&a| a <= 3.0));
    assert!(
        unit.contains(&Some(1)) && unit.iter().filter(|u| u.is_none()).count() > cells.len() / 2
    );
}

#[test]
fn paint_fills_the_layer_of_its_seed_and_no_more() {
    paint_fills_its_layer::<3, TetMesh>(&cubes([12, 12, 18]), 6.0);
    paint_fills_its_layer::<2, TriMesh>(&cubes([12, 36]), 12.0);
    #[cfg(feature = "tetgen")]
    paint_fills_its_layer::<3, PolyMesh<3>>(&boxes([12, 12, 36]), 12.0);
    paint_fills_its_layer::<2, PolyMesh<2>>(&squares([12, 36]), 12.0);
}

/// Sites whose Voronoi cells are unit cubes (squares).
fn middles<const D: usize>(dims: [usize; D]) -> Vec<[f64; D]> {
    let middle = |i: usize| {
        let mut rest = i;
        dims.map(|n| {
            let x = (rest % n) as f64 + 0.5;
            rest /= n;
            x
        })
    };
    (0..dims.iter().product()).map(middle).collect()
}

fn squares(dims: [usize; 2]) -> PolyMesh<2> {
    voronoi_plane(&middles(dims), dims.map(|n| n as f64)).unwrap()
}

#[cfg(feature = "tetgen")]
fn boxes(dims: [usize; 3]) -> PolyMesh<3> {
    crate::mesh::voronoi::voronoi(&middles(dims), dims.map(|n| n as f64)).unwrap()
}

#[test]
fn rooms_that_open_widely_are_one_block() {
    // A wall through half of the box: round its end the way is as wide as the rooms.
    let mesh: TetMesh = cubes([16, 8, 4]);
    let half = plane(&mesh, 1, 4.0, |x| x[0] > 8.0);
    assert_eq!(blocks(&cells(&mesh, &half), 0.3, 10).1, 1);
    // A door of one cube in the whole wall is a crack.
    let door = plane(&mesh, 1, 4.0, |x| {
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
    let closed = select::facets_where(&mesh, |_, face| face.iter().all(|n| walled.contains(n)));
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
    let plain: Vec<f64> = cells.links.iter().map(|l| cells.resistance(l)).collect();
    let harder: Vec<f64> = plain
        .iter()
        .zip(contrast(&cells, &values))
        .map(|(c, h)| c * h)
        .collect();
    let seed = |x, unit| Seed {
        cell: at(&mesh, [x, 2.2, 2.1]),
        unit,
    };
    let seeds = [seed(1.1, 1), seed(9.1, 2)];
    let dark = |cost: &[f64]| {
        let (unit, _) = flow(&cells, &vec![0; cells.len()], cost, &seeds, f64::INFINITY);
        let of = (0..cells.len()).filter(|&t| unit[t] == Some(1));
        of.map(|t| cells.volumes[t]).sum::<f64>() / 16.0
    };
    assert!((dark(&plain) - 5.0).abs() < 0.5, "{}", dark(&plain));
    assert!((dark(&harder) - 3.0).abs() < 0.2, "{}", dark(&harder));
    assert_eq!(
        contrast(&cells, &vec![4.0; cells.len()]),
        vec![1.0; cells.links.len()]
    );
}

fn skins_hold_their_volume<const D: usize, F: Mesh<D>>(mesh: &F) {
    let volumes = mesh.cell_volumes();
    let regions: Vec<u32> = (0..volumes.len()).map(|c| u32::from(c % 60 < 24)).collect();
    let across = mesh.cells_of_faces().unwrap();
    for region in [0, 1] {
        let skin = skin(mesh, &across, &regions, region);
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
    skins_hold_their_volume::<3, TetMesh>(&cubes([5, 4, 3]));
    skins_hold_their_volume::<2, TriMesh>(&cubes([9, 7]));
    #[cfg(feature = "tetgen")]
    skins_hold_their_volume::<3, PolyMesh<3>>(&boxes([5, 4, 6]));
    skins_hold_their_volume::<2, PolyMesh<2>>(&squares([9, 11]));
}

/// Faces of all kinds of cells know by number what their facets are labelled.
#[test]
fn labels_come_back_to_the_faces_they_were_given() {
    fn check<const D: usize, F: Mesh<D>>(mesh: &F, numbers: usize) {
        let wall = plane(mesh, 0, 2.0, |_| false);
        let labelled: Vec<([u32; D], u32)> = wall.iter().map(|&f| (f, 7)).collect();
        let labels = select::labels_of_faces(mesh, &labelled);
        assert_eq!(labels.len(), mesh.face_count());
        let marks: Vec<bool> = labels.iter().map(|&l| l == 7).collect();
        assert_eq!(marks.iter().filter(|on| **on).count(), numbers);
        assert_eq!(select::marked(mesh, &marks), wall);
    }
    // Both numbers of a face between two simplices.
    check::<3, TetMesh>(&cubes([4, 3, 2]), 2 * 2 * 6);
    check::<2, TriMesh>(&cubes([4, 3]), 2 * 3);
    #[cfg(feature = "tetgen")]
    check::<3, PolyMesh<3>>(&boxes([4, 3, 2]), 6);
    check::<2, PolyMesh<2>>(&squares([4, 3]), 3);
}

#[test]
fn surfaces_that_are_mostly_of_horizons_are_horizons() {
    let mesh: TetMesh = cubes([6, 6, 6]);
    let (layer, fault) = (
        plane(&mesh, 2, 2.0, |_| false),
        plane(&mesh, 0, 3.0, |_| false),
    );
    let facets = [layer.clone(), fault.clone()].concat();
    let surfaces = Surfaces::find(&mesh.nodes, facets, &[], &Options::default());
    // A few of the fault's facets are taken for a horizon's.
    let mut horizons = [layer, fault[..10].to_vec()].concat();
    horizons.sort_unstable();
    let up = Up::along(2, true);
    for m in measure(&surfaces, &mesh.nodes, &up, &horizons) {
        let want = if m.dip < 45.0 {
            Kind::Horizon
        } else {
            Kind::Fault
        };
        assert_eq!(m.kind, want);
    }
    let kinds = kind::kinds(&surfaces, &mesh.nodes, &[]);
    assert_eq!(kinds, [Kind::Fault; 2]);
}

#[cfg(feature = "tetgen")]
mod meshed {
    use super::*;
    use crate::feature::{self, Features};
    use crate::image::synth::{self, Kind};
    use crate::image::{Geometry, Image};
    use crate::job::{self, Outcome, Params, Spacing};
    use crate::lattice::optimize::Unobserved;
    use crate::mesh::interface::marks_of_bits;

    fn image(dims: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Image<3> {
        let [nx, ny, _] = dims;
        let at = |i: usize| [i % nx, i / nx % ny, i / (nx * ny)].map(|c| c as f64);
        let samples = (0..dims.iter().product()).map(|i| value(at(i)) as f32);
        Image::new(dims, samples.collect(), Geometry::default())
    }

    fn mesh(image: &Image<3>, kind: feature::FeatureKind, d: f64) -> Outcome {
        let params = Params {
            spacing: Spacing::Constant(d),
            feature: kind,
            ..Params::default()
        };
        job::run(image, &params, &mut Unobserved).unwrap()
    }

    fn marked(outcome: &Outcome) -> Vec<[u32; 3]> {
        let marks: Vec<bool> =
            marks_of_bits::<3>(&outcome.simplices().unwrap().feature_faces).collect();
        select::marked(&outcome.simplices().unwrap().mesh, &marks)
    }

    fn group(outcome: &Outcome, min_area: Option<f64>) -> Surfaces<3> {
        let faces = marked(outcome);
        let candidates = select::spanned(&outcome.simplices().unwrap().mesh, &faces);
        let options = Options {
            min_area,
            ..Options::default()
        };
        Surfaces::find(
            &outcome.simplices().unwrap().mesh.nodes,
            faces,
            &candidates,
            &options,
        )
    }

    /// Area of the plane n.x = c in the box: over the two axes along which it is steepest.
    fn plane_area(n: [f64; 3], c: f64, dims: [usize; 3]) -> f64 {
        let k = (0..3).fold(0, |k, j| if n[j].abs() > n[k].abs() { j } else { k });
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let mut inside = 0;
        for p in 0..4 * (dims[i] - 1) {
            for q in 0..4 * (dims[j] - 1) {
                let [u, v] = [p, q].map(|c| 0.25 * c as f64 + 0.125);
                let x = (c - n[i] * u - n[j] * v) / n[k];
                inside += usize::from((0.0..=(dims[k] - 1) as f64).contains(&x));
            }
        }
        inside as f64 / 16.0 / n[k].abs()
    }

    #[test]
    fn as_many_faults_come_out_as_went_in() {
        for (kind, seed) in [(Kind::Planes, 4), (Kind::Planes, 6), (Kind::Faults, 2)] {
            let options = synth::Options {
                dims: [110, 100, 96],
                seed,
                count: Some(3),
                ..synth::Options::default()
            };
            let made = synth::make(kind, &options).unwrap();
            let outcome = mesh(&made.image, feature::FeatureKind::Ridges, 6.0);
            let surfaces = group(&outcome, None);
            let found = measure(
                &surfaces,
                &outcome.simplices().unwrap().mesh.nodes,
                &Up::along(0, true),
                &[],
            );
            assert_eq!(found.len(), 3, "{kind:?} {seed}: {found:#?}");
            let truth = &made.truth;
            let [nx, ny, _] = truth.dims;
            for m in &found {
                // The exact plane, by a sample near it whose truth fits the surface best.
                let n: [f64; 3] = std::array::from_fn(|k| m.normal[k]);
                let middle: [f64; 3] = std::array::from_fn(|k| m.centre[k]);
                let near = (0..truth.distance.len()).filter(|&i| truth.distance[i] < 2.0);
                let fit = |&i: &usize| {
                    let at = [i % nx, i / nx % ny, i / (nx * ny)].map(|c| c as f64);
                    let off = dot(geometry::sub(at, middle), n).abs();
                    let aligned = dot(truth.direction[i].map(f64::from), n).abs();
                    (1.0 - aligned) + 1e-3 * off
                };
                let best = near.min_by(|i, j| fit(i).total_cmp(&fit(j))).unwrap();
                let at = [best % nx, best / nx % ny, best / (nx * ny)].map(|c| c as f64);
                let exact = truth.direction[best].map(f64::from);
                if kind == Kind::Planes {
                    let foot = geometry::add_scaled(at, f64::from(truth.distance[best]), exact);
                    let area = plane_area(exact, dot(foot, exact), truth.dims);
                    assert!(
                        (m.area / area - 1.0).abs() < 0.05,
                        "{seed}: {} {area}",
                        m.area
                    );
                    assert!(
                        dot(exact, n).abs() > 0.5f64.to_radians().cos(),
                        "{exact:?} {n:?}"
                    );
                    assert!(m.off_plane < 0.3, "{m:?}");
                }
            }
            // In all: the volume of a layer about the faults tells their area (but for where they
            // cross: there it tells less).
            let layer = truth.distance.iter().filter(|&&d| d < 2.0).count() as f64 / 4.0;
            let all: f64 = found.iter().map(|m| m.area).sum();
            assert!(
                (all / layer - 1.03).abs() < 0.05,
                "{kind:?} {seed}: {all} {layer}"
            );

            // The same faces, but for a few, are found by the potential alone.
            let Features {
                potential, sigma, ..
            } = &outcome.features;
            let by_image = select::in_valleys(
                &outcome.simplices().unwrap().mesh,
                potential,
                *sigma,
                0.6,
                0.82,
            );
            let marked = marked(&outcome);
            let both = by_image
                .iter()
                .filter(|f| marked.binary_search(f).is_ok())
                .count();
            let [one, other] = [&marked, &by_image].map(|list| both as f64 / list.len() as f64);
            assert!(one > 0.95 && other > 0.8, "{one} {other}");
        }
    }

    /// Three layers, folded and thrown by a fault: six units.
    fn unit([x, y, z]: [f64; 3]) -> u32 {
        let beyond = y - 30.0 + 0.35 * (x - 36.0) - 0.15 * (z - 26.0) > 0.0;
        let depth = x + 2.0 * (z * 0.1).sin() + if beyond { 9.0 } else { 0.0 };
        let layer = [22.0, 48.0].iter().filter(|&&top| depth > top).count() as u32;
        layer + if beyond { 3 } else { 0 }
    }

    #[test]
    fn painted_units_have_their_volume_and_do_not_leak() {
        let dims = [72, 60, 52];
        let image = image(dims, |x| f64::from(unit(x)));
        let outcome = mesh(&image, feature::FeatureKind::Labels, 6.0);
        let mut closed = group(&outcome, Some(0.0)).facets;
        closed.iter_mut().for_each(|f| f.sort_unstable());
        closed.sort_unstable();
        let cells = cells(&outcome.simplices().unwrap().mesh, &closed);
        let (block, count) = blocks(&cells, 0.3, 24);
        assert_eq!(count, 6);
        let cost: Vec<f64> = cells.links.iter().map(|l| cells.resistance(l)).collect();

        // The truth: the volume of each unit, by points half a sample apart.
        let mut truth = [0.0; 6];
        let fine = dims.map(|n| 2 * (n - 1));
        for z in 0..fine[2] {
            for y in 0..fine[1] {
                for x in 0..fine[0] {
                    truth[unit([x, y, z].map(|c| 0.5 * c as f64 + 0.25)) as usize] += 0.125;
                }
            }
        }
        // A seed in the middle of each unit, one unit after the other: nothing else stops the paint.
        let places = [
            [10.0, 20.0],
            [32.0, 15.0],
            [60.0, 8.0],
            [6.0, 50.0],
            [26.0, 48.0],
            [55.0, 45.0],
        ];
        for [x, y] in places {
            let seed = [x, y, 25.3];
            let want = unit(seed);
            let seeds = [Seed {
                cell: at(&outcome.simplices().unwrap().mesh, seed),
                unit: want,
            }];
            let (painted, _) = flow(&cells, &block, &cost, &seeds, f64::INFINITY);
            let (mut all, mut wrong) = (0.0, 0.0);
            for t in 0..cells.len() {
                if painted[t].is_some() {
                    all += cells.volumes[t];
                    if unit(cells.centres[t]) != want {
                        wrong += cells.volumes[t];
                    }
                }
            }
            let true_volume = truth[want as usize];
            assert!(
                (all / true_volume - 1.0).abs() < 0.03,
                "unit {want}: {all} {true_volume}"
            );
            assert!(
                wrong < 0.02 * true_volume,
                "unit {want}: {wrong} of {true_volume} leaked"
            );
        }
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let outcome = mesh(
            &image([40, 36, 32], |x| {
                f64::from(u8::from(x[0] + 0.3 * x[1] > 25.0))
            }),
            feature::FeatureKind::Labels,
            6.0,
        );
        let run = || {
            let surfaces = group(&outcome, None);
            let cells = cells(&outcome.simplices().unwrap().mesh, &surfaces.facets);
            (surfaces, blocks(&cells, 0.3, 10))
        };
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let four = rayon::ThreadPoolBuilder::new()
            .num_threads(4)
            .build()
            .unwrap();
        assert_eq!(one.install(run), four.install(run));
    }
}
