//! Geometry of VTK's rectilinear and structured grids that are images: their points are evenly spaced.

use crate::error::Result;
use crate::files::vtk::xml::Element;
use crate::files::vtk::{DataArray, VtkFile};
use crate::geometry::{norm, sub};
use crate::image::Geometry;

/// Largest distance of a point from its place in an evenly spaced grid, in steps.
const MAX_UNEVENNESS: f64 = 1e-3;

/// Largest such distance, in steps, if coordinates in single precision are rounded by as much.
const MAX_ROUNDING: f64 = 0.1;

/// Remedy for grids that are no images.
const RESAMPLE: &str =
    "resample it evenly, such as with Resample To Image in ParaView, and write .vti";

/// Returns the geometry of a rectilinear grid with `dims` points.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if an axis is not evenly spaced, or damaged.
pub(super) fn rectilinear(
    file: &VtkFile,
    piece: &Element,
    dims: [usize; 3],
) -> Result<Geometry<3>> {
    let coordinates = file.child(piece, "Coordinates")?;
    let is_array = |element: &&Element| element.name == "DataArray";
    let mut arrays = coordinates.children.iter().filter(is_array);
    let mut geometry = Geometry::default();
    for k in 0..3 {
        let axis = ["x", "y", "z"][k];
        let array = match arrays.next() {
            Some(element) => file.array(element)?,
            None => {
                let problem = format!("has no coordinates along {axis}");
                return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
            }
        };
        let values = array.values.to_f64();
        let is_finite = values.iter().all(|x| x.is_finite());
        if values.is_empty() || values.len() != dims[k] || !is_finite {
            let problem = format!(
                "has {} coordinates along {axis} for {} points",
                values.len(),
                dims[k]
            );
            return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
        }
        geometry.origin[k] = values[0];
        if values.len() == 1 {
            continue;
        }
        let step = (values[values.len() - 1] - values[0]) / (values.len() - 1) as f64;
        let place = |i: usize| values[0] + i as f64 * step;
        let unevenness = (0..values.len()).map(|i| (values[i] - place(i)).abs());
        let unevenness = unevenness.fold(0.0, f64::max);
        let limit = step.abs() * tolerance(&array, &values, step.abs());
        if step == 0.0 || unevenness > limit {
            let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
            let (low, high) = steps.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| {
                (low.min(s), high.max(s))
            });
            let problem =
                format!("is not evenly spaced along {axis}: its steps are from {low} to {high}");
            return Err(file.error(problem, RESAMPLE));
        }
        geometry.axes[k][k] = step;
    }
    Ok(geometry)
}

/// Returns the unevenness, in steps, that is rounding of coordinates in this array.
fn tolerance(array: &DataArray, values: &[f64], step: f64) -> f64 {
    if array.values.type_name() != "Float32" {
        return MAX_UNEVENNESS;
    }
    let largest = values.iter().fold(0.0f64, |max, x| max.max(x.abs()));
    let rounding = largest * f64::from(f32::EPSILON) / step;
    rounding.clamp(MAX_UNEVENNESS, MAX_ROUNDING)
}

/// Returns the geometry of a structured grid with `dims` points, which must lie on an affine grid.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if its points are not evenly spaced along straight
/// axes, or if it is damaged.
pub(super) fn structured(file: &VtkFile, piece: &Element, dims: [usize; 3]) -> Result<Geometry<3>> {
    let points = file.child(piece, "Points")?;
    let element = file.child(points, "DataArray")?;
    let array = file.array(element)?;
    let values = array.values.to_f64();
    let points = values.as_chunks::<3>().0;
    let strides = [1, dims[0], dims[0].saturating_mul(dims[1])];
    let count = strides[2].saturating_mul(dims[2]);
    if array.components != 3 || points.len() != count || count == 0 {
        let problem = format!("has {} points for {count}", points.len());
        return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
    }
    let mut geometry = Geometry {
        origin: points[0],
        ..Geometry::default()
    };
    let mut step = f64::INFINITY;
    let mut flat_axes = Vec::new();
    for k in 0..3 {
        if dims[k] == 1 {
            flat_axes.push(k);
            continue;
        }
        let last = (dims[k] - 1) as f64;
        let end = points[(dims[k] - 1) * strides[k]];
        geometry.axes[k] = sub(end, points[0]).map(|x| x / last);
        step = step.min(norm(geometry.axes[k]));
    }
    if let [flat] = flat_axes[..] {
        let [a, b] = [1, 2].map(|next| geometry.axes[(flat + next) % 3]);
        geometry.axes[flat] = crate::geometry::unit(crate::geometry::cross(a, b));
    }
    let limit = step * tolerance(&array, &values, step);
    let at = |i: usize| [i % dims[0], i / strides[1] % dims[1], i / strides[2]];
    let is_off = |(i, point): (usize, &[f64; 3])| {
        let place = geometry.to_physical(at(i).map(|index| index as f64));
        let distance = norm(sub(*point, place));
        distance.is_nan() || distance > limit
    };
    if let Some(first) = points.iter().enumerate().position(is_off) {
        let problem = format!(
            "is not evenly spaced along straight axes: point {:?} is not at its place",
            at(first)
        );
        return Err(file.error(problem, RESAMPLE));
    }
    if geometry.determinant() == 0.0 {
        return Err(file.error("has axes that are linearly dependent", RESAMPLE));
    }
    Ok(geometry)
}
