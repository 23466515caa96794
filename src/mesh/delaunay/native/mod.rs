//! Our own Delaunay kernel: no other library, no process-wide state, any number of calls at the same
//! time, on any platform.
//!
//! - [`triangulation`]: weighted Delaunay triangulations to which points are added one by one
//! - [`predicates`]: signs of determinants without rounding errors, and the rule for ties
//! - `insertion_order`: the order in which points are inserted
//! - `sphere`: the spheres of cells as rounded numbers
//! - `wide`: integers of 384 bits
//!
//! A triangulation is unique, because ties are broken by the points' numbers: it depends neither on
//! the order of insertion nor on the kernel. TetGen's is the same.

pub(crate) mod insertion_order;
pub mod predicates;
mod sphere;
pub mod triangulation;
mod wide;

use super::{DelaunayTets, Kernel, delaunay_error};
use crate::error::Result;
use crate::geometry::NONE;
use crate::geometry::bounding_box;
use crate::parallel::prelude::*;
use insertion_order::insertion_order;
use predicates::{Grid, WeightedPoint, orientation};
use triangulation::{Cell, Triangulation};

/// Our own kernel.
pub struct Native;

impl Kernel for Native {
    fn triangulate(&self, points: &[[f64; 3]], with_neighbours: bool) -> Result<DelaunayTets> {
        let triangulation: Triangulation<false> = incremental(&normalized(points))?;
        let (cells, numbers) = triangulation.into_cells();
        Ok(compacted(cells, &numbers, with_neighbours))
    }
}

/// Returns the triangulation of `points`, to which more points can be added. Coordinates are
/// between 1e-15 and 1e15, or smaller than what matters.
///
/// # Errors
/// Returns [`Error::Delaunay`](crate::Error::Delaunay) if all points lie in one plane.
pub fn incremental<const WEIGHTED: bool>(points: &[[f64; 3]]) -> Result<Triangulation<WEIGHTED>> {
    let mut order = insertion_order(points);
    put_simplex_first(points, &mut order).ok_or_else(|| {
        delaunay_error(
            "all points lie in one plane or on one line",
            "give points that span a volume",
        )
    })?;
    Ok(inserted(points, &[], &order))
}

/// Returns the triangulation of `points` with `weights`, all 0 if there are none, inserted in an
/// order that begins with four points that are not in one plane.
fn inserted<const WEIGHTED: bool>(
    points: &[[f64; 3]],
    weights: &[f64],
    order: &[u32],
) -> Triangulation<WEIGHTED> {
    let point = |i: u32| WeightedPoint {
        x: points[i as usize],
        weight: weights.get(i as usize).copied().unwrap_or(0.0),
    };
    let first = [order[0], order[1], order[2], order[3]];
    let grid = Grid::from_points(points.iter());
    let bounds = bounding_box(points);
    let mut triangulation = Triangulation::new(first.map(point), first, bounds, grid, points.len());
    for &i in &order[4..] {
        triangulation.insert(point(i), i);
    }
    triangulation
}

/// Returns the points times the power of two that brings the largest coordinate between 1 and 2.
fn normalized(points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let [low, high] = bounding_box(points);
    let largest = (low.iter().chain(&high)).fold(0.0f64, |m, x| m.max(x.abs()));
    // Two factors, since the inverse of the smallest numbers is no number.
    let exponent = -largest.log2().floor() as i32;
    let factors = [exponent / 2, exponent - exponent / 2].map(|e| 2f64.powi(e));
    (points.par_iter())
        .map(|p| p.map(|x| x * factors[0] * factors[1]))
        .collect()
}

/// Moves four points that are not in one plane to the front of `order`. Returns `None` if there are
/// none.
fn put_simplex_first(points: &[[f64; 3]], order: &mut [u32]) -> Option<()> {
    let x = |i: u32| points[i as usize];
    let first = x(order[0]);
    let second = (1..order.len()).find(|&i| x(order[i]) != first)?;
    order[1..=second].rotate_right(1);
    let second = x(order[1]);
    // A point is on the line exactly if it forms no volume with the line and any axis.
    let is_off_line = |p: [f64; 3]| {
        (0..3).any(|k| {
            let mut along_axis = first;
            along_axis[k] += 1.0;
            orientation([first, second, p, along_axis]) != 0
        })
    };
    let third = (2..order.len()).find(|&i| is_off_line(x(order[i])))?;
    order[2..=third].rotate_right(1);
    let third = x(order[2]);
    let fourth =
        (3..order.len()).find(|&i| orientation([first, second, third, x(order[i])]) != 0)?;
    order[3..=fourth].rotate_right(1);
    Some(())
}

/// Returns the cells inside the hull, numbered consecutively, with the points' numbers.
fn compacted(cells: Vec<Cell>, numbers: &[u32], with_neighbours: bool) -> DelaunayTets {
    let mut tets = Vec::with_capacity(cells.len());
    let mut new_index = Vec::with_capacity(if with_neighbours { cells.len() } else { 0 });
    for cell in &cells {
        let is_finite = cell.is_finite();
        if with_neighbours {
            new_index.push(if is_finite { tets.len() as u32 } else { NONE });
        }
        if is_finite {
            tets.push(cell.vertices.map(|v| numbers[v as usize]));
        }
    }
    let mut neighbours = Vec::with_capacity(if with_neighbours { tets.len() } else { 0 });
    if with_neighbours {
        let finite = (cells.iter().zip(&new_index)).filter(|(_, index)| **index != NONE);
        neighbours
            .extend(finite.map(|(cell, _)| cell.neighbours.map(|n| new_index[(n >> 2) as usize])));
    }
    DelaunayTets { tets, neighbours }
}

#[cfg(test)]
mod tests;
