//! Painting: cells grown from seeds, as paint flows within layers but not across surfaces
//! (Hale 2002, figure 3 and conclusion); and the blocks between surfaces, without seeds.
//!
//! A detected surface has holes, and paint would flow through the smallest. So surfaces first part
//! the mesh into *blocks*, by how far a cell is from the nearest surface, its *clearance*: two rooms
//! are one block if the way between them is wide compared with the smaller room, two if it is a
//! crack. That is a watershed of the clearance, with neighbouring basins merged where the saddle
//! between them is at least `neck` times the lower peak. Paint then flows within the block of its
//! seed.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use crate::geometry::union_find::UnionFind;
use crate::model::geodesics::{Arrivals, GeodesicSource, Geodesics};
use crate::model::surface::adjacency::CellAdjacency;
use crate::model::surface::facets::NONE;

/// For each cell the distance to the nearest surface, along ways between cell centres that cross
/// none; infinite where there is none to reach.
pub fn clearance<const D: usize>(cells: &CellAdjacency<D>) -> Vec<f64> {
    let mut least = vec![f64::INFINITY; cells.len()];
    let mut done = vec![false; cells.len()];
    // Distances are not negative, so their bits are in their order.
    let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    for link in cells.links.iter().filter(|link| !link.is_open) {
        queue.extend(
            link.cells
                .map(|c| Reverse(((0.5 * link.distance).to_bits(), c))),
        );
    }
    while let Some(Reverse((at, c))) = queue.pop() {
        if std::mem::replace(&mut done[c as usize], true) {
            continue;
        }
        let at = f64::from_bits(at);
        least[c as usize] = at;
        for (_, link, n) in cells.links_of(c) {
            let there = at + link.distance;
            if link.is_open && !done[n as usize] && there < least[n as usize] {
                least[n as usize] = there;
                queue.push(Reverse((there.to_bits(), n)));
            }
        }
    }
    least
}

/// The blocks between surfaces: for each cell the number of its block, largest block 0, and
/// the number of blocks. Blocks of fewer than `least` cells join the neighbour with which they share
/// most area, openly if they can.
///
/// With `neck` 0, every opening joins; with 1, only ways as wide as the smaller room.
pub fn blocks<const D: usize>(
    cells: &CellAdjacency<D>,
    neck: f64,
    least: usize,
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
        let here = clearance[c as usize];
        let near = cells
            .links_of(c)
            .filter(|(_, link, n)| link.is_open && done[*n as usize]);
        // Through a wide face, and away from walls.
        let mut near: Vec<(f64, u32)> = near
            .map(|(_, link, n)| (link.area * clearance[n as usize], n))
            .collect();
        near.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        for (i, &(_, n)) in near.iter().enumerate() {
            let (own, other) = (sets.find(c), sets.find(n));
            let [p, q] = [own, other].map(|s| peak[s as usize]);
            // To the first neighbour in any case; to others if the way is wide enough.
            if own != other && (i == 0 || neck == 0.0 || here >= neck * p.min(q)) {
                sets.unite(own, other);
                peak[own.min(other) as usize] = p.max(q);
            }
        }
    }
    loop {
        let (block, count) = sets.clone().into_labels();
        let crumbs = merge_targets(cells, &block, count, least);
        if crumbs.is_empty() {
            return sort_by_volume(cells, block, count);
        }
        let mut first = vec![NONE; count];
        for (c, &b) in block.iter().enumerate().rev() {
            first[b as usize] = c as u32;
        }
        for (crumb, into) in crumbs {
            sets.unite(first[crumb as usize], first[into as usize]);
        }
    }
}

/// The blocks of fewer than `least` cells, and the neighbour that each should join.
fn merge_targets<const D: usize>(
    cells: &CellAdjacency<D>,
    block: &[u32],
    count: usize,
    least: usize,
) -> Vec<(u32, u32)> {
    let mut size = vec![0; count];
    for &b in block {
        size[b as usize] += 1;
    }
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for link in &cells.links {
        let [a, b] = link.cells.map(|c| block[c as usize]);
        for (from, to) in [(a, b), (b, a)] {
            if a != b && size[from as usize] < least {
                // Any opening counts for more than all that is closed.
                let weight = if link.is_open { 1e6 } else { 1.0 };
                *shared.entry((from, to)).or_default() += weight * link.area;
            }
        }
    }
    let mut best: BTreeMap<u32, (f64, u32)> = BTreeMap::new();
    for (&(from, to), &area) in &shared {
        let entry = best.entry(from).or_insert((area, to));
        if area > entry.0 {
            *entry = (area, to);
        }
    }
    best.into_iter().map(|(from, (_, to))| (from, to)).collect()
}

/// Blocks numbered by falling volume.
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
    for (place, &b) in order.iter().enumerate() {
        rank[b] = place as u32;
    }
    block.iter_mut().for_each(|b| *b = rank[*b as usize]);
    (block, count)
}

/// Paints from seeds: each cell gets the label of the seed from which paint arrives first. Paint flows
/// the shortest way, as far as `level`; it stays in the block (see [`blocks`]) of its seed. What links
/// say in `harder` (see [`contrast_factors`]) lengthens ways through them.
pub fn paint<const D: usize>(
    ways: &Geodesics<'_, D>,
    block: &[u32],
    harder: Option<&[f64]>,
    seeds: &[GeodesicSource<D>],
    level: f64,
) -> Arrivals {
    let links = &ways.cells().links;
    let passes = |l: usize| {
        let [a, b] = links[l].cells.map(|c| block[c as usize]);
        links[l].is_open && a == b
    };
    let toll = |l: usize| harder.map_or(0.0, |harder| (harder[l] - 1.0) * links[l].distance);
    ways.shortest_paths(seeds, passes, toll, level)
}

/// How much harder paint flows between cells whose image values differ: 1 + (difference / rms
/// difference)^2, for each link.
pub fn contrast_factors<const D: usize>(cells: &CellAdjacency<D>, values: &[f64]) -> Vec<f64> {
    let square = |[a, b]: [u32; 2]| (values[a as usize] - values[b as usize]).powi(2);
    let sum: f64 = cells.links.iter().map(|link| square(link.cells)).sum();
    let mean = sum / cells.links.len().max(1) as f64;
    let harder = |s: f64| if mean > 0.0 { 1.0 + s / mean } else { 1.0 };
    cells
        .links
        .iter()
        .map(|link| harder(square(link.cells)))
        .collect()
}
