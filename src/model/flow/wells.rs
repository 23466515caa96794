//! Point sources and sinks.

use crate::parallel::prelude::*;

use super::shape_functions::{corners, gradients};
use crate::error::cause;
use crate::geometry::{bounding_box, dot};
use crate::mesh::Simplices;
use crate::{Error, Result};

/// Number of cells that one task searches.
const CHUNK_CELLS: usize = 1 << 14;
/// Largest negative barycentric coordinate of a point that counts as inside a cell, to allow for
/// rounding.
const BARYCENTRIC_TOLERANCE: f64 = 1e-9;

/// A point where fluid enters or leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct PointWell<const D: usize = 3> {
    /// The name of the well in error messages.
    pub name: String,
    /// The position, in the mesh's coordinates.
    pub position: [f64; D],
    /// Rate in m^3/s: positive for a source, negative for a sink.
    pub rate: f64,
}

/// A well with the tetrahedron or triangle that contains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocatedWell {
    /// The cell.
    pub cell: u32,
    /// The barycentric coordinates of the well in the cell (in a triangle the last one is 0).
    pub shares: [f64; 4],
    /// The well's rate.
    pub rate: f64,
}

impl<const D: usize> PointWell<D> {
    /// Checks that position and rate are finite.
    pub(super) fn check(&self) -> Result<()> {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Flow(cause(&self.name, problem, remedy)));
        if !self.rate.is_finite() {
            return refuse(format!("has the rate {}", self.rate), "give a finite rate");
        }
        if !self.position.iter().all(|c| c.is_finite()) {
            return refuse(
                "has coordinates that are not finite".into(),
                "give finite coordinates",
            );
        }
        Ok(())
    }

    /// Returns the error for a well outside the mesh with these nodes.
    pub(super) fn outside_error(&self, nodes: &[[f64; D]]) -> Error {
        let [low, high] = bounding_box(nodes);
        let mut turned = self.position;
        turned[D - 1] = -turned[D - 1];
        // Programs differ in the sign of depths and times.
        let is_turned = (0..D).all(|k| (low[k]..=high[k]).contains(&turned[k]));
        let remedy = if is_turned {
            "give z with the other sign, as the mesh has it (`atomesh info` shows its extent)"
        } else {
            "give a point inside, in the mesh's coordinates (`atomesh info` shows its extent)"
        };
        let problem = format!("{:?} lies outside the mesh", self.position);
        Error::Flow(cause(&self.name, problem, remedy))
    }

    /// Finds the tetrahedron or triangle that contains the well.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if no cell contains the well, or if its position or rate is not
    /// finite.
    pub fn locate<M: Simplices<D>>(&self, mesh: &M) -> Result<LocatedWell> {
        self.check()?;
        let depth = |c: usize| {
            let shares = barycentric(&corners(mesh, c), self.position);
            (
                shares[..=D].iter().copied().fold(f64::INFINITY, f64::min),
                c,
            )
        };
        let deeper = |a: (f64, usize), b: (f64, usize)| if b.0 > a.0 { b } else { a };
        let chunk_best: Vec<(f64, usize)> = (0..mesh.len().div_ceil(CHUNK_CELLS))
            .into_par_iter()
            .map(|k| {
                let cells = k * CHUNK_CELLS..mesh.len().min((k + 1) * CHUNK_CELLS);
                cells.map(depth).fold((f64::NEG_INFINITY, 0), deeper)
            })
            .collect();
        let (depth, cell) = chunk_best.into_iter().fold((f64::NEG_INFINITY, 0), deeper);
        if depth < -BARYCENTRIC_TOLERANCE {
            return Err(self.outside_error(mesh.nodes()));
        }
        let shares = barycentric(&corners(mesh, cell), self.position).map(|s| s.max(0.0));
        let sum: f64 = shares.iter().sum();
        Ok(LocatedWell {
            cell: cell as u32,
            shares: shares.map(|s| s / sum),
            rate: self.rate,
        })
    }
}

/// Returns the barycentric coordinates of `x`: one for each of the D + 1 corners, then 0. Inside
/// the cell all are in [0, 1].
#[inline]
pub(super) fn barycentric<const D: usize>(p: &[[f64; D]; 4], x: [f64; D]) -> [f64; 4] {
    let (g, size) = gradients(p);
    let offset: [f64; D] = std::array::from_fn(|k| x[k] - p[0][k]);
    let mut shares = [1.0, 0.0, 0.0, 0.0];
    for k in 1..=D {
        shares[k] = dot(g[k], offset) / size;
        shares[0] -= shares[k];
    }
    shares
}
