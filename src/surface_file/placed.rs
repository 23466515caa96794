//! Brings a surface that a user gives into the frame of an image, and drops its null values.

use super::interpretation::{PickedShape, PickedSurface};
use super::point_table::{ReadingFrame, TableReadings};
use super::sticks::Stick;
use crate::error::{Error, Result, cause};
use crate::image::placing::{Frame, GivenFile, MAX_TESTED_POINTS, Region};
use crate::image::point_nulls::{NullSearch, consecutive_pairs, pairs_in_plan};
use crate::image::stated::CoordinateOptions;

/// A surface in the physical coordinates of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedSurface {
    /// The triangles or the points.
    pub shape: PickedShape,
    /// The share of it that lies in the image.
    pub share: f64,
    /// Parts of sentences on what was read, assumed, turned and dropped.
    pub notes: Vec<String>,
}

impl PickedSurface {
    /// Returns the surface in the frame of an image. `place` is the option that gives it, for
    /// messages, and `options` says what the file does not say.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for coordinates that do not suit the image ([`Frame::placing`]), and for
    /// a surface that consists of null values.
    pub fn placed<const D: usize>(
        &self,
        frame: &Frame<D>,
        place: &str,
        options: &CoordinateOptions,
    ) -> Result<PlacedSurface> {
        if let PickedShape::Readings(table) = &self.shape {
            return self
                .fitting(table, frame, place, options)?
                .placed(frame, place, options);
        }
        let (mut shape, mut nulls) = self.without_nulls(options);
        if shape.points().next().is_none() {
            let problem = format!("{} has no point: {}", self.name, nulls.join(", "));
            let remedy = "export it again, or keep all values: ,null=none";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        let file = GivenFile {
            place,
            stated: &self.coordinates,
            options,
        };
        let to_frame = |p: [f64; 3]| std::array::from_fn::<f64, D, _>(|k| p[k]);
        let spread = shape.spread_points(MAX_TESTED_POINTS);
        let placing = frame.placing(file, &mut spread.into_iter().map(to_frame))?;
        shape.try_map_points(|p| {
            let placed = placing.apply(to_frame(p));
            Ok(std::array::from_fn(|k| {
                placed.get(k).copied().unwrap_or(0.0)
            }))
        })?;
        let mut notes = placing.notes.clone();
        notes.append(&mut nulls);
        notes.extend(self.notes.iter().cloned());
        Ok(PlacedSurface {
            shape,
            share: placing.share,
            notes,
        })
    }

    /// Returns the surface with the reading of its table that fits an image.
    fn fitting<const D: usize>(
        &self,
        table: &TableReadings,
        frame: &Frame<D>,
        place: &str,
        options: &CoordinateOptions,
    ) -> Result<Self> {
        let file = GivenFile {
            place,
            stated: &self.coordinates,
            options,
        };
        // A table with depths and times may have a reading that suits the image, and one that does not.
        let is_inside = frame.membership(file);
        let in_plan = frame.clone().in_region(Region::Column);
        let is_inside_in_plan = in_plan.membership(file);
        let (middle, spacing) = (frame.middle(), frame.spacing());
        let reading_frame = ReadingFrame {
            contains: &|p| {
                let position = std::array::from_fn(|k| p[k]);
                is_inside.as_ref().is_ok_and(|contains| contains(position))
            },
            contains_in_plane: &|[x, y]| {
                let place = |k| [x, y].get(k).copied().unwrap_or(middle[k]);
                let position = std::array::from_fn(place);
                (is_inside_in_plan.as_ref()).is_ok_and(|contains| contains(position))
            },
            spacing: std::array::from_fn(|k| spacing.get(k).copied().unwrap_or(1.0)),
            domain: options.domain.or(frame.domain()),
        };
        let fitting = table.fit(place, &reading_frame);
        if let (Err(_), Err(error)) = (&fitting, is_inside) {
            return Err(error);
        }
        let fitting = fitting?;
        let mut resolved = self.clone();
        resolved.shape = PickedShape::Points(fitting.points);
        resolved.coordinates = fitting.coordinates;
        resolved.notes.push(fitting.note);
        Ok(resolved)
    }

    /// Returns the shape without null values, and a note on each of these.
    fn without_nulls(&self, options: &CoordinateOptions) -> (PickedShape, Vec<String>) {
        let mut named = self.coordinates.nulls.clone();
        named.extend(options.nulls.iter().flatten());
        let recognises = options.nulls.as_deref() != Some(&[]);
        if !recognises {
            named.clear();
        }
        let search = |points: &[[f64; 3]], groups: &dyn Fn() -> Vec<Vec<[u32; 2]>>| {
            NullSearch {
                points,
                named: &named,
                recognises,
            }
            .find(groups)
        };
        match &self.shape {
            PickedShape::Readings(_) => (self.shape.clone(), Vec::new()),
            PickedShape::Points(points) => {
                let groups = || vec![consecutive_pairs(0, points.len()), pairs_in_plan(points)];
                let nulls = search(points, &groups);
                let kept = points.iter().zip(nulls.flags).filter(|(_, null)| !null);
                let kept = kept.map(|(p, _)| *p).collect();
                (PickedShape::Points(kept), nulls.notes)
            }
            PickedShape::Sticks(sticks) => {
                let points: Vec<[f64; 3]> = self.shape.points().collect();
                let pairs = || {
                    let mut first = 0;
                    let of_stick = |stick: &Stick| {
                        first += stick.points.len();
                        consecutive_pairs(first - stick.points.len(), stick.points.len())
                    };
                    vec![sticks.iter().flat_map(of_stick).collect()]
                };
                let nulls = search(&points, &pairs);
                let mut flags = nulls.flags.into_iter();
                let mut kept = sticks.clone();
                for stick in &mut kept {
                    stick.points.retain(|_| !flags.next().unwrap_or(false));
                }
                kept.retain(|stick| !stick.points.is_empty());
                (PickedShape::Sticks(kept), nulls.notes)
            }
            PickedShape::Triangles(triangles) => {
                let (nodes, corners) = distinct_nodes(triangles);
                let edges = || {
                    let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
                    vec![corners.iter().flat_map(edges).collect()]
                };
                let nulls = search(&nodes, &edges);
                let has_null = |t: &[u32; 3]| t.iter().any(|n| nulls.flags[*n as usize]);
                let kept = triangles.iter().zip(&corners).filter(|(_, t)| !has_null(t));
                let kept = kept.map(|(t, _)| *t).collect();
                (PickedShape::Triangles(kept), nulls.notes)
            }
        }
    }
}

/// Returns the distinct corners of triangles, and the numbers of each triangle's corners.
fn distinct_nodes(triangles: &[[[f64; 3]; 3]]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let points = triangles.as_flattened();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let key = |i: u32| points[i as usize].map(f64::to_bits);
    order.sort_unstable_by_key(|&i| (key(i), i));
    let mut numbers = vec![0; points.len()];
    let mut nodes: Vec<[f64; 3]> = Vec::new();
    let mut previous = None;
    for i in order {
        if previous != Some(key(i)) {
            previous = Some(key(i));
            nodes.push(points[i as usize]);
        }
        numbers[i as usize] = nodes.len() as u32 - 1;
    }
    let corners = numbers.as_chunks::<3>().0.to_vec();
    (nodes, corners)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;
    use std::path::{Path, PathBuf};

    use super::super::SurfaceFile;
    use super::super::interpretation::read_interpretation;
    use super::super::vtp::write_vtp;
    use super::*;
    use crate::image::placing::TimeToDepth;
    use crate::image::stated::ZDirection;
    use crate::image::{Geometry, Image, formats};
    use crate::job::spec::FileOption;

    /// Number of points along x and y, and their distance in metres.
    const COUNT: usize = 20;
    const STEP: f64 = 20.0;
    const CORNER: [f64; 2] = [450_000.0, 6_780_000.0];
    /// Velocity of the image, in m/s.
    const VELOCITY: f64 = 2500.0;
    const FORMATS: [&str; 11] = [
        "ts", "vtp", "obj", "xyz", "csv", "charisma", "irap", "zmap", "cps3", "grd", "asc",
    ];

    /// Returns the depth of the plane in metres.
    fn depth([x, y]: [f64; 2]) -> f64 {
        1500.0 + 0.3 * (x - CORNER[0]) - 0.2 * (y - CORNER[1])
    }

    /// A file of the plane.
    #[derive(Debug, Clone, Copy)]
    struct Case {
        format: &'static str,
        unit: &'static str,
        direction: ZDirection,
        null: Option<f64>,
        image: &'static str,
    }

    impl Case {
        /// Returns z of a point in the file.
        fn z(&self, i: usize, j: usize) -> f64 {
            let is_null = (4..8).contains(&i) && (5..11).contains(&j);
            if let (Some(null), true) = (self.null, is_null) {
                return null;
            }
            let down = depth(place(i, j))
                / match self.unit {
                    "ft" => 0.3048,
                    "ms" => 0.5e-3 * VELOCITY,
                    _ => 1.0,
                };
            if self.direction == ZDirection::Up {
                -down
            } else {
                down
            }
        }

        fn points(&self) -> Vec<[f64; 3]> {
            let at = |n: usize| {
                let (i, j) = (n % COUNT, n / COUNT);
                let [x, y] = place(i, j);
                [x, y, self.z(i, j)]
            };
            (0..COUNT * COUNT).map(at).collect()
        }

        /// Writes the file; returns what its option has to say.
        fn write(&self, path: &Path) -> String {
            let points = self.points();
            let z_unit = self.unit;
            let direction = self.direction;
            let rows = |row: &dyn Fn(usize, [f64; 3]) -> String| -> String {
                points.iter().enumerate().map(|(n, p)| row(n, *p)).collect()
            };
            let option = format!(",unit={z_unit}");
            let text = match self.format {
                "ts" => {
                    let positive = if direction == ZDirection::Up {
                        "Elevation"
                    } else {
                        "Depth"
                    };
                    let mut text = format!(
                        "GOCAD TSurf 1\nHEADER {{\nname:A\n}}\nGOCAD_ORIGINAL_COORDINATE_SYSTEM\nAXIS_UNIT \
                         \"m\" \"m\" \"{z_unit}\"\nZPOSITIVE {positive}\nEND_ORIGINAL_COORDINATE_SYSTEM\nTFACE\n"
                    );
                    text += &rows(&|n, [x, y, z]| format!("VRTX {} {x} {y} {z}\n", n + 1));
                    for [a, b, c] in facets() {
                        let _ = writeln!(text, "TRGL {} {} {}", a + 1, b + 1, c + 1);
                    }
                    text + "END\n"
                }
                "obj" => {
                    let mut text = format!("# units: m,m,{z_unit}\n# z: {direction}\n");
                    text += &rows(&|_, [x, y, z]| format!("v {x} {y} {z}\n"));
                    for [a, b, c] in facets() {
                        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
                    }
                    text
                }
                "xyz" => {
                    return self.written(
                        path,
                        rows(&|_, [x, y, z]| format!("{x} {y} {z}\n")),
                        option,
                    );
                }
                "csv" => {
                    let row =
                        |n: usize, [x, y, z]: [f64; 3]| format!("A,{},{x},{y},{z}\n", n / COUNT);
                    return self.written(
                        path,
                        format!("fault,stick,x,y,z\n{}", rows(&row)),
                        option,
                    );
                }
                "charisma" => {
                    let row = |n: usize, [x, y, z]: [f64; 3]| {
                        format!("INLINE- {} 7 {x} {y} {z} A {}\n", n / COUNT, n / COUNT)
                    };
                    return self.written(path, rows(&row), option);
                }
                "vtp" => {
                    let mut file = SurfaceFile::new(&points, &facets(), &[0, facets().len()], "A");
                    file.units = ["m", "m", z_unit].map(String::from);
                    file.z_up = direction == ZDirection::Up;
                    write_vtp(path, &file).unwrap();
                    return String::new();
                }
                _ => {
                    let samples = points.iter().map(|p| p[2] as f32).collect();
                    let geometry = Geometry::with_spacing(CORNER, [STEP; 2]);
                    formats::write(path, &Image::new([COUNT; 2], samples, geometry)).unwrap();
                    return option;
                }
            };
            self.written(path, text, String::new())
        }

        fn written(&self, path: &Path, text: String, option: String) -> String {
            std::fs::write(path, text).unwrap();
            option
        }

        /// Returns the frame of an image around the plane, and the sign of z downwards in it.
        fn frame(&self) -> (Frame<3>, f64) {
            let mut geometry =
                Geometry::with_spacing([CORNER[0], CORNER[1], -1900.0], [10.0, 10.0, 20.0]);
            geometry.units = ["m"; 3].map(String::from);
            if self.image == "down" {
                geometry.origin[2] = 1100.0;
                geometry.names[2] = "depth".into();
            }
            let frame = Frame::new(&geometry, [41; 3]);
            match self.image {
                "down" => (frame, 1.0),
                "converted" => {
                    let conversion = Some(TimeToDepth::Constant(VELOCITY));
                    (frame.with_time_to_depth(conversion, Some("ms")), -1.0)
                }
                _ => (frame, -1.0),
            }
        }

        fn path(&self, folder: &Path) -> PathBuf {
            folder.join(format!("plane.{}", self.format))
        }

        /// Returns the plane in the frame of the image.
        fn placed(&self, folder: &Path, extra: &str) -> Result<PlacedSurface> {
            let path = self.path(folder);
            let suffix = self.write(&path);
            let option: FileOption = format!("{}{suffix}{extra}", path.display())
                .parse()
                .unwrap();
            let read = read_interpretation(&path).unwrap();
            read[0].placed(&self.frame().0, "surface plane", &option.coordinates)
        }

        /// Checks that all points but the null values lie on the plane, to a hundredth of a metre.
        fn check(&self, placed: &PlacedSurface) {
            let down = self.frame().1;
            let mut count = 0;
            for [x, y, z] in placed.shape.points() {
                assert!(
                    (down * z - depth([x, y])).abs() < 0.01,
                    "{self:?}: {x} {y} {z} {:?}",
                    placed.notes
                );
                count += 1;
            }
            // A triangle beside the 4 x 6 null values goes with them.
            let cells = if self.null.is_some() {
                19 * 19 - 5 * 7
            } else {
                19 * 19
            };
            let lone_corners = if self.null.is_some() { 2 } else { 0 };
            let expected = match (&placed.shape, self.null) {
                (PickedShape::Triangles(_), _) if !self.is_grid() => 3 * (2 * cells + lone_corners),
                (PickedShape::Triangles(_), _) => count,
                (_, None) => 400,
                _ => 376,
            };
            assert_eq!(count, expected, "{self:?}: {:?}", placed.notes);
            assert!(count > 300 && placed.share > 0.99, "{self:?}");
        }

        fn is_grid(&self) -> bool {
            ["irap", "zmap", "cps3", "grd", "asc"].contains(&self.format)
        }
    }

    fn place(i: usize, j: usize) -> [f64; 2] {
        [CORNER[0] + STEP * i as f64, CORNER[1] + STEP * j as f64]
    }

    fn facets() -> Vec<[u32; 3]> {
        let mut facets = Vec::new();
        for j in 0..COUNT as u32 - 1 {
            for i in 0..COUNT as u32 - 1 {
                let a = i + j * COUNT as u32;
                let c = a + COUNT as u32 + 1;
                facets.extend([[a, a + 1, c], [a, c, c - 1]]);
            }
        }
        facets
    }

    #[test]
    fn a_plane_lies_where_it_is_in_every_format_unit_direction_and_image() {
        let folder = tempfile::tempdir().unwrap();
        let nulls = [None, Some(-999.0), Some(-999.25), Some(0.0), Some(1e30)];
        let mut count = 0;
        for (k, format) in FORMATS.into_iter().enumerate() {
            for unit in ["m", "ft", "ms"] {
                for direction in [ZDirection::Up, ZDirection::Down] {
                    for image in ["up", "down", "converted"] {
                        // Each null value meets each pair of the others over the formats.
                        count += 1;
                        let case = Case {
                            format,
                            unit,
                            direction,
                            null: nulls[(count + k) % nulls.len()],
                            image,
                        };
                        match case.placed(folder.path(), "") {
                            Ok(placed) if unit != "ms" || image == "converted" => {
                                case.check(&placed)
                            }
                            Err(error) if unit == "ms" && image != "converted" => {
                                let error = error.to_string();
                                assert!(error.contains("--velocity"), "{case:?}: {error}");
                                assert_eq!(error.lines().count(), 1);
                            }
                            other => panic!("{case:?}: {other:?}"),
                        }
                    }
                }
            }
        }
        assert_eq!(count, FORMATS.len() * 3 * 2 * 3);
    }

    #[test]
    fn what_a_file_leaves_out_is_taken_from_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let write = |text: &dyn Fn([f64; 3]) -> String, case: &Case| {
            let text: String = case.points().into_iter().map(text).collect();
            let path = folder.path().join("plain.xyz");
            std::fs::write(&path, text).unwrap();
            read_interpretation(&path).unwrap().swap_remove(0)
        };
        for (unit, image) in [("m", "up"), ("m", "down"), ("ms", "converted")] {
            for direction in [ZDirection::Up, ZDirection::Down] {
                let case = Case {
                    format: "xyz",
                    unit,
                    direction,
                    null: Some(-999.0),
                    image,
                };
                let surface = write(&|[x, y, z]| format!("{x} {y} {z}\n"), &case);
                let (frame, _) = case.frame();
                let options = CoordinateOptions::default();
                let placed = surface
                    .placed(&frame, "surface plain.xyz", &options)
                    .unwrap();
                case.check(&placed);
                let notes = placed.notes.join(", ");
                assert!(notes.contains("as the file has no unit"), "{notes}");
            }
        }
        // x, y and z in feet.
        let case = Case {
            format: "xyz",
            unit: "ft",
            direction: ZDirection::Up,
            null: None,
            image: "up",
        };
        let surface = write(
            &|[x, y, z]| format!("{} {} {z}\n", x / 0.3048, y / 0.3048),
            &case,
        );
        let options = |text: &str| text.parse::<FileOption>().unwrap().coordinates;
        for option in ["a.xyz,unit=ft", "a.xyz,unit=ft,ft,ft"] {
            let placed = surface
                .placed(&case.frame().0, "surface a", &options(option))
                .unwrap();
            case.check(&placed);
        }
    }

    #[test]
    fn an_option_replaces_what_a_file_says_and_contradictions_are_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let case = Case {
            format: "ts",
            unit: "ft",
            direction: ZDirection::Down,
            null: None,
            image: "up",
        };
        let placed = case.placed(folder.path(), "").unwrap();
        let notes = placed.notes.join(", ");
        assert_eq!(
            notes,
            "z in ft, converted to m, with the sign of z turned, as it grows downwards in the file"
        );
        let placed = case.placed(folder.path(), ",unit=m").unwrap();
        assert!(
            placed.notes[0].contains("the option's unit of z replaces the file's"),
            "{:?}",
            placed.notes
        );
        let z = placed.shape.points().next().unwrap()[2];
        assert!((z + 1500.0 / 0.3048).abs() < 1e-6, "{z}");
        let placed = case.placed(folder.path(), ",z=up").unwrap();
        assert!(
            placed
                .notes
                .join(", ")
                .contains("z up as the option says, though the file says down")
        );
        // What the file says about the sign is refuted by the image.
        let path = case.path(folder.path());
        let text = std::fs::read_to_string(&path)
            .unwrap()
            .replace("Depth", "Elevation");
        std::fs::write(&path, &text).unwrap();
        let surface = read_interpretation(&path).unwrap().swap_remove(0);
        let place = |options: &str| {
            let option: FileOption = format!("a.ts{options}").parse().unwrap();
            surface.placed(&case.frame().0, "surface a.ts", &option.coordinates)
        };
        let placed = place("").unwrap();
        case.check(&placed);
        assert!(
            placed
                .notes
                .join(", ")
                .contains("as it fits the image only so")
        );
        for (options, expected) in [
            (
                ",domain=time",
                "surface a.ts: has z in ft, which is no unit of time; ",
            ),
            (
                ",unit=ms",
                "surface a.ts: has z in two-way time (ms), but the image is in m; ",
            ),
            (
                ",unit=s,m,m",
                "surface a.ts: has x in s, but the image in m; ",
            ),
        ] {
            let error = place(options).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
        std::fs::write(&path, text.replace("\"ft\"", "\"furlong\"")).unwrap();
        let surface = read_interpretation(&path).unwrap().swap_remove(0);
        let options = CoordinateOptions::default();
        let error = surface
            .placed(&case.frame().0, "surface a.ts", &options)
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("has z in furlong, which is no known unit"),
            "{error}"
        );
    }

    #[test]
    fn a_surface_of_null_values_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.xyz");
        let text: String = (0..30)
            .map(|i| format!("{} {} -999.25\n", i % 6, i / 6))
            .collect();
        std::fs::write(&path, text).unwrap();
        let surface = read_interpretation(&path).unwrap().swap_remove(0);
        let frame = Frame::new(&Geometry::default(), [20; 3]);
        let error = surface.placed(&frame, "surface a.xyz", &CoordinateOptions::default());
        let error = error.unwrap_err().to_string();
        assert!(
            error.starts_with(
                "surface a.xyz: a has no point: 30 points with the common null value -999.25"
            ),
            "{error}"
        );
    }
}
