//! Painting: grows cells from seeds, as paint that flows within layers but not across surfaces
//! (Hale 2002, figure 3 and conclusion); and finds the blocks between surfaces, without seeds.
//!
//! A detected surface has holes, and paint would flow through the smallest one. So surfaces first
//! divide the mesh into *blocks*, by the distance of each cell from the nearest surface, its
//! *clearance*. Two compartments are one block if the opening between them is wide compared with
//! the smaller compartment, and two blocks if the opening is a crack. This is a watershed of the
//! clearance: neighbouring basins are merged if the saddle between them is at least `neck` times
//! the lower peak. Paint then flows within the block of its seed.
//!
//! - `paint_graph`: the cells and blocks of a mesh, which stay in memory between paints
//! - `paint_spec`: all options of `atomesh paint`, as one value
//! - `paint_verb`: the whole computation, from a mesh and its options

mod paint_graph;
mod paint_spec;
mod paint_verb;

pub use paint_graph::PaintCache;
pub use paint_spec::{PaintSeed, PaintSpec};
pub use paint_verb::{PaintOutcome, PaintedRegion, paint, paint_with_cache};

use std::borrow::Borrow;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use crate::geometry::union_find::UnionFind;
use crate::mesh::complex::NONE;
use crate::model::geodesics::{Arrivals, GeodesicSource, Geodesics};
use crate::model::surface::adjacency::CellAdjacency;

/// Returns for each cell the distance to the nearest surface, along paths between cell centres that
/// cross no surface. It is infinite where no surface can be reached.
pub fn clearance<const D: usize>(cells: &CellAdjacency<D>) -> Vec<f64> {
    let mut clearance = vec![f64::INFINITY; cells.len()];
    let mut done = vec![false; cells.len()];
    // Distances are not negative, so their bits have the same order.
    let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    for link in cells.links.iter().filter(|link| !link.is_open) {
        queue.extend(
            link.cells
                .map(|c| Reverse(((0.5 * link.distance).to_bits(), c))),
        );
    }
    while let Some(Reverse((bits, c))) = queue.pop() {
        if std::mem::replace(&mut done[c as usize], true) {
            continue;
        }
        let distance = f64::from_bits(bits);
        clearance[c as usize] = distance;
        for (_, link, n) in cells.links_of(c) {
            let new_distance = distance + link.distance;
            if link.is_open && !done[n as usize] && new_distance < clearance[n as usize] {
                clearance[n as usize] = new_distance;
                queue.push(Reverse((new_distance.to_bits(), n)));
            }
        }
    }
    clearance
}

/// Finds the blocks between surfaces. Returns the block of each cell, the largest block being 0,
/// and the number of blocks. A block of fewer than `min_cells` cells joins the neighbour with which
/// it shares the largest area; open links take precedence.
///
/// With `neck` 0, every opening merges blocks; with 1, only openings as wide as the smaller
/// compartment do.
pub fn blocks<const D: usize>(
    cells: &CellAdjacency<D>,
    neck: f64,
    min_cells: usize,
) -> (Vec<u32>, usize) {
    let clearance = clearance(cells);
    let mut order: Vec<u32> = (0..cells.len() as u32).collect();
    order.sort_by(|&a, &b| {
        let [x, y] = [a, b].map(|c| clearance[c as usize]);
        y.total_cmp(&x).then(a.cmp(&b))
    });
    let mut sets = UnionFind::new(cells.len());
    let mut peak = clearance.clone();
    let mut done = vec![false; cells.len()];
    for &c in &order {
        done[c as usize] = true;
        let own_clearance = clearance[c as usize];
        let neighbours = cells
            .links_of(c)
            .filter(|(_, link, n)| link.is_open && done[*n as usize]);
        // Wide faces far from surfaces come first.
        let mut candidates: Vec<(f64, u32)> = neighbours
            .map(|(_, link, n)| (link.area * clearance[n as usize], n))
            .collect();
        candidates.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        for (i, &(_, n)) in candidates.iter().enumerate() {
            let (own_set, other_set) = (sets.find(c), sets.find(n));
            let [p, q] = [own_set, other_set].map(|s| peak[s as usize]);
            // A cell always joins its first neighbour; it joins others only if the opening is wide
            // enough.
            if own_set != other_set && (i == 0 || neck == 0.0 || own_clearance >= neck * p.min(q)) {
                sets.unite(own_set, other_set);
                peak[own_set.min(other_set) as usize] = p.max(q);
            }
        }
    }
    loop {
        let (block, count) = sets.clone().into_labels();
        let merges = merge_targets(cells, &block, count, min_cells);
        if merges.is_empty() {
            return sort_by_volume(cells, block, count);
        }
        let mut first = vec![NONE; count];
        for (c, &b) in block.iter().enumerate().rev() {
            first[b as usize] = c as u32;
        }
        for (small, target) in merges {
            sets.unite(first[small as usize], first[target as usize]);
        }
    }
}

/// Returns the blocks of fewer than `min_cells` cells, each with the neighbour that it should join.
fn merge_targets<const D: usize>(
    cells: &CellAdjacency<D>,
    block: &[u32],
    count: usize,
    min_cells: usize,
) -> Vec<(u32, u32)> {
    let mut size = vec![0; count];
    for &b in block {
        size[b as usize] += 1;
    }
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for link in &cells.links {
        let [a, b] = link.cells.map(|c| block[c as usize]);
        for (small, neighbour) in [(a, b), (b, a)] {
            if a != b && size[small as usize] < min_cells {
                // Any open area counts for more than all closed area.
                let weight = if link.is_open { 1e6 } else { 1.0 };
                *shared.entry((small, neighbour)).or_default() += weight * link.area;
            }
        }
    }
    let mut best: BTreeMap<u32, (f64, u32)> = BTreeMap::new();
    for (&(small, neighbour), &area) in &shared {
        let entry = best.entry(small).or_insert((area, neighbour));
        if area > entry.0 {
            *entry = (area, neighbour);
        }
    }
    best.into_iter()
        .map(|(small, (_, neighbour))| (small, neighbour))
        .collect()
}

/// Renumbers blocks by decreasing volume.
fn sort_by_volume<const D: usize>(
    cells: &CellAdjacency<D>,
    mut block: Vec<u32>,
    count: usize,
) -> (Vec<u32>, usize) {
    let mut volume = vec![0.0; count];
    for (c, &b) in block.iter().enumerate() {
        volume[b as usize] += cells.volumes[c];
    }
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| volume[b].total_cmp(&volume[a]).then(a.cmp(&b)));
    let mut rank = vec![0; count];
    for (number, &b) in order.iter().enumerate() {
        rank[b] = number as u32;
    }
    block.iter_mut().for_each(|b| *b = rank[*b as usize]);
    (block, count)
}

/// Paints from seeds: each cell gets the label of the seed from which paint arrives first. Paint
/// flows along the shortest path, at most as far as `level`, and stays in the block (see
/// [`blocks`]) of its seed. `factors` (see [`contrast_factors`]) multiply the lengths of links.
pub fn grow<const D: usize>(
    geodesics: &Geodesics<impl Borrow<CellAdjacency<D>>, D>,
    block: &[u32],
    factors: Option<&[f64]>,
    seeds: &[GeodesicSource<D>],
    level: f64,
) -> Arrivals {
    let links = &geodesics.cells().links;
    let passes = |l: usize| {
        let [a, b] = links[l].cells.map(|c| block[c as usize]);
        links[l].is_open && a == b
    };
    let penalty = |l: usize| factors.map_or(0.0, |factors| (factors[l] - 1.0) * links[l].distance);
    geodesics.shortest_paths(seeds, passes, penalty, level)
}

/// Returns for each link the factor by which differences of image values slow down paint: 1 +
/// (difference / rms difference)^2.
pub fn contrast_factors<const D: usize>(cells: &CellAdjacency<D>, values: &[f64]) -> Vec<f64> {
    let square = |[a, b]: [u32; 2]| (values[a as usize] - values[b as usize]).powi(2);
    let sum: f64 = cells.links.iter().map(|link| square(link.cells)).sum();
    let mean = sum / cells.links.len().max(1) as f64;
    let factor = |s: f64| if mean > 0.0 { 1.0 + s / mean } else { 1.0 };
    cells
        .links
        .iter()
        .map(|link| factor(square(link.cells)))
        .collect()
}
