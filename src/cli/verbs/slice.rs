//! `atomesh slice`: pictures of a mesh over its image.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::cli::common::output::{check_output, shown};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::image::formats::AnyLoaded;
use crate::image::formats::InputOptions;
use crate::model::slice::{self, Skeleton};
use crate::store::AnyMesh;
use crate::{Error, Result};

/// `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// Its mesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// The point where the planes meet, in physical coordinates [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<String>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Runs the verb.
pub fn slice(args: &SliceArgs, console: &mut Console) -> Result<()> {
    check_output(
        &args.output,
        "--output",
        &["png"],
        &[&args.image, &args.mesh],
    )?;
    let at = args
        .at
        .as_deref()
        .map(|text| parse::point("--at", text, "give a point such as 1500,2000,300"))
        .transpose()?;
    console.begin_stage("reading");
    let image = console.read_image(&args.image, &args.input)?;
    let mesh = console.read_mesh(&args.mesh)?;
    console.begin_stage("drawing");
    let refuse =
        |problem: &str, remedy: &str| Error::Job(cause(args.mesh.display(), problem, remedy));
    let other = |mesh: u8, image: u8| {
        let problem = format!("is a {mesh}-D mesh, but the image is {image}-D");
        refuse(&problem, "give the mesh of the image")
    };
    let no_space = || {
        refuse(
            "the image's axes are linearly dependent",
            "correct its geometry",
        )
    };
    let picture = match image {
        AnyLoaded::Plane(loaded) => {
            let geometry = &loaded.image.geometry;
            let skeleton = match mesh {
                AnyMesh::Plane(file) => Skeleton::new(&file, geometry),
                AnyMesh::PlaneCells(file) => Skeleton::new(&file, geometry),
                _ => return Err(other(3, 2)),
            };
            slice::plane(&loaded.image, &skeleton.ok_or_else(no_space)?)?
        }
        AnyLoaded::Space(loaded) => {
            let geometry = &loaded.image.geometry;
            let skeleton = match mesh {
                AnyMesh::Space(file) => Skeleton::new(&file, geometry),
                AnyMesh::SpaceCells(file) => Skeleton::new(&file, geometry),
                _ => return Err(other(2, 3)),
            };
            let at = match at {
                Some(at) => geometry.to_index(at).ok_or_else(no_space)?,
                None => loaded.image.dims().map(|n| (n / 2) as f64),
            };
            slice::space(&loaded.image, &skeleton.ok_or_else(no_space)?, at)?
        }
    };
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": shown(&args.output), "size": [width, height] }),
    );
    Ok(())
}
