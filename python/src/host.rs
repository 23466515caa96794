//! A desk at which what verbs name is in memory.

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

/// What is heard while a verb runs.
pub enum Event {
    Stage(String),
    Progress(f64, String),
    Note(String),
}

/// What a verb has said by its end.
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

/// Meshes and images by name.
pub struct MemoryHost {
    meshes: HashMap<PathBuf, Arc<AnyMesh>>,
    images: HashMap<PathBuf, Arc<AnyImage>>,
    kept_names: Vec<PathBuf>,
    events: Sender<Event>,
    results: SharedResults,
}

impl MemoryHost {
    /// A desk, and what will have been said at it.
    pub fn new(
        held: &HashMap<PathBuf, Bound<'_, PyAny>>,
        keep: Vec<PathBuf>,
        events: Sender<Event>,
    ) -> PyResult<(Self, SharedResults)> {
        let said = SharedResults::default();
        let mut memory = Self {
            meshes: HashMap::new(),
            images: HashMap::new(),
            kept_names: keep,
            events,
            results: said.clone(),
        };
        for (name, thing) in held {
            match thing.cast::<objects::Mesh>() {
                Ok(mesh) => {
                    memory
                        .meshes
                        .insert(name.clone(), Arc::clone(&mesh.get().0));
                }
                Err(_) => {
                    let image = thing.cast::<objects::Image>()?;
                    memory
                        .images
                        .insert(name.clone(), Arc::clone(&image.get().0));
                }
            }
        }
        Ok((memory, said))
    }

    /// Says it to a front end that may not listen any more.
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}

impl Host for MemoryHost {
    fn result(&mut self, text: &str, json: &Value) {
        let mut said = self.results.lock();
        said.text = text.to_string();
        said.json = json.clone();
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

    fn progress(&self, share: f64, what: &str) {
        self.send(Event::Progress(share, what.to_string()));
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
