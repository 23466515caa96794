//! Nodes between regions move so that faces lie on the interface in the mean.
//!
//! Faces whose nodes lie on a curved interface cut its bulges off, and regions are too small. So it is
//! not nodes that are put onto the interface but faces: from places on each face the interface is
//! sought along its normal, and a node moves to where the squares of these distances, over the faces
//! round it, are least. On a smooth interface that is a move along the normal; on a line where three
//! regions meet all of their interfaces decide. Interfaces then give way a little, all those between
//! two regions alike, so that every region has the volume of its samples.
//!
//! No move makes an angle worse that is out of the range aimed at, nor takes one out of it.

use std::collections::BTreeMap;

use crate::parallel::prelude::*;

use super::assign::directions;
use super::{balance, region_volumes};
use crate::feature::LabelMap;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::lattice::AtomKind;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Moves of every node, at most.
const MAX_SWEEPS: usize = 10;
/// How often cells of spikes are given another label, at most.
const MAX_TRIMS: usize = 4;
/// From the sweep of this number on volumes are balanced.
const FIRST_BALANCED_SWEEP: usize = 2;
/// Interfaces are sought up to this far from faces, in samples ...
const SEARCH_RADIUS: f64 = 3.0;
/// ... and give way by at most so many.
const MAX_BALANCE_SHIFT: f64 = 0.35;
/// A node moves at most this share of the length of its shortest edge at a time.
const MAX_MOVE_RATIO: f64 = 0.25;
/// How much a move is held back where faces say nothing of its direction.
const DAMPING: f64 = 0.02;
/// A node that lies farther off the interface, in samples, is the tip of a spike, which ...
const MIN_SPIKE_LENGTH: f64 = 0.75;
/// ... goes even if angles become as small as this, in degrees.
const MIN_SPIKE_ANGLE: f64 = 20.0;
/// Tips of spikes are pulled back if they are at most so far off, in samples.
const MAX_TIP_DISTANCE: f64 = 8.0;
/// Parts of a move that are tried.
const STEP_FRACTIONS: [f64; 4] = [1.0, 0.5, 0.25, 0.1];

/// What is fitted.
#[derive(Debug, Clone, Copy)]
pub struct InterfaceFit<'a, const D: usize> {
    /// The labels.
    pub labelled: &'a LabelMap<D>,
    /// The label of each cell.
    pub regions: &'a [u32],
    /// For every cell and face, in order, the cell on its other side.
    pub neighbors: &'a [u32],
    /// What each node may do.
    pub kinds: &'a [AtomKind],
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Angles are to be at least so large (degrees), and at most 180 less it.
    pub min_angle: f64,
}

/// A face between two regions.
struct InterfaceFace<const D: usize> {
    nodes: [u32; D],
    /// The regions, the smaller number first, from which the normal points into the other.
    regions: [u32; 2],
    normal: [f64; D],
    area: f64,
    /// By node, how far the interface is, and how sure that is.
    offsets: [(f64, f64); D],
}

/// The tip of a spike: a node of an interface from which one of its labels is more than a sample away.
struct SpikeTip<const D: usize> {
    node: u32,
    /// Direction of the nearest place on the interface, and how far that is.
    direction: [f64; D],
    distance: f64,
    /// The label round the tip, and that of the spike.
    surrounding_label: u32,
    spike_label: u32,
}

/// Returns the labels of the cells of a mesh that was fitted, with those at the tips of spikes cut off: they take the
/// label round the tip, unless their middle has their own or they part that from a third one.
pub fn remove_spikes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    fitting: &InterfaceFit<'_, D>,
) -> Vec<u32> {
    let mut regions = fitting.regions.to_vec();
    for _ in 0..MAX_TRIMS {
        let trimmed = InterfaceFit {
            regions: &regions,
            ..*fitting
        };
        let faces: Vec<InterfaceFace<D>> = (trimmed.interface_faces().par_iter())
            .map(|&side| trimmed.measure_face(mesh, side))
            .collect();
        let tips = trimmed.find_tips(mesh, &faces);
        let by_node: BTreeMap<u32, &SpikeTip<D>> = tips.iter().map(|tip| (tip.node, tip)).collect();
        let mut changes = Vec::new();
        for (c, &label) in regions.iter().enumerate() {
            let tip = (mesh.cell(c).iter())
                .filter_map(|n| by_node.get(n))
                .find(|tip| tip.spike_label == label);
            let Some(tip) = tip else { continue };
            let corners = mesh.cell(c).iter().map(|&n| mesh.nodes()[n as usize]);
            let middle = corners.fold([0.0; D], |sum, x| add_scaled(sum, 1.0 / (D + 1) as f64, x));
            if trimmed.labelled.label_at(middle) == label {
                continue;
            }
            let beside = &fitting.neighbors[(D + 1) * c..(D + 1) * (c + 1)];
            let parts = |&n: &u32| {
                let label = if n == NONE {
                    tip.surrounding_label
                } else {
                    regions[n as usize]
                };
                label != tip.surrounding_label && label != tip.spike_label
            };
            if !beside.iter().any(parts) {
                changes.push((c, tip.surrounding_label));
            }
        }
        if changes.is_empty() {
            break;
        }
        for (c, label) in changes {
            regions[c] = label;
        }
    }
    regions
}

/// Fits the interfaces of a mesh.
pub fn fit<const D: usize, M: Simplices<D>>(
    mesh: &mut M,
    fitting: &InterfaceFit<'_, D>,
    patience: &CancelToken<'_>,
) {
    let corners = mesh.connectivity();
    let (start, slots) = sort_by_group(mesh.nodes().len(), corners.iter().map(|&n| n as usize));
    let around: Vec<u32> = slots.iter().map(|slot| slot / (D as u32 + 1)).collect();
    let star = |n: u32| &around[start[n as usize] as usize..start[n as usize + 1] as usize];
    let sides = fitting.interface_faces();
    let count = fitting.labelled.labels.len();
    let step = fitting.labelled.min_step();
    let mut gives: BTreeMap<[u32; 2], f64> = BTreeMap::new();
    for sweep in 0..MAX_SWEEPS {
        if patience.is_cancelled() {
            return;
        }
        let faces: Vec<InterfaceFace<D>> = (sides.par_iter())
            .map(|&side| fitting.measure_face(&*mesh, side))
            .collect();
        if sweep >= FIRST_BALANCED_SWEEP {
            let had = region_volumes(&*mesh, fitting.regions, count);
            let lacking: Vec<f64> = (fitting.labelled.volumes.iter().zip(&had))
                .map(|(wanted, had)| if *had > 0.0 { wanted - had } else { 0.0 })
                .collect();
            let mut areas: BTreeMap<[u32; 2], f64> = BTreeMap::new();
            for face in &faces {
                *areas.entry(face.regions).or_default() += face.area;
            }
            let areas: Vec<_> = areas.into_iter().collect();
            let pressure = balance::pressures(&lacking, &areas);
            for (pair, _) in areas {
                let by = pressure[pair[0] as usize] - pressure[pair[1] as usize];
                let give = gives.entry(pair).or_default();
                *give = (*give + by).clamp(-MAX_BALANCE_SHIFT * step, MAX_BALANCE_SHIFT * step);
            }
        }
        let tips = fitting.find_tips(&*mesh, &faces);
        let give = |pair| gives.get(&pair).copied().unwrap_or(0.0);
        let mut pulls: BTreeMap<u32, MoveEquations<D>> = BTreeMap::new();
        for face in &faces {
            for (&n, &(off, sure)) in face.nodes.iter().zip(&face.offsets) {
                let pull = pulls.entry(n).or_default();
                pull.add(face.normal, off + give(face.regions), sure * face.area);
            }
        }
        for SpikeTip {
            node,
            direction: along,
            distance: off,
            ..
        } in tips
        {
            let pull = pulls.entry(node).or_default();
            let weight = (0..D).map(|i| pull.matrix[i][i]).sum::<f64>();
            *pull = MoveEquations::default();
            pull.add(along, off, weight.max(1.0));
        }
        for (&n, pull) in &pulls {
            if let Some(by) = fitting.allowed_move(&*mesh, n, pull) {
                fitting.try_move(mesh, n, by, star(n));
            }
        }
    }
}

impl<const D: usize> InterfaceFit<'_, D> {
    /// Returns the faces between regions, each as a cell, of the smaller number, and the face's number in it.
    fn interface_faces(&self) -> Vec<(u32, u32)> {
        (0..self.regions.len() as u32)
            .flat_map(|c| (0..=D as u32).map(move |k| (c, k)))
            .filter(|&(c, k)| {
                let beyond = self.neighbors[(D + 1) * c as usize + k as usize];
                beyond != NONE && self.regions[c as usize] < self.regions[beyond as usize]
            })
            .collect()
    }

    /// What a face between regions is, and how far off.
    fn measure_face<M: Simplices<D>>(&self, mesh: &M, (c, k): (u32, u32)) -> InterfaceFace<D> {
        let (c, k) = (c as usize, k as usize);
        let nodes = mesh.face(c, k);
        let x = nodes.map(|n| mesh.nodes()[n as usize]);
        let apex = mesh.nodes()[mesh.cell(c)[k] as usize];
        let mut across = normal(&x);
        if dot(across, sub(apex, x[0])) > 0.0 {
            across = across.map(|a| -a);
        }
        let area = norm(across);
        let across = across.map(|a| a / area.max(f64::MIN_POSITIVE));
        let beyond = self.neighbors[(D + 1) * c + k];
        let pair = [c, beyond as usize].map(|c| self.regions[c]);
        let step = self.labelled.min_step();
        let mut sums = [(0.0, 0.0, 0.0); D];
        for weights in quadrature::<D>() {
            let mut at = [0.0; D];
            for (weight, corner) in weights.iter().zip(&x) {
                at = add_scaled(at, *weight, *corner);
            }
            let off = self
                .labelled
                .interface_distance(at, across, pair, SEARCH_RADIUS * step);
            for (sum, weight) in sums.iter_mut().zip(weights) {
                sum.2 += weight;
                if let Some(off) = off {
                    sum.0 += weight * off;
                    sum.1 += weight;
                }
            }
        }
        InterfaceFace {
            nodes,
            regions: pair,
            normal: across,
            area,
            offsets: sums.map(|(off, sure, all)| (off / f64::max(sure, 1e-12), sure / all)),
        }
    }

    /// The nodes of faces that are the tips of spikes: a label on one side of a face is not within a sample of them.
    /// The sides of a spike do not see the interface, so that nothing else pulls its tip back; with each comes the
    /// direction of the nearest place on the interface, and how far that is.
    fn find_tips<M: Simplices<D>>(&self, mesh: &M, faces: &[InterfaceFace<D>]) -> Vec<SpikeTip<D>> {
        let step = self.labelled.min_step();
        let directions = directions::<D>();
        let mut ends: Vec<(u32, [u32; 2])> = (faces.iter())
            .flat_map(|face| face.nodes.map(|n| (n, face.regions)))
            .collect();
        ends.par_sort_unstable();
        ends.dedup();
        let tip = |&(n, pair): &(u32, [u32; 2])| {
            let x = mesh.nodes()[n as usize];
            let mut seen = pair.map(|label| label == self.labelled.label_at(x));
            for part in [0.5, 1.0] {
                for along in &directions {
                    let label = self.labelled.label_at(add_scaled(x, part * step, *along));
                    seen = [seen[0] || label == pair[0], seen[1] || label == pair[1]];
                }
                if seen == [true; 2] {
                    return None;
                }
            }
            let crossings = directions.iter().filter_map(|along| {
                let off =
                    self.labelled
                        .interface_distance(x, *along, pair, MAX_TIP_DISTANCE * step)?;
                Some((*along, off))
            });
            let nearest = crossings.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
            let (around, spike) = match seen {
                [_, true] => (pair[1], pair[0]),
                _ => (pair[0], pair[1]),
            };
            Some(SpikeTip {
                node: n,
                direction: nearest.0,
                distance: nearest.1,
                surrounding_label: around,
                spike_label: spike,
            })
        };
        let mut tips: Vec<_> = ends.par_iter().filter_map(tip).collect();
        // The first interface of a node decides.
        tips.dedup_by_key(|tip| tip.node);
        tips
    }

    /// Where a node is pulled to, as far as the sides of the box let it.
    fn allowed_move<M: Simplices<D>>(
        &self,
        mesh: &M,
        n: u32,
        pull: &MoveEquations<D>,
    ) -> Option<[f64; D]> {
        let kind = self.kinds[n as usize];
        if matches!(kind, AtomKind::Corner | AtomKind::Fixed) {
            return None;
        }
        let x = mesh.nodes()[n as usize];
        let held = std::array::from_fn(|k| x[k] <= 0.0 || x[k] >= self.extent[k]);
        pull.solve(held)
    }

    /// Moves a node by as much as the angles round it allow.
    fn try_move<M: Simplices<D>>(&self, mesh: &mut M, n: u32, by: [f64; D], star: &[u32]) {
        let x = mesh.nodes()[n as usize];
        let mut shortest = f64::INFINITY;
        for &c in star {
            for &m in mesh.cell(c as usize) {
                if m != n {
                    shortest = shortest.min(norm(sub(mesh.nodes()[m as usize], x)));
                }
            }
        }
        let length = norm(by);
        if length < 1e-6 * shortest {
            return;
        }
        let scale = (MAX_MOVE_RATIO * shortest / length).min(1.0);
        let mut enough = self.worst_angle(mesh, star).min(self.min_angle);
        if length > MIN_SPIKE_LENGTH * self.labelled.min_step() {
            enough = enough.min(MIN_SPIKE_ANGLE);
        }
        for part in STEP_FRACTIONS {
            let mut there = add_scaled(x, scale * part, by);
            for k in 0..D {
                there[k] = there[k].clamp(0.0, self.extent[k]);
            }
            mesh.parts_mut().0[n as usize] = there;
            if self.worst_angle(mesh, star) >= enough {
                return;
            }
        }
        mesh.parts_mut().0[n as usize] = x;
    }

    /// The angle nearest to 0 or 180 degrees among some cells, as the difference; negative where one is
    /// turned inside out.
    fn worst_angle<M: Simplices<D>>(&self, mesh: &M, star: &[u32]) -> f64 {
        let angle = |&c: &u32| {
            if mesh.volume(c as usize) <= 0.0 {
                return -1.0;
            }
            let cosines = mesh.shape(c as usize).cosines;
            let most = cosines
                .as_ref()
                .iter()
                .fold(0.0, |most, c| c.abs().max(most));
            most.acos().to_degrees()
        };
        star.iter().map(angle).fold(180.0, f64::min)
    }
}

/// What faces say of where a node should be.
#[derive(Debug, Clone, Copy)]
struct MoveEquations<const D: usize> {
    matrix: [[f64; D]; D],
    rhs: [f64; D],
}

impl<const D: usize> Default for MoveEquations<D> {
    fn default() -> Self {
        Self {
            matrix: [[0.0; D]; D],
            rhs: [0.0; D],
        }
    }
}

impl<const D: usize> MoveEquations<D> {
    /// It should be `off` along a normal.
    fn add(&mut self, along: [f64; D], off: f64, weight: f64) {
        for i in 0..D {
            for j in 0..D {
                self.matrix[i][j] += weight * along[i] * along[j];
            }
            self.rhs[i] += weight * along[i] * off;
        }
    }

    /// The move that does most of this along the axes that are not held.
    fn solve(mut self, held: [bool; D]) -> Option<[f64; D]> {
        let trace: f64 = (0..D).map(|i| self.matrix[i][i]).sum();
        if trace <= 0.0 {
            return None;
        }
        for i in 0..D {
            self.matrix[i][i] += DAMPING * trace;
            if held[i] {
                for j in 0..D {
                    self.matrix[i][j] = 0.0;
                    self.matrix[j][i] = 0.0;
                }
                self.matrix[i][i] = 1.0;
                self.rhs[i] = 0.0;
            }
        }
        // Positive definite: no pivots are needed.
        let (mut a, mut b) = (self.matrix, self.rhs);
        for i in 0..D {
            for j in i + 1..D {
                let share = a[j][i] / a[i][i];
                for k in i..D {
                    a[j][k] -= share * a[i][k];
                }
                b[j] -= share * b[i];
            }
        }
        for i in (0..D).rev() {
            for j in i + 1..D {
                b[i] -= a[i][j] * b[j];
            }
            b[i] /= a[i][i];
        }
        b.iter().all(|c| c.is_finite()).then_some(b)
    }
}

/// Places on a face, evenly spread, as weights of its nodes.
fn quadrature<const D: usize>() -> impl Iterator<Item = [f64; D]> {
    let parts = if D == 2 { 6 } else { 4 };
    let n = parts as f64;
    let in_edge = (0..if D == 2 { parts } else { 0 }).map(move |i| {
        let t = (i as f64 + 0.5) / n;
        std::array::from_fn(|k| if k == 0 { 1.0 - t } else { t })
    });
    let rows = 0..if D == 3 { parts } else { 0 };
    let in_triangle = rows.flat_map(move |i| {
        (0..parts - i).flat_map(move |j| {
            // The triangle that stands on its base, and the one beside it that hangs.
            [1.0 / 3.0, 2.0 / 3.0]
                .into_iter()
                .filter_map(move |inside| {
                    let [u, v] = [i, j].map(|c| (c as f64 + inside) / n);
                    let rest = 1.0 - u - v;
                    (rest > 0.0).then(|| std::array::from_fn(|k| [u, v, rest][k]))
                })
        })
    });
    in_edge.chain(in_triangle)
}
