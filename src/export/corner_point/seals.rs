//! A corner-point grid as the check of seals sees it: its cells, and the connections between them that
//! the records for faults leave open.

use super::cell_walk::CellWalker;
use super::faults::{FaultResistances, GridConnection, find_connections};
use super::grid::CornerPointGrid;
use crate::geometry::grid_index::index_at;
use crate::geometry::{cross, dot, sub};
use crate::mesh::graph::{BoundaryFace, Connection, Graph};
use crate::model::reservoir::Model;
use crate::model::reservoir::seal_check::SealNetwork;

/// Smallest distance of a face from the middle of its cell, relative to the height of the grid.
const MIN_DISTANCE_RATIO: f64 = 1e-9;

/// Returns the cells and connections of a grid. `permeability` returns the permeability of a cell along
/// i, j and k, or `None` if the cell is inactive.
pub(super) fn network(
    model: &Model,
    walker: &CellWalker,
    grid: &CornerPointGrid<'_>,
    permeability: impl Fn(usize) -> Option<[f64; 3]>,
) -> SealNetwork {
    let all = find_connections(model, walker, grid);
    let resistances = FaultResistances::of_connections(grid, all.clone());
    let factors = resistances.record_factors(&all);
    let mut network = SealNetwork {
        graph: cells(model, grid),
        labels: Vec::new(),
        kinds: model.surfaces.kinds.clone(),
        names: model.surfaces.all_names().names,
        faults: model.closed_faults(),
        is_closed: Vec::new(),
        transmissibility: Vec::new(),
        has_tets: false,
    };
    let merged = model.surfaces.merged_numbers();
    let [top, bottom] = grid.pillars.z;
    let min_distance = MIN_DISTANCE_RATIO * (top - bottom);
    for (c, factor) in all.iter().zip(factors).filter(|(c, _)| c.shares_face) {
        let cells = [c.lower, c.upper].map(|cell| grid.cell_index(cell));
        let sites = cells.map(|cell| network.graph.site[cell]);
        let Some((area_vector, centre)) = common_face(grid, c) else {
            continue;
        };
        let mut connection =
            Connection::new(cells.map(|cell| cell as u32), sites, area_vector, centre);
        connection.distance = connection.distance.map(|d| d.abs().max(min_distance));
        connection.point = centre;
        let resistance = |side: usize| {
            let permeability = permeability(cells[side])?[c.axis];
            (permeability > 0.0).then(|| connection.distance[side] / permeability)
        };
        let t = match (resistance(0), resistance(1)) {
            (Some(a), Some(b)) => connection.area / (a + b),
            _ => 0.0,
        };
        network.graph.connections.push(connection);
        network.transmissibility.push(t);
        network.is_closed.push(factor == 0.0);
        let surface = c.crossed_surface.map_or(0, |(surface, _)| surface);
        network.labels.push(merged[surface as usize]);
    }
    network
}

/// Returns the cells of the grid and their faces on its boundary.
fn cells(model: &Model, grid: &CornerPointGrid<'_>) -> Graph<3> {
    let dims = grid.dims();
    let mut graph = Graph::default();
    for cell in 0..dims.iter().product() {
        let index = index_at(dims, cell);
        let site = grid.point(index, [0.5; 3]);
        let ends = |axis: usize| {
            [0.0, 1.0].map(|end| {
                let mut fractions = [0.5; 3];
                fractions[axis] = end;
                grid.point(index, fractions)
            })
        };
        let [i, j, k] = [0, 1, 2].map(|axis| {
            let [a, b] = ends(axis);
            sub(b, a)
        });
        graph.volume.push(dot(cross(i, j), k).abs());
        graph.site.push(site);
        graph.centroid.push(site);
        graph.region.push(0);
        for axis in 0..3 {
            for is_upper in [false, true] {
                let end = if is_upper { dims[axis] - 1 } else { 0 };
                if index[axis] != end {
                    continue;
                }
                let fraction = f64::from(u8::from(is_upper));
                let corner = |u: f64, v: f64| {
                    let mut fractions = [u, v, 0.0];
                    fractions.rotate_right((axis + 1) % 3);
                    fractions[axis] = fraction;
                    grid.point(index, fractions)
                };
                let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
                let (mut area, point) = quad(corners.map(|(u, v)| corner(u, v)));
                if dot(area, sub(point, site)) < 0.0 {
                    area = area.map(|c| -c);
                }
                let side = side_towards(model, area);
                let mut face = BoundaryFace::new(cell as u32, side, site, area, point);
                face.distance = face.distance.abs().max(f64::MIN_POSITIVE.sqrt());
                graph.boundary.push(face);
            }
        }
    }
    graph
}

/// Returns the side of the mesh whose outward direction is nearest to this one.
fn side_towards(model: &Model, direction: [f64; 3]) -> Option<u8> {
    let mut sums = [0.0; 6];
    for face in &model.graph.boundary {
        if let Some(side) = face.side {
            sums[usize::from(side)] += face.area * dot(face.normal, direction);
        }
    }
    let best = (0..6u8).max_by(|a, b| sums[usize::from(*a)].total_cmp(&sums[usize::from(*b)]));
    best.filter(|side| sums[usize::from(*side)] > 0.0)
}

/// Returns the area vector and the centre of a quadrilateral.
fn quad(corners: [[f64; 3]; 4]) -> ([f64; 3], [f64; 3]) {
    let [a, b, c, d] = corners;
    let area = cross(sub(c, a), sub(d, b)).map(|x| 0.5 * x);
    let centre = std::array::from_fn(|k| 0.25 * (a[k] + b[k] + c[k] + d[k]));
    (area, centre)
}

/// Returns the area vector and the centre of the face that the cells of a connection share, or `None` if it
/// has no area.
fn common_face(grid: &CornerPointGrid<'_>, c: &GridConnection) -> Option<([f64; 3], [f64; 3])> {
    let corners = if c.axis == 2 {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        corners.map(|[u, v]| grid.point(c.upper, [u, v, 0.0]))
    } else {
        // The part of the side that both cells have, on its two pillars.
        let pillar = |fraction: f64| {
            let ends = |cell: [usize; 3], along: f64| {
                [0.0, 1.0].map(|w| {
                    let mut fractions = [along, along, w];
                    fractions[1 - c.axis] = fraction;
                    grid.point(cell, fractions)
                })
            };
            let [[top, bottom], [other_top, other_bottom]] =
                [ends(c.lower, 1.0), ends(c.upper, 0.0)];
            let top = if top[2] < other_top[2] {
                top
            } else {
                other_top
            };
            let bottom = if bottom[2] > other_bottom[2] {
                bottom
            } else {
                other_bottom
            };
            if top[2] > bottom[2] {
                [top, bottom]
            } else {
                let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (top[k] + bottom[k]));
                [middle; 2]
            }
        };
        let [[a, b], [d, e]] = [pillar(0.0), pillar(1.0)];
        [a, b, e, d]
    };
    let (mut area, centre) = quad(corners);
    let [from, to] = [c.lower, c.upper].map(|cell| grid.point(cell, [0.5; 3]));
    if dot(area, sub(to, from)) < 0.0 {
        area = area.map(|x| -x);
    }
    (dot(area, area) > 0.0).then_some((area, centre))
}
