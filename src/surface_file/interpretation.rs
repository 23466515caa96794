//! Reads surfaces that a user gives: picks of interpreters, and surfaces of other programs.
//!
//! | content of the file | surface |
//! |---|---|
//! | GOCAD `TSurf`, VTK poly data, Wavefront OBJ | its triangles |
//! | a grid of heights: IRAP classic, ZMAP+, CPS-3 | two triangles for each cell with four known heights |
//! | fault sticks: a table with a column `stick`, Charisma's sticks, or GOCAD `PLine` | triangles between neighbouring sticks |
//! | a table of points | points, which [`triangulate_points`] joins |
//!
//! [`point_table`](super::point_table) reads tables.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::SurfaceFile;
use super::has_extension;
use super::point_table::{TableReadings, read_point_table};
use super::sticks::{FaultSticks, Stick, is_charisma, read_charisma};
use super::tsurf::{Gocad, read_gocad};
use super::vtp::read_surfaces;
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::{cross, dot, norm, sub, unit};
use crate::image::Image;
use crate::image::formats::{self, AnyImage, ImageFormat, ReadOptions};
use crate::image::stated::{StatedCoordinates, ZDirection};
use crate::mesh::delaunay::delaunay_plane;
use crate::names;
use crate::units;

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
    let surfaces = if has_extension(path, &["vtp"]) {
        from_triangles(&read_surfaces(path)?, None)
    } else if has_extension(path, &["obj"]) {
        from_triangles(&read_obj(path, &stem)?, None)
    } else if has_extension(path, &["ts", "pl"]) {
        match read_gocad(path)? {
            Gocad::Surfaces(file) => from_triangles(&file, None),
            Gocad::Lines(file) => from_sticks(FaultSticks::from_lines(&file)),
        }
    } else if let Some(format) = grid_format(path)? {
        vec![read_grid(path, format, stem)?]
    } else {
        if is_charisma(&read_text(path)?) {
            from_sticks(read_charisma(path)?)
        } else {
            read_point_table(path, &stem, columns)?
        }
    };
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
        let has_kind = |kind: &str| name.to_lowercase().starts_with(kind);
        PickedSurface {
            is_horizon: is_horizon.or(match (has_kind("horizon"), has_kind("fault")) {
                (true, _) => Some(true),
                (_, true) => Some(false),
                _ => None,
            }),
            name,
            shape: PickedShape::Triangles(triangles),
            coordinates: file.stated.clone(),
            notes: Vec::new(),
        }
    };
    by_name.into_iter().map(surface).collect()
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
    use ImageFormat::{Cps3, Irap, Zmap};
    files::open(path, "give a file of surfaces")?;
    let format = formats::detect(path, &ReadOptions::default()).ok();
    Ok(format.filter(|format| matches!(format, Irap | Zmap | Cps3)))
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

/// Reads the surfaces of an OBJ file: those of each group or object. Polygons are cut into fans.
fn read_obj(path: &Path, stem: &str) -> Result<SurfaceFile<3>> {
    let text = read_text(path)?;
    let mut file = SurfaceFile::<3> {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    for (number, line) in (1..).zip(text.lines()) {
        let refuse = |problem: &str| {
            let place = format!("{}:{number}", path.display());
            Error::Io(cause(place, problem, "export the file again"))
        };
        let mut words = line.split_whitespace();
        match words.next() {
            Some("#") => read_remark(line, &mut file),
            Some("v") => {
                let position: Vec<f64> = words.map_while(|word| word.parse().ok()).collect();
                let position = position.first_chunk::<3>().copied();
                let position = position.filter(|p| p.iter().all(|c| c.is_finite()));
                file.nodes
                    .push(position.ok_or_else(|| refuse("is not a vertex (x, y, z)"))?);
            }
            Some("g" | "o") => {
                let name = names::from_file(&words.collect::<Vec<_>>().join(" "));
                file.names.push(if name.is_empty() {
                    stem.to_string()
                } else {
                    name
                });
                file.surface_starts.push(file.facets.len());
            }
            Some("f") => {
                let count = file.nodes.len() as i64;
                let index = |word: &str| {
                    let number: i64 = word.split('/').next()?.parse().ok()?;
                    let index = if number < 0 {
                        count + number
                    } else {
                        number - 1
                    };
                    (0..count).contains(&index).then_some(index as u32)
                };
                let ring: Option<Vec<u32>> = words.map(index).collect();
                let ring = ring.ok_or_else(|| refuse("names a vertex that does not exist"))?;
                if file.names.is_empty() {
                    file.names.push(stem.to_string());
                    file.surface_starts.push(0);
                }
                file.facets
                    .extend((2..ring.len()).map(|k| [ring[0], ring[k - 1], ring[k]]));
                if let Some(end) = file.surface_starts.last_mut() {
                    *end = file.facets.len();
                }
            }
            _ => {}
        }
    }
    Ok(file)
}

/// Takes what a remark of an OBJ file says about the coordinates: `# units: m,m,ms` and `# z: up`.
fn read_remark(line: &str, file: &mut SurfaceFile<3>) {
    let text = line.trim_start_matches(['#', ' ']);
    if let Some(names) = text.strip_prefix("units:") {
        for (k, name) in names
            .split([',', ' '])
            .filter(|n| !n.is_empty())
            .take(3)
            .enumerate()
        {
            let unit = units::find(name).map(|_| name.to_string());
            file.units[k] = unit.clone().unwrap_or_default();
            file.stated.units[k] = unit;
        }
    }
    if let Some(direction) = text.strip_prefix("z:") {
        let is_up = direction.trim() != "down";
        file.z_up = is_up;
        file.stated.z_direction = Some(ZDirection::from_up(is_up));
    }
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
    lengths.sort_by(f64::total_cmp);
    let max = MAX_EDGE_RATIO * lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
    Ok(triangles
        .into_iter()
        .filter(|t| longest(t) <= max)
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

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
