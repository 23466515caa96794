//! Faces of a mesh, known to all who hold parts of it: surfaces are small beside the mesh.

use rayon::prelude::*;

use crate::files::kept::Kept;
use crate::mesh::Simplices;
use crate::mesh::part::{Holders, Part};
use crate::ranks::joined;

/// Faces of a mesh in parts, each once.
pub(super) struct Surface<const D: usize, T> {
    /// The mesh's numbers of their nodes, rising.
    pub numbers: Vec<u32>,
    /// What is known of each of these nodes.
    pub nodes: Vec<T>,
    /// The nodes of each face by their places among these: rising, as are the faces.
    pub faces: Vec<[u32; D]>,
    /// The sets that each face belongs to, as bits.
    pub sets: Vec<u8>,
}

impl<const D: usize, T: Kept> Surface<D, T> {
    /// The faces that the parts have, by their own numbers of nodes, rising, with what is known of nodes. A face that
    /// two have, or one has twice, belongs to the sets of both.
    ///
    /// # Errors
    /// Those of the other holders.
    pub fn told<M: Simplices<D>, H: Holders + ?Sized>(
        what: &str,
        part: &Part<'_, D, M, H>,
        mut faces: Vec<([u32; D], u8)>,
        of: impl Fn(u32) -> T,
    ) -> Result<Self, H::Error> {
        together(&mut faces);
        let mut nodes: Vec<u32> = faces.iter().flat_map(|(face, _)| *face).collect();
        nodes.par_sort_unstable();
        nodes.dedup();
        let nodes: Vec<(u32, T)> = (nodes.into_iter().map(|n| (part.number(n), of(n)))).collect();
        // Numbers in the whole rise with those in the part.
        for (face, _) in &mut faces {
            *face = face.map(|n| part.number(n));
        }
        let told = part.holders.told(what, (nodes, faces))?;
        let (nodes, faces): (Vec<_>, Vec<_>) = told.into_iter().unzip();
        let (mut nodes, mut faces) = (joined(nodes), joined(faces));
        nodes.sort_by_key(|(number, _)| *number);
        nodes.dedup_by_key(|(number, _)| *number);
        together(&mut faces);
        let (numbers, nodes): (Vec<u32>, Vec<T>) = nodes.into_iter().unzip();
        let (mut faces, sets): (Vec<[u32; D]>, Vec<u8>) = faces.into_iter().unzip();
        let place = |n: u32| numbers.partition_point(|&number| number < n) as u32;
        (faces.par_iter_mut()).for_each(|face| *face = face.map(place));
        Ok(Self {
            numbers,
            nodes,
            faces,
            sets,
        })
    }
}

/// Sorts faces, and makes one of those that are the same: it belongs to the sets of all of these.
pub(super) fn together<const D: usize>(faces: &mut Vec<([u32; D], u8)>) {
    faces.par_sort_unstable();
    faces.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 |= next.1;
        }
        same
    });
}
