//! Outlines of the part of an image that is kept: polygons in map view, and masks.

use std::collections::BTreeMap;
use std::path::Path;

use super::{AnyImage, LoadedImage, ReadOptions, detect, read_any};
use crate::error::{Error, Result, cause, io_error};
use crate::files::table::{Table, TableRow, Term, X_TERM, Y_TERM};
use crate::files::vtk::VtkFile;
use crate::files::vtk::pieces::{read_cell_integers, read_count, read_nodes};
use crate::geometry::grid_index::index_at;
use crate::image::Image;
use crate::image::formats::with_loaded;
use crate::image::time::metres_per_unit;
use crate::parallel::prelude::*;

const REMEDY: &str = "give a table of x,y, a closed GOCAD line (.pl), lines or polygons (.vtp), or an image that is not 0 inside";

/// Function that returns the part of a mask of the whole image that belongs to a cropped one.
pub(super) type FitMask<'a> = &'a dyn Fn(AnyImage) -> Result<AnyImage>;

/// Returns a flag for each sample of an image: `true` for those that a file keeps, which are inside its
/// polygons, or where the image that it holds is not zero. `fit` returns the part of a mask of the
/// whole image that belongs to this one.
///
/// # Errors
/// Returns the errors of reading the file, and [`Error::Image`] if it holds neither.
fn kept_samples<const D: usize>(
    path: &Path,
    image: &Image<D>,
    fit: FitMask<'_>,
) -> Result<Vec<bool>> {
    let dims = image.dims();
    if detect(path, &ReadOptions::default()).is_ok() && !is_polygon_file(path) {
        let mask = fit(read_any(path, &ReadOptions::default())?)?;
        let mask = mask.into_image::<D>().filter(|mask| mask.dims() == dims);
        let Some(mask) = mask else {
            let problem = format!("has other samples than the image ({dims:?})");
            let error = cause(path.display(), problem, REMEDY);
            return Err(Error::Image(error.with_parameter("inside")));
        };
        let is_kept = |s: &f32| s.is_finite() && *s != 0.0;
        return Ok(mask.as_slice().iter().map(is_kept).collect());
    }
    let polygon = Polygon::read(path, &image.geometry.units[..2])?;
    let count: usize = dims.iter().product();
    let is_kept = |i: usize| {
        let index = index_at(dims, i).map(|i| i as f64);
        let position = image.geometry.to_physical(index);
        polygon.contains([position[0], position[1]])
    };
    Ok((0..count).into_par_iter().map(is_kept).collect())
}

/// Returns the image with NaN outside what a file keeps, and a note.
fn without_outside<const D: usize>(
    mut loaded: LoadedImage<D>,
    path: &Path,
    fit: FitMask<'_>,
) -> Result<LoadedImage<D>> {
    let kept = kept_samples(path, &loaded.image, fit)?;
    let count = kept.iter().filter(|kept| **kept).count();
    if count == 0 {
        let problem = "holds no sample of the image";
        let remedy = "give an outline in the coordinates of the image";
        let error = cause(path.display(), problem, remedy);
        return Err(Error::Image(error.with_parameter("inside")));
    }
    let samples = loaded.image.samples.iter_mut().zip(&kept);
    samples
        .filter(|(_, kept)| !**kept)
        .for_each(|(sample, _)| *sample = f32::NAN);
    loaded.notes.push(format!(
        "{count} samples ({:.2} %) lie inside {}; the others are left out",
        100.0 * count as f64 / kept.len() as f64,
        path.display()
    ));
    Ok(loaded)
}

/// Returns `true` if a file holds lines or polygons, not an image.
fn is_polygon_file(path: &Path) -> bool {
    VtkFile::read(path, "PolyData").is_ok()
}

/// Areas in map view, given by the edges of their outlines. A point is inside if a line from it to
/// infinity crosses an odd number of edges, so that outlines within outlines are holes.
struct Polygon {
    edges: Vec<[[f64; 2]; 2]>,
}

impl Polygon {
    /// Reads the outlines in a file, closes one that is open, and converts lengths to those of an image
    /// whose x and y have these units.
    fn read(path: &Path, units: &[String]) -> Result<Self> {
        let Outlines {
            edges,
            units: own_units,
        } = if is_polygon_file(path) {
            Outlines {
                edges: vtk_edges(path)?,
                units: [None, None],
            }
        } else {
            let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
            if text.trim_start().starts_with("GOCAD") {
                gocad_outlines(&text)
            } else {
                table_outlines(path)?
            }
        };
        let factor = |k: usize| {
            let [own, of_image] = [own_units[k].as_deref(), units.get(k).map(String::as_str)]
                .map(|unit| unit.and_then(metres_per_unit));
            match (own, of_image) {
                (Some(own), Some(of_image)) if own != of_image => own / of_image,
                _ => 1.0,
            }
        };
        let factors = [factor(0), factor(1)];
        let edges = edges
            .into_iter()
            .map(|edge| edge.map(|[x, y]: [f64; 2]| [x * factors[0], y * factors[1]]));
        let refuse = |problem: String| {
            Error::Image(cause(path.display(), problem, REMEDY).with_parameter("inside"))
        };
        let mut edges: Vec<_> = edges.filter(|[a, b]| a != b).collect();
        let mut uses: BTreeMap<[u64; 2], usize> = BTreeMap::new();
        for end in edges.iter().flatten() {
            *uses.entry(end.map(f64::to_bits)).or_default() += 1;
        }
        let open = uses.iter().filter(|(_, count)| *count % 2 == 1);
        let open: Vec<[f64; 2]> = open.map(|(end, _)| end.map(f64::from_bits)).collect();
        match open[..] {
            [] => {}
            [a, b] => edges.push([a, b]),
            _ => return Err(refuse(format!("has lines with {} open ends", open.len()))),
        }
        if edges.len() < 3 {
            return Err(refuse("has no outline of three points or more".into()));
        }
        Ok(Self { edges })
    }

    fn contains(&self, [x, y]: [f64; 2]) -> bool {
        let crosses = |[a, b]: &&[[f64; 2]; 2]| {
            (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        };
        self.edges.iter().filter(crosses).count() % 2 == 1
    }
}

/// Returns the edges of a ring or a line of points.
fn edges_of(points: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> {
    points.windows(2).map(|pair| [pair[0], pair[1]])
}

/// The outlines in a file.
struct Outlines {
    edges: Vec<[[f64; 2]; 2]>,
    /// The units of x and y, if the file says them.
    units: [Option<String>; 2],
}

/// A column that tells rings apart.
const RING_TERM: Term = Term::new(
    "ring",
    &[
        "ringid",
        "polygon",
        "polygonid",
        "poly",
        "polyid",
        "part",
        "partid",
        "shape",
        "shapeid",
        "outline",
        "line",
        "lineid",
        "id",
        "name",
    ],
);

/// Returns the first column that tells rings apart. One whose values change from row to row numbers points.
fn ring_column(table: &Table) -> Option<usize> {
    let rows: Vec<TableRow<'_>> = table.rows().collect();
    let is_ring = |&k: &usize| {
        let changes = (rows.windows(2)).filter(|pair| pair[0].text(k) != pair[1].text(k));
        table.columns()[k].term == Some(RING_TERM.name) && 3 * changes.count() < rows.len()
    };
    (0..table.columns().len()).find(is_ring)
}

/// Reads the outlines of a table of points. A ring ends at its first point, where a segment does, or where
/// the value in a column of rings changes.
fn table_outlines(path: &Path) -> Result<Outlines> {
    let table = Table::read(path, &[X_TERM, Y_TERM, RING_TERM])?;
    let columns = match (table.column("x")?, table.column("y")?) {
        (Some(x), Some(y)) => [x, y],
        _ if !table.has_names() && (2..=3).contains(&table.columns().len()) => [0, 1],
        _ => return Err(table.error("has no columns x and y", REMEDY)),
    };
    let mut edges = Vec::new();
    let mut close = |ring: &mut Vec<[f64; 2]>| {
        if ring.len() > 2 {
            ring.push(ring[0]);
        }
        edges.extend(edges_of(ring));
        ring.clear();
    };
    let ring_column = ring_column(&table);
    let mut ring: Vec<[f64; 2]> = Vec::new();
    let mut part: (usize, Option<String>) = (0, None);
    for row in table.rows() {
        let mut point = [0.0; 2];
        for (value, column) in point.iter_mut().zip(columns) {
            let number = row.number(column)?;
            *value = number.ok_or_else(|| row.error("is not a point", REMEDY))?;
        }
        let name = ring_column.and_then(|column| row.text(column));
        let name = name.map(String::from);
        if (row.segment, &name) != (part.0, &part.1) {
            close(&mut ring);
            part = (row.segment, name);
        }
        let ends_ring = ring.len() > 2 && ring[0] == point;
        ring.push(point);
        if ends_ring {
            close(&mut ring);
        }
    }
    close(&mut ring);
    let general = table.remark_text(&["units", "unit", "coordinateunits", "xyunits", "xyunit"]);
    let units = columns.map(|column| {
        let own = table.columns()[column].unit.as_deref();
        own.or(general).map(String::from)
    });
    Ok(Outlines { edges, units })
}

/// Returns the outlines in a GOCAD file.
fn gocad_outlines(text: &str) -> Outlines {
    let mut edges = Vec::new();
    let mut units = [None, None];
    let mut vertices: BTreeMap<&str, [f64; 2]> = BTreeMap::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["GOCAD", ..] => vertices.clear(),
            ["AXIS_UNIT", x, y, ..] => {
                units = [x, y].map(|unit| Some(unit.trim_matches('"').to_string()));
            }
            ["VRTX" | "PVRTX", id, x, y, ..] => {
                if let (Ok(x), Ok(y)) = (x.parse(), y.parse()) {
                    vertices.insert(id, [x, y]);
                }
            }
            ["SEG", a, b, ..] => {
                if let (Some(a), Some(b)) = (vertices.get(a), vertices.get(b)) {
                    edges.push([*a, *b]);
                }
            }
            _ => {}
        }
    }
    Outlines { edges, units }
}

/// Reads the edges of the lines and polygons in VTK poly data.
fn vtk_edges(path: &Path) -> Result<Vec<[[f64; 2]; 2]>> {
    let file = VtkFile::read(path, "PolyData")?;
    let piece = file.piece()?;
    let count = read_count(&file, piece, "NumberOfPoints")?;
    let nodes: Vec<[f64; 3]> = read_nodes(&file, file.child(piece, "Points")?, count)?;
    let mut edges = Vec::new();
    for (name, is_ring) in [("Lines", false), ("Polys", true)] {
        let Ok(cells) = file.child(piece, name) else {
            continue;
        };
        let corners = read_cell_integers(&file, cells, "connectivity")?;
        let mut start = 0;
        for end in read_cell_integers(&file, cells, "offsets")? {
            let end = usize::try_from(end).unwrap_or(0).min(corners.len());
            let corner = |n: &i64| usize::try_from(*n).ok().and_then(|n| nodes.get(n));
            let ring = corners
                .get(start..end)
                .unwrap_or_default()
                .iter()
                .filter_map(corner);
            let mut ring: Vec<[f64; 2]> = ring.map(|&[x, y, _]| [x, y]).collect();
            if is_ring && let Some(&first) = ring.first() {
                ring.push(first);
            }
            edges.extend(edges_of(&ring));
            start = end;
        }
    }
    Ok(edges)
}

/// Returns an image of any dimension with NaN outside what a file keeps, and a note. `fit` is as in
/// [`kept_samples`].
///
/// # Errors
/// Returns the errors of [`kept_samples`], and [`Error::Image`] if nothing is kept.
pub(super) fn any_without_outside(
    image: AnyImage,
    path: &Path,
    fit: FitMask<'_>,
) -> Result<AnyImage> {
    Ok(with_loaded!(image, loaded => without_outside(loaded, path, fit)?.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_of_every_format_keep_the_same_points() {
        let folder = tempfile::tempdir().unwrap();
        let metres = ["m".to_string(), "m".to_string()];
        let feet = |c: f64| c / 0.3048;
        let in_feet = |points: &[[f64; 2]]| -> String {
            let row = |[x, y]: &[f64; 2]| format!("{},{}\n", feet(*x), feet(*y));
            points.iter().map(row).collect()
        };
        let rings = [
            [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]],
            [[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]],
        ];
        let closed = rings.map(|[a, b, c, d]| in_feet(&[a, b, c, d, a])).concat();
        let columns = format!("X (ft),Y (ft)\n{closed}");
        let remark = format!("# units: ft\nx,y\n{closed}");
        let files = [
            ("feet.csv", &*columns),
            ("remark.csv", &*remark),
            (
                "open.csv",
                "POLY_ID,x,y,point\n1,0,0,1\n1,10,0,2\n1,10,10,3\n1,0,10,4\n2,4,4,1\n2,6,4,2\n2,6,6,3\n2,4,6,4\n",
            ),
            (
                "a.csv",
                "x,y\n0,0\n10,0\n10,10\n0,10\n0,0\n4,4\n6,4\n6,6\n4,6\n4,4\n",
            ),
            (
                "b.csv",
                "x;y;z\n0;0;7\n10;0;7\n10;10;7\n0;10;7\n0;0;7\n4;4;7\n4;6;7\n6;6;7\n6;4;7\n",
            ),
            (
                "c.pl",
                "GOCAD PLine 1\nHEADER {\nname:a\n}\nILINE\nVRTX 1 0 0 7\nVRTX 2 10 0 7\nVRTX 3 10 10 7\n\
                 VRTX 4 0 10 7\nSEG 1 2\nSEG 2 3\nSEG 3 4\nSEG 4 1\nILINE\nVRTX 5 4 4 7\nVRTX 6 6 4 7\n\
                 VRTX 7 6 6 7\nVRTX 8 4 6 7\nSEG 5 6\nSEG 6 7\nSEG 7 8\nEND\n",
            ),
        ];
        for (name, text) in files {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let polygon = Polygon::read(&path, &metres).unwrap();
            for (point, inside) in [
                ([1.0, 1.0], true),
                ([9.5, 5.0], true),
                ([5.0, 5.0], false),
                ([-1.0, 5.0], false),
                ([5.0, 10.5], false),
            ] {
                assert_eq!(polygon.contains(point), inside, "{name} {point:?}");
            }
        }
        let path = folder.path().join("two.csv");
        std::fs::write(&path, "0,0\n1,1\n").unwrap();
        let message = Polygon::read(&path, &metres).err().unwrap().to_string();
        assert!(message.contains("three points"), "{message}");
    }
}
