//! Balls round the nodes of a surface, whose spheres meet in mirror points of its facets.

use crate::parallel::prelude::*;

use super::surface::Surface;
use crate::geometry::buckets::Buckets;
use crate::geometry::{add_scaled, distance2, dot, sub, unit};
use crate::mesh::poly::Lists;

/// The height of points over their facets that radii aim at, in units of the edges, ...
const HIGH: f64 = 0.3;
/// ... the share of it that they have at first if the largest radius allows, ...
const FIRST: f64 = 0.6;
/// ... and the least height that will do. No point is nearer to a side of the box, either.
const LOW: f64 = 0.08;
/// The largest radius, in units of the edges.
const WIDE: f64 = 0.9;
/// No facet makes balls larger than this circle round it would (the square, in units of the edges).
const ROUND: f64 = 0.45;
/// Points shall be outside of balls by this difference of squares, in units of the edges: where two are hardly
/// parted by a ball, one will have to go ...
const MARGIN: f64 = 0.08;
/// ... but that is this much of a fault only.
const NEARLY: f64 = 0.3;
/// Rounds in which sizes and radii become those of their neighbourhood.
const SMOOTH: usize = 2;
/// Rounds in which radii grow where spheres do not meet.
const GROW: usize = 20;
/// Rounds in which radii change where points are covered.
const ROUNDS: usize = 30;
/// By how much: the squares of radii become so many times as large.
const FACTORS: [f64; 10] = [0.8, 0.88, 0.94, 0.98, 0.995, 1.005, 1.02, 1.06, 1.12, 1.25];
/// Balls may grow and points move by so much (as a factor) before one covers another that was not near.
const GROWTH: f64 = 1.3;
/// A sphere through a point does not cover it: off by rounding at most.
const ROUNDING: f64 = 1e-9;

/// Balls round the nodes of a surface in the box `[0, extent]`.
#[derive(Debug)]
pub struct Balls<const D: usize> {
    /// The surface.
    pub surface: Surface<D>,
    /// The squares of their radii.
    pub squares: Vec<f64>,
    extent: [f64; D],
    /// The length of edges at each node.
    sizes: Vec<f64>,
    /// The facets at each node.
    stars: Lists,
    /// For each facet the nodes, but its own, whose balls may cover its points.
    near: Lists,
}

impl<const D: usize> Balls<D> {
    /// Balls such that few of them cover the points of facets.
    pub fn new(surface: Surface<D>, extent: [f64; D]) -> Self {
        let mut balls = Self {
            squares: Vec::new(),
            extent,
            sizes: smoothed(&surface, surface.sizes()),
            stars: surface.stars(),
            near: Lists::default(),
            surface,
        };
        let radii = (0..balls.sizes.len()).map(|n| balls.first_radius(n));
        let radii = smoothed(&balls.surface, radii.collect());
        balls.squares = radii.iter().map(|r| r * r).collect();
        for _ in 0..GROW {
            if !balls.grow() {
                break;
            }
        }
        balls.near = balls.found_near();
        balls.settle();
        balls
    }

    /// The far corner of the box.
    pub fn extent(&self) -> [f64; D] {
        self.extent
    }

    /// The largest radius.
    pub fn largest(&self) -> f64 {
        let largest = self.squares.iter().fold(0.0f64, |most, &w| most.max(w));
        largest.sqrt()
    }

    /// The length of edges at a facet.
    pub fn size(&self, f: usize) -> f64 {
        let nodes = self.surface.facets[f];
        nodes.iter().map(|&n| self.sizes[n as usize]).sum::<f64>() / D as f64
    }

    /// The two points of a facet, above and below it, if both are fit for sites: in no ball, inside the
    /// box, and not too near to the facet.
    pub fn points(&self, f: usize) -> Option<[[f64; D]; 2]> {
        if self.deepest(f) > 0.0 {
            return None;
        }
        let (centre, square) = self.meeting(f)?;
        Some(self.above_and_below(f, centre, square))
    }

    /// Whether a ball holds a point.
    pub fn covers(&self, n: usize, x: &[f64; D]) -> bool {
        distance2(x, &self.surface.nodes[n]) < self.squares[n] * (1.0 - ROUNDING)
    }

    /// The point in the plane of a facet at which the spheres round the ridge opposite its node k meet
    /// beyond that ridge.
    pub fn beyond(&self, f: usize, k: usize) -> Option<[f64; D]> {
        let x = self.surface.corners(f);
        let nodes = self.surface.facets[f].map(|n| self.squares[n as usize]);
        let (i, j) = ((k + 1) % D, (k + 2) % D);
        let (mut foot, mut along) = (x[i], [0.0; D]);
        if D == 3 {
            let edge = sub(x[j], x[i]);
            let long = dot(edge, edge);
            let share = 0.5 * (long + nodes[i] - nodes[j]) / long;
            foot = add_scaled(x[i], share, edge);
            along = unit(edge);
        }
        let square = nodes[i] - distance2(&foot, &x[i]);
        let inward = sub(x[k], x[i]);
        let inward = unit(add_scaled(inward, -dot(inward, along), along));
        let point = add_scaled(foot, -square.max(0.0).sqrt(), inward);
        let room = LOW * self.size(f);
        let inside = (0..D).all(|k| point[k] > room && point[k] < self.extent[k] - room);
        (square > room * room && inside).then_some(point)
    }

    /// The radius that the facets at a node ask for.
    fn first_radius(&self, n: usize) -> f64 {
        let square = self.sizes[n].powi(2);
        let star = self.stars.get(n);
        let circle = |&f: &u32| {
            let met = meeting(&self.surface.corners(f as usize), &[0.0; D]);
            met.map_or(f64::INFINITY, |(_, height)| -height)
                .min(ROUND * square)
        };
        let mean = star.iter().map(circle).sum::<f64>() / star.len().max(1) as f64;
        (mean + HIGH * HIGH * square).sqrt()
    }

    /// Lets balls grow where spheres do not meet, or hardly; whether any did.
    fn grow(&mut self) -> bool {
        let mut grown = false;
        for f in 0..self.surface.facets.len() {
            let want = (FIRST * HIGH * self.size(f)).powi(2);
            let Some((_, height)) = self.meeting(f).filter(|m| m.1 < want) else {
                continue;
            };
            for n in self.surface.facets[f].map(|n| n as usize) {
                let most = (WIDE * self.sizes[n]).powi(2);
                let to = (self.squares[n] + want - height).min(most);
                grown |= to > self.squares[n];
                self.squares[n] = to.max(self.squares[n]);
            }
        }
        grown
    }

    fn found_near(&self) -> Lists {
        let nodes = &self.surface.nodes;
        let largest = self.squares.iter().fold(0.0f64, |m, &w| m.max(w)).sqrt();
        let grid = Buckets::new(nodes, largest.max(f64::MIN_POSITIVE));
        let near = |f: usize| {
            let mut near = Vec::new();
            if let Some((centre, height)) = self.meeting(f) {
                let height = height.max(0.0).sqrt();
                grid.visit_within(centre, GROWTH * (largest + height), |n| {
                    let reach = GROWTH * (self.squares[n].sqrt() + height);
                    let own = self.surface.facets[f].contains(&(n as u32));
                    if !own && distance2(&nodes[n], &centre) < reach * reach {
                        near.push(n as u32);
                    }
                });
                near.sort_unstable();
            }
            near
        };
        let count = self.surface.facets.len();
        let found: Vec<Vec<u32>> = (0..count).into_par_iter().map(near).collect();
        let mut lists = Lists::default();
        found.into_iter().for_each(|near| lists.push(near));
        lists
    }

    /// Where the spheres of a facet meet.
    fn meeting(&self, f: usize) -> Option<([f64; D], f64)> {
        let squares = self.surface.facets[f].map(|n| self.squares[n as usize]);
        meeting(&self.surface.corners(f), &squares)
    }

    fn above_and_below(&self, f: usize, centre: [f64; D], square: f64) -> [[f64; D]; 2] {
        let (up, height) = (self.surface.up(f), square.sqrt());
        [height, -height].map(|h| add_scaled(centre, h, up))
    }

    /// What is wrong with a facet: between 1 and 2 if one of its points is not fit for a site, less if one
    /// is but nearly covered.
    fn fault(&self, f: usize) -> f64 {
        match self.deepest(f) {
            depth if depth > 0.0 => 1.0 + depth.min(1.0),
            depth if depth > -MARGIN => NEARLY * (1.0 + depth / MARGIN),
            _ => 0.0,
        }
    }

    /// How deep, at most, a point of a facet lies in a ball, as the difference of squares in units of the
    /// edges; or how much it lacks of the least height and of that distance from the sides of the box.
    fn deepest(&self, f: usize) -> f64 {
        let size = self.size(f);
        let Some((centre, square)) = self.meeting(f) else {
            return 1.0;
        };
        let lacks = (LOW * LOW - square / (size * size)).min(1.0);
        if lacks > 0.0 {
            return lacks;
        }
        let mut deepest = -MARGIN;
        for x in self.above_and_below(f, centre, square) {
            for k in 0..D {
                let out = (LOW * size - x[k]).max(x[k] - self.extent[k] + LOW * size);
                deepest = deepest.max(out / size);
            }
            for n in self.near.get(f).iter().map(|&n| n as usize) {
                let within = self.squares[n] * (1.0 - ROUNDING);
                let depth = within - distance2(&x, &self.surface.nodes[n]);
                deepest = deepest.max(depth / (size * size));
            }
        }
        deepest
    }

    /// Changes radii, one after the other, as long as that takes faults away.
    fn settle(&mut self) {
        let (nodes, facets) = (self.surface.nodes.len(), self.surface.facets.len());
        let mut touched: Vec<Vec<u32>> = (0..nodes).map(|n| self.stars.get(n).to_vec()).collect();
        for f in 0..facets {
            let near = self.near.get(f).iter();
            near.for_each(|&n| touched[n as usize].push(f as u32));
        }
        let mut faults: Vec<f64> = (0..facets).map(|f| self.fault(f)).collect();
        for _ in 0..ROUNDS {
            let mut asked = vec![false; nodes];
            for f in (0..facets).filter(|&f| faults[f] > 0.0) {
                let around = self.surface.facets[f].iter().chain(self.near.get(f));
                around.for_each(|&n| asked[n as usize] = true);
            }
            let mut better = false;
            for n in (0..nodes).filter(|&n| asked[n]) {
                let own = self.squares[n];
                let before: f64 = touched[n].iter().map(|&f| faults[f as usize]).sum();
                let mut best = (before - ROUNDING, own);
                for to in FACTORS.map(|factor| own * factor) {
                    if to > (WIDE * self.sizes[n]).powi(2) {
                        continue;
                    }
                    self.squares[n] = to;
                    let mut after = 0.0;
                    for &f in &touched[n] {
                        after += self.fault(f as usize);
                        if after >= best.0 {
                            break;
                        }
                    }
                    if after < best.0 {
                        best = (after, to);
                    }
                }
                self.squares[n] = best.1;
                if best.1 != own {
                    better = true;
                    for &f in &touched[n] {
                        faults[f as usize] = self.fault(f as usize);
                    }
                }
            }
            if !better {
                break;
            }
        }
    }
}

/// Means over nodes and their neighbours.
fn smoothed<const D: usize>(surface: &Surface<D>, mut values: Vec<f64>) -> Vec<f64> {
    for _ in 0..SMOOTH {
        let mut sums: Vec<(f64, f64)> = values.iter().map(|&value| (value, 1.0)).collect();
        for facet in &surface.facets {
            let sum: f64 = facet.iter().map(|&n| values[n as usize]).sum();
            for &n in facet {
                sums[n as usize].0 += sum / D as f64;
                sums[n as usize].1 += 1.0;
            }
        }
        values = sums.iter().map(|(sum, count)| sum / count).collect();
    }
    values
}

/// Where the spheres of a facet's nodes meet, given the squares of their radii: in two points, mirror
/// images in the facet. Gives the point half-way, and the square of the height of the two above and below
/// it, which is negative if they do not meet. `None` if the facet has no area.
fn meeting<const D: usize>(x: &[[f64; D]; D], squares: &[f64; D]) -> Option<([f64; D], f64)> {
    let u: [[f64; D]; D] = std::array::from_fn(|k| sub(x[k], x[0]));
    // (c - x0) . u_k = (|u_k|^2 + w_0 - w_k) / 2.
    let right: [f64; D] =
        std::array::from_fn(|k| 0.5 * (dot(u[k], u[k]) + squares[0] - squares[k]));
    let mut from = [0.0; D];
    if D == 2 {
        let long = dot(u[1], u[1]);
        if long <= 0.0 {
            return None;
        }
        from = u[1].map(|c| c * right[1] / long);
    } else {
        let [a, b, c] = [dot(u[1], u[1]), dot(u[1], u[2]), dot(u[2], u[2])];
        let det = a * c - b * b;
        if det <= 1e-12 * a * c {
            return None;
        }
        let s = (c * right[1] - b * right[2]) / det;
        let t = (a * right[2] - b * right[1]) / det;
        for k in 0..D {
            from[k] = s * u[1][k] + t * u[2][k];
        }
    }
    let centre = std::array::from_fn(|k| x[0][k] + from[k]);
    Some((centre, squares[0] - dot(from, from)))
}
