//! Assigns to each cell the label of the largest part of its volume.

use crate::geometry::grid_index::index_at;
use crate::parallel::prelude::*;

use crate::feature::LabelMap;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, sub, unit};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;

/// Number of planes that divide a simplex along each edge. They determine the number of sample
/// points at which the label is evaluated.
const SUBDIVISIONS: usize = 5;

/// Calls a function with every sample point of a cell.
type PointVisitor<'a, const D: usize> = dyn Fn(usize, &mut dyn FnMut([f64; D])) + Sync + 'a;

/// The cells of a mesh with sample points, each of which stands for an equal part of its cell.
pub struct SamplePoints<'a, const D: usize> {
    visit_cell: Box<PointVisitor<'a, D>>,
    count: usize,
    /// Volumes of the cells (areas in 2-D).
    pub volumes: Vec<f64>,
}

impl<'a, const D: usize> SamplePoints<'a, D> {
    /// Creates the sample points of simplices.
    pub fn from_simplices<M: Simplices<D>>(mesh: &'a M) -> Self {
        let samples = sample_weights::<D>(SUBDIVISIONS);
        let visit_cell = move |c: usize, visit: &mut dyn FnMut([f64; D])| {
            let corners = mesh.cell(c);
            for weights in &samples {
                let mut x = [0.0; D];
                for (weight, &n) in weights.iter().zip(corners) {
                    x = add_scaled(x, *weight, mesh.nodes()[n as usize]);
                }
                visit(x);
            }
        };
        Self {
            visit_cell: Box::new(visit_cell),
            count: mesh.len(),
            volumes: mesh.volumes(),
        }
    }

    /// Creates the sample points of polygons or polyhedra, between the site and the nodes of every
    /// face.
    pub fn from_cells(mesh: &'a PolyMesh<D>) -> Self {
        let count = mesh.sites.len();
        let cell_of_side = mesh
            .face_cells
            .iter()
            .flatten()
            .map(|&c| (c as usize).min(count));
        let (start, sides) = sort_by_group(count + 1, cell_of_side);
        let visit_cell = move |c: usize, visit: &mut dyn FnMut([f64; D])| {
            let site = mesh.sites[c];
            visit(site);
            for side in &sides[start[c] as usize..start[c + 1] as usize] {
                for &n in mesh.faces.get(*side as usize / 2) {
                    let direction = sub(mesh.nodes[n as usize], site);
                    for fraction in RADIAL_FRACTIONS {
                        visit(add_scaled(site, fraction, direction));
                    }
                }
            }
        };
        Self {
            visit_cell: Box::new(visit_cell),
            count,
            volumes: mesh.cell_shapes().iter().map(|shape| shape.0).collect(),
        }
    }

    /// Calls `visit` with every sample point of a cell.
    pub fn for_each(&self, cell: usize, mut visit: impl FnMut([f64; D])) {
        (self.visit_cell)(cell, &mut visit);
    }

    /// Counts the labels at the sample points of each cell.
    pub fn votes(&self, labelled: &LabelMap<D>) -> Vec<Votes> {
        let cell_votes = |c: usize| {
            let mut votes = Votes::default();
            self.for_each(c, |x| votes.add(labelled.label_at(x)));
            votes
        };
        (0..self.count).into_par_iter().map(cell_votes).collect()
    }
}

/// Positions of sample points in polyhedra, as fractions of the way from the site to a node.
const RADIAL_FRACTIONS: [f64; 2] = [0.5, 0.85];

/// Returns the faces of each cell beyond which another label lies: bit k for face k. `neighbours`
/// has the adjacent cell for each cell and face.
pub fn interface_marks<const D: usize>(regions: &[u32], neighbours: &[u32]) -> Vec<u8> {
    let cell_marks = |(region, adjacent): (&u32, &[u32])| {
        let has_other_label = |n: u32| n != NONE && regions[n as usize] != *region;
        let bits = adjacent
            .iter()
            .enumerate()
            .map(|(k, &n)| u8::from(has_other_label(n)) << k);
        bits.sum::<u8>()
    };
    regions
        .iter()
        .zip(neighbours.chunks(D + 1))
        .map(cell_marks)
        .collect()
}

/// Returns the sample points of a simplex as weights of its corners: the corners of the small
/// simplices of a subdivision, moved inwards.
fn sample_weights<const D: usize>(subdivisions: usize) -> Vec<Vec<f64>> {
    let mut samples = Vec::new();
    let mut counts = vec![0; D + 1];
    visit_compositions(subdivisions - 1, 0, &mut counts, &mut |counts| {
        let inwards = 1.0 / (D + 1) as f64;
        let weight = |&count: &usize| (count as f64 + inwards) / subdivisions as f64;
        samples.push(counts.iter().map(weight).collect());
    });
    samples
}

/// Calls `visit` with every way to distribute `remaining` units over the entries of `counts` from
/// `index` on.
fn visit_compositions(
    remaining: usize,
    index: usize,
    counts: &mut [usize],
    visit: &mut impl FnMut(&[usize]),
) {
    if index + 1 == counts.len() {
        counts[index] = remaining;
        visit(counts);
        return;
    }
    for count in 0..=remaining {
        counts[index] = count;
        visit_compositions(remaining - count, index + 1, counts, visit);
    }
}

/// Returns the label of each simplex: the label of the largest part of it, unless the cell would
/// then be a spike between cells of another label that covers nearly as much of it. Also returns the
/// sample points of each label in each simplex.
pub fn assign_labels<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbours: &[u32],
    labelled: &LabelMap<D>,
) -> (Vec<u32>, Vec<Votes>) {
    let votes = SamplePoints::from_simplices(mesh).votes(labelled);
    let node_labels = NodeLabels::new(mesh, &votes, labelled);
    let may_have = |c: usize, label: u32| node_labels.allows(mesh.cell(c), label);
    let initial_label = |c: usize| {
        let winner = votes[c].winner();
        if may_have(c, winner) {
            return winner;
        }
        votes[c]
            .winner_among(|label| may_have(c, label))
            .unwrap_or(winner)
    };
    let mut regions: Vec<u32> = (0..mesh.len()).into_par_iter().map(initial_label).collect();
    for _ in 0..MAX_ROUNDS {
        let mut changed = false;
        for c in 0..mesh.len() {
            let current = regions[c];
            let adjacent = &neighbours[(D + 1) * c..][..D + 1];
            let has_other_label = |n: u32| n != NONE && regions[n as usize] != current;
            if !adjacent.iter().any(|&n| has_other_label(n)) {
                continue;
            }
            let volume = mesh.volume(c);
            let area = |k: usize| M::face_area(&mesh.face(c, k).map(|n| mesh.nodes()[n as usize]));
            let areas: [f64; 4] = std::array::from_fn(|k| if k <= D { area(k) } else { 0.0 });
            let cost_per_area = INTERFACE_COST * volume / areas.iter().sum::<f64>();
            let cost = |label: u32| {
                let faces = adjacent.iter().zip(areas).filter(|(n, _)| **n != NONE);
                let separating = faces.filter(|(n, _)| regions[**n as usize] != label);
                let separating_area: f64 = separating.map(|(_, area)| area).sum();
                volume * (1.0 - votes[c].share(label)) + cost_per_area * separating_area
            };
            let (mut best, mut min_cost) = (current, cost(current));
            for &n in adjacent.iter().filter(|n| has_other_label(**n)) {
                let label = regions[n as usize];
                if votes[c].share(label) >= MIN_LABEL_SHARE
                    && cost(label) < (1.0 - 1e-9) * min_cost
                    && may_have(c, label)
                {
                    (best, min_cost) = (label, cost(label));
                }
            }
            changed |= best != current;
            regions[c] = best;
        }
        if !changed {
            break;
        }
    }
    (regions, votes)
}

/// The labels near the nodes of cells that contain several labels. A cell would be a spike if its
/// label were not found near each of its nodes.
struct NodeLabels {
    /// Labels within one sample of each node; empty for nodes that need no test.
    by_node: Vec<Vec<u32>>,
}

impl NodeLabels {
    fn new<const D: usize, M: Simplices<D>>(
        mesh: &M,
        votes: &[Votes],
        labelled: &LabelMap<D>,
    ) -> Self {
        let mut is_needed = vec![false; mesh.nodes().len()];
        for (c, votes) in votes.iter().enumerate() {
            if votes.0.len() > 1 {
                mesh.cell(c)
                    .iter()
                    .for_each(|&n| is_needed[n as usize] = true);
            }
        }
        let directions = directions::<D>();
        let labels_near = |(x, is_needed): (&[f64; D], &bool)| {
            let mut labels = Vec::new();
            if !is_needed {
                return labels;
            }
            labels.push(labelled.label_at(*x));
            for radius in SEARCH_RADII {
                for direction in &directions {
                    let point =
                        std::array::from_fn(|k| x[k] + radius * direction[k] * labelled.step[k]);
                    let label = labelled.label_at(point);
                    if !labels.contains(&label) {
                        labels.push(label);
                    }
                }
            }
            labels
        };
        let nodes = mesh.nodes().par_iter().zip(&is_needed);
        Self {
            by_node: nodes.map(labels_near).collect(),
        }
    }

    /// Returns `true` if a cell with these nodes may have the label.
    fn allows(&self, nodes: &[u32], label: u32) -> bool {
        let has_label = |&n: &u32| {
            let labels = &self.by_node[n as usize];
            labels.is_empty() || labels.contains(&label)
        };
        nodes.iter().all(has_label)
    }
}

/// Distances from a node, in samples, at which labels are evaluated.
const SEARCH_RADII: [f64; 2] = [0.5, 1.0];

/// Returns the unit vectors from a sample to the samples around it.
pub fn directions<const D: usize>() -> Vec<[f64; D]> {
    let count = 3usize.pow(D as u32);
    let steps = (0..count).map(|i| index_at([3; D], i).map(|c| c as f64 - 1.0));
    steps.filter(|v| *v != [0.0; D]).map(unit).collect()
}

/// Largest number of rounds in which cells change their labels.
const MAX_ROUNDS: usize = 5;
/// Cost of a complete surface between labels, relative to the volume of its cell that has the wrong
/// label.
const INTERFACE_COST: f64 = 1.5;
/// Smallest share of a cell that a label must cover to be assigned to it.
const MIN_LABEL_SHARE: f64 = 0.2;

/// Number of sample points with each label.
#[derive(Debug, Clone, Default)]
pub struct Votes(Vec<(u32, u32)>);

impl Votes {
    /// Counts one sample point with the label.
    fn add(&mut self, label: u32) {
        match self.0.iter_mut().find(|(known, _)| *known == label) {
            Some((_, count)) => *count += 1,
            None => self.0.push((label, 1)),
        }
    }

    /// Returns the share of the sample points that have the label.
    pub(super) fn share(&self, label: u32) -> f64 {
        let total: u32 = self.0.iter().map(|(_, count)| count).sum();
        let entry = self.0.iter().find(|(known, _)| *known == label);
        f64::from(entry.map_or(0, |(_, count)| *count)) / f64::from(total.max(1))
    }

    /// Returns the most frequent label of those that `accepts`; `None` if there is none.
    fn winner_among(&self, accepts: impl Fn(u32) -> bool) -> Option<u32> {
        let votes = self.0.iter().filter(|(label, _)| accepts(*label));
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        let winner = votes.fold((0, 0), better);
        (winner.1 > 0).then_some(winner.0)
    }

    /// Returns the most frequent label, and the first one found if several are equally frequent.
    pub fn winner(&self) -> u32 {
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        self.0.iter().fold((0, 0), better).0
    }
}
