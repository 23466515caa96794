//! Flow through triangles or tetrahedra: linear finite elements on a mesh split along its faults.
//! They are at the same time a finite-volume method on the control volumes around the nodes.
//!
//! Pressure is linear inside each cell. The stiffness of nodes i and j is `V grad_i . K grad_j`. A
//! row of the stiffness matrix times the pressures is the Darcy flux out of the part of the cell
//! that is nearest to node i (its median dual). So fluid is conserved exactly on these control
//! volumes, for cells of any shape, and linear pressure is exact for any mesh and tensor.
//! (Two-point fluxes between tetrahedra are not even consistent.)
//!
//! The nodes of faces on faults are doubled ([`SplitMesh`]). The rate across such a face is its
//! conductance times the pressure jump, lumped: each of the D nodes gets an equal share of the
//! face. Lumping keeps the couplings positive, so that pressures do not overshoot at faults.
//!
//! In 2-D, the mesh is a layer of unit thickness: rates are per unit length of thickness.

use crate::parallel::prelude::*;

use super::barriers::Barriers;
use super::rock::{Rock, Tensor};
use super::shape_functions::{area_vector, centre_to_face, corners, factorial, gradients};
use super::sparse_matrix::Matrix;
use super::split_mesh::{FaultFace, SplitMesh};
use super::system::{Solution, solve};
use super::wells::{LocatedWell, PointWell};
use crate::error::cause;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::dot;
use crate::mesh::{Simplices, TetMesh};
use crate::progress::CancelToken;
use crate::{Error, Result};

/// The pressure system of a mesh, ready for any sources.
#[derive(Debug, Clone)]
pub struct ElementFlow<const D: usize = 3, M = TetMesh> {
    /// The mesh, split along its faults unless they are open.
    pub split_mesh: SplitMesh<D, M>,
    /// Rate across each face of `split_mesh.faces` per pressure jump.
    pub transmissibility: Vec<f64>,
    rock: Rock,
    matrix: Matrix,
    /// Volume of each node's control volume.
    volume: Vec<f64>,
}

impl<const D: usize, M: Simplices<D>> ElementFlow<D, M> {
    /// Prepares the pressure system. `mesh` is in physical coordinates; the square of its length
    /// unit is the unit of permeability. `barriers` lie on its faces, and `rock` has one mobility
    /// for each cell.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if a cell has no positive volume or a face has more than two cells.
    pub fn new(mesh: &M, barriers: &Barriers, rock: Rock) -> Result<Self> {
        let has_no_volume = |c: &usize| {
            let volume = mesh.volume(*c);
            volume.is_nan() || volume <= 0.0
        };
        if let Some(c) = (0..mesh.len()).find(has_no_volume) {
            return Err(Error::Mesh(cause(
                format!("cell {c} of the {}", M::CELLS_NAME),
                "has no positive volume",
                "run `atomesh validate`, mesh the image again",
            )));
        }
        let split = SplitMesh::new(mesh, barriers)?;
        let transmissibility = (split.faces.par_iter())
            .map(|face| {
                let side_gradients = [0, 1].map(|side| {
                    let (g, size) = gradients(&corners(mesh, face.cells[side] as usize));
                    (g[usize::from(face.local_faces[side])], size)
                });
                let area = area_vector(side_gradients[0].0);
                let size = dot(area, area).sqrt();
                let normal = area.map(|c| c / size);
                let distance = side_gradients.map(|(g, size)| centre_to_face(g, size));
                let mobility = face
                    .cells
                    .map(|c| rock.mobility(c as usize).normal_component(normal));
                size * barriers.law(face.label).conductance(distance, mobility)
            })
            .collect::<Vec<f64>>();
        if transmissibility.iter().any(|t| *t < 0.0) {
            return Err(Error::Flow(cause(
                "fault multiplier",
                "is above 1, but elements represent faults that resist flow only",
                "give multipliers from 0 to 1",
            )));
        }
        let (matrix, volume) = assemble(&split, &transmissibility, &rock);
        Ok(Self {
            split_mesh: split,
            transmissibility,
            rock,
            matrix,
            volume,
        })
    }

    /// Returns the steady pressure. `rates` is the rate at which fluid enters at each node of the
    /// split mesh; `fixed` are pairs of a node and its given pressure (of several pressures for one
    /// node, the first one applies). If no pressure is given, the mean pressure is zero.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if rates do not balance where they must.
    pub fn solve(&self, rates: &[f64], fixed: &[(u32, f64)]) -> Result<Solution> {
        self.solve_cancellable(rates, fixed, &CancelToken::never())
    }

    /// Returns the same as [`solve`](Self::solve), but checks `cancel` between iterations.
    ///
    /// # Errors
    /// Returns the errors of [`solve`](Self::solve), and [`Error::Interrupted`] once `cancel` is
    /// cancelled.
    pub fn solve_cancellable(
        &self,
        rates: &[f64],
        fixed: &[(u32, f64)],
        cancel: &CancelToken<'_>,
    ) -> Result<Solution> {
        solve(&self.matrix, rates, fixed, &self.volume, 0.0, cancel)
    }

    /// Returns the rate at each node due to wells. The rate of a well is shared between the nodes
    /// of its cell.
    pub fn rates(&self, wells: &[LocatedWell]) -> Vec<f64> {
        let mut rates = vec![0.0; self.volume.len()];
        for well in wells {
            let corners = self.split_mesh.mesh.cell(well.cell as usize);
            for (&i, share) in corners.iter().zip(well.shares) {
                rates[i as usize] += share * well.rate;
            }
        }
        rates
    }

    /// Returns the volume of each node's control volume.
    pub fn control_volumes(&self) -> &[f64] {
        &self.volume
    }

    /// Returns the cell of each well and the shares of its nodes in its rate: the values of the
    /// linear shape functions, as the finite-element method treats a point source.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the name of the well if a well lies outside the mesh.
    pub fn locate(&self, wells: &[PointWell<D>]) -> Result<Vec<LocatedWell>> {
        wells
            .iter()
            .map(|well| well.locate(&self.split_mesh.mesh))
            .collect()
    }

    /// Returns the mobility of a cell.
    #[inline]
    pub fn mobility(&self, cell: usize) -> &Tensor {
        self.rock.mobility(cell)
    }

    /// Returns the nodes of the split mesh for whose original node `predicate` is `true`.
    pub fn nodes_where(&self, predicate: impl Fn(usize) -> bool) -> Vec<u32> {
        let nodes = 0..self.split_mesh.original_node.len() as u32;
        nodes
            .filter(|&i| predicate(self.split_mesh.original_node[i as usize] as usize))
            .collect()
    }

    /// Returns the Darcy velocity `-K grad p / viscosity` of each cell (rate per area).
    pub fn velocity(&self, pressure: &[f64]) -> Vec<[f64; D]> {
        let mesh = &self.split_mesh.mesh;
        let cell_velocity = |c: usize| {
            let (g, size) = gradients(&corners(mesh, c));
            let nodes = mesh.cell(c);
            let p = |k: usize| pressure[nodes[k] as usize];
            let gradient: [f64; D] = std::array::from_fn(|i| {
                (1..=D).map(|k| (p(k) - p(0)) * g[k][i]).sum::<f64>() / size
            });
            self.rock.mobility(c).times(gradient).map(|v| -v)
        };
        (0..mesh.len()).into_par_iter().map(cell_velocity).collect()
    }

    /// Returns the rate across each face of `split_mesh.faces`, from its first cell to its second.
    pub fn fault_rates(&self, pressure: &[f64]) -> Vec<f64> {
        let face_rate = |(face, t): (&FaultFace<D>, &f64)| {
            let [side_a, side_b] = face.nodes;
            let jumps = side_a
                .iter()
                .zip(side_b)
                .map(|(&a, b)| pressure[a as usize] - pressure[b as usize]);
            t / D as f64 * jumps.sum::<f64>()
        };
        self.split_mesh
            .faces
            .iter()
            .zip(&self.transmissibility)
            .map(face_rate)
            .collect()
    }
}

/// Returns the matrix of the system and the volumes of the control volumes.
fn assemble<const D: usize, M: Simplices<D>>(
    split: &SplitMesh<D, M>,
    transmissibility: &[f64],
    rock: &Rock,
) -> (Matrix, Vec<f64>) {
    let mesh = &split.mesh;
    let n = mesh.nodes().len();
    let (start, sorted_corners) = sort_by_group(n, mesh.connectivity().iter().map(|&i| i as usize));
    let mut couplings: Vec<(u32, u32, f64)> = Vec::with_capacity(2 * D * split.faces.len());
    for (face, t) in split.faces.iter().zip(transmissibility) {
        for (&a, &b) in face.nodes[0].iter().zip(&face.nodes[1]) {
            if a != b && *t > 0.0 {
                let share = t / D as f64;
                couplings.extend([(a, b, share), (b, a, share)]);
            }
        }
    }
    couplings.sort_by_key(|coupling| (coupling.0, coupling.1));
    let corners_of = |i: usize| &sorted_corners[start[i] as usize..start[i + 1] as usize];
    let matrix = Matrix::from_rows(n, n, |i, row| {
        for &corner in corners_of(i) {
            let (cell, k) = (corner as usize / (D + 1), corner as usize % (D + 1));
            let (g, size) = gradients(&corners(mesh, cell));
            let scale = 1.0 / (const { factorial(D) } * size);
            let flux = rock.mobility(cell).times(g[k]).map(|v| v * scale);
            for (&j, gradient) in mesh.cell(cell).iter().zip(g) {
                row.add(j, dot(flux, gradient));
            }
        }
        let first = couplings.partition_point(|c| (c.0 as usize) < i);
        for &(_, other, t) in couplings[first..].iter().take_while(|c| c.0 as usize == i) {
            row.add(i as u32, t);
            row.add(other, -t);
        }
    });
    let share = |&corner: &u32| mesh.volume(corner as usize / (D + 1)) / (D + 1) as f64;
    let volume = (0..n)
        .into_par_iter()
        .map(|i| corners_of(i).iter().map(share).sum())
        .collect();
    (matrix, volume)
}

#[cfg(test)]
#[path = "elements_tests.rs"]
mod tests;
