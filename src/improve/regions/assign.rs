//! A cell has the label of most of its volume.

use crate::parallel::prelude::*;

use crate::feature::LabelMap;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, sub};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;

/// Cells are divided by so many planes along each edge: their label is asked for in as many places as
/// that gives.
const SUBDIVISIONS: usize = 5;

/// Visits the places in a cell.
type PointVisitor<'a, const D: usize> = dyn Fn(usize, &mut dyn FnMut([f64; D])) + Sync + 'a;

/// Cells, and places in them that stand for equal parts of each.
pub struct SamplePoints<'a, const D: usize> {
    visit_cell: Box<PointVisitor<'a, D>>,
    count: usize,
    /// The cells' volumes (areas in 2-D).
    pub volumes: Vec<f64>,
}

impl<'a, const D: usize> SamplePoints<'a, D> {
    /// Of simplices.
    pub fn from_simplices<M: Simplices<D>>(mesh: &'a M) -> Self {
        let places = sample_weights::<D>(SUBDIVISIONS);
        let of_cell = move |c: usize, visit: &mut dyn FnMut([f64; D])| {
            let corners = mesh.cell(c);
            for weights in &places {
                let mut x = [0.0; D];
                for (weight, &n) in weights.iter().zip(corners) {
                    x = add_scaled(x, *weight, mesh.nodes()[n as usize]);
                }
                visit(x);
            }
        };
        Self {
            visit_cell: Box::new(of_cell),
            count: mesh.len(),
            volumes: (0..mesh.len()).map(|c| mesh.volume(c)).collect(),
        }
    }

    /// Of polygons or polyhedra: between the site and the nodes of every face.
    pub fn from_cells(mesh: &'a PolyMesh<D>) -> Self {
        let count = mesh.sites.len();
        let ends = mesh
            .face_cells
            .iter()
            .flatten()
            .map(|&c| (c as usize).min(count));
        let (start, ends) = sort_by_group(count + 1, ends);
        let of_cell = move |c: usize, visit: &mut dyn FnMut([f64; D])| {
            let site = mesh.sites[c];
            visit(site);
            for end in &ends[start[c] as usize..start[c + 1] as usize] {
                for &n in mesh.faces.get(*end as usize / 2) {
                    let out = sub(mesh.nodes[n as usize], site);
                    for share in RADIAL_FRACTIONS {
                        visit(add_scaled(site, share, out));
                    }
                }
            }
        };
        Self {
            visit_cell: Box::new(of_cell),
            count,
            volumes: mesh.cell_shapes().iter().map(|shape| shape.0).collect(),
        }
    }

    /// Visits the places in a cell.
    pub fn for_each(&self, cell: usize, mut visit: impl FnMut([f64; D])) {
        (self.visit_cell)(cell, &mut visit);
    }

    /// How often which label is found in each cell.
    pub fn votes(&self, labelled: &LabelMap<D>) -> Vec<Votes> {
        let of_cell = |c: usize| {
            let mut votes = Votes::default();
            self.for_each(c, |x| votes.add(labelled.label_at(x)));
            votes
        };
        (0..self.count).into_par_iter().map(of_cell).collect()
    }
}

/// How far out places in polyhedra are, as shares of the way from the site to a node.
const RADIAL_FRACTIONS: [f64; 2] = [0.5, 0.85];

/// For each cell of a mesh with `neighbors`, by face, the faces beyond which another label is.
pub fn interface_marks<const D: usize>(regions: &[u32], neighbors: &[u32]) -> Vec<u8> {
    let of_cell = |(region, beyond): (&u32, &[u32])| {
        let other = |n: u32| n != NONE && regions[n as usize] != *region;
        let bits = beyond
            .iter()
            .enumerate()
            .map(|(k, &n)| u8::from(other(n)) << k);
        bits.sum()
    };
    regions
        .iter()
        .zip(neighbors.chunks(D + 1))
        .map(of_cell)
        .collect()
}

/// Places in a simplex, as weights of its corners: the corners of as many small ones, drawn inwards.
fn sample_weights<const D: usize>(planes: usize) -> Vec<Vec<f64>> {
    let mut found = Vec::new();
    let mut counts = vec![0; D + 1];
    visit_compositions(planes - 1, 0, &mut counts, &mut |counts| {
        let inwards = 1.0 / (D + 1) as f64;
        let weight = |&count: &usize| (count as f64 + inwards) / planes as f64;
        found.push(counts.iter().map(weight).collect());
    });
    found
}

/// Visits every way to put `left` things into the places from `place` on.
fn visit_compositions(
    left: usize,
    place: usize,
    counts: &mut [usize],
    visit: &mut impl FnMut(&[usize]),
) {
    if place + 1 == counts.len() {
        counts[place] = left;
        visit(counts);
        return;
    }
    for here in 0..=left {
        counts[place] = here;
        visit_compositions(left - here, place + 1, counts, visit);
    }
}

/// The label of each simplex: that of most of it, unless it would be a spike between cells of another label
/// that it has nearly as much of.
pub fn assign_labels<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    labelled: &LabelMap<D>,
) -> Vec<u32> {
    let votes = SamplePoints::from_simplices(mesh).votes(labelled);
    let near = NodeLabels::new(mesh, &votes, labelled);
    let may_have = |c: usize, label: u32| near.allows(mesh.cell(c), label);
    let first = |c: usize| {
        let most = votes[c].winner();
        if may_have(c, most) {
            return most;
        }
        votes[c]
            .winner_among(|label| may_have(c, label))
            .unwrap_or(most)
    };
    let mut regions: Vec<u32> = (0..mesh.len()).into_par_iter().map(first).collect();
    for _ in 0..MAX_ROUNDS {
        let mut changed = false;
        for c in 0..mesh.len() {
            let here = regions[c];
            let beyond = &neighbors[(D + 1) * c..][..D + 1];
            let other = |n: u32| n != NONE && regions[n as usize] != here;
            if !beyond.iter().any(|&n| other(n)) {
                continue;
            }
            let volume = mesh.volume(c);
            let area = |k: usize| M::face_area(&mesh.face(c, k).map(|n| mesh.nodes()[n as usize]));
            let areas: [f64; 4] = std::array::from_fn(|k| if k <= D { area(k) } else { 0.0 });
            let price = INTERFACE_COST * volume / areas.iter().sum::<f64>();
            let cost = |label: u32| {
                let faces = beyond.iter().zip(areas).filter(|(n, _)| **n != NONE);
                let parted = faces.filter(|(n, _)| regions[**n as usize] != label);
                let parted: f64 = parted.map(|(_, area)| area).sum();
                volume * (1.0 - votes[c].share(label)) + price * parted
            };
            let (mut best, mut least) = (here, cost(here));
            for &n in beyond.iter().filter(|n| other(**n)) {
                let label = regions[n as usize];
                if votes[c].share(label) >= MIN_LABEL_SHARE
                    && cost(label) < (1.0 - 1e-9) * least
                    && may_have(c, label)
                {
                    (best, least) = (label, cost(label));
                }
            }
            changed |= best != here;
            regions[c] = best;
        }
        if !changed {
            break;
        }
    }
    regions
}

/// The labels near the nodes of cells of several labels. A cell that has a label which is not near one of its
/// nodes would be a spike.
struct NodeLabels {
    /// For each node the labels within a sample of it; empty where that was not asked for.
    by_node: Vec<Vec<u32>>,
}

impl NodeLabels {
    fn new<const D: usize, M: Simplices<D>>(
        mesh: &M,
        votes: &[Votes],
        labelled: &LabelMap<D>,
    ) -> Self {
        let mut asked = vec![false; mesh.nodes().len()];
        for (c, votes) in votes.iter().enumerate() {
            if votes.0.len() > 1 {
                mesh.cell(c).iter().for_each(|&n| asked[n as usize] = true);
            }
        }
        let directions = directions::<D>();
        let of_node = |(x, asked): (&[f64; D], &bool)| {
            let mut found = Vec::new();
            if !asked {
                return found;
            }
            found.push(labelled.label_at(*x));
            for part in SEARCH_RADII {
                for along in &directions {
                    let there = std::array::from_fn(|k| x[k] + part * along[k] * labelled.step[k]);
                    let label = labelled.label_at(there);
                    if !found.contains(&label) {
                        found.push(label);
                    }
                }
            }
            found
        };
        let nodes = mesh.nodes().par_iter().zip(&asked);
        Self {
            by_node: nodes.map(of_node).collect(),
        }
    }

    /// Returns whether a cell of these nodes may have a label.
    fn allows(&self, nodes: &[u32], label: u32) -> bool {
        let near = |&n: &u32| {
            let labels = &self.by_node[n as usize];
            labels.is_empty() || labels.contains(&label)
        };
        nodes.iter().all(near)
    }
}

/// How far round a node labels are looked for, in samples.
const SEARCH_RADII: [f64; 2] = [0.5, 1.0];

/// The directions to the samples round one, of length 1.
pub fn directions<const D: usize>() -> Vec<[f64; D]> {
    let count = 3usize.pow(D as u32);
    let steps = (0..count).map(|i| {
        let mut rest = i;
        std::array::from_fn(|_| {
            let step = (rest % 3) as f64 - 1.0;
            rest /= 3;
            step
        })
    });
    let unit = |v: [f64; D]| {
        let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        (length > 0.0).then(|| v.map(|c| c / length))
    };
    steps.filter_map(unit).collect()
}

/// Rounds in which cells may change their labels.
const MAX_ROUNDS: usize = 5;
/// What a whole surface between labels costs, in volumes of its cell that has the wrong label.
const INTERFACE_COST: f64 = 1.5;
/// A cell takes no label of which it has less than this share.
const MIN_LABEL_SHARE: f64 = 0.2;

/// How often each label was found.
#[derive(Debug, Clone, Default)]
pub struct Votes(Vec<(u32, u32)>);

impl Votes {
    fn add(&mut self, label: u32) {
        match self.0.iter_mut().find(|(known, _)| *known == label) {
            Some((_, count)) => *count += 1,
            None => self.0.push((label, 1)),
        }
    }

    /// The share of the finds that were of a label.
    fn share(&self, label: u32) -> f64 {
        let all: u32 = self.0.iter().map(|(_, count)| count).sum();
        let own = self.0.iter().find(|(known, _)| *known == label);
        f64::from(own.map_or(0, |(_, count)| *count)) / f64::from(all.max(1))
    }

    /// The label found most often among those that are `wanted`.
    fn winner_among(&self, wanted: impl Fn(u32) -> bool) -> Option<u32> {
        let votes = self.0.iter().filter(|(label, _)| wanted(*label));
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        let most = votes.fold((0, 0), better);
        (most.1 > 0).then_some(most.0)
    }

    /// The label found most often; of several the one found first.
    pub fn winner(&self) -> u32 {
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        self.0.iter().fold((0, 0), better).0
    }
}
