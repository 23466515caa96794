//! The verb `segment`: separates an object from the background by a minimum cut on the cells of a
//! mesh.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::model::segment::SegmentSpec;
use crate::progress::Stage;
use crate::surfaces::outcome::SURFACE_EXTENSIONS;

/// Arguments of `atomesh segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// The image that was meshed, or another of the same dimensions
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with `label` (1 object, 0 background) and `mean` (of the image) for each
    /// cell
    #[arg(short, long, value_name = "SEG.vtu")]
    pub output: PathBuf,
    /// Options of the segmentation.
    #[command(flatten)]
    pub spec: SegmentSpec,
}

impl SegmentArgs {
    /// Checks that no output replaces an input or another output.
    fn check_files(&self) -> Result<()> {
        let mut inputs: Vec<&Path> = vec![&self.image, &self.mesh];
        inputs.extend(self.spec.truth.as_deref());
        check_output(&self.output, "--output", &["vtu"], &inputs)?;
        inputs.push(&self.output);
        if let Some(path) = &self.spec.labels_out {
            check_output(path, "--labels-out", &IMAGE_EXTENSIONS, &inputs)?;
            inputs.push(path);
        }
        match &self.spec.surface_out {
            Some(path) => check_output(path, "--surface-out", &SURFACE_EXTENSIONS, &inputs),
            None => Ok(()),
        }
    }
}

/// Runs the verb.
pub fn segment(args: &SegmentArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    args.check_files()?;
    spec.validate().map_err(with_option_name::<SegmentSpec>)?;
    console.begin_stage(Stage::Reading);
    let mesh = console.read_mesh(&args.mesh)?;
    let image = console.read_image(&args.image, &spec.input)?;
    let paths = [&*args.mesh, &*args.image];
    let outcome = console.run_on_mesh_and_image(
        interrupts,
        mesh,
        image,
        paths,
        None,
        |mesh, image, progress| {
            crate::segment(mesh, image, spec, progress).map_err(with_option_name::<SegmentSpec>)
        },
    )?;
    console.begin_stage(Stage::Writing);
    let table = outcome.table();
    if let (Some(path), Some(labels)) = (&spec.labels_out, outcome.labels) {
        console.write_any_image(path, labels)?;
    }
    if let (Some(path), Some(surface)) = (&spec.surface_out, outcome.surface) {
        console.write_any_surfaces(path, surface)?;
    }
    console.write_any_mesh(&args.output, outcome.mesh)?;
    console.result(
        format_args!("{table}\nwrote {}", args.output.display()),
        &json!({
            "file": path_text(&args.output),
            "labels": spec.labels_out.as_deref().map(path_text),
            "surface": spec.surface_out.as_deref().map(path_text),
            "cells": outcome.cells,
            "samples": outcome.samples,
        }),
    );
    Ok(())
}
