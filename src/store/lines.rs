//! Lines as VTK poly data (`.vtp`): acute lines of meshes, and where features meet and end.

use std::path::Path;

use crate::Result;
use crate::feature::FeatureLine;
use crate::files::atomic_write;
use crate::files::vtk::{ArraySource, Document};
use crate::geometry::to_3d;
use crate::report::AcuteLine;

/// Writes lines as poly lines, in the plane as vertices; `place` is where a node is in the world. Cell
/// data are each line's `mean_angle` and `least_angle` in degrees, its `length` (both as they were
/// measured, in lattice space), and its `pair`: 0 for two features, else 1 more than the number of the
/// side of the box that a feature meets. Point data are the `angle`.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_lines<const D: usize>(
    path: &Path,
    lines: &[AcuteLine],
    place: impl Fn(u32) -> [f64; D],
) -> Result<()> {
    let nodes = lines.iter().flat_map(|line| &line.nodes);
    let points: Vec<[f64; 3]> = nodes.map(|&n| to_3d(place(n))).collect();
    let angles: Vec<f64> = lines.iter().flat_map(node_angles).collect();
    let pairs: Vec<u8> = lines.iter().map(|line| line.pair.code()).collect();
    let of_lines = |name: &str, of: fn(&AcuteLine) -> f64| {
        let value = move |i: usize| of(&lines[i]);
        ArraySource::computed(name, 1, lines.len(), value)
    };
    write_poly_lines::<D>(
        path,
        &points,
        lines.iter().map(|line| line.nodes.len()),
        vec![ArraySource::slice("angle", 1, &angles)],
        vec![
            of_lines("mean_angle", |line| line.mean_angle),
            of_lines("least_angle", |line| line.min_angle),
            of_lines("length", |line| line.length),
            ArraySource::slice("pair", 1, &pairs),
        ],
    )
}

/// Writes the lines at which features meet and end as poly lines, in the plane as vertices; `place` is
/// where a place in lattice space is in the world. Cell data are each line's `kind` (0 for a crossing, 1
/// for a branch, 2 for a tip), its `angle` in degrees and its `length` (both in lattice space), and its
/// `sheets`: two numbers, of a tip 0 and one.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_feature_lines<const D: usize>(
    path: &Path,
    lines: &[FeatureLine<D>],
    place: impl Fn([f64; D]) -> [f64; D],
) -> Result<()> {
    let places = lines.iter().flat_map(|line| &line.points);
    let points: Vec<[f64; 3]> = places.map(|&x| to_3d(place(x))).collect();
    let kinds: Vec<u8> = lines.iter().map(|line| line.kind as u8).collect();
    let sheets: Vec<u32> = lines.iter().flat_map(|line| line.surfaces).collect();
    let of_lines = |name: &str, of: fn(&FeatureLine<D>) -> f64| {
        let value = move |i: usize| of(&lines[i]);
        ArraySource::computed(name, 1, lines.len(), value)
    };
    write_poly_lines::<D>(
        path,
        &points,
        lines.iter().map(|line| line.points.len()),
        Vec::new(),
        vec![
            ArraySource::slice("kind", 1, &kinds),
            of_lines("angle", |line| line.angle),
            of_lines("length", |line| line.length),
            ArraySource::slice("sheets", 2, &sheets),
        ],
    )
}

/// Writes lines, each of so many of the points, and their data; in the plane as vertices.
fn write_poly_lines<'a, const D: usize>(
    path: &Path,
    points: &'a [[f64; 3]],
    counts: impl ExactSizeIterator<Item = usize>,
    of_points: Vec<ArraySource<'a>>,
    of_lines: Vec<ArraySource<'a>>,
) -> Result<()> {
    let mut end = 0;
    let ends: Vec<i64> = counts
        .map(|count| {
            end += count as i64;
            end
        })
        .collect();
    let mut document = Document::new("PolyData", &[]);
    let shape = if D == 2 { "Verts" } else { "Lines" };
    document.open(
        "Piece",
        &[
            ("NumberOfPoints", points.len().to_string()),
            (&format!("NumberOf{shape}"), ends.len().to_string()),
        ],
    );
    document.open("PointData", &[]);
    of_points
        .into_iter()
        .for_each(|array| document.add_array(array));
    document.close();
    document.open("CellData", &[]);
    of_lines
        .into_iter()
        .for_each(|array| document.add_array(array));
    document.close();
    document.open("Points", &[]);
    document.add_array(ArraySource::slice("Points", 3, points.as_flattened()));
    document.close();
    document.open(shape, &[]);
    document.add_array(ArraySource::computed(
        "connectivity",
        1,
        points.len(),
        |i| i as i64,
    ));
    document.add_array(ArraySource::slice("offsets", 1, &ends));
    atomic_write(path, |out| document.write(out))
}

/// The angle at each node of a line: the mean of the edges that meet there.
fn node_angles(line: &AcuteLine) -> Vec<f64> {
    let edges = &line.angles;
    let at = |i: usize| {
        let around = &edges[i.saturating_sub(1)..edges.len().min(i + 1)];
        around.iter().sum::<f64>() / around.len() as f64
    };
    (0..line.nodes.len()).map(at).collect()
}
