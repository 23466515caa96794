//! Surfaces with triangles nearer to equilateral: edges are flipped, nodes slide along the surface.

use super::surface::{FacetSurface, Ridge};
use crate::geometry::{add_scaled, cross, dot, norm, normal, sub, to_3d, unit};
use crate::mesh::complex::NONE;

/// Facets whose normals agree this much (cosine) are of one smooth surface.
const MIN_SMOOTH_COSINE: f64 = 0.85;
/// A facet turns by no more than this (cosine) when a node slides.
const MIN_TURN_COSINE: f64 = 0.9;
/// Ridges that go on this straight (cosine) are one line.
const MIN_LINE_COSINE: f64 = 0.8;
/// Rounds of flips and slides.
const MAX_ROUNDS: usize = 4;
/// More flips than any surface needs: so many for each edge.
const MAX_FLIPS_PER_EDGE: usize = 20;

impl<const D: usize> FacetSurface<D> {
    /// Flips edges and lets nodes slide. Lines where surfaces meet or end, and those in the sides of the
    /// box `[0, extent]`, stay where they are; nodes slide along them.
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

    /// Flips edges between facets that are nearly in one plane until the two angles opposite each sum up to
    /// at most 180 degrees, so that no node is within the circle round another facet.
    fn flip_edges(&mut self) {
        let mut ridges = self.ridges();
        let mut queue: Vec<Ridge> = ridges.keys().rev().copied().collect();
        // Where angles are nearly right, rounding must not lead to and fro for ever.
        let mut left = MAX_FLIPS_PER_EDGE * queue.len();
        while let Some(ridge) = queue.pop().filter(|_| left > 0) {
            let Some(&[f, g]) = ridges.get(&ridge).map(|f| &f[..]) else {
                continue;
            };
            let Some((across, new)) = self.flip_result(ridge, [f, g]) else {
                continue;
            };
            if ridges.contains_key(&across) {
                continue;
            }
            left -= 1;
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

    /// The other diagonal of two triangles and the two that it makes, if these are better.
    fn flip_result(&self, ridge: Ridge, facets: [u32; 2]) -> Option<(Ridge, [[u32; D]; 2])> {
        let at = |n: u32| to_3d(self.nodes[n as usize]);
        let nodes = self.facets[facets[0] as usize];
        let k = (0..D).find(|&k| !ridge.contains(&nodes[k]))?;
        let (a, p, q) = (nodes[k], nodes[(k + 1) % D], nodes[(k + 2) % D]);
        let other = &self.facets[facets[1] as usize];
        let b = *other.iter().find(|n| !ridge.contains(n))?;
        let cotangent = |apex: u32| {
            let [u, v] = [p, q].map(|n| sub(at(n), at(apex)));
            dot(u, v) / norm(cross(u, v)).max(f64::MIN_POSITIVE)
        };
        if cotangent(a) + cotangent(b) > -1e-6 {
            return None;
        }
        let up = |t: [u32; 3]| unit(cross(sub(at(t[1]), at(t[0])), sub(at(t[2]), at(t[0]))));
        let old = [[p, q, a], [q, p, b]].map(up);
        let new = [[p, b, a], [q, a, b]];
        let level = |n: [f64; 3]| old.iter().all(|&o| dot(o, n) > MIN_SMOOTH_COSINE);
        let better = level(old[0]) && new.iter().all(|&t| level(up(t)));
        better.then(|| {
            (
                [a.min(b), a.max(b)],
                new.map(|t| std::array::from_fn(|k| t[k])),
            )
        })
    }

    /// Moves every node once, lines first: to the middle between the two next on its line, or to the mean of
    /// the facets round it, but along the surface only and if the worst of these facets gets better.
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
        let mut held: Vec<bool> = (0..self.nodes.len() as u32)
            .map(|n| self.sides_of_node(n, extent) != 0)
            .collect();
        for n in sharp.iter().flat_map(|(ridge, _)| ridge) {
            if *n != NONE {
                held[*n as usize] = true;
            }
        }
        let stars = self.facets_of_nodes();
        for n in (0..self.nodes.len()).filter(|&n| !held[n]) {
            let star = stars.get(n);
            let (mut up, mut sum, mut weight) = ([0.0; D], [0.0; D], 0.0);
            for &f in star {
                let x = self.corners(f as usize);
                let n = normal(&x);
                up = add_scaled(up, if dot(n, up) < 0.0 { -1.0 } else { 1.0 }, n);
                let area = norm(n);
                x.iter()
                    .for_each(|&x| sum = add_scaled(sum, area / D as f64, x));
                weight += area;
            }
            if weight <= 0.0 {
                continue;
            }
            let (up, here) = (unit(up), self.nodes[n]);
            let step = sub(sum.map(|c| c / weight), here);
            let step = add_scaled(step, -dot(step, up), up);
            let before: Vec<[f64; D]> =
                star.iter().map(|&f| self.unit_normal(f as usize)).collect();
            let worst = |surface: &Self| {
                let shapes = star.iter().map(|&f| surface.roundness(f as usize));
                shapes.fold(f64::INFINITY, f64::min)
            };
            let was = worst(self);
            for share in [1.0, 0.5] {
                self.nodes[n] = add_scaled(here, share, step);
                let mut turns = star.iter().zip(&before);
                let level = turns.all(|(&f, before)| {
                    dot(self.unit_normal(f as usize), *before) > MIN_TURN_COSINE
                });
                if level && worst(self) > was {
                    break;
                }
                self.nodes[n] = here;
            }
        }
    }

    /// 1 for an equilateral triangle, 0 for one without area.
    fn roundness(&self, facet: usize) -> f64 {
        let x = self.corners(facet);
        let edges = [1, 2, 0].map(|k| sub(x[k], x[(k + 2) % D]));
        let squares: f64 = edges.iter().map(|&e| dot(e, e)).sum();
        4.0 * 3f64.sqrt() * norm(normal(&x)) / squares.max(f64::MIN_POSITIVE)
    }

    /// The ridges at which surfaces meet, end or are folded, and how many facets each has.
    fn sharp_ridges(&self) -> Vec<(Ridge, usize)> {
        let ridges = self.ridges().into_iter();
        let sharp = ridges.filter(|(_, facets)| match facets[..] {
            [f, g] => {
                dot(self.unit_normal(f as usize), self.unit_normal(g as usize)).abs()
                    < MIN_SMOOTH_COSINE
            }
            _ => true,
        });
        sharp.map(|(ridge, facets)| (ridge, facets.len())).collect()
    }

    /// For each node on a line that goes on evenly the two next to it: on the same sides of the box, and
    /// where as many facets meet.
    fn line_neighbours(&self, sharp: &[(Ridge, usize)], extent: [f64; D]) -> Vec<Option<[u32; 2]>> {
        let mut at: Vec<Vec<(u32, (u8, usize))>> = vec![Vec::new(); self.nodes.len()];
        for &([a, b], facets) in sharp {
            let kind = (
                self.sides_of_node(a, extent) & self.sides_of_node(b, extent),
                facets,
            );
            at[a as usize].push((b, kind));
            at[b as usize].push((a, kind));
        }
        let next = |n: usize| match at[n][..] {
            [(a, kind), (b, other)]
                if kind == other && self.sides_of_node(n as u32, extent) == kind.0 =>
            {
                let ways = [a, b].map(|m| unit(sub(self.nodes[m as usize], self.nodes[n])));
                (dot(ways[0], ways[1]) < -MIN_LINE_COSINE).then_some([a, b])
            }
            _ => None,
        };
        (0..self.nodes.len()).map(next).collect()
    }
}
