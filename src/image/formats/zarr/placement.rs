//! Geometry of an array, from the attributes that `convert` writes, or from the coordinate arrays
//! next to it, as xarray and MDIO store them.
//!
//! A coordinate is an array with the name of an axis that holds one number per index along the
//! axis. In a survey `cdp_x` and `cdp_y` hold the positions of traces, and `trace_mask` marks the
//! traces that exist.

use crate::geometry::hypot;
use std::path::Path;

use serde_json::Value;

use super::metadata::{self, ArrayMetadata, ZarrNode};
use super::ome::LevelMetadata;
use super::trace_headers;
use crate::error::Result;
use crate::geometry::sorted_distinct;
use crate::image::Geometry;
use crate::image::formats::AxisSpec;
use crate::image::formats::placement::NO_GEOMETRY_NOTE;
use crate::image::formats::segy::{LineNumbers, SurveyFit};
use crate::image::formats::stream::ImageHeader;

/// Name of the array that marks the traces that exist.
pub const TRACE_MASK: &str = "trace_mask";

/// Names of the arrays of trace positions.
pub const POSITION_NAMES: [&str; 2] = ["cdp_x", "cdp_y"];

/// Name of the attribute in which `convert` stores the geometry.
pub const GEOMETRY_ATTRIBUTE: &str = "atomesh";

/// Largest deviation of coordinates from even spacing, relative to the step.
const MAX_STEP_DEVIATION: f64 = 1e-3;

/// Evenly spaced numbers along an axis.
struct EvenCoordinate {
    first: f64,
    step: f64,
    unit: String,
}

impl EvenCoordinate {
    /// Returns the numbers as line numbers, or `None` if they are not whole numbers.
    fn line_numbers(&self, count: usize) -> Option<LineNumbers> {
        let [first, step] = [self.first, self.step].map(f64::round);
        let is_integral = (first - self.first).abs() < 1e-6 && (step - self.step).abs() < 1e-6;
        (is_integral && step >= 1.0 && first.abs() < 1e15 && step < 1e15).then_some(LineNumbers {
            first: first as i64,
            step: step as i64,
            count: count as u64,
        })
    }
}

/// The arrays in the same group as an array.
struct SiblingArrays<'a> {
    group: Option<&'a Path>,
}

impl SiblingArrays<'_> {
    /// Returns the array with this name and shape, or `None` if it does not exist or cannot be
    /// parsed.
    fn array(&self, name: &str, shape: &[usize]) -> Option<ArrayMetadata> {
        // Names of axes must not be paths.
        let is_plain_name = !name.is_empty() && !name.contains(['/', '\\']) && name != "..";
        let folder = self.group.filter(|_| is_plain_name)?.join(name);
        if !metadata::is_node(&folder) {
            return None;
        }
        match ZarrNode::open(&folder).ok()? {
            ZarrNode::Array(array) if array.shape == shape => Some(*array),
            _ => None,
        }
    }

    /// Returns the coordinate of an axis, or `None` if there is none or it is not evenly spaced. `trace`
    /// is the index of a trace along the axes of a survey if the axis is its vertical one.
    fn even_coordinate(
        &self,
        name: &str,
        count: usize,
        trace: Option<&[usize]>,
        notes: &mut Vec<String>,
    ) -> Result<Option<EvenCoordinate>> {
        let Some(array) = self.array(name, &[count]) else {
            return Ok(None);
        };
        let values = array.read_all()?;
        if let Some(even) = self.by_trace_header(name, &values, array_unit(&array), trace, notes)? {
            return Ok(Some(even));
        }
        let (first, last) = (values[0], values[count - 1]);
        let step = match count {
            1 => 1.0,
            _ => (last - first) / (count - 1) as f64,
        };
        let is_even = |(i, v): (usize, &f64)| {
            (v - first - i as f64 * step).abs() <= MAX_STEP_DEVIATION * step.abs()
        };
        let unit = array_unit(&array);
        if step == 0.0 || !step.is_finite() || !values.iter().enumerate().all(is_even) {
            let Some([first, step]) = step_of_truncated(&values) else {
                notes.push(format!(
                    "the coordinate {name} is not evenly spaced: not used"
                ));
                return Ok(None);
            };
            notes.push(format!(
                "the coordinate {name} has whole numbers that are not evenly spaced, as if cut off after the point: \
                 taken as {step} apart from {first} (--interval, --spacing and --origin set others)"
            ));
            return Ok(Some(EvenCoordinate { first, step, unit }));
        }
        Ok(Some(EvenCoordinate { first, step, unit }))
    }
}

impl SiblingArrays<'_> {
    /// Returns the coordinate of the vertical axis by the trace headers of MDIO, which give it exactly, or
    /// `None` if there are none, or if the numbers of the axis are of another interval.
    fn by_trace_header(
        &self,
        name: &str,
        numbers: &[f64],
        unit: String,
        trace: Option<&[usize]>,
        notes: &mut Vec<String>,
    ) -> Result<Option<EvenCoordinate>> {
        let (Some(group), Some(trace)) = (self.group, trace) else {
            return Ok(None);
        };
        let sampling = trace_headers::vertical_sampling(group, trace)?;
        let Some(sampling) = sampling.filter(|sampling| sampling.fits(numbers)) else {
            return Ok(None);
        };
        let (first, step) = (sampling.first, sampling.step(name));
        let is_cut_off = numbers.get(1).is_some_and(|number| *number != step);
        if is_cut_off || first != 0.0 {
            notes.push(format!(
                "the coordinate {name} is that of the trace headers, {step} apart from {first}: the axis holds whole \
                 numbers from 0"
            ));
        }
        Ok(Some(EvenCoordinate { first, step, unit }))
    }
}

/// Steps of samples are multiples of one of these, the first one preferred.
const STEP_PARTS: [f64; 6] = [0.5, 0.25, 0.2, 0.125, 0.1, 0.05];

/// Returns the first value and the step of evenly spaced values of which only the whole numbers are
/// stored, as MDIO does with times; `None` if there is no step that fits all, or several do.
fn step_of_truncated(values: &[f64]) -> Option<[f64; 2]> {
    let (first, last) = (*values.first()?, *values.last()?);
    let is_whole = values.iter().all(|v| v.fract() == 0.0 && v.abs() < 1e9);
    let steps = (values.len() as f64 - 1.0).max(1.0);
    let range = [(last - first - 1.0) / steps, (last - first + 1.0) / steps];
    // The first value may have been cut off, too, but times begin with whole numbers.
    let fits = |step: f64| {
        let value = |i: usize| first + i as f64 * step;
        let mut indexed = values.iter().enumerate();
        indexed.all(|(i, v)| (value(i) + 1e-9).floor() == *v || (value(i) + 1e-9).trunc() == *v)
    };
    let of_part = |part: &f64| {
        let multiples = (range[0] / part).ceil() as i64..=(range[1] / part).floor() as i64;
        let mut fitting = multiples
            .map(|n| n as f64 * part)
            .filter(|step| fits(*step));
        let step = fitting.next().filter(|step| *step != 0.0)?;
        fitting.next().is_none().then_some(step)
    };
    let step = STEP_PARTS.iter().find_map(of_part).filter(|_| is_whole)?;
    Some([first, step])
}

/// Returns the unit of the numbers of an array, as MDIO or xarray store it.
fn array_unit(array: &ArrayMetadata) -> String {
    let word = |value: &Value| value.as_str().map(String::from);
    let mdio = array.attributes.get("unitsV1").and_then(|units| {
        let mut values = units.as_object()?.values();
        values.find_map(word)
    });
    let xarray_unit = || array.attributes.get("units").and_then(word);
    mdio.or_else(xarray_unit).unwrap_or_default()
}

/// Names the axes of an image as OME-Zarr does, or else as the array does.
fn name_axes(header: &mut ImageHeader<3>, array: &ArrayMetadata, level: Option<&LevelMetadata>) {
    let names = match level {
        Some(level) => level.axis_names(&array.image_axes),
        None => {
            let names = array.image_axes.iter();
            names.map(|&axis| array.axis_names[axis].clone()).collect()
        }
    };
    for (k, name) in names.iter().rev().enumerate() {
        if !name.is_empty() {
            header.geometry.names[k].clone_from(name);
        }
    }
}

/// Sets the geometry of an image from the metadata of the array, its group, and OME-Zarr (`level`).
///
/// # Errors
/// Returns a [`crate::Error::Io`] if chunks of the coordinates cannot be read.
pub fn place(
    header: &mut ImageHeader<3>,
    array: &ArrayMetadata,
    group: Option<&Path>,
    level: Option<&LevelMetadata>,
) -> Result<()> {
    let siblings = SiblingArrays { group };
    let axes = array.image_axes.len();
    name_axes(header, array, level);
    let rows = [header.dims[2], header.dims[1]];
    let shape = if axes < 3 { &rows[1..] } else { &rows[..] };
    if let Some(mask) = siblings.array(TRACE_MASK, shape) {
        let missing: Vec<bool> = mask.read_all()?.iter().map(|live| *live == 0.0).collect();
        let count = missing.iter().filter(|missing| **missing).count();
        if count > 0 {
            header.notes.push(format!(
                "{count} of the {} places on the survey's grid have no trace: they are filled with zeros",
                missing.len()
            ));
            header.missing = missing;
        }
    }
    // The first trace that exists.
    let first_live = header.missing.iter().position(|missing| !missing);
    let first_live = first_live.unwrap_or(0);
    let trace = match axes {
        3 => vec![first_live / header.dims[1], first_live % header.dims[1]],
        _ => vec![first_live],
    };
    let mut coordinates: [Option<EvenCoordinate>; 3] = [None, None, None];
    for (k, coordinate) in coordinates.iter_mut().enumerate().take(axes) {
        let (name, count) = (&header.geometry.names[k], header.dims[k]);
        let trace = Some(&*trace).filter(|_| k == 0);
        *coordinate = siblings.even_coordinate(name, count, trace, &mut header.notes)?;
    }
    let is_survey = header.geometry.names[1..] == ["crossline", "inline"];
    if is_survey {
        let numbers = |k: usize| coordinates[k].as_ref()?.line_numbers(header.dims[k]);
        header.line_numbers = numbers(2).zip(numbers(1)).map(|(i, c)| [i, c]);
    }
    if let Some(geometry) = array
        .attributes
        .get(GEOMETRY_ATTRIBUTE)
        .and_then(|stored| stored_geometry(stored, header))
    {
        header.geometry = geometry;
        return Ok(());
    }
    if let Some(positions) = trace_positions(&siblings, shape)? {
        let (values, unit) = positions;
        if place_by_traces(header, &values, &unit, &coordinates[0], is_survey) {
            return Ok(());
        }
    }
    if coordinates.iter().all(Option::is_none) {
        match level.and_then(|level| level.geometry(&array.image_axes)) {
            Some(geometry) => {
                header.geometry = geometry;
                let note = "spacing and unit from OME-Zarr metadata";
                header.notes.push(note.into());
            }
            None => {
                // The names alone say along which coordinates the axes run.
                place_along_axes(header, &coordinates);
                header.notes.push(format!("the array {NO_GEOMETRY_NOTE}"));
            }
        }
        return Ok(());
    }
    if let (true, Some([inlines, crosslines])) = (is_survey, header.line_numbers) {
        let note = "there are no usable X, Y: horizontal coordinates are inline and crossline numbers, not metres";
        header.notes.push(note.into());
        let [first, step] = [
            [inlines.first, crosslines.first].map(|n| n as f64),
            [inlines.step, crosslines.step].map(|n| n as f64),
        ];
        let [inline, crossline] = [[step[0], 0.0], [0.0, step[1]]];
        place_upright(header, first, inline, crossline, "line", &coordinates[0]);
        return Ok(());
    }
    place_along_axes(header, &coordinates);
    Ok(())
}

/// Returns the geometry that `convert` has written, or `None` if it is invalid.
fn stored_geometry(stored: &Value, header: &ImageHeader<3>) -> Option<Geometry<3>> {
    let vector = |value: &Value| -> Option<[f64; 3]> {
        let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
        numbers?.try_into().ok()
    };
    let strings = |value: &Value| -> Option<[String; 3]> {
        let texts: Option<Vec<String>> = (value.as_array()?.iter())
            .map(|word| word.as_str().map(String::from))
            .collect();
        texts?.try_into().ok()
    };
    let axes: Option<Vec<[f64; 3]>> = stored["axes"].as_array()?.iter().map(vector).collect();
    Some(Geometry {
        origin: vector(&stored["origin"])?,
        axes: axes?.try_into().ok()?,
        names: strings(&stored["names"]).unwrap_or_else(|| header.geometry.names.clone()),
        units: strings(&stored["units"])?,
    })
}

/// Returns the positions of the traces and their unit.
fn trace_positions(
    siblings: &SiblingArrays<'_>,
    shape: &[usize],
) -> Result<Option<(Vec<[f64; 2]>, String)>> {
    let [Some(x), Some(y)] = POSITION_NAMES.map(|name| siblings.array(name, shape)) else {
        return Ok(None);
    };
    let pairs = x
        .read_all()?
        .into_iter()
        .zip(y.read_all()?)
        .map(|(x, y)| [x, y]);
    Ok(Some((pairs.collect(), array_unit(&x))))
}

/// Places a survey or a line by the positions of its traces. Returns `false` if they cannot be
/// used.
fn place_by_traces(
    header: &mut ImageHeader<3>,
    positions: &[[f64; 2]],
    unit: &str,
    vertical: &Option<EvenCoordinate>,
    is_survey: bool,
) -> bool {
    let crosslines = header.dims[1];
    let is_known = |t: &usize| {
        positions[*t].iter().all(|c| c.is_finite()) && !header.missing.get(*t).unwrap_or(&false)
    };
    let known: Vec<usize> = (0..positions.len()).filter(is_known).collect();
    let known_positions: Vec<[f64; 2]> = known.iter().map(|&t| positions[t]).collect();
    if is_survey {
        let cells: Vec<_> = known
            .iter()
            .map(|t| [t / crosslines, t % crosslines])
            .collect();
        let [x, y] = POSITION_NAMES;
        return match SurveyFit::from_positions(&cells, &known_positions) {
            Ok(fit) => {
                header.notes.push(format!(
                    "placed by {x} and {y}: a regular grid with inlines {:.3} and crosslines {:.3} apart fits them to {:.3} \
                     (rms), {:.3} at most",
                    fit.line_spacing()[0],
                        fit.line_spacing()[1],
                        fit.rms,
                        fit.max
                ));
                place_upright(
                    header,
                    fit.origin,
                    fit.inline,
                    fit.crossline,
                    unit,
                    vertical,
                );
                true
            }
            Err(reason) => {
                header
                    .notes
                    .push(format!("{x} and {y} are not used: they {reason}"));
                false
            }
        };
    }
    let length: f64 = (known_positions.windows(2))
        .map(|p| hypot(p[1][0] - p[0][0], p[1][1] - p[0][1]))
        .sum();
    let steps = match (known.first(), known.last()) {
        (Some(first), Some(last)) if last > first && header.dims[2] == 1 => last - first,
        _ => return false,
    };
    let pitch = length / steps as f64;
    if !(pitch > 0.0 && pitch.is_finite()) {
        return false;
    }
    header.notes.push(format!(
        "a 2-D line: {} traces over {length:.1}, {pitch:.3} apart",
        known.len()
    ));
    place_upright(header, [0.0; 2], [0.0, pitch], [pitch, 0.0], unit, vertical);
    true
}

/// Sets a geometry in which the first image axis points down from its first number and the other
/// axes are horizontal.
fn place_upright(
    header: &mut ImageHeader<3>,
    first: [f64; 2],
    inline: [f64; 2],
    crossline: [f64; 2],
    unit: &str,
    vertical: &Option<EvenCoordinate>,
) {
    let name = header.geometry.names[0].clone();
    let (top, step, vertical_unit) = match vertical {
        Some(even) => (even.first, even.step, even.unit.clone()),
        None => (0.0, 1.0, "sample".to_string()),
    };
    let vertical_unit = match (&*vertical_unit, &*name) {
        ("", "time" | "twt") => {
            let note = format!("the coordinate {name} has no unit: taken as ms");
            header.notes.push(note);
            "ms".to_string()
        }
        _ => vertical_unit,
    };
    header.geometry.origin = [first[0], first[1], 0.0 - top];
    header.geometry.axes = [
        [0.0, 0.0, -step],
        [crossline[0], crossline[1], 0.0],
        [inline[0], inline[1], 0.0],
    ];
    header.geometry.units = [unit.to_string(), unit.to_string(), vertical_unit];
}

/// Sets a geometry whose axes run along the coordinates that they are named after, or along the
/// coordinates in order if the names do not define them.
fn place_along_axes(header: &mut ImageHeader<3>, coordinates: &[Option<EvenCoordinate>; 3]) {
    let coordinates_by_name: Option<Vec<(usize, bool)>> =
        (header.geometry.names.iter().zip(header.dims))
            .enumerate()
            .filter(|(_, (_, count))| *count > 1)
            .map(|(_, (name, _))| {
                name.parse::<AxisSpec>()
                    .ok()
                    .map(|axis| axis.space_coordinate())
            })
            .collect();
    let distinct = coordinates_by_name
        .filter(|axes| sorted_distinct(axes.iter().map(|(c, _)| *c)).len() == 3 && axes.len() == 3);
    for k in 0..3 {
        let (c, is_descending) = distinct.as_ref().map_or((k, false), |axes| axes[k]);
        let sign = if is_descending { -1.0 } else { 1.0 };
        header.geometry.axes[k] = [0.0; 3];
        let (first, step, unit) = match &coordinates[k] {
            Some(EvenCoordinate { first, step, unit }) => (*first, *step, unit.clone()),
            None => (0.0, 1.0, String::new()),
        };
        header.geometry.origin[c] = 0.0 + sign * first;
        header.geometry.axes[k][c] = sign * step;
        header.geometry.units[c] = unit;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_of_cut_off_numbers_are_found() {
        for (first, step, count) in [
            (0.0, 2.5, 64),
            (8.0, 0.5, 20),
            (100.0, 1.25, 300),
            (0.0, 0.1, 500),
        ] {
            let values: Vec<f64> = (0..count)
                .map(|i| (first + f64::from(i) * step + 1e-9).trunc())
                .collect();
            assert_eq!(step_of_truncated(&values), Some([first, step]));
        }
        assert_eq!(step_of_truncated(&[0.0, 2.0, 5.0, 6.0, 11.0]), None);
        assert_eq!(step_of_truncated(&[0.0, 2.5, 5.0, 7.0]), None);
    }
}
