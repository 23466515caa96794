//! The verb `convert`: converts images, grids and surfaces from one format to another.

use std::path::PathBuf;

use clap::Args;

use crate::export::convert::ConvertSpec;

/// Arguments of `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image or grid to read, a corner-point grid (EGRID, GRDECL; FILE:NAME names a property), or
    /// surfaces: .vtp, GOCAD's .ts or .pl, .obj, .stl, .ply, or fault sticks: .csv, .charisma
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// The file to write: an image (.vti, .npy, .nrrd, .mha, .nii, .nii.gz, .zarr, in 2-D .png, with
    /// --like .sgy), a grid (.irap, .zmap, .cps3, .grd, .asc), surfaces (.vtp, .obj, .ts, .pl, .csv), or
    /// a corner-point grid (.GRDECL, .EGRID)
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Options of the conversion.
    #[command(flatten)]
    pub spec: ConvertSpec,
}
