//! Collects the values by which the page colours cells.

use serde_json::{Value, json};

use super::culling::PageMesh;
use super::pack::ByteStreams;
use crate::files::vtk::{DataArray, Values};
use crate::image::Image;
use crate::mesh::complex::NONE;
use crate::mesh_file::array_names::{ANGLES_ARRAY, HORIZON_FACES_ARRAY, IMAGE_ARRAY, array_unit};
use crate::model::slice::DrawableFaces;
use crate::store::{Storable, StoredMesh};

/// Code of a missing value.
const NO_VALUE: u16 = u16::MAX;
/// Largest code of a value.
const MAX_CODE: u16 = u16::MAX - 1;

/// Scalar value of each cell of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CellValues {
    /// Name of the values.
    pub name: String,
    /// Unit of the values. Empty if they have none, or if it is unknown.
    pub unit: String,
    /// Values by cell number.
    pub values: Vec<f64>,
    /// `true` if all values are integers.
    pub is_integer: bool,
    /// Names that the integers 0, 1, ... stand for. Empty if they are numbers.
    pub value_names: &'static [&'static str],
}

impl CellValues {
    /// Adds the values of the kept cells to the streams of a page, and returns their description.
    /// Integers are exact. Other values are rounded to 1/65534 of their range.
    pub(super) fn add_to_streams(&self, streams: &mut ByteStreams, kept: &PageMesh) -> Value {
        let values = || kept.cells.iter().map(|&c| self.values[c as usize]);
        let (low, high) = (values().filter(|v| v.is_finite()))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let exact = self.is_integer && high - low <= f64::from(MAX_CODE);
        let step = if exact {
            1.0
        } else {
            ((high - low) / f64::from(MAX_CODE)).max(f64::MIN_POSITIVE)
        };
        let codes: Vec<u16> = values()
            .map(|v| {
                if v.is_finite() {
                    ((v - low) / step).round() as u16
                } else {
                    NO_VALUE
                }
            })
            .collect();
        streams.add_u16s(&format!("array {}", self.name), &codes);
        json!({
            "name": self.name,
            "unit": self.unit,
            "low": low,
            "high": high,
            "step": step,
            "whole": exact,
            "words": self.value_names,
        })
    }
}

/// Returns the scalar cell arrays of a mesh, the mean over each cell of each scalar node array, and
/// the image at the centre of each cell.
pub(super) fn scalar_arrays<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    faces: &DrawableFaces,
    image: Option<&Image<D>>,
) -> Vec<CellValues> {
    // Arrays of bits that mark faces, which the page shows by the faces themselves.
    const BITMASK_ARRAYS: [&str; 3] = ["feature_faces", "feature_edges", HORIZON_FACES_ARRAY];
    let units = &stored.space.geometry.units;
    let count = stored.lattice.len();
    let mut arrays: Vec<CellValues> = Vec::new();
    let scalar = |array: &&DataArray, count: usize| {
        array.components == 1
            && array.values.len() == count
            && !BITMASK_ARRAYS.contains(&&*array.name)
    };
    for array in (stored.arrays.cell_data.iter()).filter(|a| scalar(a, count)) {
        arrays.push(CellValues {
            name: array.name.clone(),
            unit: array_unit(&array.name, units),
            values: array.values.to_f64(),
            is_integer: are_integers(&array.values),
            value_names: if array.name == ANGLES_ARRAY {
                &ANGLE_CLASS_NAMES
            } else {
                &[]
            },
        });
    }
    if let Some(regions) = stored.regions()
        && !arrays.iter().any(|array| array.name == "region")
    {
        arrays.push(CellValues {
            name: "region".to_string(),
            unit: String::new(),
            values: regions.into_iter().map(f64::from).collect(),
            is_integer: true,
            value_names: &[],
        });
    }
    for array in (stored.arrays.point_data.iter())
        .filter(|array| scalar(array, stored.lattice.nodes().len()) && !are_integers(&array.values))
    {
        if arrays.iter().all(|known| known.name != array.name) {
            arrays.push(CellValues {
                name: array.name.clone(),
                unit: array_unit(&array.name, units),
                values: cell_means(faces, &array.values.to_f64()),
                is_integer: false,
                value_names: &[],
            });
        }
    }
    if let Some(image) = image
        && arrays.iter().all(|array| array.name != IMAGE_ARRAY)
    {
        let dims = image.dims();
        let sample = |middle: &[f64; 3]| {
            let index = std::array::from_fn(|k| middle[k] * (dims[k] - 1) as f64);
            f64::from(image.interpolate_linear(index))
        };
        arrays.push(CellValues {
            name: IMAGE_ARRAY.to_string(),
            unit: String::new(),
            values: faces.cell_centres.iter().map(sample).collect(),
            is_integer: false,
            value_names: &[],
        });
    }
    arrays
}

/// Meaning of the numbers in [`ANGLES_ARRAY`].
const ANGLE_CLASS_NAMES: [&str; 3] = ["within bounds", "explained by features", "unexplained"];

fn are_integers(values: &Values) -> bool {
    !matches!(values, Values::F32(_) | Values::F64(_))
}

/// Returns the mean of node values over the drawn faces of each cell; NaN for a cell without such a
/// face. For a simplex it is the mean over its nodes.
fn cell_means(faces: &DrawableFaces, values: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); faces.cell_centres.len()];
    for (face, cells) in faces.cells.iter().enumerate() {
        let ring = faces.rings.get(face);
        let sum: f64 = ring.iter().map(|&n| values[n as usize]).sum();
        for &cell in cells.iter().filter(|&&cell| cell != NONE) {
            let (total, count) = &mut sums[cell as usize];
            *total += sum;
            *count += ring.len() as f64;
        }
    }
    let mean = |(sum, count): (f64, f64)| if count > 0.0 { sum / count } else { f64::NAN };
    sums.into_iter().map(mean).collect()
}
