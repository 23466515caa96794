//! Colours of cells by an array of the mesh, instead of by the image.

use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::geometry::statistics::nearest_quantile;
use crate::mesh_file::array_names::array_unit;
use crate::mesh_file::read_labels;
use crate::store::read_named_regions;
use crate::store::{MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

/// An array of a mesh, and its colours.
#[derive(Debug, Clone, PartialEq)]
pub struct Paint {
    /// Title of the colour bar: name of the array, with its unit if that is known.
    pub(super) title: String,
    /// Values by cell number, or by node number if `is_nodal`.
    values: Vec<f64>,
    is_nodal: bool,
    colors: Colors,
}

#[derive(Debug, Clone, PartialEq)]
enum Colors {
    /// A continuous scale from blue to red between two values.
    Scale([f64; 2]),
    /// One colour for each of these values, with its name in the legend. Other values are not
    /// painted.
    Categories(Vec<(f64, String)>),
}

/// Name of the array of regions; region 0 means no region.
const REGION: &str = "region";

/// Colours of the scale, from low to high values.
const SCALE_COLORS: [[f64; 3]; 7] = [
    [49.0, 54.0, 149.0],
    [90.0, 150.0, 200.0],
    [171.0, 217.0, 233.0],
    [253.0, 250.0, 190.0],
    [253.0, 174.0, 97.0],
    [230.0, 90.0, 60.0],
    [165.0, 0.0, 38.0],
];

/// Colours of categories. The first ones differ from the colours of seismic amplitudes.
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
    /// Creates the paint of the cell array `name` or, if there is none, of the node array of this
    /// name. Of vectors, the lengths are painted.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is no such array; `place` names the file.
    pub fn from_array<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        name: &str,
        place: &str,
    ) -> Result<Self> {
        let arrays = &stored.arrays;
        let find_array =
            |arrays: &[DataArray]| arrays.iter().find(|a| a.name == name).map(magnitudes);
        let regions = || match stored.regions() {
            Some(regions) if name == REGION => {
                Some((regions.into_iter().map(f64::from).collect(), true))
            }
            _ => None,
        };
        let cell_values = find_array(&arrays.cell_data).or_else(regions);
        let is_nodal = cell_values.is_none();
        let Some((values, is_integer)) = cell_values.or_else(|| find_array(&arrays.point_data))
        else {
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
        let entries = is_integer
            .then(|| categories(stored, name, &values))
            .flatten();
        let colors = entries.map_or_else(
            || Colors::Scale(percentile_range(&values)),
            Colors::Categories,
        );
        Ok(Self {
            title,
            values,
            is_nodal,
            colors,
        })
    }

    /// Returns the value of a cell at a node.
    pub(super) fn value(&self, cell: u32, node: u32) -> f64 {
        self.values[if self.is_nodal { node } else { cell } as usize]
    }

    /// Returns the colour of a value, or `None` if it is not painted.
    pub(super) fn color(&self, value: f64) -> Option<[u8; 3]> {
        match &self.colors {
            Colors::Categories(entries) => {
                let index = entries.iter().position(|(kind, _)| *kind == value)?;
                Some(CATEGORY_COLORS[index % CATEGORY_COLORS.len()])
            }
            Colors::Scale(_) if value.is_nan() => None,
            Colors::Scale([low, high]) => {
                let last = (SCALE_COLORS.len() - 1) as f64;
                let t = last * ((value - low) / (high - low)).clamp(0.0, 1.0);
                let index = (t as usize).min(SCALE_COLORS.len() - 2);
                let fraction = t - index as f64;
                Some(std::array::from_fn(|k| {
                    (SCALE_COLORS[index][k]
                        + fraction * (SCALE_COLORS[index + 1][k] - SCALE_COLORS[index][k]))
                        as u8
                }))
            }
        }
    }

    /// Returns the values of the first and the last colour of the colour bar, or `None` for
    /// categories.
    pub(super) fn range(&self) -> Option<[f64; 2]> {
        match self.colors {
            Colors::Scale(range) => Some(range),
            Colors::Categories(_) => None,
        }
    }

    /// Returns the names and colours of categories; empty if there is a colour bar instead.
    pub(super) fn legend(&self) -> Vec<(String, [u8; 3])> {
        let entries: &[(f64, String)] = match &self.colors {
            Colors::Categories(entries) => entries,
            Colors::Scale(_) => &[],
        };
        let color = |(value, name): &(f64, String)| Some((name.clone(), self.color(*value)?));
        entries.iter().filter_map(color).collect()
    }
}

/// Returns `true` if a mesh comes from the command `flow`, which writes a velocity. In other meshes
/// a pressure may be in bar.
fn is_flow_result(arrays: &MeshFile<()>) -> bool {
    arrays.cell_array("velocity").is_some()
}

/// Returns the values of an array, or the lengths of its vectors, and `true` if they are integers.
fn magnitudes(array: &DataArray) -> (Vec<f64>, bool) {
    let numbers = array.values.to_f64();
    let is_integer = !matches!(array.values, Values::F32(_) | Values::F64(_));
    if array.components <= 1 {
        return (numbers, is_integer);
    }
    let length = |tuple: &[f64]| tuple.iter().map(|c| c * c).sum::<f64>().sqrt();
    (
        numbers.chunks(array.components).map(length).collect(),
        false,
    )
}

/// Returns the range from the 2nd to the 98th percentile. Extremes, e.g. at wells, would leave
/// hardly any colours for the other values.
fn percentile_range(values: &[f64]) -> [f64; 2] {
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let mut quantile = |share: f64| nearest_quantile(&mut finite, share).unwrap_or(0.0);
    let (inner, outer) = (
        [quantile(0.02), quantile(0.98)],
        [quantile(0.0), quantile(1.0)],
    );
    match [inner, outer].into_iter().find(|[low, high]| low < high) {
        Some(range) => range,
        None => [outer[0], outer[0] + 1.0_f64.max(outer[0].abs())],
    }
}

/// Returns the distinct integer values with their names: always for regions, and for other arrays
/// if there are no more values than colours.
fn categories<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    name: &str,
    values: &[f64],
) -> Option<Vec<(f64, String)>> {
    let mut distinct = values.to_vec();
    distinct.sort_unstable_by(f64::total_cmp);
    distinct.dedup();
    let is_region = name == REGION;
    if !is_region && distinct.len() > CATEGORY_COLORS.len() {
        return None;
    }
    let labels = read_labels(&stored.arrays);
    let named_regions = read_named_regions(&stored.arrays);
    let region_name = |value: f64| {
        let label = labels.iter().filter(|_| is_region);
        let mut label = label.filter(|label| f64::from(label.region) == value);
        let named = named_regions.iter().filter(|_| is_region);
        let mut named = named.filter(|named| f64::from(named.region) == value);
        let name = label.find_map(|label| label.name.clone());
        name.or_else(|| named.next().map(|named| named.name.clone()))
    };
    // Cells without a region are not painted.
    let painted = distinct.into_iter().filter(|v| *v != 0.0 || !is_region);
    Some(
        painted
            .map(|value| {
                (
                    value,
                    region_name(value).unwrap_or_else(|| format!("{name} {value}")),
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
    let all_arrays = arrays.cell_data.iter().chain(&arrays.point_data);
    let mut names: Vec<&str> = all_arrays.map(|array| array.name.as_str()).collect();
    if stored.regions().is_some() {
        names.push(REGION);
    }
    names.sort_unstable();
    names.dedup();
    let remedy = if names.is_empty() {
        "omit it".to_string()
    } else {
        format!("give one of {}", names.join(", "))
    };
    let problem = format!("is not an array of {place}");
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
    fn a_few_extremes_leave_colors_for_the_rest() {
        let mut values: Vec<f64> = (0..=100).map(f64::from).collect();
        values[100] = 1e9;
        assert_eq!(percentile_range(&values), [2.0, 98.0]);
        // If only one value in 200 differs, the full range is used.
        let mut rare = vec![0.0; 200];
        rare[7] = 3.0;
        assert_eq!(percentile_range(&rare), [0.0, 3.0]);
        let [low, high] = percentile_range(&[f64::NAN, 5.0, 5.0]);
        assert!(low == 5.0 && high > low);
    }

    #[test]
    fn low_is_blue_and_high_is_red() {
        let bar = paint(vec![0.0, 10.0], Colors::Scale([0.0, 10.0]));
        let [low, high] = [-5.0, 15.0].map(|v| bar.color(v).unwrap());
        assert!(
            low[2] > low[0] + 50 && high[0] > high[2] + 50,
            "{low:?} {high:?}"
        );
        assert_eq!(bar.color(f64::NAN), None);
        let categories = vec![(1.0, "sand".to_string()), (4.0, "silt".to_string())];
        let categories = paint(vec![0.0, 1.0, 4.0], Colors::Categories(categories));
        assert_eq!(categories.color(0.0), None);
        assert_ne!(categories.color(1.0), categories.color(4.0));
        assert_eq!(categories.legend()[1].0, "silt");
    }
}
