//! Faces that lack a tetrahedron on one side, by their nodes.

use std::collections::HashMap;

/// So many tetrahedra have so few faces that they are looked through.
const FEW: usize = 48;

/// A face's nodes in rising order.
type Name = [u32; 3];

/// Faces, each with the tetrahedron on its other side and the face's number there.
#[derive(Debug, Clone, Default)]
pub(super) struct Faces {
    few: Vec<(Name, u32, u32)>,
    many: Option<HashMap<Name, (u32, u32)>>,
}

impl Faces {
    /// Forgets all, and gets ready for those of so many tetrahedra.
    pub fn clear(&mut self, tets: usize) {
        self.few.clear();
        self.many = (tets > FEW).then(HashMap::new);
    }

    pub fn put(&mut self, name: Name, tet: u32, number: u32) {
        match &mut self.many {
            Some(many) => {
                many.insert(name, (tet, number));
            }
            None => self.few.push((name, tet, number)),
        }
    }

    /// Takes a face out, if it is there.
    pub fn take(&mut self, name: Name) -> Option<(u32, u32)> {
        match &mut self.many {
            Some(many) => many.remove(&name),
            None => {
                let at = self.few.iter().position(|face| face.0 == name)?;
                let (_, tet, number) = self.few.swap_remove(at);
                Some((tet, number))
            }
        }
    }

    /// The tetrahedra on the other sides of those that are left.
    pub fn left(&self) -> impl Iterator<Item = u32> + '_ {
        let many = self.many.iter().flat_map(|many| many.values().map(|f| f.0));
        self.few.iter().map(|face| face.1).chain(many)
    }
}
