//! Rates through the faces of triangles or tetrahedra that are conserved on every one of them.
//!
//! Finite elements conserve fluid on the control volumes round nodes, not on cells: velocities of
//! two cells disagree about what crosses their common face. Here each face gets the mean of the two,
//! and then the least change, weighted by how readily the face lets fluid through, after which every
//! cell is in balance: rates change by `w_f (phi_a - phi_b)`, and the potential phi solves a
//! two-point system on the cells (the correction of Odsaeter et al. 2017, Journal of Computational
//! Physics 330, section 3). Where pressure is linear nothing changes.

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

/// What flows through the faces of a mesh of simplices. Face k of cell c has number (D + 1) c + k.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaceRates<const D: usize = 3> {
    /// Rate out of the cell through each of its faces; the two numbers of a face have exactly
    /// opposite rates.
    pub outflow: Vec<f64>,
    /// The cell across each face, also where a fault lies between; `u32::MAX` on the boundary.
    pub neighbors: Vec<u32>,
}

/// What is known of a face before the correction.
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

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.outflow.is_empty()
    }

    /// The rates out of a cell, and the cells beyond.
    #[inline]
    pub fn faces_of(&self, cell: usize) -> (&[f64], &[u32]) {
        let own = cell * (D + 1)..(cell + 1) * (D + 1);
        (&self.outflow[own.clone()], &self.neighbors[own])
    }
}

impl<const D: usize, M: Simplices<D>> ElementFlow<D, M> {
    /// Rates through faces for the pressure that [`solve`](Self::solve) found with these wells and
    /// given pressures. Faces on the boundary let fluid through where all their nodes have given
    /// pressure.
    ///
    /// # Errors
    /// [`Error::Flow`](crate::Error::Flow) if the correction cannot be found;
    /// [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
    pub fn face_rates(
        &self,
        pressure: &[f64],
        wells: &[LocatedWell],
        fixed: &[(u32, f64)],
        patience: &CancelToken<'_>,
    ) -> Result<FaceRates<D>> {
        let mesh = &self.split_mesh.mesh;
        let count = mesh.len();
        let face_of = |cell: u32, k: u8| cell as usize * (D + 1) + usize::from(k);
        // The torn mesh is made of a mesh that was checked, so no face has three cells.
        let mut around = mesh.neighbors().unwrap_or_default();
        let mut given = vec![false; mesh.nodes().len()];
        fixed.iter().for_each(|f| given[f.0 as usize] = true);

        let velocity = self.velocity(pressure);
        let mut faces: Vec<FaceFlux> = (0..around.len())
            .into_par_iter()
            .map(|face| {
                let (c, n) = (face / (D + 1), around[face]);
                let (rate, half) = self.face_flux(&velocity, face);
                if n == NONE {
                    let open = mesh.face(c, face % (D + 1));
                    let open = open.iter().all(|&i| given[i as usize]);
                    let weight = if open { half } else { 0.0 };
                    return FaceFlux {
                        rate: if open { rate } else { 0.0 },
                        weight,
                    };
                }
                if c > n as usize {
                    return FaceFlux::default();
                }
                let (back, beyond) =
                    self.face_flux(&velocity, opposite_face_index::<D>(&around, face));
                FaceFlux {
                    rate: 0.5 * (rate - back),
                    weight: half * beyond / (half + beyond),
                }
            })
            .collect();
        let across = self.fault_rates(pressure);
        let torn = self.split_mesh.faces.iter().zip(&self.transmissibility);
        for ((face, weight), rate) in torn.zip(across) {
            let [here, there] =
                [0, 1].map(|side| face_of(face.cells[side], face.local_faces[side]));
            around[here] = face.cells[1];
            around[there] = face.cells[0];
            faces[here] = FaceFlux {
                rate,
                weight: *weight,
            };
            faces[there] = FaceFlux::default();
        }
        for face in 0..around.len() {
            let n = around[face];
            if n != NONE && face / (D + 1) > n as usize {
                let FaceFlux { rate, weight } = faces[opposite_face_index::<D>(&around, face)];
                faces[face] = FaceFlux {
                    rate: -rate,
                    weight,
                };
            }
        }

        // Unknown `count` is all that is beyond the boundary.
        let beyond = |n: u32| n.min(count as u32);
        let of_cell = |c: usize| c * (D + 1)..(c + 1) * (D + 1);
        let open = |face: &usize| around[*face] == NONE && faces[*face].weight > 0.0;
        let boundary: Vec<usize> = (0..faces.len()).filter(open).collect();
        let matrix = Matrix::from_rows(count + 1, count + 1, |c, row| {
            if c < count {
                for (face, &n) in faces[of_cell(c)].iter().zip(&around[of_cell(c)]) {
                    if face.weight > 0.0 {
                        row.add(c as u32, face.weight);
                        row.add(beyond(n), -face.weight);
                    }
                }
                return;
            }
            // What is beyond is joined to all cells at open sides, whichever closed faults part them.
            for &face in &boundary {
                let weight = faces[face].weight;
                row.add(count as u32, weight);
                row.add((face / (D + 1)) as u32, -weight);
            }
        });
        let mut missing: Vec<f64> = (0..count)
            .map(|c| -faces[of_cell(c)].iter().map(|f| f.rate).sum::<f64>())
            .collect();
        missing.push(0.0);
        wells
            .iter()
            .for_each(|well| missing[well.cell as usize] += well.rate);
        let mut volume = vec![1.0; count];
        volume.push(0.0);
        let all = sum(faces.len(), |face| faces[face].rate.abs());
        let fixed = [(count as u32, 0.0)];
        let phi = solve(&matrix, &missing, &fixed, &volume, all, patience)?.pressure;
        let corrected = |face: usize| {
            let FaceFlux { rate, weight } = faces[face];
            rate + weight * (phi[face / (D + 1)] - phi[beyond(around[face]) as usize])
        };
        Ok(FaceRates {
            outflow: (0..faces.len()).into_par_iter().map(corrected).collect(),
            neighbors: around,
        })
    }

    /// The rate out of a cell through its face by its own velocity, and the rate per difference of
    /// pressure between its centre and the face.
    fn face_flux(&self, velocity: &[[f64; D]], face: usize) -> (f64, f64) {
        let (c, k) = (face / (D + 1), face % (D + 1));
        let (g, size) = gradients(&corners(&self.split_mesh.mesh, c));
        let vector = area_vector(g[k]);
        let area = dot(vector, vector).sqrt();
        let normal = vector.map(|x| x / area);
        let half = area * self.mobility(c).normal_component(normal) / centre_to_face(g[k], size);
        (dot(velocity[c], vector), half)
    }
}

/// The number that a face has from the cell beyond.
fn opposite_face_index<const D: usize>(around: &[u32], face: usize) -> usize {
    let base = around[face] as usize * (D + 1);
    let back = around[base..=base + D].iter();
    base + back
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
            let side = flow.nodes_where(|i| mesh.nodes()[i][1] == 0.0);
            let fixed: Vec<(u32, f64)> = side.into_iter().map(|i| (i, 0.0)).collect();
            let found = flow.solve(&flow.rates(&wells), &fixed).unwrap();
            let rates = flow
                .face_rates(&found.pressure, &wells, &fixed, &CancelToken::never())
                .unwrap();
            let mut through_side = 0.0;
            for c in 0..mesh.len() {
                let here = wells.iter().filter(|w| w.cell as usize == c);
                let source: f64 = here.map(|w| w.rate).sum();
                let (out, beyond) = rates.faces_of(c);
                let sum: f64 = out.iter().sum();
                assert!((sum - source).abs() < 2e-10, "{sum} {source}");
                for k in 0..=D {
                    let face = c * (D + 1) + k;
                    if beyond[k] == NONE {
                        through_side += out[k];
                    } else {
                        let back = opposite_face_index::<D>(&rates.neighbors, face);
                        assert_eq!(out[k], -rates.outflow[back]);
                    }
                }
            }
            assert!((through_side - 0.5).abs() < 1e-9);
            let closed = flow.split_mesh.faces.iter().zip(&flow.transmissibility);
            for (face, _) in closed.filter(|(_, t)| **t == 0.0) {
                let (out, _) = rates.faces_of(face.cells[0] as usize);
                assert_eq!(out[usize::from(face.local_faces[0])], 0.0);
            }
        }
    }

    #[test]
    fn every_triangle_and_tetrahedron_is_in_balance() {
        check_cell_balance::<2, TriMesh>();
        check_cell_balance::<3, TetMesh>();
    }

    /// Two parts that a closed fault separates, both with flow from side to side, and between them a
    /// pocket that nothing enters.
    fn check_separate_compartments<const D: usize, M: Simplices<D>>() {
        let mut n = [2; D];
        n[0] = 6;
        let mut extent = [2.0; D];
        extent[0] = 6.0;
        let mesh: M = jittered_box(n, extent, 0.2, |x| x[0] != 2.0 && x[0] != 4.0);
        let bits = faces_on(&mesh, |x| x[0] == 2.0);
        let other = faces_on(&mesh, |x| x[0] == 4.0);
        let bits: Vec<u8> = bits.iter().zip(other).map(|(a, b)| a | b).collect();
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
        let nodes = flow.split_mesh.mesh.nodes();
        let held = |x: [f64; D]| (x[0] < 1.5 || x[0] > 4.5) && (x[1] == 0.0 || x[1] == 2.0);
        let held = (0u32..).zip(nodes).filter(|(_, x)| held(**x));
        let fixed: Vec<(u32, f64)> = held.map(|(i, x)| (i, 3.0 * x[1] * x[0])).collect();
        let found = flow.solve(&vec![0.0; nodes.len()], &fixed).unwrap();
        assert_eq!(found.stats.compartments, 3);
        let pocket = (0..nodes.len()).filter(|&i| found.pressure[i] == 0.0);
        assert!(found.stats.undetermined > 0);
        assert!(pocket.count() >= found.stats.undetermined);
        let rates = flow
            .face_rates(&found.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        for c in 0..rates.len() {
            let sum: f64 = rates.faces_of(c).0.iter().sum();
            assert!(sum.abs() < 1e-9, "{c}: {sum}");
        }
    }

    #[test]
    fn closed_parts_may_each_have_sides_and_pockets_none() {
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
        let none = vec![0.0; mesh.nodes().len()];
        let found = flow.solve(&none, &fixed).unwrap();
        let rates = flow
            .face_rates(&found.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        for c in 0..mesh.len() {
            let (g, _) = gradients(&corners(&mesh, c));
            for k in 0..=D {
                let want = 2.0 * area_vector(g[k])[0];
                assert!((rates.faces_of(c).0[k] - want).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_constant_velocity_is_left_as_it_is() {
        check_constant_velocity::<2, TriMesh>();
        check_constant_velocity::<3, TetMesh>();
    }
}
