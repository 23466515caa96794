//! What is measured about a mesh and about the run that made it.
//!
//! - [`fidelity`]: how well the mesh's faces follow the features
//! - [`reference`]: where the features really are

pub mod fidelity;
mod nearest;
pub mod reference;
#[cfg(test)]
mod test_mesh;

pub use fidelity::{Fidelity, Match, fidelity};
pub use reference::Reference;
