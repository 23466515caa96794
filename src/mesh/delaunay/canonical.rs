//! The order of tetrahedra that does not depend on how they were found.

use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use super::DelaunayTets;
use crate::geometry::NONE;
use crate::geometry::counting_sort::sort_by_group_into;
use crate::parallel::prelude::*;

/// Number of points whose tetrahedra one task sorts.
const SORT_CHUNK: usize = 4096;
/// Number of tetrahedra that one task renumbers.
const TASK_SIZE: usize = 1 << 14;

/// Sorts tetrahedra into an order that depends only on the tetrahedra themselves. `points` is the
/// number of points. Each is rotated,
/// with its orientation unchanged, to start with its lowest node and continue with the lowest of
/// the others; then the tetrahedra are sorted by their nodes.
pub fn sort_canonical(points: usize, output: &mut DelaunayTets) {
    let DelaunayTets { tets, neighbours } = output;
    let mut firsts = vec![0; tets.len()];
    rotate_all(tets, neighbours, &mut firsts);
    // Group by the first node,
    let (mut starts, mut order) = (Vec::new(), Vec::new());
    sort_by_group_into(points, &firsts, &mut starts, &mut order);
    drop(firsts);
    // then sort each group by the other nodes.
    let mut sorted_tets = vec![[0; 4]; tets.len()];
    let mut chunks = Vec::with_capacity(points / SORT_CHUNK + 1);
    let mut remaining = (order.as_mut_slice(), sorted_tets.as_mut_slice());
    for first in (0..points).step_by(SORT_CHUNK) {
        let last = (first + SORT_CHUNK).min(points);
        let count = (starts[last] - starts[first]) as usize;
        let (order, order_tail) = remaining.0.split_at_mut(count);
        let (sorted, sorted_tail) = remaining.1.split_at_mut(count);
        remaining = (order_tail, sorted_tail);
        chunks.push((first..last, order, sorted));
    }
    chunks.into_par_iter().for_each(|(nodes, order, sorted)| {
        let chunk_start = starts[nodes.start];
        let mut group = Vec::new();
        for node in nodes {
            let [start, end] =
                [starts[node], starts[node + 1]].map(|at| (at - chunk_start) as usize);
            group.clear();
            group.extend(order[start..end].iter().map(|&t| {
                let [_, b, c, d] = tets[t as usize];
                ([b, c, d], t)
            }));
            group.sort_unstable();
            for (&([b, c, d], t), i) in group.iter().zip(start..) {
                (order[i], sorted[i]) = (t, [node as u32, b, c, d]);
            }
        }
    });
    *tets = sorted_tets;
    if neighbours.is_empty() {
        return;
    }
    let new_index: Vec<AtomicU32> = (0..order.len()).map(|_| AtomicU32::new(0)).collect();
    let tasks = order.par_chunks(TASK_SIZE).enumerate();
    tasks.for_each(|(task, order)| {
        for (&old, new) in order.iter().zip(task * TASK_SIZE..) {
            new_index[old as usize].store(new as u32, Relaxed);
        }
    });
    let mut sorted_neighbours = vec![[0; 4]; neighbours.len()];
    let tasks = sorted_neighbours
        .par_chunks_mut(TASK_SIZE)
        .zip(order.par_chunks(TASK_SIZE));
    tasks.for_each(|(sorted, order)| {
        for (sorted, &old) in sorted.iter_mut().zip(order) {
            *sorted = neighbours[old as usize].map(|n| match n {
                NONE => NONE,
                n => new_index[n as usize].load(Relaxed),
            });
        }
    });
    *neighbours = sorted_neighbours;
}

/// Rotates each tetrahedron to start with its lowest node and continue with the lowest of the
/// others, and writes the lowest nodes to `firsts`.
fn rotate_all(tets: &mut [[u32; 4]], neighbours: &mut [[u32; 4]], firsts: &mut [u32]) {
    let has_neighbours = !neighbours.is_empty();
    let mut neighbour_tasks = neighbours.chunks_mut(TASK_SIZE);
    let tasks: Vec<_> = (tets.chunks_mut(TASK_SIZE))
        .zip(firsts.chunks_mut(TASK_SIZE))
        .map(|(tets, firsts)| (tets, firsts, neighbour_tasks.next().unwrap_or_default()))
        .collect();
    tasks
        .into_par_iter()
        .for_each(|(tets, firsts, neighbours)| {
            for (i, (tet, first)) in tets.iter_mut().zip(firsts).enumerate() {
                let rotation = canonical_rotation(tet);
                *tet = rotation.map(|k| tet[usize::from(k)]);
                *first = tet[0];
                if has_neighbours {
                    neighbours[i] = rotation.map(|k| neighbours[i][usize::from(k)]);
                }
            }
        });
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
            for (k, &n) in after.neighbours[t]
                .iter()
                .enumerate()
                .filter(|n| *n.1 != NONE)
            {
                let shared = [1, 2, 3].map(|j| tet[(k + j) % 4]);
                assert!(
                    shared
                        .iter()
                        .all(|node| after.tets[n as usize].contains(node))
                );
                assert!(after.neighbours[n as usize].contains(&(t as u32)));
            }
        }
    }
}
