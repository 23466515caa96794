//! `atomesh slice`: pictures of a mesh over its image.

use serde_json::json;

use super::args::SliceArgs;
use super::console::Console;
use super::job::check_output;
use super::parse;
use crate::error::cause;
use crate::export::{AnyMesh, read_any_vtu};
use crate::io::AnyLoaded;
use crate::report::slice::{self, Skeleton};
use crate::{Error, Result, io};

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
    let image = io::read_any(&args.image, &args.input.read_options()?)?;
    let mesh = read_any_vtu(&args.mesh)?;
    console.begin_stage("drawing");
    let refuse =
        |problem: &str, remedy: &str| Error::Job(cause(args.mesh.display(), problem, remedy));
    let no_space = || refuse("the image's axes do not span space", "correct its geometry");
    let picture = match (image, mesh) {
        (AnyLoaded::Plane(loaded), AnyMesh::Plane(file)) => {
            let skeleton = Skeleton::new(&file, &loaded.image.geometry).ok_or_else(no_space)?;
            slice::plane(&loaded.image, &skeleton)?
        }
        (AnyLoaded::Space(loaded), AnyMesh::Space(file)) => {
            let geometry = &loaded.image.geometry;
            let skeleton = Skeleton::new(&file, geometry).ok_or_else(no_space)?;
            let at = match at {
                Some(at) => geometry.to_index(at).ok_or_else(no_space)?,
                None => loaded.image.dims().map(|n| (n / 2) as f64),
            };
            slice::space(&loaded.image, &skeleton, at)?
        }
        (AnyLoaded::Plane(_), _) => {
            return Err(refuse(
                "is a 3-D mesh, but the image is 2-D",
                "give the mesh of the image",
            ));
        }
        (AnyLoaded::Space(_), _) => {
            return Err(refuse(
                "is a 2-D mesh, but the image is 3-D",
                "give the mesh of the image",
            ));
        }
    };
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": args.output, "size": [width, height] }),
    );
    Ok(())
}
