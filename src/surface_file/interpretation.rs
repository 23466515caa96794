//! Reads surfaces that a user gives: picks of interpreters, and surfaces of other programs.
//!
//! | content of the file | surface |
//! |---|---|
//! | GOCAD `TSurf`, polygons of VTK poly data (`.vtp`, `.vtk`), Wavefront OBJ, STL, PLY | its triangles |
//! | a grid of heights: IRAP classic, ZMAP+, CPS-3, Surfer, ESRI ASCII | two triangles for each cell with four known heights |
//! | fault sticks: a table with a column `stick`, Charisma's sticks, GOCAD `PLine`, or lines of VTK poly data | [`join_sticks`](super::joining::join_sticks) |
//! | a table of points; GOCAD `VSet` | points, which [`triangulate_points`] joins |
//!
//! [`point_table`](super::point_table) reads tables.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::SurfaceFile;
use super::has_extension;
use super::obj::read_obj;
use super::ply::read_ply;
use super::point_table::{TableReadings, read_point_table};
use super::sticks::{FaultSticks, Stick, is_charisma, read_charisma};
use super::stl::read_stl;
use super::tsurf::{GocadKind, GocadObject, read_gocad_objects};
use super::vtp::{read_line_sticks, read_surfaces};
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::spread::{along_path, over_triangles};
use crate::geometry::statistics::upper_median;
use crate::geometry::{cross, dot, norm, sub, unit};
use crate::image::Image;
use crate::image::formats::{self, AnyImage, ImageFormat, ReadOptions};
use crate::image::stated::StatedCoordinates;
use crate::mesh::delaunay::delaunay_plane;
use crate::names;

/// A surface that a user gives, in physical coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedSurface {
    /// Name of the surface, without spaces.
    pub name: String,
    /// `true` for a horizon and `false` for a fault; `None` if its file does not say.
    pub is_horizon: Option<bool>,
    /// The triangles or the points.
    pub shape: PickedShape,
    /// The statements of the file about its coordinates.
    pub coordinates: StatedCoordinates,
    /// Notes on assumptions when the file was read.
    pub notes: Vec<String>,
}

impl PickedSurface {
    /// Returns `true` if two surfaces are one that was given twice: of the same points, in whatever
    /// order, and with the same statements about them.
    pub fn is_duplicate(&self, other: &Self) -> bool {
        let sorted = |mut points: Vec<[f64; 3]>| {
            points.sort_by(|a, b| {
                let order = a.iter().zip(b).map(|(a, b)| a.total_cmp(b));
                order.fold(Ordering::Equal, Ordering::then)
            });
            points
        };
        let has_same_points = match (&self.shape, &other.shape) {
            (PickedShape::Readings(own), PickedShape::Readings(others)) => {
                let mut readings = 0..own.count();
                own.count() == others.count()
                    && readings.all(|k| sorted(own.points(k)) == sorted(others.points(k)))
            }
            (own, others) => {
                std::mem::discriminant(own) == std::mem::discriminant(others)
                    && sorted(own.points().collect()) == sorted(others.points().collect())
            }
        };
        self.coordinates == other.coordinates && has_same_points
    }
}

/// The shape of a surface that a user gives.
#[derive(Debug, Clone, PartialEq)]
pub enum PickedShape {
    /// Triangles.
    Triangles(Vec<[[f64; 3]; 3]>),
    /// Points in no order.
    Points(Vec<[f64; 3]>),
    /// Fault sticks in no order, which [`join_sticks`](super::joining::join_sticks) joins where they
    /// are placed.
    Sticks(Vec<Stick>),
    /// Points of a table that can be read in several ways. The image decides, by
    /// [`TableReadings::fit`].
    Readings(TableReadings),
}

impl PickedShape {
    /// Returns the points, or the corners of the triangles.
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> {
        let (points, sticks, readings) = match self {
            Self::Triangles(triangles) => (triangles.as_flattened(), &[][..], None),
            Self::Points(points) => (points.as_slice(), &[][..], None),
            Self::Sticks(sticks) => (&[][..], sticks.as_slice(), None),
            Self::Readings(table) => (&[][..], &[][..], Some(table.points(0))),
        };
        let of_sticks = sticks.iter().flat_map(|stick| &stick.points);
        let points = points.iter().chain(of_sticks).copied();
        points.chain(readings.into_iter().flatten())
    }

    /// Returns points that are spread evenly over the triangles or along the sticks, about `count` of them,
    /// or the points themselves.
    pub fn spread_points(&self, count: usize) -> Vec<[f64; 3]> {
        match self {
            Self::Triangles(triangles) => over_triangles(triangles, count),
            Self::Sticks(sticks) => {
                let of_stick =
                    |stick: &Stick| along_path(&stick.points, count / sticks.len().max(1));
                sticks.iter().flat_map(of_stick).collect()
            }
            Self::Points(_) | Self::Readings(_) => self.points().collect(),
        }
    }

    /// Replaces each point by `place(point)`. Of a table that can be read in several ways, the first
    /// reading counts.
    ///
    /// # Errors
    /// Returns the first error of `place`.
    pub fn try_map_points(
        &mut self,
        mut place: impl FnMut([f64; 3]) -> Result<[f64; 3]>,
    ) -> Result<()> {
        if let Self::Readings(table) = self {
            *self = Self::Points(table.points(0));
        }
        let (points, sticks) = match self {
            Self::Readings(_) => (&mut [][..], &mut [][..]),
            Self::Triangles(triangles) => (triangles.as_flattened_mut(), &mut [][..]),
            Self::Points(points) => (points.as_mut_slice(), &mut [][..]),
            Self::Sticks(sticks) => (&mut [][..], sticks.as_mut_slice()),
        };
        let of_sticks = sticks.iter_mut().flat_map(|stick| &mut stick.points);
        for point in points.iter_mut().chain(of_sticks) {
            *point = place(*point)?;
        }
        Ok(())
    }
}

/// Reads all surfaces of a file. Surfaces of the same name are one.
///
/// # Errors
/// Returns [`Error::Io`] or [`Error::Job`] if the file cannot be read, is damaged, or holds no surface.
pub fn read_interpretation(path: &Path) -> Result<Vec<PickedSurface>> {
    read_interpretation_as(path, &[])
}

/// Reads all surfaces of a file, as [`read_interpretation`] does. If the file is a table, `columns`
/// names its columns in place of the file; `_` is a column without use.
///
/// # Errors
/// Returns [`Error::Io`] or [`Error::Job`] if the file cannot be read, is damaged, or holds no surface.
pub fn read_interpretation_as(path: &Path, columns: &[String]) -> Result<Vec<PickedSurface>> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let stem = names::from_file(&stem);
    let surfaces = if has_extension(path, &["vtp", "vtk"]) {
        let file = read_surfaces(path)?;
        if file.names.is_empty() {
            from_sticks(read_line_sticks(path)?)
        } else {
            from_triangles(&file, None)
        }
    } else if has_extension(path, &["obj"]) {
        from_triangles(&read_obj(path, &stem)?, None)
    } else if has_extension(path, &["stl"]) {
        from_triangles(&read_stl(path, &stem)?, None)
    } else if has_extension(path, &["ply"]) {
        from_triangles(&read_ply(path, &stem)?, None)
    } else if is_gocad(path)? {
        from_gocad(read_gocad_objects(path)?)
    } else if let Some(format) = grid_format(path)? {
        vec![read_grid(path, format, stem)?]
    } else {
        if is_charisma(&read_text(path)?) {
            from_sticks(read_charisma(path)?)
        } else {
            read_point_table(path, &stem, columns)?
        }
    };
    let surfaces = without_single_sticks(surfaces);
    let is_empty = |surface: &PickedSurface| match &surface.shape {
        PickedShape::Triangles(triangles) => triangles.is_empty(),
        PickedShape::Points(points) => points.is_empty(),
        PickedShape::Sticks(sticks) => sticks.is_empty(),
        PickedShape::Readings(_) => false,
    };
    if surfaces.iter().all(is_empty) {
        let remedy = "give surfaces, grids of heights, at least two fault sticks, or points x,y,z";
        return Err(Error::Io(cause(path.display(), "holds no surface", remedy)));
    }
    Ok(surfaces)
}

/// Returns the surfaces of a file, those of the same name as one.
fn from_triangles(file: &SurfaceFile<3>, is_horizon: Option<bool>) -> Vec<PickedSurface> {
    let mut by_name: BTreeMap<usize, Vec<[[f64; 3]; 3]>> = BTreeMap::new();
    for (s, name) in file.names.iter().enumerate() {
        let first = file.names.iter().position(|other| other == name);
        let facets = file.surface_facets(s).iter();
        let triangles = facets.map(|facet| facet.map(|n| file.nodes[n as usize]));
        by_name
            .entry(first.unwrap_or(s))
            .or_default()
            .extend(triangles);
    }
    let surface = |(s, triangles): (usize, _)| {
        let name = file.names[s].clone();
        PickedSurface {
            is_horizon: is_horizon.or_else(|| kind_of_name(&name)),
            name,
            shape: PickedShape::Triangles(triangles),
            coordinates: file.stated.clone(),
            notes: Vec::new(),
        }
    };
    by_name.into_iter().map(surface).collect()
}

/// Leaves out faults of a single stick if there are other surfaces, which get a note on them.
fn without_single_sticks(surfaces: Vec<PickedSurface>) -> Vec<PickedSurface> {
    let is_single = |surface: &PickedSurface| match &surface.shape {
        PickedShape::Sticks(sticks) => sticks.len() == 1,
        _ => false,
    };
    let (single, mut others): (Vec<_>, Vec<_>) = surfaces.into_iter().partition(is_single);
    let Some(first) = others.first_mut() else {
        return single;
    };
    let note = |fault: PickedSurface| format!("fault {} left out: a single stick", fault.name);
    first.notes.extend(single.into_iter().map(note));
    others
}

/// Returns `true` if a file is one of GOCAD's by its first line.
fn is_gocad(path: &Path) -> Result<bool> {
    let mut head = Vec::new();
    let file = files::open(path, "give a file of surfaces")?;
    file.take(64)
        .read_to_end(&mut head)
        .map_err(|e| io_error(path, "read", e))?;
    Ok(head.trim_ascii_start().starts_with(b"GOCAD "))
}

/// Returns the surfaces of a GOCAD file; if it has none, its lines, which are sticks; or else its
/// points. Objects of one name that state the same of their coordinates are one.
fn from_gocad(objects: Vec<GocadObject>) -> Vec<PickedSurface> {
    let kinds = [GocadKind::Surface, GocadKind::Lines, GocadKind::Points];
    let is_there = |kind: &GocadKind| objects.iter().any(|object| object.kind == *kind);
    let kind = kinds.into_iter().find(is_there);
    let mut surfaces: Vec<PickedSurface> = Vec::new();
    for object in objects
        .into_iter()
        .filter(|object| Some(object.kind) == kind)
    {
        let nodes = &object.nodes;
        let place = |n: u32| nodes[n as usize];
        let shape = match object.kind {
            GocadKind::Surface => {
                PickedShape::Triangles(object.triangles.iter().map(|t| t.map(place)).collect())
            }
            GocadKind::Lines => {
                let lines = (1..).zip(&object.lines);
                let stick = |(number, (line, nodes)): (usize, &(usize, Vec<u32>))| Stick {
                    name: number.to_string(),
                    line: Some(*line),
                    points: nodes.iter().map(|&n| place(n)).collect(),
                };
                PickedShape::Sticks(lines.map(stick).collect())
            }
            GocadKind::Points => PickedShape::Points(object.nodes),
        };
        let is_horizon = match object.kind {
            GocadKind::Lines => object.is_horizon.or(Some(false)),
            _ => object.is_horizon.or_else(|| kind_of_name(&object.name)),
        };
        let same = (surfaces.iter_mut())
            .find(|s| s.name == object.name && s.coordinates == object.coordinates);
        match (same.map(|s| &mut s.shape), shape) {
            (Some(PickedShape::Triangles(all)), PickedShape::Triangles(more)) => all.extend(more),
            (Some(PickedShape::Sticks(all)), PickedShape::Sticks(more)) => all.extend(more),
            (Some(PickedShape::Points(all)), PickedShape::Points(more)) => all.extend(more),
            (_, shape) => surfaces.push(PickedSurface {
                name: object.name,
                is_horizon,
                shape,
                coordinates: object.coordinates,
                notes: Vec::new(),
            }),
        }
    }
    surfaces
}

/// Returns `true` if a surface is a horizon by its name, and `false` if it is a fault.
fn kind_of_name(name: &str) -> Option<bool> {
    let name = name.to_lowercase();
    match (name.starts_with("horizon"), name.starts_with("fault")) {
        (true, _) => Some(true),
        (_, true) => Some(false),
        _ => None,
    }
}

/// Returns the faults of a file. Their sticks are joined when they are placed in the image.
fn from_sticks(faults: Vec<FaultSticks>) -> Vec<PickedSurface> {
    let surface = |fault: FaultSticks| PickedSurface {
        name: names::from_file(&fault.name),
        is_horizon: Some(false),
        shape: PickedShape::Sticks(fault.sticks),
        coordinates: fault.coordinates,
        notes: Vec::new(),
    };
    faults.into_iter().map(surface).collect()
}

/// Returns the format of a file if it is a grid of heights.
fn grid_format(path: &Path) -> Result<Option<ImageFormat>> {
    files::open(path, "give a file of surfaces")?;
    let format = formats::detect(path, &ReadOptions::default()).ok();
    Ok(format.filter(|format| format.is_height_grid()))
}

fn read_grid(path: &Path, format: ImageFormat, name: String) -> Result<PickedSurface> {
    let AnyImage::Plane(grid) = formats::read_any(path, &ReadOptions::default())? else {
        let problem = format!("is not a grid of heights, but {format}");
        let remedy = "give a grid z(x, y)";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    };
    Ok(PickedSurface {
        name,
        is_horizon: Some(true),
        shape: PickedShape::Triangles(grid_triangles(&grid.image)),
        coordinates: StatedCoordinates::default(),
        notes: Vec::new(),
    })
}

/// Returns two triangles for each cell of a grid whose four heights are known.
fn grid_triangles(grid: &Image<2>) -> Vec<[[f64; 3]; 3]> {
    let [nx, ny] = grid.dims();
    let node = |i: usize, j: usize| {
        let [x, y] = grid.geometry.to_physical([i as f64, j as f64]);
        [x, y, f64::from(grid.as_slice()[i + nx * j])]
    };
    let mut triangles = Vec::new();
    for j in 1..ny {
        for i in 1..nx {
            let [a, b, c, d] = [
                node(i - 1, j - 1),
                node(i, j - 1),
                node(i, j),
                node(i - 1, j),
            ];
            if [a, b, c, d].iter().all(|p| p[2].is_finite()) {
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    triangles
}

fn read_text(path: &Path) -> Result<String> {
    let mut bytes = Vec::new();
    let mut file = files::open(path, "give a file of surfaces")?;
    file.read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Longest edge of a triangle between points, in units of the median of all triangles' longest
/// edges. Longer ones close gaps or bays of the outline.
const MAX_EDGE_RATIO: f64 = 4.0;

/// Smallest height of a triangle, in units of its longest edge, that is not due to rounding.
const MIN_HEIGHT_RATIO: f64 = 1e-6;

/// Joins points to triangles: the Delaunay triangles of the points' projections onto the plane that
/// fits them best, without those that have an edge of more than `MAX_EDGE_RATIO` times the median
/// of longest edges. Of points with the same projection, the first counts.
///
/// # Errors
/// Returns an error for points on one line.
pub fn triangulate_points(points: &[[f64; 3]]) -> Result<Vec<[[f64; 3]; 3]>> {
    let count = points.len().max(1) as f64;
    let mean = points.iter().fold([0.0; 3], |sum, p| {
        std::array::from_fn(|k| sum[k] + p[k] / count)
    });
    let mut moments = [[0.0; 3]; 3];
    for p in points {
        let r = sub(*p, mean);
        for k in 0..3 {
            for l in 0..3 {
                moments[k][l] += r[k] * r[l];
            }
        }
    }
    let normal = eigenvector(&moments, eigenvalues(&moments)[0]);
    // Any two directions that span the plane.
    let least = (0..3).fold(0, |best, k| {
        if normal[k].abs() < normal[best].abs() {
            k
        } else {
            best
        }
    });
    let u = unit(cross(
        normal,
        std::array::from_fn(|k| f64::from(u8::from(k == least))),
    ));
    let v = cross(normal, u);
    let mut projected: Vec<([f64; 2], usize)> = (points.iter().enumerate())
        .map(|(i, p)| ([dot(sub(*p, mean), u), dot(sub(*p, mean), v)], i))
        .collect();
    projected.sort_by(|a, b| {
        (a.0[0].total_cmp(&b.0[0]))
            .then(a.0[1].total_cmp(&b.0[1]))
            .then(a.1.cmp(&b.1))
    });
    projected.dedup_by_key(|(place, _)| *place);
    let places: Vec<[f64; 2]> = projected.iter().map(|(place, _)| *place).collect();
    let mesh = delaunay_plane(&places)?;
    let corners = |t: &[u32; 3]| t.map(|n| points[projected[n as usize].1]);
    let triangles: Vec<[[f64; 3]; 3]> = mesh.triangles.iter().map(corners).collect();
    let longest = |t: &[[f64; 3]; 3]| {
        [(0, 1), (1, 2), (2, 0)]
            .iter()
            .fold(0.0, |longest: f64, &(a, b)| {
                longest.max(norm(sub(t[b], t[a])))
            })
    };
    let height = |t: &[[f64; 3]; 3]| norm(cross(sub(t[1], t[0]), sub(t[2], t[0]))) / longest(t);
    if !triangles
        .iter()
        .any(|t| height(t) > MIN_HEIGHT_RATIO * longest(t))
    {
        let problem = "lie on one line";
        return Err(Error::Delaunay(cause(
            "points",
            problem,
            "give points of a surface",
        )));
    }
    let mut lengths: Vec<f64> = triangles.iter().map(longest).collect();
    let max = MAX_EDGE_RATIO * upper_median(&mut lengths).unwrap_or(0.0);
    Ok(triangles
        .into_iter()
        .filter(|t| longest(t) <= max)
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_planes_across_each_axis_are_joined() {
        for axis in 0..3 {
            let place = |i: i32| {
                let mut p = [19.0; 3];
                p[(axis + 1) % 3] = 1.75 * f64::from(i % 21);
                p[(axis + 2) % 3] = 1.55 * f64::from(i / 21);
                p
            };
            let points: Vec<[f64; 3]> = (0..441).map(place).collect();
            assert_eq!(triangulate_points(&points).unwrap().len(), 800, "{axis}");
        }
    }

    fn write(folder: &Path, name: &str, text: &str) -> std::path::PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn points_of_programs_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let expected = vec![
            [500.5, 700.0, -3.25],
            [510.0, 700.0, -4.0],
            [500.0, 710.0, -5.0],
        ];
        for text in [
            "500.5 700 -3.25\n510 700 -4\n500 710 -5\n",
            "# x y z\nX,Y,Z\n500.5,700,-3.25\n510,700,-4\n500,710,-5\n",
            "z;x;y\n-3.25;500.5;700\n-4;510;700\n-5;500;710\n",
            "500.5 700 -3.25 1.5\n510 700 -4 1.5\n500 710 -5 2.5\n",
        ] {
            let path = write(folder.path(), "top A.xyz", text);
            let read = read_interpretation(&path).unwrap();
            assert_eq!(read.len(), 1);
            assert_eq!((&*read[0].name, read[0].is_horizon), ("top A", None));
            assert_eq!(
                read[0].shape,
                PickedShape::Points(expected.clone()),
                "{text}"
            );
        }
        let text = "quality,x,y,z\ngood,1,2,3\npoor,,5,6\n,4,5,6\n";
        let read = read_interpretation(&write(folder.path(), "c.xyz", text)).unwrap();
        let expected = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        assert_eq!(read[0].shape, PickedShape::Points(expected));
        let path = write(folder.path(), "a.xyz", "1 2 3\n1 2\n");
        let message = read_interpretation(&path).unwrap_err().to_string();
        assert!(message.contains("a.xyz:2: has 2 numbers; "), "{message}");
        let path = write(folder.path(), "b.xyz", "nothing\n");
        assert!(read_interpretation(&path).is_err());
    }

    #[test]
    fn surfaces_of_one_name_are_one_and_names_tell_kinds() {
        let folder = tempfile::tempdir().unwrap();
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\no Fault A\nf 1 2 3\ng top\nf 1/1 3/2 4/3\n\
                    g Fault A\nf -4 -3 -2 -1\n";
        let read = read_interpretation(&write(folder.path(), "a.obj", text)).unwrap();
        let summary: Vec<_> = (read.iter())
            .map(|s| match &s.shape {
                PickedShape::Triangles(t) => (&*s.name, s.is_horizon, t.len()),
                _ => panic!("no triangles"),
            })
            .collect();
        assert_eq!(summary, [("Fault A", Some(false), 3), ("top", None, 1)]);
        let path = write(folder.path(), "b.obj", "v 0 0 0\nf 1 2 3\n");
        let message = read_interpretation(&path).unwrap_err().to_string();
        assert!(message.contains("b.obj:2: "), "{message}");
        let path = write(
            folder.path(),
            "s.csv",
            "fault,stick,x,y,z\nA,1,0,0,0\nA,1,0,0,-9\nA,2,9,0,0\nA,2,9,0,-9\n",
        );
        let read = read_interpretation(&path).unwrap();
        assert_eq!((&*read[0].name, read[0].is_horizon), ("A", Some(false)));
    }

    #[test]
    fn grids_leave_out_cells_without_heights() {
        let folder = tempfile::tempdir().unwrap();
        let mut grid = Image::from_fn(
            [4, 3],
            crate::image::Geometry::with_spacing([100.0, 50.0], [10.0, 5.0]),
            |x| 0.1 * x[0] - 0.2 * x[1],
        );
        let path = folder.path().join("top.irap");
        formats::write(&path, &grid).unwrap();
        let area = |path: &Path| {
            let read = read_interpretation(path).unwrap();
            assert_eq!((&*read[0].name, read[0].is_horizon), ("top", Some(true)));
            let PickedShape::Triangles(triangles) = &read[0].shape else {
                panic!("no triangles")
            };
            for p in triangles.as_flattened() {
                assert!((p[2] - 0.1 * p[0] + 0.2 * p[1]).abs() < 1e-4, "{p:?}");
            }
            triangles.len()
        };
        assert_eq!(area(&path), 12);
        let mut samples = grid.as_slice().to_vec();
        samples[0] = f32::NAN;
        grid = Image::new(grid.dims(), samples, grid.geometry.clone());
        formats::write(&path, &grid).unwrap();
        assert_eq!(area(&path), 10);
    }

    /// Returns the name, kind, count of parts and statements of each surface.
    fn summaries(path: &Path) -> Vec<(String, Option<bool>, usize, StatedCoordinates)> {
        let count = |shape: &PickedShape| match shape {
            PickedShape::Triangles(triangles) => triangles.len(),
            PickedShape::Sticks(sticks) => sticks.len(),
            _ => shape.points().count(),
        };
        let summary = |s: PickedSurface| {
            let count = count(&s.shape);
            (s.name, s.is_horizon, count, s.coordinates)
        };
        read_interpretation(path)
            .unwrap()
            .into_iter()
            .map(summary)
            .collect()
    }

    #[test]
    fn gocad_objects_state_their_units_directions_and_kinds() {
        let folder = tempfile::tempdir().unwrap();
        let system = |units: &str, positive: &str| {
            format!(
                "GOCAD_ORIGINAL_COORDINATE_SYSTEM\nNAME Default\nAXIS_UNIT {units}\nZPOSITIVE {positive}\nEND_ORIGINAL_COORDINATE_SYSTEM\n"
            )
        };
        let part = "TFACE\nVRTX 1 0 0 1\nPVRTX 2 1 0 1 -99999\nVRTX 3 0 1 1\nATOM 4 2\nTRGL 1 2 3\n\
                    TFACE\nVRTX 5 9 9 9\nTRGL 4 3 5\nEND\n";
        let text = format!(
            "GOCAD TSurf 1\nHEADER {{ name: Main fault }}\n{}PROPERTIES p\nNO_DATA_VALUES -99999\n{part}\
             GOCAD TSurf 1\nHEADER {{\n*name:\"Top A\"\n}}\n{}GEOLOGICAL_TYPE top\n{part}",
            system("\"m\" \"m\" \"ft\"", "Depth"),
            system("m m ms", "elevation")
        );
        let read = summaries(&write(folder.path(), "a.ts", &text));
        let units = |z: &str| ["m", "m", z].map(|unit| Some(unit.to_string()));
        let stated = |z: &str, direction| StatedCoordinates {
            units: units(z),
            z_direction: Some(direction),
            ..StatedCoordinates::default()
        };
        use crate::image::stated::ZDirection::{Down, Up};
        let expected = [
            ("Main fault".to_string(), None, 2, stated("ft", Down)),
            ("Top A".to_string(), Some(true), 2, stated("ms", Up)),
        ];
        assert_eq!(read, expected);
        // Lines are sticks, also without segments or with segments in another order.
        let line = "VRTX 1 0 0 0\nVRTX 2 0 0 -1\nVRTX 3 0 0 -2\n";
        let text = format!(
            "GOCAD PLine 1\nHEADER {{\nname:f\n}}\nILINE\n{line}SEG 2 3\nSEG 1 2\nILINE\n\
             VRTX 4 9 0 0\nVRTX 5 9 0 -2\nEND\n"
        );
        let read = read_interpretation(&write(folder.path(), "a.pl", &text)).unwrap();
        let PickedShape::Sticks(sticks) = &read[0].shape else {
            panic!("no sticks")
        };
        let summary: Vec<_> = sticks.iter().map(|s| (s.line, s.points.len())).collect();
        assert_eq!(summary, [(Some(5), 3), (Some(11), 2)]);
        assert!(sticks[0].points[1] == [0.0, 0.0, -1.0] && read[0].is_horizon == Some(false));
        let text =
            "GOCAD VSet 1\nHEADER {\nname: horizon picks\n}\nVRTX 1 0 0 3\nPVRTX 2 1 1 3 7\nEND\n";
        let read = summaries(&write(folder.path(), "a.vs", text));
        let expected = (
            "horizon picks".to_string(),
            Some(true),
            2,
            StatedCoordinates::default(),
        );
        assert_eq!(read, [expected]);
    }

    #[test]
    fn poly_data_of_each_format_has_triangles_strips_or_sticks() {
        let folder = tempfile::tempdir().unwrap();
        let points = "POINTS 4 float\n0 0 0 1 0 0 0 1 0 1 1 2\n";
        let head = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\n";
        for (name, cells, is_sticks) in [
            ("polygons.vtk", "POLYGONS 2 8\n3 0 1 2\n3 1 3 2\n", false),
            ("strips.vtk", "TRIANGLE_STRIPS 1 5\n4 0 1 2 3\n", false),
            ("lines.vtk", "LINES 2 6\n2 0 1\n2 2 3\n", true),
        ] {
            let path = write(folder.path(), name, &format!("{head}{points}{cells}"));
            let read = read_interpretation(&path).unwrap();
            assert_eq!(read[0].name, name.trim_end_matches(".vtk"));
            let PickedSurface { shape, .. } = &read[0];
            assert_eq!(matches!(shape, PickedShape::Sticks(_)), is_sticks, "{name}");
            let corners: Vec<[f64; 3]> = shape.points().collect();
            let expected = if is_sticks { 4 } else { 6 };
            assert_eq!(corners.len(), expected, "{name}");
            assert!(corners.contains(&[1.0, 1.0, 2.0]), "{name}");
        }
    }

    #[test]
    fn sticks_of_each_writer_make_the_same_surface_again() {
        use crate::surface_file::sticks::{write_charisma, write_sticks};
        use crate::surface_file::tsurf::write_tsurf;
        let folder = tempfile::tempdir().unwrap();
        let point = |i: usize, j: usize| {
            let (along, down) = (40.0 * i as f64, 25.0 * j as f64);
            [500.0 + 0.5 * down, along, -100.0 - down]
        };
        let stick = |i: usize| Stick {
            name: i.to_string(),
            line: None,
            points: (0..5).map(|j| point(i, j)).collect(),
        };
        let faults = [FaultSticks {
            name: "Main fault".into(),
            sticks: [0, 3, 1, 4, 2].map(stick).to_vec(),
            ..FaultSticks::default()
        }];
        let area = |t: &[[f64; 3]; 3]| 0.5 * norm(cross(sub(t[1], t[0]), sub(t[2], t[0])));
        let exact = 160.0 * 100.0 * norm([0.5, 1.0]);
        let path = |ending: &str| folder.path().join(format!("a.{ending}"));
        write_sticks(&path("csv"), &faults).unwrap();
        write_charisma(&path("charisma"), &faults, true, |_| [1, 2]).unwrap();
        write_tsurf(&path("pl"), &FaultSticks::to_lines(&faults)).unwrap();
        for ending in ["csv", "charisma", "pl"] {
            let read = read_interpretation(&path(ending)).unwrap();
            assert_eq!((read.len(), &*read[0].name), (1, "Main fault"), "{ending}");
            let PickedShape::Sticks(sticks) = &read[0].shape else {
                panic!("{ending}: no sticks")
            };
            let joined = super::super::joining::join_sticks("F", sticks, [1.0; 3]).unwrap();
            let total: f64 = joined.triangles.iter().map(area).sum();
            assert!(
                (total / exact - 1.0).abs() < 1e-6,
                "{ending}: {total} {exact}"
            );
        }
    }

    #[test]
    fn duplicates_have_the_same_points_in_any_order() {
        let sticks = |points: Vec<Vec<[f64; 3]>>| PickedSurface {
            name: "F".into(),
            is_horizon: None,
            shape: PickedShape::Sticks(
                (points.into_iter())
                    .map(|points| Stick {
                        points,
                        ..Stick::default()
                    })
                    .collect(),
            ),
            coordinates: StatedCoordinates::default(),
            notes: Vec::new(),
        };
        let [a, b, c] = [[0.0; 3], [1.0; 3], [2.0; 3]];
        let first = sticks(vec![vec![a, b], vec![c]]);
        assert!(first.is_duplicate(&sticks(vec![vec![c], vec![b, a]])));
        assert!(!first.is_duplicate(&sticks(vec![vec![c], vec![b, b]])));
    }

    #[test]
    fn points_are_joined_in_their_plane_and_bays_stay_open() {
        // An L of a plane that is nearly upright.
        let mut points = Vec::new();
        for i in 0..20 {
            for j in 0..20 {
                if i < 8 || j < 8 {
                    let (a, b) = (f64::from(i), f64::from(j));
                    points.push([3.0 * a + 0.2 * b, 500.0 + a - 0.1 * b, 2.0 * b]);
                }
            }
        }
        let cell = norm(cross([3.0, 1.0, 0.0], [0.2, -0.1, 2.0]));
        let area = |triangles: &[[[f64; 3]; 3]]| -> f64 {
            let area = |t: &[[f64; 3]; 3]| 0.5 * norm(cross(sub(t[1], t[0]), sub(t[2], t[0])));
            triangles.iter().map(area).sum()
        };
        let joined = area(&triangulate_points(&points).unwrap());
        let exact = cell * (19.0 * 19.0 - 12.0 * 12.0);
        // The corner of the bay may be cut by triangles of four cells.
        assert!(
            joined >= exact - 1e-6 && joined < exact + 12.0 * cell,
            "{joined} {exact}"
        );
        assert!(triangulate_points(&points[..8]).is_err(), "on one line");
    }
}
