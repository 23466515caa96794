//! Tables of the measures of surfaces.

use super::extract::surface_name;
use super::outcome::InterfaceMeasure;
use crate::model::surface::SurfaceMeasure;
use crate::model::surface::amplitude::{Polarity, Throw};

/// Largest number of surfaces in a table.
const MAX_ROWS: usize = 40;

/// Returns the name of what faces measure: area, in the plane length.
pub(super) fn area_name(is_plane: bool) -> &'static str {
    if is_plane { "length" } else { "area" }
}

/// Returns a table of the largest surfaces, with the surfaces that they meet if `meets` is set.
pub(super) fn surface_table(measures: &[SurfaceMeasure], is_plane: bool, meets: bool) -> String {
    let area = area_name(is_plane);
    let rim = if is_plane { "ends" } else { "rim" };
    let title = |name: &'static str| if meets { name } else { "" };
    let mut lines = vec![format!(
        "{:>7} {:>7} {:>11} {:>6} {:>6} {:>4} {:>9} {:>9} {:>6} {:>5} {:>9}  {}",
        "surface",
        "kind",
        area,
        "faces",
        "strike",
        "dip",
        "off plane",
        rim,
        "pieces",
        "holes",
        "hole area",
        title("meets")
    )];
    // Names that differ from kind and number are shown at the end of the line.
    if measures.iter().any(|m| m.name.is_some()) {
        lines[0] += "  name";
    }
    let angle = |angle: Option<f64>| angle.map_or("-".into(), |angle| format!("{angle:.0}"));
    for m in measures.iter().take(MAX_ROWS) {
        let others = m.adjacent_surfaces.iter().filter(|_| meets);
        let others: Vec<String> = others.map(ToString::to_string).collect();
        lines.push(format!(
            "{:>7} {:>7} {:>11.5} {:>6} {:>6} {:>4} {:>9.3} {:>9.5} {:>6} {:>5} {:>9.3}  {}",
            m.surface,
            m.kind.name(),
            ShortNumber(m.area),
            m.facets,
            angle(m.strike),
            angle(m.dip),
            ShortNumber(m.rms_plane_distance),
            ShortNumber(m.rim),
            m.components,
            m.holes,
            ShortNumber(m.hole_area),
            others.join(" ")
        ));
        if let (Some(name), Some(line)) = (&m.name, lines.last_mut()) {
            *line += &format!("  {name}");
        }
    }
    lines
        .iter_mut()
        .for_each(|line| line.truncate(line.trim_end().len()));
    if measures.len() > MAX_ROWS {
        lines.push(format!(
            "... and {} smaller ones",
            measures.len() - MAX_ROWS
        ));
    }
    lines.join("\n")
}

/// Returns a table of vertical ranges and of measures from amplitudes.
pub(super) fn amplitude_table(measures: &[SurfaceMeasure]) -> String {
    let mut lines = vec![
        "throw, in the unit of the vertical coordinate, is positive where the hanging wall is lower".into(),
        format!(
            "{:>7} {:>7} {:>9} {:>9} {:>8} {:>8} {:>8} {:>11} {:>11} {:>5} {:>8} {:>9} {:>10}",
            "surface",
            "kind",
            "from",
            "to",
            "throw 5%",
            "median",
            "95%",
            "correlation",
            "by horizons",
            "pairs",
            "polarity",
            "amplitude",
            "confidence"
        ),
    ];
    let number =
        |value: Option<f64>| value.map_or("-".into(), |value| format!("{:.4}", ShortNumber(value)));
    for m in measures.iter().take(MAX_ROWS) {
        let Some(amplitudes) = &m.amplitudes else {
            continue;
        };
        let throw = |value: fn(&Throw) -> f64| number(amplitudes.throw.as_ref().map(value));
        let median = |throw: Option<&Throw>| {
            let doubt = if throw.is_some_and(|t| t.is_doubtful) {
                "?"
            } else {
                ""
            };
            number(throw.map(|t| t.median)) + doubt
        };
        lines.push(format!(
            "{:>7} {:>7} {:>9.5} {:>9.5} {:>8} {:>8} {:>8} {:>11} {:>11} {:>5} {:>8} {:>9} {:>10}",
            m.surface,
            m.kind.name(),
            ShortNumber(m.vertical_range[0]),
            ShortNumber(m.vertical_range[1]),
            throw(|t| t.min),
            median(amplitudes.throw.as_ref()),
            throw(|t| t.max),
            (amplitudes.throw).map_or("-".into(), |t| format!("{:.2}", t.correlation)),
            number(amplitudes.horizon_throw.map(|t| t.median)),
            (amplitudes.horizon_throw).map_or("-".into(), |t| t.pairs.to_string()),
            amplitudes.polarity.map_or("-", Polarity::name),
            number(amplitudes.amplitude),
            (amplitudes.confidence).map_or("-".into(), |c| format!("{c:.1}")),
        ));
    }
    lines.join("\n")
}

/// Returns a note on each fault whose throw is doubtful, as it differs in sign along the fault.
pub(super) fn doubtful_throw_notes(measures: &[SurfaceMeasure]) -> Vec<String> {
    let note = |m: &SurfaceMeasure| {
        let throw = m.amplitudes?.throw.filter(|throw| throw.is_doubtful)?;
        let name = surface_name(m);
        let [low, median, high] =
            [throw.min, throw.median, throw.max].map(|t| format!("{:.4}", ShortNumber(t)));
        Some(format!(
            "{name}: its throw of {median} (median) is doubtful, as it changes its sign, from {low} to {high} on 90 % of the area: \
             layers may be matched with wrong reflectors there"
        ))
    };
    measures.iter().filter_map(note).collect()
}

/// Returns a table of the interfaces between regions.
pub(super) fn interface_table(measures: &[InterfaceMeasure], is_plane: bool) -> String {
    let mut lines = vec![format!(
        "{:>12} {:>12} {:>9} {:>14}",
        "inside",
        "outside",
        "faces",
        area_name(is_plane)
    )];
    lines.extend(measures.iter().map(|m| {
        format!(
            "{:>12} {:>12} {:>9} {:>14.6}",
            m.inner.1,
            m.outer_name(),
            m.faces,
            ShortNumber(m.area)
        )
    }));
    lines.join("\n")
}

/// A number that is displayed with about as many digits as the format's precision.
struct ShortNumber(f64);

impl std::fmt::Display for ShortNumber {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(4) as i32;
        if self.0 == 0.0 {
            return f.pad("0");
        }
        let integer_digits = self.0.abs().clamp(1e-300, 1e300).log10().floor() as i32 + 1;
        let decimals = (digits - integer_digits).clamp(0, 9) as usize;
        f.pad_integral(self.0 >= 0.0, "", &format!("{:.decimals$}", self.0.abs()))
    }
}
