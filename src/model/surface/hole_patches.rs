//! Fragments that close a hole of a surface: steps where the mesh did not follow the surface more
//! smoothly.

use std::collections::BTreeMap;

use super::facets::FacetComplex;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{norm, sub};

/// Smallest fraction of its rim that a cluster of fragments shares with the surface to which it
/// belongs.
const MIN_SHARED_RIM_RATIO: f64 = 0.5;

/// Returns for each fragment the surface to which it belongs, if there is one; `None` for other
/// surfaces. `surface` holds the surface of each facet, and `fragments` is `true` for surfaces that
/// are fragments.
pub fn hole_patches<const D: usize>(
    facets: &FacetComplex<D>,
    surface: &[u32],
    fragments: &[bool],
) -> Vec<Option<u32>> {
    // The surface of each facet at a ridge, in ascending order.
    let surfaces_at = |ridge: usize| {
        let sides = facets.sides(ridge);
        let mut surfaces: Vec<u32> = sides.iter().map(|&o| surface[o as usize / D]).collect();
        surfaces.sort_unstable();
        surfaces
    };
    let is_fragment = |s: &u32| fragments[*s as usize];
    let mut clusters = UnionFind::new(fragments.len());
    for ridge in 0..facets.ridge_count() {
        let mut surfaces = surfaces_at(ridge);
        surfaces.retain(is_fragment);
        for pair in surfaces.windows(2) {
            clusters.unite(pair[0], pair[1]);
        }
    }
    let mut rim = vec![0.0; fragments.len()];
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for ridge in 0..facets.ridge_count() {
        let mut surfaces = surfaces_at(ridge);
        // All fragments at a ridge belong to one cluster.
        let ridge_fragments = surfaces.iter().copied().filter(is_fragment);
        let Some(cluster) = ridge_fragments.clone().next().map(|s| clusters.find(s)) else {
            continue;
        };
        if ridge_fragments.count() != 1 {
            continue;
        }
        let length = ridge_length(facets, facets.sides(ridge)[0] as usize);
        rim[cluster as usize] += length;
        surfaces.dedup();
        for parent in surfaces.into_iter().filter(|s| !is_fragment(s)) {
            *shared.entry((cluster, parent)).or_default() += length;
        }
    }
    let mut parent_of = vec![None; fragments.len()];
    let mut max_length = vec![0.0; fragments.len()];
    for ((cluster, parent), length) in shared {
        let c = cluster as usize;
        if length >= MIN_SHARED_RIM_RATIO * rim[c] && length > max_length[c] {
            (max_length[c], parent_of[c]) = (length, Some(parent));
        }
    }
    let parent_surface = |s: u32| parent_of[clusters.find(s) as usize].filter(|_| is_fragment(&s));
    (0..fragments.len() as u32).map(parent_surface).collect()
}

/// Returns the length of the ridge at a side; 1 in 2-D, where a ridge is a node.
fn ridge_length<const D: usize>(facets: &FacetComplex<D>, side: usize) -> f64 {
    let mut ends = facets.ridge_nodes(side).map(|n| facets.nodes[n as usize]);
    match (ends.next(), ends.next()) {
        (Some(a), Some(b)) => norm(sub(a, b)),
        _ => 1.0,
    }
}
