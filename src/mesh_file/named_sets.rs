//! Sets of cells, faces and nodes that have names, as our files store them: those of other programs'
//! files, and the boundaries at which cells were left out.
//!
//! Regions divide a mesh, and named surfaces ([`NamedSurfaces`](super::named_surfaces::NamedSurfaces))
//! lie inside it. Sets may overlap, and sets of faces may lie on the boundary. A set of cells or of
//! nodes is an array of 0 and 1, `cell_set:NAME` or `node_set:NAME`. Sets of faces are two fields,
//! because a file has no array of faces.

use super::{FieldValue, MeshFile};
use crate::files::vtk::DataArray;
use crate::mesh::poly::Lists;
use crate::mesh_file::array_names::{
    CELL_SET_PREFIX, FACE_SET_NAMES_FIELD, FACE_SETS_FIELD, NODE_SET_PREFIX,
};

/// Cells or nodes with a name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NamedSet {
    /// The name.
    pub name: String,
    /// The cells or nodes, ascending.
    pub members: Vec<u32>,
}

/// Faces with a name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FaceSet {
    /// The name.
    pub name: String,
    /// The nodes of each face, ascending.
    pub faces: Lists,
}

/// The sets of a mesh.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NamedSets {
    /// Sets of cells.
    pub cells: Vec<NamedSet>,
    /// Sets of faces, inside the mesh or on its boundary.
    pub faces: Vec<FaceSet>,
    /// Sets of nodes.
    pub nodes: Vec<NamedSet>,
}

impl NamedSets {
    /// Returns `true` if there are no sets.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty() && self.faces.is_empty() && self.nodes.is_empty()
    }

    /// Adds the sets to a file with this number of nodes and cells.
    pub fn add_to<M>(&self, file: &mut MeshFile<M>, nodes: usize, cells: usize) {
        let array = |prefix: &str, set: &NamedSet, count: usize| {
            let mut values = vec![0u8; count];
            set.members.iter().for_each(|&i| values[i as usize] = 1);
            DataArray::scalars(format!("{prefix}{}", set.name), values)
        };
        let cell_arrays = self.cells.iter().map(|s| array(CELL_SET_PREFIX, s, cells));
        file.cell_data.extend(cell_arrays);
        let node_arrays = self.nodes.iter().map(|s| array(NODE_SET_PREFIX, s, nodes));
        file.point_data.extend(node_arrays);
        file.field_data.extend(face_set_fields(&self.faces));
    }

    /// Reads the sets of a file. Faces without a set are ignored.
    pub fn from_file<M>(file: &MeshFile<M>) -> Self {
        let sets = |arrays: &[DataArray], prefix: &str| -> Vec<NamedSet> {
            let set = |array: &DataArray| {
                let name = array.name.strip_prefix(prefix)?.to_string();
                let values = (array.components == 1).then(|| array.values.to_f64())?;
                let members = (0..).zip(values).filter(|(_, value)| *value != 0.0);
                let members = members.map(|(i, _)| i).collect();
                Some(NamedSet { name, members })
            };
            arrays.iter().filter_map(set).collect()
        };
        Self {
            cells: sets(&file.cell_data, CELL_SET_PREFIX),
            faces: face_sets(file).unwrap_or_default(),
            nodes: sets(&file.point_data, NODE_SET_PREFIX),
        }
    }
}

/// Returns the fields that store sets of faces; empty if there are none.
pub fn face_set_fields(sets: &[FaceSet]) -> Vec<(String, FieldValue)> {
    if sets.is_empty() {
        return Vec::new();
    }
    let mut numbers = Vec::new();
    for (number, set) in (1..).zip(sets) {
        for i in 0..set.faces.len() {
            let face = set.faces.get(i);
            numbers.extend([number, face.len() as i64]);
            numbers.extend(face.iter().map(|&n| i64::from(n)));
        }
    }
    let names: Vec<&str> = sets.iter().map(|set| set.name.as_str()).collect();
    vec![
        (
            FACE_SET_NAMES_FIELD.into(),
            FieldValue::Text(names.join("\n")),
        ),
        (FACE_SETS_FIELD.into(), FieldValue::Ints(numbers)),
    ]
}

/// Reads the sets of faces; `None` if there are none, or if their fields are damaged.
fn face_sets<M>(file: &MeshFile<M>) -> Option<Vec<FaceSet>> {
    let (FieldValue::Text(names), FieldValue::Ints(numbers)) = (
        file.field_value(FACE_SET_NAMES_FIELD)?,
        file.field_value(FACE_SETS_FIELD)?,
    ) else {
        return None;
    };
    let set = |name: &str| FaceSet {
        name: name.into(),
        faces: Lists::default(),
    };
    let mut sets: Vec<FaceSet> = names.lines().map(set).collect();
    let mut rest = numbers.as_slice();
    while let [number, size, after @ ..] = rest {
        let (nodes, next) = after.split_at_checked(usize::try_from(*size).ok()?)?;
        let nodes: Vec<u32> = nodes
            .iter()
            .map(|&n| u32::try_from(n).ok())
            .collect::<Option<_>>()?;
        let index = usize::try_from(*number).ok()?.checked_sub(1)?;
        sets.get_mut(index)?
            .faces
            .push(crate::geometry::sorted(nodes));
        rest = next;
    }
    rest.is_empty().then_some(sets)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_come_back_from_a_file_and_damaged_ones_are_ignored() {
        let mut faces = Lists::default();
        faces.push([0, 1, 3]);
        faces.push([0, 1, 2, 4]);
        let set = |name: &str, members: &[u32]| NamedSet {
            name: name.into(),
            members: members.to_vec(),
        };
        let sets = NamedSets {
            cells: vec![set("all", &[0, 1]), set("left", &[0])],
            faces: vec![FaceSet {
                name: "outer wall".into(),
                faces,
            }],
            nodes: vec![set("corner", &[4])],
        };
        let mut file = MeshFile::<()>::default();
        sets.add_to(&mut file, 5, 2);
        assert_eq!(NamedSets::from_file(&file), sets);
        for damaged in [vec![1], vec![2, 1, 0], vec![1, 9, 0], vec![1, 1, -1]] {
            file.field_data.pop();
            file.field_data
                .push((FACE_SETS_FIELD.into(), FieldValue::Ints(damaged)));
            assert!(NamedSets::from_file(&file).faces.is_empty());
        }
    }
}
