//! Gaps in surfaces, closed by facets that the mesh has there.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::facets::{Facets, NONE};
use crate::geometry::{dot, unit};

/// Closes gaps: adds those `candidates` (facets of the mesh that are in no surface) whose nodes all
/// belong to one surface, which continue it across at least one ridge of its rim with less bend than
/// `straight`, the cosine, allows, and leave no ridge with three of its facets. Straightest first.
///
/// `surface` holds the surface of each of the facets, `normals` their averaged unit normals. Returns
/// the facets added, each with its surface.
pub fn fill<const D: usize>(
    facets: &Facets<D>,
    surface: &[u32],
    normals: &[[f64; D]],
    candidates: &[[u32; D]],
    straight: f64,
) -> Vec<([u32; D], u32)> {
    let own = facets.len();
    let mut on: Vec<(u32, u32)> = (facets.facets.iter().zip(surface))
        .flat_map(|(facet, &s)| facet.map(|n| (n, s)))
        .collect();
    on.sort_unstable();
    on.dedup();
    let holds = |s: u32, facet: &[u32; D]| facet.iter().all(|&n| on.binary_search(&(n, s)).is_ok());

    let all = [facets.facets.as_slice(), candidates].concat();
    let all = Facets::new(facets.nodes, all);
    let mut surface = surface.to_vec();
    surface.resize(all.len(), NONE);
    let mut normals = normals.to_vec();
    normals.extend((own..all.len()).map(|f| unit(all.normal(f))));

    // Queued: how straight, as an ordered number, then candidate and surface.
    let mut queue: BinaryHeap<(u64, Reverse<u32>, u32)> = BinaryHeap::new();
    let beyond = |side: usize, s: u32, surface: &[u32], normals: &[[f64; D]]| {
        let ridge = all.ridges[side / D][side % D] as usize;
        let sides = all.sides(ridge);
        let members = sides.iter().filter(|&&o| surface[o as usize / D] == s);
        if members.count() != 1 {
            return Vec::new();
        }
        let candidate = |&o: &u32| {
            let f = o as usize / D;
            let bend = -dot(all.inward(side), all.inward(o as usize));
            let parallel = dot(normals[side / D], normals[f]).abs();
            let fit = bend.min(parallel);
            let fits = surface[f] == NONE && fit > straight && holds(s, &all.facets[f]);
            fits.then_some((fit.to_bits(), Reverse(f as u32), s))
        };
        sides.iter().filter_map(candidate).collect()
    };
    for side in 0..D * own {
        queue.extend(beyond(side, surface[side / D], &surface, &normals));
    }
    let mut added = Vec::new();
    while let Some((_, Reverse(f), s)) = queue.pop() {
        let f = f as usize;
        let members = |k: usize| {
            let sides = all.sides(all.ridges[f][k] as usize);
            sides
                .iter()
                .filter(|&&o| surface[o as usize / D] == s)
                .count()
        };
        if surface[f] != NONE || (0..D).any(|k| members(k) > 1) || (0..D).all(|k| members(k) == 0) {
            continue;
        }
        surface[f] = s;
        added.push((all.facets[f], s));
        for k in 0..D {
            queue.extend(beyond(D * f + k, s, &surface, &normals));
        }
    }
    added
}
