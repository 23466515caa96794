//! Segmentations of 3D Slicer (`.seg.nrrd`): NRRD files whose key/value pairs name the labels, and whose
//! first axis counts layers if segments overlap.
//!
//! Positions are those of the NRRD header. `Segmentation_ReferenceImageExtentOffset` only says where
//! the samples lie in the image that was segmented. Source: the developer guide of 3D Slicer,
//! "Segmentations".

use std::collections::BTreeMap;

use crate::image::LabelValue;
use crate::names;

/// A segment: a label of one layer.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Segment {
    /// Its name.
    pub name: String,
    /// The value of its samples.
    pub label: LabelValue,
    /// The number of its layer, from 0.
    pub layer: usize,
}

/// Returns the segments that the key/value pairs of a header describe. `has_layers` is `true` if the
/// file has an axis of layers.
///
/// Files of versions before 4.11 have a layer for each segment, whose samples are 1 in it.
pub(super) fn segments(pairs: &[(String, String)], has_layers: bool) -> Vec<Segment> {
    let mut fields: BTreeMap<usize, BTreeMap<&str, &str>> = BTreeMap::new();
    for (key, value) in pairs {
        let field = key.strip_prefix("Segment").and_then(|rest| {
            let (number, field) = rest.split_once('_')?;
            Some((number.parse::<usize>().ok()?, field))
        });
        if let Some((number, field)) = field {
            fields.entry(number).or_default().insert(field, value);
        }
    }
    let segment = |(number, fields): (&usize, &BTreeMap<&str, &str>)| {
        let layer = fields
            .get("Layer")
            .and_then(|text| text.trim().parse().ok());
        let label = fields
            .get("LabelValue")
            .and_then(|text| LabelValue::parse(text));
        let default_layer = if has_layers { *number } else { 0 };
        Some(Segment {
            name: names::from_file(fields.get("Name")?),
            label: label.unwrap_or(LabelValue::Whole(1)),
            layer: layer.unwrap_or(default_layer),
        })
        .filter(|segment| !segment.name.is_empty())
    };
    fields.iter().filter_map(segment).collect()
}

/// Returns the names of the labels of a layer. Of segments that share a label the first counts.
pub(super) fn label_names(segments: &[Segment], layer: usize) -> Vec<(LabelValue, String)> {
    let mut labels: Vec<(LabelValue, String)> = Vec::new();
    for segment in segments.iter().filter(|segment| segment.layer == layer) {
        if !labels.iter().any(|(label, _)| *label == segment.label) {
            labels.push((segment.label, segment.name.clone()));
        }
    }
    labels
}

/// The beginning of the note on names that the file of an image gives.
pub(super) const NAMES_NOTE: &str = "labels have the names of the file";

/// Returns a note that lists the names of labels, if there are any.
pub(super) fn note_on_names(names: &[(LabelValue, String)]) -> Option<String> {
    const MAX_NAMES: usize = 20;
    let mut list: Vec<String> = (names.iter().take(MAX_NAMES))
        .map(|(label, name)| format!("{label} = {name}"))
        .collect();
    if names.len() > MAX_NAMES {
        list.push("...".into());
    }
    (!names.is_empty()).then(|| format!("{NAMES_NOTE}: {}", list.join(", ")))
}

/// Returns a description of the layers, with the names of their segments.
pub(super) fn describe_layers(segments: &[Segment], count: usize) -> String {
    const MAX_LAYERS: usize = 12;
    let layer = |layer: usize| {
        let segments = segments.iter().filter(|segment| segment.layer == layer);
        let names: Vec<&str> = segments.map(|segment| segment.name.as_str()).collect();
        match names[..] {
            [] => layer.to_string(),
            _ => format!("{layer} ({})", names.join(", ")),
        }
    };
    let mut layers: Vec<String> = (0..count.min(MAX_LAYERS)).map(layer).collect();
    if count > MAX_LAYERS {
        layers.push(format!("... {}", count - 1));
    }
    layers.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        pairs
            .iter()
            .map(|(key, value)| ((*key).to_string(), (*value).to_string()))
            .collect()
    }

    #[test]
    fn segments_have_the_labels_and_layers_of_the_header() {
        let header = pairs(&[
            ("Segment0_Name", "Bone"),
            ("Segment0_LabelValue", "3"),
            ("Segment0_Layer", "1"),
            ("Segment10_Name", "Grau: \u{e4}u\u{df}ere Haut"),
            ("Segment10_LabelValue", "2"),
            ("Segment10_Layer", "0"),
            ("Segment2_Name", "without a value"),
            ("Segment3_LabelValue", "7"),
            ("Segmentation_MasterRepresentation", "Binary labelmap"),
        ]);
        let found = segments(&header, true);
        let expected = [
            ("Bone", 3, 1),
            ("without a value", 1, 2),
            ("Grau: \u{e4}u\u{df}ere Haut", 2, 0),
        ];
        let expected = expected.map(|(name, label, layer)| Segment {
            name: name.into(),
            label: LabelValue::Whole(label),
            layer,
        });
        assert_eq!(found, expected);
        assert_eq!(
            label_names(&found, 1),
            [(LabelValue::Whole(3), "Bone".to_string())]
        );
        assert_eq!(
            describe_layers(&found, 4),
            "0 (Grau: \u{e4}u\u{df}ere Haut), 1 (Bone), 2 (without a value), 3"
        );
        assert_eq!(segments(&header, false)[1].layer, 0);
    }
}
