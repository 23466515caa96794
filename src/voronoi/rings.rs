//! The Delaunay simplices round every edge, in order: the faces of the Voronoi cells before they
//! have coordinates.
//!
//! Everything about an atom's faces is in its star (the simplices at it), so atoms are independent.
//! In a positive tetrahedron (a, b, c, d), the ring of edge a-b passes from c to d, anticlockwise
//! seen from b. In a positive triangle (a, b, c), the edge a-b has the triangle on its left and a-c
//! has it on its right; right then left is the order in which the Voronoi edge has a on its left.

use rayon::prelude::*;

use super::mirror::Mirrored;
use crate::mesh::poly::Lists;

/// Rings of the edges of atoms.
#[derive(Debug, Default)]
pub struct Rings {
    /// The edges (a, b): a is an atom, b another one with a higher number or an image. Ascending.
    pub edges: Vec<[u32; 2]>,
    /// The simplices round each edge, anticlockwise seen from b (in 2-D: right, left).
    pub simplices: Lists,
    /// Atoms with an edge on the hull: their cells have no end.
    pub open: Vec<u32>,
}

/// Atoms in one task.
const CHUNK: usize = 2048;

/// One simplex at an edge (a, b): `[b, from, to, simplex]`.
type Entry = [u32; 4];

/// The rings of all edges of atoms, and of no others. Simplices have N = D + 1 corners.
pub fn rings<const D: usize, const N: usize>(
    mirrored: &Mirrored<D>,
    simplices: &[[u32; N]],
) -> Rings {
    let atoms = mirrored.atoms;
    let stars = stars(atoms, simplices);
    let parts: Vec<Rings> = (0..atoms.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut part = Rings::default();
            let mut entries = Vec::new();
            for atom in chunk * CHUNK..((chunk + 1) * CHUNK).min(atoms) {
                let atom = atom as u32;
                entries.clear();
                for &s in stars.get(atom as usize) {
                    enter(atom, s, &simplices[s as usize], &mut entries);
                }
                entries.sort_unstable();
                part.chain(atom, &entries);
            }
            part
        })
        .collect();
    let mut all = Rings::default();
    all.edges.reserve(parts.iter().map(|p| p.edges.len()).sum());
    let items = parts.iter().map(|p| p.simplices.items.len()).sum();
    all.simplices.items.reserve(items);
    for part in parts {
        let base = all.simplices.items.len() as u32;
        all.edges.extend_from_slice(&part.edges);
        all.simplices.items.extend_from_slice(&part.simplices.items);
        let offsets = &part.simplices.offsets[1..];
        all.simplices
            .offsets
            .extend(offsets.iter().map(|o| o + base));
        all.open.extend_from_slice(&part.open);
    }
    all
}

/// The simplices at each atom, ascending.
fn stars<const N: usize>(atoms: usize, simplices: &[[u32; N]]) -> Lists {
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

/// Enters a simplex at the edges that it has from `a` to higher numbers.
#[inline]
fn enter<const N: usize>(a: u32, s: u32, simplex: &[u32; N], entries: &mut Vec<Entry>) {
    let at = |i: usize| simplex[i % N];
    let Some(i) = simplex.iter().position(|&n| n == a) else {
        return;
    };
    if N == 3 {
        let (b, c) = (at(i + 1), at(i + 2));
        if b > a {
            entries.push([b, 1, 0, s]);
        }
        if c > a {
            entries.push([c, 0, 1, s]);
        }
        return;
    }
    // The others in an order that keeps (a, b, c, d) positive.
    const OTHERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
    let [b, c, d] = OTHERS[i].map(at);
    for [b, c, d] in [[b, c, d], [c, d, b], [d, b, c]] {
        if b > a {
            entries.push([b, c, d, s]);
        }
    }
}

impl Rings {
    /// Chains an atom's sorted entries into rings.
    fn chain(&mut self, atom: u32, entries: &[Entry]) {
        for group in entries.chunk_by(|x, y| x[0] == y[0]) {
            let first = group[0];
            let mut at = first;
            for step in 0..group.len() {
                self.simplices.items.push(at[3]);
                if step + 1 == group.len() {
                    break;
                }
                match group.iter().find(|e| e[1] == at[2]) {
                    Some(&next) => at = next,
                    None => break,
                }
            }
            if at[2] != first[1] {
                self.open.push(atom);
            }
            self.edges.push([atom, first[0]]);
            self.simplices
                .offsets
                .push(self.simplices.items.len() as u32);
        }
    }
}
