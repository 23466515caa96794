//! Balls round the nodes of a surface, whose spheres meet in mirror points of its facets.

use crate::parallel::prelude::*;

use super::surface::FacetSurface;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, sub, unit};
use crate::mesh::poly::Lists;

/// The height of points over their facets that radii aim at, in units of the edges, ...
const TARGET_SITE_HEIGHT: f64 = 0.3;
/// ... the share of it that they have at first if the largest radius allows, ...
const INITIAL_HEIGHT_SHARE: f64 = 0.6;
/// ... and the least height that will do. No point is nearer to a side of the box, either.
const MIN_SITE_HEIGHT: f64 = 0.08;
/// The largest radius, in units of the edges.
const MAX_RADIUS: f64 = 0.9;
/// No facet makes balls larger than this circle round it would (the square, in units of the edges).
const MAX_SQUARED_CIRCUMRADIUS: f64 = 0.45;
/// Points shall be outside of balls by this difference of squares, in units of the edges: where two are hardly
/// parted by a ball, one will have to go ...
const COVER_MARGIN: f64 = 0.08;
/// ... but that is this much of a fault only.
const NEAR_COVER_PENALTY: f64 = 0.3;
/// Rounds in which sizes and radii become those of their neighbourhood.
const SMOOTHING_ROUNDS: usize = 2;
/// Rounds in which radii grow where spheres do not meet.
const GROWTH_ROUNDS: usize = 20;
/// Rounds in which radii change where points are covered.
const ADJUSTMENT_ROUNDS: usize = 30;
/// By how much: the squares of radii become so many times as large.
const SQUARED_RADIUS_FACTORS: [f64; 10] =
    [0.8, 0.88, 0.94, 0.98, 0.995, 1.005, 1.02, 1.06, 1.12, 1.25];
/// Balls may grow and points move by so much (as a factor) before one covers another that was not near.
const MAX_GROWTH_FACTOR: f64 = 1.3;
/// A sphere through a point does not cover it: off by rounding at most.
const ROUNDING_TOLERANCE: f64 = 1e-9;

/// Balls round the nodes of a surface in the box `[0, extent]`.
#[derive(Debug)]
pub struct Balls<const D: usize> {
    /// The surface.
    pub surface: FacetSurface<D>,
    /// The squares of their radii.
    pub squared_radii: Vec<f64>,
    extent: [f64; D],
    /// The length of edges at each node.
    edge_lengths: Vec<f64>,
    /// The facets at each node.
    facets_of_nodes: Lists,
    /// For each facet the nodes, but its own, whose balls may cover its points.
    candidate_nodes: Lists,
}

impl<const D: usize> Balls<D> {
    /// Balls such that few of them cover the points of facets.
    pub fn new(surface: FacetSurface<D>, extent: [f64; D]) -> Self {
        let mut balls = Self {
            squared_radii: Vec::new(),
            extent,
            edge_lengths: smooth_values(&surface, surface.edge_lengths()),
            facets_of_nodes: surface.facets_of_nodes(),
            candidate_nodes: Lists::default(),
            surface,
        };
        let radii = (0..balls.edge_lengths.len()).map(|n| balls.initial_radius(n));
        let radii = smooth_values(&balls.surface, radii.collect());
        balls.squared_radii = radii.iter().map(|r| r * r).collect();
        for _ in 0..GROWTH_ROUNDS {
            if !balls.grow_radii() {
                break;
            }
        }
        balls.candidate_nodes = balls.find_candidates();
        balls.adjust_radii();
        balls
    }

    /// The far corner of the box.
    pub fn extent(&self) -> [f64; D] {
        self.extent
    }

    /// The largest radius.
    pub fn max_radius(&self) -> f64 {
        let largest = self
            .squared_radii
            .iter()
            .fold(0.0f64, |most, &w| most.max(w));
        largest.sqrt()
    }

    /// The length of edges at a facet.
    pub fn edge_length(&self, f: usize) -> f64 {
        let nodes = self.surface.facets[f];
        nodes
            .iter()
            .map(|&n| self.edge_lengths[n as usize])
            .sum::<f64>()
            / D as f64
    }

    /// The two points of a facet, above and below it, if both are fit for sites: in no ball, inside the
    /// box, and not too near to the facet.
    pub fn facet_points(&self, f: usize) -> Option<[[f64; D]; 2]> {
        if self.max_depth(f) > 0.0 {
            return None;
        }
        let (centre, square) = self.sphere_intersection(f)?;
        Some(self.mirror_points(f, centre, square))
    }

    /// Whether a ball holds a point.
    pub fn covers(&self, n: usize, x: &[f64; D]) -> bool {
        distance2(x, &self.surface.nodes[n]) < self.squared_radii[n] * (1.0 - ROUNDING_TOLERANCE)
    }

    /// The point in the plane of a facet at which the spheres round the ridge opposite its node k meet
    /// beyond that ridge.
    pub fn rim_point(&self, f: usize, k: usize) -> Option<[f64; D]> {
        let x = self.surface.corners(f);
        let nodes = self.surface.facets[f].map(|n| self.squared_radii[n as usize]);
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
        let room = MIN_SITE_HEIGHT * self.edge_length(f);
        let inside = (0..D).all(|k| point[k] > room && point[k] < self.extent[k] - room);
        (square > room * room && inside).then_some(point)
    }

    /// The radius that the facets at a node ask for.
    fn initial_radius(&self, n: usize) -> f64 {
        let square = self.edge_lengths[n].powi(2);
        let star = self.facets_of_nodes.get(n);
        let circle = |&f: &u32| {
            let met = sphere_intersection(&self.surface.corners(f as usize), &[0.0; D]);
            met.map_or(f64::INFINITY, |(_, height)| -height)
                .min(MAX_SQUARED_CIRCUMRADIUS * square)
        };
        let mean = star.iter().map(circle).sum::<f64>() / star.len().max(1) as f64;
        (mean + TARGET_SITE_HEIGHT * TARGET_SITE_HEIGHT * square).sqrt()
    }

    /// Lets balls grow where spheres do not meet, or hardly; whether any did.
    fn grow_radii(&mut self) -> bool {
        let mut grown = false;
        for f in 0..self.surface.facets.len() {
            let want = (INITIAL_HEIGHT_SHARE * TARGET_SITE_HEIGHT * self.edge_length(f)).powi(2);
            let Some((_, height)) = self.sphere_intersection(f).filter(|m| m.1 < want) else {
                continue;
            };
            for n in self.surface.facets[f].map(|n| n as usize) {
                let most = (MAX_RADIUS * self.edge_lengths[n]).powi(2);
                let to = (self.squared_radii[n] + want - height).min(most);
                grown |= to > self.squared_radii[n];
                self.squared_radii[n] = to.max(self.squared_radii[n]);
            }
        }
        grown
    }

    fn find_candidates(&self) -> Lists {
        let nodes = &self.surface.nodes;
        let largest = self
            .squared_radii
            .iter()
            .fold(0.0f64, |m, &w| m.max(w))
            .sqrt();
        let grid = CellList::new(nodes, largest.max(f64::MIN_POSITIVE));
        let near = |f: usize| {
            let mut near = Vec::new();
            if let Some((centre, height)) = self.sphere_intersection(f) {
                let height = height.max(0.0).sqrt();
                grid.visit_within(centre, MAX_GROWTH_FACTOR * (largest + height), |n| {
                    let reach = MAX_GROWTH_FACTOR * (self.squared_radii[n].sqrt() + height);
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
    fn sphere_intersection(&self, f: usize) -> Option<([f64; D], f64)> {
        let squares = self.surface.facets[f].map(|n| self.squared_radii[n as usize]);
        sphere_intersection(&self.surface.corners(f), &squares)
    }

    fn mirror_points(&self, f: usize, centre: [f64; D], square: f64) -> [[f64; D]; 2] {
        let (up, height) = (self.surface.unit_normal(f), square.sqrt());
        [height, -height].map(|h| add_scaled(centre, h, up))
    }

    /// What is wrong with a facet: between 1 and 2 if one of its points is not fit for a site, less if one
    /// is but nearly covered.
    fn fault_score(&self, f: usize) -> f64 {
        match self.max_depth(f) {
            depth if depth > 0.0 => 1.0 + depth.min(1.0),
            depth if depth > -COVER_MARGIN => NEAR_COVER_PENALTY * (1.0 + depth / COVER_MARGIN),
            _ => 0.0,
        }
    }

    /// How deep, at most, a point of a facet lies in a ball, as the difference of squares in units of the
    /// edges; or how much it lacks of the least height and of that distance from the sides of the box.
    fn max_depth(&self, f: usize) -> f64 {
        let size = self.edge_length(f);
        let Some((centre, square)) = self.sphere_intersection(f) else {
            return 1.0;
        };
        let lacks = (MIN_SITE_HEIGHT * MIN_SITE_HEIGHT - square / (size * size)).min(1.0);
        if lacks > 0.0 {
            return lacks;
        }
        let mut deepest = -COVER_MARGIN;
        for x in self.mirror_points(f, centre, square) {
            for k in 0..D {
                let out = (MIN_SITE_HEIGHT * size - x[k])
                    .max(x[k] - self.extent[k] + MIN_SITE_HEIGHT * size);
                deepest = deepest.max(out / size);
            }
            for n in self.candidate_nodes.get(f).iter().map(|&n| n as usize) {
                let within = self.squared_radii[n] * (1.0 - ROUNDING_TOLERANCE);
                let depth = within - distance2(&x, &self.surface.nodes[n]);
                deepest = deepest.max(depth / (size * size));
            }
        }
        deepest
    }

    /// Changes radii, one after the other, as long as that takes faults away.
    fn adjust_radii(&mut self) {
        let (nodes, facets) = (self.surface.nodes.len(), self.surface.facets.len());
        let mut touched: Vec<Vec<u32>> = (0..nodes)
            .map(|n| self.facets_of_nodes.get(n).to_vec())
            .collect();
        for f in 0..facets {
            let near = self.candidate_nodes.get(f).iter();
            near.for_each(|&n| touched[n as usize].push(f as u32));
        }
        let mut faults: Vec<f64> = (0..facets).map(|f| self.fault_score(f)).collect();
        for _ in 0..ADJUSTMENT_ROUNDS {
            let mut asked = vec![false; nodes];
            for f in (0..facets).filter(|&f| faults[f] > 0.0) {
                let around = self.surface.facets[f]
                    .iter()
                    .chain(self.candidate_nodes.get(f));
                around.for_each(|&n| asked[n as usize] = true);
            }
            let mut better = false;
            for n in (0..nodes).filter(|&n| asked[n]) {
                let own = self.squared_radii[n];
                let before: f64 = touched[n].iter().map(|&f| faults[f as usize]).sum();
                let mut best = (before - ROUNDING_TOLERANCE, own);
                for to in SQUARED_RADIUS_FACTORS.map(|factor| own * factor) {
                    if to > (MAX_RADIUS * self.edge_lengths[n]).powi(2) {
                        continue;
                    }
                    self.squared_radii[n] = to;
                    let mut after = 0.0;
                    for &f in &touched[n] {
                        after += self.fault_score(f as usize);
                        if after >= best.0 {
                            break;
                        }
                    }
                    if after < best.0 {
                        best = (after, to);
                    }
                }
                self.squared_radii[n] = best.1;
                if best.1 != own {
                    better = true;
                    for &f in &touched[n] {
                        faults[f as usize] = self.fault_score(f as usize);
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
fn smooth_values<const D: usize>(surface: &FacetSurface<D>, mut values: Vec<f64>) -> Vec<f64> {
    for _ in 0..SMOOTHING_ROUNDS {
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
fn sphere_intersection<const D: usize>(
    x: &[[f64; D]; D],
    squares: &[f64; D],
) -> Option<([f64; D], f64)> {
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
