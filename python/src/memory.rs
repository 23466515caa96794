//! Meshes and images in memory, which verbs read by name as if they were files; results in memory; and
//! the progress of a verb as events.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use atomesh::Result;
use atomesh::export::convert::open_with_options;
use atomesh::image::formats::{AnyImage, InputOptions, OpenedImage, file_hash, read_with_options};
use atomesh::progress::{OptimizeStatus, Progress, SizeEstimate, Stage};
use atomesh::store::{AnyMesh, read_any_mesh_with_notes};
use atomesh::surface_file::AnySurfaces;
use pyo3::prelude::*;
use serde_json::Value;

use crate::objects;

/// Meshes and images in memory by name. All other names are those of files.
#[derive(Default)]
pub struct Memory {
    meshes: HashMap<PathBuf, Arc<AnyMesh>>,
    images: HashMap<PathBuf, Arc<AnyImage>>,
}

impl Memory {
    /// Returns these objects.
    pub fn new(objects: &HashMap<PathBuf, Bound<'_, PyAny>>) -> PyResult<Self> {
        let mut memory = Self::default();
        for (name, object) in objects {
            let name = name.clone();
            if let Ok(mesh) = object.cast::<objects::Mesh>() {
                memory.meshes.insert(name, Arc::clone(&mesh.get().0));
            } else {
                let image = object.cast::<objects::Image>()?;
                memory.images.insert(name, Arc::clone(&image.get().0));
            }
        }
        Ok(memory)
    }

    /// Reads a mesh, and passes on notes on what is in its file.
    pub fn read_mesh(&self, name: &Path, progress: &mut dyn Progress) -> Result<AnyMesh> {
        if let Some(mesh) = self.meshes.get(name) {
            return Ok((**mesh).clone());
        }
        let (mesh, notes) = read_any_mesh_with_notes(name)?;
        notes.iter().for_each(|note| progress.note(note));
        Ok(mesh)
    }

    /// Returns the part that the options give of an image in memory; `None` for a file.
    pub fn image(&self, name: &Path, input: &InputOptions) -> Result<Option<AnyImage>> {
        let image = self.images.get(name);
        let part = image.map(|image| input.part_in_memory((**image).clone(), name));
        part.transpose()
    }

    /// Reads an image.
    pub fn read_image(&self, name: &Path, input: &InputOptions) -> Result<AnyImage> {
        match self.image(name, input)? {
            Some(image) => Ok(image),
            None => read_with_options(name, input),
        }
    }

    /// Opens an image, whose samples may stay in its file.
    pub fn open_image(&self, name: &Path, input: &InputOptions) -> Result<OpenedImage> {
        match self.image(name, input)? {
            Some(image) => Ok(OpenedImage::InMemory(image)),
            None => open_with_options(name, input),
        }
    }

    /// Returns the hash of an image or a mesh; that of a mesh in memory is empty.
    pub fn hash(&self, name: &Path) -> Result<String> {
        match self.images.get(name) {
            Some(image) => Ok(objects::hash(image)),
            None if self.meshes.contains_key(name) => Ok(String::new()),
            None => file_hash(name),
        }
    }
}

/// A result that is written to a file or kept in memory.
pub enum Output {
    Mesh(AnyMesh),
    Image(AnyImage),
    Surfaces(AnySurfaces),
}

/// The messages and the result of a verb.
#[derive(Default)]
pub struct Answer {
    /// The report as a table.
    pub text: String,
    /// The report.
    pub json: Value,
    /// The result that is kept in memory, with its name.
    pub kept: Option<(String, Output)>,
    /// `true` if a mesh is that of a job that was stopped.
    pub is_interrupted: bool,
}

/// Returns `true` if a result of this name, which has the form `<name>`, is kept in memory.
pub fn is_in_memory(name: &Path) -> bool {
    name.as_os_str().as_encoded_bytes().starts_with(b"<")
}

/// An event while a verb runs.
pub enum Event {
    Stage(String),
    Progress(f64, String),
    Note(String),
    /// A line that is shown next to the progress.
    Line(String),
}

/// Sends the progress of a verb as events to a thread that may no longer receive them, and stops the
/// verb when it is asked to.
pub struct EventProgress {
    pub events: Sender<Event>,
    pub is_stopped: Arc<AtomicBool>,
}

impl EventProgress {
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}

impl Progress for EventProgress {
    fn stage(&mut self, stage: Stage) {
        self.send(Event::Stage(stage.to_string()));
    }

    fn note(&mut self, line: &str) {
        self.send(Event::Note(line.to_string()));
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        self.send(Event::Line(estimate.to_string()));
    }

    fn optimize_step(&mut self, status: &OptimizeStatus) {
        self.send(Event::Progress(status.fraction(), status.to_string()));
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.send(Event::Progress(fraction, String::new()));
    }

    fn keep_going(&mut self) -> bool {
        !self.is_stopped.load(Ordering::SeqCst)
    }
}
