//! The trajectory of a well: the cells that it crosses, and its length in each.

use crate::parallel::prelude::*;

use crate::geometry::{add_scaled, dot, norm, sub};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::model::reservoir::Model;

/// Largest sine of the angle between a direction and a plane that counts as parallel.
const MAX_PARALLEL_SINE: f64 = 1e-12;
/// Segments shorter than this fraction of a leg are rounding errors.
const MIN_SEGMENT_SHARE: f64 = 1e-10;

/// The trajectory of a well, in the model's metres: straight legs between points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    /// The name of the well in errors and decks.
    pub name: String,
    /// At least two points; consecutive points differ.
    pub points: Vec<[f64; 3]>,
    /// Radius of the bore at each point.
    pub radii: Vec<f64>,
}

/// The segment of a leg that lies in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WellSegment {
    /// The cell.
    pub cell: u32,
    /// The leg, from point `leg` to point `leg + 1`.
    pub leg: u32,
    /// The start and end of the segment, as fractions of the leg.
    pub span: [f64; 2],
}

impl Trajectory {
    /// Returns the start of a leg, and its vector from start to end.
    pub fn leg(&self, leg: usize) -> ([f64; 3], [f64; 3]) {
        let [a, b] = [self.points[leg], self.points[leg + 1]];
        (a, sub(b, a))
    }

    /// Returns the number of legs.
    pub fn leg_count(&self) -> usize {
        self.points.len().saturating_sub(1)
    }

    /// Returns the total length in metres.
    pub fn length(&self) -> f64 {
        (0..self.leg_count()).map(|leg| norm(self.leg(leg).1)).sum()
    }

    /// Returns the trajectory with its first and last leg extended by `reach` at the ends of the
    /// well.
    pub fn extended(&self, reach: f64) -> Self {
        let mut extended = self.clone();
        if let (Some(first), Some(last)) =
            (extended.points.first_mut(), self.leg_count().checked_sub(1))
        {
            let (a, d) = self.leg(0);
            *first = add_scaled(a, -reach / norm(d), d);
            let (a, d) = self.leg(last);
            extended.points[last + 1] = add_scaled(a, 1.0 + reach / norm(d), d);
        }
        extended
    }
}

/// Finds the cells that trajectories cross. One tracer serves all wells of a model.
pub struct WellTracer<'a> {
    pub(super) model: &'a Model,
    faces: Lists,
    /// Distance from each cell's site to the farthest of its nodes.
    cell_radius: Vec<f64>,
}

impl<'a> WellTracer<'a> {
    /// Prepares the tracer for the cells of a model.
    pub fn new(model: &'a Model) -> Self {
        let faces = model.mesh.faces_of_cells();
        let mesh: &PolyMesh<3> = &model.mesh;
        let radius = |cell: usize| {
            let nodes = faces
                .get(cell)
                .iter()
                .flat_map(|&f| mesh.faces.get(f as usize));
            let distances = nodes.map(|&n| norm(sub(mesh.nodes[n as usize], mesh.sites[cell])));
            distances.fold(0.0, f64::max)
        };
        let cell_radius = (0..model.len()).into_par_iter().map(radius).collect();
        Self {
            model,
            faces,
            cell_radius,
        }
    }

    /// Returns the faces of a cell.
    pub fn faces(&self, cell: usize) -> &[u32] {
        self.faces.get(cell)
    }

    /// Returns a point on the face, its normal out of the cell, and whether the cell is the face's
    /// owner. Returns `None` for a boundary face that is too small to have a direction.
    fn plane(&self, cell: usize, face: usize) -> Option<([f64; 3], [f64; 3], bool)> {
        let graph = &self.model.graph;
        match graph.connections.get(face) {
            Some(c) if c.cells[0] as usize == cell => Some((c.point, c.normal, true)),
            Some(c) => Some((c.point, c.normal.map(|n| -n), false)),
            None => {
                let f = &graph.boundary[face - graph.connections.len()];
                let distance = norm(sub(f.point, graph.site[cell]));
                (f.area > (1e-4 * distance).powi(2)).then_some((f.point, f.normal, true))
            }
        }
    }

    /// Returns the part of the line from `a` along `d` that lies in a cell. A line in the common
    /// face of two cells belongs to the first of them.
    fn clip(&self, cell: usize, a: [f64; 3], d: [f64; 3]) -> Option<[f64; 2]> {
        let [mut start, mut end] = [0.0f64, 1.0f64];
        let parallel_speed = MAX_PARALLEL_SINE * norm(d);
        for &face in self.faces(cell) {
            let Some((point, normal, is_owner)) = self.plane(cell, face as usize) else {
                continue;
            };
            let outside = dot(normal, sub(a, point));
            let speed = dot(normal, d);
            if speed.abs() <= parallel_speed {
                if outside > 0.0 || (outside == 0.0 && !is_owner) {
                    return None;
                }
            } else if speed > 0.0 {
                end = end.min(-outside / speed);
            } else {
                start = start.max(-outside / speed);
            }
        }
        (end - start > MIN_SEGMENT_SHARE).then_some([start, end])
    }

    /// Returns the segments of a trajectory in the order along it. Parts outside the mesh are in no
    /// segment.
    pub fn segments(&self, trajectory: &Trajectory) -> Vec<WellSegment> {
        let sites = &self.model.graph.site;
        let mut segments = Vec::new();
        for leg in 0..trajectory.leg_count() {
            let (a, d) = trajectory.leg(leg);
            let square = dot(d, d);
            let segment_in = |cell: usize| {
                let offset = sub(sites[cell], a);
                let fraction = (dot(offset, d) / square).clamp(0.0, 1.0);
                if norm(add_scaled(offset, -fraction, d)) > self.cell_radius[cell] {
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
            let mut leg_segments: Vec<WellSegment> = cells.filter_map(segment_in).collect();
            leg_segments.sort_by(|p, q| p.span[0].total_cmp(&q.span[0]));
            segments.extend(leg_segments);
        }
        segments
    }
}
