//! The way of a well through cells: which it crosses, and how far it goes in each.

use crate::parallel::prelude::*;

use crate::geometry::{add_scaled, dot, norm, sub};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::model::reservoir::Model;

/// A direction is along a plane if its sine is no more than this.
const MAX_PARALLEL_SINE: f64 = 1e-12;
/// Shares of a leg no longer than this are rounding.
const MIN_SEGMENT_SHARE: f64 = 1e-10;

/// A well's way, in the model's metres: straight legs between points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    /// What errors and the deck call it.
    pub name: String,
    /// At least two points, none at the place of the one before.
    pub points: Vec<[f64; 3]>,
    /// Radius of the bore at each point.
    pub radii: Vec<f64>,
}

/// The part of a leg that lies in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellSegment {
    /// The cell.
    pub cell: u32,
    /// The leg: from point `leg` to point `leg + 1`.
    pub leg: u32,
    /// Where it begins and ends, in shares of the leg.
    pub span: [f64; 2],
}

impl Trajectory {
    /// Start and direction (as long as the leg) of a leg.
    pub fn leg(&self, leg: usize) -> ([f64; 3], [f64; 3]) {
        let [a, b] = [self.points[leg], self.points[leg + 1]];
        (a, sub(b, a))
    }

    /// Number of legs.
    pub fn leg_count(&self) -> usize {
        self.points.len().saturating_sub(1)
    }

    /// Its whole length.
    pub fn length(&self) -> f64 {
        (0..self.leg_count()).map(|leg| norm(self.leg(leg).1)).sum()
    }

    /// The same with its first and its last leg longer by `reach` at the well's ends.
    pub fn extended(&self, reach: f64) -> Self {
        let mut longer = self.clone();
        if let (Some(first), Some(last)) =
            (longer.points.first_mut(), self.leg_count().checked_sub(1))
        {
            let (a, d) = self.leg(0);
            *first = add_scaled(a, -reach / norm(d), d);
            let (a, d) = self.leg(last);
            longer.points[last + 1] = add_scaled(a, 1.0 + reach / norm(d), d);
        }
        longer
    }
}

/// Finds the cells on a way; made once for all ways through a model.
pub struct WellTracer<'a> {
    pub(super) model: &'a Model,
    faces: Lists,
    /// Distance from each cell's site to the farthest of its nodes.
    cell_radius: Vec<f64>,
}

impl<'a> WellTracer<'a> {
    /// For the cells of a model.
    pub fn new(model: &'a Model) -> Self {
        let faces = model.mesh.faces_of_cells();
        let mesh: &PolyMesh<3> = &model.mesh;
        let reach = |cell: usize| {
            let nodes = faces
                .get(cell)
                .iter()
                .flat_map(|&f| mesh.faces.get(f as usize));
            let off = nodes.map(|&n| norm(sub(mesh.nodes[n as usize], mesh.sites[cell])));
            off.fold(0.0, f64::max)
        };
        let cell_radius = (0..model.len()).into_par_iter().map(reach).collect();
        Self {
            model,
            faces,
            cell_radius,
        }
    }

    /// The faces of each cell.
    pub fn faces(&self, cell: usize) -> &[u32] {
        self.faces.get(cell)
    }

    /// Point, normal out of the cell, and whether the cell is the face's owner; `None` for a face on
    /// the boundary that is too small to have a direction.
    fn plane(&self, cell: usize, face: usize) -> Option<([f64; 3], [f64; 3], bool)> {
        let graph = &self.model.graph;
        match graph.connections.get(face) {
            Some(c) if c.cells[0] as usize == cell => Some((c.point, c.normal, true)),
            Some(c) => Some((c.point, c.normal.map(|n| -n), false)),
            None => {
                let f = &graph.boundary[face - graph.connections.len()];
                let off = norm(sub(f.point, graph.site[cell]));
                (f.area > (1e-4 * off).powi(2)).then_some((f.point, f.normal, true))
            }
        }
    }

    /// The part of the line from `a` along `d` that lies in a cell. A line in the common face of two
    /// cells belongs to the first of them.
    fn clip(&self, cell: usize, a: [f64; 3], d: [f64; 3]) -> Option<[f64; 2]> {
        let [mut from, mut to] = [0.0f64, 1.0f64];
        let along = MAX_PARALLEL_SINE * norm(d);
        for &face in self.faces(cell) {
            let Some((point, normal, owner)) = self.plane(cell, face as usize) else {
                continue;
            };
            let outside = dot(normal, sub(a, point));
            let speed = dot(normal, d);
            if speed.abs() <= along {
                if outside > 0.0 || (outside == 0.0 && !owner) {
                    return None;
                }
            } else if speed > 0.0 {
                to = to.min(-outside / speed);
            } else {
                from = from.max(-outside / speed);
            }
        }
        (to - from > MIN_SEGMENT_SHARE).then_some([from, to])
    }

    /// The pieces of a way in the order in which it runs. What lies outside the mesh is in none.
    pub fn segments(&self, way: &Trajectory) -> Vec<WellSegment> {
        let sites = &self.model.graph.site;
        let mut pieces = Vec::new();
        for leg in 0..way.leg_count() {
            let (a, d) = way.leg(leg);
            let square = dot(d, d);
            let crossed = |cell: usize| {
                let off = sub(sites[cell], a);
                let share = (dot(off, d) / square).clamp(0.0, 1.0);
                if norm(add_scaled(off, -share, d)) > self.cell_radius[cell] {
                    return None;
                }
                let span = self.clip(cell, a, d)?;
                Some(WellSegment {
                    cell: cell as u32,
                    leg: leg as u32,
                    span,
                })
            };
            let cells = (0..sites.len()).into_par_iter();
            let mut own: Vec<WellSegment> = cells.filter_map(crossed).collect();
            own.sort_by(|p, q| p.span[0].total_cmp(&q.span[0]));
            pieces.extend(own);
        }
        pieces
    }
}
