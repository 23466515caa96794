//! Sphere packing on a surface (after VoroCrust, 2020): one ball around each node, such that the
//! spheres of a facet's nodes meet in two mirror points above and below the facet. These points
//! become sites.
//!
//! Input: the facets of a surface in a box. Output: the squared radii of the balls. Steps:
//!
//! 1. Each ball starts with the radius that gives its facets' points the target height; sizes and
//!    radii are smoothed over neighbours.
//! 2. Balls grow where the spheres of a facet do not meet.
//! 3. Where two surfaces cross, two facets beside the line share the point in the sharp angle between
//!    them. The balls on the line determine it, and it determines the balls around the nodes opposite
//!    the line (see [`Wedge`]).
//! 4. All balls on one line get one radius, in units of the line's edges: the largest at which hardly
//!    more points near the line are covered than at the best.
//! 5. Radii are adjusted, one ball at a time, as long as fewer points are covered by other balls or
//!    too close to their facet or the box's sides.
//!
//! Facets whose points are still not usable get no sites.

use crate::parallel::prelude::*;

use super::surface::FacetSurface;
use crate::geometry::cell_list::CellList;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, distance2, dot, sorted_distinct, sub, unit};
use crate::mesh::poly::Lists;
use std::collections::BTreeMap;

/// Height of the points over their facets that the radii aim at, in edge lengths.
const TARGET_SITE_HEIGHT: f64 = 0.3;
/// Fraction of the target height that points get at least when balls grow, if the largest radius
/// allows it.
const INITIAL_HEIGHT_SHARE: f64 = 0.6;
/// Smallest usable height of a point over its facet, in edge lengths; also the smallest distance
/// from a side of the box.
const MIN_SITE_HEIGHT: f64 = 0.08;
/// Largest radius, in edge lengths.
const MAX_RADIUS: f64 = 0.9;
/// Largest squared circumradius of a facet, in squared edge lengths, that counts for the first
/// radius: longer circles do not make balls larger.
const MAX_SQUARED_CIRCUMRADIUS: f64 = 0.45;
/// Margin by which points should be outside of balls, as a difference of squares in squared edge
/// lengths. If a ball hardly separates two points, one of them has to be removed later.
const COVER_MARGIN: f64 = 0.08;
/// Penalty for a point inside the margin, relative to the penalty for a covered point.
const NEAR_COVER_PENALTY: f64 = 0.3;
/// Number of rounds in which sizes and radii are averaged with their neighbours.
const SMOOTHING_ROUNDS: usize = 2;
/// Number of rounds in which balls grow where spheres do not meet.
const GROWTH_ROUNDS: usize = 20;
/// Radii of balls on a line that are tried, in units of the line's edges: the smallest, the step from
/// one to the next, and their number.
const LINE_RADII: (f64, f64, usize) = (0.52, 0.01, 14);
/// How far the penalty of the chosen radius may be above the least, for each shared point. Cells at
/// the line grow with the radius, so the largest such radius is chosen.
const LINE_PENALTY_TOLERANCE: f64 = 0.4;
/// Number of rounds in which radii change where points are covered.
const ADJUSTMENT_ROUNDS: usize = 30;
/// Factors of the squared radius that one adjustment tries.
const SQUARED_RADIUS_FACTORS: [f64; 10] =
    [0.8, 0.88, 0.94, 0.98, 0.995, 1.005, 1.02, 1.06, 1.12, 1.25];
/// Factor of distances by which balls may grow and points may move before a ball covers a point
/// that was not a candidate.
const MAX_GROWTH_FACTOR: f64 = 1.3;
/// Relative tolerance: a sphere through a point does not cover it.
const ROUNDING_TOLERANCE: f64 = 1e-9;

/// Balls around the nodes of a surface in the box `[0, extent]`.
#[derive(Debug)]
pub struct Balls<const D: usize> {
    /// The surface.
    pub surface: FacetSurface<D>,
    /// The squared radii of the balls.
    pub squared_radii: Vec<f64>,
    extent: [f64; D],
    /// Mean edge length at each node.
    edge_lengths: Vec<f64>,
    /// The facets at each node.
    facets_of_nodes: Lists,
    /// For each facet the nodes, except its own, whose balls may cover its points.
    candidate_nodes: Lists,
    /// The pairs of facets that share a point.
    wedges: Vec<Wedge>,
}

/// Two facets on a line where surfaces cross, which share the point in the sharp angle between them.
///
/// The spheres around the ends of their common edge meet in a circle around the edge. The shared point
/// is that of the circle which is as far from one facet as from the other. The spheres around the
/// opposite nodes pass through it, so the facets stay mirrors of their points.
#[derive(Debug, Clone)]
struct Wedge {
    facets: [u32; 2],
    /// The ends of the common edge.
    edge: [u32; 2],
    /// The nodes of the facets opposite the edge.
    opposite: [u32; 2],
}

impl<const D: usize> Balls<D> {
    /// Finds radii such that few balls cover points of facets.
    pub fn new(surface: FacetSurface<D>, extent: [f64; D]) -> Self {
        let mut balls = Self {
            squared_radii: Vec::new(),
            extent,
            edge_lengths: smooth_values(&surface, surface.edge_lengths()),
            facets_of_nodes: surface.facets_of_nodes(),
            candidate_nodes: Lists::default(),
            wedges: Vec::new(),
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
        balls.wedges = balls.find_wedges();
        (0..balls.wedges.len()).for_each(|w| balls.set_opposite_radii(w));
        balls.candidate_nodes = balls.find_candidates();
        for wedges in balls.wedges_of_lines() {
            balls.set_line_radii(&wedges);
        }
        balls.adjust_radii();
        balls
    }

    /// Returns the upper corner of the box.
    pub fn extent(&self) -> [f64; D] {
        self.extent
    }

    /// Returns the largest radius.
    pub fn max_radius(&self) -> f64 {
        let largest = self.squared_radii.iter().fold(0.0f64, |max, &w| max.max(w));
        largest.sqrt()
    }

    /// Returns the mean edge length at a facet.
    pub fn edge_length(&self, f: usize) -> f64 {
        let nodes = self.surface.facets[f];
        nodes
            .iter()
            .map(|&n| self.edge_lengths[n as usize])
            .sum::<f64>()
            / D as f64
    }

    /// Returns the two points of a facet, above and below it, if both can be sites: in no ball,
    /// inside the box, and not too close to the facet.
    pub fn facet_points(&self, f: usize) -> Option<[[f64; D]; 2]> {
        if self.max_depth(f) > 0.0 {
            return None;
        }
        let (centre, square) = self.sphere_intersection(f)?;
        Some(self.mirror_points(f, centre, square))
    }

    /// Returns `true` if the ball of node `n` contains a point.
    pub fn covers(&self, n: usize, x: &[f64; D]) -> bool {
        distance2(x, &self.surface.nodes[n]) < self.squared_radii[n] * (1.0 - ROUNDING_TOLERANCE)
    }

    /// Returns the point in the plane of facet `f`, beyond the ridge opposite its node k, at which
    /// the spheres of the ridge's nodes meet.
    pub fn rim_point(&self, f: usize, k: usize) -> Option<[f64; D]> {
        let x = self.surface.corners(f);
        let nodes = self.surface.facets[f].map(|n| self.squared_radii[n as usize]);
        let (i, j) = ((k + 1) % D, (k + 2) % D);
        let (mut foot, mut along) = (x[i], [0.0; D]);
        if D == 3 {
            let edge = sub(x[j], x[i]);
            let length2 = dot(edge, edge);
            let fraction = 0.5 * (length2 + nodes[i] - nodes[j]) / length2;
            foot = add_scaled(x[i], fraction, edge);
            along = unit(edge);
        }
        let square = nodes[i] - distance2(&foot, &x[i]);
        let inward = sub(x[k], x[i]);
        let inward = unit(add_scaled(inward, -dot(inward, along), along));
        let point = add_scaled(foot, -square.max(0.0).sqrt(), inward);
        let margin = MIN_SITE_HEIGHT * self.edge_length(f);
        let is_inside = (0..D).all(|k| point[k] > margin && point[k] < self.extent[k] - margin);
        (square > margin * margin && is_inside).then_some(point)
    }

    /// Returns the radius for which the points of the facets at a node get the target height.
    fn initial_radius(&self, n: usize) -> f64 {
        let length2 = self.edge_lengths[n].powi(2);
        let star = self.facets_of_nodes.get(n);
        let squared_radius = |&f: &u32| {
            let intersection = sphere_intersection(&self.surface.corners(f as usize), &[0.0; D]);
            intersection
                .map_or(f64::INFINITY, |(_, height)| -height)
                .min(MAX_SQUARED_CIRCUMRADIUS * length2)
        };
        let mean = star.iter().map(squared_radius).sum::<f64>() / star.len().max(1) as f64;
        (mean + TARGET_SITE_HEIGHT * TARGET_SITE_HEIGHT * length2).sqrt()
    }

    /// Makes balls grow where spheres do not meet, or hardly meet. Returns `true` if any ball grew.
    fn grow_radii(&mut self) -> bool {
        let mut grown = false;
        for f in 0..self.surface.facets.len() {
            let target = (INITIAL_HEIGHT_SHARE * TARGET_SITE_HEIGHT * self.edge_length(f)).powi(2);
            let Some((_, height)) = self.sphere_intersection(f).filter(|m| m.1 < target) else {
                continue;
            };
            for n in self.surface.facets[f].map(|n| n as usize) {
                let max_square = (MAX_RADIUS * self.edge_lengths[n]).powi(2);
                let new_square = (self.squared_radii[n] + target - height).min(max_square);
                grown |= new_square > self.squared_radii[n];
                self.squared_radii[n] = new_square.max(self.squared_radii[n]);
            }
        }
        grown
    }

    /// Returns the pairs of facets in the sharp angles of lines at which four facets meet. Each ball
    /// opposite a line belongs to one pair.
    fn find_wedges(&self) -> Vec<Wedge> {
        let surface = &self.surface;
        let ridges = surface.ridges();
        let crossings: Vec<_> = ridges.iter().filter(|r| D == 3 && r.1.len() == 4).collect();
        let mut is_on_line = vec![false; surface.nodes.len()];
        for &n in crossings.iter().flat_map(|crossing| crossing.0) {
            is_on_line[n as usize] = true;
        }
        let mut wedges = Vec::new();
        for (edge, facets) in crossings {
            let foot = surface.nodes[edge[0] as usize];
            let along = unit(sub(surface.nodes[edge[1] as usize], foot));
            let opposite = |f: u32| {
                surface.facets[f as usize]
                    .into_iter()
                    .find(|n| !edge.contains(n))
            };
            let direction = |f: u32| {
                let inward = sub(surface.nodes[opposite(f).unwrap_or(f) as usize], foot);
                unit(add_scaled(inward, -dot(inward, along), along))
            };
            let directions: Vec<[f64; D]> = facets.iter().map(|&f| direction(f)).collect();
            // The facets in order around the edge, by the angle from the first.
            let first = directions[0];
            let mut across = [0.0; D];
            for k in 0..D {
                let (i, j) = ((k + 1) % D, (k + 2) % D);
                across[k] = along[i] * first[j] - along[j] * first[i];
            }
            let angle = |d: &[f64; D]| dot(*d, across).atan2(dot(*d, first));
            let mut order: Vec<(f64, u32)> = directions
                .iter()
                .map(angle)
                .zip(facets.iter().copied())
                .collect();
            order.sort_by(|a, b| a.0.total_cmp(&b.0));
            let gap =
                |i: usize| (order[(i + 1) % 4].0 - order[i].0).rem_euclid(std::f64::consts::TAU);
            let start = usize::from(gap(1) + gap(3) < gap(0) + gap(2));
            for i in [start, start + 2] {
                let facets = [order[i].1, order[(i + 1) % 4].1];
                if let [Some(a), Some(b)] = facets.map(opposite) {
                    wedges.push(Wedge {
                        facets,
                        edge: *edge,
                        opposite: [a, b],
                    });
                }
            }
        }
        let mut uses = vec![0; surface.nodes.len()];
        for &n in wedges.iter().flat_map(|wedge| &wedge.opposite) {
            uses[n as usize] += 1;
        }
        let is_free = |&n: &u32| uses[n as usize] == 1 && !is_on_line[n as usize];
        wedges.retain(|wedge| wedge.opposite.iter().all(is_free));
        wedges
    }

    /// Sets the radii of the balls opposite the edge of a wedge.
    fn set_opposite_radii(&mut self, wedge: usize) {
        let Wedge {
            edge: [a, b],
            opposite,
            ..
        } = self.wedges[wedge];
        let nodes = &self.surface.nodes;
        let [x, y] = [a, b].map(|n| nodes[n as usize]);
        let [wa, wb] = [a, b].map(|n| self.squared_radii[n as usize]);
        let edge = sub(y, x);
        let (length2, along) = (dot(edge, edge), unit(edge));
        let foot = add_scaled(x, 0.5 * (length2 + wa - wb) / length2, edge);
        let square = wa - distance2(&foot, &x);
        if square <= 0.0 {
            return;
        }
        let [d, e] = opposite.map(|n| {
            let inward = sub(nodes[n as usize], foot);
            unit(add_scaled(inward, -dot(inward, along), along))
        });
        let point = add_scaled(foot, square.sqrt(), unit(add_scaled(d, 1.0, e)));
        let squares = opposite.map(|n| distance2(&point, &nodes[n as usize]));
        for (n, square) in opposite.into_iter().zip(squares) {
            self.squared_radii[n as usize] = square;
        }
    }

    /// Returns the wedges along each connected line.
    fn wedges_of_lines(&self) -> Vec<Vec<usize>> {
        let mut sets = UnionFind::new(self.surface.nodes.len());
        for wedge in &self.wedges {
            sets.unite(wedge.edge[0], wedge.edge[1]);
        }
        let (labels, count) = sets.into_labels();
        let mut lines = vec![Vec::new(); count];
        for (w, wedge) in self.wedges.iter().enumerate() {
            lines[labels[wedge.edge[0] as usize] as usize].push(w);
        }
        lines.retain(|wedges| !wedges.is_empty());
        lines
    }

    /// Gives the balls on the line of these wedges one radius in units of the line's edges: the largest
    /// whose penalty is near the least.
    fn set_line_radii(&mut self, wedges: &[usize]) {
        // The sum of lengths and the count of edges at each node of the line.
        let mut lengths: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
        let mut nodes = Vec::new();
        for wedge in wedges.iter().map(|&w| &self.wedges[w]) {
            let [x, y] = wedge.edge.map(|n| self.surface.nodes[n as usize]);
            for n in wedge.edge {
                let (sum, count) = lengths.entry(n).or_default();
                *sum += distance2(&x, &y).sqrt();
                *count += 1.0;
            }
            nodes.extend(wedge.edge.into_iter().chain(wedge.opposite));
        }
        let facets = nodes
            .iter()
            .flat_map(|&n| self.facets_of_nodes.get(n as usize));
        let facets = sorted_distinct(facets.copied());
        let (first, step, count) = LINE_RADII;
        let radii: Vec<f64> = (0..count).map(|i| first + step * i as f64).collect();
        let mut set_radii = |radius: f64| {
            for (&n, (sum, count)) in &lengths {
                self.squared_radii[n as usize] = (radius * sum / count).powi(2);
            }
            wedges.iter().for_each(|&w| self.set_opposite_radii(w));
            let scores = facets.iter().map(|&f| self.fault_score(f as usize));
            scores.sum::<f64>()
        };
        let penalties: Vec<f64> = radii.iter().map(|&radius| set_radii(radius)).collect();
        let least = penalties.iter().copied().fold(f64::INFINITY, f64::min);
        let limit = least + LINE_PENALTY_TOLERANCE * wedges.len() as f64;
        if let Some(best) = penalties.iter().rposition(|&penalty| penalty <= limit) {
            set_radii(radii[best]);
        }
    }

    fn find_candidates(&self) -> Lists {
        let nodes = &self.surface.nodes;
        let mut partners: Vec<(u32, u32)> = (self.wedges.iter())
            .flat_map(|w| [(w.facets[0], w.opposite[1]), (w.facets[1], w.opposite[0])])
            .collect();
        partners.sort_unstable();
        let largest = self
            .squared_radii
            .iter()
            .fold(0.0f64, |m, &w| m.max(w))
            .sqrt();
        let grid = CellList::new(nodes, largest);
        let candidates = |f: usize| {
            let mut candidates = Vec::new();
            if let Some((centre, height)) = self.sphere_intersection(f) {
                let height = height.max(0.0).sqrt();
                grid.visit_within(centre, MAX_GROWTH_FACTOR * (largest + height), |n| {
                    let distance = MAX_GROWTH_FACTOR * (self.squared_radii[n].sqrt() + height);
                    let is_own_node = self.surface.facets[f].contains(&(n as u32));
                    // The sphere of the other facet's node passes through the shared point.
                    let is_partner = partners.binary_search(&(f as u32, n as u32)).is_ok();
                    if !is_own_node
                        && !is_partner
                        && distance2(&nodes[n], &centre) < distance * distance
                    {
                        candidates.push(n as u32);
                    }
                });
                candidates.sort_unstable();
            }
            candidates
        };
        let count = self.surface.facets.len();
        let candidates: Vec<Vec<u32>> = (0..count).into_par_iter().map(candidates).collect();
        let mut lists = Lists::default();
        candidates
            .into_iter()
            .for_each(|candidates| lists.push(candidates));
        lists
    }

    /// Returns the intersection of the spheres of a facet; see [`sphere_intersection`].
    fn sphere_intersection(&self, f: usize) -> Option<([f64; D], f64)> {
        let squares = self.surface.facets[f].map(|n| self.squared_radii[n as usize]);
        sphere_intersection(&self.surface.corners(f), &squares)
    }

    fn mirror_points(&self, f: usize, centre: [f64; D], square: f64) -> [[f64; D]; 2] {
        let (up, height) = (self.surface.unit_normal(f), square.sqrt());
        [height, -height].map(|h| add_scaled(centre, h, up))
    }

    /// Returns the penalty of a facet: between 1 and 2 if one of its points cannot be a site,
    /// smaller if a point is only close to a ball, 0 otherwise.
    fn fault_score(&self, f: usize) -> f64 {
        match self.max_depth(f) {
            depth if depth > 0.0 => 1.0 + depth.min(1.0),
            depth if depth > -COVER_MARGIN => NEAR_COVER_PENALTY * (1.0 + depth / COVER_MARGIN),
            _ => 0.0,
        }
    }

    /// Returns the largest depth of a point of a facet in a ball, as a difference of squares in
    /// squared edge lengths; or by how much the point misses the minimum height or the minimum
    /// distance from the sides of the box.
    fn max_depth(&self, f: usize) -> f64 {
        let size = self.edge_length(f);
        let Some((centre, square)) = self.sphere_intersection(f) else {
            return 1.0;
        };
        let missing = (MIN_SITE_HEIGHT * MIN_SITE_HEIGHT - square / (size * size)).min(1.0);
        if missing > 0.0 {
            return missing;
        }
        let mut deepest = -COVER_MARGIN;
        for x in self.mirror_points(f, centre, square) {
            for k in 0..D {
                let excess = (MIN_SITE_HEIGHT * size - x[k])
                    .max(x[k] - self.extent[k] + MIN_SITE_HEIGHT * size);
                deepest = deepest.max(excess / size);
            }
            for n in self.candidate_nodes.get(f).iter().map(|&n| n as usize) {
                let square = self.squared_radii[n] * (1.0 - ROUNDING_TOLERANCE);
                let depth = square - distance2(&x, &self.surface.nodes[n]);
                deepest = deepest.max(depth / (size * size));
            }
        }
        deepest
    }

    /// Gives node `n` the radius with the lowest penalty of `facets` among those tried, if it is below
    /// `before`, and the nodes opposite it in `wedges` the radii that follow from it.
    fn reduce_penalty(&mut self, n: usize, before: f64, facets: &[u32], wedges: &[usize]) {
        let old_square = self.squared_radii[n];
        let mut best = (before - ROUNDING_TOLERANCE, old_square);
        for new_square in SQUARED_RADIUS_FACTORS.map(|factor| old_square * factor) {
            if new_square > (MAX_RADIUS * self.edge_lengths[n]).powi(2) {
                continue;
            }
            self.squared_radii[n] = new_square;
            wedges.iter().for_each(|&w| self.set_opposite_radii(w));
            let mut after = 0.0;
            for &f in facets {
                after += self.fault_score(f as usize);
                if after >= best.0 {
                    break;
                }
            }
            if after < best.0 {
                best = (after, new_square);
            }
        }
        self.squared_radii[n] = best.1;
        wedges.iter().for_each(|&w| self.set_opposite_radii(w));
    }

    /// Changes radii, one after the other, as long as that reduces the penalty.
    fn adjust_radii(&mut self) {
        let (nodes, facets) = (self.surface.nodes.len(), self.surface.facets.len());
        let mut affected_facets: Vec<Vec<u32>> = (0..nodes)
            .map(|n| self.facets_of_nodes.get(n).to_vec())
            .collect();
        for f in 0..facets {
            let candidates = self.candidate_nodes.get(f).iter();
            candidates.for_each(|&n| affected_facets[n as usize].push(f as u32));
        }
        // A ball on a line changes those opposite the line.
        let mut wedges_of_nodes: Vec<Vec<usize>> = vec![Vec::new(); nodes];
        let mut is_dependent = vec![false; nodes];
        for (w, wedge) in self.wedges.iter().enumerate() {
            wedge
                .edge
                .iter()
                .for_each(|&n| wedges_of_nodes[n as usize].push(w));
            wedge
                .opposite
                .iter()
                .for_each(|&n| is_dependent[n as usize] = true);
        }
        let dependents: Vec<Vec<u32>> = (wedges_of_nodes.iter())
            .map(|wedges| sorted_distinct(wedges.iter().flat_map(|&w| self.wedges[w].opposite)))
            .collect();
        for n in (0..nodes).filter(|&n| !dependents[n].is_empty()) {
            let own = affected_facets[n].iter();
            let others = dependents[n]
                .iter()
                .flat_map(|&m| &affected_facets[m as usize]);
            affected_facets[n] = sorted_distinct(own.chain(others).copied());
        }
        let mut faults: Vec<f64> = (0..facets).map(|f| self.fault_score(f)).collect();
        for _ in 0..ADJUSTMENT_ROUNDS {
            let mut is_selected = vec![false; nodes];
            for f in (0..facets).filter(|&f| faults[f] > 0.0) {
                let nodes = self.surface.facets[f]
                    .iter()
                    .chain(self.candidate_nodes.get(f));
                nodes.for_each(|&n| is_selected[n as usize] = true);
            }
            for wedge in &self.wedges {
                let moves = wedge.opposite.iter().any(|&n| is_selected[n as usize]);
                wedge
                    .edge
                    .iter()
                    .for_each(|&n| is_selected[n as usize] |= moves);
            }
            let mut improved = false;
            for n in (0..nodes).filter(|&n| is_selected[n] && !is_dependent[n]) {
                let old_square = self.squared_radii[n];
                let before: f64 = affected_facets[n].iter().map(|&f| faults[f as usize]).sum();
                self.reduce_penalty(n, before, &affected_facets[n], &wedges_of_nodes[n]);
                if self.squared_radii[n] != old_square {
                    improved = true;
                    for &f in &affected_facets[n] {
                        faults[f as usize] = self.fault_score(f as usize);
                    }
                }
            }
            if !improved {
                break;
            }
        }
    }
}

/// Returns values averaged over each node and its neighbours.
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

/// Returns the intersection of the spheres of a facet's nodes, given their squared radii: two
/// points, mirror images in the facet. The result is the point half-way between them, and the
/// squared height of the two points above and below it, which is negative if the spheres do not
/// meet. `None` if the facet has no area.
fn sphere_intersection<const D: usize>(
    x: &[[f64; D]; D],
    squares: &[f64; D],
) -> Option<([f64; D], f64)> {
    let u: [[f64; D]; D] = std::array::from_fn(|k| sub(x[k], x[0]));
    // (c - x0) . u_k = (|u_k|^2 + w_0 - w_k) / 2.
    let rhs: [f64; D] = std::array::from_fn(|k| 0.5 * (dot(u[k], u[k]) + squares[0] - squares[k]));
    let mut offset = [0.0; D];
    if D == 2 {
        let length2 = dot(u[1], u[1]);
        if length2 <= 0.0 {
            return None;
        }
        offset = u[1].map(|c| c * rhs[1] / length2);
    } else {
        let [a, b, c] = [dot(u[1], u[1]), dot(u[1], u[2]), dot(u[2], u[2])];
        let det = a * c - b * b;
        if det <= 1e-12 * a * c {
            return None;
        }
        let s = (c * rhs[1] - b * rhs[2]) / det;
        let t = (a * rhs[2] - b * rhs[1]) / det;
        for k in 0..D {
            offset[k] = s * u[1][k] + t * u[2][k];
        }
    }
    let centre = std::array::from_fn(|k| x[0][k] + offset[k]);
    Some((centre, squares[0] - dot(offset, offset)))
}
