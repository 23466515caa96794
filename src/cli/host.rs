//! The environment in which a verb runs: it receives messages and provides the files that the verb
//! names.
//!
//! The host of the command line is the terminal and the file system. Another front end, such as a
//! Python session, provides its own host, in which meshes, images and surfaces in memory have names
//! as if they were files, and calls [`run_with_console`](super::run_with_console).

use std::any::Any;
use std::path::Path;

use serde_json::Value;

use crate::export::SurfaceFile;
use crate::image::Image;
use crate::image::formats::AnyImage;
use crate::store::AnyMesh;

/// The interface between a verb and the front end that runs it.
pub trait Host: Send {
    /// Receives the result of the verb, as text and as JSON.
    fn result(&mut self, text: &str, json: &Value);

    /// Receives a note: one line that the user should read but that stops nothing.
    fn note(&self, line: &str);

    /// Receives one line that is shown next to the progress.
    fn log_line(&self, line: &str);

    /// Is called when a stage begins.
    fn begin_stage(&mut self, name: &str);

    /// Receives the largest fraction of the stage that can be done, in [0, 1], and its current
    /// step.
    fn progress(&self, fraction: f64, detail: &str);

    /// Is called when the stage ends.
    fn end_stage(&mut self) {}

    /// Returns the mesh of this name; `None` if it is a file.
    fn mesh(&self, _name: &Path) -> Option<AnyMesh> {
        None
    }

    /// Returns the image of this name, such as `<volume>`; `None` if it is a file.
    fn image(&self, _name: &Path) -> Option<AnyImage> {
        None
    }

    /// Returns the hash of the mesh or image of this name; `None` if it is a file.
    fn hash(&self, _name: &Path) -> Option<String> {
        None
    }

    /// Returns `true` if output of this name is [kept](Self::keep_in_memory) in memory and not
    /// written.
    fn keeps_in_memory(&self, _name: &Path) -> bool {
        false
    }

    /// Keeps a result in memory.
    fn keep_in_memory(&mut self, _name: &Path, _result: MemoryOutput) {}
}

/// A result in memory that would otherwise be written to a file.
#[derive(Debug, Clone)]
pub enum MemoryOutput {
    /// A mesh.
    Mesh(Box<AnyMesh>),
    /// A 2-D image.
    Plane(Image<2>),
    /// A 3-D image.
    Space(Image<3>),
    /// Curves in the plane.
    Curves(SurfaceFile<2>),
    /// Surfaces in space.
    Surfaces(SurfaceFile<3>),
}

impl MemoryOutput {
    /// Wraps a [`MeshFile`](crate::store::MeshFile), an image or a [`SurfaceFile`]; returns `None`
    /// for anything else.
    pub fn from_any(result: impl Any) -> Option<Self> {
        let mut result: Option<Box<dyn Any>> = Some(Box::new(result));
        take_downcast(&mut result)
            .map(Self::Plane)
            .or_else(|| take_downcast(&mut result).map(Self::Space))
            .or_else(|| take_downcast(&mut result).map(Self::Curves))
            .or_else(|| take_downcast(&mut result).map(Self::Surfaces))
            .or_else(|| AnyMesh::from_any(result?).map(|mesh| Self::Mesh(Box::new(mesh))))
    }
}

/// Takes the value out of `result` if it has type `T`.
fn take_downcast<T: Any>(result: &mut Option<Box<dyn Any>>) -> Option<T> {
    match result.take()?.downcast() {
        Ok(value) => Some(*value),
        Err(result_of_other_type) => {
            *result = Some(result_of_other_type);
            None
        }
    }
}
