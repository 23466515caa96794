//! The named sets of a mesh, with the faces and nodes of the model.

use crate::files::vtk::DataArray;
use crate::geometry::{sorted, sorted_distinct};
use crate::mesh::poly::PolyMesh;
use crate::store::named_sets::{FaceSet, NamedSet, NamedSets};

/// Sets of cells, faces and nodes of a model.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ModelSets {
    /// Sets of cells.
    pub cells: Vec<NamedSet>,
    /// Sets of faces, by their index in the mesh.
    pub faces: Vec<NamedSet>,
    /// Sets of nodes.
    pub nodes: Vec<NamedSet>,
}

impl ModelSets {
    /// Finds the sets in a mesh. If it is a layer of prisms (from a 2-D mesh), a set of edges becomes
    /// the upright faces on them, and a node stands also for the node above it.
    pub fn new(sets: NamedSets, mesh: &PolyMesh<3>, is_layer: bool) -> Self {
        let NamedSets {
            cells,
            faces,
            mut nodes,
        } = sets;
        let base_count = if is_layer {
            mesh.nodes.len() as u32 / 2
        } else {
            mesh.nodes.len() as u32
        };
        if is_layer {
            for set in &mut nodes {
                let above = set.members.iter().map(|n| n + base_count);
                let above: Vec<u32> = above.collect();
                set.members.extend(above);
            }
        }
        Self {
            cells,
            faces: find_faces(&faces, mesh, base_count),
            nodes,
        }
    }

    /// Returns the sets of cells as arrays of 0 and 1.
    pub fn cell_arrays(&self, cells: usize) -> impl Iterator<Item = DataArray> {
        self.cells.iter().map(move |set| {
            let mut values = vec![0u8; cells];
            set.members.iter().for_each(|&c| values[c as usize] = 1);
            DataArray::scalars(set.name.clone(), values)
        })
    }
}

/// Returns the indices of the faces of sets. Of a face only the nodes below `base_count` count.
fn find_faces(sets: &[FaceSet], mesh: &PolyMesh<3>, base_count: u32) -> Vec<NamedSet> {
    if sets.is_empty() {
        return Vec::new();
    }
    let base_nodes = |f: usize| -> Vec<u32> {
        let ring = mesh.faces.get(f).iter().copied();
        sorted(ring.filter(|&n| n < base_count).collect())
    };
    let all_faces = (0..mesh.faces.len()).map(|f| (base_nodes(f), f as u32));
    let known: Vec<(Vec<u32>, u32)> = sorted(all_faces.collect());
    let find = |nodes: &[u32]| {
        let found = known.binary_search_by(|entry| entry.0.as_slice().cmp(nodes));
        found.ok().map(|i| known[i].1)
    };
    let set = |set: &FaceSet| NamedSet {
        name: set.name.clone(),
        members: sorted_distinct((0..set.faces.len()).filter_map(|i| find(set.faces.get(i)))),
    };
    let found = sets.iter().map(set);
    found.filter(|set| !set.members.is_empty()).collect()
}
