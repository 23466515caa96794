//! Regions that have names but are no labels of the image, and the cells beyond the image.

use serde::{Deserialize, Serialize};

use super::array_names::{BENT_SIDE_FIELD, REGIONS_FIELD};
use super::{FieldValue, MeshFile};

/// Parts of a mesh beyond the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Burden {
    /// Above the image and its sides.
    Over,
    /// Below the image and its sides.
    Under,
    /// Beside the image.
    Side,
}

impl Burden {
    /// All parts, in the order of their regions.
    pub const ALL: [Self; 3] = [Self::Over, Self::Under, Self::Side];

    /// Returns the name of the region.
    pub fn name(self) -> &'static str {
        match self {
            Self::Over => "overburden",
            Self::Under => "underburden",
            Self::Side => "sideburden",
        }
    }
}
/// A region that has a name, but is no label of the image.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NamedRegion {
    /// Region number of its cells.
    pub region: i32,
    /// Its name.
    pub name: String,
}

/// Returns the regions of a file that have names but are no labels; empty if there are none.
pub fn read_named_regions<M>(file: &MeshFile<M>) -> Vec<NamedRegion> {
    match file.field_value(REGIONS_FIELD) {
        Some(FieldValue::Text(text)) => serde_json::from_str(text.trim()).unwrap_or_default(),
        _ => Vec::new(),
    }
}

/// Returns the name of the interface between two regions, from their names or numbers.
pub fn interface_name([a, b]: [&str; 2]) -> String {
    format!("interface_{a}_{b}")
}

/// Returns the number of the side of a mesh's box that follows a topography, if there is one: 2 axis for the lower
/// side, 2 axis + 1 for the upper side.
pub(crate) fn read_bent_side<M>(file: &MeshFile<M>) -> Option<usize> {
    match file.field_value(BENT_SIDE_FIELD) {
        Some(FieldValue::Ints(side)) => side.first().and_then(|&side| side.try_into().ok()),
        _ => None,
    }
}
