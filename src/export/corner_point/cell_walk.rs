//! Straight lines through the cells of a model: from cell to cell through their faces.

use crate::geometry::{dot, sub};
use crate::mesh::graph::Graph;
use crate::mesh::poly::{Lists, PolyMesh};

/// No walk to a point takes more steps.
const MAX_STEPS: usize = 10_000;

/// A part of a line in one cell: from `start` to `end`, as shares of the line's direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineSegment {
    /// The cell.
    pub cell: u32,
    /// Where it begins.
    pub start: f64,
    /// Where it ends.
    pub end: f64,
    /// The connection by which the line leaves, if there is one.
    pub exit_connection: Option<u32>,
}

/// Cells and their faces, which are taken to be convex and flat.
pub struct CellWalker<'a> {
    graph: &'a Graph<3>,
    faces: Lists,
}

/// A face as a cell sees it.
struct CellSide {
    point: [f64; 3],
    /// Outwards.
    normal: [f64; 3],
    neighbour: Option<u32>,
}

impl<'a> CellWalker<'a> {
    /// For the cells of a mesh and their graph.
    pub fn new(mesh: &PolyMesh<3>, graph: &'a Graph<3>) -> Self {
        Self {
            graph,
            faces: mesh.faces_of_cells(),
        }
    }

    /// The sides of a cell, each with the number of its face.
    fn sides(&self, cell: u32) -> impl Iterator<Item = (u32, CellSide)> + '_ {
        let (inner, outer) = (&self.graph.connections, &self.graph.boundary);
        self.faces.get(cell as usize).iter().map(move |&f| {
            let side = match inner.get(f as usize) {
                Some(c) if c.cells[0] == cell => CellSide {
                    point: c.point,
                    normal: c.normal,
                    neighbour: Some(c.cells[1]),
                },
                Some(c) => CellSide {
                    point: c.point,
                    normal: c.normal.map(|n| -n),
                    neighbour: Some(c.cells[0]),
                },
                None => {
                    let face = &outer[f as usize - inner.len()];
                    CellSide {
                        point: face.point,
                        normal: face.normal,
                        neighbour: None,
                    }
                }
            };
            (f, side)
        })
    }

    /// The cell that holds a point, walking from another one; for a point outside, a cell that is next
    /// to it.
    pub fn cell_at(&self, point: [f64; 3], from: u32) -> u32 {
        let mut cell = from;
        for _ in 0..MAX_STEPS {
            let mut farthest = (1e-9 * self.graph.volume[cell as usize].cbrt(), None);
            for (_, side) in self.sides(cell) {
                let off = dot(sub(point, side.point), side.normal);
                if side.neighbour.is_some() && off > farthest.0 {
                    farthest = (off, side.neighbour);
                }
            }
            match farthest.1 {
                Some(next) => cell = next,
                None => break,
            }
        }
        cell
    }

    /// Where the line enters a cell and leaves it, each with the face.
    fn cell_crossing(
        &self,
        cell: u32,
        at: [f64; 3],
        along: [f64; 3],
    ) -> [(f64, Option<(u32, CellSide)>); 2] {
        let [mut enters, mut leaves] = [(f64::NEG_INFINITY, None), (f64::INFINITY, None)];
        let parallel = 1e-12 * dot(along, along).sqrt();
        let rounding = 1e-9 * self.graph.volume[cell as usize].cbrt();
        for (f, side) in self.sides(cell) {
            let speed = dot(along, side.normal);
            let inside = dot(sub(side.point, at), side.normal);
            if speed.abs() <= parallel && inside < -rounding {
                // Beside the cell all along.
                return [enters, (f64::NEG_INFINITY, None)];
            }
            let share = inside / speed;
            if speed > parallel && share < leaves.0 {
                leaves = (share, Some((f, side)));
            } else if speed < -parallel && share > enters.0 {
                enters = (share, Some((f, side)));
            }
        }
        [enters, leaves]
    }

    /// All pieces of the line from `at` along `along`, in order, wherever it is in the mesh; the walk
    /// begins in the middle of it, and goes there from the cell `from`.
    pub fn trace_line(&self, at: [f64; 3], along: [f64; 3], from: u32) -> Vec<LineSegment> {
        let middle = std::array::from_fn(|k| at[k] + 0.5 * along[k]);
        let first = self.cell_at(middle, from);
        // From a cell on, in one direction.
        let pieces = |first: u32, along: [f64; 3], at: [f64; 3]| {
            let mut pieces: Vec<LineSegment> = Vec::new();
            let (mut cell, mut reached) = (first, f64::NEG_INFINITY);
            for _ in 0..MAX_STEPS {
                let [enters, leaves] = self.cell_crossing(cell, at, along);
                let start = enters.0.max(reached);
                let out = leaves.1.filter(|_| leaves.0 > f64::NEG_INFINITY);
                if leaves.0 > start {
                    reached = leaves.0;
                    pieces.push(LineSegment {
                        cell,
                        start,
                        end: leaves.0,
                        exit_connection: out
                            .as_ref()
                            .filter(|o| o.1.neighbour.is_some())
                            .map(|o| o.0),
                    });
                }
                match out.and_then(|(_, side)| side.neighbour) {
                    Some(next) => cell = next,
                    None => break,
                }
            }
            pieces
        };
        let end = std::array::from_fn(|k| at[k] + along[k]);
        let backwards = pieces(first, along.map(|d| -d), end);
        let forwards = pieces(first, along, at);
        let mut all: Vec<LineSegment> = Vec::with_capacity(backwards.len() + forwards.len());
        for (i, back) in backwards.iter().enumerate().skip(1).rev() {
            all.push(LineSegment {
                cell: back.cell,
                start: 1.0 - back.end,
                end: 1.0 - back.start,
                exit_connection: backwards[i - 1].exit_connection,
            });
        }
        all.extend(forwards);
        all
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
        let walk = CellWalker::new(&mesh, &graph);
        assert_eq!(walk.cell_at([1.9, 0.1, 0.1], 0), 1);
        assert_eq!(walk.cell_at([-3.0, 0.1, 0.1], 1), 0);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        for from in [0, 1] {
            let line = walk.trace_line([-1.0, 0.5, 0.25], [4.0, 0.0, 0.25], from);
            let [a, b] = line[..] else { panic!("{line:?}") };
            assert_eq!(
                [(a.cell, a.exit_connection), (b.cell, b.exit_connection)],
                [(0, Some(0)), (1, None)]
            );
            assert!(near(a.start, 0.25) && near(a.end, 1.75 / 4.0), "{a:?}");
            assert!(near(b.start, 1.75 / 4.0) && near(b.end, 0.75), "{b:?}");
            let back = walk.trace_line([3.0, 0.5, 0.25], [-4.0, 0.0, 0.25], from);
            assert_eq!(back.iter().map(|p| p.cell).collect::<Vec<_>>(), [1, 0]);
            assert_eq!(back[0].exit_connection, Some(0));
        }
        assert!(
            walk.trace_line([0.5, 3.0, 0.5], [1.0, 0.0, 0.0], 0)
                .is_empty()
        );
    }
}
