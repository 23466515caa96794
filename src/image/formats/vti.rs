//! VTK image data (`.vti`, legacy `.vtk`): origin, spacing and direction in full double precision.
//! Rectilinear and structured grids (`.vtr`, `.vts`, legacy `.vtk`) are read if they are evenly spaced.
//!
//! VTK maps index (i, j, k) to `Origin + Direction * (Spacing * index)`: column k of `Direction` is
//! the unit step along axis k. VTK has no place for units and names of axes; they are stored in
//! field data unless they are the defaults.

use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use super::{ImageFormat, LoadedImage, samples, vtk_axes};
use crate::error::Result;
use crate::files::atomic_write;
use crate::files::vtk::xml::Element;
use crate::files::vtk::{ArraySource, Document, Values, VtkFile};
use crate::image::labels::LabelCollector;
use crate::image::{ExactLabels, Geometry, Image};

/// Reads the image of a `.vti` file, with a note if its integers were rounded. The samples are
/// the active scalars of the points, or the first array of the points if none is active. If the
/// points have no data, the data of the cells are used, as samples in the centres of cells.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file is not VTK image data, is damaged, or
/// holds no 3-D scalars on points or cells.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let kinds = ["ImageData", "RectilinearGrid", "StructuredGrid"];
    let file = VtkFile::read_one_of(path, &kinds)?;
    let data_set = file.data_set();
    let piece = file.piece()?;
    let whole_extent: [i64; 6] = parse_attribute(&file, data_set, "WholeExtent")?;
    let extent: [i64; 6] = parse_attribute(&file, piece, "Extent")?;
    if whole_extent != extent {
        return Err(file.error(
            format!("holds the part {extent:?} of {whole_extent:?}"),
            "write the whole image",
        ));
    }
    let mut dims = [0usize; 3];
    let mut count = 1usize;
    for k in 0..3 {
        let (low, high) = (extent[2 * k], extent[2 * k + 1]);
        dims[k] = high
            .checked_sub(low)
            .and_then(|n| usize::try_from(n).ok())
            .map_or(0, |n| n + 1);
        count = count.saturating_mul(dims[k]);
    }

    let mut geometry = match data_set.name.as_str() {
        "RectilinearGrid" => vtk_axes::rectilinear(&file, piece, dims)?,
        "StructuredGrid" => vtk_axes::structured(&file, piece, dims)?,
        _ => image_geometry(&file, extent)?,
    };
    take_names(&file, &mut geometry)?;
    let element = match (scalars(piece, "PointData"), scalars(piece, "CellData")) {
        (Some(on_points), _) => on_points,
        (None, Some(on_cells)) => {
            // A sample of cell data lies in the centre of its cell.
            let middle = dims.map(|n| if n > 1 { 0.5 } else { 0.0 });
            geometry.origin = geometry.to_physical(middle);
            dims = dims.map(|n| (n.max(2)) - 1);
            count = dims.iter().product();
            on_cells
        }
        (None, None) => {
            let problem = "has no data on its points or cells";
            return Err(file.error(problem, "write samples as point data"));
        }
    };
    samples::check_memory(path, count)?;
    let values = sample_values(&file, element, dims)?;
    let samples = values.to_f32();
    let is_rounded = samples::may_be_rounded(&samples);
    let mut image = Image::new(dims, samples, geometry);
    if is_rounded {
        image.labels = exact_labels(&values);
    }
    let is_wide = values.to_integers().is_some();
    let note = (is_rounded && is_wide).then(|| samples::ROUNDING_NOTE.to_string());
    let encoding = if file.is_legacy() {
        "VTK legacy"
    } else {
        "VTK XML"
    };
    Ok(LoadedImage {
        image,
        format: ImageFormat::Vti,
        encoding: encoding.into(),
        notes: note.into_iter().collect(),
        survey: None,
        line_numbers: None,
    })
}

/// Returns the active scalars of some data, or else the first array.
fn scalars<'a>(piece: &'a Element, data: &str) -> Option<&'a Element> {
    let data = piece.child(data)?;
    let arrays = || data.children.iter().filter(|c| c.name == "DataArray");
    let active = data.attribute("Scalars");
    arrays()
        .find(|a| active.is_some() && a.attribute("Name") == active)
        .or_else(|| arrays().next())
}

/// Returns the values of an array, one for each sample.
fn sample_values(file: &VtkFile, element: &Element, dims: [usize; 3]) -> Result<Values> {
    let count: usize = dims.iter().product();
    let array = file.array(element)?;
    if array.components != 1 {
        return Err(file.error(
            format!("array '{}' has {} components", array.name, array.components),
            "give one scalar per sample",
        ));
    }
    if array.values.len() != count || count == 0 {
        return Err(file.error(
            format!(
                "array '{}' has {} values for {} x {} x {} samples",
                array.name,
                array.values.len(),
                dims[0],
                dims[1],
                dims[2]
            ),
            crate::files::REWRITE_DAMAGED,
        ));
    }
    Ok(array.values)
}

/// Returns the samples as exact labels, or `None` if some have a fraction.
fn exact_labels(values: &Values) -> Option<Arc<ExactLabels>> {
    let mut collector = LabelCollector::default();
    match (values.to_integers(), values) {
        (Some(integers), _) => collector.extend(integers),
        (None, Values::F64(numbers)) => {
            collector.extend_exact(numbers.iter().map(|&v| v.into()));
        }
        _ => return None,
    }
    collector.finish_exact()
}

/// Returns the geometry of an image of this extent.
fn image_geometry(file: &VtkFile, extent: [i64; 6]) -> Result<Geometry<3>> {
    let data_set = file.data_set();
    let vector_or = |name: &str, default: f64| match data_set.attribute(name) {
        None => Ok([default; 3]),
        Some(_) => parse_attribute(file, data_set, name),
    };
    let (origin, spacing) = (vector_or("Origin", 0.0)?, vector_or("Spacing", 1.0)?);
    let direction: [f64; 9] = match data_set.attribute("Direction") {
        None => [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        Some(_) => parse_attribute(file, data_set, "Direction")?,
    };
    let axes = std::array::from_fn(|k| std::array::from_fn(|c| direction[3 * c + k] * spacing[k]));
    let mut geometry = Geometry {
        axes,
        ..Geometry::default()
    };
    // The first sample has the index of the low end of the extent.
    geometry.origin = origin;
    geometry.origin = geometry.to_physical(std::array::from_fn(|k| extent[2 * k] as f64));
    Ok(geometry)
}

/// Takes the names of axes and the units from field data.
fn take_names(file: &VtkFile, geometry: &mut Geometry<3>) -> Result<()> {
    if let Some(fields) = file.data_set().child("FieldData") {
        for array in &fields.children {
            let target = match array.attribute("Name") {
                Some(AXIS_NAMES) => &mut geometry.names,
                Some(UNITS) => &mut geometry.units,
                _ => continue,
            };
            let text = file.text(array)?;
            for (target, line) in target.iter_mut().zip(text.split('\n')) {
                *target = line.to_string();
            }
        }
    }
    Ok(())
}

/// Parses an attribute of exactly `N` numbers.
fn parse_attribute<T: FromStr, const N: usize>(
    file: &VtkFile,
    element: &Element,
    name: &str,
) -> Result<[T; N]> {
    let numbers = file.parse_attribute(element, name)?;
    numbers.try_into().map_err(|v: Vec<T>| {
        let problem = format!("the attribute {name} has {} numbers, not {N}", v.len());
        file.error(problem, crate::files::REWRITE_DAMAGED)
    })
}

/// Name of the field data that holds the names of the axes, one per line.
const AXIS_NAMES: &str = "axis_names";
/// Name of the field data that holds the units of the physical coordinates, one per line.
const UNITS: &str = "units";

/// Writes an image as point data named `array_name`.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write(path: &Path, image: &Image<3>, array_name: &str) -> Result<()> {
    let dims = image.dims();
    let extent = dims.map(|n| format!("0 {}", n as i64 - 1)).join(" ");
    let spacing = image.geometry.spacing();
    // VTK needs a direction even where the step is zero.
    let direction = |c: usize, k: usize| match spacing[k] {
        0.0 => f64::from(u8::from(c == k)),
        s => image.geometry.axes[k][c] / s,
    };
    let matrix: [f64; 9] = std::array::from_fn(|i| direction(i / 3, i % 3));
    let defaults = Geometry::<3>::default();
    let names = image.geometry.names.join("\n");
    let units = image.geometry.units.join("\n");

    let mut document = Document::new(
        "ImageData",
        &[
            ("WholeExtent", extent.clone()),
            ("Origin", format_exact(&image.geometry.origin)),
            ("Spacing", format_exact(&spacing)),
            ("Direction", format_exact(&matrix)),
        ],
    );
    if image.geometry.names != defaults.names || image.geometry.units != defaults.units {
        document.open("FieldData", &[]);
        document.add_array(ArraySource::text(AXIS_NAMES, &names));
        document.add_array(ArraySource::text(UNITS, &units));
        document.close();
    }
    document.open("Piece", &[("Extent", extent)]);
    document.open("PointData", &[("Scalars", array_name.to_string())]);
    document.add_array(ArraySource::slice(array_name, 1, image.as_slice()));
    document.close();
    document.close();
    atomic_write(path, |out| document.write(out))
}

/// Returns the shortest text that reads back as the same numbers.
fn format_exact(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(|n| format!("{n:?}")).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::{AnyImage, ReadOptions, read_any};
    use super::*;
    use crate::files::vtk::fixtures::{VARIANTS, fixture};

    fn oblique_image() -> Image<3> {
        let geometry = Geometry {
            origin: [612345.678, -1e-300, 0.1 + 0.2],
            axes: [[0.3, 0.4, 0.0], [-25.0, 0.1, 0.0], [0.0, 0.0, -4.0]],
            names: ["crossline", "inline", "sample"].map(String::from),
            units: ["m", "m", "ms"].map(String::from),
        };
        let samples = (0..5 * 4 * 3).map(|i| (i as f32 * 0.7).sin()).collect();
        Image::new([5, 4, 3], samples, geometry)
    }

    #[test]
    fn every_variant_that_vtk_writes_is_read() {
        for variant in VARIANTS {
            let image = read(&fixture(&format!("{variant}.vti"))).unwrap().image;
            assert_eq!(image.dims(), [3, 2, 2], "{variant}");
            let expected: Vec<f32> = (-5..7).map(|i| i as f32).collect();
            assert_eq!(image.as_slice(), expected, "{variant}");
            assert_eq!(
                image.geometry.origin,
                [612345.678, -1e-7, 3.25],
                "{variant}"
            );
            // Axis x points along physical y, and axis y along physical -x.
            let axes = [[0.0, 12.5, 0.0], [-25.0, 0.0, 0.0], [0.0, 0.0, 4.0]];
            assert_eq!(image.geometry.axes, axes, "{variant}");
        }
    }

    #[test]
    fn legacy_images_keep_their_origin_in_double_precision() {
        for name in ["legacy_ascii.vtk", "legacy_binary.vtk"] {
            let image = read(&fixture(name)).unwrap().image;
            assert_eq!(image.dims(), [3, 2, 2], "{name}");
            let expected: Vec<f32> = (-5..7).map(|i| i as f32).collect();
            assert_eq!(image.as_slice(), expected, "{name}");
            assert_eq!(image.geometry.origin, [612345.678, -1e-7, 3.25], "{name}");
            assert_eq!(image.geometry.spacing(), [12.5, 25.0, 4.0], "{name}");
        }
    }

    #[test]
    fn write_then_read_gives_the_same_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vti");
        let image = oblique_image();
        write(&path, &image, "a < b").unwrap();
        let back = read(&path).unwrap().image;
        assert_eq!(back.as_slice(), image.as_slice());
        assert_eq!(back.geometry.origin, image.geometry.origin);
        assert_eq!(back.geometry.names, image.geometry.names);
        assert_eq!(back.geometry.units, image.geometry.units);
        for (a, b) in back
            .geometry
            .axes
            .iter()
            .flatten()
            .zip(image.geometry.axes.iter().flatten())
        {
            assert!((a - b).abs() <= 2.0 * f64::EPSILON * b.abs(), "{a} != {b}");
        }
        // The geometry is exact if the axes are parallel to the physical axes.
        let straight = Image::new(
            [2, 3, 4],
            vec![1.5; 24],
            Geometry::with_spacing([0.1, 1e6 + 0.1, -3.3], [0.1, 12.7, 1.0 / 3.0]),
        );
        write(&path, &straight, "s").unwrap();
        assert_eq!(read(&path).unwrap().image, straight);
    }

    #[test]
    fn a_file_of_deeply_nested_elements_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep.vti");
        // One element more than is read, two of which are those of the file.
        let (open, close) = ("<a>".repeat(63), "</a>".repeat(63));
        let file = |content: &str| {
            format!("<VTKFile type=\"ImageData\"><ImageData>{content}</ImageData></VTKFile>")
        };
        // One text is complete, the other is truncated in the middle.
        for text in [file(&format!("{open}{close}")), file(&open)] {
            std::fs::write(&path, text).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains("64 elements within each other"), "{error}");
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vti");
        write(&path, &oblique_image(), "s").unwrap();
        let good = std::fs::read(&path).unwrap();
        // A file that is truncated before the end of the data is never read, and never causes a
        // panic.
        let data_end = good.len() - "\n  </AppendedData>\n</VTKFile>\n".len();
        for end in (0..data_end).step_by(7).chain([data_end - 1]) {
            std::fs::write(&path, &good[..end]).unwrap();
            assert!(read(&path).is_err(), "cut at {end}");
        }
        let error_after_replacing = |old: &str, new: &str| {
            let at = good
                .windows(old.len())
                .position(|w| w == old.as_bytes())
                .unwrap();
            let bytes = [&good[..at], new.as_bytes(), &good[at + old.len()..]].concat();
            std::fs::write(&path, bytes).unwrap();
            read(&path).unwrap_err().to_string()
        };
        assert!(
            error_after_replacing("type=\"ImageData\"", "type=\"PolyData\"")
                .contains("holds PolyData")
        );
        assert!(
            error_after_replacing("WholeExtent=\"0 4", "WholeExtent=\"0 5")
                .contains("holds the part")
        );
        assert!(error_after_replacing("Origin=\"612345.678", "Origin=\"x").contains("Origin"));
        assert!(
            error_after_replacing("Direction=\"", "Direction=\"1 ").contains("10 numbers, not 9")
        );
        assert!(error_after_replacing("Float32", "Float33").contains("unknown type Float33"));
        assert!(error_after_replacing("UInt64", "UInt16").contains("UInt16"));
        assert!(error_after_replacing("vtkZLib", "vtkLZMA").contains("does not decompress"));
        assert!(error_after_replacing("vtkZLib", "vtkZip").contains("vtkZipDataCompressor"));
        let none = read(&folder.path().join("none.vti"))
            .unwrap_err()
            .to_string();
        assert!(none.contains("none.vti"));
    }

    /// Returns a rectilinear grid of 3 x 2 x 2 points in XML, with these coordinates along x, and these
    /// data.
    fn rectilinear_grid(kind: &str, x: &str, data: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?><VTKFile type=\"RectilinearGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\
             <RectilinearGrid WholeExtent=\"5 7 0 1 0 1\"><Piece Extent=\"5 7 0 1 0 1\">{data}<Coordinates>\
             <DataArray type=\"{kind}\" Name=\"x\" format=\"ascii\">{x}</DataArray>\
             <DataArray type=\"{kind}\" Name=\"y\" format=\"ascii\">20 10</DataArray>\
             <DataArray type=\"{kind}\" Name=\"z\" format=\"ascii\">-3 1</DataArray>\
             </Coordinates></Piece></RectilinearGrid></VTKFile>"
        )
    }

    fn numbers(element: &str, count: usize) -> String {
        let words: Vec<String> = (0..count).map(|i| i.to_string()).collect();
        format!(
            "<{element}><DataArray type=\"Float32\" Name=\"v\" format=\"ascii\">{}</DataArray></{element}>",
            words.join(" ")
        )
    }

    #[test]
    fn evenly_spaced_rectilinear_grids_are_images() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtr");
        let on_points = numbers("PointData", 12);
        std::fs::write(
            &path,
            rectilinear_grid("Float64", "100 102.5 105", &on_points),
        )
        .unwrap();
        let image = read(&path).unwrap().image;
        assert_eq!(image.dims(), [3, 2, 2]);
        assert_eq!(image.as_slice()[11], 11.0);
        let expected = Geometry::with_spacing([100.0, 20.0, -3.0], [2.5, -10.0, 4.0]);
        assert_eq!(image.geometry, expected);
        // Samples of cell data lie in the middle of cells.
        let on_cells = numbers("CellData", 2);
        std::fs::write(
            &path,
            rectilinear_grid("Float64", "100 102.5 105", &on_cells),
        )
        .unwrap();
        let image = read(&path).unwrap().image;
        assert_eq!(image.dims(), [2, 1, 1]);
        assert_eq!(image.geometry.origin, [101.25, 15.0, -1.0]);
        // Coordinates in single precision are rounded.
        let x = "6780000.5 6780003 6780005.5";
        std::fs::write(&path, rectilinear_grid("Float32", x, &on_points)).unwrap();
        assert_eq!(read(&path).unwrap().image.geometry.axes[0][0], 2.5);
        for (x, expected) in [
            (
                "0 1 2.1",
                "not evenly spaced along x: its steps are from 1 to 1.1",
            ),
            ("0 1 1", "not evenly spaced along x"),
            ("3 3 3", "not evenly spaced along x"),
            ("0 1", "2 coordinates along x for 3 points"),
        ] {
            std::fs::write(&path, rectilinear_grid("Float64", x, &on_points)).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn legacy_rectilinear_and_structured_grids_are_images_if_they_are_evenly_spaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtk");
        let data =
            "POINT_DATA 12\nSCALARS v float 1\nLOOKUP_TABLE default\n0 1 2 3 4 5 6 7 8 9 10 11\n";
        let rectilinear = format!(
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS 3 2 2\n\
             X_COORDINATES 3 double\n100 102.5 105\nY_COORDINATES 2 double\n20 10\n\
             Z_COORDINATES 2 double\n-3 1\n{data}"
        );
        let expected = Geometry::with_spacing([100.0, 20.0, -3.0], [2.5, -10.0, 4.0]);
        // Axes that are neither straight along x nor perpendicular.
        let mut sheared = expected.clone();
        sheared.axes = [[2.0, 1.0, 0.0], [0.5, -10.0, 0.25], [0.0, 0.0, 4.0]];
        let structured = |geometry: &Geometry<3>, bend: f64| {
            let point = |i: usize| {
                let [x, y, z] = geometry.to_physical([i % 3, i / 3 % 2, i / 6].map(|k| k as f64));
                format!("{} {y} {z}\n", if i == 7 { x + bend } else { x })
            };
            let points: String = (0..12).map(point).collect();
            format!(
                "# vtk DataFile Version 3.0\nt\nASCII\nDATASET STRUCTURED_GRID\nDIMENSIONS 3 2 2\n\
                 POINTS 12 double\n{points}{data}"
            )
        };
        let straight = structured(&expected, 0.0);
        let oblique = structured(&sheared, 0.0);
        for (text, expected) in [
            (&rectilinear, &expected),
            (&straight, &expected),
            (&oblique, &sheared),
        ] {
            std::fs::write(&path, text).unwrap();
            let AnyImage::Space(loaded) = read_any(&path, &ReadOptions::default()).unwrap() else {
                panic!("{text} is no plane");
            };
            assert_eq!(loaded.image.as_slice()[11], 11.0);
            assert_eq!(&loaded.image.geometry, expected, "{text}");
        }
        std::fs::write(&path, structured(&sheared, 0.1)).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(
            error.contains("point [1, 0, 1] is not at its place; resample it evenly"),
            "{error}"
        );
    }
}
