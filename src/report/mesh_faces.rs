//! Faces of a distributed mesh. Each face is owned by one rank, and no rank has all of them.

use crate::parallel::prelude::*;

use crate::Result;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;

/// Some faces of a mesh.
pub(super) struct MeshFaces<'a, const D: usize> {
    /// Positions of the local nodes.
    pub nodes: &'a [[f64; D]],
    /// Nodes of each face, ascending.
    pub faces: Vec<[u32; D]>,
    /// Sets of each face, as bits.
    pub sets: Vec<u8>,
}

impl<'a, const D: usize> MeshFaces<'a, D> {
    /// Keeps each face, of those that the ranks pass in, on the lowest rank that has it. The nodes
    /// of the faces are ascending. A face that occurs several times gets the sets of all its
    /// copies. Collective; `description` names the exchange.
    ///
    /// # Errors
    /// Returns the communication errors of the view.
    pub fn owned_faces<M: Simplices<D>>(
        description: &str,
        view: &MeshView<'a, D, M>,
        mut faces: Vec<([u32; D], u8)>,
    ) -> Result<Self> {
        merge_equal_faces(&mut faces);
        let is_shared = view.shared_mask();
        let is_at_cut = |&f: &usize| faces[f].0.iter().all(|&n| is_shared[n as usize]);
        let at_cuts: Vec<usize> = (0..faces.len()).filter(is_at_cut).collect();
        // Global numbers are in the order of local numbers, so they are ascending, too.
        let entry = |&f: &usize| (faces[f].0.map(|n| view.global_id(n)), faces[f].1);
        let entries = at_cuts.iter().map(entry).collect();
        let merged = view.exchange_by_nodes(description, entries, |copies| {
            let mut answers = vec![0; copies.len()];
            answers[0] = copies.iter().fold(0, |sets, copy| sets | copy.value);
            answers
        })?;
        for (f, sets) in at_cuts.into_iter().zip(merged) {
            faces[f].1 = sets;
        }
        faces.retain(|(_, sets)| *sets != 0);
        let (faces, sets) = faces.into_iter().unzip();
        Ok(Self {
            nodes: view.mesh.nodes(),
            faces,
            sets,
        })
    }

    /// Returns the positions of the nodes of a face.
    #[inline]
    pub fn corners(&self, face: usize) -> [[f64; D]; D] {
        self.faces[face].map(|n| self.nodes[n as usize])
    }
}

/// Sorts faces and merges equal ones. A merged face gets the sets of all its copies.
pub(super) fn merge_equal_faces<const D: usize>(faces: &mut Vec<([u32; D], u8)>) {
    faces.par_sort_unstable();
    faces.dedup_by(|next, kept| {
        let is_equal = next.0 == kept.0;
        if is_equal {
            kept.1 |= next.1;
        }
        is_equal
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{Comm, run_threads};
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::complex::neighbours;
    use crate::mesh::mesh_partition::MeshPartition;

    #[test]
    fn each_face_has_one_owner() {
        let mesh = kuhn_box([5, 4, 6], 1.0);
        let around = neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
        // All faces of some cells, in two sets.
        let faces = |mesh: &crate::mesh::TetMesh, first: usize| {
            let mut faces = Vec::new();
            for c in (0..mesh.tets.len()).filter(|c| (first + c) % 3 < 2) {
                for k in 0..4 {
                    let mut face = mesh.face(c, k);
                    face.sort_unstable();
                    faces.push((face, 1 + ((first + c) % 3) as u8));
                }
            }
            faces
        };
        let view = MeshView::from_mesh(&mesh);
        let expected = MeshFaces::owned_faces("faces", &view, faces(&mesh, 0)).unwrap();
        let expected: Vec<_> = expected.faces.into_iter().zip(expected.sets).collect();
        assert!(expected.iter().any(|face| face.1 == 3));
        for count in [1, 2, 5] {
            let partitions = MeshPartition::split(&mesh, &around, count);
            let owned_faces = run_threads(count, |comm: &dyn Comm| {
                let partition = &partitions[comm.rank()];
                let view = MeshView::from_partition(partition, comm);
                let owned = MeshFaces::owned_faces(
                    "faces",
                    &view,
                    faces(&partition.mesh, partition.first_cell),
                )
                .unwrap();
                let global_id = |n: u32| partition.global_ids[n as usize];
                let faces = owned.faces.iter().map(|face| face.map(global_id));
                faces.zip(owned.sets).collect::<Vec<_>>()
            });
            let mut owned_faces = owned_faces.concat();
            owned_faces.sort_unstable();
            assert!(owned_faces == expected, "{count}");
        }
    }
}
