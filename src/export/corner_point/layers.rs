//! Layers of a corner-point grid. They follow the regions of a model if these lie one above the
//! other. Otherwise they have equal thickness. At a feature that displaces regions, the columns on
//! its two sides have corners at different depths on their common pillars.

use crate::geometry::sorted_distinct;
use crate::parallel::prelude::*;

use super::cell_walk::{CellWalker, LineSegment};
use super::pillars::{Pillars, is_steep};
use crate::mesh::graph::Graph;
use crate::model::reservoir::Model;

/// Distance of a corner of a column from its pillar at which depths are taken, as a fraction of the
/// column.
const CORNER_INSET: f64 = 0.1;
/// Maximum fraction of the changes of region along lines that may be against the order of regions.
const MAX_REVERSED_SHARE: f64 = 0.05;
/// Maximum number of regions that layers follow.
const MAX_REGIONS: usize = 100;

/// Layers of a pillar grid.
pub struct GridLayers {
    /// Number of layers.
    pub count: usize,
    /// z of all corners: for each column its four corners (as in [`Pillars::column_pillars`]), and
    /// for each corner `count + 1` values from the top down.
    pub z: Vec<f64>,
    /// `true` if the layers follow regions.
    pub follows_regions: bool,
}

/// Line through the cells from the top of the pillars to their bottom.
pub struct ColumnLine {
    /// Ends of the line.
    ends: [[f64; 3]; 2],
    /// Segments of the line in cells.
    pub segments: Vec<LineSegment>,
}

impl ColumnLine {
    /// Returns z at a fraction of the line.
    pub fn z(&self, fraction: f64) -> f64 {
        self.ends[0][2] + fraction * (self.ends[1][2] - self.ends[0][2])
    }

    /// Returns the point of the line at `z`.
    pub fn point_at(&self, z: f64) -> [f64; 3] {
        let fraction = (z - self.ends[0][2]) / (self.ends[1][2] - self.ends[0][2]);
        std::array::from_fn(|k| self.ends[0][k] + fraction * (self.ends[1][k] - self.ends[0][k]))
    }
}

/// Returns the lines through a column at the given fractions along i and j. `start_cell` is a cell
/// near the first line, and is set to one near the last.
pub fn column_lines(
    walker: &CellWalker,
    pillars: &Pillars,
    column: usize,
    positions: &[[f64; 2]],
    start_cell: &mut u32,
) -> Vec<ColumnLine> {
    let line = |&position: &[f64; 2]| {
        let ends = pillars.line_ends(column, position);
        let direction = std::array::from_fn(|k| ends[1][k] - ends[0][k]);
        let segments = walker.trace_line(ends[0], direction, *start_cell);
        if let Some(segment) = segments.get(segments.len() / 2) {
            *start_cell = segment.cell;
        }
        ColumnLine { ends, segments }
    };
    positions.iter().map(line).collect()
}

/// Positions of the four corners of a column, moved inwards.
const INSET_CORNERS: [[f64; 2]; 4] = [
    [CORNER_INSET, CORNER_INSET],
    [1.0 - CORNER_INSET, CORNER_INSET],
    [CORNER_INSET, 1.0 - CORNER_INSET],
    [1.0 - CORNER_INSET, 1.0 - CORNER_INSET],
];

impl GridLayers {
    /// Creates about `count` layers.
    pub fn new(model: &Model, walker: &CellWalker, pillars: &Pillars, count: usize) -> Self {
        let [n, m] = pillars.columns;
        let corners: Vec<Vec<ColumnLine>> = (0..m)
            .into_par_iter()
            .flat_map_iter(|j| {
                let mut start_cell = 0;
                let lines =
                    |i| column_lines(walker, pillars, j * n + i, &INSET_CORNERS, &mut start_cell);
                (0..n).map(lines).collect::<Vec<_>>()
            })
            .collect();
        let order = region_order(&corners, &model.graph);
        let follows_regions = order.len() > 1;
        // For each corner, `horizons` has the top of every region and the bottom of the last one.
        let region_count = order.len().max(1);
        let region_index = |cell: u32| {
            let region = model.graph.region[cell as usize];
            order.iter().position(|&r| r == region).unwrap_or(0)
        };
        let mut horizons: Vec<f64> = Vec::with_capacity(4 * corners.len() * (region_count + 1));
        let mut thickness = vec![0.0; region_count];
        for line in corners.iter().flatten() {
            let mut heights = vec![0.0; region_count];
            for segment in &line.segments {
                heights[region_index(segment.cell)] += line.z(segment.start) - line.z(segment.end);
            }
            let mut z = line
                .segments
                .first()
                .map_or(line.ends[0][2], |p| line.z(p.start));
            horizons.push(z);
            for (sum, height) in thickness.iter_mut().zip(heights) {
                *sum += height;
                z -= height;
                horizons.push(z);
            }
        }
        join_corners(
            &mut horizons,
            region_count + 1,
            &corners,
            walker,
            pillars,
            &model.graph,
        );
        let total: f64 = thickness.iter().sum();
        let layer_count = |t: &f64| ((count as f64 * t / total).round() as usize).max(1);
        let layers: Vec<usize> = thickness.iter().map(layer_count).collect();
        let count = layers.iter().sum();
        let mut z = Vec::with_capacity(4 * corners.len() * (count + 1));
        for tops in horizons.chunks_exact(region_count + 1) {
            z.push(tops[0]);
            for (pair, &layers) in tops.windows(2).zip(&layers) {
                let z_at = |k: usize| pair[0] + (pair[1] - pair[0]) * k as f64 / layers as f64;
                z.extend((1..=layers).map(z_at));
            }
        }
        Self {
            count,
            z,
            follows_regions,
        }
    }

    /// Returns z of a corner of a column, from the top down.
    pub fn corner_depths(&self, column: usize, corner: usize) -> &[f64] {
        let size = self.count + 1;
        &self.z[(4 * column + corner) * size..][..size]
    }
}

/// Returns the regions from the top down if they lie one above the other, else an empty list.
fn region_order(corners: &[Vec<ColumnLine>], graph: &Graph<3>) -> Vec<i32> {
    let regions = sorted_distinct(graph.region.iter().copied());
    if regions.len() > MAX_REGIONS {
        return Vec::new();
    }
    let region_index = |cell: u32| regions.partition_point(|&r| r < graph.region[cell as usize]);
    let size = regions.len();
    // `above` counts how often one region lies on another. `depths` has the sums for the mean depth
    // of each region.
    let mut above = vec![0usize; size * size];
    let mut depths = vec![(0.0, 0.0); size];
    for line in corners.iter().flatten() {
        for segment in &line.segments {
            let length = segment.end - segment.start;
            let (sum, weight) = &mut depths[region_index(segment.cell)];
            *sum += 0.5 * length * (segment.start + segment.end);
            *weight += length;
        }
        for pair in line.segments.windows(2) {
            let [upper, lower] = [region_index(pair[0].cell), region_index(pair[1].cell)];
            above[upper * size + lower] += usize::from(upper != lower);
        }
    }
    let mut order: Vec<usize> = (0..size).filter(|&r| depths[r].1 > 0.0).collect();
    let mean = |r: usize| depths[r].0 / depths[r].1;
    order.sort_by(|&a, &b| mean(a).total_cmp(&mean(b)));
    let rank = |r: usize| order.iter().position(|&o| o == r);
    let pairs = (0..size * size).filter(|&at| rank(at / size) > rank(at % size));
    let reversed: usize = pairs.map(|at| above[at]).sum();
    let total: usize = above.iter().sum();
    if reversed as f64 > MAX_REVERSED_SHARE * total as f64 {
        return Vec::new();
    }
    order.into_iter().map(|r| regions[r]).collect()
}

/// Gives the corners around each pillar one common depth, unless a feature separates them.
fn join_corners(
    horizons: &mut [f64],
    size: usize,
    corners: &[Vec<ColumnLine>],
    walker: &CellWalker,
    pillars: &Pillars,
    graph: &Graph<3>,
) {
    let [n, m] = pillars.columns;
    let index =
        |column: usize, corner: usize, horizon: usize| (4 * column + corner) * size + horizon;
    let is_steep_feature = |c: u32| {
        let c = &graph.connections[c as usize];
        c.on_feature && is_steep(c.normal)
    };
    // Not all faces along a feature are on it, so three lines are tried instead of one.
    let is_separated = |a: (usize, usize), b: (usize, usize), [za, zb]: [f64; 2]| {
        [za, 0.5 * (za + zb), zb].iter().any(|&z| {
            let [p, q] = [a, b].map(|(column, corner)| corners[column][corner].point_at(z));
            let segments = &corners[a.0][a.1].segments;
            let start_cell = segments
                .get(segments.len() / 2)
                .map_or(0, |segment| segment.cell);
            let direction = std::array::from_fn(|k| q[k] - p[k]);
            let line = walker.trace_between(p, direction, start_cell);
            let mut crossings = line
                .iter()
                .filter(|segment| (0.0..1.0).contains(&segment.end));
            crossings.any(|segment| segment.exit_connection.is_some_and(is_steep_feature))
        })
    };
    // Each corner belongs to one pillar, so the mean depths at a pillar depend on no other pillar.
    let joined = |pillar: usize| {
        let mut joined: Vec<(usize, f64)> = Vec::new();
        let (i, j) = (pillar % (n + 1), pillar / (n + 1));
        // Columns around the pillar, in order around it, each with its corner on the pillar.
        let adjacent = [(0, 0, 3), (1, 0, 2), (1, 1, 0), (0, 1, 1)];
        let column_corner = |&(right, behind, corner): &(usize, usize, usize)| {
            let column = [(i + right).checked_sub(1)?, (j + behind).checked_sub(1)?];
            (column[0] < n && column[1] < m).then_some((column[1] * n + column[0], corner))
        };
        let column_corners: Vec<Option<(usize, usize)>> =
            adjacent.iter().map(column_corner).collect();
        for horizon in 0..size {
            // Features do not separate corners at the top and the bottom of the grid. Each corner
            // begins in a group of its own.
            let mut group = [0, 1, 2, 3];
            for k in 0..4 {
                if let (Some(a), Some(b)) = (column_corners[k], column_corners[(k + 1) % 4]) {
                    let z = [a, b].map(|(column, corner)| horizons[index(column, corner, horizon)]);
                    let end = horizon == 0 || horizon == size - 1;
                    if end || !is_separated(a, b, z) {
                        let (old, new) = (group[(k + 1) % 4], group[k]);
                        group
                            .iter_mut()
                            .filter(|g| **g == old)
                            .for_each(|g| *g = new);
                    }
                }
            }
            for g in 0..4 {
                let members = || {
                    let is_member = |k: &usize| group[*k] == g;
                    (0..4).filter(is_member).filter_map(|k| column_corners[k])
                };
                let sum: f64 = members().map(|(c, k)| horizons[index(c, k, horizon)]).sum();
                let mean = sum / members().count().max(1) as f64;
                joined.extend(members().map(|(c, k)| (index(c, k, horizon), mean)));
            }
        }
        joined
    };
    let pillars = (0..(n + 1) * (m + 1)).into_par_iter();
    let joined: Vec<(usize, f64)> = pillars.flat_map_iter(joined).collect();
    for (index, mean) in joined {
        horizons[index] = mean;
    }
    // Averaging must not turn thin layers upside down.
    for tops in horizons.chunks_exact_mut(size) {
        for k in 1..size {
            tops[k] = tops[k].min(tops[k - 1]);
        }
    }
}
