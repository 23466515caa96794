//! The `atomesh` binary: parse, run, exit code.

use std::process::ExitCode;

use atomesh::cli::args::CommandLine;
use atomesh::cli::out_of_memory::Careful;
use clap::Parser;

#[global_allocator]
static ALLOCATOR: Careful = Careful;

fn main() -> ExitCode {
    atomesh::cli::main(&CommandLine::parse())
}
