//! Faces of a mesh in parts, each of which is one holder's: nobody knows them all.

use crate::parallel::prelude::*;

use crate::comm::LocalOrComm;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;

/// Some faces of a mesh.
pub(super) struct MeshFaces<'a, const D: usize> {
    /// Where the mesh's nodes are.
    pub nodes: &'a [[f64; D]],
    /// The nodes of each face, rising.
    pub faces: Vec<[u32; D]>,
    /// The sets that each belongs to, as bits.
    pub sets: Vec<u8>,
}

impl<'a, const D: usize> MeshFaces<'a, D> {
    /// Of the faces that the parts of a mesh have, with nodes rising, those that this part is the first to have. What
    /// several have, or one has twice, belongs to the sets of all.
    ///
    /// # Errors
    /// Those of the other holders.
    pub fn owned_faces<M: Simplices<D>, H: LocalOrComm + ?Sized>(
        what: &str,
        part: &MeshView<'a, D, M, H>,
        mut faces: Vec<([u32; D], u8)>,
    ) -> Result<Self, H::Error> {
        merge_equal_faces(&mut faces);
        let (holders, is_shared) = (part.comm, part.shared_mask());
        // Whoever answers for its first node hears of a face from all that may have it.
        let mut places = vec![Vec::new(); holders.size()];
        let mut to = vec![Vec::new(); holders.size()];
        for (place, (face, sets)) in faces.iter().enumerate() {
            if face.iter().all(|&n| is_shared[n as usize]) {
                // Numbers in the whole rise with those in the part.
                let numbers = face.map(|n| part.global_id(n));
                let owner = holders.owner_rank(numbers[0], part.global_counts[0]);
                places[owner].push(place);
                to[owner].push((numbers, *sets));
            }
        }
        let told = holders.try_all_to_all(what, to)?;
        let mut answers: Vec<Vec<u8>> = told.iter().map(|told| vec![0; told.len()]).collect();
        let mut all = Vec::new();
        for (from, told) in told.iter().enumerate() {
            all.extend(
                told.iter()
                    .enumerate()
                    .map(|(at, of)| (of.0, from, at, of.1)),
            );
        }
        all.sort_unstable();
        for same in all.chunk_by(|a, b| a.0 == b.0) {
            let (_, from, at, _) = same[0];
            answers[from][at] = same.iter().fold(0, |sets, of| sets | of.3);
        }
        for (places, answers) in places.iter().zip(holders.try_all_to_all(what, answers)?) {
            for (&place, sets) in places.iter().zip(answers) {
                faces[place].1 = sets;
            }
        }
        faces.retain(|(_, sets)| *sets != 0);
        let (faces, sets) = faces.into_iter().unzip();
        Ok(Self {
            nodes: part.mesh.nodes(),
            faces,
            sets,
        })
    }

    /// Where the nodes of a face are.
    #[inline]
    pub fn corners(&self, face: usize) -> [[f64; D]; D] {
        self.faces[face].map(|n| self.nodes[n as usize])
    }
}

/// Sorts faces, and makes one of those that are the same: it belongs to the sets of all of these.
pub(super) fn merge_equal_faces<const D: usize>(faces: &mut Vec<([u32; D], u8)>) {
    faces.par_sort_unstable();
    faces.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 |= next.1;
        }
        same
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{Comm, run_threads};
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::complex::neighbors;
    use crate::mesh::partition::MeshPartition;

    #[test]
    fn each_face_is_one_holders() {
        let mesh = kuhn_box([5, 4, 6], 1.0);
        let around = neighbors(mesh.nodes.len(), &mesh.tets).unwrap();
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
        let part = MeshView::from_mesh(&mesh);
        let Ok(all) = MeshFaces::owned_faces("faces", &part, faces(&mesh, 0));
        let all: Vec<_> = all.faces.into_iter().zip(all.sets).collect();
        assert!(all.iter().any(|face| face.1 == 3));
        for count in [1, 2, 5] {
            let pieces = MeshPartition::split(&mesh, &around, count);
            let found = run_threads(count, |group: &dyn Comm| {
                let piece = &pieces[group.rank()];
                let part = MeshView::from_partition(piece, group);
                let own =
                    MeshFaces::owned_faces("faces", &part, faces(&piece.mesh, piece.first_cell))
                        .unwrap();
                let number = |n: u32| piece.global_ids[n as usize];
                let faces = own.faces.iter().map(|face| face.map(number));
                faces.zip(own.sets).collect::<Vec<_>>()
            });
            let mut found = found.concat();
            found.sort_unstable();
            assert!(found == all, "{count}");
        }
    }
}
