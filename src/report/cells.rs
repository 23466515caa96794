//! Measures Voronoi cells by the properties that flow simulators need of a PEBI grid.

use serde::Serialize;

use super::LatticeReport;
use super::lattice::{relative_spacing, spacing_ranks};
use crate::geometry::{distance2, norm, sub};
use crate::mesh::check::Check;
use crate::mesh::graph::{Connection, Graph};

/// Fractions of the mean area below which faces are counted as tiny.
pub const TINY_FACE_RATIOS: [f64; 4] = [1e-6, 1e-4, 1e-3, 1e-2];

/// Measures of a Voronoi mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Voronoi {
    /// Kind of cells: `polyhedra` or `polygons`.
    pub kind: &'static str,
    /// Check of validity, in lattice space.
    pub check: Check,
    /// Number of faces between two cells.
    pub connections: usize,
    /// Number of these faces that the mesh marks as faces on features.
    pub on_feature: usize,
    /// Volume (in 2-D area) of the smallest and of the largest cell over the mean.
    pub volumes: [f64; 2],
    /// Ratio of the volumes of two neighbours, the larger over the smaller: the largest ratio, and
    /// the ratio that one connection in a thousand exceeds.
    pub volume_ratio: [f64; 2],
    /// Number of cells over the number of cubes of edge d that fill the same volume, where d is
    /// known.
    pub cells_per_cube: Option<f64>,
    /// Fraction of the feature surfaces whose triangles (in 2-D edges) are exactly faces of cells,
    /// where that is known. Elsewhere faces of cells follow the features approximately.
    pub conforming: Option<f64>,
    /// Length of the shortest connection over the mean.
    pub shortest_connection: f64,
    /// Area of the smallest connection over the mean.
    pub smallest_face: f64,
    /// Fractions of the connections that are smaller than 1e-6, 1e-4, 1e-3 and 1e-2 of the mean
    /// area.
    pub tiny_faces: [f64; 4],
    /// Angle in degrees between the normal of a face and its connection in lattice space, where it
    /// should be 0: the maximum and the mean (by area). Faces below 1e-6 of the mean area are
    /// omitted, because their direction is not meaningful.
    pub angle: [f64; 2],
    /// Angles in physical space, unless its axes have different units. If they are not 0,
    /// two-point flux is an approximation.
    pub angle_physical: Option<[f64; 2]>,
    /// Number of connections whose two-point transmissibility in physical space is not positive.
    pub non_positive_connections: usize,
}

/// Measures cells by their graphs in lattice space and in physical space. `check` is the result of
/// the check of their validity.
pub fn measure_voronoi<const D: usize>(
    check: Check,
    graph: &Graph<D>,
    physical: &Graph<D>,
) -> Voronoi {
    let count = graph.connections.len();
    let mean = |sum: f64, count: usize| sum / count.max(1) as f64;
    let area = mean(graph.connections.iter().map(|c| c.area).sum(), count);
    let volume = mean(graph.volume.iter().sum(), graph.volume.len());
    let min = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
    let tiny = |limit: f64| {
        let small_faces = graph.connections.iter().filter(|c| c.area < limit * area);
        mean(small_faces.count() as f64, count)
    };
    let angles = |in_space: &Graph<D>| {
        let (mut worst, mut sum, mut total_area) = (0.0f64, 0.0, 0.0);
        for (c, connection) in graph.connections.iter().zip(&in_space.connections) {
            if c.area >= TINY_FACE_RATIOS[0] * area {
                let angle = connection.angle_error(&in_space.site);
                worst = worst.max(angle);
                sum += angle * connection.area;
                total_area += connection.area;
            }
        }
        [
            worst,
            if total_area > 0.0 {
                sum / total_area
            } else {
                0.0
            },
        ]
    };
    let mut ratios: Vec<f64> = (graph.connections.iter())
        .map(|c| {
            let [v, w] = c.cells.map(|c| graph.volume[c as usize]);
            v.max(w) / v.min(w)
        })
        .collect();
    ratios.sort_by(|a, b| b.total_cmp(a));
    let ratio = |rank: usize| ratios.get(rank).copied().unwrap_or(1.0);
    let length = |c: &Connection<D>| {
        let [a, b] = c.cells.map(|c| graph.site[c as usize]);
        norm(sub(a, b))
    };
    let lengths = || graph.connections.iter().map(length);
    let is_positive = |d: f64| d > 0.0;
    Voronoi {
        kind: if D == 2 { "polygons" } else { "polyhedra" },
        check,
        connections: count,
        on_feature: graph.connections.iter().filter(|c| c.on_feature).count(),
        volumes: [
            min(&mut graph.volume.iter().copied()) / volume,
            -min(&mut graph.volume.iter().map(|v| -v)) / volume,
        ],
        volume_ratio: [ratio(0), ratio(count / 1000)],
        cells_per_cube: None,
        conforming: None,
        shortest_connection: min(&mut lengths()) / mean(lengths().sum(), count),
        smallest_face: min(&mut graph.connections.iter().map(|c| c.area)) / area,
        tiny_faces: TINY_FACE_RATIOS.map(tiny),
        angle: angles(graph),
        angle_physical: Some(angles(physical)),
        non_positive_connections: physical
            .connections
            .iter()
            .filter(|c| !(c.distance.into_iter().all(is_positive) && c.area > 0.0))
            .count(),
    }
}

/// Returns the lattice report of Voronoi cells from their connections. `distance` returns the
/// nominal distance at a position. The nearest neighbour of an atom is one of the cells with which
/// its cell shares a face.
pub fn lattice_of_graph<const D: usize>(
    graph: &Graph<D>,
    distance: impl Fn([f64; D]) -> f64,
) -> LatticeReport {
    let mut nearest = vec![f64::INFINITY; graph.site.len()];
    for connection in &graph.connections {
        let [a, b] = connection.cells.map(|c| c as usize);
        let square = distance2(&graph.site[a], &graph.site[b]);
        nearest[a] = nearest[a].min(square);
        nearest[b] = nearest[b].min(square);
    }
    let nearest = (nearest.into_iter()).zip(graph.site.iter().map(|&site| distance(site)));
    let mut spacing = relative_spacing(nearest);
    spacing.sort_unstable_by(f64::total_cmp);
    LatticeReport {
        atoms: graph.site.len(),
        spacing: spacing_ranks(spacing.len().max(1))
            .map(|rank| spacing.get(rank).copied().unwrap_or(f64::NAN)),
        optimisation: None,
    }
}
