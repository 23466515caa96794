//! The verb `mesh`: makes a mesh of an image, and prints its report.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::Result;
use crate::cli::common::global::VerbStatus;
use crate::cli::common::options::{Typed, with_option_name};
use crate::cli::console::{Console, print};
use crate::cli::interrupts::Interrupts;
use crate::comm::{Comm, SelfComm};
use crate::job::MeshSpec;
use crate::session::{Answer, Objects, Session, check_files, run_distributed};

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

/// A job: its image and all options.
pub(crate) struct MeshJob {
    /// The image.
    pub image: PathBuf,
    /// The options.
    pub spec: MeshSpec,
    /// `true` if the text of the report has all details.
    details: bool,
}

impl MeshJob {
    /// Returns the job that the arguments and their configuration file describe. Checks the names of
    /// its files. `rank_count` processes share the job.
    ///
    /// # Errors
    /// Returns the errors of the options and of the files.
    pub fn new(args: &MeshArgs, rank_count: usize) -> Result<Self> {
        let Typed { options, names } = args.spec.clone();
        let config = args.config.as_deref();
        let spec = options
            .with_config(&names, config)
            .map_err(with_option_name::<MeshSpec>)?;
        let image = args.image.clone().unwrap_or_else(|| "image".into());
        check_files(&image, &spec, config, rank_count)?;
        Ok(Self {
            image,
            spec,
            details: args.details,
        })
    }

    /// Runs the job.
    ///
    /// # Errors
    /// Returns the errors of the job.
    pub fn run(&self, session: &mut Session<'_>, comm: &dyn Comm) -> Result<Answer> {
        run_distributed(session, &self.image, &self.spec, self.details, comm)
            .map_err(with_option_name::<MeshSpec>)
    }

    /// Runs the job in this process alone, with another name for its mesh.
    ///
    /// # Errors
    /// Returns the errors of the job.
    pub fn run_with_output(mut self, output: &Path, session: &mut Session<'_>) -> Result<Answer> {
        self.spec.output = Some(output.into());
        self.run(session, &SelfComm)
    }
}

/// Runs the verb.
pub(crate) fn mesh(
    args: &MeshArgs,
    interrupts: &Interrupts,
    console: &mut Console,
    comm: &dyn Comm,
) -> Result<VerbStatus> {
    let job = MeshJob::new(args, comm.size())?;
    if args.print_config {
        print(job.spec.to_toml()?.trim_end());
        return Ok(VerbStatus::Done);
    }
    let mut session = Session {
        objects: &Objects::default(),
        progress: &mut console.job_progress(interrupts, comm.size() == 1),
    };
    let answer = job.run(&mut session, comm)?;
    if comm.is_root() {
        console.answer(&answer);
    }
    Ok(if answer.is_interrupted {
        VerbStatus::Interrupted
    } else {
        VerbStatus::Done
    })
}
