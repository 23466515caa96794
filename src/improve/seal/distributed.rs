//! Closes holes in a mesh that is partitioned among ranks.
//!
//! All holes lie at the rims of surfaces. Each rank gathers the cells near all rims and performs
//! the same operations on them. The rank that owns a cell computes the feature planes near it and
//! sends them to all. Compartments of the partitions are united across the cuts.

use super::gathered_cells::GatheredCells;
use super::surface::{MarkedSurface, RidgeFan};
use super::{SealReport, Sealer, local_planes};
use crate::comm::{Comm, concatenate};
use crate::error::cause;
use crate::feature::FeaturePoint;
use crate::files::codec::Codec;
use crate::geometry::sorted_distinct;
use crate::geometry::union_find::UnionFind;
use crate::lattice::distance::DistributedDistance;
use crate::mesh::TetMesh;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::progress::CancelToken;
use crate::{Error, Result};

/// Largest number of rings of cells that are gathered in addition when surfaces grow beyond the
/// gathered cells.
const MAX_RINGS: usize = 4;

/// Closes holes as [`seal`](super::seal) does, in a mesh that is partitioned among the ranks in
/// their order.
///
/// `marks` are those of the tetrahedra of this partition, and `points` must contain at least the
/// feature points near it. The marked faces and the report are the same as for the whole mesh.
///
/// # Errors
/// Returns [`Error::Mesh`] if the partitions do not fit each other, and an error if another rank
/// fails.
pub fn seal_distributed(
    partition: &MeshPartition,
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &DistributedDistance<3>,
    marks: &mut [u8],
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<SealReport> {
    let planes = local_planes(points, extent, &distance.outline());
    let surface = MarkedSurface {
        mesh: &partition.mesh,
        neighbors: partition.neighbors.as_flattened(),
        marks,
    };
    let mut local = LocalSurface {
        partition,
        surface,
        comm,
    };
    local.mark_both_sides()?;
    let mut gathered = GatheredCells::default();
    let mut pending_nodes = local.rim_nodes()?;
    let mut rings = 1;
    let mut known_planes = Vec::new();
    loop {
        for _ in 0..rings {
            pending_nodes =
                gathered.gather(&pending_nodes, partition, local.surface.marks, comm)?;
        }
        let (mesh, neighbors) = gathered.local_mesh()?;
        let mut marks = gathered.local_marks();
        let surface = MarkedSurface {
            mesh: &mesh,
            neighbors: neighbors.as_flattened(),
            marks: &mut marks,
        };
        // The distance is fetched for all gathered cells, whichever rank owns them.
        let distance = distance.fetch_near(&mesh.nodes, 0.0, comm)?;
        let mut sealer = Sealer::new(surface, &planes, &distance);
        let to_local = |(global_id, planes)| (gathered.local_cell(global_id), planes);
        sealer.cell_planes = known_planes.into_iter().map(to_local).collect();
        let is_cancelled = || {
            let flags = comm.all_gather("cancellation", cancel.is_cancelled())?;
            Ok::<_, Error>(flags.contains(&true))
        };
        sealer.grow(is_cancelled, |sealer, cells| {
            let owned_cells = cells
                .into_iter()
                .filter(|&c| local.has_cell(gathered.global_cell(c)));
            let owned_cells: Vec<u32> = owned_cells.collect();
            Ok(concatenate(comm.all_gather(
                "planes near cells",
                sealer.planes_near_cells(&owned_cells),
            )?))
        })?;
        if sealer.incomplete_nodes.is_empty() {
            sealer.remove_overhangs();
            return local.close_holes(&sealer, &gathered);
        }
        // Repeat with the missing cells. The planes that are known need not be computed again.
        let incomplete = sealer.incomplete_nodes.iter();
        pending_nodes = sorted_distinct(incomplete.map(|&n| gathered.global_node(n)));
        let cell_planes = sealer.cell_planes.into_iter();
        known_planes = cell_planes
            .map(|(c, planes)| (gathered.global_cell(c), planes))
            .collect();
        rings = MAX_RINGS.min(2 * rings);
    }
}

/// The partition of this rank, its marked faces, and the communicator to the other ranks.
struct LocalSurface<'a> {
    partition: &'a MeshPartition,
    surface: MarkedSurface<'a, 3, TetMesh>,
    comm: &'a dyn Comm,
}

impl LocalSurface<'_> {
    /// Returns `value` on the other side of each face at a cut: pairs of a face and the value
    /// beyond it.
    fn values_across(&self, exchange: &str, value: impl Fn(u32) -> u32) -> Result<Vec<(u32, u32)>> {
        // One rank receives a face from both sides: the smallest node of the face determines which
        // rank.
        let count = self.comm.size();
        let mut faces = vec![Vec::new(); count];
        let mut sent = vec![Vec::new(); count];
        for (face, &beyond) in (0..).zip(self.surface.neighbors) {
            if beyond == NOT_LOCAL {
                let mut key = self.surface.face_nodes(face).map(|n| self.global_node(n));
                key.sort_unstable();
                let rank = key[0] as usize % count;
                faces[rank].push(face);
                sent[rank].push((key, value(face)));
            }
        }
        let received = self.comm.all_to_all(exchange, sent)?;
        let mut entries = Vec::new();
        for (sender, values) in received.iter().enumerate() {
            let values = values.iter().enumerate();
            entries.extend(values.map(|(position, &(key, value))| (key, sender, position, value)));
        }
        entries.sort_unstable();
        let mut answers: Vec<Vec<Option<u32>>> = received
            .iter()
            .map(|values| vec![None; values.len()])
            .collect();
        for pair in entries.chunk_by(|a, b| a.0 == b.0) {
            if let &[
                (_, sender, position, value),
                (_, other_sender, other_position, other_value),
            ] = pair
            {
                answers[sender][position] = Some(other_value);
                answers[other_sender][other_position] = Some(value);
            }
        }
        let answers = self.comm.all_to_all(exchange, answers)?;
        let mut across = Vec::new();
        for (faces, answers) in faces.into_iter().zip(answers) {
            for (face, value) in faces.into_iter().zip(answers) {
                across.push((face, value.ok_or_else(|| self.unmatched_face_error(face))?));
            }
        }
        Ok(across)
    }

    /// Returns the error for a face at a cut that does not belong to exactly two partitions.
    fn unmatched_face_error(&self, face: u32) -> Error {
        let nodes = self.surface.face_nodes(face).map(|n| self.global_node(n));
        Error::Mesh(cause(
            format!("face {nodes:?}"),
            "does not belong to exactly two partitions of the mesh",
            "mesh the image again",
        ))
    }

    /// Returns the global index of a node.
    fn global_node(&self, n: u32) -> u32 {
        self.partition.global_ids[n as usize]
    }

    /// Marks the other side of every marked face, also across cuts.
    fn mark_both_sides(&mut self) -> Result<()> {
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
    fn rim_nodes(&self) -> Result<Vec<u32>> {
        // Each ridge of a marked face, with the node of the face that is opposite to it. Both
        // together identify a face on all ranks.
        let mut ridge_faces = Vec::new();
        for face in self.surface.unique_marked_faces() {
            let ridges = self.surface.ridges(face).zip(self.surface.face_nodes(face));
            ridge_faces.extend(ridges.map(|(ridge, node)| (ridge, node, face)));
        }
        ridge_faces.sort_unstable();
        let mut shared = vec![false; self.partition.global_ids.len()];
        for n in self.partition.shared_nodes() {
            shared[n as usize] = true;
        }
        let at_cut = ridge_faces
            .iter()
            .filter(|(ridge, ..)| ridge.iter().all(|&n| shared[n as usize]));
        let at_cut: Vec<[u32; 3]> = at_cut
            .map(|&([a, b], node, _)| [a, b, node].map(|n| self.global_node(n)))
            .collect();
        let at_cuts = self.all_gather_sorted("ridges at cuts", at_cut)?;
        let mut rims = Vec::new();
        for faces in ridge_faces.chunk_by(|a, b| a.0 == b.0) {
            let &[(ridge, _, face)] = faces else { continue };
            let nodes = ridge.map(|n| self.global_node(n));
            let first = at_cuts.partition_point(|ridge| ridge[..2] < nodes[..]);
            let matches = at_cuts[first..].iter().take(2);
            let is_rim = matches.filter(|ridge| ridge[..2] == nodes[..]).count() < 2;
            if is_rim
                && self.surface.visit_ridge_cells(face / 4, ridge, |_| ()) != RidgeFan::AtBoundary
            {
                rims.extend(nodes);
            }
        }
        self.all_gather_sorted("rims", rims)
    }

    /// Gathers the values of all ranks, in rising order and without duplicates.
    fn all_gather_sorted<T: Ord + Codec>(&self, exchange: &str, local: Vec<T>) -> Result<Vec<T>> {
        let all = self.comm.all_gather(exchange, local)?.into_iter();
        let all = sorted_distinct(all.flatten());
        Ok(all)
    }

    /// Returns `true` if this partition has a cell, given by its global index.
    fn has_cell(&self, cell: usize) -> bool {
        let first = self.partition.first_cell;
        (first..first + self.partition.mesh.tets.len()).contains(&cell)
    }

    /// Returns the local index of face `k` of a cell, given by its global index, if this partition
    /// has the cell.
    fn local_face(&self, cell: usize, k: u32) -> Option<u32> {
        (self.has_cell(cell)).then(|| 4 * (cell - self.partition.first_cell) as u32 + k)
    }

    /// Marks the new faces, which all ranks have found, and opens the pockets that they create.
    fn close_holes(
        &mut self,
        sealer: &Sealer<'_, 3, TetMesh>,
        gathered: &GatheredCells,
    ) -> Result<SealReport> {
        // Sides of the new faces that belong to this partition.
        let mut sides = Vec::new();
        for (i, &face) in (0..).zip(&sealer.new_faces) {
            let twin = sealer.surface.twin(face).unwrap_or(face);
            for (side, face) in (2 * i..).zip([face, twin]) {
                if let Some(face) = self.local_face(gathered.global_cell(face / 4), face % 4) {
                    self.surface.set_mark(face, true);
                    sides.push((side, face));
                }
            }
        }
        let (local_compartments, local_volumes) = self.surface.compartments();
        let volumes = self.comm.all_gather("compartments", local_volumes)?;
        let first_compartment: usize = volumes[..self.comm.rank()].iter().map(Vec::len).sum();
        // Compartments of partitions are numbered in the order of their first cells in the whole
        // mesh, and so are the united ones.
        let volumes = volumes.concat();
        let compartment_at =
            |face: u32| first_compartment as u32 + local_compartments[(face / 4) as usize];
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
            .unmark_between(&opened, |c| merged_compartment_at(4 * c));
        for (face, other) in across {
            if opened.contains([merged_compartment_at(face), labels[other as usize]]) {
                self.surface.set_mark(face, false);
            }
        }
        Ok(sealer.report(&opened, &adjacent, count))
    }
}
