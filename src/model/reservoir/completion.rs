//! Well indices: the exchange of fluid between a well and each cell to which it is open.
//!
//! Around a well, pressure changes with the logarithm of the distance r from it. Two-point fluxes
//! do not resolve that inside a cell: the pressure of the well's cell is the exact one at some
//! distance r_o, the equivalent radius. It follows from the mass balance of the cell, if its
//! neighbours have the exact pressures at their sites (Peaceman 1978 for squares; Palagi and Aziz
//! 1994 for PEBI grids):
//!
//! ```text
//! sum_j T_j (ln r_j - ln r_o) = 2 pi k L,    index = 2 pi k L / ln(r_o / radius)
//! ```
//!
//! Here T_j are the transmissibilities to neighbours whose sites are at the distance r_j from the
//! well, and L is the length of the well in the cell. In a prism around a vertical well, T_j = k L
//! b_j / h_j, and this gives ln r_o = (sum b_j/h_j ln h_j - 2 pi) / sum b_j/h_j: 0.208 times the
//! side of a square (0.198 is exact for an infinite grid). The implementation differs in these
//! points:
//!
//! - T_j are those of the model with open faults; if the well continues into the neighbour, the r_o
//!   of the neighbour is an unknown, too.
//! - Neighbours on the straight continuation of the well count as if the well continued there.
//! - Distances, lengths and the bore are those in the space in which the rock is isotropic: x' =
//!   sqrt(k/K) x, with k the geometric mean (Peaceman 1983). Wells may deviate.
//! - A side of the box along the well acts as a mirror; a well on a side drains only the angle
//!   inside the box.
//! - Tetrahedra, whose two-point fluxes resolve the pressure poorly, count as square columns of
//!   their volume along the well.

use std::f64::consts::TAU;

use super::trajectory::{Trajectory, WellSegment, WellTracer};
use crate::error::cause;
use crate::geometry::conjugate_gradients::LinearSystem;
use crate::geometry::{add_scaled, cross, dot, norm, sub};
use crate::model::flow::Tensor;
use crate::model::reservoir::Permeability;
use crate::{Error, Result};

/// Equivalent radius of a square cell over its side (Peaceman 1978).
const SQUARE_RADIUS_RATIO: f64 = 0.2;

/// The completion of a well in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Completion {
    /// The cell.
    pub cell: u32,
    /// Length of the well in the cell, in metres.
    pub length: f64,
    /// The well index in m^3: rate times viscosity over the difference between the pressures of cell
    /// and well.
    pub index: f64,
    /// Permeability times length times the angle in which fluid flows to the well, in m^3: with the
    /// skin factor S, the index is 1 / (1 / `index` + S / `strength`).
    pub strength: f64,
    /// The equivalent radius in metres (in the rescaled space if the rock is anisotropic).
    pub equivalent_radius: f64,
}

/// The segments of a well in one cell, merged.
struct WellInCell {
    cell: usize,
    length: f64,
    /// Sum of the vectors along its segments.
    direction: [f64; 3],
    middle: [f64; 3],
    radius: f64,
    /// Permeability times length, both in the rescaled space.
    strength: f64,
    /// Radius of the bore in the rescaled space.
    bore_radius: f64,
    /// The fraction of the full angle around the well that lies inside the box.
    open_angle_share: f64,
    space: IsotropicSpace,
}

/// The space in which rock with the permeability K is isotropic.
#[derive(Clone, Copy)]
struct IsotropicSpace {
    /// Geometric mean of the permeabilities along the principal axes.
    mean_permeability: f64,
    /// `mean_permeability` K^-1, the metric.
    metric: Tensor,
    /// K / `mean_permeability`, the inverse of the metric.
    inverse: Tensor,
}

impl IsotropicSpace {
    fn new(k: &Tensor) -> Self {
        let [xx, yy, zz, xy, yz, xz] = k.0;
        let minors = [
            yy * zz - yz * yz,
            xx * zz - xz * xz,
            xx * yy - xy * xy,
            xz * yz - xy * zz,
            xy * xz - xx * yz,
            xy * yz - xz * yy,
        ];
        let determinant = xx * minors[0] + xy * minors[3] + xz * minors[5];
        let mean_permeability = determinant.cbrt();
        Self {
            mean_permeability,
            metric: Tensor(minors.map(|m| m / determinant * mean_permeability)),
            inverse: k.scaled(1.0 / mean_permeability),
        }
    }

    fn dot(&self, a: [f64; 3], b: [f64; 3]) -> f64 {
        dot(a, self.metric.times(b))
    }

    fn length(&self, a: [f64; 3]) -> f64 {
        self.dot(a, a).sqrt()
    }

    /// Returns the radius of a bore along `d` that is a circle of radius 1 in metres. In this space
    /// it is an ellipse, and the radius is the mean of its half axes.
    fn bore_radius(&self, d: [f64; 3]) -> f64 {
        let min_axis = (0..3).fold(0, |k, l| if d[l].abs() < d[k].abs() { l } else { k });
        let mut axis = [0.0; 3];
        axis[min_axis] = 1.0;
        let u = cross(d, axis);
        let u = u.map(|c| c / norm(u));
        let v = cross(d, u).map(|c| c / norm(d));
        let square = self.dot(d, d);
        let projected = |a, b| self.dot(a, b) - self.dot(a, d) * self.dot(b, d) / square;
        let (uu, vv, uv) = (projected(u, u), projected(v, v), projected(u, v));
        0.5 * (uu + vv + 2.0 * (uu * vv - uv * uv).max(0.0).sqrt()).sqrt()
    }

    /// Returns the distance of a point from a trajectory whose first and last legs extend to
    /// infinity.
    fn distance(&self, trajectory: &Trajectory, x: [f64; 3]) -> f64 {
        let last = trajectory.leg_count() - 1;
        let leg_distance = |leg: usize| {
            let (a, d) = trajectory.leg(leg);
            let x = sub(x, a);
            let low = if leg == 0 { f64::NEG_INFINITY } else { 0.0 };
            let high = if leg == last { f64::INFINITY } else { 1.0 };
            let fraction = (self.dot(x, d) / self.dot(d, d)).clamp(low, high);
            self.length(add_scaled(x, -fraction, d))
        };
        (0..=last).map(leg_distance).fold(f64::INFINITY, f64::min)
    }

    /// Returns the mirror image of a point in a plane through `point` with this normal.
    fn mirror_image(&self, x: [f64; 3], point: [f64; 3], normal: [f64; 3]) -> [f64; 3] {
        let conormal = self.inverse.times(normal);
        add_scaled(
            x,
            -2.0 * dot(normal, sub(x, point)) / dot(normal, conormal),
            conormal,
        )
    }

    /// Returns the distance of `x` from a plane through `point` with this normal.
    fn plane_distance(&self, x: [f64; 3], point: [f64; 3], normal: [f64; 3]) -> f64 {
        (dot(normal, sub(x, point)) / self.inverse.normal_component(normal).sqrt()).abs()
    }
}

impl WellTracer<'_> {
    /// Returns the completions of a well in all cells that it crosses, in the order along the well.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the model has no permeability, if the well lies outside the
    /// mesh or in inactive cells only, or if its radius is not below a cell's equivalent radius.
    pub fn complete(&self, trajectory: &Trajectory) -> Result<Vec<Completion>> {
        self.completions(trajectory, &self.segments(trajectory))
    }

    /// Returns the completion of a vertical well through a cell's site, in that cell only.
    ///
    /// # Errors
    /// Returns [`Error::Export`] in the same cases as [`complete`](Self::complete).
    pub fn complete_cell(&self, name: &str, cell: usize, radius: f64) -> Result<Vec<Completion>> {
        let model = self.model;
        let site = model.graph.site[cell];
        let size = model.graph.volume[cell].cbrt();
        let upright = Trajectory {
            name: name.into(),
            points: vec![site, add_scaled(site, -size, [0.0, 0.0, 1.0])],
            radii: vec![radius; 2],
        };
        let trajectory = upright.extended(1e3 * size);
        let segments = self.segments(&trajectory).into_iter();
        let cell_segments: Vec<WellSegment> =
            segments.filter(|p| p.cell as usize == cell).collect();
        self.completions(&trajectory, &cell_segments)
    }

    fn completions(
        &self,
        trajectory: &Trajectory,
        segments: &[WellSegment],
    ) -> Result<Vec<Completion>> {
        let permeability = self.model.need_permeability(&trajectory.name)?;
        if segments.is_empty() {
            return Err(Error::Export(cause(
                &trajectory.name,
                "lies outside the mesh",
                "give points inside, in the mesh's coordinates (`atomesh info` shows its extent)",
            )));
        }
        let active = segments
            .iter()
            .filter(|p| self.model.is_active(p.cell as usize));
        let active: Vec<WellSegment> = active.copied().collect();
        if active.is_empty() {
            return Err(Error::Export(cause(
                &trajectory.name,
                format!(
                    "lies in inactive rock only: porosity or permeability is 0 in cell {}",
                    segments[0].cell
                ),
                "give points in other cells",
            )));
        }
        let well_cells = self.merge_by_cell(permeability, trajectory, &active);
        let radii = self.log_equivalent_radii(permeability, trajectory, &well_cells)?;
        well_cells
            .iter()
            .zip(radii)
            .map(|(w, log_radius)| {
                let log_ratio = log_radius - w.bore_radius.ln();
                if log_ratio.is_nan() || log_ratio <= 0.0 {
                    return Err(Error::Export(cause(
                        &trajectory.name,
                        format!(
                            "has a radius of {} m in cell {}, whose equivalent radius is {:.3} m",
                            w.radius,
                            w.cell,
                            log_radius.exp() * w.radius / w.bore_radius
                        ),
                        "give a smaller radius, or larger cells around the well",
                    )));
                }
                Ok(Completion {
                    cell: w.cell as u32,
                    length: w.length,
                    index: TAU * w.open_angle_share * w.strength / log_ratio,
                    strength: TAU * w.open_angle_share * w.strength,
                    equivalent_radius: log_radius.exp(),
                })
            })
            .collect()
    }

    /// Merges the segments of each cell. Cells are in the order in which the well first enters
    /// them.
    fn merge_by_cell(
        &self,
        permeability: &Permeability,
        trajectory: &Trajectory,
        segments: &[WellSegment],
    ) -> Vec<WellInCell> {
        let mut well_cells: Vec<WellInCell> = Vec::new();
        for segment in segments {
            let cell = segment.cell as usize;
            let index = well_cells.iter().rposition(|w| w.cell == cell);
            let index = index.unwrap_or_else(|| {
                let space = IsotropicSpace::new(permeability.rock.mobility(cell));
                well_cells.push(WellInCell {
                    cell,
                    length: 0.0,
                    direction: [0.0; 3],
                    middle: [0.0; 3],
                    radius: 0.0,
                    strength: 0.0,
                    bore_radius: 0.0,
                    open_angle_share: 1.0,
                    space,
                });
                well_cells.len() - 1
            });
            let w = &mut well_cells[index];
            let leg = segment.leg as usize;
            let (a, d) = trajectory.leg(leg);
            let [start, end] = segment.span;
            let fraction = 0.5 * (start + end);
            let vector = d.map(|c| c * (end - start));
            let length = norm(vector);
            let [r, s] = [trajectory.radii[leg], trajectory.radii[leg + 1]];
            w.direction = add_scaled(w.direction, 1.0, vector);
            w.middle = add_scaled(w.middle, length, add_scaled(a, fraction, d));
            w.radius += length * (r + fraction * (s - r));
            w.strength += w.space.mean_permeability * w.space.length(vector);
            w.bore_radius += length * (r + fraction * (s - r)) * w.space.bore_radius(d);
            w.length += length;
        }
        for w in &mut well_cells {
            w.middle = w.middle.map(|c| c / w.length);
            w.radius /= w.length;
            w.bore_radius /= w.length;
            for (point, normal) in self.mirror_planes(w) {
                if w.space.plane_distance(w.middle, point, normal) < w.bore_radius {
                    w.open_angle_share *= 0.5;
                }
            }
        }
        well_cells
    }

    /// Returns a point and the normal of each side of the box at a cell that the well runs along.
    fn mirror_planes(&self, w: &WellInCell) -> Vec<([f64; 3], [f64; 3])> {
        let graph = &self.model.graph;
        let inner = graph.connections.len();
        let outer = self.faces(w.cell).iter().filter(|&&f| f as usize >= inner);
        outer
            .map(|&f| &graph.boundary[f as usize - inner])
            .filter(|f| dot(f.normal, w.direction).abs() < 0.5 * norm(w.direction) && f.area > 0.0)
            .map(|f| (f.point, f.normal))
            .collect()
    }

    /// Returns the logarithm of each cell's equivalent radius.
    fn log_equivalent_radii(
        &self,
        permeability: &Permeability,
        trajectory: &Trajectory,
        well_cells: &[WellInCell],
    ) -> Result<Vec<f64>> {
        let (graph, rock) = (&self.model.graph, &permeability.rock);
        if self.model.tets.is_some() {
            let log_radius = |w: &WellInCell| {
                let length = w.strength / w.space.mean_permeability;
                (SQUARE_RADIUS_RATIO * (graph.volume[w.cell] / length).sqrt()).ln()
            };
            return Ok(well_cells.iter().map(log_radius).collect());
        }
        let index_of = |cell: u32| well_cells.iter().position(|w| w.cell == cell as usize);
        let size = graph.volume.iter().sum::<f64>().cbrt();
        let segments = self.segments(&trajectory.extended(1e3 * size));
        let is_in_line = |cell: u32| segments.iter().any(|p| p.cell == cell);

        // The linear system has one row for each cell: its couplings with other cells of the well,
        // the sum of all its transmissibilities, and the right side.
        let mut couplings: Vec<Vec<(usize, f64)>> = Vec::with_capacity(well_cells.len());
        let (mut diagonal, mut right_side) = (Vec::new(), Vec::new());
        for w in well_cells {
            let mirrors = self.mirror_planes(w);
            let mirrors: Vec<_> = mirrors
                .into_iter()
                .map(|(point, n)| (point, n, 2.0 * w.space.plane_distance(w.middle, point, n)))
                .filter(|m| m.2 >= 2.0 * w.bore_radius)
                .collect();
            let (mut row, mut sum) = (Vec::new(), 0.0);
            let mut known = -TAU * w.open_angle_share * w.strength;
            for &face in self.faces(w.cell) {
                let Some(c) = graph.connections.get(face as usize) else {
                    continue;
                };
                let k = c
                    .cells
                    .map(|cell| rock.mobility(cell as usize).normal_component(c.normal));
                let t = c.area / (c.distance[0] / k[0] + c.distance[1] / k[1]);
                let other = c.cells[usize::from(c.cells[0] as usize == w.cell)];
                if let Some(index) = index_of(other) {
                    row.push((index, t));
                } else if is_in_line(other) {
                    continue;
                } else {
                    let site = graph.site[other as usize];
                    let mut log = w.space.distance(trajectory, site).ln();
                    for &(point, normal, separation) in &mirrors {
                        let image = w.space.mirror_image(site, point, normal);
                        log += (w.space.distance(trajectory, image) / separation).ln();
                    }
                    known += t * log;
                }
                sum += t;
            }
            couplings.push(row);
            diagonal.push(sum);
            right_side.push(known);
        }
        solve_couplings(&couplings, &diagonal, &right_side).ok_or_else(|| {
            Error::Export(cause(
                &trajectory.name,
                "fills all the cells around it, so that it has no well index",
                "make smaller cells there",
            ))
        })
    }
}

/// Solves `diagonal x - couplings x = right_side` by conjugate gradients. Returns `None` if the
/// system is singular.
fn solve_couplings(
    couplings: &[Vec<(usize, f64)>],
    diagonal: &[f64],
    right_side: &[f64],
) -> Option<Vec<f64>> {
    let n = right_side.len();
    let times = |x: &[f64]| -> Vec<f64> {
        let row = |i: usize| {
            let off_diagonal: f64 = couplings[i].iter().map(|&(j, t)| t * x[j]).sum();
            diagonal[i] * x[i] - off_diagonal
        };
        (0..n).map(row).collect()
    };
    let system = LinearSystem {
        times,
        diagonal,
        right_side,
    };
    let mut x = system.preconditioned(right_side);
    // The tolerance is 12 digits of the energy norm; 8 digits are accepted.
    let tolerance = 1e-24 * system.squared_norm(right_side).max(f64::MIN_POSITIVE);
    let square = system.improve(&mut x, tolerance, 20 * n + 20);
    (square <= 1e8 * tolerance && x.iter().all(|x| x.is_finite())).then_some(x)
}
