//! The boundary between object and background as a surface (a curve in the plane), smoothed.

use crate::mesh::Mesh;

/// The facets between cells of label 1 and cells of label 0, turned out of the object. `cells` are
/// those of [`Mesh::cells_of_faces`]. Where the object touches the side of the box there is none.
pub fn between<const D: usize, F: Mesh<D>>(
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

/// Moves nodes of a surface towards the mean of their neighbours on it, by the share `lambda`, so
/// many times (Xu 2016: 3 times by 0.5). On its rim only neighbours on the rim count, and where a
/// curve ends, nothing moves. Nodes of no facet stay.
pub fn smooth<const D: usize>(
    nodes: &mut [[f64; D]],
    facets: &[[u32; D]],
    times: usize,
    lambda: f64,
) {
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for facet in facets {
        for i in 0..D {
            for j in 0..i {
                edges.push([facet[i].min(facet[j]), facet[i].max(facet[j])]);
            }
        }
    }
    edges.sort_unstable();
    // Each edge once; of one facet only, it is the rim's.
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
    for _ in 0..times {
        let mut sums = vec![([0.0; D], 0.0f64); nodes.len()];
        for &([a, b], is_rim) in &edges {
            for (own, other) in [(a, b), (b, a)] {
                if !on_rim[own as usize] || (is_rim && D > 2) {
                    let (sum, count) = &mut sums[own as usize];
                    let other = nodes[other as usize];
                    *sum = std::array::from_fn(|k| sum[k] + other[k]);
                    *count += 1.0;
                }
            }
        }
        for (x, (sum, count)) in nodes.iter_mut().zip(sums) {
            if count > 0.0 {
                *x = std::array::from_fn(|k| x[k] + lambda * (sum[k] / count - x[k]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn the_boundary_points_out_of_the_object() {
        let mesh = two_cells::<3>(0.75);
        let across = mesh.cells_of_faces().unwrap();
        for (labels, sign) in [([1, 0], 1.0), ([0, 1], -1.0)] {
            let facets = between(&mesh, &across, &labels);
            assert_eq!(facets.len(), 2);
            for facet in facets {
                let [p, q, r] = facet.map(|n| mesh.nodes[n as usize]);
                assert!([p, q, r].iter().all(|x| x[0] == 0.75));
                let area = (q[1] - p[1]) * (r[2] - p[2]) - (q[2] - p[2]) * (r[1] - p[1]);
                assert!((area - sign).abs() < 1e-12, "{area}");
            }
        }
        assert!(between(&mesh, &across, &[1, 1]).is_empty());
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
        smooth(&mut nodes, &ring, 3, 0.5);
        for p in &nodes {
            assert!((p[0].hypot(p[1]) - 10.45).abs() < 0.1, "{p:?}");
        }
        let mut line = vec![[0.0, 0.0], [1.0, 1.0], [2.0, 0.0], [9.0, 9.0]];
        smooth(&mut line, &[[0, 1], [1, 2]], 1, 0.5);
        assert_eq!(line, [[0.0, 0.0], [1.0, 0.5], [2.0, 0.0], [9.0, 9.0]]);
    }

    #[test]
    fn the_rim_of_a_surface_keeps_to_its_plane() {
        // A fan of triangles round a node that stands up; its rim lies in z = 0.
        let mut nodes = vec![[0.0, 0.0, 1.0]];
        let mut facets = Vec::new();
        for i in 0..8u32 {
            let angle = std::f64::consts::TAU * f64::from(i) / 8.0;
            nodes.push([angle.cos(), angle.sin(), 0.0]);
            facets.push([0, 1 + i, 1 + (i + 1) % 8]);
        }
        smooth(&mut nodes, &facets, 3, 0.5);
        assert!((nodes[0][2] - 0.125).abs() < 1e-12);
        assert!(nodes[1..].iter().all(|p| p[2] == 0.0));
    }
}
