//! The `atomesh` binary: parse, run, exit code.

use std::process::ExitCode;

use atomesh::cli::allocator::Careful;

#[global_allocator]
static ALLOCATOR: Careful = Careful;

fn main() -> ExitCode {
    atomesh::cli::main()
}
