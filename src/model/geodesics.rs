//! Shortest paths through the cells of a mesh, around surfaces that they must not cross.
//!
//! A path is straight from its source, or from its last turning point, to the centre of a cell, if
//! the straight line crosses only open faces. Otherwise the path turns in the centre of the
//! previous cell. So distances are exact wherever a point is visible from a source, whatever the
//! size of the cells. Each turn makes them too long by a fraction of a cell. Paths along links
//! between cell centres alone would be longer everywhere, by up to a half; the fewer faces a cell
//! has, the longer they would be.

use std::borrow::Borrow;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::model::surface::adjacency::CellAdjacency;

/// Shortest-path search on the cells of a mesh: the cells, borrowed or owned, and the planes of their
/// faces.
#[derive(Debug, Clone)]
pub struct Geodesics<C, const D: usize> {
    cells: C,
    /// The faces of all cells; those of cell c are `start[c]..start[c + 1]`.
    sides: Vec<CellFacePlane<D>>,
    start: Vec<u32>,
}

/// A face of one cell.
#[derive(Debug, Clone, Copy)]
struct CellFacePlane<const D: usize> {
    /// Normal, out of the cell.
    normal: [f64; D],
    /// Scalar product of the normal with points on the face.
    offset: f64,
    /// The link through the face, `NONE` on the boundary.
    link: u32,
}

/// A source of paths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeodesicSource<const D: usize> {
    /// The position.
    pub position: [f64; D],
    /// The cell that contains it.
    pub cell: u32,
    /// The label that all paths from here carry.
    pub label: u32,
}

/// Cost and label of the shortest path to each cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrivals {
    /// Cost of the shortest path to the cell's centre. It is 0 in the cell of a source, and
    /// infinite where no path arrives.
    pub cost: Vec<f64>,
    /// Label of the source of that path; the smallest one if several paths cost the same.
    pub label: Vec<Option<u32>>,
}

/// A source, or the centre of a cell in which paths turn.
struct TurningPoint<const D: usize> {
    position: [f64; D],
    cell: u32,
    cost: f64,
}

impl<const D: usize, C: Borrow<CellAdjacency<D>>> Geodesics<C, D> {
    /// Prepares the search on a mesh of convex cells. `face_cells` is the result of
    /// [`Mesh::cells_of_faces`], and `cells` are the cells of the mesh.
    pub fn new<F: Mesh<D>>(mesh: &F, face_cells: &[[u32; 2]], cells: C) -> Self {
        let nodes = mesh.nodes();
        let (mut owners, mut planes) = (Vec::new(), Vec::new());
        let mut links = 0;
        for (face, &[first, second]) in face_cells.iter().enumerate() {
            if first == NONE {
                continue;
            }
            let (mut area_vector, mut middle, mut area) = ([0.0; D], [0.0; D], 0.0);
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| nodes[n as usize]);
                let n = normal(&corners);
                let weight = norm(n);
                area += weight;
                area_vector = add_scaled(area_vector, 1.0, n);
                for corner in corners {
                    middle = add_scaled(middle, weight / D as f64, corner);
                }
            });
            let height = if area > 0.0 {
                dot(area_vector, middle) / area
            } else {
                0.0
            };
            let link = if second == NONE { NONE } else { links };
            for (cell, sign) in [(first, 1.0), (second, -1.0)] {
                if cell != NONE {
                    owners.push(cell as usize);
                    planes.push(CellFacePlane {
                        normal: area_vector.map(|c| sign * c),
                        offset: sign * height,
                        link,
                    });
                }
            }
            links += u32::from(second != NONE);
        }
        let cell_count = cells.borrow().len();
        let (start, order) = sort_by_group(cell_count, owners.iter().copied());
        let sides = order.iter().map(|&i| planes[i as usize]).collect();
        Self {
            cells,
            sides,
            start,
        }
    }

    /// Finds the shortest paths from any of the sources to the centres of all cells whose cost is
    /// at most `max_cost`. Paths cross only links for which `passes` returns `true`. The cost of a
    /// path is its length plus the `penalty` of each link that it crosses.
    pub fn shortest_paths(
        &self,
        sources: &[GeodesicSource<D>],
        passes: impl Fn(usize) -> bool,
        penalty: impl Fn(usize) -> f64,
        max_cost: f64,
    ) -> Arrivals {
        let cells = self.cells();
        let mut arrivals = Arrivals {
            cost: vec![f64::INFINITY; cells.len()],
            label: vec![None; cells.len()],
        };
        let turning_point = |s: &GeodesicSource<D>| TurningPoint {
            position: s.position,
            cell: s.cell,
            cost: 0.0,
        };
        let mut turns: Vec<TurningPoint<D>> = sources.iter().map(turning_point).collect();
        // The last turning point from which each cell was tried: neighbours mostly try the same
        // one.
        let mut last_turn = vec![NONE; cells.len()];
        // Costs are not negative, so their bits have the same order.
        let mut queue: BinaryHeap<Reverse<(u64, u32, u32, u32)>> = BinaryHeap::new();
        queue.extend(
            (0..)
                .zip(sources)
                .map(|(i, s)| Reverse((0, s.label, s.cell, i))),
        );
        while let Some(Reverse((cost, label, c, turn))) = queue.pop() {
            if arrivals.label[c as usize].is_some() {
                continue;
            }
            let cost = f64::from_bits(cost);
            arrivals.cost[c as usize] = cost;
            arrivals.label[c as usize] = Some(label);
            // Paths turn in the centre of a cell; in the cell of a source they begin at the source.
            let mut own_turn = (turns[turn as usize].cell == c).then_some(turn);
            let turn_position = own_turn.map_or(cells.centres[c as usize], |index| {
                turns[index as usize].position
            });
            for (l, _, n) in cells.links_of(c) {
                if arrivals.label[n as usize].is_some() || !passes(l) {
                    continue;
                }
                let mut improve = |new_cost: f64, via: u32, best: &mut f64| {
                    if new_cost <= max_cost && new_cost < *best {
                        *best = new_cost;
                        queue.push(Reverse((new_cost.to_bits(), label, n, via)));
                    }
                };
                if std::mem::replace(&mut last_turn[n as usize], turn) != turn {
                    let start_point = &turns[turn as usize];
                    if let Some(straight) = self.straight_cost(start_point, n, &passes, &penalty) {
                        improve(
                            start_point.cost + straight,
                            turn,
                            &mut arrivals.cost[n as usize],
                        );
                    }
                }
                // If the path is straight, this path is not shorter.
                let turned =
                    cost + norm(sub(cells.centres[n as usize], turn_position)) + penalty(l);
                if turned < arrivals.cost[n as usize] && turned <= max_cost {
                    let via = *own_turn.get_or_insert(turns.len() as u32);
                    improve(turned, via, &mut arrivals.cost[n as usize]);
                }
            }
            if own_turn == Some(turns.len() as u32) {
                turns.push(TurningPoint {
                    position: turn_position,
                    cell: c,
                    cost,
                });
            }
        }
        for (cost, label) in arrivals.cost.iter_mut().zip(&arrivals.label) {
            if label.is_none() {
                *cost = f64::INFINITY;
            }
        }
        arrivals
    }

    /// Returns the cells.
    pub fn cells(&self) -> &CellAdjacency<D> {
        self.cells.borrow()
    }

    /// Returns the cost of the straight path to the centre of a cell, or `None` if the path crosses
    /// a closed face.
    fn straight_cost(
        &self,
        start_point: &TurningPoint<D>,
        target: u32,
        passes: impl Fn(usize) -> bool,
        penalty: impl Fn(usize) -> f64,
    ) -> Option<f64> {
        let direction = sub(self.cells().centres[target as usize], start_point.position);
        let (mut cell, mut entry_link, mut cost) = (start_point.cell, None, norm(direction));
        // Because of rounding, the walk may circle around an edge endlessly.
        let max_steps = 64 + 8 * self.cells().len().isqrt();
        for _ in 0..max_steps {
            if cell == target {
                return Some(cost);
            }
            let sides = self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize;
            let (mut exit_distance, mut exit_link) = (f64::INFINITY, NONE);
            for side in &self.sides[sides] {
                let rise = dot(side.normal, direction);
                if rise > 0.0 && entry_link != Some(side.link) {
                    let distance = (side.offset - dot(side.normal, start_point.position)) / rise;
                    if distance < exit_distance {
                        (exit_distance, exit_link) = (distance, side.link);
                    }
                }
            }
            if exit_link == NONE || !passes(exit_link as usize) {
                return None;
            }
            cost += penalty(exit_link as usize);
            entry_link = Some(exit_link);
            let [a, b] = self.cells().links[exit_link as usize].cells;
            cell = if a == cell { b } else { a };
        }
        None
    }
}

#[cfg(test)]
#[path = "geodesics_tests.rs"]
mod tests;
