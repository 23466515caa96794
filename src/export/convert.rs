//! Converts images, grids of heights and surfaces from one format to another, as `atomesh convert`
//! does.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::surfaces::AnySurfaces;
use super::surfaces::vtp::read_surfaces;
use super::{FaultSticks, Gocad, read_gocad, write_sticks};
use crate::error::cause;
use crate::files::output::check_output;
use crate::grid_file::{self, GRID_EXTENSIONS, GridFile, write_grid};
use crate::image::formats::grids::displacement_note;
use crate::image::formats::label_table;
use crate::image::formats::segy::{SegyFloat, write_like};
use crate::image::formats::stream::ImageStream;
use crate::image::formats::with_loaded;
use crate::image::formats::{
    self, AnyImage, IMAGE_EXTENSIONS, ImageFormat, InputOptions, LoadedImage, OpenedImage,
    ReadOptions, SegyBytes, StreamedImage, can_stream, extension,
};
use crate::image::image_in_depth;
use crate::image::stated::StatedCoordinates;
use crate::image::{Image, LabelValue};
use crate::option_text::NumberOrFile;
use crate::surface_file::grid_surfaces::read_grid_surfaces;
use crate::surface_file::interpretation::{PickedShape, PickedSurface, read_interpretation};
use crate::surface_file::obj::read_obj;
use crate::surface_file::ply::read_ply;
use crate::surface_file::stl::read_stl;
use crate::{Error, Result};

/// Options of `atomesh convert`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ConvertSpec {
    /// Convert an image from two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s or a file of
    /// interval velocities in m/s. Such a file is a grid in two-way time, and the image is
    /// resampled
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Write SEG-Y (OUT.sgy) with the headers of this survey, which has as many samples: its text,
    /// lines, coordinates and order of traces
    #[arg(long, value_name = "SURVEY.sgy")]
    pub like: Option<PathBuf>,
    /// The samples of SEG-Y that is written: ibm or ieee floats [default: as in the survey]
    #[arg(long, value_name = "FORMAT", requires = "like")]
    pub sample_format: Option<SegyFloat>,
    /// Write the names of labels that the image or its table has (--label-table): NAMES.csv or .tsv, which
    /// atomesh mesh --label-table reads
    #[arg(long, value_name = "NAMES.csv")]
    pub label_table_out: Option<PathBuf>,
    /// Options for reading the image, and the survey.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// File endings of SEG-Y.
const SEGY_EXTENSIONS: [&str; 2] = ["sgy", "segy"];

/// File endings of surfaces that can be read.
const SURFACE_EXTENSIONS: [&str; 8] = ["vtp", "ts", "pl", "csv", "charisma", "obj", "stl", "ply"];

/// File endings of surfaces that can be written.
const WRITTEN_SURFACE_EXTENSIONS: [&str; 5] = ["vtp", "obj", "ts", "pl", "csv"];

/// File endings of the surfaces that are written from a corner-point grid.
const GRID_SURFACE_EXTENSIONS: [&str; 3] = ["vtp", "obj", "ts"];

/// Returns `true` if the file at `path` holds surfaces and no image, judged by its ending.
fn holds_surfaces(path: &Path) -> bool {
    SURFACE_EXTENSIONS.contains(&extension(path).as_str())
}

/// The content that a corner-point grid is converted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum GridTarget {
    /// A property on a lattice.
    Image,
    /// Faults and horizons.
    Surfaces,
    /// The grid in another format.
    Grid,
}

impl GridTarget {
    /// Returns what the file `output` holds of the grid at `input`, judged by its ending; `None` if
    /// `input` holds no corner-point grid.
    fn of_files(input: &Path, output: &Path) -> Option<Self> {
        let ending = extension(output);
        let is_grid = grid_file::is_grid(input) || grid_file::split_name(input).is_some();
        is_grid.then(|| {
            if GRID_SURFACE_EXTENSIONS.contains(&ending.as_str()) {
                Self::Surfaces
            } else if GRID_EXTENSIONS.contains(&ending.as_str()) {
                Self::Grid
            } else {
                Self::Image
            }
        })
    }
}

impl ConvertSpec {
    /// Checks that the options apply to the files.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that does not apply.
    pub fn validate(&self, input: &Path, output: &Path) -> Result<()> {
        let refuse_velocity = |problem: &str, remedy: &str| match &self.velocity {
            Some(velocity) => {
                let place = format!("velocity {velocity}");
                Err(Error::Job(cause(place, problem, remedy)))
            }
            None => Ok(()),
        };
        if self.label_table_out.is_none() {
            self.input.refuse_label_table()?;
        } else if holds_surfaces(input) || self.like.is_some() {
            let problem = "writes names of labels, and the input has none";
            return Err(Error::Job(cause("label-table-out", problem, "omit it")));
        }
        if let Some(target @ (GridTarget::Surfaces | GridTarget::Grid)) =
            GridTarget::of_files(input, output)
        {
            return self.refuse_image_options(target);
        }
        if holds_surfaces(input) {
            self.input.refuse_unused("surfaces are read", "omit it")?;
            return refuse_velocity(
                "converts images to depth, but the input holds surfaces",
                "extract the surfaces in depth with atomesh surface --velocity",
            );
        }
        if let (Some(format), None) = (self.sample_format, &self.like) {
            let problem = "is for SEG-Y, which is written with the headers of a survey";
            let remedy = "omit it, or give the survey: --like survey.sgy";
            return Err(Error::Job(cause(
                format!("sample-format {format}"),
                problem,
                remedy,
            )));
        }
        if self.like.is_some() {
            return refuse_velocity(
                "makes a volume in depth, but the survey's headers are in time",
                "omit it, or write .vti",
            );
        }
        if SEGY_EXTENSIONS.contains(&extension(output).as_str()) {
            let place = format!("OUT {}", output.display());
            let problem = "is SEG-Y, which is written with the headers of a survey";
            let remedy = "give the survey from which the volume was made: --like survey.sgy";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        Ok(())
    }
}

impl ConvertSpec {
    /// Checks that no option of images is given where a corner-point grid is not sampled.
    fn refuse_image_options(&self, target: GridTarget) -> Result<()> {
        let result = match target {
            GridTarget::Surfaces => "surfaces are written",
            _ => "a corner-point grid is written",
        };
        self.input
            .refuse_unused(result, "omit it, or write an image")?;
        let given = [
            ("velocity", self.velocity.is_some()),
            ("like", self.like.is_some()),
            ("sample-format", self.sample_format.is_some()),
            ("label-table-out", self.label_table_out.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => {
                let problem = format!("is for images, but {result}");
                Err(Error::Job(cause(
                    *name,
                    problem,
                    "omit it, or write an image",
                )))
            }
            None => Ok(()),
        }
    }

    /// Checks that the options apply to the files, and that the output has the right ending and
    /// replaces no input.
    ///
    /// # Errors
    /// Returns the errors of [`validate`](Self::validate), and [`Error::Job`] or [`Error::Io`] that
    /// names the output.
    pub fn check_files(&self, input: &Path, output: &Path) -> Result<()> {
        self.validate(input, output)?;
        if holds_surfaces(input) {
            return check_output(output, "OUT", &WRITTEN_SURFACE_EXTENSIONS, &[input]);
        }
        let grid = formats::file_of_data_set(input);
        let mut inputs = vec![grid.as_deref().unwrap_or(input)];
        match GridTarget::of_files(input, output) {
            Some(GridTarget::Surfaces) => {
                return check_output(output, "OUT", &GRID_SURFACE_EXTENSIONS, &inputs);
            }
            Some(GridTarget::Grid) => {
                return check_output(output, "OUT", &GRID_EXTENSIONS, &inputs);
            }
            _ => {}
        }
        inputs.extend(self.input.geometry_from.as_deref());
        inputs.extend(self.like.as_deref());
        inputs.extend(self.velocity.as_ref().and_then(NumberOrFile::file));
        let endings = match &self.like {
            Some(_) => &SEGY_EXTENSIONS[..],
            None => &IMAGE_EXTENSIONS,
        };
        inputs.extend(self.input.label_table.as_deref());
        check_output(output, "OUT", endings, &inputs)?;
        let Some(table) = &self.label_table_out else {
            return Ok(());
        };
        inputs.push(output);
        check_output(table, "label-table-out", &["csv", "tsv"], &inputs)
    }
}

/// Opens the image that has this name, with these options.
pub type OpenImage<'a> = &'a dyn Fn(&Path, &InputOptions) -> Result<OpenedImage>;

/// Opens an image file, with options for what the file lacks.
///
/// # Errors
/// Returns the errors of [`formats::read_any`] and of [`InputOptions::read_options_for`].
pub fn open_with_options(path: &Path, input: &InputOptions) -> Result<OpenedImage> {
    formats::open(path, &input.read_options_for(path)?)
}

/// The content of a file in the form in which another file holds it.
#[non_exhaustive]
pub enum Converted {
    /// An image that may be larger than memory: it is written as it is read.
    Stream(ImageStream),
    /// An image.
    Image(AnyImage),
    /// A volume that is written with the headers of a SEG-Y file.
    Survey(SurveyCopy),
    /// Surfaces or curves.
    Surfaces(AnySurfaces),
    /// A corner-point grid.
    Grid(GridCopy),
    /// Fault sticks.
    Sticks(Vec<FaultSticks>),
}

/// A corner-point grid that is written in another format.
pub struct GridCopy(GridFile);

/// A volume, and the survey whose headers it gets.
#[derive(Debug)]
pub struct SurveyCopy {
    image: Image<3>,
    template: PathBuf,
    bytes: SegyBytes,
    sample_format: Option<SegyFloat>,
}

/// Reads an image or surfaces, and converts them to what the file `output` holds, as `atomesh
/// convert` does. [`Converted::write`] writes it. `open` opens images. Also returns notes for the
/// user.
///
/// ```
/// use atomesh::export::convert::{ConvertSpec, convert, open_with_options};
/// use atomesh::image::{Geometry, Image, formats};
///
/// let [from, to] = ["npy", "vti"].map(|ending| {
///     std::env::temp_dir().join(format!("atomesh-convert-example.{ending}"))
/// });
/// formats::write(&from, &Image::new([3, 4], vec![0.5; 12], Geometry::default()))?;
/// let (converted, _) = convert(&from, &to, &ConvertSpec::default(), &open_with_options)?;
/// converted.write(&to)?;
/// let image = formats::read_any(&to, &Default::default())?.into_image::<2>();
/// assert_eq!(image.map(|image| image.dims()), Some([3, 4]));
/// # [from, to].map(|path| std::fs::remove_file(path).ok());
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns the errors of [`ConvertSpec::validate`], those of reading, and [`Error::Job`] for content
/// that `output` cannot hold.
pub fn convert(
    input: &Path,
    output: &Path,
    spec: &ConvertSpec,
    open: OpenImage<'_>,
) -> Result<(Converted, Vec<String>)> {
    spec.validate(input, output)?;
    match GridTarget::of_files(input, output) {
        Some(GridTarget::Surfaces) => {
            let (file, notes) = read_grid_surfaces(input)?;
            let converted = Converted::Surfaces(file.into()).checked(input)?;
            return Ok((converted, notes));
        }
        Some(GridTarget::Grid) => {
            let (grid, _) = GridFile::open(input, &|_| true)?;
            let notes = grid.notes.clone();
            return Ok((Converted::Grid(GridCopy(grid)), notes));
        }
        _ => {}
    }
    if holds_surfaces(input) {
        return convert_surfaces(input, output);
    }
    if let Some(template) = &spec.like {
        return Ok((spec.survey_copy(input, template, open)?, Vec::new()));
    }
    match open(input, &spec.input)? {
        OpenedImage::Stream(stream) if spec.velocity.is_none() && can_stream(output) => {
            let notes = stream.header.notes.clone();
            Ok((Converted::Stream(stream), notes))
        }
        other => {
            with_loaded!(other.load(input)?, loaded => spec.image_in_depth(loaded, output, open))
        }
    }
}

impl ConvertSpec {
    /// Returns the image, in depth if a velocity is given, with notes.
    fn image_in_depth<const D: usize>(
        &self,
        loaded: LoadedImage<D>,
        output: &Path,
        open: OpenImage<'_>,
    ) -> Result<(Converted, Vec<String>)>
    where
        LoadedImage<D>: Into<AnyImage>,
    {
        let read = |path: &Path, input: &InputOptions| open(path, input)?.load(path);
        let (image, conversion) =
            image_in_depth(loaded.image, self.velocity.as_ref(), false, &read)?;
        let mut notes = loaded.notes.clone();
        notes.extend(
            conversion
                .into_iter()
                .flat_map(|conversion| conversion.notes),
        );
        if D == 2 {
            notes.extend(displacement_note(output, image.dims(), &image.geometry));
        }
        let converted = LoadedImage { image, ..loaded };
        Ok((Converted::Image(converted.into()), notes))
    }

    /// Returns a volume with the survey whose headers it gets.
    fn survey_copy(&self, path: &Path, template: &Path, open: OpenImage<'_>) -> Result<Converted> {
        let bytes = self.input.read_options()?.segy;
        let is_segy =
            formats::detect(path, &ReadOptions::default()).ok() == Some(ImageFormat::Segy);
        let input = if is_segy {
            self.input.clone()
        } else {
            self.input.without_segy()
        };
        let AnyImage::Space(loaded) = open(path, &input)?.load(path)? else {
            let problem = "is a 2-D image, not a volume";
            let remedy = "give a volume that was made from the survey";
            return Err(Error::Job(cause(path.display(), problem, remedy)));
        };
        Ok(Converted::Survey(SurveyCopy {
            image: loaded.image,
            template: template.to_path_buf(),
            bytes,
            sample_format: self.sample_format,
        }))
    }
}

/// Reads the fault sticks of a file.
fn sticks_of(path: &Path) -> Result<Vec<FaultSticks>> {
    let fault = |surface: PickedSurface| match surface.shape {
        PickedShape::Sticks(sticks) => Ok(FaultSticks {
            name: surface.name,
            sticks,
            coordinates: surface.coordinates,
        }),
        _ => {
            let problem = format!("{} has no sticks", surface.name);
            let remedy = "give columns fault,stick,x,y,z";
            Err(Error::Job(cause(path.display(), problem, remedy)))
        }
    };
    read_interpretation(path)?.into_iter().map(fault).collect()
}

/// Reads surfaces, lines or sticks, and returns them in the form that `output` holds, with notes.
/// Coordinates stay as they are; `output` states their units and the direction of z as `input` does.
fn convert_surfaces(input: &Path, output: &Path) -> Result<(Converted, Vec<String>)> {
    let converted = read_converted(input, output)?;
    let stated = converted.stated();
    let [input, output] = [input, output].map(Path::display);
    let mut notes = Vec::new();
    if converted.states_direction() && stated.z_direction.is_none() {
        notes.push(format!(
            "{input} does not say whether z grows upwards or downwards: {output} says upwards"
        ));
    }
    if let Converted::Sticks(_) = converted {
        let named =
            |(name, unit): (&str, &Option<String>)| Some(format!("{name} in {}", unit.as_ref()?));
        let mut words: Vec<String> = ["x", "y", "z"]
            .into_iter()
            .zip(&stated.units)
            .filter_map(named)
            .collect();
        words.extend(stated.z_direction.map(|direction| format!("z {direction}")));
        if !words.is_empty() {
            notes.push(format!(
                "{output} cannot say what {input} says: {}",
                words.join(", ")
            ));
        }
    }
    Ok((converted, notes))
}

/// Reads surfaces, lines or sticks, and returns them in the form that `output` holds.
fn read_converted(input: &Path, output: &Path) -> Result<Converted> {
    let joined = |sticks: &[FaultSticks]| -> Result<AnySurfaces> {
        let stated = sticks
            .first()
            .map(|fault| fault.coordinates.clone())
            .unwrap_or_default();
        if extension(output) == "pl" {
            let mut file = FaultSticks::to_lines(sticks);
            file.set_stated(stated);
            return Ok(AnySurfaces::Curves(file));
        }
        let mut file = FaultSticks::to_surfaces(sticks)?;
        file.set_stated(stated);
        Ok(AnySurfaces::Surfaces(file))
    };
    let is_to_sticks = extension(output) == "csv";
    let stem = input.file_stem().unwrap_or_default().to_string_lossy();
    let content = match extension(input).as_str() {
        "vtp" => AnySurfaces::Surfaces(read_surfaces(input)?),
        "obj" => AnySurfaces::Surfaces(read_obj(input, &stem)?),
        "stl" => AnySurfaces::Surfaces(read_stl(input, &stem)?),
        "ply" => AnySurfaces::Surfaces(read_ply(input, &stem)?),
        "csv" | "charisma" => {
            let sticks = sticks_of(input)?;
            let converted = if is_to_sticks {
                Converted::Sticks(sticks)
            } else {
                Converted::Surfaces(joined(&sticks)?)
            };
            return converted.checked(input);
        }
        _ => match read_gocad(input)? {
            Gocad::Surfaces(file) => AnySurfaces::Surfaces(file),
            Gocad::Lines(file) => AnySurfaces::Curves(file),
        },
    };
    let converted = match content {
        AnySurfaces::Surfaces(_) if extension(output) == "pl" => {
            let remedy =
                "write surfaces as .ts, or as sticks (.csv), which can be converted to .pl";
            let place = format!("OUT {}", output.display());
            let problem = format!("holds lines, but {} surfaces", input.display());
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        AnySurfaces::Surfaces(file) if is_to_sticks => {
            Converted::Sticks(FaultSticks::from_surfaces(&file, None))
        }
        AnySurfaces::Curves(file) if is_to_sticks => {
            Converted::Sticks(FaultSticks::from_lines(&file))
        }
        content => Converted::Surfaces(content),
    };
    converted.checked(input)
}

impl Converted {
    /// Checks that there is a surface. `input` is the file that was read.
    fn checked(self, input: &Path) -> Result<Self> {
        if self.surface_count() > 0 {
            return Ok(self);
        }
        let remedy = "give a file with surfaces";
        Err(Error::Job(cause(
            input.display(),
            "holds no surface",
            remedy,
        )))
    }

    /// Returns what the file that was read states about the coordinates of surfaces.
    fn stated(&self) -> StatedCoordinates {
        match self {
            Self::Surfaces(AnySurfaces::Curves(file)) => file.stated.clone(),
            Self::Surfaces(AnySurfaces::Surfaces(file)) => file.stated.clone(),
            Self::Sticks(sticks) => sticks
                .first()
                .map(|fault| fault.coordinates.clone())
                .unwrap_or_default(),
            _ => StatedCoordinates::default(),
        }
    }

    /// Returns `true` if the file that is written states the direction of z.
    fn states_direction(&self) -> bool {
        matches!(self, Self::Surfaces(_))
    }

    /// Returns the number of surfaces; 0 for images.
    pub fn surface_count(&self) -> usize {
        match self {
            Self::Surfaces(surfaces) => surfaces.count(),
            Self::Sticks(sticks) => sticks.len(),
            _ => 0,
        }
    }

    /// Returns the names of the labels of an image.
    fn label_names(&self) -> &[(LabelValue, String)] {
        match self {
            Self::Stream(stream) => &stream.header.label_names,
            Self::Image(image) => with_loaded!(image, loaded => &loaded.image.label_names),
            _ => &[],
        }
    }

    /// Writes the names of labels to a table. Returns their number.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there are none, and [`Error::Io`] if the file cannot be written.
    pub fn write_label_table(&self, path: &Path) -> Result<usize> {
        let names = self.label_names();
        if names.is_empty() {
            let place = format!("label-table-out {}", path.display());
            let problem =
                "has no names to write, as neither the image nor a table names its labels";
            return Err(Error::Job(cause(
                place,
                problem,
                "omit it, or give --label-table",
            )));
        }
        label_table::write(path, names)?;
        Ok(names.len())
    }

    /// Returns the number of samples along each axis of an image, or of cells along each axis of a grid;
    /// for surfaces it is empty.
    pub fn dims(&self) -> Vec<usize> {
        match self {
            Self::Stream(stream) => stream.header.dims.to_vec(),
            Self::Image(image) => image.dims(),
            Self::Survey(copy) => copy.image.dims().to_vec(),
            Self::Grid(GridCopy(grid)) => grid.dims.to_vec(),
            Self::Surfaces(_) | Self::Sticks(_) => Vec::new(),
        }
    }

    /// Writes the content in the format of the file's ending. Returns notes for the user.
    ///
    /// # Errors
    /// Returns the errors of [`formats::write`], of
    /// [`SurfaceFile::write`](super::SurfaceFile::write), of [`write_sticks`] and of [`write_like`].
    pub fn write(&self, path: &Path) -> Result<Vec<String>> {
        match self {
            Self::Stream(stream) => {
                let head = &stream.header;
                let parts = StreamedImage {
                    dims: head.dims,
                    geometry: &head.geometry,
                    missing: &head.missing,
                    line_numbers: head.line_numbers,
                    sample_type: stream.encoding.sample_type,
                    slabs: stream,
                };
                parts.write(path)?;
                return Ok(stream.rounding_note().into_iter().collect());
            }
            Self::Image(image) => image.write(path)?,
            Self::Survey(copy) => {
                let SurveyCopy {
                    image,
                    template,
                    bytes,
                    sample_format,
                } = copy;
                return write_like(path, image, template, bytes, *sample_format);
            }
            Self::Surfaces(surfaces) => surfaces.write(path)?,
            Self::Sticks(sticks) => write_sticks(path, sticks)?,
            Self::Grid(GridCopy(grid)) => write_grid(path, grid)?,
        }
        Ok(Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::surface_file::SurfaceFile;

    #[test]
    fn options_that_do_not_apply_are_refused() {
        let velocity = ConvertSpec {
            velocity: Some(NumberOrFile::Constant(2000.0)),
            ..ConvertSpec::default()
        };
        let like = ConvertSpec {
            like: Some("survey.sgy".into()),
            ..velocity.clone()
        };
        let float = ConvertSpec {
            sample_format: Some(SegyFloat::Ibm),
            ..ConvertSpec::default()
        };
        for (spec, input, output, expected) in [
            (velocity, "a.ts", "b.vtp", "velocity 2000: converts images"),
            (like, "a.npy", "b.sgy", "velocity 2000: makes a volume"),
            (float, "a.npy", "b.vti", "sample-format ibm: is for SEG-Y"),
            (
                ConvertSpec::default(),
                "a.npy",
                "b.sgy",
                "OUT b.sgy: is SEG-Y",
            ),
        ] {
            let error = spec.validate(input.as_ref(), output.as_ref()).unwrap_err();
            assert!(error.to_string().starts_with(expected), "{error}");
        }
    }

    #[test]
    fn images_and_surfaces_keep_their_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let image = Image::new(
            [3, 4],
            (0..12_u8).map(f32::from).collect(),
            Geometry::default(),
        );
        formats::write(&path("a.npy"), &image).unwrap();
        let nodes = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        let file = SurfaceFile::new(&nodes, &[[0, 1, 2], [0, 2, 3]], &[0, 2], "fault");
        file.write(&path("a.ts")).unwrap();
        for (from, to) in [("a.npy", "b.vti"), ("a.ts", "b.vtp")] {
            let spec = ConvertSpec::default();
            let (converted, _) =
                convert(&path(from), &path(to), &spec, &open_with_options).unwrap();
            converted.write(&path(to)).unwrap();
        }
        let read = formats::read_any(&path("b.vti"), &ReadOptions::default()).unwrap();
        assert_eq!(read.into_image::<2>().unwrap().samples, image.samples);
        assert_eq!(read_surfaces(&path("b.vtp")).unwrap().facets.len(), 2);
        let spec = ConvertSpec::default();
        let lines = convert(&path("a.ts"), &path("b.pl"), &spec, &open_with_options);
        let error = lines.err().unwrap().to_string();
        assert!(error.contains("holds lines"), "{error}");
    }
}
