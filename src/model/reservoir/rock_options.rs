//! Options for rock properties: numbers, tables by region, arrays of the mesh, or images that are
//! averaged over cells.

use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::averaging::ImageProbe;
use super::{DeckRegions, MILLIDARCY, MeanKind, Model, PreparedModel};
use crate::error::cause;
use crate::files::table::quantities_by_region;
use crate::files::vtk::DataArray;
use crate::image::Image;
use crate::image::formats::{AnyImage, InputOptions, ReadImage};
use crate::model::flow::{Rock, Tensor};
use crate::names::NameRules;
use crate::option_text::{InvalidValue, names_image, parse_number};
use crate::option_text::{deserialize_optional, serde_as_text};
use crate::progress::{NoProgress, Progress};
use crate::units::values::ValueMeasure;
use crate::{Error, Result};

/// Options for the rock in the cells.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct RockOptions {
    /// Porosity: a number, a CSV file of lines region,porosity, a cell array of the mesh, or an
    /// image with an optional mean: FILE[:arithmetic|harmonic|geometric|nearest] [default mean:
    /// arithmetic]
    #[arg(long, value_name = "PHI", allow_hyphen_values = true)]
    pub porosity: Option<CellValue>,
    /// Permeability: K, or KX,KY,KZ along the mesh's coordinates, each a number or an image with an
    /// optional mean [default: geometric]; or a CSV file of lines region,K or region,KX,KY,KZ
    #[arg(long, value_name = "K", allow_hyphen_values = true)]
    pub permeability: Option<CellPermeability>,
    /// Unit of the permeability: mD or m2
    #[arg(long, value_name = "UNIT")]
    pub permeability_unit: Option<PermeabilityUnit>,
    /// Net-to-gross ratio, given like a porosity: the part of a cell's height that is reservoir rock.
    /// It reduces pore volumes and the permeability along x and y
    #[arg(long, value_name = "RATIO")]
    pub net_to_gross: Option<CellValue>,
    /// A lower limit below which cells are inactive: of porosity, permeability (the largest along an
    /// axis, in its unit), net-to-gross, or a --property; may be repeated
    #[arg(long, value_name = "NAME=LIMIT", allow_hyphen_values = true)]
    pub cutoff: Vec<CutOff>,
    /// Numbers of the cells' tables of relative permeability and capillary pressure: a CSV file of
    /// lines region,number, a cell array of the mesh, an image, or a number
    #[arg(long, value_name = "NUMBERS")]
    pub satnum: Option<CellValue>,
    /// Numbers of the cells' tables of fluid volumes, given like --satnum
    #[arg(long, value_name = "NUMBERS")]
    pub pvtnum: Option<CellValue>,
    /// Numbers of the cells' equilibration regions, which have contacts of their own, given like
    /// --satnum
    #[arg(long, value_name = "NUMBERS")]
    pub eqlnum: Option<CellValue>,
    /// Numbers of the regions for which fluids in place are reported, given like --satnum [default:
    /// the regions]
    #[arg(long, value_name = "NUMBERS")]
    pub fipnum: Option<CellValue>,
    /// Another property of the cells, such as a seismic attribute, given like a porosity; may be
    /// repeated
    #[arg(long, value_name = "NAME=VALUE")]
    pub property: Vec<CellProperty>,
    /// An image of labels that sets the regions of the cells: each cell has the label that fills the
    /// largest part of it, or with `:nearest` at the end that at its centre
    #[arg(long, value_name = "IMAGE")]
    #[serde(deserialize_with = "deserialize_optional")]
    pub region: Option<String>,
    /// Options for reading the images.
    #[command(flatten, next_help_heading = "Reading images")]
    pub input: InputOptions,
}

/// A value for each cell.
#[derive(Debug, Clone, PartialEq)]
pub enum CellValue {
    /// One number for all cells.
    Number(f64),
    /// A CSV file of lines region,value; a cell array of the mesh; or an image, perhaps with a colon
    /// and the name of a [`MeanKind`].
    Named(String),
}

impl FromStr for CellValue {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        let number = text.parse();
        Ok(number.map_or_else(|_| Self::Named(text.into()), Self::Number))
    }
}

impl Display for CellValue {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Named(name) => f.write_str(name),
        }
    }
}

/// The permeability of the cells: one value, values along x, y and z, or the six components of a
/// tensor.
#[derive(Debug, Clone, PartialEq)]
pub struct CellPermeability(pub Vec<CellValue>);

impl FromStr for CellPermeability {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        if is_table(text) {
            return Ok(Self(vec![CellValue::Named(text.into())]));
        }
        let values = text.split(',').map(|word| word.trim().parse());
        Ok(Self(values.collect::<std::result::Result<_, _>>()?))
    }
}

impl Display for CellPermeability {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let texts: Vec<String> = self.0.iter().map(CellValue::to_string).collect();
        f.write_str(&texts.join(","))
    }
}

/// A lower limit of a property, below which cells are inactive.
#[derive(Debug, Clone, PartialEq)]
pub struct CutOff {
    /// `porosity`, `permeability`, `net-to-gross`, or the name of another property.
    pub name: String,
    /// The limit.
    pub limit: f64,
}

impl FromStr for CutOff {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give NAME=LIMIT, such as porosity=0.05";
        let (name, limit) = text
            .split_once('=')
            .ok_or_else(|| InvalidValue::new("has no '='", remedy))?;
        Ok(Self {
            name: name.into(),
            limit: parse_number(limit, remedy)?,
        })
    }
}

impl Display for CutOff {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.limit)
    }
}

/// A unit of permeability.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PermeabilityUnit {
    /// Millidarcy.
    Millidarcy,
    /// Square metre.
    SquareMetre,
}

impl FromStr for PermeabilityUnit {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        match text {
            "mD" => Ok(Self::Millidarcy),
            "m2" => Ok(Self::SquareMetre),
            _ => Err(InvalidValue::new("is not a known unit", "give mD or m2")),
        }
    }
}

impl Display for PermeabilityUnit {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Millidarcy => "mD",
            Self::SquareMetre => "m2",
        })
    }
}

/// A property of the cells, with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct CellProperty {
    /// The name, on one line and without `=`.
    pub name: String,
    /// The value for each cell.
    pub value: CellValue,
}

impl FromStr for CellProperty {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| InvalidValue::new("has no '='", PROPERTY_REMEDY))?;
        if name.trim().is_empty() || !NameRules::TEXT.is_legal(name) {
            return Err(InvalidValue::new(PROPERTY_NAME_PROBLEM, PROPERTY_REMEDY));
        }
        let Ok(value) = value.parse();
        Ok(Self {
            name: name.into(),
            value,
        })
    }
}

impl Display for CellProperty {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.value)
    }
}

const PROPERTY_REMEDY: &str = "give NAME=VALUE, such as amplitude=survey.sgy";
const PROPERTY_NAME_PROBLEM: &str = "has a name that is empty, taken, or not on one line";

serde_as_text!(
    CellValue: [","; 2],
    CellPermeability: [","; 2],
    PermeabilityUnit: [","; 2],
    CellProperty: ["="; 2],
    CutOff: ["="; 2],
);

/// Returns an error about an option.
fn option_error(option: &str, value: impl Display, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{option} {value}"), problem, remedy))
}

impl RockOptions {
    /// Sets the properties of the cells: regions first, as the others may depend on them. Returns
    /// the permeability, if it is given, and the cells in which an image holds no data.
    ///
    /// # Errors
    /// Returns [`Error::Export`] or [`Error::Job`] for values that make no sense, a region without
    /// a value, or a permeability without a unit, and [`Error::Io`] for files that cannot be read.
    pub(crate) fn fill(
        &self,
        prepared: &mut PreparedModel,
        read_image: ReadImage<'_>,
        progress: &mut dyn Progress,
    ) -> Result<FilledRock> {
        self.input.refuse_label_table()?;
        let mut filling = Filling {
            input: &self.input,
            read_image,
            progress,
            without_data: Vec::new(),
            permeability_unit: 1.0,
        };
        if let Some(text) = &self.region {
            let labels = filling.regions(text, prepared)?;
            prepared.model.graph.region.clone_from(&labels);
            prepared.model.mesh.region = labels;
            // The new regions are not those of the labels from which the mesh was made.
            prepared.model.labels.clear();
            prepared.model.named_regions.clear();
        }
        let mean = MeanKind::Arithmetic;
        if let Some(value) = &self.porosity {
            let values = filling.values("porosity", value, mean, prepared)?;
            prepared.model.porosity = Some(values);
        }
        if let Some(value) = &self.net_to_gross {
            let values = filling.values("net-to-gross", value, mean, prepared)?;
            if let Some(cell) = values.iter().position(|v| !(0.0..=1.0).contains(v)) {
                let problem = format!("is {} in cell {cell}", values[cell]);
                let remedy = "give ratios from 0 to 1";
                return Err(option_error("net-to-gross", value, &problem, remedy));
            }
            prepared.model.net_to_gross = Some(values);
        }
        prepared.model.deck_regions = DeckRegions {
            saturation: filling.numbers("satnum", self.satnum.as_ref(), prepared)?,
            pressure_volume: filling.numbers("pvtnum", self.pvtnum.as_ref(), prepared)?,
            equilibration: filling.numbers("eqlnum", self.eqlnum.as_ref(), prepared)?,
            fluid_in_place: filling.numbers("fipnum", self.fipnum.as_ref(), prepared)?,
        };
        for property in &self.property {
            let CellProperty { name, value } = property;
            let arrays = &prepared.model.properties;
            if arrays.iter().any(|a| a.name == *name) {
                let problem = PROPERTY_NAME_PROBLEM;
                return Err(option_error("property", property, problem, PROPERTY_REMEDY));
            }
            let values = filling.values("property", value, mean, prepared)?;
            let array = DataArray::scalars(name.as_str(), values);
            prepared.model.properties.push(array);
        }
        let rock = match &self.permeability {
            None => None,
            Some(permeability) => {
                let unit = self.unit(permeability)?;
                Some(filling.rock(permeability, unit, prepared)?)
            }
        };
        Ok(FilledRock {
            rock,
            without_data: filling.without_data,
        })
    }

    /// Returns which cells are below a cut-off. `rock` is the permeability in m^2.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a cut-off of a property that is not given.
    pub(crate) fn cut_off(&self, model: &Model, rock: Option<&Rock>) -> Result<Vec<bool>> {
        let mut is_cut_off = Vec::new();
        for cutoff in &self.cutoff {
            let property = || {
                let mut arrays = model.properties.iter();
                let array = arrays.find(|array| array.name == cutoff.name)?;
                Some(array.values.to_f64())
            };
            let permeability = || {
                let unit = self.unit(self.permeability.as_ref()?).ok()?;
                let largest = |cell: usize| {
                    let [x, y, z, ..] = rock?.mobility(cell).0;
                    Some(x.max(y).max(z) / unit)
                };
                (0..model.len()).map(largest).collect()
            };
            let values = match cutoff.name.as_str() {
                "porosity" => model.porosity.clone(),
                "net-to-gross" => model.net_to_gross.clone(),
                "permeability" => permeability(),
                _ => property(),
            };
            let Some(values) = values else {
                let problem = "is a limit of a property that is not given";
                let remedy = "give that property, or omit the limit";
                return Err(option_error("cutoff", cutoff, problem, remedy));
            };
            is_cut_off.resize(values.len(), false);
            for (is_cut_off, value) in is_cut_off.iter_mut().zip(values) {
                // The unit of permeability rounds the value, which may be the limit itself.
                *is_cut_off |= value < cutoff.limit * (1.0 - 1e-12);
            }
        }
        Ok(is_cut_off)
    }

    /// Returns a value for each cell: the arithmetic mean of an image, or what else `value` gives.
    /// `option` names it in errors.
    ///
    /// # Errors
    /// Returns the errors of [`fill`](Self::fill).
    pub(crate) fn cell_values(
        &self,
        option: &str,
        value: &CellValue,
        prepared: &PreparedModel,
        read_image: ReadImage<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Vec<f64>> {
        let input = &self.input;
        let mut filling = Filling {
            input,
            read_image,
            progress,
            without_data: Vec::new(),
            permeability_unit: 1.0,
        };
        filling.values(option, value, MeanKind::Arithmetic, prepared)
    }

    /// Returns the image that gives a value, to be looked up between the sites of cells; `None` if no image
    /// does.
    ///
    /// # Errors
    /// Returns the errors of [`fill`](Self::fill).
    pub(crate) fn probe(
        &self,
        value: &CellValue,
        prepared: &PreparedModel,
        read_image: ReadImage<'_>,
    ) -> Result<Option<ImageProbe>> {
        let CellValue::Named(text) = value else {
            return Ok(None);
        };
        let mut arrays = prepared.cell_data.iter();
        if is_table(text) || arrays.any(|a| a.name == *text && a.components == 1) {
            return Ok(None);
        }
        let mut filling = Filling {
            input: &self.input,
            read_image,
            // The notes on the image are those of the values of cells.
            progress: &mut NoProgress,
            without_data: Vec::new(),
            permeability_unit: 1.0,
        };
        let (path, _) = image_path(text);
        let image = filling.read_image(path)?;
        prepared.probe(image, &path.display().to_string()).map(Some)
    }

    /// Returns the unit of permeability in m^2.
    fn unit(&self, permeability: &CellPermeability) -> Result<f64> {
        match self.permeability_unit {
            Some(PermeabilityUnit::Millidarcy) => Ok(MILLIDARCY),
            Some(PermeabilityUnit::SquareMetre) => Ok(1.0),
            None => {
                let place = format!("permeability {permeability}");
                let cause = cause(place, "has no unit", "give its unit, mD or m2");
                Err(Error::Job(cause.with_parameter("permeability-unit")))
            }
        }
    }
}

/// The rock of a model that was filled.
pub(crate) struct FilledRock {
    /// The permeability in m^2, if it is given.
    pub rock: Option<Rock>,
    /// `true` for each cell in which an image of a property holds no data; empty if there is none.
    pub without_data: Vec<bool>,
}

/// Sets the properties of cells from options.
struct Filling<'a> {
    input: &'a InputOptions,
    read_image: ReadImage<'a>,
    progress: &'a mut dyn Progress,
    /// `true` for each cell in which an image holds no data; empty if there is none.
    without_data: Vec<bool>,
    /// Square metres in the unit of permeability.
    permeability_unit: f64,
}

impl Filling<'_> {
    fn rock(
        &mut self,
        permeability: &CellPermeability,
        unit: f64,
        prepared: &PreparedModel,
    ) -> Result<Rock> {
        self.permeability_unit = unit;
        let frame = &prepared.frame;
        let tensor = |numbers: &[f64]| {
            // Zero permeability marks inactive cells.
            if !numbers.is_empty() && numbers.iter().all(|k| *k == 0.0) {
                return Some(Tensor::default());
            }
            let tensor = Tensor::from_numbers(numbers)?;
            Some(frame.transform_tensor(tensor.scaled(unit)))
        };
        let refuse = |problem: &str| {
            let remedy = "give K or KX,KY,KZ, positive, or 0 for inactive cells";
            option_error("permeability", permeability, problem, remedy)
        };
        let values = &permeability.0;
        if let [CellValue::Named(text)] = values.as_slice()
            && is_table(text)
        {
            let lines = "write region,K or region,KX,KY,KZ, positive, or 0 for inactive cells";
            let measure = Some((ValueMeasure::Permeability, unit));
            let by_region = quantities_by_region(Path::new(text), measure, tensor, lines)?;
            return Rock::by_region(&prepared.model.graph.region, &by_region, 1.0);
        }
        let number = |value: &CellValue| match value {
            CellValue::Number(number) => Some(*number),
            CellValue::Named(_) => None,
        };
        if let Some(numbers) = values.iter().map(number).collect::<Option<Vec<f64>>>() {
            let tensor = tensor(&numbers).ok_or_else(|| refuse("is not a permeability"))?;
            return Ok(Rock::uniform(tensor, 1.0));
        }
        if !matches!(values.len(), 1 | 3) {
            return Err(refuse(&format!("has {} parts, not 1 or 3", values.len())));
        }
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for (k, value) in values.iter().enumerate() {
            // An image that is given for two directions is averaged only once.
            columns.push(match values[..k].iter().position(|known| known == value) {
                Some(known) => columns[known].clone(),
                None => self.values("permeability", value, MeanKind::Geometric, prepared)?,
            });
        }
        let cell_tensor = |cell: usize| {
            let numbers: Vec<f64> = columns.iter().map(|column| column[cell]).collect();
            tensor(&numbers).ok_or_else(|| {
                refuse(&format!(
                    "is {numbers:?} in cell {cell}, which is not a permeability"
                ))
            })
        };
        let cells = prepared.model.len();
        Ok(Rock {
            mobilities: (0..cells).map(cell_tensor).collect::<Result<_>>()?,
            cell_mobility: (0..cells as u32).collect(),
        })
    }

    /// Returns a whole number from 1 for each cell, if the option is given.
    fn numbers(
        &mut self,
        option: &str,
        value: Option<&CellValue>,
        prepared: &PreparedModel,
    ) -> Result<Option<Vec<u32>>> {
        let Some(value) = value else { return Ok(None) };
        let values = self.values(option, value, MeanKind::Nearest, prepared)?;
        let is_number = |v: &f64| v.fract() == 0.0 && (1.0..=9999.0).contains(v);
        if let Some(cell) = values.iter().position(|v| !is_number(v)) {
            let problem = format!("is {} in cell {cell}", values[cell]);
            let remedy = "give whole numbers from 1 to 9999";
            return Err(option_error(option, value, &problem, remedy));
        }
        Ok(Some(values.iter().map(|v| *v as u32).collect()))
    }

    /// Returns a value for each cell.
    fn values(
        &mut self,
        option: &str,
        value: &CellValue,
        mean: MeanKind,
        prepared: &PreparedModel,
    ) -> Result<Vec<f64>> {
        let cells = prepared.model.len();
        let text = match value {
            CellValue::Number(number) if number.is_finite() => return Ok(vec![*number; cells]),
            CellValue::Number(_) => {
                let remedy = "give a finite number";
                return Err(option_error(option, value, "is not finite", remedy));
            }
            CellValue::Named(text) => text,
        };
        if is_table(text) {
            let single = |numbers: &[f64]| match numbers {
                [value] if value.is_finite() => Some(*value),
                _ => None,
            };
            let measure = match option {
                "porosity" | "net-to-gross" | "clay" => Some((ValueMeasure::Fraction, 1.0)),
                "permeability" => Some((ValueMeasure::Permeability, self.permeability_unit)),
                _ => None,
            };
            let path = Path::new(text);
            let table = quantities_by_region(path, measure, single, "write region,value")?;
            let value = |region: &i32| {
                let row = table.iter().find(|(known, _)| known == region);
                row.map(|f| f.1).ok_or_else(|| {
                    let place = format!("{option} {text}");
                    let problem = format!("has no value for region {region}");
                    let remedy = "give one for every region of the mesh";
                    Error::Export(cause(place, problem, remedy))
                })
            };
            return prepared.model.graph.region.iter().map(value).collect();
        }
        let arrays = &prepared.cell_data;
        if let Some(array) = arrays.iter().find(|a| a.name == *text && a.components == 1) {
            return Ok(array.values.to_f64());
        }
        self.image_values(option, text, mean, prepared)
    }

    /// Returns the region of each cell: the label of an image that fills the largest part of it, or,
    /// for `IMAGE:nearest`, the label at its site.
    fn regions(&mut self, text: &str, prepared: &PreparedModel) -> Result<Vec<i32>> {
        let part = text.rsplit_once(':');
        let part = part.filter(|(_, name)| MeanKind::from_name(name).is_none());
        let is_file = |text: &str| Path::new(text).exists();
        if !is_file(text) && !part.is_some_and(|(file, _)| is_file(file)) {
            let labels = self.image_values("region", text, MeanKind::Nearest, prepared)?;
            return Ok(labels.iter().map(|&label| label.round() as i32).collect());
        }
        let image = self.read_image(Path::new(text))?;
        let shares = prepared.region_shares(&image, text)?;
        self.progress.note(&shares.note(text));
        Ok(shares.region)
    }

    fn image_values(
        &mut self,
        option: &str,
        text: &str,
        mean: MeanKind,
        prepared: &PreparedModel,
    ) -> Result<Vec<f64>> {
        let (path, named_mean) = image_path(text);
        let mean = named_mean.unwrap_or(mean);
        if !path.exists() && !names_image(path) {
            let scalars = prepared.cell_data.iter().filter(|a| a.components == 1);
            let names: Vec<&str> = scalars.map(|array| array.name.as_str()).collect();
            return Err(option_error(
                option,
                text,
                &format!(
                    "is neither a number nor a file nor a cell array of the mesh (it has {})",
                    names.join(", ")
                ),
                "give a number, a CSV file of lines region,value, or an image",
            ));
        }
        let image = self.read_image(path)?;
        let means = prepared.average(&image, mean, &path.display().to_string())?;
        self.add_cells_without_data(option, path, &means.without_data);
        Ok(means.values)
    }

    /// Adds the cells in which an image holds no data, with a note.
    fn add_cells_without_data(&mut self, option: &str, path: &Path, without_data: &[bool]) {
        let count = without_data.iter().filter(|flag| **flag).count();
        if count == 0 {
            return;
        }
        self.progress.note(&format!(
            "--{option}: {} holds no data in {count} of {} cells, which are inactive and have the value of the nearest sample",
            path.display(),
            without_data.len()
        ));
        self.without_data.resize(without_data.len(), false);
        let flags = self.without_data.iter_mut().zip(without_data);
        flags.for_each(|(flag, added)| *flag |= added);
    }

    /// Reads an image and marks the samples that hold no data; a 2-D image becomes a 3-D image of one
    /// layer.
    fn read_image(&mut self, path: &Path) -> Result<Image<3>> {
        let (image, notes) = match (self.read_image)(path, self.input)? {
            AnyImage::Plane(loaded) => (loaded.image.to_3d(), loaded.notes),
            AnyImage::Space(loaded) => (loaded.image, loaded.notes),
        };
        notes.iter().for_each(|note| self.progress.note(note));
        let marked = image.mark_nulls(!self.input.keeps_nulls());
        let marked = marked.map_err(|error| error.with_place(path.display()))?;
        let Some(marked) = marked else {
            return Ok(image);
        };
        for note in &marked.notes {
            self.progress.note(&format!("{}: {note}", path.display()));
        }
        Ok(marked.image)
    }
}

/// Returns the path in the text `PATH[:MEAN]`, and the mean.
fn image_path(text: &str) -> (&Path, Option<MeanKind>) {
    let suffix = text.rsplit_once(':');
    match suffix.and_then(|(path, name)| Some((path, MeanKind::from_name(name)?))) {
        Some((path, mean)) => (Path::new(path), Some(mean)),
        None => (Path::new(text), None),
    }
}

/// Returns `true` if a value names a table by region.
fn is_table(text: &str) -> bool {
    Path::new(text)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}
