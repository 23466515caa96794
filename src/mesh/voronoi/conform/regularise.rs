//! Improves the triangles of a surface towards equilateral ones: flips edges, and slides nodes
//! along the surface.

use super::surface::{FacetSurface, Ridge};
use crate::geometry::{add_scaled, cross, dot, norm, normal, sub, to_3d, unit};
use crate::mesh::complex::NONE;

/// Smallest cosine between the normals of two facets of one smooth surface.
const MIN_SMOOTH_COSINE: f64 = 0.85;
/// Smallest cosine between the old and the new normal of a facet when a node slides.
const MIN_TURN_COSINE: f64 = 0.9;
/// Smallest cosine between two successive ridges of one line.
const MIN_LINE_COSINE: f64 = 0.8;
/// Number of rounds of flips and slides.
const MAX_ROUNDS: usize = 4;
/// Largest number of flips for each edge, more than any surface needs.
const MAX_FLIPS_PER_EDGE: usize = 20;

impl<const D: usize> FacetSurface<D> {
    /// Flips edges and slides nodes. Lines where surfaces meet or end, and lines in the sides of
    /// the box `[0, extent]`, stay where they are; their nodes slide along them. Does nothing in
    /// 2-D.
    pub fn regularise(&mut self, extent: [f64; D]) {
        if D != 3 {
            return;
        }
        for _ in 0..MAX_ROUNDS {
            self.flip_edges();
            self.slide_nodes(extent);
        }
        self.flip_edges();
    }

    /// Flips edges between facets that are nearly in one plane, until the two angles opposite each
    /// edge sum to at most 180 degrees. Then no node is inside the circumcircle of another facet.
    fn flip_edges(&mut self) {
        let mut ridges = self.ridges();
        let mut queue: Vec<Ridge> = ridges.keys().rev().copied().collect();
        // If the sum of angles is nearly 180 degrees, rounding must not flip edges back and forth
        // endlessly.
        let mut remaining_flips = MAX_FLIPS_PER_EDGE * queue.len();
        while let Some(ridge) = queue.pop().filter(|_| remaining_flips > 0) {
            let Some(&[f, g]) = ridges.get(&ridge).map(|f| &f[..]) else {
                continue;
            };
            if self.name_of(f) != self.name_of(g) {
                continue;
            }
            let Some((across, new)) = self.flip_result(ridge, [f, g]) else {
                continue;
            };
            if ridges.contains_key(&across) {
                continue;
            }
            remaining_flips -= 1;
            for (old, new) in [f, g].into_iter().zip(new) {
                for ridge in self.ridges_of(old as usize) {
                    if let Some(facets) = ridges.get_mut(&ridge) {
                        facets.retain(|&t| t != old);
                    }
                }
                self.facets[old as usize] = new;
            }
            ridges.remove(&ridge);
            for facet in [f, g] {
                for ridge in self.ridges_of(facet as usize) {
                    ridges.entry(ridge).or_default().push(facet);
                    queue.push(ridge);
                }
            }
        }
    }

    /// Returns the other diagonal of two triangles and the two triangles that it makes, if these
    /// are better.
    fn flip_result(&self, ridge: Ridge, facets: [u32; 2]) -> Option<(Ridge, [[u32; D]; 2])> {
        let position = |n: u32| to_3d(self.nodes[n as usize]);
        let nodes = self.facets[facets[0] as usize];
        let k = (0..D).find(|&k| !ridge.contains(&nodes[k]))?;
        let (a, p, q) = (nodes[k], nodes[(k + 1) % D], nodes[(k + 2) % D]);
        let other_facet = &self.facets[facets[1] as usize];
        let b = *other_facet.iter().find(|n| !ridge.contains(n))?;
        let cotangent = |apex: u32| {
            let [u, v] = [p, q].map(|n| sub(position(n), position(apex)));
            dot(u, v) / norm(cross(u, v)).max(f64::MIN_POSITIVE)
        };
        if cotangent(a) + cotangent(b) > -1e-6 {
            return None;
        }
        let unit_normal = |t: [u32; 3]| {
            unit(cross(
                sub(position(t[1]), position(t[0])),
                sub(position(t[2]), position(t[0])),
            ))
        };
        let old = [[p, q, a], [q, p, b]].map(unit_normal);
        let new = [[p, b, a], [q, a, b]];
        let is_smooth = |n: [f64; 3]| old.iter().all(|&o| dot(o, n) > MIN_SMOOTH_COSINE);
        let is_better = is_smooth(old[0]) && new.iter().all(|&t| is_smooth(unit_normal(t)));
        is_better.then(|| {
            (
                [a.min(b), a.max(b)],
                new.map(|t| std::array::from_fn(|k| t[k])),
            )
        })
    }

    /// Moves every node once. First nodes on lines move along their line to the middle between the
    /// two adjacent nodes. Then other nodes move to the mean of the facets around them, but only
    /// along the surface and only if the worst of these facets improves. The nodes of facets at lines
    /// where surfaces meet stay.
    fn slide_nodes(&mut self, extent: [f64; D]) {
        let sharp = self.sharp_ridges();
        for (n, ends) in self.line_neighbours(&sharp, extent).into_iter().enumerate() {
            if let Some(ends) = ends {
                let [p, q] = ends.map(|m| self.nodes[m as usize]);
                let along = unit(sub(q, p));
                let x = self.nodes[n];
                let middle = add_scaled(p, 0.5, sub(q, p));
                self.nodes[n] = add_scaled(x, dot(sub(middle, x), along), along);
            }
        }
        let mut is_fixed: Vec<bool> = (0..self.nodes.len() as u32)
            .map(|n| self.sides_of_node(n, extent) != 0)
            .collect();
        for n in sharp.iter().flat_map(|(ridge, _)| ridge) {
            if *n != NONE {
                is_fixed[*n as usize] = true;
            }
        }
        // Where surfaces cross, facets on all sides are mirror images of one another.
        let crossings = self
            .ridges()
            .into_values()
            .filter(|facets| facets.len() > 2);
        for n in crossings.flatten().flat_map(|f| self.facets[f as usize]) {
            is_fixed[n as usize] = true;
        }
        let stars = self.facets_of_nodes();
        for n in (0..self.nodes.len()).filter(|&n| !is_fixed[n]) {
            let star = stars.get(n);
            let (mut normal_sum, mut sum, mut weight) = ([0.0; D], [0.0; D], 0.0);
            for &f in star {
                let x = self.corners(f as usize);
                let n = normal(&x);
                normal_sum = add_scaled(
                    normal_sum,
                    if dot(n, normal_sum) < 0.0 { -1.0 } else { 1.0 },
                    n,
                );
                let area = norm(n);
                x.iter()
                    .for_each(|&x| sum = add_scaled(sum, area / D as f64, x));
                weight += area;
            }
            if weight <= 0.0 {
                continue;
            }
            let (unit_normal, old_position) = (unit(normal_sum), self.nodes[n]);
            let step = sub(sum.map(|c| c / weight), old_position);
            let step = add_scaled(step, -dot(step, unit_normal), unit_normal);
            let before: Vec<[f64; D]> =
                star.iter().map(|&f| self.unit_normal(f as usize)).collect();
            let min_roundness = |surface: &Self| {
                let shapes = star.iter().map(|&f| surface.roundness(f as usize));
                shapes.fold(f64::INFINITY, f64::min)
            };
            let old_roundness = min_roundness(self);
            for fraction in [1.0, 0.5] {
                self.nodes[n] = add_scaled(old_position, fraction, step);
                let mut normals = star.iter().zip(&before);
                let is_smooth = normals.all(|(&f, before)| {
                    dot(self.unit_normal(f as usize), *before) > MIN_TURN_COSINE
                });
                if is_smooth && min_roundness(self) > old_roundness {
                    break;
                }
                self.nodes[n] = old_position;
            }
        }
    }

    /// Returns the shape quality of a facet: 1 for an equilateral triangle, 0 for one without area.
    fn roundness(&self, facet: usize) -> f64 {
        let x = self.corners(facet);
        let edges = [1, 2, 0].map(|k| sub(x[k], x[(k + 2) % D]));
        let squares: f64 = edges.iter().map(|&e| dot(e, e)).sum();
        4.0 * 3f64.sqrt() * norm(normal(&x)) / squares.max(f64::MIN_POSITIVE)
    }

    /// Returns the ridges at which surfaces meet, end or are folded, each with its number of
    /// facets.
    fn sharp_ridges(&self) -> Vec<(Ridge, usize)> {
        let ridges = self.ridges().into_iter();
        let sharp = ridges.filter(|(_, facets)| match facets[..] {
            [f, g] => {
                self.name_of(f) != self.name_of(g)
                    || dot(self.unit_normal(f as usize), self.unit_normal(g as usize)).abs()
                        < MIN_SMOOTH_COSINE
            }
            _ => true,
        });
        sharp.map(|(ridge, facets)| (ridge, facets.len())).collect()
    }

    /// Returns for each node on a smooth line the two adjacent nodes on that line: ridges on the
    /// same sides of the box, with the same number of facets.
    fn line_neighbours(&self, sharp: &[(Ridge, usize)], extent: [f64; D]) -> Vec<Option<[u32; 2]>> {
        let mut neighbours: Vec<Vec<(u32, (u8, usize))>> = vec![Vec::new(); self.nodes.len()];
        for &([a, b], facets) in sharp {
            let kind = (
                self.sides_of_node(a, extent) & self.sides_of_node(b, extent),
                facets,
            );
            neighbours[a as usize].push((b, kind));
            neighbours[b as usize].push((a, kind));
        }
        let line_ends = |n: usize| match neighbours[n][..] {
            [(a, kind), (b, other_kind)]
                if kind == other_kind && self.sides_of_node(n as u32, extent) == kind.0 =>
            {
                let directions = [a, b].map(|m| unit(sub(self.nodes[m as usize], self.nodes[n])));
                (dot(directions[0], directions[1]) < -MIN_LINE_COSINE).then_some([a, b])
            }
            _ => None,
        };
        (0..self.nodes.len()).map(line_ends).collect()
    }
}
