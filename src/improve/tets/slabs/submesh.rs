//! Extracts parts of a mesh as meshes of their own, and merges parts.

use crate::geometry::sorted;
use crate::parallel::prelude::*;

use super::super::NodeConstraint;
use crate::files::codec::codec_fields;
use crate::lattice::AtomKind;
use crate::mesh::FACES;
use crate::mesh::complex::NONE;

/// Some tetrahedra of a mesh, with the data of their nodes. Nodes have local indices here, in the
/// order of their global ones.
#[derive(Debug, Clone, Default)]
pub struct SubMesh {
    /// Global index of each node, rising.
    pub global_ids: Vec<u32>,
    pub nodes: Vec<[f64; 3]>,
    pub kinds: Vec<AtomKind>,
    /// Constraints of each node that belongs to a part that has been improved; empty if there is
    /// none.
    pub constraints: Vec<Option<NodeConstraint>>,
    pub tets: Vec<[u32; 4]>,
    /// Adjacent tetrahedra; `NONE` where the part ends.
    pub neighbours: Vec<[u32; 4]>,
}

codec_fields! {
    SubMesh as SubMesh { global_ids, nodes, kinds, constraints, tets, neighbours }
}

impl SubMesh {
    /// Extracts the tetrahedra with the rising indices `chosen` from a mesh or from a part of one.
    /// `node_data` returns the position, kind and constraints of a node.
    pub fn extract(
        tets: &[[u32; 4]],
        neighbours: &[[u32; 4]],
        chosen: &[u32],
        node_data: impl Fn(u32) -> ([f64; 3], AtomKind, Option<NodeConstraint>),
    ) -> Self {
        let first = chosen.first().map_or(0, |&t| t as usize);
        let mut local_tet = vec![NONE; chosen.last().map_or(0, |&t| t as usize + 1) - first];
        for (i, &t) in chosen.iter().enumerate() {
            local_tet[t as usize - first] = i as u32;
        }
        let to_local = |t: u32| {
            let local = (t as usize)
                .checked_sub(first)
                .and_then(|t| local_tet.get(t));
            local.copied().unwrap_or(NONE)
        };
        let mut ids: Vec<u32> = Vec::new();
        // Each node once, in rising order, without sorting all corners.
        let max_node = chosen.iter().flat_map(|&t| tets[t as usize]).max();
        let mut local_id = vec![NONE; max_node.map_or(0, |node| node as usize + 1)];
        for &t in chosen {
            for n in tets[t as usize] {
                if std::mem::replace(&mut local_id[n as usize], 0) == NONE {
                    ids.push(n);
                }
            }
        }
        ids.sort_unstable();
        for (i, &n) in ids.iter().enumerate() {
            local_id[n as usize] = i as u32;
        }
        let mut part = Self {
            tets: (chosen.par_iter())
                .map(|&t| tets[t as usize].map(|n| local_id[n as usize]))
                .collect(),
            neighbours: (chosen.par_iter())
                .map(|&t| neighbours[t as usize].map(to_local))
                .collect(),
            ..Self::default()
        };
        part.nodes.reserve_exact(ids.len());
        part.kinds.reserve_exact(ids.len());
        part.constraints.reserve_exact(ids.len());
        for &n in &ids {
            let (x, kind, constraint) = node_data(n);
            part.nodes.push(x);
            part.kinds.push(kind);
            part.constraints.push(constraint);
        }
        part.global_ids = ids;
        if part.constraints.iter().all(Option::is_none) {
            part.constraints = Vec::new();
        }
        part
    }

    /// Returns the constraints of a node, if they are known.
    pub fn constraint(&self, n: usize) -> Option<NodeConstraint> {
        self.constraints.get(n).copied().flatten()
    }

    /// Returns the part with the tetrahedra for which `keeps` is true.
    pub fn filter_tets(&self, keeps: impl Fn(u32) -> bool + Sync) -> Self {
        let all = (0..self.tets.len() as u32).into_par_iter();
        let chosen: Vec<u32> = all.filter(|&t| keeps(t)).collect();
        let node_data = |n: u32| {
            let n = n as usize;
            (self.nodes[n], self.kinds[n], self.constraint(n))
        };
        let mut part = Self::extract(&self.tets, &self.neighbours, &chosen, node_data);
        for id in &mut part.global_ids {
            *id = self.global_ids[*id as usize];
        }
        part
    }

    /// Merges parts that share no tetrahedron, in order, and joins them where they meet.
    pub fn merge(parts: Vec<Self>) -> Self {
        if parts.len() == 1 {
            return parts.into_iter().next().unwrap_or_default();
        }
        // Each node is taken once, from a part that knows its constraints if there is one.
        let mut nodes: Vec<(u32, bool, u32, u32)> =
            Vec::with_capacity(parts.iter().map(|part| part.global_ids.len()).sum());
        for (i, part) in parts.iter().enumerate() {
            let ids = part.global_ids.par_iter().enumerate();
            nodes.par_extend(
                ids.map(|(n, &id)| (id, part.constraint(n).is_none(), i as u32, n as u32)),
            );
        }
        nodes.par_sort_unstable();
        let mut merged_ids: Vec<Vec<u32>> = parts
            .iter()
            .map(|part| vec![0; part.global_ids.len()])
            .collect();
        let mut merged = Self::default();
        let has_constraints = parts.iter().any(|part| !part.constraints.is_empty());
        merged.global_ids.reserve_exact(nodes.len());
        merged.nodes.reserve_exact(nodes.len());
        merged.kinds.reserve_exact(nodes.len());
        for &(id, _, i, n) in &nodes {
            let (part, local) = (&parts[i as usize], n as usize);
            if merged.global_ids.last() != Some(&id) {
                merged.global_ids.push(id);
                merged.nodes.push(part.nodes[local]);
                merged.kinds.push(part.kinds[local]);
                if has_constraints {
                    merged.constraints.push(part.constraint(local));
                }
            }
            merged_ids[i as usize][local] = merged.global_ids.len() as u32 - 1;
        }
        drop(nodes);
        let count = parts.iter().map(|part| part.tets.len()).sum();
        merged.tets.reserve_exact(count);
        merged.neighbours.reserve_exact(count);
        // Each part is freed as soon as it has been copied.
        for (part, ids) in parts.into_iter().zip(merged_ids) {
            let first = merged.tets.len() as u32;
            let tets = part.tets.par_iter();
            merged
                .tets
                .par_extend(tets.map(|tet| tet.map(|n| ids[n as usize])));
            let around = part.neighbours.par_iter();
            let shift = |n: u32| if n == NONE { NONE } else { first + n };
            merged
                .neighbours
                .par_extend(around.map(|around| around.map(shift)));
        }
        merged.join_faces();
        merged
    }

    /// Makes tetrahedra neighbours that share a face without having a neighbour there.
    fn join_faces(&mut self) {
        let open_faces = |(t, (tet, around)): (usize, (&[u32; 4], &[u32; 4]))| {
            let (tet, around) = (*tet, *around);
            let ends = (0..4).filter(move |&k| around[k] == NONE);
            ends.map(move |k| {
                let face = sorted(FACES[k].map(|i| tet[i]));
                (face, t as u32, k as u8)
            })
        };
        let cells = self.tets.par_iter().zip(&self.neighbours).enumerate();
        let mut open: Vec<([u32; 3], u32, u8)> = cells.flat_map_iter(open_faces).collect();
        open.par_sort_unstable();
        for pair in open.windows(2) {
            let [(face, t, k), (other, u, l)] = [pair[0], pair[1]];
            if face == other {
                self.neighbours[t as usize][usize::from(k)] = u;
                self.neighbours[u as usize][usize::from(l)] = t;
            }
        }
    }

    /// Returns the centroid of a tetrahedron along an axis, multiplied by four.
    pub fn scaled_centroid(&self, t: u32, axis: usize) -> f64 {
        let corners = self.tets[t as usize].iter();
        corners.map(|&n| self.nodes[n as usize][axis]).sum()
    }
}
