//! Facets of a feature and the ridges at which they meet, in 2-D and 3-D.
//!
//! ```text
//!             3-D: a facet is a triangle, a ridge an edge     2-D: an edge, and a node
//!
//!                        2
//!                       / \                                        0 --------- 1
//!             ridge 1  /   \  ridge 0                           ridge 1     ridge 0
//!                     0-----1
//!                     ridge 2
//! ```
//!
//! Ridge k is opposite node k. The *side* of a facet at its ridge k has the code `D * facet + k`. A
//! ridge has two sides where the feature is a manifold, one at its rim, and three or more where
//! features cross.

use crate::parallel::prelude::*;

use crate::geometry::{add_scaled, dot, norm, normal, sub, unit};
use crate::mesh::complex::NONE;

/// Facets with their ridges. Node positions are in lattice space or in physical space, as the
/// caller decides.
#[derive(Debug, Clone)]
pub struct FacetComplex<'a, const D: usize> {
    /// Node positions.
    pub nodes: &'a [[f64; D]],
    /// Nodes of each facet.
    pub facets: Vec<[u32; D]>,
    /// `ridges[f][k]` is the number of the ridge of facet f opposite its node k.
    pub ridges: Vec<[u32; D]>,
    start: Vec<u32>,
    sides: Vec<u32>,
}

impl<'a, const D: usize> FacetComplex<'a, D> {
    /// Returns the centroid of each facet.
    pub fn centroids(&self) -> Vec<[f64; D]> {
        let centroid = |f: usize| {
            let corners = self.corners(f).into_iter();
            corners.fold([0.0; D], |sum, x| add_scaled(sum, 1.0 / D as f64, x))
        };
        (0..self.len()).map(centroid).collect()
    }

    /// Finds the ridges by sorting, in O(n log n) for n facets.
    pub fn new(nodes: &'a [[f64; D]], facets: Vec<[u32; D]>) -> Self {
        let mut keys: Vec<(u64, u32)> = (0..facets.len() * D)
            .into_par_iter()
            .map(|side| (ridge_key(&facets[side / D], side % D), side as u32))
            .collect();
        keys.par_sort_unstable();
        let mut ridges = vec![[NONE; D]; facets.len()];
        let mut start = Vec::with_capacity(keys.len() / 2 + 2);
        for (index, &(key, side)) in keys.iter().enumerate() {
            if index == 0 || keys[index - 1].0 != key {
                start.push(index as u32);
            }
            ridges[side as usize / D][side as usize % D] = start.len() as u32 - 1;
        }
        start.push(keys.len() as u32);
        let sides = keys.into_iter().map(|(_, side)| side).collect();
        Self {
            nodes,
            facets,
            ridges,
            start,
            sides,
        }
    }

    /// Returns the number of facets.
    pub fn len(&self) -> usize {
        self.facets.len()
    }

    /// Returns the number of ridges.
    pub fn ridge_count(&self) -> usize {
        self.start.len() - 1
    }

    /// Returns the sides that meet at a ridge, as ascending codes `D * facet + k`.
    pub fn sides(&self, ridge: usize) -> &[u32] {
        &self.sides[self.start[ridge] as usize..self.start[ridge + 1] as usize]
    }

    /// Returns the corner positions of a facet.
    pub fn corners(&self, facet: usize) -> [[f64; D]; D] {
        self.facets[facet].map(|n| self.nodes[n as usize])
    }

    /// Returns the nodes of the ridge at a side: all nodes of the facet except the opposite one.
    pub fn ridge_nodes(&self, side: usize) -> impl Iterator<Item = u32> + '_ {
        let facet = &self.facets[side / D];
        (0..D).filter(move |k| *k != side % D).map(|k| facet[k])
    }

    /// Returns the centre of the ridge at a side.
    pub fn ridge_centre(&self, side: usize) -> [f64; D] {
        let share = 1.0 / (D - 1) as f64;
        self.ridge_nodes(side).fold([0.0; D], |sum, n| {
            add_scaled(sum, share, self.nodes[n as usize])
        })
    }

    /// Returns the unit vector from the ridge at a side into its facet. It lies in the facet and is
    /// normal to the ridge.
    pub fn inward(&self, side: usize) -> [f64; D] {
        let mut ridge = self.ridge_nodes(side).map(|n| self.nodes[n as usize]);
        let opposite = self.nodes[self.facets[side / D][side % D] as usize];
        let Some(base) = ridge.next() else {
            return [0.0; D];
        };
        let mut v = sub(opposite, base);
        // A ridge has one direction in 3-D and none in 2-D.
        for end in ridge {
            let direction = sub(end, base);
            let square = dot(direction, direction).max(f64::MIN_POSITIVE);
            v = add_scaled(v, -dot(v, direction) / square, direction);
        }
        unit(v)
    }

    /// Returns the normal of a facet. Its length is the facet's area (3-D) or length (2-D).
    pub fn normal(&self, facet: usize) -> [f64; D] {
        normal(&self.corners(facet))
    }

    /// Returns the mean length of a facet's edges.
    pub fn size(&self, facet: usize) -> f64 {
        let x = self.corners(facet);
        let edges = (0..D).flat_map(|i| (0..i).map(move |j| (i, j)));
        edges.map(|(i, j)| norm(sub(x[i], x[j]))).sum::<f64>() / (D * (D - 1) / 2) as f64
    }
}

/// Returns a key for the ridge opposite node k: its nodes in ascending order, in one number.
fn ridge_key<const D: usize>(facet: &[u32; D], k: usize) -> u64 {
    let other_nodes = (0..D).filter(|&j| j != k).map(|j| u64::from(facet[j]));
    let (low, high) = other_nodes.fold((u64::MAX, 0), |(low, high), n| (low.min(n), high.max(n)));
    low << 32 | high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ridges_of_two_triangles_that_share_an_edge() {
        let nodes = [
            [0.0, 0.0, 0.0],
            [2.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [2.0, 1.0, 1.0],
        ];
        let facets = FacetComplex::new(&nodes, vec![[0, 1, 2], [3, 2, 1]]);
        assert_eq!(facets.ridge_count(), 5);
        let shared = facets.ridges[0][0] as usize;
        assert_eq!(facets.sides(shared), [0, 3]);
        let middle = facets.ridge_centre(0);
        assert_eq!(middle, [1.0, 0.5, 0.0]);
        let inward = facets.inward(0);
        assert!(dot(inward, [2.0, -1.0, 0.0]).abs() < 1e-15 && inward[0] < 0.0);
        assert_eq!(facets.normal(0), [0.0, 0.0, 1.0]);
        assert!((facets.size(0) - (3.0 + 5f64.sqrt()) / 3.0).abs() < 1e-15);
    }

    #[test]
    fn in_two_dimensions_ridges_are_nodes() {
        let nodes = [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [1.0, -1.0]];
        let facets = FacetComplex::new(&nodes, vec![[0, 1], [1, 2], [3, 1]]);
        assert_eq!(facets.ridge_count(), 4);
        let ridge = facets.ridges[0][0] as usize;
        assert_eq!(facets.sides(ridge), [0, 3, 4]);
        assert_eq!(facets.inward(0), [-1.0, 0.0]);
        assert_eq!(facets.normal(0), [0.0, -1.0]);
    }
}
