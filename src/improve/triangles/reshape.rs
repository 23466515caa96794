//! Adds, removes and moves atoms in a part of a mesh, whose outline does not change.
//!
//! In the plane, a constrained triangulation of the target positions contains the outline of the
//! part. Triangles outside of the outline are removed.

use super::{TriImprover, adjacency};
use crate::error::{Error, Result, cause};
use crate::geometry::{hypot, sorted};
use crate::improve::constraint::common_sides;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{Reshape, ReshapeError, ReshapeRequest, ReshapeResult};
use crate::lattice::distance::Distance;
use crate::mesh::TriMesh;
use crate::mesh::complex::NONE;
use crate::mesh::delaunay::constrained_plane;
use crate::mesh::renumber::new_numbers;
use crate::mesh::tri::{SIDES, double_area};
use crate::progress::CancelToken;

impl Reshape<2> for TriMesh {
    fn reshape(
        &self,
        request: &ReshapeRequest<2>,
        extent: [f64; 2],
        planes: &FeaturePlanes,
        distance: &Distance<2>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<Self>, ReshapeError> {
        let kept_nodes: Vec<u32> = (0..request.targets.len() as u32)
            .filter(|&n| !request.is_removed[n as usize])
            .collect();
        let new_ids = new_numbers(request.targets.len(), &kept_nodes);
        let points: Vec<[f64; 2]> = kept_nodes
            .iter()
            .map(|&n| request.targets[n as usize])
            .collect();
        let kinds: Vec<_> = kept_nodes
            .iter()
            .map(|&n| request.kinds[n as usize])
            .collect();
        let rim: Vec<[u32; 2]> = outer_edges(self, extent)
            .map_err(ReshapeError::Mesh)?
            .into_iter()
            .map(|edge| edge.map(|n| new_ids[n as usize]))
            .collect();
        let triangulation = constrained_plane(&points, &rim).map_err(ReshapeError::Mesh)?;
        if let Some(n) = find_node_on_rim(&triangulation, &rim) {
            return Err(ReshapeError::Node(kept_nodes[n]));
        }
        let mesh = keep_inside_rim(triangulation, &rim).map_err(ReshapeError::Mesh)?;
        let mut used = vec![false; points.len()];
        for &n in mesh.triangles.as_flattened() {
            used[n as usize] = true;
        }
        if let Some(unused) = used.iter().position(|used| !used) {
            return Err(ReshapeError::Node(kept_nodes[unused]));
        }
        let area = |mesh: &TriMesh| -> f64 {
            (0..mesh.triangles.len())
                .map(|t| double_area(&mesh.corners(t)))
                .sum()
        };
        let (old, new) = (area(self), area(&mesh));
        if (old - new).abs() > 1e-9 * old {
            return Err(ReshapeError::Mesh(Error::Mesh(cause(
                "the mesh around the edit",
                format!("would have the area {new} instead of {old}"),
                "mesh the image again",
            ))));
        }
        let neighbours = adjacency(&mesh).map_err(ReshapeError::Mesh)?;
        let mut improver = TriImprover::new(
            mesh, neighbours, &kinds, extent, planes, distance, min_angle,
        );
        let report = improver.improve(&CancelToken::never());
        let finished = improver.finish();
        // Nodes keep their indices in the request; nodes that improvement has inserted come after
        // those.
        let inserted = |n: u32| n - kept_nodes.len() as u32 + request.targets.len() as u32;
        let kept = finished.old_ids.iter();
        let kept = kept.map(|&n| {
            kept_nodes
                .get(n as usize)
                .copied()
                .unwrap_or_else(|| inserted(n))
        });
        Ok(ReshapeResult {
            request_nodes: kept.collect(),
            mesh: finished.mesh,
            kinds: finished.kinds,
            feature_faces: finished.feature_faces,
            report,
        })
    }
}

/// Returns the outline of the part, except for edges in the sides of the box. The part is on the
/// left of each edge.
fn outer_edges(part: &TriMesh, extent: [f64; 2]) -> Result<Vec<[u32; 2]>> {
    let neighbours = adjacency(part)?;
    let mut rim = Vec::new();
    for (triangle, adjacent) in part.triangles.iter().zip(&neighbours) {
        for k in (0..3).filter(|&k| adjacent[k] == NONE) {
            let edge = SIDES[k].map(|i| triangle[i]);
            let ends = edge.into_iter().map(|n| part.nodes[n as usize]);
            if common_sides(ends, extent) == 0 {
                rim.push(edge);
            }
        }
    }
    Ok(rim)
}

/// Returns a node that lies on an edge of the outline, so that no triangle has this edge: the node
/// nearest to the edge, except for its ends. Returns `None` if the triangles have all edges of the
/// outline.
fn find_node_on_rim(mesh: &TriMesh, rim: &[[u32; 2]]) -> Option<usize> {
    let sides = |t: &[u32; 3]| SIDES.map(|side| side.map(|i| t[i]));
    let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(sides).collect();
    edges.sort_unstable();
    let is_lost = |edge: &&[u32; 2]| edges.binary_search(edge).is_err();
    let &[a, b] = rim.iter().find(is_lost)?;
    let [p, q] = [a, b].map(|n| mesh.nodes[n as usize]);
    let along = [q[0] - p[0], q[1] - p[1]];
    let distance = |n: &usize| {
        let [x, y] = mesh.nodes[*n];
        let dot = (x - p[0]) * along[0] + (y - p[1]) * along[1];
        let fraction = (dot / (along[0].powi(2) + along[1].powi(2))).clamp(0.0, 1.0);
        hypot(
            x - p[0] - fraction * along[0],
            y - p[1] - fraction * along[1],
        )
    };
    let others = (0..mesh.nodes.len()).filter(|&n| n != a as usize && n != b as usize);
    others.min_by(|m, n| distance(m).total_cmp(&distance(n)))
}

/// Keeps the triangles on the left of the outline, and all that can be reached from these without
/// crossing it. Keeps all triangles if there is no outline.
fn keep_inside_rim(mesh: TriMesh, rim: &[[u32; 2]]) -> Result<TriMesh> {
    if rim.is_empty() {
        return Ok(mesh);
    }
    let sorted = sorted(rim.to_vec());
    let is_rim = |edge: [u32; 2]| sorted.binary_search(&edge).is_ok();
    let neighbours = adjacency(&mesh)?;
    let edge = |t: usize, k: usize| SIDES[k].map(|i| mesh.triangles[t][i]);
    let mut inside: Vec<bool> = (0..mesh.triangles.len())
        .map(|t| (0..3).any(|k| is_rim(edge(t, k))))
        .collect();
    let mut queue: Vec<usize> = (0..inside.len()).filter(|&t| inside[t]).collect();
    while let Some(t) = queue.pop() {
        for k in (0..3).filter(|&k| !is_rim(edge(t, k))) {
            let next = neighbours[t][k] as usize;
            if neighbours[t][k] != NONE && !inside[next] {
                inside[next] = true;
                queue.push(next);
            }
        }
    }
    let triangles = (mesh.triangles.iter().zip(&inside))
        .filter(|(_, inside)| **inside)
        .map(|(triangle, _)| *triangle)
        .collect();
    Ok(TriMesh {
        nodes: mesh.nodes,
        triangles,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sorted_distinct;
    use crate::lattice::AtomKind;
    use crate::mesh::delaunay::delaunay_plane;

    #[test]
    fn an_l_shaped_part_keeps_its_outline() {
        // A grid of unit squares. The part is an L, and its convex hull is larger than the part.
        let nodes: Vec<[f64; 2]> = (0..49)
            .map(|i| [f64::from(i % 7), f64::from(i / 7)])
            .collect();
        let extent = [6.0; 2];
        let full = delaunay_plane(&nodes).unwrap();
        let in_part = |t: &[u32; 3]| {
            let middle = |k: usize| t.iter().map(|&n| nodes[n as usize][k]).sum::<f64>() / 3.0;
            let (x, y) = (middle(0), middle(1));
            x > 1.0 && y < 5.0 && !(x > 4.0 && y > 2.0)
        };
        let cells: Vec<[u32; 3]> = full.triangles.iter().copied().filter(in_part).collect();
        let numbers = sorted_distinct(cells.as_flattened().iter().copied());
        let local = |n: u32| numbers.binary_search(&n).unwrap() as u32;
        let part = TriMesh {
            nodes: numbers.iter().map(|&n| nodes[n as usize]).collect(),
            triangles: cells.iter().map(|t| t.map(local)).collect(),
        };
        let before = outer_edges(&part, extent).unwrap();
        let [removed, moved] =
            [[2.0, 2.0], [3.0, 3.0]].map(|x| part.nodes.iter().position(|&y| y == x).unwrap());
        let mut request = ReshapeRequest {
            targets: part.nodes.clone(),
            kinds: vec![AtomKind::Fixed; part.nodes.len()],
            is_removed: vec![false; part.nodes.len() + 1],
        };
        request.is_removed[removed] = true;
        request.targets[moved] = [3.2, 3.1];
        request.targets.push([2.4, 2.3]);
        request.kinds.push(AtomKind::Fixed);
        let planes = FeaturePlanes::new(&[], extent, 2.0, 2.0);
        let distance = Distance::Constant(1.0);
        let result = part
            .reshape(&request, extent, &planes, &distance, 20.0)
            .unwrap();
        let mut after: Vec<[u32; 2]> = outer_edges(&result.mesh, extent)
            .unwrap()
            .into_iter()
            .map(|edge| edge.map(|n| result.request_nodes[n as usize]))
            .collect();
        let mut before = before;
        before.sort_unstable();
        after.sort_unstable();
        assert_eq!(before, after);
        assert!(!result.request_nodes.contains(&(removed as u32)));
        for (x, &n) in result.mesh.nodes.iter().zip(&result.request_nodes) {
            if let Some(target) = request.targets.get(n as usize) {
                assert_eq!(x, target);
            }
        }
        let error_of = |part: &TriMesh, request: &ReshapeRequest<2>| {
            part.reshape(request, extent, &planes, &distance, 20.0)
                .unwrap_err()
        };
        // A node cannot be outside of the outline, nor on it.
        for x in [[5.0, 4.0], [4.0, 3.5]] {
            request.targets[moved] = x;
            let error = error_of(&part, &request);
            assert!(
                matches!(error, ReshapeError::Node(n) if n as usize == moved),
                "{error:?}"
            );
        }
        // An error that no single node causes is returned as such.
        request.targets[moved] = [f64::NAN, 3.0];
        let ReshapeError::Mesh(error) = error_of(&part, &request) else {
            panic!("a node was blamed");
        };
        assert!(
            error.to_string().contains("too large to compute"),
            "{error}"
        );
        request.targets[moved] = [3.2, 3.1];
        let mut twice = part.clone();
        twice.triangles.push(part.triangles[0]);
        let ReshapeError::Mesh(error) = error_of(&twice, &request) else {
            panic!("a node was blamed");
        };
        assert!(error.to_string().contains("overlap"), "{error}");
    }
}
