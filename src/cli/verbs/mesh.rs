//! The verb `mesh`: makes a mesh of an image, and prints its report.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::Result;
use crate::cli::common::global::VerbStatus;
use crate::cli::common::options::{Typed, with_option_name};
use crate::cli::console::{Console, print};
use crate::cli::interrupts::Interrupts;
use crate::comm::Comm;
use crate::job::MeshSpec;
use crate::session::{Objects, Session, check_files, run_distributed};

/// Arguments of `atomesh mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The image to mesh: SEG-Y, Zarr, MDIO, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png (2-D),
    /// or raw samples with --raw
    #[arg(value_name = "IMAGE", required_unless_present = "print_config")]
    pub image: Option<PathBuf>,
    /// Options of the job.
    #[command(flatten)]
    pub spec: Typed<MeshSpec>,
    /// A TOML file of options. Options on the command line take precedence
    #[arg(long, value_name = "FILE.toml", help_heading = None)]
    pub config: Option<PathBuf>,
    /// Print the whole report, which --report writes as JSON in any case
    #[arg(long, help_heading = None)]
    pub details: bool,
    /// Print the effective options as TOML and stop
    #[arg(long, help_heading = None)]
    pub print_config: bool,
}

/// Runs the verb.
pub(crate) fn mesh(
    args: &MeshArgs,
    interrupts: &Interrupts,
    console: &mut Console,
    comm: &dyn Comm,
) -> Result<VerbStatus> {
    let Typed { options, names } = args.spec.clone();
    let config = args.config.as_deref();
    let spec = options
        .with_config(&names, config)
        .map_err(with_option_name::<MeshSpec>)?;
    let image = args.image.as_deref().unwrap_or(Path::new("image"));
    check_files(image, &spec, config, comm.size())?;
    if args.print_config {
        print(spec.to_toml()?.trim_end());
        return Ok(VerbStatus::Done);
    }
    let mut session = Session {
        objects: &Objects::default(),
        progress: &mut console.job_progress(interrupts, comm.size() == 1),
    };
    let answer = run_distributed(&mut session, image, &spec, args.details, comm)
        .map_err(with_option_name::<MeshSpec>)?;
    if comm.is_root() {
        console.answer(&answer);
    }
    Ok(if answer.is_interrupted {
        VerbStatus::Interrupted
    } else {
        VerbStatus::Done
    })
}
