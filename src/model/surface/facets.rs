//! Facets of a feature and the ridges at which they meet, in two and three dimensions.
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
//! Ridge k is opposite node k. A facet's *side* at its ridge k has the code `D * facet + k`. Where a
//! feature is a manifold, a ridge has two sides; at its rim one; where features cross, three or more.

use crate::parallel::prelude::*;

use crate::geometry::{add_scaled, dot, norm, normal, sub, unit};

/// No number.
pub const NONE: u32 = u32::MAX;

/// Facets with their ridges. Positions are the caller's: in one space, lattice or physical.
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
    /// Finds the ridges, by sorting: n log n in the number of facets.
    pub fn new(nodes: &'a [[f64; D]], facets: Vec<[u32; D]>) -> Self {
        let mut keys: Vec<(u64, u32)> = (0..facets.len() * D)
            .into_par_iter()
            .map(|side| (ridge_key(&facets[side / D], side % D), side as u32))
            .collect();
        keys.par_sort_unstable();
        let mut ridges = vec![[NONE; D]; facets.len()];
        let mut start = Vec::with_capacity(keys.len() / 2 + 2);
        for (at, &(key, side)) in keys.iter().enumerate() {
            if at == 0 || keys[at - 1].0 != key {
                start.push(at as u32);
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

    /// Number of facets.
    pub fn len(&self) -> usize {
        self.facets.len()
    }

    /// Number of ridges.
    pub fn ridge_count(&self) -> usize {
        self.start.len() - 1
    }

    /// The sides that meet at a ridge, as codes `D * facet + k`, ascending.
    pub fn sides(&self, ridge: usize) -> &[u32] {
        &self.sides[self.start[ridge] as usize..self.start[ridge + 1] as usize]
    }

    /// Corner positions of a facet.
    pub fn corners(&self, facet: usize) -> [[f64; D]; D] {
        self.facets[facet].map(|n| self.nodes[n as usize])
    }

    /// Nodes of the ridge at a side: all of the facet's but the one opposite.
    pub fn ridge_nodes(&self, side: usize) -> impl Iterator<Item = u32> + '_ {
        let facet = &self.facets[side / D];
        (0..D).filter(move |k| *k != side % D).map(|k| facet[k])
    }

    /// The middle of the ridge at a side.
    pub fn ridge_centre(&self, side: usize) -> [f64; D] {
        let share = 1.0 / (D - 1) as f64;
        self.ridge_nodes(side).fold([0.0; D], |sum, n| {
            add_scaled(sum, share, self.nodes[n as usize])
        })
    }

    /// The unit vector from the ridge at a side into its facet, in the facet and normal to the ridge.
    pub fn inward(&self, side: usize) -> [f64; D] {
        let mut ridge = self.ridge_nodes(side).map(|n| self.nodes[n as usize]);
        let opposite = self.nodes[self.facets[side / D][side % D] as usize];
        let Some(base) = ridge.next() else {
            return [0.0; D];
        };
        let mut v = sub(opposite, base);
        // In 3-D the ridge has one direction, in 2-D none.
        for end in ridge {
            let along = sub(end, base);
            let square = dot(along, along).max(f64::MIN_POSITIVE);
            v = add_scaled(v, -dot(v, along) / square, along);
        }
        unit(v)
    }

    /// Normal of a facet; its length is the facet's area (3-D) or length (2-D).
    pub fn normal(&self, facet: usize) -> [f64; D] {
        normal(&self.corners(facet))
    }

    /// Mean length of a facet's edges.
    pub fn size(&self, facet: usize) -> f64 {
        let x = self.corners(facet);
        let edges = (0..D).flat_map(|i| (0..i).map(move |j| (i, j)));
        edges.map(|(i, j)| norm(sub(x[i], x[j]))).sum::<f64>() / (D * (D - 1) / 2) as f64
    }
}

/// The ridge opposite node k, as a number: its nodes in rising order.
fn ridge_key<const D: usize>(facet: &[u32; D], k: usize) -> u64 {
    let rest = (0..D).filter(|&j| j != k).map(|j| u64::from(facet[j]));
    let (low, high) = rest.fold((u64::MAX, 0), |(low, high), n| (low.min(n), high.max(n)));
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
        let at_one = facets.ridges[0][0] as usize;
        assert_eq!(facets.sides(at_one), [0, 3, 4]);
        assert_eq!(facets.inward(0), [-1.0, 0.0]);
        assert_eq!(facets.normal(0), [0.0, -1.0]);
    }
}
