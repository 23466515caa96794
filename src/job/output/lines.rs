//! Writes lines as VTK poly data (`.vtp`): acute lines of meshes, and lines where features meet or
//! end.

use std::path::Path;

use crate::Result;
use crate::feature::FeatureLine;
use crate::files::vtk::{ArraySource, PolyData};
use crate::geometry::to_3d;
use crate::report::AcuteLine;

/// Writes acute lines as poly lines (in 2-D as vertices). `position_of` returns the world position
/// of a node.
///
/// Cell data are the `mean_angle` and `least_angle` of each line in degrees and its `length`, all
/// measured in lattice space, and its `pair`: 0 for two features, otherwise 1 + the number of the
/// side of the box that a feature meets. Point data are the `angle`.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_lines<const D: usize>(
    path: &Path,
    lines: &[AcuteLine],
    position_of: impl Fn(u32) -> [f64; D],
) -> Result<()> {
    let nodes = lines.iter().flat_map(|line| &line.nodes);
    let points: Vec<[f64; 3]> = nodes.map(|&n| to_3d(position_of(n))).collect();
    let angles: Vec<f64> = lines.iter().flat_map(node_angles).collect();
    let pairs: Vec<u8> = lines.iter().map(|line| line.pair.code()).collect();
    let line_array = |name: &str, value_of: fn(&AcuteLine) -> f64| {
        let value = move |i: usize| value_of(&lines[i]);
        ArraySource::computed(name, 1, lines.len(), value)
    };
    write_poly_lines::<D>(
        path,
        &points,
        lines.iter().map(|line| line.nodes.len()),
        vec![ArraySource::slice("angle", 1, &angles)],
        vec![
            line_array("mean_angle", |line| line.mean_angle),
            line_array("least_angle", |line| line.min_angle),
            line_array("length", |line| line.length),
            ArraySource::slice("pair", 1, &pairs),
        ],
    )
}

/// Writes the lines at which features meet or end as poly lines (in 2-D as vertices). `to_world`
/// maps a position from lattice space to the world.
///
/// Cell data are the `kind` of each line (0 for a crossing, 1 for a branch, 2 for a tip), its
/// `angle` in degrees and its `length` (both in lattice space), and its `sheets`: the numbers of
/// the two feature surfaces, for a tip 0 and one number.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_feature_lines<const D: usize>(
    path: &Path,
    lines: &[FeatureLine<D>],
    to_world: impl Fn([f64; D]) -> [f64; D],
) -> Result<()> {
    let line_points = lines.iter().flat_map(|line| &line.points);
    let points: Vec<[f64; 3]> = line_points.map(|&x| to_3d(to_world(x))).collect();
    let kinds: Vec<u8> = lines.iter().map(|line| line.kind as u8).collect();
    let surfaces: Vec<u32> = lines.iter().flat_map(|line| line.surfaces).collect();
    let line_array = |name: &str, value_of: fn(&FeatureLine<D>) -> f64| {
        let value = move |i: usize| value_of(&lines[i]);
        ArraySource::computed(name, 1, lines.len(), value)
    };
    write_poly_lines::<D>(
        path,
        &points,
        lines.iter().map(|line| line.points.len()),
        Vec::new(),
        vec![
            ArraySource::slice("kind", 1, &kinds),
            line_array("angle", |line| line.angle),
            line_array("length", |line| line.length),
            ArraySource::slice("sheets", 2, &surfaces),
        ],
    )
}

/// Writes lines and their data. Each line has a number of successive points, given in `counts`. In
/// 2-D lines are written as vertices.
fn write_poly_lines<'a, const D: usize>(
    path: &Path,
    points: &'a [[f64; 3]],
    counts: impl ExactSizeIterator<Item = usize>,
    point_arrays: Vec<ArraySource<'a>>,
    line_arrays: Vec<ArraySource<'a>>,
) -> Result<()> {
    let mut end = 0;
    let ends: Vec<i64> = counts
        .map(|count| {
            end += count as i64;
            end
        })
        .collect();
    let (element, counted): (_, &[_]) = if D == 2 {
        ("Verts", &["Verts"])
    } else {
        ("Lines", &["Lines"])
    };
    PolyData {
        counted,
        point_data: Some(point_arrays),
        cell_data: Some(line_arrays),
        ..PolyData::new(element, points, ends.len(), |i| ends[i])
    }
    .write(path)
}

/// Returns the angle at each node of a line: the mean of the adjacent edges.
fn node_angles(line: &AcuteLine) -> Vec<f64> {
    let edges = &line.angles;
    let angle_at = |i: usize| {
        let angles = &edges[i.saturating_sub(1)..edges.len().min(i + 1)];
        angles.iter().sum::<f64>() / angles.len() as f64
    };
    (0..line.nodes.len()).map(angle_at).collect()
}
