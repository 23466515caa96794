//! A part of a mesh as a mesh of its own, and parts put together.

use crate::parallel::prelude::*;

use super::super::NodeConstraint;
use crate::files::codec::codec_fields;
use crate::lattice::AtomKind;
use crate::mesh::FACES;
use crate::mesh::complex::NONE;

/// Some tetrahedra of a mesh, and what is known of their nodes. Nodes have numbers of their own here, in the order
/// of those that they have in the whole.
#[derive(Debug, Clone, Default)]
pub struct SubMesh {
    /// The whole's number of each node, rising.
    pub global_ids: Vec<u32>,
    pub nodes: Vec<[f64; 3]>,
    pub kinds: Vec<AtomKind>,
    /// What holds a node that was in a part that has been improved; empty if none was.
    pub constraints: Vec<Option<NodeConstraint>>,
    pub tets: Vec<[u32; 4]>,
    /// `NONE` where the part ends.
    pub neighbors: Vec<[u32; 4]>,
}

codec_fields! {
    SubMesh as SubMesh { global_ids, nodes, kinds, constraints, tets, neighbors }
}

impl SubMesh {
    /// Some of the tetrahedra of a mesh, in rising order, or of some of it; `known` tells of each node where it is, what it
    /// may do and what holds it.
    pub fn extract(
        tets: &[[u32; 4]],
        neighbors: &[[u32; 4]],
        chosen: &[u32],
        known: impl Fn(u32) -> ([f64; 3], AtomKind, Option<NodeConstraint>),
    ) -> Self {
        let first = chosen.first().map_or(0, |&t| t as usize);
        let mut place = vec![NONE; chosen.last().map_or(0, |&t| t as usize + 1) - first];
        for (i, &t) in chosen.iter().enumerate() {
            place[t as usize - first] = i as u32;
        }
        let here = |t: u32| {
            let place = (t as usize).checked_sub(first).and_then(|t| place.get(t));
            place.copied().unwrap_or(NONE)
        };
        let mut ids: Vec<u32> = Vec::new();
        // Each node once, in rising order, without sorting all corners.
        let most = chosen.iter().flat_map(|&t| tets[t as usize]).max();
        let mut number = vec![NONE; most.map_or(0, |most| most as usize + 1)];
        for &t in chosen {
            for n in tets[t as usize] {
                if std::mem::replace(&mut number[n as usize], 0) == NONE {
                    ids.push(n);
                }
            }
        }
        ids.sort_unstable();
        for (i, &n) in ids.iter().enumerate() {
            number[n as usize] = i as u32;
        }
        let mut part = Self {
            tets: (chosen.par_iter())
                .map(|&t| tets[t as usize].map(|n| number[n as usize]))
                .collect(),
            neighbors: (chosen.par_iter())
                .map(|&t| neighbors[t as usize].map(here))
                .collect(),
            ..Self::default()
        };
        part.nodes.reserve_exact(ids.len());
        part.kinds.reserve_exact(ids.len());
        part.constraints.reserve_exact(ids.len());
        for &n in &ids {
            let (x, kind, hold) = known(n);
            part.nodes.push(x);
            part.kinds.push(kind);
            part.constraints.push(hold);
        }
        part.global_ids = ids;
        if part.constraints.iter().all(Option::is_none) {
            part.constraints = Vec::new();
        }
        part
    }

    /// What holds a node, if that is known.
    pub fn constraint(&self, n: usize) -> Option<NodeConstraint> {
        self.constraints.get(n).copied().flatten()
    }

    /// Those of its tetrahedra that are wanted.
    pub fn filter_tets(&self, wanted: impl Fn(u32) -> bool + Sync) -> Self {
        let all = (0..self.tets.len() as u32).into_par_iter();
        let chosen: Vec<u32> = all.filter(|&t| wanted(t)).collect();
        let known = |n: u32| {
            let n = n as usize;
            (self.nodes[n], self.kinds[n], self.constraint(n))
        };
        let mut part = Self::extract(&self.tets, &self.neighbors, &chosen, known);
        for id in &mut part.global_ids {
            *id = self.global_ids[*id as usize];
        }
        part
    }

    /// Parts that have no tetrahedron in common, one after the other, joined where they meet.
    pub fn merge(parts: Vec<Self>) -> Self {
        if parts.len() == 1 {
            return parts.into_iter().next().unwrap_or_default();
        }
        // Each node once: what is known of its hold is known to whichever part improved it.
        let mut nodes: Vec<(u32, bool, u32, u32)> =
            Vec::with_capacity(parts.iter().map(|part| part.global_ids.len()).sum());
        for (i, part) in parts.iter().enumerate() {
            let all = part.global_ids.par_iter().enumerate();
            nodes.par_extend(
                all.map(|(n, &id)| (id, part.constraint(n).is_none(), i as u32, n as u32)),
            );
        }
        nodes.par_sort_unstable();
        let mut number: Vec<Vec<u32>> = parts
            .iter()
            .map(|part| vec![0; part.global_ids.len()])
            .collect();
        let mut all = Self::default();
        let held = parts.iter().any(|part| !part.constraints.is_empty());
        all.global_ids.reserve_exact(nodes.len());
        all.nodes.reserve_exact(nodes.len());
        all.kinds.reserve_exact(nodes.len());
        for &(id, _, i, n) in &nodes {
            let (part, place) = (&parts[i as usize], n as usize);
            if all.global_ids.last() != Some(&id) {
                all.global_ids.push(id);
                all.nodes.push(part.nodes[place]);
                all.kinds.push(part.kinds[place]);
                if held {
                    all.constraints.push(part.constraint(place));
                }
            }
            number[i as usize][place] = all.global_ids.len() as u32 - 1;
        }
        drop(nodes);
        let count = parts.iter().map(|part| part.tets.len()).sum();
        all.tets.reserve_exact(count);
        all.neighbors.reserve_exact(count);
        // What has been copied goes.
        for (part, number) in parts.into_iter().zip(number) {
            let first = all.tets.len() as u32;
            let tets = part.tets.par_iter();
            all.tets
                .par_extend(tets.map(|tet| tet.map(|n| number[n as usize])));
            let around = part.neighbors.par_iter();
            let moved = |n: u32| if n == NONE { NONE } else { first + n };
            all.neighbors
                .par_extend(around.map(|around| around.map(moved)));
        }
        all.join_faces();
        all
    }

    /// Tetrahedra with a face in common beyond which neither has another become neighbours.
    fn join_faces(&mut self) {
        let faces = |(t, (tet, around)): (usize, (&[u32; 4], &[u32; 4]))| {
            let (tet, around) = (*tet, *around);
            let ends = (0..4).filter(move |&k| around[k] == NONE);
            ends.map(move |k| {
                let mut face = FACES[k].map(|i| tet[i]);
                face.sort_unstable();
                (face, t as u32, k as u8)
            })
        };
        let all = self.tets.par_iter().zip(&self.neighbors).enumerate();
        let mut open: Vec<([u32; 3], u32, u8)> = all.flat_map_iter(faces).collect();
        open.par_sort_unstable();
        for two in open.windows(2) {
            let [(face, t, k), (other, u, l)] = [two[0], two[1]];
            if face == other {
                self.neighbors[t as usize][usize::from(k)] = u;
                self.neighbors[u as usize][usize::from(l)] = t;
            }
        }
    }

    /// The middle of a tetrahedron along an axis, four times as much.
    pub fn scaled_centroid(&self, t: u32, axis: usize) -> f64 {
        let corners = self.tets[t as usize].iter();
        corners.map(|&n| self.nodes[n as usize][axis]).sum()
    }
}
