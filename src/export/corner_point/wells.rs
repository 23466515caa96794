//! The cells of a corner-point grid that wells are open to, with Peaceman's (1983) index of each: of a
//! well that runs along all three axes in a cell, the root of the sum of their squares (Shu 2005).

use std::f64::consts::TAU;

use super::grid::CornerPointGrid;
use crate::Result;
use crate::error::{Error, cause};
use crate::export::simulators::deck::WellConnection;
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::model::reservoir::Well;

/// A well is followed in steps of this share of the smallest length of a cell.
const STEP_RATIO: f64 = 0.05;

/// The openings of a well, in the order in which it runs. `permeability` is that of each cell along i, j
/// and k, `None` where there is no rock.
///
/// # Errors
/// [`Error::Export`] if it lies outside the grid, or is as wide as a cell's equivalent radius.
pub fn well_connections(
    well: &Well,
    grid: &CornerPointGrid,
    permeability: impl Fn([usize; 3]) -> Option<[f64; 3]>,
) -> Result<Vec<WellConnection>> {
    let refuse = |problem: String, remedy: &str| {
        Error::Export(cause(format!("well {}", well.name), problem, remedy))
    };
    let mut openings = Vec::new();
    for (cell, way) in well_path_cells(well, grid) {
        let Some(k) = permeability(cell) else {
            continue;
        };
        let index = well_index(grid.cell_lengths(cell), k, way, well.radius).ok_or_else(|| {
            let [i, j, k] = cell.map(|n| n + 1);
            refuse(
                format!(
                    "has a radius of {} m, the equivalent radius of cell ({i}, {j}, {k}) or more",
                    well.radius
                ),
                "give a smaller radius, or a coarser grid",
            )
        })?;
        openings.push(WellConnection {
            cell: cell.map(|n| n + 1),
            index,
        });
    }
    match openings.is_empty() {
        true => Err(refuse(
            "lies outside the cells of the grid".into(),
            "give points inside",
        )),
        false => Ok(openings),
    }
}

/// The cells on a well's way, each with how far it goes there along i, j and k.
fn well_path_cells(well: &Well, grid: &CornerPointGrid) -> Vec<([usize; 3], [f64; 3])> {
    if let [point] = well.path[..] {
        let cell = grid.find_cell(point, 0);
        let whole = |cell| (cell, [0.0, 0.0, grid.cell_lengths(cell)[2]]);
        return cell.map(whole).into_iter().collect();
    }
    let [n, m, layers] = grid.dims();
    let middle = grid.cell_lengths([n / 2, m / 2, layers / 2]);
    let step = STEP_RATIO * middle.iter().copied().fold(f64::INFINITY, f64::min);
    let mut ways: Vec<([usize; 3], [f64; 3])> = Vec::new();
    let mut column = 0;
    for leg in well.path.windows(2) {
        let along = sub(leg[1], leg[0]);
        let count = (norm(along) / step).ceil().max(1.0) as usize;
        let part = along.map(|d| d / count as f64);
        for i in 0..count {
            let point = add_scaled(leg[0], i as f64 + 0.5, part);
            let Some(cell) = grid.find_cell(point, column) else {
                continue;
            };
            column = cell[1] * n + cell[0];
            let axes = grid.pillars.axes;
            let [x, y] = axes.map(|axis| dot(axis, [part[0], part[1]]).abs());
            let part = [x, y, part[2].abs()];
            match ways.iter_mut().find(|way| way.0 == cell) {
                Some((_, way)) => *way = add_scaled(*way, 1.0, part),
                None => ways.push((cell, part)),
            }
        }
    }
    ways
}

/// The well index of a cell of these lengths and permeabilities; `None` if the bore is too wide.
fn well_index(lengths: [f64; 3], k: [f64; 3], way: [f64; 3], radius: f64) -> Option<f64> {
    let mut squares = 0.0;
    for axis in 0..3 {
        let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
        let ratio = (k[b] / k[a]).sqrt();
        let across = (ratio * lengths[a].powi(2) + lengths[b].powi(2) / ratio).sqrt();
        let equivalent = 0.28 * across / (ratio.sqrt() + ratio.sqrt().recip());
        if way[axis] > 0.0 {
            let over = (equivalent / radius).ln();
            if over.is_nan() || over <= 0.0 {
                return None;
            }
            squares += (TAU * (k[a] * k[b]).sqrt() * way[axis] / over).powi(2);
        }
    }
    Some(squares.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upright_well_in_a_square_has_peacemans_index() {
        let found = well_index([10.0, 10.0, 2.0], [3.0; 3], [0.0, 0.0, 2.0], 0.1).unwrap();
        let known = TAU * 3.0 * 2.0 / (0.14f64 * 200.0f64.sqrt() / 0.1).ln();
        assert!((found / known - 1.0).abs() < 1e-12, "{found} {known}");
        // As long along another axis of a cube, and askew.
        let cube = |way| well_index([10.0; 3], [3.0; 3], way, 0.1).unwrap();
        let along = cube([0.0, 10.0, 0.0]);
        assert!((cube([6.0, 8.0, 0.0]) / along - 1.0).abs() < 1e-12);
        assert_eq!(well_index([1.0; 3], [1.0; 3], [1.0, 0.0, 0.0], 0.3), None);
    }
}
