//! The Delaunay simplices round every edge, in order: the faces of the Voronoi cells before they
//! have coordinates.
//!
//! Everything about an atom's faces is in its star (the simplices at it), so atoms are independent.
//! In a positive tetrahedron (a, b, c, d), the ring of edge a-b passes from c to d, anticlockwise
//! seen from b. In a positive triangle (a, b, c), the edge a-b has the triangle on its left and a-c
//! has it on its right; right then left is the order in which the Voronoi edge has a on its left.

use crate::parallel::prelude::*;

use crate::mesh::poly::Lists;

/// Rings of the edges of some atoms.
#[derive(Debug, Default)]
pub struct Rings {
    /// The edges (a, b): a is an atom, b another one with a higher number or an image. Ascending.
    pub edges: Vec<[u32; 2]>,
    /// The simplices round each edge, anticlockwise seen from b (in 2-D: right, left).
    pub simplices: Lists,
    /// Simplices that follow one another and whose centres are one node.
    pub coincident_pairs: Vec<[u32; 2]>,
    /// Edges (by their place in the list) whose face is as narrow as rounding, though long.
    pub narrow_edges: Vec<u32>,
    /// Atoms with an edge on the hull: their cells have no end.
    pub open_atoms: Vec<u32>,
}

/// Atoms in one task.
const CHUNK_SIZE: usize = 2048;

/// One simplex at an edge (a, b), round which it leads from one face to another.
#[derive(Debug, Clone, Copy, Default)]
struct RingStep {
    from_neighbour: u32,
    to_neighbour: u32,
    simplex: u32,
}

/// The turns at the edges of one atom.
#[derive(Debug, Default)]
struct AtomEdges {
    /// The other ends b of the edges, and how many turns each has.
    ends: Vec<(u32, u32)>,
    /// Every turn, with the number of its edge.
    steps: Vec<(u32, RingStep)>,
    /// The edges by their ends.
    order: Vec<u32>,
    /// The turns edge by edge.
    sorted_steps: Vec<RingStep>,
}

/// The rings of all edges of atoms, and of no others. Simplices have N = D + 1 corners; `one` says
/// whether the centres of two of them are one node, `narrow` whether a face with such centres is none.
pub fn rings<const N: usize>(
    atoms: usize,
    simplices: &[[u32; N]],
    one: impl Fn(u32, u32) -> bool + Sync,
    narrow: impl Fn(&[u32]) -> bool + Sync,
) -> Vec<Rings> {
    let stars = simplices_of_atoms(atoms, simplices);
    (0..atoms.div_ceil(CHUNK_SIZE))
        .into_par_iter()
        .map(|chunk| {
            let mut part = Rings::default();
            let mut star = AtomEdges::default();
            for atom in chunk * CHUNK_SIZE..((chunk + 1) * CHUNK_SIZE).min(atoms) {
                star.ends.clear();
                star.steps.clear();
                for &s in stars.get(atom) {
                    star.add_simplex(atom as u32, s, &simplices[s as usize]);
                }
                star.sort_steps();
                part.append_rings(atom as u32, &star);
            }
            for edge in 0..part.edges.len() {
                let ring = part.simplices.get(edge);
                for (i, &s) in ring.iter().enumerate() {
                    let t = ring[(i + 1) % ring.len()];
                    if one(s, t) {
                        part.coincident_pairs.push([s, t]);
                    }
                }
                if narrow(ring) {
                    part.narrow_edges.push(edge as u32);
                }
            }
            part
        })
        .collect()
}

/// The simplices that have an atom, ordered by their first one: what lies together in space, as
/// atoms do, is then together in memory.
pub fn ordered_simplices<const N: usize>(atoms: usize, simplices: &[[u32; N]]) -> Vec<[u32; N]> {
    let first = |simplex: &[u32; N]| simplex.iter().fold(u32::MAX, |a, &b| a.min(b)) as usize;
    let mut next = vec![0u32; atoms + 1];
    for simplex in simplices {
        if let Some(count) = next.get_mut(first(simplex) + 1) {
            *count += 1;
        }
    }
    for i in 0..atoms {
        next[i + 1] += next[i];
    }
    let mut sorted = vec![[0; N]; next[atoms] as usize];
    for simplex in simplices {
        let first = first(simplex);
        if first < atoms {
            sorted[next[first] as usize] = *simplex;
            next[first] += 1;
        }
    }
    sorted
}

/// The simplices at each atom, ascending.
fn simplices_of_atoms<const N: usize>(atoms: usize, simplices: &[[u32; N]]) -> Lists {
    let mut offsets = vec![0u32; atoms + 1];
    for &node in simplices.as_flattened() {
        if (node as usize) < atoms {
            offsets[node as usize + 1] += 1;
        }
    }
    for i in 0..atoms {
        offsets[i + 1] += offsets[i];
    }
    let mut next = offsets.clone();
    let mut items = vec![0u32; offsets[atoms] as usize];
    for (s, simplex) in simplices.iter().enumerate() {
        for &node in simplex {
            if (node as usize) < atoms {
                let at = &mut next[node as usize];
                items[*at as usize] = s as u32;
                *at += 1;
            }
        }
    }
    Lists { offsets, items }
}

impl AtomEdges {
    /// Enters a simplex at the edges that it has from `a` to higher numbers.
    #[inline]
    fn add_simplex<const N: usize>(&mut self, a: u32, s: u32, simplex: &[u32; N]) {
        let at = |i: usize| simplex[i % N];
        let Some(i) = simplex.iter().position(|&n| n == a) else {
            return;
        };
        if N == 3 {
            let (b, c) = (at(i + 1), at(i + 2));
            self.add_step(a, b, 1, 0, s);
            self.add_step(a, c, 0, 1, s);
            return;
        }
        // The others in an order that keeps (a, b, c, d) positive.
        const OTHER_CORNERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
        let [b, c, d] = OTHER_CORNERS[i].map(at);
        self.add_step(a, b, c, d, s);
        self.add_step(a, c, d, b, s);
        self.add_step(a, d, b, c, s);
    }

    #[inline]
    fn add_step(&mut self, a: u32, b: u32, from: u32, to: u32, simplex: u32) {
        if b < a {
            return;
        }
        let edge = match self.ends.iter().position(|end| end.0 == b) {
            Some(edge) => edge,
            None => {
                self.ends.push((b, 0));
                self.ends.len() - 1
            }
        };
        self.ends[edge].1 += 1;
        self.steps.push((
            edge as u32,
            RingStep {
                from_neighbour: from,
                to_neighbour: to,
                simplex,
            },
        ));
    }

    /// Puts edges in the order of their ends and turns in that of edges.
    fn sort_steps(&mut self) {
        self.order.clear();
        self.order.extend(0..self.ends.len() as u32);
        self.order
            .sort_unstable_by_key(|&edge| self.ends[edge as usize].0);
        let mut start = 0;
        for &edge in &self.order {
            let count = &mut self.ends[edge as usize].1;
            start += *count;
            *count = start - *count;
        }
        self.sorted_steps
            .resize(self.steps.len(), RingStep::default());
        for (edge, turn) in &self.steps {
            let at = &mut self.ends[*edge as usize].1;
            self.sorted_steps[*at as usize] = *turn;
            *at += 1;
        }
        // Each count has become the end of the edge's turns.
    }
}

impl Rings {
    /// Chains an atom's turns into rings.
    fn append_rings(&mut self, atom: u32, star: &AtomEdges) {
        let mut start = 0;
        for &edge in &star.order {
            let (b, end) = star.ends[edge as usize];
            let turns = &star.sorted_steps[start..end as usize];
            start = end as usize;
            // In the plane, right (from 0) comes before left.
            let first = turns.iter().min_by_key(|turn| turn.from_neighbour);
            let Some(&first) = first else { continue };
            let mut at = first;
            self.simplices.items.push(at.simplex);
            for _ in 1..turns.len() {
                match turns
                    .iter()
                    .find(|turn| turn.from_neighbour == at.to_neighbour)
                {
                    Some(&next) => at = next,
                    None => break,
                }
                self.simplices.items.push(at.simplex);
            }
            if at.to_neighbour != first.from_neighbour {
                self.open_atoms.push(atom);
            }
            self.edges.push([atom, b]);
            self.simplices
                .offsets
                .push(self.simplices.items.len() as u32);
        }
    }
}
