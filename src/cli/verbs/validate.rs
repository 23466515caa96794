//! The verb `validate`: checks a mesh with atomesh's own checker, the Delaunay kernels (spade in 2-D) and
//! CGAL, as far as they are built in.

use std::path::PathBuf;

use clap::Args;

/// Arguments of `atomesh validate`.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
}
