//! Computes rates through the faces of triangles or tetrahedra that are conserved in every cell.
//!
//! Finite elements conserve fluid on the control volumes around nodes, not in cells: the velocities
//! of two cells give different rates through their common face. Here each face gets the mean of the
//! two rates. Then a correction brings every cell into balance: it is the smallest one, weighted by
//! the conductances of the faces. Rates change by `w_f (phi_a - phi_b)`, and the potential phi
//! solves a two-point system on the cells (the correction of Odsaeter et al. 2017, Journal of
//! Computational Physics 330, section 3). Where pressure is linear, nothing changes.

use crate::parallel::prelude::*;

use super::elements::ElementFlow;
use super::shape_functions::{area_vector, centre_to_face, corners, gradients};
use super::sparse_matrix::{Matrix, sum};
use super::system::solve;
use super::wells::LocatedWell;
use crate::Result;
use crate::geometry::dot;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Rates through the faces of a mesh of simplices. Face k of cell c has the number (D + 1) c + k.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaceRates<const D: usize = 3> {
    /// Rate out of the cell through each of its faces. The two numbers of an inner face have
    /// exactly opposite rates.
    pub outflow: Vec<f64>,
    /// The cell on the other side of each face, also if the face lies on a fault; `NONE` on the
    /// boundary.
    pub neighbours: Vec<u32>,
}

/// Rate and weight of a face before the correction.
#[derive(Debug, Clone, Copy, Default)]
struct FaceFlux {
    rate: f64,
    weight: f64,
}

impl<const D: usize> FaceRates<D> {
    /// Number of cells.
    pub fn len(&self) -> usize {
        self.outflow.len() / (D + 1)
    }

    /// Returns `true` if there are no cells.
    pub fn is_empty(&self) -> bool {
        self.outflow.is_empty()
    }

    /// Returns the rates out of a cell through its faces, and the cells on the other sides of them.
    #[inline]
    pub fn faces_of(&self, cell: usize) -> (&[f64], &[u32]) {
        let range = cell * (D + 1)..(cell + 1) * (D + 1);
        (&self.outflow[range.clone()], &self.neighbours[range])
    }
}

impl<const D: usize, M: Simplices<D>> ElementFlow<D, M> {
    /// Computes rates through faces from the pressure that [`solve`](Self::solve) returned for
    /// these wells and fixed pressures. Fluid passes a boundary face only if all its nodes have
    /// fixed pressure.
    ///
    /// # Errors
    /// Returns [`Error::Flow`](crate::Error::Flow) if the correction cannot be computed, and
    /// [`Error::Interrupted`](crate::Error::Interrupted) once `cancel` is cancelled.
    pub fn face_rates(
        &self,
        pressure: &[f64],
        wells: &[LocatedWell],
        fixed: &[(u32, f64)],
        cancel: &CancelToken<'_>,
    ) -> Result<FaceRates<D>> {
        let count = self.split_mesh.mesh.len();
        let (faces, neighbours) = self.mean_fluxes(pressure, fixed);
        // Unknown number `count` stands for everything outside the boundary.
        let unknown_of = |n: u32| n.min(count as u32);
        let face_range = |c: usize| c * (D + 1)..(c + 1) * (D + 1);
        let is_open = |face: &usize| neighbours[*face] == NONE && faces[*face].weight > 0.0;
        let boundary: Vec<usize> = (0..faces.len()).filter(is_open).collect();
        let matrix = Matrix::from_rows(count + 1, count + 1, |c, row| {
            if c < count {
                for (face, &n) in faces[face_range(c)].iter().zip(&neighbours[face_range(c)]) {
                    if face.weight > 0.0 {
                        row.add(c as u32, face.weight);
                        row.add(unknown_of(n), -face.weight);
                    }
                }
                return;
            }
            // The outside is coupled to the cells at all open boundary faces, also to cells that
            // closed faults separate.
            for &face in &boundary {
                let weight = faces[face].weight;
                row.add(count as u32, weight);
                row.add((face / (D + 1)) as u32, -weight);
            }
        });
        let mut deficit: Vec<f64> = (0..count)
            .map(|c| -faces[face_range(c)].iter().map(|f| f.rate).sum::<f64>())
            .collect();
        deficit.push(0.0);
        wells
            .iter()
            .for_each(|well| deficit[well.cell as usize] += well.rate);
        let mut volume = vec![1.0; count];
        volume.push(0.0);
        let total_rate = sum(faces.len(), |face| faces[face].rate.abs());
        let fixed = [(count as u32, 0.0)];
        let phi = solve(&matrix, &deficit, &fixed, &volume, total_rate, cancel)?.pressure;
        let corrected = |face: usize| {
            let FaceFlux { rate, weight } = faces[face];
            rate + weight * (phi[face / (D + 1)] - phi[unknown_of(neighbours[face]) as usize])
        };
        Ok(FaceRates {
            outflow: (0..faces.len()).into_par_iter().map(corrected).collect(),
            neighbours,
        })
    }

    /// Returns the mean of the two rates through each face, and the neighbours of cells, those
    /// across faults included.
    fn mean_fluxes(&self, pressure: &[f64], fixed: &[(u32, f64)]) -> (Vec<FaceFlux>, Vec<u32>) {
        let mesh = &self.split_mesh.mesh;
        let face_index = |cell: u32, k: u8| cell as usize * (D + 1) + usize::from(k);
        // The split mesh comes from a checked mesh, so no face has three cells.
        let mut neighbours = mesh.neighbours().unwrap_or_default();
        let mut is_fixed = vec![false; mesh.nodes().len()];
        fixed.iter().for_each(|f| is_fixed[f.0 as usize] = true);

        let velocity = self.velocity(pressure);
        let mut faces: Vec<FaceFlux> = (0..neighbours.len())
            .into_par_iter()
            .map(|face| {
                let (c, n) = (face / (D + 1), neighbours[face]);
                let (rate, conductance) = self.face_flux(&velocity, face);
                if n == NONE {
                    let face_nodes = mesh.face(c, face % (D + 1));
                    let is_open = face_nodes.iter().all(|&i| is_fixed[i as usize]);
                    let weight = if is_open { conductance } else { 0.0 };
                    return FaceFlux {
                        rate: if is_open { rate } else { 0.0 },
                        weight,
                    };
                }
                if c > n as usize {
                    return FaceFlux::default();
                }
                let (opposite_rate, opposite_conductance) =
                    self.face_flux(&velocity, opposite_face_index::<D>(&neighbours, face));
                FaceFlux {
                    rate: 0.5 * (rate - opposite_rate),
                    weight: conductance * opposite_conductance
                        / (conductance + opposite_conductance),
                }
            })
            .collect();
        let fault_rates = self.fault_rates(pressure);
        let fault_faces = self.split_mesh.faces.iter().zip(&self.transmissibility);
        for ((face, weight), rate) in fault_faces.zip(fault_rates) {
            let [face_a, face_b] =
                [0, 1].map(|side| face_index(face.cells[side], face.local_faces[side]));
            neighbours[face_a] = face.cells[1];
            neighbours[face_b] = face.cells[0];
            faces[face_a] = FaceFlux {
                rate,
                weight: *weight,
            };
            faces[face_b] = FaceFlux::default();
        }
        for face in 0..neighbours.len() {
            let n = neighbours[face];
            if n != NONE && face / (D + 1) > n as usize {
                let FaceFlux { rate, weight } = faces[opposite_face_index::<D>(&neighbours, face)];
                faces[face] = FaceFlux {
                    rate: -rate,
                    weight,
                };
            }
        }
        (faces, neighbours)
    }

    /// Returns the rate out of a cell through a face by the cell's own velocity, and the
    /// conductance (rate per pressure difference) between the cell's centre and the face.
    fn face_flux(&self, velocity: &[[f64; D]], face: usize) -> (f64, f64) {
        let (c, k) = (face / (D + 1), face % (D + 1));
        let (g, size) = gradients(&corners(&self.split_mesh.mesh, c));
        let vector = area_vector(g[k]);
        let area = dot(vector, vector).sqrt();
        let normal = vector.map(|x| x / area);
        let conductance =
            area * self.mobility(c).normal_component(normal) / centre_to_face(g[k], size);
        (dot(velocity[c], vector), conductance)
    }
}

/// Returns the number that a face has in the cell on its other side.
fn opposite_face_index<const D: usize>(neighbours: &[u32], face: usize) -> usize {
    let base = neighbours[face] as usize * (D + 1);
    let cells_beyond = neighbours[base..=base + D].iter();
    base + cells_beyond
        .clone()
        .position(|&c| c as usize == face / (D + 1))
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::{faces_on, jittered_box};
    use crate::mesh::{TetMesh, TriMesh};
    use crate::model::flow::test_meshes::{faulted_box, flow_through};
    use crate::model::flow::{FaultLaw, PointWell, Rock, Tensor};

    fn check_cell_balance<const D: usize, M: Simplices<D>>() {
        let (mesh, bits) = faulted_box::<D, M>();
        let regions: Vec<i32> = (0..mesh.len()).map(|c| (c / 30 % 2) as i32).collect();
        let tensor = Tensor::from_numbers(&[3.0, 1.0, 0.1, 0.5, -0.1, 0.2]).unwrap();
        let rock =
            Rock::by_region(&regions, &[(0, tensor), (1, Tensor::isotropic(0.01))], 1.0).unwrap();
        for multiplier in [0.0, 0.01, 1.0] {
            let faults = FaultLaw::new(multiplier, None).unwrap();
            let flow = flow_through(&mesh, &bits, rock.clone(), faults);
            let well = |x: f64, rate| {
                let mut position = [1.1; D];
                position[0] = x;
                PointWell {
                    name: "well".into(),
                    position,
                    rate,
                }
            };
            let wells = flow.locate(&[well(0.4, 2.0), well(2.5, -1.5)]).unwrap();
            let side_nodes = flow.nodes_where(|i| mesh.nodes()[i][1] == 0.0);
            let fixed: Vec<(u32, f64)> = side_nodes.into_iter().map(|i| (i, 0.0)).collect();
            let solution = flow.solve(&flow.rates(&wells), &fixed).unwrap();
            let rates = flow
                .face_rates(&solution.pressure, &wells, &fixed, &CancelToken::never())
                .unwrap();
            let mut through_side = 0.0;
            for c in 0..mesh.len() {
                let cell_wells = wells.iter().filter(|w| w.cell as usize == c);
                let source: f64 = cell_wells.map(|w| w.rate).sum();
                let (outflow, neighbours) = rates.faces_of(c);
                let sum: f64 = outflow.iter().sum();
                assert!((sum - source).abs() < 2e-10, "{sum} {source}");
                for k in 0..=D {
                    let face = c * (D + 1) + k;
                    if neighbours[k] == NONE {
                        through_side += outflow[k];
                    } else {
                        let opposite = opposite_face_index::<D>(&rates.neighbours, face);
                        assert_eq!(outflow[k], -rates.outflow[opposite]);
                    }
                }
            }
            assert!((through_side - 0.5).abs() < 1e-9);
            let faces = flow.split_mesh.faces.iter().zip(&flow.transmissibility);
            for (face, _) in faces.filter(|(_, t)| **t == 0.0) {
                let (outflow, _) = rates.faces_of(face.cells[0] as usize);
                assert_eq!(outflow[usize::from(face.local_faces[0])], 0.0);
            }
        }
    }

    #[test]
    fn every_triangle_and_tetrahedron_is_in_balance() {
        check_cell_balance::<2, TriMesh>();
        check_cell_balance::<3, TetMesh>();
    }

    /// Checks two parts of a box that a closed fault separates. Both have flow from side to side,
    /// and between them is a pocket that no fluid enters.
    fn check_separate_compartments<const D: usize, M: Simplices<D>>() {
        let mut n = [2; D];
        n[0] = 6;
        let mut extent = [2.0; D];
        extent[0] = 6.0;
        let mesh: M = jittered_box(n, extent, 0.2, |x| x[0] != 2.0 && x[0] != 4.0);
        let bits = faces_on(&mesh, |x| x[0] == 2.0);
        let second_bits = faces_on(&mesh, |x| x[0] == 4.0);
        let bits: Vec<u8> = bits.iter().zip(second_bits).map(|(a, b)| a | b).collect();
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
        let nodes = flow.split_mesh.mesh.nodes();
        let is_fixed = |x: [f64; D]| (x[0] < 1.5 || x[0] > 4.5) && (x[1] == 0.0 || x[1] == 2.0);
        let fixed_nodes = (0u32..).zip(nodes).filter(|(_, x)| is_fixed(**x));
        let fixed: Vec<(u32, f64)> = fixed_nodes.map(|(i, x)| (i, 3.0 * x[1] * x[0])).collect();
        let solution = flow.solve(&vec![0.0; nodes.len()], &fixed).unwrap();
        assert_eq!(solution.stats.compartments, 3);
        let pocket_nodes = (0..nodes.len()).filter(|&i| solution.pressure[i] == 0.0);
        assert!(solution.stats.undetermined > 0);
        assert!(pocket_nodes.count() >= solution.stats.undetermined);
        let rates = flow
            .face_rates(&solution.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        for c in 0..rates.len() {
            let sum: f64 = rates.faces_of(c).0.iter().sum();
            assert!(sum.abs() < 1e-9, "{c}: {sum}");
        }
    }

    #[test]
    fn separate_compartments_and_pockets_are_in_balance() {
        check_separate_compartments::<2, TriMesh>();
        check_separate_compartments::<3, TetMesh>();
    }

    fn check_constant_velocity<const D: usize, M: Simplices<D>>() {
        let n: [usize; D] = std::array::from_fn(|k| 5 - k);
        let mesh: M = jittered_box(n, n.map(|n| n as f64), 0.2, |_| true);
        let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
        let flow = flow_through(&mesh, &faces_on(&mesh, |_| false), rock, FaultLaw::OPEN);
        let fixed: Vec<(u32, f64)> = flow
            .nodes_where(|i| mesh.nodes()[i][0] == 0.0 || mesh.nodes()[i][0] == 5.0)
            .into_iter()
            .map(|i| (i, -mesh.nodes()[i as usize][0]))
            .collect();
        let no_rates = vec![0.0; mesh.nodes().len()];
        let solution = flow.solve(&no_rates, &fixed).unwrap();
        let rates = flow
            .face_rates(&solution.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        for c in 0..mesh.len() {
            let (g, _) = gradients(&corners(&mesh, c));
            for k in 0..=D {
                let expected = 2.0 * area_vector(g[k])[0];
                assert!((rates.faces_of(c).0[k] - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_constant_velocity_is_unchanged() {
        check_constant_velocity::<2, TriMesh>();
        check_constant_velocity::<3, TetMesh>();
    }
}
