//! The facets on which faces of Voronoi cells should lie.

use std::collections::BTreeMap;

use crate::geometry::{distance2, normal, unit};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;

/// Triangles (in 2-D: edges) in a box `[0, extent]` that meet in whole ridges.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FacetSurface<const D: usize> {
    /// Positions of the nodes; nodes on a side of the box lie exactly on it.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each facet.
    pub facets: Vec<[u32; D]>,
    /// For each facet the index of the name of its surface, or `NONE`; empty if no surface has a
    /// name. Facets of different surfaces are never joined.
    pub names: Vec<u32>,
}

/// The nodes of a ridge, where facets meet, in ascending order. In 2-D the second is `NONE`.
pub(super) type Ridge = [u32; 2];

impl<const D: usize> FacetSurface<D> {
    /// Creates a surface from the marked faces of a mesh. `marks` has bit k of a cell set if its
    /// face k is marked, on both sides of the face. `neighbours` has the cell beyond for every cell
    /// and face, in order, and `names` the index of the name of its surface, or `NONE`; it is empty
    /// if no surface has a name.
    pub fn from_marked<M: Simplices<D>>(
        mesh: &M,
        neighbours: &[u32],
        marks: &[u8],
        names: &[u32],
    ) -> Self {
        let is_marked = |&face: &usize| {
            let (cell, k) = (face / (D + 1), face % (D + 1));
            let beyond = neighbours[face];
            marks[cell] >> k & 1 == 1 && beyond != NONE && beyond as usize >= cell
        };
        let marked = (0..neighbours.len()).filter(is_marked);
        let facets = marked
            .clone()
            .map(|face| mesh.face(face / (D + 1), face % (D + 1)));
        Self {
            names: marked.filter_map(|face| names.get(face).copied()).collect(),
            ..Self::from_facets(mesh.nodes(), facets)
        }
    }

    /// Returns the facets for which `is_selected` holds, as a surface.
    pub fn subset(&self, is_selected: impl Fn(usize) -> bool) -> Self {
        let selected = (0..self.facets.len()).filter(|&f| is_selected(f));
        let facets = selected.clone().map(|f| self.facets[f]);
        Self {
            names: selected
                .filter_map(|f| self.names.get(f).copied())
                .collect(),
            ..Self::from_facets(&self.nodes, facets)
        }
    }

    /// Returns the index of the name of a facet's surface, or [`NONE`].
    pub(super) fn name_of(&self, facet: u32) -> u32 {
        self.names.get(facet as usize).copied().unwrap_or(NONE)
    }

    /// Creates a surface of these facets. Its nodes are numbered in the order of their first use.
    fn from_facets(nodes: &[[f64; D]], facets: impl Iterator<Item = [u32; D]>) -> Self {
        let mut surface = Self::default();
        let mut new_index = vec![NONE; nodes.len()];
        for facet in facets {
            surface.facets.push(facet.map(|n| {
                let new_node = &mut new_index[n as usize];
                if *new_node == NONE {
                    *new_node = surface.nodes.len() as u32;
                    surface.nodes.push(nodes[n as usize]);
                }
                *new_node
            }));
        }
        surface
    }

    /// Returns the positions of a facet's nodes.
    pub fn corners(&self, facet: usize) -> [[f64; D]; D] {
        self.facets[facet].map(|n| self.nodes[n as usize])
    }

    /// Returns the unit normal of a facet.
    pub(super) fn unit_normal(&self, facet: usize) -> [f64; D] {
        unit(normal(&self.corners(facet)))
    }

    /// Returns the facets at each node.
    pub(super) fn facets_of_nodes(&self) -> Lists {
        let mut stars = vec![Vec::new(); self.nodes.len()];
        for (f, facet) in self.facets.iter().enumerate() {
            facet.iter().for_each(|&n| stars[n as usize].push(f as u32));
        }
        let mut lists = Lists::default();
        stars.into_iter().for_each(|star| lists.push(star));
        lists
    }

    /// Returns for each node the mean length of the edges of its facets.
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

    /// Returns the facets at each ridge.
    pub(super) fn ridges(&self) -> BTreeMap<Ridge, Vec<u32>> {
        let mut ridges: BTreeMap<Ridge, Vec<u32>> = BTreeMap::new();
        for f in 0..self.facets.len() {
            for ridge in self.ridges_of(f) {
                ridges.entry(ridge).or_default().push(f as u32);
            }
        }
        ridges
    }

    /// Returns the ridges of a facet: the one opposite each of its nodes.
    pub(super) fn ridges_of(&self, facet: usize) -> [Ridge; D] {
        let nodes = self.facets[facet];
        std::array::from_fn(|k| {
            let mut ridge = [NONE; 2];
            let others = (0..D).filter(|&i| i != k).map(|i| nodes[i]);
            ridge.iter_mut().zip(others).for_each(|(slot, n)| *slot = n);
            ridge.sort_unstable();
            ridge
        })
    }

    /// Returns the sides of the box on which a node lies, as bits.
    pub(super) fn sides_of_node(&self, node: u32, extent: [f64; D]) -> u8 {
        let x = &self.nodes[node as usize];
        (0..D).fold(0, |sides, k| {
            let (low, high) = (u8::from(x[k] <= 0.0), u8::from(x[k] >= extent[k]));
            sides | (low | high << 1) << (2 * k)
        })
    }
}
