//! The order of tetrahedra that does not depend on how they were found.

use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use super::{DelaunayTets, OUTSIDE};
use crate::geometry::counting_sort::sort_by_group_into;
use crate::parallel::prelude::*;

/// Number of points whose tetrahedra one task sorts.
const SORT_CHUNK: usize = 4096;

/// Sorts tetrahedra into an order that depends only on the tetrahedra themselves. `points` is the
/// number of points. Each is rotated,
/// with its orientation unchanged, to start with its lowest node and continue with the lowest of
/// the others; then the tetrahedra are sorted by their nodes.
pub fn sort_canonical(points: usize, output: &mut DelaunayTets) {
    let DelaunayTets { tets, neighbors } = output;
    let with_neighbors = !neighbors.is_empty();
    let rotations: Vec<[u8; 4]> = tets.par_iter().map(canonical_rotation).collect();
    let rotated = |t: u32| rotations[t as usize].map(|k| tets[t as usize][usize::from(k)]);
    // Group by the first node,
    let first = |t: u32| rotated(t)[0];
    let firsts: Vec<u32> = (0..tets.len() as u32).into_par_iter().map(first).collect();
    let (mut starts, mut sorted) = (Vec::new(), Vec::new());
    sort_by_group_into(points, &firsts, &mut starts, &mut sorted);
    drop(firsts);
    // then sort each group by the other nodes.
    let mut remaining = sorted.as_mut_slice();
    let mut chunks = Vec::with_capacity(points / SORT_CHUNK + 1);
    for first in (0..points).step_by(SORT_CHUNK) {
        let last = (first + SORT_CHUNK).min(points);
        let (chunk, tail) = remaining.split_at_mut((starts[last] - starts[first]) as usize);
        remaining = tail;
        chunks.push((first..last, chunk));
    }
    chunks.into_par_iter().for_each(|(nodes, chunk)| {
        let chunk_start = starts[nodes.start];
        for node in nodes {
            let range =
                (starts[node] - chunk_start) as usize..(starts[node + 1] - chunk_start) as usize;
            chunk[range].sort_unstable_by_key(|&t| rotated(t));
        }
    });
    let new_tets = sorted.par_iter().map(|&t| rotated(t)).collect();
    if with_neighbors {
        let new_index = tets.par_iter().map(|_| AtomicU32::new(0));
        let new_index: Vec<AtomicU32> = new_index.collect();
        let pairs = sorted.par_iter().enumerate();
        pairs.for_each(|(new, &old)| new_index[old as usize].store(new as u32, Relaxed));
        let renumbered = |&t: &u32| {
            rotations[t as usize].map(|k| match neighbors[t as usize][usize::from(k)] {
                OUTSIDE => OUTSIDE,
                n => new_index[n as usize].load(Relaxed),
            })
        };
        *neighbors = sorted.par_iter().map(renumbered).collect();
    }
    *tets = new_tets;
}

/// Returns the even permutation that puts the lowest node first and the lowest of the others
/// second.
fn canonical_rotation(tet: &[u32; 4]) -> [u8; 4] {
    const ROTATIONS: [[u8; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
    let min_corner = (0..4).min_by_key(|&k| tet[k]).unwrap_or(0);
    let [a, b, c, d] = ROTATIONS[min_corner];
    let others = [[b, c, d], [c, d, b], [d, b, c]];
    let [b, c, d] = others
        .into_iter()
        .min_by_key(|others| tet[usize::from(others[0])])
        .unwrap_or([b, c, d]);
    [a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::geometry::{cross, dot, sub};
    use crate::mesh::delaunay::Kernel;
    use crate::mesh::delaunay::native::Native;

    #[test]
    fn canonical_order_keeps_tetrahedra_and_neighbours() {
        let mut random = Random::new(7);
        let points: Vec<[f64; 3]> = (0..500).map(|_| [(); 3].map(|()| random.draw())).collect();
        let before = Native.triangulate(&points, true).unwrap();
        let mut after = before.clone();
        sort_canonical(points.len(), &mut after);
        let sorted = |tets: &[[u32; 4]]| {
            let mut all: Vec<[u32; 4]> = tets.to_vec();
            all.iter_mut().for_each(|t| t.sort_unstable());
            all.sort_unstable();
            all
        };
        assert_eq!(sorted(&before.tets), sorted(&after.tets));
        assert!(after.tets.is_sorted());
        for (t, tet) in after.tets.iter().enumerate() {
            let [a, b, c, d] = tet.map(|i| points[i as usize]);
            assert!(dot(cross(sub(b, a), sub(c, a)), sub(d, a)) > 0.0);
            for (k, &n) in after.neighbors[t]
                .iter()
                .enumerate()
                .filter(|n| *n.1 != OUTSIDE)
            {
                let shared = [1, 2, 3].map(|j| tet[(k + j) % 4]);
                assert!(
                    shared
                        .iter()
                        .all(|node| after.tets[n as usize].contains(node))
                );
                assert!(after.neighbors[n as usize].contains(&(t as u32)));
            }
        }
    }
}
