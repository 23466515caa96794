//! What two-point fluxes miss where cells do not have the shape of the rock's permeability, and the metric in
//! which cells would have it.

use super::cells::CellFlow;
use super::rock::{FaultLaw, Rock, Tensor};
use crate::Result;
use crate::geometry::{add_scaled, dot, norm};
use crate::mesh::graph::Graph;
use crate::progress::CancelToken;

/// Errors of the rate along an axis that are smaller are not worth a word.
const MIN_NOTED_ERROR: f64 = 0.05;

/// What two-point fluxes make of flow along each axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisRatios<const D: usize> {
    /// The rate between two opposite sides of the box, over the right one, for each of the image's axes;
    /// `None` where the box has no such sides.
    pub ratio: [Option<f64>; D],
    /// The scales of `--metric` that give cells the shape of the rock, with as many cells as there are.
    pub metric: [f64; D],
}

impl<const D: usize> AxisRatios<D> {
    /// Flow through rock that is alike everywhere, with the mean permeability of `rock`, in the cells of
    /// `graph`. `axes` are the vectors from sample to sample, and `step` is the metric that the cells were made
    /// with.
    ///
    /// # Errors
    /// Those of [`CellFlow`], and [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
    pub fn new(
        graph: &Graph<D>,
        rock: &Rock,
        axes: &[[f64; D]; D],
        step: [f64; D],
        patience: &CancelToken<'_>,
    ) -> Result<Self> {
        let tensor = mean(graph, rock);
        let uniform = Rock::uniform(tensor, 1.0);
        let flow = CellFlow::new(graph, &uniform, FaultLaw::OPEN)?;
        let mut ratio = [None; D];
        for (axis, ratio) in ratio.iter_mut().enumerate() {
            let sides = [2 * axis as u8, 2 * axis as u8 + 1];
            let [Some(low), Some(high)] = sides.map(|side| BoxSide::from_graph(graph, side)) else {
                continue;
            };
            let length = dot(high.normal, high.middle) - dot(high.normal, low.middle);
            let right = high.area * tensor.normal_component(high.normal) / length;
            let given = [(sides[0], 1.0), (sides[1], 0.0)];
            let cells = graph.volume.len();
            let found = flow.solve_cancellable(&vec![0.0; cells], &given, patience)?;
            *ratio = Some(found.inflow[cells] / right);
        }
        Ok(Self {
            ratio,
            metric: metric(&tensor, axes, step),
        })
    }

    /// What to say of it, if rates are wrong by more than a little.
    pub fn note(&self) -> Option<String> {
        let wrong =
            |ratio: &Option<f64>| ratio.is_some_and(|ratio| (ratio - 1.0).abs() > MIN_NOTED_ERROR);
        if !self.ratio.iter().any(wrong) {
            return None;
        }
        let names = ["x", "y", "z"];
        let each = (names.iter().zip(self.ratio)).filter_map(|(axis, ratio)| {
            ratio.map(|ratio| format!("{ratio:.2} times the right one along {axis}"))
        });
        let scales = self.metric.map(|scale| format!("{scale:.3}"));
        Some(format!(
            "cells do not have the shape of the permeability: the flow that two-point fluxes give is {} (the image's axes); mesh with --metric {}",
            each.collect::<Vec<_>>().join(", "),
            scales.join(",")
        ))
    }
}

/// One side of the box.
struct BoxSide<const D: usize> {
    normal: [f64; D],
    middle: [f64; D],
    area: f64,
}

impl<const D: usize> BoxSide<D> {
    fn from_graph(graph: &Graph<D>, side: u8) -> Option<Self> {
        let (mut normal, mut middle, mut area) = ([0.0; D], [0.0; D], 0.0);
        for face in graph.boundary.iter().filter(|face| face.side == Some(side)) {
            normal = add_scaled(normal, face.area, face.normal);
            middle = add_scaled(middle, face.area, face.point);
            area += face.area;
        }
        (area > 0.0).then(|| {
            let length = norm(normal);
            Self {
                normal: normal.map(|n| n / length),
                middle: middle.map(|x| x / area),
                area,
            }
        })
    }
}

/// The mean permeability, geometric along each coordinate; rock that conducts nothing does not count.
fn mean<const D: usize>(graph: &Graph<D>, rock: &Rock) -> Tensor {
    let (mut sums, mut volume) = ([0.0; 3], 0.0);
    for (cell, &own) in graph.volume.iter().enumerate() {
        let k = rock.mobility(cell).0;
        if (0..3).all(|axis| k[axis] > 0.0) {
            (0..3).for_each(|axis| sums[axis] += own * k[axis].ln());
            volume += own;
        }
    }
    let [x, y, z] = sums.map(|sum| (sum / volume.max(f64::MIN_POSITIVE)).exp());
    Tensor([x, y, z, 0.0, 0.0, 0.0])
}

/// Lengths of samples over the root of the permeability along them, with the same product as `step` has.
fn metric<const D: usize>(tensor: &Tensor, axes: &[[f64; D]; D], step: [f64; D]) -> [f64; D] {
    let scales = axes.map(|axis| {
        let length = norm(axis);
        length / tensor.normal_component(axis.map(|x| x / length)).sqrt()
    });
    let all = |scales: [f64; D]| scales.iter().product::<f64>();
    let factor = (all(step) / all(scales)).powf(1.0 / D as f64);
    scales.map(|scale| factor * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn cells_of_the_rocks_shape_are_right_and_say_nothing() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.assign_sides([0.0; 3], [2.0, 1.0, 1.0]);
        let graph = Graph::from_poly(&mesh);
        let rock = Rock::uniform(Tensor::from_numbers(&[4.0, 4.0, 1.0]).unwrap(), 1.0);
        let axes = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]];
        let found = AxisRatios::new(&graph, &rock, &axes, [1.0; 3], &CancelToken::never()).unwrap();
        for ratio in found.ratio {
            assert!((ratio.unwrap() - 1.0).abs() < 1e-9, "{ratio:?}");
        }
        assert_eq!(found.note(), None);
        // Samples twice as wide as high, in rock that conducts half as far upwards.
        assert!(found.metric.iter().all(|scale| (scale - 1.0).abs() < 1e-12));
        let wrong = AxisRatios {
            ratio: [Some(1.0), None, Some(3.3)],
            metric: [0.5, 1.0, 2.0],
        };
        let note = wrong.note().unwrap();
        assert!(
            note.contains("1.00 times the right one along x, 3.30 times the right one along z")
        );
        assert!(note.ends_with("--metric 0.500,1.000,2.000"), "{note}");
    }
}
