//! Faces that lack a tetrahedron on one side, by their nodes.

use std::collections::HashMap;

/// So many tetrahedra have so few faces that they are looked through.
const MAX_LIST_TETS: usize = 48;

/// A face's nodes in rising order.
type FaceKey = [u32; 3];

/// Faces, each with the tetrahedron on its other side and the face's number there.
#[derive(Debug, Clone, Default)]
pub(super) struct OpenFaces {
    list: Vec<(FaceKey, u32, u32)>,
    map: Option<HashMap<FaceKey, (u32, u32)>>,
}

impl OpenFaces {
    /// Forgets all, and gets ready for those of so many tetrahedra.
    pub fn clear(&mut self, tets: usize) {
        self.list.clear();
        self.map = (tets > MAX_LIST_TETS).then(HashMap::new);
    }

    pub fn insert(&mut self, name: FaceKey, tet: u32, number: u32) {
        match &mut self.map {
            Some(many) => {
                many.insert(name, (tet, number));
            }
            None => self.list.push((name, tet, number)),
        }
    }

    /// Takes a face out, if it is there.
    pub fn remove(&mut self, name: FaceKey) -> Option<(u32, u32)> {
        match &mut self.map {
            Some(many) => many.remove(&name),
            None => {
                let at = self.list.iter().position(|face| face.0 == name)?;
                let (_, tet, number) = self.list.swap_remove(at);
                Some((tet, number))
            }
        }
    }

    /// The tetrahedra on the other sides of those that are left.
    pub fn remaining_tets(&self) -> impl Iterator<Item = u32> + '_ {
        let many = self.map.iter().flat_map(|many| many.values().map(|f| f.0));
        self.list.iter().map(|face| face.1).chain(many)
    }
}
