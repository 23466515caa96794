//! The flow between the two sides of a fault, through its leaks and around its ends.
//!
//! Fluid enters all cells on one side of the fault, up to other faults and the sides of the mesh, and leaves
//! all cells on the other, at a rate in proportion to their volumes. The conductance is the rate over the
//! difference between the mean pressures of the two sides; a share is a conductance with the fault
//! closed over that with the fault open. All other faults are open.

use std::collections::VecDeque;

use super::leaks::{FaultLeaks, LeakFinder};
use super::network::SealNetwork;
use crate::Result;
use crate::geometry::union_find::UnionFind;
use crate::model::flow::{CellFlow, FaultLaw, Rock, Tensor};
use crate::progress::CancelToken;

/// Shares of the flow between the two sides of an open fault.
pub(super) struct Shares {
    /// The share through each leak of the closed fault.
    pub leaks: Vec<f64>,
    /// The share around the ends of the closed fault.
    pub around: f64,
}

/// Returns the shares of the flow that pass a closed fault.
pub(super) fn shares(
    network: &SealNetwork,
    finder: &LeakFinder<'_>,
    fault: u32,
    found: &FaultLeaks,
    cancel: &CancelToken<'_>,
) -> Result<Shares> {
    let blocks = blocks(network, finder, fault, found);
    let open = conductance(network, &network.transmissibility, &blocks, &[], cancel)?.0;
    let mut closed = network.transmissibility.clone();
    let labels = network.labels.iter().zip(&network.is_closed);
    for (t, (label, is_closed)) in closed.iter_mut().zip(labels) {
        // Closed fragments and horizons fill holes.
        if *is_closed && !network.is_other_fault(*label, fault) {
            *t = 0.0;
        }
    }
    let leak_connections: Vec<&[(usize, f64)]> = found
        .leaks
        .iter()
        .map(|leak| &leak.connections[..])
        .collect();
    let (total, leaks) = conductance(network, &closed, &blocks, &leak_connections, cancel)?;
    if open <= 0.0 {
        return Ok(Shares {
            leaks: vec![0.0; leaks.len()],
            around: 0.0,
        });
    }
    let leaks: Vec<f64> = leaks.iter().map(|leak| (leak / open).max(0.0)).collect();
    let through: f64 = leaks.iter().sum();
    Ok(Shares {
        around: (total / open - through).max(0.0),
        leaks,
    })
}

/// Returns -1 or 1 for the cells of the blocks on the two sides of a fault, and 0 for other cells. A
/// cell between has the side that fewer connections lead to.
fn blocks(
    network: &SealNetwork,
    finder: &LeakFinder<'_>,
    fault: u32,
    found: &FaultLeaks,
) -> Vec<i8> {
    let mut blocks = found.sides.clone();
    let cells = 0..blocks.len() as u32;
    let mut front: VecDeque<u32> = cells.filter(|cell| blocks[*cell as usize] != 0).collect();
    while let Some(cell) = front.pop_front() {
        for &index in finder.connections_at(cell) {
            let index = index as usize;
            if network.labels[index] == fault || finder.is_barrier(index) {
                continue;
            }
            let [a, b] = network.graph.connections[index].cells;
            let other = if a == cell { b } else { a };
            if blocks[other as usize] == 0 {
                blocks[other as usize] = blocks[cell as usize];
                front.push_back(other);
            }
        }
    }
    blocks
}

/// Returns the conductance between the blocks -1 and 1, and the part of it through each set of
/// connections.
fn conductance(
    network: &SealNetwork,
    transmissibility: &[f64],
    blocks: &[i8],
    sets: &[&[(usize, f64)]],
    cancel: &CancelToken<'_>,
) -> Result<(f64, Vec<f64>)> {
    let graph = &network.graph;
    let mut components = UnionFind::new(blocks.len());
    for (c, t) in graph.connections.iter().zip(transmissibility) {
        if *t > 0.0 {
            components.unite(c.cells[0], c.cells[1]);
        }
    }
    let component: Vec<usize> = (0..blocks.len() as u32)
        .map(|cell| components.find(cell) as usize)
        .collect();
    // Volumes of the two blocks in each connected part of the cells.
    let mut volumes = vec![[0.0; 2]; blocks.len()];
    for (cell, block) in blocks.iter().enumerate().filter(|(_, block)| **block != 0) {
        volumes[component[cell]][usize::from(*block > 0)] += graph.volume[cell];
    }
    let is_joined = |part: usize| volumes[part].iter().all(|volume| *volume > 0.0);
    if !component.iter().any(|part| is_joined(*part)) {
        return Ok((0.0, vec![0.0; sets.len()]));
    }
    let share = |cell: usize| match blocks[cell] {
        0 => 0.0,
        block if is_joined(component[cell]) => {
            graph.volume[cell] / volumes[component[cell]][usize::from(block > 0)]
        }
        _ => 0.0,
    };
    // Fluid enters on the side -1.
    let rates: Vec<f64> = (0..blocks.len())
        .map(|cell| -f64::from(blocks[cell]) * share(cell))
        .collect();
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let mut flow = CellFlow::new(graph, &rock, FaultLaw::OPEN)?;
    // The scale has no effect on shares, but the solver needs numbers of a usual size.
    let largest = network.transmissibility.iter().copied().fold(0.0, f64::max);
    flow.transmissibility = transmissibility.iter().map(|t| t / largest).collect();
    let pressure = flow.solve_cancellable(&rates, &[], cancel)?.pressure;
    let mut differences = vec![0.0; blocks.len()];
    for (cell, rate) in rates.iter().enumerate() {
        differences[component[cell]] += rate * pressure[cell];
    }
    let of_part = |part: usize| {
        if is_joined(part) && differences[part] > 0.0 {
            1.0 / differences[part]
        } else {
            0.0
        }
    };
    let total = (0..blocks.len()).map(of_part).sum();
    let through = |set: &&[(usize, f64)]| {
        let flows = set.iter().map(|&(index, sign)| {
            let [a, b] = graph.connections[index].cells.map(|cell| cell as usize);
            let rate = flow.transmissibility[index] * (pressure[a] - pressure[b]);
            sign * rate * of_part(component[a])
        });
        flows.sum()
    };
    Ok((total, sets.iter().map(through).collect()))
}
