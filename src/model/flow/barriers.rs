//! The faces of a mesh that resist flow (faults), and the fault law of each.

use super::rock::FaultLaw;
use crate::error::cause;
use crate::{Error, Result};

/// The barriers of a mesh. Faces are numbered as in
/// [`Connection::face`](crate::mesh::graph::Connection::face): face k of simplex c is `(D + 1) c +
/// k`; faces of polyhedra and polygons have the mesh's own numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Barriers {
    label: Vec<u32>,
    laws: Vec<FaultLaw>,
    names: Vec<String>,
}

impl Barriers {
    /// Returns barriers with one law on all faces for which `is_barrier`, in the order of the
    /// faces, is `true`.
    pub fn uniform(is_barrier: impl IntoIterator<Item = bool>, law: FaultLaw) -> Self {
        Self {
            label: is_barrier.into_iter().map(u32::from).collect(),
            laws: vec![law],
            names: Vec::new(),
        }
    }

    /// Returns barriers with labels. `label` has one entry for each face, 0 where there is no
    /// barrier; label l has the law `laws[l - 1]`. A face between two simplices has two numbers,
    /// and it is enough if one of them has a label.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if a label has no law.
    pub fn new(label: Vec<u32>, laws: Vec<FaultLaw>) -> Result<Self> {
        match label.iter().max() {
            Some(&max) if max as usize > laws.len() => Err(Error::Flow(cause(
                format!("fault {max}"),
                "has no multiplier",
                format!("give one for each of {max} faults"),
            ))),
            _ => Ok(Self {
                label,
                laws,
                names: Vec::new(),
            }),
        }
    }

    /// Adds the names of labels 1, 2 ...
    #[must_use]
    pub fn with_names(self, names: Vec<String>) -> Self {
        Self { names, ..self }
    }

    /// Gives some faces laws of their own, in place of those of their labels.
    #[must_use]
    pub fn with_face_laws(
        mut self,
        face_laws: impl IntoIterator<Item = (usize, FaultLaw)>,
    ) -> Self {
        for (face, law) in face_laws {
            self.laws.push(law);
            let count = self.label.len().max(face + 1);
            self.label.resize(count, 0);
            self.label[face] = self.laws.len() as u32;
        }
        self
    }

    /// Returns the name of the barriers with a label. Labels without a name are called `scraps`.
    pub fn name(&self, label: u32) -> String {
        let name = self.names.get(label as usize - 1).cloned();
        name.unwrap_or_else(|| "scraps".into())
    }

    /// Returns the label of a face, or `None` if nothing resists flow there.
    #[inline]
    pub fn label(&self, face: usize) -> Option<u32> {
        let label = *self.label.get(face)?;
        (label > 0 && !self.law(label).is_open()).then_some(label)
    }

    /// Returns the law of the barriers with a label.
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
    fn labels_have_laws_and_open_faults_have_no_label() {
        let law = |m| FaultLaw::new(m, None).unwrap();
        let barriers = Barriers::new(vec![0, 2, 1, 0], vec![law(0.5), law(1.0)]).unwrap();
        let labels = [0, 1, 2, 3, 4].map(|face| barriers.label(face));
        assert_eq!(labels, [None, None, Some(1), None, None]);
        assert_eq!(barriers.law(1), law(0.5));
        let error = Barriers::new(vec![0, 3], vec![law(0.5)]).unwrap_err();
        assert!(error.to_string().starts_with("fault 3: "), "{error}");
    }

    #[test]
    fn bits_mark_the_faces_of_triangles_and_tetrahedra() {
        let marks: Vec<bool> = marks_from_bits::<2>(&[5, 2]).collect();
        assert_eq!(marks, [true, false, true, false, true, false]);
        assert_eq!(marks_from_bits::<3>(&[8, 0]).count(), 8);
    }
}
