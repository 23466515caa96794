//! Rates through the faces of tetrahedra that are conserved on every tetrahedron.
//!
//! Finite elements conserve fluid on the control volumes round nodes, not on tetrahedra: velocities
//! of two tetrahedra disagree about what crosses their common face. Here each face gets the mean of
//! the two, and then the least change, weighted by how readily the face lets fluid through, after
//! which every tetrahedron is in balance: rates change by `w_f (phi_a - phi_b)`, and the potential
//! phi solves a two-point system on the tetrahedra (the correction of Odsaeter et al. 2017, Journal of
//! Computational Physics 330, section 3). Where pressure is linear nothing changes.

use rayon::prelude::*;

use super::sparse::{Matrix, sum};
use super::system::solve;
use super::tets::{TetFlow, gradients};
use super::wells::Located;
use crate::Result;
use crate::mesh::complex::{NONE, neighbors};
use crate::mesh::{dot, norm};

/// What flows through the faces of a mesh of tetrahedra.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaceRates {
    /// Rate out of each tetrahedron through its face k; the two tetrahedra of a face have exactly
    /// opposite rates.
    pub out: Vec<[f64; 4]>,
    /// The tetrahedron across face k, also where a fault lies between; `u32::MAX` on the boundary.
    pub neighbors: Vec<[u32; 4]>,
}

/// What is known of a face before the correction.
#[derive(Debug, Clone, Copy, Default)]
struct Face {
    rate: f64,
    weight: f64,
}

impl TetFlow {
    /// Rates through faces for the pressure that [`solve`](Self::solve) found with these wells and
    /// given pressures. Faces on the boundary let fluid through where all their nodes have given
    /// pressure.
    ///
    /// # Errors
    /// [`Error::Flow`](crate::Error::Flow) if the correction cannot be found.
    pub fn face_rates(
        &self,
        pressure: &[f64],
        wells: &[Located],
        fixed: &[(u32, f64)],
    ) -> Result<FaceRates> {
        let mesh = &self.split.mesh;
        let count = mesh.tets.len();
        // The torn mesh is made of a mesh that was checked, so no face has three tetrahedra.
        let mut around = neighbors(mesh.nodes.len(), &mesh.tets).unwrap_or_default();
        let mut given = vec![false; mesh.nodes.len()];
        fixed.iter().for_each(|f| given[f.0 as usize] = true);

        let velocity = self.velocity(pressure);
        let mut faces: Vec<[Face; 4]> = (0..count)
            .into_par_iter()
            .map(|t| {
                let (g, volume6) = gradients(&mesh.corners(t));
                std::array::from_fn(|k| {
                    // The face's area vector, outwards.
                    let area = g[k].map(|c| -0.5 * c);
                    let n = around[t][k];
                    let half = |t: usize| self.half_transmissibility(t, g[k], volume6);
                    if n != NONE {
                        if t > n as usize {
                            return Face::default();
                        }
                        let other = gradients(&mesh.corners(n as usize));
                        let back = back_face(&around, t, n as usize);
                        let beyond = self.half_transmissibility(n as usize, other.0[back], other.1);
                        let own = half(t);
                        Face {
                            rate: 0.5 * (dot(velocity[t], area) + dot(velocity[n as usize], area)),
                            weight: own * beyond / (own + beyond),
                        }
                    } else if (0..4).all(|i| i == k || given[mesh.tets[t][i] as usize]) {
                        Face {
                            rate: dot(velocity[t], area),
                            weight: half(t),
                        }
                    } else {
                        Face::default()
                    }
                })
            })
            .collect();
        let across = self.fault_rates(pressure);
        for ((face, rate), weight) in self
            .split
            .faces
            .iter()
            .zip(across)
            .zip(&self.transmissibility)
        {
            let [t, n] = face.tets.map(|t| t as usize);
            let [k, back] = face.face.map(usize::from);
            around[t][k] = n as u32;
            around[n][back] = t as u32;
            faces[t][k] = Face {
                rate,
                weight: *weight,
            };
            faces[n][back] = Face::default();
        }
        for t in 0..count {
            for k in 0..4 {
                let n = around[t][k];
                if n != NONE && t > n as usize {
                    let Face { rate, weight } =
                        faces[n as usize][back_face(&around, t, n as usize)];
                    faces[t][k] = Face {
                        rate: -rate,
                        weight,
                    };
                }
            }
        }

        // Unknown `count` is all that is beyond the boundary.
        let beyond = |n: u32| n.min(count as u32);
        let matrix = Matrix::from_rows(count + 1, count + 1, |t, row| {
            if t < count {
                for (face, &n) in faces[t].iter().zip(&around[t]) {
                    if face.weight > 0.0 {
                        row.add(t as u32, face.weight);
                        row.add(beyond(n), -face.weight);
                    }
                }
            }
        });
        let mut missing: Vec<f64> = faces
            .iter()
            .map(|f| -f.iter().map(|f| f.rate).sum::<f64>())
            .collect();
        missing.push(0.0);
        wells
            .iter()
            .for_each(|well| missing[well.cell as usize] += well.rate);
        let mut volume = vec![1.0; count];
        volume.push(0.0);
        let all = sum(count, |t| faces[t].iter().map(|f| f.rate.abs()).sum());
        let phi = solve(&matrix, &missing, &[(count as u32, 0.0)], &volume, all)?.pressure;
        let corrected = |t: usize| -> [f64; 4] {
            std::array::from_fn(|k| {
                let Face { rate, weight } = faces[t][k];
                rate + weight * (phi[t] - phi[beyond(around[t][k]) as usize])
            })
        };
        Ok(FaceRates {
            out: (0..count).into_par_iter().map(corrected).collect(),
            neighbors: around,
        })
    }

    /// Rate per difference of pressure between a tetrahedron's centre and one of its faces, of which
    /// six volumes times the gradient of its base function are given.
    fn half_transmissibility(&self, t: usize, g: [f64; 3], volume6: f64) -> f64 {
        let double_area = norm(g);
        let normal = g.map(|c| c / double_area);
        // A quarter of the height, 3 V / A.
        let distance = volume6 / (4.0 * double_area);
        0.5 * double_area * self.mobility(t).along(normal) / distance
    }
}

/// Which face of `n` leads back to `t`.
fn back_face(around: &[[u32; 4]], t: usize, n: usize) -> usize {
    around[n].iter().position(|&m| m as usize == t).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::test_meshes::{faces_on, jittered_box};
    use crate::flow::{Faults, Rock, Tensor, Well};

    #[test]
    fn every_tetrahedron_is_in_balance() {
        let mesh = jittered_box([6; 3], [3.0; 3], 0.25, |x| x[0] != 1.5);
        let bits = faces_on(&mesh, |x| x[0] == 1.5 && x[2] <= 2.0);
        let regions: Vec<i32> = (0..mesh.tets.len()).map(|t| (t / 300 % 2) as i32).collect();
        let tensor = Tensor::from_numbers(&[3.0, 1.0, 0.1, 0.5, -0.1, 0.2]).unwrap();
        let rock =
            Rock::by_region(&regions, &[(0, tensor), (1, Tensor::isotropic(0.01))], 1.0).unwrap();
        for multiplier in [0.0, 0.01, 1.0] {
            let faults = Faults::new(multiplier, None).unwrap();
            let flow = TetFlow::new(&mesh, &bits, rock.clone(), faults).unwrap();
            let well = |x: f64, rate| Well {
                name: "well".into(),
                position: [x, 1.1, 1.3],
                rate,
            };
            let wells = flow.locate(&[well(0.4, 2.0), well(2.5, -1.5)]).unwrap();
            let side = flow.nodes_where(|i| mesh.nodes[i][1] == 0.0);
            let fixed: Vec<(u32, f64)> = side.into_iter().map(|i| (i, 0.0)).collect();
            let found = flow.solve(&flow.rates(&wells), &fixed).unwrap();
            let rates = flow.face_rates(&found.pressure, &wells, &fixed).unwrap();
            let mut through_side = 0.0;
            for t in 0..mesh.tets.len() {
                let source: f64 = wells
                    .iter()
                    .filter(|w| w.cell as usize == t)
                    .map(|w| w.rate)
                    .sum();
                let out: f64 = rates.out[t].iter().sum();
                assert!((out - source).abs() < 2e-10, "{out} {source}");
                for k in 0..4 {
                    match rates.neighbors[t][k] {
                        NONE => through_side += rates.out[t][k],
                        n => {
                            let back = back_face(&rates.neighbors, t, n as usize);
                            assert_eq!(rates.out[t][k], -rates.out[n as usize][back]);
                        }
                    }
                }
            }
            assert!((through_side - 0.5).abs() < 1e-9);
            let closed = flow.split.faces.iter().zip(&flow.transmissibility);
            for (face, _) in closed.filter(|(_, t)| **t == 0.0) {
                assert_eq!(
                    rates.out[face.tets[0] as usize][usize::from(face.face[0])],
                    0.0
                );
            }
        }
    }

    #[test]
    fn a_constant_velocity_is_left_as_it_is() {
        let mesh = jittered_box([5, 4, 3], [5.0, 4.0, 3.0], 0.2, |_| true);
        let flow = TetFlow::new(
            &mesh,
            &[],
            Rock::uniform(Tensor::isotropic(2.0), 1.0),
            Faults::OPEN,
        )
        .unwrap();
        let fixed: Vec<(u32, f64)> = flow
            .nodes_where(|i| mesh.nodes[i][0] == 0.0 || mesh.nodes[i][0] == 5.0)
            .into_iter()
            .map(|i| (i, -mesh.nodes[i as usize][0]))
            .collect();
        let found = flow.solve(&vec![0.0; mesh.nodes.len()], &fixed).unwrap();
        let rates = flow.face_rates(&found.pressure, &[], &fixed).unwrap();
        for t in 0..mesh.tets.len() {
            let (g, _) = gradients(&mesh.corners(t));
            for k in 0..4 {
                assert!((rates.out[t][k] + 0.5 * 2.0 * g[k][0]).abs() < 1e-9);
            }
        }
    }
}
