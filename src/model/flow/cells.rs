//! Flow between cells by two-point fluxes: one pressure in each cell, and a rate between two cells
//! that is proportional to the difference of their pressures.
//!
//! Two-point fluxes are correct where the line between two sites is parallel to the permeability
//! times the normal of the common face: on Voronoi cells of isotropic rock, and on boxes whose axes
//! are those of the permeability. They are then exact for linear pressure. On tetrahedra they are
//! not even consistent; use [`ElementFlow`](super::ElementFlow) there.

use crate::parallel::prelude::*;

use super::barriers::Barriers;
use super::rock::{FaultLaw, Rock};
use super::sparse_matrix::{Matrix, sum};
use super::system::{Solution, solve};
use super::wells::PointWell;
use crate::error::cause;
use crate::geometry::{dot, solve_positive};
use crate::mesh::graph::{Connection, Graph, Locator};
use crate::progress::CancelToken;
use crate::{Error, Result};

/// The pressure system of a graph of cells, ready for any sources.
#[derive(Debug, Clone)]
pub struct CellFlow<'a, const D: usize> {
    /// Rate through each connection of the graph per pressure difference. It includes the
    /// resistance of the fault on the connection.
    pub transmissibility: Vec<f64>,
    /// Rate through each boundary face per difference between the pressures of the face and of its
    /// cell.
    pub boundary_transmissibility: Vec<f64>,
    /// Mean angle in degrees, weighted by area, between the line from site to site and the
    /// permeability times the face's normal. It is 0 where two-point fluxes are correct.
    pub angle_error: f64,
    graph: &'a Graph<D>,
}

/// Rates through all faces for a given pressure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellRates {
    /// Rate through each connection, from its first cell to its second.
    pub connections: Vec<f64>,
    /// Rate through each boundary face, outwards.
    pub boundary: Vec<f64>,
}

impl<'a, const D: usize> CellFlow<'a, D> {
    /// Computes the transmissibility of every connection: `1 / T = (d_1 / k_1 + d_2 / k_2 + r) /
    /// area`. Here d are the distances from the sites to the face, k the mobilities along the
    /// face's normal, and r is the resistance of the fault if the face lies on a feature.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if a face does not lie between its sites, so that the
    /// transmissibility would not be positive.
    pub fn new(graph: &'a Graph<D>, rock: &Rock, faults: FaultLaw) -> Result<Self> {
        let law = |c: &Connection<D>| (c.on_feature && !faults.is_open()).then_some(faults);
        Self::with_laws(graph, rock, law)
    }

    /// Computes the transmissibilities with the barriers in `barriers`, each with its own law,
    /// instead of one law for all features.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] in the same cases as [`new`](Self::new).
    pub fn with_barriers(graph: &'a Graph<D>, rock: &Rock, barriers: &Barriers) -> Result<Self> {
        let law = |c: &Connection<D>| {
            let label = barriers.label(c.face as usize);
            label.map(|label| barriers.law(label))
        };
        Self::with_laws(graph, rock, law)
    }

    fn with_laws(
        graph: &'a Graph<D>,
        rock: &Rock,
        law: impl Fn(&Connection<D>) -> Option<FaultLaw> + Sync,
    ) -> Result<Self> {
        let transmissibility_of = |c: &Connection<D>| {
            let mobility = c
                .cells
                .map(|cell| rock.mobility(cell as usize).normal_component(c.normal));
            let mut resistance = c.distance[0] / mobility[0] + c.distance[1] / mobility[1];
            if let Some(law) = law(c) {
                resistance += 1.0 / law.conductance(c.distance, mobility);
            }
            c.area / resistance
        };
        let transmissibility: Vec<f64> = graph
            .connections
            .par_iter()
            .map(transmissibility_of)
            .collect();
        let boundary_transmissibility: Vec<f64> = graph
            .boundary
            .par_iter()
            .map(|f| {
                let mobility = rock.mobility(f.cell as usize).normal_component(f.normal);
                f.area * mobility / f.distance
            })
            .collect();
        let is_invalid = |t: &f64| t.is_nan() || *t < 0.0 || *t == f64::INFINITY;
        let refuse = |place: String| {
            Error::Flow(cause(
                place,
                "lies on the wrong side of a cell's site, so that its transmissibility is negative",
                "make the cells again, with their sites inside",
            ))
        };
        if let Some(c) = transmissibility.iter().position(is_invalid) {
            let [a, b] = graph.connections[c].cells;
            return Err(refuse(format!("the face between cells {a} and {b}")));
        }
        if let Some(f) = boundary_transmissibility.iter().position(is_invalid) {
            let cell = graph.boundary[f].cell;
            return Err(refuse(format!("the boundary face of cell {cell}")));
        }
        Ok(Self {
            transmissibility,
            boundary_transmissibility,
            angle_error: angle_error(graph, rock),
            graph,
        })
    }

    /// Returns the steady pressure. `rates` is the rate at which fluid enters each cell; `sides`
    /// are pairs of a side of the box and its pressure. If no pressure is given, the mean pressure
    /// is zero. The unknowns of the solution are the cells, then the sides in the given order.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if rates do not balance where they must, or if a side has no faces.
    pub fn solve(&self, rates: &[f64], sides: &[(u8, f64)]) -> Result<Solution> {
        self.solve_cancellable(rates, sides, &CancelToken::never())
    }

    /// Returns the same as [`solve`](Self::solve), but checks `cancel` between iterations.
    ///
    /// # Errors
    /// Returns the errors of [`solve`](Self::solve), and [`Error::Interrupted`] once `cancel` is
    /// cancelled.
    pub fn solve_cancellable(
        &self,
        rates: &[f64],
        sides: &[(u8, f64)],
        cancel: &CancelToken<'_>,
    ) -> Result<Solution> {
        let (cells, n) = (rates.len(), rates.len() + sides.len());
        let mut couplings = Vec::new();
        let mut couple = |a: usize, b: usize, t: f64| {
            if t > 0.0 {
                couplings.extend([(a as u32, b as u32, t), (b as u32, a as u32, t)]);
            }
        };
        for (c, &t) in self.graph.connections.iter().zip(&self.transmissibility) {
            couple(c.cells[0] as usize, c.cells[1] as usize, t);
        }
        for (f, &t) in self
            .graph
            .boundary
            .iter()
            .zip(&self.boundary_transmissibility)
        {
            if let Some(index) = sides.iter().position(|s| Some(s.0) == f.side) {
                couple(f.cell as usize, cells + index, t);
            }
        }
        couplings.par_sort_by_key(|c| c.0);
        let mut start = vec![0; n + 1];
        couplings.iter().for_each(|c| start[c.0 as usize + 1] += 1);
        for i in 0..n {
            start[i + 1] += start[i];
        }
        if let Some(empty_side) = (cells..n).find(|&i| start[i] == start[i + 1]) {
            return Err(Error::Flow(cause(
                format!("side {}", sides[empty_side - cells].0),
                "has no faces, so that no pressure can be given there",
                "give the pressure of a side of the box",
            )));
        }
        let matrix = Matrix::from_rows(n, n, |i, row| {
            let row_couplings = &couplings[start[i]..start[i + 1]];
            row.add(i as u32, row_couplings.iter().map(|c| c.2).sum());
            row_couplings.iter().for_each(|c| row.add(c.1, -c.2));
        });
        let fixed: Vec<(u32, f64)> = sides
            .iter()
            .zip(cells as u32..)
            .map(|(&(_, pressure), i)| (i, pressure))
            .collect();
        let mut all_rates = rates.to_vec();
        all_rates.resize(n, 0.0);
        let mut weights = self.graph.volume.clone();
        weights.resize(n, 0.0);
        solve(&matrix, &all_rates, &fixed, &weights, 0.0, cancel)
    }

    /// Returns the rate through every face. `sides` are those given to [`solve`](Self::solve).
    pub fn rates(&self, pressure: &[f64], sides: &[(u8, f64)]) -> CellRates {
        let connections = self.graph.connections.iter().zip(&self.transmissibility);
        let boundary = self
            .graph
            .boundary
            .iter()
            .zip(&self.boundary_transmissibility);
        CellRates {
            connections: connections
                .map(|(c, t)| t * (pressure[c.cells[0] as usize] - pressure[c.cells[1] as usize]))
                .collect(),
            boundary: boundary
                .map(|(f, t)| {
                    let side = sides.iter().find(|s| Some(s.0) == f.side);
                    side.map_or(0.0, |s| t * (pressure[f.cell as usize] - s.1))
                })
                .collect(),
        }
    }

    /// Returns the Darcy velocity of each cell: the constant vector whose fluxes through the cell's
    /// faces fit the computed rates best, in the least-squares sense weighted by area. It is exact
    /// where the velocity is constant.
    pub fn velocity(&self, rates: &CellRates) -> Vec<[f64; D]> {
        // Sums over the faces of each cell: area n n^T, and rate times n.
        let mut sums = vec![([[0.0; D]; D], [0.0; D]); self.graph.volume.len()];
        let mut add = |cell: u32, area: f64, n: [f64; D], rate: f64| {
            let (square, flux) = &mut sums[cell as usize];
            for i in 0..D {
                flux[i] += rate * n[i];
                for j in 0..D {
                    square[i][j] += area * n[i] * n[j];
                }
            }
        };
        for (c, &rate) in self.graph.connections.iter().zip(&rates.connections) {
            add(c.cells[0], c.area, c.normal, rate);
            add(c.cells[1], c.area, c.normal, rate);
        }
        for (f, &rate) in self.graph.boundary.iter().zip(&rates.boundary) {
            add(f.cell, f.area, f.normal, rate);
        }
        sums.into_iter()
            .map(|(square, flux)| solve_positive(square, flux))
            .collect()
    }

    /// Returns the rate of each cell due to the wells that lie in it.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the name of the well if a well lies outside the mesh.
    pub fn well_rates(&self, wells: &[PointWell<D>]) -> Result<Vec<f64>> {
        let mut rates = vec![0.0; self.graph.volume.len()];
        let locator = Locator::new(self.graph);
        for well in wells {
            well.check()?;
            let cell = locator.cell_at(well.position);
            let cell = cell.ok_or_else(|| well.outside_error(&self.graph.centroid))?;
            rates[cell] += well.rate;
        }
        Ok(rates)
    }
}

/// Returns the mean angle in degrees, weighted by area, between the lines from site to site and the
/// conormals (permeability times normal).
fn angle_error<const D: usize>(graph: &Graph<D>, rock: &Rock) -> f64 {
    let connections = &graph.connections;
    let angle = |i: usize| {
        let c = &connections[i];
        let [a, b] = c.cells.map(|cell| graph.site[cell as usize]);
        let line: [f64; D] = std::array::from_fn(|k| b[k] - a[k]);
        let conormal = rock.mobility(c.cells[0] as usize).times(c.normal);
        let along = dot(line, conormal) / dot(conormal, conormal);
        let across: [f64; D] = std::array::from_fn(|k| line[k] - along * conormal[k]);
        dot(across, across)
            .sqrt()
            .atan2(along * dot(conormal, conormal).sqrt())
    };
    let area = sum(connections.len(), |i| connections[i].area);
    let weighted = sum(connections.len(), |i| connections[i].area * angle(i));
    (weighted / area.max(f64::MIN_POSITIVE)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::grid_index::{index_at, strides};
    use crate::mesh::graph::BoundaryFace;
    use crate::model::flow::Tensor;

    /// Returns a grid of boxes whose edges grow in geometric progression along each axis. Faces
    /// after `fault` boxes along x lie on a feature.
    fn grid<const D: usize>(n: [usize; D], extent: [f64; D], fault: Option<usize>) -> Graph<D> {
        let edge = |k: usize, i: usize| {
            let q: f64 = 1.2;
            extent[k] * (q.powi(i as i32) - 1.0) / (q.powi(n[k] as i32) - 1.0)
        };
        let mut graph = Graph::default();
        let count: usize = n.iter().product();
        let strides = strides(n);
        for cell in 0..count {
            let index = index_at(n, cell);
            let size: [f64; D] = std::array::from_fn(|k| edge(k, index[k] + 1) - edge(k, index[k]));
            let volume: f64 = size.iter().product();
            let site: [f64; D] =
                std::array::from_fn(|k| 0.5 * (edge(k, index[k]) + edge(k, index[k] + 1)));
            graph.volume.push(volume);
            graph.site.push(site);
            graph.centroid.push(site);
            graph.region.push((index[0] >= n[0] / 2) as i32);
            for k in 0..D {
                let area = volume / size[k];
                for upper in [false, true] {
                    let mut normal = [0.0; D];
                    normal[k] = if upper { 1.0 } else { -1.0 };
                    let mut point = site;
                    point[k] += 0.5 * size[k] * normal[k];
                    if index[k] + 1 == n[k] && upper || index[k] == 0 && !upper {
                        graph.boundary.push(BoundaryFace {
                            cell: cell as u32,
                            side: Some(2 * k as u8 + upper as u8),
                            face: 0,
                            area,
                            distance: 0.5 * size[k],
                            point,
                            normal,
                        });
                    } else if upper {
                        let next = edge(k, index[k] + 2) - edge(k, index[k] + 1);
                        graph.connections.push(Connection {
                            cells: [cell as u32, (cell + strides[k]) as u32],
                            face: 0,
                            on_feature: k == 0 && fault == Some(index[0] + 1),
                            area,
                            distance: [0.5 * size[k], 0.5 * next],
                            point,
                            normal,
                        });
                    }
                }
            }
        }
        graph
    }

    fn linear_pressure_is_exact<const D: usize>() {
        let extent: [f64; D] = std::array::from_fn(|k| 4.0 + k as f64);
        let graph = grid::<D>(std::array::from_fn(|k| 6 + k), extent, None);
        let rock = Rock::uniform(Tensor::from_numbers(&[2.0, 30.0, 0.1]).unwrap(), 0.5);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::CLOSED).unwrap();
        assert!(flow.angle_error < 1e-9);
        for axis in 0..D {
            let sides = [(2 * axis as u8, 5.0), (2 * axis as u8 + 1, 1.0)];
            let solution = flow.solve(&vec![0.0; graph.volume.len()], &sides).unwrap();
            for (p, x) in solution.pressure.iter().zip(&graph.site) {
                assert!((p - (5.0 - 4.0 * x[axis] / extent[axis])).abs() < 1e-10);
            }
            let rates = flow.rates(&solution.pressure, &sides);
            let u = [4.0, 60.0, 0.2][axis] * 4.0 / extent[axis];
            for velocity in flow.velocity(&rates) {
                for k in 0..D {
                    let expected = if k == axis { u } else { 0.0 };
                    assert!(
                        (velocity[k] - expected).abs() < 1e-9 * (1.0 + u),
                        "{velocity:?}"
                    );
                }
            }
            let area: f64 = extent.iter().product::<f64>() / extent[axis];
            assert!((solution.stats.throughput / (u * area) - 1.0).abs() < 1e-10);
            assert!(solution.stats.total_imbalance < 1e-10 && solution.stats.max_imbalance < 1e-10);
        }
    }

    #[test]
    fn linear_pressure_is_exact_on_boxes_in_two_and_three_dimensions() {
        linear_pressure_is_exact::<2>();
        linear_pressure_is_exact::<3>();
    }

    #[test]
    fn regions_and_a_fault_in_series() {
        let graph = grid([8, 3, 2], [4.0, 1.0, 1.0], Some(4));
        let (normal, k, w, m) = (graph.connections[0].normal, [2.0, 0.5], 0.01, 1e-3);
        assert_eq!(normal, [1.0, 0.0, 0.0]);
        let kinds = [(0, Tensor::isotropic(k[0])), (1, Tensor::isotropic(k[1]))];
        let rock = Rock::by_region(&graph.region, &kinds, 1.0).unwrap();
        let faults = FaultLaw::new(m, Some(w)).unwrap();
        let flow = CellFlow::new(&graph, &rock, faults).unwrap();
        let middle = graph
            .connections
            .iter()
            .find(|c| c.on_feature)
            .unwrap()
            .point[0];
        let layer = 0.5 * w * (1.0 / k[0] + 1.0 / k[1]) * (1.0 / m - 1.0);
        let resistance = middle / k[0] + (4.0 - middle) / k[1] + layer;
        let solution = flow
            .solve(&vec![0.0; graph.volume.len()], &[(0, 1.0), (1, 0.0)])
            .unwrap();
        assert!((solution.stats.throughput * resistance - 1.0).abs() < 1e-10);
        let closed = CellFlow::new(&graph, &rock, FaultLaw::CLOSED).unwrap();
        let solution = closed
            .solve(&vec![0.0; graph.volume.len()], &[(0, 1.0), (1, 0.0)])
            .unwrap();
        assert_eq!(solution.stats.compartments, 2);
        for (p, region) in solution.pressure.iter().zip(&graph.region) {
            assert!((p - f64::from(1 - region)).abs() < 1e-10);
        }
    }

    #[test]
    fn wells_go_to_the_cells_that_contain_them_and_balance() {
        let graph = grid([9, 8, 7], [4.0, 5.0, 6.0], None);
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
        let well = |position: [f64; 3], rate| PointWell {
            name: "--source".into(),
            position,
            rate,
        };
        let site = graph.site[137];
        let shifted = site.map(|x| x + 0.01);
        let rates = flow
            .well_rates(&[well(shifted, 3.0), well(graph.site[300], -3.0)])
            .unwrap();
        assert_eq!((rates[137], rates[300]), (3.0, -3.0));
        let solution = flow.solve(&rates, &[]).unwrap();
        assert!(solution.stats.max_imbalance < 1e-10 && solution.stats.total_imbalance < 1e-10);
        let cell_rates = flow.rates(&solution.pressure, &[]);
        let mut outflow = vec![0.0; rates.len()];
        for (c, rate) in graph.connections.iter().zip(&cell_rates.connections) {
            outflow[c.cells[0] as usize] += rate;
            outflow[c.cells[1] as usize] -= rate;
        }
        assert!(
            outflow
                .iter()
                .zip(&rates)
                .all(|(outflow, rate)| (outflow - rate).abs() < 1e-9)
        );
        for position in [[-0.1, 1.0, 1.0], [1.0, 5.1, 1.0]] {
            let error = flow
                .well_rates(&[well(position, 1.0)])
                .unwrap_err()
                .to_string();
            assert!(
                error.starts_with("--source: ") && error.contains("outside"),
                "{error}"
            );
        }
        assert!(
            flow.solve(&flow.well_rates(&[well(site, 1.0)]).unwrap(), &[])
                .is_err()
        );
        assert!(flow.solve(&rates, &[(9, 1.0)]).is_err());
    }
}
