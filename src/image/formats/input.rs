//! Options for reading an image whose file lacks information.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::placement::ImagePlacement;
use super::{
    AnyImage, Crop, ImageFormat, OpenedImage, ReadOptions, SegyBytes, detect, name_labels,
    restricted,
};
use crate::error::cause;
use crate::option_text::deserialize_optional;
use crate::{Error, Result};

/// Reads the image that has this name, with these options.
pub type ReadImage<'a> = &'a dyn Fn(&Path, &InputOptions) -> Result<AnyImage>;

/// Reads an image from a file, with options for what the file lacks.
///
/// # Errors
/// Returns the errors of [`read_any`](super::read_any) and of
/// [`InputOptions::read_options_for`].
pub fn read_with_options(path: &Path, input: &InputOptions) -> Result<AnyImage> {
    super::read_any(path, &input.read_options_for(path)?)
}

/// The quantity along a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SampleDomain {
    /// Two-way time
    Time,
    /// Depth
    Depth,
}

impl std::fmt::Display for SampleDomain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Time => "time",
            Self::Depth => "depth",
        })
    }
}

/// Options for reading an image whose file lacks information.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct InputOptions {
    /// The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    /// 100x400x208:f32be
    #[arg(long, value_name = "DIMS:TYPE")]
    #[serde(deserialize_with = "deserialize_optional")]
    pub raw: Option<String>,
    /// Distances between samples along the axes of the array, the fastest first, or one for all: for
    /// an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of the
    /// lattice on which a corner-point grid is sampled
    #[arg(long, value_name = "A,B,C")]
    #[serde(deserialize_with = "deserialize_optional")]
    pub spacing: Option<String>,
    /// The position of the first sample
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    #[serde(deserialize_with = "deserialize_optional")]
    pub origin: Option<String>,
    /// Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft, ms, um.
    /// They replace those of the file; numbers are not converted
    #[arg(long, value_name = "U,V,W")]
    #[serde(deserialize_with = "deserialize_optional")]
    pub unit: Option<String>,
    /// The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from sample
    /// to sample), or time, depth, sample (all downwards), crossline, inline [default: those of the
    /// file, or x,y,z]
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true)]
    #[serde(deserialize_with = "deserialize_optional")]
    pub axes: Option<String>,
    /// Distance between samples along the vertical axis (time, depth or z), in its unit, in place of
    /// that of the file
    #[arg(long, value_name = "STEP")]
    pub interval: Option<f64>,
    /// Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    #[arg(long, value_name = "IMAGE")]
    pub geometry_from: Option<PathBuf>,
    /// Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    /// option common null values are recognised, and traces that are zero throughout count as
    /// missing
    #[arg(long, value_name = "V,...", allow_hyphen_values = true)]
    #[serde(deserialize_with = "deserialize_optional")]
    pub null: Option<String>,
    /// An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    /// left out, and neither they nor their edge are features
    #[arg(long, value_name = "IMAGE")]
    pub mask: Option<PathBuf>,
    /// The block of the image to read, both ends included: ranges of line numbers, of coordinates or
    /// of indices from 0, separated by commas, such as inline=100:200,time=1000:1500, x=A:B,y=A:B,z=A:B
    /// or i=A:B. Everything is as if the file held only this block
    #[arg(long, value_name = "RANGES")]
    #[serde(deserialize_with = "deserialize_optional")]
    pub crop: Option<String>,
    /// Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or .vtp), or an
    /// image with as many samples that is 0 outside
    #[arg(long, value_name = "FILE")]
    pub inside: Option<PathBuf>,
    /// A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of the
    /// layer to read, from 0
    #[arg(long, value_name = "N")]
    pub layer: Option<usize>,
    /// Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of values and
    /// names (.csv, .tsv). none: not those of a table that lies beside the image
    #[arg(long, value_name = "FILE")]
    pub label_table: Option<PathBuf>,
    /// SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual header
    /// says so]. In depth, sample intervals are in thousandths of a metre or foot, and the first
    /// sample in metres or feet
    #[arg(long, value_name = "DOMAIN")]
    pub domain: Option<SampleDomain>,
    /// SEG-Y: trace header byte of the inline number [default: 189]
    #[arg(long, value_name = "BYTE")]
    pub inline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the crossline number [default: 193]
    #[arg(long, value_name = "BYTE")]
    pub crossline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the x coordinate [default: 181]
    #[arg(long, value_name = "BYTE")]
    pub x_byte: Option<usize>,
    /// SEG-Y: trace header byte of the y coordinate [default: 185]
    #[arg(long, value_name = "BYTE")]
    pub y_byte: Option<usize>,
    /// SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    #[arg(long, value_name = "BYTE")]
    pub scalar_byte: Option<usize>,
    /// SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    #[arg(long, value_name = "BYTE")]
    pub delay_byte: Option<usize>,
    /// SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    #[arg(long, value_name = "BYTE")]
    pub interval_byte: Option<usize>,
}

impl InputOptions {
    /// Checks that no option is given where no image is read; `reason` says why none is read.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if an option is given.
    pub fn refuse_unused(&self, reason: &str, remedy: &str) -> Result<()> {
        let Some(given) = self.given_option() else {
            return Ok(());
        };
        let problem = format!("is for files of images, but {reason}");
        Err(Error::Job(cause(format!("--{given}"), problem, remedy)))
    }

    /// Checks that no table of labels is given where no label has a name.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if one is given.
    pub fn refuse_label_table(&self) -> Result<()> {
        let Some(table) = &self.label_table else {
            return Ok(());
        };
        let problem = "names labels, which have no names here";
        let remedy = "omit it; atomesh mesh, convert and info use it";
        let place = format!("label-table {}", table.display());
        Err(Error::Job(cause(place, problem, remedy)))
    }

    /// Returns the name of the first option that is given.
    fn given_option(&self) -> Option<String> {
        let options = serde_json::to_value(self).ok()?;
        let mut given = options.as_object()?.iter().filter(|(_, v)| !v.is_null());
        given.next().map(|(name, _)| name.clone())
    }

    /// Returns the options for the reader.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if the description of raw samples or the geometry cannot be
    /// parsed, or if a byte lies outside a trace header.
    pub fn read_options(&self) -> Result<ReadOptions> {
        let standard = SegyBytes::default();
        let segy = SegyBytes {
            inline: self.inline_byte.unwrap_or(standard.inline),
            crossline: self.crossline_byte.unwrap_or(standard.crossline),
            x: self.x_byte.unwrap_or(standard.x),
            y: self.y_byte.unwrap_or(standard.y),
            scalar: self.scalar_byte.unwrap_or(standard.scalar),
            delay: self.delay_byte.unwrap_or(standard.delay),
            dt: self.interval_byte.unwrap_or(standard.dt),
            is_depth: self.domain.map(|domain| domain == SampleDomain::Depth),
        };
        segy.check()?;
        let raw = |text: &String| -> Result<_> {
            text.parse()
                .map_err(|error: Error| error.with_place(format!("raw {text}")))
        };
        let raw = self.raw.as_ref().map(raw).transpose()?;
        Ok(ReadOptions {
            raw,
            segy,
            placement: self.placement()?,
            nulls: self.nulls()?,
            mask: self.mask.clone(),
            crop: self.crop()?,
            layer: self.layer,
            label_table: self.label_table.clone(),
            inside: self.inside.clone(),
        })
    }

    /// Returns the block of the image that is read, if one is given.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if it cannot be parsed.
    fn crop(&self) -> Result<Option<Crop>> {
        self.crop.as_deref().map(str::parse).transpose()
    }

    /// Returns the part that the options give of an image in memory, which has the name `place`.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that are for files only, the errors of
    /// [`read_options`](Self::read_options), and those of the files that the options name.
    pub fn part_in_memory(&self, image: AnyImage, place: &Path) -> Result<AnyImage> {
        let others = Self {
            null: None,
            crop: None,
            inside: None,
            label_table: None,
            ..self.clone()
        };
        others.refuse_unused(
            "the image is in memory",
            "omit it; spacing, origin and units are those of the image in memory",
        )?;
        let options = ReadOptions {
            crop: self.crop()?,
            inside: self.inside.clone(),
            ..ReadOptions::default()
        };
        let mut opened = OpenedImage::InMemory(image).with_nulls(&self.nulls()?);
        if let Some(table) = &self.label_table {
            name_labels(&mut opened, place, Some(table))?;
        }
        restricted(opened, place, &options)?.load(place)
    }

    /// Returns the null values.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if a value is not a number.
    pub fn nulls(&self) -> Result<Vec<f32>> {
        if self.keeps_nulls() {
            return Ok(Vec::new());
        }
        let number = |text: &str| -> Result<f32> {
            let remedy = "give numbers with commas between them, or none";
            let parsed = text.parse::<f32>();
            parsed.map_err(|_| Error::Job(cause(text, "is not a number", remedy)))
        };
        parse_list("null", &self.null, number).map(Option::unwrap_or_default)
    }

    /// Returns the null values of points and surfaces: `None` recognises common ones, and an empty
    /// list keeps all values.
    ///
    /// # Errors
    /// Returns an [`Error::Job`] if a value is not a number.
    pub fn point_nulls(&self) -> Result<Option<Vec<f64>>> {
        let nulls = self.nulls()?.into_iter().map(f64::from).collect();
        Ok(self.null.as_ref().map(|_| nulls))
    }

    /// Returns `true` if no value but NaN stands for missing samples.
    pub fn keeps_nulls(&self) -> bool {
        self.null.as_deref() == Some("none")
    }

    /// Returns the geometry that the options give.
    fn placement(&self) -> Result<ImagePlacement> {
        let number = |text: &str| -> Result<f64> {
            let parsed = text.parse::<f64>().ok().filter(|number| number.is_finite());
            let remedy = "give numbers with commas between them";
            parsed.ok_or_else(|| Error::Job(cause(text, "is not a number", remedy)))
        };
        let placement = ImagePlacement {
            spacing: parse_list("spacing", &self.spacing, number)?,
            origin: parse_list("origin", &self.origin, number)?,
            units: parse_list("unit", &self.unit, |text| Ok(text.to_string()))?,
            axes: parse_list("axes", &self.axes, FromStr::from_str)?,
            interval: self.interval,
            reference_image: self.geometry_from.clone(),
        };
        let other_options = [&self.spacing, &self.origin, &self.unit, &self.axes];
        if let Some(path) = &placement.reference_image
            && (other_options.iter().any(|other| other.is_some()) || self.interval.is_some())
        {
            return Err(Error::Job(cause(
                format!("geometry-from {}", path.display()),
                "gives the complete geometry",
                "omit spacing, origin, unit, axes and interval",
            )));
        }
        Ok(placement)
    }

    /// Returns these options, completed by those of `fallback` where these are not given.
    pub fn with_fallback(&self, fallback: &Self) -> Self {
        Self {
            raw: self.raw.clone().or_else(|| fallback.raw.clone()),
            spacing: self.spacing.clone().or_else(|| fallback.spacing.clone()),
            origin: self.origin.clone().or_else(|| fallback.origin.clone()),
            unit: self.unit.clone().or_else(|| fallback.unit.clone()),
            axes: self.axes.clone().or_else(|| fallback.axes.clone()),
            interval: self.interval.or(fallback.interval),
            geometry_from: (self.geometry_from.clone()).or_else(|| fallback.geometry_from.clone()),
            null: self.null.clone().or_else(|| fallback.null.clone()),
            mask: self.mask.clone().or_else(|| fallback.mask.clone()),
            crop: self.crop.clone().or_else(|| fallback.crop.clone()),
            inside: self.inside.clone().or_else(|| fallback.inside.clone()),
            layer: self.layer.or(fallback.layer),
            label_table: (self.label_table.clone()).or_else(|| fallback.label_table.clone()),
            domain: self.domain.or(fallback.domain),
            inline_byte: self.inline_byte.or(fallback.inline_byte),
            crossline_byte: self.crossline_byte.or(fallback.crossline_byte),
            x_byte: self.x_byte.or(fallback.x_byte),
            y_byte: self.y_byte.or(fallback.y_byte),
            scalar_byte: self.scalar_byte.or(fallback.scalar_byte),
            delay_byte: self.delay_byte.or(fallback.delay_byte),
            interval_byte: self.interval_byte.or(fallback.interval_byte),
        }
    }

    /// Returns these options without those of SEG-Y.
    pub fn without_segy(&self) -> Self {
        Self {
            domain: None,
            inline_byte: None,
            crossline_byte: None,
            x_byte: None,
            y_byte: None,
            scalar_byte: None,
            delay_byte: None,
            interval_byte: None,
            ..self.clone()
        }
    }

    /// Returns the options for reading the file at `path`.
    ///
    /// # Errors
    /// Returns the errors of [`InputOptions::read_options`] and [`detect`], and an [`Error::Job`]
    /// if SEG-Y header bytes are given for a file in another format.
    pub fn read_options_for(&self, path: &Path) -> Result<ReadOptions> {
        let options = self.read_options()?;
        if let Some(layer) = self.layer {
            let format = detect(path, &options)?;
            if !matches!(format, ImageFormat::Nrrd | ImageFormat::Dicom) {
                return Err(Error::Job(cause(
                    format!("layer {layer}"),
                    format!(
                        "applies to segmentations of 3D Slicer (.seg.nrrd) and of DICOM, but {} is read as {format}",
                        path.display()
                    ),
                    "omit it",
                )));
            }
        }
        let domain = self.domain.map(|domain| domain.to_string());
        let byte = |byte: Option<usize>| byte.map(|byte| byte.to_string());
        let bytes = [
            ("domain", domain),
            ("inline-byte", byte(self.inline_byte)),
            ("crossline-byte", byte(self.crossline_byte)),
            ("x-byte", byte(self.x_byte)),
            ("y-byte", byte(self.y_byte)),
            ("scalar-byte", byte(self.scalar_byte)),
            ("delay-byte", byte(self.delay_byte)),
            ("interval-byte", byte(self.interval_byte)),
        ];
        if let Some((name, byte)) = (bytes.into_iter()).find_map(|(name, byte)| Some((name, byte?)))
        {
            let format = detect(path, &options)?;
            let reference_format = options
                .placement
                .reference_image
                .as_deref()
                .map(|reference| {
                    let defaults = ReadOptions::default();
                    detect(reference, &defaults)
                });
            if format != ImageFormat::Segy
                && reference_format.transpose()? != Some(ImageFormat::Segy)
            {
                return Err(Error::Job(cause(
                    format!("{name} {byte}"),
                    format!(
                        "applies to SEG-Y, but {} is read as {format}",
                        path.display()
                    ),
                    "omit it",
                )));
            }
        }
        Ok(options)
    }
}

/// Parses a list of values separated by commas.
fn parse_list<T>(
    name: &str,
    text: &Option<String>,
    parse: impl Fn(&str) -> Result<T>,
) -> Result<Option<Vec<T>>> {
    let Some(text) = text else { return Ok(None) };
    let parts = text.split(',').map(|part| parse(part.trim()));
    let parts: Result<Vec<T>> = parts.collect();
    let with_name = |error: Error| {
        if error.cause().place.starts_with(name) {
            error
        } else {
            error.with_place(format!("{name} {text}"))
        }
    };
    parts.map(Some).map_err(with_name)
}
