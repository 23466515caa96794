//! OME-Zarr (NGFF 0.1 to 0.5): images with levels of resolution, and where their samples lie.
//!
//! A group names its levels in `multiscales`, the finest first, with the axes of the arrays and for
//! each level a scale and a translation. The levels may lie in groups below that group.
//! Specification: <https://ngff.openmicroscopy.org/0.5>.

use std::path::{Component, Path, PathBuf};

use serde_json::{Map, Value};

use super::metadata::{self, ArrayMetadata, ZarrNode};
use crate::image::Geometry;
use crate::image::formats::placement::length_unit;

/// Largest number of groups between a level and the group that describes it.
const MAX_NESTING: usize = 6;

/// Level of an image with several resolutions.
pub struct Level {
    /// Path of the array below the group.
    pub path: PathBuf,
    /// Number of levels of the image.
    pub count: usize,
    /// Number of images that the group describes.
    pub image_count: usize,
}

/// Returns the finest level of the first image that a group describes, or `None` if it describes none.
pub fn finest_level(attributes: &Map<String, Value>) -> Option<Level> {
    let images = multiscales(attributes)?;
    let levels = images.first()?["datasets"].as_array()?;
    let path = PathBuf::from(levels.first()?["path"].as_str()?);
    // The path must not lead out of the group.
    let is_inside = path.components().all(|c| matches!(c, Component::Normal(_)));
    is_inside.then_some(Level {
        path,
        count: levels.len(),
        image_count: images.len(),
    })
}

/// Returns the images with several resolutions that a group describes.
fn multiscales(attributes: &Map<String, Value>) -> Option<&Vec<Value>> {
    let nested = attributes.get("ome").and_then(|ome| ome.get("multiscales"));
    nested
        .or_else(|| attributes.get("multiscales"))?
        .as_array()
        .filter(|images| !images.is_empty())
}

/// Metadata of one level.
pub struct LevelMetadata {
    /// Name of each axis of the array, in lower case.
    names: Vec<String>,
    /// Kind of each axis, such as `space` or `channel`; empty if it is not given.
    kinds: Vec<String>,
    units: Vec<String>,
    scale: Vec<f64>,
    translation: Vec<f64>,
    /// `true` if the metadata give a scale.
    has_scale: bool,
}

impl LevelMetadata {
    /// Finds the metadata of an array in the groups above it. Returns `None` if there are none.
    pub fn find(array: &ArrayMetadata) -> Option<Self> {
        let folder = array.folder.canonicalize().ok()?;
        let groups = folder.ancestors().skip(1).take(MAX_NESTING);
        for group in groups {
            if !metadata::is_node(group) {
                continue;
            }
            let Ok(ZarrNode::Group(attributes)) = ZarrNode::open(group) else {
                continue;
            };
            let path = folder.strip_prefix(group).ok()?;
            for image in multiscales(&attributes).into_iter().flatten() {
                let mut levels = image["datasets"].as_array().into_iter().flatten();
                let level = levels.find(|level| {
                    let name = level["path"].as_str();
                    name.is_some_and(|name| Path::new(name) == path)
                });
                if let Some(level) = level {
                    return Self::parse(image, level, array.shape.len());
                }
            }
        }
        None
    }

    /// Parses the metadata of a level whose array has `count` axes.
    fn parse(image: &Value, level: &Value, count: usize) -> Option<Self> {
        let text = |value: &Value| value.as_str().unwrap_or_default().to_lowercase();
        let axes = match image["axes"].as_array() {
            Some(axes) => axes.clone(),
            // Versions before 0.3 name no axes: they have all five.
            None => ["t", "c", "z", "y", "x"].map(Value::from).to_vec(),
        };
        if axes.len() != count {
            return None;
        }
        let (mut scale, mut translation) = (vec![1.0; count], vec![0.0; count]);
        let mut has_scale = false;
        for entry in [level, image] {
            let steps = entry["coordinateTransformations"].as_array();
            for step in steps.into_iter().flatten() {
                let numbers = |name: &str, default: f64| match &step[name] {
                    Value::Null => Some(vec![default; count]),
                    list => numbers(list).filter(|list| list.len() == count),
                };
                let (factors, shifts) = (numbers("scale", 1.0)?, numbers("translation", 0.0)?);
                has_scale |= !step["scale"].is_null();
                for axis in 0..count {
                    scale[axis] *= factors[axis];
                    translation[axis] = translation[axis] * factors[axis] + shifts[axis];
                }
            }
        }
        Some(Self {
            // Versions before 0.4 give names alone.
            names: (axes.iter())
                .map(|axis| text(if axis.is_string() { axis } else { &axis["name"] }))
                .collect(),
            kinds: axes.iter().map(|axis| text(&axis["type"])).collect(),
            units: (axes.iter())
                .map(|axis| axis["unit"].as_str().unwrap_or_default().to_string())
                .collect(),
            scale,
            translation,
            has_scale,
        })
    }

    /// Returns the axes of the array that lie in space, the slowest first.
    pub fn space_axes(&self) -> Vec<usize> {
        let is_space = |&axis: &usize| match &*self.kinds[axis] {
            "" => matches!(&*self.names[axis], "x" | "y" | "z"),
            kind => kind == "space",
        };
        (0..self.names.len()).filter(is_space).collect()
    }

    /// Returns the geometry of an image whose axes are these axes of the array, the slowest first.
    /// Returns `None` if the metadata give no valid scale.
    pub fn geometry(&self, image_axes: &[usize]) -> Option<Geometry<3>> {
        if !self.has_scale {
            return None;
        }
        let coordinate = |axis: usize| ["x", "y", "z"].iter().position(|n| self.names[axis] == *n);
        let mut geometry = Geometry::default();
        let mut used = [false; 3];
        for (k, &axis) in image_axes.iter().rev().enumerate() {
            let (scale, translation) = (self.scale[axis], self.translation[axis]);
            if !(scale > 0.0 && scale.is_finite() && translation.is_finite()) {
                return None;
            }
            let c = coordinate(axis).unwrap_or(k);
            if std::mem::replace(&mut used[c], true) {
                return None;
            }
            geometry.axes[k] = [0.0; 3];
            geometry.axes[k][c] = scale;
            geometry.origin[c] = translation;
            geometry.names[k].clone_from(&self.names[axis]);
            let unit = &*self.units[axis];
            geometry.units[c] = length_unit(unit).unwrap_or(unit).to_string();
        }
        // In 2-D the axis of the single sample takes the coordinate that is left.
        for k in image_axes.len()..3 {
            let c = used.iter().position(|used| !used)?;
            used[c] = true;
            geometry.axes[k] = [0.0; 3];
            geometry.axes[k][c] = 1.0;
            geometry.units[c] = geometry.units[(c + 1) % 3].clone();
        }
        Some(geometry.in_one_length_unit())
    }

    /// Returns the names of these axes.
    pub fn axis_names(&self, image_axes: &[usize]) -> Vec<String> {
        let names = image_axes.iter().map(|&axis| self.names[axis].clone());
        names.collect()
    }
}

/// Parses a list of numbers.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}
