//! What a well gives to, or takes from, each cell that it is open to.
//!
//! Round a well, pressure falls as the logarithm of the distance r from it. Two-point fluxes do not
//! see that inside a cell: the pressure of the well's cell is the true one at some distance r_o, its
//! equivalent radius. It follows from the cell's balance if its neighbours have the pressures that
//! are true where their sites are (Peaceman 1978 for squares; Palagi and Aziz 1994 for PEBI grids):
//!
//! ```text
//! sum_j T_j (ln r_j - ln r_o) = 2 pi k L,    index = 2 pi k L / ln(r_o / radius)
//! ```
//!
//! with T_j the transmissibilities to neighbours whose sites are r_j away from the well, and L its
//! length in the cell. In a prism round an upright well, T_j = k L b_j / h_j, and this is
//! ln r_o = (sum b_j/h_j ln h_j - 2 pi) / sum b_j/h_j: 0.208 of the side of a square (0.198 is exact
//! for an endless grid). Here
//!
//! - T_j are the model's own, faults open; where the well goes on into the neighbour, its r_o is an unknown, too;
//! - neighbours that lie on the well's straight continuation count as if it went on there;
//! - distances, lengths and the bore are those in the space where rock conducts alike in all
//!   directions: x' = sqrt(k/K) x, k the geometric mean (Peaceman 1983); wells may deviate;
//! - a side of the box along the well acts as a mirror; a well on it drains only the angle inside;
//! - tetrahedra, whose two-point fluxes do not see the pressure that well, count as square columns of
//!   their volume along the well.

use std::f64::consts::TAU;

use super::trajectory::{Trajectory, WellSegment, WellTracer};
use crate::error::cause;
use crate::geometry::{add_scaled, cross, dot, norm, sub};
use crate::model::flow::Tensor;
use crate::model::reservoir::Permeability;
use crate::{Error, Result};

/// Equivalent radius of a square cell over its side (Peaceman 1978).
const SQUARE_RADIUS_RATIO: f64 = 0.2;

/// A well in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Completion {
    /// The cell.
    pub cell: u32,
    /// Length of the well in the cell, in metres.
    pub length: f64,
    /// The well index in m^3: rate times viscosity over the difference between the pressures of cell
    /// and well.
    pub index: f64,
    /// The equivalent radius in metres (of a space that is rescaled where the rock is not alike in all
    /// directions).
    pub equivalent_radius: f64,
}

/// The parts of a well in one cell, together.
struct WellInCell {
    cell: usize,
    length: f64,
    /// From where to where it goes in all.
    direction: [f64; 3],
    middle: [f64; 3],
    radius: f64,
    /// Permeability times length, both of the rescaled space.
    strength: f64,
    /// Radius of the bore in the rescaled space.
    bore_radius: f64,
    /// The share of the full angle that is open.
    open_angle_share: f64,
    space: IsotropicSpace,
}

/// Lengths in the space where rock of permeability K conducts alike in all directions.
#[derive(Clone, Copy)]
struct IsotropicSpace {
    /// Geometric mean of the permeabilities along the principal axes.
    mean_permeability: f64,
    /// mean K^-1, the metric.
    metric: Tensor,
    /// K / mean.
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

    /// The radius of a round bore of radius 1 along `d`: the mean of the half axes of the ellipse that
    /// it is here.
    fn bore_radius(&self, d: [f64; 3]) -> f64 {
        let least = (0..3).fold(0, |k, l| if d[l].abs() < d[k].abs() { l } else { k });
        let mut axis = [0.0; 3];
        axis[least] = 1.0;
        let u = cross(d, axis);
        let u = u.map(|c| c / norm(u));
        let v = cross(d, u).map(|c| c / norm(d));
        let square = self.dot(d, d);
        let across = |a, b| self.dot(a, b) - self.dot(a, d) * self.dot(b, d) / square;
        let (uu, vv, uv) = (across(u, u), across(v, v), across(u, v));
        0.5 * (uu + vv + 2.0 * (uu * vv - uv * uv).max(0.0).sqrt()).sqrt()
    }

    /// Distance of a point from a way whose ends go on for ever.
    fn distance(&self, way: &Trajectory, x: [f64; 3]) -> f64 {
        let last = way.leg_count() - 1;
        let off = |leg: usize| {
            let (a, d) = way.leg(leg);
            let x = sub(x, a);
            let low = if leg == 0 { f64::NEG_INFINITY } else { 0.0 };
            let high = if leg == last { f64::INFINITY } else { 1.0 };
            let share = (self.dot(x, d) / self.dot(d, d)).clamp(low, high);
            self.length(add_scaled(x, -share, d))
        };
        (0..=last).map(off).fold(f64::INFINITY, f64::min)
    }

    /// A point's image in the plane of a face.
    fn mirror_image(&self, x: [f64; 3], on: [f64; 3], normal: [f64; 3]) -> [f64; 3] {
        let turned = self.inverse.times(normal);
        add_scaled(
            x,
            -2.0 * dot(normal, sub(x, on)) / dot(normal, turned),
            turned,
        )
    }

    /// Distance from a point to a plane.
    fn plane_distance(&self, x: [f64; 3], on: [f64; 3], normal: [f64; 3]) -> f64 {
        (dot(normal, sub(x, on)) / self.inverse.normal_component(normal).sqrt()).abs()
    }
}

impl WellTracer<'_> {
    /// The completions of a well in all cells that it crosses, in the order in which it does.
    ///
    /// # Errors
    /// [`Error::Export`] if there is not a permeability, the well lies outside the mesh, or is as wide as
    /// a cell's equivalent radius.
    pub fn complete(&self, way: &Trajectory) -> Result<Vec<Completion>> {
        self.completions(way, &self.segments(way))
    }

    /// The completion of an upright well through a cell's site, in that cell only.
    ///
    /// # Errors
    /// As [`complete`](Self::complete).
    pub fn complete_cell(&self, name: &str, cell: usize, radius: f64) -> Result<Vec<Completion>> {
        let model = self.model;
        let site = model.graph.site[cell];
        let size = model.graph.volume[cell].cbrt();
        let upright = Trajectory {
            name: name.into(),
            points: vec![site, add_scaled(site, -size, [0.0, 0.0, 1.0])],
            radii: vec![radius; 2],
        };
        let way = upright.extended(1e3 * size);
        let pieces = self.segments(&way).into_iter();
        let own: Vec<WellSegment> = pieces.filter(|p| p.cell as usize == cell).collect();
        self.completions(&way, &own)
    }

    fn completions(&self, way: &Trajectory, pieces: &[WellSegment]) -> Result<Vec<Completion>> {
        let permeability = self.model.need_permeability(&way.name)?;
        if pieces.is_empty() {
            return Err(Error::Export(cause(
                &way.name,
                "lies outside the mesh",
                "give points inside, in the mesh's coordinates (`atomesh info` shows its extent)",
            )));
        }
        let active = pieces
            .iter()
            .filter(|p| self.model.is_active(p.cell as usize));
        let active: Vec<WellSegment> = active.copied().collect();
        if active.is_empty() {
            return Err(Error::Export(cause(
                &way.name,
                format!(
                    "lies in inactive rock only: porosity or permeability is 0 in cell {}",
                    pieces[0].cell
                ),
                "give points in other cells",
            )));
        }
        let within = self.merge_by_cell(permeability, way, &active);
        let radii = self.log_equivalent_radii(permeability, way, &within)?;
        within
            .iter()
            .zip(radii)
            .map(|(w, log_radius)| {
                let over = log_radius - w.bore_radius.ln();
                if over.is_nan() || over <= 0.0 {
                    return Err(Error::Export(cause(
                        &way.name,
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
                    index: TAU * w.open_angle_share * w.strength / over,
                    equivalent_radius: log_radius.exp(),
                })
            })
            .collect()
    }

    /// The pieces by cell, in the order in which cells are first met.
    fn merge_by_cell(
        &self,
        permeability: &Permeability,
        way: &Trajectory,
        pieces: &[WellSegment],
    ) -> Vec<WellInCell> {
        let mut all: Vec<WellInCell> = Vec::new();
        for piece in pieces {
            let cell = piece.cell as usize;
            let at = all.iter().rposition(|w| w.cell == cell);
            let at = at.unwrap_or_else(|| {
                let space = IsotropicSpace::new(permeability.rock.mobility(cell));
                all.push(WellInCell {
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
                all.len() - 1
            });
            let w = &mut all[at];
            let leg = piece.leg as usize;
            let (a, d) = way.leg(leg);
            let [from, to] = piece.span;
            let share = 0.5 * (from + to);
            let part = d.map(|c| c * (to - from));
            let length = norm(part);
            let [r, s] = [way.radii[leg], way.radii[leg + 1]];
            w.direction = add_scaled(w.direction, 1.0, part);
            w.middle = add_scaled(w.middle, length, add_scaled(a, share, d));
            w.radius += length * (r + share * (s - r));
            w.strength += w.space.mean_permeability * w.space.length(part);
            w.bore_radius += length * (r + share * (s - r)) * w.space.bore_radius(d);
            w.length += length;
        }
        for w in &mut all {
            w.middle = w.middle.map(|c| c / w.length);
            w.radius /= w.length;
            w.bore_radius /= w.length;
            for (on, normal) in self.mirror_planes(w) {
                if w.space.plane_distance(w.middle, on, normal) < w.bore_radius {
                    w.open_angle_share *= 0.5;
                }
            }
        }
        all
    }

    /// The sides of the box at a cell that the well runs along: a point and the normal of each.
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

    /// The logarithm of each cell's equivalent radius.
    fn log_equivalent_radii(
        &self,
        permeability: &Permeability,
        way: &Trajectory,
        within: &[WellInCell],
    ) -> Result<Vec<f64>> {
        let (graph, rock) = (&self.model.graph, &permeability.rock);
        if self.model.tets.is_some() {
            let of = |w: &WellInCell| {
                let length = w.strength / w.space.mean_permeability;
                (SQUARE_RADIUS_RATIO * (graph.volume[w.cell] / length).sqrt()).ln()
            };
            return Ok(within.iter().map(of).collect());
        }
        let number = |cell: u32| within.iter().position(|w| w.cell == cell as usize);
        let size = graph.volume.iter().sum::<f64>().cbrt();
        let all = self.segments(&way.extended(1e3 * size));
        let in_line = |cell: u32| all.iter().any(|p| p.cell == cell);

        // A row a cell: its couplings with others, their sum and that with what is known; the right
        // side.
        let mut couplings: Vec<Vec<(usize, f64)>> = Vec::with_capacity(within.len());
        let (mut diagonal, mut right) = (Vec::new(), Vec::new());
        for w in within {
            let mirrors = self.mirror_planes(w);
            let mirrors: Vec<_> = mirrors
                .into_iter()
                .map(|(on, n)| (on, n, 2.0 * w.space.plane_distance(w.middle, on, n)))
                .filter(|m| m.2 >= 2.0 * w.bore_radius)
                .collect();
            let (mut own, mut sum) = (Vec::new(), 0.0);
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
                if let Some(other) = number(other) {
                    own.push((other, t));
                } else if in_line(other) {
                    continue;
                } else {
                    let site = graph.site[other as usize];
                    let mut log = w.space.distance(way, site).ln();
                    for &(on, normal, apart) in &mirrors {
                        let image = w.space.mirror_image(site, on, normal);
                        log += (w.space.distance(way, image) / apart).ln();
                    }
                    known += t * log;
                }
                sum += t;
            }
            couplings.push(own);
            diagonal.push(sum);
            right.push(known);
        }
        solve_couplings(&couplings, &diagonal, &right).ok_or_else(|| {
            Error::Export(cause(
                &way.name,
                "fills all the cells around it, so that it has no well index",
                "make smaller cells there",
            ))
        })
    }
}

/// Solves `diagonal x - couplings x = right` by conjugate gradients; `None` if that is singular.
fn solve_couplings(
    couplings: &[Vec<(usize, f64)>],
    diagonal: &[f64],
    right: &[f64],
) -> Option<Vec<f64>> {
    let n = right.len();
    let product = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let times = |x: &[f64]| -> Vec<f64> {
        let row = |i: usize| {
            let off: f64 = couplings[i].iter().map(|&(j, t)| t * x[j]).sum();
            diagonal[i] * x[i] - off
        };
        (0..n).map(row).collect()
    };
    let scaled = |r: &[f64]| -> Vec<f64> { r.iter().zip(diagonal).map(|(r, d)| r / d).collect() };
    let mut x = scaled(right);
    let mut residual: Vec<f64> = times(&x).iter().zip(right).map(|(a, b)| b - a).collect();
    let mut z = scaled(&residual);
    let mut direction = z.clone();
    let mut square = product(&residual, &z);
    // Of the energy: 12 digits; 8 will do.
    let goal = 1e-24 * product(right, &scaled(right)).max(f64::MIN_POSITIVE);
    for _ in 0..20 * n + 20 {
        if square <= goal {
            break;
        }
        let turned = times(&direction);
        let step = square / product(&direction, &turned);
        for i in 0..n {
            x[i] += step * direction[i];
            residual[i] -= step * turned[i];
        }
        z = scaled(&residual);
        let next = product(&residual, &z);
        let ratio = next / square;
        square = next;
        for i in 0..n {
            direction[i] = z[i] + ratio * direction[i];
        }
    }
    (square <= 1e8 * goal && x.iter().all(|x| x.is_finite())).then_some(x)
}
