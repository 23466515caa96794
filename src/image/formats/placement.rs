//! Where an image lies whose file does not say so: bare arrays, pictures, stacks.

use std::path::PathBuf;

use super::stream::{ImageHeader, OpenedImage};
use super::{AnyImage, SegyBytes, open};
use crate::error::{Error, Result, cause};
use crate::image::Geometry;
use crate::image::formats::ReadOptions;

/// How the note ends that a reader makes of a file without geometry.
pub(crate) const NO_GEOMETRY_NOTE: &str = "has no geometry: unit spacing, origin 0";

/// Where an image lies, as a user says it. It applies to files that say no more than unit spacing and origin
/// 0, and is refused for others.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImagePlacement {
    /// Distances between samples along the array's axes, the fastest first; one for all of them will do.
    pub spacing: Option<Vec<f64>>,
    /// Position of the first sample: x, y, z.
    pub origin: Option<Vec<f64>>,
    /// Units of x, y and z; one for all of them will do.
    pub units: Option<Vec<String>>,
    /// What the array's axes are, the fastest first.
    pub axes: Option<Vec<AxisSpec>>,
    /// An image of as many samples that lies where this one shall lie.
    pub reference_image: Option<PathBuf>,
}

/// What an axis of an array is: a coordinate of the world along which it runs, up or down.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisSpec {
    /// What it is called.
    pub name: String,
    /// Number of the coordinate; `None` for the last one, whether there are two or three.
    coordinate: Option<usize>,
    /// Whether the coordinate falls from sample to sample.
    is_descending: bool,
}

impl std::str::FromStr for AxisSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let text = text.trim();
        let bare = text.strip_prefix('-').unwrap_or(text);
        let (coordinate, down) = match bare {
            "x" | "crossline" | "trace" => (Some(0), false),
            "y" | "inline" => (Some(1), false),
            "z" => (Some(2), false),
            "sample" | "time" | "depth" => (None, true),
            _ => {
                return Err(Error::Job(cause(
                    format!("axes {text}"),
                    "is no axis",
                    "give x, y or z (-z where the coordinate falls from sample to sample), or time, depth, sample, crossline, inline",
                )));
            }
        };
        Ok(Self {
            name: bare.to_string(),
            coordinate,
            is_descending: down != text.starts_with('-'),
        })
    }
}

impl AxisSpec {
    /// Number of the coordinate of space, and whether it falls from sample to sample.
    pub(super) fn space_coordinate(&self) -> (usize, bool) {
        (self.coordinate.unwrap_or(2), self.is_descending)
    }
}

/// Returns the short name of a unit of length that microscopes write; `None` for samples and what is no length.
pub fn length_unit(name: &str) -> Option<&'static str> {
    Some(match name.trim().trim_matches('"') {
        "um" | "micron" | "microns" | "micrometer" | "micrometre" | "\u{b5}m" | "\u{3bc}m"
        | "\\u00B5m" | "\\u00b5m" => "um",
        "nm" | "nanometer" | "nanometre" => "nm",
        "mm" | "millimeter" | "millimetre" => "mm",
        "cm" | "centimeter" | "centimetre" => "cm",
        "m" | "meter" | "metre" => "m",
        _ => return None,
    })
}

impl ImagePlacement {
    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Puts an image in its place.
    ///
    /// # Errors
    /// [`Error::Job`] for what does not fit the image, and for an image that lies somewhere already; those
    /// of reading the other image.
    pub(super) fn apply(&self, opened: OpenedImage, segy: &SegyBytes) -> Result<OpenedImage> {
        if self.is_empty() {
            return Ok(opened);
        }
        Ok(match opened {
            OpenedImage::Stream(mut stream) => {
                let from = self.open_reference(segy)?.map(OpenedImage::into_header);
                stream.header = self.place_header(stream.header, from)?;
                OpenedImage::Stream(stream)
            }
            OpenedImage::InMemory(AnyImage::Plane(loaded)) => {
                let from = self.open_reference(segy)?.map(OpenedImage::into_header);
                let head = self.place_header(loaded.header(), from)?;
                OpenedImage::InMemory(AnyImage::Plane(head.with_array(loaded.image.samples)))
            }
            OpenedImage::InMemory(AnyImage::Space(loaded)) => {
                let from = self.open_reference(segy)?.map(OpenedImage::into_header);
                let head = self.place_header(loaded.header(), from)?;
                OpenedImage::InMemory(AnyImage::Space(head.with_array(loaded.image.samples)))
            }
        })
    }

    /// The image whose geometry is asked for; its samples are not read where its headers are enough.
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

    /// One with `D` axes; `from` is the other image, if there is one, if that has as many.
    fn place_header<const D: usize>(
        &self,
        mut head: ImageHeader<D>,
        from: Option<Option<ImageHeader<D>>>,
    ) -> Result<ImageHeader<D>> {
        let name = self.option_name();
        let bare = Geometry::<D>::default();
        let found = &head.geometry;
        let says_units_only = Self {
            units: None,
            ..self.clone()
        }
        .is_empty();
        if !says_units_only && (found.origin, found.axes) != (bare.origin, bare.axes) {
            return Err(Error::Job(cause(
                name,
                format!(
                    "is given, but the file ({}) says itself where it lies",
                    head.format
                ),
                "omit it; to place its samples elsewhere, convert it to .npy first",
            )));
        }
        if !says_units_only {
            head.notes.retain(|note| !note.contains(NO_GEOMETRY_NOTE));
        }
        if let Some(from) = from {
            let dims = head.dims;
            let path = self
                .reference_image
                .as_deref()
                .unwrap_or(std::path::Path::new(""));
            let other = from.filter(|from| from.dims == dims);
            let other = other.ok_or_else(|| {
                Error::Job(cause(
                    name,
                    format!("has not the {dims:?} samples of the image"),
                    "give the image from which this one was made",
                ))
            })?;
            head.geometry = other.geometry;
            head.missing = other.missing;
            head.survey = other.survey;
            head.line_numbers = other.line_numbers;
            head.notes.push(format!("placed as {}", path.display()));
            return Ok(head);
        }
        if self.units.is_some() && found.units.iter().any(|unit| !unit.is_empty()) {
            return Err(Error::Job(cause(
                "unit",
                format!(
                    "is given, but the file has units: {}",
                    found.units.join(", ")
                ),
                "omit it",
            )));
        }
        let mut geometry = match says_units_only {
            true => found.clone(),
            false => self.axis_geometry(found)?,
        };
        if let Some(origin) = &self.origin {
            geometry.origin = expand_to_axes("origin", origin, false)?;
        }
        if let Some(units) = &self.units {
            geometry.units = expand_to_axes("unit", units, true)?;
        }
        head.geometry = geometry;
        Ok(head)
    }

    /// A bare geometry with axes along the coordinates that are asked for, and so long.
    fn axis_geometry<const D: usize>(&self, bare: &Geometry<D>) -> Result<Geometry<D>> {
        let mut geometry = bare.clone();
        let spacing: [f64; D] = match &self.spacing {
            Some(spacing) => expand_to_axes("spacing", spacing, true)?,
            None => [1.0; D],
        };
        if let Some(s) = spacing.iter().find(|s| **s <= 0.0) {
            return Err(Error::Job(cause(
                format!("spacing {s}"),
                "is not positive",
                "give the distance between samples; -x, -y or -z of axes turn one round",
            )));
        }
        let Some(axes) = &self.axes else {
            for k in 0..D {
                geometry.axes[k][k] = spacing[k];
            }
            return Ok(geometry);
        };
        let axes: [AxisSpec; D] = expand_to_axes("axes", axes, false)?;
        let mut taken = [false; D];
        for (k, axis) in axes.iter().enumerate() {
            let c = axis.coordinate.unwrap_or(D - 1);
            // A section has but one axis that is not its last.
            let c = if D == 2 && axis.name == "inline" {
                0
            } else {
                c
            };
            if c >= D || std::mem::replace(&mut taken[c], true) {
                return Err(Error::Job(cause(
                    format!("axes {}", axis.name),
                    match c >= D {
                        true => "is an axis of space, but the image is 2-D",
                        false => "runs along the same coordinate as another axis",
                    },
                    "give each coordinate once: x, y, z say, or time,crossline,inline",
                )));
            }
            let turn = if axis.is_descending { -1.0 } else { 1.0 };
            geometry.axes[k] =
                std::array::from_fn(|at| if at == c { turn * spacing[k] } else { 0.0 });
            geometry.names[k].clone_from(&axis.name);
        }
        Ok(geometry)
    }

    /// The name of what is given.
    fn option_name(&self) -> String {
        match self {
            Self {
                reference_image: Some(path),
                ..
            } => format!("geometry-from {}", path.display()),
            Self {
                spacing: Some(_), ..
            } => "spacing".into(),
            Self {
                origin: Some(_), ..
            } => "origin".into(),
            Self { axes: Some(_), .. } => "axes".into(),
            _ => "unit".into(),
        }
    }
}

/// One value for each axis; of a single one, perhaps, the same for all.
fn expand_to_axes<T: Clone, const D: usize>(
    name: &str,
    values: &[T],
    same: bool,
) -> Result<[T; D]> {
    if let ([value], true) = (values, same) {
        return Ok(std::array::from_fn(|_| value.clone()));
    }
    <[T; D]>::try_from(values.to_vec()).map_err(|values| {
        Error::Job(cause(
            name,
            format!("has {} values, but the image {D} axes", values.len()),
            format!("give {D} of them, as in {}", ["", "A,B", "A,B,C"][D - 1]),
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::image::formats::{InputOptions, read_any};

    /// Reads a small array under these options.
    fn read(dims: &[usize], words: [Option<&str>; 4]) -> Result<AnyImage> {
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
        let [spacing, origin, unit, axes] = words.map(|word| word.map(String::from));
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
    fn an_array_lies_where_it_is_put() {
        let words = [
            "4,12.5,25",
            "1000,2000,-300",
            "m,m,ms",
            "time,crossline,inline",
        ];
        let AnyImage::Space(loaded) = read(&[5, 4, 3], words.map(Some)).unwrap() else {
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

        // A section, time first; one number for all axes.
        let words = [Some("5"), None, None, Some("time,x")];
        let AnyImage::Plane(loaded) = read(&[5, 4], words).unwrap() else {
            panic!("not in the plane")
        };
        assert_eq!(loaded.image.geometry.to_physical([1.0, 2.0]), [10.0, -5.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let refused = |dims: &[usize], words| read(dims, words).unwrap_err().to_string();
        for (words, part) in [
            (
                [Some("1,2"), None, None, None],
                "has 2 values, but the image 3 axes",
            ),
            ([Some("0"), None, None, None], "is not positive"),
            ([Some("a"), None, None, None], "is no number"),
            ([None, Some("1"), None, None], "has 1 values"),
            ([None, None, None, Some("x,y,w")], "is no axis"),
            ([None, None, None, Some("x,y,-y")], "the same coordinate"),
        ] {
            let said = refused(&[5, 4, 3], words);
            assert!(said.contains(part), "{said}");
        }
        let said = refused(&[5, 4], [None, None, None, Some("x,z")]);
        assert!(said.contains("the image is 2-D"), "{said}");
    }

    #[test]
    fn a_file_that_lies_somewhere_stays_there_and_lends_its_place() {
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
        let said = read(&placed, spacing).unwrap_err().to_string();
        assert!(said.contains("says itself where it lies"), "{said}");
        let from = |path: &PathBuf| InputOptions {
            geometry_from: Some(path.clone()),
            ..InputOptions::default()
        };
        let AnyImage::Space(found) = read(&bare, from(&placed)).unwrap() else {
            panic!("not in space")
        };
        assert_eq!(
            found.image.geometry.to_physical([1.0; 3]),
            geometry.to_physical([1.0; 3])
        );
        let said = read(&small, from(&placed)).unwrap_err().to_string();
        assert!(said.contains("has not the [4, 3, 3] samples"), "{said}");
        let both = InputOptions {
            origin: Some("0,0,0".into()),
            ..from(&placed)
        };
        let said = read(&bare, both).unwrap_err().to_string();
        assert!(said.contains("geometry-from"), "{said}");
    }
}
