//! The boundary between object and background as a smooth surface (a curve in 2-D).

use crate::mesh::Mesh;

/// Returns the facets between cells of label 1 and cells of label 0, oriented so that their normals
/// point out of the object. `cells` is the result of [`Mesh::cells_of_faces`]. Sides of the box are
/// not part of the boundary.
pub fn boundary_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    cells: &[[u32; 2]],
    labels: &[u8],
) -> Vec<[u32; D]> {
    let mut facets = Vec::new();
    for (face, cells) in cells.iter().enumerate() {
        if let [Some(a), Some(b)] = cells.map(|c| labels.get(c as usize))
            && a != b
        {
            mesh.facets(face, |mut facet| {
                if *a == 0 {
                    facet.swap(0, 1);
                }
                facets.push(facet);
            });
        }
    }
    facets
}

/// Fractions of the way to the mean of their neighbours by which nodes move, in turn (Taubin 1995):
/// first towards the mean, then slightly farther away from it. A ball shrinks in the first step and
/// grows by as much in the second, while roughness decreases in both. (Three steps of 0.5, as in Xu
/// 2016, shrink a ball of radius 40 by 0.75.)
const TAUBIN_WEIGHTS: [f64; 2] = [0.5, -0.51];
/// Number of repetitions of both steps.
const SMOOTHING_ROUNDS: usize = 10;

/// Smooths a surface and keeps the volume that it encloses. Nodes on the rim of a surface depend
/// only on neighbours on the rim. End nodes of a curve, and nodes without a facet, do not move.
pub fn smooth<const D: usize>(nodes: &mut [[f64; D]], facets: &[[u32; D]]) {
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for facet in facets {
        for i in 0..D {
            for j in 0..i {
                edges.push([facet[i].min(facet[j]), facet[i].max(facet[j])]);
            }
        }
    }
    edges.sort_unstable();
    // Each edge occurs once here; an edge of only one facet is on the rim.
    let edges: Vec<([u32; 2], bool)> = edges
        .chunk_by(|a, b| a == b)
        .map(|same| (same[0], same.len() == 1))
        .collect();
    let mut on_rim = vec![false; nodes.len()];
    if D == 2 {
        let mut degree = vec![0u8; nodes.len()];
        for n in edges.iter().flat_map(|(edge, _)| edge) {
            degree[*n as usize] = degree[*n as usize].saturating_add(1);
        }
        on_rim
            .iter_mut()
            .zip(degree)
            .for_each(|(rim, n)| *rim = n == 1);
    } else {
        for (edge, is_rim) in &edges {
            edge.iter().for_each(|&n| on_rim[n as usize] |= is_rim);
        }
    }
    for weight in [TAUBIN_WEIGHTS; SMOOTHING_ROUNDS].into_iter().flatten() {
        let mut sums = vec![([0.0; D], 0.0f64); nodes.len()];
        for &([a, b], is_rim) in &edges {
            for (node, neighbour) in [(a, b), (b, a)] {
                if !on_rim[node as usize] || (is_rim && D > 2) {
                    let (sum, count) = &mut sums[node as usize];
                    let neighbour = nodes[neighbour as usize];
                    *sum = std::array::from_fn(|k| sum[k] + neighbour[k]);
                    *count += 1.0;
                }
            }
        }
        for (x, (sum, count)) in nodes.iter_mut().zip(sums) {
            if count > 0.0 {
                *x = std::array::from_fn(|k| x[k] + weight * (sum[k] / count - x[k]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{dot, norm, normal, sub};
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::samples::two_cells;
    use std::f64::consts::PI;

    #[test]
    fn the_boundary_points_out_of_the_object() {
        let mesh = two_cells::<3>(0.75);
        let face_cells = mesh.cells_of_faces().unwrap();
        for (labels, sign) in [([1, 0], 1.0), ([0, 1], -1.0)] {
            let facets = boundary_facets(&mesh, &face_cells, &labels);
            assert_eq!(facets.len(), 2);
            for facet in facets {
                let [p, q, r] = facet.map(|n| mesh.nodes[n as usize]);
                assert!([p, q, r].iter().all(|x| x[0] == 0.75));
                let area = (q[1] - p[1]) * (r[2] - p[2]) - (q[2] - p[2]) * (r[1] - p[1]);
                assert!((area - sign).abs() < 1e-12, "{area}");
            }
        }
        assert!(boundary_facets(&mesh, &face_cells, &[1, 1]).is_empty());
    }

    #[test]
    fn a_ragged_circle_becomes_rounder_and_an_end_stays() {
        let n = 64u32;
        let node = |i: u32| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
            let radius = if i.is_multiple_of(2) { 10.0 } else { 11.0 };
            [radius * angle.cos(), radius * angle.sin()]
        };
        let mut nodes: Vec<[f64; 2]> = (0..n).map(node).collect();
        let ring: Vec<[u32; 2]> = (0..n).map(|i| [i, (i + 1) % n]).collect();
        smooth(&mut nodes, &ring);
        for p in &nodes {
            assert!((p[0].hypot(p[1]) - 10.5).abs() < 0.02, "{p:?}");
        }
        let mut line = vec![[0.0, 0.0], [1.0, 1.0], [2.0, 0.0], [9.0, 9.0]];
        smooth(&mut line, &[[0, 1], [1, 2]]);
        // Half of the way towards the ends, then 0.51 of the distance back.
        assert!((line[1][1] - (0.5f64 * 1.51).powi(10)).abs() < 1e-12);
        line[1][1] = 0.0;
        assert_eq!(line, [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0]]);
    }

    #[test]
    fn the_rim_of_a_surface_keeps_to_its_plane() {
        // A fan of triangles around a raised node; its rim lies in z = 0.
        let mut nodes = vec![[0.0, 0.0, 1.0]];
        let mut facets = Vec::new();
        for i in 0..8u32 {
            let angle = std::f64::consts::TAU * f64::from(i) / 8.0;
            nodes.push([angle.cos(), angle.sin(), 0.0]);
            facets.push([0, 1 + i, 1 + (i + 1) % 8]);
        }
        smooth(&mut nodes, &facets);
        assert!((nodes[0][2] - (0.5f64 * 1.51).powi(10)).abs() < 1e-12);
        assert!(nodes[1..].iter().all(|p| p[2] == 0.0));
    }

    /// Returns the volume that facets enclose, and their area.
    fn volume_and_area(nodes: &[[f64; 3]], facets: &[[u32; 3]]) -> (f64, f64) {
        let facet_sums = |facet: &[u32; 3]| {
            let corners = facet.map(|n| nodes[n as usize]);
            let n = normal(&corners);
            (dot(n, corners[0]) / 3.0, norm(n))
        };
        let sum = |a: (f64, f64), b: (f64, f64)| (a.0 + b.0, a.1 + b.1);
        facets.iter().map(facet_sums).fold((0.0, 0.0), sum)
    }

    #[test]
    fn a_ragged_ball_keeps_its_volume_and_loses_its_raggedness() {
        // Tetrahedra whose centres are within a ball, in meshes of two sizes.
        for (cubes, size, radius) in [(24, 4.0, 39.92), (16, 3.0, 15.0)] {
            let mesh = kuhn_box([cubes; 3], size);
            let centre = 0.5 * size * cubes as f64;
            let is_inside = |(_, x): &(f64, [f64; 3])| norm(sub(*x, [centre; 3])) < radius;
            let volumes = mesh.cell_volumes();
            let labels: Vec<u8> = volumes.iter().map(|c| u8::from(is_inside(c))).collect();
            let facets = boundary_facets(&mesh, &mesh.cells_of_faces().unwrap(), &labels);
            let (before, ragged) = volume_and_area(&mesh.nodes, &facets);
            let mut nodes = mesh.nodes.clone();
            smooth(&mut nodes, &facets);
            let (after, area) = volume_and_area(&nodes, &facets);
            let radius_of = |volume: f64| (0.75 * volume / PI).cbrt();
            let change = radius_of(after) - radius_of(before);
            assert!(change.abs() < 0.1, "{change}");
            // Areas relative to that of a sphere.
            let [ragged, area] = [ragged, area].map(|a| a / (4.0 * PI * radius * radius));
            assert!(ragged > 1.25 && area < 1.08, "{ragged} {area}");
        }
    }
}
