//! Reads NetCDF files, as far as Exodus files need them: the classic formats and NetCDF-4, by the crate
//! `netcdf-reader`.

use std::path::Path;

use netcdf_reader::{NcFile, NcVariable};

use super::{FileProblem, ReadResult};
use crate::image::formats::hdf5::source::storage;
use crate::memory;

/// Remedy for files that are not read.
const REMEDY: &str = "copy the file again, or convert it with nccopy -k 64-bit-offset IN OUT";

/// An open NetCDF file.
pub struct NetcdfReader {
    file: NcFile,
    variables: Vec<NcVariable>,
    dimensions: Vec<(String, usize)>,
}

impl NetcdfReader {
    /// Opens a file.
    pub fn open(path: &Path) -> ReadResult<Self> {
        let storage = storage(path).map_err(|e| FileProblem {
            problem: e.to_string(),
            remedy: REMEDY,
        })?;
        let fault = |e: netcdf_reader::Error| FileProblem {
            problem: format!("is damaged or no NetCDF file: {e}"),
            remedy: REMEDY,
        };
        let file = NcFile::from_storage(storage).map_err(fault)?;
        let variables = file.variables().map_err(fault)?.to_vec();
        let dimensions = file.dimensions().map_err(fault)?.iter();
        let length = |size: u64| usize::try_from(size).unwrap_or(usize::MAX);
        let dimensions = dimensions.map(|d| (d.name.clone(), length(d.size)));
        Ok(Self {
            dimensions: dimensions.collect(),
            variables,
            file,
        })
    }

    /// Returns the number of variables.
    pub fn variable_count(&self) -> usize {
        self.variables.len()
    }

    /// Returns the length of a dimension.
    pub fn dimension(&self, name: &str) -> Option<usize> {
        let mut dimensions = self.dimensions.iter();
        dimensions.find_map(|(known, length)| (known == name).then_some(*length))
    }

    fn variable(&self, name: &str) -> Option<&NcVariable> {
        self.variables
            .iter()
            .find(|variable| variable.name() == name)
    }

    /// Returns the length of a variable along each dimension.
    pub fn shape(&self, name: &str) -> Option<Vec<usize>> {
        let shape = self.variable(name)?.shape().into_iter();
        Some(
            shape
                .map(|n| usize::try_from(n).unwrap_or(usize::MAX))
                .collect(),
        )
    }

    /// Returns a text attribute of a variable.
    pub fn attribute(&self, variable: &str, name: &str) -> Option<String> {
        let attribute = self.variable(variable)?.attribute(name)?;
        Some(text(&attribute.value.as_string()?))
    }

    /// Returns the numbers of a variable; empty if there is no such variable.
    pub fn numbers(&self, name: &str) -> ReadResult<Vec<f64>> {
        if !self.check_size(name)? {
            return Ok(Vec::new());
        }
        let numbers = self.file.read_variable_as_f64(name);
        let numbers = numbers.map_err(|e| unreadable(name, &e))?;
        Ok(numbers.into_raw_vec_and_offset().0)
    }

    /// Returns the texts of a variable, one for each row.
    pub fn texts(&self, name: &str) -> ReadResult<Vec<String>> {
        if !self.check_size(name)? {
            return Ok(Vec::new());
        }
        let texts = self.file.read_variable_as_strings(name);
        let texts = texts.map_err(|e| unreadable(name, &e))?;
        Ok(texts.iter().map(|row| text(row)).collect())
    }

    /// Returns `true` if there is a variable of this name that has values, after checking that they fit
    /// into memory.
    fn check_size(&self, name: &str) -> ReadResult<bool> {
        let Some(shape) = self.shape(name) else {
            return Ok(false);
        };
        let count: f64 = shape.iter().map(|&n| n as f64).product();
        let task = format!("the variable '{name}' of {count} numbers");
        let checked = memory::ensure_available(name, 8.0 * count, task, "give a smaller mesh");
        match checked {
            Ok(()) => Ok(count > 0.0),
            Err(error) => Err(FileProblem {
                problem: format!("is too large, or damaged: {error}"),
                remedy: REMEDY,
            }),
        }
    }
}

fn unreadable(name: &str, error: &netcdf_reader::Error) -> FileProblem {
    FileProblem {
        problem: format!("the variable '{name}' cannot be read: {error}"),
        remedy: REMEDY,
    }
}

/// Returns the text before the first zero byte, trimmed.
fn text(row: &str) -> String {
    row.split('\0')
        .next()
        .unwrap_or_default()
        .trim()
        .to_string()
}
