//! Traces straight lines through the cells of a model, from cell to cell through their faces.

use crate::geometry::{dot, sub};
use crate::mesh::graph::{Graph, Locator};
use crate::parallel::prelude::*;

/// Maximum number of steps of a walk.
const MAX_STEPS: usize = 10_000;

/// Segment of a line in one cell. Its ends are fractions of the direction vector of the line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineSegment {
    /// Cell that holds the segment.
    pub cell: u32,
    /// Start of the segment.
    pub start: f64,
    /// End of the segment.
    pub end: f64,
    /// Connection through which the line leaves the cell. `None` if it leaves the mesh.
    pub exit_connection: Option<u32>,
}

/// Walks through cells. Cells are assumed to be convex, and faces flat.
pub struct CellWalker<'a> {
    cells: Locator<'a, 3>,
    /// Distance within which a point lies in each cell, because coordinates are rounded.
    rounding: Vec<f64>,
}

impl<'a> CellWalker<'a> {
    /// Creates a walker for the cells of a graph.
    pub fn new(graph: &'a Graph<3>) -> Self {
        let volumes = graph.volume.par_iter();
        Self {
            cells: Locator::new(graph),
            rounding: volumes.map(|volume| 1e-9 * volume.cbrt()).collect(),
        }
    }

    /// Returns the cell that contains a point, walking from `start_cell`. For a point outside the
    /// mesh it returns a cell near the point.
    pub fn cell_at(&self, point: [f64; 3], start_cell: u32) -> u32 {
        let mut cell = start_cell;
        for _ in 0..MAX_STEPS {
            let mut farthest = (self.rounding[cell as usize], None);
            for side in self.cells.sides(cell) {
                let distance = side.offset(point);
                if side.neighbour.is_some() && distance > farthest.0 {
                    farthest = (distance, side.neighbour);
                }
            }
            match farthest.1 {
                Some(next) => cell = next,
                None => break,
            }
        }
        cell
    }

    /// Returns where a line enters a cell, and where it leaves it, with the face through which it
    /// does and the cell beyond.
    #[inline]
    fn cell_crossing(
        &self,
        cell: u32,
        origin: [f64; 3],
        direction: [f64; 3],
        parallel: f64,
    ) -> (f64, f64, Option<(u32, Option<u32>)>) {
        let (mut enters, mut leaves) = (f64::NEG_INFINITY, (f64::INFINITY, None));
        let rounding = self.rounding[cell as usize];
        for side in self.cells.sides(cell) {
            let speed = dot(direction, side.normal);
            let distance = dot(sub(side.point, origin), side.normal);
            if speed.abs() <= parallel && distance < -rounding {
                // The line is parallel to this face and outside the cell.
                return (enters, f64::NEG_INFINITY, None);
            }
            let fraction = distance / speed;
            if speed > parallel && fraction < leaves.0 {
                leaves = (fraction, Some((side.face, side.neighbour)));
            } else if speed < -parallel && fraction > enters {
                enters = fraction;
            }
        }
        (enters, leaves.0, leaves.1)
    }

    /// Returns the segments, in order, in which the line from `origin` along `direction` crosses
    /// the mesh. The search begins at the middle of the line, which is found by a walk from
    /// `start_cell`.
    pub fn trace_line(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        start_cell: u32,
    ) -> Vec<LineSegment> {
        self.trace(origin, direction, start_cell, f64::INFINITY)
    }

    /// Returns the segments of [`trace_line`](Self::trace_line) that lie between `origin` and the end
    /// of `direction`, at least in part.
    pub fn trace_between(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        start_cell: u32,
    ) -> Vec<LineSegment> {
        self.trace(origin, direction, start_cell, 1.0)
    }

    /// Traces a line from its middle to both sides, up to the cell that holds the fraction `limit`
    /// of its direction to either side.
    fn trace(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        start_cell: u32,
        limit: f64,
    ) -> Vec<LineSegment> {
        let middle = std::array::from_fn(|k| origin[k] + 0.5 * direction[k]);
        let first = self.cell_at(middle, start_cell);
        let parallel = 1e-12 * dot(direction, direction).sqrt();
        // Traces the line from a cell in one direction.
        let trace = |first: u32, direction: [f64; 3], origin: [f64; 3]| {
            let mut segments: Vec<LineSegment> = Vec::new();
            let (mut cell, mut reached) = (first, f64::NEG_INFINITY);
            for _ in 0..MAX_STEPS {
                let (enters, leaves, exit) = self.cell_crossing(cell, origin, direction, parallel);
                let start = enters.max(reached);
                let next = exit.and_then(|(_, neighbour)| neighbour);
                if leaves > start {
                    reached = leaves;
                    segments.push(LineSegment {
                        cell,
                        start,
                        end: leaves,
                        exit_connection: exit.filter(|_| next.is_some()).map(|exit| exit.0),
                    });
                }
                match next {
                    Some(next) if reached < limit => cell = next,
                    _ => break,
                }
            }
            segments
        };
        let end = std::array::from_fn(|k| origin[k] + direction[k]);
        let backwards = trace(first, direction.map(|d| -d), end);
        let forwards = trace(first, direction, origin);
        let mut segments: Vec<LineSegment> = Vec::with_capacity(backwards.len() + forwards.len());
        for (i, segment) in backwards.iter().enumerate().skip(1).rev() {
            segments.push(LineSegment {
                cell: segment.cell,
                start: 1.0 - segment.end,
                end: 1.0 - segment.start,
                exit_connection: backwards[i - 1].exit_connection,
            });
        }
        segments.extend(forwards);
        segments
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn lines_go_from_cell_to_cell() {
        let mesh = two_cells::<3>(0.75);
        let graph = Graph::from_poly(&mesh);
        let walker = CellWalker::new(&graph);
        assert_eq!(walker.cell_at([1.9, 0.1, 0.1], 0), 1);
        assert_eq!(walker.cell_at([-3.0, 0.1, 0.1], 1), 0);
        let is_close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        for start_cell in [0, 1] {
            let line = walker.trace_line([-1.0, 0.5, 0.25], [4.0, 0.0, 0.25], start_cell);
            let [a, b] = line[..] else { panic!("{line:?}") };
            assert_eq!(
                [(a.cell, a.exit_connection), (b.cell, b.exit_connection)],
                [(0, Some(0)), (1, None)]
            );
            assert!(
                is_close(a.start, 0.25) && is_close(a.end, 1.75 / 4.0),
                "{a:?}"
            );
            assert!(
                is_close(b.start, 1.75 / 4.0) && is_close(b.end, 0.75),
                "{b:?}"
            );
            let short = walker.trace_between([0.1, 0.5, 0.25], [0.2, 0.0, 0.0], start_cell);
            assert_eq!(short.iter().map(|p| p.cell).collect::<Vec<_>>(), [0]);
            let across = walker.trace_between([0.1, 0.5, 0.25], [1.0, 0.0, 0.0], start_cell);
            assert_eq!(across.iter().map(|p| p.cell).collect::<Vec<_>>(), [0, 1]);
            assert!(is_close(across[0].end, 0.65), "{across:?}");
            let reversed = walker.trace_line([3.0, 0.5, 0.25], [-4.0, 0.0, 0.25], start_cell);
            assert_eq!(reversed.iter().map(|p| p.cell).collect::<Vec<_>>(), [1, 0]);
            assert_eq!(reversed[0].exit_connection, Some(0));
        }
        assert!(
            walker
                .trace_line([0.5, 3.0, 0.5], [1.0, 0.0, 0.0], 0)
                .is_empty()
        );
    }
}
