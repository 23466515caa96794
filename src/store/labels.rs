//! The regions of a mesh that are labels of its image, as the file stores them.

use serde::{Deserialize, Serialize};

use super::{FieldValue, MeshFile};
use crate::feature::LabelMap;
use crate::image::LabelValue;

/// Name of the field that stores the labels.
pub(super) const LABELS_FIELD: &str = "labels";

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

/// Returns the field that stores the labels of an image.
pub(super) fn labels_field<const D: usize>(
    label_map: &LabelMap<D>,
) -> Option<(String, FieldValue)> {
    let regions: Vec<LabelledRegion> = (label_map.labels.iter().zip(&label_map.names))
        .zip(label_map.regions())
        .map(|((&label, name), region)| LabelledRegion {
            region,
            label,
            name: name.clone(),
        })
        .collect();
    regions_field(&regions)
}

/// Returns the field that stores labelled regions.
pub(super) fn regions_field(regions: &[LabelledRegion]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(regions).ok()?;
    Some((LABELS_FIELD.into(), FieldValue::Text(text)))
}

/// Removes the labels from a file whose regions are replaced.
pub(super) fn remove_labels<M>(file: &mut MeshFile<M>) {
    file.field_data.retain(|(name, _)| name != LABELS_FIELD);
}

/// Returns the labels of a file; empty if its regions are no labels.
pub fn read_labels<M>(file: &MeshFile<M>) -> Vec<LabelledRegion> {
    match file.field_value(LABELS_FIELD) {
        Some(FieldValue::Text(text)) => serde_json::from_str(text.trim()).unwrap_or_default(),
        _ => Vec::new(),
    }
}
