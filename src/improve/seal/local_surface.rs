//! The marked faces of the local cells of a mesh that may be distributed. Compartments of
//! partitions are united across the cuts.

use super::surface::{MarkedSurface, RidgeFan, ridge_nodes};
use super::{SealReport, Sealer};
use crate::error::cause;
use crate::files::codec::Codec;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{sorted, sorted_distinct};
use crate::mesh::Simplices;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::view::MeshView;
use crate::{Error, Result};

/// The local cells, and their marked faces.
pub(super) struct LocalSurface<'a, const D: usize, M> {
    pub view: &'a MeshView<'a, D, M>,
    pub surface: MarkedSurface<'a, D, M>,
}

impl<const D: usize, M: Simplices<D>> LocalSurface<'_, D, M> {
    /// Returns `value` on the other side of each face at a cut: pairs of a face and the value
    /// beyond it.
    fn values_across(&self, exchange: &str, value: impl Fn(u32) -> u32) -> Result<Vec<(u32, u32)>> {
        let at_cuts = (0..).zip(self.surface.neighbours);
        let at_cuts = at_cuts.filter(|(_, beyond)| **beyond == NOT_LOCAL);
        let faces: Vec<u32> = at_cuts.map(|(face, _)| face).collect();
        let entry = |&face: &u32| (sorted(self.global_face_nodes(face)), value(face));
        let entries = faces.iter().map(entry).collect();
        let beyond = (self.view).exchange_by_nodes(exchange, entries, |sides| match sides {
            [one, other] => vec![Some(other.value), Some(one.value)],
            _ => vec![None; sides.len()],
        })?;
        (faces.into_iter().zip(beyond))
            .map(|(face, value)| Ok((face, value.ok_or_else(|| self.unmatched_face_error(face))?)))
            .collect()
    }

    /// Returns the global indices of the nodes of a face.
    fn global_face_nodes(&self, face: u32) -> [u32; D] {
        (self.surface.face_nodes(face)).map(|n| self.view.global_id(n))
    }

    /// Returns the error for a face at a cut that does not belong to exactly two partitions.
    fn unmatched_face_error(&self, face: u32) -> Error {
        Error::Mesh(cause(
            format!("face {:?}", self.global_face_nodes(face)),
            "does not belong to exactly two partitions of the mesh",
            "mesh the image again",
        ))
    }

    /// Marks the other side of every marked face, also across cuts.
    pub fn mark_both_sides(&mut self) -> Result<()> {
        self.surface.mark_both_sides();
        let marked = self.values_across("marked faces", |face| {
            u32::from(self.surface.is_marked(face))
        })?;
        for (face, _) in marked.into_iter().filter(|(_, marked)| *marked == 1) {
            self.surface.set_mark(face, true);
        }
        Ok(())
    }

    /// Returns the global indices of the nodes of all rims in the mesh, in rising order. Some nodes
    /// on the outside of the mesh may be among them.
    pub fn rim_nodes(&self) -> Result<Vec<u32>> {
        // Each ridge of a marked face, with the node of the face that is opposite to it. Both
        // together identify a face on all ranks.
        let mut ridge_faces = Vec::new();
        for face in self.surface.unique_marked_faces() {
            let ridges = self.surface.ridges(face).zip(self.surface.face_nodes(face));
            ridge_faces.extend(ridges.map(|(ridge, node)| (ridge, node, face)));
        }
        ridge_faces.sort_unstable();
        let is_shared = self.view.shared_mask();
        let at_cut = ridge_faces
            .iter()
            .filter(|(ridge, ..)| ridge_nodes(*ridge).all(|n| is_shared[n as usize]));
        let to_global = |n: u32| {
            if n == NONE {
                NONE
            } else {
                self.view.global_id(n)
            }
        };
        let at_cut: Vec<[u32; 3]> = at_cut
            .map(|&([a, b], node, _)| [a, b, node].map(to_global))
            .collect();
        let at_cuts = self.all_gather_sorted("ridges at cuts", at_cut)?;
        let mut rims = Vec::new();
        for faces in ridge_faces.chunk_by(|a, b| a.0 == b.0) {
            let &[(ridge, _, face)] = faces else { continue };
            let nodes = ridge.map(to_global);
            let first = at_cuts.partition_point(|ridge| ridge[..2] < nodes[..]);
            let matches = at_cuts[first..].iter().take(2);
            let is_rim = matches.filter(|ridge| ridge[..2] == nodes[..]).count() < 2;
            if is_rim
                && self
                    .surface
                    .visit_ridge_cells(face / (D as u32 + 1), ridge, |_| ())
                    != RidgeFan::AtBoundary
            {
                rims.extend(ridge_nodes(nodes));
            }
        }
        self.all_gather_sorted("rims", rims)
    }

    /// Gathers the values of all ranks, in rising order and without duplicates.
    fn all_gather_sorted<T: Ord + Codec>(&self, exchange: &str, local: Vec<T>) -> Result<Vec<T>> {
        Ok(sorted_distinct(self.view.concatenate(exchange, local)?))
    }

    /// Returns `true` if this partition has a cell, given by its global index.
    pub fn has_cell(&self, cell: usize) -> bool {
        let first = self.view.first_cell;
        (first..first + self.view.mesh.len()).contains(&cell)
    }

    /// Returns the local index of face `k` of a cell, given by its global index, if this partition
    /// has the cell.
    fn local_face(&self, cell: usize, k: u32) -> Option<u32> {
        let n = D as u32 + 1;
        (self.has_cell(cell)).then(|| n * (cell - self.view.first_cell) as u32 + k)
    }

    /// Marks the new faces, which all ranks have found, and opens the pockets that they create.
    /// `global_cell` returns the global index of a cell of `sealer`.
    pub fn close_holes(
        &mut self,
        sealer: &Sealer<'_, D, M>,
        global_cell: impl Fn(u32) -> usize,
    ) -> Result<SealReport> {
        let n = D as u32 + 1;
        // Sides of the new faces that belong to this partition.
        let mut sides = Vec::new();
        for (i, &face) in (0..).zip(&sealer.new_faces) {
            let twin = sealer.surface.twin(face).unwrap_or(face);
            for (side, face) in (2 * i..).zip([face, twin]) {
                if let Some(face) = self.local_face(global_cell(face / n), face % n) {
                    self.surface.set_mark(face, true);
                    sides.push((side, face));
                }
            }
        }
        let (local_compartments, local_volumes) = self.surface.compartments();
        // Compartments of partitions are numbered in the order of their first cells in the whole
        // mesh, and so are the united ones.
        let first_compartment = (self.view).first_number("compartments", local_volumes.len())?;
        let volumes = self.view.concatenate("compartments", local_volumes)?;
        let compartment_at =
            |face: u32| first_compartment as u32 + local_compartments[(face / n) as usize];
        let across = self.values_across("compartments at cuts", compartment_at)?;
        let open = across
            .iter()
            .filter(|(face, _)| !self.surface.is_marked(*face));
        let pairs = sorted_distinct(open.map(|&(face, other)| [compartment_at(face), other]));
        let mut union = UnionFind::new(volumes.len());
        for [r, s] in self.all_gather_sorted("united compartments", pairs)? {
            union.unite(r, s);
        }
        let (labels, count) = union.into_labels();
        let mut merged_volumes = vec![0.0; count];
        for (part_volume, &compartment) in volumes.iter().zip(&labels) {
            merged_volumes[compartment as usize] += part_volume;
        }
        let merged_compartment_at = |face: u32| labels[compartment_at(face) as usize];
        let sides: Vec<(u32, u32)> = (sides.into_iter())
            .map(|(side, face)| (side, merged_compartment_at(face)))
            .collect();
        let mut adjacent = vec![[NONE; 2]; sealer.new_faces.len()];
        for (side, compartment) in self.all_gather_sorted("compartments beside faces", sides)? {
            adjacent.as_flattened_mut()[side as usize] = compartment;
        }
        let opened = sealer.find_pockets(&merged_volumes, &adjacent);
        self.surface
            .unmark_between(&opened, |c| merged_compartment_at(n * c));
        for (face, other) in across {
            if opened.contains([merged_compartment_at(face), labels[other as usize]]) {
                self.surface.set_mark(face, false);
            }
        }
        Ok(sealer.report(&opened, &adjacent, count))
    }
}
