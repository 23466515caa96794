//! Where an array lies: by what `convert` has written of it, or by the coordinates beside it, as xarray and
//! MDIO keep them.
//!
//! A coordinate is an array with the name of an axis, which holds a number for each index along that. Of
//! a survey `cdp_x` and `cdp_y` hold positions of traces, and `trace_mask` says where there are any.

use std::path::Path;

use serde_json::Value;

use super::metadata::{Metadata, NODE, Node};
use crate::error::Result;
use crate::image::Geometry;
use crate::image::formats::AxisName;
use crate::image::formats::placement::{BARE, length_unit};
use crate::image::formats::segy::{Fit, Lines};
use crate::image::formats::stream::Head;

/// Which traces there are.
pub const MASK: &str = "trace_mask";

/// Positions of traces.
pub const POSITIONS: [&str; 2] = ["cdp_x", "cdp_y"];

/// Where `convert` keeps the geometry.
pub const OURS: &str = "atomesh";

/// Numbers that miss even steps by more than this share of a step are not even.
const UNEVEN: f64 = 1e-3;

/// Even numbers along an axis.
struct Even {
    first: f64,
    step: f64,
    unit: String,
}

impl Even {
    /// The whole numbers of lines.
    fn lines(&self, count: usize) -> Option<Lines> {
        let [first, step] = [self.first, self.step].map(f64::round);
        let whole = (first - self.first).abs() < 1e-6 && (step - self.step).abs() < 1e-6;
        (whole && step >= 1.0 && first.abs() < 1e15 && step < 1e15).then_some(Lines {
            first: first as i64,
            step: step as i64,
            count: count as u64,
        })
    }
}

/// The arrays beside one.
struct Beside<'a> {
    group: Option<&'a Path>,
}

impl Beside<'_> {
    /// One of these, of this shape; none if it is not there or cannot be understood.
    fn array(&self, name: &str, shape: &[usize]) -> Option<Metadata> {
        // Names are those of axes: no paths.
        let plain = !name.is_empty() && !name.contains(['/', '\\']) && name != "..";
        let folder = self.group.filter(|_| plain)?.join(name);
        if !folder.join(NODE).is_file() {
            return None;
        }
        match Node::open(&folder).ok()? {
            Node::Array(array) if array.shape == shape => Some(*array),
            _ => None,
        }
    }

    /// The coordinate of an axis, if it rises or falls evenly.
    fn even(&self, name: &str, count: usize, notes: &mut Vec<String>) -> Result<Option<Even>> {
        let Some(array) = self.array(name, &[count]) else {
            return Ok(None);
        };
        let values = array.all()?;
        let (first, last) = (values[0], values[count - 1]);
        let step = match count {
            1 => 1.0,
            _ => (last - first) / (count - 1) as f64,
        };
        let off =
            |(i, v): (usize, &f64)| (v - first - i as f64 * step).abs() <= UNEVEN * step.abs();
        if step == 0.0 || !step.is_finite() || !values.iter().enumerate().all(off) {
            notes.push(format!("the coordinate {name} is not even: not used"));
            return Ok(None);
        }
        let unit = unit_of(&array);
        Ok(Some(Even { first, step, unit }))
    }
}

/// The unit of an array's numbers, as MDIO or xarray keep it.
fn unit_of(array: &Metadata) -> String {
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
pub fn place(head: &mut Head<3>, array: &Metadata, group: Option<&Path>) -> Result<()> {
    let beside = Beside { group };
    let axes = array.shape.len();
    for (k, name) in array.names.iter().rev().take(3).enumerate() {
        if !name.is_empty() {
            head.geometry.names[k].clone_from(name);
        }
    }
    let rows = [head.dims[2], head.dims[1]];
    let shape = if axes < 3 { &rows[1..] } else { &rows[..] };
    if let Some(mask) = beside.array(MASK, shape) {
        let missing: Vec<bool> = mask.all()?.iter().map(|live| *live == 0.0).collect();
        let count = missing.iter().filter(|missing| **missing).count();
        if count > 0 {
            head.notes.push(format!(
                "{count} of {} cells have no trace: filled with zeros",
                missing.len()
            ));
            head.missing = missing;
        }
    }
    let mut coordinates: [Option<Even>; 3] = [None, None, None];
    for (k, coordinate) in coordinates.iter_mut().enumerate().take(axes) {
        let (name, count) = (&head.geometry.names[k], head.dims[k]);
        *coordinate = beside.even(name, count, &mut head.notes)?;
    }
    let is_survey = head.geometry.names[1..] == ["crossline", "inline"];
    if is_survey {
        let numbers = |k: usize| coordinates[k].as_ref()?.lines(head.dims[k]);
        head.lines = numbers(2).zip(numbers(1)).map(|(i, c)| [i, c]);
    }
    if let Some(geometry) = array.attributes.get(OURS).and_then(|said| ours(said, head)) {
        head.geometry = geometry;
        return Ok(());
    }
    if let Some(positions) = positions(&beside, shape)? {
        let (values, unit) = positions;
        if traces(head, &values, &unit, &coordinates[0], is_survey) {
            return Ok(());
        }
    }
    if coordinates.iter().all(Option::is_none) && of_ome(head, array, group) {
        return Ok(());
    }
    if coordinates.iter().all(Option::is_none) {
        head.notes.push(format!("the array {BARE}"));
        return Ok(());
    }
    if let (true, Some([inlines, crosslines])) = (is_survey, head.lines) {
        let note = "no usable X, Y: horizontal coordinates are inline and crossline numbers";
        head.notes.push(note.into());
        let [first, step] = [
            [inlines.first, crosslines.first].map(|n| n as f64),
            [inlines.step, crosslines.step].map(|n| n as f64),
        ];
        let [inline, crossline] = [[step[0], 0.0], [0.0, step[1]]];
        upright(head, first, inline, crossline, "line", &coordinates[0]);
        return Ok(());
    }
    along_axes(head, &coordinates);
    Ok(())
}

/// Places an array of an OME-Zarr image (NGFF 0.5) by the scale and the translation that its group gives it; says
/// whether it could.
fn of_ome(head: &mut Head<3>, array: &Metadata, group: Option<&Path>) -> bool {
    let placed = || -> Option<Geometry<3>> {
        let Node::Group(node) = Node::open(group?).ok()? else {
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
fn ours(said: &Value, head: &Head<3>) -> Option<Geometry<3>> {
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
fn positions(beside: &Beside<'_>, shape: &[usize]) -> Result<Option<(Vec<[f64; 2]>, String)>> {
    let [Some(x), Some(y)] = POSITIONS.map(|name| beside.array(name, shape)) else {
        return Ok(None);
    };
    let pairs = x.all()?.into_iter().zip(y.all()?).map(|(x, y)| [x, y]);
    Ok(Some((pairs.collect(), unit_of(&x))))
}

/// Places a survey, or a line, by the positions of its traces; says whether it could.
fn traces(
    head: &mut Head<3>,
    positions: &[[f64; 2]],
    unit: &str,
    vertical: &Option<Even>,
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
        let [x, y] = POSITIONS;
        return match Fit::of(&cells, &at) {
            Ok(fit) => {
                head.notes.push(format!(
                    "placed by {x} and {y}: they miss a regular grid by {:.3} rms, {:.3} at most (pitch: inlines {:.3}, crosslines {:.3})",
                    fit.rms, fit.max, fit.pitch()[0], fit.pitch()[1]
                ));
                upright(head, fit.origin, fit.inline, fit.crossline, unit, vertical);
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
    upright(head, [0.0; 2], [0.0, pitch], [pitch, 0.0], unit, vertical);
    true
}

/// Lays the first image axis down from its first number, the others level.
fn upright(
    head: &mut Head<3>,
    first: [f64; 2],
    inline: [f64; 2],
    crossline: [f64; 2],
    unit: &str,
    vertical: &Option<Even>,
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
fn along_axes(head: &mut Head<3>, coordinates: &[Option<Even>; 3]) {
    let named: Option<Vec<(usize, bool)>> = (head.geometry.names.iter().zip(head.dims))
        .enumerate()
        .filter(|(_, (_, count))| *count > 1)
        .map(|(_, (name, _))| name.parse::<AxisName>().ok().map(|axis| axis.along()))
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
            Some(Even { first, step, unit }) => (*first, *step, unit.clone()),
            None => (0.0, 1.0, String::new()),
        };
        head.geometry.origin[c] = 0.0 + sign * first;
        head.geometry.axes[k][c] = sign * step;
        head.geometry.units[c] = unit;
    }
}
