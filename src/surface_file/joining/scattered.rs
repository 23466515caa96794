//! Joins sticks that cross, such as those on lines and on slices: Delaunay triangles of places along
//! all of them.

use std::collections::{BTreeMap, BTreeSet};

use super::line::{Line, Point};
use super::screening::{MAX_GAP_RATIO, least_direction};
use crate::error::Result;
use crate::geometry::{cross, dot, norm, sub, unit};
use crate::mesh::delaunay::delaunay_plane;

/// Distance between places on a stick, in units of the spacing of sticks.
const STEP_RATIO: f64 = 1.0 / 6.0;

/// Distance below which places become one node, in units of the distance between places.
const SNAP_RATIO: f64 = 0.3;

/// Smallest projected area of a triangle on the outside, in units of its area (75 degrees).
const MIN_PROJECTION: f64 = 0.26;

/// Largest cosine of the angle opposite to the outer edge of a flat triangle (135 degrees).
const MAX_OUTER_COSINE: f64 = -0.707;

/// Largest number of places.
const MAX_PLACES: f64 = 1e5;

/// A place on sticks that becomes a node.
struct Node {
    point: Point,
    projected: [f64; 2],
    /// The lines that pass through it.
    lines: BTreeSet<usize>,
}

/// Joins lines to triangles: the Delaunay triangles of places on them, projected along the direction
/// that is most perpendicular to the sticks and to the vectors between them. Triangles outside a
/// stick that bends, and those with an edge of more than [`MAX_GAP_RATIO`] times the usual length,
/// are left out.
///
/// # Errors
/// Returns an error if the lines lie on one line.
pub(super) fn join_crossing_lines(lines: &[Line], spacing: f64) -> Result<Vec<[Point; 3]>> {
    let total: f64 = lines.iter().map(|line| line.length).sum();
    let step = f64::max(STEP_RATIO * spacing, total / MAX_PLACES);
    let nodes = nodes_of(lines, step, normal_of(lines, spacing));
    let places: Vec<[f64; 2]> = nodes.iter().map(|node| node.projected).collect();
    let mut triangles = delaunay_plane(&places)?.triangles;
    let max = MAX_GAP_RATIO * usual_edge(&nodes, &triangles);
    triangles.retain(|t| longest_edge(&nodes, t) <= max);
    peel(&nodes, &mut triangles);
    let corners = |t: &[u32; 3]| t.map(|n| nodes[n as usize].point);
    Ok(triangles.iter().map(corners).collect())
}

/// Returns the direction that is most perpendicular to all lines and to the vectors between
/// neighbours.
fn normal_of(lines: &[Line], spacing: f64) -> Point {
    let mut vectors = Vec::new();
    for (i, line) in lines.iter().enumerate() {
        let samples = line.samples();
        vectors.extend(samples.windows(2).map(|p| unit(sub(p[1], p[0]))));
        for &sample in samples {
            let others = (0..lines.len()).filter(|&j| j != i);
            let near = others
                .map(|j| lines[j].nearest_of_samples(sample, false))
                .filter(|near| near.distance > 0.2 * spacing)
                .min_by(|a, b| a.distance.total_cmp(&b.distance));
            vectors.extend(near.map(|near| unit(sub(near.place, sample))));
        }
    }
    least_direction(vectors.into_iter())
}

/// Returns nodes along the lines, projected along `normal`. Ends and corners of lines come first, so
/// that other places near them become one with them.
fn nodes_of(lines: &[Line], step: f64, normal: Point) -> Vec<Node> {
    let least = (0..3).fold(0, |best, k| {
        if normal[k].abs() < normal[best].abs() {
            k
        } else {
            best
        }
    });
    let u = unit(cross(
        normal,
        std::array::from_fn(|k| f64::from(u8::from(k == least))),
    ));
    let v = cross(normal, u);
    let size = SNAP_RATIO * step;
    let mut nodes: Vec<Node> = Vec::new();
    let mut by_cell: BTreeMap<[i64; 2], usize> = BTreeMap::new();
    let mut add = |line: usize, point: Point| {
        let projected = [dot(point, u), dot(point, v)];
        let cell = projected.map(|c| (c / size).round() as i64);
        let node = *by_cell.entry(cell).or_insert(nodes.len());
        if node == nodes.len() {
            nodes.push(Node {
                point,
                projected,
                lines: BTreeSet::new(),
            });
        }
        nodes[node].lines.insert(line);
    };
    for (i, line) in lines.iter().enumerate() {
        let ends = line.points.first().into_iter().chain(line.points.last());
        ends.for_each(|&end| add(i, end));
    }
    for (i, line) in lines.iter().enumerate() {
        line.points.iter().for_each(|&point| add(i, point));
    }
    for (i, line) in lines.iter().enumerate() {
        line.densified(step).iter().for_each(|&point| add(i, point));
    }
    nodes
}

/// Returns the longest edge of a triangle.
fn longest_edge(nodes: &[Node], t: &[u32; 3]) -> f64 {
    let p = t.map(|n| nodes[n as usize].point);
    let edges = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| norm(sub(p[b], p[a])));
    edges.into_iter().fold(0.0, f64::max)
}

/// Returns the area of a triangle in the projection.
fn projected_area(nodes: &[Node], t: &[u32; 3]) -> f64 {
    let [a, b, c] = t.map(|n| nodes[n as usize].projected);
    let ([x, y], [s, t]) = (sub(b, a), sub(c, a));
    0.5 * (x * t - y * s).abs()
}

/// Returns the longest edge of which triangles with half of the projected area have no longer one.
fn usual_edge(nodes: &[Node], triangles: &[[u32; 3]]) -> f64 {
    let mut edges: Vec<[f64; 2]> = (triangles.iter())
        .map(|t| [longest_edge(nodes, t), projected_area(nodes, t)])
        .collect();
    edges.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let half = 0.5 * edges.iter().map(|edge| edge[1]).sum::<f64>();
    let mut sum = 0.0;
    for [edge, area] in edges {
        sum += area;
        if sum >= half {
            return edge;
        }
    }
    0.0
}

/// Removes triangles from the outside that are no part of the surface: those whose corners all lie on
/// one stick fill its bends, and those that are nearly parallel to the direction of projection, or
/// flat along the outline, fill the bends of the outline.
fn peel(nodes: &[Node], triangles: &mut Vec<[u32; 3]>) {
    let is_on_one_line = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|n| &nodes[n as usize].lines);
        a.iter().any(|line| b.contains(line) && c.contains(line))
    };
    let is_upright = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|n| nodes[n as usize].point);
        projected_area(nodes, t) < MIN_PROJECTION * 0.5 * norm(cross(sub(b, a), sub(c, a)))
    };
    let edges =
        |t: &[u32; 3]| [(0, 1), (1, 2), (2, 0)].map(|(a, b)| [t[a].min(t[b]), t[a].max(t[b])]);
    // The outer edge of a flat triangle is the longest, opposite to an obtuse angle.
    let is_flat = |t: &[u32; 3], outer: usize| {
        let [a, b, c] = [0, 1, 2].map(|k| nodes[t[(outer + k) % 3] as usize].projected);
        let (to_a, to_b) = (sub(a, c), sub(b, c));
        dot(to_a, to_b) < MAX_OUTER_COSINE * norm(to_a) * norm(to_b)
    };
    loop {
        let mut counts: BTreeMap<[u32; 2], usize> = BTreeMap::new();
        for edge in triangles.iter().flat_map(edges) {
            *counts.entry(edge).or_default() += 1;
        }
        let before = triangles.len();
        triangles.retain(|t| {
            let is_outer = edges(t).map(|edge| counts[&edge] == 1);
            let mut outer = (0..3).filter(|&k| is_outer[k]).peekable();
            outer.peek().is_none()
                || !(is_on_one_line(t) || is_upright(t) || outer.any(|k| is_flat(t, k)))
        });
        if triangles.len() == before {
            return;
        }
    }
}
