//! The `atomesh` binary: parse, run, exit code.

use std::process::ExitCode;

use atomesh::cli::out_of_memory::Careful;

#[global_allocator]
static ALLOCATOR: Careful = Careful;

fn main() -> ExitCode {
    atomesh::cli::main()
}
