//! The facets that faces of Voronoi cells shall lie on.

use std::collections::BTreeMap;

use crate::geometry::{cross, distance2, dot, in_space, norm, sub, unit};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;

/// Triangles (edges in the plane) in a box `[0, extent]`, which meet in whole ridges.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface<const D: usize> {
    /// Where the nodes are; on a side of the box exactly.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each facet.
    pub facets: Vec<[u32; D]>,
}

/// Facets whose normals agree this much (cosine) are nearly in one plane.
const FLAT: f64 = 0.85;

/// The nodes of a ridge in rising order: where facets meet. The second is `NONE` in the plane.
pub(super) type Ridge = [u32; 2];

impl<const D: usize> Surface<D> {
    /// The marked faces of a mesh (`marks`: bit k of a cell for its face k, on both of its sides).
    /// `neighbors` has for every cell and face, in order, the cell beyond.
    pub fn of_marked<M: Simplices<D>>(mesh: &M, neighbors: &[u32], marks: &[u8]) -> Self {
        let mut surface = Self::default();
        let mut number = vec![NONE; mesh.nodes().len()];
        for (face, &beyond) in neighbors.iter().enumerate() {
            let (c, k) = (face / (D + 1), face % (D + 1));
            if marks[c] >> k & 1 == 0 || beyond == NONE || (beyond as usize) < c {
                continue;
            }
            let facet = mesh.face(c, k).map(|n| {
                let number = &mut number[n as usize];
                if *number == NONE {
                    *number = surface.nodes.len() as u32;
                    surface.nodes.push(mesh.nodes()[n as usize]);
                }
                *number
            });
            surface.facets.push(facet);
        }
        surface
    }

    /// Flips edges between facets that are nearly in one plane until the two angles opposite each sum up to
    /// at most 180 degrees, so that no node is within the circle round another facet.
    pub fn flip(&mut self) {
        if D != 3 {
            return;
        }
        let mut ridges = self.ridges();
        let mut queue: Vec<Ridge> = ridges.keys().rev().copied().collect();
        // Each flip makes some angles larger; what is nearly square may go on for ever by rounding.
        let mut left = 20 * queue.len();
        while let Some(ridge) = queue.pop() {
            let Some(&[f, g]) = ridges.get(&ridge).map(|f| &f[..]) else {
                continue;
            };
            let Some(new) = self.flipped(ridge, f as usize, g as usize) else {
                continue;
            };
            let [a, b] = [new[0][2], new[0][1]];
            let across = [a.min(b), a.max(b)];
            if left == 0 || ridges.contains_key(&across) {
                continue;
            }
            left -= 1;
            for (old, new) in [f, g].into_iter().zip(new) {
                for ridge in self.ridges_of(old as usize) {
                    if let Some(at) = ridges.get_mut(&ridge) {
                        at.retain(|&t| t != old);
                    }
                }
                self.facets[old as usize] = std::array::from_fn(|k| new[k]);
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

    /// The two facets with the other diagonal, if that is better: its nodes are the second and third of
    /// the first facet.
    fn flipped(&self, ridge: Ridge, f: usize, g: usize) -> Option<[[u32; 3]; 2]> {
        let at = |n: u32| in_space(self.nodes[n as usize]);
        let nodes = self.facets[f];
        let k = (0..D).find(|&k| !ridge.contains(&nodes[k]))?;
        // In the order round the first facet: p, q, a; and b beyond.
        let (a, p, q) = (nodes[k], nodes[(k + 1) % D], nodes[(k + 2) % D]);
        let b = *self.facets[g].iter().find(|n| !ridge.contains(n))?;
        let cot = |apex: u32| {
            let (u, v) = (sub(at(p), at(apex)), sub(at(q), at(apex)));
            dot(u, v) / norm(cross(u, v)).max(1e-300)
        };
        if cot(a) + cot(b) > -1e-6 {
            return None;
        }
        let up = |t: [u32; 3]| unit(cross(sub(at(t[1]), at(t[0])), sub(at(t[2]), at(t[0]))));
        let old = [up([p, q, a]), up([q, p, b])];
        let new = [[p, b, a], [q, a, b]];
        let level = |n: [f64; 3]| old.iter().all(|&o| dot(o, n) > FLAT);
        (level(old[0]) && new.iter().all(|&t| level(up(t)))).then_some(new)
    }

    /// The positions of a facet's nodes.
    pub fn corners(&self, facet: usize) -> [[f64; D]; D] {
        self.facets[facet].map(|n| self.nodes[n as usize])
    }

    /// The facets at each node.
    pub(super) fn stars(&self) -> Lists {
        let mut stars = vec![Vec::new(); self.nodes.len()];
        for (f, facet) in self.facets.iter().enumerate() {
            facet.iter().for_each(|&n| stars[n as usize].push(f as u32));
        }
        let mut lists = Lists::default();
        stars.into_iter().for_each(|star| lists.push(star));
        lists
    }

    /// For each node the mean length of the edges of its facets.
    pub(super) fn sizes(&self) -> Vec<f64> {
        let mut sums = vec![(0.0, 0usize); self.nodes.len()];
        for facet in &self.facets {
            for (i, &a) in facet.iter().enumerate() {
                for &b in &facet[..i] {
                    let length =
                        distance2(&self.nodes[a as usize], &self.nodes[b as usize]).sqrt();
                    for n in [a, b] {
                        sums[n as usize].0 += length;
                        sums[n as usize].1 += 1;
                    }
                }
            }
        }
        sums.iter().map(|&(sum, count)| sum / count.max(1) as f64).collect()
    }

    /// The facets at each ridge.
    pub(super) fn ridges(&self) -> BTreeMap<Ridge, Vec<u32>> {
        let mut ridges: BTreeMap<Ridge, Vec<u32>> = BTreeMap::new();
        for f in 0..self.facets.len() {
            for ridge in self.ridges_of(f) {
                ridges.entry(ridge).or_default().push(f as u32);
            }
        }
        ridges
    }

    /// The ridges of a facet: the one opposite each of its nodes.
    pub(super) fn ridges_of(&self, facet: usize) -> [Ridge; D] {
        let nodes = self.facets[facet];
        std::array::from_fn(|k| {
            let mut ridge = [NONE; 2];
            let others = (0..D).filter(|&i| i != k).map(|i| nodes[i]);
            ridge.iter_mut().zip(others).for_each(|(to, n)| *to = n);
            ridge.sort_unstable();
            ridge
        })
    }

    /// The sides of the box on which a node lies, as bits.
    pub(super) fn sides(&self, node: u32, extent: [f64; D]) -> u8 {
        let x = &self.nodes[node as usize];
        (0..D).fold(0, |sides, k| {
            let (low, high) = (u8::from(x[k] <= 0.0), u8::from(x[k] >= extent[k]));
            sides | (low | high << 1) << (2 * k)
        })
    }
}

/// Where the spheres of a facet's nodes meet, given the squares of their radii: in two points, mirror
/// images in the facet. Gives the point half-way, and the square of the height of the two above and below
/// it, which is negative if they do not meet. `None` if the facet has no area.
pub(super) fn meeting<const D: usize>(
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
