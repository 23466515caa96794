//! Ways compared with the shortest ones that geometry knows: straight, and round the end of a wall.

use super::*;
use crate::geometry::random::Random;
use crate::mesh::boxes::jittered_box;
use crate::mesh::voronoi::voronoi_plane;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::model::surface::adjacency::find_cell;

/// Ways on a mesh from a point, as far as `most`, and how well the cells that they reach agree with the
/// places for which `within` holds: Dice's coefficient, which whole cells cannot make 1, and that of all
/// cells of which half and more is within.
fn check_geodesics<const D: usize, F: Mesh<D>>(
    mesh: &F,
    closed: &[[u32; D]],
    at: [f64; D],
    most: f64,
    within: impl Fn([f64; D]) -> bool,
) -> [f64; 2] {
    let across = mesh.cells_of_faces().unwrap();
    let cells = CellAdjacency::new(mesh, &across, closed);
    let ways = Geodesics::new(mesh, &across, &cells);
    let cell = find_cell(mesh, &across, at).unwrap();
    let source = GeodesicSource {
        position: at,
        cell,
        label: 3,
    };
    let found = ways.shortest_paths(&[source], |l| cells.links[l].is_open, |_| 0.0, most);
    let reached = |c: usize| found.label[c].is_some();
    for c in 0..cells.len() {
        assert!(found.cost[c].is_finite() == reached(c));
        assert!(!reached(c) || (found.label[c] == Some(3) && found.cost[c] <= most));
    }
    // Each cell counts by the share of it that is within: of points between its facets and its centre.
    let mut sums = vec![[0.0; 2]; cells.len()];
    let mut random = Random::new(1);
    for (face, &both) in across.iter().enumerate() {
        for cell in both.into_iter().filter(|&c| c != NONE) {
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| mesh.nodes()[n as usize]);
                let centre = cells.centres[cell as usize];
                let height = dot(normal(&corners), sub(corners[0], centre)).abs();
                for _ in 0..8 {
                    // Uniform in the simplex: differences of sorted numbers.
                    let mut parts = [0.0; 4];
                    parts.iter_mut().for_each(|p| *p = -random.draw().ln());
                    let whole: f64 = parts[..=D].iter().sum();
                    let mut p = centre.map(|c| c * parts[D] / whole);
                    for k in 0..D {
                        p = add_scaled(p, parts[k] / whole, corners[k]);
                    }
                    let sum = &mut sums[cell as usize];
                    sum[0] += height;
                    sum[1] += if within(p) { height } else { 0.0 };
                }
            });
        }
    }
    let shares: Vec<f64> = sums.iter().map(|[whole, inside]| inside / whole).collect();
    let of = |chosen: &dyn Fn(usize) -> bool| {
        let (mut both, mut either) = (0.0, 0.0);
        for (c, share) in shares.iter().enumerate() {
            let chosen = f64::from(u8::from(chosen(c)));
            both += 2.0 * chosen * share * cells.volumes[c];
            either += (share + chosen) * cells.volumes[c];
        }
        both / either
    };
    [of(&reached), of(&|c| shares[c] >= 0.5)]
}

fn length<const D: usize>(a: [f64; D], b: [f64; D]) -> f64 {
    norm(sub(a, b))
}

/// Atoms in the plane about `d` apart.
fn random_points(extent: f64, d: f64) -> Vec<[f64; 2]> {
    let n = (extent / d) as usize;
    let mut random = Random::new(2);
    let mut atoms = Vec::new();
    for i in 0..n * n {
        let cell = [i % n, i / n];
        atoms.push(cell.map(|c| (c as f64 + random.range(0.15, 0.85)) * extent / n as f64));
    }
    atoms
}

#[test]
fn ways_reach_a_disc_and_a_ball_whatever_the_cells() {
    for d in [1.5f64, 3.0, 6.0] {
        let radius = 15.0 * d.max(2.0);
        let n = (2.4 * radius / d) as usize;
        let extent = d * n as f64;
        let middle = [0.5 * extent + 0.3, 0.5 * extent - 0.4];
        let disc = |p| length(p, middle) <= radius;
        let squares: TriMesh = jittered_box([n; 2], [extent; 2], 0.3, |_| true);
        let [found, best] = check_geodesics(&squares, &[], middle, radius, disc);
        assert!(
            found > 0.97 && found > best - 0.003,
            "triangles, {d}: {found} {best}"
        );
        let polygons = voronoi_plane(&random_points(extent, d), [extent; 2]).unwrap();
        let [found, best] = check_geodesics(&polygons, &[], middle, radius, disc);
        assert!(
            found > 0.97 && found > best - 0.003,
            "polygons, {d}: {found} {best}"
        );
    }
    let cubes: TetMesh = jittered_box([16; 3], [32.0; 3], 0.25, |_| true);
    let middle = [16.3, 15.8, 16.1];
    let [found, best] = check_geodesics(&cubes, &[], middle, 15.0, |p| length(p, middle) <= 15.0);
    assert!(
        found > 0.96 && found > best - 0.003,
        "tetrahedra: {found} {best}"
    );
}

/// A wall from the left side to the tip at (36, 36), and a source above it: below, ways go round the
/// tip, and turn in the centre of a cell near it.
#[test]
fn ways_go_round_the_end_of_a_wall() {
    let (tip, at, most) = ([36.0, 36.0], [24.2, 44.1], 30.0);
    let seen = |p: [f64; 2]| {
        let t = (at[1] - tip[1]) / (at[1] - p[1]);
        p[1] >= tip[1] || at[0] + t * (p[0] - at[0]) >= tip[0]
    };
    let way = |p| {
        if seen(p) {
            length(at, p)
        } else {
            length(at, tip) + length(tip, p)
        }
    };
    for (n, least) in [(24, 0.96), (48, 0.97)] {
        let moves = |x: [f64; 2]| x[1] != tip[1];
        let mesh: TriMesh = jittered_box([n; 2], [72.0; 2], 0.3, moves);
        let mut wall = Vec::new();
        for c in 0..mesh.triangles.len() {
            for k in 0..3 {
                let mut face = mesh.face(c, k);
                face.sort_unstable();
                let on = |n: &u32| {
                    let [x, y] = mesh.nodes[*n as usize];
                    y == tip[1] && x <= tip[0]
                };
                if face.iter().all(on) {
                    wall.push(face);
                }
            }
        }
        wall.sort_unstable();
        wall.dedup();
        assert_eq!(wall.len(), n / 2);
        let [found, best] = check_geodesics(&mesh, &wall, at, most, |p| way(p) <= most);
        assert!(found > least && found > best - 0.02, "{n}: {found} {best}");
        // As the crow flies it would be another place.
        assert!(check_geodesics(&mesh, &wall, at, most, |p| length(at, p) <= most)[0] < 0.93);
    }
}

#[test]
fn tolls_are_paid_and_the_nearer_source_wins() {
    let mesh: TriMesh = jittered_box([40, 10], [40.0, 10.0], 0.2, |_| true);
    let across = mesh.cells_of_faces().unwrap();
    let cells = CellAdjacency::new(&mesh, &across, &[]);
    let ways = Geodesics::new(&mesh, &across, &cells);
    let source = |x: f64, label| {
        let at = [x, 5.1];
        let cell = find_cell(&mesh, &across, at).unwrap();
        GeodesicSource {
            position: at,
            cell,
            label,
        }
    };
    let both = [source(4.3, 1), source(30.1, 2)];
    let divide = |toll: &dyn Fn(usize) -> f64| {
        let found = ways.shortest_paths(&both, |_| true, toll, f64::INFINITY);
        let own = (0..cells.len()).filter(|&c| found.label[c] == Some(1));
        own.map(|c| cells.volumes[c]).sum::<f64>() / 10.0
    };
    // Half-way, bent a little: nothing bends the line between two points.
    let free = divide(&|_| 0.0);
    assert!((free - 17.2).abs() < 0.3, "{free}");
    // Six to pay at x = 12 moves the divide by three.
    let toll = |l: usize| {
        let [a, b] = cells.links[l]
            .cells
            .map(|c| cells.centres[c as usize][0] > 12.0);
        if a == b { 0.0 } else { 6.0 }
    };
    let paid = divide(&toll);
    assert!((paid - 14.2).abs() < 0.5, "{paid}");
}
