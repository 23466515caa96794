//! The command line as a whole. The arguments of each verb are declared next to its code, in
//! [`verbs`](crate::cli::verbs).

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};

use crate::cli::common::global::CommonOptions;
use crate::cli::verbs::columns::ColumnsArgs;
use crate::cli::verbs::convert::ConvertArgs;
use crate::cli::verbs::edit::EditArgs;
use crate::cli::verbs::export::ExportArgs;
use crate::cli::verbs::feature::FeatureArgs;
use crate::cli::verbs::flow::FlowArgs;
use crate::cli::verbs::info::InfoArgs;
use crate::cli::verbs::mesh::MeshArgs;
use crate::cli::verbs::paint::PaintArgs;
use crate::cli::verbs::quality::QualityArgs;
use crate::cli::verbs::report::ReportArgs;
use crate::cli::verbs::script::ScriptArgs;
use crate::cli::verbs::segment::SegmentArgs;
use crate::cli::verbs::setup::{CompletionsArgs, ManArgs};
use crate::cli::verbs::slice::SliceArgs;
use crate::cli::verbs::surface::SurfaceArgs;
use crate::cli::verbs::synth::SynthArgs;
use crate::cli::verbs::validate::ValidateArgs;
use crate::error::{Error, cause};

/// Returns the text of `atomesh --version`. The licence of the program depends on the libraries
/// that are linked into it.
fn version() -> &'static str {
    match (cfg!(feature = "tetgen"), cfg!(feature = "cgal")) {
        (true, true) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with TetGen (AGPL-3.0) and CGAL's triangulations",
            "\n(GPL-3.0), so this program as a whole is AGPL-3.0. `--no-default-features --features cli`",
            "\nbuilds one without them, which makes the same meshes."
        ),
        (true, false) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with TetGen (AGPL-3.0), so this program as a",
            "\nwhole is AGPL-3.0. `--no-default-features --features cli` builds one without it, which makes",
            "\nthe same meshes."
        ),
        (false, true) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with CGAL's triangulations (GPL-3.0), so this",
            "\nprogram as a whole is GPL-3.0. `--no-default-features --features cli` builds one without it,",
            "\nwhich makes the same meshes."
        ),
        (false, false) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nMIT OR Apache-2.0. Built without TetGen and CGAL, with atomesh's own Delaunay kernel."
        ),
    }
}

/// The whole command line.
#[derive(Debug, Parser)]
#[command(
    name = "atomesh",
    version = version(),
    about = "Images, above all seismic volumes, straight to feature-aligned meshes",
    propagate_version = true,
    arg_required_else_help = true,
    after_help = "Examples:\n  atomesh synth amplitude -o survey.sgy\n  \
                  atomesh mesh survey.sgy -o mesh.vtu --feature faults+horizons\n  \
                  atomesh surface mesh.vtu --survey survey.sgy -o surfaces.vtp"
)]
pub struct CommandLine {
    /// The verb to run.
    #[command(subcommand)]
    pub verb: Verb,
    /// Options that every verb has.
    #[command(flatten)]
    pub common: CommonOptions,
}

/// The verbs of the command line.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Makes a mesh of an image that is aligned with the image's features (the main job)
    #[command(after_help = "Example:\n  atomesh mesh survey.sgy -o mesh.vtu --distance 8")]
    Mesh(Box<MeshArgs>),
    /// Detects the features of an image and writes the potential b(x)
    #[command(after_help = "Example:\n  atomesh feature faults.npy -o potential.vti --sigma 2")]
    Feature(FeatureArgs),
    /// Shows what a file holds: dimensions, geometry, units, range, traces, missing data
    #[command(after_help = "Example:\n  atomesh info survey.sgy")]
    Info(InfoArgs),
    /// Converts an image from one format to another
    #[command(after_help = "Example:\n  atomesh convert survey.sgy survey.vti")]
    Convert(ConvertArgs),
    /// Measures the quality and the fidelity of a mesh
    #[command(after_help = "Example:\n  atomesh quality mesh.vtu --truth distance.npy")]
    Quality(QualityArgs),
    /// Writes a page with mesh, image and figures: one HTML file for any browser
    #[command(after_help = "Example:\n  atomesh report survey.sgy mesh.vtu -o page.html")]
    Report(ReportArgs),
    /// Checks a mesh with atomesh's own checker, its Delaunay kernels and CGAL
    #[command(after_help = "Example:\n  atomesh validate mesh.vtu")]
    Validate(ValidateArgs),
    /// Computes steady flow from sources to sinks, with faults closed, open, or in between
    #[command(
        after_help = "Example:\n  atomesh flow mesh.vtu --source 20,30,40 --sink 80,60,50 -o flow.vtu --streamlines lines.vtp"
    )]
    Flow(FlowArgs),
    /// Adds, moves and removes atoms of a mesh; only their neighbourhood changes
    #[command(
        after_help = "Example:\n  atomesh edit mesh.vtu survey.sgy -o edited.vtu --add 1500,2000,300 --remove 812"
    )]
    Edit(EditArgs),
    /// Extends the Voronoi cells of a map down through layers between horizons
    #[command(
        after_help = "Example:\n  atomesh columns map.vtu --horizon top.npy --horizon base.npy --layers 5 -o cells.vtu"
    )]
    Columns(ColumnsArgs),
    /// Exports a mesh to a reservoir simulator, or to another mesher
    #[command(
        after_help = "Example:\n  atomesh export cells.vtu --to opm -o CASE.DATA --porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 2000"
    )]
    Export(Box<ExportArgs>),
    /// Draws the mesh over its image, a part of it in space, surfaces and lines
    #[command(
        after_help = "Example:\n  atomesh slice survey.sgy mesh.vtu -o sections.png\n  atomesh slice flow.vtu lines.vtp -o flow.png --view 3d --cut z --color pressure"
    )]
    Slice(SliceArgs),
    /// Groups the faces on features into labelled surfaces: faults, horizons
    #[command(after_help = "Example:\n  atomesh surface mesh.vtu -o faults.vtp")]
    Surface(SurfaceArgs),
    /// Paints cells from seeds, within layers but not across surfaces
    #[command(
        after_help = "Example:\n  atomesh paint mesh.vtu --seed 40,50,60 --seed 90,50,60 -o painted.vtu"
    )]
    Paint(PaintArgs),
    /// Separates an object from the background by a minimum cut on the cells of a mesh
    #[command(
        after_help = "Example:\n  atomesh segment image.nrrd mesh.vtu --object 60,60,60 --background 5,5,5 -o segmented.vtu"
    )]
    Segment(SegmentArgs),
    /// Makes synthetic images whose features are known exactly
    #[command(
        after_help = "Example:\n  atomesh synth faults -o faults.vti --truth distance.npy --dims 170,150,128"
    )]
    Synth(SynthArgs),
    /// Runs a script of commands, whose meshes stay in memory until its end
    #[command(after_help = "Example:\n  atomesh script steps.txt")]
    Script(ScriptArgs),
    /// Shows how this program was built, what it runs on, and which related programs are installed
    #[command(after_help = "Example:\n  atomesh doctor")]
    Doctor,
    /// Prints a script with which a shell completes commands and options
    #[command(
        after_help = "Example:\n  atomesh completions bash > ~/.local/share/bash-completion/completions/atomesh"
    )]
    Completions(CompletionsArgs),
    /// Writes manual pages
    #[command(after_help = "Example:\n  atomesh man -o ~/.local/share/man/man1")]
    Man(ManArgs),
}

/// Returns an error about the value of an option as an error of one line. Returns `None` if the
/// command line is wrong in another way, which clap explains better.
pub fn value_error(error: &clap::Error) -> Option<Error> {
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.as_str()),
        _ => None,
    };
    if error.kind() != ErrorKind::ValueValidation {
        return None;
    }
    let option = text(ContextKind::InvalidArg)?.split(' ').next()?;
    let value = text(ContextKind::InvalidValue)?;
    let problem = std::error::Error::source(error)?.to_string();
    let (problem, remedy) = problem
        .split_once("; ")
        .unwrap_or((&problem, "--help says what is expected"));
    Some(Error::Job(cause(
        format!("{option} {value}"),
        problem,
        remedy,
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        CommandLine::command().debug_assert();
    }
}
