//! Geometry that the user gives for an image: where the file has none (arrays, pictures, stacks), or in
//! place of that of the file.

use std::path::PathBuf;

use super::stream::{ImageHeader, OpenedImage};
use super::{SegyBytes, open};
use crate::error::{Error, Result, cause};
use crate::geometry::{dot, unit};
use crate::image::Geometry;
use crate::image::formats::ReadOptions;
use crate::image::formats::with_loaded;
use crate::units::{self, Quantity};

/// End of the note that a reader writes for a file without geometry.
pub(crate) const NO_GEOMETRY_NOTE: &str = "does not say where its samples lie: they are taken to be 1 apart, the first at 0 (--axes, --spacing, --unit)";

/// Geometry of an image as the user gives it. What is given replaces that part of the file's geometry, and
/// a note says so if the file has one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImagePlacement {
    /// Distances between samples along the axes of the array, the fastest first, or one for all
    /// axes.
    pub spacing: Option<Vec<f64>>,
    /// Position of the first sample: x, y, z.
    pub origin: Option<Vec<f64>>,
    /// Units of x, y and z, or one for all.
    pub units: Option<Vec<String>>,
    /// Meaning of the axes of the array, the fastest first.
    pub axes: Option<Vec<AxisSpec>>,
    /// Distance between samples along the vertical axis.
    pub interval: Option<f64>,
    /// An image of the same dimensions whose geometry is used.
    pub reference_image: Option<PathBuf>,
}

/// Meaning of an axis of an array: the physical coordinate along which it runs, and the direction.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisSpec {
    /// Name of the axis.
    pub name: String,
    /// Index of the coordinate; `None` for the last one, whether there are two or three.
    coordinate: Option<usize>,
    /// `true` if the coordinate decreases from sample to sample.
    is_descending: bool,
}

impl std::str::FromStr for AxisSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let text = text.trim();
        let bare = text.strip_prefix('-').unwrap_or(text);
        let (coordinate, descends) = match bare {
            "x" | "crossline" | "trace" => (Some(0), false),
            "y" | "inline" => (Some(1), false),
            "z" => (Some(2), false),
            "sample" | "time" | "depth" => (None, true),
            _ => {
                return Err(Error::Job(cause(
                    format!("axes {text}"),
                    "is not an axis",
                    "give x, y or z (-z where the coordinate decreases from sample to sample), or time, depth, sample, crossline, inline",
                )));
            }
        };
        Ok(Self {
            name: bare.to_string(),
            coordinate,
            is_descending: descends != text.starts_with('-'),
        })
    }
}

impl AxisSpec {
    /// Returns the index of the coordinate in 3-D, and `true` if it decreases from sample to
    /// sample.
    pub(super) fn space_coordinate(&self) -> (usize, bool) {
        (self.coordinate.unwrap_or(2), self.is_descending)
    }
}

/// Returns the short name of a unit of length as microscopes write it, or `None` if it is not a
/// known unit of length.
pub fn length_unit(name: &str) -> Option<&'static str> {
    units::find(name)
        .filter(|unit| unit.quantity == Quantity::Length)
        .map(|unit| unit.symbol)
}

impl ImagePlacement {
    /// Returns `true` if no option is given.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the options without those of the distances between samples, for formats that have been
    /// sampled at these distances.
    pub(super) fn without_spacing(&self) -> Self {
        Self {
            spacing: None,
            interval: None,
            ..self.clone()
        }
    }

    /// Applies the geometry to an image.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if the options do not fit the image, or if the image has a
    /// geometry already, and the errors of reading the reference image.
    pub(super) fn apply(&self, opened: OpenedImage, segy: &SegyBytes) -> Result<OpenedImage> {
        if self.is_empty() {
            return Ok(opened);
        }
        let reference = self.open_reference(segy)?;
        Ok(match opened {
            OpenedImage::Stream(mut stream) => {
                let reference = reference.map(OpenedImage::into_header);
                stream.header = self.place_header(stream.header, reference)?;
                OpenedImage::Stream(stream)
            }
            OpenedImage::InMemory(image) => with_loaded!(image, loaded => {
                let reference = reference.map(OpenedImage::into_header);
                let header = self.place_header(loaded.header(), reference)?;
                OpenedImage::InMemory(header.with_image(loaded.image).into())
            }),
        })
    }

    /// Opens the reference image. Its samples are not read if its headers are enough.
    fn open_reference(&self, segy: &SegyBytes) -> Result<Option<OpenedImage>> {
        let Some(path) = &self.reference_image else {
            return Ok(None);
        };
        let options = ReadOptions {
            segy: *segy,
            ..ReadOptions::default()
        };
        open(path, &options).map(Some)
    }

    /// Applies the geometry to a header with `D` axes. `reference` is the header of the reference
    /// image, if one is given and has as many axes.
    fn place_header<const D: usize>(
        &self,
        mut header: ImageHeader<D>,
        reference: Option<Option<ImageHeader<D>>>,
    ) -> Result<ImageHeader<D>> {
        let bare = Geometry::<D>::default();
        let stored = header.geometry.clone();
        let has_place = (stored.origin, stored.axes) != (bare.origin, bare.axes);
        if !self.says_units_only() {
            header.notes.retain(|note| !note.contains(NO_GEOMETRY_NOTE));
        }
        if let Some(candidate) = reference {
            return self.place_as_reference(header, candidate, has_place);
        }
        let mut geometry = if self.says_units_only() {
            stored.clone()
        } else {
            self.axis_geometry(&stored, has_place)?
        };
        if let Some(origin) = &self.origin {
            geometry.origin = expand_to_axes("origin", origin, false)?;
        }
        if let Some(units) = &self.units {
            geometry.units = expand_to_axes("unit", units, true)?;
            self.check_unit_of_time(&geometry)?;
        }
        if let Some(interval) = self.interval {
            set_interval(&mut geometry, interval, &header)?;
        }
        let has_units = stored.units.iter().any(|unit| !unit.is_empty());
        if geometry != stored && (has_place || has_units && self.units.is_some()) {
            header.notes.push(format!(
                "{} instead of the geometry in the file ({})",
                self.option_names(),
                describe(&stored)
            ));
        }
        header.geometry = geometry;
        Ok(header)
    }

    /// Returns `true` if no option but the units is given.
    fn says_units_only(&self) -> bool {
        Self {
            units: None,
            ..self.clone()
        }
        .is_empty()
    }

    /// Returns a header with the geometry of the reference image.
    fn place_as_reference<const D: usize>(
        &self,
        mut header: ImageHeader<D>,
        reference: Option<ImageHeader<D>>,
        has_place: bool,
    ) -> Result<ImageHeader<D>> {
        let dims = header.dims;
        let path = self.reference_image.as_deref();
        let path = path.unwrap_or(std::path::Path::new(""));
        let source = reference.filter(|header| header.dims == dims);
        let source = source.ok_or_else(|| {
            Error::Job(cause(
                format!("geometry-from {}", path.display()),
                format!("does not have the {dims:?} samples of the image"),
                "give the image from which this one was made",
            ))
        })?;
        let instead = if has_place {
            format!(" instead of the file ({})", describe(&header.geometry))
        } else {
            String::new()
        };
        header.geometry = source.geometry;
        header.missing = source.missing;
        header.survey = source.survey;
        header.line_numbers = source.line_numbers;
        header
            .notes
            .push(format!("geometry taken from {}{instead}", path.display()));
        Ok(header)
    }

    /// Refuses units in the order of the array's axes: the unit of time belongs to the coordinate
    /// along which the axis `time` runs.
    fn check_unit_of_time<const D: usize>(&self, geometry: &Geometry<D>) -> Result<()> {
        let axes = self.axes.as_deref().unwrap_or_default();
        let time_axis = axes.iter().find(|axis| axis.name == "time");
        let expected = time_axis.map(|axis| axis.coordinate.unwrap_or(D - 1));
        let (Some(expected), Some(given)) = (expected, geometry.time_coordinate()) else {
            return Ok(());
        };
        if given == expected {
            return Ok(());
        }
        let names = ["x", "y", "z"];
        Err(Error::Job(cause(
            format!("unit {}", geometry.units.join(",")),
            format!(
                "gives a unit of time to {}, but time runs along {}",
                names[given], names[expected]
            ),
            "give units in the order x, y, z, not in that of the array's axes, such as m,m,ms",
        )))
    }

    /// Returns a geometry with the given axes and spacing. Where they are not given, those of `stored`
    /// remain, if the file has a place (`has_place`).
    fn axis_geometry<const D: usize>(
        &self,
        stored: &Geometry<D>,
        has_place: bool,
    ) -> Result<Geometry<D>> {
        let mut geometry = stored.clone();
        let spacing: [f64; D] = match &self.spacing {
            Some(spacing) => expand_to_axes("spacing", spacing, true)?,
            None => stored.axes.map(|axis| dot(axis, axis).sqrt()),
        };
        if let Some(s) = spacing.iter().find(|s| **s <= 0.0) {
            return Err(Error::Job(cause(
                format!("spacing {s}"),
                "is not positive",
                "give the distance between samples; to reverse an axis, write -x, -y or -z in axes",
            )));
        }
        let Some(axes) = &self.axes else {
            for k in 0..D {
                geometry.axes[k] = unit(stored.axes[k]).map(|part| part * spacing[k] + 0.0);
            }
            return Ok(geometry);
        };
        let axes: [AxisSpec; D] = expand_to_axes("axes", axes, false)?;
        if !has_place {
            geometry.origin = [0.0; D];
        }
        let mut used = [false; D];
        for (k, axis) in axes.iter().enumerate() {
            let c = axis.coordinate.unwrap_or(D - 1);
            // In a 2-D section inlines run along the coordinate that is not the last.
            let c = if D == 2 && axis.name == "inline" {
                0
            } else {
                c
            };
            if c >= D || std::mem::replace(&mut used[c], true) {
                return Err(Error::Job(cause(
                    format!("axes {}", axis.name),
                    if c >= D {
                        "is the third axis, but the image is 2-D"
                    } else {
                        "runs along the same coordinate as another axis"
                    },
                    match D {
                        2 => "give each coordinate once, e.g. x,y, or time,x for a section",
                        _ => "give each coordinate once, e.g. x,y,z or time,crossline,inline",
                    },
                )));
            }
            let sign = if axis.is_descending { -1.0 } else { 1.0 };
            geometry.axes[k] = std::array::from_fn(|coordinate| {
                if coordinate == c {
                    sign * spacing[k]
                } else {
                    0.0
                }
            });
            geometry.names[k].clone_from(&axis.name);
        }
        Ok(geometry)
    }

    /// Returns the options that are given, as on the command line.
    fn option_names(&self) -> String {
        let given = [
            ("--spacing", self.spacing.is_some()),
            ("--origin", self.origin.is_some()),
            ("--unit", self.units.is_some()),
            ("--axes", self.axes.is_some()),
            ("--interval", self.interval.is_some()),
        ];
        let names = given.iter().filter(|(_, is_given)| *is_given);
        let names: Vec<&str> = names.map(|(name, _)| *name).collect();
        names.join(", ")
    }
}

/// Sets the distance between samples along the vertical axis, whose direction remains.
fn set_interval<const D: usize>(
    geometry: &mut Geometry<D>,
    interval: f64,
    header: &ImageHeader<D>,
) -> Result<()> {
    if !(interval > 0.0 && interval.is_finite()) {
        return Err(Error::Job(cause(
            format!("interval {interval}"),
            "is not positive",
            "give the distance between samples in the unit of the vertical axis",
        )));
    }
    let is_named = |name: &String| matches!(&**name, "sample" | "time" | "twt" | "depth" | "z");
    let steepest = (0..D).max_by(|&a, &b| {
        let height = |k: usize| unit(geometry.axes[k])[D - 1].abs();
        height(a).total_cmp(&height(b))
    });
    let named = geometry.names.iter().position(is_named);
    let vertical = named.or(steepest).unwrap_or(D - 1);
    geometry.axes[vertical] = unit(geometry.axes[vertical]).map(|part| part * interval + 0.0);
    // A survey whose headers have no interval counts samples, from 0.
    if let (Some(survey), "sample") = (&header.survey, &*geometry.units[D - 1]) {
        geometry.units[D - 1] = if survey.is_depth { "m" } else { "ms" }.to_string();
        geometry.origin[D - 1] = 0.0 - survey.t0_ms;
    }
    Ok(())
}

/// Describes a geometry in a note.
fn describe<const D: usize>(geometry: &Geometry<D>) -> String {
    let list = |numbers: [f64; D]| numbers.map(|n| without_noise(n).to_string()).join(", ");
    let spacing = list(geometry.axes.map(|axis| dot(axis, axis).sqrt()));
    let units = if geometry.units.iter().all(String::is_empty) {
        String::new()
    } else {
        format!(", units {}", geometry.units.join(", "))
    };
    format!("spacing {spacing}, origin {}{units}", list(geometry.origin))
}

/// Returns a number with at most ten significant digits.
fn without_noise(number: f64) -> f64 {
    format!("{number:.9e}").parse().unwrap_or(number)
}

/// Returns one value for each axis. If `allow_single` is set, a single value stands for all axes.
fn expand_to_axes<T: Clone, const D: usize>(
    name: &str,
    values: &[T],
    allow_single: bool,
) -> Result<[T; D]> {
    if let ([value], true) = (values, allow_single) {
        return Ok(std::array::from_fn(|_| value.clone()));
    }
    <[T; D]>::try_from(values.to_vec()).map_err(|values| {
        Error::Job(cause(
            name,
            format!("has {} values, but the image has {D} axes", values.len()),
            format!("give {D} of them, as in {}", ["", "A,B", "A,B,C"][D - 1]),
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::formats::AnyImage;
    use crate::image::formats::{InputOptions, LoadedImage, read_any};
    use crate::image::{ExactLabels, Image};

    /// Writes a small array and reads it with these options.
    fn read(dims: &[usize], options: [Option<&str>; 4]) -> Result<AnyImage> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let count = dims.iter().product();
        match *dims {
            [nx, ny] => {
                let image = Image::new([nx, ny], vec![1.0; count], Geometry::default());
                super::super::write(&path, &image)?;
            }
            _ => {
                let dims = [dims[0], dims[1], dims[2]];
                let image = Image::new(dims, vec![1.0; count], Geometry::default());
                super::super::write(&path, &image)?;
            }
        }
        let [spacing, origin, unit, axes] = options.map(|word| word.map(String::from));
        let input = InputOptions {
            spacing,
            origin,
            unit,
            axes,
            ..InputOptions::default()
        };
        read_any(&path, &input.read_options_for(&path)?)
    }

    #[test]
    fn an_array_gets_the_given_geometry() {
        let options = [
            "4,12.5,25",
            "1000,2000,-300",
            "m,m,ms",
            "time,crossline,inline",
        ];
        let AnyImage::Space(loaded) = read(&[5, 4, 3], options.map(Some)).unwrap() else {
            panic!("not in space")
        };
        let geometry = &loaded.image.geometry;
        assert_eq!(
            geometry.to_physical([1.0, 2.0, 1.0]),
            [1025.0, 2025.0, -304.0]
        );
        assert_eq!(geometry.units, ["m", "m", "ms"]);
        assert_eq!(geometry.names, ["time", "crossline", "inline"]);
        assert!(loaded.notes.is_empty(), "{:?}", loaded.notes);

        // A 2-D section with time first; one number applies to all axes.
        let options = [Some("5"), None, None, Some("time,x")];
        let AnyImage::Plane(loaded) = read(&[5, 4], options).unwrap() else {
            panic!("not in the plane")
        };
        assert_eq!(loaded.image.geometry.to_physical([1.0, 2.0]), [10.0, -5.0]);
    }

    #[test]
    fn an_image_in_memory_keeps_its_exact_labels() {
        let labels = [16_777_216, 16_777_217, 16_777_217, 16_777_219];
        let labels = ExactLabels::from_integers(labels);
        let mut image = Image::new([4, 1], vec![16_777_216.0; 4], Geometry::default());
        image.labels = Some(labels.clone());
        let loaded = LoadedImage::from(image.with_dead(vec![false, true, false, false]));
        let placement = ImagePlacement {
            spacing: Some(vec![2.0]),
            ..ImagePlacement::default()
        };
        let opened = OpenedImage::InMemory(AnyImage::Plane(loaded));
        let placed = placement.apply(opened, &SegyBytes::default()).unwrap();
        let OpenedImage::InMemory(AnyImage::Plane(placed)) = placed else {
            panic!("not in the plane")
        };
        assert_eq!(placed.image.geometry.axes, [[2.0, 0.0], [0.0, 2.0]]);
        assert_eq!(placed.image.labels, Some(labels));
        assert_eq!(placed.image.dead, [false, true, false, false]);
    }

    #[test]
    fn placements_that_do_not_fit_are_refused() {
        let error_message = |dims: &[usize], words| read(dims, words).unwrap_err().to_string();
        for (options, part) in [
            (
                [Some("1,2"), None, None, None],
                "has 2 values, but the image has 3 axes",
            ),
            ([Some("0"), None, None, None], "is not positive"),
            ([Some("a"), None, None, None], "is not a number"),
            ([None, Some("1"), None, None], "has 1 values"),
            ([None, None, None, Some("x,y,w")], "is not an axis"),
            ([None, None, None, Some("x,y,-y")], "the same coordinate"),
            (
                [None, None, Some("ms,m,m"), Some("time,x,y")],
                "gives a unit of time to x, but time runs along z",
            ),
        ] {
            let message = error_message(&[5, 4, 3], options);
            assert!(message.contains(part), "{message}");
        }
        let message = error_message(&[5, 4], [None, None, None, Some("x,z")]);
        assert!(message.contains("the image is 2-D"), "{message}");
    }

    #[test]
    fn a_placed_file_keeps_its_geometry_and_serves_as_reference() {
        let folder = tempfile::tempdir().unwrap();
        let [placed, bare, small] =
            ["a.vti", "a.npy", "b.npy"].map(|name| folder.path().join(name));
        let geometry = Geometry::with_spacing([7.0, 8.0, 9.0], [1.0, 2.0, 3.0]);
        let image = Image::new([4, 3, 2], vec![1.0; 24], geometry.clone());
        super::super::write(&placed, &image).unwrap();
        super::super::write(&bare, &image).unwrap();
        let other = Image::new([4, 3, 3], vec![1.0; 36], geometry.clone());
        super::super::write(&small, &other).unwrap();
        let read =
            |path: &PathBuf, input: InputOptions| read_any(path, &input.read_options_for(path)?);

        let spacing = InputOptions {
            spacing: Some("2".into()),
            ..InputOptions::default()
        };
        let AnyImage::Space(loaded) = read(&placed, spacing).unwrap() else {
            panic!("not in space")
        };
        assert_eq!(
            loaded.image.geometry.to_physical([1.0; 3]),
            [9.0, 10.0, 11.0]
        );
        let note =
            "--spacing instead of the geometry in the file (spacing 1, 2, 3, origin 7, 8, 9)";
        assert!(loaded.notes.contains(&note.into()), "{:?}", loaded.notes);
        let geometry_from = |path: &PathBuf| InputOptions {
            geometry_from: Some(path.clone()),
            ..InputOptions::default()
        };
        let AnyImage::Space(loaded) = read(&bare, geometry_from(&placed)).unwrap() else {
            panic!("not in space")
        };
        assert_eq!(
            loaded.image.geometry.to_physical([1.0; 3]),
            geometry.to_physical([1.0; 3])
        );
        let message = read(&small, geometry_from(&placed))
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("does not have the [4, 3, 3] samples"),
            "{message}"
        );
        let conflicting = InputOptions {
            origin: Some("0,0,0".into()),
            ..geometry_from(&placed)
        };
        let message = read(&bare, conflicting).unwrap_err().to_string();
        assert!(message.contains("geometry-from"), "{message}");
    }
}
