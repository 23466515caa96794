//! What cells are painted with instead of the image: an array of the mesh.

use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::store::labels::read_labels;
use crate::store::output::array_unit;
use crate::store::{MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

/// An array of a mesh, and its colours.
#[derive(Debug, Clone, PartialEq)]
pub struct Paint {
    /// What is written over the bar of colours: its name, with its unit if that is known.
    pub(super) title: String,
    /// By the number of the cell or of the node.
    values: Vec<f64>,
    is_nodal: bool,
    colors: Colors,
}

#[derive(Debug, Clone, PartialEq)]
enum Colors {
    /// From blue to red between two values.
    Scale([f64; 2]),
    /// One for each number, with what it means; those that it does not hold are not painted.
    Categories(Vec<(f64, String)>),
}

/// The regions of cells; 0 where there is none.
const REGION: &str = "region";

/// From low values to high ones.
const SCALE_COLORS: [[f64; 3]; 7] = [
    [49.0, 54.0, 149.0],
    [90.0, 150.0, 200.0],
    [171.0, 217.0, 233.0],
    [253.0, 250.0, 190.0],
    [253.0, 174.0, 97.0],
    [230.0, 90.0, 60.0],
    [165.0, 0.0, 38.0],
];

/// Of things that are told apart by number; the first are none of the colours of amplitudes.
pub(super) const CATEGORY_COLORS: [[u8; 3]; 10] = [
    [95, 185, 180],
    [232, 157, 72],
    [86, 152, 205],
    [201, 92, 96],
    [148, 120, 190],
    [160, 125, 95],
    [222, 150, 190],
    [104, 178, 120],
    [190, 185, 80],
    [130, 140, 150],
];

impl Paint {
    /// Of an array of cells or, if there is none of that name, of nodes; of vectors their lengths.
    ///
    /// # Errors
    /// [`Error::Job`] if there is no such array; `place` names the file.
    pub fn from_array<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        name: &str,
        place: &str,
    ) -> Result<Self> {
        let arrays = &stored.arrays;
        let named = |arrays: &[DataArray]| arrays.iter().find(|a| a.name == name).map(magnitudes);
        let regions = || match stored.regions() {
            Some(regions) if name == REGION => {
                Some((regions.into_iter().map(f64::from).collect(), true))
            }
            _ => None,
        };
        let of_cells = named(&arrays.cell_data).or_else(regions);
        let of_nodes = of_cells.is_none();
        let Some((values, whole)) = of_cells.or_else(|| named(&arrays.point_data)) else {
            return Err(missing_array_error(stored, name, place));
        };
        let unit = match name {
            "pressure" if is_flow_result(arrays) => "Pa".to_string(),
            "velocity" if is_flow_result(arrays) => "m/s".to_string(),
            _ => array_unit(name, &stored.space.geometry.units),
        };
        let title = match unit.as_str() {
            "" => name.to_string(),
            unit => format!("{name} [{unit}]"),
        };
        let kinds = whole.then(|| categories(stored, name, &values)).flatten();
        let colors = kinds.map_or_else(
            || Colors::Scale(percentile_range(&values)),
            Colors::Categories,
        );
        Ok(Self {
            title,
            values,
            is_nodal: of_nodes,
            colors,
        })
    }

    /// The value at a node of a cell.
    pub(super) fn value(&self, cell: u32, node: u32) -> f64 {
        self.values[if self.is_nodal { node } else { cell } as usize]
    }

    /// The colour of a value; `None` if it is not painted.
    pub(super) fn color(&self, value: f64) -> Option<[u8; 3]> {
        match &self.colors {
            Colors::Categories(kinds) => {
                let at = kinds.iter().position(|(kind, _)| *kind == value)?;
                Some(CATEGORY_COLORS[at % CATEGORY_COLORS.len()])
            }
            Colors::Scale(_) if value.is_nan() => None,
            Colors::Scale([low, high]) => {
                let last = (SCALE_COLORS.len() - 1) as f64;
                let t = last * ((value - low) / (high - low)).clamp(0.0, 1.0);
                let at = (t as usize).min(SCALE_COLORS.len() - 2);
                let share = t - at as f64;
                Some(std::array::from_fn(|k| {
                    (SCALE_COLORS[at][k] + share * (SCALE_COLORS[at + 1][k] - SCALE_COLORS[at][k]))
                        as u8
                }))
            }
        }
    }

    /// The values with the first and the last colour of a bar; `None` of what is told apart by number.
    pub(super) fn range(&self) -> Option<[f64; 2]> {
        match self.colors {
            Colors::Scale(range) => Some(range),
            Colors::Categories(_) => None,
        }
    }

    /// What each colour means, where there is no bar.
    pub(super) fn legend(&self) -> Vec<(String, [u8; 3])> {
        let kinds: &[(f64, String)] = match &self.colors {
            Colors::Categories(kinds) => kinds,
            Colors::Scale(_) => &[],
        };
        let color = |(value, name): &(f64, String)| Some((name.clone(), self.color(*value)?));
        kinds.iter().filter_map(color).collect()
    }
}

/// Whether a mesh comes from `flow`, as its velocity says: of any other a pressure may be in bar.
fn is_flow_result(arrays: &MeshFile<()>) -> bool {
    arrays.cell_array("velocity").is_some()
}

/// Numbers, or the lengths of vectors; and whether they are whole numbers.
fn magnitudes(array: &DataArray) -> (Vec<f64>, bool) {
    let numbers = array.values.to_f64();
    let whole = !matches!(array.values, Values::F32(_) | Values::F64(_));
    if array.components <= 1 {
        return (numbers, whole);
    }
    let length = |tuple: &[f64]| tuple.iter().map(|c| c * c).sum::<f64>().sqrt();
    (
        numbers.chunks(array.components).map(length).collect(),
        false,
    )
}

/// From the 2nd to the 98th of a hundred values: the extremes at wells and the like would leave no
/// colours for the rest.
fn percentile_range(values: &[f64]) -> [f64; 2] {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let rank = |share: f64| {
        let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(at).copied().unwrap_or(0.0)
    };
    let (inner, outer) = ([rank(0.02), rank(0.98)], [rank(0.0), rank(1.0)]);
    match [inner, outer].into_iter().find(|[low, high]| low < high) {
        Some(range) => range,
        None => [outer[0], outer[0] + 1.0_f64.max(outer[0].abs())],
    }
}

/// Whole numbers and what they mean: regions, and other numbers if there are no more than colours.
fn categories<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    name: &str,
    values: &[f64],
) -> Option<Vec<(f64, String)>> {
    let mut kinds = values.to_vec();
    kinds.sort_unstable_by(f64::total_cmp);
    kinds.dedup();
    let regions = name == REGION;
    if !regions && kinds.len() > CATEGORY_COLORS.len() {
        return None;
    }
    let labels = read_labels(&stored.arrays);
    let named = |value: f64| {
        let label = labels.iter().filter(|_| regions);
        let mut label = label.filter(|label| f64::from(label.region) == value);
        label.find_map(|label| label.name.clone())
    };
    // Cells without a region are not painted.
    let painted = kinds.into_iter().filter(|v| *v != 0.0 || !regions);
    Some(
        painted
            .map(|value| {
                (
                    value,
                    named(value).unwrap_or_else(|| format!("{name} {value}")),
                )
            })
            .collect(),
    )
}

fn missing_array_error<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    name: &str,
    place: &str,
) -> Error {
    let arrays = &stored.arrays;
    let both = arrays.cell_data.iter().chain(&arrays.point_data);
    let mut names: Vec<&str> = both.map(|array| array.name.as_str()).collect();
    if stored.regions().is_some() {
        names.push(REGION);
    }
    names.sort_unstable();
    names.dedup();
    let remedy = match names.is_empty() {
        true => "omit it".to_string(),
        false => format!("give one of {}", names.join(", ")),
    };
    let problem = format!("is no array of {place}");
    Error::Job(cause(format!("--color {name}"), problem, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paint(values: Vec<f64>, colors: Colors) -> Paint {
        Paint {
            title: String::new(),
            values,
            is_nodal: false,
            colors,
        }
    }

    #[test]
    fn a_few_extremes_leave_colours_for_the_rest() {
        let mut values: Vec<f64> = (0..=100).map(f64::from).collect();
        values[100] = 1e9;
        assert_eq!(percentile_range(&values), [2.0, 98.0]);
        // One value in a hundred: all of them count.
        let mut rare = vec![0.0; 200];
        rare[7] = 3.0;
        assert_eq!(percentile_range(&rare), [0.0, 3.0]);
        let [low, high] = percentile_range(&[f64::NAN, 5.0, 5.0]);
        assert!(low == 5.0 && high > low);
    }

    #[test]
    fn low_is_blue_and_high_is_red() {
        let scale = paint(vec![0.0, 10.0], Colors::Scale([0.0, 10.0]));
        let [low, high] = [-5.0, 15.0].map(|v| scale.color(v).unwrap());
        assert!(
            low[2] > low[0] + 50 && high[0] > high[2] + 50,
            "{low:?} {high:?}"
        );
        assert_eq!(scale.color(f64::NAN), None);
        let kinds = vec![(1.0, "sand".to_string()), (4.0, "silt".to_string())];
        let kinds = paint(vec![0.0, 1.0, 4.0], Colors::Categories(kinds));
        assert_eq!(kinds.color(0.0), None);
        assert_ne!(kinds.color(1.0), kinds.color(4.0));
        assert_eq!(kinds.legend()[1].0, "silt");
    }
}
