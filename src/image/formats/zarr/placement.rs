//! Where an array lies: by what `convert` has written of it, or by the coordinates beside it, as xarray and
//! MDIO keep them.
//!
//! A coordinate is an array with the name of an axis, which holds a number for each index along that. Of
//! a survey `cdp_x` and `cdp_y` hold positions of traces, and `trace_mask` says where there are any.

use std::path::Path;

use serde_json::Value;

use super::metadata::{ArrayMetadata, NODE_FILE, ZarrNode};
use crate::error::Result;
use crate::image::Geometry;
use crate::image::formats::AxisSpec;
use crate::image::formats::placement::{NO_GEOMETRY_NOTE, length_unit};
use crate::image::formats::segy::{LineNumbers, SurveyFit};
use crate::image::formats::stream::ImageHeader;

/// Which traces there are.
pub const TRACE_MASK: &str = "trace_mask";

/// Positions of traces.
pub const POSITION_NAMES: [&str; 2] = ["cdp_x", "cdp_y"];

/// Where `convert` keeps the geometry.
pub const GEOMETRY_ATTRIBUTE: &str = "atomesh";

/// Numbers that miss even steps by more than this share of a step are not even.
const MAX_STEP_DEVIATION: f64 = 1e-3;

/// Even numbers along an axis.
struct EvenCoordinate {
    first: f64,
    step: f64,
    unit: String,
}

impl EvenCoordinate {
    /// The whole numbers of lines.
    fn line_numbers(&self, count: usize) -> Option<LineNumbers> {
        let [first, step] = [self.first, self.step].map(f64::round);
        let whole = (first - self.first).abs() < 1e-6 && (step - self.step).abs() < 1e-6;
        (whole && step >= 1.0 && first.abs() < 1e15 && step < 1e15).then_some(LineNumbers {
            first: first as i64,
            step: step as i64,
            count: count as u64,
        })
    }
}

/// The arrays beside one.
struct SiblingArrays<'a> {
    group: Option<&'a Path>,
}

impl SiblingArrays<'_> {
    /// One of these, of this shape; none if it is not there or cannot be understood.
    fn array(&self, name: &str, shape: &[usize]) -> Option<ArrayMetadata> {
        // Names are those of axes: no paths.
        let plain = !name.is_empty() && !name.contains(['/', '\\']) && name != "..";
        let folder = self.group.filter(|_| plain)?.join(name);
        if !folder.join(NODE_FILE).is_file() {
            return None;
        }
        match ZarrNode::open(&folder).ok()? {
            ZarrNode::Array(array) if array.shape == shape => Some(*array),
            _ => None,
        }
    }

    /// The coordinate of an axis, if it rises or falls evenly.
    fn even_coordinate(
        &self,
        name: &str,
        count: usize,
        notes: &mut Vec<String>,
    ) -> Result<Option<EvenCoordinate>> {
        let Some(array) = self.array(name, &[count]) else {
            return Ok(None);
        };
        let values = array.read_all()?;
        let (first, last) = (values[0], values[count - 1]);
        let step = match count {
            1 => 1.0,
            _ => (last - first) / (count - 1) as f64,
        };
        let off = |(i, v): (usize, &f64)| {
            (v - first - i as f64 * step).abs() <= MAX_STEP_DEVIATION * step.abs()
        };
        if step == 0.0 || !step.is_finite() || !values.iter().enumerate().all(off) {
            notes.push(format!("the coordinate {name} is not even: not used"));
            return Ok(None);
        }
        let unit = array_unit(&array);
        Ok(Some(EvenCoordinate { first, step, unit }))
    }
}

/// The unit of an array's numbers, as MDIO or xarray keep it.
fn array_unit(array: &ArrayMetadata) -> String {
    let word = |value: &Value| value.as_str().map(String::from);
    let mdio = array.attributes.get("unitsV1").and_then(|units| {
        let mut all = units.as_object()?.values();
        all.find_map(word)
    });
    let plain = || array.attributes.get("units").and_then(word);
    mdio.or_else(plain).unwrap_or_default()
}

/// Places an image, from the array and the group that it lies in.
///
/// # Errors
/// [`crate::Error::Io`] for coordinates whose chunks cannot be read.
pub fn place(head: &mut ImageHeader<3>, array: &ArrayMetadata, group: Option<&Path>) -> Result<()> {
    let beside = SiblingArrays { group };
    let axes = array.shape.len();
    for (k, name) in array.axis_names.iter().rev().take(3).enumerate() {
        if !name.is_empty() {
            head.geometry.names[k].clone_from(name);
        }
    }
    let rows = [head.dims[2], head.dims[1]];
    let shape = if axes < 3 { &rows[1..] } else { &rows[..] };
    if let Some(mask) = beside.array(TRACE_MASK, shape) {
        let missing: Vec<bool> = mask.read_all()?.iter().map(|live| *live == 0.0).collect();
        let count = missing.iter().filter(|missing| **missing).count();
        if count > 0 {
            head.notes.push(format!(
                "{count} of {} cells have no trace: filled with zeros",
                missing.len()
            ));
            head.missing = missing;
        }
    }
    let mut coordinates: [Option<EvenCoordinate>; 3] = [None, None, None];
    for (k, coordinate) in coordinates.iter_mut().enumerate().take(axes) {
        let (name, count) = (&head.geometry.names[k], head.dims[k]);
        *coordinate = beside.even_coordinate(name, count, &mut head.notes)?;
    }
    let is_survey = head.geometry.names[1..] == ["crossline", "inline"];
    if is_survey {
        let numbers = |k: usize| coordinates[k].as_ref()?.line_numbers(head.dims[k]);
        head.line_numbers = numbers(2).zip(numbers(1)).map(|(i, c)| [i, c]);
    }
    if let Some(geometry) = array
        .attributes
        .get(GEOMETRY_ATTRIBUTE)
        .and_then(|said| stored_geometry(said, head))
    {
        head.geometry = geometry;
        return Ok(());
    }
    if let Some(positions) = trace_positions(&beside, shape)? {
        let (values, unit) = positions;
        if place_by_traces(head, &values, &unit, &coordinates[0], is_survey) {
            return Ok(());
        }
    }
    if coordinates.iter().all(Option::is_none) && place_by_ome(head, array, group) {
        return Ok(());
    }
    if coordinates.iter().all(Option::is_none) {
        head.notes.push(format!("the array {NO_GEOMETRY_NOTE}"));
        return Ok(());
    }
    if let (true, Some([inlines, crosslines])) = (is_survey, head.line_numbers) {
        let note = "no usable X, Y: horizontal coordinates are inline and crossline numbers";
        head.notes.push(note.into());
        let [first, step] = [
            [inlines.first, crosslines.first].map(|n| n as f64),
            [inlines.step, crosslines.step].map(|n| n as f64),
        ];
        let [inline, crossline] = [[step[0], 0.0], [0.0, step[1]]];
        place_upright(head, first, inline, crossline, "line", &coordinates[0]);
        return Ok(());
    }
    place_along_axes(head, &coordinates);
    Ok(())
}

/// Places an array of an OME-Zarr image (NGFF 0.5) by the scale and the translation that its group gives it; says
/// whether it could.
fn place_by_ome(head: &mut ImageHeader<3>, array: &ArrayMetadata, group: Option<&Path>) -> bool {
    let placed = || -> Option<Geometry<3>> {
        let ZarrNode::Group(node) = ZarrNode::open(group?).ok()? else {
            return None;
        };
        let name = array.folder.file_name()?.to_str()?;
        let ome = node.get("ome")?;
        let mut images = ome["multiscales"].as_array()?.iter();
        let (image, dataset) = images.find_map(|image| {
            let mut datasets = image["datasets"].as_array()?.iter();
            Some((image, datasets.find(|set| set["path"] == name)?))
        })?;
        let numbers = |value: &Value| -> Option<Vec<f64>> {
            value.as_array()?.iter().map(Value::as_f64).collect()
        };
        let axes = image["axes"].as_array()?;
        let count = axes.len();
        let (mut scale, mut translation) = (vec![1.0; count], vec![0.0; count]);
        let lists = [dataset, image].map(|of| of["coordinateTransformations"].as_array());
        for change in lists.into_iter().flatten().flatten() {
            let factors = numbers(&change["scale"]).unwrap_or_else(|| vec![1.0; count]);
            let shifts = numbers(&change["translation"]).unwrap_or_else(|| vec![0.0; count]);
            if factors.len() != count || shifts.len() != count {
                return None;
            }
            for k in 0..count {
                scale[k] *= factors[k];
                translation[k] = translation[k] * factors[k] + shifts[k];
            }
        }
        let mut geometry = Geometry::default();
        for (k, from) in (0..count).rev().take(3).enumerate() {
            if !(scale[from] > 0.0 && scale[from].is_finite() && translation[from].is_finite()) {
                return None;
            }
            geometry.axes[k][k] = scale[from];
            geometry.origin[k] = translation[from];
            let unit = axes[from]["unit"].as_str().unwrap_or_default();
            geometry.units[k] = length_unit(unit).unwrap_or(unit).to_string();
        }
        Some(geometry)
    };
    match placed() {
        Some(geometry) => {
            head.geometry = geometry;
            head.notes.push("spacing and unit as OME-Zarr says".into());
            true
        }
        None => false,
    }
}

/// The geometry that `convert` has written, if it makes sense.
fn stored_geometry(said: &Value, head: &ImageHeader<3>) -> Option<Geometry<3>> {
    let vector = |value: &Value| -> Option<[f64; 3]> {
        let all: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
        all?.try_into().ok()
    };
    let words = |value: &Value| -> Option<[String; 3]> {
        let all: Option<Vec<String>> = (value.as_array()?.iter())
            .map(|word| word.as_str().map(String::from))
            .collect();
        all?.try_into().ok()
    };
    let axes: Option<Vec<[f64; 3]>> = said["axes"].as_array()?.iter().map(vector).collect();
    Some(Geometry {
        origin: vector(&said["origin"])?,
        axes: axes?.try_into().ok()?,
        names: words(&said["names"]).unwrap_or_else(|| head.geometry.names.clone()),
        units: words(&said["units"])?,
    })
}

/// Positions of traces and their unit.
fn trace_positions(
    beside: &SiblingArrays<'_>,
    shape: &[usize],
) -> Result<Option<(Vec<[f64; 2]>, String)>> {
    let [Some(x), Some(y)] = POSITION_NAMES.map(|name| beside.array(name, shape)) else {
        return Ok(None);
    };
    let pairs = x
        .read_all()?
        .into_iter()
        .zip(y.read_all()?)
        .map(|(x, y)| [x, y]);
    Ok(Some((pairs.collect(), array_unit(&x))))
}

/// Places a survey, or a line, by the positions of its traces; says whether it could.
fn place_by_traces(
    head: &mut ImageHeader<3>,
    positions: &[[f64; 2]],
    unit: &str,
    vertical: &Option<EvenCoordinate>,
    is_survey: bool,
) -> bool {
    let crosslines = head.dims[1];
    let known = |t: &usize| {
        positions[*t].iter().all(|c| c.is_finite()) && !head.missing.get(*t).unwrap_or(&false)
    };
    let known: Vec<usize> = (0..positions.len()).filter(known).collect();
    let at: Vec<[f64; 2]> = known.iter().map(|&t| positions[t]).collect();
    if is_survey {
        let cells: Vec<_> = known
            .iter()
            .map(|t| [t / crosslines, t % crosslines])
            .collect();
        let [x, y] = POSITION_NAMES;
        return match SurveyFit::from_positions(&cells, &at) {
            Ok(fit) => {
                head.notes.push(format!(
                    "placed by {x} and {y}: they miss a regular grid by {:.3} rms, {:.3} at most (pitch: inlines {:.3}, crosslines {:.3})",
                    fit.rms, fit.max, fit.line_spacing()[0], fit.line_spacing()[1]
                ));
                place_upright(head, fit.origin, fit.inline, fit.crossline, unit, vertical);
                true
            }
            Err(reason) => {
                head.notes.push(format!("{x} and {y} {reason}: not used"));
                false
            }
        };
    }
    let length: f64 = (at.windows(2))
        .map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1]))
        .sum();
    let steps = match (known.first(), known.last()) {
        (Some(first), Some(last)) if last > first && head.dims[2] == 1 => last - first,
        _ => return false,
    };
    let pitch = length / steps as f64;
    if !(pitch > 0.0 && pitch.is_finite()) {
        return false;
    }
    head.notes.push(format!(
        "a 2-D line: {} traces over {length:.1}, {pitch:.3} apart",
        known.len()
    ));
    place_upright(head, [0.0; 2], [0.0, pitch], [pitch, 0.0], unit, vertical);
    true
}

/// Lays the first image axis down from its first number, the others level.
fn place_upright(
    head: &mut ImageHeader<3>,
    first: [f64; 2],
    inline: [f64; 2],
    crossline: [f64; 2],
    unit: &str,
    vertical: &Option<EvenCoordinate>,
) {
    let name = head.geometry.names[0].clone();
    let (top, step, down) = match vertical {
        Some(even) => (even.first, even.step, even.unit.clone()),
        None => (0.0, 1.0, "sample".to_string()),
    };
    let down = match (&*down, &*name) {
        ("", "time" | "twt") => {
            let note = format!("the coordinate {name} has no unit: taken as ms");
            head.notes.push(note);
            "ms".to_string()
        }
        _ => down,
    };
    head.geometry.origin = [first[0], first[1], 0.0 - top];
    head.geometry.axes = [
        [0.0, 0.0, -step],
        [crossline[0], crossline[1], 0.0],
        [inline[0], inline[1], 0.0],
    ];
    head.geometry.units = [unit.to_string(), unit.to_string(), down];
}

/// Lays the image along the coordinates that its axes are named after, else in their order.
fn place_along_axes(head: &mut ImageHeader<3>, coordinates: &[Option<EvenCoordinate>; 3]) {
    let named: Option<Vec<(usize, bool)>> = (head.geometry.names.iter().zip(head.dims))
        .enumerate()
        .filter(|(_, (_, count))| *count > 1)
        .map(|(_, (name, _))| {
            name.parse::<AxisSpec>()
                .ok()
                .map(|axis| axis.space_coordinate())
        })
        .collect();
    let distinct = named.filter(|along| {
        let mut all: Vec<usize> = along.iter().map(|(c, _)| *c).collect();
        all.sort_unstable();
        all.windows(2).all(|pair| pair[0] != pair[1]) && along.len() == 3
    });
    for k in 0..3 {
        let (c, falls) = distinct.as_ref().map_or((k, false), |along| along[k]);
        let sign = if falls { -1.0 } else { 1.0 };
        head.geometry.axes[k] = [0.0; 3];
        let (first, step, unit) = match &coordinates[k] {
            Some(EvenCoordinate { first, step, unit }) => (*first, *step, unit.clone()),
            None => (0.0, 1.0, String::new()),
        };
        head.geometry.origin[c] = 0.0 + sign * first;
        head.geometry.axes[k][c] = sign * step;
        head.geometry.units[c] = unit;
    }
}
