//! Shortest ways through the cells of a mesh, round the surfaces that may not be crossed.
//!
//! A way is straight from where it began, or from where it last had to turn, to the centre of a cell,
//! as far as a straight line crosses only open faces; else it turns in the centre of the cell before.
//! So distances are exact wherever a point is seen from a source, whatever the size of the cells, and
//! too long by a part of a cell for each turn. Ways along links alone would be longer everywhere, by
//! up to a half, the more the fewer faces a cell has.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::model::surface::adjacency::CellAdjacency;

/// Cells, and the planes of their faces.
#[derive(Debug, Clone)]
pub struct Geodesics<'a, const D: usize> {
    cells: &'a CellAdjacency<D>,
    /// The sides of each cell, from its start to the next one's.
    sides: Vec<CellFacePlane<D>>,
    start: Vec<u32>,
}

/// A face as one of its cells sees it.
#[derive(Debug, Clone, Copy)]
struct CellFacePlane<const D: usize> {
    /// Points out of the cell.
    normal: [f64; D],
    /// Of points on the face, along the normal.
    offset: f64,
    /// The link through it, `NONE` on the boundary.
    link: u32,
}

/// Where a way begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeodesicSource<const D: usize> {
    /// The point.
    pub position: [f64; D],
    /// The cell that holds it.
    pub cell: u32,
    /// What all ways from here carry.
    pub label: u32,
}

/// Where ways end: for each cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrivals {
    /// What the cheapest way to its centre costs; 0 in the cell of a source; infinite where none
    /// arrives.
    pub cost: Vec<f64>,
    /// The label of the source of that way; of equally cheap ones the least.
    pub label: Vec<Option<u32>>,
}

/// A source, or the centre of a cell in which ways turn.
struct TurningPoint<const D: usize> {
    position: [f64; D],
    cell: u32,
    cost: f64,
}

impl<'a, const D: usize> Geodesics<'a, D> {
    /// Of a mesh of convex cells; `across` are those of [`Mesh::cells_of_faces`], and `cells` those
    /// of the mesh.
    pub fn new<F: Mesh<D>>(mesh: &F, across: &[[u32; 2]], cells: &'a CellAdjacency<D>) -> Self {
        let nodes = mesh.nodes();
        let (mut owners, mut found) = (Vec::new(), Vec::new());
        let mut links = 0;
        for (face, &[own, beyond]) in across.iter().enumerate() {
            if own == NONE {
                continue;
            }
            let (mut out, mut middle, mut area) = ([0.0; D], [0.0; D], 0.0);
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| nodes[n as usize]);
                let n = normal(&corners);
                let weight = norm(n);
                area += weight;
                out = add_scaled(out, 1.0, n);
                for corner in corners {
                    middle = add_scaled(middle, weight / D as f64, corner);
                }
            });
            let height = if area > 0.0 {
                dot(out, middle) / area
            } else {
                0.0
            };
            let link = if beyond == NONE { NONE } else { links };
            for (cell, sign) in [(own, 1.0), (beyond, -1.0)] {
                if cell != NONE {
                    owners.push(cell as usize);
                    found.push(CellFacePlane {
                        normal: out.map(|c| sign * c),
                        offset: sign * height,
                        link,
                    });
                }
            }
            links += u32::from(beyond != NONE);
        }
        let (start, order) = sort_by_group(cells.len(), owners.iter().copied());
        let sides = order.iter().map(|&i| found[i as usize]).collect();
        Self {
            cells,
            sides,
            start,
        }
    }

    /// Cheapest ways from any of the sources to the centres of all cells, as far as they cost at most
    /// `most`. They go through links that `passes` lets through. Each costs its length and `toll` for
    /// each link.
    pub fn shortest_paths(
        &self,
        sources: &[GeodesicSource<D>],
        passes: impl Fn(usize) -> bool,
        toll: impl Fn(usize) -> f64,
        most: f64,
    ) -> Arrivals {
        let cells = self.cells;
        let mut found = Arrivals {
            cost: vec![f64::INFINITY; cells.len()],
            label: vec![None; cells.len()],
        };
        let turn_of = |s: &GeodesicSource<D>| TurningPoint {
            position: s.position,
            cell: s.cell,
            cost: 0.0,
        };
        let mut turns: Vec<TurningPoint<D>> = sources.iter().map(turn_of).collect();
        // For each cell the last turn from which it was looked for: neighbours mostly ask for the same.
        let mut looked = vec![NONE; cells.len()];
        // Costs are not negative, so their bits are in their order.
        let mut queue: BinaryHeap<Reverse<(u64, u32, u32, u32)>> = BinaryHeap::new();
        queue.extend(
            (0..)
                .zip(sources)
                .map(|(i, s)| Reverse((0, s.label, s.cell, i))),
        );
        while let Some(Reverse((cost, label, c, turn))) = queue.pop() {
            if found.label[c as usize].is_some() {
                continue;
            }
            let cost = f64::from_bits(cost);
            found.cost[c as usize] = cost;
            found.label[c as usize] = Some(label);
            // Ways that turn here do so in the centre; in a source's cell they begin at the source.
            let mut own = (turns[turn as usize].cell == c).then_some(turn);
            let here = own.map_or(cells.centres[c as usize], |own| {
                turns[own as usize].position
            });
            for (l, _, n) in cells.links_of(c) {
                if found.label[n as usize].is_some() || !passes(l) {
                    continue;
                }
                let mut better = |there: f64, by: u32, known: &mut f64| {
                    if there <= most && there < *known {
                        *known = there;
                        queue.push(Reverse((there.to_bits(), label, n, by)));
                    }
                };
                if std::mem::replace(&mut looked[n as usize], turn) != turn {
                    let from = &turns[turn as usize];
                    if let Some(straight) = self.straight_cost(from, n, &passes, &toll) {
                        better(from.cost + straight, turn, &mut found.cost[n as usize]);
                    }
                }
                // Where the way is straight, this is not shorter.
                let turned = cost + norm(sub(cells.centres[n as usize], here)) + toll(l);
                if turned < found.cost[n as usize] && turned <= most {
                    let by = *own.get_or_insert(turns.len() as u32);
                    better(turned, by, &mut found.cost[n as usize]);
                }
            }
            if own == Some(turns.len() as u32) {
                turns.push(TurningPoint {
                    position: here,
                    cell: c,
                    cost,
                });
            }
        }
        for (cost, label) in found.cost.iter_mut().zip(&found.label) {
            if label.is_none() {
                *cost = f64::INFINITY;
            }
        }
        found
    }

    /// The cells.
    pub fn cells(&self) -> &'a CellAdjacency<D> {
        self.cells
    }

    /// What the straight way to the centre of a cell costs, if it crosses only what lets it through.
    fn straight_cost(
        &self,
        from: &TurningPoint<D>,
        to: u32,
        passes: impl Fn(usize) -> bool,
        toll: impl Fn(usize) -> f64,
    ) -> Option<f64> {
        let along = sub(self.cells.centres[to as usize], from.position);
        let (mut cell, mut entered, mut cost) = (from.cell, None, norm(along));
        // Rounding may lead it round and round an edge.
        let most = 64 + 8 * self.cells.len().isqrt();
        for _ in 0..most {
            if cell == to {
                return Some(cost);
            }
            let sides = self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize;
            let (mut leaves, mut through) = (f64::INFINITY, NONE);
            for side in &self.sides[sides] {
                let rise = dot(side.normal, along);
                if rise > 0.0 && entered != Some(side.link) {
                    let at = (side.offset - dot(side.normal, from.position)) / rise;
                    if at < leaves {
                        (leaves, through) = (at, side.link);
                    }
                }
            }
            if through == NONE || !passes(through as usize) {
                return None;
            }
            cost += toll(through as usize);
            entered = Some(through);
            let [a, b] = self.cells.links[through as usize].cells;
            cell = if a == cell { b } else { a };
        }
        None
    }
}

#[cfg(test)]
#[path = "ways_tests.rs"]
mod tests;
