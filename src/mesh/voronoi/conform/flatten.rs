//! Makes the parts of a surface that are nearly planar exactly planar.
//!
//! The sites of two facets in one plane are the corners of a rectangle, so that their four cells
//! meet at one edge, also where no nodes hold the cells together. If the plane is off by a hundredth
//! of a degree, the four cells meet at two edges instead, with a face between them that is as narrow
//! as a needle.

use std::collections::VecDeque;

use super::surface::FacetSurface;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::{add_scaled, dot, norm, solve_positive, sub, unit};

/// Largest distance of a node from the plane of its part, in mean edge lengths.
const MAX_PLANE_DISTANCE: f64 = 0.02;
/// Smallest cosine between the normals of a part and of its facets.
const MIN_NORMAL_COSINE: f64 = 0.99;
/// Largest cosine between the normals of two planes that are made perpendicular.
const MAX_PERPENDICULAR_COSINE: f64 = 0.002;
/// Smallest number of facets of a part.
const MIN_FACETS: usize = 8;

/// A plane: a point on it, and its unit normal.
type Plane<const D: usize> = ([f64; D], [f64; D]);

/// Sums over points, from which the best plane follows.
#[derive(Clone, Copy)]
struct PointSums<const D: usize> {
    count: f64,
    first: [f64; D],
    second: [[f64; D]; D],
}

impl<const D: usize> FacetSurface<D> {
    /// Moves the nodes of nearly planar parts onto planes, and those where two parts meet onto both.
    /// Nodes on sides of the box `[0, extent]` stay on them. Does nothing in 2-D.
    pub fn flatten(&mut self, extent: [f64; D]) {
        if D != 3 || self.facets.is_empty() {
            return;
        }
        let lengths = self.edge_lengths();
        let tolerance = MAX_PLANE_DISTANCE * lengths.iter().sum::<f64>() / lengths.len() as f64;
        let planes = self.planar_parts(tolerance);
        let stars = self.facets_of_nodes();
        for n in 0..self.nodes.len() {
            let mut parts: Vec<usize> = (stars.get(n).iter())
                .filter_map(|&f| planes.0[f as usize])
                .collect();
            parts.sort_unstable();
            parts.dedup();
            let planes: Vec<Plane<D>> = parts.iter().map(|&p| planes.1[p]).collect();
            self.move_onto(n, planes, extent, tolerance);
        }
    }

    /// Moves a node onto planes, along the sides of the box on which it lies, if it is near them.
    fn move_onto(&mut self, n: usize, mut planes: Vec<Plane<D>>, extent: [f64; D], tolerance: f64) {
        let x = self.nodes[n];
        let sides = self.sides_of_node(n as u32, extent);
        for k in (0..D).filter(|k| sides >> (2 * k) & 3 != 0) {
            let mut axis = [0.0; D];
            axis[k] = 1.0;
            planes.push((x, axis));
        }
        if planes.len() > D {
            return;
        }
        let mut products = [[0.0; D]; D];
        let mut distances = [0.0; D];
        for (i, (point, normal)) in planes.iter().enumerate() {
            distances[i] = dot(sub(*point, x), *normal);
            for (j, (_, other)) in planes.iter().enumerate() {
                products[i][j] = dot(*normal, *other);
            }
        }
        (planes.len()..D).for_each(|i| products[i][i] = 1.0);
        let steps = solve_positive(products, distances);
        let mut target = x;
        for ((_, normal), step) in planes.iter().zip(steps) {
            target = add_scaled(target, step, *normal);
        }
        for k in (0..D).filter(|k| sides >> (2 * k) & 3 != 0) {
            target[k] = x[k];
        }
        if norm(sub(target, x)) < 2.0 * tolerance {
            self.nodes[n] = target;
        }
    }

    /// Returns for each facet its planar part, if it has one, and the planes of the parts. A part
    /// continues beyond a line where surfaces cross.
    fn planar_parts(&self, tolerance: f64) -> (Vec<Option<usize>>, Vec<Plane<D>>) {
        let mut neighbours = vec![Vec::new(); self.facets.len()];
        for facets in self.ridges().into_values() {
            for &f in &facets {
                let others = facets.iter().copied().filter(|&g| g != f);
                neighbours[f as usize].extend(others);
            }
        }
        let (mut parts, mut planes) = (vec![None; self.facets.len()], Vec::new());
        let mut is_done = vec![false; self.facets.len()];
        for seed in 0..self.facets.len() {
            if is_done[seed] {
                continue;
            }
            let (members, sums) = self.grow_part(seed, &parts, &neighbours, tolerance);
            is_done[seed] = true;
            let Some(plane) = sums.plane().filter(|_| members.len() >= MIN_FACETS) else {
                continue;
            };
            let is_near = |f: &usize| self.is_in_plane(*f, &plane, tolerance);
            for f in members.into_iter().filter(is_near) {
                is_done[f] = true;
                parts[f] = Some(planes.len());
            }
            planes.push(self.perpendicular(plane, &planes));
        }
        (parts, planes)
    }

    /// Turns a plane that is nearly perpendicular to one of the others until it is perpendicular: only
    /// then four cells can meet at the line where they cross.
    fn perpendicular(&self, (point, normal): Plane<D>, others: &[Plane<D>]) -> Plane<D> {
        let cosine = |other: &&Plane<D>| dot(other.1, normal).abs() < MAX_PERPENDICULAR_COSINE;
        let Some((_, other)) = others.iter().find(cosine) else {
            return (point, normal);
        };
        (
            point,
            unit(add_scaled(normal, -dot(*other, normal), *other)),
        )
    }

    /// Returns the facets that lie in one plane with a facet and are connected to it, except those
    /// that have a part already, and the sums over their corners.
    fn grow_part(
        &self,
        seed: usize,
        parts: &[Option<usize>],
        neighbours: &[Vec<u32>],
        tolerance: f64,
    ) -> (Vec<usize>, PointSums<D>) {
        let corners = self.corners(seed);
        let mut sums = PointSums::new();
        corners.iter().for_each(|x| sums.add(*x));
        let mut plane = (corners[0], self.unit_normal(seed));
        let (mut members, mut queue) = (vec![seed], VecDeque::from([seed]));
        let mut is_member = vec![false; self.facets.len()];
        is_member[seed] = true;
        while let Some(f) = queue.pop_front() {
            for g in neighbours[f].iter().map(|&g| g as usize) {
                if is_member[g] || parts[g].is_some() || !self.is_in_plane(g, &plane, tolerance) {
                    continue;
                }
                is_member[g] = true;
                members.push(g);
                queue.push_back(g);
                self.corners(g).iter().for_each(|x| sums.add(*x));
                plane = sums.plane().unwrap_or(plane);
            }
        }
        (members, sums)
    }

    /// Returns `true` if a facet lies in a plane.
    fn is_in_plane(&self, f: usize, (point, normal): &Plane<D>, tolerance: f64) -> bool {
        dot(self.unit_normal(f), *normal).abs() > MIN_NORMAL_COSINE
            && (self.corners(f).iter()).all(|x| dot(sub(*x, *point), *normal).abs() < tolerance)
    }
}

impl<const D: usize> PointSums<D> {
    fn new() -> Self {
        Self {
            count: 0.0,
            first: [0.0; D],
            second: [[0.0; D]; D],
        }
    }

    fn add(&mut self, x: [f64; D]) {
        self.count += 1.0;
        self.first = add_scaled(self.first, 1.0, x);
        for (row, c) in self.second.iter_mut().zip(x) {
            *row = add_scaled(*row, c, x);
        }
    }

    /// Returns the plane with the least sum of squared distances; `None` without points.
    fn plane(&self) -> Option<Plane<D>> {
        if self.count == 0.0 {
            return None;
        }
        let mean = self.first.map(|c| c / self.count);
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| self.second[i][j] / self.count - mean[i] * mean[j])
        });
        let normal = eigenvector(&covariance, eigenvalues(&covariance)[0]);
        Some((mean, normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    const EXTENT: [f64; 3] = [10.0; 3];

    /// Returns triangles between 11 x 11 nodes at a height across the whole box.
    fn grid(height: impl Fn(f64, f64) -> f64) -> FacetSurface<3> {
        let mut surface = FacetSurface::default();
        for j in 0..11 {
            for i in 0..11 {
                let (x, y) = (f64::from(i), f64::from(j));
                surface.nodes.push([x, y, height(x, y)]);
            }
        }
        for n in (0..110).filter(|n| n % 11 < 10) {
            surface
                .facets
                .extend([[n, n + 1, n + 12], [n, n + 12, n + 11]]);
        }
        surface
    }

    #[test]
    fn noisy_planes_become_planar_and_curved_surfaces_stay() {
        let mut random = Random::new(3);
        let noise: Vec<f64> = (0..121).map(|_| 0.01 * (random.draw() - 0.5)).collect();
        let noisy = |x: f64, y: f64| 4.0 + 0.3 * x + 0.1 * y + noise[(x + 11.0 * y) as usize];
        let mut surface = grid(noisy);
        let before = surface.clone();
        surface.flatten(EXTENT);
        let (sum, first) = (surface.unit_normal(0), surface.nodes[0]);
        for (x, old) in surface.nodes.iter().zip(&before.nodes) {
            assert!(dot(sub(*x, first), sum).abs() < 1e-12, "{x:?}");
            assert!(norm(sub(*x, *old)) < 0.01);
            for k in 0..2 {
                let is_on_side = old[k] == 0.0 || old[k] == 10.0;
                assert!(!is_on_side || x[k] == old[k]);
            }
        }
        let bowl = grid(|x, y| 2.0 + 0.05 * ((x - 5.0).powi(2) + (y - 5.0).powi(2)));
        let mut flattened = bowl.clone();
        flattened.flatten(EXTENT);
        assert_eq!(flattened, bowl);
    }

    #[test]
    fn nearly_perpendicular_planes_become_perpendicular() {
        let surface = FacetSurface::<3>::default();
        let other = ([0.0; 3], [0.0, 0.0, 1.0]);
        let normal = |z: f64| unit([1.0, 1.0, z]);
        let turned = surface.perpendicular(([1.0; 3], normal(0.001)), &[other]);
        assert_eq!(turned.0, [1.0; 3]);
        assert!(norm(sub(turned.1, normal(0.0))) < 1e-15, "{turned:?}");
        let oblique = ([1.0; 3], normal(0.1));
        assert_eq!(surface.perpendicular(oblique, &[other]), oblique);
    }
}
