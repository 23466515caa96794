//! Crumbs that close a hole of a surface: steps where the mesh could not follow it more smoothly.

use std::collections::BTreeMap;

use super::facets::FacetComplex;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{norm, sub};

/// Crumbs that hang together are part of a surface with which they share this much of their rim.
const MIN_SHARED_RIM_RATIO: f64 = 0.5;

/// For each surface, if it is one of the `crumbs`, the surface that it is part of, if there is one that
/// is none of them. `surface` holds the surface of each facet.
pub fn hole_patches<const D: usize>(
    facets: &FacetComplex<D>,
    surface: &[u32],
    crumbs: &[bool],
) -> Vec<Option<u32>> {
    // The surfaces at a ridge, in rising order, as often as they have facets there.
    let at = |ridge: usize| {
        let sides = facets.sides(ridge);
        let mut here: Vec<u32> = sides.iter().map(|&o| surface[o as usize / D]).collect();
        here.sort_unstable();
        here
    };
    let is_crumb = |s: &u32| crumbs[*s as usize];
    let mut clusters = UnionFind::new(crumbs.len());
    for ridge in 0..facets.ridge_count() {
        let mut here = at(ridge);
        here.retain(is_crumb);
        for pair in here.windows(2) {
            clusters.unite(pair[0], pair[1]);
        }
    }
    let mut rim = vec![0.0; crumbs.len()];
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for ridge in 0..facets.ridge_count() {
        let mut here = at(ridge);
        // All crumbs here are of one cluster.
        let inside = here.iter().copied().filter(is_crumb);
        let Some(cluster) = inside.clone().next().map(|s| clusters.find(s)) else {
            continue;
        };
        if inside.count() != 1 {
            continue;
        }
        let length = ridge_length(facets, facets.sides(ridge)[0] as usize);
        rim[cluster as usize] += length;
        here.dedup();
        for whole in here.into_iter().filter(|s| !is_crumb(s)) {
            *shared.entry((cluster, whole)).or_default() += length;
        }
    }
    let mut part_of = vec![None; crumbs.len()];
    let mut most = vec![0.0; crumbs.len()];
    for ((cluster, whole), length) in shared {
        let c = cluster as usize;
        if length >= MIN_SHARED_RIM_RATIO * rim[c] && length > most[c] {
            (most[c], part_of[c]) = (length, Some(whole));
        }
    }
    let of_cluster = |s: u32| part_of[clusters.find(s) as usize].filter(|_| is_crumb(&s));
    (0..crumbs.len() as u32).map(of_cluster).collect()
}

/// Length of the ridge at a side; 1 in the plane, where it is a node.
fn ridge_length<const D: usize>(facets: &FacetComplex<D>, side: usize) -> f64 {
    let mut ends = facets.ridge_nodes(side).map(|n| facets.nodes[n as usize]);
    match (ends.next(), ends.next()) {
        (Some(a), Some(b)) => norm(sub(a, b)),
        _ => 1.0,
    }
}
