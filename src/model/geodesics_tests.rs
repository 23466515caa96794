//! Compares paths with the exact shortest paths: straight lines, and lines around the end of a
//! wall.

use super::*;
use crate::geometry::random::Random;
use crate::mesh::boxes::jittered_box;
use crate::mesh::voronoi::voronoi_plane;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::model::surface::adjacency::find_cell;

/// Computes the cells within `max_cost` of a position, and compares them with the region in which
/// `is_inside` is `true`. Returns Dice's coefficient of the two, and that of the cells which are at
/// least half inside. Whole cells cannot reach 1.
fn check_geodesics<const D: usize, F: Mesh<D>>(
    mesh: &F,
    closed: &[[u32; D]],
    position: [f64; D],
    max_cost: f64,
    is_inside: impl Fn([f64; D]) -> bool,
) -> [f64; 2] {
    let face_cells = mesh.cells_of_faces().unwrap();
    let cells = CellAdjacency::new(mesh, &face_cells, closed);
    let geodesics = Geodesics::new(mesh, &face_cells, &cells);
    let cell = find_cell(mesh, &face_cells, position).unwrap();
    let source = GeodesicSource {
        position,
        cell,
        label: 3,
    };
    let arrivals =
        geodesics.shortest_paths(&[source], |l| cells.links[l].is_open, |_| 0.0, max_cost);
    let reached = |c: usize| arrivals.label[c].is_some();
    for c in 0..cells.len() {
        assert!(arrivals.cost[c].is_finite() == reached(c));
        assert!(!reached(c) || (arrivals.label[c] == Some(3) && arrivals.cost[c] <= max_cost));
    }
    // Each cell counts by the fraction of it that is inside, estimated from points between its
    // facets and its centre.
    let mut sums = vec![[0.0; 2]; cells.len()];
    let mut random = Random::new(1);
    for (face, &cell_pair) in face_cells.iter().enumerate() {
        for cell in cell_pair.into_iter().filter(|&c| c != NONE) {
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| mesh.nodes()[n as usize]);
                let centre = cells.centres[cell as usize];
                let height = dot(normal(&corners), sub(corners[0], centre)).abs();
                for _ in 0..8 {
                    // Normalised exponential variables are uniform in the simplex.
                    let mut weights = [0.0; 4];
                    weights.iter_mut().for_each(|p| *p = -random.draw().ln());
                    let total: f64 = weights[..=D].iter().sum();
                    let mut p = centre.map(|c| c * weights[D] / total);
                    for k in 0..D {
                        p = add_scaled(p, weights[k] / total, corners[k]);
                    }
                    let sum = &mut sums[cell as usize];
                    sum[0] += height;
                    sum[1] += if is_inside(p) { height } else { 0.0 };
                }
            });
        }
    }
    let shares: Vec<f64> = sums.iter().map(|[total, inside]| inside / total).collect();
    let dice = |chosen: &dyn Fn(usize) -> bool| {
        let (mut both, mut either) = (0.0, 0.0);
        for (c, share) in shares.iter().enumerate() {
            let weight = f64::from(u8::from(chosen(c)));
            both += 2.0 * weight * share * cells.volumes[c];
            either += (share + weight) * cells.volumes[c];
        }
        both / either
    };
    [dice(&reached), dice(&|c| shares[c] >= 0.5)]
}

fn length<const D: usize>(a: [f64; D], b: [f64; D]) -> f64 {
    norm(sub(a, b))
}

/// Returns random points in a square, about `d` apart.
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
fn geodesics_reach_a_disc_and_a_ball_for_all_kinds_of_cells() {
    for d in [1.5f64, 3.0, 6.0] {
        let radius = 15.0 * d.max(2.0);
        let n = (2.4 * radius / d) as usize;
        let extent = d * n as f64;
        let middle = [0.5 * extent + 0.3, 0.5 * extent - 0.4];
        let disc = |p| length(p, middle) <= radius;
        let squares: TriMesh = jittered_box([n; 2], [extent; 2], 0.3, |_| true);
        let [score, best] = check_geodesics(&squares, &[], middle, radius, disc);
        assert!(
            score > 0.97 && score > best - 0.003,
            "triangles, {d}: {score} {best}"
        );
        let polygons = voronoi_plane(&random_points(extent, d), [extent; 2]).unwrap();
        let [score, best] = check_geodesics(&polygons, &[], middle, radius, disc);
        assert!(
            score > 0.97 && score > best - 0.003,
            "polygons, {d}: {score} {best}"
        );
    }
    let cubes: TetMesh = jittered_box([16; 3], [32.0; 3], 0.25, |_| true);
    let middle = [16.3, 15.8, 16.1];
    let [score, best] = check_geodesics(&cubes, &[], middle, 15.0, |p| length(p, middle) <= 15.0);
    assert!(
        score > 0.96 && score > best - 0.003,
        "tetrahedra: {score} {best}"
    );
}

/// A wall goes from the left side to its tip at (36, 36), with a source above it. Below the wall,
/// paths go around the tip and turn in the centre of a cell near it.
#[test]
fn geodesics_go_around_the_end_of_a_wall() {
    let (tip, source, max_cost) = ([36.0, 36.0], [24.2, 44.1], 30.0);
    let is_visible = |p: [f64; 2]| {
        let t = (source[1] - tip[1]) / (source[1] - p[1]);
        p[1] >= tip[1] || source[0] + t * (p[0] - source[0]) >= tip[0]
    };
    let distance = |p| {
        if is_visible(p) {
            length(source, p)
        } else {
            length(source, tip) + length(tip, p)
        }
    };
    for (n, min_score) in [(24, 0.96), (48, 0.97)] {
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
        let [score, best] =
            check_geodesics(&mesh, &wall, source, max_cost, |p| distance(p) <= max_cost);
        assert!(
            score > min_score && score > best - 0.02,
            "{n}: {score} {best}"
        );
        // Straight distances through the wall would give another region.
        assert!(
            check_geodesics(&mesh, &wall, source, max_cost, |p| length(source, p)
                <= max_cost)[0]
                < 0.93
        );
    }
}

#[test]
fn tolls_add_to_costs_and_the_nearest_source_wins() {
    let mesh: TriMesh = jittered_box([40, 10], [40.0, 10.0], 0.2, |_| true);
    let face_cells = mesh.cells_of_faces().unwrap();
    let cells = CellAdjacency::new(&mesh, &face_cells, &[]);
    let geodesics = Geodesics::new(&mesh, &face_cells, &cells);
    let source = |x: f64, label| {
        let position = [x, 5.1];
        let cell = find_cell(&mesh, &face_cells, position).unwrap();
        GeodesicSource {
            position,
            cell,
            label,
        }
    };
    let sources = [source(4.3, 1), source(30.1, 2)];
    let divide_position = |penalty: &dyn Fn(usize) -> f64| {
        let arrivals = geodesics.shortest_paths(&sources, |_| true, penalty, f64::INFINITY);
        let first_cells = (0..cells.len()).filter(|&c| arrivals.label[c] == Some(1));
        first_cells.map(|c| cells.volumes[c]).sum::<f64>() / 10.0
    };
    // The divide is half-way, because nothing bends the lines.
    let free = divide_position(&|_| 0.0);
    assert!((free - 17.2).abs() < 0.3, "{free}");
    // A penalty of six at x = 12 moves the divide by three.
    let penalty = |l: usize| {
        let [a, b] = cells.links[l]
            .cells
            .map(|c| cells.centres[c as usize][0] > 12.0);
        if a == b { 0.0 } else { 6.0 }
    };
    let paid = divide_position(&penalty);
    assert!((paid - 14.2).abs() < 0.5, "{paid}");
}
