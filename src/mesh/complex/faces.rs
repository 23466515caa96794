//! Open faces: faces that still lack a tetrahedron on one side, stored by their nodes.

use std::collections::HashMap;

/// Largest number of tetrahedra for which a list of open faces is searched linearly. A hash map is
/// faster for more.
const MAX_LIST_TETS: usize = 48;

/// The nodes of a face in ascending order.
type FaceKey = [u32; 3];

/// Open faces, each with the tetrahedron on its other side and the number of the face in that
/// tetrahedron.
#[derive(Debug, Clone, Default)]
pub(super) struct OpenFaces {
    list: Vec<(FaceKey, u32, u32)>,
    map: Option<HashMap<FaceKey, (u32, u32)>>,
}

impl OpenFaces {
    /// Removes all faces, and prepares for the faces of `tets` tetrahedra.
    pub fn clear(&mut self, tets: usize) {
        self.list.clear();
        self.map = (tets > MAX_LIST_TETS).then(HashMap::new);
    }

    pub fn insert(&mut self, key: FaceKey, tet: u32, number: u32) {
        match &mut self.map {
            Some(map) => {
                map.insert(key, (tet, number));
            }
            None => self.list.push((key, tet, number)),
        }
    }

    /// Removes a face and returns its tetrahedron and number, if it is present.
    pub fn remove(&mut self, key: FaceKey) -> Option<(u32, u32)> {
        match &mut self.map {
            Some(map) => map.remove(&key),
            None => {
                let index = self.list.iter().position(|face| face.0 == key)?;
                let (_, tet, number) = self.list.swap_remove(index);
                Some((tet, number))
            }
        }
    }

    /// Returns the tetrahedra on the other sides of the faces that remain.
    pub fn remaining_tets(&self) -> impl Iterator<Item = u32> + '_ {
        let in_map = self.map.iter().flat_map(|many| many.values().map(|f| f.0));
        self.list.iter().map(|face| face.1).chain(in_map)
    }
}
