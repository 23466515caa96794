//! Moves the nodes between regions so that faces lie on the interfaces on average.
//!
//! If the nodes of faces lay on a curved interface, the faces would cut off its bulges, and regions
//! would be too small. Therefore the faces are fitted, and not the nodes. Sample points on each
//! face look for the interface along the normal of the face. A node moves to where the sum of the
//! squares of these distances, over the faces around it, is smallest. On a smooth interface this is
//! a move along the normal; on a line where three regions meet, all of their interfaces contribute.
//! Then all interfaces between the same two regions shift a little by the same distance, so that
//! every region has the volume of its samples.
//!
//! No move makes an angle worse that is outside of the target range, or moves an angle out of that
//! range. The exception is a long move, of a node far from its interface, such as the tip of a spike:
//! it may leave angles down to 20 degrees.

use std::collections::BTreeMap;

use crate::parallel::prelude::*;

use super::AnchoredNodes;
use super::assign::directions;
use super::parts::LabelParts;
use super::{balance, part_volumes};
use crate::feature::LabelMap;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, dot, norm, normal, sorted_distinct, sub, unit};
use crate::improve::node_moves::{MoveEquations, MovingNode, mean_offsets};
use crate::lattice::AtomKind;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Largest number of moves of each node.
const MAX_SWEEPS: usize = 14;
/// Largest number of times that cells of spikes change their label.
const MAX_TRIMS: usize = 4;
/// First sweep in which volumes are balanced.
const FIRST_BALANCED_SWEEP: usize = 2;
/// Largest distance, in samples, from a face at which its interface is searched.
const SEARCH_RADIUS: f64 = 3.0;
/// Largest shift of an interface for the volume balance, in samples.
const MAX_BALANCE_SHIFT: f64 = 0.35;
/// Smallest move, in samples, of a node that counts as far from its interface.
const MIN_SPIKE_LENGTH: f64 = 0.75;
/// Smallest angle, in degrees, that such a move may leave.
const MIN_SPIKE_ANGLE: f64 = 20.0;
/// Largest distance, in samples, of the tip of a spike from the interface to be pulled back to it.
const MAX_TIP_DISTANCE: f64 = 8.0;
/// Input of the fit of interfaces.
#[derive(Debug, Clone, Copy)]
pub struct InterfaceFit<'a, const D: usize> {
    /// Labels of the image.
    pub labelled: &'a LabelMap<D>,
    /// Label of each cell.
    pub regions: &'a [u32],
    /// Connected parts of the labels, which keep their volumes.
    pub parts: &'a LabelParts<D>,
    /// Part of each cell, or [`NONE`].
    pub cell_parts: &'a [u32],
    /// Adjacent cell for every cell and face, in order.
    pub neighbours: &'a [u32],
    /// Kind of each node.
    pub kinds: &'a [AtomKind],
    /// Nodes that stay on given surfaces, if there are any.
    pub anchors: Option<&'a AnchoredNodes>,
    /// Far corner of the box.
    pub extent: [f64; D],
    /// Target for the smallest angle, in degrees; the largest angle is 180 degrees less this.
    pub min_angle: f64,
}

/// A face between two regions.
struct InterfaceFace<const D: usize> {
    nodes: [u32; D],
    /// The two regions, the smaller label first. The normal points from the first into the second.
    regions: [u32; 2],
    /// The parts on its two sides, or [`NONE`].
    parts: [u32; 2],
    normal: [f64; D],
    area: f64,
    /// Distance of the interface for each node, and the confidence of it (share of the sample
    /// points that found the interface).
    offsets: [(f64, f64); D],
}

/// The tip of a spike: a node of an interface that is more than a sample away from one of the two
/// labels.
struct SpikeTip<const D: usize> {
    node: u32,
    /// Direction of the nearest point on the interface, and its distance.
    direction: [f64; D],
    distance: f64,
    /// Label around the tip, and label of the spike.
    surrounding_label: u32,
    spike_label: u32,
}

/// Returns the labels of the cells of a fitted mesh after the tips of spikes are cut off. Cells at a
/// tip take the label around it, unless their centroid has the spike's label or they have a face to
/// a third label.
pub fn remove_spikes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    fitting: &InterfaceFit<'_, D>,
) -> Vec<u32> {
    let mut regions = fitting.regions.to_vec();
    for _ in 0..MAX_TRIMS {
        let current = InterfaceFit {
            regions: &regions,
            ..*fitting
        };
        let faces: Vec<InterfaceFace<D>> = (current.interface_faces().par_iter())
            .map(|&cell_face| current.measure_face(mesh, cell_face))
            .collect();
        let tips = current.find_tips(mesh, &faces);
        let by_node: BTreeMap<u32, &SpikeTip<D>> = tips.iter().map(|tip| (tip.node, tip)).collect();
        let mut changes = Vec::new();
        for (c, &label) in regions.iter().enumerate() {
            let tip = (mesh.cell(c).iter())
                .filter_map(|n| by_node.get(n))
                .find(|tip| tip.spike_label == label);
            let Some(tip) = tip else { continue };
            let corners = mesh.cell(c).iter().map(|&n| mesh.nodes()[n as usize]);
            let middle = corners.fold([0.0; D], |sum, x| add_scaled(sum, 1.0 / (D + 1) as f64, x));
            if current.labelled.label_at(middle) == label {
                continue;
            }
            let adjacent = &fitting.neighbours[(D + 1) * c..(D + 1) * (c + 1)];
            let separates_third = |&n: &u32| {
                let label = if n == NONE {
                    tip.surrounding_label
                } else {
                    regions[n as usize]
                };
                label != tip.surrounding_label && label != tip.spike_label
            };
            if !adjacent.iter().any(separates_third) {
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

/// Fits the interfaces of a mesh by moving its nodes.
pub fn fit<const D: usize, M: Simplices<D>>(
    mesh: &mut M,
    fitting: &InterfaceFit<'_, D>,
    cancel: &CancelToken<'_>,
) {
    let corners = mesh.connectivity();
    let (start, slots) = sort_by_group(mesh.nodes().len(), corners.iter().map(|&n| n as usize));
    let star_cells: Vec<u32> = slots.iter().map(|slot| slot / (D as u32 + 1)).collect();
    let star = |n: u32| &star_cells[start[n as usize] as usize..start[n as usize + 1] as usize];
    let cell_faces = fitting.interface_faces();
    let nodes_of_face = |&(c, k): &(u32, u32)| mesh.face(c as usize, k as usize);
    let nodes = sorted_distinct(cell_faces.iter().flat_map(nodes_of_face));
    let mut index_of_node = vec![0; mesh.nodes().len()];
    for (i, &n) in nodes.iter().enumerate() {
        index_of_node[n as usize] = i;
    }
    let step = fitting.labelled.min_step();
    let mut shifts: BTreeMap<[u32; 2], f64> = BTreeMap::new();
    for sweep in 0..MAX_SWEEPS {
        if cancel.is_cancelled() {
            return;
        }
        let faces: Vec<InterfaceFace<D>> = (cell_faces.par_iter())
            .map(|&cell_face| fitting.measure_face(&*mesh, cell_face))
            .collect();
        if sweep >= FIRST_BALANCED_SWEEP {
            let volumes = part_volumes(&*mesh, fitting.cell_parts, fitting.parts.count());
            let deficits: Vec<f64> = (fitting.parts.volumes.iter().zip(&volumes))
                .map(|(target, volume)| if *volume > 0.0 { target - volume } else { 0.0 })
                .collect();
            let mut areas: BTreeMap<[u32; 2], f64> = BTreeMap::new();
            for face in faces.iter().filter(|face| !face.parts.contains(&NONE)) {
                *areas.entry(face.parts).or_default() += face.area;
            }
            let areas: Vec<_> = areas.into_iter().collect();
            let pressure = balance::pressures(&deficits, &areas);
            for (pair, _) in areas {
                let change = pressure[pair[0] as usize] - pressure[pair[1] as usize];
                let shift = shifts.entry(pair).or_default();
                *shift =
                    (*shift + change).clamp(-MAX_BALANCE_SHIFT * step, MAX_BALANCE_SHIFT * step);
            }
        }
        let tips = fitting.find_tips(&*mesh, &faces);
        let shift_of = |pair| shifts.get(&pair).copied().unwrap_or(0.0);
        let mut equations = vec![MoveEquations::<D>::default(); nodes.len()];
        for face in &faces {
            for (&n, &(offset, confidence)) in face.nodes.iter().zip(&face.offsets) {
                equations[index_of_node[n as usize]].add(
                    face.normal,
                    offset + shift_of(face.parts),
                    confidence * face.area,
                );
            }
        }
        for SpikeTip {
            node,
            direction,
            distance,
            ..
        } in tips
        {
            let equation = &mut equations[index_of_node[node as usize]];
            let weight = (0..D).map(|i| equation.matrix[i][i]).sum::<f64>();
            *equation = MoveEquations::default();
            equation.add(direction, distance, weight.max(1.0));
        }
        for (&n, equation) in nodes.iter().zip(&equations) {
            if let Some(displacement) = fitting.allowed_move(&*mesh, n, equation) {
                fitting.try_move(mesh, n, displacement, star(n));
            }
        }
    }
}

impl<const D: usize> InterfaceFit<'_, D> {
    /// Returns the faces between regions, each as the cell with the smaller label and the index of
    /// the face in that cell.
    fn interface_faces(&self) -> Vec<(u32, u32)> {
        let separates = |&(c, k): &(u32, u32)| {
            let neighbour = self.neighbours[(D + 1) * c as usize + k as usize];
            neighbour != NONE && self.regions[c as usize] < self.regions[neighbour as usize]
        };
        (0..self.regions.len() as u32)
            .into_par_iter()
            .flat_map_iter(|c| (0..=D as u32).map(move |k| (c, k)).filter(separates))
            .collect()
    }

    /// Measures a face between regions and its distance from the interface.
    fn measure_face<M: Simplices<D>>(&self, mesh: &M, (c, k): (u32, u32)) -> InterfaceFace<D> {
        let (c, k) = (c as usize, k as usize);
        let nodes = mesh.face(c, k);
        let x = nodes.map(|n| mesh.nodes()[n as usize]);
        let apex = mesh.nodes()[mesh.cell(c)[k] as usize];
        let mut normal = normal(&x);
        if dot(normal, sub(apex, x[0])) > 0.0 {
            normal = normal.map(|a| -a);
        }
        let area = norm(normal);
        let normal = unit(normal);
        let neighbour = self.neighbours[(D + 1) * c + k];
        let pair = [c, neighbour as usize].map(|c| self.regions[c]);
        let parts = [c, neighbour as usize].map(|c| self.cell_parts[c]);
        let step = self.labelled.min_step();
        InterfaceFace {
            nodes,
            regions: pair,
            parts,
            normal,
            area,
            offsets: mean_offsets(x, quadrature::<D>(), |point| {
                let reach = SEARCH_RADIUS * step;
                (self.labelled).interface_distance(point, normal, pair, reach)
            }),
        }
    }

    /// Returns the nodes of faces that are tips of spikes: one of the two labels of a face does not
    /// occur within a sample of them. The sides of a spike do not find the interface, so only the
    /// tip itself can be pulled back. Each tip has the direction and distance of the nearest point
    /// on the interface.
    fn find_tips<M: Simplices<D>>(&self, mesh: &M, faces: &[InterfaceFace<D>]) -> Vec<SpikeTip<D>> {
        let step = self.labelled.min_step();
        let directions = directions::<D>();
        let mut node_pairs: Vec<(u32, [u32; 2])> = (faces.iter())
            .flat_map(|face| face.nodes.map(|n| (n, face.regions)))
            .collect();
        node_pairs.par_sort_unstable();
        node_pairs.dedup();
        let find_tip = |&(n, pair): &(u32, [u32; 2])| {
            let x = mesh.nodes()[n as usize];
            let mut seen = pair.map(|label| label == self.labelled.label_at(x));
            for radius in [0.5, 1.0] {
                for direction in &directions {
                    let label = self
                        .labelled
                        .label_at(add_scaled(x, radius * step, *direction));
                    seen = [seen[0] || label == pair[0], seen[1] || label == pair[1]];
                }
                if seen == [true; 2] {
                    return None;
                }
            }
            let crossings = directions.iter().filter_map(|direction| {
                let distance = self.labelled.interface_distance(
                    x,
                    *direction,
                    pair,
                    MAX_TIP_DISTANCE * step,
                )?;
                Some((*direction, distance))
            });
            let nearest = crossings.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
            let (surrounding_label, spike_label) = match seen {
                [_, true] => (pair[1], pair[0]),
                _ => (pair[0], pair[1]),
            };
            Some(SpikeTip {
                node: n,
                direction: nearest.0,
                distance: nearest.1,
                surrounding_label,
                spike_label,
            })
        };
        let mut tips: Vec<_> = node_pairs.par_iter().filter_map(find_tip).collect();
        // A node takes its tip from the first of its interfaces.
        tips.dedup_by_key(|tip| tip.node);
        tips
    }

    /// Returns the move that solves the equations of a node, within the sides of the box; `None` if
    /// the node is fixed.
    fn allowed_move<M: Simplices<D>>(
        &self,
        mesh: &M,
        n: u32,
        equations: &MoveEquations<D>,
    ) -> Option<[f64; D]> {
        let kind = self.kinds[n as usize];
        if matches!(kind, AtomKind::Corner | AtomKind::Fixed) {
            return None;
        }
        let x = mesh.nodes()[n as usize];
        let is_fixed = std::array::from_fn(|k| x[k] <= 0.0 || x[k] >= self.extent[k]);
        let displacement = equations.solve(is_fixed)?;
        Some(match self.anchors {
            Some(anchors) => anchors.along_surfaces(n, x, displacement, is_fixed),
            None => displacement,
        })
    }

    /// Moves a node by the largest fraction of the displacement that the angles around it allow.
    fn try_move<M: Simplices<D>>(
        &self,
        mesh: &mut M,
        n: u32,
        displacement: [f64; D],
        star: &[u32],
    ) {
        let moving = MovingNode {
            node: n,
            star,
            extent: self.extent,
        };
        let (shortest, mut min_sine) = moving.limits(mesh, self.min_angle);
        let length = norm(displacement);
        if length < 1e-6 * shortest {
            return;
        }
        if length > MIN_SPIKE_LENGTH * self.labelled.min_step() {
            min_sine = min_sine.min(MIN_SPIKE_ANGLE.to_radians().sin());
        }
        moving.move_by(mesh, displacement, shortest, min_sine);
    }
}

/// Returns evenly distributed points on a face, as weights of its nodes.
fn quadrature<const D: usize>() -> impl Iterator<Item = [f64; D]> {
    let subdivisions = if D == 2 { 6 } else { 4 };
    let n = subdivisions as f64;
    let in_edge = (0..if D == 2 { subdivisions } else { 0 }).map(move |i| {
        let t = (i as f64 + 0.5) / n;
        std::array::from_fn(|k| if k == 0 { 1.0 - t } else { t })
    });
    let rows = 0..if D == 3 { subdivisions } else { 0 };
    let in_triangle = rows.flat_map(move |i| {
        (0..subdivisions - i).flat_map(move |j| {
            // Centroids of the small upright triangle and of the inverted one next to it.
            [1.0 / 3.0, 2.0 / 3.0]
                .into_iter()
                .filter_map(move |offset| {
                    let [u, v] = [i, j].map(|c| (c as f64 + offset) / n);
                    let rest = 1.0 - u - v;
                    (rest > 0.0).then(|| std::array::from_fn(|k| [u, v, rest][k]))
                })
        })
    });
    in_edge.chain(in_triangle)
}
