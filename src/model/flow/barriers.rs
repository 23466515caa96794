//! Which faces of a mesh resist flow, and how: faults, each with its own law.

use super::rock::FaultLaw;
use crate::error::cause;
use crate::{Error, Result};

/// The barriers of a mesh. Faces are numbered as in
/// [`Connection::face`](crate::mesh::graph::Connection::face): face k of simplex c is
/// `(D + 1) c + k`, those of polyhedra and polygons are the mesh's own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Barriers {
    label: Vec<u32>,
    laws: Vec<FaultLaw>,
    names: Vec<String>,
}

impl Barriers {
    /// Barriers that all resist alike, on the faces for which `on` holds, face after face.
    pub fn uniform(on: impl IntoIterator<Item = bool>, law: FaultLaw) -> Self {
        Self {
            label: on.into_iter().map(u32::from).collect(),
            laws: vec![law],
            names: Vec::new(),
        }
    }

    /// Barriers with labels: `label` has one for each face, 0 where nothing stands; label l resists
    /// as `laws[l - 1]` says. The two numbers that a face between simplices has need not both be
    /// labelled.
    ///
    /// # Errors
    /// [`Error::Flow`] for a label without a law.
    pub fn new(label: Vec<u32>, laws: Vec<FaultLaw>) -> Result<Self> {
        match label.iter().max() {
            Some(&most) if most as usize > laws.len() => Err(Error::Flow(cause(
                format!("fault {most}"),
                "has no multiplier",
                format!("give one for each of {most} faults"),
            ))),
            _ => Ok(Self {
                label,
                laws,
                names: Vec::new(),
            }),
        }
    }

    /// The same with names for labels 1, 2 ...
    #[must_use]
    pub fn with_names(self, names: Vec<String>) -> Self {
        Self { names, ..self }
    }

    /// The name of a label's barriers.
    pub fn name(&self, label: u32) -> String {
        let name = self.names.get(label as usize - 1).cloned();
        name.unwrap_or_else(|| "scraps".into())
    }

    /// The label of a face, unless nothing resists there.
    #[inline]
    pub fn label(&self, face: usize) -> Option<u32> {
        let label = *self.label.get(face)?;
        (label > 0 && !self.law(label).is_open()).then_some(label)
    }

    /// How barriers of a label resist.
    #[inline]
    pub fn law(&self, label: u32) -> FaultLaw {
        self.laws[label as usize - 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::interface::marks_from_bits;

    #[test]
    fn labels_have_laws_and_open_ones_do_not_count() {
        let law = |m| FaultLaw::new(m, None).unwrap();
        let barriers = Barriers::new(vec![0, 2, 1, 0], vec![law(0.5), law(1.0)]).unwrap();
        let labels = [0, 1, 2, 3, 4].map(|face| barriers.label(face));
        assert_eq!(labels, [None, None, Some(1), None, None]);
        assert_eq!(barriers.law(1), law(0.5));
        let error = Barriers::new(vec![0, 3], vec![law(0.5)]).unwrap_err();
        assert!(error.to_string().starts_with("fault 3: "), "{error}");
    }

    #[test]
    fn bits_stand_for_the_faces_of_triangles_and_tetrahedra() {
        let marks: Vec<bool> = marks_from_bits::<2>(&[5, 2]).collect();
        assert_eq!(marks, [true, false, true, false, true, false]);
        assert_eq!(marks_from_bits::<3>(&[8, 0]).count(), 8);
    }
}
