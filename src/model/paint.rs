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

use crate::geometry::sets::Sets;
use crate::model::surface::adjacency::Adjacency;
use crate::model::surface::facets::NONE;

/// Where paint of a unit begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed {
    /// The cell.
    pub cell: u32,
    /// The unit; several seeds may belong to one.
    pub unit: u32,
}

/// For each cell the distance to the nearest surface, along ways between cell centres that cross
/// none; infinite where there is none to reach.
pub fn clearance<const D: usize>(cells: &Adjacency<D>) -> Vec<f64> {
    let mut sources = Vec::new();
    for link in cells.links.iter().filter(|link| !link.open) {
        sources.extend(link.cells.map(|c| (0.5 * link.distance, c, 0)));
    }
    let distance: Vec<f64> = cells.links.iter().map(|link| link.distance).collect();
    spread(
        cells,
        &sources,
        &distance,
        |l| cells.links[l].open,
        f64::INFINITY,
    )
    .0
}

/// The blocks between surfaces: for each cell the number of its block, largest block 0, and
/// the number of blocks. Blocks of fewer than `least` cells join the neighbour with which they share
/// most area, openly if they can.
///
/// With `neck` 0, every opening joins; with 1, only ways as wide as the smaller room.
pub fn blocks<const D: usize>(cells: &Adjacency<D>, neck: f64, least: usize) -> (Vec<u32>, usize) {
    let clearance = clearance(cells);
    let mut order: Vec<u32> = (0..cells.len() as u32).collect();
    order.sort_by(|&a, &b| {
        let [x, y] = [a, b].map(|c| clearance[c as usize]);
        y.total_cmp(&x).then(a.cmp(&b))
    });
    let mut sets = Sets::new(cells.len());
    let mut peak = clearance.clone();
    let mut done = vec![false; cells.len()];
    for &c in &order {
        done[c as usize] = true;
        let here = clearance[c as usize];
        let near = cells
            .around(c)
            .filter(|(_, link, n)| link.open && done[*n as usize]);
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
        let (block, count) = sets.clone().numbered();
        let crumbs = absorbing(cells, &block, count, least);
        if crumbs.is_empty() {
            return by_size(cells, block, count);
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
fn absorbing<const D: usize>(
    cells: &Adjacency<D>,
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
                let weight = if link.open { 1e6 } else { 1.0 };
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
fn by_size<const D: usize>(
    cells: &Adjacency<D>,
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

/// Paints from seeds: each cell gets the unit of the seed from which paint arrives first. `cost`
/// holds what it takes to flow through each link; paint stays in the block (see [`blocks`]) of its
/// seed and stops where it has cost `level`.
///
/// Returns the unit of each cell, `None` where no paint arrives, and the cost there. Of seeds whose
/// paint arrives at once the lower unit wins.
pub fn paint<const D: usize>(
    cells: &Adjacency<D>,
    block: &[u32],
    cost: &[f64],
    seeds: &[Seed],
    level: f64,
) -> (Vec<Option<u32>>, Vec<f64>) {
    let sources: Vec<(f64, u32, u32)> = seeds.iter().map(|s| (0.0, s.cell, s.unit)).collect();
    let passes = |l: usize| {
        let [a, b] = cells.links[l].cells.map(|c| block[c as usize]);
        cells.links[l].open && a == b
    };
    let (arrival, unit) = spread(cells, &sources, cost, passes, level);
    let painted = arrival
        .iter()
        .zip(unit)
        .map(|(a, u)| a.is_finite().then_some(u));
    (painted.collect(), arrival)
}

/// Least cost from any of the sources (cost there, cell, label) to each cell, infinite beyond
/// `most`, and the label of that source.
fn spread<const D: usize>(
    cells: &Adjacency<D>,
    sources: &[(f64, u32, u32)],
    cost: &[f64],
    passes: impl Fn(usize) -> bool,
    most: f64,
) -> (Vec<f64>, Vec<u32>) {
    let mut least = vec![f64::INFINITY; cells.len()];
    let mut label = vec![NONE; cells.len()];
    // Costs are not negative, so their bits are in their order.
    let mut queue: BinaryHeap<Reverse<(u64, u32, u32)>> = BinaryHeap::new();
    queue.extend(
        sources
            .iter()
            .map(|&(at, c, s)| Reverse((at.to_bits(), s, c))),
    );
    while let Some(Reverse((at, s, c))) = queue.pop() {
        if label[c as usize] != NONE {
            continue;
        }
        let at = f64::from_bits(at);
        least[c as usize] = at;
        label[c as usize] = s;
        for (l, _, n) in cells.around(c) {
            let there = at + cost[l];
            if label[n as usize] == NONE && there <= most && there < least[n as usize] && passes(l)
            {
                least[n as usize] = there;
                queue.push(Reverse((there.to_bits(), s, n)));
            }
        }
    }
    (least, label)
}

/// How much harder paint flows between cells whose image values differ: 1 + (difference / rms
/// difference)^2, for each link.
pub fn contrast<const D: usize>(cells: &Adjacency<D>, values: &[f64]) -> Vec<f64> {
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
