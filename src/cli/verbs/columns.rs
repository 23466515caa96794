//! The verb `columns`: extends the Voronoi cells of a map down through layers between horizons.

use std::path::PathBuf;

use clap::Args;

use crate::model::columns::ColumnsSpec;

/// Arguments of `atomesh columns`.
#[derive(Debug, Args)]
pub struct ColumnsArgs {
    /// The map: a mesh of Voronoi cells of a 2-D image, made by `atomesh mesh MAP --cells voronoi`
    #[arg(value_name = "MAP.vtu")]
    pub map: PathBuf,
    /// The mesh to write
    #[arg(short, long, value_name = "CELLS.vtu")]
    pub output: PathBuf,
    /// A horizon; give at least two, from the top down. Each is a number z, a 2-D image of z (with
    /// the dimensions of the meshed image, or with its own position), a grid (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), or
    /// surfaces FILE[:NAME] (.ts, .vtp, .obj) or points. z is brought to one unit and one direction; what a file does not say
    /// follows it: ,unit=ft ,z=down ,null=-999
    #[arg(long, value_name = "Z", required = true, allow_hyphen_values = true)]
    pub horizon: Vec<String>,
    /// Options of the columns.
    #[command(flatten)]
    pub spec: ColumnsSpec,
}
