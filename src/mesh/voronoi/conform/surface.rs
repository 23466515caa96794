//! The facets that faces of Voronoi cells shall lie on.

use std::collections::BTreeMap;

use crate::geometry::{distance2, normal, unit};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;

/// Triangles (edges in the plane) in a box `[0, extent]`, which meet in whole ridges.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FacetSurface<const D: usize> {
    /// Where the nodes are; on a side of the box exactly.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each facet.
    pub facets: Vec<[u32; D]>,
}

/// The nodes of a ridge in rising order: where facets meet. The second is `NONE` in the plane.
pub(super) type Ridge = [u32; 2];

impl<const D: usize> FacetSurface<D> {
    /// The marked faces of a mesh (`marks`: bit k of a cell for its face k, on both of its sides).
    /// `neighbors` has for every cell and face, in order, the cell beyond.
    pub fn from_marked<M: Simplices<D>>(mesh: &M, neighbors: &[u32], marks: &[u8]) -> Self {
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

    /// The facets that are `wanted`, as a surface.
    pub fn subset(&self, wanted: impl Fn(usize) -> bool) -> Self {
        let mut part = Self::default();
        let mut number = vec![NONE; self.nodes.len()];
        for (_, facet) in self.facets.iter().enumerate().filter(|&(f, _)| wanted(f)) {
            part.facets.push(facet.map(|n| {
                let number = &mut number[n as usize];
                if *number == NONE {
                    *number = part.nodes.len() as u32;
                    part.nodes.push(self.nodes[n as usize]);
                }
                *number
            }));
        }
        part
    }

    /// The positions of a facet's nodes.
    pub fn corners(&self, facet: usize) -> [[f64; D]; D] {
        self.facets[facet].map(|n| self.nodes[n as usize])
    }

    /// The unit normal of a facet.
    pub(super) fn unit_normal(&self, facet: usize) -> [f64; D] {
        unit(normal(&self.corners(facet)))
    }

    /// The facets at each node.
    pub(super) fn facets_of_nodes(&self) -> Lists {
        let mut stars = vec![Vec::new(); self.nodes.len()];
        for (f, facet) in self.facets.iter().enumerate() {
            facet.iter().for_each(|&n| stars[n as usize].push(f as u32));
        }
        let mut lists = Lists::default();
        stars.into_iter().for_each(|star| lists.push(star));
        lists
    }

    /// For each node the mean length of the edges of its facets.
    pub(super) fn edge_lengths(&self) -> Vec<f64> {
        let mut sums = vec![(0.0, 0usize); self.nodes.len()];
        for facet in &self.facets {
            for (i, &a) in facet.iter().enumerate() {
                for &b in &facet[..i] {
                    let length = distance2(&self.nodes[a as usize], &self.nodes[b as usize]).sqrt();
                    for n in [a, b] {
                        sums[n as usize].0 += length;
                        sums[n as usize].1 += 1;
                    }
                }
            }
        }
        sums.iter()
            .map(|&(sum, count)| sum / count.max(1) as f64)
            .collect()
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
    pub(super) fn sides_of_node(&self, node: u32, extent: [f64; D]) -> u8 {
        let x = &self.nodes[node as usize];
        (0..D).fold(0, |sides, k| {
            let (low, high) = (u8::from(x[k] <= 0.0), u8::from(x[k] >= extent[k]));
            sides | (low | high << 1) << (2 * k)
        })
    }
}
