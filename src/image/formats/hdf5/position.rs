//! The order of a data set's axes, and the position of its samples.

use super::source::{Hdf5Source, NumberSet, attribute_numbers, attribute_text};
use crate::Result;
use crate::image::Geometry;
use crate::parallel::prelude::*;

/// Group of ITK's images.
const ITK_GROUP: &str = "/ITKImage/0";
/// Group of VTK's data.
const VTK_GROUP: &str = "/VTKHDF";
/// Attribute of the distances between samples in micrometres, z first, as the HDF5 plugins of Fiji and
/// ilastik write it.
const ELEMENT_SIZE: &str = "element_size_um";

/// Returns the path of the image of a file that a known program wrote.
pub fn known_image(source: &Hdf5Source) -> Option<String> {
    let itk = format!("{ITK_GROUP}/VoxelData");
    if source.dataset(&itk).is_ok() {
        return Some(itk);
    }
    let group = source.group(VTK_GROUP)?;
    let kind = attribute_text(&group.attribute("Type").ok()?)?;
    if kind != "ImageData" {
        return None;
    }
    let arrays = |part: &str| -> Option<String> {
        let child = source.group(&format!("{VTK_GROUP}/{part}"))?;
        let active = child.attribute("Scalars").ok();
        let active = active.as_ref().and_then(attribute_text);
        let (_, mut names) = child.member_names().ok()?;
        names.sort();
        let name = active.filter(|name| names.contains(name));
        let name = name.or_else(|| (names.len() == 1).then(|| names.remove(0)))?;
        Some(format!("{VTK_GROUP}/{part}/{name}"))
    };
    arrays("PointData").or_else(|| arrays("CellData"))
}

/// The axes of a data set as x, y and z.
pub struct ArrayAxes {
    /// Number of samples along x, y and z.
    pub dims: [usize; 3],
    /// Distance in numbers of the data set between samples along x, y and z.
    strides: [usize; 3],
    /// Distance between samples that `axistags` gives; 0 for none.
    resolutions: [f64; 3],
}

impl ArrayAxes {
    /// Finds the axes of a data set. Axes of length 1 for time or channels are left out.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) for a data set of other than two or three axes.
    pub fn new(set: &NumberSet<'_>) -> Result<Self> {
        let shape = set.shape();
        let mut strides = vec![1usize; shape.len()];
        for k in (0..shape.len().saturating_sub(1)).rev() {
            strides[k] = strides[k + 1].saturating_mul(shape[k + 1]);
        }
        let tags = set.attribute_text("axistags");
        let tags = tags.and_then(|text| axis_tags(&text));
        let tags = tags.filter(|tags| tags.len() == shape.len());
        // Without tags the last axis is x.
        let mut letters: Vec<(char, f64)> = match tags {
            Some(tags) => tags,
            None => {
                let first_used = shape.iter().position(|&n| n != 1).unwrap_or(shape.len());
                // Leading axes of length 1 are left out if there are more than three.
                let extra = shape.len().saturating_sub(3).min(first_used);
                let last_used = shape.iter().rposition(|&n| n != 1).unwrap_or(0);
                let mut end = shape.len();
                while end - extra > 3 && end - 1 > last_used {
                    end -= 1;
                }
                let names = ['z', 'y', 'x'];
                let count = end - extra;
                let name = |k: usize| match k.checked_sub(extra) {
                    Some(index) if index < count && count <= 3 => names[3 - count + index],
                    _ => 'c',
                };
                (0..shape.len()).map(|k| (name(k), 0.0)).collect()
            }
        };
        letters.truncate(shape.len());
        let mut axes = Self {
            dims: [1; 3],
            strides: [0; 3],
            resolutions: [0.0; 3],
        };
        for ((letter, resolution), (&length, &stride)) in
            letters.into_iter().zip(shape.iter().zip(&strides))
        {
            match ['x', 'y', 'z'].iter().position(|&known| known == letter) {
                Some(axis) => {
                    axes.dims[axis] = length;
                    axes.strides[axis] = stride;
                    axes.resolutions[axis] = resolution;
                }
                None if length == 1 => {}
                None => {
                    return Err(set.error(
                        format!(
                            "has {length} channels, times or further axes (shape {shape:?}), not one"
                        ),
                        "write one of them to a file of its own, with h5py",
                    ));
                }
            }
        }
        if shape.len() < 2 {
            let problem = format!("has {} axes, not two or three", shape.len());
            return Err(set.error(problem, "give an image"));
        }
        Ok(axes)
    }

    /// Returns the bytes of the samples in the order of an image, x fastest.
    pub fn in_order(&self, bytes: Vec<u8>, size: usize) -> Vec<u8> {
        let [nx, ny, nz] = self.dims;
        let count = nx.saturating_mul(ny).saturating_mul(nz);
        let expected = [1, nx, nx * ny];
        let is_in_order = (0..3).all(|k| self.dims[k] == 1 || self.strides[k] == expected[k]);
        if is_in_order || bytes.len() != count * size {
            return bytes;
        }
        let mut ordered = vec![0; bytes.len()];
        let rows = ordered.par_chunks_mut(nx * size).enumerate();
        rows.for_each(|(row, out)| {
            let start = row % ny * self.strides[1] + row / ny * self.strides[2];
            for (i, sample) in out.chunks_exact_mut(size).enumerate() {
                let at = size * (start + i * self.strides[0]);
                sample.copy_from_slice(&bytes[at..at + size]);
            }
        });
        ordered
    }
}

/// Returns the axes in the JSON text of vigra: the letter of each, and the distance between samples.
fn axis_tags(text: &str) -> Option<Vec<(char, f64)>> {
    let tags: serde_json::Value = serde_json::from_str(text).ok()?;
    let axis = |axis: &serde_json::Value| {
        let key = axis.get("key")?.as_str()?.chars().next()?;
        let resolution = axis.get("resolution").and_then(serde_json::Value::as_f64);
        Some((key, resolution.unwrap_or(0.0)))
    };
    tags.get("axes")?.as_array()?.iter().map(axis).collect()
}

/// The position of samples.
pub struct Position {
    /// The geometry; the default if the file has none.
    pub geometry: Geometry<3>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

impl Position {
    /// Finds the position of a data set's samples.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) for a position that is incomplete.
    pub fn find(source: &Hdf5Source, set: &NumberSet<'_>) -> Result<Self> {
        let mut notes = Vec::new();
        let geometry = if set.path.starts_with(&format!("{ITK_GROUP}/")) {
            itk_geometry(source, set)?
        } else if set.path.starts_with(&format!("{VTK_GROUP}/")) {
            vtk_geometry(source, set)?
        } else {
            stated_spacing(set)?
        };
        if set.attribute_text("MATLAB_class").is_some() {
            notes.push("MATLAB's first index is x, its second y and its third z".into());
        }
        Ok(Self { geometry, notes })
    }
}

/// Returns the geometry of ITK's image, in the coordinates of its other formats (LPS).
fn itk_geometry(source: &Hdf5Source, set: &NumberSet<'_>) -> Result<Geometry<3>> {
    let numbers = |name: &str| -> Result<Vec<f64>> {
        let set = source.dataset(&format!("{ITK_GROUP}/{name}"))?;
        let encoding = set.encoding()?;
        Ok(encoding.numbers(&set.read_bytes()?).collect())
    };
    let (origin, spacing) = (numbers("Origin")?, numbers("Spacing")?);
    let directions = numbers("Directions")?;
    let dim = origin.len();
    if ![2, 3].contains(&dim) || spacing.len() != dim || directions.len() != dim * dim {
        let problem = "has a position of other than two or three axes";
        return Err(set.error(problem, "give a 2-D or 3-D image"));
    }
    let mut geometry = Geometry::default();
    for (k, axis) in geometry.axes.iter_mut().enumerate().take(dim) {
        geometry.origin[k] = origin[k];
        // A row holds the direction of an axis.
        *axis = std::array::from_fn(|c| {
            let cosine = if c < dim {
                directions[dim * k + c]
            } else {
                0.0
            };
            cosine * spacing[k]
        });
    }
    Ok(geometry)
}

/// Returns the geometry of VTK's image data.
fn vtk_geometry(source: &Hdf5Source, set: &NumberSet<'_>) -> Result<Geometry<3>> {
    let incomplete = |name: &str| {
        let problem = format!("has no complete attribute {name} of {VTK_GROUP}");
        set.error(problem, crate::files::REWRITE_DAMAGED)
    };
    let group = source.group(VTK_GROUP).ok_or_else(|| incomplete("Type"))?;
    let attribute = |name: &str| attribute_numbers(&group.attribute(name).ok()?);
    let vector = |name: &str, default: f64| -> Result<[f64; 3]> {
        let numbers = attribute(name).unwrap_or_else(|| vec![default; 3]);
        numbers.try_into().map_err(|_| incomplete(name))
    };
    let (origin, spacing) = (vector("Origin", 0.0)?, vector("Spacing", 1.0)?);
    let extent = attribute("WholeExtent").filter(|extent| extent.len() == 6);
    let extent = extent.ok_or_else(|| incomplete("WholeExtent"))?;
    let identity = || vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let direction = attribute("Direction").unwrap_or_else(identity);
    if direction.len() != 9 {
        return Err(incomplete("Direction"));
    }
    let mut geometry = Geometry {
        axes: std::array::from_fn(|k| std::array::from_fn(|c| direction[3 * c + k] * spacing[k])),
        origin,
        ..Geometry::default()
    };
    let is_on_cells = set.path.starts_with(&format!("{VTK_GROUP}/CellData/"));
    let first: [f64; 3] = std::array::from_fn(|k| {
        let has_cells = is_on_cells && extent[2 * k + 1] > extent[2 * k];
        extent[2 * k] + if has_cells { 0.5 } else { 0.0 }
    });
    geometry.origin = geometry.to_physical(first);
    Ok(geometry)
}

/// Returns the geometry of an array with attributes of its spacing; the default if there are none.
fn stated_spacing(set: &NumberSet<'_>) -> Result<Geometry<3>> {
    let is_spacing = |numbers: &[f64]| numbers.iter().all(|x| x.is_finite() && *x > 0.0);
    if let Some(sizes) = set.attribute_numbers(ELEMENT_SIZE) {
        let dims: [f64; 3] = match sizes[..] {
            [z, y, x] if is_spacing(&sizes) => [x, y, z],
            [y, x] if is_spacing(&sizes) => [x, y, 1.0],
            _ => {
                let problem = format!("has the attribute {ELEMENT_SIZE} = {sizes:?}");
                return Err(set.error(problem, "write three distances above 0, z first"));
            }
        };
        let mut geometry = Geometry::with_spacing([0.0; 3], dims);
        geometry.units = std::array::from_fn(|_| "um".to_string());
        return Ok(geometry);
    }
    let axes = ArrayAxes::new(set)?;
    let used: Vec<f64> = (0..3)
        .filter(|&k| axes.dims[k] > 1)
        .map(|k| axes.resolutions[k])
        .collect();
    Ok(if !used.is_empty() && is_spacing(&used) {
        let or_one = |x: f64| if x > 0.0 { x } else { 1.0 };
        Geometry::with_spacing([0.0; 3], axes.resolutions.map(or_one))
    } else {
        Geometry::default()
    })
}
