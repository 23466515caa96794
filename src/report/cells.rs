//! What is measured about Voronoi cells: what a flow simulator asks of a PEBI grid.

use serde::Serialize;

use super::LatticeReport;
use crate::comm::SelfComm;
use crate::geometry::{norm, sub};
use crate::mesh::check::Check;
use crate::mesh::graph::{Connection, Graph};

/// Shares of the mean area below which faces are counted as tiny.
pub const TINY_FACE_RATIOS: [f64; 4] = [1e-6, 1e-4, 1e-3, 1e-2];

/// Voronoi cells in figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Voronoi {
    /// `polyhedra` or `polygons`.
    pub kind: &'static str,
    /// Validity, in lattice space.
    pub check: Check,
    /// Number of faces between two cells.
    pub connections: usize,
    /// How many of them lie along a feature, the mesh says.
    pub on_feature: usize,
    /// Volume (area in the plane) of the smallest and the largest cell over the mean.
    pub volumes: [f64; 2],
    /// The volumes of neighbours over one another, the larger first: the worst, and what one connection
    /// in a thousand exceeds.
    pub volume_ratio: [f64; 2],
    /// Number of cells over that of cubes of edge d that fill the same volume, where d is known.
    pub cells_per_cube: Option<f64>,
    /// The share of the features' surfaces whose triangles (edges in the plane) are faces of cells, where
    /// that is known; elsewhere faces follow them as nearly as they do.
    pub conforming: Option<f64>,
    /// Length of the shortest connection over the mean.
    pub shortest_connection: f64,
    /// Area of the smallest connection over the mean.
    pub smallest_face: f64,
    /// The share of connections smaller than 1e-6, 1e-4, 1e-3 and 1e-2 of the mean area.
    pub tiny_faces: [f64; 4],
    /// Angle in degrees between a face's normal and its connection in lattice space, where it should
    /// be 0: the largest and the mean (by area). Faces below 1e-6 of the mean area, which have no
    /// direction to speak of, are left out.
    pub angle: [f64; 2],
    /// The same in physical space, unless its axes mix units: where it is not 0, two-point flux is an approximation.
    pub angle_physical: Option<[f64; 2]>,
    /// Connections whose two-point transmissibility is not positive, in physical space.
    pub non_positive_connections: usize,
}

/// Measures cells, of whose validity `check` tells, by their graph in lattice space and in the world.
pub fn measure_voronoi<const D: usize>(
    check: Check,
    graph: &Graph<D>,
    physical: &Graph<D>,
) -> Voronoi {
    let count = graph.connections.len();
    let mean = |sum: f64, count: usize| sum / count.max(1) as f64;
    let area = mean(graph.connections.iter().map(|c| c.area).sum(), count);
    let volume = mean(graph.volume.iter().sum(), graph.volume.len());
    let least = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
    let tiny = |limit: f64| {
        let few = graph.connections.iter().filter(|c| c.area < limit * area);
        mean(few.count() as f64, count)
    };
    let angles = |in_space: &Graph<D>| {
        let (mut worst, mut sum, mut all) = (0.0f64, 0.0, 0.0);
        for (c, here) in graph.connections.iter().zip(&in_space.connections) {
            if c.area >= TINY_FACE_RATIOS[0] * area {
                let angle = here.angle_error(&in_space.site);
                worst = worst.max(angle);
                sum += angle * here.area;
                all += here.area;
            }
        }
        [worst, if all > 0.0 { sum / all } else { 0.0 }]
    };
    let mut ratios: Vec<f64> = (graph.connections.iter())
        .map(|c| {
            let [v, w] = c.cells.map(|c| graph.volume[c as usize]);
            v.max(w) / v.min(w)
        })
        .collect();
    ratios.sort_by(|a, b| b.total_cmp(a));
    let ratio = |place: usize| ratios.get(place).copied().unwrap_or(1.0);
    let length = |c: &Connection<D>| {
        let [a, b] = c.cells.map(|c| graph.site[c as usize]);
        norm(sub(a, b))
    };
    let lengths = || graph.connections.iter().map(length);
    let positive = |d: f64| d > 0.0;
    Voronoi {
        kind: if D == 2 { "polygons" } else { "polyhedra" },
        check,
        connections: count,
        on_feature: graph.connections.iter().filter(|c| c.on_feature).count(),
        volumes: [
            least(&mut graph.volume.iter().copied()) / volume,
            -least(&mut graph.volume.iter().map(|v| -v)) / volume,
        ],
        volume_ratio: [ratio(0), ratio(count / 1000)],
        cells_per_cube: None,
        conforming: None,
        shortest_connection: least(&mut lengths()) / mean(lengths().sum(), count),
        smallest_face: least(&mut graph.connections.iter().map(|c| c.area)) / area,
        tiny_faces: TINY_FACE_RATIOS.map(tiny),
        angle: angles(graph),
        angle_physical: Some(angles(physical)),
        non_positive_connections: physical
            .connections
            .iter()
            .filter(|c| !(c.distance.into_iter().all(positive) && c.area > 0.0))
            .count(),
    }
}

/// Figures of a lattice from its connections, with the nominal distance at any position: the nearest
/// neighbour of an atom is one with which its cell has a face.
pub fn lattice_of_graph<const D: usize>(
    graph: &Graph<D>,
    distance: impl Fn([f64; D]) -> f64,
) -> LatticeReport {
    let mut nearest = vec![f64::INFINITY; graph.site.len()];
    for connection in &graph.connections {
        let [a, b] = connection.cells.map(|c| c as usize);
        let square = (0..D).map(|k| (graph.site[a][k] - graph.site[b][k]).powi(2));
        let square: f64 = square.sum();
        nearest[a] = nearest[a].min(square);
        nearest[b] = nearest[b].min(square);
    }
    let nearest = (nearest.into_iter()).zip(graph.site.iter().map(|&site| distance(site)));
    let Ok(found) = super::lattice::lattice_figures(nearest, graph.site.len(), &SelfComm);
    found
}
