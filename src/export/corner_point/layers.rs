//! The layers of a corner-point grid: between the regions of a model where these lie one above the
//! other, else of equal thickness. At a feature that displaces regions, the columns on its two sides
//! have corners at different depths on their common pillars.

use crate::parallel::prelude::*;

use super::cell_walk::{CellWalker, LineSegment};
use super::pillars::{Pillars, is_steep};
use crate::mesh::graph::Graph;
use crate::model::reservoir::Model;

/// How far from its pillar, as a share of the column, the depths of a column's corner are taken.
const CORNER_INSET: f64 = 0.1;
/// Share of the changes of region along lines that may be against the order.
const MAX_REVERSED_SHARE: f64 = 0.05;
/// No more regions than these are followed.
const MAX_REGIONS: usize = 100;

/// Layers of a pillar grid.
pub struct GridLayers {
    /// Number of layers.
    pub count: usize,
    /// z of every corner: of column after column, its four corners (as
    /// [`Pillars::column_pillars`]), each from the top down, `count + 1` numbers.
    pub z: Vec<f64>,
    /// Whether they follow regions.
    pub follows_regions: bool,
}

/// A line through the cells from the top of the pillars to their bottom.
pub struct ColumnLine {
    /// Its ends.
    ends: [[f64; 3]; 2],
    /// Its parts in cells.
    pub segments: Vec<LineSegment>,
}

impl ColumnLine {
    /// z at a share of the line.
    pub fn z(&self, share: f64) -> f64 {
        self.ends[0][2] + share * (self.ends[1][2] - self.ends[0][2])
    }

    /// The point at z.
    pub fn point_at(&self, z: f64) -> [f64; 3] {
        let share = (z - self.ends[0][2]) / (self.ends[1][2] - self.ends[0][2]);
        std::array::from_fn(|k| self.ends[0][k] + share * (self.ends[1][k] - self.ends[0][k]))
    }
}

/// The lines through a column at some places, from left to right and from front to back.
pub fn column_lines(
    walk: &CellWalker,
    pillars: &Pillars,
    column: usize,
    places: &[[f64; 2]],
    from: &mut u32,
) -> Vec<ColumnLine> {
    let line = |&place: &[f64; 2]| {
        let ends = pillars.line_ends(column, place);
        let along = std::array::from_fn(|k| ends[1][k] - ends[0][k]);
        let pieces = walk.trace_line(ends[0], along, *from);
        if let Some(piece) = pieces.get(pieces.len() / 2) {
            *from = piece.cell;
        }
        ColumnLine {
            ends,
            segments: pieces,
        }
    };
    places.iter().map(line).collect()
}

/// The four corners, a little inside.
const INSET_CORNERS: [[f64; 2]; 4] = [
    [CORNER_INSET, CORNER_INSET],
    [1.0 - CORNER_INSET, CORNER_INSET],
    [CORNER_INSET, 1.0 - CORNER_INSET],
    [1.0 - CORNER_INSET, 1.0 - CORNER_INSET],
];

impl GridLayers {
    /// About `count` layers.
    pub fn new(model: &Model, walk: &CellWalker, pillars: &Pillars, count: usize) -> Self {
        let [n, m] = pillars.columns;
        let corners: Vec<Vec<ColumnLine>> = (0..m)
            .into_par_iter()
            .flat_map_iter(|j| {
                let mut from = 0;
                let lines = |i| column_lines(walk, pillars, j * n + i, &INSET_CORNERS, &mut from);
                (0..n).map(lines).collect::<Vec<_>>()
            })
            .collect();
        let order = region_order(&corners, &model.graph);
        let follows_regions = order.len() > 1;
        // Of each corner the top of every region, and the bottom of the last.
        let parts = order.len().max(1);
        let place = |cell: u32| {
            let region = model.graph.region[cell as usize];
            order.iter().position(|&r| r == region).unwrap_or(0)
        };
        let mut horizons: Vec<f64> = Vec::with_capacity(4 * corners.len() * (parts + 1));
        let mut thickness = vec![0.0; parts];
        for line in corners.iter().flatten() {
            let mut within = vec![0.0; parts];
            for piece in &line.segments {
                within[place(piece.cell)] += line.z(piece.start) - line.z(piece.end);
            }
            let mut z = line
                .segments
                .first()
                .map_or(line.ends[0][2], |p| line.z(p.start));
            horizons.push(z);
            for (sum, part) in thickness.iter_mut().zip(within) {
                *sum += part;
                z -= part;
                horizons.push(z);
            }
        }
        join_corners(
            &mut horizons,
            parts + 1,
            &corners,
            walk,
            pillars,
            &model.graph,
        );
        let whole: f64 = thickness.iter().sum();
        let share = |t: &f64| ((count as f64 * t / whole).round() as usize).max(1);
        let layers: Vec<usize> = thickness.iter().map(share).collect();
        let count = layers.iter().sum();
        let mut z = Vec::with_capacity(4 * corners.len() * (count + 1));
        for tops in horizons.chunks_exact(parts + 1) {
            z.push(tops[0]);
            for (pair, &layers) in tops.windows(2).zip(&layers) {
                let at = |k: usize| pair[0] + (pair[1] - pair[0]) * k as f64 / layers as f64;
                z.extend((1..=layers).map(at));
            }
        }
        Self {
            count,
            z,
            follows_regions,
        }
    }

    /// z of a corner of a column, from the top down.
    pub fn corner_depths(&self, column: usize, corner: usize) -> &[f64] {
        let size = self.count + 1;
        &self.z[(4 * column + corner) * size..][..size]
    }
}

/// The regions from the top down, if they lie one above the other; else none.
fn region_order(corners: &[Vec<ColumnLine>], graph: &Graph<3>) -> Vec<i32> {
    let mut regions = graph.region.clone();
    regions.sort_unstable();
    regions.dedup();
    if regions.len() > MAX_REGIONS {
        return Vec::new();
    }
    let place = |cell: u32| regions.partition_point(|&r| r < graph.region[cell as usize]);
    let size = regions.len();
    // How often one lies on another, and how deep each is on average.
    let mut above = vec![0usize; size * size];
    let mut depths = vec![(0.0, 0.0); size];
    for line in corners.iter().flatten() {
        for piece in &line.segments {
            let length = piece.end - piece.start;
            let (sum, weight) = &mut depths[place(piece.cell)];
            *sum += 0.5 * length * (piece.start + piece.end);
            *weight += length;
        }
        for pair in line.segments.windows(2) {
            let [upper, lower] = [place(pair[0].cell), place(pair[1].cell)];
            above[upper * size + lower] += usize::from(upper != lower);
        }
    }
    let mut order: Vec<usize> = (0..size).filter(|&r| depths[r].1 > 0.0).collect();
    let mean = |r: usize| depths[r].0 / depths[r].1;
    order.sort_by(|&a, &b| mean(a).total_cmp(&mean(b)));
    let rank = |r: usize| order.iter().position(|&o| o == r);
    let pairs = (0..size * size).filter(|&at| rank(at / size) > rank(at % size));
    let against: usize = pairs.map(|at| above[at]).sum();
    let all: usize = above.iter().sum();
    if against as f64 > MAX_REVERSED_SHARE * all as f64 {
        return Vec::new();
    }
    order.into_iter().map(|r| regions[r]).collect()
}

/// Gives the corners round each pillar one depth, unless a feature is between them.
fn join_corners(
    horizons: &mut [f64],
    size: usize,
    corners: &[Vec<ColumnLine>],
    walk: &CellWalker,
    pillars: &Pillars,
    graph: &Graph<3>,
) {
    let [n, m] = pillars.columns;
    let at = |column: usize, corner: usize, horizon: usize| (4 * column + corner) * size + horizon;
    let steep = |c: u32| {
        let c = &graph.connections[c as usize];
        c.on_feature && is_steep(c.normal)
    };
    // Not all faces along a feature are on it: three lines see it better than one.
    let parted = |a: (usize, usize), b: (usize, usize), [za, zb]: [f64; 2]| {
        [za, 0.5 * (za + zb), zb].iter().any(|&z| {
            let [p, q] = [a, b].map(|(column, corner)| corners[column][corner].point_at(z));
            let pieces = &corners[a.0][a.1].segments;
            let from = pieces.get(pieces.len() / 2).map_or(0, |piece| piece.cell);
            let along = std::array::from_fn(|k| q[k] - p[k]);
            let line = walk.trace_line(p, along, from);
            let mut between = line.iter().filter(|piece| (0.0..1.0).contains(&piece.end));
            between.any(|piece| piece.exit_connection.is_some_and(steep))
        })
    };
    for pillar in 0..(n + 1) * (m + 1) {
        let (i, j) = (pillar % (n + 1), pillar / (n + 1));
        // The columns round it, each with the corner that is on it, in order round it.
        let round = [(0, 0, 3), (1, 0, 2), (1, 1, 0), (0, 1, 1)];
        let held = |&(right, behind, corner): &(usize, usize, usize)| {
            let column = [(i + right).checked_sub(1)?, (j + behind).checked_sub(1)?];
            (column[0] < n && column[1] < m).then_some((column[1] * n + column[0], corner))
        };
        let round: Vec<Option<(usize, usize)>> = round.iter().map(held).collect();
        for horizon in 0..size {
            // The ends of the grid are never parted; corners begin as groups of their own.
            let mut group = [0, 1, 2, 3];
            for k in 0..4 {
                if let (Some(a), Some(b)) = (round[k], round[(k + 1) % 4]) {
                    let z = [a, b].map(|(column, corner)| horizons[at(column, corner, horizon)]);
                    let end = horizon == 0 || horizon == size - 1;
                    if end || !parted(a, b, z) {
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
                    let of = |k: &usize| group[*k] == g;
                    (0..4).filter(of).filter_map(|k| round[k])
                };
                let sum: f64 = members().map(|(c, k)| horizons[at(c, k, horizon)]).sum();
                let mean = sum / members().count().max(1) as f64;
                members().for_each(|(c, k)| horizons[at(c, k, horizon)] = mean);
            }
        }
    }
    // Means must not turn thin layers upside down.
    for tops in horizons.chunks_exact_mut(size) {
        for k in 1..size {
            tops[k] = tops[k].min(tops[k - 1]);
        }
    }
}
