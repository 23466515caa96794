//! The regions of a mesh that are labels of its image, as the file stores them.

use serde::{Deserialize, Serialize};

use super::array_names::LABELS_FIELD;
use super::{FieldValue, MeshFile};
use crate::image::LabelValue;

/// A region that is a label of the image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelledRegion {
    /// Region number of its cells.
    pub region: i32,
    /// Label of its samples.
    pub label: LabelValue,
    /// Name of the label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// Returns the field that stores labelled regions.
pub(crate) fn regions_field(regions: &[LabelledRegion]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(regions).ok()?;
    Some((LABELS_FIELD.into(), FieldValue::Text(text)))
}

/// Removes the labels from a file whose regions are replaced.
pub(crate) fn remove_labels<M>(file: &mut MeshFile<M>) {
    file.field_data.retain(|(name, _)| name != LABELS_FIELD);
}

/// Returns the labels of a file; empty if its regions are no labels.
pub fn read_labels<M>(file: &MeshFile<M>) -> Vec<LabelledRegion> {
    match file.field_value(LABELS_FIELD) {
        Some(FieldValue::Text(text)) => serde_json::from_str(text.trim()).unwrap_or_default(),
        _ => Vec::new(),
    }
}
