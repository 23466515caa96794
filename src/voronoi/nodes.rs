//! The nodes of Voronoi cells: centres of Delaunay simplices, those at one place made one node, and
//! those at a side of the box put onto it exactly.

use rayon::prelude::*;

use super::mirror::Mirrored;
use super::rings::Rings;

/// Centres nearer to a side than this share of their sphere's radius are on it.
const ON_SIDE: f64 = 1e-9;

/// A node: where, and how far its atoms are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node<const D: usize> {
    /// Its position, exactly on the sides that it is on.
    pub position: [f64; D],
    /// Distance to its atoms.
    pub radius: f64,
}

/// The centre of every simplex that has an atom; others are far away.
pub fn centres<const D: usize, const N: usize>(
    mirrored: &Mirrored<D>,
    simplices: &[[u32; N]],
    extent: [f64; D],
    centre: impl Fn([[f64; D]; N]) -> ([f64; D], f64) + Sync,
) -> Vec<Node<D>> {
    simplices
        .par_iter()
        .map(|simplex| {
            if simplex.iter().all(|&n| n as usize >= mirrored.atoms) {
                return Node {
                    position: [f64::INFINITY; D],
                    radius: 0.0,
                };
            }
            let (mut position, square) = centre(simplex.map(|n| mirrored.points[n as usize]));
            let radius = square.sqrt();
            for k in 0..D {
                for side in [0.0, extent[k]] {
                    if (position[k] - side).abs() <= ON_SIDE * radius {
                        position[k] = side;
                    }
                }
            }
            Node { position, radius }
        })
        .collect()
}

/// The sides of the box beyond which a node lies, as bits; none for one without atoms.
pub fn sides_beyond<const D: usize>(node: &Node<D>, extent: [f64; D]) -> u8 {
    if node.radius == 0.0 {
        return 0;
    }
    (0..D).fold(0, |sides, k| {
        let below = u8::from(node.position[k] < 0.0);
        let above = u8::from(node.position[k] > extent[k]);
        sides | (below | above << 1) << (2 * k)
    })
}

/// For each simplex, the simplex whose centre is its node: centres that follow each other round an
/// edge and are no farther apart than `tolerance` times the radius are one node.
pub fn merged<const D: usize>(nodes: &[Node<D>], rings: &Rings, tolerance: f64) -> Vec<u32> {
    let close = |&(s, t): &(u32, u32)| {
        let (a, b) = (&nodes[s as usize], &nodes[t as usize]);
        let square: f64 = (0..D)
            .map(|k| (a.position[k] - b.position[k]).powi(2))
            .sum();
        square <= (tolerance * a.radius.min(b.radius)).powi(2)
    };
    let pairs: Vec<(u32, u32)> = (0..rings.edges.len())
        .into_par_iter()
        .with_min_len(4096)
        .flat_map_iter(|edge| {
            let ring = rings.simplices.get(edge);
            (0..ring.len())
                .map(|i| (ring[i], ring[(i + 1) % ring.len()]))
                .filter(close)
        })
        .collect();
    let mut first: Vec<u32> = (0..nodes.len() as u32).collect();
    for (s, t) in pairs {
        let (s, t) = (root(&mut first, s), root(&mut first, t));
        first[s.max(t) as usize] = s.min(t);
    }
    for s in 0..first.len() {
        // Roots come before what they are the root of.
        first[s] = first[first[s] as usize];
    }
    first
}

fn root(first: &mut [u32], mut s: u32) -> u32 {
    while first[s as usize] != s {
        first[s as usize] = first[first[s as usize] as usize];
        s = first[s as usize];
    }
    s
}
