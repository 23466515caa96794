//! Measures of a mesh from a file, and a page that shows them with the mesh and its image.
//!
//! - `quality`: measures the quality and the fidelity of a mesh
//! - `report`: writes the page

pub(crate) mod quality;
mod report;

pub use quality::{QualitySpec, quality};
pub use report::{ReportSpec, report};
