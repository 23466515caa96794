//! The host of verbs that Python calls: meshes and images are in memory.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use atomesh::cli::host::{Host, MemoryOutput};
use atomesh::image::formats::AnyImage;
use atomesh::store::AnyMesh;
use pyo3::prelude::*;
use serde_json::Value;

use crate::objects;

/// An event while a verb runs.
pub enum Event {
    Stage(String),
    Progress(f64, String),
    Note(String),
}

/// The messages and results of a verb, shared between its host and the caller.
#[derive(Clone, Default)]
pub struct SharedResults(Arc<Mutex<Results>>);

#[derive(Default)]
pub struct Results {
    pub text: String,
    pub json: Value,
    pub notes: Vec<String>,
    pub stored: Vec<(String, MemoryOutput)>,
}

impl SharedResults {
    pub fn lock(&self) -> MutexGuard<'_, Results> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A host that provides meshes and images in memory by name.
pub struct MemoryHost {
    meshes: HashMap<PathBuf, Arc<AnyMesh>>,
    images: HashMap<PathBuf, Arc<AnyImage>>,
    kept_names: Vec<PathBuf>,
    events: Sender<Event>,
    results: SharedResults,
}

impl MemoryHost {
    /// Returns a host with these objects, and the results that it will receive.
    pub fn new(
        objects: &HashMap<PathBuf, Bound<'_, PyAny>>,
        keep: Vec<PathBuf>,
        events: Sender<Event>,
    ) -> PyResult<(Self, SharedResults)> {
        let results = SharedResults::default();
        let mut memory = Self {
            meshes: HashMap::new(),
            images: HashMap::new(),
            kept_names: keep,
            events,
            results: results.clone(),
        };
        for (name, object) in objects {
            match object.cast::<objects::Mesh>() {
                Ok(mesh) => {
                    memory
                        .meshes
                        .insert(name.clone(), Arc::clone(&mesh.get().0));
                }
                Err(_) => {
                    let image = object.cast::<objects::Image>()?;
                    memory
                        .images
                        .insert(name.clone(), Arc::clone(&image.get().0));
                }
            }
        }
        Ok((memory, results))
    }

    /// Sends an event to a front end that may no longer receive it.
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}

impl Host for MemoryHost {
    fn result(&mut self, text: &str, json: &Value) {
        let mut results = self.results.lock();
        results.text = text.to_string();
        results.json = json.clone();
    }

    fn note(&self, line: &str) {
        self.results.lock().notes.push(line.to_string());
        self.send(Event::Note(line.to_string()));
    }

    fn log_line(&self, line: &str) {
        self.send(Event::Note(line.to_string()));
    }

    fn begin_stage(&mut self, name: &str) {
        self.send(Event::Stage(name.to_string()));
    }

    fn progress(&self, fraction: f64, detail: &str) {
        self.send(Event::Progress(fraction, detail.to_string()));
    }

    fn mesh(&self, name: &Path) -> Option<AnyMesh> {
        self.meshes.get(name).map(|mesh| (**mesh).clone())
    }

    fn image(&self, name: &Path) -> Option<AnyImage> {
        self.images.get(name).map(|image| (**image).clone())
    }

    fn hash(&self, name: &Path) -> Option<String> {
        match self.images.get(name) {
            Some(image) => Some(objects::hash(image)),
            None => self.meshes.get(name).map(|_| String::new()),
        }
    }

    fn keeps_in_memory(&self, name: &Path) -> bool {
        self.kept_names.iter().any(|kept| kept == name)
    }

    fn keep_in_memory(&mut self, name: &Path, result: MemoryOutput) {
        let name = name.display().to_string();
        self.results.lock().stored.push((name, result));
    }
}
