//! Where a verb works: who hears what it has to say, and where lies what it names by a path.
//!
//! The program's own desk is the terminal and the files of the operating system. Another front end, such
//! as a Python session, sets up one of its own, at which meshes, images and surfaces that it has in memory
//! go by names as if they were files, and calls [`perform_at`](super::perform_at).

use std::any::Any;
use std::path::Path;

use serde_json::Value;

use crate::export::SurfaceFile;
use crate::image::Image;
use crate::image::formats::AnyImage;
use crate::store::AnyMesh;

/// What a verb hears from and tells to whoever runs it.
pub trait Host: Send {
    /// The result of the verb.
    fn result(&mut self, text: &str, json: &Value);

    /// One line about something that the user should know but that stops nothing.
    fn note(&self, line: &str);

    /// One line beside the progress.
    fn log_line(&self, line: &str);

    /// A stage begins.
    fn begin_stage(&mut self, name: &str);

    /// How much of the stage is done at most, in [0, 1], and what it is at.
    fn progress(&self, share: f64, what: &str);

    /// The stage is over.
    fn end_stage(&mut self) {}

    /// The mesh that goes by this name, if it is no file.
    fn mesh(&self, _name: &Path) -> Option<AnyMesh> {
        None
    }

    /// The image that goes by this name, if it is no file.
    fn image(&self, _name: &Path) -> Option<AnyImage> {
        None
    }

    /// The hash of what goes by this name, if it is no file.
    fn hash(&self, _name: &Path) -> Option<String> {
        None
    }

    /// Whether what is to be written under this name shall be [kept](Self::keep) instead.
    fn keeps_in_memory(&self, _name: &Path) -> bool {
        false
    }

    /// Keeps a result.
    fn keep_in_memory(&mut self, _name: &Path, _result: MemoryOutput) {}
}

/// A result that would otherwise be a file.
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
    /// A mesh in a [`MeshFile`](crate::store::MeshFile), an image or a [`SurfaceFile`]; `None` of anything
    /// else.
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

/// What there is, if it is of this type.
fn take_downcast<T: Any>(result: &mut Option<Box<dyn Any>>) -> Option<T> {
    match result.take()?.downcast() {
        Ok(found) => Some(*found),
        Err(other) => {
            *result = Some(other);
            None
        }
    }
}
