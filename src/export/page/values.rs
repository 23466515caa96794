//! What the page colours cells by.

use serde_json::{Value, json};

use super::keep::Kept;
use super::pack::Streams;
use crate::files::vtk::{DataArray, Values};
use crate::image::Image;
use crate::mesh::complex::NONE;
use crate::model::slice::Faces;
use crate::store::file::{ANGLES, HORIZON_FACES, IMAGE, unit_of};
use crate::store::{Stored, StoredMesh};

/// Stands for no number.
const NOTHING: u16 = u16::MAX;
/// The largest number that stands for a value.
const FINEST: u16 = u16::MAX - 1;

/// A value for each cell of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
    /// Its name.
    pub name: String,
    /// Its unit; empty if it has none, or none is known.
    pub unit: String,
    /// By the number of the cell.
    pub values: Vec<f64>,
    /// Whether all are whole numbers.
    pub whole: bool,
    /// What whole numbers mean, from 0 on, where they are names.
    pub words: &'static [&'static str],
}

impl Array {
    /// Adds what a page needs of it to its streams, and says what that is. Whole numbers are kept as
    /// they are, others to one part in 65534 of their range.
    pub(super) fn put(&self, streams: &mut Streams, kept: &Kept) -> Value {
        let values = || kept.cells.iter().map(|&c| self.values[c as usize]);
        let (low, high) = (values().filter(|v| v.is_finite()))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let exact = self.whole && high - low <= f64::from(FINEST);
        let step = match exact {
            true => 1.0,
            false => ((high - low) / f64::from(FINEST)).max(f64::MIN_POSITIVE),
        };
        let words: Vec<u16> = values()
            .map(|v| match v.is_finite() {
                true => ((v - low) / step).round() as u16,
                false => NOTHING,
            })
            .collect();
        streams.add_words(&format!("array {}", self.name), &words);
        json!({
            "name": self.name,
            "unit": self.unit,
            "low": low,
            "high": high,
            "step": step,
            "whole": exact,
            "words": self.words,
        })
    }
}

/// The scalar cell arrays of a mesh, the means of its nodes' numbers over each cell, and the image in
/// the middle of each cell.
pub(super) fn of<const D: usize, M: Stored<D>>(
    stored: &StoredMesh<D, M>,
    faces: &Faces,
    image: Option<&Image<D>>,
) -> Vec<Array> {
    // Bits of faces, which the faces themselves show.
    const BITS: [&str; 3] = ["feature_faces", "feature_edges", HORIZON_FACES];
    let units = &stored.space.geometry.units;
    let count = stored.lattice.len();
    let mut arrays: Vec<Array> = Vec::new();
    let scalar = |array: &&DataArray, count: usize| {
        array.components == 1 && array.values.len() == count && !BITS.contains(&&*array.name)
    };
    for array in (stored.arrays.cell_data.iter()).filter(|a| scalar(a, count)) {
        arrays.push(Array {
            name: array.name.clone(),
            unit: unit_of(&array.name, units),
            values: array.values.to_f64(),
            whole: is_whole(&array.values),
            words: if array.name == ANGLES {
                &EXPLAINED
            } else {
                &[]
            },
        });
    }
    if let Some(regions) = stored.regions()
        && !arrays.iter().any(|array| array.name == "region")
    {
        arrays.push(Array {
            name: "region".to_string(),
            unit: String::new(),
            values: regions.into_iter().map(f64::from).collect(),
            whole: true,
            words: &[],
        });
    }
    for array in (stored.arrays.point_data.iter())
        .filter(|array| scalar(array, stored.lattice.nodes().len()) && !is_whole(&array.values))
    {
        if arrays.iter().all(|known| known.name != array.name) {
            arrays.push(Array {
                name: array.name.clone(),
                unit: unit_of(&array.name, units),
                values: means(faces, &array.values.to_f64()),
                whole: false,
                words: &[],
            });
        }
    }
    if let Some(image) = image
        && arrays.iter().all(|array| array.name != IMAGE)
    {
        let dims = image.dims();
        let at = |middle: &[f64; 3]| {
            let index = std::array::from_fn(|k| middle[k] * (dims[k] - 1) as f64);
            f64::from(image.linear(index))
        };
        arrays.push(Array {
            name: IMAGE.to_string(),
            unit: String::new(),
            values: faces.middles.iter().map(at).collect(),
            whole: false,
            words: &[],
        });
    }
    arrays
}

/// What the numbers of [`ANGLES`] mean.
const EXPLAINED: [&str; 3] = ["within bounds", "explained by features", "unexplained"];

fn is_whole(values: &Values) -> bool {
    !matches!(values, Values::F32(_) | Values::F64(_))
}

/// The mean over each cell's faces of the values of their nodes: of a simplex that of its nodes.
fn means(faces: &Faces, values: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); faces.middles.len()];
    for (face, cells) in faces.cells.iter().enumerate() {
        let ring = faces.rings.get(face);
        let sum: f64 = ring.iter().map(|&n| values[n as usize]).sum();
        for &cell in cells.iter().filter(|&&cell| cell != NONE) {
            let (all, count) = &mut sums[cell as usize];
            *all += sum;
            *count += ring.len() as f64;
        }
    }
    sums.into_iter().map(|(sum, count)| sum / count).collect()
}
