//! Options for rock properties: numbers, tables by region, arrays of the mesh, or images that are
//! averaged over cells.

use std::path::Path;

use clap::Args;

use super::console::Console;
use super::parse::option_error;
use crate::error::cause;
use crate::files::csv::values_by_region;
use crate::files::vtk::DataArray;
use crate::image::Image;
use crate::image::formats::AnyImage;
use crate::image::formats::InputOptions;
use crate::model::flow::{Rock, Tensor};
use crate::model::reservoir::PreparedModel;
use crate::model::reservoir::{MILLIDARCY, MeanKind};
use crate::{Error, Result};

/// Options for the rock in the cells.
#[derive(Debug, Clone, Args)]
pub struct RockOptions {
    /// Porosity: a number, a CSV file of lines region,porosity, a cell array of the mesh, or an
    /// image with an optional mean: FILE[:arithmetic|harmonic|geometric|nearest] [default mean:
    /// arithmetic]
    #[arg(long, value_name = "PHI", allow_hyphen_values = true)]
    pub porosity: Option<String>,
    /// Permeability: K, or KX,KY,KZ along the mesh's coordinates, each a number or an image with an
    /// optional mean [default: geometric]; or a CSV file of lines region,K or region,KX,KY,KZ
    #[arg(long, value_name = "K", allow_hyphen_values = true)]
    pub permeability: Option<String>,
    /// Unit of the permeability: mD or m2
    #[arg(long, value_name = "UNIT")]
    pub permeability_unit: Option<String>,
    /// Another property of the cells, such as a seismic attribute, given like a porosity; may be
    /// repeated
    #[arg(long, value_name = "NAME=VALUE")]
    pub property: Vec<String>,
    /// An image of labels that sets the regions of the cells
    #[arg(long, value_name = "IMAGE")]
    pub region: Option<String>,
    /// Options for reading the images.
    #[command(flatten, next_help_heading = "Reading images")]
    pub input: InputOptions,
}

impl RockOptions {
    /// Sets the properties of the cells: regions first, as the others may depend on them. Returns
    /// the permeability, if it is given.
    ///
    /// # Errors
    /// Returns [`Error::Export`] or [`Error::Job`] for values that make no sense, a region without
    /// a value, or a permeability without a unit, and [`Error::Io`] for files that cannot be read.
    pub fn fill(&self, prepared: &mut PreparedModel, console: &Console) -> Result<Option<Rock>> {
        if let Some(text) = &self.region {
            let labels =
                self.image_values("--region", text, MeanKind::Nearest, prepared, console)?;
            let labels: Vec<i32> = labels.iter().map(|&l| l.round() as i32).collect();
            prepared.model.graph.region.clone_from(&labels);
            prepared.model.mesh.region = labels;
            // The new regions are not those of the labels from which the mesh was made.
            prepared.model.labels.clear();
        }
        if let Some(text) = &self.porosity {
            let values =
                self.values("--porosity", text, MeanKind::Arithmetic, prepared, console)?;
            prepared.model.porosity = Some(values);
        }
        for text in &self.property {
            let remedy = "give NAME=VALUE, such as amplitude=survey.sgy";
            let Some((name, value)) = text.split_once('=') else {
                return Err(option_error("--property", text, "has no '='", remedy));
            };
            let letters = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            let arrays = &prepared.model.properties;
            if name.is_empty() || !letters || arrays.iter().any(|a| a.name == name) {
                let problem = "has a name that is empty, taken, or not of letters, digits and _";
                return Err(option_error("--property", text, problem, remedy));
            }
            let values =
                self.values("--property", value, MeanKind::Arithmetic, prepared, console)?;
            let array = DataArray::scalars(name, values);
            prepared.model.properties.push(array);
        }
        match &self.permeability {
            None => Ok(None),
            Some(text) => self.rock(text, prepared, console).map(Some),
        }
    }

    /// Returns the unit of permeability in m^2.
    fn unit(&self, text: &str) -> Result<f64> {
        let remedy = "give --permeability-unit mD or m2";
        match self.permeability_unit.as_deref() {
            Some("mD") => Ok(MILLIDARCY),
            Some("m2") => Ok(1.0),
            Some(other) => Err(option_error(
                "--permeability-unit",
                other,
                "is not a known unit",
                remedy,
            )),
            None => Err(option_error("--permeability", text, "has no unit", remedy)),
        }
    }

    fn rock(&self, text: &str, prepared: &PreparedModel, console: &Console) -> Result<Rock> {
        let unit = self.unit(text)?;
        let frame = &prepared.frame;
        let tensor = |numbers: &[f64]| {
            // Zero permeability marks inactive cells.
            if !numbers.is_empty() && numbers.iter().all(|k| *k == 0.0) {
                return Some(Tensor::default());
            }
            let tensor = Tensor::from_numbers(numbers)?;
            Some(frame.transform_tensor(tensor.scaled(unit)))
        };
        let remedy = "give K or KX,KY,KZ, positive, or 0 for inactive cells";
        if is_table(text) {
            let lines = "write region,K or region,KX,KY,KZ, positive, or 0 for inactive cells";
            let by_region = values_by_region(Path::new(text), tensor, lines)?;
            return Rock::by_region(&prepared.model.graph.region, &by_region, 1.0);
        }
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let numbers: Option<Vec<f64>> = parts.iter().map(|part| part.parse().ok()).collect();
        if let Some(numbers) = numbers {
            let tensor = tensor(&numbers).ok_or_else(|| {
                option_error("--permeability", text, "is not a permeability", remedy)
            })?;
            return Ok(Rock::uniform(tensor, 1.0));
        }
        if !matches!(parts.len(), 1 | 3) {
            let problem = format!("has {} parts, not 1 or 3", parts.len());
            return Err(option_error("--permeability", text, &problem, remedy));
        }
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for (k, part) in parts.iter().enumerate() {
            // An image that is given for two directions is averaged only once.
            columns.push(match parts[..k].iter().position(|known| known == part) {
                Some(known) => columns[known].clone(),
                None => self.values(
                    "--permeability",
                    part,
                    MeanKind::Geometric,
                    prepared,
                    console,
                )?,
            });
        }
        let cell_tensor = |cell: usize| {
            let numbers: Vec<f64> = columns.iter().map(|column| column[cell]).collect();
            tensor(&numbers).ok_or_else(|| {
                let problem = format!("is {numbers:?} in cell {cell}, which is not a permeability");
                option_error("--permeability", text, &problem, remedy)
            })
        };
        let cells = prepared.model.len();
        Ok(Rock {
            mobilities: (0..cells).map(cell_tensor).collect::<Result<_>>()?,
            cell_mobility: (0..cells as u32).collect(),
        })
    }

    /// Returns a value for each cell.
    fn values(
        &self,
        option: &str,
        text: &str,
        mean: MeanKind,
        prepared: &PreparedModel,
        console: &Console,
    ) -> Result<Vec<f64>> {
        let cells = prepared.model.len();
        if let Ok(number) = text.parse::<f64>() {
            if !number.is_finite() {
                return Err(option_error(
                    option,
                    text,
                    "is not finite",
                    "give a finite number",
                ));
            }
            return Ok(vec![number; cells]);
        }
        if is_table(text) {
            let single = |numbers: &[f64]| match numbers {
                [value] if value.is_finite() => Some(*value),
                _ => None,
            };
            let table = values_by_region(Path::new(text), single, "write region,value")?;
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
        if let Some(array) = arrays.iter().find(|a| a.name == text && a.components == 1) {
            return Ok(array.values.to_f64());
        }
        self.image_values(option, text, mean, prepared, console)
    }

    fn image_values(
        &self,
        option: &str,
        text: &str,
        mean: MeanKind,
        prepared: &PreparedModel,
        console: &Console,
    ) -> Result<Vec<f64>> {
        let suffix = text.rsplit_once(':');
        let (path, mean) =
            match suffix.and_then(|(path, name)| Some((path, MeanKind::from_name(name)?))) {
                Some((path, mean)) => (path, mean),
                None => (text, mean),
            };
        let path = Path::new(path);
        if !console.image_exists(path) {
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
        let image = read_image(path, &self.input, console)?;
        prepared.average(&image, mean, &path.display().to_string())
    }
}

/// Returns `true` if a value names a table by region.
fn is_table(text: &str) -> bool {
    Path::new(text)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}

/// Reads an image; a 2-D image becomes a 3-D image of one layer.
fn read_image(path: &Path, input: &InputOptions, console: &Console) -> Result<Image<3>> {
    let (image, notes) = match console.read_image(path, input)? {
        AnyImage::Plane(loaded) => (loaded.image.to_3d(), loaded.notes),
        AnyImage::Space(loaded) => (loaded.image, loaded.notes),
    };
    notes.iter().for_each(|note| console.note(note));
    Ok(image)
}
