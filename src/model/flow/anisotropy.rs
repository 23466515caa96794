//! Measures the error of two-point fluxes where the shape of the cells does not match the
//! anisotropy of the permeability, and computes the metric in which it would match.

use super::cells::CellFlow;
use super::rock::{FaultLaw, Rock, Tensor};
use crate::Result;
use crate::geometry::{add_scaled, dot, norm};
use crate::mesh::graph::Graph;
use crate::progress::CancelToken;

/// Smallest relative error of the rate along an axis that gets a note.
const MIN_NOTED_ERROR: f64 = 0.05;

/// Errors of two-point fluxes for flow along each axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisRatios<const D: usize> {
    /// Computed rate over exact rate between two opposite sides of the box, for each of the image's
    /// axes. `None` where the box has no such sides.
    pub ratio: [Option<f64>; D],
    /// The values of `--metric` that match the cells to the rock's anisotropy and keep the number
    /// of cells.
    pub metric: [f64; D],
}

impl<const D: usize> AxisRatios<D> {
    /// Computes the flow along each axis through uniform rock with the mean permeability of `rock`,
    /// in the cells of `graph`. `axes` are the vectors from sample to sample, and `step` is the
    /// metric with which the cells were made.
    ///
    /// # Errors
    /// Returns the errors of [`CellFlow`], and [`Error::Interrupted`](crate::Error::Interrupted)
    /// once `cancel` is cancelled.
    pub fn new(
        graph: &Graph<D>,
        rock: &Rock,
        axes: &[[f64; D]; D],
        step: [f64; D],
        cancel: &CancelToken<'_>,
    ) -> Result<Self> {
        let tensor = mean_permeability(graph, rock);
        let uniform = Rock::uniform(tensor, 1.0);
        let flow = CellFlow::new(graph, &uniform, FaultLaw::OPEN)?;
        let mut ratio = [None; D];
        for (axis, ratio) in ratio.iter_mut().enumerate() {
            let sides = [2 * axis as u8, 2 * axis as u8 + 1];
            let [Some(low), Some(high)] = sides.map(|side| BoxSide::from_graph(graph, side)) else {
                continue;
            };
            let length = dot(high.normal, high.middle) - dot(high.normal, low.middle);
            let expected_rate = high.area * tensor.normal_component(high.normal) / length;
            let side_pressures = [(sides[0], 1.0), (sides[1], 0.0)];
            let cells = graph.volume.len();
            let solution = flow.solve_cancellable(&vec![0.0; cells], &side_pressures, cancel)?;
            *ratio = Some(solution.inflow[cells] / expected_rate);
        }
        Ok(Self {
            ratio,
            metric: matching_metric(&tensor, axes, step),
        })
    }

    /// Returns a note for the user if the rate along any axis has an error above 5 %.
    pub fn note(&self) -> Option<String> {
        let is_wrong =
            |ratio: &Option<f64>| ratio.is_some_and(|ratio| (ratio - 1.0).abs() > MIN_NOTED_ERROR);
        if !self.ratio.iter().any(is_wrong) {
            return None;
        }
        let names = ["x", "y", "z"];
        let phrases = (names.iter().zip(self.ratio)).filter_map(|(axis, ratio)| {
            ratio.map(|ratio| format!("{ratio:.2} times the right one along {axis}"))
        });
        let scales = self.metric.map(|scale| format!("{scale:.3}"));
        Some(format!(
            "the cells do not match the anisotropy of the permeability: the flow that two-point fluxes give is {} (the image's axes); mesh with --metric {}",
            phrases.collect::<Vec<_>>().join(", "),
            scales.join(",")
        ))
    }
}

/// Area, mean normal and centre of one side of the box.
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

/// Returns the mean permeability: the geometric mean along each coordinate, weighted by volume.
/// Cells with zero permeability do not count.
fn mean_permeability<const D: usize>(graph: &Graph<D>, rock: &Rock) -> Tensor {
    let (mut sums, mut volume) = ([0.0; 3], 0.0);
    for (cell, &cell_volume) in graph.volume.iter().enumerate() {
        let k = rock.mobility(cell).0;
        if (0..3).all(|axis| k[axis] > 0.0) {
            (0..3).for_each(|axis| sums[axis] += cell_volume * k[axis].ln());
            volume += cell_volume;
        }
    }
    let [x, y, z] = sums.map(|sum| (sum / volume.max(f64::MIN_POSITIVE)).exp());
    Tensor([x, y, z, 0.0, 0.0, 0.0])
}

/// Returns a scale for each axis that is proportional to the sample length over the square root of
/// the permeability along the axis. Its product is that of `step`.
fn matching_metric<const D: usize>(
    tensor: &Tensor,
    axes: &[[f64; D]; D],
    step: [f64; D],
) -> [f64; D] {
    let scales = axes.map(|axis| {
        let length = norm(axis);
        length / tensor.normal_component(axis.map(|x| x / length)).sqrt()
    });
    let product = |scales: [f64; D]| scales.iter().product::<f64>();
    let factor = (product(step) / product(scales)).powf(1.0 / D as f64);
    scales.map(|scale| factor * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn cells_that_match_the_anisotropy_are_exact_and_get_no_note() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.assign_sides([0.0; 3], [2.0, 1.0, 1.0]);
        let graph = Graph::from_poly(&mesh);
        let rock = Rock::uniform(Tensor::from_numbers(&[4.0, 4.0, 1.0]).unwrap(), 1.0);
        let axes = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]];
        let ratios =
            AxisRatios::new(&graph, &rock, &axes, [1.0; 3], &CancelToken::never()).unwrap();
        for ratio in ratios.ratio {
            assert!((ratio.unwrap() - 1.0).abs() < 1e-9, "{ratio:?}");
        }
        assert_eq!(ratios.note(), None);
        // Samples are twice as wide as high, and the vertical permeability is a quarter of the
        // horizontal one.
        assert!(
            ratios
                .metric
                .iter()
                .all(|scale| (scale - 1.0).abs() < 1e-12)
        );
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
