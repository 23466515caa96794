//! Flow through tetrahedra: linear finite elements on a mesh torn along its faults, which are at the
//! same time a finite-volume method on the control volumes round the nodes.
//!
//! Inside each tetrahedron pressure is linear. The stiffness of nodes i and j is
//! `V grad_i . K grad_j`; a row of it times the pressures is just the Darcy flux out of the part of
//! the tetrahedron that is nearest to node i (its median dual), so fluid is conserved exactly on
//! these control volumes whatever the shape of the tetrahedra, and linear pressure is exact for any
//! mesh and tensor. (Two-point fluxes between tetrahedra are not even consistent.)
//!
//! Where faces lie on faults the nodes are doubled ([`Split`]). What crosses such a face is
//! its conductance times the jump of pressure, a third of the face at each of its nodes: lumping
//! keeps the couplings positive, so no fault makes pressures overshoot.

use rayon::prelude::*;

use super::rock::{Faults, Rock, Tensor};
use super::sparse::Matrix;
use super::split::Split;
use super::system::{Solution, solve};
use super::wells::{Located, Well};
use crate::error::cause;
use crate::mesh::{FACES, TetMesh, cross, dot, norm, sub, volume6};
use crate::{Error, Result};

/// The pressure system of a mesh, ready for any sources.
#[derive(Debug, Clone)]
pub struct TetFlow {
    /// The mesh, torn along its faults unless they are open.
    pub split: Split,
    /// Rate across each face of `split.faces` per jump of pressure.
    pub transmissibility: Vec<f64>,
    rock: Rock,
    matrix: Matrix,
    /// Volume of each node's control volume.
    volume: Vec<f64>,
}

/// Gradients of the four linear base functions, times six volumes, and six volumes.
#[inline]
pub(super) fn gradients(p: &[[f64; 3]; 4]) -> ([[f64; 3]; 4], f64) {
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (ga, gb, gc) = (cross(b, c), cross(c, a), cross(a, b));
    let origin = [0, 1, 2].map(|k| -(ga[k] + gb[k] + gc[k]));
    ([origin, ga, gb, gc], dot(a, ga))
}

impl TetFlow {
    /// Prepares the pressure system: `mesh` where flow shall be computed (physical coordinates; its
    /// length unit is that of permeability's square), `feature_faces` as in
    /// [`Split::new`] (empty: no faults), one mobility for each tetrahedron.
    ///
    /// # Errors
    /// [`Error::Mesh`] if a tetrahedron has no positive volume or the mesh is no mesh.
    pub fn new(mesh: &TetMesh, feature_faces: &[u8], rock: Rock, faults: Faults) -> Result<Self> {
        if let Some(t) = (0..mesh.tets.len()).find(|&t| {
            let volume = volume6(&mesh.corners(t));
            volume.is_nan() || volume <= 0.0
        }) {
            return Err(Error::Mesh(cause(
                format!("tetrahedron {t}"),
                "has no positive volume",
                "run `atomesh validate`, mesh the image again",
            )));
        }
        let split = Split::new(
            mesh,
            if faults.are_open() {
                &[]
            } else {
                feature_faces
            },
        )?;
        let transmissibility: Vec<f64> = split
            .faces
            .iter()
            .map(|face| {
                let corners = face.tets.map(|t| mesh.corners(t as usize));
                let p = FACES[usize::from(face.face[0])].map(|i| corners[0][i]);
                let square = cross(sub(p[1], p[0]), sub(p[2], p[0]));
                let area = 0.5 * norm(square);
                let normal = square.map(|c| c / (2.0 * area));
                // From the centroid to the face it is a quarter of the height, 3 V / A.
                let distance = corners.map(|corners| volume6(&corners) / (8.0 * area));
                let mobility = face.tets.map(|t| rock.mobility(t as usize).along(normal));
                area * faults.conductance(distance, mobility)
            })
            .collect();
        let (matrix, volume) = assemble(&split, &transmissibility, &rock);
        Ok(Self {
            split,
            transmissibility,
            rock,
            matrix,
            volume,
        })
    }

    /// Steady pressure where fluid enters at each node of the torn mesh at its rate in `rates`, and
    /// some nodes' pressures are given (the first of several for one node holds). Where no pressure
    /// is given, its mean is zero.
    ///
    /// # Errors
    /// [`Error::Flow`] if rates do not balance where they must.
    pub fn solve(&self, rates: &[f64], fixed: &[(u32, f64)]) -> Result<Solution> {
        solve(&self.matrix, rates, fixed, &self.volume, 0.0)
    }

    /// The rate at each node due to wells: shared between the nodes of its tetrahedron.
    pub fn rates(&self, wells: &[Located]) -> Vec<f64> {
        let mut rates = vec![0.0; self.volume.len()];
        for well in wells {
            let corners = self.split.mesh.tets[well.cell as usize];
            for (i, share) in corners.into_iter().zip(well.shares) {
                rates[i as usize] += share * well.rate;
            }
        }
        rates
    }

    /// The volume of each node's control volume.
    pub fn control_volumes(&self) -> &[f64] {
        &self.volume
    }

    /// The tetrahedron of each well and how its rate is shared between the nodes: by the linear base
    /// functions, which is what the finite-element method makes of a point source.
    ///
    /// # Errors
    /// [`Error::Flow`] names a well outside the mesh.
    pub fn locate(&self, wells: &[Well]) -> Result<Vec<Located>> {
        wells
            .iter()
            .map(|well| well.locate(&self.split.mesh))
            .collect()
    }

    /// The mobility of a tetrahedron.
    #[inline]
    pub fn mobility(&self, t: usize) -> &Tensor {
        self.rock.mobility(t)
    }

    /// The nodes of the torn mesh for which `chosen` holds of the node they were made from.
    pub fn nodes_where(&self, chosen: impl Fn(usize) -> bool) -> Vec<u32> {
        let nodes = 0..self.split.original.len() as u32;
        nodes
            .filter(|&i| chosen(self.split.original[i as usize] as usize))
            .collect()
    }

    /// The Darcy velocity `-K grad p / viscosity` of each tetrahedron (rate per area).
    pub fn velocity(&self, pressure: &[f64]) -> Vec<[f64; 3]> {
        let mesh = &self.split.mesh;
        let one = |t: usize| {
            let (g, volume6) = gradients(&mesh.corners(t));
            let p = mesh.tets[t].map(|i| pressure[i as usize]);
            let gradient =
                [0, 1, 2].map(|c| (1..4).map(|k| (p[k] - p[0]) * g[k][c]).sum::<f64>() / volume6);
            self.rock.mobility(t).times(gradient).map(|v| -v)
        };
        (0..mesh.tets.len()).into_par_iter().map(one).collect()
    }

    /// The rate across each face of `split.faces`, from its first tetrahedron to its second.
    pub fn fault_rates(&self, pressure: &[f64]) -> Vec<f64> {
        let across = |(face, t): (&super::split::FaultFace, &f64)| {
            let [here, there] = face.nodes;
            let jumps = here
                .iter()
                .zip(there)
                .map(|(&a, b)| pressure[a as usize] - pressure[b as usize]);
            t / 3.0 * jumps.sum::<f64>()
        };
        self.split
            .faces
            .iter()
            .zip(&self.transmissibility)
            .map(across)
            .collect()
    }
}

/// The system's matrix and the control volumes.
fn assemble(split: &Split, transmissibility: &[f64], rock: &Rock) -> (Matrix, Vec<f64>) {
    let mesh = &split.mesh;
    let (start, corners) = corners_of_nodes(mesh);
    let mut couplings: Vec<(u32, u32, f64)> = Vec::with_capacity(6 * split.faces.len());
    for (face, t) in split.faces.iter().zip(transmissibility) {
        for (&a, &b) in face.nodes[0].iter().zip(&face.nodes[1]) {
            if a != b && *t > 0.0 {
                couplings.extend([(a, b, t / 3.0), (b, a, t / 3.0)]);
            }
        }
    }
    couplings.sort_by_key(|coupling| (coupling.0, coupling.1));
    let n = mesh.nodes.len();
    let matrix = Matrix::from_rows(n, n, |i, row| {
        for &corner in &corners[start[i] as usize..start[i + 1] as usize] {
            let (t, c) = (corner as usize / 4, corner as usize % 4);
            let (g, volume6) = gradients(&mesh.corners(t));
            let out = rock.mobility(t).times(g[c]).map(|v| v / (6.0 * volume6));
            for (k, &j) in mesh.tets[t].iter().enumerate() {
                row.add(j, dot(out, g[k]));
            }
        }
        let first = couplings.partition_point(|c| (c.0 as usize) < i);
        for &(_, other, t) in couplings[first..].iter().take_while(|c| c.0 as usize == i) {
            row.add(i as u32, t);
            row.add(other, -t);
        }
    });
    let share = |&corner: &u32| volume6(&mesh.corners(corner as usize / 4)) / 24.0;
    let volume = (0..n)
        .into_par_iter()
        .map(|i| {
            corners[start[i] as usize..start[i + 1] as usize]
                .iter()
                .map(share)
                .sum()
        })
        .collect();
    (matrix, volume)
}

/// For each node its corners, 4 t + c: those of node i from `start[i]` to `start[i + 1]`.
fn corners_of_nodes(mesh: &TetMesh) -> (Vec<u32>, Vec<u32>) {
    let all = mesh.tets.as_flattened();
    let mut start = vec![0u32; mesh.nodes.len() + 1];
    for &i in all {
        start[i as usize + 1] += 1;
    }
    for i in 0..mesh.nodes.len() {
        start[i + 1] += start[i];
    }
    let mut next = start.clone();
    let mut corners = vec![0; all.len()];
    for (corner, &i) in all.iter().enumerate() {
        corners[next[i as usize] as usize] = corner as u32;
        next[i as usize] += 1;
    }
    (start, corners)
}

#[cfg(test)]
#[path = "tets_tests.rs"]
mod tests;
