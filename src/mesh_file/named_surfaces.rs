//! Surfaces that have names in the file of another program, as our files store them.

use super::array_names::{SURFACE_FACES_FIELD, SURFACE_NAMES_FIELD};
use super::{FieldValue, MeshFile};
use crate::geometry::sorted_distinct;

/// Named surfaces and their faces.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NamedSurfaces {
    /// Names of surfaces 1, 2 and so on.
    pub names: Vec<String>,
    /// The two cells of each face, ascending, and the number of its surface; sorted.
    pub faces: Vec<([u32; 2], u32)>,
}

impl NamedSurfaces {
    /// Creates named surfaces from faces with the index of a name. Of a face with two names, the
    /// first name counts. Names without faces are removed.
    pub fn new(names: &[String], mut faces: Vec<([u32; 2], u32)>) -> Self {
        faces.sort_unstable();
        faces.dedup_by_key(|(cells, _)| *cells);
        let used = sorted_distinct(faces.iter().map(|face| face.1));
        let surface_number = |index: u32| used.partition_point(|&other| other < index) as u32 + 1;
        Self {
            faces: (faces.iter())
                .map(|&(cells, index)| (cells, surface_number(index)))
                .collect(),
            names: used
                .iter()
                .map(|&index| names[index as usize].clone())
                .collect(),
        }
    }

    /// Returns the fields that store the surfaces; empty if there are none.
    pub fn into_fields(self) -> Vec<(String, FieldValue)> {
        if self.names.is_empty() {
            return Vec::new();
        }
        let numbers = self
            .faces
            .iter()
            .flat_map(|&([a, b], surface)| [surface, a, b]);
        let numbers = numbers.map(i64::from).collect();
        vec![
            (
                SURFACE_NAMES_FIELD.into(),
                FieldValue::Text(self.names.join("\n")),
            ),
            (SURFACE_FACES_FIELD.into(), FieldValue::Ints(numbers)),
        ]
    }

    /// Puts the surfaces in the place of those that a file has.
    pub fn replace_in(self, fields: &mut Vec<(String, FieldValue)>) {
        fields.retain(|(name, _)| name != SURFACE_NAMES_FIELD && name != SURFACE_FACES_FIELD);
        fields.extend(self.into_fields());
    }

    /// Reads the surfaces of a file.
    pub(crate) fn from_file<M>(file: &MeshFile<M>) -> Self {
        let (Some(FieldValue::Text(names)), Some(FieldValue::Ints(numbers))) = (
            file.field_value(SURFACE_NAMES_FIELD),
            file.field_value(SURFACE_FACES_FIELD),
        ) else {
            return Self::default();
        };
        let names: Vec<String> = names.lines().map(str::to_string).collect();
        let face = |&[surface, a, b]: &[i64; 3]| {
            let index = u32::try_from(surface).ok()?.checked_sub(1)?;
            let cells = [u32::try_from(a).ok()?, u32::try_from(b).ok()?];
            ((index as usize) < names.len()).then_some((cells, index))
        };
        let faces = numbers.as_chunks::<3>().0.iter().filter_map(face);
        Self::new(&names, faces.collect())
    }

    /// Returns the number of the surface on which the face between two cells lies.
    pub fn surface_between(&self, mut cells: [u32; 2]) -> Option<u32> {
        cells.sort_unstable();
        let found = self.faces.binary_search_by_key(&cells, |face| face.0);
        found.ok().map(|i| self.faces[i].1)
    }
}
