//! Finds the cells of a corner-point grid to which wells are connected, with the well index of
//! Peaceman (1983) for each. If a well runs along several axes in a cell, the index is the square
//! root of the sum of the squares of the indices along the axes (Shu 2005).

use std::f64::consts::TAU;

use super::grid::CornerPointGrid;
use crate::Result;
use crate::error::{Error, cause};
use crate::export::simulators::deck::WellConnection;
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::model::reservoir::Well;

/// Step along a well, relative to the smallest length of a cell.
const STEP_RATIO: f64 = 0.05;

/// Returns the connections of a well to cells, in order along the well. `permeability` returns the
/// permeability of a cell along i, j and k, or `None` if there is no rock.
///
/// # Errors
/// Returns [`Error::Export`] if the well lies outside the grid, or if its radius is not smaller
/// than the equivalent radius of a cell.
pub fn well_connections(
    well: &Well,
    grid: &CornerPointGrid,
    permeability: impl Fn([usize; 3]) -> Option<[f64; 3]>,
) -> Result<Vec<WellConnection>> {
    let refuse = |problem: String, remedy: &str| {
        Error::Export(cause(format!("well {}", well.name), problem, remedy))
    };
    let mut openings = Vec::new();
    for (cell, path) in well_path_cells(well, grid) {
        let Some(k) = permeability(cell) else {
            continue;
        };
        let [index, strength] = well_index(grid.cell_lengths(cell), k, path, well.radius).ok_or_else(|| {
            let [i, j, k] = cell.map(|n| n + 1);
            refuse(
                format!(
                    "has a radius of {} m, not less than the equivalent radius of cell ({i}, {j}, {k})",
                    well.radius
                ),
                "give a smaller radius, or a coarser grid",
            )
        })?;
        openings.push(WellConnection {
            cell: cell.map(|n| n + 1),
            index,
            strength,
        });
    }
    if openings.is_empty() {
        return Err(refuse(
            "lies outside the cells of the grid".into(),
            "give points inside",
        ));
    }
    Ok(openings)
}

/// Returns the cells along the path of a well, each with the length of the path in it along i, j
/// and k.
fn well_path_cells(well: &Well, grid: &CornerPointGrid) -> Vec<([usize; 3], [f64; 3])> {
    if let [point] = well.path[..] {
        let cell = grid.find_cell(point, 0);
        let vertical_path = |cell| (cell, [0.0, 0.0, grid.cell_lengths(cell)[2]]);
        return cell.map(vertical_path).into_iter().collect();
    }
    let [n, m, layers] = grid.dims();
    let middle = grid.cell_lengths([n / 2, m / 2, layers / 2]);
    let step = STEP_RATIO * middle.iter().copied().fold(f64::INFINITY, f64::min);
    let mut paths: Vec<([usize; 3], [f64; 3])> = Vec::new();
    let mut column = 0;
    for leg in well.path.windows(2) {
        let along = sub(leg[1], leg[0]);
        let count = (norm(along) / step).ceil().max(1.0) as usize;
        let increment = along.map(|d| d / count as f64);
        for i in 0..count {
            let point = add_scaled(leg[0], i as f64 + 0.5, increment);
            let Some(cell) = grid.find_cell(point, column) else {
                continue;
            };
            column = cell[1] * n + cell[0];
            let axes = grid.pillars.axes;
            let [x, y] = axes.map(|axis| dot(axis, [increment[0], increment[1]]).abs());
            let lengths = [x, y, increment[2].abs()];
            match paths.iter_mut().find(|entry| entry.0 == cell) {
                Some((_, path)) => *path = add_scaled(*path, 1.0, lengths),
                None => paths.push((cell, lengths)),
            }
        }
    }
    paths
}

/// Returns the well index of a cell with these lengths and permeabilities, and the strength (see
/// [`WellConnection`]), or `None` if the radius is too large.
fn well_index(lengths: [f64; 3], k: [f64; 3], path: [f64; 3], radius: f64) -> Option<[f64; 2]> {
    let mut squares = [0.0; 2];
    for axis in 0..3 {
        let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
        let ratio = (k[b] / k[a]).sqrt();
        let across = (ratio * lengths[a].powi(2) + lengths[b].powi(2) / ratio).sqrt();
        let equivalent = 0.28 * across / (ratio.sqrt() + ratio.sqrt().recip());
        if path[axis] > 0.0 {
            let log_ratio = (equivalent / radius).ln();
            if log_ratio.is_nan() || log_ratio <= 0.0 {
                return None;
            }
            let strength = TAU * (k[a] * k[b]).sqrt() * path[axis];
            squares[0] += (strength / log_ratio).powi(2);
            squares[1] += strength.powi(2);
        }
    }
    Some(squares.map(f64::sqrt))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upright_well_in_a_square_has_peacemans_index() {
        let [index, strength] =
            well_index([10.0, 10.0, 2.0], [3.0; 3], [0.0, 0.0, 2.0], 0.1).unwrap();
        assert!((strength / (TAU * 6.0) - 1.0).abs() < 1e-12);
        let expected = TAU * 3.0 * 2.0 / (0.14f64 * 200.0f64.sqrt() / 0.1).ln();
        assert!((index / expected - 1.0).abs() < 1e-12, "{index} {expected}");
        // Wells of the same length along another axis of a cube, and along none.
        let cube = |path| well_index([10.0; 3], [3.0; 3], path, 0.1).unwrap()[0];
        let along = cube([0.0, 10.0, 0.0]);
        assert!((cube([6.0, 8.0, 0.0]) / along - 1.0).abs() < 1e-12);
        assert_eq!(well_index([1.0; 3], [1.0; 3], [1.0, 0.0, 0.0], 0.3), None);
    }
}
