//! Finds the Delaunay simplices around every edge, in order: the faces of the Voronoi cells before
//! they have coordinates.
//!
//! An atom's faces depend only on its star (the simplices at it), so atoms can be processed in
//! parallel. In a positive tetrahedron (a, b, c, d), the ring of edge a-b passes from c to d,
//! anticlockwise seen from b. In a positive triangle (a, b, c), the edge a-b has the triangle on
//! its left, and a-c has it on its right. Right then left is the order in which the Voronoi edge
//! has a on its left.

use crate::geometry::counting_sort::sort_by_group;
use crate::parallel::prelude::*;

use crate::mesh::poly::Lists;

/// Rings of the edges of a chunk of atoms.
#[derive(Debug, Default)]
pub struct Rings {
    /// The edges (a, b), ascending: a is an atom, b another atom with a higher number, or an image.
    pub edges: Vec<[u32; 2]>,
    /// The simplices around each edge, anticlockwise seen from b (in 2-D: right, left).
    pub simplices: Lists,
    /// Successive simplices in a ring whose centres coincide.
    pub coincident_pairs: Vec<[u32; 2]>,
    /// Edges (indices into `edges`) whose face is long but as narrow as rounding errors.
    pub narrow_edges: Vec<u32>,
    /// Atoms with an edge on the hull: their cells are unbounded.
    pub open_atoms: Vec<u32>,
}

/// Number of atoms in one parallel task.
const CHUNK_SIZE: usize = 2048;

/// One simplex at an edge (a, b), which leads around the edge from one face to the next.
#[derive(Debug, Clone, Copy, Default)]
struct RingStep {
    from_neighbour: u32,
    to_neighbour: u32,
    simplex: u32,
}

/// The steps around all edges of one atom.
#[derive(Debug, Default)]
struct AtomEdges {
    /// The other ends b of the edges, and the number of steps of each.
    ends: Vec<(u32, u32)>,
    /// All steps, each with the number of its edge.
    steps: Vec<(u32, RingStep)>,
    /// The edges, sorted by their ends.
    order: Vec<u32>,
    /// The steps, sorted by edge.
    sorted_steps: Vec<RingStep>,
}

/// Returns the rings of all edges that have an atom as one end. Simplices have N = D + 1 corners.
/// `coincide` returns whether the centres of two simplices coincide, `is_narrow` whether a face
/// with these centres is a needle.
pub fn rings<const N: usize>(
    atoms: usize,
    simplices: &[[u32; N]],
    coincide: impl Fn(u32, u32) -> bool + Sync,
    is_narrow: impl Fn(&[u32]) -> bool + Sync,
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
                    if coincide(s, t) {
                        part.coincident_pairs.push([s, t]);
                    }
                }
                if is_narrow(ring) {
                    part.narrow_edges.push(edge as u32);
                }
            }
            part
        })
        .collect()
}

/// Returns the simplices that have an atom as a corner, sorted by their first corner. Atoms close
/// to each other in space have close numbers, so neighbouring simplices are then close in memory.
pub fn ordered_simplices<const N: usize>(atoms: usize, simplices: &[[u32; N]]) -> Vec<[u32; N]> {
    let first_node = |simplex: &[u32; N]| simplex.iter().fold(u32::MAX, |a, &b| a.min(b)) as usize;
    let (_, order) = sort_by_group(atoms, simplices.iter().map(first_node));
    order.iter().map(|&s| simplices[s as usize]).collect()
}

/// Returns the simplices at each atom, ascending.
fn simplices_of_atoms<const N: usize>(atoms: usize, simplices: &[[u32; N]]) -> Lists {
    Lists::inverse(atoms, simplices)
}

impl AtomEdges {
    /// Adds a simplex to the edges that it has from `a` to higher numbers.
    #[inline]
    fn add_simplex<const N: usize>(&mut self, a: u32, s: u32, simplex: &[u32; N]) {
        let corner = |i: usize| simplex[i % N];
        let Some(i) = simplex.iter().position(|&n| n == a) else {
            return;
        };
        if N == 3 {
            let (b, c) = (corner(i + 1), corner(i + 2));
            self.add_step(a, b, 1, 0, s);
            self.add_step(a, c, 0, 1, s);
            return;
        }
        // The other corners in an order that keeps (a, b, c, d) positive.
        const OTHER_CORNERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
        let [b, c, d] = OTHER_CORNERS[i].map(corner);
        self.add_step(a, b, c, d, s);
        self.add_step(a, c, d, b, s);
        self.add_step(a, d, b, c, s);
    }

    #[inline]
    fn add_step(&mut self, a: u32, b: u32, from_neighbour: u32, to_neighbour: u32, simplex: u32) {
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
                from_neighbour,
                to_neighbour,
                simplex,
            },
        ));
    }

    /// Sorts the edges by their ends, and the steps by edge.
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
        for (edge, step) in &self.steps {
            let slot = &mut self.ends[*edge as usize].1;
            self.sorted_steps[*slot as usize] = *step;
            *slot += 1;
        }
        // Each count has now become the end of the edge's steps.
    }
}

impl Rings {
    /// Chains an atom's steps into rings.
    fn append_rings(&mut self, atom: u32, star: &AtomEdges) {
        let mut start = 0;
        for &edge in &star.order {
            let (b, end) = star.ends[edge as usize];
            let steps = &star.sorted_steps[start..end as usize];
            start = end as usize;
            // In 2-D, right (from 0) comes before left.
            let first = steps.iter().min_by_key(|step| step.from_neighbour);
            let Some(&first) = first else { continue };
            let mut current = first;
            self.simplices.items.push(current.simplex);
            for _ in 1..steps.len() {
                match steps
                    .iter()
                    .find(|step| step.from_neighbour == current.to_neighbour)
                {
                    Some(&next) => current = next,
                    None => break,
                }
                self.simplices.items.push(current.simplex);
            }
            if current.to_neighbour != first.from_neighbour {
                self.open_atoms.push(atom);
            }
            self.edges.push([atom, b]);
            self.simplices
                .offsets
                .push(self.simplices.items.len() as u32);
        }
    }
}
