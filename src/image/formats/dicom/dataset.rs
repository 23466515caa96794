//! Data sets of DICOM: their values, and those of each frame of a file.

use std::path::{Path, PathBuf};

use dicom_dictionary_std::tags;
use dicom_object::mem::InMemElement;
use dicom_object::{InMemDicomObject, OpenFileOptions, Tag};

use super::super::packed::{DAMAGED_REMEDY, file_error};
use super::lengths::check_lengths;
use crate::error::Result;
use crate::names;

/// A data set, or an item of a sequence.
pub(super) type DataSet = InMemDicomObject;

/// A file of DICOM.
pub(super) struct DicomFile {
    /// Its path.
    pub path: PathBuf,
    /// UID of the transfer syntax, which says how samples are encoded.
    pub syntax: String,
    /// Its elements.
    pub data: DataSet,
}

impl DicomFile {
    /// Reads a file, without its samples unless `with_samples`.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be read or is damaged.
    pub fn read(path: &Path, with_samples: bool) -> Result<Self> {
        check_lengths(path)?;
        let options = OpenFileOptions::new();
        let options = if with_samples {
            options
        } else {
            // The first element of the group of samples.
            options.read_until(tags::EXTENDED_OFFSET_TABLE)
        };
        let object = options.open_file(path).map_err(|e| {
            let problem = format!("is not a complete DICOM file: {}", innermost(&e));
            file_error(path, problem, DAMAGED_REMEDY)
        })?;
        Ok(Self {
            path: path.to_path_buf(),
            syntax: object.meta().transfer_syntax().to_string(),
            data: object.into_inner(),
        })
    }

    /// Returns an error about this file.
    pub fn error(&self, problem: impl std::fmt::Display, remedy: &str) -> crate::Error {
        file_error(&self.path, problem, remedy)
    }

    /// Returns the number of frames.
    pub fn frame_count(&self) -> usize {
        let count = integer(&self.data, tags::NUMBER_OF_FRAMES).unwrap_or(1);
        usize::try_from(count).unwrap_or(0)
    }

    /// Returns where the values of a frame are looked for.
    pub fn frame(&self, number: usize) -> FrameScope<'_> {
        FrameScope {
            file: &self.data,
            shared: items(&self.data, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE).first(),
            own: items(&self.data, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).get(number),
        }
    }
}

/// Returns the text of the innermost cause of an error.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

/// The data sets that may hold a value of one frame: its own functional groups, those that all frames
/// share, and the file's elements.
#[derive(Clone, Copy)]
pub(super) struct FrameScope<'a> {
    file: &'a DataSet,
    shared: Option<&'a DataSet>,
    own: Option<&'a DataSet>,
}

impl<'a> FrameScope<'a> {
    /// Returns the first item of a functional group.
    pub fn group(&self, group: Tag) -> Option<&'a DataSet> {
        let first_item = |set: Option<&'a DataSet>| items(set?, group).first();
        first_item(self.own).or_else(|| first_item(self.shared))
    }

    /// Returns the element `tag` of a functional group, or else of the file.
    fn element(&self, group: Tag, tag: Tag) -> Option<&'a InMemElement> {
        let in_group = self.group(group).and_then(|item| item.get(tag));
        in_group.or_else(|| self.file.get(tag))
    }

    /// Returns numbers of the functional group, or else of the file.
    pub fn numbers(&self, group: Tag, tag: Tag) -> Option<Vec<f64>> {
        element_numbers(self.element(group, tag)?)
    }

    /// Returns the first number of the functional group, or else of the file.
    pub fn number(&self, group: Tag, tag: Tag) -> Option<f64> {
        self.numbers(group, tag)?.first().copied()
    }
}

/// Returns the items of a sequence; none if it is missing.
pub(super) fn items(set: &DataSet, tag: Tag) -> &[DataSet] {
    set.get(tag)
        .and_then(|element| element.items())
        .unwrap_or_default()
}

/// Returns the numbers of an element, unless one is not finite.
fn element_numbers(element: &InMemElement) -> Option<Vec<f64>> {
    let numbers = element.to_multi_float64().ok()?;
    (!numbers.is_empty() && numbers.iter().all(|x| x.is_finite())).then_some(numbers)
}

/// Returns the text of an element without spaces around it, unless it is empty.
fn element_text(element: &InMemElement) -> Option<String> {
    let text = element.to_str().ok()?;
    let text = names::from_file(text.trim_matches(['\0', ' ']));
    (!text.is_empty()).then_some(text)
}

/// Returns the numbers of an element of a data set.
pub(super) fn numbers(set: &DataSet, tag: Tag) -> Option<Vec<f64>> {
    element_numbers(set.get(tag)?)
}

/// Returns the text of an element of a data set.
pub(super) fn text(set: &DataSet, tag: Tag) -> Option<String> {
    element_text(set.get(tag)?)
}

/// Returns the first integer of an element of a data set.
pub(super) fn integer(set: &DataSet, tag: Tag) -> Option<i64> {
    let numbers = set.get(tag)?.to_multi_int::<i64>().ok()?;
    numbers.first().copied()
}

/// Returns `N` numbers; `None` if there are more or fewer.
pub(super) fn array<const N: usize>(numbers: Option<Vec<f64>>) -> Option<[f64; N]> {
    numbers?.try_into().ok()
}
