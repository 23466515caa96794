//! Runs the verbs on files, and on meshes and images in memory in place of files.
//!
//! A verb checks its options and the names of its files, reads its inputs, calls the function of the
//! library, and writes the results. The command line and the Python package call it.
//!
//! - `verbs`: the verbs
//! - `job`: the verb `mesh`
//! - `check`: which files a job reads and writes, and whether it may
//! - `trace`: the lattices of a job as files
//! - `image_cache`: images that stay in memory after they were read from files
//! - `others`: the files beside the mesh of a job: report, page, surfaces, lines, potential

mod check;
mod image_cache;
mod job;
mod others;
mod trace;
mod verbs;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;

use crate::Result;
use crate::edit::EditCache;
use crate::export::convert::open_with_options;
use crate::files::output::path_text;
use crate::image::formats::{AnyImage, InputOptions, OpenedImage, file_hash, read_with_options};
use crate::mesh_file::AnyMesh;
use crate::model::paint::PaintCache;
use crate::progress::Progress;
use crate::store::read_any_mesh_with_notes;
use crate::surface_file::AnySurfaces;
pub use image_cache::ImageCache;
#[cfg(feature = "cli")]
pub(crate) use {check::check_files, check::output_path, job::run_distributed};

/// Meshes and images in memory by name, such as `<volume>`. All other names are those of files.
#[derive(Debug, Default)]
pub struct Objects {
    /// The meshes.
    pub meshes: HashMap<PathBuf, Arc<AnyMesh>>,
    /// The images.
    pub images: HashMap<PathBuf, Arc<AnyImage>>,
    /// `true` if the main result of a verb is kept in memory if its name begins with `<`.
    pub keeps_results: bool,
    /// Data of files that stay in memory between verbs, if they do.
    pub resident: Option<ResidentData>,
}

impl Objects {
    /// Returns the part that the options give of an image in memory; `None` for a file.
    fn image(&self, name: &Path, input: &InputOptions) -> Result<Option<AnyImage>> {
        let image = self.images.get(name);
        let part = image.map(|image| input.part_in_memory((**image).clone(), name));
        part.transpose()
    }

    fn read_image(&self, name: &Path, input: &InputOptions) -> Result<AnyImage> {
        match (self.image(name, input)?, &self.resident) {
            (Some(image), _) => Ok(image),
            (None, Some(resident)) => resident.images.read(name, input),
            (None, None) => read_with_options(name, input),
        }
    }

    /// Opens an image, whose samples may stay in its file.
    fn open_image(&self, name: &Path, input: &InputOptions) -> Result<OpenedImage> {
        match self.image(name, input)? {
            Some(image) => Ok(OpenedImage::InMemory(image)),
            None => open_with_options(name, input),
        }
    }

    /// Reads a mesh, and passes on notes on what is in its file.
    fn read_mesh(&self, name: &Path, progress: &mut dyn Progress) -> Result<AnyMesh> {
        if let Some(mesh) = self.meshes.get(name) {
            return Ok((**mesh).clone());
        }
        let (mesh, notes) = read_any_mesh_with_notes(name)?;
        notes.iter().for_each(|note| progress.note(note));
        Ok(mesh)
    }

    /// Returns the hash of an object in memory; that of a mesh is empty.
    fn known_hash(&self, name: &Path) -> Option<String> {
        let hash = self.images.get(name).map(|image| image.hash());
        hash.or_else(|| self.meshes.get(name).map(|_| String::new()))
    }

    fn hash(&self, name: &Path) -> Result<String> {
        match (self.known_hash(name), &self.resident) {
            (Some(hash), _) => Ok(hash),
            (None, Some(resident)) => resident.images.hash(name),
            (None, None) => file_hash(name),
        }
    }

    fn keeps(&self, name: &Path) -> bool {
        self.keeps_results && name.as_os_str().as_encoded_bytes().starts_with(b"<")
    }
}

/// Data of files that stay in memory between verbs. A file that changes meanwhile is not read again.
#[derive(Debug, Default)]
pub struct ResidentData {
    /// Images as they were read.
    pub images: ImageCache,
    /// The image of the last edit as it was prepared, with its features.
    pub edits: EditCache,
    /// The cells of the mesh that was painted last.
    pub paints: PaintCache,
}

/// The main result of a verb, which is written to a file or kept in memory.
#[derive(Debug)]
pub enum Output {
    /// A mesh.
    Mesh(AnyMesh),
    /// An image.
    Image(Box<AnyImage>),
    /// Surfaces or curves.
    Surfaces(AnySurfaces),
}

/// The report and the result of a verb.
#[derive(Debug, Default)]
pub struct Answer {
    /// The report as text.
    pub text: String,
    /// The report.
    pub json: Value,
    /// A line for each file that is written: its name, and what it holds.
    pub files: Vec<String>,
    /// The result, if it is kept in memory, and its name.
    pub kept: Option<(String, Output)>,
    /// `true` if the job was stopped, so that the mesh is that of the lattice so far.
    pub is_interrupted: bool,
}

impl Answer {
    fn new(text: impl Into<String>, json: Value) -> Self {
        Self {
            text: text.into(),
            json,
            ..Self::default()
        }
    }

    /// Adds a line about the file `path`, which holds `content`.
    fn with_file(mut self, path: &Path, content: &str) -> Self {
        let colon = if content.is_empty() { "" } else { ": " };
        self.files
            .push(format!("{}{colon}{content}", path.display()));
        self
    }

    /// Keeps the result in memory, or writes it, by its name.
    fn with_result(mut self, objects: &Objects, path: &Path, result: Output) -> Result<Self> {
        if objects.keeps(path) {
            self.kept = Some((path_text(path), result));
            return Ok(self);
        }
        match result {
            Output::Mesh(mesh) => mesh.write(path)?,
            Output::Image(image) => image.write(path)?,
            Output::Surfaces(surfaces) => surfaces.write(path)?,
        }
        Ok(self)
    }
}

/// Runs verbs. Names of files may be those of `objects`.
pub struct Session<'a> {
    /// The meshes and images in memory.
    pub objects: &'a Objects,
    /// Follows the verb, and may stop it.
    pub progress: &'a mut dyn Progress,
}
