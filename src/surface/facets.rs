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

use rayon::prelude::*;

/// No number.
pub const NONE: u32 = u32::MAX;

/// Facets with their ridges. Positions are the caller's: in one space, lattice or physical.
#[derive(Debug, Clone)]
pub struct Facets<'a, const D: usize> {
    /// Node positions.
    pub nodes: &'a [[f64; D]],
    /// Nodes of each facet.
    pub facets: Vec<[u32; D]>,
    /// `ridges[f][k]` is the number of the ridge of facet f opposite its node k.
    pub ridges: Vec<[u32; D]>,
    start: Vec<u32>,
    sides: Vec<u32>,
}

impl<'a, const D: usize> Facets<'a, D> {
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

    /// Whether there is no facet.
    pub fn is_empty(&self) -> bool {
        self.facets.is_empty()
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
    pub fn ridge_middle(&self, side: usize) -> [f64; D] {
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
        edges.map(|(i, j)| length(sub(x[i], x[j]))).sum::<f64>() / (D * (D - 1) / 2) as f64
    }
}

/// The ridge opposite node k, as a number: its nodes in rising order.
fn ridge_key<const D: usize>(facet: &[u32; D], k: usize) -> u64 {
    let rest = (0..D).filter(|&j| j != k).map(|j| u64::from(facet[j]));
    let (low, high) = rest.fold((u64::MAX, 0), |(low, high), n| (low.min(n), high.max(n)));
    low << 32 | high
}

/// Normal of a facet; its length is the facet's area (3-D) or length (2-D). In 3-D the nodes turn
/// anticlockwise seen from where it points to, in 2-D it points to the right of the edge.
pub fn normal<const D: usize>(x: &[[f64; D]; D]) -> [f64; D] {
    let u = sub(x[1], x[0]);
    let mut n = [0.0; D];
    if D == 2 {
        n[0] = u[1];
        n[1] = -u[0];
    } else {
        let v = sub(x[2], x[0]);
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            n[k] = 0.5 * (u[i] * v[j] - u[j] * v[i]);
        }
    }
    n
}

/// `a - b`.
#[inline]
pub fn sub<const D: usize>(a: [f64; D], b: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| a[k] - b[k])
}

/// `a + s b`.
#[inline]
pub fn add_scaled<const D: usize>(a: [f64; D], s: f64, b: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| a[k] + s * b[k])
}

/// Scalar product.
#[inline]
pub fn dot<const D: usize>(a: [f64; D], b: [f64; D]) -> f64 {
    (0..D).map(|k| a[k] * b[k]).sum()
}

/// Length.
#[inline]
pub fn length<const D: usize>(a: [f64; D]) -> f64 {
    dot(a, a).sqrt()
}

/// The unit vector along `a`; zero for zero.
#[inline]
pub fn unit<const D: usize>(a: [f64; D]) -> [f64; D] {
    let long = length(a);
    if long > 0.0 { a.map(|c| c / long) } else { a }
}

/// Sets of numbers that are united pair by pair; the smallest member names a set.
#[derive(Debug, Clone)]
pub struct Sets(Vec<u32>);

impl Sets {
    /// `count` sets of one number each.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The name of the set that holds `i`.
    pub fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    /// Unites the sets of `i` and `j`.
    pub fn unite(&mut self, i: u32, j: u32) {
        let (i, j) = (self.find(i), self.find(j));
        self.0[i.max(j) as usize] = i.min(j);
    }

    /// For each number the number of its set, sets being numbered in the order of their names; and
    /// how many sets there are.
    pub fn numbered(mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut number = vec![NONE; self.0.len()];
        for i in 0..self.0.len() as u32 {
            let name = self.find(i) as usize;
            // A name is the smallest of its set, so it comes first.
            if name as u32 == i {
                number[name] = count;
                count += 1;
            } else {
                number[i as usize] = number[name];
            }
        }
        (number, count as usize)
    }
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
        let facets = Facets::new(&nodes, vec![[0, 1, 2], [3, 2, 1]]);
        assert_eq!(facets.ridge_count(), 5);
        let shared = facets.ridges[0][0] as usize;
        assert_eq!(facets.sides(shared), [0, 3]);
        let middle = facets.ridge_middle(0);
        assert_eq!(middle, [1.0, 0.5, 0.0]);
        let inward = facets.inward(0);
        assert!(dot(inward, [2.0, -1.0, 0.0]).abs() < 1e-15 && inward[0] < 0.0);
        assert_eq!(facets.normal(0), [0.0, 0.0, 1.0]);
        assert!((facets.size(0) - (3.0 + 5f64.sqrt()) / 3.0).abs() < 1e-15);
    }

    #[test]
    fn in_two_dimensions_ridges_are_nodes() {
        let nodes = [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [1.0, -1.0]];
        let facets = Facets::new(&nodes, vec![[0, 1], [1, 2], [3, 1]]);
        assert_eq!(facets.ridge_count(), 4);
        let at_one = facets.ridges[0][0] as usize;
        assert_eq!(facets.sides(at_one), [0, 3, 4]);
        assert_eq!(facets.inward(0), [-1.0, 0.0]);
        assert_eq!(facets.normal(0), [0.0, -1.0]);
    }

    #[test]
    fn sets_are_numbered_in_order() {
        let mut sets = Sets::new(6);
        sets.unite(5, 1);
        sets.unite(4, 2);
        sets.unite(4, 5);
        assert_eq!(sets.numbered(), (vec![0, 1, 1, 2, 1, 1], 3));
    }
}
