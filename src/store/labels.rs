//! The regions of a mesh that are labels of its image, as its file keeps them.

use serde::{Deserialize, Serialize};

use super::{FieldValue, MeshFile};
use crate::feature::LabelMap;
use crate::image::LabelValue;

/// The name under which a file keeps them.
const LABELS_FIELD: &str = "labels";

/// A region that is a label of the image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelledRegion {
    /// The value that its cells have.
    pub region: i32,
    /// The value that its samples have.
    pub label: LabelValue,
    /// What it is called.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// What a file says of labels.
pub(super) fn labels_field<const D: usize>(labelled: &LabelMap<D>) -> Option<(String, FieldValue)> {
    let regions: Vec<LabelledRegion> = (labelled.labels.iter().zip(&labelled.names))
        .zip(labelled.regions())
        .map(|((&label, name), region)| LabelledRegion {
            region,
            label,
            name: name.clone(),
        })
        .collect();
    regions_field(&regions)
}

/// The field that says it.
pub(super) fn regions_field(regions: &[LabelledRegion]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(regions).ok()?;
    Some((LABELS_FIELD.into(), FieldValue::Text(text)))
}

/// Regions that are set anew are no labels any more.
pub(super) fn remove_labels<M>(file: &mut MeshFile<M>) {
    file.field_data.retain(|(name, _)| name != LABELS_FIELD);
}

/// The labels of a file; none if its regions are no labels.
pub fn read_labels<M>(file: &MeshFile<M>) -> Vec<LabelledRegion> {
    match file.field_value(LABELS_FIELD) {
        Some(FieldValue::Text(text)) => serde_json::from_str(text.trim()).unwrap_or_default(),
        _ => Vec::new(),
    }
}
