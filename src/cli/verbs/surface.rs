//! The verb `surface`: groups faces on features into labelled surfaces.

use std::path::PathBuf;

use clap::Args;

use crate::surfaces::SurfaceSpec;

/// Arguments of `atomesh surface`.
#[derive(Debug, Args)]
pub struct SurfaceArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The file to write: surfaces as .vtp, .obj, or GOCAD's .ts; faults as sticks: .csv, .charisma;
    /// horizons as grids of their heights, .irap, .zmap, .cps3, .grd, .asc, or as points, .xyz
    #[arg(short, long, value_name = "S.vtp")]
    pub output: PathBuf,
    /// Options of the surfaces.
    #[command(flatten)]
    pub spec: SurfaceSpec,
}
