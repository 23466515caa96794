//! A cell has the label of most of its volume.

use crate::parallel::prelude::*;

use crate::feature::Labelled;
use crate::geometry::groups::grouped;
use crate::geometry::{add_scaled, sub};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;

/// Cells are divided by so many planes along each edge: their label is asked for in as many places as
/// that gives.
const PLANES: usize = 5;

/// Visits the places in a cell.
type Visiting<'a, const D: usize> = dyn Fn(usize, &mut dyn FnMut([f64; D])) + Sync + 'a;

/// Cells, and places in them that stand for equal parts of each.
pub struct Places<'a, const D: usize> {
    of_cell: Box<Visiting<'a, D>>,
    count: usize,
    /// The cells' volumes (areas in 2-D).
    pub sizes: Vec<f64>,
}

impl<'a, const D: usize> Places<'a, D> {
    /// Of simplices.
    pub fn of_simplices<M: Simplices<D>>(mesh: &'a M) -> Self {
        let places = places::<D>(PLANES);
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
            of_cell: Box::new(of_cell),
            count: mesh.len(),
            sizes: (0..mesh.len()).map(|c| mesh.volume(c)).collect(),
        }
    }

    /// Of polygons or polyhedra: between the site and the nodes of every face.
    pub fn of_cells(mesh: &'a PolyMesh<D>) -> Self {
        let count = mesh.sites.len();
        let ends = mesh
            .face_cells
            .iter()
            .flatten()
            .map(|&c| (c as usize).min(count));
        let (start, ends) = grouped(count + 1, ends);
        let of_cell = move |c: usize, visit: &mut dyn FnMut([f64; D])| {
            let site = mesh.sites[c];
            visit(site);
            for end in &ends[start[c] as usize..start[c + 1] as usize] {
                for &n in mesh.faces.get(*end as usize / 2) {
                    let out = sub(mesh.nodes[n as usize], site);
                    for share in OUTWARDS {
                        visit(add_scaled(site, share, out));
                    }
                }
            }
        };
        Self {
            of_cell: Box::new(of_cell),
            count,
            sizes: mesh.cell_shapes().iter().map(|shape| shape.0).collect(),
        }
    }

    /// Visits the places in a cell.
    pub fn each(&self, cell: usize, mut visit: impl FnMut([f64; D])) {
        (self.of_cell)(cell, &mut visit);
    }

    /// How often which label is found in each cell.
    pub fn votes(&self, labelled: &Labelled<D>) -> Vec<Votes> {
        let of_cell = |c: usize| {
            let mut votes = Votes::default();
            self.each(c, |x| votes.add(labelled.at(x)));
            votes
        };
        (0..self.count).into_par_iter().map(of_cell).collect()
    }
}

/// How far out places in polyhedra are, as shares of the way from the site to a node.
const OUTWARDS: [f64; 2] = [0.5, 0.85];

/// For each cell of a mesh with `neighbors`, by face, the faces beyond which another label is.
pub fn marks<const D: usize>(regions: &[u32], neighbors: &[u32]) -> Vec<u8> {
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
fn places<const D: usize>(planes: usize) -> Vec<Vec<f64>> {
    let mut found = Vec::new();
    let mut counts = vec![0; D + 1];
    lay_out(planes - 1, 0, &mut counts, &mut |counts| {
        let inwards = 1.0 / (D + 1) as f64;
        let weight = |&count: &usize| (count as f64 + inwards) / planes as f64;
        found.push(counts.iter().map(weight).collect());
    });
    found
}

/// Visits every way to put `left` things into the places from `place` on.
fn lay_out(left: usize, place: usize, counts: &mut [usize], visit: &mut impl FnMut(&[usize])) {
    if place + 1 == counts.len() {
        counts[place] = left;
        visit(counts);
        return;
    }
    for here in 0..=left {
        counts[place] = here;
        lay_out(left - here, place + 1, counts, visit);
    }
}

/// The label of each simplex: that of most of it, unless it would be a spike between cells of another label
/// that it has nearly as much of.
pub fn labels<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    labelled: &Labelled<D>,
) -> Vec<u32> {
    let votes = Places::of_simplices(mesh).votes(labelled);
    let near = LabelsNear::new(mesh, &votes, labelled);
    let may_have = |c: usize, label: u32| near.allow(mesh.cell(c), label);
    let first = |c: usize| {
        let most = votes[c].most();
        if may_have(c, most) {
            return most;
        }
        votes[c].most_of(|label| may_have(c, label)).unwrap_or(most)
    };
    let mut regions: Vec<u32> = (0..mesh.len()).into_par_iter().map(first).collect();
    for _ in 0..ROUNDS {
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
            let price = PRICE * volume / areas.iter().sum::<f64>();
            let cost = |label: u32| {
                let faces = beyond.iter().zip(areas).filter(|(n, _)| **n != NONE);
                let parted = faces.filter(|(n, _)| regions[**n as usize] != label);
                let parted: f64 = parted.map(|(_, area)| area).sum();
                volume * (1.0 - votes[c].share(label)) + price * parted
            };
            let (mut best, mut least) = (here, cost(here));
            for &n in beyond.iter().filter(|n| other(**n)) {
                let label = regions[n as usize];
                if votes[c].share(label) >= SOME
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
struct LabelsNear {
    /// For each node the labels within a sample of it; empty where that was not asked for.
    of_node: Vec<Vec<u32>>,
}

impl LabelsNear {
    fn new<const D: usize, M: Simplices<D>>(
        mesh: &M,
        votes: &[Votes],
        labelled: &Labelled<D>,
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
            found.push(labelled.at(*x));
            for part in NEAR {
                for along in &directions {
                    let there = std::array::from_fn(|k| x[k] + part * along[k] * labelled.step[k]);
                    let label = labelled.at(there);
                    if !found.contains(&label) {
                        found.push(label);
                    }
                }
            }
            found
        };
        let nodes = mesh.nodes().par_iter().zip(&asked);
        Self {
            of_node: nodes.map(of_node).collect(),
        }
    }

    /// Returns whether a cell of these nodes may have a label.
    fn allow(&self, nodes: &[u32], label: u32) -> bool {
        let near = |&n: &u32| {
            let labels = &self.of_node[n as usize];
            labels.is_empty() || labels.contains(&label)
        };
        nodes.iter().all(near)
    }
}

/// How far round a node labels are looked for, in samples.
const NEAR: [f64; 2] = [0.5, 1.0];

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
const ROUNDS: usize = 5;
/// What a whole surface between labels costs, in volumes of its cell that has the wrong label.
const PRICE: f64 = 1.5;
/// A cell takes no label of which it has less than this share.
const SOME: f64 = 0.2;

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
    fn most_of(&self, wanted: impl Fn(u32) -> bool) -> Option<u32> {
        let votes = self.0.iter().filter(|(label, _)| wanted(*label));
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        let most = votes.fold((0, 0), better);
        (most.1 > 0).then_some(most.0)
    }

    /// The label found most often; of several the one found first.
    pub fn most(&self) -> u32 {
        let better = |a: (u32, u32), &b: &(u32, u32)| if b.1 > a.1 { b } else { a };
        self.0.iter().fold((0, 0), better).0
    }
}
