//! A desk at which what verbs name is in memory.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use atomesh::cli::desk::{Desk, Kept};
use atomesh::image::formats::AnyLoaded;
use atomesh::store::AnyMesh;
use pyo3::prelude::*;
use serde_json::Value;

use crate::held;

/// What is heard while a verb runs.
pub enum Event {
    Stage(String),
    Progress(f64, String),
    Note(String),
}

/// What a verb has said by its end.
#[derive(Clone, Default)]
pub struct Said(Arc<Mutex<Results>>);

#[derive(Default)]
pub struct Results {
    pub text: String,
    pub json: Value,
    pub notes: Vec<String>,
    pub kept: Vec<(String, Kept)>,
}

impl Said {
    pub fn lock(&self) -> MutexGuard<'_, Results> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Meshes and images by name.
pub struct Memory {
    meshes: HashMap<PathBuf, Arc<AnyMesh>>,
    images: HashMap<PathBuf, Arc<AnyLoaded>>,
    keep: Vec<PathBuf>,
    events: Sender<Event>,
    said: Said,
}

impl Memory {
    /// A desk, and what will have been said at it.
    pub fn new(
        held: &HashMap<PathBuf, Bound<'_, PyAny>>,
        keep: Vec<PathBuf>,
        events: Sender<Event>,
    ) -> PyResult<(Self, Said)> {
        let said = Said::default();
        let mut memory = Self {
            meshes: HashMap::new(),
            images: HashMap::new(),
            keep,
            events,
            said: said.clone(),
        };
        for (name, thing) in held {
            match thing.cast::<held::Mesh>() {
                Ok(mesh) => {
                    memory
                        .meshes
                        .insert(name.clone(), Arc::clone(&mesh.get().0));
                }
                Err(_) => {
                    let image = thing.cast::<held::Image>()?;
                    memory
                        .images
                        .insert(name.clone(), Arc::clone(&image.get().0));
                }
            }
        }
        Ok((memory, said))
    }

    /// Says it to a front end that may not listen any more.
    fn tell(&self, event: Event) {
        let _ = self.events.send(event);
    }
}

impl Desk for Memory {
    fn result(&mut self, text: &str, json: &Value) {
        let mut said = self.said.lock();
        said.text = text.to_string();
        said.json = json.clone();
    }

    fn note(&self, line: &str) {
        self.said.lock().notes.push(line.to_string());
        self.tell(Event::Note(line.to_string()));
    }

    fn line(&self, line: &str) {
        self.tell(Event::Note(line.to_string()));
    }

    fn stage(&mut self, name: &str) {
        self.tell(Event::Stage(name.to_string()));
    }

    fn progress(&self, share: f64, what: &str) {
        self.tell(Event::Progress(share, what.to_string()));
    }

    fn mesh(&self, name: &Path) -> Option<AnyMesh> {
        self.meshes.get(name).map(|mesh| (**mesh).clone())
    }

    fn image(&self, name: &Path) -> Option<AnyLoaded> {
        self.images.get(name).map(|image| (**image).clone())
    }

    fn hash(&self, name: &Path) -> Option<String> {
        match self.images.get(name) {
            Some(image) => Some(held::hash(image)),
            None => self.meshes.get(name).map(|_| String::new()),
        }
    }

    fn keeps(&self, name: &Path) -> bool {
        self.keep.iter().any(|kept| kept == name)
    }

    fn keep(&mut self, name: &Path, result: Kept) {
        let name = name.display().to_string();
        self.said.lock().kept.push((name, result));
    }
}
