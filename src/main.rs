//! The `atomesh` binary: parse, run, exit code.

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    atomesh::cli::main(&atomesh::cli::args::CommandLine::parse())
}
