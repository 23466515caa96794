//! Surfaces that have names in the file of another program, as our files keep them.

use super::{FieldValue, MeshFile};

/// The name under which a file keeps the names, and that of the faces: for each three numbers, that of its
/// surface, from 1 on, and those of its two cells.
pub const SURFACE_NAMES_FIELD: &str = "surface_names";
/// See [`SURFACE_NAMES_FIELD`].
pub const SURFACE_FACES_FIELD: &str = "surface_faces";

/// Surfaces by name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NamedSurfaces {
    /// The name of surface 1, 2 ...
    pub names: Vec<String>,
    /// The two cells of each face, ascending, and the number of its surface; sorted.
    pub faces: Vec<([u32; 2], u32)>,
}

impl NamedSurfaces {
    /// Surfaces by name in their order, each face with the place of its name among them; of a face with two
    /// names the first holds, and names that no face has are left out.
    pub fn new(names: &[String], mut faces: Vec<([u32; 2], u32)>) -> Self {
        faces.sort_unstable();
        faces.dedup_by_key(|(cells, _)| *cells);
        let mut used: Vec<u32> = faces.iter().map(|face| face.1).collect();
        used.sort_unstable();
        used.dedup();
        let number = |place: u32| used.partition_point(|&other| other < place) as u32 + 1;
        Self {
            faces: (faces.iter())
                .map(|&(cells, place)| (cells, number(place)))
                .collect(),
            names: used
                .iter()
                .map(|&place| names[place as usize].clone())
                .collect(),
        }
    }

    /// The fields that say it; none if there are no surfaces.
    pub fn into_fields(self) -> Vec<(String, FieldValue)> {
        if self.names.is_empty() {
            return Vec::new();
        }
        let numbers = self
            .faces
            .iter()
            .flat_map(|&([a, b], number)| [number, a, b]);
        let numbers = numbers.map(i64::from).collect();
        vec![
            (
                SURFACE_NAMES_FIELD.into(),
                FieldValue::Text(self.names.join("\n")),
            ),
            (SURFACE_FACES_FIELD.into(), FieldValue::Ints(numbers)),
        ]
    }

    /// Those of a file.
    pub(super) fn from_file<M>(file: &MeshFile<M>) -> Self {
        let (Some(FieldValue::Text(names)), Some(FieldValue::Ints(numbers))) = (
            file.field_value(SURFACE_NAMES_FIELD),
            file.field_value(SURFACE_FACES_FIELD),
        ) else {
            return Self::default();
        };
        let names: Vec<String> = names.lines().map(str::to_string).collect();
        let face = |&[number, a, b]: &[i64; 3]| {
            let place = u32::try_from(number).ok()?.checked_sub(1)?;
            let cells = [u32::try_from(a).ok()?, u32::try_from(b).ok()?];
            ((place as usize) < names.len()).then_some((cells, place))
        };
        let faces = numbers.as_chunks::<3>().0.iter().filter_map(face);
        Self::new(&names, faces.collect())
    }

    /// The number of the surface on which the face between two cells lies.
    pub fn surface_between(&self, mut cells: [u32; 2]) -> Option<u32> {
        cells.sort_unstable();
        let at = self.faces.binary_search_by_key(&cells, |face| face.0);
        at.ok().map(|at| self.faces[at].1)
    }
}
